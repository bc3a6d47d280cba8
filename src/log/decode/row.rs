//! Intermediate row between wire formats and columns.

use std::cell::Cell;

use super::steps::Shape;

/// Index into [`Row::texts`]: frame of the header.
pub(super) const FRAME: usize = 0;
/// Index into [`Row::texts`]: child frame.
pub(super) const CHILD: usize = 1;
/// Index into [`Row::texts`]: text of a text-only type.
pub(super) const BODY: usize = 0;

/// Index into [`Row::numbers`]: quaternion x, y, z, w.
pub(super) const QUATERNION: usize = 0;
/// Index into [`Row::numbers`]: position of a pose, three numbers.
pub(super) const POSITION: usize = 4;
/// Index into [`Row::numbers`]: angular velocity of an IMU, three numbers.
pub(super) const GYRO: usize = 4;
/// Index into [`Row::numbers`]: specific force of an IMU, three numbers.
pub(super) const ACCEL: usize = 7;

/// Index into [`Row::lists`]: positions, a bare array, or a covariance.
pub(super) const VALUES: usize = 0;
/// Index into [`Row::lists`]: velocities.
pub(super) const VELOCITIES: usize = 1;
/// Index into [`Row::lists`]: commanded joint positions.
pub(super) const REFERENCE: usize = 2;
/// Index into [`Row::lists`]: commanded joint velocities.
pub(super) const REFERENCE_VELOCITIES: usize = 3;
/// Index into [`Row::lists`]: matrix of a pose.
pub(super) const MATRIX: usize = 2;

/// Maximum length of a list. Longer lists are cleared or truncated; an arm does not have them.
pub(super) const MAX_LIST: usize = 1 << 16;

/// Destination of a message field.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Slot {
    /// Time at which the content was valid.
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
    /// Type that a schema must declare for this slot.
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

/// Times of a message, ns.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) struct RowTimes {
    /// Receive time of the recorder.
    pub(crate) log: i64,
    /// Publish time of the sender.
    pub(crate) publish: i64,
    /// Sequence number from the sender or recorder; 0 if there is none.
    pub(crate) sequence: u32,
}

/// Fields of one row as read from the wire.
///
/// One `Row` serves all messages of a channel. Its buffers are reused, so decoding allocates only while
/// they grow. A plan fills every slot of its recipe for every row; the others keep their defaults.
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
    /// Pose group of the row.
    pub(super) group: Cell<Group>,
    /// Positions of the previous message's values, in encodings without an index.
    pub(super) shape: Option<Box<Shape>>,
}

/// Pose group of a row, cached if all messages of one shape share it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) enum Group {
    /// Determined by its texts; the group is not requested.
    #[default]
    ByTexts,
    /// Determined by its texts; the group is requested.
    Wanted,
    /// Known group. The texts may belong to a different row.
    Known(usize),
}

impl Row {
    /// Stamp in ns; saturates. 0 (not set) if the seconds are nonzero and the nanoseconds are a second or
    /// more, which no clock produces.
    pub(super) fn stamp(&self) -> i64 {
        if self.seconds != 0 && !(0..1_000_000_000).contains(&self.nanoseconds) {
            return 0;
        }
        self.seconds.saturating_mul(1_000_000_000).saturating_add(self.nanoseconds)
    }

    /// `N` consecutive numbers from index `first`.
    pub(super) fn numbers<const N: usize>(&self, first: usize) -> [f64; N] {
        std::array::from_fn(|i| self.numbers[first + i])
    }

    /// Resets a slot to its default, used for fields missing from a message.
    pub(super) fn reset(&mut self, slot: Slot) {
        match slot {
            Slot::Stamp => (self.seconds, self.nanoseconds) = (0, 0),
            Slot::Text(index) => self.texts[index].clear(),
            Slot::Number(index) => self.numbers[index] = 0.0,
            Slot::Names => self.names.clear(),
            Slot::List(index) => self.lists[index].clear(),
        }
    }

    /// Appends to the list at `index`; [`Row::cap_list`] clears it if it is too long.
    pub(super) fn push(&mut self, index: usize, value: f64) {
        let list = &mut self.lists[index];
        if list.len() <= MAX_LIST {
            list.push(value);
        }
    }

    /// Clears the list at `index` if it is too long.
    pub(super) fn cap_list(&mut self, index: usize) {
        if self.lists[index].len() > MAX_LIST {
            self.lists[index].clear();
        }
    }

    /// Replaces the text at `index`, which usually equals the previous one.
    pub(super) fn set_text(&mut self, index: usize, bytes: &[u8]) {
        let text = &mut self.texts[index];
        if text.as_bytes() != bytes {
            text.clear();
            push_lossy(text, bytes);
        }
    }

    /// Frame at `index`, without the leading `/` of ROS 1.
    pub(super) fn frame(&self, index: usize) -> &str {
        let frame = &self.texts[index];
        frame.strip_prefix('/').unwrap_or(frame)
    }
}

/// List of names in one buffer.
///
/// It is refilled for every message, usually with the same names, so previous names stay in the buffer
/// until they are replaced.
#[derive(Clone, Debug, Default)]
pub(super) struct Names {
    text: String,
    ends: Vec<usize>,
    /// Number of buffered names that are in the list.
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

    /// End of the first `count` names in the buffer.
    fn end_of(&self, count: usize) -> usize {
        count.checked_sub(1).and_then(|last| self.ends.get(last)).copied().unwrap_or(0)
    }

    fn ends(&self) -> &[usize] {
        &self.ends[..self.len]
    }

    fn bytes(&self) -> &[u8] {
        &self.text.as_bytes()[..self.end_of(self.len)]
    }

    /// Name at `index`.
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

/// Appends `bytes` with replacement characters for invalid UTF-8, without a copy.
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
