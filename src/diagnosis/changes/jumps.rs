//! Jumps of recorded numbers that motion and noise do not explain, and gaps.

use crate::latency::correlation::median_period_s;
use crate::model::jacobian::pose_change;
use crate::priors::LEVER_M;
use crate::residuals::residual_check::align_with_fk;
use crate::{AlignedSamples, PoseStream};
use ground::geometry::Vec3;
use ground::stats::quantile;
use ground::stream::JointTrack;

/// To the usual variation.
const MIN_JUMP_RATIO: f64 = 6.0;
const MAX_CHANGE_POINTS: usize = 8;
/// Relative to the strongest.
const MIN_RELATIVE_STRENGTH: f64 = 0.2;
const MIN_SEPARATION_S: f64 = 0.5;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jump {
    /// Midpoint of the two stamps, from the run's origin.
    pub at_s: f64,
    /// Half their interval.
    pub within_s: f64,
    /// Ratio to the usual variation; infinite for a gap.
    pub strength: f64,
}

impl Jump {
    pub fn overlaps(&self, other: &Self) -> bool {
        (self.at_s - other.at_s).abs() <= self.within_s + other.within_s
    }
}

/// Steps of the logged poses that exceed the mean of the adjacent ones, without FK.
pub(super) fn jumps_in_logged_path(joints: &JointTrack, stream: &PoseStream) -> Vec<Jump> {
    /// Numerical floor.
    const FLOOR_M: f64 = 1e-5;
    let AlignedSamples { t_s, logged: poses, .. } = align_with_fk(joints, stream);
    let step = |row: usize| {
        let [shift, turn] = pose_change(&poses[row - 1], &poses[row]);
        [shift, turn * LEVER_M]
    };
    let steps: Vec<[Vec3; 2]> = (1..poses.len()).map(step).collect();
    let of_kind = |kind: usize| {
        let step = |row: usize| steps[row - 1][kind];
        let deviation = |row: usize| (step(row) - 0.5 * (step(row - 1) + step(row + 1))).norm();
        jumps_in_steps(&t_s, FLOOR_M, deviation)
    };
    [of_kind(0), of_kind(1)].concat()
}

/// Jumps such as a lost zero: steps that exceed the mean of the adjacent ones. Steps across a gap do not
/// count, because the joint may have moved.
pub(super) fn jumps_in_joints(joints: &JointTrack) -> Vec<Jump> {
    /// In rad or m.
    const MIN_JUMP: f64 = 1e-3;
    let gap_s = min_gap_s(&joints.t_s);
    let q = |row: usize, column: usize| joints.row(row)[column];
    let of_joint = |column: usize| {
        let step = |row: usize| q(row, column) - q(row - 1, column);
        let deviation = |row: usize| match joints.t_s[row + 1] - joints.t_s[row - 2] > gap_s {
            true => 0.0,
            false => (step(row) - 0.5 * (step(row - 1) + step(row + 1))).abs(),
        };
        jumps_in_steps(&joints.t_s, MIN_JUMP / MIN_JUMP_RATIO, deviation)
    };
    strongest((0..joints.dof).flat_map(of_joint).collect())
}

/// `deviation` is that of the step to each row from the mean of its neighbours.
fn jumps_in_steps(t_s: &[f64], floor: f64, deviation: impl Fn(usize) -> f64) -> Vec<Jump> {
    const USUAL_QUANTILE: f64 = 0.95;
    let sizes: Vec<f64> = (2..t_s.len().saturating_sub(1)).map(deviation).collect();
    let usual = quantile(&mut sizes.clone(), USUAL_QUANTILE).unwrap_or(0.0) + floor;
    let jump = |(at, size): (usize, f64)| {
        let (before_s, after_s) = (t_s[at + 1], t_s[at + 2]);
        let times = size / usual;
        (times > MIN_JUMP_RATIO).then_some(Jump {
            at_s: 0.5 * (before_s + after_s),
            within_s: 0.5 * (after_s - before_s),
            strength: times,
        })
    };
    sizes.into_iter().enumerate().filter_map(jump).collect()
}

fn min_gap_s(t_s: &[f64]) -> f64 {
    const MIN_GAP_PERIODS: f64 = 10.0;
    const MIN_GAP_S: f64 = 0.3;
    (MIN_GAP_PERIODS * median_period_s(t_s)).max(MIN_GAP_S)
}

/// Anything may change during a gap.
pub(super) fn gaps(t_s: &[f64]) -> Vec<Jump> {
    const MAX_GAPS: usize = 3;
    let min_gap_s = min_gap_s(t_s);
    let intervals = t_s.windows(2).map(|pair| (pair[1] - pair[0], pair[0]));
    let mut gaps: Vec<(f64, f64)> = intervals.filter(|(s, _)| *s > min_gap_s).collect();
    gaps.sort_by(|a, b| b.0.total_cmp(&a.0));
    let jump = |(long_s, from_s): (f64, f64)| Jump {
        at_s: from_s + 0.5 * long_s,
        within_s: 0.5 * long_s,
        strength: f64::INFINITY,
    };
    gaps.into_iter().take(MAX_GAPS).map(jump).collect()
}

/// Jumps in time order, at least [`MIN_SEPARATION_S`] apart.
pub(super) fn strongest(mut jumps: Vec<Jump>) -> Vec<Jump> {
    jumps.sort_by(|a, b| b.strength.total_cmp(&a.strength));
    let largest = jumps.iter().find(|jump| jump.strength.is_finite());
    let min_strength = MIN_RELATIVE_STRENGTH * largest.map_or(0.0, |jump| jump.strength);
    let mut separated: Vec<Jump> = Vec::new();
    for jump in jumps {
        let is_separated =
            separated.iter().all(|other| (other.at_s - jump.at_s).abs() > MIN_SEPARATION_S);
        if is_separated && separated.len() < MAX_CHANGE_POINTS && jump.strength > min_strength {
            separated.push(jump);
        }
    }
    separated.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    separated
}
