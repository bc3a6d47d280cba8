//! Scale errors of a target's positions: a wrong tag size scales all coordinates, a wrong focal length only
//! depth.

use super::decoded_target::{TargetEncoding, TargetScaleError};
use super::series::mean_direction;
use super::start::{
    DEPTH_COLUMN, MEDIAN_NORMAL_LENGTH, PositionFit, SIZE_COLUMN, fit_positions,
    solve_closed_form_quick,
};
use super::{CameraMount, HandEyeStreams, MAX_FIT_POSES};
use ground::geometry::Vec3;
use ground::stats::Measured;

/// Prefers one factor if it fits as well as two. `None` if no factor reduces the closure error
/// substantially.
pub(super) fn estimate_scale_error(
    streams: &HandEyeStreams,
    mount: CameraMount,
    offset_s: f64,
) -> Option<TargetScaleError> {
    /// Without a factor, relative to the selected model.
    const MIN_RESIDUAL_RATIO: f64 = 1.4;
    /// With one factor, relative to two.
    const MAX_RESIDUAL_RATIO_ONE_FACTOR: f64 = 1.12;
    /// In standard errors and as a value, which lens distortion reaches.
    const MIN_STD_ERRORS: f64 = 5.0;
    const MIN_DEVIATION: f64 = 2e-3;
    let setting = streams.setting(TargetEncoding::AsLogged, mount, MAX_FIT_POSES);
    let pairs = setting.pairs_at(offset_s, MAX_FIT_POSES);
    let (_, [camera, _]) = solve_closed_form_quick(&pairs)?;
    let along = Vec3::from(mean_direction(streams.target)).iamax();
    let tried = |factors: &[usize]| fit_positions(&pairs, &camera.rotation, along, factors);
    let neither = tried(&[])?;
    let (of_size, of_depth, of_both) =
        (tried(&[SIZE_COLUMN])?, tried(&[DEPTH_COLUMN])?, tried(&[SIZE_COLUMN, DEPTH_COLUMN])?);
    let does = |one: &PositionFit| {
        one.residual_m <= MAX_RESIDUAL_RATIO_ONE_FACTOR * of_both.residual_m.max(f64::MIN_POSITIVE)
    };
    let is_either = does(&of_size) && does(&of_depth);
    let is_size = does(&of_size) && (!does(&of_depth) || of_size.residual_m <= of_depth.residual_m);
    let (chosen, factors): (PositionFit, &[usize]) = match (is_size, does(&of_depth)) {
        (true, _) => (of_size, &[SIZE_COLUMN]),
        (false, true) => (of_depth, &[DEPTH_COLUMN]),
        (false, false) => (of_both, &[SIZE_COLUMN, DEPTH_COLUMN]),
    };
    if neither.residual_m < MIN_RESIDUAL_RATIO * chosen.residual_m {
        return None;
    }
    let sigma_m = chosen.residual_m / MEDIAN_NORMAL_LENGTH;
    let factor = |column: usize, fixed: f64| match factors.contains(&column) {
        true => (chosen.values[column], sigma_m * chosen.inverse[(column, column)].max(0.0).sqrt()),
        false => (fixed, 0.0),
    };
    let (all, all_error) = factor(SIZE_COLUMN, 1.0);
    let (more, more_error) = factor(DEPTH_COLUMN, 0.0);
    let dof = (3 * pairs.len()).saturating_sub(SIZE_COLUMN + factors.len()).max(3) as f64;
    let measured = |value: f64, std_error: f64| Measured { value, std_error, dof };
    let size = measured(1.0 / all, all_error / (all * all));
    let depth = measured(all / (all + more), more_error * all / (all + more).powi(2));
    let is_precise = |one: &Measured| {
        one.value.is_finite()
            && one.value > 0.0
            && (one.value - 1.0).abs() > (MIN_STD_ERRORS * one.std_error).max(MIN_DEVIATION)
    };
    // A fixed factor is exactly 1, so it is not precise.
    let (size, depth) = (Some(size).filter(is_precise), Some(depth).filter(is_precise));
    let is_any = size.is_some() || depth.is_some();
    is_any.then_some(TargetScaleError { size, depth, along, is_either })
}
