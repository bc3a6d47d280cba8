//! ZER: zero offsets.

use poseaudit::robot::Robot;
use poseaudit::synth::{Motion, POSE, Scenario, SynthComplianceKind, Task, urdf_text};

use crate::checks::case::ExpectedEstimate::{Amount, Degrees};
use crate::checks::case::ExpectedSubject::{Joint, Topic};
use crate::checks::case::{Expected, Log, cases, error, half_width, single_finding, warning};
use crate::checks::mdl::move_joint_origin;
use crate::checks::mot::set_compliance;
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, OtherFindingAndInconclusive, Skipped};

cases! {
    ZER001 a_zero_offset_of_an_elbow: |log| log.run.joints.zero_offsets = zero_offset(2, 0.6)
        => error(Joint("elbow_joint"), Degrees(0.6, 0.02));
    ZER001 a_negative_zero_offset_of_a_shoulder: |log| log.run.joints.zero_offsets = zero_offset(1, -0.3)
        => warning(Joint("shoulder_lift_joint"), Degrees(-0.3, 0.02));
    ZER001 a_zero_offset_of_a_wrist: |log| log.run.joints.zero_offsets = zero_offset(3, 1.0)
        => error(Joint("wrist_1_joint"), Degrees(1.0, 0.02));
    ZER001 a_zero_offset_of_the_first_joint: |log| log.run.joints.zero_offsets = zero_offset(0, 0.4)
        => warning(Joint("shoulder_pan_joint"), Degrees(0.4, 0.02));
    ZER001 a_zero_offset_of_the_last_joint: |log| log.run.joints.zero_offsets = zero_offset(5, -0.8)
        => error(Joint("wrist_3_joint"), Degrees(-0.8, 0.02));
    ZER001 an_elbow_off_by_120_degrees: |log| log.run.joints.zero_offsets = zero_offset(2, 120.0)
        => error(Joint("elbow_joint"), Degrees(120.0, 0.02));
    ZER001 a_wrist_off_by_178_degrees: |log| log.run.joints.zero_offsets = zero_offset(3, -178.0)
        => error(Joint("wrist_1_joint"), Degrees(-178.0, 0.02));
    ZER001 the_first_joint_off_by_50_degrees: |log| log.run.joints.zero_offsets = zero_offset(0, 50.0)
        => error(Joint("shoulder_pan_joint"), Degrees(50.0, 0.02));
    ZER001 a_zero_offset_of_a_rail: |log| {
        mount_on_rail(&mut log.run);
        log.run.joints.zero_offsets = vec![0.003];
    } => error(Joint("rail_joint"), Amount(0.003, 0.05e-3));

    ZER001 a_zero_offset_of_a_hundredth_of_a_degree_passes: |log| log.run.joints.zero_offsets = zero_offset(2, 0.01)
        => NoFindings;
    ZER001 an_arm_on_a_rail_passes: |log| mount_on_rail(&mut log.run) => NoFindings;

    ZER001 a_late_pose_is_not_reported_as_zero_offset: |log| log.run.pose.timing.latency_s = 0.022
        => OnlyOtherFinding("LAT001");
    ZER001 a_rotated_base_is_not_reported_as_zero_offset: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_rotated_by_180_degrees();
    } => OnlyOtherFinding("FRM002");
    ZER001 a_tool_offset_is_not_reported_as_zero_offset: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool_offset()
        => OnlyOtherFinding("FRM003");
    ZER001 radial_scale_is_not_reported_as_zero_offset: |log| log.run.pose.radial_scale_error = 0.01 => OnlyOtherFinding("ZER002");
    ZER001 nominal_kinematics_are_not_reported_as_zero_offset: |log| crate::checks::mdl::add_link_deviations(&mut log.run)
        => OtherFindingAndInconclusive("MDL001", "calibrat");
    ZER001 one_large_link_deviation_is_not_reported_as_zero_offset: |log| add_large_link_deviation(&mut log.run)
        => OtherFindingAndInconclusive("MDL001", "calibrat");
    ZER001 a_drifting_imu_is_not_reported_as_zero_offset: |log| log.run.imu.yaw_drift_rad_s = 1e-3
        => OnlyOtherFinding("YAW001");

    ZER001 no_pose_stream: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");
    ZER001 zero_offsets_are_not_observable_at_rest: |log| log.run.motion = Motion::AtRest => Inconclusive("");
    ZER001 zero_offsets_are_not_observable_with_one_moving_joint: |log| log.run.motion = Motion::OneJoint(1) => Inconclusive("");

    ZER003 sag_of_a_shoulder: |log| set_compliance(log, &[(1, SynthComplianceKind::Sag, 0.6)])
        => error(Joint("shoulder_lift_joint"), Degrees(0.6, 0.06));
    ZER003 a_small_sag_of_an_elbow: |log| set_compliance(log, &[(2, SynthComplianceKind::Sag, 0.25)])
        => warning(Joint("elbow_joint"), Degrees(0.25, 0.04));
    ZER003 sag_of_healthy_gears_passes: |log| set_compliance(log, &[(1, SynthComplianceKind::Sag, 0.03)]) => NoFindings;
    ZER003 a_zero_offset_is_not_reported_as_sag: |log| {
        set_compliance(log, &[]);
        log.run.joints.zero_offsets = zero_offset(1, 0.6);
    } => OnlyOtherFinding("ZER001");
    ZER003 backlash_is_not_reported_as_sag: |log| set_compliance(log, &[(1, SynthComplianceKind::Backlash, 1.0)]) => OnlyOtherFinding("MOT006");
    ZER003 nominal_kinematics_are_not_reported_as_sag: |log| crate::checks::mdl::add_link_deviations(&mut log.run)
        => OnlyOtherFinding("MDL001");
    ZER003 sag_is_not_observable_at_rest: |log| log.run.motion = Motion::AtRest => Inconclusive("barely moves");
    ZER003 no_pose_stream_for_sag: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");

    ZER001 sag_is_not_reported_as_zero_offset: |log| set_compliance(log, &[(1, SynthComplianceKind::Sag, 0.6)]) => OnlyOtherFinding("ZER003");

    ZER002 growth_of_one_percent_beside_link_deviations: |log| {
        crate::checks::mdl::add_link_deviations_times(&mut log.run, 0.1);
        log.run.pose.radial_scale_error = 0.01;
    } => error(Topic(POSE), Amount(0.01, 5e-4));
    ZER002 positions_too_far_out: |log| log.run.pose.radial_scale_error = 0.01
        => error(Topic(POSE), Amount(0.01, 0.1e-3));
    ZER002 positions_too_near: |log| log.run.pose.radial_scale_error = -0.002
        => warning(Topic(POSE), Amount(-0.002, 0.1e-3));
    ZER002 a_radial_scale_of_a_ten_thousandth_passes: |log| log.run.pose.radial_scale_error = 1e-4 => NoFindings;
    ZER002 a_zero_offset_is_not_reported_as_radial_scale: |log| log.run.joints.zero_offsets = zero_offset(2, 0.6)
        => OnlyOtherFinding("ZER001");
    ZER002 a_tool_offset_is_not_reported_as_radial_scale: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool_offset()
        => OnlyOtherFinding("FRM003");
    ZER002 millimetres_are_not_reported_as_radial_scale: |log| log.run.pose.is_in_millimetres = true
        => OnlyOtherFinding("ORD008");
    ZER002 nominal_kinematics_are_not_reported_as_radial_scale: |log| crate::checks::mdl::add_link_deviations(&mut log.run)
        => OtherFindingAndInconclusive("MDL001", "calibrat");
    ZER002 radial_scale_is_not_observable_at_rest: |log| log.run.motion = Motion::AtRest
        => Inconclusive("reach far out");
    ZER002 no_pose_stream_for_radial_scale: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");
}

