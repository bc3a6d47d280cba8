//! Fits all streams of an arm together, from the best starting state of each.

use crate::LastTurn;
use crate::encodings::decoded_stream::DecodedStream;
use crate::frames::constant_frames::{constant_frame_residual, starting_states};
use crate::joints::{CorrectedJoints, is_quarter_turn, single_zeros};
use crate::latency::correlation::{LagPeak, median_period_s};
use crate::model::measurement::{
    MAX_EXPLAINED_M, MAX_EXPLAINED_RAD, PoseObservations, State, StreamState,
};
use crate::priors::ZERO_PRIOR;
use crate::samples::sampling::MAX_SEARCH_SAMPLES;
use crate::selection::causes_beside_links::{causes_beyond_link_deviations, zero_instead_of_frame};
use crate::selection::link_deviations::{LinkDeviations, estimate_link_deviations};
use crate::selection::model_selection::{
    CandidateCauses, Cause, MAX_NOISE_INFLATION, SelectedModel, or_without_causes, parameter_count,
    select_from_starts, select_model,
};
use crate::selection::nominal_model::{
    Timing, is_calibratable, is_calibratable_frame, is_nominal, rms_of_kinds,
    timing_beside_link_deviations,
};
use crate::selection::tool_preference::prefer_tool_frames;
use ground::geometry::Pose;
use ground::robot::JointKind;
use std::f64::consts::FRAC_PI_2;
use std::sync::atomic::{AtomicUsize, Ordering};

pub(super) struct ArmFit {
    pub(super) model: SelectedModel,
    pub(super) candidates: CandidateCauses,
    /// Joint zeros with link deviations, if a nominal model is compared with a calibrated arm. Causes that
    /// deviations can imitate are then not reported.
    pub(super) deviations: Option<LinkDeviations>,
    /// Per stream, beside these deviations.
    pub(super) timings: Vec<Option<Timing>>,
}

static FULL_FITS: AtomicUsize = AtomicUsize::new(0);

/// Number of fits of an arm and its streams by this process.
pub fn full_fit_count() -> usize {
    FULL_FITS.load(Ordering::Relaxed)
}

/// Measures latencies and skews of an arm whose links deviate. Small ones are hidden from the selection of causes.
pub(super) fn with_timings(fitted: ArmFit, observations: &[&PoseObservations]) -> ArmFit {
    if fitted.deviations.is_none() {
        return fitted;
    }
    let state = fitted.exact_state();
    let all = fitted.candidates.all();
    let timing = |s: usize| {
        let has_skew = all.contains(&Cause::Skew(s));
        let found = || timing_beside_link_deviations(observations[s].in_state(&state, s), has_skew);
        all.contains(&Cause::Latency(s)).then(found).flatten()
    };
    let timings: Vec<Option<Timing>> = (0..state.streams.len()).map(timing).collect();
    let is_hidden = |cause: &Cause| matches!(*cause, Cause::Skew(s) if timings[s].is_some_and(|it| it.is_skewed));
    let candidates = fitted.candidates;
    let unselected =
        candidates.optional.iter().filter(|cause| !fitted.model.causes.contains(cause));
    let hidden: Vec<Cause> = unselected.copied().filter(is_hidden).collect();
    let mut model = match hidden.is_empty() {
        true => fitted.model,
        false => {
            let mut with_hidden = candidates.retaining(|cause| !hidden.contains(cause));
            with_hidden.always.extend(&hidden);
            let mut model = select_model(observations, state, &with_hidden);
            model.causes.extend(hidden);
            model.causes.sort_unstable();
            model
        }
    };
    for (s, stream) in model.state.streams.iter_mut().enumerate() {
        let Some(timing) = timings[s] else { continue };
        stream.latency_s = timing.latency_s.value;
        if let Some(skew) = timing.skew.filter(|_| model.causes.contains(&Cause::Skew(s))) {
            stream.skew = skew.value;
        }
    }
    ArmFit { model, candidates, timings, ..fitted }
}

