//! Effects of clocks, queues and names: coarse clocks, latency ramps, load-dependent latency, one-sided
//! jitter, renamed frames and topics.

use std::collections::BTreeSet;

use poseaudit::finding::{Estimate, Severity, Status};
use poseaudit::geometry::Vec3;
use poseaudit::report::Report;
use poseaudit::synth::{IMU, JOINT_STATES, POSE, Scenario, SynthComplianceKind};

use crate::checks::case::{Log, single_finding, summary};
use crate::checks::recording::{Field, Message, read, write};

const SECOND_NS: f64 = 1e9;

/// The report on 20 s of joint states at 125 Hz and poses at 50 Hz, with edited messages.
fn report_with(edit: fn(&mut Vec<Message>)) -> Report {
    Log::modified(|log| {
        use_high_rates(&mut log.run);
        log.edit = Some(edit);
    })
    .report()
}

fn use_high_rates(run: &mut Scenario) {
    run.tf.timing.rate_hz = 0.0;
    run.imu.timing.rate_hz = 0.0;
    run.duration_s = 20.0;
    run.joints.timing.rate_hz = 125.0;
    run.pose.timing.rate_hz = 50.0;
}

fn codes(report: &Report) -> BTreeSet<&str> {
    report.findings.iter().map(|finding| finding.code).collect()
}

fn value_and_half_width(report: &Report, code: &str) -> (f64, f64) {
    let estimate = single_finding(report, code, POSE).estimate.as_ref().expect("an estimate");
    (estimate.value().expect("an amount"), half_width(estimate))
}

fn half_width(estimate: &Estimate) -> f64 {
    crate::checks::case::half_width(estimate).expect("an interval")
}

fn stamp_ns(message: &Message) -> i64 {
    let stamps = message.fields().into_iter().filter_map(|field| match field {
        Field::Stamp(at) => Some(at),
        _ => None,
    });
    let at = stamps.into_iter().next().expect("a stamp");
    let word = |at: usize| u32::from_le_bytes(message.cdr[at..at + 4].try_into().expect("a word"));
    i64::from(word(at)) * 1_000_000_000 + i64::from(word(at + 4))
}

fn pose_messages(messages: &mut [Message]) -> impl Iterator<Item = &mut Message> {
    messages_of(messages, POSE)
}

fn messages_of<'a>(
    messages: &'a mut [Message],
    topic: &'static str,
) -> impl Iterator<Item = &'a mut Message> {
    messages.iter_mut().filter(move |message| message.topic == topic)
}

/// Delays the poses' stamps by `late_s` of the sample's index and its time since the first, s.
fn delay_poses(messages: &mut [Message], late_s: impl Fn(usize, f64) -> f64) {
    delay_topic(messages, POSE, late_s);
}

fn delay_topic(messages: &mut [Message], topic: &'static str, late_s: impl Fn(usize, f64) -> f64) {
    let first_ns = messages_of(messages, topic).map(|message| stamp_ns(message)).min().unwrap_or(0);
    for (row, message) in messages_of(messages, topic).enumerate() {
        let since_s = (stamp_ns(message) - first_ns) as f64 / SECOND_NS;
        message.shift((late_s(row, since_s) * SECOND_NS) as i64);
    }
    messages.sort_by_key(|message| message.log_ns);
}

/// Rounds the stamps of a topic to ticks; receive times stay.
fn round_stamps(messages: &mut [Message], topic: &str, tick_ns: i64) {
    for message in messages.iter_mut().filter(|message| message.topic == topic) {
        let stamp_ns = stamp_ns(message);
        message.shift_stamps((stamp_ns + tick_ns / 2).div_euclid(tick_ns) * tick_ns - stamp_ns);
    }
}

