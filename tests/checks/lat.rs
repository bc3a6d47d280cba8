//! LAT: late or early streams.

use poseaudit::finding::{CheckRow, Status};
use poseaudit::synth::{Camera, IMU, JOINT_STATES, Motion, MovingBase, POSE, TARGET, TF, Timing};

use crate::checks::case::ExpectedEstimate::Amount;
use crate::checks::case::ExpectedSubject::{Frame, Topic};
use crate::checks::case::{
    Expected, Log, cases, error, half_width, single_finding, summary, warning,
};
use crate::checks::recording::{shift_stamps, take_rotations};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, Skipped};

/// Poses in the odometry frame of a base that drives and turns.
fn drive(log: &mut Log) {
    let frame_id = "odom".to_owned();
    log.run.duration_s = 16.0;
    log.run.imu.timing.rate_hz = 0.0;
    log.run.pose.frame_id.clone_from(&frame_id);
    log.run.moving_base = Some(MovingBase {
        frame_id,
        reach_m: 1.5,
        turn_rad: 0.8,
        transform_timing: Timing::every(50.0, 0.0061),
    });
}

cases! {
    LAT001 a_late_pose: |log| log.run.pose.timing.latency_s = 0.015
        => error(Topic(POSE), Amount(0.015, 0.2e-3));
    LAT001 backlash_is_not_reported_as_latency: |log| {
        crate::checks::mot::set_compliance(log, &[(1, poseaudit::synth::SynthComplianceKind::Backlash, 1.0)]);
    } => OnlyOtherFinding("MOT006");
    LAT001 an_early_pose: |log| log.run.pose.timing.latency_s = -0.006
        => warning(Topic(POSE), Amount(-0.006, 0.2e-3));
    LAT001 a_very_late_pose: |log| log.run.pose.timing.latency_s = 1.5
        => error(Topic(POSE), Amount(1.5, 0.5e-3));
    LAT001 late_points: |log| {
        log.run.pose.timing.latency_s = 0.015;
        log.edit = Some(|messages| take_rotations(messages, POSE));
    } => error(Topic(POSE), Amount(0.015, 0.2e-3));
    LAT001 a_late_tf: |log| log.run.tf.timing.latency_s = 0.030
        => error(Topic(TF), Amount(0.030, 0.2e-3));
    LAT001 a_late_imu: |log| log.run.imu.timing.latency_s = 0.012
        => error(Topic(IMU), Amount(0.012, 0.3e-3));
    LAT001 a_late_imu_without_orientation: |log| {
        log.run.imu.timing.latency_s = 0.012;
        log.run.imu.has_orientation = false;
    } => error(Topic(IMU), Amount(0.012, 0.5e-3));
    LAT001 late_joint_states: |log| log.run.joints.timing.latency_s = 0.012
        => error(Topic(JOINT_STATES), Amount(0.012, 0.2e-3));
    LAT001 a_late_pose_without_velocities: |log| {
        log.run.joints.has_velocity = false;
        log.run.pose.timing.latency_s = 0.015;
    } => error(Topic(POSE), Amount(0.015, 0.2e-3));
    LAT001 a_late_pose_of_one_moving_wrist: |log| {
        log.run.motion = Motion::OneJoint(5);
        log.run.pose.timing.latency_s = 0.015;
    } => error(Topic(POSE), Amount(0.015, 0.5e-3));
    LAT001 a_late_target: |log| {
        crate::checks::hec::watch_target(log, Camera::InHand);
        log.run.target.timing.latency_s = 0.08;
    } => error(Topic(TARGET), Amount(0.08, 1.5e-3));
    LAT001 a_late_target_on_the_hand: |log| {
        crate::checks::hec::watch_target(log, Camera::InBase);
        log.run.target.timing.latency_s = 0.025;
    } => error(Topic(TARGET), Amount(0.025, 1.5e-3));
    LAT001 a_target_without_latency: |log| crate::checks::hec::watch_target(log, Camera::InHand) => NoFindings;

    LAT001 a_pose_on_a_moving_base_passes: drive => NoFindings;
    LAT001 late_transforms_of_a_moving_base: |log| {
        drive(log);
        log.run.moving_base.as_mut().expect("a moving base").transform_timing.latency_s = 0.06;
    } => error(Frame(TF, "odom"), Amount(0.06, 0.5e-3));
    LAT001 a_late_pose_on_a_moving_base: |log| {
        drive(log);
        log.run.pose.timing.latency_s = 0.015;
    } => error(Topic(POSE), Amount(0.015, 0.2e-3));

    LAT001 half_a_millisecond_passes: |log| log.run.pose.timing.latency_s = 0.5e-3 => NoFindings;

    LAT001 a_misread_rotation_is_not_reported_as_latency: |log| log.run.pose.encoding = crate::checks::ord::misread_as_rpy()
        => OnlyOtherFinding("ORD001");
    LAT001 an_inverted_pose_is_not_reported_as_latency: |log| {
        log.run.pose.encoding = poseaudit::synth::LoggedEncoding::Inverted;
    } => OnlyOtherFinding("ORD003");
    LAT001 a_zero_offset_is_not_reported_as_latency: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => OnlyOtherFinding("ZER001");
    LAT001 a_tool_offset_is_not_reported_as_latency: |log| {
        log.run.pose.tip_from_stream = crate::checks::frm::tool_offset();
    } => OnlyOtherFinding("FRM003");
    LAT001 clock_skew_is_not_reported_as_latency: |log| log.run.pose.timing.skew = 300e-6
        => OnlyOtherFinding("LAT002");
    LAT001 clock_skew_of_an_imu_is_not_reported_as_latency: |log| log.run.imu.timing.skew = 2e-3
        => OnlyOtherFinding("LAT002");

    LAT001 only_joint_states: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose, /tf or IMU");
    LAT001 an_arm_at_rest: |log| log.run.motion = Motion::AtRest => Inconclusive("barely moves");
    LAT001 periodic_motion: |log| {
        log.run.motion = Motion::Periodic { period_s: 0.8 };
    } => Inconclusive("the motion is periodic");

    LAT002 a_clock_that_runs_slow: |log| log.run.pose.timing.skew = 400e-6
        => warning(Topic(POSE), Amount(400e-6, 10e-6));
    LAT002 a_clock_that_runs_fast: |log| log.run.pose.timing.skew = -800e-6
        => error(Topic(POSE), Amount(-800e-6, 10e-6));
    LAT002 a_clock_that_runs_slow_on_a_moving_base: |log| {
        drive(log);
        log.run.pose.timing.skew = 400e-6;
    } => warning(Topic(POSE), Amount(400e-6, 20e-6));
    LAT002 a_skew_of_ten_millionths_passes: |log| log.run.pose.timing.skew = 10e-6 => NoFindings;
    LAT002 a_late_pose_is_not_reported_as_clock_skew: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    LAT002 a_drifting_imu_is_not_reported_as_clock_skew: |log| log.run.imu.yaw_drift_rad_s = 1e-3
        => OnlyOtherFinding("YAW001");
    LAT002 radial_scale_is_not_reported_as_clock_skew: |log| log.run.pose.radial_scale_error = 0.01 => OnlyOtherFinding("ZER002");
    LAT002 an_imu_on_a_fast_clock: |log| log.run.imu.timing.skew = 800e-6
        => error(Topic(IMU), Amount(800e-6, 30e-6));
    LAT002 an_imu_on_a_slow_clock_without_orientation: |log| {
        log.run.imu.timing.skew = -2e-3;
        log.run.imu.has_orientation = false;
    } => error(Topic(IMU), Amount(-2e-3, 0.1e-3));
    LAT002 a_late_imu_is_not_reported_as_clock_skew: |log| log.run.imu.timing.latency_s = 0.16
        => OnlyOtherFinding("LAT001");
    LAT002 no_stream_for_clock_skew: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose or IMU stream");
    LAT002 clock_skew_is_not_observable_at_rest: |log| log.run.motion = Motion::AtRest
        => Inconclusive("barely moves");

    LAT003 a_latency_step_of_a_pose: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| shift_stamps(messages, POSE, 10.0, f64::MAX, 0.030));
    } => error(Topic(POSE), Amount(0.030, 1e-3));
    LAT003 a_negative_latency_step_of_a_pose: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| shift_stamps(messages, POSE, 9.0, f64::MAX, -0.012));
    } => warning(Topic(POSE), Amount(-0.012, 1e-3));
    LAT003 a_latency_step_of_a_pose_on_a_moving_base: |log| {
        drive(log);
        log.edit = Some(|messages| shift_stamps(messages, POSE, 9.0, f64::MAX, -0.012));
    } => warning(Topic(POSE), Amount(-0.012, 1e-3));
    LAT003 a_clock_step_of_a_pose_on_a_moving_base: |log| {
        drive(log);
        log.edit = Some(|messages| shift_stamps(messages, POSE, 9.0, f64::MAX, 0.8));
    } => error(Topic(POSE), Amount(0.8, 2e-3));
    LAT003 a_latency_step_of_an_imu: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| shift_stamps(messages, IMU, 9.0, f64::MAX, 0.025));
    } => error(Topic(IMU), Amount(0.025, 1e-3));
    LAT003 a_latency_step_of_an_imu_without_orientation: |log| {
        log.run.duration_s = 16.0;
        log.run.imu.has_orientation = false;
        log.edit = Some(|messages| shift_stamps(messages, IMU, 9.0, f64::MAX, 0.040));
    } => error(Topic(IMU), Amount(0.040, 3e-3));
    LAT003 a_latency_step_of_joint_states: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| shift_stamps(messages, JOINT_STATES, 10.0, f64::MAX, 0.030));
    } => error(Topic(JOINT_STATES), Amount(0.030, 1e-3));
    LAT003 a_latency_step_of_a_millisecond_passes: |log| {
        log.edit = Some(|messages| shift_stamps(messages, POSE, 5.0, f64::MAX, 0.001));
    } => NoFindings;
    LAT003 a_late_pose_is_not_reported_as_latency_step: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    LAT003 clock_skew_is_not_reported_as_latency_step: |log| log.run.pose.timing.skew = 400e-6 => OnlyOtherFinding("LAT002");
    LAT003 a_zero_offset_is_not_reported_as_latency_step: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => OnlyOtherFinding("ZER001");
    LAT003 radial_scale_is_not_reported_as_latency_step: |log| log.run.pose.radial_scale_error = 0.01 => OnlyOtherFinding("ZER002");
    LAT003 no_stream_for_latency_steps: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose, /tf or IMU");
    LAT003 latency_steps_are_not_observable_at_rest: |log| log.run.motion = Motion::AtRest
        => Inconclusive("barely moves");
}

