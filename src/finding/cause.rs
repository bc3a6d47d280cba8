//! Causes of faults, with the values that correct them.

use crate::geometry::{
    AngleUnit, Axes, LengthScale, Misread, Pose, Rotation, RotationEncoding, RotationError,
};
use crate::robot::DhConvention;
use crate::stats::Measured;

/// Cause named by a finding. Corrections and pictures match it exhaustively, so a new cause does not
/// compile until each of them handles it.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Cause {
    /// Joint zero offset: `q_true = q_reported + offset`.
    JointZero {
        /// The offset, rad or m.
        offset: Measured,
        /// Whether the joint is prismatic.
        slides: bool,
    },
    /// Joint compliance, whose size depends on the joint's motion or the arm's configuration.
    Compliance,
    /// Joint positions in the wrong unit; rad or m per logged unit.
    JointUnit(f64),
    /// Joints with a wrong scale, in the order of the chain.
    JointScale(Vec<JointScaleCorrection>),
    /// Joint positions published under other joints' names.
    JointOrder {
        /// Joints in the order of the numbers.
        is: Vec<String>,
        /// Joints in the order of the names.
        read_as: Vec<String>,
    },
    /// The DH table uses this convention, not the declared one.
    DhConvention(DhConvention),
    /// Radial scale: position errors that grow with reach.
    RadialScale,
    /// The log belongs to this robot, not to the given one.
    OtherRobot(String),
    /// The kinematic model does not explain the log.
    UnexplainedResidual,
    /// No known cause reconciles poses and joint states.
    Disagreement {
        /// Size of the disagreement, as a clause.
        said: String,
    },
    /// Latency, s: a sample stamped *t* was true at *t − latency*.
    Latency(Measured),
    /// Rate of change of the latency, s/s.
    ClockSkew(Measured),
    /// A parameter of the arm or its poses changes during the run.
    ParameterChange,
    /// The latency is not constant.
    VaryingLatency,
    /// Misinterpreted rotations or inverted poses.
    Rotation(RotationError),
    /// Encoding that was inferred for bare numbers without a declaration.
    InferredEncoding {
        /// Encoding of the rotations.
        coding: RotationEncoding,
        /// Unit of the positions.
        length: LengthScale,
        /// Unit of the angles.
        angle: AngleUnit,
    },
    /// Angles in a different unit from the one assumed.
    AngleUnit(Misread<AngleUnit>),
    /// Positions in a different unit from the one assumed.
    LengthUnit(Misread<LengthScale>),
    /// Positions or rotations whose axes are not x forward, y left, z up.
    Axes {
        /// Axes of the positions.
        positions: Axes,
        /// Axes of the rotations.
        rotations: Axes,
    },
    /// Poses expressed in a different reference frame: `reference_from_stream`.
    ReferenceFrame(Pose),
    /// Poses of a different tool frame: `tip_from_stream`.
    ToolFrame(Pose),
    /// /tf disagrees with FK of the joint states.
    TfDisagrees,
    /// Yaw drift of an IMU against the arm, rad/s.
    YawDrift(Measured),
    /// Yaw step of an IMU against the arm.
    YawJump,
    /// Orientation of an IMU in its link: `link_from_imu`.
    ImuMount(Rotation),
    /// Pose of a camera in its parent, which differs from the log's frames.
    CameraMount {
        /// Whether the camera is in the hand; `None` if the motion does not show it.
        in_hand: Option<bool>,
        /// Frame of the pose; `None` if the log does not name it.
        parent: Option<String>,
        /// `parent_from_camera`.
        pose: Pose,
    },
    /// The frames do not form a tree.
    FrameTree,
    /// Wrong stamps or rates.
    Stamps,
    /// A fault without a correction, with the picture that shows it.
    Pictured(Picture),
    /// A fault without a correction or a picture; the value suffices.
    #[default]
    Other,
}

/// Data that shows a fault in a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    /// Spectrum of a path, and the path at its strongest vibration.
    Vibration,
    /// Camera observations compared with the hand.
    HandEye,
    /// The tip along a commanded line.
    Line,
    /// Goals, and the poses at rest.
    RestError,
    /// Norms of rotations.
    RotationNorm,
    /// Axes of an IMU in its link.
    ImuAxes,
    /// Gyro signal at rest.
    Gyro,
    /// Up direction measured by an accelerometer at rest.
    Tilt,
    /// Positions and speeds of a joint.
    Joint,
    /// Errors of a stream, and the times of its samples.
    Stream,
}

/// Correction of a joint's scale: `q_true = factor · q_reported + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointScaleCorrection {
    /// Name of the joint.
    pub joint: String,
    /// The factor.
    pub factor: Measured,
    /// The offset, rad or m, if the numbers have their own zero.
    pub offset: Option<f64>,
    /// Whether the joint is prismatic.
    pub slides: bool,
}
