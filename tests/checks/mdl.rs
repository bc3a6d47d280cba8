//! MDL: unexplained residuals.

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::fs;
use std::path::Path;

use poseaudit::geometry::{Convention, Pose, Rotation, Vec3, pose, rotation_from_rotvec, xyz_of};
use poseaudit::report::Verdict;
use poseaudit::robot::Robot;
use poseaudit::run::CalibrationSource;
use poseaudit::synth::{Coding, Noise, POSE, Scenario, urdf_text};

use crate::checks::case::On::Topic;
use crate::checks::case::What::{Frame, ResidualBetween};
use crate::checks::case::{Expected, Log, cases, error, info, summary, the};
use Expected::{BlamedOn, Sound, Undecided};

cases! {
    MDL001 nominal_kinematics: |log| calibrate(&mut log.run)
        => info(Topic(POSE), ResidualBetween(0.5e-3, 6e-3));
    MDL001 a_forearm_of_another_length: |log| lengthen_forearm(&mut log.run)
        => error(Topic(POSE), ResidualBetween(0.01, 0.1));

    MDL001 the_arms_own_calibration_leaves_nothing: |log| {
        calibrate(&mut log.run);
        log.options.run.calibrations = vec![calibration_file(&log.run.robot)];
    } => Sound;
    MDL001 a_tenth_of_a_millimetre_of_link_is_sound: |log| {
        alter(&mut log.run, "wrist_1_joint", [1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]);
    } => Sound;

    MDL001 a_joint_zero_leaves_nothing: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero(1, 0.8);
    } => BlamedOn("ZER001");
    MDL001 a_misread_rotation_leaves_nothing: |log| {
        log.run.pose.coding = crate::checks::ord::misread_as_rpy();
    } => BlamedOn("ORD001");
    MDL001 a_late_pose_leaves_nothing: |log| log.run.pose.timing.latency_s = 0.05
        => BlamedOn("LAT001");
    MDL001 a_frame_leaves_nothing: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::shifted();
    } => BlamedOn("FRM002");

    MDL001 growth_with_reach_leaves_nothing: |log| log.run.pose.growth = 0.01
        => BlamedOn("ZER002");

    MDL001 nothing_but_joint_states: |log| joint_states_alone(&mut log.run)
        => Undecided("nothing in this log can be compared with /joint_states");
    MDL001 a_handful_of_samples: |log| {
        joint_states_alone(&mut log.run);
        log.run.pose.timing.rate_hz = 0.3;
    } => Undecided("samples");
}

/// Removes every stream that could be compared with the joint states.
fn joint_states_alone(run: &mut Scenario) {
    for timing in [&mut run.pose.timing, &mut run.tf.timing, &mut run.imu.timing] {
        timing.rate_hz = 0.0;
    }
}

#[test]
fn joint_states_alone_are_no_pass() {
    let report = Log::with(|log| joint_states_alone(&mut log.run)).audited();
    assert_eq!(report.verdict, Verdict::Inconclusive);
}

