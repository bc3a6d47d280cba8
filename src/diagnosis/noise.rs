//! Standard deviation and autocorrelation of residuals.
//!
//! Residuals of logged poses are correlated: filters, quantised encoders and small model errors persist
//! from sample to sample. Intervals that assume independent samples are too narrow by the square root of
//! the inflation factor. The autocovariance is modelled as white noise plus a first-order autoregressive
//! part, `γ(0) = σ²`, `γ(k) = share·σ²·ρ^k`.

/// White plus first-order autoregressive noise of one kind of residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of one component, in the residual's unit.
    pub sigma: f64,
    /// Share of the variance that is autoregressive, 0 to 1.
    pub share: f64,
    /// Correlation of the autoregressive part from one sample to the next, 0 to 1.
    pub rho: f64,
}

impl Noise {
    /// Factor by which correlation inflates the variance of a mean (`1 + 2·Σ γ(k)/γ(0)`).
    pub fn inflation(&self) -> f64 {
        1.0 + 2.0 * self.share * self.rho / (1.0 - self.rho)
    }

    /// Factor for the variance of a mean of squares (`1 + 2·Σ (γ(k)/γ(0))²`, for normal noise).
    pub fn inflation_of_squares(&self) -> f64 {
        let Self { share, rho, .. } = *self;
        1.0 + 2.0 * (share * rho).powi(2) / (1.0 - rho * rho)
    }

    /// Estimates the noise of a residual with three components per sample, weighted by `weights` (0 to 1
    /// each). `sigma` is at least `floor`.
    pub fn estimate(residual: &[[f64; 3]], weights: &[f64], floor: f64) -> Self {
        let variance = weighted_variance(residual, weights);
        let correlations = correlations(residual, weights, variance);
        let (share, rho) = fit_autoregression(&correlations, residual.len());
        Self { sigma: variance.sqrt().max(floor), share, rho }
    }
}

fn weighted_variance(residual: &[[f64; 3]], weights: &[f64]) -> f64 {
    let total: f64 = weights.iter().sum();
    let squares: f64 = residual.iter().zip(weights).map(|(r, w)| w * dot(r, r)).sum();
    squares / (3.0 * total).max(1.0)
}

/// Mean correlation over lags from `first` to `last`.
struct Correlation {
    first: usize,
    last: usize,
    mean: f64,
}

impl Correlation {
    /// Number of lags.
    fn width(&self) -> f64 {
        (self.last - self.first + 1) as f64
    }

    /// Mean of `ρ^lag` over the lags.
    fn mean_autoregression(&self, rho: f64) -> f64 {
        let power = |lag: usize| rho.powi(lag as i32);
        (power(self.first) - power(self.last + 1)) / ((1.0 - rho) * self.width())
    }
}

