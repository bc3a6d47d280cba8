//! Change of a quantity between runs: constant, a trend, or one step.
//!
//! Runs scatter beyond their own intervals, because load, temperature and configurations differ. `value =
//! line + u + e`, where `e` has the run's standard error and `u` a common standard deviation such that the
//! weighted sum of squares equals its degrees of freedom (Paule and Mandel, *Consensus values and weighting
//! factors*, J. Res. NBS 87, 1982). For a step, a before/after indicator replaces time.

use crate::Measured;
use ground::stats::{mean, median_of};

/// Estimate from one run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunEstimate {
    /// s from any origin.
    pub time_s: f64,
    /// Value.
    pub value: f64,
    /// From this run alone.
    pub std_error: f64,
}

/// Change over the runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trend {
    /// Slope, per second.
    pub rate_per_s: Measured,
    /// At `middle_s`, uncorrelated with the slope.
    pub level: Measured,
    /// Weighted mean time, s.
    pub middle_s: f64,
    /// Standard deviation between runs beyond their errors.
    pub spread: f64,
    /// If it fits better than the line.
    pub step: Option<TrendStep>,
}

/// Step between two runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrendStep {
    /// Runs before and after it, s.
    pub between_s: [f64; 2],
    /// Step height.
    pub height: Measured,
}

/// Minimum number of runs for a trend.
pub const MIN_RUNS: usize = 4;

/// Likelihood ratio of a step to the line; large because the position is selected.
const MIN_STEP_LOG_RATIO: f64 = 5.0;
/// In one pass over the runs.
const MAX_FITS: usize = 128;

/// `None` if there are fewer than [`MIN_RUNS`] runs, or all at one time.
pub fn estimate_trend(estimates: &[RunEstimate]) -> Option<Trend> {
    let mut estimates: Vec<RunEstimate> = estimates.iter().copied().filter(is_usable).collect();
    estimates.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    if estimates.len() < MIN_RUNS {
        return None;
    }
    // Preserves precision.
    let origin_s = mean(estimates.iter().map(|one| one.time_s));
    let times_s: Vec<f64> = estimates.iter().map(|one| one.time_s - origin_s).collect();
    let line = LineFit::fit(&estimates, &times_s)?;
    let step = most_likely_step(&estimates)
        .filter(|(_, fit)| fit.log_likelihood > line.log_likelihood + MIN_STEP_LOG_RATIO)
        .filter(|(between_s, fit)| {
            persists_without_any_run(&estimates, between_s[1], fit.slope.value)
        });
    Some(Trend {
        rate_per_s: line.slope,
        level: line.level,
        middle_s: origin_s + line.middle,
        spread: line.spread,
        step: step.map(|(between_s, fit)| TrendStep { between_s, height: fit.slope }),
    })
}

fn is_usable(estimates: &RunEstimate) -> bool {
    let RunEstimate { time_s, value, std_error } = estimates;
    time_s.is_finite() && value.is_finite() && std_error.is_finite() && *std_error > 0.0
}

/// With at least two runs on each side. Searches many runs from coarse to fine.
fn most_likely_step(estimates: &[RunEstimate]) -> Option<([f64; 2], LineFit)> {
    let (mut places, mut best) = (2..estimates.len() - 1, None::<(usize, LineFit)>);
    loop {
        let stride = places.len().div_ceil(MAX_FITS).max(1);
        for first_after in places.clone().step_by(stride) {
            if estimates[first_after - 1].time_s == estimates[first_after].time_s {
                continue;
            }
            let side: Vec<f64> =
                (0..estimates.len()).map(|run| f64::from(run >= first_after)).collect();
            let Some(fit) = LineFit::fit(estimates, &side) else { continue };
            if best.as_ref().is_none_or(|(_, other)| fit.log_likelihood > other.log_likelihood) {
                best = Some((first_after, fit));
            }
        }
        let (first_after, fit) = best?;
        if stride == 1 {
            return Some(([estimates[first_after - 1].time_s, estimates[first_after].time_s], fit));
        }
        places = places.start.max(first_after.saturating_sub(stride))
            ..places.end.min(first_after + stride);
    }
}

