//! The process boundary: output on stdout and stderr, and the exit status.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).expect("stdout is JSON")
}

/// Asserts that the call exits with `expected`, prints one line with `part`, and no report.
#[track_caller]
fn assert_refused(args: &[&str], expected: i32, part: &str) {
    let output = poseaudit(args);
    assert_eq!(status(&output), expected, "{}", stderr(&output));
    let line = stderr(&output).trim_end();
    assert!(line.starts_with("error: ") && !line.contains('\n'), "{line}");
    assert!(line.contains(part), "{line}");
    assert!(output.stdout.is_empty(), "{}", stdout(&output));
}

#[test]
fn a_file_that_is_not_a_log_gives_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, content).expect("a file");
        path.display().to_string()
    };
    assert_refused(&["audit", "no/such.mcap"], 2, "no/such.mcap");
    assert_refused(&["audit", &path("empty.mcap", b"")], 3, "empty.mcap");
    assert_refused(&["audit", &path("text.mcap", b"t,x,y\n0,1,2\n")], 3, "text");
    assert_refused(&["audit", &folder.path().display().to_string()], 3, "directory");
    assert_refused(&["info", "no/such.mcap"], 2, "no/such.mcap");
}

#[test]
fn errors_are_reports_in_json() {
    let output = poseaudit(&["audit", "no/such.mcap", "--format", "json"]);
    let report = json(&output);
    assert_eq!(status(&output), 2);
    assert_eq!(report["schema"], "poseaudit.report/1");
    assert_eq!(report["verdict"], "inconclusive");
    for key in ["what", "where", "do"] {
        assert!(report["error"][key].as_str().is_some_and(|text| !text.is_empty()), "{key}");
    }
}

#[test]
fn a_truncated_log_is_audited_up_to_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cut.mcap");
    let whole = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(CLEAN)).expect("the fixture");
    fs::write(&path, &whole[..whole.len() * 2 / 3]).expect("a file");
    let report = json(&poseaudit(&["audit", &path.display().to_string(), "--format", "json"]));
    assert_eq!(codes(&report), ["ING001"]);
}

#[test]
fn a_wrong_call_exits_with_2() {
    for args in [
        &["audit"][..],
        &["audit", CLEAN, "--select", "FOO001"],
        &["audit", CLEAN, "--format", "yaml"],
        &["audit", CLEAN, "--max-latency", "-1"],
        &["audit", CLEAN, "--declare", "/tcp"],
        &["audit", CLEAN, "--parquet", "Cargo.toml"],
        &["audit", CLEAN, "--robot", "no/such.urdf"],
        &["audit", CLEAN, "--tip", "no_such_link"],
        &["audit", CLEAN, "--calibration", "no/such.yaml"],
        &["audit", CLEAN, "--corrections", "no/such.toml"],
        &["audit", CLEAN, "--fix", "Cargo.toml"],
        &["explain", "LAT999"],
        &["no-such-command"],
    ] {
        let output = poseaudit(args);
        assert_eq!(status(&output), 2, "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).starts_with("error: "), "{args:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty(), "{args:?}");
    }
}

#[test]
fn an_invalid_calibration_gives_one_line_with_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("arm.yaml").display().to_string();
    fs::write(&path, "kinematics:\n  shoulder: {x: 0}\n").expect("a file");
    assert_refused(&["audit", CLEAN, "--calibration", &path], 2, "arm.yaml:2: not a calibration");
}

#[test]
fn an_unknown_rule_suggests_the_nearest() {
    assert_refused(&["explain", "lat9"], 2, "did you mean LAT001");
    assert_refused(&["explain", "zeros"], 2, "unknown rule `zeros`");
    assert_refused(&["explain", "joint"], 2, "ZER001 (joint-zero)");
}

