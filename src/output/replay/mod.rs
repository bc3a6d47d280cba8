//! Recording for the Rerun viewer. Streams are decimated to about 4 000 rows each: evenly for moving
//! objects, by minimum and maximum of each interval for plots.
//!
//! | entity | content |
//! |---|---|
//! | `/arms/NAME/arm` | capsules along the arm by FK of the corrected joint states |
//! | `/arms/NAME/arm_as_recorded` | same for the recorded joint states, if different |
//! | `/arms/NAME/links/LINK` | frame, name and visuals of a link by FK |
//! | `/arms/NAME/tip` | the tool by FK |
//! | `/arms/NAME/TOPIC/…` | a stream's tool `as_logged` and `as_explained`, trails, and `error` from FK |
//! | `/errors/NAME/{position_mm,rotation_deg}/TOPIC/…` | error against FK before and after correction, and limit |
//! | `/errors/NAME/yaw_deg/TOPIC` | IMU yaw against FK |
//! | `/joints/NAME/JOINT` | a joint's corrected position |
//! | `/proof/NN/…` | plots specific to finding NN |
//! | `/findings/…`, `/spans/…` | findings as log messages, pages and time spans |
//! | `/report` | the report as a page |
//!
//! Timelines: `run`, since the run's origin; `stamp` and `log_time` as in the log; and `sample`, the index
//! of the last joint state, which shows all streams at the same moment.

mod arm;
mod audited;
mod base_recording;
mod blueprint;
mod chunk_writer;
mod encoder;
mod finding_views;
mod findings;
mod layout;
mod mesh;
mod page;
mod plots;
mod row_times;
mod scene;
mod timeline_writer;
mod tools;
mod visuals;

use std::fs;
use std::path::{Path, PathBuf};

use re_chunk::ChunkError;
use re_log_encoding::CodecError;
use re_log_types::{ApplicationId, LogMsg};
use re_sdk_types::SerializationError;
use re_sdk_types::archetypes::ViewCoordinates;

use crate::diagnosis::{AlignedSamples, PoseDistances};
use crate::finding::Finding;
use crate::geometry::Pose;
use crate::report::{Report, write_whole};
use crate::robot::{Chain, Robot};
use crate::stream::JointTrack;
use crate::time::Stamp;

pub use base_recording::{BaseError, BaseRecording};
use chunk_writer::ChunkWriter;
pub use row_times::ReceiveTimes;
use timeline_writer::{TimelineNames, TimelineWriter};

const APPLICATION: &str = env!("CARGO_PKG_NAME");

/// Rows per stream.
const MAX_ROWS: usize = 4_000;

/// Output path and identity of a recording. The viewer combines data with the same ids.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// Application id. Default: poseaudit.
    pub application: Option<String>,
    /// Recording id. Default: derived from the content.
    pub id: Option<String>,
    /// The viewer also shows the log: timelines have its names, `ros2_timestamp` and `message_log_time`, so
    /// that one cursor moves both.
    pub shares_log_timelines: bool,
    /// Recording of the log that this one is a layer of, which is never overwritten. Arms are then drawn in the
    /// frames of the log.
    pub base: Option<PathBuf>,
    /// Timeline that the layout shows. Default: `run`.
    pub timeline: Option<&'static str>,
    /// Folders of meshes. No file outside them is read.
    pub mesh_roots: Vec<PathBuf>,
}

impl Recording {
    /// This recording as a layer of the one at `path`.
    #[must_use]
    pub fn with_base(self, path: PathBuf, base: &BaseRecording) -> Self {
        Self {
            application: Some(base.application.clone()),
            id: Some(base.id.clone()),
            shares_log_timelines: base.has_log_timelines(),
            base: Some(path),
            timeline: base.shared_timeline(),
            ..self
        }
    }
}

impl From<PathBuf> for Recording {
    fn from(path: PathBuf) -> Self {
        Self { path, ..Self::default() }
    }
}

/// Content of a recording.
#[derive(Clone, Debug)]
pub struct Replay<'a> {
    /// Origin of times in seconds.
    pub origin: Stamp,
    /// First and last stamp of the run.
    pub span: (Stamp, Stamp),
    /// Arms, each in a separate space.
    pub arms: Vec<ReplayArm<'a>>,
    /// Report, most severe finding first.
    pub report: &'a Report,
}

