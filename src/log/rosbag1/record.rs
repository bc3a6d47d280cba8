//! Records of a ROS 1 bag of version 2.0, borrowed from the bytes that hold them.
//!
//! Format: <http://wiki.ros.org/Bags/Format/2.0>. A record is a header, which is a list of named
//! fields, and data, each behind its length. The field `op` says what the record is.

use crate::unpack::{Compression, Packed};

/// What a record is.
pub(super) mod op {
    pub(in super::super) const MESSAGE: u8 = 0x02;
    pub(in super::super) const BAG: u8 = 0x03;
    pub(in super::super) const INDEX: u8 = 0x04;
    pub(in super::super) const CHUNK: u8 = 0x05;
    pub(in super::super) const CHUNK_INFO: u8 = 0x06;
    pub(in super::super) const CONNECTION: u8 = 0x07;
}

/// Longest header that is believed: it holds a topic name at most.
const MAX_HEADER_BYTES: usize = 1 << 14;

/// One record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record<'a> {
    /// Where it begins.
    pub(super) offset: usize,
    /// What it is: one of [`op`].
    pub(super) op: u8,
    pub(super) header: Header<'a>,
    pub(super) data: &'a [u8],
    /// Where the next record begins.
    pub(super) end: usize,
}

/// What stands where a record should begin.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum Broken<'a> {
    /// The rest is too short for a header.
    #[error("{left} bytes, too few for a record")]
    Stub { left: usize },
    /// No header of named fields with an `op`.
    #[error("something else")]
    NoHeader,
    /// A record that is longer than the rest.
    #[error("a record (op {op:#04x}) of {length} bytes, of which {} are there", data.len())]
    Cut { op: u8, header: Header<'a>, length: u32, data: &'a [u8] },
}

/// The record at `offset`, which is at most the length of `bytes`.
pub(super) fn record(bytes: &[u8], offset: usize) -> Result<Record<'_>, Broken<'_>> {
    let rest = &bytes[offset..];
    let stub = Broken::Stub { left: rest.len() };
    let (header, rest) = match split(rest).ok_or(stub)? {
        (length, _) if length as usize > MAX_HEADER_BYTES => return Err(Broken::NoHeader),
        (length, rest) => rest.split_at_checked(length as usize).ok_or(stub)?,
    };
    let header = Header(header);
    let op = header.op().ok_or(Broken::NoHeader)?;
    let (length, data) = split(rest).ok_or(stub)?;
    match data.get(..length as usize) {
        Some(data) => {
            let end = bytes.len() - rest.len() + size_of::<u32>() + data.len();
            Ok(Record { offset, op, header, data, end })
        }
        None => Err(Broken::Cut { op, header, length, data }),
    }
}

/// Where the next record begins, at `from` or after it; with `only`, the next of that kind.
///
/// That the bytes of a field `op` stand within a header whose fields fill it, and which has those
/// that its kind of record must have, does not happen by chance.
pub(super) fn find_record(bytes: &[u8], from: usize, only: Option<u8>) -> Option<usize> {
    /// A field of four bytes that begins with `op=`.
    const OP: &[u8] = b"\x04\0\0\0op=";
    /// The fields before it in a header are shorter than this.
    const BEFORE: usize = 256;
    /// In data that hold so many of them and no record, there is none.
    const MOST: usize = 10_000;
    let rest = bytes.get(from..)?;
    let fields = rest.windows(OP.len()).enumerate().filter(|(_, window)| *window == OP);
    fields.take(MOST).map(|(at, _)| from + at).find_map(|field| {
        let last = field.checked_sub(size_of::<u32>())?;
        let mut starts = from.max(last.saturating_sub(BEFORE))..=last;
        starts.find(|&start| is_record(bytes, start, field, only))
    })
}

/// Whether a sound record of the kind `only` begins at `start`, whose header covers the byte `field`.
fn is_record(bytes: &[u8], start: usize, field: usize, only: Option<u8>) -> bool {
    let Some((length, _)) = split(&bytes[start..]) else {
        return false;
    };
    let end = start + size_of::<u32>() + length as usize;
    length as usize <= MAX_HEADER_BYTES
        && field < end
        && record(bytes, start).is_ok_and(|record| match record.op {
            other if only.is_some_and(|only| only != other) => false,
            op::MESSAGE => Message::of(&record).is_some(),
            op::CHUNK => Chunk::of(record.header, record.data).is_some(),
            op::CONNECTION => Connection::of(&record).is_some(),
            op::CHUNK_INFO => record.header.u32("count").is_some(),
            op::INDEX => record.header.u32("conn").is_some(),
            _ => false,
        })
}

/// The fields of a header, or of a connection's data: each a length, a name, `=` and a value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    /// The fields as far as they are sound: a name and a value, or `None` where they are not.
    fn fields(self) -> impl Iterator<Item = Option<(&'a [u8], &'a [u8])>> {
        let mut rest = self.0;
        std::iter::from_fn(move || {
            if rest.is_empty() {
                return None;
            }
            let field = split(rest).and_then(|(length, after)| {
                let (field, after) = after.split_at_checked(length as usize)?;
                rest = after;
                let equals = field.iter().position(|&byte| byte == b'=')?;
                Some((&field[..equals], &field[equals + 1..]))
            });
            if field.is_none() {
                rest = &[];
            }
            Some(field)
        })
    }

    /// The field `op`, if every field is sound.
    fn op(self) -> Option<u8> {
        let mut op = None;
        for field in self.fields() {
            if let (b"op", &[value]) = field? {
                op = Some(value);
            }
        }
        op
    }

    fn bytes(self, name: &str) -> Option<&'a [u8]> {
        let mut fields = self.fields().map_while(|field| field);
        fields.find(|(found, _)| *found == name.as_bytes()).map(|(_, value)| value)
    }

    /// The text of a field, as far as it is UTF-8.
    pub(super) fn text(self, name: &str) -> Option<&'a str> {
        std::str::from_utf8(self.bytes(name)?).ok()
    }

    pub(super) fn u32(self, name: &str) -> Option<u32> {
        self.bytes(name)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub(super) fn u64(self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(u64::from_le_bytes)
    }

    /// A time in nanoseconds.
    fn time(self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(time)
    }
}

