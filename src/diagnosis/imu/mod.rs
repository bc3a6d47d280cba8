//! IMU on the arm: latency, mount, yaw drift and gyro bias.
//!
//! With orientation: `world_from_imu(s) = Rz(drift·(s − middle)) · world_from_base · FK(q(s − τ)) ·
//! link_from_imu`. World yaw and tilt are free; so is the mount if it is not logged or does not fit.
//! Without: `gyro(s) = link_from_imu⁻¹ · ω_FK(s − τ) + bias`, with ω the body rate of the link. `τ =
//! latency + skew·(s − middle)`, because an IMU often has its own clock. FK includes the estimated joint
//! offsets: an uncorrected wrist zero of 1° looks like 0.6 °/min of drift and 0.9° of mount error.

mod conventions;
mod effects;
mod estimates;
mod extension_tests;
mod gyro;
mod model;
mod orientation;
mod residual_check;
mod solve;
#[cfg(test)]
mod tests;
mod tilt;

use crate::encodings::reinterpret::decode_rotations;
use crate::frames::rotation_frames::mean_rotation;
use crate::latency::correlation::{
    ArmSpeeds, LagPeak, SpeedSeries, angular_speed, correlation_by_lag, equal_peaks, lag_peaks,
    norm_series,
};
use crate::samples::sampling::{FkSequence, REST_SIGMAS, rest_speeds};
use crate::{AxesError, EstimateResult, IntendedEncoding, NotObservable, PoseEncoding};
pub use conventions::{AccelUnit, AccelUnitError, GyroSaturation, ImuConventions};
pub use estimates::{
    GyroAxesRotation, GyroBias, GyroBiasChange, GyroBiasProfile, GyroScaleError, HeadingError,
    HeadingPair, ImuDiagnosis, ImuMountChange, ImuStream, UpDirections, YawJump, YawProfile,
    YawWarmUp,
};
pub use residual_check::{GyroResidual, ImuResidualCheck, check_imu_residual};

use ground::geometry::{Rotation, Vec3, angle_between, mean_vector, rotation_by_wahba};
use ground::stats::mean;
use ground::stats::thin::thinned;
use ground::stream::{ImuTrack, JointSequence, JointTrack, sample_noise};
use nalgebra::Matrix3;

pub(super) const MAX_IMU_FIT_SAMPLES: usize = 5000;
/// Minimum for an IMU that follows the arm.
const MIN_CORRELATION: f64 = 0.6;
const MIN_FIT_SAMPLES: usize = 20;
const MOUNT_SIGNIFICANCE: f64 = 1e-4;
/// High because an omitted skew biases the latency.
const SKEW_SIGNIFICANCE: f64 = 1e-3;
/// Parts of a run: for [`check_explained`], and to average noise.
const BLOCKS: usize = 10;
/// Rms in the blocks, for [`check_explained`].
const MIN_ROTATION_RAD: f64 = 0.02;
const MIN_EXPLAINED_SHARE: f64 = 0.95;
const ROTATION_LATENCY_SAMPLES: usize = 300;

/// Diagnoses one IMU against the joint states (ideally
/// [`corrected_joints`](crate::JointDiagnosis::corrected_joints)).
pub fn diagnose_imu(joints: &JointTrack, stream: &ImuStream, max_lag_s: f64) -> ImuDiagnosis {
    let numbers = ImuConventions::detect(joints, stream, max_lag_s);
    let track = numbers.convert(stream.track);
    diagnose_converted_imu(joints, &ImuStream { track: &track, ..*stream }, &numbers, max_lag_s)
}

