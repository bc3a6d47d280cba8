//! Gauss–Newton for the free parameters of an IMU model.

use super::model::{Linearization, Model};
use crate::solver::linear::Weight;
use crate::solver::robust::{pseudo_inverse, sandwich};
use crate::{EstimateResult, Measured, NotObservable};
use ground::geometry::Vec3;
use ground::stats::MeasuredLength;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

pub(super) struct Solved {
    covariance: DMatrix<f64>,
    /// Directions over all columns that are not free or not observable; the fit did not change them.
    fixed: Vec<DVector<f64>>,
    dof: f64,
    /// Fitted parameters.
    values: DVector<f64>,
    /// Residuals after the random effects.
    pub residuals: Vec<Vec3>,
}

/// Fits `free` and the random effects. Directions that the motion does not excite above the design noise stay
/// fixed.
pub(super) fn solve(model: &mut impl Model, free: &[usize]) -> Solved {
    const MAX_STEPS: usize = 8;
    /// In the parameters' units.
    const CONVERGED_STEP: f64 = 1e-9;
    let mut linearization = model.linearize();
    let width = linearization.linear.width;
    let [mut excited, mut fixed] = excited_directions(model, &linearization, free);
    let mut all = free.to_vec();
    let columns_of_model = model.parameters().columns.iter();
    let precision = DVector::from_iterator(width, columns_of_model.map(|it| it.precision));
    for column in (0..width).filter(|at| precision[*at] > 0.0 && !free.contains(at)) {
        excited.push(unit(width, column));
        all.push(column);
    }
    let basis = columns(width, &excited);
    let noise = basis.tr_mul(&linearization.design_noise) * &basis;
    let prior = basis.tr_mul(&DMatrix::from_diagonal(&precision)) * &basis;
    let mut steps = 0;
    let (linear, fit) = loop {
        let linear = linearization.linear;
        let pull = -model.parameters().values(0..width).component_mul(&precision);
        let fit = linear.reweighted_fit(2, |normal| {
            // Without the design noise, a step would overshoot where a prior shares its direction.
            let matrix = basis.tr_mul(&normal.matrix) * &basis + &prior;
            &basis * (pseudo_inverse(&matrix).0 * basis.tr_mul(&(&normal.right + &pull)))
        });
        let largest = free.iter().map(|&at| fit.step[at].abs()).fold(0.0, f64::max);
        model.parameters().apply(fit.step.as_slice(), free);
        model.turn(fit.step.as_slice());
        steps += 1;
        if steps == MAX_STEPS || largest < CONVERGED_STEP {
            break (linear, fit);
        }
        linearization = model.linearize();
    };
    let noise = noise * fit.weights.first().map_or(0.0, Weight::base_weight);
    let parts = linear.covariance_parts(&fit.weights);
    let [information, scores] = parts.map(|part| basis.tr_mul(&part) * &basis);
    let information = without_noise(information, &noise) + &prior;
    let mut covariance = sandwich(&information, &(scores + &prior));
    for (at, direction) in excited.into_iter().enumerate() {
        if !covariance[(at, at)].is_finite() {
            covariance.fill_row(at, 0.0);
            covariance.fill_column(at, 0.0);
            fixed.push(direction);
        }
    }
    let covariance = &basis * covariance * basis.transpose();
    let random = prior.diagonal().iter().filter(|precision| **precision > 0.0).count();
    let dof = fit.normal.dof(all.len() - random);
    let residuals = fit.residuals.into_iter().flatten().collect();
    let values = model.parameters().values(0..width);
    let others = (0..width).filter(|column| !all.contains(column));
    fixed.extend(others.map(|column| unit(width, column)));
    Solved { covariance, fixed, dof, values, residuals }
}

/// Combinations of the `free` parameters that the motion excites, and those that it does not.
fn excited_directions(
    model: &mut impl Model,
    Linearization { linear, design_noise, .. }: &Linearization,
    free: &[usize],
) -> [Vec<DVector<f64>>; 2] {
    /// Share of noise in the `AᵀA` of an excited combination. Joint and gyro noise are known to a factor of
    /// two in variance; this adds another.
    const MAX_NOISE_SHARE: f64 = 0.25;
    let squares = linear.information(&linear.even_weights());
    let units = |columns: &[usize]| -> Vec<DVector<f64>> {
        columns.iter().map(|&column| unit(linear.width, column)).collect()
    };
    let mut free = free.to_vec();
    free.sort_unstable();
    let (mut excited, mut fixed) = (units(&free), Vec::new());
    let own_group = model.own_group();
    for group in [own_group].into_iter().chain(model.parameters().groups()) {
        let own: Vec<usize> = group.filter(|column| free.contains(column)).collect();
        if own.is_empty() {
            continue;
        }
        excited.retain(|direction| own.iter().all(|&column| direction[column] == 0.0));
        let others = columns(linear.width, &excited);
        let own = columns(linear.width, &units(&own));
        // Effects that the other parameters do not explain.
        let across = others.tr_mul(&squares) * &own;
        let between = pseudo_inverse(&(others.tr_mul(&squares) * &others)).0;
        let alone = own.tr_mul(&squares) * &own - across.tr_mul(&(between * &across));
        let by_noise = own.tr_mul(design_noise) * &own;
        let eigen = (alone - by_noise / MAX_NOISE_SHARE).symmetric_eigen();
        for (direction, excess) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
            let directions = if *excess > 0.0 { &mut excited } else { &mut fixed };
            directions.push(&own * direction);
        }
    }
    [excited, fixed]
}

