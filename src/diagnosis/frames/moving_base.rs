//! Arms with a moving base, whose poses are in a frame that does not move along.

use super::constant_frames::misfit_of_frames;
use super::position_fit::spread;
use crate::PoseStream;
use crate::encodings::position::metres_by_size;
use crate::latency::coarse::detect_pose_latency_changes;
use crate::latency::compensation::with_stamps;
use crate::latency::correlation::ArmSpeeds;
use crate::samples::sampling::FkSequence;
use crate::solver::noise::{Noise, rms};
use ground::geometry::{Pose, Vec3, mean_vector};
use ground::stats::Measured;
use ground::stats::thin::thinned;
use ground::stream::{JointTrack, Orientations};
use nalgebra::{Matrix2, Matrix3, Vector2};

const MAX_SAMPLES: usize = 300;
const MIN_SAMPLES: usize = 20;
/// For latency and lag.
const MAX_LAG_S: f64 = 0.5;
const INITIAL_STEP_S: f64 = 0.02;
const FINAL_STEP_S: f64 = 2e-5;
/// Separate latencies of transforms and poses, or one that varies, must reduce the residual to this fraction.
const MAX_RESIDUAL_RATIO: f64 = 0.7;
/// Separate latencies must differ by more than this.
const MIN_LAG_DIFFERENCE_S: f64 = 2e-3;
/// With a residual above the first fraction of the extent, joints may be misinterpreted. A lag must then
/// reduce it below the second fraction.
const MAX_RESIDUAL_SHARE: f64 = 0.1;
const MAX_RESIDUAL_RATIO_OFF_ARM: f64 = 0.5;

/// Latencies of poses in a moving frame and of its transforms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingBaseLag {
    /// Latency of the poses, s. If it varies, its smallest level, or 0 for a ramp.
    pub latency_s: f64,
    /// Latency of the transforms, s; `None` unless it differs from 0.
    pub transform_latency_s: Option<Measured>,
}

