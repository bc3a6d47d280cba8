//! A log as messages, and edits that the generator does not offer.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use mcap::{Channel, Compression, Schema};

use poseaudit::synth::{GOAL, IMU, JOINT_STATES, POSE, Scenario, TARGET, TF, TF_STATIC};

/// One message of a log.
#[derive(Clone)]
pub struct Message {
    pub topic: String,
    pub type_name: String,
    pub definition: String,
    pub log_ns: i64,
    /// Encoded message, with the four bytes of the encapsulation header.
    pub cdr: Vec<u8>,
}

/// The bytes of the log of `run`, with edited messages.
pub fn write(run: &Scenario, edit: Option<fn(&mut Vec<Message>)>) -> Vec<u8> {
    let mut bytes = Vec::new();
    run.write_mcap(Cursor::new(&mut bytes), None).expect("the log is written");
    let Some(edit) = edit else { return bytes };
    let mut messages = read(&bytes);
    edit(&mut messages);
    encode(&messages)
}

/// The messages of a log.
pub fn read(bytes: &[u8]) -> Vec<Message> {
    let messages = mcap::MessageStream::new(bytes).expect("a log");
    let message = |message: mcap::Message| {
        let schema = message.channel.schema.as_ref().expect("a schema");
        Message {
            topic: message.channel.topic.clone(),
            type_name: schema.name.clone(),
            definition: String::from_utf8(schema.data.to_vec()).expect("a text"),
            log_ns: message.log_time.cast_signed(),
            cdr: message.data.to_vec(),
        }
    };
    messages.map(|read| message(read.expect("a message"))).collect()
}

