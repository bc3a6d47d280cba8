//! Logs by URL from a local server: requests, reports, and interrupted connections.

mod server;

use std::collections::HashMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::LazyLock;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use mcap::records::MessageHeader;
use mcap::{Compression, MessageStream, WriteOptions};
use serde_json::Value;

use server::{BUCKET, Behaviour, KEY_ID, Server};

/// Rules of the audit: enough to detect differences, and fast.
const RULES: &str = "ING,TIM,LAT";

const IMAGE: usize = 300_000;

/// A log of an arm and of a camera whose images are 95 % of its bytes.
fn log_with_images(compression: Option<Compression>) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/faulty.mcap");
    let arm = fs::read(path).expect("the fixture");
    let options = WriteOptions::new().compression(compression);
    let mut writer = options.create(Cursor::new(Vec::new())).expect("a writer");
    let schema = writer.add_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data");
    let camera =
        writer.add_channel(schema.expect("a schema"), "/camera", "cdr", &Default::default());
    let camera = camera.expect("a channel");
    let (mut image_bytes_due, mut images) = (0, 0_u32);
    let mut channels: HashMap<u16, u16> = HashMap::new();
    for message in MessageStream::new(&arm).expect("messages") {
        let message = message.expect("a sound message");
        let channel_id = *channels.entry(message.channel.id).or_insert_with(|| {
            let logged = &message.channel;
            let schema = logged.schema.as_ref().expect("a schema");
            let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data);
            let (schema, encoding) = (schema.expect("a schema"), &logged.message_encoding);
            let channel = writer.add_channel(schema, &logged.topic, encoding, &logged.metadata);
            channel.expect("a channel")
        });
        let header = MessageHeader {
            channel_id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data).expect("memory");
        image_bytes_due += 19 * message.data.len();
        while image_bytes_due >= IMAGE {
            image_bytes_due -= IMAGE;
            images += 1;
            let (log_time, publish_time) = (message.log_time, message.publish_time);
            let header =
                MessageHeader { channel_id: camera, sequence: images, log_time, publish_time };
            // Noise, which compresses no better than an image.
            let noise = |index: usize| (index as u32).wrapping_mul(0x9e37_79b9 ^ images) >> 13;
            let image: Vec<u8> = (0..IMAGE).map(|index| noise(index) as u8).collect();
            writer.write_to_known_channel(&header, &image).expect("memory");
        }
    }
    writer.finish().expect("memory");
    writer.into_inner().into_inner()
}

static UNCOMPRESSED_LOG: LazyLock<Vec<u8>> = LazyLock::new(|| log_with_images(None));

/// Runs the program with the server as its S3, with the key `key_id`.
fn poseaudit(server: &Server, key_id: &str, args: &[&str]) -> Output {
    let mut command = command(server, args);
    command.env("AWS_ACCESS_KEY_ID", key_id).env("AWS_SECRET_ACCESS_KEY", "secret");
    command.output().expect("the binary runs")
}

/// The program, without credentials.
fn command(server: &Server, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        if ["AWS_", "GOOGLE_", "AZURE_", "POSEAUDIT_", "HOME"]
            .iter()
            .any(|prefix| name.starts_with(prefix))
        {
            command.env_remove(name);
        }
    }
    command
        .args(args)
        .env("AWS_ENDPOINT_URL", server.endpoint())
        .env("AWS_ALLOW_HTTP", "true")
        .env("AWS_REGION", "us-east-1")
        .env("NO_PROXY", "127.0.0.1");
    command
}

fn audit(server: &Server, url: &str, more: &[&str]) -> (Value, Output) {
    let args = [&["audit", url, "--format", "json", "--select", RULES], more].concat();
    let output = poseaudit(server, KEY_ID, &args);
    let report = serde_json::from_slice(&output.stdout);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    (report.unwrap_or_else(|error| panic!("{error}: {stderr}")), output)
}

fn s3(key: &str) -> String {
    format!("s3://{BUCKET}/{key}")
}

