//! Combined faults: each is found as if it were alone.

use poseaudit::geometry::QuaternionOrderError;
use poseaudit::report::Report;
use poseaudit::robot::catalogue;
use poseaudit::synth::{self, Coding, IMU, JOINT_STATES, POSE, Scenario};

use crate::checks::case::What::{Amount, Degrees, DegreesAMinute, Frame, Order, ReadAs};
use crate::checks::case::{Log, What, summary, the};
use crate::checks::zer::zero;

/// Asserts the findings: rule, subject and estimate.
#[track_caller]
fn assert_found(report: &Report, expected: &[(&str, &str, What)]) {
    assert_eq!(report.findings.len(), expected.len(), "found:\n{}", summary(&report.findings));
    for (code, label, what) in expected {
        what.assert_is(the(report, code, label).estimate.as_ref());
    }
}

#[test]
fn the_demos_four() {
    let mut log = Log::sound();
    let demo = synth::demo();
    log.run.pose.coding = demo.pose.coding;
    log.run.pose.timing.latency_s = demo.pose.timing.latency_s;
    log.run.joints.zero_offsets = demo.joints.zero_offsets;
    log.run.imu.yaw_drift_rad_s = demo.imu.yaw_drift_rad_s;
    assert_found(
        &log.audited(),
        &[
            ("ORD001", POSE, ReadAs("rotvec", "euler:xyz")),
            ("LAT001", POSE, Amount(0.022, 0.2e-3)),
            ("ZER001", "shoulder_lift_joint", Degrees(0.5, 0.02)),
            ("YAW001", IMU, DegreesAMinute(3.0, 0.1)),
        ],
    );
}

#[test]
fn a_last_joint_that_turns_the_other_way_beside_a_zero() {
    let report = Log::with(|log| {
        log.run.joints.scales = vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0];
        log.run.joints.zero_offsets = zero(1, 0.5);
    })
    .audited();
    the(&report, "ORD009", "wrist_3_joint");
    let lift = the(&report, "ZER001", "shoulder_lift_joint");
    Degrees(0.5, 0.02).assert_is(lift.estimate.as_ref());
    assert_eq!(report.findings.len(), 2, "found:\n{}", summary(&report.findings));
}

#[test]
fn degrees_beside_a_clock_that_is_set_back() {
    let report = Log::with(|log| {
        log.run.duration_s = 20.0;
        log.run.joints.in_degrees = true;
        log.run.pose.timing.step = Some((9.0, -0.2));
    })
    .audited();
    the(&report, "ORD004", JOINT_STATES);
    Amount(-0.2, 2e-3).assert_is(the(&report, "LAT003", POSE).estimate.as_ref());
    assert!(
        report
            .findings
            .iter()
            .all(|it| it.code.starts_with("TIM") || ["ORD004", "LAT003"].contains(&it.code)),
        "found:\n{}",
        summary(&report.findings)
    );
}

#[test]
fn two_joint_zeros() {
    let report = Log::with(|log| {
        log.run.joints.zero_offsets = zero(1, 0.5);
        log.run.joints.zero_offsets.extend(zero(2, -0.4)[1..].to_vec());
        assert_eq!(log.run.joints.zero_offsets.len(), 4, "lift and wrist_1");
    })
    .audited();
    assert_found(
        &report,
        &[
            ("ZER001", "shoulder_lift_joint", Degrees(0.5, 0.02)),
            ("ZER001", "wrist_1_joint", Degrees(-0.4, 0.02)),
        ],
    );
}

#[test]
fn neighbouring_joint_zeros() {
    let report = Log::with(|log| {
        log.run.joints.zero_offsets = zero(2, 0.6);
        log.run.joints.zero_offsets.push(-0.6_f64.to_radians());
    })
    .audited();
    assert_found(
        &report,
        &[
            ("ZER001", "elbow_joint", Degrees(0.6, 0.02)),
            ("ZER001", "wrist_1_joint", Degrees(-0.6, 0.02)),
        ],
    );
}

#[test]
fn a_quaternion_slip_and_a_latency() {
    let report = Log::with(|log| {
        log.run.pose.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
        log.run.pose.timing.latency_s = 0.015;
    })
    .audited();
    assert_found(
        &report,
        &[
            ("ORD002", POSE, ReadAs("quat:wxyz", "quat:xyzw")),
            ("LAT001", POSE, Amount(0.015, 0.2e-3)),
        ],
    );
}

