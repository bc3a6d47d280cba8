//! Reads partially fetched files without accessing missing ranges.

use std::ops::Range;

use mcap::records::op;

use super::record::{self, Frame};
use super::{ChunkUse, MissingByte, Reader};
use crate::unpack::{Compression, Packed};

impl<'a> Reader<'a, '_, '_> {
    /// Whether `range` is present; stores the first missing byte.
    pub(super) fn is_present(&mut self, range: Range<usize>) -> bool {
        let is_there = self.present.contains(&range);
        if !is_there {
            self.absent.get_or_insert(MissingByte(range.start));
        }
        is_there
    }

    pub(super) fn parts_use(&self, frame: &Frame<'a>, packed: &Packed<'a>) -> ChunkUse {
        let is_open =
            packed.compression == Compression::None && packed.data.len() as u64 == packed.size;
        if self.is_ignored_by_index(frame) {
            ChunkUse::Counts
        } else if is_open && self.check_parts(packed.data).is_ok() {
            ChunkUse::Some
        } else {
            ChunkUse::Absent
        }
    }

    pub(super) fn place(&self, part: &[u8]) -> Range<usize> {
        let start = part.as_ptr().addr() - self.bytes.as_ptr().addr();
        start..start + part.len()
    }

    /// Whether a chunk's indexes name only messages that are counted.
    pub(super) fn is_ignored_by_index(&self, chunk: &Frame<'a>) -> bool {
        let mut indexes = self.indexes_after(chunk).peekable();
        indexes.peek().is_some() && indexes.all(|index| self.ignores(index.channel_id))
    }

    /// Checks that all needed parts of an uncompressed chunk are present. Returns the number of skipped
    /// message bytes, or the first missing range if it can be determined.
    pub(super) fn check_parts(&self, records: &'a [u8]) -> Result<usize, Option<Range<usize>>> {
        let Range { start: base, end } = self.place(records);
        let (mut at, mut ignored) = (0, 0);
        while at < records.len() {
            let head = base + at..end.min(base + at + record::MESSAGE_HEAD);
            if !self.present.contains(&head) {
                return Err(Some(head));
            }
            let frame = record::frame(records, at).map_err(|_| None)?;
            let whole = base + at..base + frame.end();
            let passed_over = match frame.opcode {
                op::MESSAGE => self.skipped_bytes(frame.body).ok_or(None)?,
                _ => 0,
            };
            if passed_over == 0 && !self.present.contains(&whole) {
                return Err(Some(whole));
            }
            // A channel redefined inside the file may be needed.
            if frame.opcode == op::CHANNEL {
                let channel = record::Channel::parse(frame.body).ok_or(None)?;
                if !self.definitions.has_channel(&channel) {
                    return Err(None);
                }
            }
            ignored += passed_over;
            at = frame.end();
        }
        Ok(ignored)
    }

    /// `None` if its channel is unknown.
    fn skipped_bytes(&self, body: &'a [u8]) -> Option<usize> {
        let message = record::Message::parse(body)?;
        let id = self.definitions.channel_of(message.channel_id)?;
        Some(if self.intake.ignores(id) { message.data.len() } else { 0 })
    }
}
