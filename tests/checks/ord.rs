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
use poseaudit::synth::{Coding, IMU, JOINT_STATES, Motion, POSE};

use crate::checks::case::On::{self, JointOf, Topic};
use crate::checks::case::What::{self, Degrees, Order, ReadAs};
use crate::checks::case::{Expected, Log, cases, error, summary, the, warning};
use crate::checks::recording::{Field, Message, cut_out, stick};
use Expected::{BlamedOn, LeftOpenBy, Skipped, Sound, Undecided};

/// Topic of the poses as unnamed numbers.
const NUMBERS: &str = "/arm/tool_vector";

cases! {
    ORD001 a_rotation_vector_read_as_rpy: |log| log.run.pose.coding = misread_as_rpy()
        => error(Topic(POSE), ReadAs("rotvec", "euler:xyz"));
    ORD001 moving_axes_for_fixed: |log| log.run.pose.coding = misread("euler:xyz", "euler:XYZ")
        => error(Topic(POSE), ReadAs("euler:xyz", "euler:XYZ"));
    ORD001 zyz_read_as_rpy: |log| log.run.pose.coding = misread("euler:ZYZ", "euler:xyz")
        => error(Topic(POSE), ReadAs("euler:ZYZ", "euler:xyz"));
    ORD001 zyx_read_as_rpy: |log| log.run.pose.coding = misread("euler:ZYX", "euler:xyz")
        => error(Topic(POSE), ReadAs("euler:ZYX", "euler:xyz"));
    ORD001 rpy_read_as_a_rotation_vector: |log| {
        log.run.pose.coding = misread("euler:xyz", "rotvec");
    } => error(Topic(POSE), ReadAs("euler:xyz", "rotvec"));
    ORD001 axes_turned_in_another_order: |log| {
        log.run.pose.coding = misread("euler:xzy@axes", "euler:xyz");
    } => error(Topic(POSE), ReadAs("euler:xzy@axes", "euler:xyz"));
    ORD001 an_imu_that_is_misread: |log| log.run.imu.coding = misread("euler:ZYX", "euler:xyz")
        => error(Topic(IMU), ReadAs("euler:ZYX", "euler:xyz"));

    ORD001 rotations_through_a_half_turn_are_sound: |log| {
        // The tool's orientation passes 180°, where quaternions change sign.
        log.run.home = vec![0.4, -1.2, 1.2, -1.6, -1.57, 3.0];
        log.run.motion = Motion::Continuous;
    } => Sound;

    ORD001 a_quaternion_slip_is_no_convention: |log| {
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
    } => BlamedOn("ORD002");
    ORD001 a_transpose_is_no_convention: |log| log.run.pose.coding = Coding::Transposed
        => BlamedOn("ORD003");
    ORD001 a_turned_base_is_no_convention: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::half_turn();
    } => BlamedOn("FRM002");
    ORD001 a_late_pose_is_no_convention: |log| log.run.pose.timing.latency_s = 0.1
        => BlamedOn("LAT001");

    ORD001 no_orientations: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.with_orientation = false;
    } => Skipped("no");

    ORD002 w_first_read_as_w_last: |log| {
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(POSE), ReadAs("quat:wxyz", "quat:xyzw"));
    ORD002 w_last_read_as_w_first: |log| {
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::XyzwReadAsWxyz);
    } => error(Topic(POSE), ReadAs("quat:xyzw", "quat:wxyz"));
    ORD002 an_imu_with_w_first: |log| {
        log.run.imu.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(IMU), ReadAs("quat:wxyz", "quat:xyzw"));
    ORD002 quaternions_of_either_sign_are_sound: |log| log.edit = Some(|messages| turn_signs(messages)) => Sound;
    ORD002 a_misread_rotation_is_no_slip: |log| log.run.pose.coding = misread_as_rpy()
        => BlamedOn("ORD001");
    ORD002 an_inverse_is_no_slip: |log| log.run.pose.coding = Coding::Inverted
        => BlamedOn("ORD003");
    ORD002 no_quaternions: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with orientations");

    ORD003 an_inverted_pose: |log| log.run.pose.coding = Coding::Inverted
        => error(Topic(POSE), ReadAs("pose-inverse", "pose"));
    ORD003 a_transposed_rotation: |log| log.run.pose.coding = Coding::Transposed
        => error(Topic(POSE), ReadAs("transpose", "pose"));
    ORD003 an_inverted_imu: |log| log.run.imu.coding = Coding::Transposed
        => error(Topic(IMU), ReadAs("transpose", "pose"));
    ORD003 a_base_out_of_line_is_sound: |log| log.run.imu.world_yaw_rad = 2.9 => Sound;
    ORD003 a_misread_rotation_is_no_inverse: |log| {
        log.run.pose.coding = misread("euler:ZYX", "euler:xyz");
    } => BlamedOn("ORD001");
    ORD003 a_quaternion_slip_is_no_inverse: |log| {
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::XyzwReadAsWxyz);
    } => BlamedOn("ORD002");
    ORD003 a_tool_is_no_inverse: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool()
        => BlamedOn("FRM003");
    ORD003 no_poses: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no stream with orientations");

    ORD004 joints_in_degrees: |log| log.run.joints.in_degrees = true
        => error(Topic(JOINT_STATES), ReadAs("deg", "rad"));
    ORD004 an_arm_that_hardly_leaves_zero_is_sound: |log| {
        log.run.home = vec![0.0; 6];
        log.run.amplitude = 0.1;
    } => Sound;
    ORD004 joints_in_another_order_are_no_degrees: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => BlamedOn("ORD005");
    ORD004 millimetres_are_no_degrees: |log| log.run.pose.in_millimetres = true
        => BlamedOn("ORD008");
    ORD004 joints_in_degrees_at_rest: |log| {
        (log.run.joints.in_degrees, log.run.motion) = (true, Motion::AtRest);
    } => error(Topic(JOINT_STATES), ReadAs("deg", "rad"));
    ORD004 an_arm_that_rests_where_its_joints_say_is_sound: |log| log.run.motion = Motion::AtRest => Sound;
    ORD004 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD004 nothing_to_hold_the_joints_against: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Undecided("log a pose");

    ORD005 numbers_in_the_order_of_the_alphabet: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => error(Topic(JOINT_STATES), Order(&[
        "elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint",
        "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
    ]));
    ORD005 numbers_in_a_ring: |log| {
        log.run.joints.number_order = Some(vec![5, 0, 1, 2, 3, 4]);
    } => error(Topic(JOINT_STATES), Order(&[
        "wrist_3_joint", "shoulder_pan_joint", "shoulder_lift_joint",
        "elbow_joint", "wrist_1_joint", "wrist_2_joint",
    ]));
    ORD005 names_and_numbers_in_the_same_order_are_sound: |log| {
        log.edit = Some(|messages| reorder(messages, [2, 1, 0, 3, 4, 5]));
    } => Sound;
    ORD005 degrees_are_no_order: |log| log.run.joints.in_degrees = true => BlamedOn("ORD004");
    ORD005 joint_zeros_are_no_order: |log| {
        log.run.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.05];
    } => BlamedOn("ZER001");
    ORD005 no_names: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD005 only_what_believes_the_names: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Undecided("log a pose that does not come from /tf");

    ORD006 rpy_that_stands_upright: |log| {
        turn_the_base_alone(log);
        declare(log, |messages| as_euler(messages, Convention::RPY), "euler:xyz");
    } => warning(Topic(NUMBERS), What::About(1.0, 1e-9));
    ORD006 rpy_far_from_upright_is_sound: |log| {
        (log.run.amplitude, log.run.speed) = (0.3, 1.0);
        declare(log, |messages| as_euler(messages, Convention::RPY), "euler:xyz");
    } => Sound;
    ORD006 a_rotation_vector_has_no_lock: |log| {
        turn_the_base_alone(log);
        declare(log, |messages| as_numbers(messages, 1.0), "rotvec");
    } => Sound;
    ORD006 degrees_are_no_lock: |log| {
        declare(log, |messages| as_numbers(messages, 1_f64.to_degrees()), "rotvec");
    } => BlamedOn("ORD004");
    ORD006 what_nobody_declared_is_no_lock: |log| {
        turn_the_base_alone(log);
        log.options.policy.rules.ignore = vec!["TIM005".parse().expect("a rule")];
        log.edit = Some(|messages| as_euler(messages, Convention::RPY));
    } => Sound;
    ORD006 no_bare_numbers: |_| {} => Skipped("no stream uses Euler angles");

    ORD007 a_standard_table_that_says_modified: |log| by_table(log, "modified", [""; 2])
        => error(On::Robot, ReadAs("standard", "modified"));
    ORD007 a_table_that_says_what_it_is: |log| by_table(log, "standard", [""; 2]) => Sound;
    ORD007 a_joint_zero_is_no_convention: |log| {
        by_table(log, "standard", [""; 2]);
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    ORD007 a_misread_rotation_is_no_dh_convention: |log| {
        by_table(log, "standard", [""; 2]);
        log.run.pose.coding = misread_as_rpy();
    } => BlamedOn("ORD001");
    ORD007 a_shifted_base_is_no_convention: |log| {
        by_table(log, "standard", [""; 2]);
        log.run.pose.reference_from_stream = crate::checks::frm::shifted();
    } => BlamedOn("FRM002");
    ORD007 another_arms_table_is_no_convention: |log| {
        by_table(log, "standard", ["-0.425", "-0.365"]);
    } => LeftOpenBy("MDL001", "wrong robot model");
    ORD007 a_urdf: |_| {} => Skipped("DH convention");
    ORD007 nothing_to_hold_the_table_against: |log| {
        by_table(log, "modified", [""; 2]);
        log.run.pose.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD008 positions_in_millimetres: |log| log.run.pose.in_millimetres = true
        => error(Topic(POSE), ReadAs("mm", "m"));
    ORD008 positions_in_centimetres: |log| log.edit = Some(|messages| in_unit(messages, 1e-2))
        => error(Topic(POSE), ReadAs("cm", "m"));
    ORD008 positions_in_inches: |log| log.edit = Some(|messages| in_unit(messages, 0.0254))
        => error(Topic(POSE), ReadAs("in", "m"));
    ORD008 positions_in_tenths_of_a_millimetre: |log| {
        log.edit = Some(|messages| in_unit(messages, 1e-4));
    } => error(Topic(POSE), ReadAs("0.1 mm", "m"));
    ORD008 positions_in_kilometres: |log| log.edit = Some(|messages| in_unit(messages, 1e3))
        => error(Topic(POSE), ReadAs("km", "m"));
    ORD008 positions_in_a_unit_of_their_own: |log| {
        log.edit = Some(|messages| in_unit(messages, 0.0043));
    } => error(Topic(POSE), ReadAs("0.004300 m", "m"));
    ORD008 mirrored_axes_are_no_unit: |log| log.edit = Some(|messages| in_axes(messages, UNITY, UNITY))
        => BlamedOn("ORD010");
    ORD008 a_percent_is_no_unit: |log| log.run.pose.growth = 0.3e-3 => Sound;
    ORD008 degrees_are_no_millimetres: |log| log.run.joints.in_degrees = true
        => BlamedOn("ORD004");
    ORD008 a_frame_far_off_is_no_unit: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::far_off();
    } => BlamedOn("FRM002");
    ORD008 no_positions: |log| {
        log.run.imu.timing.rate_hz = 0.0;
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD009 a_joint_that_is_reversed: |log| log.run.joints.scales = vec![1.0, 1.0, -1.0]
        => error(JointOf(JOINT_STATES, "elbow_joint"), What::Amount(-1.0, 1e-3));
    ORD009 a_wrist_that_is_reversed: |log| {
        log.run.joints.scales = vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0];
    } => error(JointOf(JOINT_STATES, "wrist_3_joint"), What::Amount(-1.0, 1e-3));
    ORD009 a_gear_that_is_counted_twice: |log| log.run.joints.scales = vec![1.0, 0.5]
        => error(JointOf(JOINT_STATES, "shoulder_lift_joint"), What::Amount(2.0, 2e-3));
    ORD009 ticks_of_all_encoders: |log| log.run.joints.scales = vec![4096.0 / TAU; 6]
        => error(Topic(JOINT_STATES), What::Amount(TAU / 4096.0, 1e-6));
    ORD009 joints_in_degrees_have_no_gear: |log| log.run.joints.in_degrees = true
        => BlamedOn("ORD004");
    ORD009 joints_in_another_order_are_not_reversed: |log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
    } => BlamedOn("ORD005");
    ORD009 a_joint_homed_elsewhere_has_no_gear: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 120.0);
    } => BlamedOn("ZER001");
    ORD009 a_turned_base_is_no_gear: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::half_turn();
    } => BlamedOn("FRM002");
    ORD009 joints_that_count_rightly_are_sound: |_| {} => Sound;
    ORD009 no_joint_states_to_scale: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");
    ORD009 only_what_believes_the_joints: |log| {
        log.run.joints.scales = vec![1.0, 1.0, -1.0];
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Undecided("log a pose that does not come from /tf");

    ORD010 y_up_and_left_handed: |log| log.edit = Some(|messages| in_axes(messages, UNITY, UNITY))
        => error(Topic(POSE), ReadAs("x right, y up, z forward (left-handed)", STANDARD));
    ORD010 y_and_z_exchanged: |log| log.edit = Some(|messages| in_axes(messages, EXCHANGED, EXCHANGED))
        => error(Topic(POSE), ReadAs("x forward, y up, z left (left-handed)", STANDARD));
    ORD010 positions_alone: |log| log.edit = Some(|messages| in_axes(messages, OPTICAL, STANDARD))
        => error(Topic(POSE), ReadAs("positions x right, y down, z forward", STANDARD));
    ORD010 rotations_alone: |log| log.edit = Some(|messages| in_axes(messages, STANDARD, HALF))
        => error(Topic(POSE), ReadAs("rotations x forward, y right, z down", STANDARD));
    ORD010 axes_that_both_ends_exchange: |log| log.edit = Some(|messages| in_axes(messages, OPTICAL, OPTICAL))
        => error(Topic(POSE), ReadAs("x right, y down, z forward", STANDARD));
    ORD010 axes_as_they_should_be: |_| {} => Sound;
    ORD010 a_turned_base_is_no_exchange: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::half_turn();
    } => BlamedOn("FRM002");
    ORD010 an_inverse_is_no_exchange: |log| log.run.pose.coding = Coding::Inverted
        => BlamedOn("ORD003");
    ORD010 no_poses_with_axes: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");

    ORD011 z_that_is_always_zero: |log| log.edit = Some(|messages| constant(messages, 2))
        => error(Topic(POSE), What::About(0.5, 0.45));
    ORD011 x_that_is_always_zero: |log| log.edit = Some(|messages| constant(messages, 0))
        => error(Topic(POSE), What::About(0.5, 0.45));
    ORD011 an_arm_at_rest_is_sound: |log| log.run.motion = Motion::AtRest => Sound;
    ORD011 a_base_alone_that_turns_is_sound: |log| {
        log.run.motion = Motion::OneJoint(0);
        log.run.speed *= 0.5;
    } => Sound;
    ORD011 a_pose_that_never_moves_has_no_constant_coordinate: |log| {
        log.edit = Some(|messages| {
            stick(messages, POSE, -1.0, 9.0);
            cut_out(messages, POSE, 1.0, 9.0);
        });
    } => BlamedOn("FRM007");
    ORD011 millimetres_are_not_constant: |log| log.run.pose.in_millimetres = true
        => BlamedOn("ORD008");
    ORD011 no_poses_with_coordinates: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no pose stream");
}

