//! Standard deviation and autocorrelation of residuals. Filters, quantised encoders and model errors
//! persist from sample to sample, so intervals for independent samples are too narrow by the square root of
//! the inflation. The model is white noise plus a first-order autoregressive part, `γ(0) = σ²`, `γ(k) =
//! share·σ²·ρ^k`.

use ground::geometry::Vec3;
use ground::stats::mean;

/// Noise of one kind of residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Noise {
    /// Standard deviation of one component, in the residual's unit.
    pub sigma: f64,
    /// Autoregressive share of the variance, 0 to 1.
    pub share: f64,
    /// Correlation of that part per sample, 0 to 1.
    pub rho: f64,
    /// Inflation by errors that recur with the configuration, in addition to that by autocorrelation.
    pub recurrence: f64,
}

impl Noise {
    /// Independent samples.
    pub fn white(sigma: f64) -> Self {
        Self { sigma, share: 0.0, rho: 0.0, recurrence: 0.0 }
    }

    /// Inflation of the variance of a mean (`1 + 2·Σ γ(k)/γ(0)`).
    pub fn inflation(&self) -> f64 {
        self.inflation_by_time() + self.recurrence
    }

    fn inflation_by_time(&self) -> f64 {
        1.0 + 2.0 * self.share * self.rho / (1.0 - self.rho)
    }

    /// Ratio of the standard deviation of a mean to that under autocorrelation alone.
    pub fn recurrence_factor(&self) -> f64 {
        (1.0 + self.recurrence / self.inflation_by_time()).sqrt()
    }

    /// Number of independent components of samples with three each.
    pub fn independent(&self, samples: usize) -> f64 {
        3.0 * samples as f64 / self.inflation()
    }

    /// Inflation for a mean of squares of normal noise (`1 + 2·Σ (γ(k)/γ(0))²`).
    pub fn inflation_of_squares(&self) -> f64 {
        let Self { share, rho, recurrence, .. } = *self;
        1.0 + 2.0 * (share * rho).powi(2) / (1.0 - rho * rho) + recurrence
    }

    /// Estimates the noise of three components per sample, all of weight 1. `sigma` is at least `floor`.
    pub fn unweighted(residual: &[Vec3], floor: f64) -> Self {
        Self::estimate(residual, &vec![1.0; residual.len()], floor)
    }

    /// Estimates the noise of three components per sample, with `weights` 0 to 1. `sigma` is at least
    /// `floor`.
    pub fn estimate(residual: &[Vec3], weights: &[f64], floor: f64) -> Self {
        let variance = weighted_variance(residual, weights);
        let correlations = correlations(residual, weights, variance);
        let (share, rho) = fit_autoregression(&correlations, residual.len());
        Self { sigma: variance.sqrt().max(floor), share, rho, recurrence: 0.0 }
    }
}

/// Root mean square of the lengths. 0 without residuals.
pub(crate) fn rms(residual: &[Vec3]) -> f64 {
    mean_square(residual).sqrt()
}

/// Mean square of the lengths. 0 without residuals.
pub(crate) fn mean_square(residual: &[Vec3]) -> f64 {
    mean(residual.iter().map(Vec3::norm_squared))
}

fn weighted_variance(residual: &[Vec3], weights: &[f64]) -> f64 {
    let total: f64 = weights.iter().sum();
    let squares: f64 = residual.iter().zip(weights).map(|(r, w)| w * r.norm_squared()).sum();
    squares / (3.0 * total).max(1.0)
}

/// Mean over lags from `first` to `last`.
struct Correlation {
    first: usize,
    last: usize,
    mean: f64,
}

impl Correlation {
    fn width(&self) -> f64 {
        (self.last - self.first + 1) as f64
    }
}

/// Lags 1, 2–3, 4–7 … up to an eighth of the samples. A long correlation of a small share is visible only
/// as a mean over many lags.
fn correlations(residual: &[Vec3], weights: &[f64], variance: f64) -> Vec<Correlation> {
    // Prefix sums: a window of lags costs one difference.
    let mut before = vec![(Vec3::zeros(), 0.0)];
    for (r, w) in residual.iter().zip(weights) {
        let (sum, total) = before[before.len() - 1];
        before.push((sum + *w * r, total + w));
    }
    let longest = residual.len() / 8;
    let firsts = std::iter::successors(Some(1), |first| Some(2 * first));
    let windows = firsts.take_while(|&first| first <= longest);
    let correlation = |first: usize| {
        let last = (2 * first - 1).min(longest);
        let (mut products, mut total) = (0.0, 0.0);
        for k in last..residual.len() {
            let (from, to) = (&before[k - last], &before[k - first + 1]);
            products += weights[k] * residual[k].dot(&(to.0 - from.0));
            total += weights[k] * (to.1 - from.1);
        }
        let covariance = products / (3.0 * total).max(1.0);
        Correlation { first, last, mean: covariance / variance.max(f64::MIN_POSITIVE) }
    };
    windows.map(correlation).collect()
}

