//! Gauss–Newton over the free parameters of a model of an IMU.

use super::super::linear::{Linear, Normal, Weight};
use super::super::robust::sandwich;
use super::super::{Measured, Seen, Unseen};
use ground::geometry::Vec3;
use ground::stats::{Length, joint_p_value};
use nalgebra::{DMatrix, DVector};

/// A model with parameters, of which some are fitted.
pub(super) trait Model {
    /// Residuals and their derivatives at the parameters as they are.
    fn linearize(&self) -> Linear;

    /// Moves the parameters by `delta`, one entry a column of the design.
    fn apply(&mut self, delta: &DVector<f64>);
}

/// Covariance of the parameters that a fit left free.
pub(super) struct Solved {
    free: Vec<usize>,
    covariance: DMatrix<f64>,
    dof: f64,
}

/// Fits the parameters `free` of `model`, and leaves the others as they are.
pub(super) fn solve(model: &mut impl Model, free: &[usize]) -> Solved {
    /// Steps after which a fit that still moves is left where it is.
    const STEPS: usize = 8;
    /// A step this small is the last, in the parameters' own units.
    const STILL: f64 = 1e-9;
    let mut left = STEPS;
    loop {
        let linear = model.linearize();
        let step = Step::of(&linear, free);
        model.apply(&step.delta);
        left -= 1;
        if left == 0 || step.delta.amax() < STILL {
            return step.solved(&linear, free);
        }
    }
}

/// One Gauss–Newton step on a linearised model.
struct Step {
    delta: DVector<f64>,
    /// By what it leaves of the residuals.
    weights: Vec<Weight>,
    independent: f64,
}

impl Step {
    /// The step of the parameters `free`.
    fn of(linear: &Linear, free: &[usize]) -> Self {
        let columns: Vec<usize> = (0..linear.width).collect();
        let zero = DVector::zeros(linear.width);
        let mut step =
            Self { delta: zero.clone(), weights: linear.first_weights(), independent: 0.0 };
        for _ in 0..2 {
            let mut normal = Normal::zeros(linear.width);
            linear.accumulate(&step.weights, &columns, &mut normal);
            let delta = normal.step(&zero, free);
            let weights = linear.weights_after(delta.as_slice());
            step = Self { delta, weights, independent: normal.independent };
        }
        step
    }

    /// The covariance where it was taken.
    fn solved(self, linear: &Linear, free: &[usize]) -> Solved {
        let mut free = free.to_vec();
        free.sort_unstable();
        let targets: Vec<Option<usize>> =
            (0..linear.width).map(|column| free.binary_search(&column).ok()).collect();
        let mut information = DMatrix::zeros(free.len(), free.len());
        let mut scores = information.clone();
        linear.accumulate_covariance(&self.weights, &targets, &mut information, &mut scores);
        let covariance = sandwich(&information, &scores);
        let dof = (self.independent - free.len() as f64).max(3.0);
        Solved { free, covariance, dof }
    }
}

/// How large the residual of each sample is.
pub(super) fn lengths(linear: &Linear) -> impl Iterator<Item = f64> {
    linear.residual[0].iter().map(|&residual| Vec3::from(residual).norm())
}

impl Solved {
    /// A parameter that the fit left at `value`.
    pub fn one(&self, parameter: usize, value: f64) -> Seen<Measured> {
        let variance = self.block(&[parameter])?[(0, 0)];
        Ok(Measured { value, std_error: variance.max(0.0).sqrt(), dof: self.dof })
    }

    /// A sum of parameters, each times its entry of `along`, which the fit left at `value`.
    pub fn along(&self, parameters: &[usize], along: &[f64], value: f64) -> Seen<Measured> {
        let along = DVector::from_column_slice(along);
        let variance = along.dot(&(self.block(parameters)? * &along));
        Ok(Measured { value, std_error: variance.max(0.0).sqrt(), dof: self.dof })
    }

    /// The length of a vector of parameters.
    pub fn length(&self, parameters: &[usize], vector: &[f64]) -> Seen<Length> {
        Ok(Length::of(vector, &self.block(parameters)?, self.dof))
    }

    /// The length of the sum of two vectors of parameters, which is `sum`.
    pub fn length_of_sum(&self, one: &[usize], other: &[usize], sum: &[f64]) -> Seen<Length> {
        let n = one.len();
        let both = self.block(&[one, other].concat())?;
        let covariance = DMatrix::from_fn(n, n, |i, j| {
            both[(i, j)] + both[(i, n + j)] + both[(n + i, j)] + both[(n + i, n + j)]
        });
        Ok(Length::of(sum, &covariance, self.dof))
    }

    /// Whether parameters as far from zero as `vector` have less than this `chance` of being truly
    /// zero.
    pub fn is_sure(&self, parameters: &[usize], vector: &[f64], chance: f64) -> bool {
        let vector = DVector::from_column_slice(vector);
        let p_value = |covariance| joint_p_value(&vector, &covariance, self.dof);
        self.block(parameters).is_ok_and(|covariance| p_value(covariance) < chance)
    }

    fn block(&self, parameters: &[usize]) -> Seen<DMatrix<f64>> {
        let at: Vec<usize> = parameters
            .iter()
            .map(|parameter| self.free.binary_search(parameter).map_err(|_| Unseen::NotExcited))
            .collect::<Seen<_>>()?;
        let block = DMatrix::from_fn(at.len(), at.len(), |i, j| self.covariance[(at[i], at[j])]);
        if block.iter().all(|value| value.is_finite()) {
            Ok(block)
        } else {
            Err(Unseen::NotExcited)
        }
    }
}
