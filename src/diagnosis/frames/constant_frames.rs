//! Initial guesses of constant frame errors.

use super::position_fit::PositionFit;
use super::rotation_frames::mean_rotation;
use crate::distinct::by_score;
use crate::model::jacobian::pose_changes;
use crate::model::measurement::{PoseObservations, StreamAt, StreamState, pose_of_twist, stacked};
use crate::priors::{LEVER_M, MARKER_PRIOR_M};
use crate::solver::linear::Normal;
use crate::solver::minimize::{LeastSquares, Limits, minimize};
use crate::solver::noise::rms;
use ground::geometry::{
    Axes, Pose, Rotation, Vec3, angle_between, mean_vector, pose, rotation_by_wahba,
    rotation_from_rotvec, rotvec_from_rotation,
};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Vector6};
use std::sync::LazyLock;

const INITIAL_GUESS_SAMPLES: usize = 120;
/// If most deviations are smaller, the fit needs no initial guess.
const MAX_UNGUESSED_RAD: f64 = 0.06;
const MAX_UNGUESSED_M: f64 = 0.03;
/// To identify a round rotation.
const ROUND_TOLERANCE_RAD: f64 = 0.06;

/// Starting states of a stream's fit, near joint offsets `offsets`. The first has no frame error. A stream
/// far from FK adds closed-form frame errors, exact and round.
pub(crate) fn starting_states(
    observations: &PoseObservations,
    latency_s: f64,
    offsets: &[f64],
) -> Vec<StreamState> {
    let is_tool_point = observations.excluded.rotation;
    let without_frames = StreamState { is_tool_point, ..StreamState::at_latency(latency_s) };
    let (fk, logged) = pose_pairs(observations.at(&without_frames, offsets));
    if fk.len() < 3 {
        return vec![without_frames];
    }
    let with =
        |reference: Pose, tool: Pose| StreamState { reference, tool, ..without_frames.clone() };
    let identity = Pose::identity();
    if !observations.reference_known {
        let (reference, tool) = fit_frames(&fk, &logged);
        return vec![with(reference_frame(&fk, &logged), identity), with(reference, tool)];
    }
    let mut starts = vec![without_frames.clone()];
    let far = fk.iter().zip(&logged).filter(|(fk, logged)| {
        angle_between(&fk.rotation, &logged.rotation) > MAX_UNGUESSED_RAD
            || (fk.translation.vector - logged.translation.vector).norm() > MAX_UNGUESSED_M
    });
    if far.count() * 4 < fk.len() {
        return starts;
    }
    let (reference, tool) = fit_frames(&fk, &logged);
    let reference_only = reference_frame(&fk, &logged);
    let tool_only = tool_frame(&fk, &logged);
    let first_joint = observations.chain.first_joint_frame();
    starts.extend([
        with(identity, tool_only),
        with(reference_only, identity),
        with(reference, tool),
    ]);
    let with_round =
        |round: Pose, tool: Pose| StreamState { round_reference: Some(round), ..with(round, tool) };
    let tool_after =
        |round: &Pose| tool_frame(&fk.iter().map(|fk| round * fk).collect::<Vec<Pose>>(), &logged);
    if let Some(round) = round_frame_error(&reference_only, &first_joint) {
        starts.extend([tool_after(&round), identity].map(|tool| with_round(round, tool)));
    }
    if let Some(round) = round_frame_error(&reference, &first_joint) {
        starts.push(with_round(round, tool_after(&round)));
    }
    if let Some(round) = round_rotation(&tool_only.rotation) {
        let shifted = pose(tool_only.translation.vector.into(), round.rotation);
        starts.extend(
            [round, shifted]
                .map(|tool| StreamState { round_tool: Some(round), ..with(identity, tool) }),
        );
    }
    starts
}

/// FK and logged poses of a subset of samples. FK has no frames.
fn pose_pairs(StreamAt { observations, state, offsets }: StreamAt) -> (Vec<Pose>, Vec<Pose>) {
    let identity = Pose::identity();
    let state = StreamState { reference: identity, tool: identity, ..state.clone() };
    let mut predictor = observations.at(&state, offsets).predictor();
    let pair = |k: usize| {
        Some((predictor.pose_at(k)?, pose(observations.xyz[k].into(), observations.rotation[k])))
    };
    observations.rows(INITIAL_GUESS_SAMPLES).filter_map(pair).unzip()
}

fn reference_frame(fk: &[Pose], logged: &[Pose]) -> Pose {
    let rotations: Vec<Rotation> =
        fk.iter().zip(logged).map(|(fk, l)| l.rotation * fk.rotation.inverse()).collect();
    let turn = mean_rotation(&rotations);
    let at = |(fk, l): (&Pose, &Pose)| l.translation.vector - turn * fk.translation.vector;
    pose(mean_vector(fk.iter().zip(logged).map(at)).into(), turn)
}

