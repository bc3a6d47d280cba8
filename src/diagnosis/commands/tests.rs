use super::line::detect_lines;
use super::*;
use crate::test_motion::noise;
use ground::geometry::{
    Convention, Pose, pose, rotation_from_rotvec, rotation_from_rpy, rotvec_from_rotation,
};

/// Smooth step over one second.
fn blend(t_s: f64, from_s: f64) -> f64 {
    let u = (t_s - from_s).clamp(0.0, 1.0);
    u * u * u * (10.0 + u * (-15.0 + 6.0 * u))
}

fn times(rate_hz: f64) -> Vec<f64> {
    (0..(6.0 * rate_hz) as usize).map(|row| row as f64 / rate_hz).collect()
}

/// A UR5e that turns all joints by 0.3 rad between 1 s and 2 s, and back between 4 s and 5 s.
fn joints_at(t_s: f64) -> [f64; 6] {
    let part = blend(t_s, 1.0) - blend(t_s, 4.0);
    [0.0, -1.6, 1.5, -1.5, -1.6, 0.0].map(|home| home + 0.3 * part)
}

fn arm() -> (JointTrack, Chain, Vec<usize>) {
    let (_, chain) = crate::test_motion::arm();
    let t_s = times(125.0);
    let q: Vec<f64> = t_s.iter().flat_map(|&t_s| joints_at(t_s)).collect();
    let slope = |t_s: f64| {
        let (before, after) = (joints_at(t_s - 1e-4), joints_at(t_s + 1e-4));
        std::array::from_fn::<f64, 6, _>(|joint| (after[joint] - before[joint]) / 2e-4)
    };
    let qd = t_s.iter().flat_map(|&t_s| slope(t_s)).collect();
    (JointTrack { t_s, dof: 6, q, qd, noise: Vec::new() }, chain, (0..6).collect())
}

/// Commands `pose_at` at `t_s`.
fn diagnosed(t_s: Vec<f64>, pose_at: impl Fn(&Chain, f64) -> Pose) -> CommandDiagnosis {
    let (joints, chain, columns) = arm();
    let poses = t_s.iter().map(|&t_s| pose_at(&chain, t_s)).collect();
    let commands = Commands { series: PoseSeries { t_s, poses }, joints: Vec::new() };
    let witness = PoseSeries::from_joints(&joints, &chain, &columns);
    let arm = CommandedArm { joints: &joints, chain: &chain, columns: &columns };
    diagnose_commands(&commands, &arm, &[witness], 1.0).expect("it rests")
}

fn aside(by_m: f64) -> Pose {
    Pose::translation(0.0, by_m, 0.0)
}

#[test]
fn a_streamed_command_is_compared_at_every_rest_with_its_delay() {
    let found =
        diagnosed(times(50.0), |chain, t_s| aside(0.003) * chain.forward(&joints_at(t_s + 0.08)));
    let following = found.tracking.expect("it is followed");
    assert!((following.delay_s - 0.08).abs() < 5e-3, "{following:?}");
    assert!(
        (following.compensated.0 - 0.003).abs() < 1e-3 && following.rms.0 > 0.01,
        "{following:?}"
    );
    assert_eq!(found.rest_errors[0].len(), 3, "{:?}", found.rest_errors[0]);
    for gap in &found.rest_errors[0] {
        assert!((gap.distance_m.norm.value - 0.003).abs() < 1e-5, "{gap:?}");
        assert!(gap.angle_rad.norm.value < 1e-5 && gap.distance_m.p_value < 1e-6, "{gap:?}");
    }
    assert!(found.lines.is_empty(), "an arc is not a line");
}

#[test]
fn only_goals_that_the_arm_reached_count() {
    let reached = |chain: &Chain| chain.forward(&joints_at(3.0));
    // The arm reaches one goal, the other is far from its next rest.
    let found = diagnosed(vec![0.6, 3.8], |chain, t_s| match t_s {
        t_s if t_s < 1.0 => aside(0.004) * reached(chain),
        _ => aside(0.3) * reached(chain),
    });
    assert_eq!((found.goals, found.not_reached, found.rest_errors[0].len()), (2, 1, 1));
    assert!((found.rest_errors[0][0].distance_m.norm.value - 0.004).abs() < 1e-5);
    assert!(found.nearest_miss.is_some_and(|(m, _)| m > 0.1), "{found:?}");
    let found = diagnosed(vec![5.2], |chain, _| aside(0.004) * chain.forward(&joints_at(5.5)));
    assert_eq!((found.goals, found.not_reached, found.rest_errors[0].len()), (1, 1, 0));
}

