//! ROS 1 bags, version 2.0, read from the first byte to the last, skipping damage. The index is read first:
//! it repeats connections that a damaged chunk may have lost.

mod chunks;
mod record;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use self::record::{Broken, Chunk, Connection, Record, op};
use super::chunk_pool::{self, ChunkPool};
use super::decode::Format;
use super::intake::{ChannelId, Intake, MAX_BATCH_MESSAGES};
use super::losses::{Losses, UnknownRecords};
use super::topic::{Message, MessagePlace};
use super::unpack::{Compression, Unpacker};
use super::{Crc, Extent, ReadOptions};

pub(super) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

pub(super) fn read(
    bytes: &[u8],
    options: &ReadOptions,
    losses: &mut Losses,
    intake: &mut Intake,
) -> Crc {
    chunk_pool::with_pool(|ahead| {
        let before = intake.messages();
        let mut reader = Reader {
            bytes,
            options,
            losses,
            intake,
            ahead,
            scanned: Some(MAGIC.len()),
            connections: HashMap::new(),
            index: Index::Missing,
            recorded: (0, 0),
            covered: 0,
            orphans: None,
            unknown: UnknownRecords::default(),
            in_lost_chunk: false,
            in_packed: false,
        };
        reader.index();
        reader.walk();
        let read = reader.intake.messages() - before;
        reader.close(read);
        Crc::from_counts(reader.covered, read)
    })
}

struct Reader<'a, 'r, 'scope> {
    bytes: &'a [u8],
    options: &'r ReadOptions,
    losses: &'r mut Losses,
    intake: &'r mut Intake,
    ahead: &'r mut ChunkPool<'scope, 'a>,
    /// Offset up to which chunks are queued. `None` if no record follows.
    scanned: Option<usize>,
    /// Keyed by connection number; the first record of a number counts.
    connections: HashMap<u32, Sender>,
    index: Index,
    /// Chunk infos read, and the messages they count.
    recorded: (u32, u64),
    covered: u64,
    /// Messages of undescribed connections: number, and offset of the first.
    orphans: Option<(u64, usize)>,
    unknown: UnknownRecords,
    in_lost_chunk: bool,
    /// The last chunk is compressed: its data contain bytes that look like records.
    in_packed: bool,
}

#[derive(Clone, Copy)]
struct Sender {
    /// `None` if there are too many channels.
    channel: Option<ChannelId>,
    latching: bool,
    /// Its messages start with a header, which starts with a sequence number.
    numbers: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Index {
    /// The recording was not closed.
    Missing,
    At {
        offset: usize,
        chunks: u32,
    },
}

impl<'a> Reader<'a, '_, '_> {
    fn index(&mut self) {
        let Ok(header) = record::record(self.bytes, MAGIC.len()) else {
            return;
        };
        let offset = header.header.u64("index_pos").and_then(|at| usize::try_from(at).ok());
        let (op::BAG, Some(offset @ 1..)) = (header.op, offset) else {
            return;
        };
        let chunks = header.header.u32("chunk_count").unwrap_or(0);
        self.index = Index::At { offset, chunks };
        let mut offset = offset;
        while offset < self.bytes.len() {
            match record::record(self.bytes, offset) {
                Ok(record) if record.op == op::CONNECTION => {
                    self.connection(&record);
                    offset = record.end;
                }
                // The walk records damage.
                _ => return,
            }
        }
    }

    fn walk(&mut self) {
        let mut unpacker = Unpacker::default();
        let mut offset = MAGIC.len();
        // Start of the search for the next record: the previous one may have a wrong length.
        let mut sound = offset;
        // Chunk lengths are written when a chunk is full; after a crash the last one is zero.
        let mut open: Option<Chunk<'a>> = None;
        while offset < self.bytes.len() {
            self.options.set_position(offset);
            self.unpack_ahead(offset);
            match record::record(self.bytes, offset) {
                Ok(record) => {
                    open = None;
                    let intact = match record.op {
                        op::CHUNK => self.chunk(&record, &mut unpacker, &mut open),
                        _ => self.top(&record),
                    };
                    sound = if intact { record.end } else { record.offset + 1 };
                    offset = record.end;
                }
                Err(broken) => {
                    if let Some(chunk) = open {
                        return self.open_chunk(chunk, offset, &mut unpacker);
                    }
                    let Some(next) = self.next_record(sound, broken) else {
                        return self.lose_rest(offset, broken, &mut unpacker);
                    };
                    let what =
                        format!("expected a record, found {broken}; continued at byte {next}");
                    self.losses.add(offset, Extent::Messages, None, what);
                    offset = next;
                    self.scanned = Some(next);
                }
            }
        }
    }

