//! Tests every output of every command with every input: no input is lost, and no existing file is lost
//! unless it is replaced completely.
#![allow(unsafe_code, reason = "limits and signals of a child")]
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

/// A command: its inputs and its arguments, with `OUT` as the output.
struct Call {
    args: &'static str,
    inputs: &'static [&'static str],
    /// For an output folder, a file that is written into it.
    file: Option<&'static str>,
}

const AUDIT_INPUTS: &[&str] =
    &["run.mcap", "bag/bag_0.mcap", "r.toml", "c.yaml", "poseaudit.toml", "corrections.toml"];

/// Inputs of an audit in these tests.
const AUDIT_ARGS: &str = "run.mcap bag --robot r.toml --calibration c.yaml --config poseaudit.toml";

const CALLS: &[Call] = &[
    Call {
        args: "audit READS --corrections corrections.toml --output OUT",
        inputs: AUDIT_INPUTS,
        file: None,
    },
    Call {
        args: "audit READS --corrections corrections.toml --format json --output OUT",
        inputs: AUDIT_INPUTS,
        file: None,
    },
    Call {
        args: "audit READS --corrections corrections.toml --format json --format html --output OUT",
        inputs: AUDIT_INPUTS,
        file: Some("report.json"),
    },
    Call {
        args: "audit READS --corrections corrections.toml --rrd OUT",
        inputs: AUDIT_INPUTS,
        file: None,
    },
    Call {
        args: "audit run.mcap --mesh-root meshes --rrd OUT",
        inputs: &["meshes/a/link.obj"],
        file: None,
    },
    Call {
        args: "audit run.mcap --mesh-root meshes --rrd new.rrd --output OUT",
        inputs: &["meshes/a/link.obj"],
        file: None,
    },
    Call {
        args: "audit READS --corrections corrections.toml --mcap OUT",
        inputs: AUDIT_INPUTS,
        file: None,
    },
    Call {
        args: "audit READS --corrections corrections.toml --plotjuggler OUT",
        inputs: AUDIT_INPUTS,
        file: None,
    },
    Call {
        args: "audit READS --corrections corrections.toml --parquet OUT",
        inputs: AUDIT_INPUTS,
        file: Some("findings.parquet"),
    },
    Call {
        args: "audit READS --fix OUT",
        inputs: &["run.mcap", "bag/bag_0.mcap", "r.toml", "c.yaml", "poseaudit.toml"],
        file: Some("corrections.toml"),
    },
    Call { args: "audit READS --fix OUT", inputs: &["run.mcap", "r.toml"], file: Some("r.toml") },
    Call {
        args: "compare old.json run.mcap --output OUT",
        inputs: &["old.json", "run.mcap"],
        file: None,
    },
    Call { args: "compare bag run.mcap --output OUT", inputs: &["bag/bag_0.mcap"], file: None },
    Call {
        args: "init run.mcap bag --output OUT",
        inputs: &["run.mcap", "bag/bag_0.mcap"],
        file: None,
    },
    Call { args: "fk r.toml --file q.csv --output OUT", inputs: &["r.toml", "q.csv"], file: None },
    Call {
        args: "fleet run.mcap bag --out results --output OUT",
        inputs: &["run.mcap", "bag/bag_0.mcap"],
        file: None,
    },
    Call {
        args: "fleet run.mcap --out results --robot r.toml --config poseaudit.toml --output OUT",
        inputs: &["r.toml", "poseaudit.toml", "results/runs/part.parquet"],
        file: None,
    },
    Call {
        args: "fleet run.mcap --out results --pending --output OUT",
        inputs: &["run.mcap", "results/runs/part.parquet"],
        file: None,
    },
    Call {
        args: "fleet report results --output OUT",
        inputs: &["results/runs/part.parquet"],
        file: None,
    },
];

/// A folder with an input of every kind. Each has invalid content, so a reader that runs before the output
/// check causes a different error.
fn folder_with_inputs() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for name in AUDIT_INPUTS
        .iter()
        .chain(&["meshes/a/link.obj", "old.json", "q.csv", "results/runs/part.parquet"])
    {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        // A config is read for the robots that it names.
        let text = if *name == "poseaudit.toml" { "# nothing\n" } else { name };
        fs::write(path, text).expect("a file");
    }
    folder
}

