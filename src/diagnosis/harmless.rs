//! An active TCP before a moved base, where the motion hardly tells them apart.
//!
//! A tool that keeps its orientation is as far from the flange, seen from the base, as from the flange
//! itself: its offset and one of the base are the same numbers. An offset of the tool is what controllers
//! are set to; a base beside its place is a fault. So the tool is named wherever it leaves as little.

use super::explain::{Approach, Cause, Explanation, Menu, explain};
use super::frames::tool_start;
use super::model::{StreamState, Witness};
use ground::geometry::Pose;

/// What leaves at most so many times as much, …
const AS_LITTLE: f64 = 1.5;
/// … or more by at most this, leaves as little: what a drawing differs from an arm by, m and rad.
const AS_LITTLE_MORE: [f64; 2] = [0.3e-3, 0.3e-3];

/// The explanation with a tool in the place of each tuned reference frame that a tool explains as well,
/// fitted on about `most` samples a stream.
pub(super) fn tools_first(
    witnesses: &[&Witness],
    mut explanation: Explanation,
    menu: &Menu,
    most: usize,
) -> Explanation {
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
        let menu = Menu { optional, ..menu.clone() };
        let other = explain(witnesses, start, &menu, Approach::Careful, most);
        if other.causes.len() <= explanation.causes.len() && leaves_as_little(&other, &explanation)
        {
            explanation = other;
        }
    }
    explanation
}

fn leaves_as_little(one: &Explanation, other: &Explanation) -> bool {
    let kinds = AS_LITTLE_MORE.iter().cycle();
    one.noise()
        .iter()
        .zip(&other.noise())
        .zip(kinds)
        .all(|((one, other), more)| one.sigma <= (AS_LITTLE * other.sigma).max(other.sigma + more))
}
