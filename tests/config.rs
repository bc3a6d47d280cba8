//! Effects of a config on an audit, and the config that `init` writes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Cursor;
use std::mem::discriminant;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use boon::{Compiler, Schemas};
use poseaudit::Options;
use poseaudit::config::{Config, template};
use poseaudit::finding::{Severity, Status};
use poseaudit::report::{Report, Verdict};
use poseaudit::synth::POSE;
use serde_json::Value;

/// The reports on the fixtures, each with its log.
static REPORTS: LazyLock<Vec<(PathBuf, Report)>> = LazyLock::new(|| {
    let entries = fs::read_dir(fixture("")).expect("the fixtures");
    let logs = entries.map(|entry| entry.expect("an entry").path());
    let logs = logs.filter(|log| log.extension().is_some_and(|extension| extension == "mcap"));
    let audited = logs.map(|log| {
        let options = Options { logs: vec![log.clone()], ..Options::default() };
        (log, poseaudit::audit(&options).expect("a report").report)
    });
    audited.collect()
});

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// Audits a log with a config.
fn audit_with_config(log: &Path, config: &str) -> Report {
    let config = Config::from_text(config.to_owned(), Path::new("p.toml")).expect("a config");
    let options = Options { logs: vec![log.to_owned()], ..config.options() };
    poseaudit::audit(&options).expect("a report").report
}

fn audit_faulty_log(config: &str) -> Report {
    audit_with_config(&fixture("faulty.mcap"), config)
}

/// Findings, as `CODE subject`.
fn found_subjects(report: &Report) -> Vec<String> {
    let subjects =
        report.findings.iter().map(|one| format!("{} {}", one.code, one.subject.label()));
    subjects.collect()
}

/// Keys and values, without empty tables.
fn settings(config: &str) -> toml::Table {
    let mut settings: toml::Table = config.parse().expect("TOML");
    settings.retain(|_, value| value.as_table().is_none_or(|table| !table.is_empty()));
    settings
}

#[test]
fn the_config_of_init_gives_the_same_report_as_no_config() {
    for (log, without) in &*REPORTS {
        let [short, complete] = [false, true].map(|all| template(without, all));
        assert_eq!(settings(&short), settings(&complete), "{}", log.display());
        let with = audit_with_config(log, &short);
        for key in ["verdict", "error", "robots", "checks", "findings", "observability"] {
            let value_of = |report: &Report| -> Value {
                serde_json::to_value(report).expect("a report is JSON")[key].clone()
            };
            let (mut without, mut with) = (value_of(without), value_of(&with));
            // The config is then the source of the robot.
            for robots in [&mut without, &mut with] {
                let rows = robots.as_array_mut().into_iter().flatten();
                rows.for_each(|row| drop(row.as_object_mut().map(|row| row.remove("source"))));
            }
            assert_eq!(with, without, "{key} of {}", log.display());
        }
    }
    assert!(REPORTS.len() > 15, "{}", REPORTS.len());
}

#[test]
fn every_report_is_valid_and_can_be_read_back() {
    let (mut schemas, mut compiler) = (Schemas::new(), Compiler::new());
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/poseaudit.report.schema.json");
    let schema = compiler.compile(path, &mut schemas).expect("a schema");
    for (log, report) in &*REPORTS {
        let value = serde_json::to_value(report).expect("a report is JSON");
        let valid = schemas.validate(&value, schema);
        valid.unwrap_or_else(|error| panic!("{}: {error:#}", log.display()));
        let text = serde_json::to_string(&value).expect("JSON");
        let read: Report = serde_json::from_str(&text).expect("a report");
        assert_eq!(serde_json::to_string(&read).expect("JSON"), text, "{}", log.display());
        let estimates = |of: &Report| -> Vec<_> {
            of.checks.iter().map(|row| row.estimate.as_ref().map(discriminant)).collect()
        };
        assert_eq!(estimates(&read), estimates(report), "{}", log.display());
        let mut wrong = value;
        wrong["checks"][0]["status"] = "fine".into();
        assert!(schemas.validate(&wrong, schema).is_err(), "the schema must look at checks");
    }
}

