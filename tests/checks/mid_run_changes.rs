//! Faults that change during a run: the rule of the fault reports the values before and after, and the
//! time.

use std::collections::BTreeSet;

use poseaudit::finding::{Estimate, Finding};
use poseaudit::geometry::{
    Pose, QuaternionOrderError, Vec3, pose, rotation_from_rotvec, rotation_from_xyzw,
};
use poseaudit::report::{Report, Verdict};
use poseaudit::synth::{JOINT_STATES, LoggedEncoding, POSE, Scenario, ToolSlip};
use serde_json::Value;

use crate::checks::case::{Log, single_finding, summary};
use crate::checks::recording::{Field, Message, drop_messages};

/// Time of every change, s from the start.
const CHANGE_S: f64 = 4.5;

#[test]
fn a_tool_slip_is_reported_with_both_offsets_and_its_time() {
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        let tool_from_slipped = Pose::translation(0.0, 0.03, 0.04);
        log.run.pose.tool_slip = Some(ToolSlip { from_s: CHANGE_S, to_s: 60.0, tool_from_slipped });
    })
    .report();
    assert_change(&report, "FRM003", POSE, 0.05, 1e-4);
    let finding = single_finding(&report, "FRM003", POSE);
    assert_eq!(finding.title, "tool frame changes mid-run");
    let to = &finding.evidence.more["changes"][0]["to"]["xyz"];
    let to = [0, 1, 2].map(|axis| to[axis].as_f64().expect("a number"));
    assert!((Vec3::from(to) - Vec3::new(0.0, 0.03, 0.04)).norm() < 1e-4, "{to:?}");
}

#[test]
fn a_temporary_tool_slip_is_only_a_tool_finding() {
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        let tool_from_slipped = Pose::translation(0.0, 0.0, 0.02);
        log.run.pose.tool_slip = Some(ToolSlip { from_s: CHANGE_S, to_s: 6.0, tool_from_slipped });
    })
    .report();
    assert_eq!(codes(&report), ["FRM003"].into(), "{}", summary(&report.findings));
    let slip_m =
        single_finding(&report, "FRM003", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(slip_m.is_some_and(|slip_m| (slip_m - 0.02).abs() < 1e-3), "{slip_m:?}");
}

#[test]
fn a_temporary_tool_slip_has_the_same_size_with_poses_in_millimetres() {
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.is_in_millimetres = true;
        let tool_from_slipped = Pose::translation(0.0, 0.0, 0.02);
        log.run.pose.tool_slip = Some(ToolSlip { from_s: CHANGE_S, to_s: 6.0, tool_from_slipped });
    })
    .report();
    assert_eq!(codes(&report), ["FRM003", "ORD008"].into(), "{}", summary(&report.findings));
    let slip_m =
        single_finding(&report, "FRM003", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(slip_m.is_some_and(|slip_m| (slip_m - 0.02).abs() < 1e-3), "{slip_m:?}");
}

#[test]
fn a_base_moved_mid_run_is_reported() {
    let report = report_with(|messages| {
        let moved = pose([0.0, 0.012, 0.005], rotation_from_rotvec(Vec3::z() * 0.02));
        edit_poses(messages_after_change(messages), |logged| moved * logged);
    });
    assert_change(&report, "FRM002", POSE, 0.013, 1e-4);
}

/// A change below the limits must not hide a constant offset above them.
#[test]
fn a_constant_offset_is_reported_although_it_also_changes_a_little() {
    let report = report_with(|messages| {
        edit_poses(messages, |logged| Pose::translation(0.0, 0.02, 0.0) * logged);
        edit_poses(messages_after_change(messages), |logged| {
            Pose::translation(0.0, 0.0, 4e-4) * logged
        });
    });
    let finding = single_finding(&report, "FRM002", POSE);
    let offset_m = finding.estimate.as_ref().and_then(Estimate::value);
    assert!(offset_m.is_some_and(|offset_m| (offset_m - 0.02).abs() < 5e-4), "{offset_m:?}");
}

#[test]
fn a_zero_offset_that_changes_mid_run_is_reported_and_no_abrupt_stop() {
    let report = report_with(|messages| {
        for message in messages_after_change(messages)
            .iter_mut()
            .filter(|message| message.topic == JOINT_STATES)
        {
            message.turn_joint(2, -0.8_f64.to_radians());
        }
    });
    assert_change(&report, "ZER001", "elbow_joint", 0.8_f64.to_radians(), 1e-4);
}

