//! Compares commands with the motion of the arm: error at rest, following error and latency, and
//! straightness of commanded lines.
//!
//! Once a command has been constant for a while and the arm rests, only a constant pose error remains.
//! Goals that the arm never approached are counted separately.

mod delay;
mod joint_map;
mod line;
mod measured_poses;
mod rest;
mod rest_error;

use self::delay::is_streamed;
pub use self::delay::{CommandDelay, DelayFailure, estimate_joint_delays, estimate_pose_delay};
pub use self::joint_map::JointMap;
pub use self::rest_error::{CommandDiagnosis, CommandTracking, RestError, RestErrorSpread};
use crate::latency::correlation::{ArmSpeeds, LagPeak, median_period_s};
use crate::model::jacobian::pose_change;
use crate::residuals::excess::mean_of;
use crate::samples::sampling::rows_within;
use crate::solver::noise::Noise;
use crate::{EstimateResult, NotObservable, PoseSeries};
use ground::geometry::{Rotation, Vec3, angle_between};
use ground::robot::Chain;
use ground::stats::thin::thinned;
use ground::stats::{Measured, lowest, mean};
use ground::stream::JointTrack;

use joint_map::CommandedState;
pub use line::{CommandedLine, LineDeviation};
use measured_poses::{MeasuredPoses, length_of, pose_noise, variance_of_mean};
use rest::{ConstantCommand, Rest, constant_commands, detect_rests, mean_pose, poses_within};

/// Commanded poses over time.
#[derive(Clone, Debug, Default)]
pub struct Commands {
    /// Commanded `base_from_tip`.
    pub series: PoseSeries,
    /// Positions, row-major, in joint-track order; NaN without a command. Empty for pose commands.
    pub joints: Vec<f64>,
}

impl Commands {
    /// Converts joint commands: `q` has `order.len()` numbers per row, `order` their joint-track columns. A
    /// joint missing from a row keeps its last command; joints never commanded use their measured position.
    pub fn from_joints(
        t_s: &[f64],
        order: &[usize],
        q: &[f64],
        joints: &JointTrack,
        (chain, columns): (&Chain, &[usize]),
    ) -> Self {
        let mut commands = Self::default();
        let mut latest = vec![f64::NAN; joints.dof];
        let mut sequence = joints.sequence();
        for (&t_s, row) in t_s.iter().zip(q.chunks_exact(order.len().max(1))) {
            for (&column, &value) in order.iter().zip(row).filter(|(_, value)| value.is_finite()) {
                latest[column] = value;
            }
            let measured = sequence.at(t_s);
            let position = |&column: &usize| match latest[column].is_finite() {
                true => Some(latest[column]),
                false => measured.map(|(q, _)| q[column]),
            };
            let Some(q) = columns.iter().map(position).collect::<Option<Vec<f64>>>() else {
                continue;
            };
            commands.series.t_s.push(t_s);
            commands.series.poses.push(chain.forward(&q));
            commands.joints.extend(&latest);
        }
        commands
    }
}

/// Joint order of unnamed commands: chain, joint-track or alphabetical order, whichever is closest to the
/// measured joints. `None` if none follows them.
pub fn infer_joint_order(
    t_s: &[f64],
    q: &[f64],
    joints: &JointTrack,
    names: &[String],
    columns: &[usize],
) -> Option<Vec<usize>> {
    /// From the commands, rad or m, at one of the delays below.
    const MAX_JOINT_DISTANCE: f64 = 0.1;
    const TRIAL_DELAYS_S: [f64; 5] = [0.0, 0.1, 0.2, 0.4, 0.8];
    let mut alphabetical = columns.to_vec();
    alphabetical.sort_by_key(|&column| names.get(column));
    let mut as_tracked = columns.to_vec();
    as_tracked.sort_unstable();
    let distance_at = |order: &[usize], later_s: f64| {
        let mut sequence = joints.sequence();
        let rows = t_s.iter().zip(q.chunks_exact(order.len().max(1)));
        let distances = rows.filter_map(|(t_s, row)| {
            let (at, _) = sequence.at(t_s + later_s)?;
            Some(mean(order.iter().zip(row).map(|(&column, q)| (at[column] - q).abs())))
        });
        let distances: Vec<f64> = distances.collect();
        if distances.is_empty() { f64::INFINITY } else { mean(distances) }
    };
    let distance = |order: &[usize]| {
        let distances = TRIAL_DELAYS_S.iter().map(|&later_s| distance_at(order, later_s));
        distances.fold(f64::INFINITY, f64::min)
    };
    // Returns the first of equal candidates.
    let orders = [columns.to_vec(), as_tracked, alphabetical].into_iter();
    let orders = orders.map(|order| (distance(&order), order));
    let (least, order) = lowest(orders, |it| it.0)?;
    (least < MAX_JOINT_DISTANCE).then_some(order)
}

