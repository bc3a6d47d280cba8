//! ORD: misinterpreted conventions, units and orders.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fs;
use std::path::Path;

use poseaudit::finding::{CheckRow, Severity, Status};
use poseaudit::geometry::{
    Axes, Convention, Misinterpretation, QuaternionOrderError, rotation_from_xyzw,
    xyzw_from_rotation,
};
use poseaudit::report::Report;
use poseaudit::synth::{IMU, JOINT_STATES, LoggedEncoding, Motion, POSE, Task};

use crate::checks::case::ExpectedEstimate::{self, Degrees, IsReadAs, Order};
use crate::checks::case::ExpectedSubject::{self, JointOf, Topic};
use crate::checks::case::{Expected, Log, cases, error, single_finding, summary, warning};
use crate::checks::recording::{Field, Message, drop_messages, freeze_samples, rename_topic};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, OtherFindingAndInconclusive, Skipped};

/// Topic of a tracked body on the tool.
const MARKER: &str = "/vicon/tool_marker/pose";
/// Topic of the poses as unnamed numbers.
const NUMBERS: &str = "/arm/tool_vector";

cases! {
    ORD001 a_rotation_vector_read_as_rpy: |log| log.run.pose.encoding = misread_as_rpy()
        => error(Topic(POSE), IsReadAs("rotvec", "euler:xyz"));
    ORD001 intrinsic_angles_read_as_extrinsic: |log| log.run.pose.encoding = misread("euler:xyz", "euler:XYZ")
        => error(Topic(POSE), IsReadAs("euler:xyz", "euler:XYZ"));
    ORD001 zyz_read_as_rpy: |log| log.run.pose.encoding = misread("euler:ZYZ", "euler:xyz")
        => error(Topic(POSE), IsReadAs("euler:ZYZ", "euler:xyz"));
    ORD001 zyx_read_as_rpy: |log| log.run.pose.encoding = misread("euler:ZYX", "euler:xyz")
        => error(Topic(POSE), IsReadAs("euler:ZYX", "euler:xyz"));
    ORD001 rpy_read_as_a_rotation_vector: |log| {
        log.run.pose.encoding = misread("euler:xyz", "rotvec");
    } => error(Topic(POSE), IsReadAs("euler:xyz", "rotvec"));
    ORD001 euler_angles_in_another_axis_order: |log| {
        log.run.pose.encoding = misread("euler:xzy@axes", "euler:xyz");
    } => error(Topic(POSE), IsReadAs("euler:xzy@axes", "euler:xyz"));
    ORD001 a_misread_imu: |log| log.run.imu.encoding = misread("euler:ZYX", "euler:xyz")
        => error(Topic(IMU), IsReadAs("euler:ZYX", "euler:xyz"));

    ORD001 rotations_beyond_180_degrees_pass: |log| {
        // The tool's orientation passes 180°, where quaternions change sign.
        log.run.home = vec![0.4, -1.2, 1.2, -1.6, -1.57, 3.0];
        log.run.motion = Motion::Continuous;
    } => NoFindings;

    ORD001 a_wrong_quaternion_order_is_not_reported_as_rotation_encoding: |log| {
        log.run.pose.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
    } => OnlyOtherFinding("ORD002");
    ORD001 a_transpose_is_not_reported_as_rotation_encoding: |log| log.run.pose.encoding = LoggedEncoding::Transposed
        => OnlyOtherFinding("ORD003");
    ORD001 a_rotated_base_is_not_reported_as_rotation_encoding: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    ORD001 a_late_pose_is_not_reported_as_rotation_encoding: |log| log.run.pose.timing.latency_s = 0.1
        => OnlyOtherFinding("LAT001");

    ORD001 no_orientations: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.has_orientation = false;
    } => Skipped("no");

    ORD002 w_first_read_as_w_last: |log| {
        log.run.pose.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(POSE), IsReadAs("quat:wxyz", "quat:xyzw"));
    ORD002 w_last_read_as_w_first: |log| {
        log.run.pose.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::XyzwReadAsWxyz);
    } => error(Topic(POSE), IsReadAs("quat:xyzw", "quat:wxyz"));
    ORD002 an_imu_with_w_first: |log| {
        log.run.imu.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(IMU), IsReadAs("quat:wxyz", "quat:xyzw"));
    ORD002 quaternions_of_either_sign_pass: |log| log.edit = Some(|messages| flip_quaternion_signs(messages)) => NoFindings;
    ORD002 a_misread_rotation_is_not_reported_as_quaternion_order: |log| log.run.pose.encoding = misread_as_rpy()
        => OnlyOtherFinding("ORD001");
    ORD002 an_inverse_is_not_reported_as_quaternion_order: |log| log.run.pose.encoding = LoggedEncoding::Inverted
        => OnlyOtherFinding("ORD003");
    ORD002 no_quaternions: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with orientations");

    ORD003 an_inverted_pose: |log| log.run.pose.encoding = LoggedEncoding::Inverted
        => error(Topic(POSE), IsReadAs("pose-inverse", "pose"));
    ORD003 an_inverted_pose_of_a_tracker_is_no_camera_target: |log| {
        log.run.pose.encoding = LoggedEncoding::Inverted;
        log.run.pose.frame_id = "vicon".to_owned();
        log.edit = Some(|messages| rename_topic(messages, POSE, MARKER));
    } => error(Topic(MARKER), IsReadAs("pose-inverse", "pose"));
    ORD003 a_transposed_rotation: |log| log.run.pose.encoding = LoggedEncoding::Transposed
        => error(Topic(POSE), IsReadAs("transpose", "pose"));
    ORD003 an_inverted_imu: |log| log.run.imu.encoding = LoggedEncoding::Transposed
        => error(Topic(IMU), IsReadAs("transpose", "pose"));
    ORD003 a_shifted_base_passes: |log| log.run.imu.world_yaw_rad = 2.9 => NoFindings;
    ORD003 a_misread_rotation_is_not_reported_as_inverse: |log| {
        log.run.pose.encoding = misread("euler:ZYX", "euler:xyz");
    } => OnlyOtherFinding("ORD001");
    ORD003 a_wrong_quaternion_order_is_not_reported_as_inverse: |log| {
        log.run.pose.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::XyzwReadAsWxyz);
    } => OnlyOtherFinding("ORD002");
    ORD003 a_tool_offset_is_not_reported_as_inverse: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool_offset()
        => OnlyOtherFinding("FRM003");
    ORD003 no_poses: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with orientations");

    ORD004 joints_in_degrees: |log| log.run.joints.is_in_degrees = true
        => error(Topic(JOINT_STATES), IsReadAs("deg", "rad"));
    ORD004 joints_near_zero_pass: |log| {
        log.run.home = vec![0.0; 6];
        log.run.amplitude = 0.1;
    } => NoFindings;
    ORD004 joints_in_another_order_are_not_reported_as_degrees: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => OnlyOtherFinding("ORD005");
    ORD004 millimetres_are_not_reported_as_degrees: |log| log.run.pose.is_in_millimetres = true
        => OnlyOtherFinding("ORD008");
    ORD004 joints_in_degrees_at_rest: |log| {
        (log.run.joints.is_in_degrees, log.run.motion) = (true, Motion::AtRest);
    } => error(Topic(JOINT_STATES), IsReadAs("deg", "rad"));
    ORD004 correct_joints_at_rest_pass: |log| log.run.motion = Motion::AtRest => NoFindings;
    ORD004 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD004 no_stream_to_compare_joints_with: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Inconclusive("log a pose");

    ORD005 positions_in_alphabetical_order: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => error(Topic(JOINT_STATES), Order(&[
        "elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint",
        "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
    ]));
    ORD005 positions_rotated_by_one_joint: |log| {
        log.run.joints.number_order = Some(vec![5, 0, 1, 2, 3, 4]);
    } => error(Topic(JOINT_STATES), Order(&[
        "wrist_3_joint", "shoulder_pan_joint", "shoulder_lift_joint",
        "elbow_joint", "wrist_1_joint", "wrist_2_joint",
    ]));
    ORD005 names_and_positions_in_the_same_order_pass: |log| {
        log.edit = Some(|messages| reorder_joints(messages, [2, 1, 0, 3, 4, 5]));
    } => NoFindings;
    ORD005 joints_in_degrees_are_not_reported_as_joint_order: |log| log.run.joints.is_in_degrees = true => OnlyOtherFinding("ORD004");
    ORD005 zero_offsets_are_not_reported_as_joint_order: |log| {
        log.run.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.05];
    } => OnlyOtherFinding("ZER001");
    ORD005 no_names: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD005 only_streams_derived_from_the_names: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Inconclusive("log a pose that does not come from /tf");

    ORD006 rpy_at_gimbal_lock: |log| {
        move_first_joint_only(log);
        declare_encoding(log, |messages| poses_to_euler_numbers(messages, Convention::RPY, 1.0), "euler:xyz");
    } => warning(Topic(NUMBERS), ExpectedEstimate::AmountWithoutInterval(1.0, 1e-9));
    ORD006 rpy_far_from_gimbal_lock_passes: |log| {
        (log.run.amplitude, log.run.speed) = (0.3, 1.0);
        declare_encoding(log, |messages| poses_to_euler_numbers(messages, Convention::RPY, 1.0), "euler:xyz");
    } => NoFindings;
    ORD006 a_rotation_vector_is_not_reported_as_gimbal_lock: |log| {
        move_first_joint_only(log);
        declare_encoding(log, |messages| poses_to_numbers(messages, 1.0), "rotvec");
    } => NoFindings;
    ORD006 angles_in_degrees_are_not_reported_as_gimbal_lock: |log| {
        declare_encoding(log, |messages| poses_to_numbers(messages, 1_f64.to_degrees()), "rotvec");
    } => OnlyOtherFinding("ORD004");
    ORD006 undeclared_angles_are_not_checked_for_gimbal_lock: |log| {
        move_first_joint_only(log);
        log.options.policy.rules.ignore = vec!["TIM005".parse().expect("a rule")];
        log.edit = Some(|messages| poses_to_euler_numbers(messages, Convention::RPY, 1.0));
    } => Inconclusive("its convention is not declared");
    ORD006 no_unnamed_numbers: |_| {} => Skipped("no stream uses Euler angles");

    ORD007 a_standard_dh_table_declared_as_modified: |log| use_dh_table(log, "modified", [""; 2])
        => error(ExpectedSubject::Robot, IsReadAs("standard", "modified"));
    ORD007 a_dh_table_declared_correctly: |log| use_dh_table(log, "standard", [""; 2]) => NoFindings;
    ORD007 a_zero_offset_is_not_reported_as_dh_convention: |log| {
        use_dh_table(log, "standard", [""; 2]);
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    ORD007 a_misread_rotation_is_not_reported_as_dh_convention: |log| {
        use_dh_table(log, "standard", [""; 2]);
        log.run.pose.encoding = misread_as_rpy();
    } => OnlyOtherFinding("ORD001");
    ORD007 a_shifted_base_is_not_reported_as_dh_convention: |log| {
        use_dh_table(log, "standard", [""; 2]);
        log.run.pose.reference_from_stream = crate::checks::frm::base_shifted_and_tilted();
    } => OnlyOtherFinding("FRM002");
    ORD007 a_dh_table_of_another_arm_is_not_reported_as_dh_convention: |log| {
        use_dh_table(log, "standard", ["-0.425", "-0.365"]);
    } => OtherFindingAndInconclusive("MDL001", "wrong robot model");
    ORD007 a_urdf: |_| {} => Skipped("DH convention");
    ORD007 no_stream_to_compare_the_dh_table_with: |log| {
        use_dh_table(log, "modified", [""; 2]);
        log.run.pose.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD008 positions_in_millimetres: |log| log.run.pose.is_in_millimetres = true
        => error(Topic(POSE), IsReadAs("mm", "m"));
    ORD008 positions_in_centimetres: |log| log.edit = Some(|messages| convert_unit(messages, 1e-2))
        => error(Topic(POSE), IsReadAs("cm", "m"));
    ORD008 positions_in_inches: |log| log.edit = Some(|messages| convert_unit(messages, 0.0254))
        => error(Topic(POSE), IsReadAs("in", "m"));
    ORD008 positions_in_tenths_of_a_millimetre: |log| {
        log.edit = Some(|messages| convert_unit(messages, 1e-4));
    } => error(Topic(POSE), IsReadAs("0.1 mm", "m"));
    ORD008 positions_in_kilometres: |log| log.edit = Some(|messages| convert_unit(messages, 1e3))
        => error(Topic(POSE), IsReadAs("km", "m"));
    ORD008 positions_in_an_unknown_unit: |log| {
        log.edit = Some(|messages| convert_unit(messages, 0.0043));
    } => error(Topic(POSE), IsReadAs("0.004300 m", "m"));
    ORD008 mirrored_axes_are_not_reported_as_unit: |log| log.edit = Some(|messages| convert_axes(messages, UNITY, UNITY))
        => OnlyOtherFinding("ORD010");
    ORD008 a_scale_of_one_percent_is_not_reported_as_unit: |log| log.run.pose.radial_scale_error = 0.3e-3 => NoFindings;
    ORD008 joints_in_degrees_are_not_reported_as_millimetres: |log| log.run.joints.is_in_degrees = true
        => OnlyOtherFinding("ORD004");
    ORD008 a_distant_frame_is_not_reported_as_unit: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::distant_world();
    } => OnlyOtherFinding("FRM002");
    ORD008 no_positions: |log| {
        log.run.imu.timing.rate_hz = 0.0;
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD009 a_reversed_joint: |log| log.run.joints.scales = vec![1.0, 1.0, -1.0]
        => error(JointOf(JOINT_STATES, "elbow_joint"), ExpectedEstimate::Amount(-1.0, 1e-3));
    ORD009 a_reversed_wrist: |log| {
        log.run.joints.scales = vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0];
    } => error(JointOf(JOINT_STATES, "wrist_3_joint"), ExpectedEstimate::Amount(-1.0, 1e-3));
    ORD009 a_reversed_wrist_of_a_noisy_small_motion: |log| {
        log.run.joints.scales = vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0];
        log.run.motion = Motion::Task(Task::Servoing);
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (8e-4, 2e-3);
    } => error(JointOf(JOINT_STATES, "wrist_3_joint"), ExpectedEstimate::Amount(-1.0, 0.02));
    ORD009 a_gear_ratio_applied_twice: |log| log.run.joints.scales = vec![1.0, 0.5]
        => error(JointOf(JOINT_STATES, "shoulder_lift_joint"), ExpectedEstimate::Amount(2.0, 2e-3));
    ORD009 positions_in_encoder_ticks: |log| log.run.joints.scales = vec![4096.0 / TAU; 6]
        => error(Topic(JOINT_STATES), ExpectedEstimate::Amount(TAU / 4096.0, 1e-6));
    ORD009 joints_in_degrees_are_not_reported_as_joint_scale: |log| log.run.joints.is_in_degrees = true
        => OnlyOtherFinding("ORD004");
    ORD009 joints_in_another_order_are_not_reported_as_joint_scale: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => OnlyOtherFinding("ORD005");
    ORD009 a_large_zero_offset_is_not_reported_as_joint_scale: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 120.0);
    } => OnlyOtherFinding("ZER001");
    ORD009 a_rotated_base_is_not_reported_as_joint_scale: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    ORD009 correct_joint_scales_pass: |_| {} => NoFindings;
    ORD009 no_joint_states_to_scale: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD009 only_streams_derived_from_the_joints: |log| {
        log.run.joints.scales = vec![1.0, 1.0, -1.0];
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Inconclusive("log a pose that does not come from /tf");

    ORD010 y_up_and_left_handed: |log| log.edit = Some(|messages| convert_axes(messages, UNITY, UNITY))
        => error(Topic(POSE), IsReadAs("x right, y up, z forward (left-handed)", STANDARD));
    ORD010 y_and_z_exchanged: |log| log.edit = Some(|messages| convert_axes(messages, EXCHANGED, EXCHANGED))
        => error(Topic(POSE), IsReadAs("x forward, y up, z left (left-handed)", STANDARD));
    ORD010 wrong_axes_of_positions_only: |log| log.edit = Some(|messages| convert_axes(messages, OPTICAL, STANDARD))
        => error(Topic(POSE), IsReadAs("positions x right, y down, z forward", STANDARD));
    ORD010 wrong_axes_of_rotations_only: |log| log.edit = Some(|messages| convert_axes(messages, STANDARD, HALF))
        => error(Topic(POSE), IsReadAs("rotations x forward, y right, z down", STANDARD));
    ORD010 wrong_axes_of_base_and_tool: |log| log.edit = Some(|messages| convert_axes(messages, OPTICAL, OPTICAL))
        => error(Topic(POSE), IsReadAs("x right, y down, z forward", STANDARD));
    ORD010 correct_axes: |_| {} => NoFindings;
    ORD010 a_rotated_base_is_not_reported_as_axis_convention: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    ORD010 an_inverse_is_not_reported_as_axis_convention: |log| log.run.pose.encoding = LoggedEncoding::Inverted
        => OnlyOtherFinding("ORD003");
    ORD010 no_poses_with_axes: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD011 z_that_is_always_zero: |log| log.edit = Some(|messages| zero_coordinate(messages, 2))
        => error(Topic(POSE), ExpectedEstimate::AmountWithoutInterval(0.5, 0.45));
    ORD011 x_that_is_always_zero: |log| log.edit = Some(|messages| zero_coordinate(messages, 0))
        => error(Topic(POSE), ExpectedEstimate::AmountWithoutInterval(0.5, 0.45));
    ORD011 an_arm_at_rest_passes: |log| log.run.motion = Motion::AtRest => NoFindings;
    ORD011 a_motion_of_only_the_first_joint_passes: |log| {
        log.run.motion = Motion::OneJoint(0);
        log.run.speed *= 0.5;
    } => NoFindings;
    ORD011 a_constant_pose_is_not_reported_as_constant_coordinate: |log| {
        log.edit = Some(|messages| {
            freeze_samples(messages, POSE, -1.0, 9.0);
            drop_messages(messages, POSE, 1.0, 9.0);
        });
    } => OnlyOtherFinding("FRM007");
    ORD011 millimetres_are_not_reported_as_constant_coordinate: |log| log.run.pose.is_in_millimetres = true
        => OnlyOtherFinding("ORD008");
    ORD011 no_poses_with_coordinates: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");
}