#[test]
fn thresholds_and_severities_come_from_the_config() {
    let late = |config: &str| {
        let report = audit_faulty_log(config);
        let late = report.findings.iter().find(|one| one.code == "LAT001");
        late.map(|one| one.severity)
    };
    assert_eq!(late(""), Some(Severity::Error));
    let table = |keys: &str| late(&format!("[rules.LAT001]\n{keys}"));
    assert_eq!(table("error = \"16 ms\""), Some(Severity::Warning));
    assert_eq!(table("warning = \"16 ms\"\nerror = \"17 ms\""), None);
    assert_eq!(table("severity = \"info\""), Some(Severity::Info));
}

#[test]
fn ignored_findings_are_listed_and_do_not_count() {
    let report = audit_faulty_log(
        "[[ignore]]\ncode = \"LAT001\"\ntopic = \"/tcp_pose_broadcaster/pose\"\nreason = \"known\"\n\
         [[ignore]]\ncode = \"ZER\"\nreason = \"re-homed\"\n\
         [[ignore]]\ncode = \"YAW\"\ntopic = \"/no_such_imu\"\nreason = \"gone\"\n",
    );
    assert_eq!((report.verdict, found_subjects(&report)), (Verdict::Pass, Vec::new()));
    let ignored: Vec<(&str, &str)> =
        report.ignored.iter().map(|one| (one.finding.code, one.place.as_str())).collect();
    assert_eq!(ignored, [("LAT001", "p.toml:1"), ("ZER001", "p.toml:5")]);
    let row = report
        .checks
        .iter()
        .find(|row| row.code == "ZER001" && row.subject.joint.as_deref() == Some("elbow_joint"));
    let row = row.expect("the check is listed");
    assert_eq!(row.status, Status::Skipped);
    assert_eq!(row.reason.as_deref(), Some("ignored: re-homed (p.toml:5)"));
    let notes: Vec<&str> = report.log.notes.iter().map(|note| note.note.as_str()).collect();
    assert!(notes.contains(&"settings are from this file"), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("YAW on /no_such_imu")), "{notes:?}");
    let json = serde_json::to_value(&report).expect("a report is JSON");
    assert_eq!(json["ignored"][0]["reason"], "known");
    assert_eq!(json["ignored"][0]["code"], "LAT001");
}

#[test]
fn declared_rates_and_topics_are_checked() {
    let report = audit_faulty_log(
        "[stream.\"/imu/data\"]\nrate_hz = 400\n[stream.\"/tf\"]\nrate_hz = 20\n\
         [stream.\"/gone\"]\nrole = \"pose\"\n[stream.\"/unwanted\"]\nrole = \"ignored\"\n",
    );
    let slow = found_subjects(&report).into_iter().filter(|found| found.starts_with("TIM006"));
    assert_eq!(slow.collect::<Vec<_>>(), ["TIM006 /gone", "TIM006 /imu/data"]);
}

#[test]
fn roles_sources_and_frames_come_from_the_config() {
    let pose = "/tcp_pose_broadcaster/pose";
    let with = |keys: &str| {
        audit_with_config(&fixture("clean.mcap"), &format!("[stream.\"{pose}\"]\n{keys}"))
    };
    let row = |report: &Report| {
        let row = report.streams.iter().find(|stream| stream.topic == pose).cloned();
        row.expect("the stream is listed")
    };
    let external = with("witness = \"external\"");
    assert_eq!(row(&external).source_kind, Some("external"));
    let ignored = with("role = \"ignored\"");
    assert_eq!(row(&ignored).role, "ignored");
    assert!(!ignored.checks.iter().any(|check| check.subject.topic.as_deref() == Some(pose)));
    let in_base_link = with("frame = \"base_link\"");
    assert_eq!(found_subjects(&in_base_link), [format!("FRM002 {pose}")]);
    let of_flange = with("link = \"flange\"");
    assert_eq!(found_subjects(&of_flange), [format!("FRM003 {pose}")]);
    assert_eq!(of_flange.findings[0].severity, Severity::Error);
}

