//! FRM: wrong frames.

use std::f64::consts::{FRAC_PI_2, PI};

use poseaudit::finding::{Estimate, Severity};
use poseaudit::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use poseaudit::synth::{
    COMMANDED_JOINTS, COMMANDED_POSE, Commands, GOAL, Lines, Motion, POSE, TF, TF_STATIC, ToolSlip,
};
use serde_json::Value;

use crate::checks::case::On;
use crate::checks::case::What::{self, About, Frame};
use crate::checks::case::{Expected, Log, cases, error, info, the, warning};
use crate::checks::recording::{Field, Message};
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
    FRM001 a_joint_zero_is_inherited: |log| log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6)
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
        log.run.joints.zero_offsets = crate::checks::zer::zero(0, 0.6);
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
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream = tool();
    } => error(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_tool_beyond_a_tip_that_nobody_named: |log| log.run.pose.tip_from_stream = tool()
        => info(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_marker_beside_the_named_tip: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = shifted();
        log.run.pose.tip_from_stream = tool();
    } => info(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_marker_that_is_taken_for_another: |log| {
        let tool_from_slipped = pose([0.03, 0.0, 0.04], rotation_from_rotvec(Vec3::z() * 2.0));
        log.run.pose.slip = Some(ToolSlip { from_s: 3.0, to_s: 5.0, tool_from_slipped });
    } => error(TIP, Frame([0.05, 4e-3], [2_f64.to_degrees(), 1.0]));
    FRM003 a_little_of_tool: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 0.002;
    } => warning(TIP, Frame([0.002, 0.1e-3], [0.0, 0.02]));
    FRM003 a_tenth_of_a_millimetre_of_tool_is_sound: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 1e-4;
    } => Sound;
    FRM003 the_last_joints_zero_is_no_tool: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.joints.zero_offsets = crate::checks::zer::zero(5, 0.6);
    } => BlamedOn("ZER001");
    FRM003 a_turned_base_is_no_tool: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.reference_from_stream = half_turn();
    } => BlamedOn("FRM002");
    FRM003 a_misread_rotation_is_no_tool: |log| log.run.pose.coding = crate::checks::ord::misread_as_rpy()
        => BlamedOn("ORD001");
    FRM003 at_rest_a_base_makes_up_for_the_tool: |log| log.run.motion = Motion::AtRest
        => Undecided("turn the wrist");
    FRM003 no_pose_of_any_tool: |log| log.run.pose.timing.rate_hz = 0.0
        => Skipped("no pose stream");

    FRM004 a_frame_with_two_parents: |log| {
        log.edit = Some(|messages| publish(messages, TF, |row| {
            (if row % 2 == 0 { "cell" } else { "table" }, "fixture", 0.0)
        }));
    } => error(On::Frame(TF, "fixture"), What::None);
    FRM004 a_ring_of_two: |log| {
        log.edit = Some(|messages| publish(messages, TF, |row| {
            if row % 2 == 0 { ("cell", "fixture", 0.0) } else { ("fixture", "cell", 0.0) }
        }));
    } => error(On::Frame(TF, "fixture"), What::None);
    FRM004 two_publishers_of_one_transform: |log| {
        log.edit = Some(|messages| publish(messages, TF, |row| {
            ("cell", "fixture", if row % 3 == 0 { 0.05 } else { 0.0 })
        }));
    } => error(On::Frame(TF, "fixture"), About(0.05, 1e-9));
    FRM004 a_static_frame_that_moves: |log| {
        log.edit = Some(|messages| {
            publish(messages, TF_STATIC, |_| ("cell", "fixture", 0.0));
            publish(messages, TF_STATIC, |row| ("cell", "fixture", 0.02 * row as f64));
        });
    } => error(On::Frame(TF_STATIC, "fixture"), About(0.02, 1e-9));
    FRM004 a_pose_in_a_tree_of_its_own: |log| {
        log.run.pose.frame_id = "cell".to_owned();
        log.edit = Some(|messages| publish(messages, TF_STATIC, |_| ("room", "cell", 0.3)));
    } => error(On::Frame(TF, "cell"), What::None);
    FRM004 what_is_picked_up_and_put_down_is_sound: |log| {
        // Each of the two transforms has gaps while the other is published.
        log.options.policy.rules.ignore = vec!["TIM002".parse().expect("a rule")];
        log.edit = Some(|messages| publish(messages, TF, |row| {
            (if row / 25 % 2 == 0 { "cell" } else { "table" }, "fixture", 0.0)
        }));
    } => Sound;
    FRM004 a_trackers_world_needs_no_tie: |log| {
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = shifted();
    } => Sound;
    FRM004 a_link_elsewhere_is_a_tree_all_the_same: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 0.003, 0.0]));
    } => BlamedOn("FRM001");
    FRM004 no_frames: |log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.tf.with_static = false;
    } => Skipped("no /tf");

    FRM005 quaternions_that_are_too_short: |log| {
        log.edit = Some(|messages| stretch(messages, POSE, |_| 0.985));
    } => error(On::Topic(POSE), About(0.015, 1e-9));
    FRM005 a_quaternion_in_ten_that_is_a_little_long: |log| {
        log.edit = Some(|messages| {
            stretch(messages, POSE, |row| if row % 10 == 3 { 1.002 } else { 1.0 });
        });
    } => warning(On::Topic(POSE), About(0.002, 1e-9));
    FRM005 single_precision_is_sound: |log| {
        log.edit = Some(|messages| stretch(messages, POSE, |row| 1.0 + 1e-7 * (row % 3) as f64));
    } => Sound;
    FRM005 components_in_another_order_are_of_unit_norm: |log| {
        log.run.pose.coding = crate::checks::ord::misread_as_rpy();
    } => BlamedOn("ORD001");
    FRM005 nothing_that_turns: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.tf.with_static = false;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with quaternions");

    FRM007 a_pose_in_the_tools_own_frame: |log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "tool0".to_owned();
    } => warning(On::Topic(POSE), What::None);
    FRM007 a_topic_of_which_every_tenth_pose_is_in_another_frame: |log| {
        log.edit = Some(|messages| crate::checks::recording::rename_frame(messages, POSE, 10));
    } => warning(On::Topic(POSE), What::None);
    FRM007 a_pose_in_the_base: |_| () => Sound;
    FRM007 a_pose_in_a_world_of_its_own: |log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "mocap_world".to_owned();
        log.run.pose.reference_from_stream = far_off();
    } => Sound;
    FRM007 a_turned_base_is_a_frame_all_the_same: |log| {
        log.run.pose.reference_from_stream = half_turn();
    } => BlamedOn("FRM002");
    FRM007 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0
        => Skipped("no joint states");

    FRM006 goals_that_are_missed_by_three_millimetres: |log| {
        told(log, Commands::Goals, 0.0);
        log.options.run.tip = Some("tool0".to_owned());
        log.run.reference.tip_from_commanded = Pose::translation(0.003, 0.0, 0.0);
    } => warning(On::Topic(GOAL), Frame([0.003, 0.05e-3], [0.0, 0.01]));
    // The tip is on the last joint's axis.
    FRM006 a_wrist_that_stays_short_of_its_poses: |log| {
        told(log, Commands::Poses, 0.3);
        log.options.run.tip = Some("tool0".to_owned());
    } => warning(On::Topic(COMMANDED_POSE), Frame([0.0, 0.05e-3], [0.3, 0.005]));
    FRM006 a_joint_that_stays_short: |log| told(log, Commands::Joints, 0.7)
        => error(On::Topic(COMMANDED_JOINTS), Frame([0.0, 0.05e-3], [0.7, 0.005]));
    FRM006 another_tool_than_the_one_that_is_logged: |log| {
        told(log, Commands::Poses, 0.0);
        log.run.reference.tip_from_commanded = tool();
    } => info(On::Topic(COMMANDED_POSE), Frame([0.14, 0.2e-3], [90.0, 0.05]));
    FRM006 goals_that_are_reached: |log| told(log, Commands::Goals, 0.0) => Sound;
    FRM006 poses_that_are_followed: |log| told(log, Commands::Poses, 0.0) => Sound;
    FRM006 joints_that_are_followed: |log| told(log, Commands::Joints, 0.0) => Sound;
    FRM006 a_goal_that_is_given_up: |log| {
        told(log, Commands::Goals, 0.0);
        log.edit = Some(|messages| give_up_a_goal(messages));
    } => Sound;
    FRM006 without_a_pose_stream: |log| {
        told(log, Commands::Goals, 0.0);
        log.run.pose.timing.rate_hz = 0.0;
    } => Sound;
    FRM006 a_joint_zero_is_no_goal_missed: |log| {
        told(log, Commands::Goals, 0.0);
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    FRM006 a_late_pose_reaches_its_goals: |log| {
        told(log, Commands::Poses, 0.0);
        log.run.pose.timing.latency_s = 0.05;
    } => BlamedOn("LAT001");
    FRM006 a_turned_base_reaches_its_goals: |log| {
        told(log, Commands::Poses, 0.0);
        log.run.pose.reference_from_stream = half_turn();
    } => BlamedOn("FRM002");
    FRM006 a_misread_pose_reaches_its_goals: |log| {
        told(log, Commands::Goals, 0.0);
        log.run.pose.coding = crate::checks::ord::misread_as_rpy();
    } => BlamedOn("ORD001");
    FRM006 an_arm_that_never_rests: |log| {
        told(log, Commands::Poses, 0.0);
        log.run.motion = Motion::Continuous;
    } => Undecided("never rests");
    FRM006 a_goal_in_a_frame_of_its_own: |log| {
        told(log, Commands::Goals, 0.0);
        log.run.reference.frame_id = "map".to_owned();
    } => Skipped("not fixed to the robot");
    FRM006 no_goals: |_| {} => Skipped("no goal");
}

