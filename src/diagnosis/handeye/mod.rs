//! Hand-eye: a hand that an arm moves, a target that a camera sees, and whether the two can be of one
//! rigid setting.
//!
//! With the camera in the hand, `base_from_hand · X · camera_from_target` is the constant
//! `base_from_target`; with the camera fixed in the base and the target in the hand,
//! `base_from_hand⁻¹ · X · camera_from_target` is the constant `hand_from_target`. `X`, the pose of the
//! camera in what carries it, and that constant `Y` are both unknown. Both hypotheses have one shape,
//! `mount_from_camera = X`, `carrier · X · camera_from_target = Y`, where the carrier is the hand's pose
//! or its inverse, so one solver serves both.
//!
//! The steps: the lag at which hand and target turn alike; a first guess in closed form from relative
//! motions (`A X = X B`: Park and Martin, "Robot sensor calibration: solving AX = XB on the Euclidean
//! group", IEEE Trans. Robotics and Automation 10(5), 1994), from pairs of which both turn by the same
//! angle, as they must (Chen, "A screw motion approach to uniqueness analysis of head-eye geometry",
//! CVPR 1991); then Gauss–Newton over `X`, `Y` and the time offset, on robust weights.

mod closure;
mod diversity;
mod fit;
mod reading;
mod series;
mod start;
mod stretch;

use super::latency::{self, Peak, Speed};
use super::{FrameEstimate, Seen, Unseen};
use ground::geometry::{Pose, Vec3, angle_between, rotvec_from_rotation};
use ground::stats::{Length, Measured};

use closure::closure;
use diversity::diversity;
pub use fit::TargetScale;
use fit::{Fit, fit};
pub(super) use fit::{WIDTH, design};
pub use reading::TargetReading;
use reading::{ReadTarget, better_reading};
pub use series::PoseSeries;
use series::Setting;
pub use stretch::Stretch;

/// Poses that the fit uses; more are thinned out evenly.
pub(super) const FIT_POSES: usize = 500;
/// Poses of both streams that a fit needs at least.
const FEWEST: usize = 12;

/// Where the camera is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mount {
    /// The hand carries it, and the target is fixed in the base (eye in hand).
    InHand,
    /// It is fixed in the base, and the hand carries the target (eye to hand).
    InBase,
}

impl Mount {
    /// Both.
    pub const ALL: [Mount; 2] = [Mount::InHand, Mount::InBase];
}

/// A hand and a target.
#[derive(Clone, Copy, Debug)]
pub struct HandEyeStreams<'a> {
    /// `base_from_hand` over time.
    pub hand: &'a PoseSeries,
    /// `camera_from_target` over time.
    pub target: &'a PoseSeries,
    /// Standard error that aligning a foreign clock left between the two, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Where the log's frames say that the camera is: the mount, and `hand_from_camera` or
    /// `base_from_camera`.
    pub logged: Option<(Mount, Pose)>,
}

/// By how much the hand turns, and about what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diversity {
    /// The largest angle between two of its orientations, rad.
    pub span_rad: f64,
    /// How far its orientations are from their mean, rms rad.
    pub turning_rad: f64,
    /// The angle to the axis that it mostly turns about, rad, that 95 % of its turns stay within; 0
    /// to π/2.
    pub spread_rad: f64,
    /// The axis that it mostly turns about, in the hand.
    pub axis_in_hand: [f64; 3],
}

/// How far the chain is from closing.
#[derive(Clone, Debug, PartialEq)]
pub struct Closure {
    /// Target poses held against the chain, outliers with them.
    pub poses: usize,
    /// How many of them are outliers: off by more than six standard deviations of the rest.
    pub outliers: usize,
    /// Position, rms m, without the outliers.
    pub rms_m: f64,
    /// Rotation, rms rad, without the outliers.
    pub rms_rad: f64,
    /// Position, median m, of all poses.
    pub median_m: f64,
    /// Rotation, median rad, of all poses.
    pub median_rad: f64,
    /// Position beyond the noise from one pose to the next, rms m.
    pub excess_m: Measured,
    /// Rotation beyond the noise from one pose to the next, rms rad.
    pub excess_rad: Measured,
    /// Stamp (s from the run's origin), position (m) and rotation (rad) of each pose.
    pub each: Vec<(f64, f64, f64)>,
}

