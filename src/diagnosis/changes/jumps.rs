//! Detects change points: jumps of a stream relative to the arm that motion and noise do not explain.

use crate::latency::correlation::median_period_s;
use crate::residuals::residual_check::align_with_fk;
use crate::{AlignedSamples, PoseStream};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::{median, quantile};
use ground::stream::JointTrack;

/// On either side, in samples. A jump within the noise needs more than one.
const WINDOW_SAMPLES: [usize; 3] = [1, 5, 25];
/// To the variation that the motion explains.
const MIN_JUMP_RATIO: f64 = 6.0;
const MAX_CHANGE_POINTS: usize = 8;
/// Relative to the strongest.
const MIN_RELATIVE_STRENGTH: f64 = 0.2;
/// Share of the longer window's strength; the shorter window then dates the jump.
const MIN_SHORT_WINDOW_STRENGTH: f64 = 0.3;
const MIN_SEPARATION_S: f64 = 0.5;
/// Converts rotations to lengths.
const LEVER_M: f64 = 0.3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jump {
    /// Midpoint of the two stamps, from the run's origin.
    pub at_s: f64,
    /// Half their interval.
    pub within_s: f64,
    /// Ratio to the explained variation; infinite for a gap.
    pub strength: f64,
    /// Averaging window on either side.
    pub window_s: f64,
}

/// Uses the residual in `aligned` and the raw error against FK at `lag_s`.
pub(super) fn detect_jumps(
    joints: &JointTrack,
    stream: &PoseStream,
    aligned: &AlignedSamples,
    lag_s: f64,
) -> Vec<Jump> {
    let pairs = aligned.corrected.iter().zip(&aligned.fk_at_truth);
    let in_base = |(is, fk): (&Pose, &Pose)| {
        let rotation = rotvec_from_rotation(&(is.rotation * fk.rotation.inverse()));
        [is.translation.vector - fk.translation.vector, rotation * LEVER_M]
    };
    let pairs: Vec<[Vec3; 2]> = pairs.map(in_base).collect();
    let mut jumps = jumps_in_series(&aligned.t_s, &pairs, &aligned.fk_at_truth);
    let raw = align_with_fk(joints, stream, lag_s);
    let rotation = |pose: &Pose| [pose.rotation * Vec3::x(), pose.rotation * Vec3::y()];
    let in_tool: Vec<Pose> =
        raw.fk.iter().zip(&raw.logged).map(|(fk, logged)| fk.inv_mul(logged)).collect();
    let at: Vec<[Vec3; 2]> =
        in_tool.iter().map(|pose| [pose.translation.vector, Vec3::zeros()]).collect();
    let turned: Vec<[Vec3; 2]> =
        in_tool.iter().map(|pose| rotation(pose).map(|axis| axis * LEVER_M)).collect();
    jumps.extend(jumps_in_series(&raw.t_s, &at, &raw.fk));
    jumps.extend(jumps_in_series(&raw.t_s, &turned, &raw.fk));
    jumps.extend(jumps_in_path(&raw.t_s, &raw.logged));
    jumps.extend(gaps(&stream.track.t_s));
    strongest(jumps)
}

/// [`jumps_in_path`] of the logged poses.
pub(super) fn jumps_in_logged_path(joints: &JointTrack, stream: &PoseStream) -> Vec<Jump> {
    let logged = align_with_fk(joints, stream, 0.0);
    jumps_in_path(&logged.t_s, &logged.logged)
}

/// Detects steps that exceed the mean of the adjacent ones, without FK.
fn jumps_in_path(t_s: &[f64], poses: &[Pose]) -> Vec<Jump> {
    /// Numerical floor.
    const FLOOR_M: f64 = 1e-5;
    let step = |row: usize| -> [Vec3; 2] {
        let (a, b) = (&poses[row - 1], &poses[row]);
        let rotation = rotvec_from_rotation(&(b.rotation * a.rotation.inverse()));
        [b.translation.vector - a.translation.vector, rotation * LEVER_M]
    };
    let steps: Vec<[Vec3; 2]> = (1..poses.len()).map(step).collect();
    let of_kind = |kind: usize| {
        let deviation_from_neighbours = |at: usize| {
            (steps[at][kind] - 0.5 * (steps[at - 1][kind] + steps[at + 1][kind])).norm()
        };
        let sizes = (1..steps.len().saturating_sub(1)).map(deviation_from_neighbours).collect();
        jumps_in_differences(t_s, sizes, FLOOR_M)
    };
    [of_kind(0), of_kind(1)].concat()
}

