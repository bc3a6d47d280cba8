//! Streams of a run: content, timing and faults.

use nalgebra::Matrix3;

use super::structure::{JointWrapping, SecondPublisher, ToolSlip};
use crate::geometry::{Convention, Misinterpretation, Pose, QuaternionOrderError, Vec3};

/// Timing of a stream's messages.
#[derive(Debug, Clone, PartialEq)]
pub struct Timing {
    /// In Hz; 0 disables the stream.
    pub rate_hz: f64,
    /// Time of the first content, s after the start.
    pub phase_s: f64,
    /// In s: content stamped *t* was true at *t − latency*. With a skew, at mid-run.
    pub latency_s: f64,
    /// Growth of the latency, s/s.
    pub skew: f64,
    /// Stamps' clock minus the recorder's, s, besides latency and skew.
    pub clock_offset_s: f64,
    /// Otherwise header stamps are zero.
    pub has_stamps: bool,
    /// Rate of new content, Hz, repeated under new stamps; 0: always new.
    pub update_hz: f64,
    /// Clock step: time, s after the start, and size, s.
    pub clock_step: Option<(f64, f64)>,
    /// Latency ramp: start and end, s after the start, and size, s; a step if both are equal.
    pub latency_ramp: Option<(f64, f64, f64)>,
    /// Not recorded: start and end, s after the start.
    pub gap_s: Option<(f64, f64)>,
}

/// Joint states.
#[derive(Debug, Clone, PartialEq)]
pub struct JointStream {
    /// Timing.
    pub timing: Timing,
    /// Whether velocities are logged.
    pub has_velocity: bool,
    /// Delay after the positions, s.
    pub velocity_latency_s: f64,
    /// Per joint, velocities only; 1 beyond the list.
    pub velocity_scales: Vec<f64>,
    /// `q_true − q_reported`, rad or m, from base to tip; zero beyond the list. Pose stream and IMU use the
    /// true positions, /tf the reported ones.
    pub zero_offsets: Vec<f64>,
    /// Per joint, after the offset, of positions, velocities and /tf; 1 beyond the list.
    pub scales: Vec<f64>,
    /// Whether values are degrees; /tf reads them as radians.
    pub is_in_degrees: bool,
    /// Joint indices from the base in the order of the values, if it differs from the names' (used by /tf).
    pub number_order: Option<Vec<usize>>,
    /// Wrapping of continuous joints into one turn.
    pub wrapping: Option<JointWrapping>,
    /// Encoder resolution, rad or m; 0 for none.
    pub resolution: f64,
    /// Joints, from the root, on a separate topic.
    pub separate_topic: Option<(Vec<usize>, String)>,
    /// Frozen values: start and end, s after the start.
    pub frozen_s: Option<(f64, f64)>,
}

/// Tool poses: `reference_from_stream⁻¹ · base_from_tip · tip_from_stream`, then scaled radially, then
/// encoded.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseStream {
    /// Timing.
    pub timing: Timing,
    /// Frame of the messages.
    pub frame_id: String,
    /// Actual reference frame in the base.
    pub reference_from_stream: Pose,
    /// Actual tool frame in the tip.
    pub tip_from_stream: Pose,
    /// Logged over true position, minus 1.
    pub radial_scale_error: f64,
    /// Encoding of the logged pose.
    pub encoding: LoggedEncoding,
    /// Inverts the pose before encoding.
    pub is_inverted: bool,
    /// Whether positions are in mm.
    pub is_in_millimetres: bool,
    /// Factor of the positions: 100 for cm.
    pub position_factor: f64,
    /// Axes of the numbers in the right ones; mirrored if the determinant is −1.
    pub axes: Option<Matrix3<f64>>,
    /// Coordinate that never changes: index and value, m.
    pub constant_coordinate: Option<(usize, f64)>,
    /// Quaternion that is never set: x, y, z, w.
    pub unset_quaternion: Option<[f64; 4]>,
    /// Temporary slip of the tool.
    pub tool_slip: Option<ToolSlip>,
    /// Norm of the quaternions.
    pub quaternion_norm: f64,
    /// Publishes on [`NUMBERS`](super::NUMBERS) position in m and rotation in this convention, rad, without
    /// stamp and frame.
    pub number_convention: Option<Convention>,
    /// Whether its rotation is in degrees.
    pub has_numbers_in_degrees: bool,
    /// Outliers: sample and offset, m.
    pub outliers: Vec<(usize, Vec3)>,
    /// Frozen values: start and end, s after the start.
    pub frozen_s: Option<(f64, f64)>,
}