#[test]
fn every_rule_is_listed_and_explained() {
    let rules = poseaudit(&["rules"]);
    assert_eq!(status(&rules), 0);
    for rule in poseaudit::checks::registry() {
        assert!(stdout(&rules).contains(rule.code), "{}", rule.code);
        let explained = poseaudit(&["explain", &rule.code.to_lowercase()]);
        assert_eq!(status(&explained), 0);
        assert!(stdout(&explained).starts_with(rule.code), "{}", stdout(&explained));
        let by_name = poseaudit(&["explain", rule.name]);
        assert_eq!(stdout(&by_name), stdout(&explained), "{}", rule.name);
        assert!(stdout(&explained).contains("\nWhen it misleads\n"), "{}", rule.code);
    }
}

#[test]
fn a_clean_log_passes() {
    let output = poseaudit(&["audit", CLEAN]);
    assert_eq!(status(&output), 0, "{}", stdout(&output));
    assert!(stdout(&output).contains("\nPASS "), "{}", stdout(&output));
    assert!(!stdout(&output).contains('\u{1b}'), "colours belong to terminals");
}

#[test]
fn a_faulty_log_fails_unless_its_rules_are_deselected() {
    let output = poseaudit(&["audit", FAULTY, "--format", "json"]);
    assert_eq!(status(&output), 1, "{}", stdout(&output));
    assert_eq!(json(&output)["verdict"], "fail");
    let never = poseaudit(&["audit", FAULTY, "--fail-on", "never"]);
    assert_eq!(status(&never), 0, "{}", stdout(&never));
    let ignored = poseaudit(&["audit", FAULTY, "--select", "ING", "--format", "json"]);
    assert_eq!(status(&ignored), 0, "{}", stdout(&ignored));
}

#[test]
fn messages_are_clauses_with_a_number() {
    let report = json(&poseaudit(&["audit", FAULTY, "--format", "json"]));
    let findings = report["findings"].as_array().expect("a list");
    assert!(!findings.is_empty());
    for finding in findings {
        let message = finding["message"].as_str().expect("a text");
        assert!(!message.starts_with(char::is_uppercase), "{message}");
        assert!(!message.ends_with('.'), "{message}");
        assert!(message.contains(|c: char| c.is_ascii_digit()), "{message}");
        assert!(!message.contains('\n'), "{message}");
        assert!(finding["fix"].as_str().is_some_and(|fix| !fix.is_empty()), "{message}");
        let title = finding["title"].as_str().expect("a text");
        assert!(!title.contains(|c: char| c.is_ascii_digit()) && !title.ends_with('.'), "{title}");
    }
}

#[test]
fn the_json_report_has_the_documented_keys_in_order() {
    let report = json(&poseaudit(&["audit", "fixtures/goal.mcap", "--format", "json"]));
    let keys = |value: &Value| -> Vec<String> {
        value.as_object().expect("an object").keys().cloned().collect()
    };
    assert_eq!(
        keys(&report),
        [
            "schema", "tool", "verdict", "error", "log", "robots", "streams", "checks", "findings",
            // Not part of the contract, so they come last.
            "observability", "workspace", "plans"
        ]
    );
    assert_eq!(
        keys(&report["findings"][0]),
        [
            "code", "severity", "title", "message", "subject", "estimate", "evidence", "fix",
            "start_ns", "end_ns"
        ]
    );
    assert_eq!(keys(&report["log"]), ["files", "messages", "start_ns", "end_ns", "duration_s"]);
    assert!(report["log"]["start_ns"].is_string());
}

#[test]
fn the_same_log_gives_the_same_report() {
    let once = poseaudit(&["audit", FAULTY, "--format", "json"]);
    assert_eq!(once.stdout, poseaudit(&["audit", FAULTY, "--format", "json"]).stdout);
}

#[test]
fn a_report_is_written_to_the_output_path() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("reports/today/clean.txt");
    let output = poseaudit(&["audit", CLEAN, "--output", &path.display().to_string()]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    assert!(output.stdout.is_empty());
    let text = fs::read_to_string(&path).expect("the report");
    assert!(text.contains("PASS") && !text.contains('\u{1b}'), "{text}");
}