#[test]
fn a_constant_joint_error_is_reported() {
    let (joints, chain, columns) = arm();
    let t_s = times(50.0);
    let q: Vec<f64> = t_s
        .iter()
        .flat_map(|&t_s| {
            let mut q = joints_at(t_s);
            q[2] += 0.005;
            q
        })
        .collect();
    let names: Vec<String> = (0..6).map(|joint| format!("joint_{}", 6 - joint)).collect();
    let order = infer_joint_order(&t_s, &q, &joints, &names, &columns).expect("it follows");
    assert_eq!(order, columns);
    let commands = Commands::from_joints(&t_s, &order, &q, &joints, (&chain, &columns));
    let witness = PoseSeries::from_joints(&joints, &chain, &columns);
    let arm = CommandedArm { joints: &joints, chain: &chain, columns: &columns };
    let found = diagnose_commands(&commands, &arm, &[witness], 1.0).expect("it rests");
    for gap in &found.rest_errors[0] {
        let off: Vec<f64> = gap.joints.iter().map(|(_, off)| off.value).collect();
        assert!((off[2] + 0.005).abs() < 1e-9 && off[1].abs() < 1e-9, "{off:?}");
        assert!((gap.angle_rad.norm.value - 0.005).abs() < 1e-5, "{gap:?}");
    }
    let far: Vec<f64> = q.iter().map(|q| q + 1.0).collect();
    assert_eq!(infer_joint_order(&t_s, &far, &joints, &names, &columns), None);
}

#[test]
fn a_reversed_scaled_and_displaced_joint_is_mapped_at_its_delay() {
    let (joints, ..) = arm();
    let t_s = times(50.0);
    let commanded = |t_s: f64| {
        let q = joints_at(t_s + 0.1);
        [-q[0], q[1] / 2.0, q[2] + 1.57, q[3], q[4], q[5]]
    };
    let q: Vec<f64> = t_s.iter().flat_map(|&t_s| commanded(t_s)).collect();
    let delays = estimate_joint_delays(&t_s, &[0, 1, 2, 3, 4, 5], &q, &joints, 1.0);
    let expected = [Some((-1.0, 0.0)), Some((2.0, 0.0)), Some((1.0, -1.57)), None, None, None];
    for (delay, expected) in delays.iter().zip(expected) {
        let response = delay.response.as_ref().expect("it follows");
        assert!((response.delay_s.value - 0.1).abs() < 5e-3, "{delay:?}");
        assert_eq!(response.gain < 0.0, delay.joint == Some(0), "{delay:?}");
        assert_eq!(delay.map.is_some(), expected.is_some(), "{delay:?}");
        let Some((map, (gain, offset))) = delay.map.zip(expected) else { continue };
        assert!((map.gain.value - gain).abs() < 0.01, "{delay:?}");
        assert!((map.offset.value - offset).abs() < 0.01, "{delay:?}");
    }
}

#[test]
fn goals_of_a_reversed_joint_are_mapped_at_the_rests() {
    // Moves to the next place for one second, then rests for one.
    let place = |step: usize| 0.5 * [0.0, 1.0, -0.6, 0.4, -1.0, 0.7, 0.2][step.min(6)];
    let (mut joints, chain, columns) = arm();
    let at = |t_s: f64| {
        let step = (t_s / 2.0) as usize;
        let part = blend(t_s, 2.0 * step as f64);
        let from = if step == 0 { place(0) } else { place(step - 1) };
        from + part * (place(step) - from)
    };
    joints.t_s = (0..1750).map(|row| row as f64 / 125.0).collect();
    let states = |t_s: f64| std::array::from_fn::<f64, 6, _>(|joint| at(t_s) - joint as f64 / 5.0);
    joints.q = joints.t_s.iter().flat_map(|&t_s| states(t_s)).collect();
    joints.qd = vec![0.0; joints.q.len()];
    let t_s: Vec<f64> = (0..7).map(|step| 2.0 * step as f64).collect();
    let goals = |&t_s: &f64| {
        let q = states(t_s + 1.9);
        [-q[0], q[1], q[2], q[3], q[4], q[5]]
    };
    let q: Vec<f64> = t_s.iter().flat_map(goals).collect();
    let commands = Commands::from_joints(&t_s, &columns, &q, &joints, (&chain, columns.as_slice()));
    let witness = PoseSeries::from_joints(&joints, &chain, &columns);
    let arm = CommandedArm { joints: &joints, chain: &chain, columns: &columns };
    let found = diagnose_commands(&commands, &arm, &[witness], 1.0).expect("it rests");
    let [(0, map)] = found.goal_maps.as_slice() else { panic!("{:?}", found.goal_maps) };
    assert!((map.gain.value + 1.0).abs() < 1e-6 && map.offset.value.abs() < 1e-3, "{map:?}");
}

#[test]
fn a_tool_rotation_is_distinguished_from_a_base_shift() {
    let gap = |commanded: Pose, measured: Pose| RestError {
        from_s: 0.0,
        to_s: 1.0,
        commanded,
        measured,
        distance_m: length_of(Vec3::x(), 0.0),
        angle_rad: length_of(Vec3::zeros(), 0.0),
        joints: Vec::new(),
    };
    let places =
        [0.0, 0.7, 1.4].map(|yaw| pose([0.3, 0.1, 0.2], rotation_from_rpy([0.2, 0.1, yaw])));
    let by_tool = RestErrorSpread::from_rests(&places.map(|place| gap(place * aside(0.1), place)));
    let by_tool = by_tool.expect("three rests");
    assert!(by_tool.in_tool.0 < 1e-12 && by_tool.in_base.0 > 0.03, "{by_tool:?}");
    let by_base = RestErrorSpread::from_rests(&places.map(|place| gap(aside(0.1) * place, place)));
    let by_base = by_base.expect("three rests");
    assert!(by_base.in_base.0 < 1e-12 && by_base.in_tool.0 > 0.03, "{by_base:?}");
}

