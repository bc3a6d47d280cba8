//! The arm and its pose streams: everything that is estimated from joint states and poses together.

use super::course::latency_course;
use super::explain::{Approach, Cause, ENTANGLED, Explanation, Menu, best, explain};
use super::frames::{frame_estimate, starts};
use super::harmless::tools_first;
use super::joints::{
    Left, Read, corrected, half_turns, lies_on_arm, likely_readings, lone_zeros, other_reading,
    read_joints,
};
use super::latency::{ArmSpeeds, Peak, median_period_s};
use super::model::{Blind, State, StreamState, Sweep, ToolPart, Witness};
use super::nominal::{MOST_M, MOST_RAD, is_nominal};
use super::observability::Observability;
use super::placing::spread;
use super::prepare::{
    Placement, Prepared, as_rotations, metres_by_reach, prepare, stream_lag_s, stream_peaks,
};
use super::residual::residual;
use super::{
    Aligned, ArmDiagnosis, AxesSlip, ConstantPart, JointOffset, JointReading, JointScale,
    LengthSlip, Measured, PoseDiagnosis, PoseStream, Residual, Seen, Twin, UnitSlip, Unseen,
};
use crate::geometry::{LengthScale, Pose, Vec3, pose};
use crate::robot::JointKind;
use crate::stream::{JointTrack, Orientations};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Samples a stream in the search for the explanation, and in the final fit.
pub(super) const SEARCH_SAMPLES: usize = 500;
const FIT_SAMPLES: usize = 4000;
/// Speeds correlate less than this where a stream does not follow the arm.
pub(super) const FOLLOWS: f64 = 0.3;
/// Residuals below this cannot tell two latencies apart, rms rad and m at an arm's length of 1 m.
const ALIAS_FLOOR: f64 = 2e-5;

/// Diagnoses the joint states and all pose streams that are witnesses to them.
///
/// `most_lag_s` bounds the latency that is sought, s.
pub fn diagnose_arm(joints: &JointTrack, streams: &[PoseStream], most_lag_s: f64) -> ArmDiagnosis {
    let slides = prismatic(joints.dof, streams);
    let placed = |joints: &JointTrack| -> Vec<Placement> {
        streams.iter().map(|stream| Placement::of(joints, stream, most_lag_s)).collect()
    };
    let placements = placed(joints);
    let by = |reading: &JointReading| {
        let read = Read::by(joints, reading, &slides);
        let anew = (*reading != JointReading::default()).then(|| placed(read.near()));
        diagnose(joints, &read, streams, anew.as_ref().unwrap_or(&placements), true)
    };
    let as_logged = JointReading::default();
    let mut metres: Vec<f64> = placements.iter().map(Placement::metres).collect();
    let is_confirmed = |read: &Read| {
        let mut both = streams.iter().zip(&placements);
        both.any(|(stream, placement)| {
            placement.explains()
                && prepare(read, stream, placement).is_ok_and(|it| it.is_confirmed())
        })
    };
    let mut reading = match is_confirmed(&Read::by(joints, &as_logged, &slides)) {
        // What positions lie on as they are written needs no other joint states.
        true => Ok(JointReading::default()),
        false => read_joints(joints, streams, &metres, most_lag_s),
    };
    if reading.is_err() {
        // Joints that are read wrongly may feign another unit of the poses.
        let others = [vec![1.0; streams.len()], streams.iter().map(metres_by_reach).collect()];
        for other in others.into_iter().filter(|other| *other != metres) {
            let by_other = read_joints(joints, streams, &other, most_lag_s);
            if by_other.as_ref().is_ok_and(|reading| !reading.is_as_logged()) {
                (reading, metres) = (by_other, other);
                break;
            }
        }
    }
    let mut found = by(reading.as_ref().unwrap_or(&as_logged));
    if reading.as_ref().is_ok_and(|reading| *reading != as_logged) && !found.holds() {
        // A reading that leaves much is none.
        (reading, found) = (Err(Unseen::NotExcited), by(&as_logged));
    }
    let astray = |found: &Found| {
        !found.streams.is_empty() && found.streams.iter().all(PoseDiagnosis::strays)
    };
    if reading.is_err() || astray(&found) {
        // What is wrong beside them may hide names and units.
        for likely in likely_readings(joints, streams, &metres, most_lag_s) {
            let by_it = by(&likely.reading);
            let is_part = likely.by_range && by_it.left() * PARTLY_BETTER < found.left();
            if is_part || (by_it.holds() && by_it.left() * FAR_BETTER < found.left()) {
                (reading, found) = (Ok(likely.reading), by_it);
                break;
            }
        }
    }
    if let (Ok(_), Some((stream, left))) = (&reading, found.unexplained()) {
        let own = &streams[stream];
        let lag_s = found.streams[stream]
            .latency_s
            .as_ref()
            .map_or_else(|_| stream_lag_s(joints, own, most_lag_s), |latency| latency.value);
        let other = other_reading(joints, own, metres[stream], lag_s, left);
        if let Some(other) = other {
            let by_other = by(&other);
            if by_other.holds() && by_other.left() * FAR_BETTER < found.left() {
                (reading, found) = (Ok(other), by_other);
            }
        }
    }
    // Names and units that leave every stream astray are not read rightly, however near some of the
    // positions are.
    if astray(&found) && reading.as_ref().is_ok_and(JointReading::is_as_logged) {
        reading = Err(Unseen::NotExcited);
    }
    if let Ok(reading) = &mut reading {
        for slip in &mut reading.slips {
            let own = found.scales.iter().find(|scale| scale.column == slip.column);
            slip.factor = own.map_or(slip.factor, |scale| scale.factor.value);
        }
    }
    let Found { offsets, scales, streams } = found;
    ArmDiagnosis { joints: reading, offsets, scales, streams }
}

