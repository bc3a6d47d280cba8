//! Rows appended to columns, then finalized.

use std::collections::HashMap;

use super::row::{self, Names, Row, RowTimes};
use crate::stream::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, PoseColumns, TextColumns, Times,
};

/// Most joint names a topic may have. Rows are dense, so that a message with a new name each time
/// would fill the memory; the largest humanoids have below a hundred joints.
const MAX_JOINTS: usize = 256;

/// Most distinct texts kept of a topic.
const MAX_TEXTS: usize = 64;

/// Longest text kept, in bytes.
const MAX_TEXT_BYTES: usize = 16 << 20;

/// A message with more joint names than a topic may have.
#[derive(Debug, thiserror::Error)]
#[error("more than {MAX_JOINTS} different joint names on one topic")]
pub(in crate::log) struct TooManyJoints;

/// The columns of one topic while rows are appended.
#[derive(Debug)]
pub(in crate::log) enum Builder {
    Joints(Joints),
    Poses(Poses),
    Transforms(Poses),
    Imu(ImuColumns),
    Array(ArrayColumns),
    Text(TextColumns),
}

impl Builder {
    pub(super) fn joints() -> Self {
        Self::Joints(Joints::default())
    }

    pub(super) fn poses() -> Self {
        Self::Poses(Poses::default())
    }

    pub(super) fn transforms() -> Self {
        Self::Transforms(Poses::default())
    }

    pub(super) fn imu() -> Self {
        Self::Imu(ImuColumns::default())
    }

    pub(super) fn array() -> Self {
        Self::Array(ArrayColumns::default())
    }

    pub(super) fn text() -> Self {
        Self::Text(TextColumns::default())
    }

    /// Appends one row, or counts why it is dropped.
    pub(in crate::log) fn append(
        &mut self,
        row: &Row,
        times: RowTimes,
    ) -> Result<(), TooManyJoints> {
        match self {
            Builder::Joints(joints) => joints.append(row, times)?,
            Builder::Poses(poses) | Builder::Transforms(poses) => poses.append(row, times),
            Builder::Imu(imu) => append_imu(imu, row, times),
            Builder::Array(array) => append_array(array, row, times),
            Builder::Text(text) => append_text(text, row, times),
        }
        Ok(())
    }

    /// The columns.
    pub(in crate::log) fn finalize(self) -> Columns {
        match self {
            Builder::Joints(joints) => Columns::Joints(joints.columns),
            Builder::Poses(poses) => Columns::Poses(poses.groups),
            Builder::Transforms(poses) => Columns::Transforms(poses.groups),
            Builder::Imu(imu) => Columns::Imu(imu),
            Builder::Array(array) => Columns::Array(array),
            Builder::Text(text) => Columns::Text(text),
        }
    }
}

/// Joint states, with the way from a message's names to their columns.
#[derive(Debug, Default)]
pub(in crate::log) struct Joints {
    columns: JointColumns,
    by_name: HashMap<String, usize>,
    /// Names of the message before, which the next one mostly repeats,
    names: Names,
    /// and the column of each.
    order: Vec<usize>,
}

impl Joints {
    fn append(&mut self, row: &Row, times: RowTimes) -> Result<(), TooManyJoints> {
        let [positions, velocities] = [&row.lists[row::VALUES], &row.lists[row::VELOCITIES]];
        if positions.len() != row.names.len() {
            self.columns.wrong_length += 1;
            return Ok(());
        }
        if row.names != self.names {
            self.map_names(&row.names)?;
        }
        keep_first(&mut self.columns.frame_id, row.frame(row::FRAME));
        let index = push_times(&mut self.columns.times, row.stamp(), times);
        for joint in &mut self.columns.joints {
            joint.position.push(f64::NAN);
            joint.velocity.push(f64::NAN);
        }
        let with_velocity = velocities.len() == positions.len();
        for (i, (&column, &position)) in self.order.iter().zip(positions).enumerate() {
            let joint = &mut self.columns.joints[column];
            if position.is_finite() {
                joint.position[index] = position;
            } else {
                self.columns.not_finite += 1;
            }
            if with_velocity {
                joint.velocity[index] = velocities[i];
            }
        }
        Ok(())
    }

