//! Tests whether IMU parameters vary over the run: a step (sup-F over the change point: Andrews 1993), an
//! exponential decay, a random walk, or a dependence on another quantity. Each test extends one linearised
//! model by weighted columns. Extensions compete by the log Bayes factor over the base model, as diagnoses
//! of an arm do (`selection::evidence`).

use super::effects::{Profile, Shape};
use super::model::{Linearization, Moment};
use crate::priors::price;
use crate::solver::linear::{Linear, ridged};
use crate::solver::noise::Noise;
use crate::solver::robust::robust_sigma;
use ground::geometry::Vec3;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::ops::Range;

/// Pieces that approximate a weight function in the coarse search.
const COARSE_PIECES: usize = 240;
const CHANGE_POINT_CANDIDATES: usize = 60;
/// As a share of the run.
const MIN_SIDE_SHARE: f64 = 0.06;
const OUTLIER_SIGMAS: f64 = 8.0;

/// Extensions of a base model. Matrices have three rows per sample.
pub(super) struct ExtensionTests<'a> {
    linear: &'a Linear,
    moments: &'a [Moment],
    residual: DVector<f64>,
    /// Derivatives by the parameters of the base model.
    base: DMatrix<f64>,
    /// Their prior precisions; 0 without a prior.
    precision: Vec<f64>,
    base_products: Products,
    /// Per sample.
    robust_weights: Vec<f64>,
    /// Square of a residual beyond which a sample is an outlier.
    outlier: f64,
    /// Error of the base model without any fault; smaller residuals distinguish no extensions.
    model_error: f64,
    /// Noise of the base model.
    variance: f64,
}

/// Noise as that of independent samples.
#[derive(Clone, Copy)]
struct IndependentNoise {
    variance: f64,
    /// Their number.
    independent: f64,
}

/// Base model for one variance of independent noise.
struct BaseFit {
    cholesky: Cholesky<f64, Dyn>,
    parameters: DVector<f64>,
}

/// Additional columns of the design.
struct Extension {
    design: DMatrix<f64>,
    products: Products,
    /// 1 for the components of the residual that they change, else 0.
    changed: Vec3,
}

/// Robustly weighted products of additional columns.
#[derive(Clone)]
struct Products {
    with_base: DMatrix<f64>,
    own: DMatrix<f64>,
    with_residual: DVector<f64>,
}

/// Fit of the base model with additional columns.
struct ExtendedFit {
    /// Decrease of the sum of squares.
    gain: f64,
    base: DVector<f64>,
    added: DVector<f64>,
    /// Twice the log of the prior volume of the added parameters over the posterior one.
    occam: f64,
}

impl Products {
    fn zeros(base: usize, own: usize) -> Self {
        let (with_base, with_residual) = (DMatrix::zeros(base, own), DVector::zeros(own));
        Self { with_base, own: DMatrix::zeros(own, own), with_residual }
    }

    /// Adds those of other samples, with their columns multiplied by `weight`.
    fn add(&mut self, other: &Self, weight: f64) {
        self.with_base.zip_apply(&other.with_base, |sum, one| *sum += weight * one);
        self.own.zip_apply(&other.own, |sum, one| *sum += weight * weight * one);
        self.with_residual.axpy(weight, &other.with_residual, 1.0);
    }
}

