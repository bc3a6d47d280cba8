//! Data for the Rerun viewer, from `--view` and from the importer that the viewer runs for each file.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const FAULTY: &str = "fixtures/faulty.mcap";

fn program(path: &str) -> Command {
    let mut command = Command::new(path);
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    command
}

fn import(arguments: &[&str]) -> Output {
    let mut importer = program(env!("CARGO_BIN_EXE_rerun-importer-poseaudit"));
    importer.args(arguments).output().expect("the importer runs")
}

fn contains_text(bytes: &[u8], part: &str) -> bool {
    bytes.windows(part.len()).any(|window| window == part.as_bytes())
}

#[test]
fn the_importer_adds_the_audit_to_the_named_recording() {
    let output = import(&[FAULTY, "--application-id", "an-app", "--recording-id", "rec-4711"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.starts_with(b"RRF"), "no recording");
    assert!(contains_text(&output.stdout, "an-app") && contains_text(&output.stdout, "rec-4711"));
}

/// An audit that writes `layer.rrd` as a layer of another recording.
fn audit_with_layer(folder: &Path, base: &str) -> Output {
    let mut audit = program(env!("CARGO_BIN_EXE_poseaudit"));
    audit.args(["audit", FAULTY, "-q", "--rrd"]).arg(folder.join("layer.rrd"));
    audit.arg("--rrd-layer").arg(folder.join(base)).output().expect("the program runs")
}

#[test]
fn a_layer_has_the_ids_and_timelines_of_its_base() {
    let folder = tempfile::tempdir().expect("a folder");
    let imported = import(&[FAULTY, "--application-id", "an-app", "--recording-id", "rec-4711"]);
    fs::write(folder.path().join("base.rrd"), &imported.stdout).expect("a file");
    let output = audit_with_layer(folder.path(), "base.rrd");
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let layer = fs::read(folder.path().join("layer.rrd")).expect("a layer");
    for part in ["an-app", "rec-4711", "ros2_timestamp"] {
        assert!(contains_text(&layer, part), "{part}");
    }
}

#[test]
fn a_base_that_is_no_recording_of_a_log_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("text.rrd"), "nothing\n").expect("a file");
    for (base, expected) in [("text.rrd", "not a Rerun recording"), ("none.rrd", "cannot be read")]
    {
        let output = audit_with_layer(folder.path(), base);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(expected) && stderr.lines().count() == 1, "{stderr}");
        assert!(!folder.path().join("layer.rrd").exists());
    }
    let mut audit = program(env!("CARGO_BIN_EXE_poseaudit"));
    let output = audit.args(["audit", FAULTY, "--rrd-layer", FAULTY]).output();
    let stderr = String::from_utf8(output.expect("the program runs").stderr).expect("UTF-8");
    assert!(stderr.contains("add --rrd FILE or --view"), "{stderr}");
}

#[test]
fn files_without_an_arm_are_left_to_other_importers() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = folder.path().join("notes.txt");
    fs::write(&text, "nothing\n").expect("a file");
    for file in ["README.md", "no/such.mcap", &text.display().to_string()] {
        let output = import(&[file, "--recording-id", "r"]);
        assert_eq!(output.status.code(), Some(66), "{file}");
        assert!(output.stdout.is_empty(), "{file}");
    }
    assert_eq!(import(&["--recording-id", "r"]).status.code(), Some(2));
}

/// An audit with `--view` and only `folder` on the path.
fn audit_with_view(folder: &Path, more: &[&str]) -> Output {
    let mut audit = program(env!("CARGO_BIN_EXE_poseaudit"));
    audit.env("PATH", folder).args(["audit", FAULTY, "--view"]).args(more);
    audit.output().expect("the program runs")
}

#[test]
fn mesh_folders_must_exist_and_be_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let rrd = folder.path().join("run.rrd").display().to_string();
    let audit = |arguments: &[&str]| {
        let mut audit = program(env!("CARGO_BIN_EXE_poseaudit"));
        audit.args(["audit", FAULTY]).args(arguments);
        let output = audit.output().expect("the program runs");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let cases = [
        (vec!["--mesh-root", "no/such", "--rrd", &rrd], "no/such: no such folder"),
        (vec!["--mesh-root", "src", "--mesh-root", FAULTY, "--rrd", &rrd], "not a folder"),
        (vec!["--mesh-root", "src"], "--rrd FILE or --view"),
    ];
    for (arguments, expected) in cases {
        let (status, stderr) = audit(&arguments);
        assert_eq!(status, Some(2), "{arguments:?}");
        assert!(stderr.contains(expected) && stderr.lines().count() == 1, "{stderr}");
        assert!(!folder.path().join("run.rrd").exists());
    }
}

#[test]
fn missing_meshes_are_noted_in_the_report() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut audit = program(env!("CARGO_BIN_EXE_poseaudit"));
    let rrd = folder.path().join("run.rrd");
    audit.args(["audit", FAULTY, "--mesh-root"]).arg(folder.path()).arg("--rrd").arg(&rrd);
    let output = audit.output().expect("the program runs");
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let report = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(report.contains("has no mesh: it is drawn as capsules"), "{report}");
    assert!(rrd.is_file());
}

#[test]
fn without_a_viewer_nothing_is_audited() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = audit_with_view(folder.path(), &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(output.stdout.is_empty());
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(stderr.contains("--view") && stderr.contains("not on the PATH"), "{stderr}");
}

#[cfg(unix)]
#[test]
fn the_viewer_is_started_with_the_recording() {
    use std::os::unix::fs::PermissionsExt;
    use std::time::Duration;

    let folder = tempfile::tempdir().expect("a folder");
    let viewer = folder.path().join("rerun");
    let (argument_file, recording) = (folder.path().join("seen"), folder.path().join("run.rrd"));
    // The file is renamed when it is complete.
    let script = format!(
        "#!/bin/sh\nprintf %s \"$1\" > {0}.part\n/bin/mv {0}.part {0}\n",
        argument_file.display()
    );
    fs::write(&viewer, script).expect("a script");
    fs::set_permissions(&viewer, fs::Permissions::from_mode(0o755)).expect("a program");
    let path = recording.display().to_string();
    let output = audit_with_view(folder.path(), &["--rrd", &path]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    // The program does not wait for the viewer.
    let polls = (0..500).map(|_| std::thread::sleep(Duration::from_millis(20)));
    let opened = polls.map(|()| fs::read_to_string(&argument_file)).find_map(Result::ok);
    assert_eq!(opened.as_deref(), Some(path.as_str()));
    assert!(recording.is_file());
}