/// Another reading of the joints must leave so many times less than the one as logged.
const FAR_BETTER: f64 = 5.0;
/// Degrees that the joints' ranges speak for must leave so many times less.
const PARTLY_BETTER: f64 = 3.0;
/// What is left counts as explained below this, rms m and rad beyond the noise: MDL001's figures.
const EXPLAINED_M: f64 = 1e-3;
const EXPLAINED_RAD: f64 = 1.75e-3;
/// A reading of the joints may leave this share of the motion's extent, or so much, m.
const NEAR: f64 = 0.02;
const NEAR_M: f64 = 5e-3;

/// What was found by one reading of the joints.
struct Found {
    offsets: Vec<JointOffset>,
    scales: Vec<JointScale>,
    streams: Vec<PoseDiagnosis>,
}

impl Found {
    /// Whether some stream is near the arm.
    fn is_near(&self) -> bool {
        let near = |found: &PoseDiagnosis| {
            let most_m = (NEAR * extent_m(found)).max(NEAR_M);
            found.residual.as_ref().is_ok_and(|residual| residual.excess_m.value < most_m)
        };
        self.streams.iter().any(near)
    }

    /// Whether the reading may be believed: some stream is near the arm, and no joint needs a scale of
    /// its own that is no gear's unless that explains all.
    fn holds(&self) -> bool {
        let is_odd = self.scales.iter().any(|scale| !scale.is_coded() && !scale.is_round());
        self.is_near() && (!is_odd || self.unexplained().is_none())
    }

    /// All that is left, an angle counting at an arm's length of 0.3 m, m.
    fn left(&self) -> f64 {
        self.streams.iter().map(|found| together(&left(found))).sum()
    }

    /// The stream of which most is left, and that, if it is not explained.
    fn unexplained(&self) -> Option<(usize, Left)> {
        let lefts = self.streams.iter().map(left).enumerate();
        let worst = lefts.max_by(|a, b| together(&a.1).total_cmp(&together(&b.1)))?;
        let Left { m, rad } = worst.1;
        let is_open = m > EXPLAINED_M || rad.is_some_and(|rad| rad > EXPLAINED_RAD);
        (is_open && !self.streams[worst.0].nominal).then_some(worst)
    }
}

/// What is left of a stream beyond its noise; a metre and a radian where it could not be read.
fn left(found: &PoseDiagnosis) -> Left {
    match (&found.residual, &found.reading) {
        (Ok(residual), Ok(_)) => {
            Left { m: residual.excess_m.value, rad: Some(residual.excess_rad.value) }
        }
        // Its positions are read all the same; the last joint may turn the other way.
        (Ok(residual), Err(Unseen::DoesNotFollow(_))) => {
            Left { m: residual.excess_m.value, rad: Some(1.0) }
        }
        (Ok(residual), Err(_)) => Left { m: residual.excess_m.value, rad: None },
        (Err(_), Err(Unseen::DoesNotFollow(_))) => Left { m: 1.0, rad: Some(1.0) },
        (Err(_), _) => Left { m: 0.0, rad: None },
    }
}

fn together(left: &Left) -> f64 {
    left.together(0.3)
}

/// Extent of the tip's motion by FK, m.
fn extent_m(found: &PoseDiagnosis) -> f64 {
    let fk: Vec<Vec3> =
        found.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).collect();
    spread(&fk)
}

/// Diagnoses a stream that is computed from the joint states, such as /tf: it can be late or
/// wrongly assembled, but it is no witness to the joints' zeros.
///
/// It is held against the joint states as recorded, or as `reading` corrects them, whichever it
/// follows.
pub fn diagnose_derived(
    joints: &JointTrack,
    reading: Option<&JointReading>,
    stream: &PoseStream,
    most_lag_s: f64,
) -> PoseDiagnosis {
    let streams = std::slice::from_ref(stream);
    let slides = prismatic(joints.dof, streams);
    let by = |reading: &JointReading| {
        let read = Read::by(joints, reading, &slides).for_derived();
        let placements = [Placement::of(&read.track, stream, most_lag_s)];
        diagnose(joints, &read, streams, &placements, false).streams.remove(0)
    };
    let left = |diagnosis: &PoseDiagnosis| {
        diagnosis.residual.as_ref().map_or(f64::INFINITY, Residual::together_m)
    };
    let as_recorded = by(&JointReading::default());
    match reading {
        Some(reading) if !reading.is_as_logged() => {
            let mended = by(reading);
            if left(&mended) < left(&as_recorded) { mended } else { as_recorded }
        }
        _ => as_recorded,
    }
}

