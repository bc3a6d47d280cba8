//! Generated logs for the benchmark, all of one arm.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use mcap::records::MessageHeader;
use mcap::{Compression, MessageStream, WriteOptions};
use poseaudit::geometry::rotvec_from_rotation;
use poseaudit::synth::{JOINT_STATES, POSE, Scenario};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// One log.
pub struct BenchLog {
    pub name: String,
    pub path: PathBuf,
    pub messages: u64,
    pub bytes: u64,
}

/// All logs.
pub struct Logs {
    pub mcap: Vec<BenchLog>,
    /// The reference log in other containers.
    pub others: Vec<BenchLog>,
    /// The same arm for 1, 4 and 16 times the duration.
    pub lengths: Vec<BenchLog>,
}

impl Logs {
    /// Generates the logs in `folder`; the largest has about `messages` messages.
    pub fn generate(folder: &Path, messages: u64) -> Result<Self> {
        let arm = |name: &str, messages: u64, compression: Option<Compression>| {
            generate_log(folder, &format!("{name}.mcap"), |path| {
                let mut scenario = scenario();
                scenario.duration_s = messages as f64 / rate_hz(&scenario);
                scenario.write_mcap(BufWriter::new(File::create(path)?), compression)?;
                Ok(())
            })
        };
        let zstd = Some(Compression::Zstd);
        let small = arm("arm for a camera, zstd", messages / 12, zstd)?;
        let camera = |name: &str, compression: Option<Compression>| {
            generate_log(folder, &format!("{name}.mcap"), |path| {
                write_with_camera(&small.path, path, compression)
            })
        };
        let mcap = vec![
            arm("arm, zstd", messages, zstd)?,
            arm("arm, lz4", messages, Some(Compression::Lz4))?,
            arm("arm, not compressed", messages, None)?,
            camera("camera 95 %, not compressed", None)?,
            camera("camera 95 %, zstd", zstd)?,
        ];
        let lengths = [16, 4, 1].map(|share| arm(&format!("1∕{share}"), messages / share, zstd));
        let whole = &mcap[0].path;
        let others = vec![
            generate_log(folder, "bag of ROS 1, lz4.bag", |path| write_ros1_bag(whole, path))?,
            generate_log(folder, "database of rosbag2.db3", |path| write_database(whole, path))?,
            generate_log(folder, "record of RTDE.csv", |path| write_rtde(whole, path))?,
        ];
        Ok(Self { mcap, others, lengths: lengths.into_iter().collect::<Result<_>>()? })
    }

    /// The reference log for stages and other containers.
    pub fn reference_log(&self) -> &BenchLog {
        &self.mcap[0]
    }
}

fn scenario() -> Scenario {
    let mut scenario = Scenario::ur5e();
    scenario.joints.timing.rate_hz = 500.0;
    scenario.pose.timing.rate_hz = 500.0;
    scenario.imu.timing.rate_hz = 200.0;
    scenario.tf.timing.rate_hz = 125.0;
    scenario
}

fn rate_hz(scenario: &Scenario) -> f64 {
    let timings =
        [&scenario.joints.timing, &scenario.pose.timing, &scenario.imu.timing, &scenario.tf.timing];
    timings.iter().map(|timing| timing.rate_hz).sum()
}

/// Generates a log if it does not exist, and counts its messages.
fn generate_log(
    folder: &Path,
    file: &str,
    write: impl FnOnce(&Path) -> Result<()>,
) -> Result<BenchLog> {
    let path = folder.join(file);
    if !path.exists() {
        eprintln!("making {}", path.display());
        let unfinished = folder.join("unfinished");
        let _none_there = fs::remove_file(&unfinished);
        write(&unfinished)?;
        fs::rename(&unfinished, &path)?;
    }
    let log = poseaudit::log::open(std::slice::from_ref(&path), &Default::default())?;
    let name = path.file_stem().context("a name")?.to_string_lossy().into_owned();
    Ok(BenchLog { name, messages: log.messages, bytes: fs::metadata(&path)?.len(), path })
}