#[test]
fn corrections_are_written_and_applied() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder_of_fixes = folder.path().join("to/mend").display().to_string();
    let plain = poseaudit(&["audit", FAULTY]);
    let output = poseaudit(&["audit", FAULTY, "--fix", &folder_of_fixes]);
    assert_eq!((status(&output), &output.stdout), (1, &plain.stdout), "{}", stderr(&output));
    let file = format!("{folder_of_fixes}/corrections.toml");
    let output = poseaudit(&["audit", FAULTY, "--corrections", &file]);
    assert_eq!(status(&output), 0, "{}", stdout(&output));
    assert!(stdout(&output).contains("corrected: elbow_joint by an offset of 0.6°"));
    assert!(stdout(&output).contains("its latency of 15 ms"), "{}", stdout(&output));
    // /tf was published from the uncorrected joint states.
    let report = json(&poseaudit(&["audit", FAULTY, "--corrections", &file, "--format", "json"]));
    let rows = report["checks"].as_array().expect("rows");
    let of_tf = rows.iter().find(|row| row["code"] == "MDL001" && row["subject"]["topic"] == "/tf");
    let row = of_tf.expect("a row");
    assert!(row["reason"].as_str().is_some_and(|why| why.contains("before their correction")));
    assert!(row["estimate"]["value"].as_f64().is_some_and(|m| m < 1e-4), "{row}");
    assert!(row["evidence"]["as_logged"]["most_m"].as_f64().is_some_and(|m| m < 1e-3), "{row}");
    fs::write(&file, "schema = \"poseaudit.corrections/1\"\n[[jiont]]\n").expect("a file");
    assert_refused(
        &["audit", FAULTY, "--corrections", &file],
        2,
        "corrections.toml:2: invalid corrections",
    );
}

#[test]
fn a_required_rule_that_is_inconclusive_fails_the_call() {
    let args = ["audit", CLEAN, "--select", "ING", "--require", "LAT001"];
    let output = poseaudit(&[&args[..], &["--format", "json"]].concat());
    assert_eq!(status(&output), 1, "{}", stderr(&output));
    assert!(stderr(&output).contains("--require LAT001"), "{}", stderr(&output));
    // The last line of the text explains the status.
    let output = poseaudit(&["audit", "fixtures/gimbal.mcap", "--require", "LAT002"]);
    assert_eq!(status(&output), 1, "{}", stdout(&output));
    let last = stdout(&output).lines().last();
    assert_eq!(last, Some("  exit status 1: --require LAT002 is inconclusive"));
    assert!(!stderr(&output).contains("--require"), "{}", stderr(&output));
}

#[test]
fn an_inconclusive_report_ends_with_its_exit_status() {
    let audit = |options: &[&str]| {
        let output = poseaudit(&[&["audit", "fixtures/gimbal.mcap"], options].concat());
        let last = stdout(&output).lines().last().unwrap_or_default().to_owned();
        (status(&output), last)
    };
    let (status, last) = audit(&[]);
    assert!(status == 0 && last.starts_with("  exit status 0: an inconclusive run"), "{last}");
    let failing = (1, "  exit status 1: --fail-on inconclusive".to_owned());
    assert_eq!(audit(&["--fail-on", "inconclusive"]), failing);
    let output = poseaudit(&["audit", "fixtures/shake.mcap", "--fail-on", "never"]);
    assert!(stdout(&output).contains("  exit status 0: "), "{}", stdout(&output));
}

#[test]
fn a_terminal_shows_the_whole_report() {
    for (log, most) in [(FAULTY, 25), (CLEAN, 12)] {
        let output = poseaudit(&["audit", log]);
        assert!(stdout(&output).lines().count() <= most, "{}", stdout(&output));
        let verdict = stdout(&output).split("\n\n").last().unwrap_or_default();
        assert!(verdict.starts_with("FAIL ") || verdict.starts_with("PASS "), "{verdict}");
        let verbose = poseaudit(&["audit", log, "-v"]);
        for label in ["\npassed ", "\nskipped ", "\nworkspace "] {
            assert!(!stdout(&output).contains(label), "{}", stdout(&output));
            assert!(stdout(&verbose).contains(label), "{label}: {}", stdout(&verbose));
        }
    }
}