/// `observations` are those of `decoded`.
pub(super) fn fit(
    decoded: &[&DecodedStream],
    observations: &[&PoseObservations],
    corrected: &CorrectedJoints,
) -> Option<ArmFit> {
    let largest_stream = (0..observations.len()).max_by_key(|&s| observations[s].len())?;
    let with_offsets = !corrected.is_derived;
    FULL_FITS.fetch_add(1, Ordering::Relaxed);
    let fit_with = |may_confound_frames: bool| {
        let candidates = |decoded: &[&DecodedStream]| CandidateCauses {
            may_confound_frames,
            ..candidate_causes(decoded, corrected)
        };
        let (start, model) = common_start(decoded, corrected, &candidates, largest_stream);
        let candidates = candidates(decoded);
        let model = model.unwrap_or_else(|| select_model(observations, start, &candidates));
        let model = or_without_causes(observations, model, &candidates);
        (model, candidates)
    };
    let (mut model, mut candidates) = fit_with(false);
    let follows_in_other_frames = |s: usize| {
        is_calibratable(constant_frame_residual(observations[s].in_state(&model.state, s)))
    };
    let is_open = with_offsets && !explains_all(&model);
    if is_open && (0..observations.len()).any(follows_in_other_frames) {
        // Amounts along an unobservable direction are arbitrary, so this is tried last.
        let (confounded, with_confounded) = fit_with(true);
        if explains_all(&confounded) {
            (model, candidates) = (confounded, with_confounded);
        }
    }
    let large_offsets = large_zeros(&model.state, corrected);
    let model = prefer_tool_frames(observations, model, &candidates, &large_offsets);
    let (model, candidates) = match with_offsets {
        true => prefer_zeros(observations, model, candidates, &large_offsets),
        false => (model, candidates),
    };
    let large_offsets = large_zeros(&model.state, corrected);
    let plain: Vec<StreamState> = (0..observations.len())
        .map(|s| with_significant_causes(&model, (observations[s], s), &large_offsets))
        .collect();
    let has_links = observations.iter().any(|observations| !observations.chain.is_floating());
    let is_open = with_offsets && has_links && allows_link_deviations(&model);
    let largest = observations[largest_stream].at(&plain[largest_stream], &large_offsets);
    let deviations = if is_open { estimate_link_deviations(largest) } else { None };
    let with_zeros = deviations.as_ref().map(|it| it.with_zeros(&large_offsets));
    let offsets = with_zeros.unwrap_or(large_offsets);
    let is_retained = |cause: &Cause| match *cause {
        Cause::Zero(joint) => offsets[joint] != 0.0,
        Cause::RadialScale(s) => plain[s].radial_scale != 0.0,
        Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => true,
        Cause::Reference(s) => plain[s].reference != Pose::identity(),
        Cause::Tool(s) => plain[s].tool != Pose::identity(),
    };
    let mut dropped = model.causes.clone();
    dropped.retain(|cause| !is_retained(cause));
    let dropped = parameter_count(&dropped, &model.state);
    let is_of_calibrated = |s: usize| {
        let selected = observations[s].in_state(&model.state, s);
        is_nominal(observations[s].at(&plain[s], &offsets), selected, dropped)
    };
    if !is_open || !(0..observations.len()).any(is_of_calibrated) {
        let fitted = ArmFit { model, candidates, deviations: None, timings: Vec::new() };
        return Some(match with_offsets && has_links {
            true => drop_imitated_causes(fitted, observations, largest_stream),
            false => fitted,
        });
    }
    let is_named = |cause: &Cause| match *cause {
        Cause::Zero(joint) => deviations.as_ref().is_some_and(|it| it.confounders(joint).is_some()),
        _ => false,
    };
    let (named, optional): (Vec<Cause>, Vec<Cause>) =
        candidates.optional.into_iter().filter(is_retained).partition(is_named);
    let always = [candidates.always, named].concat();
    let candidates = CandidateCauses { always, optional, ..candidates };
    let start = State { offsets, streams: plain };
    let model = select_model(observations, start, &candidates);
    Some(ArmFit { model, candidates, deviations, timings: Vec::new() })
}

