//! What each stream of a run records, when, and what is wrong with it.

use nalgebra::Matrix3;

use super::structure::{Fold, SecondPublisher, ToolSlip};
use crate::geometry::{Convention, Misreading, Pose, QuaternionSlip, Vec3};

/// When the messages of a stream are made, stamped and received.
#[derive(Debug, Clone, PartialEq)]
pub struct Timing {
    /// Messages a second; 0 leaves the stream out.
    pub rate_hz: f64,
    /// When the content of the first message is true, s after the start.
    pub phase_s: f64,
    /// Latency, s: what is stamped *t* was true at *t − latency*. With a skew, the value at mid-run.
    pub latency_s: f64,
    /// By how much the latency grows with each second of stamp, s/s.
    pub skew: f64,
    /// The clock of the stamps minus the recorder's, s, beyond latency and skew.
    pub clock_offset_s: f64,
    /// Whether header stamps are set; they are zero where not.
    pub stamped: bool,
    /// How often the content is new; between these moments it is repeated under new stamps. 0: always.
    pub new_hz: f64,
    /// When the clock of the stamps steps, s after the start, and by how much, s.
    pub step: Option<(f64, f64)>,
    /// From when to when what is sent becomes older, s after the start, and by how much, s: at once where both
    /// are the same.
    pub ages: Option<(f64, f64, f64)>,
    /// From when to when nothing is recorded, s after the start.
    pub gap_s: Option<(f64, f64)>,
}

/// The joint states.
#[derive(Debug, Clone, PartialEq)]
pub struct JointStream {
    /// Its times.
    pub timing: Timing,
    /// Whether velocities are logged.
    pub with_velocity: bool,
    /// How late the velocities are against the positions beside them, s.
    pub velocity_late_s: f64,
    /// What each joint's velocities alone are multiplied by; those of joints beyond its end by 1.
    pub velocity_scales: Vec<f64>,
    /// `q_true − q_reported`, rad or m, one a joint from base to tip; joints beyond its end have
    /// none. The pose stream and the IMU know the truth, /tf follows the joint states.
    pub zero_offsets: Vec<f64>,
    /// What each joint's positions and velocities are multiplied by before they are reported, after
    /// their offset; joints beyond its end by 1. /tf believes them.
    pub scales: Vec<f64>,
    /// Whether the numbers are degrees. /tf takes them for radians, as a state publisher does.
    pub in_degrees: bool,
    /// The joints in the order that the numbers are in, each counted from the base, where that is
    /// not the order of the names. /tf believes the names.
    pub number_order: Option<Vec<usize>>,
    /// Whether endless joints are brought back into one turn.
    pub fold: Option<Fold>,
    /// The step of the encoders, rad or m; 0 where they have none.
    pub quantum: f64,
    /// The topic of these joints alone, counted from the root.
    pub apart: Option<(Vec<usize>, String)>,
    /// From when to when the stream goes on saying what it said first, s from the start.
    pub stuck_s: Option<(f64, f64)>,
}

/// The stream of tool poses.
///
/// Its rows are `reference_from_stream⁻¹ · base_from_tip · tip_from_stream`, then grown, then coded.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseStream {
    /// Its times.
    pub timing: Timing,
    /// The frame that the messages name.
    pub frame_id: String,
    /// Pose of the frame that the numbers are in, in the base.
    pub reference_from_stream: Pose,
    /// Pose of the frame that the numbers are of, in the tip.
    pub tip_from_stream: Pose,
    /// Scale of the logged over the true position, minus 1.
    pub growth: f64,
    /// What became of the pose on its way into the log.
    pub coding: Coding,
    /// Whether it was inverted as a whole before that.
    pub inverted: bool,
    /// Whether positions are in mm.
    pub in_millimetres: bool,
    /// What positions are multiplied by beside that: 100 where they are cm.
    pub times: f64,
    /// The axes that the numbers are in, seen from the right ones; mirrored where the determinant is −1.
    pub axes: Option<Matrix3<f64>>,
    /// A coordinate that never changes, and what it says, m.
    pub constant: Option<(usize, f64)>,
    /// What stands where the quaternion should, where nobody sets it: x, y, z, w.
    pub unset: Option<[f64; 4]>,
    /// When the tool is elsewhere.
    pub slip: Option<ToolSlip>,
    /// Scale of the quaternions: 1 where they are of unit norm.
    pub quaternion_norm: f64,
    /// Where this says how, the poses are on [`NUMBERS`](super::NUMBERS) instead: six bare numbers, position in m and
    /// rotation in this convention, rad. Such a message has no stamp and no frame.
    pub as_numbers: Option<Convention>,
    /// Whether the three numbers of such a rotation are degrees.
    pub numbers_in_degrees: bool,
    /// Samples by their number from 0, and how far off each is, m.
    pub strays: Vec<(usize, Vec3)>,
    /// From when to when the stream goes on saying what it said first, s from the start.
    pub stuck_s: Option<(f64, f64)>,
}

