use super::fit::ArmFit;
use crate::model::measurement::State;
use crate::selection::model_selection::{Cause, MIN_CAUSE_SEPARATION, SelectedModel};
use crate::{Confounder, EstimateResult, Measured, NotObservable};
use nalgebra::DVector;

/// First parameter of `cause` if `causes` and the always-free causes are free.
pub(super) fn measured(
    fitted: &ArmFit,
    causes: &[Cause],
    cause: Cause,
) -> EstimateResult<Measured> {
    let ArmFit { model, candidates, .. } = fitted;
    let state = &model.state;
    let parameters = candidates.free_parameters(causes, state);
    let parameter = cause.parameters(state).start;
    let at = parameters.binary_search(&parameter).map_err(|_| NotObservable::NotExcited)?;
    model.linear.measured(&parameters, at).ok_or(NotObservable::NotExcited)
}

/// Whether the motion does not separate the effects of two causes.
pub(super) fn are_collinear(model: &SelectedModel, one: Cause, other: Cause) -> bool {
    let state = &model.state;
    let mut both: Vec<usize> = one.parameters(state).chain(other.parameters(state)).collect();
    both.sort_unstable();
    model.linear.normal.separation(&[], &both) < MIN_CAUSE_SEPARATION
}

/// Causes that explain the log as well in its place.
pub(super) fn confounders(fitted: &ArmFit, cause: Cause) -> Vec<Confounder> {
    let ArmFit { model, candidates, .. } = fitted;
    let (state, linear) = (&model.state, &model.linear);
    let cost = linear.cost(&candidates.free_parameters(&model.causes, state));
    let rest: Vec<Cause> = model.causes.iter().copied().filter(|c| *c != cause).collect();
    let confounder = |&other: &Cause| {
        let swapped: Vec<Cause> = rest.iter().copied().chain([other]).collect();
        let parameters = candidates.free_parameters(&swapped, state);
        if linear.cost(&parameters) > cost + 12.0 {
            return None;
        }
        as_confounder(other, state, &(state.values() + linear.step(&parameters)))
    };
    let others = candidates.optional.iter().filter(|other| !model.causes.contains(other));
    others.filter_map(confounder).collect()
}

/// Frames that are collinear with the joint offset `cause`.
pub(super) fn frame_confounders(fitted: &ArmFit, cause: Cause) -> Vec<Confounder> {
    let ArmFit { model, candidates, .. } = fitted;
    let state = &model.state;
    let values = state.values();
    let round = state.streams.iter().enumerate().flat_map(|(s, stream)| {
        let reference = stream.round_reference.map(|_| Cause::Reference(s));
        reference.into_iter().chain(stream.round_tool.map(|_| Cause::Tool(s)))
    });
    let causes = candidates.always.iter().chain(&model.causes).copied().chain(round);
    causes
        .filter(|other| matches!(other, Cause::Reference(_) | Cause::Tool(_)))
        .filter(|frame| are_collinear(model, *frame, cause))
        .filter_map(|frame| as_confounder(frame, state, &values))
        .collect()
}

/// A joint zero or a frame with its value. `None` for other causes.
fn as_confounder(cause: Cause, state: &State, values: &DVector<f64>) -> Option<Confounder> {
    let own = &values.as_slice()[cause.parameters(state)];
    match cause {
        Cause::Zero(joint) => Some(Confounder::JointZero(joint, own[0])),
        Cause::Reference(s) => Some(Confounder::Reference(s, frame_size(own))),
        Cause::Tool(s) => Some(Confounder::Tool(s, frame_size(own))),
        _ => None,
    }
}

/// Angle in rad, or length in m if it does not rotate.
fn frame_size(twist: &[f64]) -> f64 {
    let norm = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (length, angle) = (norm(&twist[..3]), norm(&twist[3..]));
    if angle > 1e-5 { angle } else { length }
}
