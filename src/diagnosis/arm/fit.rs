//! Fits all streams of an arm together, from the best starting state of each.

use super::{MAX_EXPLAINED_M, MAX_EXPLAINED_RAD};
use crate::encodings::decoded_stream::DecodedStream;
use crate::frames::constant_frames::{constant_frame_residual, starting_states};
use crate::joints::{CorrectedJoints, is_quarter_turn, single_zeros};
use crate::latency::correlation::LagPeak;
use crate::model::measurement::{PoseObservations, State, StreamState};
use crate::samples::sampling::MAX_SEARCH_SAMPLES;
use crate::selection::link_deviations::{
    LinkDeviations, ZERO_PRIOR, causes_beyond_link_deviations, estimate_link_deviations,
};
use crate::selection::model_selection::{
    Approach, CandidateCauses, Cause, SelectedModel, best_model, select_model,
};
use crate::selection::nominal_model::{MAX_TIP_CHANGE_M, MAX_TIP_CHANGE_RAD, is_nominal, rms};
use crate::selection::tool_preference::prefer_tool_frames;
use ground::geometry::Pose;
use ground::robot::JointKind;
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_2;

/// Per stream.
pub(crate) const FIT_SAMPLES: usize = 4000;

pub(super) struct ArmFit {
    pub(super) model: SelectedModel,
    pub(super) candidates: CandidateCauses,
    /// Joint zeros with link deviations, if a nominal model is compared with a calibrated arm. Causes that
    /// deviations can imitate are then not reported.
    pub(super) deviations: Option<LinkDeviations>,
}

/// Whether links may deviate from the model.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum LinkModel {
    Deviate,
    /// Already corrected by another segment's result.
    AreKnown,
}

pub(super) fn fit(
    prepared: &[&DecodedStream],
    read: &CorrectedJoints,
    with_offsets: bool,
    links: LinkModel,
) -> Option<ArmFit> {
    if prepared.is_empty() {
        return None;
    }
    let alone: Vec<State> =
        prepared.iter().map(|prepared| best_start(prepared, read, with_offsets)).collect();
    let witnesses: Vec<&PoseObservations> =
        prepared.iter().map(|prepared| &prepared.observations).collect();
    let menu = candidate_causes(prepared, read, with_offsets);
    // The streams share the joints: start from the stream with most samples.
    let most = (0..prepared.len()).max_by_key(|&s| prepared[s].observations.len()).unwrap_or(0);
    let start = State {
        offsets: alone[most].offsets.clone(),
        streams: alone.into_iter().flat_map(|state| state.streams).collect(),
    };
    let explanation = select_model(&witnesses, start, &menu, Approach::Careful, FIT_SAMPLES);
    let explanation = prefer_tool_frames(&witnesses, explanation, &menu, FIT_SAMPLES);
    let plain: Vec<StreamState> =
        (0..witnesses.len()).map(|s| without_small_causes(&explanation, s)).collect();
    let most = (0..witnesses.len()).max_by_key(|&s| witnesses[s].len())?;
    // Calibrations do not change a zero by more, rad or m.
    let large = large_zeros(&explanation.state, read, 0.1);
    let is_open = with_offsets && allows_link_deviations(&explanation);
    let drawing = if is_open {
        estimate_link_deviations(witnesses[most], &plain[most], &large)
    } else {
        None
    };
    let offsets = drawing.as_ref().map_or_else(|| large.clone(), |it| it.with_zeros(&large));
    let is_of_calibrated =
        |s: usize| is_nominal(witnesses[s], s, &explanation.state, &plain[s], &offsets);
    if !is_open || !(0..witnesses.len()).any(is_of_calibrated) {
        let fitted = ArmFit { model: explanation, candidates: menu, deviations: None };
        return Some(match with_offsets && links == LinkModel::Deviate {
            true => drop_imitated_causes(fitted, &witnesses, most),
            false => fitted,
        });
    }
    let large = offsets;
    let kept = |cause: &Cause| match *cause {
        Cause::Zero(joint) => large[joint] != 0.0,
        Cause::RadialScale(_) => false,
        Cause::JointScale(_) => true,
        Cause::Latency(_) | Cause::Skew(_) => true,
        Cause::Reference(s) => plain[s].reference != Pose::identity(),
        Cause::Tool(s) => plain[s].tool != Pose::identity(),
    };
    let is_named = |cause: &Cause| match *cause {
        Cause::Zero(joint) => drawing.as_ref().is_some_and(|it| it.confounders(joint).is_some()),
        _ => false,
    };
    let (named, optional): (Vec<Cause>, Vec<Cause>) =
        menu.optional.into_iter().filter(kept).partition(is_named);
    let menu = CandidateCauses { always: [menu.always, named].concat(), optional };
    let start = State { offsets: large, streams: plain };
    let explanation = select_model(&witnesses, start, &menu, Approach::Careful, FIT_SAMPLES);
    Some(ArmFit { model: explanation, candidates: menu, deviations: drawing })
}