/// `X` as it was solved for.
#[derive(Clone, Debug)]
pub struct CameraPose {
    /// `hand_from_camera` or `base_from_camera`, by the mount.
    pub pose: Pose,
    /// Standard errors of its translation along its own axes, m; infinite where the motion does not
    /// show it.
    pub translation_error_m: [f64; 3],
    /// Standard errors of its rotation about its own axes, rad; infinite likewise.
    pub rotation_error_rad: [f64; 3],
    /// Length of its translation, m.
    pub distance_m: Measured,
    /// Angle of its rotation, rad.
    pub angle_rad: Measured,
}

/// Hand and eye under one hypothesis of where the camera is.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The hypothesis.
    pub mount: Mount,
    /// By what factor the other hypothesis leaves more; infinite where it could not be solved.
    pub ratio: f64,
    /// How late the target's stamps are against the hand's, s: what they say at *t* was true at
    /// *t − offset*.
    pub offset_s: Measured,
    /// The camera in what carries it.
    pub camera: CameraPose,
    /// The constant: `base_from_target` or `hand_from_target`.
    pub target: Pose,
    /// What is left of the poses that the fit uses, position and rotation together, rad.
    pub misfit_rad: f64,
    /// How far it is from closing.
    pub closure: Closure,
    /// The scale of the target's positions.
    pub scale: TargetScale,
}

/// All that was estimated on a hand and a target.
#[derive(Clone, Debug)]
pub struct HandEyeDiagnosis {
    /// How well the target turns as the hand does: the best correlation of their angular speeds.
    pub follows: Option<Peak>,
    /// How much the hand turns while the target is seen.
    pub diversity: Seen<Diversity>,
    /// The chain as logged.
    pub solution: Seen<Solution>,
    /// Another way to read the target's poses under which it closes far better, where there is one.
    pub reading: Option<(TargetReading, Solution)>,
    /// How late the target's stamps are against the hand's, s: that of the best solution, or why this
    /// motion does not show it.
    pub latency_s: Seen<Measured>,
    /// The pose of the camera against what the log's frames say, `logged_from_solved`.
    pub mount_error: Option<FrameEstimate>,
    /// Direction from the camera to the target, the mean in its axes.
    pub view: [f64; 3],
}

impl HandEyeDiagnosis {
    fn unseen(why: &Unseen) -> Self {
        Self {
            follows: None,
            diversity: Err(why.clone()),
            solution: Err(why.clone()),
            reading: None,
            latency_s: Err(why.clone()),
            mount_error: None,
            view: [0.0; 3],
        }
    }

    /// The solution that explains the log: that of the other reading where there is one.
    pub fn best(&self) -> Option<&Solution> {
        let read = self.reading.as_ref().map(|(_, solution)| solution);
        read.or(self.solution.as_ref().ok())
    }
}

/// The correlation of the angular speeds of a hand and a target and the lag of the target, best
/// first.
pub fn turning_peaks(hand: &PoseSeries, target: &PoseSeries, most_lag_s: f64) -> Vec<Peak> {
    let window_s = (2.5 * latency::median_period_s(&target.t_s)).clamp(0.25, 0.6);
    let speed = |series: &PoseSeries| -> Speed {
        latency::differenced(&series.t_s, window_s, |a, b| {
            angle_between(&series.poses[a].rotation, &series.poses[b].rotation)
        })
    };
    latency::peaks(&speed(hand), &speed(target), most_lag_s)
}

