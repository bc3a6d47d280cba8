//! Repeated `--format`, and `--output`.

use std::collections::BTreeSet;
use std::fs;

use poseaudit::report::FORMATS;
use serde_json::Value;

use super::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};

/// Runs `audit LOG` in every format, into `folder`.
fn args_of_all_formats(log: &str, folder: &str) -> Vec<String> {
    let mut args = vec!["audit".to_owned(), log.to_owned()];
    args.extend(FORMATS.iter().flat_map(|format| ["--format".to_owned(), format.name.to_owned()]));
    args.extend(["--output".to_owned(), folder.to_owned()]);
    args
}

#[test]
fn several_formats_are_written_into_a_folder_and_equal_single_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder_path = folder.path().join("made/for/it");
    let args = args_of_all_formats(FAULTY, &folder_path.display().to_string());
    let output = poseaudit(&args.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(status(&output), 1, "{}", stderr(&output));
    assert!(output.stdout.is_empty(), "{}", stdout(&output));
    let names = fs::read_dir(&folder_path)
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"));
    let expected: BTreeSet<String> =
        FORMATS.iter().map(|format| format.file_name.to_owned()).collect();
    assert_eq!(names.collect::<BTreeSet<_>>(), expected);
    for format in FORMATS {
        let kept = fs::read(folder_path.join(format.file_name)).expect("the file");
        let alone = poseaudit(&["audit", FAULTY, "--format", format.name]);
        assert_eq!(status(&alone), 1, "{}", format.name);
        assert!(kept == alone.stdout, "{} differs", format.name);
    }
}

#[test]
fn several_formats_without_a_folder_are_refused_before_the_audit() {
    let call = ["audit", "no/such.mcap", "--format", "text", "--format", "json"];
    for (output, part) in [(None, "--output"), (Some("Cargo.toml"), "a folder")] {
        let output = output.map(|path| ["--output", path]);
        let output = poseaudit(&[&call[..], output.as_ref().map_or(&[], |it| &it[..])].concat());
        assert_eq!(status(&output), 2);
        let line = stderr(&output).trim_end();
        assert!(line.contains(part) && !line.contains('\n'), "{line}");
        assert!(output.stdout.is_empty(), "{}", stdout(&output));
    }
}

#[test]
fn a_repeated_format_counts_once() {
    let once = poseaudit(&["audit", CLEAN, "--format", "json"]);
    let twice = poseaudit(&["audit", CLEAN, "--format", "json", "--format", "json"]);
    assert_eq!(status(&twice), 0, "{}", stderr(&twice));
    assert!(once.stdout == twice.stdout);
}

#[test]
fn an_unreadable_log_is_reported_in_every_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("empty.mcap");
    fs::write(&log, "").expect("a file");
    let folder_path = folder.path().join("reports");
    let args = args_of_all_formats(&log.display().to_string(), &folder_path.display().to_string());
    let output = poseaudit(&args.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(status(&output), 3, "{}", stderr(&output));
    for format in FORMATS {
        let text = fs::read_to_string(folder_path.join(format.file_name)).expect(format.name);
        assert!(text.contains("the file is empty"), "{}: {text}", format.name);
    }
    let json = fs::read(folder_path.join("report.json")).expect("the report");
    let json: Value = serde_json::from_slice(&json).expect("JSON");
    assert_eq!(json["error"]["what"], "the file is empty (0 bytes)");
}