#[test]
fn an_inverse_pose_is_found_together_with_a_reading() {
    for (coding, code, is, read_as) in [
        (Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw), "ORD002", "quat:wxyz", "quat:xyzw"),
        (misread_as_rpy(), "ORD001", "rotvec", "euler:xyz"),
    ] {
        let report = Log::with(|log| {
            log.run.pose.coding = coding;
            log.run.pose.inverted = true;
        });
        let report = report.audited();
        ReadAs(is, read_as).assert_is(the(&report, code, POSE).estimate.as_ref());
        let inverse = the(&report, "ORD003", POSE);
        ReadAs("pose-inverse", "pose").assert_is(inverse.estimate.as_ref());
        assert_eq!(report.findings.len(), 2, "{}", summary(&report.findings));
    }
}

#[test]
fn positions_are_audited_where_the_orientation_was_never_set() {
    for unset in [[0.0; 4], [0.0, 0.0, 0.0, 1.0], [f64::NAN; 4]] {
        let report = Log::with(|log| {
            log.run.pose.timing.latency_s = 0.025;
            log.edit = Some(match unset {
                [_, _, _, 1.0] => |messages| orient(messages, [0.0, 0.0, 0.0, 1.0]),
                [part, ..] if part.is_nan() => |messages| orient(messages, [f64::NAN; 4]),
                _ => |messages| orient(messages, [0.0; 4]),
            });
        });
        let report = report.audited();
        let late = the(&report, "LAT001", POSE);
        What::Amount(0.025, 1e-3).assert_is(late.estimate.as_ref());
        let row =
            report.checks.iter().find(|row| row.code == "ORD001" && row.subject.label() == POSE);
        let why = row.and_then(|row| row.reason.as_deref()).unwrap_or_default();
        assert!(why.contains("never set"), "{unset:?}: {why}");
    }
}

