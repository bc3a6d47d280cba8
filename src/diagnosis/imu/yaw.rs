//! Decomposes the yaw error over time into constant drift, jumps and a random walk.
//!
//! Averages over bins long enough to be independent are modelled as `a + b·t + Σ sizeⱼ·[t > atⱼ] + walk +
//! white noise`, with as many parts as the penalised likelihood supports. Bin averages of a Wiener process
//! of density q have the covariance `q²Δ(i + 1/2)` for bins i < j of length Δ, and `q²Δ(i + 1/3)` for i =
//! j.

use crate::solver::noise::Noise;
use crate::{Measured, YawJump, YawProfile};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::f64::consts::{PI, TAU};

const MAX_BINS: f64 = 100.0;
const MIN_BINS: usize = 10;
/// In correlation times of the noise.
const BIN_CORRELATION_TIMES: f64 = 3.0;
/// A longer correlation is attributed to a random walk.
const MAX_BIN_S: f64 = 0.4;
/// In log likelihood. A jump is searched over all bins; a walk's density is tested on the boundary of its
/// range.
const MIN_JUMP_GAIN: f64 = 12.0;
const MIN_WALK_GAIN: f64 = 7.0;
/// More are modelled as a walk.
const MAX_JUMPS: usize = 3;
const FLOOR_RAD: f64 = 1e-6;

#[derive(Clone, Debug, Default)]
pub(super) struct YawDecomposition {
    /// If jumps or a walk change its estimate.
    pub drift_rad_s: Option<Measured>,
    pub parts: YawProfile,
    /// Random walk, rad, at the bin times; constant beyond.
    path: Vec<(f64, f64)>,
}

impl YawDecomposition {
    /// Neither jumps nor walk.
    pub fn is_steady(&self) -> bool {
        self.path.is_empty() && self.parts.jumps.is_empty()
    }

    /// Keeps only the jumps.
    pub fn without_walk(self) -> Self {
        let parts = YawProfile { walk_rad_per_sqrt_s: None, ..self.parts };
        Self { parts, drift_rad_s: None, path: Vec::new() }
    }

    /// Random walk at `t_s`.
    pub fn walk_rad(&self, t_s: f64) -> f64 {
        let right = self.path.partition_point(|&(at, _)| at < t_s);
        match (right.checked_sub(1).map(|left| self.path[left]), self.path.get(right)) {
            (Some((before, from)), Some(&(after, to))) => {
                from + (to - from) * (t_s - before) / (after - before)
            }
            (Some((_, end)), None) | (None, Some(&(_, end))) => end,
            (None, None) => 0.0,
        }
    }
}

/// Decomposes `series` of ascending times, s, and angles, rad.
pub(super) fn decompose_yaw(series: &[(f64, f64)]) -> YawDecomposition {
    let Some(bins) = Bins::from_samples(&unwrapped(series)) else {
        return YawDecomposition::default();
    };
    let steady = bins.fit(&[], 0.0);
    let jumpy = bins.with_walk(bins.with_jumps(steady.clone()));
    let wandering = bins.with_jumps(bins.with_walk(steady.clone()));
    let best = [steady, wandering, jumpy]
        .into_iter()
        .reduce(|a, b| if b.score() > a.score() { b } else { a });
    best.map(|fit| bins.decomposition(&fit)).unwrap_or_default()
}

pub(super) fn unwrapped(series: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (mut turns, mut last) = (0.0, None);
    let unwrap = |&(t_s, angle): &(f64, f64)| {
        if let Some(last) = last.replace(angle) {
            let change: f64 = angle - last;
            if change.abs() > PI {
                turns -= change.signum() * TAU;
            }
        }
        (t_s, angle + turns)
    };
    series.iter().map(unwrap).collect()
}

struct Bins {
    samples: Vec<(f64, f64)>,
    /// Per non-empty bin.
    ranges: Vec<std::ops::Range<usize>>,
    t_s: Vec<f64>,
    mean: DVector<f64>,
    /// Covariance for 1 rad/√s.
    walk: DMatrix<f64>,
    middle_s: f64,
}

#[derive(Clone)]
struct BinFit {
    jumps_s: Vec<f64>,
    /// Per second, relative to the variance of a bin.
    walk_ratio: f64,
    parameters: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Variance of a bin, rad².
    variance: f64,
    log_likelihood: f64,
    dof: f64,
}

impl BinFit {
    fn score(&self) -> f64 {
        let walks = if self.walk_ratio > 0.0 { MIN_WALK_GAIN } else { 0.0 };
        self.log_likelihood - MIN_JUMP_GAIN * self.jumps_s.len() as f64 - walks
    }

    fn parameter(&self, at: usize) -> Measured {
        let std_error = self.covariance[(at, at)].max(0.0).sqrt();
        Measured { value: self.parameters[at], std_error, dof: self.dof }
    }
}

