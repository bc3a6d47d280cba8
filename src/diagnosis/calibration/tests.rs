//! Calibration of arms with known link deviations.

use super::*;
use ground::geometry::{Vec3, angle_between, pose, rotation_from_rotvec};
use ground::robot::catalogue;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

use super::parameters::distinguishable_axes;
use crate::model::measurement::pose_of_twist;

const NOISE_M: f64 = 2e-5;
const NOISE_RAD: f64 = 2e-5;
const LATENCY_S: f64 = 0.012;

struct Normal(rand_pcg::Pcg64);

impl Normal {
    fn next(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    fn triple(&mut self, scale: f64) -> Vec3 {
        Vec3::new(scale * self.next(), scale * self.next(), scale * self.next())
    }
}

struct Case {
    nominal: Robot,
    truth: Robot,
    /// Link deviations in the order of the parameters.
    values: Vec<f64>,
    base: LinkId,
    tip: LinkId,
    joints: JointTrack,
    t_s: Vec<f64>,
    poses: Vec<Pose>,
}

impl Case {
    /// UR5e with deviations of `link_m` (and 0.1° per mm), whose joints oscillate by `amplitude`.
    fn new(seed: u64, link_m: f64, seconds: f64, amplitude: [f64; 6]) -> Self {
        let mut normal = Normal(rand_pcg::Pcg64::seed_from_u64(seed));
        let nominal = catalogue::find("ur5e").expect("it is in the catalogue").clone();
        let [base, tip] = ["base", "tool0"].map(|name| nominal.link(name).expect("a link"));
        let path = nominal.link_path(base, tip).expect("a path");
        let mut values = Vec::new();
        let deviations: Vec<Pose> = (0..path.links.len())
            .map(|link| {
                let mut twist = [0.0; 6];
                for (first, scale) in [(0, link_m), (3, 1.745 * link_m)] {
                    for direction in distinguishable_axes(&path, link, first > 0) {
                        let value = scale * normal.next();
                        (0..3).for_each(|axis| twist[first + axis] += value * direction[axis]);
                        values.push(value);
                    }
                }
                pose_of_twist(&twist)
            })
            .collect();
        let truth = nominal.with_deviations(&path, &deviations, &[]);
        let mut joints = JointTrack { dof: 6, ..Default::default() };
        let at = |joint: usize, t_s: f64| {
            let (rate, phase) = (0.37 + 0.171 * joint as f64, 1.3 * joint as f64);
            let turn = rate * t_s + phase;
            let middle = [0.0, -1.4, 1.1, -0.8, -0.6, 0.2][joint];
            (middle + amplitude[joint] * turn.sin(), amplitude[joint] * rate * turn.cos())
        };
        for row in 0..(125.0 * seconds) as usize {
            let t_s = row as f64 / 125.0;
            joints.t_s.push(t_s);
            for joint in 0..6 {
                let (q, qd) = at(joint, t_s);
                joints.q.push(q);
                joints.qd.push(qd);
            }
        }
        let chain = truth.chain(base, tip).expect("a chain");
        let (mut t_s, mut poses) = (Vec::new(), Vec::new());
        for row in 4..(50.0 * seconds) as usize {
            let stamp = row as f64 * 0.02;
            let q: Vec<f64> = (0..6).map(|joint| at(joint, stamp - LATENCY_S).0).collect();
            let exact = chain.forward(&q);
            let mut logged = exact;
            logged.translation.vector += normal.triple(NOISE_M);
            logged.rotation = rotation_from_rotvec(normal.triple(NOISE_RAD)) * exact.rotation;
            t_s.push(stamp);
            poses.push(logged);
        }
        Self { nominal, truth, values, base, tip, joints, t_s, poses }
    }