/// Replaces frames by joint zeros that are likelier together with link deviations.
fn prefer_zeros(
    observations: &[&PoseObservations],
    model: SelectedModel,
    candidates: CandidateCauses,
    large_offsets: &[f64],
) -> (SelectedModel, CandidateCauses) {
    /// In m and rad. Larger frames have nonlinear effects above link deviations; not calibrated.
    const MAX_FRAME: (f64, f64) = (0.05, 0.1);
    let is_small = |frame: &Pose, round: Option<Pose>| {
        round.is_none()
            && frame.translation.vector.norm() < MAX_FRAME.0
            && frame.rotation.angle() < MAX_FRAME.1
    };
    let streams = &model.state.streams;
    let is_replaceable = |cause: &&Cause| match **cause {
        Cause::Reference(s) => is_small(&streams[s].reference, streams[s].round_reference),
        Cause::Tool(s) => is_small(&streams[s].tool, streams[s].round_tool),
        _ => false,
    };
    let frames: Vec<Cause> = model.causes.iter().filter(is_replaceable).copied().collect();
    for frame in frames {
        let others: Vec<Cause> =
            model.causes.iter().copied().filter(|cause| *cause != frame).collect();
        let mut without = model.exact_state(&candidates).without(&[frame]);
        without.offsets = large_offsets.to_vec();
        without.streams.iter_mut().for_each(|stream| stream.radial_scale = 0.0);
        let zeros = candidates.optional.iter().copied().filter(|cause| {
            matches!(cause, Cause::Zero(joint) if large_offsets[*joint] == 0.0)
                && !others.contains(cause)
        });
        if let Some(zero) = zero_instead_of_frame(observations, &without, frame, &others, zeros) {
            let start = model.state.clone().without(&[frame]);
            let is_retained = |cause: &Cause| {
                others.contains(cause) || *cause == zero || matches!(cause, Cause::Skew(_))
            };
            let candidates = candidates.retaining(is_retained);
            let with_zero = select_model(observations, start, &candidates);
            if is_within_calibration(&with_zero) {
                return prefer_zeros(observations, with_zero, candidates, large_offsets);
            }
        }
    }
    (model, candidates)
}

impl ArmFit {
    pub fn exact_state(&self) -> State {
        self.model.exact_state(&self.candidates)
    }

    /// Whether the cause is selected or always free.
    pub fn is_free(&self, cause: Cause) -> bool {
        self.model.causes.contains(&cause) || self.candidates.always.contains(&cause)
    }
}

/// Drops causes that usual link deviations imitate in stream `s`, if a nominal model explains the residual.
fn drop_imitated_causes(fitted: ArmFit, observations: &[&PoseObservations], s: usize) -> ArmFit {
    let ArmFit { model, candidates, .. } = &fitted;
    let imitable = small_causes(model, s);
    if imitable.is_empty() {
        return fitted;
    }
    let without = fitted.exact_state().without(&imitable);
    let significant =
        causes_beyond_link_deviations(observations[s].in_state(&without, s), s, &imitable);
    let (_, imitated): (Vec<Cause>, Vec<Cause>) =
        imitable.into_iter().partition(|cause| significant.contains(cause));
    if imitated.is_empty() {
        return fitted;
    }
    let is_retained = |cause: &Cause| {
        matches!(cause, Cause::Latency(_) | Cause::Skew(_) | Cause::JointScale(_))
            || (model.causes.contains(cause) && !imitated.contains(cause))
    };
    let candidates = candidates.retaining(is_retained);
    let start = fitted.exact_state().without(&imitated);
    let nominal = estimate_link_deviations(observations[s].in_state(&start, s));
    let model = select_model(observations, start, &candidates);
    match is_within_calibration(&model) {
        true => ArmFit { model, candidates, deviations: nominal, timings: Vec::new() },
        false => fitted,
    }
}

/// Whether link deviations may explain every stream's residual.
fn is_within_calibration(model: &SelectedModel) -> bool {
    residuals(model).all(is_calibratable)
}

/// Whether every stream's residual counts as explained.
fn explains_all(model: &SelectedModel) -> bool {
    residuals(model).all(|[m, rad]| m < MAX_EXPLAINED_M && rad < MAX_EXPLAINED_RAD)
}

/// Residual of every stream, rms m and rad.
fn residuals(model: &SelectedModel) -> impl Iterator<Item = [f64; 2]> {
    model.linear.streams().map(|stream| rms_of_kinds(&stream.residual))
}

