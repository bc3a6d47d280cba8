//! A stream's samples beside forward kinematics, and how far the two are apart.

use ground::geometry::{Pose, angle_between};

/// A stream's samples beside what FK says at the same stamps. One entry a sample in each column.
#[derive(Clone, Debug, Default)]
pub struct Aligned {
    /// Stamp of the sample, s from the run's origin.
    pub t_s: Vec<f64>,
    /// `reference_from_child` as logged.
    pub logged: Vec<Pose>,
    /// `reference_from_tip` by FK of the joint states as recorded, at the same stamp.
    pub fk: Vec<Pose>,
    /// The logged pose with everything found taken off: what should lie on `fk_at_truth`.
    pub corrected: Vec<Pose>,
    /// `reference_from_tip` by FK with the joint offsets found, when the content was true.
    pub fk_at_truth: Vec<Pose>,
}

/// How far poses are apart. One entry a pair in each column.
#[derive(Clone, Debug, Default)]
pub struct Residuals {
    /// Distance of the positions, m.
    pub m: Vec<f64>,
    /// Angle of the rotation from one orientation to the other, rad.
    pub rad: Vec<f64>,
}

impl Aligned {
    /// The logged poses against FK's as recorded.
    pub fn before(&self) -> Residuals {
        Residuals::between(&self.logged, &self.fk)
    }

    /// The corrected poses against where the tip truly was.
    pub fn after(&self) -> Residuals {
        Residuals::between(&self.corrected, &self.fk_at_truth)
    }

    /// The middle of its stamps, s from the run's origin; 0 of no samples.
    pub(super) fn middle_s(&self) -> f64 {
        0.5 * (self.t_s.first().unwrap_or(&0.0) + self.t_s.last().unwrap_or(&0.0))
    }

    /// Distance of FK's position as recorded from the origin of the reference frame, m.
    pub fn reach_m(&self) -> Vec<f64> {
        self.fk.iter().map(|fk| fk.translation.vector.norm()).collect()
    }
}

impl Residuals {
    fn between(a: &[Pose], b: &[Pose]) -> Self {
        let pair = |(a, b): (&Pose, &Pose)| {
            let distance_m = (a.translation.vector - b.translation.vector).norm();
            (distance_m, angle_between(&a.rotation, &b.rotation))
        };
        let (m, rad) = a.iter().zip(b).map(pair).unzip();
        Self { m, rad }
    }
}
