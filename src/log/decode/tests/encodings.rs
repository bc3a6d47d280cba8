//! The same content decodes to the same columns in every encoding.

use super::super::*;
use super::decode_all;
use ground::stream::{Columns, JointColumns, PoseColumns};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Style {
    Ros1,
    Cdr { big_endian: bool },
    Cdr2 { big_endian: bool, delimited: bool },
}

const STYLES: [Style; 7] = [
    Style::Ros1,
    Style::Cdr { big_endian: false },
    Style::Cdr { big_endian: true },
    Style::Cdr2 { big_endian: false, delimited: false },
    Style::Cdr2 { big_endian: true, delimited: false },
    Style::Cdr2 { big_endian: false, delimited: true },
    Style::Cdr2 { big_endian: true, delimited: true },
];

/// Follows DDS XTypes 1.3, §7.4.3, and the ROS 1 wiki.
struct Writer {
    style: Style,
    bytes: Vec<u8>,
}

impl Writer {
    fn new(style: Style) -> Self {
        let bytes = match style {
            Style::Ros1 => vec![],
            Style::Cdr { big_endian } => vec![0, u8::from(!big_endian), 0, 0],
            Style::Cdr2 { big_endian, delimited } => {
                vec![0, if delimited { 8 } else { 6 } + u8::from(!big_endian), 0, 0]
            }
        };
        Self { style, bytes }
    }

    fn value<const N: usize>(&mut self, mut little_endian: [u8; N]) {
        let (align, big_endian) = match self.style {
            Style::Ros1 => (1, false),
            Style::Cdr { big_endian } => (N, big_endian),
            Style::Cdr2 { big_endian, .. } => (N.min(4), big_endian),
        };
        while align > 1 && !(self.bytes.len() - 4).is_multiple_of(align) {
            self.bytes.push(0xee);
        }
        if big_endian {
            little_endian.reverse();
        }
        self.bytes.extend(little_endian);
    }

    fn u32(&mut self, value: u32) {
        self.value(value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.value(value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        let zero = usize::from(self.style != Style::Ros1);
        self.u32((text.len() + zero) as u32);
        self.bytes.extend(text.as_bytes());
        self.bytes.extend(&[0][..zero]);
    }

    /// `has_length`: in bytes, before the content.
    fn delimited(&mut self, has_length: bool, content: impl FnOnce(&mut Self)) {
        if !has_length {
            return content(self);
        }
        self.u32(0);
        let start = self.bytes.len();
        content(self);
        let length = (self.bytes.len() - start) as u32;
        let is_big = matches!(self.style, Style::Cdr2 { big_endian: true, .. });
        let length = if is_big { length.to_be_bytes() } else { length.to_le_bytes() };
        self.bytes[start - 4..start].copy_from_slice(&length);
    }

    fn message(&mut self, content: impl FnOnce(&mut Self)) {
        self.delimited(matches!(self.style, Style::Cdr2 { delimited: true, .. }), content);
    }

    /// Sequence of anything except numbers.
    fn sequence<T>(&mut self, items: &[T], write: impl Fn(&mut Self, &T)) {
        self.delimited(matches!(self.style, Style::Cdr2 { .. }), |writer| {
            writer.u32(items.len() as u32);
            items.iter().for_each(|item| write(writer, item));
        });
    }

    fn numbers(&mut self, numbers: &[f64]) {
        self.u32(numbers.len() as u32);
        numbers.iter().for_each(|&number| self.f64(number));
    }

    fn stamp(&mut self, stamp: i64) {
        self.message(|writer| {
            writer.u32((stamp / 1_000_000_000) as u32);
            writer.u32((stamp % 1_000_000_000) as u32);
        });
    }

    fn all(&mut self, numbers: &[f64]) {
        self.message(|writer| numbers.iter().for_each(|&number| writer.f64(number)));
    }
}

struct Transform {
    stamp: i64,
    frames: [String; 2],
    xyz: [f64; 3],
    q_xyzw: [f64; 4],
}

struct Joints {
    stamp: i64,
    names: Vec<String>,
    position: Vec<f64>,
    velocity: Vec<f64>,
}

/// Knuth's linear congruential generator.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        self.0 >> 33
    }