/// Estimates the latencies of the poses in a moving frame and of its transforms by FK: minimises the position residual of
/// `logged(s) = frame_from_base(s − λ) · FK(q(s − τ)) · tool` over λ and τ, which are equal unless separate values fit
/// clearly better. If the latency of the poses varies, the stamps are compensated first. `None` if too few samples have a
/// transform.
///
/// `stream` is transformed to the base with its moving frame at some latency.
pub fn estimate_moving_base_lag(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> Option<MovingBaseLag> {
    let constant = lag_with_stamps(joints, stream, max_lag_s);
    let varying = detect_pose_latency_changes(joints, stream, max_lag_s).and_then(|change| {
        let track = with_stamps(stream, &change.compensated(&stream.track.t_s));
        lag_with_stamps(joints, &PoseStream { track: &track, ..*stream }, max_lag_s)
    });
    let max_m = constant.map_or(f64::INFINITY, |(_, residual_m)| MAX_RESIDUAL_RATIO * residual_m);
    Some(varying.filter(|(_, residual_m)| *residual_m < max_m).or(constant)?.0)
}

/// The same at constant latencies, and the residual, m.
fn lag_with_stamps(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> Option<(MovingBaseLag, f64)> {
    let frame = stream.moving_frame?;
    let logged = frame.in_frame(stream.track);
    let rows = sample_rows(logged.t_s.len());
    // Positions of the poses in the tip, per row.
    let tool_offsets = |lag_s: f64, latency_s: f64| -> Vec<Option<Vec3>> {
        let mut fk = FkSequence::new(joints, stream.chain, stream.columns);
        let offset = |&row: &usize| {
            let t_s = logged.t_s[row];
            let at = frame.pose_at(t_s - lag_s)? * nalgebra::Point3::from(logged.xyz[row]);
            let arm = fk.at(t_s - latency_s)?;
            Some(arm.rotation.inverse() * (at.coords - arm.translation.vector))
        };
        rows.iter().map(offset).collect()
    };
    let cost = |lag_s: f64, latency_s: f64| -> f64 {
        let mut offsets: Vec<Vec3> = tool_offsets(lag_s, latency_s).into_iter().flatten().collect();
        if 2 * offsets.len() < rows.len() || offsets.len() < MIN_SAMPLES {
            return f64::INFINITY;
        }
        subtract_mean(&mut offsets);
        rms(&offsets)
    };
    let best = lags(max_lag_s).min_by(|&a, &b| cost(a, a).total_cmp(&cost(b, b)))?;
    let together = descend([best, 0.0], &|[both, _]| cost(both, both))[0];
    let min_cost_together = cost(together, together);
    if !min_cost_together.is_finite() {
        return None;
    }
    let [lag_s, latency_s] = descend([together, together], &|[lag, latency]| cost(lag, latency));
    let min_cost = cost(lag_s, latency_s);
    if min_cost > MAX_RESIDUAL_SHARE * spread(&stream.track.xyz)
        && min_cost > MAX_RESIDUAL_RATIO_OFF_ARM * cost(0.0, 0.0)
    {
        // No lag matches FK: joints may be misinterpreted, so keep the stamps.
        return Some((MovingBaseLag { latency_s: 0.0, transform_latency_s: None }, min_cost));
    }
    let is_on_time = (lag_s - latency_s).abs() < MIN_LAG_DIFFERENCE_S
        || min_cost > MAX_RESIDUAL_RATIO * min_cost_together;
    let late = || difference_of_lags([lag_s, latency_s], &tool_offsets);
    let transform_latency_s = (!is_on_time).then(late).flatten();
    let (latency_s, min_cost) = match transform_latency_s {
        None => (together, min_cost_together),
        Some(_) => (latency_s, min_cost),
    };
    Some((MovingBaseLag { latency_s, transform_latency_s }, min_cost))
}

/// Lags to try, s.
fn lags(max_lag_s: f64) -> impl Iterator<Item = f64> {
    let tried = (max_lag_s.min(MAX_LAG_S) / INITIAL_STEP_S) as i32;
    (-tried..=tried).map(|step| f64::from(step) * INITIAL_STEP_S)
}

fn subtract_mean(vectors: &mut [Vec3]) {
    let mean = mean_vector(&*vectors);
    vectors.iter_mut().for_each(|vector| *vector -= mean);
}

/// Latency minus lag, with its standard error from the derivatives of `tool_offsets` by both. `None` if the motion does
/// not distinguish them.
fn difference_of_lags(
    [lag_s, latency_s]: [f64; 2],
    tool_offsets: &impl Fn(f64, f64) -> Vec<Option<Vec3>>,
) -> Option<Measured> {
    /// For central differences.
    const STEP_S: f64 = 1e-3;
    const NOISE_FLOOR_M: f64 = 1e-6;
    const SHIFTS: [[f64; 2]; 5] =
        [[0.0, 0.0], [-STEP_S, 0.0], [STEP_S, 0.0], [0.0, -STEP_S], [0.0, STEP_S]];
    let shifted = SHIFTS.map(|[lag, latency]| tool_offsets(lag_s + lag, latency_s + latency));
    let of_row =
        |row: usize| shifted.iter().map(|offsets| offsets[row]).collect::<Option<Vec<Vec3>>>();
    let rows: Vec<Vec<Vec3>> = (0..shifted[0].len()).filter_map(of_row).collect();
    if rows.len() < MIN_SAMPLES {
        return None;
    }
    let about_mean = |of: &dyn Fn(&[Vec3]) -> Vec3| {
        let mut all: Vec<Vec3> = rows.iter().map(|row| of(row)).collect();
        subtract_mean(&mut all);
        all
    };
    let residual = about_mean(&|row| row[0]);
    let [by_lag, by_latency] = [(1, 2), (3, 4)]
        .map(|(before, after)| about_mean(&|row| (row[after] - row[before]) / (2.0 * STEP_S)));
    let dot = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
    let across = dot(&by_lag, &by_latency);
    let information =
        Matrix2::new(dot(&by_lag, &by_lag), across, across, dot(&by_latency, &by_latency));
    let noise = Noise::unweighted(&residual, NOISE_FLOOR_M);
    let along = Vector2::new(-1.0, 1.0);
    let variance = along.dot(&(information.try_inverse()? * along));
    let independent = noise.independent(residual.len());
    Some(Measured {
        value: latency_s - lag_s,
        std_error: noise.sigma * (variance * noise.inflation()).sqrt(),
        dof: (independent - 2.0).max(1.0),
    })
}

/// Pattern search (Hooke and Jeeves 1961): steps along axes and diagonals, halved when none improves.
fn descend(start: [f64; 2], cost: &dyn Fn([f64; 2]) -> f64) -> [f64; 2] {
    let directions = || {
        let signs = [1.0, 0.0, -1.0];
        let all = signs.into_iter().flat_map(move |x| signs.map(|y| [x, y]));
        all.filter(|direction| *direction != [0.0; 2])
    };
    let (mut at, mut min_cost, mut step) = (start, cost(start), INITIAL_STEP_S);
    while step > FINAL_STEP_S {
        let trials = directions().map(|[x, y]| [at[0] + step * x, at[1] + step * y]);
        let best = trials.map(|to| (cost(to), to)).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((less, to)) if less < min_cost => (at, min_cost) = (to, less),
            _ => step *= 0.5,
        }
    }
    at
}

/// Motion of a base in the frame of its poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseMotion {
    /// Largest distance from the mean, m.
    pub travel_m: f64,
    /// Largest rotation from the first, rad.
    pub turn_rad: f64,
}