/// Causes of stream `s` that link deviations can imitate: zeros below [`ZERO_PRIOR`], small frames, and
/// radial scale. Smaller causes count as explained.
fn small_causes(model: &SelectedModel, s: usize) -> Vec<Cause> {
    let stream = &model.state.streams[s];
    let is_small_frame = |frame: &Pose| {
        let (m, rad) = (frame.translation.vector.norm(), frame.rotation.angle());
        (m > MAX_EXPLAINED_M || rad > MAX_EXPLAINED_RAD) && is_calibratable([m, rad])
    };
    let is_small = |cause: &&Cause| match **cause {
        Cause::Zero(joint) => {
            (MAX_EXPLAINED_RAD..ZERO_PRIOR).contains(&model.state.offsets[joint].abs())
        }
        Cause::Reference(own) => own == s && is_small_frame(&stream.reference),
        Cause::Tool(own) => own == s && is_small_frame(&stream.tool),
        Cause::RadialScale(own) => own == s && stream.radial_scale.abs() > MAX_EXPLAINED_M,
        Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => false,
    };
    model.causes.iter().filter(is_small).copied().collect()
}

/// Requires several causes, or one with a remaining residual.
fn allows_link_deviations(model: &SelectedModel) -> bool {
    let can_be_imitated = |cause: &&Cause| !matches!(cause, Cause::Skew(_) | Cause::JointScale(_));
    model.causes.iter().filter(can_be_imitated).count() > 1
        || model.noise().iter().any(|noise| noise.inflation() > MAX_NOISE_INFLATION)
}

/// Offsets too large for link deviations, and all scales.
fn large_zeros(state: &State, corrected: &CorrectedJoints) -> Vec<f64> {
    /// Calibrations do not change a zero by more, rad or m.
    const MAX_CALIBRATED_ZERO: f64 = 0.1;
    let retained = |(index, value): (usize, &f64)| {
        if index >= corrected.track.dof || value.abs() > MAX_CALIBRATED_ZERO { *value } else { 0.0 }
    };
    state.offsets.iter().enumerate().map(retained).collect()
}

/// Keeps frames that are unknown, round, or too large for a calibration.
pub(super) fn without_small_causes(state: &StreamState) -> StreamState {
    let unless_small =
        |frame: &Pose| if is_calibratable_frame(frame) { Pose::identity() } else { *frame };
    StreamState {
        radial_scale: 0.0,
        reference: unless_small(&state.reference),
        tool: unless_small(&state.tool),
        ..state.clone()
    }
}

/// Keeps also the small frames and the radial scale if they exceed the effect of link deviations.
fn with_significant_causes(
    model: &SelectedModel,
    (observations, s): (&PoseObservations, usize),
    offsets: &[f64],
) -> StreamState {
    let mut plain = without_small_causes(&model.state.streams[s]);
    let causes = small_causes(model, s);
    let is_zero = |cause: &Cause| matches!(cause, Cause::Zero(_));
    if causes.iter().all(is_zero) || observations.chain.is_floating() {
        return plain;
    }
    // Without the zeros that were found, links would have to explain these, too.
    let found = model.state.offsets.iter().zip(offsets);
    let offsets: Vec<f64> = found
        .map(|(found, large)| if found.abs() < ZERO_PRIOR { *large } else { *found })
        .collect();
    for cause in causes_beyond_link_deviations(observations.at(&plain, &offsets), s, &causes) {
        let state = &model.state.streams[s];
        match cause {
            Cause::Reference(_) => plain.reference = state.reference,
            Cause::RadialScale(_) => plain.radial_scale = state.radial_scale,
            Cause::Tool(_) => plain.tool = state.tool,
            _ => {}
        }
    }
    plain
}

