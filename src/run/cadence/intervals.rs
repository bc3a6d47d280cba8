//! The intervals between the rows of a stream, held against their pace.

use super::motion::Motion;
use crate::stats::median as median_of;
use crate::time::{Stamp, seconds};

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

/// An interval between two rows that lasts longer than a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Its time.
    pub stretch: Stretch,
    /// How many rows are missing in it, at the stream's period.
    pub missing: usize,
    /// Whether nothing was received for most of it. What was received all the time had its clock set.
    pub is_silent: bool,
}

/// How far apart rows are that follow each other.
pub(super) struct Pace {
    /// The typical interval, s: the mean of those close to the median, which rounding of stamps
    /// makes one of its steps.
    pub period_s: f64,
    /// Whether nearly all intervals are close to one, two, three … periods.
    pub is_regular: bool,
    /// How many periods an interval may last although no row is missing: one, or as many as jitter reaches.
    longest: u32,
}

impl Pace {
    pub fn of(times: &[(Stamp, i64)]) -> Option<Self> {
        /// An interval this close to the median lacks no row.
        const SINGLE: f64 = 0.5;
        const CLOSE: f64 = 0.25;
        const REGULAR: f64 = 0.6;
        /// Rows of whole bursts of 2, 3, 4, 6 or 12.
        const BURSTS: usize = 12;
        /// The interval of most rows, of the mean one, if they come one by one: two rows in five may be lost.
        const USUAL: std::ops::RangeInclusive<f64> = 0.5..=1.6;
        /// As many intervals, evenly spread over all, tell the median.
        const ENOUGH: usize = 50_000;
        let intervals = || times.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0));
        let count = times.len().saturating_sub(1);
        if count < 2 {
            return None;
        }
        let mut some: Vec<f64> = intervals().step_by(count.div_ceil(ENOUGH)).collect();
        let mut median = median_of(&mut some)?;
        // Rows that come in bursts have another interval within a burst than on average.
        let blocks = times.windows(BURSTS + 1).step_by(count.div_ceil(ENOUGH));
        let mut blocks: Vec<f64> =
            blocks.map(|rows| rows[BURSTS].0.seconds_since(rows[0].0) / BURSTS as f64).collect();
        if let Some(mean) = median_of(&mut blocks).filter(|mean| !USUAL.contains(&(median / mean)))
        {
            median = mean;
        }
        let close = intervals().filter(|dt| (dt - median).abs() < SINGLE * median);
        let (sum_s, singles) =
            close.fold((0.0, 0), |(sum_s, singles), dt| (sum_s + dt, singles + 1));
        let period_s = if singles > 0 { sum_s / f64::from(singles) } else { median };
        let is_close = |dt: &f64| {
            let periods = dt / period_s;
            // Most are one period, and to round is slow.
            (periods - 1.0).abs() < CLOSE || (periods - periods.round().max(1.0)).abs() < CLOSE
        };
        let regular = intervals().filter(is_close).count();
        let is_regular = regular as f64 > REGULAR * count as f64;
        Some(Self { period_s, is_regular, longest: reached_by_jitter(times, period_s) })
    }
}

/// The number of periods that jitter alone reaches: lost rows leave whole periods, so that intervals between two
/// multiples are rarer than those at the upper one. A loop that waits between its rows has no such valley.
fn reached_by_jitter(times: &[(Stamp, i64)], period_s: f64) -> u32 {
    /// Intervals this near to a multiple are at it.
    const NEAR: f64 = 0.25;
    /// Intervals beyond this many periods are rare in any stream.
    const MOST: usize = 8;
    let periods: Vec<f64> =
        times.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0) / period_s).collect();
    let is_near = |periods: f64| (periods - periods.round()).abs() < NEAR;
    let (mut at, mut below) = ([0_usize; MOST], [0_usize; MOST]);
    for (row, &own) in periods.iter().enumerate() {
        let upper = if is_near(own) { own.round() } else { own.ceil() };
        if !(2.0..MOST as f64).contains(&upper) {
            continue;
        }
        // A row that was late, or early, makes up for it in the interval beside.
        let beside = [row.checked_sub(1), Some(row + 1)].into_iter().flatten();
        let mut beside = beside.filter_map(|other| periods.get(other));
        let makes_up = |other: &f64| *other < 1.0 - NEAR && is_near(own + other);
        if is_near(own) {
            at[upper as usize] += 1;
        } else if !beside.any(makes_up) {
            below[upper as usize] += 1;
        }
    }
    let reached = (2..MOST).take_while(|&upper| below[upper] > at[upper]).count();
    1 + reached as u32
}

