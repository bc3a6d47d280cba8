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

use std::collections::{HashMap, HashSet};

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
use super::publishers::TwoPublishers;
use super::role::Role;
use super::streams::{Stream, tf_topics};
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
    /// Of these, steps after which the stamps stay behind: the clock was set back, no row was late.
    pub set_back: usize,
    /// Rows that repeat stamp and content.
    pub repeats: usize,
    /// Of these, rows that arrive when a new one is due: an old row was sent in its place.
    pub stale: usize,
    /// Rows that repeat only the stamp.
    pub conflicts: usize,
    /// Of these, rows with the stamp of both rows before: the stamp stands still.
    pub held: usize,
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
    let tf_topics = tf_topics(streams);
    // Transforms that are also separate streams.
    let separate = streams.iter().filter(|stream| is_tool_pose(stream));
    let separate: HashSet<(&str, &str)> = separate.map(body).collect();
    let rhythm = |(index, stream): (usize, &Stream)| {
        // Other transforms are handled with their TF topic.
        let is_own = matches!(stream.role, Role::Tf) || is_tool_pose(stream);
        let has_rhythm = has_rhythm(stream) && (is_own || !tf_topics.contains(&stream.topic));
        let columns = stream.columns.as_ref().filter(|_| has_rhythm)?;
        let mut parts: Vec<CadencePart<'_>> = split_parts(columns, arms)
            .into_iter()
            .flat_map(|part| {
                let publishers = &timing.sample_filter.publishers;
                match TwoPublishers::of_part(publishers, index, part.piece) {
                    Some(two) => Vec::from(part.by_publisher(&two.second_rows)),
                    None => vec![part],
                }
            })
            .collect();
        if stream.role == Role::Tf {
            parts.retain(|part| {
                !part.frame.is_some_and(|frame| separate.contains(&(&stream.topic, frame)))
            });
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
    let (mut rhythms, numbers): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    let skipped_numbers = sequence_numbers::count_skipped(&numbers);
    let mut bounds_by_stream: Vec<Option<PartBounds>> = vec![None; streams.len()];
    for (rhythm, bounds) in &rhythms {
        bounds_by_stream[rhythm.stream] = *bounds;
    }
    // Poses of one body on one topic, perhaps in several frames.
    let mut bodies: HashMap<(&str, &str), Vec<usize>> = HashMap::new();
    for (index, stream) in streams.iter().enumerate() {
        if matches!(stream.columns, Some(Columns::Poses(_))) && !tf_topics.contains(&stream.topic) {
            bodies.entry(body(stream)).or_default().push(index);
        }
    }
    let relabelled = |index: usize| -> Vec<usize> {
        let own = &streams[index];
        let of_body =
            bodies.get(&body(own)).filter(|of_body| of_body.binary_search(&index).is_ok());
        let is_other = |other: &&usize| streams[**other].frame_id != own.frame_id;
        of_body.into_iter().flatten().filter(is_other).copied().collect()
    };
    // A stream that continues with another frame_id has not ended.
    let with_others = |(rhythm, own): &(Rhythm, Option<PartBounds>)| {
        let others = relabelled(rhythm.stream).into_iter();
        let bounds = others.filter_map(|other| bounds_by_stream[other]).chain(*own);
        bounds.reduce(PartBounds::join).filter(|_| is_expected(&streams[rhythm.stream]))
    };
    let bounds: Vec<Option<PartBounds>> = rhythms.iter().map(with_others).collect();
    let ends = SortedEnds::collect(&bounds);
    for (index, (rhythm, _)) in rhythms.iter_mut().enumerate() {
        rhythm.extent = compare_extent(&bounds, &ends, index, &motion);
        let [only] = rhythm.parts.as_mut_slice() else { continue };
        only.skipped_numbers = skipped_numbers[index];
        if only.missing_rows.is_empty() {
            continue;
        }
        let others = relabelled(rhythm.stream);
        if !others.is_empty() {
            let rows = others.into_iter().flat_map(|other| timing.clocks.rows(streams, other, 0));
            let mut other_stamps: Vec<Stamp> = rows.map(|(stamp, _)| stamp).collect();
            other_stamps.sort_unstable();
            only.remove_filled(&other_stamps);
        }
    }
    rhythms.into_iter().map(|(rhythm, _)| rhythm).collect()
}

fn has_rhythm(stream: &Stream) -> bool {
    !matches!(stream.role, Role::TfStatic | Role::Description | Role::Ignored)
}

fn is_expected(stream: &Stream) -> bool {
    matches!(stream.role, Role::Joints | Role::Pose | Role::Candidate { .. } | Role::Tf | Role::Imu)
}

fn is_tool_pose(stream: &Stream) -> bool {
    matches!(stream.role, Role::Pose | Role::Candidate { .. })
}

/// Topic and child frame of a stream.
fn body(stream: &Stream) -> (&str, &str) {
    (&stream.topic, &stream.child_frame_id)
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
            (cadence.steps_back, cadence.set_back) = self.steps_back(offset, cadence.period_s);
        }
        cadence
    }

    fn cadence(&self, base_cadences: &Cadence) -> Cadence {
        let cadence = Cadence {
            frame: self.frame.map(str::to_owned),
            is_audited: self.is_audited,
            ..base_cadences.clone()
        };
        if cadence.has_header_stamps { self.with_repeated(cadence) } else { cadence }
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

    /// Steps, and the number of those after which the stamps stay behind as long as at a steady rate.
    fn steps_back(&self, offset_nanos: i64, period_s: Option<f64>) -> (Vec<(Stamp, f64)>, usize) {
        /// Fewer rows may be a queue that is sent late.
        const MIN_ROWS_BEHIND: f64 = 3.0;
        let stamps: Vec<i64> = self.stamped_rows().map(|(_, stamp)| stamp).collect();
        let (mut steps, mut set_back) = (Vec::new(), 0);
        for (row, pair) in stamps.windows(2).enumerate().filter(|(_, pair)| pair[1] < pair[0]) {
            let by_s = seconds(pair[0].saturating_sub(pair[1]));
            steps.push((Stamp::from_nanos(pair[0].saturating_add(offset_nanos)), by_s));
            // Half of the rows that a steady clock needs to make up for the step.
            let due = period_s.map_or(f64::INFINITY, |period_s| (0.5 * by_s / period_s).ceil());
            let behind = stamps[row + 1..].iter().take_while(|stamp| **stamp < pair[0]);
            let due = due.max(MIN_ROWS_BEHIND);
            set_back += usize::from(behind.take(due as usize).count() as f64 >= due);
        }
        (steps, set_back)
    }

    /// Counts rows that repeat a stamp, with the same and with different content.
    fn with_repeated(&self, mut cadence: Cadence) -> Cadence {
        /// Minimum time since the previous row for a row in the place of a new one, in periods.
        const MIN_TURN_PERIODS: f64 = 0.75;
        if self.stamped_rows().is_sorted_by(|a, b| a.1 < b.1) {
            return cadence;
        }
        let turn_s = cadence.period_s.map_or(f64::INFINITY, |own| MIN_TURN_PERIODS * own);
        let mut first: HashMap<i64, usize> = HashMap::new();
        // Stamps of the two rows before, and the receive time of the last one.
        let (mut before, mut received) = ([None; 2], None);
        for (row, stamp) in self.stamped_rows() {
            let now = self.times.log[row];
            let is_in_turn =
                received.is_some_and(|last| seconds(now.saturating_sub(last)) > turn_s);
            match first.get(&stamp) {
                Some(&earlier) if self.values.is_same_measurement(earlier, row) => {
                    cadence.repeats += 1;
                    cadence.stale += usize::from(is_in_turn);
                }
                Some(_) => {
                    cadence.conflicts += 1;
                    cadence.held += usize::from(before == [Some(stamp); 2]);
                }
                None => {
                    first.insert(stamp, row);
                }
            }
            (before, received) = ([before[1], Some(stamp)], Some(now));
        }
        cadence
    }
}
