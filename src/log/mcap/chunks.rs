use std::ops::Range;

use mcap::records::op;

use super::record::{self, Frame};
use super::{ChunkUse, MissingByte, Reader};
use crate::Extent;
use crate::chunk_pool::{self, ChunkResult};
use crate::unpack::{Compression, Packed, Unpacker};

impl<'a> Reader<'a, '_, '_> {
    pub(super) fn unpack_ahead(&mut self, here: usize) {
        let far = here.saturating_add(chunk_pool::MAX_LOOKAHEAD_BYTES);
        while let Some(offset) = self.scanned.filter(|at| *at < far && self.ahead.has_room()) {
            let frame = match record::frame(self.bytes, offset) {
                Ok(frame) if !matches!(frame.opcode, op::DATA_END | op::FOOTER) => frame,
                _ => return self.scanned = None,
            };
            self.scanned = Some(frame.end());
            let chunk = match frame.opcode {
                op::CHUNK => record::Chunk::parse(frame.body).filter(record::Chunk::is_whole),
                _ => None,
            };
            let packed = chunk.and_then(|chunk| chunk.packed());
            if let Some(packed) = &packed {
                self.advise(&frame, packed);
            }
            if let Some(packed) = packed
                && self.chunk_use(&frame, &packed) == ChunkUse::All
                && self.intake.unpack_budget.admit(&packed).is_ok()
            {
                let table = self.snapshot();
                self.ahead.unpack(offset, packed, table);
            }
        }
    }

    pub(super) fn chunk_use(&self, frame: &Frame<'a>, packed: &Packed<'a>) -> ChunkUse {
        if !self.present.contains(&self.place(packed.data)) {
            return self.parts_use(frame, packed);
        }
        if self.options.verify {
            return ChunkUse::All;
        }
        if packed.compression == Compression::None {
            let is_whole = packed.data.len() as u64 == packed.size;
            let may_be_passed_over = is_whole && self.has_ignored_channels();
            return if may_be_passed_over { self.records_use(packed.data) } else { ChunkUse::All };
        }
        if self.is_ignored_by_index(frame) { ChunkUse::Counts } else { ChunkUse::All }
    }

    pub(super) fn has_ignored_channels(&self) -> bool {
        let mut known = self.definitions.channels.iter().flatten().filter_map(|channel| channel.id);
        known.any(|id| self.intake.ignores(id))
    }

    /// Whether messages of a known channel are only counted.
    pub(super) fn ignores(&self, channel_id: u16) -> bool {
        self.definitions.channel_of(channel_id).is_some_and(|id| self.intake.ignores(id))
    }

    /// Needed records of an uncompressed chunk; large unused messages can be skipped.
    pub(super) fn records_use(&self, records: &[u8]) -> ChunkUse {
        let mut ignored = 0;
        for frame in record::frames(records, 0) {
            let Ok(frame) = frame else { return ChunkUse::All };
            if frame.opcode == op::MESSAGE
                && let Some(message) = record::Message::parse(frame.body)
                && self.ignores(message.channel_id)
            {
                ignored += message.data.len();
            }
        }
        if ignored > records.len() / 2 { ChunkUse::Some } else { ChunkUse::All }
    }

    pub(super) fn indexes_after(
        &self,
        chunk: &Frame<'a>,
    ) -> impl Iterator<Item = record::MessageIndex<'a>> + use<'a> {
        record::frames(self.bytes, chunk.end())
            .map_while(|frame| frame.ok().filter(|frame| frame.opcode == op::MESSAGE_INDEX))
            .filter_map(|frame| record::MessageIndex::parse(frame.body))
    }

    /// Needed ranges of the messages in a chunk with `length` bytes of records, according to its indexes:
    /// needed messages completely, others only their heads. `None` if a channel is unknown or an index
    /// points outside the chunk.
    pub(super) fn needed_parts(
        &self,
        chunk: &Frame<'a>,
        length: usize,
    ) -> Option<Vec<Range<usize>>> {
        let mut starts = Vec::new();
        for index in self.indexes_after(chunk) {
            let is_ignored = self.intake.ignores(self.definitions.channel_of(index.channel_id)?);
            for offset in index.offsets() {
                let offset = usize::try_from(offset).ok().filter(|offset| *offset < length)?;
                starts.push((offset, is_ignored));
            }
        }
        starts.sort_unstable();
        // Schemas and channels precede the first message.
        let before = 0..starts.first()?.0;
        let mut parts = vec![before];
        for (number, &(start, is_ignored)) in starts.iter().enumerate() {
            let next = starts.get(number + 1).map_or(length, |next| next.0);
            let head = next.min(start + record::MESSAGE_HEAD);
            parts.push(start..if is_ignored { head } else { next });
        }
        Some(parts)
    }

