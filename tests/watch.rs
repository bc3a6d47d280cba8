//! Logs that are audited while they are written.

use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use serde_json::Value;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr};

/// A fixture with small chunks, like those of a recorder that writes immediately.
fn small_chunk_log(fixture: &str) -> Vec<u8> {
    let whole = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(fixture)).expect("the fixture");
    let mut written = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().chunk_size(Some(1 << 14));
    let mut writer = options.create(&mut written).expect("a writer");
    for message in mcap::MessageStream::new(&whole).expect("a log") {
        writer.write(&message.expect("a message")).expect("room");
    }
    writer.finish().expect("room");
    drop(writer);
    written.into_inner()
}

/// Starts `watch`.
fn watch(path: &Path, options: &[&str]) -> Child {
    watch_command(path, options).spawn().expect("the binary runs")
}

fn watch_command(path: &Path, options: &[&str]) -> Command {
    let mut call = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    call.arg("watch").arg(path).args(["--every", "0.05", "--format", "json"]).args(options);
    call.stdout(Stdio::piped());
    call
}

/// Its exit status, and its printed lines.
fn wait_for_end(mut child: Child) -> (i32, Vec<Value>) {
    let mut text = String::new();
    child.stdout.take().expect("a pipe").read_to_string(&mut text).expect("UTF-8");
    let status = child.wait().expect("it ends").code().expect("by itself");
    (status, text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect())
}

/// Writes the bytes in `pieces`, with short delays.
fn append_in_pieces(path: &Path, bytes: &[u8], pieces: usize) {
    let mut file = OpenOptions::new().append(true).open(path).expect("a file");
    for piece in bytes.chunks(bytes.len().div_ceil(pieces)) {
        file.write_all(piece).expect("room");
        thread::sleep(Duration::from_millis(300));
    }
}

fn empty_log(folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("run.mcap");
    fs::write(&path, b"").expect("a file");
    path
}

fn verdicts(lines: &[Value]) -> Vec<&str> {
    lines.iter().filter_map(|line| line["verdict"].as_str()).collect()
}

#[test]
fn a_growing_log_is_audited_repeatedly_and_once_more_at_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = empty_log(&folder);
    let recordings = ["seen.rrd", "whole.rrd"].map(|name| folder.path().join(name));
    let [seen, whole] = recordings.each_ref().map(|path| path.to_str().expect("UTF-8"));
    let child = watch(&path, &["--rrd", seen]);
    append_in_pieces(&path, &small_chunk_log(FAULTY), 6);
    let (status, lines) = wait_for_end(child);
    // The viewer finally gets the recording of the complete log.
    poseaudit(&["audit", path.to_str().expect("UTF-8"), "--rrd", whole]);
    assert!(fs::read(seen).expect("a recording") == fs::read(whole).expect("a recording"));
    assert_eq!(status, 1);
    assert!(lines.len() >= 2, "{lines:?}");
    let last = lines.last().expect("a line");
    assert_eq!((&last["event"], &last["verdict"]), (&"ended".into(), &"fail".into()));
    assert!(lines[..lines.len() - 1].iter().any(|line| line["verdict"] == "fail"), "{lines:?}");
    // Each byte is read once while the log is written, except the index at its end, and then all bytes
    // again.
    let (size, read) = (small_chunk_log(FAULTY).len() as u64, last["read_bytes"].as_u64());
    assert_eq!(last["read_again_bytes"].as_u64(), Some(size));
    assert!(read.is_some_and(|read| read <= size && read > size / 2), "{read:?} of {size}");
    let new_findings: Vec<&Value> =
        lines.iter().flat_map(|line| line["new"].as_array()).flatten().collect();
    let is_new = |code: &str| {
        new_findings
            .iter()
            .any(|new| new["finding"].as_str().is_some_and(|it| it.starts_with(code)))
    };
    assert!(is_new("LAT001") && is_new("ZER001"), "{new_findings:?}");
}

