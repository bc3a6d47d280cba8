//! Implements the fuzz targets, for the fuzzer and for the tests that replay their seeds.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use self::containers::{tfrecord_frame, workbook, zip_archive};
use mcap::records::MessageHeader;
use poseaudit::log::{self, ColumnSettings, Log, LogError, ReadOptions};
use poseaudit::time::Clock;

#[path = "containers.rs"]
mod containers;

/// A target: a folder of seeds, and the function that processes each.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: [Target; 24] = [
    ("mcap", read_file),
    ("rosbag1", read_file),
    ("rosbag2", read_file),
    ("rtde", read_file),
    ("zstd", read_file),
    ("metadata", read_metadata),
    ("ros2msg", |bytes| read_message("cdr", "ros2msg", bytes)),
    ("ros2idl", |bytes| read_message("cdr", "ros2idl", bytes)),
    ("ros1", |bytes| read_message("ros1", "ros1msg", bytes)),
    ("protobuf", |bytes| read_message("protobuf", "protobuf", bytes)),
    ("json", |bytes| read_message("json", "jsonschema", bytes)),
    ("csv", read_csv),
    ("hdf5", read_file),
    ("lerobot", read_lerobot),
    ("npy", read_file),
    ("npz", read_npz),
    ("parquet", read_file),
    ("rsi", read_file),
    ("tfrecord", read_tfrecord),
    ("zarr", read_zarr),
    ("columns", read_columns),
    ("records", read_file),
    ("xlsx", read_workbook),
    ("yaml", read_file),
];

/// Runs the named target on `bytes`.
pub fn feed(target: &str, bytes: &[u8]) {
    let (_, feed) = TARGETS.iter().find(|(name, _)| *name == target).expect("a target");
    feed(bytes);
}

/// Reads a log of any kind from these bytes.
fn read_file(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("log");
    fs::write(&path, bytes).expect("a file");
    check_log(open(&path));
}

/// Reads a table with a layout of its columns, which follows one byte of its length.
fn read_columns(bytes: &[u8]) {
    let Some((layout, table)) = split_after_length::<1>(bytes) else { return };
    let Some(layout) = std::str::from_utf8(layout).ok().and_then(|text| text.parse().ok()) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("log");
    fs::write(&path, table).expect("a file");
    let columns = ColumnSettings { layouts: vec![layout], ..ColumnSettings::default() };
    check_log(log::open(&[path], &ReadOptions { columns, ..ReadOptions::default() }));
}

/// Reads a workbook with one sheet; its shared strings follow two bytes of their length.
fn read_workbook(bytes: &[u8]) {
    let Some((strings, sheet)) = split_after_length::<2>(bytes) else { return };
    read_file(&workbook(strings, sheet));
}

/// Reads the same bytes as a log and as calibration tables.
fn read_csv(bytes: &[u8]) {
    read_file(bytes);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("table.csv");
    fs::write(&path, bytes).expect("a file");
    if let Some(table) = log::read_number_table(&path).expect("a file") {
        assert!(table.rows.iter().all(|row| row.len() == table.width()));
        assert!(table.rows.iter().flatten().all(|value| value.is_finite()));
        let joints: Vec<String> = (0..table.width()).map(|joint| format!("j{joint}")).collect();
        let columns = table.joints(&joints).unwrap_or_default();
        assert!(columns.iter().all(|&column| column < table.width()));
    }
    let settings = ColumnSettings::default();
    // A table without a position is refused.
    if let Ok(Some(table)) = log::read_calibration_table(&path, &settings) {
        let width = table.numbers.width();
        assert!(table.positions.iter().flatten().all(|&column| column < width));
    }
}

/// Reads a folder with this `metadata.yaml` and a valid file.
fn read_metadata(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("metadata.yaml"), bytes).expect("a file");
    let log =
        mcap_with_message("json", "std_msgs/msg/String", "jsonschema", b"", br#"{"data":"a"}"#);
    fs::write(folder.path().join("run_0.mcap"), log).expect("a file");
    check_log(open(folder.path()));
}

