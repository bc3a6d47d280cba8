//! Files in memory.

#[cfg(not(target_arch = "wasm32"))]
#[path = "mapped/disk.rs"]
mod place;
#[cfg(target_arch = "wasm32")]
#[path = "mapped/memory.rs"]
mod place;

use std::fs::{self, File};
use std::io;
use std::path::Path;

use bytes::Bytes;

use super::LogError;

pub(super) use self::place::{Temporary, advise, temporary};

/// A file in memory.
pub(super) struct Mapped(Bytes);

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
        place::map(&file, metadata.len()).map(Self).map_err(io_error)
    }

    /// The content of the file at `path`, which the caller has.
    pub(super) fn given(path: &Path, content: &Bytes) -> Result<Self, LogError> {
        match content.is_empty() {
            true => Err(LogError::Empty { path: path.to_owned() }),
            false => Ok(Self(content.clone())),
        }
    }

    /// What was kept and nobody else knows.
    pub(super) fn of(kept: &Temporary) -> io::Result<Self> {
        let mapped = place::kept(kept).map(Self)?;
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