fn poseaudit(folder: &Path, args: &[String]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    command.args(args).current_dir(folder);
    command
}

fn args(call: &str, out: &str) -> Vec<String> {
    let call = call.replace("READS", AUDIT_ARGS);
    call.split(' ').map(|arg| arg.replace("OUT", out)).collect()
}

/// A hash of each file below a folder, and the targets of its links. A fleet's lock is empty and remains.
fn hash_files(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_symlink() {
            let target = fs::read_link(&path).expect("a link");
            all.insert(path, target.display().to_string());
        } else if path.is_dir() {
            all.extend(hash_files(&path));
        } else if !path.ends_with(".lock") {
            let bytes = fs::read(&path).expect("a file");
            all.insert(path, blake3::hash(&bytes).to_hex().to_string());
        }
    }
    all
}

/// Asserts that a call exited with status 2 and one line that contains `part`, without other output.
#[track_caller]
fn assert_refused(output: &Output, part: &str, call: &[String]) {
    assert_one_line_error(output, part, call);
    assert!(output.stdout.is_empty(), "{call:?}");
}

/// Asserts that a call exited with status 2 and one line that contains `part`.
#[track_caller]
fn assert_one_line_error(output: &Output, part: &str, call: &[String]) {
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let line = stderr.trim_end();
    assert_eq!(output.status.code(), Some(2), "{call:?}: {line}");
    assert!(line.starts_with("error: ") && !line.contains('\n'), "{call:?}: {line}");
    assert!(line.contains(part), "{call:?}: {line}");
}

/// The same for a call whose output could not be written, with a report on stdout.
#[track_caller]
fn assert_output_refused(output: &Output, part: &str, call: &[String]) {
    let has_report_on_stdout = ["--rrd", "--mcap", "--parquet", "--fix"]
        .iter()
        .any(|option| call.iter().any(|arg| arg == option));
    if !has_report_on_stdout {
        return assert_refused(output, part, call);
    }
    assert_one_line_error(output, part, call);
    let report = String::from_utf8_lossy(&output.stdout);
    assert!(report.contains("base.mcap") && report.contains("PASS"), "{call:?}: {report}");
}

/// Runs `call` with its output at `out`, and asserts that it is refused without changes.
#[track_caller]
fn assert_call_refused(folder: &Path, call: &Call, out: &str, part: &str) {
    let before = hash_files(folder);
    let args = args(call.args, out);
    let output = poseaudit(folder, &args).output().expect("the binary runs");
    assert_refused(&output, part, &args);
    assert_eq!(hash_files(folder), before, "{args:?}");
}

#[test]
fn no_output_overwrites_an_input() {
    let folder = folder_with_inputs();
    let at = |name: &str| folder.path().join(name);
    for (number, call) in CALLS.iter().enumerate() {
        for input in call.inputs {
            let name = input.replace('/', "_");
            // `init` does not overwrite anything, however the path is written. A store has only its own
            // files, and meshes are read only below their folder.
            let what = match call.args {
                init if init.starts_with("init") => "",
                _ if input.starts_with("results") => "is written there too",
                _ if input.starts_with("meshes") => "is one of the files in --mesh-root meshes",
                _ => "which would be lost",
            };
            if let Some(file) = call.file {
                let [hard, soft] = ["hard", "soft"].map(|kind| format!("{kind}-{number}-{name}"));
                fs::create_dir(at(&hard)).expect("a folder");
                fs::create_dir(at(&soft)).expect("a folder");
                fs::hard_link(at(input), at(&hard).join(file)).expect("a link");
                symlink(at(input), at(&soft).join(file)).expect("a link");
                assert_call_refused(folder.path(), call, &hard, what);
                assert_call_refused(folder.path(), call, &soft, what);
                continue;
            }
            assert_call_refused(folder.path(), call, input, what);
            assert_call_refused(folder.path(), call, &format!("./new/../meshes/../{input}"), what);
            assert_call_refused(folder.path(), call, &at(input).display().to_string(), what);
            let link = format!("link-{number}-{name}");
            symlink(at(input), at(&link)).expect("a link");
            assert_call_refused(folder.path(), call, &link, what);
            // If only names count, a different name is a different file, which is replaced.
            if what == "which would be lost" || what.is_empty() {
                let hard = format!("hard-{number}-{name}");
                fs::hard_link(at(input), at(&hard)).expect("a link");
                assert_call_refused(folder.path(), call, &hard, what);
            }
        }
    }
}

