//! Topics of a log and messages of its audit as Foxglove channels. A log has millions of rows, so each message is
//! encoded only when it is read.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | of joint states | `foxglove.JointStates` | positions and velocities, rad and rad/s |
//! | of poses, of transforms | `foxglove.PoseInFrame`, `foxglove.FrameTransform` | as logged; table columns only if named |
//! | of other numbers, of IMUs, of texts | `poseaudit.Numbers`, `poseaudit.Imu`, `poseaudit.Text` | as logged |
//! | `/poseaudit/pose/TOPIC` | `foxglove.PoseInFrame` | audited poses as logged, in the frame of the arm |
//! | `/poseaudit/fk/TOPIC` | `foxglove.PoseInFrame` | FK of the logged joint states at the same stamps |
//! | other `/poseaudit/` | | messages of [the parent module](super) |

use std::collections::{BTreeMap, HashSet};

use serde_json::{Value, json};

use super::{Message, identity_rotation, messages, schema, time};
use crate::Audited;
use crate::geometry::{Pose, xyz_of, xyzw_from_rotation};
use crate::log::{RotationLabels, TableCell, Topic};
use crate::report::Report;
use crate::stream::{ArrayColumns, Columns, ImuColumns, JointColumns, PoseColumns, Times};
use crate::time::{Clock, Stamp};

/// One topic with its messages in order of log time.
#[derive(Debug)]
pub struct Channel {
    /// Topic name, unique among the channels.
    pub topic: String,
    /// Name of its schema.
    pub schema_name: &'static str,
    /// JSON schema of its messages.
    pub schema: Value,
    /// Number of rows that have no valid log time and are not messages.
    pub untimed: usize,
    content: Content,
    rows: Vec<Row>,
}

/// A message of a channel, as JSON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelMessage {
    /// Receive time of the recorder, ns.
    pub log_time: u64,
    /// Publish time of the sender, ns.
    pub publish_time: u64,
    /// JSON.
    pub data: Vec<u8>,
}

#[derive(Debug)]
enum Content {
    Columns(Box<Columns>),
    Messages(Vec<Message>),
}

#[derive(Clone, Copy, Debug)]
struct Row {
    log_time: u64,
    /// Index of the pose or transform.
    part: u32,
    row: u32,
}

/// Channels of the topics that were decoded, then those of the audit, if there was one.
pub fn channels(topics: Vec<Topic>, audited: Option<&Audited>) -> Vec<Channel> {
    let report = audited.map(|audited| &audited.report);
    let of_log = topics.into_iter().filter_map(|topic| Channel::from_topic(topic, report));
    let of_audit = audited.into_iter().flat_map(|audited| {
        message_channels(messages(audited)).into_iter().chain(pose_channels(audited))
    });
    let mut names = HashSet::new();
    let mut channels: Vec<Channel> =
        of_log.chain(of_audit).filter(|channel| !channel.rows.is_empty()).collect();
    for channel in &mut channels {
        let numbered = (2..).map(|number| format!("{}/{number}", channel.topic));
        let mut candidates = std::iter::once(channel.topic.clone()).chain(numbered);
        if let Some(name) = candidates.find(|name| !names.contains(name)) {
            names.insert(name.clone());
            channel.topic = name;
        }
    }
    channels
}

impl Channel {
    /// `None` if the topic was not decoded.
    fn from_topic(topic: Topic, report: Option<&Report>) -> Option<Self> {
        let Topic { name, columns, cells, .. } = topic;
        let mut columns = match columns? {
            Columns::Array(array) if has_named_pose(&array, &cells) => {
                Columns::Poses(vec![named_poses(&array)])
            }
            columns => columns,
        };
        if let (Columns::Poses(poses), Some(report)) = (&mut columns, report) {
            poses.iter_mut().for_each(|poses| name_frame(poses, &name, report));
        }
        let names: Vec<&str> = cells.iter().map(|cell| cell.name.as_str()).collect();
        let (schema_name, schema) = match &columns {
            Columns::Joints(_) => ("foxglove.JointStates", schema::joint_states()),
            Columns::Poses(poses) if !are_transforms(poses) => {
                ("foxglove.PoseInFrame", schema::pose_in_frame())
            }
            Columns::Poses(_) | Columns::Transforms(_) => {
                ("foxglove.FrameTransform", schema::frame_transform())
            }
            Columns::Imu(_) => ("poseaudit.Imu", schema::imu()),
            Columns::Array(_) => ("poseaudit.Numbers", schema::numbers(&names.join(", "))),
            Columns::Text(_) => ("poseaudit.Text", schema::text()),
        };
        Some(Self::new(name, schema_name, schema, Content::Columns(Box::new(columns))))
    }

