//! How the time of one stream lies against that of the others.

use super::motion::Motion;
use super::parts::Part;
use crate::run::clock::StreamClock;
use crate::time::{Stamp, seconds};

/// How the time of one stream lies against that of the others, by when their messages were received.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extent {
    /// By how much it begins after the others (their median), s; negative where before.
    pub late_start_s: f64,
    /// By how much it ends before the others, s; negative where after.
    pub early_end_s: f64,
    /// Whether the arm moved before it began and after it ended; `None` where no joint states say.
    pub moving: [Option<bool>; 2],
}

/// First and last row of a stream: when received, and on the audit's clock.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    received: (i64, i64),
    stamps: (Stamp, Stamp),
}

impl Bounds {
    pub(super) fn of(part: &Part<'_>, clock: &StreamClock) -> Option<Self> {
        let received = part.rows.iter().map(|row| part.times.log[row]);
        let known = part.rows.iter().filter_map(|row| clock.stamp_of(part.times, row));
        Some(Self { received: ends(received)?, stamps: ends(known)? })
    }

    pub(super) fn join(self, other: Self) -> Self {
        let ((a, b), (c, d)) = (self.received, other.received);
        let ((e, f), (g, h)) = (self.stamps, other.stamps);
        Self { received: (a.min(c), b.max(d)), stamps: (e.min(g), f.max(h)) }
    }
}

/// The least and the greatest.
fn ends<T: Ord + Copy>(mut values: impl Iterator<Item = T>) -> Option<(T, T)> {
    let first = values.next()?;
    Some(
        values.fold((first, first), |(least, greatest), value| {
            (least.min(value), greatest.max(value))
        }),
    )
}

/// How stream `index` lies against the others.
pub(super) fn extent(bounds: &[Option<Bounds>], index: usize, motion: &Motion) -> Option<Extent> {
    let own = bounds[index]?;
    let others = || {
        let others = bounds.iter().enumerate().filter(move |(other, _)| *other != index);
        others.filter_map(|(_, bounds)| *bounds)
    };
    // Of two others the one that leaves the less to blame this stream for.
    let median = |mut times: Vec<i64>, upper: bool| {
        times.sort_unstable();
        let middle = if upper { times.len() / 2 } else { times.len().saturating_sub(1) / 2 };
        times.get(middle).copied()
    };
    let start = median(others().map(|other| other.received.0).collect(), true)?;
    let end = median(others().map(|other| other.received.1).collect(), false)?;
    let late_start_s = seconds(own.received.0.saturating_sub(start));
    let early_end_s = seconds(end.saturating_sub(own.received.1));
    let (first, last) = own.stamps;
    let moving = [
        motion.moves(first.shifted(-late_start_s.max(0.0)), first),
        motion.moves(last, last.shifted(early_end_s.max(0.0))),
    ];
    Some(Extent { late_start_s, early_end_s, moving })
}