/// Applies if constant frames have a small residual of stream `s` without them.
fn drop_imitated_causes(fitted: ArmFit, witnesses: &[&PoseObservations], s: usize) -> ArmFit {
    let ArmFit { model: explanation, candidates: menu, .. } = &fitted;
    let small = small_causes(explanation, s);
    if small.is_empty() || !explains_all(explanation) {
        return fitted;
    }
    let is_held =
        |cause: Cause| explanation.causes.contains(&cause) || menu.always.contains(&cause);
    let undone = |causes: &[Cause]| {
        let mut state = explanation.state.clone();
        for (s, stream) in state.streams.iter_mut().enumerate() {
            // A frame that does not count as a cause must be exactly the identity.
            if !is_held(Cause::Reference(s)) && stream.round_reference.is_none() {
                stream.reference = Pose::identity();
            }
            if !is_held(Cause::Tool(s)) && stream.round_tool.is_none() {
                stream.tool = Pose::identity();
            }
        }
        for cause in causes {
            match *cause {
                Cause::Zero(joint) => state.offsets[joint] = 0.0,
                Cause::Reference(s) => state.streams[s].reference = Pose::identity(),
                Cause::Tool(s) => state.streams[s].tool = Pose::identity(),
                Cause::RadialScale(s) => state.streams[s].radial_scale = 0.0,
                Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => {}
            }
        }
        state
    };
    let State { offsets, streams } = undone(&small);
    let standing = causes_beyond_link_deviations((witnesses[s], s), &streams[s], &offsets, &small);
    let (_, feigned): (Vec<Cause>, Vec<Cause>) =
        small.into_iter().partition(|cause| standing.contains(cause));
    if feigned.is_empty() {
        return fitted;
    }
    let kept = |cause: &Cause| {
        matches!(cause, Cause::Latency(_) | Cause::Skew(_) | Cause::JointScale(_))
            || (explanation.causes.contains(cause) && !feigned.contains(cause))
    };
    let optional = menu.optional.iter().copied().filter(kept).collect();
    let menu = CandidateCauses { always: menu.always.clone(), optional };
    let start = undone(&feigned);
    let nominal = estimate_link_deviations(witnesses[s], &start.streams[s], &start.offsets);
    let explanation = select_model(witnesses, start, &menu, Approach::Careful, FIT_SAMPLES);
    let State { offsets, streams } = &explanation.state;
    // Dropped causes may leave a constant offset in a known frame, as usual links do.
    let is_constant = || {
        let [m, rad] = constant_frame_residual(witnesses[s], &streams[s], offsets);
        witnesses[s].reference_known && m < MAX_EXPLAINED_M && rad < MAX_EXPLAINED_RAD
    };
    match explains_all(&explanation) || is_constant() {
        true => ArmFit { model: explanation, candidates: menu, deviations: nominal },
        false => fitted,
    }
}

/// Whether every stream's residual is below MDL001's thresholds.
fn explains_all(explanation: &SelectedModel) -> bool {
    explanation.linear.streams.iter().all(|stream| {
        rms(&stream.residual[0]) < MAX_EXPLAINED_M && rms(&stream.residual[1]) < MAX_EXPLAINED_RAD
    })
}

/// Causes of stream `s` that link deviations can imitate: zeros below [`ZERO_PRIOR`], small frames, and
/// radial scale. Causes below MDL001's thresholds are not faults.
fn small_causes(explanation: &SelectedModel, s: usize) -> Vec<Cause> {
    let found = &explanation.state.streams[s];
    let is_near = |frame: &Pose| {
        let (m, rad) = (frame.translation.vector.norm(), frame.rotation.angle());
        (m > MAX_EXPLAINED_M || rad > MAX_EXPLAINED_RAD)
            && m <= MAX_TIP_CHANGE_M
            && rad <= MAX_TIP_CHANGE_RAD
    };
    let is_small = |cause: &&Cause| match **cause {
        Cause::Zero(joint) => {
            (MAX_EXPLAINED_RAD..ZERO_PRIOR).contains(&explanation.state.offsets[joint].abs())
        }
        Cause::Reference(own) => own == s && is_near(&found.reference),
        Cause::Tool(own) => own == s && is_near(&found.tool),
        Cause::RadialScale(own) => own == s && found.radial_scale.abs() > MAX_EXPLAINED_M,
        Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => false,
    };
    explanation.causes.iter().filter(is_small).copied().collect()
}

/// Requires several causes, or one with a remaining residual.
fn allows_link_deviations(explanation: &SelectedModel) -> bool {
    /// For white noise; a larger inflation indicates a wrong model.
    const MAX_NOISE_INFLATION: f64 = 1.5;
    let is_small = |cause: &&Cause| !matches!(cause, Cause::Skew(_) | Cause::JointScale(_));
    explanation.causes.iter().filter(is_small).count() > 1
        || explanation.noise().iter().any(|noise| noise.inflation() > MAX_NOISE_INFLATION)
}

/// Offsets above `most`, rad or m, and all scales.
fn large_zeros(state: &State, read: &CorrectedJoints, most: f64) -> Vec<f64> {
    let kept = |(index, value): (usize, &f64)| {
        if index >= read.track.dof || value.abs() > most { *value } else { 0.0 }
    };
    state.offsets.iter().enumerate().map(kept).collect()
}