/// Runs `watch` with this script as the viewer, on a log that is written in six pieces.
#[cfg(unix)]
fn watch_with_viewer(folder: &tempfile::TempDir, script: &str) -> (i32, Vec<Value>, String) {
    use std::os::unix::fs::PermissionsExt;
    let viewer = folder.path().join("rerun");
    fs::write(&viewer, format!("#!/bin/sh\n{script}\n")).expect("a script");
    fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).expect("a program");
    let path = empty_log(folder);
    let mut call = watch_command(&path, &["--rrd-connect", "9911"]);
    let mut child =
        call.env("PATH", folder.path()).stderr(Stdio::piped()).spawn().expect("the binary runs");
    let mut stderr = child.stderr.take().expect("a pipe");
    append_in_pieces(&path, &small_chunk_log(FAULTY), 6);
    let (status, lines) = wait_for_end(child);
    let mut stderr_text = String::new();
    stderr.read_to_string(&mut stderr_text).expect("UTF-8");
    let (waiting, messages) = stderr_text.split_once('\n').expect("a line");
    assert!(waiting.starts_with("waiting for data in "), "{stderr_text}");
    (status, lines, messages.to_owned())
}

#[cfg(unix)]
#[test]
fn a_viewer_receives_each_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    // The file is renamed when it is complete.
    let seen = folder.path().join("seen");
    let script = format!(
        "/bin/cat > {0}.part; echo \"$*\" > {0}.call; /bin/mv {0}.part {0}",
        seen.display()
    );
    let (status, lines, stderr_text) = watch_with_viewer(&folder, &script);
    assert_eq!((status, stderr_text.as_str()), (1, ""));
    let polls = (0..500).map(|_| thread::sleep(Duration::from_millis(20)));
    let received = polls.map(|()| fs::read(&seen)).find_map(Result::ok).expect("recordings");
    let call = fs::read_to_string(seen.with_extension("call")).expect("a call");
    assert_eq!(call.trim_end(), "--port 9911 -");
    // One after the other; the last is that of the complete log.
    let last = folder.path().join("last.rrd").display().to_string();
    let path = folder.path().join("run.mcap").display().to_string();
    poseaudit(&["audit", &path, "--rrd", &last]);
    assert!(received.ends_with(&fs::read(last).expect("a recording")));
    let recordings = received.windows(8).filter(|end| end == b"RRF2FOOT").count();
    assert!(recordings >= 2 && recordings <= lines.len(), "{recordings} recordings, {lines:?}");
}

#[cfg(unix)]
#[test]
fn a_closed_viewer_is_reported_once_and_does_not_end_the_watch() {
    let folder = tempfile::tempdir().expect("a folder");
    let (status, lines, stderr_text) = watch_with_viewer(&folder, "exit 0");
    assert_eq!(status, 1, "{lines:?}");
    assert_eq!(lines.last().map(|line| &line["event"]), Some(&"ended".into()));
    assert!(
        stderr_text.contains("viewer at port 9911: does not accept recordings"),
        "{stderr_text}"
    );
    assert_eq!(stderr_text.lines().count(), 1, "{stderr_text}");
}

#[test]
fn a_restarted_log_is_audited_from_its_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = empty_log(&folder);
    let child = watch(&path, &[]);
    let faulty = small_chunk_log(FAULTY);
    append_in_pieces(&path, &faulty[..faulty.len() / 2], 3);
    fs::write(&path, b"").expect("a file");
    append_in_pieces(&path, &small_chunk_log(CLEAN), 5);
    let (status, lines) = wait_for_end(child);
    assert_eq!(status, 0, "{lines:?}");
    let again = lines.iter().position(|line| line["event"] == "begun-again").expect("a line");
    assert!(verdicts(&lines[..again]).contains(&"fail"), "{lines:?}");
    assert!(!verdicts(&lines[again..]).contains(&"fail"), "{lines:?}");
    assert_eq!(lines.last().map(|line| &line["verdict"]), Some(&"pass".into()));
}