/// The report on a log with poses as unnamed numbers, without the finding about missing stamps.
fn audited_as_numbers(edit: fn(&mut Vec<Message>)) -> Report {
    let mut report = Log::with(|log| log.edit = Some(edit)).audited();
    let stamps = the(&report, "TIM005", NUMBERS);
    assert_eq!(stamps.severity, Severity::Info);
    report.findings.retain(|finding| finding.code != "TIM005");
    let reading = the(&report, "ORD001", NUMBERS);
    assert_eq!(reading.severity, Severity::Info);
    assert_eq!(report.findings.len(), 1, "{}", summary(&report.findings));
    report
}

#[test]
fn beside_a_wrong_dh_convention_other_faults_are_found_as_if_it_were_right() {
    let report = Log::with(|log| {
        by_table(log, "modified", [""; 2]);
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
        log.run.pose.timing.latency_s = 0.015;
    });
    let report = report.audited();
    let mut codes: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    codes.sort_unstable();
    assert_eq!(codes, ["LAT001", "ORD007", "ZER001"], "{}", summary(&report.findings));
    Degrees(0.6, 0.02).assert_is(the(&report, "ZER001", "elbow_joint").estimate.as_ref());
    let source = &report.robots[0].source;
    assert!(source.ends_with("DH table interpreted as standard"), "{source}");
}