    /// Reads a record outside chunks. Returns whether its length is reliable.
    fn top(&mut self, record: &Record<'a>) -> bool {
        let in_lost_chunk = std::mem::take(&mut self.in_lost_chunk);
        match record.op {
            op::INDEX if in_lost_chunk => {
                // The index of a lost chunk contains its number of messages.
                self.losses.add_to_last(record.header.u32("count").unwrap_or(0).into());
                self.in_lost_chunk = true;
            }
            op::CHUNK_INFO => {
                self.recorded.0 += 1;
                self.recorded.1 += record::chunk_info_messages(record);
                if let Some((chunk, first, last)) = record::chunk_info_times(record) {
                    self.losses.set_span(chunk, first, last);
                }
            }
            op::BAG if record.header.text("encryptor").is_some_and(|name| !name.is_empty()) => {
                let what = "the bag is encrypted; rewrite it without encryption".to_owned();
                self.losses.add(record.offset, Extent::Messages, None, what);
            }
            _ => {
                let mut batch = Vec::new();
                self.content(record, record.offset, &mut batch);
                self.intake.batch(&mut batch);
            }
        }
        false
    }

    fn content<'m>(
        &mut self,
        record: &Record<'m>,
        place: usize,
        batch: &mut Vec<(ChannelId, Message<'m>)>,
    ) {
        match record.op {
            op::MESSAGE => match record::Message::from_record(record) {
                Some(header) => batch.extend(self.message(header, record.data, place)),
                None => {
                    let what = "message record without a connection or time".to_owned();
                    self.losses.add(place, Extent::Messages, Some(1), what);
                }
            },
            op::CONNECTION if !self.connection(record) => {
                let what = "malformed connection record".to_owned();
                self.losses.add(place, Extent::Index, Some(0), what);
            }
            op::BAG | op::INDEX | op::CHUNK | op::CHUNK_INFO | op::CONNECTION => {}
            other => self.unknown.add(other),
        }
        if batch.len() == MAX_BATCH_MESSAGES {
            self.intake.batch(batch);
        }
    }

    fn message<'m>(
        &mut self,
        header: record::Message,
        data: &'m [u8],
        place: usize,
    ) -> Option<(ChannelId, Message<'m>)> {
        let sender = self.connections.get(&header.connection);
        let Some(&Sender { channel: Some(channel), latching, numbers }) = sender else {
            self.orphans.get_or_insert((0, place)).0 += 1;
            return None;
        };
        let number = data.first_chunk().copied().map(u32::from_le_bytes);
        // A bag has one time per message, the recorder's receive time.
        let message = Message {
            log_time: header.time,
            publish_time: header.time,
            sequence: number.filter(|_| numbers).unwrap_or(0),
            data,
            place: MessagePlace::Byte(place as u64),
            latched: latching,
        };
        Some((channel, message))
    }

    fn connection(&mut self, record: &Record<'_>) -> bool {
        let Some(connection) = Connection::from_record(record) else {
            return false;
        };
        let intake = &mut *self.intake;
        self.connections.entry(connection.id).or_insert_with(|| Sender {
            channel: intake.channel(
                connection.topic,
                Format {
                    encoding: "ros1",
                    type_name: connection.type_name,
                    schema_encoding: "ros1msg",
                    schema: connection.definition,
                },
            ),
            latching: connection.latching,
            numbers: connection.begins_with_header(),
        });
        true
    }

