//! Scale errors of a target's positions: a wrong tag size scales all coordinates, a wrong focal length only
//! depth.
//!
//! For a known camera rotation the model is linear: `R_c·t_x − t_y + a·R_c·R_x·t + d·R_c·R_x·t_z·z = −t_c`.

use super::decoded_target::{DecodedTarget, TargetScaleError};
use super::series::{HandEyeSetting, PosePair, mean_direction};
use super::start::solve_closed_form_quick;
use super::{CameraMount, HandEyeStreams, MAX_FIT_POSES};
use ground::geometry::{Rotation, Vec3};
use ground::stats::{Measured, median};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Columns: camera, constant, common factor, additional depth factor.
const WIDTH: usize = 8;
const SIZE_COLUMN: usize = 6;
const DEPTH_COLUMN: usize = 7;

struct ScaleFit {
    /// Common, and additional for depth.
    factors: [f64; 2],
    errors: [f64; 2],
    /// Median.
    residual_m: f64,
    dof: f64,
}

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
    let target = DecodedTarget::as_logged(streams.target, MAX_FIT_POSES);
    let setting = HandEyeSetting::new(streams.hand, target.poses(), mount);
    let pairs = setting.pairs_at(offset_s, MAX_FIT_POSES);
    let rotation = solve_closed_form_quick(&pairs)?.camera.rotation;
    let along = Vec3::from(mean_direction(streams.target)).iamax();
    let tried = |free: &[usize]| solve_with_factors(&pairs, &rotation, along, free);
    let neither = tried(&[])?;
    let (of_size, of_depth, of_both) =
        (tried(&[SIZE_COLUMN])?, tried(&[DEPTH_COLUMN])?, tried(&[SIZE_COLUMN, DEPTH_COLUMN])?);
    let does = |one: &ScaleFit| {
        one.residual_m <= MAX_RESIDUAL_RATIO_ONE_FACTOR * of_both.residual_m.max(f64::MIN_POSITIVE)
    };
    let is_either = does(&of_size) && does(&of_depth);
    let is_size = does(&of_size) && (!does(&of_depth) || of_size.residual_m <= of_depth.residual_m);
    let (chosen, has_size, has_depth) = match (is_size, does(&of_depth)) {
        (true, _) => (of_size, true, false),
        (false, true) => (of_depth, false, true),
        (false, false) => (of_both, true, true),
    };
    if neither.residual_m < MIN_RESIDUAL_RATIO * chosen.residual_m {
        return None;
    }
    let ([all, more], [all_error, more_error]) = (chosen.factors, chosen.errors);
    let measured = |value: f64, std_error: f64| Measured { value, std_error, dof: chosen.dof };
    let size = measured(1.0 / all, all_error / (all * all));
    let depth = measured(all / (all + more), more_error * all / (all + more).powi(2));
    let is_precise = |one: &Measured| {
        one.value.is_finite()
            && one.value > 0.0
            && (one.value - 1.0).abs() > (MIN_STD_ERRORS * one.std_error).max(MIN_DEVIATION)
    };
    let found = TargetScaleError {
        size: Some(size).filter(|one| has_size && is_precise(one)),
        depth: Some(depth).filter(|one| has_depth && is_precise(one)),
        along,
        is_either,
    };
    (found.size.is_some() || found.depth.is_some()).then_some(found)
}

/// Factors in `free`; Cauchy weights.
fn solve_with_factors(
    pairs: &[PosePair],
    rotation: &Rotation,
    along: usize,
    free: &[usize],
) -> Option<ScaleFit> {
    const ROUNDS: usize = 4;
    let columns: Vec<usize> = (0..SIZE_COLUMN).chain(free.iter().copied()).collect();
    let rows: Vec<(DMatrix<f64>, Vec3)> = pairs
        .iter()
        .map(|PosePair { carrier_pose, target }| {
            let turned = carrier_pose.rotation.to_rotation_matrix();
            let observed = target.translation.vector;
            let deep = Vec3::ith(along, observed[along]);
            let [observed, deep] =
                [observed, deep].map(|xyz| carrier_pose.rotation * (rotation * xyz));
            let mut row = DMatrix::zeros(3, WIDTH);
            row.view_mut((0, 0), (3, 3)).copy_from(turned.matrix());
            row.view_mut((0, 3), (3, 3)).copy_from(&-Matrix3::identity());
            row.view_mut((0, SIZE_COLUMN), (3, 1)).copy_from(&observed);
            row.view_mut((0, DEPTH_COLUMN), (3, 1)).copy_from(&deep);
            let mut right = -carrier_pose.translation.vector;
            if !free.contains(&SIZE_COLUMN) {
                right -= observed;
            }
            (row.select_columns(&columns), right)
        })
        .collect();
    let width = columns.len();
    let mut weights = vec![1.0; rows.len()];
    let mut found = DVector::zeros(width);
    let (mut inverse, mut residual_m) = (DMatrix::zeros(width, width), f64::INFINITY);
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (DMatrix::zeros(width, width), DVector::zeros(width));
        for ((row, value), &weight) in rows.iter().zip(&weights) {
            normal += row.tr_mul(row) * weight;
            right += row.tr_mul(value) * weight;
        }
        for i in 0..SIZE_COLUMN {
            normal[(i, i)] += 1e-9 * rows.len() as f64;
        }
        inverse = normal.cholesky()?.inverse();
        found = &inverse * right;
        let deviation: Vec<f64> =
            rows.iter().map(|(row, value)| (row * &found - value).norm()).collect();
        residual_m = median(&mut deviation.clone())?;
        let scale = (2.0 * residual_m).max(1e-9);
        weights =
            deviation.iter().map(|deviation| 1.0 / (1.0 + (deviation / scale).powi(2))).collect();
    }
    // The median length of three normal components is 1.5382 standard deviations.
    let sigma_m = residual_m / 1.5382;
    let of = |column: usize, fixed: f64| match columns.iter().position(|&own| own == column) {
        Some(at) => (found[at], sigma_m * inverse[(at, at)].max(0.0).sqrt()),
        None => (fixed, 0.0),
    };
    let ((all, all_error), (more, more_error)) = (of(SIZE_COLUMN, 1.0), of(DEPTH_COLUMN, 0.0));
    let dof = (3 * rows.len()).saturating_sub(width).max(3) as f64;
    Some(ScaleFit { factors: [all, more], errors: [all_error, more_error], residual_m, dof })
}
