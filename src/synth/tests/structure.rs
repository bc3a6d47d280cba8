//! Compares the structure of a cell's log with the true motion.

use super::*;
use crate::robot::JointKind;
use std::f64::consts::TAU;

fn joints_of(log: &Log, topic: &str) -> Vec<(f64, Vec<String>, Vec<f64>)> {
    log.read(topic, |cdr| {
        let stamp_s = cdr.header().0;
        let names = (0..cdr.u32()).map(|_| cdr.string()).collect();
        (stamp_s, names, cdr.sequence())
    })
}

#[test]
fn values_are_repeated_under_new_stamps_until_updated() {
    let mut run = quiet_run();
    run.joints.timing.update_hz = 5.0;
    let truth = Truth::new(&run).unwrap();
    let joints = Log::write(&run).joints();
    for (index, joints) in joints.iter().enumerate() {
        assert!((joints.stamp_s - index as f64 / 25.0).abs() < 1e-9);
        let (q, _) = truth.joints((index / 5) as f64 / 5.0);
        assert!(joints.positions.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-9), "{index}");
    }
}

#[test]
fn scale_wrapping_and_resolution_affect_joints_and_tf() {
    let mut run = quiet_run();
    run.home = vec![0.0, -1.5, 1.5, -1.5, -1.5, PI];
    run.joints.scales = vec![1.0, -1.0];
    run.joints.wrapping = Some(JointWrapping::PlusMinusPi);
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);
    for joints in log.joints() {
        let (q, q_dot) = truth.joints(joints.stamp_s);
        assert!((joints.positions[1] + q[1]).abs() < 1e-9);
        assert!((joints.velocities[1] + q_dot[1]).abs() < 1e-9);
        // Not wrapped: it has limits.
        assert!((joints.positions[5] - q[5]).abs() < 1e-9);
    }
    for fold in [JointWrapping::PlusMinusPi, JointWrapping::ZeroToTwoPi] {
        let folded = fold.wrap(7.0, JointKind::Continuous);
        assert!((folded - 7.0 + TAU).abs() < 1e-12 && fold.wrap(7.0, JointKind::Revolute) == 7.0);
    }
    run.joints = JointStream { scales: Vec::new(), wrapping: None, resolution: 0.01, ..run.joints };
    for joints in Log::write(&run).joints() {
        for (said, q) in joints.positions.iter().zip(truth.joints(joints.stamp_s).0) {
            assert!((said / 0.01).fract().abs() < 1e-6 || (said / 0.01).fract().abs() > 1.0 - 1e-6);
            assert!((said - q).abs() < 0.0051);
        }
    }
}

#[test]
fn separate_joints_and_namespaces_have_own_topics() {
    let mut run = quiet_run();
    run.namespace = "/left".to_owned();
    run.joints.separate_topic = Some((vec![0], "/rail/joint_states".to_owned()));
    let log = Log::write(&run);
    let rest = joints_of(&log, "/left/joint_states");
    let apart = joints_of(&log, "/left/rail/joint_states");
    assert_eq!((rest.len(), apart.len()), (100, 100));
    assert!(rest[0].1.len() == 5 && apart[0].1 == ["shoulder_pan_joint"]);
    assert!(!log.transforms(TF).is_empty() && log.poses().is_empty());
    assert_eq!(log.read("/left/tcp_pose_broadcaster/pose", |cdr| cdr.header().0).len(), 100);
}

#[test]
fn several_arms_are_one_log() {
    let left = Scenario { namespace: "/left".to_owned(), ..quiet_run() };
    let right = Scenario { namespace: "/right".to_owned(), seed: 9, ..quiet_run() };
    let mut bytes = Vec::new();
    write_cell(&[left, right], Cursor::new(&mut bytes), None).unwrap();
    let log = Log(bytes);
    let positions = |topic: &str| joints_of(&log, topic)[50].2.clone();
    assert_ne!(positions("/left/joint_states"), positions("/right/joint_states"));
    assert_eq!(log.transforms(TF).len(), 2 * 100 * 6);
}

#[test]
fn poses_of_an_arm_on_a_moving_base_are_in_the_fixed_frame() {
    let mut run = quiet_run();
    let edge = Timing::every(25.0, 0.0);
    run.moving_base = Some(MovingBase {
        frame_id: "odom".to_owned(),
        reach_m: 1.0,
        turn_rad: 0.5,
        transform_timing: edge,
    });
    run.pose.frame_id = "odom".to_owned();
    run.pose.timing.phase_s = 0.0;
    let truth = Truth::new(&run).unwrap();
    let log = Log::write(&run);
    let edges: Vec<LoggedTf> =
        log.transforms(TF).into_iter().filter(|tf| tf.parent == "odom").collect();
    assert_eq!(edges.len(), 100);
    for ((stamp_s, logged), edge) in log.poses().into_iter().zip(edges) {
        assert_same_pose(&logged, &(edge.parent_from_child * truth.first_from_tip(stamp_s)));
    }
}