/// Joint states and chain to the commanded tip.
#[derive(Clone, Copy, Debug)]
pub struct CommandedArm<'a> {
    /// Joint states as recorded.
    pub joints: &'a JointTrack,
    /// Base to tip.
    pub chain: &'a Chain,
    /// Column in `joints` per joint of `chain`.
    pub columns: &'a [usize],
}

/// Compares commands with the arm's motion. `measured_poses` are `base_from_tip`, corrected for
/// latency; the first is FK of the joint states.
///
/// # Errors
/// If the commands do not overlap the joint states, or the arm never rests.
pub fn diagnose_commands(
    commands: &Commands,
    arm: &CommandedArm<'_>,
    measured_poses: &[PoseSeries],
    max_lag_s: f64,
) -> EstimateResult<CommandDiagnosis> {
    let series = &commands.series;
    let (_, end_s) = arm.joints.span().ok_or(NotObservable::NoOverlap)?;
    if series.t_s.first().is_none_or(|&first_s| first_s > end_s) {
        return Err(NotObservable::NoOverlap);
    }
    let is_streamed = is_streamed(&series.t_s);
    let tracking = is_streamed.then(|| command_tracking(series, arm, max_lag_s)).flatten();
    let rests = detect_rests(arm.joints);
    if rests.is_empty() {
        return Err(NotObservable::NeverRests);
    }
    let constant_commands = constant_commands(series, is_streamed, end_s);
    let with_noise = |series| MeasuredPoses { series, noise: pose_noise(series, &rests) };
    let measured_poses: Vec<MeasuredPoses<'_>> = measured_poses.iter().map(with_noise).collect();
    let (mut reached, mut unreached): (Vec<RestErrors>, Vec<RestErrors>) = Default::default();
    for command in &constant_commands {
        let windows = rest_windows(command, &rests, is_streamed, tracking).into_iter();
        let rest_errors = windows.map(|window| -> RestErrors {
            let poses = measured_poses.iter();
            poses.map(|one| rest_error(commands, arm, command, window, one)).collect()
        });
        let at_rests = rest_errors.filter(|errors| errors.iter().any(Option::is_some));
        if tracking.is_some() {
            reached.extend(at_rests);
        } else if let Some(nearest) = lowest(at_rests, |errors| smallest_error(errors)) {
            // A rest farther from the goal was not its target: the arm stopped early or was moved by other means.
            let is_near = smallest_error(&nearest) <= 1.0;
            if is_near { reached.push(nearest) } else { unreached.push(nearest) }
        }
    }
    let misses = unreached.iter().flatten().flatten();
    let nearest = lowest(misses, |miss| relative_error(miss));
    let nearest_miss = nearest.map(|miss| (miss.distance_m.norm.value, miss.angle_rad.norm.value));
    if (0..measured_poses.len()).any(|stream| is_constant_transform(&unreached, stream)) {
        reached.append(&mut unreached);
    }
    reached.sort_by(|a, b| start_s(a).total_cmp(&start_s(b)));
    let is_goal = |command: &&ConstantCommand| command.to_s - command.from_s >= rest::MIN_REST_S;
    let goals = constant_commands.iter().filter(is_goal).count();
    let not_reached = if tracking.is_none() { goals.saturating_sub(reached.len()) } else { 0 };
    let mut rest_errors = vec![Vec::new(); measured_poses.len()];
    for reached in reached {
        rest_errors.iter_mut().zip(reached).for_each(|(all, rest_error)| all.extend(rest_error));
    }
    let lines = match is_streamed && commands.joints.is_empty() {
        true => line::detect_lines(series, &constant_commands, &rests, &measured_poses),
        false => Vec::new(),
    };
    let goal_maps = goal_maps(commands, arm.joints, &constant_commands, &rests);
    Ok(CommandDiagnosis {
        is_streamed,
        tracking,
        goals,
        not_reached,
        nearest_miss,
        rest_errors,
        goal_maps,
        lines,
    })
}

/// One per observation.
type RestErrors = Vec<Option<RestError>>;