/// Every output of a call that reads a log, with `LOG` as the log; for a folder, a file that is written
/// into it.
const LOG_CALLS: &[(&str, Option<&str>)] = &[
    ("audit LOG --output OUT", None),
    ("audit LOG --format json --output OUT", None),
    ("audit LOG --format json --format html --output OUT", Some("report.json")),
    ("audit LOG --rrd OUT", None),
    ("audit LOG --mcap OUT", None),
    ("audit LOG --parquet OUT", Some("findings.parquet")),
    ("audit LOG --fix OUT", Some("corrections.toml")),
    ("compare old.json LOG --output OUT", None),
];

/// Fleets, and reports on the folder `FOLDER`, in which the log is.
const FLEET_CALLS: &[(&str, Option<&str>)] = &[
    ("fleet LOG --out fleet --output OUT", None),
    ("fleet LOG --out fleet --pending --output OUT", None),
    ("fleet report FOLDER --output OUT", None),
    ("fleet report FOLDER --format html --output OUT", None),
];

/// Logs that are folders, parts of a file, or have companion files, and the files that are read with each.
const LOGS_AND_FILES: &[(&str, &[&str])] = &[
    ("a.lerobot", &["a.lerobot/meta/info.json", EPISODE]),
    ("a.lerobot#1", &["a.lerobot/meta/info.json", EPISODE]),
    (EPISODE, &["a.lerobot/meta/info.json", EPISODE]),
    ("a.zarr", &["a.zarr/.zgroup", "a.zarr/actual_q/.zarray", "a.zarr/actual_q/0.0"]),
    ("bag", &["bag/bag_0.mcap", "bag/metadata.yaml"]),
    ("tfa/a.tfrecord", &["tfa/a.tfrecord", "tfa/features.json", "tfa/dataset_info.json"]),
    ("b.h5#demo_1", &["b.h5"]),
    ("a.npz", &["a.npz"]),
    ("run.db3", &["run.db3", "run.db3-wal"]),
];

const EPISODE: &str = "a.lerobot/data/chunk-000/episode_000000.parquet";

/// A folder with these logs, valid as far as their type detection.
fn folder_with_logs() -> TempDir {
    let folder = folder_with_inputs();
    // The header of an empty record.
    let record = [&[0; 8][..], &[41, 3, 152, 7]].concat();
    for file in LOGS_AND_FILES.iter().flat_map(|(_, files)| files.iter()) {
        let content: &[u8] = match *file {
            "a.zarr/.zgroup" => b"{\"zarr_format\": 2}",
            "a.lerobot/meta/info.json" => b"{}",
            "tfa/a.tfrecord" => &record,
            "run.db3" => b"SQLite format 3\0",
            name => name.as_bytes(),
        };
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, content).expect("a file");
    }
    folder
}

