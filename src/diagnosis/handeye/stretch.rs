//! Scale errors of a target's positions. A wrong tag size scales all coordinates; a wrong focal length
//! scales only depth.
//!
//! For a known camera rotation the model is linear in camera, constant and both factors: `R_c·t_x − t_y +
//! a·R_c·R_x·t + d·R_c·R_x·t_z·z = −t_c`.

use super::reading::DecodedTarget;
use super::series::{HandEyeSetting, PosePair, mean_direction};
use super::start::quick_start;
use super::{CameraMount, FIT_POSES, HandEyeStreams};
use ground::geometry::{Rotation, Vec3};
use ground::stats::{Measured, median};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Scale errors of a target's positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetScaleError {
    /// Factor by which all positions are too long; 1 if the target size is right.
    pub size: Option<Measured>,
    /// Additional factor by which the depth is too long; 1 if the focal length is right.
    pub depth: Option<Measured>,
    /// Index of the depth coordinate: 0 to 2.
    pub along: usize,
    /// Whether either factor alone explains this motion almost equally well.
    pub is_either: bool,
}

impl TargetScaleError {
    /// Corrects a logged position.
    pub fn mended(&self, xyz: Vec3) -> Vec3 {
        let factor = |of: &Option<Measured>| of.map_or(1.0, |of| of.value);
        let mut xyz = xyz / factor(&self.size);
        xyz[self.along] /= factor(&self.depth);
        xyz
    }
}

/// Columns: camera, constant, common factor, additional depth factor.
const WIDTH: usize = 8;
const SIZE: usize = 6;
const DEPTH: usize = 7;

/// Fit with some factors free.
struct ScaleFit {
    /// Common factor, and additional depth factor.
    factors: [f64; 2],
    /// Standard errors of the factors.
    errors: [f64; 2],
    /// Median residual, m.
    left_m: f64,
    dof: f64,
}

/// Scale of the positions of a target with delay `offset_s`. Prefers one factor if it fits as well as two.
/// `None` if no factor reduces the closure error substantially.
pub(super) fn stretch(
    streams: &HandEyeStreams,
    mount: CameraMount,
    offset_s: f64,
) -> Option<TargetScaleError> {
    /// Minimum residual without a factor, relative to the selected model.
    const WORSE: f64 = 1.4;
    /// Maximum residual with one factor, relative to that with two.
    const AS_LITTLE: f64 = 1.12;
    /// Minimum deviation of a factor from 1, in standard errors and as a value. Lens distortion reaches the
    /// latter.
    const SURE: f64 = 5.0;
    const LEAST: f64 = 2e-3;
    let target = DecodedTarget::as_logged(streams.target, FIT_POSES);
    let setting = HandEyeSetting::new(streams.hand, target.poses(), mount);
    let pairs = setting.pairs_at(offset_s, FIT_POSES);
    let rotation = quick_start(&pairs)?.camera.rotation;
    let along = Vec3::from(mean_direction(streams.target)).iamax();
    let tried = |free: &[usize]| solved(&pairs, &rotation, along, free);
    let neither = tried(&[])?;
    let (of_size, of_depth, of_both) = (tried(&[SIZE])?, tried(&[DEPTH])?, tried(&[SIZE, DEPTH])?);
    let does = |one: &ScaleFit| one.left_m <= AS_LITTLE * of_both.left_m.max(f64::MIN_POSITIVE);
    let is_either = does(&of_size) && does(&of_depth);
    let is_size = does(&of_size) && (!does(&of_depth) || of_size.left_m <= of_depth.left_m);
    let (chosen, has_size, has_depth) = match (is_size, does(&of_depth)) {
        (true, _) => (of_size, true, false),
        (false, true) => (of_depth, false, true),
        (false, false) => (of_both, true, true),
    };
    if neither.left_m < WORSE * chosen.left_m {
        return None;
    }
    let ([all, more], [all_error, more_error]) = (chosen.factors, chosen.errors);
    let measured = |value: f64, std_error: f64| Measured { value, std_error, dof: chosen.dof };
    let size = measured(1.0 / all, all_error / (all * all));
    let depth = measured(all / (all + more), more_error * all / (all + more).powi(2));
    let is_sure = |one: &Measured| {
        one.value.is_finite()
            && one.value > 0.0
            && (one.value - 1.0).abs() > (SURE * one.std_error).max(LEAST)
    };
    let found = TargetScaleError {
        size: Some(size).filter(|one| has_size && is_sure(one)),
        depth: Some(depth).filter(|one| has_depth && is_sure(one)),
        along,
        is_either,
    };
    (found.size.is_some() || found.depth.is_some()).then_some(found)
}

/// Least squares of the chain's positions with the factors in `free`, with Cauchy weights.
fn solved(
    pairs: &[PosePair],
    rotation: &Rotation,
    along: usize,
    free: &[usize],
) -> Option<ScaleFit> {
    const ROUNDS: usize = 4;
    let columns: Vec<usize> = (0..SIZE).chain(free.iter().copied()).collect();
    let rows: Vec<(DMatrix<f64>, Vec3)> = pairs
        .iter()
        .map(|PosePair { carrier, target }| {
            let turned = carrier.rotation.to_rotation_matrix();
            let seen = target.translation.vector;
            let deep = Vec3::ith(along, seen[along]);
            let [seen, deep] = [seen, deep].map(|xyz| carrier.rotation * (rotation * xyz));
            let mut row = DMatrix::zeros(3, WIDTH);
            row.view_mut((0, 0), (3, 3)).copy_from(turned.matrix());
            row.view_mut((0, 3), (3, 3)).copy_from(&-Matrix3::identity());
            row.view_mut((0, SIZE), (3, 1)).copy_from(&seen);
            row.view_mut((0, DEPTH), (3, 1)).copy_from(&deep);
            let mut right = -carrier.translation.vector;
            if !free.contains(&SIZE) {
                right -= seen;
            }
            (row.select_columns(&columns), right)
        })
        .collect();
    let width = columns.len();
    let mut weights = vec![1.0; rows.len()];
    let mut found = DVector::zeros(width);
    let (mut inverse, mut left_m) = (DMatrix::zeros(width, width), f64::INFINITY);
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (DMatrix::zeros(width, width), DVector::zeros(width));
        for ((row, value), &weight) in rows.iter().zip(&weights) {
            normal += row.tr_mul(row) * weight;
            right += row.tr_mul(value) * weight;
        }
        for i in 0..SIZE {
            normal[(i, i)] += 1e-9 * rows.len() as f64;
        }
        inverse = normal.cholesky()?.inverse();
        found = &inverse * right;
        let off: Vec<f64> = rows.iter().map(|(row, value)| (row * &found - value).norm()).collect();
        left_m = median(&mut off.clone())?;
        let scale = (2.0 * left_m).max(1e-9);
        weights = off.iter().map(|off| 1.0 / (1.0 + (off / scale).powi(2))).collect();
    }
    // The median length of three normal components is 1.5382 standard deviations.
    let sigma_m = left_m / 1.5382;
    let of = |column: usize, fixed: f64| match columns.iter().position(|&own| own == column) {
        Some(at) => (found[at], sigma_m * inverse[(at, at)].max(0.0).sqrt()),
        None => (fixed, 0.0),
    };
    let ((all, all_error), (more, more_error)) = (of(SIZE, 1.0), of(DEPTH, 0.0));
    let dof = (3 * rows.len()).saturating_sub(width).max(3) as f64;
    Some(ScaleFit { factors: [all, more], errors: [all_error, more_error], left_m, dof })
}
