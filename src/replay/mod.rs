//! The recording of a run for the [Rerun](https://rerun.io) viewer: the arm as it moved, every pose
//! stream as logged and as corrected, the errors over time and the findings.
//!
//! | entity | what it shows |
//! |---|---|
//! | `ROBOT/arm` | the arm by FK of the joint states, everything found taken off; its links and tool below |
//! | `ROBOT/arm_as_recorded` | the arm by FK of the joint states as recorded, where these are at fault |
//! | `ROBOT/streams/TOPIC/logged` | the pose as logged, at its stamp |
//! | `ROBOT/streams/TOPIC/corrected` | its ghost: everything found taken off, when it was true |
//! | `ROBOT/streams/TOPIC/trail/…` | the ways that both went, over the whole run |
//! | `ROBOT/plots/…` | errors over the stamp, before and after the correction |
//! | `findings`, `report` | the findings on the time line, and all of them on a page |
//!
//! All of a robot is in the frame of its base, in metres. There are two timelines: `t`, the time
//! since the run's origin, and `stamp`, the run's own clock.
//!
//! A long run is thinned, so that the viewer stays quick: see [`MOST_POSES`] and [`MOST_POINTS`].

mod arm;
mod layout;
mod palette;
mod plots;
mod recorder;
mod streams;
mod thinning;
mod words;

use std::io;
use std::path::{Path, PathBuf};

use rerun::external::re_log_encoding::EncodeError;
use rerun::{EntityPath, RecordingStreamBuilder, RecordingStreamError};

use crate::geometry::Pose;
use crate::report::Report;
use crate::robot::Chain;
use crate::stream::JointTrack;
use crate::tables::AlignedTable;
use crate::time::Stamp;

use recorder::Recorder;

/// Most poses of a stream, or of the arm, that move over time; of more every k-th and the last is
/// shown.
pub const MOST_POSES: usize = 20_000;

/// Most points of a trail, of which every k-th and the last is shown, and of a plotted series, of
/// which the least and the greatest value in every stretch of equally many samples are shown.
pub const MOST_POINTS: usize = 5_000;

/// What to show of a run.
#[derive(Clone, Debug)]
pub struct Replay<'a> {
    /// The stamp that times in seconds count from.
    pub origin: Stamp,
    /// The arms.
    pub arms: Vec<ReplayArm<'a>>,
    /// What was found.
    pub report: &'a Report,
}

/// An arm and what the log says of it.
#[derive(Clone, Debug)]
pub struct ReplayArm<'a> {
    /// The robot's name; no two arms of a run share it.
    pub name: &'a str,
    /// The chain from the robot's base to its tip.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint tracks.
    pub columns: &'a [usize],
    /// The joint states as recorded.
    pub recorded: &'a JointTrack,
    /// The joint states with everything found taken off; `None` where nothing was found.
    pub corrected: Option<&'a JointTrack>,
    /// Its pose streams.
    pub streams: Vec<ReplayStream<'a>>,
    /// The IMUs that it carries.
    pub imus: Vec<ReplayImu<'a>>,
}

/// A pose stream beside FK.
#[derive(Clone, Debug)]
pub struct ReplayStream<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// The chain from the stream's reference link to the link whose pose it is.
    pub chain: &'a Chain,
    /// For each joint of `chain`, its column in the joint tracks.
    pub columns: &'a [usize],
    /// Its samples.
    pub table: AlignedTable,
    /// Whether it is computed from the joint states, as /tf is. It then says nothing new of where
    /// the arm was, and is shown as logged only.
    pub derived: bool,
    /// `reference_from_stream` as estimated, where the log does not tie the stream's frame to the
    /// robot. The logged poses are then shown through it, and have no error of their own.
    pub estimated_reference: Option<Pose>,
}

/// An IMU beside FK.
#[derive(Clone, Copy, Debug)]
pub struct ReplayImu<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// Time from the origin (s), and its yaw minus FK's about gravity (rad).
    pub yaw_error: &'a [(f64, f64)],
}

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// Rerun could not take the data.
    #[error("the recording cannot be made: {0}")]
    Record(#[from] RecordingStreamError),
    /// Rerun could not put the data in its format.
    #[error("the recording cannot be encoded: {0}")]
    Encode(#[from] EncodeError),
    /// The file cannot be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// The path as given.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
}

/// Writes the recording to the file at `path`; nothing is written where it cannot be made.
///
/// # Errors
/// Where the recording cannot be made, or the file cannot be written.
pub fn write(path: &Path, replay: &Replay) -> Result<(), ReplayError> {
    let recording = encode(replay)?;
    std::fs::write(path, recording)
        .map_err(|source| ReplayError::Write { path: path.to_owned(), source })
}

/// The recording as the bytes of an `.rrd` file.
///
/// It is made in memory, because Rerun's own file sink tells of a full disk only in its log.
fn encode(replay: &Replay) -> Result<Vec<u8>, ReplayError> {
    let application = env!("CARGO_PKG_NAME");
    // Explicitly enabled: the environment variable RERUN must not empty a file that was asked for.
    let (stream, storage) = RecordingStreamBuilder::new(application)
        .recording_name(words::name(replay.report))
        .enabled(true)
        .memory()?;
    layout::blueprint(replay).send(&stream, Default::default())?;
    let recorder = Recorder::new(stream, replay.origin);
    for arm in &replay.arms {
        arm::record(arm, &recorder)?;
        streams::record(arm, &recorder)?;
        plots::record(arm, &recorder)?;
    }
    words::record(replay, &recorder)?;
    Ok(storage.drain_as_bytes()?)
}

impl ReplayArm<'_> {
    /// The entity below which everything of this arm lies.
    fn entity(&self) -> EntityPath {
        rerun::entity_path![self.name]
    }

    /// A name for its stream `index` that no other has: the topic, and a number where several
    /// streams are of one topic.
    fn stream_name(&self, index: usize) -> String {
        let topic = self.streams[index].topic;
        match self.streams[..index].iter().filter(|stream| stream.topic == topic).count() {
            0 => topic.to_owned(),
            before => format!("{topic} ({})", before + 1),
        }
    }

    /// The joint states that say best where the arm was.
    fn joints(&self) -> &JointTrack {
        self.corrected.unwrap_or(self.recorded)
    }
}
