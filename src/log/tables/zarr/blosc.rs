//! Blosc 1 chunks as written by numcodecs: blocks of LZ4, zlib or Zstandard with shuffled bytes or bits.
//!
//! Format: `README_CHUNK_FORMAT.rst` of c-blosc 1.21.

use super::codec::{codec_error, decode_lz4, read_all};
use crate::tables::TableError;

const HEADER_BYTES: usize = 16;
/// Blosc 2 uses higher ones.
const MAX_VERSION: u8 = 2;
/// Blocks are split by byte of the element within these limits.
const MAX_SPLIT_BYTES: usize = 16;
const MIN_PART_BYTES: usize = 128;

/// Indexed by code.
const COMPRESSORS: [&str; 8] = ["BloscLZ", "LZ4", "Snappy", "zlib", "Zstandard", "5", "6", "7"];

struct Header {
    flags: u8,
    /// Element size, bytes.
    size: usize,
    /// Size of the whole, and of each block.
    bytes: usize,
    block: usize,
}

pub(crate) fn unpack(chunk: &[u8], most: usize) -> Result<Vec<u8>, TableError> {
    let cut = || TableError::from("a chunk is truncated");
    let (header, rest) = chunk.split_first_chunk::<HEADER_BYTES>().ok_or_else(cut)?;
    if header[0] > MAX_VERSION {
        return Err("a chunk is not in Blosc 1 format".into());
    }
    let word = |at: usize| read_u32(header, at).unwrap_or(0);
    let header =
        Header { flags: header[2], size: header[3].max(1).into(), bytes: word(4), block: word(8) };
    let Header { flags, bytes, block, .. } = header;
    if bytes > most {
        return Err(format!("a chunk declares {bytes} bytes, its array {most}").into());
    }
    if flags & 2 != 0 {
        return rest.get(..bytes).map(<[u8]>::to_vec).ok_or_else(cut);
    }
    if block == 0 && bytes > 0 {
        return Err("a chunk declares blocks of 0 bytes".into());
    }
    let mut whole = Vec::new();
    for number in 0..bytes.div_ceil(block.max(1)) {
        let length = block.min(bytes - whole.len());
        let start = read_u32(rest, 4 * number).ok_or_else(cut)?;
        let packed = chunk.get(start..).ok_or_else(cut)?;
        whole.extend(header.unshuffle(header.block(packed, length).ok_or_else(cut)??));
    }
    Ok(whole)
}

fn read_u32(bytes: &[u8], at: usize) -> Option<usize> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?) as usize)
}

impl Header {
    /// Does not unshuffle. `None` if truncated.
    fn block(&self, packed: &[u8], length: usize) -> Option<Result<Vec<u8>, TableError>> {
        let is_split = self.flags & 0x10 == 0
            && self.size <= MAX_SPLIT_BYTES
            && length / self.size >= MIN_PART_BYTES
            && length == self.block;
        let part = if is_split { length / self.size } else { length };
        let (mut block, mut at) = (Vec::new(), 0);
        for _ in 0..if is_split { self.size } else { 1 } {
            let own = read_u32(packed, at)?;
            let bytes = packed.get(at + 4..(at + 4).checked_add(own)?)?;
            at += 4 + own;
            match if own == part { Ok(bytes.to_vec()) } else { self.part(bytes, part) } {
                Ok(bytes) if bytes.len() == part => block.extend(bytes),
                Ok(_) => return None,
                Err(what) => return Some(Err(what)),
            }
        }
        Some(Ok(block))
    }

    fn part(&self, packed: &[u8], length: usize) -> Result<Vec<u8>, TableError> {
        match self.flags >> 5 {
            1 => decode_lz4(packed, length),
            3 => read_all(flate2::read::ZlibDecoder::new(packed), length),
            4 => read_all(zstd::Decoder::with_buffer(packed).map_err(codec_error)?, length),
            other => Err(format!(
                "its chunks are compressed with {}, which is not supported; write it with lz4 or zstd",
                COMPRESSORS[usize::from(other)]
            )
            .into()),
        }
    }

    fn unshuffle(&self, block: Vec<u8>) -> Vec<u8> {
        match (self.flags & 1 != 0, self.flags & 4 != 0) {
            (true, _) => unshuffle_bytes(&block, self.size),
            (false, true) if (block.len() / self.size).is_multiple_of(8) => {
                unshuffle_bits(&block, self.size)
            }
            _ => block,
        }
    }
}

/// Shuffled: all first bytes of the elements, then all second bytes, and so on.
pub(super) fn unshuffle_bytes(bytes: &[u8], size: usize) -> Vec<u8> {
    let count = bytes.len() / size;
    let mut whole = bytes.to_vec();
    for (element, own) in whole.chunks_exact_mut(size).enumerate() {
        own.iter_mut().enumerate().for_each(|(part, byte)| *byte = bytes[part * count + element]);
    }
    whole
}

/// Lowest bit first.
fn unshuffle_bits(bytes: &[u8], size: usize) -> Vec<u8> {
    let row = bytes.len() / size / 8;
    let mut whole = bytes.to_vec();
    for (element, own) in whole.chunks_exact_mut(size).enumerate() {
        for (part, byte) in own.iter_mut().enumerate() {
            let bit = |bit: usize| {
                (bytes[(part * 8 + bit) * row + element / 8] >> (element % 8) & 1) << bit
            };
            *byte = (0..8).map(bit).sum();
        }
    }
    whole
}