    /// Returns whether all records could be read.
    pub(super) fn chunk(&mut self, frame: &Frame<'a>, unpacker: &mut Unpacker) -> bool {
        let chunk = record::Chunk::parse(frame.body).filter(record::Chunk::is_whole);
        self.has_chunks = true;
        let Some(chunk) = chunk else {
            self.record_lost_chunk(
                frame.offset,
                "chunk is shorter than its declared length".to_owned(),
            );
            return false;
        };
        let Some(packed) = chunk.packed() else {
            let found = chunk.compression;
            let what = format!(
                "chunk has unsupported compression `{found}`, expected `zstd`, `lz4` or none"
            );
            self.record_lost_chunk(frame.offset, what);
            self.losses.set_span(frame.offset, chunk.first_time, chunk.last_time);
            return false;
        };
        let mut unpacked = match self.ahead.take_result(frame.offset) {
            Some(ChunkResult::Unpacked(unpacked)) => Some(unpacked),
            Some(ChunkResult::Read(part)) => {
                if self.join_part(part, &packed) {
                    return true;
                }
                None
            }
            None => None,
        };
        let records = match &mut unpacked {
            Some(unpacked) => unpacked.content(&packed, &mut self.intake.unpack_budget),
            None => match self.chunk_use(frame, &packed) {
                ChunkUse::Counts => {
                    self.count(frame);
                    return true;
                }
                ChunkUse::Some => {
                    self.chunk_records(packed.data, frame.offset);
                    return true;
                }
                ChunkUse::Absent => {
                    self.absent.get_or_insert(MissingByte(frame.offset));
                    return true;
                }
                ChunkUse::All => unpacker.chunk(&packed, &mut self.intake.unpack_budget),
            },
        };
        let is_sound = match records {
            Ok(records) => {
                let before = self.intake.messages();
                self.chunk_records(records, frame.offset);
                if packed.crc != 0 {
                    self.covered += self.intake.messages() - before;
                }
                true
            }
            Err(error) => {
                self.losses.add(frame.offset, error.extent(), None, error.to_string());
                self.in_lost_chunk = true;
                self.losses.set_span(frame.offset, chunk.first_time, chunk.last_time);
                false
            }
        };
        if let Some(unpacked) = unpacked {
            self.ahead.recycle(unpacked);
        }
        is_sound
    }

    pub(super) fn count(&mut self, chunk: &Frame<'a>) {
        for index in self.indexes_after(chunk) {
            if let Some((id, span)) =
                self.definitions.channel_of(index.channel_id).zip(index.span())
            {
                self.intake.count(id, index.count(), span);
            }
        }
    }

    pub(super) fn chunk_records(&mut self, records: &[u8], offset: usize) {
        let mut batch = Vec::new();
        for frame in record::frames(records, 0) {
            match frame {
                Ok(frame) => {
                    if self.content(&frame, offset, &mut batch).is_none() {
                        self.record_lost_record(&frame, offset);
                    }
                }
                Err(broken) => {
                    let what = format!("in the chunk, expected a record, found {broken}");
                    self.losses.add(offset, Extent::Messages, None, what);
                }
            }
        }
        self.intake.batch(&mut batch);
    }

    pub(super) fn record_lost_chunk(&mut self, offset: usize, what: String) {
        self.losses.add(offset, Extent::Messages, None, what);
        self.in_lost_chunk = true;
    }

    pub(super) fn salvage_chunk(&mut self, records: &[u8], offset: usize) {
        let mut batch = Vec::new();
        for frame in record::frames(records, 0).flatten() {
            if self.content(&frame, offset, &mut batch).is_none() {
                self.record_lost_record(&frame, offset);
            }
        }
        self.intake.batch(&mut batch);
    }
}