impl ArmDiagnosis {
    /// The joint states as they should have been recorded: names and units as found, and the joint
    /// offsets of the smallest explanation added.
    ///
    /// `prismatic` says for each column of `joints` whether that joint slides.
    pub fn corrected_joints(&self, joints: &JointTrack, prismatic: &[bool]) -> JointTrack {
        let mut track = match &self.joints {
            Ok(reading) => corrected(joints, reading, prismatic),
            Err(_) => joints.clone(),
        };
        let offset = |offset: &JointOffset| match &offset.offset {
            Ok(measured) if offset.chosen => measured.value,
            _ => 0.0,
        };
        let mut offsets: Vec<f64> = self.offsets.iter().map(offset).collect();
        for scale in self.scales.iter().filter(|scale| scale.is_coded()) {
            offsets[scale.column] = scale.offset;
        }
        for row in track.q.chunks_exact_mut(offsets.len().max(1)) {
            for (q, offset) in row.iter_mut().zip(&offsets) {
                *q += offset;
            }
        }
        track
    }
}

/// How well a pose stream follows the arm: the best correlation of its speeds with FK's.
///
/// Bare numbers must also lie where the arm is: joint angles in an array move when the arm moves.
pub fn follows(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Option<Peak> {
    let peak = likely_lags(joints, stream, most_lag_s).first().copied()?;
    let placed = as_rotations(&stream.track.orientation).is_some() || {
        let placement = Placement::of(joints, stream, most_lag_s);
        placement.explains() || lies_on_arm(joints, stream, placement.metres(), peak.lag_s)
    };
    Some(if placed { peak } else { Peak { correlation: 0.0, ..peak } })
}

/// The lags at which a pose stream may follow the arm, by its speeds: the likeliest first.
pub fn likely_lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<Peak> {
    stream_peaks(&ArmSpeeds::of(joints, stream.chain, stream.columns), stream, most_lag_s)
}

fn prismatic(dof: usize, streams: &[PoseStream]) -> Vec<bool> {
    let mut prismatic = vec![false; dof];
    for stream in streams {
        for (kind, &column) in stream.chain.joint_kinds().iter().zip(stream.columns) {
            prismatic[column] = *kind == JointKind::Prismatic;
        }
    }
    prismatic
}

/// Fits all streams together and writes each one's diagnosis.
fn diagnose(
    recorded: &JointTrack,
    read: &Read,
    streams: &[PoseStream],
    placements: &[Placement],
    with_offsets: bool,
) -> Found {
    let joints = &read.track;
    let prepared: Vec<Seen<Prepared>> = streams
        .iter()
        .zip(placements)
        .map(|(stream, placement)| prepare(read, stream, placement))
        .collect();
    let usable: Vec<&Prepared> = prepared.iter().flatten().collect();
    let fitted = fit(&usable, read, with_offsets);
    let (offsets, scales) = match &fitted {
        Some(_) if !with_offsets => (Vec::new(), Vec::new()),
        Some(fitted) => (joint_offsets(fitted, &usable, joints), joint_scales(fitted, read)),
        None => {
            let why = prepared.iter().find_map(|prepared| prepared.as_ref().err());
            (unseen_offsets(joints.dof, why.unwrap_or(&Unseen::NoOverlap)), Vec::new())
        }
    };
    let mut used = 0;
    let diagnoses = streams
        .iter()
        .zip(prepared.iter().zip(placements))
        .map(|(stream, (prepared, placement))| match (prepared, &fitted) {
            (Ok(prepared), Some(fitted)) => {
                used += 1;
                stream_diagnosis(recorded, stream, placement, prepared, fitted, used - 1)
            }
            (Ok(_), None) => no_diagnosis(Unseen::NoOverlap),
            (Err(why), _) => no_diagnosis(why.clone()),
        })
        .collect();
    Found { offsets, scales, streams: diagnoses }
}

/// The fit of all streams together.
struct Fitted {
    explanation: Explanation,
    menu: Menu,
    /// Whether the model is a drawing held against a calibrated arm, so that no single cause of
    /// that size is named.
    nominal: bool,
}

fn fit(prepared: &[&Prepared], read: &Read, with_offsets: bool) -> Option<Fitted> {
    if prepared.is_empty() {
        return None;
    }
    let alone: Vec<State> =
        prepared.iter().map(|prepared| best_start(prepared, read, with_offsets)).collect();
    let witnesses: Vec<&Witness> = prepared.iter().map(|prepared| &prepared.witness).collect();
    let menu = menu(prepared, read, with_offsets);
    // Streams share the joints: the offsets of the stream with most samples start all.
    let most = (0..prepared.len()).max_by_key(|&s| prepared[s].witness.len()).unwrap_or(0);
    let start = State {
        offsets: alone[most].offsets.clone(),
        streams: alone.into_iter().flat_map(|state| state.streams).collect(),
    };
    let explanation = explain(&witnesses, start, &menu, Approach::Careful, FIT_SAMPLES);
    let explanation = tools_first(&witnesses, explanation, &menu, FIT_SAMPLES);
    let plain: Vec<StreamState> =
        (0..witnesses.len()).map(|s| without_small_causes(&explanation, s)).collect();
    let nominal = with_offsets
        && (0..witnesses.len()).any(|s| is_nominal(witnesses[s], s, &explanation.state, &plain[s]));
    if !nominal {
        return Some(Fitted { explanation, menu, nominal });
    }
    let large = large_zeros(&explanation.state, read);
    let kept = |cause: &Cause| match *cause {
        Cause::Zero(joint) => large[joint] != 0.0,
        Cause::Growth(_) => false,
        Cause::Gain(_) => true,
        Cause::Latency(_) | Cause::Skew(_) => true,
        Cause::Reference(s) => plain[s].reference != Pose::identity(),
        Cause::Tool(s) => plain[s].tool != Pose::identity(),
    };
    let menu = Menu { optional: menu.optional.into_iter().filter(kept).collect(), ..menu };
    let start = State { offsets: large, streams: plain };
    let explanation = explain(&witnesses, start, &menu, Approach::Careful, FIT_SAMPLES);
    Some(Fitted { explanation, menu, nominal })
}

/// The joint offsets that no calibration feigns, and what scales are found.
fn large_zeros(state: &State, read: &Read) -> Vec<f64> {
    /// Calibrations change no zero by more, rad or m.
    const MOST: f64 = 0.1;
    let kept = |(index, value): (usize, &f64)| {
        if index >= read.track.dof || value.abs() > MOST { *value } else { 0.0 }
    };
    state.offsets.iter().enumerate().map(kept).collect()
}

/// A stream's state without the causes that a calibration may feign: frames stay where they are
/// unknown, round, or larger than calibrations are.
fn without_small_causes(explanation: &Explanation, stream: usize) -> StreamState {
    let found = &explanation.state.streams[stream];
    let is_large = |frame: &Pose| {
        frame.translation.vector.norm() > MOST_M || frame.rotation.angle() > MOST_RAD
    };
    let kept = |frame: &Pose| if is_large(frame) { *frame } else { Pose::identity() };
    StreamState {
        growth: 0.0,
        reference: kept(&found.reference),
        tool: kept(&found.tool),
        ..found.clone()
    }
}

fn menu(prepared: &[&Prepared], read: &Read, with_offsets: bool) -> Menu {
    let (mut always, mut optional) = (Vec::new(), Vec::new());
    if with_offsets {
        let dof = read.track.dof;
        let seen = |joint: &usize| prepared.iter().any(|p| p.witness.columns.contains(joint));
        let (of_code, own): (Vec<usize>, Vec<usize>) =
            (0..dof).filter(seen).partition(|&joint| read.has_zero_of_code(joint));
        optional.extend(own.into_iter().map(Cause::Zero));
        always.extend(of_code.into_iter().map(Cause::Zero));
        always.extend((dof..dof + read.gained.len()).map(Cause::Gain));
    }
    for (s, prepared) in prepared.iter().enumerate() {
        if prepared.moves {
            always.push(Cause::Latency(s));
            optional.push(Cause::Skew(s));
        }
        if !prepared.witness.reference_known {
            always.push(Cause::Reference(s));
        } else if with_offsets {
            optional.push(Cause::Reference(s));
        }
        // A stream that is derived from the joint states agrees with them or does not: nothing is
        // to be explained away.
        if with_offsets {
            // In a world that is anywhere, and with a tool that never turns, its own turn is no cause.
            match prepared.witness.tool_part {
                ToolPart::Turn => always.push(Cause::Tool(s)),
                ToolPart::Whole | ToolPart::Point => optional.push(Cause::Tool(s)),
            }
            optional.push(Cause::Growth(s));
        }
    }
    Menu { always, optional }
}

/// The start from which a stream alone is explained best.
fn best_start(prepared: &Prepared, read: &Read, with_offsets: bool) -> State {
    let menu = menu(&[prepared], read, with_offsets);
    let best_lag = prepared.peaks.first().map_or(0.0, |peak| peak.correlation);
    let lags: Vec<f64> = if prepared.moves {
        let near = |peak: &&Peak| peak.correlation > best_lag - 0.1;
        // Streams that copy the joints' stamps lie exactly at none, in a hole of their own noise.
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
        let frames = starts(&prepared.witness, lag_s, &read.offsets);
        let is_far = frames.len() > 1;
        begun.extend(frames.into_iter().map(|stream| start(&read.offsets, stream)));
        if is_far && prepared.witness.reference_known {
            for (joint, zero) in lone_zeros(&prepared.witness, lag_s, &read.offsets) {
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
            explain(&[&prepared.witness], state, &menu, approach, SEARCH_SAMPLES)
        })
        .collect();
    best(explanations)
        .map_or_else(|| start(&read.offsets, StreamState::at_latency(0.0)), |best| best.state)
}

fn unseen_offsets(dof: usize, why: &Unseen) -> Vec<JointOffset> {
    let offset = || JointOffset {
        offset: Err(why.clone()),
        chosen: false,
        effect_m: 0.0,
        twins: Vec::new(),
    };
    (0..dof).map(|_| offset()).collect()
}

/// The offset of every joint: those chosen with the chosen causes alone, the others with all
/// joints free.
fn joint_offsets(fitted: &Fitted, prepared: &[&Prepared], joints: &JointTrack) -> Vec<JointOffset> {
    let Fitted { explanation, menu, .. } = fitted;
    let moved = moved_joints(joints);
    let zeros: Vec<Cause> =
        menu.optional.iter().copied().filter(|cause| matches!(cause, Cause::Zero(_))).collect();
    let everyone: Vec<Cause> =
        explanation.causes.iter().copied().chain(zeros.iter().copied()).collect();
    (0..joints.dof)
        .map(|joint| {
            let cause = Cause::Zero(joint);
            let chosen = explanation.causes.contains(&cause);
            let offset = if fitted.nominal {
                Err(Unseen::NominalKinematics)
            } else if !zeros.contains(&cause) {
                Err(Unseen::NotExcited)
            } else if chosen {
                measured(fitted, &explanation.causes, cause, 0)
            } else if !moved[joint] || moved.iter().filter(|m| **m).count() < 2 {
                Err(Unseen::NotExcited)
            } else {
                measured(fitted, &everyone, cause, 0)
            };
            let twins = if chosen { twins(fitted, cause) } else { frame_twins(fitted, cause) };
            let slides = slides(prepared, joint);
            let within_a_turn = |offset: Measured| match slides {
                true => offset,
                false => {
                    Measured { value: offset.value - TAU * half_turns(offset.value), ..offset }
                }
            };
            let offset = offset.map(within_a_turn);
            let amount = offset.as_ref().map_or(0.0, |offset| offset.value.abs());
            let chord = if slides { amount } else { 2.0 * (0.5 * amount).sin() };
            JointOffset { offset, chosen, effect_m: chord * lever_m(prepared, joint), twins }
        })
        .collect()
}

/// Whether a joint of the track slides.
fn slides(prepared: &[&Prepared], joint: usize) -> bool {
    prepared.iter().any(|Prepared { witness, .. }| {
        let own = witness.columns.iter().position(|&column| column == joint);
        own.is_some_and(|own| witness.chain.joint_kinds()[own] == JointKind::Prismatic)
    })
}

/// The scales of the joints that have one of their own.
fn joint_scales(fitted: &Fitted, read: &Read) -> Vec<JointScale> {
    let explanation = &fitted.explanation;
    let scale = |(at, &column): (usize, &usize)| {
        let gain = Cause::Gain(read.track.dof + at);
        let about = read.factors[column];
        let gain = measured(fitted, &explanation.causes, gain, 0).ok()?;
        let factor = Measured {
            value: about * (1.0 + gain.value),
            std_error: about.abs() * gain.std_error,
            ..gain
        };
        let zero = Cause::Zero(column);
        let is_off = explanation.causes.contains(&zero) || fitted.menu.always.contains(&zero);
        let offset = if is_off { explanation.state.offsets[column] } else { 0.0 };
        Some(JointScale { column, factor, offset })
    };
    read.gained.iter().enumerate().filter_map(scale).collect()
}

/// Joints that move by more than 3° (or 5 mm) over the run.
fn moved_joints(joints: &JointTrack) -> Vec<bool> {
    (0..joints.dof)
        .map(|j| {
            let column = || joints.q.iter().skip(j).step_by(joints.dof);
            let low = column().copied().fold(f64::INFINITY, f64::min);
            let high = column().copied().fold(f64::NEG_INFINITY, f64::max);
            high - low > 0.05
        })
        .collect()
}

/// Distance from a joint's axis to the tip at full stretch, m a rad (1 for a sliding joint): the
/// largest over joint positions spread evenly over a turn each (Halton 1960).
fn lever_m(prepared: &[&Prepared], joint: usize) -> f64 {
    const TRIED: u32 = 500;
    const BASES: [u32; 10] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29];
    let lever = |prepared: &&Prepared| {
        let own = prepared.witness.columns.iter().position(|&column| column == joint)?;
        let chain = prepared.witness.chain;
        let kinds = chain.joint_kinds();
        if kinds[own] == JointKind::Prismatic {
            return Some(1.0);
        }
        let mut jacobian = vec![[0.0; 6]; chain.dof()];
        let levers = (1..=TRIED).map(|index| {
            let at = |(j, kind): (usize, &JointKind)| match kind {
                JointKind::Prismatic => 0.0,
                _ => TAU * (radical_inverse(index, BASES[j % BASES.len()]) - 0.5),
            };
            let q: Vec<f64> = kinds.iter().enumerate().map(at).collect();
            chain.forward_with_jacobian(&q, &mut jacobian);
            let [x, y, z, ..] = jacobian[own];
            Vec3::new(x, y, z).norm()
        });
        Some(levers.fold(0.0, f64::max))
    };
    prepared.iter().filter_map(lever).fold(0.0, f64::max)
}

/// The digits of `index` in `base` mirrored at the point, in [0, 1).
fn radical_inverse(mut index: u32, base: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while index > 0 {
        value += f64::from(index % base) * digit;
        index /= base;
        digit /= f64::from(base);
    }
    value
}

/// The estimate of one parameter of `cause` when `causes` and what is always free are free.
fn measured(fitted: &Fitted, causes: &[Cause], cause: Cause, which: usize) -> Seen<Measured> {
    let Fitted { explanation, menu, .. } = fitted;
    let state = &explanation.state;
    let mut parameters: Vec<usize> =
        menu.always.iter().chain(causes).flat_map(|cause| cause.parameters(state)).collect();
    parameters.sort_unstable();
    parameters.dedup();
    let wanted = cause.parameters(state).start + which;
    let at = parameters.binary_search(&wanted).map_err(|_| Unseen::NotExcited)?;
    explanation.linear.measured(&parameters, at, state).ok_or(Unseen::NotExcited)
}

/// Causes that explain the log as well in the place of `cause`.
fn twins(fitted: &Fitted, cause: Cause) -> Vec<Twin> {
    let Fitted { explanation, menu, .. } = fitted;
    let (state, linear) = (&explanation.state, &explanation.linear);
    let parameters = |causes: &[Cause]| -> Vec<usize> {
        let mut list: Vec<usize> =
            menu.always.iter().chain(causes).flat_map(|c| c.parameters(state)).collect();
        list.sort_unstable();
        list
    };
    let cost = linear.cost(&parameters(&explanation.causes));
    let rest: Vec<Cause> = explanation.causes.iter().copied().filter(|c| *c != cause).collect();
    menu.optional
        .iter()
        .filter(|other| !explanation.causes.contains(other))
        .filter_map(|&other| {
            let swapped: Vec<Cause> = rest.iter().copied().chain([other]).collect();
            let parameters = parameters(&swapped);
            if linear.cost(&parameters) > cost + 12.0 {
                return None;
            }
            let values = state.values() + linear.step(&parameters);
            let own: Vec<f64> = other.parameters(state).map(|p| values[p]).collect();
            match other {
                Cause::Zero(joint) => Some(Twin::JointZero(joint, own[0])),
                Cause::Reference(s) => Some(Twin::Reference(s, frame_amount(&own))),
                Cause::Tool(s) => Some(Twin::Tool(s, frame_amount(&own))),
                Cause::Gain(_) | Cause::Latency(_) | Cause::Skew(_) | Cause::Growth(_) => None,
            }
        })
        .collect()
}

/// Frames of the explanation that do to this log what the joint offset `cause` does.
fn frame_twins(fitted: &Fitted, cause: Cause) -> Vec<Twin> {
    let Fitted { explanation, menu, .. } = fitted;
    let (state, linear) = (&explanation.state, &explanation.linear);
    let values = state.values();
    let frames = menu.always.iter().chain(&explanation.causes);
    let round = (0..state.streams.len()).flat_map(|s| {
        let stream = &state.streams[s];
        let reference = stream.round_reference.map(|_| Cause::Reference(s));
        reference.into_iter().chain(stream.round_tool.map(|_| Cause::Tool(s)))
    });
    let round: Vec<Cause> = round.collect();
    frames
        .chain(&round)
        .filter_map(|&frame| {
            let mut parameters: Vec<usize> = frame.parameters(state).collect();
            let own: Vec<f64> = parameters.iter().map(|&p| values[p]).collect();
            parameters.extend(cause.parameters(state));
            parameters.sort_unstable();
            let same = linear.normal.separation(&parameters) < ENTANGLED;
            match frame {
                Cause::Reference(s) if same => Some(Twin::Reference(s, frame_amount(&own))),
                Cause::Tool(s) if same => Some(Twin::Tool(s, frame_amount(&own))),
                _ => None,
            }
        })
        .collect()
}

/// The size of a frame change: its angle in rad, or where it does not turn its length in m.
fn frame_amount(twist: &[f64]) -> f64 {
    let norm = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (length, angle) = (norm(&twist[..3]), norm(&twist[3..]));
    if angle > 1e-5 { angle } else { length }
}

fn no_diagnosis(why: Unseen) -> PoseDiagnosis {
    let rests = || Unseen::RestsOn("the reading of the rotations");
    PoseDiagnosis {
        length: Err(why.clone()),
        axes: Err(why.clone()),
        reading: Err(why),
        inverted: false,
        constant: Vec::new(),
        degrees: None,
        latency_s: Err(rests()),
        skew: Err(rests()),
        skew_chosen: false,
        course: Err(rests()),
        growth: Err(rests()),
        growth_chosen: false,
        reference: Err(rests()),
        tool: Err(rests()),
        residual: Err(rests()),
        nominal: false,
        observability: None,
        top_speed_m_s: 0.0,
        aligned: Aligned::default(),
    }
}

/// The unit that positions turned out to be in, where it is another one than they were read as.
fn length_slip(
    stream: &PoseStream,
    placement: &Placement,
    prepared: &Prepared,
    residual: &Seen<Residual>,
) -> Seen<Option<LengthSlip>> {
    placement.metres.as_ref().map_err(Unseen::clone)?;
    if prepared.metres == 1.0 {
        return Ok(None);
    }
    let declared = stream.track.declared.as_ref();
    let read_as = match declared.is_some_and(|declared| declared.millimetres) {
        true => LengthScale::MILLIMETRE,
        false => LengthScale::METRE,
    };
    let is = LengthScale::of(prepared.metres * read_as.in_m());
    let residual = residual.as_ref().ok();
    let corrected = residual.map_or(0.0, |residual| residual.rms_m);
    let as_logged = residual.map_or(0.0, |residual| residual.before_m);
    Ok(Some(LengthSlip { is, read_as, residual: UnitSlip { as_logged, corrected } }))
}

/// The coordinates that never change, with what FK does to them.
fn constant_parts(
    stream: &PoseStream,
    prepared: &Prepared,
    aligned: &Aligned,
) -> Vec<ConstantPart> {
    let axes = prepared.axes.unwrap_or(AxesSlip::NONE).positions;
    let coordinates = ['x', 'y', 'z'].into_iter().enumerate();
    let constant = coordinates.filter(|&(axis, _)| prepared.constant[axis]);
    let part = |(axis, coordinate): (usize, char)| {
        let along = aligned.fk.iter().map(|fk| axes.of(fk.translation.vector)[axis]);
        let (low, high) = along
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high): (f64, f64), value| {
                (value.min(low), value.max(high))
            });
        let all = stream.track.xyz.iter().map(|xyz| xyz[axis]);
        let value = all.sum::<f64>() / stream.track.xyz.len().max(1) as f64;
        ConstantPart { coordinate, value, moved_m: (high - low).max(0.0) }
    };
    constant.map(part).collect()
}

