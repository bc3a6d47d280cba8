use std::path::PathBuf;

use ground::stream::Columns;
use ground::time::Stamp;

use super::tables::RowLayout;

/// Encoding of a table's topics.
pub(super) const TABLE: &str = "table";
/// The same of a table by UR's RTDE client.
pub(super) const RTDE: &str = "csv";

/// Everything read from the files of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Log {
    /// Files in the order given.
    pub files: Vec<LogFile>,
    /// Topics, sorted by name.
    pub topics: Vec<Topic>,
    /// Descriptions from attachments and metadata.
    pub descriptions: Vec<Description>,
    /// Messages read, of any type.
    pub messages: u64,
    /// First and last log time.
    pub span: Option<(Stamp, Stamp)>,
    /// Damage, by file and offset.
    pub losses: Vec<Loss>,
    /// Remarks other than damage.
    pub notes: Vec<Note>,
    /// Contradictions between declarations and numbers. `None` if nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// Duplicate or constant table columns. `None` without tables.
    pub repeats: Option<Vec<Repeat>>,
    /// Robot type in the metadata.
    pub robot_type: Option<String>,
    /// Table column identified as times by its numbers.
    pub time_column: Option<String>,
    /// Columns of each table.
    pub tables: Vec<TableShape>,
    /// Question about undetermined columns, asked if no arm is found.
    pub question: Option<String>,
}

impl Log {
    /// Whether the log contains `/clock`, that is, simulation time.
    pub fn has_clock(&self) -> bool {
        self.topics.iter().any(|topic| topic.name.trim_start_matches('/') == "clock")
    }
}

/// One file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct LogFile {
    /// Path as given, or the given folder's path and the file's name.
    pub path: PathBuf,
    /// Kind of file.
    pub container: Container,
    /// Size.
    pub bytes: u64,
    /// Bytes fetched. `None` for a local file.
    pub fetched: Option<u64>,
    /// Checksum coverage of its messages.
    pub crc: Crc,
}

/// Kind of a log file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Container {
    /// MCAP.
    Mcap,
    /// ROS 1 bag 2.0.
    RosBag1,
    /// rosbag2 SQLite database.
    RosBag2Sqlite,
    /// MCAP in a rosbag2 folder.
    RosBag2Mcap,
    /// Output of Universal Robots' RTDE client.
    RtdeCsv,
    /// Other text table.
    Csv,
    /// TUM trajectory.
    Tum,
    /// KITTI odometry poses.
    Kitti,
    /// Times of the rows of another file.
    Times,
    /// NumPy array.
    Npy,
    /// Archive of NumPy arrays.
    Npz,
    /// Parquet, from LeRobot or elsewhere.
    Parquet,
    /// HDF5.
    Hdf5,
    /// MATLAB before 7.3.
    Matlab,
    /// Zarr, folder or zip.
    Zarr,
    /// TFRecord with TensorFlow examples.
    TfRecord,
    /// KUKA Robot Sensor Interface.
    Rsi,
    /// Excel workbook.
    Xlsx,
    /// JSON or JSON lines.
    Json,
    /// YAML.
    Yaml,
}

impl Container {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Container::Mcap => "mcap",
            Container::RosBag1 => "rosbag1",
            Container::RosBag2Sqlite => "rosbag2-sqlite",
            Container::RosBag2Mcap => "rosbag2-mcap",
            Container::RtdeCsv => "rtde-csv",
            Container::Csv => "csv",
            Container::Tum => "tum",
            Container::Kitti => "kitti",
            Container::Times => "times",
            Container::Npy => "npy",
            Container::Npz => "npz",
            Container::Parquet => "parquet",
            Container::Hdf5 => "hdf5",
            Container::Matlab => "matlab",
            Container::Zarr => "zarr",
            Container::TfRecord => "tfrecord",
            Container::Rsi => "kuka-rsi",
            Container::Xlsx => "xlsx",
            Container::Json => "json",
            Container::Yaml => "yaml",
        }
    }
}

/// Share of a file's messages with a verified checksum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Crc {
    /// All.
    All,
    /// Some.
    Partial,
    /// None.
    None,
}

impl Crc {
    pub(super) fn from_counts(covered: u64, read: u64) -> Self {
        match covered {
            0 => Crc::None,
            covered if covered < read => Crc::Partial,
            _ => Crc::All,
        }
    }

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Crc::All => "all",
            Crc::Partial => "partial",
            Crc::None => "none",
        }
    }
}

