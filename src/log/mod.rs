//! Log files in, columns out: containers, and the decoding of messages by the schema in the log.
//!
//! [`open`] reads whole files. What a file is, is told from its bytes and never from its name. Each
//! container walks its records and hands schemas and messages to one `Intake`, which knows from the
//! registry in `decode` which types have columns; every other topic is counted and listed.
//!
//! Nothing in a file may stop the reading of what is sound in it: damage becomes a [`Loss`], a topic
//! that cannot be decoded becomes [`Undecodable`], and only a file of which nothing can be read is a
//! [`LogError`]. What a stream means is decided further up.

mod decode;
mod error;
mod intake;
mod losses;
mod mcap;
mod sniff;
#[cfg(test)]
mod testing;

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use memmap2::Mmap;

use self::intake::Intake;
use self::sniff::Kind;
use crate::stream::Columns;
use crate::time::Stamp;

pub use self::error::LogError;

/// How to read.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadOptions {
    /// Check every checksum in the files, also where that takes another pass over the bytes.
    pub verify: bool,
}

/// All that was read from the files of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// The files, in the order given.
    pub files: Vec<LogFile>,
    /// The topics of all files, in the order of their names.
    pub topics: Vec<Topic>,
    /// Robot descriptions found beside the messages, in attachments and metadata.
    pub descriptions: Vec<Description>,
    /// Messages read, of whatever type.
    pub messages: u64,
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
    /// What was damaged, in the order of the files and of the bytes in them.
    pub losses: Vec<Loss>,
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
    /// Path as given.
    pub path: PathBuf,
    /// What kind of file it is.
    pub container: Container,
    /// Size of the file.
    pub bytes: u64,
    /// How many of its messages a checksum vouches for.
    pub crc: Crc,
}

/// The kind of a log file.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Container {
    /// An MCAP file.
    Mcap,
}

impl Container {
    /// The name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Container::Mcap => "mcap",
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
    /// First and last log time; `None` without messages.
    pub span: Option<(Stamp, Stamp)>,
}

/// Messages of one topic that could not be decoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Undecodable {
    /// How many.
    pub messages: u64,
    /// Why the first of them could not, in one line.
    pub first: String,
}

/// A robot description that travelled in the log, but not as a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Name of the attachment or the metadata entry.
    pub name: String,
    /// The URDF text.
    pub text: String,
}

/// A part of a file that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The file.
    pub file: PathBuf,
    /// Where in the file the damage begins.
    pub offset: u64,
    /// What is wrong there, in one line.
    pub what: String,
    /// How many messages are lost; `None` where nothing in the file says.
    pub messages: Option<u64>,
    /// What kind of content is gone.
    pub extent: Extent,
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
}

/// Reads the files of one run; rows of the same topic and type are appended in the order given.
///
/// # Errors
///
/// If one of the files cannot be opened or is no log of a supported kind, or if no message can be
/// read from any of them. Damage to a part of a file is no error: see [`Log::losses`].
pub fn open(paths: &[PathBuf], options: &ReadOptions) -> Result<Log, LogError> {
    let mut intake = Intake::default();
    let mut files = Vec::with_capacity(paths.len());
    for path in paths {
        let map = map(path)?;
        let (container, crc) = match sniff::kind(&map) {
            Kind::Mcap => (Container::Mcap, mcap::read(path, &map, options, &mut intake)),
            Kind::Known { looks, instead } => {
                return Err(LogError::Unsupported { path: path.clone(), looks, instead });
            }
            Kind::Unknown { looks } => {
                return Err(LogError::NotALog { path: path.clone(), looks });
            }
        };
        let bytes = map.len() as u64;
        files.push(LogFile { path: path.clone(), container, bytes, crc });
    }
    let log = intake.finish(files);
    if log.messages == 0 {
        return Err(LogError::no_messages(&log));
    }
    Ok(log)
}

