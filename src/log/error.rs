use std::io;
use std::path::{Path, PathBuf};

use super::Log;

/// Why nothing could be read from the files given.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// There is no such file.
    #[error("{}: no such file", path.display())]
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
    /// The path is a directory.
    #[error("{}: is a directory; name the log files in it", path.display())]
    Directory {
        /// The path as given.
        path: PathBuf,
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
    #[error("{}: not a robot log: it looks like {looks}; expected an MCAP file", path.display())]
    NotALog {
        /// The path as given.
        path: PathBuf,
        /// What its first bytes look like.
        looks: &'static str,
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
                cause: format!("byte {}: {}", loss.offset, loss.what),
            },
            None => Self::NoMessages { path, cause: "none were recorded".to_owned() },
        }
    }
}