#[test]
fn no_output_overwrites_a_file_of_a_log_at_any_depth() {
    let folder = folder_with_logs();
    let at = |name: &str| folder.path().join(name);
    for (number, (args, file)) in LOG_CALLS.iter().chain(FLEET_CALLS).enumerate() {
        for (log, files) in LOGS_AND_FILES {
            let path = Path::new(log);
            let parent = path.parent().filter(|parent| *parent != Path::new(""));
            let of_file = parent.unwrap_or(Path::new("."));
            let results = if at(log).is_dir() { path } else { of_file };
            // A fleet takes no single episode, and refuses folders without data before it looks at outputs.
            let is_refused = log.contains('#') || at(log).is_dir();
            if args.starts_with("fleet LOG") && is_refused {
                continue;
            }
            // Nothing is written into a dataset or a store, not even the tables of the fleet.
            let is_store = matches!(results.to_str(), Some("a.lerobot" | "a.zarr"));
            let is_report = args.starts_with("fleet report");
            let is_inside = is_report && is_store;
            let why = if is_inside { "would become part of it" } else { "which would be lost" };
            let args = args.replace("LOG", log).replace("FOLDER", &results.display().to_string());
            let call = Call { args: args.as_str().to_owned().leak(), inputs: &[], file: *file };
            for input in *files {
                // A report reads only the folder.
                let is_elsewhere =
                    results != Path::new(".") && !Path::new(input).starts_with(results);
                if is_report && is_elsewhere {
                    continue;
                }
                let name =
                    format!("{number}-{}-{}", log.replace('/', "_"), input.replace('/', "_"));
                let [hard, soft] = ["hard", "soft"].map(|kind| format!("{kind}-{name}"));
                match file {
                    Some(file) => {
                        fs::create_dir(at(&hard)).expect("a folder");
                        fs::create_dir(at(&soft)).expect("a folder");
                        fs::hard_link(at(input), at(&hard).join(file)).expect("a link");
                        symlink(at(input), at(&soft).join(file)).expect("a link");
                    }
                    None => {
                        assert_call_refused(folder.path(), &call, input, why);
                        fs::hard_link(at(input), at(&hard)).expect("a link");
                        symlink(at(input), at(&soft)).expect("a link");
                    }
                }
                assert_call_refused(folder.path(), &call, &hard, why);
                assert_call_refused(folder.path(), &call, &soft, why);
            }
        }
    }
}

#[test]
fn nothing_is_written_into_a_folder_that_is_a_log() {
    let folder = folder_with_logs();
    for (args, file) in LOG_CALLS {
        for (log, inside) in [
            ("a.lerobot", "a.lerobot/data/chunk-000"),
            (EPISODE, "a.lerobot/data/chunk-000"),
            ("a.zarr", "a.zarr/actual_q"),
            ("bag", "bag"),
        ] {
            let args = args.replace("LOG", log);
            let call = Call { args: args.leak(), inputs: &[], file: *file };
            let out = if file.is_some() { inside.to_owned() } else { format!("{inside}/new") };
            assert_call_refused(folder.path(), &call, &out, "would become part of it");
        }
    }
    // A config is allowed there, but a report on results must not replace a table.
    let init = Call { args: "init bag --output OUT", inputs: &[], file: None };
    let args = args(init.args, "bag/poseaudit.toml");
    let output = poseaudit(folder.path(), &args).output().expect("the binary runs");
    assert!(!String::from_utf8_lossy(&output.stderr).contains("part of it"));
    let results = Call { args: "fleet report a.lerobot --output OUT", inputs: &[], file: None };
    for out in [EPISODE, "a.lerobot/new.html"] {
        assert_call_refused(folder.path(), &results, out, "would become part of it");
    }
}

#[test]
fn a_report_on_an_invalid_config_overwrites_no_input() {
    let folder = folder_with_inputs();
    fs::write(folder.path().join("poseaudit.toml"), "no config").expect("a file");
    let call = &CALLS[1];
    for input in AUDIT_INPUTS {
        assert_call_refused(folder.path(), call, input, "which would be lost");
    }
    fs::write(folder.path().join("poseaudit.toml"), "robot = \"named.toml\"\n").expect("a file");
    fs::write(folder.path().join("named.toml"), "named").expect("a file");
    let named =
        Call { args: "audit run.mcap --config poseaudit.toml --format json --output OUT", ..*call };
    assert_call_refused(folder.path(), &named, "named.toml", "which would be lost");
}

#[test]
fn two_outputs_at_the_same_path_are_refused() {
    let folder = folder_with_inputs();
    for (args, part) in [
        ("audit run.mcap --rrd x --output OUT", "x"),
        ("audit run.mcap --rrd x --output OUT", "./new/../x"),
        ("audit run.mcap --rrd x --output OUT", "x/y"),
        ("audit run.mcap --parquet tables --output OUT", "tables/checks.parquet"),
        ("audit run.mcap --fix mend --rrd OUT", "mend/corrections.md"),
        ("audit run.mcap --fix mend --rrd OUT", "mend"),
        ("audit run.mcap --format json --format html --output o --rrd OUT", "o/report.html"),
        ("fleet run.mcap --out results --output OUT", "results/runs/new.parquet"),
    ] {
        let call = Call { args, inputs: &[], file: None };
        assert_call_refused(folder.path(), &call, part, "is written there too");
    }
}