    fn new(topic: String, schema_name: &'static str, schema: Value, content: Content) -> Self {
        let log_times: Vec<Vec<i64>> = match &content {
            Content::Columns(columns) => {
                columns.times().into_iter().map(|times| times.log.clone()).collect()
            }
            Content::Messages(messages) => {
                vec![messages.iter().map(|message| message.at.nanos()).collect()]
            }
        };
        let all: usize = log_times.iter().map(Vec::len).sum();
        let mut rows: Vec<Row> = log_times
            .iter()
            .zip(0..)
            .flat_map(|(times, part)| {
                times.iter().zip(0..).map(move |(time, row)| (time, part, row))
            })
            .filter_map(|(&time, part, row)| {
                Some(Row { log_time: time.try_into().ok()?, part, row })
            })
            .collect();
        rows.sort_by_key(|row| row.log_time);
        let untimed = all - rows.len();
        Self { topic, schema_name, schema, untimed, content, rows }
    }

    /// Number of messages; at least one.
    pub fn message_count(&self) -> usize {
        self.rows.len()
    }

    /// Log time of a message, ns. `None` after the last.
    pub fn log_time(&self, position: usize) -> Option<u64> {
        self.rows.get(position).map(|row| row.log_time)
    }

    /// Number of messages for whose log time `is_before` holds. It must hold up to some time, and not after it.
    pub fn count_while(&self, is_before: impl Fn(u64) -> bool) -> usize {
        self.rows.partition_point(|row| is_before(row.log_time))
    }

    /// Encodes a message. `None` after the last.
    pub fn message(&self, position: usize) -> Option<ChannelMessage> {
        let &Row { log_time, part, row } = self.rows.get(position)?;
        let (part, row) = (part as usize, row as usize);
        let (publish_time, content) = match &self.content {
            Content::Messages(messages) => (log_time, messages[row].content.clone()),
            Content::Columns(columns) => {
                let publish = columns.times()[part].nanos_on(Clock::Publish)[row];
                (publish.try_into().unwrap_or(log_time), content_of(columns, part, row))
            }
        };
        Some(ChannelMessage { log_time, publish_time, data: content.to_string().into_bytes() })
    }
}

/// Whether the numbers are a position and a quaternion, by the names of their columns.
fn has_named_pose(array: &ArrayColumns, cells: &[TableCell]) -> bool {
    let is_quaternion = |cell: &TableCell| cell.labels == Some(RotationLabels::Quaternion);
    array.width == 7 && cells.iter().any(is_quaternion)
}

fn named_poses(array: &ArrayColumns) -> PoseColumns {
    let mut poses = PoseColumns { times: array.times.clone().into(), ..PoseColumns::default() };
    for row in 0..array.times.len() {
        if let &[x, y, z, qx, qy, qz, qw] = array.row(row) {
            poses.xyz.push([x, y, z]);
            poses.q_xyzw.push([qx, qy, qz, qw]);
        }
    }
    poses
}

/// Poses without a frame are in the one that the audit assumed.
fn name_frame(poses: &mut PoseColumns, topic: &str, report: &Report) {
    if !poses.frame_id.is_empty() {
        return;
    }
    let child =
        |child: &Option<String>| child.as_deref().unwrap_or_default() == poses.child_frame_id;
    let mut rows = report.streams.iter();
    let row = rows.find(|row| row.topic == topic && child(&row.child_frame_id));
    if let Some(reference) = row.and_then(|row| row.reference.as_ref()) {
        poses.frame_id.clone_from(reference);
    }
}

/// Several named bodies need their names, which a `PoseInFrame` lacks.
fn are_transforms(poses: &[PoseColumns]) -> bool {
    poses.len() > 1 && poses.iter().all(|poses| !poses.child_frame_id.is_empty())
}

fn content_of(columns: &Columns, part: usize, row: usize) -> Value {
    let stamp = |times: &Times| match times.header[row] {
        0 => time(Stamp::from_nanos(times.log[row])),
        header => time(Stamp::from_nanos(header)),
    };
    match columns {
        Columns::Joints(joints) => joint_states(stamp(&joints.times), joints, row),
        Columns::Poses(poses) if !are_transforms(poses) => {
            let poses = &poses[part];
            json!({
                "timestamp": stamp(&poses.times),
                "frame_id": poses.frame_id,
                "pose": { "position": vector(poses.xyz[row]), "orientation": rotation(poses.q_xyzw[row]) },
            })
        }
        Columns::Poses(poses) | Columns::Transforms(poses) => {
            let poses = &poses[part];
            json!({
                "timestamp": stamp(&poses.times),
                "parent_frame_id": poses.frame_id,
                "child_frame_id": poses.child_frame_id,
                "translation": vector(poses.xyz[row]),
                "rotation": rotation(poses.q_xyzw[row]),
            })
        }
        Columns::Imu(imu) => imu_content(stamp(&imu.times), imu, row),
        Columns::Array(array) => {
            json!({ "timestamp": stamp(&array.times), "values": array.row(row) })
        }
        Columns::Text(text) => json!({ "timestamp": stamp(&text.times), "text": text.text[row] }),
    }
}