/// The log of `messages`, in chunks of about 64 KiB.
pub fn encode(messages: &[Message]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = mcap::WriteOptions::new()
        .profile("ros2")
        .compression(Some(Compression::Zstd))
        .compression_threads(0)
        .chunk_size(Some(1 << 16));
    let mut writer = options.create(Cursor::new(&mut bytes)).expect("a writer");
    let mut channels: BTreeMap<&str, Arc<Channel>> = BTreeMap::new();
    for (sequence, message) in (1..).zip(messages) {
        let id = channels.len() as u16;
        let channel = channels.entry(&message.topic).or_insert_with(|| {
            let schema = Schema {
                id: id + 1,
                name: message.type_name.clone(),
                encoding: "ros2msg".to_owned(),
                data: Cow::Owned(message.definition.clone().into_bytes()),
            };
            Arc::new(Channel {
                id,
                topic: message.topic.clone(),
                schema: Some(Arc::new(schema)),
                message_encoding: "cdr".to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let time = message.log_ns.cast_unsigned();
        let written = mcap::Message {
            channel: Arc::clone(channel),
            sequence,
            log_time: time,
            publish_time: time,
            data: Cow::Borrowed(&message.cdr),
        };
        writer.write(&written).expect("a message is written");
    }
    writer.finish().expect("the log is written");
    drop(writer);
    bytes
}

/// A part of a message, by byte offset.
pub enum Field {
    /// Seconds and nanoseconds.
    Stamp(usize),
    /// Position or translation; for a transform with its child frame.
    Xyz(usize, String),
    /// A quaternion.
    Xyzw(usize),
}

impl Message {
    /// Fields that tests edit.
    pub fn fields(&self) -> Vec<Field> {
        let mut cdr = Reader { bytes: &self.cdr, at: 4 };
        let mut fields = Vec::new();
        match self.topic.as_str() {
            JOINT_STATES => fields.push(cdr.header()),
            POSE | TARGET | GOAL => {
                fields.extend([cdr.header(), cdr.xyz(String::new()), cdr.xyzw()])
            }
            IMU => fields.extend([cdr.header(), cdr.xyzw()]),
            TF | TF_STATIC => {
                for _ in 0..cdr.u32() {
                    fields.push(cdr.header());
                    let child = cdr.string();
                    fields.extend([cdr.xyz(child), cdr.xyzw()]);
                }
            }
            _ => {}
        }
        fields
    }

    pub fn floats<const N: usize>(&self, at: usize) -> [f64; N] {
        let float = |i: usize| f64::from_le_bytes(self.cdr[at + 8 * i..][..8].try_into().unwrap());
        std::array::from_fn(float)
    }

    pub fn set_floats(&mut self, at: usize, values: &[f64]) {
        for (i, value) in values.iter().enumerate() {
            self.cdr[at + 8 * i..][..8].copy_from_slice(&value.to_le_bytes());
        }
    }

    /// Shifts its stamps and its receive time by `by_ns`.
    pub fn shift(&mut self, by_ns: i64) {
        self.log_ns += by_ns;
        self.shift_stamps(by_ns);
    }

    /// Shifts its stamps by `by_ns`, but not its receive time.
    pub fn shift_stamps(&mut self, by_ns: i64) {
        const SECOND_NS: i64 = 1_000_000_000;
        for field in self.fields() {
            let Field::Stamp(at) = field else { continue };
            let word = |at: usize| u32::from_le_bytes(self.cdr[at..at + 4].try_into().unwrap());
            let stamp_ns = i64::from(word(at)) * SECOND_NS + i64::from(word(at + 4)) + by_ns;
            let seconds = u32::try_from(stamp_ns / SECOND_NS).expect("a stamp after 1970");
            let nanos = (stamp_ns % SECOND_NS) as u32;
            self.cdr[at..at + 4].copy_from_slice(&seconds.to_le_bytes());
            self.cdr[at + 4..at + 8].copy_from_slice(&nanos.to_le_bytes());
        }
    }

    /// Rotates joint `joint` of a joint state by `by_rad`; NaN removes its position.
    pub fn turn_joint(&mut self, joint: usize, by_rad: f64) {
        let mut cdr = Reader { bytes: &self.cdr, at: 4 };
        cdr.header();
        (0..cdr.u32()).for_each(|_| drop(cdr.string()));
        let joints = cdr.list().len();
        let at = cdr.at - 8 * (joints - joint);
        let [q] = self.floats(at);
        self.set_floats(at, &[q + by_rad]);
    }

    /// Multiplies all positions of a joint state.
    pub fn scale_joints(&mut self, factor: f64) {
        let mut cdr = Reader { bytes: &self.cdr, at: 4 };
        cdr.header();
        (0..cdr.u32()).for_each(|_| drop(cdr.string()));
        let positions = cdr.list();
        let at = cdr.at - 8 * positions.len();
        self.set_floats(at, &positions.iter().map(|q| factor * q).collect::<Vec<f64>>());
    }

    /// Reorders the joints of a joint state, names and numbers alike.
    pub fn reorder_joints(&mut self, order: &[usize]) {
        let mut cdr = Reader { bytes: &self.cdr, at: 4 };
        cdr.header();
        let from = cdr.at;
        let names: Vec<String> = (0..cdr.u32()).map(|_| cdr.string()).collect();
        let lists: Vec<Vec<f64>> = (0..3).map(|_| cdr.list()).collect();
        let mut written = self.cdr[..from].to_vec();
        align(&mut written, 4);
        written.extend((names.len() as u32).to_le_bytes());
        order.iter().for_each(|&joint| append_name(&mut written, &names[joint]));
        for list in lists {
            let numbers: Vec<f64> = match list.as_slice() {
                [] => Vec::new(),
                list => order.iter().map(|&joint| list[joint]).collect(),
            };
            append_list(&mut written, &numbers);
        }
        self.cdr = written;
    }

    /// Replaces the joints of a joint state by three wheels at 0.
    pub fn become_wheels(&mut self) {
        let mut cdr = Reader { bytes: &self.cdr, at: 4 };
        cdr.header();
        let mut written = self.cdr[..cdr.at].to_vec();
        align(&mut written, 4);
        written.extend(3_u32.to_le_bytes());
        for name in ["left_wheel", "right_wheel", "caster"] {
            append_name(&mut written, name);
        }
        for numbers in [[0.0; 3].as_slice(), &[], &[]] {
            append_list(&mut written, numbers);
        }
        self.cdr = written;
    }

    /// Replaces the content by a single transform without rotation, with its own stamp.
    pub fn become_transform(&mut self, parent: &str, child: &str, xyz: [f64; 3]) {
        let header: [u8; 8] = self.cdr[8..16].try_into().expect("a stamp");
        self.cdr.truncate(4);
        self.cdr.extend(1_u32.to_le_bytes());
        self.cdr.extend(header);
        for name in [parent, child] {
            append_name(&mut self.cdr, name);
        }
        align(&mut self.cdr, 8);
        let numbers = xyz.into_iter().chain([0.0, 0.0, 0.0, 1.0]);
        self.cdr.extend(numbers.flat_map(f64::to_le_bytes));
    }

    /// Replaces the message by a `std_msgs/Float64MultiArray` of `numbers`.
    pub fn become_array(&mut self, topic: &str, numbers: &[f64]) {
        self.topic = topic.to_owned();
        self.type_name = "std_msgs/msg/Float64MultiArray".to_owned();
        let parts = [
            ("MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n"),
            ("MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"),
        ];
        self.definition = "MultiArrayLayout layout\nfloat64[] data\n".to_owned();
        for (name, fields) in parts {
            self.definition += &format!("{:=<80}\nMSG: std_msgs/{name}\n{fields}", "");
        }
        self.cdr.truncate(4);
        self.cdr.extend([0; 8]);
        append_list(&mut self.cdr, numbers);
    }
}

/// Aligns the end to `size` bytes, relative to the end of the encapsulation header.
fn align(cdr: &mut Vec<u8>, size: usize) {
    cdr.resize((cdr.len() - 4).next_multiple_of(size) + 4, 0);
}

fn append_name(cdr: &mut Vec<u8>, name: &str) {
    align(cdr, 4);
    cdr.extend((name.len() as u32 + 1).to_le_bytes());
    cdr.extend(name.as_bytes());
    cdr.push(0);
}

fn append_list(cdr: &mut Vec<u8>, numbers: &[f64]) {
    align(cdr, 4);
    cdr.extend((numbers.len() as u32).to_le_bytes());
    if !numbers.is_empty() {
        align(cdr, 8);
    }
    for number in numbers {
        cdr.extend(number.to_le_bytes());
    }
}

/// Sequential access to a message.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    /// Offset of the next value of `size` bytes; skips `count` of them.
    fn skip(&mut self, size: usize, count: usize) -> usize {
        let at = (self.at - 4).next_multiple_of(size) + 4;
        self.at = at + size * count;
        at
    }

    fn u32(&mut self) -> u32 {
        let at = self.skip(4, 1);
        u32::from_le_bytes(self.bytes[at..at + 4].try_into().unwrap())
    }

    fn string(&mut self) -> String {
        let length = self.u32() as usize;
        let at = self.skip(1, length);
        String::from_utf8(self.bytes[at..at + length - 1].to_vec()).expect("a text")
    }

    fn list(&mut self) -> Vec<f64> {
        let count = self.u32() as usize;
        if count == 0 {
            return Vec::new();
        }
        let at = self.skip(8, count);
        let numbers = self.bytes[at..at + 8 * count].chunks_exact(8);
        numbers.map(|number| f64::from_le_bytes(number.try_into().unwrap())).collect()
    }

    /// The stamp; skips the frame.
    fn header(&mut self) -> Field {
        let at = self.skip(4, 2);
        self.string();
        Field::Stamp(at)
    }

    fn xyz(&mut self, child: String) -> Field {
        Field::Xyz(self.skip(8, 3), child)
    }

    fn xyzw(&mut self) -> Field {
        Field::Xyzw(self.skip(8, 4))
    }
}

/// Shifts the stamps of `topic` (all topics if empty) by `by_s`, for messages received from `from_s` to
/// `to_s` after the first. Receive times stay.
pub fn shift_stamps(messages: &mut [Message], topic: &str, from_s: f64, to_s: f64, by_s: f64) {
    let nanos = |seconds: f64| (seconds * 1e9) as i64;
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let within = start_ns + nanos(from_s)..start_ns.saturating_add(nanos(to_s));
    for message in messages.iter_mut().filter(|message| within.contains(&message.log_ns)) {
        if topic.is_empty() || message.topic == topic {
            message.shift_stamps(nanos(by_s));
        }
    }
}

/// Drops the messages of `topic` received from `from_s` to `to_s` after the first message.
pub fn drop_messages(messages: &mut Vec<Message>, topic: &str, from_s: f64, to_s: f64) {
    let nanos = |seconds: f64| (seconds * 1e9) as i64;
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let within = start_ns + nanos(from_s)..start_ns.saturating_add(nanos(to_s));
    messages.retain(|message| message.topic != topic || !within.contains(&message.log_ns));
}

/// Moves the positions of samples `rows` of `topic` by `by_m`.
pub fn displace(messages: &mut [Message], topic: &str, rows: &[usize], by_m: [f64; 3]) {
    let of_topic = messages.iter_mut().filter(|message| message.topic == topic);
    for (_, message) in of_topic.enumerate().filter(|(row, _)| rows.contains(row)) {
        for field in message.fields() {
            let Field::Xyz(at, _) = field else { continue };
            let xyz: [f64; 3] = message.floats(at);
            message.set_floats(at, &[0, 1, 2].map(|axis| xyz[axis] + by_m[axis]));
        }
    }
}

/// Writes `stamp`, seconds and nanoseconds, into a message header.
pub fn set_stamp(message: &mut Message, stamp: [u8; 8]) {
    for field in message.fields() {
        let Field::Stamp(at) = field else { continue };
        message.cdr[at..at + 8].copy_from_slice(&stamp);
    }
}

pub fn rename_topic(messages: &mut [Message], from: &str, to: &str) {
    for message in messages.iter_mut().filter(|message| message.topic == from) {
        message.topic = to.to_owned();
    }
}

/// Changes the frame of every `step`th message of `topic`.
pub fn rename_frame(messages: &mut [Message], topic: &str, step: usize) {
    let of_topic = messages.iter_mut().filter(|message| message.topic == topic);
    for message in of_topic.step_by(step) {
        for field in message.fields() {
            let Field::Stamp(at) = field else { continue };
            // The frame name follows the stamp and the length.
            message.cdr[at + 12] = b'x';
        }
    }
}

/// Freezes the samples of `topic` received from `from_s` to `to_s` at their first value.
pub fn freeze_samples(messages: &mut [Message], topic: &str, from_s: f64, to_s: f64) {
    let nanos = |seconds: f64| (seconds * 1e9) as i64;
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let within = start_ns + nanos(from_s)..start_ns.saturating_add(nanos(to_s));
    let mut first: Option<[f64; 7]> = None;
    let is_meant =
        |message: &&mut Message| message.topic == topic && within.contains(&message.log_ns);
    for message in messages.iter_mut().filter(is_meant) {
        for field in message.fields() {
            let Field::Xyz(at, _) = field else { continue };
            let numbers = *first.get_or_insert(message.floats(at));
            message.set_floats(at, &numbers);
        }
    }
}

/// Poses of an object: noise at rest, except while the arm carries it from `from_s` to `to_s`.
pub fn carry(messages: &mut [Message], topic: &str, from_s: f64, to_s: f64) {
    const NOISE_M: f64 = 2e-4;
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let mut own: Vec<&mut Message> =
        messages.iter_mut().filter(|message| message.topic == topic).collect();
    let row_at = |at_s: f64| {
        own.partition_point(|message| ((message.log_ns - start_ns) as f64) < 1e9 * at_s)
    };
    let [first, last] = [from_s, to_s].map(row_at);
    let pose_of = |message: &Message| {
        let at = message.fields().into_iter().find_map(|field| match field {
            Field::Xyz(at, _) => Some(at),
            _ => None,
        });
        at.map(|at| (at, message.floats::<7>(at)))
    };
    let [before, after] = [first, last].map(|row| pose_of(own[row]).expect("a pose").1);
    for (row, message) in own.iter_mut().enumerate() {
        let Some((at, _)) = pose_of(message) else { continue };
        let mut rest = if row < first { before } else { after };
        rest[0] += NOISE_M * (row as f64).sin();
        if !(first..last).contains(&row) {
            message.set_floats(at, &rest);
        }
    }
}

/// Sets the poses of `topic` received in one of `spans_s` to zero without rotation, as a tracker without a target does.
pub fn lose_target(messages: &mut [Message], topic: &str, spans_s: &[(f64, f64)]) {
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    for message in messages.iter_mut().filter(|message| message.topic == topic) {
        let at_s = 1e-9 * (message.log_ns - start_ns) as f64;
        for field in message.fields() {
            let Field::Xyz(at, _) = field else { continue };
            if spans_s.iter().any(|&(from_s, to_s)| (from_s..to_s).contains(&at_s)) {
                message.set_floats(at, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
            }
        }
    }
}

/// Moves the poses of `topic` along a line, with a period of 0.8 s.
pub fn swing(messages: &mut [Message], topic: &str) {
    let of_topic = messages.iter_mut().filter(|message| message.topic == topic);
    for (row, message) in of_topic.enumerate() {
        for field in message.fields() {
            if let Field::Xyz(at, _) = field {
                let y = 0.2 * (0.31 * row as f64).sin();
                message.set_floats(at, &[0.4, y, 0.3, 0.0, 0.0, 0.0, 1.0]);
            }
        }
    }
}

/// Turns the poses of `topic` into points.
pub fn take_rotations(messages: &mut [Message], topic: &str) {
    const DEFINITION: &str = "std_msgs/Header header\ngeometry_msgs/Point point\n===\nMSG: geometry_msgs/Point\nfloat64 x\n\
                              float64 y\nfloat64 z\n===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n\
                              string frame_id\n===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
    const QUATERNION_BYTES: usize = 32;
    for message in messages.iter_mut().filter(|message| message.topic == topic) {
        message.type_name = "geometry_msgs/msg/PointStamped".to_owned();
        message.definition = DEFINITION.to_owned();
        message.cdr.truncate(message.cdr.len() - QUATERNION_BYTES);
    }
}

/// Sets all stamps of `topic` to the first.
pub fn freeze_stamps(messages: &mut [Message], topic: &str) {
    let mut first: Option<[u8; 8]> = None;
    for message in messages.iter_mut().filter(|message| message.topic == topic) {
        for field in message.fields() {
            if let Field::Stamp(at) = field {
                let stamp = &mut message.cdr[at..at + 8];
                let own: [u8; 8] = (&*stamp).try_into().unwrap();
                stamp.copy_from_slice(first.get_or_insert(own).as_slice());
            }
        }
    }
}

/// Repeats every `every`th sample of `topic` until the next.
pub fn repeat_samples(messages: &mut [Message], topic: &str, every: usize) {
    let mut new: Vec<[f64; 7]> = Vec::new();
    let of_topic = messages.iter_mut().filter(|message| message.topic == topic);
    for (row, message) in of_topic.enumerate() {
        let places = message.fields().into_iter().filter_map(|field| match field {
            Field::Xyz(at, _) => Some(at),
            _ => None,
        });
        let places: Vec<usize> = places.collect();
        if row % every == 0 {
            new = places.iter().map(|&at| message.floats(at)).collect();
        }
        for (&at, numbers) in places.iter().zip(&new) {
            message.set_floats(at, numbers);
        }
    }
}

/// Adds a joint state of three wheels at 0 after each of the arm's.
pub fn add_wheels(messages: &mut Vec<Message>) {
    let states = messages.iter().filter(|message| message.topic == JOINT_STATES);
    let mut wheels: Vec<Message> = states.cloned().collect();
    for message in &mut wheels {
        message.become_wheels();
        message.shift(1_000_000);
    }
    messages.extend(wheels);
    messages.sort_by_key(|message| message.log_ns);
}

/// Freezes the joint states received from `from_s` to `to_s` at the first of them.
pub fn freeze_joints(messages: &mut [Message], from_s: f64, to_s: f64) {
    /// End offset of a message's stamp.
    const STAMP_END: usize = 12;
    let nanos = |seconds: f64| (seconds * 1e9) as i64;
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let within = start_ns + nanos(from_s)..start_ns.saturating_add(nanos(to_s));
    let mut first: Option<Vec<u8>> = None;
    let is_meant =
        |message: &&mut Message| message.topic == JOINT_STATES && within.contains(&message.log_ns);
    for message in messages.iter_mut().filter(is_meant) {
        let body = first.get_or_insert_with(|| message.cdr[STAMP_END..].to_vec()).clone();
        message.cdr.truncate(STAMP_END);
        message.cdr.extend(body);
    }
}
