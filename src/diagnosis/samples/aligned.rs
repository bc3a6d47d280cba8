//! Samples of a stream aligned with forward kinematics.

use crate::model::jacobian::pose_change;
use ground::geometry::{Pose, Vec3, angle_between};
use nalgebra::Point3;

/// Poses of a stream and of FK, one entry per sample in each column.
#[derive(Clone, Debug, Default)]
pub struct AlignedSamples {
    /// Stamp, s from the run's origin.
    pub t_s: Vec<f64>,
    /// `reference_from_child` as logged.
    pub logged: Vec<Pose>,
    /// `reference_from_tip` from FK of the recorded joint states.
    pub fk: Vec<Pose>,
    /// Logged pose with all findings corrected.
    pub corrected: Vec<Pose>,
    /// `reference_from_tip` from FK of corrected joints at the time of measurement. Comparable with
    /// `corrected`.
    pub fk_at_truth: Vec<Pose>,
    /// Corrected joint positions at the time of measurement, in chain order: as many per sample as the chain has
    /// joints. Empty if unknown.
    pub q_at_truth: Vec<f64>,
    /// Base of each sample in the moving frame of the logged poses. Empty if the frame does not move in the base.
    pub frame_from_base: Vec<Pose>,
}

/// Distances between pairs of poses, one entry per pair.
#[derive(Clone, Debug, Default)]
pub struct PoseDistances {
    /// Position distance, m.
    pub m: Vec<f64>,
    /// Rotation angle, rad.
    pub rad: Vec<f64>,
}

impl AlignedSamples {
    /// Logged poses against recorded FK.
    pub fn before(&self) -> PoseDistances {
        PoseDistances::between(&self.logged, &self.fk)
    }

    /// Corrected poses against corrected FK.
    pub fn after(&self) -> PoseDistances {
        PoseDistances::between(&self.corrected, &self.fk_at_truth)
    }

    /// Corrected pose minus a predicted one: m, rotation vector in rad.
    pub(crate) fn residual(&self, row: usize, predicted: &Pose) -> [Vec3; 2] {
        pose_change(predicted, &self.corrected[row])
    }

    /// Corrected poses minus FK: positions of a point of the tip, m, and rotations, rad. At the origin of the tip, a
    /// rotation error of a distant marker becomes a position error.
    pub(crate) fn residuals(&self, point: Vec3) -> [Vec<Vec3>; 2] {
        let point = Point3::from(point);
        let residual = |(is, fk): (&Pose, &Pose)| {
            let [_, turn] = pose_change(fk, is);
            (is * point - fk * point, turn)
        };
        self.corrected.iter().zip(&self.fk_at_truth).map(residual).unzip().into()
    }

    /// Velocity of `fk_at_truth` in the frame of the logged poses, in the axes of the sample's base: m/s and rad/s.
    pub(crate) fn velocity(&self, row: usize) -> [Vec3; 2] {
        let (from, to) = (row.saturating_sub(1), (row + 1).min(self.t_s.len() - 1));
        let [before, after] = [from, to].map(|other| match self.frame_from_base.as_slice() {
            [] => self.fk_at_truth[other],
            base => base[row].inv_mul(&base[other]) * self.fk_at_truth[other],
        });
        let interval_s = (self.t_s[to] - self.t_s[from]).max(f64::MIN_POSITIVE);
        pose_change(&before, &after).map(|part| part / interval_s)
    }

    /// Middle of the stamps, s. 0 without samples.
    pub(crate) fn middle_s(&self) -> f64 {
        0.5 * (self.t_s.first().unwrap_or(&0.0) + self.t_s.last().unwrap_or(&0.0))
    }

    /// Distance of recorded FK from the reference origin, m.
    pub fn reach_m(&self) -> Vec<f64> {
        self.fk.iter().map(|fk| fk.translation.vector.norm()).collect()
    }
}

impl PoseDistances {
    fn between(a: &[Pose], b: &[Pose]) -> Self {
        let pair = |(a, b): (&Pose, &Pose)| {
            let distance_m = (a.translation.vector - b.translation.vector).norm();
            (distance_m, angle_between(&a.rotation, &b.rotation))
        };
        let (m, rad) = a.iter().zip(b).map(pair).unzip();
        Self { m, rad }
    }
}
