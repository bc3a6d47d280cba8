//! Which directions of the links the logs do not tell: those of which no more is known than before.

use super::Untold;
use super::parameters::Parameters;
use super::workspace::Workspace;
use nalgebra::{DMatrix, DVector};

/// A direction is told where its variance is less than this share of what it was before.
const TOLD: f64 = 0.5;
/// Parameters that make up less than this of a direction are left out of it.
const PART: f64 = 0.3;

/// The directions that `information` does not tell, the least told first.
pub(super) fn untold(
    information: &DMatrix<f64>,
    parameters: &Parameters,
    link_m: f64,
    workspace: &Workspace,
) -> Vec<Untold> {
    let (links, all) = (parameters.links.len(), parameters.width());
    let prior = parameters.prior(link_m);
    let mut of_links = information.view((0, 0), (links, links)).into_owned();
    if all > links {
        // What the rest takes for itself says nothing of the links.
        let mut rest = information.view((links, links), (all - links, all - links)).into_owned();
        (0..all - links).for_each(|i| rest[(i, i)] += prior[links + i]);
        let both = information.view((0, links), (links, all - links));
        if let Some(cholesky) = rest.cholesky() {
            of_links -= both * cholesky.solve(&both.transpose());
        }
    }
    let scale = DVector::from_fn(links, |i, _| prior[i].sqrt().recip());
    let scaled = DMatrix::from_fn(links, links, |i, j| of_links[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut found: Vec<Untold> = (0..links)
        .filter_map(|at| {
            let share = (1.0 + eigen.eigenvalues[at].max(0.0)).recip();
            let direction = eigen.eigenvectors.column(at);
            let mut parts: Vec<(usize, f64)> = direction.iter().copied().enumerate().collect();
            parts.retain(|(_, part)| part.abs() > PART);
            parts.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
            let mut along = DVector::zeros(parameters.shared());
            (0..links).for_each(|i| along[i] = direction[i] * scale[i] * share.sqrt());
            (share > TOLD).then(|| Untold { parts, share, effect_m: workspace.effect_m(&along) })
        })
        .collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
}
