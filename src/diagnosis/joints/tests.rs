use super::comparison::JointComparison;
use super::estimate::half_follows_as_logged;
use super::interpreted_poses::{FreeFrames, InterpretedPoses, ResidualSize};
use super::map::{JointMap, candidate_orders, half_turns};
use super::search::{InterpretationKind, SearchOutcome, search_kind};
use super::slow_samples::JOINT_ENCODING_SAMPLES;
use crate::frames::position_fit::spread;
use crate::samples::sampling::range_of;
use crate::test_random::Lcg;
use crate::{diagnose_arm, test_motion};
use ground::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use ground::robot::Chain;
use ground::stream::{JointTrack, PoseTrack};
use std::f64::consts::{PI, TAU};

const MOST: ResidualSize = ResidualSize { m: 5e-3, rad: Some(0.03) };

fn ur5e() -> Chain {
    test_motion::arm().1
}

/// Poses over the arm's range, with joint values transformed by `logged`.
fn view<'a>(
    chain: &'a Chain,
    tool: Pose,
    logged: impl Fn(&[f64]) -> Vec<f64>,
) -> InterpretedPoses<'a> {
    let mut random = Lcg::new();
    let mut of = |most: f64| random.number(2.0 * most) - most;
    let rows: Vec<Vec<f64>> =
        (0..60).map(|_| (0..chain.dof()).map(|_| of(1.2)).collect()).collect();
    let poses: Vec<Pose> = rows.iter().map(|q| chain.forward(q) * tool).collect();
    let noise = |k: usize| 1e-4 * Vec3::new((k as f64).sin(), (3.0 * k as f64).cos(), 0.3);
    let xyz = poses.iter().enumerate().map(|(k, at)| at.translation.vector + noise(k)).collect();
    let q: Vec<f64> = rows.iter().flat_map(|row| logged(row)).collect();
    let span = |joint: usize| range_of(q.iter().skip(joint).step_by(chain.dof()).copied());
    let spans = (0..chain.dof()).map(span).collect();
    let rotation = Some(poses.iter().map(|pose| pose.rotation).collect());
    InterpretedPoses { lever_m: 0.25, ..InterpretedPoses::new(chain, xyz, rotation, q, spans) }
}

fn find_map(view: &InterpretedPoses, kind: InterpretationKind, freedom: FreeFrames) -> JointMap {
    match search_kind(view, kind, freedom, MOST) {
        SearchOutcome::Found(find_map) => find_map.map,
        SearchOutcome::Ambiguous(_) => panic!("several ways fit"),
        SearchOutcome::Nothing => panic!("nothing fits"),
    }
}

fn assert_near(find_map: &[f64], expected: &[f64], most: f64) {
    let near = find_map.iter().zip(expected).all(|(a, b)| (a - b).abs() < most);
    assert!(near, "{find_map:?}, not {expected:?}");
}

/// Poses of the tip for all rows of `joints`.
fn tip_track(joints: &JointTrack, chain: &Chain) -> PoseTrack {
    let poses = joints.q.chunks(chain.dof()).map(|q| chain.forward(q));
    let poses = poses.map(|pose| (pose.translation.vector, pose.rotation));
    test_motion::pose_track(&joints.t_s, poses)
}

fn tcp() -> Pose {
    pose([0.02, -0.01, 0.15], Default::default())
}

#[test]
fn half_a_run_as_logged_shows_a_change_and_not_an_encoding() {
    let chain = ur5e();
    let logged = view(&chain, tcp(), <[f64]>::to_vec);
    assert!(!half_follows_as_logged(&logged));
    let mut changed = logged.clone();
    changed.xyz[40..].iter_mut().for_each(|xyz| xyz.z += 0.12);
    assert!(half_follows_as_logged(&changed));
    for factor in [0.98, 0.5, -1.0] {
        let scaled = |q: &[f64]| vec![q[0], q[1], q[2] / factor, q[3], q[4], q[5]];
        assert!(!half_follows_as_logged(&view(&chain, tcp(), scaled)));
    }
}

#[test]
fn one_misinterpreted_joint_is_found_for_any_scale_and_zero() {
    let chain = ur5e();
    for (joint, factor, zero) in [
        (2, -1.0, 0.0),
        (1, 0.5, 0.0),
        (3, TAU / 4096.0, -PI),
        (0, 0.011, 0.7),
        (4, 1.0, 2.0 * TAU / 3.0 - TAU),
        (5, -1.0, 0.0),
    ] {
        let view = view(&chain, tcp(), |q| {
            let mut logged = q.to_vec();
            logged[joint] = (q[joint] - zero) / factor;
            logged
        });
        let map = find_map(&view, InterpretationKind::OneJoint, FreeFrames::Tool);
        let expected = JointMap::as_logged(6).with(joint, factor, zero);
        for (own, truth) in map.factor.iter().zip(&expected.factor) {
            assert!((own / truth - 1.0).abs() < 1e-2, "{map:?}, not {expected:?}");
        }
        assert_near(&map.zero, &expected.zero, 0.02);
    }
}

