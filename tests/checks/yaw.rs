//! YAW: heading of an IMU.

use nalgebra::Matrix3;
use poseaudit::finding::{CheckRow, Status};
use poseaudit::geometry::{
    Pose, QuaternionOrderError, Rotation, Vec3, pose, rotation_from_rotvec, rotation_from_xyzw,
    xyzw_from_rotation,
};
use poseaudit::synth::{IMU, JOINT_STATES, LoggedEncoding, Motion, Task};

use crate::checks::case::ExpectedEstimate::{Amount, Degrees, DegreesPerMinute};
use crate::checks::case::ExpectedSubject::Topic;
use crate::checks::case::{Expected, Log, cases, error, single_finding, summary, warning};
use crate::checks::recording::{Field, Message};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, Skipped};

cases! {
    YAW001 a_drift_of_3_degrees_per_minute: |log| log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(3.0)
        => error(Topic(IMU), DegreesPerMinute(3.0, 0.1));
    YAW001 a_negative_drift: |log| log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(-1.0)
        => warning(Topic(IMU), DegreesPerMinute(-1.0, 0.1));
    YAW001 a_drift_of_an_imu_on_its_side: |log| {
        log.run.imu.tip_from_imu =
            pose([0.0, 0.05, 0.0], rotation_from_rotvec(Vec3::new(1.2, 0.3, -0.8)));
        log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(2.5);
    } => error(Topic(IMU), DegreesPerMinute(2.5, 0.1));

    YAW001 a_yaw_jump_near_a_magnet: |log| log.run.imu.yaw_jumps = vec![(3.3, -2.5_f64.to_radians())]
        => error(Topic(IMU), Degrees(-2.5, 0.1));
    YAW001 a_jump_of_ten_degrees: |log| log.run.imu.yaw_jumps = vec![(6.2, 10_f64.to_radians())]
        => error(Topic(IMU), Degrees(10.0, 0.1));
    YAW001 a_small_jump: |log| log.run.imu.yaw_jumps = vec![(5.1, 0.8_f64.to_radians())]
        => warning(Topic(IMU), Degrees(0.8, 0.1));
    YAW001 a_jump_of_a_tenth_of_a_degree_passes: |log| {
        log.run.imu.yaw_jumps = vec![(4.0, 0.1_f64.to_radians())];
    } => NoFindings;
    YAW001 a_yaw_with_a_random_walk: |log| {
        log.run.duration_s = 20.0;
        log.run.imu.yaw_walk_rad_per_sqrt_s = 0.2_f64.to_radians();
    } => Inconclusive("the yaw wanders by 0.");

    YAW001 a_yaw_that_is_constant_passes: |log| log.run.imu.world_yaw_rad = -2.2 => NoFindings;
    YAW001 a_twentieth_of_a_degree_a_minute_passes: |log| {
        log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(0.05);
    } => NoFindings;

    YAW001 a_wrist_zero_offset_is_not_reported_as_yaw_drift: |log| log.run.joints.zero_offsets = crate::checks::zer::zero_offset(3, 1.0)
        => OnlyOtherFinding("ZER001");
    YAW001 a_late_imu_is_not_reported_as_yaw_drift: |log| log.run.imu.timing.latency_s = 0.02
        => OnlyOtherFinding("LAT001");
    YAW001 a_gyros_bias_is_not_reported_as_yaw_drift_of_the_orientation: |log| {
        log.run.imu.gyro_bias_rad_s = gyro_bias();
    } => OnlyOtherFinding("YAW004");
    YAW001 a_rotated_mount_is_not_reported_as_yaw_drift: |log| log.run.imu.mount_error = rotated_mount(20.0)
        => OnlyOtherFinding("YAW003");
    YAW001 a_misread_imu_is_not_reported_as_yaw_drift: |log| {
        log.run.imu.encoding = crate::checks::ord::misread("euler:ZYX", "euler:xyz");
    } => OnlyOtherFinding("ORD001");

    YAW001 no_imu: |log| log.run.imu.timing.rate_hz = 0.0 => Skipped("no IMU");
    YAW001 no_orientation: |log| log.run.imu.has_orientation = false
        => Skipped("no orientation");
    YAW001 one_second_of_yaw: |log| log.run.duration_s = 1.2 => Inconclusive("exceeds the limit of ±0.2 °/min");

    YAW002 a_tilted_accelerometer: |log| log.edit = Some(|messages| tilt_accelerations(messages))
        => warning(Topic(IMU), Degrees(1.5, 0.05));
    YAW002 a_tilted_world_frame: |log| log.edit = Some(|messages| tilt_world_frame(messages))
        => error(Topic(IMU), Degrees(3.0, 0.05));
    YAW002 an_imu_upside_down_passes: |log| {
        log.run.imu.tip_from_imu =
            pose([0.0, 0.05, 0.0], rotation_from_rotvec(Vec3::new(3.0, 0.3, 0.0)));
    } => NoFindings;
    YAW002 a_drift_of_yaw_is_not_reported_as_tilt: |log| log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(3.0)
        => OnlyOtherFinding("YAW001");
    YAW002 a_jump_of_yaw_is_not_reported_as_tilt: |log| {
        log.run.imu.yaw_jumps = vec![(3.3, 10_f64.to_radians())];
    } => OnlyOtherFinding("YAW001");
    YAW002 a_rotated_mount_is_not_reported_as_tilt: |log| log.run.imu.mount_error = rotated_mount(3.0)
        => OnlyOtherFinding("YAW003");
    YAW002 a_late_imu_is_not_reported_as_tilt: |log| log.run.imu.timing.latency_s = 0.02
        => OnlyOtherFinding("LAT001");
    YAW002 no_imu_for_tilt: |log| log.run.imu.timing.rate_hz = 0.0 => Skipped("no IMU");
    YAW002 no_roll_and_pitch: |log| log.run.imu.has_orientation = false
        => Skipped("no orientation");

    YAW003 a_mount_off_by_90_degrees: |log| log.run.imu.mount_error = rotated_mount(90.0)
        => error(Topic(IMU), Degrees(90.0, 0.1));
    YAW003 a_mount_off_by_3_degrees: |log| log.run.imu.mount_error = rotated_mount(3.0)
        => warning(Topic(IMU), Degrees(3.0, 0.1));
    YAW003 a_mount_off_by_90_degrees_without_orientation: |log| {
        log.run.imu.mount_error = rotated_mount(90.0);
        log.run.imu.has_orientation = false;
    } => error(Topic(IMU), Degrees(90.0, 0.5));
    YAW003 a_mount_off_by_a_twentieth_of_a_degree_passes: |log| log.run.imu.mount_error = rotated_mount(0.05)
        => NoFindings;
    YAW003 a_wrist_zero_offset_is_not_reported_as_mount_error: |log| log.run.joints.zero_offsets = crate::checks::zer::zero_offset(4, 2.0)
        => OnlyOtherFinding("ZER001");
    YAW003 a_misread_imu_is_not_reported_as_mount_error: |log| {
        log.run.imu.encoding = crate::checks::ord::misread("euler:ZYX", "euler:xyz");
    } => OnlyOtherFinding("ORD001");
    YAW003 a_jump_of_yaw_is_not_reported_as_mount_error: |log| {
        log.run.imu.yaw_jumps = vec![(5.1, -10_f64.to_radians())];
    } => OnlyOtherFinding("YAW001");
    YAW003 a_misread_imu_is_not_reported_as_mount_error_and_tilt: |log| {
        log.run.imu.encoding = crate::checks::ord::misread("euler:zyz", "euler:yzy");
    } => OnlyOtherFinding("ORD001");
    YAW003 a_gyros_scale_is_not_reported_as_mount_error: |log| {
        log.run.imu.gyro_from_rate = misaligned_gyro();
        log.run.imu.has_orientation = false;
    } => NoFindings;
    YAW003 two_percent_of_scale_is_not_reported_as_mount_error: |log| {
        log.run.imu.gyro_from_rate = Matrix3::from_diagonal_element(1.02);
        log.run.imu.has_orientation = false;
    } => NoFindings;
    YAW003 an_imu_with_unrelated_motion: |log| log.edit = Some(|messages| reverse_contents(messages, IMU))
        => Inconclusive("does not follow the arm");
    YAW003 a_growing_latency_is_not_reported_as_mount_error: |log| log.run.imu.timing.skew = 2e-3
        => OnlyOtherFinding("LAT002");
    YAW003 a_gyros_bias_is_not_reported_as_mount_error: |log| log.run.imu.gyro_bias_rad_s = gyro_bias()
        => OnlyOtherFinding("YAW004");
    YAW003 no_imu_for_a_mount: |log| log.run.imu.timing.rate_hz = 0.0 => Skipped("no IMU");
    YAW003 no_frame_of_the_imu: |log| log.run.tf.has_static = false => Skipped("no transform from the arm to the IMU");

    YAW004 a_gyro_bias: |log| log.run.imu.gyro_bias_rad_s = gyro_bias()
        => error(Topic(IMU), Amount(BIAS_RAD_S, 0.5e-3));
    YAW004 a_small_gyro_bias: |log| log.run.imu.gyro_bias_rad_s = gyro_bias() * 0.2
        => warning(Topic(IMU), Amount(0.2 * BIAS_RAD_S, 0.5e-3));
    YAW004 a_gyro_bias_without_orientation: |log| {
        log.run.imu.gyro_bias_rad_s = gyro_bias();
        log.run.imu.has_orientation = false;
    } => error(Topic(IMU), Amount(BIAS_RAD_S, 0.5e-3));
    YAW004 a_bias_of_a_hundredth_of_a_degree_per_second_passes: |log| {
        log.run.imu.gyro_bias_rad_s = Vec3::new(0.0, 0.0, 2e-4);
    } => NoFindings;
    YAW004 a_drift_of_the_orientation_is_not_reported_as_gyro_bias: |log| {
        log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(3.0);
    } => OnlyOtherFinding("YAW001");
    YAW004 a_gyros_scale_is_not_reported_as_gyro_bias: |log| log.run.imu.gyro_from_rate = misaligned_gyro() => NoFindings;
    YAW004 two_percent_of_scale_is_not_reported_as_gyro_bias: |log| {
        log.run.imu.gyro_from_rate = Matrix3::from_diagonal_element(1.02);
        log.run.imu.gyro_bias_rad_s = gyro_bias();
    } => error(Topic(IMU), Amount(BIAS_RAD_S, 0.5e-3));
    YAW004 a_growing_latency_is_not_reported_as_gyro_bias: |log| {
        log.run.imu.timing.skew = 2e-3;
        log.run.imu.has_orientation = false;
    } => OnlyOtherFinding("LAT002");
    YAW004 a_gyro_with_noisy_joints: |log| {
        log.run.duration_s = 20.0;
        (log.run.noise.joints, log.run.joints.has_velocity) = (5e-4, false);
        log.run.imu.gyro_bias_rad_s = gyro_bias() * 0.2;
    } => warning(Topic(IMU), Amount(0.2 * BIAS_RAD_S, 1e-3));
    YAW004 a_late_imu_is_not_reported_as_gyro_bias: |log| log.run.imu.timing.latency_s = 0.02
        => OnlyOtherFinding("LAT001");
    YAW004 a_rotated_mount_is_not_reported_as_gyro_bias: |log| log.run.imu.mount_error = rotated_mount(20.0)
        => OnlyOtherFinding("YAW003");
    YAW004 no_imu_with_a_gyro: |log| log.run.imu.timing.rate_hz = 0.0 => Skipped("no IMU");
}

