//! What was read from the files of one run.

use std::path::PathBuf;

use ground::stream::Columns;
use ground::time::Stamp;

/// All that was read from the files of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// The files, in the order given.
    pub files: Vec<LogFile>,
    /// The topics of all files, in the order of their names.
    pub topics: Vec<Topic>,
    /// Robot descriptions and calibrations found beside the messages, in attachments and metadata.
    pub descriptions: Vec<Description>,
    /// Messages read, of whatever type.
    pub messages: u64,
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
    /// What was damaged, in the order of the files and of the bytes in them.
    pub losses: Vec<Loss>,
    /// What a reader of a report should know of the files, and is no damage.
    pub notes: Vec<Note>,
    /// What is declared of the files and their numbers are not; `None` where nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// What in tables repeats in every row; `None` where there are no tables.
    pub repeats: Option<Vec<Repeat>>,
    /// The type of the robot, as metadata say it.
    pub robot_type: Option<String>,
    /// The column of a table that holds times, where its numbers told it.
    pub time_column: Option<String>,
    /// What the columns of a table leave open, to be asked where no arm is found.
    pub question: Option<String>,
}

impl Log {
    /// Whether the log holds `/clock`, the mark of simulation time.
    pub fn has_clock(&self) -> bool {
        self.topics.iter().any(|topic| topic.name.trim_start_matches('/') == "clock")
    }
}

/// One file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct LogFile {
    /// Path as given; of a file in a folder, the folder's path and its name.
    pub path: PathBuf,
    /// What kind of file it is.
    pub container: Container,
    /// Size of the file.
    pub bytes: u64,
    /// How many bytes were fetched to read it; `None` for a file that was there.
    pub fetched: Option<u64>,
    /// How many of its messages a checksum vouches for.
    pub crc: Crc,
}

/// The kind of a log file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Container {
    /// An MCAP file.
    Mcap,
    /// A ROS 1 bag of version 2.0.
    RosBag1,
    /// A SQLite database of rosbag2.
    RosBag2Sqlite,
    /// An MCAP file of a rosbag2 folder.
    RosBag2Mcap,
    /// What Universal Robots' RTDE client writes.
    RtdeCsv,
    /// Any other table as text.
    Csv,
    /// An array of NumPy.
    Npy,
    /// An archive of such arrays.
    Npz,
    /// A Parquet file, of a LeRobot dataset or any other.
    Parquet,
    /// An HDF5 file.
    Hdf5,
    /// A Zarr store, as a folder or a zip archive.
    Zarr,
    /// Records of TensorFlow examples.
    TfRecord,
    /// Packets of KUKA's Robot Sensor Interface.
    Rsi,
}

impl Container {
    /// The name used in reports.
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

/// How many of a file's messages are covered by a checksum that was checked and held.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Crc {
    /// Every message that was read.
    All,
    /// Some of them.
    Partial,
    /// None of them.
    None,
}

impl Crc {
    /// What it is where a checksum holds for `covered` of `read` messages.
    pub(super) fn of(covered: u64, read: u64) -> Self {
        match covered {
            0 => Crc::None,
            covered if covered < read => Crc::Partial,
            _ => Crc::All,
        }
    }

    /// The name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Crc::All => "all",
            Crc::Partial => "partial",
            Crc::None => "none",
        }
    }
}

/// One topic, over all files.
#[derive(Clone, Debug, PartialEq)]
pub struct Topic {
    /// Topic name.
    pub name: String,
    /// Type name as the log spells it, such as `sensor_msgs/msg/JointState`; empty without a schema.
    pub type_name: String,
    /// Encoding of the messages, such as `cdr`.
    pub encoding: String,
    /// Messages read, decoded or not.
    pub messages: u64,
    /// What they held; `None` for types that an audit does not use, or where none could be decoded.
    pub columns: Option<Columns>,
    /// Messages of a type that an audit uses, which could not be decoded.
    pub undecodable: Option<Undecodable>,
    /// Why there are no columns, where its messages could be decoded and are of no use.
    pub useless: Option<String>,
    /// How its columns were told, where no schema says it: of a table.
    pub read_as: Option<String>,
    /// Which numbers of a table it is made of, in its order.
    pub cells: Vec<TableCell>,
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
}

/// One number of a table's rows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TableCell {
    /// Its column among those of the table, and its place in a row of that.
    pub at: (usize, usize),
    /// What `[columns]` of a config calls it.
    pub name: String,
    /// What the names of its rotation say that the numbers are, if it is one of a rotation's.
    pub labels: Option<RotationLabels>,
    /// Whether its name says nothing of it, and it is measured: fractions that change.
    pub is_unidentified: bool,
}

/// Names of the numbers of a rotation that say how it is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RotationLabels {
    /// qx, qy, qz, qw, in the order of their letters.
    Quaternion,
    /// roll, pitch, yaw.
    RollPitchYaw,
    /// A, B, C of KUKA, Doosan and others.
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
    /// How many.
    pub messages: u64,
    /// Why the first of them could not, in one line.
    pub first: String,
}

/// A robot description or a UR's calibration that travelled in the log, but not as a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the attachment or the metadata entry.
    pub name: String,
    /// The text: XML of a URDF, or YAML of a calibration.
    pub text: String,
}

/// A part of a file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The file.
    pub file: PathBuf,
    /// Where in the file the damage begins, in bytes; `None` where it is not at one place.
    pub offset: Option<u64>,
    /// What is wrong there, in one line.
    pub what: String,
    /// How many messages are lost; `None` where nothing in the file says.
    pub messages: Option<u64>,
    /// First and last log time of what was there; `None` where nothing in the file says.
    pub span: Option<(Stamp, Stamp)>,
    /// What kind of content is gone.
    pub extent: Extent,
}

/// What a reader of a report should know of a file, though nothing in it is damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// The file.
    pub file: PathBuf,
    /// What to know, in one line.
    pub what: String,
}

/// Columns of a table that hold what others hold in every row, to the bit, or never change.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Repeat {
    /// The topic that the columns are.
    pub topic: String,
    /// The joint, where it is one number of several.
    pub number: Option<String>,
    /// The topic or the joint that it repeats; `None` where it is one value throughout.
    pub of: Option<String>,
}

/// What a [`Loss`] took.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Extent {
    /// Index, summary, footer or an attachment: every message is there.
    Index,
    /// The end of the file within its last record, as when a recorder is killed.
    Tail,
    /// Messages amid the file.
    Messages,
    /// What this program does not read unasked, and is no damage.
    Unread,
}
