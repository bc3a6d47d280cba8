//! MOT: motion that an arm should not make, or cannot.

use std::f64::consts::TAU;

use poseaudit::synth::{JOINT_STATES, Motion, Shake, Stop};

use crate::case::On::{self, Joint};
use crate::case::What::{About, Amount};
use crate::case::{Expected, Log, cases, info, warning};
use Expected::{BlamedOn, LeftOpenBy, Skipped, Sound};

cases! {
    // The tip is 0.5096 m off the first joint's axis: 3 mrad are 1.529 mm, 1.081 mm rms.
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
        => LeftOpenBy("ORD004", "read them right first");
    MOT002 a_joint_zero_stops_nothing: |log| log.run.joints.zero_offsets = crate::zer::zero(2, 0.6)
        => BlamedOn("ZER001");
    MOT002 no_joint_states: |log| log.run.joints.timing.rate_hz = 0.0 => Skipped("joint states");

    MOT003 a_turn_too_many: |log| turn_too_many(log, 0.3)
        => warning(Joint("wrist_3_joint"), About(0.3, 2e-3));
    MOT003 a_turn_that_is_hardly_too_many: |log| turn_too_many(log, 0.05)
        => info(Joint("wrist_3_joint"), About(0.05, 2e-3));
    MOT003 a_turn_within_the_limits_is_sound: |log| turn_too_many(log, -0.3) => Sound;
    MOT003 joints_in_degrees_are_within_no_limits: |log| log.run.joints.in_degrees = true
        => LeftOpenBy("ORD004", "read them right first");
    MOT003 a_joint_zero_within_the_limits: |log| {
        log.run.joints.zero_offsets = crate::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    MOT003 no_joint_states_at_all: |log| log.run.joints.timing.rate_hz = 0.0
        => Skipped("joint states");
}

/// The arm rests, and its first joint shakes.
fn shake(log: &mut Log, amplitude: f64, frequency_hz: f64) {
    log.run.motion = Motion::AtRest;
    log.run.joints.timing.rate_hz = 200.0;
    log.run.shake = Some(Shake { joint: 0, amplitude, frequency_hz });
}

/// One joint moves at up to 1 rad/s and is stopped so hard, rad/s².
fn stop(log: &mut Log, deceleration: f64) {
    log.run.motion = Motion::OneJoint(1);
    log.run.speed = 1.0;
    log.run.joints.timing.rate_hz = 500.0;
    log.run.stop = Some(Stop { after_s: 3.0, deceleration });
}

/// The last joint rests at `past_rad` and counts a turn more, which moves nothing.
fn turn_too_many(log: &mut Log, past_rad: f64) {
    log.run.home[5] = past_rad;
    log.run.motion = Motion::AtRest;
    log.run.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.0, 0.0, -TAU];
}
