//! Robust weights, and covariances under correlated noise.

use ground::geometry::Vec3;
use ground::stats::{STD_DEV_PER_MEDIAN, median};
use nalgebra::{DMatrix, DVector};

/// Smaller ones, of the scaled normal matrix, are unobservable.
pub(crate) const MIN_OBSERVABLE_EIGENVALUE: f64 = 1e-9;

/// Larger residuals are downweighted.
const HUBER_SIGMAS: f64 = 3.0;

/// Sandwich covariance `H⁻¹ S H⁻¹`. Infinite variance if unobservable.
pub(crate) fn sandwich(information: &DMatrix<f64>, scores: &DMatrix<f64>) -> DMatrix<f64> {
    let (inverse, blind) = pseudo_inverse(information);
    let mut covariance = &inverse * scores * &inverse;
    for (i, &share) in blind.iter().enumerate() {
        if share > 1e-3 {
            covariance[(i, i)] = f64::INFINITY;
        }
    }
    covariance
}

/// Huber weights relative to the robust standard deviation.
pub(crate) fn huber(residual: &[Vec3], floor: f64) -> Vec<f64> {
    let limit = HUBER_SIGMAS * robust_sigma(residual).max(floor) * 3f64.sqrt();
    let weight = |norm: f64| if norm <= limit { 1.0 } else { limit / norm };
    residual.iter().map(|residual| weight(residual.norm())).collect()
}

/// Standard deviation of one component, from the median magnitude.
pub(crate) fn robust_sigma(residual: &[Vec3]) -> f64 {
    let mut magnitudes: Vec<f64> =
        residual.iter().flat_map(|r| r.iter()).map(|c| c.abs()).collect();
    STD_DEV_PER_MEDIAN * median(&mut magnitudes).unwrap_or(0.0)
}

/// Rms of the smallest 90 %.
pub(crate) fn trimmed_rms(mut squares: Vec<f64>) -> f64 {
    squares.sort_unstable_by(f64::total_cmp);
    let kept = kept_samples(squares.len());
    (squares[..kept].iter().sum::<f64>() / kept.max(1) as f64).sqrt()
}

/// Number of samples in [`trimmed_rms`].
pub(crate) fn kept_samples(count: usize) -> usize {
    (9 * count).div_ceil(10)
}

/// Inverse over observable directions, and each parameter's share (0 to 1) in unobservable ones.
pub(crate) fn pseudo_inverse(matrix: &DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
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
        if value > MIN_OBSERVABLE_EIGENVALUE {
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
