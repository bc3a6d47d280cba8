//! Logs with joint names that differ from the model.

use std::fs::File;
use std::path::PathBuf;

use poseaudit::report::{Report, Trouble};
use poseaudit::run::RunOptions;
use poseaudit::synth::{Scenario, write_cell};
use poseaudit::{Options, audit};
use tempfile::TempDir;

/// A UR5e with joints named `before` and a number; its log has no description, and a foreign frame.
fn ur5e(before: &str) -> Scenario {
    let run = Scenario::ur5e();
    named(run, |joint| format!("{before}{}", joint + 1))
}

/// A run with renamed joints.
fn named(run: Scenario, name: impl Fn(usize) -> String) -> Scenario {
    let own = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let renamed = run.robot.with_joints_renamed(|joint| {
        let at = own.iter().position(|own| joint == format!("{own}_joint"));
        at.map_or(joint.to_owned(), &name)
    });
    let mut run = Scenario { robot: renamed.expect("distinct names"), ..run };
    (run.description, run.tf.timing.rate_hz, run.tf.with_static) = (false, 0.0, false);
    run.imu.timing.rate_hz = 0.0;
    run.pose.frame_id = "cell".to_owned();
    run
}

fn audited(runs: &[Scenario], options: RunOptions) -> Result<Report, Trouble> {
    let folder = TempDir::new().expect("a folder");
    let log: PathBuf = folder.path().join("run.mcap");
    write_cell(runs, File::create(&log).expect("a file"), None).expect("a log");
    let options = Options { logs: vec![log], run: options, ..Options::default() };
    Ok(audit(&options)?.report)
}

fn as_robot(name: &str) -> RunOptions {
    RunOptions { robots: vec![name.into()], ..RunOptions::default() }
}

/// How the report describes the identification of the arm; empty without an arm.
fn source(report: &Report) -> &str {
    report.robots.first().map_or("", |robot| robot.source.as_str())
}

fn refusal(report: &Report) -> String {
    report.error.as_ref().map_or_else(String::new, ToString::to_string)
}

#[test]
fn an_arm_is_matched_by_the_order_of_its_joints_and_the_evidence_is_said() {
    let mut run = ur5e("J");
    run.joints.zero_offsets = vec![0.0, 0.0, 0.6_f64.to_radians()];
    let report = audited(&[run], as_robot("ur5e")).expect("a report");
    let said = source(&report);
    assert!(said.contains("J1…J6 are shoulder_pan_joint…wrist_3_joint"), "{said}");
    assert!(said.contains("fits within") && said.contains("with a joint zero"), "{said}");
    let zero = report.findings.iter().find(|found| *found.code == *"ZER001").expect("the zero");
    assert_eq!(zero.subject.joint.as_deref(), Some("J3"));
}

#[test]
fn without_a_model_the_only_arm_that_fits_is_taken() {
    let report = audited(&[ur5e("axis_")], RunOptions::default()).expect("a report");
    assert_eq!(report.robots[0].name, "ur5e");
    assert!(source(&report).contains("the next best of"), "{}", source(&report));
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn names_without_numbers_are_taken_in_the_order_that_fits() {
    let names = ["base", "shoulder", "elbow", "wrist_a", "wrist_b", "wrist_c"];
    let run = named(Scenario::ur5e(), |joint| names[joint].to_owned());
    let report = audited(&[run], as_robot("ur5e")).expect("a report");
    assert!(source(&report).contains("base…wrist_c are"), "{}", source(&report));
}

#[test]
fn what_does_not_fit_is_a_question_with_the_option_that_answers_it() {
    for (robot, part) in [
        ("ur10", "--joint-map J1=shoulder_pan_joint,J2=shoulder_lift_joint"),
        ("ur5", "matched by order, the poses do not fit"),
        ("franka_fer", "joint names differ: the log has J1"),
    ] {
        let report = audited(&[ur5e("J")], as_robot(robot)).expect("a report");
        assert!(
            report.robots.is_empty() && refusal(&report).contains(part),
            "{}",
            refusal(&report)
        );
    }
}

#[test]
fn no_arm_is_guessed_without_poses() {
    let mut run = ur5e("J");
    run.pose.timing.rate_hz = 0.0;
    let report = audited(&[run.clone()], RunOptions::default()).expect("a report");
    assert!(refusal(&report).contains("no robot model matches the joints"), "{}", refusal(&report));
    // A named robot is matched by numbers without confirmation.
    let report = audited(&[run], as_robot("ur5e")).expect("a report");
    assert!(source(&report).contains("not confirmed by a pose stream"), "{}", source(&report));
}

#[test]
fn two_arms_are_each_matched_by_their_own_numbers() {
    let arm = |side: &str, seed| {
        let mut run = ur5e(&format!("{side}_ax"));
        (run.namespace, run.seed) = (format!("/{side}"), seed);
        run
    };
    let report = audited(&[arm("one", 1), arm("two", 2)], as_robot("ur5e")).expect("a report");
    let names: Vec<&str> = report.robots.iter().map(|robot| robot.name.as_str()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
    assert!(names[0] != names[1], "{names:?}");
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn a_map_of_joints_is_followed_with_and_without_a_model() {
    // No name determines this order.
    let names = ["alpha", "beta", "gamma", "delta", "epsilon", "zeta"];
    let run = named(Scenario::ur5e(), |joint| names[joint].to_owned());
    let own = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let map = |own: &[&str]| {
        let pairs = names.iter().zip(own).map(|(logged, own)| format!("{logged}={own}_joint"));
        pairs.map(|pair| pair.parse().expect("a pair")).collect()
    };
    for robots in [vec!["ur5e".into()], Vec::new()] {
        let options = RunOptions { robots, joint_map: map(&own), ..RunOptions::default() };
        let report = audited(std::slice::from_ref(&run), options).expect("a report");
        assert_eq!(report.robots[0].name, "ur5e");
        assert!(report.findings.is_empty(), "{:?}", report.findings);
    }
    // The caller's mapping is used, and its fault is found.
    let swapped = ["shoulder_lift", "shoulder_pan", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let options = RunOptions { joint_map: map(&swapped), ..as_robot("ur5e") };
    let report = audited(std::slice::from_ref(&run), options).expect("a report");
    assert!(report.findings.iter().any(|found| *found.code == *"ORD005"), "{:?}", report.findings);
    let unknown = ["shoulder_pn"; 1];
    let options = RunOptions { joint_map: map(&unknown), ..as_robot("ur5e") };
    let error = audited(&[run], options).expect_err("no such joint");
    assert!(error.to_string().contains("did you mean 'shoulder_pan_joint'"), "{error}");
}
