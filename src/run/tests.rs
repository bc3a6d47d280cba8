mod recording;

use super::*;
use crate::geometry::{Pose, pose, rotation_from_rpy, xyz_of, xyzw_from_rotation};
use crate::log::{Log, Topic};
use crate::robot::{JointKind, Robot, catalogue};
use crate::stream::{
    ArrayColumns, Columns, ImuColumns, JointColumn, JointColumns, Orientations, PoseColumns,
};

use self::recording::{ROWS, Recording, START, TRANSPORT, poses, q_at, some_pose, stamps};

fn misfit_m(arm: &Arm, source: &PoseSource) -> f64 {
    let mut sequence = arm.joints.sequence();
    let gaps = source.track.t_s.iter().zip(&source.track.xyz).map(|(&t_s, xyz)| {
        let (q, _) = sequence.at(t_s).expect("joint states");
        let q: Vec<f64> = source.columns.iter().map(|&column| q[column]).collect();
        (source.chain.forward(&q).translation.vector - xyz).norm()
    });
    gaps.fold(0.0, f64::max)
}

fn role_of<'a>(run: &'a Run, topic: &str) -> (&'static str, &'a str) {
    let stream = run.streams.iter().find(|stream| stream.topic == topic).unwrap();
    (stream.role.name(), &stream.reason)
}

#[test]
fn poses_and_transforms_get_the_chain_that_predicts_them() {
    let mut recording = Recording::new();
    let fk = recording.fk("base", "tool0");
    recording.add_pose("/tcp_pose_broadcaster/pose", poses("base", "", fk));
    recording.add_tf("", true);
    let run = recording.run();
    let [arm] = run.arms.as_slice() else { panic!("{:?}", run.no_arm) };
    assert_eq!((arm.chain.base_name(), arm.chain.tip_name()), ("base", "tool0"));
    assert_eq!(arm.joints.len(), ROWS as usize);
    let [source] = arm.poses.as_slice() else { panic!("one pose stream") };
    assert!(source.reference_known && source.stamps_copied && !source.tip_named);
    assert!(misfit_m(arm, source) < 1e-9);
    let tf = arm.tf.as_ref().unwrap();
    assert_eq!(tf.track.t_s.len(), ROWS as usize);
    assert!(misfit_m(arm, tf) < 1e-9);
    assert_eq!(arm.from_model, []);
    assert_eq!(run.origin, Stamp::from_nanos(START));
    assert!((run.streams[0].rate_hz.unwrap() - 125.0).abs() < 1e-9);
}

#[test]
fn missing_fixed_transforms_come_from_the_model_and_are_reported() {
    let mut recording = Recording::new();
    recording.add_tf("", false);
    let run = recording.run();
    let arm = &run.arms[0];
    assert!(misfit_m(arm, arm.tf.as_ref().unwrap()) < 1e-9);
    let children: Vec<&str> = arm.from_model.iter().map(|(_, child)| child.as_str()).collect();
    assert_eq!(children, ["base", "base_link_inertia", "flange", "tool0"]);
}

#[test]
fn frames_may_carry_a_prefix() {
    let mut recording = Recording::new();
    let fk = recording.fk("base", "tool0");
    recording.add_tf("ur5e/", true);
    recording.add_pose("/hand", poses("ur5e/base", "ur5e/tool0", fk));
    let run = recording.run();
    let arm = &run.arms[0];
    assert!(misfit_m(arm, arm.tf.as_ref().unwrap()) < 1e-9);
    assert!(arm.poses[0].reference_known && arm.poses[0].tip_named);
    assert!(misfit_m(arm, &arm.poses[0]) < 1e-9);
    assert_eq!(run.streams[3].link.as_deref(), Some("ur5e/tool0"));
}

#[test]
fn a_frame_tied_to_a_link_by_static_transforms_is_known() {
    let mut recording = Recording::new();
    let (fk, cell_from_base) = (recording.fk("base", "tool0"), some_pose());
    let statics = vec![poses("cell", "base", |_| cell_from_base)];
    recording.add("/tf_static", Columns::Transforms(statics));
    recording.add_pose("/tcp_pose", poses("cell", "", |nanos| cell_from_base * fk(nanos)));
    let run = recording.run();
    let (arm, source) = (&run.arms[0], &run.arms[0].poses[0]);
    assert!(source.reference_known);
    assert!(misfit_m(arm, source) < 1e-9);
    assert!(role_of(&run, "/tcp_pose").1.contains("'cell' is tied to 'base'"));
}