/// Diagnoses a stream already converted.
pub(super) fn diagnose_converted_imu(
    joints: &JointTrack,
    stream: &ImuStream,
    numbers: &ImuConventions,
    max_lag_s: f64,
) -> ImuDiagnosis {
    let link = Link::new(joints, stream, numbers);
    let peaks = link.peaks(max_lag_s);
    let followed_s = followed_lag_s(&peaks);
    let (moves, lag_s) = (followed_s.is_some(), followed_s.unwrap_or(0.0));
    let gyro = link.fit_gyro(lag_s, moves);
    let by_gyro = gyro.as_ref().ok().filter(|_| moves);
    let orientation = if stream.track.orientation.is_empty() {
        Err(NotObservable::NoOrientation)
    } else {
        // The gyro's delay is independent of the convention and more precise than the speed correlation.
        let start = gyro.as_ref().map_or(link.delay(lag_s), |fit| fit.parameters.delay());
        link.fit_orientation(start, moves, by_gyro)
    };
    let by_orientation = orientation.as_ref().ok().and_then(|found| found.link_from_imu);
    let axes_rotation = by_orientation
        .zip(by_gyro)
        .and_then(|(mount, gyro)| gyro_axes_rotation(&link, lag_s, &mount, gyro));
    let with_gyro = axes_rotation.filter(|rotation| rotation.with_accel);
    let imu_from_accel = with_gyro.map_or_else(Rotation::identity, |it| it.imu_from_gyro);
    let mount = by_orientation.or(link.known_mount()).unwrap_or_default();
    let forces = link.static_forces(lag_s, &mount, &imu_from_accel);
    let tilt_rad = match stream.track.orientation.is_empty() {
        true => Err(NotObservable::NoOrientation),
        false => tilt::tilt(&forces[0]),
    };
    let gyro = gyro.map(|fit| fit.diagnosis);
    let gyro_bias = gyro.as_ref().map_err(Clone::clone).and_then(|it| it.gyro_bias.clone());
    let mut found = match (orientation, gyro) {
        (Ok(found), gyro) => {
            let by_gyro = gyro.map(|gyro| gyro.skew);
            let skew = found.skew.or_else(|why| by_gyro.unwrap_or(Err(why)));
            ImuDiagnosis { skew, axes_rotation, up: tilt::up(&forces), ..found }
        }
        (Err(NotObservable::NoOrientation), Ok(gyro)) => gyro,
        (Err(why @ NotObservable::NoOrientation), Err(no_gyro)) => ImuDiagnosis {
            encoding: Err(why.clone()),
            yaw_drift_rad_s: Err(why),
            ..ImuDiagnosis::not_observable(&no_gyro)
        },
        // If the orientation does not follow the arm, a match of the gyro is coincidence.
        (Err(why), gyro) => ImuDiagnosis {
            link_from_imu: gyro.as_ref().ok().and_then(|gyro| gyro.link_from_imu),
            mount_change: gyro.ok().and_then(|gyro| gyro.mount_change),
            ..ImuDiagnosis::not_observable(&why)
        },
    };
    if let Some(lags) = ambiguous_lags(&peaks) {
        found.drop_latency(&NotObservable::Periodic(lags));
    }
    // Stamp errors of the clock alignment at both ends simulate a skew.
    let t_s = &stream.track.t_s;
    let span_s = t_s.last().unwrap_or(&0.0) - t_s.first().unwrap_or(&0.0);
    let simulated_skew = 2.0 * stream.stamp_error_s / span_s.max(f64::MIN_POSITIVE);
    ImuDiagnosis {
        latency_s: found.latency_s.map(|it| it.with_error(stream.stamp_error_s)),
        skew: found.skew.map(|it| it.with_error(simulated_skew)),
        conventions: numbers.clone(),
        tilt_rad,
        gyro_bias,
        ..found
    }
}

fn gyro_axes_rotation(
    link: &Link,
    lag_s: f64,
    link_from_imu: &Rotation,
    gyro: &gyro::GyroFit,
) -> Option<GyroAxesRotation> {
    /// Gain in constancy of the specific force if the accelerometer shares the gyro's axes.
    const MIN_CONSTANCY_GAIN: f64 = 0.05;
    let rotation = gyro
        .rotation_against(link_from_imu)
        .filter(|rotation| rotation.size_rad.p_value < MOUNT_SIGNIFICANCE)?;
    let [by_gyro, by_imu] =
        [gyro.parameters.link_from_imu, *link_from_imu].map(|mount| link.steadiness(lag_s, &mount));
    Some(GyroAxesRotation { with_accel: by_gyro > by_imu + MIN_CONSTANCY_GAIN, ..rotation })
}

/// Correlation of the IMU's angular speed with its link's per lag within ±`max_lag_s`, for plots. Uses the
/// gyro or the orientation, whichever correlates better.
pub fn angular_speed_correlation(
    joints: &JointTrack,
    stream: &ImuStream,
    max_lag_s: f64,
) -> Vec<LagPeak> {
    by_better_signal(joints, stream, |link_speed, speed| {
        let mut by_lag = correlation_by_lag(link_speed, speed, max_lag_s);
        by_lag.retain(|at| at.correlation.is_finite());
        by_lag
    })
}

/// Correlation of the link's angular speed with that of the gyro or of the orientation, whichever is higher.
fn by_better_signal(
    joints: &JointTrack,
    stream: &ImuStream,
    correlate: impl Fn(&SpeedSeries, &SpeedSeries) -> Vec<LagPeak>,
) -> Vec<LagPeak> {
    let ImuTrack { t_s, gyro, orientation, .. } = stream.track;
    let link_speed = ArmSpeeds::from_joints(joints, stream.chain, stream.columns).angular;
    let by_gyro = correlate(&link_speed, &norm_series(t_s, gyro));
    if orientation.is_empty() {
        return by_gyro;
    }
    let by_orientation = correlate(&link_speed, &angular_speed(t_s, orientation));
    let best = |by_lag: &[LagPeak]| by_lag.first().map_or(f64::MIN, |peak| peak.correlation);
    if best(&by_orientation) > best(&by_gyro) { by_orientation } else { by_gyro }
}

