//! Malicious lengths, depths and sizes cause an error without using much memory.

use super::super::super::testing::Cdr;
use super::super::*;
use super::{cdr, decode_all, refused};
use ground::stream::Columns;

fn error(format: Format<'_>, message: Vec<u8>) -> String {
    decode_all(format, &[message]).1.expect("an error")
}

#[test]
fn arrays_of_nothing_take_no_time() {
    // In ROS 1 empty messages take no bytes, so the message length does not bound their number.
    let text = "Empty[4000000000] a\nEmpty[] b\nstring data\n===\nMSG: std_msgs/Empty\n";
    let format =
        Format { encoding: "ros1", schema_encoding: "ros1msg", ..cdr("std_msgs/String", text) };
    let (parts, error) = decode_all(format, &[[2, 0, 0, 0, 2, 0, 0, 0, b'o', b'k'].to_vec()]);
    assert_eq!(error, None);
    assert!(matches!(&parts[0].1, Some(Columns::Text(text)) if text.text == ["ok"]));
    let many = [0xff, 0xff, 0xff, 0xff, 2, 0, 0, 0, b'o', b'k'].to_vec();
    assert!(
        self::error(format, many).contains("field `b`: byte 4 of the message: needs 4294967295")
    );
}

#[test]
fn arrays_of_nothing_in_arrays_take_no_time() {
    // 250,000 empty elements per byte of the message.
    let text = "Many[4000000000] a\nstring data\n===\nMSG: std_msgs/Many\nEmpty[] b\n\
                ===\nMSG: std_msgs/Empty\n";
    let format =
        Format { encoding: "ros1", schema_encoding: "ros1msg", ..cdr("std_msgs/String", text) };
    let count = 500_000_u32.to_le_bytes();
    assert!(error(format, count.repeat(250_000)).contains("field `a.b`"));
}

#[test]
fn arrays_of_nothing_of_a_stated_length_take_no_time() {
    let text = "Outer[4000000000] a\nstring data\n===\nMSG: std_msgs/Outer\nMany[4000000000] b\n\
                ===\nMSG: std_msgs/Many\nEmpty[5] c\n===\nMSG: std_msgs/Empty\n";
    let format =
        Format { encoding: "ros1", schema_encoding: "ros1msg", ..cdr("std_msgs/String", text) };
    let (parts, error) = decode_all(format, &[[2, 0, 0, 0, b'o', b'k'].to_vec()]);
    assert_eq!(error, None);
    assert!(matches!(&parts[0].1, Some(Columns::Text(text)) if text.text == ["ok"]));
}

#[test]
fn arrays_longer_than_the_message_are_refused() {
    for fields in ["float64[4294967295] a", "string[4294967295] a", "std_msgs/Header[4294967295] a"]
    {
        let text = format!(
            "{fields}\nstring data\n===\nMSG: std_msgs/Header\ntime stamp\nstring frame_id\n"
        );
        let message = Cdr::little().all(&[0.0; 64]).done();
        let error = error(cdr("std_msgs/String", &text), message);
        assert!(error.contains("field `a"), "{error}");
    }
}

