//! Records of a ROS 1 bag, version 2.0, borrowed from the bytes of the file.
//!
//! Format: <http://wiki.ros.org/Bags/Format/2.0>. A record is a header of named fields, and data, each
//! preceded by its length. The field `op` is its kind.

use crate::unpack::{Compression, Packed};

pub(super) mod op {
    pub(in super::super) const MESSAGE: u8 = 0x02;
    pub(in super::super) const BAG: u8 = 0x03;
    pub(in super::super) const INDEX: u8 = 0x04;
    pub(in super::super) const CHUNK: u8 = 0x05;
    pub(in super::super) const CHUNK_INFO: u8 = 0x06;
    pub(in super::super) const CONNECTION: u8 = 0x07;
}

/// Longest plausible header; its longest field is a topic name.
const MAX_HEADER_BYTES: usize = 1 << 14;

#[derive(Clone, Copy, Debug)]
pub(super) struct Record<'a> {
    pub(super) offset: usize,
    pub(super) op: u8,
    pub(super) header: Header<'a>,
    pub(super) data: &'a [u8],
    pub(super) end: usize,
}

#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum Broken<'a> {
    #[error("{left} bytes, too few for a record")]
    Stub { left: usize },
    #[error("something else")]
    NoHeader,
    #[error("a record (op {op:#04x}) of {length} bytes, only {} of them in the file", data.len())]
    Cut { op: u8, header: Header<'a>, length: u32, data: &'a [u8] },
}

/// Parses the record at `offset`, which is at most the length of `bytes`.
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

/// Offset of the next record at or after `from`, of the kind `only` if given. Random data does not form a
/// header of valid fields that include `op` and all fields required for the kind.
pub(super) fn find_record(bytes: &[u8], from: usize, only: Option<u8>) -> Option<usize> {
    /// Four bytes that start with `op=`.
    const OP_FIELD: &[u8] = b"\x04\0\0\0op=";
    /// Maximum length of the fields before it.
    const MAX_FIELDS_BYTES: usize = 256;
    const MAX_CANDIDATES: usize = 10_000;
    let rest = bytes.get(from..)?;
    let fields = rest.windows(OP_FIELD.len()).enumerate().filter(|(_, window)| *window == OP_FIELD);
    fields.take(MAX_CANDIDATES).map(|(at, _)| from + at).find_map(|field| {
        let last = field.checked_sub(size_of::<u32>())?;
        let mut starts = from.max(last.saturating_sub(MAX_FIELDS_BYTES))..=last;
        starts.find(|&start| is_record(bytes, start, field, only))
    })
}

/// Whether a record of the kind `only` starts at `start`, with a header that includes the byte `field`.
fn is_record(bytes: &[u8], start: usize, field: usize, only: Option<u8>) -> bool {
    let Some((length, _)) = split(&bytes[start..]) else {
        return false;
    };
    let end = start + size_of::<u32>() + length as usize;
    length as usize <= MAX_HEADER_BYTES
        && field < end
        && record(bytes, start).is_ok_and(|record| match record.op {
            other if only.is_some_and(|only| only != other) => false,
            op::MESSAGE => Message::from_record(&record).is_some(),
            op::CHUNK => Chunk::from_header(record.header, record.data).is_some(),
            op::CONNECTION => Connection::from_record(&record).is_some(),
            op::CHUNK_INFO => record.header.u32("count").is_some(),
            op::INDEX => record.header.u32("conn").is_some(),
            _ => false,
        })
}