#[test]
fn a_rail_moves_the_base_of_the_poses() {
    let rail = "  <link name=\"rail_base\"/>\n  <joint name=\"rail_joint\" type=\"prismatic\">\n    \
                <parent link=\"rail_base\"/>\n    <child link=\"base_link\"/>\n    \
                <axis xyz=\"1 0 0\"/>\n    \
                <limit effort=\"0\" lower=\"-1\" upper=\"1\" velocity=\"1\"/>\n  </joint>\n</robot>";
    let text = urdf_text(&quiet_run().robot).replace("</robot>", rail);
    let robot = Robot::from_urdf(&text, "test").unwrap();
    let mut run = Scenario { robot, root: Some("rail_base".to_owned()), ..quiet_run() };
    run.base = "base_link".to_owned();
    run.home.insert(0, 0.0);
    let truth = Truth::new(&run).unwrap();
    assert_eq!(truth.chain.dof(), 7);
    for (stamp_s, logged) in Log::write(&run).poses() {
        let (q, _) = truth.joints(stamp_s);
        let mut on_rail = truth.first_from_tip(stamp_s);
        on_rail.translation.vector.x -= q[0];
        assert_same_pose(&logged, &on_rail);
    }
}

#[test]
fn a_second_publisher_differs_only_in_the_offset_transform() {
    let mut run = quiet_run();
    let moved = pose([0.005, 0.0, 0.0], Rotation::identity());
    let timing = run.tf.timing.clone();
    run.tf.second = Some(SecondPublisher { timing, offset_joint: Some((2, moved)) });
    let transforms = Log::write(&run).transforms(TF);
    assert_eq!(transforms.len(), 2 * 100 * 6);
    let elbow: Vec<&LoggedTf> = transforms.iter().filter(|tf| tf.child == "forearm_link").collect();
    for pair in elbow.chunks(2).filter(|pair| pair[0].stamp_s == pair[1].stamp_s) {
        let [a, b] = [pair[0], pair[1]].map(|tf| tf.parent_from_child.translation.vector);
        assert!(((a - b).norm() - 0.005).abs() < 1e-9);
    }
}

#[test]
fn a_hand_leads_the_arm_in_another_world() {
    let mut run = quiet_run();
    run.leader.timing = Timing::every(25.0, 0.0);
    run.leader.lead_s = 0.2;
    let truth = Truth::new(&run).unwrap();
    let hand = Log::write(&run).read("/hand/pose", |cdr| (cdr.header(), cdr.pose()));
    for ((stamp_s, frame), logged) in hand {
        assert_eq!(frame, "hand_world");
        let expected = run.leader.frame_from_base
            * truth.base_from_tip(stamp_s + 0.2)
            * run.leader.tip_from_hand;
        assert_same_pose(&logged, &expected);
    }
}

#[test]
fn positions_may_have_other_units_axes_constants_and_slips() {
    let mut run = quiet_run();
    let truth = Truth::new(&run).unwrap();
    let (times, axes) = (100.0, Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0));
    run.pose.position_factor = times;
    run.pose.axes = Some(axes);
    for (stamp_s, logged) in Log::write(&run).poses() {
        let truth = truth.base_from_tip(stamp_s);
        let expected = times * (axes * truth.translation.vector);
        assert!((logged.translation.vector - expected).norm() < 1e-7);
        let turned = axes * truth.rotation.to_rotation_matrix().matrix() * axes.transpose();
        let logged = logged.rotation.to_rotation_matrix();
        assert!((logged.matrix() - turned).norm() < 1e-9);
    }
    let slip = pose([0.0, 0.0, 0.07], Rotation::identity());
    run.pose = PoseStream { position_factor: 1.0, axes: None, ..run.pose };
    run.pose.constant_coordinate = Some((1, 0.25));
    run.pose.tool_slip = Some(ToolSlip { from_s: 2.0, to_s: 3.0, tool_from_slipped: slip });
    for (stamp_s, logged) in Log::write(&run).poses() {
        let tool = if (2.0..3.0).contains(&stamp_s) { slip } else { Pose::identity() };
        let expected = (truth.base_from_tip(stamp_s) * tool).translation;
        assert!((logged.translation.x - expected.x).abs() < 1e-9 && logged.translation.y == 0.25);
    }
}

#[test]
fn a_stream_clock_may_step() {
    let mut run = quiet_run();
    run.pose.timing.clock_step = Some((2.0, 0.3));
    let stamps: Vec<f64> =
        Log::write(&run).poses().into_iter().map(|(stamp_s, _)| stamp_s).collect();
    let longest = stamps.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    assert!((longest - 0.34).abs() < 1e-9);
}