/// The report on a local copy of `bytes`.
fn report_on_local_copy(server: &Server, bytes: &[u8], more: &[&str]) -> Value {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.mcap");
    fs::write(&path, bytes).expect("a file");
    audit(server, &path.display().to_string(), more).0
}

/// The report without the parts that may differ: the log's name, and the number of fetched bytes.
fn without_log_name(mut report: Value, name: &str) -> Value {
    let file = report["log"]["files"][0].as_object_mut().expect("a file");
    file.remove("fetched_bytes");
    file.remove("path");
    let text = report.to_string().replace(name, "LOG");
    serde_json::from_str(&text).expect("JSON")
}

fn fetched_bytes(report: &Value) -> usize {
    report["log"]["files"][0]["fetched_bytes"].as_u64().expect("fetched_bytes") as usize
}

#[test]
fn of_images_in_uncompressed_chunks_almost_nothing_is_fetched() {
    let server = Server::start(&[("cell 7/run.mcap", &UNCOMPRESSED_LOG)], Behaviour::default());
    let url = s3("cell 7/run.mcap");
    let (report, output) = audit(&server, &url, &[]);
    assert_eq!(output.status.code(), Some(1), "{report}");
    let local = report_on_local_copy(&server, &UNCOMPRESSED_LOG, &[]);
    assert_eq!(local["log"]["files"][0].get("fetched_bytes"), None);
    let bytes = fetched_bytes(&report);
    assert!(bytes * 10 <= UNCOMPRESSED_LOG.len(), "{bytes} of {}", UNCOMPRESSED_LOG.len());
    assert_eq!(server.counts().bytes.load(Ordering::Relaxed), bytes);
    let path = local["log"]["files"][0]["path"].as_str().expect("a path").to_owned();
    assert_eq!(without_log_name(report, &url), without_log_name(local, &path));

    let text = poseaudit(&server, KEY_ID, &["audit", &url, "--select", "ING"]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains(&format!("{url}  ")) && text.contains(" MB fetched ("), "{text}");
    let info = poseaudit(&server, KEY_ID, &["info", &url]);
    let info = String::from_utf8_lossy(&info.stdout).into_owned();
    assert!(info.contains(" MB fetched (") && info.contains("/camera"), "{info}");
}

#[test]
fn with_verify_all_bytes_are_fetched() {
    let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], Behaviour::default());
    let url = s3("run.mcap");
    let (report, _) = audit(&server, &url, &["--verify"]);
    assert_eq!(fetched_bytes(&report), UNCOMPRESSED_LOG.len());
    let local = report_on_local_copy(&server, &UNCOMPRESSED_LOG, &["--verify"]);
    let path = local["log"]["files"][0]["path"].as_str().expect("a path").to_owned();
    assert_eq!(without_log_name(report, &url), without_log_name(local, &path));
}

#[test]
fn compressed_damaged_and_unindexed_logs_give_the_report_of_a_local_copy() {
    let packed = log_with_images(Some(Compression::Zstd));
    let cut = &UNCOMPRESSED_LOG[..UNCOMPRESSED_LOG.len() / 2];
    let mut damaged = UNCOMPRESSED_LOG.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 400_000].fill(0);
    let archive = zstd::bulk::compress(&packed, 1).expect("memory");
    for (name, bytes) in
        [("packed", &packed[..]), ("cut", cut), ("damaged", &damaged), ("archive", &archive)]
    {
        let server = Server::start(&[(name, bytes)], Behaviour::default());
        let (report, _) = audit(&server, &s3(name), &[]);
        let local = report_on_local_copy(&server, bytes, &[]);
        let path = local["log"]["files"][0]["path"].as_str().expect("a path").to_owned();
        let (remote, local) = (without_log_name(report, &s3(name)), without_log_name(local, &path));
        assert_eq!(remote, local, "{name}");
    }
}

