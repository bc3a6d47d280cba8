//! The catalogue arms.

use poseaudit::geometry::{Pose, angle_between, pose, rotation_from_rpy, rotation_from_xyzw};
use poseaudit::robot::catalogue;
use serde::Deserialize;

use super::{chain, default_chain, urdf};

/// FK of the catalogue's arms by other programs and files; each group has its source and tolerance.
#[derive(Deserialize)]
struct CheckGroup {
    robot: String,
    source: String,
    base: String,
    tip: String,
    tolerance_m: Option<f64>,
    tolerance_rad: Option<f64>,
    rows: Vec<CheckRow>,
}

#[derive(Deserialize)]
struct CheckRow {
    q: Vec<f64>,
    position_m: [f64; 3],
    quaternion_xyzw: Option<[f64; 4]>,
    rpy_rad: Option<[f64; 3]>,
}

impl CheckRow {
    fn base_from_tip(&self) -> Pose {
        let of_quaternion = |xyzw| rotation_from_xyzw(xyzw).unwrap();
        let rotation = self.quaternion_xyzw.map(of_quaternion);
        pose(self.position_m, rotation.unwrap_or_else(|| rotation_from_rpy(self.rpy_rad.unwrap())))
    }
}

fn check_groups() -> Vec<CheckGroup> {
    serde_json::from_str(include_str!("../../fixtures/check_values.json")).unwrap()
}

#[test]
fn forward_kinematics_agree_with_other_programs_for_every_arm() {
    let groups = check_groups();
    for CheckGroup { robot, source, base, tip, tolerance_m, tolerance_rad, rows } in &groups {
        let chain = chain(catalogue::find(robot).unwrap(), base, tip);
        for row in rows {
            let (found, expected) = (chain.forward(&row.q), row.base_from_tip());
            let distance_m = (found.translation.vector - expected.translation.vector).norm();
            let angle_rad = angle_between(&found.rotation, &expected.rotation);
            let near = tolerance_m.is_none_or(|most| distance_m <= most)
                && tolerance_rad.is_none_or(|most| angle_rad <= most);
            assert!(near, "{robot} against {source}: {distance_m:e} m and {angle_rad:e} rad off");
        }
    }
    let unchecked: Vec<_> = catalogue::names()
        .filter(|name| !groups.iter().any(|group| group.robot == *name))
        .collect();
    assert!(unchecked.is_empty(), "without check values: {unchecked:?}");
}

#[test]
fn every_arm_names_its_source_and_its_controller_frames() {
    for robot in catalogue::entries() {
        let provenance = robot.provenance.as_ref().unwrap();
        assert!(provenance.source.contains('@'), "{}: {}", robot.name, provenance.source);
        assert!(!provenance.licence.is_empty(), "{}", robot.name);
        let frames = [&robot.controller_base, &robot.controller_tip];
        assert!(frames.into_iter().all(Option::is_some), "{}", robot.name);
        assert!(default_chain(robot).dof() >= 5, "{}", robot.name);
    }
}

#[test]
fn catalogue_names_and_aliases_are_unique() {
    let mut names: Vec<&str> = catalogue::names().collect();
    names.extend(catalogue::entries().flat_map(|robot| &robot.aliases).map(String::as_str));
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count);
}

#[test]
fn arms_are_found_by_name_alias_and_loose_spelling() {
    let name_of = |name| catalogue::find(name).map(|robot| robot.name.as_str());
    assert_eq!(name_of("panda"), Some("franka_fer"));
    assert_eq!(name_of("UR5e"), Some("ur5e"));
    assert_eq!(name_of("KUKA-LBR iiwa7"), Some("kuka_lbr_iiwa7"));
    assert_eq!(name_of("ur6"), None);
    assert!(catalogue::nearest_names("ur6").contains(&"ur5"));
}

