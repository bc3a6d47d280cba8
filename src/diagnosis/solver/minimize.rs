//! Levenberg–Marquardt for small nonlinear least-squares problems (Levenberg 1944, Marquardt 1963).

use crate::model::jacobian::Derivative;
use ground::geometry::Vec3;
use nalgebra::{DMatrix, DVector};

/// Problem linearised about a state.
pub(crate) struct NormalEquations {
    /// `AᵀA`.
    pub matrix: DMatrix<f64>,
    /// `Aᵀr`.
    pub right: DVector<f64>,
    /// `rᵀr`.
    pub cost: f64,
}

impl NormalEquations {
    /// Equations without residuals.
    pub fn zeros(width: usize) -> Self {
        Self { matrix: DMatrix::zeros(width, width), right: DVector::zeros(width), cost: 0.0 }
    }

    /// Adds one residual with its derivatives. Only the lower triangle is summed.
    pub fn add(&mut self, derivatives: &[f64], residual: f64) {
        for (i, a) in derivatives.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            self.right[i] += a * residual;
            for (j, b) in derivatives[..=i].iter().enumerate() {
                self.matrix[(i, j)] += a * b;
            }
        }
        self.cost += residual * residual;
    }

    /// Adds position and rotation of a pose, with a weight each; 0 excludes them.
    pub fn add_pose(&mut self, derivatives: &[Derivative], residual: [Vec3; 2], weights: [f64; 2]) {
        let mut row = vec![0.0; derivatives.len()];
        for (kind, weight) in weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0) {
            for axis in 0..3 {
                let own = derivatives.iter().map(|derivative| weight * derivative[kind][axis]);
                row.iter_mut().zip(own).for_each(|(value, own)| *value = own);
                self.add(&row, weight * residual[kind][axis]);
            }
        }
    }
}

pub(crate) trait LeastSquares {
    type State;

    /// `None` if the state is not valid.
    fn linearize(&self, state: &Self::State) -> Option<NormalEquations>;

    /// State after a step.
    fn moved(&self, state: &Self::State, step: &[f64]) -> Self::State;
}

/// When to stop.
#[derive(Clone, Copy)]
pub(crate) struct Limits {
    pub steps: usize,
    /// Predicted relative decrease of the cost by a step.
    pub min_gain: f64,
}

/// State with the lowest cost found from `start`, and that cost. Directions that the residuals do not determine stay
/// at the start. `None` if the start is not valid.
pub(crate) fn minimize<P: LeastSquares>(
    problem: &P,
    start: P::State,
    limits: Limits,
) -> Option<(f64, P::State)> {
    /// Relative to the diagonal.
    const MIN_DAMPING: f64 = 1e-6;
    const MAX_DAMPING: f64 = 1e3;
    const DAMPING_FACTOR: f64 = 10.0;
    let mut state = start;
    let mut here = problem.linearize(&state)?;
    let mut damping = MIN_DAMPING;
    // Below it, residuals are rounding errors.
    let min_cost = f64::EPSILON * here.cost;
    for _ in 0..limits.steps {
        let mut damped = here.matrix.clone();
        for i in 0..damped.nrows() {
            damped[(i, i)] += damping * damped[(i, i)] + f64::MIN_POSITIVE;
        }
        let step = damped.cholesky().map(|cholesky| cholesky.solve(&here.right));
        // The predicted decrease of the cost.
        if step.as_ref().is_some_and(|step| step.dot(&here.right) < limits.min_gain * here.cost) {
            break;
        }
        let next = step.and_then(|step| {
            let next = problem.moved(&state, step.as_slice());
            let there = problem.linearize(&next).filter(|there| there.cost < here.cost)?;
            Some((next, there))
        });
        match next {
            Some((next, there)) => {
                (state, here) = (next, there);
                damping = (damping / DAMPING_FACTOR).max(MIN_DAMPING);
            }
            None => damping *= DAMPING_FACTOR,
        }
        if damping > MAX_DAMPING || here.cost < min_cost {
            break;
        }
    }
    Some((here.cost, state))
}
