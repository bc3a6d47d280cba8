//! Messages of every recipe, through plan and builder.

pub(crate) mod encodings;
mod hostile;
mod idl;
mod independent;
mod layouts;
mod shapes;
mod vectors;

use super::super::testing::{self, Cdr};
use super::*;
use ground::stream::{Columns, ImuColumns, JointColumns, PoseColumns};
use ground::time::Clock;

/// Also returns the first error.
fn decode_all(
    format: Format<'_>,
    messages: &[Vec<u8>],
) -> (Vec<(&'static str, Option<Columns>)>, Option<String>) {
    let recipe = Recipe::for_type(format.type_name).unwrap();
    let plan = format.plan(recipe).unwrap();
    let (mut builder, mut row) = (recipe.builder(), Row::default());
    let mut first = None;
    for (index, message) in messages.iter().enumerate() {
        let (log, publish) = (1000 + index as i64, 2000 + index as i64);
        let times = RowTimes { log, publish, sequence: 0 };
        let mut append = |row: &Row| builder.append(row, times);
        if let Err(error) = plan.decode(message, &mut row, &mut append) {
            first.get_or_insert_with(|| error.to_string());
        }
    }
    (builder.finalize(), first)
}

/// For CDR with a message definition and types with one part.
fn decode(type_name: &str, schema: &str, messages: &[Vec<u8>]) -> (Columns, Option<String>) {
    let (mut parts, error) = decode_all(cdr(type_name, schema), messages);
    assert_eq!((parts.len(), parts[0].0), (1, ""));
    (parts.remove(0).1.unwrap(), error)
}

fn cdr<'a>(type_name: &'a str, schema: &'a str) -> Format<'a> {
    let (encoding, schema_encoding) = ("cdr", "ros2msg");
    Format { encoding, type_name, schema_encoding, schema: schema.as_bytes() }
}

fn joints(schema: &str, messages: &[Vec<u8>]) -> JointColumns {
    match decode("sensor_msgs/msg/JointState", schema, messages) {
        (Columns::Joints(joints), None) => joints,
        other => panic!("{other:?}"),
    }
}

fn poses(type_name: &str, schema: &str, messages: &[Vec<u8>]) -> Vec<PoseColumns> {
    match decode(type_name, schema, messages) {
        (Columns::Poses(poses) | Columns::Transforms(poses), None) => poses,
        other => panic!("{other:?}"),
    }
}

fn imu(messages: &[Vec<u8>]) -> ImuColumns {
    match decode("sensor_msgs/msg/Imu", testing::IMU, messages) {
        (Columns::Imu(imu), None) => imu,
        other => panic!("{other:?}"),
    }
}

fn refusal(type_name: &str, schema: &str) -> String {
    refused(cdr(type_name, schema))
}

fn refused(format: Format<'_>) -> String {
    format.plan(Recipe::for_type(format.type_name).unwrap()).unwrap_err().to_string()
}

/// NaN equals NaN.
fn assert_same(found: &[f64], expected: &[f64]) {
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(found), bits(expected), "{found:?} {expected:?}");
}

const NAN: f64 = f64::NAN;

#[test]
fn joints_are_appended_to_the_column_of_their_name() {
    let joints = joints(
        testing::JOINT_STATE,
        &[
            Cdr::joint_state(&["a", "b"], &[1.0, 2.0], &[0.1, 0.2]),
            Cdr::joint_state(&["b", "a"], &[4.0, 3.0], &[]),
            Cdr::joint_state(&["c"], &[5.0], &[0.5]),
            Cdr::joint_state(&["a", "b"], &[6.0, 7.0], &[0.6, 0.7]),
        ],
    );
    let names: Vec<&str> = joints.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["a", "b", "c"]);
    assert_same(&joints.joints[0].position, &[1.0, 3.0, NAN, 6.0]);
    assert_same(&joints.joints[1].position, &[2.0, 4.0, NAN, 7.0]);
    assert_same(&joints.joints[2].position, &[NAN, NAN, 5.0, NAN]);
    assert_same(&joints.joints[0].velocity.to_slice(), &[0.1, NAN, NAN, 0.6]);
    assert_eq!(joints.times.header, [1_000_000_002; 4]);
    assert_eq!(joints.times.log, [1000, 1001, 1002, 1003]);
    assert_eq!(joints.times.nanos_on(Clock::Publish), [2000, 2001, 2002, 2003]);
    assert_eq!(joints.frame_id, "base_link");
}

