//! ZER: zero offsets.

use poseaudit::robot::Robot;
use poseaudit::synth::{Giving, Motion, POSE, Scenario, urdf_text};

use crate::checks::case::On::{Joint, Topic};
use crate::checks::case::What::{Amount, Degrees};
use crate::checks::case::{Expected, Log, cases, error, half_width, the, warning};
use crate::checks::mdl::alter;
use crate::checks::mot::gives;
use Expected::{BlamedOn, LeftOpenBy, Skipped, Sound, Undecided};

cases! {
    ZER001 an_elbow: |log| log.run.joints.zero_offsets = zero(2, 0.6)
        => error(Joint("elbow_joint"), Degrees(0.6, 0.02));
    ZER001 a_shoulder_below: |log| log.run.joints.zero_offsets = zero(1, -0.3)
        => warning(Joint("shoulder_lift_joint"), Degrees(-0.3, 0.02));
    ZER001 a_wrist: |log| log.run.joints.zero_offsets = zero(3, 1.0)
        => error(Joint("wrist_1_joint"), Degrees(1.0, 0.02));
    ZER001 the_first_joint: |log| log.run.joints.zero_offsets = zero(0, 0.4)
        => warning(Joint("shoulder_pan_joint"), Degrees(0.4, 0.02));
    ZER001 the_last_joint: |log| log.run.joints.zero_offsets = zero(5, -0.8)
        => error(Joint("wrist_3_joint"), Degrees(-0.8, 0.02));
    ZER001 an_elbow_a_third_of_a_turn_off: |log| log.run.joints.zero_offsets = zero(2, 120.0)
        => error(Joint("elbow_joint"), Degrees(120.0, 0.02));
    ZER001 a_wrist_half_a_turn_off: |log| log.run.joints.zero_offsets = zero(3, -178.0)
        => error(Joint("wrist_1_joint"), Degrees(-178.0, 0.02));
    ZER001 the_first_joint_by_no_round_angle: |log| log.run.joints.zero_offsets = zero(0, 50.0)
        => error(Joint("shoulder_pan_joint"), Degrees(50.0, 0.02));
    ZER001 a_rail: |log| {
        on_a_rail(&mut log.run);
        log.run.joints.zero_offsets = vec![0.003];
    } => error(Joint("rail_joint"), Amount(0.003, 0.05e-3));

    ZER001 a_hundredth_of_a_degree_is_sound: |log| log.run.joints.zero_offsets = zero(2, 0.01)
        => Sound;
    ZER001 an_arm_on_a_rail_is_sound: |log| on_a_rail(&mut log.run) => Sound;

    ZER001 a_late_pose_is_no_zero: |log| log.run.pose.timing.latency_s = 0.022
        => BlamedOn("LAT001");
    ZER001 a_turned_base_is_no_zero: |log| {
        log.run.pose.reference_from_stream = crate::checks::frm::half_turn();
    } => BlamedOn("FRM002");
    ZER001 a_tool_is_no_zero: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool()
        => BlamedOn("FRM003");
    ZER001 growth_with_reach_is_no_zero: |log| log.run.pose.growth = 0.01 => BlamedOn("ZER002");
    ZER001 nominal_kinematics_are_no_zero: |log| crate::checks::mdl::calibrate(&mut log.run)
        => LeftOpenBy("MDL001", "calibrat");
    ZER001 one_crooked_link_is_no_zero: |log| crooked(&mut log.run)
        => LeftOpenBy("MDL001", "calibrat");
    ZER001 a_drifting_imu_is_no_zero: |log| log.run.imu.yaw_drift_rad_s = 1e-3
        => BlamedOn("YAW001");

    ZER001 no_pose: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");
    ZER001 an_arm_that_rests: |log| log.run.motion = Motion::AtRest => Undecided("");
    ZER001 one_joint_that_moves: |log| log.run.motion = Motion::OneJoint(1) => Undecided("");

    ZER003 a_shoulder_that_sags: |log| gives(log, &[(1, Giving::Sag, 0.6)])
        => error(Joint("shoulder_lift_joint"), Degrees(0.6, 0.06));
    ZER003 an_elbow_that_sags_a_little: |log| gives(log, &[(2, Giving::Sag, 0.25)])
        => warning(Joint("elbow_joint"), Degrees(0.25, 0.04));
    ZER003 sag_of_healthy_gears_is_sound: |log| gives(log, &[(1, Giving::Sag, 0.03)]) => Sound;
    ZER003 a_joint_zero_is_no_sag: |log| {
        gives(log, &[]);
        log.run.joints.zero_offsets = zero(1, 0.6);
    } => BlamedOn("ZER001");
    ZER003 play_is_no_sag: |log| gives(log, &[(1, Giving::Play, 1.0)]) => BlamedOn("MOT006");
    ZER003 nominal_kinematics_are_no_sag: |log| crate::checks::mdl::calibrate(&mut log.run)
        => BlamedOn("MDL001");
    ZER003 an_arm_at_rest_shows_no_sag: |log| log.run.motion = Motion::AtRest => Undecided("barely moves");
    ZER003 no_pose_that_could_sag: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");

    ZER001 sag_is_no_zero: |log| gives(log, &[(1, Giving::Sag, 0.6)]) => BlamedOn("ZER003");

    ZER002 positions_too_far_out: |log| log.run.pose.growth = 0.01
        => error(Topic(POSE), Amount(0.01, 0.1e-3));
    ZER002 positions_too_near: |log| log.run.pose.growth = -0.002
        => warning(Topic(POSE), Amount(-0.002, 0.1e-3));
    ZER002 a_ten_thousandth_is_sound: |log| log.run.pose.growth = 1e-4 => Sound;
    ZER002 a_joint_zero_is_no_growth: |log| log.run.joints.zero_offsets = zero(2, 0.6)
        => BlamedOn("ZER001");
    ZER002 a_tool_is_no_growth: |log| log.run.pose.tip_from_stream = crate::checks::frm::tool()
        => BlamedOn("FRM003");
    ZER002 millimetres_are_no_growth: |log| log.run.pose.in_millimetres = true
        => BlamedOn("ORD008");
    ZER002 nominal_kinematics_are_no_growth: |log| crate::checks::mdl::calibrate(&mut log.run)
        => LeftOpenBy("MDL001", "calibrat");
    ZER002 at_rest_a_shift_is_as_good_as_growth: |log| log.run.motion = Motion::AtRest
        => Undecided("reach far out");
    ZER002 no_pose_to_grow: |log| log.run.pose.timing.rate_hz = 0.0 => Skipped("no pose stream");
}

