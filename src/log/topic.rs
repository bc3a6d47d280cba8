//! One topic while its messages are taken in.

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

/// Most different messages of a latching channel that are known again.
const MAX_LATCHED: usize = 1 << 12;

/// One message as a container holds it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message<'a> {
    /// When the recorder received it, in nanoseconds.
    pub(super) log_time: u64,
    /// When the sender published it, in nanoseconds.
    pub(super) publish_time: u64,
    /// The number that its sender, or the recorder, gave it; 0 where none did.
    pub(super) sequence: u32,
    /// The encoded message.
    pub(super) data: &'a [u8],
    /// Where in the file it is, or the chunk that holds it.
    pub(super) place: Place,
    /// Whether it is one that its sender repeats to whoever comes late, and a recorder at the
    /// beginning of every file.
    pub(super) latched: bool,
}

/// Where in a file a message is.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    /// At this byte.
    Byte(u64),
    /// In this row of a table.
    Row(i64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Byte(offset) => write!(f, "record at byte {offset} of the file"),
            Place::Row(row) => write!(f, "row {row} of the table `messages`"),
        }
    }
}

/// How messages of one channel are decoded.
pub(super) struct Channel {
    pub(super) decoding: Arc<Decoding>,
    /// Of the channel's own, so that no slot holds what another type left there.
    row: Option<Box<Row>>,
    /// Whether each message may be a zstd frame: no CDR message begins like one.
    may_be_packed: bool,
    /// Hashes of the latched messages that were taken.
    latched: HashSet<u64>,
}

#[derive(Debug)]
pub(super) enum Decoding {
    /// No audit uses the type.
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
    pub(super) taken: Taken,
    /// Rows that were not decoded from messages.
    pub(super) columns: Option<Columns>,
    /// How its columns were told.
    pub(super) read_as: Option<String>,
    /// Which numbers of a table it is made of.
    pub(super) cells: Vec<TableCell>,
    /// Which messages of a batch are its own: the channel's place, and the message's.
    pub(super) waiting: Vec<(usize, usize)>,
}

/// What was taken of a topic's messages: of all that were read, or of those of one chunk.
#[derive(Default)]
pub(super) struct Taken {
    pub(super) channels: Vec<Channel>,
    pub(super) messages: u64,
    pub(super) builder: Option<Builder>,
    pub(super) undecodable: Option<Undecodable>,
    /// The files that hold it, by their number, and the span in each.
    pub(super) spans: Vec<(usize, Span)>,
}

/// What it takes to read messages of a topic into columns of their own.
pub(super) struct Blank {
    channels: Vec<(Arc<Decoding>, bool)>,
    builder: Option<Builder>,
}

impl Blank {
    /// Nothing taken yet.
    pub(super) fn taken(&self) -> Taken {
        let channel = |(decoding, may_be_packed): &(Arc<Decoding>, bool)| {
            Channel::new(Arc::clone(decoding), *may_be_packed)
        };
        Taken {
            channels: self.channels.iter().map(channel).collect(),
            builder: self.builder.as_ref().map(Builder::blank),
            ..Taken::default()
        }
    }
}

impl Taken {
    /// The same channels and columns, with nothing in them.
    pub(super) fn blank(&self) -> Blank {
        let channel = |channel: &Channel| (Arc::clone(&channel.decoding), channel.may_be_packed);
        Blank {
            channels: self.channels.iter().map(channel).collect(),
            builder: self.builder.as_ref().map(Builder::blank),
        }
    }

    /// Whether [`Taken::join`] of `later` gives what reading its messages here would.
    pub(super) fn fits(&self, later: &Self) -> bool {
        match (&self.builder, &later.builder) {
            (Some(own), Some(later)) => own.fits(later),
            (None, Some(_)) => false,
            (_, None) => true,
        }
    }

    /// Takes over what `later` messages were read to.
    pub(super) fn join(&mut self, later: Self) {
        self.messages += later.messages;
        if let (Some(builder), Some(later)) = (&mut self.builder, later.builder) {
            builder.join(later);
        }
        if let Some(Undecodable { messages, first }) = later.undecodable {
            self.undecodable.get_or_insert(Undecodable { messages: 0, first }).messages += messages;
        }
        for (file, (first, last)) in later.spans {
            self.seen(file, first);
            self.seen(file, last);
        }
    }