/// Pseudo-random numbers from 0 to 1.
fn random(row: usize) -> f64 {
    let hash = (row as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let hash = (hash ^ (hash >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((hash ^ (hash >> 27)) >> 11) as f64 / (1_u64 << 53) as f64
}

const TICK_NS: i64 = 15_625_000;

#[test]
fn stamps_of_a_coarse_clock_are_not_reported_as_lost_samples() {
    for report in [
        report_with(|messages| round_stamps(messages, POSE, TICK_NS)),
        report_with(|messages| round_stamps(messages, JOINT_STATES, 6_000_000)),
    ] {
        assert_eq!(codes(&report), ["TIM005"].into(), "{}", summary(&report.findings));
        let rows = report.checks.iter().filter(|row| row.code == "TIM002");
        assert!(rows.into_iter().all(|row| row.status == Status::Pass), "{:?}", report.checks);
    }
}

#[test]
fn lost_samples_are_counted_despite_a_coarse_clock() {
    let report = report_with(|messages| {
        round_stamps(messages, POSE, TICK_NS);
        let mut row = 0;
        messages.retain(|message| {
            row += 1;
            message.topic != POSE || random(row) > 0.08
        });
    });
    assert_eq!(codes(&report), ["TIM002"].into(), "{}", summary(&report.findings));
    let estimate =
        single_finding(&report, "TIM002", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(estimate.is_some_and(|share| (share - 0.08).abs() < 0.03), "{estimate:?}");
}

/// Noise hides which times are rounded, so none are restored.
#[test]
fn stamps_truncated_to_clock_ticks_are_early_by_half_a_tick() {
    let report = Log::modified(|log| {
        use_high_rates(&mut log.run);
        log.run.noise.pose_m = 0.02;
        log.edit = Some(|messages: &mut Vec<Message>| {
            round_stamps(messages, POSE, TICK_NS);
            pose_messages(messages).for_each(|message| message.shift_stamps(-TICK_NS / 2));
        });
    })
    .report();
    let (value, half) = value_and_half_width(&report, "LAT001");
    assert!((value + 0.5 * TICK_NS as f64 / SECOND_NS).abs() < 2.0 * half, "{value} ± {half}");
    let message = &single_finding(&report, "LAT001", POSE).message;
    assert!(message.contains("half a clock tick of 15.6 ms"), "{message}");
}

/// The tick hides a constant offset of up to half of it.
#[test]
fn restored_stamps_that_were_truncated_are_not_reported_as_early() {
    let report = report_with(|messages| {
        round_stamps(messages, POSE, TICK_NS);
        pose_messages(messages).for_each(|message| message.shift_stamps(-TICK_NS / 2));
    });
    assert_eq!(codes(&report), ["TIM005"].into(), "{}", summary(&report.findings));
    let message = &single_finding(&report, "TIM005", POSE).message;
    assert!(message.contains("multiples of 15.6 ms"), "{message}");
    let latency = report.checks.iter().find(|row| row.code == "LAT001").expect("a check");
    assert_eq!(latency.status, Status::Inconclusive, "{latency:?}");
}

#[test]
fn equal_stamps_in_whole_seconds_show_no_latency() {
    let report = Log::modified(|log| {
        use_high_rates(&mut log.run);
        log.run.pose.timing.rate_hz = log.run.joints.timing.rate_hz;
        log.run.pose.timing.phase_s = log.run.joints.timing.phase_s;
        log.edit = Some(|messages: &mut Vec<Message>| {
            let tick_ns = SECOND_NS as i64;
            round_stamps(messages, POSE, tick_ns);
            round_stamps(messages, JOINT_STATES, tick_ns);
        });
    })
    .report();
    for topic in [POSE, JOINT_STATES] {
        assert_eq!(single_finding(&report, "TIM005", topic).severity, Severity::Warning);
    }
    let latency = report.checks.iter().find(|row| row.code == "LAT001").expect("a check");
    assert_eq!(latency.status, Status::Inconclusive, "{latency:?}");
}

#[test]
fn a_latency_ramp_is_reported_with_both_levels() {
    let report = report_with(|messages| {
        delay_poses(messages, |_, since_s| 0.004 + 0.02 * ((since_s - 6.0) / 6.0).clamp(0.0, 1.0));
    });
    let finding = single_finding(&report, "LAT003", POSE);
    assert_eq!(finding.evidence.more["kind"], "ramp", "{}", summary(&report.findings));
    let (value, half) = value_and_half_width(&report, "LAT003");
    assert!((value - 0.02).abs() < 2.0 * half.max(1e-4), "{value} ± {half}");
    let change = finding.estimate.as_ref().and_then(Estimate::change).expect("a change");
    assert!((change.from - 0.004).abs() < 5e-4 && (change.to - 0.024).abs() < 5e-4, "{change:?}");
}

#[test]
fn a_large_latency_ramp_is_not_reported_as_steps_or_wrong_model() {
    let late = report_with(|messages| {
        delay_poses(messages, |_, since_s| 0.09 * ((since_s - 6.0) / 8.0).clamp(0.0, 1.0));
    });
    let early = report_with(|messages| {
        delay_poses(messages, |_, since_s| -0.06 * ((since_s - 6.0) / 8.0).clamp(0.0, 1.0));
    });
    for (size_s, report) in [(0.09, late), (-0.06, early)] {
        let finding = single_finding(&report, "LAT003", POSE);
        assert_eq!(finding.evidence.more["kind"], "ramp", "{}", summary(&report.findings));
        let (value, half) = value_and_half_width(&report, "LAT003");
        assert!((value - size_s).abs() < 2.0 * half.max(1e-4), "{value} ± {half}");
        assert!(half < 1e-3, "{half}");
        let is_other = |code: &str| !["LAT001", "LAT003"].contains(&code);
        let others = report.findings.iter().filter(|finding| is_other(finding.code));
        assert_eq!(others.count(), 0, "{}", summary(&report.findings));
    }
}

#[test]
fn a_latency_ramp_of_an_imu_is_reported_and_no_yaw_drift() {
    let report = Log::modified(|log| {
        use_high_rates(&mut log.run);
        log.run.imu.timing.rate_hz = 100.0;
        log.edit = Some(|messages: &mut Vec<Message>| {
            let late_s = |_, since_s: f64| 0.08 * ((since_s - 6.0) / 8.0).clamp(0.0, 1.0);
            delay_topic(messages, IMU, late_s);
        });
    })
    .report();
    let finding = single_finding(&report, "LAT003", IMU);
    let estimate = finding.estimate.as_ref().expect("an estimate");
    let (value, half) = (estimate.value().expect("an amount"), half_width(estimate));
    assert!((value - 0.08).abs() < 2.0 * half.max(1e-4) && half < 2e-3, "{value} ± {half}");
    let is_late = |code: &str| ["LAT001", "LAT003"].contains(&code);
    assert!(codes(&report).into_iter().all(is_late), "{}", summary(&report.findings));
}

#[test]
fn a_load_dependent_latency_is_reported_with_its_range_only() {
    let report = report_with(|messages| {
        let at = |message: &Message| {
            let fields = message.fields().into_iter();
            let xyz = fields.into_iter().find_map(|field| match field {
                Field::Xyz(at, _) => Some(message.floats::<3>(at)),
                _ => None,
            });
            (stamp_ns(message) as f64 / SECOND_NS, Vec3::from(xyz.expect("a position")))
        };
        let all: Vec<(f64, Vec3)> = pose_messages(messages).map(|message| at(message)).collect();
        let speed = |row: usize| {
            let (before, after) = (all[row.saturating_sub(1)], all[(row + 1).min(all.len() - 1)]);
            (after.1 - before.1).norm() / (after.0 - before.0)
        };
        let max_speed = (0..all.len()).map(speed).fold(0.0, f64::max);
        let late: Vec<f64> =
            (0..all.len()).map(|row| 0.003 + 0.02 * speed(row) / max_speed).collect();
        delay_poses(messages, |row, _| late[row]);
    });
    let finding = single_finding(&report, "LAT003", POSE);
    assert_eq!(finding.evidence.more["kind"], "load", "{}", summary(&report.findings));
    let (value, half) = value_and_half_width(&report, "LAT003");
    assert!((value - 0.02).abs() < 1e-3 && half < 1.5e-3, "{value} ± {half}");
    assert!(
        codes(&report).is_subset(&["LAT001", "LAT003"].into()),
        "{}",
        summary(&report.findings)
    );
}

#[test]
fn delay_jitter_is_reported_with_median_and_mean() {
    let report =
        report_with(|messages| delay_poses(messages, |row, _| 0.010 - 4e-3 * random(row).ln()));
    let (value, half) = value_and_half_width(&report, "LAT001");
    let median_s = 0.010 + 4e-3 * 2.0_f64.ln();
    assert!((value - median_s).abs() < 2.0 * half, "{value} ± {half} is not {median_s}");
    let finding = single_finding(&report, "LAT001", POSE);
    assert!(finding.message.contains("(median;"), "{}", finding.message);
    let mean_s = finding.evidence.more["delays"]["mean_s"].as_f64();
    assert!(mean_s.is_some_and(|mean_s| (mean_s - 0.014).abs() < 6e-4), "{mean_s:?}");
}

#[test]
fn a_frame_id_change_mid_run_is_not_reported_as_early_end() {
    let report = report_with(|messages| {
        let count = pose_messages(messages).count();
        for message in pose_messages(messages).skip(count / 2) {
            for field in message.fields() {
                let Field::Stamp(at) = field else { continue };
                message.cdr[at + 12] = b'x';
            }
        }
    });
    let found = codes(&report);
    assert!(found.is_subset(&["FRM007"].into()), "{}", summary(&report.findings));
}

#[test]
fn a_tool_pose_on_a_topic_named_marker_is_not_a_camera_target() {
    let report = report_with(|messages| {
        for message in pose_messages(messages) {
            message.topic = "/vicon/tool_marker".to_owned();
        }
    });
    let found = report.streams.iter().find(|stream| stream.topic == "/vicon/tool_marker");
    assert_eq!(found.map(|stream| stream.role), Some("pose"), "{:?}", report.streams);
    assert_eq!(codes(&report), BTreeSet::new(), "{}", summary(&report.findings));
}

/// Sag of the shoulder in degrees, before and after the load changes at [`LOADED_S`].
const SAGS: [f64; 2] = [0.15, 0.6];
const LOADED_S: f64 = 9.0;

fn set_sag(run: &mut Scenario, degrees: f64) {
    use_high_rates(run);
    let amplitude_rad = degrees.to_radians();
    run.compliance = vec![poseaudit::synth::SynthCompliance {
        joint: 1,
        kind: SynthComplianceKind::Sag,
        amplitude_rad,
    }];
}

#[test]
fn sag_that_changes_with_the_load_is_reported_with_both_values() {
    let report = Log::modified(|log| {
        set_sag(&mut log.run, SAGS[0]);
        log.edit = Some(|messages| {
            let mut loaded = Log::fault_free().run;
            set_sag(&mut loaded, SAGS[1]);
            let mut bytes = Vec::new();
            loaded.write_mcap(std::io::Cursor::new(&mut bytes), None).expect("it is written");
            let mut loaded = read(&bytes);
            let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
            let from_ns = start_ns + (LOADED_S * SECOND_NS) as i64;
            messages.retain(|message| message.topic != POSE || message.log_ns < from_ns);
            loaded.retain(|message| message.topic == POSE && message.log_ns >= from_ns);
            messages.extend(loaded);
            messages.sort_by_key(|message| message.log_ns);
        });
    })
    .report();
    assert_eq!(codes(&report), ["ZER003"].into(), "{}", summary(&report.findings));
    let finding = single_finding(&report, "ZER003", "shoulder_lift_joint");
    let change = finding.estimate.as_ref().and_then(Estimate::change).expect("a change");
    for (found, truth) in [(change.from, SAGS[0]), (change.to, SAGS[1])] {
        assert!((found.to_degrees() - truth).abs() < 0.1, "{change:?}");
    }
    let start = report.log.start_ns.expect("a start");
    let at_s = change.change_ns.seconds_since(start);
    assert!((at_s - LOADED_S).abs() < 1.5, "{at_s} s");
}

/// Joint states at 500 Hz with uniform stamp jitter of up to `max_jitter_s`.
fn add_stamp_jitter(messages: &mut [Message], max_jitter_s: f64) {
    let joints = messages_of(messages, JOINT_STATES).enumerate();
    for (row, message) in joints {
        message.shift_stamps((max_jitter_s * (2.0 * random(row) - 1.0) * SECOND_NS) as i64);
    }
}

#[test]
fn gaps_and_lost_samples_agree_with_the_stamps() {
    type Edit = fn(&mut Vec<Message>);
    let edits: [(Edit, &[&str]); 5] = [
        (|messages| add_stamp_jitter(messages, 3e-4), &[]),
        (|messages| add_stamp_jitter(messages, 6e-4), &[]),
        // Pairs, as from a bus that sends two at once.
        (
            |messages| {
                let joints = messages_of(messages, JOINT_STATES).enumerate();
                joints
                    .filter(|(row, _)| row % 2 == 1)
                    .for_each(|(_, own)| own.shift_stamps(-1_900_000));
            },
            &[],
        ),
        (
            |messages| {
                add_stamp_jitter(messages, 3e-4);
                let mut row = 0;
                messages.retain(|message| {
                    row += usize::from(message.topic == JOINT_STATES);
                    message.topic != JOINT_STATES || !(2000..2200).contains(&row)
                });
            },
            &["TIM002"],
        ),
        (
            |messages| {
                add_stamp_jitter(messages, 3e-4);
                let mut row = 0;
                messages.retain(|message| {
                    row += 1;
                    message.topic != JOINT_STATES || random(row) > 0.05
                });
            },
            &["TIM002"],
        ),
    ];
    for (case, (edit, expected)) in edits.into_iter().enumerate() {
        let log = Log::modified(|log| {
            use_high_rates(&mut log.run);
            log.run.duration_s = 12.0;
            log.run.joints.timing.rate_hz = 500.0;
            log.edit = Some(edit);
        });
        let [before, mut messages] = [None, Some(edit)].map(|edit| read(&write(&log.run, edit)));
        let removed = before.len() - messages.len();
        let report = log.report();
        let found = codes(&report);
        assert_eq!(
            found,
            expected.iter().copied().collect(),
            "{case}: {}",
            summary(&report.findings)
        );
        for finding in report.findings.iter().filter(|finding| finding.code.starts_with("TIM")) {
            let mut stamps: Vec<i64> =
                messages_of(&mut messages, JOINT_STATES).map(|own| stamp_ns(own)).collect();
            stamps.sort_unstable();
            let more = &finding.evidence.more;
            let gaps = more["gaps"].as_array().expect("gaps");
            for gap in gaps {
                let start: i64 = gap["start_ns"].as_str().and_then(|at| at.parse().ok()).unwrap();
                let at = stamps.binary_search(&start).expect("a gap starts at a stamp");
                let length_s = (stamps[at + 1] - start) as f64 / SECOND_NS;
                assert!(
                    (gap["length_s"].as_f64().unwrap() - length_s).abs() < 1e-6,
                    "{case}: {gap}"
                );
            }
            let lost = more["lost"].as_u64().unwrap() as usize;
            assert!(lost.abs_diff(removed) <= 2 + removed / 20, "{case}: {lost} of {removed}");
        }
    }
}
