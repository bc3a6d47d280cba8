//! Directions of the link parameters that the logs do not determine.

use super::UndeterminedDirection;
use super::parameters::CalibrationParameters;
use super::workspace::TipSensitivity;
use nalgebra::{DMatrix, DVector};

/// Share of the prior variance, for a determined direction.
const MAX_VARIANCE_SHARE: f64 = 0.5;
/// Smaller ones are omitted from its description.
const MIN_COMPONENT: f64 = 0.3;

/// The least determined first.
pub(super) fn undetermined_directions(
    information: &DMatrix<f64>,
    parameters: &CalibrationParameters,
    link_m: f64,
    workspace: &TipSensitivity,
) -> Vec<UndeterminedDirection> {
    let (links, all) = (parameters.links.len(), parameters.width);
    let prior = parameters.prior(link_m);
    let mut of_links = information.view((0, 0), (links, links)).into_owned();
    if all > links {
        // Marginalise over the others.
        let mut rest = information.view((links, links), (all - links, all - links)).into_owned();
        (0..all - links).for_each(|i| rest[(i, i)] += prior[links + i]);
        let both = information.view((0, links), (links, all - links));
        if let Some(cholesky) = rest.cholesky() {
            of_links -= both * cholesky.solve(&both.transpose());
        }
    }
    let scale = prior.rows(0, links).map(|precision| precision.sqrt().recip());
    let scaled = DMatrix::from_fn(links, links, |i, j| of_links[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut found: Vec<UndeterminedDirection> = (0..links)
        .filter_map(|at| {
            let share = (1.0 + eigen.eigenvalues[at].max(0.0)).recip();
            let direction = eigen.eigenvectors.column(at);
            let mut parts: Vec<(usize, f64)> = direction.iter().copied().enumerate().collect();
            parts.retain(|(_, part)| part.abs() > MIN_COMPONENT);
            parts.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            let mut along = DVector::zeros(parameters.shared());
            (0..links).for_each(|i| along[i] = direction[i] * scale[i] * share.sqrt());
            (share > MAX_VARIANCE_SHARE).then(|| UndeterminedDirection {
                parts,
                share,
                effect_m: workspace.effect_m(&along),
            })
        })
        .collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
}
