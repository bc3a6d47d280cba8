//! Detects pose streams that repeat one value while the arm moves.
//!
//! The latency is still unknown. So a span counts only if the arm never rests for half as long within the
//! maximum latency. Removal makes other faults estimable. Spans next to a rest are found later, when speeds
//! give the lag.

use std::ops::Range;

use crate::diagnosis::value_range;
use crate::geometry::{Pose, Vec3};
use crate::stats::thin::thinned;
use crate::stream::{JointTrack, Orientations, PoseTrack};
use crate::time::Stamp;

use super::Run;
use super::arm::Arm;
use super::poses::StampedTrack;
use super::sources::PoseSource;

/// Minimum duration, s; slow sources repeat values for less.
pub(super) const MIN_DURATION_S: f64 = 0.25;
/// Minimum number of periods, for the same reason.
pub(super) const MIN_PERIODS: usize = 10;
/// Gaps longer than this end a span, s.
const MAX_GAP_S: f64 = 1.0;
/// With this latency, values near both ends may lie outside the joint states, s; such spans are not reported.
const MAX_LATENCY_S: f64 = 1.0;
/// Accuracy of a lag from speeds, s.
pub(super) const LAG_ACCURACY_S: f64 = 0.1;
/// Maximum motion of a joint at rest, rad or m.
pub(super) const MAX_REST_MOTION: f64 = 5e-3;
/// The same as a share of the joint's range.
pub(super) const MAX_REST_SHARE: f64 = 0.01;

/// A span with one repeated value while the arm moved.
#[derive(Clone, Debug, PartialEq)]
pub struct FrozenSpan {
    /// Index of the stream.
    pub stream: usize,
    /// Joints that are frozen while others move; empty if the whole stream is frozen.
    pub joints: Vec<String>,
    /// First stamp with the value, of the joint that is frozen longest.
    pub start: Stamp,
    /// Last stamp with the value.
    pub end: Stamp,
    /// Number of samples with the value.
    pub samples: usize,
    /// Whether the stream has no other value.
    pub is_whole_stream: bool,
    /// Motion of the fastest joint, rad or m: the minimum over possible latencies. `None` if the joint states are frozen to the end.
    pub joint_motion: Option<f64>,
}

/// Removes repeats while the arm moves, except the first of each value, and returns the spans. `columns`
/// are the joints that move the link.
///
/// If the stream may belong to another arm (not `known`), keeps it when little would remain.
pub(super) fn remove_frozen(
    stream: usize,
    poses: &mut StampedTrack<PoseTrack>,
    joints: &JointTrack,
    columns: &[usize],
    (known, max_lag_s): (bool, f64),
) -> Vec<FrozenSpan> {
    let StampedTrack { track, stamps } = poses;
    let holds = constant_spans(track);
    if holds.is_empty() {
        return Vec::new();
    }
    let mut frozen = Vec::new();
    let mut kept = vec![true; stamps.len()];
    let rests = rest_limits(joints);
    for (first, last) in holds {
        let hold = (track.t_s[first], track.t_s[last]);
        let moved = min_motion(joints, (columns, &rests), hold, max_lag_s).unwrap_or(0.0);
        // An object at rest that the arm picks up does not jump.
        let may_be_object = !known && last + 1 < track.t_s.len() && !jumps_after(track, last);
        if moved > 0.0 && !may_be_object {
            let (start, end, samples) = (stamps[first], stamps[last], last + 1 - first);
            frozen.push(FrozenSpan {
                stream,
                joints: Vec::new(),
                start,
                end,
                samples,
                is_whole_stream: false,
                joint_motion: Some(moved),
            });
            kept[first + 1..=last].fill(false);
        }
    }
    let left = kept.iter().filter(|kept| **kept).count();
    if !known && 2 * left < kept.len() {
        return Vec::new();
    }
    frozen.iter_mut().for_each(|frozen| frozen.is_whole_stream = left < 2);
    if !frozen.is_empty() {
        retain_samples(track, &kept);
        let mut kept = kept.iter();
        stamps.retain(|_| kept.next().is_none_or(|kept| *kept));
    }
    frozen
}

