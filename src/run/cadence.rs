//! How regularly the rows of a stream come: steps back, repeats, gaps, losses and slow stretches.
//!
//! Stamps say when the content was true, receive times only that it arrived: a stamp that steps back
//! is held against the order of receipt, and a gap in the stamps is one in the receipts too, or it
//! was the clock that stepped.

use std::collections::HashMap;

use crate::stream::{Columns, JointColumns, PoseColumns, Times};
use crate::time::{Clock, Stamp, seconds};

use super::arm::Arm;
use super::clock::{HeaderStamps, StreamClock};
use super::joints::{JointTopic, Samples};
use super::role::Role;
use super::streams::{Stream, Timing};
use super::tf_tree::without_slash;

/// A gap is longer than this many periods, and than [`GAP_S`].
const GAP_PERIODS: f64 = 10.0;
/// A gap is longer than this, s.
const GAP_S: f64 = 0.1;

/// How regularly the rows of one stream come, or of one transform of a TF topic, or of one of
/// several senders on a topic of joint states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cadence {
    /// The child frame of the transform.
    pub frame: Option<String>,
    /// Whether an audit needs it: false for transforms that are not of an arm's own links.
    pub wanted: bool,
    /// Rows.
    pub rows: usize,
    /// Typical time between two rows, s; `None` of fewer than three rows.
    pub period_s: Option<f64>,
    /// Whether the header stamps can be judged: they are there and advance.
    pub stamped: bool,
    /// Stamps before one that was received earlier, by more than a period: each with the latest
    /// stamp before it, and how far it is behind, s.
    pub steps_back: Vec<(Stamp, f64)>,
    /// Rows that repeat the stamp of an earlier one with the same content.
    pub repeats: usize,
    /// Rows that repeat the stamp of an earlier one with other content.
    pub conflicts: usize,
    /// Silences longer than ten periods and 0.1 s.
    pub gaps: Vec<Stretch>,
    /// How many rows are missing between the others, beside silences while the arm rests and slow
    /// stretches; `None` where the rows come at no fixed period.
    pub lost: Option<usize>,
    /// Where rows come at a lower rate than usual, for two seconds or more.
    pub slow: Vec<Stretch>,
}

/// A part of a stream's time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The stamp that it begins with.
    pub start: Stamp,
    /// The stamp that it ends with.
    pub end: Stamp,
    /// Rows a second in it, both ends counted as half a row.
    pub rate_hz: f64,
    /// Whether the arm moved in it; `None` where no joint states say.
    pub moving: Option<bool>,
}

impl Stretch {
    /// Its length, s.
    pub fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

/// How the time of one stream lies against that of the others, by when their messages were received.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extent {
    /// By how much it begins after the others (their median), s; negative where before.
    pub late_start_s: f64,
    /// By how much it ends before the others, s; negative where after.
    pub early_end_s: f64,
    /// Whether the arm moved before it began and after it ended; `None` where no joint states say.
    pub moving: [Option<bool>; 2],
}

/// The rhythm of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Rhythm {
    /// Index of the stream.
    pub stream: usize,
    /// Its parts.
    pub parts: Vec<Cadence>,
    /// How it lies against the others; `None` where there is no other.
    pub extent: Option<Extent>,
}

