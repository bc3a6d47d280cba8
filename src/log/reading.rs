use std::io;
use std::path::{Path, PathBuf};

use super::containment::{Containment, LINK_LEADS_OUTSIDE};
use super::contents::{Container, Crc, Extent, Log, LogFile};
use super::file_format::FileFormat;
use super::files::{LogInput, reject_duplicates};
use super::intake::Intake;
use super::losses::Losses;
use super::mapped::MappedFile;
use super::mcap::MissingByte;
use super::memory_budget::MemoryBudget;
use super::options::ReadOptions;
use super::ranges::Present;
use super::remote::{Address, Fetched};
use super::tables::{self, JoinedRows, TableFormat, Tables};
use super::unpack::{UnpackBudget, Unpacked};
use super::{LogError, RemoteFault, file_format, mcap, remote, rosbag1, rosbag2, rtde, unpack};
use ground::boundary::StagedFile;

/// Reads the files, rosbag2 folders and store objects (by URL) of one run, in any mix of formats. Rows of
/// the same topic and type are appended in the order given.
///
/// # Errors
/// If a file cannot be opened, is not a supported log or is given twice, or if no message can be read.
/// Partial damage is not an error: see [`Log::losses`].
pub fn open(paths: &[PathBuf], options: &ReadOptions) -> Result<Log, LogError> {
    let mut intake = Intake::default();
    let mut rtde = rtde::Recording::default();
    let mut memory = MemoryBudget::new(options.max_unpacked_gib);
    let inputs = inputs(paths, options, &mut intake)?;
    let inputs = tables::join_inputs(inputs, &mut intake);
    reject_duplicates(&inputs)?;
    let mut tables = Tables::new(&inputs);
    if let Some(progress) = &options.progress {
        progress.set_total(inputs.iter().map(LogInput::bytes).sum());
    }
    let mut files = Vec::with_capacity(inputs.len());
    let mut first_skipped = None;
    for input in &inputs {
        let mut reading = FileReader {
            path: &input.path,
            in_bag: input.in_bag,
            episode: input.episode.as_deref(),
            options: options.clone(),
            losses: Losses::new(&input.path),
            intake: &mut intake,
            rtde: &mut rtde,
            tables: &mut tables,
            memory: &mut memory,
            size: 0,
            present: Present::Whole,
        };
        let read = reading.read_file(input);
        let mut losses = reading.losses;
        let mut bytes = input.bytes();
        match read {
            Ok(file) => {
                bytes = file.bytes;
                files.push(file);
            }
            // One unreadable file of a recording does not prevent reading the others.
            Err(error) if input.in_bag && inputs.len() > 1 => match &error {
                LogError::Columns { path, what } | LogError::NoTimes { path, what, .. } => {
                    match tables.names_signal(path) {
                        true => losses.add_unplaced(Extent::Messages, None, what.clone()),
                        false => intake.note(path, format!("was not read: {what}")),
                    }
                    first_skipped.get_or_insert(error);
                }
                _ => losses.add_unplaced(Extent::Messages, input.recorded, error.to_string()),
            },
            Err(error) => return Err(error),
        }
        intake.losses(losses);
        if let Some(progress) = &options.progress {
            progress.finish_file(bytes);
        }
    }
    if !options.columns.layouts.is_empty() && !tables.has_used_layout() && !files.is_empty() {
        let path = files[0].path.clone();
        let what = "--columns names the columns of a table, but no file it applies to is one";
        return Err(LogError::Layout { path, what: what.to_owned() });
    }
    rtde.hand_over(&mut intake);
    tables.finish(&mut intake);
    let log = intake.finish(files);
    if log.messages == 0 {
        return Err(first_skipped.unwrap_or_else(|| LogError::no_messages(&log)));
    }
    Ok(log)
}

