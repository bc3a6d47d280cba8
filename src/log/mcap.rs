//! MCAP files, read from the first byte to the last, skipping damage. The summary is read first: it repeats
//! schemas and channels that a damaged chunk may have lost.

mod advice;
mod chunks;
mod definitions;
mod growing;
mod parts;
mod record;
mod sparse;
#[cfg(feature = "cloud")]
mod survey;
#[cfg(test)]
mod tests;

use std::cell::OnceCell;
use std::collections::HashMap;
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::op;

use self::parts::DefinitionSnapshot;
use self::record::{Broken, Frame};
use super::chunk_pool::{self, ChunkPool};
use super::intake::{ChannelId, Intake, MAX_BATCH_MESSAGES};
use super::losses::{Losses, UnknownRecords};
use super::ranges::Present;
use super::topic::Message;
use super::unpack::Unpacker;
use super::{Crc, Extent, ReadOptions};

pub(super) use self::growing::{GrowingFile, whole_records};
#[cfg(feature = "cloud")]
pub(super) use self::survey::{Survey, survey};

/// Required byte offset of a file that has not been fetched.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct MissingByte(pub(super) usize);

/// Reads the file `bytes` into `intake`. Accesses only the `present` bytes, which must cover those
/// requested by [`survey`](survey::survey).
///
/// # Errors
/// If they do not; the partial result must be discarded.
pub(super) fn read(
    bytes: &[u8],
    present: &Present,
    options: &ReadOptions,
    losses: &mut Losses,
    intake: &mut Intake,
) -> Result<Crc, MissingByte> {
    chunk_pool::with_pool(|ahead| {
        let before = intake.messages();
        let mut reader = Reader::new(bytes, present, options, losses, intake, ahead);
        let summary = reader.summary();
        let end = reader.walk();
        if let Some(absent) = reader.absent {
            return Err(absent);
        }
        let read = reader.intake.messages() - before;
        reader.close(&summary, end, read);
        Ok(Crc::from_counts(reader.covered, read))
    })
}

struct Reader<'a, 'r, 'scope> {
    bytes: &'a [u8],
    present: &'r Present,
    /// First required byte that is absent.
    absent: Option<MissingByte>,
    options: &'r ReadOptions,
    intake: &'r mut Intake,
    losses: &'r mut Losses,
    ahead: &'r mut ChunkPool<'scope, 'a>,
    /// Offset up to which chunks are queued. `None` if no record follows.
    scanned: Option<usize>,
    definitions: Definitions,
    /// Snapshot for parallel parsing, once requested.
    table: Option<Arc<DefinitionSnapshot>>,
    tables: u32,
    /// Most of a chunk was skipped: fetch the wanted parts of the following ones separately.
    is_scattered: bool,
    covered: u64,
    /// Messages of undescribed channels: number, and offset of the first.
    orphans: Option<(u64, usize)>,
    unknown: UnknownRecords,
    in_lost_chunk: bool,
    has_chunks: bool,
    trailing_zeros_start: OnceCell<usize>,
}

/// Latest schemas and channels; chunks repeat them.
#[derive(Clone, Default)]
struct Definitions {
    schemas: HashMap<u16, Arc<Schema>>,
    /// Indexed by channel id.
    channels: Vec<Option<Arc<Channel>>>,
    changes: u64,
}

impl Definitions {
    fn channel_of(&self, channel_id: u16) -> Option<ChannelId> {
        self.channels.get(usize::from(channel_id))?.as_ref()?.id
    }

    fn has_schema(&self, schema: &record::Schema<'_>) -> bool {
        self.schemas.get(&schema.id).is_some_and(|known| known.matches(schema))
    }

    fn has_channel(&self, channel: &record::Channel<'_>) -> bool {
        let known = self.channels.get(usize::from(channel.id)).and_then(Option::as_ref);
        known.is_some_and(|known| known.matches(channel))
    }
}

struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
}

