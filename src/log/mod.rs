//! Reads log files into columns. A file's format is identified by its bytes, never by its name. Each
//! container passes schemas and messages to one `Intake`; the registry in `decode` lists the types with
//! columns.
//!
//! Intact parts of a damaged file are read. Damage becomes a [`Loss`], an undecodable topic
//! [`Undecodable`], and a fully unreadable file a [`LogError`].
#![warn(missing_docs, clippy::unwrap_used)]
#![cfg_attr(target_arch = "wasm32", allow(dead_code, reason = "used by the database reader"))]

mod calibration_table;
mod chunk_pool;
mod containment;
mod contents;
mod decode;
mod error;
mod file_format;
mod files;
mod follow;
mod intake;
mod losses;
mod mapped;
mod mcap;
mod memory_budget;
mod name;
mod options;
mod part;
mod progress;
mod ranges;
mod reading;
mod remote;
mod rosbag1;
mod rosbag2;
mod rtde;
#[cfg(test)]
mod seeds;
mod spans;
mod tables;
#[cfg(test)]
mod testing;
mod topic;
mod unpack;

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use self::file_format::FileFormat;
use self::tables::TableFormat;

pub use self::calibration_table::{
    CalibrationTable, NumberTable, RotationColumns, not_configurations, read_calibration_points,
    read_calibration_table, read_calibration_tables, read_number_table,
};
pub use self::contents::{
    Cell, Container, Crc, Description, Extent, Log, LogFile, Loss, Note, Repeat, RotationLabels,
    TableCell, TableNumber, TableShape, Topic, Undecodable,
};
pub use self::error::{CONFIGURATION_COLUMNS_REMEDY, LogError, POSE_TIMES_REMEDY, rate_remedy};
pub use self::follow::{Growth, LogFollower};
pub use self::name::ESCAPED;
pub use self::name::SourceName;
pub use self::options::ReadOptions;
pub use self::progress::Progress;
pub use self::reading::open;
pub use self::remote::{RemoteFault, RemoteObject, is_url, list, normalize_url};
pub use self::tables::{
    COMMAND_WORDS, ColumnSelector, ColumnSettings, DeclaredPose, FileLayout, LayoutError,
    LayoutItem, Meaning, RowLayout, enclosing_dataset, episodes, is_dataset, is_store,
    split_episode, store_files,
};

/// Local file named by `path` or a `file://` URL. `None` for an object in a store.
pub fn local(path: &Path) -> Option<PathBuf> {
    let is_url = is_url(path);
    (!is_url).then(|| remote::local(path).unwrap_or_else(|| path.to_owned()))
}

/// Leading bytes that [`looks_like_log`] needs.
pub const HEAD_BYTES: u64 = 4096;

/// Whether the file starts like a table.
pub fn is_table(path: &Path) -> bool {
    is_store(path) || matches!(detect_file_format(path), Some(FileFormat::Table(_)))
}

/// Files read together with the log file at `path`, whether they exist or not.
pub fn sidecars(path: &Path) -> Vec<PathBuf> {
    match detect_file_format(path) {
        Some(FileFormat::Sqlite) => {
            ["-wal", "-shm", "-journal"].map(|end| rosbag2::beside(path, end)).into()
        }
        Some(FileFormat::Table(TableFormat::TfRecord)) => tables::declared_beside(path),
        Some(FileFormat::Table(TableFormat::Kitti)) => tables::pose_times_beside(path),
        _ => Vec::new(),
    }
}

fn detect_file_format(path: &Path) -> Option<FileFormat> {
    read_head(path).map(|head| file_format::detect_format(&head))
}

/// First bytes of a regular file.
fn read_head(path: &Path) -> Option<Vec<u8>> {
    let is_file = std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file());
    let mut head = Vec::new();
    let mut read = is_file.then(|| File::open(path).ok()).flatten()?.take(HEAD_BYTES);
    read.read_to_end(&mut head).ok()?;
    Some(head)
}

/// Whether a file starting with `head` may be a log. A zstd archive must be read to know.
pub fn looks_like_log(head: &[u8]) -> bool {
    match file_format::detect_format(head) {
        FileFormat::Known { .. } | FileFormat::Unknown { .. } => false,
        // A table without times may be anything.
        FileFormat::Table(TableFormat::Csv) => tables::column_names(head).is_some(),
        FileFormat::Table(TableFormat::Json) => tables::has_record_times(head),
        // A list of times, or the settings of anything.
        FileFormat::Table(TableFormat::Times | TableFormat::Yaml) => false,
        _ => true,
    }
}
