//! Closure error of each pose, and its excess over the noise.

use super::fit::HandEyeFit;
use super::series::HandEyeSetting;
use super::{ClosureError, MIN_POSES};
use crate::residuals::excess::{excess_square, mean_of, square_root};
use crate::solver::noise::rms;
use ground::geometry::Vec3;
use ground::stats::{Measured, median};

/// For the standard error of the excess.
const BLOCKS: usize = 12;

/// `None` for fewer than [`MIN_POSES`] poses.
pub(super) fn closure_error(setting: &HandEyeSetting, fit: &HandEyeFit) -> Option<ClosureError> {
    let residuals = setting.targets.iter();
    let residuals: Vec<(f64, [Vec3; 2])> = residuals
        .filter_map(|(t_s, target)| Some((*t_s, fit.residual(setting, *t_s, target)?)))
        .collect();
    if residuals.len() < MIN_POSES {
        return None;
    }
    let near = residuals.iter().map(|(_, residuals)| residuals);
    let near: Vec<&[Vec3; 2]> = near.filter(|residuals| !fit.is_outlier(residuals)).collect();
    let (all, outliers) = (residuals.len(), residuals.len() - near.len());
    let of = |kind: usize| -> Vec<Vec3> { near.iter().map(|residuals| residuals[kind]).collect() };
    let medians = [0, 1].map(|kind| {
        let mut norms: Vec<f64> =
            residuals.iter().map(|(_, residuals)| residuals[kind].norm()).collect();
        median(&mut norms).unwrap_or(0.0)
    });
    Some(ClosureError {
        poses: all,
        outliers,
        rms_m: rms(&of(0)),
        rms_rad: rms(&of(1)),
        median_m: medians[0],
        median_rad: medians[1],
        excess_m: excess(&of(0)),
        excess_rad: excess(&of(1)),
        each: residuals.iter().map(|(t_s, [m, rad])| (*t_s, m.norm(), rad.norm())).collect(),
    })
}

/// Rms in excess of the sample-to-sample noise (half the mean squared successive difference, von Neumann
/// 1941). The standard error comes from the spread over blocks.
fn excess(vectors: &[Vec3]) -> Measured {
    let blocks = vectors.chunks((vectors.len() / BLOCKS).max(3)).filter(|block| block.len() >= 3);
    let beyond: Vec<f64> = blocks.map(excess_square).collect();
    if beyond.len() < 2 {
        return Measured { value: rms(vectors), std_error: f64::INFINITY, dof: 1.0 };
    }
    square_root(mean_of(&beyond))
}
