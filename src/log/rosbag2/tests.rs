use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::super::testing::{Cdr, DatabaseWriter, LogWriter, POSE_STAMPED};
use super::super::{Container, Extent, Log, LogError, ReadOptions, open};
use super::*;
use ground::stream::{Columns, PoseColumns};

fn read(path: &Path) -> Log {
    try_read(path).unwrap()
}

fn try_read(path: &Path) -> Result<Log, LogError> {
    open(&[path.to_owned()], &ReadOptions::default())
}

fn rows(log: &Log) -> &PoseColumns {
    match &log.topics[0].columns {
        Some(Columns::Poses(poses)) => &poses[0],
        other => panic!("{other:?}"),
    }
}

fn database(path: &Path, first: u32, count: u32) {
    let database = DatabaseWriter::create(path);
    database.poses(1, "/pose");
    database.count_poses(1, first, count);
}

fn mcap(path: &Path, first: u32, count: u32) {
    let mut log = LogWriter::default();
    let channel = log.channel("/pose", "geometry_msgs/msg/PoseStamped", POSE_STAMPED);
    for n in first..first + count {
        let message = Cdr::pose_stamped(0, n, "base", [n.into(), 0.5, 0.25]);
        log.message(channel, n.into(), &message);
    }
    fs::write(path, log.finish()).unwrap();
}

fn metadata(folder: &Path, files: &[(&str, u64)]) {
    let mut text = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: sqlite3\n  \
                    custom_data: ~\n  relative_file_paths:\n"
        .to_owned();
    for (name, _) in files {
        text += &format!("    - {name}\n");
    }
    let all: u64 = files.iter().map(|(_, count)| count).sum();
    text += &format!("  message_count: {all}\n  files:\n");
    for (name, count) in files {
        text += &format!("    - path: {name}\n      message_count: {count}\n");
    }
    fs::write(folder.join(METADATA), text).unwrap();
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn names_in(folder: &Path) -> Vec<PathBuf> {
    files_in(folder).unwrap()
}

#[test]
fn a_database_gives_its_rows() {
    let folder = folder();
    // Must be escaped in a URI; misleading extension.
    let path = folder.path().join("a b?#%.mcap");
    database(&path, 5, 100);
    let log = read(&path);
    assert_eq!(log.losses, []);
    assert_eq!(log.files[0].container, Container::RosBag2Sqlite);
    assert_eq!(log.messages, 100);
    let expected: Vec<i64> = (5..105).collect();
    assert_eq!(rows(&log).times.log, expected);
    assert_eq!(rows(&log).times.header, expected);
    assert_eq!(rows(&log).xyz[99], [104.0, 0.5, 0.25]);
    assert_eq!(names_in(folder.path()), [path]);
}

#[test]
fn the_first_schema_version_is_read() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    let database = DatabaseWriter::create_old(&path);
    database.poses(7, "/pose");
    database.count_poses(7, 0, 10);
    let log = read(&path);
    assert_eq!(log.losses, []);
    let topic = &log.topics[0];
    assert_eq!((topic.name.as_str(), topic.messages), ("/pose", 10));
    assert_eq!(topic.type_name, "geometry_msgs/msg/PoseStamped");
}

#[test]
fn rows_and_times_below_zero_are_read() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    let database = DatabaseWriter::create(&path);
    database.poses(1, "/pose");
    let insert = "INSERT INTO messages (id, topic_id, timestamp, data) VALUES (?1, 1, ?2, ?3)";
    for (row, time) in [(-70_000, -5), (0, 10), (3, 20)] {
        let message = Cdr::pose_stamped(0, 1, "base", [0.0; 3]);
        database.database().execute(insert, (row, time, message)).unwrap();
    }
    let log = read(&path);
    assert_eq!(log.losses, []);
    assert_eq!(rows(&log).times.log, [0, 10, 20]);
    let [note] = log.notes.as_slice() else { panic!("{:?}", log.notes) };
    assert!(note.what.contains("receive time of 1 messages is before 1970"), "{note:?}");
}

