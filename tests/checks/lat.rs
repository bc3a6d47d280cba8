//! LAT: late or early streams.

use poseaudit::finding::{CheckRow, Status};
use poseaudit::synth::{Camera, IMU, JOINT_STATES, Motion, POSE, TARGET, TF, Timing};

use crate::checks::case::On::Topic;
use crate::checks::case::What::Amount;
use crate::checks::case::{Expected, Log, cases, error, half_width, summary, the, warning};
use crate::checks::recording::restamp;
use Expected::{BlamedOn, Skipped, Sound, Undecided};

cases! {
    LAT001 a_late_pose: |log| log.run.pose.timing.latency_s = 0.015
        => error(Topic(POSE), Amount(0.015, 0.2e-3));
    LAT001 play_is_no_latency: |log| {
        crate::checks::mot::gives(log, &[(1, poseaudit::synth::Giving::Play, 1.0)]);
    } => BlamedOn("MOT006");
    LAT001 an_early_pose: |log| log.run.pose.timing.latency_s = -0.006
        => warning(Topic(POSE), Amount(-0.006, 0.2e-3));
    LAT001 a_very_late_pose: |log| log.run.pose.timing.latency_s = 1.5
        => error(Topic(POSE), Amount(1.5, 0.5e-3));
    LAT001 a_late_tf: |log| log.run.tf.timing.latency_s = 0.030
        => error(Topic(TF), Amount(0.030, 0.2e-3));
    LAT001 a_late_imu: |log| log.run.imu.timing.latency_s = 0.012
        => error(Topic(IMU), Amount(0.012, 0.3e-3));
    LAT001 a_late_imu_without_orientation: |log| {
        log.run.imu.timing.latency_s = 0.012;
        log.run.imu.with_orientation = false;
    } => error(Topic(IMU), Amount(0.012, 0.5e-3));
    LAT001 late_joint_states: |log| log.run.joints.timing.latency_s = 0.012
        => error(Topic(JOINT_STATES), Amount(0.012, 0.2e-3));
    LAT001 a_late_pose_without_velocities: |log| {
        log.run.joints.with_velocity = false;
        log.run.pose.timing.latency_s = 0.015;
    } => error(Topic(POSE), Amount(0.015, 0.2e-3));
    LAT001 a_late_pose_of_one_moving_wrist: |log| {
        log.run.motion = Motion::OneJoint(5);
        log.run.pose.timing.latency_s = 0.015;
    } => error(Topic(POSE), Amount(0.015, 0.5e-3));
    LAT001 a_target_that_is_seen_late: |log| {
        crate::checks::hec::watched(log, Camera::InHand);
        log.run.target.timing.latency_s = 0.08;
    } => error(Topic(TARGET), Amount(0.08, 1.5e-3));
    LAT001 a_target_on_the_hand_that_is_seen_late: |log| {
        crate::checks::hec::watched(log, Camera::InBase);
        log.run.target.timing.latency_s = 0.025;
    } => error(Topic(TARGET), Amount(0.025, 1.5e-3));
    LAT001 a_target_that_is_seen_in_time: |log| crate::checks::hec::watched(log, Camera::InHand) => Sound;

    LAT001 half_a_millisecond_is_sound: |log| log.run.pose.timing.latency_s = 0.5e-3 => Sound;

    LAT001 a_misread_rotation_is_no_latency: |log| log.run.pose.coding = crate::checks::ord::misread_as_rpy()
        => BlamedOn("ORD001");
    LAT001 an_inverted_pose_is_no_latency: |log| {
        log.run.pose.coding = poseaudit::synth::Coding::Inverted;
    } => BlamedOn("ORD003");
    LAT001 a_joint_zero_is_no_latency: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => BlamedOn("ZER001");
    LAT001 a_tool_is_no_latency: |log| {
        log.run.pose.tip_from_stream = crate::checks::frm::tool();
    } => BlamedOn("FRM003");
    LAT001 a_skew_is_no_latency_at_mid_run: |log| log.run.pose.timing.skew = 300e-6
        => BlamedOn("LAT002");
    LAT001 a_skew_of_an_imu_is_no_latency_at_mid_run: |log| log.run.imu.timing.skew = 2e-3
        => BlamedOn("LAT002");

    LAT001 no_stream_beside_the_joints: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose, /tf or IMU");
    LAT001 an_arm_at_rest: |log| log.run.motion = Motion::AtRest => Undecided("barely moves");
    LAT001 motion_that_repeats_itself: |log| {
        log.run.motion = Motion::Periodic { period_s: 0.8 };
    } => Undecided("the motion is periodic");

    LAT002 a_clock_that_runs_slow: |log| log.run.pose.timing.skew = 400e-6
        => warning(Topic(POSE), Amount(400e-6, 10e-6));
    LAT002 a_clock_that_runs_fast: |log| log.run.pose.timing.skew = -800e-6
        => error(Topic(POSE), Amount(-800e-6, 10e-6));
    LAT002 ten_millionths_are_sound: |log| log.run.pose.timing.skew = 10e-6 => Sound;
    LAT002 a_late_pose_is_not_growing_late: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    LAT002 a_drifting_imu_is_no_skew: |log| log.run.imu.yaw_drift_rad_s = 1e-3
        => BlamedOn("YAW001");
    LAT002 growth_with_reach_is_no_skew: |log| log.run.pose.growth = 0.01 => BlamedOn("ZER002");
    LAT002 an_imu_on_a_fast_clock: |log| log.run.imu.timing.skew = 800e-6
        => error(Topic(IMU), Amount(800e-6, 30e-6));
    LAT002 an_imu_on_a_slow_clock_without_orientation: |log| {
        log.run.imu.timing.skew = -2e-3;
        log.run.imu.with_orientation = false;
    } => error(Topic(IMU), Amount(-2e-3, 0.1e-3));
    LAT002 a_late_imu_is_not_growing_late: |log| log.run.imu.timing.latency_s = 0.16
        => BlamedOn("LAT001");
    LAT002 no_stream_to_grow_late: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose or IMU stream");
    LAT002 an_arm_at_rest_shows_no_skew: |log| log.run.motion = Motion::AtRest
        => Undecided("barely moves");

    LAT003 a_pose_that_is_later_from_a_moment_on: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| restamp(messages, POSE, 10.0, f64::MAX, 0.030));
    } => error(Topic(POSE), Amount(0.030, 1e-3));
    LAT003 a_pose_that_is_earlier_from_a_moment_on: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| restamp(messages, POSE, 9.0, f64::MAX, -0.012));
    } => warning(Topic(POSE), Amount(-0.012, 1e-3));
    LAT003 an_imu_that_is_later_from_a_moment_on: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| restamp(messages, IMU, 9.0, f64::MAX, 0.025));
    } => error(Topic(IMU), Amount(0.025, 1e-3));
    LAT003 an_imu_without_orientation_that_is_later_from_a_moment_on: |log| {
        log.run.duration_s = 16.0;
        log.run.imu.with_orientation = false;
        log.edit = Some(|messages| restamp(messages, IMU, 9.0, f64::MAX, 0.040));
    } => error(Topic(IMU), Amount(0.040, 3e-3));
    LAT003 joint_states_that_are_later_from_a_moment_on: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| restamp(messages, JOINT_STATES, 10.0, f64::MAX, 0.030));
    } => error(Topic(JOINT_STATES), Amount(0.030, 1e-3));
    LAT003 a_jump_of_a_millisecond_is_sound: |log| {
        log.edit = Some(|messages| restamp(messages, POSE, 5.0, f64::MAX, 0.001));
    } => Sound;
    LAT003 a_late_pose_is_steady: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    LAT003 a_skew_is_no_jump: |log| log.run.pose.timing.skew = 400e-6 => BlamedOn("LAT002");
    LAT003 a_joint_zero_is_no_jump: |log| log.run.joints.zero_offsets = vec![0.0, 0.0, 0.02]
        => BlamedOn("ZER001");
    LAT003 growth_with_reach_is_no_jump: |log| log.run.pose.growth = 0.01 => BlamedOn("ZER002");
    LAT003 no_stream_to_jump: |log| {
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 0.0;
        log.run.imu.timing.rate_hz = 0.0;
    } => Skipped("no pose, /tf or IMU");
    LAT003 an_arm_at_rest_shows_no_jump: |log| log.run.motion = Motion::AtRest
        => Undecided("barely moves");
}