#[test]
fn all_joints_in_another_unit_are_one_interpretation() {
    let chain = ur5e();
    for factor in [1f64.to_radians(), TAU / 65536.0, -1.0, 1.0 / 101.0] {
        let view = view(&chain, tcp(), |q| q.iter().map(|q| q / factor).collect());
        let map = find_map(&view, InterpretationKind::OneJoint, FreeFrames::Tool);
        assert_near(&map.factor.iter().map(|f| f / factor).collect::<Vec<_>>(), &[1.0; 6], 1e-2);
    }
}

#[test]
fn two_joints_or_an_order_and_one_joint_are_found() {
    let chain = ur5e();
    let two = view(&chain, tcp(), |q| vec![q[0], q[1] - 1.9, -q[2], q[3], q[4], q[5]]);
    let map = find_map(&two, InterpretationKind::TwoJoints, FreeFrames::Tool);
    assert_near(&map.zero, &[0.0, 1.9, 0.0, 0.0, 0.0, 0.0], 0.02);
    assert_near(&map.factor, &[1.0, 1.0, -1.0, 1.0, 1.0, 1.0], 1e-6);

    let order = view(&chain, Pose::identity(), |q| vec![q[2], q[1], q[0], -q[3], q[4], q[5]]);
    let map = find_map(&order, InterpretationKind::OrderAndOneJoint, FreeFrames::Tool);
    assert_eq!(map.from, [2, 1, 0, 3, 4, 5]);
    assert_near(&map.factor, &[1.0, 1.0, 1.0, -1.0, 1.0, 1.0], 1e-6);
}

#[test]
fn joints_are_interpreted_in_an_unknown_world_frame() {
    let chain = ur5e();
    let mut view = view(&chain, tcp(), |q| vec![q[0], -q[1], q[2], q[3], q[4], q[5]]);
    let world = pose([1.0, -2.0, 0.3], rotation_from_rotvec(Vec3::new(0.3, 0.1, 2.0)));
    for (xyz, rotation) in view.xyz.iter_mut().zip(view.rotation.as_mut().expect("rotations")) {
        let moved = world * Pose::from_parts((*xyz).into(), *rotation);
        (*xyz, *rotation) = (moved.translation.vector, moved.rotation);
    }
    let map = find_map(&view, InterpretationKind::OneJoint, FreeFrames::Both);
    assert_near(&map.factor, &[1.0, -1.0, 1.0, 1.0, 1.0, 1.0], 1e-6);
}

#[test]
fn correct_or_unfittable_joints_give_no_interpretation() {
    let chain = ur5e();
    let right = view(&chain, tcp(), <[f64]>::to_vec);
    let coupled = view(&chain, Pose::identity(), |q| {
        vec![q[0], q[1], q[2], q[3], q[4] + 0.6 * q[3], q[5] - 0.5 * q[0]]
    });
    for view in [right, coupled] {
        for kind in InterpretationKind::ALL {
            assert!(matches!(
                search_kind(&view, kind, FreeFrames::Tool, MOST),
                SearchOutcome::Nothing
            ));
        }
    }
}

#[test]
fn candidate_orders_of_many_joints_are_bounded() {
    let names: Vec<String> = (0..30).map(|joint| format!("joint_{joint}")).collect();
    assert_eq!(candidate_orders(&names[..4], 7).len(), 24);
    assert!(candidate_orders(&names, 7).len() < 500);
}

#[test]
fn angles_are_normalized_to_half_a_turn() {
    for (angle, expected) in [(3.5, 3.5 - TAU), (-3.5, TAU - 3.5), (PI, PI), (-PI, PI), (0.2, 0.2)]
    {
        assert!((angle - TAU * half_turns(angle) - expected).abs() < 1e-12);
    }
}

#[test]
fn a_coupled_pair_is_identified_with_its_factor() {
    let chain = ur5e();
    for (joint, by, factor) in [(2, 1, 1.0), (2, 1, -1.0), (5, 4, 0.05), (4, 3, -0.02)] {
        let view = view(&chain, tcp(), |q| {
            let mut logged = q.to_vec();
            logged[joint] -= factor * q[by];
            logged
        });
        let most = ResidualSize { m: 5e-4, rad: Some(1e-3) };
        let SearchOutcome::Found(find_map) =
            search_kind(&view, InterpretationKind::Coupled, FreeFrames::Tool, most)
        else {
            panic!("{factor} of joint {by} in joint {joint} is not found")
        };
        let coupling = find_map.map.coupling.expect("a coupling");
        assert_eq!((coupling.joint, coupling.by), (joint, by));
        assert!((coupling.factor - factor).abs() < 1e-3, "{coupling:?}");
    }
}

