//! Restores stamps rounded by a coarse clock: milliseconds in a table, whole seconds, or 15.6 ms on some
//! machines.
//!
//! The row order still gives the times: a nearly regular sender follows a few straight lines through the
//! intervals of the rounded stamps (O'Rourke, "An on-line algorithm for fitting straight lines between data
//! ranges", 1981).

use std::collections::HashMap;

use crate::stream::{Columns, Times};
use crate::time::{self, Clock};

use super::part_series::PartValues;
use super::role::Role;
use super::streams::Stream;
use super::tick_grid::{TickGrid, rounding_tick_s};

/// A part with rounded stamps, restored from the row order.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundedStamps {
    /// Index of the stream.
    pub stream: usize,
    /// Tick of the clock, s.
    pub tick_s: f64,
    /// Rows with the previous row's stamp.
    pub shared_rows: usize,
    /// Maximum error, s, besides a constant offset of up to half a tick.
    pub resolution_s: f64,
    /// Whether the rows are those of a table, whose columns share their times whatever the stamps.
    pub is_of_table: bool,
    /// [`Stream::file`].
    pub(super) file: Option<usize>,
    /// Index of the stream's part.
    pub(super) piece: usize,
    /// Group of parts with the same stamps, as in one table.
    pub(super) group: usize,
}

/// Minimum tick, s.
const MIN_TICK_S: f64 = 2e-4;

/// Parts with the same stamps, such as the streams of a table, are restored together, even if the values of some of
/// them do not show that their stamps are rounded.
pub(super) fn restore_stamps(streams: &mut [Stream], clock: Clock) -> Vec<RoundedStamps> {
    let mut known: HashMap<Vec<i64>, (usize, RestoredStamps)> = HashMap::new();
    for index in 0..streams.len() {
        for (piece, raw) in parts_of_use(&streams[index], clock) {
            let columns = streams[index].columns.as_ref().filter(|_| !known.contains_key(raw));
            let values = columns.and_then(|columns| PartValues::of(columns, piece));
            let restored = values.and_then(|values| {
                RestoredStamps::restore(raw, &values).filter(|restored| {
                    restored.is_smoother_than(raw, &values)
                        || !are_copies_of_even_joints(raw, index, streams, clock)
                })
            });
            if let Some(restored) = restored {
                let group = known.len();
                known.insert(raw.to_vec(), (group, restored));
            }
        }
    }
    let mut found = Vec::new();
    for (index, stream) in streams.iter().enumerate() {
        for (piece, raw) in parts_of_use(stream, clock) {
            if let Some((group, restored)) = known.get(raw) {
                found.push(restored.report((index, piece), stream, *group));
            }
        }
    }
    let mut by_group: Vec<(usize, RestoredStamps)> = known.into_values().collect();
    by_group.sort_by_key(|(group, _)| *group);
    for RoundedStamps { stream, piece, group, .. } in &found {
        let columns = streams[*stream].columns.as_mut();
        if let Some(times) = columns.and_then(|columns| columns.times_mut().into_iter().nth(*piece))
        {
            times.restamp(clock_of_rows(times, clock), by_group[*group].1.nanos.clone());
        }
    }
    found
}

/// Tick of the clock of each part with rounded stamps, s, per stream and part.
pub(super) fn clock_ticks_s(streams: &[Stream], clock: Clock) -> HashMap<(usize, usize), f64> {
    let of_stream = |(index, stream): (usize, &Stream)| {
        let parts = parts_of_use(stream, clock).into_iter();
        let ticks = parts.map(|(piece, raw)| ((index, piece), rounding_tick_s(raw, MIN_TICK_S)));
        ticks.filter(|(_, tick_s)| *tick_s > 0.0).collect::<Vec<_>>()
    };
    streams.iter().enumerate().flat_map(of_stream).collect()
}

/// Index and stamps of each part of a stream that the audit uses.
fn parts_of_use(stream: &Stream, clock: Clock) -> Vec<(usize, &[i64])> {
    let is_of_use = !matches!(stream.role, Role::TfStatic | Role::Description | Role::Ignored);
    let columns = stream.columns.as_ref().filter(|_| is_of_use);
    let parts = columns.into_iter().flat_map(|columns| columns.times()).enumerate();
    parts.map(|(piece, times)| (piece, times.nanos_on(clock_of_rows(times, clock)))).collect()
}

