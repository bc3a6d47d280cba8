//! MCAP records, borrowed from the bytes of the file. The `mcap` crate copies every string and assumes that
//! attachments are long enough; here, a record that is too short is `None`.

use std::ops::Range;

use mcap::records::op;

use crate::topic;
use crate::unpack::{Compression, Packed, UnpackBudget, Unpacker};

/// Size of opcode and length.
pub(super) const FRAME_HEADER: usize = 9;

#[derive(Clone, Copy, Debug)]
pub(super) struct Frame<'a> {
    pub(super) offset: usize,
    pub(super) opcode: u8,
    pub(super) body: &'a [u8],
}

impl Frame<'_> {
    pub(super) fn end(&self) -> usize {
        self.offset + FRAME_HEADER + self.body.len()
    }
}

#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum Broken<'a> {
    #[error("{left} bytes, too few for a record")]
    Stub { left: usize },
    #[error("opcode 0, which is invalid")]
    Zero,
    #[error("a record (opcode {opcode:#04x}) of {length} bytes, only {} of them in the file", body.len())]
    Cut { opcode: u8, length: u64, body: &'a [u8] },
}

/// Parses the record at `offset`, which is at most the length of `bytes`.
pub(super) fn frame(bytes: &[u8], offset: usize) -> Result<Frame<'_>, Broken<'_>> {
    let rest = &bytes[offset..];
    let mut fields = Fields(rest);
    let (Some(opcode), Some(length)) = (fields.u8(), fields.u64()) else {
        return Err(Broken::Stub { left: rest.len() });
    };
    if opcode == 0 {
        return Err(Broken::Zero);
    }
    let Fields(body) = fields;
    match usize::try_from(length).ok().and_then(|length| body.get(..length)) {
        Some(body) => Ok(Frame { offset, opcode, body }),
        None => Err(Broken::Cut { opcode, length, body }),
    }
}

/// Records from `offset` to the first invalid one, inclusive.
pub(super) fn frames(
    bytes: &[u8],
    mut offset: usize,
) -> impl Iterator<Item = Result<Frame<'_>, Broken<'_>>> {
    std::iter::from_fn(move || {
        if offset >= bytes.len() {
            return None;
        }
        let frame = frame(bytes, offset);
        offset = frame.map_or(bytes.len(), |frame| frame.end());
        Some(frame)
    })
}

/// Offset of the next complete chunk in the range `within`. A chunk states its length in the record and
/// with its compressed data; random data does not match both and a known compression.
pub(super) fn find_chunk(bytes: &[u8], within: Range<usize>) -> Option<usize> {
    starts(bytes, within, op::CHUNK).find(|&offset| {
        let Ok(frame) = frame(bytes, offset) else {
            return false;
        };
        let Some(chunk) = Chunk::parse(frame.body) else {
            return false;
        };
        let header = CHUNK_HEADER + chunk.compression.len();
        chunk.compression().is_some()
            && chunk.is_whole()
            && header + chunk.data.len() == frame.body.len()
    })
}

/// Offset of the next message outside of chunks in the range `within`. Its channel satisfies `is_known`,
/// and a record or the end follows.
pub(super) fn find_message(
    bytes: &[u8],
    within: Range<usize>,
    is_known: impl Fn(u16) -> bool,
) -> Option<usize> {
    starts(bytes, within, op::MESSAGE).find(|&offset| {
        let Ok(found) = frame(bytes, offset) else {
            return false;
        };
        Message::parse(found.body).is_some_and(|message| is_known(message.channel_id))
            && (found.end() == bytes.len()
                || frame(bytes, found.end()).is_ok_and(|next| next.opcode <= op::DATA_END))
    })
}

fn starts(bytes: &[u8], within: Range<usize>, opcode: u8) -> impl Iterator<Item = usize> {
    let from = within.start;
    let within = bytes.get(within).unwrap_or_default();
    let found = within.iter().enumerate().filter(move |&(_, &byte)| byte == opcode);
    found.map(move |(offset, _)| from + offset)
}

