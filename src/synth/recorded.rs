//! Streams of a run: content, timing and faults.

use nalgebra::Matrix3;

use super::structure::{Fold, SecondPublisher, ToolSlip};
use crate::geometry::{Convention, Misinterpretation, Pose, QuaternionOrderError, Vec3};

/// Timing of a stream's messages.
#[derive(Debug, Clone, PartialEq)]
pub struct Timing {
    /// Message rate, Hz; 0 disables the stream.
    pub rate_hz: f64,
    /// Time at which the content of the first message is true, s after the start.
    pub phase_s: f64,
    /// Latency, s: content stamped *t* was true at *t − latency*. With a skew, the value at mid-run.
    pub latency_s: f64,
    /// Growth of the latency with the stamp, s/s.
    pub skew: f64,
    /// Offset of the stamps' clock from the recorder's, s, in addition to latency and skew.
    pub clock_offset_s: f64,
    /// Whether header stamps are set; otherwise they are zero.
    pub stamped: bool,
    /// Rate of new content, Hz; it is repeated in between under new stamps. 0: always new.
    pub new_hz: f64,
    /// Step of the stamps' clock: time, s after the start, and size, s.
    pub step: Option<(f64, f64)>,
    /// Latency ramp of the content: start and end, s after the start, and size, s. A step if both times are
    /// equal.
    pub ages: Option<(f64, f64, f64)>,
    /// Gap in the recording: start and end, s after the start.
    pub gap_s: Option<(f64, f64)>,
}

/// Joint states.
#[derive(Debug, Clone, PartialEq)]
pub struct JointStream {
    /// Timing.
    pub timing: Timing,
    /// Whether velocities are logged.
    pub with_velocity: bool,
    /// Delay of the velocities relative to the positions, s.
    pub velocity_late_s: f64,
    /// Scale of each joint's velocities only; 1 beyond the end of the list.
    pub velocity_scales: Vec<f64>,
    /// `q_true − q_reported`, rad or m, one per joint from base to tip; zero beyond the end of the list.
    /// The pose stream and the IMU use the true positions, /tf the reported ones.
    pub zero_offsets: Vec<f64>,
    /// Scale of each joint's reported positions and velocities, applied after the offset; 1 beyond the end
    /// of the list. /tf uses the scaled values.
    pub scales: Vec<f64>,
    /// Whether values are degrees. /tf interprets them as radians, as a state publisher does.
    pub in_degrees: bool,
    /// Order of the values as joint indices from the base, if it differs from the order of the names. /tf
    /// uses the names.
    pub number_order: Option<Vec<usize>>,
    /// Wrapping of continuous joints into one turn.
    pub fold: Option<Fold>,
    /// Resolution of the encoders, rad or m; 0 for none.
    pub quantum: f64,
    /// Joints, counted from the root, published on a separate topic.
    pub apart: Option<(Vec<usize>, String)>,
    /// Interval with frozen values, s from the start.
    pub stuck_s: Option<(f64, f64)>,
}

/// Stream of tool poses.
///
/// The content is `reference_from_stream⁻¹ · base_from_tip · tip_from_stream`, then scaled radially, then
/// encoded.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseStream {
    /// Timing.
    pub timing: Timing,
    /// Frame of the messages.
    pub frame_id: String,
    /// Pose of the actual reference frame in the base.
    pub reference_from_stream: Pose,
    /// Pose of the actual tool frame in the tip.
    pub tip_from_stream: Pose,
    /// Radial scale minus 1: logged over true position.
    pub growth: f64,
    /// Encoding of the logged pose.
    pub coding: Coding,
    /// Whether the whole pose is inverted before encoding.
    pub inverted: bool,
    /// Whether positions are in mm.
    pub in_millimetres: bool,
    /// Additional factor of the positions: 100 for cm.
    pub times: f64,
    /// Axes of the numbers relative to the right ones; mirrored if the determinant is −1.
    pub axes: Option<Matrix3<f64>>,
    /// Constant coordinate: index and value, m.
    pub constant: Option<(usize, f64)>,
    /// Placeholder for a quaternion that is never set: x, y, z, w.
    pub unset: Option<[f64; 4]>,
    /// Temporary slip of the tool.
    pub slip: Option<ToolSlip>,
    /// Norm of the quaternions.
    pub quaternion_norm: f64,
    /// If set, the poses are published on [`NUMBERS`](super::NUMBERS) as six bare numbers: position in m
    /// and rotation in this convention, rad. The message has neither stamp nor frame.
    pub as_numbers: Option<Convention>,
    /// Whether the three rotation numbers are in degrees.
    pub numbers_in_degrees: bool,
    /// Outliers: sample index and offset, m.
    pub strays: Vec<(usize, Vec3)>,
    /// Interval with frozen values, s from the start.
    pub stuck_s: Option<(f64, f64)>,
}

