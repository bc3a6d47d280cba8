//! Moments at which a stream jumps against the arm: from one sample to the next by more than the arm's
//! motion and the noise make.

use crate::latency::median_period_s;
use crate::proof::beside_fk;
use crate::{Aligned, PoseStream};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::{median, quantile};
use ground::stream::JointTrack;

/// Samples on either side of a moment whose means are compared: one where a jump is large, more where
/// it hides in the noise.
const SIDES: [usize; 3] = [1, 5, 25];
/// A jump is so many times what the motion makes there.
const TIMES: f64 = 6.0;
/// Jumps that are followed up.
const MOST: usize = 8;
/// A jump that is beside a larger one counts from this share of it on.
const LEAST: f64 = 0.2;
/// A jump that shows over fewer samples as well, by this share, is dated by them.
const FINER: f64 = 0.3;
/// Jumps closer together are one, s.
const APART_S: f64 = 0.5;
/// Distance from the tip of the points that show how it turns, m.
const ARM_M: f64 = 0.3;

/// A moment between two samples of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jump {
    /// The middle of the two stamps, s from the run's origin.
    pub at_s: f64,
    /// Half the time between them, s.
    pub within_s: f64,
    /// How many times what the motion makes there; infinite of a gap.
    pub times: f64,
    /// The time on either side over whose mean it was seen, s.
    pub over_s: f64,
}

/// The moments at which a stream most likely jumps: by what `aligned` leaves of it, and straight from
/// FK at `lag_s`.
pub(super) fn jumps(
    joints: &JointTrack,
    stream: &PoseStream,
    aligned: &Aligned,
    lag_s: f64,
) -> Vec<Jump> {
    let left = aligned.corrected.iter().zip(&aligned.fk_at_truth);
    let in_base = |(is, fk): (&Pose, &Pose)| {
        let turn = rotvec_from_rotation(&(is.rotation * fk.rotation.inverse()));
        [is.translation.vector - fk.translation.vector, turn * ARM_M]
    };
    let left: Vec<[Vec3; 2]> = left.map(in_base).collect();
    let mut found = of_series(&aligned.t_s, &left, &aligned.fk_at_truth);
    let raw = beside_fk(joints, stream, lag_s);
    let turn = |pose: &Pose| [pose.rotation * Vec3::x(), pose.rotation * Vec3::y()];
    let in_tool: Vec<Pose> =
        raw.fk.iter().zip(&raw.logged).map(|(fk, logged)| fk.inv_mul(logged)).collect();
    let at: Vec<[Vec3; 2]> =
        in_tool.iter().map(|pose| [pose.translation.vector, Vec3::zeros()]).collect();
    let turned: Vec<[Vec3; 2]> =
        in_tool.iter().map(|pose| turn(pose).map(|axis| axis * ARM_M)).collect();
    found.extend(of_series(&raw.t_s, &at, &raw.fk));
    found.extend(of_series(&raw.t_s, &turned, &raw.fk));
    found.extend(of_path(&raw.t_s, &raw.logged));
    found.extend(gaps(&stream.track.t_s));
    strongest(found)
}

/// The jumps of a path by itself, whatever the arm does: from one sample to the next by more than from those
/// before and to those after.
fn of_path(t_s: &[f64], poses: &[Pose]) -> Vec<Jump> {
    /// Below this a step is arithmetic, m.
    const FLOOR_M: f64 = 1e-5;
    let step = |row: usize| -> [Vec3; 2] {
        let (a, b) = (&poses[row - 1], &poses[row]);
        let turn = rotvec_from_rotation(&(b.rotation * a.rotation.inverse()));
        [b.translation.vector - a.translation.vector, turn * ARM_M]
    };
    let steps: Vec<[Vec3; 2]> = (1..poses.len()).map(step).collect();
    let of_kind = |kind: usize| {
        let beside = |at: usize| {
            (steps[at][kind] - 0.5 * (steps[at - 1][kind] + steps[at + 1][kind])).norm()
        };
        let sizes = (1..steps.len().saturating_sub(1)).map(beside).collect();
        of_sizes(t_s, sizes, FLOOR_M)
    };
    [of_kind(0), of_kind(1)].concat()
}