fn candidate_causes(decoded: &[&DecodedStream], corrected: &CorrectedJoints) -> CandidateCauses {
    let with_offsets = !corrected.is_derived;
    let (mut always, mut optional) = (Vec::new(), Vec::new());
    if with_offsets {
        let dof = corrected.track.dof;
        let is_in_a_stream = |joint: &usize| {
            decoded.iter().map(|decoded| &decoded.observations).any(|observations| {
                !observations.chain.is_floating() && observations.columns.contains(joint)
            }) && !decoded.iter().any(|decoded| {
                decoded.last_turn == LastTurn::OfTool
                    && decoded.observations.columns.last() == Some(joint)
            })
        };
        let (encoded, others): (Vec<usize>, Vec<usize>) =
            (0..dof).filter(is_in_a_stream).partition(|&joint| corrected.has_encoded_zero(joint));
        optional.extend(others.into_iter().map(Cause::Zero));
        always.extend(encoded.into_iter().map(Cause::Zero));
        always.extend((dof..dof + corrected.gains.len()).map(Cause::JointScale));
    }
    for (s, decoded) in decoded.iter().enumerate() {
        if decoded.moves {
            always.push(Cause::Latency(s));
            optional.extend((!decoded.shares_clock).then_some(Cause::Skew(s)));
        }
        if !decoded.observations.reference_known {
            always.push(Cause::Reference(s));
        } else if with_offsets {
            optional.push(Cause::Reference(s));
        }
        // A stream derived from the joint states must agree with them: no frame or scale causes.
        if with_offsets {
            optional.extend((decoded.last_turn != LastTurn::OfJoint).then_some(Cause::Tool(s)));
            optional.push(Cause::RadialScale(s));
        }
    }
    CandidateCauses { always, optional, may_confound_frames: false }
}

/// Best start of all streams, and the converged model of a single one.
fn common_start(
    decoded: &[&DecodedStream],
    corrected: &CorrectedJoints,
    candidates: &dyn Fn(&[&DecodedStream]) -> CandidateCauses,
    largest_stream: usize,
) -> (State, Option<SelectedModel>) {
    let start = |stream: &DecodedStream| best_start(stream, corrected, &candidates(&[stream]));
    if let [only] = decoded {
        return start(only);
    }
    let single_stream: Vec<State> = decoded.iter().map(|stream| start(stream).0).collect();
    // The streams share the joints: start from the stream with most samples.
    let offsets = single_stream[largest_stream].offsets.clone();
    let streams = single_stream.into_iter().flat_map(|state| state.streams).collect();
    (State { offsets, streams }, None)
}

/// Best start of a single stream, and its model if that converged on all samples.
fn best_start(
    decoded: &DecodedStream,
    corrected: &CorrectedJoints,
    candidates: &CandidateCauses,
) -> (State, Option<SelectedModel>) {
    /// Smaller lags lead to the same model as none.
    const MIN_LAG_PERIODS: f64 = 0.1;
    let best_lag = decoded.peaks.first().map_or(0.0, |peak| peak.correlation);
    let min_lag_s = MIN_LAG_PERIODS * median_period_s(&decoded.observations.t_s);
    let is_strong = |peak: &&LagPeak| decoded.moves && peak.correlation > best_lag - 0.1;
    let strong = decoded.peaks.iter().filter(is_strong).take(3).map(|peak| peak.lag_s);
    // Streams that copy the joints' stamps have zero latency, a narrow minimum.
    let lags: Vec<f64> = strong.filter(|lag_s| lag_s.abs() > min_lag_s).chain([0.0]).collect();
    let start = |offsets: &[f64], stream: StreamState| State {
        offsets: offsets.to_vec(),
        streams: vec![stream],
    };
    let mut starts: Vec<State> = Vec::new();
    for &lag_s in &lags {
        if corrected.is_derived {
            starts.push(start(&corrected.offsets, StreamState::at_latency(lag_s)));
            continue;
        }
        let frames = starting_states(&decoded.observations, lag_s, &corrected.offsets);
        let is_far = frames.len() > 1;
        starts.extend(frames.into_iter().map(|stream| start(&corrected.offsets, stream)));
        let has_zeros = !decoded.observations.chain.is_floating();
        if is_far && has_zeros && decoded.observations.reference_known {
            for (joint, zero) in single_zeros(&decoded.observations, lag_s, &corrected.offsets) {
                let mut offsets = corrected.offsets.clone();
                offsets[joint] = zero;
                starts.push(start(&offsets, StreamState::at_latency(lag_s)));
            }
        }
    }
    let best = select_from_starts(&decoded.observations, starts, candidates);
    let Some(best) = best else {
        return (start(&corrected.offsets, StreamState::default()), None);
    };
    if let Some(turned) = with_base_turned(&best.state, &decoded.observations) {
        return (turned, None);
    }
    let is_final = best.is_converged && decoded.observations.len() <= MAX_SEARCH_SAMPLES;
    (best.state.clone(), is_final.then_some(best))
}

