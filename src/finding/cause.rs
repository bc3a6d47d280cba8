use crate::geometry::{
    AngleUnit, Axes, LengthScale, Misread, Pose, Rotation, RotationEncoding, RotationError,
};
use crate::robot::DhConvention;
use crate::stats::Measured;

/// Cause of a finding. Corrections and pictures match it exhaustively.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Cause {
    /// Joint zero offset: `q_true = q_reported + offset`.
    JointZero {
        /// In rad or m.
        offset: Measured,
        /// Prismatic.
        is_prismatic: bool,
    },
    /// Joint compliance, which depends on motion or configuration.
    Compliance,
    /// Wrong unit of joint positions; rad or m per logged unit.
    JointUnit(f64),
    /// Wrong scales, in the order of the chain.
    JointScale(Vec<JointScaleCorrection>),
    /// Joint coupled to another: `q_true = q_reported + factor · q_with`.
    JointCoupling {
        /// Driving joint.
        with: String,
        /// Factor.
        factor: Measured,
    },
    /// Positions published under other joints' names.
    JointOrder {
        /// In the order of the numbers.
        is: Vec<String>,
        /// In the order of the names.
        read_as: Vec<String>,
    },
    /// Actual convention of the DH table.
    DhConvention(DhConvention),
    /// Position errors that grow with reach.
    RadialScale,
    /// The log belongs to this robot.
    OtherRobot(String),
    /// The kinematic model does not explain the log.
    UnexplainedResidual,
    /// No known cause reconciles poses and joint states.
    Disagreement {
        /// Its size, as a clause.
        description: String,
    },
    /// Orientations follow the arm in no known convention, positions do.
    UnreadOrientations,
    /// Latency, s: a sample stamped *t* was true at *t − latency*.
    Latency(Measured),
    /// Rate of change of the latency, s/s.
    ClockSkew(Measured),
    /// A parameter changes during the run.
    ParameterChange,
    /// The latency is not constant.
    VaryingLatency,
    /// Misinterpreted rotations or inverted poses.
    Rotation(RotationError),
    /// Inferred encoding of bare numbers.
    InferredEncoding {
        /// Rotation encoding.
        coding: RotationEncoding,
        /// Length unit of positions.
        length: LengthScale,
        /// Angle unit.
        angle: AngleUnit,
    },
    /// Wrong angle unit.
    AngleUnit(Misread<AngleUnit>),
    /// Wrong length unit.
    LengthUnit(Misread<LengthScale>),
    /// Axes other than x forward, y left, z up.
    Axes {
        /// Axes of positions.
        positions: Axes,
        /// Axes of rotations.
        rotations: Axes,
    },
    /// Other reference frame: `reference_from_stream`.
    ReferenceFrame(Pose),
    /// Other tool frame: `tip_from_stream`.
    ToolFrame(Pose),
    /// /tf disagrees with FK of the joint states.
    TfDisagrees,
    /// Yaw drift of an IMU, rad/s.
    YawDrift(Measured),
    /// Yaw step of an IMU.
    YawJump,
    /// Mount of an IMU: `link_from_imu`.
    ImuMount(Rotation),
    /// Pose of a camera that differs from the log's frames.
    CameraMount {
        /// Camera in the hand; `None` if the motion does not show it.
        in_hand: Option<bool>,
        /// Parent frame; `None` if the log does not name it.
        parent: Option<String>,
        /// `parent_from_camera`.
        pose: Pose,
    },
    /// The frames do not form a tree.
    FrameTree,
    /// Wrong stamps or rates.
    Stamps,
    /// A fault with a picture but no correction.
    Pictured(Picture),
    /// A fault without correction or picture.
    #[default]
    Other,
}

impl Cause {
    /// Whether its correction is of joints or their model, not of one stream.
    pub fn is_of_joints(&self) -> bool {
        matches!(
            self,
            Cause::JointZero { .. }
                | Cause::JointUnit(_)
                | Cause::JointScale(_)
                | Cause::JointCoupling { .. }
                | Cause::JointOrder { .. }
                | Cause::DhConvention(_)
        )
    }

    /// Whether a value corrects the cause.
    pub fn has_correction(&self) -> bool {
        match self {
            Cause::RadialScale
            | Cause::Compliance
            | Cause::OtherRobot(_)
            | Cause::UnexplainedResidual
            | Cause::Disagreement { .. }
            | Cause::UnreadOrientations
            | Cause::VaryingLatency
            | Cause::ParameterChange
            | Cause::TfDisagrees
            | Cause::YawDrift(_)
            | Cause::YawJump
            | Cause::FrameTree
            | Cause::Stamps
            | Cause::Pictured(_)
            | Cause::Other => false,
            Cause::JointZero { .. }
            | Cause::JointUnit(_)
            | Cause::JointScale(_)
            | Cause::JointCoupling { .. }
            | Cause::JointOrder { .. }
            | Cause::DhConvention(_)
            | Cause::Latency(_)
            | Cause::ClockSkew(_)
            | Cause::Rotation(_)
            | Cause::InferredEncoding { .. }
            | Cause::AngleUnit(_)
            | Cause::LengthUnit(_)
            | Cause::Axes { .. }
            | Cause::ReferenceFrame(_)
            | Cause::ToolFrame(_)
            | Cause::ImuMount(_) => true,
            Cause::CameraMount { in_hand, parent, .. } => in_hand.is_some() && parent.is_some(),
        }
    }
}

/// Data that shows a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Picture {
    /// Spectrum and path of the strongest vibration.
    Vibration,
    /// Camera observations compared with the hand.
    HandEye,
    /// Tip along a commanded line.
    Line,
    /// Goals and poses at rest.
    RestError,
    /// Norms of rotations.
    RotationNorm,
    /// Axes of an IMU in its link.
    ImuAxes,
    /// Gyro signal at rest.
    Gyro,
    /// Up direction of an accelerometer at rest.
    Tilt,
    /// Positions and speeds of a joint.
    Joint,
    /// Errors and sample times of a stream.
    Stream,
}

/// Scale of a joint: `q_true = factor · q_reported + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointScaleCorrection {
    /// Joint.
    pub joint: String,
    /// Factor.
    pub factor: Measured,
    /// Offset, rad or m, if the numbers have their own zero.
    pub offset: Option<f64>,
    /// Prismatic.
    pub is_prismatic: bool,
}
