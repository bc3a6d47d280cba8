//! Separates rows of one or two periodic senders by time.

/// Maximum share of unexplained rows.
pub(super) const MAX_UNEXPLAINED_SHARE: f64 = 0.04;

/// Minimum share of ticks with a row.
const MIN_TICK_SHARE: f64 = 0.85;

/// Maximum deviation from a tick, periods.
const MAX_TICK_DEVIATION: f64 = 0.3;

/// Maximum extrapolation error in a smooth sequence, m or rad.
pub(super) const MAX_EXTRAPOLATION_ERROR: f64 = 3e-4;

/// Minimum number of rows of a publisher.
pub(super) const MIN_PUBLISHER_ROWS: usize = 12;

/// Extrapolation error of a row from two earlier ones.
pub(super) type ExtrapolationError<'a> = &'a dyn Fn(usize, usize, usize) -> f64;

/// The same share for a single sender. With less, a fine period could explain two coarse ones.
const MIN_SINGLE_TICK_SHARE: f64 = 0.7;

/// Whether one period explains nearly all rows.
pub(super) fn has_one_sender(t_s: &[f64]) -> bool {
    let distinct: Vec<f64> =
        t_s.iter().copied().fold(Vec::with_capacity(t_s.len()), |mut kept, t| {
            if kept.last().is_none_or(|last| t - last > 1e-6) {
                kept.push(t);
            }
            kept
        });
    let few = |remaining: usize| (remaining as f64) < MAX_UNEXPLAINED_SHARE * t_s.len() as f64;
    few(t_s.len() - distinct.len())
        && frequent_intervals(&distinct).into_iter().any(|period_s| {
            let train =
                longest_train(&distinct, &vec![false; distinct.len()], period_s, &|_, _, _| 0.0);
            let ticks = (distinct[distinct.len() - 1] - distinct[0]) / period_s;
            few(distinct.len() - train.len()) && train.len() as f64 > MIN_SINGLE_TICK_SHARE * ticks
        })
}

/// Whether two combs explain the stamps of `split` clearly better than one.
///
/// Deviations are normal with drifting phase in both models, so this is a likelihood ratio. A single
/// sender's jitter deviates equally from any comb.
pub(super) fn has_two_senders(t_s: &[f64], split: &SenderSplit) -> bool {
    /// Minimum ratio of deviations. Splitting one sender gains less, although the split selects fitting
    /// rows.
    const MIN_DEVIATION_RATIO: f64 = 3.0;
    /// Minimum deviation, s: stamp resolution.
    const MIN_DEVIATION_S: f64 = 1e-6;
    let one_s = frequent_intervals(t_s)
        .into_iter()
        .filter_map(|period_s| comb_deviation(t_s, period_s))
        .fold(phase_deviation(t_s), f64::min)
        .max(MIN_DEVIATION_S);
    let log_of = |(rows, period_s): (&Vec<usize>, f64)| {
        let own: Vec<f64> = rows.iter().map(|&row| t_s[row]).collect();
        let deviation_s = comb_deviation(&own, period_s).unwrap_or(f64::INFINITY);
        rows.len() as f64 * deviation_s.max(MIN_DEVIATION_S).ln()
    };
    let two: f64 = split.rows.iter().zip(split.periods_s).map(log_of).sum();
    one_s.ln() - two / split.explained_rows() as f64 > MIN_DEVIATION_RATIO.ln()
}

/// Deviation from a comb, s; `None` if too few ticks have a row ([`MIN_SINGLE_TICK_SHARE`]).
fn comb_deviation(t_s: &[f64], period_s: f64) -> Option<f64> {
    let (mut tick, mut phases) = (0.0, vec![*t_s.first()?]);
    for pair in t_s.windows(2) {
        tick += ((pair[1] - pair[0]) / period_s).round().max(1.0);
        phases.push(pair[1] - tick * period_s);
    }
    (t_s.len() as f64 > MIN_SINGLE_TICK_SHARE * tick).then(|| phase_deviation(&phases))
}

/// Rms deviation from the local mean, without the largest, which are slips by a period.
fn phase_deviation(phases: &[f64]) -> f64 {
    /// Rows on each side that determine the phase.
    const HALF_WINDOW_ROWS: usize = 8;
    const KEPT_SHARE: f64 = 0.95;
    let mut squares: Vec<f64> = phases
        .windows(2 * HALF_WINDOW_ROWS + 1)
        .map(|own| {
            let others = own.iter().sum::<f64>() - own[HALF_WINDOW_ROWS];
            (own[HALF_WINDOW_ROWS] - others / (2 * HALF_WINDOW_ROWS) as f64).powi(2)
        })
        .collect();
    let kept = (KEPT_SHARE * squares.len() as f64).ceil() as usize;
    if kept == 0 {
        return 0.0;
    }
    squares.select_nth_unstable_by(kept - 1, f64::total_cmp);
    (squares[..kept].iter().sum::<f64>() / kept as f64).sqrt()
}

