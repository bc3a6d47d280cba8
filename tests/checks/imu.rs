//! Realistic IMU faults: other units, limited ranges, NED axes, compasses near steel, sensors that warm up,
//! mounts that slip.

use poseaudit::finding::{Estimate, Finding, Status};
use poseaudit::geometry::{
    Rotation, Vec3, rotation_from_rotvec, rotation_from_xyzw, xyzw_from_rotation,
};
use poseaudit::report::Report;
use poseaudit::synth::IMU;

use crate::checks::case::ExpectedEstimate::{
    self, Amount, AmountWithoutInterval, Degrees, DegreesPerMinute, IsReadAs,
};
use crate::checks::case::ExpectedSubject::Topic;
use crate::checks::case::{Expected, Log, cases, error, single_finding, summary, warning};
use crate::checks::recording::{Field, Message};
use Expected::{NoFindings, OnlyOtherFinding};

cases! {
    ORD004 a_gyro_in_degrees: |log| log.edit = Some(|messages| edit_imu(messages, gyro_to_degrees))
        => error(Topic(IMU), IsReadAs("deg", "rad"));
    ORD004 a_gyro_in_degrees_without_orientation_or_frame: |log| {
        log.run.imu.has_orientation = false;
        log.run.tf.has_static = false;
        log.edit = Some(|messages| edit_imu(messages, gyro_to_degrees));
    } => error(Topic(IMU), IsReadAs("deg", "rad"));
    YAW004 a_gyro_in_degrees_is_not_reported_as_bias: |log| {
        log.edit = Some(|messages| edit_imu(messages, gyro_to_degrees));
    } => OnlyOtherFinding("ORD004");
    LAT001 a_gyro_in_degrees_is_not_reported_as_latency: |log| {
        log.run.imu.has_orientation = false;
        log.edit = Some(|messages| edit_imu(messages, gyro_to_degrees));
    } => OnlyOtherFinding("ORD004");

    ORD008 an_accelerometer_in_g: |log| log.edit = Some(|messages| edit_imu(messages, accel_to_g))
        => error(Topic(IMU), IsReadAs("g", "m/s²"));
    ORD008 an_accelerometer_in_milli_g: |log| {
        log.edit = Some(|messages| edit_imu(messages, accel_to_milli_g));
    } => error(Topic(IMU), IsReadAs("mg", "m/s²"));
    ORD008 an_accelerometer_with_twice_the_scale: |log| {
        log.edit = Some(|messages| edit_imu(messages, |sample| sample.accel *= 2.0));
    } => error(Topic(IMU), AmountWithoutInterval(2.0, 0.05));
    YAW002 a_linear_acceleration_without_gravity: |log| {
        log.edit = Some(|messages| edit_imu(messages, remove_gravity));
    } => warning(Topic(IMU), ExpectedEstimate::None);
    YAW002 an_accelerometer_in_g_is_not_reported_as_tilt: |log| {
        log.edit = Some(|messages| edit_imu(messages, accel_to_g));
    } => OnlyOtherFinding("ORD008");

    MDL001 a_gyro_gain_error: |log| {
        log.edit = Some(|messages| edit_imu(messages, |sample| sample.gyro *= 1.06));
    } => warning(Topic(IMU), Amount(0.06, 5e-3));
    MDL001 a_gyro_with_a_gain_of_two_percent_passes: |log| {
        log.edit = Some(|messages| edit_imu(messages, |sample| sample.gyro *= 1.02));
    } => NoFindings;
    MDL001 a_saturated_gyro: |log| log.edit = Some(|messages| edit_imu(messages, saturate_gyro))
        => error(Topic(IMU), AmountWithoutInterval(0.5, 1e-9));
    YAW004 a_saturated_gyro_is_not_reported_as_bias: |log| {
        log.edit = Some(|messages| edit_imu(messages, saturate_gyro));
    } => OnlyOtherFinding("MDL001");

    YAW002 a_world_frame_with_z_down: |log| log.edit = Some(|messages| edit_imu(messages, world_to_ned))
        => error(Topic(IMU), Degrees(180.0, 0.5));
    YAW001 a_world_frame_with_z_down_is_not_reported_as_yaw_drift: |log| {
        log.edit = Some(|messages| edit_imu(messages, world_to_ned));
    } => OnlyOtherFinding("YAW002");

    YAW001 a_heading_error_from_soft_iron: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| edit_imu(messages, add_soft_iron_error));
    } => warning(Topic(IMU), Degrees(1.4, 0.05));
    LAT003 a_heading_error_is_not_reported_as_latency_step: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| edit_imu(messages, add_soft_iron_error));
    } => OnlyOtherFinding("YAW001");

    YAW004 a_bias_that_steps: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| edit_imu(messages, add_bias_step));
    } => error(Topic(IMU), Amount(0.025, 2e-3));
    YAW004 a_bias_that_settles: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| edit_imu(messages, add_decaying_bias));
    } => error(Topic(IMU), Amount(0.03, 6e-3));
    YAW003 an_imu_that_slips: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| edit_imu(messages, slip_mount));
    } => error(Topic(IMU), Degrees(8.0, 0.2));
    YAW001 an_imu_that_slips_is_not_reported_as_yaw_drift: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| edit_imu(messages, slip_mount));
    } => OnlyOtherFinding("YAW003");
}