/// Jumps such as a lost zero: steps that exceed the mean of the adjacent ones. Steps across a gap do not
/// count, because the joint may have moved.
pub(super) fn jumps_in_joints(joints: &JointTrack) -> Vec<Jump> {
    /// In rad or m.
    const MIN_JUMP: f64 = 1e-3;
    let rows = joints.len();
    let gap_s = min_gap_s(&joints.t_s);
    let q = |row: usize, column: usize| joints.q[row * joints.dof + column];
    let of_joint = |column: usize| {
        let step = |row: usize| q(row, column) - q(row - 1, column);
        let deviation_from_neighbours =
            |row: usize| match joints.t_s[row + 1] - joints.t_s[row - 2] > gap_s {
                true => 0.0,
                false => (step(row) - 0.5 * (step(row - 1) + step(row + 1))).abs(),
            };
        let sizes: Vec<f64> = (2..rows.saturating_sub(1)).map(deviation_from_neighbours).collect();
        jumps_in_differences(&joints.t_s, sizes, MIN_JUMP / MIN_JUMP_RATIO)
    };
    strongest((0..joints.dof).flat_map(of_joint).collect())
}

/// `sizes` are differences between each step and the mean of its neighbours, from the second step on.
fn jumps_in_differences(t_s: &[f64], sizes: Vec<f64>, floor: f64) -> Vec<Jump> {
    const USUAL_QUANTILE: f64 = 0.95;
    let usual = quantile(&mut sizes.clone(), USUAL_QUANTILE).unwrap_or(0.0) + floor;
    let jump = |(at, size): (usize, f64)| {
        let (before_s, after_s) = (t_s[at + 1], t_s[at + 2]);
        let times = size / usual;
        (times > MIN_JUMP_RATIO).then_some(Jump {
            at_s: 0.5 * (before_s + after_s),
            within_s: 0.5 * (after_s - before_s),
            strength: times,
            window_s: 0.0,
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
    let mut gaps: Vec<(f64, f64)> = t_s
        .windows(2)
        .map(|pair| (pair[1] - pair[0], pair[0]))
        .filter(|(s, _)| *s > min_gap_s)
        .collect();
    gaps.sort_by(|a, b| b.0.total_cmp(&a.0));
    let jump = |(long_s, from_s): (f64, f64)| Jump {
        at_s: from_s + 0.5 * long_s,
        within_s: 0.5 * long_s,
        strength: f64::INFINITY,
        window_s: 0.0,
    };
    gaps.into_iter().take(MAX_GAPS).map(jump).collect()
}

/// Jumps in time order, at least [`MIN_SEPARATION_S`] apart.
pub(super) fn strongest(jumps: Vec<Jump>) -> Vec<Jump> {
    let finer = |jump: &Jump| {
        jumps.iter().any(|other| {
            other.window_s < jump.window_s
                && (other.at_s - jump.at_s).abs() <= jump.window_s
                && other.strength > MIN_SHORT_WINDOW_STRENGTH * jump.strength
        })
    };
    let mut jumps: Vec<Jump> = jumps.iter().filter(|jump| !finer(jump)).copied().collect();
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

fn jumps_in_series(t_s: &[f64], series: &[[Vec3; 2]], fk: &[Pose]) -> Vec<Jump> {
    WINDOW_SAMPLES.into_iter().flat_map(|side| jumps_between_means(t_s, series, fk, side)).collect()
}

/// Compares means over `side` samples before and after.
fn jumps_between_means(t_s: &[f64], series: &[[Vec3; 2]], fk: &[Pose], side: usize) -> Vec<Jump> {
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
    let distance = |a: [Vec3; 2], b: [Vec3; 2]| {
        a.iter().zip(&b).map(|(a, b)| (a - b).norm_squared()).sum::<f64>().sqrt()
    };
    // The jump is between samples `row - 1` and `row`.
    let rows: Vec<usize> = (side..=n - side).filter(|row| *row < n).collect();
    let step = |row: usize| distance(mean(row - side, row), mean(row, row + side));
    let steps: Vec<f64> = rows.iter().map(|&row| step(row)).collect();
    let moved = |row: usize| {
        let (a, b) = (&fk[row - side], &fk[row + side - 1]);
        let rotation = rotvec_from_rotation(&(a.rotation * b.rotation.inverse())) * LEVER_M;
        (a.translation.vector - b.translation.vector).norm() + rotation.norm()
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
    const FLOOR_M: f64 = 1e-5;
    let jump = |(index, &row): (usize, &usize)| {
        let usual = still + slope * moves[index] + FLOOR_M;
        if steps[index] <= MIN_JUMP_RATIO * usual {
            return None;
        }
        // A fast residual also varies before and after the jump.
        let before = (2..=6).filter_map(|by| steps.get(index.checked_sub(by * side)?).copied());
        let after = (2..=6).filter_map(|by| steps.get(index + by * side).copied());
        let [before, after] = [before.collect(), after.collect()]
            .map(|mut surrounding: Vec<f64>| median(&mut surrounding).unwrap_or(0.0));
        let usual = usual.max(before.min(after));
        let times = steps[index] / usual;
        (times > MIN_JUMP_RATIO).then(|| Jump {
            at_s: 0.5 * (t_s[row - 1] + t_s[row]),
            within_s: 0.5 * (t_s[row] - t_s[row - 1]),
            strength: times,
            window_s: t_s[row + side - 1] - t_s[row],
        })
    };
    rows.iter().enumerate().filter_map(jump).collect()
}
