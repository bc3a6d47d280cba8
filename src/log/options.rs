//! How to read.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;

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
    /// Files that the caller has: their content by the path that names them among the logs. Nothing is looked
    /// for at these paths.
    pub given: BTreeMap<PathBuf, Bytes>,
    /// Kept up to date while the files are read.
    pub progress: Option<Arc<Progress>>,
}

impl ReadOptions {
    /// Says what is done from now on.
    pub fn begins(&self, doing: &'static str) {
        if let Some(progress) = &self.progress {
            progress.begins(doing);
        }
    }

    /// Says how far the file that is being read was read.
    pub(super) fn at(&self, offset: usize) {
        if let Some(progress) = &self.progress {
            progress.at(offset as u64);
        }
    }
}