/// Most frequent intervals between rows and the next few, s.
fn frequent_intervals(t_s: &[f64]) -> Vec<f64> {
    const MAX_ROWS_AHEAD: usize = 6;
    /// Relative tolerance of equal intervals.
    const MAX_RELATIVE_DIFFERENCE: f64 = 0.03;
    const MAX_PERIODS: usize = 14;
    /// Number of frequent intervals that may be one irregular interval, and their maximum ratio.
    const MAX_MERGED_INTERVALS: usize = 8;
    const MAX_MERGED_RATIO: f64 = 1.8;
    let mut all: Vec<f64> = (1..=MAX_ROWS_AHEAD)
        .flat_map(|ahead| t_s.iter().zip(t_s.iter().skip(ahead)).map(|(a, b)| b - a))
        .filter(|dt| *dt > 1e-6)
        .collect();
    all.sort_by(f64::total_cmp);
    let mut bins: Vec<(usize, f64)> = Vec::new();
    let mut at = 0;
    while at < all.len() {
        let end =
            at + all[at..].partition_point(|dt| *dt <= all[at] * (1.0 + MAX_RELATIVE_DIFFERENCE));
        bins.push((end - at, all[(at + end) / 2]));
        at = end;
    }
    bins.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.total_cmp(&b.1)));
    let often: Vec<f64> =
        bins.into_iter().take(MAX_PERIODS).map(|(_, period_s)| period_s).collect();
    // A stamp copied from joint states is the one before or after the due time.
    let mut sorted: Vec<f64> = often.iter().copied().take(MAX_MERGED_INTERVALS).collect();
    sorted.sort_by(f64::total_cmp);
    let between = sorted.windows(2).filter(|pair| pair[1] < MAX_MERGED_RATIO * pair[0]);
    let between: Vec<f64> = between.map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    often.into_iter().chain(between).collect()
}

/// Unused rows every `period_s`, from the start that finds the most.
fn longest_train(
    t_s: &[f64],
    used: &[bool],
    period_s: f64,
    error: ExtrapolationError<'_>,
) -> Vec<usize> {
    const MAX_STARTS: usize = 6;
    let free: Vec<usize> = (0..t_s.len()).filter(|&row| !used[row]).collect();
    let mut best = Vec::new();
    for (passed, &start) in free.iter().take(MAX_STARTS).enumerate() {
        // A later start cannot find more.
        if best.len() > free.len() - passed {
            break;
        }
        let train = follow_period(t_s, used, start, period_s, error);
        if train.len() >= best.len() {
            best = train;
        }
    }
    best
}

/// Rows after `start` every `period_s`, each predicted from the previous one. At one tick, selects the row
/// nearest to the extrapolation.
fn follow_period(
    t_s: &[f64],
    used: &[bool],
    start: usize,
    period_s: f64,
    error: ExtrapolationError<'_>,
) -> Vec<usize> {
    /// Maximum stamp difference at one tick, periods.
    const MAX_STAMP_DIFFERENCE: f64 = 0.02;
    /// Maximum distance ratio to prefer a row by value.
    const MAX_VALUE_DISTANCE_RATIO: f64 = 0.5;
    let mut rows = vec![start];
    loop {
        let from = rows[rows.len() - 1];
        let before = rows[rows.len().saturating_sub(2)];
        let mut best: Option<(f64, usize)> = None;
        for row in from + 1..t_s.len() {
            let periods = (t_s[row] - t_s[from]) / period_s;
            if best.is_some() && periods > 1.0 + MAX_TICK_DEVIATION {
                break;
            }
            let tick = periods.round().max(1.0);
            let late = (periods - tick).abs();
            if used[row] || late > MAX_TICK_DEVIATION {
                continue;
            }
            if best.is_none_or(|(least, _)| late < least - MAX_STAMP_DIFFERENCE) {
                best = Some((late, row));
            } else if let Some((least, current)) = best
                && late < least + MAX_STAMP_DIFFERENCE
                && error(before, from, row)
                    < MAX_VALUE_DISTANCE_RATIO * error(before, from, current)
            {
                best = Some((least.min(late), row));
            }
            if tick > 1.0 {
                break;
            }
        }
        let Some((_, row)) = best else { return rows };
        rows.push(row);
    }
}

pub(super) struct SenderSplit {
    pub(super) periods_s: [f64; 2],
    pub(super) rows: [Vec<usize>; 2],
}