/// Detects a base that moves in the frame of its poses, as on a vehicle, lift or rail. At some latency, the
/// base pose from FK must move in a plane or on a line and rotate about one axis only, with several times
/// more travel than deviation.
pub fn detect_base_motion(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> Option<BaseMotion> {
    /// An arm that differs from its model can deviate by less.
    const MIN_TRAVEL_M: f64 = 0.1;
    /// Travel to deviation.
    const MIN_TRAVEL_RATIO: f64 = 10.0;
    /// Between samples, as a fraction of the travel. A larger step is a base that was pushed once.
    const MAX_STEP_SHARE: f64 = 0.5;
    let Orientations::Rotations(rotations) = &stream.track.orientation else { return None };
    let rows = sample_rows(stream.track.t_s.len());
    // FK and logged poses.
    let pairs = |latency_s: f64| -> Vec<(Pose, Pose)> {
        let mut fk = FkSequence::new(joints, stream.chain, stream.columns);
        let pair = |&row: &usize| {
            let logged = Pose::from_parts(stream.track.xyz[row].into(), rotations[row]);
            Some((fk.at(stream.track.t_s[row] - latency_s)?, logged))
        };
        rows.iter().filter_map(pair).collect()
    };
    let bases = |latency_s: f64| -> Vec<Pose> {
        pairs(latency_s).into_iter().map(|(fk, logged)| logged * fk.inverse()).collect()
    };
    let distance_from_start = |latency_s: f64| -> f64 {
        let bases = bases(latency_s);
        match 2 * bases.len() < rows.len() || bases.len() < MIN_SAMPLES {
            true => f64::INFINITY,
            false => PlanarTravel::fit(&bases).deviation_m,
        }
    };
    let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
    let peaks = arm.lag_peaks(&stream.track.t_s, &stream.track.xyz, Some(rotations), max_lag_s);
    let near: Vec<f64> = peaks.iter().take(3).map(|peak| peak.lag_s).collect();
    let best = lags(max_lag_s)
        .chain(near.iter().copied())
        .min_by(|&a, &b| distance_from_start(a).total_cmp(&distance_from_start(b)))?;
    let latency_s = descend([best, 0.0], &|[latency_s, _]| distance_from_start(latency_s))[0];
    let bases = bases(latency_s);
    if bases.len() < MIN_SAMPLES {
        return None;
    }
    let travel = PlanarTravel::fit(&bases);
    let steps = bases.windows(2).map(|two| two[1].translation.vector - two[0].translation.vector);
    let largest_m = steps.map(|step| step.norm()).fold(0.0, f64::max);
    let mut away: Vec<Vec3> = bases.iter().map(|base| base.translation.vector).collect();
    subtract_mean(&mut away);
    let travel_m = away.iter().map(Vec3::norm).fold(0.0, f64::max);
    let is_fixed = |lag_s: f64| {
        let max_m = travel.along_m / MIN_TRAVEL_RATIO;
        is_base_fixed(pairs(lag_s), metres_by_size(joints, stream), max_m)
    };
    let moves = travel_m > MIN_TRAVEL_M
        && travel.along_m > MIN_TRAVEL_RATIO * travel.deviation_m
        && largest_m < MAX_STEP_SHARE * travel.along_m
        && !near.into_iter().chain([latency_s]).any(is_fixed);
    moves.then(|| {
        let turned = bases.iter().map(|base| base.rotation.angle_to(&bases[0].rotation));
        BaseMotion { travel_m, turn_rad: turned.fold(0.0, f64::max) }
    })
}

/// Whether a fixed base, with constant world frame and marker, has a position residual below `most_m` rms, in metres
/// or the unit whose spread matches FK. Otherwise a tool of constant orientation or a single rotation axis resembles a
/// moving base. `pairs` are FK and logged poses.
fn is_base_fixed(pairs: Vec<(Pose, Pose)>, unit_m: f64, most_m: f64) -> bool {
    let (fk, logged): (Vec<Pose>, Vec<Pose>) = pairs.into_iter().unzip();
    [1.0, unit_m].into_iter().any(|metres| {
        let scaled = |pose: &Pose| {
            Pose::from_parts((pose.translation.vector * metres).into(), pose.rotation)
        };
        let logged: Vec<Pose> = logged.iter().map(scaled).collect();
        misfit_of_frames(&fk, &logged)[0] < most_m * metres
    })
}

/// Travel in the plane normal to the rotation axis.
struct PlanarTravel {
    along_m: f64,
    deviation_m: f64,
}

impl PlanarTravel {
    /// From rotations to lengths.
    const LEVER_M: f64 = 0.5;
    /// Smaller values of `1 − σ_min` of the mean rotation are a constant orientation (5 mrad rms).
    const MIN_ROTATION_SPREAD: f64 = 1e-5;

    fn fit(poses: &[Pose]) -> Self {
        let n = poses.len().max(1) as f64;
        let rotations = poses.iter().map(|pose| pose.rotation.to_rotation_matrix().into_inner());
        let mean = rotations.sum::<Matrix3<f64>>() / n;
        let mut away: Vec<Vec3> = poses.iter().map(|pose| pose.translation.vector).collect();
        subtract_mean(&mut away);
        let scatter = away.iter().map(|away| away * away.transpose()).sum::<Matrix3<f64>>() / n;
        let squares = scatter.symmetric_eigenvalues();
        let svd = mean.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Self { along_m: 0.0, deviation_m: f64::INFINITY };
        };
        let turns = 1.0 - svd.singular_values.min();
        let (across, leans_rad) = if turns < Self::MIN_ROTATION_SPREAD {
            // Only positions define the plane.
            (squares.min(), (2.0 * turns).max(0.0).sqrt())
        } else {
            // Body axis that varies least, and its direction.
            let at = svd.singular_values.imax();
            let (up, axis) = (u.column(at).into_owned(), v_t.row(at).transpose());
            let leans = poses.iter().map(|pose| (pose.rotation * axis - up).norm_squared());
            let across = away.iter().map(|away| away.dot(&up).powi(2));
            (across.sum::<f64>() / n, (leans.sum::<f64>() / n).sqrt())
        };
        Self {
            along_m: (squares.sum() - across).max(0.0).sqrt(),
            deviation_m: across.max(0.0).sqrt().hypot(Self::LEVER_M * leans_rad),
        }
    }
}