impl PoseSource {
    /// Spans with one value while the arm moves at each of `lags_s`, or to and from which the position jumps.
    fn frozen_at_lags(&self, joints: &JointTrack, lags_s: &[f64]) -> Vec<FrozenSamples> {
        let rests = rest_limits(joints);
        let of = |(first, last): (usize, usize)| {
            let hold = (self.track.t_s[first], self.track.t_s[last]);
            let moved =
                motion_at_lags(joints, (&self.columns, &rests), hold, lags_s).unwrap_or(0.0);
            let is_apart = || jumps_to(&self.track, first) && jumps_after(&self.track, last);
            (moved > 0.0 || is_apart()).then_some((first, last, moved))
        };
        constant_spans(&self.track).into_iter().filter_map(of).collect()
    }

    /// Its track without the spans in which it is stuck: it repeats one value while the arm moves at each of `lags_s`,
    /// then jumps. An object at rest that the arm picks up does not jump. `None` without such a span, or if little
    /// would remain.
    pub fn track_without_stuck_spans(
        &self,
        joints: &JointTrack,
        lags_s: &[f64],
    ) -> Option<PoseTrack> {
        let mut stuck = self.frozen_at_lags(joints, lags_s);
        stuck.retain(|(_, last, _)| jumps_after(&self.track, *last));
        let kept = kept_samples(&self.track, stuck.iter().map(|&(first, last, _)| (first, last)));
        let left = kept.iter().filter(|kept| **kept).count();
        if stuck.is_empty() || 2 * left < kept.len() {
            return None;
        }
        let mut track = self.track.clone();
        retain_samples(&mut track, &kept);
        Some(track)
    }

    /// Its track without the spans with one value after which it jumps, whether the arm moves or not.
    pub fn track_without_jumps(&self) -> PoseTrack {
        let mut spans = constant_spans(&self.track);
        spans.retain(|(_, last)| jumps_after(&self.track, *last));
        let mut track = self.track.clone();
        retain_samples(&mut track, &kept_samples(&self.track, spans.into_iter()));
        track
    }

    /// Whether it repeats a value for a long time.
    pub fn has_constant_span(&self) -> bool {
        !constant_spans(&self.track).is_empty()
    }

    /// How far the joints move its link during its single value, m. `None` if it has several, or the joints
    /// do not move the link.
    pub fn motion_at_single_value_m(&self, joints: &JointTrack) -> Option<f64> {
        let is_constant = (1..self.track.t_s.len()).all(|row| is_same(&self.track, 0, row));
        is_constant.then(|| self.fk_motion_m(joints)).filter(|moved_m| *moved_m > MAX_REST_MOTION)
    }

    /// Whether the stream rests while the joints do, or while they move the tool. `None` if it moves.
    pub fn rests_with(&self, joints: &JointTrack) -> Option<bool> {
        let first = self.track.xyz.first()?;
        let is_near = |xyz: &Vec3| (xyz - first).norm() < MAX_REST_MOTION;
        self.track.xyz.iter().all(is_near).then(|| self.fk_motion_m(joints) < MAX_REST_MOTION)
    }

    /// Largest distance of the tool from its first place by FK, over the time of the stream, m.
    pub(super) fn fk_motion_m(&self, joints: &JointTrack) -> f64 {
        let [first_s, .., last_s] = self.track.t_s.as_slice() else { return 0.0 };
        let row_of = |t_s: f64| joints.t_s.partition_point(|at_s| *at_s < t_s);
        let poses = self.fk_poses(joints, row_of(*first_s)..row_of(*last_s));
        let from_first =
            |pose: &Pose| (pose.translation.vector - poses[0].translation.vector).norm();
        poses.iter().map(from_first).fold(0.0, f64::max)
    }

    /// Poses of its link by FK at some of these rows.
    pub(super) fn fk_poses(&self, joints: &JointTrack, rows: Range<usize>) -> Vec<Pose> {
        const MAX_POSES: usize = 64;
        let pose = |row: usize| self.chain.forward(&joints.positions_at(row, &self.columns));
        thinned(rows, MAX_POSES).map(pose).collect()
    }
}