#[test]
fn a_web_server_works_with_and_without_range_requests() {
    for ignores_ranges in [false, true] {
        let behaviour = Behaviour { is_public: true, ignores_ranges, ..Behaviour::default() };
        let server = Server::start(&[("cell 7/run.mcap", &UNCOMPRESSED_LOG)], behaviour);
        let plain = format!("{}/{BUCKET}/cell%207/run.mcap", server.endpoint());
        let (report, _) = audit(&server, &format!("{plain}?signature=s3cret"), &[]);
        let bytes = fetched_bytes(&report);
        assert!(
            if ignores_ranges {
                bytes == UNCOMPRESSED_LOG.len()
            } else {
                bytes * 10 <= UNCOMPRESSED_LOG.len()
            },
            "{bytes}"
        );
        // A signature must not be printed.
        assert_eq!(report["log"]["files"][0]["path"], plain);
        assert!(!report.to_string().contains("s3cret"));
    }
}

#[test]
fn a_user_and_a_password_are_used_and_never_printed() {
    let login = Some("Basic bWU6c2VjIHJldA==");
    let behaviour = Behaviour { is_public: true, login, ..Behaviour::default() };
    let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], behaviour);
    let host = server.endpoint().replace("http://", "");
    let address = format!("HTTP://me:sec%20ret@{host}/{BUCKET}/run.mcap?token=sec%20ret");
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out").display().to_string();
    let misspelt = format!("htp://me:sec%20ret@{host}/run.mcap?token=sec%20ret");
    let wrong = format!("http://you:sec%20ret@{host}/{BUCKET}/run.mcap");
    let s3 = "s3://me:sec%20ret@bucket/run.mcap";
    let report = folder.path().join("report").display().to_string();
    let fleet = ["fleet", &address, "--select", "ING", "--out", &out];
    let plain = format!("http://{host}/{BUCKET}/run.mcap");
    for (args, status, part) in [
        (&["audit", &address, "--select", "ING"][..], 0, plain.as_str()),
        (&["audit", &address, "--select", "ING", "--format", "sarif", "--output", &report], 0, ""),
        (&["info", &address], 0, &plain),
        (&[&fleet[..], &["--pending"]].concat(), 0, &plain),
        (&fleet, 0, "1 pass"),
        (&["fleet", &wrong, "--out", &out], 3, "401 Unauthorized"),
        (&["audit", &wrong], 3, "401 Unauthorized"),
        (&["audit", &misspelt], 2, "unsupported URL scheme htp://"),
        (&["audit", &misspelt.replace("://", ":/")], 2, "no such file"),
        (&["fleet", &misspelt, "--out", &out], 2, "contains no log"),
        (&["audit", s3], 2, "credentials must come from the environment"),
        (&["compare", &misspelt, &wrong], 2, "htp://"),
        (&["tf", &wrong, "a", "b"], 3, "401 Unauthorized"),
        (&["init", &misspelt], 2, "htp://"),
    ] {
        let output = poseaudit(&server, KEY_ID, args);
        let printed = [output.stdout, output.stderr].concat();
        let printed = String::from_utf8_lossy(&printed).into_owned();
        assert_eq!(output.status.code(), Some(status), "{args:?}: {printed}");
        assert!(printed.contains(part) && !printed.contains("sec"), "{args:?}: {printed}");
    }
    let mut files = vec![folder.path().to_owned()];
    while let Some(path) = files.pop() {
        if path.is_dir() {
            files.extend(fs::read_dir(&path).expect("a folder").map(|it| it.expect("it").path()));
            continue;
        }
        let bytes = fs::read(&path).expect("a file");
        let holds = |text: &str| bytes.windows(text.len()).any(|part| part == text.as_bytes());
        assert!(!holds("sec%20ret") && !holds("sec ret"), "{}", path.display());
    }
}