/// The state with both frames determined by positions at its latency.
pub(crate) fn with_frames_from_positions(stream: StreamAt) -> StreamState {
    let (fk, logged) = pose_pairs(stream);
    if fk.len() < 3 {
        return stream.state.clone();
    }
    let (reference, tool) = frames_from_positions(&fk, &logged);
    StreamState { reference, tool, ..stream.state.clone() }
}

fn frames_from_positions(fk: &[Pose], logged: &[Pose]) -> (Pose, Pose) {
    let xyz: Vec<Vec3> = logged.iter().map(|pose| pose.translation.vector).collect();
    let (reference, point) = PositionFit { fk, xyz: &xyz }.fit_rigid_or_collinear();
    let turned: Vec<Pose> = fk.iter().map(|fk| reference * fk).collect();
    let turn = tool_frame(&turned, logged).rotation;
    (reference, pose(point.into(), turn))
}

/// Tool frame that best maps FK to the logged poses.
pub(crate) fn tool_frame(fk: &[Pose], logged: &[Pose]) -> Pose {
    let tools: Vec<Pose> = fk.iter().zip(logged).map(|(fk, l)| fk.inverse() * l).collect();
    let rotations: Vec<Rotation> = tools.iter().map(|tool| tool.rotation).collect();
    let xyz = mean_vector(tools.iter().map(|tool| tool.translation.vector));
    pose(xyz.into(), mean_rotation(&rotations))
}

/// Same for a stream without a reference error. `None` if there are too few samples.
pub(crate) fn tool_start(stream: StreamAt) -> Option<Pose> {
    let (fk, logged) = pose_pairs(stream);
    (fk.len() >= 3).then(|| tool_frame(&fk, &logged))
}

/// Assumed position noise.
const START_NOISE_M: f64 = 1e-3;
const LIMITS: Limits = Limits { steps: 25, min_gain: 1e-6 };
/// Before the best starts are continued.
const ROUGH_LIMITS: Limits = Limits { steps: 6, min_gain: 1e-3 };
const CONTINUED_STARTS: usize = 2;

/// Closed-form reference and tool frame (`A X = X B`; Park and Martin 1994).
pub(crate) fn initial_frames(fk: &[Pose], logged: &[Pose]) -> (Pose, Pose) {
    frames_for_rotation(rotation_by_wahba(&relative_rotations(fk, logged)), fk, logged)
}

/// Fits reference and tool frame together.
///
/// The cost has several minima if the hand rotates little or about one axis. Starts are one rotation from
/// relative rotations (Park and Martin 1994), one from positions (Kabsch 1976), and four that align the
/// common axis. Returns the best pair.
pub(crate) fn fit_frames(fk: &[Pose], logged: &[Pose]) -> (Pose, Pose) {
    let correlation = relative_rotations(fk, logged);
    let by_positions = frames_from_positions(fk, logged);
    let turns = candidate_reference_rotations(&correlation, &by_positions.0.rotation);
    let starts =
        turns.into_iter().map(|turn| frames_for_rotation(turn, fk, logged)).chain([by_positions]);
    let pair = FramePair { fk, logged };
    let rough = starts.filter_map(|start| minimize(&pair, start, ROUGH_LIMITS));
    by_score(rough)
        .take(CONTINUED_STARTS)
        .filter_map(|frames| minimize(&pair, frames, LIMITS))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(Default::default, |(_, frames)| frames)
}

/// Residual after fitting constant frames, rms m and rad.
pub(crate) fn misfit_of_frames(fk: &[Pose], logged: &[Pose]) -> [f64; 2] {
    misfit_in_frames(fk, logged, &fit_frames(fk, logged))
}

/// Residual in given frames, rms m and rad.
pub(crate) fn misfit_in_frames(
    fk: &[Pose],
    logged: &[Pose],
    (reference, tool): &(Pose, Pose),
) -> [f64; 2] {
    let predicted: Vec<Pose> = fk.iter().map(|fk| reference * fk * tool).collect();
    pose_changes(&predicted, logged).map(|residual| rms(&residual))
}

/// Same for a stream at its latency with joint offsets.
pub(crate) fn constant_frame_residual(stream: StreamAt) -> [f64; 2] {
    let (fk, logged) = pose_pairs(stream);
    misfit_of_frames(&fk, &logged)
}

