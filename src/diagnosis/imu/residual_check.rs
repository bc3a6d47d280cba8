//! Residual of an IMU against FK, computed independently of the fits. A pass requires it to be small.

use super::conventions::{Alignment, rate_pairs};
use super::{Delay, ImuDiagnosis, ImuStream, Link, LinkState, followed_lag_s, noise_of_axes};
use crate::frames::rotation_frames::mean_rotation;
use crate::residuals::residual_check::{ErrorSeries, FkError};
use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::median;
use ground::stream::JointTrack;

const MIN_SAMPLES: usize = 50;

/// Residual of an IMU that rotates with the arm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuResidualCheck {
    /// Orientation residual after correcting latency, mount, world frame and yaw error. `length` is zero.
    pub orientation: Option<FkError>,
    /// Gyro residual.
    pub gyro: Option<GyroResidual>,
    /// Median specific force. `None` if it is zero.
    pub gravity_m_s2: Option<f64>,
}

/// Residual of a gyro against FK after correcting mount and mean, rms rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroResidual {
    /// Gyro rate over the arm's.
    pub scale: f64,
    /// Residual.
    pub residual: f64,
    /// Angular rate of the link by FK.
    pub by_fk: f64,
    /// Sample-to-sample noise.
    pub noise: f64,
}

/// Computes the residual against FK of the corrected `joints`. `None` if the IMU does not rotate with the
/// arm.
pub fn check_imu_residual(
    joints: &JointTrack,
    stream: &ImuStream,
    diagnosis: &ImuDiagnosis,
    max_lag_s: f64,
) -> Option<ImuResidualCheck> {
    let track = diagnosis.conventions.convert(stream.track);
    let stream = &ImuStream { track: &track, ..*stream };
    let link = Link::new(joints, stream, &diagnosis.conventions);
    let followed_s = followed_lag_s(&link.peaks(max_lag_s))?;
    let lag_s = diagnosis.latency_s.as_ref().map_or(followed_s, |latency| latency.value);
    let skew = diagnosis.skew.as_ref().map_or(0.0, |skew| skew.value);
    let delay = Delay { skew, ..link.delay(lag_s) };
    let moving = link.states(link.rows(), delay).filter(|(_, state)| state.moving);
    let link_states: Vec<(usize, LinkState)> = moving.collect();
    let mut forces: Vec<f64> = stream.track.accel.iter().map(Vec3::norm).collect();
    (link_states.len() >= MIN_SAMPLES).then(|| ImuResidualCheck {
        orientation: orientation_residual(stream, diagnosis, &link_states),
        gyro: gyro_residual(&link, &link_states),
        gravity_m_s2: median(&mut forces).filter(|size| *size > 0.0),
    })
}

/// `None` if there is no orientation or its encoding is misinterpreted.
fn orientation_residual(
    stream: &ImuStream,
    diagnosis: &ImuDiagnosis,
    link_states: &[(usize, LinkState)],
) -> Option<FkError> {
    let encoding = diagnosis.encoding.as_ref().ok()?;
    let (track, link_from_imu) = (stream.track, diagnosis.link_from_imu?);
    if track.orientation.is_empty() || !encoding.best.is_as_logged() {
        return None;
    }
    let yaw_at = |t_s: f64| {
        let next = diagnosis.yaw_error.partition_point(|(at_s, _)| *at_s <= t_s);
        let last = diagnosis.yaw_error.get(next.saturating_sub(1));
        last.map_or(0.0, |(_, yaw_rad)| *yaw_rad)
    };
    let mount_at = |t_s: f64| match &diagnosis.mount_change {
        Some(change) if t_s > change.at_s => change.link_from_imu,
        _ => link_from_imu,
    };
    let world = |(row, state): &(usize, LinkState)| {
        let link_from_imu = mount_at(track.t_s[*row]);
        let world = track.orientation[*row] * (state.rotation * link_from_imu).inverse();
        rotation_from_rotvec(Vec3::z() * -yaw_at(track.t_s[*row])) * world
    };
    let worlds: Vec<Rotation> = link_states.iter().map(world).collect();
    let mean = mean_rotation(&worlds);
    let angle = worlds.iter().map(|world| rotvec_from_rotation(&(world * mean.inverse())));
    let sample =
        |(row, state): &(usize, LinkState)| (track.t_s[*row], pose([0.0; 3], state.rotation));
    let (t_s, fk): (Vec<f64>, Vec<Pose>) = link_states.iter().map(sample).unzip();
    let nothing = vec![Vec3::zeros(); fk.len()];
    let series = ErrorSeries::new(&t_s, &fk, nothing, Some(angle.collect()));
    Some(series.error(&Vec::from_iter(0..fk.len())))
}

/// With the best-fitting mount. `None` if the gyro is always zero.
fn gyro_residual(link: &Link, link_states: &[(usize, LinkState)]) -> Option<GyroResidual> {
    let gyro = &link.stream.track.gyro;
    let mut pairs = rate_pairs(link.stream.track, link_states);
    pairs.retain(|(gyro, _)| !link.numbers.saturates(gyro));
    let Alignment { link_from_imu, bias, mean_rate, residual } = Alignment::fit(&pairs);
    let (mut along, mut square) = (0.0, 0.0);
    for (gyro, rate) in &pairs {
        let rate = rate - mean_rate;
        along += rate.dot(&(link_from_imu * (gyro - bias) - mean_rate));
        square += rate.norm_squared();
    }
    let has_rates = gyro.iter().any(|gyro| gyro.norm() > 0.0);
    (has_rates && square > 0.0).then(|| GyroResidual {
        scale: along / square,
        residual,
        by_fk: (square / pairs.len() as f64).sqrt(),
        noise: noise_of_axes(gyro).norm(),
    })
}
