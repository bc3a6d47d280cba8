//! Content read from the files of one run.

use std::path::PathBuf;

use ground::stream::Columns;
use ground::time::Stamp;

/// Everything read from the files of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// Files, in the order given.
    pub files: Vec<LogFile>,
    /// Topics of all files, sorted by name.
    pub topics: Vec<Topic>,
    /// Robot descriptions and calibrations from attachments and metadata.
    pub descriptions: Vec<Description>,
    /// Number of messages read, of any type.
    pub messages: u64,
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
    /// Damage, in the order of files and offsets.
    pub losses: Vec<Loss>,
    /// Remarks about the files that are not damage.
    pub notes: Vec<Note>,
    /// Contradictions between declarations and numbers. `None` if nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// Duplicate or constant table columns. `None` without tables.
    pub repeats: Option<Vec<Repeat>>,
    /// Robot type according to metadata.
    pub robot_type: Option<String>,
    /// Column of a table identified as times by its numbers.
    pub time_column: Option<String>,
    /// Question about undetermined table columns, asked if no arm is found.
    pub question: Option<String>,
}

impl Log {
    /// Whether the log contains `/clock`, which indicates simulation time.
    pub fn has_clock(&self) -> bool {
        self.topics.iter().any(|topic| topic.name.trim_start_matches('/') == "clock")
    }
}

/// One file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct LogFile {
    /// Path as given; for a file in a folder, the folder's path and its name.
    pub path: PathBuf,
    /// Kind of file.
    pub container: Container,
    /// Size of the file.
    pub bytes: u64,
    /// Number of bytes fetched to read it. `None` for a local file.
    pub fetched: Option<u64>,
    /// Checksum coverage of its messages.
    pub crc: Crc,
}

/// Kind of a log file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Container {
    /// An MCAP file.
    Mcap,
    /// A ROS 1 bag, version 2.0.
    RosBag1,
    /// A rosbag2 SQLite database.
    RosBag2Sqlite,
    /// An MCAP file of a rosbag2 folder.
    RosBag2Mcap,
    /// Output of Universal Robots' RTDE client.
    RtdeCsv,
    /// Any other text table.
    Csv,
    /// A NumPy array.
    Npy,
    /// An archive of NumPy arrays.
    Npz,
    /// A Parquet file, from a LeRobot dataset or elsewhere.
    Parquet,
    /// An HDF5 file.
    Hdf5,
    /// A Zarr store, as a folder or zip archive.
    Zarr,
    /// TFRecord with TensorFlow examples.
    TfRecord,
    /// Packets of KUKA's Robot Sensor Interface.
    Rsi,
}

impl Container {
    /// Name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Container::Mcap => "mcap",
            Container::RosBag1 => "rosbag1",
            Container::RosBag2Sqlite => "rosbag2-sqlite",
            Container::RosBag2Mcap => "rosbag2-mcap",
            Container::RtdeCsv => "rtde-csv",
            Container::Csv => "csv",
            Container::Npy => "npy",
            Container::Npz => "npz",
            Container::Parquet => "parquet",
            Container::Hdf5 => "hdf5",
            Container::Zarr => "zarr",
            Container::TfRecord => "tfrecord",
            Container::Rsi => "kuka-rsi",
        }
    }
}

/// Share of a file's messages covered by a verified checksum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Crc {
    /// All messages read.
    All,
    /// Some of them.
    Partial,
    /// None of them.
    None,
}

impl Crc {
    /// Coverage if checksums hold for `covered` of `read` messages.
    pub(super) fn from_counts(covered: u64, read: u64) -> Self {
        match covered {
            0 => Crc::None,
            covered if covered < read => Crc::Partial,
            _ => Crc::All,
        }
    }

    /// Name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Crc::All => "all",
            Crc::Partial => "partial",
            Crc::None => "none",
        }
    }
}

/// One topic over all files.
#[derive(Clone, Debug, PartialEq)]
pub struct Topic {
    /// Topic name.
    pub name: String,
    /// Type name as in the log, such as `sensor_msgs/msg/JointState`; empty without a schema.
    pub type_name: String,
    /// Encoding of the messages, such as `cdr`.
    pub encoding: String,
    /// Number of messages read, decoded or not.
    pub messages: u64,
    /// Decoded content. `None` for types that an audit does not use, or if no message could be decoded.
    pub columns: Option<Columns>,
    /// Undecodable messages of a type that an audit uses.
    pub undecodable: Option<Undecodable>,
    /// Reason why there are no columns although messages could be decoded.
    pub unusable: Option<String>,
    /// Interpretation of its columns, for tables without a schema.
    pub read_as: Option<String>,
    /// Table columns it consists of, in order.
    pub cells: Vec<TableCell>,
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
}

/// One number in the rows of a table.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TableCell {
    /// Index of its column in the table and of the number within the column.
    pub at: (usize, usize),
    /// Name in `[columns]` of a config.
    pub name: String,
    /// Encoding indicated by the names of its rotation, if it belongs to one.
    pub labels: Option<RotationLabels>,
    /// Whether its name is meaningless and it is measured, with changing fractional values.
    pub is_unidentified: bool,
}

/// Names of rotation components that indicate the encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RotationLabels {
    /// qx, qy, qz, qw, in any order.
    Quaternion,
    /// roll, pitch, yaw.
    RollPitchYaw,
    /// A, B, C as used by KUKA, Doosan and others.
    Abc,
    /// FANUC's W, P, R.
    Wpr,
    /// Kawasaki's O, A, T.
    Oat,
    /// A rotation vector.
    RotationVector,
}

/// Messages of one topic that could not be decoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Undecodable {
    /// Number of messages.
    pub messages: u64,
    /// Error of the first one, in one line.
    pub first: String,
}

/// Robot description or UR calibration in the log outside messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the attachment or metadata entry.
    pub name: String,
    /// Text: URDF XML or calibration YAML.
    pub text: String,
}

/// Part of a file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The file.
    pub file: PathBuf,
    /// Offset of the damage in the file, in bytes. `None` if it has no single position.
    pub offset: Option<u64>,
    /// Description, in one line.
    pub what: String,
    /// Number of lost messages. `None` if unknown.
    pub messages: Option<u64>,
    /// First and last log time of the lost content. `None` if unknown.
    pub span: Option<(Stamp, Stamp)>,
    /// Kind of content lost.
    pub extent: Extent,
}

/// Remark about a file that is not damage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// The file.
    pub file: PathBuf,
    /// The remark, in one line.
    pub what: String,
}

/// Table columns that duplicate others bit by bit or never change.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Repeat {
    /// Topic of the columns.
    pub topic: String,
    /// The joint, if it is one of several numbers.
    pub number: Option<String>,
    /// Topic or joint that it duplicates. `None` if it is constant.
    pub of: Option<String>,
}

/// Content affected by a [`Loss`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Extent {
    /// Index, summary, footer or an attachment; no messages.
    Index,
    /// End of the file within its last record, for example because the recorder was killed.
    Tail,
    /// Messages within the file.
    Messages,
    /// Content that is skipped by default but not damaged.
    Unread,
    /// Messages that were read, but of a segment that cannot be audited.
    Unaudited,
}