#[test]
fn too_little_rotation_for_hand_eye_fails_only_if_hand_eye_is_required() {
    let few_views = ["audit", "fixtures/few_views.mcap", "--format", "json"];
    let severity = |args: &[&str]| {
        let report: Value = serde_json::from_slice(&poseaudit(args).stdout).expect("a report");
        let findings = report["findings"].as_array().expect("a list");
        let found = findings.iter().find(|finding| finding["code"] == "HEC002");
        found.expect("HEC002")["severity"].clone()
    };
    assert_eq!(severity(&few_views), "info");
    for code in ["HEC", "HEC001", "HEC002"] {
        assert_eq!(severity(&[&few_views[..], &["--require", code]].concat()), "warning");
    }
}

#[test]
fn info_lists_topics_and_roles() {
    let output = poseaudit(&["info", CLEAN]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    for part in ["/joint_states", "joints", "/tf_static", "/imu/data", "imu"] {
        assert!(stdout(&output).contains(part), "{part} is not in\n{}", stdout(&output));
    }
}

fn codes(report: &Value) -> Vec<&str> {
    let findings = report["findings"].as_array().expect("a list");
    findings.iter().filter_map(|finding| finding["code"].as_str()).collect()
}

#[test]
fn the_demo_prints_json() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path().display().to_string();
    let output = poseaudit(&["demo", &dir, "--format", "json"]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(report["schema"], "poseaudit.report/1");
    assert_eq!(report["verdict"], "fail");
    let recovered = stderr(&output).lines().filter(|line| line.starts_with("recovered"));
    assert_eq!(recovered.count(), 4, "{}", stderr(&output));
}

#[test]
fn the_demo_of_a_pair_finds_latency_and_slip_within_their_intervals() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path().display().to_string();
    let output = poseaudit(&["demo", "--pair", &dir, "--format", "json"]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    let recovered = stderr(&output).lines().filter(|line| line.starts_with("recovered"));
    assert_eq!(recovered.count(), 2, "{}", stderr(&output));
    let report = json(&output);
    let findings = report["findings"].as_array().expect("a list");
    let faults = findings.iter().filter(|finding| finding["severity"] != "info");
    let found: Vec<(&str, bool)> = faults
        .map(|finding| {
            let code = finding["code"].as_str().expect("a code");
            let planted = if code == "LAT001" { 0.024 } else { 0.005 };
            let end = |at: usize| finding["estimate"]["ci95"][at].as_f64().expect("a number");
            (code, (end(0)..=end(1)).contains(&planted))
        })
        .collect();
    assert_eq!(found, [("LAT001", true), ("FRM003", true)], "{findings:#?}");
    assert!(folder.path().join("pair.mcap").is_file());
}

#[cfg(unix)]
#[test]
fn the_command_for_datasets_is_the_program_of_the_python_package() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let call = |arguments: &[&str]| {
        let mut program = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
        let program = program.arg("dataset").args(arguments).env("PATH", folder.path());
        program.output().expect("the program runs")
    };
    let missing = call(&["runs"]);
    assert_eq!(status(&missing), 2);
    assert!(stderr(&missing).contains("pip install poseaudit"), "{}", stderr(&missing));
    let program = folder.path().join("poseaudit-dataset");
    fs::write(&program, "#!/bin/sh\necho \"$@\"\nexit 3\n").expect("a program");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("permissions");
    let called = call(&["a/b", "--robot", "so101", "--out=x"]);
    assert_eq!((status(&called), stdout(&called)), (3, "a/b --robot so101 --out=x\n"));
}