#[test]
fn a_radial_scale_that_changes_mid_run_is_reported() {
    let report = report_with(|messages| {
        edit_poses(messages_after_change(messages), |logged| {
            pose((1.01 * logged.translation.vector).into(), logged.rotation)
        });
    });
    assert_change(&report, "ZER002", POSE, 0.01, 1e-4);
}

#[test]
fn a_short_segment_of_unknown_encoding_gives_no_frame_finding() {
    let report = report_with(|messages| {
        let last_ns = messages.iter().map(|message| message.log_ns).max().unwrap_or(0);
        let first = messages.partition_point(|message| message.log_ns < last_ns - 1_200_000_000);
        edit_pose_fields(&mut messages[first..], |message, field| {
            if let Field::Xyzw(at) = field {
                let [x, y, z, w] = message.floats(at);
                message.set_floats(at, &[w, x, y, z]);
            }
        });
    });
    let found = codes(&report);
    assert!(found.is_subset(&["MDL001", "ORD002"].into()), "{found:?}");
    assert_ne!(report.verdict, Verdict::Pass, "{found:?}");
}

#[test]
fn an_encoding_that_changes_mid_run_is_reported_with_its_time() {
    let wxyz = report_with(|messages| {
        edit_pose_fields(messages_after_change(messages), |message, field| {
            if let Field::Xyzw(at) = field {
                let [x, y, z, w] = message.floats(at);
                message.set_floats(at, &[w, x, y, z]);
            }
        });
    });
    let millimetres = report_with(|messages| millimetres_after_change(messages));
    for (code, report) in [("ORD002", wxyz), ("ORD008", millimetres)] {
        assert_eq!(codes(&report), [code].into(), "{}", summary(&report.findings));
        let finding = single_finding(&report, code, POSE);
        let changes = &finding.evidence.more["change_ns"];
        assert_eq!(changes.as_array().map(Vec::len), Some(1), "{changes}");
        assert_near_s(seconds_after_start(&report, &changes[0]), CHANGE_S);
    }
}

#[test]
fn joint_angles_that_change_to_degrees_after_a_gap_are_reported_for_that_part() {
    const GAP_S: f64 = 1.5;
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.duration_s *= 2.0;
        log.edit = Some(|messages| {
            let after = messages_after_change(messages).iter_mut();
            after
                .filter(|message| message.topic == JOINT_STATES)
                .for_each(|message| message.scale_joints(1_f64.to_degrees()));
            for topic in [JOINT_STATES, POSE] {
                drop_messages(messages, topic, CHANGE_S, CHANGE_S + GAP_S);
            }
        });
    })
    .report();
    let above: BTreeSet<&str> =
        codes(&report).into_iter().filter(|code| *code != "TIM002").collect();
    assert_eq!(above, ["ORD004"].into(), "{}", summary(&report.findings));
    let finding = single_finding(&report, "ORD004", JOINT_STATES);
    let at_s = seconds_after_start(&report, &finding.evidence.more["change_ns"][0]);
    assert!((CHANGE_S - 0.05..CHANGE_S + GAP_S + 0.05).contains(&at_s), "{at_s} s");
}

#[test]
fn joints_that_change_unit_or_order_without_a_gap_are_reported_for_that_part() {
    let of = |change: fn(&mut Scenario)| {
        Log::modified(|log| {
            log.run.tf.timing.rate_hz = 0.0;
            log.run.duration_s *= 2.0;
            let mut changed = log.run.clone();
            change(&mut changed);
            log.run.changes = vec![(CHANGE_S, changed)];
        })
        .report()
    };
    let reports = [
        ("ORD004", of(|run| run.joints.is_in_degrees = true)),
        ("ORD005", of(|run| run.joints.number_order = Some(vec![0, 1, 4, 3, 2, 5]))),
    ];
    for (code, report) in reports {
        assert_eq!(codes(&report), [code].into(), "{}", summary(&report.findings));
        let finding = single_finding(&report, code, JOINT_STATES);
        let at_s = seconds_after_start(&report, &finding.evidence.more["change_ns"][0]);
        assert_near_s(at_s, CHANGE_S);
    }
}

