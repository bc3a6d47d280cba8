//! Audits of valid log files with arbitrary numbers, stamps, names, descriptions and joints, derived from a
//! byte string, and the invariants of every report.
//!
//! A generated log is rewritten message by message with edits that the string selects.
//! `examples/fuzz_audits.rs` generates strings for hours, and `tests/fuzz.rs` replays the seeds.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};
use poseaudit::boundary::catch_panic;
use poseaudit::geometry::{Convention, Misinterpretation};
use poseaudit::report::{Format, Report, Trouble, TroubleKind, Verdict};
use poseaudit::run::{RobotSource, RunOptions};
use poseaudit::synth::{LoggedEncoding, Motion, ROBOT_DESCRIPTION, Scenario};
use poseaudit::{Options, audit};

#[path = "tables.rs"]
mod tables;

/// A first byte from here on stands for a table, a lower one for messages.
const FIRST_TABLE_BYTE: u8 = 0xe8;
/// Maximum processor time for an audit of a 1 MB log in an unoptimised build, s.
const MAX_PROCESSOR_TIME_S: f64 = 60.0;
/// Maximum peak memory of the process, kB.
const MAX_PEAK_KB: u64 = 1_500_000;

/// Extreme numbers for message fields.
const EXTREME_NUMBERS: [f64; 18] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    1e308,
    -1e308,
    1e155,
    1e154,
    9e11,
    -1e9,
    1e6,
    57.3,
    1e3,
    1.0,
    1e-6,
    5e-324,
    0.0,
    -0.0,
    -1.0,
];

/// Extreme times, ns: at the limits of the range, and near them.
const EXTREME_NANOS: [i64; 10] = [
    0,
    1,
    -1,
    i64::MAX,
    i64::MIN,
    1_000_000_000,
    -3_000_000_000,
    4_294_967_295_999_999_999,
    1_780_000_000_000_000_000,
    2_000_000,
];

/// Hostile names that overwrite a text, up to its length.
const HOSTILE_TEXTS: [&str; 8] =
    ["/", "../../x", "\u{1b}[31m", "\u{202e}abc", "\"><script>", "%s%n", "\0\0\0\0", "tool0"];

/// Source of choices: bytes in order, then zeros.
struct ChoiceSource<'a>(&'a [u8]);

impl ChoiceSource<'_> {
    /// A choice below `count`.
    fn below(&mut self, count: usize) -> usize {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        usize::from(*first) * count.max(1) / 256
    }

    /// A choice below `count`, which may be large.
    fn index_below(&mut self, count: usize) -> usize {
        let fine = self.below(256);
        (self.below(256) * 256 + fine) * count.max(1) / 65536
    }

    fn flag(&mut self) -> bool {
        self.below(2) == 1
    }

    fn choose<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }
}

/// A message to be edited.
#[derive(Clone)]
struct Message {
    topic: String,
    type_name: String,
    definition: Vec<u8>,
    log_ns: u64,
    publish_ns: u64,
    cdr: Vec<u8>,
}

/// Audits the log derived from `bytes`, and checks the invariants of its report. Returns the kinds of its
/// answers, which distinguish logs.
pub fn audit_and_check(bytes: &[u8]) -> BTreeSet<String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run");
    let (mut draw, written) = match bytes.split_first() {
        Some((first, rest)) if *first >= FIRST_TABLE_BYTE => {
            let mut draw = ChoiceSource(rest);
            let written = tables::write(&mut draw, &path);
            (draw, Some(written))
        }
        _ => {
            let mut draw = ChoiceSource(bytes);
            write_messages(&mut draw, &path);
            (draw, None)
        }
    };
    let robot = draw.choose(&[None, None, Some("ur5e"), Some("panda")]);
    let options = Options {
        logs: vec![path],
        run: RunOptions {
            robots: robot.into_iter().map(RobotSource::from).collect(),
            ..RunOptions::default()
        },
        ..Options::default()
    };
    let with_figures_drawn = draw.flag();
    let audited = || -> Result<Report, Trouble> {
        let audited = audit(&options)?;
        Ok(if with_figures_drawn { audited.with_figures().report } else { audited.report })
    };
    let start_s = processor_time_s();
    let report = catch_panic(audited).unwrap_or_else(|panic| panic!("a panic: {panic}"));
    let elapsed_s = processor_time_s() - start_s;
    assert!(elapsed_s < MAX_PROCESSOR_TIME_S, "it took {elapsed_s} s");
    let peak_kb = peak_kb();
    assert!(peak_kb < MAX_PEAK_KB, "it took {peak_kb} kB");
    match report {
        Ok(report) => {
            if let Some(written) = written {
                tables::assert_rows_are_reported(&written, &report);
            }
            check_report(&report)
        }
        Err(trouble) => {
            assert!(!trouble.what.contains('\n') && !trouble.remedy.is_empty());
            BTreeSet::from([trouble.remedy])
        }
    }
}