#[test]
fn the_joint_of_a_positioner_moves_the_frame_of_the_poses() {
    let table = r#"  <link name="table"/>
  <joint name="table_axis" type="revolute">
    <parent link="base_link"/>
    <child link="table"/>
    <axis xyz="0 0 1"/>
    <limit effort="0" lower="-3" upper="3" velocity="1"/>
  </joint>
</robot>"#;
    let angle = |nanos: i64| 0.5 * (1e-9 * (nanos - START) as f64).sin();
    let mut recording = Recording::new();
    let Some((_, Columns::Joints(joints))) = recording.topics.first_mut() else {
        panic!("no joint states")
    };
    let mut axis = JointColumn { name: "table_axis".to_owned(), ..Default::default() };
    for nanos in stamps() {
        axis.position.push(angle(nanos));
        axis.velocity.push(f64::NAN);
    }
    joints.joints.push(axis);
    let fk = recording.fk("base_link", "tool0");
    let base_from_table = |nanos| pose([0.0; 3], rotation_from_rpy([0.0, 0.0, angle(nanos)]));
    let in_table = poses("table", "", |nanos| base_from_table(nanos).inverse() * fk(nanos));
    recording.add_pose("/tcp_pose", in_table);
    let urdf = crate::synth::urdf_text(&recording.robot).replace("</robot>", table);
    let robot = RobotSource { prefix: None, model: "positioner.urdf".to_owned(), text: Some(urdf) };
    let options = RunOptions { robots: vec![robot], ..Default::default() };
    let run = Run::assemble(recording.log(), &options).unwrap();
    let source = &run.arms[0].poses[0];
    assert!(source.reference_known);
    assert!(misfit_m(&run.arms[0], source) < 1e-9);
}

#[test]
fn an_unconnected_frame_is_unknown() {
    let mut recording = Recording::new();
    let fk = recording.fk("base", "tool0");
    recording.add_pose("/tcp_pose", poses("mocap_world", "", fk));
    let run = recording.run();
    assert!(!run.arms[0].poses[0].reference_known);
    assert_eq!(run.streams[1].reference.as_deref(), Some("mocap_world"));
}

#[test]
fn the_requested_tip_overrides_the_child_frame() {
    let mut recording = Recording::new();
    let fk = recording.fk("base", "tool0");
    recording.add_pose("/pose", poses("base", "wrist_3_link", fk));
    let options = RunOptions { tip: Some("flange".to_owned()), ..Default::default() };
    let run = recording.run_with(options);
    assert_eq!(run.arms[0].poses[0].chain.tip_name(), "flange");
    assert!(role_of(&run, "/pose").1.contains("audited as 'flange'"));
}

#[test]
fn a_tool_tied_to_the_requested_tip_is_taken_off() {
    let mut recording = Recording::new();
    let (fk, tip_from_tool) = (recording.fk("base", "tool0"), some_pose());
    let statics = vec![poses("tool0", "gripper_tcp", |_| tip_from_tool)];
    recording.add("/tf_static", Columns::Transforms(statics));
    recording.add_pose("/pose", poses("base", "gripper_tcp", |nanos| fk(nanos) * tip_from_tool));
    let options = RunOptions { tip: Some("tool0".to_owned()), ..Default::default() };
    let run = recording.run_with(options);
    assert!(misfit_m(&run.arms[0], &run.arms[0].poses[0]) < 1e-9);
}

#[test]
fn a_pose_measured_onto_tf_is_a_candidate_and_no_part_of_the_arm() {
    let mut recording = Recording::new();
    let fk = recording.fk("base", "tool0");
    recording.add_tf("", true);
    let Some((_, Columns::Transforms(transforms))) = recording.topics.get_mut(1) else {
        panic!("/tf")
    };
    transforms.push(poses("base", "tool0_controller", &fk));
    transforms.push(poses("base", "tool0", fk));
    transforms.push(poses("odom", "base_link", |_| Pose::identity()));
    let mut run = recording.run();
    assert!(misfit_m(&run.arms[0], run.arms[0].tf.as_ref().unwrap()) < 1e-9);
    let children: Vec<(&str, &str)> = run.streams[3..]
        .iter()
        .map(|stream| (stream.child_frame_id.as_str(), stream.role.name()))
        .collect();
    assert_eq!(children, [("tool0_controller", "unassigned"), ("tool0", "pose")]);
    assert_eq!(run.candidates().collect::<Vec<_>>(), [3]);
    // A network that delivers in bursts distorts the speeds by stamps; the driver's frame stays the tool's.
    run.resolve_candidate(3, Some(0.17), false);
    assert_eq!(run.streams[3].role, Role::Pose);
    assert_eq!(run.arms[0].poses.len(), 2);
}

