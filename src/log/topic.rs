//! One topic while its messages are read.

use std::collections::HashSet;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use super::decode::{Builder, MAX_FRAMES, Plan, Row, RowTimes};
use super::spans::{Span, join};
use super::unpack::ZSTD_MAGIC;
use super::{TableCell, Topic, Undecodable};
use ground::stream::Columns;
use ground::time::Stamp;

/// Maximum number of distinct messages remembered per latching channel.
const MAX_LATCHED: usize = 1 << 12;

/// One message of a container.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message<'a> {
    /// Receive time of the recorder, ns.
    pub(super) log_time: u64,
    /// Publish time of the sender, ns.
    pub(super) publish_time: u64,
    /// Sequence number from the sender or recorder; 0 if there is none.
    pub(super) sequence: u32,
    /// Encoded message.
    pub(super) data: &'a [u8],
    /// Position of the message, or of its chunk, in the file.
    pub(super) place: MessagePlace,
    /// Whether it is latched: the sender repeats it for late subscribers, and a recorder at the start of
    /// every file.
    pub(super) latched: bool,
}

/// Position of a message in a file.
#[derive(Clone, Copy, Debug)]
pub(super) enum MessagePlace {
    /// Byte offset.
    Byte(u64),
    /// Row of a table.
    Row(i64),
}

impl fmt::Display for MessagePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MessagePlace::Byte(offset) => write!(f, "record at byte {offset} of the file"),
            MessagePlace::Row(row) => write!(f, "row {row} of the table `messages`"),
        }
    }
}

/// Decoder of one channel.
pub(super) struct ChannelDecoder {
    pub(super) decoding: Arc<Decoding>,
    /// Separate per channel, so slots do not contain values of a different type.
    row: Option<Box<Row>>,
    /// Whether messages may be zstd frames: a CDR message never starts like one.
    may_be_packed: bool,
    /// Hashes of the latched messages read so far.
    latched: HashSet<u64>,
}

#[derive(Debug)]
pub(super) enum Decoding {
    /// An audit does not use the type.
    Ignored,
    By(Plan),
    Impossible {
        cause: String,
    },
}

pub(super) struct TopicIntake {
    pub(super) name: String,
    pub(super) type_name: String,
    pub(super) encoding: String,
    pub(super) content: TopicContent,
    /// Rows that were not decoded from messages.
    pub(super) columns: Option<Columns>,
    /// Interpretation of its columns.
    pub(super) read_as: Option<String>,
    /// Table cells it consists of.
    pub(super) cells: Vec<TableCell>,
    /// Its messages in a batch: index of the channel and of the message.
    pub(super) waiting: Vec<(usize, usize)>,
}

/// Content read from a topic's messages, over all files or one chunk.
#[derive(Default)]
pub(super) struct TopicContent {
    pub(super) channels: Vec<ChannelDecoder>,
    pub(super) messages: u64,
    pub(super) builder: Option<Builder>,
    pub(super) undecodable: Option<Undecodable>,
    /// Files that contain it, by number, with the span in each.
    pub(super) spans: Vec<(usize, Span)>,
}

/// Template for reading messages of a topic into separate columns.
pub(super) struct TopicTemplate {
    channels: Vec<(Arc<Decoding>, bool)>,
    builder: Option<Builder>,
}

impl TopicTemplate {
    /// Empty content.
    pub(super) fn new_content(&self) -> TopicContent {
        let channel = |(decoding, may_be_packed): &(Arc<Decoding>, bool)| {
            ChannelDecoder::new(Arc::clone(decoding), *may_be_packed)
        };
        TopicContent {
            channels: self.channels.iter().map(channel).collect(),
            builder: self.builder.as_ref().map(Builder::empty_copy),
            ..TopicContent::default()
        }
    }
}

impl TopicContent {
    /// The same channels and columns without content.
    pub(super) fn template(&self) -> TopicTemplate {
        let channel =
            |channel: &ChannelDecoder| (Arc::clone(&channel.decoding), channel.may_be_packed);
        TopicTemplate {
            channels: self.channels.iter().map(channel).collect(),
            builder: self.builder.as_ref().map(Builder::empty_copy),
        }
    }

    /// Whether [`TopicContent::join`] with `later` is equivalent to reading its messages here.
    pub(super) fn can_join(&self, later: &Self) -> bool {
        match (&self.builder, &later.builder) {
            (Some(own), Some(later)) => own.can_join(later),
            (None, Some(_)) => false,
            (_, None) => true,
        }
    }

    /// Appends the content of `later` messages.
    pub(super) fn join(&mut self, later: Self) {
        self.messages += later.messages;
        if let (Some(builder), Some(later)) = (&mut self.builder, later.builder) {
            builder.join(later);
        }
        if let Some(Undecodable { messages, first }) = later.undecodable {
            self.undecodable.get_or_insert(Undecodable { messages: 0, first }).messages += messages;
        }
        for (file, (first, last)) in later.spans {
            self.record_span(file, first);
            self.record_span(file, last);
        }
    }