/// The rhythm of every stream that may be audited.
pub(super) fn rhythms(
    streams: &[Stream],
    timing: &Timing,
    topics: &[JointTopic<'_>],
    arms: &[Arm],
) -> Vec<Rhythm> {
    let motion = Motion::of(topics, arms);
    let mut rhythms: Vec<(Rhythm, Option<Bounds>)> = Vec::new();
    for (index, stream) in streams.iter().enumerate() {
        let is_audited = matches!(
            stream.role,
            Role::Joints | Role::Pose | Role::Candidate { .. } | Role::Tf | Role::Imu
        );
        let Some(columns) = stream.columns.as_ref().filter(|_| is_audited) else { continue };
        let mut parts = parts(columns, arms);
        if stream.role == Role::Tf {
            parts.retain(|part| !is_stream_of_its_own(part, stream, streams));
        }
        let bounds = parts
            .iter()
            .filter(|part| part.wanted)
            .filter_map(|part| Bounds::of(part, timing.clock(index, part.piece)?))
            .reduce(Bounds::join);
        let parts = parts
            .iter()
            .filter_map(|part| Some(part.cadence(timing.clock(index, part.piece)?, &motion)));
        rhythms.push((Rhythm { stream: index, parts: parts.collect(), extent: None }, bounds));
    }
    let bounds: Vec<Option<Bounds>> = rhythms.iter().map(|(_, bounds)| *bounds).collect();
    for (index, (rhythm, _)) in rhythms.iter_mut().enumerate() {
        rhythm.extent = extent(&bounds, index, &motion);
    }
    rhythms.into_iter().map(|(rhythm, _)| rhythm).collect()
}

/// Whether a transform of TF topic `stream` is listed as a measured pose beside it.
fn is_stream_of_its_own(part: &Part<'_>, stream: &Stream, streams: &[Stream]) -> bool {
    streams.iter().any(|other| {
        matches!(other.role, Role::Pose | Role::Candidate { .. })
            && other.topic == stream.topic
            && part.frame == Some(other.child_frame_id.as_str())
    })
}

/// First and last row of a stream: when received, and on the audit's clock.
#[derive(Clone, Copy)]
struct Bounds {
    received: (i64, i64),
    stamps: (Stamp, Stamp),
}

impl Bounds {
    fn of(part: &Part<'_>, clock: &StreamClock) -> Option<Self> {
        let stamps = clock.stamps_of(part.times);
        let known = || part.rows.iter().filter_map(|&row| stamps[row]);
        let received = || part.rows.iter().map(|&row| part.times.log[row]);
        Some(Self {
            received: (received().min()?, received().max()?),
            stamps: (known().min()?, known().max()?),
        })
    }

    fn join(self, other: Self) -> Self {
        let ((a, b), (c, d)) = (self.received, other.received);
        let ((e, f), (g, h)) = (self.stamps, other.stamps);
        Self { received: (a.min(c), b.max(d)), stamps: (e.min(g), f.max(h)) }
    }
}

/// How stream `index` lies against the others.
fn extent(bounds: &[Option<Bounds>], index: usize, motion: &Motion) -> Option<Extent> {
    let own = bounds[index]?;
    let others = || {
        let others = bounds.iter().enumerate().filter(move |(other, _)| *other != index);
        others.filter_map(|(_, bounds)| *bounds)
    };
    // Of two others the one that leaves the less to blame this stream for.
    let median = |mut times: Vec<i64>, upper: bool| {
        times.sort_unstable();
        let middle = if upper { times.len() / 2 } else { times.len().saturating_sub(1) / 2 };
        times.get(middle).copied()
    };
    let start = median(others().map(|other| other.received.0).collect(), true)?;
    let end = median(others().map(|other| other.received.1).collect(), false)?;
    let late_start_s = seconds(own.received.0.saturating_sub(start));
    let early_end_s = seconds(end.saturating_sub(own.received.1));
    let (first, last) = own.stamps;
    let moving = [
        motion.moves(first.shifted(-late_start_s.max(0.0)), first),
        motion.moves(last, last.shifted(early_end_s.max(0.0))),
    ];
    Some(Extent { late_start_s, early_end_s, moving })
}

/// When the joints were where.
struct Motion {
    joints: Vec<(Vec<Stamp>, Vec<f64>)>,
}

impl Motion {
    /// Of the joints of the arms, or where there is no arm of all joints.
    fn of(topics: &[JointTopic<'_>], arms: &[Arm]) -> Self {
        let of_an_arm = |name: &str| {
            arms.is_empty()
                || arms.iter().any(|arm| arm.joint_names.iter().any(|joint| joint == name))
        };
        let mut joints = Vec::new();
        for topic in topics {
            for joint in topic.columns.joints.iter().filter(|joint| of_an_arm(&joint.name)) {
                let Samples { stamps, position, .. } = Samples::of(topic, &joint.name);
                joints.push((stamps, position));
            }
        }
        Self { joints }
    }

    /// Whether a joint moved between two times; `None` where the joint states cover less than half
    /// of what lies between.
    fn moves(&self, start: Stamp, end: Stamp) -> Option<bool> {
        /// What a joint's noise may feign, and less than an arm does in a tenth of a second of work,
        /// rad or m.
        const MOVES: f64 = 5e-3;
        let mut covered = false;
        for (stamps, position) in &self.joints {
            let from = stamps.partition_point(|&stamp| stamp <= start).saturating_sub(1);
            let to =
                stamps.partition_point(|&stamp| stamp < end).min(stamps.len().saturating_sub(1));
            let (Some(first), Some(last)) = (stamps.get(from), stamps.get(to)) else { continue };
            let shared_s = (*last).min(end).seconds_since((*first).max(start));
            if from >= to || 2.0 * shared_s < end.seconds_since(start) {
                continue;
            }
            covered = true;
            let span = &position[from..=to];
            let low = span.iter().copied().fold(f64::INFINITY, f64::min);
            let high = span.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            if high - low > MOVES {
                return Some(true);
            }
        }
        covered.then_some(false)
    }
}

/// Some rows of a stream that come from one sender at one rhythm.
struct Part<'a> {
    /// Which piece of the stream's columns they are in.
    piece: usize,
    frame: Option<&'a str>,
    wanted: bool,
    times: &'a Times,
    /// The rows, in the order of receipt.
    rows: Vec<usize>,
    columns: Piece<'a>,
}

/// What the rows of a part hold.
enum Piece<'a> {
    Joints(&'a JointColumns),
    Poses(&'a PoseColumns),
    Numbers(Vec<&'a [[f64; 3]]>),
    Array(&'a [f64], usize),
}

impl Piece<'_> {
    /// Whether two rows hold the same.
    fn is_same(&self, a: usize, b: usize) -> bool {
        let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
        match self {
            Piece::Joints(joints) => {
                joints.joints.iter().all(|joint| same(joint.position[a], joint.position[b]))
            }
            Piece::Poses(poses) => {
                poses.xyz[a] == poses.xyz[b] && poses.q_xyzw[a] == poses.q_xyzw[b]
            }
            Piece::Numbers(columns) => columns.iter().all(|column| column[a] == column[b]),
            Piece::Array(values, width) => {
                values[a * width..(a + 1) * width] == values[b * width..(b + 1) * width]
            }
        }
    }
}

/// The parts of what a stream held.
fn parts<'a>(columns: &'a Columns, arms: &[Arm]) -> Vec<Part<'a>> {
    let whole = |piece: usize, times: &'a Times, columns: Piece<'a>| Part {
        piece,
        frame: None,
        wanted: true,
        times,
        rows: in_order_of_receipt(times, (0..times.len()).collect()),
        columns,
    };
    match columns {
        Columns::Joints(joints) => senders(joints)
            .into_iter()
            .map(|rows| Part {
                rows: in_order_of_receipt(&joints.times, rows),
                ..whole(0, &joints.times, Piece::Joints(joints))
            })
            .collect(),
        Columns::Poses(poses) => {
            let poses = poses.iter().enumerate();
            poses.map(|(piece, poses)| whole(piece, &poses.times, Piece::Poses(poses))).collect()
        }
        Columns::Transforms(transforms) => {
            let transforms = transforms.iter().enumerate();
            transforms
                .map(|(piece, poses)| Part {
                    frame: Some(without_slash(&poses.child_frame_id)),
                    wanted: is_of_an_arm(poses, arms),
                    ..whole(piece, &poses.times, Piece::Poses(poses))
                })
                .collect()
        }
        Columns::Imu(imu) => {
            vec![whole(0, &imu.times, Piece::Numbers(vec![&imu.gyro, &imu.accel]))]
        }
        Columns::Array(array) => {
            vec![whole(0, &array.times, Piece::Array(&array.values, array.width))]
        }
        Columns::Text(_) => Vec::new(),
    }
}

fn in_order_of_receipt(times: &Times, mut rows: Vec<usize>) -> Vec<usize> {
    rows.sort_by_key(|&row| times.log[row]);
    rows
}

/// Whether a transform is between links of an arm.
fn is_of_an_arm(transform: &PoseColumns, arms: &[Arm]) -> bool {
    let (parent, child) =
        (without_slash(&transform.frame_id), without_slash(&transform.child_frame_id));
    arms.iter().any(|arm| arm.joints_between(parent, child).is_some())
}

/// The rows of joint states by their sender: joints that are ever in one message have the same.
fn senders(joints: &JointColumns) -> Vec<Vec<usize>> {
    let in_row = |row: usize| {
        let joints = joints.joints.iter().enumerate();
        joints.filter(move |(_, joint)| !joint.position[row].is_nan()).map(|(index, _)| index)
    };
    let mut sender: Vec<usize> = (0..joints.joints.len()).collect();
    for row in 0..joints.times.len() {
        let Some(first) = in_row(row).next() else { continue };
        for joint in in_row(row) {
            let (kept, gone) = (sender[first], sender[joint]);
            if kept != gone {
                sender.iter_mut().filter(|of| **of == gone).for_each(|of| *of = kept);
            }
        }
    }
    let mut rows: Vec<(usize, Vec<usize>)> = Vec::new();
    for row in 0..joints.times.len() {
        let Some(of) = in_row(row).next().map(|joint| sender[joint]) else { continue };
        match rows.iter_mut().find(|(known, _)| *known == of) {
            Some((_, rows)) => rows.push(row),
            None => rows.push((of, vec![row])),
        }
    }
    rows.into_iter().map(|(_, rows)| rows).collect()
}

impl Part<'_> {
    fn cadence(&self, clock: &StreamClock, motion: &Motion) -> Cadence {
        let mut cadence = Cadence {
            frame: self.frame.map(str::to_owned),
            wanted: self.wanted,
            rows: self.rows.len(),
            stamped: clock.stamps == HeaderStamps::Sound,
            ..Cadence::default()
        };
        let stamps = clock.stamps_of(self.times);
        let mut times: Vec<(Stamp, i64)> =
            self.rows.iter().filter_map(|&row| Some((stamps[row]?, self.times.log[row]))).collect();
        times.sort_unstable();
        times.dedup_by_key(|(stamp, _)| *stamp);
        let pace = Pace::of(&times);
        cadence.period_s = pace.as_ref().map(|pace| pace.period_s);
        if let Some(pace) = &pace {
            let mut received: Vec<i64> = times.iter().map(|(_, received)| *received).collect();
            received.sort_unstable();
            let intervals = Intervals { times: &times, received: &received, pace, motion };
            cadence.gaps = intervals.gaps();
            cadence.slow = intervals.slow();
            cadence.lost = intervals.lost(&cadence);
        }
        if cadence.stamped {
            let offset = match clock.clock {
                Clock::Header => clock.alignment.map_or(0, |alignment| alignment.offset_nanos),
                Clock::Log | Clock::Publish => 0,
            };
            cadence.steps_back = self.steps_back(cadence.period_s.unwrap_or(0.0), offset);
            (cadence.repeats, cadence.conflicts) = self.repeated();
            // What has the stamp of another sample is not missing at its own.
            let conflicts = cadence.conflicts;
            cadence.lost = cadence.lost.map(|lost| lost.saturating_sub(conflicts));
        }
        cadence
    }

    /// Rows whose header has a stamp, in the order of receipt.
    fn stamped(&self) -> impl Iterator<Item = (usize, i64)> {
        let rows = self.rows.iter().map(|&row| (row, self.times.header[row]));
        rows.filter(|(_, stamp)| *stamp != 0)
    }

    /// Where stamps step back by more than a period: what stands before the step, and its size, s.
    fn steps_back(&self, period_s: f64, offset_nanos: i64) -> Vec<(Stamp, f64)> {
        /// Two rows that change places step back by a period and what their stamps jitter.
        const JITTER: f64 = 1.2;
        let mut steps = Vec::new();
        let mut before: Option<i64> = None;
        for (_, stamp) in self.stamped() {
            let by_s = before.map_or(0.0, |before| seconds(before.saturating_sub(stamp)));
            if by_s > JITTER * period_s && by_s > 0.0 {
                let at = before.unwrap_or(stamp).saturating_add(offset_nanos);
                steps.push((Stamp::from_nanos(at), by_s));
            }
            before = Some(stamp);
        }
        steps
    }

    /// How many rows repeat the stamp of an earlier row: with the same content, with other.
    fn repeated(&self) -> (usize, usize) {
        let mut first: HashMap<i64, usize> = HashMap::new();
        let (mut same, mut other) = (0, 0);
        for (row, stamp) in self.stamped() {
            match first.get(&stamp) {
                Some(&earlier) if self.columns.is_same(earlier, row) => same += 1,
                Some(_) => other += 1,
                None => {
                    first.insert(stamp, row);
                }
            }
        }
        (same, other)
    }
}

