//! The recording for the Rerun viewer: the arm, what was logged of it and what it should have said.
//!
//! Nothing is computed here but where things are drawn. Streams are decimated to about 4 000 rows
//! each: evenly for what moves, by the lowest and highest value of each stretch for what is plotted.
//!
//! | entity | what it is |
//! |---|---|
//! | `/arms/NAME/arm` | capsules along the arm by FK, its joints as they should have been recorded |
//! | `/arms/NAME/arm_as_recorded` | the same as recorded, where that differs |
//! | `/arms/NAME/links/LINK` | frame of a link by FK, with its name and its visuals |
//! | `/arms/NAME/tip` | the tool by FK |
//! | `/arms/NAME/TOPIC/…` | a stream's tool `as_logged` and `as_explained`, their trails, and the `error` from FK |
//! | `/errors/NAME/{position_mm,rotation_deg}/TOPIC/…` | distance from FK, before and after, and the limit |
//! | `/errors/NAME/yaw_deg/TOPIC` | yaw of an IMU against FK |
//! | `/joints/NAME/JOINT` | a joint's position, as it should have been recorded |
//! | `/proof/NN/…` | what proves finding NN and no other picture shows: a spectrum, a target's views, axes |
//! | `/findings/…`, `/spans/…` | the findings on the time line, as lines of a log, pages, and spans |
//! | `/report` | the report as a page |
//!
//! Timelines: `run`, the time since the run's origin; `stamp` and `log_time` as the log has them; and
//! `sample`, the number of the last joint state at a stamp, so that all streams are of one moment.

mod arm;
mod audited;
mod blueprint;
mod findings;
mod layout;
mod mesh;
mod moments;
mod page;
mod plots;
mod proofs;
mod reel;
mod scene;
mod tape;
mod tools;
mod visuals;

use std::fs;
use std::path::{Path, PathBuf};

use re_chunk::ChunkError;
use re_log_encoding::EncodeError;
use re_log_types::{ApplicationId, LogMsg};
use re_sdk_types::SerializationError;
use re_sdk_types::archetypes::ViewCoordinates;

use crate::diagnosis::{Aligned, Residuals};
use crate::finding::Finding;
use crate::geometry::Pose;
use crate::report::{Report, write_whole};
use crate::robot::{Chain, Robot};
use crate::stream::JointTrack;
use crate::time::Stamp;

pub use moments::Receipts;
use reel::Reel;
use tape::{Names, Tape};

/// Whose recordings these are, in the viewer.
const APPLICATION: &str = env!("CARGO_PKG_NAME");

/// No more rows than this of one stream are written.
const MOST_ROWS: usize = 4_000;

/// Where a recording goes, and which one it says that it is. The viewer shows together what is of one
/// recording of one application.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The application; poseaudit where there is none.
    pub application: Option<String>,
    /// The recording's id; where there is none, one that follows from what it shows.
    pub id: Option<String>,
    /// Whether the viewer shows it beside the log that it reads itself. Its timelines then have the
    /// viewer's names, `ros2_timestamp` and `message_log_time`, so that one cursor moves both.
    pub beside_log: bool,
    /// The folders that the models' meshes are sought below. No file outside of them is read.
    pub mesh_roots: Vec<PathBuf>,
}

impl From<PathBuf> for Recording {
    fn from(path: PathBuf) -> Self {
        Self { path, ..Self::default() }
    }
}

/// What a recording shows.
#[derive(Clone, Debug)]
pub struct Replay<'a> {
    /// The run's origin, from which times in seconds count.
    pub origin: Stamp,
    /// First and last stamp of the run.
    pub span: (Stamp, Stamp),
    /// The arms, each in its own space.
    pub arms: Vec<ReplayArm<'a>>,
    /// What the audit says, the gravest finding first.
    pub report: &'a Report,
}

