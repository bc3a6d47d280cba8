//! Causes: what is wrong, with the amounts that mend it.

use crate::geometry::{AngleUnit, Axes, Coding, LengthScale, Pose, Rotation, RotationSlip, Slip};
use crate::robot::DhConvention;
use crate::stats::Measured;

/// The cause that a finding names. Corrections and pictures are made of it by exhaustive matches, so
/// that a new cause does not compile until each says what it does with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Cause {
    /// The zero of a joint: `q_true = q_reported + offset`.
    JointZero {
        /// The offset, rad or m.
        offset: Measured,
        /// Whether the joint slides.
        slides: bool,
    },
    /// A joint gives: by how much hangs on its motion or on the arm's posture.
    Bend,
    /// The positions of a joint are in another unit: rad or m for each.
    JointUnit(f64),
    /// Joints that have a scale of their own, in the order of the chain.
    JointScale(Vec<JointScaling>),
    /// The positions of the joints stand under other joints' names.
    JointOrder {
        /// Whose number stands at each place.
        is: Vec<String>,
        /// Whose name stands at each place.
        read_as: Vec<String>,
    },
    /// The rows of the DH table are of this convention, not of the other.
    Dh(DhConvention),
    /// Position errors grow with reach.
    Growth,
    /// The log is of another robot than the one named; of this one.
    OtherRobot(String),
    /// The model does not explain the log.
    Model,
    /// Nothing makes poses and joint states those of one arm.
    Disagreement {
        /// By how much they disagree, in a clause.
        said: String,
    },
    /// What is stamped *t* was true at *t − latency*, s.
    Latency(Measured),
    /// By how much the latency grows with each second, s/s.
    Skew(Measured),
    /// Something of the arm or of its poses changes in mid-run.
    Changes,
    /// The latency is not constant.
    UnsteadyLatency,
    /// Rotations are misread, or poses are inverted.
    Rotation(RotationSlip),
    /// The reading of bare numbers of which nothing is declared.
    Bare {
        /// How the rotations are coded.
        coding: Coding,
        /// The unit of the positions.
        length: LengthScale,
        /// The unit of the angles.
        angle: AngleUnit,
    },
    /// Angles are in another unit than they were read as.
    AngleUnit(Slip<AngleUnit>),
    /// Positions are in another unit than they were read as.
    LengthUnit(Slip<LengthScale>),
    /// Positions or rotations are in other axes than x forward, y left, z up.
    Axes {
        /// The axes of the positions.
        positions: Axes,
        /// The axes of the rotations.
        rotations: Axes,
    },
    /// Poses are in a frame of their own: `reference_from_stream`.
    Reference(Pose),
    /// Poses are of a frame of their own: `tip_from_stream`.
    Tool(Pose),
    /// /tf disagrees with FK of the joint states.
    TfDisagrees,
    /// The yaw of an IMU drifts against the arm, rad/s.
    YawDrift(Measured),
    /// The yaw of an IMU jumps against the arm.
    YawJump,
    /// The orientation of an IMU in its link: `link_from_imu`.
    ImuMount(Rotation),
    /// The pose of a camera in its parent, which the log's frames have elsewhere.
    CameraMount {
        /// Whether the hand carries the camera; `None` where the motion does not tell.
        in_hand: Option<bool>,
        /// The frame that the pose is in; `None` where the log does not name it.
        parent: Option<String>,
        /// `parent_from_camera`.
        pose: Pose,
    },
    /// The frames are no tree.
    Frames,
    /// Stamps or rates are not what they should be.
    Stamps,
    /// A fault that no file mends, by what shows it.
    Seen(Sight),
    /// A fault that no file mends and that its amount shows.
    #[default]
    Other,
}

/// What shows a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// The spectrum of a path, and the path where it shakes most.
    Shake,
    /// What a camera sees against the hand.
    HandEye,
    /// The tip beside a commanded line.
    Line,
    /// Goals and where the arm came to rest.
    Rest,
    /// The norms of rotations.
    Norm,
    /// The axes of an IMU in its link.
    ImuAxes,
    /// A gyro while the arm rests.
    Gyro,
    /// Where an accelerometer feels up while the arm rests.
    Tilt,
    /// A joint's positions and speeds.
    Joint,
    /// The errors of a stream, and when it was there.
    Stream,
}

/// A joint whose positions must be scaled: `q_true = factor · q_reported + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointScaling {
    /// Name of the joint.
    pub joint: String,
    /// The factor.
    pub factor: Measured,
    /// The offset, rad or m, where the scale has one.
    pub offset: Option<f64>,
    /// Whether the joint slides.
    pub slides: bool,
}