#[test]
fn joint_messages_of_wrong_length_are_dropped_and_counted() {
    let joints = joints(
        testing::JOINT_STATE,
        &[
            Cdr::joint_state(&["a", "b"], &[1.0], &[]),
            Cdr::joint_state(&["a", "b"], &[], &[]),
            Cdr::joint_state(&[], &[1.0], &[]),
            Cdr::joint_state(&["a", "b"], &[1.0, NAN], &[f64::INFINITY, 1.0]),
        ],
    );
    assert_eq!(joints.wrong_length, 3);
    assert_eq!(joints.not_finite, 1);
    assert_eq!(joints.times.len(), 1);
    assert_same(&joints.joints[1].position, &[NAN]);
}

#[test]
fn a_joint_that_is_named_twice_contradicts_itself_where_the_positions_differ() {
    let messages = [[1.0, 2.0, 1.5], [1.0, 2.0, 1.0], [1.0, 2.0, NAN], [NAN, 2.0, 1.5]]
        .map(|positions| Cdr::joint_state(&["a", "b", "a"], &positions, &[]));
    let joints = joints(testing::JOINT_STATE, &messages);
    assert_eq!(joints.contradictory, 1);
    assert_same(&joints.joints[0].position, &[1.5, 1.0, 1.0, 1.5]);
}

#[test]
fn endlessly_new_joint_names_are_refused() {
    let names: Vec<String> = (0..300).map(|index| format!("joint_{index}")).collect();
    let message = |name: &String| Cdr::joint_state(&[name], &[0.0], &[]);
    let messages: Vec<Vec<u8>> = names.iter().map(message).collect();
    let (columns, error) = decode("sensor_msgs/JointState", testing::JOINT_STATE, &messages);
    let Columns::Joints(joints) = columns else { panic!("joints") };
    assert_eq!(joints.joints.len(), 256);
    assert_eq!(error.unwrap(), "topic has more than 256 different joint names");
    assert!(joints.joints.iter().all(|joint| joint.position.len() == joints.times.len()));
}

#[test]
fn the_schema_in_the_log_says_where_fields_are() {
    // More fields, a different order and number types, and a ROS 1 time.
    let schema = testing::schema(
        "uint8 extra\nfloat32[] velocity\nDetail[2] details\nfloat32[<=9] position # bounded\n\
         string<=20[] name\nHeader header\nDetail[] more",
        &[
            (
                "sensor_msgs/Detail",
                "int16 A=3\nuint16 b\nstring c\nduration d\nEmpty e\nstring[] f",
            ),
            ("sensor_msgs/Empty", ""),
            ("std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id"),
        ],
    );
    let detail = |cdr: Cdr| cdr.u16(1).text("xyz").u32(1).u32(2).u8(0).texts(&["p", "qr"]);
    let cdr = Cdr::little().u8(9).u32(2).f32(0.5).f32(0.25);
    let cdr = detail(detail(cdr));
    let cdr = cdr.u32(2).f32(1.5).f32(2.5).texts(&["a", "b"]);
    let message = cdr.u32(77).u32(3).u32(4).text("/base").u32(0).done();
    let joints = joints(&schema, &[message]);
    assert_eq!(joints.times.header, [3_000_000_004]);
    assert_eq!(joints.frame_id, "base");
    assert_same(&joints.joints[1].position, &[2.5]);
    assert_same(&joints.joints[1].velocity.to_slice(), &[0.25]);
}

