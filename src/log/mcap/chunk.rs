//! The records inside a chunk.

use std::io::{self, Read};

use super::record::Chunk;

/// Largest chunk that is unpacked. Recorders write chunks of a few megabytes.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// Why the records of a chunk cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum ChunkError {
    #[error("chunk of {size} bytes is larger than the {MAX_CHUNK_BYTES} that are unpacked")]
    TooLarge { size: u64 },
    #[error("chunk is compressed by `{found}`, expected `zstd`, `lz4` or none")]
    Compression { found: String },
    #[error("chunk cannot be unpacked: {0}")]
    Unpack(#[from] io::Error),
    #[error("chunk holds {found} bytes, its header says {expected}")]
    Size { expected: u64, found: u64 },
    #[error("chunk fails its checksum ({found:08x}, its header says {expected:08x})")]
    Crc { expected: u32, found: u32 },
}

/// Unpacks one chunk after the other into one buffer.
#[derive(Default)]
pub(super) struct Unpacker {
    zstd: zstd::bulk::Decompressor<'static>,
    buffer: Vec<u8>,
}

impl Unpacker {
    /// The records of a whole chunk, of the size and with the checksum that its header says.
    pub(super) fn unpack<'a>(&'a mut self, chunk: &Chunk<'a>) -> Result<&'a [u8], ChunkError> {
        let records = match chunk.compression {
            "" => chunk.data,
            "zstd" => {
                // The capacity bounds what zstd may write, and only what it writes takes memory.
                self.make_room(chunk)?;
                self.zstd.decompress_to_buffer(chunk.data, &mut self.buffer)?;
                &self.buffer
            }
            "lz4" => {
                self.make_room(chunk)?;
                let stream = lz4::Decoder::new(chunk.data)?;
                stream.take(chunk.size + 1).read_to_end(&mut self.buffer)?;
                &self.buffer
            }
            other => return Err(ChunkError::Compression { found: other.to_owned() }),
        };
        if records.len() as u64 != chunk.size {
            let found = records.len() as u64;
            return Err(ChunkError::Size { expected: chunk.size, found });
        }
        if chunk.crc != 0 {
            let found = crc32fast::hash(records);
            if found != chunk.crc {
                return Err(ChunkError::Crc { expected: chunk.crc, found });
            }
        }
        Ok(records)
    }

    /// The records at the beginning of a chunk whose end is missing, as far as they can be unpacked.
    pub(super) fn unpack_cut<'a>(&'a mut self, chunk: &Chunk<'a>) -> &'a [u8] {
        let (buffer, data) = (&mut self.buffer, chunk.data);
        buffer.clear();
        let limit = chunk.size.min(MAX_CHUNK_BYTES);
        // That the stream breaks off is known: what came before stays in the buffer.
        let _broken_off = match chunk.compression {
            "" => return data,
            "zstd" => zstd::stream::read::Decoder::with_buffer(data)
                .and_then(|stream| stream.take(limit).read_to_end(buffer)),
            "lz4" => {
                lz4::Decoder::new(data).and_then(|stream| stream.take(limit).read_to_end(buffer))
            }
            _ => Ok(0),
        };
        &self.buffer
    }

    /// An empty buffer with the capacity for a chunk.
    fn make_room(&mut self, chunk: &Chunk<'_>) -> Result<(), ChunkError> {
        let too_large = || ChunkError::TooLarge { size: chunk.size };
        if chunk.size > MAX_CHUNK_BYTES {
            return Err(too_large());
        }
        self.buffer.clear();
        self.buffer.try_reserve_exact(chunk.size as usize).map_err(|_| too_large())
    }
}
