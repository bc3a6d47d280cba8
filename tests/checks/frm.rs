//! FRM: frames that are not where they are said to be.

use std::f64::consts::{FRAC_PI_2, PI};

use poseaudit::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use poseaudit::synth::{Motion, POSE, TF, TF_STATIC};
use serde_json::Value;

use crate::case::On;
use crate::case::What::Frame;
use crate::case::{Expected, Log, cases, error, info, the, warning};
use crate::recording::{Field, Message};
use Expected::{BlamedOn, Skipped, Sound, Undecided};

const BASE: On = On::Frame(POSE, "base");
const TIP: On = On::Frame(POSE, "tool0");
const TIP_OF_TF: On = On::Frame(TF, "tool0");

cases! {
    FRM001 a_static_transform_that_is_not_the_models: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 0.003, 0.0]));
    } => warning(TIP_OF_TF, Frame([0.003, 0.1e-3], [0.0, 0.01]));
    FRM001 a_link_that_is_not_the_models: |log| {
        log.edit = Some(|messages| move_frame(messages, TF, "forearm_link", [0.008, 0.0, 0.0]));
    } => error(TIP_OF_TF, Frame([0.008, 0.5e-3], [0.0, 0.01]));
    FRM001 a_tenth_of_a_millimetre_is_sound: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 1e-4, 0.0]));
    } => Sound;
    FRM001 a_joint_zero_is_inherited: |log| log.run.joints.zero_offsets = crate::zer::zero(2, 0.6)
        => BlamedOn("ZER001");
    FRM001 a_pose_in_another_frame_is_not_tfs: |log| {
        log.run.pose.reference_from_stream = half_turn();
    } => BlamedOn("FRM002");
    FRM001 a_late_tf_agrees_once_it_is_shifted: |log| log.run.tf.timing.latency_s = 0.05
        => BlamedOn("LAT001");
    FRM001 no_tf: |log| log.run.tf.timing.rate_hz = 0.0 => Skipped("no /tf");

    FRM002 a_base_turned_by_half: |log| log.run.pose.reference_from_stream = half_turn()
        => error(BASE, Frame([0.0, 0.05e-3], [180.0, 0.01]));
    FRM002 a_base_shifted_and_tilted: |log| log.run.pose.reference_from_stream = shifted()
        => error(BASE, Frame([0.06, 0.1e-3], [2.0, 0.02]));
    FRM002 a_base_shifted_by_a_little: |log| {
        log.run.pose.reference_from_stream.translation.vector.y = -0.0025;
    } => warning(BASE, Frame([0.0025, 0.1e-3], [0.0, 0.02]));
    FRM002 a_tenth_of_a_millimetre_of_base_is_sound: |log| {
        log.run.pose.reference_from_stream.translation.vector.y = 1e-4;
    } => Sound;
    FRM002 a_trackers_world_is_sound: |log| {
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = shifted();
    } => Sound;
    FRM002 the_first_joints_zero_is_no_frame: |log| {
        log.run.joints.zero_offsets = crate::zer::zero(0, 0.6);
    } => BlamedOn("ZER001");
    FRM002 a_tool_is_no_base: |log| log.run.pose.tip_from_stream = tool() => BlamedOn("FRM003");
    FRM002 millimetres_are_no_base: |log| log.run.pose.in_millimetres = true
        => BlamedOn("ORD008");
    FRM002 a_late_pose_is_in_its_frame: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    FRM002 at_rest_a_tool_makes_up_for_the_base: |log| log.run.motion = Motion::AtRest
        => Undecided("turn the wrist");
    FRM002 no_pose_in_any_frame: |log| log.run.pose.timing.rate_hz = 0.0
        => Skipped("no pose stream");

    FRM003 a_tool_beyond_the_named_tip: |log| {
        log.options.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream = tool();
    } => error(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_tool_beyond_a_tip_that_nobody_named: |log| log.run.pose.tip_from_stream = tool()
        => info(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_little_of_tool: |log| {
        log.options.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 0.002;
    } => warning(TIP, Frame([0.002, 0.1e-3], [0.0, 0.02]));
    FRM003 a_tenth_of_a_millimetre_of_tool_is_sound: |log| {
        log.options.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 1e-4;
    } => Sound;
    FRM003 the_last_joints_zero_is_no_tool: |log| {
        log.options.tip = Some("tool0".to_owned());
        log.run.joints.zero_offsets = crate::zer::zero(5, 0.6);
    } => BlamedOn("ZER001");
    FRM003 a_turned_base_is_no_tool: |log| {
        log.options.tip = Some("tool0".to_owned());
        log.run.pose.reference_from_stream = half_turn();
    } => BlamedOn("FRM002");
    FRM003 a_misread_rotation_is_no_tool: |log| log.run.pose.coding = crate::ord::misread_as_rpy()
        => BlamedOn("ORD001");
    FRM003 at_rest_a_base_makes_up_for_the_tool: |log| log.run.motion = Motion::AtRest
        => Undecided("turn the wrist");
    FRM003 no_pose_of_any_tool: |log| log.run.pose.timing.rate_hz = 0.0
        => Skipped("no pose stream");
}

pub fn half_turn() -> Pose {
    pose([0.0; 3], rotation_from_rotvec(Vec3::z() * PI))
}

/// 60 mm aside, and tilted by 2° about x.
pub fn shifted() -> Pose {
    pose([0.02, -0.04, 0.04], rotation_from_rotvec(Vec3::x() * 2_f64.to_radians()))
}

/// A cell's corner as origin.
pub fn far_off() -> Pose {
    pose([-4.0, 6.0, 0.5], rotation_from_rotvec(Vec3::new(0.3, 0.1, -1.2)))
}

/// A tool 140 mm long, turned by a quarter.
pub fn tool() -> Pose {
    pose([0.0, 0.0, 0.14], rotation_from_rotvec(Vec3::z() * FRAC_PI_2))
}

/// Moves the frame `child` against its parent.
fn move_frame(messages: &mut [Message], topic: &str, child: &str, by: [f64; 3]) {
    for message in messages.iter_mut().filter(|message| message.topic == topic) {
        for field in message.fields() {
            if let Field::Xyz(at, frame) = field
                && frame == child
            {
                let xyz: [f64; 3] = message.floats(at);
                message.set_floats(at, &[xyz[0] + by[0], xyz[1] + by[1], xyz[2] + by[2]]);
            }
        }
    }
}

/// Asserts that the evidence holds `expected` as the finding's pose.
#[track_caller]
fn assert_pose(evidence: &Value, expected: &Pose) {
    let numbers = |key: &str| -> Vec<f64> {
        let list = evidence[key].as_array().unwrap_or_else(|| panic!("no {key} in {evidence}"));
        list.iter().filter_map(Value::as_f64).collect()
    };
    let (xyz, xyzw) = (numbers("xyz"), numbers("quaternion_xyzw"));
    let found = pose(
        xyz.try_into().expect("three numbers"),
        poseaudit::geometry::rotation_from_xyzw(xyzw.try_into().expect("four numbers"))
            .expect("a rotation"),
    );
    let off = found.inverse() * expected;
    assert!(
        off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-4,
        "{found} is not {expected}"
    );
}

#[test]
fn the_poses_of_both_frames_are_told_as_the_contract_signs_them() {
    let report = Log::with(|log| log.run.pose.reference_from_stream = shifted()).audited();
    assert_pose(&the(&report, "FRM002", POSE).evidence.more["pose"], &shifted());
    let report = Log::with(|log| log.run.pose.tip_from_stream = tool()).audited();
    assert_pose(&the(&report, "FRM003", POSE).evidence.more["pose"], &tool());
}

#[test]
fn a_world_of_its_own_is_estimated_and_not_judged() {
    let report = Log::with(|log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = far_off();
    })
    .audited();
    assert!(report.findings.is_empty(), "{}", crate::case::summary(&report.findings));
    let row = report.checks.iter().find(|row| row.code == "FRM002").expect("it was asked");
    // `reference_from_stream` of a reference that is the base: nothing else is known of it.
    assert_pose(&row.evidence["pose"], &far_off());
}
