//! The scratch row between wire formats and columns.

use std::cell::Cell;

use super::steps::Shape;

/// Index into [`Row::texts`]: the header's frame.
pub(super) const FRAME: usize = 0;
/// Index into [`Row::texts`]: the child frame.
pub(super) const CHILD: usize = 1;
/// Index into [`Row::texts`]: the text of a type that is only a text.
pub(super) const BODY: usize = 0;

/// Index into [`Row::numbers`]: four numbers x, y, z, w.
pub(super) const QUATERNION: usize = 0;
/// Index into [`Row::numbers`]: three numbers of a pose.
pub(super) const POSITION: usize = 4;
/// Index into [`Row::numbers`]: three numbers of an IMU reading.
pub(super) const GYRO: usize = 4;
/// Index into [`Row::numbers`]: three numbers of an IMU reading.
pub(super) const ACCEL: usize = 7;

/// Index into [`Row::lists`]: positions, a bare array, or a covariance.
pub(super) const VALUES: usize = 0;
/// Index into [`Row::lists`]: velocities.
pub(super) const VELOCITIES: usize = 1;
/// Index into [`Row::lists`]: positions that the joints shall have.
pub(super) const REFERENCE: usize = 2;
/// Index into [`Row::lists`]: velocities that the joints shall have.
pub(super) const REFERENCE_VELOCITIES: usize = 3;
/// Index into [`Row::lists`]: the matrix of a pose.
pub(super) const MATRIX: usize = 2;

/// Most numbers or names in one list; longer lists are left empty, or cut, as of no arm.
pub(super) const MAX_LIST: usize = 1 << 16;

/// What a field of a message fills.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Slot {
    /// The time at which the content was true.
    Stamp,
    /// One of [`Row::texts`].
    Text(usize),
    /// One of [`Row::numbers`].
    Number(usize),
    /// [`Row::names`].
    Names,
    /// One of [`Row::lists`].
    List(usize),
}

impl Slot {
    /// What a schema must declare for this slot.
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

/// The times of a message, in nanoseconds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct RowTimes {
    /// When the recorder received it.
    pub(crate) log: i64,
    /// When the sender published it.
    pub(crate) publish: i64,
    /// The number that its sender, or the recorder, gave it; 0 where none did.
    pub(crate) sequence: u32,
}

/// The fields of one row, as the wire had them.
///
/// One `Row` serves all messages of a channel: its buffers are cleared and filled again, so that
/// decoding allocates only while they grow. A plan fills every slot of its recipe for every row;
/// the others keep their defaults.
#[derive(Debug, Default)]
pub(crate) struct Row {
    pub(super) seconds: i64,
    pub(super) nanoseconds: i64,
    pub(super) numbers: [f64; 10],
    pub(super) texts: [String; 2],
    pub(super) names: Names,
    pub(super) lists: [Vec<f64>; 4],
    /// Which element of the message's array of rows it is.
    pub(super) index: usize,
    /// In which group of poses the row is.
    pub(super) group: Cell<Group>,
    /// Where the values of the message before lay, in an encoding that is walked.
    pub(super) shape: Option<Box<Shape>>,
}

/// In which group of poses a row is, where all messages of one shape have such a row.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) enum Group {
    /// Told by its texts, and of no interest to others.
    #[default]
    ByTexts,
    /// Told by its texts, and wanted here.
    Wanted,
    /// This one. The texts may be those of another row.
    Known(usize),
}

impl Row {
    /// The stamp in nanoseconds; saturates. 0, as where none was set, where the nanoseconds beside whole
    /// seconds are a second or more: no clock says so.
    pub(super) fn stamp(&self) -> i64 {
        if self.seconds != 0 && !(0..1_000_000_000).contains(&self.nanoseconds) {
            return 0;
        }
        self.seconds.saturating_mul(1_000_000_000).saturating_add(self.nanoseconds)
    }

    /// The `N` numbers from index `first` on.
    pub(super) fn numbers<const N: usize>(&self, first: usize) -> [f64; N] {
        std::array::from_fn(|i| self.numbers[first + i])
    }

    /// Empties a slot, as where a message leaves out what has the default value.
    pub(super) fn reset(&mut self, slot: Slot) {
        match slot {
            Slot::Stamp => (self.seconds, self.nanoseconds) = (0, 0),
            Slot::Text(index) => self.texts[index].clear(),
            Slot::Number(index) => self.numbers[index] = 0.0,
            Slot::Names => self.names.clear(),
            Slot::List(index) => self.lists[index].clear(),
        }
    }

    /// Appends to the list at `index`; one that is too long is emptied by [`Row::cap_list`].
    pub(super) fn push(&mut self, index: usize, value: f64) {
        let list = &mut self.lists[index];
        if list.len() <= MAX_LIST {
            list.push(value);
        }
    }

    /// Empties the list at `index` if it is too long.
    pub(super) fn cap_list(&mut self, index: usize) {
        if self.lists[index].len() > MAX_LIST {
            self.lists[index].clear();
        }
    }

    /// Replaces the text at `index`, which is mostly that of the row before.
    pub(super) fn set_text(&mut self, index: usize, bytes: &[u8]) {
        let text = &mut self.texts[index];
        if text.as_bytes() != bytes {
            text.clear();
            push_lossy(text, bytes);
        }
    }

    /// The frame at `index`, without the leading `/` of ROS 1.
    pub(super) fn frame(&self, index: usize) -> &str {
        let frame = &self.texts[index];
        frame.strip_prefix('/').unwrap_or(frame)
    }
}

/// A list of names in one buffer.
///
/// It is filled anew for every message, mostly with the same names: those of the message before stay
/// in the buffer until another one comes in their place.
#[derive(Clone, Debug, Default)]
pub(super) struct Names {
    text: String,
    ends: Vec<usize>,
    /// How many of those in the buffer are in the list.
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

    /// Where the first `count` names end in the buffer.
    fn end_of(&self, count: usize) -> usize {
        count.checked_sub(1).and_then(|last| self.ends.get(last)).copied().unwrap_or(0)
    }

    fn ends(&self) -> &[usize] {
        &self.ends[..self.len]
    }

    fn bytes(&self) -> &[u8] {
        &self.text.as_bytes()[..self.end_of(self.len)]
    }

    /// The name at `index`.
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

/// Appends `bytes` with a replacement character for what is not UTF-8, without allocating a copy.
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
    fn names_come_back_as_they_went_in() {
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
    fn names_are_those_of_the_last_message_only() {
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
    fn hostile_stamps_saturate() {
        let row = Row { seconds: i64::MAX, nanoseconds: 1, ..Row::default() };
        assert_eq!(row.stamp(), i64::MAX);
    }
}
