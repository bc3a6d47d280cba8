//! Properties that must not change the findings: epoch, position of a world frame, order of names, sign of
//! quaternions, rate.

use poseaudit::finding::{Estimate, Finding};
use poseaudit::report::Report;

use crate::checks::case::{Log, half_width, summary};
use crate::checks::frm;
use crate::checks::ord::{flip_quaternion_signs, reorder_joints};
use crate::checks::recording::Message;
use crate::checks::zer::zero_offset;

/// A log with three faults of different kinds.
fn log_with_three_faults() -> Log {
    Log::modified(|log| {
        log.run.pose.timing.latency_s = 0.015;
        log.run.joints.zero_offsets = zero_offset(2, 0.6);
        log.run.imu.yaw_drift_rad_s = 1e-3;
    })
}

/// Rule and subject of each finding, in order.
fn found_subjects(report: &Report) -> Vec<(&'static str, &str)> {
    report.findings.iter().map(|finding| (finding.code, finding.subject.label())).collect()
}

/// Asserts that both audits agree: same findings, same status for every subject, and values within each
/// other's intervals.
#[track_caller]
fn assert_same(before: &Report, after: &Report) {
    assert_eq!(
        found_subjects(before),
        found_subjects(after),
        "found:\n{}",
        summary(&after.findings)
    );
    let rows = |report: &Report| -> Vec<_> {
        report.checks.iter().map(|row| (row.code, row.subject.clone(), row.status)).collect()
    };
    assert_eq!(rows(before), rows(after));
    assert_eq!(before.verdict, after.verdict);
    for (a, b) in before.findings.iter().zip(&after.findings) {
        assert_eq!(a.severity, b.severity);
        assert_within(a, b);
    }
}

#[track_caller]
fn assert_within(a: &Finding, b: &Finding) {
    let (Some(a_is), Some(b_is)) = (&a.estimate, &b.estimate) else {
        return assert_eq!(a.estimate, b.estimate);
    };
    let (Some(a_value), Some(b_value)) = (a_is.value(), b_is.value()) else {
        return assert_eq!(encoding_names(a_is), encoding_names(b_is));
    };
    for (estimate, other) in [(a_is, b_value), (b_is, a_value)] {
        let half = half_width(estimate).expect("an interval");
        let off = (other - estimate.value().expect("a value")).abs();
        // Both values may be anywhere in their own interval.
        assert!(off <= 2.0 * half, "{} moved by {off}, beyond ±{half}", a.code);
    }
}

/// An estimate without a value, as text.
fn encoding_names(estimate: &Estimate) -> Option<(&str, &str)> {
    estimate.convention()
}

/// The report on the faulty log, with edited messages.
fn report_with(edit: fn(&mut Vec<Message>)) -> Report {
    Log { edit: Some(edit), ..log_with_three_faults() }.report()
}

#[test]
fn another_epoch_gives_the_same_findings() {
    const EARLIER_NS: i64 = -1_779_999_000_123_456_789;
    let before = log_with_three_faults().report();
    let after = report_with(|messages| {
        messages.iter_mut().for_each(|message| message.shift(EARLIER_NS));
    });
    assert_same(&before, &after);
    for (a, b) in before.findings.iter().zip(&after.findings) {
        for (a, b) in [(a.start_ns, b.start_ns), (a.end_ns, b.end_ns)] {
            let (a, b) = (a.expect("a stamp").nanos(), b.expect("a stamp").nanos());
            assert_eq!(b - a, EARLIER_NS);
        }
    }
}

#[test]
fn another_world_frame_gives_the_same_findings() {
    let mut log = log_with_three_faults();
    log.run.pose.frame_id = "tracker".to_owned();
    let before = log.report();
    assert!(
        found_subjects(&before).contains(&("ZER001", "elbow_joint")),
        "{:?}",
        found_subjects(&before)
    );
    for place in
        [frm::base_shifted_and_tilted(), frm::distant_world(), frm::base_rotated_by_180_degrees()]
    {
        log.run.pose.reference_from_stream = place;
        assert_same(&before, &log.report());
    }
}

#[test]
fn another_joint_order_in_the_messages_gives_the_same_findings() {
    let before = log_with_three_faults().report();
    assert_same(&before, &report_with(|messages| reorder_joints(messages, [2, 1, 0, 3, 4, 5])));
    assert_same(&before, &report_with(|messages| reorder_joints(messages, [5, 3, 1, 0, 2, 4])));
}

#[test]
fn the_other_sign_of_quaternions_gives_the_same_findings() {
    assert_same(
        &log_with_three_faults().report(),
        &report_with(|messages| flip_quaternion_signs(messages)),
    );
}

#[test]
fn twice_the_rate_gives_the_same_findings() {
    // Vibration is visible only above 25 Hz.
    let mut log = log_with_three_faults();
    log.options.policy.rules.ignore = vec!["MOT001".parse().expect("a rule")];
    let before = log.report();
    let run = &mut log.run;
    for timing in
        [&mut run.joints.timing, &mut run.pose.timing, &mut run.tf.timing, &mut run.imu.timing]
    {
        timing.rate_hz *= 2.0;
    }
    assert_same(&before, &log.report());
}

#[test]
fn another_message_order_gives_the_same_findings() {
    let after = report_with(|messages| messages.reverse());
    assert_same(&log_with_three_faults().report(), &after);
}

#[test]
fn another_noise_seed_gives_the_same_findings() {
    let before = log_with_three_faults().report();
    for seed in 2..=4 {
        let mut log = log_with_three_faults();
        log.run.seed = seed;
        let after = log.report();
        let mut found = [found_subjects(&before), found_subjects(&after)];
        found.iter_mut().for_each(|names| names.sort_unstable());
        assert_eq!(found[0], found[1], "seed {seed} found:\n{}", summary(&after.findings));
    }
}