    fn stream(&self) -> CalibrationStream<'_> {
        CalibrationStream {
            joints: &self.joints,
            columns: (0..6).collect(),
            base: self.base,
            tip: self.tip,
            t_s: self.t_s.clone(),
            poses: self.poses.clone(),
            excluded: [false; 3],
            is_rotation_excluded: false,
            latency_s: LATENCY_S + 1e-3,
            latency_is_free: true,
            skew: 0.0,
            reference: Pose::identity(),
            reference_freedom: FrameFreedom::Known,
            tool: Pose::identity(),
            tool_freedom: FrameFreedom::Known,
            held_out_group: None,
        }
    }

    fn calibrate(&self) -> ArmCalibration {
        calibrate_arm(&self.nominal, &[self.stream()], &[], &[]).expect("a calibration")
    }

    /// Log with another base frame and tool.
    fn elsewhere(&self, world: &Pose, tool: &Pose) -> CalibrationStream<'_> {
        CalibrationStream {
            poses: self.poses.iter().map(|pose| world * pose * tool).collect(),
            reference: *world,
            reference_freedom: FrameFreedom::Pose(0),
            tool: *tool,
            tool_freedom: FrameFreedom::Pose(0),
            ..self.stream()
        }
    }
}

/// Rms over the workspace, m and rad.
fn tip_difference(case: &Case, calibrate: &Robot) -> (f64, f64) {
    let chains =
        [&case.truth, calibrate].map(|robot| robot.chain(case.base, case.tip).expect("a chain"));
    let (mut m, mut rad) = (0.0, 0.0);
    for k in 0..400 {
        let q: Vec<f64> = (0..6)
            .map(|joint| 3.1 * (f64::from(k) * (1.1 + 0.37 * f64::from(joint))).sin())
            .collect();
        let [a, b] = chains.each_ref().map(|chain| chain.forward(&q));
        m += (a.translation.vector - b.translation.vector).norm_squared();
        rad += angle_between(&a.rotation, &b.rotation).powi(2);
    }
    ((m / 400.0).sqrt(), (rad / 400.0).sqrt())
}

const RICH: [f64; 6] = [1.9, 0.9, 1.3, 1.5, 1.6, 2.0];

#[test]
fn link_deviations_are_estimated_over_the_whole_workspace() {
    for seed in 0..3 {
        let case = Case::new(seed, 0.5e-3, 60.0, RICH);
        let calibrate = case.calibrate();
        let (before_m, _) = tip_difference(&case, &case.nominal);
        let (m, rad) = tip_difference(&case, &calibrate.robot);
        assert!(before_m > 1e-3 && m < 5e-6 && rad.to_degrees() < 0.001, "{before_m} {m} {rad}");
        assert!(
            m < 2.5 * calibrate.calibrated_uncertainty.m
                && m > 0.3 * calibrate.calibrated_uncertainty.m,
            "{m} {:?}",
            calibrate.calibrated_uncertainty
        );
        assert!((0.3e-3..0.9e-3).contains(&calibrate.link_m), "{}", calibrate.link_m);
        let stream = &calibrate.streams[0];
        let noise_m = 3f64.sqrt() * NOISE_M;
        assert!(stream.before.m > 5e-4 && (stream.after.m / noise_m - 1.0).abs() < 0.05);
        assert!((stream.held_out_after.m / noise_m - 1.0).abs() < 0.1, "{stream:?}");
        let latency = stream.latency_s.expect("it is free");
        assert!((latency.value - LATENCY_S).abs() < 5.0 * latency.std_error + 1e-6, "{latency:?}");
    }
}

