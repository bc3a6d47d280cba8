//! Files of a disk, mapped.
#![allow(unsafe_code, reason = "files are mapped")]

use std::fs::File;
use std::io;

use bytes::Bytes;
use memmap2::MmapOptions;

use super::Looks;

/// What is kept for a while, and goes with the process.
pub(crate) type Temporary = File;

/// An empty one.
pub(crate) fn temporary() -> io::Result<Temporary> {
    tempfile::tempfile()
}

/// All of a temporary file that was written.
pub(super) fn kept(file: &Temporary) -> io::Result<Bytes> {
    // SAFETY: the map is read-only, and nobody else writes to the file.
    unsafe { MmapOptions::new().map(file) }.map(Bytes::from_owner)
}

/// A file of `bytes`.
pub(super) fn map(file: &File, bytes: u64) -> io::Result<Bytes> {
    // SAFETY: the map is read-only and lives only while its file is decoded. Another process that
    // shortens the file meanwhile ends this one with SIGBUS, as with any memory-mapped reader.
    unsafe { MmapOptions::new().len(worth_reading(file, bytes)).map(file) }.map(Bytes::from_owner)
}

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

/// Tells the system how `bytes` will be looked at. That is advice: whatever comes of it, they are the same.
#[cfg(target_os = "linux")]
pub(crate) fn advise(bytes: &[u8], looks: Looks) {
    /// Where pages are larger the system refuses the advice.
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
pub(crate) fn advise(_: &[u8], _: Looks) {}