/// The jumps of the joint states by themselves, as where a zero is lost: of each joint from one sample to the
/// next by more than from those before and to those after. Over a gap, as between two excerpts, it may have moved.
pub(super) fn of_joints(joints: &JointTrack) -> Vec<Jump> {
    /// Less is no change that matters, rad or m.
    const LEAST: f64 = 1e-3;
    let rows = joints.len();
    let gap_s = least_gap_s(&joints.t_s);
    let q = |row: usize, column: usize| joints.q[row * joints.dof + column];
    let of_joint = |column: usize| {
        let step = |row: usize| q(row, column) - q(row - 1, column);
        let beside = |row: usize| match joints.t_s[row + 1] - joints.t_s[row - 2] > gap_s {
            true => 0.0,
            false => (step(row) - 0.5 * (step(row - 1) + step(row + 1))).abs(),
        };
        let sizes: Vec<f64> = (2..rows.saturating_sub(1)).map(beside).collect();
        of_sizes(&joints.t_s, sizes, LEAST / TIMES)
    };
    strongest((0..joints.dof).flat_map(of_joint).collect())
}

/// The jumps of what differs by so much from the line through its neighbours, from the second step on. Below
/// `floor` a difference is none.
fn of_sizes(t_s: &[f64], sizes: Vec<f64>, floor: f64) -> Vec<Jump> {
    /// What nearly all samples are beside the line through their neighbours.
    const NEARLY_ALL: f64 = 0.95;
    let usual = quantile(&mut sizes.clone(), NEARLY_ALL).unwrap_or(0.0) + floor;
    let jump = |(at, size): (usize, f64)| {
        let (before_s, after_s) = (t_s[at + 1], t_s[at + 2]);
        let times = size / usual;
        (times > TIMES).then_some(Jump {
            at_s: 0.5 * (before_s + after_s),
            within_s: 0.5 * (after_s - before_s),
            times,
            over_s: 0.0,
        })
    };
    sizes.into_iter().enumerate().filter_map(jump).collect()
}

/// Stamps further apart have a gap between them, s.
fn least_gap_s(t_s: &[f64]) -> f64 {
    /// A gap is so many periods, …
    const PERIODS: f64 = 10.0;
    /// … and so long, s.
    const LONG_S: f64 = 0.3;
    (PERIODS * median_period_s(t_s)).max(LONG_S)
}

/// The longest gaps of a stream, in which anything may happen.
fn gaps(t_s: &[f64]) -> Vec<Jump> {
    const FOLLOWED: usize = 3;
    let least_s = least_gap_s(t_s);
    let mut gaps: Vec<(f64, f64)> = t_s
        .windows(2)
        .map(|pair| (pair[1] - pair[0], pair[0]))
        .filter(|(s, _)| *s > least_s)
        .collect();
    gaps.sort_by(|a, b| b.0.total_cmp(&a.0));
    let jump = |(long_s, from_s): (f64, f64)| Jump {
        at_s: from_s + 0.5 * long_s,
        within_s: 0.5 * long_s,
        times: f64::INFINITY,
        over_s: 0.0,
    };
    gaps.into_iter().take(FOLLOWED).map(jump).collect()
}

/// The strongest jumps, no two of them close together, in the order of time.
pub(super) fn strongest(found: Vec<Jump>) -> Vec<Jump> {
    // The finer of two says when.
    let finer = |jump: &Jump| {
        found.iter().any(|other| {
            other.over_s < jump.over_s
                && (other.at_s - jump.at_s).abs() <= jump.over_s
                && other.times > FINER * jump.times
        })
    };
    let mut found: Vec<Jump> = found.iter().filter(|jump| !finer(jump)).copied().collect();
    found.sort_by(|a, b| b.times.total_cmp(&a.times));
    let largest = found.iter().find(|jump| jump.times.is_finite());
    let least = LEAST * largest.map_or(0.0, |jump| jump.times);
    let mut kept: Vec<Jump> = Vec::new();
    for jump in found {
        let is_apart = kept.iter().all(|other| (other.at_s - jump.at_s).abs() > APART_S);
        if is_apart && kept.len() < MOST && jump.times > least {
            kept.push(jump);
        }
    }
    kept.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    kept
}