#[test]
fn a_pose_is_printed_in_every_convention() {
    let pose = "243.69 -249.04 618.32 149.49 -12.78 72.64";
    let output = poseaudit(&["pose", "--all", "--from", "euler:xyz", "--deg", "--mm", pose]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    for part in ["FANUC", "KUKA", "Rotation.from_euler(\"xyz\"", "euler:zyx", "0.243690"] {
        assert!(stdout(&output).contains(part), "{part}: {}", stdout(&output));
    }
    let report =
        json(&poseaudit(&["pose", "-0.1 0 0.2 0 0 -90", "--from", "kuka", "--format", "json"]));
    assert_eq!(report["schema"], "poseaudit.pose/1");
    assert_eq!(report["read_as"]["convention"], "euler:ZYX");
    assert_eq!(report["conventions"].as_array().map(Vec::len), Some(36));
    let unity = &report["worlds"][0];
    assert_eq!((&unity["who"], &unity["xyz_m"][1]), (&"Unity".into(), &0.0002.into()));
}

#[test]
fn one_pose_is_printed_in_twelve_lines_whose_columns_never_collide() {
    for text in [
        "p[-143.5, -435.2, 288.1, 1.2, -1.7, 0.6]",
        "array([0.3, 0.1, -0.5, 0., 0., 0., 1.])",
        "0.3 0.1 0.5 0.2 0.5 -0.1",
        "0 -1 0 0.3  1 0 0 0.1  0 0 1 0.5  0 0 0 1",
    ] {
        let output = poseaudit(&["pose", text]);
        assert_eq!(status(&output), 0, "{}", stderr(&output));
        assert!(stdout(&output).lines().count() <= 12, "{}", stdout(&output));
        let all = poseaudit(&["pose", "--all", "--from", "rotvec,m,rad", "1e6 -2e6 3e6 0 0 -3.1"]);
        for number in ["1000000.000000", "-2000000.000000", "-2000000000.000", "177.6169°"] {
            let is_alone = |line: &str| line.split_whitespace().any(|word| word == number);
            assert!(stdout(&all).lines().any(is_alone), "{number}: {}", stdout(&all));
        }
    }
    let literal = poseaudit(&["pose", "p[-143.5, -435.2, 288.1, 1.2, -1.7, 0.6]"]);
    assert!(stdout(&literal).contains("no arm reaches 541.3 m; if the"), "{}", stdout(&literal));
    let far = poseaudit(&["pose", "p[1.2, -1.1, 0.3, 1.2, -1.7, 0.6]", "--robot", "ur5e"]);
    assert!(stderr(&far).contains("1.655 m from the origin, but ur5e reaches"), "{}", stderr(&far));
    let near = poseaudit(&["pose", "p[0.2, -0.1, 0.3, 1.2, -1.7, 0.6]", "--robot", "ur5e"]);
    assert_eq!(stderr(&near), "");
}

#[test]
fn two_poses_are_reconciled() {
    let call = [
        "pose",
        "--is",
        "0.246 -0.249 0.619 0.170 0.472 -0.074 0.862",
        "--but",
        "243.69 -249.04 618.32 149.49 -12.78 72.64",
    ];
    let output = poseaudit(&call);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    assert!(
        stdout(&output).starts_with("reconciled      residual 0.22°, 2.41 mm"),
        "{}",
        stdout(&output)
    );
    let report = json(&poseaudit(&[&call[..], &["--robot", "ur10e", "--format", "json"]].concat()));
    assert_eq!(report["verdict"], "reconciled");
    let best = &report["hypotheses"][0];
    assert_eq!(best["but"]["convention"], "euler:xyz");
    assert_eq!(best["tool"]["is"], "flange");
    // Two poses need no options.
    assert_eq!(stdout(&poseaudit(&["pose", call[2], call[4]])), stdout(&output));
}

#[test]
fn the_remaining_offset_of_two_poses_is_printed_first_and_no_match_exits_with_1() {
    let tool = ["pose", "p[0.3, 0.1, 0.5, 1.2, -1.7, 0.6]", "0.3 0.1 0.62 1.2 -1.7 0.6"];
    let output = poseaudit(&[&tool[..], &["--but-as", "ur"]].concat());
    assert_eq!(status(&output), 1, "{}", stderr(&output));
    let text = stdout(&output);
    assert!(text.starts_with("orientations agree, 120.0 mm along base z\n"), "{text}");
    let nothing = ["pose", "0.3 0.1 0.5 0.5 0.5 0.5 0.5", "0.9 -0.1 0.2 0.1 0.7 0.1 0.7"];
    let output = poseaudit(&[&nothing[..], &["--is-as", "ros", "--but-as", "ros"]].concat());
    assert_eq!(status(&output), 1, "{}", stdout(&output));
}

#[test]
fn numbers_need_no_quotes_and_one_pose_refuses_options_for_two() {
    let bare = ["pose", "0.3,", "0.1,", "-0.5", "0", "0", "0", "1", "--from", "ros"];
    assert_eq!(status(&poseaudit(&bare)), 0, "{}", stderr(&poseaudit(&bare)));
    assert_refused(&["pose", "0 0 1 0 0 0 1", "--is-as", "ur"], 2, "--is-as");
}

#[test]
fn an_invalid_pose_gives_one_line() {
    assert_refused(&["pose", "1 2 3 4 5"], 2, "5 numbers are not a pose");
    assert_refused(
        &["pose", "1 0 0  0 0.9 0  0 0 1"],
        2,
        "not orthonormal: max |RᵀR − I| is 1.90e-1",
    );
    assert_refused(&["pose", "1 2 3", "--from", "euler:xxz"], 2, "--from");
    assert_refused(&["pose"], 2, "no pose was given");
    assert_refused(&["pose", "--pairs", "no/such.csv"], 2, "no/such.csv");
}

#[test]
fn a_log_in_place_of_a_command_suggests_audit() {
    assert_refused(&[FAULTY], 2, "audit it with `poseaudit audit fixtures/faulty.mcap`");
}

#[test]
fn a_folder_of_several_runs_suggests_the_fleet() {
    let runs = tempfile::tempdir().expect("a folder");
    let path = runs.path().display().to_string();
    assert_refused(&["audit", &path], 3, "it is a directory without log files");
    for run in ["monday", "tuesday"] {
        fs::create_dir(runs.path().join(run)).expect("a folder");
        fs::copy(CLEAN, runs.path().join(run).join("run.mcap")).expect("a copy");
    }
    assert_refused(&["audit", &path], 3, "poseaudit fleet FOLDER --out DIR");
    fs::copy(CLEAN, runs.path().join("one.mcap")).expect("a copy");
    fs::copy(CLEAN, runs.path().join("other.mcap")).expect("a copy");
    assert_refused(&["audit", &path], 3, "poseaudit fleet FOLDER --out DIR");
}

#[test]
fn findings_that_need_no_arm_fail_a_log_without_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("poses.csv");
    // One of seven rows is lost.
    let row =
        |at: usize| format!("{:.3},{:.6},0.1,0.2\n", 0.01 * at as f64, (0.02 * at as f64).sin());
    let rows: String = (0..900).filter(|at| at % 7 != 3).map(row).collect();
    fs::write(&path, "time,x,y,z\n".to_owned() + &rows).expect("a file");
    let output = poseaudit(&["audit", &path.display().to_string()]);
    let text = stdout(&output);
    assert_eq!(status(&output), 1, "{text}");
    assert!(text.contains("TIM002") && text.contains("NO AUDIT"), "{text}");
    assert!(text.contains("exit status 1: the findings above need no arm"), "{text}");
}

