//! Hand-eye calibration: whether a hand moved by an arm and a target seen by a camera fit one rigid setup.
//!
//! With the camera in the hand, `base_from_hand · X · camera_from_target` is the constant
//! `base_from_target`. With the camera in the base, `base_from_hand⁻¹ · X · camera_from_target` is
//! `hand_from_target`. Both have the form `carrier · X · camera_from_target = Y` with `X =
//! mount_from_camera` and `Y` unknown, so one solver handles both:
//! 1. The lag between the rotations of hand and target.
//! 2. A closed-form solution from relative motions (`A X = X B`: Park and Martin, "Robot sensor
//!    calibration: solving AX = XB on the Euclidean group", IEEE Trans. Robotics and Automation 10(5),
//!    1994), from pairs with equal rotation angles (Chen, "A screw motion approach to uniqueness analysis
//!    of head-eye geometry", CVPR 1991).
//! 3. Gauss–Newton over `X`, `Y` and the time offset, with robust weights.

mod closure;
mod diversity;
mod fit;
mod series;
mod start;
mod target_encoding;

use crate::latency::correlation::{self, LagPeak, SpeedSeries};
use crate::{EstimateResult, FrameEstimate, NotObservable};
use ground::geometry::{Pose, Vec3, angle_between, rotvec_from_rotation};
use ground::stats::{Measured, MeasuredLength};
use nalgebra::{DMatrix, DVector};

use closure::closure_error;
use diversity::rotation_diversity;
pub use fit::TargetScale;
use fit::{HandEyeFit, fit};
pub(super) use fit::{WIDTH, design};
pub use series::PoseSeries;
use target_encoding::better_encoding;
pub use target_encoding::{TargetEncoding, TargetScaleError};

/// Longer streams are thinned evenly.
pub(super) const MAX_FIT_POSES: usize = 500;
const MIN_POSES: usize = 12;

/// Mounting of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraMount {
    /// Target fixed in the base (eye-in-hand).
    InHand,
    /// Target in the hand (eye-to-hand).
    InBase,
}

impl CameraMount {
    /// Both mountings.
    pub const ALL: [CameraMount; 2] = [CameraMount::InHand, CameraMount::InBase];
}

/// Input streams.
#[derive(Clone, Copy, Debug)]
pub struct HandEyeStreams<'a> {
    /// `base_from_hand` over time.
    pub hand: &'a PoseSeries,
    /// `camera_from_target` over time.
    pub target: &'a PoseSeries,
    /// Standard error of the clock alignment; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Logged `hand_from_camera` or `base_from_camera`, if any.
    pub logged: Option<(CameraMount, Pose)>,
}

/// Diversity of the hand's rotations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationDiversity {
    /// Largest angle between orientations.
    pub span_rad: f64,
    /// Rms angle to the mean orientation.
    pub turning_rad: f64,
    /// 95th percentile of the angle between rotation axes and principal axis; 0 to π/2.
    pub spread_rad: f64,
    /// Principal axis, in the hand.
    pub axis_in_hand: [f64; 3],
}

/// Closure error of the hand-eye chain. Rms values exclude outliers, medians do not.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosureError {
    /// Poses compared, including outliers.
    pub poses: usize,
    /// Errors beyond six standard deviations.
    pub outliers: usize,
    /// Position error.
    pub rms_m: f64,
    /// Rotation error.
    pub rms_rad: f64,
    /// Position error.
    pub median_m: f64,
    /// Rotation error.
    pub median_rad: f64,
    /// Rms beyond the pose-to-pose noise.
    pub excess_m: Measured,
    /// Rms beyond the pose-to-pose noise.
    pub excess_rad: Measured,
    /// Stamp (s from the run's origin), position error (m) and rotation error (rad) per pose.
    pub each: Vec<(f64, f64, f64)>,
}

/// Estimated camera pose `X`. Standard errors are infinite if not observable.
#[derive(Clone, Debug)]
pub struct CameraPose {
    /// `hand_from_camera` or `base_from_camera`.
    pub pose: Pose,
    /// Along the camera axes.
    pub translation_error_m: [f64; 3],
    /// About the camera axes.
    pub rotation_error_rad: [f64; 3],
    /// Translation's length.
    pub distance_m: Measured,
    /// Rotation angle.
    pub angle_rad: Measured,
}

/// Hand-eye solution for one mounting.
#[derive(Clone, Debug)]
pub struct HandEyeSolution {
    /// Encoding of the target's poses.
    pub encoding: TargetEncoding,
    /// Mounting of the camera.
    pub mount: CameraMount,
    /// Residual of the other mounting over this one's; infinite if it has no solution.
    pub ratio: f64,
    /// Target's delay relative to the hand: a sample stamped *t* was measured at *t − offset*.
    pub offset_s: Measured,
    /// Camera on its mount.
    pub camera: CameraPose,
    /// `base_from_target` or `hand_from_target`.
    pub target: Pose,
    /// Combined residual of the fit.
    pub misfit_rad: f64,
    /// Closure error.
    pub closure: ClosureError,
    /// Scale of the target's positions.
    pub scale: TargetScale,
}