/// Writes a log of messages.
fn write_messages(draw: &mut ChoiceSource, path: &Path) {
    let mut messages = messages_of(&draw_scenario(draw));
    for _ in 0..draw.below(6) {
        edit(draw, &mut messages);
    }
    match draw.below(4) {
        0 => std::fs::write(path, encode_mcap(&messages, None)).expect("a file"),
        1 => std::fs::write(path, encode_mcap(&messages, Some(Compression::Zstd))).expect("a file"),
        2 => std::fs::write(path, encode_mcap(&messages, Some(Compression::Lz4))).expect("a file"),
        _ => write_database(&messages, path),
    }
}

/// A sound run, or one with a planted fault.
fn draw_scenario(draw: &mut ChoiceSource) -> Scenario {
    let mut run = Scenario { duration_s: 2.0 + 0.5 * draw.below(5) as f64, ..Scenario::ur5e() };
    run.joints.timing.rate_hz = draw.choose(&[50.0, 25.0]);
    run.pose.timing.rate_hz = draw.choose(&[25.0, 50.0, 0.0]);
    run.tf.timing.rate_hz = draw.choose(&[12.5, 0.0, 50.0]);
    run.imu.timing.rate_hz = draw.choose(&[100.0, 0.0]);
    run.has_description = draw.flag();
    run.motion = if draw.flag() { Motion::Continuous } else { Motion::PickAndPlace };
    run.pose.timing.latency_s = draw.choose(&[0.0, 0.02]);
    run.joints.zero_offsets = vec![0.0, draw.choose(&[0.0, 0.02])];
    if draw.flag() {
        let misinterpretation =
            Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY };
        run.pose.encoding = LoggedEncoding::Misinterpreted(misinterpretation);
    }
    run.joints.is_in_degrees = draw.below(8) == 1;
    run.pose.is_in_millimetres = draw.below(8) == 1;
    run.pose.number_convention = (draw.below(4) == 1).then_some(Convention::RotVec);
    run.namespace = draw.choose(&["", "/left"]).to_owned();
    run
}

/// The messages of a run.
fn messages_of(run: &Scenario) -> Vec<Message> {
    let mut bytes = Vec::new();
    run.write_mcap(Cursor::new(&mut bytes), None).expect("a log");
    let read = mcap::MessageStream::new(&bytes).expect("a log");
    let message = |message: mcap::Message| {
        let schema = message.channel.schema.clone().expect("a schema");
        Message {
            topic: message.channel.topic.clone(),
            type_name: schema.name.clone(),
            definition: schema.data.to_vec(),
            log_ns: message.log_time,
            publish_ns: message.publish_time,
            cdr: message.data.to_vec(),
        }
    };
    read.map(|read| message(read.expect("a message"))).collect()
}