impl<'a> ExtensionTests<'a> {
    /// Tests on a linearised model. The base model has the parameters `base`, each with a prior precision.
    /// `None` if they cannot be fitted.
    pub fn new(
        Linearization { linear, moments, .. }: &'a Linearization,
        base: &[(usize, f64)],
        model_error: f64,
    ) -> Option<Self> {
        let residual = &linear.residual[0];
        let sigma = robust_sigma(residual).max(model_error);
        let outlier = 3.0 * (OUTLIER_SIGMAS * sigma).powi(2);
        let mut tests = Self {
            linear,
            moments,
            residual: DVector::from_iterator(
                3 * residual.len(),
                residual.iter().flatten().copied(),
            ),
            base: design(linear, base.iter().map(|(column, _)| *column)),
            precision: base.iter().map(|(_, precision)| *precision).collect(),
            base_products: Products::zeros(0, 0),
            robust_weights: residual
                .iter()
                .map(|r| (outlier / r.norm_squared()).min(1.0))
                .collect(),
            outlier,
            model_error,
            variance: sigma.powi(2),
        };
        tests.base_products = tests.products(0..moments.len(), &tests.base);
        let fit = tests.base_fit(tests.variance)?;
        tests.variance = tests.noise(&tests.base_residual(&fit), Vec3::repeat(1.0)).variance;
        Some(tests)
    }

    /// Twice the log Bayes factor and the profile of an effect of this shape on `columns`, with parameters of the prior
    /// `size`.
    pub fn likeliest(
        &self,
        columns: Range<usize>,
        shape: Shape,
        size: f64,
    ) -> Option<(f64, Profile)> {
        match shape {
            Shape::Step => self.step(columns, size),
            Shape::Decay => self.decay(columns, size),
            Shape::Walk => self.walk(columns),
            Shape::Heading => {
                let about = |axis: usize| {
                    let profile = Profile::Heading { axis };
                    Some((self.compare(columns.clone(), profile, size)?.0, profile))
                };
                (0..3).rev().filter_map(about).max_by(|a, b| a.0.total_cmp(&b.0))
            }
        }
    }

