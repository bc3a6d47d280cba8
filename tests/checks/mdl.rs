//! MDL: unexplained residuals.

use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::fs;
use std::path::Path;

use poseaudit::geometry::{
    Convention, Pose, Rotation, Vec3, pose, rotation_from_rotvec, rotation_from_xyzw, xyz_of,
    xyzw_from_rotation,
};
use poseaudit::report::Verdict;
use poseaudit::robot::Robot;
use poseaudit::run::CalibrationSource;
use poseaudit::synth::{LoggedEncoding, Noise, POSE, Scenario, urdf_text};

use crate::checks::case::ExpectedEstimate::{Frame, ResidualBetween};
use crate::checks::case::ExpectedSubject::Topic;
use crate::checks::case::{Expected, Log, cases, error, info, single_finding, summary};
use crate::checks::recording::Field;
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding};

cases! {
    MDL001 nominal_kinematics: |log| add_link_deviations(&mut log.run)
        => info(Topic(POSE), ResidualBetween(0.5e-3, 6e-3));
    MDL001 a_forearm_of_another_length: |log| lengthen_forearm(&mut log.run)
        => error(Topic(POSE), ResidualBetween(0.01, 0.1));

    MDL001 an_arm_on_a_rail_passes_in_the_frame_of_a_tracker: |log| {
        crate::checks::zer::mount_on_rail(&mut log.run);
        log.run.pose.frame_id = "tracker".to_owned();
    } => NoFindings;
    MDL001 the_calibration_of_the_arm_leaves_no_residual: |log| {
        add_link_deviations(&mut log.run);
        log.options.run.calibrations = vec![calibration_file(&log.run.robot)];
    } => NoFindings;
    MDL001 a_tenth_of_a_millimetre_of_link_passes: |log| {
        move_joint_origin(&mut log.run, "wrist_1_joint", [1e-4, 0.0, 0.0, 0.0, 0.0, 0.0]);
    } => NoFindings;

    MDL001 a_zero_offset_leaves_no_residual: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(1, 0.8);
    } => OnlyOtherFinding("ZER001");
    MDL001 a_misread_rotation_leaves_no_residual: |log| {
        log.run.pose.encoding = crate::checks::ord::misread_as_rpy();
    } => OnlyOtherFinding("ORD001");
    MDL001 a_late_pose_leaves_no_residual: |log| log.run.pose.timing.latency_s = 0.05
        => OnlyOtherFinding("LAT001");
    MDL001 a_frame_offset_leaves_no_residual: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_shifted_and_tilted();
    } => OnlyOtherFinding("FRM002");

    MDL001 radial_scale_leaves_no_residual: |log| log.run.pose.radial_scale_error = 0.01
        => OnlyOtherFinding("ZER002");

    MDL001 only_joint_states: |log| remove_other_streams(&mut log.run)
        => Inconclusive("nothing in this log can be compared with /joint_states");
    MDL001 too_few_pose_samples: |log| {
        remove_other_streams(&mut log.run);
        log.run.pose.timing.rate_hz = 0.3;
    } => Inconclusive("samples");
}

/// Removes every stream that could be compared with the joint states.
fn remove_other_streams(run: &mut Scenario) {
    for timing in [&mut run.pose.timing, &mut run.tf.timing, &mut run.imu.timing] {
        timing.rate_hz = 0.0;
    }
}

#[test]
fn a_log_of_only_joint_states_is_inconclusive() {
    let report = Log::modified(|log| remove_other_streams(&mut log.run)).report();
    assert_eq!(report.verdict, Verdict::Inconclusive);
}