#[test]
fn the_encoding_of_a_vendor_is_compared_with_the_log() {
    let log = fixture("gimbal.mcap");
    let encoding_codes = |vendor: &str, units: &str| {
        let keys = format!("vendor = \"{vendor}\"\n{units}");
        let report = audit_with_config(&log, &format!("[stream.\"/tool_pose\"]\n{keys}"));
        let codes = report.findings.iter().map(|one| one.code);
        codes.filter(|code| code.starts_with("ORD") && *code != "ORD006").collect::<BTreeSet<_>>()
    };
    // Its numbers are roll, pitch and yaw in radians, and metres.
    assert_eq!(encoding_codes("aubo", ""), [].into());
    assert_eq!(encoding_codes("jaka", ""), ["ORD008"].into());
    assert_eq!(encoding_codes("jaka", "units = [\"m\"]"), [].into());
    assert_eq!(encoding_codes("ur", ""), ["ORD001"].into());
    assert_eq!(encoding_codes("fanuc", ""), ["ORD004", "ORD008"].into());
}

#[test]
fn a_stream_setting_that_contradicts_the_log_is_refused_with_its_line() {
    let refused = |text: &str| {
        let config = Config::from_text(text.to_owned(), Path::new("p.toml")).expect("a config");
        let options = Options { logs: vec![fixture("clean.mcap")], ..config.options() };
        poseaudit::audit(&options).expect_err("the call is wrong").to_string()
    };
    for (keys, part) in [
        ("role = \"imu\"", "cannot have the role `imu`"),
        ("frame = \"base_lnk\"", "did you mean 'base_link'?"),
        ("link = \"no_such_thing\"", "not a link of an arm"),
        ("convention = \"rotvec\"", "contains quaternions"),
    ] {
        let message = refused(&format!("\n[stream.\"/tcp_pose_broadcaster/pose\"]\n{keys}"));
        assert!(message.starts_with("p.toml:2: ") && message.contains(part), "{message}");
    }
    let message = refused("[stream.\"/imu/data\"]\nlink = \"tool0\"");
    assert!(message.contains("have no `link`"), "{message}");
}

/// The log at `path` with its pose topic renamed to `name`.
fn rename_pose_topic(path: &Path, name: &str) -> Vec<u8> {
    let bytes = fs::read(path).expect("the fixture");
    let mut writer = mcap::Writer::new(Cursor::new(Vec::new())).expect("a writer");
    let mut channels = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).expect("messages") {
        let message = message.expect("a sound message");
        let logged = &message.channel;
        let topic = if logged.topic == POSE { name } else { logged.topic.as_str() };
        let schema = logged.schema.as_ref().expect("a schema");
        let channel_id = *channels.entry(logged.id).or_insert_with(|| {
            let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data);
            let schema = schema.expect("a schema");
            let channel =
                writer.add_channel(schema, topic, &logged.message_encoding, &logged.metadata);
            channel.expect("a channel")
        });
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data).expect("memory");
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

#[test]
fn hostile_topic_names_are_escaped_and_read_back() {
    let name = "/it's|a\\ \"<b>'''topic\u{202e} # H1";
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("run.mcap");
    fs::write(&log, rename_pose_topic(&fixture("faulty.mcap"), name)).expect("a file");
    let fix = folder.path().join("fix");
    let options = Options { logs: vec![log.clone()], ..Options::default() };
    let first = poseaudit::audit(&options).expect("a report");
    first.write_fixes(&fix).expect("a folder to write to");
    let without = first.report;
    assert!(without.streams.iter().any(|stream| stream.topic == name));
    assert_eq!(
        found_subjects(&audit_with_config(&log, &template(&without, true))),
        found_subjects(&without)
    );
    assert!(!template(&without, true).contains(['\u{202e}', '\u{1b}']));

    let index = fs::read_to_string(fix.join("corrections.md")).expect("the index");
    let row = index.lines().find(|line| line.starts_with("| LAT001 on ")).expect("a row");
    assert!(row.contains("/it's&#124;a") && row.contains("&lt;b&gt;"), "{row}");
    assert_eq!(row.matches('|').count(), 4, "{row}");
    for file in fs::read_dir(&fix).expect("a folder") {
        let path = file.expect("an entry").path();
        let text = fs::read_to_string(&path).expect("a text");
        let is_for_people = path.extension().is_some_and(|kind| kind == "md" || kind == "yaml");
        let is_plain = !text.contains('\u{1b}') && !text.contains('\u{202e}');
        assert!(is_plain || !is_for_people, "{}", path.display());
    }
    let corrections = Some(fix.join("corrections.toml"));
    let corrected = poseaudit::audit(&Options { corrections, ..options });
    let corrected = corrected.expect("a report").report;
    assert!(corrected.findings.len() < without.findings.len());
}