/// Correlation `Σ stream·FKᵀ` of relative rotation vectors.
fn relative_rotations(fk: &[Pose], logged: &[Pose]) -> Matrix3<f64> {
    let n = fk.len();
    let stride = (n / 3).max(1);
    let pair = |a: usize| {
        let b = (a + stride) % n;
        let by_stream = rotvec_from_rotation(&(logged[b].rotation * logged[a].rotation.inverse()));
        let by_fk = rotvec_from_rotation(&(fk[b].rotation * fk[a].rotation.inverse()));
        by_stream * by_fk.transpose()
    };
    (0..n).map(pair).sum()
}

/// Candidate reference rotations: the least-squares solution, and four that align the common axis, a
/// quarter turn apart, starting nearest to `about`.
fn candidate_reference_rotations(correlation: &Matrix3<f64>, about: &Rotation) -> Vec<Rotation> {
    let mut turns = vec![rotation_by_wahba(correlation)];
    let svd = correlation.svd(true, true);
    if let (Some(u), Some(v_t)) = (svd.u, svd.v_t) {
        let in_stream: Vec3 = u.column(0).into();
        let by_fk: Vec3 = v_t.row(0).transpose();
        let to_axis = Rotation::rotation_between(&(about * by_fk), &in_stream);
        let aligned = to_axis.unwrap_or_default() * about;
        turns.extend((0..4).map(|quarter| {
            let angle = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
            rotation_from_rotvec(in_stream * angle) * aligned
        }));
    }
    turns
}

fn frames_for_rotation(turn: Rotation, fk: &[Pose], logged: &[Pose]) -> (Pose, Pose) {
    let tools: Vec<Rotation> =
        fk.iter().zip(logged).map(|(fk, l)| (turn * fk.rotation).inverse() * l.rotation).collect();
    let tool_turn = mean_rotation(&tools);
    // p = t + turn·(p_fk + R_fk·c): linear in t and c.
    let (mut hands, mut right) = (Matrix3::zeros(), [Vec3::zeros(); 2]);
    for (fk, l) in fk.iter().zip(logged) {
        let hand = turn * fk.rotation;
        let target = l.translation.vector - turn * fk.translation.vector;
        hands += hand.to_rotation_matrix().matrix();
        right[0] += target;
        right[1] += hand.inverse() * target;
    }
    let mut normal = Matrix6::identity() * fk.len() as f64;
    normal.fixed_view_mut::<3, 3>(0, 3).copy_from(&hands);
    normal.fixed_view_mut::<3, 3>(3, 0).copy_from(&hands.transpose());
    for i in 3..6 {
        normal[(i, i)] += (START_NOISE_M / MARKER_PRIOR_M).powi(2);
    }
    let right = Vector6::from(stacked(right));
    let solution = normal.cholesky().map_or_else(Vector6::zeros, |c| c.solve(&right));
    let xyz = |first: usize| solution.fixed_rows::<3>(first).into_owned().into();
    (pose(xyz(0), turn), pose(xyz(3), tool_turn))
}

/// Reference and tool frame between FK and logged poses.
struct FramePair<'a> {
    fk: &'a [Pose],
    logged: &'a [Pose],
}

impl LeastSquares for FramePair<'_> {
    type State = (Pose, Pose);

    fn linearize(&self, (reference, tool): &Self::State) -> Option<Normal> {
        // Weights of the squared residuals of position and rotation.
        const WEIGHTS: [f64; 2] = [
            1.0 / (START_NOISE_M * START_NOISE_M),
            LEVER_M * LEVER_M / (START_NOISE_M * START_NOISE_M),
        ];
        let zeros = Matrix3::<f64>::zeros();
        let (mut hands, mut crosses, mut squares) = (zeros, zeros, zeros);
        let (mut points, mut right, mut cost) = (Vec3::zeros(), [Vec3::zeros(); 4], 0.0);
        for (fk, logged) in self.fk.iter().zip(self.logged) {
            let predicted = reference * fk * tool;
            let point = predicted.translation.vector;
            let hand = *predicted.rotation.to_rotation_matrix().matrix();
            let offset = logged.translation.vector - point;
            let turn = rotvec_from_rotation(&(logged.rotation * predicted.rotation.inverse()));
            let (shift, twist) = (WEIGHTS[0] * offset, WEIGHTS[1] * turn);
            let lever = point.cross_matrix();
            points += point;
            hands += hand;
            crosses += lever * hand;
            squares += lever * lever;
            let gradient =
                [shift, point.cross(&shift) + twist, hand.tr_mul(&shift), hand.tr_mul(&twist)];
            right.iter_mut().zip(gradient).for_each(|(sum, part)| *sum += part);
            cost += shift.dot(&offset) + twist.dot(&turn);
        }
        // The design of a pose is `[I, -lever, hand, 0]` for the position and `[0, I, 0, hand]` for the rotation.
        let count = self.fk.len() as f64;
        let [position, rotation] = WEIGHTS;
        let levers = points.cross_matrix();
        let mut matrix = DMatrix::identity(12, 12) * (count * position);
        let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
            matrix.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
            matrix.fixed_view_mut::<3, 3>(column, row).copy_from(&block.transpose());
        };
        let unit = Matrix3::identity() * (count * rotation);
        set(3, 0, position * levers);
        set(3, 3, unit - position * squares);
        set(6, 0, position * hands.transpose());
        set(6, 3, position * crosses.transpose());
        set(9, 3, rotation * hands.transpose());
        set(9, 9, unit);
        let right = DVector::from_iterator(12, right.iter().flatten().copied());
        let mut normal = Normal { matrix, right, cost, independent: 0.0 };
        add_tool_prior(&mut normal, tool);
        Some(normal)
    }

    fn moved(&self, (reference, tool): &Self::State, step: &[f64]) -> Self::State {
        (pose_of_twist(&step[..6]) * reference, tool * pose_of_twist(&step[6..]))
    }
}