/// Whether the step after `after_s` persists without any single run. Of many runs, only those furthest from
/// the median are left out.
fn persists_without_any_run(estimates: &[RunEstimate], after_s: f64, by: f64) -> bool {
    const MIN_PERSISTING_SHARE: f64 = 0.5;
    let middle = median_of(estimates.iter().map(|one| one.value)).unwrap_or(0.0);
    let deviation = |run: usize| (estimates[run].value - middle).abs();
    let mut runs: Vec<usize> = (0..estimates.len()).collect();
    runs.sort_by(|a, b| deviation(*b).total_cmp(&deviation(*a)));
    runs.into_iter().take(MAX_FITS).all(|out| {
        let rest: Vec<RunEstimate> = [&estimates[..out], &estimates[out + 1..]].concat();
        let side: Vec<f64> = rest.iter().map(|one| f64::from(one.time_s >= after_s)).collect();
        LineFit::fit(&rest, &side).is_some_and(|fit| fit.slope.value / by >= MIN_PERSISTING_SHARE)
    })
}

/// `value = level + slope · (x − middle)`.
#[derive(Clone, Copy, Debug)]
struct LineFit {
    slope: Measured,
    level: Measured,
    middle: f64,
    spread: f64,
    /// Weighted sum.
    squares: f64,
    log_likelihood: f64,
}

impl LineFit {
    /// `None` if all of `x` are equal.
    fn fit(estimates: &[RunEstimate], x: &[f64]) -> Option<Self> {
        let dof = estimates.len() as f64 - 2.0;
        let with = |variance: f64| Self::with_variance(estimates, x, variance);
        let exceeds = |variance: f64| Some(with(variance)?.squares > dof);
        if !exceeds(0.0)? {
            return with(0.0);
        }
        // The squares decrease with the spread.
        let mut low = 0.0;
        let mut high =
            estimates.iter().map(|one| one.value.powi(2)).fold(f64::MIN_POSITIVE, f64::max);
        while exceeds(high)? {
            high *= 4.0;
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if exceeds(middle)? { low = middle } else { high = middle }
        }
        with(high)
    }