#[test]
fn folders_linked_files_and_read_only_files_are_not_replaced() {
    let folder = folder_with_inputs();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("folder/inside")).expect("a folder");
    fs::write(at("file"), "mine").expect("a file");
    fs::write(at("kept"), "kept").expect("a file");
    fs::set_permissions(at("kept"), Permissions::from_mode(0o444)).expect("permissions");
    for (number, call) in CALLS.iter().enumerate() {
        let is_init = call.args.starts_with("init");
        let expected_part = |what| if is_init { "exists already" } else { what };
        if let Some(file) = call.file {
            assert_call_refused(folder.path(), call, "file", "folder");
            let out = format!("out-{number}");
            fs::create_dir(at(&out)).expect("a folder");
            fs::copy(at("kept"), at(&out).join(file)).expect("a copy");
            assert_call_refused(folder.path(), call, &out, "is read-only");
            continue;
        }
        assert_call_refused(folder.path(), call, "folder", expected_part("is a folder"));
        assert_call_refused(folder.path(), call, "file/new", "file is not a folder");
        assert_call_refused(folder.path(), call, "kept", expected_part("is read-only"));
        let link = format!("folder/link-{number}");
        symlink(at("file"), at(&link)).expect("a link");
        assert_call_refused(folder.path(), call, &link, expected_part("outside its folder"));
    }
}

#[test]
fn stdout_redirected_into_an_input_is_refused() {
    let folder = folder_with_inputs();
    let path = folder.path().join("run.mcap");
    let before = fs::read(&path).expect("the log");
    for call in [
        "audit run.mcap",
        "info run.mcap",
        "audit run.mcap --format json --output new",
        "tf run.mcap base tool0",
    ] {
        let stdout = fs::File::options().append(true).open(&path).expect("the log");
        let args = args(call, "");
        let output = poseaudit(folder.path(), &args).stdout(stdout).output().expect("it runs");
        assert_refused(&output, "it is the log run.mcap, which would be lost", &args);
        assert_eq!(fs::read(&path).expect("the log"), before);
    }
}

/// Calls that write, with their actual inputs.
const WRITING_CALLS: &[&str] = &[
    "audit LOG --select ING --output OUT/new",
    "audit LOG --select ING --format json --format html --output OUT",
    "audit LOG --select ING --rrd OUT/new",
    "audit LOG --select ING --mcap OUT/new",
    "audit LOG --select ING --parquet OUT",
    "audit LOG --select ING --fix OUT",
    "compare LOG LOG --output OUT/new",
    "init LOG --output OUT/new",
    "fk ur5e --file q.csv --output OUT/new.csv",
    "fleet LOG --select ING --out OUT",
    "fleet LOG --out OUT/store --pending --output OUT/new",
    "fleet report results --output OUT/new",
    "demo OUT",
    "demo --pair OUT",
    "man --output OUT",
];

fn writing_calls(folder: &Path, out: &str) -> Vec<Vec<String>> {
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/base.mcap");
    let joints = "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,\
                  wrist_3_joint\n0,0,0,0,0,0\n";
    fs::write(folder.join("q.csv"), joints).expect("a file");
    let log = log.display().to_string();
    WRITING_CALLS.iter().map(|call| args(&call.replace("LOG", &log), out)).collect()
}