#[test]
fn a_candidate_that_does_not_follow_is_unassigned_with_the_reason() {
    let mut recording = Recording::new();
    recording.add_pose("/camera_mount_pose", poses("map", "", |_| some_pose()));
    recording.add_pose("/hand_pose", poses("base", "", |_| some_pose()));
    let mut run = recording.run();
    for (stream, peak) in [(1, Some(0.5)), (2, Some(0.5))] {
        run.resolve_candidate(stream, peak, false);
    }
    run.remove_rejected(&[1, 2]);
    assert_eq!(role_of(&run, "/camera_mount_pose").0, "unassigned");
    assert!(role_of(&run, "/camera_mount_pose").1.contains("speed correlation 0.50"));
    assert_eq!(role_of(&run, "/hand_pose").0, "pose");
    assert_eq!(run.arms[0].poses.iter().map(|source| source.stream).collect::<Vec<_>>(), [2]);
}

#[test]
fn transforms_that_cross_not_all_joints_are_no_source() {
    let mut recording = Recording::new();
    recording.add_tf("", true);
    let Some((_, Columns::Transforms(transforms))) = recording.topics.get_mut(1) else {
        panic!("/tf")
    };
    let elbow = transforms.remove(2);
    let Some((_, Columns::Transforms(fixed))) = recording.topics.get_mut(2) else {
        panic!("/tf_static")
    };
    fixed.push(elbow);
    let run = recording.run();
    let expected = TfUnavailable::NotCovered { joints: vec!["elbow_joint".to_owned()] };
    assert_eq!(run.arms[0].tf.as_ref().unwrap_err(), &expected);
    assert!(role_of(&run, "/tf").1.contains("covers elbow_joint"));
}

#[test]
fn joints_outside_the_arm_are_ignored_with_the_reason() {
    let mut recording = Recording::new();
    let Some((_, Columns::Joints(joints))) = recording.topics.get_mut(0) else { panic!("joints") };
    let finger = JointColumn::from_positions("finger_joint".to_owned(), vec![0.0; ROWS as usize]);
    joints.joints.push(finger);
    joints.joints[2].position[100] = f64::NAN;
    let commands = joints.clone();
    recording.add("/joint_commands", Columns::Joints(commands));
    let run = recording.run();
    assert!(role_of(&run, "/joint_states").1.contains("finger_joint"));
    assert_eq!(role_of(&run, "/joint_commands").0, "reference");
    assert_eq!(run.arms[0].joints.len(), ROWS as usize);
    let samples: Vec<usize> = run.arms[0].joint_sources.iter().map(|joint| joint.samples).collect();
    assert_eq!(samples.iter().sum::<usize>(), 6 * ROWS as usize - 1);
}

fn imu(frame_id: &str, clock_offset: i64) -> Columns {
    let mut imu =
        ImuColumns { frame_id: frame_id.to_owned(), has_orientation: true, ..Default::default() };
    for nanos in stamps() {
        imu.times.push(nanos - clock_offset, nanos + TRANSPORT, nanos);
        imu.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
        imu.gyro.push([0.0; 3]);
        imu.accel.push([0.0; 3]);
    }
    Columns::Imu(imu)
}

#[test]
fn an_imu_is_on_the_link_that_its_frame_is_tied_to() {
    let mut recording = Recording::new();
    let mount = some_pose();
    let statics = vec![poses("wrist_1_link", "imu_link", |_| mount)];
    recording.add("/tf_static", Columns::Transforms(statics));
    recording.add("/imu/tied", imu("imu_link", 0));
    recording.add("/imu/unknown", imu("xsens", 0));
    recording.add("/imu/base", imu("base_link", 0));
    let run = recording.run();
    let [tied, unknown] = run.arms[0].imus.as_slice() else { panic!("two IMUs") };
    assert_eq!((tied.chain.tip_name(), tied.chain.dof()), ("wrist_1_link", 4));
    let error = tied.link_from_imu.unwrap().inverse() * mount;
    assert!(error.translation.vector.norm() + error.rotation.angle() < 1e-9);
    assert_eq!((unknown.chain.tip_name(), unknown.link_from_imu), ("tool0", None));
    assert!(role_of(&run, "/imu/base").1.contains("does not move"));
}