/// How far apart rows are that follow each other.
struct Pace {
    /// The typical interval, s: the mean of those close to the median, which rounding of stamps
    /// makes one of its steps.
    period_s: f64,
    /// Whether nearly all intervals are close to one, two, three … periods.
    is_regular: bool,
}

impl Pace {
    fn of(times: &[(Stamp, i64)]) -> Option<Self> {
        /// An interval this close to the median lacks no row.
        const SINGLE: f64 = 0.5;
        const CLOSE: f64 = 0.25;
        const REGULAR: f64 = 0.6;
        let intervals: Vec<f64> =
            times.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0)).collect();
        if intervals.len() < 2 {
            return None;
        }
        let mut sorted = intervals.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        let close: Vec<f64> =
            sorted.into_iter().filter(|dt| (dt / median - 1.0).abs() < SINGLE).collect();
        let period_s = close.iter().sum::<f64>() / close.len() as f64;
        let is_close = |dt: &&f64| {
            let periods = **dt / period_s;
            (periods - periods.round().max(1.0)).abs() < CLOSE
        };
        let regular = intervals.iter().filter(is_close).count();
        Some(Self { period_s, is_regular: regular as f64 > REGULAR * intervals.len() as f64 })
    }
}

/// The times between rows, held against their pace.
struct Intervals<'a> {
    /// Stamp and time of receipt of each row, in the order of the stamps, each stamp once.
    times: &'a [(Stamp, i64)],
    /// The times of receipt in their own order.
    received: &'a [i64],
    pace: &'a Pace,
    motion: &'a Motion,
}

