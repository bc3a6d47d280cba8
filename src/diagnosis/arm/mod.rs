//! Joint estimation of the arm and its pose streams.

mod align;
mod confounders;
mod fit;
mod stream;
mod zeros;

use std::borrow::Cow;
use std::cell::LazyCell;

use crate::compliance::apply_compliance;
use crate::encodings::decoded_stream::{DecodedStream, decode_stream};
use crate::encodings::position::{PositionEncodingEstimate, metres_by_reach};
use crate::frames::position_fit::spread;
use crate::joints::{
    CorrectedJoints, ResidualSize, correct_joints, estimate_joint_encoding, follows_arm,
    likely_encodings, other_encoding,
};
use crate::latency::correlation::{ArmSpeeds, LagPeak};
use crate::samples::sampling::{as_rotations, stream_lag_s, stream_peaks};
use crate::selection::nominal_model::{MAX_TIP_CHANGE_M, MAX_TIP_CHANGE_RAD};
use crate::{
    ArmDiagnosis, EstimateResult, FrameCorrection, JointChange, JointCoupling, JointDiagnosis,
    JointEncoding, JointOffset, JointScale, JointUnit, NotObservable, PoseDiagnosis, PoseStream,
    ScalarChange, StreamResidual,
};
pub(super) use fit::FIT_SAMPLES;
use fit::{LinkModel, fit};
use ground::geometry::Vec3;
use ground::robot::JointKind;
use ground::stream::JointTrack;
use stream::{no_diagnosis, stream_diagnosis};
use zeros::{joint_couplings, joint_offsets, joint_scales, unobservable_offsets};

/// Diagnoses joint states and independent pose streams; `most_lag_s` is the largest latency to search.
pub fn diagnose_arm(joints: &JointTrack, streams: &[PoseStream], most_lag_s: f64) -> ArmDiagnosis {
    diagnose_with(joints, streams, most_lag_s, LinkModel::Deviate)
}

/// Diagnoses a segment already corrected by another's result: the links are the same, so they explain no
/// residual.
pub(super) fn diagnose_other_segment(
    joints: &JointTrack,
    streams: &[PoseStream],
    most_lag_s: f64,
) -> ArmDiagnosis {
    diagnose_with(joints, streams, most_lag_s, LinkModel::AreKnown)
}

