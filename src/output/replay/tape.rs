//! Writer of a recording: entity paths, and columns on all timelines.

use re_chunk::TimeColumn;
use re_log_types::{EntityPath, EntityPathPart};
use re_sdk_types::{AsComponents, SerializedComponentColumn};

use super::moments::Moments;
use super::reel::Reel;
use super::{Receipts, ReplayArm, ReplayCause};
use crate::time::Stamp;

/// Seconds since the run's origin.
pub(super) const RUN: &str = "run";
/// Index of joint states.
pub(super) const SAMPLE: &str = "sample";

/// Timelines that come from the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Names {
    pub stamp: &'static str,
    /// Receive times.
    pub log: &'static str,
}

impl Names {
    /// Names without the log.
    pub const OWN: Self = Self { stamp: "stamp", log: "log_time" };
    /// The viewer's names for a log: one cursor moves both.
    pub const OF_VIEWER: Self = Self { stamp: "ros2_timestamp", log: "message_log_time" };
}

pub(super) struct Tape {
    reel: Reel,
    origin: Stamp,
    names: Names,
}

impl Tape {
    pub fn new(reel: Reel, origin: Stamp, names: Names) -> Self {
        Self { reel, origin, names }
    }

    pub fn stamp(&self, t_s: f64) -> Stamp {
        self.origin.shifted(t_s)
    }

    /// Times on all timelines; `received` are the receive times.
    pub fn moments(
        &self,
        arm: &ReplayArm<'_>,
        received: &Receipts,
        stamps: impl Iterator<Item = Stamp>,
    ) -> Moments {
        /// Half a microsecond, because seconds are floats.
        const NOTHING_S: f64 = 5e-7;
        let mut moments = Moments::default();
        for stamp in stamps {
            let t_s = stamp.seconds_since(self.origin) + NOTHING_S;
            let so_far = arm.recorded.t_s.partition_point(|known_s| *known_s <= t_s);
            moments.stamps_ns.push(stamp.nanos());
            moments.logs_ns.push(received.log_time(stamp).nanos());
            moments.samples.push(so_far.saturating_sub(1) as i64);
        }
        moments
    }

    pub fn of_joints(&self, arm: &ReplayArm<'_>, kept: &[usize]) -> Moments {
        let stamps = kept.iter().map(|&row| self.stamp(arm.recorded.t_s[row]));
        self.moments(arm, &arm.received, stamps)
    }

    /// Adds a row without times.
    pub fn still(&self, path: &EntityPath, what: &impl AsComponents) -> Result<(), ReplayCause> {
        self.reel.still(path, what)
    }

    /// One row per time.
    pub fn columns(
        &self,
        path: &EntityPath,
        moments: &Moments,
        columns: impl Iterator<Item = SerializedComponentColumn>,
    ) -> Result<(), ReplayCause> {
        let Moments { stamps_ns, logs_ns, samples } = moments;
        let since_origin = stamps_ns.iter().map(|stamp| stamp.saturating_sub(self.origin.nanos()));
        let Names { stamp, log } = self.names;
        let times = [
            TimeColumn::new_duration_nanos(RUN, since_origin),
            TimeColumn::new_timestamp_nanos_since_epoch(stamp, stamps_ns.iter().copied()),
            TimeColumn::new_timestamp_nanos_since_epoch(log, logs_ns.iter().copied()),
            TimeColumn::new_sequence(SAMPLE, samples.iter().copied()),
        ];
        self.reel.columns(path, times, columns)
    }

    pub fn finish(self) -> Reel {
        self.reel
    }
}

/// The slashes of a topic separate further parts.
pub(super) fn entity(parts: &[&str]) -> EntityPath {
    let parts = parts.iter().flat_map(|part| part.split('/')).filter(|part| !part.is_empty());
    EntityPath::from(parts.map(EntityPathPart::new).collect::<Vec<_>>())
}