/// A zero offset of one joint, in degrees.
pub fn zero(joint: usize, degrees: f64) -> Vec<f64> {
    let mut offsets = vec![0.0; joint];
    offsets.push(degrees.to_radians());
    offsets
}

/// Gives the arm realistic link deviations: one link is rotated by 0.37°, the others slightly, without zero
/// offsets.
fn crooked(run: &mut Scenario) {
    alter(run, "shoulder_lift_joint", [0.1e-3, 0.0, 0.0, -0.5e-3, 0.0, 0.0]);
    alter(run, "elbow_joint", [-0.15e-3, 0.0, 0.0, 0.3e-3, 0.7e-3, 0.0]);
    alter(run, "wrist_1_joint", [-0.1e-3, 0.7e-3, 0.9e-3, -6.4e-3, -1.5e-3, 0.0]);
    alter(run, "wrist_2_joint", [0.0, 0.2e-3, 0.1e-3, -1.9e-3, 0.0, 0.0]);
    alter(run, "wrist_3_joint", [0.15e-3, -0.1e-3, 0.1e-3, 1.5e-3, 0.0, 0.0]);
}

pub fn on_a_rail(run: &mut Scenario) {
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
fn indistinguishable(joint: usize, name: &str) -> Vec<(&'static str, f64)> {
    let report = Log::with(|log| log.run.joints.zero_offsets = zero(joint, 0.6)).audited();
    let others = the(&report, "ZER001", name).evidence.indistinguishable.iter();
    let degrees = |value: f64| (value.to_degrees() * 100.0).round() / 100.0;
    others
        .map(|other| {
            let value = other.estimate.as_ref().and_then(|estimate| estimate.value());
            (other.code, degrees(value.expect("a value")).abs())
        })
        .collect()
}

#[test]
fn the_ends_of_the_chain_list_the_frames_that_do_the_same() {
    assert_eq!(indistinguishable(0, "shoulder_pan_joint"), [("FRM002", 0.6)]);
    assert_eq!(indistinguishable(2, "elbow_joint"), []);
    assert_eq!(indistinguishable(5, "wrist_3_joint"), [("FRM003", 0.6)]);
}

#[test]
fn a_zero_stands_out_beside_one_crooked_link() {
    for (joint, name, degrees) in [(2, "elbow_joint", 0.4), (3, "wrist_1_joint", -0.4)] {
        let report = Log::with(|log| {
            crooked(&mut log.run);
            log.run.joints.zero_offsets = zero(joint, degrees);
        })
        .audited();
        let zeros = report.findings.iter().filter(|found| found.code == "ZER001");
        assert_eq!(zeros.count(), 1);
        let amount = the(&report, "ZER001", name).estimate.as_ref().expect("an amount");
        let value = amount.value().expect("a number").to_degrees();
        let half = half_width(amount).expect("an interval").to_degrees();
        assert!((value - degrees).abs() < half.min(0.03) && half < 0.15, "{value} ± {half}");
    }
}

#[test]
fn what_the_state_publisher_inherits_is_said_with_the_joint() {
    let report = Log::with(|log| log.run.joints.zero_offsets = zero(2, 0.6)).audited();
    let finding = the(&report, "ZER001", "elbow_joint");
    assert_eq!(finding.evidence.more["inherited_by"], serde_json::json!(["/tf"]));
    // 0.6° at the elbow move forearm and wrist, which extend up to 0.49 m.
    let effect_m = finding.evidence.effect_m.expect("an effect");
    assert!((0.003..0.006).contains(&effect_m), "{effect_m}");
}
