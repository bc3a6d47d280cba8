//! Realistic IMU faults: other units, limited ranges, NED axes, compasses near steel, sensors that warm up,
//! mounts that slip.

use poseaudit::finding::{Estimate, Finding, Status};
use poseaudit::geometry::{
    Rotation, Vec3, rotation_from_rotvec, rotation_from_xyzw, xyzw_from_rotation,
};
use poseaudit::report::Report;
use poseaudit::synth::IMU;

use crate::checks::case::On::Topic;
use crate::checks::case::What::{About, Amount, Degrees, DegreesAMinute, ReadAs};
use crate::checks::case::{Expected, Log, cases, error, summary, the, warning};
use crate::checks::recording::{Field, Message};
use Expected::{BlamedOn, Sound};

cases! {
    ORD004 a_gyro_in_degrees: |log| log.edit = Some(|messages| change(messages, in_degrees))
        => error(Topic(IMU), ReadAs("deg", "rad"));
    ORD004 a_gyro_in_degrees_without_orientation_or_frame: |log| {
        log.run.imu.with_orientation = false;
        log.run.tf.with_static = false;
        log.edit = Some(|messages| change(messages, in_degrees));
    } => error(Topic(IMU), ReadAs("deg", "rad"));
    YAW004 a_gyro_in_degrees_has_no_bias: |log| {
        log.edit = Some(|messages| change(messages, in_degrees));
    } => BlamedOn("ORD004");
    LAT001 a_gyro_in_degrees_is_not_late: |log| {
        log.run.imu.with_orientation = false;
        log.edit = Some(|messages| change(messages, in_degrees));
    } => BlamedOn("ORD004");

    ORD008 an_accelerometer_in_g: |log| log.edit = Some(|messages| change(messages, in_g))
        => error(Topic(IMU), ReadAs("g", "m/s²"));
    ORD008 an_accelerometer_in_thousandths_of_g: |log| {
        log.edit = Some(|messages| change(messages, in_milli_g));
    } => error(Topic(IMU), ReadAs("mg", "m/s²"));
    YAW002 an_accelerometer_in_g_does_not_lean: |log| {
        log.edit = Some(|messages| change(messages, in_g));
    } => BlamedOn("ORD008");

    MDL001 a_gyro_that_reads_too_much: |log| {
        log.edit = Some(|messages| change(messages, |sample| sample.gyro *= 1.06));
    } => warning(Topic(IMU), Amount(0.06, 5e-3));
    MDL001 a_gyro_with_a_gain_of_two_percent_is_sound: |log| {
        log.edit = Some(|messages| change(messages, |sample| sample.gyro *= 1.02));
    } => Sound;
    MDL001 a_gyro_that_saturates: |log| log.edit = Some(|messages| change(messages, saturate))
        => error(Topic(IMU), About(0.5, 1e-9));
    YAW004 a_gyro_that_saturates_has_no_bias: |log| {
        log.edit = Some(|messages| change(messages, saturate));
    } => BlamedOn("MDL001");

    YAW002 a_world_whose_z_is_down: |log| log.edit = Some(|messages| change(messages, into_ned))
        => error(Topic(IMU), Degrees(180.0, 0.5));
    YAW001 a_world_whose_z_is_down_does_not_drift: |log| {
        log.edit = Some(|messages| change(messages, into_ned));
    } => BlamedOn("YAW002");

    YAW001 a_compass_in_steel: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| change(messages, soft_iron));
    } => warning(Topic(IMU), Degrees(1.4, 0.05));
    LAT003 a_compass_in_steel_is_as_late_as_ever: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| change(messages, soft_iron));
    } => BlamedOn("YAW001");

    YAW004 a_bias_that_steps: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| change(messages, bias_steps));
    } => error(Topic(IMU), Amount(0.025, 2e-3));
    YAW004 a_bias_that_settles: |log| {
        log.run.duration_s = 20.0;
        log.edit = Some(|messages| change(messages, bias_settles));
    } => error(Topic(IMU), Amount(0.03, 6e-3));
    YAW003 an_imu_that_slips: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| change(messages, slip));
    } => error(Topic(IMU), Degrees(8.0, 0.2));
    YAW001 an_imu_that_slips_does_not_drift: |log| {
        log.run.duration_s = 16.0;
        log.edit = Some(|messages| change(messages, slip));
    } => BlamedOn("YAW003");
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
fn change(messages: &mut [Message], of: fn(&mut Sample)) {
    const GYRO: usize = 8 * (4 + 9);
    const ACCEL: usize = GYRO + 8 * (3 + 9);
    let of_imu = messages.iter_mut().filter(|message| message.topic == IMU);
    let mut first_ns = None;
    for message in of_imu {
        let first_ns = *first_ns.get_or_insert(message.log_ns);
        let found = message.fields().into_iter().find_map(|field| match field {
            Field::Xyzw(at) => Some(at),
            _ => None,
        });
        let at = found.expect("an orientation");
        let orientation = message.floats::<4>(at);
        let is_there = orientation.iter().any(|one| *one != 0.0);
        let mut sample = Sample {
            since_s: (message.log_ns as f64 - first_ns as f64) * 1e-9,
            world_from_imu: rotation_from_xyzw(orientation).unwrap_or_default(),
            gyro: message.floats::<3>(at + GYRO).into(),
            accel: message.floats::<3>(at + ACCEL).into(),
        };
        of(&mut sample);
        if is_there {
            message.set_floats(at, &xyzw_from_rotation(&sample.world_from_imu));
        }
        message.set_floats(at + GYRO, sample.gyro.as_slice());
        message.set_floats(at + ACCEL, sample.accel.as_slice());
    }
}

