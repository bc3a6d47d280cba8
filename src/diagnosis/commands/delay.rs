//! Delay of the arm behind its commands.

use super::joint_map::{CommandedState, JointMap};
use crate::latency::correlation::median_period_s;
use crate::priors::LEVER_M;
use crate::samples::sampling::range_of;
use crate::signals::response::{ResponseChanges, TimeSeries};
use crate::{NotObservable, PoseSeries, Response};
use ground::geometry::{Pose, Vec3, rotvec_from_rotation};
use ground::stats::cumulative;
use ground::stream::{JointTrack, sample_noise};

/// Response of a joint or the tip to commands.
#[derive(Clone, Debug)]
pub struct CommandDelay {
    /// Column; `None` for poses.
    pub joint: Option<usize>,
    /// Median of the commands.
    pub period_s: f64,
    /// Response, or why not. Its gain is negative if the joint moves the other way.
    pub response: Result<Response, DelayFailure>,
    /// From the joint's command to its state. `None` if they agree, or if no constant map describes them.
    pub map: Option<JointMap>,
}

impl CommandDelay {
    /// Whether the commands are goals, to which the controller plans the path.
    pub fn is_of_goals(&self) -> bool {
        matches!(self.response, Err(DelayFailure::Goals | DelayFailure::Steps))
    }
}

/// Why the delay is undetermined.
#[derive(Clone, Debug, PartialEq)]
pub enum DelayFailure {
    /// Single goals, not a stream.
    Goals,
    /// A stream of repeated goals.
    Steps,
    /// Shared with other estimates.
    NotObservable(NotObservable),
}

impl From<NotObservable> for DelayFailure {
    fn from(why: NotObservable) -> Self {
        Self::NotObservable(why)
    }
}

/// To compare changes over: the minimum, and multiples of command and state periods.
const MIN_WINDOW_S: f64 = 0.1;
const COMMAND_PERIODS: f64 = 2.5;
const STATE_PERIODS: f64 = 4.0;
const MAX_DELAY_S: f64 = 2.0;
/// In rad or m.
const MIN_MOTION: f64 = 0.01;

/// Estimates the delay per commanded joint. `q` has `order.len()` numbers per row (NaN without a command);
/// `order` holds their columns in `joints`.
pub fn estimate_joint_delays(
    t_s: &[f64],
    order: &[usize],
    q: &[f64],
    joints: &JointTrack,
    max_lag_s: f64,
) -> Vec<CommandDelay> {
    let width = order.len().max(1);
    let of = |(at, &column): (usize, &usize)| {
        let commanded = t_s.iter().zip(q.iter().skip(at).step_by(width));
        let (t_s, commanded): (Vec<f64>, Vec<f64>) =
            commanded.filter(|(_, q)| q.is_finite()).map(|(t, q)| (*t, *q)).unzip();
        let measured: Vec<f64> = joints.positions_of(column).collect();
        let period_s = median_period_s(&t_s);
        let paths = [&commanded, &measured].map(Clone::clone);
        let commanded = TimeSeries::new(t_s, vec![commanded]);
        let state = (joints.t_s.as_slice(), measured);
        let response = |commanded: &TimeSeries| {
            estimate_delay(commanded, (state.0, vec![state.1.clone()]), &paths, max_lag_s)
        };
        let response = match response(&commanded) {
            Err(DelayFailure::NotObservable(NotObservable::DoesNotFollow(correlation))) => {
                let reversed = response(&commanded.negated());
                reversed
                    .map(|found| Response { gain: -found.gain, ..found })
                    .map_err(|_| NotObservable::DoesNotFollow(correlation).into())
            }
            response => response,
        };
        let map = response.as_ref().ok().and_then(|found| {
            let caused = found.reference_at(&commanded, state.0);
            let samples = state.0.iter().zip(&state.1).zip(caused);
            let samples = samples.filter_map(|((&t_s, &state), command)| {
                Some(CommandedState { t_s, command: command?, state })
            });
            JointMap::fit(&samples.collect::<Vec<_>>())
        });
        CommandDelay { joint: Some(column), period_s, response, map }
    };
    order.iter().enumerate().map(of).collect()
}

/// Delay of the tip behind commanded poses; both series are `base_from_tip`.
pub fn estimate_pose_delay(
    commanded: &PoseSeries,
    measured: &PoseSeries,
    max_lag_s: f64,
) -> CommandDelay {
    let period_s = median_period_s(&commanded.t_s);
    let [commanded_columns, measured_columns] = [commanded, measured].map(columns);
    let path = |columns: &[Vec<f64>]| {
        let rows = columns.first().map_or(0, Vec::len);
        let square =
            |row: usize| columns.iter().map(|c| (c[row] - c[row - 1]).powi(2)).sum::<f64>();
        cumulative((1..rows).map(|row| square(row).sqrt()))
    };
    let paths = [&commanded_columns, &measured_columns].map(|columns| path(columns));
    let commanded = TimeSeries::new(commanded.t_s.clone(), commanded_columns);
    let measured = (measured.t_s.as_slice(), measured_columns);
    let response = estimate_delay(&commanded, measured, &paths, max_lag_s);
    CommandDelay { joint: None, period_s, response, map: None }
}