/// The arm's transforms from the joint states, and static transforms.
#[derive(Debug, Clone, PartialEq)]
pub struct TfStream {
    /// Stamps are copies with the joint states' phase, and their rate or a fraction.
    pub timing: Timing,
    /// Encoding of the logged transforms.
    pub encoding: LoggedEncoding,
    /// Logs /tf_static.
    pub has_static: bool,
    /// Second publisher of these transforms.
    pub second: Option<SecondPublisher>,
    /// More transforms in /tf_static.
    pub others: Vec<OtherTransform>,
}

/// Transform that does not belong to the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherTransform {
    /// Parent frame.
    pub parent: String,
    /// Child frame.
    pub child: String,
    /// Child in the parent.
    pub parent_from_child: Pose,
}

/// IMU at the tip, in a world with arbitrary yaw.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuStream {
    /// Timing.
    pub timing: Timing,
    /// Mounting, as in /tf_static.
    pub tip_from_imu: Pose,
    /// True mount in the published one: `imu_as_published_from_imu`.
    pub mount_error: Pose,
    /// Otherwise its covariance marks it as absent (REP 145).
    pub has_orientation: bool,
    /// Yaw of the base in the IMU's world, rad; not a fault.
    pub world_yaw_rad: f64,
    /// In rad/s about the base's z axis.
    pub yaw_drift_rad_s: f64,
    /// Time, s after the start, and size, rad.
    pub yaw_jumps: Vec<(f64, f64)>,
    /// Yaw random walk, rad/√s.
    pub yaw_walk_rad_per_sqrt_s: f64,
    /// In the sensor frame, rad/s.
    pub gyro_bias_rad_s: Vec3,
    /// From true to gyro rates before the bias: scale on the diagonal, misalignment off it.
    pub gyro_from_rate: Matrix3<f64>,
    /// Decaying gyro bias: at first, rad/s in the sensor frame, and time constant, s.
    pub gyro_warm_up: Option<(Vec3, f64)>,
    /// Decaying yaw drift: final error, rad, and time constant, s.
    pub yaw_warm_up: Option<(f64, f64)>,
    /// Yaw error by heading of the IMU's x axis (hard and soft iron): amplitude and phase, rad, of two
    /// harmonics.
    pub yaw_by_heading: [(f64, f64); 2],
    /// Factor of the rates: 180/π for °/s.
    pub gyro_factor: f64,
    /// Factor of the specific force: 1/9.80665 for g.
    pub force_factor: f64,
    /// Encoding of the logged orientation.
    pub encoding: LoggedEncoding,
}

/// Encoding of a logged pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LoggedEncoding {
    /// Correct.
    #[default]
    Correct,
    /// Three rotation numbers, interpreted in another convention.
    Misinterpreted(Misinterpretation),
    /// Quaternion in the wrong order.
    WrongQuaternionOrder(QuaternionOrderError),
    /// Rotation only.
    Transposed,
    /// The whole pose.
    Inverted,
}

impl Timing {
    /// At `rate_hz` from `phase_s` after the start, without latency.
    pub fn every(rate_hz: f64, phase_s: f64) -> Self {
        Self {
            rate_hz,
            phase_s,
            latency_s: 0.0,
            skew: 0.0,
            clock_offset_s: 0.0,
            has_stamps: true,
            update_hz: 0.0,
            clock_step: None,
            latency_ramp: None,
            gap_s: None,
        }
    }
}