/// One topic over all files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Topic {
    /// Name.
    pub name: String,
    /// Type as in the log, such as `sensor_msgs/msg/JointState`; empty without a schema.
    pub type_name: String,
    /// Message encoding, such as `cdr`.
    pub encoding: String,
    /// Messages read, decoded or not.
    pub messages: u64,
    /// `None` for unused types, or if no message could be decoded.
    pub columns: Option<Columns>,
    /// Undecodable messages of a used type.
    pub undecodable: Option<Undecodable>,
    /// Why there are no columns although messages could be decoded.
    pub unusable: Option<String>,
    /// Interpretation of a table's columns.
    pub read_as: Option<String>,
    /// Its table columns, in order.
    pub cells: Vec<TableCell>,
    /// Table columns of its joint velocities.
    pub velocity_cells: Vec<TableCell>,
    /// Whether its receive times come from its motion, because its clock has another origin.
    pub is_aligned_by_motion: bool,
    /// First and last log time.
    pub span: Option<(Stamp, Stamp)>,
    /// Number of the file with all its messages, from 1; `None` if several have them.
    pub file: Option<usize>,
}

impl Topic {
    /// Whether its rows are those of a table file, which one program writes.
    pub fn is_from_table(&self) -> bool {
        matches!(self.encoding.as_str(), TABLE | RTDE)
    }
}

/// Columns of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct TableShape {
    /// The first file with this table.
    pub file: PathBuf,
    /// Its columns, in the order of a row.
    pub numbers: Vec<TableNumber>,
    /// Column of the stamps.
    pub time: Option<Cell>,
    /// Column of their nanoseconds, if `time` holds whole seconds.
    pub nanos: Option<Cell>,
    /// Unit of the stamps, s, unless the numbers show that they are seconds.
    pub time_unit_s: Option<f64>,
    /// Set if the stamps are generated.
    pub rate_hz: Option<f64>,
    /// Whether its rows have no times; the stamps are those of an assumed rate.
    pub lacks_times: bool,
    /// Column that is named as a time and increases, but in an unknown unit, and its median step. Set if the rows have no
    /// times.
    pub time_without_unit: Option<(Cell, f64)>,
    /// The meaning of its columns as a value of `--columns`.
    pub layout: Option<String>,
    /// Why the layout is only a proposal; `None` if it is how the columns were read.
    pub layout_reason: Option<String>,
    /// The caller's layout.
    pub given_layout: Option<RowLayout>,
}

/// One column in the rows of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableNumber {
    /// As in [`TableCell::at`]; `None` for text.
    pub at: Option<Cell>,
    /// Name in `[columns]` of a config.
    pub name: String,
}

/// Place of a number in the rows of a table.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Cell {
    /// Index of its column.
    pub column: usize,
    /// Index within the column.
    pub part: usize,
}

/// One number in the rows of a table.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TableCell {
    /// Index of its table in [`Log::tables`].
    pub table: usize,
    /// Its place in a row.
    pub at: Cell,
    /// Name in `[columns]` of a config.
    pub name: String,
    /// Encoding indicated by its rotation's names.
    pub labels: Option<RotationLabels>,
    /// Whether its name is meaningless and its values are measured.
    pub is_unidentified: bool,
}

/// Names of rotation components that indicate the encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RotationLabels {
    /// qx, qy, qz, qw, in any order, or `xyzw`.
    Quaternion,
    /// `wxyz`.
    ScalarFirst,
    /// roll, pitch, yaw.
    RollPitchYaw,
    /// A, B, C, as KUKA.
    Abc,
    /// FANUC's W, P, R.
    Wpr,
    /// Kawasaki's O, A, T.
    Oat,
    /// Rotation vector.
    RotationVector,
}

/// Undecodable messages of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Undecodable {
    /// Number of messages.
    pub messages: u64,
    /// First error, in one line.
    pub first: String,
}

/// Robot description or UR calibration outside messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the attachment or metadata entry.
    pub name: String,
    /// URDF XML or calibration YAML.
    pub text: String,
}

/// Part of a file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The file.
    pub file: PathBuf,
    /// Offset in bytes. `None` without a single position.
    pub offset: Option<u64>,
    /// Description, in one line.
    pub what: String,
    /// Lost messages, if known.
    pub messages: Option<u64>,
    /// First and last log time of the lost content, if known.
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
    /// Their topic.
    pub topic: String,
    /// The joint, if one of several.
    pub number: Option<String>,
    /// Topic or joint it duplicates. `None` if constant.
    pub of: Option<String>,
}

/// Content affected by a [`Loss`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Extent {
    /// Index, summary, footer or an attachment; no messages.
    Index,
    /// End of the file within its last record, for example after a killed recorder.
    Tail,
    /// Messages within the file.
    Messages,
    /// Skipped by default, not damaged.
    Unread,
    /// Messages read, in a segment that cannot be audited.
    NotAudited,
}
