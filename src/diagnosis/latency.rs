//! Coarse latency: the lags at which a stream's speed follows the arm's.
//!
//! Speed is the one thing about a pose stream that survives a turned reference frame, and its
//! correlation with FK's says how late the stream is before anything else is known. It is coarse by
//! design: a tool offset or a wrong convention biases it by milliseconds, so the model refines it.

use crate::geometry::{Rotation, Vec3, angle_between};
use crate::robot::Chain;
use crate::stream::JointTrack;

/// A lag with the correlation of speeds there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Latency of the stream, s; positive where the stream is late.
    pub lag_s: f64,
    /// Pearson correlation of the two speeds over the common span, −1 to 1.
    pub correlation: f64,
}

/// A speed over time, on its own stamps.
#[derive(Clone, Debug, Default)]
pub(super) struct Speed {
    pub t_s: Vec<f64>,
    pub value: Vec<f64>,
}

/// Linear (m/s) and angular (rad/s) speed of the chain's tip by FK, at the joint stamps.
pub(super) fn arm_speeds(joints: &JointTrack, chain: &Chain, columns: &[usize]) -> (Speed, Speed) {
    let mut jacobian = vec![[0.0; 6]; columns.len()];
    let mut q = vec![0.0; columns.len()];
    let (mut linear, mut angular) = (Vec::new(), Vec::new());
    for row in 0..joints.len() {
        for (own, &column) in q.iter_mut().zip(columns) {
            *own = joints.row(row)[column];
        }
        chain.forward_with_jacobian(&q, &mut jacobian);
        let mut twist = [0.0; 6];
        for (column, &track) in jacobian.iter().zip(columns) {
            let rate = joints.qd[row * joints.dof + track];
            for (sum, part) in twist.iter_mut().zip(column) {
                *sum += part * rate;
            }
        }
        linear.push(Vec3::new(twist[0], twist[1], twist[2]).norm());
        angular.push(Vec3::new(twist[3], twist[4], twist[5]).norm());
    }
    let on_stamps = |value| Speed { t_s: joints.t_s.clone(), value };
    (on_stamps(linear), on_stamps(angular))
}

/// Speed of all joints together (root of the sum of squares), at the joint stamps: what any
/// mix-up of joint names leaves as it is.
pub(super) fn joint_activity(joints: &JointTrack) -> Speed {
    let value = joints
        .qd
        .chunks_exact(joints.dof.max(1))
        .map(|row| row.iter().map(|v| v * v).sum::<f64>().sqrt())
        .collect();
    Speed { t_s: joints.t_s.clone(), value }
}

/// Speed of a stream between samples `window_s` apart, by `distance` of two samples.
fn differenced(t_s: &[f64], window_s: f64, distance: impl Fn(usize, usize) -> f64) -> Speed {
    let mut speed = Speed::default();
    let mut first = 0;
    for last in 0..t_s.len() {
        while first + 1 < last && t_s[last] - t_s[first + 1] >= window_s {
            first += 1;
        }
        let span = t_s[last] - t_s[first];
        if span >= window_s && span < 4.0 * window_s {
            speed.t_s.push(0.5 * (t_s[last] + t_s[first]));
            speed.value.push(distance(first, last) / span);
        }
    }
    speed
}

/// Time over which a stream's speed is taken, s: long against its noise, short against a motion.
fn window_s(t_s: &[f64]) -> f64 {
    (2.5 * median_period_s(t_s)).clamp(0.02, 0.2)
}

/// The median time between samples, s.
pub(super) fn median_period_s(t_s: &[f64]) -> f64 {
    let mut periods: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).collect();
    if periods.is_empty() {
        return 0.0;
    }
    let middle = periods.len() / 2;
    *periods.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Speed of logged positions, in the positions' unit per second.
pub(super) fn linear_speed(t_s: &[f64], xyz: &[Vec3]) -> Speed {
    differenced(t_s, window_s(t_s), |a, b| (xyz[b] - xyz[a]).norm())
}

/// Speed of the origin of the *inverse* of logged poses, m/s.
pub(super) fn inverse_linear_speed(t_s: &[f64], xyz: &[Vec3], rotation: &[Rotation]) -> Speed {
    let inverse = |k: usize| rotation[k].inverse() * xyz[k];
    differenced(t_s, window_s(t_s), |a, b| (inverse(b) - inverse(a)).norm())
}

/// Speed of logged rotations, rad/s.
pub(super) fn angular_speed(t_s: &[f64], rotation: &[Rotation]) -> Speed {
    differenced(t_s, window_s(t_s), |a, b| angle_between(&rotation[a], &rotation[b]))
}

/// Norms of a vector series, such as an IMU's angular rates.
pub(super) fn norms(t_s: &[f64], vectors: &[Vec3]) -> Speed {
    Speed { t_s: t_s.to_vec(), value: vectors.iter().map(Vec3::norm).collect() }
}

