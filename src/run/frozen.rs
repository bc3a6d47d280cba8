//! Times in which a stream of poses repeats one value though the arm moves.
//!
//! How late the stream is, nobody knows yet. A time is told to be frozen only where the arm nowhere rests
//! for half as long within the latency that is sought: then it moved, whatever the latency. Without these
//! times what is left of the stream shows its faults; with them, its pose would follow nothing. Once the
//! lag is known by the speeds of what is left, the times that lie beside a rest are told, too.

use crate::stream::{JointTrack, Orientations, PoseTrack};
use crate::time::Stamp;

use super::Run;
use super::arm::Arm;
use super::poses::Stamped;
use super::sources::PoseSource;

/// Shorter repeats are how a slow source looks in a fast stream, s …
const LEAST_S: f64 = 0.25;
/// … and so are fewer periods.
const LEAST_PERIODS: usize = 10;
/// What was said in a longer silence, nobody knows, s.
const BREAK_S: f64 = 1.0;
/// Where a stream may be later than this, and what it says is of before the first joint state or of after
/// the last, nothing is told, s.
const LATE_S: f64 = 1.0;
/// A joint that moves by less rests, rad or m, …
const REST: f64 = 5e-3;
/// … and by less than this share of its range over the run, in whatever unit it is.
const REST_SHARE: f64 = 0.01;

/// A time in which a stream stood still and the arm did not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frozen {
    /// Index of the stream.
    pub stream: usize,
    /// The first sample with the value.
    pub start: Stamp,
    /// The last one.
    pub end: Stamp,
    /// Samples with it.
    pub samples: usize,
    /// Whether the stream says nothing else.
    pub whole: bool,
    /// The most that a joint moved meanwhile, at any latency that is sought, at least: rad or m.
    pub moved: f64,
}

/// Takes the samples out of a stream's track that repeat a value while the arm moves, but for the first
/// of each value, and says when that was. `columns` of the joints move the link whose poses they are.
/// Of a stream that is not `known` to be this arm's nothing is taken where little else would be left: it
/// may well stand still.
pub(super) fn take_frozen(
    stream: usize,
    poses: &mut Stamped<PoseTrack>,
    joints: &JointTrack,
    columns: &[usize],
    (known, most_lag_s): (bool, f64),
) -> Vec<Frozen> {
    let Stamped { track, stamps } = poses;
    let holds = holds(track);
    if holds.is_empty() {
        return Vec::new();
    }
    let mut frozen = Vec::new();
    let mut kept = vec![true; stamps.len()];
    let rests = rests(joints);
    for (first, last) in holds {
        let hold = (track.t_s[first], track.t_s[last]);
        let moved = least_motion(joints, (columns, &rests), hold, most_lag_s).unwrap_or(0.0);
        if moved > 0.0 {
            let (start, end, samples) = (stamps[first], stamps[last], last + 1 - first);
            frozen.push(Frozen { stream, start, end, samples, whole: false, moved });
            kept[first + 1..=last].fill(false);
        }
    }
    let left = kept.iter().filter(|kept| **kept).count();
    if !known && 2 * left < kept.len() {
        return Vec::new();
    }
    frozen.iter_mut().for_each(|frozen| frozen.whole = left < 2);
    if !frozen.is_empty() {
        keep(track, &kept);
        retain(stamps, &kept);
    }
    frozen
}

impl PoseSource {
    /// Whether it repeats a value for long anywhere.
    pub fn stands_still(&self) -> bool {
        !holds(&self.track).is_empty()
    }

    /// By how much the joints move what it is the pose of while it says one thing only, m; `None` where it
    /// says more, or they do not move it.
    pub fn unmoved_by_m(&self, joints: &JointTrack) -> Option<f64> {
        /// Moments that are looked at.
        const LOOKS: usize = 64;
        let Self { track, chain, columns, .. } = self;
        let ([first_s, .., last_s], true) =
            (track.t_s.as_slice(), (1..track.t_s.len()).all(|row| is_same(track, 0, row)))
        else {
            return None;
        };
        let row_of = |t_s: f64| joints.t_s.partition_point(|at_s| *at_s < t_s);
        let rows = row_of(*first_s)..row_of(*last_s);
        let pose = |row: usize| {
            let q: Vec<f64> = columns.iter().map(|&column| joints.row(row)[column]).collect();
            chain.forward(&q).translation.vector
        };
        let places: Vec<_> =
            rows.clone().step_by(rows.len().div_ceil(LOOKS).max(1)).map(pose).collect();
        let from_first_m = places.iter().map(|place| (place - places[0]).norm());
        Some(from_first_m.fold(0.0, f64::max)).filter(|moved_m| *moved_m > REST)
    }
}

impl Run {
    /// Takes the samples out of a source's track that repeat a value while the arm moves, now that the
    /// lags are known at which the source may follow the arm: it moved at each of them.
    pub fn take_frozen_at(&mut self, arm: usize, source: usize, lags_s: &[f64]) {
        let Arm { joints, poses, .. } = &mut self.arms[arm];
        let PoseSource { stream, track, columns, .. } = &mut poses[source];
        let holds = holds(track);
        if holds.is_empty() {
            return;
        }
        let mut kept = vec![true; track.t_s.len()];
        let rests = rests(joints);
        let stamp = |t_s: f64| Stamp::from_nanos(self.origin.nanos() + (1e9 * t_s).round() as i64);
        for (first, last) in holds {
            let hold = (track.t_s[first], track.t_s[last]);
            let moved = motion_at(joints, (columns, &rests), hold, lags_s).unwrap_or(0.0);
            if moved <= 0.0 {
                continue;
            }
            self.frozen.push(Frozen {
                stream: *stream,
                start: stamp(hold.0),
                end: stamp(hold.1),
                samples: last + 1 - first,
                whole: false,
                moved,
            });
            kept[first + 1..=last].fill(false);
        }
        keep(track, &kept);
    }
}