/// Norm of [`bias`].
const BIAS_RAD_S: f64 = 0.03;

pub fn gyro_bias() -> Vec3 {
    Vec3::new(0.01, -0.02, 0.02)
}

/// A gyro with scale errors of +3 % about x and −2 % about z, whose x and y axes lean towards each other by
/// 0.01 rad each.
fn misaligned_gyro() -> Matrix3<f64> {
    Matrix3::new(1.03, 0.01, 0.0, 0.01, 1.0, 0.0, 0.0, 0.0, 0.98)
}

/// A mount rotated about an oblique axis.
pub fn rotated_mount(degrees: f64) -> Pose {
    pose([0.0; 3], rotation_from_rotvec(Vec3::new(0.6, 0.0, 0.8) * degrees.to_radians()))
}

/// Rotates the measured acceleration by 1.5° about the world's x axis.
fn tilt_accelerations(messages: &mut [Message]) {
    const AFTER_QUATERNION: usize = 8 * (4 + 9 + 3 + 9);
    let tilt = rotation_from_rotvec(Vec3::x() * 1.5_f64.to_radians());
    edit_orientations(messages, |message, at, world_from_imu| {
        let at = at + AFTER_QUATERNION;
        let acceleration = Vec3::from(message.floats::<3>(at));
        let acceleration = world_from_imu.inverse() * (tilt * (world_from_imu * acceleration));
        message.set_floats(at, acceleration.as_slice());
    });
}