#[test]
fn an_inverted_pose_is_found_together_with_a_misread_rotation() {
    for (coding, code, is, read_as) in [
        (
            LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw),
            "ORD002",
            "quat:wxyz",
            "quat:xyzw",
        ),
        (misread_as_rpy(), "ORD001", "rotvec", "euler:xyz"),
    ] {
        let report = Log::modified(|log| {
            log.run.pose.encoding = coding;
            log.run.pose.is_inverted = true;
        });
        let report = report.report();
        IsReadAs(is, read_as).assert_matches(single_finding(&report, code, POSE).estimate.as_ref());
        let inverse = single_finding(&report, "ORD003", POSE);
        IsReadAs("pose-inverse", "pose").assert_matches(inverse.estimate.as_ref());
        assert_eq!(report.findings.len(), 2, "{}", summary(&report.findings));
    }
}

/// The orientation of the inverse pose is nearly that of a tool that points down.
#[test]
fn positions_show_the_inverse_pose_of_a_tool_that_points_down() {
    for task in [Task::Palletising, Task::Picking, Task::Conveyor] {
        let report = Log::modified(|log| {
            log.run.motion = Motion::Task(task);
            log.run.pose.encoding = LoggedEncoding::Inverted;
        })
        .report();
        let inverse = single_finding(&report, "ORD003", POSE);
        IsReadAs("pose-inverse", "pose").assert_matches(inverse.estimate.as_ref());
        assert_eq!(report.findings.len(), 1, "{task:?}: {}", summary(&report.findings));
    }
}