/// The lags within ±`most_s` at which `stream` follows `arm`, best first; empty without motion or
/// without a common span.
pub(super) fn peaks(arm: &Speed, stream: &Speed, most_s: f64) -> Vec<Peak> {
    let (Some(&arm_end), Some(&stream_end)) = (arm.t_s.last(), stream.t_s.last()) else {
        return Vec::new();
    };
    let (arm_start, stream_start) = (arm.t_s[0], stream.t_s[0]);
    let span = arm_end - arm_start;
    let step = median_period_s(&stream.t_s).max(median_period_s(&arm.t_s)).clamp(0.004, 0.02);
    let step = step.max(span / 12_000.0);
    if span < 20.0 * step {
        return Vec::new();
    }
    // The stream's grid may run outside the arm's span: a late stream does.
    let most_s = most_s.min(span / 3.0);
    let lags = (most_s / step).floor() as isize;
    let arm = gridded(arm, arm_start, step, (span / step) as usize + 1);
    let offset = ((stream_start - arm_start) / step).round() as isize;
    let stream_count = ((stream_end - stream_start) / step) as usize + 1;
    let stream = gridded(stream, arm_start + offset as f64 * step, step, stream_count);
    let correlations: Vec<f64> =
        (-lags..=lags).map(|lag| correlation(&arm, &stream, lag - offset)).collect();
    let mut peaks: Vec<Peak> = (1..correlations.len().saturating_sub(1))
        .filter(|&i| {
            let c = &correlations[i - 1..=i + 1];
            c[1].is_finite() && c[1] >= c[0] && c[1] > c[2]
        })
        .map(|i| {
            let (a, b, c) = (correlations[i - 1], correlations[i], correlations[i + 1]);
            let bend = a - 2.0 * b + c;
            let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
            Peak { lag_s: (i as f64 + shift - lags as f64) * step, correlation: b }
        })
        .collect();
    peaks.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    peaks
}

/// A speed sampled every `step` from `start` by linear interpolation.
fn gridded(speed: &Speed, start: f64, step: f64, count: usize) -> Vec<f64> {
    let mut right = 0;
    (0..count)
        .map(|i| {
            let t = start + i as f64 * step;
            while right < speed.t_s.len() && speed.t_s[right] < t {
                right += 1;
            }
            match (right.checked_sub(1), speed.t_s.get(right)) {
                (None, _) => speed.value[0],
                (Some(left), None) => speed.value[left],
                (Some(left), Some(&after)) => {
                    let share = (t - speed.t_s[left]) / (after - speed.t_s[left]);
                    speed.value[left] + share * (speed.value[right] - speed.value[left])
                }
            }
        })
        .collect()
}

/// Pearson correlation of `arm[i]` and `stream[i + lag]` over all common `i`; NaN where one is
/// constant or fewer than a third of the samples are common.
fn correlation(arm: &[f64], stream: &[f64], lag: isize) -> f64 {
    let first = (-lag).max(0) as usize;
    let last = arm.len().min((stream.len() as isize - lag).max(0) as usize);
    if last <= first || (last - first) * 3 < arm.len().min(stream.len()) {
        return f64::NAN;
    }
    let n = (last - first) as f64;
    let (mut sx, mut sy, mut sxx, mut syy, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in first..last {
        let (x, y) = (arm[i], stream[(i as isize + lag) as usize]);
        sx += x;
        sy += y;
        sxx += x * x;
        syy += y * y;
        sxy += x * y;
    }
    let (vx, vy) = (sxx - sx * sx / n, syy - sy * sy / n);
    if vx <= 1e-12 * sxx || vy <= 1e-12 * syy {
        f64::NAN
    } else {
        (sxy - sx * sy / n) / (vx * vy).sqrt()
    }
}

/// The best peak of the linear and angular speeds of a pose stream, against those by FK.
pub(super) fn pose_peaks(
    joints: &JointTrack,
    chain: &Chain,
    columns: &[usize],
    t_s: &[f64],
    xyz: &[Vec3],
    rotation: Option<&[Rotation]>,
    most_s: f64,
) -> Vec<Peak> {
    let (arm_linear, arm_angular) = arm_speeds(joints, chain, columns);
    let mut found = vec![peaks(&arm_linear, &linear_speed(t_s, xyz), most_s)];
    if let Some(rotation) = rotation {
        found.push(peaks(&arm_angular, &angular_speed(t_s, rotation), most_s));
        found.push(peaks(&arm_linear, &inverse_linear_speed(t_s, xyz, rotation), most_s));
    }
    let best = |peaks: &Vec<Peak>| peaks.first().map_or(f64::MIN, |peak| peak.correlation);
    found.into_iter().max_by(|a, b| best(a).total_cmp(&best(b))).unwrap_or_default()
}

/// Speed of the tip at its fastest, m/s.
pub(super) fn top(speed: &Speed) -> f64 {
    speed.value.iter().copied().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bumps(offset_s: f64, from: f64, to: f64, rate: f64) -> Speed {
        let shape = |t: f64| (1.3 * t).sin().powi(2) + 0.5 * (0.37 * t * t).sin().powi(2);
        let t_s: Vec<f64> =
            (0..((to - from) * rate) as usize).map(|i| from + i as f64 / rate).collect();
        let value = t_s.iter().map(|t| shape(t - offset_s)).collect();
        Speed { t_s, value }
    }

    #[test]
    fn a_planted_lag_is_found_to_a_fraction_of_a_sample() {
        for lag in [-0.4, -0.015, 0.0, 0.0221, 0.9] {
            let found = peaks(&bumps(0.0, 0.0, 10.0, 125.0), &bumps(lag, 0.31, 9.7, 90.0), 2.0);
            assert!((found[0].lag_s - lag).abs() < 2e-3, "{lag}: {:?}", found[0]);
        }
    }

    #[test]
    fn a_constant_speed_has_no_peak() {
        let still =
            Speed { t_s: (0..1000).map(|i| i as f64 * 0.01).collect(), value: vec![0.3; 1000] };
        assert!(peaks(&still, &bumps(0.0, 0.0, 10.0, 100.0), 1.0).is_empty());
    }
}
