//! Parts of a file, each read by one thread into separate columns and joined in file order.
//!
//! A thread knows the channels that were known when its part was assigned. Content that depends on earlier
//! parts is left to the main reader.

use super::intake::{ChannelId, ChannelLocation};
use super::topic::{Message, TopicContent, TopicTemplate};

/// Reads the records of a part.
pub(super) trait PartParser: Send + Sync {
    /// Parses the `records` of the part at byte `offset` of the file. `None` if they must be read in file
    /// order.
    fn part(&self, records: &[u8], offset: usize) -> Option<PartContent>;
}

/// Snapshot of the known channels.
pub(super) struct ChannelSnapshot {
    topics: Vec<TopicTemplate>,
    channels: Vec<ChannelLocation>,
    /// Number of the file.
    file: usize,
}

impl ChannelSnapshot {
    pub(super) fn new(
        topics: Vec<TopicTemplate>,
        channels: Vec<ChannelLocation>,
        file: usize,
    ) -> Self {
        Self { topics, channels, file }
    }

    /// Reader for an empty part.
    pub(super) fn part(&self) -> PartReader<'_> {
        PartReader {
            known: self,
            places: vec![None; self.topics.len()],
            part: PartContent::default(),
        }
    }
}

/// Rows read by one thread from a part, by topic.
#[derive(Default)]
pub(super) struct PartContent {
    pub(super) topics: Vec<(usize, TopicContent)>,
    /// Number of redefinitions before the part was read.
    pub(super) changes: u64,
}

/// Part being read.
pub(super) struct PartReader<'a> {
    known: &'a ChannelSnapshot,
    /// Index of each topic in the part.
    places: Vec<Option<usize>>,
    part: PartContent,
}

impl PartReader<'_> {
    /// Counts a message, and appends its rows if the channel has columns. `None` if it must be read in file
    /// order.
    pub(super) fn message(&mut self, channel: ChannelId, message: &Message<'_>) -> Option<()> {
        let ChannelLocation { topic, place } = *self.known.channels.get(channel.0)?;
        let topics = &mut self.part.topics;
        let at = *self.places[topic].get_or_insert_with(|| {
            topics.push((topic, self.known.topics[topic].new_content()));
            topics.len() - 1
        });
        let taken = &mut topics[at].1;
        // The decompression allowance and latched messages are tracked over the whole file.
        if message.latched || taken.channels[place].is_packed(message.data) {
            return None;
        }
        taken.message(place, message, self.known.file);
        Some(())
    }

    /// Finished part, with the number of redefinitions before it.
    pub(super) fn finish(self, changes: u64) -> PartContent {
        PartContent { changes, ..self.part }
    }
}