/// Whether the stamps of a stream are copied from joint states with even stamps, for example from every second one.
fn are_copies_of_even_joints(raw: &[i64], of: usize, streams: &[Stream], clock: Clock) -> bool {
    streams.iter().enumerate().filter(|(index, _)| *index != of).any(|(_, stream)| {
        let Some(Columns::Joints(joints)) = &stream.columns else { return false };
        let own = joints.times.nanos_on(clock_of_rows(&joints.times, clock));
        let copies = raw.iter().filter(|nanos| own.binary_search(nanos).is_ok()).count();
        let is_rounded = || RestoredStamps::restore(own, &PartValues::Joints(joints)).is_some();
        10 * copies >= 9 * raw.len() && !is_rounded()
    })
}

/// Clock of the rows: log time without header stamps.
fn clock_of_rows(times: &Times, clock: Clock) -> Clock {
    let has_stamps = times.header.iter().any(|nanos| *nanos != 0);
    if clock == Clock::Header && !has_stamps { Clock::Log } else { clock }
}

#[derive(Clone)]
struct RestoredStamps {
    nanos: Vec<i64>,
    tick_s: f64,
    shared: usize,
    resolution_s: f64,
}

impl RestoredStamps {
    fn report(&self, (index, piece): (usize, usize), of: &Stream, group: usize) -> RoundedStamps {
        let Self { tick_s, shared, resolution_s, .. } = *self;
        RoundedStamps {
            stream: index,
            piece,
            tick_s,
            shared_rows: shared,
            resolution_s,
            is_of_table: of.is_from_table || of.read_as.is_some(),
            file: of.file,
            group,
        }
    }

    /// Whether the values are smoother at the restored times than at the stamps. Copies of another stream's stamps are exact.
    fn is_smoother_than(&self, raw: &[i64], values: &PartValues<'_>) -> bool {
        let repeats = repeats(values, raw.len());
        let residual = |nanos: &[i64]| {
            interpolation_residual(&seconds_from(nanos, nanos[0]), values, &repeats)
        };
        matches!((residual(&self.nanos), residual(raw)), (Some(restored), Some(raw)) if restored < raw)
    }

    /// `None` unless the stamps are multiples of a tick that hides times.
    fn restore(raw: &[i64], values: &PartValues<'_>) -> Option<Self> {
        /// Minimum share of rows with the previous stamp but new values.
        const MIN_SHARED_SHARE: f64 = 0.02;
        /// Restored times interpolate values well, unlike two publishers that disagree. White noise has a ratio of √1.5 / √2 =
        /// 0.87, motion far less.
        const MAX_RESIDUAL_RATIO: f64 = 0.6;
        let first = *raw.first()?;
        if !raw.is_sorted() || raw.contains(&0) {
            return None;
        }
        let t_s = seconds_from(raw, first);
        let grid = TickGrid::detect_with_min_tick(&t_s, MIN_TICK_S)?;
        let is_even = grid.is_of_one_even_sender();
        let shared = grid.ticks.iter().filter(|ticks| **ticks == 0).count();
        let share = shared as f64 / raw.len() as f64;
        if share <= MIN_SHARED_SHARE && !is_even {
            return None;
        }
        let repeats = repeats(values, raw.len());
        let sent_again = grid.ticks.iter().zip(&repeats);
        let sent_again = sent_again.filter(|(ticks, repeats)| **ticks == 0 && **repeats).count();
        // Resting arms also repeat: rows with a shared stamp may do so as often as others.
        let rest = repeats.iter().filter(|repeats| **repeats).count() - sent_again;
        let usual = rest as f64 / (repeats.len() - shared).max(1) as f64;
        let are_sent_again = sent_again as f64 > 0.5 * shared as f64 * (1.0 + usual);
        // Expected share of shared stamps for a sender faster than the tick.
        let period_s = t_s[t_s.len() - 1] / (t_s.len() - 1) as f64;
        let expected = 1.0 - period_s / grid.tick_s;
        let are_shared = share > MIN_SHARED_SHARE && share < 1.5 * expected && !are_sent_again;
        if !(are_shared || is_even) {
            return None;
        }
        let (restored_s, resolution_s) = straighten(&t_s, grid.tick_s);
        let residual = |t_s: &[f64]| interpolation_residual(t_s, values, &repeats);
        let restored = residual(&restored_s);
        // If the shortest interval is one tick, the tick may be the period, and longer intervals losses.
        let is_coarser = grid.ticks.iter().all(|ticks| *ticks >= 2);
        let is_plausible = if are_shared || is_coarser {
            matches!(values, PartValues::Imu(_))
                || restored.map_or(!are_shared, |residual| residual < MAX_RESIDUAL_RATIO)
        } else {
            restored.zip(residual(&t_s)).is_some_and(|(restored, raw)| {
                restored < MAX_RESIDUAL_RATIO.min(MAX_RESIDUAL_RATIO * raw)
            })
        };
        let mut last = i64::MIN;
        let nanos = restored_s.iter().map(|at_s| {
            last = (first + time::nanos(*at_s)).max(last + 1);
            last
        });
        let nanos = nanos.collect();
        is_plausible.then_some(Self { nanos, tick_s: grid.tick_s, shared, resolution_s })
    }
}