pub(super) fn trailing_zeros(bytes: &[u8]) -> usize {
    const BLOCK_BYTES: usize = 1 << 12;
    let mut end = bytes.len();
    while end >= BLOCK_BYTES && bytes[end - BLOCK_BYTES..end] == [0; BLOCK_BYTES] {
        end -= BLOCK_BYTES;
    }
    bytes[..end].iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1)
}

const MAX_COMPRESSION_NAME: u32 = 16;

/// Size without compression name and data.
const CHUNK_HEADER: usize = 8 + 8 + 8 + 4 + 4 + 8;

#[cfg_attr(not(feature = "cloud"), allow(dead_code, reason = "local files are complete"))]
pub(super) const CHUNK_HEAD: usize = FRAME_HEADER + CHUNK_HEADER + MAX_COMPRESSION_NAME as usize;

pub(super) const MESSAGE_HEAD: usize = FRAME_HEADER + 2 + 4 + 8 + 8;

#[derive(Clone, Copy, Debug)]
pub(super) struct Schema<'a> {
    pub(super) id: u16,
    pub(super) name: &'a str,
    pub(super) encoding: &'a str,
    pub(super) data: &'a [u8],
}

impl<'a> Schema<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let (id, name, encoding) = (fields.u16()?, fields.text()?, fields.text()?);
        let length = fields.u32()?;
        Some(Self { id, name, encoding, data: fields.bytes(length.into())? })
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Channel<'a> {
    pub(super) id: u16,
    /// 0 if the channel has no schema.
    pub(super) schema_id: u16,
    pub(super) topic: &'a str,
    pub(super) encoding: &'a str,
}

impl<'a> Channel<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            id: fields.u16()?,
            schema_id: fields.u16()?,
            topic: fields.text()?,
            encoding: fields.text()?,
        })
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Message<'a> {
    pub(super) channel_id: u16,
    pub(super) sequence: u32,
    pub(super) log_time: u64,
    pub(super) publish_time: u64,
    pub(super) data: &'a [u8],
}

impl<'a> Message<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let (channel_id, sequence) = (fields.u16()?, fields.u32()?);
        let (log_time, publish_time) = (fields.u64()?, fields.u64()?);
        Some(Self { channel_id, sequence, log_time, publish_time, data: fields.0 })
    }

    /// `offset` is the file offset of its chunk, or of the message outside of chunks.
    pub(super) fn at_offset(self, offset: usize) -> topic::Message<'a> {
        topic::Message {
            log_time: self.log_time,
            publish_time: self.publish_time,
            sequence: self.sequence,
            data: self.data,
            place: topic::MessagePlace::Byte(offset as u64),
            latched: false,
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Chunk<'a> {
    /// Log times, ns.
    pub(super) first_time: u64,
    pub(super) last_time: u64,
    /// Uncompressed size.
    pub(super) size: u64,
    /// Checksum of the uncompressed records; 0 if absent.
    pub(super) crc: u32,
    pub(super) compression: &'a str,
    /// Declared length of `data`.
    compressed_size: u64,
    /// Possibly truncated.
    pub(super) data: &'a [u8],
}