/// Commands between two poses, with orientation `turned` per fraction of the path.
fn line_of(from: Pose, to: Pose, turned: impl Fn(f64) -> Rotation) -> CommandedLine {
    let t_s = times(50.0);
    let at = |t_s: f64| {
        let part = blend(t_s, 2.0);
        let xyz = from.translation.vector.lerp(&to.translation.vector, part);
        Pose::from_parts(xyz.into(), turned(part))
    };
    let poses = t_s.iter().map(|&t_s| at(t_s)).collect();
    let series = PoseSeries { t_s, poses };
    let holds = constant_commands(&series, true, 6.0);
    detect_lines(&series, &holds, &[], &[]).pop().expect("a line")
}

#[test]
fn a_wrong_orientation_interpolation_is_identified() {
    let ends = [[0.2, 0.1, 0.3], [-0.6, 0.9, 1.2]].map(rotation_from_rpy);
    let (from, to) = (pose([0.3, 0.0, 0.4], ends[0]), pose([0.4, 0.2, 0.3], ends[1]));
    let turn = rotvec_from_rotation(&(ends[0].inverse() * ends[1]));
    let slerp = |part: f64| ends[0] * rotation_from_rotvec(turn * part);
    let by_numbers = |convention: Convention| {
        let [a, b] = ends.map(|rotation| convention.numbers(&rotation));
        move |part: f64| {
            convention.rotation(std::array::from_fn(|at| a[at] + part * (b[at] - a[at])))
        }
    };
    let line = line_of(from, to, slerp);
    assert!(line.command_rad < 1e-9 && line.interpolated.is_none(), "{line:?}");
    assert!((line.turn_rad - turn.norm()).abs() < 1e-9);

    let line = line_of(from, to, by_numbers(Convention::RPY));
    assert_eq!(line.interpolated.as_deref(), Some("euler:xyz"), "{line:?}");
    assert!(line.command_rad > 0.02 && line.command_off_axis_rad > 0.01, "{line:?}");
    let line = line_of(from, to, by_numbers(Convention::RotVec));
    assert_eq!(line.interpolated.as_deref(), Some("rotvec"), "{line:?}");

    // A quaternion blend stays on the slerp's arc with another speed profile.
    let half = turn.norm() / 2.0;
    let blended = |part: f64| 2.0 * (part * half.sin()).atan2(1.0 - part + part * half.cos());
    let line =
        line_of(from, to, |part| ends[0] * rotation_from_rotvec(turn.normalize() * blended(part)));
    assert_eq!(line.interpolated.as_deref(), Some("quaternion components"), "{line:?}");
    assert!(line.command_off_axis_rad < 1e-6, "{line:?}");
    let line = line_of(from, to, |part| slerp(part * part));
    assert!(line.interpolated.is_none() && line.command_rad > 0.2, "{line:?}");
    assert!(line.command_off_axis_rad < 1e-6, "{line:?}");
}

#[test]
fn a_command_lasts_until_the_next_or_until_the_stream_ends() {
    let here = Pose::identity();
    let goals = PoseSeries { t_s: vec![1.0, 3.0, 4.0], poses: vec![here, aside(0.1), aside(0.1)] };
    let spans = |series: &PoseSeries, is_streamed| -> Vec<(f64, f64)> {
        constant_commands(series, is_streamed, 9.0)
            .iter()
            .map(|hold| (hold.from_s, hold.to_s))
            .collect()
    };
    assert_eq!(spans(&goals, false), [(1.0, 3.0), (3.0, 9.0)]);
    let t_s: Vec<f64> =
        (0..80).map(|row| f64::from(row) * 0.05 + if row < 40 { 0.0 } else { 2.0 }).collect();
    let stream = PoseSeries { poses: vec![here; t_s.len()], t_s };
    assert!(is_streamed(&stream.t_s) && !is_streamed(&goals.t_s));
    let found = spans(&stream, true);
    assert_eq!(found.len(), 2, "{found:?}");
    assert!((found[0].1 - 1.95).abs() < 1e-9 && (found[1].1 - 5.95).abs() < 1e-9, "{found:?}");
}

#[test]
fn rests_are_detected_in_noise() {
    let (mut joints, ..) = arm();
    for size in [0.0, 2e-5, 5e-4] {
        joints.q.iter_mut().enumerate().for_each(|(row, q)| *q += size * noise(row));
        let found = detect_rests(&joints);
        assert_eq!(found.len(), 3, "{size}: {found:?}");
        assert!((1.9..2.3).contains(&found[1].from_s), "{size}: {found:?}");
        assert!((3.7..4.15).contains(&found[1].to_s), "{size}: {found:?}");
    }
}
