//! What the tests of this room write: CDR messages and MCAP files.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};

const SEPARATOR: &str =
    "================================================================================";

/// `std_msgs/Header` and what it contains, as they follow a definition.
macro_rules! with_header {
    ($definition:literal) => {
        concat!(
            $definition,
            "================================================================================\n",
            "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
            "================================================================================\n",
            "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
        )
    };
}

pub(super) const JOINT_STATE: &str = with_header!(
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
);

pub(super) const POSE_STAMPED: &str = with_header!(
    "# A pose\nstd_msgs/Header header\nPose pose\n\
    ================================================================================\n\
    MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n\
    ================================================================================\n\
    MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n\
    ================================================================================\n\
    MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
);

pub(super) const TF_MESSAGE: &str = with_header!(
    "geometry_msgs/TransformStamped[] transforms\n\
    ================================================================================\n\
    MSG: geometry_msgs/TransformStamped\n\
    std_msgs/Header header\nstring child_frame_id\nTransform transform\n\
    ================================================================================\n\
    MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n\
    ================================================================================\n\
    MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n\
    ================================================================================\n\
    MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
);

pub(super) const IMU: &str = with_header!(
    "std_msgs/Header header\n\
    geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
    geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
    geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n\
    ================================================================================\n\
    MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n\
    ================================================================================\n\
    MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
);

/// `definition` followed by those of `nested`, as rosbag2 concatenates them.
pub(super) fn schema(definition: &str, nested: &[(&str, &str)]) -> String {
    let mut schema = format!("{definition}\n");
    for (name, definition) in nested {
        schema.push_str(&format!("{SEPARATOR}\nMSG: {name}\n{definition}\n"));
    }
    schema
}

/// A CDR message being written.
#[derive(Clone)]
pub(super) struct Cdr {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl Cdr {
    pub(super) fn little() -> Self {
        Self { bytes: vec![0, 1, 0, 0], big_endian: false }
    }

    pub(super) fn big() -> Self {
        Self { bytes: vec![0, 0, 0, 0], big_endian: true }
    }

    fn value<const N: usize>(mut self, mut little_endian: [u8; N]) -> Self {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        if self.big_endian {
            little_endian.reverse();
        }
        self.bytes.extend(little_endian);
        self
    }

    pub(super) fn u8(self, value: u8) -> Self {
        self.value([value])
    }

    pub(super) fn u16(self, value: u16) -> Self {
        self.value(value.to_le_bytes())
    }

    pub(super) fn u32(self, value: u32) -> Self {
        self.value(value.to_le_bytes())
    }

    pub(super) fn f32(self, value: f32) -> Self {
        self.value(value.to_le_bytes())
    }

    pub(super) fn f64(self, value: f64) -> Self {
        self.value(value.to_le_bytes())
    }

    pub(super) fn all(self, values: &[f64]) -> Self {
        values.iter().fold(self, |cdr, &value| cdr.f64(value))
    }

    pub(super) fn list(self, values: &[f64]) -> Self {
        self.u32(values.len() as u32).all(values)
    }

    pub(super) fn text(self, text: &str) -> Self {
        let mut cdr = self.u32(text.len() as u32 + 1);
        cdr.bytes.extend(text.as_bytes());
        cdr.u8(0)
    }

    pub(super) fn texts(self, texts: &[&str]) -> Self {
        texts.iter().fold(self.u32(texts.len() as u32), |cdr, text| cdr.text(text))
    }

    pub(super) fn header(self, seconds: u32, nanoseconds: u32, frame_id: &str) -> Self {
        self.u32(seconds).u32(nanoseconds).text(frame_id)
    }

    pub(super) fn done(self) -> Vec<u8> {
        self.bytes
    }

    pub(super) fn pose_stamped(
        seconds: u32,
        nanoseconds: u32,
        frame_id: &str,
        xyz: [f64; 3],
    ) -> Vec<u8> {
        let cdr = Self::little().header(seconds, nanoseconds, frame_id);
        cdr.all(&xyz).all(&[0.0, 0.0, 0.0, 1.0]).done()
    }

    pub(super) fn joint_state(names: &[&str], position: &[f64], velocity: &[f64]) -> Vec<u8> {
        let cdr = Self::little().header(1, 2, "base_link");
        cdr.texts(names).list(position).list(velocity).list(&[]).done()
    }
}

/// An MCAP file being written.
pub(super) struct LogWriter(Writer<Cursor<Vec<u8>>>);

impl Default for LogWriter {
    fn default() -> Self {
        Self::new(Some(Compression::Zstd))
    }
}

impl LogWriter {
    /// A file of small chunks.
    pub(super) fn new(compression: Option<Compression>) -> Self {
        Self::with(WriteOptions::new().compression(compression).chunk_size(Some(1024)))
    }

    pub(super) fn with(options: WriteOptions) -> Self {
        Self(options.create(Cursor::new(Vec::new())).unwrap())
    }

    pub(super) fn writer(&mut self) -> &mut Writer<Cursor<Vec<u8>>> {
        &mut self.0
    }

    pub(super) fn channel(&mut self, topic: &str, type_name: &str, schema: &str) -> u16 {
        self.encoded_channel(topic, type_name, "cdr", schema)
    }

    pub(super) fn encoded_channel(
        &mut self,
        topic: &str,
        type_name: &str,
        encoding: &str,
        schema: &str,
    ) -> u16 {
        let schema = self.0.add_schema(type_name, "ros2msg", schema.as_bytes()).unwrap();
        self.0.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
    }

    pub(super) fn message(&mut self, channel_id: u16, time: u64, data: &[u8]) {
        let header =
            MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time + 1 };
        self.0.write_to_known_channel(&header, data).unwrap();
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        self.0.finish().unwrap();
        self.0.into_inner().into_inner()
    }
}