fn stream_diagnosis(
    recorded: &JointTrack,
    stream: &PoseStream,
    placement: &Placement,
    prepared: &Prepared,
    fitted: &Fitted,
    index: usize,
) -> PoseDiagnosis {
    let Fitted { explanation, menu, .. } = fitted;
    let causes = &explanation.causes;
    let with = |cause: Cause| -> Vec<Cause> {
        let mut with = causes.clone();
        if !with.contains(&cause) && !menu.always.contains(&cause) {
            with.push(cause);
        }
        with
    };
    let one = |cause: Cause| {
        if fitted.nominal && matches!(cause, Cause::Growth(_)) {
            Err(Unseen::NominalKinematics)
        } else if is_hidden(fitted, cause, index) {
            Err(Unseen::NotExcited)
        } else if menu.all().contains(&cause) {
            measured(fitted, &with(cause), cause, 0)
        } else {
            Err(Unseen::AtRest)
        }
    };
    let latency_s = one(Cause::Latency(index)).map(|latency| Measured {
        std_error: latency.std_error.hypot(stream.stamp_error_s),
        ..latency
    });
    let latency_s = match aliases(prepared, explanation, index) {
        Some(lags) => Err(Unseen::Periodic(lags)),
        None => latency_s,
    };
    let frame = |cause: Cause| {
        if fitted.nominal && !menu.all().contains(&cause) {
            return Err(Unseen::NominalKinematics);
        }
        if is_hidden(fitted, cause, index) {
            return Err(Unseen::NotExcited);
        }
        frame_estimate(explanation, menu, &with(cause), cause, index)
    };
    let aligned = align(recorded, stream, prepared, explanation, index);
    let (found, zeros) = (&explanation.state.streams[index], &explanation.state.offsets);
    let residual = residual(&aligned, &prepared.witness, found, zeros);
    let information = explanation.linear.information_of(index);
    let observability = Observability::of(&prepared.witness, found, zeros, &information);
    let course = match &latency_s {
        Ok(_) => latency_course(&aligned, found.skew),
        Err(why) => Err(why.clone()),
    };
    let t_s = &prepared.witness.t_s;
    let span_s = (t_s[t_s.len() - 1] - t_s[0]).max(f64::MIN_POSITIVE);
    let mut reading = prepared.reading.clone();
    if let (Ok(reading), Ok(residual)) = (&mut reading, &residual) {
        // Latency, offsets and frames have been taken off since the readings were compared.
        reading.best_rad = reading.best_rad.min(residual.rms_rad);
    }
    PoseDiagnosis {
        reading,
        length: length_slip(stream, placement, prepared, &residual),
        axes: Ok(prepared.axes),
        inverted: prepared.inverted,
        constant: constant_parts(stream, prepared, &aligned),
        degrees: prepared.degrees,
        latency_s,
        skew: one(Cause::Skew(index)).map(|skew| Measured {
            // Stamps that are off by this much at either end feign a skew.
            std_error: skew.std_error.hypot(2.0 * stream.stamp_error_s / span_s),
            ..skew
        }),
        skew_chosen: causes.contains(&Cause::Skew(index)),
        course,
        growth: one(Cause::Growth(index)),
        growth_chosen: causes.contains(&Cause::Growth(index)),
        reference: frame(Cause::Reference(index)),
        tool: frame(Cause::Tool(index)),
        residual,
        nominal: fitted.nominal,
        observability: Some(observability),
        top_speed_m_s: placement.top_speed_m_s,
        aligned,
    }
}

