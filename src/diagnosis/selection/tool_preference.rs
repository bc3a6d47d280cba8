//! Prefers a tool offset (an active TCP) to a base offset if the motion barely distinguishes them, as with
//! constant tool orientation. A tool offset is a normal setting, a displaced base is a fault.

use super::model_selection::{Approach, CandidateCauses, Cause, SelectedModel, select_model};
use crate::frames::constant_frames::tool_start;
use crate::model::measurement::{PoseObservations, StreamState};
use ground::geometry::Pose;

/// The tool may have this multiple of the base's residual.
const MAX_RESIDUAL_RATIO: f64 = 1.5;
/// It may also exceed the base's by this, m and rad: the effect of typical link deviations.
const MAX_EXTRA_RESIDUAL_M_RAD: [f64; 2] = [0.3e-3, 0.3e-3];

/// Replaces each tuned reference by a tool if that fits as well, on about `most` samples per stream.
pub(crate) fn prefer_tool_frames(
    witnesses: &[&PoseObservations],
    mut explanation: SelectedModel,
    menu: &CandidateCauses,
    most: usize,
) -> SelectedModel {
    for s in 0..witnesses.len() {
        let found = &explanation.state.streams[s];
        let is_tuned = found.round_reference.is_none()
            && explanation.causes.contains(&Cause::Reference(s))
            && !explanation.causes.contains(&Cause::Tool(s))
            && menu.optional.contains(&Cause::Tool(s));
        if !is_tuned {
            continue;
        }
        let plain = StreamState { reference: Pose::identity(), ..found.clone() };
        let offsets = &explanation.state.offsets;
        let Some(tool) = tool_start(witnesses[s], &plain, offsets) else { continue };
        let mut start = explanation.state.clone();
        start.streams[s] = StreamState { tool, ..plain };
        let without = |cause: &&Cause| **cause != Cause::Reference(s);
        let optional = menu.optional.iter().filter(without).copied().collect();
        let menu = CandidateCauses { optional, ..menu.clone() };
        let other = select_model(witnesses, start, &menu, Approach::Careful, most);
        if other.causes.len() <= explanation.causes.len() && fits_as_well(&other, &explanation) {
            explanation = other;
        }
    }
    explanation
}

fn fits_as_well(one: &SelectedModel, other: &SelectedModel) -> bool {
    let kinds = MAX_EXTRA_RESIDUAL_M_RAD.iter().cycle();
    one.noise().iter().zip(&other.noise()).zip(kinds).all(|((one, other), more)| {
        one.sigma <= (MAX_RESIDUAL_RATIO * other.sigma).max(other.sigma + more)
    })
}