impl Run {
    /// Removes repeats while the arm moves at each of `lags_s`, the possible lags of the source.
    pub fn remove_frozen_at_lags(&mut self, arm: usize, source: usize, lags_s: &[f64]) {
        let Arm { joints, poses, .. } = &mut self.arms[arm];
        let source = &mut poses[source];
        let found = source.frozen_at_lags(joints, lags_s);
        self.frozen.extend(found.iter().map(|&(first, last, joint_motion)| FrozenSpan {
            stream: source.stream,
            joints: Vec::new(),
            start: self.origin.shifted(source.track.t_s[first]),
            end: self.origin.shifted(source.track.t_s[last]),
            samples: last + 1 - first,
            is_whole_stream: false,
            joint_motion: Some(joint_motion),
        }));
        let kept = kept_samples(&source.track, found.iter().map(|&(first, last, _)| (first, last)));
        retain_samples(&mut source.track, &kept);
    }
}

/// First and last sample of a span, and the motion of the fastest joint.
type FrozenSamples = (usize, usize, f64);

/// All but the repeats within spans. If it jumps to the value, such as zeros of a tracker without a target, the value is dropped, too.
fn kept_samples(track: &PoseTrack, spans: impl Iterator<Item = (usize, usize)>) -> Vec<bool> {
    let mut kept = vec![true; track.t_s.len()];
    for (first, last) in spans {
        let repeats = first + usize::from(!jumps_to(track, first))..=last;
        kept[repeats].fill(false);
    }
    kept
}

fn rest_limits(joints: &JointTrack) -> Vec<f64> {
    let rows = || 0..joints.len();
    let rest = |joint: usize| {
        (MAX_REST_SHARE * value_range(rows().map(|row| joints.row(row)[joint])))
            .max(MAX_REST_MOTION)
    };
    (0..joints.dof).map(rest).collect()
}

fn constant_spans(track: &PoseTrack) -> Vec<(usize, usize)> {
    let mut holds =
        spans_like_first(&track.t_s, MIN_DURATION_S, |first, row| is_same(track, first, row));
    holds.retain(|(first, last)| last - first >= MIN_PERIODS);
    holds
}

/// First and last sample of each span without gaps in which all samples are like its first one.
pub(super) fn spans_like_first(
    t_s: &[f64],
    min_duration_s: f64,
    is_like: impl Fn(usize, usize) -> bool,
) -> Vec<(usize, usize)> {
    let (mut spans, mut first) = (Vec::new(), 0);
    while first < t_s.len() {
        let like = (first + 1..t_s.len())
            .take_while(|&row| t_s[row] - t_s[row - 1] < MAX_GAP_S && is_like(first, row));
        let last = first + like.count();
        if t_s[last] - t_s[first] >= min_duration_s {
            spans.push((first, last));
        }
        first = last + 1;
    }
    spans
}

/// Motion of the fastest joint during `hold`, minimised over lags near `lags_s`; 0 at rest. `None` outside
/// the joint states.
fn motion_at_lags(
    joints: &JointTrack,
    (columns, rests): (&[usize], &[f64]),
    hold: (f64, f64),
    lags_s: &[f64],
) -> Option<f64> {
    /// Of the search, s.
    const STEP_S: f64 = 0.01;
    let (&begin_s, &end_s) = (joints.t_s.first()?, joints.t_s.last()?);
    let steps = (LAG_ACCURACY_S / STEP_S) as i32;
    let lags_s = lags_s
        .iter()
        .flat_map(|lag_s| (-steps..=steps).map(move |step| lag_s + STEP_S * f64::from(step)));
    let mut moved = lags_s.map(|lag_s| {
        let (from_s, to_s) = (hold.0 - lag_s, hold.1 - lag_s);
        if from_s < begin_s || to_s > end_s {
            return None;
        }
        let rows = joints.t_s.partition_point(|t_s| *t_s < from_s)
            ..joints.t_s.partition_point(|t_s| *t_s <= to_s);
        let moved = columns.iter().filter_map(|&joint| {
            let range = value_range(rows.clone().map(|row| joints.row(row)[joint]));
            (range > rests[joint]).then_some(range)
        });
        Some(moved.fold(0.0, f64::max))
    });
    moved
        .try_fold(f64::INFINITY, |least, moved| Some(least.min(moved?)))
        .filter(|it| it.is_finite())
}

