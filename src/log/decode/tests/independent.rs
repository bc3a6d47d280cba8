//! Messages written by other programs decode to the original numbers.

use super::super::*;
use super::vectors::*;
use super::{assert_same, decode_all};
use ground::stream::{Columns, JointColumns, PoseColumns};

const STAMP: i64 = 1_700_000_000_123_456_789;
const TURNED: [f64; 4] = [0.0, 0.0, 0.6, 0.8];

fn columns(format: Format<'_>, hexadecimal: &str) -> Vec<(&'static str, Columns)> {
    let (parts, error) = decode_all(format, &[bytes(hexadecimal)]);
    assert_eq!(error, None);
    parts.into_iter().map(|(name, columns)| (name, columns.unwrap())).collect()
}

fn only(format: Format<'_>, hexadecimal: &str) -> Columns {
    let mut parts = columns(format, hexadecimal);
    assert_eq!((parts.len(), parts[0].0), (1, ""));
    parts.remove(0).1
}

fn bytes(hexadecimal: &str) -> Vec<u8> {
    let digits = hexadecimal.as_bytes().as_chunks::<2>().0;
    digits
        .iter()
        .map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

fn ros1<'a>(type_name: &'a str, definition: &'a str) -> Format<'a> {
    let (encoding, schema_encoding) = ("ros1", "ros1msg");
    Format { encoding, type_name, schema_encoding, schema: definition.as_bytes() }
}

/// As in SQLite bags: without a definition.
fn bare(type_name: &str) -> Format<'_> {
    Format { encoding: "cdr", type_name, schema_encoding: "", schema: b"" }
}

fn protobuf(type_name: &str) -> Format<'_> {
    let schema = include_bytes!("foxglove.bin");
    Format { encoding: "protobuf", type_name, schema_encoding: "protobuf", schema }
}

fn json(type_name: &str) -> Format<'_> {
    Format { encoding: "json", type_name, schema_encoding: "jsonschema", schema: b"{}" }
}

fn hexadecimal(text: &str) -> String {
    text.bytes().map(|byte| format!("{byte:02x}")).collect()
}

fn assert_joints(joints: &JointColumns, expected: &[(&str, f64, f64)]) {
    assert_eq!(joints.times.header, [STAMP]);
    assert!(!joints.times.unstamped);
    let found: Vec<_> = joints
        .joints
        .iter()
        .map(|joint| (joint.name.as_str(), joint.position[0], joint.velocity[0]))
        .collect();
    assert_eq!(found, expected);
}

fn assert_transforms(groups: &[PoseColumns]) {
    let [first, second] = groups else { panic!("{groups:?}") };
    assert_eq!((first.frame_id.as_str(), first.child_frame_id.as_str()), ("base", "link_1"));
    assert_eq!((second.frame_id.as_str(), second.child_frame_id.as_str()), ("link_1", "tool0"));
    assert_eq!(
        (&first.times.header[..], &second.times.header[..]),
        (&[STAMP][..], &[1_700_000_001_000_000_005][..])
    );
    assert_eq!((first.xyz[0], first.q_xyzw[0]), ([0.1, 0.2, 0.3], TURNED));
    assert_eq!((second.xyz[0], second.q_xyzw[0]), ([-1.0, 0.0, 2.5], [0.5, -0.5, 0.5, 0.5]));
}

fn assert_two_poses(groups: &[PoseColumns]) {
    let children: Vec<&str> = groups.iter().map(|group| group.child_frame_id.as_str()).collect();
    assert_eq!(children, ["", "[1]"]);
    for (group, x) in groups.iter().zip([1.0, 4.0]) {
        assert_eq!((group.frame_id.as_str(), &group.times.header[..]), ("map", &[STAMP][..]));
        assert_eq!((group.xyz[0], group.q_xyzw[0]), ([x, 2.0, 3.0], TURNED));
    }
}

#[test]
fn joint_states() {
    for (format, message) in [
        (ros1("sensor_msgs/JointState", ROS1_JOINT_STATE_DEFINITION), ROS1_JOINT_STATE),
        (bare("sensor_msgs/msg/JointState"), ROS2_JOINT_STATE),
    ] {
        let Columns::Joints(joints) = only(format, message) else { panic!("joints") };
        assert_joints(&joints, &[("shoulder", 0.5, 0.125), ("elbow", -1.25, 2.0)]);
        assert_eq!(joints.frame_id, "base");
    }
}

#[test]
fn transforms() {
    let in_json = hexadecimal(JSON_FRAME_TRANSFORMS);
    for (format, message) in [
        (ros1("tf/tfMessage", ROS1_TF_DEFINITION), ROS1_TF),
        (ros1("tf2_msgs/TFMessage", ROS1_TF_DEFINITION), ROS1_TF),
        (bare("tf2_msgs/msg/TFMessage"), ROS2_TF),
        (protobuf("foxglove.FrameTransforms"), PROTO_FRAME_TRANSFORMS),
        (json("foxglove.FrameTransforms"), &in_json),
    ] {
        let Columns::Transforms(groups) = only(format, message) else { panic!("transforms") };
        assert_transforms(&groups);
    }
    let single = only(protobuf("foxglove.FrameTransform"), PROTO_FRAME_TRANSFORM);
    let Columns::Transforms(groups) = single else { panic!("transforms") };
    assert_eq!((groups.len(), groups[0].xyz[0]), (1, [0.1, 0.2, 0.3]));
}

