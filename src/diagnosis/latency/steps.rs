//! Large latency steps: assigns a candidate lag to each time, minimising speed differences plus a price per
//! step (Viterbi 1967).

use super::coarse::CoarseLatencyChange;
use super::correlation::{SpeedSeries, median_period_s, window_s};
use super::lag_windows::LagWindow;
use super::piecewise::PiecewiseLatency;
use super::profile::{LatencyProfile, LatencyShape, LatencyStep, largest, mean};
use super::speed_residual::{MAX_SPEED_RESIDUAL_SHARE, SpeedPair};
use crate::samples::sampling::rows_within;
use crate::{EstimateResult, Measured};
use ground::stats::thin::thinned;
use ground::stats::{highest, lowest, parabola_minimum};

/// More do not improve a lag.
pub(super) const MAX_PROFILE_SAMPLES: usize = 4000;
/// Between two candidate lags.
const MIN_LAG_SEPARATION_S: f64 = 0.015;
const MIN_LEVEL_S: f64 = 1.5;
const MAX_LAGS: usize = 8;
/// Standard error of a lag from speeds alone.
const COARSE_STD_ERROR_S: f64 = 2e-3;
/// After the steps, relative to the best constant lag.
const MAX_RESIDUAL_RATIO: f64 = 0.35;

/// Latency steps, from the lags in `followed`.
pub(crate) fn detect_steps(
    speeds: SpeedPair,
    followed: &[&LagWindow],
) -> Option<CoarseLatencyChange> {
    let mut lags = candidate_lags(followed);
    let after_leaps: Vec<f64> = forward_leaps_s(speeds.stream)
        .into_iter()
        .flat_map(|leap_s| lags.iter().flat_map(move |lag_s| [lag_s - leap_s, lag_s + leap_s]))
        .collect();
    lags.extend(after_leaps);
    let rough = (lags.len() > 1).then(|| assign_lags(speeds, &lags)).flatten()?;
    Some(assign_lags(speeds, &rough.finer_lags(speeds)).unwrap_or(rough))
}

/// Sizes of the largest steps of a clock that was set forward, if the largest gaps are such steps, s.
fn forward_leaps_s(stream: &SpeedSeries) -> Vec<f64> {
    const MAX_LEAPS: usize = 2;
    /// Smaller ones are within a window.
    const MIN_LEAP_S: f64 = 1.0;
    let usual_s = median_period_s(&stream.t_s) + window_s(&stream.t_s);
    let intervals = stream.t_s.windows(2).map(|pair| pair[1] - pair[0] - usual_s);
    let mut leaps: Vec<f64> = intervals.filter(|leap_s| *leap_s > MIN_LEAP_S).collect();
    leaps.sort_by(|a, b| b.total_cmp(a));
    leaps.truncate(MAX_LEAPS);
    leaps
}

/// Lags of the windows, most frequent first. Close ones merge to the best correlated.
fn candidate_lags(windows: &[&LagWindow]) -> Vec<f64> {
    let mut all = windows.to_vec();
    all.sort_by(|a, b| a.lag_s.total_cmp(&b.lag_s));
    let mut groups: Vec<&[&LagWindow]> =
        all.chunk_by(|a, b| b.lag_s - a.lag_s < MIN_LAG_SEPARATION_S).collect();
    groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
    let best = |group: &[&LagWindow]| highest(group, |it| it.correlation).map(|best| best.lag_s);
    groups.into_iter().take(MAX_LAGS).filter_map(best).collect()
}

