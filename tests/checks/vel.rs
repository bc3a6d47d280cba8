//! VEL and LAT004: velocities compared with positions, and states with commands.

use std::f64::consts::TAU;

use poseaudit::finding::{Severity, Status};
use poseaudit::synth::{COMMANDED_JOINTS, COMMANDED_POSE, Commands, JOINT_STATES};

use crate::checks::case::ExpectedEstimate::Amount;
use crate::checks::case::ExpectedSubject::{JointOf, Topic};
use crate::checks::case::{Expected, Log, cases, error, single_finding, summary, warning};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, Skipped};

cases! {
    VEL001 velocities_in_degrees_per_second: |log| scale_velocities(log, &[1_f64.to_degrees(); 6])
        => error(Topic(JOINT_STATES), Amount(56.3, 0.1));
    VEL001 a_velocity_with_the_wrong_sign: |log| scale_velocities(log, &[1.0, 1.0, -1.0])
        => error(JointOf(JOINT_STATES, "elbow_joint"), Amount(2.0, 0.01));
    VEL001 a_velocity_10_percent_too_large: |log| scale_velocities(log, &[1.0, 1.1])
        => warning(JointOf(JOINT_STATES, "shoulder_lift_joint"), Amount(0.1, 2e-3));
    VEL001 velocities_that_are_always_zero: |log| scale_velocities(log, &[0.0; 6])
        => error(Topic(JOINT_STATES), Amount(1.0, 0.01));
    VEL001 correct_velocities: |_| {} => NoFindings;
    VEL001 velocities_three_milliseconds_late_pass: |log| log.run.joints.velocity_latency_s = 3e-3 => NoFindings;
    VEL001 velocities_from_14_bit_encoders_pass: |log| log.run.joints.resolution = TAU / 16384.0 => NoFindings;
    VEL001 velocities_with_noisy_positions_pass: |log| log.run.noise.joints = 1e-4 => NoFindings;
    VEL001 a_late_pose_is_not_reported_as_velocities: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    VEL001 a_zero_offset_is_not_reported_as_velocities: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => OnlyOtherFinding("ZER001");
    VEL001 joints_in_degrees_are_not_reported_as_velocities: |log| log.run.joints.is_in_degrees = true
        => OnlyOtherFinding("ORD004");
    // Its velocities have the right sign, but its positions do not.
    VEL001 a_reversed_joint_is_not_reported_as_velocities: |log| {
        log.run.joints.scales = vec![1.0, 1.0, -1.0];
        scale_velocities(log, &[1.0, 1.0, -1.0]);
    } => OnlyOtherFinding("ORD009");
    VEL001 no_velocities: |log| log.run.joints.has_velocity = false
        => Skipped("no velocities");

    LAT004 joints_followed_late: |log| set_command_lead(log, Commands::Joints, 0.14)
        => warning(Topic(COMMANDED_JOINTS), Amount(0.14, 1e-3));
    LAT004 joints_followed_very_late: |log| set_command_lead(log, Commands::Joints, 0.3)
        => error(Topic(COMMANDED_JOINTS), Amount(0.3, 1e-3));
    LAT004 poses_followed_late: |log| set_command_lead(log, Commands::Poses, 0.14)
        => warning(Topic(COMMANDED_POSE), Amount(0.14, 1e-3));
    LAT004 joints_followed_soon: |log| set_command_lead(log, Commands::Joints, 0.03) => NoFindings;
    LAT004 poses_followed_soon: |log| set_command_lead(log, Commands::Poses, 0.02) => NoFindings;
    LAT004 a_late_pose_is_not_reported_as_command_delay: |log| {
        set_command_lead(log, Commands::Joints, 0.02);
        log.run.pose.timing.latency_s = 0.08;
    } => OnlyOtherFinding("LAT001");
    LAT004 goals_do_not_determine_the_command_delay: |log| set_command_lead(log, Commands::Goals, 0.14) => Inconclusive("goals");
    LAT004 no_commands: |_| {} => Skipped("no commands");
}

/// Scales only the velocities.
fn scale_velocities(log: &mut Log, scales: &[f64]) {
    log.run.joints.velocity_scales = scales.to_vec();
}

/// Commands that lead the arm by `ahead_s`.
fn set_command_lead(log: &mut Log, commands: Commands, ahead_s: f64) {
    let timing = &mut log.run.reference.timing;
    (timing.rate_hz, timing.latency_s) = (50.0, -ahead_s);
    log.run.reference.commands = commands;
}

#[test]
fn late_velocities_are_reported_with_their_delay() {
    let report = Log::modified(|log| log.run.joints.velocity_latency_s = 0.06).report();
    assert!(
        report.findings.iter().all(|found| found.code == "VEL001"),
        "{}",
        summary(&report.findings)
    );
    let found = single_finding(&report, "VEL001", JOINT_STATES);
    assert_eq!(found.severity, Severity::Warning);
    let delay_s = found.evidence.more["delay_s"].as_f64().expect("a delay");
    assert!((delay_s - 0.06).abs() < 2e-3, "{delay_s}");
    assert!(found.message.contains("velocities lag the positions by 6"), "{}", found.message);
}

#[test]
fn the_command_delay_is_independent_of_the_start_time() {
    let delays = |start_s: i64| {
        let report = Log::modified(|log| {
            set_command_lead(log, Commands::Joints, 0.14);
            log.run.start = log.run.start.shifted(start_s as f64);
        });
        let found = single_finding(&report.report(), "LAT004", COMMANDED_JOINTS).clone();
        found.estimate.and_then(|estimate| estimate.value()).expect("a delay")
    };
    assert!((delays(0) - delays(86_400)).abs() < 1e-6);
}

#[test]
fn the_velocity_of_a_resting_joint_is_inconclusive() {
    let report =
        Log::modified(|log| log.run.motion = poseaudit::synth::Motion::OneJoint(1)).report();
    let rows = report.checks.iter().filter(|row| row.code == "VEL001");
    let statuses: Vec<Status> = rows.map(|row| row.status).collect();
    let passed = statuses.iter().filter(|status| **status == Status::Pass).count();
    assert_eq!((statuses.len(), passed), (6, 1), "{statuses:?}");
    assert!(statuses.iter().all(|status| *status != Status::Fail));
}