    /// Counts a message of file number `file`, and appends its rows where its channel has columns.
    pub(super) fn message(&mut self, place: usize, message: &Message<'_>, file: usize) {
        let times = RowTimes {
            log: saturating(message.log_time),
            publish: saturating(message.publish_time),
            sequence: message.sequence,
        };
        self.messages += 1;
        self.seen(file, Stamp::from_nanos(times.log));
        let channel = &mut self.channels[place];
        if message.latched && channel.is_repeated(message.data) {
            return;
        }
        match (&*channel.decoding, &mut self.builder) {
            (Decoding::By(plan), Some(builder)) => {
                let row = channel.row.get_or_insert_default();
                let mut append = |row: &Row| builder.append(row, times);
                if let Err(error) = plan.decode(message.data, row, &mut append) {
                    take_down(&mut self.undecodable, message.place, &error);
                }
            }
            (Decoding::Impossible { cause }, _) => {
                take_down(&mut self.undecodable, message.place, cause);
            }
            (Decoding::By(_) | Decoding::Ignored, _) => {}
        }
    }

    /// Takes down that file number `file` holds a message of log time `at`.
    pub(super) fn seen(&mut self, file: usize, at: Stamp) {
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
    /// What was taken so far, without what it takes to take more.
    pub(super) fn so_far(&self) -> Self {
        Self {
            name: self.name.clone(),
            type_name: self.type_name.clone(),
            encoding: self.encoding.clone(),
            taken: Taken {
                channels: Vec::new(),
                messages: self.taken.messages,
                builder: self.taken.builder.clone(),
                undecodable: self.taken.undecodable.clone(),
                spans: self.taken.spans.clone(),
            },
            columns: self.columns.clone(),
            read_as: self.read_as.clone(),
            cells: self.cells.clone(),
            waiting: Vec::new(),
        }
    }

    /// The topic, and one more for each further part of what its messages hold.
    pub(super) fn finish(self) -> Vec<Topic> {
        let Taken { messages, builder, mut undecodable, spans, .. } = self.taken;
        let span = spans.into_iter().map(|(_, span)| span).reduce(join);
        let refused = builder.as_ref().map_or(0, Builder::refused);
        if refused > 0 {
            let first = format!("it has more than {MAX_FRAMES} pairs of frames");
            undecodable.get_or_insert(Undecodable { messages: 0, first }).messages += refused;
        }
        let useless = builder.as_ref().and_then(Builder::useless);
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
            // Told once, for the whole of the messages.
            undecodable: undecodable.clone().filter(|_| part.is_empty()),
            useless: useless.clone(),
            read_as: self.read_as.clone(),
            cells: self.cells.clone(),
            span,
        };
        parts.into_iter().map(topic).collect()
    }
}

impl Channel {
    pub(super) fn new(decoding: Arc<Decoding>, may_be_packed: bool) -> Self {
        Self { decoding, row: None, may_be_packed, latched: HashSet::new() }
    }

    /// Whether a message is a zstd frame that must be unpacked before it is decoded.
    pub(super) fn is_packed(&self, data: &[u8]) -> bool {
        let is_decoded = matches!(*self.decoding, Decoding::By(_));
        is_decoded && self.may_be_packed && data.starts_with(ZSTD_MAGIC)
    }

    /// Whether a latched message of this channel was taken before.
    pub(super) fn is_repeated(&mut self, data: &[u8]) -> bool {
        let mut hasher = DefaultHasher::new();
        data.hash(&mut hasher);
        let hash = hasher.finish();
        self.latched.contains(&hash)
            || (self.latched.len() < MAX_LATCHED && !self.latched.insert(hash))
    }
}

/// Takes down that the message at `place` cannot be decoded.
pub(super) fn take_down(
    undecodable: &mut Option<Undecodable>,
    place: Place,
    cause: &dyn fmt::Display,
) {
    let undecodable = undecodable
        .get_or_insert_with(|| Undecodable { messages: 0, first: format!("{cause} ({place})") });
    undecodable.messages += 1;
}

pub(super) fn saturating(nanos: u64) -> i64 {
    i64::try_from(nanos).unwrap_or(i64::MAX)
}
