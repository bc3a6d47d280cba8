use std::path::{Path, PathBuf};

use super::{Extent, Loss};
use ground::time::Stamp;

/// Maximum number of losses per file; further ones are merged into the last.
const MAX_LOSSES: usize = 100;

#[derive(Debug)]
pub(super) struct Losses {
    file: PathBuf,
    list: Vec<Loss>,
    /// Messages lost by the damage merged with the last entry; `None` if the list is not full.
    before_last: Option<Option<u64>>,
    last: Option<u64>,
}

impl Losses {
    pub(super) fn new(file: &Path) -> Self {
        Self { file: file.to_owned(), list: Vec::new(), before_last: None, last: None }
    }

    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// Adds damage at `offset`, with the number of lost `messages` if known.
    pub(super) fn add(
        &mut self,
        offset: usize,
        extent: Extent,
        messages: Option<u64>,
        what: String,
    ) {
        self.add_at(Some(offset as u64), extent, messages, what);
    }

    pub(super) fn add_unplaced(&mut self, extent: Extent, messages: Option<u64>, what: String) {
        self.add_at(None, extent, messages, what);
    }

    fn add_at(&mut self, offset: Option<u64>, extent: Extent, messages: Option<u64>, what: String) {
        let file = self.file.clone();
        let loss = Loss { file, offset, what, messages, span: None, extent };
        // All skipped content is one entry.
        let unread = loss.extent == Extent::Unread;
        let goes_on = unread && self.list.last().is_some_and(|last| last.extent == loss.extent);
        if self.list.len() < MAX_LOSSES && !goes_on {
            (self.last, self.before_last) = (loss.messages, None);
            self.list.push(loss);
        } else if let Some(last) = self.list.last_mut() {
            const FURTHER_DAMAGE: &str = ", and further damage after it";
            if !last.what.ends_with(FURTHER_DAMAGE) && !goes_on {
                last.what.push_str(FURTHER_DAMAGE);
            }
            last.extent = last.extent.max(loss.extent);
            self.before_last = Some(last.messages);
            last.messages = sum(last.messages, loss.messages);
            self.last = loss.messages;
        }
    }

    pub(super) fn add_to_last(&mut self, messages: u64) {
        self.last = Some(self.last.unwrap_or(0).saturating_add(messages));
        if let Some(last) = self.list.last_mut() {
            last.messages = match self.before_last {
                Some(before) => sum(before, self.last),
                None => self.last,
            };
        }
    }

    /// Sets the time span of the damage at `offset`, ns.
    pub(super) fn set_span(&mut self, offset: usize, first: u64, last: u64) {
        let at = |loss: &&mut Loss| loss.offset == Some(offset as u64);
        let (Ok(first), Ok(last)) = (first.try_into(), last.try_into()) else { return };
        let (first, last) = (Stamp::from_nanos(first), Stamp::from_nanos(last));
        if let Some(loss) = self.list.iter_mut().find(at) {
            loss.span = Some((first, last));
        } else if let Some(unread) = self.list.last_mut()
            && unread.extent == Extent::Unread
            && let Some(span) = &mut unread.span
        {
            *span = (span.0.min(first), span.1.max(last));
        }
    }