#[test]
fn positions_are_audited_without_orientations() {
    for unset in [[0.0; 4], [0.0, 0.0, 0.0, 1.0], [f64::NAN; 4]] {
        let report = Log::modified(|log| {
            log.run.pose.timing.latency_s = 0.025;
            log.edit = Some(match unset {
                [_, _, _, 1.0] => |messages| set_orientation(messages, [0.0, 0.0, 0.0, 1.0]),
                [part, ..] if part.is_nan() => |messages| set_orientation(messages, [f64::NAN; 4]),
                _ => |messages| set_orientation(messages, [0.0; 4]),
            });
        });
        let report = report.report();
        let late = single_finding(&report, "LAT001", POSE);
        ExpectedEstimate::Amount(0.025, 1e-3).assert_matches(late.estimate.as_ref());
        let row =
            report.checks.iter().find(|row| row.code == "ORD001" && row.subject.label() == POSE);
        let why = row.and_then(|row| row.reason.as_deref()).unwrap_or_default();
        assert!(why.contains("never set"), "{unset:?}: {why}");
    }
}

/// Such as commanded joints of an arm with seven joints.
#[test]
fn seven_numbers_without_a_quaternion_are_not_a_pose() {
    const VECTOR: &str = "/arm/vector";
    let report = Log::modified(|log| {
        log.edit = Some(|messages| {
            let poses = messages.iter().filter(|message| message.topic == POSE).cloned();
            let vectors = poses.map(|mut message| {
                let numbers = message.fields().into_iter().flat_map(|field| match field {
                    Field::Stamp(_) => Vec::new(),
                    Field::Xyz(at, _) => message.floats::<3>(at).to_vec(),
                    Field::Xyzw(at) => message.floats::<4>(at).map(|part| 2.2 * part).to_vec(),
                });
                let numbers: Vec<f64> = numbers.collect();
                message.become_array(VECTOR, &numbers);
                message
            });
            let vectors: Vec<Message> = vectors.collect();
            messages.extend(vectors);
        });
    })
    .report();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    let vector = report.streams.iter().find(|row| row.topic == VECTOR).expect("a stream");
    assert!(vector.reason.contains("not a quaternion"), "{}", vector.reason);
}