/// The arm follows commanded lines; its last joint stays short by `short_by_degrees`.
fn told(log: &mut Log, commands: Commands, short_by_degrees: f64) {
    crate::checks::mot::along(log, Lines::default());
    log.run.reference.commands = commands;
    if short_by_degrees > 0.0 {
        log.run.reference.short_by = vec![0.0, 0.0, 0.0, 0.0, 0.0, short_by_degrees.to_radians()];
    }
}

#[test]
fn an_elbow_that_stays_short_is_no_tool() {
    let report = Log::with(|log| {
        told(log, Commands::Poses, 0.0);
        log.run.reference.short_by = vec![0.0, 0.0, 0.3_f64.to_radians()];
    })
    .audited();
    let found = the(&report, "FRM006", COMMANDED_POSE);
    assert_eq!(found.severity, Severity::Warning, "{}", found.message);
    let Some(Estimate::Frame { value, rotation, .. }) = &found.estimate else {
        panic!("a length and an angle were expected")
    };
    assert!((rotation.value - 0.3_f64.to_radians()).abs() < 1e-4, "{rotation:?}");
    // In this configuration the tip is 0.4 to 0.6 m from the elbow's axis.
    assert!((0.4..0.6).contains(&(value / 0.3_f64.to_radians())), "{value}");
}

