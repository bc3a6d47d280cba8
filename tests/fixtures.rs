//! The logs in `fixtures/` match the current generator.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

#[path = "../fixtures/scenarios.rs"]
mod scenarios;

/// Log times and sizes of the messages of each topic. Numbers may differ in their last digits between
/// platforms, and so do compressed bytes.
fn times_and_sizes(log: &[u8]) -> BTreeMap<String, Vec<(u64, usize)>> {
    let mut topics: BTreeMap<String, Vec<(u64, usize)>> = BTreeMap::new();
    for message in mcap::MessageStream::new(log).unwrap().map(Result::unwrap) {
        let topic = topics.entry(message.channel.topic.clone()).or_default();
        topic.push((message.log_time, message.data.len()));
    }
    topics
}

#[test]
fn fixtures_are_small_and_current() {
    for (name, run) in scenarios::all().unwrap() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name);
        let committed = std::fs::read(&path).unwrap();
        let mut generated = Vec::new();
        run.write_mcap(Cursor::new(&mut generated), Some(mcap::Compression::Zstd)).unwrap();
        assert!(committed.len() < 300_000, "{name} has {} bytes", committed.len());
        assert!(
            times_and_sizes(&committed) == times_and_sizes(&generated),
            "{name} differs from the generator's output: run `cargo run --example fixtures`"
        );
    }
}