/// The report on a log with poses as unnamed numbers, without the finding about missing stamps.
fn report_of_numbers(edit: fn(&mut Vec<Message>)) -> Report {
    let mut report = Log::modified(|log| log.edit = Some(edit)).report();
    let stamps = single_finding(&report, "TIM005", NUMBERS);
    assert_eq!(stamps.severity, Severity::Info);
    report.findings.retain(|finding| finding.code != "TIM005");
    let reading = single_finding(&report, "ORD001", NUMBERS);
    assert_eq!(reading.severity, Severity::Info);
    assert_eq!(report.findings.len(), 1, "{}", summary(&report.findings));
    report
}

#[test]
fn other_faults_are_found_despite_a_wrong_dh_convention() {
    let report = Log::modified(|log| {
        use_dh_table(log, "modified", [""; 2]);
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
        log.run.pose.timing.latency_s = 0.015;
    });
    let report = report.report();
    let mut codes: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    codes.sort_unstable();
    assert_eq!(codes, ["LAT001", "ORD007", "ZER001"], "{}", summary(&report.findings));
    Degrees(0.6, 0.02)
        .assert_matches(single_finding(&report, "ZER001", "elbow_joint").estimate.as_ref());
    let source = &report.robots[0].source;
    assert!(source.ends_with("DH table interpreted as standard"), "{source}");
}