fn add_tool_prior(normal: &mut Normal, tool: &Pose) {
    // Changes of the tool are along its own axes.
    let own = tool.rotation.inverse() * tool.translation.vector;
    for axis in 0..3 {
        normal.add_prior(6 + axis, 1.0 / MARKER_PRIOR_M, -own[axis]);
    }
}

/// Nearest quarter turn within [`ROUND_TOLERANCE_RAD`], excluding the identity.
fn round_rotation(rotation: &Rotation) -> Option<Pose> {
    static QUARTER_TURNS: LazyLock<Vec<Rotation>> = LazyLock::new(|| {
        let right_handed = Axes::all().iter().filter(|axes| !axes.are_left_handed());
        let others = right_handed.filter(|axes| **axes != Axes::STANDARD);
        others.map(|axes| axes.conjugator()).collect()
    });
    QUARTER_TURNS
        .iter()
        .find(|quarter| angle_between(quarter, rotation) < ROUND_TOLERANCE_RAD)
        .map(|quarter| pose([0.0; 3], *quarter))
}

/// Round rotation nearest to `frame`, about its origin or the first joint, where the arm may be mounted.
fn round_frame_error(frame: &Pose, first_joint: &Pose) -> Option<Pose> {
    let away_m =
        |round: &Pose| (round.translation.vector - frame.translation.vector).norm_squared();
    let at_joint = round_rotation(&(first_joint.inverse() * frame * first_joint).rotation)
        .map(|round| first_joint * round * first_joint.inverse());
    let both = [round_rotation(&frame.rotation), at_joint];
    both.into_iter().flatten().min_by(|a, b| away_m(a).total_cmp(&away_m(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::jacobian::{Derivative, PoseJacobian, pose_change};
    use crate::solver::linear::Linear;

    #[test]
    fn equations_of_frames_equal_sums_over_poses() {
        let number = |seed: usize| ((seed * 37 + 11) % 89) as f64 / 89.0 - 0.5;
        let random = |seed: usize| {
            pose_of_twist(&std::array::from_fn::<f64, 6, _>(|i| number(7 * seed + 101 * i)))
        };
        let (reference, tool) = (random(1), random(2));
        let fk: Vec<Pose> = (3..23).map(random).collect();
        let logged: Vec<Pose> = fk.iter().map(|fk| random(30) * reference * fk * tool).collect();
        let pair = FramePair { fk: &fk, logged: &logged };
        let equations = pair.linearize(&(reference, tool)).expect("valid frames");
        let mut linear = Linear::new(12, &[0.0; 2]);
        let weighted = |[position, turn]: Derivative| {
            [position / START_NOISE_M, turn * (LEVER_M / START_NOISE_M)]
        };
        for (fk, logged) in fk.iter().zip(&logged) {
            let jacobian = PoseJacobian::new(&[], &reference, fk, &tool);
            let mut rows = linear.push(&weighted(pose_change(&jacobian.pose, logged)));
            for axis in 0..6 {
                rows.set_all(axis, weighted(jacobian.reference(axis)));
                rows.set_all(6 + axis, weighted(jacobian.tool(axis)));
            }
        }
        let mut sums = linear.normal(&linear.even_weights());
        add_tool_prior(&mut sums, &tool);
        assert!((&equations.matrix - &sums.matrix).amax() < 1e-9 * sums.matrix.amax());
        assert!((&equations.right - &sums.right).amax() < 1e-9 * sums.right.amax());
        assert!((equations.cost / sums.cost - 1.0).abs() < 1e-9);
    }
}
