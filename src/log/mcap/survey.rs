//! What of a file must be there to read it, when only parts of it are.
//!
//! The summary at the end says where the chunks are, and the index behind each chunk which messages
//! are in it. What the reader looks at is found by walking as it walks; where the walk comes to a
//! byte that is not there, that is asked for, and the walk is made anew. A file whose records do not
//! stand as its indexes say is asked for whole, so that the reader meets damage as in any other file.

#[cfg(test)]
mod tests;

use std::ops::Range;

use mcap::MAGIC;
use mcap::records::op;

use super::record::{self, FRAME_HEADER, Frame};
use super::{Reader, Summary};
use crate::ReadOptions;
use crate::ahead;
use crate::intake::Intake;
use crate::losses::Losses;
use crate::ranges::Present;
use crate::unpack::Compression;

/// What of a file is missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Survey {
    /// Nothing that its reading looks at.
    Nothing,
    /// At least these ranges.
    Parts(Vec<Range<usize>>),
    /// All of it that is not there: it has no index, or is not what the index says.
    Rest,
}

/// What is missing of the file `bytes`, of which only `present` is there.
pub(crate) fn survey(bytes: &[u8], present: &Present) -> Survey {
    let options = ReadOptions::default();
    let mut losses = Losses::of("".as_ref());
    let mut intake = Intake::default();
    ahead::with(|ahead| {
        Reader::new(bytes, present, &options, &mut losses, &mut intake, ahead).survey()
    })
}

/// Why a walk does not go on: the file must be there whole.
struct Unlike;

impl<'a> Reader<'a, '_, '_> {
    fn survey(&mut self) -> Survey {
        let asked = self.missing_summary();
        let asked =
            asked.and_then(|missing| if missing.is_empty() { self.missing() } else { Ok(missing) });
        match asked {
            Ok(missing) if missing.is_empty() => Survey::Nothing,
            Ok(missing) => Survey::Parts(missing),
            Err(Unlike) => Survey::Rest,
        }
    }

    /// What is missing of footer and summary.
    fn missing_summary(&self) -> Result<Vec<Range<usize>>, Unlike> {
        let size = self.bytes.len();
        let footer = size.checked_sub(MAGIC.len() + record::Footer::SIZE).ok_or(Unlike)?;
        let end = footer..size;
        if !self.present.holds(&end) {
            return Ok(vec![end]);
        }
        let start = self.summary_start().filter(|start| (MAGIC.len()..footer).contains(start));
        let summary = start.ok_or(Unlike)?..size;
        Ok(if self.present.holds(&summary) { Vec::new() } else { vec![summary] })
    }

    /// Where the footer says that the summary begins, if there is a footer.
    fn summary_start(&self) -> Option<usize> {
        let content = self.bytes.strip_suffix(MAGIC)?;
        let frame = record::frame(content, content.len() - record::Footer::SIZE).ok()?;
        let footer = (frame.opcode == op::FOOTER).then(|| record::Footer::parse(frame.body));
        usize::try_from(footer??.summary_start).ok()
    }

    /// What is missing before the summary, which is there.
    fn missing(&mut self) -> Result<Vec<Range<usize>>, Unlike> {
        let start = self.summary_start().ok_or(Unlike)?;
        let Summary::Closed { messages: recorded } = self.summary() else { return Err(Unlike) };
        if !self.losses.is_empty() {
            return Err(Unlike);
        }
        let outside = self.outside_of_chunks(start)?;
        let missing = self.absent(outside);
        if !missing.is_empty() {
            return Ok(missing);
        }
        let (missing, messages) = self.missing_in_chunks()?;
        match recorded {
            Some(recorded) if recorded != messages => Err(Unlike),
            _ => Ok(missing),
        }
    }

    /// All but what the chunks before the summary at `end` hold, by the summary's index of them.
    fn outside_of_chunks(&self, end: usize) -> Result<Vec<Range<usize>>, Unlike> {
        let records = record::frames(self.bytes, end).map_while(Result::ok);
        let indexes = records.filter(|frame| frame.opcode == op::CHUNK_INDEX);
        let chunks: Option<Vec<Range<usize>>> =
            indexes.map(|frame| record::chunk_place(frame.body)).collect();
        let mut chunks = chunks.filter(|chunks| !chunks.is_empty()).ok_or(Unlike)?;
        chunks.sort_by_key(|chunk| chunk.start);
        let mut outside = Vec::with_capacity(chunks.len() + 1);
        let mut at = 0;
        for chunk in chunks {
            if chunk.start < at || chunk.end > end {
                return Err(Unlike);
            }
            outside.push(at..chunk.end.min(chunk.start + record::CHUNK_HEAD));
            at = chunk.end;
        }
        outside.push(at..end);
        Ok(outside)
    }