#[test]
fn intervals_cover_the_truth_at_their_confidence() {
    let (mut inside, mut all) = (0, 0);
    let (mut parameters_inside, mut parameters) = (0, 0);
    for seed in 10..26 {
        let case = Case::new(seed, 0.3e-3, 20.0, RICH);
        let calibrate = case.calibrate();
        for (at, truth) in case.values.iter().enumerate() {
            let [low, high] = calibrate.value(at).interval(0.95);
            parameters_inside += usize::from((low..=high).contains(truth));
            parameters += 1;
        }
        // FK over the workspace.
        for k in 0..20 {
            let q: Vec<f64> = (0..6)
                .map(|joint| 2.9 * (f64::from(k) * 0.7 + 1.9 * f64::from(joint)).sin())
                .collect();
            let [truth, own] = [&case.truth, &calibrate.robot]
                .map(|robot| robot.chain(case.base, case.tip).expect("a chain").forward(&q));
            let error = truth.translation.vector - own.translation.vector;
            let spread = spread_at(&case, &calibrate, &q);
            inside += (0..3).filter(|&axis| error[axis].abs() < 1.96 * spread[axis]).count();
            all += 3;
        }
    }
    let share = inside as f64 / f64::from(all);
    let of_parameters = parameters_inside as f64 / f64::from(parameters);
    assert!((0.90..=0.99).contains(&share), "{share} {of_parameters}");
    assert!((0.92..=0.98).contains(&of_parameters), "{share} {of_parameters}");
}

/// Standard error of the tip position at `q`, by finite differences.
fn spread_at(case: &Case, calibrate: &ArmCalibration, q: &[f64]) -> [f64; 3] {
    const STEP: f64 = 1e-6;
    let path = case.nominal.link_path(case.base, case.tip).expect("a path");
    let at = |values: &[f64]| {
        let mut all = vec![[0.0; 6]; path.links.len()];
        for (one, value) in calibrate.parameters.iter().zip(values) {
            let first = if one.is_rotation { 3 } else { 0 };
            (0..3).for_each(|axis| all[one.link][first + axis] += one.direction[axis] * value);
        }
        let deviations: Vec<Pose> = all.iter().map(|twist| pose_of_twist(twist)).collect();
        let robot = case.nominal.with_deviations(&path, &deviations, &[]);
        robot.chain(case.base, case.tip).expect("a chain").forward(q).translation.vector
    };
    let middle = at(&calibrate.values);
    let slopes: Vec<Vec3> = (0..calibrate.values.len())
        .map(|parameter| {
            let mut values = calibrate.values.clone();
            values[parameter] += STEP;
            (at(&values) - middle) / STEP
        })
        .collect();
    std::array::from_fn(|axis| {
        let slope = DVector::from_iterator(slopes.len(), slopes.iter().map(|slope| slope[axis]));
        slope.dot(&(&calibrate.covariance * &slope)).sqrt()
    })
}

#[test]
fn base_and_tool_frames_do_not_change_the_links() {
    let case = Case::new(3, 0.4e-3, 30.0, RICH);
    let tool = pose([0.05, 0.02, 0.2], rotation_from_rotvec(Vec3::new(-0.3, 0.8, 0.1)));
    let far = pose([1.3, -0.4, 0.7], rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0)));
    let places = [(Pose::identity(), tool), (far, tool), (far, Pose::identity())];
    let calibrate = places.map(|(world, tool)| {
        calibrate_arm(&case.nominal, &[case.elsewhere(&world, &tool)], &[], &[])
            .expect("a calibration")
    });
    let [a, b, c] = &calibrate;
    assert!(
        a.parameters == b.parameters && a.parameters.iter().all(|one| (1..6).contains(&one.link))
    );
    for (at, ((x, y), z)) in a.values.iter().zip(&b.values).zip(&c.values).enumerate() {
        let spread = a.value(at).std_error;
        assert!((x - y).abs() < 0.02 * spread, "{at}: {x} {y} {spread}");
        // Rotation noise acts on another lever.
        assert!((x - z).abs() < spread, "{at}: {x} {z} {spread}");
    }
}

#[test]
fn one_moving_joint_adds_little_to_the_nominal_model() {
    let case = Case::new(4, 0.5e-3, 30.0, [0.0, 0.0, 1.2, 0.0, 0.0, 0.0]);
    let calibrate = case.calibrate();
    assert!(
        calibrate.calibrated_uncertainty.m > 0.5 * calibrate.nominal_uncertainty.m,
        "{:?} {:?}",
        calibrate.calibrated_uncertainty,
        calibrate.nominal_uncertainty
    );
    let spans = &calibrate.streams[0].spans;
    assert!(spans[2] > 2.0 && spans.iter().filter(|span| **span < 1e-9).count() == 5, "{spans:?}");
    assert!(!calibrate.undetermined.is_empty());
}

