//! Runs so long that the estimators use excerpts.

use poseaudit::finding::{CheckRow, Status};
use poseaudit::synth::{IMU, JOINT_STATES, POSE, TF};

use crate::checks::case::ExpectedEstimate::{Amount, Degrees, DegreesPerMinute};
use crate::checks::case::{Log, single_finding};
use crate::checks::zer::zero_offset;

/// Twelve minutes, at rates that keep the log small.
fn long_log(change: impl FnOnce(&mut Log)) -> Log {
    Log::modified(|log| {
        log.run.duration_s = 720.0;
        for timing in [
            &mut log.run.joints.timing, &mut log.run.pose.timing, &mut log.run.tf.timing,
            &mut log.run.imu.timing,
        ] {
            timing.rate_hz = 25.0;
        }
        change(log);
    })
}

#[test]
fn faults_of_a_long_run_are_found_with_their_values() {
    let report = long_log(|log| {
        log.run.pose.timing.latency_s = 0.015;
        log.run.joints.zero_offsets = zero_offset(2, 0.4);
        log.run.imu.yaw_drift_rad_s = 2.5_f64.to_radians() / 60.0;
    })
    .report();
    assert_eq!(report.findings.len(), 3, "{:#?}", report.findings);
    for (code, label, what) in [
        ("LAT001", POSE, Amount(0.015, 0.2e-3)),
        ("ZER001", "elbow_joint", Degrees(0.4, 0.02)),
        ("YAW001", IMU, DegreesPerMinute(2.5, 0.05)),
    ] {
        what.assert_matches(single_finding(&report, code, label).estimate.as_ref());
    }
    let notes = &report.log.notes;
    assert!(notes.iter().any(|note| note.note.contains("24 excerpts of 12 s")), "{notes:?}");
}

#[test]
fn clock_skew_is_estimated_over_the_whole_of_a_long_run() {
    let report = long_log(|log| log.run.pose.timing.skew = 100e-6).report();
    Amount(100e-6, 2e-6).assert_matches(single_finding(&report, "LAT002", POSE).estimate.as_ref());
}

#[test]
fn a_long_run_passes_and_all_its_samples_are_counted() {
    let report = long_log(|_| {}).report();
    assert!(report.findings.is_empty(), "{:#?}", report.findings);
    // At this rate the motion rules cannot detect stops and vibration; there is no camera.
    let has_input = |row: &&CheckRow| {
        !["MOT", "HEC"].contains(&&row.code[..3])
            && !crate::checks::WITHOUT_INPUT.contains(&row.code)
    };
    for row in report.checks.iter().filter(has_input) {
        assert_eq!(row.status, Status::Pass, "{row:#?}");
    }
    for topic in [JOINT_STATES, POSE, TF, IMU] {
        let row = report.streams.iter().find(|row| row.topic == topic);
        let count = row.map_or(0, |row| row.count);
        assert!((17_990..=18_001).contains(&count), "{topic}: {count} rows");
    }
}