/// Quarter turns of the first joint's zero are equivalent to a base rotation, which differs between makers. `None` without
/// such a zero.
fn with_base_turned(state: &State, observations: &PoseObservations) -> Option<State> {
    let &first = observations.columns.first()?;
    let is_turning = observations.chain.joint_kinds().first() != Some(&JointKind::Prismatic);
    let angle = (state.offsets[first] / FRAC_PI_2).round() * FRAC_PI_2;
    if !is_turning || angle == 0.0 || !is_quarter_turn(state.offsets[first]) {
        return None;
    }
    let mut state = state.clone();
    let mut positions = vec![0.0; observations.columns.len()];
    let at_zero = observations.chain.forward(&positions);
    positions[0] = angle;
    let rotation = observations.chain.forward(&positions) * at_zero.inverse();
    state.offsets[first] -= angle;
    for stream in &mut state.streams {
        stream.reference *= rotation;
        let round = stream.round_reference.unwrap_or_default() * rotation;
        stream.round_reference = observations.reference_known.then_some(round);
    }
    Some(state)
}

#[cfg(test)]
mod tests {
    use super::{Cause, fit, with_timings};
    use crate::arm::encoded_run::EncodedRun;
    use crate::arm_run::ArmRun;
    use crate::encodings::decoded_stream::decode_stream;
    use crate::test_motion::{arm, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use crate::{ArmDiagnosis, JointEncoding, Measured, diagnose_arm};
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};

    #[test]
    fn a_hidden_skew_is_free_once() {
        const SKEW: f64 = 1e-4;
        let (joints, chain) = arm();
        let deviating = deviating_chain(4e-4);
        let base = pose([0.01, -0.02, 0.005], Rotation::identity());
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| {
            let pose = base * deviating.forward(q);
            (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
        });
        let stamps: Vec<f64> = joints.t_s.iter().map(|t_s| t_s * (1.0 + SKEW)).collect();
        let track = pose_track(&stamps, poses);
        let streams = [tip_stream(&track, &chain)];
        let (joints, streams) = (&joints, &streams);
        let run = ArmRun { joints, streams, is_prismatic: &[false; 6], max_lag_s: 1.0 };
        let run = EncodedRun::new(run, JointEncoding::default(), false);
        let EncodedRun { corrected, position_encodings, .. } = &run;
        let decoded =
            decode_stream(corrected, &streams[0], &position_encodings[0]).expect("a stream");
        let observations = [&decoded.observations];
        let mut fitted = fit(&[&decoded], &observations, corrected).expect("a fit");
        // As if the selection had missed it.
        fitted.model.causes.retain(|cause| *cause != Cause::Skew(0));
        let fitted = with_timings(fitted, &observations);
        let free = fitted.candidates.free(&fitted.model.causes);
        assert_eq!(free.iter().filter(|cause| **cause == Cause::Skew(0)).count(), 1);
    }

    /// Diagnosis of a deviating arm that moves by a few degrees, with an elbow zero and a tool.
    fn diagnosed(link_m: f64, zero_rad: f64, tool: &Pose) -> ArmDiagnosis {
        let (mut joints, chain) = arm();
        for values in [&mut joints.q, &mut joints.qd] {
            values.iter_mut().for_each(|value| *value *= 0.05);
        }
        for q in joints.q.chunks_mut(6) {
            let middle = [0.3, -1.2, 1.5, -1.9, -1.6, 0.2];
            q.iter_mut().zip(middle).for_each(|(q, middle)| *q += middle);
        }
        let deviating = deviating_chain(link_m);
        let mut random = Lcg::new();
        let poses = joints.q.chunks(6).map(|q| {
            let mut q = q.to_vec();
            q[2] += zero_rad;
            let pose = deviating.forward(&q) * tool;
            (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
        });
        let track = pose_track(&joints.t_s, poses);
        diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0)
    }