/// Decodes the orientations with `encoding`; of several possible rotations, selects the one closest to FK.
/// `None` if the IMU then does not follow the arm.
pub fn reinterpret_imu(
    joints: &JointTrack,
    stream: &ImuStream,
    encoding: PoseEncoding,
    max_lag_s: f64,
) -> Option<Vec<Rotation>> {
    let numbers = ImuConventions::default();
    let link = Link::new(joints, stream, &numbers);
    let lag_s = link.peaks(max_lag_s).first().map_or(0.0, |peak| peak.lag_s);
    let fk = FkSequence::new(joints, stream.chain, stream.columns);
    let truth_s = stream.track.t_s.iter().map(|stamp_s| stamp_s - lag_s);
    let known = [Rotation::identity(), link.known_mount().unwrap_or_default()];
    let intended = IntendedEncoding { encoding, axes: AxesError::NONE, is_inverted: false };
    decode_rotations(&stream.track.orientation, &intended, fk, truth_s, known, false)
}

/// Delay of stamps relative to the measured time: `latency + skew·(stamp − middle)`.
#[derive(Clone, Copy, Debug)]
struct Delay {
    latency_s: f64,
    skew: f64,
    middle_s: f64,
}

impl Delay {
    /// Time of measurement.
    fn truth_s(&self, stamp_s: f64) -> f64 {
        stamp_s - self.latency_s - self.skew * (stamp_s - self.middle_s)
    }
}

/// Likeliest lag of an IMU that follows the arm.
fn followed_lag_s(peaks: &[LagPeak]) -> Option<f64> {
    peaks.first().filter(|peak| peak.correlation > MIN_CORRELATION).map(|peak| peak.lag_s)
}

/// Lags with nearly equal correlations, as in repetitive motion.
fn ambiguous_lags(peaks: &[LagPeak]) -> Option<Vec<f64>> {
    let equal = &peaks[..equal_peaks(peaks)];
    (equal.len() > 1).then(|| equal.iter().map(|peak| peak.lag_s).collect())
}

struct Link<'a> {
    joints: &'a JointTrack,
    stream: &'a ImuStream<'a>,
    numbers: &'a ImuConventions,
    rest_speeds: Vec<f64>,
    /// Variances of position and velocity per joint of the chain.
    joint_noise: Vec<[f64; 2]>,
    middle_s: f64,
}

/// Noise between samples along each axis.
fn noise_of_axes(vectors: &[Vec3]) -> Vec3 {
    Vec3::from_fn(|axis, _| {
        sample_noise(&vectors.iter().map(|vector| vector[axis]).collect::<Vec<f64>>())
    })
}

/// Mount from `Σ link·imuᵀ`. If the directions vary too little, selects the solution closest to `expected`.
fn mount_of(correlation: &Matrix3<f64>, expected: &Rotation) -> Rotation {
    /// As a share of the best-observed directions.
    const EXPECTED_MOUNT_WEIGHT: f64 = 1e-2;
    let expected = expected.to_rotation_matrix();
    rotation_by_wahba(
        &(correlation + expected.matrix() * (EXPECTED_MOUNT_WEIGHT * correlation.norm())),
    )
}

/// State of the link at one time.
#[derive(Default)]
struct LinkState {
    /// Joint positions in chain order.
    q: Vec<f64>,
    /// `base_from_link`.
    rotation: Rotation,
    /// In base, m.
    position: Vec3,
    /// In base, rad/s.
    rate: Vec3,
    /// Covariance in base, rad².
    rotation_noise: Matrix3<f64>,
    /// Trace of the covariance, rad²/s².
    rate_noise: f64,
    moving: bool,
}

impl LinkState {
    /// Angular rate in the link, rad/s.
    fn body_rate(&self) -> Vec3 {
        self.rotation.inverse() * self.rate
    }
}

