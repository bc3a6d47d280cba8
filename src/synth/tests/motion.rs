//! Checks motions against limits and commands.

use super::*;

#[test]
fn every_motion_of_every_arm_is_smooth_and_within_limits() {
    let motions = [
        Motion::PickAndPlace,
        Motion::Continuous,
        Motion::Periodic { period_s: 2.5 },
        Motion::OneJoint(1),
        Motion::AtRest,
    ];
    for robot in catalogue::entries() {
        let [base, tip] =
            [&robot.default_base, &robot.default_tip].map(|name| name.clone().unwrap());
        for motion in motions {
            let run = Scenario { motion, ..Scenario::new(robot.clone(), &base, &tip) };
            let truth = Truth::new(&run).unwrap();
            for step in 0..200 {
                const H: f64 = 1e-5;
                let time_s = 0.1 * f64::from(step);
                let (q, q_dot) = truth.joints(time_s);
                let [(before, _), (after, _)] = [-H, H].map(|h| truth.joints(time_s + h));
                for joint in 0..q.len() {
                    let limits = truth.chain.limits()[joint];
                    assert!(limits.lower.is_none_or(|lower| q[joint] >= lower), "{}", robot.name);
                    assert!(limits.upper.is_none_or(|upper| q[joint] <= upper), "{}", robot.name);
                    assert!(limits.velocity.is_none_or(|limit| q_dot[joint].abs() <= limit));
                    assert!(q_dot[joint].abs() <= run.speed + 1e-9);
                    let slope = (after[joint] - before[joint]) / (2.0 * H);
                    assert!((slope - q_dot[joint]).abs() < 1e-6);
                }
            }
        }
    }
}

#[test]
fn line_motions_are_straight_and_joints_follow() {
    let lines = LineMotion { bow_m: 0.004, interpolated_as: None };
    let run = Scenario { motion: Motion::Lines(lines), ..quiet_run() };
    let truth = Truth::new(&run).unwrap();
    let rests = truth.rests();
    assert!(rests.len() > 2);
    let (leave_s, arrive_s) = (rests[0].1, rests[1].0);
    let [start, end] = [leave_s, arrive_s].map(|time_s| truth.commanded_pose(time_s).unwrap());
    let chord = end.translation.vector - start.translation.vector;
    let mut farthest_m = 0.0_f64;
    for step in 0..=100 {
        const H: f64 = 1e-4;
        let time_s = leave_s + (arrive_s - leave_s) * 0.01 * f64::from(step);
        let off = |pose: &Pose| {
            (pose.translation.vector - start.translation.vector).cross(&chord).norm() / chord.norm()
        };
        assert!(off(&truth.commanded_pose(time_s).unwrap()) < 1e-9);
        farthest_m = farthest_m.max(off(&truth.base_from_tip(time_s)));
        let (_, q_dot) = truth.joints(time_s);
        let [(before, _), (after, _)] = [-H, H].map(|h| truth.joints(time_s + h));
        for joint in 0..6 {
            let slope = (after[joint] - before[joint]) / (2.0 * H);
            assert!((slope - q_dot[joint]).abs() < 1e-3, "{slope} {}", q_dot[joint]);
        }
    }
    assert!((farthest_m - 0.004).abs() < 2e-5, "{farthest_m}");
    assert_same_pose(&truth.base_from_tip(leave_s - 0.3), &start);
}

#[test]
fn a_goal_is_sent_once_before_the_motion() {
    let mut run = Scenario { motion: Motion::Lines(LineMotion::default()), ..quiet_run() };
    (run.reference.timing.rate_hz, run.reference.commands) = (1.0, Commands::Goals);
    let truth = Truth::new(&run).unwrap();
    let goals = Log::write(&run).read(GOAL, |cdr| (cdr.header().0, cdr.pose()));
    let rests = truth.rests();
    assert!(!goals.is_empty());
    for ((stamp_s, goal), rest) in goals.iter().zip(rests.windows(2)) {
        assert!((rest[0].0..rest[0].1).contains(stamp_s));
        let off = goal.inverse() * truth.base_from_tip(rest[1].0);
        assert!(off.translation.vector.norm() < 1e-7 && off.rotation.angle() < 1e-7, "{off}");
    }
}

#[test]
fn joints_lag_their_commands_by_the_offset() {
    let mut run = quiet_run();
    (run.reference.timing.rate_hz, run.reference.commands) = (25.0, Commands::Joints);
    run.reference.command_offset = vec![0.0, 0.01];
    let truth = Truth::new(&run).unwrap();
    let told = Log::write(&run).read(COMMANDED_JOINTS, |cdr| {
        let stamp_s = cdr.header().0;
        let names = cdr.u32();
        (0..names).for_each(|_| drop(cdr.string()));
        (stamp_s, cdr.sequence())
    });
    assert_eq!(told.len(), 100);
    for (stamp_s, told) in told {
        let (q, _) = truth.joints(stamp_s);
        assert!((told[1] - q[1] - 0.01).abs() < 1e-8 && (told[2] - q[2]).abs() < 1e-8);
    }
}