    /// Infers unknown losses: `source` reports `recorded` messages, `read` were read.
    pub(super) fn infer_missing(&mut self, source: &str, recorded: u64, read: u64) {
        let known: u64 = self.list.iter().filter_map(|loss| loss.messages).sum();
        let missing = recorded.saturating_sub(read).saturating_sub(known);
        let mut unknown: Vec<&mut Loss> =
            self.list.iter_mut().filter(|loss| loss.messages.is_none()).collect();
        match unknown.as_mut_slice() {
            [] if missing > 0 => {
                let what = format!("{source} counts {recorded} messages, but {read} were found");
                self.add_unplaced(Extent::Messages, Some(missing), what);
            }
            [only] if missing > 0 => only.messages = Some(missing),
            several if missing == 0 => {
                for loss in several {
                    loss.messages = Some(0);
                    loss.extent = Extent::Index;
                }
            }
            _ => {}
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    pub(super) fn finish(mut self) -> Vec<Loss> {
        self.list.sort_by_key(|loss| loss.offset);
        self.list
    }
}

/// Records of unknown kinds, possibly from a newer version of the format.
#[derive(Debug, Default)]
pub(super) struct UnknownRecords {
    count: u64,
    first: u8,
}

impl UnknownRecords {
    pub(super) fn add(&mut self, code: u8) {
        if self.count == 0 {
            self.first = code;
        }
        self.count += 1;
    }

    /// Note about them, if any; `name` is the format's term for the kind.
    pub(super) fn note(&self, name: &str) -> Option<String> {
        let (count, first) = (self.count, self.first);
        (count > 0).then(|| match count {
            1 => format!("skipped a record of unknown kind ({name} {first:#04x})"),
            _ => {
                format!("skipped {count} records of unknown kinds (the first: {name} {first:#04x})")
            }
        })
    }
}

fn sum(a: Option<u64>, b: Option<u64>) -> Option<u64> {
    Some(a?.saturating_add(b?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hostile_file_cannot_fill_the_memory_with_losses() {
        let mut losses = Losses::new(Path::new("x"));
        for offset in 0..1000 {
            losses.add(offset, Extent::Index, Some(1), "broken".to_owned());
        }
        let losses = losses.finish();
        assert_eq!(losses.len(), MAX_LOSSES);
        assert_eq!(losses.iter().filter_map(|loss| loss.messages).sum::<u64>(), 1000);
    }

    #[test]
    fn unknown_counts_remain_unknown_in_a_full_list_of_losses() {
        let full = |first: Option<u64>| {
            let mut losses = Losses::new(Path::new("x"));
            for offset in 0..MAX_LOSSES {
                losses.add(offset, Extent::Messages, first, "broken".to_owned());
            }
            losses
        };
        let with_chunk = |mut losses: Losses| {
            losses.add(1000, Extent::Messages, None, "broken".to_owned());
            losses.add_to_last(3);
            losses.add_to_last(4);
            losses.finish().last().and_then(|loss| loss.messages)
        };
        assert_eq!(with_chunk(full(Some(1))), Some(8));
        assert_eq!(with_chunk(full(None)), None);
    }

    #[test]
    fn the_summary_determines_the_messages_of_a_single_loss() {
        let mut losses = Losses::new(Path::new("x"));
        losses.add(5, Extent::Messages, None, "broken".to_owned());
        losses.add(9, Extent::Messages, Some(2), "broken".to_owned());
        losses.infer_missing("the summary", 20, 11);
        let losses = losses.finish();
        assert_eq!(losses[0].messages, Some(7));
        assert_eq!(losses[1].messages, Some(2));
    }

    #[test]
    fn unread_records_give_one_loss() {
        let mut losses = Losses::new(Path::new("x"));
        losses.add(3, Extent::Messages, None, "broken".to_owned());
        losses.add_to_last(1);
        for chunk in 1..=50 {
            losses.add(10 * chunk, Extent::Unread, None, "too much".to_owned());
            losses.set_span(10 * chunk, 100 * chunk as u64, 100 * chunk as u64 + 7);
            losses.add_to_last(2);
            losses.add_to_last(3);
        }
        let losses = losses.finish();
        let [broken, unread] = losses.as_slice() else { panic!("{losses:?}") };
        assert_eq!((broken.messages, unread.messages), (Some(1), Some(250)));
        assert_eq!((unread.offset, unread.what.as_str()), (Some(10), "too much"));
        let span = [100, 5007].map(Stamp::from_nanos);
        assert_eq!(unread.span, Some(span.into()));
    }

    #[test]
    fn damage_without_lost_messages_is_index_damage() {
        let mut losses = Losses::new(Path::new("x"));
        losses.add(5, Extent::Messages, None, "broken".to_owned());
        losses.infer_missing("the summary", 20, 20);
        let losses = losses.finish();
        assert_eq!((losses[0].messages, losses[0].extent), (Some(0), Extent::Index));
    }
}