/// From `first`, s.
fn seconds_from(nanos: &[i64], first: i64) -> Vec<f64> {
    nanos.iter().map(|nanos| time::seconds(nanos - first)).collect()
}

/// Whether each row but the first has the values of the previous one.
fn repeats(values: &PartValues<'_>, rows: usize) -> Vec<bool> {
    (1..rows).map(|row| values.is_same(row - 1, row)).collect()
}

/// Mean difference of new values from the interpolation between their neighbours, relative to their steps. `None` if too few
/// are new.
fn interpolation_residual(t_s: &[f64], values: &PartValues<'_>, repeats: &[bool]) -> Option<f64> {
    const MIN_NEW_VALUES: usize = 20;
    let numbers = if matches!(values, PartValues::Poses(_)) { 3 } else { values.width() };
    let is_new = |row: &usize| *row == 0 || !repeats[row - 1];
    let rows: Vec<usize> = (0..t_s.len()).filter(is_new).collect();
    let (mut off, mut steps, mut count) = (0.0, 0.0, 0);
    for three in rows.windows(3) {
        let [a, b, c] = [three[0], three[1], three[2]];
        let part = (t_s[b] - t_s[a]) / (t_s[c] - t_s[a]).max(f64::MIN_POSITIVE);
        for number in 0..numbers {
            let [x, y, z] = [a, b, c].map(|row| values.number(row, number));
            if (x + y + z).is_finite() {
                off += (y - x - part * (z - x)).abs();
                steps += 0.5 * ((y - x).abs() + (z - y).abs());
            }
        }
        count += 1;
    }
    (count >= MIN_NEW_VALUES && steps > 0.0).then_some(off / steps)
}

/// Fits the fewest lines within half a tick of each stamp, plus a jitter margin. Returns times on them, and
/// their uncertainty, s.
fn straighten(t_s: &[f64], tick_s: f64) -> (Vec<f64>, f64) {
    /// Maximum jitter of a regular sender, periods.
    const MAX_JITTER_PERIODS: f64 = 1.0;
    let n = t_s.len();
    let period_s = (t_s[n - 1] - t_s[0]) / (n - 1) as f64;
    let margin_s = (0.25 * tick_s).min(MAX_JITTER_PERIODS * period_s);
    let mut restored = Vec::with_capacity(n);
    let (mut weighted, mut from) = (0.0, 0);
    while from < n {
        let line = StampLine::fit(&t_s[from..], 0.5 * tick_s + margin_s);
        let rows = line.rows;
        let own = &t_s[from..from + rows];
        let beside = || own.iter().enumerate().map(|(row, at)| at - line.value_at(row));
        let least = beside().fold(f64::INFINITY, f64::min);
        let most = beside().fold(f64::NEG_INFINITY, f64::max);
        // Every offset in these bounds keeps the line within half a tick. The line is as uncertain as a
        // mean of as many rounded stamps.
        let (low, high) = (most - 0.5 * tick_s, least + 0.5 * tick_s);
        let offset = 0.5 * (low + high);
        let left_open_s = (0.5 * (high - low)).abs() + tick_s / (rows as f64).sqrt();
        weighted += rows as f64 * left_open_s.min(0.5 * tick_s);
        restored.extend((0..rows).map(|row| line.value_at(row) + offset));
        from += rows;
    }
    (restored, weighted / n as f64)
}

