//! The robot room: readers, catalogue, forward kinematics.

use std::f64::consts::{FRAC_PI_2, PI};

use poseaudit::geometry::{
    Pose, Rotation, angle_between, pose, rotation_from_rpy, rotation_from_xyzw,
    rotvec_from_rotation, xyz_of,
};
use poseaudit::robot::{Chain, ChainError, JointKind, Robot, catalogue};
use serde::Deserialize;

/// FK of other programs and files for the catalogue's arms; each group says whose, and how near.
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
    serde_json::from_str(include_str!("../fixtures/check_values.json")).unwrap()
}

fn chain(robot: &Robot, base: &str, tip: &str) -> Chain {
    robot
        .chain(robot.link_or_nearest(base).unwrap(), robot.link_or_nearest(tip).unwrap())
        .unwrap_or_else(|error| panic!("{}: {error}", robot.name))
}

fn default_chain(robot: &Robot) -> Chain {
    chain(robot, robot.default_base.as_deref().unwrap(), robot.default_tip.as_deref().unwrap())
}

fn urdf(body: &str) -> Robot {
    Robot::from_urdf(&format!("<robot name=\"test\">\n{body}\n</robot>"), "test.urdf").unwrap()
}

/// Positions in ±2, from a linear congruential generator: the tests need no random crate.
fn positions(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 4.0 - 2.0
    };
    (0..count).map(|_| next()).collect()
}

#[track_caller]
fn assert_near(found: &Pose, expected: &Pose, tolerance: f64, what: &str) {
    let distance_m = (found.translation.vector - expected.translation.vector).norm();
    let angle_rad = angle_between(&found.rotation, &expected.rotation);
    assert!(
        distance_m <= tolerance && angle_rad <= tolerance,
        "{what}: {distance_m:e} m and {angle_rad:e} rad off"
    );
}

