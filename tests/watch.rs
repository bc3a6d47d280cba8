//! Logs that are audited while they are written.

use std::fs::{self, OpenOptions};
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use serde_json::Value;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr};

/// A fixture with small chunks, like those of a recorder that writes immediately.
fn bytes(fixture: &str) -> Vec<u8> {
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
    call(path, options).spawn().expect("the binary runs")
}

fn call(path: &Path, options: &[&str]) -> Command {
    let mut call = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    call.arg("watch").arg(path).args(["--every", "0.05", "--format", "json"]).args(options);
    call.stdout(Stdio::piped());
    call
}

/// Its exit status, and its printed lines.
fn ended(mut child: Child) -> (i32, Vec<Value>) {
    let mut text = String::new();
    child.stdout.take().expect("a pipe").read_to_string(&mut text).expect("UTF-8");
    let status = child.wait().expect("it ends").code().expect("by itself");
    (status, text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect())
}

/// Writes the bytes in `pieces`, with short delays.
fn write(path: &Path, bytes: &[u8], pieces: usize) {
    let mut file = OpenOptions::new().append(true).open(path).expect("a file");
    for piece in bytes.chunks(bytes.len().div_ceil(pieces)) {
        file.write_all(piece).expect("room");
        thread::sleep(Duration::from_millis(300));
    }
}

fn log(folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("run.mcap");
    fs::write(&path, b"").expect("a file");
    path
}

fn verdicts(lines: &[Value]) -> Vec<&str> {
    lines.iter().filter_map(|line| line["verdict"].as_str()).collect()
}

#[test]
fn a_log_that_is_being_written_is_audited_as_it_grows_and_once_more_at_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = log(&folder);
    let drawn = ["seen.rrd", "whole.rrd"].map(|name| folder.path().join(name));
    let [seen, whole] = drawn.each_ref().map(|path| path.to_str().expect("UTF-8"));
    let child = watch(&path, &["--rrd", seen]);
    write(&path, &bytes(FAULTY), 6);
    let (status, lines) = ended(child);
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
    let (size, read) = (bytes(FAULTY).len() as u64, last["read_bytes"].as_u64());
    assert_eq!(last["read_again_bytes"].as_u64(), Some(size));
    assert!(read.is_some_and(|read| read <= size && read > size / 2), "{read:?} of {size}");
    let told: Vec<&Value> =
        lines.iter().flat_map(|line| line["new"].as_array()).flatten().collect();
    let is_told = |code: &str| {
        told.iter().any(|new| new["finding"].as_str().is_some_and(|it| it.starts_with(code)))
    };
    assert!(is_told("LAT001") && is_told("ZER001"), "{told:?}");
}

/// Runs `watch` with this script as the viewer, on a log that is written in six pieces.
#[cfg(unix)]
fn shown(folder: &tempfile::TempDir, script: &str) -> (i32, Vec<Value>, String) {
    use std::os::unix::fs::PermissionsExt;
    let viewer = folder.path().join("rerun");
    fs::write(&viewer, format!("#!/bin/sh\n{script}\n")).expect("a script");
    fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).expect("a program");
    let path = log(folder);
    let mut call = call(&path, &["--rrd-connect", "9911"]);
    let mut child =
        call.env("PATH", folder.path()).stderr(Stdio::piped()).spawn().expect("the binary runs");
    let mut stderr = child.stderr.take().expect("a pipe");
    write(&path, &bytes(FAULTY), 6);
    let (status, lines) = ended(child);
    let mut said = String::new();
    stderr.read_to_string(&mut said).expect("UTF-8");
    (status, lines, said)
}

#[cfg(unix)]
#[test]
fn a_viewer_is_given_the_recordings_as_they_are_made() {
    let folder = tempfile::tempdir().expect("a folder");
    // The file is renamed when it is complete.
    let seen = folder.path().join("seen");
    let script = format!(
        "/bin/cat > {0}.part; echo \"$*\" > {0}.call; /bin/mv {0}.part {0}",
        seen.display()
    );
    let (status, lines, said) = shown(&folder, &script);
    assert_eq!((status, said.as_str()), (1, ""));
    let patience = (0..500).map(|_| thread::sleep(Duration::from_millis(20)));
    let given = patience.map(|()| fs::read(&seen)).find_map(Result::ok).expect("recordings");
    let call = fs::read_to_string(seen.with_extension("call")).expect("a call");
    assert_eq!(call.trim_end(), "--port 9911 -");
    // One after the other; the last is that of the complete log.
    let last = folder.path().join("last.rrd").display().to_string();
    let path = folder.path().join("run.mcap").display().to_string();
    poseaudit(&["audit", &path, "--rrd", &last]);
    assert!(given.ends_with(&fs::read(last).expect("a recording")));
    let begun = given.windows(4).filter(|four| four == b"RRF2").count();
    assert!(begun >= 2 && begun <= lines.len(), "{begun} recordings, {lines:?}");
}

