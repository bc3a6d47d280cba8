//! Levenberg–Marquardt for small nonlinear least-squares problems (Levenberg 1944, Marquardt 1963).

use super::linear::Normal;
use crate::model::jacobian::Derivative;
use ground::geometry::Vec3;

/// Relative to the diagonal.
pub(crate) const MIN_DAMPING: f64 = 1e-6;

/// Sums over the poses of a problem linearised about a state.
pub(crate) struct PoseSums {
    /// Of the matrix, the upper triangle.
    normal: Normal,
    /// Derivatives of a position or rotation.
    rows: [Vec<f64>; 3],
}

impl PoseSums {
    pub fn new(width: usize) -> Self {
        Self { normal: Normal::zeros(width), rows: Default::default() }
    }

    /// Adds position and rotation of a pose, with a weight each; 0 excludes them.
    pub fn add(&mut self, derivatives: &[Derivative], residual: [Vec3; 2], weights: [f64; 2]) {
        for (kind, weight) in weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0) {
            for (axis, row) in self.rows.iter_mut().enumerate() {
                row.clear();
                row.extend(derivatives.iter().map(|derivative| weight * derivative[kind][axis]));
            }
            self.add_rows((weight * residual[kind]).into());
        }
    }

    /// Adds three residuals, in one pass over the sums.
    fn add_rows(&mut self, residuals: [f64; 3]) {
        let Normal { matrix, right, cost, .. } = &mut self.normal;
        let [x, y, z] = self.rows.each_ref().map(Vec::as_slice);
        let columns = matrix.as_mut_slice().chunks_exact_mut(right.len().max(1));
        for (i, (column, ((a, b), c))) in columns.zip(x.iter().zip(y).zip(z)).enumerate() {
            if *a == 0.0 && *b == 0.0 && *c == 0.0 {
                continue;
            }
            let right = &mut right[i];
            *right = *right + a * residuals[0] + b * residuals[1] + c * residuals[2];
            for (((sum, x), y), z) in column[..=i].iter_mut().zip(x).zip(y).zip(z) {
                *sum = *sum + a * x + b * y + c * z;
            }
        }
        *cost = residuals.iter().fold(*cost, |sum, residual| sum + residual * residual);
    }

    pub fn normal(mut self) -> Normal {
        self.normal.matrix.fill_lower_triangle_with_upper_triangle();
        self.normal
    }
}

pub(crate) trait LeastSquares {
    type State;

    /// `None` if the state is not valid.
    fn linearize(&self, state: &Self::State) -> Option<Normal>;

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
        let step = here.damped_step(damping);
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
