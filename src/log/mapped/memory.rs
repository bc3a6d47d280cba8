//! Replacement for platforms without files, such as browsers.

use std::fs::File;
use std::io::{self, Cursor};

use bytes::Bytes;

pub(crate) type Temporary = Cursor<Vec<u8>>;

#[expect(clippy::unnecessary_wraps, reason = "fallible on disk")]
pub(crate) fn temporary() -> io::Result<Temporary> {
    Ok(Cursor::default())
}

#[expect(clippy::unnecessary_wraps, reason = "fallible on disk")]
pub(super) fn share_bytes(memory: &Temporary) -> io::Result<Bytes> {
    Ok(Bytes::copy_from_slice(memory.get_ref()))
}

pub(super) fn map(_: &File, _: u64) -> io::Result<Bytes> {
    Err(io::ErrorKind::Unsupported.into())
}

pub(crate) fn advise(_: &[u8], _: super::AccessPattern) {}