/// Checks that the model explains rotation or rate `by_fk`, given the residual, all rms. Ignores rotations that are too
/// small.
///
/// # Errors
/// If the correlation is too low.
fn check_explained(rotation_rad: f64, by_fk: f64, residual: f64) -> EstimateResult<()> {
    let correlation = (1.0 - (residual / by_fk).powi(2)).max(0.0).sqrt();
    if rotation_rad > MIN_ROTATION_RAD && correlation < MIN_EXPLAINED_SHARE {
        Err(NotObservable::DoesNotFollow(correlation))
    } else {
        Ok(())
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    mean(values.map(|value| value * value)).sqrt()
}

impl<'a> Link<'a> {
    fn new(joints: &'a JointTrack, stream: &'a ImuStream<'a>, numbers: &'a ImuConventions) -> Self {
        let t_s = &stream.track.t_s;
        let middle_s = 0.5 * (t_s.first().unwrap_or(&0.0) + t_s.last().unwrap_or(&0.0));
        let rest_speeds = rest_speeds(joints);
        let noise = |&column: &usize| match joints.noise.get(column) {
            Some(noise) => noise.map(|sigma| sigma * sigma),
            None => {
                let q: Vec<f64> = joints.positions_of(column).collect();
                [sample_noise(&q).powi(2), (rest_speeds[column] / REST_SIGMAS).powi(2)]
            }
        };
        let joint_noise = stream.columns.iter().map(noise).collect();
        Self { joints, stream, numbers, rest_speeds, joint_noise, middle_s }
    }

    /// As logged.
    fn known_mount(&self) -> Option<Rotation> {
        self.stream.link_from_imu.map(|pose| pose.rotation)
    }

    fn delay(&self, latency_s: f64) -> Delay {
        Delay { latency_s, skew: 0.0, middle_s: self.middle_s }
    }

    fn at(&self, t_s: f64, joints: &mut JointSequence) -> Option<LinkState> {
        let (q, qd) = joints.at(t_s)?;
        let ImuStream { chain, columns, .. } = self.stream;
        let q: Vec<f64> = columns.iter().map(|&column| q[column]).collect();
        let mut jacobian = vec![[0.0; 6]; columns.len()];
        let pose = chain.forward_with_jacobian(&q, &mut jacobian);
        let (rotation, position) = (pose.rotation, pose.translation.vector);
        let mut link_state = LinkState { q, rotation, position, ..LinkState::default() };
        let columns = jacobian.iter().zip(*columns).zip(&self.joint_noise);
        for ((column, &track), [position, velocity]) in columns {
            let axis = Vec3::new(column[3], column[4], column[5]);
            link_state.rate += axis * qd[track];
            link_state.rotation_noise += axis * axis.transpose() * *position;
            link_state.rate_noise += axis.norm_squared() * velocity;
            link_state.moving |= qd[track].abs() > self.rest_speeds[track];
        }
        Some(link_state)
    }

    /// Lags at which the IMU's speed correlates with the link's, most likely first.
    fn peaks(&self, max_lag_s: f64) -> Vec<LagPeak> {
        by_better_signal(self.joints, self.stream, |link_speed, speed| {
            lag_peaks(link_speed, speed, max_lag_s)
        })
    }

    /// Rms rotation of the link by FK about its mean in each block of the run.
    fn rotation_rms_rad(&self, delay: &Delay) -> f64 {
        let rows = thinned(0..self.stream.track.t_s.len(), ROTATION_LATENCY_SAMPLES);
        let states = self.states(rows, *delay);
        let rotations: Vec<Rotation> = states.map(|(_, state)| state.rotation).collect();
        let blocks = rotations.chunks(rotations.len().div_ceil(BLOCKS).max(1));
        rms(blocks.flat_map(|block| {
            let mean = mean_rotation(block);
            block.iter().map(move |rotation| angle_between(&mean, rotation))
        }))
    }

    /// Checks that the model explains the rotation within each block. Effects that are constant in a block do not.
    fn check_rotation_explained(&self, delay: &Delay, residuals: &[Vec3]) -> EstimateResult<()> {
        let rotation_rad = self.rotation_rms_rad(delay);
        let blocks = residuals.chunks(residuals.len().div_ceil(BLOCKS).max(1));
        let residual_rad = rms(blocks.flat_map(|block| {
            let mean = mean_vector(block);
            block.iter().map(move |residual| (residual - mean).norm())
        }));
        check_explained(rotation_rad, rotation_rad, residual_rad)
    }

    /// Evenly thinned rows of the stream.
    fn rows(&self) -> impl Iterator<Item = usize> + use<> {
        thinned(0..self.stream.track.t_s.len(), MAX_IMU_FIT_SAMPLES)
    }

    /// States of the link at rows of the stream. Skips rows that the joint states do not cover.
    fn states(
        &self,
        rows: impl Iterator<Item = usize>,
        delay: Delay,
    ) -> impl Iterator<Item = (usize, LinkState)> {
        let mut joints = self.joints.sequence();
        let t_s = &self.stream.track.t_s;
        rows.filter_map(move |row| Some((row, self.at(delay.truth_s(t_s[row]), &mut joints)?)))
    }
}
