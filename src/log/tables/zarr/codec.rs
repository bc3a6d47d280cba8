//! Codecs of chunks.

use std::io::Read;

use serde_json::Value;

use super::blosc;
use crate::tables::{TableError, first_line};

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Codec {
    Zlib,
    Gzip,
    Zstd,
    Bzip2,
    /// As in numcodecs: the length, then a block.
    Lz4,
    Blosc,
    /// Checksum that is not verified.
    Crc32c,
    /// Element size in bytes.
    Shuffle(usize),
}

impl Codec {
    pub fn from_name(name: &str, settings: &Value) -> Result<Self, TableError> {
        let size = || settings.get("elementsize").and_then(Value::as_u64).unwrap_or(4);
        // Zarr 3 prefixes the codecs of numcodecs.
        Ok(match name.strip_prefix("numcodecs.").unwrap_or(name) {
            "zlib" => Self::Zlib,
            "gzip" => Self::Gzip,
            "zstd" => Self::Zstd,
            "bz2" => Self::Bzip2,
            "lz4" => Self::Lz4,
            "blosc" => Self::Blosc,
            "crc32c" => Self::Crc32c,
            "shuffle" => Self::Shuffle(usize::try_from(size()).unwrap_or(1).max(1)),
            _ => {
                return Err(format!(
                    "codec '{name}' is not supported; write it with blosc, zstd, gzip or none"
                )
                .into());
            }
        })
    }

    /// Decodes at most `most` bytes.
    pub fn decode(self, packed: &[u8], most: usize) -> Result<Vec<u8>, TableError> {
        match self {
            Self::Zlib => read_all(flate2::read::ZlibDecoder::new(packed), most),
            Self::Gzip => read_all(flate2::read::MultiGzDecoder::new(packed), most),
            Self::Zstd => read_all(zstd::Decoder::with_buffer(packed).map_err(codec_error)?, most),
            Self::Bzip2 => read_all(bzip2::read::BzDecoder::new(packed), most),
            Self::Lz4 => {
                let (length, block) = packed.split_first_chunk().ok_or("a chunk is truncated")?;
                let length = u32::from_le_bytes(*length) as usize;
                match length <= most {
                    true => decode_lz4(block, length),
                    false => Err(too_long(length, most)),
                }
            }
            Self::Blosc => blosc::unpack(packed, most),
            Self::Crc32c => Ok(packed[..packed.len().saturating_sub(4)].to_vec()),
            Self::Shuffle(size) => Ok(blosc::unshuffle_bytes(packed, size)),
        }
    }
}

pub(super) fn read_all(decoder: impl Read, most: usize) -> Result<Vec<u8>, TableError> {
    let mut bytes = Vec::new();
    decoder.take(most as u64 + 1).read_to_end(&mut bytes).map_err(codec_error)?;
    if bytes.len() > most { Err(too_long(bytes.len(), most)) } else { Ok(bytes) }
}

/// The caller has limited `length`.
pub(super) fn decode_lz4(block: &[u8], length: usize) -> Result<Vec<u8>, TableError> {
    let length = i32::try_from(length).map_err(|_| "a chunk is too long")?;
    lz4::block::decompress(block, Some(length)).map_err(codec_error)
}

fn too_long(length: usize, most: usize) -> TableError {
    format!("a chunk unpacks to {length} bytes or more instead of {most}").into()
}

#[expect(clippy::needless_pass_by_value, reason = "it is handed to map_err")]
pub(super) fn codec_error(error: std::io::Error) -> TableError {
    format!("a chunk cannot be unpacked: {}", first_line(&error)).into()
}
