//! The recording as it is written: entity paths, and columns on both timelines.

use rerun::log::TimeColumn;
use rerun::{
    AsComponents, EntityPath, EntityPathPart, RecordingStream, RecordingStreamResult,
    SerializedComponentColumn,
};

use super::ReplayCause;
use crate::time::Stamp;

/// The timeline of stamps as the log has them.
const STAMP: &str = "stamp";
/// The timeline since the run's origin.
pub(super) const RUN: &str = "run";

/// The recording.
pub(super) struct Tape {
    recording: RecordingStream,
    origin: Stamp,
}

impl Tape {
    pub fn new(recording: RecordingStream, origin: Stamp) -> Self {
        Self { recording, origin }
    }

    /// Stamp of a time in seconds from the origin, ns.
    pub fn stamp_ns(&self, t_s: f64) -> i64 {
        self.origin.shifted(t_s).nanos()
    }

    /// Adds what holds all the time.
    pub fn still(&self, path: &EntityPath, what: &impl AsComponents) -> RecordingStreamResult<()> {
        self.recording.log_static(path.clone(), what)
    }

    /// Adds columns with a row for each stamp.
    pub fn columns(
        &self,
        path: &EntityPath,
        stamps_ns: &[i64],
        columns: impl Iterator<Item = SerializedComponentColumn>,
    ) -> RecordingStreamResult<()> {
        let since_origin = stamps_ns.iter().map(|stamp| stamp.saturating_sub(self.origin.nanos()));
        let times = [
            TimeColumn::new_timestamp_nanos_since_epoch(STAMP, stamps_ns.iter().copied()),
            TimeColumn::new_duration_nanos(RUN, since_origin),
        ];
        self.recording.send_columns(path.clone(), times, columns)
    }

    /// Waits until everything is on disk.
    pub fn finish(self) -> Result<(), ReplayCause> {
        Ok(self.recording.flush_blocking()?)
    }
}

/// The entity at the end of `parts`; a topic's slashes part it further.
pub(super) fn entity(parts: &[&str]) -> EntityPath {
    let parts = parts.iter().flat_map(|part| part.split('/')).filter(|part| !part.is_empty());
    EntityPath::from(parts.map(EntityPathPart::new).collect::<Vec<_>>())
}