/// A connection: a topic of one sender.
#[derive(Clone, Copy, Debug)]
pub(super) struct Connection<'a> {
    pub(super) id: u32,
    pub(super) topic: &'a str,
    /// Such as `sensor_msgs/JointState`.
    pub(super) type_name: &'a str,
    pub(super) definition: &'a [u8],
    /// Whether the sender repeats its last message to whoever comes late.
    pub(super) latching: bool,
}

impl<'a> Connection<'a> {
    pub(super) fn of(record: &Record<'a>) -> Option<Self> {
        let of_sender = Header(record.data);
        Some(Self {
            id: record.header.u32("conn")?,
            topic: record.header.text("topic")?,
            type_name: of_sender.text("type")?,
            definition: of_sender.bytes("message_definition")?,
            latching: of_sender.text("latching") == Some("1"),
        })
    }
}

impl Connection<'_> {
    /// Whether the first field of its messages is a `std_msgs/Header`, of which the first is `seq`.
    pub(super) fn begins_with_header(&self) -> bool {
        let Ok(text) = std::str::from_utf8(self.definition) else {
            return false;
        };
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        let mut fields = lines.filter(|line| !line.is_empty() && !line.contains('='));
        let type_name = fields.next().and_then(|field| field.split_whitespace().next());
        matches!(type_name, Some("Header" | "std_msgs/Header"))
    }
}

/// The header of a message.
#[derive(Clone, Copy, Debug)]
pub(super) struct Message {
    pub(super) connection: u32,
    /// When the recorder received it, in nanoseconds.
    pub(super) time: u64,
}

impl Message {
    pub(super) fn of(record: &Record<'_>) -> Option<Self> {
        Some(Self { connection: record.header.u32("conn")?, time: record.header.time("time")? })
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk<'a> {
    /// `None` where it is one that is not known.
    pub(super) compression: Option<Compression>,
    /// Bytes of the records inside.
    pub(super) size: u32,
    pub(super) data: &'a [u8],
}

impl<'a> Chunk<'a> {
    pub(super) fn of(header: Header<'a>, data: &'a [u8]) -> Option<Self> {
        let compression = match header.text("compression")? {
            "none" => Some(Compression::None),
            "lz4" => Some(Compression::Lz4),
            "bz2" => Some(Compression::Bz2),
            _ => None,
        };
        Some(Self { compression, size: header.u32("size")?, data })
    }

    /// The records inside; `None` where their compression is unknown.
    pub(super) fn packed(&self) -> Option<Packed<'a>> {
        // What checksums there are the compressed data hold themselves.
        let (compression, size) = (self.compression?, self.size.into());
        Some(Packed { compression, data: self.data, size, crc: 0 })
    }

    /// Whether a checksum in the compressed data covers what is inside.
    pub(super) fn has_checksum(&self) -> bool {
        /// The byte of an lz4 frame's flags, and that for a checksum of its content.
        const LZ4_FLAGS: (usize, u8) = (4, 0x04);
        match self.compression {
            Some(Compression::Bz2) => true,
            Some(Compression::Lz4) => {
                self.data.get(LZ4_FLAGS.0).is_some_and(|flags| flags & LZ4_FLAGS.1 != 0)
            }
            _ => false,
        }
    }
}

/// How many messages a chunk info counts: its data has a connection and a count for each.
pub(super) fn chunk_info_messages(record: &Record<'_>) -> u64 {
    const ENTRY: usize = 8;
    record
        .data
        .chunks_exact(ENTRY)
        .filter_map(|entry| entry.last_chunk().copied().map(u32::from_le_bytes))
        .map(u64::from)
        .sum()
}

/// The messages of one connection in a chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageIndex<'a> {
    /// Time and place of each.
    entries: &'a [[u8; 12]],
}

impl<'a> MessageIndex<'a> {
    /// With the number of the connection.
    pub(super) fn of(record: &Record<'a>) -> Option<(u32, Self)> {
        let (entries, _) = record.data.as_chunks();
        Some((record.header.u32("conn")?, Self { entries }))
    }

    /// How many messages there are.
    pub(super) fn count(&self) -> u64 {
        self.entries.len() as u64
    }

    /// Their first and last time, ns; `None` where there is no message.
    pub(super) fn span(&self) -> Option<(u64, u64)> {
        let times = || self.entries.iter().filter_map(|entry| Some(time(entry.first_chunk()?)));
        times().min().zip(times().max())
    }
}

/// Seconds and nanoseconds as nanoseconds.
fn time(value: &[u8; 8]) -> u64 {
    let [seconds, nanoseconds] = [&value[..4], &value[4..]]
        .map(|part| part.try_into().map_or(0, u32::from_le_bytes))
        .map(u64::from);
    seconds * 1_000_000_000 + nanoseconds
}

/// Where the chunk of a chunk info begins, and the times of its first and last message, ns.
pub(super) fn chunk_info_times(record: &Record<'_>) -> Option<(usize, u64, u64)> {
    let chunk = record.header.u64("chunk_pos")?.try_into().ok()?;
    Some((chunk, record.header.time("start_time")?, record.header.time("end_time")?))
}

/// A length, and what follows it.
fn split(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (&length, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(length), rest))
}