fn inputs(
    paths: &[PathBuf],
    options: &ReadOptions,
    intake: &mut Intake,
) -> Result<Vec<LogInput>, LogError> {
    let mut inputs = Vec::new();
    for path in paths {
        if let Some(content) = options.given.get(path) {
            inputs.push(LogInput { given: Some(content.clone()), ..LogInput::local(path.clone()) });
            continue;
        }
        let named = remote::local(path);
        let path = named.as_ref().unwrap_or(path);
        let (path, episode) = tables::split_episode(path);
        let path = &path;
        let before = inputs.len();
        match Address::from_path(path)? {
            Some(address) => {
                let path = address.display_path();
                inputs.push(LogInput { address: Some(address), ..LogInput::local(path) });
            }
            None if tables::is_dataset(path) => {
                inputs.extend(contained(path, tables::dataset_files(path)?, intake)?);
            }
            None if tables::is_store(path) => inputs.push(LogInput::local(path.clone())),
            None if path.is_dir() => match rosbag2::files_of(path, intake) {
                Ok(files) => inputs.extend(contained(path, files, intake)?),
                Err(error @ (LogError::Directory { .. } | LogError::Runs { .. })) => {
                    let rows = JoinedRows::in_folder(path).ok_or(error)?;
                    inputs.push(rows.into_input(path, intake));
                }
                Err(error) => return Err(error),
            },
            None => inputs.push(LogInput::local(path.clone())),
        }
        inputs[before..].iter_mut().for_each(|input| input.episode.clone_from(&episode));
    }
    Ok(inputs)
}

/// Files in `folder`; links that leave the folder are recorded as losses.
fn contained(
    folder: &Path,
    inputs: Vec<LogInput>,
    intake: &mut Intake,
) -> Result<Vec<LogInput>, LogError> {
    let mut within = Containment::new(folder);
    let (inside, outside): (Vec<LogInput>, Vec<LogInput>) =
        inputs.into_iter().partition(|input| within.holds(&input.path));
    if inside.is_empty() {
        let cause = "whose files are links out of it and are not followed; copy their targets";
        return Err(LogError::Directory { path: folder.to_owned(), cause });
    }
    for LogInput { path, recorded, .. } in outside {
        let mut losses = Losses::new(&path);
        losses.add_unplaced(Extent::Messages, recorded, format!("it {LINK_LEADS_OUTSIDE}"));
        intake.losses(losses);
    }
    Ok(inside)
}

struct FileReader<'a> {
    path: &'a Path,
    in_bag: bool,
    episode: Option<&'a str>,
    options: ReadOptions,
    losses: Losses,
    intake: &'a mut Intake,
    rtde: &'a mut rtde::Recording,
    tables: &'a mut Tables,
    memory: &'a mut MemoryBudget,
    /// Stored size in bytes.
    size: u64,
    present: Present,
}