#[test]
fn a_write_ahead_log_is_read_and_not_modified() {
    let (recording, crashed) = (folder(), folder());
    let path = recording.path().join("run.db3");
    database(&path, 0, 50);
    let database = DatabaseWriter(&path);
    let copy = crashed.path().join("run.db3");
    fs::copy(&path, &copy).unwrap();
    fs::copy(beside(&path), beside(&copy)).unwrap();
    drop(database);
    let before: Vec<Vec<u8>> = [&copy, &beside(&copy)].map(|path| fs::read(path).unwrap()).into();
    assert_eq!(read(&copy).messages, 80);
    assert_eq!(names_in(crashed.path()), [copy.clone(), beside(&copy)]);
    let after: Vec<Vec<u8>> = [&copy, &beside(&copy)].map(|path| fs::read(path).unwrap()).into();
    assert!(before == after);

    // Frames have 1048 bytes; transactions have several.
    let [whole, wal] = [&before[0], &before[1]];
    let mut leftover = wal.clone();
    let frame = leftover[32..32 + 1048].to_vec();
    leftover.extend_from_slice(&frame);
    let length = wal.len();
    leftover[length + 8..length + 16].fill(7);
    let mut flipped = wal.clone();
    flipped[32 + 10 * 1048 + 500] ^= 1;
    let mut headless = wal.clone();
    headless[20] ^= 1;
    let cases = [
        (leftover, None),
        (flipped, Some("at byte 10512: frames from 11 on cannot be read")),
        (headless, Some("at byte 0: header damaged")),
        (wal[..length - 7].to_vec(), Some("truncated within frame")),
        (wal[..20].to_vec(), Some("truncated: 20 bytes are too few for a header")),
        (wal[..length - 1048].to_vec(), Some("belong to an incomplete transaction")),
    ];
    for (bytes, expected) in cases {
        fs::write(&copy, whole).unwrap();
        fs::write(beside(&copy), bytes).unwrap();
        let log = read(&copy);
        let what: Vec<&str> = log.losses.iter().map(|loss| loss.what.as_str()).collect();
        assert_eq!(what.len(), usize::from(expected.is_some()), "{what:?}");
        assert!(expected.is_none_or(|expected| what[0].contains(expected)), "{what:?}");
        assert!(log.losses.iter().all(|loss| loss.extent == Extent::Messages));
    }

    /// 30 messages are only in the write-ahead log.
    #[expect(non_snake_case, reason = "they are named as ROS names them")]
    fn DatabaseWriter(path: &Path) -> rusqlite::Connection {
        let database = rusqlite::Connection::open(path).unwrap();
        database.query_row("PRAGMA journal_mode = WAL", [], |_| Ok(())).unwrap();
        for n in 50..80 {
            let message = Cdr::pose_stamped(0, n, "base", [0.0; 3]);
            let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?1, ?2)";
            database.execute(insert, (n, message)).unwrap();
        }
        database
    }

    fn beside(path: &Path) -> PathBuf {
        path.with_extension("db3-wal")
    }
}

#[test]
fn a_damaged_page_loses_only_its_messages() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    database(&path, 0, 400);
    let mut bytes = fs::read(&path).unwrap();
    // A leaf page (0x0d) of the messages inside the file.
    let page = (30..).find(|page| bytes[page * 1024] == 0x0d).unwrap();
    bytes[page * 1024..(page + 1) * 1024].fill(0xaa);
    fs::write(&path, &bytes).unwrap();
    let log = read(&path);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert!(loss.what.contains("malformed"), "{}", loss.what);
    assert_eq!(loss.extent, Extent::Messages);
    assert_eq!(loss.messages, Some(400 - log.messages));
    assert!(log.messages >= 390, "{}", log.messages);
}

#[test]
fn a_truncated_database_is_read_up_to_its_end() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    database(&path, 0, 400);
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 5000]).unwrap();
    let log = read(&path);
    assert!((340..400).contains(&log.messages), "{}", log.messages);
    let expected = format!("truncated: {} of {} bytes", whole.len() - 5000, whole.len());
    let of_file = log.losses.iter().filter(|loss| !loss.what.contains("are out of order"));
    let [cut] = of_file.collect::<Vec<_>>()[..] else { panic!("{:?}", log.losses) };
    assert!(cut.what.ends_with(&expected), "{}", cut.what);
    assert_eq!(cut.extent, Extent::Messages);
}

fn cells(bytes: &[u8], page: usize, header: usize) -> Vec<usize> {
    let two = |at: usize| usize::from(bytes[at]) << 8 | usize::from(bytes[at + 1]);
    let page = page * 1024;
    (0..two(page + 3)).map(|cell| page + two(page + header + 2 * cell)).collect()
}