/// The command is constant and the arm rests as its result.
fn rest_windows(
    command: &ConstantCommand,
    rests: &[Rest],
    is_streamed: bool,
    tracking: Option<CommandTracking>,
) -> Vec<(f64, f64)> {
    /// After the command stops; twice the delay is added.
    const SETTLING_S: f64 = 0.1;
    /// At the end of a long rest.
    const MAX_REST_S: f64 = 1.0;
    let delay_s = tracking.map_or(0.0, |tracking| tracking.delay_s.max(0.0));
    let is_led = |rest: &&Rest| {
        // With no command before it, the arm is holding a constant stream.
        tracking.is_some() || rest.from_s > command.from_s || is_streamed && command.first == 0
    };
    let window = |rest: &Rest| {
        let from_s = rest.from_s.max(command.from_s + SETTLING_S + 2.0 * delay_s);
        let to_s = rest.to_s.min(command.to_s);
        // The motion has settled further in the later half.
        let late_s = (0.5 * (from_s + to_s)).min(to_s - rest::MIN_REST_S).max(to_s - MAX_REST_S);
        (to_s - from_s >= rest::MIN_REST_S).then_some((from_s.max(late_s), to_s))
    };
    rests.iter().filter(is_led).filter_map(window).collect()
}

/// Limits of the distance between a rest and its goal.
const MAX_GOAL_DISTANCE_M: f64 = 0.02;
const MAX_GOAL_ANGLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Distance from a goal relative to its limits.
fn relative_error(rest_error: &RestError) -> f64 {
    (rest_error.distance_m.norm.value / MAX_GOAL_DISTANCE_M)
        .max(rest_error.angle_rad.norm.value / MAX_GOAL_ANGLE_RAD)
}

/// Smallest among the observations.
fn smallest_error(rest_errors: &[Option<RestError>]) -> f64 {
    rest_errors.iter().flatten().map(relative_error).fold(f64::INFINITY, f64::min)
}

fn start_s(rest_errors: &[Option<RestError>]) -> f64 {
    rest_errors.iter().flatten().map(|rest_error| rest_error.from_s).fold(f64::INFINITY, f64::min)
}

/// Whether one rigid transform explains all distant goals (three or more): another frame or tool.
fn is_constant_transform(unreached: &[RestErrors], stream: usize) -> bool {
    const FEWEST: usize = 3;
    const MAX_TRANSFORM_SPREAD: (f64, f64) = (0.25 * MAX_GOAL_DISTANCE_M, 0.1 * MAX_GOAL_ANGLE_RAD);
    let rest_errors: Vec<RestError> =
        unreached.iter().filter_map(|rest_errors| rest_errors[stream].clone()).collect();
    let is_small = |spread: (f64, f64)| {
        spread.0 <= MAX_TRANSFORM_SPREAD.0 && spread.1 <= MAX_TRANSFORM_SPREAD.1
    };
    let constancy =
        RestErrorSpread::from_rests(&rest_errors).filter(|_| rest_errors.len() >= FEWEST);
    constancy.is_some_and(|constancy| is_small(constancy.in_tool) || is_small(constancy.in_base))
}

/// `None` if there are too few samples or the pose still moves.
fn rest_error(
    commands: &Commands,
    arm: &CommandedArm<'_>,
    command: &ConstantCommand,
    (from_s, to_s): (f64, f64),
    measured_poses: &MeasuredPoses<'_>,
) -> Option<RestError> {
    const FEWEST: usize = 4;
    /// Between the two halves of a rest.
    const MAX_REST_MOTION_M_RAD: (f64, f64) = (2e-4, 3e-4);
    const SIGMAS: f64 = 4.0;
    let series = measured_poses.series;
    let poses = poses_within(series, from_s, to_s);
    let count = poses.len();
    if count < FEWEST {
        return None;
    }
    let middle_s = 0.5 * (from_s + to_s);
    let measured = mean_pose(poses)?;
    let early = mean_pose(poses_within(series, from_s, middle_s))?;
    let late = mean_pose(poses_within(series, middle_s, to_s))?;
    let crept_m = (late.translation.vector - early.translation.vector).norm();
    let crept_rad = angle_between(&early.rotation, &late.rotation);
    let by_noise = |noise: &Noise| SIGMAS * (2.0 * variance_of_mean(noise, count / 2)).sqrt();
    let [metres, radians] = &measured_poses.noise;
    if crept_m > MAX_REST_MOTION_M_RAD.0 + by_noise(metres)
        || crept_rad > MAX_REST_MOTION_M_RAD.1 + by_noise(radians)
    {
        return None;
    }
    let commanded = commands.series.poses[command.last];
    let [shift, turn] = pose_change(&measured, &commanded);
    Some(RestError {
        from_s,
        to_s,
        commanded,
        measured,
        distance_m: length_of(shift, variance_of_mean(metres, count)),
        angle_rad: length_of(turn, variance_of_mean(radians, count)),
        joints: joint_errors(commands, arm.joints, command, (from_s, to_s)),
    })
}

