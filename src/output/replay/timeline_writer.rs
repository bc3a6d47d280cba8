//! Writer of a recording: entity paths, and columns on all timelines.

use re_chunk::TimeColumn;
use re_log_types::{EntityPath, EntityPathPart};
use re_sdk_types::{AsComponents, SerializedComponentColumn};

use super::chunk_writer::ChunkWriter;
use super::row_times::RowTimes;
use super::{ReceiveTimes, ReplayArm, ReplayCause};
use crate::time::Stamp;

/// Seconds since the run's origin.
pub(super) const RUN_TIMELINE: &str = "run";
/// Index of joint states.
pub(super) const SAMPLE_TIMELINE: &str = "sample";

/// Timelines that come from the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TimelineNames {
    pub stamp: &'static str,
    /// Receive times.
    pub log: &'static str,
}

impl TimelineNames {
    /// Names without the log.
    pub const STANDALONE: Self = Self { stamp: "stamp", log: "log_time" };
    /// The viewer's names for a log: one cursor moves both.
    pub const VIEWER: Self = Self { stamp: "ros2_timestamp", log: "message_log_time" };
}

pub(super) struct TimelineWriter {
    writer: ChunkWriter,
    origin: Stamp,
    names: TimelineNames,
}

impl TimelineWriter {
    pub fn new(chunks: ChunkWriter, origin: Stamp, names: TimelineNames) -> Self {
        Self { writer: chunks, origin, names }
    }

    pub fn stamp(&self, t_s: f64) -> Stamp {
        self.origin.shifted(t_s)
    }

    /// Times on all timelines; `received` are the receive times.
    pub fn row_times(
        &self,
        arm: &ReplayArm<'_>,
        received: &ReceiveTimes,
        stamps: impl Iterator<Item = Stamp>,
    ) -> RowTimes {
        /// Half a microsecond, because seconds are floats.
        const TOLERANCE_S: f64 = 5e-7;
        let mut times = RowTimes::default();
        for stamp in stamps {
            let t_s = stamp.seconds_since(self.origin) + TOLERANCE_S;
            let so_far = arm.recorded.t_s.partition_point(|known_s| *known_s <= t_s);
            times.stamps_ns.push(stamp.nanos());
            times.logs_ns.push(received.log_time(stamp).nanos());
            times.samples.push(so_far.saturating_sub(1) as i64);
        }
        times
    }

    pub fn joint_times(&self, arm: &ReplayArm<'_>, kept: &[usize]) -> RowTimes {
        let stamps = kept.iter().map(|&row| self.stamp(arm.recorded.t_s[row]));
        self.row_times(arm, &arm.received, stamps)
    }

    /// Adds a row without times.
    pub fn log_static(
        &self,
        path: &EntityPath,
        what: &impl AsComponents,
    ) -> Result<(), ReplayCause> {
        self.writer.log_static(path, what)
    }

    /// One row per time.
    pub fn log_columns(
        &self,
        path: &EntityPath,
        times: &RowTimes,
        columns: impl Iterator<Item = SerializedComponentColumn>,
    ) -> Result<(), ReplayCause> {
        let RowTimes { stamps_ns, logs_ns, samples } = times;
        let since_origin = stamps_ns.iter().map(|stamp| stamp.saturating_sub(self.origin.nanos()));
        let TimelineNames { stamp, log } = self.names;
        let times = [
            TimeColumn::new_duration_nanos(RUN_TIMELINE, since_origin),
            TimeColumn::new_timestamp_nanos_since_epoch(stamp, stamps_ns.iter().copied()),
            TimeColumn::new_timestamp_nanos_since_epoch(log, logs_ns.iter().copied()),
            TimeColumn::new_sequence(SAMPLE_TIMELINE, samples.iter().copied()),
        ];
        self.writer.log_columns(path, times, columns)
    }

    pub fn finish(self) -> ChunkWriter {
        self.writer
    }
}

/// The slashes of a topic separate further parts.
pub(super) fn entity_path(parts: &[&str]) -> EntityPath {
    let parts = parts.iter().flat_map(|part| part.split('/')).filter(|part| !part.is_empty());
    EntityPath::from(parts.map(EntityPathPart::new).collect::<Vec<_>>())
}