#[test]
fn unnamed_numbers_get_the_encoding_that_fits_the_arm() {
    let report = report_of_numbers(|messages| poses_to_numbers(messages, 1.0));
    let message = &single_finding(&report, "ORD001", NUMBERS).message;
    assert!(
        message.starts_with("assumed m, rotvec in rad (as Universal Robots does)"),
        "{message}"
    );
}

#[test]
fn unnamed_numbers_may_be_degrees() {
    let report = report_of_numbers(|messages| poses_to_numbers(messages, 1_f64.to_degrees()));
    let message = &single_finding(&report, "ORD001", NUMBERS).message;
    assert!(message.starts_with("assumed m, rotvec in deg"), "{message}");
    for code in ["ORD004", "ORD006", "ORD008"] {
        let rows =
            report.checks.iter().filter(|row| row.code == code && row.subject.label() == NUMBERS);
        assert!(
            rows.clone().count() == 1 && rows.clone().all(|row| row.status == Status::Pass),
            "{code}"
        );
    }
}

#[test]
fn wrongly_declared_units_are_reported_as_units() {
    let in_radians = |messages: &mut Vec<Message>| poses_to_numbers(messages, 1.0);
    let in_degrees = |messages: &mut Vec<Message>| poses_to_numbers(messages, 1_f64.to_degrees());
    let metres_as_millimetres = ("ORD008", IsReadAs("m", "mm"));
    let radians_as_degrees = ("ORD004", IsReadAs("rad", "deg"));
    let degrees_as_radians = ("ORD004", IsReadAs("deg", "rad"));
    type Declared<'a> = (&'a str, fn(&mut Vec<Message>), &'a [(&'a str, ExpectedEstimate)]);
    let logs: [Declared<'_>; 6] = [
        ("rotvec", in_radians, &[]),
        ("rotvec,deg", in_degrees, &[]),
        ("rotvec,mm", in_radians, &[metres_as_millimetres]),
        ("rotvec,deg", in_radians, &[radians_as_degrees]),
        ("rotvec", in_degrees, &[degrees_as_radians]),
        ("rotvec,deg,mm", in_radians, &[radians_as_degrees, metres_as_millimetres]),
    ];
    for (declared, edit, expected) in logs {
        let report = Log::modified(|log| {
            log.edit = Some(edit);
            let declaration = format!("{NUMBERS}={declared}");
            log.options.run.declared = vec![declaration.parse().expect("a declaration")];
        });
        let mut report = report.report();
        report.findings.retain(|finding| finding.code != "TIM005");
        let found = summary(&report.findings);
        assert_eq!(report.findings.len(), expected.len(), "{declared}:\n{found}");
        for (code, what) in expected {
            let finding = single_finding(&report, code, NUMBERS);
            what.assert_matches(finding.estimate.as_ref());
            assert!(finding.message.contains("declared as"), "{found}");
        }
    }
}

