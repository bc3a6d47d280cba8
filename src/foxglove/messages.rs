use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::convert::Infallible;
use std::rc::Rc;

use foxglove_data_loader::{ChannelId, Message, MessageIterator, MessageIteratorArgs};

use crate::recording::Recording;

/// Messages of several channels, merged in order of log time. Encodes one at a time.
#[derive(Debug)]
pub struct Messages {
    recording: Rc<Recording>,
    end: u64,
    /// Next log time, id and position of each channel, earliest first.
    next: BinaryHeap<Reverse<(u64, ChannelId, usize)>>,
}

impl Messages {
    /// Messages from the start to the end time, both included.
    pub fn new(recording: Rc<Recording>, args: &MessageIteratorArgs) -> Self {
        let start = args.start_time.unwrap_or(0);
        let end = args.end_time.unwrap_or(u64::MAX);
        let mut messages = Self { recording, end, next: BinaryHeap::new() };
        for id in args.channels.iter().copied().collect::<BTreeSet<ChannelId>>() {
            let channel = messages.recording.channel(id);
            let first = channel.map(|channel| channel.count_while(|log_time| log_time < start));
            messages.push(id, first.unwrap_or_default());
        }
        messages
    }

    fn push(&mut self, id: ChannelId, position: usize) {
        let channel = self.recording.channel(id);
        let log_time = channel.and_then(|channel| channel.log_time(position));
        if let Some(log_time) = log_time.filter(|log_time| *log_time <= self.end) {
            self.next.push(Reverse((log_time, id, position)));
        }
    }
}

impl MessageIterator for Messages {
    type Error = Infallible;

    fn next(&mut self) -> Option<Result<Message, Infallible>> {
        let Reverse((_, id, position)) = self.next.pop()?;
        self.push(id, position + 1);
        self.recording.message(id, position).map(Ok)
    }
}
