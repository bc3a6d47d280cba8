//! Finds missing rows and reduced rates in the intervals between rows.

use super::motion::Motion;
use crate::stats::median as median_of;
use crate::time::{Stamp, seconds};

/// A time span of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// First stamp.
    pub start: Stamp,
    /// Last stamp.
    pub end: Stamp,
    /// Mean rate, Hz; each end counts as half a row.
    pub rate_hz: f64,
    /// Whether the arm moved; `None` without joint states.
    pub moving: Option<bool>,
}

impl Stretch {
    /// Duration, s.
    pub fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

/// An interval longer than a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Its time span.
    pub stretch: Stretch,
    /// Number of missing rows.
    pub missing: usize,
    /// Whether nothing was received for half of it; else the clock was stepped.
    pub is_silent: bool,
}

pub(super) struct Pace {
    /// Typical interval, s: mean of intervals near the median, which rounded stamps quantise.
    pub period_s: f64,
    /// Whether intervals are near multiples of the period.
    pub is_regular: bool,
    /// Maximum number of periods without a loss; more than one with jitter.
    longest: u32,
}

impl Pace {
    pub fn of(times: &[(Stamp, i64)]) -> Option<Self> {
        /// Maximum deviation of a single interval, as a share of the median.
        const SINGLE: f64 = 0.5;
        const CLOSE: f64 = 0.25;
        const REGULAR: f64 = 0.6;
        /// Block length with whole bursts of 2, 3, 4, 6 or 12 rows.
        const BURSTS: usize = 12;
        /// Ratio of median to mean interval for evenly spaced rows; two in five may be lost.
        const USUAL: std::ops::RangeInclusive<f64> = 0.5..=1.6;
        const ENOUGH: usize = 50_000;
        let intervals = || times.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0));
        let count = times.len().saturating_sub(1);
        if count < 2 {
            return None;
        }
        let mut some: Vec<f64> = intervals().step_by(count.div_ceil(ENOUGH)).collect();
        let mut median = median_of(&mut some)?;
        // Intervals within a burst differ from the mean.
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
            // One period first, because rounding is slow.
            (periods - 1.0).abs() < CLOSE || (periods - periods.round().max(1.0)).abs() < CLOSE
        };
        let regular = intervals().filter(is_close).count();
        let is_regular = regular as f64 > REGULAR * count as f64;
        Some(Self { period_s, is_regular, longest: reached_by_jitter(times, period_s) })
    }
}

/// Number of periods that jitter alone can reach.
///
/// Lost rows give whole multiples of the period, so intervals between two multiples are rarer than at the
/// upper one.
fn reached_by_jitter(times: &[(Stamp, i64)], period_s: f64) -> u32 {
    /// Maximum distance from a multiple, in periods.
    const NEAR: f64 = 0.25;
    /// Longer intervals are rare in any stream, in periods.
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
        // A late or early row shortens an adjacent interval.
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

pub(super) struct Intervals<'a> {
    /// Stamp and receive time of each row, by unique stamps.
    pub times: &'a [(Stamp, i64)],
    pub pace: &'a Pace,
    pub motion: &'a Motion<'a>,
}

impl Intervals<'_> {
    fn all(&self) -> impl Iterator<Item = (usize, f64)> {
        let pairs = self.times.windows(2).enumerate();
        pairs.map(|(left, pair)| (left, pair[1].0.seconds_since(pair[0].0)))
    }

    fn stretch(&self, left: usize, count: usize) -> Stretch {
        let (start, end) = (self.times[left].0, self.times[left + count].0);
        let rate_hz = count as f64 / end.seconds_since(start);
        Stretch { start, end, rate_hz, moving: self.motion.moves(start, end) }
    }

    /// Whether nothing was received for half of the interval after row `left`. `received` is sorted.
    fn is_silent(&self, received: &[i64], left: usize, interval_s: f64) -> bool {
        let (before, after) = (self.times[left].1, self.times[left + 1].1);
        let from = received.partition_point(|&received| received < before);
        let to = received.partition_point(|&received| received <= after);
        let between = received.get(from..to).unwrap_or_default();
        let silences = between.windows(2).map(|pair| seconds(pair[1].saturating_sub(pair[0])));
        2.0 * silences.fold(0.0, f64::max) > interval_s
    }

    /// Intervals with missing rows.
    pub fn holes(&self) -> Vec<Hole> {
        /// Bounds the count if a stamp is decades off.
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

    /// Number of rows within half a period of the previous one.
    pub fn bunched(&self) -> usize {
        const SHORT: f64 = 0.5;
        self.all().filter(|(_, interval_s)| *interval_s < SHORT * self.pace.period_s).count()
    }

    /// Spans with a reduced rate: most of nine consecutive intervals are long, none is a hole.
    pub fn lulls(&self) -> Vec<Stretch> {
        /// Minimum ratio of a long interval to the period.
        const LOWER: f64 = 1.25;
        const FAR_LONGER: f64 = 4.0;
        const AROUND: usize = 9;
        // Usually no interval is long.
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