impl Bins {
    fn from_samples(samples: &[(f64, f64)]) -> Option<Self> {
        let (first, last) = (samples.first()?.0, samples.last()?.0);
        let span_s = last - first;
        let longest_s = MAX_BIN_S.max(span_s / MAX_BINS);
        if !(span_s > 0.0 && span_s.is_finite()) {
            return None;
        }
        let length_s =
            (BIN_CORRELATION_TIMES * memory_s(samples)).clamp(span_s / MAX_BINS, longest_s);
        let bin_of = |t_s: f64| ((t_s - first) / length_s) as usize;
        let mut ranges: Vec<std::ops::Range<usize>> = Vec::new();
        for k in 0..samples.len() {
            match ranges.last_mut() {
                Some(range) if bin_of(samples[range.start].0) == bin_of(samples[k].0) => {
                    range.end = k + 1;
                }
                _ => ranges.push(k..k + 1),
            }
        }
        // An incomplete last bin is noisier.
        let fullest = ranges.iter().map(ExactSizeIterator::len).max()?;
        ranges.retain(|range| 2 * range.len() >= fullest);
        let n = ranges.len();
        if n < MIN_BINS {
            return None;
        }
        let mean_of = |part: fn(&(f64, f64)) -> f64| {
            let mean = move |range: &std::ops::Range<usize>| {
                samples[range.clone()].iter().map(part).sum::<f64>() / range.len() as f64
            };
            ranges.iter().map(mean).collect::<Vec<f64>>()
        };
        let t_s = mean_of(|sample| sample.0);
        let walk = DMatrix::from_fn(n, n, |i, j| {
            let since_s = t_s[i.min(j)] - t_s[0];
            since_s + length_s * if i == j { 1.0 / 3.0 } else { 0.5 }
        });
        let mean = DVector::from_vec(mean_of(|sample| sample.1));
        let middle_s = 0.5 * (first + last);
        Some(Self { samples: samples.to_vec(), ranges, t_s, mean, walk, middle_s })
    }

    fn share_after(&self, at_s: f64) -> Vec<f64> {
        let share = |range: &std::ops::Range<usize>| {
            let samples = &self.samples[range.clone()];
            let before = samples.partition_point(|sample| sample.0 <= at_s);
            (samples.len() - before) as f64 / samples.len() as f64
        };
        self.ranges.iter().map(share).collect()
    }

    /// Generalised least squares; likelihood concentrated in parameters and variance.
    fn fit(&self, jumps_s: &[f64], walk_ratio: f64) -> BinFit {
        let root = self.root(walk_ratio);
        self.fit_whitened(jumps_s, walk_ratio, root.as_ref())
    }

    /// Cholesky factor of the covariance. `None` for the identity.
    fn root(&self, walk_ratio: f64) -> Option<Cholesky<f64, Dyn>> {
        let n = self.mean.len();
        let covariance = || DMatrix::identity(n, n) + &self.walk * walk_ratio;
        if walk_ratio > 0.0 { covariance().cholesky() } else { None }
    }

    fn fit_whitened(
        &self,
        jumps_s: &[f64],
        walk_ratio: f64,
        root: Option<&Cholesky<f64, Dyn>>,
    ) -> BinFit {
        let n = self.mean.len();
        let mut design = DMatrix::from_element(n, 2 + jumps_s.len(), 1.0);
        design
            .set_column(1, &DVector::from_iterator(n, self.t_s.iter().map(|t| t - self.middle_s)));
        for (j, &at_s) in jumps_s.iter().enumerate() {
            design.set_column(2 + j, &DVector::from_vec(self.share_after(at_s)));
        }
        let mut right = self.mean.clone();
        let mut log_root = 0.0;
        if let Some(root) = root {
            let lower = root.l_dirty();
            lower.solve_lower_triangular_mut(&mut design);
            lower.solve_lower_triangular_mut(&mut right);
            log_root = lower.diagonal().iter().map(|d| d.ln()).sum();
        }
        let information = design.transpose() * &design;
        let width = information.nrows();
        let inverse = information.try_inverse();
        let is_solved = inverse.is_some();
        let inverse = inverse.unwrap_or_else(|| DMatrix::zeros(width, width));
        let parameters = &inverse * (design.transpose() * &right);
        let residual = &right - &design * &parameters;
        let square = residual.norm_squared().max(n as f64 * FLOOR_RAD.powi(2));
        let dof = (n - width) as f64;
        let variance = square / dof;
        let log_likelihood = -0.5 * n as f64 * (square / n as f64).ln() - log_root;
        let log_likelihood = match is_solved && log_likelihood.is_finite() {
            true => log_likelihood,
            false => f64::NEG_INFINITY,
        };
        BinFit {
            jumps_s: jumps_s.to_vec(),
            walk_ratio,
            parameters,
            covariance: inverse * variance,
            variance,
            log_likelihood,
            dof,
        }
    }

