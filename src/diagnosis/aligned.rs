//! Samples of a stream aligned with forward kinematics, and their differences.

use ground::geometry::{Pose, angle_between};

/// Samples of a stream and FK at the same stamps, one entry per sample in each column.
#[derive(Clone, Debug, Default)]
pub struct AlignedSamples {
    /// Stamp of the sample, s from the run's origin.
    pub t_s: Vec<f64>,
    /// `reference_from_child` as logged.
    pub logged: Vec<Pose>,
    /// `reference_from_tip` from FK of the recorded joint states at the same stamp.
    pub fk: Vec<Pose>,
    /// Logged pose with all findings corrected, comparable with `fk_at_truth`.
    pub corrected: Vec<Pose>,
    /// `reference_from_tip` from FK with corrected joints, at the time of measurement.
    pub fk_at_truth: Vec<Pose>,
}

/// Distances between pairs of poses, one entry per pair in each column.
#[derive(Clone, Debug, Default)]
pub struct PoseDistances {
    /// Distance between the positions, m.
    pub m: Vec<f64>,
    /// Angle between the orientations, rad.
    pub rad: Vec<f64>,
}

impl AlignedSamples {
    /// Logged poses against FK of the recorded joint states.
    pub fn before(&self) -> PoseDistances {
        PoseDistances::between(&self.logged, &self.fk)
    }

    /// Corrected poses against FK of the corrected joint states.
    pub fn after(&self) -> PoseDistances {
        PoseDistances::between(&self.corrected, &self.fk_at_truth)
    }

    /// Middle of the stamps, s from the run's origin. 0 without samples.
    pub(super) fn middle_s(&self) -> f64 {
        0.5 * (self.t_s.first().unwrap_or(&0.0) + self.t_s.last().unwrap_or(&0.0))
    }

    /// Distance of the recorded FK position from the origin of the reference frame, m.
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