fn diagnose_with(
    joints: &JointTrack,
    streams: &[PoseStream],
    most_lag_s: f64,
    links: LinkModel,
) -> ArmDiagnosis {
    let slides = prismatic_columns(joints.dof, streams);
    let placed = |joints: &JointTrack| -> Vec<PositionEncodingEstimate> {
        streams
            .iter()
            .map(|stream| PositionEncodingEstimate::estimate(joints, stream, most_lag_s))
            .collect()
    };
    let placements = placed(joints);
    let by = |reading: &JointEncoding| {
        let read = CorrectedJoints::new(joints, reading, &slides);
        let anew = (*reading != JointEncoding::default()).then(|| placed(read.approximate_track()));
        diagnose(joints, &read, streams, anew.as_ref().unwrap_or(&placements), true, links)
    };
    let as_logged = JointEncoding::default();
    let mut metres: Vec<f64> = placements.iter().map(PositionEncodingEstimate::metres).collect();
    let is_confirmed = |read: &CorrectedJoints| {
        let mut both = streams.iter().zip(&placements);
        both.any(|(stream, placement)| {
            placement.needs_correction()
                && decode_stream(read, stream, placement).is_ok_and(|it| it.is_confirmed())
        })
    };
    let mut reading = match is_confirmed(&CorrectedJoints::new(joints, &as_logged, &slides)) {
        // The joint states need no other encoding.
        true => Ok(JointEncoding::default()),
        false => estimate_joint_encoding(joints, streams, &metres, most_lag_s),
    };
    if reading.is_err() {
        // Wrong joint encodings can imitate another unit.
        let others = [vec![1.0; streams.len()], streams.iter().map(metres_by_reach).collect()];
        for other in others.into_iter().filter(|other| *other != metres) {
            let by_other = estimate_joint_encoding(joints, streams, &other, most_lag_s);
            if by_other.as_ref().is_ok_and(|reading| !reading.is_as_logged()) {
                (reading, metres) = (by_other, other);
                break;
            }
        }
    }
    let mut found = by(reading.as_ref().unwrap_or(&as_logged));
    if reading.as_ref().is_ok_and(|reading| *reading != as_logged) && !found.is_credible() {
        (reading, found) = (Err(NotObservable::NotExcited), by(&as_logged));
    }
    // With weak motion, a fault can look like mirrored axes or an inverse. Reject these if the poses as
    // logged need no more joint zeros.
    let is_rewritten =
        found.streams.iter().any(|it| it.is_inverted || matches!(it.axes, Ok(Some(_))));
    if is_rewritten && reading.as_ref().is_ok_and(JointEncoding::is_as_logged) {
        let sound: Vec<PositionEncodingEstimate> =
            placements.iter().map(PositionEncodingEstimate::standard_only).collect();
        let read = CorrectedJoints::new(joints, &as_logged, &slides);
        let as_written = diagnose(joints, &read, streams, &sound, true, links);
        if as_written.unexplained().is_none()
            && as_written.is_near()
            && as_written.zero_count() <= found.zero_count()
        {
            found = as_written;
        }
    }
    let astray = |found: &EncodingResult| {
        !found.streams.is_empty() && found.streams.iter().all(PoseDiagnosis::is_far_from_fk)
    };
    // A stream that agrees with the joint states as logged must still do so.
    let is_alone = streams.len() < 2;
    let plain = LazyCell::new(|| by(&as_logged));
    let spoils = |found: &EncodingResult| !is_alone && !found.preserves_agreement(&plain);
    if reading.as_ref().is_ok_and(|reading| !reading.is_as_logged()) && spoils(&found) {
        (reading, found) = (Ok(JointEncoding::default()), by(&as_logged));
    }
    if reading.is_err() || astray(&found) {
        // Other faults may hide the encoding.
        for likely in likely_encodings(joints, streams, &metres, most_lag_s) {
            let by_it = by(&likely.encoding);
            if spoils(&by_it) {
                continue;
            }
            let is_part = likely.by_range
                && by_it.total_residual_m() * MIN_IMPROVEMENT_BY_RANGE < found.total_residual_m();
            if is_part
                || (by_it.is_credible()
                    && by_it.total_residual_m() * MIN_IMPROVEMENT < found.total_residual_m())
            {
                (reading, found) = (Ok(likely.encoding), by_it);
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
        let other = other_encoding(joints, own, metres[stream], lag_s, left);
        if let Some(other) = other {
            let by_other = by(&other);
            if by_other.is_credible()
                && by_other.total_residual_m() * MIN_IMPROVEMENT < found.total_residual_m()
                && !spoils(&by_other)
            {
                (reading, found) = (Ok(other), by_other);
            }
        }
    }
    // If no stream follows FK, the encoding is undetermined.
    if astray(&found) && reading.as_ref().is_ok_and(JointEncoding::is_as_logged) {
        reading = Err(NotObservable::NotExcited);
    }
    if let Ok(reading) = &mut reading {
        for slip in &mut reading.unit_errors {
            let own = found.scales.iter().find(|scale| scale.column == slip.column);
            slip.factor = own.map_or(slip.factor, |scale| scale.factor.value);
        }
    }
    let EncodingResult { offsets, mut scales, mut couplings, streams } = found;
    if let Ok(reading) = &mut reading {
        let is_one = |factor: f64| (factor - 1.0).abs() < FACTOR_TOLERANCE;
        scales.retain(|scale| !is_one(scale.factor.value));
        reading.unit_errors.retain(|slip| slip.unit != JointUnit::Scaled || !is_one(slip.factor));
        couplings.retain(|coupling| coupling.factor.value.abs() > FACTOR_TOLERANCE);
        reading.couplings.clone_from(&couplings);
    }
    let (changes, patches, bends) = (Vec::new(), Vec::new(), Vec::new());
    let joints =
        JointDiagnosis { encoding: reading, offsets, scales, changes, patches, compliance: bends };
    ArmDiagnosis { joints, streams }
}

/// Counts as 1: less than 0.1° per turn.
const FACTOR_TOLERANCE: f64 = 2e-4;
/// Residual as logged over another joint encoding's.
const MIN_IMPROVEMENT: f64 = 5.0;
/// For degrees indicated by the range of values.
const MIN_IMPROVEMENT_BY_RANGE: f64 = 3.0;
/// Excess residual that counts as explained, rms (MDL001's thresholds).
const MAX_EXPLAINED_M: f64 = 1e-3;
pub(super) const MAX_EXPLAINED_RAD: f64 = 1.75e-3;
/// For a valid joint encoding: of the motion's extent, or m.
const MAX_RESIDUAL_SHARE: f64 = 0.02;
const MAX_RESIDUAL_M: f64 = 5e-3;

struct EncodingResult {
    offsets: Vec<JointOffset>,
    scales: Vec<JointScale>,
    couplings: Vec<JointCoupling>,
    streams: Vec<PoseDiagnosis>,
}

impl EncodingResult {
    fn zero_count(&self) -> usize {
        self.offsets.iter().filter(|offset| offset.is_chosen).count()
    }

    /// Some stream is close to FK.
    fn is_near(&self) -> bool {
        let near = |found: &PoseDiagnosis| {
            let most_m = (MAX_RESIDUAL_SHARE * extent_m(found)).max(MAX_RESIDUAL_M);
            found.residual.as_ref().is_ok_and(|residual| residual.excess_m.value < most_m)
        };
        self.streams.iter().any(near)
    }

    /// Each stream that agrees with FK in `other`, without frame errors, still does.
    fn preserves_agreement(&self, other: &EncodingResult) -> bool {
        let agrees = |found: &PoseDiagnosis| {
            let is_explained = found.residual.as_ref().is_ok_and(|left| {
                left.rms_m < MAX_EXPLAINED_M
                    && left.rms_rad < MAX_EXPLAINED_RAD
                    && found.encoding.is_ok()
            });
            let FrameCorrection { reference, .. } = &found.frame_correction;
            is_explained
                && reference.translation.vector.norm() < MAX_TIP_CHANGE_M
                && reference.rotation.angle() < MAX_TIP_CHANGE_RAD
        };
        let pairs = self.streams.iter().zip(&other.streams);
        pairs.into_iter().all(|(own, other)| !agrees(other) || agrees(own))
    }

    /// Some stream must be close to FK. A scale that is not a plausible gear ratio must explain everything.
    fn is_credible(&self) -> bool {
        let is_odd = self.scales.iter().any(|scale| !scale.is_coded() && !scale.is_round())
            || self.couplings.iter().any(|coupling| !coupling.is_round());
        self.is_near() && (!is_odd || self.unexplained().is_none())
    }

    /// Sum over the streams. Angles are weighted by 0.3 m.
    fn total_residual_m(&self) -> f64 {
        self.streams.iter().map(|found| combined_m(&excess_residual(found))).sum()
    }

    /// Stream with the largest unexplained excess residual.
    fn unexplained(&self) -> Option<(usize, ResidualSize)> {
        let lefts = self.streams.iter().map(excess_residual).enumerate();
        let worst = lefts.max_by(|a, b| combined_m(&a.1).total_cmp(&combined_m(&b.1)))?;
        let ResidualSize { m, rad } = worst.1;
        let is_open = m > MAX_EXPLAINED_M || rad.is_some_and(|rad| rad > MAX_EXPLAINED_RAD);
        (is_open && !self.streams[worst.0].is_nominal).then_some(worst)
    }
}

/// 1 m and 1 rad if not decoded.
fn excess_residual(found: &PoseDiagnosis) -> ResidualSize {
    match (&found.residual, &found.encoding) {
        (Ok(residual), Ok(_)) => {
            ResidualSize { m: residual.excess_m.value, rad: Some(residual.excess_rad.value) }
        }
        // Positions are valid, e.g. if the last joint's sign is wrong.
        (Ok(residual), Err(NotObservable::DoesNotFollow(_))) => {
            ResidualSize { m: residual.excess_m.value, rad: Some(1.0) }
        }
        (Ok(residual), Err(_)) => ResidualSize { m: residual.excess_m.value, rad: None },
        (Err(_), Err(NotObservable::DoesNotFollow(_))) => ResidualSize { m: 1.0, rad: Some(1.0) },
        (Err(_), _) => ResidualSize { m: 0.0, rad: None },
    }
}

fn combined_m(left: &ResidualSize) -> f64 {
    left.combined_m(0.3)
}

/// Extent of FK's positions.
fn extent_m(found: &PoseDiagnosis) -> f64 {
    let fk: Vec<Vec3> =
        found.aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).collect();
    spread(&fk)
}

/// Diagnoses a stream computed from the joint states, such as /tf, which is not an independent reference
/// for joint zeros. Compares it with the joint states as recorded and as corrected by `reading`; the better
/// match counts.
pub fn diagnose_derived(
    joints: &JointTrack,
    reading: Option<&JointEncoding>,
    stream: &PoseStream,
    most_lag_s: f64,
) -> PoseDiagnosis {
    let streams = std::slice::from_ref(stream);
    let slides = prismatic_columns(joints.dof, streams);
    let by = |reading: &JointEncoding| {
        let read = CorrectedJoints::new(joints, reading, &slides).for_derived();
        let placements = [PositionEncodingEstimate::estimate(&read.track, stream, most_lag_s)];
        diagnose(joints, &read, streams, &placements, false, LinkModel::AreKnown).streams.remove(0)
    };
    let left = |diagnosis: &PoseDiagnosis| {
        diagnosis.residual.as_ref().map_or(f64::INFINITY, StreamResidual::combined_m)
    };
    let as_recorded = by(&JointEncoding::default());
    match reading {
        Some(reading) if !reading.is_as_logged() => {
            let mended = by(reading);
            if left(&mended) < left(&as_recorded) { mended } else { as_recorded }
        }
        _ => as_recorded,
    }
}

impl JointDiagnosis {
    /// Largest change of a joint's zero, if any.
    pub fn zero_change(&self, column: usize) -> Option<&ScalarChange> {
        self.largest_change(column, |change| change.zero.as_ref())
    }

    /// Largest change of a joint's scale, if any.
    pub fn factor_change(&self, column: usize) -> Option<&ScalarChange> {
        self.largest_change(column, |change| change.factor.as_ref())
    }

    fn largest_change(
        &self,
        column: usize,
        of: impl Fn(&JointChange) -> Option<&ScalarChange>,
    ) -> Option<&ScalarChange> {
        let own = self.changes.iter().filter(|change| change.column == column);
        ScalarChange::largest(own.filter_map(of))
    }

    /// Removes eccentricity above the usual level, which no rule reports.
    pub fn without_eccentricity(&self) -> Self {
        let mut named = self.clone();
        named.compliance.retain(|bend| !bend.is_eccentric());
        named
    }

    /// Corrects change points, names and units, compliance, and the selected model's joint offsets.
    /// `prismatic` flags columns of `joints`.
    pub fn corrected_joints(&self, joints: &JointTrack, prismatic: &[bool]) -> JointTrack {
        let mut unchanged = Cow::Borrowed(joints);
        for patch in &self.patches {
            patch.apply(unchanged.to_mut());
        }
        let mut track = match &self.encoding {
            Ok(reading) => correct_joints(&unchanged, reading, prismatic),
            Err(_) => unchanged.into_owned(),
        };
        if !self.compliance.is_empty() {
            apply_compliance(&mut track, &self.compliance);
        }
        let offset = |offset: &JointOffset| match &offset.offset {
            Ok(measured) if offset.is_chosen => measured.value,
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

/// Best correlation of a pose stream's speeds with FK's. Bare numbers must also be positioned where the arm
/// is, because an array of joint angles correlates too.
pub fn best_lag_peak(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Option<LagPeak> {
    let peak = candidate_lags(joints, stream, most_lag_s).first().copied()?;
    let placed = as_rotations(&stream.track.orientation).is_some() || {
        let placement = PositionEncodingEstimate::estimate(joints, stream, most_lag_s);
        placement.needs_correction() || follows_arm(joints, stream, placement.metres(), peak.lag_s)
    };
    Some(if placed { peak } else { LagPeak { correlation: 0.0, ..peak } })
}

/// Candidate lags from speeds, best first.
pub fn candidate_lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<LagPeak> {
    stream_peaks(&ArmSpeeds::from_joints(joints, stream.chain, stream.columns), stream, most_lag_s)
}

fn prismatic_columns(dof: usize, streams: &[PoseStream]) -> Vec<bool> {
    let mut prismatic = vec![false; dof];
    for stream in streams {
        for (kind, &column) in stream.chain.joint_kinds().iter().zip(stream.columns) {
            prismatic[column] = *kind == JointKind::Prismatic;
        }
    }
    prismatic
}

/// Fits all streams together.
fn diagnose(
    recorded: &JointTrack,
    read: &CorrectedJoints,
    streams: &[PoseStream],
    placements: &[PositionEncodingEstimate],
    with_offsets: bool,
    links: LinkModel,
) -> EncodingResult {
    let joints = &read.track;
    let prepared: Vec<EstimateResult<DecodedStream>> = streams
        .iter()
        .zip(placements)
        .map(|(stream, placement)| decode_stream(read, stream, placement))
        .collect();
    let usable: Vec<&DecodedStream> = prepared.iter().flatten().collect();
    let fitted = fit(&usable, read, with_offsets, links);
    let (offsets, scales, couplings) = match &fitted {
        Some(_) if !with_offsets => (Vec::new(), Vec::new(), Vec::new()),
        Some(fitted) => (
            joint_offsets(fitted, &usable, joints),
            joint_scales(fitted, read),
            joint_couplings(fitted, read),
        ),
        None => {
            let why = prepared.iter().find_map(|prepared| prepared.as_ref().err());
            (
                unobservable_offsets(joints.dof, why.unwrap_or(&NotObservable::NoOverlap)),
                Vec::new(),
                Vec::new(),
            )
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
            (Ok(_), None) => no_diagnosis(NotObservable::NoOverlap),
            (Err(why), _) => no_diagnosis(why.clone()),
        })
        .collect();
    EncodingResult { offsets, scales, couplings, streams: diagnoses }
}