/// Rotates the world frame of the orientations by 3° about its y axis.
fn tilt_world_frame(messages: &mut [Message]) {
    let tilt = rotation_from_rotvec(Vec3::y() * 3_f64.to_radians());
    edit_orientations(messages, |message, at, world_from_imu| {
        message.set_floats(at, &xyzw_from_rotation(&(tilt * world_from_imu)));
    });
}

/// Calls `change` with each IMU message, the offset of its orientation, and the orientation.
fn edit_orientations(messages: &mut [Message], change: impl Fn(&mut Message, usize, Rotation)) {
    for message in messages.iter_mut().filter(|message| message.topic == IMU) {
        for field in message.fields() {
            if let Field::Xyzw(at) = field {
                let rotation = rotation_from_xyzw(message.floats(at)).expect("a rotation");
                change(message, at, rotation);
            }
        }
    }
}

/// Reverses the contents of the messages of `topic`, but not their stamps.
pub fn reverse_contents(messages: &mut [Message], topic: &str) {
    const STAMP: std::ops::Range<usize> = 4..12;
    let mut all: Vec<&mut Message> =
        messages.iter_mut().filter(|message| message.topic == topic).collect();
    let contents: Vec<Vec<u8>> = all.iter().rev().map(|message| message.cdr.clone()).collect();
    for (message, mut cdr) in all.iter_mut().zip(contents) {
        cdr[STAMP].copy_from_slice(&message.cdr[STAMP]);
        message.cdr = cdr;
    }
}

