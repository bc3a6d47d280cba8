//! Encodings of a target's poses, and the one with which the chain closes. The camera's mount absorbs a common rotation
//! of all axes. Observable are positions in other axes than rotations, transposed or misinterpreted rotations, and
//! scaled positions: a wrong tag size scales all coordinates, a wrong focal length only depth.

use super::series::{HandEyeSetting, mean_direction};
use super::start::{
    DEPTH_COLUMN, MEDIAN_NORMAL_LENGTH, SIZE_COLUMN, angle_difference, fit_positions,
    solve_closed_form_quick,
};
use super::{CameraMount, HandEyeSolution, HandEyeStreams, MAX_FIT_POSES, solve};
use crate::PoseEncoding;
use crate::encodings::rotation::simple_encodings;
use ground::geometry::{Axes, Pose, Rotation, Vec3, misinterpretation_classes, pose};
use ground::stats::Measured;
use ground::stats::thin::thinned;

/// Relative to the logged encoding.
const MAX_RESIDUAL_RATIO: f64 = 1.0 / 3.0;
const MAX_POSES: usize = 80;
/// Noise of the best detectors; smaller closure errors need no other encoding.
const MAX_CLOSURE_M_RAD: (f64, f64) = (1.5e-3, 0.15 * std::f64::consts::PI / 180.0);

/// Encoding of a target's poses.
#[derive(Clone, Copy, Debug)]
pub enum TargetEncoding {
    /// Rotations have this encoding.
    Rotations(PoseEncoding),
    /// Positions and rotations use different axes: those of the positions, if the rotations use the standard ones.
    Axes(Axes),
    /// Positions are scaled.
    Scaled(TargetScaleError),
}

/// Scale errors of a target's positions, as factors by which they are too long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetScaleError {
    /// Common factor; 1 if the size is right.
    pub size: Option<Measured>,
    /// Additional depth factor; 1 if the focal length is right.
    pub depth: Option<Measured>,
    /// Depth coordinate: 0 to 2.
    pub along: usize,
    /// Whether either factor alone explains the motion almost equally well.
    pub is_either: bool,
}

impl TargetScaleError {
    /// Corrects a logged position.
    pub fn correct(&self, xyz: Vec3) -> Vec3 {
        let factor = |of: &Option<Measured>| of.map_or(1.0, |of| of.value);
        let mut xyz = xyz / factor(&self.size);
        xyz[self.along] /= factor(&self.depth);
        xyz
    }
}

impl<'a> HandEyeStreams<'a> {
    /// Hand and decoded target, thinned to about `most` poses.
    pub(super) fn setting(
        &self,
        encoding: TargetEncoding,
        mount: CameraMount,
        most: usize,
    ) -> HandEyeSetting<'a> {
        let mut truths = Vec::new();
        let stamped = thinned(self.target.t_s.iter().zip(&self.target.poses), most);
        let poses = stamped.map(|(&t_s, pose)| (t_s, encoding.decode(pose, &mut truths)));
        HandEyeSetting::new(self.hand, poses, mount)
    }
}

impl TargetEncoding {
    pub(super) const AS_LOGGED: Self = Self::Rotations(PoseEncoding::AsLogged);

    /// `truths` is a scratch buffer.
    fn decode(&self, logged: &Pose, truths: &mut Vec<Rotation>) -> Pose {
        let (xyz, rotation) = (logged.translation.vector, logged.rotation);
        match self {
            Self::Axes(axes) => pose(axes.to_standard(xyz).into(), rotation),
            Self::Rotations(encoding) => {
                encoding.true_rotations(&rotation, truths);
                pose(xyz.into(), truths.first().copied().unwrap_or(rotation))
            }
            Self::Scaled(stretch) => pose(stretch.correct(xyz).into(), rotation),
        }
    }
}

