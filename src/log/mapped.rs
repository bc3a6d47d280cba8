//! Files in memory.
#![allow(unsafe_code, reason = "files are mapped")]

use std::fs::{self, File};
use std::io;
use std::path::Path;

use memmap2::{Mmap, MmapOptions};

use super::LogError;

/// How much of a file of `bytes` is mapped: of a hole at its end, which reads as zeros and is of no
/// length, not more than tells that there are zeros.
#[cfg(target_os = "linux")]
fn worth_reading(file: &File, bytes: u64) -> usize {
    use std::os::fd::AsRawFd;
    const ZEROS: u64 = 1 << 20;
    /// Holes beyond which a file is not searched.
    const MOST: usize = 1000;
    let whole = usize::try_from(bytes).unwrap_or(usize::MAX);
    // SAFETY: the call moves the offset of a file that is never read by it.
    let seek = |from: u64, to| unsafe {
        let found = libc::lseek64(file.as_raw_fd(), i64::try_from(from).unwrap_or(i64::MAX), to);
        u64::try_from(found).ok()
    };
    let mut from = 0;
    for _ in 0..MOST {
        let Some(hole) = seek(from, libc::SEEK_HOLE).filter(|hole| *hole < bytes) else {
            return whole;
        };
        match seek(hole, libc::SEEK_DATA) {
            Some(data) if data > hole => from = data,
            _ => return whole.min(usize::try_from(hole + ZEROS).unwrap_or(whole)),
        }
    }
    whole
}

#[cfg(not(target_os = "linux"))]
fn worth_reading(_: &File, bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

/// A file in memory.
pub(super) struct Mapped(Mmap);

impl AsRef<[u8]> for Mapped {
    fn as_ref(&self) -> &[u8] {
        self.bytes()
    }
}

impl Mapped {
    /// Maps a file into memory, or says in one line why it cannot be read.
    pub(super) fn open(path: &Path) -> Result<Self, LogError> {
        let io_error = |source: io::Error| LogError::io(path, source);
        // Before it is opened: a pipe would wait for somebody to write to it.
        let metadata = fs::metadata(path).map_err(io_error)?;
        if !metadata.is_file() {
            return Err(LogError::NotAFile { path: path.to_owned() });
        }
        let file = File::open(path).map_err(io_error)?;
        if metadata.len() == 0 {
            return Err(LogError::Empty { path: path.to_owned() });
        }
        // SAFETY: the map is read-only and lives only while its file is decoded. Another process
        // that shortens the file meanwhile ends this one with SIGBUS, as with any memory-mapped
        // reader.
        unsafe { MmapOptions::new().len(worth_reading(&file, metadata.len())).map(&file) }
            .map(Self)
            .map_err(io_error)
    }

    /// Maps an open file that nobody else knows.
    pub(super) fn of(file: &File) -> io::Result<Self> {
        // SAFETY: the map is read-only, and nobody else writes to the file.
        let mapped = unsafe { Mmap::map(file) }.map(Self)?;
        if mapped.bytes().is_empty() {
            Err(io::ErrorKind::UnexpectedEof.into())
        } else {
            Ok(mapped)
        }
    }

    /// Its content.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }
}

/// How parts of a file in memory will be looked at.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Looks {
    /// At single places far from each other: what is between them shall not be read from the disk.
    Scattered,
    /// At all of it, soon.
    Whole,
}

/// Tells the system how `bytes` will be looked at. That is advice: whatever comes of it, they are the same.
#[cfg(target_os = "linux")]
pub(super) fn advise(bytes: &[u8], looks: Looks) {
    /// Or a multiple of it, of which the system tells nothing but an error.
    const PAGE: usize = 1 << 12;
    let advice = match looks {
        Looks::Scattered => libc::MADV_RANDOM,
        Looks::Whole => libc::MADV_WILLNEED,
    };
    let before = bytes.as_ptr().addr() % PAGE;
    let start = bytes.as_ptr().wrapping_sub(before).cast_mut().cast();
    // SAFETY: neither advice changes what is in memory, and the call looks at no byte.
    let _advice = unsafe { libc::madvise(start, before + bytes.len(), advice) };
}

#[cfg(not(target_os = "linux"))]
pub(super) fn advise(_: &[u8], _: Looks) {}