/// Whether a frame or the growth of stream `index`, which nothing needs, may be there all the same,
/// made up for by another of them: at rest only all of them together show.
fn is_hidden(fitted: &Fitted, cause: Cause, index: usize) -> bool {
    let Fitted { explanation, menu, .. } = fitted;
    let (state, found) = (&explanation.state, &explanation.state.streams[index]);
    let is_round = match cause {
        Cause::Reference(_) => found.round_reference.is_some(),
        Cause::Tool(_) => found.round_tool.is_some(),
        Cause::Growth(_) => false,
        Cause::Zero(_) | Cause::Gain(_) | Cause::Latency(_) | Cause::Skew(_) => return false,
    };
    if is_round || explanation.causes.contains(&cause) || !menu.optional.contains(&cause) {
        return false;
    }
    let others = [Cause::Reference(index), Cause::Tool(index), Cause::Growth(index)];
    let makes_up = |other: &Cause| {
        let mut both: Vec<usize> = cause.parameters(state).chain(other.parameters(state)).collect();
        both.sort_unstable();
        *other != cause
            && menu.optional.contains(other)
            && explanation.linear.normal.separation(&both) < ENTANGLED
    };
    others.iter().any(makes_up)
}

/// Other lags at which the stream lies as well on the arm as at the one found: repeating motion.
fn aliases(prepared: &Prepared, explanation: &Explanation, index: usize) -> Option<Vec<f64>> {
    let found = &explanation.state.streams[index];
    let witness = &prepared.witness;
    let at = |latency_s: f64| {
        let state = StreamState { latency_s, ..found.clone() };
        witness.at_latency(&state, &explanation.state.offsets, SEARCH_SAMPLES)
    };
    let (best, _) = at(found.latency_s);
    let apart = 4.0 * median_period_s(&witness.t_s).max(0.02);
    let others: Vec<f64> = prepared
        .peaks
        .iter()
        .take(6)
        .map(|peak| peak.lag_s)
        .chain([0.0])
        .filter(|lag_s| (lag_s - found.latency_s).abs() > apart)
        .filter_map(|lag_s| {
            let settled = (0..4).fold(lag_s, |lag_s, _| lag_s + at(lag_s).1);
            let same = (settled - found.latency_s).abs() < apart;
            (!same && at(settled).0 < 2.0 * best.max(ALIAS_FLOOR)).then_some(settled)
        })
        .collect();
    if others.is_empty() {
        return None;
    }
    let mut lags = vec![found.latency_s];
    lags.extend(others);
    lags.sort_by(f64::total_cmp);
    lags.dedup_by(|a, b| (*a - *b).abs() < apart);
    Some(lags)
}