impl<'a> Replay<'a> {
    /// The named arm, else the first.
    fn arm_of(&self, finding: &Finding) -> Option<&ReplayArm<'a>> {
        let named = finding.subject.arm().map(String::as_str);
        let named = self.arms.iter().find(|arm| Some(arm.name) == named);
        named.or(self.arms.first())
    }

    /// Span of the finding, or else of the run.
    fn span_of(&self, finding: &Finding) -> (Stamp, Stamp) {
        let (start, end) = (finding.start_ns, finding.end_ns);
        (start.unwrap_or(self.span.0), end.unwrap_or(self.span.1))
    }
}

/// One arm and its streams.
#[derive(Clone, Debug)]
pub struct ReplayArm<'a> {
    /// Name.
    pub name: &'a str,
    /// Robot with the arm.
    pub robot: &'a Robot,
    /// Chain from base to tip.
    pub chain: &'a Chain,
    /// Columns of the chain's joints in the joint tracks.
    pub columns: &'a [usize],
    /// Receive times of joint states.
    pub received: ReceiveTimes,
    /// Recorded joint states.
    pub recorded: &'a JointTrack,
    /// Corrected joint states.
    pub corrected: JointTrack,
    /// Pose streams and /tf.
    pub streams: Vec<ReplayStream<'a>>,
    /// IMUs.
    pub imus: Vec<ReplayImu<'a>>,
}

impl ReplayArm<'_> {
    /// With the topic if the arm has several streams.
    fn label(&self, stream: &ReplayStream<'_>, state: PoseState) -> String {
        let measured = self.streams.iter().filter(|other| other.kind == StreamKind::Pose);
        match stream.kind {
            StreamKind::Tf => stream.topic.to_owned(),
            StreamKind::Pose if measured.count() == 1 => state.label().to_owned(),
            StreamKind::Pose => format!("{} {}", stream.topic, state.label()),
        }
    }
}

/// One stream of tool poses.
#[derive(Clone, Debug)]
pub struct ReplayStream<'a> {
    /// Topic.
    pub topic: &'a str,
    /// Source of the poses.
    pub kind: StreamKind,
    /// Samples aligned with FK.
    pub aligned: &'a AlignedSamples,
    /// Receive times.
    pub received: ReceiveTimes,
    /// Pose of the samples' frame in the base of the chain.
    pub base_from_reference: Pose,
    /// The log connects that frame to the arm. Otherwise logged poses have no place and no error; corrected
    /// poses use the estimated frame.
    pub reference_known: bool,
    /// s. Corrected poses are drawn at the time of measurement.
    pub latency_s: f64,
}

/// Source of a stream's poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamKind {
    /// Logged as poses.
    Pose,
    /// Derived from joint states: the log's transforms.
    Tf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PoseState {
    Logged,
    /// After correcting all findings.
    Corrected,
}

impl PoseState {
    /// Transforms derived from joints have no corrected state. Poses in a frame not connected to the arm
    /// have no logged state.
    fn drawn_states(stream: &ReplayStream<'_>) -> impl Iterator<Item = PoseState> {
        let logged = stream.reference_known.then_some(PoseState::Logged);
        let explained = (stream.kind == StreamKind::Pose).then_some(PoseState::Corrected);
        logged.into_iter().chain(explained)
    }

    /// Last component of its paths.
    const fn entity(self) -> &'static str {
        match self {
            PoseState::Logged => "as_logged",
            PoseState::Corrected => "as_explained",
        }
    }

    /// Poses in the reference frame.
    fn poses<'a>(self, stream: &ReplayStream<'a>) -> &'a [Pose] {
        match self {
            PoseState::Logged => &stream.aligned.logged,
            PoseState::Corrected => &stream.aligned.corrected,
        }
    }

    fn residuals(self, stream: &ReplayStream<'_>) -> PoseDistances {
        match self {
            PoseState::Logged => stream.aligned.before(),
            PoseState::Corrected => stream.aligned.after(),
        }
    }

    const fn label(self) -> &'static str {
        match self {
            PoseState::Logged => "as logged",
            PoseState::Corrected => "as explained",
        }
    }

    /// Red as logged, green after correction, violet for /tf.
    const fn rgb(self, kind: StreamKind) -> [u8; 3] {
        match (kind, self) {
            (StreamKind::Tf, _) => [200, 150, 255],
            (StreamKind::Pose, PoseState::Logged) => [240, 80, 60],
            (StreamKind::Pose, PoseState::Corrected) => [60, 200, 110],
        }
    }
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ReplayImu<'a> {
    /// Topic.
    pub topic: &'a str,
    /// Receive times.
    pub received: ReceiveTimes,
    /// s from the run's origin, and yaw against FK, rad.
    pub yaw_error: &'a [(f64, f64)],
}