    fn lose_tail(&mut self, offset: usize, place: &str, saved: u64) {
        let what = format!("the file ends {place}; {saved} of its messages were read");
        self.losses.add(offset, Extent::Tail, None, what);
    }

    /// Records the damage at `offset` and salvages the rest of the chunk.
    fn lose_rest(&mut self, offset: usize, broken: Broken<'a>, unpacker: &mut Unpacker) {
        match broken {
            _ if matches!(self.index, Index::At { offset: index, .. } if index <= offset) => {
                let what = format!("expected an index record, found {broken}");
                self.losses.add(offset, Extent::Index, Some(0), what);
            }
            _ if self.is_whole() => {
                let what = format!("expected a record, found {broken}; the rest was not read");
                self.losses.add(offset, Extent::Messages, None, what);
            }
            Broken::Cut { op: op::CHUNK, header, data, .. } => {
                let saved = Chunk::from_header(header, data)
                    .map_or(0, |chunk| self.cut_chunk(&chunk, data, offset, unpacker));
                self.lose_tail(offset, "within a chunk", saved);
            }
            Broken::Cut { op: op::MESSAGE, .. } => {
                let what = "the file ends within a message".to_owned();
                self.losses.add(offset, Extent::Tail, Some(1), what);
            }
            Broken::Cut { .. } | Broken::Stub { .. } => {
                let what = "the file ends within a record".to_owned();
                self.losses.add(offset, Extent::Tail, None, what);
            }
            Broken::NoHeader if self.bytes[offset..].iter().all(|&byte| byte == 0) => {
                let what = "the file ends in zeros, as after a crash".to_owned();
                self.losses.add(offset, Extent::Tail, None, what);
            }
            Broken::NoHeader => {
                let what = format!("expected a record, found {broken}; the rest was not read");
                self.losses.add(offset, Extent::Messages, None, what);
            }
        }
    }

    fn next_record(&self, from: usize, broken: Broken<'_>) -> Option<usize> {
        let chunk = match broken {
            Broken::Cut { op: op::CHUNK, header, length, data } => {
                Chunk::from_header(header, data).map(|chunk| (chunk, length))
            }
            _ => None,
        };
        match chunk {
            // The lengths agree, so the end of the file is missing.
            Some((Chunk { compression: Some(Compression::None), size, .. }, length))
                if size == length && !self.is_whole() =>
            {
                None
            }
            // Compressed data contain bytes that look like records.
            Some((Chunk { compression: Some(Compression::Lz4 | Compression::Bz2), .. }, _)) => {
                record::find_record(self.bytes, from, Some(op::CHUNK))
            }
            _ => record::find_record(self.bytes, from, self.in_packed.then_some(op::CHUNK)),
        }
    }

    /// Whether the file extends to its index.
    fn is_whole(&self) -> bool {
        matches!(self.index, Index::At { offset, .. } if offset < self.bytes.len())
    }

    fn close(&mut self, read: u64) {
        if let Some(what) = self.unknown.note("op") {
            self.intake.note(self.losses.file(), what);
        }
        if let Some((messages, offset)) = self.orphans {
            let (extent, why) = self.intake.missing_channel_reason();
            let what = format!("the first of {messages} messages of connections {why}");
            self.losses.add(offset, extent, Some(messages), what);
        }
        match self.index {
            Index::Missing => {
                let what = "the bag has no index: the recording was not closed".to_owned();
                self.losses.add_unplaced(Extent::Index, Some(0), what);
            }
            Index::At { offset, .. } if offset >= self.bytes.len() => {
                if self.losses.is_empty() {
                    let what = format!("the file ends before its index at byte {offset}");
                    self.losses.add(self.bytes.len(), Extent::Tail, None, what);
                }
            }
            Index::At { chunks, .. } if chunks == self.recorded.0 => {
                self.losses.infer_missing("the index", self.recorded.1, read);
            }
            Index::At { offset, chunks } => {
                if self.losses.is_empty() {
                    let what = format!("the index lists {} of {chunks} chunks", self.recorded.0);
                    self.losses.add(offset, Extent::Index, Some(0), what);
                }
            }
        }
    }
}
