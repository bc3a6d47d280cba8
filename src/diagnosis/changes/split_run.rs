//! Splits a run into segments.

use std::ops::Range;

use super::jumps::Jump;
use crate::arm_run::ArmRun;
use crate::latency::compensation::{tracks_with_stamps, with_tracks};
use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::samples::sampling::rows_within;
use ground::stats::lowest;
use ground::stream::JointTrack;

/// Change points are on the joint states' clock.
pub(super) struct SplitRun<'a> {
    pub arm: ArmRun<'a>,
    /// Latency per stream.
    pub lags: &'a [f64],
}

/// Start (inclusive) and end (exclusive), s.
pub(super) type Span = (f64, f64);

/// Sets a joint's velocity in `row` from its positions there and in row `neighbour`. Velocities derived from
/// positions are wrong next to a jump.
pub(super) fn set_velocity(joints: &mut JointTrack, column: usize, row: usize, neighbour: usize) {
    let JointTrack { t_s, dof, q, qd, .. } = joints;
    if row == neighbour || row.max(neighbour) >= t_s.len() {
        return;
    }
    let [here, there] = [row, neighbour].map(|row| row * *dof + column);
    qd[here] = (q[there] - q[here]) / (t_s[neighbour] - t_s[row]);
}

impl SplitRun<'_> {
    /// Segments between jumps. Of the two jumps that bound a segment with too few samples, drops the weaker.
    pub fn split_at(&self, jumps: &[Jump]) -> Vec<Span> {
        let mut jumps = jumps.to_vec();
        loop {
            let inner = || jumps.iter().map(|jump| jump.at_s);
            let starts = std::iter::once(f64::NEG_INFINITY).chain(inner());
            let spans: Vec<Span> = starts.zip(inner().chain([f64::INFINITY])).collect();
            let is_short = |span: &Span| self.samples(*span) < MIN_SEGMENT_SAMPLES;
            let Some(short) = spans.iter().position(is_short) else { return spans };
            let ends = short.checked_sub(1).into_iter().chain([short]);
            let ends = ends.filter(|end| *end < jumps.len());
            let weaker = lowest(ends, |end| jumps[*end].strength);
            let Some(weaker) = weaker else { return Vec::new() };
            jumps.remove(weaker);
        }
    }

    fn rows(&self, stream: usize, (from_s, to_s): Span) -> Range<usize> {
        let (t_s, lag_s) = (&self.arm.streams[stream].track.t_s, self.lags[stream]);
        rows_within(t_s, from_s + lag_s, to_s + lag_s)
    }

    /// Samples of the stream that has most.
    pub fn samples(&self, span: Span) -> usize {
        (0..self.arm.streams.len()).map(|s| self.rows(s, span).len()).max().unwrap_or(0)
    }

    fn joints_in(&self, (from_s, to_s): Span) -> JointTrack {
        let joints = self.arm.joints;
        let rows = rows_within(&joints.t_s, from_s, to_s);
        let mut segment = joints.at_rows(rows.clone());
        let last = segment.len().saturating_sub(1);
        (0..joints.dof).for_each(|column| {
            if rows.start > 0 {
                set_velocity(&mut segment, column, 0, 1);
            }
            if rows.end < joints.len() {
                set_velocity(&mut segment, column, last, last.saturating_sub(1));
            }
        });
        segment
    }

    /// Result of a function of a segment alone.
    pub fn within<T>(&self, span: Span, of: impl FnOnce(&ArmRun) -> T) -> T {
        let tracks = tracks_with_stamps(self.arm.streams, |s, t_s| {
            Some(self.rows(s, span).map(|row| (row, t_s[row])).collect())
        });
        let streams = with_tracks(self.arm.streams, &tracks);
        of(&ArmRun { joints: &self.joints_in(span), streams: &streams, ..self.arm })
    }
}
