//! Selects the clock of each stream and aligns streams on different clocks.

use std::ops::RangeInclusive;

use crate::stream::Times;
use crate::time::{Clock, Stamp, seconds};

/// State of a stream's header stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeaderStamps {
    /// Increasing; a few may be zero, see [`StreamClock::zero`].
    Sound,
    /// The message type has no header.
    Absent,
    /// At least half are unset.
    Zero,
    /// All are equal.
    Constant,
    /// Most are less than the previous stamp.
    Backward,
}

/// Clock of a stream's header stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Epoch {
    /// The clock of most streams, within the maximum latency of the recorder's.
    Common,
    /// Not the clock of most streams.
    Foreign,
    /// The common clock, but not the recorder's: simulation or replay.
    CommonButNotTheRecorders,
}

/// How a stream was aligned to the clock of most streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Offset added to every stamp, ns. An integer, because clocks may be decades apart.
    pub offset_nanos: i64,
    /// Standard error of the offset, s: typical minus minimum transport delay of both streams.
    pub spread_s: f64,
    /// Whether the offset comes from the motion, which leaves the delay unknown.
    pub is_by_motion: bool,
}

/// Clock of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamClock {
    /// Index of the stream.
    pub stream: usize,
    /// Child frame of the group's first transform, if a TF topic uses several clocks.
    pub frame: Option<String>,
    /// Clock of the rows.
    pub clock: Clock,
    /// State of the header stamps.
    pub stamps: HeaderStamps,
    /// Number of rows.
    pub rows: u64,
    /// Number of zero header stamps.
    pub zero: u64,
    /// Whether the first received header stamp is zero.
    pub begins_at_zero: bool,
    /// Valid times, ns; others are discarded.
    pub valid_range: RangeInclusive<i64>,
    /// Number of rows outside that range.
    pub out_of_range: u64,
    /// Median of log time minus header stamp, s; `None` if the headers are not [`HeaderStamps::Sound`].
    pub log_minus_header_s: Option<f64>,
    /// 1 % quantile of the same, s; negative if received before the stamps.
    pub soonest_s: Option<f64>,
    /// Clock of the header stamps.
    pub epoch: Epoch,
    /// Alignment, if the stamps were shifted.
    pub alignment: Option<Alignment>,
}

impl StreamClock {
    /// Rows with a valid stamp on the stream's clock.
    pub fn rows_of(&self, times: &Times) -> impl Iterator<Item = (Stamp, usize)> {
        let rows = times.nanos_on(self.clock).iter().zip(0..);
        rows.filter_map(move |(nanos, row)| Some((self.stamp(*nanos)?, row)))
    }

    /// Stamp of one row. `None` if it has none on the stream's clock, or does not exist.
    pub fn stamp_of(&self, times: &Times, row: usize) -> Option<Stamp> {
        self.stamp(*times.nanos_on(self.clock).get(row)?)
    }

    fn stamp(&self, nanos: i64) -> Option<Stamp> {
        let offset = self.alignment.map_or(0, |alignment| alignment.offset_nanos);
        let is_set = self.clock != Clock::Header || nanos != 0;
        let is_valid = is_set && self.valid_range.contains(&nanos);
        is_valid.then(|| Stamp::from_nanos(nanos.saturating_add(offset)))
    }
}

pub(super) struct ClockSource<'a> {
    pub stream: usize,
    pub frame: Option<&'a str>,
    /// Times of all rows, per transform.
    pub times: Vec<&'a Times>,
    pub has_header: bool,
    /// Joint states break ties.
    pub is_joints: bool,
    /// Its receive times come from its motion.
    pub is_aligned_by_motion: bool,
}

