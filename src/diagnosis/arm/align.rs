use crate::encodings::decoded_stream::DecodedStream;
use crate::model::measurement::{
    ExcludedComponents, PoseObservations, PredictionBuffers, StreamState,
};
use crate::selection::model_selection::SelectedModel;
use crate::{AlignedSamples, PoseStream};
use ground::geometry::pose;
use ground::stream::{JointTrack, Orientations};

/// Before and after correcting the selected causes.
pub(super) fn align(
    recorded: &JointTrack,
    stream: &PoseStream,
    prepared: &DecodedStream,
    explanation: &SelectedModel,
    index: usize,
) -> AlignedSamples {
    let witness = &prepared.observations;
    let found = &explanation.state.streams[index];
    let taken = found.frame_correction();
    let plain = StreamState::at_latency(0.0);
    let as_recorded = PoseObservations {
        joints: recorded,
        chain: witness.chain,
        columns: witness.columns,
        gains: &[],
        reference_known: witness.reference_known,
        rest_speeds: witness.rest_speeds,
        t_s: witness.t_s.clone(),
        xyz: Vec::new(),
        rotation: Vec::new(),
        excluded: witness.excluded,
        tool_part: witness.tool_part,
        middle_s: witness.middle_s,
    };
    let zero = vec![0.0; recorded.dof];
    let (mut sweep, mut truth_sweep) =
        (PredictionBuffers::new(&as_recorded), PredictionBuffers::new(witness));
    let truth_state = StreamState {
        latency_s: found.latency_s,
        skew: found.skew,
        ..StreamState::at_latency(0.0)
    };
    let mut aligned = AlignedSamples::default();
    let mut source = 0;
    for k in 0..witness.len() {
        let truth = witness.pose_at(k, &truth_state, &explanation.state.offsets, &mut truth_sweep);
        let fk = as_recorded.pose_at(k, &plain, &zero, &mut sweep);
        let (Some(truth), Some(fk)) = (truth, fk) else {
            continue;
        };
        while stream.track.t_s[source] < witness.t_s[k] {
            source += 1;
        }
        let rotation = match &stream.track.orientation {
            Orientations::Rotations(rotations) => rotations[source],
            Orientations::Numbers(_) | Orientations::Unset(_) => witness.rotation[k],
        };
        let mut read = pose(witness.xyz[k].into(), witness.rotation[k]);
        if witness.excluded != ExcludedComponents::default() {
            witness.excluded.fill(&mut read, &taken.invert(&truth));
        }
        aligned.t_s.push(witness.t_s[k]);
        aligned.logged.push(pose(stream.track.xyz[source].into(), rotation));
        aligned.fk.push(fk);
        aligned.corrected.push(taken.apply(&read));
        aligned.fk_at_truth.push(truth);
    }
    aligned
}