/// What each joint of the track must move by in order not to rest.
fn rests(joints: &JointTrack) -> Vec<f64> {
    let rows = || 0..joints.len();
    let rest = |joint| (REST_SHARE * range(rows().map(|row| joints.row(row)[joint]))).max(REST);
    (0..joints.dof).map(rest).collect()
}

fn range(of: impl Iterator<Item = f64> + Clone) -> f64 {
    of.clone().fold(f64::NEG_INFINITY, f64::max) - of.fold(f64::INFINITY, f64::min)
}

/// The first and the last row of each time that is long enough in which a track repeats one value.
fn holds(track: &PoseTrack) -> Vec<(usize, usize)> {
    let (mut holds, mut first) = (Vec::new(), 0);
    while first < track.t_s.len() {
        let repeats = (first + 1..track.t_s.len()).take_while(|&row| {
            track.t_s[row] - track.t_s[row - 1] < BREAK_S && is_same(track, first, row)
        });
        let last = first + repeats.count();
        if last - first >= LEAST_PERIODS && track.t_s[last] - track.t_s[first] >= LEAST_S {
            holds.push((first, last));
        }
        first = last + 1;
    }
    holds
}

/// By how much the joint moves in `hold` that moves most, at the lag of those about `lags_s` at which it
/// moves least; 0 where all rest. `None` where the joint states do not cover it.
fn motion_at(
    joints: &JointTrack,
    (columns, rests): (&[usize], &[f64]),
    hold: (f64, f64),
    lags_s: &[f64],
) -> Option<f64> {
    /// A lag by speeds alone is right to this, s, and is tried in such steps.
    const RIGHT_S: f64 = 0.1;
    const STEP_S: f64 = 0.01;
    let (&begin_s, &end_s) = (joints.t_s.first()?, joints.t_s.last()?);
    let steps = (RIGHT_S / STEP_S) as i32;
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
            let range = range(rows.clone().map(|row| joints.row(row)[joint]));
            (range > rests[joint]).then_some(range)
        });
        Some(moved.fold(0.0, f64::max))
    });
    moved
        .try_fold(f64::INFINITY, |least, moved| Some(least.min(moved?)))
        .filter(|it| it.is_finite())
}

/// Whether two samples are the same to the last bit.
fn is_same(track: &PoseTrack, a: usize, b: usize) -> bool {
    track.xyz[a] == track.xyz[b]
        && match &track.orientation {
            Orientations::Rotations(rotations) => rotations[a] == rotations[b],
            Orientations::Numbers(numbers) => numbers[a] == numbers[b],
            Orientations::Unset(_) => true,
        }
}

fn keep(track: &mut PoseTrack, kept: &[bool]) {
    retain(&mut track.t_s, kept);
    retain(&mut track.xyz, kept);
    match &mut track.orientation {
        Orientations::Rotations(rotations) => retain(rotations, kept),
        Orientations::Numbers(numbers) => retain(numbers, kept),
        Orientations::Unset(samples) => *samples = track.t_s.len(),
    }
    if let Some(others) =
        track.declared.as_mut().and_then(|declared| declared.in_other_angles.as_mut())
    {
        retain(others, kept);
    }
}

fn retain<T>(values: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    values.retain(|_| kept.next().is_none_or(|kept| *kept));
}

/// Of all times half as long as `hold` and within `most_lag_s` of it the one in which the joints move
/// least: by how much the joint moves then that moves most, 0 where all rest. `None` where the joint
/// states do not cover them, so that the arm may have rested unseen.
fn least_motion(
    joints: &JointTrack,
    (columns, rests): (&[usize], &[f64]),
    hold: (f64, f64),
    most_lag_s: f64,
) -> Option<f64> {
    /// Starts that are tried in a length, and samples that are looked at in it.
    const STARTS: f64 = 4.0;
    const LOOKS: usize = 8;
    let (&begin_s, &end_s) = (joints.t_s.first()?, joints.t_s.last()?);
    let at = |t_s: f64| {
        let row = joints.t_s.partition_point(|own| *own < t_s).min(joints.t_s.len() - 1);
        joints.row(row)
    };
    let length_s = 0.5 * (hold.1 - hold.0);
    let late_s = LATE_S.min(most_lag_s);
    if hold.0 + late_s + length_s > end_s || hold.1 - late_s - length_s < begin_s {
        return None;
    }
    // The first value may be of before the first joint state.
    if hold.0 - begin_s < LATE_S && hold.1 - most_lag_s - begin_s < LEAST_S {
        return None;
    }
    let (from_s, to_s) = ((hold.0 - most_lag_s).max(begin_s), (hold.1 + most_lag_s).min(end_s));
    let (mut start_s, mut least) = (from_s, None::<f64>);
    while start_s + length_s <= to_s {
        let rows = (0..=LOOKS).map(|look| at(start_s + length_s * look as f64 / LOOKS as f64));
        let rows: Vec<&[f64]> = rows.collect();
        let moved = columns.iter().filter_map(|&joint| {
            let range = range(rows.iter().map(|row| row[joint]));
            (range > rests[joint]).then_some(range)
        });
        let most = moved.fold(0.0, f64::max);
        least = Some(least.map_or(most, |least| least.min(most)));
        start_s += length_s / STARTS;
    }
    least
}