#[test]
fn a_stream_on_another_clock_is_judged_to_the_transports_spread() {
    let report = Log::with(|log| log.run.imu.timing.clock_offset_s = -1000.0).audited();
    assert_eq!(report.findings.len(), 1, "{}", summary(&report.findings));
    let is_imus = |row: &&CheckRow| row.code == "LAT001" && row.subject.label() == IMU;
    let row = report.checks.iter().find(is_imus).expect("a row");
    assert_ne!(row.status, Status::Fail);
    let half = row.estimate.as_ref().and_then(half_width).expect("an interval");
    // The generator's transport takes 0.1 to 2 ms.
    assert!((0.5e-3..5e-3).contains(&half), "{half}");
}

#[test]
fn a_latency_counts_against_the_joints_where_there_is_no_third_stream() {
    let mut log = Log::with(|log| log.run.pose.timing.latency_s = 0.015);
    let indistinguishable = |log: &Log| {
        let report = log.audited();
        let finding = the(&report, "LAT001", POSE);
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
fn a_tf_with_the_joints_own_stamps_is_no_witness_against_them() {
    let report = Log::with(|log| {
        log.run.joints.timing.latency_s = 0.012;
        log.run.tf.timing = Timing { rate_hz: 12.5, ..log.run.joints.timing };
        log.run.imu.timing.rate_hz = 0.0;
    })
    .audited();
    // The pose is the only early stream, and no third stream shows which side is at fault.
    let finding = the(&report, "LAT001", POSE);
    let value = finding.estimate.as_ref().and_then(|estimate| estimate.value());
    assert!(value.is_some_and(|value| (value + 0.012).abs() < 0.2e-3), "{finding:#?}");
    assert_eq!(finding.evidence.indistinguishable[0].subject.label(), JOINT_STATES);
    assert_eq!(report.findings.len(), 1);
}

#[test]
fn coloured_noise_widens_the_interval_so_that_it_holds_the_truth() {
    for seed in 1..=4 {
        let mut log = Log::with(|log| {
            log.run.seed = seed;
            log.run.pose.timing.latency_s = 0.015;
            log.run.noise.pose_m = 2e-4;
            log.run.noise.pose_rad = 2e-4;
        });
        let mut half_of = |correlation: f64| {
            log.run.noise.correlation = correlation;
            let report = log.audited();
            let estimate = the(&report, "LAT001", POSE).estimate.clone().expect("an estimate");
            let half = half_width(&estimate).expect("an interval");
            let off = (estimate.value().expect("a value") - 0.015).abs();
            assert!(off <= 2.0 * half, "seed {seed}, correlation {correlation}: {off} ± {half}");
            half
        };
        let (white, coloured) = (half_of(0.0), half_of(0.95));
        assert!(coloured > 1.1 * white, "seed {seed}: {coloured} against {white}");
    }
}
