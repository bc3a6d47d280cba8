//! Weights of residuals, and covariances that hold whatever their noise.

use ground::stats::{NORMAL, median};
use nalgebra::{DMatrix, DVector};

/// Eigenvalues of the scaled normal matrix below this are directions that the log does not show.
pub(super) const BLIND: f64 = 1e-9;

/// Residuals beyond this many standard deviations lose weight (Huber).
const HUBER: f64 = 3.0;

/// How each parameter moves with each score, `H⁻¹` over the directions that the log shows.
pub(super) fn influence(information: &DMatrix<f64>) -> DMatrix<f64> {
    pseudo_inverse(information).0
}

/// The sandwich covariance `H⁻¹ S H⁻¹`; infinite variances where the log does not show a parameter.
pub(super) fn sandwich(information: &DMatrix<f64>, scores: &DMatrix<f64>) -> DMatrix<f64> {
    let (inverse, blind) = pseudo_inverse(information);
    let mut covariance = &inverse * scores * &inverse;
    for (i, &share) in blind.iter().enumerate() {
        if share > 1e-3 {
            covariance[(i, i)] = f64::INFINITY;
        }
    }
    covariance
}

/// Huber weights of three-component residuals against their own robust spread.
pub(super) fn huber(residual: &[[f64; 3]], floor: f64) -> Vec<f64> {
    let limit = HUBER * robust_sigma(residual).max(floor) * 3f64.sqrt();
    residual
        .iter()
        .map(|r| {
            let norm = r.iter().map(|c| c * c).sum::<f64>().sqrt();
            if norm <= limit { 1.0 } else { limit / norm }
        })
        .collect()
}

/// Standard deviation of one component by the median magnitude of all.
pub(super) fn robust_sigma(residual: &[[f64; 3]]) -> f64 {
    let mut magnitudes: Vec<f64> = residual.iter().flatten().map(|c| c.abs()).collect();
    NORMAL * median(&mut magnitudes).unwrap_or(0.0)
}

/// Inverse on the directions that the log shows, and for each parameter the share of it (0 to 1)
/// that lies in directions that it does not.
pub(super) fn pseudo_inverse(matrix: &DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let n = matrix.nrows();
    let scale = DVector::from_fn(n, |i, _| {
        let diagonal = matrix[(i, i)];
        if diagonal > 0.0 { diagonal.sqrt().recip() } else { 0.0 }
    });
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(n, n);
    let mut blind: Vec<f64> = scale.iter().map(|&s| if s > 0.0 { 0.0 } else { 1.0 }).collect();
    for (k, &value) in eigen.eigenvalues.iter().enumerate() {
        let direction = eigen.eigenvectors.column(k);
        if value > BLIND {
            inverse += direction * direction.transpose() / value;
        } else {
            for i in 0..n {
                blind[i] += direction[i] * direction[i];
            }
        }
    }
    let inverse = DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]);
    (inverse, blind)
}