#[test]
fn millimetres_and_a_joint_zero() {
    let report = Log::with(|log| {
        log.run.pose.in_millimetres = true;
        log.run.joints.zero_offsets = zero(2, 0.6);
    })
    .audited();
    assert_found(
        &report,
        &[("ORD008", POSE, ReadAs("mm", "m")), ("ZER001", "elbow_joint", Degrees(0.6, 0.02))],
    );
}

#[test]
fn degrees_in_the_wrong_order_and_late() {
    let report = Log::with(|log| {
        log.run.joints.in_degrees = true;
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
        log.run.pose.timing.latency_s = 0.015;
    })
    .audited();
    let found: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(found.len(), 3, "found:\n{}", summary(&report.findings));
    for code in ["ORD004", "ORD005", "LAT001"] {
        assert!(found.contains(&code), "found:\n{}", summary(&report.findings));
    }
    Amount(0.015, 0.2e-3).assert_is(the(&report, "LAT001", POSE).estimate.as_ref());
}

#[test]
fn an_arm_that_sags_does_so_beside_positions_in_the_wrong_order() {
    let report = Log::with(|log| {
        log.run.joints.number_order = Some(vec![2, 1, 0, 3, 4, 5]);
        crate::checks::mot::gives(log, &[(1, synth::Giving::Sag, 0.6)]);
    })
    .audited();
    let found: Vec<&str> = report.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(found, ["ORD005", "ZER003"], "found:\n{}", summary(&report.findings));
    Degrees(0.6, 0.06).assert_is(the(&report, "ZER003", "shoulder_lift_joint").estimate.as_ref());
}

#[test]
fn a_turned_base_a_tool_and_a_joint_zero() {
    let report = Log::with(|log| {
        log.options.run.tip = Some("tool0".to_owned());
        log.run.pose.reference_from_stream = crate::checks::frm::half_turn();
        log.run.pose.tip_from_stream = crate::checks::frm::tool();
        log.run.joints.zero_offsets = zero(2, 0.6);
    })
    .audited();
    assert_found(
        &report,
        &[
            ("FRM002", POSE, Frame([0.0, 0.1e-3], [180.0, 0.02])),
            ("FRM003", POSE, Frame([0.14, 0.2e-3], [90.0, 0.02])),
            ("ZER001", "elbow_joint", Degrees(0.6, 0.02)),
        ],
    );
}

#[test]
fn an_inverted_pose_with_a_joint_zero_and_late() {
    let report = Log::with(|log| {
        log.run.pose.coding = Coding::Inverted;
        log.run.joints.zero_offsets = zero(2, 0.6);
        log.run.pose.timing.latency_s = -0.012;
    })
    .audited();
    assert_found(
        &report,
        &[
            ("ORD003", POSE, ReadAs("pose-inverse", "pose")),
            ("ZER001", "elbow_joint", Degrees(0.6, 0.02)),
            ("LAT001", POSE, Amount(-0.012, 0.2e-3)),
        ],
    );
}

/// A log of an iiwa, whose link lengths are almost symmetric.
fn iiwa(change: impl FnOnce(&mut Log)) -> Report {
    let robot = catalogue::find("kuka_lbr_iiwa14").expect("the catalogue has it").clone();
    Log::with(|log| {
        let sound = log.run.clone();
        log.run = Scenario::new(robot, "lbr_link_0", "lbr_link_ee");
        log.run.home = vec![0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0];
        (log.run.duration_s, log.run.speed) = (sound.duration_s, sound.speed);
        (log.run.joints.timing, log.run.pose.timing) = (sound.joints.timing, sound.pose.timing);
        (log.run.tf.timing, log.run.imu.timing) = (sound.tf.timing, sound.imu.timing);
        log.options.run.tip = Some("lbr_link_ee".to_owned());
        change(log);
    })
    .audited()
}

#[test]
fn joints_read_from_tip_to_base_are_no_inverse_between_turned_frames() {
    let report = iiwa(|log| log.run.joints.number_order = Some((0..7).rev().collect()));
    assert_found(
        &report,
        &[(
            "ORD005",
            JOINT_STATES,
            Order(&["lbr_A7", "lbr_A6", "lbr_A5", "lbr_A4", "lbr_A3", "lbr_A2", "lbr_A1"]),
        )],
    );
}

#[test]
fn a_base_turned_by_half_is_no_zero_of_the_first_joint() {
    let report = iiwa(|log| log.run.pose.reference_from_stream = crate::checks::frm::half_turn());
    assert_found(&report, &[("FRM002", POSE, Frame([0.0, 0.05e-3], [180.0, 0.01]))]);
    let twins = &report.findings[0].evidence.indistinguishable;
    assert!(twins.iter().any(|twin| twin.code == "ZER001"), "{twins:?}");
}
