//! Which samples of a stream tell, and at which lags.

use super::PoseStream;
use super::latency::{ArmSpeeds, Peak};
use ground::geometry::{Pose, Rotation};
use ground::robot::Chain;
use ground::stats::{NORMAL, median};
use ground::stream::{JointTrack, Orientations, PoseTrack};
use std::ops::Range;

/// Speeds correlate less than this where a stream does not follow the arm.
pub(super) const FOLLOWS: f64 = 0.3;

/// Samples a stream in the search for the explanation, and in the final fit.
pub(super) const SEARCH_SAMPLES: usize = 500;

/// Samples that readings are tried on.
pub(super) const READING_SAMPLES: usize = 72;

/// The rows of a series of `len`; of a longer one `most` of them, in stretches evenly over it.
pub fn stretches(len: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
    const STRETCHES: usize = 24;
    let (count, rows) = if len <= most { (1, len) } else { (STRETCHES, most / STRETCHES) };
    (0..count).map(move |at| at * len / count..at * len / count + rows)
}

pub(super) fn as_rotations(orientation: &Orientations) -> Option<&[Rotation]> {
    match orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) | Orientations::Unset(_) => None,
    }
}

/// The lags at which a stream may follow the arm by its speeds, the likeliest first.
pub(super) fn stream_peaks(arm: &ArmSpeeds, stream: &PoseStream, most_lag_s: f64) -> Vec<Peak> {
    let PoseTrack { t_s, xyz, orientation, .. } = stream.track;
    arm.peaks_of(t_s, xyz, as_rotations(orientation), most_lag_s)
}

/// The lag at which a stream follows the arm best by its speeds, s; 0 where none does.
pub(super) fn stream_lag_s(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> f64 {
    let arm = ArmSpeeds::of(joints, stream.chain, stream.columns);
    let peaks = stream_peaks(&arm, stream, most_lag_s);
    let best = peaks.first().filter(|peak| peak.correlation > FOLLOWS);
    best.map_or(0.0, |peak| peak.lag_s)
}

/// Slow samples spread over the run, and FK at the moments that they speak of.
pub(super) fn slow_samples(
    joints: &JointTrack,
    chain: &Chain,
    columns: &[usize],
    t_s: &[f64],
    lag_s: f64,
) -> (Vec<usize>, Vec<Pose>) {
    /// Samples among which slow ones are sought.
    const ENOUGH: usize = 4000;
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let mut covered: Vec<(usize, f64)> = Vec::new();
    let stride = t_s.len().div_ceil(ENOUGH).max(1);
    for (k, t) in t_s.iter().enumerate().step_by(stride) {
        if joints.at(t - lag_s, &mut cursor, &mut q, &mut qd) {
            covered.push((k, qd.iter().map(|v| v * v).sum()));
        }
    }
    let mut slowest = covered;
    let kept = slowest.len().div_ceil(2);
    slowest.sort_by(|a, b| a.1.total_cmp(&b.1));
    slowest.truncate(kept);
    let mut rows: Vec<usize> = slowest.iter().map(|(k, _)| *k).collect();
    rows.sort_unstable();
    let step = rows.len().div_ceil(READING_SAMPLES).max(1);
    let rows: Vec<usize> = rows.into_iter().step_by(step).collect();
    cursor = 0;
    let fk = rows
        .iter()
        .map(|&k| {
            joints.at(t_s[k] - lag_s, &mut cursor, &mut q, &mut qd);
            let own: Vec<f64> = columns.iter().map(|&c| q[c]).collect();
            chain.forward(&own)
        })
        .collect();
    (rows, fk)
}

/// A joint moves that is faster than so many standard deviations of its velocity's noise.
pub(super) const STILL_SIGMAS: f64 = 5.0;

/// Joint speeds that are no motion: five times the noise of the velocities, at least 0.2 mrad/s.
///
/// Noise by the median magnitude of second differences, which smooth motion hardly has.
pub(super) fn still_speeds(joints: &JointTrack) -> Vec<f64> {
    /// A median of more is no better.
    const ENOUGH: usize = 20_000;
    let stride = joints.len().div_ceil(ENOUGH).max(1);
    let speed = |row: usize, joint: usize| joints.qd[row * joints.dof + joint];
    (0..joints.dof)
        .map(|j| {
            let middles = (1..joints.len().saturating_sub(1)).step_by(stride);
            let mut bends: Vec<f64> = middles
                .map(|k| (speed(k - 1, j) - 2.0 * speed(k, j) + speed(k + 1, j)).abs())
                .collect();
            let Some(median) = median(&mut bends) else { return f64::INFINITY };
            (STILL_SIGMAS * NORMAL * median / 6f64.sqrt()).max(2e-4)
        })
        .collect()
}
