//! Selects samples of a stream.

use crate::distinct::by_score;
use crate::{EstimateResult, NotObservable, PoseStream};
use ground::geometry::{Pose, Rotation, interpolate};
use ground::robot::Chain;
use ground::stats::thin::thinned;
use ground::stats::{STD_DEV_PER_MEDIAN, median};
use ground::stream::{JointSequence, JointTrack, Orientations};
use std::ops::Range;

/// Per stream, in the search for causes.
pub(crate) const MAX_SEARCH_SAMPLES: usize = 500;

pub(crate) const ENCODING_SAMPLES: usize = 72;

/// # Errors
/// If there are too few samples.
pub(crate) fn check_sample_count(have: usize, need: usize) -> EstimateResult<()> {
    if have < need { Err(NotObservable::TooFewSamples { have, need }) } else { Ok(()) }
}

/// Rows of the first or second half (0 or 1) of a series, thinned to about `max_rows`. Blocks alternate between the
/// halves, so each contains all kinds of motion.
pub(crate) fn rows_of_half(len: usize, half: usize, max_rows: usize) -> Vec<usize> {
    const BLOCKS: usize = 10;
    let block = len.div_ceil(BLOCKS).max(1);
    thinned(0..len, 2 * max_rows).filter(|row| (row / block) % 2 == half).collect()
}

/// Row ranges of a series, thinned to about `max_rows` rows in even stretches.
pub fn row_blocks(len: usize, max_rows: usize) -> impl Iterator<Item = Range<usize>> {
    const BLOCKS: usize = 24;
    let (count, rows) = if len <= max_rows { (1, len) } else { (BLOCKS, max_rows / BLOCKS) };
    (0..count).map(move |at| at * len / count..at * len / count + rows)
}

/// Rows with stamps from the first time on and before the second.
pub(crate) fn rows_within(t_s: &[f64], from_s: f64, to_s: f64) -> Range<usize> {
    let [from, to] = [from_s, to_s].map(|at_s| t_s.partition_point(|t_s| *t_s < at_s));
    from..to
}

/// Lowest and highest value; `[∞, −∞]` without values.
pub fn range_of(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    let none = [f64::INFINITY, f64::NEG_INFINITY];
    values.into_iter().fold(none, |[low, high], value| [low.min(value), high.max(value)])
}

/// Highest minus lowest value; −∞ without values.
pub fn value_range(values: impl IntoIterator<Item = f64>) -> f64 {
    let [low, high] = range_of(values);
    high - low
}

/// Drops rows whose compensated stamps precede an earlier one.
pub fn monotonic_rows(compensated_s: impl Iterator<Item = (usize, f64)>) -> Vec<(usize, f64)> {
    let mut retained: Vec<(usize, f64)> = Vec::with_capacity(compensated_s.size_hint().0);
    for (row, t_s) in compensated_s {
        if retained.last().is_none_or(|(_, before_s)| t_s > *before_s) {
            retained.push((row, t_s));
        }
    }
    retained
}

pub(crate) fn as_rotations(orientation: &Orientations) -> Option<&[Rotation]> {
    match orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) | Orientations::Unset(_) => None,
    }
}

/// Pose at a time between strictly increasing `t_s`, interpolated. `None` outside them and in gaps longer than `max_gap_s`.
pub(crate) fn pose_between(t_s: &[f64], poses: &[Pose], at_s: f64, max_gap_s: f64) -> Option<Pose> {
    let right = t_s.partition_point(|&t| t < at_s);
    let (&after_s, after) = (t_s.get(right)?, poses.get(right)?);
    if after_s == at_s {
        return Some(*after);
    }
    let left = right.checked_sub(1)?;
    let gap_s = after_s - t_s[left];
    (gap_s <= max_gap_s).then(|| interpolate(&poses[left], after, (at_s - t_s[left]) / gap_s))
}

/// FK of an arm at times, fastest if these ascend.
pub(crate) struct FkSequence<'a> {
    joints: JointSequence<'a>,
    chain: &'a Chain,
    columns: &'a [usize],
    q: Vec<f64>,
}

impl<'a> FkSequence<'a> {
    pub fn new(joints: &'a JointTrack, chain: &'a Chain, columns: &'a [usize]) -> Self {
        Self { joints: joints.sequence(), chain, columns, q: vec![0.0; columns.len()] }
    }

    /// `None` if joint states do not cover the time.
    pub fn at(&mut self, t_s: f64) -> Option<Pose> {
        let (row, _) = self.joints.at(t_s)?;
        for (q, &column) in self.q.iter_mut().zip(self.columns) {
            *q = row[column];
        }
        Some(self.chain.forward(&self.q))
    }
}

/// Slow samples of a stream over the run, with FK.
pub(crate) fn slow_samples(
    joints: &JointTrack,
    stream: &PoseStream,
    lag_s: f64,
) -> (Vec<usize>, Vec<Pose>) {
    /// The slow half of these is used.
    const MAX_SAMPLES: usize = 4000;
    let t_s = &stream.track.t_s;
    let mut sequence = joints.sequence();
    let covered = thinned(t_s.iter().enumerate(), MAX_SAMPLES).filter_map(|(k, t)| {
        let (_, qd) = sequence.at(t - lag_s)?;
        Some((qd.iter().map(|v| v * v).sum(), k))
    });
    let covered: Vec<(f64, usize)> = covered.collect();
    let slow = covered.len().div_ceil(2);
    let mut rows: Vec<usize> = by_score(covered).take(slow).collect();
    rows.sort_unstable();
    let rows: Vec<usize> = thinned(rows, ENCODING_SAMPLES).collect();
    let mut fk = FkSequence::new(joints, stream.chain, stream.columns);
    let fk = rows.iter().filter_map(|&k| fk.at(t_s[k] - lag_s)).collect();
    (rows, fk)
}

/// Multiple of the velocity noise for a moving joint.
pub(crate) const REST_SIGMAS: f64 = 5.0;

/// Speed below which each joint rests: five times the velocity noise, at least 0.2 mrad/s. Median second
/// differences remove smooth motion.
pub(crate) fn rest_speeds(joints: &JointTrack) -> Vec<f64> {
    const MAX_SAMPLES: usize = 20_000;
    let stride = joints.len().div_ceil(MAX_SAMPLES).max(1);
    let speed = |row: usize, joint: usize| joints.velocities(row)[joint];
    (0..joints.dof)
        .map(|j| {
            let middles = (1..joints.len().saturating_sub(1)).step_by(stride);
            let mut second_differences: Vec<f64> = middles
                .map(|k| (speed(k - 1, j) - 2.0 * speed(k, j) + speed(k + 1, j)).abs())
                .collect();
            let Some(median) = median(&mut second_differences) else { return f64::INFINITY };
            (REST_SIGMAS * STD_DEV_PER_MEDIAN * median / 6f64.sqrt()).max(2e-4)
        })
        .collect()
}
