//! Filters samples for estimation: one publisher, no outliers, no stale or repeated values.

use super::outliers::{self, Outliers, detect_outliers};
use super::part_series::{Part, PartSeries, PartValues, collect_parts};
use super::publishers::{self, TwoPublishers, detect_publishers};
use super::repeated::{self, RepeatedValues, detect_repeated_values};
use super::role::Role;
use super::rows::Rows;
use super::stale::{self, JointLeap, StaleJoints, detect_stale_joints};
use super::streams::{Stream, StreamClocks, with_key};
use super::zero_rows::{detect_zero_rows, poses_of_zero_rows};

/// Samples excluded from estimation; each list is sorted by stream and part.
#[derive(Debug, Default)]
pub struct SampleFilter {
    /// Outliers and rows of zeros.
    pub outliers: Vec<Outliers>,
    /// Parts with two publishers.
    pub publishers: Vec<TwoPublishers>,
    /// Repeated values with new stamps.
    pub repeated: Vec<RepeatedValues>,
    /// Frozen joint states.
    pub(super) stale: Vec<StaleJoints>,
    /// Jumps of several joints in one sample, which are not excluded.
    pub leaps: Vec<JointLeap>,
}

impl SampleFilter {
    pub(super) fn new(streams: &[Stream], clocks: &StreamClocks) -> Self {
        let parts = collect_parts(streams);
        let by_stamp = |stream, piece| {
            let mut rows = clocks.rows(streams, stream, piece);
            rows.sort_by_key(|(stamp, _)| *stamp);
            rows
        };
        let all_rows = |part: &Part<'_>| {
            let mut rows = clocks.rows(streams, part.stream, part.piece);
            rows.sort_by_key(|(stamp, row)| (*stamp, part.times.log[*row]));
            rows
        };
        let publishers = detect_publishers(&parts, &all_rows);
        let mut zeros = detect_zero_rows(streams, clocks, &publishers);
        zeros.extend(poses_of_zero_rows(&parts, &by_stamp, &zeros));
        zeros.sort_by_key(|found| (found.stream, found.piece));
        let rows = |part: &Part<'_>| {
            let mut rows = all_rows(part);
            publishers::remove_second_publisher(&publishers, part.stream, part.piece, &mut rows);
            outliers::remove_outliers(&zeros, part.stream, part.piece, &mut rows);
            // A message resent with its stamp is the same row.
            rows.dedup_by_key(|(stamp, _)| *stamp);
            rows
        };
        let repeated = detect_repeated_values(&parts, &rows);
        let joints = parts.iter().filter(|part| {
            matches!(part.values, PartValues::Joints(_))
                && streams[part.stream].role == Role::Joints
        });
        let (mut stale, mut leaps) = (Vec::new(), Vec::new());
        for part in joints {
            let mut series = PartSeries::new(part, &rows);
            repeated::deduplicate(&repeated, part.stream, part.piece, &mut series.rows);
            let (stale_joints, joint_leaps) = detect_stale_joints(&series);
            stale.extend(stale_joints);
            leaps.extend(joint_leaps);
        }
        let mut outliers = detect_outliers(streams, clocks, &publishers, &zeros);
        outliers.extend(zeros);
        outliers.sort_by_key(|found| (found.stream, found.piece));
        Self { outliers, publishers, repeated, stale, leaps }
    }

    pub(super) fn apply(&self, stream: usize, piece: usize, rows: &mut Rows) {
        publishers::remove_second_publisher(&self.publishers, stream, piece, rows);
        outliers::remove_outliers(&self.outliers, stream, piece, rows);
        stale::remove_stale_rows(&self.stale, stream, rows);
        repeated::deduplicate(&self.repeated, stream, piece, rows);
    }

    /// Copies one part's results to another stream.
    pub(super) fn share(&mut self, part: (usize, usize), to: usize) {
        let outliers = with_key(&self.outliers, part, |one| (one.stream, one.piece)).to_vec();
        let outliers = outliers.into_iter().map(|one| Outliers { stream: to, piece: 0, ..one });
        self.outliers.extend(outliers);
        let two = with_key(&self.publishers, part, |one| (one.stream, one.piece)).to_vec();
        let two = two.into_iter().map(|one| TwoPublishers { stream: to, piece: 0, ..one });
        self.publishers.extend(two);
        let repeated = with_key(&self.repeated, part, |one| (one.stream, one.piece)).to_vec();
        let repeated =
            repeated.into_iter().map(|one| RepeatedValues { stream: to, piece: 0, ..one });
        self.repeated.extend(repeated);
    }
}