#[test]
fn at_rest_an_encoding_passes_only_if_no_frame_is_a_confounder() {
    let report = Log::modified(|log| log.run.motion = Motion::AtRest).report();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    for code in ["ORD001", "ORD002", "ORD003"] {
        let row_of = |topic: &str| {
            let is_meant = |row: &&CheckRow| row.code == code && row.subject.label() == topic;
            report.checks.iter().find(is_meant).expect("it is asked")
        };
        // The pose's frames are links of the arm; the IMU's world frame may have any rotation.
        assert_eq!(row_of(POSE).status, Status::Pass, "{:#?}", row_of(POSE));
        assert_eq!(row_of(IMU).status, Status::Inconclusive, "{:#?}", row_of(IMU));
        assert!(row_of(IMU).reason.as_deref().is_some_and(|why| why.contains("turn the wrist")));
    }
}

pub fn misread(is: &str, read_as: &str) -> LoggedEncoding {
    let convention = |name: &str| name.parse().expect("a convention's name");
    LoggedEncoding::Misinterpreted(Misinterpretation {
        is: convention(is),
        read_as: convention(read_as),
    })
}

pub fn misread_as_rpy() -> LoggedEncoding {
    LoggedEncoding::Misinterpreted(Misinterpretation {
        is: Convention::RotVec,
        read_as: Convention::RPY,
    })
}

