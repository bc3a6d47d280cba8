//! VEL and LAT004: velocities compared with positions, and states with commands.

use std::f64::consts::TAU;

use poseaudit::finding::{Severity, Status};
use poseaudit::synth::{COMMANDED_JOINTS, COMMANDED_POSE, Commands, JOINT_STATES};

use crate::checks::case::On::{JointOf, Topic};
use crate::checks::case::What::Amount;
use crate::checks::case::{Expected, Log, cases, error, summary, the, warning};
use Expected::{BlamedOn, Skipped, Sound, Undecided};

cases! {
    VEL001 velocities_in_degrees_per_second: |log| scaled(log, &[1_f64.to_degrees(); 6])
        => error(Topic(JOINT_STATES), Amount(56.3, 0.1));
    VEL001 a_velocity_with_the_wrong_sign: |log| scaled(log, &[1.0, 1.0, -1.0])
        => error(JointOf(JOINT_STATES, "elbow_joint"), Amount(2.0, 0.01));
    VEL001 a_velocity_that_is_a_tenth_too_large: |log| scaled(log, &[1.0, 1.1])
        => warning(JointOf(JOINT_STATES, "shoulder_lift_joint"), Amount(0.1, 2e-3));
    VEL001 velocities_that_are_never_filled: |log| scaled(log, &[0.0; 6])
        => error(Topic(JOINT_STATES), Amount(1.0, 0.01));
    VEL001 velocities_as_they_should_be: |_| {} => Sound;
    VEL001 three_milliseconds_late_is_sound: |log| log.run.joints.velocity_late_s = 3e-3 => Sound;
    VEL001 fourteen_bits_are_sound: |log| log.run.joints.quantum = TAU / 16384.0 => Sound;
    VEL001 noise_of_the_positions_is_sound: |log| log.run.noise.joints = 1e-4 => Sound;
    VEL001 a_late_pose_says_nothing_of_velocities: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    VEL001 a_joint_zero_has_no_rate: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => BlamedOn("ZER001");
    VEL001 joints_in_degrees_have_velocities_in_degrees: |log| log.run.joints.in_degrees = true
        => BlamedOn("ORD004");
    // Its velocities have the right sign, but its positions do not.
    VEL001 a_joint_that_counts_backwards: |log| {
        log.run.joints.scales = vec![1.0, 1.0, -1.0];
        scaled(log, &[1.0, 1.0, -1.0]);
    } => BlamedOn("ORD009");
    VEL001 no_velocities: |log| log.run.joints.with_velocity = false
        => Skipped("no velocities");

    LAT004 joints_that_follow_late: |log| led(log, Commands::Joints, 0.14)
        => warning(Topic(COMMANDED_JOINTS), Amount(0.14, 1e-3));
    LAT004 joints_that_follow_very_late: |log| led(log, Commands::Joints, 0.3)
        => error(Topic(COMMANDED_JOINTS), Amount(0.3, 1e-3));
    LAT004 poses_that_are_followed_late: |log| led(log, Commands::Poses, 0.14)
        => warning(Topic(COMMANDED_POSE), Amount(0.14, 1e-3));
    LAT004 joints_that_follow_soon: |log| led(log, Commands::Joints, 0.03) => Sound;
    LAT004 poses_that_are_followed_soon: |log| led(log, Commands::Poses, 0.02) => Sound;
    LAT004 a_late_pose_is_no_delay: |log| {
        led(log, Commands::Joints, 0.02);
        log.run.pose.timing.latency_s = 0.08;
    } => BlamedOn("LAT001");
    LAT004 goals_tell_no_delay: |log| led(log, Commands::Goals, 0.14) => Undecided("goals");
    LAT004 no_commands: |_| {} => Skipped("no commands");
}

/// Scales only the velocities.
fn scaled(log: &mut Log, scales: &[f64]) {
    log.run.joints.velocity_scales = scales.to_vec();
}

/// Commands that lead the arm by `ahead_s`.
fn led(log: &mut Log, commands: Commands, ahead_s: f64) {
    let timing = &mut log.run.reference.timing;
    (timing.rate_hz, timing.latency_s) = (50.0, -ahead_s);
    log.run.reference.commands = commands;
}

#[test]
fn velocities_that_are_late_are_told_by_how_much() {
    let report = Log::with(|log| log.run.joints.velocity_late_s = 0.06).audited();
    assert!(
        report.findings.iter().all(|found| found.code == "VEL001"),
        "{}",
        summary(&report.findings)
    );
    let found = the(&report, "VEL001", JOINT_STATES);
    assert_eq!(found.severity, Severity::Warning);
    let delay_s = found.evidence.more["delay_s"].as_f64().expect("a delay");
    assert!((delay_s - 0.06).abs() < 2e-3, "{delay_s}");
    assert!(found.message.contains("velocities lag the positions by 6"), "{}", found.message);
}

#[test]
fn a_delay_does_not_hang_on_when_the_log_began() {
    let delays = |start_s: i64| {
        let report = Log::with(|log| {
            led(log, Commands::Joints, 0.14);
            log.run.start = log.run.start.shifted(start_s as f64);
        });
        let found = the(&report.audited(), "LAT004", COMMANDED_JOINTS).clone();
        found.estimate.and_then(|estimate| estimate.value()).expect("a delay")
    };
    assert!((delays(0) - delays(86_400)).abs() < 1e-6);
}

#[test]
fn a_joint_that_rests_leaves_its_velocity_open() {
    let report = Log::with(|log| log.run.motion = poseaudit::synth::Motion::OneJoint(1)).audited();
    let rows = report.checks.iter().filter(|row| row.code == "VEL001");
    let statuses: Vec<Status> = rows.map(|row| row.status).collect();
    let passed = statuses.iter().filter(|status| **status == Status::Pass).count();
    assert_eq!((statuses.len(), passed), (6, 1), "{statuses:?}");
    assert!(statuses.iter().all(|status| *status != Status::Fail));
}
