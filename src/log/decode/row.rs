//! Intermediate row between wire formats and columns.

use std::cell::Cell;

use super::steps::Shape;

/// Indices into [`Row::texts`].
pub(super) const FRAME: usize = 0;
pub(super) const CHILD: usize = 1;
/// Text of a text-only type.
pub(super) const BODY: usize = 0;

/// Indices into [`Row::numbers`]: quaternion x, y, z, w.
pub(super) const QUATERNION: usize = 0;
/// Position of a pose.
pub(super) const POSITION: usize = 4;
/// Gyro and [`ACCEL`] (specific force) of an IMU.
pub(super) const GYRO: usize = 4;
pub(super) const ACCEL: usize = 7;

/// Indices into [`Row::lists`]: positions, a bare array, or a covariance.
pub(super) const VALUES: usize = 0;
pub(super) const VELOCITIES: usize = 1;
/// Commanded joint positions and velocities.
pub(super) const REFERENCE: usize = 2;
pub(super) const REFERENCE_VELOCITIES: usize = 3;
/// Matrix of a pose.
pub(super) const MATRIX: usize = 2;

/// Longer lists are cleared or truncated; an arm does not have them.
pub(super) const MAX_LIST: usize = 1 << 16;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Slot {
    /// Time of the content.
    Stamp,
    /// Index into [`Row::texts`].
    Text(usize),
    /// Index into [`Row::numbers`].
    Number(usize),
    Names,
    /// Index into [`Row::lists`].
    List(usize),
}

impl Slot {
    pub(super) const fn expected(self) -> &'static str {
        match self {
            Slot::Stamp => "a time",
            Slot::Text(_) => "a string",
            Slot::Number(_) => "a number",
            Slot::Names => "an array of strings",
            Slot::List(_) => "an array of numbers",
        }
    }
}

/// Times in ns.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct RowTimes {
    /// Receive time.
    pub(crate) log: i64,
    /// Publish time.
    pub(crate) publish: i64,
    /// From the sender or recorder; 0 if there is none.
    pub(crate) sequence: u32,
}

/// Fields of one row as read from the wire.
///
/// One `Row` serves all messages of a channel and reuses its buffers. A plan fills every slot of its recipe
/// for every row; the others keep their defaults.
#[derive(Debug, Default)]
pub(crate) struct Row {
    pub(super) seconds: i64,
    pub(super) nanoseconds: i64,
    pub(super) numbers: [f64; 10],
    pub(super) texts: [String; 2],
    pub(super) names: Names,
    pub(super) lists: [Vec<f64>; 4],
    /// Index in the message's array of rows.
    pub(super) index: usize,
    pub(super) group: Cell<Group>,
    /// Positions of the previous message's values, in encodings without an index.
    pub(super) shape: Option<Box<Shape>>,
}

/// Cached if all messages of one shape share it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) enum Group {
    /// Determined by the texts; not requested.
    #[default]
    ByTexts,
    /// Determined by the texts; requested.
    Wanted,
    /// The texts may belong to a different row.
    Known(usize),
}

impl Row {
    /// ns; saturates. 0 (not set) for nanoseconds that no clock produces, unless the seconds are 0.
    pub(super) fn stamp(&self) -> i64 {
        if self.seconds != 0 && !(0..1_000_000_000).contains(&self.nanoseconds) {
            return 0;
        }
        self.seconds.saturating_mul(1_000_000_000).saturating_add(self.nanoseconds)
    }

    pub(super) fn numbers<const N: usize>(&self, first: usize) -> [f64; N] {
        std::array::from_fn(|i| self.numbers[first + i])
    }

    /// Clears a field missing from a message.
    pub(super) fn reset(&mut self, slot: Slot) {
        match slot {
            Slot::Stamp => (self.seconds, self.nanoseconds) = (0, 0),
            Slot::Text(index) => self.texts[index].clear(),
            Slot::Number(index) => self.numbers[index] = 0.0,
            Slot::Names => self.names.clear(),
            Slot::List(index) => self.lists[index].clear(),
        }
    }

    /// [`Row::cap_list`] clears the list if it is too long.
    pub(super) fn push(&mut self, index: usize, value: f64) {
        let list = &mut self.lists[index];
        if list.len() <= MAX_LIST {
            list.push(value);
        }
    }

