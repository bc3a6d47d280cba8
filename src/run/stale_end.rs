//! Stale joint states that keep one value from a motion to the end of the log.
//!
//! An arm at rest looks the same, so a stream of poses that followed the arm must move on. If its frame may move as well, the
//! joints must have stopped without slowing down.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use crate::geometry::Vec3;
use crate::stream::{Columns, JointTrack, PoseTrack};
use crate::time::Stamp;

use super::Run;
use super::frozen::{
    FrozenSpan, LAG_ACCURACY_S, MAX_REST_MOTION, MAX_REST_SHARE, MIN_DURATION_S, MIN_PERIODS,
};
use super::stale::{MAX_FROZEN_MOTION_SIGMAS, SPEED_ROWS, StaleJoints};

impl Run {
    /// Removes the joint states of an arm after the first of these rows, which are stale.
    pub(super) fn remove_stale_end(&mut self, arm: usize, rows: Range<usize>) {
        let found = &mut self.arms[arm];
        let stamp = |row: usize| {
            let since_origin = (1e9 * found.joints.t_s[row]).round() as i64;
            Stamp::from_nanos(self.origin.nanos() + since_origin)
        };
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
                start,
                end,
                samples: rows.len() + 1,
                is_whole_stream: false,
                joint_motion: None,
            };
            self.frozen.push(frozen);
            self.sample_filter.stale.push(StaleJoints { frozen, rows });
        }
    }
}

/// The last rows, in which no joint moves.
pub(super) struct StaleEnd {
    pub rows: Range<usize>,
    /// Whether a joint moved at full speed just before.
    pub stops_abruptly: bool,
}

impl StaleEnd {
    pub fn find(joints: &JointTrack) -> Option<Self> {
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
        let stops_abruptly = stops_abruptly(joints, first, &limits);
        is_long.then_some(Self { rows: first..last + 1, stops_abruptly })
    }
}

/// Whether the fastest joint reaches `row` without slowing down.
fn stops_abruptly(joints: &JointTrack, row: usize, limits: &[f64]) -> bool {
    /// Of the distances in two equal times. A joint that slows down evenly covers a third before it rests.
    const MIN_RATIO: f64 = 0.6;
    /// Distance in multiples of the motion that counts as none.
    const MIN_DISTANCE: f64 = 20.0;
    let Some(begin) = row.checked_sub(2 * SPEED_ROWS) else { return false };
    let distance = |from: usize, joint: usize| {
        (joints.row(from + SPEED_ROWS)[joint] - joints.row(from)[joint]).abs()
    };
    let ratio = |joint: usize| distance(begin + SPEED_ROWS, joint) / limits[joint];
    let fastest = (0..joints.dof).max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)));
    fastest.is_some_and(|joint| {
        ratio(joint) > MIN_DISTANCE
            && distance(begin + SPEED_ROWS, joint) > MIN_RATIO * distance(begin, joint)
    })
}

/// Whether the position changes in this span of time, later by each of the lags, if there are any.
pub(super) fn moves_within(track: &PoseTrack, [from_s, to_s]: [f64; 2], lags_s: &[f64]) -> bool {
    let changes = |lag_s: &f64| {
        let row = |t_s: f64| track.t_s.partition_point(|own| *own < t_s);
        let rows = row(from_s + lag_s + LAG_ACCURACY_S)..row(to_s + lag_s - LAG_ACCURACY_S);
        let within = track.xyz.get(rows).unwrap_or_default();
        let Some(start) = within.first() else { return false };
        let from_start = |xyz: &Vec3| (xyz - start).norm();
        let range = track.xyz.iter().map(from_start).fold(0.0, f64::max);
        let limit = MAX_REST_MOTION.max(MAX_REST_SHARE * range);
        within.iter().filter(|xyz| from_start(xyz) > limit).count() >= MIN_PERIODS
    };
    !lags_s.is_empty() && lags_s.iter().all(changes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 s at 100 Hz of a joint that follows `position`, with noise of 10 µrad.
    fn found(position: impl Fn(f64) -> f64) -> Option<StaleEnd> {
        let t_s: Vec<f64> = (0..2000).map(|row| 0.01 * f64::from(row)).collect();
        let noise = |row: usize| 1e-5 * ((row * 7919 % 13) as f64 - 6.0) / 6.0;
        let q = t_s.iter().enumerate().map(|(row, t_s)| position(*t_s) + noise(row)).collect();
        let noise = vec![[1e-5, 1e-3]];
        StaleEnd::find(&JointTrack { qd: vec![0.0; t_s.len()], t_s, dof: 1, q, noise })
    }

    #[test]
    fn a_joint_that_stops_at_full_speed_differs_from_one_that_slows_down() {
        let stale = found(|t_s| (1.1 * t_s.min(13.0)).sin()).expect("rests");
        assert!(stale.stops_abruptly && stale.rows.start.abs_diff(1300) < 3, "{:?}", stale.rows);
        let acceleration = 2.0;
        let rest =
            found(|t_s| -0.5 * acceleration * (13.0 - t_s).clamp(0.0, 1.0).powi(2)).expect("rests");
        assert!(!rest.stops_abruptly);
        assert!(found(|t_s| (1.1 * t_s).sin()).is_none());
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
        assert!(!moves(0.0..20.0, &[]));
        assert!(moves(0.0..14.0, &[0.0]) && !moves(0.0..14.0, &[0.0, 1.0]));
        // After the joint states end, the arm may move again.
        assert!(!moves(16.5..20.0, &[0.0]));
    }
}