/// Edits some messages of one topic.
fn edit(draw: &mut ChoiceSource, messages: &mut Vec<Message>) {
    let topics: Vec<String> = {
        let names: BTreeSet<&String> = messages.iter().map(|message| &message.topic).collect();
        names.into_iter().cloned().collect()
    };
    if topics.is_empty() {
        return;
    }
    let topic = topics[draw.below(topics.len())].clone();
    let rows: Vec<usize> =
        (0..messages.len()).filter(|&row| messages[row].topic == topic).collect();
    let rows = select_rows(draw, &rows);
    let Some(length) = rows.iter().map(|&row| messages[row].cdr.len()).max() else { return };
    match draw.below(14) {
        // Numbers are aligned to eight bytes after the encapsulation header.
        0..4 => {
            let (at, value) =
                (4 + 8 * draw.index_below((length - 4) / 8), draw.choose(&EXTREME_NUMBERS));
            let all = draw.below(4) == 3;
            for row in rows {
                let cdr = &mut messages[row].cdr;
                let end = if all { cdr.len() } else { cdr.len().min(at + 8) };
                let places =
                    cdr.get_mut(at..end).into_iter().flat_map(|rest| rest.chunks_exact_mut(8));
                places.for_each(|place| place.copy_from_slice(&value.to_le_bytes()));
            }
        }
        4 => {
            let (at, factor) =
                (4 + 8 * draw.index_below((length - 4) / 8), draw.choose(&EXTREME_NUMBERS));
            for row in rows {
                if let Some(place) = messages[row].cdr.get_mut(at..at + 8) {
                    let value = f64::from_le_bytes(place.try_into().expect("eight bytes"));
                    place.copy_from_slice(&(value * factor).to_le_bytes());
                }
            }
        }
        // Most messages start with a header's stamp.
        5 => {
            let nanos = draw.choose(&EXTREME_NANOS);
            let (seconds, rest) =
                (nanos.div_euclid(1_000_000_000), nanos.rem_euclid(1_000_000_000));
            for row in rows {
                if let Some(place) = messages[row].cdr.get_mut(4..12) {
                    place[..4].copy_from_slice(&(seconds as i32).to_le_bytes());
                    place[4..].copy_from_slice(&(rest as u32).to_le_bytes());
                }
            }
        }
        6 => {
            let (nanos, adds, both) = (draw.choose(&EXTREME_NANOS), draw.flag(), draw.flag());
            for row in rows {
                let message = &mut messages[row];
                let before = if adds { message.log_ns } else { 0 };
                message.log_ns = before.wrapping_add_signed(nanos);
                message.publish_ns = if both { message.log_ns } else { message.publish_ns };
            }
        }
        7 => {
            let removed: BTreeSet<usize> = rows.into_iter().collect();
            let mut row = 0..;
            messages.retain(|_| !removed.contains(&row.next().unwrap_or(0)));
        }
        8 => {
            let repeated: Vec<Message> = rows.iter().map(|&row| messages[row].clone()).collect();
            messages.extend(repeated);
        }
        9 => {
            let (at, text) = (4 + draw.index_below(length), draw.choose(&HOSTILE_TEXTS));
            for row in rows {
                let letters = messages[row].cdr.iter_mut().skip(at);
                let letters = letters.skip_while(|byte| !byte.is_ascii_lowercase());
                letters.zip(text.bytes()).for_each(|(letter, byte)| *letter = byte);
            }
        }
        10 => {
            let (at, value) = (draw.index_below(length), draw.below(256) as u8);
            for row in rows {
                if let Some(byte) = messages[row].cdr.get_mut(at) {
                    *byte = value;
                }
            }
        }
        11 => {
            let keep = draw.index_below(length);
            rows.iter().for_each(|&row| messages[row].cdr.truncate(keep));
        }
        12 => edit_description(draw, messages),
        _ => {
            let other = topics[draw.below(topics.len())].clone();
            let name = draw.choose(&["", "/a b", "/x\n/y", "/tool0/pose", "joint_states"]);
            let name = if name.is_empty() { other } else { name.to_owned() };
            rows.iter().for_each(|&row| messages[row].topic.clone_from(&name));
        }
    }
}