#[test]
fn bare_numbers_are_read_as_what_follows_the_arm() {
    let report = audited_as_numbers(|messages| as_numbers(messages, 1.0));
    let message = &the(&report, "ORD001", NUMBERS).message;
    assert!(
        message.starts_with("assumed m, rotvec in rad (as Universal Robots does)"),
        "{message}"
    );
}

#[test]
fn bare_numbers_may_be_degrees() {
    let report = audited_as_numbers(|messages| as_numbers(messages, 1_f64.to_degrees()));
    let message = &the(&report, "ORD001", NUMBERS).message;
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
fn units_declared_wrongly_are_one_slip_of_units() {
    let in_radians = |messages: &mut Vec<Message>| as_numbers(messages, 1.0);
    let in_degrees = |messages: &mut Vec<Message>| as_numbers(messages, 1_f64.to_degrees());
    let metres_as_millimetres = ("ORD008", ReadAs("m", "mm"));
    let radians_as_degrees = ("ORD004", ReadAs("rad", "deg"));
    let degrees_as_radians = ("ORD004", ReadAs("deg", "rad"));
    type Declared<'a> = (&'a str, fn(&mut Vec<Message>), &'a [(&'a str, What)]);
    let logs: [Declared<'_>; 6] = [
        ("rotvec", in_radians, &[]),
        ("rotvec,deg", in_degrees, &[]),
        ("rotvec,mm", in_radians, &[metres_as_millimetres]),
        ("rotvec,deg", in_radians, &[radians_as_degrees]),
        ("rotvec", in_degrees, &[degrees_as_radians]),
        ("rotvec,deg,mm", in_radians, &[radians_as_degrees, metres_as_millimetres]),
    ];
    for (declared, edit, expected) in logs {
        let report = Log::with(|log| {
            log.edit = Some(edit);
            let declaration = format!("{NUMBERS}={declared}");
            log.options.run.declared = vec![declaration.parse().expect("a declaration")];
        });
        let mut report = report.audited();
        report.findings.retain(|finding| finding.code != "TIM005");
        let found = summary(&report.findings);
        assert_eq!(report.findings.len(), expected.len(), "{declared}:\n{found}");
        for (code, what) in expected {
            let finding = the(&report, code, NUMBERS);
            what.assert_is(finding.estimate.as_ref());
            assert!(finding.message.contains("declared as"), "{found}");
        }
    }
}