/// Maps a file into memory, or says in one line why it cannot be read.
fn map(path: &Path) -> Result<Mmap, LogError> {
    let io_error = |source: io::Error| LogError::io(path, source);
    let file = File::open(path).map_err(io_error)?;
    let metadata = file.metadata().map_err(io_error)?;
    if metadata.is_dir() {
        return Err(LogError::Directory { path: path.to_owned() });
    }
    if !metadata.is_file() {
        return Err(LogError::NotAFile { path: path.to_owned() });
    }
    if metadata.len() == 0 {
        return Err(LogError::Empty { path: path.to_owned() });
    }
    // SAFETY: the map is read-only and lives only while its file is decoded. Another process that
    // shortens the file meanwhile ends this one with SIGBUS, as with any memory-mapped reader.
    unsafe { Mmap::map(&file) }.map_err(io_error)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::testing::{self, Cdr, LogWriter};
    use super::*;
    use crate::stream::Columns;

    fn open_one(path: &Path) -> Result<Log, LogError> {
        open(&[path.to_owned()], &ReadOptions::default())
    }

    fn refusal(name: &str, content: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        let line = open_one(&path).unwrap_err().to_string();
        assert!(!line.contains('\n'), "{line}");
        line.replace(&path.display().to_string(), "FILE")
    }

    #[test]
    fn what_is_no_log_is_told_from_its_bytes() {
        let text = refusal("run.mcap", b"time,x,y\n0.0,1.0,2.0\n");
        assert!(text.contains("FILE: not a robot log: it looks like text"), "{text}");
        let sqlite = refusal("run.mcap", b"SQLite format 3\0\x10\0");
        assert!(sqlite.contains("SQLite database"), "{sqlite}");
        let bag = refusal("run.mcap", b"#ROSBAG V2.0\nabc");
        assert!(bag.contains("ROS 1 bag"), "{bag}");
        let empty = refusal("run.mcap", b"");
        assert!(empty.contains("the file is empty"), "{empty}");
        let bytes = refusal("run.mcap", &[0x80, 0xff, 0, 1, 2, 3]);
        assert!(bytes.contains("unknown binary data"), "{bytes}");
        let stub = refusal("run.mcap", b"\x89MCA");
        assert!(stub.contains("MCAP file that was cut off"), "{stub}");
    }

    #[test]
    fn a_missing_file_and_a_directory_get_one_clear_line() {
        let folder = tempfile::tempdir().unwrap();
        let missing = open_one(&folder.path().join("none.mcap")).unwrap_err();
        assert!(matches!(missing, LogError::NotFound { .. }), "{missing}");
        let directory = open_one(folder.path()).unwrap_err();
        assert!(matches!(directory, LogError::Directory { .. }), "{directory}");
        assert!(directory.to_string().contains("name the log files in it"), "{directory}");
    }

    #[test]
    fn a_log_without_messages_is_an_error_that_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        fs::write(&path, LogWriter::default().finish()).unwrap();
        let error = open_one(&path).unwrap_err();
        assert!(matches!(error, LogError::NoMessages { .. }), "{error}");
    }

    #[test]
    fn several_files_are_one_run() {
        let folder = tempfile::tempdir().unwrap();
        let mut paths = Vec::new();
        for (name, first) in [("a.mcap", 100), ("b.mcap", 200)] {
            let mut log = LogWriter::default();
            let channel =
                log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
            for time in first..first + 10 {
                log.message(
                    channel,
                    time,
                    &Cdr::pose_stamped(0, time as u32, "base", [1.0, 2.0, 3.0]),
                );
            }
            let path = folder.path().join(name);
            fs::write(&path, log.finish()).unwrap();
            paths.push(path);
        }
        let log = open(&paths, &ReadOptions { verify: true }).unwrap();
        assert_eq!(log.messages, 20);
        assert_eq!(log.span, Some((Stamp::from_nanos(100), Stamp::from_nanos(209))));
        assert_eq!(log.files.len(), 2);
        assert!(log.files.iter().all(|file| file.crc == Crc::All));
        assert_eq!(log.losses, []);
        let [topic] = log.topics.as_slice() else { panic!("one topic") };
        let Some(Columns::Poses(poses)) = &topic.columns else { panic!("poses") };
        assert_eq!(poses.len(), 1);
        assert_eq!(poses[0].times.len(), 20);
        assert_eq!(poses[0].times.header[19], 209);
    }

    #[test]
    fn a_simulated_clock_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut log = LogWriter::default();
        let schema = "builtin_interfaces/Time clock\n";
        let channel = log.channel("/clock", "rosgraph_msgs/msg/Clock", schema);
        log.message(channel, 5, &Cdr::little().u32(1).u32(2).done());
        fs::write(&path, log.finish()).unwrap();
        let log = open_one(&path).unwrap();
        assert!(log.has_clock());
        assert_eq!(log.topics[0].messages, 1);
        assert_eq!(log.topics[0].columns, None);
        assert_eq!(log.topics[0].undecodable, None);
    }
}
