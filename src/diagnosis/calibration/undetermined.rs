//! Directions of the link parameters that the logs do not determine.

use super::UndeterminedDirection;
use super::parameters::CalibrationParameters;
use super::workspace::TipSensitivity;
use nalgebra::{DMatrix, DVector};

/// Share of the prior variance, for a determined direction.
const MAX_VARIANCE_SHARE: f64 = 0.5;
/// Smaller ones are omitted from its description.
const MIN_COMPONENT: f64 = 0.3;

/// The least determined first. `covariance` is that of the posterior with a prior of `link_m`.
pub(super) fn undetermined_directions(
    covariance: &DMatrix<f64>,
    parameters: &CalibrationParameters,
    link_m: f64,
    workspace: &TipSensitivity,
) -> Vec<UndeterminedDirection> {
    let links = parameters.links.len();
    let scale = parameters.prior(link_m).map(f64::sqrt);
    let relative = |i: usize, j: usize| covariance[(i, j)] * scale[i] * scale[j];
    let eigen = DMatrix::from_fn(links, links, relative).symmetric_eigen();
    let values = eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter());
    let undetermined = values.filter(|(share, _)| **share > MAX_VARIANCE_SHARE);
    let described = undetermined.map(|(share, direction)| {
        let share = share.min(1.0);
        let mut parts: Vec<(usize, f64)> = direction.iter().copied().enumerate().collect();
        parts.retain(|(_, part)| part.abs() > MIN_COMPONENT);
        parts.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let mut along = DVector::zeros(parameters.shared());
        (0..links).for_each(|i| along[i] = direction[i] / scale[i] * share.sqrt());
        UndeterminedDirection { parts, share, effect_m: workspace.effect_m(&along) }
    });
    let mut described: Vec<UndeterminedDirection> = described.collect();
    described.sort_by(|a, b| b.share.total_cmp(&a.share));
    described
}