impl Schema {
    fn matches(&self, schema: &record::Schema<'_>) -> bool {
        (self.name.as_str(), self.encoding.as_str(), self.data.as_slice())
            == (schema.name, schema.encoding, schema.data)
    }
}

struct Channel {
    /// `None` if there are too many channels.
    id: Option<ChannelId>,
    schema_id: u16,
    topic: String,
    encoding: String,
}

impl Channel {
    fn matches(&self, channel: &record::Channel<'_>) -> bool {
        (self.schema_id, self.topic.as_str(), self.encoding.as_str())
            == (channel.schema_id, channel.topic, channel.encoding)
    }
}

enum Summary {
    /// The file was not closed.
    Unclosed,
    Closed {
        messages: Option<u64>,
    },
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ChunkUse {
    /// Most of the chunk, or unknown: it is decompressed and verified.
    All,
    /// Some messages of an uncompressed chunk, between larger ones.
    Some,
    Counts,
    Absent,
}

enum DataEnd<'a> {
    Closed(Frame<'a>),
    Open,
    Damaged,
}

impl<'a, 'r, 'scope> Reader<'a, 'r, 'scope> {
    fn new(
        bytes: &'a [u8],
        present: &'r Present,
        options: &'r ReadOptions,
        losses: &'r mut Losses,
        intake: &'r mut Intake,
        ahead: &'r mut ChunkPool<'scope, 'a>,
    ) -> Self {
        Self {
            bytes,
            present,
            absent: None,
            options,
            intake,
            losses,
            ahead,
            scanned: Some(MAGIC.len()),
            definitions: Definitions::default(),
            table: None,
            tables: 0,
            is_scattered: false,
            covered: 0,
            orphans: None,
            unknown: UnknownRecords::default(),
            in_lost_chunk: false,
            has_chunks: false,
            trailing_zeros_start: OnceCell::new(),
        }
    }
}

impl<'a> Reader<'a, '_, '_> {
    /// Reads schemas and channels from the summary, if any.
    fn summary(&mut self) -> Summary {
        let Some(content) = self.bytes.strip_suffix(MAGIC) else {
            let magic = self.bytes.len().saturating_sub(MAGIC.len());
            self.is_present(magic..self.bytes.len());
            return Summary::Unclosed;
        };
        let footer_start = content.len().saturating_sub(record::Footer::SIZE);
        if !self.is_present(footer_start..self.bytes.len()) {
            return Summary::Unclosed;
        }
        let footer = match record::frame(content, footer_start) {
            Ok(frame) if frame.opcode == op::FOOTER => record::Footer::parse(frame.body),
            _ => None,
        };
        let Some(footer) = footer else {
            self.record_lost_summary(footer_start, "no footer before the end of the file");
            return Summary::Closed { messages: None };
        };
        let start = usize::try_from(footer.summary_start).unwrap_or(usize::MAX);
        if start == 0 {
            return Summary::Closed { messages: None };
        }
        let Some(records) = content.get(..footer_start).filter(|records| start <= records.len())
        else {
            self.record_lost_summary(footer_start, "the footer points beyond the end of the file");
            return Summary::Closed { messages: None };
        };
        if !self.is_present(start..footer_start) {
            return Summary::Unclosed;
        }
        // The checksum covers the footer up to itself.
        let covered = &content[start..content.len() - size_of::<u32>()];
        if footer.summary_crc != 0 && crc32fast::hash(covered) != footer.summary_crc {
            self.record_lost_summary(start, "the summary fails its checksum");
            return Summary::Closed { messages: None };
        }
        let mut messages = None;
        // Schemas first: a channel may precede its schema.
        for wanted in [op::SCHEMA, op::CHANNEL, op::STATISTICS] {
            let frames = record::frames(records, start).flatten();
            for frame in frames.filter(|frame| frame.opcode == wanted) {
                match wanted {
                    op::STATISTICS => messages = record::recorded_messages(frame.body),
                    _ if self.definition(&frame).is_none() => {
                        self.record_lost_record(&frame, frame.offset);
                    }
                    _ => {}
                }
            }
        }
        Summary::Closed { messages }
    }