#[test]
fn joint_states_unrelated_to_all_streams_leave_the_imu_inconclusive() {
    let report =
        Log::modified(|log| log.edit = Some(|messages| reverse_contents(messages, JOINT_STATES)))
            .report();
    // Only checks of its own data apply: an IMU that does not move with the arm is not compared with it.
    let needs_no_arm =
        |code: &str| code.starts_with("TIM") || ["FRM005", "ING003", "MDL001"].contains(&code);
    let of_imu = |row: &&CheckRow| row.subject.label() == IMU && !needs_no_arm(row.code);
    let judged: Vec<&CheckRow> = report.checks.iter().filter(of_imu).collect();
    assert!(judged.len() > 6, "{judged:?}");
    for row in judged {
        assert_eq!(row.status, Status::Inconclusive, "{row:?}");
    }
}

fn deg_per_min_to_rad_per_s(rate: f64) -> f64 {
    rate.to_radians() / 60.0
}

#[test]
fn a_yaw_drift_is_found_at_rest() {
    let report = Log::modified(|log| {
        log.run.motion = Motion::AtRest;
        log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(3.0);
    })
    .report();
    // At rest the IMU's latency is not observable, but a rotating yaw does not need it.
    let found: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(found, ["YAW001"]);
    DegreesPerMinute(3.0, 0.1).assert_matches(report.findings[0].estimate.as_ref());
}

#[test]
fn a_yaw_jump_is_reported_with_its_time_and_the_drift_separately() {
    let report = Log::modified(|log| {
        log.run.imu.yaw_jumps = vec![(3.3, 3_f64.to_radians())];
        log.run.imu.yaw_drift_rad_s = deg_per_min_to_rad_per_s(6.0);
    })
    .report();
    let [drift, jump] = report.findings.as_slice() else {
        panic!("a drift and a jump were expected:\n{}", summary(&report.findings))
    };
    DegreesPerMinute(6.0, 0.3).assert_matches(drift.estimate.as_ref());
    Degrees(3.0, 0.1).assert_matches(jump.estimate.as_ref());
    assert_eq!([&drift.evidence.more["kind"], &jump.evidence.more["kind"]], ["drift", "jump"]);
    let at_s = jump.evidence.more["jumps"][0]["at_s"].as_f64().expect("a time");
    assert!((at_s - 3.3).abs() < 0.1, "{at_s}");
}