#[test]
fn several_logs_give_one_estimate() {
    let [first, second] = [(); 2].map(|()| Case::new(5, 0.4e-3, 20.0, RICH));
    let one = first.calibrate();
    let world = pose([0.4, 0.1, -0.2], rotation_from_rotvec(Vec3::new(0.0, 0.3, 1.0)));
    let streams = [first.stream(), second.elsewhere(&world, &Pose::identity())];
    let both = calibrate_arm(&first.nominal, &streams, &[], &[]).expect("a calibration");
    assert!(
        both.calibrated_uncertainty.m < one.calibrated_uncertainty.m,
        "{:?} {:?}",
        both.calibrated_uncertainty,
        one.calibrated_uncertainty
    );
    assert!(both.streams[0].reference.is_none() && both.streams[1].reference.is_some());
}

#[test]
fn outliers_barely_change_the_calibration() {
    let mut case = Case::new(6, 0.4e-3, 40.0, RICH);
    let mut normal = Normal(rand_pcg::Pcg64::seed_from_u64(60));
    for at in (0..case.poses.len()).step_by(25) {
        case.poses[at].translation.vector += normal.triple(5e-3);
    }
    let (m, _) = tip_difference(&case, &case.calibrate().robot);
    assert!(m < 8e-6, "{m}");
}

#[test]
fn a_joint_zero_of_degrees_is_absorbed_by_the_origin() {
    let case = Case::new(7, 0.2e-3, 40.0, RICH);
    let mut off = case.joints.clone();
    off.q.chunks_exact_mut(6).for_each(|row| row[2] -= 0.03);
    let stream = CalibrationStream { joints: &off, ..case.stream() };
    let calibrate = calibrate_arm(&case.nominal, &[stream], &[2], &[]).expect("a calibration");
    let chains = [&case.truth, &calibrate.robot]
        .map(|robot| robot.chain(case.base, case.tip).expect("a chain"));
    let q = [0.3, -1.0, 0.9, -0.4, 1.1, 2.0];
    let mut reported = q;
    reported[2] -= 0.03;
    let error =
        chains[0].forward(&q).translation.vector - chains[1].forward(&reported).translation.vector;
    assert!(error.norm() < 8e-6, "{error}");
}

/// Configurations of `chain` that put the point `tool` of its tip at `socket`.
fn configurations_at(
    chain: &ground::robot::Chain,
    socket: Vec3,
    tool: Vec3,
    count: usize,
    noise_m: f64,
    normal: &mut Normal,
) -> Vec<Vec<f64>> {
    let mut jacobian = vec![[0.0; 6]; chain.dof()];
    let mut found = Vec::new();
    while found.len() < count {
        let at = socket + normal.triple(noise_m);
        let mut q: Vec<f64> = (0..chain.dof()).map(|_| 0.9 * normal.next()).collect();
        let mut error = f64::INFINITY;
        for _ in 0..50 {
            let tip = chain.forward_with_jacobian(&q, &mut jacobian);
            let lever = tip.rotation * tool;
            let residual = at - (tip.translation.vector + lever);
            error = residual.norm();
            let slopes = nalgebra::Matrix3xX::from_columns(
                &jacobian
                    .iter()
                    .map(|&[x, y, z, rx, ry, rz]| {
                        Vec3::new(x, y, z) + Vec3::new(rx, ry, rz).cross(&lever)
                    })
                    .collect::<Vec<_>>(),
            );
            let square: nalgebra::Matrix3<f64> =
                &slopes * slopes.transpose() + 1e-6 * nalgebra::Matrix3::identity();
            let Some(inverse) = square.try_inverse() else { break };
            let step = slopes.transpose() * (inverse * residual);
            q.iter_mut().zip(step.iter()).for_each(|(q, step)| *q += step.clamp(-0.3, 0.3));
        }
        if error < 1e-9 && q.iter().all(|q| q.abs() < 2.9) {
            found.push(q);
        }
    }
    found
}