    /// Finds the columns of `names`, and makes those that are new.
    fn map_names(&mut self, names: &Names) -> Result<(), TooManyJoints> {
        // Should the columns run out halfway, the next message must be mapped anew.
        self.names.clear();
        self.order.clear();
        let rows = self.columns.times.len();
        for name in names.iter() {
            let column = match self.by_name.get(name) {
                Some(&column) => column,
                None if self.columns.joints.len() == MAX_JOINTS => return Err(TooManyJoints),
                None => {
                    let absent = vec![f64::NAN; rows];
                    self.columns.joints.push(JointColumn {
                        name: name.to_owned(),
                        position: absent.clone(),
                        velocity: absent,
                    });
                    let column = self.columns.joints.len() - 1;
                    self.by_name.insert(name.to_owned(), column);
                    column
                }
            };
            self.order.push(column);
        }
        self.names.clone_from(names);
        Ok(())
    }
}

/// Poses split by frame and child frame.
#[derive(Debug, Default)]
pub(in crate::log) struct Poses {
    groups: Vec<PoseColumns>,
    by_frames: HashMap<String, usize>,
    /// Scratch for a key of `by_frames`.
    key: String,
    /// The group of the row before.
    last: usize,
}

impl Poses {
    fn append(&mut self, row: &Row, times: RowTimes) {
        self.last = self.group(row.frame(row::FRAME), row.frame(row::CHILD));
        let group = &mut self.groups[self.last];
        let xyz = row.numbers::<3>(row::POSITION);
        let q_xyzw = row.numbers::<4>(row::QUATERNION);
        if !finite(&xyz) || !finite(&q_xyzw) {
            group.not_finite += 1;
            return;
        }
        push_times(&mut group.times, row.stamp(), times);
        group.xyz.push(xyz);
        group.q_xyzw.push(q_xyzw);
    }

    /// The group of a pair of frames.
    fn group(&mut self, frame_id: &str, child_frame_id: &str) -> usize {
        let same = |group: &PoseColumns| {
            group.frame_id == frame_id && group.child_frame_id == child_frame_id
        };
        if self.groups.get(self.last).is_some_and(same) {
            return self.last;
        }
        self.key.clear();
        self.key.push_str(frame_id);
        self.key.push('\0');
        self.key.push_str(child_frame_id);
        if let Some(&group) = self.by_frames.get(&self.key) {
            return group;
        }
        self.groups.push(PoseColumns {
            frame_id: frame_id.to_owned(),
            child_frame_id: child_frame_id.to_owned(),
            ..PoseColumns::default()
        });
        let group = self.groups.len() - 1;
        self.by_frames.insert(self.key.clone(), group);
        group
    }
}

fn append_imu(imu: &mut ImuColumns, row: &Row, times: RowTimes) {
    keep_first(&mut imu.frame_id, row.frame(row::FRAME));
    // REP 145: −1 in the first place says that there is no orientation.
    let has_orientation = row.lists[row::VALUES].first() != Some(&-1.0);
    let q_xyzw = if has_orientation { row.numbers(row::QUATERNION) } else { [0.0; 4] };
    let gyro = row.numbers(row::GYRO);
    let accel = row.numbers(row::ACCEL);
    if !finite(&q_xyzw) || !finite(&gyro) || !finite(&accel) {
        imu.not_finite += 1;
        return;
    }
    imu.has_orientation |= has_orientation;
    push_times(&mut imu.times, row.stamp(), times);
    imu.q_xyzw.push(q_xyzw);
    imu.gyro.push(gyro);
    imu.accel.push(accel);
}

fn append_array(array: &mut ArrayColumns, row: &Row, times: RowTimes) {
    let values = &row.lists[row::VALUES];
    if array.width == 0 {
        array.width = values.len();
    }
    if values.is_empty() || values.len() != array.width {
        array.wrong_length += 1;
    } else if !finite(values) {
        array.not_finite += 1;
    } else {
        push_times(&mut array.times, 0, times);
        array.values.extend_from_slice(values);
    }
}

fn append_text(column: &mut TextColumns, row: &Row, times: RowTimes) {
    let text = &row.texts[row::BODY];
    let full = column.text.len() == MAX_TEXTS || text.len() > MAX_TEXT_BYTES;
    if !full && !column.text.contains(text) {
        push_times(&mut column.times, 0, times);
        column.text.push(text.clone());
    }
}

/// Appends the times of a row and returns its index.
fn push_times(column: &mut Times, stamp: i64, times: RowTimes) -> usize {
    column.push(stamp, times.log, times.publish);
    column.len() - 1
}

fn keep_first(kept: &mut String, text: &str) {
    if kept.is_empty() && !text.is_empty() {
        text.clone_into(kept);
    }
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|value| value.is_finite())
}
