//! Regularity of a stream's rows: decreasing stamps, repeats, holes and reduced rates.
//!
//! A header stamp is the time of the content, a receive time its arrival. A hole in the stamps must also be
//! one in the receive times, or the clock was stepped. The rules decide which are faults.

mod coarse_clock;
mod extent;
mod intervals;
mod motion;
mod parts;
mod sequence_numbers;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use rayon::prelude::*;

use crate::stream::Columns;
use crate::time::{Clock, Stamp, seconds};

use self::coarse_clock::CoarseClock;
use self::extent::{PartBounds, SortedEnds, compare_extent};
use self::intervals::{Intervals, RowPeriod};
use self::motion::ArmMotion;
use self::parts::{CadencePart, split_parts};
use super::arm::Arm;
use super::clock::{HeaderStamps, StreamClock};
use super::joints::JointTopic;
use super::role::Role;
use super::streams::Stream;
use super::timing::Timing;

pub use self::extent::StreamExtent;
pub use self::intervals::{MissingRows, RateSpan};

/// Regularity of a stream, of one transform, or of one joint state sender.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cadence {
    /// Child frame of the transform.
    pub frame: Option<String>,
    /// Whether it should be regular; false for transforms outside an arm.
    pub is_audited: bool,
    /// Number of rows.
    pub rows: usize,
    /// Typical interval, s; `None` with fewer than three rows.
    pub period_s: Option<f64>,
    /// Whether intervals are near multiples of the period.
    pub is_regular: bool,
    /// Tick of a coarse stamp clock, s. Finer receive times then give the rhythm.
    pub tick_s: Option<f64>,
    /// Whether header stamps are present and increasing.
    pub has_header_stamps: bool,
    /// Stamps that decrease: the previous stamp, and the decrease, s.
    pub steps_back: Vec<(Stamp, f64)>,
    /// Rows that repeat stamp and content.
    pub repeats: usize,
    /// Rows that repeat only the stamp.
    pub conflicts: usize,
    /// Intervals with missing rows, in time order.
    pub missing_rows: Vec<MissingRows>,
    /// Rows within half a period of the previous one: late, not lost; each replaces a missing row.
    pub bunched: usize,
    /// Spans at a notably lower rate.
    pub slow_spans: Vec<RateSpan>,
    /// Rows missing by sequence number; `None` if unusable.
    pub skipped_numbers: Option<usize>,
}

/// Regularity of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Rhythm {
    /// Index of the stream.
    pub stream: usize,
    /// One entry per part.
    pub parts: Vec<Cadence>,
    /// Extent relative to other streams; `None` without others.
    pub extent: Option<StreamExtent>,
}

impl Rhythm {
    fn has_relabelled(&self, streams: &[Stream]) -> bool {
        let own = &streams[self.stream];
        streams.iter().any(|other| is_relabelled(own, other, streams))
    }
}

impl Cadence {
    fn remove_filled(&mut self, other_stamps: &[Stamp]) {
        self.missing_rows.retain(|hole| {
            let RateSpan { start, end, .. } = hole.span;
            let [from, to] =
                [start, end].map(|at| other_stamps.partition_point(|stamp| *stamp < at));
            let between = other_stamps[from..to.max(from)].iter().copied();
            let mut last = start;
            let silences = between.chain([end]).map(|stamp| {
                let silence_s = stamp.seconds_since(last);
                last = stamp;
                silence_s
            });
            2.0 * silences.fold(0.0, f64::max) > hole.span.seconds()
        });
    }
}

