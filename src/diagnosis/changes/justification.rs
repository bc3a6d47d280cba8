//! Decides whether change points explain enough of a run's residual.

use crate::ArmDiagnosis;
use crate::residuals::comparison::{excess_m, log_likelihood_gain, residual_m};
use crate::selection::model_selection::price;

/// For accepted change points.
pub(super) const MAX_RESIDUAL_RATIO: f64 = 0.5;
/// If the likelihood must also justify them, because the residual is mostly noise.
const MAX_RESIDUAL_RATIO_BY_LIKELIHOOD: f64 = 0.95;

/// Change points must halve the residual, or increase the likelihood by more than the price of their
/// parameters (after Chow 1960).
pub(super) fn is_justified(before: &ArmDiagnosis, after: &ArmDiagnosis, parameters: usize) -> bool {
    let [was, is] = [before, after].map(residual_m);
    if is <= MAX_RESIDUAL_RATIO * was {
        return true;
    }
    let (gain, independent) = log_likelihood_gain(before, after);
    let is_less = is <= MAX_RESIDUAL_RATIO_BY_LIKELIHOOD * was
        || excess_m(after) <= MAX_RESIDUAL_RATIO * excess_m(before);
    is_less && gain > price(independent) * parameters as f64
}