#[test]
fn the_metadata_service_is_asked_for_credentials_only_by_a_setting() {
    let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], Behaviour::default());
    let refusal = |url: &str, setting: &str| {
        let mut command = command(&server, &["audit", url]);
        command.env("AWS_METADATA_ENDPOINT", server.endpoint());
        let output = command.env("POSEAUDIT_METADATA_SERVICE", setting).output().expect("it runs");
        assert_eq!(output.status.code(), Some(3), "{url}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    for (url, variable) in [
        (s3("run.mcap"), "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"),
        ("gs://bucket/run.mcap".to_owned(), "GOOGLE_SERVICE_ACCOUNT"),
        ("az://box/run.mcap".to_owned(), "AZURE_STORAGE_ACCOUNT_KEY"),
    ] {
        let line = refusal(&url, "false");
        let expected = format!("error: {url}: no credentials for ");
        assert!(line.starts_with(&expected) && line.contains(variable), "{line}");
        assert!(line.contains("POSEAUDIT_METADATA_SERVICE=true"), "{line}");
    }
    assert_eq!(server.counts().requests.load(Ordering::Relaxed), 0);
    refusal(&s3("run.mcap"), "true");
    assert!(server.counts().requests.load(Ordering::Relaxed) > 0);
}

#[test]
fn a_stalled_server_ends_the_call() {
    let servers = [
        Behaviour { byte_interval_ms: 300, is_public: true, ..Behaviour::default() },
        Behaviour {
            byte_interval_ms: 300,
            ignores_ranges: true,
            is_public: true,
            ..Behaviour::default()
        },
        Behaviour { is_silent: true, is_public: true, ..Behaviour::default() },
    ];
    for behaviour in servers {
        let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], behaviour);
        let url = format!("{}/{BUCKET}/run.mcap", server.endpoint());
        let mut command = command(&server, &["audit", &url]);
        command.env("POSEAUDIT_PATIENCE", "3").env("POSEAUDIT_LEAST_RATE", "100");
        let begin = Instant::now();
        let output = command.output().expect("the binary runs");
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{behaviour:?}: {line}");
        let expected = " bytes in 3 s, below the minimum of 100 per second; try again, or lower ";
        assert!(line.contains(expected) && line.lines().count() == 1, "{behaviour:?}: {line}");
        assert!(begin.elapsed() < Duration::from_secs(20), "{behaviour:?}");
    }
    let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], Behaviour::default());
    let mut command = command(&server, &["audit", "https://host/run.mcap"]);
    let output = command.env("POSEAUDIT_LEAST_RATE", "1 kB").output().expect("the binary runs");
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{line}");
    assert!(line.contains("POSEAUDIT_LEAST_RATE is `1 kB`, not a whole number"), "{line}");
}

#[test]
fn interrupted_connections_are_resumed() {
    for behaviour in [
        Behaviour { truncate_every: 3, ..Behaviour::default() },
        Behaviour { busy_requests: 2, ..Behaviour::default() },
        Behaviour {
            truncate_every: 2,
            intact_after: Some(2),
            ignores_ranges: true,
            is_public: true,
            ..Behaviour::default()
        },
    ] {
        let server = Server::start(&[("run.mcap", &UNCOMPRESSED_LOG)], behaviour);
        let url = match behaviour.is_public {
            true => format!("{}/{BUCKET}/run.mcap", server.endpoint()),
            false => s3("run.mcap"),
        };
        let (report, output) = audit(&server, &url, &[]);
        assert_eq!(output.status.code(), Some(1), "{behaviour:?}: {report}");
        let local = report_on_local_copy(&server, &UNCOMPRESSED_LOG, &[]);
        assert_eq!(report["findings"], local["findings"], "{behaviour:?}");
    }
}

