//! Decompresses parts of files within limits. A few kilobytes can expand to terabytes, so decompressed
//! sizes are charged to an [`UnpackBudget`] for the whole file.

use std::io::{self, Read, Seek, Write};

use ground::boundary::StagedFile;

use super::Extent;
use super::mapped::{Temporary, temporary};

pub(super) const ZSTD_MAGIC: &[u8] = b"\x28\xb5\x2f\xfd";

pub(super) const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// Recorders write chunks of a few megabytes.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

const MAX_MESSAGE_BYTES: u64 = 64 << 20;

/// Charge per byte that is slow to decompress or stored on disk.
const SLOW_OR_STORED_COST: u64 = 16;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Compression {
    None,
    Zstd,
    Lz4,
    Bz2,
}

#[derive(Debug, thiserror::Error)]
pub(super) enum UnpackError {
    #[error("{part} of {size} bytes is larger than the limit of {limit}")]
    TooLarge { part: &'static str, size: u64, limit: u64 },
    #[error(
        "{part} not decompressed: the file would exceed the default limit of {} GiB",
        limit >> 30
    )]
    TooMuch { part: &'static str, limit: u64 },
    #[error("{part} cannot be decompressed: {source}")]
    Broken { part: &'static str, source: io::Error },
    #[error("chunk has {found} bytes, its header says {expected}")]
    Size { expected: u64, found: u64 },
    #[error("chunk fails its checksum ({found:08x}, expected {expected:08x})")]
    Crc { expected: u32, found: u32 },
}

impl UnpackError {
    /// Damaged messages, or content skipped by default.
    pub(super) fn extent(&self) -> Extent {
        match self {
            Self::TooMuch { .. } => Extent::Unread,
            Self::TooLarge { .. } | Self::Broken { .. } | Self::Size { .. } | Self::Crc { .. } => {
                Extent::Messages
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Packed<'a> {
    pub(super) compression: Compression,
    pub(super) data: &'a [u8],
    /// Decompressed size according to its header.
    pub(super) size: u64,
    /// Checksum of the decompressed bytes; 0 if absent.
    pub(super) crc: u32,
}

impl<'a> Packed<'a> {
    fn content<'b>(&self, buffer: &'b [u8]) -> &'b [u8]
    where
        'a: 'b,
    {
        match self.compression {
            Compression::None => self.data,
            Compression::Zstd | Compression::Lz4 | Compression::Bz2 => buffer,
        }
    }

    /// Decompressed size, multiplied for bzip2 because it is slow.
    fn cost(&self) -> u64 {
        match self.compression {
            Compression::None => 0,
            Compression::Zstd | Compression::Lz4 => self.size,
            Compression::Bz2 => self.size.saturating_mul(SLOW_OR_STORED_COST),
        }
    }

    fn verify(&self, content: &[u8]) -> Result<(), UnpackError> {
        let found = content.len() as u64;
        if found != self.size {
            return Err(UnpackError::Size { expected: self.size, found });
        }
        let crc = if self.crc == 0 { 0 } else { crc32fast::hash(content) };
        if crc == self.crc {
            Ok(())
        } else {
            Err(UnpackError::Crc { expected: self.crc, found: crc })
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct UnpackBudget {
    limit: u64,
    used: u64,
}

impl UnpackBudget {
    const BASE_BYTES: u64 = 16 << 30;
    /// Per byte of the file. Black images reach 1400. Chunks do not stay in memory, so this only bounds
    /// time.
    const MAX_RATIO: u64 = 2000;

    pub(super) fn for_file(bytes: u64, requested_gib: Option<u32>) -> Self {
        let default_limit = bytes.saturating_mul(Self::MAX_RATIO).saturating_add(Self::BASE_BYTES);
        Self { limit: default_limit.max(u64::from(requested_gib.unwrap_or(0)) << 30), used: 0 }
    }

    #[cfg(test)]
    pub(super) fn with_limit(limit: u64) -> Self {
        Self { limit, used: 0 }
    }

    fn remaining(&self) -> u64 {
        self.limit - self.used
    }

    fn check(&self, part: &'static str, size: u64) -> Result<(), UnpackError> {
        if size > self.remaining() {
            return Err(UnpackError::TooMuch { part, limit: self.limit });
        }
        Ok(())
    }

    fn take(&mut self, bytes: u64) {
        self.used = self.used.saturating_add(bytes).min(self.limit);
    }

    pub(super) fn admit(&self, packed: &Packed<'_>) -> Result<(), UnpackError> {
        let (size, limit) = (packed.size, MAX_CHUNK_BYTES);
        match packed.compression {
            Compression::None => Ok(()),
            _ if size > limit => Err(UnpackError::TooLarge { part: CHUNK, size, limit }),
            _ => self.check(CHUNK, packed.cost()),
        }
    }

    /// Charged even if decompression fails.
    pub(super) fn charge(&mut self, packed: &Packed<'_>) {
        self.take(packed.cost());
    }
}

const CHUNK: &str = "chunk";

pub(super) struct UnpackedChunk {
    pub(super) buffer: Vec<u8>,
    outcome: Result<(), UnpackError>,
}

impl UnpackedChunk {
    /// Charges the allowance.
    pub(super) fn content<'a>(
        &'a mut self,
        packed: &Packed<'a>,
        budget: &mut UnpackBudget,
    ) -> Result<&'a [u8], UnpackError> {
        budget.admit(packed)?;
        budget.charge(packed);
        std::mem::replace(&mut self.outcome, Ok(()))?;
        Ok(packed.content(&self.buffer))
    }

    /// Does not charge. `None` if there is an error.
    pub(super) fn if_sound<'a>(&'a self, packed: &Packed<'a>) -> Option<&'a [u8]> {
        self.outcome.is_ok().then(|| packed.content(&self.buffer))
    }
}

#[derive(Default)]
pub(super) struct Unpacker {
    zstd: zstd::bulk::Decompressor<'static>,
    buffer: Vec<u8>,
}

impl Unpacker {
    /// Verified against the size and checksum in its header.
    pub(super) fn chunk<'a>(
        &'a mut self,
        packed: &Packed<'a>,
        budget: &mut UnpackBudget,
    ) -> Result<&'a [u8], UnpackError> {
        budget.admit(packed)?;
        budget.charge(packed);
        self.fill(packed)?;
        Ok(packed.content(&self.buffer))
    }

    /// The cost is charged when the chunk is read.
    pub(super) fn chunk_into(&mut self, buffer: Vec<u8>, packed: &Packed<'_>) -> UnpackedChunk {
        self.buffer = buffer;
        let outcome = self.fill(packed);
        UnpackedChunk { buffer: std::mem::take(&mut self.buffer), outcome }
    }

    fn fill(&mut self, packed: &Packed<'_>) -> Result<(), UnpackError> {
        let Packed { compression, data, size, .. } = *packed;
        if compression != Compression::None {
            self.make_room(CHUNK, size, MAX_CHUNK_BYTES)?;
        }
        let buffer = &mut self.buffer;
        let unpacked = match compression {
            // The capacity limits zstd's output; only written bytes take memory.
            Compression::Zstd => self.zstd.decompress_to_buffer(data, buffer),
            _ => read_stream(compression, data, size.saturating_add(1), buffer),
        };
        unpacked.map_err(|source| UnpackError::Broken { part: CHUNK, source })?;
        packed.verify(packed.content(&self.buffer))
    }

    /// Start of a truncated chunk, as far as possible.
    pub(super) fn cut_chunk<'a>(
        &'a mut self,
        compression: Compression,
        data: &'a [u8],
        budget: &mut UnpackBudget,
    ) -> &'a [u8] {
        let buffer = &mut self.buffer;
        buffer.clear();
        if compression == Compression::None {
            return data;
        }
        let limit = budget.remaining().min(MAX_CHUNK_BYTES);
        let broken_off = read_stream(compression, data, limit, buffer);
        if compression == Compression::Bz2
            && broken_off.is_err_and(|error| error.kind() != io::ErrorKind::UnexpectedEof)
        {
            // A block is output before its checksum is verified, and a chunk rarely has two.
            buffer.clear();
        }
        budget.take(buffer.len() as u64);
        buffer
    }

    pub(super) fn message(
        &mut self,
        frame: &[u8],
        budget: &mut UnpackBudget,
    ) -> Result<&[u8], UnpackError> {
        const PART: &str = "message";
        let stated = zstd::zstd_safe::get_frame_content_size(frame).ok().flatten();
        let size = stated.unwrap_or(MAX_MESSAGE_BYTES);
        self.make_room(PART, size, MAX_MESSAGE_BYTES)?;
        budget.check(PART, stated.unwrap_or(1))?;
        let unpacked = self.zstd.decompress_to_buffer(frame, &mut self.buffer);
        budget.take(if unpacked.is_ok() { self.buffer.len() as u64 } else { size });
        unpacked.map_err(|source| UnpackError::Broken { part: PART, source })?;
        Ok(&self.buffer)
    }

    fn make_room(&mut self, part: &'static str, size: u64, limit: u64) -> Result<(), UnpackError> {
        let too_large = || UnpackError::TooLarge { part, size, limit };
        if size > limit {
            return Err(too_large());
        }
        self.buffer.clear();
        self.buffer.try_reserve_exact(size as usize).map_err(|_| too_large())
    }
}