#[test]
fn the_recording_command_is_the_first_line_of_record_list() {
    for source in ["ur5e", CLEAN] {
        let output = poseaudit(&["record-list", source]);
        let first = stdout(&output).lines().next().unwrap_or_default();
        assert!(
            first.starts_with("ros2 bag record ") && first.contains("/joint_states"),
            "{first}"
        );
    }
}

#[test]
fn options_of_all_commands_are_below_those_of_the_command() {
    for command in ["audit", "pose", "fk", "watch", "record-list"] {
        let help = poseaudit(&[command, "--help"]);
        let place = |option: &str| stdout(&help).find(option).expect(option);
        let last = ["--quiet", "--verbose", "--color"].map(place);
        let own = place("--format");
        assert!(own < place("Messages:") && own < last[0], "{command}: {}", stdout(&help));
    }
}

#[test]
fn tables_are_written_into_a_new_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let tables = folder.path().join("made/tables");
    let output = poseaudit(&["audit", FAULTY, "--parquet", &tables.display().to_string()]);
    assert_eq!(status(&output), 1, "{}", stderr(&output));
    for name in ["aligned", "reach_map", "reached_poses", "joints", "findings", "checks"] {
        let bytes = fs::read(tables.join(format!("{name}.parquet"))).expect(name);
        assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"), "{name}");
    }
}

