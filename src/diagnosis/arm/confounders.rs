use super::fit::ArmFit;
use crate::selection::model_selection::{Cause, MIN_CAUSE_SEPARATION};
use crate::{Confounder, EstimateResult, Measured, NotObservable};

/// Parameter `which` of `cause` if `causes` and the always-free causes are free.
pub(super) fn measured(
    fitted: &ArmFit,
    causes: &[Cause],
    cause: Cause,
    which: usize,
) -> EstimateResult<Measured> {
    let ArmFit { model, candidates, .. } = fitted;
    let state = &model.state;
    let parameters = candidates.free_parameters(causes, state);
    let parameter = cause.parameters(state).start + which;
    let at = parameters.binary_search(&parameter).map_err(|_| NotObservable::NotExcited)?;
    model.linear.measured(&parameters, at, state).ok_or(NotObservable::NotExcited)
}

/// Causes that explain the log as well in its place.
pub(super) fn confounders(fitted: &ArmFit, cause: Cause) -> Vec<Confounder> {
    let ArmFit { model, candidates, .. } = fitted;
    let (state, linear) = (&model.state, &model.linear);
    let cost = linear.cost(&candidates.free_parameters(&model.causes, state));
    let rest: Vec<Cause> = model.causes.iter().copied().filter(|c| *c != cause).collect();
    candidates
        .optional
        .iter()
        .filter(|other| !model.causes.contains(other))
        .filter_map(|&other| {
            let swapped: Vec<Cause> = rest.iter().copied().chain([other]).collect();
            let parameters = candidates.free_parameters(&swapped, state);
            if linear.cost(&parameters) > cost + 12.0 {
                return None;
            }
            let values = state.values() + linear.step(&parameters);
            let effects: Vec<f64> = other.parameters(state).map(|p| values[p]).collect();
            match other {
                Cause::Zero(joint) => Some(Confounder::JointZero(joint, effects[0])),
                Cause::Reference(s) => Some(Confounder::Reference(s, frame_size(&effects))),
                Cause::Tool(s) => Some(Confounder::Tool(s, frame_size(&effects))),
                _ => None,
            }
        })
        .collect()
}

/// Collinear with the joint offset `cause`.
pub(super) fn frame_confounders(fitted: &ArmFit, cause: Cause) -> Vec<Confounder> {
    let ArmFit { model, candidates, .. } = fitted;
    let (state, linear) = (&model.state, &model.linear);
    let values = state.values();
    let frames = candidates.always.iter().chain(&model.causes);
    let round = (0..state.streams.len()).flat_map(|s| {
        let stream = &state.streams[s];
        let reference = stream.round_reference.map(|_| Cause::Reference(s));
        reference.into_iter().chain(stream.round_tool.map(|_| Cause::Tool(s)))
    });
    let round: Vec<Cause> = round.collect();
    frames
        .chain(&round)
        .filter_map(|&frame| {
            let mut parameters: Vec<usize> = frame.parameters(state).collect();
            let own: Vec<f64> = parameters.iter().map(|&p| values[p]).collect();
            parameters.extend(cause.parameters(state));
            parameters.sort_unstable();
            let same = linear.normal.separation(&[], &parameters) < MIN_CAUSE_SEPARATION;
            match frame {
                Cause::Reference(s) if same => Some(Confounder::Reference(s, frame_size(&own))),
                Cause::Tool(s) if same => Some(Confounder::Tool(s, frame_size(&own))),
                _ => None,
            }
        })
        .collect()
}

/// Angle in rad, or length in m if it does not rotate.
fn frame_size(twist: &[f64]) -> f64 {
    let norm = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (length, angle) = (norm(&twist[..3]), norm(&twist[3..]));
    if angle > 1e-5 { angle } else { length }
}