#[test]
fn a_full_disk_and_an_unwritable_folder_change_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let results = args("fleet LOG --select ING --out results", "");
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/base.mcap");
    let results = results.iter().map(|arg| arg.replace("LOG", &log.display().to_string()));
    let fleet = poseaudit(folder.path(), &results.collect::<Vec<_>>()).output().expect("it runs");
    assert!(fleet.status.code().is_some_and(|code| code < 2));
    for call in writing_calls(folder.path(), "old") {
        let old = folder.path().join("old");
        fs::create_dir_all(&old).expect("a folder");
        let is_init = call[0] == "init";
        if !is_init {
            fs::write(old.join("new"), "as it was").expect("a file");
            fs::write(old.join("new.csv"), "as it was").expect("a file");
        }
        let before = hash_files(folder.path());
        let mut command = poseaudit(folder.path(), &call);
        // Simulates a full disk: no file can have a byte.
        let forbid_writing = || {
            let none = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
            // SAFETY: both calls affect only this process, and are allowed between fork and exec.
            let set = unsafe {
                libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
                libc::setrlimit(libc::RLIMIT_FSIZE, &none)
            };
            if set == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
        };
        // SAFETY: see above.
        let output = unsafe { command.pre_exec(forbid_writing) }.output().expect("the binary runs");
        assert_output_refused(&output, "File too large", &call);
        assert_eq!(hash_files(folder.path()), before, "{call:?}");
        fs::remove_dir_all(&old).expect("a folder");
    }
    for call in writing_calls(folder.path(), "/proc/none") {
        let before = hash_files(folder.path());
        let output = poseaudit(folder.path(), &call).output().expect("the binary runs");
        assert_output_refused(&output, "/proc/none", &call);
        assert_eq!(hash_files(folder.path()), before, "{call:?}");
    }
}

#[test]
fn an_interrupted_call_leaves_no_partial_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/faulty.mcap");
    fs::write(folder.path().join("run.rrd"), "as it was").expect("a file");
    let names = || {
        let entries = fs::read_dir(folder.path()).expect("a folder");
        entries.map(|entry| entry.expect("an entry").file_name()).collect::<Vec<_>>()
    };
    for signal in [libc::SIGINT, libc::SIGTERM] {
        let call = ["audit", &log.display().to_string(), "--rrd", "run.rrd"].map(str::to_owned);
        // A call may finish before it is observed to write.
        let interrupted = (0..20).find_map(|_| {
            let mut command = poseaudit(folder.path(), &call);
            // The parent may have set this signal to be ignored, as a shell does for background jobs.
            let reset_signal = move || {
                // SAFETY: the call only resets the signal in the child.
                unsafe { libc::signal(signal, libc::SIG_DFL) };
                Ok(())
            };
            // SAFETY: a single async-signal-safe call runs between fork and exec.
            let command = unsafe { command.pre_exec(reset_signal) };
            let mut child = command.stdout(Stdio::null()).spawn().expect("the binary runs");
            let pid = i32::try_from(child.id()).expect("a process");
            let mut status = None;
            while status.is_none() && names().len() < 2 {
                status = child.try_wait().expect("a child");
            }
            // SAFETY: the process is a child of this one that has not been waited for.
            let sent = status.is_none() && unsafe { libc::kill(pid, signal) } == 0;
            let status = child.wait().expect("a child");
            (sent && status.signal().is_some()).then_some(status)
        });
        assert_eq!(interrupted.and_then(|status| status.signal()), Some(signal));
        assert_eq!(names(), ["run.rrd"]);
    }
}

#[test]
fn the_same_log_gives_the_same_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/faulty.mcap");
    let recordings = ["a.rrd", "b.rrd"].map(|name| {
        let call = ["audit", &log.display().to_string(), "--rrd", name].map(str::to_owned);
        let output = poseaudit(folder.path(), &call).output().expect("the binary runs");
        assert_eq!(output.status.code(), Some(1));
        fs::read(folder.path().join(name)).expect("a recording")
    });
    assert!(recordings[0].len() > 100_000 && recordings[0] == recordings[1]);
}

#[test]
fn an_unwritable_temporary_folder_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/base.mcap"));
    let packed = zstd::bulk::compress(&log.expect("the fixture"), 1).expect("memory");
    fs::write(folder.path().join("run.mcap.zst"), packed).expect("a file");
    for call in ["audit run.mcap.zst", "info run.mcap.zst", "fleet run.mcap.zst --out results"] {
        for place in ["/none", "/dev/null"] {
            let call = args(call, "");
            let output = poseaudit(folder.path(), &call).env("TMPDIR", place).output();
            let output = output.expect("the binary runs");
            assert_refused(&output, &format!(" in {place}: "), &call);
            assert_refused(&output, "set TMPDIR to another folder", &call);
        }
    }
}