fn sample_rows(rows: usize) -> Vec<usize> {
    thinned(0..rows, MAX_SAMPLES).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_motion::{arm, pose_track, tip_stream};
    use crate::{MovingFrame, PoseDiagnosis, diagnose_run};
    use ground::geometry::rotation_from_rpy;
    use ground::stream::PoseTrack;

    fn odometry(t_s: f64) -> Pose {
        let turn = rotation_from_rpy([0.0, 0.0, 0.4 * (0.27 * t_s).sin()]);
        Pose::from_parts([0.2 * t_s, 0.5 * (0.31 * t_s).sin(), 0.0].into(), turn)
    }

    /// Track in `frame(t)`, with a latency by stamp.
    fn track(
        joints: &JointTrack,
        chain: &ground::robot::Chain,
        latency_s: impl Fn(f64) -> f64,
        frame: impl Fn(f64) -> Pose,
    ) -> PoseTrack {
        let (mut poses, mut t_s) = (Vec::new(), Vec::new());
        let mut sequence = joints.sequence();
        for row in 100..1800 {
            let stamp = f64::from(row) * 0.01 + 0.003;
            let truth_s = stamp - latency_s(stamp);
            let (q, _) = sequence.at(truth_s).expect("joint states");
            let pose = frame(truth_s) * chain.forward(q);
            t_s.push(stamp);
            poses.push((pose.translation.vector, pose.rotation));
        }
        pose_track(&t_s, poses)
    }

    fn stream<'a>(track: &'a PoseTrack, chain: &'a ground::robot::Chain) -> PoseStream<'a> {
        PoseStream { reference_known: false, ..tip_stream(track, chain) }
    }

    /// Odometry with this latency, and the poses in it transformed to the base at their stamps.
    fn moving_frame(latency_s: f64) -> MovingFrame {
        let t_s: Vec<f64> = (0..1000).map(|row| f64::from(row) * 0.02).collect();
        let base_from_frame = t_s.iter().map(|t_s| odometry(t_s - latency_s).inverse()).collect();
        MovingFrame { t_s, base_from_frame, lag_s: 0.0 }
    }

    #[test]
    fn base_transforms_are_used_at_their_true_time() {
        let (joints, chain) = arm();
        let logged = track(&joints, &chain, |_| 0.03, odometry);
        let lag = |edge_s: f64| {
            let frame = moving_frame(edge_s);
            let in_base = frame.in_base(&logged);
            let stream = PoseStream { moving_frame: Some(&frame), ..stream(&in_base, &chain) };
            estimate_moving_base_lag(&joints, &stream, 5.0).expect("a latency")
        };
        let (on_time, late) = (lag(0.0), lag(0.05));
        assert!((on_time.latency_s - 0.03).abs() < 2e-4, "{on_time:?}");
        assert_eq!(on_time.transform_latency_s, None);
        assert!((late.latency_s - 0.03).abs() < 1e-3, "{late:?}");
        let late = late.transform_latency_s.expect("late transforms");
        assert!((late.value - 0.05).abs() < 1e-3 && late.std_error < 1e-3, "{late:?}");
    }

    fn diagnosed(frame: &MovingFrame, logged: &PoseTrack, reference_known: bool) -> PoseDiagnosis {
        let (joints, chain) = arm();
        let in_base = frame.in_base(logged);
        let stream = stream(&in_base, &chain);
        let stream = PoseStream { moving_frame: Some(frame), reference_known, ..stream };
        diagnose_run(&joints, &[stream], &[false; 6], 5.0).streams.remove(0)
    }

    #[test]
    fn a_changing_latency_of_poses_on_a_moving_base_is_compensated() {
        let (joints, chain) = arm();
        let frame = moving_frame(0.0);
        let steps = [0.012, 0.03, 0.5]
            .map(|size_s| move |t_s: f64| if t_s > 9.0 { 0.004 + size_s } else { 0.004 });
        for latency_s in steps {
            let logged = track(&joints, &chain, latency_s, odometry);
            let found = diagnosed(&frame, &logged, false);
            let size_s = latency_s(10.0) - latency_s(0.0);
            let profile = found.latency_profile.as_ref().expect("a profile");
            let [step] = profile.steps.as_slice() else { panic!("{size_s}: {profile:?}") };
            assert!((step.size_s.value - size_s).abs() < 3e-4, "{size_s}: {step:?}");
            let residual = found.residual.as_ref().expect("a residual");
            assert!(residual.rms_m < 5e-4, "{size_s}: {residual:?}");
        }
    }

    #[test]
    fn a_latency_ramp_of_poses_on_a_moving_base_is_measured() {
        let (joints, chain) = arm();
        // The base moves as fast as the tool.
        let odometry = |t_s: f64| odometry(4.0 * t_s);
        let frame = moving_frame(0.0);
        let base_from_frame = frame.t_s.iter().map(|t_s| odometry(*t_s).inverse()).collect();
        let frame = MovingFrame { base_from_frame, ..frame };
        let ramp = |t_s: f64| 0.004 + 0.01 * ((t_s - 10.3) / 2.3).clamp(0.0, 1.0);
        let logged = track(&joints, &chain, ramp, odometry);
        let found = diagnosed(&frame, &logged, true);
        let profile = found.latency_profile.as_ref().expect("a profile");
        assert!(profile.is_unsteady && profile.steps.is_empty(), "{profile:?}");
        let swing = &profile.swing_s;
        assert!((swing.value - 0.01).abs() < swing.half_width(0.99), "{swing:?}");
        assert!(swing.std_error < 1e-3, "{swing:?}");
    }

    #[test]
    fn latency_and_skew_of_poses_on_a_moving_base_are_exact() {
        let (joints, chain) = arm();
        let frame = moving_frame(0.0);
        let logged = track(&joints, &chain, |t_s| 0.02 + 1e-3 * (t_s - 10.0), odometry);
        let found = diagnosed(&frame, &logged, false);
        let skew = found.skew.as_ref().expect("a skew");
        assert!(found.is_skew_chosen && (skew.value - 1e-3).abs() < 2e-5, "{skew:?}");
        let residual = found.residual.as_ref().expect("a residual");
        assert!(residual.rms_m < 2e-4, "{residual:?}");
    }

    #[test]
    fn a_tool_of_constant_orientation_is_no_sliding_base() {
        // A gantry with prismatic joints only.
        let urdf = ["x", "y", "z"].iter().enumerate().fold(String::new(), |urdf, (n, axis)| {
            let unit = ["1 0 0", "0 1 0", "0 0 1"][n];
            urdf + &format!(
                "<link name=\"l{}\"/><joint name=\"{axis}\" type=\"prismatic\"><parent link=\"l{n}\"/>\
                 <child link=\"l{}\"/><axis xyz=\"{unit}\"/><limit lower=\"-2\" upper=\"2\" effort=\"1\" \
                 velocity=\"2\"/></joint>",
                n + 1,
                n + 1
            )
        });
        let urdf = format!("<robot name=\"g\"><link name=\"l0\"/>{urdf}</robot>");
        let robot = ground::robot::Robot::from_urdf(&urdf, "g").unwrap();
        let link = |name| robot.link(name).unwrap();
        let chain = robot.chain(link("l0"), link("l3")).unwrap();
        let mut joints = JointTrack { dof: 3, ..Default::default() };
        for row in 0..2500 {
            let t_s = f64::from(row) * 0.008;
            joints.t_s.push(t_s);
            joints.q.extend([0.3 * (0.9 * t_s).sin(), 0.2 * (0.31 * t_s).cos(), 0.0]);
            joints.qd.extend([0.27 * (0.9 * t_s).cos(), -0.062 * (0.31 * t_s).sin(), 0.0]);
        }
        let world = Pose::from_parts([1.0, 0.2, 0.4].into(), rotation_from_rpy([0.1, -0.2, 2.1]));
        let body = Pose::from_parts([0.03, 0.0, 0.06].into(), rotation_from_rpy([0.7, 0.3, -1.1]));
        let (mut poses, mut t_s) = (Vec::new(), Vec::new());
        let mut sequence = joints.sequence();
        for row in 100..1800 {
            let stamp = f64::from(row) * 0.01 + 0.003;
            let (q, _) = sequence.at(stamp).expect("joint states");
            let pose = world * chain.forward(q) * body;
            t_s.push(stamp);
            poses.push((pose.translation.vector, pose.rotation));
        }
        let track = pose_track(&t_s, poses);
        let stream = PoseStream { columns: &[0, 1, 2], ..stream(&track, &chain) };
        assert_eq!(detect_base_motion(&joints, &stream, 5.0), None);
    }

    #[test]
    fn a_driving_base_is_distinguished_from_a_fixed_base_and_another_arm() {
        let (joints, chain) = arm();
        let travel = |track: PoseTrack| detect_base_motion(&joints, &stream(&track, &chain), 5.0);
        let driven = travel(track(&joints, &chain, |_| 0.03, odometry)).unwrap();
        assert!(driven.travel_m > 1.0 && (driven.turn_rad - 0.8).abs() < 0.4, "{driven:?}");
        assert_eq!(travel(track(&joints, &chain, |_| 0.0, |_| odometry(3.0))), None);
        let pushed = |t_s: f64| odometry(if t_s < 9.0 { 1.0 } else { 2.0 });
        assert_eq!(travel(track(&joints, &chain, |_| 0.0, pushed)), None);
        let mut other = track(&joints, &chain, |_| 0.0, |_| Pose::identity());
        other.xyz.iter_mut().for_each(|xyz| xyz.x += 0.3 * xyz.y * xyz.z);
        assert_eq!(travel(other), None);
    }
}
