//! Findings and errors as an MCAP file for Foxglove, to open next to the log, and a layout that shows them.
//! The schemas are JSON.
//!
//! | topic | schema | content |
//! |---|---|---|
//! | `/poseaudit/log` | `foxglove.Log` | the verdict, and each finding at its start |
//! | `/poseaudit/error/TOPIC` | `poseaudit.Error` | errors of a pose stream against FK, and their limits |
//! | `/poseaudit/scene` | `foxglove.SceneUpdate` | logged and FK pose of a stream's tool, with its findings |
//!
//! Frame names are the log's, so the scene is part of its frame tree.

mod channels;
mod errors;
mod layout;
mod problems;
mod schema;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use serde_json::{Value, json};

use super::write_file;
use crate::audit::Audited;
use crate::evidence::{PoseEvidence, StreamEvidence};
use crate::finding::{Finding, Severity};
use crate::geometry::Pose;
use crate::places::PathRegistry;
use crate::report::outline::Outline;
use crate::report::{Report, Trouble};
use crate::stats::thin;
use crate::time::{NANOS_PER_SECOND, Stamp};

pub use channels::{Channel, ChannelMessage, channels};
pub use problems::{Problem, problems};

/// Scenes per stream.
const MAX_SCENES: usize = 2_000;

const LOG_TOPIC: &str = "/poseaudit/log";
const SCENE_TOPIC: &str = "/poseaudit/scene";

const LOG_SCHEMA: &str = "foxglove.Log";
const SCENE_SCHEMA: &str = "foxglove.SceneUpdate";
const ERROR_SCHEMA: &str = "poseaudit.Error";

/// Registers the messages and their layout.
pub fn register_outputs(path: &Path, places: &mut PathRegistry) {
    places.add_output("--mcap", path);
    places.add_output("--mcap", &layout_path(path));
}

/// `run.mcap` has the layout `run.layout.json`.
pub fn layout_path(path: &Path) -> PathBuf {
    path.with_extension("layout.json")
}

impl Audited {
    /// Writes findings and errors as Foxglove messages, and the layout next to them.
    ///
    /// # Errors
    /// If a file cannot be written or would replace an input file.
    pub fn write_foxglove(&self, path: &Path) -> Result<(), Trouble> {
        self.read.check_with(|places| register_outputs(path, places))?;
        let remedy = "set --mcap to a writable file";
        let messages = messages(self);
        let bytes =
            encode_mcap(&messages).map_err(|error| Trouble::call(path.display(), error, remedy))?;
        write_file(path, bytes, remedy)?;
        let layout = format!("{:#}\n", self.foxglove_layout(&messages));
        write_file(&layout_path(path), layout, remedy)
    }

    fn foxglove_layout(&self, messages: &[Message]) -> Value {
        let errors = messages.iter().filter(|message| message.schema == ERROR_SCHEMA);
        let topics: BTreeSet<String> = errors.map(|message| message.topic.clone()).collect();
        let topics: Vec<String> = topics.into_iter().collect();
        let mut streams = self.evidence.robots.iter().flat_map(|arm| &arm.poses);
        let frame = streams.next().map(|stream| stream.reference.as_str());
        layout::layout(&topics, frame)
    }
}

#[derive(Debug)]
struct Message {
    topic: String,
    schema: &'static str,
    at: Stamp,
    content: Value,
}

fn messages(audited: &Audited) -> Vec<Message> {
    let Audited { report, run, evidence, .. } = audited;
    let (start, end) = run.span.unwrap_or((run.origin, run.origin));
    let outline = Outline::new(report);
    let mut messages = vec![log_message(start, 2, "verdict", &verdict_text(report, &outline))];
    messages
        .extend(report.findings.iter().map(|finding| finding_message(finding, &outline, start)));
    for arm in &evidence.robots {
        for stream in &arm.poses {
            messages.extend(errors::error_messages(&arm.name, stream, report, run.origin));
            if stream.reference_known {
                messages.extend(scene_messages(stream, report, run.origin));
            }
        }
    }
    messages.retain(|message| (start..=end).contains(&message.at));
    messages.sort_by(|a, b| (a.at, &a.topic).cmp(&(b.at, &b.topic)));
    messages
}

/// Log message at the finding's first stamp.
fn finding_message(finding: &Finding, outline: &Outline<'_>, start: Stamp) -> Message {
    let level = match finding.severity {
        Severity::Info => 2,
        Severity::Warning => 3,
        Severity::Error => 4,
    };
    let text = format!("{}\nfix: {}", finding_text(finding, outline), finding.fix);
    log_message(finding.start_ns.unwrap_or(start).max(start), level, finding.code, &text)
}

fn verdict_text(report: &Report, outline: &Outline<'_>) -> String {
    format!("{}: {}", report.verdict, outline.verdict_reason())
}

fn finding_text(finding: &Finding, outline: &Outline<'_>) -> String {
    let subject = outline.subject(&finding.subject);
    let about = outline.finding_lines(finding).into_iter().map(|line| format!("\n{line}"));
    let about: String = about.collect();
    format!("{} {subject}: {}{about}", finding.code, finding.message)
}

