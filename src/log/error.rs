use std::io;
use std::path::{Path, PathBuf};

use super::{Log, RemoteFault, SourceName};

/// What can be read.
const EXPECTED: &str = "an MCAP file, a ROS 1 bag, a rosbag2 bag, or a table: CSV, NPY, NPZ, Parquet, HDF5, \
     Zarr, TFRecord, LeRobot, KUKA RSI";

/// Why nothing could be read from the files given.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// There is no such file.
    #[error("{}: no such file", SourceName::of(path))]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// The file may not be read.
    #[error("{}: permission denied", path.display())]
    Permission {
        /// The path as given.
        path: PathBuf,
    },
    /// The path is a directory, but not of one recording.
    #[error("{}: is a directory {cause}; name the log files in it", path.display())]
    Directory {
        /// The path as given.
        path: PathBuf,
        /// Why it is not read, after "is a directory".
        cause: &'static str,
    },
    /// The same file is among the files more than once.
    #[error("{}: is given twice{}; name it once", path.display(), same_as(path, first))]
    Twice {
        /// The path as given the second time.
        path: PathBuf,
        /// The path as given the first time.
        first: PathBuf,
    },
    /// The path is a pipe, a device or a socket.
    #[error("{}: is not a regular file; save the log to a file first", path.display())]
    NotAFile {
        /// The path as given.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// The path as given.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file has no bytes.
    #[error("{}: the file is empty (0 bytes); was the recording ever written?", path.display())]
    Empty {
        /// The path as given.
        path: PathBuf,
    },
    /// The file is of a known kind that is not read here.
    #[error("{}: is {looks}, which is not supported; {instead}", path.display())]
    Unsupported {
        /// The path as given.
        path: PathBuf,
        /// What it is, with its article.
        looks: &'static str,
        /// What to do about it.
        instead: &'static str,
    },
    /// The file is no log.
    #[error("{}: not a robot log: it looks like {looks}; expected {EXPECTED}", path.display())]
    NotALog {
        /// The path as given.
        path: PathBuf,
        /// What its first bytes look like.
        looks: &'static str,
    },
    /// What is unpacked cannot be kept in a temporary file.
    #[error("{}: cannot be kept in {}: {source}", path.display(), std::env::temp_dir().display())]
    Temporary {
        /// The path as given.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// An object in a store cannot be read.
    #[error("{}: {}; {}", url.display(), fault, fault.remedy())]
    Remote {
        /// Its address, without what may be secret in it.
        url: PathBuf,
        /// Why not.
        fault: RemoteFault,
    },
    /// A table of which nothing says what its columns are.
    #[error("{}: {what}; say it in [columns] of the config", path.display())]
    Columns {
        /// The path as given.
        path: PathBuf,
        /// What is not known.
        what: String,
    },
    /// A dataset of more episodes than one audit takes.
    #[error(
        "{}: holds more than {most} episodes; name one as FILE#EPISODE, or audit each with `poseaudit fleet`",
        path.display()
    )]
    Episodes {
        /// The path as given.
        path: PathBuf,
        /// How many an audit takes.
        most: usize,
    },
    /// The files are logs, but no message can be read from them.
    #[error("{}: no messages can be read: {cause}", path.display())]
    NoMessages {
        /// The first of the files.
        path: PathBuf,
        /// The first damage, or that none were recorded.
        cause: String,
    },
}

impl LogError {
    /// The error for what the operating system said about `path`.
    pub(super) fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound { path },
            io::ErrorKind::PermissionDenied => Self::Permission { path },
            _ => Self::Io { path, source },
        }
    }

    /// The error for a log of which no message could be read.
    pub(super) fn no_messages(log: &Log) -> Self {
        let path = log.files.first().map(|file| file.path.clone()).unwrap_or_default();
        match log.losses.first() {
            Some(loss) => Self::NoMessages {
                path: loss.file.clone(),
                cause: match loss.offset {
                    Some(offset) => format!("byte {offset}: {}", loss.what),
                    None => loss.what.clone(),
                },
            },
            None => Self::NoMessages { path, cause: "none were recorded".to_owned() },
        }
    }
}

/// Under which other path a file was given, if under another.
fn same_as(path: &Path, first: &Path) -> String {
    if path == first { String::new() } else { format!(", first as {}", first.display()) }
}