#[test]
fn forward_kinematics_of_one_configuration_and_of_a_file_agree() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let q = ["0.1", "-1.2", "1.4", "-1", "-1.5", "0.3"];
    fs::write(path("q.csv"), format!("# one row\n{}\n", q.join(","))).expect("a file");
    let one = json(&poseaudit(&[&["fk", "ur5e", "--format", "json"], &q[..]].concat()));
    let many = ["fk", "ur5e", "--file", &path("q.csv"), "--output", &path("poses.csv")];
    assert_eq!(status(&poseaudit(&many)), 0);
    let text = fs::read_to_string(path("poses.csv")).expect("the poses");
    let row = text.lines().nth(1).expect("a row").split(',');
    let numbers: Vec<f64> = row.map(|cell| cell.parse().expect("a number")).collect();
    for (axis, xyz) in one["xyz_m"].as_array().expect("three numbers").iter().enumerate() {
        assert!((xyz.as_f64().expect("a number") - numbers[6 + axis]).abs() < 1e-12, "{text}");
    }
    let degrees = ["fk", "ur5e", "0", "-90", "90", "0", "0", "0"];
    let warned = poseaudit(&degrees);
    assert_eq!(status(&warned), 0);
    assert!(stderr(&warned).starts_with("warning: a joint at 90 rad"), "{}", stderr(&warned));
    assert_eq!(stderr(&poseaudit(&[&degrees[..], &["--deg"]].concat())), "");
    assert_refused(&["fk", "ur5e", "1", "2"], 2, "6 joints");
    assert_refused(&["fk", "ur5x", "1"], 2, "ur5");
    assert_refused(&["robots", "ur5x"], 2, "ur5");
}

#[test]
fn a_transform_of_the_log_is_looked_up_as_tf2_does() {
    let at = |time: &str| {
        json(&poseaudit(&["tf", CLEAN, "base", "tool0", "--at", time, "--format", "json"]))
    };
    let numbers = |row: &Value, key: &str| -> Vec<f64> {
        let list = row[key].as_array().expect("numbers").iter();
        list.map(|number| number.as_f64().expect("a number")).collect()
    };
    let there = at("+3");
    assert_eq!(there["how"], "interpolated");
    assert!(there["age_s"].as_f64().is_some_and(|age_s| (0.0..0.04).contains(&age_s)), "{there}");
    let back = ["tf", CLEAN, "tool0", "base", "--at", "+3", "--format", "json"];
    let back = json(&poseaudit(&back));
    // The inverse pose has the same distance: x' = −Rᵀ·x.
    let length = |row: &Value| numbers(row, "xyz_m").iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!((length(&there) - length(&back)).abs() < 1e-12);
    let refused = |time: &str, part: &str| {
        assert_refused(&["tf", CLEAN, "base", "tool0", &format!("--at={time}")], 2, part);
    };
    refused("+300", "--at: +300.000 s is outside the log's transforms, which cover +0.");
    refused("1780000300", "which cover +0.");
    let negative = poseaudit(&["tf", CLEAN, "base", "tool0", "--at=-100"]);
    assert_eq!(status(&negative), 2);
    assert!(stderr(&negative).contains("expected +S from the start"), "{}", stderr(&negative));
    let followed = poseaudit(&["tf", CLEAN, "base", "tool0", "--follow", "2"]);
    assert!(stdout(&followed).lines().count() > 20, "{}", stdout(&followed));
    assert_refused(&["tf", CLEAN, "base", "tool"], 2, "tool0");
}

