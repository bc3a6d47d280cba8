//! The same where there is no disk, as in a browser.

use std::fs::File;
use std::io::{self, Cursor};

use bytes::Bytes;

/// What is kept for a while.
pub(crate) type Temporary = Cursor<Vec<u8>>;

/// An empty one.
#[expect(clippy::unnecessary_wraps, reason = "on a disk it may fail")]
pub(crate) fn temporary() -> io::Result<Temporary> {
    Ok(Cursor::default())
}

/// All that was written.
#[expect(clippy::unnecessary_wraps, reason = "on a disk it may fail")]
pub(super) fn kept(memory: &Temporary) -> io::Result<Bytes> {
    Ok(Bytes::copy_from_slice(memory.get_ref()))
}

/// There is no file to be had.
pub(super) fn map(_: &File, _: u64) -> io::Result<Bytes> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Memory is looked at in any way.
pub(crate) fn advise(_: &[u8], _: super::Looks) {}
