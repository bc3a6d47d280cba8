//! Large changes of a stream's latency, estimated from speeds alone. They are too large for
//! [`super::profile`], which requires small residuals.
//!
//! In each window of several seconds, the stream's speed matches the arm's at some lag. These lags form
//! steps ([`super::steps`]) or a piecewise linear profile ([`super::ramp`]).

use super::correlation::{ArmSpeeds, SpeedSeries, angular_speed, linear_speed, norm_series};
use super::lag_windows::{LagWindow, lag_windows};
use super::piecewise::PiecewiseLatency;
use super::ramp::RampFit;
use super::speed_residual::{MAX_SPEED_RESIDUAL_SHARE, SpeedPair};
use super::steps::{MAX_PROFILE_SAMPLES, detect_steps};
use crate::samples::sampling::{as_rotations, monotonic_rows, value_range};
use crate::{ImuStream, PoseStream};
use ground::stats::thin::thinned;
use ground::stats::{highest, lowest, median_of, quantile};
use ground::stream::JointTrack;

const MIN_CORRELATION: f64 = 0.85;
/// Residual of a piecewise linear profile over that of a line.
const MAX_RESIDUAL_RATIO: f64 = 0.9;
/// Of the latency. A profile shows smaller variations.
pub(super) const MIN_VARIATION_S: f64 = 0.035;

/// Large latency change within the run: steps between constant levels, or piecewise linear.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseLatencyChange {
    /// At the stamps.
    pub latency: PiecewiseLatency,
    /// Time of each step, and by how much the levels overlap there, or leave a gap, s. Empty for a piecewise linear
    /// latency.
    pub steps: Vec<(f64, f64)>,
}

impl CoarseLatencyChange {
    /// Piecewise linear.
    pub fn ramp(latency: PiecewiseLatency) -> Self {
        Self { latency, steps: Vec::new() }
    }

    pub fn has_steps(&self) -> bool {
        !self.steps.is_empty()
    }

    /// Whether a stamp belongs to one level.
    pub fn is_far_from_steps(&self, t_s: f64) -> bool {
        self.steps.iter().all(|(at_s, overlap_s)| (t_s - at_s).abs() > *overlap_s)
    }

    /// Start and lag of each level between steps, s. The first starts at −∞.
    pub fn levels(&self) -> Vec<(f64, f64)> {
        let starts_s = self.steps.iter().map(|step| step.0);
        let starts_s = std::iter::once(f64::NEG_INFINITY).chain(starts_s);
        starts_s.map(|from_s| (from_s, self.latency.at(from_s))).collect()
    }

    /// Lag that remains when the change is removed, s: that of the level with the smallest one.
    pub fn retained_s(&self) -> f64 {
        let lags_s = self.levels().into_iter().map(|level| level.1);
        lowest(lags_s, |lag_s| lag_s.abs()).filter(|_| self.has_steps()).unwrap_or(0.0)
    }

    /// Compensated stamps, each with its row. Drops rows near a step and rows that would be out of order.
    pub fn compensated(&self, t_s: &[f64]) -> Vec<(usize, f64)> {
        let retained_s = self.retained_s();
        let clear = t_s.iter().enumerate().filter(|(_, t_s)| self.is_far_from_steps(**t_s));
        let compensated_s = |t_s: f64| t_s - (self.latency.at(t_s) - retained_s);
        monotonic_rows(clear.map(|(row, t_s)| (row, compensated_s(*t_s))))
    }
}

