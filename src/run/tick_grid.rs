//! Detects stamps that are multiples of a tick, such as 15.6 ms on some Windows machines.

use crate::stats::median;
use crate::time::{NANOS_PER_SECOND, seconds};

/// Minimum tick, s.
const MIN_TICK_S: f64 = 2e-3;
/// Minimum share of intervals of whole ticks.
const MIN_WHOLE_TICK_SHARE: f64 = 0.98;

/// Rows stamped in multiples of a tick.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TickGrid {
    /// Tick, s.
    pub tick_s: f64,
    /// Ticks between consecutive rows.
    pub ticks: Vec<u32>,
}

impl TickGrid {
    /// Tick of ascending stamps, s; `None` without one. For a fine clock and even stream, its period.
    pub fn detect(t_s: &[f64]) -> Option<Self> {
        Self::detect_with_min_tick(t_s, MIN_TICK_S)
    }

    /// For ticks of at least `least_s`.
    pub fn detect_with_min_tick(t_s: &[f64], least_s: f64) -> Option<Self> {
        const MIN_INTERVALS: usize = 50;
        /// Maximum ticks in the shortest interval.
        const MAX_SHORTEST_TICKS: u32 = 4;
        const ROUNDING_S: f64 = 2e-5;
        let intervals = || t_s.windows(2).map(|pair| pair[1] - pair[0]);
        let count = intervals().len();
        let mut some: Vec<f64> = intervals().filter(|dt| *dt > least_s).collect();
        if count < MIN_INTERVALS || some.is_empty() {
            return None;
        }
        let at = some.len() / 50;
        let shortest_s = *some.select_nth_unstable_by(at, f64::total_cmp).1;
        drop(some);
        (1..=MAX_SHORTEST_TICKS).find_map(|parts| {
            let rough_s = shortest_s / f64::from(parts);
            let short = intervals().filter(|dt| *dt > least_s && *dt < shortest_s + 0.5 * rough_s);
            let (sum_s, count_short) =
                short.fold((0.0, 0), |(sum_s, count), dt| (sum_s + dt, count + 1));
            let tick_s = sum_s / f64::from(count_short) / f64::from(parts);
            let ticks = |dt: f64| (dt / tick_s).round();
            let is_multiple =
                |dt: &f64| (*dt - ticks(*dt) * tick_s).abs() < ROUNDING_S.max(2e-3 * tick_s);
            let fit = || intervals().filter(is_multiple).count() as f64;
            let is_one = tick_s >= least_s && fit() >= MIN_WHOLE_TICK_SHARE * count as f64;
            is_one.then(|| Self { tick_s, ticks: intervals().map(|dt| ticks(dt) as u32).collect() })
        })
    }

    /// Whether the stamps come from a regular sender whose period is not a multiple of the tick.
    ///
    /// Ticks over equal numbers of rows then differ by at most one (a Sturmian sequence; Lothaire,
    /// *Algebraic Combinatorics on Words*, ch. 2); losses make them less even. `false` if the tick does not
    /// coarsen the stamps.
    pub fn is_of_one_even_sender(&self) -> bool {
        /// Window length in rare intervals, so that losses change the sum.
        const WINDOW_RARE_INTERVALS: f64 = 4.0;
        const MAX_RARE_SHARE: f64 = 5e-3;
        const MIN_EVEN_SHARE: f64 = 0.9;
        let n = self.ticks.len();
        let sum: u64 = self.ticks.iter().copied().map(u64::from).sum();
        let mean = sum as f64 / n as f64;
        let rare = (mean - mean.floor()).min(mean.ceil() - mean);
        let window = (WINDOW_RARE_INTERVALS / rare.max(MAX_RARE_SHARE)).ceil() as usize;
        if rare < MAX_RARE_SHARE || n < 3 * window {
            return false;
        }
        let sums: Vec<u64> = self
            .ticks
            .windows(window)
            .map(|own| own.iter().copied().map(u64::from).sum())
            .collect();
        let usual = window as f64 * mean;
        let even = sums.iter().filter(|sum| (**sum as f64 - usual).abs() < 1.0 + 1e-6).count();
        even as f64 >= MIN_EVEN_SHARE * sums.len() as f64
    }