#[test]
fn a_log_without_a_footer_is_not_reported_as_damaged_while_watched() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = empty_log(&folder);
    let child = watch(&path, &[]);
    // Its data are complete, but it has no footer and is not known to be growing.
    let clean = small_chunk_log(CLEAN);
    let (most, end) = clean.split_at(clean.len() - mcap::MAGIC.len());
    append_in_pieces(&path, most, 2);
    thread::sleep(Duration::from_secs(1));
    append_in_pieces(&path, end, 1);
    let (status, lines) = wait_for_end(child);
    assert_eq!(status, 0, "{lines:?}");
    assert!(lines.iter().all(|line| line["new"] == Value::Array(Vec::new())), "{lines:?}");
    let again = lines.last().and_then(|line| line["read_again_bytes"].as_u64());
    assert!(again.is_some_and(|again| again > clean.len() as u64), "{lines:?}");
}

#[test]
fn until_fail_ends_before_the_end_of_the_log() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = empty_log(&folder);
    let faulty = small_chunk_log(FAULTY);
    append_in_pieces(&path, &faulty[..faulty.len() * 3 / 4], 1);
    // For a folder, watches the newest log that is being written.
    let (status, lines) = wait_for_end(watch(folder.path(), &["--until", "fail"]));
    assert_eq!(status, 1);
    assert_eq!(verdicts(&lines).last(), Some(&"fail"));
    assert!(lines.iter().all(|line| line["event"] != "ended"), "{lines:?}");
}

#[test]
fn an_idle_log_without_a_footer_ends_the_watch() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = empty_log(&folder);
    let clean = small_chunk_log(CLEAN);
    append_in_pieces(&path, &clean[..clean.len() / 2], 1);
    let (_, lines) = wait_for_end(watch(&path, &["--idle", "1"]));
    let last = lines.last().expect("a line");
    assert_eq!(last["event"], "ended");
    // Findings of the complete audit about the end of the file.
    let findings = last["new"].as_array().expect("findings");
    assert!(
        findings
            .iter()
            .any(|new| new["finding"].as_str().is_some_and(|it| it.starts_with("ING001"))),
        "{last}"
    );
}

#[test]
fn until_fail_ends_with_a_failing_log_when_another_log_replaces_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let clean = small_chunk_log(CLEAN);
    append_in_pieces(&empty_log(&folder), &clean[..clean.len() / 2], 1);
    let child = watch(folder.path(), &["--until", "fail"]);
    thread::sleep(Duration::from_secs(1));
    // The recorder was killed, so the first log has no footer; recording continues with another name.
    fs::write(folder.path().join("second.mcap"), small_chunk_log(FAULTY)).expect("a file");
    let (status, lines) = wait_for_end(child);
    assert_eq!(status, 1);
    let last = lines.last().expect("a line");
    assert_eq!((&last["event"], &last["verdict"]), (&"ended".into(), &"fail".into()), "{lines:?}");
    assert!(last["log"].as_str().is_some_and(|log| log.ends_with("run.mcap")), "{lines:?}");
}

#[test]
fn a_watch_says_what_it_waits_for_and_what_ends_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut call = watch_command(folder.path(), &[]);
    let mut child = call.stderr(Stdio::piped()).spawn().expect("the binary runs");
    let mut line = String::new();
    let stderr = child.stderr.take().expect("a pipe");
    BufReader::new(stderr).read_line(&mut line).expect("UTF-8");
    child.kill().expect("it runs");
    child.wait().expect("it ends");
    let path = folder.path().display();
    assert_eq!(line, format!("waiting for a log in {path}; ends with Ctrl-C\n"));
}

#[test]
fn a_missing_path_is_refused_in_one_line() {
    let output = poseaudit(&["watch", "no/such.mcap"]);
    assert_eq!(status(&output), 2);
    assert!(
        stderr(&output).contains("no/such.mcap: no such file or folder"),
        "{}",
        stderr(&output)
    );
}
