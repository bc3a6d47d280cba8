//! What of a file is read from the disk: of chunks that are not packed, between large messages that no audit
//! uses, those with a use.

use super::Reader;
use super::record::{self, Frame};
use crate::mapped::{Looks, advise};
use crate::unpack::{Compression, Packed};

impl<'a> Reader<'a, '_, '_> {
    /// Tells the system what of a chunk will be looked at, before anything is, as the indexes behind it say.
    /// Should they be wrong, it is read later.
    pub(super) fn advise(&mut self, chunk: &Frame<'a>, packed: &Packed<'a>) {
        let wanted = match packed.compression {
            Compression::None => self.wanted(chunk, packed.data),
            _ => None,
        };
        match wanted {
            Some(wanted) => {
                if !std::mem::replace(&mut self.is_scattered, true) {
                    advise(&self.bytes[chunk.offset..], Looks::Scattered);
                }
                wanted.into_iter().for_each(|run| advise(run, Looks::Whole));
            }
            None if self.is_scattered => advise(packed.data, Looks::Whole),
            None => {}
        }
    }

    /// The parts of the records of a chunk in which messages with a use are, where those without have most of
    /// its bytes.
    fn wanted(&self, chunk: &Frame<'a>, records: &'a [u8]) -> Option<Vec<&'a [u8]>> {
        if self.options.verify || !self.has_ignored_channels() {
            return None;
        }
        let mut messages: Vec<(usize, bool)> = Vec::new();
        for index in self.indexes_behind(chunk) {
            let id = self.definitions.channel_of(index.channel_id);
            let is_ignored = id.is_some_and(|id| self.intake.ignores(id));
            let offsets = index.offsets().filter_map(|at| usize::try_from(at).ok());
            messages.extend(offsets.map(|at| (at.min(records.len()), is_ignored)));
        }
        messages.sort_unstable();
        let ends = messages.iter().map(|(at, _)| *at).skip(1).chain([records.len()]);
        let parts: Vec<_> = messages.iter().copied().zip(ends).collect();
        let ignored = parts.iter().filter(|((_, is_ignored), _)| *is_ignored);
        let ignored: usize = ignored.map(|((at, _), end)| end - at).sum();
        if 2 * ignored <= records.len() {
            return None;
        }
        let first = messages.first().map_or(0, |(at, _)| *at);
        let mut runs: Vec<_> = std::iter::once(0..first).collect();
        for ((at, is_ignored), end) in parts {
            // Of those that are passed over it is read how long they are.
            let end = if is_ignored { end.min(at + record::MESSAGE_HEAD) } else { end };
            match runs.last_mut().filter(|run| run.end == at) {
                Some(run) => run.end = end,
                None => runs.push(at..end),
            }
        }
        Some(runs.into_iter().map(|run| &records[run]).collect())
    }
}
