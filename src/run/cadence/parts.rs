//! Splits a stream into senders and transforms.

use std::collections::HashSet;

use crate::run::arm::Arm;
use crate::run::part_series::PartValues;
use crate::run::role::is_detection_frame;
use crate::run::tf_tree::strip_slash;
use crate::stream::{Columns, JointColumns, PoseColumns, Times};

pub(super) struct CadencePart<'a> {
    /// Index of the stream's part.
    pub piece: usize,
    pub frame: Option<&'a str>,
    pub is_audited: bool,
    pub times: &'a Times,
    /// Rows in receive order.
    pub rows: RowOrder,
    pub values: PartValues<'a>,
}

pub(super) struct RowOrder {
    count: usize,
    /// `None` for all rows in log order, usually the receive order.
    rows: Option<Vec<usize>>,
}

impl CadencePart<'_> {
    /// Whether both parts have the same times.
    pub fn has_times_of(&self, other: &Self) -> bool {
        let is_shared = std::ptr::eq(self.times, other.times);
        self.rows.rows == other.rows.rows && (is_shared || self.times == other.times)
    }

    /// Splits by publisher, given the rows of the second.
    pub fn by_publisher(&self, second: &HashSet<usize>) -> [Self; 2] {
        let (of_second, of_first): (Vec<usize>, Vec<usize>) =
            self.rows.iter().partition(|row| second.contains(row));
        let part = |rows| Self { rows: RowOrder::by_receive_time(self.times, rows), ..*self };
        [of_first, of_second].map(part)
    }
}

impl RowOrder {
    fn all(times: &Times) -> Self {
        let count = times.len();
        match times.log.is_sorted() {
            true => Self { count, rows: None },
            false => Self::by_receive_time(times, (0..count).collect()),
        }
    }

    fn by_receive_time(times: &Times, mut rows: Vec<usize>) -> Self {
        rows.sort_by_key(|&row| times.log[row]);
        Self { count: rows.len(), rows: Some(rows) }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn iter(&self) -> impl Iterator<Item = usize> {
        let row = |at: usize| self.rows.as_ref().map_or(at, |rows| rows[at]);
        (0..self.count).map(row)
    }
}

pub(super) fn split_parts<'a>(columns: &'a Columns, arms: &[Arm]) -> Vec<CadencePart<'a>> {
    let mut parts = Vec::new();
    for (piece, times) in columns.times().into_iter().enumerate() {
        let Some(values) = PartValues::of(columns, piece) else { continue };
        let rows = RowOrder::all(times);
        let whole = CadencePart { piece, frame: None, is_audited: true, times, rows, values };
        match columns {
            Columns::Joints(joints) if !is_complete(joints) => {
                let of_sender =
                    |rows| CadencePart { rows: RowOrder::by_receive_time(times, rows), ..whole };
                parts.extend(rows_by_sender(joints).into_iter().map(of_sender));
            }
            Columns::Transforms(poses) => parts.push(CadencePart {
                frame: Some(strip_slash(&poses[piece].child_frame_id)),
                is_audited: is_of_an_arm(&poses[piece], arms),
                ..whole
            }),
            _ => parts.push(whole),
        }
    }
    parts
}

/// Whether a transform is between the arm's links; without an arm, whether it is not a camera detection.
fn is_of_an_arm(transform: &PoseColumns, arms: &[Arm]) -> bool {
    let (parent, child) =
        (strip_slash(&transform.frame_id), strip_slash(&transform.child_frame_id));
    if arms.is_empty() {
        return !is_detection_frame(parent) && !is_detection_frame(child);
    }
    arms.iter().any(|arm| arm.joints_between(parent, child).is_some())
}

fn is_complete(joints: &JointColumns) -> bool {
    joints.joints.iter().all(|joint| joint.position.iter().all(|q| !q.is_nan()))
}

/// Groups rows by sender: joints that ever share a message have the same one.
pub(super) fn rows_by_sender(joints: &JointColumns) -> Vec<Vec<usize>> {
    let in_row = |row: usize| {
        let joints = joints.joints.iter().enumerate();
        joints.filter(move |(_, joint)| !joint.position[row].is_nan()).map(|(index, _)| index)
    };
    let mut sender: Vec<usize> = (0..joints.joints.len()).collect();
    for row in 0..joints.times.len() {
        let Some(first) = in_row(row).next() else { continue };
        for joint in in_row(row) {
            let (kept, gone) = (sender[first], sender[joint]);
            if kept != gone {
                sender.iter_mut().filter(|of| **of == gone).for_each(|of| *of = kept);
            }
        }
    }
    let mut rows: Vec<(usize, Vec<usize>)> = Vec::new();
    for row in 0..joints.times.len() {
        let Some(of) = in_row(row).next().map(|joint| sender[joint]) else { continue };
        match rows.iter_mut().find(|(known, _)| *known == of) {
            Some((_, rows)) => rows.push(row),
            None => rows.push((of, vec![row])),
        }
    }
    rows.into_iter().map(|(_, rows)| rows).collect()
}