/// Selects rows: one, a span, every n-th, or all.
fn select_rows(draw: &mut ChoiceSource, rows: &[usize]) -> Vec<usize> {
    let at = draw.index_below(rows.len());
    match draw.below(4) {
        0 => rows.get(at).copied().into_iter().collect(),
        1 => rows.iter().skip(at).take(1 + draw.index_below(rows.len())).copied().collect(),
        2 => rows.iter().skip(at).step_by(2 + draw.below(40)).copied().collect(),
        _ => rows.to_vec(),
    }
}

/// Changes a number of the arm's description, or removes a part of it.
fn edit_description(draw: &mut ChoiceSource, messages: &mut [Message]) {
    let is_it = |message: &&mut Message| message.topic.ends_with(ROBOT_DESCRIPTION);
    let Some(message) = messages.iter_mut().find(is_it) else { return };
    let Some(text) = message.cdr.get(8..) else { return };
    let text = String::from_utf8_lossy(text).trim_end_matches('\0').to_owned();
    let places: Vec<usize> = text.match_indices('"').map(|(at, _)| at).collect();
    let Some(&start) = places.get(2 * draw.index_below(places.len() / 2)) else { return };
    let end = places.iter().copied().find(|&at| at > start).unwrap_or(text.len());
    let odd =
        ["1e308 0 0", "-1e155 1e155 1", "0 0 0", "nan", "prismatic", "floating", "", "1e6 0 0"];
    let text = match draw.flag() {
        true => format!("{}\"{}{}", &text[..start], draw.choose(&odd), &text[end..]),
        false => {
            let end = (end + 1 + draw.index_below(4000)).min(text.len());
            let end = (end..=text.len()).find(|&at| text.is_char_boundary(at)).unwrap_or(end);
            format!("{}{}", &text[..start], &text[end..])
        }
    };
    message.cdr.truncate(4);
    message.cdr.extend((text.len() as u32 + 1).to_le_bytes());
    message.cdr.extend(text.bytes());
    message.cdr.push(0);
}

fn encode_mcap(messages: &[Message], compression: Option<Compression>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = WriteOptions::new().compression(compression).compression_threads(0);
    let mut writer = options.create(Cursor::new(&mut bytes)).expect("a writer");
    let mut channels: BTreeMap<(&str, &str), u16> = BTreeMap::new();
    for (sequence, message) in (1..).zip(messages) {
        let channel = (message.topic.as_str(), message.type_name.as_str());
        let channel_id = *channels.entry(channel).or_insert_with(|| {
            let schema = writer.add_schema(&message.type_name, "ros2msg", &message.definition);
            let schema = schema.expect("a schema");
            let channel = writer.add_channel(schema, &message.topic, "cdr", &BTreeMap::new());
            channel.expect("a channel")
        });
        let Message { log_ns: log_time, publish_ns: publish_time, .. } = *message;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        writer.write_to_known_channel(&header, &message.cdr).expect("a message");
    }
    writer.finish().expect("an end");
    drop(writer);
    bytes
}

/// A rosbag2 database with the messages.
fn write_database(messages: &[Message], path: &Path) {
    let database = rusqlite::Connection::open(path).expect("a database");
    let schema = "
        BEGIN;
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
        CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,
            encoded_message_definition TEXT);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);";
    database.execute_batch(schema).expect("tables");
    let mut topics: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let mut types: BTreeSet<&str> = BTreeSet::new();
    for message in messages {
        let next = topics.len() + 1;
        let topic = *topics.entry((&message.topic, &message.type_name)).or_insert(next);
        if topic == next {
            let insert = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr')";
            let row = (topic as i64, &message.topic, &message.type_name);
            database.execute(insert, row).expect("a topic");
        }
        if types.insert(&message.type_name) {
            let insert = "INSERT INTO message_definitions (topic_type, encoding, \
                          encoded_message_definition) VALUES (?1, 'ros2msg', ?2)";
            let text = String::from_utf8_lossy(&message.definition);
            database.execute(insert, (&message.type_name, text)).expect("a definition");
        }
        let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        let row = (topic as i64, message.log_ns.cast_signed(), &message.cdr);
        database.execute(insert, row).expect("a message");
    }
    database.execute_batch("COMMIT").expect("an end");
}

