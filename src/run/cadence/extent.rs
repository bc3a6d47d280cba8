//! Compares the start and end of each stream with the others.

use super::motion::ArmMotion;
use super::parts::CadencePart;
use crate::run::clock::StreamClock;
use crate::time::{Stamp, seconds};

/// Start and end relative to other streams, by receive time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StreamExtent {
    /// Start relative to the median start of the others, s; positive if later.
    pub late_start_s: f64,
    /// End relative to the others, s; positive if earlier.
    pub early_end_s: f64,
    /// Whether the arm moved before the start and after the end; `None` without joint states there.
    pub is_arm_moving: [Option<bool>; 2],
}

#[derive(Clone, Copy)]
pub(super) struct PartBounds {
    received: (i64, i64),
    stamps: (Stamp, Stamp),
}

impl PartBounds {
    pub(super) fn measure(part: &CadencePart<'_>, clock: &StreamClock) -> Option<Self> {
        let stamp = |row: usize| clock.stamp_of(part.times, row);
        // Receive times of messages without stamps may be unset, too.
        let stamped = part.rows.iter().filter(|row| stamp(*row).is_some());
        let received = stamped.map(|row| part.times.log[row]);
        Some(Self {
            received: min_max(received)?,
            stamps: min_max(part.rows.iter().filter_map(stamp))?,
        })
    }

    pub(super) fn join(self, other: Self) -> Self {
        let ((a, b), (c, d)) = (self.received, other.received);
        let ((e, f), (g, h)) = (self.stamps, other.stamps);
        Self { received: (a.min(c), b.max(d)), stamps: (e.min(g), f.max(h)) }
    }
}

fn min_max<T: Ord + Copy>(mut values: impl Iterator<Item = T>) -> Option<(T, T)> {
    let first = values.next()?;
    Some(
        values.fold((first, first), |(least, greatest), value| {
            (least.min(value), greatest.max(value))
        }),
    )
}

pub(super) struct SortedEnds {
    starts: Vec<i64>,
    ends: Vec<i64>,
}

impl SortedEnds {
    pub(super) fn collect(bounds: &[Option<PartBounds>]) -> Self {
        let sorted = |time: fn(&PartBounds) -> i64| {
            let mut times: Vec<i64> = bounds.iter().flatten().map(time).collect();
            times.sort_unstable();
            times
        };
        Self { starts: sorted(|of| of.received.0), ends: sorted(|of| of.received.1) }
    }
}

/// Median of sorted `times` without `own`, one of them. For an even count, the greater middle value if
/// `upper`, else the smaller.
fn median_of_others(times: &[i64], own: i64, upper: bool) -> Option<i64> {
    let others = times.len().checked_sub(1)?;
    let middle = if upper { others / 2 } else { others.saturating_sub(1) / 2 };
    let place = times.partition_point(|time| *time < own);
    let is_there = middle < others;
    is_there.then(|| times[middle + usize::from(middle >= place)])
}

pub(super) fn compare_extent(
    bounds: &[Option<PartBounds>],
    all: &SortedEnds,
    index: usize,
    motion: &ArmMotion,
) -> Option<StreamExtent> {
    let own = bounds[index]?;
    // With two others, use the one closer to this stream.
    let start = median_of_others(&all.starts, own.received.0, true)?;
    let end = median_of_others(&all.ends, own.received.1, false)?;
    let late_start_s = seconds(own.received.0.saturating_sub(start));
    let early_end_s = seconds(end.saturating_sub(own.received.1));
    let (first, last) = own.stamps;
    let moving = [
        motion.moves(first.shifted(-late_start_s.max(0.0)), first),
        motion.moves(last, last.shifted(early_end_s.max(0.0))),
    ];
    Some(StreamExtent { late_start_s, early_end_s, is_arm_moving: moving })
}
