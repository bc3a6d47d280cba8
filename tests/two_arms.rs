//! Logs of two arms.

use std::fs;
use std::io::Cursor;

use poseaudit::finding::Severity;
use poseaudit::report::Report;
use poseaudit::synth::{POSE, Scenario, write_cell};
use poseaudit::{Options, audit};
use tempfile::TempDir;

use crate::checks::recording::{self, Message};

/// A UR5e whose topics begin with `side`.
fn arm(side: &str, seed: u64) -> Scenario {
    let mut run = Scenario::ur5e();
    (run.namespace, run.seed) = (format!("/{side}"), seed);
    (run.tf.timing.rate_hz, run.tf.has_static, run.imu.timing.rate_hz) = (0.0, false, 0.0);
    run
}

fn audit_edited(arms: &[Scenario], edit: impl Fn(&mut Message)) -> Report {
    let mut bytes = Vec::new();
    write_cell(arms, Cursor::new(&mut bytes), None).expect("a log");
    let mut messages = recording::read(&bytes);
    messages.iter_mut().for_each(edit);
    let folder = TempDir::new().expect("a folder");
    let log = folder.path().join("run.mcap");
    fs::write(&log, recording::encode(&messages)).expect("a file");
    audit(&Options { logs: vec![log], ..Options::default() }).expect("a report").report
}

fn exchange(a: &str, b: &str) -> impl Fn(&mut Message) {
    let exchanged = [(a.to_owned(), b.to_owned()), (b.to_owned(), a.to_owned())];
    move |message| {
        let own = exchanged.iter().find(|(topic, _)| *topic == message.topic);
        if let Some((_, other)) = own {
            message.topic.clone_from(other);
        }
    }
}

#[test]
fn exchanged_poses_of_two_arms_are_named_and_audited_against_the_arms_they_follow() {
    let [left, right] = ["left", "right"].map(|side| format!("/{side}{POSE}"));
    let report = audit_edited(&[arm("left", 1), arm("right", 2)], exchange(&left, &right));
    let found: Vec<(&str, Severity, &str)> = report
        .findings
        .iter()
        .map(|found| {
            let topic = found.subject.topic.as_deref().unwrap_or_default();
            (found.code, found.severity, topic)
        })
        .collect();
    let expected = [&left, &right].map(|topic| ("FRM007", Severity::Error, topic.as_str()));
    assert_eq!(found, expected);
}

#[test]
fn a_joint_zero_does_not_assign_the_poses_to_an_arm_that_moves_alike() {
    let mut left = arm("left", 1);
    left.joints.zero_offsets = vec![0.0, 0.0, 0.6];
    let report = audit_edited(&[left, arm("right", 1)], |_| {});
    let codes: Vec<&str> = report.findings.iter().map(|found| found.code).collect();
    assert_eq!(codes, ["ZER001"]);
}

#[test]
fn an_arm_without_poses_gets_none_of_an_arm_that_moves_alike() {
    let (mut left, mut right) = (arm("left", 1), arm("right", 1));
    left.joints.is_in_degrees = true;
    right.pose.timing.rate_hz = 0.0;
    let report = audit_edited(&[left, right], |_| {});
    let codes: Vec<&str> = report.findings.iter().map(|found| found.code).collect();
    assert!(codes.contains(&"ORD004") && !codes.contains(&"FRM007"), "{codes:?}");
}
