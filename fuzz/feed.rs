//! What the fuzz targets do with bytes, for them and for the tests that replay their seeds.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use mcap::records::MessageHeader;
use poseaudit::log::{self, Log, LogError, ReadOptions};
use poseaudit::time::Clock;

/// A target: a folder of seeds, and what is done with each.
pub type Target = (&'static str, fn(&[u8]));

/// Every target.
pub const TARGETS: [Target; 11] = [
    ("mcap", file),
    ("rosbag1", file),
    ("rosbag2", file),
    ("rtde", file),
    ("zstd", file),
    ("metadata", metadata),
    ("ros2msg", |bytes| message("cdr", "ros2msg", bytes)),
    ("ros2idl", |bytes| message("cdr", "ros2idl", bytes)),
    ("ros1", |bytes| message("ros1", "ros1msg", bytes)),
    ("protobuf", |bytes| message("protobuf", "protobuf", bytes)),
    ("json", |bytes| message("json", "jsonschema", bytes)),
];

/// Does with `bytes` what the target of this name does.
pub fn feed(target: &str, bytes: &[u8]) {
    let (_, feed) = TARGETS.iter().find(|(name, _)| *name == target).expect("a target");
    feed(bytes);
}

/// Reads a log of these bytes, of whatever kind they are.
fn file(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("log");
    fs::write(&path, bytes).expect("a file");
    check(open(&path));
}

/// Reads a folder with this `metadata.yaml`, and a sound file beside it.
fn metadata(bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("metadata.yaml"), bytes).expect("a file");
    let log = recorded("json", "std_msgs/msg/String", "jsonschema", b"", br#"{"data":"a"}"#);
    fs::write(folder.path().join("run_0.mcap"), log).expect("a file");
    check(open(folder.path()));
}

/// Reads a log with one message, given with its type and schema before it: the type behind a byte of
/// its length, the schema behind two.
fn message(encoding: &str, schema_encoding: &str, bytes: &[u8]) {
    let Some((type_name, rest)) = delimited::<1>(bytes) else { return };
    let Some((schema, data)) = delimited::<2>(rest) else { return };
    let Ok(type_name) = std::str::from_utf8(type_name) else { return };
    file(&recorded(encoding, type_name, schema_encoding, schema, data));
}

/// What is behind a length of `WIDTH` bytes, and the rest.
fn delimited<const WIDTH: usize>(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<WIDTH>()?;
    let length = length.iter().rev().fold(0, |length, &byte| length << 8 | usize::from(byte));
    rest.split_at_checked(length)
}

/// An MCAP file with the message twice.
fn recorded(
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

/// Holds what was read to what every reader promises.
fn check(read: Result<Log, LogError>) {
    let log = match read {
        Ok(log) => log,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    assert!(log.messages > 0);
    for columns in log.topics.iter().filter_map(|topic| topic.columns.as_ref()) {
        for times in columns.times() {
            let lengths = [times.log.len(), times.on(Clock::Publish).len(), times.header.len()];
            assert_eq!(lengths, [times.log.len(); 3]);
        }
    }
}