#[test]
fn the_html_report_plots_the_evidence_of_each_finding() {
    let args = ["audit", FAULTY, "--format", "html"];
    let (output, again) = (poseaudit(&args), poseaudit(&args));
    assert_eq!(status(&output), 1);
    assert_eq!(output.stdout, again.stdout, "two audits of one log differ");
    let page = stdout(&output);
    let data = page.split("<script id=\"data\" type=\"application/json\">").nth(1);
    let data = data.and_then(|rest| rest.split("</script>").next()).expect("the plots' data");
    let plots: Value = serde_json::from_str(data).expect("JSON");
    let plots = plots.as_object().expect("plots").iter();
    // Plots of streams without findings have other ids.
    let plots: Vec<&Value> =
        plots.filter(|(id, _)| id.starts_with("plot-")).map(|(_, plot)| plot).collect();
    // The residual is smallest at the estimated latency.
    let valley = plots.iter().find(|plot| plot["x_label"] == "latency, ms").expect("a valley");
    let numbers = |values: &Value| -> Vec<f64> {
        values.as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
    };
    let (x, left) = (numbers(&valley["x"]), numbers(&valley["series"][0]["values"]));
    let least = (0..left.len()).min_by(|&a, &b| left[a].total_cmp(&left[b])).expect("values");
    let found = valley["mark"]["at"].as_f64().expect("a mark");
    assert!((x[least] - found).abs() < 0.5 && (found - 15.0).abs() < 0.1, "{} {found}", x[least]);
    assert!(left[0] > 20.0 * left[least], "{left:?}");
    // The explanation reduces the error.
    let most = |plot: &Value, at: usize| {
        numbers(&plot["series"][at]["values"]).into_iter().fold(0.0, f64::max)
    };
    let over_time = plots.iter().filter(|plot| plot["series"].as_array().map(Vec::len) == Some(2));
    let mut over_time =
        over_time.filter(|plot| plot["series"][0]["label"] == "as logged").peekable();
    assert!(over_time.peek().is_some());
    for plot in over_time {
        assert!(most(plot, 1) < 0.1 * most(plot, 0), "{}", plot["y_label"]);
    }
    // The faulty joint stands out.
    let offsets = page.split("Zero offsets of all joints").nth(1).expect("the offsets");
    let rows: Vec<&str> =
        offsets.split("</table>").next().unwrap_or_default().split("<tr").collect();
    let faults: Vec<&&str> = rows.iter().filter(|row| row.contains("class=\"fault\"")).collect();
    assert!(rows.len() == 7 && faults.len() == 1 && faults[0].contains("elbow_joint"), "{rows:?}");
}

#[test]
fn the_command_line_overrides_the_config() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("poseaudit.toml");
    let config = path.display().to_string();
    fs::write(&path, "fail_on = \"never\"\nselect = [\"LAT\"]\n").expect("a file");
    let output = poseaudit(&["audit", FAULTY, "--config", &config, "--format", "json"]);
    let report = json(&output);
    assert_eq!((status(&output), codes(&report)), (0, vec!["LAT001"]));
    let over = ["audit", FAULTY, "--config", &config, "--fail-on", "error", "--select", "ZER001"];
    let output = poseaudit(&[&over[..], &["--format", "json"]].concat());
    assert_eq!((status(&output), codes(&json(&output))), (1, vec!["ZER001"]));
    fs::write(&path, "\nfail_onn = \"never\"\n").expect("a file");
    let message = format!("{config}:2: unknown key `fail_onn`: did you mean `fail_on`?");
    assert_refused(&["audit", CLEAN, "--config", &config], 2, &message);
    assert_refused(&["audit", CLEAN, "--config", "no/such.toml"], 2, "no/such.toml");
}

#[test]
fn init_writes_a_config_and_does_not_overwrite_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("new/poseaudit.toml").display().to_string();
    let output = poseaudit(&["init", CLEAN, "--output", &config]);
    assert_eq!((status(&output), stdout(&output)), (0, ""));
    let written = fs::read_to_string(&config).expect("the config");
    assert_eq!(stdout(&poseaudit(&["init", CLEAN])), written);
    let output = poseaudit(&["audit", CLEAN, "--config", &config]);
    assert_eq!(status(&output), 0, "{}", stdout(&output));
    assert_refused(&["init", CLEAN, "--output", &config], 2, "not overwritten");
    assert!(written.lines().count() < 45 && !written.contains("[rules."), "{written}");
    let all = poseaudit(&["init", CLEAN, "--all"]);
    assert!(stdout(&all).contains("# [rules.LAT001]"), "{}", stdout(&all));
    let schema = json(&poseaudit(&["init", "--schema"]));
    assert_eq!(schema["title"], "poseaudit.toml");
}