/// Whether over half of the path consists of jumps several times faster than the arm's top speed. The
/// controller then plans its own profile, which hides the delay.
fn advances_in_steps(
    (commanded_t_s, commanded): (&[f64], &[f64]),
    (measured_t_s, measured): (&[f64], &[f64]),
) -> bool {
    const MIN_STEP_SPEED_RATIO: f64 = 4.0;
    const MIN_STEP_PATH_SHARE: f64 = 0.5;
    const STEP_WINDOW_S: f64 = 0.1;
    let mut fastest = 0.0_f64;
    let mut first = 0;
    for (last, &t_s) in measured_t_s.iter().enumerate() {
        while t_s - measured_t_s[first] > 2.0 * STEP_WINDOW_S {
            first += 1;
        }
        let length_s = t_s - measured_t_s[first];
        if length_s >= STEP_WINDOW_S {
            fastest = fastest.max((measured[last] - measured[first]).abs() / length_s);
        }
    }
    let noise = 6.0 * sample_noise(measured);
    let (mut path, mut path_in_steps) = (0.0, 0.0);
    for (times, ends) in commanded_t_s.windows(2).zip(commanded.windows(2)) {
        let step = (ends[1] - ends[0]).abs();
        path += step;
        if step > MIN_STEP_SPEED_RATIO * fastest * (times[1] - times[0]) + noise {
            path_in_steps += step;
        }
    }
    path_in_steps > MIN_STEP_PATH_SHARE * path
}

/// Position, m, and accumulated rotation vectors, rad, times a balancing length.
fn columns(series: &PoseSeries) -> Vec<Vec<f64>> {
    let turn =
        |pair: &[Pose]| rotvec_from_rotation(&(pair[1].rotation * pair[0].rotation.inverse()));
    let turns: Vec<Vec3> = series.poses.windows(2).map(turn).collect();
    let rotated = |axis: usize| cumulative(turns.iter().map(|turn| LEVER_M * turn[axis]));
    let position =
        |axis: usize| series.poses.iter().map(|pose| pose.translation.vector[axis]).collect();
    (0..3).map(position).chain((0..3).map(rotated)).collect()
}

/// `paths` are the distances that command and measurement have moved.
fn estimate_delay(
    commanded: &TimeSeries,
    (measured_t_s, measured): (&[f64], Vec<Vec<f64>>),
    paths: &[Vec<f64>; 2],
    max_lag_s: f64,
) -> Result<Response, DelayFailure> {
    if !is_streamed(&commanded.t_s) {
        return Err(DelayFailure::Goals);
    }
    if advances_in_steps((&commanded.t_s, &paths[0]), (measured_t_s, &paths[1])) {
        return Err(DelayFailure::Steps);
    }
    let (Some(first), Some(last)) = (commanded.t_s.first(), commanded.t_s.last()) else {
        return Err(NotObservable::NoOverlap.into());
    };
    let motion = |columns: &[Vec<f64>]| -> f64 {
        let ranges = columns.iter().map(|column| range_of(column.iter().copied()));
        ranges.map(|[low, high]| high - low).fold(0.0, f64::max)
    };
    if motion(&commanded.columns) < MIN_MOTION {
        return Err(NotObservable::AtRest.into());
    }
    let window_s = (COMMAND_PERIODS * median_period_s(&commanded.t_s))
        .max(STATE_PERIODS * median_period_s(measured_t_s))
        .max(MIN_WINDOW_S);
    let changes = ResponseChanges::from_windows(measured_t_s, &measured, (*first, *last), window_s);
    if changes.windows.is_empty() {
        return Err(NotObservable::NoOverlap.into());
    }
    if motion(&measured) < MIN_MOTION {
        return Err(NotObservable::DoesNotFollow(0.0).into());
    }
    Ok(changes.estimate_response(commanded, max_lag_s.min(MAX_DELAY_S))?)
}

pub(super) fn is_streamed(t_s: &[f64]) -> bool {
    const MIN_STREAM_COMMANDS: usize = 20;
    const MAX_STREAM_PERIOD_S: f64 = 0.2;
    t_s.len() >= MIN_STREAM_COMMANDS && median_period_s(t_s) <= MAX_STREAM_PERIOD_S
}