#[test]
fn each_motion_matches_its_name() {
    let moves = |motion| {
        let truth = Truth::new(&Scenario { motion, ..Scenario::ur5e() }).unwrap();
        let speeds = (0..400).map(|step| truth.joints(0.05 * f64::from(step)).1);
        speeds.fold([0.0_f64; 6], |most, speed| {
            std::array::from_fn(|joint| most[joint].max(speed[joint].abs()))
        })
    };
    assert!(moves(Motion::PickAndPlace).iter().all(|&speed| speed > 0.3));
    assert!(moves(Motion::Continuous).iter().all(|&speed| speed > 0.3));
    assert_eq!(moves(Motion::AtRest), [0.0; 6]);
    let only_the_elbow = moves(Motion::OneJoint(2));
    assert!(only_the_elbow[2] > 0.3);
    assert_eq!(only_the_elbow.map(|speed| speed > 0.0), [false, false, true, false, false, false]);

    let periodic = Scenario { motion: Motion::Periodic { period_s: 4.0 }, ..Scenario::ur5e() };
    let truth = Truth::new(&periodic).unwrap();
    let (first, again) = (truth.joints(1.0).0, truth.joints(9.0).0);
    assert!(first.iter().zip(again).all(|(a, b)| (a - b).abs() < 1e-9));
}

#[test]
fn a_prismatic_joint_is_in_metres() {
    const RAIL: &str = r#"<robot name="rail"><link name="a"/><link name="b"/><link name="c"/>
        <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/>
        <axis xyz="0 1 0"/><limit lower="0" upper="1.5" effort="0" velocity="1"/></joint>
        <joint name="turn" type="continuous"><parent link="b"/><child link="c"/></joint></robot>"#;
    let robot = Robot::from_urdf(RAIL, "rail").unwrap();
    let run = Scenario { noise: Noise::NONE, ..Scenario::new(robot, "a", "c") };
    let log = Log::write(&run);
    let truth = Truth::new(&run).unwrap();
    let slides = log.transforms(TF).into_iter().filter(|tf| tf.child == "b");
    let mut most = f64::MIN;
    for tf in slides {
        let y = tf.parent_from_child.translation.y;
        assert!((y - truth.joints(tf.stamp_s).0[0]).abs() < 1e-8);
        most = most.max(y);
    }
    assert!((0.76..1.06).contains(&most));
}

#[test]
fn tasks_follow_lines_within_joint_limits() {
    use Task::*;
    let tasks = [
        Picking, Palletising, Welding, Spraying, Screwdriving, BinPicking, Teleoperation, Servoing,
        Conveyor, Drawer, Calibration,
    ];
    for task in tasks {
        let run = Scenario { motion: Motion::Task(task), ..quiet_run() };
        let truth = Truth::new(&run).unwrap();
        let mut moved = 0.0_f64;
        for step in 0..100 {
            let time_s = 0.01 * run.duration_s * f64::from(step);
            assert_same_pose(&truth.base_from_tip(time_s), &truth.commanded_pose(time_s).unwrap());
            let (_, q_dot) = truth.joints(time_s);
            for (speed, limits) in q_dot.iter().zip(truth.chain.limits()) {
                assert!(limits.velocity.is_none_or(|limit| speed.abs() <= limit), "{task:?}");
                moved = moved.max(speed.abs());
            }
        }
        assert!(moved > 0.02, "{task:?}");
    }
}

#[test]
fn an_elbow_swing_keeps_the_tip_fixed() {
    let arm = catalogue::find("kuka_lbr_iiwa14").unwrap().clone();
    let home = vec![0.0, 0.5, 0.0, -1.4, 0.0, 1.0, 0.0];
    let motion = Motion::ElbowSwing;
    let run = Scenario { motion, home, ..Scenario::new(arm, "lbr_link_0", "lbr_link_ee") };
    let truth = Truth::new(&run).unwrap();
    let (start, _) = truth.joints(0.0);
    let mut moved = 0.0_f64;
    for step in 0..40 {
        let time_s = 0.5 * f64::from(step);
        assert_same_pose(&truth.base_from_tip(time_s), &truth.base_from_tip(0.0));
        moved = moved.max((truth.joints(time_s).0[2] - start[2]).abs());
    }
    assert!(moved > 0.1, "{moved}");
}
