use super::stream::StreamFit;
use crate::AlignedSamples;
use crate::model::measurement::{
    ExcludedComponents, PoseObservations, Prediction, StreamAt, StreamState,
};
use crate::samples::sampling::{FkSequence, as_rotations};
use ground::geometry::{Pose, pose};

/// Before and after correcting the selected causes.
pub(super) fn align(fit: &StreamFit) -> AlignedSamples {
    let StreamFit { recorded, stream, .. } = fit;
    let StreamAt { observations, state, offsets } = fit.at();
    let correction = state.frame_correction();
    let truth_state = without_frames(state);
    let mut truths = observations.at(&truth_state, offsets).predictor();
    let mut recorded_fk = FkSequence::new(recorded, observations.chain, observations.columns);
    let mut aligned = AlignedSamples::default();
    let rotations = as_rotations(&stream.track.orientation);
    let mut source = 0;
    for k in 0..observations.len() {
        let (Some(Prediction { jacobian, q, .. }), Some(fk)) =
            (truths.at(k), recorded_fk.at(observations.t_s[k]))
        else {
            continue;
        };
        let truth = jacobian.pose;
        while stream.track.t_s[source] < observations.t_s[k] {
            source += 1;
        }
        let rotation = rotations.map_or(observations.rotation[k], |all| all[source]);
        let mut decoded_pose = pose(observations.xyz[k].into(), observations.rotation[k]);
        if observations.excluded != ExcludedComponents::default() {
            observations.excluded.fill(&mut decoded_pose, &correction.invert(&truth));
        }
        if let Some(frame) = stream.moving_frame {
            let base_from_frame = frame.pose_at(observations.t_s[k] - frame.lag_s);
            let Some(base_from_frame) = base_from_frame else { continue };
            aligned.frame_from_base.push(base_from_frame.inverse());
        }
        aligned.t_s.push(observations.t_s[k]);
        aligned.logged.push(pose(stream.track.xyz[source].into(), rotation));
        aligned.fk.push(fk);
        aligned.corrected.push(correction.apply(&decoded_pose));
        aligned.fk_at_truth.push(truth);
        aligned.q_at_truth.extend_from_slice(q);
    }
    aligned
}

/// FK at the times of measurement of aligned samples whose stamps are later by `late_s`. `None` where joint states do not
/// cover them.
pub(super) fn fk_at_latency(
    fit: &StreamFit,
    aligned: &AlignedSamples,
    late_s: &dyn Fn(f64) -> f64,
) -> Vec<Option<Pose>> {
    let StreamAt { observations, state, offsets } = fit.at();
    let state = without_frames(state);
    let t_s = aligned.t_s.iter().map(|t_s| t_s - late_s(*t_s)).collect();
    let observations =
        PoseObservations { t_s, xyz: Vec::new(), rotation: Vec::new(), ..*observations };
    let mut predictor = observations.at(&state, offsets).predictor();
    (0..aligned.t_s.len()).map(|row| predictor.pose_at(row)).collect()
}

/// Latency and skew alone.
fn without_frames(state: &StreamState) -> StreamState {
    StreamState { skew: state.skew, ..StreamState::at_latency(state.latency_s) }
}