#[test]
fn at_rest_a_reading_passes_only_where_no_frame_can_make_up_for_it() {
    let report = Log::with(|log| log.run.motion = Motion::AtRest).audited();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    for code in ["ORD001", "ORD002", "ORD003"] {
        let on = |topic: &str| {
            let is_meant = |row: &&CheckRow| row.code == code && row.subject.label() == topic;
            report.checks.iter().find(is_meant).expect("it is asked")
        };
        // The pose's frames are links of the arm; the IMU's world frame may have any rotation.
        assert_eq!(on(POSE).status, Status::Pass, "{:#?}", on(POSE));
        assert_eq!(on(IMU).status, Status::Inconclusive, "{:#?}", on(IMU));
        assert!(on(IMU).reason.as_deref().is_some_and(|why| why.contains("turn the wrist")));
    }
}

pub fn misread(is: &str, read_as: &str) -> Coding {
    let convention = |name: &str| name.parse().expect("a convention's name");
    Coding::Misread(Misinterpretation { is: convention(is), read_as: convention(read_as) })
}

pub fn misread_as_rpy() -> Coding {
    Coding::Misread(Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY })
}

/// Axes by name.
const STANDARD: &str = "x forward, y left, z up";
const UNITY: &str = "x right, y up, z forward (left-handed)";
const EXCHANGED: &str = "x forward, y up, z left (left-handed)";
const OPTICAL: &str = "x right, y down, z forward";
const HALF: &str = "x forward, y right, z down";