    pub(super) fn cap_list(&mut self, index: usize) {
        if self.lists[index].len() > MAX_LIST {
            self.lists[index].clear();
        }
    }

    /// The text usually equals the previous one.
    pub(super) fn set_text(&mut self, index: usize, bytes: &[u8]) {
        let text = &mut self.texts[index];
        if text.as_bytes() != bytes {
            text.clear();
            push_lossy(text, bytes);
        }
    }

    /// Without the leading `/` of ROS 1.
    pub(super) fn frame(&self, index: usize) -> &str {
        let frame = &self.texts[index];
        frame.strip_prefix('/').unwrap_or(frame)
    }
}

/// List of names in one buffer.
///
/// Messages usually repeat the names, so the buffer keeps previous names until they are replaced.
#[derive(Clone, Debug, Default)]
pub(super) struct Names {
    text: String,
    ends: Vec<usize>,
    len: usize,
}

impl PartialEq for Names {
    fn eq(&self, other: &Self) -> bool {
        self.ends() == other.ends() && self.bytes() == other.bytes()
    }
}

impl Names {
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(super) fn push(&mut self, bytes: &[u8]) {
        if self.len == MAX_LIST {
            return;
        }
        let start = self.end_of(self.len);
        let known = self.ends.get(self.len).map(|&end| &self.text.as_bytes()[start..end]);
        if known != Some(bytes) {
            self.ends.truncate(self.len);
            self.text.truncate(start);
            push_lossy(&mut self.text, bytes);
            self.ends.push(self.text.len());
        }
        self.len += 1;
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    fn end_of(&self, count: usize) -> usize {
        count.checked_sub(1).and_then(|last| self.ends.get(last)).copied().unwrap_or(0)
    }

    fn ends(&self) -> &[usize] {
        &self.ends[..self.len]
    }

    fn bytes(&self) -> &[u8] {
        &self.text.as_bytes()[..self.end_of(self.len)]
    }

    pub(super) fn get(&self, index: usize) -> Option<&str> {
        Some(&self.text[self.end_of(index)..*self.ends().get(index)?])
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &str> {
        let mut start = 0;
        self.ends().iter().map(move |&end| {
            let name = &self.text[start..end];
            start = end;
            name
        })
    }
}

/// Replaces invalid UTF-8, without a copy.
fn push_lossy(text: &mut String, bytes: &[u8]) {
    if let Ok(valid) = std::str::from_utf8(bytes) {
        text.push_str(valid);
        return;
    }
    for chunk in bytes.utf8_chunks() {
        text.push_str(chunk.valid());
        if !chunk.invalid().is_empty() {
            text.push(char::REPLACEMENT_CHARACTER);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_that_are_not_utf8_are_kept_readable() {
        let mut row = Row::default();
        row.set_text(FRAME, b"/base\xff_link");
        assert_eq!(row.frame(FRAME), "base\u{fffd}_link");
    }

    #[test]
    fn names_are_stored_unchanged() {
        let mut names = Names::default();
        for name in ["elbow", "", "wrist_1"] {
            names.push(name.as_bytes());
        }
        assert_eq!(names.iter().collect::<Vec<_>>(), ["elbow", "", "wrist_1"]);
        assert_eq!(names.len(), 3);
        let each: Vec<_> = (0..4).map(|index| names.get(index)).collect();
        assert_eq!(each, [Some("elbow"), Some(""), Some("wrist_1"), None]);
    }

    #[test]
    fn joint_names_come_from_the_last_message() {
        let of = |names: &mut Names, list: &[&str]| {
            names.clear();
            list.iter().for_each(|name| names.push(name.as_bytes()));
        };
        let mut names = Names::default();
        for list in [&["a", "b", "c"][..], &["a", "bb", "c"], &["a"], &[], &["a", "b", "c"]] {
            of(&mut names, list);
            let mut fresh = Names::default();
            of(&mut fresh, list);
            assert_eq!(names.iter().collect::<Vec<_>>(), list);
            assert_eq!(names, fresh);
            assert_eq!(names.get(list.len()), None);
        }
        of(&mut names, &["a", "b"]);
        let mut other = Names::default();
        of(&mut other, &["ab", ""]);
        assert_ne!(names, other);
    }

    #[test]
    fn out_of_range_stamps_saturate() {
        let row = Row { seconds: i64::MAX, nanoseconds: 1, ..Row::default() };
        assert_eq!(row.stamp(), i64::MAX);
    }
}