/// Detects large latency changes of a pose stream.
pub fn detect_pose_latency_changes(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> Option<CoarseLatencyChange> {
    let PoseStream { chain, columns, moving_frame, .. } = *stream;
    let ArmSpeeds { linear, angular, .. } =
        ArmSpeeds::in_frame(joints, chain, columns, moving_frame);
    let in_frame = moving_frame.map(|frame| frame.in_frame(stream.track));
    let track = in_frame.as_ref().unwrap_or(stream.track);
    let mut pairs = vec![(linear, linear_speed(&track.t_s, &track.xyz))];
    let rotations = as_rotations(&track.orientation);
    pairs.extend(rotations.map(|rotations| (angular, angular_speed(&track.t_s, rotations))));
    for (arm, speed) in &mut pairs {
        *speed = without_spikes(arm, std::mem::take(speed));
    }
    detect_changes(&pairs, max_lag_s)
}

/// Removes spikes, which occur where stamps step back and distant positions have close stamps.
fn without_spikes(arm: &SpeedSeries, speed: SpeedSeries) -> SpeedSeries {
    const MAX_QUANTILE_RATIO: f64 = 4.0;
    const SPEED_QUANTILE: f64 = 0.95;
    /// On the ratio of the arm's maximum speed to its quantile.
    const QUANTILE_MARGIN: f64 = 1.3;
    let nearly_all = |speed: &SpeedSeries| quantile(&mut speed.value.clone(), SPEED_QUANTILE);
    let (Some(of_arm), Some(own)) = (nearly_all(arm), nearly_all(&speed)) else { return speed };
    let fastest = arm.value.iter().copied().fold(0.0, f64::max);
    let times = (QUANTILE_MARGIN * fastest / of_arm).min(MAX_QUANTILE_RATIO);
    let max_speed = if times.is_finite() { times * own } else { MAX_QUANTILE_RATIO * own };
    speed.at_rows((0..speed.t_s.len()).filter(|row| speed.value[*row] <= max_speed))
}

/// Same for an IMU, from its angular speed.
pub fn detect_imu_latency_changes(
    joints: &JointTrack,
    stream: &ImuStream,
    max_lag_s: f64,
) -> Option<CoarseLatencyChange> {
    let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
    detect_changes(&[(arm.angular, norm_series(&stream.track.t_s, &stream.track.gyro))], max_lag_s)
}

/// Uses the pair (arm, stream) that correlates best.
fn detect_changes(
    pairs: &[(SpeedSeries, SpeedSeries)],
    max_lag_s: f64,
) -> Option<CoarseLatencyChange> {
    let seen = pairs.iter().map(|(arm, stream)| {
        let speeds = SpeedPair { arm, stream };
        (speeds, lag_windows(speeds, max_lag_s))
    });
    let typical = |windows: &[LagWindow]| {
        median_of(windows.iter().map(|window| window.correlation)).unwrap_or(0.0)
    };
    let (speeds, windows) = highest(seen, |(_, windows)| typical(windows))?;
    let followed: Vec<&LagWindow> =
        windows.iter().filter(|window| window.correlation >= MIN_CORRELATION).collect();
    let is_large = |latency: &PiecewiseLatency| {
        value_range(latency.knots.iter().map(|knot| knot.1)) >= MIN_VARIATION_S
    };
    let steps = detect_steps(speeds, &followed).filter(|steps| is_large(&steps.latency));
    let rows = thinned(0..speeds.stream.t_s.len(), MAX_PROFILE_SAMPLES);
    let speeds = SpeedPair { stream: &speeds.stream.at_rows(rows), ..speeds };
    let Some(RampFit { ramp, residual, line_residual }) =
        PiecewiseLatency::fit_windows(speeds, &followed)
    else {
        return steps;
    };
    let of_steps = |steps: &CoarseLatencyChange| speeds.residual(&|t_s| steps.latency.at(t_s));
    let steps_residual = steps.as_ref().map_or(f64::INFINITY, of_steps);
    // Linear growth is skew, not steps.
    let steps = steps.filter(|_| steps_residual < line_residual);
    let max_residual = MAX_SPEED_RESIDUAL_SHARE * speeds.variation();
    let is_ramp = residual < max_residual.min(MAX_RESIDUAL_RATIO * line_residual);
    match is_ramp && residual <= steps_residual {
        true => Some(CoarseLatencyChange::ramp(ramp)),
        false => steps,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    fn shape(t_s: f64) -> f64 {
        (1.3 * t_s).sin().powi(2) + 0.5 * (0.037 * t_s * t_s).sin().powi(2)
    }

    /// 40 s of speeds of an arm and of a stream with latency `late`.
    pub fn pair(late: impl Fn(f64) -> f64) -> (SpeedSeries, SpeedSeries) {
        let t_s: Vec<f64> = (0..4000).map(|row| f64::from(row) * 0.01).collect();
        let value = t_s.iter().map(|t_s| shape(*t_s)).collect();
        let own = t_s.iter().map(|t_s| shape(t_s - late(*t_s))).collect();
        (SpeedSeries { t_s: t_s.clone(), value }, SpeedSeries { t_s, value: own })
    }

    pub fn changed(late: impl Fn(f64) -> f64) -> Option<CoarseLatencyChange> {
        detect_changes(&[pair(late)], 5.0)
    }

    #[test]
    fn a_century_without_samples_has_no_windows() {
        let (mut arm, stream) = pair(|_| 0.0);
        arm.t_s.push(3e9);
        arm.value.push(0.0);
        let windows = lag_windows(SpeedPair { arm: &arm, stream: &stream }, 5.0);
        assert!((5..20).contains(&windows.len()), "{}", windows.len());
    }

    #[test]
    fn a_constant_or_skewed_latency_has_no_coarse_change() {
        for late_s in [0.0, 0.022, -0.7] {
            assert_eq!(changed(|_| late_s), None);
        }
        for skew in [3e-4, 3e-3, -8e-3] {
            assert_eq!(changed(|t_s| skew * t_s), None, "{skew}");
        }
    }

    #[test]
    fn a_latency_ramp_is_estimated_at_every_time() {
        for (from_s, to_s, size_s) in [(10.0, 25.0, 0.1), (4.0, 36.0, -0.25), (20.0, 26.0, 0.08)] {
            let late =
                |t_s: f64| 0.02 + size_s * ((t_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
            let found = changed(late);
            let ramp = found.filter(|it| !it.has_steps()).expect("it ramps").latency;
            for t_s in (1..39).map(f64::from) {
                let off_s = ramp.at(t_s) - late(t_s);
                assert!(off_s.abs() < 0.1 * size_s.abs(), "{size_s} at {t_s} s: off by {off_s}");
                let straight_s = t_s - ramp.at(t_s);
                assert!((ramp.logged_s(straight_s) - t_s).abs() < 1e-6, "{size_s} at {t_s} s");
            }
        }
    }
}