#[test]
fn joint_names_of_a_log_find_the_arm() {
    let ur = [
        "elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint", "wrist_1_joint",
        "wrist_2_joint", "wrist_3_joint",
    ];
    let candidates = catalogue::candidates_for(&ur);
    assert_eq!(candidates[0].names.matched, 6);
    assert!(candidates[0].names.is_complete());
    let complete: Vec<&str> = candidates.iter().map(|c| c.robot().name.as_str()).collect();
    assert_eq!(
        complete,
        ["ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur15", "ur16e", "ur20", "ur30"]
    );
}

#[test]
fn a_log_with_another_prefix_finds_the_arm_under_its_own_names() {
    for (prefix, arm) in [("panda_", "franka_fer"), ("left/fr3_", "franka_fr3")] {
        let mut logged: Vec<String> = (1..=7).map(|i| format!("{prefix}joint{i}")).collect();
        logged.push("gripper_finger".to_owned());
        let best = &catalogue::candidates_for(&logged)[0];
        assert_eq!(best.robot().name, arm);
        let renamed = best.renamed().unwrap();
        let base = renamed.default_base.clone().unwrap();
        let tip = renamed.default_tip.clone().unwrap();
        assert!(base.starts_with(prefix), "{base}");
        assert_eq!(chain(&renamed, &base, &tip).joint_names(), &logged[..7]);
    }
}

#[test]
fn two_equal_arms_in_a_log_are_two_candidates() {
    let robot = catalogue::find("franka_fr3").unwrap();
    let logged: Vec<String> = ["left_", "right_"]
        .iter()
        .flat_map(|side| (1..=7).map(move |i| format!("{side}fr3_joint{i}")))
        .collect();
    let candidates = catalogue::candidates_for(&logged);
    for (candidate, base) in candidates.iter().zip(["left_fr3_link0", "right_fr3_link0"]) {
        assert_eq!(candidate.robot(), robot);
        assert_eq!(candidate.names.logged_name("fr3_link0"), base);
    }
}

#[test]
fn six_logged_joints_do_not_match_an_arm_with_seven() {
    let six: Vec<String> = (1..=6).map(|i| format!("joint_{i}")).collect();
    let seven: Vec<String> = (1..=7).map(|i| format!("joint_{i}")).collect();
    assert!(catalogue::candidates_for(&six)[0].names.is_complete());
    assert_eq!(catalogue::candidates_for(&seven)[0].robot().name, "kinova_gen3_7dof");
    assert!(catalogue::candidates_for(&["left_wheel", "right_wheel"]).is_empty());
}

#[test]
fn a_prefix_that_makes_two_names_equal_is_refused() {
    let robot = urdf(
        "<link name='a_x'/><link name='x'/>
         <joint name='j' type='fixed'><parent link='a_x'/><child link='x'/></joint>",
    );
    assert_eq!(robot.with_prefix_replaced("a_", ""), None);
    let renamed = robot.with_prefix_replaced("a_", "b_").unwrap();
    assert!(renamed.link("b_x").is_some() && renamed.link("a_x").is_none());
}

#[test]
fn an_arm_is_found_by_a_model_name_that_only_one_has() {
    for (short, name) in [
        ("fr3", Some("franka_fr3")),
        ("xarm6", Some("ufactory_xarm6")),
        ("iiwa14", Some("kuka_lbr_iiwa14")),
        ("IRB120", Some("abb_irb120_3_58")),
        ("gen3", Some("kinova_gen3_7dof")),
        ("lrmate200id", Some("fanuc_lrmate200id")),
        ("CRX10iA", Some("fanuc_crx10ia")),
        ("rizon4", Some("flexiv_rizon4")),
        ("GoFa", Some("abb_crb15000_5_95")),
        ("kr6-r900-2", Some("kuka_kr6_r900_2")),
        // Renamed by the manufacturer, with the same kinematics.
        ("ur7e", Some("ur5e")),
        ("ur12e", Some("ur10e")),
        // Several arms, or not a model name.
        ("irb1200", None),
        ("kr6", None),
        ("tm5", None),
        ("700", None),
        ("left", None),
        ("", None),
    ] {
        let found = catalogue::find(short).map(|robot| robot.name.as_str());
        assert_eq!(found, name, "{short}");
    }
}