impl ReplayImu<'_> {
    /// An IMU may have no orientation.
    fn has_yaw(&self) -> bool {
        !self.yaw_error.is_empty()
    }
}

/// A recording could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: the recording cannot be written: {cause}", path.display())]
pub struct ReplayError {
    /// File.
    pub path: PathBuf,
    /// Cause.
    #[source]
    pub cause: ReplayCause,
}

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum ReplayCause {
    /// File not created.
    Folder(#[from] std::io::Error),
    /// Values not serialised.
    Values(#[from] SerializationError),
    /// Rows not serialised.
    Rows(#[from] ChunkError),
    /// File not encoded.
    Encoding(#[from] CodecError),
}

/// Writes the recording, creating its folders. Returns notes on the requested meshes.
///
/// # Errors
/// If the file cannot be written.
pub fn write(recording: &Recording, replay: &Replay<'_>) -> Result<Vec<String>, ReplayError> {
    let mut notes = Vec::new();
    write_whole(&recording.path, |staged| {
        notes = record(staged, recording, replay)?;
        Ok(())
    })
    .map_err(|cause| ReplayError { path: recording.path.clone(), cause })?;
    Ok(notes)
}

fn record(
    staged: &Path,
    wanted: &Recording,
    replay: &Replay<'_>,
) -> Result<Vec<String>, ReplayCause> {
    let (messages, notes) = messages(wanted, replay)?;
    fs::write(staged, encoder::encode(&messages)?)?;
    Ok(notes)
}

fn application(wanted: &Recording) -> ApplicationId {
    let named = wanted.application.clone().and_then(|name| ApplicationId::try_new(name).ok());
    named.unwrap_or(APPLICATION.into())
}

fn messages(
    wanted: &Recording,
    replay: &Replay<'_>,
) -> Result<(Vec<LogMsg>, Vec<String>), ReplayCause> {
    let chunks = ChunkWriter::new(replay, &application(wanted), wanted.id.clone());
    layout::draw(replay, &chunks, wanted)?;
    let names =
        if wanted.shares_log_timelines { TimelineNames::VIEWER } else { TimelineNames::STANDALONE };
    let writer = TimelineWriter::new(chunks, replay.origin, names);
    let mut meshes = Vec::new();
    for arm in &replay.arms {
        meshes.extend(draw_arm(&writer, arm, wanted)?);
        plots::draw(&writer, arm, replay.report)?;
    }
    finding_views::draw(&writer, replay)?;
    findings::write(&writer, replay)?;
    page::write(&writer, replay, &meshes)?;
    let notes = if wanted.mesh_roots.is_empty() { Vec::new() } else { meshes };
    Ok((writer.finish().messages()?, notes))
}

fn draw_arm(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    wanted: &Recording,
) -> Result<Vec<String>, ReplayCause> {
    let size_m = arm.chain.max_reach_m();
    let root = scene::arm_root(arm.name);
    writer.log_static(&root, &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    if wanted.base.is_some() {
        writer.log_static(&root, &scene::connection_to_log(&root, arm.chain.base_name()))?;
    }
    let drawn = visuals::draw(writer, arm, size_m, &wanted.mesh_roots)?;
    if !drawn.is_complete {
        arm::draw(writer, arm, "arm", &arm.corrected, size_m)?;
    }
    if arm.corrected.q != arm.recorded.q {
        arm::draw_thin(writer, arm, "arm_as_recorded", arm.recorded, size_m)?;
    }
    tools::draw_tip(writer, arm, size_m)?;
    for stream in &arm.streams {
        tools::draw(writer, arm, stream, size_m)?;
    }
    Ok(drawn.notes)
}

#[cfg(test)]
mod tests;
