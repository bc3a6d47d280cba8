//! Tests whether IMU parameters vary over the run: a step (sup-F over the change point: Andrews 1993), an
//! exponential decay, a random walk, or a dependence on another quantity. Each test extends one linearised
//! model by weighted columns. Extensions compete by the log Bayes factor over the base model, as diagnoses
//! of an arm do (`selection::evidence`).

use super::effects::Walk;
use crate::priors::price;
use crate::solver::linear::{Linear, Normal, ridged};
use crate::solver::noise::Noise;
use crate::solver::robust::robust_sigma;
use ground::geometry::Vec3;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Pieces that approximate a weight function in the coarse search.
const COARSE_PIECES: usize = 240;
const CHANGE_POINT_CANDIDATES: usize = 60;
/// As a share of the run.
const MIN_SIDE_SHARE: f64 = 0.06;
const OUTLIER_SIGMAS: f64 = 8.0;

pub(super) struct ExtensionTests<'a> {
    linear: &'a Linear,
    t_s: &'a [f64],
    /// Parameters of the base model.
    base: Vec<usize>,
    /// Their prior precisions; 0 without a prior.
    precision: Vec<f64>,
    robust_weights: Vec<f64>,
    /// Square of a residual beyond which a sample is an outlier.
    outlier: f64,
    /// Error of the base model without any fault; smaller residuals distinguish no extensions.
    model_error: f64,
    normal: Normal,
    /// Base model under its own noise.
    fit: BaseFit,
    /// Its variance.
    variance: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct ModelExtension {
    /// Change point or time constant, s, or density of a walk; 0 if none applies.
    pub at: f64,
    /// 95 % interval of a change point.
    pub interval_s: [f64; 2],
    /// Twice the log Bayes factor over the base model.
    pub log_bayes_factor: f64,
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
    /// Residual and prior sum of squares.
    squares: f64,
}

/// Additional columns: each of `columns`, scaled by every one of `weights` (one value per sample).
struct Extension<'a> {
    columns: &'a [usize],
    weights: Vec<Vec<f64>>,
    added: Added,
}

/// One component of a sample's residual.
struct BaseRow<'a> {
    weight: f64,
    /// Derivatives by the parameters of the base model, and by all.
    base: &'a DVector<f64>,
    all: &'a [f64],
    residual: f64,
}

/// Products of additional columns.
#[derive(Clone)]
struct Added {
    with_base: DMatrix<f64>,
    own: DMatrix<f64>,
    with_residual: DVector<f64>,
}

/// Fit of additional columns.
struct AddedFit {
    /// Decrease of the sum of squares.
    gain: f64,
    parameters: DVector<f64>,
    log_det: f64,
}

impl Added {
    fn zeros(base: usize, own: usize) -> Self {
        let (with_base, with_residual) = (DMatrix::zeros(base, own), DVector::zeros(own));
        Self { with_base, own: DMatrix::zeros(own, own), with_residual }
    }

    /// Adds `other` with its columns multiplied by `weight`; its products count `count` times.
    fn add(&mut self, other: &Self, weight: f64, count: f64) {
        self.with_base.zip_apply(&other.with_base, |sum, one| *sum += count * weight * one);
        self.own.zip_apply(&other.own, |sum, one| *sum += count * weight * weight * one);
        self.with_residual.axpy(count * weight, &other.with_residual, 1.0);
    }

    fn add_row(&mut self, row: &BaseRow, added: &DVector<f64>) {
        self.with_base.ger(row.weight, row.base, added, 1.0);
        self.own.ger(row.weight, added, added, 1.0);
        self.with_residual.axpy(row.weight * row.residual, added, 1.0);
    }
}

