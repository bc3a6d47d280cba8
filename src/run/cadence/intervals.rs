//! Finds missing rows and reduced rates in the intervals between rows.

use super::motion::ArmMotion;
use crate::stats::median as median_of;
use crate::time::{Stamp, seconds};

/// A time span of a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateSpan {
    /// First stamp.
    pub start: Stamp,
    /// Last stamp.
    pub end: Stamp,
    /// Mean rate, Hz; each end counts as half a row.
    pub rate_hz: f64,
    /// Whether the arm moved; `None` without joint states.
    pub is_arm_moving: Option<bool>,
}

impl RateSpan {
    /// Duration, s.
    pub fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

/// An interval longer than a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissingRows {
    /// Its time span.
    pub span: RateSpan,
    /// Number of missing rows.
    pub count: usize,
    /// Whether nothing was received for half of it; else the clock was stepped.
    pub is_silent: bool,
}

pub(super) struct RowPeriod {
    /// Typical interval, s: mean of intervals near the median, which rounded stamps quantise.
    pub period_s: f64,
    /// Whether intervals are near multiples of the period.
    pub is_regular: bool,
    /// Maximum number of periods without a loss; more than one with jitter.
    max_periods: u32,
}

impl RowPeriod {
    pub fn estimate(times: &[(Stamp, i64)]) -> Option<Self> {
        /// Maximum deviation of a single interval, as a share of the median.
        const MAX_SINGLE_DEVIATION: f64 = 0.5;
        const MAX_REGULAR_DEVIATION: f64 = 0.25;
        const MIN_REGULAR_SHARE: f64 = 0.6;
        /// Long intervals with so large a share of all are lost rows only if most are near multiples of the period. Of
        /// the intervals between events, half are by chance.
        const MIN_LONG_SHARE: f64 = 0.2;
        const MIN_LONG_REGULAR_SHARE: f64 = 0.75;
        /// Block length with whole bursts of 2, 3, 4, 6 or 12 rows.
        const BLOCK_ROWS: usize = 12;
        /// Ratio of median to mean interval for evenly spaced rows; two in five may be lost.
        const EVEN_RATIO: std::ops::RangeInclusive<f64> = 0.5..=1.6;
        const MAX_INTERVALS: usize = 50_000;
        let intervals = || times.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0));
        let count = times.len().saturating_sub(1);
        if count < 2 {
            return None;
        }
        let mut some: Vec<f64> = intervals().step_by(count.div_ceil(MAX_INTERVALS)).collect();
        let mut median = median_of(&mut some)?;
        // Intervals within a burst differ from the mean.
        let blocks = times.windows(BLOCK_ROWS + 1).step_by(count.div_ceil(MAX_INTERVALS));
        let mut blocks: Vec<f64> = blocks
            .map(|rows| rows[BLOCK_ROWS].0.seconds_since(rows[0].0) / BLOCK_ROWS as f64)
            .collect();
        if let Some(mean) =
            median_of(&mut blocks).filter(|mean| !EVEN_RATIO.contains(&(median / mean)))
        {
            median = mean;
        }
        let close = intervals().filter(|dt| (dt - median).abs() < MAX_SINGLE_DEVIATION * median);
        let (sum_s, singles) =
            close.fold((0.0, 0), |(sum_s, singles), dt| (sum_s + dt, singles + 1));
        let period_s = if singles > 0 { sum_s / f64::from(singles) } else { median };
        let is_close = |dt: &f64| {
            let periods = dt / period_s;
            // One period first, because rounding is slow.
            (periods - 1.0).abs() < MAX_REGULAR_DEVIATION
                || (periods - periods.round().max(1.0)).abs() < MAX_REGULAR_DEVIATION
        };
        let regular = intervals().filter(is_close).count();
        let long = || intervals().filter(|dt| *dt > (1.0 + MAX_SINGLE_DEVIATION) * period_s);
        let (long_count, long_regular) =
            (long().count() as f64, long().filter(is_close).count() as f64);
        let are_events = long_count >= MIN_LONG_SHARE * count as f64
            && long_regular < MIN_LONG_REGULAR_SHARE * long_count;
        let is_regular = regular as f64 > MIN_REGULAR_SHARE * count as f64 && !are_events;
        Some(Self { period_s, is_regular, max_periods: max_jitter_periods(times, period_s) })
    }
}