/// The times between rows, held against their pace.
pub(super) struct Intervals<'a> {
    /// Stamp and time of receipt of each row, in the order of the stamps, each stamp once.
    pub times: &'a [(Stamp, i64)],
    pub pace: &'a Pace,
    pub motion: &'a Motion<'a>,
}

impl Intervals<'_> {
    fn all(&self) -> impl Iterator<Item = (usize, f64)> {
        let pairs = self.times.windows(2).enumerate();
        pairs.map(|(left, pair)| (left, pair[1].0.seconds_since(pair[0].0)))
    }

    /// Rows from `left` on over `count` intervals, as a stretch of time.
    fn stretch(&self, left: usize, count: usize) -> Stretch {
        let (start, end) = (self.times[left].0, self.times[left + count].0);
        let rate_hz = count as f64 / end.seconds_since(start);
        Stretch { start, end, rate_hz, moving: self.motion.moves(start, end) }
    }

    /// Whether nothing was received, for half of it at least, in the interval from row `left` on.
    /// `received` are the times of receipt in their own order.
    fn is_silent(&self, received: &[i64], left: usize, interval_s: f64) -> bool {
        let (before, after) = (self.times[left].1, self.times[left + 1].1);
        let from = received.partition_point(|&received| received < before);
        let to = received.partition_point(|&received| received <= after);
        let between = received.get(from..to).unwrap_or_default();
        let silences = between.windows(2).map(|pair| seconds(pair[1].saturating_sub(pair[0])));
        2.0 * silences.fold(0.0, f64::max) > interval_s
    }

    /// The intervals in which rows are missing.
    pub fn holes(&self) -> Vec<Hole> {
        /// A stamp from another age would say that millions are missing.
        const MOST: f64 = 1e9;
        let periods = |interval_s: f64| (interval_s / self.pace.period_s).round().min(MOST);
        let longest = self.pace.longest as usize;
        let long_s = (longest as f64 + 0.5) * self.pace.period_s;
        let long = self.all().filter(|(_, interval_s)| *interval_s > long_s);
        let mut long = long.peekable();
        if long.peek().is_none() {
            return Vec::new();
        }
        let mut received: Vec<i64> = self.times.iter().map(|(_, received)| *received).collect();
        received.sort_unstable();
        let hole = |(left, interval_s): (usize, f64)| Hole {
            stretch: self.stretch(left, 1),
            missing: (periods(interval_s) as usize).saturating_sub(longest),
            is_silent: self.is_silent(&received, left, interval_s),
        };
        long.map(hole).collect()
    }

    /// How many rows follow the one before by less than half a period.
    pub fn bunched(&self) -> usize {
        const SHORT: f64 = 0.5;
        self.all().filter(|(_, interval_s)| *interval_s < SHORT * self.pace.period_s).count()
    }

    /// Stretches in which most of nine intervals that follow each other are longer than usual, and
    /// none is far longer than the others: that would be a hole in it.
    pub fn lulls(&self) -> Vec<Stretch> {
        /// A stream's rate varies by less.
        const LOWER: f64 = 1.25;
        const FAR_LONGER: f64 = 4.0;
        const AROUND: usize = 9;
        // Hardly any interval is long, and of a window with such a median half of them are.
        let is_long = |interval_s: &f64| *interval_s > LOWER * self.pace.period_s;
        if !self.pace.is_regular || !self.all().any(|(_, interval_s)| is_long(&interval_s)) {
            return Vec::new();
        }
        let intervals: Vec<f64> = self.all().map(|(_, interval_s)| interval_s).collect();
        let is_lower = |window: &[f64]| {
            let mut sorted = [0.0; AROUND];
            let sorted = &mut sorted[..window.len()];
            sorted.copy_from_slice(window);
            sorted.sort_by(f64::total_cmp);
            let (median, longest) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() - 1]);
            median > LOWER * self.pace.period_s && longest < FAR_LONGER * median
        };
        let around = |at: usize| {
            let (from, to) = (at.saturating_sub(AROUND / 2), at + AROUND / 2 + 1);
            &intervals[from..to.min(intervals.len())]
        };
        let may_be_lower = |at: usize| {
            let window = around(at);
            2 * window.iter().filter(|interval_s| is_long(interval_s)).count() >= window.len()
        };
        let is_lower = |at: usize| may_be_lower(at) && is_lower(around(at));
        let lower: Vec<bool> = (0..intervals.len()).map(is_lower).collect();
        let mut found = Vec::new();
        let mut at = 0;
        while at < lower.len() {
            let length = lower[at..].iter().take_while(|lower| **lower).count();
            if length > 0 {
                found.push(self.stretch(at, length));
            }
            at += length.max(1);
        }
        found
    }
}
