//! Prefers a tool offset (an active TCP) to a base offset if the motion barely distinguishes them, as with
//! constant tool orientation. A tool offset is a normal setting, a displaced base is a fault.

use super::model_selection::{CandidateCauses, Cause, SelectedModel, select_model};
use crate::frames::constant_frames::tool_start;
use crate::model::measurement::{PoseObservations, StreamState};
use ground::geometry::Pose;

/// The tool may have this multiple of the base's residual.
const MAX_RESIDUAL_RATIO: f64 = 1.5;
/// It may also exceed the base's by this, m and rad: the effect of typical link deviations.
const MAX_EXTRA_RESIDUAL_M_RAD: [f64; 2] = [0.3e-3, 0.3e-3];

/// Replaces each tuned reference by a tool if that fits as well, on about `max_samples` samples per stream.
pub(crate) fn prefer_tool_frames(
    observations: &[&PoseObservations],
    mut model: SelectedModel,
    candidates: &CandidateCauses,
    max_samples: usize,
) -> SelectedModel {
    for s in 0..observations.len() {
        let stream = &model.state.streams[s];
        let is_tuned = stream.round_reference.is_none()
            && model.causes.contains(&Cause::Reference(s))
            && !model.causes.contains(&Cause::Tool(s))
            && candidates.optional.contains(&Cause::Tool(s));
        if !is_tuned {
            continue;
        }
        let without_reference = StreamState { reference: Pose::identity(), ..stream.clone() };
        let offsets = &model.state.offsets;
        let Some(tool) = tool_start(observations[s], &without_reference, offsets) else { continue };
        let mut start = model.state.clone();
        start.streams[s] = StreamState { tool, ..without_reference };
        let without = |cause: &&Cause| **cause != Cause::Reference(s);
        let optional = candidates.optional.iter().filter(without).copied().collect();
        let candidates = CandidateCauses { optional, ..candidates.clone() };
        let other = select_model(observations, start, &candidates, max_samples);
        if other.causes.len() <= model.causes.len() && fits_as_well(&other, &model) {
            model = other;
        }
    }
    model
}

fn fits_as_well(one: &SelectedModel, other: &SelectedModel) -> bool {
    let kinds = MAX_EXTRA_RESIDUAL_M_RAD.iter().cycle();
    one.noise().iter().zip(&other.noise()).zip(kinds).all(|((one, other), more)| {
        one.sigma <= (MAX_RESIDUAL_RATIO * other.sigma).max(other.sigma + more)
    })
}