/// Keeps frames that are unknown, round, or too large for a calibration.
pub(super) fn without_small_causes(explanation: &SelectedModel, stream: usize) -> StreamState {
    let found = &explanation.state.streams[stream];
    let is_large = |frame: &Pose| {
        frame.translation.vector.norm() > MAX_TIP_CHANGE_M
            || frame.rotation.angle() > MAX_TIP_CHANGE_RAD
    };
    let kept = |frame: &Pose| if is_large(frame) { *frame } else { Pose::identity() };
    StreamState {
        radial_scale: 0.0,
        reference: kept(&found.reference),
        tool: kept(&found.tool),
        ..found.clone()
    }
}

fn candidate_causes(
    prepared: &[&DecodedStream],
    read: &CorrectedJoints,
    with_offsets: bool,
) -> CandidateCauses {
    let (mut always, mut optional) = (Vec::new(), Vec::new());
    if with_offsets {
        let dof = read.track.dof;
        let seen = |joint: &usize| prepared.iter().any(|p| p.observations.columns.contains(joint));
        let (of_code, own): (Vec<usize>, Vec<usize>) =
            (0..dof).filter(seen).partition(|&joint| read.has_encoded_zero(joint));
        optional.extend(own.into_iter().map(Cause::Zero));
        always.extend(of_code.into_iter().map(Cause::Zero));
        always.extend((dof..dof + read.gains.len()).map(Cause::JointScale));
    }
    for (s, prepared) in prepared.iter().enumerate() {
        if prepared.moves {
            always.push(Cause::Latency(s));
            optional.push(Cause::Skew(s));
        }
        if !prepared.observations.reference_known {
            always.push(Cause::Reference(s));
        } else if with_offsets {
            optional.push(Cause::Reference(s));
        }
        // A stream derived from the joint states must agree with them: no frame or scale causes.
        if with_offsets {
            optional.extend([Cause::Tool(s), Cause::RadialScale(s)]);
        }
    }
    CandidateCauses { always, optional }
}

/// State from which a single stream fits best.
fn best_start(prepared: &DecodedStream, read: &CorrectedJoints, with_offsets: bool) -> State {
    let menu = candidate_causes(&[prepared], read, with_offsets);
    let best_lag = prepared.peaks.first().map_or(0.0, |peak| peak.correlation);
    let lags: Vec<f64> = if prepared.moves {
        let near = |peak: &&LagPeak| peak.correlation > best_lag - 0.1;
        // Streams that copy the joints' stamps have zero latency, a narrow minimum.
        prepared.peaks.iter().filter(near).take(3).map(|peak| peak.lag_s).chain([0.0]).collect()
    } else {
        vec![0.0]
    };
    let start = |offsets: &[f64], stream: StreamState| State {
        offsets: offsets.to_vec(),
        streams: vec![stream],
    };
    let mut begun: Vec<State> = Vec::new();
    for &lag_s in &lags {
        if !with_offsets {
            begun.push(start(&read.offsets, StreamState::at_latency(lag_s)));
            continue;
        }
        let frames = starting_states(&prepared.observations, lag_s, &read.offsets);
        let is_far = frames.len() > 1;
        begun.extend(frames.into_iter().map(|stream| start(&read.offsets, stream)));
        if is_far && prepared.observations.reference_known {
            for (joint, zero) in single_zeros(&prepared.observations, lag_s, &read.offsets) {
                let mut offsets = read.offsets.clone();
                offsets[joint] = zero;
                begun.push(start(&offsets, StreamState::at_latency(lag_s)));
            }
        }
    }
    let explanations = begun
        .into_par_iter()
        .flat_map_iter(|state| [(state.clone(), Approach::Careful), (state, Approach::Bold)])
        .map(|(state, approach)| {
            select_model(&[&prepared.observations], state, &menu, approach, MAX_SEARCH_SAMPLES)
        })
        .collect();
    let state = best_model(explanations)
        .map_or_else(|| start(&read.offsets, StreamState::at_latency(0.0)), |best| best.state);
    with_base_turned(state, &prepared.observations)
}

/// Quarter turns of the first joint's zero are equivalent to a base rotation, which differs between makers.
fn with_base_turned(mut state: State, witness: &PoseObservations) -> State {
    let Some(&first) = witness.columns.first() else { return state };
    let is_turning = witness.chain.joint_kinds().first() != Some(&JointKind::Prismatic);
    let turn = (state.offsets[first] / FRAC_PI_2).round() * FRAC_PI_2;
    if !is_turning || turn == 0.0 || !is_quarter_turn(state.offsets[first]) {
        return state;
    }
    let mut positions = vec![0.0; witness.columns.len()];
    let at_zero = witness.chain.forward(&positions);
    positions[0] = turn;
    let turned = witness.chain.forward(&positions) * at_zero.inverse();
    state.offsets[first] -= turn;
    for stream in &mut state.streams {
        stream.reference *= turned;
        let round = stream.round_reference.unwrap_or_default() * turned;
        stream.round_reference = witness.reference_known.then_some(round);
    }
    state
}
