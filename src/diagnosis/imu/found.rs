//! What is estimated on an IMU.

use super::ImuNumbers;
use crate::{GradualLatency, LatencyCourse, ReadingEstimate, Seen, Unseen};
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
    /// What was taken off the stamps already, to be told of with what is found beyond it.
    pub taken_off: Option<&'a GradualLatency>,
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
    /// How it changes within the run, where it surely does; `vector_rad_s` is then the larger of the two.
    pub change: Option<BiasChange>,
}

/// A gyro's bias that is not one over the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasChange {
    /// How it goes from the one to the other.
    pub course: BiasCourse,
    /// The bias at the beginning, in the sensor's frame, rad/s.
    pub before_rad_s: Vec3,
    /// The bias that it comes to, likewise.
    pub after_rad_s: Vec3,
    /// The length of their difference, rad/s.
    pub size_rad_s: Length,
}

/// How a gyro's bias goes from one value to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BiasCourse {
    /// At once.
    Step {
        /// When, s from the run's origin.
        at_s: f64,
        /// 95 % interval of that, s.
        interval_s: [f64; 2],
    },
    /// Exponentially from the first sample on.
    WarmUp {
        /// In which it comes nearer by a factor of e, s.
        time_constant_s: f64,
    },
}

/// A gyro whose axes are not those of the orientation beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesTurn {
    /// What takes rates in the gyro's axes to those of the orientation.
    pub imu_from_gyro: Rotation,
    /// Its angle, rad.
    pub size_rad: Length,
    /// Whether the accelerometer has the gyro's axes, and not the orientation's.
    pub with_accel: bool,
}

/// Where the accelerometer feels up, as unit vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up {
    /// In the world of the orientation.
    pub in_world: Vec3,
    /// In the arm's base, by FK and the mount that fits best.
    pub in_base: Vec3,
}

/// An IMU that is turned in its mount within the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MountChange {
    /// When, s from the run's origin.
    pub at_s: f64,
    /// 95 % interval of that, s.
    pub interval_s: [f64; 2],
    /// `link_from_imu` from then on.
    pub link_from_imu: Rotation,
    /// By how much it is turned, rad.
    pub size_rad: Length,
}

/// A yaw error that depends on where the IMU heads: hard and soft iron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingError {
    /// Half of what it goes from its least to its most, over the headings of the run, rad.
    pub amplitude_rad: Measured,
    /// The axis of the IMU whose heading it is: 0 is x.
    pub axis: usize,
}

/// A yaw that drifts at first and less and less.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawWarmUp {
    /// In which the drift falls by a factor of e, s.
    pub time_constant_s: f64,
    /// How far it turns the yaw in all, rad; positive to the left.
    pub turned_rad: Measured,
    /// How fast it drifts at first beside the drift that stays, rad/s.
    pub at_first_rad_s: Measured,
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
    /// What of it depends on the heading.
    pub heading: Option<HeadingError>,
    /// What of it settles from the beginning on.
    pub warm_up: Option<YawWarmUp>,
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
    /// `link_from_imu` as it fits best; where it changes, that at the beginning.
    pub link_from_imu: Option<Rotation>,
    /// How the gyro's axes are turned against the orientation's, where both follow the arm and they surely
    /// are.
    pub axes_turn: Option<AxesTurn>,
    /// How the mount changes within the run, where it surely does.
    pub mount_change: Option<MountChange>,
    /// How the numbers are written. All else is of the numbers as they should be.
    pub numbers: ImuNumbers,
    /// Angle between gravity by the accelerometer and the vertical of the orientation, rad.
    pub tilt_rad: Seen<Length>,
    /// Where the accelerometer feels up while the arm rests.
    pub up: Option<Up>,
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
            axes_turn: None,
            mount_change: None,
            numbers: ImuNumbers::default(),
            tilt_rad: Err(why.clone()),
            up: None,
            gyro_bias: Err(why.clone()),
            yaw_error: Vec::new(),
            headings: Vec::new(),
        }
    }
}