/// Results of the hand-eye calibration.
#[derive(Clone, Debug)]
pub struct HandEyeDiagnosis {
    /// Best correlation of angular speeds.
    pub follows: Option<LagPeak>,
    /// Rotations while the target is visible.
    pub diversity: EstimateResult<RotationDiversity>,
    /// Solution for poses as logged.
    pub solution: EstimateResult<HandEyeSolution>,
    /// Solution for an encoding with a much smaller closure error, if any.
    pub alternative: Option<HandEyeSolution>,
    /// Target's delay relative to the hand by the best solution.
    pub latency_s: EstimateResult<Measured>,
    /// Deviation from the logged camera pose, `logged_from_solved`.
    pub mount_error: Option<FrameEstimate>,
    /// Mean direction camera to target, in camera axes.
    pub view: [f64; 3],
}

impl HandEyeDiagnosis {
    /// Alternative encoding's solution if there is one.
    pub fn best(&self) -> Option<&HandEyeSolution> {
        self.alternative.as_ref().or(self.solution.as_ref().ok())
    }
}

/// Correlation of the angular speeds over the target's lag, best first.
pub fn rotation_lag_peaks(hand: &PoseSeries, target: &PoseSeries, max_lag_s: f64) -> Vec<LagPeak> {
    let window_s = (2.5 * correlation::median_period_s(&target.t_s)).clamp(0.25, 0.6);
    let speed = |series: &PoseSeries| -> SpeedSeries {
        correlation::differenced_speed(&series.t_s, window_s, |a, b| {
            angle_between(&series.poses[a].rotation, &series.poses[b].rotation)
        })
    };
    correlation::lag_peaks(&speed(hand), &speed(target), max_lag_s)
}

/// Estimates time offset, camera pose and closure error.
pub fn diagnose_hand_eye(streams: &HandEyeStreams, max_lag_s: f64) -> HandEyeDiagnosis {
    let HandEyeStreams { hand, target, .. } = *streams;
    let overlaps = hand.overlap_s(target) > 0.0;
    let peaks = if overlaps { rotation_lag_peaks(hand, target, max_lag_s) } else { Vec::new() };
    let lags = candidate_lags(&peaks);
    let lag_s = best_lag_s(streams, &lags);
    let observed = streams.setting(TargetEncoding::AS_LOGGED, CameraMount::InHand, MAX_FIT_POSES);
    let diversity = match observed.pairs_at(lag_s, usize::MAX).len() {
        _ if !overlaps => Err(NotObservable::NoOverlap),
        MIN_POSES.. => Ok(rotation_diversity(&observed, lag_s)),
        have => Err(NotObservable::TooFewSamples { have, need: MIN_POSES }),
    };
    let solution = diversity.clone().and_then(|_| {
        solve(streams, TargetEncoding::AS_LOGGED, lag_s).ok_or(NotObservable::NotExcited)
    });
    let mut diagnosis = HandEyeDiagnosis {
        follows: peaks.first().copied(),
        diversity,
        alternative: solution.as_ref().ok().and_then(|it| better_encoding(streams, it, lag_s)),
        solution,
        latency_s: Err(NotObservable::NotExcited),
        mount_error: None,
        view: series::mean_direction(target),
    };
    diagnosis.mount_error = diagnosis.best().and_then(|best| mount_error(streams, best));
    diagnosis.latency_s = latency(streams, &diagnosis, &lags);
    diagnosis
}

/// Delay of the target by the best solution.
///
/// # Errors
/// If the target does not follow the hand, nothing moves while it is visible, or several of `lags` fit
/// equally well.
fn latency(
    streams: &HandEyeStreams,
    found: &HandEyeDiagnosis,
    lags: &[f64],
) -> EstimateResult<Measured> {
    /// Share of the hand's rotation, for a target that follows it.
    const MAX_RESIDUAL_SHARE: f64 = 0.5;
    /// Another lag with a smaller ratio to the best fits equally well.
    const MAX_RESIDUAL_RATIO: f64 = 2.0;
    let as_logged = found.solution.as_ref().map_err(Clone::clone)?;
    let best = found.alternative.as_ref().unwrap_or(as_logged);
    let turning_rad = found.diversity.as_ref().map_or(0.0, |diversity| diversity.turning_rad);
    if best.closure.rms_rad > MAX_RESIDUAL_SHARE * turning_rad {
        let correlation = found.follows.map_or(0.0, |peak| peak.correlation);
        return Err(NotObservable::DoesNotFollow(correlation));
    }
    if !best.offset_s.std_error.is_finite() {
        return Err(NotObservable::AtRest);
    }
    let min_separation_s = (4.0 * correlation::median_period_s(&streams.target.t_s)).max(0.1);
    let is_other = |lag_s: &f64| (lag_s - best.offset_s.value).abs() > min_separation_s;
    let others = lags.iter().copied().chain([0.0]).filter(is_other).filter_map(|lag_s| {
        let other = solve(streams, best.encoding, lag_s)?;
        let is_as_good = other.misfit_rad < MAX_RESIDUAL_RATIO * best.misfit_rad;
        Some(other.offset_s.value).filter(|offset_s| is_as_good && is_other(offset_s))
    });
    let mut fitting: Vec<f64> = others.collect();
    if fitting.is_empty() {
        return Ok(best.offset_s);
    }
    fitting.push(best.offset_s.value);
    fitting.sort_by(f64::total_cmp);
    fitting.dedup_by(|a, b| (*a - *b).abs() < min_separation_s);
    Err(NotObservable::Periodic(fitting))
}