/// Makes the forearm 60 mm longer and the upper arm 60 mm shorter, which no zero offset or frame can
/// explain.
pub fn lengthen_forearm(run: &mut Scenario) {
    alter(run, "wrist_1_joint", [-0.06, 0.0, 0.0, 0.0, 0.0, 0.0]);
    alter(run, "elbow_joint", [0.06, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

/// Makes the arm a real one: all links deviate slightly from the catalogue model of the audit.
pub fn calibrate(run: &mut Scenario) {
    alter(run, "shoulder_pan_joint", [0.0, 0.0, 0.6e-3, 0.0, 0.0, 0.0]);
    alter(run, "shoulder_lift_joint", [0.3e-3, -0.4e-3, 0.0, 0.8e-3, 0.0, -0.5e-3]);
    alter(run, "elbow_joint", [1.1e-3, 0.4e-3, 0.5e-3, 0.9e-3, -0.6e-3, 0.0]);
    alter(run, "wrist_1_joint", [-0.9e-3, 0.3e-3, -0.6e-3, -0.7e-3, 0.9e-3, 0.0]);
    alter(run, "wrist_2_joint", [0.2e-3, 0.5e-3, -0.3e-3, 1.0e-3, 0.0, 0.4e-3]);
    alter(run, "wrist_3_joint", [-0.3e-3, 0.6e-3, 0.2e-3, -0.8e-3, 0.3e-3, 0.0]);
}

/// Writes the calibration of a UR like `ur_calibration`.
fn calibration_file(robot: &Robot) -> CalibrationSource {
    const BLOCKS: [(&str, &str); 6] = [
        ("shoulder", "shoulder_pan_joint"),
        ("upper_arm", "shoulder_lift_joint"),
        ("forearm", "elbow_joint"),
        ("wrist_1", "wrist_1_joint"),
        ("wrist_2", "wrist_2_joint"),
        ("wrist_3", "wrist_3_joint"),
    ];
    let rpy: Convention = "euler:xyz".parse().expect("a convention");
    let mut text = "kinematics:\n".to_owned();
    for (block, joint) in BLOCKS {
        let origin = robot.joint(joint).expect(joint).parent_from_joint;
        let [x, y, z] = xyz_of(&origin);
        let [roll, pitch, yaw] = rpy.numbers(&origin.rotation);
        text += &format!(
            "  {block}:\n    x: {x}\n    y: {y}\n    z: {z}\n    \
             roll: {roll}\n    pitch: {pitch}\n    yaw: {yaw}\n"
        );
    }
    text += "  hash: calib_1234567890\n";
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibration.yaml");
    fs::write(&file, text).expect("the tests may write there");
    CalibrationSource { prefix: None, file }
}

#[test]
fn a_calibration_is_said_in_the_robots_source() {
    let report = Log::with(|log| {
        calibrate(&mut log.run);
        log.options.run.calibrations = vec![calibration_file(&log.run.robot)];
    })
    .audited();
    let source = &report.robots[0].source;
    assert!(source.ends_with("calibration.yaml (calib_1234567890)"), "{source}");
    assert_eq!(
        report.streams.iter().find(|s| s.topic == POSE).unwrap().witness,
        Some("controller")
    );
}

#[test]
fn nominal_kinematics_beside_a_late_inverted_pose_are_still_nominal() {
    let report = Log::with(|log| {
        calibrate(&mut log.run);
        log.run.pose.timing.latency_s = 0.02;
        log.run.pose.coding = Coding::Inverted;
    })
    .audited();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["LAT001", "MDL001", "ORD003"].into(), "{}", summary(&report.findings));
}

#[test]
fn a_tool_and_growth_are_no_calibration_however_noisy_the_tracker() {
    let report = Log::with(|log| {
        log.run.noise = Noise { pose_m: 2e-4, pose_rad: 4e-4, ..log.run.noise };
        log.run.pose.tip_from_stream = Pose::translation(0.0, 0.003, -0.002);
        log.run.pose.growth = 0.004;
        log.run.pose.coding = Coding::Inverted;
        log.run.pose.timing.rate_hz = 50.0;
    })
    .audited();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM003", "ORD003", "ZER002"].into(), "{}", summary(&report.findings));
}

#[test]
fn the_catalogue_arm_that_fits_is_named_beside_a_model_that_does_not() {
    let report = Log::with(|log| log.options.run.robots = vec!["ur10e".into()]).audited();
    let message = &the(&report, "MDL001", POSE).message;
    assert!(message.contains("wrong robot model: a ur5e fits the poses to "), "{message}");
    assert_eq!(report.robots[0].name, "ur10e");
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["MDL001"].into(), "{}", summary(&report.findings));
}

#[test]
fn the_catalogue_does_not_displace_a_model_that_a_frame_makes_fit_as_well() {
    let report = turned_in_its_cell([0.0; 3]).audited();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM002"].into(), "{}", summary(&report.findings));
    Frame([0.0, 1e-3], [180.0, 0.1]).assert_is(the(&report, "FRM002", POSE).estimate.as_ref());
}

#[test]
fn a_base_turned_by_half_in_a_cell_is_no_joint_turned_by_half() {
    let report = turned_in_its_cell([0.3, 0.0, 0.8]).audited();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM002"].into(), "{}", summary(&report.findings));
    Frame([0.6, 1e-3], [180.0, 0.1]).assert_is(the(&report, "FRM002", POSE).estimate.as_ref());
}

/// An arm at `xyz` (m) in its cell, with poses relative to the cell that are rotated by 180° about the
/// base's z axis.
fn turned_in_its_cell(xyz: [f64; 3]) -> Log {
    Log::with(|log| {
        let Log { run, .. } = log;
        let root = run.robot.link_name(run.robot.root());
        let [x, y, z] = xyz;
        let mount = format!(
            "<link name=\"world\"/><joint name=\"mount\" type=\"fixed\"><parent link=\"world\"/>\
             <child link=\"{root}\"/><origin xyz=\"{x} {y} {z}\"/></joint></robot>"
        );
        let text = urdf_text(&run.robot).replace("</robot>", &mount);
        run.robot = Robot::from_urdf(&text, "an arm in its cell").expect("a robot");
        (run.base, run.pose.frame_id) = ("world".to_owned(), "world".to_owned());
        let cell_from_base = pose(xyz, Rotation::identity());
        let half = pose([0.0; 3], rotation_from_rotvec(Vec3::z() * PI));
        run.pose.reference_from_stream = cell_from_base * half * cell_from_base.inverse();
        run.tf.timing.rate_hz = 0.0;
    })
}

/// Moves the origin of a joint by x, y, z (m) and roll, pitch, yaw (rad). The log contains neither the
/// altered model nor its transforms.
pub fn alter(run: &mut Scenario, joint: &str, by: [f64; 6]) {
    let text = urdf_text(&run.robot);
    let (before, from_joint) = text.split_once(&format!("<joint name=\"{joint}\"")).expect(joint);
    let (head, rest) = from_joint.split_once("<origin xyz=\"").expect("an origin");
    let (xyz, rest) = rest.split_once("\" rpy=\"").expect("angles");
    let (rpy, rest) = rest.split_once('"').expect("an end");
    let origin = format!("{xyz} {rpy}");
    let numbers = origin.split(' ').zip(by).map(|(number, by)| {
        let number: f64 = number.parse().expect("a number");
        (number + by).to_string()
    });
    let [x, y, z, roll, pitch, yaw] = numbers.collect::<Vec<_>>().try_into().expect("six");
    let altered = format!(
        "{before}<joint name=\"{joint}\"{head}<origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"{rest}"
    );
    run.robot = Robot::from_urdf(&altered, "an altered arm").expect("a robot");
    run.description = false;
    run.tf.timing.rate_hz = 0.0;
}