impl FileReader<'_> {
    fn read_file(&mut self, input: &LogInput) -> Result<LogFile, LogError> {
        let path = self.path;
        let Some(address) = &input.address else {
            if input.given.is_none() && path.is_dir() {
                return self.read_store(path);
            }
            let mapped = input.open()?;
            let before = self.intake.messages();
            let file = self.read_whole(mapped.bytes(), None)?;
            if let Some(recorded) = input.recorded {
                self.losses.infer_missing(
                    "metadata.yaml",
                    recorded,
                    self.intake.messages() - before,
                );
            }
            return Ok(LogFile { bytes: input.bytes(), ..file });
        };
        let Fetched { file: Unpacked { file, path: named }, present, bytes } =
            remote::fetch(address, &self.options)
                .map_err(|fault| LogError::Remote { url: path.to_owned(), fault })?;
        let mapped = MappedFile::from_temporary(&file).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => LogError::Empty { path: path.to_owned() },
            _ => LogError::io(path, source),
        })?;
        // Fetching dominates the time.
        self.options.progress = None;
        self.present = present;
        Ok(LogFile { fetched: Some(bytes), ..self.read_whole(mapped.bytes(), named)? })
    }

    fn read_store(&mut self, folder: &Path) -> Result<LogFile, LogError> {
        let sizes = tables::store_files(folder).into_iter().filter_map(|file| file.metadata().ok());
        let bytes = sizes.map(|metadata| metadata.len()).sum();
        self.intake.begin_file(folder, bytes);
        self.size = bytes;
        let kind = FileFormat::Table(TableFormat::Zarr);
        let (container, crc) = self.read_content(kind, folder, &[], || ())?;
        Ok(LogFile { path: folder.to_owned(), container, bytes, fetched: None, crc })
    }

    /// Reads a file; `named` is the name of a temporary one.
    fn read_whole(&mut self, bytes: &[u8], named: Option<StagedFile>) -> Result<LogFile, LogError> {
        let (path, size) = (self.path, bytes.len() as u64);
        self.size = size;
        self.intake.begin_file(path, size);
        self.intake.unpack_budget = UnpackBudget::for_file(size, self.options.max_unpacked_gib);
        let (container, crc) = match file_format::detect_format(bytes) {
            FileFormat::Zstd => self.read_archive(bytes)?,
            kind => self.read_named(kind, bytes, named)?,
        };
        Ok(LogFile { path: path.to_owned(), container, bytes: size, fetched: None, crc })
    }

    fn read_archive(&mut self, archive: &[u8]) -> Result<(Container, Crc), LogError> {
        let options = &self.options;
        let (Unpacked { file, path }, end) =
            unpack::file(archive, &mut self.intake.unpack_budget, |offset| {
                options.set_position(offset)
            })
            .map_err(|source| LogError::Temporary { path: self.path.to_owned(), source })?;
        if let Err(error) = end {
            let extent = match error.extent() {
                Extent::Messages => Extent::Tail,
                ours => ours,
            };
            self.losses.add_unplaced(extent, None, error.to_string());
        }
        let looks = "an empty zstd archive";
        let unpacked = MappedFile::from_temporary(&file)
            .map_err(|_| LogError::NotALog { path: self.path.to_owned(), looks })?;
        // Progress refers to the archive.
        self.options.progress = None;
        self.read_named(file_format::detect_format(unpacked.bytes()), unpacked.bytes(), path)
    }

    /// Reads a log; `named` is the name of a temporary file.
    fn read_named(
        &mut self,
        kind: FileFormat,
        bytes: &[u8],
        named: Option<StagedFile>,
    ) -> Result<(Container, Crc), LogError> {
        match named {
            None => self.read_content(kind, self.path, bytes, || ()),
            // The name is removed once the file is open, or at the end if the system cannot unlink open
            // files.
            Some(path) => {
                let place = path.to_path_buf();
                let opened = || drop(std::fs::remove_file(&*path));
                self.read_content(kind, &place, bytes, opened)
            }
        }
    }

    /// Reads the log at `place`: its own path, or its temporary file. Calls `opened` once the name is no
    /// longer needed.
    fn read_content(
        &mut self,
        kind: FileFormat,
        place: &Path,
        bytes: &[u8],
        opened: impl FnOnce(),
    ) -> Result<(Container, Crc), LogError> {
        let Self { options, losses, intake, rtde, tables, memory, size, present, episode, .. } =
            self;
        // A layout replaces the names of RTDE fields.
        let kind = match kind {
            FileFormat::Rtde if options.columns.layout_of(self.path).is_some() => {
                FileFormat::Table(TableFormat::Csv)
            }
            kind => kind,
        };
        let path = || self.path.to_owned();
        let absent = |MissingByte(byte)| {
            let fault = RemoteFault::Contradiction { byte: byte as u64 };
            LogError::Remote { url: path(), fault }
        };
        let no_database = || LogError::Unsupported {
            path: path(),
            looks: "a rosbag2 database",
            instead: "SQLite cannot open files in a browser: convert it to MCAP, or use the command-line \
                program",
        };
        Ok(match kind {
            FileFormat::Mcap => {
                let of_bag = if self.in_bag { Container::RosBag2Mcap } else { Container::Mcap };
                let crc = mcap::read(bytes, present, options, losses, intake).map_err(absent)?;
                (of_bag, crc)
            }
            FileFormat::RosBag1 => {
                (Container::RosBag1, rosbag1::read(bytes, options, losses, intake))
            }
            // SQLite opens files by name only.
            FileFormat::Sqlite if options.given.contains_key(self.path) => {
                return Err(no_database());
            }
            #[cfg(target_arch = "wasm32")]
            FileFormat::Sqlite => {
                drop(opened);
                return Err(no_database());
            }
            #[cfg(not(target_arch = "wasm32"))]
            FileFormat::Sqlite => {
                if !rosbag2::read_database(place, options, losses, intake, opened) {
                    let looks = "a SQLite database without rosbag2 tables";
                    return Err(LogError::NotALog { path: path(), looks });
                }
                (Container::RosBag2Sqlite, Crc::None)
            }
            FileFormat::Rtde => {
                rtde.read(self.path, bytes, options, losses, intake);
                (Container::RtdeCsv, Crc::None)
            }
            FileFormat::Table(kind) => {
                let places = (self.path, place);
                let kind = match kind {
                    TableFormat::Csv if tables::is_tum_by_name(self.path, bytes) => {
                        TableFormat::Tum
                    }
                    kind => kind,
                };
                memory.add_file(*size);
                let mut context = tables::ReadContext { losses, memory, times: Vec::new() };
                let asked = (&options.columns, *episode);
                tables.read(kind, places, bytes, asked, &mut context, intake)?;
                (kind.container(), Crc::None)
            }
            FileFormat::Zstd => {
                let (looks, instead) = ("a zstd archive within a zstd archive", "unpack it first");
                return Err(LogError::Unsupported { path: path(), looks, instead });
            }
            FileFormat::Known { looks, instead } => {
                return Err(LogError::Unsupported { path: path(), looks, instead });
            }
            FileFormat::Unknown { looks } => return Err(LogError::NotALog { path: path(), looks }),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::Arc;

    use super::*;
    use crate::testing::{self, Cdr, LogWriter};
    use crate::{Progress, Topic};
    use ground::stream::Columns;
    use ground::time::Stamp;

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
    fn other_file_types_are_identified_by_their_bytes() {
        let text = refusal("run.mcap", b"name,of,what\nis,not,known\n");
        assert!(text.contains("FILE: not a robot log: it looks like text"), "{text}");
        let sqlite = refusal("run.mcap", b"SQLite format 3\0\x10\0");
        assert!(sqlite.contains("the database cannot be opened: "), "{sqlite}");
        let bag = refusal("run.mcap", b"#ROSBAG V1.2\nabc");
        assert!(bag.contains("ROS 1 bag of a version other than 2.0"), "{bag}");
        let pointer =
            refusal("run.csv", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n");
        assert!(pointer.contains("git lfs pull"), "{pointer}");
        let empty = refusal("run.mcap", b"");
        assert!(empty.contains("the file is empty"), "{empty}");
        let bytes = refusal("run.mcap", &[0x80, 0xff, 0, 1, 2, 3]);
        assert!(bytes.contains("unknown binary data"), "{bytes}");
        let stub = refusal("run.mcap", b"\x89MCA");
        assert!(stub.contains("MCAP file truncated"), "{stub}");
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
    fn a_log_without_messages_is_a_clear_error() {
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
    fn files_in_memory_are_read_like_those_on_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        ten_poses(&path, 100);
        let bytes = fs::read(&path).unwrap();
        let packed = zstd::bulk::compress(&bytes, 1).unwrap();
        let own = open_one(&path).unwrap();
        for content in [bytes.clone(), packed] {
            let name = PathBuf::from("run");
            let given = [(name.clone(), content.into())].into();
            let options = ReadOptions { given, ..ReadOptions::default() };
            let log = open(std::slice::from_ref(&name), &options).unwrap();
            assert_eq!((log.messages, &log.topics), (own.messages, &own.topics));
            assert_eq!(log.files[0].path, name);
        }
        let names = ["a", "b"].map(PathBuf::from);
        let refused = |contents: [Vec<u8>; 2]| {
            let given = names.clone().into_iter().zip(contents.map(Into::into)).collect();
            let options = ReadOptions { given, ..ReadOptions::default() };
            open(&names, &options).unwrap_err()
        };
        let twice = refused([bytes.clone(), bytes.clone()]);
        assert!(matches!(twice, LogError::Twice { .. }), "{twice}");
        assert!(matches!(refused([Vec::new(), bytes.clone()]), LogError::Empty { .. }));
        let database = refused([bytes, unpack::SQLITE_MAGIC.to_vec()]);
        assert!(database.to_string().contains("SQLite cannot open files"), "{database}");
    }

    #[test]
    fn progress_ends_at_the_total_size() {
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
    fn a_simulated_clock_is_detected() {
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
