//! How regularly the rows of a stream come: steps back, repeats, holes and lulls.
//!
//! Stamps say when the content was true, receive times only that it arrived: a stamp that steps back
//! is held against the order of receipt, and a hole in the stamps is one in the receipts too, or it
//! was the clock that stepped. Nothing is judged here: how large a hole is a gap, and how many lost
//! rows are a fault, is for the rules to say.

mod coarse;
mod extent;
mod intervals;
mod motion;
mod numbers;
mod parts;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use rayon::prelude::*;

use crate::stream::Columns;
use crate::time::{Clock, Stamp, seconds};

use self::coarse::Coarse;
use self::extent::{Bounds, Ends, extent};
use self::intervals::{Intervals, Pace};
use self::motion::Motion;
use self::parts::{Part, parts};
use super::arm::Arm;
use super::clock::{HeaderStamps, StreamClock};
use super::joints::JointTopic;
use super::role::Role;
use super::streams::Stream;
use super::timing::Timing;

pub use self::extent::Extent;
pub use self::intervals::{Hole, Stretch};

/// How regularly the rows of one stream come, or of one transform of a TF topic, or of one of
/// several senders on a topic of joint states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cadence {
    /// The child frame of the transform.
    pub frame: Option<String>,
    /// Whether an audit may expect it to be steady: false for transforms that are not of an arm's own
    /// links.
    pub wanted: bool,
    /// Rows.
    pub rows: usize,
    /// Typical time between two rows, s; `None` of fewer than three rows.
    pub period_s: Option<f64>,
    /// Whether nearly all intervals are close to one, two, three … periods.
    pub is_regular: bool,
    /// The tick of a coarse clock that its stamps are of, which hides when between two ticks a row came, s;
    /// its rhythm is then that of the times of receipt, where these are finer.
    pub tick_s: Option<f64>,
    /// Whether the header stamps can be judged: they are there and advance.
    pub stamped: bool,
    /// Stamps before one that was received earlier: each with the stamp before it, and how far it is
    /// behind, s.
    pub steps_back: Vec<(Stamp, f64)>,
    /// Rows that repeat the stamp of an earlier one with the same content.
    pub repeats: usize,
    /// Rows that repeat the stamp of an earlier one with other content.
    pub conflicts: usize,
    /// Intervals in which a row or more is missing, in the order of time.
    pub holes: Vec<Hole>,
    /// Rows closer than half a period to the one before: those were late, not lost, and make up for
    /// one missing row each.
    pub bunched: usize,
    /// Where rows come at a notably lower rate than usual, for several rows on end.
    pub lulls: Vec<Stretch>,
    /// Rows missing by the numbers that the sender gives its messages; `None` where it gives none.
    pub skipped: Option<usize>,
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

impl Rhythm {
    /// Whether its topic has the poses of its body in other frames, too.
    fn has_relabelled(&self, streams: &[Stream]) -> bool {
        let own = &streams[self.stream];
        streams.iter().any(|other| is_relabelled(own, other, streams))
    }
}

impl Cadence {
    /// Takes out the holes in which rows came elsewhere, at stamps in ascending order.
    fn fill_holes(&mut self, came: &[Stamp]) {
        self.holes.retain(|hole| {
            let Stretch { start, end, .. } = hole.stretch;
            let [from, to] = [start, end].map(|at| came.partition_point(|stamp| *stamp < at));
            let between = came[from..to.max(from)].iter().copied();
            let mut last = start;
            let silences = between.chain([end]).map(|stamp| {
                let silence_s = stamp.seconds_since(last);
                last = stamp;
                silence_s
            });
            2.0 * silences.fold(0.0, f64::max) > hole.stretch.seconds()
        });
    }
}

