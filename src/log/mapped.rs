#[cfg(not(target_arch = "wasm32"))]
#[path = "mapped/disk.rs"]
mod platform;
#[cfg(target_arch = "wasm32")]
#[path = "mapped/memory.rs"]
mod platform;

use std::fs::{self, File};
use std::io;
use std::path::Path;

use bytes::Bytes;

use super::LogError;

pub(super) use self::platform::{Temporary, advise, temporary};

pub(super) struct MappedFile(Bytes);

impl AsRef<[u8]> for MappedFile {
    fn as_ref(&self) -> &[u8] {
        self.bytes()
    }
}

impl MappedFile {
    pub(super) fn open(path: &Path) -> Result<Self, LogError> {
        let io_error = |source: io::Error| LogError::io(path, source);
        // Check before opening: a pipe would block.
        let metadata = fs::metadata(path).map_err(io_error)?;
        if !metadata.is_file() {
            return Err(LogError::NotAFile { path: path.to_owned() });
        }
        let file = File::open(path).map_err(io_error)?;
        if metadata.len() == 0 {
            return Err(LogError::Empty { path: path.to_owned() });
        }
        platform::map(&file, metadata.len()).map(Self).map_err(io_error)
    }

    pub(super) fn from_content(path: &Path, content: &Bytes) -> Result<Self, LogError> {
        match content.is_empty() {
            true => Err(LogError::Empty { path: path.to_owned() }),
            false => Ok(Self(content.clone())),
        }
    }

    pub(super) fn from_temporary(kept: &Temporary) -> io::Result<Self> {
        let mapped = platform::share_bytes(kept).map(Self)?;
        if mapped.bytes().is_empty() {
            Err(io::ErrorKind::UnexpectedEof.into())
        } else {
            Ok(mapped)
        }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum AccessPattern {
    /// Distant positions, without the bytes between them.
    Scattered,
    Whole,
}