/// Appends at most `limit` bytes to `buffer`. Those before an error stay in it.
fn read_stream(
    compression: Compression,
    data: &[u8],
    limit: u64,
    buffer: &mut Vec<u8>,
) -> io::Result<usize> {
    match compression {
        Compression::None => Ok(0),
        Compression::Zstd => {
            zstd::stream::read::Decoder::with_buffer(data)?.take(limit).read_to_end(buffer)
        }
        Compression::Lz4 => lz4::Decoder::new(data)?.take(limit).read_to_end(buffer),
        Compression::Bz2 => bzip2::bufread::BzDecoder::new(data).take(limit).read_to_end(buffer),
    }
}

pub(super) struct Unpacked {
    pub(super) file: Temporary,
    /// SQLite opens files by name only. An unnamed file disappears however the process ends.
    pub(super) path: Option<StagedFile>,
}

impl Unpacked {
    pub(super) fn create(head: &[u8]) -> io::Result<Self> {
        // SQLite cannot open files in memory either.
        #[cfg(not(target_arch = "wasm32"))]
        if head.starts_with(SQLITE_MAGIC) {
            return Self::named();
        }
        let _ = head;
        Ok(Self { file: temporary()?, path: None })
    }

    #[cfg(not(target_arch = "wasm32"))]
    fn named() -> io::Result<Self> {
        let path = StagedFile::new(|| Ok(tempfile::NamedTempFile::new()?.into_temp_path()))?;
        let file = Temporary::options().read(true).write(true).open(&*path)?;
        Ok(Self { file, path: Some(path) })
    }
}

