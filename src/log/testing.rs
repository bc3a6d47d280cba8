use std::collections::BTreeMap;
use std::io::{Cursor, Read, Write};
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};

const SEPARATOR: &str =
    "================================================================================";

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

/// With `nested` definitions, as concatenated by rosbag2.
pub(super) fn schema(definition: &str, nested: &[(&str, &str)]) -> String {
    let mut schema = format!("{definition}\n");
    for (name, definition) in nested {
        schema.push_str(&format!("{SEPARATOR}\nMSG: {name}\n{definition}\n"));
    }
    schema
}

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

pub(super) struct LogWriter(Writer<Cursor<Vec<u8>>>);

impl Default for LogWriter {
    fn default() -> Self {
        Self::new(Some(Compression::Zstd))
    }
}

impl LogWriter {
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

pub(super) struct BagWriter {
    bytes: Vec<u8>,
    compression: &'static str,
    chunk: Vec<u8>,
    connections: Vec<Vec<u8>>,
    /// Time and offset, by connection.
    index: BTreeMap<u32, Vec<(u64, u32)>>,
    chunk_infos: Vec<Vec<u8>>,
}

impl BagWriter {
    /// `none`, `lz4` or `bz2`.
    pub(super) fn new(compression: &'static str) -> Self {
        let mut bytes = super::rosbag1::MAGIC.to_vec();
        bytes.extend(Self::bag_header(0, 0, 0));
        Self {
            bytes,
            compression,
            chunk: Vec::new(),
            connections: Vec::new(),
            index: BTreeMap::new(),
            chunk_infos: Vec::new(),
        }
    }

    fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
        let mut header = Vec::new();
        for (name, value) in fields {
            header.extend((name.len() as u32 + 1 + value.len() as u32).to_le_bytes());
            header.extend(name.as_bytes());
            header.push(b'=');
            header.extend(*value);
        }
        header
    }

    fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        let header = Self::header(fields);
        let mut record = (header.len() as u32).to_le_bytes().to_vec();
        record.extend(header);
        record.extend((data.len() as u32).to_le_bytes());
        record.extend(data);
        record
    }

    fn bag_header(index: u64, connections: u32, chunks: u32) -> Vec<u8> {
        let fields: [(&str, &[u8]); 4] = [
            ("op", &[3]),
            ("index_pos", &index.to_le_bytes()),
            ("conn_count", &connections.to_le_bytes()),
            ("chunk_count", &chunks.to_le_bytes()),
        ];
        // Recorders reserve 4096 bytes.
        Self::record(&fields, &[b' '; 16])
    }

    fn time(nanos: u64) -> [u8; 8] {
        let (seconds, rest) = ((nanos / 1_000_000_000) as u32, (nanos % 1_000_000_000) as u32);
        (u64::from(rest) << 32 | u64::from(seconds)).to_le_bytes()
    }

    pub(super) fn connection(&mut self, topic: &str, type_name: &str, definition: &str) -> u32 {
        let id = self.connections.len() as u32;
        let of_sender = Self::header(&[
            ("callerid", b"/recorder"),
            ("md5sum", b"*"),
            ("message_definition", definition.as_bytes()),
            ("topic", topic.as_bytes()),
            ("type", type_name.as_bytes()),
        ]);
        let fields: [(&str, &[u8]); 3] =
            [("conn", &id.to_le_bytes()), ("op", &[7]), ("topic", topic.as_bytes())];
        let record = Self::record(&fields, &of_sender);
        self.chunk.extend(&record);
        self.connections.push(record);
        id
    }

    pub(super) fn message(&mut self, connection: u32, nanos: u64, data: &[u8]) {
        let place = self.chunk.len() as u32;
        self.index.entry(connection).or_default().push((nanos, place));
        let fields: [(&str, &[u8]); 3] =
            [("conn", &connection.to_le_bytes()), ("op", &[2]), ("time", &Self::time(nanos))];
        self.chunk.extend(Self::record(&fields, data));
    }

    fn packed(&self) -> Vec<u8> {
        match self.compression {
            "lz4" => {
                let checksum = lz4::ContentChecksum::ChecksumEnabled;
                let builder = lz4::EncoderBuilder::new().checksum(checksum).build(Vec::new());
                let mut encoder = builder.unwrap();
                encoder.write_all(&self.chunk).unwrap();
                let (packed, end) = encoder.finish();
                end.unwrap();
                packed
            }
            "bz2" => {
                let mut packed = Vec::new();
                let level = bzip2::Compression::fast();
                bzip2::read::BzEncoder::new(&self.chunk[..], level)
                    .read_to_end(&mut packed)
                    .unwrap();
                packed
            }
            _ => self.chunk.clone(),
        }
    }

    fn chunk_header(&self, size: u32) -> [(&'static str, Vec<u8>); 3] {
        [
            ("compression", self.compression.as_bytes().to_vec()),
            ("op", vec![5]),
            ("size", size.to_le_bytes().to_vec()),
        ]
    }

    pub(super) fn end_chunk(&mut self) -> usize {
        let place = self.bytes.len();
        let header = self.chunk_header(self.chunk.len() as u32);
        let fields = header.each_ref().map(|(name, value)| (*name, value.as_slice()));
        self.bytes.extend(Self::record(&fields, &self.packed()));
        let mut counts = Vec::new();
        for (connection, entries) in std::mem::take(&mut self.index) {
            let (connection, count) = (connection.to_le_bytes(), entries.len() as u32);
            counts.extend(connection);
            counts.extend(count.to_le_bytes());
            let data: Vec<u8> = entries
                .iter()
                .flat_map(|&(nanos, place)| [&Self::time(nanos)[..], &place.to_le_bytes()].concat())
                .collect();
            let fields: [(&str, &[u8]); 4] = [
                ("conn", &connection),
                ("count", &count.to_le_bytes()),
                ("op", &[4]),
                ("ver", &[1, 0, 0, 0]),
            ];
            self.bytes.extend(Self::record(&fields, &data));
        }
        let fields: [(&str, &[u8]); 6] = [
            ("chunk_pos", &(place as u64).to_le_bytes()),
            ("count", &(counts.len() as u32 / 8).to_le_bytes()),
            ("end_time", &[0; 8]),
            ("op", &[6]),
            ("start_time", &[0; 8]),
            ("ver", &[1, 0, 0, 0]),
        ];
        self.chunk_infos.push(Self::record(&fields, &counts));
        self.chunk.clear();
        place
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        if !self.chunk.is_empty() {
            self.end_chunk();
        }
        let (connections, chunks) = (self.connections.len() as u32, self.chunk_infos.len() as u32);
        let header = Self::bag_header(self.bytes.len() as u64, connections, chunks);
        let start = super::rosbag1::MAGIC.len();
        self.bytes[start..start + header.len()].copy_from_slice(&header);
        self.bytes.extend(self.connections.concat());
        self.bytes.extend(self.chunk_infos.concat());
        self.bytes
    }

    /// Like a crash: the last chunk has length zero, and there is no index.
    pub(super) fn abandon(mut self) -> Vec<u8> {
        let header = self.chunk_header(0);
        let fields = header.each_ref().map(|(name, value)| (*name, value.as_slice()));
        self.bytes.extend(Self::record(&fields, &[]));
        let packed = self.packed();
        self.bytes.extend(packed);
        self.bytes
    }
}