    fn with_jumps(&self, mut fit: BinFit) -> BinFit {
        while fit.jumps_s.len() < MAX_JUMPS {
            let more = self.with_jump(&fit);
            if more.score() <= fit.score() {
                break;
            }
            fit = more;
        }
        fit
    }

    /// Searches between bins first, then between samples.
    fn with_jump(&self, fit: &BinFit) -> BinFit {
        let root = self.root(fit.walk_ratio);
        let try_at = |at_s: f64| {
            let jumps: Vec<f64> = fit.jumps_s.iter().copied().chain([at_s]).collect();
            self.fit_whitened(&jumps, fit.walk_ratio, root.as_ref())
        };
        let better = |a: BinFit, b: BinFit| {
            if b.log_likelihood > a.log_likelihood { b } else { a }
        };
        let end_of = |bin: usize| self.samples[self.ranges[bin].end - 1].0;
        let is_separate = |&bin: &usize| {
            fit.jumps_s.iter().all(|&at_s| {
                let nearest = self.t_s.partition_point(|&t_s| t_s < at_s);
                nearest.abs_diff(bin) > 2
            })
        };
        let bins = (1..self.ranges.len() - 2).filter(is_separate);
        let coarse = bins
            .map(|bin| (bin, try_at(end_of(bin))))
            .reduce(|a, b| if b.1.log_likelihood > a.1.log_likelihood { b } else { a });
        let Some((bin, coarse)) = coarse else { return fit.clone() };
        let near = self.ranges[bin].start..self.ranges[bin + 1].end - 1;
        let stride = near.len().div_ceil(100).max(1);
        near.step_by(stride).map(|k| try_at(self.samples[k].0)).fold(coarse, better)
    }

    fn with_walk(&self, fit: BinFit) -> BinFit {
        // From well below a bin's noise to well above it, in factors of 2 of its variance, then refined.
        let scale = 1.0 / (self.t_s[1] - self.t_s[0]).max(f64::MIN_POSITIVE);
        let coarse = (-14..=14).map(|power| scale * 2f64.powi(power));
        let jumps_s = fit.jumps_s.clone();
        let better = |a: BinFit, ratio: f64| {
            let b = self.fit(&jumps_s, ratio);
            if b.score() > a.score() { b } else { a }
        };
        let found = coarse.fold(fit, better);
        let finer = [-3.0, -2.0, -1.0, 1.0, 2.0, 3.0].map(|step: f64| (0.25 * step).exp2());
        let ratio = found.walk_ratio;
        finer.into_iter().map(|factor| ratio * factor).fold(found, better)
    }

    fn decomposition(&self, fit: &BinFit) -> YawDecomposition {
        let mut jumps: Vec<YawJump> = fit
            .jumps_s
            .iter()
            .enumerate()
            .map(|(j, &at_s)| YawJump { at_s, size_rad: fit.parameter(2 + j) })
            .collect();
        jumps.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let walks = fit.walk_ratio > 0.0;
        let walk_rad_rt_s = walks.then(|| (fit.variance * fit.walk_ratio).sqrt());
        let drift_rad_s = (walks || !jumps.is_empty()).then(|| fit.parameter(1));
        let explained = |bin: usize| {
            let line = fit.parameters[0] + fit.parameters[1] * (self.t_s[bin] - self.middle_s);
            let jumped = fit.jumps_s.iter().enumerate();
            line + jumped
                .map(|(j, &at)| fit.parameters[2 + j] * self.share_after(at)[bin])
                .sum::<f64>()
        };
        let path = match walks {
            true => (0..self.t_s.len())
                .map(|bin| (self.t_s[bin], self.mean[bin] - explained(bin)))
                .collect(),
            false => Vec::new(),
        };
        YawDecomposition {
            drift_rad_s,
            parts: YawProfile {
                jumps,
                walk_rad_per_sqrt_s: walk_rad_rt_s,
                ..YawProfile::default()
            },
            path,
        }
    }
}

/// Correlation time of the noise, without components slower than some seconds.
fn memory_s(samples: &[(f64, f64)]) -> f64 {
    const MAX_BLOCKS: f64 = 8.0;
    const MIN_BLOCK_S: f64 = 2.0;
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return 0.0 };
    let (n, span_s) = (samples.len(), last.0 - first.0);
    let stretches = MAX_BLOCKS.max(span_s / MIN_BLOCK_S);
    let length = ((n as f64 / stretches) as usize).max(4);
    let flat: Vec<[f64; 3]> = samples.chunks(length).flat_map(detrended).collect();
    let noise = Noise::estimate(&flat, &vec![1.0; n], FLOOR_RAD);
    noise.inflation() * span_s / n as f64
}

