//! FRM: wrong frames.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use poseaudit::finding::{Estimate, Severity};
use poseaudit::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use poseaudit::synth::{
    COMMANDED_JOINTS, COMMANDED_POSE, Commands, GOAL, LineMotion, Motion, POSE, TF, TF_STATIC,
    Task, ToolSlip,
};
use serde_json::Value;

use crate::checks::case::ExpectedEstimate::{self, AmountWithoutInterval, Frame};
use crate::checks::case::ExpectedSubject;
use crate::checks::case::{Expected, Log, cases, error, info, single_finding, warning};
use crate::checks::recording::{Field, Message, carry, freeze_samples, rename_topic, swing};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, Skipped};

const OBJECT: &str = "/workpiece/pose";
const BASE: ExpectedSubject = ExpectedSubject::Frame(POSE, "base");
const TIP: ExpectedSubject = ExpectedSubject::Frame(POSE, "tool0");
const TIP_OF_TF: ExpectedSubject = ExpectedSubject::Frame(TF, "tool0");

cases! {
    FRM001 a_static_transform_that_contradicts_the_model: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 0.003, 0.0]));
    } => warning(TIP_OF_TF, Frame([0.003, 0.1e-3], [0.0, 0.01]));
    FRM001 a_link_that_contradicts_the_model: |log| {
        log.edit = Some(|messages| move_frame(messages, TF, "forearm_link", [0.008, 0.0, 0.0]));
    } => error(TIP_OF_TF, Frame([0.008, 0.5e-3], [0.0, 0.01]));
    FRM001 a_tenth_of_a_millimetre_passes: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 1e-4, 0.0]));
    } => NoFindings;
    FRM001 a_zero_offset_is_not_a_finding_about_tf: |log| log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6)
        => OnlyOtherFinding("ZER001");
    FRM001 a_pose_in_another_frame_is_not_a_finding_about_tf: |log| {
        log.run.pose.reference_from_stream = base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    FRM001 a_late_tf_agrees_with_the_model: |log| log.run.tf.timing.latency_s = 0.05
        => OnlyOtherFinding("LAT001");
    FRM001 no_tf: |log| log.run.tf.timing.rate_hz = 0.0 => Skipped("no /tf");

    FRM002 a_base_rotated_by_180_degrees: |log| log.run.pose.reference_from_stream = base_rotated_by_180_degrees()
        => error(BASE, Frame([0.0, 0.05e-3], [180.0, 0.01]));
    FRM002 a_base_shifted_and_tilted: |log| log.run.pose.reference_from_stream = base_shifted_and_tilted()
        => error(BASE, Frame([0.06, 0.1e-3], [2.0, 0.02]));
    FRM002 a_base_shifted_by_2_5_millimetres: |log| {
        log.run.pose.reference_from_stream.translation.vector.y = -0.0025;
    } => warning(BASE, Frame([0.0025, 0.1e-3], [0.0, 0.02]));
    FRM002 a_tenth_of_a_millimetre_of_base_passes: |log| {
        log.run.pose.reference_from_stream.translation.vector.y = 1e-4;
    } => NoFindings;
    FRM002 a_tracker_world_frame_passes: |log| {
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = base_shifted_and_tilted();
    } => NoFindings;
    FRM002 the_first_joint_zero_offset_is_not_reported_as_frame_offset: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(0, 0.6);
    } => OnlyOtherFinding("ZER001");
    FRM002 a_tool_offset_is_not_reported_as_base_offset: |log| log.run.pose.tip_from_stream = tool_offset() => OnlyOtherFinding("FRM003");
    FRM002 millimetres_are_not_reported_as_base_offset: |log| log.run.pose.is_in_millimetres = true
        => OnlyOtherFinding("ORD008");
    FRM002 a_late_pose_is_not_reported_as_base_offset: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    FRM002 at_rest_a_base_offset_is_not_observable: |log| log.run.motion = Motion::AtRest
        => Inconclusive("turn the wrist");
    FRM002 no_pose_stream_for_a_base_offset: |log| log.run.pose.timing.rate_hz = 0.0
        => Skipped("no pose stream");

    FRM003 a_tool_offset_from_the_named_tip: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream = tool_offset();
    } => error(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_tool_offset_from_the_default_tip: |log| log.run.pose.tip_from_stream = tool_offset()
        => info(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 a_marker_offset_from_the_named_tip: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = base_shifted_and_tilted();
        log.run.pose.tip_from_stream = tool_offset();
    } => info(TIP, Frame([0.14, 0.1e-3], [90.0, 0.02]));
    FRM003 switching_between_two_markers: |log| {
        let tool_from_slipped = pose([0.03, 0.0, 0.04], rotation_from_rotvec(Vec3::z() * 2.0));
        log.run.pose.tool_slip = Some(ToolSlip { from_s: 3.0, to_s: 5.0, tool_from_slipped });
    } => error(TIP, Frame([0.05, 4e-3], [2_f64.to_degrees(), 1.0]));
    FRM003 a_tool_offset_of_2_millimetres: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 0.002;
    } => warning(TIP, Frame([0.002, 0.1e-3], [0.0, 0.02]));
    FRM003 a_tenth_of_a_millimetre_of_tool_passes: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.translation.vector.x = 1e-4;
    } => NoFindings;
    FRM003 the_last_joint_zero_offset_is_not_reported_as_tool_offset: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(5, 0.6);
    } => OnlyOtherFinding("ZER001");
    FRM003 a_tool_turned_about_the_last_axis_beside_an_imu: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.tip_from_stream.rotation = rotation_from_rotvec(Vec3::z() * FRAC_PI_4);
    } => error(TIP, Frame([0.0, 0.1e-3], [45.0, 0.02]));
    FRM003 a_rotated_base_is_not_reported_as_tool_offset: |log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.reference_from_stream = base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    FRM003 a_misread_rotation_is_not_reported_as_tool_offset: |log| log.run.pose.encoding = crate::checks::ord::misread_as_rpy()
        => OnlyOtherFinding("ORD001");
    FRM003 at_rest_a_tool_offset_is_not_observable: |log| log.run.motion = Motion::AtRest
        => Inconclusive("turn the wrist");
    FRM003 no_pose_stream_for_a_tool_offset: |log| log.run.pose.timing.rate_hz = 0.0
        => Skipped("no pose stream");

    FRM004 a_frame_with_two_parents: |log| {
        log.edit = Some(|messages| add_transforms(messages, TF, |row| {
            (if row % 2 == 0 { "cell" } else { "table" }, "fixture", 0.0)
        }));
    } => error(ExpectedSubject::Frame(TF, "fixture"), ExpectedEstimate::None);
    FRM004 a_cycle_of_two_frames: |log| {
        log.edit = Some(|messages| add_transforms(messages, TF, |row| {
            if row % 2 == 0 { ("cell", "fixture", 0.0) } else { ("fixture", "cell", 0.0) }
        }));
    } => error(ExpectedSubject::Frame(TF, "fixture"), ExpectedEstimate::None);
    FRM004 two_publishers_of_one_transform: |log| {
        log.edit = Some(|messages| add_transforms(messages, TF, |row| {
            ("cell", "fixture", if row % 3 == 0 { 0.05 } else { 0.0 })
        }));
    } => error(ExpectedSubject::Frame(TF, "fixture"), AmountWithoutInterval(0.05, 1e-9));
    FRM004 a_static_frame_that_moves: |log| {
        log.edit = Some(|messages| {
            add_transforms(messages, TF_STATIC, |_| ("cell", "fixture", 0.0));
            add_transforms(messages, TF_STATIC, |row| ("cell", "fixture", 0.02 * row as f64));
        });
    } => error(ExpectedSubject::Frame(TF_STATIC, "fixture"), AmountWithoutInterval(0.02, 1e-9));
    FRM004 a_pose_in_an_unconnected_frame_tree: |log| {
        log.run.pose.frame_id = "cell".to_owned();
        log.edit = Some(|messages| add_transforms(messages, TF_STATIC, |_| ("room", "cell", 0.3)));
    } => error(ExpectedSubject::Frame(TF, "cell"), ExpectedEstimate::None);
    FRM004 a_frame_that_is_reattached_passes: |log| {
        // Each of the two transforms has gaps while the other is published.
        log.options.policy.rules.ignore = vec!["TIM002".parse().expect("a rule")];
        log.edit = Some(|messages| add_transforms(messages, TF, |row| {
            (if row / 25 % 2 == 0 { "cell" } else { "table" }, "fixture", 0.0)
        }));
    } => NoFindings;
    FRM004 a_tracker_world_frame_may_be_unconnected: |log| {
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = base_shifted_and_tilted();
    } => NoFindings;
    FRM004 a_shifted_link_is_not_reported_as_a_tree_fault: |log| {
        log.edit = Some(|messages| move_frame(messages, TF_STATIC, "tool0", [0.0, 0.003, 0.0]));
    } => OnlyOtherFinding("FRM001");
    FRM004 no_frames: |log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.tf.has_static = false;
    } => Skipped("no /tf");

    FRM005 quaternions_of_norm_below_one: |log| {
        log.edit = Some(|messages| scale_quaternions(messages, POSE, |_| 0.985));
    } => error(ExpectedSubject::Topic(POSE), AmountWithoutInterval(0.015, 1e-9));
    FRM005 one_quaternion_in_ten_of_norm_above_one: |log| {
        log.edit = Some(|messages| {
            scale_quaternions(messages, POSE, |row| if row % 10 == 3 { 1.002 } else { 1.0 });
        });
    } => warning(ExpectedSubject::Topic(POSE), AmountWithoutInterval(0.002, 1e-9));
    FRM005 single_precision_passes: |log| {
        log.edit = Some(|messages| scale_quaternions(messages, POSE, |row| 1.0 + 1e-7 * (row % 3) as f64));
    } => NoFindings;
    FRM005 components_in_another_order_are_of_unit_norm: |log| {
        log.run.pose.encoding = crate::checks::ord::misread_as_rpy();
    } => OnlyOtherFinding("ORD001");
    FRM005 no_stream_with_quaternions: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.tf.has_static = false;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with quaternions");

    FRM007 a_pose_in_the_tool_frame_itself: |log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "tool0".to_owned();
    } => warning(ExpectedSubject::Topic(POSE), ExpectedEstimate::None);
    FRM007 every_tenth_pose_in_another_frame: |log| {
        log.edit = Some(|messages| crate::checks::recording::rename_frame(messages, POSE, 10));
    } => warning(ExpectedSubject::Topic(POSE), ExpectedEstimate::None);
    FRM007 a_pose_in_the_base: |_| () => NoFindings;
    FRM007 an_object_that_the_arm_carries: |log| {
        log.edit = Some(|messages| {
            carry(messages, POSE, 3.0, 5.0);
            rename_topic(messages, POSE, OBJECT);
        });
    } => info(ExpectedSubject::Topic(OBJECT), ExpectedEstimate::None);
    FRM007 a_pose_without_a_name_that_has_one_value: |log| {
        log.edit = Some(|messages| {
            freeze_samples(messages, POSE, -1.0, 9.0);
            rename_topic(messages, POSE, OBJECT);
        });
    } => warning(ExpectedSubject::Topic(OBJECT), ExpectedEstimate::None);
    FRM007 a_tool_pose_that_moves_otherwise: |log| {
        log.run.pose.frame_id = "mocap".to_owned();
        log.edit = Some(|messages| {
            swing(messages, POSE);
            rename_topic(messages, POSE, "/mocap/tool");
        });
    } => warning(ExpectedSubject::Topic("/mocap/tool"), ExpectedEstimate::None);
    FRM007 a_late_pose_without_a_name_is_no_object: |log| {
        log.run.pose.timing.latency_s = 2.5;
        log.edit = Some(|messages| rename_topic(messages, POSE, OBJECT));
    } => OnlyOtherFinding("LAT001");
    FRM007 a_pose_in_an_unconnected_world_frame: |log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "mocap_world".to_owned();
        log.run.pose.reference_from_stream = distant_world();
    } => NoFindings;
    FRM007 a_rotated_base_is_still_a_reference_frame: |log| {
        log.run.pose.reference_from_stream = base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    FRM007 no_joint_states: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no joint states");

    FRM006 goals_missed_by_three_millimetres: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.options.run.tip = Some("tool0".to_owned());
        log.run.reference.tip_from_commanded = Pose::translation(0.003, 0.0, 0.0);
    } => warning(ExpectedSubject::Topic(GOAL), Frame([0.003, 0.05e-3], [0.0, 0.01]));
    // The tip is on the last joint's axis.
    FRM006 a_wrist_that_stops_short_of_commanded_poses: |log| {
        follow_commands(log, Commands::Poses, 0.3);
        log.options.run.tip = Some("tool0".to_owned());
    } => warning(ExpectedSubject::Topic(COMMANDED_POSE), Frame([0.0, 0.05e-3], [0.3, 0.005]));
    FRM006 a_joint_that_stops_short_of_commands: |log| follow_commands(log, Commands::Joints, 0.7)
        => error(ExpectedSubject::Topic(COMMANDED_JOINTS), Frame([0.0, 0.05e-3], [0.7, 0.005]));
    FRM006 commands_for_another_tool_than_the_logged_one: |log| {
        follow_commands(log, Commands::Poses, 0.0);
        log.run.reference.tip_from_commanded = tool_offset();
    } => info(ExpectedSubject::Topic(COMMANDED_POSE), Frame([0.14, 0.2e-3], [90.0, 0.05]));
    FRM006 reached_goals: |log| follow_commands(log, Commands::Goals, 0.0) => NoFindings;
    FRM006 followed_poses: |log| follow_commands(log, Commands::Poses, 0.0) => NoFindings;
    FRM006 followed_joints: |log| follow_commands(log, Commands::Joints, 0.0) => NoFindings;
    FRM006 an_abandoned_goal: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.edit = Some(|messages| give_up_a_goal(messages));
    } => NoFindings;
    FRM006 goals_without_a_pose_stream: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.run.pose.timing.rate_hz = 0.0;
    } => NoFindings;
    FRM006 a_zero_offset_is_not_reported_as_a_missed_goal: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    FRM006 a_late_pose_reaches_its_goals: |log| {
        follow_commands(log, Commands::Poses, 0.0);
        log.run.pose.timing.latency_s = 0.05;
    } => OnlyOtherFinding("LAT001");
    FRM006 a_rotated_base_reaches_its_goals: |log| {
        follow_commands(log, Commands::Poses, 0.0);
        log.run.pose.reference_from_stream = base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    FRM006 a_misread_pose_reaches_its_goals: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.run.pose.encoding = crate::checks::ord::misread_as_rpy();
    } => OnlyOtherFinding("ORD001");
    FRM006 an_arm_that_never_rests: |log| {
        follow_commands(log, Commands::Poses, 0.0);
        log.run.motion = Motion::Continuous;
    } => Inconclusive("never rests");
    FRM006 a_goal_in_an_unconnected_frame: |log| {
        follow_commands(log, Commands::Goals, 0.0);
        log.run.reference.frame_id = "map".to_owned();
    } => Skipped("not fixed to the robot");
    FRM006 no_goals: |_| {} => Skipped("no goal");
}

