//! `poseaudit plan`, the motion to record, end to end.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::program::{poseaudit, status, stderr, stdout};

const AROUND: &str = "--around=0,-1.57,1.57,-1.2,-1.57,0.3";

fn write_plan(folder: &Path, name: &str, purpose: &str) -> (String, String) {
    let path = folder.join(name).display().to_string();
    let output = poseaudit(&[
        "plan", "ur5e", AROUND, "--for", purpose, "--seconds", "20", "--output", &path,
    ]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    (path, stdout(&output).to_owned())
}

fn check_motion(path: &str, more: &[&str]) -> (i32, Value) {
    let call = [&["plan", "ur5e", "--check", path, "--format", "json"], more].concat();
    let output = poseaudit(&call);
    let report = serde_json::from_slice(&output.stdout);
    (status(&output), report.unwrap_or_else(|error| panic!("{error}: {}", stderr(&output))))
}

#[test]
fn every_plan_format_is_read_back_unchanged() {
    let folder = tempfile::tempdir().expect("a folder");
    let half_widths = ["csv", "json", "yaml"].map(|form| {
        let (path, text) = write_plan(folder.path(), &format!("motion.{form}"), "latency");
        assert!(text.contains("NO COLLISION CHECKING"), "{text}");
        let (status, checked) = check_motion(&path, &["--for", "latency"]);
        assert_eq!(status, 0, "{checked}");
        assert_eq!(checked["beyond"], Value::Array(Vec::new()));
        assert_eq!(checked["too_near"], Value::Null);
        checked["expected"][0]["half_95"].as_f64().expect("a number")
    });
    let text = fs::read_to_string(folder.path().join("motion.json")).expect("the plan");
    let plan: Value = serde_json::from_str(&text).expect("JSON");
    let promised = plan["expected"][0]["half_95"].as_f64().expect("a number");
    for half_width in half_widths {
        assert!((half_width / promised - 1.0).abs() < 0.02, "{half_width} {promised}");
    }
    assert!(plan["gain"]["over_random_phases"].as_f64() > Some(1.5), "{}", plan["gain"]);
    assert!(plan["gain"]["over_one_joint_at_a_time"].as_f64() > Some(1.5), "{}", plan["gain"]);
}

#[test]
fn the_same_call_writes_the_same_plan() {
    let folder = tempfile::tempdir().expect("a folder");
    let [one, other] = ["one.csv", "other.csv"]
        .map(|name| fs::read(write_plan(folder.path(), name, "zeros").0).expect("a motion"));
    assert_eq!(one, other);
}

#[test]
fn a_motion_beyond_joint_limits_fails_and_names_the_joint() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fast.csv").display().to_string();
    let mut text =
        "t,shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,\
                    wrist_3_joint\n"
            .to_owned();
    for row in 0..400 {
        let t_s = f64::from(row) * 0.01;
        let pan = 1.2 * (4.0 * t_s).sin();
        text += &format!("{t_s},{pan},-1.57,1.57,-1.2,-1.57,0.3\n");
    }
    fs::write(&path, text).expect("a file");
    let (status, report) = check_motion(&path, &[]);
    assert_eq!(status, 1);
    let beyond = report["beyond"].as_array().expect("a list");
    let found: Vec<_> =
        beyond.iter().map(|it| (it["joint"].as_str(), it["what"].as_str())).collect();
    let pan = Some("shoulder_pan_joint");
    assert_eq!(found, [(pan, Some("speed")), (pan, Some("acceleration"))]);
    // The model's own speed limit applies in any case.
    assert_eq!(check_motion(&path, &["--acceleration", "25", "--speed", "3"]).0, 1);
    let folded = poseaudit(&["plan", "ur5e", "--check", &path, "--floor", "0.5"]);
    assert!(status == 1 && stdout(&folded).contains("TOO CLOSE"), "{}", stdout(&folded));
}

#[test]
fn an_impossible_plan_gives_one_line_and_exits_with_2() {
    for (call, part) in [
        (&["plan", "ur5e", "--around", "0,-1.57,3.5,-1.2,-1.57,0"][..], "elbow_joint is at 3.5000"),
        (&["plan", "ur5e", "--around", "0,0,0"], "given for 6 joints"),
        (&["plan", "ur5e", AROUND, "--floor", "0.4"], "below the floor"),
        (&["plan", "panda", "--around=0,0.4,0,-1.8,0,2.2,0.8", "--format", "urscript"], "URScript"),
        (&["plan", "no_such_arm", AROUND], "no_such_arm"),
        (&["plan", "ur5e", "--check", "Cargo.toml"], "Cargo.toml"),
        (&["plan", "ur5e", "--check", "no/such.csv"], "no/such.csv"),
    ] {
        let output = poseaudit(call);
        let line = stderr(&output).trim_end();
        assert_eq!(status(&output), 2, "{call:?}: {line}");
        assert!(
            line.starts_with("error: ") && !line.contains('\n') && line.contains(part),
            "{line}"
        );
    }
}

#[test]
fn a_urscript_program_starts_only_at_the_planned_position() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, _) = write_plan(folder.path(), "zeros.script", "zeros");
    let text = fs::read_to_string(path).expect("a program");
    for part in ["# NO COLLISION CHECKING", "def poseaudit_plan():", "halt", "servoj(posture(t)"] {
        assert!(text.contains(part), "{part}");
    }
    let opened = ["def ", "while ", "if "]
        .map(|word| text.lines().filter(|line| line.trim_start().starts_with(word)).count());
    let closed = text.lines().filter(|line| line.trim() == "end").count();
    assert_eq!(opened.iter().sum::<usize>(), closed);
}

#[test]
fn inconclusive_audits_suggest_plan_calls_that_run() {
    let output = poseaudit(&["audit", "fixtures/few_views.mcap", "--fail-on", "never"]);
    let text = stdout(&output).to_owned();
    let calls: Vec<&str> =
        text.lines().filter_map(|line| line.find("poseaudit plan").map(|at| &line[at..])).collect();
    let output = poseaudit(&["audit", "fixtures/few_views.mcap", "--format", "json"]);
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
    let plans = report["plans"].as_array().expect("a list");
    let commands: Vec<&str> = plans.iter().filter_map(|plan| plan["command"].as_str()).collect();
    // The first call is printed completely, the others by their purpose.
    assert_eq!(calls, [commands[0]], "{text}");
    for (at, call) in commands.iter().enumerate() {
        // Once for each arm and purpose.
        assert!(!commands[..at].contains(call), "{text}");
        let purpose = call.split(" --for ").nth(1).expect("a purpose");
        assert!(text.contains(&format!("--for {purpose}")), "{text}");
        let words: Vec<&str> = call.split(' ').skip(1).chain(["--seconds", "10"]).collect();
        let output = poseaudit(&words);
        assert_eq!(status(&output), 0, "{call}: {}", stderr(&output));
        assert!(stdout(&output).contains("expected ± (95 %)"), "{call}");
    }
    // Every code in a plan is undetermined.
    for plan in plans {
        for code in plan["codes"].as_array().expect("codes") {
            let mut rows = report["checks"].as_array().expect("rows").iter();
            assert!(
                rows.any(|row| row["code"] == *code && row["status"] == "inconclusive"),
                "{code}"
            );
        }
    }
}