impl Intervals<'_> {
    fn all(&self) -> impl Iterator<Item = (usize, f64)> {
        let pairs = self.times.windows(2).enumerate();
        pairs.map(|(left, pair)| (left, pair[1].0.seconds_since(pair[0].0)))
    }

    fn is_long(&self, interval_s: f64) -> bool {
        interval_s > GAP_S && interval_s > GAP_PERIODS * self.pace.period_s
    }

    /// Rows from `left` on over `count` intervals, as a stretch of time.
    fn stretch(&self, left: usize, count: usize) -> Stretch {
        let (start, end) = (self.times[left].0, self.times[left + count].0);
        let rate_hz = count as f64 / end.seconds_since(start);
        Stretch { start, end, rate_hz, moving: self.motion.moves(start, end) }
    }

    /// Whether nothing was received, for half of it at least, in the interval from row `left` on.
    /// What was received all the time had its clock set.
    fn is_silent(&self, left: usize, interval_s: f64) -> bool {
        let (before, after) = (self.times[left].1, self.times[left + 1].1);
        let from = self.received.partition_point(|&received| received < before);
        let to = self.received.partition_point(|&received| received <= after);
        let between = self.received.get(from..to).unwrap_or_default();
        let silences = between.windows(2).map(|pair| seconds(pair[1].saturating_sub(pair[0])));
        2.0 * silences.fold(0.0, f64::max) > interval_s
    }

    /// The silences.
    fn gaps(&self) -> Vec<Stretch> {
        let long = self.all().filter(|(_, interval_s)| self.is_long(*interval_s));
        let silent = long.filter(|&(left, interval_s)| self.is_silent(left, interval_s));
        silent.map(|(left, _)| self.stretch(left, 1)).collect()
    }

    /// Stretches of two seconds or more in which the median of nine intervals is long, but none is
    /// a gap.
    fn slow(&self) -> Vec<Stretch> {
        const SLOW: f64 = 1.4;
        const LASTS_S: f64 = 2.0;
        const AROUND: usize = 9;
        if !self.pace.is_regular {
            return Vec::new();
        }
        let intervals: Vec<f64> = self.all().map(|(_, interval_s)| interval_s).collect();
        let is_slow = |window: &[f64]| {
            let above = window.iter().filter(|dt| **dt > SLOW * self.pace.period_s).count();
            2 * above > window.len() && !window.iter().any(|dt| self.is_long(*dt))
        };
        let around = |at: usize| {
            let (from, to) = (at.saturating_sub(AROUND / 2), at + AROUND / 2 + 1);
            &intervals[from..to.min(intervals.len())]
        };
        let slow: Vec<bool> = (0..intervals.len()).map(|at| is_slow(around(at))).collect();
        let mut found = Vec::new();
        let mut at = 0;
        while at < slow.len() {
            let length = slow[at..].iter().take_while(|slow| **slow).count();
            if length > 0 {
                let stretch = self.stretch(at, length);
                if stretch.seconds() >= LASTS_S {
                    found.push(stretch);
                }
            }
            at += length.max(1);
        }
        found
    }

    /// Rows missing between others: an interval of three periods lacks two. Intervals shorter than
    /// half a period make up for one each: those rows were late, not lost.
    fn lost(&self, cadence: &Cadence) -> Option<usize> {
        let is_elsewhere = |start: Stamp| {
            let rests = cadence.gaps.iter().filter(|gap| gap.moving == Some(false));
            let mut excused = rests.chain(&cadence.slow);
            excused.any(|stretch| stretch.start <= start && start < stretch.end)
        };
        if !self.pace.is_regular {
            return None;
        }
        let mut lost = 0_i64;
        for (left, interval_s) in self.all() {
            let periods = interval_s / self.pace.period_s;
            if periods < 0.5 {
                lost -= 1;
            } else if periods > 1.5
                && !is_elsewhere(self.times[left].0)
                && (!self.is_long(interval_s) || self.is_silent(left, interval_s))
            {
                // A stamp from another age would count millions: a silence is a silence.
                lost += (periods.round().min(1e9) as i64) - 1;
            }
        }
        Some(usize::try_from(lost).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Epoch;
    use crate::stream::JointColumn;

    const MS: i64 = 1_000_000;

    /// A stream at 100 Hz for 10 s, received 1 ms after its stamps; `edit` says what becomes of row
    /// `row`: its stamp and its time of receipt, ms.
    fn poses(edit: impl Fn(i64) -> Option<(i64, i64)>) -> Columns {
        let mut poses = PoseColumns::default();
        for row in 0..1000 {
            let Some((stamp, received)) = edit(row) else { continue };
            poses.times.push((1_000_000 + stamp) * MS, (1_000_000 + received) * MS, 0);
            poses.xyz.push([row as f64, 0.0, 0.0]);
            poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
        }
        Columns::Poses(vec![poses])
    }

    fn on_time(row: i64) -> (i64, i64) {
        (10 * row, 10 * row + 1)
    }

    /// The cadence of the first part, beside a joint that moves in the first 5 s.
    fn cadence(columns: &Columns) -> Cadence {
        let clock = StreamClock {
            stream: 0,
            frame: None,
            clock: Clock::Header,
            stamps: HeaderStamps::Sound,
            rows: 0,
            zero: 0,
            log_minus_header_s: Some(1e-3),
            epoch: Epoch::Common,
            alignment: None,
        };
        let stamps: Vec<Stamp> =
            (0..1000).map(|row| Stamp::from_nanos((1_000_000 + 10 * row) * MS)).collect();
        let position = (0..1000).map(|row| 0.01 * f64::from(row.min(500))).collect();
        parts(columns, &[])[0].cadence(&clock, &Motion { joints: vec![(stamps, position)] })
    }

    #[test]
    fn a_steady_stream_has_its_period_and_nothing_else() {
        let jittered = |row: i64| Some((10 * row + (row * 7919) % 3, 10 * row + 5));
        for columns in [poses(|row| Some(on_time(row))), poses(jittered)] {
            let found = cadence(&columns);
            assert!(found.period_s.is_some_and(|period_s| (period_s - 0.01).abs() < 1e-4));
            assert_eq!((found.lost, found.repeats, found.conflicts), (Some(0), 0, 0));
            assert!(found.gaps.is_empty() && found.slow.is_empty(), "{found:?}");
            assert!(found.steps_back.is_empty(), "{found:?}");
        }
    }

    #[test]
    fn silence_is_told_by_whether_the_arm_moves() {
        let silent =
            |from: i64| poses(move |row| (!(from..from + 60).contains(&row)).then(|| on_time(row)));
        for (from, moving, lost) in [(200, true, 60), (700, false, 0)] {
            let found = cadence(&silent(from));
            let [gap] = found.gaps.as_slice() else { panic!("{found:?}") };
            assert!((gap.seconds() - 0.61).abs() < 1e-9 && gap.moving == Some(moving), "{gap:?}");
            assert_eq!(found.lost, Some(lost));
        }
    }

    #[test]
    fn a_clock_that_is_set_forward_leaves_no_gap() {
        let set = |row: i64| {
            let (stamp, received) = on_time(row);
            Some((stamp + if row < 300 { 0 } else { 700 }, received))
        };
        let found = cadence(&poses(set));
        assert!(found.gaps.is_empty() && found.lost == Some(0), "{found:?}");
    }

    #[test]
    fn lost_rows_are_counted_and_late_ones_are_not() {
        let lossy = cadence(&poses(|row| (row % 20 != 7).then(|| on_time(row))));
        assert_eq!(lossy.lost, Some(50));
        let late = |row: i64| {
            let (stamp, received) = on_time(row);
            Some((stamp + if row % 20 == 7 { 8 } else { 0 }, received + 8))
        };
        assert_eq!(cadence(&poses(late)).lost, Some(0));
        let random = |row: i64| Some((10 * row + (row * 7919) % 97, 10 * row + 100));
        assert_eq!(cadence(&poses(random)).lost, None);
    }

    #[test]
    fn a_lower_rate_over_seconds_is_a_slow_stretch_and_no_loss() {
        let slow = |row: i64| (row < 600 || row % 4 == 0).then(|| on_time(row));
        let found = cadence(&poses(slow));
        let [stretch] = found.slow.as_slice() else { panic!("{found:?}") };
        assert!((stretch.rate_hz - 25.0).abs() < 1.0 && stretch.seconds() > 3.5, "{stretch:?}");
        assert_eq!(found.lost, Some(0));
    }

    #[test]
    fn stamps_are_held_against_the_order_of_receipt() {
        let back = |row: i64| {
            let (stamp, received) = on_time(row);
            Some((stamp - if (300..330).contains(&row) { 407 } else { 0 }, received))
        };
        let found = cadence(&poses(back));
        let [(at, by_s)] = found.steps_back.as_slice() else { panic!("{found:?}") };
        assert_eq!(at.nanos(), (1_000_000 + 2990) * MS);
        assert!((by_s - 0.397).abs() < 1e-9, "{by_s}");
        assert!(found.gaps.is_empty(), "{found:?}");
        // Two that change places step back by one period, which a receiver has to live with.
        let swapped = |row: i64| {
            let (stamp, received) = on_time(row);
            Some((stamp, received + if row == 500 { 15 } else { 0 }))
        };
        assert!(cadence(&poses(swapped)).steps_back.is_empty());
    }

    #[test]
    fn a_stamp_used_twice_is_a_repeat_or_a_conflict() {
        let mut columns = poses(|row| {
            let (stamp, received) = on_time(row);
            Some((stamp - if row % 100 == 50 { 10 } else { 0 }, received))
        });
        let found = cadence(&columns);
        assert_eq!((found.repeats, found.conflicts, found.lost), (0, 10, Some(0)));
        if let Columns::Poses(poses) = &mut columns {
            poses[0].xyz.fill([0.0; 3]);
        }
        let found = cadence(&columns);
        assert_eq!((found.repeats, found.conflicts), (10, 0));
    }

    #[test]
    fn two_senders_on_one_topic_are_looked_at_apart() {
        let mut columns = JointColumns::default();
        for name in ["arm", "finger"] {
            columns.joints.push(JointColumn { name: name.to_owned(), ..JointColumn::default() });
        }
        for row in 0..300 {
            let of_arm = row % 3 != 0;
            columns.times.push(10 * row * MS, 10 * row * MS, 0);
            let values = if of_arm { [0.1, f64::NAN] } else { [f64::NAN, 0.2] };
            for (joint, value) in columns.joints.iter_mut().zip(values) {
                joint.position.push(value);
                joint.velocity.push(f64::NAN);
            }
        }
        let rows: Vec<usize> = senders(&columns).iter().map(Vec::len).collect();
        assert_eq!(rows, [100, 200]);
    }
}
