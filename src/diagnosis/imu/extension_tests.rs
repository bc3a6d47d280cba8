//! Tests whether IMU parameters vary over time: a step (sup-F over the change point: Andrews 1993), an
//! exponential decay, or a dependence on another quantity. Each test extends one linearised model by
//! weighted columns. Extensions compete by the log Bayes factor over the base model, as diagnoses of an arm do
//! (`selection::evidence`).

use crate::priors::price;
use crate::solver::linear::{Linear, Normal, Triangle};
use crate::solver::noise::Noise;
use crate::solver::robust::robust_sigma;
use nalgebra::{DMatrix, DVector};

/// Pieces that approximate a weight function in the coarse search.
const COARSE_PIECES: usize = 240;
const CHANGE_POINT_CANDIDATES: usize = 60;
/// As a share of the run.
const MIN_SIDE_SHARE: f64 = 0.06;
const OUTLIER_SIGMAS: f64 = 8.0;

pub(super) struct ExtensionTests<'a> {
    linear: &'a Linear,
    t_s: Vec<f64>,
    /// Free parameters of the base model.
    base: Vec<usize>,
    robust_weights: Vec<f64>,
    /// Error of the base model without any fault; smaller residuals distinguish no extensions.
    model_error: f64,
    /// Residual sum of squares of the base model.
    residual_squares: f64,
}

#[derive(Clone, Debug)]
pub(super) struct ModelExtension {
    /// Change point or time constant, s; 0 if neither applies.
    pub at_s: f64,
    /// 95 % interval.
    pub interval_s: [f64; 2],
    /// Twice the log Bayes factor over the base model.
    pub log_bayes_factor: f64,
    /// Residual sum of squares.
    residual_squares: f64,
    /// Variance of independent noise.
    variance: f64,
}

impl ModelExtension {
    /// Whether it is likelier than the base model.
    pub fn is_likelier(&self) -> bool {
        self.log_bayes_factor > 0.0
    }
}

impl<'a> ExtensionTests<'a> {
    /// Tests on `linear` with samples at `t_s` and free parameters `base`.
    pub fn new(linear: &'a Linear, t_s: Vec<f64>, base: &[usize], model_error: f64) -> Self {
        let residual = &linear.residual[0];
        let limit = OUTLIER_SIGMAS * robust_sigma(residual).max(model_error) * 3f64.sqrt();
        let norm = |r: &[f64; 3]| r.iter().map(|c| c * c).sum::<f64>().sqrt();
        let robust_weights = residual.iter().map(|r| (limit / norm(r)).min(1.0)).collect();
        let base = base.to_vec();
        let mut tests =
            Self { linear, t_s, base, robust_weights, model_error, residual_squares: 0.0 };
        tests.residual_squares = tests.residual_squares(&[], &[]).0;
        tests
    }

    fn len(&self) -> usize {
        self.t_s.len()
    }

    fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (*self.t_s.first()?, *self.t_s.last()?);
        (last > first).then_some((first, last))
    }

    /// Tests for a step of `columns` and estimates its time.
    pub fn step(&self, columns: &[usize]) -> Option<ModelExtension> {
        let (first, last) = self.span()?;
        let side_s = MIN_SIDE_SHARE * (last - first);
        let sums = PrefixSums::new(self, columns);
        let at = |at_s: f64| sums.residual_with_step(self.t_s.partition_point(|t_s| *t_s <= at_s));
        let (from_s, to_s) = (first + side_s, last - side_s);
        let link_state = |k: usize, from_s: f64, to_s: f64| {
            from_s + (to_s - from_s) * k as f64 / (CHANGE_POINT_CANDIDATES - 1) as f64
        };
        let mut best_s =
            best_candidate((0..CHANGE_POINT_CANDIDATES).map(|k| link_state(k, from_s, to_s)), at)?;
        let mut around_s = 1.5 * (to_s - from_s) / CHANGE_POINT_CANDIDATES as f64;
        for _ in 0..2 {
            let candidates = (0..CHANGE_POINT_CANDIDATES)
                .map(|k| link_state(k, best_s - around_s, best_s + around_s));
            best_s = best_candidate(candidates, at)?;
            around_s *= 4.0 / CHANGE_POINT_CANDIDATES as f64;
        }
        let next = self.t_s.partition_point(|t_s| *t_s <= best_s);
        if let Some(before) = next.checked_sub(1).filter(|_| next < self.len()) {
            best_s = 0.5 * (self.t_s[before] + self.t_s[next]);
        }
        let weight = self.t_s.iter().map(|t_s| f64::from(u8::from(*t_s > best_s))).collect();
        let mut extension = self.best_extension(columns, &[weight])?;
        // 95 % likelihood region.
        let limit = extension.residual_squares + 3.84 * extension.variance;
        let end = |sign: f64| {
            let mut step_s = 1.5 * (last - first) / self.len() as f64;
            let mut end_s = best_s;
            while at(end_s + sign * step_s) < limit && step_s < last - first {
                end_s += sign * step_s;
                step_s *= 1.5;
            }
            end_s + sign * step_s
        };
        (extension.at_s, extension.interval_s) = (best_s, [end(-1.0), end(1.0)]);
        Some(extension)
    }

    /// Tests for an exponential decay of `columns` from the start; `at_s` is the time constant.
    pub fn decay(&self, columns: &[usize]) -> Option<ModelExtension> {
        let (first, last) = self.span()?;
        let span_s = last - first;
        let sums = PrefixSums::new(self, columns);
        let residual = |tau_s: f64, pieces: usize| {
            sums.residual_with_weight(pieces, |t_s| (-(t_s - first) / tau_s).exp())
        };
        let taus = (0..CHANGE_POINT_CANDIDATES)
            .map(|k| span_s * 0.03 * 33f64.powf(k as f64 / CHANGE_POINT_CANDIDATES as f64));
        let tau_s = best_candidate(taus, |tau_s| residual(tau_s, COARSE_PIECES))?;
        let finer = (-4..=4).map(|k| tau_s * 1.015f64.powi(k));
        let tau_s = best_candidate(finer, |tau_s| residual(tau_s, self.len()))?;
        let weight = self.t_s.iter().map(|t_s| (-(t_s - first) / tau_s).exp()).collect();
        let extension = self.best_extension(columns, &[weight])?;
        Some(ModelExtension { at_s: tau_s, interval_s: [tau_s; 2], ..extension })
    }

    /// Best extension by `columns`, each scaled by one of `weights` (one value per sample). Counts one parameter for
    /// the time, time constant or axis that selected the weights.
    pub fn best_extension(
        &self,
        columns: &[usize],
        weights: &[Vec<f64>],
    ) -> Option<ModelExtension> {
        let (residual_squares, parameters) = self.residual_squares(columns, weights);
        let residual = self.residual(columns, weights, &parameters);
        let noise = Noise::estimate(&residual, &self.robust_weights, self.model_error);
        let samples = 3.0 * self.len() as f64;
        let inflation = noise.inflation().max(1.0);
        let mean_square = |squares: f64| squares / samples + self.model_error.powi(2);
        let independent = samples / inflation;
        let ratio = mean_square(self.residual_squares) / mean_square(residual_squares);
        let added = columns.len() * weights.len() + 1;
        let log_bayes_factor = independent * ratio.ln() - price(independent) * added as f64;
        log_bayes_factor.is_finite().then_some(ModelExtension {
            at_s: 0.0,
            interval_s: [0.0; 2],
            log_bayes_factor,
            residual_squares,
            variance: mean_square(residual_squares) * inflation,
        })
    }

    /// Also returns the parameters: the base, then `columns` for each set of weights.
    fn residual_squares(&self, columns: &[usize], weights: &[Vec<f64>]) -> (f64, DVector<f64>) {
        let width = self.base.len() + columns.len() * weights.len();
        let mut sums = Triangle::zeros(width + 1);
        let mut rows = [0, 1, 2].map(|_| vec![0.0; width + 1]);
        for sample in 0..self.len() {
            for (axis, row) in rows.iter_mut().enumerate() {
                self.fill(row, sample, axis, columns, weights);
            }
            sums.add_squares([&rows[0], &rows[1], &rows[2]], self.robust_weights[sample]);
        }
        solve_sums(width, |i, j| sums.at(i, j))
    }

    /// Derivatives of one residual component, followed by the residual.
    fn fill(
        &self,
        row: &mut [f64],
        sample: usize,
        axis: usize,
        columns: &[usize],
        weights: &[Vec<f64>],
    ) {
        let design_row = self.linear.row(sample, axis);
        let (base, added) = row.split_at_mut(self.base.len());
        base.iter_mut().zip(&self.base).for_each(|(value, &column)| *value = design_row[column]);
        let by_weight = weights
            .iter()
            .flat_map(|weight| columns.iter().map(|&column| weight[sample] * design_row[column]));
        let residual = self.linear.residual[0][sample][axis];
        let all = by_weight.chain([residual]);
        added.iter_mut().zip(all).for_each(|(value, derivative)| *value = derivative);
    }

    fn residual(
        &self,
        columns: &[usize],
        weights: &[Vec<f64>],
        parameters: &DVector<f64>,
    ) -> Vec<[f64; 3]> {
        let mut row = vec![0.0; parameters.len() + 1];
        let mut one = |sample: usize, axis: usize| {
            self.fill(&mut row, sample, axis, columns, weights);
            let explained: f64 = row.iter().zip(parameters.iter()).map(|(a, b)| a * b).sum();
            row[parameters.len()] - explained
        };
        (0..self.len()).map(|sample| [one(sample, 0), one(sample, 1), one(sample, 2)]).collect()
    }
}

