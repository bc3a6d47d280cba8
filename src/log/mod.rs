//! Log files in, columns out: containers, and the decoding of messages by the schema in the log.
//!
//! [`open`] reads whole files. What a file is, is told from its bytes and never from its name. Each
//! container walks its records and hands schemas and messages to one `Intake`, which knows from the
//! registry in `decode` which types have columns; every other topic is counted and listed.
//!
//! Nothing in a file may stop the reading of what is sound in it: damage becomes a [`Loss`], a topic
//! that cannot be decoded becomes [`Undecodable`], and only a file of which nothing can be read is a
//! [`LogError`]. What a stream means is decided further up.

mod ahead;
mod decode;
mod error;
mod files;
mod intake;
mod losses;
mod mcap;
mod name;
mod progress;
mod ranges;
mod remote;
mod rosbag1;
mod rosbag2;
mod rtde;
#[cfg(test)]
mod seeds;
mod sniff;
#[cfg(test)]
mod testing;
mod unpack;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::boundary::Staged;

use self::files::{Input, Mapped};
use self::intake::Intake;
use self::losses::Losses;
use self::mcap::Absent;
use self::ranges::Present;
use self::remote::Fetched;
use self::sniff::Kind;
use self::unpack::{Allowance, Unpacked};
use crate::stream::Columns;
use crate::time::Stamp;

pub use self::error::LogError;
pub use self::name::SourceName;
pub use self::progress::Progress;
pub use self::remote::{Listed, RemoteFault, is_url, list, normal};

/// How to read.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Check every checksum in the files, also where that takes another pass over the bytes.
    pub verify: bool,
    /// What the compressed parts of a file may unpack to, GiB, where that is more than would be unpacked
    /// otherwise.
    pub max_unpacked_gib: Option<u32>,
    /// Kept up to date while the files are read.
    pub progress: Option<Arc<Progress>>,
}

impl ReadOptions {
    /// Says how far the file that is being read was read.
    fn at(&self, offset: usize) {
        if let Some(progress) = &self.progress {
            progress.at(offset as u64);
        }
    }
}

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
    fn of(covered: u64, read: u64) -> Self {
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

/// The local file that `path` names, itself or as a `file://` URL; `None` for an object in a store.
pub(crate) fn local(path: &Path) -> Option<PathBuf> {
    let is_url = remote::is_url(path);
    (!is_url).then(|| remote::local(path).unwrap_or_else(|| path.to_owned()))
}

/// How much of a file's beginning [`looks_like_log`] wants to see, in bytes.
pub const HEAD_BYTES: u64 = 4096;

/// Whether a file that begins with `head` may be a log: of a zstd archive only reading it tells.
pub fn looks_like_log(head: &[u8]) -> bool {
    !matches!(sniff::kind(head), sniff::Kind::Known { .. } | sniff::Kind::Unknown { .. })
}

/// Reads the files, rosbag2 folders and objects in stores (by URL) of one run, of whatever kinds;
/// rows of the same topic and type are appended in the order given.
///
/// # Errors
///
/// If one of the files cannot be opened or is no log of a supported kind, if the same file is given
/// twice, or if no message can be read from any of them. Damage to a part of a file is no error: see
/// [`Log::losses`].
pub fn open(paths: &[PathBuf], options: &ReadOptions) -> Result<Log, LogError> {
    let mut intake = Intake::default();
    let mut rtde = rtde::Recording::default();
    let inputs = files::inputs(paths, &mut intake)?;
    files::refuse_repeats(&inputs)?;
    if let Some(progress) = &options.progress {
        progress.begin(inputs.iter().map(Input::bytes).sum());
    }
    let mut files = Vec::with_capacity(inputs.len());
    for input in &inputs {
        let mut reading = Reading {
            path: &input.path,
            in_bag: input.in_bag,
            options: options.clone(),
            losses: Losses::of(&input.path),
            intake: &mut intake,
            rtde: &mut rtde,
            present: Present::Whole,
        };
        let read = reading.file(input);
        let mut losses = reading.losses;
        let mut bytes = input.bytes();
        match read {
            Ok(file) => {
                bytes = file.bytes;
                files.push(file);
            }
            // One file of a recording does not take the others with it.
            Err(error) if input.in_bag && inputs.len() > 1 => {
                losses.add_unplaced(Extent::Messages, input.recorded, error.to_string());
            }
            Err(error) => return Err(error),
        }
        intake.losses(losses);
        if let Some(progress) = &options.progress {
            progress.file_done(bytes);
        }
    }
    rtde.hand_over(&mut intake);
    let log = intake.finish(files);
    if log.messages == 0 {
        return Err(LogError::no_messages(&log));
    }
    Ok(log)
}

/// One file being read.
struct Reading<'a> {
    path: &'a Path,
    in_bag: bool,
    options: ReadOptions,
    losses: Losses,
    intake: &'a mut Intake,
    rtde: &'a mut rtde::Recording,
    /// What of the file is there.
    present: Present,
}