fn assign_lags(SpeedPair { arm, stream }: SpeedPair, lags: &[f64]) -> Option<CoarseLatencyChange> {
    /// Price of a step, as a duration of the smallest speed difference.
    const STEP_PRICE_S: f64 = 10.0;
    let rows: Vec<usize> = thinned(0..stream.t_s.len(), MAX_PROFILE_SAMPLES).collect();
    let compared = stream.at_rows(rows.iter().copied());
    let speeds = SpeedPair { arm, stream: &compared };
    let costs: Vec<Vec<f64>> = lags.iter().map(|&lag_s| speeds.differences(&|_| lag_s)).collect();
    let (begin_s, end_s) = compared.span_s()?;
    let min_difference = |at: usize| costs.iter().map(|own| own[at]).fold(f64::INFINITY, f64::min);
    let best: f64 = (0..rows.len()).map(min_difference).sum();
    let span_s = (end_s - begin_s).max(f64::MIN_POSITIVE);
    let path = cheapest_path(&costs, (STEP_PRICE_S * best / span_s).max(f64::MIN_POSITIVE))?;
    let gap_s = |row: &usize| stream.t_s[*row] - stream.t_s[*row - 1];
    // Start of each level, its lag and the interval before it. As long as the step if only the clock was set forward.
    let step = |at: usize| {
        let between = rows[at - 1] + 1..=rows[at];
        let begin = highest(between, gap_s).unwrap_or(rows[at]);
        (stream.t_s[begin], path[at], gap_s(&begin))
    };
    let steps = (1..rows.len()).filter(|&at| path[at] != path[at - 1]).map(step);
    let levels: Vec<(f64, usize, f64)> =
        std::iter::once((f64::NEG_INFINITY, path[0], 0.0)).chain(steps).collect();
    // Short levels are glitches in one of the speeds.
    let ends_s = levels.iter().skip(1).map(|level| level.0).chain([end_s]);
    let long = levels.iter().zip(ends_s);
    let long = long.filter(|(level, end_s)| end_s - level.0.max(begin_s) >= MIN_LEVEL_S);
    let mut levels: Vec<(f64, usize, f64)> = long.map(|(level, _)| *level).collect();
    levels.dedup_by_key(|level| level.1);
    levels.first_mut()?.0 = f64::NEG_INFINITY;
    let steps = levels.windows(2).map(|both| {
        let overlap_s = lags[both[1].1] - lags[both[0].1] - both[1].2;
        (both[1].0, overlap_s.abs())
    });
    let of_levels: Vec<_> = levels.iter().map(|level| (level.0, lags[level.1])).collect();
    let latency = PiecewiseLatency::with_steps(&of_levels);
    let found = CoarseLatencyChange { steps: steps.collect(), latency };
    let is_clear = |row: &usize| found.is_far_from_steps(compared.t_s[*row]);
    let clear: Vec<usize> = (0..rows.len()).filter(is_clear).collect();
    let cost = |lag_at: &dyn Fn(f64) -> usize| -> f64 {
        clear.iter().map(|&row| costs[lag_at(compared.t_s[row])][row]).sum()
    };
    let with = cost(&|t_s| levels[levels.partition_point(|level| level.0 <= t_s) - 1].1);
    let alone = (0..lags.len()).map(|lag| cost(&|_| lag)).fold(f64::INFINITY, f64::min);
    let clear = compared.at_rows(clear.iter().copied());
    let variation = SpeedPair { stream: &clear, ..speeds }.variation();
    let explains = with < (MAX_RESIDUAL_RATIO * alone).min(MAX_SPEED_RESIDUAL_SHARE * variation);
    (found.has_steps() && explains).then_some(found)
}

/// The lag of each row with the smallest sum of costs, of which there is a list per lag, and of a price per change of the
/// lag.
fn cheapest_path(costs: &[Vec<f64>], price: f64) -> Option<Vec<usize>> {
    let cheapest = |sums: &[f64]| lowest(0..sums.len(), |at| sums[*at]);
    let rows = costs.first()?.len();
    let mut sums: Vec<f64> = costs.iter().map(|own| own[0]).collect();
    let mut came_by: Vec<Vec<usize>> = Vec::with_capacity(rows);
    for row in 1..rows {
        let best = cheapest(&sums)?;
        let from = |lag: usize| if sums[best] + price < sums[lag] { best } else { lag };
        let from: Vec<usize> = (0..costs.len()).map(from).collect();
        let next = from.iter().enumerate().map(|(lag, &from)| {
            let step = if from == lag { 0.0 } else { price };
            sums[from] + step + costs[lag][row]
        });
        sums = next.collect();
        came_by.push(from);
    }
    let mut path = vec![cheapest(&sums)?; rows];
    for row in (1..rows).rev() {
        path[row - 1] = came_by[row - 1][path[row]];
    }
    Some(path)
}

impl CoarseLatencyChange {
    /// Lag with the smallest speed difference over each level, s.
    fn finer_lags(&self, SpeedPair { arm, stream }: SpeedPair) -> Vec<f64> {
        /// Around the coarse lag.
        const LAG_SEARCH_RANGE_S: f64 = 0.03;
        const LAG_SEARCH_STEP_S: f64 = 1e-3;
        let ends_s = self.steps.iter().map(|step| step.0).chain([f64::INFINITY]);
        let finer = self.levels().into_iter().zip(ends_s).map(|((from_s, lag_s), end_s)| {
            let clear = rows_within(&stream.t_s, from_s, end_s);
            let clear = clear.filter(|&row| self.is_far_from_steps(stream.t_s[row]));
            let compared = stream.at_rows(thinned(Vec::from_iter(clear), MAX_PROFILE_SAMPLES));
            let speeds = SpeedPair { arm, stream: &compared };
            let cost = |lag_s: f64| speeds.residual(&|_| lag_s);
            let steps = (LAG_SEARCH_RANGE_S / LAG_SEARCH_STEP_S) as i32;
            let tried = (-steps..=steps).map(|step| lag_s + LAG_SEARCH_STEP_S * f64::from(step));
            let best_s = lowest(tried.map(|lag_s| (cost(lag_s), lag_s)), |it| it.0);
            let Some((min_residual, best_s)) = best_s else { return lag_s };
            let [before, after] =
                [best_s - LAG_SEARCH_STEP_S, best_s + LAG_SEARCH_STEP_S].map(cost);
            best_s + LAG_SEARCH_STEP_S * parabola_minimum([before, min_residual, after])
        });
        let mut finer: Vec<f64> = finer.collect();
        finer.sort_by(f64::total_cmp);
        finer.dedup_by(|a, b| (*a - *b).abs() < LAG_SEARCH_STEP_S);
        finer
    }