impl<'a> Replay<'a> {
    /// The arm that a finding is of: the one it names, else the first.
    fn arm_of(&self, finding: &Finding) -> Option<&ReplayArm<'a>> {
        let named = finding.subject.robot.as_deref();
        let named = self.arms.iter().find(|arm| Some(arm.name) == named);
        named.or(self.arms.first())
    }

    /// First and last stamp of what a finding is about; the run's where it is of all of it.
    fn span_of(&self, finding: &Finding) -> (Stamp, Stamp) {
        let (start, end) = (finding.start_ns, finding.end_ns);
        (start.unwrap_or(self.span.0), end.unwrap_or(self.span.1))
    }
}

/// One arm and its streams.
#[derive(Clone, Debug)]
pub struct ReplayArm<'a> {
    /// Its name.
    pub name: &'a str,
    /// The robot that it is a part of.
    pub robot: &'a Robot,
    /// The chain from base to tip.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint tracks.
    pub columns: &'a [usize],
    /// When the joint states were received.
    pub received: Receipts,
    /// The joint states as recorded.
    pub recorded: &'a JointTrack,
    /// The joint states as they should have been recorded.
    pub corrected: JointTrack,
    /// Its streams of poses, and /tf.
    pub streams: Vec<ReplayStream<'a>>,
    /// Its IMUs.
    pub imus: Vec<ReplayImu<'a>>,
}

impl ReplayArm<'_> {
    /// What a drawing of `stream` is called: what is said of the tool, and the topic where that
    /// alone does not tell.
    fn label(&self, stream: &ReplayStream<'_>, state: State) -> String {
        let measured = self.streams.iter().filter(|other| other.kind == StreamKind::Pose);
        match stream.kind {
            StreamKind::Tf => stream.topic.to_owned(),
            StreamKind::Pose if measured.count() == 1 => state.words().to_owned(),
            StreamKind::Pose => format!("{} {}", stream.topic, state.words()),
        }
    }
}

/// One stream of tool poses.
#[derive(Clone, Debug)]
pub struct ReplayStream<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Where its poses come from.
    pub kind: StreamKind,
    /// Its samples beside FK.
    pub aligned: &'a Aligned,
    /// When its messages were received.
    pub received: Receipts,
    /// The frame of the samples in the base of the arm's chain.
    pub base_from_reference: Pose,
    /// Whether the log ties that frame to the arm. If not, what was logged has no place in the
    /// scene and no error against FK; what it says once the frame is estimated has both.
    pub reference_known: bool,
    /// How much later than true its content is stamped, s; the explained pose is drawn at the time
    /// when it was true.
    pub latency_s: f64,
}

/// Where a stream's poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamKind {
    /// Measured, and logged as poses.
    Pose,
    /// Derived from the joint states, in the log's transforms.
    Tf,
}

/// What is said of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// What the log says.
    Logged,
    /// The same with everything found taken off.
    Explained,
}

impl State {
    /// Of what `stream` is drawn. Transforms derived from the joints are only as they are, and what
    /// is logged in a frame that nothing ties to the arm has no place beside it.
    fn drawn(stream: &ReplayStream<'_>) -> impl Iterator<Item = State> {
        let logged = stream.reference_known.then_some(State::Logged);
        let explained = (stream.kind == StreamKind::Pose).then_some(State::Explained);
        logged.into_iter().chain(explained)
    }

    /// Last part of its entities.
    const fn entity(self) -> &'static str {
        match self {
            State::Logged => "as_logged",
            State::Explained => "as_explained",
        }
    }

    /// Where the tool is, in the reference frame.
    fn poses<'a>(self, stream: &ReplayStream<'a>) -> &'a [Pose] {
        match self {
            State::Logged => &stream.aligned.logged,
            State::Explained => &stream.aligned.corrected,
        }
    }

    /// How far the tool is from where it should be.
    fn residuals(self, stream: &ReplayStream<'_>) -> Residuals {
        match self {
            State::Logged => stream.aligned.before(),
            State::Explained => stream.aligned.after(),
        }
    }

    const fn words(self) -> &'static str {
        match self {
            State::Logged => "as logged",
            State::Explained => "as explained",
        }
    }

    /// Red as logged, green as explained, violet in /tf.
    const fn rgb(self, kind: StreamKind) -> [u8; 3] {
        match (kind, self) {
            (StreamKind::Tf, _) => [200, 150, 255],
            (StreamKind::Pose, State::Logged) => [240, 80, 60],
            (StreamKind::Pose, State::Explained) => [60, 200, 110],
        }
    }
}

