#![allow(unsafe_code, reason = "files are mapped")]

use std::fs::File;
use std::io;

use bytes::Bytes;
use memmap2::MmapOptions;

use super::AccessPattern;

/// Deleted with the process.
pub(crate) type Temporary = File;

pub(crate) fn temporary() -> io::Result<Temporary> {
    tempfile::tempfile()
}

pub(super) fn share_bytes(file: &Temporary) -> io::Result<Bytes> {
    // SAFETY: the map is read-only, and no other process writes to the file.
    unsafe { MmapOptions::new().map(file) }.map(Bytes::from_owner)
}

pub(super) fn map(file: &File, bytes: u64) -> io::Result<Bytes> {
    // SAFETY: the map is read-only and exists only while its file is decoded. If another process truncates
    // the file, this process ends with SIGBUS, as with any memory-mapped reader.
    unsafe { MmapOptions::new().len(worth_reading(file, bytes)).map(file) }.map(Bytes::from_owner)
}

/// Number of bytes to map. A sparse hole at the end is shortened, but remains detectable as zeros.
#[cfg(target_os = "linux")]
fn worth_reading(file: &File, bytes: u64) -> usize {
    use std::os::fd::AsRawFd;
    const KEPT_ZERO_BYTES: u64 = 1 << 20;
    const MAX_HOLES: usize = 1000;
    let whole = usize::try_from(bytes).unwrap_or(usize::MAX);
    // SAFETY: the call only moves the offset of the file, which is not used for reading.
    let seek = |from: u64, to| unsafe {
        let found = libc::lseek64(file.as_raw_fd(), i64::try_from(from).unwrap_or(i64::MAX), to);
        u64::try_from(found).ok()
    };
    let mut from = 0;
    for _ in 0..MAX_HOLES {
        let Some(hole) = seek(from, libc::SEEK_HOLE).filter(|hole| *hole < bytes) else {
            return whole;
        };
        match seek(hole, libc::SEEK_DATA) {
            Some(data) if data > hole => from = data,
            _ => return whole.min(usize::try_from(hole + KEPT_ZERO_BYTES).unwrap_or(whole)),
        }
    }
    whole
}

#[cfg(not(target_os = "linux"))]
fn worth_reading(_: &File, bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

#[cfg(target_os = "linux")]
pub(crate) fn advise(bytes: &[u8], looks: AccessPattern) {
    /// The system rejects the advice if its pages are larger.
    const PAGE_BYTES: usize = 1 << 12;
    let advice = match looks {
        AccessPattern::Scattered => libc::MADV_RANDOM,
        AccessPattern::Whole => libc::MADV_WILLNEED,
    };
    let before = bytes.as_ptr().addr() % PAGE_BYTES;
    let start = bytes.as_ptr().wrapping_sub(before).cast_mut().cast();
    // SAFETY: neither advice changes memory, and the call does not access it.
    let _advice = unsafe { libc::madvise(start, before + bytes.len(), advice) };
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn advise(_: &[u8], _: AccessPattern) {}
