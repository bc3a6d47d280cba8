//! What is estimated on an IMU.

use crate::{LatencyCourse, ReadingEstimate, Seen, Unseen};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::robot::Chain;
use ground::stats::{Length, Measured};
use ground::stream::ImuTrack;

/// An IMU, as the estimators see it.
#[derive(Clone, Copy, Debug)]
pub struct ImuStream<'a> {
    /// The readings.
    pub track: &'a ImuTrack,
    /// The chain from the robot's base to the link that carries the IMU.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint track.
    pub columns: &'a [usize],
    /// Standard error that aligning a foreign clock left in the stamps, s; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// `link_from_imu` by the log's frames, where they say.
    pub link_from_imu: Option<Pose>,
}

/// The constant part of (gyro − rate by FK).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroBias {
    /// In the sensor's frame, rad/s.
    pub vector_rad_s: Vec3,
    /// Its length, rad/s.
    pub length_rad_s: Length,
    /// How fast yaw that is integrated from this gyro would drift about the base's z, rad/s.
    pub yaw_rate_rad_s: f64,
    /// Scale and misalignment, where the gyro surely has them; they are no part of the bias.
    pub shape: Option<GyroShape>,
}

/// By what a gyro's rates differ from the true ones beside a bias and a rotation:
/// `gyro = (1 + S)·ω + bias` with S symmetric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroShape {
    /// Scale errors along x, y and z; positive where the gyro reads too much.
    pub scale: [Measured; 3],
    /// By how much the axes y and z, x and z, x and y lean towards each other, rad each axis.
    pub misalignment_rad: [Measured; 3],
}

/// What an IMU's yaw error does beside drifting steadily.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct YawCourse {
    /// Its jumps, in the order of time.
    pub jumps: Vec<YawJump>,
    /// Density of its random walk, rad/√s, where it wanders.
    pub walk_rad_rt_s: Option<f64>,
}

/// A sudden change of yaw that stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawJump {
    /// When, s from the run's origin.
    pub at_s: f64,
    /// By how much, rad; positive to the left.
    pub size_rad: Measured,
}

/// All that was estimated on one IMU.
#[derive(Clone, Debug)]
pub struct ImuDiagnosis {
    /// Convention and direction of the orientation.
    pub reading: Seen<ReadingEstimate>,
    /// Latency against the joint states, s; where the clock surely has a skew, that at mid-run.
    pub latency_s: Seen<Measured>,
    /// How its latency went over the run.
    pub latency_course: Seen<LatencyCourse>,
    /// Clock skew, s/s.
    pub skew: Seen<Measured>,
    /// Drift of the IMU's yaw against FK's about gravity, rad/s.
    pub yaw_drift_rad_s: Seen<Measured>,
    /// What that yaw does beside drifting.
    pub yaw_course: YawCourse,
    /// The best-fitting `link_from_imu` rotation error against the log's frames, rad.
    pub mount_rad: Seen<Length>,
    /// `link_from_imu` as it fits best.
    pub link_from_imu: Option<Rotation>,
    /// Angle between gravity by the accelerometer and the vertical of the orientation, rad.
    pub tilt_rad: Seen<Length>,
    /// Constant part of (gyro − rate by FK).
    pub gyro_bias: Seen<GyroBias>,
    /// Stamp (s from the origin), yaw of IMU against FK (rad), for the pictures.
    pub yaw_error: Vec<(f64, f64)>,
    /// The headings that this is the difference of, for the pictures.
    pub headings: Vec<Heading>,
}

/// Where one axis of an IMU points, about gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading {
    /// Stamp, s from the run's origin.
    pub t_s: f64,
    /// By the IMU's orientation, rad, without jumps by whole turns.
    pub imu_rad: f64,
    /// By FK, turned to the IMU's world, rad, likewise.
    pub fk_rad: f64,
}

impl ImuDiagnosis {
    /// Nothing of it can be told.
    pub fn unseen(why: &Unseen) -> Self {
        Self {
            reading: Err(why.clone()),
            latency_s: Err(why.clone()),
            latency_course: Err(why.clone()),
            skew: Err(why.clone()),
            yaw_drift_rad_s: Err(why.clone()),
            yaw_course: YawCourse::default(),
            mount_rad: Err(why.clone()),
            link_from_imu: None,
            tilt_rad: Err(why.clone()),
            gyro_bias: Err(why.clone()),
            yaw_error: Vec::new(),
            headings: Vec::new(),
        }
    }
}