/// A zero offset of one joint, in degrees.
pub fn zero_offset(joint: usize, degrees: f64) -> Vec<f64> {
    let mut offsets = vec![0.0; joint];
    offsets.push(degrees.to_radians());
    offsets
}

/// Gives the arm realistic link deviations: one link is rotated by 0.37°, the others slightly, without zero
/// offsets.
fn add_large_link_deviation(run: &mut Scenario) {
    move_joint_origin(run, "shoulder_lift_joint", [0.1e-3, 0.0, 0.0, -0.5e-3, 0.0, 0.0]);
    move_joint_origin(run, "elbow_joint", [-0.15e-3, 0.0, 0.0, 0.3e-3, 0.7e-3, 0.0]);
    move_joint_origin(run, "wrist_1_joint", [-0.1e-3, 0.7e-3, 0.9e-3, -6.4e-3, -1.5e-3, 0.0]);
    move_joint_origin(run, "wrist_2_joint", [0.0, 0.2e-3, 0.1e-3, -1.9e-3, 0.0, 0.0]);
    move_joint_origin(run, "wrist_3_joint", [0.15e-3, -0.1e-3, 0.1e-3, 1.5e-3, 0.0, 0.0]);
}

pub fn mount_on_rail(run: &mut Scenario) {
    let rail = r#"  <link name="rail"/>
  <joint name="rail_joint" type="prismatic">
    <parent link="rail"/>
    <child link="base_link"/>
    <axis xyz="1 0 0"/>
    <limit effort="0" lower="-1" upper="1" velocity="1"/>
  </joint>
</robot>"#;
    let text = urdf_text(&run.robot).replace("</robot>", rail);
    run.robot = Robot::from_urdf(&text, "a UR5e on a rail").expect("a robot");
    run.base = "rail".to_owned();
    run.pose.frame_id = "rail".to_owned();
    run.home.insert(0, 0.0);
}

