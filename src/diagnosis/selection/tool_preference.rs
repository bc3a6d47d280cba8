//! Prefers a tool offset (an active TCP) to a base offset if the motion barely distinguishes them, as with
//! constant tool orientation. A tool offset is a normal setting, a displaced base is a fault.

use super::model_selection::{CandidateCauses, Cause, SelectedModel, select_model};
use super::nominal_model::{is_calibratable_frame, noise_beside_links};
use crate::frames::constant_frames::tool_start;
use crate::model::measurement::{PoseObservations, StreamState};
use crate::priors::price;
use ground::geometry::Pose;

/// Of a fit by a tool, relative to one by the base. Noise of the joint positions rotates a tool, and shifts its tip.
const MAX_NOISE_RATIO: f64 = 1.5;

/// Replaces each tuned reference by a tool if that fits as well with link deviations. `offsets` has only the joint zeros too
/// large for link deviations.
pub(crate) fn prefer_tool_frames(
    observations: &[&PoseObservations],
    mut model: SelectedModel,
    candidates: &CandidateCauses,
    offsets: &[f64],
) -> SelectedModel {
    for (s, &observations_of_stream) in observations.iter().enumerate() {
        let stream = &model.state.streams[s];
        let is_tuned = stream.round_reference.is_none()
            && model.causes.contains(&Cause::Reference(s))
            && !model.causes.contains(&Cause::Tool(s))
            && candidates.optional.contains(&Cause::Tool(s));
        if !is_tuned {
            continue;
        }
        let by_reference = StreamState { radial_scale: 0.0, ..stream.clone() };
        let without_reference = StreamState { reference: Pose::identity(), ..by_reference.clone() };
        let Some(tool) = tool_start(observations_of_stream.at(&without_reference, offsets)) else {
            continue;
        };
        // Link deviations imitate smaller frames, whichever end they are at.
        if is_calibratable_frame(&tool) {
            continue;
        }
        let by_tool = StreamState { tool, ..without_reference };
        let beside_links = |state| noise_beside_links(observations_of_stream.at(state, offsets));
        let (tool_noise, tool_links) = beside_links(&by_tool);
        let (reference_noise, reference_links) = beside_links(&by_reference);
        let noise = || tool_noise.iter().zip(&reference_noise);
        let independent = model.linear.normal.independent;
        let log_ratios: f64 = noise().map(|(tool, reference)| (reference / tool).ln()).sum();
        // Twice the log likelihood that less noise by the tool gains.
        let gain = (2.0 * log_ratios * independent / tool_noise.len().max(1) as f64).max(0.0);
        let is_noise_equal = noise().all(|(tool, reference)| *tool <= MAX_NOISE_RATIO * reference);
        // A displaced base has the price of a cause.
        let fits_as_well = (is_noise_equal || gain > 0.0)
            && tool_links <= reference_links + price(independent) + gain;
        if !fits_as_well {
            continue;
        }
        let mut start = model.state.clone();
        start.streams[s] = by_tool;
        let candidates = candidates.retaining(|cause| *cause != Cause::Reference(s));
        model = select_model(observations, start, &candidates);
    }
    model
}
