//! Streams as rows of numbers in time order: joint states, poses, transforms, IMUs.

use std::ops::Deref;

use crate::stream::{ArrayColumns, Columns, ImuColumns, JointColumns, PoseColumns, Times};

use super::role::Role;
use super::rows::Rows;
use super::streams::Stream;
use super::tf_tree::strip_slash;

/// One part of a stream.
#[derive(Clone, Copy)]
pub(super) struct Part<'a> {
    /// Index of the stream.
    pub stream: usize,
    /// Index of the part.
    pub piece: usize,
    /// Child frame of a transform.
    pub frame: Option<&'a str>,
    /// Whether one program wrote the columns as a table.
    pub is_table: bool,
    pub times: &'a Times,
    pub values: PartValues<'a>,
}

/// A part with its rows in time order. They take as much memory as a number of each row, so only the parts in work have
/// them.
pub(super) struct PartSeries<'a> {
    pub part: Part<'a>,
    pub rows: Rows,
}

impl<'a> Deref for PartSeries<'a> {
    type Target = Part<'a>;

    fn deref(&self) -> &Part<'a> {
        &self.part
    }
}

/// Rows of a part in time order.
pub(super) type RowsOfPart<'a> = &'a (dyn Fn(&Part<'_>) -> Rows + Sync);

#[derive(Clone, Copy)]
pub(super) enum PartValues<'a> {
    Joints(&'a JointColumns),
    Poses(&'a PoseColumns),
    Imu(&'a ImuColumns),
    Array(&'a ArrayColumns),
}

impl<'a> PartValues<'a> {
    /// Values of one part of [`Columns::times`]; `None` for texts.
    pub fn of(columns: &'a Columns, piece: usize) -> Option<Self> {
        match columns {
            Columns::Joints(joints) => Some(Self::Joints(joints)),
            Columns::Poses(poses) | Columns::Transforms(poses) => poses.get(piece).map(Self::Poses),
            Columns::Imu(imu) => Some(Self::Imu(imu)),
            Columns::Array(array) => Some(Self::Array(array)),
            Columns::Text(_) => None,
        }
    }

    /// Number of values per row.
    pub fn width(&self) -> usize {
        match self {
            PartValues::Joints(joints) => joints.joints.len(),
            PartValues::Poses(_) => 7,
            PartValues::Imu(_) => 10,
            PartValues::Array(array) => array.width,
        }
    }

    pub fn number(&self, row: usize, number: usize) -> f64 {
        match (self, number) {
            (PartValues::Joints(joints), _) => joints.joints[number].position[row],
            (PartValues::Poses(poses), 0..3) => poses.xyz[row][number],
            (PartValues::Poses(poses), _) => poses.q_xyzw[row][number - 3],
            (PartValues::Array(array), _) => array.row(row)[number],
            (PartValues::Imu(imu), 0..3) => imu.gyro[row][number],
            (PartValues::Imu(imu), 3..6) => imu.accel[row][number - 3],
            (PartValues::Imu(imu), _) => imu.q_xyzw[row][number - 6],
        }
    }

    /// Whether two rows are bitwise equal.
    pub fn is_same(&self, a: usize, b: usize) -> bool {
        self.has_same_numbers(self.width(), a, b)
    }

    /// Whether two rows have the same measurement. The orientation of an IMU is computed from its measurements.
    pub fn is_same_measurement(&self, a: usize, b: usize) -> bool {
        let count = if matches!(self, PartValues::Imu(_)) { 6 } else { self.width() };
        self.has_same_numbers(count, a, b)
    }

    fn has_same_numbers(&self, count: usize, a: usize, b: usize) -> bool {
        let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
        (0..count).all(|number| same(self.number(a, number), self.number(b, number)))
    }
}

impl<'a> PartSeries<'a> {
    pub fn new(part: &Part<'a>, rows: RowsOfPart<'_>) -> Self {
        Self { part: *part, rows: rows(part) }
    }

    /// Seconds since the first row.
    pub fn seconds(&self) -> Vec<f64> {
        let first = self.rows.first().map(|(stamp, _)| *stamp).unwrap_or_default();
        self.rows.iter().map(|(stamp, _)| stamp.seconds_since(first)).collect()
    }
}

/// All parts except joint states with incomplete messages.
pub(super) fn collect_parts(streams: &[Stream]) -> Vec<Part<'_>> {
    let mut found = Vec::new();
    for (stream, held) in streams.iter().enumerate() {
        let is_used = matches!(
            held.role,
            Role::Joints
                | Role::Pose
                | Role::Candidate { .. }
                | Role::Unassigned
                | Role::Tf
                | Role::Imu
        );
        let Some(columns) = held.columns.as_ref().filter(|_| is_used) else { continue };
        let is_table = held.is_from_table || held.read_as.is_some();
        if let Columns::Joints(joints) = columns
            && joints.joints.iter().any(|joint| joint.position.iter().any(|q| !q.is_finite()))
        {
            continue;
        }
        for (piece, times) in columns.times().into_iter().enumerate() {
            let Some(values) = PartValues::of(columns, piece) else { continue };
            let frame = match columns {
                Columns::Transforms(poses) => Some(strip_slash(&poses[piece].child_frame_id)),
                _ => None,
            };
            found.push(Part { stream, piece, frame, is_table, times, values });
        }
    }
    found
}