/// The transforms of the arm's joints, as a state publisher computes them from the joint states, and
/// the fixed ones.
#[derive(Debug, Clone, PartialEq)]
pub struct TfStream {
    /// Its times. Rate and phase of the joint states, or a fraction of that rate, give it stamps
    /// that are copies of theirs.
    pub timing: Timing,
    /// What became of the transforms on their way into the log.
    pub coding: Coding,
    /// Whether /tf_static is there.
    pub with_static: bool,
    /// A second program that publishes them.
    pub second: Option<SecondPublisher>,
    /// Transforms in /tf_static beside the arm's own.
    pub others: Vec<OtherTransform>,
}

/// A transform that is none of the arm's own.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherTransform {
    /// The frame above.
    pub parent: String,
    /// The frame below.
    pub child: String,
    /// Pose of the child in the parent.
    pub parent_from_child: Pose,
}

/// The IMU at the tip: gyro, accelerometer and an orientation in a world of its own yaw.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuStream {
    /// Its times.
    pub timing: Timing,
    /// `tip_from_imu` as /tf_static has it.
    pub tip_from_imu: Pose,
    /// How the IMU is truly mounted: `imu_as_published_from_imu`.
    pub mount_error: Pose,
    /// Whether the orientation is logged; where not, its covariance says so (REP 145).
    pub with_orientation: bool,
    /// Yaw of the base in the IMU's world at the start, rad. No fault.
    pub world_yaw_rad: f64,
    /// By how much the logged yaw runs ahead of the true one, rad/s about the base's z axis.
    pub yaw_drift_rad_s: f64,
    /// When the logged yaw jumps, s after the start, and by how much, rad.
    pub yaw_jumps: Vec<(f64, f64)>,
    /// Density of a random walk of the logged yaw, rad/√s.
    pub yaw_walk_rad_rt_s: f64,
    /// Bias of the gyro in its own frame, rad/s.
    pub gyro_bias_rad_s: Vec3,
    /// What the gyro makes of true rates before the bias: 1 on the diagonal where the scale is right,
    /// 0 beside it where the axes are square.
    pub gyro_from_rate: Matrix3<f64>,
    /// What the gyro reads beside that at the start, rad/s in its own frame, and the time constant with which it
    /// settles, s.
    pub gyro_warms_up: Option<(Vec3, f64)>,
    /// By how much the logged yaw runs ahead of the true one in the end, rad, and the time constant with which
    /// it gets there, s.
    pub yaw_warms_up: Option<(f64, f64)>,
    /// By how much the logged yaw is ahead, rad, as a sine of the heading of the IMU's x axis and as one of
    /// twice that, each with its phase, rad: hard and soft iron.
    pub yaw_by_heading: [(f64, f64); 2],
    /// What rates are multiplied by before they are logged: 180/π where they are °/s.
    pub gyro_times: f64,
    /// What specific forces are multiplied by before they are logged: 1/9.80665 where they are in g.
    pub force_times: f64,
    /// What became of the orientation on its way into the log.
    pub coding: Coding,
}

/// What became of a pose on its way into the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coding {
    /// Nothing.
    #[default]
    Faithful,
    /// The rotation was shown as three numbers and these were read otherwise.
    Misread(Misreading),
    /// The quaternion's components were taken in the wrong order.
    Slipped(QuaternionSlip),
    /// The rotation was transposed, the position left.
    Transposed,
    /// The whole pose was inverted.
    Inverted,
}

impl Timing {
    /// `rate_hz` messages a second from `phase_s` after the start on, in time and on the recorder's
    /// clock.
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
