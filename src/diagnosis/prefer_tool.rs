//! Prefers a tool offset (an active TCP) to a base offset if the motion cannot distinguish them well.
//!
//! If the tool keeps its orientation, a tool offset and a base offset have the same effect. A tool offset
//! is a normal controller setting, a displaced base is a fault. So the tool is selected if it fits about as
//! well.

use super::frames::tool_start;
use super::model::{PoseObservations, StreamState};
use super::model_selection::{Approach, CandidateCauses, Cause, SelectedModel, select_model};
use ground::geometry::Pose;

/// The tool fits as well if its residual is at most this multiple of the base's, …
const MAX_RESIDUAL_RATIO: f64 = 1.5;
/// … or exceeds it by at most this, m and rad. This is the effect of typical link deviations.
const MAX_EXTRA_RESIDUAL_M_RAD: [f64; 2] = [0.3e-3, 0.3e-3];

/// Replaces each tuned reference frame by a tool frame if that fits as well. Fits about `most` samples per
/// stream.
pub(super) fn prefer_tool_frames(
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
