//! Determines which ranges of a partially fetched file are needed.
//!
//! The survey walks the file like the reader, requests missing ranges, and restarts after they are fetched.
//! A file that does not match its indexes is requested completely.

#[cfg(test)]
mod tests;

use std::ops::Range;

use mcap::MAGIC;
use mcap::records::op;

use super::record::{self, FRAME_HEADER, Frame};
use super::{Reader, Summary};
use crate::ReadOptions;
use crate::chunk_pool;
use crate::intake::Intake;
use crate::losses::Losses;
use crate::ranges::Present;
use crate::unpack::Compression;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Survey {
    Nothing,
    Parts(Vec<Range<usize>>),
    Rest,
}

/// Missing ranges of the file `bytes`, given those in `present`.
pub(crate) fn survey(bytes: &[u8], present: &Present) -> Survey {
    let options = ReadOptions::default();
    let mut losses = Losses::new("".as_ref());
    let mut intake = Intake::default();
    chunk_pool::with_pool(|ahead| {
        Reader::new(bytes, present, &options, &mut losses, &mut intake, ahead).survey()
    })
}

struct IndexMismatch;

impl<'a> Reader<'a, '_, '_> {
    fn survey(&mut self) -> Survey {
        let asked = self.missing_summary();
        let asked =
            asked.and_then(|missing| if missing.is_empty() { self.missing() } else { Ok(missing) });
        match asked {
            Ok(missing) if missing.is_empty() => Survey::Nothing,
            Ok(missing) => Survey::Parts(missing),
            Err(IndexMismatch) => Survey::Rest,
        }
    }

    fn missing_summary(&self) -> Result<Vec<Range<usize>>, IndexMismatch> {
        let size = self.bytes.len();
        let footer = size.checked_sub(MAGIC.len() + record::Footer::SIZE).ok_or(IndexMismatch)?;
        let end = footer..size;
        if !self.present.contains(&end) {
            return Ok(vec![end]);
        }
        let start = self.summary_start().filter(|start| (MAGIC.len()..footer).contains(start));
        let summary = start.ok_or(IndexMismatch)?..size;
        Ok(if self.present.contains(&summary) { Vec::new() } else { vec![summary] })
    }

    fn summary_start(&self) -> Option<usize> {
        let content = self.bytes.strip_suffix(MAGIC)?;
        let frame = record::frame(content, content.len() - record::Footer::SIZE).ok()?;
        let footer = (frame.opcode == op::FOOTER).then(|| record::Footer::parse(frame.body));
        usize::try_from(footer??.summary_start).ok()
    }

    fn missing(&mut self) -> Result<Vec<Range<usize>>, IndexMismatch> {
        let start = self.summary_start().ok_or(IndexMismatch)?;
        let Summary::Closed { messages: recorded } = self.summary() else {
            return Err(IndexMismatch);
        };
        if !self.losses.is_empty() {
            return Err(IndexMismatch);
        }
        let outside = self.outside_of_chunks(start)?;
        let missing = self.missing_of(outside);
        if !missing.is_empty() {
            return Ok(missing);
        }
        let (missing, messages) = self.missing_in_chunks()?;
        match recorded {
            Some(recorded) if recorded != messages => Err(IndexMismatch),
            _ => Ok(missing),
        }
    }

    fn outside_of_chunks(&self, end: usize) -> Result<Vec<Range<usize>>, IndexMismatch> {
        let records = record::frames(self.bytes, end).map_while(Result::ok);
        let indexes = records.filter(|frame| frame.opcode == op::CHUNK_INDEX);
        let chunks: Option<Vec<Range<usize>>> =
            indexes.map(|frame| record::chunk_place(frame.body)).collect();
        let mut chunks = chunks.filter(|chunks| !chunks.is_empty()).ok_or(IndexMismatch)?;
        chunks.sort_by_key(|chunk| chunk.start);
        let mut outside = Vec::with_capacity(chunks.len() + 1);
        let mut at = 0;
        for chunk in chunks {
            if chunk.start < at || chunk.end > end {
                return Err(IndexMismatch);
            }
            outside.push(at..chunk.end.min(chunk.start + record::CHUNK_HEAD));
            at = chunk.end;
        }
        outside.push(at..end);
        Ok(outside)
    }

