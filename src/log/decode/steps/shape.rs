//! Cached positions of a message's values, for the next message of the same shape.
//!
//! Lengths and texts determine the positions of later values. They rarely change within a channel: if the
//! next message has the same ones at the same positions, its values are read from the cached positions.

use std::ops::Range;

use super::super::cursor::{Cursor, Short};
use super::super::fault::{Append, DecodeError};
use super::super::row::{Group, MAX_LIST, Row};
use super::super::schema::Primitive;
use super::op::{Count, Op, Step};

/// Arms need fewer; particle clouds more.
const MAX_READS: usize = 512;

/// Maximum offset of a decisive byte.
const MAX_DECISIVE_OFFSET: usize = 1 << 14;

/// Consecutive messages of different shapes before shapes are computed less often.
const MAX_SHAPE_CHANGES: u32 = 8;
/// Then computes the shape for one message in this many.
const RARE_INTERVAL_MESSAGES: u32 = 64;

#[derive(Debug, Default)]
pub(in crate::decode) struct Shape {
    /// Empty if no shape is known.
    reads: Vec<Read>,
    /// Byte ranges that determine the shape.
    decisive: Vec<Range<usize>>,
    /// Last message up to the last decisive byte.
    words: Vec<u64>,
    /// Decisive bits of each word.
    masks: Vec<u64>,
    /// Minimum message length, bytes.
    least: usize,
    /// Consecutive messages of other shapes.
    strange: u32,
    /// Groups of the rows, if a message has several.
    groups: Vec<Group>,
    /// Whether the texts of the rows can be skipped.
    is_told: bool,
}

#[derive(Debug)]
enum Read {
    /// Offsets of seconds and nanoseconds in the message.
    Stamp(usize, usize),
    /// Doubles from this offset in the message.
    Doubles(usize, Range<usize>),
    /// Doubles from offset `at` in the message.
    List { at: usize, count: usize, index: usize },
    /// Value at this offset in the body.
    Value(usize, Op),
    /// Completes the message's only row.
    Only,
    /// Completes a row of several.
    Row(usize),
}

impl Shape {
    pub(super) fn is_of(&self, message: &[u8]) -> bool {
        if self.reads.is_empty() || message.len() < self.least {
            return false;
        }
        let (words, rest) = message.as_chunks();
        let own = self.words.iter().zip(&self.masks);
        // Compare without branches: there are few words, usually equal.
        let differs = own.zip(words).fold(0, |differs, ((own, mask), word)| {
            differs | (own ^ u64::from_le_bytes(*word)) & mask
        });
        let last = self.words.get(words.len()).zip(self.masks.get(words.len()));
        differs == 0 && last.is_none_or(|(own, mask)| (own ^ padded_word(rest)) & mask == 0)
    }

    pub(super) fn forget(&mut self) {
        self.reads.clear();
        self.strange = self.strange.saturating_add(1);
    }

    pub(super) fn is_wanted(&self) -> bool {
        self.strange <= MAX_SHAPE_CHANGES || self.strange.is_multiple_of(RARE_INTERVAL_MESSAGES)
    }

    /// `message` has this shape; `cursor` is at the start of its body.
    pub(super) fn read(
        &mut self,
        message: &[u8],
        cursor: &mut Cursor<'_>,
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'static>> {
        self.strange = 0;
        for read in &self.reads {
            match *read {
                Read::Stamp(seconds, nanoseconds) => {
                    row.seconds = i32::from_le_bytes(bytes_at(message, seconds)).into();
                    row.nanoseconds = u32::from_le_bytes(bytes_at(message, nanoseconds)).into();
                }
                Read::Doubles(at, ref range) => {
                    let values = &message[at..at + 8 * range.len()];
                    for (value, &bytes) in
                        row.numbers[range.clone()].iter_mut().zip(doubles(values))
                    {
                        *value = f64::from_le_bytes(bytes);
                    }
                }
                Read::List { at, count, index } => {
                    let values = &message[at..at + 8 * count];
                    let list = &mut row.lists[index];
                    list.clear();
                    list.extend(doubles(values).iter().map(|&bytes| f64::from_le_bytes(bytes)));
                }
                Read::Value(_, Op::Text(_)) if self.is_told => {}
                Read::Value(at, ref op) => {
                    cursor.seek(at);
                    op.run(cursor, row).map_err(|short| DecodeError::Short { field: "", short })?;
                }
                Read::Only => append(row)?,
                Read::Row(index) => {
                    row.index = index;
                    row.group.set(self.groups[index]);
                    let appended = append(row);
                    self.groups[index] = row.group.take();
                    appended?;
                }
            }
        }
        if !self.is_told {
            self.is_told = self.groups.iter().all(|group| matches!(group, Group::Known(_)));
        }
        Ok(())
    }

    /// Computes the shape of `message`, which was parsed without error. `cursor` is at its first value;
    /// `whole` means that the message itself is the row.
    pub(super) fn take(
        &mut self,
        steps: &[Step],
        mut cursor: Cursor<'_>,
        whole: bool,
        message: &[u8],
    ) {
        self.reads.clear();
        self.decisive.clear();
        self.groups.clear();
        self.is_told = false;
        let before = cursor.before();
        self.decisive.push(0..before);
        let is_little_endian = cursor.is_little_endian();
        let mut walk = Walk { shape: self, before, is_little_endian, several: !whole };
        let walked = walk.over(steps, &mut cursor);
        if whole {
            self.reads.push(Read::Only);
        }
        let end = self.decisive.last().map_or(0, |part| part.end);
        if walked.is_none() || end > MAX_DECISIVE_OFFSET || self.reads.len() > MAX_READS {
            return self.reads.clear();
        }
        self.least = before + cursor.position();
        let mut decides = vec![0; end];
        self.decisive.iter().for_each(|part| decides[part.clone()].fill(u8::MAX));
        self.words = u64_words(&message[..end]);
        self.masks = u64_words(&decides);
    }
}