/// Correlations over lags 1, 2–3, 4–7 and so on up to an eighth of the samples. A long correlation of a
/// small share of the noise is visible only when averaged over many lags.
fn correlations(residual: &[[f64; 3]], weights: &[f64], variance: f64) -> Vec<Correlation> {
    // Prefix sums: any window of lags costs one difference.
    let mut before = vec![([0.0; 3], 0.0)];
    for (r, w) in residual.iter().zip(weights) {
        let (sum, total) = before[before.len() - 1];
        before.push((std::array::from_fn(|axis| sum[axis] + w * r[axis]), total + w));
    }
    let longest = residual.len() / 8;
    let firsts = std::iter::successors(Some(1), |first| Some(2 * first));
    let windows = firsts.take_while(|&first| first <= longest);
    let correlation = |first: usize| {
        let last = (2 * first - 1).min(longest);
        let (mut products, mut total) = (0.0, 0.0);
        for k in last..residual.len() {
            let (from, to) = (&before[k - last], &before[k - first + 1]);
            let sum: [f64; 3] = std::array::from_fn(|axis| to.0[axis] - from.0[axis]);
            products += weights[k] * dot(&residual[k], &sum);
            total += weights[k] * (to.1 - from.1);
        }
        let covariance = products / (3.0 * total).max(1.0);
        Correlation { first, last, mean: covariance / variance.max(f64::MIN_POSITIVE) }
    };
    windows.map(correlation).collect()
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Least-squares fit of `share·ρ^lag` to the correlations over a grid of ρ. Returns zeros if the fit
/// improves no more than chance does.
fn fit_autoregression(correlations: &[Correlation], samples: usize) -> (f64, f64) {
    /// Improvement by chance, in squared standard errors of white noise's correlations. White noise of any
    /// length was taken for coloured less than once in a hundred times.
    const MAX_CHANCE_IMPROVEMENT: f64 = 9.0;
    // A correlation time of more than a quarter of the log cannot be separated from a constant.
    let longest = 1.0 - 4.0 / (samples as f64).max(8.0);
    let grid = (1..400).map(|i| 1.0 - (0.0025 * f64::from(i)).powi(2) * 0.9975);
    // A mean over many lags is better known, but coloured noise correlates those lags.
    let weight = |one: &Correlation| one.width().sqrt();
    let misfit = |share: f64, rho: f64| -> f64 {
        let left = |one: &Correlation| one.mean - share * one.mean_autoregression(rho);
        correlations.iter().map(|one| weight(one) * left(one).powi(2)).sum()
    };
    let none = misfit(0.0, 0.0);
    let mut best = (0.0, 0.0, none);
    for rho in grid.filter(|&rho| rho <= longest) {
        let (mut num, mut den) = (0.0, 0.0);
        for one in correlations {
            let power = one.mean_autoregression(rho);
            num += weight(one) * one.mean * power;
            den += weight(one) * power * power;
        }
        if den <= 0.0 {
            continue;
        }
        let share = (num / den).clamp(0.0, 1.0);
        let cost = misfit(share, rho);
        if cost < best.2 {
            best = (share, rho, cost);
        }
    }
    let is_chance = (none - best.2) * 3.0 * samples as f64 <= MAX_CHANCE_IMPROVEMENT;
    if is_chance { (0.0, 0.0) } else { (best.0, best.1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn series(n: usize, rho: f64, white: f64) -> Vec<[f64; 3]> {
        seeded(7, n, rho, white)
    }

    fn seeded(seed: u64, n: usize, rho: f64, white: f64) -> Vec<[f64; 3]> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut state = [0.0; 3];
        (0..n)
            .map(|_| {
                state = state.map(|s| rho * s + (1.0 - rho * rho).sqrt() * normal());
                state.map(|s| s + white * normal())
            })
            .collect()
    }

    #[test]
    fn a_short_piece_of_white_noise_has_no_memory_either() {
        let r = series(20_000, 0.0, 0.0);
        let pieces =
            r.chunks(200).map(|piece| Noise::estimate(piece, &vec![1.0; piece.len()], 0.0));
        let remembering = pieces.filter(|noise| noise.inflation() > 1.5).count();
        assert!(remembering <= 2, "{remembering} of 100");
    }

    #[test]
    fn a_long_memory_of_a_small_part_is_found() {
        let r = series(20_000, 0.98, 4.0);
        let noise = Noise::estimate(&r, &vec![1.0; r.len()], 0.0);
        let expected = 1.0 + 2.0 / 17.0 * 0.98 / 0.02;
        assert!((noise.inflation() / expected - 1.0).abs() < 0.4, "{noise:?} against {expected}");
    }

    #[test]
    fn white_noise_has_no_memory() {
        let r = series(4000, 0.0, 0.0);
        let noise = Noise::estimate(&r, &vec![1.0; r.len()], 0.0);
        assert!((noise.sigma - 1.0).abs() < 0.03);
        assert!(noise.inflation() < 1.3, "{noise:?}");
    }

    #[test]
    fn chance_is_no_memory() {
        for seed in 0..40 {
            let r = seeded(seed, 2000, 0.0, 0.0);
            let noise = Noise::estimate(&r, &vec![1.0; r.len()], 0.0);
            assert!(noise.inflation() < 15.0, "{noise:?}");
        }
    }

    #[test]
    fn the_memory_of_coloured_noise_is_found() {
        for (rho, white) in [(0.95, 0.0), (0.95, 1.0), (0.6, 0.3)] {
            let r = series(20_000, rho, white);
            let noise = Noise::estimate(&r, &vec![1.0; r.len()], 0.0);
            let share = 1.0 / (1.0 + white * white);
            let expected = 1.0 + 2.0 * share * rho / (1.0 - rho);
            assert!(
                (noise.inflation() / expected - 1.0).abs() < 0.25,
                "{noise:?} against {expected}"
            );
        }
    }
}
