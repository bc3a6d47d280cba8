//! An IMU on the arm: its latency, its mount, the drift of its yaw and the bias of its gyro.
//!
//! With orientation: `world_from_imu(s) = Rz(drift·(s − middle)) · world_from_base · FK(q(s − τ))
//! · link_from_imu`, the constant world yaw and tilt free, the mount free where the log does not give
//! it or what it gives does not fit. Without: `gyro(s) = link_from_imu⁻¹ · ω_FK(s − τ) + bias`, ω the
//! body rate of the link. FK carries the joint offsets found, since a wrist zero of 1° looks like
//! 0.6 °/min of drift and 0.9° of mount error without them.

mod gyro;
mod orientation;
mod solve;
mod tilt;
mod yaw;

use super::arm::still_speeds;
use super::latency::{Peak, angular_speed, arm_speeds, norms, peaks};
use super::{ImuDiagnosis, ImuStream, Measured, Unseen, YawCourse};
use crate::geometry::{Rotation, Vec3};
use crate::stream::JointTrack;

/// Samples of an IMU that are fitted.
const FIT_SAMPLES: usize = 5000;
/// Speeds correlate less than this where an IMU does not follow the arm.
const FOLLOWS: f64 = 0.6;
/// Samples without which nothing is fitted.
const NEED: usize = 20;
/// A mount that fits better than the log's is believed below this chance.
const MOUNT_CHANCE: f64 = 1e-4;

/// Diagnoses one IMU against the joint states, which should be those corrected by
/// [`ArmDiagnosis::corrected_joints`](super::ArmDiagnosis::corrected_joints).
pub fn diagnose_imu(joints: &JointTrack, stream: &ImuStream, most_lag_s: f64) -> ImuDiagnosis {
    let link = Link::new(joints, stream);
    let peaks = link.peaks(most_lag_s);
    let moves = peaks.first().is_some_and(|peak| peak.correlation > FOLLOWS);
    let lag_s = peaks.first().filter(|_| moves).map_or(0.0, |peak| peak.lag_s);
    let gyro = link.fit_gyro(lag_s, moves);
    let orientation = if stream.track.orientation.is_empty() {
        Err(Unseen::NoOrientation)
    } else {
        // The gyro's lag is free of any convention, and finer than the speeds'.
        let start_s = gyro
            .as_ref()
            .ok()
            .and_then(|fit| fit.latency_s.as_ref().ok())
            .map_or(lag_s, |m| m.value);
        link.fit_orientation(start_s, moves)
    };
    let from_gyro = || match &gyro {
        Ok(fit) => fit.latency_s.clone(),
        Err(why) => Err(why.clone()),
    };
    let latency_s = match &orientation {
        Ok(fit) => fit.latency_s.clone(),
        Err(_) => from_gyro(),
    };
    let latency_s = match repeats(&peaks) {
        Some(lags) => Err(Unseen::Periodic(lags)),
        None => latency_s.map(|latency| Measured {
            std_error: latency.std_error.hypot(stream.stamp_error_s),
            ..latency
        }),
    };
    let turned = gyro.as_ref().ok().filter(|_| moves).map(|fit| fit.link_from_imu);
    let mount_by_gyro = gyro.as_ref().map_err(Clone::clone).and_then(|fit| fit.mount_rad.clone());
    let gyro_bias = gyro.and_then(|fit| fit.bias);
    let tilt_rad = link.tilt(lag_s);
    match orientation {
        Ok(fit) => ImuDiagnosis {
            reading: Ok(fit.reading),
            latency_s,
            yaw_drift_rad_s: fit.drift_rad_s,
            yaw_course: fit.course,
            mount_rad: fit.mount_rad,
            link_from_imu: Some(fit.link_from_imu),
            tilt_rad,
            gyro_bias,
            yaw_error: fit.yaw_error,
        },
        Err(why) => ImuDiagnosis {
            reading: Err(why.clone()),
            latency_s,
            yaw_drift_rad_s: Err(why.clone()),
            yaw_course: YawCourse::default(),
            mount_rad: mount_by_gyro,
            link_from_imu: turned,
            tilt_rad,
            gyro_bias,
            yaw_error: Vec::new(),
        },
    }
}