/// Checks the invariants of a report, and returns its answers.
fn check_report(report: &Report) -> BTreeSet<String> {
    // Exit statuses: 0 and 1 by the verdict, 2 and 3 by the error.
    let status = match (&report.error, report.verdict) {
        (Some(trouble), _) if trouble.kind == TroubleKind::Call => 2,
        (Some(_), _) => 3,
        (None, Verdict::Fail) => 1,
        (None, Verdict::Pass | Verdict::Inconclusive) => 0,
    };
    let mut answers = BTreeSet::from([format!("{status}")]);
    for name in ["json", "text", "markdown", "html"] {
        let format = Format::from_name(name).expect("a format");
        if (format.has_plots() || format.is_text()) && report.figures.is_none() {
            continue;
        }
        let mut written = Vec::new();
        format.write(report, &mut written).expect("a report");
        let written = String::from_utf8(written).expect("UTF-8");
        assert!(!written.is_empty());
        if name == "json" {
            assert_plausible_numbers(&serde_json::from_str(&written).expect("JSON"), "");
        }
        if name == "text" {
            written.lines().for_each(assert_no_invalid_value);
        }
    }
    for finding in &report.findings {
        answers.insert(format!("{} {:?} {}", finding.code, finding.severity, finding.title));
    }
    for row in &report.checks {
        answers.insert(format!("{} {:?}", row.code, row.status));
    }
    // Omissions must be reported.
    if report.verdict == Verdict::Pass && report.error.is_none() {
        let is_audited = |role: &str| matches!(role, "joints" | "pose" | "tf" | "imu");
        for stream in report.streams.iter().filter(|stream| stream.dropped > 0) {
            let is_topic = |topic: Option<&String>| topic == Some(&stream.topic);
            let is_found =
                report.findings.iter().any(|found| is_topic(found.subject.topic.as_ref()));
            let is_reported = is_found
                || report.checks.iter().any(|row| {
                    let reason = row.reason.as_deref().unwrap_or_default();
                    is_topic(row.subject.topic.as_ref()) && reason.contains("left out")
                });
            assert!(!is_audited(stream.role) || is_reported, "{stream:?}");
        }
    }
    answers
}

/// Asserts that a line contains no invalid value.
fn assert_no_invalid_value(line: &str) {
    // Messages say which numbers are unusable.
    let line = &line.replace("(NaN, infinite or beyond 1e12)", "");
    let mut words = line.split(|c: char| !c.is_alphanumeric());
    assert!(!words.any(|word| matches!(word, "NaN" | "inf")), "{line}");
    let longest = line.split(|c: char| !c.is_ascii_digit()).map(str::len).max();
    assert!(longest.unwrap_or(0) <= 40, "{line}");
}

/// Asserts that all numbers of a report are plausible.
fn assert_plausible_numbers(value: &serde_json::Value, place: &str) {
    match value {
        serde_json::Value::Number(number) => {
            let number = number.as_f64().unwrap_or(f64::INFINITY);
            assert!(number.abs() < 1e30, "{place}: {number}");
        }
        serde_json::Value::Array(values) => {
            values.iter().for_each(|value| assert_plausible_numbers(value, place))
        }
        serde_json::Value::Object(map) => {
            map.iter().for_each(|(key, value)| assert_plausible_numbers(value, key))
        }
        _ => {}
    }
}

/// Peak memory of this process, kB; 0 if the system does not provide it.
fn peak_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Processor time of this process, s; 0 if the system does not provide it.
pub fn processor_time_s() -> f64 {
    const TICKS_PER_S: f64 = 100.0;
    let status = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = status.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks = fields.skip(11).take(2).filter_map(|field| field.parse::<f64>().ok());
    ticks.sum::<f64>() / TICKS_PER_S
}
