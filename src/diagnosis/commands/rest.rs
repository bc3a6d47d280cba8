//! Rests of the arm and constant commands.

use crate::PoseSeries;
use crate::latency::correlation::median_period_s;
use ground::geometry::{
    Pose, angle_between, mean_vector, rotation_from_rotvec, rotvec_from_rotation,
};
use ground::stats::cumulative;
use ground::stream::{JointTrack, sample_noise};

/// In shorter rests the motion has not settled.
pub(super) const MIN_REST_S: f64 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rest {
    pub from_s: f64,
    pub to_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ConstantCommand {
    pub first: usize,
    pub last: usize,
    pub from_s: f64,
    pub to_s: f64,
}

/// Means over a tenth of a second before and after each sample must agree within the noise.
pub(super) fn detect_rests(joints: &JointTrack) -> Vec<Rest> {
    let period_s = median_period_s(&joints.t_s);
    let is_gap = |row: usize| joints.t_s[row] - joints.t_s[row - 1] > (10.0 * period_s).max(0.1);
    let still = still_rows(joints, period_s);
    let rows: Vec<usize> = (0..joints.len()).filter(|&row| still[row]).collect();
    let rests = rows.chunk_by(|&row, &next| next == row + 1 && !is_gap(next)).map(|rows| {
        let [from_s, to_s] = [rows[0], rows[rows.len() - 1]].map(|row| joints.t_s[row]);
        Rest { from_s, to_s }
    });
    rests.filter(|rest| rest.to_s - rest.from_s >= MIN_REST_S).collect()
}

fn still_rows(joints: &JointTrack, period_s: f64) -> Vec<bool> {
    const HALF_WINDOW_S: f64 = 0.1;
    /// In rad/s or m/s: 2 mm/s at a radius of 1 m.
    const MAX_REST_SPEED: f64 = 2e-3;
    const SIGMAS: f64 = 4.0;
    let (rows, dof) = (joints.len(), joints.dof);
    let half = ((HALF_WINDOW_S / period_s.max(1e-6)).round() as usize).max(1);
    let mut still = vec![true; rows];
    for joint in 0..dof {
        let q: Vec<f64> = joints.positions_of(joint).collect();
        let before = cumulative(q.iter().copied());
        let mean = |from: usize, to: usize| (before[to] - before[from]) / (to - from) as f64;
        let by_noise = SIGMAS * sample_noise(&q) * (2.0 / half as f64).sqrt();
        for (row, still) in still.iter_mut().enumerate() {
            // Truncated at the ends of the track.
            let (from, to) = (row.saturating_sub(half), (row + 1 + half).min(rows));
            let left = if from == row { q[row] } else { mean(from, row) };
            let right = if row + 1 == to { q[row] } else { mean(row + 1, to) };
            let apart_s = (joints.t_s[to - 1] - joints.t_s[from]).max(period_s) / 2.0;
            *still &= (right - left).abs() <= MAX_REST_SPEED * apart_s + by_noise;
        }
    }
    still
}

/// A single goal holds until the next one or `end_s`; a streamed command until the stream stops.
pub(super) fn constant_commands(
    series: &PoseSeries,
    is_streamed: bool,
    end_s: f64,
) -> Vec<ConstantCommand> {
    /// Equal commands.
    const COMMAND_TOLERANCE_M_RAD: (f64, f64) = (5e-5, 5e-5);
    let PoseSeries { t_s, poses } = series;
    let silent_s = if is_streamed { (10.0 * median_period_s(t_s)).max(0.5) } else { f64::INFINITY };
    let mut found = Vec::new();
    let mut first = 0;
    for row in 1..=t_s.len() {
        let last = row - 1;
        let next_s = t_s.get(row).copied();
        let is_silent = next_s.is_some_and(|next_s| next_s - t_s[last] > silent_s);
        let is_other = poses.get(row).is_none_or(|next| {
            (next.translation.vector - poses[first].translation.vector).norm()
                > COMMAND_TOLERANCE_M_RAD.0
                || angle_between(&next.rotation, &poses[first].rotation) > COMMAND_TOLERANCE_M_RAD.1
        });
        if !is_other && !is_silent {
            continue;
        }
        let to_s = match next_s {
            Some(next_s) if !is_silent => next_s,
            None if !is_streamed => end_s.max(t_s[last]),
            _ => t_s[last],
        };
        found.push(ConstantCommand { first, last, from_s: t_s[first], to_s });
        first = row;
    }
    found
}

pub(super) fn poses_within(series: &PoseSeries, from_s: f64, to_s: f64) -> &[Pose] {
    let from = series.t_s.partition_point(|&t| t < from_s);
    let to = series.t_s.partition_point(|&t| t <= to_s).max(from);
    &series.poses[from..to]
}

/// Mean of nearly equal poses. `None` without poses.
pub(super) fn mean_pose(poses: &[Pose]) -> Option<Pose> {
    let first = poses.first()?.rotation;
    let xyz = mean_vector(poses.iter().map(|pose| pose.translation.vector));
    let turn = |pose: &Pose| rotvec_from_rotation(&(first.inverse() * pose.rotation));
    let rotation = first * rotation_from_rotvec(mean_vector(poses.iter().map(turn)));
    Some(Pose::from_parts(xyz.into(), rotation))
}