/// Adds images to the log at `from`, with 19 times the bytes of its messages.
fn write_with_camera(from: &Path, to: &Path, compression: Option<Compression>) -> Result<()> {
    const IMAGE_BYTES: usize = 300_000;
    const IMAGE_BYTES_PER_MESSAGE_BYTE: usize = 19;
    let bytes = fs::read(from)?;
    let mut writer =
        WriteOptions::new().compression(compression).create(BufWriter::new(File::create(to)?))?;
    let schema = writer.add_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data")?;
    let camera = writer.add_channel(schema, "/camera/image_raw", "cdr", &Default::default())?;
    // Half of it is noise, as in images.
    let mut random = Pcg64::seed_from_u64(1);
    let mut image = vec![0; IMAGE_BYTES];
    random.fill_bytes(&mut image);
    image.iter_mut().for_each(|byte| *byte &= 0x0f);
    let mut image_bytes_due = 0;
    let mut channels: HashMap<u16, u16> = HashMap::new();
    for message in MessageStream::new(&bytes)? {
        let message = message?;
        let channel_id = match channels.get(&message.channel.id) {
            Some(&channel) => channel,
            None => {
                let logged = &message.channel;
                let schema = logged.schema.as_ref().context("a schema")?;
                let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
                let channel = writer.add_channel(
                    schema, &logged.topic, &logged.message_encoding, &logged.metadata,
                )?;
                channels.insert(logged.id, channel);
                channel
            }
        };
        let header = MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data)?;
        image_bytes_due += IMAGE_BYTES_PER_MESSAGE_BYTE * message.data.len();
        while image_bytes_due >= IMAGE_BYTES {
            image_bytes_due -= IMAGE_BYTES;
            let at = random.next_u32() as usize % IMAGE_BYTES;
            image[at] ^= 1;
            let header = MessageHeader {
                channel_id: camera,
                sequence: 0,
                log_time: message.log_time,
                publish_time: message.log_time,
            };
            writer.write_to_known_channel(&header, &image)?;
        }
    }
    writer.finish()?;
    Ok(())
}

/// Converts the log at `from` to a rosbag2 database.
fn write_database(from: &Path, to: &Path) -> Result<()> {
    let bytes = fs::read(from)?;
    let mut database = rusqlite::Connection::open(to)?;
    database.execute_batch(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
         serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
         CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, \
         timestamp INTEGER NOT NULL, data BLOB NOT NULL);
         CREATE INDEX timestamp_idx ON messages (timestamp ASC);",
    )?;
    let writing = database.transaction()?;
    let mut insert =
        writing.prepare("INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)")?;
    let mut topics: HashMap<String, i64> = HashMap::new();
    for message in MessageStream::new(&bytes)? {
        let message = message?;
        let topic = match topics.get(&message.channel.topic) {
            Some(&topic) => topic,
            None => {
                let schema = message.channel.schema.as_ref().context("a schema")?;
                writing.execute(
                    "INSERT INTO topics(name, type, serialization_format, offered_qos_profiles) \
                     VALUES (?1, ?2, 'cdr', '')",
                    [&message.channel.topic, &schema.name],
                )?;
                let topic = writing.last_insert_rowid();
                topics.insert(message.channel.topic.clone(), topic);
                topic
            }
        };
        insert.execute((topic, message.log_time as i64, &message.data[..]))?;
    }
    drop(insert);
    writing.commit()?;
    Ok(())
}

/// One sample of the arm.
struct Sample {
    nanos: i64,
    q: Vec<f64>,
}