/// Axes by name.
const STANDARD: &str = "x forward, y left, z up";
const UNITY: &str = "x right, y up, z forward (left-handed)";
const EXCHANGED: &str = "x forward, y up, z left (left-handed)";
const OPTICAL: &str = "x right, y down, z forward";
const HALF: &str = "x forward, y right, z down";

/// Writes positions and rotations of the poses in these axes.
pub fn convert_axes(messages: &mut [Message], positions: &str, rotations: &str) {
    let axes = |name: &str| -> Axes { name.parse().expect("axes") };
    let (positions, turn) = (axes(positions), axes(rotations).conjugator());
    edit_poses(messages, |xyz, xyzw| {
        let rotation = rotation_from_xyzw(xyzw).expect("a rotation");
        let own = xyzw_from_rotation(&(turn * rotation * turn.inverse()));
        (positions.convert_from_standard(xyz.into()).into(), own)
    });
}

/// Writes the positions of the poses in a unit of this many metres.
pub fn convert_unit(messages: &mut [Message], metres: f64) {
    edit_poses(messages, |xyz, xyzw| (xyz.map(|part| part / metres), xyzw));
}

/// Sets one coordinate of the poses to zero.
fn zero_coordinate(messages: &mut [Message], axis: usize) {
    edit_poses(messages, |mut xyz, xyzw| {
        xyz[axis] = 0.0;
        (xyz, xyzw)
    });
}

/// Sets all poses to one orientation.
fn set_orientation(messages: &mut [Message], xyzw: [f64; 4]) {
    edit_poses(messages, |xyz, _| (xyz, xyzw));
}

fn edit_poses(messages: &mut [Message], edit: impl Fn([f64; 3], [f64; 4]) -> ([f64; 3], [f64; 4])) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let places = message.fields().into_iter().fold([0; 2], |places, field| match field {
            Field::Stamp(_) => places,
            Field::Xyz(at, _) => [at, places[1]],
            Field::Xyzw(at) => [places[0], at],
        });
        let (xyz, xyzw) = edit(message.floats(places[0]), message.floats(places[1]));
        message.set_floats(places[0], &xyz);
        message.set_floats(places[1], &xyzw);
    }
}