#[test]
fn both_byte_orders_give_the_same_rows() {
    let write =
        |cdr: Cdr| cdr.header(5, 6, "base").all(&[1.0, 2.0, 3.0, 0.0, 0.6, 0.0, 0.8]).done();
    let messages = [write(Cdr::little()), write(Cdr::big())];
    let poses = poses("geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED, &messages);
    assert_eq!(poses[0].times.header, [5_000_000_006; 2]);
    assert_eq!(poses[0].xyz, [[1.0, 2.0, 3.0]; 2]);
    assert_eq!(poses[0].q_xyzw, [[0.0, 0.6, 0.0, 0.8]; 2]);
}

#[test]
fn poses_are_split_by_frame_and_must_be_finite() {
    let poses = poses(
        "geometry_msgs/PoseStamped",
        testing::POSE_STAMPED,
        &[
            Cdr::pose_stamped(1, 0, "/base", [1.0; 3]),
            Cdr::pose_stamped(2, 0, "world", [2.0; 3]),
            Cdr::pose_stamped(3, 0, "base", [NAN, 0.0, 0.0]),
            Cdr::pose_stamped(4, 0, "base", [4.0; 3]),
        ],
    );
    let frames: Vec<&str> = poses.iter().map(|group| group.frame_id.as_str()).collect();
    assert_eq!(frames, ["base", "world"]);
    assert_eq!(poses[0].xyz, [[1.0; 3], [4.0; 3]]);
    assert_eq!((poses[0].not_finite, poses[1].not_finite), (1, 0));
}

#[test]
fn transforms_are_rows_of_their_own() {
    let transform = |cdr: Cdr, time, parent, child, x| {
        cdr.header(time, 0, parent).text(child).all(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    };
    let first = transform(Cdr::little().u32(2), 1, "base", "link_1", 0.1);
    let first = transform(first, 2, "link_1", "link_2", 0.2).done();
    let second = transform(Cdr::big().u32(1), 3, "/base", "/link_1", 0.3).done();
    let none = Cdr::little().u32(0).done();
    let groups = poses("tf2_msgs/msg/TFMessage", testing::TF_MESSAGE, &[first, second, none]);
    assert_eq!(groups.len(), 2);
    assert_eq!(groups[0].child_frame_id, "link_1");
    assert_eq!(groups[0].times.header, [1_000_000_000, 3_000_000_000]);
    assert_eq!(groups[1].frame_id, "link_1");
    assert_eq!(groups[1].xyz, [[0.2, 0.0, 0.0]]);
}

#[test]
fn the_other_pose_types_have_their_child_frame() {
    let nested = [
        ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
        ("geometry_msgs/PoseWithCovariance", "Pose pose\nfloat64[36] covariance"),
        ("geometry_msgs/Pose", "Point position\nQuaternion orientation"),
        ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z"),
        ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    ];
    let pose = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0];
    let odometry = testing::schema(
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose",
        &nested,
    );
    let message = Cdr::little().header(1, 0, "odom").text("base").all(&pose).all(&[0.0; 36]).done();
    let groups = poses("nav_msgs/msg/Odometry", &odometry, &[message]);
    assert_eq!((groups[0].frame_id.as_str(), groups[0].child_frame_id.as_str()), ("odom", "base"));
    let covariance = testing::schema("std_msgs/Header header\nPoseWithCovariance pose", &nested);
    let message = Cdr::little().header(1, 0, "map").all(&pose).all(&[0.0; 36]).done();
    let groups = poses("geometry_msgs/msg/PoseWithCovarianceStamped", &covariance, &[message]);
    assert_eq!(groups[0].xyz, [[1.0, 2.0, 3.0]]);
}

#[test]
fn implausibly_large_numbers_are_dropped_and_counted() {
    let first = Cdr::joint_state(&["a", "b"], &[1e155, 0.2], &[1.0, 1e155]);
    let second = Cdr::joint_state(&["a", "b"], &[9e11, -1e308], &[1.0, 1.0]);
    let joints = joints(testing::JOINT_STATE, &[first, second]);
    assert_eq!((joints.not_finite, joints.unusable.as_slice()), (2, &[1, 1][..]));
    let [a, b] = joints.joints.as_slice() else { panic!("{:?}", joints.joints) };
    assert!(a.position[0].is_nan() && a.position[1] == 9e11 && b.position[1].is_nan());
    assert!(b.position[0] == 0.2 && b.velocity[0].is_nan() && b.velocity[1] == 1.0);
}

#[test]
fn an_imu_may_have_no_orientation() {
    let reading = |orientation: [f64; 4], first: f64, x: f64| {
        let cdr = Cdr::little().header(1, 0, "/imu").all(&orientation).f64(first).all(&[0.0; 8]);
        cdr.all(&[x, 0.2, 0.3]).all(&[0.0; 9]).all(&[9.0, 8.0, 7.0]).all(&[0.0; 9]).done()
    };
    let without = imu(&[reading([NAN; 4], -1.0, 0.1), reading([NAN; 4], -1.0, NAN)]);
    assert!(!without.has_orientation);
    assert_eq!(without.q_xyzw, [[0.0; 4]]);
    assert_eq!(without.gyro, [[0.1, 0.2, 0.3]]);
    assert_eq!(without.accel, [[9.0, 8.0, 7.0]]);
    assert_eq!((without.frame_id.as_str(), without.not_finite), ("imu", 1));
    let with = imu(&[reading([0.0, 0.0, 0.6, 0.8], 0.0, 0.1), reading([NAN; 4], 0.0, 0.1)]);
    assert!(with.has_orientation);
    assert_eq!(with.q_xyzw, [[0.0, 0.0, 0.6, 0.8]]);
    assert_eq!(with.not_finite, 1);
}

#[test]
fn arrays_have_one_width() {
    let schema = testing::schema(
        "MultiArrayLayout layout\nfloat64[] data",
        &[
            ("std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset"),
            ("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride"),
        ],
    );
    let message = |values: &[f64]| {
        Cdr::little().u32(1).text("joints").u32(6).u32(6).u32(0).list(values).done()
    };
    let messages = [message(&[]), message(&[1.0, 2.0]), message(&[3.0]), message(&[NAN, 1.0])];
    let (columns, error) = decode("std_msgs/msg/Float64MultiArray", &schema, &messages);
    let Columns::Array(array) = columns else { panic!("array") };
    assert_eq!(error, None);
    assert_eq!((array.width, array.wrong_length, array.not_finite), (2, 2, 1));
    assert_eq!(array.values, [1.0, 2.0]);
    assert_eq!(array.times.header, [0]);
}

#[test]
fn single_vectors_and_quaternions_become_arrays_with_stamps() {
    for (type_name, numbers) in [
        ("geometry_msgs/msg/Vector3Stamped", &[1.0, 2.0, 3.0][..]),
        ("geometry_msgs/msg/QuaternionStamped", &[0.0, 0.6, 0.0, 0.8]),
    ] {
        let format = Format { schema_encoding: "", ..cdr(type_name, "") };
        let message = Cdr::little().header(1, 2, "imu").all(numbers).done();
        let (parts, error) = decode_all(format, &[message]);
        let Some(Columns::Array(array)) = &parts[0].1 else { panic!("array") };
        assert_eq!((error, array.row(0), array.times.header[0]), (None, numbers, 1_000_000_002));
    }
}

#[test]
fn equal_texts_are_stored_once_and_bounded() {
    let mut messages = vec![Cdr::little().text("<robot/>").done(); 3];
    messages.extend((0..100).map(|index| Cdr::little().text(&format!("text {index}")).done()));
    let (columns, _) = decode("std_msgs/msg/String", "string data\n", &messages);
    let Columns::Text(text) = columns else { panic!("text") };
    assert_eq!(text.text.len(), 64);
    assert_eq!(text.text[..2], ["<robot/>", "text 0"]);
    assert_eq!(text.times.log[..2], [1000, 1003]);
}

#[test]
fn every_truncated_message_is_an_error_that_names_the_field() {
    let whole = Cdr::joint_state(&["a", "b"], &[1.0, 2.0], &[0.1, 0.2]);
    let effort = 4;
    for length in 0..whole.len() - effort {
        let message = whole[..length].to_vec();
        let (_, error) = decode("sensor_msgs/JointState", testing::JOINT_STATE, &[message]);
        let error = error.unwrap_or_else(|| panic!("{length} bytes were enough"));
        assert!(length < 4 || error.contains("field `"), "{error}");
    }
}

#[test]
fn a_hostile_length_is_an_error() {
    let message = Cdr::little().header(0, 0, "x").u32(u32::MAX).done();
    let (_, error) = decode("sensor_msgs/JointState", testing::JOINT_STATE, &[message]);
    let error = error.unwrap();
    let expected = "field `name`: byte 24 of the message: needs 4294967295 bytes, 0 remain";
    assert_eq!(error, expected);
}

#[test]
fn mismatching_schemas_give_the_reason() {
    let joint_state = |definition: &str| refusal("sensor_msgs/msg/JointState", definition);
    let header = "time stamp\nstring frame_id\n";
    let with = |fields: &str| testing::schema(fields, &[("std_msgs/Header", header)]);
    assert_eq!(
        joint_state(&with("Header header\nstring[] name\nfloat64[] position")),
        "schema of `sensor_msgs/msg/JointState`: no field `velocity`"
    );
    let text = joint_state(&with("Header header\nstring[] name\nstring[] position"));
    assert!(text.ends_with("expected an array of numbers in field `position`, found `string[]`"));
    let undefined = joint_state("Header header\n");
    assert!(undefined.contains("field `header` is of type `std_msgs/Header`, which the schema"));
    let wide = joint_state("wstring w\n");
    assert!(wide.contains("field `w` is of type `wstring`"));
}

#[test]
fn schemas_that_contain_themselves_are_refused() {
    let itself = testing::schema("A a", &[("sensor_msgs/A", "A[] a")]);
    assert!(refusal("sensor_msgs/JointState", &itself).contains("contain itself"));
    // Twenty levels of ten fields each: 10^20 fields.
    let level =
        |name: usize| (0..10).map(|field| format!("L{name} f{field}\n")).collect::<String>();
    let levels: Vec<(String, String)> = (0..20)
        .map(|index| (format!("sensor_msgs/L{index}"), level(index + 1)))
        .chain([("sensor_msgs/L20".to_owned(), "int8 x".to_owned())])
        .collect();
    let levels: Vec<(&str, &str)> =
        levels.iter().map(|(name, fields)| (name.as_str(), fields.as_str())).collect();
    let laughs = testing::schema("L0 l", &levels);
    assert!(refusal("sensor_msgs/JointState", &laughs).contains("more than 10000 fields"));
}

#[test]
fn fields_after_the_wanted_ones_may_be_unreadable() {
    let header = "time stamp\nstring frame_id\n";
    let fields = "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n\
        wstring wide\nStrange strange";
    let schema = testing::schema(fields, &[("std_msgs/Header", header)]);
    let message = Cdr::joint_state(&["a"], &[1.0], &[]);
    assert_same(&joints(&schema, &[message]).joints[0].position, &[1.0]);
}

#[test]
fn a_message_of_wrong_length_does_not_use_other_columns() {
    let joints = joints(
        testing::JOINT_STATE,
        &[
            Cdr::joint_state(&["a", "b"], &[1.0, 2.0], &[]),
            Cdr::joint_state(&["c"], &[5.0, 6.0], &[]),
        ],
    );
    assert_eq!((joints.joints.len(), joints.times.len(), joints.wrong_length), (2, 1, 1));
}

#[test]
fn a_type_without_stamp_gives_the_reason() {
    let (columns, _) = decode("std_msgs/String", "string data", &[Cdr::little().text("x").done()]);
    assert!(columns.times().iter().all(|times| times.unstamped));
    let message = Cdr::pose_stamped(0, 0, "base", [0.0; 3]);
    let poses = poses("geometry_msgs/PoseStamped", testing::POSE_STAMPED, &[message]);
    assert!(!poses[0].times.unstamped && poses[0].times.header == [0]);
}

#[test]
fn arrays_of_too_many_poses_are_ignored() {
    let format = Format { schema_encoding: "", ..cdr("geometry_msgs/msg/PoseArray", "") };
    let message = |count: u32| {
        let cdr = Cdr::little().header(1, 0, "map").u32(count);
        (0..count).fold(cdr, |cdr, _| cdr.all(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])).done()
    };
    let (parts, error) = decode_all(format, &[message(16)]);
    assert!(matches!(&parts[0].1, Some(Columns::Poses(poses)) if poses.len() == 16));
    assert_eq!(error, None);
    let (parts, error) = decode_all(format, &[message(1), message(17), message(1)]);
    assert_eq!((&parts[0].1, error), (&None, None));
}