#[test]
fn clock_skew_is_found_with_a_unit_that_changes_mid_run() {
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.timing.skew = 1e-3;
        log.edit = Some(|messages| millimetres_after_change(messages));
    })
    .report();
    assert_eq!(codes(&report), ["LAT002", "ORD008"].into(), "{}", summary(&report.findings));
    let skew = single_finding(&report, "LAT002", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(skew.is_some_and(|skew| (skew - 1e-3).abs() < 2e-5), "{skew:?}");
}

#[test]
fn a_unit_change_is_found_with_a_wrong_quaternion_order() {
    let report = Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.encoding =
            LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
        log.edit = Some(|messages| millimetres_after_change(messages));
    })
    .report();
    assert_eq!(codes(&report), ["ORD002", "ORD008"].into(), "{}", summary(&report.findings));
    let changes =
        |code| single_finding(&report, code, POSE).evidence.more.get("change_ns").cloned();
    assert_eq!(changes("ORD002"), None);
    assert!(changes("ORD008").is_some());
}

fn millimetres_after_change(messages: &mut [Message]) {
    edit_pose_fields(messages_after_change(messages), |message, field| {
        if let Field::Xyz(at, _) = field {
            let xyz: [f64; 3] = message.floats(at);
            message.set_floats(at, &xyz.map(|metres| 1e3 * metres));
        }
    });
}

#[test]
fn a_log_without_changes_has_no_findings() {
    let report = report_with(|_| {});
    assert_eq!(codes(&report), BTreeSet::new(), "{}", summary(&report.findings));
}

/// The report on a log without /tf, with edited messages.
fn report_with(edit: fn(&mut Vec<Message>)) -> Report {
    Log::modified(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.edit = Some(edit);
    })
    .report()
}

/// The messages from [`CHANGE_S`] on.
fn messages_after_change(messages: &mut [Message]) -> &mut [Message] {
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let from_ns = start_ns + (CHANGE_S * 1e9) as i64;
    let first = messages.partition_point(|message| message.log_ns < from_ns);
    &mut messages[first..]
}

fn edit_pose_fields(messages: &mut [Message], change: impl Fn(&mut Message, Field)) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        for field in message.fields() {
            change(message, field);
        }
    }
}

fn edit_poses(messages: &mut [Message], change: impl Fn(Pose) -> Pose) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let (mut at_xyz, mut at_xyzw) = (0, 0);
        for field in message.fields() {
            match field {
                Field::Xyz(at, _) => at_xyz = at,
                Field::Xyzw(at) => at_xyzw = at,
                Field::Stamp(_) => {}
            }
        }
        let rotation = rotation_from_xyzw(message.floats(at_xyzw)).expect("a rotation");
        let changed = change(pose(message.floats(at_xyz), rotation));
        message.set_floats(at_xyz, changed.translation.vector.as_slice());
        message.set_floats(at_xyzw, changed.rotation.coords.as_slice());
    }
}

fn codes(report: &Report) -> BTreeSet<&str> {
    report.findings.iter().map(|finding| finding.code).collect()
}

/// Asserts a single finding, `code` on `label`, with a change by `size` at [`CHANGE_S`].
#[track_caller]
fn assert_change(report: &Report, code: &str, label: &str, size: f64, tolerance: f64) {
    assert_eq!(codes(report), [code].into(), "{}", summary(&report.findings));
    let finding: &Finding = single_finding(report, code, label);
    let estimate: &Estimate = finding.estimate.as_ref().expect("an estimate");
    let value = estimate.value().expect("an amount");
    assert!((value - size).abs() < tolerance, "{value} is not {size}");
    let change = estimate.change().expect("a change");
    assert!((change.to - change.from - size).abs() < tolerance, "{change:?}");
    assert_near_s(
        seconds_after_start(report, &Value::String(change.change_ns.to_string())),
        CHANGE_S,
    );
}

/// Time of a stamp after the start of the log, s.
fn seconds_after_start(report: &Report, stamp: &Value) -> f64 {
    let ns = |text: &str| text.parse::<i64>().expect("nanoseconds");
    let stamp = stamp.as_str().map(ns).expect("a stamp");
    let start = report.log.start_ns.expect("a start");
    (stamp - ns(&start.to_string())) as f64 * 1e-9
}

#[track_caller]
fn assert_near_s(at_s: f64, expected_s: f64) {
    assert!((at_s - expected_s).abs() < 0.05, "{at_s} s is not {expected_s} s");
}