pub(super) struct DatabaseWriter(rusqlite::Connection);

impl DatabaseWriter {
    /// Schema version 4.
    pub(super) fn create(path: &Path) -> Self {
        let database = rusqlite::Connection::open(path).unwrap();
        let schema = "
            PRAGMA page_size = 1024;
            CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
            CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,
                metadata TEXT NOT NULL);
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
                type_description_hash TEXT NOT NULL);
            CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
                encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,
                type_description_hash TEXT NOT NULL);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                timestamp INTEGER NOT NULL, data BLOB NOT NULL);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);
            INSERT INTO schema VALUES (4, 'jazzy');";
        database.execute_batch(schema).unwrap();
        Self(database)
    }

    /// Schema version 1.
    pub(super) fn create_old(path: &Path) -> Self {
        let database = rusqlite::Connection::open(path).unwrap();
        let schema = "
            CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                serialization_format TEXT NOT NULL);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                timestamp INTEGER NOT NULL, data BLOB NOT NULL);";
        database.execute_batch(schema).unwrap();
        Self(database)
    }

    pub(super) fn database(&self) -> &rusqlite::Connection {
        &self.0
    }

    pub(super) fn poses(&self, id: i64, topic: &str) {
        let type_name = "geometry_msgs/msg/PoseStamped";
        let columns = "id, name, type, serialization_format";
        let old = format!("INSERT INTO topics ({columns}) VALUES (?1, ?2, ?3, 'cdr')");
        let new = format!(
            "INSERT INTO topics ({columns}, offered_qos_profiles, type_description_hash) \
             VALUES (?1, ?2, ?3, 'cdr', '', '')"
        );
        if self.0.execute(&new, (id, topic, type_name)).is_err() {
            self.0.execute(&old, (id, topic, type_name)).unwrap();
            return;
        }
        let definition = "INSERT INTO message_definitions (topic_type, encoding, \
            encoded_message_definition, type_description_hash) VALUES (?1, 'ros2msg', ?2, '')";
        self.0.execute(definition, (type_name, POSE_STAMPED)).unwrap();
    }

    pub(super) fn message(&self, topic: i64, nanos: i64, data: &[u8]) {
        let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        self.0.execute(insert, (topic, nanos, data)).unwrap();
    }

    /// x, time and stamp count from `first`.
    pub(super) fn count_poses(&self, topic: i64, first: u32, count: u32) {
        self.0.execute_batch("BEGIN").unwrap();
        for n in first..first + count {
            self.message(topic, n.into(), &Cdr::pose_stamped(0, n, "base", [n.into(), 0.5, 0.25]));
        }
        self.0.execute_batch("COMMIT").unwrap();
    }
}