/// DH rows of a UR5e, standard convention.
const ROWS: &str = "\
rows = [
  [0.0, 0.1625, 1.5707963267948966, 0.0],
  [-0.425, 0.0, 0.0, 0.0],
  [-0.3922, 0.0, 0.0, 0.0],
  [0.0, 0.1333, 1.5707963267948966, 0.0],
  [0.0, 0.0997, -1.5707963267948966, 0.0],
  [0.0, 0.0996, 0.0, 0.0],
]
";

/// Audits with a DH table that declares this convention, with one text replaced. The frames of the log's
/// /tf are not links of a table.
pub fn use_dh_table(log: &mut Log, convention: &str, [from, to]: [&str; 2]) {
    let rows = if from.is_empty() { ROWS.to_owned() } else { ROWS.replacen(from, to, 1) };
    let names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    let names = names.map(|name| format!("\"{name}_joint\"")).join(", ");
    let text = format!(
        "[dh]\nconvention = \"{convention}\"\nbase = \"base\"\ntip = \"tool0\"\n{rows}\
         joint_names = [{names}]\n"
    );
    let name = format!("ur5e-{convention}-{to}.toml");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let file = folder.join(name);
    // Tests that run in parallel write the same file.
    let staged = tempfile::NamedTempFile::new_in(folder).expect("the tests may write there");
    fs::write(staged.path(), text).expect("a file");
    staged.persist(&file).expect("a file");
    log.options.run.robots = vec![file.display().to_string().as_str().into()];
    log.run.tf.timing.rate_hz = 0.0;
}

/// Turns the poses into six unnamed numbers: position, and rotation vector in units of 1 / `per_radian`
/// rad.
pub fn poses_to_numbers(messages: &mut [Message], per_radian: f64) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let mut numbers = Vec::new();
        for field in message.fields() {
            match field {
                Field::Stamp(_) => {}
                Field::Xyz(at, _) => numbers.extend(message.floats::<3>(at)),
                Field::Xyzw(at) => {
                    let rotation = rotation_from_xyzw(message.floats(at)).expect("a rotation");
                    let rotvec = Convention::RotVec.numbers(&rotation);
                    numbers.extend(rotvec.map(|radians| radians * per_radian));
                }
            }
        }
        message.become_array(NUMBERS, &numbers);
    }
}

/// The same with three Euler angles.
pub fn poses_to_euler_numbers(messages: &mut [Message], convention: Convention, per_radian: f64) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let mut numbers = Vec::new();
        for field in message.fields() {
            match field {
                Field::Stamp(_) => {}
                Field::Xyz(at, _) => numbers.extend(message.floats::<3>(at)),
                Field::Xyzw(at) => {
                    let rotation = rotation_from_xyzw(message.floats(at)).expect("a rotation");
                    let angles = convention.numbers(&rotation);
                    numbers.extend(angles.map(|angle| angle * per_radian));
                }
            }
        }
        message.become_array(NUMBERS, &numbers);
    }
}

/// Declares the encoding of the unnamed numbers, and ignores their missing stamps.
pub fn declare_encoding(log: &mut Log, edit: fn(&mut Vec<Message>), convention: &str) {
    let declaration = format!("{NUMBERS}={convention}");
    log.options.run.declared = vec![declaration.parse().expect("a declaration")];
    log.options.policy.rules.ignore = vec!["TIM005".parse().expect("a rule")];
    log.edit = Some(edit);
}

/// Rotates only the first joint, so that roll and pitch of the tool stay constant; with a straight second
/// wrist, the tool's x axis points up.
fn move_first_joint_only(log: &mut Log) {
    log.run.motion = Motion::OneJoint(0);
    // One axis does not determine the encoding of rotations, so other rules are disabled.
    log.options.policy.rules.select = vec!["ORD006".parse().expect("a rule")];
    log.run.home = vec![0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, 0.0, 0.0];
}

/// Changes the sign of every other quaternion.
pub fn flip_quaternion_signs(messages: &mut [Message]) {
    for message in messages.iter_mut().step_by(2) {
        for field in message.fields() {
            if let Field::Xyzw(at) = field {
                message.set_floats(at, &message.floats::<4>(at).map(|component| -component));
            }
        }
    }
}

/// Reorders the joints of all joint states, names and numbers alike.
pub fn reorder_joints(messages: &mut [Message], order: [usize; 6]) {
    for message in messages.iter_mut().filter(|message| message.topic == JOINT_STATES) {
        message.reorder_joints(&order);
    }
}