impl<'a> ExtensionTests<'a> {
    /// Tests on `linear` with samples at `t_s`. The base model has the parameters `base`, each with a prior
    /// precision. `None` if they cannot be fitted.
    pub fn new(
        linear: &'a Linear,
        t_s: &'a [f64],
        base: &[(usize, f64)],
        model_error: f64,
    ) -> Option<Self> {
        let residual = &linear.residual[0];
        let sigma = robust_sigma(residual).max(model_error);
        let outlier = 3.0 * (OUTLIER_SIGMAS * sigma).powi(2);
        let robust_weights: Vec<f64> =
            residual.iter().map(|r| (outlier / r.norm_squared()).min(1.0)).collect();
        let precision: Vec<f64> = base.iter().map(|parameter| parameter.1).collect();
        let base: Vec<usize> = base.iter().map(|parameter| parameter.0).collect();
        let mut normal = Normal::zeros(base.len());
        for_each_row(linear, &base, &robust_weights, |_, row| {
            normal.matrix.ger(row.weight, row.base, row.base, 1.0);
            normal.right.axpy(row.weight * row.residual, row.base, 1.0);
            normal.cost += row.weight * row.residual * row.residual;
        });
        let fit = BaseFit::new(&normal, &precision, sigma.powi(2))?;
        let mut tests = Self {
            linear,
            t_s,
            base,
            precision,
            robust_weights,
            outlier,
            model_error,
            normal,
            fit,
            variance: sigma.powi(2),
        };
        let noise = tests.noise(&tests.fit.parameters, &tests.extension(&[], Vec::new()), &[]);
        tests.variance = noise.variance;
        tests.fit = BaseFit::new(&tests.normal, &tests.precision, noise.variance)?;
        Some(tests)
    }

    fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (*self.t_s.first()?, *self.t_s.last()?);
        (last > first).then_some((first, last))
    }

    /// Tests for a step of `columns` and estimates its time.
    pub fn step(&self, columns: &[usize], size: f64) -> Option<ModelExtension> {
        let (first, last) = self.span()?;
        let side_s = MIN_SIDE_SHARE * (last - first);
        let before = self.prefix_sums(columns);
        let at = |at_s: f64| {
            let from = self.t_s.partition_point(|t_s| *t_s <= at_s);
            let mut after = before[self.t_s.len()].clone();
            after.add(&before[from], 1.0, -1.0);
            self.fit.squares - self.fit.extend(&after, 0.0).map_or(0.0, |fit| fit.gain)
        };
        let candidates = |from_s: f64, to_s: f64| {
            let step_s = (to_s - from_s) / (CHANGE_POINT_CANDIDATES - 1) as f64;
            (0..CHANGE_POINT_CANDIDATES).map(move |k| from_s + step_s * k as f64)
        };
        let (from_s, to_s) = (first + side_s, last - side_s);
        let mut best_s = best_candidate(candidates(from_s, to_s), at)?;
        let mut around_s = 1.5 * (to_s - from_s) / CHANGE_POINT_CANDIDATES as f64;
        for _ in 0..2 {
            best_s = best_candidate(candidates(best_s - around_s, best_s + around_s), at)?;
            around_s *= 4.0 / CHANGE_POINT_CANDIDATES as f64;
        }
        let next = self.t_s.partition_point(|t_s| *t_s <= best_s);
        if let Some(before) = next.checked_sub(1).filter(|_| next < self.t_s.len()) {
            best_s = 0.5 * (self.t_s[before] + self.t_s[next]);
        }
        let weight = self.t_s.iter().map(|t_s| f64::from(*t_s > best_s)).collect();
        let (log_bayes_factor, variance) = self.compare(columns, vec![weight], size)?;
        // 95 % likelihood region.
        let limit = at(best_s) + 3.84 * variance;
        let end = |sign: f64| {
            let mut step_s = 1.5 * (last - first) / self.t_s.len() as f64;
            let mut end_s = best_s;
            while at(end_s + sign * step_s) < limit && step_s < last - first {
                end_s += sign * step_s;
                step_s *= 1.5;
            }
            end_s + sign * step_s
        };
        Some(ModelExtension { at: best_s, interval_s: [end(-1.0), end(1.0)], log_bayes_factor })
    }

    /// Tests for an exponential decay of `columns` from the start, and estimates its time constant.
    pub fn decay(&self, columns: &[usize], size: f64) -> Option<ModelExtension> {
        let (first, last) = self.span()?;
        let before = self.prefix_sums(columns);
        let samples = self.t_s.len();
        // Start and products of each of `count` pieces.
        let pieces = |count: usize| -> Vec<(f64, Added)> {
            let count = count.min(samples);
            let piece = |at: usize| {
                let (from, to) = (at * samples / count, (at + 1) * samples / count);
                let mut products = before[to].clone();
                products.add(&before[from], 1.0, -1.0);
                (self.t_s[(from + to) / 2] - first, products)
            };
            (0..count).map(piece).collect()
        };
        let residual = |tau_s: f64, pieces: &[(f64, Added)]| {
            let mut sums = Added::zeros(self.base.len(), columns.len());
            for (t_s, products) in pieces {
                sums.add(products, (-t_s / tau_s).exp(), 1.0);
            }
            -self.fit.extend(&sums, 0.0).map_or(0.0, |fit| fit.gain)
        };
        let taus = (0..CHANGE_POINT_CANDIDATES)
            .map(|k| (last - first) * 0.03 * 33f64.powf(k as f64 / CHANGE_POINT_CANDIDATES as f64));
        let (coarse, fine) = (pieces(COARSE_PIECES), pieces(samples));
        let tau_s = best_candidate(taus, |tau_s| residual(tau_s, &coarse))?;
        let finer = (-4..=4).map(|k| tau_s * 1.015f64.powi(k));
        let tau_s = best_candidate(finer, |tau_s| residual(tau_s, &fine))?;
        let weight = self.t_s.iter().map(|t_s| (-(t_s - first) / tau_s).exp()).collect();
        let extension = self.best_extension(columns, vec![weight], size)?;
        Some(ModelExtension { at: tau_s, ..extension })
    }

    /// Extension by `columns`, each scaled by every one of `weights` (one value per sample), with parameters of the
    /// prior `size`.
    pub fn best_extension(
        &self,
        columns: &[usize],
        weights: Vec<Vec<f64>>,
        size: f64,
    ) -> Option<ModelExtension> {
        let (log_bayes_factor, _) = self.compare(columns, weights, size)?;
        Some(ModelExtension { at: 0.0, interval_s: [0.0; 2], log_bayes_factor })
    }

    /// Random walk of `column`. Estimates its density, per √s.
    pub fn walk(&self, column: usize, walk: &Walk) -> Option<ModelExtension> {
        /// Variances of an increment, relative to its noise.
        const POWERS_OF_TWO: std::ops::RangeInclusive<i32> = -8..=24;
        /// Every so many increments are joined while the noise is first estimated: single ones absorb autocorrelated
        /// noise.
        const JOINED_INCREMENTS: usize = 4;
        const MAX_REFINEMENTS: usize = 8;
        let mut weights = vec![Vec::with_capacity(self.t_s.len()); walk.increments];
        for &t_s in self.t_s {
            weights.iter_mut().zip(walk.weights(t_s)).for_each(|(all, weight)| all.push(weight));
        }
        let join = |increments: &[Vec<f64>]| {
            (0..self.t_s.len()).map(|at| increments.iter().map(|one| one[at]).sum()).collect()
        };
        let columns = &[column];
        let joined = self.extension(columns, weights.chunks(JOINED_INCREMENTS).map(join).collect());
        let whole = Extension { columns, weights, added: self.increments(column, walk) };
        let added = &whole.added;
        let likeliest = |noise: &IndependentNoise| {
            let fit = BaseFit::new(&self.normal, &self.precision, noise.variance)?;
            let typical = noise.variance * walk.increments as f64 / added.own.trace();
            let cost = |variance: f64| {
                noise.evidence(&fit, added, variance).map_or(f64::INFINITY, |gain| -gain)
            };
            let coarse =
                best_candidate(POWERS_OF_TWO.map(|power| typical * 2f64.powi(power)), cost)?;
            best_candidate((-4..=4).map(|k| coarse * 2f64.powf(0.25 * f64::from(k))), cost)
        };
        let mut noise = self.noise_with(&self.fit, &joined, 0.0)?;
        let mut variance = likeliest(&noise)?;
        // The density is a parameter as well.
        let log_bayes_factor = self.evidence(&whole, variance, noise)? - price(noise.independent);
        // The first noise contains the walk within the joined increments.
        for _ in 0..MAX_REFINEMENTS {
            let fit = BaseFit::new(&self.normal, &self.precision, noise.variance)?;
            let precision = noise.variance / variance;
            noise = self.noise_with(&fit, &whole, precision)?;
            let previous = std::mem::replace(&mut variance, likeliest(&noise)?);
            if variance <= previous {
                break;
            }
        }
        let density = (variance / walk.step_s).sqrt();
        Some(ModelExtension { at: density, interval_s: [0.0; 2], log_bayes_factor })
    }

    /// Twice the log Bayes factor, and the variance of independent noise.
    fn compare(&self, columns: &[usize], weights: Vec<Vec<f64>>, size: f64) -> Option<(f64, f64)> {
        let extension = self.extension(columns, weights);
        let noise = self.noise_with(&self.fit, &extension, self.variance / size.powi(2))?;
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
        let added = &extension.added;
        let fit = BaseFit::new(&self.normal, &self.precision, noise.variance)?;
        let extended = fit.extend(added, noise.variance / variance)?;
        let base = &fit.parameters - fit.cholesky.solve(&(&added.with_base * &extended.parameters));
        let values = extended.parameters.as_slice();
        let (mut by_weights, mut by_outliers) = (0.0, 0.0);
        for (sample, weight) in self.robust_weights.iter().enumerate() {
            let before = self.residual(sample, &fit.parameters, extension, &[]).norm_squared();
            let after = self.residual(sample, &base, extension, values).norm_squared();
            by_weights += weight * (before - after);
            by_outliers += before.min(self.outlier) - after.min(self.outlier);
        }
        let evidence = noise.evidence(&fit, added, variance)?;
        Some(evidence + (by_outliers - by_weights) / noise.variance)
    }

    /// Residual of a sample after the base model and additional columns.
    fn residual(
        &self,
        sample: usize,
        base: &DVector<f64>,
        Extension { columns, weights, .. }: &Extension,
        added: &[f64],
    ) -> Vec3 {
        Vec3::from_fn(|axis, _| {
            let row = self.linear.row(sample, axis);
            let by_base = self.base.iter().zip(base.iter()).map(|(&at, value)| row[at] * value);
            let by_added = weights
                .iter()
                .flat_map(|weight| columns.iter().map(move |&column| weight[sample] * row[column]));
            let by_added = by_added.zip(added).map(|(derivative, value)| derivative * value);
            self.linear.residual(sample, axis) - by_base.chain(by_added).sum::<f64>()
        })
    }

    /// Noise with additional columns, in the components of the residual that they change. `precision` is that of their
    /// prior, times the variance of the noise.
    fn noise_with(
        &self,
        fit: &BaseFit,
        extension: &Extension,
        precision: f64,
    ) -> Option<IndependentNoise> {
        let added = &extension.added;
        let extended = fit.extend(added, precision)?;
        let by_added = fit.cholesky.solve(&(&added.with_base * &extended.parameters));
        let base = &fit.parameters - by_added;
        Some(self.noise(&base, extension, extended.parameters.as_slice()))
    }

    fn noise(&self, base: &DVector<f64>, extension: &Extension, added: &[f64]) -> IndependentNoise {
        /// Share of the columns' squares in a component that they change.
        const MIN_SHARE: f64 = 1e-3;
        let samples = 0..self.t_s.len();
        let squares = [0, 1, 2].map(|axis| -> f64 {
            let of_sample = |sample| {
                let row = self.linear.row(sample, axis);
                extension.columns.iter().map(move |&at| row[at].powi(2))
            };
            samples.clone().flat_map(of_sample).sum()
        });
        let is_changed = squares.map(|one| one >= MIN_SHARE * squares.iter().sum::<f64>());
        let changed = |sample: usize| {
            let residual = self.residual(sample, base, extension, added);
            Vec3::from_fn(|axis, _| if is_changed[axis] { residual[axis] } else { 0.0 })
        };
        let residual: Vec<Vec3> = samples.map(changed).collect();
        let components = is_changed.iter().filter(|changed| **changed).count() as f64;
        let noise = Noise::estimate(&residual, &self.robust_weights, 0.0);
        let inflation = noise.inflation().max(1.0);
        let variance = (noise.sigma.powi(2) * 3.0 / components).max(self.model_error.powi(2));
        let independent = components * self.t_s.len() as f64 / inflation;
        IndependentNoise { variance: variance * inflation, independent }
    }

    fn extension<'c>(&self, columns: &'c [usize], weights: Vec<Vec<f64>>) -> Extension<'c> {
        let mut added = Added::zeros(self.base.len(), columns.len() * weights.len());
        let mut values = DVector::zeros(columns.len() * weights.len());
        self.for_each_row(|sample, row| {
            let products = weights
                .iter()
                .flat_map(|weight| columns.iter().map(move |&at| weight[sample] * row.all[at]));
            values.iter_mut().zip(products).for_each(|(value, product)| *value = product);
            added.add_row(&row, &values);
        });
        Extension { columns, weights, added }
    }

    /// Products of a walk's increments. While an increment passes, every earlier one has weight 1, so the product of
    /// both contains only the later weight.
    fn increments(&self, column: usize, walk: &Walk) -> Added {
        let count = walk.increments;
        let zeros = || vec![Added::zeros(self.base.len(), 1); count];
        // Per interval of the walk: with the weight of its increment, and with weight 1.
        let (mut passing, mut passed) = (zeros(), zeros());
        let mut squares = vec![0.0; count];
        let mut value = DVector::zeros(1);
        self.for_each_row(|sample, row| {
            let (at, share) = walk.position(self.t_s[sample]);
            value[0] = row.all[column];
            passed[at].add_row(&row, &value);
            let square = row.weight * value[0] * value[0];
            value[0] *= share;
            passing[at].add_row(&row, &value);
            // `passing.own` has the square of the share.
            squares[at] += share * square;
        });
        let mut added = Added::zeros(self.base.len(), count);
        let mut later = Added::zeros(self.base.len(), 1);
        for at in (0..count).rev() {
            let mut own = passing[at].clone();
            own.add(&later, 1.0, 1.0);
            added.with_base.set_column(at, &own.with_base.column(0));
            added.with_residual[at] = own.with_residual[0];
            for earlier in 0..at {
                let product = squares[at] + later.own[(0, 0)];
                added.own[(at, earlier)] = product;
                added.own[(earlier, at)] = product;
            }
            added.own[(at, at)] = own.own[(0, 0)];
            later.add(&passed[at], 1.0, 1.0);
        }
        added
    }

    /// Sums over the samples before each one. They give the residual for any weight function without another
    /// pass over the data.
    fn prefix_sums(&self, columns: &[usize]) -> Vec<Added> {
        let mut sums = Added::zeros(self.base.len(), columns.len());
        let mut before = vec![sums.clone()];
        let mut values = DVector::zeros(columns.len());
        self.for_each_row(|sample, row| {
            if before.len() <= sample {
                before.push(sums.clone());
            }
            values.iter_mut().zip(columns).for_each(|(value, &at)| *value = row.all[at]);
            sums.add_row(&row, &values);
        });
        before.push(sums);
        before
    }

    fn for_each_row(&self, each: impl FnMut(usize, BaseRow)) {
        for_each_row(self.linear, &self.base, &self.robust_weights, each);
    }
}

