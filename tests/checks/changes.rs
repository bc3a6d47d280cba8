//! Faults that change during a run: the rule of the fault reports the values before and after, and the
//! time.

use std::collections::BTreeSet;

use poseaudit::finding::{Estimate, Finding};
use poseaudit::geometry::{
    Pose, QuaternionOrderError, Vec3, pose, rotation_from_rotvec, rotation_from_xyzw,
};
use poseaudit::report::{Report, Verdict};
use poseaudit::synth::{Coding, JOINT_STATES, POSE, ToolSlip};
use serde_json::Value;

use crate::checks::case::{Log, summary, the};
use crate::checks::recording::{Field, Message};

/// Time of every change, s from the start.
const FROM_S: f64 = 4.5;

#[test]
fn a_tool_that_slips_is_named_with_both_offsets_and_the_moment() {
    let report = Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        let tool_from_slipped = Pose::translation(0.0, 0.03, 0.04);
        log.run.pose.slip = Some(ToolSlip { from_s: FROM_S, to_s: 60.0, tool_from_slipped });
    })
    .audited();
    assert_change(&report, "FRM003", POSE, 0.05, 1e-4);
    let finding = the(&report, "FRM003", POSE);
    assert_eq!(finding.title, "tool frame changes mid-run");
    let to = &finding.evidence.more["changes"][0]["to"]["xyz"];
    let to = [0, 1, 2].map(|axis| to[axis].as_f64().expect("a number"));
    assert!((Vec3::from(to) - Vec3::new(0.0, 0.03, 0.04)).norm() < 1e-4, "{to:?}");
}

#[test]
fn a_tool_that_slips_and_is_put_back_is_the_tools_alone() {
    let report = Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        let tool_from_slipped = Pose::translation(0.0, 0.0, 0.02);
        log.run.pose.slip = Some(ToolSlip { from_s: FROM_S, to_s: 6.0, tool_from_slipped });
    })
    .audited();
    assert_eq!(codes(&report), ["FRM003"].into(), "{}", summary(&report.findings));
    let apart_m = the(&report, "FRM003", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(apart_m.is_some_and(|apart_m| (apart_m - 0.02).abs() < 1e-3), "{apart_m:?}");
}

#[test]
fn a_tool_that_slips_and_is_put_back_is_as_far_off_in_millimetres() {
    let report = Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.in_millimetres = true;
        let tool_from_slipped = Pose::translation(0.0, 0.0, 0.02);
        log.run.pose.slip = Some(ToolSlip { from_s: FROM_S, to_s: 6.0, tool_from_slipped });
    })
    .audited();
    assert_eq!(codes(&report), ["FRM003", "ORD008"].into(), "{}", summary(&report.findings));
    let apart_m = the(&report, "FRM003", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(apart_m.is_some_and(|apart_m| (apart_m - 0.02).abs() < 1e-3), "{apart_m:?}");
}

#[test]
fn a_base_that_is_moved_is_named() {
    let report = edited(|messages| {
        let moved = pose([0.0, 0.012, 0.005], rotation_from_rotvec(Vec3::z() * 0.02));
        each_pose(later(messages), |logged| moved * logged);
    });
    assert_change(&report, "FRM002", POSE, 0.013, 1e-4);
}

#[test]
fn a_joint_that_loses_its_zero_is_named_and_does_not_stop_there() {
    let report = edited(|messages| {
        for message in later(messages).iter_mut().filter(|message| message.topic == JOINT_STATES) {
            message.turn_joint(2, -0.8_f64.to_radians());
        }
    });
    assert_change(&report, "ZER001", "elbow_joint", 0.8_f64.to_radians(), 1e-4);
}

#[test]
fn positions_that_grow_from_then_on_are_named_with_their_growth() {
    let report = edited(|messages| {
        each_pose(later(messages), |logged| {
            pose((1.01 * logged.translation.vector).into(), logged.rotation)
        });
    });
    assert_change(&report, "ZER002", POSE, 0.01, 1e-4);
}

#[test]
fn a_short_part_that_does_not_tell_how_it_is_coded_names_no_frame() {
    let report = edited(|messages| {
        let last_ns = messages.iter().map(|message| message.log_ns).max().unwrap_or(0);
        let first = messages.partition_point(|message| message.log_ns < last_ns - 1_200_000_000);
        each_pose_field(&mut messages[first..], |message, field| {
            if let Field::Xyzw(at) = field {
                let [x, y, z, w] = message.floats(at);
                message.set_floats(at, &[w, x, y, z]);
            }
        });
    });
    let said = codes(&report);
    assert!(said.is_subset(&["MDL001", "ORD002"].into()), "{said:?}");
    assert_ne!(report.verdict, Verdict::Pass, "{said:?}");
}