/// Mean of ρ^lag over the lags of each window.
fn mean_autoregressions(windows: &[Correlation], rho: f64, means: &mut [f64]) {
    // Each window starts at twice the first lag of the one before.
    let mut power = rho;
    for (at, (window, mean)) in windows.iter().zip(means).enumerate() {
        let is_last = at + 1 == windows.len();
        let next = if is_last { rho.powi(window.last as i32 + 1) } else { power * power };
        *mean = (power - next) / ((1.0 - rho) * window.width());
        power = next;
    }
}

/// Least-squares `share·ρ^lag` over a grid of ρ. Zeros if it improves no more than chance.
fn fit_autoregression(correlations: &[Correlation], samples: usize) -> (f64, f64) {
    /// In squared standard errors of white noise's correlations. White noise of any length was taken for
    /// coloured in less than 1 %.
    const MAX_CHANCE_IMPROVEMENT: f64 = 9.0;
    // Longer correlations cannot be separated from a constant.
    let longest = 1.0 - 4.0 / (samples as f64).max(8.0);
    let grid = (1..400).map(|i| 1.0 - (0.0025 * f64::from(i)).powi(2) * 0.9975);
    // Means over many lags are more accurate, but coloured noise correlates the lags.
    let weight = |one: &Correlation| one.width().sqrt();
    let weights: Vec<f64> = correlations.iter().map(weight).collect();
    let misfit = |share: f64, expected: &[f64]| -> f64 {
        let all = correlations.iter().zip(&weights).zip(expected);
        all.map(|((one, weight), expected)| weight * (one.mean - share * expected).powi(2)).sum()
    };
    let mut expected = vec![0.0; correlations.len()];
    let none = misfit(0.0, &expected);
    let is_chance = |improvement: f64| improvement * 3.0 * samples as f64 <= MAX_CHANCE_IMPROVEMENT;
    // Even a perfect fit would be chance.
    if is_chance(none) {
        return (0.0, 0.0);
    }
    let mut best = (0.0, 0.0, none);
    for rho in grid.filter(|&rho| rho <= longest) {
        mean_autoregressions(correlations, rho, &mut expected);
        let (mut num, mut den) = (0.0, 0.0);
        for ((one, weight), power) in correlations.iter().zip(&weights).zip(&expected) {
            num += weight * one.mean * power;
            den += weight * power * power;
        }
        if den <= 0.0 {
            continue;
        }
        let share = (num / den).clamp(0.0, 1.0);
        let cost = misfit(share, &expected);
        if cost < best.2 {
            best = (share, rho, cost);
        }
    }
    if is_chance(none - best.2) { (0.0, 0.0) } else { (best.0, best.1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn series(n: usize, rho: f64, white: f64) -> Vec<Vec3> {
        seeded(7, n, rho, white)
    }

    fn seeded(seed: u64, n: usize, rho: f64, white: f64) -> Vec<Vec3> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut state = Vec3::zeros();
        (0..n)
            .map(|_| {
                state = state.map(|s| rho * s + (1.0 - rho * rho).sqrt() * normal());
                state.map(|s| s + white * normal())
            })
            .collect()
    }

    #[test]
    fn a_short_series_of_white_noise_has_no_autocorrelation() {
        let r = series(20_000, 0.0, 0.0);
        let pieces = r.chunks(200).map(|piece| Noise::unweighted(piece, 0.0));
        let remembering = pieces.filter(|noise| noise.inflation() > 1.5).count();
        assert!(remembering <= 2, "{remembering} of 100");
    }

    #[test]
    fn a_small_share_of_long_autocorrelation_is_found() {
        let r = series(20_000, 0.98, 4.0);
        let noise = Noise::unweighted(&r, 0.0);
        let expected = 1.0 + 2.0 / 17.0 * 0.98 / 0.02;
        assert!((noise.inflation() / expected - 1.0).abs() < 0.4, "{noise:?} against {expected}");
    }

    #[test]
    fn white_noise_has_no_autocorrelation() {
        let r = series(4000, 0.0, 0.0);
        let noise = Noise::unweighted(&r, 0.0);
        assert!((noise.sigma - 1.0).abs() < 0.03);
        assert!(noise.inflation() < 1.3, "{noise:?}");
    }

    #[test]
    fn chance_correlation_is_no_autocorrelation() {
        for seed in 0..40 {
            let r = seeded(seed, 2000, 0.0, 0.0);
            let noise = Noise::unweighted(&r, 0.0);
            assert!(noise.inflation() < 15.0, "{noise:?}");
        }
    }

    #[test]
    fn the_autocorrelation_of_coloured_noise_is_estimated() {
        for (rho, white) in [(0.95, 0.0), (0.95, 1.0), (0.6, 0.3)] {
            let r = series(20_000, rho, white);
            let noise = Noise::unweighted(&r, 0.0);
            let share = 1.0 / (1.0 + white * white);
            let expected = 1.0 + 2.0 * share * rho / (1.0 - rho);
            assert!(
                (noise.inflation() / expected - 1.0).abs() < 0.25,
                "{noise:?} against {expected}"
            );
        }
    }
}
