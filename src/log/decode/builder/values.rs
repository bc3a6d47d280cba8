//! Appends IMU samples, bare numbers and texts.

use std::ops::Range;

use super::super::row::{self, Row, RowTimes};
use super::super::schema::bounded;
use ground::stream::{ArrayColumns, ImuColumns, TextColumns, Times, is_usable};

const MAX_TEXTS: usize = 64;

const MAX_TEXT_BYTES: usize = 16 << 20;

pub(super) fn append_imu(imu: &mut ImuColumns, row: &Row, times: RowTimes) {
    keep_first(&mut imu.frame_id, row.frame(row::FRAME));
    // REP 145: −1 in the first element means no orientation.
    let has_orientation = row.lists[row::VALUES].first() != Some(&-1.0);
    let q_xyzw = if has_orientation { row.numbers(row::QUATERNION) } else { [0.0; 4] };
    let gyro = row.numbers(row::GYRO);
    let accel = row.numbers(row::ACCEL);
    if !all_usable(&q_xyzw) || !all_usable(&gyro) || !all_usable(&accel) {
        imu.not_finite += 1;
        return;
    }
    imu.has_orientation |= has_orientation;
    push_times(&mut imu.times, row.stamp(), times);
    imu.q_xyzw.push(q_xyzw);
    imu.gyro.push(gyro);
    imu.accel.push(accel);
}

pub(super) fn join_imu(imu: &mut ImuColumns, later: ImuColumns) {
    keep_first(&mut imu.frame_id, &later.frame_id);
    imu.has_orientation |= later.has_orientation;
    imu.not_finite += later.not_finite;
    imu.times.append(&later.times);
    imu.q_xyzw.extend_from(&later.q_xyzw);
    imu.gyro.extend_from(&later.gyro);
    imu.accel.extend_from(&later.accel);
}

#[derive(Clone, Debug)]
pub(in crate::decode) struct Array {
    pub(super) numbers: Numbers,
    pub(super) columns: ArrayColumns,
}

#[derive(Clone, Debug)]
pub(super) enum Numbers {
    /// Index into [`Row::lists`].
    List(usize),
    /// Indices into [`Row::numbers`].
    Fields(Range<usize>),
}

impl Array {
    pub(super) fn new(numbers: Numbers) -> Self {
        Self { numbers, columns: ArrayColumns::default() }
    }

    pub(super) fn append(&mut self, row: &Row, times: RowTimes) {
        let array = &mut self.columns;
        let values = match &self.numbers {
            Numbers::List(index) => row.lists[*index].as_slice(),
            Numbers::Fields(fields) => &row.numbers[fields.clone()],
        };
        if array.width == 0 {
            array.width = values.len();
        }
        if values.is_empty() || values.len() != array.width {
            array.wrong_length += 1;
        } else if !all_usable(values) {
            array.not_finite += 1;
        } else {
            push_times(&mut array.times, row.stamp(), times);
            array.values.extend_from_slice(values);
        }
    }

    /// Requires equal widths.
    pub(super) fn fits(&self, later: &Self) -> bool {
        [0, later.columns.width].contains(&self.columns.width)
    }

    pub(super) fn join(&mut self, later: Self) {
        let (array, later) = (&mut self.columns, later.columns);
        array.width = later.width;
        array.wrong_length += later.wrong_length;
        array.not_finite += later.not_finite;
        array.times.append(&later.times);
        array.values.extend_from_slice(&later.values);
    }
}

pub(super) fn append_text(column: &mut TextColumns, row: &Row, times: RowTimes) {
    let text = &row.texts[row::BODY];
    if has_room(column, text) {
        push_times(&mut column.times, 0, times);
        column.text.push(text.clone());
    }
}

/// Appends only new texts.
pub(super) fn join_texts(column: &mut TextColumns, later: TextColumns) {
    for (row, text) in later.text.into_iter().enumerate() {
        if has_room(column, &text) {
            column.times.append_row(&later.times, row);
            column.text.push(text);
        }
    }
}

fn has_room(column: &TextColumns, text: &String) -> bool {
    let full = column.text.len() == MAX_TEXTS || text.len() > MAX_TEXT_BYTES;
    !full && !column.text.contains(text)
}

/// Returns the row's index.
pub(super) fn push_times(column: &mut Times, stamp: i64, times: RowTimes) -> usize {
    column.push(stamp, times.log, times.publish);
    column.sequence.push(times.sequence);
    column.len() - 1
}

pub(super) fn keep_first(kept: &mut String, text: &str) {
    if kept.is_empty() && !text.is_empty() {
        *kept = bounded(text).into_owned();
    }
}

pub(super) fn all_usable(values: &[f64]) -> bool {
    values.iter().all(|value| is_usable(*value))
}

/// Four NaNs mean the same as zeros: not set.
pub(super) fn quaternion(row: &Row) -> [f64; 4] {
    let q_xyzw = row.numbers::<4>(row::QUATERNION);
    if q_xyzw.iter().all(|part| part.is_nan()) { [0.0; 4] } else { q_xyzw }
}