/// Moves the second goal to a pose that the arm does not reach.
fn give_up_a_goal(messages: &mut [Message]) {
    let second = messages.iter_mut().filter(|message| message.topic == GOAL).nth(1);
    let goal = second.expect("several goals");
    for field in goal.fields() {
        if let Field::Xyz(at, _) = field {
            let xyz: [f64; 3] = goal.floats(at);
            goal.set_floats(at, &[xyz[0] + 0.1, xyz[1], xyz[2] - 0.2]);
        }
    }
}

pub fn half_turn() -> Pose {
    pose([0.0; 3], rotation_from_rotvec(Vec3::z() * PI))
}

/// 60 mm to the side, tilted by 2° about x.
pub fn shifted() -> Pose {
    pose([0.02, -0.04, 0.04], rotation_from_rotvec(Vec3::x() * 2_f64.to_radians()))
}

/// Origin at a corner of the cell.
pub fn far_off() -> Pose {
    pose([-4.0, 6.0, 0.5], rotation_from_rotvec(Vec3::new(0.3, 0.1, -1.2)))
}

/// A tool 140 mm long, rotated by 90°.
pub fn tool() -> Pose {
    pose([0.0, 0.0, 0.14], rotation_from_rotvec(Vec3::z() * FRAC_PI_2))
}

/// Moves the frame `child` relative to its parent.
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

/// Adds a transform along x to each message of `topic`; `of` maps the message index to its x.
fn publish(
    messages: &mut Vec<Message>,
    topic: &str,
    of: impl Fn(usize) -> (&'static str, &'static str, f64),
) {
    let like: Vec<Message> =
        messages.iter().filter(|message| message.topic == topic).cloned().collect();
    let new = like.into_iter().enumerate().map(|(row, mut message)| {
        let (parent, child, x_m) = of(row);
        message.become_transform(parent, child, [x_m, 0.0, 0.0]);
        message.shift(1_000_000);
        message
    });
    messages.extend(new.collect::<Vec<_>>());
    messages.sort_by_key(|message| message.log_ns);
}

/// Scales the quaternions of `topic` by `factor` of the message index.
fn stretch(messages: &mut [Message], topic: &str, factor: impl Fn(usize) -> f64) {
    let of_topic = messages.iter_mut().filter(|message| message.topic == topic);
    for (row, message) in of_topic.enumerate() {
        for field in message.fields() {
            if let Field::Xyzw(at) = field {
                let xyzw: [f64; 4] = message.floats(at);
                message.set_floats(at, &xyzw.map(|component| factor(row) * component));
            }
        }
    }
}

/// Asserts that the evidence has `expected` as the finding's pose.
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
    assert!(report.findings.is_empty(), "{}", crate::checks::case::summary(&report.findings));
    let row = report.checks.iter().find(|row| row.code == "FRM002").expect("it was asked");
    // `reference_from_stream` relative to the base, as nothing else is known about the reference.
    assert_pose(&row.evidence["pose"], &far_off());
}