#[test]
fn a_stream_on_another_clock_has_the_interval_of_the_transport_delay() {
    let report = Log::modified(|log| log.run.imu.timing.clock_offset_s = -1000.0).report();
    assert_eq!(report.findings.len(), 1, "{}", summary(&report.findings));
    let is_imus = |row: &&CheckRow| row.code == "LAT001" && row.subject.label() == IMU;
    let row = report.checks.iter().find(is_imus).expect("a row");
    assert_ne!(row.status, Status::Fail);
    let half = row.estimate.as_ref().and_then(half_width).expect("an interval");
    // The generator's transport takes 0.1 to 2 ms.
    assert!((0.5e-3..5e-3).contains(&half), "{half}");
}

#[test]
fn without_a_third_stream_joint_latency_is_a_confounder() {
    let mut log = Log::modified(|log| log.run.pose.timing.latency_s = 0.015);
    let indistinguishable = |log: &Log| {
        let report = log.report();
        let finding = single_finding(&report, "LAT001", POSE);
        let others = finding.evidence.indistinguishable.iter();
        others
            .map(|other| {
                let value = other.estimate.as_ref().and_then(|estimate| estimate.value());
                (other.code, other.subject.label().to_owned(), value.expect("a value") < 0.0)
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(indistinguishable(&log), []);
    log.run.imu.timing.rate_hz = 0.0;
    log.run.tf.timing.rate_hz = 0.0;
    assert_eq!(indistinguishable(&log), [("LAT001", JOINT_STATES.to_owned(), true)]);
}

#[test]
fn tf_with_the_stamps_of_the_joint_states_does_not_confirm_their_latency() {
    let report = Log::modified(|log| {
        log.run.joints.timing.latency_s = 0.012;
        log.run.tf.timing = Timing { rate_hz: 12.5, ..log.run.joints.timing };
        log.run.imu.timing.rate_hz = 0.0;
    })
    .report();
    // The pose is the only early stream, and no third stream shows which side is at fault.
    let finding = single_finding(&report, "LAT001", POSE);
    let value = finding.estimate.as_ref().and_then(|estimate| estimate.value());
    assert!(value.is_some_and(|value| (value + 0.012).abs() < 0.2e-3), "{finding:#?}");
    assert_eq!(finding.evidence.indistinguishable[0].subject.label(), JOINT_STATES);
    assert_eq!(report.findings.len(), 1);
}

#[test]
fn with_correlated_noise_the_interval_covers_the_true_latency() {
    for seed in 1..=4 {
        let mut log = Log::modified(|log| {
            log.run.seed = seed;
            log.run.pose.timing.latency_s = 0.015;
            log.run.noise.pose_m = 2e-4;
            log.run.noise.pose_rad = 2e-4;
        });
        let mut half_width_with = |correlation: f64| {
            log.run.noise.correlation = correlation;
            let report = log.report();
            let estimate =
                single_finding(&report, "LAT001", POSE).estimate.clone().expect("an estimate");
            let half = half_width(&estimate).expect("an interval");
            let off = (estimate.value().expect("a value") - 0.015).abs();
            assert!(off <= 2.0 * half, "seed {seed}, correlation {correlation}: {off} ± {half}");
            half
        };
        let (white, coloured) = (half_width_with(0.0), half_width_with(0.95));
        assert!(coloured > 1.1 * white, "seed {seed}: {coloured} against {white}");
    }
}

#[test]
fn a_clock_of_the_joint_states_that_is_set_back_is_one_finding() {
    let report = Log::modified(|log| {
        log.run.duration_s = 20.0;
        log.run.joints.timing.clock_step = Some((9.0, -0.08));
    })
    .report();
    let stepped = report.findings.iter().find(|finding| finding.code == "LAT003").expect("LAT003");
    assert_eq!(stepped.subject.label(), JOINT_STATES);
    Amount(-0.08, 2e-3).assert_matches(stepped.estimate.as_ref());
    let others = report.findings.iter().filter(|finding| !finding.code.starts_with("TIM"));
    assert_eq!(others.count(), 1, "found:\n{}", summary(&report.findings));
}