#[test]
fn unordered_row_numbers_are_damage_and_the_search_ends() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    database(&path, 0, 4000);
    let whole = fs::read(&path).unwrap();
    let pages = |kind: u8| (30..whole.len() / 1024).filter(move |&page| whole[page * 1024] == kind);
    // The row number follows the length of the content; each has one or two bytes.
    let whole = fs::read(&path).unwrap();
    let mut bytes = whole.clone();
    let cell = cells(&bytes, pages(0x0d).nth(20).unwrap(), 8)[1];
    let number = cell + 1 + usize::from(bytes[cell] >> 7);
    bytes[number] = 0x80;
    fs::write(&path, &bytes).unwrap();
    let log = read(&path);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert!(
        loss.what.starts_with("1 rows of the table `messages` are out of order"),
        "{}",
        loss.what
    );
    assert_eq!((loss.messages, log.messages), (Some(1), 3999));

    let mut bytes = whole.clone();
    let page = (2..).find(|&page| bytes[page * 1024] == 0x05).unwrap();
    let ways = cells(&bytes, page, 12);
    let first: [u8; 4] = bytes[ways[0]..ways[0] + 4].try_into().unwrap();
    for way in ways {
        bytes[way..way + 4].copy_from_slice(&first);
    }
    fs::write(&path, &bytes).unwrap();
    let log = read(&path);
    let lost: u64 = log.losses.iter().filter_map(|loss| loss.messages).sum();
    assert!(log.messages < 4000 && lost > 0, "{} read, {lost} lost", log.messages);
}

#[test]
fn every_truncation_and_flipped_byte_is_survived() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    database(&path, 0, 60);
    let whole = fs::read(&path).unwrap();
    let damaged = folder.path().join("damaged.db3");
    for length in (100..whole.len()).step_by(97) {
        fs::write(&damaged, &whole[..length]).unwrap();
        if let Ok(log) = try_read(&damaged) {
            assert!(log.messages < 60 || !log.losses.is_empty() || length + 4096 > whole.len());
        }
    }
    for index in (0..whole.len()).step_by(29) {
        let mut bytes = whole.clone();
        bytes[index] ^= 0xff;
        fs::write(&damaged, &bytes).unwrap();
        if let Ok(log) = try_read(&damaged) {
            assert!(log.messages <= 61, "byte {index}");
        }
    }
}

#[test]
fn views_and_virtual_tables_are_refused() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    let database = DatabaseWriter::create(&path);
    database
        .database()
        .execute_batch(
            "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS \
             (SELECT 1 UNION ALL SELECT id + 1 FROM n) \
             SELECT id, 1 AS topic_id, 1 AS timestamp, x'00' AS data FROM n;",
        )
        .unwrap();
    drop(database);
    let error = try_read(&path).unwrap_err().to_string();
    assert!(error.contains("SQLite database without rosbag2 tables"), "{error}");
}

#[test]
fn files_of_a_folder_form_one_log_and_missing_ones_are_reported() {
    let folder = folder();
    database(&folder.path().join("run_0.db3"), 0, 10);
    mcap(&folder.path().join("run_2.mcap"), 30, 10);
    metadata(folder.path(), &[("run_0.db3", 10), ("run/run_1.db3", 20), ("run_2.mcap", 10)]);
    let log = read(folder.path());
    let containers: Vec<Container> = log.files.iter().map(|file| file.container).collect();
    assert_eq!(containers, [Container::RosBag2Sqlite, Container::RosBag2Mcap]);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert_eq!((loss.extent, loss.messages), (Extent::Messages, Some(20)));
    assert!(loss.what.contains("run_1.db3"), "{}", loss.what);
    assert_eq!(log.messages, 20);
    assert_eq!(rows(&log).times.log.iter().sum::<i64>(), 45 + 345);
}

#[test]
fn unlisted_splits_are_read_and_reported() {
    let folder = folder();
    for split in [0, 1, 2, 10] {
        mcap(&folder.path().join(format!("run_{split}.mcap")), 10 * split, 10);
    }
    database(&folder.path().join("run_1.db3"), 0, 10);
    database(&folder.path().join("other_1.db3"), 0, 10);
    let text =
        "rosbag2_bagfile_information:\n  relative_file_paths:\n    - run_0.mcap\n    - run_1.mc";
    fs::write(folder.path().join(METADATA), text).unwrap();
    let log = read(folder.path());
    let names: Vec<_> = log.files.iter().filter_map(|file| file.path.file_name()).collect();
    assert_eq!(names, ["run_0.mcap", "run_1.mcap", "run_2.mcap", "run_10.mcap"]);
    assert_eq!(log.messages, 40);
    let count_losses = |extent| log.losses.iter().filter(|loss| loss.extent == extent).count();
    assert_eq!(
        (count_losses(Extent::Index), count_losses(Extent::Messages), log.losses.len()),
        (3, 1, 4)
    );
    let notes: Vec<&str> = log.notes.iter().map(|note| note.what.as_str()).collect();
    assert_eq!(notes, ["not listed in metadata.yaml, so it was not read"; 2]);
}