/// Prefix sums of all products of derivatives and residual. They give the residual for any weight function
/// without another pass over the data.
struct PrefixSums<'a> {
    tests: &'a ExtensionTests<'a>,
    others: usize,
    before: Vec<Triangle>,
}

impl<'a> PrefixSums<'a> {
    fn new(tests: &'a ExtensionTests<'a>, columns: &[usize]) -> Self {
        let width = tests.base.len() + columns.len();
        let always = [vec![1.0; tests.len()]];
        let mut rows = [0, 1, 2].map(|_| vec![0.0; width + 1]);
        let mut sums = Triangle::zeros(width + 1);
        let mut before = vec![sums.clone()];
        for sample in 0..tests.len() {
            for (axis, row) in rows.iter_mut().enumerate() {
                tests.fill(row, sample, axis, columns, &always);
            }
            sums.add_squares([&rows[0], &rows[1], &rows[2]], tests.robust_weights[sample]);
            before.push(sums.clone());
        }
        Self { tests, others: columns.len(), before }
    }

    fn residual_with_step(&self, from: usize) -> f64 {
        let mut after = self.before[self.tests.len()].clone();
        after.add_scaled(&self.before[from], -1.0);
        self.residual_squares(&after, &after)
    }

    /// `course(t)` is approximated as constant over each piece.
    fn residual_with_weight(&self, pieces: usize, weight_at: impl Fn(f64) -> f64) -> f64 {
        let samples = self.tests.len();
        let mut single = Triangle::zeros(self.tests.base.len() + self.others + 1);
        let mut double = single.clone();
        let pieces = pieces.min(samples);
        for piece in 0..pieces {
            let (from, to) = (piece * samples / pieces, (piece + 1) * samples / pieces);
            let weight = weight_at(self.tests.t_s[(from + to) / 2]);
            for (sums, by) in [(&mut single, weight), (&mut double, weight * weight)] {
                sums.add_scaled(&self.before[to], by);
                sums.add_scaled(&self.before[from], -by);
            }
        }
        self.residual_squares(&single, &double)
    }

    /// `once` holds products of base and additional parameters, `twice` those of two additional ones.
    fn residual_squares(&self, single: &Triangle, double: &Triangle) -> f64 {
        let base = self.tests.base.len();
        let width = base + self.others;
        let is_other = |i: usize| (base..width).contains(&i);
        solve_sums(width, |i, j| match (is_other(i), is_other(j)) {
            (false, false) => self.before[self.tests.len()].at(i, j),
            (true, true) => double.at(i, j),
            _ => single.at(i, j),
        })
        .0
    }
}

fn solve_sums(width: usize, sums: impl Fn(usize, usize) -> f64) -> (f64, DVector<f64>) {
    let normal = Normal {
        matrix: DMatrix::from_fn(width, width, &sums),
        right: DVector::from_fn(width, |i, _| sums(width, i)),
        ..Normal::zeros(0)
    };
    let all: Vec<usize> = (0..width).collect();
    let parameters = normal.step(&DVector::zeros(width), &all);
    ((sums(width, width) - normal.right.dot(&parameters)).max(0.0), parameters)
}

fn best_candidate(
    candidates: impl Iterator<Item = f64>,
    residual: impl Fn(f64) -> f64,
) -> Option<f64> {
    let all = candidates.map(|candidate| (candidate, residual(candidate)));
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(candidate, _)| candidate)
}
