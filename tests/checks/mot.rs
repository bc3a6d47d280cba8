//! MOT: undesired or impossible motion.

use std::f64::consts::TAU;

use poseaudit::finding::{CheckRow, Status};
use poseaudit::geometry::Convention;
use poseaudit::synth::{
    COMMANDED_POSE, Commands, FinalStop, JOINT_STATES, JointOscillation, LineMotion, Motion, POSE,
    SynthCompliance, SynthComplianceKind,
};

use crate::checks::case::ExpectedEstimate::{Amount, AmountWithoutInterval, Degrees, Frame};
use crate::checks::case::ExpectedSubject::{self, Joint};
use crate::checks::case::{Expected, Log, cases, error, info, single_finding, warning};
use crate::checks::recording::{add_wheels, displace};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, OtherFindingAndInconclusive, Skipped};

cases! {
    // The tip is 0.5096 m from the first joint's axis: 3 mrad are 1.529 mm, 1.081 mm rms.
    MOT001 a_vibrating_servo: |log| vibrate(log, 3e-3, 12.0)
        => warning(ExpectedSubject::Topic(JOINT_STATES), AmountWithoutInterval(1.081e-3, 0.03e-3));
    MOT001 a_slightly_vibrating_servo_passes: |log| {
        vibrate(log, 0.3e-3, 12.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => NoFindings;
    MOT001 a_slow_swing_is_not_reported_as_vibration: |log| {
        vibrate(log, 10e-3, 4.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => NoFindings;
    MOT001 a_stop_is_not_reported_as_vibration: |log| {
        stop_abruptly(log, 30.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => OnlyOtherFinding("MOT002");
    MOT001 no_stream_that_can_vibrate: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("joint states");

    MOT002 an_abrupt_stop_at_30_rad_per_s2: |log| stop_abruptly(log, 30.0)
        => warning(Joint("shoulder_lift_joint"), Amount(30.0, 3.0));
    MOT002 a_stop_at_10_rad_per_s2_passes: |log| stop_abruptly(log, 10.0) => NoFindings;
    MOT002 joints_in_degrees_are_not_reported_as_abrupt_stop: |log| log.run.joints.is_in_degrees = true
        => OtherFindingAndInconclusive("ORD004", "correct them first");
    MOT002 a_zero_offset_is_not_reported_as_abrupt_stop: |log| log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6)
        => OnlyOtherFinding("ZER001");
    MOT002 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");

    MOT003 one_turn_beyond_the_limits: |log| add_extra_turn(log, 0.3)
        => OtherFindingAndInconclusive("ORD009", "off by whole turns");
    MOT003 slightly_beyond_the_limits: |log| add_extra_turn(log, 0.05)
        => info(Joint("wrist_3_joint"), AmountWithoutInterval(0.05, 2e-3));
    MOT003 a_turn_within_the_limits_passes: |log| add_extra_turn(log, -0.3) => NoFindings;
    MOT003 an_encoder_step_is_not_reported_as_speed: |log| use_coarse_encoders(log) => NoFindings;
    MOT003 joints_in_degrees_are_not_reported_as_beyond_the_limits: |log| log.run.joints.is_in_degrees = true
        => OtherFindingAndInconclusive("ORD004", "correct them first");
    MOT003 a_zero_offset_is_not_reported_as_beyond_the_limits: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    MOT003 no_joint_states_for_limits: |log| log.run.joints.timing.rate_hz = 0.0
        => Skipped("joint states");

    MOT005 one_outlier_of_ten_metres: |log| {
        log.edit = Some(|messages| displace(messages, POSE, &[70], [10.0, 0.0, 0.0]));
    } => warning(ExpectedSubject::Topic(POSE), AmountWithoutInterval(10.0, 0.1));
    MOT005 occasional_outliers: |log| {
        log.edit = Some(|messages| displace(messages, POSE, &[0, 31, 90, 91, 150], [0.0, 0.8, 0.6]));
    } => warning(ExpectedSubject::Topic(POSE), AmountWithoutInterval(1.0, 0.1));
    MOT005 an_encoder_with_a_bit_error: |log| {
        log.edit = Some(|messages| {
            let mut states = messages.iter_mut().filter(|message| message.topic == JOINT_STATES);
            states.nth(200).expect("a joint state").turn_joint(2, 0.5);
        });
    } => warning(ExpectedSubject::JointOf(JOINT_STATES, "elbow_joint"), AmountWithoutInterval(0.5, 0.02));
    MOT005 joint_states_of_zeros_among_measured_ones: |log| {
        log.edit = Some(|messages| {
            let states = messages.iter_mut().filter(|message| message.topic == JOINT_STATES);
            let zeros = (0_usize..).zip(states).filter(|(row, _)| row * 7919 % 13 == 5);
            zeros.for_each(|(_, state)| state.scale_joints(0.0));
        });
    } => warning(ExpectedSubject::Topic(JOINT_STATES), AmountWithoutInterval(1.8, 1.3));
    MOT005 other_joints_at_zero_in_messages_of_their_own_pass: |log| log.edit = Some(add_wheels) => NoFindings;
    MOT005 motion_is_not_reported_as_outliers: |log| log.run.pose.timing.rate_hz = 20.0 => NoFindings;
    MOT005 large_noise_is_not_reported_as_outliers: |log| {
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (1e-3, 2e-3);
    } => NoFindings;
    MOT005 a_late_pose_is_not_reported_as_outliers: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    MOT005 an_abrupt_stop_is_not_reported_as_outliers: |log| stop_abruptly(log, 30.0) => OnlyOtherFinding("MOT002");
    MOT005 no_stream_for_outliers: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no joint states, tool poses or transforms");

    MOT006 a_shoulder_with_backlash: |log| set_compliance(log, &[(1, SynthComplianceKind::Backlash, 1.0)])
        => error(Joint("shoulder_lift_joint"), Degrees(1.0, 0.03));
    MOT006 an_elbow_with_some_backlash: |log| set_compliance(log, &[(2, SynthComplianceKind::Backlash, 0.3)])
        => warning(Joint("elbow_joint"), Degrees(0.3, 0.02));
    MOT006 a_shoulder_pushed_through_its_backlash: |log| set_compliance(log, &[(1, SynthComplianceKind::LoadedBacklash, 1.0)])
        => error(Joint("shoulder_lift_joint"), Degrees(1.0, 0.01));
    MOT006 a_wrist_pushed_through_its_backlash: |log| set_compliance(log, &[(3, SynthComplianceKind::LoadedBacklash, 0.3)])
        => warning(Joint("wrist_1_joint"), Degrees(0.3, 0.01));
    MOT006 backlash_of_healthy_gears_passes: |log| set_compliance(log, &[(1, SynthComplianceKind::Backlash, 0.05)]) => NoFindings;
    MOT006 a_late_pose_is_not_reported_as_backlash: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    MOT006 a_zero_offset_is_not_reported_as_backlash: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    MOT006 sag_is_not_reported_as_backlash: |log| set_compliance(log, &[(1, SynthComplianceKind::Sag, 0.6)]) => OnlyOtherFinding("ZER003");
    MOT006 eccentric_gears_are_not_reported_as_backlash: |log| set_compliance(log, &[(1, SynthComplianceKind::Eccentricity(2), 0.8)])
        => OnlyOtherFinding("MDL001");
    MOT006 backlash_is_not_observable_at_rest: |log| log.run.motion = Motion::AtRest => Inconclusive("barely moves");
    MOT006 only_encoders: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");

    MOT004 a_bowed_line: |log| follow_lines(log, LineMotion { bow_m: 3e-3, ..LineMotion::default() })
        => warning(ExpectedSubject::Topic(COMMANDED_POSE), Frame([3e-3, 0.2e-3], [0.0, 0.1]));
    MOT004 a_strongly_bowed_line: |log| follow_lines(log, LineMotion { bow_m: 8e-3, ..LineMotion::default() })
        => error(ExpectedSubject::Topic(COMMANDED_POSE), Frame([8e-3, 0.4e-3], [0.0, 0.1]));
    MOT004 straight_lines: |log| follow_lines(log, LineMotion::default()) => NoFindings;
    MOT004 a_bow_of_half_a_millimetre_passes: |log| follow_lines(log, LineMotion { bow_m: 0.5e-3, ..LineMotion::default() })
        => NoFindings;
    MOT004 noise_is_not_reported_as_a_bow: |log| {
        follow_lines(log, LineMotion::default());
        log.run.noise.joints = 5e-4;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (3e-4, 1e-3);
    } => NoFindings;
    MOT004 a_late_pose_is_not_reported_as_a_bow: |log| {
        follow_lines(log, LineMotion::default());
        log.run.pose.timing.latency_s = 0.05;
    } => OnlyOtherFinding("LAT001");
    MOT004 a_misread_pose_is_not_reported_as_a_bow: |log| {
        follow_lines(log, LineMotion::default());
        log.run.pose.encoding = crate::checks::ord::misread_as_rpy();
    } => OnlyOtherFinding("ORD001");
    MOT004 a_zero_offset_is_not_reported_as_a_bow: |log| {
        follow_lines(log, LineMotion::default());
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    MOT004 goals_are_not_checked_as_lines: |log| {
        follow_lines(log, LineMotion::default());
        log.run.reference.commands = Commands::Goals;
    } => Skipped("goals, not a streamed path");
    MOT004 arcs_are_not_checked_as_lines: |log| {
        follow_lines(log, LineMotion::default());
        log.run.motion = Motion::PickAndPlace;
    } => Skipped("no commanded path in this log is straight");
    MOT004 no_commands: |_| {} => Skipped("no commanded poses");
}

#[test]
fn encoder_steps_may_hide_vibration() {
    let report = Log::modified(use_coarse_encoders).report();
    let of_joints = |row: &&CheckRow| row.code == "MOT001" && row.subject.label() == JOINT_STATES;
    let row = report.checks.iter().find(of_joints).expect("a row");
    assert_eq!(row.status, Status::Inconclusive, "{row:?}");
    assert!(row.reason.as_deref().is_some_and(|why| why.contains("hides vibration")), "{row:?}");
}

/// 9-bit encoders read at 1 kHz: a step between samples is 350°/s.
fn use_coarse_encoders(log: &mut Log) {
    (log.run.motion, log.run.amplitude) = (Motion::Continuous, 0.9);
    log.run.joints.timing.rate_hz = 1000.0;
    log.run.joints.resolution = TAU / 512.0;
    log.run.joints.has_velocity = false;
}

#[test]
fn fifteen_samples_are_too_few_for_outliers() {
    let report = Log::modified(|log| log.run.pose.timing.rate_hz = 1.9).report();
    let row_of = |topic: &str| {
        let is_of = |row: &&CheckRow| row.subject.topic.as_deref() == Some(topic);
        let mut rows = report.checks.iter().filter(|row| row.code == "MOT005").filter(is_of);
        rows.next().expect("the stream is asked about")
    };
    assert_eq!(row_of(JOINT_STATES).status, Status::Pass);
    assert_eq!(row_of(POSE).status, Status::Inconclusive);
    assert!(
        row_of(POSE).reason.as_deref().is_some_and(|why| why.contains("fewer than 20 samples"))
    );
}

/// The arm follows lines that are streamed to it 40 ms ahead.
pub fn follow_lines(log: &mut Log, lines: LineMotion) {
    log.run.motion = Motion::Lines(lines);
    log.run.duration_s = 12.0;
    log.run.pose.timing.rate_hz = 50.0;
    let timing = &mut log.run.reference.timing;
    (timing.rate_hz, timing.latency_s) = (50.0, -0.04);
}

#[test]
fn interpolated_euler_angles_are_reported_with_their_convention() {
    let log = Log::modified(|log| {
        follow_lines(
            log,
            LineMotion { interpolated_as: Some(Convention::RPY), ..LineMotion::default() },
        );
    });
    let report = log.report();
    let found = single_finding(&report, "MOT004", COMMANDED_POSE);
    assert_eq!(found.title, "orientation along the line is not a slerp");
    assert_eq!(found.evidence.more["interpolated"], "euler:xyz");
    assert!(found.message.ends_with("as if euler:xyz were interpolated"), "{}", found.message);
    assert_eq!(report.findings.len(), 1, "{}", crate::checks::case::summary(&report.findings));
    assert!(!report.findings.iter().any(|found| found.subject.label() == POSE));
}

/// Joint compliance, as index, kind and magnitude in degrees.
pub fn set_compliance(log: &mut Log, compliance: &[(usize, SynthComplianceKind, f64)]) {
    let compliance_of = |&(joint, how, degrees): &(usize, SynthComplianceKind, f64)| {
        SynthCompliance { joint, kind: how, amplitude_rad: degrees.to_radians() }
    };
    log.run.compliance = compliance.iter().map(compliance_of).collect();
    log.run.duration_s = 15.0;
    log.run.joints.timing.rate_hz = 125.0;
    log.run.pose.timing.rate_hz = 50.0;
}

#[test]
fn backlash_of_two_joints_is_distinguished_from_sag_and_latency() {
    let report = Log::modified(|log| {
        set_compliance(
            log,
            &[
                (1, SynthComplianceKind::Backlash, 0.8),
                (2, SynthComplianceKind::Sag, 0.7),
                (4, SynthComplianceKind::Backlash, 0.5),
            ],
        );
        log.run.pose.timing.latency_s = 0.015;
    })
    .report();
    let degrees = |code: &str, joint: &str| {
        let value =
            single_finding(&report, code, joint).estimate.as_ref().and_then(|it| it.value());
        value.expect("a value").to_degrees()
    };
    for (code, joint, amount) in [
        ("MOT006", "shoulder_lift_joint", 0.8),
        ("MOT006", "wrist_2_joint", 0.5),
        ("ZER003", "elbow_joint", 0.7),
    ] {
        let found = degrees(code, joint);
        assert!((found - amount).abs() < 0.1 * amount, "{code} of {joint}: {found}");
    }
    let late = single_finding(&report, "LAT001", POSE).estimate.as_ref().and_then(|it| it.value());
    assert!((late.expect("a value") - 0.015).abs() < 1e-3, "{late:?}");
    assert!(!report.findings.iter().any(|found| found.code == "ZER001"));
}

#[test]
fn an_eccentric_gear_is_named_with_the_residual() {
    let log =
        Log::modified(|log| set_compliance(log, &[(1, SynthComplianceKind::Eccentricity(2), 0.8)]));
    let report = log.report();
    let message = &single_finding(&report, "MDL001", POSE).message;
    let expected =
        "it varies with the angle of shoulder_lift_joint: eccentric gear or encoder, ±0.8";
    assert!(message.contains(expected), "{message}");
    let is_zero_or_latency = |code: &str| code.starts_with("ZER") || code.starts_with("LAT");
    assert!(!report.findings.iter().any(|found| is_zero_or_latency(found.code)));
}

/// The arm rests, and its first joint vibrates.
fn vibrate(log: &mut Log, amplitude: f64, frequency_hz: f64) {
    log.run.motion = Motion::AtRest;
    log.run.joints.timing.rate_hz = 200.0;
    log.run.oscillation = Some(JointOscillation { joint: 0, amplitude, frequency_hz });
}

/// One joint moves at up to 1 rad/s and stops with this deceleration, rad/s².
fn stop_abruptly(log: &mut Log, deceleration: f64) {
    log.run.motion = Motion::OneJoint(1);
    log.run.speed = 1.0;
    log.run.joints.timing.rate_hz = 500.0;
    log.run.final_stop = Some(FinalStop { after_s: 3.0, deceleration });
}

/// The last joint rests at `past_rad`, one turn too far, which does not move the tool.
fn add_extra_turn(log: &mut Log, past_rad: f64) {
    log.run.home[5] = past_rad;
    log.run.motion = Motion::AtRest;
    log.run.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.0, 0.0, -TAU];
}
