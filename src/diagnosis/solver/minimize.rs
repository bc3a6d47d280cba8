//! Levenberg–Marquardt for small nonlinear least-squares problems (Levenberg 1944, Marquardt 1963).

use crate::model::jacobian::Derivative;
use ground::geometry::Vec3;
use nalgebra::{DMatrix, DVector};

/// Relative to the diagonal.
const MIN_DAMPING: f64 = 1e-6;

/// Problem linearised about a state.
pub(crate) struct NormalEquations {
    /// Upper triangle of `AᵀA`.
    triangle: DMatrix<f64>,
    /// `Aᵀr`.
    right: DVector<f64>,
    /// `rᵀr`.
    cost: f64,
    /// Derivatives of a position or rotation.
    rows: [Vec<f64>; 3],
}

impl NormalEquations {
    /// From sums over all residuals; `matrix` gives the lower triangle of `AᵀA`.
    pub fn from_sums(
        matrix: impl Fn(usize, usize) -> f64,
        right: impl IntoIterator<Item = f64>,
        cost: f64,
    ) -> Self {
        let right = DVector::from_vec(right.into_iter().collect());
        let at = |j: usize, i: usize| if j <= i { matrix(i, j) } else { 0.0 };
        let triangle = DMatrix::from_fn(right.len(), right.len(), at);
        Self { triangle, rows: Default::default(), right, cost }
    }

    pub fn zeros(width: usize) -> Self {
        let triangle = DMatrix::zeros(width, width);
        Self { triangle, right: DVector::zeros(width), cost: 0.0, rows: Default::default() }
    }

    /// Adds one residual with its derivatives.
    pub fn add(&mut self, derivatives: &[f64], residual: f64) {
        let columns = self.triangle.as_mut_slice().chunks_exact_mut(self.right.len().max(1));
        for (i, (column, a)) in columns.zip(derivatives).enumerate() {
            if *a != 0.0 {
                self.right[i] += a * residual;
                column[..=i].iter_mut().zip(derivatives).for_each(|(sum, b)| *sum += a * b);
            }
        }
        self.cost += residual * residual;
    }

    /// Adds three residuals, in one pass over the sums.
    fn add_three(&mut self, [x, y, z]: [&[f64]; 3], residuals: [f64; 3]) {
        let columns = self.triangle.as_mut_slice().chunks_exact_mut(self.right.len().max(1));
        for (i, (column, ((a, b), c))) in columns.zip(x.iter().zip(y).zip(z)).enumerate() {
            if *a == 0.0 && *b == 0.0 && *c == 0.0 {
                continue;
            }
            let right = &mut self.right[i];
            *right = *right + a * residuals[0] + b * residuals[1] + c * residuals[2];
            for (((sum, x), y), z) in column[..=i].iter_mut().zip(x).zip(y).zip(z) {
                *sum = *sum + a * x + b * y + c * z;
            }
        }
        self.cost = residuals.iter().fold(self.cost, |sum, residual| sum + residual * residual);
    }

    /// Adds position and rotation of a pose, with a weight each; 0 excludes them.
    pub fn add_pose(&mut self, derivatives: &[Derivative], residual: [Vec3; 2], weights: [f64; 2]) {
        let mut rows = std::mem::take(&mut self.rows);
        for (kind, weight) in weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0) {
            for (axis, row) in rows.iter_mut().enumerate() {
                row.clear();
                row.extend(derivatives.iter().map(|derivative| weight * derivative[kind][axis]));
            }
            self.add_three(rows.each_ref().map(Vec::as_slice), (weight * residual[kind]).into());
        }
        self.rows = rows;
    }

    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Cost after the least-squares step of these parameters alone. Infinite if the residuals do not determine them.
    pub fn cost_after(&self, parameters: &[usize]) -> f64 {
        let right = DVector::from_fn(parameters.len(), |i, _| self.right[parameters[i]]);
        let step = self.solve(parameters, &right, MIN_DAMPING);
        step.map_or(f64::INFINITY, |step| self.cost - right.dot(&step))
    }

    /// Step with each diagonal entry increased by the share `damping`.
    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let all: Vec<usize> = (0..self.right.len()).collect();
        self.solve(&all, &self.right, damping)
    }

    /// Step of these parameters, ascending.
    fn solve(
        &self,
        parameters: &[usize],
        right: &DVector<f64>,
        damping: f64,
    ) -> Option<DVector<f64>> {
        let width = parameters.len();
        let at = |i: usize, j: usize| self.triangle[(parameters[i.min(j)], parameters[i.max(j)])];
        let mut matrix = DMatrix::from_fn(width, width, at);
        for i in 0..width {
            matrix[(i, i)] += damping * matrix[(i, i)] + f64::MIN_POSITIVE;
        }
        matrix.cholesky().map(|cholesky| cholesky.solve(right))
    }
}

pub(crate) trait LeastSquares {
    type State;

    /// `None` if the state is not valid.
    fn linearize(&self, state: &Self::State) -> Option<NormalEquations>;

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
    const MAX_DAMPING: f64 = 1e3;
    const DAMPING_FACTOR: f64 = 10.0;
    let mut state = start;
    let mut here = problem.linearize(&state)?;
    let mut damping = MIN_DAMPING;
    // Below it, residuals are rounding errors.
    let min_cost = f64::EPSILON * here.cost;
    for _ in 0..limits.steps {
        let step = here.step(damping);
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
