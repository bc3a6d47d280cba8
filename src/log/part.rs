//! Parts of a file, each read by one thread into separate columns and joined in file order. Content that
//! depends on earlier parts is processed by the main reader.

use super::intake::{ChannelId, ChannelLocation};
use super::topic::{Message, TopicContent, TopicTemplate};

pub(super) trait PartParser: Send + Sync {
    /// Parses `records` at byte `offset` of the file. `None` if they must be read in file order.
    fn part(&self, records: &[u8], offset: usize) -> Option<PartContent>;
}

pub(super) struct ChannelSnapshot {
    pub(super) topics: Vec<TopicTemplate>,
    pub(super) channels: Vec<ChannelLocation>,
    /// Number of the file.
    pub(super) file: usize,
}

impl ChannelSnapshot {
    pub(super) fn part(&self) -> PartReader<'_> {
        PartReader {
            known: self,
            places: vec![None; self.topics.len()],
            part: PartContent::default(),
        }
    }
}

#[derive(Default)]
pub(super) struct PartContent {
    pub(super) topics: Vec<(usize, TopicContent)>,
    pub(super) changes: u64,
}

pub(super) struct PartReader<'a> {
    known: &'a ChannelSnapshot,
    places: Vec<Option<usize>>,
    part: PartContent,
}

impl PartReader<'_> {
    /// Like `Intake::message`. `None` if the message must be read in file order.
    pub(super) fn message(&mut self, channel: ChannelId, message: &Message<'_>) -> Option<()> {
        let ChannelLocation { topic, place } = *self.known.channels.get(channel.0)?;
        let topics = &mut self.part.topics;
        let at = *self.places[topic].get_or_insert_with(|| {
            topics.push((topic, self.known.topics[topic].new_content()));
            topics.len() - 1
        });
        let taken = &mut topics[at].1;
        // Decompression allowance and latched messages are tracked over the whole file.
        if message.latched || taken.channels[place].is_packed(message.data) {
            return None;
        }
        taken.message(place, message, self.known.file);
        Some(())
    }

    pub(super) fn finish(self, changes: u64) -> PartContent {
        PartContent { changes, ..self.part }
    }
}