fn detrended(samples: &[(f64, f64)]) -> impl Iterator<Item = [f64; 3]> {
    let n = samples.len() as f64;
    let (t, y) =
        samples.iter().fold((0.0, 0.0), |sum, sample| (sum.0 + sample.0, sum.1 + sample.1));
    let (t, y) = (t / n, y / n);
    let (mut tt, mut ty) = (0.0, 0.0);
    for sample in samples {
        tt += (sample.0 - t).powi(2);
        ty += (sample.0 - t) * (sample.1 - y);
    }
    let slope = if tt > 0.0 { ty / tt } else { 0.0 };
    samples.iter().map(move |sample| [sample.1 - y - slope * (sample.0 - t), 0.0, 0.0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const RATE_HZ: f64 = 100.0;

    /// 20 s with `error`, noise of 3e-4 rad and a random walk of density `walk`.
    fn series(seed: u64, rho: f64, walk: f64, error: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let (mut noise, mut wandered) = (normal(), 0.0);
        (0..2000)
            .map(|k| {
                let t_s = f64::from(k) / RATE_HZ;
                noise = rho * noise + (1.0 - rho * rho).sqrt() * normal();
                wandered += walk * RATE_HZ.sqrt().recip() * normal();
                (t_s, error(t_s) + 3e-4 * noise + wandered)
            })
            .collect()
    }

    #[test]
    fn a_drift_in_noise_is_steady() {
        let steady = (0..60).filter(|&seed| {
            let rho = if seed % 2 == 0 { 0.0 } else { 0.95 };
            decompose_yaw(&series(seed, rho, 0.0, |t_s| 1e-3 * t_s)).is_steady()
        });
        assert_eq!(steady.count(), 60);
    }

    #[test]
    fn a_yaw_jump_is_estimated_with_time_size_and_drift() {
        for (rho, size) in [(0.0, 0.01), (0.0, -0.003), (0.95, 0.01), (0.95, -0.2)] {
            let jump = |t_s: f64| if t_s > 7.123 { size } else { 0.0 };
            let decomposition = decompose_yaw(&series(5, rho, 0.0, |t_s| 1e-4 * t_s + jump(t_s)));
            let [found] = decomposition.parts.jumps.as_slice() else {
                panic!("{rho} {size}: {decomposition:?}")
            };
            assert!((found.at_s - 7.123).abs() < 0.1, "{found:?}");
            assert!((found.size_rad.value - size).abs() < 3e-4, "{found:?}");
            assert_eq!(decomposition.parts.walk_rad_per_sqrt_s, None);
            let drift = decomposition.drift_rad_s.unwrap();
            assert!((drift.value - 1e-4).abs() < 4.0 * drift.std_error, "{drift:?}");
        }
    }

    #[test]
    fn a_random_walk_is_distinguished_from_jumps_with_a_valid_drift_interval() {
        let (walk, count) = (2e-3, 60);
        let (mut walks, mut covered, mut jumps) = (0, 0, 0);
        for seed in 0..count {
            let decomposition = decompose_yaw(&series(seed, 0.0, walk, |_| 0.0));
            walks += usize::from(
                decomposition.parts.walk_rad_per_sqrt_s.is_some_and(|q| (1e-3..4e-3).contains(&q)),
            );
            jumps += decomposition.parts.jumps.len();
            covered += usize::from(decomposition.drift_rad_s.is_some_and(|drift| {
                let [low, high] = drift.interval(0.95);
                (low..=high).contains(&0.0)
            }));
        }
        assert!(walks >= 57 && jumps <= 2 && covered >= 52, "{walks} {jumps} {covered}");
    }

    #[test]
    fn a_jump_is_detected_within_a_random_walk() {
        let jump = |t_s: f64| if t_s > 12.0 { 0.05 } else { 0.0 };
        let decomposition = decompose_yaw(&series(9, 0.0, 1e-3, jump));
        assert_eq!(decomposition.parts.jumps.len(), 1, "{:?}", decomposition.parts);
        assert!(decomposition.parts.walk_rad_per_sqrt_s.is_some(), "{:?}", decomposition.parts);
    }

    #[test]
    fn unwrapping_beyond_half_a_turn_is_no_jump() {
        let wrapped = |t_s: f64| (0.3 * t_s + PI).rem_euclid(TAU) - PI;
        assert!(decompose_yaw(&series(2, 0.0, 0.0, wrapped)).is_steady());
    }

    #[test]
    fn a_short_series_is_steady() {
        for n in [0, 1, 2, 9] {
            assert!(decompose_yaw(&series(1, 0.0, 0.0, |_| 0.0)[..n]).is_steady());
        }
        assert!(decompose_yaw(&[(0.0, 0.0); 50]).is_steady());
        assert!(decompose_yaw(&vec![(f64::NAN, f64::NAN); 50]).is_steady());
    }
}