    /// Few digits in both bases: exact in every encoding.
    fn number(&mut self) -> f64 {
        ((self.next() % (1 << 20)) as f64 - f64::from(1 << 19)) / 1024.0
    }

    fn name(&mut self) -> String {
        let length = self.next() % 9;
        (0..length).map(|_| char::from(b'a' + (self.next() % 26) as u8)).collect()
    }

    fn stamp(&mut self) -> i64 {
        (self.next() % 2_000_000_000) as i64 * 1_000_000_000 + (self.next() % 1_000_000_000) as i64
    }

    fn transform(&mut self) -> Transform {
        Transform {
            stamp: self.stamp(),
            frames: [self.name(), self.name()],
            xyz: std::array::from_fn(|_| self.number()),
            q_xyzw: std::array::from_fn(|_| self.number()),
        }
    }

    fn joints(&mut self) -> Joints {
        let count = self.next() % 8;
        let mut names: Vec<String> = (0..count).map(|i| format!("{}_{i}", self.name())).collect();
        names.sort();
        Joints {
            stamp: self.stamp(),
            position: names.iter().map(|_| self.number()).collect(),
            velocity: names.iter().map(|_| self.number()).collect(),
            names,
        }
    }
}

fn in_style(style: Style, transforms: &[Transform]) -> Vec<u8> {
    let mut writer = Writer::new(style);
    writer.message(|writer| {
        writer.sequence(transforms, |writer, transform| {
            writer.message(|writer| {
                writer.stamp(transform.stamp);
                transform.frames.iter().for_each(|frame| writer.text(frame));
                writer.all(&transform.xyz);
                writer.all(&transform.q_xyzw);
            });
        });
    });
    writer.bytes
}

fn joints_in_style(style: Style, joints: &Joints) -> Vec<u8> {
    let mut writer = Writer::new(style);
    writer.message(|writer| {
        writer.message(|writer| {
            if style == Style::Ros1 {
                writer.u32(9);
            }
            writer.stamp(joints.stamp);
            writer.text("base");
        });
        writer.sequence(&joints.names, |writer, name| writer.text(name));
        writer.numbers(&joints.position);
        writer.numbers(&joints.velocity);
        writer.numbers(&[]);
    });
    writer.bytes
}