/// Estimates the time offset, the camera's pose and the closure of a hand and a target.
pub fn diagnose_hand_eye(streams: &HandEyeStreams, most_lag_s: f64) -> HandEyeDiagnosis {
    let HandEyeStreams { hand, target, .. } = *streams;
    if hand.overlap_s(target) <= 0.0 {
        return HandEyeDiagnosis::unseen(&Unseen::NoOverlap);
    }
    let peaks = turning_peaks(hand, target, most_lag_s);
    let lags = candidate_lags(&peaks);
    let as_logged = ReadTarget::as_logged(target, FIT_POSES);
    let lag_s = best_lag_s(hand, &as_logged, &lags);
    let seen = Setting::new(hand, as_logged.poses(), Mount::InHand);
    let have = seen.count_at(lag_s);
    let diversity = diversity(&seen, lag_s);
    let solution = match have {
        FEWEST.. => solve(streams, &as_logged, lag_s).ok_or(Unseen::NotExcited),
        _ => Err(Unseen::TooFewSamples { have, need: FEWEST }),
    };
    let reading = match &solution {
        Ok(solution) => better_reading(streams, solution, lag_s),
        Err(_) => None,
    };
    let mut diagnosis = HandEyeDiagnosis {
        follows: peaks.first().copied(),
        diversity: match have {
            FEWEST.. => Ok(diversity),
            _ => Err(Unseen::TooFewSamples { have, need: FEWEST }),
        },
        solution,
        reading,
        latency_s: Err(Unseen::NotExcited),
        mount_error: None,
        view: series::mean_direction(target),
    };
    diagnosis.mount_error = diagnosis.best().and_then(|best| mount_error(streams, best));
    diagnosis.latency_s = latency(streams, &diagnosis, &lags);
    diagnosis
}

/// How late the target is by the best solution; why that is not told where the target does not turn as
/// the hand does, where nothing moves while it is seen, or where another of `lags` closes the chain as
/// well.
fn latency(streams: &HandEyeStreams, found: &HandEyeDiagnosis, lags: &[f64]) -> Seen<Measured> {
    /// The target is not the hand's of whose turning the chain leaves more than this share.
    const FOLLOWS: f64 = 0.5;
    /// Another lag is as good that leaves less than so many times as much.
    const AS_GOOD: f64 = 2.0;
    let best = match (found.best(), &found.solution) {
        (Some(best), _) => best,
        (None, Err(why)) => return Err(why.clone()),
        (None, Ok(_)) => return Err(Unseen::NotExcited),
    };
    let turning_rad = found.diversity.as_ref().map_or(0.0, |diversity| diversity.turning_rad);
    if best.closure.rms_rad > FOLLOWS * turning_rad {
        let correlation = found.follows.map_or(0.0, |peak| peak.correlation);
        return Err(Unseen::DoesNotFollow(correlation));
    }
    if !best.offset_s.std_error.is_finite() {
        return Err(Unseen::AtRest);
    }
    let reading = found.reading.as_ref().map_or(TargetReading::AsLogged, |(reading, _)| *reading);
    let target = ReadTarget { reading, ..ReadTarget::as_logged(streams.target, FIT_POSES) };
    let apart_s = (4.0 * latency::median_period_s(&streams.target.t_s)).max(0.1);
    let is_other = |lag_s: &f64| (lag_s - best.offset_s.value).abs() > apart_s;
    let others = lags.iter().copied().chain([0.0]).filter(is_other).filter_map(|lag_s| {
        let other = solve(streams, &target, lag_s)?;
        let is_as_good = other.misfit_rad < AS_GOOD * best.misfit_rad;
        Some(other.offset_s.value).filter(|offset_s| is_as_good && is_other(offset_s))
    });
    let mut fitting: Vec<f64> = others.collect();
    if fitting.is_empty() {
        return Ok(best.offset_s);
    }
    fitting.push(best.offset_s.value);
    fitting.sort_by(f64::total_cmp);
    fitting.dedup_by(|a, b| (*a - *b).abs() < apart_s);
    Err(Unseen::Periodic(fitting))
}