#[test]
fn a_stream_on_a_foreign_clock_is_aligned_to_the_joints() {
    let mut recording = Recording::new();
    recording.add("/imu/data", imu("tool0", 1_700_000_000_000_000_000));
    let run = recording.run();
    let [first, .., last] = run.arms[0].imus[0].track.t_s.as_slice() else { panic!("samples") };
    assert!(first.abs() < 1e-9 && (last - 3.192).abs() < 1e-9, "{first} {last}");
    assert_eq!(run.clocks[1].epoch, Epoch::Foreign);
}

#[test]
fn undeclared_numbers_are_candidates_and_declared_ones_are_poses() {
    let mut array = ArrayColumns { width: 6, ..Default::default() };
    array.times.unstamped = true;
    for nanos in stamps() {
        array.times.push(0, nanos, 0);
        array.values.extend([0.0, 0.0, nanos as f64 * 1e-12, 0.1, 0.2, 0.3]);
    }
    let mut recording = Recording::new();
    recording.add("/ur/tcp", Columns::Array(array.clone()));
    let run = recording.run();
    assert_eq!(run.streams[1].role, Role::Candidate { presumed: false });
    assert!(matches!(run.arms[0].poses[0].track.orientation, Orientations::Numbers(_)));

    let mut recording = Recording::new();
    recording.add("/ur/tcp", Columns::Array(array));
    let declared = vec!["/ur/tcp=rotvec".parse().unwrap()];
    let run = recording.run_with(RunOptions { declared, ..Default::default() });
    assert_eq!(run.streams[1].role, Role::Pose);
    assert!(matches!(run.arms[0].poses[0].track.orientation, Orientations::Rotations(_)));
    assert_eq!(run.arms[0].poses[0].chain.base_name(), "base");
}

#[test]
fn a_controllers_feedback_is_the_arm_and_its_reference_is_not() {
    let mut recording = Recording::new();
    let Columns::Joints(feedback) = recording.topics.remove(0).1 else { panic!("joints") };
    let mut reference = feedback.clone();
    reference.joints.iter_mut().for_each(|joint| joint.position.fill(0.0));
    recording.add("/arm_controller/state", Columns::Joints(feedback));
    recording.add("/arm_controller/state.reference", Columns::Joints(reference));
    let run = recording.run();
    let roles: Vec<Role> = run.streams.iter().map(|stream| stream.role).collect();
    assert_eq!(roles, [Role::Joints, Role::Reference]);
    assert!(run.arms[0].joint_sources.iter().all(|joint| joint.stream == 0));
}

#[test]
fn a_fake_controller_is_no_second_arm() {
    const FAKE: &str = "/move_group/fake_controller_joint_states";
    let mut recording = Recording::new();
    let Columns::Joints(states) = recording.topics.remove(0).1 else { panic!("joints") };
    let mut fake = states.clone();
    fake.joints.iter_mut().for_each(|joint| joint.position.fill(0.0));
    recording.add(FAKE, Columns::Joints(fake.clone()));
    recording.add("/joint_states", Columns::Joints(states));
    let run = recording.run();
    let roles: Vec<Role> = run.streams.iter().map(|stream| stream.role).collect();
    assert_eq!((roles, run.arms.len()), (vec![Role::Reference, Role::Joints], 1));
    // Without other joint states, it is used.
    let mut alone = Recording::new();
    alone.topics.remove(0);
    alone.add(FAKE, Columns::Joints(fake));
    assert_eq!(alone.run().streams[0].role, Role::Joints);
}

/// `franka_msgs/FrankaState`: unnamed joints, column-major matrix.
fn franka() -> (JointColumns, ArrayColumns) {
    let robot = catalogue::find("panda").unwrap();
    let [base, tip] = ["fer_link0", "fer_hand_tcp"].map(|link| robot.link(link).unwrap());
    let chain = robot.chain(base, tip).unwrap();
    let mut joints = JointColumns { unnamed: true, ..Default::default() };
    for joint in 1..=7 {
        let name = format!("panda_joint{joint}");
        joints.joints.push(JointColumn { name, ..Default::default() });
    }
    let mut matrix = ArrayColumns { width: 16, ..Default::default() };
    for nanos in stamps() {
        let [a, b, c, d, e, f] = q_at(nanos);
        let q = [a, b, c, d - 1.5, e, f + 1.5, 0.3];
        joints.times.push(nanos, nanos + TRANSPORT, nanos);
        matrix.times.push(nanos, nanos + TRANSPORT, nanos);
        for (joint, q) in joints.joints.iter_mut().zip(q) {
            joint.position.push(q);
            joint.velocity.push(f64::NAN);
        }
        matrix.values.extend(chain.forward(&q).to_homogeneous().as_slice());
    }
    (joints, matrix)
}