#[test]
fn links_of_two_models_keep_their_models_names() {
    let format = Format { schema_encoding: "", ..cdr("gazebo_msgs/msg/LinkStates", "") };
    let names = ["left::tool0", "right::tool0", "right::elbow"];
    let cdr = names.iter().fold(Cdr::little().texts(&names).u32(3), |cdr, _| {
        cdr.all(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    });
    let (parts, _) = decode_all(format, &[cdr.u32(0).done()]);
    let Some(Columns::Poses(poses)) = &parts[0].1 else { panic!("poses") };
    let children: Vec<&str> = poses.iter().map(|pose| pose.child_frame_id.as_str()).collect();
    assert_eq!(children, ["left::tool0", "right::tool0", "elbow"]);
}

#[test]
fn json_may_leave_out_numbers_but_no_objects() {
    let type_name = "geometry_msgs/msg/PoseStamped";
    let format = Format { encoding: "json", ..cdr(type_name, "") };
    let decoded = |message: &str| {
        let (mut parts, error) = decode_all(format, &[message.as_bytes().to_vec()]);
        let Some(Columns::Poses(poses)) = parts.remove(0).1 else { panic!("poses") };
        (poses, error)
    };
    let header = r#""header":{"stamp":{"sec":1,"nanosec":2},"frame_id":"base"}"#;
    let whole = format!(
        r#"{{"pose":{{"orientation":{{"w":1}},"position":{{"x":"1.5","y":null}}}},{header}}}"#
    );
    let (poses, error) = decoded(&whole);
    assert_eq!((error, poses[0].not_finite), (None, 1));
    let (poses, _) = decoded(&whole.replace("null", "2"));
    assert_eq!((poses[0].xyz[0], poses[0].q_xyzw[0]), ([1.5, 2.0, 0.0], [0.0, 0.0, 0.0, 1.0]));
    assert_eq!((poses[0].frame_id.as_str(), poses[0].times.header[0]), ("base", 1_000_000_002));
    for (message, expected) in [
        (format!(r#"{{"pose":{{"position":{{}}}},{header}}}"#), "no object `pose.orientation`"),
        ("{}".to_owned(), "no object `header`"),
        (whole.replace("1.5", "left"), "expected a number in field `pose.position.x`"),
        (whole.replace(r#"{"w":1}"#, "[1]"), "an object in field `pose.orientation`"),
        (whole.replace(r#"{"sec":1,"nanosec":2}"#, "7"), "expected a time in field `header.stamp`"),
        (whole[..30].to_owned(), "EOF"),
        ("[1]".to_owned(), "an object"),
        (format!("{whole}x"), "trailing"),
    ] {
        let error = decoded(&message).1.unwrap();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn protocol_buffers_of_another_type_are_refused() {
    let foxglove = include_bytes!("tests/foxglove.bin");
    let format = Format {
        encoding: "protobuf",
        type_name: "foxglove.PoseInFrame",
        schema_encoding: "protobuf",
        schema: foxglove,
    };
    // Field 3 is a number instead of the pose.
    let (_, error) = decode_all(format, &[vec![0x18, 0x01]]);
    assert!(error.unwrap().starts_with("field `pose`: a wire type that differs"), "wire type");
    let joints = Format { type_name: "sensor_msgs/JointState", ..format };
    assert!(refused(joints).contains("does not define `sensor_msgs/JointState`"));
    assert!(refused(Format { schema: b"", ..format }).contains("no schema"));
    assert!(refused(Format { schema: b"\xff", ..format }).contains("not a FileDescriptorSet"));
    assert!(refused(Format { schema_encoding: "", ..format }).contains("expected `protobuf`"));
}

#[test]
fn errors_name_other_encodings() {
    let format = Format { encoding: "flatbuffer", ..cdr("sensor_msgs/JointState", "x") };
    let expected =
        "messages are encoded as `flatbuffer`, expected `cdr`, `ros1`, `json` or `protobuf`";
    assert_eq!(refused(format), expected);
    let other = Format { encoding: "cdr", schema_encoding: "ros1msg", ..format };
    let expected = "schema is written in `ros1msg`, expected `ros2msg` or `ros2idl`";
    assert_eq!(refused(other), expected);
    let none = Format { encoding: "ros1", schema: b"", ..format };
    assert_eq!(refused(none), "the log has no schema for `sensor_msgs/JointState`");
}
