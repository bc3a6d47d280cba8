//! Alternative encodings of a target's poses. The camera's mount absorbs a common rotation of all axes.
//! Observable are positions in other axes than rotations, transposed or misinterpreted rotations, and
//! scaled positions.

use super::decoded_target::{TargetEncoding, TargetScaleError};
use super::start::{angle_difference, solve_closed_form_quick};
use super::target_scale::estimate_scale_error;
use super::{CameraMount, HandEyeSolution, HandEyeStreams, solve};
use ground::geometry::{Axes, QuaternionOrderError, misinterpretation_classes};

/// Relative to the logged encoding.
const MAX_RESIDUAL_RATIO: f64 = 1.0 / 3.0;
const MAX_POSES: usize = 80;
/// Noise of the best detectors; smaller closure errors need no other encoding.
const MAX_CLOSURE_M_RAD: (f64, f64) = (1.5e-3, 0.15 * std::f64::consts::PI / 180.0);

/// `None` if the chain closes as logged or no encoding is much better.
pub(super) fn better_encoding(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<(TargetEncoding, HandEyeSolution)> {
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
    let misfit = |one: &(TargetEncoding, HandEyeSolution)| one.1.misfit_rad;
    best.into_iter().flatten().min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
}

fn much_better_scale(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<(TargetEncoding, HandEyeSolution)> {
    /// Ratio to the logged excess error and to the corrected total.
    const MAX_EXCESS_RATIO: f64 = 0.5;
    let with = |stretch: TargetScaleError| {
        let encoding = TargetEncoding::Scaled(stretch);
        Some((encoding, solve(streams, encoding, lag_s)?))
    };
    let at = |one: &HandEyeSolution| estimate_scale_error(streams, one.mount, one.offset_s.value);
    // A large scale error biases the time offset, so repeat at the corrected one.
    let (_, first) = with(at(as_logged)?)?;
    let (encoding, solution) = with(at(&first)?)?;
    let (excess_m, was_m) = (solution.closure.excess_m.value, as_logged.closure.excess_m.value);
    let closes =
        excess_m < MAX_EXCESS_RATIO * was_m && excess_m < MAX_EXCESS_RATIO * solution.closure.rms_m;
    closes.then_some((encoding, solution))
}

fn alternative_encoding(
    streams: &HandEyeStreams,
    as_logged: &HandEyeSolution,
    lag_s: f64,
) -> Option<(TargetEncoding, HandEyeSolution)> {
    let logged_misfit = closure_error_with(streams, TargetEncoding::AsLogged, lag_s)?;
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
    closes.then_some((encoding, solution))
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
    let as_logged = difference_of(TargetEncoding::AsLogged);
    if as_logged < MAX_ANGLE_DIFFERENCE_RAD {
        let mut same_angles = vec![
            TargetEncoding::Transposed,
            TargetEncoding::QuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw),
            TargetEncoding::QuaternionOrder(QuaternionOrderError::XyzwReadAsWxyz),
        ];
        let others = Axes::all().iter().filter(|axes| **axes != Axes::STANDARD);
        same_angles.extend(others.copied().map(TargetEncoding::Axes));
        return same_angles;
    }
    let encodings = misinterpretation_classes().iter().map(TargetEncoding::Misinterpreted);
    let mut differences: Vec<(f64, TargetEncoding)> =
        encodings.map(|encoding| (difference_of(encoding), encoding)).collect();
    differences.retain(|(difference, _)| *difference < MAX_RESIDUAL_RATIO * as_logged);
    differences.sort_by(|a, b| a.0.total_cmp(&b.0));
    differences.into_iter().take(MAX_ENCODINGS).map(|(_, encoding)| encoding).collect()
}