    /// Whether longer stamp intervals are shorter by receive time, so that no rows were lost. `received_s`
    /// are of the same rows, s.
    pub fn hides_no_loss(&self, received_s: &[f64]) -> bool {
        /// Minimum excess of long stamp over receive intervals, ticks.
        const MIN_LONG_EXCESS_TICKS: f64 = 0.25;
        /// Maximum excess of the others, ticks.
        const MAX_OTHER_EXCESS_TICKS: f64 = 0.1;
        const MIN_LONG_INTERVALS: usize = 5;
        let (mut ticks, middle) = (self.ticks.clone(), self.ticks.len() / 2);
        let usual = *ticks.select_nth_unstable(middle).1;
        drop(ticks);
        let beyond = |is_long: bool| -> Vec<f64> {
            let pairs = self.ticks.iter().zip(received_s.windows(2));
            let of = pairs.filter(|(ticks, _)| (**ticks > usual) == is_long);
            of.map(|(ticks, pair)| f64::from(*ticks) - (pair[1] - pair[0]) / self.tick_s).collect()
        };
        let mut long = beyond(true);
        long.len() >= MIN_LONG_INTERVALS
            && median(&mut long).is_some_and(|apart| apart > MIN_LONG_EXCESS_TICKS)
            && median(&mut beyond(false)).is_some_and(|apart| apart < MAX_OTHER_EXCESS_TICKS)
    }
}

/// Tick of a clock that rounds ascending stamps, s: the greatest common divisor of the intervals, if less than the shortest
/// one. 0 without one, or if it is shorter than `min_s`.
pub(super) fn rounding_tick_s(raw: &[i64], min_s: f64) -> f64 {
    let min = (min_s * NANOS_PER_SECOND as f64) as i64;
    let (mut tick, mut shortest) = (0_i64, i64::MAX);
    for pair in raw.windows(2) {
        let interval = pair[1].saturating_sub(pair[0]).saturating_abs();
        if interval > 0 {
            shortest = shortest.min(interval);
            tick = greatest_common_divisor(tick, interval);
            if tick < min {
                return 0.0;
            }
        }
    }
    if tick < shortest { seconds(tick) } else { 0.0 }
}

fn greatest_common_divisor(mut a: i64, mut b: i64) -> i64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 s of stamps from a ticking clock, with a share of rows lost at random.
    fn stamps(period_s: f64, tick_s: f64, lost: f64) -> (Vec<f64>, Vec<f64>) {
        let mut state = 12_345_u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1_u64 << 31) as f64
        };
        let kept: Vec<f64> = (0..(40.0 / period_s) as usize)
            .map(|row| 0.0031 + row as f64 * period_s)
            .filter(|_| random() >= lost)
            .collect();
        let received = kept.iter().map(|t_s| t_s + 2e-3 * random()).collect();
        (kept.iter().map(|t_s| (t_s / tick_s).floor() * tick_s).collect(), received)
    }

    #[test]
    fn a_coarse_clock_is_distinguished_from_lost_rows() {
        for (period_s, tick_s) in
            [(0.02, 0.015625), (0.0125, 0.01), (0.0188, 0.015625), (0.0211, 0.01), (0.011, 0.01)]
        {
            let (stamped, received) = stamps(period_s, tick_s, 0.0);
            let grid = TickGrid::detect(&stamped).expect("a tick");
            assert!((grid.tick_s - tick_s).abs() < 1e-6, "{period_s} {tick_s}: {}", grid.tick_s);
            assert!(grid.is_of_one_even_sender(), "{period_s} {tick_s}");
            assert!(
                period_s > 1.5 * tick_s || grid.hides_no_loss(&received),
                "{period_s} {tick_s}"
            );
        }
        for lost in [0.02, 0.08, 0.2, 0.4] {
            let (stamped, received) = stamps(0.02, 0.02, lost);
            let grid = TickGrid::detect(&stamped).expect("its period");
            assert!(!grid.is_of_one_even_sender() && !grid.hides_no_loss(&received), "{lost}");
        }
    }

    #[test]
    fn uneven_stamps_have_no_tick() {
        let (_, received) = stamps(0.02, 0.02, 0.0);
        assert_eq!(TickGrid::detect(&received), None);
        assert_eq!(TickGrid::detect(&[0.0, 0.01]), None);
    }

    #[test]
    fn only_uneven_intervals_show_the_tick_of_a_clock() {
        let stamps = |period_ns: f64, tick_ns: i64| -> Vec<i64> {
            let at = |row: i32| (f64::from(row) * period_ns) as i64 / tick_ns * tick_ns;
            (0..500).map(at).collect()
        };
        let tick_s = |period_ns, tick_ns| rounding_tick_s(&stamps(period_ns, tick_ns), 1e-4);
        assert_eq!(tick_s(8.333e6, 1_000_000), 1e-3);
        assert_eq!(tick_s(33.333e6, 10_000_000), 1e-2);
        for (period_ns, tick_ns) in [(8e6, 1_000_000), (8.333e6, 1), (8.333e6, 10_000)] {
            assert_eq!(tick_s(period_ns, tick_ns), 0.0, "{period_ns} {tick_ns}");
        }
    }
}