#[test]
fn long_lists_are_counted_and_not_kept() {
    let list = vec![1.0; 70_000];
    let text = "float64[] data";
    let message = Cdr::little().list(&list).done();
    let (parts, error) = decode_all(cdr("std_msgs/Float64MultiArray", text), &[message]);
    let Some(Columns::Array(array)) = &parts[0].1 else { panic!("array") };
    assert_eq!((error, array.times.len(), array.wrong_length), (None, 0, 1));
    let json = format!(r#"{{"data":{list:?}}}"#).into_bytes();
    let format = Format { encoding: "json", ..cdr("std_msgs/Float64MultiArray", text) };
    let (parts, error) = decode_all(format, &[json]);
    let Some(Columns::Array(array)) = &parts[0].1 else { panic!("array") };
    assert_eq!((error, array.times.len(), array.wrong_length), (None, 0, 1));
}

#[test]
fn json_of_any_depth_is_read_or_refused() {
    let format = Format { encoding: "json", ..cdr("std_msgs/String", "") };
    let deep = |open: &str, close: &str| {
        let (open, close) = (open.repeat(100_000), close.repeat(100_000));
        format!(r#"{{"other":{open}1{close},"data":"ok"}}"#).into_bytes()
    };
    for message in [deep("[", "]"), deep(r#"{"a":"#, "}")] {
        let _ = decode_all(format, &[message]);
    }
    let unended = format!(r#"{{"data":"{}"#, "[".repeat(100_000)).into_bytes();
    assert!(error(format, unended).len() < 300);
    let long = format!(r#"{{"data":"","data":{{"{}":1}}}}"#, "x".repeat(1 << 20)).into_bytes();
    assert!(error(format, long).len() < 300);
}

fn field(number: u8, content: &[u8]) -> Vec<u8> {
    let mut bytes = vec![number << 3 | 2];
    let mut length = content.len();
    while length >= 0x80 {
        bytes.push(length as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    bytes.extend(content);
    bytes
}

#[test]
fn descriptors_that_nest_or_grow_without_end_are_refused() {
    let format = Format {
        encoding: "protobuf",
        schema_encoding: "protobuf",
        ..cdr("foxglove.FrameTransforms", "")
    };
    let refused = |file: Vec<u8>| refused(Format { schema: &field(1, &file), ..format });
    let nested =
        (0..50).fold(field(1, b"a"), |inner, _| [field(1, b"a"), field(3, &inner)].concat());
    assert!(refused(field(4, &nested)).contains("nested deeper"));
    let fields = field(2, &field(1, b"x")).repeat(10_001);
    assert!(refused(field(4, &fields)).contains("more than 10000 fields"));
    let types: Vec<Vec<u8>> =
        (0..5_001).map(|i| field(4, &field(1, format!("T{i}").as_bytes()))).collect();
    assert!(refused(types.concat()).contains("more than 5000 types"));
    assert!(refused(field(4, &field(1, &[b'x'; 300]))).contains("name of more than 256"));
    assert!(refused(vec![0; 5 << 20]).contains("bytes long; the limit is"));
}

#[test]
fn a_protobuf_type_that_contains_itself_is_read_as_deep_as_the_recipe() {
    // message FrameTransform { repeated FrameTransform transforms = 1; } does not match the recipe.
    let itself =
        [field(1, b"transforms"), vec![0x18, 1, 0x20, 3, 0x28, 11], field(6, b".foxglove.T")];
    let message = [field(1, b"FrameTransforms"), field(2, &itself.concat())].concat();
    let inner = [field(1, b"T"), field(2, &itself.concat())].concat();
    let file = [field(2, b"foxglove"), field(4, &message), field(4, &inner)].concat();
    let format = Format {
        encoding: "protobuf",
        schema_encoding: "protobuf",
        schema: &field(1, &file),
        ..cdr("foxglove.FrameTransforms", "")
    };
    assert!(refused(format).ends_with("no field `transforms.timestamp`"), "{}", refused(format));
}

#[test]
fn bytes_at_random_are_never_more_than_an_error() {
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as u8
    };
    let foxglove = include_bytes!("foxglove.bin");
    let formats = [
        cdr("tf2_msgs/msg/TFMessage", ""),
        cdr("franka_msgs/msg/FrankaRobotState", ""),
        Format { encoding: "json", ..cdr("foxglove.PosesInFrame", "") },
        Format {
            encoding: "protobuf",
            schema_encoding: "protobuf",
            schema: foxglove,
            ..cdr("foxglove.PosesInFrame", "")
        },
    ];
    for _ in 0..500 {
        for format in formats {
            let length = usize::from(next());
            let mut message: Vec<u8> = (0..length).map(|_| next()).collect();
            if let [first, second, ..] = message.as_mut_slice() {
                (*first, *second) = (0, *second % 10);
            }
            let _ = decode_all(format, &[message]);
        }
        let mut schema = foxglove.to_vec();
        let at = (usize::from(next()) << 8 | usize::from(next())) % schema.len();
        schema[at] = next();
        let recipe = Recipe::for_type("foxglove.PosesInFrame").unwrap();
        let format = Format { schema: &schema, type_name: "foxglove.PosesInFrame", ..formats[3] };
        let _ = format.plan(recipe);
    }
}