    /// What is missing of the chunks that are of use, and how many messages there are by the indexes.
    fn missing_in_chunks(&mut self) -> Result<(Vec<Range<usize>>, u64), Unlike> {
        let (mut missing, mut messages) = (Vec::new(), 0);
        let mut offset = MAGIC.len();
        loop {
            let frame = self.frame_there(offset)?;
            match frame.opcode {
                op::DATA_END | op::FOOTER => return Ok((missing, messages)),
                op::CHUNK => {
                    let part = self.missing_in_chunk(&frame)?;
                    missing.extend(self.absent(part));
                    messages += self.indexes_behind(&frame).map(|index| index.count()).sum::<u64>();
                }
                _ if !self.present.holds(&(offset..frame.end())) => return Err(Unlike),
                op::MESSAGE => messages += 1,
                _ => self.definition(&frame).ok_or(Unlike)?,
            }
            offset = frame.end();
        }
    }

    /// The record at `offset`, if its length is there.
    fn frame_there(&self, offset: usize) -> Result<Frame<'a>, Unlike> {
        if !self.present.holds(&(offset..offset + FRAME_HEADER)) {
            return Err(Unlike);
        }
        record::frame(self.bytes, offset).map_err(|_| Unlike)
    }

    /// What the reader looks at in the chunk `frame`.
    fn missing_in_chunk(&self, frame: &Frame<'a>) -> Result<Vec<Range<usize>>, Unlike> {
        let head = frame.offset..frame.end().min(frame.offset + record::CHUNK_HEAD);
        if !self.present.holds(&head) {
            return Err(Unlike);
        }
        let chunk = record::Chunk::parse(frame.body).filter(record::Chunk::is_whole);
        let packed = chunk.and_then(|chunk| chunk.packed()).ok_or(Unlike)?;
        self.indexes_are_there(frame)?;
        let data = self.place(packed.data);
        let only_counted = self.is_ignored_by_index(frame);
        if only_counted || self.present.holds(&data) {
            return Ok(Vec::new());
        }
        if packed.compression != Compression::None || packed.data.len() as u64 != packed.size {
            return Ok(vec![data]);
        }
        let Some(messages) = self.messages_of(frame, packed.data.len()) else {
            return Ok(vec![data]);
        };
        let in_file = |part: &Range<usize>| data.start + part.start..data.start + part.end;
        let parts: Vec<Range<usize>> = messages.iter().map(in_file).collect();
        if messages.iter().map(Range::len).sum::<usize>() > packed.data.len() / 2 {
            return Ok(vec![data]);
        }
        if !self.absent(parts.clone()).is_empty() {
            return Ok(parts);
        }
        Ok(match self.look_through(packed.data) {
            // What the reader would read whole, and check, it gets whole.
            Ok(ignored) if ignored > packed.data.len() / 2 => Vec::new(),
            Ok(_) => vec![data],
            // A record that no index names: all up to the next that one does.
            Err(Some(missing)) => {
                let next = parts.iter().map(|part| part.start).find(|next| *next > missing.start);
                let up_to_next = missing.start..missing.end.max(next.unwrap_or(data.end));
                vec![up_to_next]
            }
            Err(None) => vec![data],
        })
    }

    fn indexes_are_there(&self, chunk: &Frame<'a>) -> Result<(), Unlike> {
        let mut offset = chunk.end();
        loop {
            let frame = self.frame_there(offset)?;
            if frame.opcode != op::MESSAGE_INDEX {
                return Ok(());
            }
            let is_there = self.present.holds(&(offset..frame.end()));
            if !is_there || record::MessageIndex::parse(frame.body).is_none() {
                return Err(Unlike);
            }
            offset = frame.end();
        }
    }

    /// What is looked at of the messages of a chunk with `length` bytes of records, as the indexes
    /// behind it tell: all of those with a use, and the head of the others. `None` where a channel is
    /// not known, or an index points out of the chunk.
    fn messages_of(&self, chunk: &Frame<'a>, length: usize) -> Option<Vec<Range<usize>>> {
        let mut starts = Vec::new();
        for index in self.indexes_behind(chunk) {
            let is_ignored = self.intake.ignores(self.definitions.channel_of(index.channel_id)?);
            for offset in index.offsets() {
                let offset = usize::try_from(offset).ok().filter(|offset| *offset < length)?;
                starts.push((offset, is_ignored));
            }
        }
        starts.sort_unstable();
        // What stands before the first is schemas and channels.
        let before = 0..starts.first()?.0;
        let mut parts = vec![before];
        for (number, &(start, is_ignored)) in starts.iter().enumerate() {
            let next = starts.get(number + 1).map_or(length, |next| next.0);
            let head = next.min(start + record::MESSAGE_HEAD);
            parts.push(start..if is_ignored { head } else { next });
        }
        Some(parts)
    }

    /// What of `ranges` is not there.
    fn absent(&self, mut ranges: Vec<Range<usize>>) -> Vec<Range<usize>> {
        ranges.retain(|range| !self.present.holds(range));
        ranges
    }
}