    #[test]
    fn in_a_small_motion_a_zero_is_likelier_than_the_tool_that_it_equals() {
        let tool = pose([0.004, 0.012, 0.009], rotation_from_rotvec(Vec3::new(0.02, -0.01, 0.02)));
        // Rules do not report smaller zeros.
        let zeros = |found: &ArmDiagnosis| -> Vec<(usize, Measured)> {
            let zeros = found.joints.offsets.iter().enumerate();
            let chosen = zeros.filter(|(_, zero)| zero.is_chosen);
            let chosen = chosen.map(|(joint, zero)| (joint, zero.offset.clone().expect("a zero")));
            chosen.filter(|(_, zero)| zero.value.abs() > 1e-3).collect()
        };
        for link_m in [1e-4, 2e-4] {
            for zero_rad in [-0.035, 0.02] {
                let found = zeros(&diagnosed(link_m, zero_rad, &Pose::identity()));
                let [(2, zero)] = found.as_slice() else {
                    panic!("{link_m} {zero_rad}: {found:?}")
                };
                assert!((zero.value - zero_rad).abs() < zero.half_width(0.99), "{zero:?}");
            }
            let found = diagnosed(link_m, 0.0, &tool);
            assert!(found.streams[0].tool.as_ref().is_ok_and(|it| it.is_chosen), "{link_m}");
            assert!(zeros(&found).is_empty(), "{link_m}: {:?}", zeros(&found));
        }
    }

    /// A motion of one joint shows little more than a constant offset, which several zeros explain as well as small link
    /// deviations do.
    #[test]
    fn zeros_do_not_replace_small_link_deviations_while_one_joint_moves() {
        let (mut joints, chain) = arm();
        let pose = [0.3, -1.2, 1.5, -1.9, -1.6, 0.2];
        for (row, (q, qd)) in joints.q.chunks_mut(6).zip(joints.qd.chunks_mut(6)).enumerate() {
            let angle = 0.5 * (joints.t_s[row]).sin();
            q.copy_from_slice(&pose);
            q[5] += angle;
            qd.fill(0.0);
            qd[5] = 0.5 * (joints.t_s[row]).cos();
        }
        for (link_m, zero_rad) in [(3e-5, 1e-3), (5e-5, 2e-3), (1e-4, 1e-3)] {
            let deviating = deviating_chain(link_m);
            let mut random = Lcg::new();
            let poses = joints.q.chunks(6).map(|q| {
                let mut q = q.to_vec();
                q[0] += zero_rad;
                let pose = deviating.forward(&q);
                let noise = rotation_from_rotvec(random.triple(2e-3).into());
                (pose.translation.vector + Vec3::from(random.triple(1e-3)), noise * pose.rotation)
            });
            let track = pose_track(&joints.t_s, poses);
            let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
            for zero in found.joints.offsets.iter().filter(|zero| zero.is_chosen) {
                let value = zero.offset.as_ref().expect("a zero").value;
                assert!(value.abs() < 5e-3, "{link_m}: {:?}", found.joints.offsets);
            }
        }
    }

    /// Larger links than usual could explain both.
    #[test]
    fn a_radial_scale_is_found_beside_a_zero_of_the_wrist() {
        const SCALE: f64 = 8e-3;
        let (joints, chain) = arm();
        for (link_m, zero_rad) in [(3e-5, 0.0175), (1e-4, 0.05)] {
            let deviating = deviating_chain(link_m);
            let mut random = Lcg::new();
            let poses = joints.q.chunks(6).map(|q| {
                let mut q = q.to_vec();
                q[3] += zero_rad;
                let pose = deviating.forward(&q);
                let xyz = pose.translation.vector * (1.0 + SCALE);
                (xyz + Vec3::from(random.triple(2e-5)), pose.rotation)
            });
            let track = pose_track(&joints.t_s, poses);
            let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
            let [stream] = found.streams.as_slice() else { panic!("{:?}", found.streams.len()) };
            let scale = stream.radial_scale.as_ref().expect("a scale").value;
            assert!(stream.is_radial_scale_chosen && (scale - SCALE).abs() < 5e-4, "{scale}");
            let zero = &found.joints.offsets[3];
            let value = zero.offset.as_ref().expect("a zero").value;
            assert!(zero.is_chosen && (value - zero_rad).abs() < 1e-3, "{link_m}: {value}");
        }
    }
}
