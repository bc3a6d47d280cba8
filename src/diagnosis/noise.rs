//! How noisy a residual is, and how long its noise remembers.
//!
//! Residuals of logged poses are correlated: filters, quantised encoders and small model errors
//! repeat from sample to sample, and an interval that takes samples as independent is too narrow by
//! the square root of that. The autocovariance is modelled as white noise plus a first-order
//! autoregressive part, `γ(0) = σ²`, `γ(k) = share·σ²·ρ^k`, which has the two limits that logs show.

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
    /// The factor by which correlation inflates the variance of a mean (`1 + 2·Σ γ(k)/γ(0)`).
    pub fn inflation(&self) -> f64 {
        1.0 + 2.0 * self.share * self.rho / (1.0 - self.rho)
    }

    /// The noise of a residual of three components a sample, weighted by `weights` (0 to 1 each).
    ///
    /// `sigma` is never below `floor`.
    pub fn of(residual: &[[f64; 3]], weights: &[f64], floor: f64) -> Self {
        let variance = weighted_variance(residual, weights);
        let lags = [1usize, 2, 4, 8, 16, 32, 64, 128, 256];
        let correlation: Vec<(usize, f64)> = lags
            .into_iter()
            .filter(|&lag| lag * 8 <= residual.len())
            .map(|lag| {
                (lag, autocovariance(residual, weights, lag) / variance.max(f64::MIN_POSITIVE))
            })
            .collect();
        let (share, rho) = fit_autoregression(&correlation);
        Self { sigma: variance.sqrt().max(floor), share, rho }
    }
}

fn weighted_variance(residual: &[[f64; 3]], weights: &[f64]) -> f64 {
    let total: f64 = weights.iter().sum();
    let squares: f64 = residual.iter().zip(weights).map(|(r, w)| w * dot(r, r)).sum();
    squares / (3.0 * total).max(1.0)
}

fn autocovariance(residual: &[[f64; 3]], weights: &[f64], lag: usize) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for k in lag..residual.len() {
        let weight = weights[k] * weights[k - lag];
        sum += weight * dot(&residual[k], &residual[k - lag]);
        total += weight;
    }
    sum / (3.0 * total).max(1.0)
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Least squares of `share·ρ^lag` to measured correlations, over a grid of ρ.
fn fit_autoregression(correlation: &[(usize, f64)]) -> (f64, f64) {
    let grid = (1..400).map(|i| 1.0 - (0.0025 * f64::from(i)).powi(2) * 0.9975);
    let misfit = |share: f64, rho: f64| -> f64 {
        correlation.iter().map(|&(lag, c)| (c - share * rho.powi(lag as i32)).powi(2)).sum()
    };
    let mut best = (0.0, 0.0, misfit(0.0, 0.0));
    for rho in grid {
        let (mut num, mut den) = (0.0, 0.0);
        for &(lag, c) in correlation {
            let power = rho.powi(lag as i32);
            num += c * power;
            den += power * power;
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
    (best.0, best.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn series(n: usize, rho: f64, white: f64) -> Vec<[f64; 3]> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(7);
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
    fn white_noise_has_no_memory() {
        let r = series(4000, 0.0, 0.0);
        let noise = Noise::of(&r, &vec![1.0; r.len()], 0.0);
        assert!((noise.sigma - 1.0).abs() < 0.03);
        assert!(noise.inflation() < 1.3, "{noise:?}");
    }

    #[test]
    fn the_memory_of_coloured_noise_is_found() {
        for (rho, white) in [(0.95, 0.0), (0.95, 1.0), (0.6, 0.3)] {
            let r = series(20_000, rho, white);
            let noise = Noise::of(&r, &vec![1.0; r.len()], 0.0);
            let share = 1.0 / (1.0 + white * white);
            let expected = 1.0 + 2.0 * share * rho / (1.0 - rho);
            assert!(
                (noise.inflation() / expected - 1.0).abs() < 0.25,
                "{noise:?} against {expected}"
            );
        }
    }
}