fn log_message(at: Stamp, level: u8, code: &str, text: &str) -> Message {
    let content = json!({
        "timestamp": time(at),
        "level": level,
        "message": text,
        "name": "poseaudit",
        "file": code,
        "line": 0,
    });
    Message { topic: LOG_TOPIC.to_owned(), schema: LOG_SCHEMA, at, content }
}

/// Logged and FK pose of a stream's tool. Empty without findings.
fn scene_messages(
    stream: &StreamEvidence<PoseEvidence>,
    report: &Report,
    origin: Stamp,
) -> Vec<Message> {
    let topic = stream.topic();
    let is_on = |finding: &&Finding| finding.subject.topic.as_deref() == Some(topic);
    let found: Vec<&Finding> = report.findings.iter().filter(is_on).collect();
    let Some(first) = found.first() else { return Vec::new() };
    let metadata: Vec<Value> =
        found.iter().map(|it| json!({ "key": it.code, "value": it.message })).collect();
    let aligned = &stream.diagnosis.aligned;
    let scene = |row: usize| {
        let at = origin.shifted(aligned.t_s[row]);
        let (logged, fk) = (&aligned.logged[row], &aligned.fk[row]);
        let entity = json!({
            "timestamp": time(at),
            "frame_id": stream.reference,
            "id": topic,
            "lifetime": { "sec": 0, "nsec": 0 },
            "frame_locked": true,
            "metadata": metadata,
            "arrows": [],
            "cubes": [],
            "spheres": [sphere(fk, FK_RGB), sphere(logged, LOGGED_RGB)],
            "cylinders": [],
            "lines": [line_between(fk, logged)],
            "triangles": [],
            "texts": [label(logged, &format!("{} {}", first.code, first.message))],
            "models": [],
        });
        let content = json!({ "deletions": [], "entities": [entity] });
        Message { topic: SCENE_TOPIC.to_owned(), schema: SCENE_SCHEMA, at, content }
    };
    thin::even_rows(aligned.t_s.len(), MAX_SCENES).into_iter().map(scene).collect()
}

const FK_RGB: [f64; 3] = [0.24, 0.78, 0.43];
const LOGGED_RGB: [f64; 3] = [0.94, 0.31, 0.24];

fn time(at: Stamp) -> Value {
    json!({ "sec": at.nanos().div_euclid(NANOS_PER_SECOND), "nsec": at.nanos().rem_euclid(NANOS_PER_SECOND) })
}

fn point(pose: &Pose) -> Value {
    let at = pose.translation.vector;
    json!({ "x": at.x, "y": at.y, "z": at.z })
}

fn identity_rotation() -> Value {
    json!({ "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 })
}

fn colour([r, g, b]: [f64; 3]) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": 1.0 })
}

fn sphere(pose: &Pose, rgb: [f64; 3]) -> Value {
    /// Diameter, m.
    const SPHERE_SIZE_M: f64 = 0.02;
    json!({
        "pose": { "position": point(pose), "orientation": identity_rotation() },
        "size": { "x": SPHERE_SIZE_M, "y": SPHERE_SIZE_M, "z": SPHERE_SIZE_M },
        "color": colour(rgb),
    })
}

fn line_between(from: &Pose, to: &Pose) -> Value {
    json!({
        "type": 0,
        "pose": { "position": { "x": 0.0, "y": 0.0, "z": 0.0 }, "orientation": identity_rotation() },
        "thickness": 3.0,
        "scale_invariant": true,
        "points": [point(from), point(to)],
        "color": colour(LOGGED_RGB),
        "colors": [],
        "indices": [],
    })
}

fn label(pose: &Pose, text: &str) -> Value {
    json!({
        "pose": { "position": point(pose), "orientation": identity_rotation() },
        "billboard": true,
        "font_size": 14.0,
        "scale_invariant": true,
        "color": colour([1.0; 3]),
        "text": text,
    })
}

fn encode_mcap(messages: &[Message]) -> Result<Vec<u8>, McapError> {
    let options = WriteOptions::new()
        .profile("")
        .library("poseaudit")
        .compression(Some(Compression::Zstd))
        .compression_threads(0);
    let mut writer = options.create(Cursor::new(Vec::new()))?;
    let mut schemas = BTreeMap::new();
    for (name, schema) in schema::of_audit() {
        let id = writer.add_schema(name, "jsonschema", schema.to_string().as_bytes())?;
        schemas.insert(name, id);
    }
    let topics: BTreeMap<&str, &str> =
        messages.iter().map(|message| (message.topic.as_str(), message.schema)).collect();
    let mut channels = BTreeMap::new();
    for (topic, schema) in topics {
        let channel = writer.add_channel(schemas[schema], topic, "json", &BTreeMap::new())?;
        channels.insert(topic, channel);
    }
    for (sequence, message) in messages.iter().enumerate() {
        let at = message.at.nanos().cast_unsigned();
        let header = MessageHeader {
            channel_id: channels[message.topic.as_str()],
            sequence: sequence as u32,
            log_time: at,
            publish_time: at,
        };
        writer.write_to_known_channel(&header, message.content.to_string().as_bytes())?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}
