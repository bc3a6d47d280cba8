//! Messages of the log: topic, type, definition, encoding.

use super::cdr::CdrWriter;
use super::{
    COMMANDED_JOINTS, COMMANDED_POSE, GOAL, IMU, JOINT_STATES, NUMBERS, POSE, ROBOT_DESCRIPTION,
    TARGET, TF, TF_STATIC,
};
use crate::geometry::Vec3;
use crate::time::Stamp;

/// Simultaneous messages are written in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Topic {
    RobotDescription,
    TfStatic,
    JointStates,
    SeparateJoints,
    Imu,
    Pose,
    Numbers,
    Tf,
    Target,
    CommandedPose,
    CommandedJoints,
    Goal,
    Leader,
    Tracker,
}

impl Topic {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::RobotDescription => ROBOT_DESCRIPTION,
            Self::TfStatic => TF_STATIC,
            Self::JointStates | Self::SeparateJoints => JOINT_STATES,
            Self::Imu => IMU,
            Self::Pose | Self::Leader | Self::Tracker => POSE,
            Self::Numbers => NUMBERS,
            Self::Tf => TF,
            Self::Target => TARGET,
            Self::CommandedPose => COMMANDED_POSE,
            Self::CommandedJoints => COMMANDED_JOINTS,
            Self::Goal => GOAL,
        }
    }

    pub(super) fn type_name(self) -> &'static str {
        match self {
            Self::RobotDescription => "std_msgs/msg/String",
            Self::TfStatic | Self::Tf => "tf2_msgs/msg/TFMessage",
            Self::JointStates | Self::SeparateJoints | Self::CommandedJoints => {
                "sensor_msgs/msg/JointState"
            }
            Self::Imu => "sensor_msgs/msg/Imu",
            Self::Numbers => "std_msgs/msg/Float64MultiArray",
            Self::Pose
            | Self::Target
            | Self::CommandedPose
            | Self::Goal
            | Self::Leader
            | Self::Tracker => "geometry_msgs/msg/PoseStamped",
        }
    }

    /// With all nested types, as in rosbag2.
    pub(super) fn definition(self) -> String {
        let (own, parts): (&str, &[(&str, &str)]) = match self {
            Self::RobotDescription => ("string data\n", &[]),
            Self::TfStatic | Self::Tf => (
                "geometry_msgs/TransformStamped[] transforms\n",
                &[TRANSFORM_STAMPED, HEADER, TIME, TRANSFORM, VECTOR3, QUATERNION],
            ),
            Self::JointStates | Self::SeparateJoints | Self::CommandedJoints => (
                "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n\
                 float64[] effort\n",
                &[HEADER, TIME],
            ),
            Self::Numbers => (
                "MultiArrayLayout layout\nfloat64[] data\n",
                &[MULTI_ARRAY_LAYOUT, MULTI_ARRAY_DIMENSION],
            ),
            Self::Imu => (
                "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\n\
                 float64[9] orientation_covariance\n\
                 geometry_msgs/Vector3 angular_velocity\n\
                 float64[9] angular_velocity_covariance\n\
                 geometry_msgs/Vector3 linear_acceleration\n\
                 float64[9] linear_acceleration_covariance\n",
                &[HEADER, TIME, QUATERNION, VECTOR3],
            ),
            Self::Pose
            | Self::Target
            | Self::CommandedPose
            | Self::Goal
            | Self::Leader
            | Self::Tracker => (
                "std_msgs/Header header\nPose pose\n",
                &[HEADER, TIME, POSE_TYPE, POINT, QUATERNION],
            ),
        };
        let mut definition = own.to_owned();
        for (name, fields) in parts {
            definition += &format!("{:=<80}\nMSG: {name}\n{fields}", "");
        }
        definition
    }
}

const HEADER: (&str, &str) =
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const TRANSFORM_STAMPED: (&str, &str) = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\nTransform transform\n",
);
const TRANSFORM: (&str, &str) =
    ("geometry_msgs/Transform", "Vector3 translation\nQuaternion rotation\n");
const POSE_TYPE: (&str, &str) = ("geometry_msgs/Pose", "Point position\nQuaternion orientation\n");
const MULTI_ARRAY_LAYOUT: (&str, &str) =
    ("std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n");
const MULTI_ARRAY_DIMENSION: (&str, &str) =
    ("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n");
const POINT: (&str, &str) = ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n");
const VECTOR3: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) =
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n");

/// Position (m or mm), quaternion x, y, z, w.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LoggedPose {
    pub(super) xyz: [f64; 3],
    pub(super) xyzw: [f64; 4],
}

/// Element of a `tf2_msgs/TFMessage`.
pub(super) struct LoggedTransform<'a> {
    pub(super) parent: &'a str,
    pub(super) child: &'a str,
    pub(super) parent_from_child: LoggedPose,
}

/// In the IMU's frame; gyro in rad/s, specific force in m/s².
#[derive(Clone, Copy)]
pub(super) struct LoggedImu {
    pub(super) orientation_xyzw: Option<[f64; 4]>,
    pub(super) gyro: Vec3,
    pub(super) specific_force: Vec3,
}

pub(super) fn string(data: &str) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.string(data);
    cdr.finish()
}

/// `velocities` may be empty; efforts are.
pub(super) fn joint_state(
    stamp: Stamp,
    names: &[String],
    positions: &[f64],
    velocities: &[f64],
) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.header(stamp, "");
    cdr.sequence_length(names.len());
    for name in names {
        cdr.string(name);
    }
    cdr.f64_sequence(positions);
    cdr.f64_sequence(velocities);
    cdr.f64_sequence(&[]);
    cdr.finish()
}

pub(super) fn pose_stamped(stamp: Stamp, frame_id: &str, pose: LoggedPose) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.header(stamp, frame_id);
    cdr.f64_array(pose.xyz);
    cdr.f64_array(pose.xyzw);
    cdr.finish()
}

/// `Float64MultiArray` without dimensions.
pub(super) fn numbers(data: &[f64]) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.sequence_length(0);
    cdr.sequence_length(0);
    cdr.f64_sequence(data);
    cdr.finish()
}

pub(super) fn tf_message(stamp: Stamp, transforms: &[LoggedTransform]) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.sequence_length(transforms.len());
    for transform in transforms {
        cdr.header(stamp, transform.parent);
        cdr.string(transform.child);
        cdr.f64_array(transform.parent_from_child.xyz);
        cdr.f64_array(transform.parent_from_child.xyzw);
    }
    cdr.finish()
}

/// Covariances are unknown (zeros); −1 in the first entry marks an absent orientation.
pub(super) fn imu(stamp: Stamp, frame_id: &str, sample: &LoggedImu) -> Vec<u8> {
    const UNKNOWN: [f64; 9] = [0.0; 9];
    const ABSENT: [f64; 9] = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    const NO_ROTATION: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
    let mut cdr = CdrWriter::new();
    cdr.header(stamp, frame_id);
    cdr.f64_array(sample.orientation_xyzw.unwrap_or(NO_ROTATION));
    cdr.f64_array(if sample.orientation_xyzw.is_some() { UNKNOWN } else { ABSENT });
    cdr.f64_array(sample.gyro.into());
    cdr.f64_array(UNKNOWN);
    cdr.f64_array(sample.specific_force.into());
    cdr.f64_array(UNKNOWN);
    cdr.finish()
}