/// Fields of a header or a connection: each a length, a name, `=` and a value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    /// Ends with `None` at an invalid field.
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

    /// Opcode, if all fields are valid.
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

    /// Text, if it is UTF-8.
    pub(super) fn text(self, name: &str) -> Option<&'a str> {
        std::str::from_utf8(self.bytes(name)?).ok()
    }

    pub(super) fn u32(self, name: &str) -> Option<u32> {
        self.bytes(name)?.try_into().ok().map(u32::from_le_bytes)
    }

    pub(super) fn u64(self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(u64::from_le_bytes)
    }

    /// Time in ns.
    fn time(self, name: &str) -> Option<u64> {
        self.bytes(name)?.try_into().ok().map(time)
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Connection<'a> {
    pub(super) id: u32,
    pub(super) topic: &'a str,
    /// For example `sensor_msgs/JointState`.
    pub(super) type_name: &'a str,
    pub(super) definition: &'a [u8],
    /// The sender repeats its last message to new subscribers.
    pub(super) latching: bool,
}

impl<'a> Connection<'a> {
    pub(super) fn from_record(record: &Record<'a>) -> Option<Self> {
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
    /// Whether its messages start with a `std_msgs/Header`, which starts with `seq`.
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

#[derive(Clone, Copy, Debug)]
pub(super) struct Message {
    pub(super) connection: u32,
    /// Receive time, ns.
    pub(super) time: u64,
}

impl Message {
    pub(super) fn from_record(record: &Record<'_>) -> Option<Self> {
        Some(Self { connection: record.header.u32("conn")?, time: record.header.time("time")? })
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk<'a> {
    /// `None` if unknown.
    pub(super) compression: Option<Compression>,
    /// Uncompressed size.
    pub(super) size: u32,
    pub(super) data: &'a [u8],
}

impl<'a> Chunk<'a> {
    pub(super) fn from_header(header: Header<'a>, data: &'a [u8]) -> Option<Self> {
        let compression = match header.text("compression")? {
            "none" => Some(Compression::None),
            "lz4" => Some(Compression::Lz4),
            "bz2" => Some(Compression::Bz2),
            _ => None,
        };
        Some(Self { compression, size: header.u32("size")?, data })
    }

    /// `None` if the compression is unknown.
    pub(super) fn packed(&self) -> Option<Packed<'a>> {
        // Checksums are part of the compressed data.
        let (compression, size) = (self.compression?, self.size.into());
        Some(Packed { compression, data: self.data, size, crc: 0 })
    }

    pub(super) fn has_checksum(&self) -> bool {
        /// Flags of an lz4 frame: index, and flag of a content checksum.
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

/// Sum over all connections.
pub(super) fn chunk_info_messages(record: &Record<'_>) -> u64 {
    const ENTRY: usize = 8;
    record
        .data
        .chunks_exact(ENTRY)
        .filter_map(|entry| entry.last_chunk().copied().map(u32::from_le_bytes))
        .map(u64::from)
        .sum()
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MessageIndex<'a> {
    /// Time and offset of each message.
    entries: &'a [[u8; 12]],
}

impl<'a> MessageIndex<'a> {
    /// The connection and its index.
    pub(super) fn from_record(record: &Record<'a>) -> Option<(u32, Self)> {
        let (entries, _) = record.data.as_chunks();
        Some((record.header.u32("conn")?, Self { entries }))
    }

    pub(super) fn count(&self) -> u64 {
        self.entries.len() as u64
    }

    /// First and last time, ns; `None` if empty.
    pub(super) fn span(&self) -> Option<(u64, u64)> {
        let times = || self.entries.iter().filter_map(|entry| Some(time(entry.first_chunk()?)));
        times().min().zip(times().max())
    }
}

/// Time in ns from seconds and nanoseconds.
fn time(value: &[u8; 8]) -> u64 {
    let [seconds, nanoseconds] = [&value[..4], &value[4..]]
        .map(|part| part.try_into().map_or(0, u32::from_le_bytes))
        .map(u64::from);
    seconds * 1_000_000_000 + nanoseconds
}

/// Offset of the chunk, and its first and last time, ns.
pub(super) fn chunk_info_times(record: &Record<'_>) -> Option<(usize, u64, u64)> {
    let chunk = record.header.u64("chunk_pos")?.try_into().ok()?;
    Some((chunk, record.header.time("start_time")?, record.header.time("end_time")?))
}

fn split(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (&length, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(length), rest))
}