fn in_degrees(sample: &mut Sample) {
    sample.gyro *= 1_f64.to_degrees();
}

fn in_g(sample: &mut Sample) {
    sample.accel /= 9.80665;
}

fn in_milli_g(sample: &mut Sample) {
    sample.accel /= 9.80665e-3;
}

fn saturate(sample: &mut Sample) {
    sample.gyro = sample.gyro.map(|rate| rate.clamp(-0.5, 0.5));
}

fn into_ned(sample: &mut Sample) {
    let half = rotation_from_rotvec(Vec3::new(1.0, 1.0, 0.0).normalize() * std::f64::consts::PI);
    sample.world_from_imu = half * sample.world_from_imu;
}

/// A heading error of 2.8° peak to peak over this motion.
fn soft_iron(sample: &mut Sample) {
    let points = sample.world_from_imu * Vec3::x();
    let heading = points.y.atan2(points.x);
    let error = 5.0 * heading.sin() + 2.0 * (2.0 * heading).cos();
    let turned = rotation_from_rotvec(Vec3::z() * error.to_radians());
    sample.world_from_imu = turned * sample.world_from_imu;
}

fn bias_steps(sample: &mut Sample) {
    if sample.since_s > CHANGE_S {
        sample.gyro += Vec3::new(0.015, 0.0, 0.02);
    }
}

fn bias_settles(sample: &mut Sample) {
    sample.gyro.y += 0.03 * (-sample.since_s / 4.0).exp();
}

fn slip(sample: &mut Sample) {
    if sample.since_s > CHANGE_S {
        let slip = rotation_from_rotvec(Vec3::new(0.6, 0.8, 0.0) * 8_f64.to_radians());
        sample.world_from_imu *= slip;
        sample.gyro = slip.inverse() * sample.gyro;
        sample.accel = slip.inverse() * sample.accel;
    }
}

fn changed(of: fn(&mut Log)) -> Report {
    Log::with(|log| {
        log.run.duration_s = 16.0;
        of(log);
    })
    .audited()
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
fn a_bias_that_steps_says_from_what_to_what_and_when() {
    let report = changed(|log| log.edit = Some(|messages| change(messages, bias_steps)));
    assert_changes(the(&report, "YAW004", IMU), 0.0, 0.025, 2e-3);
}

#[test]
fn an_imu_that_slips_says_from_what_to_what_and_when() {
    let to = 8_f64.to_radians();
    let report = changed(|log| log.edit = Some(|messages| change(messages, slip)));
    assert_changes(the(&report, "YAW003", IMU), 0.0, to, 4e-3);
    let gyro_alone = changed(|log| {
        log.run.imu.with_orientation = false;
        log.edit = Some(|messages| change(messages, slip));
    });
    assert_changes(the(&gyro_alone, "YAW003", IMU), 0.0, to, 1e-2);
}

#[test]
fn a_drift_beside_what_depends_on_the_heading_is_found_with_it() {
    let report = Log::with(|log| {
        log.run.duration_s = 20.0;
        log.run.imu.yaw_drift_rad_s = 5_f64.to_radians() / 60.0;
        log.edit = Some(|messages| change(messages, soft_iron));
    })
    .audited();
    let [drift, heading] = report.findings.as_slice() else {
        panic!("a drift and a heading were expected:\n{}", summary(&report.findings))
    };
    DegreesAMinute(5.0, 0.3).assert_is(drift.estimate.as_ref());
    assert_eq!(heading.evidence.more["kind"], "heading");
}

#[test]
fn axes_of_ned_are_said_as_such() {
    let report = Log::with(|log| {
        log.edit = Some(|messages| {
            change(messages, |sample| {
                let half = rotation_from_rotvec(Vec3::x() * std::f64::consts::PI);
                into_ned(sample);
                sample.world_from_imu *= half;
                (sample.gyro, sample.accel) = (half * sample.gyro, half * sample.accel);
            });
        });
    })
    .audited();
    let world = the(&report, "YAW002", IMU);
    assert!(world.message.contains("world frame has z down (NED)"), "{}", world.message);
    let axes = the(&report, "YAW003", IMU);
    assert!(axes.message.contains("(FRD, as with NED: z points down)"), "{}", axes.message);
    assert_eq!(report.findings.len(), 2, "{}", summary(&report.findings));
}

#[test]
fn what_was_converted_is_judged_as_if_it_had_been_right() {
    let sound = Log::sound().audited();
    let converted = Log::with(|log| log.edit = Some(|messages| change(messages, in_degrees)));
    let converted = converted.audited();
    let passed = |report: &Report, code: &str| {
        let mut of = report.checks.iter().filter(|row| row.code == code);
        let row = of.find(|row| row.subject.label() == IMU).expect("a row").clone();
        assert_eq!(row.status, Status::Pass, "{row:?}");
        row.estimate.as_ref().and_then(Estimate::value).expect("an amount")
    };
    for code in ["LAT001", "YAW003", "YAW004"] {
        let off = passed(&sound, code) - passed(&converted, code);
        assert!(off.abs() < 1e-6, "{code}: {off}");
    }
}