// ── catalogue ──────────────────────────────────────────────────────────────────────────────────

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
    names.extend(catalogue::entries().iter().flat_map(|robot| &robot.aliases).map(String::as_str));
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
        "elbow_joint",
        "shoulder_lift_joint",
        "shoulder_pan_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ];
    let candidates = catalogue::candidates_for(&ur);
    assert_eq!(candidates[0].names.matched, 6);
    assert!(candidates[0].names.is_complete());
    let complete: Vec<&str> = candidates.iter().map(|c| c.robot.name.as_str()).collect();
    assert_eq!(complete, ["ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "ur30"]);
}

#[test]
fn a_log_with_another_prefix_finds_the_arm_under_its_own_names() {
    for (prefix, arm) in [("panda_", "franka_fer"), ("left/fr3_", "franka_fr3")] {
        let mut logged: Vec<String> = (1..=7).map(|i| format!("{prefix}joint{i}")).collect();
        logged.push("gripper_finger".to_owned());
        let best = &catalogue::candidates_for(&logged)[0];
        assert_eq!(best.robot.name, arm);
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
        assert_eq!(candidate.robot, robot);
        assert_eq!(candidate.names.logged_name("fr3_link0"), base);
    }
}

#[test]
fn six_joints_of_a_log_do_not_prefer_an_arm_of_seven() {
    let six: Vec<String> = (1..=6).map(|i| format!("joint_{i}")).collect();
    let seven: Vec<String> = (1..=7).map(|i| format!("joint_{i}")).collect();
    assert!(catalogue::candidates_for(&six)[0].names.is_complete());
    assert_eq!(catalogue::candidates_for(&seven)[0].robot.name, "kinova_gen3_7dof");
    assert!(catalogue::candidates_for(&["left_wheel", "right_wheel"]).is_empty());
}

#[test]
fn a_prefix_that_would_make_two_names_one_is_refused() {
    let robot = urdf(
        "<link name='a_x'/><link name='x'/>
         <joint name='j' type='fixed'><parent link='a_x'/><child link='x'/></joint>",
    );
    assert_eq!(robot.with_prefix_replaced("a_", ""), None);
    let renamed = robot.with_prefix_replaced("a_", "b_").unwrap();
    assert!(renamed.link("b_x").is_some() && renamed.link("a_x").is_none());
}

// ── chains ─────────────────────────────────────────────────────────────────────────────────────

/// A slide, a turn about a skew axis, a follower of the slide's coordinate and of the turn's.
const GANTRY: &str = "
    <link name='rail'/><link name='carriage'/><link name='arm'/><link name='hand'/>
    <link name='finger'/><link name='tool'/><link name='camera'/>
    <joint name='slide' type='prismatic'><parent link='rail'/><child link='carriage'/>
      <origin xyz='0 0 0.4' rpy='0.1 0 0.2'/><axis xyz='1 0 0'/><limit lower='-1.5' upper='1.5'/></joint>
    <joint name='turn' type='revolute'><parent link='carriage'/><child link='arm'/>
      <origin xyz='0.1 0 0.3'/><axis xyz='0 1 1'/></joint>
    <joint name='swing' type='continuous'><parent link='arm'/><child link='hand'/>
      <origin xyz='0.5 0 0' rpy='0 1.57 0'/><axis xyz='0 0 -1'/>
      <mimic joint='turn' multiplier='-0.5' offset='0.3'/></joint>
    <joint name='reach' type='prismatic'><parent link='hand'/><child link='finger'/>
      <axis xyz='0 1 0'/><mimic joint='slide' multiplier='2'/></joint>
    <joint name='fix' type='fixed'><parent link='finger'/><child link='tool'/>
      <origin xyz='0 0 0.1'/><axis xyz='0 0 0'/></joint>
    <joint name='eye' type='fixed'><parent link='rail'/><child link='camera'/>
      <origin xyz='1 2 3' rpy='0.3 0.2 0.1'/></joint>";

#[test]
fn the_jacobian_is_the_derivative_of_the_pose() {
    let gantry = urdf(GANTRY);
    let mut chains: Vec<Chain> = catalogue::entries().iter().map(default_chain).collect();
    chains.push(chain(&gantry, "camera", "tool"));
    chains.push(chain(&gantry, "tool", "rail"));
    for chain in &chains {
        let q = positions(chain.dof(), 7);
        let mut jacobian = vec![[0.0; 6]; chain.dof()];
        let pose = chain.forward_with_jacobian(&q, &mut jacobian);
        assert_near(&pose, &chain.forward(&q), 1e-15, chain.tip_name());
        for (joint, column) in jacobian.iter().enumerate() {
            let expected = central_difference(chain, &q, joint);
            for (found, expected) in column.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-8, "{joint}: {column:?}, not {expected:?}");
            }
        }
    }
}