    /// Counts a message of file number `file`, and appends its rows if its channel has columns.
    pub(super) fn message(&mut self, place: usize, message: &Message<'_>, file: usize) {
        let times = RowTimes {
            log: saturating_nanos(message.log_time),
            publish: saturating_nanos(message.publish_time),
            sequence: message.sequence,
        };
        self.messages += 1;
        self.record_span(file, Stamp::from_nanos(times.log));
        let channel = &mut self.channels[place];
        if message.latched && channel.is_repeated(message.data) {
            return;
        }
        match (&*channel.decoding, &mut self.builder) {
            (Decoding::By(plan), Some(builder)) => {
                let row = channel.row.get_or_insert_default();
                let mut append = |row: &Row| builder.append(row, times);
                if let Err(error) = plan.decode(message.data, row, &mut append) {
                    record_undecodable(&mut self.undecodable, message.place, &error);
                }
            }
            (Decoding::Impossible { cause }, _) => {
                record_undecodable(&mut self.undecodable, message.place, cause);
            }
            (Decoding::By(_) | Decoding::Ignored, _) => {}
        }
    }

    /// Records that file number `file` contains a message with log time `at`.
    pub(super) fn record_span(&mut self, file: usize, at: Stamp) {
        match self.spans.last_mut() {
            Some((last, (first_at, last_at))) if *last == file => {
                *first_at = at.min(*first_at);
                *last_at = at.max(*last_at);
            }
            _ => self.spans.push((file, (at, at))),
        }
    }
}

impl TopicIntake {
    /// Copy of the content so far, without the means to read more.
    pub(super) fn snapshot(&self) -> Self {
        Self {
            name: self.name.clone(),
            type_name: self.type_name.clone(),
            encoding: self.encoding.clone(),
            content: TopicContent {
                channels: Vec::new(),
                messages: self.content.messages,
                builder: self.content.builder.clone(),
                undecodable: self.content.undecodable.clone(),
                spans: self.content.spans.clone(),
            },
            columns: self.columns.clone(),
            read_as: self.read_as.clone(),
            cells: self.cells.clone(),
            waiting: Vec::new(),
        }
    }

    /// The topic, plus one per additional part of its messages.
    pub(super) fn finish(self) -> Vec<Topic> {
        let TopicContent { messages, builder, mut undecodable, spans, .. } = self.content;
        let span = spans.into_iter().map(|(_, span)| span).reduce(join);
        let refused = builder.as_ref().map_or(0, Builder::rejected_rows);
        if refused > 0 {
            let first = format!("more than {MAX_FRAMES} pairs of frames");
            undecodable.get_or_insert(Undecodable { messages: 0, first }).messages += refused;
        }
        let useless = builder.as_ref().and_then(Builder::unusable_reason);
        let parts = match (self.columns, builder) {
            (Some(columns), _) => vec![("", Some(columns))],
            (None, Some(builder)) => builder.finalize(),
            (None, None) => vec![("", None)],
        };
        let topic = |(part, columns): (&str, _)| Topic {
            name: format!("{}{part}", self.name),
            type_name: self.type_name.clone(),
            encoding: self.encoding.clone(),
            messages,
            columns,
            // Reported once per message.
            undecodable: undecodable.clone().filter(|_| part.is_empty()),
            unusable: useless.clone(),
            read_as: self.read_as.clone(),
            cells: self.cells.clone(),
            span,
        };
        parts.into_iter().map(topic).collect()
    }
}

impl ChannelDecoder {
    pub(super) fn new(decoding: Arc<Decoding>, may_be_packed: bool) -> Self {
        Self { decoding, row: None, may_be_packed, latched: HashSet::new() }
    }

    /// Whether a message is a zstd frame to be decompressed before decoding.
    pub(super) fn is_packed(&self, data: &[u8]) -> bool {
        let is_decoded = matches!(*self.decoding, Decoding::By(_));
        is_decoded && self.may_be_packed && data.starts_with(ZSTD_MAGIC)
    }

    /// Whether a latched message of this channel was read before.
    pub(super) fn is_repeated(&mut self, data: &[u8]) -> bool {
        let mut hasher = DefaultHasher::new();
        data.hash(&mut hasher);
        let hash = hasher.finish();
        self.latched.contains(&hash)
            || (self.latched.len() < MAX_LATCHED && !self.latched.insert(hash))
    }
}

/// Records that the message at `place` cannot be decoded.
pub(super) fn record_undecodable(
    undecodable: &mut Option<Undecodable>,
    place: MessagePlace,
    cause: &dyn fmt::Display,
) {
    let undecodable = undecodable
        .get_or_insert_with(|| Undecodable { messages: 0, first: format!("{cause} ({place})") });
    undecodable.messages += 1;
}

pub(super) fn saturating_nanos(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX)
}
