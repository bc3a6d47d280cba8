//! Logs with joint names that differ from the model.

use std::fs::File;
use std::path::PathBuf;

use poseaudit::finding::Status;
use poseaudit::report::{Report, Trouble, Verdict};
use poseaudit::run::RunOptions;
use poseaudit::synth::{Commands, Motion, Noise, Scenario, write_cell};
use poseaudit::{Options, audit};
use tempfile::TempDir;

/// A UR5e with joints named `before` and a number; its log has no description, and a foreign frame.
fn ur5e(before: &str) -> Scenario {
    let run = Scenario::ur5e();
    rename_joints(run, |joint| format!("{before}{}", joint + 1))
}

/// A run with renamed joints.
fn rename_joints(run: Scenario, name: impl Fn(usize) -> String) -> Scenario {
    let own = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let renamed = run.robot.with_joints_renamed(|joint| {
        let at = own.iter().position(|own| joint == format!("{own}_joint"));
        at.map_or(joint.to_owned(), &name)
    });
    let mut run = Scenario { robot: renamed.expect("distinct names"), ..run };
    (run.has_description, run.tf.timing.rate_hz, run.tf.has_static) = (false, 0.0, false);
    run.imu.timing.rate_hz = 0.0;
    run.pose.frame_id = "cell".to_owned();
    run
}

fn audit_runs(runs: &[Scenario], options: RunOptions) -> Result<Report, Trouble> {
    let folder = TempDir::new().expect("a folder");
    let log: PathBuf = folder.path().join("run.mcap");
    write_cell(runs, File::create(&log).expect("a file"), None).expect("a log");
    let options = Options { logs: vec![log], run: options, ..Options::default() };
    Ok(audit(&options)?.report)
}

fn with_robot(name: &str) -> RunOptions {
    RunOptions { robots: vec![name.into()], ..RunOptions::default() }
}

/// How the report describes the identification of the arm; empty without an arm.
fn source_of(report: &Report) -> &str {
    report.robots.first().map_or("", |robot| robot.source.as_str())
}

fn error_text(report: &Report) -> String {
    report.error.as_ref().map_or_else(String::new, ToString::to_string)
}

fn residual_reason(report: &Report) -> &str {
    let row = report.checks.iter().find(|row| row.code == "MDL001").expect("the residual check");
    row.reason.as_deref().unwrap_or_default()
}

#[test]
fn without_a_model_only_the_checks_that_need_one_stay_open() {
    let mut run = ur5e("thumb_");
    run.pose.timing.rate_hz = 0.0;
    run.reference.commands = Commands::Joints;
    (run.reference.timing.rate_hz, run.reference.timing.latency_s) = (50.0, -0.14);
    let report = audit_runs(&[run.clone()], RunOptions::default()).expect("a report");
    assert!(report.error.is_none() && report.verdict == Verdict::Fail, "{report:?}");
    let codes: Vec<&str> = report.findings.iter().map(|found| found.code).collect();
    assert_eq!(codes, ["LAT004"]);
    assert!(residual_reason(&report).contains("pass --robot"), "{}", residual_reason(&report));
    run.reference.timing.latency_s = -0.02;
    let report = audit_runs(&[run.clone()], RunOptions::default()).expect("a report");
    assert_eq!(report.verdict, Verdict::Inconclusive);
    for code in ["LAT004", "VEL001", "MOT002"] {
        let mut rows = report.checks.iter().filter(|row| row.code == code);
        assert!(rows.all(|row| row.status == Status::Pass), "{code}");
    }
}

#[test]
fn an_arm_is_matched_by_joint_order_and_the_evidence_is_listed() {
    let mut run = ur5e("J");
    run.joints.zero_offsets = vec![0.0, 0.0, 0.6_f64.to_radians()];
    let report = audit_runs(&[run], with_robot("ur5e")).expect("a report");
    let source = source_of(&report);
    assert!(source.contains("J1…J6 are shoulder_pan_joint…wrist_3_joint"), "{source}");
    assert!(source.contains("fits within") && source.contains("with a joint zero"), "{source}");
    let zero = report.findings.iter().find(|found| *found.code == *"ZER001").expect("the zero");
    assert_eq!(zero.subject.joint.as_deref(), Some("J3"));
}