/// Writes positions and rotations of the poses in these axes.
pub fn in_axes(messages: &mut [Message], positions: &str, rotations: &str) {
    let axes = |name: &str| -> Axes { name.parse().expect("axes") };
    let (positions, turn) = (axes(positions), axes(rotations).conjugator());
    edit_poses(messages, |xyz, xyzw| {
        let rotation = rotation_from_xyzw(xyzw).expect("a rotation");
        let own = xyzw_from_rotation(&(turn * rotation * turn.inverse()));
        (positions.convert_from_standard(xyz.into()).into(), own)
    });
}

/// Writes the positions of the poses in a unit of this many metres.
pub fn in_unit(messages: &mut [Message], metres: f64) {
    edit_poses(messages, |xyz, xyzw| (xyz.map(|part| part / metres), xyzw));
}

/// Sets one coordinate of the poses to zero.
fn constant(messages: &mut [Message], axis: usize) {
    edit_poses(messages, |mut xyz, xyzw| {
        xyz[axis] = 0.0;
        (xyz, xyzw)
    });
}

/// Sets all poses to one orientation.
fn orient(messages: &mut [Message], xyzw: [f64; 4]) {
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
pub fn by_table(log: &mut Log, convention: &str, [from, to]: [&str; 2]) {
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

/// Turns the poses into six unnamed numbers: position, and rotation vector in units of 1 / `to_the_radian`
/// rad.
pub fn as_numbers(messages: &mut [Message], to_the_radian: f64) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let mut numbers = Vec::new();
        for field in message.fields() {
            match field {
                Field::Stamp(_) => {}
                Field::Xyz(at, _) => numbers.extend(message.floats::<3>(at)),
                Field::Xyzw(at) => {
                    let rotation = rotation_from_xyzw(message.floats(at)).expect("a rotation");
                    let rotvec = Convention::RotVec.numbers(&rotation);
                    numbers.extend(rotvec.map(|radians| radians * to_the_radian));
                }
            }
        }
        message.become_array(NUMBERS, &numbers);
    }
}