impl<'a> Chunk<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let (first_time, last_time) = (fields.u64()?, fields.u64()?);
        let (size, crc) = (fields.u64()?, fields.u32()?);
        let length = fields.u32()?;
        if length > MAX_COMPRESSION_NAME {
            return None;
        }
        let compression = std::str::from_utf8(fields.bytes(length.into())?).ok()?;
        let compressed_size = fields.u64()?;
        let there = compressed_size.min(fields.0.len() as u64);
        let data = fields.bytes(there)?;
        Some(Self { first_time, last_time, size, crc, compression, compressed_size, data })
    }

    fn compression(&self) -> Option<Compression> {
        match self.compression {
            "" => Some(Compression::None),
            "zstd" => Some(Compression::Zstd),
            "lz4" => Some(Compression::Lz4),
            _ => None,
        }
    }

    /// `None` if the compression is unknown.
    pub(super) fn packed(&self) -> Option<Packed<'a>> {
        let compression = self.compression()?;
        Some(Packed { compression, data: self.data, size: self.size, crc: self.crc })
    }

    pub(super) fn cut_records<'b>(
        &'b self,
        unpacker: &'b mut Unpacker,
        allowance: &mut UnpackBudget,
    ) -> &'b [u8] {
        let compression = self.compression();
        compression.map_or(&[], |compression| unpacker.cut_chunk(compression, self.data, allowance))
    }

    pub(super) fn is_whole(&self) -> bool {
        self.data.len() as u64 == self.compressed_size
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct MessageIndex<'a> {
    pub(super) channel_id: u16,
    /// Log time and offset of each message.
    entries: &'a [[u8; 16]],
}

impl<'a> MessageIndex<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let (channel_id, length) = (fields.u16()?, fields.u32()?);
        let (entries, _) = fields.bytes(length.into())?.as_chunks();
        Some(Self { channel_id, entries })
    }

    pub(super) fn count(&self) -> u64 {
        self.entries.len() as u64
    }

    pub(super) fn offsets(&self) -> impl Iterator<Item = u64> + use<'a> {
        self.entries.iter().filter_map(|entry| Fields(&entry[8..]).u64())
    }

    /// First and last log time, ns; `None` if empty.
    pub(super) fn span(&self) -> Option<(u64, u64)> {
        let time = |entry: &[u8; 16]| Fields(entry).u64();
        let times = || self.entries.iter().filter_map(time);
        times().min().zip(times().max())
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Attachment<'a> {
    pub(super) name: &'a str,
    pub(super) data: &'a [u8],
    /// Bytes covered by the checksum.
    pub(super) covered: &'a [u8],
    /// 0 if absent.
    pub(super) crc: u32,
}

impl<'a> Attachment<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let _times = fields.bytes(16)?;
        let name = fields.text()?;
        let _media_type = fields.text()?;
        let length = fields.u64()?;
        let data = fields.bytes(length)?;
        let covered = &body[..body.len() - fields.0.len()];
        Some(Self { name, data, covered, crc: fields.u32()? })
    }
}

pub(super) fn metadata(body: &[u8]) -> Option<(&str, impl Iterator<Item = (&str, &str)>)> {
    let mut fields = Fields(body);
    let name = fields.text()?;
    let length = fields.u32()?;
    let mut pairs = Fields(fields.bytes(length.into())?);
    Some((name, std::iter::from_fn(move || pairs.text().zip(pairs.text()))))
}

#[cfg(feature = "cloud")]
pub(super) fn chunk_place(body: &[u8]) -> Option<Range<usize>> {
    let mut fields = Fields(body);
    let _times = fields.bytes(16)?;
    let start = usize::try_from(fields.u64()?).ok()?;
    let length = usize::try_from(fields.u64()?).ok()?;
    Some(start..start.checked_add(length)?)
}

pub(super) fn recorded_messages(body: &[u8]) -> Option<u64> {
    Fields(body).u64()
}

/// 0 if absent.
pub(super) fn data_crc(body: &[u8]) -> Option<u32> {
    Fields(body).u32()
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Footer {
    /// 0 if absent.
    pub(super) summary_start: u64,
    /// Covers the summary and the preceding footer fields; 0 if absent.
    pub(super) summary_crc: u32,
}

impl Footer {
    pub(super) const SIZE: usize = FRAME_HEADER + 20;

    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let summary_start = fields.u64()?;
        let _summary_offset_start = fields.u64()?;
        Some(Self { summary_start, summary_crc: fields.u32()? })
    }
}

#[derive(Clone, Copy)]
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, length: u64) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(bytes)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (&bytes, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(bytes)
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()?;
        std::str::from_utf8(self.bytes(length.into())?).ok()
    }
}
