//! Chains and their kinematics.

use std::f64::consts::PI;

use poseaudit::geometry::{Pose, Rotation, pose, rotation_from_rpy, rotvec_from_rotation};
use poseaudit::robot::{Chain, ChainError, JointKind, catalogue};

use super::{assert_near, chain, default_chain, positions, urdf};

/// A prismatic joint, a revolute joint about a skew axis, and two joints that mimic them.
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
    let mut chains: Vec<Chain> = catalogue::entries().map(default_chain).collect();
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

/// Twist of the tip in the base by a central difference of joint `joint`.
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
fn a_chain_through_an_intermediate_link_is_the_product_of_its_parts() {
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
fn a_mimic_joint_without_its_master_in_the_path_takes_its_position() {
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
        assert_eq!(poses.len(), 20);
        for (q, pose) in rows.chunks(chain.dof()).zip(&poses) {
            assert_near(pose, &chain.forward(q), 1e-13, &robot.name);
        }
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
fn an_impossible_chain_is_an_error_with_a_remedy() {
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
    assert!(error("a", "e").starts_with("joint 'n' mimics 'n', which refers back to itself"));
}

#[test]
fn a_misspelt_link_suggests_the_nearest() {
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