#[test]
fn the_state_of_a_franka_arm_is_joints_and_the_pose_by_them() {
    let mut recording = Recording::new();
    recording.topics.clear();
    let (joints, matrix) = franka();
    recording.add("/franka_states", Columns::Joints(joints));
    recording.add("/franka_states.O_T_EE", Columns::Array(matrix));
    let run = Run::assemble(recording.log(), &RunOptions::default()).unwrap();
    assert!(run.no_arm.is_none(), "{:?}", run.no_arm);
    assert_eq!(run.streams[0].role, Role::Joints);
    assert_eq!(run.streams[1].role, Role::Candidate { presumed: true });
    let arm = &run.arms[0];
    let [source] = arm.poses.as_slice() else { panic!("one pose") };
    let row = source.track.t_s.len() / 2;
    let ours = source.chain.forward(arm.joints.row(row)).translation.vector;
    assert!((ours - source.track.xyz[row]).norm() < 1e-9);
}

#[test]
fn unnamed_joints_are_ignored_if_others_are_named() {
    let (joints, matrix) = franka();
    let mut named = joints.clone();
    named.unnamed = false;
    for joint in &mut named.joints {
        joint.name = joint.name.replace("panda", "fer");
    }
    let mut recording = Recording::new();
    recording.topics.clear();
    recording.add("/franka_states", Columns::Joints(joints));
    recording.add("/franka_states.O_T_EE", Columns::Array(matrix));
    recording.add("/joint_states", Columns::Joints(named));
    let run = Run::assemble(recording.log(), &RunOptions::default()).unwrap();
    assert_eq!((run.arms.len(), run.streams[0].role), (1, Role::Ignored));
    assert_eq!(run.streams[0].reason, "its joints have no names, unlike those on '/joint_states'");
    assert_eq!(run.arms[0].poses.len(), 1);
}

#[test]
fn a_log_without_an_arm_keeps_its_streams() {
    let mut recording = Recording::new();
    recording.add("/imu/data", imu("imu_link", 0));
    recording.topics.remove(0);
    let run = Run::assemble(recording.log(), &RunOptions::default()).unwrap();
    assert!(matches!(run.no_arm, Some(RunError::NoJointStates { .. })));
    assert_eq!((run.streams.len(), run.clocks.len()), (1, 1));
    assert_eq!(run.origin, Stamp::from_nanos(START));
}

#[test]
fn errors_in_the_options_give_the_remedy() {
    let call = |options: RunOptions| {
        let robots = if options.robots.is_empty() { vec!["ur5e".into()] } else { options.robots };
        let options = RunOptions { robots, ..options };
        Run::assemble(Recording::new().log(), &options).unwrap_err().to_string()
    };
    let some = |name: &str| Some(name.to_owned());
    let tip = call(RunOptions { tip: some("tol0"), ..Default::default() });
    assert!(
        tip.contains("--tip 'tol0' is not a link of the robot (did you mean 'tool0'?)"),
        "{tip}"
    );
    let base = call(RunOptions { base: some("nowhere"), ..Default::default() });
    assert!(base.contains("--base 'nowhere'"), "{base}");
    let robot = call(RunOptions { robots: vec!["/nowhere.urdf".into()], ..Default::default() });
    assert!(robot.contains("/nowhere.urdf"), "{robot}");
    let topic = vec!["/nothing=rotvec".parse().unwrap()];
    let declared = call(RunOptions { declared: topic, ..Default::default() });
    assert!(declared.contains("no such topic"), "{declared}");
    for line in [tip, base, robot, declared] {
        assert!(!line.contains('\n'), "{line}");
    }
}

#[test]
fn two_arms_of_one_model_are_two_with_their_own_streams() {
    let mut recording = Recording::new();
    let mut both = recording.joint_states();
    for side in ["left_", "right_"] {
        for joint in recording.joint_states().joints {
            both.joints.push(JointColumn { name: format!("{side}{}", joint.name), ..joint });
        }
    }
    both.joints.drain(..6);
    recording.topics[0].1 = Columns::Joints(both);
    let fk = recording.fk("base", "tool0");
    recording.add_pose("/right/tcp_pose", poses("right_base", "right_tool0", fk));
    let run = recording.run();
    let names: Vec<&str> = run.arms.iter().map(|arm| arm.name.as_str()).collect();
    assert_eq!(names, ["ur5e (left_tool0)", "ur5e (right_tool0)"]);
    assert!(run.arms[0].poses.is_empty());
    assert!(misfit_m(&run.arms[1], &run.arms[1].poses[0]) < 1e-9);
}