/// `None` if the chain closes as logged or no encoding is much better.
pub(super) fn better_encoding(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<HandEyeSolution> {
    let closure = &as_logged.closure;
    if closure.excess_m.value < MAX_CLOSURE_M_RAD.0
        && closure.excess_rad.value < MAX_CLOSURE_M_RAD.1
    {
        return None;
    }
    let best = [
        much_better_scale(streams, as_logged, lag_s),
        alternative_encoding(streams, as_logged, lag_s),
    ];
    best.into_iter().flatten().min_by(|a, b| a.misfit_rad.total_cmp(&b.misfit_rad))
}

fn much_better_scale(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<HandEyeSolution> {
    /// Ratio to the logged excess error and to the corrected total.
    const MAX_EXCESS_RATIO: f64 = 0.5;
    let with_scale_of = |one: &HandEyeSolution| {
        let stretch = estimate_scale_error(streams, one.mount, one.offset_s.value)?;
        solve(streams, TargetEncoding::Scaled(stretch), lag_s)
    };
    // A large scale error biases the time offset, so repeat at the corrected one.
    let solution = with_scale_of(&with_scale_of(as_logged)?)?;
    let (excess_m, was_m) = (solution.closure.excess_m.value, as_logged.closure.excess_m.value);
    let closes =
        excess_m < MAX_EXCESS_RATIO * was_m && excess_m < MAX_EXCESS_RATIO * solution.closure.rms_m;
    closes.then_some(solution)
}

fn alternative_encoding(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<HandEyeSolution> {
    let logged_misfit = closure_error_with(streams, TargetEncoding::AS_LOGGED, lag_s)?;
    let tried = candidates(streams, lag_s).into_iter();
    let tried = tried
        .filter_map(|encoding| Some((closure_error_with(streams, encoding, lag_s)?, encoding)));
    let (misfit, encoding) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
    if misfit > MAX_RESIDUAL_RATIO * logged_misfit {
        return None;
    }
    let solution = solve(streams, encoding, lag_s)?;
    let (found, logged) = (&solution.closure, &as_logged.closure);
    let errors = [(found.rms_m, logged.rms_m), (found.rms_rad, logged.rms_rad)];
    let closes = errors.iter().all(|(found, logged)| *found <= 1.1 * logged)
        && errors.iter().any(|(found, logged)| *found < MAX_RESIDUAL_RATIO * logged);
    closes.then_some(solution)
}

/// Uses the better mounting.
fn closure_error_with(
    streams: &HandEyeStreams,
    encoding: TargetEncoding,
    lag_s: f64,
) -> Option<f64> {
    let misfits = CameraMount::ALL.into_iter().filter_map(|mount| {
        let pairs = streams.setting(encoding, mount, MAX_POSES).pairs_at(lag_s, MAX_POSES);
        Some(solve_closed_form_quick(&pairs)?.0)
    });
    misfits.min_by(f64::total_cmp)
}

/// If the rotation angles match the hand's, only angle-preserving encodings; otherwise only those that make
/// them match.
fn candidates(streams: &HandEyeStreams, lag_s: f64) -> Vec<TargetEncoding> {
    /// Median of matching angles.
    const MAX_ANGLE_DIFFERENCE_RAD: f64 = 0.03;
    /// Encodings that improve the angles.
    const MAX_ENCODINGS: usize = 6;
    let difference_of = |encoding| {
        let setting = streams.setting(encoding, CameraMount::InHand, MAX_POSES);
        angle_difference(&setting.pairs_at(lag_s, MAX_POSES / 2))
    };
    let as_logged = difference_of(TargetEncoding::AS_LOGGED);
    if as_logged < MAX_ANGLE_DIFFERENCE_RAD {
        let others = Axes::all().iter().filter(|axes| **axes != Axes::STANDARD);
        let rotations = simple_encodings().filter(|one| *one != PoseEncoding::AsLogged);
        let rotations = rotations.map(TargetEncoding::Rotations);
        return rotations.chain(others.copied().map(TargetEncoding::Axes)).collect();
    }
    let encodings = misinterpretation_classes().iter().map(PoseEncoding::Misinterpreted);
    let encodings = encodings.map(TargetEncoding::Rotations);
    let mut differences: Vec<(f64, TargetEncoding)> =
        encodings.map(|encoding| (difference_of(encoding), encoding)).collect();
    differences.retain(|(difference, _)| *difference < MAX_RESIDUAL_RATIO * as_logged);
    differences.sort_by(|a, b| a.0.total_cmp(&b.0));
    differences.into_iter().take(MAX_ENCODINGS).map(|(_, encoding)| encoding).collect()
}

/// Prefers one factor if it fits as well as two. `None` if no factor reduces the closure error
/// substantially.
fn estimate_scale_error(
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
    let setting = streams.setting(TargetEncoding::AS_LOGGED, mount, MAX_FIT_POSES);
    let pairs = setting.pairs_at(offset_s, MAX_FIT_POSES);
    let (_, [camera, _]) = solve_closed_form_quick(&pairs)?;
    let along = Vec3::from(mean_direction(streams.target)).iamax();
    let tried = |factors: &[usize]| fit_positions(&pairs, &camera.rotation, along, factors);
    let (neither, both) = (tried(&[])?, [SIZE_COLUMN, DEPTH_COLUMN]);
    let of_both = tried(&both)?;
    let max_m = MAX_RESIDUAL_RATIO_ONE_FACTOR * of_both.residual_m.max(f64::MIN_POSITIVE);
    let mut alone = Vec::new();
    for factors in both.chunks(1) {
        alone.push((tried(factors)?, factors));
    }
    alone.retain(|(fit, _)| fit.residual_m <= max_m);
    let is_either = alone.len() == 2;
    let better = alone.into_iter().min_by(|a, b| a.0.residual_m.total_cmp(&b.0.residual_m));
    let (chosen, factors) = better.unwrap_or((of_both, &both));
    if neither.residual_m < MIN_RESIDUAL_RATIO * chosen.residual_m {
        return None;
    }
    let sigma_m = chosen.residual_m / MEDIAN_NORMAL_LENGTH;
    let [all_error, more_error] = both.map(|column| {
        let is_free = f64::from(factors.contains(&column));
        is_free * sigma_m * chosen.inverse[(column, column)].max(0.0).sqrt()
    });
    let (all, more) = (1.0 + chosen.values[SIZE_COLUMN], chosen.values[DEPTH_COLUMN]);
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