fn of_series(t_s: &[f64], series: &[[Vec3; 2]], fk: &[Pose]) -> Vec<Jump> {
    SIDES.into_iter().flat_map(|side| of_sides(t_s, series, fk, side)).collect()
}

/// The jumps between means over `side` samples.
fn of_sides(t_s: &[f64], series: &[[Vec3; 2]], fk: &[Pose], side: usize) -> Vec<Jump> {
    let n = series.len();
    if n < 4 * side + 20 {
        return Vec::new();
    }
    let mut sums = vec![[Vec3::zeros(); 2]; n + 1];
    for (row, value) in series.iter().enumerate() {
        sums[row + 1] = std::array::from_fn(|kind| sums[row][kind] + value[kind]);
    }
    let mean = |from: usize, to: usize| -> [Vec3; 2] {
        std::array::from_fn(|kind| (sums[to][kind] - sums[from][kind]) / (to - from) as f64)
    };
    let apart = |a: [Vec3; 2], b: [Vec3; 2]| {
        a.iter().zip(&b).map(|(a, b)| (a - b).norm_squared()).sum::<f64>().sqrt()
    };
    // Between the samples `row - 1` and `row`.
    let rows: Vec<usize> = (side..=n - side).filter(|row| *row < n).collect();
    let step = |row: usize| apart(mean(row - side, row), mean(row, row + side));
    let steps: Vec<f64> = rows.iter().map(|&row| step(row)).collect();
    let moved = |row: usize| {
        let (a, b) = (&fk[row - side], &fk[row + side - 1]);
        let turn = rotvec_from_rotation(&(a.rotation * b.rotation.inverse())) * ARM_M;
        (a.translation.vector - b.translation.vector).norm() + turn.norm()
    };
    let moves: Vec<f64> = rows.iter().map(|&row| moved(row)).collect();
    let Some(usual) = median(&mut moves.clone()) else { return Vec::new() };
    let still = steps.iter().zip(&moves).filter(|(_, moved)| **moved <= usual);
    let mut still: Vec<f64> = still.map(|(step, _)| *step).collect();
    let fast = steps.iter().zip(&moves).filter(|(_, moved)| **moved > usual.max(1e-9));
    let mut slopes: Vec<f64> = fast.map(|(step, moved)| step / moved).collect();
    let (Some(still), slope) = (median(&mut still), median(&mut slopes).unwrap_or(0.0)) else {
        return Vec::new();
    };
    // Below this a step is arithmetic, m.
    const FLOOR_M: f64 = 1e-5;
    let jump = |(index, &row): (usize, &usize)| {
        let usual = still + slope * moves[index] + FLOOR_M;
        if steps[index] <= TIMES * usual {
            return None;
        }
        // A residual that varies fast does so before and after as well.
        let before = (2..=6).filter_map(|by| steps.get(index.checked_sub(by * side)?).copied());
        let after = (2..=6).filter_map(|by| steps.get(index + by * side).copied());
        let [before, after] = [before.collect(), after.collect()]
            .map(|mut beside: Vec<f64>| median(&mut beside).unwrap_or(0.0));
        let usual = usual.max(before.min(after));
        let times = steps[index] / usual;
        (times > TIMES).then(|| Jump {
            at_s: 0.5 * (t_s[row - 1] + t_s[row]),
            within_s: 0.5 * (t_s[row] - t_s[row - 1]),
            times,
            over_s: t_s[row + side - 1] - t_s[row],
        })
    };
    rows.iter().enumerate().filter_map(jump).collect()
}
