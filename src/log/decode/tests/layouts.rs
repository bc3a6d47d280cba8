//! Versions of message types, and missing fields.

use super::super::*;
use super::{cdr, decode_all, refusal};
use crate::testing::Cdr;
use ground::stream::Columns;

const JSON: Format<'_> = Format {
    encoding: "json",
    type_name: "control_msgs/msg/JointTrajectoryControllerState",
    schema_encoding: "",
    schema: b"",
};

#[test]
fn empty_fields_of_an_older_version_do_not_hide_newer_ones() {
    let [new, old] = [
        r#""feedback":{"positions":[0.5,1.5],"velocities":[]},"reference":{"positions":[0.25,1.25]}"#,
        r#""actual":{"positions":[],"velocities":null},"desired":{"positions":[],"velocities":[]}"#,
    ];
    for fields in [format!("{new},{old}"), format!("{old},{new}"), new.to_owned()] {
        let message = format!(r#"{{"header":{{}},"joint_names":["a","b"],{fields}}}"#);
        let (parts, error) = decode_all(JSON, &[message.into_bytes()]);
        assert_eq!(error, None);
        let position = |part: usize| match &parts[part].1 {
            Some(Columns::Joints(joints)) => {
                joints.joints.iter().map(|joint| joint.position[0]).collect::<Vec<_>>()
            }
            other => panic!("{other:?}"),
        };
        assert_eq!([position(0), position(1)], [[0.5, 1.5], [0.25, 1.25]], "{fields}");
    }
}

#[test]
fn a_transform_without_position_and_rotation_is_refused() {
    let protobuf = Format {
        encoding: "protobuf",
        type_name: "foxglove.FrameTransforms",
        schema_encoding: "protobuf",
        schema: include_bytes!("foxglove.bin"),
    };
    // A transform with only a name, and one with only an empty rotation.
    let (named, rotated) = (vec![0x0a, 3, 0x1a, 1, b'c'], vec![0x0a, 2, 0x2a, 0]);
    let (parts, error) = decode_all(protobuf, &[named]);
    assert!(error.is_some_and(|error| error.contains("neither a position nor a rotation")));
    assert_eq!(parts[0].1, Some(Columns::Transforms(Vec::new())));
    assert_eq!(decode_all(protobuf, &[rotated]).1, None);
    let json = Format { encoding: "json", ..protobuf };
    let message = br#"{"transforms":[{"child_frame_id":"c"}]}"#.to_vec();
    assert!(decode_all(json, &[message]).1.is_some_and(|error| error.contains("no object")));
}

#[test]
fn enumerations_have_their_declared_width_and_lists_a_length() {
    let schema = "module std_msgs { module msg {
        @bit_bound(8) enum Mode { IDLE, RUN };
        enum Wide { NO, YES };
        @final struct Float64MultiArray {
            Mode mode; sequence<Mode> modes; Wide wide; sequence<double> data;
        };
    }; };";
    let idl = Format {
        encoding: "cdr",
        type_name: "std_msgs/msg/Float64MultiArray",
        schema_encoding: "ros2idl",
        schema: schema.as_bytes(),
    };
    let first = Cdr::little().u8(1).u32(2).u8(0).u8(1).u32(1).list(&[1.5]).done();
    // CDR version 2 (DDS XTypes 1.3, §7.4.3.5): six bytes for a list of a non-primitive type.
    let second = vec![
        0, 7, 0, 0, 1, 0, 0, 0, 6, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0,
        0, 0, 0, 0, 0xf8, 0x3f,
    ];
    for message in [first, second] {
        let (parts, error) = decode_all(idl, &[message]);
        let Some(Columns::Array(array)) = &parts[0].1 else { panic!("{parts:?}") };
        assert_eq!((error, &array.values[..]), (None, &[1.5][..]));
    }
}

#[test]
fn an_unqualified_header_belongs_to_its_package_if_defined_there() {
    let own = "Header header\nfloat64[] data\n===\nMSG: std_msgs/Header\nuint8 kind\n";
    let other = "Header header\nfloat64[] data\n===\nMSG: my_msgs/Header\nuint8 kind\n\
                 ===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";
    let values = |schema: &str, message: Vec<u8>| {
        let (parts, error) = decode_all(cdr("std_msgs/msg/Float64MultiArray", schema), &[message]);
        let Some(Columns::Array(array)) = &parts[0].1 else { panic!("{parts:?}") };
        assert_eq!(error, None);
        array.values.clone()
    };
    assert_eq!(values(own, Cdr::little().u8(1).list(&[1.5]).done()), [1.5]);
    assert_eq!(values(other, Cdr::little().header(1, 2, "base").list(&[2.5]).done()), [2.5]);
    // A package with its own Header next to that of ROS.
    let nested = "my_msgs/Stamped first\nfloat64[] data\n===\nMSG: my_msgs/Stamped\nHeader header\n\
                  ===\nMSG: my_msgs/Header\nuint8 kind\n\
                  ===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n";
    assert_eq!(values(nested, Cdr::little().u8(1).list(&[3.5]).done()), [3.5]);
}

#[test]
fn names_from_files_are_truncated_in_messages() {
    let long = "x".repeat(5000);
    for schema in
        [format!("{long}/Type data\n"), format!("Inner[] data\n===\nMSG: std_msgs/{long}\n")]
    {
        let refusal = refusal("std_msgs/msg/Float64MultiArray", &schema);
        assert!(refusal.len() < 400, "{} bytes", refusal.len());
    }
    let name = "n".repeat(5000);
    let message = Cdr::joint_state(&[&name], &[1.0], &[]);
    let (parts, _) =
        decode_all(cdr("sensor_msgs/msg/JointState", crate::testing::JOINT_STATE), &[message]);
    let Some(Columns::Joints(joints)) = &parts[0].1 else { panic!("{parts:?}") };
    assert!(joints.joints[0].name.ends_with("n…") && joints.joints[0].name.len() < 300);
}

#[test]
fn trajectory_points_are_joint_set_points() {
    let json = Format { type_name: "trajectory_msgs/msg/JointTrajectory", ..JSON };
    let message = br#"{"header":{"stamp":{"sec":5,"nanosec":7}},"joint_names":["a","b"],
        "points":[{"positions":[0.5,1.5],"velocities":[]},{"positions":[0.25,1.25],"velocities":[]}]}"#;
    let (parts, error) = decode_all(json, &[message.to_vec()]);
    assert_eq!((error, parts[0].0), (None, ".setpoint"));
    let Some(Columns::Joints(joints)) = &parts[0].1 else { panic!("{parts:?}") };
    let of =
        |joint: usize| (joints.joints[joint].name.as_str(), &joints.joints[joint].position[..]);
    assert_eq!([of(0), of(1)], [("a", &[0.5, 0.25][..]), ("b", &[1.5, 1.25][..])]);
    assert_eq!(joints.times.header, [5_000_000_007; 2]);
}
