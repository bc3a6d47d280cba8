//! Options for reading.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;

use super::progress::Progress;
use super::tables::ColumnSettings;

/// Options for reading.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Verify every checksum, even if that takes another pass over the bytes.
    pub verify: bool,
    /// Decompression limit per file, GiB, if higher than the default.
    pub max_unpacked_gib: Option<u32>,
    /// Column mapping of tables, given by the caller.
    pub columns: ColumnSettings,
    /// Files supplied by the caller: content by path. The disk is not accessed for these paths.
    pub given: BTreeMap<PathBuf, Bytes>,
    /// Progress, updated while files are read.
    pub progress: Option<Arc<Progress>>,
}

impl ReadOptions {
    /// Sets the current activity.
    pub fn set_activity(&self, doing: &'static str) {
        if let Some(progress) = &self.progress {
            progress.set_activity(doing);
        }
    }

    /// Sets the position in the current file.
    pub(super) fn set_position(&self, offset: usize) {
        if let Some(progress) = &self.progress {
            progress.set_position(offset as u64);
        }
    }
}