pub(super) fn measure_rhythms(
    streams: &[Stream],
    timing: &Timing,
    topics: &[JointTopic<'_>],
    arms: &[Arm],
) -> Vec<Rhythm> {
    let motion = ArmMotion::new(topics, arms);
    let rhythm = |(index, stream): (usize, &Stream)| {
        let has_rhythm = has_rhythm(stream) && !is_within_tf(stream, streams);
        let columns = stream.columns.as_ref().filter(|_| has_rhythm)?;
        let mut parts: Vec<CadencePart<'_>> = split_parts(columns, arms)
            .into_iter()
            .flat_map(|part| {
                let two = timing.sample_filter.publishers.iter();
                let mut two = two.filter(|two| (two.stream, two.piece) == (index, part.piece));
                match two.next() {
                    Some(two) => Vec::from(part.by_publisher(&two.second_rows)),
                    None => vec![part],
                }
            })
            .collect();
        if stream.role == Role::Tf {
            parts.retain(|part| !is_separate_stream(part, stream, streams));
        }
        let bounds = parts
            .iter()
            .filter(|part| part.is_audited)
            .filter_map(|part| PartBounds::measure(part, timing.clocks.clock(index, part.piece)?))
            .reduce(PartBounds::join);
        // If senders share a topic, sequence numbers may count all messages.
        let numbers = match parts.as_slice() {
            [only] if stream.role != Role::Tf => only.numbers(),
            _ => Vec::new(),
        };
        // Transforms of one sender share its message times.
        let led_by = |at: usize| {
            let part: &CadencePart<'_> = &parts[at];
            let clock = |part: &CadencePart<'_>| timing.clocks.index(index, part.piece);
            let led = |first: &usize| {
                clock(&parts[*first]) == clock(part) && parts[*first].has_times_of(part)
            };
            (0..at).find(led).unwrap_or(at)
        };
        let leaders: Vec<usize> = (0..parts.len()).map(led_by).collect();
        let base_cadences = leaders.par_iter().enumerate().map(|(at, leader)| {
            let clock = timing.clocks.clock(index, parts[at].piece)?;
            (at == *leader).then(|| parts[at].measure_period(clock, &motion))
        });
        let base_cadences: Vec<Option<Cadence>> = base_cadences.collect();
        let cadence = |(part, leader): (&CadencePart<'_>, &usize)| {
            let rounded = timing.clocks.rounded_stamps(index, part.piece);
            let cadence = part.cadence(base_cadences[*leader].as_ref()?);
            Some(Cadence { tick_s: rounded.map(|own| own.tick_s).or(cadence.tick_s), ..cadence })
        };
        let parts = parts.par_iter().zip(&leaders).filter_map(cadence);
        let rhythm = Rhythm { stream: index, parts: parts.collect(), extent: None };
        Some(((rhythm, bounds), numbers))
    };
    let found: Vec<_> = streams.par_iter().enumerate().filter_map(rhythm).collect();
    let (mut rhythms, counted): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    // A stream that continues with another frame_id has not ended.
    let with_others = |(rhythm, own): &(Rhythm, Option<PartBounds>)| {
        let stream = &streams[rhythm.stream];
        let others = rhythms.iter().filter(|(other, _)| {
            other.stream != rhythm.stream && is_relabelled(stream, &streams[other.stream], streams)
        });
        let all = others.filter_map(|(_, bounds)| *bounds).chain(*own).reduce(PartBounds::join);
        all.filter(|_| is_expected(stream))
    };
    let bounds: Vec<Option<PartBounds>> = rhythms.iter().map(with_others).collect();
    let ends = SortedEnds::collect(&bounds);
    for (index, (rhythm, _)) in rhythms.iter_mut().enumerate() {
        rhythm.extent = compare_extent(&bounds, &ends, index, &motion);
        let own = &streams[rhythm.stream];
        let other_stamps = || {
            let others = streams.iter().enumerate().filter(|(other, _)| *other != rhythm.stream);
            let others = others.filter(|(_, other)| is_relabelled(own, other, streams));
            let mut other_stamps: Vec<Stamp> = others
                .flat_map(|(other, _)| timing.clocks.rows(streams, other, 0))
                .map(|(stamp, _)| stamp)
                .collect();
            other_stamps.sort_unstable();
            other_stamps
        };
        if let (true, [only]) = (rhythm.has_relabelled(streams), rhythm.parts.as_mut_slice()) {
            only.remove_filled(&other_stamps());
        }
        if let [only] = rhythm.parts.as_mut_slice() {
            only.skipped_numbers = sequence_numbers::count_skipped(&counted, index);
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
fn is_separate_stream(part: &CadencePart<'_>, stream: &Stream, streams: &[Stream]) -> bool {
    streams.iter().any(|other| {
        matches!(other.role, Role::Pose | Role::Candidate { .. })
            && other.topic == stream.topic
            && part.frame == Some(other.child_frame_id.as_str())
    })
}

impl CadencePart<'_> {
    fn measure_period(&self, clock: &StreamClock, motion: &ArmMotion) -> Cadence {
        let mut cadence = Cadence {
            rows: self.rows.len(),
            has_header_stamps: clock.stamps == HeaderStamps::Sound,
            ..Cadence::default()
        };
        let stamped = |row: usize| Some((clock.stamp_of(self.times, row)?, self.times.log[row]));
        let mut times: Vec<(Stamp, i64)> = Vec::with_capacity(self.rows.len());
        times.extend(self.rows.iter().filter_map(stamped));
        if !times.is_sorted() {
            times.sort_unstable();
        }
        let coarse = CoarseClock::detect(&times);
        match &coarse {
            Some(CoarseClock { interpolated: Some(finer), .. }) => times.clone_from(finer),
            _ => times.dedup_by_key(|(stamp, _)| *stamp),
        }
        let pace = RowPeriod::estimate(&times);
        cadence.period_s = pace.as_ref().map(|pace| pace.period_s);
        cadence.tick_s = coarse.as_ref().map(|coarse| coarse.tick_s);
        let is_blurred = coarse.is_some_and(|coarse| coarse.is_blurred);
        if let Some(pace) = &pace {
            cadence.is_regular = pace.is_regular && !is_blurred;
            let intervals = Intervals { times: &times, pace, motion };
            cadence.missing_rows = intervals.missing_rows();
            cadence.bunched = intervals.count_bunched();
            cadence.slow_spans = intervals.slow_spans();
        }
        if cadence.has_header_stamps {
            let offset = match clock.clock {
                Clock::Header => clock.alignment.map_or(0, |alignment| alignment.offset_nanos),
                Clock::Log | Clock::Publish => 0,
            };
            cadence.steps_back = self.steps_back(offset);
        }
        cadence
    }

    fn cadence(&self, base_cadences: &Cadence) -> Cadence {
        let (repeats, conflicts) =
            if base_cadences.has_header_stamps { self.count_repeated() } else { (0, 0) };
        Cadence {
            frame: self.frame.map(str::to_owned),
            is_audited: self.is_audited,
            repeats,
            conflicts,
            ..base_cadences.clone()
        }
    }

    fn stamped_rows(&self) -> impl Iterator<Item = (usize, i64)> {
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
        for (_, stamp) in self.stamped_rows() {
            if let Some(before) = before.filter(|before| stamp < *before) {
                let at = Stamp::from_nanos(before.saturating_add(offset_nanos));
                steps.push((at, seconds(before.saturating_sub(stamp))));
            }
            before = Some(stamp);
        }
        steps
    }

    /// Rows that repeat a stamp, with the same and with different content.
    fn count_repeated(&self) -> (usize, usize) {
        if self.stamped_rows().is_sorted_by(|a, b| a.1 < b.1) {
            return (0, 0);
        }
        let mut first: HashMap<i64, usize> = HashMap::new();
        let (mut same, mut other) = (0, 0);
        for (row, stamp) in self.stamped_rows() {
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