fn track_of(rows: &[Vec<f64>]) -> JointTrack {
    let mut track = JointTrack { dof: rows[0].len(), ..Default::default() };
    for (at, row) in rows.iter().enumerate() {
        for within_s in [0.0, 0.5] {
            track.t_s.push(at as f64 + within_s);
            track.q.extend(row);
        }
    }
    track.qd = vec![0.0; track.q.len()];
    track
}

const SOCKETS: [[f64; 3]; 6] = [
    [0.5, 0.0, 0.02],
    [0.5, 0.05, 0.02],
    [0.35, 0.35, 0.1],
    [0.35, 0.4, 0.1],
    [0.4, -0.35, 0.25],
    [0.4, -0.3, 0.25],
];

#[test]
fn a_point_at_rest_calibrates_links_and_zeros_without_a_sensor() {
    const NOISE_M: f64 = 5e-5;
    const ZERO_RAD: f64 = 0.014;
    let mut normal = Normal(rand_pcg::Pcg64::seed_from_u64(11));
    let nominal = catalogue::find("franka_fer").expect("it is in the catalogue").clone();
    let base = nominal.root();
    let tip = nominal.link("fer_link8").or(nominal.leaf_links().last()).expect("a link");
    let path = nominal.link_path(base, tip).expect("a path");
    let deviations: Vec<Pose> = (0..path.links.len())
        .map(|link| {
            let is_end = link == 0 || link + 1 == path.links.len();
            let scale = if is_end { 0.0 } else { 1.0 };
            let mut twist = [0.0; 6];
            for (first, size) in [(0, 0.4e-3), (3, 0.7e-3)] {
                for direction in distinguishable_axes(&path, link, first > 0) {
                    let value = scale * size * normal.next();
                    (0..3).for_each(|axis| twist[first + axis] += value * direction[axis]);
                }
            }
            pose_of_twist(&twist)
        })
        .collect();
    let mut zeros = vec![0.0; path.axes.len()];
    zeros[3] = ZERO_RAD;
    let truth = nominal.with_deviations(&path, &deviations, &zeros);
    let chain = truth.chain(base, tip).expect("a chain");
    let tool = Vec3::new(0.01, -0.02, 0.12);
    let tracks: Vec<JointTrack> = SOCKETS
        .iter()
        .map(|&socket| {
            let rows = configurations_at(&chain, socket.into(), tool, 30, NOISE_M, &mut normal);
            track_of(&rows)
        })
        .collect();
    let stream = |(s, joints)| -> CalibrationStream<'_> {
        let joints: &JointTrack = joints;
        CalibrationStream {
            joints,
            columns: (0..joints.dof).collect(),
            base,
            tip,
            t_s: (0..30).map(|at| f64::from(at) + 0.25).collect(),
            poses: vec![Pose::identity(); 30],
            excluded: [false; 3],
            is_rotation_excluded: true,
            latency_s: 0.0,
            latency_is_free: false,
            skew: 0.0,
            reference: Pose::identity(),
            reference_freedom: FrameFreedom::Position(s),
            tool: Pose::identity(),
            tool_freedom: FrameFreedom::Position(0),
            held_out_group: Some(s / 2),
        }
    };
    let streams: Vec<CalibrationStream> = tracks.iter().enumerate().map(stream).collect();
    let distances: Vec<PointDistance> = [0, 2, 4]
        .into_iter()
        .map(|s| PointDistance { streams: [s, s + 1], distance_m: 0.05, std_error_m: 1e-4 })
        .collect();
    let found = calibrate_arm(&nominal, &streams, &[], &distances).expect("a calibration");
    assert!(found.remaining_step.is_none(), "{:?}", found.remaining_step);
    for one in &found.streams {
        let noise_m = 3f64.sqrt() * NOISE_M;
        assert!(one.before.m > 1e-3 && one.after.m < 1.1 * noise_m, "{one:?}");
        assert!(one.held_out_before.m > 1e-3 && one.held_out_after.m < 2.0 * noise_m, "{one:?}");
    }
    assert!(found.distances_m.iter().all(|[_, after]| (after - 0.05).abs() < 1e-4));
    // Without distances, the nominal lengths determine the scale.
    let unscaled = calibrate_arm(&nominal, &streams, &[], &[]).expect("a calibration");
    let point =
        |s: usize| unscaled.streams[s].reference.expect("free").inverse().translation.vector;
    for s in [0, 2, 4] {
        let distance_m = (point(s) - point(s + 1)).norm();
        assert!((distance_m - 0.05).abs() < 0.3e-3, "{distance_m}");
    }
    // Another place, with the point that was estimated.
    let elsewhere = configurations_at(&chain, Vec3::new(0.3, 0.1, 0.5), tool, 30, 0.0, &mut normal);
    let calibrated = found.robot.chain(base, tip).expect("a chain");
    let rows = || elsewhere.iter().map(Vec::as_slice);
    let [before, after] = [&nominal.chain(base, tip).expect("a chain"), &calibrated]
        .map(|chain| FixedPoint::fit(chain, rows()).expect("rows").rms_m());
    assert!(before > 1e-3 && after < 0.2e-3, "{before} {after}");
}