/// Lags whose correlations are as good as equal: repeating motion.
fn repeats(peaks: &[Peak]) -> Option<Vec<f64>> {
    let best = peaks.first()?;
    let equal: Vec<f64> = peaks
        .iter()
        .take_while(|peak| 1.0 - peak.correlation < 1.2 * (1.0 - best.correlation) + 1e-4)
        .map(|peak| peak.lag_s)
        .collect();
    (equal.len() > 1).then_some(equal)
}

/// The link that carries the IMU, over time.
struct Link<'a> {
    joints: &'a JointTrack,
    stream: &'a ImuStream<'a>,
    still: Vec<f64>,
    middle_s: f64,
}

/// The link at one moment.
struct Moment {
    /// `base_from_link`.
    rotation: Rotation,
    /// Angular velocity of the link in base, rad/s.
    rate: Vec3,
    /// Whether some joint moves.
    moving: bool,
}

/// Buffers of a sweep.
struct Sweep {
    cursor: usize,
    track: [Vec<f64>; 2],
    q: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
}

impl<'a> Link<'a> {
    fn new(joints: &'a JointTrack, stream: &'a ImuStream<'a>) -> Self {
        let t_s = &stream.track.t_s;
        let middle_s = match (t_s.first(), t_s.last()) {
            (Some(first), Some(last)) => 0.5 * (first + last),
            _ => 0.0,
        };
        Self { joints, stream, still: still_speeds(joints), middle_s }
    }

    fn sweep(&self) -> Sweep {
        let (own, track) = (self.stream.columns.len(), self.joints.dof);
        Sweep {
            cursor: 0,
            track: [vec![0.0; track], vec![0.0; track]],
            q: vec![0.0; own],
            jacobian: vec![[0.0; 6]; own],
        }
    }

    fn at(&self, t_s: f64, sweep: &mut Sweep) -> Option<Moment> {
        let [q, qd] = &mut sweep.track;
        if !self.joints.at(t_s, &mut sweep.cursor, q, qd) {
            return None;
        }
        for (own, &column) in sweep.q.iter_mut().zip(self.stream.columns) {
            *own = q[column];
        }
        let pose = self.stream.chain.forward_with_jacobian(&sweep.q, &mut sweep.jacobian);
        let mut moment = Moment { rotation: pose.rotation, rate: Vec3::zeros(), moving: false };
        for (column, &track) in sweep.jacobian.iter().zip(self.stream.columns) {
            moment.rate += Vec3::new(column[3], column[4], column[5]) * qd[track];
            moment.moving |= qd[track].abs() > self.still[track];
        }
        Some(moment)
    }

    /// Lags at which the IMU turns as fast as the link.
    fn peaks(&self, most_lag_s: f64) -> Vec<Peak> {
        let track = self.stream.track;
        let (_, turning) = arm_speeds(self.joints, self.stream.chain, self.stream.columns);
        let gyro = peaks(&turning, &norms(&track.t_s, &track.gyro), most_lag_s);
        if track.orientation.is_empty() {
            return gyro;
        }
        let oriented = peaks(&turning, &angular_speed(&track.t_s, &track.orientation), most_lag_s);
        let best = |peaks: &[Peak]| peaks.first().map_or(f64::MIN, |peak| peak.correlation);
        if best(&oriented) > best(&gyro) { oriented } else { gyro }
    }

    /// Every so many samples, so that about [`FIT_SAMPLES`] are used.
    fn stride(&self) -> usize {
        self.stream.track.t_s.len().div_ceil(FIT_SAMPLES).max(1)
    }
}