/// The stream's samples beside FK, before and after the explanation.
fn align(
    recorded: &JointTrack,
    stream: &PoseStream,
    prepared: &Prepared,
    explanation: &Explanation,
    index: usize,
) -> Aligned {
    let witness = &prepared.witness;
    let found = &explanation.state.streams[index];
    let plain = StreamState::at_latency(0.0);
    let as_recorded = Witness {
        joints: recorded,
        chain: witness.chain,
        columns: witness.columns,
        gained: &[],
        reference_known: witness.reference_known,
        still: witness.still,
        t_s: witness.t_s.clone(),
        xyz: Vec::new(),
        rotation: Vec::new(),
        blind: witness.blind,
        tool_part: witness.tool_part,
        middle_s: witness.middle_s,
    };
    let zero = vec![0.0; recorded.dof];
    let (mut sweep, mut truth_sweep) = (Sweep::new(&as_recorded), Sweep::new(witness));
    let truth_state = StreamState {
        latency_s: found.latency_s,
        skew: found.skew,
        ..StreamState::at_latency(0.0)
    };
    let mut aligned = Aligned::default();
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
        if witness.blind != Blind::default() {
            let mut in_base = truth * found.tool;
            in_base.translation.vector *= 1.0 + found.growth;
            witness.blind.fill(&mut read, &(found.reference * in_base));
        }
        let mut in_base = found.reference.inverse() * read;
        in_base.translation.vector /= 1.0 + found.growth;
        aligned.t_s.push(witness.t_s[k]);
        aligned.logged.push(pose(stream.track.xyz[source].into(), rotation));
        aligned.fk.push(fk);
        aligned.corrected.push(in_base * found.tool.inverse());
        aligned.fk_at_truth.push(truth);
    }
    aligned
}
