//! Parts of a file, each read by one thread into separate columns and joined in file order.
//!
//! A thread knows the channels that were known when its part was assigned. Content that depends on earlier
//! parts is left to the main reader.

use super::intake::{ChannelId, ChannelOf};
use super::topic::{Blank, Message, Taken};

/// Reads the records of a part.
pub(super) trait Records: Send + Sync {
    /// Parses the `records` of the part at byte `offset` of the file. `None` if they must be read in file
    /// order.
    fn part(&self, records: &[u8], offset: usize) -> Option<Part>;
}

/// Snapshot of the known channels.
pub(super) struct Known {
    topics: Vec<Blank>,
    channels: Vec<ChannelOf>,
    /// Number of the file.
    file: usize,
}

impl Known {
    pub(super) fn new(topics: Vec<Blank>, channels: Vec<ChannelOf>, file: usize) -> Self {
        Self { topics, channels, file }
    }

    /// Reader for an empty part.
    pub(super) fn part(&self) -> PartReader<'_> {
        PartReader { known: self, places: vec![None; self.topics.len()], part: Part::default() }
    }
}

/// Rows read by one thread from a part, by topic.
#[derive(Default)]
pub(super) struct Part {
    pub(super) topics: Vec<(usize, Taken)>,
    /// Number of redefinitions before the part was read.
    pub(super) changes: u64,
}

/// Part being read.
pub(super) struct PartReader<'a> {
    known: &'a Known,
    /// Index of each topic in the part.
    places: Vec<Option<usize>>,
    part: Part,
}

impl PartReader<'_> {
    /// Counts a message, and appends its rows if the channel has columns. `None` if it must be read in file
    /// order.
    pub(super) fn message(&mut self, channel: ChannelId, message: &Message<'_>) -> Option<()> {
        let ChannelOf { topic, place } = *self.known.channels.get(channel.0)?;
        let topics = &mut self.part.topics;
        let at = *self.places[topic].get_or_insert_with(|| {
            topics.push((topic, self.known.topics[topic].taken()));
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
    pub(super) fn done(self, changes: u64) -> Part {
        Part { changes, ..self.part }
    }
}
