//! Stale joint states that keep one value from a motion to the end of the log.
//!
//! An arm at rest looks the same, so all streams of poses that followed the arm in its base frame must move on. Other frames
//! may move while the arm rests.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use crate::stream::{Columns, JointTrack, PoseTrack};

use super::Run;
use super::frozen::{
    FrozenSpan, LAG_ACCURACY_S, MAX_REST_MOTION, MAX_REST_SHARE, MIN_DURATION_S, MIN_PERIODS,
};
use super::stale::{MAX_FROZEN_MOTION_SIGMAS, StaleJoints};

impl Run {
    /// Removes the joint states of an arm after the first of these rows, which are stale.
    pub(super) fn remove_stale_end(&mut self, arm: usize, rows: Range<usize>) {
        let found = &mut self.arms[arm];
        let stamp = |row: usize| self.origin.shifted(found.joints.t_s[row]);
        let (start, end) = (stamp(rows.start), stamp(rows.end - 1));
        for track in std::iter::once(&mut found.joints).chain(&mut found.recorded_joints) {
            Arc::make_mut(track).truncate(rows.start + 1);
        }
        let streams: BTreeSet<usize> =
            self.arms[arm].joint_sources.iter().map(|joint| joint.stream).collect();
        for stream in streams {
            let Some(Columns::Joints(columns)) = &self.streams[stream].columns else { continue };
            let Some(clock) = self.clocks_of(stream).first() else { continue };
            let all = clock.rows_of(&columns.times);
            let mut rows: Vec<usize> =
                all.filter(|(stamp, _)| *stamp > start).map(|(_, row)| row).collect();
            rows.sort_unstable();
            let frozen = FrozenSpan {
                stream,
                joints: Vec::new(),
                start,
                end,
                samples: rows.len() + 1,
                is_whole_stream: false,
                joint_motion: None,
            };
            self.frozen.push(frozen.clone());
            self.sample_filter.stale.push(StaleJoints { frozen, rows });
        }
    }
}

/// The last rows, if no joint moves in them.
pub(super) fn rows_at_rest(joints: &JointTrack) -> Option<Range<usize>> {
    let last = joints.len().checked_sub(1)?;
    let limit = |joint: usize| {
        let noise = joints.noise.get(joint).map_or(0.0, |noise| noise[0]);
        MAX_FROZEN_MOTION_SIGMAS * noise + 1e-9
    };
    let limits: Vec<f64> = (0..joints.dof).map(limit).collect();
    let is_still = |row: &usize| {
        let both = joints.row(*row).iter().zip(joints.row(last)).zip(&limits);
        both.into_iter().all(|((q, end), limit)| (q - end).abs() <= *limit)
    };
    let first = (0..=last).rev().take_while(is_still).last()?;
    let is_long =
        last - first >= MIN_PERIODS && joints.t_s[last] - joints.t_s[first] >= MIN_DURATION_S;
    is_long.then_some(first..last + 1)
}

/// Whether the position keeps changing in this span of time, later by each of the lags. A value that jumps, as a tracker's
/// zeros, does not.
pub(super) fn moves_within(track: &PoseTrack, [from_s, to_s]: [f64; 2], lags_s: &[f64]) -> bool {
    const INTERVAL_S: f64 = 0.2;
    const MIN_INTERVALS: usize = 5;
    let row = |t_s: f64| track.t_s.partition_point(|own| *own < t_s);
    let range = track.xyz.iter().map(|xyz| (xyz - track.xyz[0]).norm()).fold(0.0, f64::max);
    let limit = MAX_REST_MOTION.max(MAX_REST_SHARE * range);
    let keeps_moving = |lag_s: &f64| {
        let begin_s = from_s + lag_s + LAG_ACCURACY_S;
        let count = ((to_s - from_s - 2.0 * LAG_ACCURACY_S) / INTERVAL_S).max(0.0) as usize;
        let at = |interval: usize| track.xyz.get(row(begin_s + interval as f64 * INTERVAL_S));
        let moves = |interval: &usize| {
            at(*interval).zip(at(interval + 1)).is_some_and(|(a, b)| (b - a).norm() > limit)
        };
        (0..count).filter(moves).count() >= MIN_INTERVALS
    };
    lags_s.iter().all(keeps_moving)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    #[test]
    fn the_rest_at_the_end_is_found() {
        let t_s: Vec<f64> = (0..2000).map(|row| 0.01 * f64::from(row)).collect();
        let found = |until_s: f64| {
            let noise = |row: usize| 1e-5 * ((row * 7919 % 13) as f64 - 6.0) / 6.0;
            let rows = t_s.iter().enumerate();
            let q = rows.map(|(row, t_s)| (1.1 * t_s.min(until_s)).sin() + noise(row)).collect();
            let (t_s, qd, noise) = (t_s.clone(), vec![0.0; 2000], vec![[1e-5, 1e-3]]);
            rows_at_rest(&JointTrack { t_s, dof: 1, q, qd, noise })
        };
        assert!(found(13.0).is_some_and(|rows| rows.start.abs_diff(1300) < 3 && rows.end == 2000));
        assert_eq!(found(20.0), None);
    }

    #[test]
    fn poses_must_move_meanwhile_at_every_lag() {
        let t_s: Vec<f64> = (0..2000).map(|row| 0.01 * f64::from(row)).collect();
        let track = |moves: Range<f64>| PoseTrack {
            xyz: t_s
                .iter()
                .map(|t_s| Vec3::x() * t_s.clamp(moves.start, moves.end).sin())
                .collect(),
            orientation: crate::stream::Orientations::Unset(t_s.len()),
            t_s: t_s.clone(),
            declared: None,
        };
        let moves = |range, lags_s: &[f64]| moves_within(&track(range), [13.0, 16.0], lags_s);
        assert!(moves(0.0..20.0, &[0.0, 1.5]));
        assert!(moves(0.0..15.0, &[0.0]) && !moves(0.0..15.0, &[0.0, 1.5]));
        // After the joint states end, the arm may move again.
        assert!(!moves(16.5..20.0, &[0.0]));
    }
}