    fn record_lost_summary(&mut self, offset: usize, what: &str) {
        self.losses.add(offset, Extent::Index, Some(0), what.to_owned());
    }

    fn walk(&mut self) -> DataEnd<'a> {
        let mut unpacker = Unpacker::default();
        let mut offset = MAGIC.len();
        // Start of the search for the next chunk: the previous record may have a wrong length.
        let mut sound = offset;
        while offset < self.bytes.len() {
            self.options.set_position(offset);
            self.unpack_ahead(offset);
            if !self.is_present(offset..self.bytes.len().min(offset + record::FRAME_HEADER)) {
                return DataEnd::Damaged;
            }
            match record::frame(self.bytes, offset) {
                Ok(frame) if matches!(frame.opcode, op::DATA_END | op::FOOTER) => {
                    return DataEnd::Closed(frame);
                }
                Ok(frame) => {
                    let intact = self.record(&frame, &mut unpacker);
                    sound = if intact { frame.end() } else { offset + 1 };
                    offset = frame.end();
                }
                // The rest must be searched.
                Err(_) if !self.is_present(sound..self.bytes.len()) => return DataEnd::Damaged,
                Err(broken) => {
                    let Some(next) = self.next_record(sound) else {
                        self.salvage_rest(offset, broken, &mut unpacker);
                        return DataEnd::Damaged;
                    };
                    let what =
                        format!("expected a record, found {broken}; continued at byte {next}");
                    self.losses.add(offset, Extent::Messages, None, what);
                    (offset, sound) = (next, next + 1);
                    self.scanned = Some(next);
                }
            }
        }
        DataEnd::Open
    }

    /// Offset to continue from after damage. Chunks contain bytes that look like messages, so messages
    /// are searched only in files without chunks.
    fn next_record(&self, from: usize) -> Option<usize> {
        let channels = &self.definitions.channels;
        let is_known = |id: u16| matches!(channels.get(usize::from(id)), Some(Some(_)));
        let within = || from..self.zeros_from().max(from);
        record::find_chunk(self.bytes, within()).or_else(|| {
            let find = || record::find_message(self.bytes, within(), is_known);
            if self.has_chunks { None } else { find() }
        })
    }

    /// Start of the trailing zeros, possibly gigabytes.
    fn zeros_from(&self) -> usize {
        *self.trailing_zeros_start.get_or_init(|| record::trailing_zeros(self.bytes))
    }

    /// Reads one record. Returns whether its length is reliable.
    fn record(&mut self, frame: &Frame<'a>, unpacker: &mut Unpacker) -> bool {
        let in_lost_chunk = std::mem::take(&mut self.in_lost_chunk);
        match frame.opcode {
            op::CHUNK => return self.chunk(frame, unpacker),
            _ if !self.is_present(frame.offset..frame.end()) => {}
            op::MESSAGE_INDEX if in_lost_chunk => {
                // The index of a lost chunk contains its number of messages.
                let index = record::MessageIndex::parse(frame.body);
                self.losses.add_to_last(index.map_or(0, |index| index.count()));
                self.in_lost_chunk = true;
            }
            op::ATTACHMENT => self.attachment(frame),
            op::METADATA => self.metadata(frame),
            _ => {
                let mut batch = Vec::new();
                if self.content(frame, frame.offset, &mut batch).is_none() {
                    self.record_lost_record(frame, frame.offset);
                }
                self.intake.batch(&mut batch);
            }
        }
        false
    }

    /// Reads a schema, channel or message, which is added to `batch`. `None` if malformed.
    fn content<'m>(
        &mut self,
        frame: &Frame<'m>,
        offset: usize,
        batch: &mut Vec<(ChannelId, Message<'m>)>,
    ) -> Option<()> {
        if frame.opcode != op::MESSAGE {
            // Opcodes from 0x80 are for private use.
            if (op::DATA_END + 1..0x80).contains(&frame.opcode) {
                self.unknown.add(frame.opcode);
            }
            return self.definition(frame);
        }
        let message = record::Message::parse(frame.body)?;
        let Some(id) = self.definitions.channel_of(message.channel_id) else {
            self.orphans.get_or_insert((0, offset)).0 += 1;
            return Some(());
        };
        batch.push((id, message.at_offset(offset)));
        if batch.len() == MAX_BATCH_MESSAGES {
            self.intake.batch(batch);
        }
        Some(())
    }