/// Makes the forearm 60 mm longer and the upper arm 60 mm shorter, which no zero offset or frame can
/// explain.
pub fn lengthen_forearm(run: &mut Scenario) {
    move_joint_origin(run, "wrist_1_joint", [-0.06, 0.0, 0.0, 0.0, 0.0, 0.0]);
    move_joint_origin(run, "elbow_joint", [0.06, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

/// Makes the arm a real one: all links deviate slightly from the catalogue model of the audit.
pub fn add_link_deviations(run: &mut Scenario) {
    add_link_deviations_times(run, 1.0);
}

/// A multiple of [`add_link_deviations`].
pub fn add_link_deviations_times(run: &mut Scenario, factor: f64) {
    for (joint, by) in [
        ("shoulder_pan_joint", [0.0, 0.0, 0.6e-3, 0.0, 0.0, 0.0]),
        ("shoulder_lift_joint", [0.3e-3, -0.4e-3, 0.0, 0.8e-3, 0.0, -0.5e-3]),
        ("elbow_joint", [1.1e-3, 0.4e-3, 0.5e-3, 0.9e-3, -0.6e-3, 0.0]),
        ("wrist_1_joint", [-0.9e-3, 0.3e-3, -0.6e-3, -0.7e-3, 0.9e-3, 0.0]),
        ("wrist_2_joint", [0.2e-3, 0.5e-3, -0.3e-3, 1.0e-3, 0.0, 0.4e-3]),
        ("wrist_3_joint", [-0.3e-3, 0.6e-3, 0.2e-3, -0.8e-3, 0.3e-3, 0.0]),
    ] {
        move_joint_origin(run, joint, by.map(|by| factor * by));
    }
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
fn a_calibration_is_named_in_the_robot_source() {
    let report = Log::modified(|log| {
        add_link_deviations(&mut log.run);
        log.options.run.calibrations = vec![calibration_file(&log.run.robot)];
    })
    .report();
    let source = &report.robots[0].source;
    assert!(source.ends_with("calibration.yaml (calib_1234567890)"), "{source}");
    assert_eq!(
        report.streams.iter().find(|s| s.topic == POSE).unwrap().source_kind,
        Some("controller")
    );
}

#[test]
fn a_nominal_model_is_found_with_a_late_inverted_pose() {
    let report = Log::modified(|log| {
        add_link_deviations(&mut log.run);
        log.run.pose.timing.latency_s = 0.02;
        log.run.pose.encoding = LoggedEncoding::Inverted;
    })
    .report();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["LAT001", "MDL001", "ORD003"].into(), "{}", summary(&report.findings));
}

#[test]
fn with_a_noisy_tracker_tool_offset_and_radial_scale_are_not_reported_as_nominal_model() {
    let report = Log::modified(|log| {
        log.run.noise = Noise { pose_m: 2e-4, pose_rad: 4e-4, ..log.run.noise };
        log.run.pose.tip_from_stream = Pose::translation(0.0, 0.003, -0.002);
        log.run.pose.radial_scale_error = 0.004;
        log.run.pose.encoding = LoggedEncoding::Inverted;
        log.run.pose.timing.rate_hz = 50.0;
    })
    .report();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM003", "ORD003", "ZER002"].into(), "{}", summary(&report.findings));
}

#[test]
fn a_wrong_model_is_reported_with_the_catalogue_arm_that_fits() {
    let report = Log::modified(|log| log.options.run.robots = vec!["ur10e".into()]).report();
    let message = &single_finding(&report, "MDL001", POSE).message;
    assert!(message.contains("wrong robot model: a ur5e fits the poses to "), "{message}");
    assert_eq!(report.robots[0].name, "ur10e");
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["MDL001"].into(), "{}", summary(&report.findings));
}

#[test]
fn a_model_that_fits_with_a_frame_offset_is_not_reported_as_wrong() {
    let report = log_of_arm_in_cell([0.0; 3]).report();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM002"].into(), "{}", summary(&report.findings));
    Frame([0.0, 1e-3], [180.0, 0.1])
        .assert_matches(single_finding(&report, "FRM002", POSE).estimate.as_ref());
}

#[test]
fn a_base_rotated_in_a_cell_is_not_reported_as_a_zero_offset() {
    let report = log_of_arm_in_cell([0.3, 0.0, 0.8]).report();
    let codes: BTreeSet<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM002"].into(), "{}", summary(&report.findings));
    Frame([0.6, 1e-3], [180.0, 0.1])
        .assert_matches(single_finding(&report, "FRM002", POSE).estimate.as_ref());
}

/// An arm at `xyz` (m) in its cell, with poses relative to the cell that are rotated by 180° about the
/// base's z axis.
fn log_of_arm_in_cell(xyz: [f64; 3]) -> Log {
    Log::modified(|log| {
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
pub fn move_joint_origin(run: &mut Scenario, joint: &str, by: [f64; 6]) {
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
    let changed_urdf = format!(
        "{before}<joint name=\"{joint}\"{head}<origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"{rest}"
    );
    run.robot = Robot::from_urdf(&changed_urdf, "an altered arm").expect("a robot");
    run.has_description = false;
    run.tf.timing.rate_hz = 0.0;
}

/// The commonest mistake with Euler angles. Differences between samples are as large as the error, but no noise.
#[test]
fn orientations_from_degrees_taken_as_radians_do_not_pass() {
    let report = Log::modified(|log| {
        log.edit = Some(|messages| {
            for message in messages.iter_mut().filter(|message| message.topic == POSE) {
                for field in message.fields() {
                    let Field::Xyzw(at) = field else { continue };
                    let rotation =
                        rotation_from_xyzw(message.floats(at)).expect("a unit quaternion");
                    let degrees = Convention::RPY.numbers(&rotation).map(f64::to_degrees);
                    let wrong = xyzw_from_rotation(&Convention::RPY.rotation(degrees));
                    message.set_floats(at, &wrong);
                }
            }
        });
    })
    .report();
    let finding = single_finding(&report, "MDL001", POSE);
    assert!(finding.message.starts_with("orientations differ from FK by 1"), "{}", finding.message);
}