impl Reading<'_> {
    /// Reads the file, or fetches the object and reads that.
    fn file(&mut self, input: &Input) -> Result<LogFile, LogError> {
        let path = self.path;
        let Some(address) = &input.address else {
            let mapped = Mapped::open(path)?;
            let before = self.intake.messages();
            let file = self.whole(mapped.bytes(), None)?;
            if let Some(recorded) = input.recorded {
                self.losses.settle("metadata.yaml", recorded, self.intake.messages() - before);
            }
            return Ok(LogFile { bytes: input.bytes(), ..file });
        };
        let Fetched { file: Unpacked { file, path: named }, present, bytes } =
            remote::fetch(address, &self.options)
                .map_err(|fault| LogError::Remote { url: path.to_owned(), fault })?;
        let mapped = Mapped::of(&file).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => LogError::Empty { path: path.to_owned() },
            _ => LogError::io(path, source),
        })?;
        // To fetch it is what takes time.
        self.options.progress = None;
        self.present = present;
        Ok(LogFile { fetched: Some(bytes), ..self.whole(mapped.bytes(), named)? })
    }

    /// Reads the `bytes` of a file, which is a temporary one if it is `named`.
    fn whole(&mut self, bytes: &[u8], named: Option<Staged>) -> Result<LogFile, LogError> {
        let (path, size) = (self.path, bytes.len() as u64);
        self.intake.begin_file(path, size);
        self.intake.allowance = Allowance::of(size, self.options.max_unpacked_gib);
        let (container, crc) = match sniff::kind(bytes) {
            Kind::Zstd => self.archive(bytes)?,
            kind => self.named(kind, bytes, named)?,
        };
        Ok(LogFile { path: path.to_owned(), container, bytes: size, fetched: None, crc })
    }

    /// Reads the log that is packed in `archive`.
    fn archive(&mut self, archive: &[u8]) -> Result<(Container, Crc), LogError> {
        let options = &self.options;
        let (Unpacked { file, path }, end) =
            unpack::file(archive, &mut self.intake.allowance, |offset| options.at(offset))
                .map_err(|source| LogError::Temporary { path: self.path.to_owned(), source })?;
        if let Err(error) = end {
            let extent = match error.extent() {
                Extent::Messages => Extent::Tail,
                ours => ours,
            };
            self.losses.add_unplaced(extent, None, error.to_string());
        }
        let looks = "a zstd archive of nothing";
        let unpacked = Mapped::of(&file)
            .map_err(|_| LogError::NotALog { path: self.path.to_owned(), looks })?;
        // The archive is what counts, and it was read.
        self.options.progress = None;
        self.named(sniff::kind(unpacked.bytes()), unpacked.bytes(), path)
    }

    /// Reads the `bytes` of a log, of a temporary file if it is `named`.
    fn named(
        &mut self,
        kind: Kind,
        bytes: &[u8],
        named: Option<Staged>,
    ) -> Result<(Container, Crc), LogError> {
        match named {
            None => self.content(kind, self.path, bytes, || ()),
            // Once the file is open, its name is not needed any more. Where open files cannot lose
            // theirs, it goes in the end.
            Some(path) => {
                let place = path.to_path_buf();
                let opened = || drop(std::fs::remove_file(&*path));
                self.content(kind, &place, bytes, opened)
            }
        }
    }

    /// Reads the `bytes` of a log, which are at `place`: its own path, or where it was unpacked to.
    /// What needs the name of that place says when it is `opened`.
    fn content(
        &mut self,
        kind: Kind,
        place: &Path,
        bytes: &[u8],
        opened: impl FnOnce(),
    ) -> Result<(Container, Crc), LogError> {
        let Self { options, losses, intake, rtde, present, .. } = self;
        let path = || self.path.to_owned();
        let absent = |Absent(byte)| {
            let fault = RemoteFault::Contradiction { byte: byte as u64 };
            LogError::Remote { url: path(), fault }
        };
        Ok(match kind {
            Kind::Mcap => {
                let of_bag = if self.in_bag { Container::RosBag2Mcap } else { Container::Mcap };
                let crc = mcap::read(bytes, present, options, losses, intake).map_err(absent)?;
                (of_bag, crc)
            }
            Kind::RosBag1 => (Container::RosBag1, rosbag1::read(bytes, options, losses, intake)),
            Kind::Sqlite => {
                if !rosbag2::read_database(place, options, losses, intake, opened) {
                    let looks = "a SQLite database without the tables of a rosbag2 bag";
                    return Err(LogError::NotALog { path: path(), looks });
                }
                (Container::RosBag2Sqlite, Crc::None)
            }
            Kind::Rtde => {
                rtde.read(self.path, bytes, options, losses, intake);
                (Container::RtdeCsv, Crc::None)
            }
            Kind::Zstd => {
                let (looks, instead) = ("a zstd archive within another", "unpack it first");
                return Err(LogError::Unsupported { path: path(), looks, instead });
            }
            Kind::Known { looks, instead } => {
                return Err(LogError::Unsupported { path: path(), looks, instead });
            }
            Kind::Unknown { looks } => return Err(LogError::NotALog { path: path(), looks }),
        })
    }
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
        assert!(sqlite.contains("the database cannot be opened: "), "{sqlite}");
        let bag = refusal("run.mcap", b"#ROSBAG V1.2\nabc");
        assert!(bag.contains("ROS 1 bag of another version than 2.0"), "{bag}");
        let numbers = refusal("run.csv", b"0.0,1.0,2.0\n");
        assert!(numbers.contains("without a first line that names them"), "{numbers}");
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
        let text = directory.to_string();
        assert!(text.contains("is a directory without log files; name the log files"), "{text}");
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
        let log = open(&paths, &ReadOptions { verify: true, ..ReadOptions::default() }).unwrap();
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

    /// A file of ten poses at times from `first` on.
    fn ten_poses(path: &Path, first: u64) {
        let mut log = LogWriter::default();
        let channel = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
        for time in first..first + 10 {
            log.message(channel, time, &Cdr::pose_stamped(0, time as u32, "base", [0.0; 3]));
        }
        fs::write(path, log.finish()).unwrap();
    }

    #[test]
    fn the_same_file_twice_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let [a, copy, other] = ["a", "copy", "other"].map(|name| folder.path().join(name));
        ten_poses(&a, 100);
        ten_poses(&other, 200);
        fs::copy(&a, &copy).unwrap();
        let detour = folder.path().join(".").join("a");
        for second in [&a, &copy, &detour] {
            let twice = [a.clone(), other.clone(), second.clone()];
            let error = open(&twice, &ReadOptions::default()).unwrap_err();
            assert!(matches!(&error, LogError::Twice { first, .. } if *first == a), "{error}");
            assert!(error.to_string().contains("is given twice"), "{error}");
        }
        assert_eq!(open(&[a, other], &ReadOptions::default()).unwrap().messages, 20);
    }

    #[test]
    fn files_of_different_kinds_are_merged_by_topic() {
        let folder = tempfile::tempdir().unwrap();
        let [mcap, database] = ["a", "b"].map(|name| folder.path().join(name));
        ten_poses(&mcap, 100);
        let writer = testing::DatabaseWriter::create(&database);
        writer.poses(1, "/pose");
        writer.count_poses(1, 110, 10);
        drop(writer);
        let log = open(&[mcap, database], &ReadOptions::default()).unwrap();
        let kinds: Vec<&str> = log.files.iter().map(|file| file.container.name()).collect();
        assert_eq!(kinds, ["mcap", "rosbag2-sqlite"]);
        let [Topic { columns: Some(Columns::Poses(poses)), .. }] = log.topics.as_slice() else {
            panic!("{:?}", log.topics)
        };
        assert_eq!(poses[0].times.log, (100..120).collect::<Vec<_>>());
        assert_eq!((log.losses.as_slice(), log.notes.as_slice()), ([].as_slice(), [].as_slice()));
    }

    #[test]
    fn progress_ends_where_the_files_do() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["a", "b"].map(|name| folder.path().join(name));
        ten_poses(&paths[0], 100);
        let writer = testing::DatabaseWriter::create(&paths[1]);
        writer.poses(1, "/pose");
        writer.count_poses(1, 200, 10);
        drop(writer);
        let progress = Arc::new(Progress::default());
        let options =
            ReadOptions { progress: Some(Arc::clone(&progress)), ..ReadOptions::default() };
        open(&paths, &options).unwrap();
        let bytes = paths.map(|path| fs::metadata(path).unwrap().len()).iter().sum();
        assert_eq!((progress.read(), progress.total()), (bytes, bytes));
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