struct StampLine {
    rows: usize,
    at_first: f64,
    slope: f64,
}

impl StampLine {
    fn value_at(&self, row: usize) -> f64 {
        self.at_first + self.slope * row as f64
    }

    /// The line within `half` of the longest initial run; its slope is the mean of the steepest and the
    /// flattest one.
    fn fit(values: &[f64], half: f64) -> Self {
        type Point = (f64, f64);
        let slope = |a: Point, b: Point| (b.1 - a.1) / (b.0 - a.0);
        let cross =
            |o: Point, a: Point, b: Point| (a.0 - o.0) * (b.1 - o.1) - (a.1 - o.1) * (b.0 - o.0);
        let upper_of = |row: usize| (row as f64, values[row] + half);
        let lower_of = |row: usize| (row as f64, values[row] - half);
        if values.len() < 2 {
            return Self { rows: values.len(), at_first: values[0], slope: 0.0 };
        }
        // The flattest runs from an upper to a lower bound, the steepest from a lower to an upper one.
        let (mut flattest, mut steepest) = ((upper_of(0), lower_of(1)), (lower_of(0), upper_of(1)));
        let mut upper = vec![upper_of(0), upper_of(1)];
        let mut lower = vec![lower_of(0), lower_of(1)];
        let (mut upper_from, mut lower_from) = (0, 0);
        let mut rows = 2;
        while rows < values.len() {
            let (above, below) = (upper_of(rows), lower_of(rows));
            let (least, most) = (slope(flattest.0, flattest.1), slope(steepest.0, steepest.1));
            let at = |line: (Point, Point), slope: f64| line.1.1 + slope * (above.0 - line.1.0);
            if above.1 < at(flattest, least) || below.1 > at(steepest, most) {
                break;
            }
            if above.1 < at(steepest, most) {
                let mut best = lower_from;
                for other in lower_from + 1..lower.len() {
                    if slope(lower[other], above) > slope(lower[best], above) {
                        break;
                    }
                    best = other;
                }
                steepest = (lower[best], above);
                lower_from = best;
                while upper.len() >= upper_from + 2
                    && cross(upper[upper.len() - 2], upper[upper.len() - 1], above) <= 0.0
                {
                    upper.pop();
                }
                upper.push(above);
            }
            if below.1 > at(flattest, least) {
                let mut best = upper_from;
                for other in upper_from + 1..upper.len() {
                    if slope(upper[other], below) < slope(upper[best], below) {
                        break;
                    }
                    best = other;
                }
                flattest = (upper[best], below);
                upper_from = best;
                while lower.len() >= lower_from + 2
                    && cross(lower[lower.len() - 2], lower[lower.len() - 1], below) >= 0.0
                {
                    lower.pop();
                }
                lower.push(below);
            }
            rows += 1;
        }
        let (least, most) = (slope(flattest.0, flattest.1), slope(steepest.0, steepest.1));
        let slope = 0.5 * (least + most);
        // Their intersection is on the mean line.
        let at_zero = |line: (Point, Point), slope: f64| line.0.1 - slope * line.0.0;
        let (a, b) = (at_zero(flattest, least), at_zero(steepest, most));
        let meet = if (most - least).abs() > f64::EPSILON { (a - b) / (most - least) } else { 0.0 };
        let slope = slope.max(0.0);
        Self { rows, at_first: a + (least - slope) * meet, slope }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::ArrayColumns;

    /// Rows with uniform jitter within ±`jitter_s`, without those in `gap`.
    fn sent(period_s: f64, jitter_s: f64, gap: std::ops::Range<usize>) -> Vec<f64> {
        let mut state = 7_u64;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1_u64 << 30) as f64 - 1.0
        };
        let rows = (0..(30.0 / period_s) as usize).map(|row| (row, jitter_s * random()));
        rows.filter(|(row, _)| !gap.contains(row))
            .map(|(row, by)| 0.0123 + row as f64 * period_s + by)
            .collect()
    }

    fn rounded(t_s: &[f64], tick_s: f64) -> Vec<f64> {
        t_s.iter().map(|t| (t / tick_s).round() * tick_s).collect()
    }

    #[test]
    fn the_order_of_rows_restores_rounded_stamps() {
        // Tolerance: an eighth of the tick, a quarter with jitter.
        for (period_s, tick_s, jitter_s, within_s) in [
            (0.008, 0.01, 0.0, 1.25e-3),
            (0.008, 0.01, 3e-4, 2.5e-3),
            (0.008, 1.0, 0.0, 0.125),
            (0.002, 0.01, 2e-4, 2.5e-3),
            (0.0333, 0.01, 0.0, 1.25e-3),
            (0.001, 1.0, 5e-4, 0.125),
        ] {
            let true_s = sent(period_s, jitter_s, 0..0);
            let (restored, resolution_s) = straighten(&rounded(&true_s, tick_s), tick_s);
            let most = true_s.iter().zip(&restored).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(most < within_s, "{period_s} {tick_s} {jitter_s}: {most}");
            assert!(resolution_s < within_s, "{period_s} {tick_s} {jitter_s}: {resolution_s}");
            assert!(restored.is_sorted());
        }
    }

    #[test]
    fn a_gap_is_kept() {
        let true_s = sent(0.008, 1e-4, 1000..1040);
        let (restored, _) = straighten(&rounded(&true_s, 0.01), 0.01);
        let longest = restored.windows(2).map(|two| two[1] - two[0]).fold(0.0, f64::max);
        assert!((longest - 0.328).abs() < 0.02, "{longest}");
    }

    /// Poses at 30 Hz, with stamps of joint states at 100 Hz: rounded to 10 ms, or copied from the latest joint state.
    #[test]
    fn values_show_whether_stamps_are_rounded_or_copied() {
        let true_s = sent(1.0 / 30.0, 0.0, 0..0);
        let stamps_s = rounded(&true_s, 0.01);
        let raw: Vec<i64> = stamps_s.iter().map(|t_s| (t_s * 1e9).round() as i64).collect();
        for (sampled_s, is_rounded) in [(&true_s, true), (&stamps_s, false)] {
            let mut array = ArrayColumns { width: 1, ..Default::default() };
            for (t_s, nanos) in sampled_s.iter().zip(&raw) {
                array.times.push(*nanos, *nanos, *nanos);
                array.values.push((2.0 * t_s).sin());
            }
            let values = PartValues::Array(&array);
            let restored = RestoredStamps::restore(&raw, &values).expect("rounded stamps");
            assert_eq!(restored.is_smoother_than(&raw, &values), is_rounded);
        }
    }

    /// Stamps on a grid of 10 ms, at 90 Hz: rounded, or from a sender at 100 Hz that loses every ninth row.
    #[test]
    fn values_show_whether_stamps_are_rounded_or_rows_are_lost() {
        let sent_s = sent(0.01, 0.0, 0..0);
        let kept = sent_s.iter().enumerate().filter(|(row, _)| (row + 1) % 9 != 0);
        let kept_s: Vec<f64> = kept.map(|(_, t_s)| *t_s).collect();
        let true_s = sent(0.01 * 9.0 / 8.0, 0.0, 0..0);
        for (sampled_s, is_rounded) in [(true_s, true), (kept_s, false)] {
            let mut array = ArrayColumns { width: 1, ..Default::default() };
            for t_s in &sampled_s {
                array.values.push((2.0 * t_s).sin());
            }
            let raw: Vec<i64> = rounded(&sampled_s, 0.01)
                .iter()
                .map(|t_s| 1_000_000_000 + (t_s * 1e9).round() as i64)
                .collect();
            let restored = RestoredStamps::restore(&raw, &PartValues::Array(&array));
            assert_eq!(restored.is_some(), is_rounded);
        }
    }
}