/// Asserts that the call exits with `expected` and prints one line with the URL and `parts`.
#[track_caller]
fn assert_refused(server: &Server, key_id: &str, url: &str, expected: i32, parts: &[&str]) {
    let output = poseaudit(server, key_id, &["audit", url]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let line = stderr.trim_end();
    assert_eq!(output.status.code(), Some(expected), "{line}");
    assert!(line.starts_with(&format!("error: {url}: ")) && !line.contains('\n'), "{line}");
    for part in parts {
        assert!(line.contains(part), "{line}");
    }
    assert!(output.stdout.is_empty());
}

#[test]
fn an_object_that_cannot_be_fetched_gives_one_line() {
    let objects: &[(&str, &[u8])] =
        &[("run.mcap", &UNCOMPRESSED_LOG), ("empty.mcap", b""), ("notes.txt", b"no log")];
    let server = Server::start(objects, Behaviour::default());
    let refused = |key: &str, url: &str, expected, parts: &[&str]| {
        assert_refused(&server, key, url, expected, parts);
    };
    refused(KEY_ID, &s3("none.mcap"), 2, &["no such object", "check the spelling of the key"]);
    refused(KEY_ID, "s3://other/run.mcap", 2, &["no such bucket"]);
    refused(KEY_ID, "s3://", 2, &["no bucket or host after s3://"]);
    refused(KEY_ID, "ftp://host/run.mcap", 2, &["unsupported URL scheme ftp://"]);
    refused(KEY_ID, &s3("empty.mcap"), 3, &["the file is empty"]);
    refused(KEY_ID, &s3("notes.txt"), 3, &["not a robot log: it looks like text"]);
    let denied = ["S3 refuses: 403 Forbidden, InvalidAccessKeyId", "check AWS_ACCESS_KEY_ID"];
    refused("AKIDOTHER", &s3("run.mcap"), 3, &denied);
    let twice = poseaudit(&server, KEY_ID, &["audit", &s3("run.mcap"), &s3("run.mcap")]);
    assert_eq!(twice.status.code(), Some(2));

    let gone = Server::start(&[], Behaviour::default()).endpoint();
    let url = format!("{gone}/{BUCKET}/run.mcap");
    refused(KEY_ID, &url, 3, &["cannot be reached: Connection refused", "check the network"]);
    let always = Server::start(
        &[("run.mcap", &UNCOMPRESSED_LOG)],
        Behaviour { truncate_every: 1, ..Behaviour::default() },
    );
    assert_refused(&always, KEY_ID, &s3("run.mcap"), 3, &["the connection broke off at byte "]);
    let busy = Server::start(
        &[("run.mcap", &UNCOMPRESSED_LOG)],
        Behaviour { busy_requests: 1000, ..Behaviour::default() },
    );
    assert_refused(&busy, KEY_ID, &s3("run.mcap"), 3, &["the server answered: 503", "SlowDown"]);
    let changes = Server::start(
        &[("run.mcap", &UNCOMPRESSED_LOG)],
        Behaviour { changes_after: 5, ..Behaviour::default() },
    );
    assert_refused(&changes, KEY_ID, &s3("run.mcap"), 3, &["changed while it was read"]);
}

#[test]
fn a_fleet_audits_the_logs_below_a_prefix_and_fetches_each_once() {
    let arm = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/base.mcap"));
    let arm = arm.expect("the fixture");
    let objects: &[(&str, &[u8])] = &[
        ("a/1.mcap", &arm),
        ("a/b/2.mcap", b""),
        ("a/c/3.mcap", b"no log"),
        ("a/notes.txt", b"x"),
    ];
    let server = Server::start(objects, Behaviour::default());
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().display().to_string();
    let fleet = |source: &str| {
        let run = poseaudit(&server, KEY_ID, &["fleet", source, "--out", &out, "--format", "json"]);
        let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
        let summary: Value = serde_json::from_slice(&run.stdout).expect(&stderr);
        ["logs", "done_before", "done_now"].map(|key| summary[key].as_u64().expect(key))
    };
    // An empty object marks a folder.
    assert_eq!(fleet(&s3("a")), [2, 0, 2]);
    let before = server.counts().bytes.load(Ordering::Relaxed);
    assert_eq!(fleet(&s3("a")), [2, 2, 0]);
    assert_eq!(fleet(&s3("a/*.mcap")), [1, 1, 0]);
    assert_eq!(fleet(&s3("a/1.mcap")), [1, 1, 0]);
    assert_eq!(server.counts().bytes.load(Ordering::Relaxed), before);
}
