//! Amounts of causes in a fit, and causes that it does not distinguish.

use super::fit::ArmFit;
use crate::model::measurement::State;
use crate::selection::model_selection::{Cause, MIN_CAUSE_SEPARATION};
use crate::{Confounder, EstimateResult, Measured, NotObservable};
use nalgebra::DVector;

impl ArmFit {
    /// First parameter of `cause` if `causes` and the always-free causes are free.
    pub(super) fn measured(&self, causes: &[Cause], cause: Cause) -> EstimateResult<Measured> {
        let state = &self.model.state;
        let parameters = self.candidates.free_parameters(causes, state);
        let parameter = cause.parameters(state).start;
        let at = parameters.binary_search(&parameter).map_err(|_| NotObservable::NotExcited)?;
        self.model.linear.measured(&parameters, at).ok_or(NotObservable::NotExcited)
    }

    /// Whether the motion does not separate the effects of two causes.
    pub(super) fn are_collinear(&self, one: Cause, other: Cause) -> bool {
        let state = &self.model.state;
        let mut both: Vec<usize> = one.parameters(state).chain(other.parameters(state)).collect();
        both.sort_unstable();
        self.model.linear.separation(&both) < MIN_CAUSE_SEPARATION
    }

    /// Causes that explain the log as well in its place.
    pub(super) fn confounders(&self, cause: Cause) -> Vec<Confounder> {
        let Self { model, candidates, .. } = self;
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
    pub(super) fn frame_confounders(&self, cause: Cause) -> Vec<Confounder> {
        let state = &self.model.state;
        let values = state.values();
        let round = state.streams.iter().enumerate().flat_map(|(s, stream)| {
            let reference = stream.round_reference.map(|_| Cause::Reference(s));
            reference.into_iter().chain(stream.round_tool.map(|_| Cause::Tool(s)))
        });
        let causes = self.candidates.free(&self.model.causes).into_iter().chain(round);
        causes
            .filter(|other| matches!(other, Cause::Reference(_) | Cause::Tool(_)))
            .filter(|frame| self.are_collinear(*frame, cause))
            .filter_map(|frame| as_confounder(frame, state, &values))
            .collect()
    }
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

#[cfg(test)]
mod tests {
    use crate::test_motion::{arm, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use crate::{Confounder, PoseStream, diagnose_arm};
    use ground::geometry::{Vec3, pose, rotation_from_rotvec};

    #[test]
    fn unknown_frames_hide_the_zeros_of_both_ends_whatever_their_axes() {
        const NOISE: f64 = 5e-4;
        let (joints, chain) = arm();
        let world = pose([0.4, -1.1, 0.7], rotation_from_rotvec(Vec3::new(0.1, 0.2, 1.3)));
        // The last joint turns the marker about one of its axes, or nearly so.
        for turn_rad in [0.0, 0.7, 1.5, 1.56, 1.57] {
            let marker = rotation_from_rotvec(Vec3::new(turn_rad, 0.0, 0.0));
            let marker = pose([0.02, 0.01, 0.06], marker);
            let mut random = Lcg::new();
            let noisy = |q: &[f64]| {
                let pose = world * chain.forward(q) * marker;
                let turn = rotation_from_rotvec(random.triple(NOISE).into());
                (pose.translation.vector + Vec3::from(random.triple(NOISE)), turn * pose.rotation)
            };
            let track = pose_track(&joints.t_s, joints.q.chunks(6).map(noisy));
            let stream = PoseStream { reference_known: false, ..tip_stream(&track, &chain) };
            let offsets = diagnose_arm(&joints, &[stream], 1.0).joints.offsets;
            let [first, last] = [0, 5].map(|joint: usize| &offsets[joint].confounders);
            let has_reference = first.iter().any(|it| matches!(it, Confounder::Reference(0, _)));
            let has_tool = last.iter().any(|it| matches!(it, Confounder::Tool(0, _)));
            assert!(has_reference && has_tool, "{turn_rad}: {first:?}, {last:?}");
        }
    }
}