/// Best correlation peak and those close to it.
fn candidate_lags(peaks: &[LagPeak]) -> Vec<f64> {
    /// Correlation below the best peak.
    const MAX_PEAK_DEFICIT: f64 = 0.1;
    const MAX_LAGS: usize = 3;
    /// Below it, only zero lag is tried.
    const MIN_CORRELATION: f64 = 0.4;
    let Some(best) = peaks.first().filter(|peak| peak.correlation > MIN_CORRELATION) else {
        return vec![0.0];
    };
    let near =
        peaks.iter().take_while(|peak| peak.correlation > best.correlation - MAX_PEAK_DEFICIT);
    near.take(MAX_LAGS).map(|peak| peak.lag_s).collect()
}

/// Smallest closure error of the closed form.
fn best_lag_s(streams: &HandEyeStreams, lags: &[f64]) -> f64 {
    let settings = CameraMount::ALL
        .map(|mount| streams.setting(TargetEncoding::AS_LOGGED, mount, MAX_FIT_POSES));
    let misfit = |lag_s: f64| {
        let starts = settings.each_ref().map(|setting| start::solve_closed_form(setting, lag_s));
        starts.into_iter().flatten().map(|start| start.0).fold(f64::MAX, f64::min)
    };
    let misfits = lags.iter().map(|&lag_s| (misfit(lag_s), lag_s));
    misfits.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, lag_s)| lag_s)
}

/// Solves for both mountings; the smaller residual wins.
fn solve(
    streams: &HandEyeStreams,
    encoding: TargetEncoding,
    lag_s: f64,
) -> Option<HandEyeSolution> {
    let fits = CameraMount::ALL.into_iter().filter_map(|mount| {
        let setting = streams.setting(encoding, mount, MAX_FIT_POSES);
        let (_, frames) = start::solve_closed_form(&setting, lag_s)?;
        fit(setting, frames, lag_s)
    });
    let mut fits: Vec<HandEyeFit> = fits.collect();
    fits.sort_by(|a, b| a.misfit().total_cmp(&b.misfit()));
    let other = fits.get(1).map_or(f64::INFINITY, HandEyeFit::misfit);
    let fit = fits.first()?;
    let (mount, misfit) = (fit.setting.mount, fit.misfit());
    let closure = closure_error(&streams.setting(encoding, mount, usize::MAX), fit)?;
    let along = Vec3::from(series::mean_direction(streams.target)).iamax();
    Some(HandEyeSolution {
        encoding,
        mount,
        ratio: other / misfit.max(1e-9),
        offset_s: fit.offset_s.with_error(streams.stamp_error_s),
        camera: fit.camera(),
        target: fit.state.constant,
        misfit_rad: misfit,
        closure,
        scale: fit.scale(along),
    })
}

/// `None` if the mountings differ.
fn mount_error(streams: &HandEyeStreams, solution: &HandEyeSolution) -> Option<FrameEstimate> {
    let (_, logged) = streams.logged.filter(|(mount, _)| *mount == solution.mount)?;
    let camera = &solution.camera;
    let pose = logged.inverse() * camera.pose;
    let turned = rotvec_from_rotation(&pose.rotation);
    let of = |vector: [f64; 3], errors: [f64; 3]| {
        let variances = DVector::from_column_slice(&errors.map(|error| error * error));
        let covariance = DMatrix::from_diagonal(&variances);
        let is_finite = errors.iter().all(|error| error.is_finite());
        is_finite.then(|| MeasuredLength::estimate(&vector, &covariance, camera.distance_m.dof))
    };
    // The errors are in the axes of the estimated camera: nearly the logged ones for any deviation of
    // interest.
    let length = of(pose.translation.vector.into(), camera.translation_error_m)?;
    let angle = of(turned.into(), camera.rotation_error_rad)?;
    Some(FrameEstimate {
        pose,
        translation_m: length.norm,
        rotation_rad: angle.norm,
        // Bonferroni, two tests.
        p_value: (2.0 * length.p_value.min(angle.p_value)).min(1.0),
        is_chosen: true,
    })
}

#[cfg(test)]
mod tests;