#[test]
fn numbers_that_are_coded_otherwise_from_then_on_are_named_for_that_part() {
    let wxyz = edited(|messages| {
        each_pose_field(later(messages), |message, field| {
            if let Field::Xyzw(at) = field {
                let [x, y, z, w] = message.floats(at);
                message.set_floats(at, &[w, x, y, z]);
            }
        });
    });
    let millimetres = edited(|messages| in_millimetres_later(messages));
    for (code, report) in [("ORD002", wxyz), ("ORD008", millimetres)] {
        assert_eq!(codes(&report), [code].into(), "{}", summary(&report.findings));
        let finding = the(&report, code, POSE);
        let changes = &finding.evidence.more["change_ns"];
        assert_eq!(changes.as_array().map(Vec::len), Some(1), "{changes}");
        assert_near_s(seconds(&report, &changes[0]), FROM_S);
    }
}

#[test]
fn a_clock_that_runs_fast_does_so_beside_a_unit_that_changes() {
    let report = Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.timing.skew = 1e-3;
        log.edit = Some(|messages| in_millimetres_later(messages));
    })
    .audited();
    assert_eq!(codes(&report), ["LAT002", "ORD008"].into(), "{}", summary(&report.findings));
    let skew = the(&report, "LAT002", POSE).estimate.as_ref().and_then(Estimate::value);
    assert!(skew.is_some_and(|skew| (skew - 1e-3).abs() < 2e-5), "{skew:?}");
}

#[test]
fn a_unit_that_changes_does_so_beside_components_that_are_in_the_wrong_order() {
    let report = Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
        log.edit = Some(|messages| in_millimetres_later(messages));
    })
    .audited();
    assert_eq!(codes(&report), ["ORD002", "ORD008"].into(), "{}", summary(&report.findings));
    let changes = |code| the(&report, code, POSE).evidence.more.get("change_ns").cloned();
    assert_eq!(changes("ORD002"), None);
    assert!(changes("ORD008").is_some());
}

fn in_millimetres_later(messages: &mut [Message]) {
    each_pose_field(later(messages), |message, field| {
        if let Field::Xyz(at, _) = field {
            let xyz: [f64; 3] = message.floats(at);
            message.set_floats(at, &xyz.map(|metres| 1e3 * metres));
        }
    });
}

#[test]
fn what_stays_as_it_is_has_not_changed() {
    let report = edited(|_| {});
    assert_eq!(codes(&report), BTreeSet::new(), "{}", summary(&report.findings));
}

/// The report on a log without /tf, with edited messages.
fn edited(edit: fn(&mut Vec<Message>)) -> Report {
    Log::with(|log| {
        log.run.tf.timing.rate_hz = 0.0;
        log.edit = Some(edit);
    })
    .audited()
}

/// The messages from [`FROM_S`] on.
fn later(messages: &mut [Message]) -> &mut [Message] {
    let start_ns = messages.iter().map(|message| message.log_ns).min().unwrap_or(0);
    let from_ns = start_ns + (FROM_S * 1e9) as i64;
    let first = messages.partition_point(|message| message.log_ns < from_ns);
    &mut messages[first..]
}

fn each_pose_field(messages: &mut [Message], change: impl Fn(&mut Message, Field)) {
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        for field in message.fields() {
            change(message, field);
        }
    }
}

fn each_pose(messages: &mut [Message], change: impl Fn(Pose) -> Pose) {
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

/// Asserts a single finding, `code` on `label`, with a change by `size` at [`FROM_S`].
#[track_caller]
fn assert_change(report: &Report, code: &str, label: &str, size: f64, tolerance: f64) {
    assert_eq!(codes(report), [code].into(), "{}", summary(&report.findings));
    let finding: &Finding = the(report, code, label);
    let estimate: &Estimate = finding.estimate.as_ref().expect("an estimate");
    let value = estimate.value().expect("an amount");
    assert!((value - size).abs() < tolerance, "{value} is not {size}");
    let change = estimate.change().expect("a change");
    assert!((change.to - change.from - size).abs() < tolerance, "{change:?}");
    assert_near_s(seconds(report, &Value::String(change.change_ns.to_string())), FROM_S);
}

/// Time of a stamp after the start of the log, s.
fn seconds(report: &Report, stamp: &Value) -> f64 {
    let ns = |text: &str| text.parse::<i64>().expect("nanoseconds");
    let stamp = stamp.as_str().map(ns).expect("a stamp");
    let start = report.log.start_ns.expect("a start");
    (stamp - ns(&start.to_string())) as f64 * 1e-9
}

#[track_caller]
fn assert_near_s(at_s: f64, expected_s: f64) {
    assert!((at_s - expected_s).abs() < 0.05, "{at_s} s is not {expected_s} s");
}