/// Time of changes within a run, s from the first sample.
const CHANGE_S: f64 = 7.0;

/// Content of an IMU message.
struct Sample {
    /// Time since the first sample, s.
    since_s: f64,
    world_from_imu: Rotation,
    gyro: Vec3,
    accel: Vec3,
}

/// Edits the content of each IMU message.
fn edit_imu(messages: &mut [Message], edit: fn(&mut Sample)) {
    const GYRO: usize = 8 * (4 + 9);
    const ACCEL: usize = GYRO + 8 * (3 + 9);
    let of_imu = messages.iter_mut().filter(|message| message.topic == IMU);
    let mut first_ns = None;
    for message in of_imu {
        let first_ns = *first_ns.get_or_insert(message.log_ns);
        let orientation_at = message.fields().into_iter().find_map(|field| match field {
            Field::Xyzw(at) => Some(at),
            _ => None,
        });
        let at = orientation_at.expect("an orientation");
        let orientation = message.floats::<4>(at);
        let is_set = orientation.iter().any(|one| *one != 0.0);
        let mut sample = Sample {
            since_s: (message.log_ns as f64 - first_ns as f64) * 1e-9,
            world_from_imu: rotation_from_xyzw(orientation).unwrap_or_default(),
            gyro: message.floats::<3>(at + GYRO).into(),
            accel: message.floats::<3>(at + ACCEL).into(),
        };
        edit(&mut sample);
        if is_set {
            message.set_floats(at, &xyzw_from_rotation(&sample.world_from_imu));
        }
        message.set_floats(at + GYRO, sample.gyro.as_slice());
        message.set_floats(at + ACCEL, sample.accel.as_slice());
    }
}

fn gyro_to_degrees(sample: &mut Sample) {
    sample.gyro *= 1_f64.to_degrees();
}

fn accel_to_g(sample: &mut Sample) {
    sample.accel /= 9.80665;
}

fn remove_gravity(sample: &mut Sample) {
    sample.accel -= sample.world_from_imu.inverse() * (9.80665 * Vec3::z());
}

fn accel_to_milli_g(sample: &mut Sample) {
    sample.accel /= 9.80665e-3;
}

fn saturate_gyro(sample: &mut Sample) {
    sample.gyro = sample.gyro.map(|rate| rate.clamp(-0.5, 0.5));
}

fn world_to_ned(sample: &mut Sample) {
    let half = rotation_from_rotvec(Vec3::new(1.0, 1.0, 0.0).normalize() * std::f64::consts::PI);
    sample.world_from_imu = half * sample.world_from_imu;
}

/// A heading error of 2.8° peak to peak over this motion.
fn add_soft_iron_error(sample: &mut Sample) {
    let points = sample.world_from_imu * Vec3::x();
    let heading = points.y.atan2(points.x);
    let error = 5.0 * heading.sin() + 2.0 * (2.0 * heading).cos();
    let turned = rotation_from_rotvec(Vec3::z() * error.to_radians());
    sample.world_from_imu = turned * sample.world_from_imu;
}

fn add_bias_step(sample: &mut Sample) {
    if sample.since_s > CHANGE_S {
        sample.gyro += Vec3::new(0.015, 0.0, 0.02);
    }
}

fn add_decaying_bias(sample: &mut Sample) {
    sample.gyro.y += 0.03 * (-sample.since_s / 4.0).exp();
}

fn slip_mount(sample: &mut Sample) {
    if sample.since_s > CHANGE_S {
        let slip = rotation_from_rotvec(Vec3::new(0.6, 0.8, 0.0) * 8_f64.to_radians());
        sample.world_from_imu *= slip;
        sample.gyro = slip.inverse() * sample.gyro;
        sample.accel = slip.inverse() * sample.accel;
    }
}