#[test]
fn imu_readings() {
    for (format, message) in [
        (ros1("sensor_msgs/Imu", ROS1_IMU_DEFINITION), ROS1_IMU),
        (bare("sensor_msgs/msg/Imu"), ROS2_IMU),
    ] {
        let Columns::Imu(imu) = only(format, message) else { panic!("imu") };
        assert_eq!((&imu.times.header[..], imu.frame_id.as_str()), (&[STAMP][..], "imu"));
        assert_eq!(imu.q_xyzw, [[0.0, 0.6, 0.0, 0.8]]);
        assert_eq!(imu.gyro, [[0.1, 0.2, 0.3]]);
        assert_eq!(imu.accel, [[1.0, 2.0, 9.5]]);
    }
}

#[test]
fn several_poses_in_a_message() {
    let in_json = hexadecimal(JSON_POSES_IN_FRAME);
    for (format, message) in [
        (ros1("geometry_msgs/PoseArray", ROS1_POSE_ARRAY_DEFINITION), ROS1_POSE_ARRAY),
        (bare("geometry_msgs/msg/PoseArray"), ROS2_POSE_ARRAY),
        (protobuf("foxglove.PosesInFrame"), PROTO_POSES_IN_FRAME),
        (json("foxglove.PosesInFrame"), &in_json),
    ] {
        let Columns::Poses(groups) = only(format, message) else { panic!("poses") };
        assert_two_poses(&groups);
    }
}

#[test]
fn the_states_of_a_trajectory_controller_of_any_year() {
    let type_name = "control_msgs/msg/JointTrajectoryControllerState";
    let new = ROS2_CONTROLLER_STATE_DEFINITION.as_bytes();
    let described = Format { schema_encoding: "ros2msg", schema: new, ..bare(type_name) };
    for (format, message) in [
        (ros1(type_name, ROS1_CONTROLLER_STATE_DEFINITION), ROS1_CONTROLLER_STATE),
        (described, ROS2_CONTROLLER_STATE),
        (bare(type_name), ROS2_CONTROLLER_STATE),
    ] {
        let parts = columns(format, message);
        let [("", Columns::Joints(feedback)), (".reference", Columns::Joints(reference))] =
            parts.as_slice()
        else {
            panic!("{parts:?}")
        };
        assert_joints(feedback, &[("a", 1.5, 0.75), ("b", 2.5, 1.25)]);
        assert_joints(reference, &[("a", 1.0, 0.5), ("b", 2.0, 1.0)]);
    }
}

#[test]
fn the_state_of_a_franka_arm_is_joints_and_a_pose() {
    let format = ros1("franka_msgs/FrankaState", ROS1_FRANKA_STATE_DEFINITION);
    let parts = columns(format, ROS1_FRANKA_STATE);
    let [("", Columns::Joints(joints)), (".O_T_EE", Columns::Array(matrix))] = parts.as_slice()
    else {
        panic!("{parts:?}")
    };
    assert!(joints.unnamed);
    let names: Vec<&str> = joints.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!((names.len(), names[0], names[6]), (7, "panda_joint1", "panda_joint7"));
    let positions: Vec<f64> = joints.joints.iter().map(|joint| joint.position[0]).collect();
    assert_same(&positions, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]);
    assert_eq!(joints.joints[6].velocity, [7.0]);
    assert_eq!((matrix.width, &matrix.times.header[..]), (16, &[STAMP][..]));
    assert_eq!(matrix.row(0)[12..], [0.3, 0.1, 0.5, 1.0]);

    let parts = columns(bare("franka_msgs/msg/FrankaRobotState"), ROS2_FRANKA_ROBOT_STATE);
    let [("", Columns::Joints(joints)), (".o_t_ee", Columns::Poses(poses))] = parts.as_slice()
    else {
        panic!("{parts:?}")
    };
    assert_joints(joints, &[("fr3_joint1", 0.25, 1.0), ("fr3_joint2", 0.5, 2.0)]);
    assert_eq!((poses[0].frame_id.as_str(), poses[0].xyz[0]), ("fr3_link0", [1.0, 2.0, 3.0]));
}

#[test]
fn the_states_of_a_simulation_have_names_and_no_stamp() {
    let Columns::Poses(links) = only(bare("gazebo_msgs/msg/LinkStates"), ROS2_LINK_STATES) else {
        panic!("poses")
    };
    let children: Vec<&str> = links.iter().map(|group| group.child_frame_id.as_str()).collect();
    assert_eq!(children, ["link", "tool0"]);
    assert!(links.iter().all(|group| group.frame_id == "world" && group.times.unstamped));
    assert_eq!(links[1].xyz, [[4.0, 2.0, 3.0]]);
}

#[test]
fn every_truncated_message_is_an_error_unless_only_unread_fields_are_missing() {
    for (format, message, read) in [
        (ros1("tf/tfMessage", ROS1_TF_DEFINITION), ROS1_TF, 178),
        (bare("sensor_msgs/msg/JointState"), ROS2_JOINT_STATE, 104 - 8),
        (bare("franka_msgs/msg/FrankaRobotState"), ROS2_FRANKA_ROBOT_STATE, 1173 - 1),
    ] {
        let message = bytes(message);
        for length in 0..read {
            let (_, error) = decode_all(format, &[message[..length].to_vec()]);
            assert!(error.is_some(), "{length} bytes of {} were enough", format.type_name);
        }
    }
    // A protocol buffer cut between two fields is still valid. No cut may panic.
    let message = bytes(PROTO_POSES_IN_FRAME);
    let broken = (0..message.len())
        .filter(|&length| {
            let cut = message[..length].to_vec();
            decode_all(protobuf("foxglove.PosesInFrame"), &[cut]).1.is_some()
        })
        .count();
    assert!(broken > message.len() - 6, "{broken}");
}
