use std::io;
use std::path::{Path, PathBuf};

use super::{Log, RemoteFault, SourceName};

const EXPECTED: &str = "an MCAP file, a ROS 1 bag, a rosbag2 bag, or a table: CSV, NPY, NPZ, Parquet, HDF5, \
     Zarr, TFRecord, LeRobot, Excel, JSON, YAML, MATLAB, TUM, EuRoC, KITTI, KUKA RSI";

/// What to do about [`LogError::PoseTimes`].
pub const POSE_TIMES_REMEDY: &str = "also pass the times file of the sequence (a time in s per pose), store \
     it as times.txt in the same folder, or set `rate_hz` in [columns] of the config";

/// What to do about [`LogError::ConfigurationColumns`].
pub const CONFIGURATION_COLUMNS_REMEDY: &str = "state the columns, as --columns 'q[6]:deg,xyz:mm' for one table, or as \
     --columns 'JOINTS.csv=q[6]:deg' --columns 'POSES.csv=xyz:mm' for two; each row is one configuration";

/// Reason why nothing could be read from the given files. Paths are as given.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file does not exist.
    #[error("{}: no such file", SourceName::from_path(path))]
    NotFound {
        /// Path.
        path: PathBuf,
    },
    /// The file is not readable.
    #[error("{}: permission denied", path.display())]
    Permission {
        /// Path.
        path: PathBuf,
    },
    /// Directory that does not contain exactly one recording.
    #[error("{}: is a directory {cause}; name the log files in it", path.display())]
    Directory {
        /// Path.
        path: PathBuf,
        /// Reason; follows "is a directory".
        cause: &'static str,
    },
    /// Directory with the logs of several runs.
    #[error("{}: is a directory with logs of several runs, or of one without its metadata.yaml", path.display())]
    Runs {
        /// Path.
        path: PathBuf,
    },
    /// The same file is given twice.
    #[error("{}: is given twice{}; name it once", path.display(), same_as(path, first))]
    Twice {
        /// Second path.
        path: PathBuf,
        /// First path.
        first: PathBuf,
    },
    /// A pipe, device or socket.
    #[error("{}: is not a regular file; save the log to a file first", path.display())]
    NotAFile {
        /// Path.
        path: PathBuf,
    },
    /// The operating system reported an error.
    #[error("{}: cannot be read: {source}", path.display())]
    Io {
        /// Path.
        path: PathBuf,
        /// Operating system error.
        source: io::Error,
    },
    /// The file has no bytes.
    #[error("{}: the file is empty (0 bytes); was the recording ever written?", path.display())]
    Empty {
        /// Path.
        path: PathBuf,
    },
    /// Known but unsupported format.
    #[error("{}: is {looks}, which is not supported; {instead}", path.display())]
    Unsupported {
        /// Path.
        path: PathBuf,
        /// Format with its article.
        looks: &'static str,
        /// Suggested action.
        instead: &'static str,
    },
    /// The file is not a log.
    #[error("{}: not a robot log: it looks like {looks}; expected {EXPECTED}", path.display())]
    NotALog {
        /// Path.
        path: PathBuf,
        /// Appearance of its first bytes.
        looks: &'static str,
    },
    /// Unpacked content cannot be stored in a temporary file.
    #[error("{}: cannot be stored in {}: {source}", path.display(), std::env::temp_dir().display())]
    Temporary {
        /// Path.
        path: PathBuf,
        /// Operating system error.
        source: io::Error,
    },
    /// An object in a store cannot be read.
    #[error("{}: {}; {}", url.display(), fault, fault.remedy())]
    Remote {
        /// Address without secrets.
        url: PathBuf,
        /// The reason.
        fault: RemoteFault,
    },
    /// The columns of a table are not identified.
    #[error("{}: {what}; declare it in [columns] of the config", path.display())]
    Columns {
        /// Path.
        path: PathBuf,
        /// The unidentified content.
        what: String,
    },
    /// The rows of a table have no times.
    #[error("{}: {what}; {}", path.display(), rate_remedy(*rows, *numbers))]
    NoTimes {
        /// Path.
        path: PathBuf,
        /// The reason.
        what: String,
        /// Number of rows.
        rows: usize,
        /// Numbers in a row.
        numbers: usize,
    },
    /// A given layout contradicts a table.
    #[error("{}: {what}; `_` ignores a column (docs/datasets.md)", path.display())]
    Layout {
        /// Path.
        path: PathBuf,
        /// The contradiction.
        what: String,
    },
    /// Rows of configurations that cannot be used.
    #[error("{}: {what}; {remedy}", path.display())]
    Configurations {
        /// Path.
        path: PathBuf,
        /// Why.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A table of configurations whose columns are unknown.
    #[error("{}: {what}; {CONFIGURATION_COLUMNS_REMEDY}", path.display())]
    ConfigurationColumns {
        /// Path.
        path: PathBuf,
        /// The reason.
        what: String,
    },
    /// KITTI poses without the times of their rows.
    #[error("{}: {what}; {POSE_TIMES_REMEDY}", path.display())]
    PoseTimes {
        /// Path.
        path: PathBuf,
        /// The reason.
        what: String,
    },
    /// A dataset has more episodes than an audit accepts.
    #[error(
        "{}: has more than {most} episodes; select one as FILE#EPISODE, or audit each with `poseaudit fleet`",
        path.display()
    )]
    Episodes {
        /// Path.
        path: PathBuf,
        /// Maximum number of episodes.
        most: usize,
    },
    /// Logs without a readable message.
    #[error("{}: no messages can be read: {cause}", path.display())]
    NoMessages {
        /// First of the files.
        path: PathBuf,
        /// First damage, or that nothing was recorded.
        cause: String,
    },
}

impl LogError {
    pub(super) fn io(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound { path },
            io::ErrorKind::PermissionDenied => Self::Permission { path },
            _ => Self::Io { path, source },
        }
    }

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

/// What to do about a table without times, with these rows and numbers in each.
pub fn rate_remedy(rows: usize, numbers: usize) -> String {
    format!(
        "state its {numbers} columns with --columns, as q[6] for joints, xyz and rotvec for a pose and _[2] for two others \
         (without joints, poses are compared only with other poses), and end with the true rows per second, as @30; or set \
         `rate_hz = 30` in [columns] of the config, or pass a file with the times of the {rows} rows as well; if each row is \
         a configuration at rest, use `poseaudit calibrate` without a rate"
    )
}

/// Mentions the first path of a repeated file, if it differs.
fn same_as(path: &Path, first: &Path) -> String {
    if path == first { String::new() } else { format!(", first as {}", first.display()) }
}