    /// Latency profile of these steps, refined with the profile `found` on the stream without them, plus
    /// its additional jumps.
    pub fn profile(&self, found: &EstimateResult<LatencyProfile>) -> LatencyProfile {
        /// For merging a remaining jump with a step.
        const MAX_MERGE_DISTANCE_S: f64 = 2.0;
        let fine = found.as_ref().ok().cloned().unwrap_or_default();
        let retained_s = self.retained_s();
        let levels = self.levels().into_iter();
        let levels: Vec<(f64, f64)> =
            levels.map(|(from_s, lag_s)| (from_s, lag_s - retained_s)).collect();
        let begins: Vec<f64> = levels.iter().map(|(from_s, lag_s)| from_s - lag_s).collect();
        let level = |index: usize| {
            let until_s = begins.get(index + 1).copied().unwrap_or(f64::INFINITY);
            mean(fine.windows.iter().filter(|(t_s, _)| (begins[index]..until_s).contains(t_s)))
        };
        let step = |index: usize| {
            let (at_s, coarse_s) = (levels[index].0, levels[index].1 - levels[index - 1].1);
            let size_s = match (level(index - 1), level(index)) {
                (Some(before), Some(after)) => Measured {
                    value: coarse_s + after.value - before.value,
                    std_error: before.std_error.hypot(after.std_error),
                    dof: before.dof + after.dof,
                },
                _ => {
                    Measured { value: coarse_s, std_error: COARSE_STD_ERROR_S, dof: f64::INFINITY }
                }
            };
            LatencyStep { at_s, size_s }
        };
        let mut jumps: Vec<LatencyStep> = (1..levels.len()).map(step).collect();
        let is_clear = |jump: &&LatencyStep| {
            begins.iter().all(|begin_s| (jump.at_s - begin_s).abs() > MAX_MERGE_DISTANCE_S)
        };
        jumps.extend(fine.steps.iter().filter(|_| fine.is_unsteady).filter(is_clear));
        jumps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        LatencyProfile {
            swing_s: largest(&jumps).unwrap_or_default(),
            is_unsteady: true,
            shape: LatencyShape::Steps,
            skew: 0.0,
            levels: PiecewiseLatency::with_steps(&levels),
            parameters: 2 * jumps.len(),
            steps: jumps,
            ..fine
        }
    }
}

#[cfg(test)]
mod tests {
    use super::detect_steps;
    use crate::latency::coarse::CoarseLatencyChange;
    use crate::latency::coarse::tests::{changed, pair};
    use crate::latency::lag_windows::lag_windows;
    use crate::latency::speed_residual::SpeedPair;

    #[test]
    fn a_clock_that_is_set_forward_beyond_the_arms_times_is_measured() {
        for size_s in [3.0, 12.0, 60.0] {
            let (arm, mut stream) = pair(|_| 0.0);
            stream.t_s.iter_mut().filter(|t_s| **t_s > 17.0).for_each(|t_s| *t_s += size_s);
            let speeds = SpeedPair { arm: &arm, stream: &stream };
            let windows = lag_windows(speeds, 5.0);
            let followed: Vec<_> = windows.iter().filter(|it| it.correlation > 0.85).collect();
            let found = detect_steps(speeds, &followed).expect("a step");
            let profile = found.profile(&Err(crate::NotObservable::AtRest));
            let [step] = profile.steps.as_slice() else { panic!("{size_s}: {found:?}") };
            assert!((step.size_s.value - size_s).abs() < 0.01, "{size_s}: {step:?}");
            assert!((step.at_s - 17.01 - size_s).abs() < 0.02, "{size_s}: {step:?}");
            let compared = found.compensated(&stream.t_s);
            assert!(compared.len() > 3950, "{size_s}: {}", compared.len());
        }
    }

    #[test]
    fn steps_are_estimated_with_their_times() {
        for sizes_s in [[0.3, 0.3], [-0.4, -0.4], [0.1, 0.8], [1.5, 0.0]] {
            let late = |t_s: f64| match t_s {
                t_s if t_s < 14.0 => 0.0,
                t_s if t_s < 27.0 => sizes_s[0],
                _ => sizes_s[1],
            };
            let found = changed(late);
            let found = found.filter(CoarseLatencyChange::has_steps).expect("it steps");
            let profile = found.profile(&Err(crate::NotObservable::AtRest));
            let first = profile.steps[0];
            assert!((first.at_s - 14.0).abs() < 0.3, "{sizes_s:?}: {found:?}");
            assert!((first.size_s.value - sizes_s[0]).abs() < 0.01, "{sizes_s:?}: {found:?}");
            let is_one = sizes_s[0] == sizes_s[1];
            assert_eq!(profile.steps.len(), if is_one { 1 } else { 2 }, "{found:?}");
            let straight = found.compensated(&[1.0, 2.0, 38.0]);
            let last = straight[straight.len() - 1].1 - 38.0 + sizes_s[1];
            assert!(last.abs() < 0.01, "{sizes_s:?}: {straight:?}");
        }
    }
}
