//! Estimates for an IMU.

use super::ImuConventions;
use crate::{EncodingEstimate, EstimateResult, LatencyProfile, NotObservable, PiecewiseLatency};
use ground::geometry::{Pose, Rotation, Vec3};
use ground::robot::Chain;
use ground::stats::{Measured, MeasuredLength};
use ground::stream::ImuTrack;

/// Input of the IMU estimators.
#[derive(Clone, Copy, Debug)]
pub struct ImuStream<'a> {
    /// Measurements.
    pub track: &'a ImuTrack,
    /// Chain from the robot's base to the IMU's link.
    pub chain: &'a Chain,
    /// Column in the joint track per joint of `chain`.
    pub columns: &'a [usize],
    /// Standard error of the clock alignment; 0 on a shared clock.
    pub stamp_error_s: f64,
    /// Logged `link_from_imu`, if present.
    pub link_from_imu: Option<Pose>,
    /// Latency already compensated in the stamps, to be reported with the rest.
    pub removed_ramp: Option<&'a PiecewiseLatency>,
    /// Rms rotation error of FK against the arm's poses that no cause explains; 0 if unknown.
    pub fk_error_rad: f64,
}

/// Constant part of (gyro − FK rate).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroBias {
    /// Bias in the sensor's frame.
    pub vector_rad_s: Vec3,
    /// Its length.
    pub length_rad_s: MeasuredLength,
    /// Drift of yaw integrated from this gyro, about the base's z.
    pub yaw_rate_rad_s: f64,
    /// Scale and misalignment, if significant; not included in the bias.
    pub scale_error: Option<GyroScaleError>,
    /// Change within the run, if significant. `vector_rad_s` is then the larger value.
    pub change: Option<GyroBiasChange>,
}

/// Gyro bias that varies within the run. Vectors in the sensor's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroBiasChange {
    /// Time profile.
    pub profile: GyroBiasProfile,
    /// Initial bias.
    pub before_rad_s: Vec3,
    /// Final bias.
    pub after_rad_s: Vec3,
    /// Length of the difference.
    pub size_rad_s: MeasuredLength,
}

/// Time profile of a gyro bias.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GyroBiasProfile {
    /// Step.
    Step {
        /// Time, s from the run's origin.
        at_s: f64,
        /// 95 % interval.
        interval_s: [f64; 2],
    },
    /// Exponential decay from the first sample.
    WarmUp {
        /// Time constant.
        time_constant_s: f64,
    },
}

/// Gyro whose axes are rotated against those of the orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroAxesRotation {
    /// Rotation from the gyro's axes to the orientation's.
    pub imu_from_gyro: Rotation,
    /// Its angle.
    pub size_rad: MeasuredLength,
    /// Whether the accelerometer shares the gyro's axes.
    pub with_accel: bool,
}

/// Direction opposite to gravity by the accelerometer, as unit vectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpDirections {
    /// Direction in the orientation's world frame.
    pub in_world: Vec3,
    /// Direction in the arm's base, by FK and the estimated mount.
    pub in_base: Vec3,
    /// Its angle to the base's z axis.
    pub base_tilt_rad: MeasuredLength,
}

/// Rotation of an IMU in its mount within the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuMountChange {
    /// Time, s from the run's origin.
    pub at_s: f64,
    /// 95 % interval.
    pub interval_s: [f64; 2],
    /// `link_from_imu` after the change.
    pub link_from_imu: Rotation,
    /// Angle of the change.
    pub size_rad: MeasuredLength,
}

/// Yaw error that depends on the heading (hard and soft iron).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingError {
    /// Half the peak-to-peak error over the run's headings.
    pub amplitude_rad: Measured,
    /// IMU axis of the heading: 0 is x.
    pub axis: usize,
}

/// Yaw drift that decays exponentially.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawWarmUp {
    /// Time constant.
    pub time_constant_s: f64,
    /// Total rotation; positive to the left.
    pub turned_rad: Measured,
    /// Initial drift in excess of the constant one.
    pub at_first_rad_s: Measured,
}

