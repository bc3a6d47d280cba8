//! Parts of a file, each read by one thread into columns of its own, which are joined in the order of the
//! file.
//!
//! A thread knows the channels that were known when it was given its part. What it cannot do alone, because
//! it depends on what stands before its part, it leaves to the reader.

use super::intake::{ChannelId, ChannelOf};
use super::topic::{Blank, Message, Taken};

/// Reads the records of a part.
pub(super) trait Records: Send + Sync {
    /// What the `records` of the part at byte `offset` of the file hold; `None` where they must be read in
    /// the order of the file.
    fn part(&self, records: &[u8], offset: usize) -> Option<Part>;
}

/// The channels that were known at some time.
pub(super) struct Known {
    topics: Vec<Blank>,
    channels: Vec<ChannelOf>,
    /// The number of the file.
    file: usize,
}

impl Known {
    pub(super) fn new(topics: Vec<Blank>, channels: Vec<ChannelOf>, file: usize) -> Self {
        Self { topics, channels, file }
    }

    /// A part of which nothing is read yet.
    pub(super) fn part(&self) -> PartReader<'_> {
        PartReader { known: self, places: vec![None; self.topics.len()], part: Part::default() }
    }
}

/// What one thread read of a part: of each topic in it the rows.
#[derive(Default)]
pub(super) struct Part {
    pub(super) topics: Vec<(usize, Taken)>,
    /// How often a definition had become another, of those by which it was read.
    pub(super) changes: u64,
}

/// A part while it is read.
pub(super) struct PartReader<'a> {
    known: &'a Known,
    /// Where each topic is among those of the part.
    places: Vec<Option<usize>>,
    part: Part,
}

impl PartReader<'_> {
    /// Counts a message, and appends its rows where the channel has columns; `None` where that must be
    /// done in the order of the file.
    pub(super) fn message(&mut self, channel: ChannelId, message: &Message<'_>) -> Option<()> {
        let ChannelOf { topic, place } = *self.known.channels.get(channel.0)?;
        let topics = &mut self.part.topics;
        let at = *self.places[topic].get_or_insert_with(|| {
            topics.push((topic, self.known.topics[topic].taken()));
            topics.len() - 1
        });
        let taken = &mut topics[at].1;
        // What messages may unpack to is counted over the file, and so are those that are repeated.
        if message.latched || taken.channels[place].is_packed(message.data) {
            return None;
        }
        taken.message(place, message, self.known.file);
        Some(())
    }

    /// What was read, by definitions that had changed so often.
    pub(super) fn done(self, changes: u64) -> Part {
        Part { changes, ..self.part }
    }
}
