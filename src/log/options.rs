//! How to read.

use std::sync::Arc;

use super::progress::Progress;
use super::tables::ColumnSettings;

/// How to read.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Check every checksum in the files, also where that takes another pass over the bytes.
    pub verify: bool,
    /// What the compressed parts of a file may unpack to, GiB, where that is more than would be unpacked
    /// otherwise.
    pub max_unpacked_gib: Option<u32>,
    /// What the caller says of the columns of tables.
    pub columns: ColumnSettings,
    /// Kept up to date while the files are read.
    pub progress: Option<Arc<Progress>>,
}

impl ReadOptions {
    /// Says how far the file that is being read was read.
    pub(super) fn at(&self, offset: usize) {
        if let Some(progress) = &self.progress {
            progress.at(offset as u64);
        }
    }
}
