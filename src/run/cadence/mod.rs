//! Regularity of a stream's rows: decreasing stamps, repeats, holes and reduced rates.
//!
//! A header stamp is the time of the content, a receive time its arrival. A hole in the stamps must also be
//! one in the receive times, or the clock was stepped. The rules decide which are faults.

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

/// Regularity of a stream, of one transform, or of one joint state sender.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cadence {
    /// Child frame of the transform.
    pub frame: Option<String>,
    /// Whether it should be regular; false for transforms outside an arm.
    pub wanted: bool,
    /// Number of rows.
    pub rows: usize,
    /// Typical interval, s; `None` with fewer than three rows.
    pub period_s: Option<f64>,
    /// Whether intervals are near multiples of the period.
    pub is_regular: bool,
    /// Tick of a coarse stamp clock, s. Finer receive times then give the rhythm.
    pub tick_s: Option<f64>,
    /// Whether header stamps are present and increasing.
    pub stamped: bool,
    /// Stamps that decrease: the previous stamp, and the decrease, s.
    pub steps_back: Vec<(Stamp, f64)>,
    /// Rows that repeat stamp and content.
    pub repeats: usize,
    /// Rows that repeat only the stamp.
    pub conflicts: usize,
    /// Intervals with missing rows, in time order.
    pub holes: Vec<Hole>,
    /// Rows within half a period of the previous one: late, not lost; each replaces a missing row.
    pub bunched: usize,
    /// Spans at a notably lower rate.
    pub lulls: Vec<Stretch>,
    /// Rows missing by sequence number; `None` if unusable.
    pub skipped: Option<usize>,
}

/// Regularity of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Rhythm {
    /// Index of the stream.
    pub stream: usize,
    /// One entry per part.
    pub parts: Vec<Cadence>,
    /// Extent relative to other streams; `None` without others.
    pub extent: Option<Extent>,
}

impl Rhythm {
    fn has_relabelled(&self, streams: &[Stream]) -> bool {
        let own = &streams[self.stream];
        streams.iter().any(|other| is_relabelled(own, other, streams))
    }
}

impl Cadence {
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
                let two = timing.sample_filter.publishers.iter();
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
        // If senders share a topic, sequence numbers may count all messages.
        let numbers = match parts.as_slice() {
            [only] if stream.role != Role::Tf => only.numbers(),
            _ => Vec::new(),
        };
        // Transforms of one sender share its message times.
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
    // A stream that continues with another frame_id has not ended.
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

fn is_expected(stream: &Stream) -> bool {
    matches!(stream.role, Role::Joints | Role::Pose | Role::Candidate { .. } | Role::Tf | Role::Imu)
}

/// Whether two streams are poses of one body on one topic, in different frames.
fn is_relabelled(stream: &Stream, other: &Stream, streams: &[Stream]) -> bool {
    stream.topic == other.topic
        && stream.child_frame_id == other.child_frame_id
        && stream.frame_id != other.frame_id
        && [stream, other].iter().all(|one| matches!(one.columns, Some(Columns::Poses(_))))
        && !streams.iter().any(|tf| tf.role == Role::Tf && tf.topic == stream.topic)
}

/// Whether a stream is a transform handled with its TF topic.
fn is_within_tf(stream: &Stream, streams: &[Stream]) -> bool {
    !matches!(stream.role, Role::Tf | Role::Pose | Role::Candidate { .. })
        && streams.iter().any(|other| other.role == Role::Tf && other.topic == stream.topic)
}

/// Whether a transform of the TF topic is also a measured pose.
fn is_stream_of_its_own(part: &Part<'_>, stream: &Stream, streams: &[Stream]) -> bool {
    streams.iter().any(|other| {
        matches!(other.role, Role::Pose | Role::Candidate { .. })
            && other.topic == stream.topic
            && part.frame == Some(other.child_frame_id.as_str())
    })
}

impl Part<'_> {
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

    fn stamped(&self) -> impl Iterator<Item = (usize, i64)> {
        let rows = self.rows.iter().map(|row| (row, self.times.header[row]));
        rows.filter(|(_, stamp)| *stamp != 0)
    }

    /// Sequence numbers in receive order; empty if missing.
    fn numbers(&self) -> Vec<u32> {
        let numbers = &self.times.sequence;
        self.rows.iter().map_while(|row| numbers.get(row).copied()).collect()
    }

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

    /// Rows that repeat a stamp, with the same and with different content.
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