/// The rhythm of every stream that plays a part.
pub(super) fn rhythms(
    streams: &[Stream],
    timing: &Timing,
    topics: &[JointTopic<'_>],
    arms: &[Arm],
) -> Vec<Rhythm> {
    let motion = Motion::of(topics, arms);
    let rhythm = |(index, stream): (usize, &Stream)| {
        let has_rhythm = has_rhythm(stream) && !is_within_tf(stream, streams);
        let columns = stream.columns.as_ref().filter(|_| has_rhythm)?;
        let mut parts: Vec<Part<'_>> = parts(columns, arms)
            .into_iter()
            .flat_map(|part| {
                let two = timing.sift.publishers.iter();
                let mut two = two.filter(|two| (two.stream, two.piece) == (index, part.piece));
                match two.next() {
                    Some(two) => Vec::from(part.by_publisher(&two.second)),
                    None => vec![part],
                }
            })
            .collect();
        if stream.role == Role::Tf {
            parts.retain(|part| !is_stream_of_its_own(part, stream, streams));
        }
        let bounds = parts
            .iter()
            .filter(|part| part.wanted)
            .filter_map(|part| Bounds::of(part, timing.clocks.clock(index, part.piece)?))
            .reduce(Bounds::join);
        // Where several senders share a topic, the numbers may count the messages of all.
        let numbers = match parts.as_slice() {
            [only] if stream.role != Role::Tf => only.numbers(),
            _ => Vec::new(),
        };
        // The transforms of one sender have the times of its messages.
        let led_by = |at: usize| {
            let part: &Part<'_> = &parts[at];
            let clock = |part: &Part<'_>| timing.clocks.index(index, part.piece);
            let led = |first: &usize| {
                clock(&parts[*first]) == clock(part) && parts[*first].has_times_of(part)
            };
            (0..at).find(led).unwrap_or(at)
        };
        let leaders: Vec<usize> = (0..parts.len()).map(led_by).collect();
        let paced = leaders.par_iter().enumerate().map(|(at, leader)| {
            let clock = timing.clocks.clock(index, parts[at].piece)?;
            (at == *leader).then(|| parts[at].paced(clock, &motion))
        });
        let paced: Vec<Option<Cadence>> = paced.collect();
        let cadence = |(part, leader): (&Part<'_>, &usize)| {
            let rounded = timing.clocks.rounded_stamps(index, part.piece);
            let cadence = part.cadence(paced[*leader].as_ref()?);
            Some(Cadence { tick_s: rounded.map(|own| own.tick_s).or(cadence.tick_s), ..cadence })
        };
        let parts = parts.par_iter().zip(&leaders).filter_map(cadence);
        let rhythm = Rhythm { stream: index, parts: parts.collect(), extent: None };
        Some(((rhythm, bounds), numbers))
    };
    let found: Vec<_> = streams.par_iter().enumerate().filter_map(rhythm).collect();
    let (mut rhythms, counted): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    // What goes on under another frame_id has not ended.
    let with_others = |(rhythm, own): &(Rhythm, Option<Bounds>)| {
        let stream = &streams[rhythm.stream];
        let others = rhythms.iter().filter(|(other, _)| {
            other.stream != rhythm.stream && is_relabelled(stream, &streams[other.stream], streams)
        });
        let all = others.filter_map(|(_, bounds)| *bounds).chain(*own).reduce(Bounds::join);
        all.filter(|_| is_expected(stream))
    };
    let bounds: Vec<Option<Bounds>> = rhythms.iter().map(with_others).collect();
    let ends = Ends::of(&bounds);
    for (index, (rhythm, _)) in rhythms.iter_mut().enumerate() {
        rhythm.extent = extent(&bounds, &ends, index, &motion);
        let own = &streams[rhythm.stream];
        let came = || {
            let others = streams.iter().enumerate().filter(|(other, _)| *other != rhythm.stream);
            let others = others.filter(|(_, other)| is_relabelled(own, other, streams));
            let mut came: Vec<Stamp> = others
                .flat_map(|(other, _)| timing.clocks.rows(streams, other, 0))
                .map(|(stamp, _)| stamp)
                .collect();
            came.sort_unstable();
            came
        };
        if let (true, [only]) = (rhythm.has_relabelled(streams), rhythm.parts.as_mut_slice()) {
            only.fill_holes(&came());
        }
        if let [only] = rhythm.parts.as_mut_slice() {
            only.skipped = numbers::skipped(&counted, index);
        }
    }
    rhythms.into_iter().map(|(rhythm, _)| rhythm).collect()
}

/// Whether the rows of a stream come in a rhythm that may be looked at.
fn has_rhythm(stream: &Stream) -> bool {
    match stream.role {
        Role::Joints
        | Role::Pose
        | Role::Candidate { .. }
        | Role::Reference
        | Role::Target
        | Role::Tf
        | Role::Imu
        | Role::Unassigned => true,
        Role::TfStatic | Role::Description | Role::Ignored => false,
    }
}

/// Whether a stream must be there from the first to the last of the run.
fn is_expected(stream: &Stream) -> bool {
    matches!(stream.role, Role::Joints | Role::Pose | Role::Candidate { .. } | Role::Tf | Role::Imu)
}

/// Whether two streams are the poses of one body on one topic, in other frames.
fn is_relabelled(stream: &Stream, other: &Stream, streams: &[Stream]) -> bool {
    stream.topic == other.topic
        && stream.child_frame_id == other.child_frame_id
        && stream.frame_id != other.frame_id
        && [stream, other].iter().all(|one| matches!(one.columns, Some(Columns::Poses(_))))
        && !streams.iter().any(|tf| tf.role == Role::Tf && tf.topic == stream.topic)
}

/// Whether a stream is a transform that is looked at with the others of its TF topic.
fn is_within_tf(stream: &Stream, streams: &[Stream]) -> bool {
    !matches!(stream.role, Role::Tf | Role::Pose | Role::Candidate { .. })
        && streams.iter().any(|other| other.role == Role::Tf && other.topic == stream.topic)
}

/// Whether a transform of TF topic `stream` is listed as a measured pose beside it.
fn is_stream_of_its_own(part: &Part<'_>, stream: &Stream, streams: &[Stream]) -> bool {
    streams.iter().any(|other| {
        matches!(other.role, Role::Pose | Role::Candidate { .. })
            && other.topic == stream.topic
            && part.frame == Some(other.child_frame_id.as_str())
    })
}

impl Part<'_> {
    /// What its times alone tell.
    fn paced(&self, clock: &StreamClock, motion: &Motion) -> Cadence {
        let mut cadence = Cadence {
            rows: self.rows.len(),
            stamped: clock.stamps == HeaderStamps::Sound,
            ..Cadence::default()
        };
        let stamped = |row: usize| Some((clock.stamp_of(self.times, row)?, self.times.log[row]));
        let mut times: Vec<(Stamp, i64)> = Vec::with_capacity(self.rows.len());
        times.extend(self.rows.iter().filter_map(stamped));
        if !times.is_sorted() {
            times.sort_unstable();
        }
        let coarse = Coarse::of(&times);
        match &coarse {
            Some(Coarse { finer: Some(finer), .. }) => times.clone_from(finer),
            _ => times.dedup_by_key(|(stamp, _)| *stamp),
        }
        let pace = Pace::of(&times);
        cadence.period_s = pace.as_ref().map(|pace| pace.period_s);
        cadence.tick_s = coarse.as_ref().map(|coarse| coarse.tick_s);
        let is_blurred = coarse.is_some_and(|coarse| coarse.is_blurred);
        if let Some(pace) = &pace {
            cadence.is_regular = pace.is_regular && !is_blurred;
            let intervals = Intervals { times: &times, pace, motion };
            cadence.holes = intervals.holes();
            cadence.bunched = intervals.bunched();
            cadence.lulls = intervals.lulls();
        }
        if cadence.stamped {
            let offset = match clock.clock {
                Clock::Header => clock.alignment.map_or(0, |alignment| alignment.offset_nanos),
                Clock::Log | Clock::Publish => 0,
            };
            cadence.steps_back = self.steps_back(offset);
        }
        cadence
    }

    /// All that there is to say, by what times like its own tell.
    fn cadence(&self, paced: &Cadence) -> Cadence {
        let (repeats, conflicts) = if paced.stamped { self.repeated() } else { (0, 0) };
        Cadence {
            frame: self.frame.map(str::to_owned),
            wanted: self.wanted,
            repeats,
            conflicts,
            ..paced.clone()
        }
    }

    /// Rows whose header has a stamp, in the order of receipt.
    fn stamped(&self) -> impl Iterator<Item = (usize, i64)> {
        let rows = self.rows.iter().map(|row| (row, self.times.header[row]));
        rows.filter(|(_, stamp)| *stamp != 0)
    }

    /// The numbers of its rows, in the order of receipt; none where not each row has one.
    fn numbers(&self) -> Vec<u32> {
        let numbers = &self.times.sequence;
        self.rows.iter().map_while(|row| numbers.get(row).copied()).collect()
    }

    /// Where stamps step back: what stands before the step, and its size, s.
    fn steps_back(&self, offset_nanos: i64) -> Vec<(Stamp, f64)> {
        let mut steps = Vec::new();
        let mut before: Option<i64> = None;
        for (_, stamp) in self.stamped() {
            if let Some(before) = before.filter(|before| stamp < *before) {
                let at = Stamp::from_nanos(before.saturating_add(offset_nanos));
                steps.push((at, seconds(before.saturating_sub(stamp))));
            }
            before = Some(stamp);
        }
        steps
    }

    /// How many rows repeat the stamp of an earlier row: with the same content, with other.
    fn repeated(&self) -> (usize, usize) {
        if self.stamped().is_sorted_by(|a, b| a.1 < b.1) {
            return (0, 0);
        }
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
