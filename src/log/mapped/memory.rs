//! In-memory replacement for platforms without a file system, such as browsers.

use std::fs::File;
use std::io::{self, Cursor};

use bytes::Bytes;

/// Temporary data.
pub(crate) type Temporary = Cursor<Vec<u8>>;

/// Creates an empty buffer.
#[expect(clippy::unnecessary_wraps, reason = "fallible on disk")]
pub(crate) fn temporary() -> io::Result<Temporary> {
    Ok(Cursor::default())
}

/// Returns all that was written.
#[expect(clippy::unnecessary_wraps, reason = "fallible on disk")]
pub(super) fn kept(memory: &Temporary) -> io::Result<Bytes> {
    Ok(Bytes::copy_from_slice(memory.get_ref()))
}

/// Files cannot be mapped here.
pub(super) fn map(_: &File, _: u64) -> io::Result<Bytes> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Does nothing; memory needs no advice.
pub(crate) fn advise(_: &[u8], _: super::AccessPattern) {}