/// Missing values have no field.
fn joint_states(stamp: Value, joints: &JointColumns, row: usize) -> Value {
    let states = joints.joints.iter().map(|joint| {
        let mut state = json!({ "name": joint.name });
        let (position, velocity) = (joint.position.get(row), joint.velocity.get(row));
        for (field, value) in [("position", position), ("velocity", velocity)] {
            if let Some(value) = value.filter(|value| value.is_finite()) {
                state[field] = json!(value);
            }
        }
        state
    });
    json!({ "timestamp": stamp, "joints": states.collect::<Value>() })
}

/// Without a field for an unknown orientation.
fn imu_content(stamp: Value, imu: &ImuColumns, row: usize) -> Value {
    let mut content = json!({
        "timestamp": stamp,
        "frame_id": imu.frame_id,
        "angular_velocity": vector(imu.gyro[row]),
        "linear_acceleration": vector(imu.accel[row]),
    });
    if imu.has_orientation {
        content["orientation"] = rotation(imu.q_xyzw[row]);
    }
    content
}

fn vector([x, y, z]: [f64; 3]) -> Value {
    json!({ "x": x, "y": y, "z": z })
}

/// Foxglove draws no pose without a rotation, so an unset one is the identity.
fn rotation([x, y, z, w]: [f64; 4]) -> Value {
    match [x, y, z, w] == [0.0; 4] {
        true => identity_rotation(),
        false => json!({ "x": x, "y": y, "z": z, "w": w }),
    }
}

fn message_channels(messages: Vec<Message>) -> Vec<Channel> {
    let mut topics: BTreeMap<String, Vec<Message>> = BTreeMap::new();
    for message in messages {
        topics.entry(message.topic.clone()).or_default().push(message);
    }
    let channel = |(topic, messages): (String, Vec<Message>)| {
        let name = messages.first()?.schema;
        Some(Channel::new(topic, name, schema::by_name(name)?, Content::Messages(messages)))
    };
    topics.into_iter().filter_map(channel).collect()
}

/// Logged poses and FK of the streams whose frame is connected to the arm.
fn pose_channels(audited: &Audited) -> Vec<Channel> {
    let streams = audited.evidence.poses_and_tf().map(|(_, stream)| stream);
    let channels = streams.filter(|stream| stream.reference_known).flat_map(|stream| {
        let aligned = &stream.diagnosis.aligned;
        let found = stream.diagnosis.length_unit.as_ref().ok().copied().flatten();
        let in_m = match stream.declared {
            Some(declared) => declared.lengths.in_m(),
            None => found.filter(|_| stream.is_undeclared).map_or(1.0, |unit| unit.factor()),
        };
        [("pose", &aligned.logged, in_m), ("fk", &aligned.fk, 1.0)].map(|(kind, poses, in_m)| {
            let topic = format!("/poseaudit/{kind}/{}", stream.topic().trim_start_matches('/'));
            let (t_s, origin) = (&aligned.t_s, audited.run.origin);
            let columns = pose_columns(t_s, poses, in_m, origin, &stream.reference);
            let content = Content::Columns(Box::new(Columns::Poses(vec![columns])));
            Channel::new(topic, "foxglove.PoseInFrame", schema::pose_in_frame(), content)
        })
    });
    channels.collect()
}

/// `in_m` is the unit of the positions.
fn pose_columns(t_s: &[f64], poses: &[Pose], in_m: f64, origin: Stamp, frame: &str) -> PoseColumns {
    let mut columns = PoseColumns { frame_id: frame.to_owned(), ..PoseColumns::default() };
    for (t_s, pose) in t_s.iter().zip(poses) {
        let at = origin.shifted(*t_s).nanos();
        columns.times.push(at, at, at);
        columns.xyz.push(xyz_of(pose).map(|one| in_m * one));
        columns.q_xyzw.push(xyzw_from_rotation(&pose.rotation));
    }
    columns
}