/// The same with three Euler angles.
fn as_euler(messages: &mut [Message], convention: Convention) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let mut numbers = Vec::new();
        for field in message.fields() {
            match field {
                Field::Stamp(_) => {}
                Field::Xyz(at, _) => numbers.extend(message.floats::<3>(at)),
                Field::Xyzw(at) => {
                    let rotation = rotation_from_xyzw(message.floats(at)).expect("a rotation");
                    numbers.extend(convention.numbers(&rotation));
                }
            }
        }
        message.become_array(NUMBERS, &numbers);
    }
}

/// Declares the encoding of the unnamed numbers, and ignores their missing stamps.
fn declare(log: &mut Log, edit: fn(&mut Vec<Message>), convention: &str) {
    let declaration = format!("{NUMBERS}={convention}");
    log.options.run.declared = vec![declaration.parse().expect("a declaration")];
    log.options.policy.rules.ignore = vec!["TIM005".parse().expect("a rule")];
    log.edit = Some(edit);
}

/// Rotates only the first joint, so that roll and pitch of the tool stay constant; with a straight second
/// wrist, the tool's x axis points up.
fn turn_the_base_alone(log: &mut Log) {
    log.run.motion = Motion::OneJoint(0);
    // One axis does not determine the encoding of rotations, so other rules are disabled.
    log.options.policy.rules.select = vec!["ORD006".parse().expect("a rule")];
    log.run.home = vec![0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, 0.0, 0.0];
}

/// Changes the sign of every other quaternion.
pub fn turn_signs(messages: &mut [Message]) {
    for message in messages.iter_mut().step_by(2) {
        for field in message.fields() {
            if let Field::Xyzw(at) = field {
                message.set_floats(at, &message.floats::<4>(at).map(|component| -component));
            }
        }
    }
}

/// Reorders the joints of all joint states, names and numbers alike.
pub fn reorder(messages: &mut [Message], order: [usize; 6]) {
    for message in messages.iter_mut().filter(|message| message.topic == JOINT_STATES) {
        message.reorder_joints(&order);
    }
}