    /// First and last time.
    fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.moments.first()?.t_s, self.moments.last()?.t_s);
        (last > first).then_some((first, last))
    }

    /// Number of samples until this time.
    fn samples_until(&self, at_s: f64) -> usize {
        self.moments.partition_point(|moment| moment.t_s <= at_s)
    }

    fn step(&self, columns: Range<usize>, size: f64) -> Option<(f64, Profile)> {
        let (first, last) = self.span()?;
        let side_s = MIN_SIDE_SHARE * (last - first);
        let fit = self.base_fit(self.variance)?;
        let design = design(self.linear, columns.clone());
        // Products of the samples from each one on.
        let samples = self.moments.len();
        let mut from = vec![Products::zeros(self.base.ncols(), columns.len()); samples + 1];
        for sample in (0..samples).rev() {
            from[sample] = from[sample + 1].clone();
            from[sample].add(&self.products(sample..sample + 1, &design), 1.0);
        }
        let cost = |at_s: f64| fit.cost(&from[self.samples_until(at_s)]);
        let candidates = |from_s: f64, to_s: f64| {
            let step_s = (to_s - from_s) / (CHANGE_POINT_CANDIDATES - 1) as f64;
            (0..CHANGE_POINT_CANDIDATES).map(move |k| from_s + step_s * k as f64)
        };
        let (from_s, to_s) = (first + side_s, last - side_s);
        let mut at_s = best_candidate(candidates(from_s, to_s), cost)?;
        let mut around_s = 1.5 * (to_s - from_s) / CHANGE_POINT_CANDIDATES as f64;
        for _ in 0..2 {
            at_s = best_candidate(candidates(at_s - around_s, at_s + around_s), cost)?;
            around_s *= 4.0 / CHANGE_POINT_CANDIDATES as f64;
        }
        let next = self.samples_until(at_s);
        if (1..samples).contains(&next) {
            at_s = 0.5 * (self.moments[next - 1].t_s + self.moments[next].t_s);
        }
        let step = |interval_s| Profile::Step { at_s, interval_s };
        let (log_bayes_factor, variance) = self.compare(columns, step([at_s; 2]), size)?;
        // 95 % likelihood region.
        let limit = cost(at_s) + 3.84 * variance;
        let end = |sign: f64| {
            let mut step_s = 1.5 * (last - first) / samples as f64;
            let mut end_s = at_s;
            while cost(end_s + sign * step_s) < limit && step_s < last - first {
                end_s += sign * step_s;
                step_s *= 1.5;
            }
            end_s + sign * step_s
        };
        Some((log_bayes_factor, step([end(-1.0), end(1.0)])))
    }

    /// From the start.
    fn decay(&self, columns: Range<usize>, size: f64) -> Option<(f64, Profile)> {
        let (first_s, last_s) = self.span()?;
        let fit = self.base_fit(self.variance)?;
        let design = design(self.linear, columns.clone());
        let samples = self.moments.len();
        // Time since the start and products of each of `count` pieces.
        let pieces = |count: usize| -> Vec<(f64, Products)> {
            let count = count.min(samples);
            let piece = |at: usize| {
                let (from, to) = (at * samples / count, (at + 1) * samples / count);
                let since_s = self.moments[(from + to) / 2].t_s - first_s;
                (since_s, self.products(from..to, &design))
            };
            (0..count).map(piece).collect()
        };
        let cost = |tau_s: f64, pieces: &[(f64, Products)]| {
            let mut sums = Products::zeros(self.base.ncols(), columns.len());
            for (since_s, products) in pieces {
                sums.add(products, (-since_s / tau_s).exp());
            }
            fit.cost(&sums)
        };
        let taus = (0..CHANGE_POINT_CANDIDATES).map(|k| {
            (last_s - first_s) * 0.03 * 33f64.powf(k as f64 / CHANGE_POINT_CANDIDATES as f64)
        });
        let (coarse, fine) = (pieces(COARSE_PIECES), pieces(samples));
        let tau_s = best_candidate(taus, |tau_s| cost(tau_s, &coarse))?;
        let finer = (-4..=4).map(|k| tau_s * 1.015f64.powi(k));
        let time_constant_s = best_candidate(finer, |tau_s| cost(tau_s, &fine))?;
        let profile = Profile::Decay { first_s, time_constant_s };
        Some((self.compare(columns, profile, size)?.0, profile))
    }

    fn walk(&self, columns: Range<usize>) -> Option<(f64, Profile)> {
        /// Knots: at most this many, for a density known to 10 %, and at least this far apart.
        const MAX_KNOTS: f64 = 60.0;
        const MIN_KNOT_DISTANCE_S: f64 = 0.4;
        /// Variances of an increment, relative to its noise.
        const POWERS_OF_TWO: std::ops::RangeInclusive<i32> = -8..=24;
        /// Every so many increments are joined while the noise is first estimated: single ones absorb autocorrelated
        /// noise.
        const JOINED_INCREMENTS: f64 = 4.0;
        const MAX_REFINEMENTS: usize = 8;
        let (first_s, last_s) = self.span()?;
        let count = ((last_s - first_s) / MIN_KNOT_DISTANCE_S).min(MAX_KNOTS).floor();
        if count <= 2.0 {
            return None;
        }
        let step_s = (last_s - first_s) / count;
        let walk = |density: f64, joined: f64| Profile::Walk {
            density,
            first_s,
            step_s: joined * step_s,
            increments: (count / joined).ceil() as usize,
        };
        let joined = self.extension(columns.clone(), walk(0.0, JOINED_INCREMENTS));
        let whole = self.extension(columns, walk(0.0, 1.0));
        let likeliest = |noise: &IndependentNoise| {
            let fit = self.base_fit(noise.variance)?;
            let typical = noise.variance * count / whole.products.own.trace();
            let cost = |variance: f64| {
                let extended = fit.extend(&whole.products, noise.variance / variance);
                extended.map_or(f64::INFINITY, |extended| -noise.evidence(&extended))
            };
            let coarse =
                best_candidate(POWERS_OF_TWO.map(|power| typical * 2f64.powi(power)), cost)?;
            best_candidate((-4..=4).map(|k| coarse * 2f64.powf(0.25 * f64::from(k))), cost)
        };
        let mut noise = self.noise_with(self.variance, &joined, 0.0)?;
        let mut variance = likeliest(&noise)?;
        // The density is a parameter as well.
        let log_bayes_factor = self.evidence(&whole, variance, noise)? - price(noise.independent);
        // The first noise contains the walk within the joined increments.
        for _ in 0..MAX_REFINEMENTS {
            noise = self.noise_with(noise.variance, &whole, noise.variance / variance)?;
            let previous = std::mem::replace(&mut variance, likeliest(&noise)?);
            if variance <= previous {
                break;
            }
        }
        Some((log_bayes_factor, walk((variance / step_s).sqrt(), 1.0)))
    }

    /// Twice the log Bayes factor of an extension by `columns`, each scaled by every function of `profile`, with
    /// parameters of the prior `size`; and the variance of independent noise.
    pub fn compare(
        &self,
        columns: Range<usize>,
        profile: Profile,
        size: f64,
    ) -> Option<(f64, f64)> {
        let extension = self.extension(columns, profile);
        let noise = self.noise_with(self.variance, &extension, self.variance / size.powi(2))?;
        let log_bayes_factor = self.evidence(&extension, size.powi(2), noise)?;
        log_bayes_factor.is_finite().then_some((log_bayes_factor, noise.variance))
    }

    /// Twice the log Bayes factor of additional columns. An outlier counts the same however far off it is: columns
    /// that move it, but not to the others, explain nothing.
    fn evidence(
        &self,
        extension: &Extension,
        variance: f64,
        noise: IndependentNoise,
    ) -> Option<f64> {
        let fit = self.base_fit(noise.variance)?;
        let extended = fit.extend(&extension.products, noise.variance / variance)?;
        let before = self.base_residual(&fit);
        let after = self.extended_residual(extension, &extended);
        let samples = self.robust_weights.iter().zip(before.iter().zip(&after));
        let by_outliers = samples.map(|(weight, (before, after))| {
            let [before, after] = [before, after].map(Vec3::norm_squared);
            before.min(self.outlier) - after.min(self.outlier) - weight * (before - after)
        });
        Some(noise.evidence(&extended) + by_outliers.sum::<f64>() / noise.variance)
    }

    /// Noise with additional columns, by a fit for `variance`. `precision` is that of their prior, times the variance.
    fn noise_with(
        &self,
        variance: f64,
        extension: &Extension,
        precision: f64,
    ) -> Option<IndependentNoise> {
        let extended = self.base_fit(variance)?.extend(&extension.products, precision)?;
        let residual = self.extended_residual(extension, &extended);
        Some(self.noise(&residual, extension.changed))
    }

    /// In the components that an extension changes.
    fn noise(&self, residual: &[Vec3], changed: Vec3) -> IndependentNoise {
        let residual: Vec<Vec3> = residual.iter().map(|it| it.component_mul(&changed)).collect();
        let components = changed.sum();
        let noise = Noise::estimate(&residual, &self.robust_weights, 0.0);
        let inflation = noise.inflation().max(1.0);
        let variance = (noise.sigma.powi(2) * 3.0 / components).max(self.model_error.powi(2));
        let independent = components * residual.len() as f64 / inflation;
        IndependentNoise { variance: variance * inflation, independent }
    }

    fn base_residual(&self, fit: &BaseFit) -> Vec<Vec3> {
        by_sample(&(&self.residual - &self.base * &fit.parameters))
    }

    fn extended_residual(&self, extension: &Extension, fit: &ExtendedFit) -> Vec<Vec3> {
        by_sample(&(&self.residual - &self.base * &fit.base - &extension.design * &fit.added))
    }

    fn extension(&self, columns: Range<usize>, profile: Profile) -> Extension {
        /// Share of the columns' squares in a component that they change.
        const MIN_SHARE: f64 = 1e-3;
        let columns = design(self.linear, columns);
        let squares = Vec3::from_fn(|axis, _| {
            columns.rows_with_step(axis, self.moments.len(), 2).norm_squared()
        });
        let changed = squares.map(|one| f64::from(one >= MIN_SHARE * squares.sum()));
        let weights = self.moments.iter();
        let weights = weights.map(|moment| profile.weights(moment.t_s, &moment.world_from_imu));
        let weights: Vec<Vec<f64>> = weights.collect();
        let width = columns.ncols() * weights.first().map_or(0, Vec::len);
        let design = DMatrix::from_fn(columns.nrows(), width, |row, at| {
            weights[row / 3][at / columns.ncols()] * columns[(row, at % columns.ncols())]
        });
        let products = self.products(0..self.moments.len(), &design);
        Extension { design, products, changed }
    }

    /// Of the columns of `added`, over these samples.
    fn products(&self, samples: Range<usize>, added: &DMatrix<f64>) -> Products {
        let (first, count) = (3 * samples.start, 3 * samples.len());
        let own = added.rows(first, count);
        let weighted = DMatrix::from_fn(count, own.ncols(), |row, column| {
            self.robust_weights[samples.start + row / 3] * own[(row, column)]
        });
        Products {
            with_base: self.base.rows(first, count).transpose() * &weighted,
            own: own.transpose() * &weighted,
            with_residual: weighted.tr_mul(&self.residual.rows(first, count)),
        }
    }

    fn base_fit(&self, variance: f64) -> Option<BaseFit> {
        let mut matrix = self.base_products.own.clone();
        for (at, precision) in self.precision.iter().enumerate() {
            matrix[(at, at)] += variance * precision;
        }
        let cholesky = ridged(matrix).cholesky()?;
        let parameters = cholesky.solve(&self.base_products.with_residual);
        Some(BaseFit { cholesky, parameters })
    }
}