/// Decompresses a zstd file of any size into a temporary file as far as possible; the inner error is why it
/// is incomplete. Reports archive bytes read to `at`.
///
/// # Errors
/// If the temporary file cannot be written.
pub(super) fn file(
    archive: &[u8],
    budget: &mut UnpackBudget,
    at: impl Fn(usize),
) -> io::Result<(Unpacked, Result<(), UnpackError>)> {
    const PART: &str = "archive";
    let broken = |source| UnpackError::Broken { part: PART, source };
    let mut stream = match zstd::stream::read::Decoder::with_buffer(archive) {
        Ok(stream) => stream,
        Err(source) => return Ok((Unpacked::create(&[])?, Err(broken(source)))),
    };
    let mut buffer = vec![0; 1 << 16];
    let mut unpacked = None;
    let end = loop {
        // The first piece contains the file's whole magic.
        let (length, end) = fill(&mut stream, &mut buffer);
        // Disk is scarcer than time.
        let cost = length as u64 * SLOW_OR_STORED_COST;
        if let Err(error) = budget.check(PART, cost) {
            break Err(error);
        }
        budget.take(cost);
        at(archive.len() - stream.get_ref().len());
        let piece = &buffer[..length];
        let unpacked = match &mut unpacked {
            Some(unpacked) => unpacked,
            none => none.insert(Unpacked::create(piece)?),
        };
        write_all(&mut unpacked.file, piece)?;
        match end {
            Ok(()) if length == buffer.len() => {}
            end => break end.map_err(broken),
        }
    };
    let mut unpacked = unpacked.map_or_else(|| Unpacked::create(&[]), Ok)?;
    unpacked.file.rewind()?;
    Ok((unpacked, end))
}