/// At rest, free frames fit any arm within the rounding, and so does any joint order.
#[test]
fn an_arm_at_rest_is_identified_by_its_name_only_and_has_no_wrong_order() {
    let mut run = ur5e("joint_");
    (run.motion, run.noise) = (Motion::AtRest, Noise::NONE);
    let report = audit_runs(&[run.clone()], RunOptions::default()).expect("a report");
    let text = error_text(&report);
    assert!(text.contains("does not distinguish") && text.contains("--robot"), "{text}");
    let report = audit_runs(&[run], with_robot("ur5e")).expect("a report");
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn without_a_model_the_only_arm_that_fits_is_used() {
    // An arm of the catalogue also names its joints J1 to J6, but does not fit.
    for prefix in ["axis_", "J"] {
        let report = audit_runs(&[ur5e(prefix)], RunOptions::default()).expect("a report");
        assert_eq!(report.robots[0].name, "ur5e", "{prefix}");
        assert!(source_of(&report).contains("the next best of"), "{}", source_of(&report));
        assert!(report.findings.is_empty(), "{:?}", report.findings);
    }
}

#[test]
fn joint_names_without_numbers_are_matched_in_the_order_that_fits() {
    let names = ["base", "shoulder", "elbow", "wrist_a", "wrist_b", "wrist_c"];
    let run = rename_joints(Scenario::ur5e(), |joint| names[joint].to_owned());
    let report = audit_runs(&[run], with_robot("ur5e")).expect("a report");
    assert!(source_of(&report).contains("base…wrist_c are"), "{}", source_of(&report));
}

#[test]
fn joints_that_do_not_fit_are_an_error_that_names_the_option_to_use() {
    for (robot, part) in [
        ("ur10", "--joint-map J1=shoulder_pan_joint,J2=shoulder_lift_joint"),
        ("ur5", "matched by order, the poses do not fit"),
        ("franka_fer", "joint names differ: the log has J1"),
    ] {
        let report = audit_runs(&[ur5e("J")], with_robot(robot)).expect("a report");
        assert!(
            report.robots.is_empty() && error_text(&report).contains(part),
            "{}",
            error_text(&report)
        );
    }
}

#[test]
fn no_arm_is_guessed_without_poses() {
    let mut run = ur5e("J");
    run.pose.timing.rate_hz = 0.0;
    let report = audit_runs(&[run.clone()], RunOptions::default()).expect("a report");
    assert!(report.robots.is_empty() && report.error.is_none(), "{}", error_text(&report));
    let reason = residual_reason(&report);
    assert!(reason.contains("no robot model matches the joints"), "{reason}");
    // A named robot is matched by numbers without confirmation.
    let report = audit_runs(&[run], with_robot("ur5e")).expect("a report");
    assert!(
        source_of(&report).contains("not confirmed by a pose stream"),
        "{}",
        source_of(&report)
    );
}

#[test]
fn two_arms_are_each_matched_by_their_own_positions() {
    let arm = |side: &str, seed| {
        let mut run = ur5e(&format!("{side}_ax"));
        (run.namespace, run.seed) = (format!("/{side}"), seed);
        run
    };
    let report = audit_runs(&[arm("one", 1), arm("two", 2)], with_robot("ur5e")).expect("a report");
    let names: Vec<&str> = report.robots.iter().map(|robot| robot.name.as_str()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    assert!(names[0] != names[1], "{names:?}");
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn a_joint_map_is_used_with_and_without_a_model() {
    // No name determines this order.
    let names = ["alpha", "beta", "gamma", "delta", "epsilon", "zeta"];
    let run = rename_joints(Scenario::ur5e(), |joint| names[joint].to_owned());
    let own = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let map = |own: &[&str]| {
        let pairs = names.iter().zip(own).map(|(logged, own)| format!("{logged}={own}_joint"));
        pairs.map(|pair| pair.parse().expect("a pair")).collect()
    };
    for robots in [vec!["ur5e".into()], Vec::new()] {
        let options = RunOptions { robots, joint_map: map(&own), ..RunOptions::default() };
        let report = audit_runs(std::slice::from_ref(&run), options).expect("a report");
        assert_eq!(report.robots[0].name, "ur5e");
        assert!(report.findings.is_empty(), "{:?}", report.findings);
    }
    // The caller's mapping is used, and its fault is found.
    let swapped = ["shoulder_lift", "shoulder_pan", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let options = RunOptions { joint_map: map(&swapped), ..with_robot("ur5e") };
    let report = audit_runs(std::slice::from_ref(&run), options).expect("a report");
    assert!(report.findings.iter().any(|found| *found.code == *"ORD005"), "{:?}", report.findings);
    let unknown = ["shoulder_pn"; 1];
    let options = RunOptions { joint_map: map(&unknown), ..with_robot("ur5e") };
    let error = audit_runs(&[run], options).expect_err("no such joint");
    assert!(error.to_string().contains("did you mean 'shoulder_pan_joint'"), "{error}");
}