/// Columns of the design.
fn design(linear: &Linear, columns: impl IntoIterator<Item = usize>) -> DMatrix<f64> {
    let columns = Vec::from_iter(columns);
    DMatrix::from_fn(3 * linear.len(), columns.len(), |row, at| {
        linear.row(row / 3, row % 3)[columns[at]]
    })
}

fn by_sample(residual: &DVector<f64>) -> Vec<Vec3> {
    residual.as_slice().chunks_exact(3).map(Vec3::from_column_slice).collect()
}

impl IndependentNoise {
    /// Twice the log Bayes factor of additional parameters. Counts one parameter for the time, time constant or axis
    /// that selected them.
    fn evidence(&self, extended: &ExtendedFit) -> f64 {
        extended.gain / self.variance - extended.occam - price(self.independent)
    }
}

impl BaseFit {
    /// Fit with additional columns, with a prior precision times the noise variance.
    fn extend(&self, added: &Products, precision: f64) -> Option<ExtendedFit> {
        let by_base = self.cholesky.solve(&added.with_base);
        let mut own = &added.own - added.with_base.tr_mul(&by_base);
        for at in 0..own.nrows() {
            own[(at, at)] += precision;
        }
        let cholesky = ridged(own).cholesky()?;
        let right = &added.with_residual - added.with_base.tr_mul(&self.parameters);
        let parameters = cholesky.solve(&right);
        Some(ExtendedFit {
            gain: right.dot(&parameters),
            base: &self.parameters - by_base * &parameters,
            occam: cholesky.ln_determinant() - parameters.len() as f64 * precision.ln(),
            added: parameters,
        })
    }

    /// Change of the sum of squares by additional columns without a prior.
    fn cost(&self, added: &Products) -> f64 {
        self.extend(added, 0.0).map_or(0.0, |fit| -fit.gain)
    }
}

fn best_candidate(candidates: impl Iterator<Item = f64>, cost: impl Fn(f64) -> f64) -> Option<f64> {
    let all = candidates.map(|candidate| (candidate, cost(candidate)));
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(candidate, _)| candidate)
}