/// The arm follows commanded lines; its last joint stays short by `short_by_degrees`.
fn follow_commands(log: &mut Log, commands: Commands, short_by_degrees: f64) {
    crate::checks::mot::follow_lines(log, LineMotion::default());
    log.run.reference.commands = commands;
    if short_by_degrees > 0.0 {
        log.run.reference.command_offset =
            vec![0.0, 0.0, 0.0, 0.0, 0.0, short_by_degrees.to_radians()];
    }
}

#[test]
fn an_elbow_that_stops_short_is_not_reported_as_tool_offset() {
    let report = Log::modified(|log| {
        follow_commands(log, Commands::Poses, 0.0);
        log.run.reference.command_offset = vec![0.0, 0.0, 0.3_f64.to_radians()];
    })
    .report();
    let found = single_finding(&report, "FRM006", COMMANDED_POSE);
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

pub fn base_rotated_by_180_degrees() -> Pose {
    pose([0.0; 3], rotation_from_rotvec(Vec3::z() * PI))
}

/// 60 mm to the side, tilted by 2° about x.
pub fn base_shifted_and_tilted() -> Pose {
    pose([0.02, -0.04, 0.04], rotation_from_rotvec(Vec3::x() * 2_f64.to_radians()))
}

/// Origin at a corner of the cell.
pub fn distant_world() -> Pose {
    pose([-4.0, 6.0, 0.5], rotation_from_rotvec(Vec3::new(0.3, 0.1, -1.2)))
}

/// A tool 140 mm long, rotated by 90°.
pub fn tool_offset() -> Pose {
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
fn add_transforms(
    messages: &mut Vec<Message>,
    topic: &str,
    transform_at: impl Fn(usize) -> (&'static str, &'static str, f64),
) {
    let of_topic: Vec<Message> =
        messages.iter().filter(|message| message.topic == topic).cloned().collect();
    let new = of_topic.into_iter().enumerate().map(|(row, mut message)| {
        let (parent, child, x_m) = transform_at(row);
        message.become_transform(parent, child, [x_m, 0.0, 0.0]);
        message.shift(1_000_000);
        message
    });
    messages.extend(new.collect::<Vec<_>>());
    messages.sort_by_key(|message| message.log_ns);
}

/// Scales the quaternions of `topic` by `factor` of the message index.
fn scale_quaternions(messages: &mut [Message], topic: &str, factor: impl Fn(usize) -> f64) {
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
fn base_and_tool_poses_have_the_documented_sign() {
    let report =
        Log::modified(|log| log.run.pose.reference_from_stream = base_shifted_and_tilted())
            .report();
    assert_pose(
        &single_finding(&report, "FRM002", POSE).evidence.more["pose"],
        &base_shifted_and_tilted(),
    );
    let report = Log::modified(|log| log.run.pose.tip_from_stream = tool_offset()).report();
    assert_pose(&single_finding(&report, "FRM003", POSE).evidence.more["pose"], &tool_offset());
}

/// At a constant orientation, only the tool's usual length limits how far the base is off.
#[test]
fn base_and_tool_are_reported_although_the_motion_does_not_separate_them() {
    for task in [Task::Palletising, Task::Welding] {
        let report = Log::modified(|log| {
            log.run.motion = Motion::Task(task);
            log.run.pose.reference_from_stream = distant_world();
            log.run.pose.tip_from_stream = tool_offset();
        })
        .report();
        let text = crate::checks::case::summary(&report.findings);
        assert!(report.findings.iter().all(|finding| finding.code != "MDL001"), "{text}");
        let Some(Estimate::Frame { ci95: Some([low_m, high_m]), .. }) =
            single_finding(&report, "FRM002", POSE).estimate
        else {
            panic!("{text}")
        };
        let distance_m = distant_world().translation.vector.norm();
        assert!((low_m - 0.1..high_m + 0.1).contains(&distance_m), "{text}");
    }
}

/// A base rotated by hundredths of a degree absorbs more of the link deviations than the tool does.
#[test]
fn a_tool_of_constant_orientation_is_no_displaced_base_although_links_deviate() {
    for task in [Task::Drawer, Task::Palletising, Task::Welding] {
        let report = Log::modified(|log| {
            log.run.motion = Motion::Task(task);
            crate::checks::mdl::add_link_deviations_times(&mut log.run, 0.2);
            log.run.pose.tip_from_stream = Pose::translation(0.0, 0.0, 0.15);
        })
        .report();
        let text = crate::checks::case::summary(&report.findings);
        assert!(report.findings.iter().all(|finding| finding.code != "FRM002"), "{text}");
        single_finding(&report, "FRM003", POSE);
    }
}

#[test]
fn an_unconnected_world_frame_is_estimated_and_not_judged() {
    let report = Log::modified(|log| {
        log.run.motion = Motion::Continuous;
        log.run.pose.frame_id = "tracker".to_owned();
        log.run.pose.reference_from_stream = distant_world();
    })
    .report();
    assert!(report.findings.is_empty(), "{}", crate::checks::case::summary(&report.findings));
    let row = report.checks.iter().find(|row| row.code == "FRM002").expect("it was asked");
    // `reference_from_stream` relative to the base, as nothing else is known about the reference.
    assert_pose(&row.evidence["pose"], &distant_world());
}