fn report_of_16_s(change: fn(&mut Log)) -> Report {
    Log::modified(|log| {
        log.run.duration_s = 16.0;
        change(log);
    })
    .report()
}

/// Asserts that a finding changes between two values at [`CHANGE_S`].
fn assert_changes(found: &Finding, from: f64, to: f64, tolerance: f64) {
    let estimate = found.estimate.as_ref();
    let change = estimate.and_then(Estimate::change).expect("a change");
    assert!((change.from - from).abs() < tolerance, "{change:?}");
    assert!((change.to - to).abs() < tolerance, "{change:?}");
    let start = found.start_ns.expect("a start");
    let at_s = change.change_ns.seconds_since(start);
    assert!((at_s - CHANGE_S).abs() < 0.15, "{at_s} s: {change:?}");
    let [low, high] =
        change.change_ci95_ns.expect("an interval").map(|end| end.seconds_since(start));
    assert!(low < at_s && at_s < high && high - low < 1.0, "{low} to {high} s");
}

#[test]
fn a_bias_step_is_reported_with_both_values_and_its_time() {
    let report =
        report_of_16_s(|log| log.edit = Some(|messages| edit_imu(messages, add_bias_step)));
    assert_changes(single_finding(&report, "YAW004", IMU), 0.0, 0.025, 2e-3);
}

#[test]
fn an_imu_slip_is_reported_with_both_values_and_its_time() {
    let to = 8_f64.to_radians();
    let report = report_of_16_s(|log| log.edit = Some(|messages| edit_imu(messages, slip_mount)));
    assert_changes(single_finding(&report, "YAW003", IMU), 0.0, to, 4e-3);
    let gyro_alone = report_of_16_s(|log| {
        log.run.imu.has_orientation = false;
        log.edit = Some(|messages| edit_imu(messages, slip_mount));
    });
    assert_changes(single_finding(&gyro_alone, "YAW003", IMU), 0.0, to, 1e-2);
}

#[test]
fn a_yaw_drift_is_found_together_with_a_heading_error() {
    let report = Log::modified(|log| {
        log.run.duration_s = 20.0;
        log.run.imu.yaw_drift_rad_s = 5_f64.to_radians() / 60.0;
        log.edit = Some(|messages| edit_imu(messages, add_soft_iron_error));
    })
    .report();
    let [drift, heading] = report.findings.as_slice() else {
        panic!("a drift and a heading were expected:\n{}", summary(&report.findings))
    };
    DegreesPerMinute(5.0, 0.3).assert_matches(drift.estimate.as_ref());
    assert_eq!(heading.evidence.more["kind"], "heading");
}

#[test]
fn ned_axes_are_named_in_the_message() {
    let report = Log::modified(|log| {
        log.edit = Some(|messages| {
            edit_imu(messages, |sample| {
                let half = rotation_from_rotvec(Vec3::x() * std::f64::consts::PI);
                world_to_ned(sample);
                sample.world_from_imu *= half;
                (sample.gyro, sample.accel) = (half * sample.gyro, half * sample.accel);
            });
        });
    })
    .report();
    let world = single_finding(&report, "YAW002", IMU);
    assert!(world.message.contains("world frame has z down (NED)"), "{}", world.message);
    let axes = single_finding(&report, "YAW003", IMU);
    assert!(axes.message.contains("(FRD, as with NED: z points down)"), "{}", axes.message);
    assert_eq!(report.findings.len(), 2, "{}", summary(&report.findings));
}

#[test]
fn other_rules_judge_the_gyro_after_conversion() {
    let sound = Log::fault_free().report();
    let converted =
        Log::modified(|log| log.edit = Some(|messages| edit_imu(messages, gyro_to_degrees)));
    let converted = converted.report();
    let passed = |report: &Report, code: &str| {
        let mut rows = report.checks.iter().filter(|row| row.code == code);
        let row = rows.find(|row| row.subject.label() == IMU).expect("a row").clone();
        assert_eq!(row.status, Status::Pass, "{row:?}");
        row.estimate.as_ref().and_then(Estimate::value).expect("an amount")
    };
    for code in ["LAT001", "YAW003", "YAW004"] {
        let off = passed(&sound, code) - passed(&converted, code);
        assert!(off.abs() < 1e-6, "{code}: {off}");
    }
}