#[test]
fn a_broken_split_loses_no_other_split() {
    let folder = folder();
    database(&folder.path().join("run_0.db3"), 0, 10);
    fs::write(folder.path().join("run_1.db3"), b"").unwrap();
    metadata(folder.path(), &[("run_0.db3", 10), ("run_1.db3", 20)]);
    let log = read(folder.path());
    assert_eq!(log.messages, 10);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert_eq!((loss.extent, loss.messages), (Extent::Messages, Some(20)));
}

#[test]
fn messages_counted_by_metadata_and_missing_in_the_database_are_lost() {
    let folder = folder();
    database(&folder.path().join("run_0.db3"), 0, 10);
    metadata(folder.path(), &[("run_0.db3", 13)]);
    let log = read(folder.path());
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert_eq!((loss.extent, loss.messages), (Extent::Messages, Some(3)));
    assert_eq!(loss.what, "metadata.yaml counts 13 messages, but 10 were found");
}

#[test]
fn a_folder_without_metadata_is_read_if_it_is_one_recording() {
    let folder = folder();
    database(&folder.path().join("run_0.db3"), 0, 10);
    database(&folder.path().join("run_1.db3"), 10, 10);
    fs::write(folder.path().join("notes.txt"), "nothing").unwrap();
    let log = read(folder.path());
    assert_eq!((log.messages, log.files.len()), (20, 2));
    let [note] = log.notes.as_slice() else { panic!("{:?}", log.notes) };
    assert_eq!(note.what, "no metadata.yaml: the 2 log files in the folder are read");
    database(&folder.path().join("other.db3"), 0, 10);
    let error = try_read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("logs of several runs"), "{error}");
}

#[test]
fn a_folder_with_one_table_is_that_table_and_nested_folders_are_several_runs() {
    let folder = folder();
    let run = folder.path().join("session/take/run");
    fs::create_dir_all(&run).unwrap();
    let row = |row: u32| format!("{{\"t\": {}, \"q\": [0, 0, {row}]}}\n", 0.01 * f64::from(row));
    let rows: String = (0..30).map(row).collect();
    fs::write(run.join("data.jsonl"), rows).unwrap();
    assert_eq!(read(&run).files.len(), 1);
    let error = try_read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("logs of several runs"), "{error}");
}

#[test]
fn a_broken_metadata_file_is_damage_to_the_index() {
    let folder = folder();
    database(&folder.path().join("run_0.db3"), 0, 10);
    fs::write(folder.path().join(METADATA), "rosbag2_bagfile_information: [1, {").unwrap();
    let log = read(folder.path());
    assert_eq!(log.messages, 10);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert_eq!((loss.extent, loss.messages), (Extent::Index, Some(0)));
}

#[test]
fn files_packed_by_zstd_are_read() {
    let folder = folder();
    let names = ["run_0.db3.zstd", "run_1.mcap.zstd"];
    let plain = folder.path().join("plain");
    database(&plain, 0, 10);
    let pack = |name: &str| {
        let packed = zstd::bulk::compress(&fs::read(&plain).unwrap(), 1).unwrap();
        fs::write(folder.path().join(name), packed).unwrap();
        fs::remove_file(&plain).unwrap();
    };
    pack(names[0]);
    mcap(&plain, 10, 10);
    pack(names[1]);
    metadata(folder.path(), &[(names[0], 10), (names[1], 10)]);
    let log = read(folder.path());
    assert_eq!((log.messages, log.losses.as_slice()), (20, [].as_slice()));
    let containers: Vec<Container> = log.files.iter().map(|file| file.container).collect();
    assert_eq!(containers, [Container::RosBag2Sqlite, Container::RosBag2Mcap]);
    let lone = read(&folder.path().join(names[1]));
    assert_eq!(lone.files[0].container, Container::Mcap);
    assert_eq!(lone.messages, 10);
}

#[test]
fn messages_packed_by_zstd_are_read() {
    let folder = folder();
    let path = folder.path().join("run.db3");
    let database = DatabaseWriter::create(&path);
    database.poses(1, "/pose");
    for n in 0..10 {
        let message = Cdr::pose_stamped(0, n, "base", [n.into(), 0.5, 0.25]);
        database.message(1, n.into(), &zstd::bulk::compress(&message, 1).unwrap());
    }
    database.message(1, 10, b"\x28\xb5\x2f\xfdnot zstd");
    let log = read(&path);
    assert_eq!(rows(&log).xyz[9], [9.0, 0.5, 0.25]);
    assert_eq!(rows(&log).times.len(), 10);
    let undecodable = log.topics[0].undecodable.as_ref().unwrap();
    assert_eq!(undecodable.messages, 1);
    assert!(undecodable.first.contains("(row 11 of the table `messages`)"), "{undecodable:?}");
}