/// A pick motion: the arm dwells at one place for most of the time.
#[test]
fn samples_of_an_arm_that_dwells_show_other_places() {
    const DWELL_ROWS: usize = 400;
    let chain = ur5e();
    let home = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0];
    let moves = |row: usize| match row.checked_sub(DWELL_ROWS) {
        Some(moving) => 0.5 * (1.0 - (TAU * moving as f64 / 100.0).cos()),
        None => 0.0,
    };
    let rows: Vec<Vec<f64>> =
        (0..DWELL_ROWS + 100).map(|row| home.map(|q| q + moves(row)).to_vec()).collect();
    let t_s: Vec<f64> = (0..rows.len()).map(|row| 0.01 * row as f64).collect();
    let rates = (1..=rows.len()).map(|row| {
        let rate = 100.0 * (moves(row.min(rows.len() - 1)) - moves(row - 1));
        [rate; 6]
    });
    let joints = JointTrack {
        t_s,
        dof: chain.dof(),
        qd: rates.flatten().collect(),
        q: rows.concat(),
        noise: Vec::new(),
    };
    let track = tip_track(&joints, &chain);
    let stream = test_motion::tip_stream(&track, &chain);
    let comparison =
        JointComparison { joints: &joints, stream: &stream, metres: 1.0, max_lag_s: 0.0 };
    let samples = comparison.samples(0.0);
    assert!(samples.xyz.len() >= JOINT_ENCODING_SAMPLES / 2, "{} samples", samples.xyz.len());
    assert!(spread(&samples.xyz) > 0.2 * spread(&track.xyz), "{} m", spread(&samples.xyz));
}

#[test]
fn a_joint_reversed_among_degrees_is_multiplied_by_minus_one() {
    const REVERSED: usize = 3;
    let (joints, chain) = test_motion::arm();
    let track = tip_track(&joints, &chain);
    let mut logged = joints.clone();
    for values in [&mut logged.q, &mut logged.qd] {
        values.iter_mut().for_each(|value| *value = value.to_degrees());
        values.iter_mut().skip(REVERSED).step_by(6).for_each(|value| *value = -*value);
    }
    let found = diagnose_arm(&logged, &[test_motion::tip_stream(&track, &chain)], 1.0);
    let encoding = found.joints.encoding.expect("an encoding");
    assert!(encoding.is_in_degrees);
    let [reversed] = encoding.unit_errors.as_slice() else { panic!("{:?}", encoding.unit_errors) };
    assert_eq!(reversed.column, REVERSED);
    assert!((reversed.factor + 1.0).abs() < 1e-3, "{reversed:?}");
}

#[test]
fn some_joints_in_degrees_are_found_beside_others_in_radians() {
    const IN_DEGREES: [usize; 2] = [1, 4];
    let (mut joints, chain) = test_motion::arm();
    let track = tip_track(&joints, &chain);
    for values in [&mut joints.q, &mut joints.qd] {
        for row in values.chunks_mut(6) {
            IN_DEGREES.into_iter().for_each(|joint| row[joint] = row[joint].to_degrees());
        }
    }
    let found = diagnose_arm(&joints, &[test_motion::tip_stream(&track, &chain)], 1.0);
    let errors = found.joints.encoding.expect("an encoding").unit_errors;
    let columns: Vec<usize> = errors.iter().map(|error| error.column).collect();
    assert_eq!(columns, IN_DEGREES, "{errors:?}");
    assert!(errors.iter().all(|error| (error.factor / 1f64.to_radians() - 1.0).abs() < 1e-3));
}

/// The forearm and the first wrist joint keep the tool's orientation.
#[test]
fn a_reversed_wrist_is_found_while_the_tool_keeps_its_orientation() {
    const REVERSED: usize = 3;
    let (mut joints, chain) = test_motion::arm();
    for (row, q) in joints.q.chunks_mut(6).enumerate() {
        let t_s = row as f64 * 0.008;
        let (lift, elbow) = (-1.4 + 0.3 * (0.7 * t_s).sin(), 1.6 + 0.4 * (1.1 * t_s).cos());
        q.copy_from_slice(&[0.3, lift, elbow, -1.9 - lift - elbow, -1.57, 0.2]);
    }
    joints.qd.fill(0.0);
    let mut random = Lcg::new();
    let poses = joints.q.chunks(6).map(|q| {
        let pose = chain.forward(q);
        let noise = rotation_from_rotvec(random.triple(2e-5).into());
        (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation * noise)
    });
    let track = test_motion::pose_track(&joints.t_s, poses);
    joints.q.iter_mut().skip(REVERSED).step_by(6).for_each(|q| *q = -*q);
    let period_s = 0.008;
    for at in 6..joints.q.len() {
        joints.qd[at] = (joints.q[at] - joints.q[at - 6]) / period_s;
    }
    let found = diagnose_arm(&joints, &[test_motion::tip_stream(&track, &chain)], 1.0);
    let errors = found.joints.encoding.expect("an encoding").unit_errors;
    let [reversed] = errors.as_slice() else { panic!("{errors:?}") };
    assert_eq!((reversed.column, reversed.factor.round()), (REVERSED, -1.0));
}