/// Passes every component of the samples, with the sample's number.
fn for_each_row(
    linear: &Linear,
    base: &[usize],
    robust_weights: &[f64],
    mut each: impl FnMut(usize, BaseRow),
) {
    let mut base_values = DVector::zeros(base.len());
    for (sample, &weight) in robust_weights.iter().enumerate() {
        for axis in 0..3 {
            let all = linear.row(sample, axis);
            base_values.iter_mut().zip(base).for_each(|(value, &at)| *value = all[at]);
            let residual = linear.residual(sample, axis);
            each(sample, BaseRow { weight, base: &base_values, all, residual });
        }
    }
}

impl IndependentNoise {
    /// Twice the log Bayes factor of additional parameters with this prior variance. Counts one parameter for the
    /// time, time constant or axis that selected them.
    fn evidence(&self, fit: &BaseFit, added: &Added, variance: f64) -> Option<f64> {
        let precision = self.variance / variance;
        let extended = fit.extend(added, precision)?;
        let occam = extended.log_det - extended.parameters.len() as f64 * precision.ln();
        Some(extended.gain / self.variance - occam - price(self.independent))
    }
}

impl BaseFit {
    fn new(normal: &Normal, precision: &[f64], variance: f64) -> Option<Self> {
        let mut matrix = normal.matrix.clone();
        for (at, precision) in precision.iter().enumerate() {
            matrix[(at, at)] += variance * precision;
        }
        let cholesky = ridged(matrix).cholesky()?;
        let parameters = cholesky.solve(&normal.right);
        let squares = normal.cost - normal.right.dot(&parameters);
        Some(Self { cholesky, parameters, squares })
    }

    /// Fit with additional columns, with a prior precision times the noise variance.
    fn extend(&self, added: &Added, precision: f64) -> Option<AddedFit> {
        let by_base = self.cholesky.solve(&added.with_base);
        let mut own = &added.own - added.with_base.tr_mul(&by_base);
        for at in 0..own.nrows() {
            own[(at, at)] += precision;
        }
        let cholesky = ridged(own).cholesky()?;
        let right = &added.with_residual - added.with_base.tr_mul(&self.parameters);
        let parameters = cholesky.solve(&right);
        let log_det = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        Some(AddedFit { gain: right.dot(&parameters), parameters, log_det })
    }
}

fn best_candidate(
    candidates: impl Iterator<Item = f64>,
    residual: impl Fn(f64) -> f64,
) -> Option<f64> {
    let all = candidates.map(|candidate| (candidate, residual(candidate)));
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(candidate, _)| candidate)
}