    /// Also returns the number of messages in the indexes.
    fn missing_in_chunks(&mut self) -> Result<(Vec<Range<usize>>, u64), IndexMismatch> {
        let (mut missing, mut messages) = (Vec::new(), 0);
        let mut offset = MAGIC.len();
        loop {
            let frame = self.present_frame(offset)?;
            match frame.opcode {
                op::DATA_END | op::FOOTER => return Ok((missing, messages)),
                op::CHUNK => {
                    let part = self.missing_in_chunk(&frame)?;
                    missing.extend(self.missing_of(part));
                    messages += self.indexes_after(&frame).map(|index| index.count()).sum::<u64>();
                }
                _ if !self.present.contains(&(offset..frame.end())) => return Err(IndexMismatch),
                op::MESSAGE => messages += 1,
                _ => self.definition(&frame).ok_or(IndexMismatch)?,
            }
            offset = frame.end();
        }
    }

    fn present_frame(&self, offset: usize) -> Result<Frame<'a>, IndexMismatch> {
        if !self.present.contains(&(offset..offset + FRAME_HEADER)) {
            return Err(IndexMismatch);
        }
        record::frame(self.bytes, offset).map_err(|_| IndexMismatch)
    }

    fn missing_in_chunk(&self, frame: &Frame<'a>) -> Result<Vec<Range<usize>>, IndexMismatch> {
        let head = frame.offset..frame.end().min(frame.offset + record::CHUNK_HEAD);
        if !self.present.contains(&head) {
            return Err(IndexMismatch);
        }
        let chunk = record::Chunk::parse(frame.body).filter(record::Chunk::is_whole);
        let packed = chunk.and_then(|chunk| chunk.packed()).ok_or(IndexMismatch)?;
        self.indexes_are_there(frame)?;
        let data = self.place(packed.data);
        let only_counted = self.is_ignored_by_index(frame);
        if only_counted || self.present.contains(&data) {
            return Ok(Vec::new());
        }
        if packed.compression != Compression::None || packed.data.len() as u64 != packed.size {
            return Ok(vec![data]);
        }
        let Some(messages) = self.needed_parts(frame, packed.data.len()) else {
            return Ok(vec![data]);
        };
        let in_file = |part: &Range<usize>| data.start + part.start..data.start + part.end;
        let parts: Vec<Range<usize>> = messages.iter().map(in_file).collect();
        if messages.iter().map(Range::len).sum::<usize>() > packed.data.len() / 2 {
            return Ok(vec![data]);
        }
        if !self.missing_of(parts.clone()).is_empty() {
            return Ok(parts);
        }
        Ok(match self.check_parts(packed.data) {
            // A chunk that the reader verifies completely is fetched completely.
            Ok(ignored) if ignored > packed.data.len() / 2 => Vec::new(),
            Ok(_) => vec![data],
            // No index lists this record: requests everything up to the next listed one.
            Err(Some(missing)) => {
                let next = parts.iter().map(|part| part.start).find(|next| *next > missing.start);
                let up_to_next = missing.start..missing.end.max(next.unwrap_or(data.end));
                vec![up_to_next]
            }
            Err(None) => vec![data],
        })
    }

    fn indexes_are_there(&self, chunk: &Frame<'a>) -> Result<(), IndexMismatch> {
        let mut offset = chunk.end();
        loop {
            let frame = self.present_frame(offset)?;
            if frame.opcode != op::MESSAGE_INDEX {
                return Ok(());
            }
            let is_there = self.present.contains(&(offset..frame.end()));
            if !is_there || record::MessageIndex::parse(frame.body).is_none() {
                return Err(IndexMismatch);
            }
            offset = frame.end();
        }
    }

    fn missing_of(&self, mut ranges: Vec<Range<usize>>) -> Vec<Range<usize>> {
        ranges.retain(|range| !self.present.contains(range));
        ranges
    }
}
