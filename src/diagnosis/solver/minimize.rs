//! Levenberg–Marquardt for small nonlinear least-squares problems (Levenberg 1944, Marquardt 1963).

use super::linear::Normal;

/// Relative to the diagonal.
pub(crate) const MIN_DAMPING: f64 = 1e-6;

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
