use std::collections::HashSet;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use super::decode::{Builder, MAX_FRAMES, Plan, Row, RowTimes};
use super::spans::{Span, join};
use super::unpack::ZSTD_MAGIC;
use super::{Topic, Undecodable};
use ground::time::Stamp;

/// Distinct messages remembered per latching channel.
const MAX_LATCHED: usize = 1 << 12;

#[derive(Clone, Copy, Debug)]
pub(super) struct Message<'a> {
    /// Receive time of the recorder, ns.
    pub(super) log_time: u64,
    /// Publish time of the sender, ns.
    pub(super) publish_time: u64,
    /// From the sender or recorder; 0 if there is none.
    pub(super) sequence: u32,
    pub(super) data: &'a [u8],
    pub(super) place: MessagePlace,
    /// Latched: repeated for late subscribers, and by recorders at the start of every file.
    pub(super) latched: bool,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum MessagePlace {
    Byte(u64),
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

pub(super) struct ChannelDecoder {
    pub(super) decoding: Arc<Decoding>,
    /// Per channel, so slots do not contain values of another type.
    row: Option<Box<Row>>,
    /// Messages may be zstd frames: CDR never starts like one.
    may_be_packed: bool,
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

#[derive(Default)]
pub(super) struct TopicIntake {
    /// With the columns of a table; those of messages are in `content`.
    pub(super) topic: Topic,
    pub(super) content: TopicContent,
    /// Index of channel and message.
    pub(super) waiting: Vec<(usize, usize)>,
}

/// Content of all files or of one chunk.
#[derive(Default)]
pub(super) struct TopicContent {
    pub(super) channels: Vec<ChannelDecoder>,
    pub(super) messages: u64,
    pub(super) builder: Option<Builder>,
    pub(super) undecodable: Option<Undecodable>,
    /// Files that contain it, by number, and its span.
    pub(super) spans: Vec<(usize, Span)>,
}

pub(super) struct TopicTemplate {
    channels: Vec<(Arc<Decoding>, bool)>,
    builder: Option<Builder>,
}

impl TopicTemplate {
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
    pub(super) fn template(&self) -> TopicTemplate {
        let channel =
            |channel: &ChannelDecoder| (Arc::clone(&channel.decoding), channel.may_be_packed);
        TopicTemplate {
            channels: self.channels.iter().map(channel).collect(),
            builder: self.builder.as_ref().map(Builder::empty_copy),
        }
    }

    /// Whether [`TopicContent::join`] with `later` equals reading its messages here.
    pub(super) fn can_join(&self, later: &Self) -> bool {
        match (&self.builder, &later.builder) {
            (Some(own), Some(later)) => own.can_join(later),
            (None, Some(_)) => false,
            (_, None) => true,
        }
    }

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

    pub(super) fn record_span(&mut self, file: usize, at: Stamp) {
        match self.spans.last_mut() {
            Some((last, span)) if *last == file => *span = join(*span, (at, at)),
            _ => self.spans.push((file, (at, at))),
        }
    }
}

impl TopicIntake {
    /// Further messages cannot be added to the copy.
    pub(super) fn snapshot(&self) -> Self {
        Self {
            topic: self.topic.clone(),
            content: TopicContent {
                channels: Vec::new(),
                messages: self.content.messages,
                builder: self.content.builder.clone(),
                undecodable: self.content.undecodable.clone(),
                spans: self.content.spans.clone(),
            },
            waiting: Vec::new(),
        }
    }

    /// One topic per part of its messages.
    pub(super) fn finish(mut self) -> Vec<Topic> {
        let TopicContent { messages, builder, mut undecodable, spans, .. } = self.content;
        let file = <[_; 1]>::try_from(spans.as_slice()).ok().map(|[(file, _)]| file);
        let span = spans.into_iter().map(|(_, span)| span).reduce(join);
        let refused = builder.as_ref().map_or(0, Builder::rejected_rows);
        if refused > 0 {
            let first = format!("more than {MAX_FRAMES} pairs of frames");
            undecodable.get_or_insert(Undecodable { messages: 0, first }).messages += refused;
        }
        let useless = builder.as_ref().and_then(Builder::unusable_reason);
        let parts = match (self.topic.columns.take(), builder) {
            (Some(columns), _) => vec![("", Some(columns))],
            (None, Some(builder)) => builder.finalize(),
            (None, None) => vec![("", None)],
        };
        let topic = |(part, columns): (&str, _)| Topic {
            name: format!("{}{part}", self.topic.name),
            messages,
            columns,
            // A message counts once, not once per part.
            undecodable: undecodable.clone().filter(|_| part.is_empty()),
            unusable: useless.clone(),
            span,
            file,
            ..self.topic.clone()
        };
        parts.into_iter().map(topic).collect()
    }
}

impl ChannelDecoder {
    pub(super) fn new(decoding: Arc<Decoding>, may_be_packed: bool) -> Self {
        Self { decoding, row: None, may_be_packed, latched: HashSet::new() }
    }

    pub(super) fn is_packed(&self, data: &[u8]) -> bool {
        let is_decoded = matches!(*self.decoding, Decoding::By(_));
        is_decoded && self.may_be_packed && data.starts_with(ZSTD_MAGIC)
    }

    /// Whether this latched message was read before.
    pub(super) fn is_repeated(&mut self, data: &[u8]) -> bool {
        let mut hasher = DefaultHasher::new();
        data.hash(&mut hasher);
        let hash = hasher.finish();
        self.latched.contains(&hash)
            || (self.latched.len() < MAX_LATCHED && !self.latched.insert(hash))
    }
}

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