impl ClockSource<'_> {
    fn rows(&self) -> usize {
        self.times.iter().map(|times| times.len()).sum()
    }

    fn header_stamps(&self) -> (HeaderStamps, usize) {
        let stamps = || self.times.iter().flat_map(|times| &times.header);
        let (rows, zero) = (self.rows(), stamps().filter(|&&stamp| stamp == 0).count());
        let back = |times: &Times| times.header.windows(2).filter(|pair| pair[1] < pair[0]).count();
        let steps_back: usize = self.times.iter().map(|times| back(times)).sum();
        let is_constant = || stamps().all(|stamp| Some(stamp) == stamps().next());
        let state = if !self.has_header {
            HeaderStamps::Absent
        } else if 2 * zero >= rows.max(1) {
            HeaderStamps::Zero
        } else if rows > 1 && is_constant() {
            HeaderStamps::Constant
        } else if self.times.iter().all(|times| times.log.is_sorted()) && 2 * steps_back > rows {
            HeaderStamps::Backward
        } else {
            HeaderStamps::Sound
        };
        (state, zero)
    }

    fn begins_at_zero(&self) -> bool {
        let rows = self.times.iter().flat_map(|times| times.log.iter().zip(&times.header));
        rows.min_by_key(|(received, _)| **received).is_some_and(|(_, stamp)| *stamp == 0)
    }

    fn nanos(&self, clock: Clock) -> impl Iterator<Item = i64> {
        let nanos = self.times.iter().flat_map(move |times| times.nanos_on(clock)).copied();
        nanos.filter(move |nanos| clock != Clock::Header || *nanos != 0)
    }

    /// Valid range: the central 90 % of the rows, extended by a day or 100 times their span. A single far
    /// stamp would else extend the run by centuries.
    fn valid_range(&self, clock: Clock) -> RangeInclusive<i64> {
        const MIN_MARGIN_NS: i64 = 86_400_000_000_000;
        /// Fewer rows are not checked; more do not improve the estimate.
        const CHECKED_ROWS: RangeInclusive<usize> = 20..=100_000;
        let every = self.rows().div_ceil(*CHECKED_ROWS.end()).max(1);
        let mut nanos: Vec<i64> = self.nanos(clock).step_by(every).collect();
        if nanos.len() < *CHECKED_ROWS.start() {
            return i64::MIN..=i64::MAX;
        }
        let (low, high) = (nanos.len() / 20, nanos.len() - 1 - nanos.len() / 20);
        let first = *nanos.select_nth_unstable(low).1;
        let last = *nanos.select_nth_unstable(high).1;
        let margin = last.saturating_sub(first).saturating_mul(100).max(MIN_MARGIN_NS);
        first.saturating_sub(margin)..=last.saturating_add(margin)
    }

    fn count_outside(&self, clock: Clock, near: &RangeInclusive<i64>) -> u64 {
        self.nanos(clock).filter(|nanos| !near.contains(nanos)).count() as u64
    }

    /// Log time minus time on `clock`, of rows with a stamp.
    fn delay(&self, clock: Clock) -> Option<DelayStats> {
        const MAX_DELAY_ROWS: usize = 100_000;
        let rows = self.times.iter().flat_map(|times| times.log.iter().zip(times.nanos_on(clock)));
        let rows = rows.step_by(self.rows().div_ceil(MAX_DELAY_ROWS).max(1));
        let stamped = rows.filter(|(_, stamp)| clock != Clock::Header || **stamp != 0);
        DelayStats::from_delays(stamped.map(|(log, stamp)| log.saturating_sub(*stamp)).collect())
    }
}