/// The lags that are worth a try: that of the best correlation, and those of correlations near it.
fn candidate_lags(peaks: &[Peak]) -> Vec<f64> {
    /// So much less correlation may still be the right lag.
    const NEAR: f64 = 0.1;
    const MOST: usize = 3;
    /// Less is no more than chance, and no lag is as good.
    const SOME: f64 = 0.4;
    let Some(best) = peaks.first().filter(|peak| peak.correlation > SOME) else {
        return vec![0.0];
    };
    let near = peaks.iter().take_while(|peak| peak.correlation > best.correlation - NEAR);
    near.take(MOST).map(|peak| peak.lag_s).collect()
}

/// The lag under which the closed form closes best.
fn best_lag_s(hand: &PoseSeries, target: &ReadTarget, lags: &[f64]) -> f64 {
    let misfit = |lag_s: f64| {
        let misfits = Mount::ALL.map(|mount| {
            let setting = Setting::new(hand, target.poses(), mount);
            start::start(&setting.pairs_at(lag_s, start::POSES)).map_or(f64::MAX, |s| s.misfit)
        });
        misfits[0].min(misfits[1])
    };
    match lags {
        [only] => *only,
        lags => lags
            .iter()
            .map(|&lag_s| (misfit(lag_s), lag_s))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map_or(0.0, |(_, lag_s)| lag_s),
    }
}

/// Solves under both mounts and keeps the one that leaves less.
fn solve(streams: &HandEyeStreams, target: &ReadTarget, lag_s: f64) -> Option<Solution> {
    let fits = Mount::ALL.map(|mount| {
        let setting = Setting::new(streams.hand, target.poses(), mount);
        let start = start::start(&setting.pairs_at(lag_s, start::POSES))?;
        let fit = fit(&setting, start, lag_s)?;
        Some((mount, fit.misfit(), fit))
    });
    let mut fits: Vec<(Mount, f64, Fit)> = fits.into_iter().flatten().collect();
    fits.sort_by(|a, b| a.1.total_cmp(&b.1));
    let other = fits.get(1).map_or(f64::INFINITY, |other| other.1);
    let (mount, misfit, fit) = fits.into_iter().next()?;
    let full = ReadTarget { series: streams.target, reading: target.reading, stride: 1 };
    let closure = closure(&Setting::new(streams.hand, full.poses(), mount), &fit)?;
    let along = Vec3::from(series::mean_direction(streams.target)).iamax();
    let scale = fit.scale(&Setting::new(streams.hand, target.poses(), mount), along);
    let offset_s =
        Measured { std_error: fit.offset_s.std_error.hypot(streams.stamp_error_s), ..fit.offset_s };
    Some(Solution {
        mount,
        ratio: other / misfit.max(1e-9),
        offset_s,
        camera: fit.camera(),
        target: fit.constant,
        misfit_rad: misfit,
        closure,
        scale,
    })
}

/// The solved pose of the camera against the logged one, where both mounts are the same.
fn mount_error(streams: &HandEyeStreams, solution: &Solution) -> Option<FrameEstimate> {
    let (mount, logged) = streams.logged?;
    if mount != solution.mount {
        return None;
    }
    let camera = &solution.camera;
    let pose = logged.inverse() * camera.pose;
    let turned = rotvec_from_rotation(&pose.rotation);
    let of = |vector: [f64; 3], errors: [f64; 3]| {
        let covariance =
            nalgebra::DMatrix::from_fn(
                3,
                3,
                |i, j| {
                    if i == j { errors[i] * errors[i] } else { 0.0 }
                },
            );
        errors
            .iter()
            .all(|error| error.is_finite())
            .then(|| Length::of(&vector, &covariance, camera.distance_m.dof))
    };
    // Errors along the camera's axes as solved and as logged differ by a turn, which is small where
    // it matters.
    let length = of(pose.translation.vector.into(), camera.translation_error_m)?;
    let angle = of(turned.into(), camera.rotation_error_rad)?;
    Some(FrameEstimate {
        pose,
        translation_m: length.norm,
        rotation_rad: angle.norm,
        // Either of the two, by Bonferroni.
        p_value: (2.0 * length.p_value.min(angle.p_value)).min(1.0),
        chosen: true,
    })
}

#[cfg(test)]
mod tests;
