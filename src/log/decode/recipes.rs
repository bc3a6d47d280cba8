//! Maps fields of message types to slots and columns.

use super::builder::{Builder, NamedPart, Part};
use super::row::{self, Slot};
use super::schema::canonical;

/// Slots by path from the message's root.
pub(super) type Fields = &'static [(&'static str, Slot)];

/// Whether the field at `path` is within the message or array at `above`.
pub(super) fn is_below(path: &str, above: &str) -> bool {
    path.strip_prefix(above).is_some_and(|rest| rest.starts_with('.'))
}

pub(crate) struct Recipe {
    /// Names such as `package/Type`, or `package.Type` outside ROS.
    type_names: &'static [&'static str],
    /// Array whose elements are rows; without it, a message is one row.
    pub(super) row_list: Option<&'static str>,
    /// One per version of the type; the first whose fields all exist is used.
    pub(super) layouts: &'static [Fields],
    /// The first has the topic's own name. If rows come from an array there is one part, and rows have
    /// groups ([`Row::group`](row::Row::group)).
    parts: &'static [NamedPart],
}

impl Recipe {
    /// Accepts `package/Type` and `package/msg/Type`.
    pub(crate) fn for_type(type_name: &str) -> Option<&'static Recipe> {
        let type_name = canonical(type_name);
        RECIPES.iter().find(|recipe| recipe.type_names.contains(&type_name.as_ref()))
    }

    pub(crate) fn builder(&self) -> Builder {
        let is_stamp = |(_, slot): &(&str, Slot)| *slot == Slot::Stamp;
        Builder::new(self.parts, self.layouts.iter().any(|fields| fields.iter().any(is_stamp)))
    }
}

macro_rules! layout {
    ($($field:expr),* $(,)?) => { &[&[$($field),*]] };
}

/// A position and a quaternion in two nested messages.
macro_rules! pose_slots {
    ($position:literal, $orientation:literal $(, $other:expr)*) => {
        &[
            $($other,)*
            (concat!($position, ".x"), Slot::Number(row::POSITION)),
            (concat!($position, ".y"), Slot::Number(row::POSITION + 1)),
            (concat!($position, ".z"), Slot::Number(row::POSITION + 2)),
            (concat!($orientation, ".x"), Slot::Number(row::QUATERNION)),
            (concat!($orientation, ".y"), Slot::Number(row::QUATERNION + 1)),
            (concat!($orientation, ".z"), Slot::Number(row::QUATERNION + 2)),
            (concat!($orientation, ".w"), Slot::Number(row::QUATERNION + 3)),
        ]
    };
}

macro_rules! vector_slots {
    ($vector:literal, $first:expr) => {
        [
            (concat!($vector, ".x"), Slot::Number($first)),
            (concat!($vector, ".y"), Slot::Number($first + 1)),
            (concat!($vector, ".z"), Slot::Number($first + 2)),
        ]
    };
}
const POINT: [(&str, Slot); 3] = vector_slots!("point", row::POSITION);
const VECTOR: [(&str, Slot); 3] = vector_slots!("vector", row::POSITION);
const GYRO: [(&str, Slot); 3] = vector_slots!("angular_velocity", row::GYRO);
const ACCEL: [(&str, Slot); 3] = vector_slots!("linear_acceleration", row::ACCEL);

const STAMP: (&str, Slot) = ("header.stamp", Slot::Stamp);
const FRAME: (&str, Slot) = ("header.frame_id", Slot::Text(row::FRAME));
const NAMES: (&str, Slot) = ("joint_names", Slot::Names);

