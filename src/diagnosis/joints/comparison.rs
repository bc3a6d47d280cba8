//! Joint states and the pose stream with which they are compared.

use super::interpreted_poses::FreeFrames;
use super::slow_samples::rms_speeds;
use crate::PoseStream;
use crate::distinct::distinct;
use crate::frames::position_fit::spread;
use crate::latency::correlation::{joint_speed_lags, linear_speed};
use ground::geometry::Vec3;
use ground::stream::{JointTrack, sample_noise};

pub(super) const MIN_SAMPLES: usize = 6;
/// Share of the motion's extent, for joint states accepted as logged.
pub(super) const MAX_LOGGED_RESIDUAL_SHARE: f64 = 0.05;
/// For another interpretation at slow samples, before correcting latency and small causes.
pub(super) const MAX_RESIDUAL_RAD: f64 = 0.03;
/// Share of the extent.
pub(crate) const MAX_FOLLOWING_RESIDUAL_SHARE: f64 = 0.3;
/// Spread of the positions of a tip at rest.
pub(super) const MAX_REST_SPREAD_M: f64 = 2e-3;
/// Between latencies that are tried.
pub(super) const MIN_LAG_DIFFERENCE_S: f64 = 0.01;

#[derive(Clone, Copy)]
pub(crate) struct JointComparison<'a> {
    pub joints: &'a JointTrack,
    pub stream: &'a PoseStream<'a>,
    /// Unit of the stream's positions, m.
    pub metres: f64,
    /// The largest latency to search, s.
    pub max_lag_s: f64,
}

impl JointComparison<'_> {
    /// Whether the stream follows the arm, up to a tool offset or a rotated reference frame.
    pub fn follows_arm(&self, lag_s: f64) -> bool {
        let samples = self.samples(lag_s);
        samples.len() >= MIN_SAMPLES
            && samples.least_misfit(FreeFrames::Both)
                < MAX_FOLLOWING_RESIDUAL_SHARE * spread(&samples.xyz)
    }

    /// Zero and peaks of the speed correlation. At slow samples a remaining error has little effect, a wrong
    /// candidate has.
    pub(super) fn lags_s(&self) -> Vec<f64> {
        let Self { joints, stream: PoseStream { track, .. }, max_lag_s, .. } = *self;
        let speed = linear_speed(&track.t_s, &track.xyz);
        // Speeds as logged, and normalised per joint.
        let units = [vec![1.0; joints.dof], rms_speeds(joints)];
        let peaks =
            units.iter().flat_map(|units| joint_speed_lags(joints, units, &speed, max_lag_s));
        let is_same = |one: &f64, other: &f64| (one - other).abs() <= MIN_LAG_DIFFERENCE_S;
        distinct(std::iter::once(0.0).chain(peaks), is_same)
    }

    /// Largest position residual that counts as noise, m: no interpretation has a smaller one.
    pub(super) fn max_noise_m(&self, extent_m: f64) -> f64 {
        /// Residuals of 60 samples scatter by 5 %.
        const MAX_NOISE_RATIO: f64 = 1.5;
        let xyz = &self.stream.track.xyz;
        let along =
            |axis: usize| sample_noise(&xyz.iter().map(|xyz| xyz[axis]).collect::<Vec<f64>>());
        // Rms distance of a position from the mean, due to noise.
        let noise_m = self.metres * Vec3::from([0, 1, 2].map(along)).norm();
        (MAX_NOISE_RATIO * noise_m).min(MAX_LOGGED_RESIDUAL_SHARE * extent_m)
    }
}

/// Whether the poses follow FK as logged, up to constant frames. `None` if a resting tip or few samples do not
/// tell.
pub fn follows_as_logged(joints: &JointTrack, stream: &PoseStream) -> Option<bool> {
    let samples = JointComparison { joints, stream, metres: 1.0, max_lag_s: 0.0 }.samples(0.0);
    let extent = spread(&samples.xyz);
    let residual = samples.fitted_residual(&samples.as_logged(), FreeFrames::Both);
    (samples.len() >= MIN_SAMPLES && extent > MAX_REST_SPREAD_M).then(|| {
        residual.m < MAX_LOGGED_RESIDUAL_SHARE * extent
            && residual.rad.is_none_or(|rad| rad < MAX_RESIDUAL_RAD)
    })
}