/// Pads the last word with zeros.
fn u64_words(bytes: &[u8]) -> Vec<u64> {
    let (words, rest) = bytes.as_chunks();
    let last = (!rest.is_empty()).then(|| padded_word(rest));
    words.iter().map(|word| u64::from_le_bytes(*word)).chain(last).collect()
}

/// Pads fewer than eight bytes with zeros.
fn padded_word(bytes: &[u8]) -> u64 {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    u64::from_le_bytes(word)
}

fn doubles(bytes: &[u8]) -> &[[u8; 8]] {
    bytes.as_chunks().0
}

/// The four bytes must exist.
fn bytes_at(message: &[u8], at: usize) -> [u8; 4] {
    message[at..].first_chunk().copied().unwrap_or_default()
}

/// Records positions without reading values.
struct Walk<'s> {
    shape: &'s mut Shape,
    /// Bytes before the body.
    before: usize,
    is_little_endian: bool,
    /// Several rows per message, with different texts.
    several: bool,
}

impl Walk<'_> {
    /// `None` if the shape cannot be cached.
    fn over(&mut self, steps: &[Step], cursor: &mut Cursor<'_>) -> Option<()> {
        for Step { op, .. } in steps {
            match *op {
                Op::Skip { size, count } => {
                    let count = self.count(count, cursor)?;
                    cursor.skip(size, count.into()).ok()?;
                }
                Op::SkipTexts(count) => {
                    for _ in 0..self.count(count, cursor)? {
                        self.decided(cursor, Cursor::text)?;
                    }
                }
                Op::Names(_) if self.several => return None,
                Op::Names(count) => {
                    for _ in 0..self.count(count, cursor)? {
                        self.decided(cursor, Cursor::text)?;
                    }
                }
                Op::Text(index) => {
                    let at = cursor.position();
                    self.decided(cursor, Cursor::text)?;
                    // Otherwise the text is already set.
                    if self.several {
                        self.push(Read::Value(at, Op::Text(index)))?;
                    }
                }
                Op::Seconds(primitive) => self.value(primitive, Op::Seconds(primitive), cursor)?,
                Op::Nanoseconds(primitive) => {
                    self.value(primitive, Op::Nanoseconds(primitive), cursor)?;
                    self.join_stamp();
                }
                Op::Number(primitive, index) => {
                    self.value(primitive, Op::Number(primitive, index), cursor)?;
                }
                Op::Doubles(ref range) => {
                    let at = cursor.aligned(8);
                    let read = match self.is_little_endian {
                        true => Read::Doubles(self.before + at, range.clone()),
                        false => Read::Value(at, Op::Doubles(range.clone())),
                    };
                    self.push(read)?;
                    cursor.skip(8, range.len() as u64).ok()?;
                }
                Op::List(primitive, count, index) => {
                    let count = self.count(count, cursor)?;
                    let at = cursor.aligned(primitive.size());
                    let read = match primitive {
                        Primitive::F64
                            if self.is_little_endian
                                && (1..=MAX_LIST).contains(&(count as usize)) =>
                        {
                            Read::List { at: self.before + at, count: count as usize, index }
                        }
                        _ => Read::Value(at, Op::List(primitive, Count::Fixed(count), index)),
                    };
                    self.push(read)?;
                    cursor.skip(primitive.size(), count.into()).ok()?;
                }
                Op::Repeat { count, ref steps, rows } => {
                    for index in 0..self.count(count, cursor)? {
                        self.over(steps, cursor)?;
                        if rows {
                            self.shape.groups.push(Group::Wanted);
                            self.push(Read::Row(index as usize))?;
                        }
                    }
                }
                Op::Delimited { .. } | Op::Unreadable(_) => return None,
            }
        }
        Some(())
    }

    fn count(&mut self, count: Count, cursor: &mut Cursor<'_>) -> Option<u32> {
        match count {
            Count::Fixed(count) => Some(count),
            Count::Wire => self.decided(cursor, Cursor::length),
        }
    }

    /// Reads a value that determines the position of later ones.
    fn decided<'m, T>(
        &mut self,
        cursor: &mut Cursor<'m>,
        read: impl FnOnce(&mut Cursor<'m>) -> Result<T, Short>,
    ) -> Option<T> {
        let start = self.before + cursor.position();
        let value = read(cursor).ok()?;
        let end = self.before + cursor.position();
        match self.shape.decisive.last_mut() {
            Some(part) if part.end == start => part.end = end,
            _ => self.shape.decisive.push(start..end),
        }
        (end <= MAX_DECISIVE_OFFSET).then_some(value)
    }

    fn value(&mut self, primitive: Primitive, op: Op, cursor: &mut Cursor<'_>) -> Option<()> {
        let size = primitive.size();
        self.push(Read::Value(cursor.aligned(size), op))?;
        cursor.skip(size, 1).ok()
    }

    /// Merges the seconds and nanoseconds of ROS 2 types.
    fn join_stamp(&mut self) {
        use Primitive::{I32, U32};
        if let [.., Read::Value(s, Op::Seconds(I32)), Read::Value(ns, Op::Nanoseconds(U32))] =
            self.shape.reads[..]
            && self.is_little_endian
        {
            self.shape.reads.truncate(self.shape.reads.len() - 2);
            self.shape.reads.push(Read::Stamp(self.before + s, self.before + ns));
        }
    }

    fn push(&mut self, read: Read) -> Option<()> {
        self.shape.reads.push(read);
        (self.shape.reads.len() <= MAX_READS).then_some(())
    }
}