/// Groups the transforms of a TF topic by clock.
///
/// Each is given by child frame and times. A group has one kind of stamps, and delays within
/// `max_latency_s` of each other. Returns each group with its transforms' indices.
pub(super) fn group_by_clock<'a>(
    stream: usize,
    transforms: impl Iterator<Item = (&'a str, &'a Times)>,
    max_latency_s: f64,
) -> Vec<(ClockSource<'a>, Vec<usize>)> {
    let mut groups: Vec<(ClockSource<'a>, Vec<usize>)> = Vec::new();
    let mut seen: Vec<(HeaderStamps, Option<DelayStats>)> = Vec::new();
    for (index, (child, times)) in transforms.enumerate() {
        let frame = Some(child);
        let alone = ClockSource {
            stream,
            frame,
            times: vec![times],
            has_header: true,
            is_joints: false,
            is_aligned_by_motion: false,
        };
        let (stamps, _) = alone.header_stamps();
        let delay = alone.delay(Clock::Header);
        let fits = |(other, group): &(HeaderStamps, Option<DelayStats>)| {
            let close = delay.zip(*group).is_some_and(|(a, b)| a.agrees(b, max_latency_s));
            stamps == *other && (stamps != HeaderStamps::Sound || close)
        };
        match seen.iter().position(fits) {
            Some(group) => {
                groups[group].0.times.push(times);
                groups[group].1.push(index);
            }
            None => {
                seen.push((stamps, delay));
                groups.push((alone, vec![index]));
            }
        }
    }
    if let [(whole, _)] = groups.as_mut_slice() {
        whole.frame = None;
    }
    groups
}

#[derive(Clone, Copy, Debug)]
struct DelayStats {
    median: i64,
    /// 1 % quantile: near the minimum, robust against one stamp from the future.
    floor: i64,
    /// Of the central 90 %, like the valid range of stamps.
    usual: [i64; 2],
}

impl DelayStats {
    fn from_delays(mut delays: Vec<i64>) -> Option<Self> {
        let at = |part: usize| delays.len() * part / 100;
        let [low, first, middle, last] = [1, 5, 50, 95].map(at);
        if delays.is_empty() {
            return None;
        }
        let mut quantile = |at: usize| *delays.select_nth_unstable(at).1;
        Some(Self {
            median: quantile(middle),
            floor: quantile(low),
            usual: [first, last].map(quantile),
        })
    }

    fn spread_s(self) -> f64 {
        seconds(self.median.saturating_sub(self.floor))
    }

    const ZERO: Self = Self { median: 0, floor: 0, usual: [0; 2] };

    /// Whether some usual delays of both are within the limit of each other. A clock that is set in mid-run is the common clock
    /// before or after.
    fn agrees(self, other: Self, limit_s: f64) -> bool {
        let ([first, last], [other_first, other_last]) = (self.usual, other.usual);
        let apart = first.saturating_sub(other_last).max(other_first.saturating_sub(last));
        seconds(apart) <= limit_s
    }
}

/// Selects the clock of every stream, and aligns those on other clocks.
///
/// A stream is on another clock if all its delays to the recorder differ by more than `max_latency_s`.
/// Alignment uses the minimum of log time minus stamp: the clock offset plus the minimum transport delay.
/// Subtracting that of a stream on the common clock removes the delay. Streams on log time are aligned
/// as well if the common clock is not the recorder's.
pub(super) fn select_clocks(
    sources: &[ClockSource<'_>],
    wanted: Clock,
    max_latency_s: f64,
) -> Vec<StreamClock> {
    let mut clocks = Vec::with_capacity(sources.len());
    let mut delays = Vec::with_capacity(sources.len());
    for source in sources {
        let (stamps, zero) = source.header_stamps();
        let falls_back = wanted == Clock::Header && stamps != HeaderStamps::Sound;
        let clock = if falls_back { Clock::Log } else { wanted };
        let is_sound = stamps == HeaderStamps::Sound;
        let near = source.valid_range(clock);
        let header = is_sound.then(|| source.delay(Clock::Header)).flatten();
        delays.push(if clock == Clock::Header { header } else { source.delay(clock) });
        clocks.push(StreamClock {
            stream: source.stream,
            frame: source.frame.map(str::to_owned),
            clock,
            stamps,
            rows: source.rows() as u64,
            zero: zero as u64,
            begins_at_zero: source.begins_at_zero(),
            out_of_range: source.count_outside(clock, &near),
            valid_range: near,
            log_minus_header_s: header.map(|delay| seconds(delay.median)),
            soonest_s: header.map(|delay| seconds(delay.floor)),
            epoch: Epoch::Common,
            alignment: None,
        });
    }
    if wanted == Clock::Header {
        align(sources, &mut clocks, &delays, max_latency_s);
    }
    clocks
}

fn align(
    sources: &[ClockSource<'_>],
    clocks: &mut [StreamClock],
    delays: &[Option<DelayStats>],
    max_latency_s: f64,
) {
    let votes: Vec<(usize, DelayStats)> = (0..clocks.len())
        .filter(|&i| clocks[i].clock == Clock::Header)
        .filter_map(|i| Some((i, delays[i]?)))
        .collect();
    let agreeing = |delay: DelayStats| {
        votes.iter().filter(|(_, other)| delay.agrees(*other, max_latency_s)).count()
    };
    // Joint states, then the earlier stream.
    let rank = |&&(i, delay): &&(usize, DelayStats)| {
        (agreeing(delay), sources[i].is_joints, std::cmp::Reverse(i))
    };
    let Some(&(_, common)) = votes.iter().max_by_key(rank) else { return };
    let is_recorders = common.agrees(DelayStats::ZERO, max_latency_s);
    for ((clock, delay), source) in clocks.iter_mut().zip(delays).zip(sources) {
        let Some(delay) = delay else { continue };
        let agrees = delay.agrees(common, max_latency_s);
        if clock.clock == Clock::Header {
            clock.epoch = match (agrees, is_recorders) {
                (false, _) => Epoch::Foreign,
                (true, true) => Epoch::Common,
                (true, false) => Epoch::CommonButNotTheRecorders,
            };
        }
        if !agrees {
            clock.alignment = Some(Alignment {
                offset_nanos: delay.floor.saturating_sub(common.floor),
                spread_s: match source.is_aligned_by_motion {
                    true => max_latency_s,
                    false => delay.spread_s().hypot(common.spread_s()),
                },
                is_by_motion: source.is_aligned_by_motion,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOINTS: usize = 7;
    const START: i64 = 1_760_000_000_000_000_000;

    /// 1000 rows at 100 Hz, delayed by 100 µs to 2.1 ms; `header` changes the true stamps.
    fn times(header: impl Fn(usize, i64) -> i64) -> Times {
        let mut times = Times::default();
        for row in 0..1000 {
            let truth = START + row as i64 * 10_000_000;
            let delay = 100_000 + (row as i64 * 7919 % 1000) * 2_000;
            times.push(header(row, truth), truth + delay, truth + delay / 2);
        }
        times
    }

    fn source(stream: usize, times: &Times) -> ClockSource<'_> {
        ClockSource {
            stream,
            frame: None,
            times: vec![times],
            has_header: true,
            is_joints: stream == JOINTS,
            is_aligned_by_motion: false,
        }
    }

    #[test]
    fn a_foreign_clock_is_aligned_to_the_others_within_its_spread() {
        let good = times(|_, truth| truth);
        let foreign = times(|_, truth| truth - 1_700_000_000_000_000_000);
        let sources = [source(0, &foreign), source(JOINTS, &good), source(2, &good)];
        let clocks = select_clocks(&sources, Clock::Header, 5.0);
        assert_eq!(
            clocks.iter().map(|c| c.epoch).collect::<Vec<_>>(),
            [Epoch::Foreign, Epoch::Common, Epoch::Common]
        );
        let alignment = clocks[0].alignment.unwrap();
        assert_eq!(alignment.offset_nanos, 1_700_000_000_000_000_000);
        assert!((0.0005..0.003).contains(&alignment.spread_s), "{alignment:?}");
        let first = clocks[0].stamp_of(&foreign, 0).unwrap();
        assert_eq!(first, Stamp::from_nanos(START));
        assert_eq!(clocks[1].alignment, None);
    }

    #[test]
    fn a_clock_that_is_set_in_mid_run_is_not_aligned() {
        let good = times(|_, truth| truth);
        for from in [300, 700] {
            let set = times(|row, truth| truth + if row < from { 0 } else { 60_000_000_000 });
            let sources = [source(0, &set), source(JOINTS, &good), source(2, &good)];
            let clocks = select_clocks(&sources, Clock::Header, 5.0);
            assert!(clocks.iter().all(|clock| clock.alignment.is_none()), "{clocks:?}");
        }
    }

    #[test]
    fn a_foreign_clock_with_a_few_good_stamps_is_aligned() {
        let good = times(|_, truth| truth);
        let foreign = times(|row, truth| if row < 20 { truth } else { truth - 100_000_000_000 });
        let clocks =
            select_clocks(&[source(JOINTS, &good), source(0, &foreign)], Clock::Header, 5.0);
        assert_eq!(clocks[1].epoch, Epoch::Foreign);
    }

    #[test]
    fn absurd_stamps_are_discarded_and_a_foreign_clock_is_kept() {
        let odd = |row: usize, truth: i64| match row {
            500 => i64::MAX,
            501 => 1_000_000_000,
            row if row % 2 == 0 => truth,
            _ => truth + 3_600_000_000_000,
        };
        let odd = times(odd);
        let clocks = select_clocks(&[source(JOINTS, &odd)], Clock::Header, 5.0);
        assert_eq!((clocks[0].out_of_range, clocks[0].rows), (2, 1000));
        assert_eq!((clocks[0].stamp_of(&odd, 500), clocks[0].stamp_of(&odd, 501)), (None, None));
        assert_eq!(clocks[0].rows_of(&odd).count(), 998);
        let foreign = times_of_1970();
        let clocks = select_clocks(&[source(JOINTS, &foreign)], Clock::Header, 5.0);
        assert_eq!(clocks[0].out_of_range, 0);
    }

    fn times_of_1970() -> Times {
        times(|_, truth| truth - START + 1_000_000_000)
    }

    #[test]
    fn a_delay_within_the_maximum_latency_is_not_compensated() {
        let good = times(|_, truth| truth);
        let late = times(|_, truth| truth + 1_500_000_000);
        let sources = [source(JOINTS, &good), source(0, &late)];
        let clocks = select_clocks(&sources, Clock::Header, 5.0);
        assert!(
            clocks.iter().all(|clock| clock.alignment.is_none() && clock.epoch == Epoch::Common)
        );
    }

    #[test]
    fn joint_states_decide_between_two_disagreeing_clocks() {
        let good = times(|_, truth| truth);
        let foreign = times(|_, truth| truth - 100_000_000_000);
        let sources = [source(0, &good), source(JOINTS, &foreign)];
        let clocks = select_clocks(&sources, Clock::Header, 5.0);
        assert_eq!(clocks[0].epoch, Epoch::Foreign);
        assert_eq!(clocks[1].epoch, Epoch::CommonButNotTheRecorders);
        assert_eq!(clocks[0].alignment.unwrap().offset_nanos, -100_000_000_000);
    }

    #[test]
    fn zero_constant_and_missing_stamps_fall_back_to_log_time() {
        let zero = times(|_, _| 0);
        let constant = times(|_, _| START);
        let some_zero = times(|row, truth| if row % 10 == 0 { 0 } else { truth });
        let mut sources =
            [source(0, &zero), source(1, &constant), source(2, &some_zero), source(3, &zero)];
        sources[3].has_header = false;
        let clocks = select_clocks(&sources, Clock::Header, 5.0);
        let seen: Vec<_> = clocks.iter().map(|c| (c.clock, c.stamps, c.zero)).collect();
        assert_eq!(
            seen,
            [
                (Clock::Log, HeaderStamps::Zero, 1000),
                (Clock::Log, HeaderStamps::Constant, 0),
                (Clock::Header, HeaderStamps::Sound, 100),
                (Clock::Log, HeaderStamps::Absent, 1000),
            ]
        );
        assert_eq!(clocks[0].stamp_of(&zero, 3), Some(Stamp::from_nanos(zero.log[3])));
        assert_eq!(clocks[2].stamp_of(&some_zero, 10), None);
    }

    #[test]
    fn log_time_is_aligned_to_simulated_time() {
        let simulated = times(|_, truth| truth - START);
        let array = times(|_, _| 0);
        let mut sources = [source(JOINTS, &simulated), source(1, &array)];
        sources[1].has_header = false;
        let clocks = select_clocks(&sources, Clock::Header, 5.0);
        assert_eq!(clocks[0].epoch, Epoch::CommonButNotTheRecorders);
        let first = clocks[1].stamp_of(&array, 0).unwrap();
        assert!(seconds(first.nanos()).abs() < 0.003, "{first}");
    }

    #[test]
    fn transforms_of_one_topic_are_grouped_by_clock() {
        let good = times(|_, truth| truth);
        let foreign = times(|_, truth| truth - 100_000_000_000);
        let unset = times(|_, _| 0);
        let edges = [("a", &good), ("b", &foreign), ("c", &good), ("d", &unset), ("e", &unset)];
        let groups = group_by_clock(3, edges.into_iter(), 5.0);
        let members: Vec<_> =
            groups.iter().map(|(source, of)| (source.frame, of.as_slice())).collect();
        assert_eq!(members, [(Some("a"), &[0, 2][..]), (Some("b"), &[1]), (Some("d"), &[3, 4])]);
        assert_eq!(
            group_by_clock(3, [("a", &good), ("c", &good)].into_iter(), 5.0)[0].0.frame,
            None
        );
    }

    #[test]
    fn other_selected_clocks_are_used_unchanged() {
        let foreign = times(|_, truth| truth - 100_000_000_000);
        let clocks = select_clocks(&[source(JOINTS, &foreign)], Clock::Log, 5.0);
        assert_eq!((clocks[0].clock, clocks[0].alignment), (Clock::Log, None));
    }
}