/// Returns the length and why it stopped early.
fn fill(stream: &mut impl Read, buffer: &mut [u8]) -> (usize, io::Result<()>) {
    let mut length = 0;
    while length < buffer.len() {
        match stream.read(&mut buffer[length..]) {
            Ok(0) => break,
            Ok(more) => length += more,
            Err(error) => return (length, Err(error)),
        }
    }
    (length, Ok(()))
}

fn write_all(file: &mut Temporary, bytes: &[u8]) -> io::Result<()> {
    file.write_all(bytes).map_err(|source| {
        io::Error::new(
            source.kind(),
            format!("cannot be decompressed to a temporary file: {source}"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn zeros(bytes: usize) -> Vec<u8> {
        zstd::bulk::compress(&vec![0; bytes], 1).unwrap()
    }

    fn packed(data: &[u8], size: u64) -> Packed<'_> {
        Packed { compression: Compression::Zstd, data, size, crc: 0 }
    }

    #[test]
    fn small_parts_share_the_unpacking_limit_of_the_file() {
        let (mut unpacker, mut budget) =
            (Unpacker::default(), UnpackBudget { limit: 2500, used: 0 });
        let part = zeros(1000);
        let packed = packed(&part, 1000);
        let mut unpack = || unpacker.chunk(&packed, &mut budget).is_ok();
        assert_eq!([unpack(), unpack(), unpack(), unpack()], [true, true, false, false]);
    }

    #[test]
    fn truncated_parts_are_charged_their_declared_size() {
        let (mut unpacker, mut budget) =
            (Unpacker::default(), UnpackBudget { limit: 2500, used: 0 });
        let mut part = zeros(1000);
        part.pop();
        for left in [1500, 500, 500] {
            assert!(unpacker.chunk(&packed(&part, 1000), &mut budget).is_err());
            assert_eq!(budget.remaining(), left);
        }
    }

    #[test]
    fn an_oversized_message_is_not_unpacked() {
        let (mut unpacker, mut budget) = (Unpacker::default(), UnpackBudget::for_file(1000, None));
        assert_eq!(unpacker.message(&zeros(70), &mut budget).unwrap(), [0; 70]);
        let error = unpacker.message(&zeros(65 << 20), &mut budget).unwrap_err();
        assert!(error.to_string().contains("larger than"), "{error}");
    }

    #[test]
    fn an_archive_is_unpacked_up_to_its_limit_or_damage() {
        let archive = zeros(300_000);
        let unpack = |archive: &[u8], limit: u64| {
            let limit = SLOW_OR_STORED_COST * limit;
            let (unpacked, end) =
                file(archive, &mut UnpackBudget { limit, used: 0 }, |_| ()).unwrap();
            (unpacked.file.metadata().unwrap().len(), end.is_ok())
        };
        assert_eq!(unpack(&archive, 1 << 20), (300_000, true));
        let (bytes, whole) = unpack(&archive, 200_000);
        assert!(bytes <= 200_000 && !whole);
        assert!(!unpack(&archive[..archive.len() - 3], 1 << 20).1);
        assert_eq!(unpack(b"\x28\xb5\x2f\xfd garbage", 1 << 20), (0, false));
    }

    #[test]
    fn only_a_database_is_a_named_file() {
        let unpack = |content: &[u8]| {
            let archive = zstd::bulk::compress(content, 1).unwrap();
            let read = std::cell::Cell::new(0);
            let (unpacked, end) =
                file(&archive, &mut UnpackBudget::for_file(1000, None), |at| read.set(at)).unwrap();
            assert!(end.is_ok() && read.get() == archive.len(), "{} bytes", read.get());
            unpacked.path.is_some()
        };
        assert!(unpack(b"SQLite format 3\0 and so on"));
        assert!(!unpack(b"\x89MCAP0\r\n and so on"));
    }
}