/// One IMU.
#[derive(Clone, Debug)]
pub struct ReplayImu<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// When its messages were received.
    pub received: Receipts,
    /// Stamp, s from the run's origin, and yaw against FK, rad.
    pub yaw_error: &'a [(f64, f64)],
}

impl ReplayImu<'_> {
    /// Whether there is a yaw to plot; an IMU may have no orientation.
    fn has_yaw(&self) -> bool {
        !self.yaw_error.is_empty()
    }
}

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: the recording cannot be written: {cause}", path.display())]
pub struct ReplayError {
    /// The recording.
    pub path: PathBuf,
    /// What went wrong.
    #[source]
    pub cause: ReplayCause,
}

/// What went wrong with a recording.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub enum ReplayCause {
    /// No file can be made there.
    Folder(#[from] std::io::Error),
    /// Values have no form in a recording.
    Values(#[from] SerializationError),
    /// Nor have rows.
    Rows(#[from] ChunkError),
    /// It has no form in a file.
    Encoding(#[from] EncodeError),
}

/// Writes the recording to its file, whose folders are made; what is to be known of the meshes that
/// were asked for.
///
/// # Errors
/// Where the file cannot be written.
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
    fs::write(staged, reel::bytes(&messages)?)?;
    Ok(notes)
}

fn application(wanted: &Recording) -> ApplicationId {
    let named = wanted.application.clone().and_then(|name| ApplicationId::try_new(name).ok());
    named.unwrap_or(APPLICATION.into())
}

/// All that the recording is made of; what is to be known of meshes.
fn messages(
    wanted: &Recording,
    replay: &Replay<'_>,
) -> Result<(Vec<LogMsg>, Vec<String>), ReplayCause> {
    let reel = Reel::new(replay, &application(wanted), wanted.id.clone());
    layout::draw(replay, &reel)?;
    let names = if wanted.beside_log { Names::OF_VIEWER } else { Names::OWN };
    let tape = Tape::new(reel, replay.origin, names);
    let mut meshes = Vec::new();
    for arm in &replay.arms {
        meshes.extend(draw_arm(&tape, arm, &wanted.mesh_roots)?);
        plots::draw(&tape, arm, replay.report)?;
    }
    proofs::draw(&tape, replay)?;
    findings::write(&tape, replay)?;
    page::write(&tape, replay, &meshes)?;
    let notes = if wanted.mesh_roots.is_empty() { Vec::new() } else { meshes };
    Ok((tape.finish().messages()?, notes))
}

/// Adds an arm and its streams; what is to be known of its meshes.
fn draw_arm(
    tape: &Tape,
    arm: &ReplayArm<'_>,
    mesh_roots: &[PathBuf],
) -> Result<Vec<String>, ReplayCause> {
    let size_m = arm.chain.max_reach_m();
    tape.still(&scene::root(arm.name), &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    let drawn = visuals::draw(tape, arm, size_m, mesh_roots)?;
    if !drawn.is_whole {
        arm::draw(tape, arm, "arm", &arm.corrected, size_m)?;
    }
    if arm.corrected.q != arm.recorded.q {
        arm::draw_thin(tape, arm, "arm_as_recorded", arm.recorded, size_m)?;
    }
    tools::draw_tip(tape, arm, size_m)?;
    for stream in &arm.streams {
        tools::draw(tape, arm, stream, size_m)?;
    }
    Ok(drawn.notes)
}

#[cfg(test)]
mod tests;
