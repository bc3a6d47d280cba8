//! Closure error of each pose, and its excess over the noise.

use super::fit::HandEyeFit;
use super::series::HandEyeSetting;
use super::start::median_of;
use super::{ClosureError, MIN_POSES};
use crate::residuals::excess::{excess_square, mean_of, square_root};
use crate::solver::noise::rms;
use ground::geometry::Vec3;
use ground::stats::Measured;

/// For the standard error of the excess.
const BLOCKS: usize = 12;

/// `None` for fewer than [`MIN_POSES`] poses.
pub(super) fn closure_error(setting: &HandEyeSetting, fit: &HandEyeFit) -> Option<ClosureError> {
    let all = setting
        .targets
        .iter()
        .filter_map(|(t_s, target)| Some((*t_s, fit.residual(setting, *t_s, target)?)));
    let all: Vec<(f64, [Vec3; 2])> = all.collect();
    if all.len() < MIN_POSES {
        return None;
    }
    let near = all.iter().filter(|(_, residuals)| !fit.is_outlier(residuals));
    let near = [0, 1].map(|kind| near.clone().map(|(_, it)| it[kind]).collect::<Vec<Vec3>>());
    let median = |kind: usize| median_of(all.iter().map(|(_, residuals)| residuals[kind].norm()));
    Some(ClosureError {
        poses: all.len(),
        outliers: all.len() - near[0].len(),
        rms_m: rms(&near[0]),
        rms_rad: rms(&near[1]),
        median_m: median(0),
        median_rad: median(1),
        excess_m: excess(&near[0]),
        excess_rad: excess(&near[1]),
        each: all.iter().map(|(t_s, [m, rad])| (*t_s, m.norm(), rad.norm())).collect(),
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