/// Finds two periods with rows at nearly all ticks that explain nearly all rows. Of smooth splits, takes
/// the most regular. `None` if every split is rougher than `max_roughness`.
pub(super) fn split_senders(
    t_s: &[f64],
    error: ExtrapolationError<'_>,
    max_roughness: f64,
) -> Option<SenderSplit> {
    /// Maximum ratio to the least roughness.
    const MAX_ROUGHNESS_RATIO: f64 = 2.0;
    let firsts = frequent_intervals(t_s).into_iter().filter_map(|period_s| {
        let (first, used) = complete_train(t_s, &vec![false; t_s.len()], period_s, error)?;
        Some((period_s, first, used))
    });
    let firsts: Vec<(f64, Vec<usize>, Vec<bool>)> = firsts.collect();
    // A split is at least as rough as its first train.
    if firsts.iter().all(|(_, first, _)| roughness(first, error) > max_roughness) {
        return None;
    }
    let tried = firsts.into_iter().filter_map(|(period_s, first, used)| {
        let rest: Vec<f64> = (0..t_s.len()).filter(|&row| !used[row]).map(|row| t_s[row]).collect();
        // A period's shortest intervals limit its rows.
        let span_s = t_s.last()? - t_s.first()?;
        let most = |second_s: f64| 2.0 + span_s / ((1.0 - MAX_TICK_DEVIATION) * second_s);
        let remaining = rest.len() as f64 - MAX_UNEXPLAINED_SHARE * t_s.len() as f64;
        let enough =
            frequent_intervals(&rest).into_iter().filter(|second_s| most(*second_s) > remaining);
        let splits = enough.filter_map(move |second_s| {
            let second = complete_train(t_s, &used, second_s, error)?.0;
            SenderSplit::new(t_s, [period_s, second_s], [first.clone(), second])
        });
        Some(splits.map(|split| (split.roughness(error), split)).collect::<Vec<_>>())
    });
    let splits: Vec<(f64, SenderSplit)> = tried.flatten().collect();
    let least = splits.iter().map(|(rough, _)| *rough).fold(f64::INFINITY, f64::min);
    let smooth = splits
        .into_iter()
        .filter(|(rough, _)| *rough <= MAX_EXTRAPOLATION_ERROR.max(MAX_ROUGHNESS_RATIO * least));
    let scored = smooth.map(|(_, split)| (split.unevenness(t_s), split));
    scored.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, split)| split)
}

pub(super) fn split_by_periods(
    t_s: &[f64],
    periods_s: [f64; 2],
    error: ExtrapolationError<'_>,
) -> Option<SenderSplit> {
    let (first, used) = complete_train(t_s, &vec![false; t_s.len()], periods_s[0], error)?;
    let second = complete_train(t_s, &used, periods_s[1], error)?.0;
    SenderSplit::new(t_s, periods_s, [first, second])
}

/// Rows every `period_s`, and those used so far. `None` if too many ticks are empty.
fn complete_train(
    t_s: &[f64],
    used: &[bool],
    period_s: f64,
    error: ExtrapolationError<'_>,
) -> Option<(Vec<usize>, Vec<bool>)> {
    let train = longest_train(t_s, used, period_s, error);
    let ticks = (t_s.last()? - t_s.first()?) / period_s;
    let is_kept = train.len() >= MIN_PUBLISHER_ROWS && train.len() as f64 > MIN_TICK_SHARE * ticks;
    let mut used = used.to_vec();
    train.iter().for_each(|&row| used[row] = true);
    is_kept.then_some((train, used))
}

impl SenderSplit {
    pub(super) fn explained_rows(&self) -> usize {
        self.rows[0].len() + self.rows[1].len()
    }

    /// Mean extrapolation error within a period; the larger of both.
    pub(super) fn roughness(&self, error: ExtrapolationError<'_>) -> f64 {
        self.rows.iter().map(|rows| roughness(rows, error)).fold(0.0, f64::max)
    }

    /// Mean deviation from the ticks, periods, plus the share of unexplained rows.
    pub(super) fn unevenness(&self, t_s: &[f64]) -> f64 {
        let off_tick = |rows: &[usize], period_s: f64| -> f64 {
            let ticks = rows.windows(2).map(|pair| (t_s[pair[1]] - t_s[pair[0]]) / period_s);
            ticks.map(|ticks| (ticks - ticks.round()).abs()).sum()
        };
        let error: f64 = self
            .rows
            .iter()
            .zip(self.periods_s)
            .map(|(rows, period_s)| off_tick(rows, period_s))
            .sum();
        (error + (t_s.len() - self.explained_rows()) as f64) / t_s.len() as f64
    }

    /// `None` if too many rows are unexplained.
    pub(super) fn new(t_s: &[f64], periods_s: [f64; 2], rows: [Vec<usize>; 2]) -> Option<Self> {
        let mut split = Self { periods_s, rows };
        if split.rows[0].len() < split.rows[1].len() {
            split.rows.reverse();
            split.periods_s.reverse();
        }
        let remaining = t_s.len() - split.explained_rows();
        ((remaining as f64) < MAX_UNEXPLAINED_SHARE * t_s.len() as f64).then_some(split)
    }
}

pub(super) fn roughness(rows: &[usize], error: ExtrapolationError<'_>) -> f64 {
    let offs = rows.windows(3).map(|three| error(three[0], three[1], three[2]));
    offs.sum::<f64>() / rows.len() as f64
}