fn columns(width: usize, directions: &[DVector<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(width, directions.len(), |i, j| directions[j][i])
}

fn unit(width: usize, column: usize) -> DVector<f64> {
    DVector::from_fn(width, |row, _| f64::from(row == column))
}

/// Information without the design noise. Zero along directions that have less: their noise must not use up a
/// prior, as where a link deviation has the same effect as the mount.
fn without_noise(mut information: DMatrix<f64>, noise: &DMatrix<f64>) -> DMatrix<f64> {
    let scale = information.diagonal().map(|one| if one > 0.0 { one.sqrt() } else { 1.0 });
    information -= noise;
    let scaled = |i: usize, j: usize| information[(i, j)] / (scale[i] * scale[j]);
    let mut eigen = DMatrix::from_fn(scale.len(), scale.len(), scaled).symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    let clipped = eigen.recompose();
    DMatrix::from_fn(scale.len(), scale.len(), |i, j| clipped[(i, j)] * scale[i] * scale[j])
}

/// Largest share of an observable parameter in fixed directions.
const MAX_FIXED_SHARE: f64 = 1e-3;

impl Solved {
    pub fn measure(&self, parameter: usize) -> EstimateResult<Measured> {
        self.measure_combination(parameter..parameter + 1, &DVector::from_element(1, 1.0))
    }

    /// Estimate of a linear combination.
    pub fn measure_combination(
        &self,
        parameters: Range<usize>,
        along: &DVector<f64>,
    ) -> EstimateResult<Measured> {
        let value = along.dot(&self.values.rows_range(parameters.clone()));
        let variance = along.dot(&(self.block(parameters)? * along));
        Ok(Measured { value, std_error: variance.max(0.0).sqrt(), dof: self.dof })
    }

    /// Length of a vector: the sum of consecutive blocks of parameters.
    pub fn length(
        &self,
        parameters: impl Iterator<Item = usize> + Clone,
        vector: &[f64],
    ) -> EstimateResult<MeasuredLength> {
        let blocks = self.block(parameters)?;
        let n = vector.len();
        let sum = DMatrix::from_fn(n, blocks.nrows(), |i, j| f64::from(i == j % n));
        let covariance = &sum * blocks * sum.transpose();
        Ok(MeasuredLength::estimate(vector, &covariance, self.dof))
    }

    /// Length of the observable component: a lower bound.
    pub fn observable_length(
        &self,
        parameters: Range<usize>,
        vector: &[f64],
    ) -> EstimateResult<MeasuredLength> {
        let n = parameters.len();
        let mut fixed = DMatrix::zeros(n, n);
        for direction in &self.fixed {
            let own = direction.rows(parameters.start, n);
            fixed += own * own.transpose();
        }
        let eigen = fixed.symmetric_eigen();
        let excited =
            (0..n).filter(|&at| eigen.eigenvalues[at] < MAX_FIXED_SHARE).collect::<Vec<_>>();
        if excited.is_empty() {
            return Err(NotObservable::NotExcited);
        }
        let basis = eigen.eigenvectors.select_columns(&excited);
        let covariance = basis.tr_mul(&self.covariance_of(parameters)?) * &basis;
        let part = basis.tr_mul(&DVector::from_column_slice(vector));
        Ok(MeasuredLength::estimate(part.as_slice(), &covariance, self.dof))
    }

    fn block(
        &self,
        parameters: impl Iterator<Item = usize> + Clone,
    ) -> EstimateResult<DMatrix<f64>> {
        let is_fixed = |parameter: usize| {
            self.fixed.iter().any(|direction| direction[parameter].powi(2) > MAX_FIXED_SHARE)
        };
        if parameters.clone().any(is_fixed) {
            return Err(NotObservable::NotExcited);
        }
        self.covariance_of(parameters)
    }

    fn covariance_of(
        &self,
        parameters: impl Iterator<Item = usize>,
    ) -> EstimateResult<DMatrix<f64>> {
        let at: Vec<usize> = parameters.collect();
        let block = self.covariance.select_rows(&at).select_columns(&at);
        let is_estimated = block.iter().all(|value| value.is_finite());
        if is_estimated { Ok(block) } else { Err(NotObservable::NotExcited) }
    }
}
