use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;

use super::progress::Progress;
use super::tables::ColumnSettings;

/// Options for reading.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Verify every checksum, even in another pass.
    pub verify: bool,
    /// Decompression limit per file, GiB, if above the default.
    pub max_unpacked_gib: Option<u32>,
    /// Column mapping of tables.
    pub columns: ColumnSettings,
    /// Content supplied by the caller, by path. The disk is not accessed for these paths.
    pub given: BTreeMap<PathBuf, Bytes>,
    /// Updated while files are read.
    pub progress: Option<Arc<Progress>>,
}

impl ReadOptions {
    /// Sets the current activity.
    pub fn set_activity(&self, doing: &'static str) {
        if let Some(progress) = &self.progress {
            progress.set_activity(doing);
        }
    }

    pub(super) fn set_position(&self, offset: usize) {
        if let Some(progress) = &self.progress {
            progress.set_position(offset as u64);
        }
    }
}