/// Transforms of the arm's joints, as computed by a state publisher from the joint states, and static
/// transforms.
#[derive(Debug, Clone, PartialEq)]
pub struct TfStream {
    /// Timing. With the rate (or a fraction of it) and phase of the joint states, the stamps are copies of
    /// theirs.
    pub timing: Timing,
    /// Encoding of the logged transforms.
    pub coding: Coding,
    /// Whether /tf_static is present.
    pub with_static: bool,
    /// Second publisher of the same transforms.
    pub second: Option<SecondPublisher>,
    /// Additional transforms in /tf_static.
    pub others: Vec<OtherTransform>,
}

/// Transform that does not belong to the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherTransform {
    /// Parent frame.
    pub parent: String,
    /// Child frame.
    pub child: String,
    /// Pose of the child in the parent.
    pub parent_from_child: Pose,
}

/// IMU at the tip: gyro, accelerometer, and orientation in a world frame with arbitrary yaw.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuStream {
    /// Timing.
    pub timing: Timing,
    /// `tip_from_imu` in /tf_static.
    pub tip_from_imu: Pose,
    /// True mount relative to the published one: `imu_as_published_from_imu`.
    pub mount_error: Pose,
    /// Whether the orientation is logged; otherwise its covariance marks it as absent (REP 145).
    pub with_orientation: bool,
    /// Yaw of the base in the IMU's world at the start, rad. Not a fault.
    pub world_yaw_rad: f64,
    /// Drift of the logged yaw, rad/s about the base's z axis.
    pub yaw_drift_rad_s: f64,
    /// Jumps of the logged yaw: time, s after the start, and size, rad.
    pub yaw_jumps: Vec<(f64, f64)>,
    /// Density of a random walk of the logged yaw, rad/√s.
    pub yaw_walk_rad_rt_s: f64,
    /// Gyro bias in the sensor frame, rad/s.
    pub gyro_bias_rad_s: Vec3,
    /// Matrix from true rates to gyro rates before the bias: scale on the diagonal, misalignment off it.
    pub gyro_from_rate: Matrix3<f64>,
    /// Decaying part of the gyro bias: initial value, rad/s in the sensor frame, and time constant, s.
    pub gyro_warms_up: Option<(Vec3, f64)>,
    /// Decaying drift of the logged yaw: final error, rad, and time constant, s.
    pub yaw_warms_up: Option<(f64, f64)>,
    /// Heading-dependent error of the logged yaw (hard and soft iron): amplitude and phase, rad, of the
    /// first and second harmonic of the heading of the IMU's x axis.
    pub yaw_by_heading: [(f64, f64); 2],
    /// Scale of the logged rates: 180/π for °/s.
    pub gyro_times: f64,
    /// Scale of the logged specific force: 1/9.80665 for g.
    pub force_times: f64,
    /// Encoding of the logged orientation.
    pub coding: Coding,
}

/// Encoding of a logged pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coding {
    /// Correct.
    #[default]
    Faithful,
    /// The rotation was converted to three numbers, which were interpreted in another convention.
    Misread(Misinterpretation),
    /// The quaternion components were used in the wrong order.
    Slipped(QuaternionOrderError),
    /// The rotation is transposed, the position is not.
    Transposed,
    /// The whole pose is inverted.
    Inverted,
}

impl Timing {
    /// Regular messages at `rate_hz` from `phase_s` after the start, on the recorder's clock and without
    /// latency.
    pub fn every(rate_hz: f64, phase_s: f64) -> Self {
        Self {
            rate_hz,
            phase_s,
            latency_s: 0.0,
            skew: 0.0,
            clock_offset_s: 0.0,
            stamped: true,
            new_hz: 0.0,
            step: None,
            ages: None,
            gap_s: None,
        }
    }
}