    fn record_lost_record(&mut self, frame: &Frame<'_>, offset: usize) {
        let what = format!("malformed record (opcode {:#04x})", frame.opcode);
        let (extent, messages) = match frame.opcode {
            op::MESSAGE => (Extent::Messages, Some(1)),
            _ => (Extent::Index, Some(0)),
        };
        self.losses.add(offset, extent, messages, what);
    }

    /// Records the damage at `offset` and salvages the rest of the chunk.
    fn salvage_rest(&mut self, offset: usize, broken: Broken<'a>, unpacker: &mut Unpacker) {
        let closed = self.bytes.ends_with(MAGIC);
        let (extent, messages, what) = match broken {
            Broken::Cut { opcode: op::CHUNK, body, .. } if !closed => {
                let before = self.intake.messages();
                if let Some(chunk) = record::Chunk::parse(body) {
                    let records = chunk.cut_records(unpacker, &mut self.intake.unpack_budget);
                    self.salvage_chunk(records, offset);
                }
                let saved = self.intake.messages() - before;
                let what =
                    format!("the file ends within a chunk; {saved} of its messages were read");
                (Extent::Tail, None, what)
            }
            Broken::Cut { opcode: op::MESSAGE, .. } if !closed => {
                (Extent::Tail, Some(1), "the file ends within a message".to_owned())
            }
            Broken::Cut { opcode: 0x01..=0x0f, .. } | Broken::Stub { .. } if !closed => {
                (Extent::Index, Some(0), "the file ends within a record".to_owned())
            }
            Broken::Zero if self.zeros_from() <= offset => {
                (Extent::Tail, None, "the file ends in zeros, as after a crash".to_owned())
            }
            _ => {
                let what = format!("expected a record, found {broken}; the rest was not read");
                (Extent::Messages, None, what)
            }
        };
        self.losses.add(offset, extent, messages, what);
    }

    fn close(&mut self, summary: &Summary, end: DataEnd<'_>, read: u64) {
        if let Some(what) = self.unknown.note("opcode") {
            self.intake.note(self.losses.file(), what);
        }
        if let Some((messages, offset)) = self.orphans {
            let (extent, why) = self.intake.missing_channel_reason();
            let what = format!("the first of {messages} messages of channels {why}");
            self.losses.add(offset, extent, Some(messages), what);
        }
        match (summary, end) {
            (Summary::Unclosed, DataEnd::Open | DataEnd::Closed(_)) => {
                let what = "the file ends without a footer: the recording was not closed";
                self.record_lost_summary(self.bytes.len(), what);
            }
            (Summary::Closed { .. }, DataEnd::Closed(frame)) if self.options.verify => {
                self.check_data(&frame, read);
            }
            _ => {}
        }
        if let Summary::Closed { messages: Some(recorded) } = *summary {
            self.losses.infer_missing("the summary", recorded, read);
        }
    }

    /// Verifies the checksum in the closing record `end`.
    fn check_data(&mut self, end: &Frame<'_>, read: u64) {
        let crc = match end.opcode {
            op::DATA_END => record::data_crc(end.body).unwrap_or(0),
            _ => 0,
        };
        if crc == 0 {
            return;
        }
        if crc32fast::hash(&self.bytes[..end.offset]) == crc {
            self.covered = read;
        } else if self.losses.is_empty() {
            let what = "the data section fails its checksum";
            if self.covered == read {
                self.record_lost_summary(
                    end.offset,
                    &format!("{what}, although every chunk is intact"),
                );
            } else {
                let what = format!("{what}: messages outside chunks may be altered");
                self.losses.add(end.offset, Extent::Messages, None, what);
            }
        }
    }
}
