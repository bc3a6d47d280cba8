//! The recording for the Rerun viewer: the arm, what was logged of it and what it should have said.
//!
//! Nothing is computed here but where things are drawn. Streams are decimated to about 4 000 rows
//! each: evenly for what moves, by the lowest and highest value of each stretch for what is plotted.
//!
//! | entity | what it is |
//! |---|---|
//! | `/arms/NAME/arm` | the arm by FK, its joints as they should have been recorded |
//! | `/arms/NAME/arm_as_recorded` | the same as recorded, where that differs |
//! | `/arms/NAME/tip` | frame of the tip, at the end of `arm` |
//! | `/arms/NAME/TOPIC/…` | a stream's tool `as_logged` and `as_explained`, and their trails |
//! | `/errors/NAME/{position_mm,rotation_deg}/TOPIC/…` | distance from FK, before and after |
//! | `/errors/NAME/yaw_deg/TOPIC` | yaw of an IMU against FK |
//! | `/findings`, `/report` | the findings on the time line, and as a page |
//!
//! Two timelines: `stamp` as the log has it, and `run`, the time since the run's origin.

mod blueprint;
mod layout;
mod page;
mod plots;
mod scene;
mod tape;

use std::path::{Path, PathBuf};

use polars::prelude::{DataFrame, PolarsError};
use rerun::sink::SinkFlushError;
use rerun::{ApplicationId, RecordingStreamBuilder, RecordingStreamError, SerializationError};

use crate::finding::Finding;
use crate::geometry::Pose;
use crate::report::{Verdict, write_whole};
use crate::robot::Chain;
use crate::stream::JointTrack;
use crate::time::Stamp;

use tape::Tape;

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
    /// The recording's id; a new one where there is none.
    pub id: Option<String>,
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
    /// The arms, each in its own space.
    pub arms: Vec<ReplayArm<'a>>,
    /// The answer in one word.
    pub verdict: Verdict,
    /// What is wrong, the gravest first.
    pub findings: &'a [Finding],
}

/// One arm and its streams.
#[derive(Clone, Debug)]
pub struct ReplayArm<'a> {
    /// Its name.
    pub name: &'a str,
    /// The chain from base to tip.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint tracks.
    pub columns: &'a [usize],
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
    /// Its samples and residuals, by [`tables::aligned_frame`](crate::tables::aligned_frame).
    pub frame: DataFrame,
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
    /// Stamp, s from the run's origin, and yaw against FK, rad.
    pub yaw_error: &'a [(f64, f64)],
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
    /// It cannot be opened or added to.
    Recording(#[from] RecordingStreamError),
    /// Values have no form in a recording.
    Values(#[from] SerializationError),
    /// It does not arrive on disk.
    Flush(#[from] SinkFlushError),
    /// A stream's frame lacks a column.
    Frame(#[from] PolarsError),
}

/// Writes the recording to its file, whose folders are made.
///
/// # Errors
/// Where the file cannot be written, or a stream's frame lacks a column.
pub fn write(recording: &Recording, replay: &Replay<'_>) -> Result<(), ReplayError> {
    write_whole(&recording.path, |staged| record(staged, recording, replay))
        .map_err(|cause| ReplayError { path: recording.path.clone(), cause })
}

fn record(staged: &Path, wanted: &Recording, replay: &Replay<'_>) -> Result<(), ReplayCause> {
    // Explicitly enabled: the environment variable RERUN must not empty a file that was asked for.
    let named = wanted.application.clone().and_then(|name| ApplicationId::try_new(name).ok());
    let application = named.unwrap_or(APPLICATION.into());
    let mut builder = RecordingStreamBuilder::new(application).enabled(true);
    if let Some(id) = &wanted.id {
        builder = builder.recording_id(id.as_str());
    }
    let recording = builder.save(staged)?;
    layout::send(replay, &recording)?;
    let tape = Tape::new(recording, replay.origin);
    for arm in &replay.arms {
        scene::draw(&tape, arm)?;
        plots::draw(&tape, arm)?;
    }
    page::write(&tape, replay)?;
    tape.finish()
}

#[cfg(test)]
mod tests;