#[cfg(unix)]
#[test]
fn a_viewer_that_is_closed_is_said_once_and_ends_no_watch() {
    let folder = tempfile::tempdir().expect("a folder");
    let (status, lines, said) = shown(&folder, "exit 0");
    assert_eq!(status, 1, "{lines:?}");
    assert_eq!(lines.last().map(|line| &line["event"]), Some(&"ended".into()));
    assert!(said.contains("viewer at port 9911: does not accept recordings"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn a_log_that_is_killed_and_begun_again_is_audited_anew() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = log(&folder);
    let child = watch(&path, &[]);
    let faulty = bytes(FAULTY);
    write(&path, &faulty[..faulty.len() / 2], 3);
    fs::write(&path, b"").expect("a file");
    write(&path, &bytes(CLEAN), 5);
    let (status, lines) = ended(child);
    assert_eq!(status, 0, "{lines:?}");
    let again = lines.iter().position(|line| line["event"] == "begun-again").expect("a line");
    assert!(verdicts(&lines[..again]).contains(&"fail"), "{lines:?}");
    assert!(!verdicts(&lines[again..]).contains(&"fail"), "{lines:?}");
    assert_eq!(lines.last().map(|line| &line["verdict"]), Some(&"pass".into()));
}

#[test]
fn a_log_without_an_end_yet_is_no_damaged_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = log(&folder);
    let child = watch(&path, &[]);
    // Its data are complete, but it has no footer and is not known to be growing.
    let clean = bytes(CLEAN);
    let (most, end) = clean.split_at(clean.len() - mcap::MAGIC.len());
    write(&path, most, 2);
    thread::sleep(Duration::from_secs(1));
    write(&path, end, 1);
    let (status, lines) = ended(child);
    assert_eq!(status, 0, "{lines:?}");
    assert!(lines.iter().all(|line| line["new"] == Value::Array(Vec::new())), "{lines:?}");
    let again = lines.last().and_then(|line| line["read_again_bytes"].as_u64());
    assert!(again.is_some_and(|again| again > clean.len() as u64), "{lines:?}");
}

#[test]
fn until_fail_ends_before_the_log_does() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = log(&folder);
    let faulty = bytes(FAULTY);
    write(&path, &faulty[..faulty.len() * 3 / 4], 1);
    // For a folder, watches the newest log that is being written.
    let (status, lines) = ended(watch(folder.path(), &["--until", "fail"]));
    assert_eq!(status, 1);
    assert_eq!(verdicts(&lines).last(), Some(&"fail"));
    assert!(lines.iter().all(|line| line["event"] != "ended"), "{lines:?}");
}

#[test]
fn a_log_whose_recorder_died_ends_when_nothing_comes() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = log(&folder);
    let clean = bytes(CLEAN);
    write(&path, &clean[..clean.len() / 2], 1);
    let (_, lines) = ended(watch(&path, &["--idle", "1"]));
    let last = lines.last().expect("a line");
    assert_eq!(last["event"], "ended");
    // Findings of the complete audit about the end of the file.
    let says = last["new"].as_array().expect("findings");
    assert!(
        says.iter().any(|new| new["finding"].as_str().is_some_and(|it| it.starts_with("ING001"))),
        "{last}"
    );
}

#[test]
fn until_fail_ends_with_a_log_that_fails_when_another_takes_its_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let clean = bytes(CLEAN);
    write(&log(&folder), &clean[..clean.len() / 2], 1);
    let child = watch(folder.path(), &["--until", "fail"]);
    thread::sleep(Duration::from_secs(1));
    // The recorder was killed, so the first log has no footer; recording continues with another name.
    fs::write(folder.path().join("second.mcap"), bytes(FAULTY)).expect("a file");
    let (status, lines) = ended(child);
    assert_eq!(status, 1);
    let last = lines.last().expect("a line");
    assert_eq!((&last["event"], &last["verdict"]), (&"ended".into(), &"fail".into()), "{lines:?}");
    assert!(last["log"].as_str().is_some_and(|log| log.ends_with("run.mcap")), "{lines:?}");
}

#[test]
fn a_path_that_is_not_there_is_refused_in_one_line() {
    let output = poseaudit(&["watch", "no/such.mcap"]);
    assert_eq!(status(&output), 2);
    assert!(
        stderr(&output).contains("no/such.mcap: no such file or folder"),
        "{}",
        stderr(&output)
    );
}