#[test]
fn a_mount_is_described_by_its_axes() {
    let report = Log::modified(|log| {
        log.run.imu.tip_from_imu = Pose::translation(0.02, 0.0, 0.03);
        let quarter = Vec3::new(0.0, 0.0, -90_f64.to_radians());
        log.run.imu.mount_error = pose([0.0; 3], rotation_from_rotvec(quarter));
    })
    .report();
    let found = single_finding(&report, "YAW003", IMU);
    let axes = "imu x points along tool0 -y; y along tool0 x; z along tool0 z";
    assert!(found.message.ends_with(axes), "{}", found.message);
    let more = &found.evidence.more;
    assert_eq!(more["axes"][0], "imu x points along tool0 -y");
    assert_eq!(more["logged_axes"][0], "imu x points along tool0 x");
    let cosine = |matrix: &str| more[matrix]["matrix"][1][0].as_f64().expect("a number");
    assert!((cosine("direction_cosines") + 1.0).abs() < 1e-4);
    assert!(cosine("logged_direction_cosines").abs() < 1e-9);
}

#[test]
fn a_yaw_random_walk_is_reported_with_its_density() {
    let density = 0.3_f64.to_radians();
    let report = Log::modified(|log| {
        log.run.duration_s = 30.0;
        log.run.imu.yaw_walk_rad_per_sqrt_s = density;
    })
    .report();
    assert!(report.findings.is_empty(), "{}", summary(&report.findings));
    let row = report.checks.iter().find(|row| row.code == "YAW001").expect("a row");
    assert_eq!(row.evidence["kind"], "random-walk");
    let found = row.evidence["walk_rad_rt_s"].as_f64().expect("a density");
    assert!((0.7..1.4).contains(&(found / density)), "{found} is not {density}");
}

#[test]
fn gyro_scale_and_misalignment_are_reported() {
    let report = Log::modified(|log| {
        log.run.imu.gyro_from_rate = misaligned_gyro();
        log.run.imu.gyro_bias_rad_s = gyro_bias();
    })
    .report();
    let found = single_finding(&report, "YAW004", IMU);
    Amount(BIAS_RAD_S, 0.5e-3).assert_matches(found.estimate.as_ref());
    let shape = |key: &str| -> Vec<f64> {
        let entries = found.evidence.more[key].as_array().expect("three numbers");
        entries.iter().map(|entry| entry["value"].as_f64().expect("a number")).collect()
    };
    let assert_near = |found: Vec<f64>, planted: [f64; 3]| {
        let off = found.iter().zip(planted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-3, "{found:?} is not {planted:?}");
    };
    assert_near(shape("scale"), [0.03, 0.0, -0.02]);
    assert_near(shape("misalignment_rad"), [0.0, 0.0, 0.01]);
}

#[test]
fn a_wrong_quaternion_order_is_not_reported_as_tilt() {
    let report = Log::modified(|log| {
        log.run.motion = Motion::Task(Task::Drawer);
        log.run.imu.encoding =
            LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
    })
    .report();
    let text = summary(&report.findings);
    assert!(report.findings.iter().all(|finding| finding.code != "YAW002"), "{text}");
}

/// A tool absorbs link deviations as well, but the IMU's mount is as in the log only with the zero.
#[test]
fn a_wrist_zero_offset_of_a_deviating_arm_is_no_mount_error() {
    let report = Log::modified(|log| {
        log.run.motion = Motion::OneJoint(0);
        crate::checks::mdl::add_link_deviations_times(&mut log.run, 0.3);
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(5, 2.0);
    })
    .report();
    let codes: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    let has = |code: &str| codes.contains(&code);
    assert!(has("ZER001") && !has("YAW003") && !has("FRM003"), "{}", summary(&report.findings));
}