/// The alternatives listed by a finding on this joint.
fn confounders_of(joint: usize, name: &str) -> Vec<(&'static str, f64)> {
    let report =
        Log::modified(|log| log.run.joints.zero_offsets = zero_offset(joint, 0.6)).report();
    let others = single_finding(&report, "ZER001", name).evidence.indistinguishable.iter();
    let degrees = |value: f64| (value.to_degrees() * 100.0).round() / 100.0;
    others
        .map(|other| {
            let value = other.estimate.as_ref().and_then(|estimate| estimate.value());
            (other.code, degrees(value.expect("a value")).abs())
        })
        .collect()
}

#[test]
fn zero_offsets_of_the_outer_joints_list_frames_as_confounders() {
    assert_eq!(confounders_of(0, "shoulder_pan_joint"), [("FRM002", 0.6)]);
    assert_eq!(confounders_of(2, "elbow_joint"), []);
    assert_eq!(confounders_of(5, "wrist_3_joint"), [("FRM003", 0.6)]);
}

#[test]
fn a_zero_offset_is_found_despite_one_large_link_deviation() {
    for (joint, name, degrees) in [(2, "elbow_joint", 0.4), (3, "wrist_1_joint", -0.4)] {
        let report = Log::modified(|log| {
            add_large_link_deviation(&mut log.run);
            log.run.joints.zero_offsets = zero_offset(joint, degrees);
        })
        .report();
        let zeros = report.findings.iter().filter(|found| found.code == "ZER001");
        assert_eq!(zeros.count(), 1);
        let amount = single_finding(&report, "ZER001", name).estimate.as_ref().expect("an amount");
        let value = amount.value().expect("a number").to_degrees();
        let half = half_width(amount).expect("an interval").to_degrees();
        assert!((value - degrees).abs() < half.min(0.03) && half < 0.15, "{value} ± {half}");
    }
}

#[test]
fn tf_that_inherits_a_zero_offset_is_listed_in_the_finding() {
    let report = Log::modified(|log| log.run.joints.zero_offsets = zero_offset(2, 0.6)).report();
    let finding = single_finding(&report, "ZER001", "elbow_joint");
    assert_eq!(finding.evidence.more["inherited_by"], serde_json::json!(["/tf"]));
    // 0.6° at the elbow move forearm and wrist, which extend up to 0.49 m.
    let effect_m = finding.evidence.effect_m.expect("an effect");
    assert!((0.003..0.006).contains(&effect_m), "{effect_m}");
}

#[test]
fn sag_over_a_small_range_is_not_reported_as_scale() {
    let report = Log::modified(|log| {
        set_compliance(log, &[(1, SynthComplianceKind::Sag, 1.2)]);
        log.run.motion = Motion::Task(Task::Picking);
    })
    .report();
    single_finding(&report, "ZER003", "shoulder_lift_joint");
    let text = crate::checks::case::summary(&report.findings);
    assert!(report.findings.iter().all(|finding| finding.code != "ORD009"), "{text}");
}

/// They turn the poses alike, whatever the links.
#[test]
fn a_zero_of_the_first_joint_lists_the_base_although_links_deviate() {
    let report = Log::modified(|log| {
        crate::checks::mdl::add_link_deviations_times(&mut log.run, 0.2);
        log.run.joints.zero_offsets = zero_offset(0, 8.0);
    })
    .report();
    let finding = single_finding(&report, "ZER001", "shoulder_pan_joint");
    let others: Vec<&str> =
        finding.evidence.indistinguishable.iter().map(|other| other.code).collect();
    assert_eq!(others, ["FRM002"]);
}