    /// Fit with this variance between runs.
    fn with_variance(estimates: &[RunEstimate], x: &[f64], variance: f64) -> Option<Self> {
        let row = |(one, &x): (&RunEstimate, &f64)| {
            (1.0 / (one.std_error.powi(2) + variance), x, one.value)
        };
        let rows = || estimates.iter().zip(x).map(row);
        let weight: f64 = rows().map(|(w, ..)| w).sum();
        let middle = rows().map(|(w, x, _)| w * x).sum::<f64>() / weight;
        let level = rows().map(|(w, _, y)| w * y).sum::<f64>() / weight;
        let across: f64 = rows().map(|(w, x, _)| w * (x - middle).powi(2)).sum();
        if across <= 0.0 || !across.is_finite() {
            return None;
        }
        let slope = rows().map(|(w, x, y)| w * (x - middle) * (y - level)).sum::<f64>() / across;
        let residual = |x: f64, y: f64| y - level - slope * (x - middle);
        let squares: f64 = rows().map(|(w, x, y)| w * residual(x, y).powi(2)).sum();
        let logs: f64 = rows().map(|(w, ..)| -w.ln()).sum();
        let dof = estimates.len() as f64 - 2.0;
        let measured = |value, variance: f64| Measured { value, std_error: variance.sqrt(), dof };
        Some(Self {
            slope: measured(slope, 1.0 / across),
            level: measured(level, 1.0 / weight),
            middle,
            spread: variance.sqrt(),
            squares,
            log_likelihood: -0.5 * (logs + squares),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    const DAY_S: f64 = 86_400.0;

    /// Daily runs.
    fn runs(count: usize, spread: f64, seed: u64, course: impl Fn(f64) -> f64) -> Vec<RunEstimate> {
        let mut random = Pcg64::seed_from_u64(seed);
        let noise = Normal::new(0.0, 1.0).expect("a distribution");
        let estimates = (0..count).map(|day| {
            let std_error = if day % 3 == 0 { 0.5 } else { 0.1 };
            let error = std_error * noise.sample(&mut random);
            let value = course(day as f64) + spread * noise.sample(&mut random) + error;
            RunEstimate { time_s: 1.78e9 + day as f64 * DAY_S, value, std_error }
        });
        estimates.collect()
    }

    #[test]
    fn the_interval_covers_the_rate_at_its_confidence() {
        for spread in [0.0, 0.4] {
            let covered = (0..400).filter(|&seed| {
                let estimates = runs(12, spread, seed, |day| 3.0 + 0.2 * day);
                let rate = estimate_trend(&estimates).expect("a trend").rate_per_s.scaled(DAY_S);
                let [low, high] = rate.interval(0.95);
                (low..=high).contains(&0.2)
            });
            let covered = covered.count();
            assert!((365..=400).contains(&covered), "{covered} of 400 with a spread of {spread}");
        }
    }

    #[test]
    fn a_constant_quantity_rarely_has_a_trend() {
        let moves = |seed| {
            let found = estimate_trend(&runs(20, 0.3, seed, |_| 5.0)).expect("a trend");
            let [low, high] = found.rate_per_s.interval(0.999);
            !(low..=high).contains(&0.0) || found.step.is_some()
        };
        let wrong = (0..400).filter(|&seed| moves(seed)).count();
        assert!(wrong <= 12, "{wrong} of 400");
    }

    #[test]
    fn a_step_and_a_slope_are_distinguished() {
        for seed in 0..50 {
            let stepped =
                estimate_trend(&runs(20, 0.1, seed, |day| if day < 12.0 { 0.0 } else { 4.0 }));
            let step = stepped.expect("a trend").step.expect("a step");
            assert_eq!(step.between_s, [11.0, 12.0].map(|day| 1.78e9 + day * DAY_S));
            let [low, high] = step.height.interval(0.9999);
            assert!((low..=high).contains(&4.0), "{step:?}");
            let sloped = estimate_trend(&runs(20, 0.1, seed, |day| 0.2 * day)).expect("a trend");
            assert_eq!(sloped.step, None);
        }
    }

    #[test]
    fn a_single_outlier_run_is_no_step() {
        for (seed, at) in [1, 2, 10, 17, 18].into_iter().enumerate() {
            let mut estimates = runs(20, 0.1, seed as u64, |_| 0.0);
            estimates[at].value += 4.0;
            assert_eq!(estimate_trend(&estimates).expect("a trend").step, None, "run {at} of 20");
        }
    }

    #[test]
    fn a_step_before_the_last_two_runs_is_detected() {
        let stepped = estimate_trend(&runs(12, 0.1, 3, |day| if day < 10.0 { 0.0 } else { -4.0 }));
        let step = stepped.expect("a trend").step.expect("a step");
        assert!((-4.5..-3.5).contains(&step.height.value), "{step:?}");
    }

    #[test]
    fn too_few_runs_or_equal_times_give_no_trend() {
        let mut estimates = runs(4, 0.1, 1, |day| day);
        assert!(estimate_trend(&estimates).is_some() && estimate_trend(&estimates[..3]).is_none());
        estimates.iter_mut().for_each(|one| one.time_s = 0.0);
        assert_eq!(estimate_trend(&estimates), None);
        estimates.iter_mut().for_each(|one| one.std_error = f64::INFINITY);
        assert_eq!(estimate_trend(&estimates), None);
    }
}