/// Number of periods that jitter alone can reach.
///
/// Lost rows give whole multiples of the period, so intervals between two multiples are rarer than at the
/// upper one.
fn max_jitter_periods(times: &[(Stamp, i64)], period_s: f64) -> u32 {
    /// Maximum distance from a multiple, in periods.
    const MAX_DISTANCE_PERIODS: f64 = 0.25;
    /// Longer intervals are rare in any stream, in periods.
    const MAX_PERIODS: usize = 8;
    let periods = |row: usize| {
        let next = times.get(row + 1)?.0;
        Some(next.seconds_since(times[row].0) / period_s)
    };
    let is_near = |periods: f64| (periods - periods.round()).abs() < MAX_DISTANCE_PERIODS;
    let (mut at, mut below) = ([0_usize; MAX_PERIODS], [0_usize; MAX_PERIODS]);
    for (row, own) in (0..times.len()).filter_map(|row| Some((row, periods(row)?))) {
        // Most intervals are one period, and rounding is slow.
        if own < 1.0 + MAX_DISTANCE_PERIODS {
            continue;
        }
        let upper = if is_near(own) { own.round() } else { own.ceil() };
        if !(2.0..MAX_PERIODS as f64).contains(&upper) {
            continue;
        }
        // A late or early row shortens an adjacent interval.
        let beside = [row.checked_sub(1), Some(row + 1)].into_iter().flatten();
        let mut beside = beside.filter_map(periods);
        let makes_up = |other: f64| other < 1.0 - MAX_DISTANCE_PERIODS && is_near(own + other);
        if is_near(own) {
            at[upper as usize] += 1;
        } else if !beside.any(makes_up) {
            below[upper as usize] += 1;
        }
    }
    let reached = (2..MAX_PERIODS).take_while(|&upper| below[upper] > at[upper]).count();
    1 + reached as u32
}

pub(super) struct Intervals<'a> {
    /// Stamp and receive time of each row, by unique stamps.
    pub times: &'a [(Stamp, i64)],
    pub pace: &'a RowPeriod,
    pub motion: &'a ArmMotion<'a>,
}

impl Intervals<'_> {
    fn all(&self) -> impl Iterator<Item = (usize, f64)> {
        let pairs = self.times.windows(2).enumerate();
        pairs.map(|(left, pair)| (left, pair[1].0.seconds_since(pair[0].0)))
    }

    fn stretch(&self, left: usize, count: usize) -> RateSpan {
        let (start, end) = (self.times[left].0, self.times[left + count].0);
        let rate_hz = count as f64 / end.seconds_since(start);
        RateSpan { start, end, rate_hz, is_arm_moving: self.motion.moves(start, end) }
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
    pub fn missing_rows(&self) -> Vec<MissingRows> {
        /// Bounds the count if a stamp is decades off.
        const MAX_MISSING: f64 = 1e9;
        let periods = |interval_s: f64| (interval_s / self.pace.period_s).round().min(MAX_MISSING);
        let longest = self.pace.max_periods as usize;
        let long_s = (longest as f64 + 0.5) * self.pace.period_s;
        let long = self.all().filter(|(_, interval_s)| *interval_s > long_s);
        let mut long = long.peekable();
        if long.peek().is_none() {
            return Vec::new();
        }
        let mut received: Vec<i64> = self.times.iter().map(|(_, received)| *received).collect();
        received.sort_unstable();
        let hole = |(left, interval_s): (usize, f64)| MissingRows {
            span: self.stretch(left, 1),
            count: (periods(interval_s) as usize).saturating_sub(longest),
            is_silent: self.is_silent(&received, left, interval_s),
        };
        long.map(hole).collect()
    }

    /// Number of rows within half a period of the previous one.
    pub fn count_bunched(&self) -> usize {
        const MAX_SHORT_PERIODS: f64 = 0.5;
        self.all()
            .filter(|(_, interval_s)| *interval_s < MAX_SHORT_PERIODS * self.pace.period_s)
            .count()
    }

    /// Spans with a reduced rate: most of nine consecutive intervals are long, none is a hole.
    pub fn slow_spans(&self) -> Vec<RateSpan> {
        /// Minimum ratio of a long interval to the period.
        const MIN_LONG_PERIODS: f64 = 1.25;
        const MIN_HOLE_RATIO: f64 = 4.0;
        const WINDOW_INTERVALS: usize = 9;
        // Usually no interval is long.
        let is_long = |interval_s: &f64| *interval_s > MIN_LONG_PERIODS * self.pace.period_s;
        if !self.pace.is_regular || !self.all().any(|(_, interval_s)| is_long(&interval_s)) {
            return Vec::new();
        }
        let intervals: Vec<f64> = self.all().map(|(_, interval_s)| interval_s).collect();
        let is_lower = |window: &[f64]| {
            let mut sorted = [0.0; WINDOW_INTERVALS];
            let sorted = &mut sorted[..window.len()];
            sorted.copy_from_slice(window);
            sorted.sort_by(f64::total_cmp);
            let (median, longest) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() - 1]);
            median > MIN_LONG_PERIODS * self.pace.period_s && longest < MIN_HOLE_RATIO * median
        };
        let around = |at: usize| {
            let (from, to) =
                (at.saturating_sub(WINDOW_INTERVALS / 2), at + WINDOW_INTERVALS / 2 + 1);
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
        for run in lower.chunk_by(|a, b| a == b) {
            if run[0] {
                found.push(self.stretch(at, run.len()));
            }
            at += run.len();
        }
        found
    }
}