/// The twist of the tip in base by a central difference of joint `joint`.
fn central_difference(chain: &Chain, q: &[f64], joint: usize) -> [f64; 6] {
    const STEP: f64 = 1e-6;
    let moved = |step: f64| {
        let mut q = q.to_vec();
        q[joint] += step;
        chain.forward(&q)
    };
    let (before, after) = (moved(-STEP), moved(STEP));
    let linear = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
    let turn: Rotation = after.rotation * before.rotation.inverse();
    let angular = rotvec_from_rotation(&turn) / (2.0 * STEP);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

#[test]
fn a_chain_walked_backwards_is_the_inverse() {
    for robot in catalogue::entries() {
        let there = default_chain(robot);
        let back = chain(robot, there.tip_name(), there.base_name());
        let q = positions(there.dof(), 3);
        let q_back: Vec<f64> = q.iter().rev().copied().collect();
        let names_back: Vec<&String> = there.joint_names().iter().rev().collect();
        assert_eq!(back.joint_names().iter().collect::<Vec<_>>(), names_back);
        assert_near(&back.forward(&q_back), &there.forward(&q).inverse(), 1e-14, &robot.name);
    }
}

#[test]
fn a_chain_through_a_link_on_the_way_is_the_product_of_its_parts() {
    let robot = catalogue::find("ur5e").unwrap();
    let q = positions(6, 11);
    let base_from_forearm = chain(robot, "base", "forearm_link").forward(&q[..3]);
    let forearm_from_tool = chain(robot, "forearm_link", "tool0").forward(&q[3..]);
    let base_from_tool = chain(robot, "base", "tool0").forward(&q);
    assert_near(&(base_from_forearm * forearm_from_tool), &base_from_tool, 1e-14, "ur5e");
}

#[test]
fn a_base_on_a_side_branch_is_reached_over_fixed_joints() {
    let robot = catalogue::find("ur5e").unwrap();
    let [base, base_link] = ["base", "base_link"].map(|name| robot.link(name).unwrap());
    let base_from_base_link = robot.fixed_transform(base, base_link).unwrap();
    assert_near(
        &base_from_base_link,
        &pose([0.0; 3], rotation_from_rpy([0.0, 0.0, PI])),
        1e-15,
        "",
    );
    let q = positions(6, 5);
    let direct = chain(robot, "base", "tool0").forward(&q);
    let product = base_from_base_link * chain(robot, "base_link", "tool0").forward(&q);
    assert_near(&direct, &product, 1e-14, "ur5e");
    assert_eq!(robot.fixed_transform(base, robot.link("tool0").unwrap()), None);
    assert_eq!(robot.fixed_transform(base, base), Some(Pose::identity()));
}

#[test]
fn sliding_and_mimicking_joints_follow_their_coordinates() {
    let robot = urdf(GANTRY);
    let chain = chain(&robot, "rail", "tool");
    assert_eq!(chain.joint_names(), ["slide", "turn"]);
    assert_eq!(chain.joint_kinds(), [JointKind::Prismatic, JointKind::Revolute]);
    assert_eq!(chain.limits()[0].upper, Some(1.5));
    let (slide_m, turn_rad) = (0.7, -1.1);
    let part = |xyz: [f64; 3], rpy: [f64; 3]| pose(xyz, rotation_from_rpy(rpy));
    let about = |axis: [f64; 3], angle: f64| {
        let rotvec = nalgebra::Vector3::from(axis).normalize() * angle;
        pose([0.0; 3], poseaudit::geometry::rotation_from_rotvec(rotvec))
    };
    let expected = part([0.0, 0.0, 0.4], [0.1, 0.0, 0.2])
        * part([slide_m, 0.0, 0.0], [0.0; 3])
        * part([0.1, 0.0, 0.3], [0.0; 3])
        * about([0.0, 1.0, 1.0], turn_rad)
        * part([0.5, 0.0, 0.0], [0.0, 1.57, 0.0])
        * about([0.0, 0.0, -1.0], -0.5 * turn_rad + 0.3)
        * part([0.0, 2.0 * slide_m, 0.0], [0.0; 3])
        * part([0.0, 0.0, 0.1], [0.0; 3]);
    assert_near(&chain.forward(&[slide_m, turn_rad]), &expected, 1e-14, "gantry");
}

#[test]
fn a_follower_alone_in_the_path_takes_its_masters_position() {
    let robot = urdf(GANTRY);
    let chain = chain(&robot, "arm", "hand");
    assert_eq!(chain.joint_names(), ["turn"]);
    let turned = chain.forward(&[0.4]).rotation.inverse() * chain.forward(&[0.0]).rotation;
    assert!((turned.angle() - 0.2).abs() < 1e-15);
}

#[test]
fn joint_frames_are_the_child_links_in_either_direction() {
    let robot = catalogue::find("kinova_gen3_7dof").unwrap();
    let (base, tip) = ("base_link", "end_effector_link");
    let q = positions(7, 13);
    let mut frames = Vec::new();
    chain(robot, base, tip).joint_frames(&q, &mut frames);
    let mut frames_from_tip = Vec::new();
    let q_back: Vec<f64> = q.iter().rev().copied().collect();
    chain(robot, tip, base).joint_frames(&q_back, &mut frames_from_tip);
    let base_from_tip = chain(robot, base, tip).forward(&q);
    for (index, frame) in frames.iter().enumerate() {
        let child =
            robot.joint(chain(robot, base, tip).joint_names()[index].as_str()).unwrap().child;
        let expected = chain(robot, base, robot.link_name(child)).forward(&q[..=index]);
        assert_near(frame, &expected, 1e-14, "from the base");
        assert_near(
            &(base_from_tip * frames_from_tip[6 - index]),
            &expected,
            1e-14,
            "from the tip",
        );
    }
}

#[test]
fn a_batch_is_the_same_as_one_by_one() {
    for robot in catalogue::entries() {
        let chain = default_chain(robot);
        let rows = positions(chain.dof() * 20, 17);
        let mut poses = vec![Pose::identity()];
        chain.forward_batch(&rows, &mut poses);
        let single: Vec<Pose> = rows.chunks(chain.dof()).map(|q| chain.forward(q)).collect();
        assert_eq!(poses, single, "{}", robot.name);
    }
}

#[test]
fn the_order_of_joints_in_the_file_does_not_matter() {
    let mut joints: Vec<&str> = GANTRY.split_inclusive("</joint>").collect();
    let links = joints[0].split_at(joints[0].find("<joint").unwrap()).0;
    joints[0] = &joints[0][links.len()..];
    joints.reverse();
    let reversed = urdf(&format!("{}{links}", joints.concat()));
    let (a, b) = (chain(&urdf(GANTRY), "camera", "tool"), chain(&reversed, "camera", "tool"));
    assert_eq!(a, b);
}

#[test]
fn the_reach_of_an_arm_stretched_out_is_found() {
    for (arm, base, tip, reach_m) in [
        ("ur5e", "shoulder_link", "wrist_1_link", (0.425_f64 + 0.3922).hypot(0.1333)),
        ("kuka_lbr_iiwa7", "lbr_link_0", "lbr_link_ee", 0.34 + 0.4 + 0.4 + 0.126),
    ] {
        let found_m = chain(catalogue::find(arm).unwrap(), base, tip).max_reach_m();
        assert!(found_m <= reach_m + 1e-9 && found_m > 0.99 * reach_m, "{arm}: {found_m}");
    }
    let slide = chain(&urdf(GANTRY), "rail", "carriage");
    assert!((slide.max_reach_m() - slide.forward(&[1.5]).translation.vector.norm()).abs() < 1e-12);
}

#[test]
fn what_makes_no_chain_says_what_to_do() {
    let robot = urdf(
        "<link name='a'/><link name='b'/><link name='c'/><link name='d'/><link name='e'/>
         <joint name='f' type='fixed'><parent link='a'/><child link='b'/></joint>
         <joint name='free' type='floating'><parent link='b'/><child link='c'/></joint>
         <joint name='m' type='revolute'><parent link='a'/><child link='d'/><mimic joint='nobody'/></joint>
         <joint name='n' type='revolute'><parent link='a'/><child link='e'/><mimic joint='n'/></joint>",
    );
    let error = |base: &str, tip: &str| {
        let link = |name| robot.link(name).unwrap();
        robot.chain(link(base), link(tip)).unwrap_err().to_string()
    };
    assert_eq!(error("a", "a"), "base and tip are the same link 'a'; choose another tip");
    assert!(error("a", "b").starts_with("no joint between 'a' and 'b' can move; choose"));
    assert!(error("a", "c").starts_with("joint 'free' between base and tip is floating; choose"));
    assert!(error("a", "d").starts_with("joint 'm' mimics 'nobody', which is not a joint"));
    assert!(error("a", "e").starts_with("joint 'n' mimics 'n', which leads back to itself"));
}

#[test]
fn a_misspelt_link_is_answered_with_the_nearest() {
    let error = catalogue::find("ur5e").unwrap().link_or_nearest("wrist_3_lnk").unwrap_err();
    let ChainError::UnknownLink { instead, .. } = &error else { panic!("{error}") };
    assert_eq!(instead[0], "wrist_3_link");
    assert!(
        error.to_string().starts_with("robot 'ur5e' has no link 'wrist_3_lnk'; try 'wrist_3_link'")
    );
    let error = catalogue::find("ur5e").unwrap().link_or_nearest("world").unwrap_err().to_string();
    assert_eq!(
        error,
        "robot 'ur5e' has no link 'world'; try 'base_link' or 'tool0' or 'base' or 'ft_frame'"
    );
}

// ── tables ─────────────────────────────────────────────────────────────────────────────────────

#[test]
fn a_dh_table_alone_is_a_robot() {
    let text = "
        units = 'm, rad'
        [dh]
        convention = 'modified'
        rows = [[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]]
        joint_names = ['lift', 'spin']
        joint_types = ['prismatic', 'revolute']
        post_xyz = [0.0, 0.0, 0.9]";
    let robot = Robot::from_text(text, "arm.toml").unwrap();
    let chain = default_chain(&robot);
    assert_eq!((chain.base_name(), chain.tip_name()), ("base", "tip"));
    assert_eq!(chain.joint_names(), ["lift", "spin"]);
    let craig = |a, alpha, theta: f64, d: f64| {
        pose([a, 0.0, 0.0], rotation_from_rpy([alpha, 0.0, 0.0]))
            * pose([0.0, 0.0, d], rotation_from_rpy([0.0, 0.0, theta]))
    };
    // Rx and Dx commute, Rz and Dz too.
    let expected = craig(0.1, 0.3, 0.4, 0.2 + 0.05)
        * craig(0.5, 0.7, 0.8 + 1.0, 0.6)
        * pose([0.0, 0.0, 0.9], Rotation::identity());
    assert_near(&chain.forward(&[0.05, 1.0]), &expected, 1e-15, "modified");
}

#[test]
fn the_two_conventions_differ_where_a_and_alpha_stand() {
    let of = |convention: &str| {
        let text =
            format!("[dh]\nconvention = '{convention}'\nrows = [[1.0, 0.0, {FRAC_PI_2}, 0.0]]");
        default_chain(&Robot::from_toml(&text, "arm.toml").unwrap()).forward(&[FRAC_PI_2])
    };
    let (standard, modified) = (xyz_of(&of("standard")), xyz_of(&of("modified")));
    assert!((standard[1] - 1.0).abs() < 1e-15, "{standard:?}");
    assert!((modified[0] - 1.0).abs() < 1e-15, "{modified:?}");
}

#[test]
fn a_bad_table_is_refused_with_its_line() {
    let fixed = "[[joint]]\nname = 'j'\ntype = 'fixed'\nparent = 'a'\nchild = 'b'\n";
    let cases = [
        ("dof = [", "arm.toml:1: not a robot in TOML: "),
        ("id = 'x'", "arm.toml:1: the file has neither [[joint]] nor [dh]; add one of the two"),
        ("[dh]\nrows = []", "arm.toml:1: not a robot in TOML: missing field `convention`"),
        (
            "[dh]\nconvention = 'craig'\nrows = []",
            "arm.toml:2: not a robot in TOML: unknown variant `craig`, expected `standard` or `modified`",
        ),
        (
            "[dh]\nconvention = 'standard'\nrows = [[0.0, 0.0]]",
            "arm.toml:3: not a robot in TOML: invalid length 2",
        ),
        (
            "[dh]\nconvention = 'standard'\nrows = [[0, 0, 0, nan]]",
            "arm.toml:1: [dh] has a number that is not finite, or beyond 1000000; correct the number",
        ),
        (
            "[dh]\nconvention = 'standard'\njoint_names = ['a']\nrows = []",
            "arm.toml:1: 1 joint_names of [dh] for 0 rows; give one a row",
        ),
        (
            &format!("units = 'mm, deg'\n{fixed}"),
            "arm.toml:1: units are \"mm, deg\", not \"m, rad\"; convert",
        ),
        (
            &format!("{fixed}axes = [0, 0, 1]"),
            "arm.toml:6: not a robot in TOML: unknown field `axes`",
        ),
        (
            &format!("{fixed}xyz = [0, 0, inf]"),
            "arm.toml:1: joint 'j' has a number that is not finite",
        ),
        (&format!("{fixed}{fixed}"), "arm.toml:6: a second joint is named 'j'; rename one of them"),
        (
            &format!("tip = 'c'\n{fixed}"),
            "arm.toml:1: the tip 'c' is not a link of the model; correct the name",
        ),
        (&format!("dof = 1\n{fixed}"), "arm.toml:1: dof = 1, and 0 joints can move; correct dof"),
        (
            &fixed.replace("fixed", "ball"),
            "arm.toml:1: joint 'j': type \"ball\" is unknown; use revolute",
        ),
        (
            &format!("{}axis = [0, 0, 0]", fixed.replace("fixed", "revolute")),
            "arm.toml:1: joint 'j': the axis is zero",
        ),
    ];
    for (text, message) in cases {
        let error = Robot::from_text(text, "arm.toml").unwrap_err().to_string();
        assert!(error.starts_with(message), "{text}\n  gave {error}\n  not  {message}");
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn a_file_that_is_missing_is_named() {
    let error = Robot::from_file(std::path::Path::new("no/such.urdf")).unwrap_err();
    assert_eq!(
        error.to_string(),
        "no/such.urdf: cannot be read as text; check that it exists and is a URDF or a TOML file"
    );
    assert!(std::error::Error::source(&error).is_some());
}

// ── URDF ───────────────────────────────────────────────────────────────────────────────────────

#[test]
fn urdf_defaults_and_slack_are_understood() {
    let robot = urdf(
        "<link name='a'><visual><geometry><mesh filename='$(find x)/y.stl' scale='?'/></geometry></visual></link>
         <link name='b'/><link name='c'/>
         <gazebo><joint name='not a joint'/></gazebo><transmission><joint name='j'/></transmission>
         <joint name='j' type='revolute'><parent link='a'/><child link='b'/><limit upper='inf' effort='x'/></joint>
         <joint name='k' type='continuous'><parent link='b'/><child link='c'/><origin xyz=' 1\t2 3 '/>
           <axis xyz='0 0 -4'/><limit lower='0' upper='0' velocity='2'/></joint>",
    );
    let [j, k] = ["j", "k"].map(|name| robot.joint(name).unwrap());
    assert_eq!((j.axis.x, j.parent_from_joint), (1.0, Pose::identity()));
    assert_eq!((j.limits.lower, j.limits.upper, j.limits.velocity), (None, None, None));
    assert_eq!((k.axis.z, xyz_of(&k.parent_from_joint)), (-1.0, [1.0, 2.0, 3.0]));
    assert_eq!((k.limits.lower, k.limits.upper, k.limits.velocity), (None, None, Some(2.0)));
    assert_eq!(robot.link_name(robot.root()), "a");
    let leaves: Vec<&str> = robot.leaf_links().map(|link| robot.link_name(link)).collect();
    assert_eq!(leaves, ["c"]);
    let below: Vec<&str> =
        robot.child_joints(robot.root()).map(|joint| joint.name.as_str()).collect();
    assert_eq!(below, ["j"]);
}

#[test]
fn an_expanded_xacro_with_a_byte_order_mark_is_read() {
    let text = "\u{feff}<?xml version='1.0'?>\n<!DOCTYPE robot>
        <robot xmlns:xacro='http://www.ros.org/wiki/xacro'><link name='base'/></robot>";
    assert!(Robot::from_text(text, "x").unwrap().link("base").is_some());
    let text = text.replace("robot>\n", "robot [<!ENTITY a 'base'>]>\n");
    let error = Robot::from_text(&text, "x").unwrap_err().to_string();
    assert!(error.contains("document type") && error.contains("--noent"), "{error}");
}

#[test]
fn a_bad_urdf_is_refused_with_its_line() {
    let links = "<link name='a'/><link name='b'/>\n";
    let joint = |inside: &str| {
        format!(
            "{links}<joint name='j' type='revolute'><parent link='a'/><child link='b'/>\n{inside}</joint>"
        )
    };
    let bare = |name: &str, parent: &str, child: &str| {
        format!(
            "<joint name='{name}' type='fixed'><parent link='{parent}'/><child link='{child}'/></joint>\n"
        )
    };
    let cases = [
        (String::new(), "x:1: the model has no link; give the URDF itself"),
        ("<link/>".to_owned(), "x:2: a <link> has no name; add it"),
        (format!("{links}<joint name='j'/>"), "x:3: joint 'j' has no type attribute; add it"),
        (
            format!("{links}<joint name='j' type='ball'/>"),
            "x:3: joint 'j': type \"ball\" is unknown; use",
        ),
        (
            format!("{links}<joint name='j' type='fixed'/>"),
            "x:3: joint 'j' has no <parent link=…>; add it",
        ),
        (
            joint("<origin xyz='1 2'/>"),
            "x:4: joint 'j': xyz=\"1 2\" is not three finite numbers; correct the number",
        ),
        (
            joint("<origin rpy='0 0 nan'/>"),
            "x:4: joint 'j': rpy=\"0 0 nan\" is not three finite numbers",
        ),
        (
            joint("<origin quat_xyzw='0 0 0 0'/>"),
            "x:4: joint 'j': quat_xyzw=\"0 0 0 0\" is not a quaternion x y z w",
        ),
        (
            joint("<origin xyz='0 1e308 0'/>"),
            "x:3: joint 'j' of link 'b' has the number 1e308, and none beyond 1000000 is taken; correct the number",
        ),
        (
            joint("<mimic joint='k' multiplier='-1e7'/>"),
            "x:3: joint 'j' of link 'b' has the number 1e7,",
        ),
        (joint("<limit lower='-3,1'/>"), "x:4: joint 'j': lower=\"-3,1\" is not a number"),
        (
            joint("<mimic joint='k' multiplier='inf'/>"),
            "x:4: joint 'j': multiplier=\"inf\" is not a finite number",
        ),
        (
            joint("<axis xyz='0 0 0'/>"),
            "x:3: joint 'j': the axis is zero; give the axis a direction",
        ),
        (
            joint("<origin xyz='${d1} 0 0'/>"),
            "x:4: \"${d1} 0 0\" is a leftover of xacro; expand it first",
        ),
        (
            "<link name='$(arg prefix)a'/>".to_owned(),
            "x:2: \"$(arg prefix)a\" is a leftover of xacro",
        ),
        ("<xacro:ur_robot/>".to_owned(), "x:2: the prefix xacro: is a leftover of xacro"),
        (
            "<a:arg xmlns:a='http://wiki.ros.org/xacro'/>".to_owned(),
            "x:2: <xacro:arg> is a leftover of xacro",
        ),
        (
            "<link name='a'/><link name='a'/>".to_owned(),
            "x:2: a second link is named 'a'; rename one of them",
        ),
        (
            format!("<link name='c'/>{links}{}{}", bare("j", "a", "b"), bare("j", "b", "c")),
            "x:4: a second joint is named 'j'",
        ),
        (
            format!("{links}{}", bare("j", "a", "c")),
            "x:3: joint 'j': its child link 'c' is not declared; add the link",
        ),
        (
            format!("{links}{}", bare("j", "c", "b")),
            "x:3: joint 'j': its parent link 'c' is not declared",
        ),
        (
            format!("{links}{}{}", bare("j", "a", "b"), bare("k", "a", "b")),
            "x:4: link 'b' is the child of two joints, 'j' and 'k'; remove",
        ),
        (
            links.to_owned(),
            "x:2: two links have no parent joint: 'a' and 'b'; join them by a joint",
        ),
        (
            format!("{links}{}{}", bare("j", "a", "b"), bare("k", "b", "a")),
            "x:4: joint 'k' closes a loop; remove the joint",
        ),
        (format!("{links}{}", bare("j", "b", "b")), "x:3: joint 'j' closes a loop"),
    ];
    for (body, message) in cases {
        let text = format!("<robot name='r'>\n{body}</robot>");
        let error = Robot::from_urdf(&text, "x").unwrap_err().to_string();
        assert!(error.starts_with(message), "{body}\n  gave {error}\n  not  {message}");
    }
    for (text, message) in [
        ("<sdf/>", "x:1: the XML's root element is <sdf>, not <robot>; give the arm's URDF"),
        ("<robot>\n<link name='a'>\n</robot>", "x:3: not well-formed XML: "),
        ("", "x:1: not well-formed XML: "),
    ] {
        let error = Robot::from_urdf(text, "x").unwrap_err().to_string();
        assert!(error.starts_with(message), "{text}\n  gave {error}\n  not  {message}");
    }
}

#[test]
fn a_hostile_urdf_neither_overflows_nor_hangs() {
    let deep = format!("{}{}", "<link name='a'>".repeat(99), "</link>".repeat(99));
    assert_eq!(urdf(&deep).links().count(), 1);

    let links: String = (0..2_000).map(|i| format!("<link name='l{i}'/>")).collect();
    let joint = |i: usize, to: usize| {
        format!(
            "<joint name='j{i}' type='prismatic'><parent link='l{i}'/><child link='l{to}'/></joint>"
        )
    };
    let line: String = (0..1_999).map(|i| joint(i, i + 1)).collect();
    let robot = urdf(&format!("{links}{line}"));
    let (base, tip) = (robot.link("l0").unwrap(), robot.link("l1999").unwrap());
    let chain = robot.chain(base, tip).unwrap();
    assert_eq!(xyz_of(&chain.forward(&[1e-3; 1_999]))[0].round(), 2.0);

    let mimic = |i: usize| format!("<mimic joint='j{}'/></joint>", i + 1);
    let mimics: String =
        (0..1_998).map(|i| joint(i, i + 1).replace("</joint>", &mimic(i))).collect();
    let robot = urdf(&format!("{links}{mimics}{}", joint(1_998, 1_999)));
    assert_eq!(robot.chain(base, tip).unwrap().joint_names(), ["j1998"]);

    let ring = format!("<robot>{links}{line}{}</robot>", joint(1_999, 0));
    let error = Robot::from_urdf(&ring, "x").unwrap_err().to_string();
    assert!(error.contains("closes a loop"), "{error}");
}

#[test]
fn arms_are_found_by_their_models_where_only_one_has_it() {
    for (short, name) in [
        ("fr3", Some("franka_fr3")),
        ("xarm6", Some("ufactory_xarm6")),
        ("iiwa14", Some("kuka_lbr_iiwa14")),
        ("IRB120", Some("abb_irb120_3_58")),
        ("gen3", Some("kinova_gen3_7dof")),
        ("lrmate200id", Some("fanuc_lrmate200id")),
        // Two arms each, or no model's name.
        ("irb1200", None),
        ("tm5", None),
        ("700", None),
        ("left", None),
        ("", None),
    ] {
        let found = catalogue::find(short).map(|robot| robot.name.as_str());
        assert_eq!(found, name, "{short}");
    }
}