#[test]
fn points_in_one_tracker_frame_share_it() {
    let case = Case::new(8, 0.4e-3, 20.0, RICH);
    let world = pose([1.3, -0.4, 0.7], rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.0)));
    let nests = [[0.05, 0.0, 0.1], [-0.04, 0.06, 0.08], [0.0, -0.05, 0.15]];
    let near = pose([1.31, -0.41, 0.7], rotation_from_rotvec(Vec3::new(0.4, -1.1, 2.01)));
    let streams: Vec<CalibrationStream> = nests
        .iter()
        .enumerate()
        .map(|(s, nest)| {
            let tool = pose(*nest, rotation_from_rotvec(Vec3::zeros()));
            CalibrationStream {
                is_rotation_excluded: true,
                reference: near,
                reference_freedom: FrameFreedom::Pose(0),
                tool: Pose::identity(),
                tool_freedom: FrameFreedom::Position(s),
                ..case.elsewhere(&world, &tool)
            }
        })
        .collect();
    let several = calibrate_arm(&case.nominal, &streams, &[], &[]).expect("a calibration");
    let one = calibrate_arm(&case.nominal, &streams[..1], &[], &[]).expect("a calibration");
    let tool = several.streams[0].tool.expect("an estimated point");
    let m = distance_difference_m(&case, &several.robot, nests[0].into(), tool.translation.vector);
    assert!(m < 15e-6, "{m}");
    assert!(
        several.calibrated_uncertainty.m < 0.8 * one.calibrated_uncertainty.m,
        "{:?} {:?}",
        several.calibrated_uncertainty,
        one.calibrated_uncertainty
    );
    let references: Vec<_> = several.streams.iter().map(|one| one.reference).collect();
    assert!(references.iter().all(|one| *one == references[0]));
}

/// Rms difference of the distances that a point of the tool travels, m: `truth` on the true arm, `found` on `robot`.
fn distance_difference_m(case: &Case, robot: &Robot, truth: Vec3, found: Vec3) -> f64 {
    let chains =
        [&case.truth, robot].map(|robot| robot.chain(case.base, case.tip).expect("a chain"));
    let at = |k: usize| -> Vec<f64> {
        (0..6).map(|joint| 2.9 * ((k * 7 + 3 * joint) as f64 * 0.61).sin()).collect()
    };
    let squares: Vec<f64> = (0..200)
        .map(|k| {
            let [a, b] = [(&chains[0], truth), (&chains[1], found)].map(|(chain, point)| {
                let [one, other] = [2 * k, 2 * k + 1].map(|k| chain.forward(&at(k)));
                let of = |tip: Pose| tip.translation.vector + tip.rotation * point;
                (of(one) - of(other)).norm()
            });
            (a - b).powi(2)
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}