fn in_json(transforms: &[Transform], rows_first: bool) -> Vec<u8> {
    let rows: Vec<String> = transforms
        .iter()
        .map(|Transform { stamp, frames: [parent, child], xyz: [x, y, z], q_xyzw }| {
            let (sec, nsec) = (stamp / 1_000_000_000, stamp % 1_000_000_000);
            let [qx, qy, qz, qw] = q_xyzw;
            let stamp = format!(r#""timestamp":{{"sec":{sec},"nsec":{nsec}}}"#);
            let frames = format!(r#""parent_frame_id":"{parent}","child_frame_id":"{child}""#);
            let translation = format!(r#""translation":{{"x":{x:?},"y":{y:?},"z":{z:?}}}"#);
            let rotation =
                format!(r#""rotation": {{"w":{qw:?},"x":{qx:?},"y":{qy:?},"z":{qz:?}}}"#);
            match rows_first {
                true => {
                    format!(r#"{{{rotation},"extra":[{{"x":1}}],{translation},{frames},{stamp}}}"#)
                }
                false => format!("{{{stamp}, {frames},\n{translation},{rotation}}}"),
            }
        })
        .collect();
    format!(r#"{{"other":null,"transforms":[{}]}}"#, rows.join(",")).into_bytes()
}

#[derive(Default)]
struct Proto(Vec<u8>);

impl Proto {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn integer(mut self, number: u64, value: u64) -> Self {
        self.varint(number << 3);
        self.varint(value);
        self
    }

    fn f64(mut self, number: u64, value: f64) -> Self {
        self.varint(number << 3 | 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn bytes(mut self, number: u64, bytes: &[u8]) -> Self {
        self.varint(number << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }
}

fn in_protobuf(transforms: &[Transform]) -> Vec<u8> {
    let rows = transforms.iter().map(|transform| {
        let stamp = Proto::default().integer(2, (transform.stamp % 1_000_000_000) as u64);
        let stamp = stamp.integer(1, (transform.stamp / 1_000_000_000) as u64);
        let numbers = |numbers: &[f64]| {
            let each = numbers.iter().enumerate();
            each.fold(Proto::default(), |proto, (i, &x)| proto.f64(i as u64 + 1, x)).0
        };
        // Fields out of order, and unknown ones.
        let row = Proto::default().bytes(5, &numbers(&transform.q_xyzw)).integer(77, 5);
        let row = row.bytes(3, transform.frames[1].as_bytes()).bytes(1, &stamp.0);
        let row = row.bytes(2, transform.frames[0].as_bytes()).f64(99, 1.0);
        row.bytes(4, &numbers(&transform.xyz)).0
    });
    rows.fold(Proto::default(), |proto, row| proto.bytes(1, &row)).0
}

fn groups(format: Format<'_>, message: Vec<u8>) -> Vec<PoseColumns> {
    let (mut parts, error) = decode_all(format, &[message]);
    assert_eq!(error, None, "{format:?}");
    match parts.remove(0).1 {
        Some(Columns::Transforms(groups)) => groups,
        other => panic!("{other:?}"),
    }
}

fn joint_columns(format: Format<'_>, message: Vec<u8>) -> JointColumns {
    let (mut parts, error) = decode_all(format, &[message]);
    assert_eq!(error, None, "{format:?}");
    match parts.remove(0).1 {
        Some(Columns::Joints(joints)) => joints,
        other => panic!("{other:?}"),
    }
}

const CDR: Format<'_> = Format {
    encoding: "cdr",
    type_name: "foxglove_msgs/msg/FrameTransforms",
    schema_encoding: "",
    schema: b"",
};

const ROS1_TRANSFORMS: &str = "FrameTransform[] transforms\n===\nMSG: foxglove_msgs/FrameTransform\n\
    time timestamp\nstring parent_frame_id\nstring child_frame_id\n\
    geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n\
    ===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n\
    ===\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n";

/// Name of the fuzz target, type, schema and message.
pub(crate) fn seeds() -> Vec<(&'static str, &'static str, Vec<u8>, Vec<u8>)> {
    let mut random = Random(11);
    let transforms = [random.transform(), random.transform()];
    let mut seeds = vec![
        (
            "protobuf",
            "foxglove.FrameTransforms",
            include_bytes!("foxglove.bin").to_vec(),
            in_protobuf(&transforms),
        ),
        ("json", "foxglove.FrameTransforms", Vec::new(), in_json(&transforms, false)),
    ];
    for style in STYLES {
        let (target, schema) = match style {
            Style::Ros1 => ("ros1", ROS1_TRANSFORMS),
            _ => ("ros2msg", ""),
        };
        seeds.push((target, CDR.type_name, schema.into(), in_style(style, &transforms)));
    }
    seeds
}

#[test]
fn transforms_are_the_same_in_every_encoding() {
    let mut random = Random(7);
    for count in (0..40).map(|i| i % 6) {
        let transforms: Vec<Transform> = (0..count).map(|_| random.transform()).collect();
        let mut found = Vec::new();
        for style in STYLES {
            let ros1 = Format {
                encoding: "ros1",
                schema_encoding: "ros1msg",
                schema: ROS1_TRANSFORMS.as_bytes(),
                ..CDR
            };
            let format = if style == Style::Ros1 { ros1 } else { CDR };
            found.push(groups(format, in_style(style, &transforms)));
        }
        let type_name = "foxglove.FrameTransforms";
        let json = Format { encoding: "json", type_name, ..CDR };
        found.push(groups(json, in_json(&transforms, false)));
        found.push(groups(json, in_json(&transforms, true)));
        let schema = include_bytes!("foxglove.bin");
        let protobuf =
            Format { encoding: "protobuf", type_name, schema_encoding: "protobuf", schema };
        found.push(groups(protobuf, in_protobuf(&transforms)));
        let written: Vec<_> = transforms.iter().map(|t| (t.stamp, t.xyz, t.q_xyzw)).collect();
        for groups in &found {
            let mut read: Vec<_> = groups
                .iter()
                .flat_map(|group| {
                    let poses = group.xyz.iter().zip(group.q_xyzw.iter());
                    group.times.header.iter().zip(poses).map(|(&t, (&xyz, &q))| (t, xyz, q))
                })
                .collect();
            read.sort_by_key(|row| written.iter().position(|other| other == row));
            assert_eq!(read, written);
            assert_eq!(groups, &found[0]);
        }
    }
}

#[test]
fn joint_states_are_the_same_in_every_encoding() {
    let ros1_definition = "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n\
        float64[] effort\n===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
    let type_name = "sensor_msgs/JointState";
    let cdr = Format { type_name, ..CDR };
    let mut random = Random(3);
    for _ in 0..40 {
        let joints = random.joints();
        let mut found: Vec<JointColumns> = STYLES
            .iter()
            .map(|&style| {
                let ros1 = Format {
                    encoding: "ros1",
                    schema_encoding: "ros1msg",
                    schema: ros1_definition.as_bytes(),
                    ..cdr
                };
                let format = if style == Style::Ros1 { ros1 } else { cdr };
                joint_columns(format, joints_in_style(style, &joints))
            })
            .collect();
        let Joints { stamp, names, position, velocity } = &joints;
        for (sec, nsec) in [("secs", "nsecs"), ("sec", "nanosec")] {
            let stamp = format!(
                r#""stamp":{{"{sec}":{},"{nsec}":{}}}"#,
                stamp / 1_000_000_000,
                stamp % 1_000_000_000
            );
            let message = format!(
                r#"{{"name":{names:?},"position":{position:?},"velocity":{velocity:?},"effort":[],
                "header":{{"seq":1,{stamp},"frame_id":"base"}}}}"#
            );
            found.push(joint_columns(Format { encoding: "json", ..cdr }, message.into_bytes()));
        }
        for columns in &found {
            assert_eq!(columns, &found[0]);
        }
        let read: Vec<_> = found[0].joints.iter().map(|joint| joint.position[0]).collect();
        assert_eq!((&read, found[0].times.header[0]), (position, *stamp));
    }
}

#[test]
fn xcdr2_follows_the_specification() {
    // Names {"a"}, positions {1.5}. DDS XTypes 1.3, §7.4.3.5: every appendable structure and every sequence
    // of strings has a length prefix, and doubles are aligned to 4.
    let delimited: &[u8] = &[
        0x00, 0x09, 0x00, 0x00, // D_CDR2_LE, no options
        0x3c, 0, 0, 0, // JointState: 60 bytes
        0x12, 0, 0, 0, // Header: 18 bytes
        0x08, 0, 0, 0, // Time: 8 bytes
        0x01, 0, 0, 0, 0x02, 0, 0, 0, // 1 s, 2 ns
        0x02, 0, 0, 0, b'b', 0, // frame_id
        0, 0, // padding
        0x0a, 0, 0, 0, // name: 10 bytes
        0x01, 0, 0, 0, 0x02, 0, 0, 0, b'a', 0, // one string of two bytes
        0, 0, // padding
        0x01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf8, 0x3f, // position
        0x00, 0, 0, 0, // velocity
        0x00, 0, 0, 0, // effort
    ];
    let plain: &[u8] = &[
        0x00, 0x07, 0x00, 0x03, // PLAIN_CDR2_LE, three bytes of padding at the end
        0x01, 0, 0, 0, 0x02, 0, 0, 0, // 1 s, 2 ns
        0x02, 0, 0, 0, b'b', 0, // frame_id
        0, 0, // padding
        0x0a, 0, 0, 0, // name: 10 bytes
        0x01, 0, 0, 0, 0x02, 0, 0, 0, b'a', 0, // one string of two bytes
        0, 0, // padding
        0x01, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xf8, 0x3f, // position
        0x00, 0, 0, 0, // velocity
        0x00, 0, 0, 0, // effort
        0, 0, 0, // padding
    ];
    let format = Format { type_name: "sensor_msgs/msg/JointState", ..CDR };
    for message in [delimited, plain] {
        let joints = joint_columns(format, message.to_vec());
        assert_eq!((joints.times.header[0], joints.frame_id.as_str()), (1_000_000_002, "b"));
        assert_eq!((joints.joints[0].name.as_str(), joints.joints[0].position[0]), ("a", 1.5));
    }
}