fn joint_errors(
    commands: &Commands,
    joints: &JointTrack,
    command: &ConstantCommand,
    (from_s, to_s): (f64, f64),
) -> Vec<(usize, Measured)> {
    let dof = joints.dof;
    let Some(commanded) = commands.joints.chunks_exact(dof.max(1)).nth(command.last) else {
        return Vec::new();
    };
    let rows = rows_within(&joints.t_s, from_s, to_s.next_up());
    if rows.len() < 2 {
        return Vec::new();
    }
    let error = |column: usize| {
        let errors = rows.clone().map(|row| joints.row(row)[column] - commanded[column]);
        (column, mean_of(&errors.collect::<Vec<f64>>()))
    };
    (0..dof).filter(|&column| commanded[column].is_finite()).map(error).collect()
}

/// Compares joint goals with the states at the last rest that each caused, when the arm has arrived.
fn goal_maps(
    commands: &Commands,
    joints: &JointTrack,
    constant_commands: &[ConstantCommand],
    rests: &[Rest],
) -> Vec<(usize, JointMap)> {
    let mut samples = vec![Vec::new(); joints.dof];
    for command in constant_commands {
        let Some(window) = rest_windows(command, rests, false, None).pop() else { continue };
        let mut rows = commands.joints.chunks_exact(joints.dof.max(1));
        let Some(commanded) = rows.nth(command.last) else { continue };
        for (column, error) in joint_errors(commands, joints, command, window) {
            let command = commanded[column];
            let state = command + error.value;
            samples[column].push(CommandedState { t_s: window.0, command, state });
        }
    }
    let maps = samples.iter().enumerate();
    maps.filter_map(|(column, samples)| Some((column, JointMap::fit(samples)?))).collect()
}

/// `None` if the arm's speed does not correlate with the commands'.
fn command_tracking(
    series: &PoseSeries,
    arm: &CommandedArm<'_>,
    max_lag_s: f64,
) -> Option<CommandTracking> {
    const MIN_CORRELATION: f64 = 0.7;
    /// Below the highest peak; the equal one with the smallest lag is selected.
    const MAX_PEAK_DEFICIT: f64 = 0.03;
    let CommandedArm { joints, chain, columns } = *arm;
    let (xyz, rotations): (Vec<Vec3>, Vec<Rotation>) =
        series.poses.iter().map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let speeds = ArmSpeeds::from_joints(joints, chain, columns);
    let peaks = speeds.lag_peaks(&series.t_s, &xyz, Some(&rotations), max_lag_s);
    let highest = peaks.first()?.correlation;
    let high = peaks.iter().filter(|peak| peak.correlation >= highest - MAX_PEAK_DEFICIT);
    let peak = lowest(high, |peak| peak.lag_s.abs())?;
    if peak.correlation < MIN_CORRELATION {
        return None;
    }
    // The commands lead the arm.
    let LagPeak { lag_s, correlation } = *peak;
    let delay_s = -lag_s;
    Some(CommandTracking {
        delay_s,
        correlation,
        rms: tracking_error(series, arm, 0.0),
        compensated: tracking_error(series, arm, delay_s),
    })
}

/// Distance and angle, rms m and rad, between FK and the command `delay_s` earlier, while the arm moves.
fn tracking_error(series: &PoseSeries, arm: &CommandedArm<'_>, delay_s: f64) -> (f64, f64) {
    /// More rows do not improve the rms.
    const ENOUGH: usize = 4000;
    /// Speed of a moving arm, rad/s or m/s.
    const MIN_JOINT_SPEED: f64 = 0.02;
    let CommandedArm { joints, chain, columns } = *arm;
    let period_s = median_period_s(&series.t_s);
    let moves =
        |row: &usize| !joints.velocities(*row).iter().all(|speed| speed.abs() < MIN_JOINT_SPEED);
    let errors = thinned(0..joints.len(), ENOUGH).filter(moves).filter_map(|row| {
        let commanded = series.at(joints.t_s[row] - delay_s, period_s)?;
        let measured = chain.forward(&joints.positions_at(row, columns));
        let [shift, turn] = pose_change(&measured, &commanded);
        Some((shift.norm_squared(), turn.norm_squared()))
    });
    let (metres, radians): (Vec<f64>, Vec<f64>) = errors.unzip();
    (mean(metres).sqrt(), mean(radians).sqrt())
}

#[cfg(test)]
mod tests;