static RECIPES: &[Recipe] = &[
    Recipe {
        type_names: &["sensor_msgs/JointState"],
        row_list: None,
        layouts: layout![
            STAMP,
            FRAME,
            ("name", Slot::Names),
            ("position", Slot::List(row::VALUES)),
            ("velocity", Slot::List(row::VELOCITIES)),
        ],
        parts: &[("", Part::joints)],
    },
    Recipe {
        type_names: &["control_msgs/JointTrajectoryControllerState"],
        row_list: None,
        // ROS 2 dropped the names `desired` and `actual` in 2023.
        layouts: &[
            &[
                STAMP,
                FRAME,
                NAMES,
                ("feedback.positions", Slot::List(row::VALUES)),
                ("feedback.velocities", Slot::List(row::VELOCITIES)),
                ("reference.positions", Slot::List(row::REFERENCE)),
                ("reference.velocities", Slot::List(row::REFERENCE_VELOCITIES)),
            ],
            &[
                STAMP,
                FRAME,
                NAMES,
                ("actual.positions", Slot::List(row::VALUES)),
                ("actual.velocities", Slot::List(row::VELOCITIES)),
                ("desired.positions", Slot::List(row::REFERENCE)),
                ("desired.velocities", Slot::List(row::REFERENCE_VELOCITIES)),
            ],
        ],
        parts: &[("", Part::joints), (".reference", Part::reference)],
    },
    Recipe {
        // A single point is a set-point; the last point of a trajectory is its goal.
        type_names: &["trajectory_msgs/JointTrajectory"],
        row_list: Some("points"),
        layouts: layout![
            STAMP,
            FRAME,
            NAMES,
            ("points.positions", Slot::List(row::REFERENCE)),
            ("points.velocities", Slot::List(row::REFERENCE_VELOCITIES)),
        ],
        parts: &[(".setpoint", Part::reference)],
    },
    Recipe {
        // ROS 1 spells the matrix in capitals.
        type_names: &[
            "franka_msgs/FrankaState", "franka_control/FrankaState", "franka_hw/FrankaState",
        ],
        row_list: None,
        layouts: &[
            &[
                STAMP,
                FRAME,
                ("q", Slot::List(row::VALUES)),
                ("dq", Slot::List(row::VELOCITIES)),
                ("O_T_EE", Slot::List(row::MATRIX)),
            ],
            &[
                STAMP,
                FRAME,
                ("q", Slot::List(row::VALUES)),
                ("dq", Slot::List(row::VELOCITIES)),
                ("o_t_ee", Slot::List(row::MATRIX)),
            ],
        ],
        parts: &[("", Part::franka_joints), (".O_T_EE", Part::matrix)],
    },
    Recipe {
        type_names: &["franka_msgs/FrankaRobotState"],
        row_list: None,
        layouts: &[pose_slots!(
            "o_t_ee.pose.position",
            "o_t_ee.pose.orientation",
            STAMP,
            ("measured_joint_state.name", Slot::Names),
            ("measured_joint_state.position", Slot::List(row::VALUES)),
            ("measured_joint_state.velocity", Slot::List(row::VELOCITIES)),
            ("o_t_ee.header.frame_id", Slot::Text(row::FRAME))
        )],
        parts: &[("", Part::joints), (".o_t_ee", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/PoseStamped"],
        row_list: None,
        layouts: &[pose_slots!("pose.position", "pose.orientation", STAMP, FRAME)],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/Pose"],
        row_list: None,
        layouts: &[pose_slots!("position", "orientation")],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/PointStamped"],
        row_list: None,
        layouts: layout![STAMP, FRAME, POINT[0], POINT[1], POINT[2]],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/PoseWithCovarianceStamped"],
        row_list: None,
        layouts: &[pose_slots!("pose.pose.position", "pose.pose.orientation", STAMP, FRAME)],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/PoseArray"],
        row_list: Some("poses"),
        layouts: &[pose_slots!("poses.position", "poses.orientation", STAMP, FRAME)],
        parts: &[("", Part::numbered_poses)],
    },
    Recipe {
        type_names: &["gazebo_msgs/LinkStates", "gazebo_msgs/ModelStates"],
        row_list: Some("pose"),
        layouts: &[pose_slots!("pose.position", "pose.orientation", ("name", Slot::Names))],
        parts: &[("", Part::named_poses)],
    },
    Recipe {
        type_names: &["nav_msgs/Odometry"],
        row_list: None,
        layouts: &[pose_slots!(
            "pose.pose.position",
            "pose.pose.orientation",
            STAMP,
            FRAME,
            ("child_frame_id", Slot::Text(row::CHILD))
        )],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["geometry_msgs/TransformStamped"],
        row_list: None,
        layouts: &[pose_slots!(
            "transform.translation",
            "transform.rotation",
            STAMP,
            FRAME,
            ("child_frame_id", Slot::Text(row::CHILD))
        )],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["tf2_msgs/TFMessage", "tf/tfMessage"],
        row_list: Some("transforms"),
        layouts: &[pose_slots!(
            "transforms.transform.translation",
            "transforms.transform.rotation",
            ("transforms.header.stamp", Slot::Stamp),
            ("transforms.header.frame_id", Slot::Text(row::FRAME)),
            ("transforms.child_frame_id", Slot::Text(row::CHILD))
        )],
        parts: &[("", Part::transforms)],
    },
    Recipe {
        type_names: &["foxglove.FrameTransform", "foxglove_msgs/FrameTransform"],
        row_list: None,
        layouts: &[pose_slots!(
            "translation",
            "rotation",
            ("timestamp", Slot::Stamp),
            ("parent_frame_id", Slot::Text(row::FRAME)),
            ("child_frame_id", Slot::Text(row::CHILD))
        )],
        parts: &[("", Part::transforms)],
    },
    Recipe {
        type_names: &["foxglove.FrameTransforms", "foxglove_msgs/FrameTransforms"],
        row_list: Some("transforms"),
        layouts: &[pose_slots!(
            "transforms.translation",
            "transforms.rotation",
            ("transforms.timestamp", Slot::Stamp),
            ("transforms.parent_frame_id", Slot::Text(row::FRAME)),
            ("transforms.child_frame_id", Slot::Text(row::CHILD))
        )],
        parts: &[("", Part::transforms)],
    },
    Recipe {
        type_names: &["foxglove.PoseInFrame", "foxglove_msgs/PoseInFrame"],
        row_list: None,
        layouts: &[pose_slots!(
            "pose.position",
            "pose.orientation",
            ("timestamp", Slot::Stamp),
            ("frame_id", Slot::Text(row::FRAME))
        )],
        parts: &[("", Part::poses)],
    },
    Recipe {
        type_names: &["foxglove.PosesInFrame", "foxglove_msgs/PosesInFrame"],
        row_list: Some("poses"),
        layouts: &[pose_slots!(
            "poses.position",
            "poses.orientation",
            ("timestamp", Slot::Stamp),
            ("frame_id", Slot::Text(row::FRAME))
        )],
        parts: &[("", Part::numbered_poses)],
    },
    Recipe {
        type_names: &["sensor_msgs/Imu"],
        row_list: None,
        layouts: layout![
            STAMP,
            FRAME,
            ("orientation.x", Slot::Number(row::QUATERNION)),
            ("orientation.y", Slot::Number(row::QUATERNION + 1)),
            ("orientation.z", Slot::Number(row::QUATERNION + 2)),
            ("orientation.w", Slot::Number(row::QUATERNION + 3)),
            ("orientation_covariance", Slot::List(row::VALUES)),
            GYRO[0],
            GYRO[1],
            GYRO[2],
            ACCEL[0],
            ACCEL[1],
            ACCEL[2],
        ],
        parts: &[("", Part::imu)],
    },
    Recipe {
        type_names: &["geometry_msgs/QuaternionStamped"],
        row_list: None,
        layouts: layout![
            STAMP,
            ("quaternion.x", Slot::Number(row::QUATERNION)),
            ("quaternion.y", Slot::Number(row::QUATERNION + 1)),
            ("quaternion.z", Slot::Number(row::QUATERNION + 2)),
            ("quaternion.w", Slot::Number(row::QUATERNION + 3)),
        ],
        parts: &[("", Part::quaternion)],
    },
    Recipe {
        type_names: &["geometry_msgs/Vector3Stamped"],
        row_list: None,
        layouts: layout![STAMP, VECTOR[0], VECTOR[1], VECTOR[2]],
        parts: &[("", Part::vector)],
    },
    Recipe {
        type_names: &["std_msgs/Float64MultiArray"],
        row_list: None,
        layouts: layout![("data", Slot::List(row::VALUES))],
        parts: &[("", Part::array)],
    },
    Recipe {
        type_names: &["std_msgs/String"],
        row_list: None,
        layouts: layout![("data", Slot::Text(row::BODY))],
        parts: &[("", Part::text)],
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_an_array_are_of_one_part() {
        let several = RECIPES.iter().filter(|recipe| recipe.row_list.is_some());
        let parts: Vec<usize> = several.map(|recipe| recipe.parts.len()).collect();
        assert!(parts.len() > 2 && parts.iter().all(|&count| count == 1), "{parts:?}");
    }
}