/// Joint positions of the log at `from`, in the order of the UR5e's chain.
fn joint_samples(from: &Path) -> Result<Vec<Sample>> {
    let log = poseaudit::log::open(&[from.to_owned()], &Default::default())?;
    let topic = log.topics.into_iter().find(|topic| topic.name == JOINT_STATES);
    let Some(poseaudit::stream::Columns::Joints(joints)) = topic.and_then(|topic| topic.columns)
    else {
        anyhow::bail!("no joint states");
    };
    let row = |row: usize| Sample {
        nanos: joints.times.header[row],
        q: joints.joints.iter().map(|joint| joint.position[row]).collect(),
    };
    Ok((0..joints.times.len()).map(row).collect())
}

/// Joint positions and FK poses, recorded as by Universal Robots' client.
fn write_rtde(from: &Path, to: &Path) -> Result<()> {
    let scenario = scenario();
    let robot = &scenario.robot;
    let link = |name: &str| robot.link(name).context("a UR5e has that link");
    let chain = robot.chain(link("base")?, link("tool0")?)?;
    let mut out = BufWriter::new(File::create(to)?);
    let columns = (0..6).map(|i| format!("actual_q_{i}"));
    let columns = columns.chain((0..6).map(|i| format!("actual_TCP_pose_{i}")));
    writeln!(out, "timestamp {}", columns.collect::<Vec<_>>().join(" "))?;
    for Sample { nanos, q } in joint_samples(from)? {
        let pose = chain.forward(&q);
        let (p, r) = (pose.translation.vector, rotvec_from_rotation(&pose.rotation));
        write!(out, "{:.6}", (nanos - 1_780_000_000_000_000_000) as f64 * 1e-9 + 100.0)?;
        for value in q.iter().chain(p.iter()).chain(r.iter()) {
            write!(out, " {value:.9}")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

/// Joint states and poses in a ROS 1 bag, with lz4-compressed chunks.
fn write_ros1_bag(from: &Path, to: &Path) -> Result<()> {
    const CHUNK_BYTES: usize = 768 << 10;
    const JOINTS: &str = "std_msgs/Header header\nstring[] name\nfloat64[] position\n\
        float64[] velocity\nfloat64[] effort\n\
        ================\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
    const POSES: &str = "std_msgs/Header header\ngeometry_msgs/Pose pose\n\
        ================\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n\
        ================\nMSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n\
        ================\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n\
        ================\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n";
    let scenario = scenario();
    let robot = &scenario.robot;
    let link = |name: &str| robot.link(name).context("a UR5e has that link");
    let chain = robot.chain(link("base")?, link("tool0")?)?;
    let names = chain.joint_names().to_vec();
    let connections = [
        (JOINT_STATES, "sensor_msgs/JointState", JOINTS),
        (POSE, "geometry_msgs/PoseStamped", POSES),
    ];
    let connection = |id: u32| {
        let (topic, type_name, definition) = connections[id as usize];
        let header = encode_fields(&[
            ("op", &[7]),
            ("conn", &id.to_le_bytes()),
            ("topic", topic.as_bytes()),
        ]);
        let data = encode_fields(&[
            ("topic", topic.as_bytes()),
            ("type", type_name.as_bytes()),
            ("md5sum", b"*"),
            ("message_definition", definition.as_bytes()),
        ]);
        encode_record(&header, &data)
    };

    let mut out = BufWriter::new(File::create(to)?);
    out.write_all(b"#ROSBAG V2.0\n")?;
    let bag_header = |index: u64, chunks: u32| {
        let header = encode_fields(&[
            ("op", &[3]),
            ("index_pos", &index.to_le_bytes()),
            ("conn_count", &2_u32.to_le_bytes()),
            ("chunk_count", &chunks.to_le_bytes()),
        ]);
        encode_record(&header, &vec![b' '; 4096 - 8 - header.len()])
    };
    out.write_all(&bag_header(0, 0))?;

    let mut infos = Vec::new();
    let mut chunk = [connection(0), connection(1)].concat();
    let mut entries: [Vec<u8>; 2] = Default::default();
    let mut span: Option<([u8; 8], [u8; 8])> = None;
    let samples = joint_samples(from)?;
    for (number, Sample { nanos, q }) in samples.iter().enumerate() {
        let time = [(nanos / 1_000_000_000) as u32, (nanos % 1_000_000_000) as u32];
        let time: [u8; 8] = time.map(u32::to_le_bytes).concat().try_into().expect("eight bytes");
        let pose = chain.forward(q);
        let head = |frame: &str| {
            let mut head = (number as u32).to_le_bytes().to_vec();
            head.extend(time);
            push_text(&mut head, frame);
            head
        };
        let mut joints = head("");
        joints.extend((names.len() as u32).to_le_bytes());
        names.iter().for_each(|name| push_text(&mut joints, name));
        joints.extend((q.len() as u32).to_le_bytes());
        q.iter().for_each(|q| joints.extend(q.to_le_bytes()));
        joints.extend([0; 8]);
        let mut pose_message = head("base");
        let quaternion = pose.rotation.coords;
        for value in pose.translation.vector.iter().chain(quaternion.iter()) {
            pose_message.extend(value.to_le_bytes());
        }
        for (id, data) in [(0_u32, joints), (1, pose_message)] {
            let entry = &mut entries[id as usize];
            entry.extend(time);
            entry.extend((chunk.len() as u32).to_le_bytes());
            let header =
                encode_fields(&[("op", &[2]), ("conn", &id.to_le_bytes()), ("time", &time)]);
            chunk.extend(encode_record(&header, &data));
        }
        span = Some((span.map_or(time, |(first, _)| first), time));
        if chunk.len() < CHUNK_BYTES && number + 1 < samples.len() {
            continue;
        }
        let (first, last) = span.take().context("a chunk has messages")?;
        let offset = out.stream_position()?;
        let mut packed = lz4::EncoderBuilder::new().build(Vec::new())?;
        packed.write_all(&chunk)?;
        let (packed, done) = packed.finish();
        done?;
        let size = (chunk.len() as u32).to_le_bytes();
        let header = encode_fields(&[("op", &[5]), ("compression", b"lz4"), ("size", &size)]);
        out.write_all(&encode_record(&header, &packed))?;
        let mut counts = Vec::new();
        for (id, entries) in entries.iter_mut().enumerate() {
            let (id, count) = (id as u32, (entries.len() / 12) as u32);
            let header = encode_fields(&[
                ("op", &[4]),
                ("ver", &1_u32.to_le_bytes()),
                ("conn", &id.to_le_bytes()),
                ("count", &count.to_le_bytes()),
            ]);
            out.write_all(&encode_record(&header, entries))?;
            counts.extend([id, count].map(u32::to_le_bytes).concat());
            entries.clear();
        }
        let header = encode_fields(&[
            ("op", &[6]),
            ("ver", &1_u32.to_le_bytes()),
            ("chunk_pos", &offset.to_le_bytes()),
            ("start_time", &first),
            ("end_time", &last),
            ("count", &2_u32.to_le_bytes()),
        ]);
        infos.push(encode_record(&header, &counts));
        chunk.clear();
    }
    let index = out.stream_position()?;
    out.write_all(&[connection(0), connection(1)].concat())?;
    out.write_all(&infos.concat())?;
    out.seek(SeekFrom::Start(b"#ROSBAG V2.0\n".len() as u64))?;
    out.write_all(&bag_header(index, infos.len() as u32))?;
    Ok(out.flush()?)
}

fn push_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

/// `name=value` fields, each after its length.
fn encode_fields(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let field = |(name, value): &(&str, &[u8])| {
        let length = (name.len() + 1 + value.len()) as u32;
        [&length.to_le_bytes(), name.as_bytes(), b"=", *value].concat()
    };
    fields.iter().flat_map(field).collect()
}

/// A bag record: header and data, each after its length.
fn encode_record(header: &[u8], data: &[u8]) -> Vec<u8> {
    let [header_length, data_length] = [header, data].map(|part| (part.len() as u32).to_le_bytes());
    [&header_length, header, &data_length, data].concat()
}
