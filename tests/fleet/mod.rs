//! Many logs: one row each, for any input and after crashes; and the report on them.

mod dataset;
mod logs;
mod report;
mod result_tables;

use std::fs;
use std::io;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result};
use serde_json::Value;
use tempfile::TempDir;

use logs::{BOMB_MIB, short_run, write_zip_bomb};
use result_tables::ResultTables;

/// A `poseaudit fleet` command.
fn fleet(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    command.arg("fleet").args(args).current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

fn status(output: &Output) -> Option<i32> {
    output.status.code()
}

fn json(output: &Output) -> Result<Value> {
    let stderr = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).with_context(|| stderr.into_owned())
}

/// A folder with `count` short logs, and one for results.
fn short_logs(count: u64) -> Result<(TempDir, String, String)> {
    let folder = tempfile::tempdir()?;
    let (logs, out) = (folder.path().join("logs"), folder.path().join("out"));
    for seed in 0..count {
        short_run(seed).write(&logs.join(format!("{seed:03}.mcap")))?;
    }
    let text = |path: &Path| path.display().to_string();
    Ok((folder, text(&logs), text(&out)))
}

#[test]
fn every_log_is_one_row_even_if_unreadable() -> Result<()> {
    let (folder, logs, out) = short_logs(3)?;
    let at = |name: &str| folder.path().join("logs").join(name);
    fs::copy(at("000.mcap"), at("copy.mcap"))?;
    fs::write(at("empty.mcap"), "")?;
    fs::write(at("text.bag"), "no bag")?;
    let complete = fs::read(at("001.mcap"))?;
    // Half of its only chunk, which cannot be read.
    fs::write(at("cut.mcap"), &complete[..complete.len() / 2])?;
    fs::write(at("notes.txt"), "no log")?;
    fs::copy("fixtures/faulty.mcap", at("faulty.mcap"))?;
    let output = fleet(&[&logs, "--out", &out, "--format", "json"]).output()?;
    let summary = json(&output)?;
    assert_eq!(status(&output), Some(1));
    assert_eq!(summary["schema"], "poseaudit.fleet-run/1");
    assert_eq!(summary["logs"], 8);
    assert_eq!((&summary["duplicates"], &summary["done_now"]), (&1.into(), &7.into()));
    assert_eq!(summary["statuses"]["not_audited"], 3);

    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!(rows.keys("runs").len(), 7);
    assert_eq!(rows.count_logs("runs"), 7);
    assert_eq!(rows.count_logs("errors"), 3);
    let named = rows.text_column("runs", "path");
    assert!(named.iter().all(|path| Path::new(path).is_absolute()), "{named:?}");
    // The rows are equal to those of the audit itself.
    let single_audit = Command::new(env!("CARGO_BIN_EXE_poseaudit"))
        .args(["audit", "fixtures/faulty.mcap", "--format", "json"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()?;
    let single_audit = json(&single_audit)?;
    let faulty = rows.key_of("faulty.mcap").context("a row of the log")?;
    for (table, part) in [("findings", "findings"), ("checks", "checks"), ("streams", "streams")] {
        let count = rows.keys(table).iter().filter(|key| **key == faulty).count();
        assert_eq!(Some(count), single_audit[part].as_array().map(Vec::len), "{table}");
    }
    Ok(())
}

#[test]
fn audited_logs_are_skipped_unless_settings_change() -> Result<()> {
    let (folder, logs, out) = short_logs(2)?;
    let run = |more: &[&str]| -> Result<(u64, u64)> {
        let mut args = vec![logs.as_str(), "--out", &out, "--format", "json"];
        args.extend(more);
        let summary = json(&fleet(&args).output()?)?;
        let count = |name: &str| summary[name].as_u64().context("a number");
        Ok((count("done_now")?, count("done_before")?))
    };
    assert_eq!(run(&[])?, (2, 0));
    assert_eq!(run(&[])?, (0, 2));
    assert_eq!(run(&["--fail-on", "error", "--jobs", "1", "--label", "site=x"])?, (0, 2));
    fs::rename(folder.path().join("logs/000.mcap"), folder.path().join("logs/other.mcap"))?;
    assert_eq!(run(&[])?, (0, 2));
    short_run(7).write(&folder.path().join("logs/new.mcap"))?;
    assert_eq!(run(&[])?, (1, 2));
    assert_eq!(run(&["--max-latency", "4"])?, (3, 0));
    assert_eq!(ResultTables::read(Path::new(&out))?.count_logs("runs"), 6);
    Ok(())
}

#[test]
fn pending_logs_are_those_without_a_row() -> Result<()> {
    let (folder, logs, out) = short_logs(2)?;
    let pending = |more: &[&str]| -> Result<Vec<String>> {
        let output = fleet(&[&logs, "--out", &out, "--pending"]).args(more).output()?;
        assert_eq!(status(&output), Some(0));
        let text = String::from_utf8(output.stdout)?;
        let name = |line: &str| Some(Path::new(line).file_name()?.to_str()?.to_owned());
        Ok(text.lines().filter_map(name).collect())
    };
    assert_eq!(pending(&[])?, ["000.mcap", "001.mcap"]);
    assert!(!Path::new(&out).exists());
    fleet(&[&logs, "--out", &out]).output()?;
    short_run(7).write(&folder.path().join("logs/new.mcap"))?;
    assert_eq!(pending(&[])?, ["new.mcap"]);
    assert_eq!(pending(&["--max-latency", "4"])?.len(), 3);
    assert_eq!(pending(&["--identity", "file"])?.len(), 3);
    fleet(&[&logs, "--out", &out, "--identity", "file"]).output()?;
    assert!(pending(&["--identity", "file"])?.is_empty());
    Ok(())
}

/// Kills a process and its children.
fn kill(child: &mut Child) -> io::Result<()> {
    child.kill()?;
    child.wait().map(|_| ())
}

#[test]
fn a_killed_call_can_be_resumed_without_lost_or_repeated_rows() -> Result<()> {
    const LOGS: u64 = 12;
    let (_folder, logs, out) = short_logs(LOGS)?;
    let runs = Path::new(&out).join("runs");
    // Names of unfinished parts start with a dot.
    let is_part = |part: &fs::DirEntry| !part.file_name().as_encoded_bytes().starts_with(b".");
    let done = || {
        let parts = fs::read_dir(&runs).into_iter().flatten().filter_map(Result::ok);
        parts.filter(is_part).count() as u64
    };
    let mut kills = 0;
    while done() < LOGS {
        let before = done();
        let mut child = fleet(&[&logs, "--out", &out, "--jobs", "2"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        // During the next log: some rows are written, others pending.
        while done() <= before && child.try_wait()?.is_none() {
            thread::sleep(Duration::from_millis(1));
        }
        let done_before_kill = done();
        kill(&mut child)?;
        kills += 1;
        ResultTables::read(Path::new(&out))?;
        assert!(done() >= done_before_kill, "a killed call took rows with it");
        if kills == 4 {
            break;
        }
    }
    let before = ResultTables::read(Path::new(&out))?.count_logs("runs") as u64;
    let summary = json(&fleet(&[&logs, "--out", &out, "--format", "json"]).output()?)?;
    // A killed process may have finished its log after the rows were counted.
    let done_now = summary["done_now"].as_u64().context("a number")?;
    assert!(before > 0 && done_now <= LOGS - before, "{summary}");
    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!((rows.keys("runs").len() as u64, rows.count_logs("runs") as u64), (LOGS, LOGS));
    for table in ["streams", "checks"] {
        assert_eq!(rows.count_logs(table) as u64, LOGS, "{table}");
        assert!(rows.has_unique_rows(table), "{table}");
    }
    Ok(())
}

#[test]
fn a_hundred_result_files_are_merged_without_changes() -> Result<()> {
    const LOGS: u64 = 100;
    let folder = tempfile::tempdir()?;
    let (logs, out) = (folder.path().join("logs"), folder.path().join("out"));
    fs::create_dir(&logs)?;
    // Refused after their first bytes, to be fast.
    for index in 0..LOGS {
        fs::write(logs.join(format!("{index}.mcap")), format!("no log {index}"))?;
    }
    let [logs, out] = [logs, out].map(|path| path.display().to_string());
    // So many processes that each gets one log at a time and writes its own parts.
    let output = fleet(&[&logs, "--out", &out, "--format", "json", "--jobs", "25"]).output()?;
    assert_eq!(status(&output), Some(3));
    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!((rows.count_logs("runs"), rows.count_logs("errors")), (100, 100));
    for table in ["runs", "errors"] {
        let names: Vec<String> = fs::read_dir(Path::new(&out).join(table))?
            .map(|part| Ok(part?.file_name().to_string_lossy().into_owned()))
            .collect::<io::Result<_>>()?;
        assert!(names.len() == 1 && names[0].starts_with("merged-1-"), "{names:?}");
    }
    let summary = json(&fleet(&[&logs, "--out", &out, "--format", "json"]).output()?)?;
    assert_eq!((&summary["done_now"], &summary["done_before"]), (&0.into(), &100.into()));
    Ok(())
}

#[test]
fn logs_beyond_time_or_memory_limits_are_rows_and_can_be_retried() -> Result<()> {
    let (folder, logs, out) = short_logs(1)?;
    write_zip_bomb(&folder.path().join("logs/bomb.mcap"))?;
    let limited = |more: &[&str]| -> Result<Value> {
        let mut args = vec![logs.as_str(), "--out", &out, "--format", "json"];
        args.extend(more);
        json(&fleet(&args).output()?)
    };
    let memory = format!("{}MiB", BOMB_MIB / 2);
    let summary = limited(&["--memory", &memory])?;
    if cfg!(target_os = "linux") {
        assert_eq!(summary["statuses"]["audited"], 1, "{summary}");
        assert_eq!(summary["errors"].as_array().map(Vec::len), Some(1), "{summary}");
    }
    let summary = limited(&["--timeout", "0.001", "--max-latency", "4"])?;
    assert_eq!(summary["statuses"]["timed_out"], 2, "{summary}");
    assert_eq!(limited(&["--max-latency", "4"])?["done_now"], 0);
    let summary = limited(&["--max-latency", "4", "--retry"])?;
    assert_eq!((&summary["done_now"], &summary["statuses"]["timed_out"]), (&2.into(), &0.into()));
    let rows = ResultTables::read(Path::new(&out))?;
    assert!(!rows.text_column("runs", "status").contains(&"timed_out".to_owned()));
    assert!(!rows.text_column("errors", "status").contains(&"timed_out".to_owned()));
    Ok(())
}

#[test]
fn an_unreadable_log_is_retried() -> Result<()> {
    let (folder, _, out) = short_logs(1)?;
    let [there, gone] = ["logs/000.mcap", "logs/gone.mcap"]
        .map(|name| folder.path().join(name).display().to_string());
    let list = folder.path().join("list");
    fs::write(&list, format!("{there}\n{gone}\n"))?;
    let run = || -> Result<Value> {
        let list = fs::File::open(&list)?;
        json(&fleet(&["-", "--out", &out, "--format", "json"]).stdin(list).output()?)
    };
    assert_eq!(run()?["statuses"]["unreadable"], 1);
    short_run(5).write(Path::new(&gone))?;
    let summary = run()?;
    assert_eq!((&summary["done_now"], &summary["done_before"]), (&1.into(), &1.into()));
    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!((rows.count_logs("runs"), rows.count_logs("errors")), (2, 0));
    Ok(())
}

#[test]
fn several_engines_may_write_into_one_folder() -> Result<()> {
    let (folder, _, out) = short_logs(3)?;
    let mut children = Vec::new();
    for index in [0, 1, 2, 0, 1, 2] {
        let log = folder.path().join(format!("logs/{index:03}.mcap")).display().to_string();
        let child = fleet(&[&log, "--out", &out, "--jobs", "1"]).stdout(Stdio::null()).spawn()?;
        children.push(child);
    }
    for mut child in children {
        assert_eq!(child.wait()?.code(), Some(0));
    }
    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!((rows.keys("runs").len(), rows.count_logs("runs")), (3, 3));
    assert!(rows.has_unique_rows("checks"));
    Ok(())
}

#[test]
fn labels_come_from_options_and_paths() -> Result<()> {
    let folder = tempfile::tempdir()?;
    for arm in ["cell1", "cell2"] {
        let path = folder.path().join("berlin").join(arm).join("run.mcap");
        short_run(arm.len() as u64 + u64::from(arm == "cell2")).write(&path)?;
    }
    let [logs, out] = ["berlin", "out"].map(|name| folder.path().join(name).display().to_string());
    let call = [&logs, "--out", &out, "--labels-from", "{site}/{arm}/*", "--label", "shift=night"];
    assert_eq!(status(&fleet(&call).output()?), Some(0));
    let rows = ResultTables::read(Path::new(&out))?;
    assert_eq!(rows.text_column("runs", "site"), ["berlin", "berlin"]);
    let mut arms = rows.text_column("runs", "arm");
    arms.sort();
    assert_eq!(arms, ["cell1", "cell2"]);
    assert!(rows.text_column("runs", "labels_json").iter().all(|json| json.contains("night")));
    Ok(())
}

#[test]
fn a_wrong_call_exits_with_2_and_writes_nothing() -> Result<()> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out").display().to_string();
    let empty = folder.path().display().to_string();
    for args in [
        &["no/such", "--out", &out][..],
        &[&empty, "--out", &out],
        &["fixtures", "--out", "Cargo.toml"],
        &["fixtures"],
        &["fixtures", "--out", &out, "--memory", "much"],
        &["fixtures", "--out", &out, "--robot", "no/such.urdf"],
        &["fixtures", "--out", &out, "--label", "site"],
        &["fixtures", "--out", &out, "--labels-from", "*"],
        &["report", &empty],
    ] {
        let output = fleet(args).output()?;
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(status(&output), Some(2), "{args:?}: {stderr}");
        assert!(stderr.starts_with("error: "), "{args:?}: {stderr}");
        assert!(!Path::new(&out).join("runs").exists(), "{args:?}");
    }
    Ok(())
}
