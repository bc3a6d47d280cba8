use super::Reader;
use super::record::{self, Chunk, MessageIndex, Record, op};
use crate::Extent;
use crate::chunk_pool::{self, ChunkResult};
use crate::decode::excerpt;
use crate::unpack::{Compression, UnpackError, Unpacker};

impl<'a> Reader<'a, '_, '_> {
    pub(super) fn unpack_ahead(&mut self, here: usize) {
        let far = here.saturating_add(chunk_pool::MAX_LOOKAHEAD_BYTES);
        while let Some(offset) = self.scanned.filter(|at| *at < far && self.ahead.has_room()) {
            self.scanned = None;
            if offset >= self.bytes.len() {
                return;
            }
            let Ok(record) = record::record(self.bytes, offset) else { return };
            self.scanned = Some(record.end);
            let chunk = match record.op {
                op::CHUNK => Chunk::from_header(record.header, record.data),
                _ => None,
            };
            if let Some(packed) = chunk.and_then(|chunk| chunk.packed())
                && packed.compression != Compression::None
                && !self.is_ignored(&record)
                && self.intake.unpack_budget.admit(&packed).is_ok()
            {
                self.ahead.unpack(offset, packed, None);
            }
        }
    }

    pub(super) fn indexed(
        &self,
        chunk: &Record<'a>,
    ) -> impl Iterator<Item = (u32, MessageIndex<'a>)> + use<'a> {
        let (bytes, mut offset) = (self.bytes, chunk.end);
        std::iter::from_fn(move || {
            let record = (offset < bytes.len()).then(|| record::record(bytes, offset).ok())??;
            offset = record.end;
            (record.op == op::INDEX).then(|| MessageIndex::from_record(&record))?
        })
    }

    /// Whether a chunk's index lists only unused messages.
    pub(super) fn is_ignored(&self, chunk: &Record<'a>) -> bool {
        let is_ignored = |(id, _): (u32, MessageIndex<'_>)| {
            let channel = self.connections.get(&id).and_then(|sender| sender.channel);
            channel.is_some_and(|channel| self.intake.ignores(channel))
        };
        let mut indexed = self.indexed(chunk).peekable();
        let has_index = indexed.peek().is_some();
        !self.options.verify && has_index && indexed.all(is_ignored)
    }

    pub(super) fn count(&mut self, chunk: &Record<'a>) {
        for (id, index) in self.indexed(chunk) {
            let channel = self.connections.get(&id).and_then(|sender| sender.channel);
            if let Some((channel, span)) = channel.zip(index.span()) {
                self.intake.count(channel, index.count(), span);
            }
        }
    }

    /// Returns whether the chunk's length is certain.
    pub(super) fn chunk(
        &mut self,
        record: &Record<'a>,
        unpacker: &mut Unpacker,
        open: &mut Option<Chunk<'a>>,
    ) -> bool {
        self.in_lost_chunk = false;
        self.in_packed = false;
        let Some(chunk) = Chunk::from_header(record.header, record.data) else {
            self.lose_chunk(record.offset, "malformed chunk record".to_owned());
            return false;
        };
        if chunk.size == 0 && chunk.data.is_empty() {
            *open = Some(chunk);
            return false;
        }
        let Some(packed) = chunk.packed() else {
            let found = excerpt(record.header.text("compression").unwrap_or_default());
            let what = format!(
                "chunk has unsupported compression `{found}`, expected `lz4`, `bz2` or `none`"
            );
            self.lose_chunk(record.offset, what);
            return false;
        };
        let compression = packed.compression;
        self.in_packed = compression != Compression::None;
        if compression == Compression::None && chunk.data.len() != chunk.size as usize {
            return self.ambiguous_chunk(record, chunk);
        }
        if compression != Compression::None && self.is_ignored(record) {
            self.count(record);
            return true;
        }
        let mut unpacked = self.ahead.take_result(record.offset).and_then(ChunkResult::unpacked);
        let content = match &mut unpacked {
            Some(unpacked) => unpacked.content(&packed, &mut self.intake.unpack_budget),
            None => unpacker.chunk(&packed, &mut self.intake.unpack_budget),
        };
        let is_sound = match content {
            Ok(records) => {
                let before = self.intake.messages();
                self.chunk_records(records, record.offset);
                if chunk.has_checksum() {
                    self.covered += self.intake.messages() - before;
                }
                true
            }
            Err(error @ UnpackError::Size { .. }) => {
                let before = self.intake.messages();
                let allowance = &mut self.intake.unpack_budget;
                let records = unpacker.cut_chunk(compression, chunk.data, allowance);
                self.chunk_records(records, record.offset);
                let read = self.intake.messages() - before;
                self.misstated_chunk(record.offset, &error, read);
                true
            }
            Err(error) => {
                self.losses.add(record.offset, error.extent(), None, error.to_string());
                self.in_lost_chunk = true;
                false
            }
        };
        if let Some(unpacked) = unpacked {
            self.ahead.recycle(unpacked);
        }
        is_sound
    }

    /// Reads an uncompressed chunk with two different lengths. Returns whether the length of its record is
    /// certain.
    pub(super) fn ambiguous_chunk(&mut self, record: &Record<'a>, chunk: Chunk<'a>) -> bool {
        let goes_on =
            record.end == self.bytes.len() || record::record(self.bytes, record.end).is_ok();
        if !goes_on {
            // The search for the next record finds its records; reading them here would duplicate them.
            self.lose_chunk(record.offset, "chunk has two different lengths".to_owned());
            return false;
        }
        let before = self.intake.messages();
        self.chunk_records(chunk.data, record.offset);
        let (expected, found) = (chunk.size.into(), chunk.data.len() as u64);
        let read = self.intake.messages() - before;
        self.misstated_chunk(record.offset, &UnpackError::Size { expected, found }, read);
        true
    }

    pub(super) fn misstated_chunk(&mut self, offset: usize, error: &UnpackError, read: u64) {
        let (extent, messages) = match error {
            UnpackError::Size { expected, found } if found < expected => (Extent::Messages, None),
            _ => (Extent::Index, Some(0)),
        };
        let what = format!("{error}; {read} of its messages were read");
        self.losses.add(offset, extent, messages, what);
    }

    pub(super) fn chunk_records(&mut self, records: &[u8], place: usize) {
        let (mut offset, mut sound) = (0, 0);
        let mut batch = Vec::new();
        while offset < records.len() {
            match record::record(records, offset) {
                Ok(record) => {
                    self.content(&record, place, &mut batch);
                    sound = record.offset + 1;
                    offset = record.end;
                }
                Err(broken) => {
                    let what = format!("in the chunk, expected a record, found {broken}");
                    self.losses.add(place, Extent::Messages, None, what);
                    let Some(next) = record::find_record(records, sound, None) else { break };
                    (offset, sound) = (next, next);
                }
            }
        }
        self.intake.batch(&mut batch);
    }

    /// Reads a truncated chunk; returns the number of messages.
    pub(super) fn cut_chunk(
        &mut self,
        chunk: &Chunk<'_>,
        data: &[u8],
        place: usize,
        unpacker: &mut Unpacker,
    ) -> u64 {
        let before = self.intake.messages();
        if let Some(compression) = chunk.compression {
            let records = unpacker.cut_chunk(compression, data, &mut self.intake.unpack_budget);
            let (mut offset, mut batch) = (0, Vec::new());
            while let Ok(record) = record::record(records, offset) {
                self.content(&record, place, &mut batch);
                offset = record.end;
                if offset >= records.len() {
                    break;
                }
            }
            self.intake.batch(&mut batch);
        }
        self.intake.messages() - before
    }

    /// Reads the last chunk of an unclosed bag, up to the end of the file.
    pub(super) fn open_chunk(&mut self, chunk: Chunk<'a>, offset: usize, unpacker: &mut Unpacker) {
        let saved = self.cut_chunk(&chunk, &self.bytes[offset..], offset, unpacker);
        self.lose_tail(offset, "within a chunk", saved);
    }

    pub(super) fn lose_chunk(&mut self, offset: usize, what: String) {
        self.losses.add(offset, Extent::Messages, None, what);
        self.in_lost_chunk = true;
    }
}