/// Reads a dataset with this `info.json` and a valid episode.
fn read_lerobot(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let chunk = folder.path().join("data/chunk-000");
    fs::create_dir_all(&chunk).expect("a folder");
    fs::create_dir_all(folder.path().join("meta")).expect("a folder");
    fs::write(folder.path().join("meta/info.json"), bytes).expect("a file");
    fs::write(chunk.join("episode_000000.parquet"), EPISODE).expect("a file");
    check_log(open(folder.path()));
}

const EPISODE: &[u8] = include_bytes!("seeds/lerobot.parquet");

/// Reads a store with one array: two bytes of length, its metadata, and its first chunk.
fn read_zarr(bytes: &[u8]) {
    let Some((metadata, chunk)) = split_after_length::<2>(bytes) else { return };
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("q")).expect("a folder");
    for (name, content) in [
        (".zgroup", br#"{"zarr_format": 2}"#.as_slice()),
        (".zattrs", br#"{"fps": 10}"#),
        ("q/.zarray", metadata),
        ("q/0.0", chunk),
    ] {
        fs::write(folder.path().join(name), content).expect("a file");
    }
    check_log(open(folder.path()));
}

/// Reads an archive of two arrays; the first follows two bytes of its length.
fn read_npz(bytes: &[u8]) {
    let Some((first, second)) = split_after_length::<2>(bytes) else { return };
    read_file(&zip_archive(&[("timestamp.npy", first), ("q.npy", second)]));
}

/// Reads a file of records with valid checksums, each after two bytes of its length.
fn read_tfrecord(mut bytes: &[u8]) {
    let mut framed = Vec::new();
    while let Some((record, rest)) = split_after_length::<2>(bytes) {
        framed.extend(tfrecord_frame(record));
        bytes = rest;
    }
    read_file(&framed);
}

/// Reads a log with one message, after its type (one length byte) and its schema (two).
fn read_message(encoding: &str, schema_encoding: &str, bytes: &[u8]) {
    let Some((type_name, rest)) = split_after_length::<1>(bytes) else { return };
    let Some((schema, data)) = split_after_length::<2>(rest) else { return };
    let Ok(type_name) = std::str::from_utf8(type_name) else { return };
    read_file(&mcap_with_message(encoding, type_name, schema_encoding, schema, data));
}

/// Splits after a length of `WIDTH` bytes and that much data.
fn split_after_length<const WIDTH: usize>(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<WIDTH>()?;
    let length = length.iter().rev().fold(0, |length, &byte| length << 8 | usize::from(byte));
    rest.split_at_checked(length)
}

/// An MCAP file with the message twice.
fn mcap_with_message(
    encoding: &str,
    type_name: &str,
    schema_encoding: &str,
    schema: &[u8],
    data: &[u8],
) -> Vec<u8> {
    let plain = mcap::WriteOptions::new().use_chunks(false);
    let mut writer = plain.create(Cursor::new(Vec::new())).expect("a writer");
    let schema = writer.add_schema(type_name, schema_encoding, schema).expect("a schema");
    let channel_id = writer.add_channel(schema, "/topic", encoding, &Default::default());
    let channel_id = channel_id.expect("a channel");
    for time in [1, 2] {
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, data).expect("a message");
    }
    writer.finish().expect("an end");
    writer.into_inner().into_inner()
}

fn open(path: &Path) -> Result<Log, LogError> {
    log::open(&[path.to_owned()], &ReadOptions { verify: true, ..ReadOptions::default() })
}

/// Checks the invariants of every reader.
fn check_log(read: Result<Log, LogError>) {
    let log = match read {
        Ok(log) => log,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    assert!(log.messages > 0);
    for columns in log.topics.iter().filter_map(|topic| topic.columns.as_ref()) {
        for times in columns.times() {
            let lengths =
                [times.log.len(), times.nanos_on(Clock::Publish).len(), times.header.len()];
            assert_eq!(lengths, [times.log.len(); 3]);
        }
    }
}