/// Scale and misalignment of a gyro: `gyro = (1 + S)·ω + bias` with S symmetric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroScaleError {
    /// Along x, y and z; positive if the gyro measures too much.
    pub scale: [Measured; 3],
    /// Angles between y and z, x and z, x and y, per axis. `None` if one scale of all axes explains the rates.
    pub misalignment_rad: Option<[Measured; 3]>,
}

/// Yaw error of an IMU apart from constant drift.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct YawProfile {
    /// Jumps in time order.
    pub jumps: Vec<YawJump>,
    /// Density of the random walk, if any.
    pub walk_rad_per_sqrt_s: Option<f64>,
    /// Heading-dependent part.
    pub heading: Option<HeadingError>,
    /// Exponentially decaying part.
    pub warm_up: Option<YawWarmUp>,
}

/// Permanent jump of the yaw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawJump {
    /// Time, s from the run's origin.
    pub at_s: f64,
    /// Positive to the left.
    pub size_rad: Measured,
}

/// All estimates for one IMU.
#[derive(Clone, Debug)]
pub struct ImuDiagnosis {
    /// Convention and direction of the orientation.
    pub encoding: EstimateResult<EncodingEstimate>,
    /// Latency against the joint states; at mid-run if there is a skew.
    pub latency_s: EstimateResult<Measured>,
    /// Latency profile over the run.
    pub latency_profile: EstimateResult<LatencyProfile>,
    /// Clock skew, s/s.
    pub skew: EstimateResult<Measured>,
    /// Drift of the yaw about gravity against FK.
    pub yaw_drift_rad_s: EstimateResult<Measured>,
    /// Yaw error apart from the drift.
    pub yaw_profile: YawProfile,
    /// Rotation error of the logged `link_from_imu`.
    pub mount_rad: EstimateResult<MeasuredLength>,
    /// Estimated `link_from_imu`; the initial one if it changes.
    pub link_from_imu: Option<Rotation>,
    /// Gyro against orientation, if significant and both follow the arm.
    pub axes_rotation: Option<GyroAxesRotation>,
    /// Change of the mount, if significant.
    pub mount_change: Option<ImuMountChange>,
    /// Detected conventions. All other estimates use the converted measurements.
    pub conventions: ImuConventions,
    /// Gravity by the accelerometer against the vertical of the orientation.
    pub tilt_rad: EstimateResult<MeasuredLength>,
    /// Direction opposite to gravity at rest.
    pub up: Option<UpDirections>,
    /// Constant part of (gyro − FK rate).
    pub gyro_bias: EstimateResult<GyroBias>,
    /// Stamp (s from the origin) and yaw error against FK (rad), for plots.
    pub yaw_error: Vec<(f64, f64)>,
    /// The headings whose difference is `yaw_error`.
    pub headings: Vec<HeadingPair>,
}

/// Direction of one IMU axis about gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadingPair {
    /// Time, s from the run's origin.
    pub t_s: f64,
    /// Heading by the IMU, unwrapped.
    pub imu_rad: f64,
    /// Heading by FK in the IMU's world frame, unwrapped.
    pub fk_rad: f64,
}

impl ImuDiagnosis {
    /// Diagnosis without any estimate.
    pub fn not_observable(why: &NotObservable) -> Self {
        Self {
            encoding: Err(why.clone()),
            latency_s: Err(why.clone()),
            latency_profile: Err(why.clone()),
            skew: Err(why.clone()),
            yaw_drift_rad_s: Err(why.clone()),
            yaw_profile: YawProfile::default(),
            mount_rad: Err(why.clone()),
            link_from_imu: None,
            axes_rotation: None,
            mount_change: None,
            conventions: ImuConventions::default(),
            tilt_rad: Err(why.clone()),
            up: None,
            gyro_bias: Err(why.clone()),
            yaw_error: Vec::new(),
            headings: Vec::new(),
        }
    }

    pub(super) fn drop_latency(&mut self, why: &NotObservable) {
        self.latency_s = Err(why.clone());
        self.latency_profile = Err(why.clone());
        self.skew = Err(why.clone());
    }
}
