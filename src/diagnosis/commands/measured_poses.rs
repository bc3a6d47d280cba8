//! Measured poses with their noise.

use super::rest::{Rest, mean_pose, poses_within};
use crate::PoseSeries;
use crate::model::jacobian::pose_change;
use crate::solver::noise::Noise;
use ground::geometry::Vec3;
use ground::stats::MeasuredLength;

pub(super) struct MeasuredPoses<'a> {
    pub series: &'a PoseSeries,
    /// Per component of position, m, and rotation, rad.
    pub noise: [Noise; 2],
}

/// Noise of position, m, and rotation, rad.
pub(super) fn pose_noise(series: &PoseSeries, rests: &[Rest]) -> [Noise; 2] {
    /// From the specification: 1 µm and 1 µrad.
    const FLOOR: f64 = 1e-6;
    let changes = rests.iter().flat_map(|rest| {
        let poses = poses_within(series, rest.from_s, rest.to_s);
        let mean = mean_pose(poses);
        poses.iter().filter_map(move |pose| Some(pose_change(&mean?, pose).into()))
    });
    let (metres, radians): (Vec<Vec3>, Vec<Vec3>) = changes.unzip();
    [metres, radians].map(|residuals| Noise::unweighted(&residuals, FLOOR))
}

/// Accounts for autocorrelation.
pub(super) fn variance_of_mean(noise: &Noise, count: usize) -> f64 {
    let inflation = (noise.inflation() / count.max(1) as f64).min(1.0);
    noise.sigma * noise.sigma * inflation
}

/// All components have this variance.
pub(super) fn length_of(vector: Vec3, variance: f64) -> MeasuredLength {
    /// Squared: 1 µm and 1 µrad.
    const FLOOR: f64 = 1e-12;
    let covariance = nalgebra::DMatrix::identity(3, 3) * (variance + FLOOR);
    MeasuredLength::estimate(vector.as_slice(), &covariance, f64::INFINITY)
}
