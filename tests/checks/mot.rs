//! MOT: undesired or impossible motion.

use std::f64::consts::TAU;

use poseaudit::finding::{CheckRow, Status};
use poseaudit::geometry::Convention;
use poseaudit::synth::{
    COMMANDED_POSE, Commands, Gives, Giving, JOINT_STATES, Lines, Motion, POSE, Shake, Stop,
};

use crate::checks::case::On::{self, Joint};
use crate::checks::case::What::{About, Amount, Degrees, Frame};
use crate::checks::case::{Expected, Log, cases, error, info, the, warning};
use crate::checks::recording::throw;
use Expected::{BlamedOn, LeftOpenBy, Skipped, Sound, Undecided};

cases! {
    // The tip is 0.5096 m from the first joint's axis: 3 mrad are 1.529 mm, 1.081 mm rms.
    MOT001 a_servo_that_hunts: |log| shake(log, 3e-3, 12.0)
        => warning(On::Topic(JOINT_STATES), About(1.081e-3, 0.03e-3));
    MOT001 a_servo_that_hunts_a_little_is_sound: |log| {
        shake(log, 0.3e-3, 12.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => Sound;
    MOT001 a_slow_swing_is_work: |log| {
        shake(log, 10e-3, 4.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => Sound;
    MOT001 a_stop_is_no_shake: |log| {
        stop(log, 30.0);
        log.run.pose.timing.rate_hz = 50.0;
    } => BlamedOn("MOT002");
    MOT001 nothing_moves_without_joint_states: |log| log.run.joints.timing.rate_hz = 0.0
        => Skipped("joint states");

    MOT002 a_stop_at_thirty: |log| stop(log, 30.0)
        => warning(Joint("shoulder_lift_joint"), Amount(30.0, 3.0));
    MOT002 a_stop_at_ten_is_sound: |log| stop(log, 10.0) => Sound;
    MOT002 joints_in_degrees_are_no_motion: |log| log.run.joints.in_degrees = true
        => LeftOpenBy("ORD004", "correct them first");
    MOT002 a_joint_zero_stops_nothing: |log| log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6)
        => BlamedOn("ZER001");
    MOT002 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");

    MOT003 a_turn_too_many: |log| turn_too_many(log, 0.3)
        => LeftOpenBy("ORD009", "off by whole turns");
    MOT003 a_turn_that_is_hardly_too_many: |log| turn_too_many(log, 0.05)
        => info(Joint("wrist_3_joint"), About(0.05, 2e-3));
    MOT003 a_turn_within_the_limits_is_sound: |log| turn_too_many(log, -0.3) => Sound;
    MOT003 a_step_of_an_encoder_is_no_speed: |log| coarse_encoders(log) => Sound;
    MOT003 joints_in_degrees_are_within_no_limits: |log| log.run.joints.in_degrees = true
        => LeftOpenBy("ORD004", "correct them first");
    MOT003 a_joint_zero_within_the_limits: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    MOT003 no_joint_states_at_all: |log| log.run.joints.timing.rate_hz = 0.0
        => Skipped("joint states");

    MOT005 a_pose_that_is_ten_metres_off_once: |log| {
        log.edit = Some(|messages| throw(messages, POSE, &[70], [10.0, 0.0, 0.0]));
    } => warning(On::Topic(POSE), About(10.0, 0.1));
    MOT005 a_pose_that_is_off_now_and_then: |log| {
        log.edit = Some(|messages| throw(messages, POSE, &[0, 31, 90, 91, 150], [0.0, 0.8, 0.6]));
    } => warning(On::Topic(POSE), About(1.0, 0.1));
    MOT005 an_encoder_that_drops_a_bit: |log| {
        log.edit = Some(|messages| {
            let mut states = messages.iter_mut().filter(|message| message.topic == JOINT_STATES);
            states.nth(200).expect("a joint state").turn_joint(2, 0.5);
        });
    } => warning(On::JointOf(JOINT_STATES, "elbow_joint"), About(0.5, 0.02));
    MOT005 motion_is_not_stray: |log| log.run.pose.timing.rate_hz = 20.0 => Sound;
    MOT005 coarse_noise_is_not_stray: |log| {
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (1e-3, 2e-3);
    } => Sound;
    MOT005 a_late_pose_does_not_jump: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    MOT005 an_abrupt_stop_is_no_jump: |log| stop(log, 30.0) => BlamedOn("MOT002");
    MOT005 nothing_that_could_jump: |log| {
        log.run.joints.timing.rate_hz = 0.0;
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
    } => Skipped("no joint states, tool poses or transforms");

    MOT006 a_shoulder_with_play: |log| gives(log, &[(1, Giving::Play, 1.0)])
        => error(Joint("shoulder_lift_joint"), Degrees(1.0, 0.03));
    MOT006 an_elbow_with_some_play: |log| gives(log, &[(2, Giving::Play, 0.3)])
        => warning(Joint("elbow_joint"), Degrees(0.3, 0.02));
    MOT006 a_shoulder_that_is_pushed_through_its_play: |log| gives(log, &[(1, Giving::PushedPlay, 1.0)])
        => error(Joint("shoulder_lift_joint"), Degrees(1.0, 0.01));
    MOT006 a_wrist_that_is_pushed_through_its_play: |log| gives(log, &[(3, Giving::PushedPlay, 0.3)])
        => warning(Joint("wrist_1_joint"), Degrees(0.3, 0.01));
    MOT006 play_of_healthy_gears_is_sound: |log| gives(log, &[(1, Giving::Play, 0.05)]) => Sound;
    MOT006 a_late_pose_is_no_play: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    MOT006 a_joint_zero_is_no_play: |log| {
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    MOT006 sag_is_no_play: |log| gives(log, &[(1, Giving::Sag, 0.6)]) => BlamedOn("ZER003");
    MOT006 eccentric_gears_are_no_play: |log| gives(log, &[(1, Giving::Eccentric(2), 0.8)])
        => BlamedOn("MDL001");
    MOT006 an_arm_at_rest_shows_no_play: |log| log.run.motion = Motion::AtRest => Undecided("barely moves");
    MOT006 no_pose_beside_the_encoders: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");

    MOT004 a_line_that_is_bowed: |log| along(log, Lines { bow_m: 3e-3, ..Lines::default() })
        => warning(On::Topic(COMMANDED_POSE), Frame([3e-3, 0.2e-3], [0.0, 0.1]));
    MOT004 a_line_that_is_bowed_by_much: |log| along(log, Lines { bow_m: 8e-3, ..Lines::default() })
        => error(On::Topic(COMMANDED_POSE), Frame([8e-3, 0.4e-3], [0.0, 0.1]));
    MOT004 lines_as_they_should_be: |log| along(log, Lines::default()) => Sound;
    MOT004 half_a_millimetre_is_sound: |log| along(log, Lines { bow_m: 0.5e-3, ..Lines::default() })
        => Sound;
    MOT004 noise_is_no_bow: |log| {
        along(log, Lines::default());
        log.run.noise.joints = 5e-4;
        (log.run.noise.pose_m, log.run.noise.pose_rad) = (3e-4, 1e-3);
    } => Sound;
    MOT004 a_late_pose_keeps_to_its_line: |log| {
        along(log, Lines::default());
        log.run.pose.timing.latency_s = 0.05;
    } => BlamedOn("LAT001");
    MOT004 a_misread_pose_keeps_to_its_line: |log| {
        along(log, Lines::default());
        log.run.pose.coding = crate::checks::ord::misread_as_rpy();
    } => BlamedOn("ORD001");
    MOT004 a_joint_zero_bows_no_line: |log| {
        along(log, Lines::default());
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    MOT004 goals_are_no_lines: |log| {
        along(log, Lines::default());
        log.run.reference.commands = Commands::Goals;
    } => Skipped("goals, not a streamed path");
    MOT004 arcs_are_no_lines: |log| {
        along(log, Lines::default());
        log.run.motion = Motion::PickAndPlace;
    } => Skipped("no commanded path in this log is straight");
    MOT004 no_commands: |_| {} => Skipped("no commanded poses");
}

#[test]
fn steps_of_an_encoder_may_hide_shake() {
    let report = Log::with(coarse_encoders).audited();
    let of_joints = |row: &&CheckRow| row.code == "MOT001" && row.subject.label() == JOINT_STATES;
    let row = report.checks.iter().find(of_joints).expect("a row");
    assert_eq!(row.status, Status::Inconclusive, "{row:?}");
    assert!(row.reason.as_deref().is_some_and(|why| why.contains("hides vibration")), "{row:?}");
}

/// 9-bit encoders read at 1 kHz: a step between samples is 350°/s.
fn coarse_encoders(log: &mut Log) {
    (log.run.motion, log.run.amplitude) = (Motion::Continuous, 0.9);
    log.run.joints.timing.rate_hz = 1000.0;
    log.run.joints.quantum = TAU / 512.0;
    log.run.joints.with_velocity = false;
}

#[test]
fn what_is_usual_is_not_told_from_fifteen_samples() {
    let report = Log::with(|log| log.run.pose.timing.rate_hz = 1.9).audited();
    let of = |topic: &str| {
        let is_of = |row: &&CheckRow| row.subject.topic.as_deref() == Some(topic);
        let mut rows = report.checks.iter().filter(|row| row.code == "MOT005").filter(is_of);
        rows.next().expect("the stream is asked about")
    };
    assert_eq!(of(JOINT_STATES).status, Status::Pass);
    assert_eq!(of(POSE).status, Status::Inconclusive);
    assert!(of(POSE).reason.as_deref().is_some_and(|why| why.contains("fewer than 20 samples")));
}

/// The arm follows lines that are streamed to it 40 ms ahead.
pub fn along(log: &mut Log, lines: Lines) {
    log.run.motion = Motion::Lines(lines);
    log.run.duration_s = 12.0;
    log.run.pose.timing.rate_hz = 50.0;
    let timing = &mut log.run.reference.timing;
    (timing.rate_hz, timing.latency_s) = (50.0, -0.04);
}

#[test]
fn an_orientation_that_is_interpolated_by_its_numbers_is_told() {
    let log = Log::with(|log| {
        along(log, Lines { turned_by: Some(Convention::RPY), ..Lines::default() });
    });
    let report = log.audited();
    let found = the(&report, "MOT004", COMMANDED_POSE);
    assert_eq!(found.title, "orientation along the line is not a slerp");
    assert_eq!(found.evidence.more["interpolated"], "euler:xyz");
    assert!(found.message.ends_with("as if euler:xyz were interpolated"), "{}", found.message);
    assert_eq!(report.findings.len(), 1, "{}", crate::checks::case::summary(&report.findings));
    assert!(!report.findings.iter().any(|found| found.subject.label() == POSE));
}

/// Joint compliance, as index, kind and magnitude in degrees.
pub fn gives(log: &mut Log, gives: &[(usize, Giving, f64)]) {
    let of = |&(joint, how, degrees): &(usize, Giving, f64)| Gives {
        joint,
        how,
        by_rad: degrees.to_radians(),
    };
    log.run.gives = gives.iter().map(of).collect();
    log.run.duration_s = 15.0;
    log.run.joints.timing.rate_hz = 125.0;
    log.run.pose.timing.rate_hz = 50.0;
}

#[test]
fn play_at_two_joints_is_told_from_sag_and_from_a_latency_beside_it() {
    let report = Log::with(|log| {
        gives(log, &[(1, Giving::Play, 0.8), (2, Giving::Sag, 0.7), (4, Giving::Play, 0.5)]);
        log.run.pose.timing.latency_s = 0.015;
    })
    .audited();
    let degrees = |code: &str, joint: &str| {
        let value = the(&report, code, joint).estimate.as_ref().and_then(|it| it.value());
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
    let late = the(&report, "LAT001", POSE).estimate.as_ref().and_then(|it| it.value());
    assert!((late.expect("a value") - 0.015).abs() < 1e-3, "{late:?}");
    assert!(!report.findings.iter().any(|found| found.code == "ZER001"));
}

#[test]
fn an_eccentric_gear_is_said_with_what_is_left() {
    let log = Log::with(|log| gives(log, &[(1, Giving::Eccentric(2), 0.8)]));
    let report = log.audited();
    let message = &the(&report, "MDL001", POSE).message;
    let said = "it varies with the angle of shoulder_lift_joint: eccentric gear or encoder, ±0.8";
    assert!(message.contains(said), "{message}");
    let joint_or_time = |code: &str| code.starts_with("ZER") || code.starts_with("LAT");
    assert!(!report.findings.iter().any(|found| joint_or_time(found.code)));
}

/// The arm rests, and its first joint vibrates.
fn shake(log: &mut Log, amplitude: f64, frequency_hz: f64) {
    log.run.motion = Motion::AtRest;
    log.run.joints.timing.rate_hz = 200.0;
    log.run.shake = Some(Shake { joint: 0, amplitude, frequency_hz });
}

/// One joint moves at up to 1 rad/s and stops with this deceleration, rad/s².
fn stop(log: &mut Log, deceleration: f64) {
    log.run.motion = Motion::OneJoint(1);
    log.run.speed = 1.0;
    log.run.joints.timing.rate_hz = 500.0;
    log.run.stop = Some(Stop { after_s: 3.0, deceleration });
}

/// The last joint rests at `past_rad`, one turn too far, which does not move the tool.
fn turn_too_many(log: &mut Log, past_rad: f64) {
    log.run.home[5] = past_rad;
    log.run.motion = Motion::AtRest;
    log.run.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.0, 0.0, -TAU];
}