/// Whether the position jumps after the sample `last`, compared with the next steps.
pub(super) fn jumps_after(track: &PoseTrack, last: usize) -> bool {
    let rows = last + 2..(last + 2 + JUMP_STEPS).min(track.xyz.len());
    is_jump(track, last + 1, rows)
}

/// Whether the position jumps to the sample `first`, compared with the previous steps.
fn jumps_to(track: &PoseTrack, first: usize) -> bool {
    is_jump(track, first, first.saturating_sub(JUMP_STEPS).max(1)..first)
}

/// Steps that a jump is compared with.
const JUMP_STEPS: usize = 10;

/// Whether the step to `row` is a jump, compared with the steps to `others`.
fn is_jump(track: &PoseTrack, row: usize, others: Range<usize>) -> bool {
    const MIN_STEP_RATIO: f64 = 5.0;
    let step = |row: usize| (track.xyz[row] - track.xyz[row - 1]).norm();
    let longest = others.clone().map(step).fold(0.0, f64::max);
    !others.is_empty() && step(row) > MIN_STEP_RATIO * longest
}

pub(super) fn is_same(track: &PoseTrack, a: usize, b: usize) -> bool {
    track.xyz[a] == track.xyz[b]
        && match &track.orientation {
            Orientations::Rotations(rotations) => rotations[a] == rotations[b],
            Orientations::Numbers(numbers) => numbers[a] == numbers[b],
            Orientations::Unset(_) => true,
        }
}

pub(super) fn retain_samples(track: &mut PoseTrack, kept: &[bool]) {
    let rows = kept.iter().enumerate().filter(|(_, kept)| **kept).map(|(row, _)| row);
    *track = track.at_rows(&rows.collect::<Vec<usize>>());
}

/// Least motion of the fastest joint in any span half as long as `hold` within `max_lag_s`. `None` outside
/// the joint states, as the arm may have rested.
fn min_motion(
    joints: &JointTrack,
    (columns, rests): (&[usize], &[f64]),
    hold: (f64, f64),
    max_lag_s: f64,
) -> Option<f64> {
    /// Start times per span length, and samples per span.
    const STARTS_PER_SPAN: f64 = 4.0;
    const SAMPLES_PER_SPAN: usize = 8;
    let (&begin_s, &end_s) = (joints.t_s.first()?, joints.t_s.last()?);
    let at = |t_s: f64| {
        let row = joints.t_s.partition_point(|own| *own < t_s).min(joints.t_s.len() - 1);
        joints.row(row)
    };
    let length_s = 0.5 * (hold.1 - hold.0);
    let late_s = MAX_LATENCY_S.min(max_lag_s);
    if hold.0 + late_s + length_s > end_s || hold.1 - late_s - length_s < begin_s {
        return None;
    }
    // The first value may precede the first joint state.
    if hold.0 - begin_s < MAX_LATENCY_S && hold.1 - max_lag_s - begin_s < MIN_DURATION_S {
        return None;
    }
    let (from_s, to_s) = ((hold.0 - max_lag_s).max(begin_s), (hold.1 + max_lag_s).min(end_s));
    let (mut start_s, mut least) = (from_s, None::<f64>);
    while start_s + length_s <= to_s {
        let rows = (0..=SAMPLES_PER_SPAN)
            .map(|look| at(start_s + length_s * look as f64 / SAMPLES_PER_SPAN as f64));
        let rows: Vec<&[f64]> = rows.collect();
        let moved = columns.iter().filter_map(|&joint| {
            let range = value_range(rows.iter().map(|row| row[joint]));
            (range > rests[joint]).then_some(range)
        });
        let most = moved.fold(0.0, f64::max);
        least = Some(least.map_or(most, |least| least.min(most)));
        start_s += length_s / STARTS_PER_SPAN;
    }
    least
}
