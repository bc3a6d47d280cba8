use crate::encodings::decoded_stream::DecodedStream;
use crate::model::measurement::{ExcludedComponents, PoseObservations, Prediction, StreamState};
use crate::samples::sampling::{FkSequence, as_rotations};
use crate::selection::model_selection::SelectedModel;
use crate::{AlignedSamples, PoseStream};
use ground::geometry::{Pose, pose};
use ground::stream::JointTrack;

/// Before and after correcting the selected causes.
pub(super) fn align(
    recorded: &JointTrack,
    stream: &PoseStream,
    decoded: &DecodedStream,
    model: &SelectedModel,
    index: usize,
) -> AlignedSamples {
    let observations = &decoded.observations;
    let stream_state = &model.state.streams[index];
    let correction = stream_state.frame_correction();
    let StreamState { latency_s, skew, .. } = *stream_state;
    let truth_state = StreamState { skew, ..StreamState::at_latency(latency_s) };
    let mut truths = observations.at(&truth_state, &model.state.offsets).predictor();
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
    aligned: &AlignedSamples,
    decoded: &DecodedStream,
    model: &SelectedModel,
    index: usize,
    late_s: &dyn Fn(f64) -> f64,
) -> Vec<Option<Pose>> {
    let StreamState { latency_s, skew, .. } = model.state.streams[index];
    let state = StreamState { skew, ..StreamState::at_latency(latency_s) };
    let t_s = aligned.t_s.iter().map(|t_s| t_s - late_s(*t_s)).collect();
    let observations =
        PoseObservations { t_s, xyz: Vec::new(), rotation: Vec::new(), ..decoded.observations };
    let mut predictor = observations.at(&state, &model.state.offsets).predictor();
    (0..aligned.t_s.len()).map(|row| predictor.pose_at(row)).collect()
}
