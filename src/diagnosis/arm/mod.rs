//! Joint estimation of the arm and its pose streams.

mod align;
mod beside_links;
mod confounders;
mod fit;
mod stream;
mod zeros;

use std::cell::OnceCell;

use crate::encodings::decoded_stream::{DecodedStream, decode_stream};
use crate::encodings::orientation_samples::MAX_ENCODING_RESIDUAL_RAD;
use crate::encodings::position::{PositionEncodingEstimate, metres_by_reach, metres_by_size};
use crate::encodings::rotation::MAX_RESIDUAL_RAD as MAX_ROTATION_RESIDUAL_RAD;
use crate::joints::{CorrectedJoints, JointComparison, LikelyEncoding, ResidualSize};
use crate::latency::correlation::{ArmSpeeds, LagPeak, stream_lag_s, stream_peaks};
use crate::model::measurement::{FLOOR_M, MAX_EXPLAINED_M, MAX_EXPLAINED_RAD, PoseObservations};
use crate::priors::LEVER_M;
use crate::samples::sampling::as_rotations;
use crate::selection::evidence::log_bayes_factor;
use crate::selection::held_out::HeldOut;
pub(super) use crate::selection::model_selection::FIT_SAMPLES;
use crate::selection::nominal_model::{is_calibratable, is_calibratable_frame};
use crate::{
    ArmDiagnosis, EstimateResult, JointCoupling, JointDiagnosis, JointEncoding, JointOffset,
    JointScale, JointUnit, NotObservable, PoseDiagnosis, PoseEncoding, PoseStream, StreamResidual,
};
use beside_links::BesideLinks;
pub use fit::full_fit_count;
use fit::{fit, with_timings};
use ground::geometry::{Convention, QuaternionOrderError};
use ground::robot::JointKind;
use ground::stream::JointTrack;
use stream::{StreamFit, no_diagnosis};
use zeros::{joint_gains, joint_offsets, unobservable_offsets};

/// Whether the streams are compared with poses instead of joint states.
pub(super) fn are_floating(streams: &[PoseStream]) -> bool {
    streams.iter().any(|stream| stream.chain.is_floating())
}

/// Diagnoses joint states and independent pose streams; `max_lag_s` is the largest latency to search.
///
/// The joint encoding is the one that explains the streams. Another one than the logged replaces it if it is
/// credible and keeps streams that already agree; finally it must be the likelier one.
pub fn diagnose_arm(joints: &JointTrack, streams: &[PoseStream], max_lag_s: f64) -> ArmDiagnosis {
    if are_floating(streams) {
        return diagnose_arm_encoded(joints, streams, max_lag_s, JointEncoding::default());
    }
    let mut search = EncodingSearch::new(joints, streams, max_lag_s);
    let mut result = match search.estimate() {
        Ok(encoding) => search.diagnose_as(encoding),
        Err(why) => EncodingResult { encoding: Err(why), ..search.logged.diagnose() },
    };
    let is_default = |encoding: &JointEncoding| *encoding == JointEncoding::default();
    if !result.encoding.as_ref().map_or(true, is_default) && !result.is_credible() {
        let encoding = Err(NotObservable::NotExcited);
        result = EncodingResult { encoding, ..search.as_logged().clone() };
    }
    if !result.is_in_other_encoding() {
        result = search.logged.or_standard(result);
    } else if search.spoils_agreement(&result) {
        result = search.as_logged().clone();
    }
    let is_open = result.encoding.is_err() || result.is_far_from_fk();
    if is_open && let Some(likely) = search.likely(&result) {
        result = likely;
    }
    if result.encoding.is_ok()
        && let Some(other) = search.of_unexplained(&result)
    {
        result = other;
    }
    if result.is_in_other_encoding() {
        return search.likelier(result);
    }
    if result.encoding.is_ok() && result.is_far_from_fk() {
        // No stream follows FK.
        result.encoding = Err(NotObservable::NotExcited);
    }
    result.into_diagnosis()
}

/// Joint states in an encoding, and the encodings of the streams' positions that they show.
struct EncodedRun<'a> {
    joints: &'a JointTrack,
    encoding: JointEncoding,
    corrected: CorrectedJoints,
    streams: &'a [PoseStream<'a>],
    position_encodings: Vec<PositionEncodingEstimate>,
}

impl<'a> EncodedRun<'a> {
    /// `are_derived`: whether the streams are computed from the joint states.
    fn new(
        joints: &'a JointTrack,
        streams: &'a [PoseStream<'a>],
        max_lag_s: f64,
        encoding: JointEncoding,
        are_derived: bool,
    ) -> Self {
        let mut is_prismatic = vec![false; joints.dof];
        for stream in streams {
            for (kind, &column) in stream.chain.joint_kinds().iter().zip(stream.columns) {
                is_prismatic[column] = *kind == JointKind::Prismatic;
            }
        }
        let corrected = CorrectedJoints::new(joints, &encoding, is_prismatic);
        let corrected = if are_derived { corrected.for_derived() } else { corrected };
        let track = corrected.approximate_track();
        let estimate =
            |stream: &PoseStream| PositionEncodingEstimate::estimate(track, stream, max_lag_s);
        let position_encodings = streams.iter().map(estimate).collect();
        Self { joints, encoding, corrected, streams, position_encodings }
    }

    fn diagnose(&self) -> EncodingResult {
        self.diagnose_with(&self.position_encodings)
    }

    /// The same with other encodings of the positions.
    fn diagnose_with(&self, position_encodings: &[PositionEncodingEstimate]) -> EncodingResult {
        let Self { joints, corrected, streams, .. } = self;
        let decode = |(stream, position_encoding): (&PoseStream<'a>, _)| {
            decode_stream(corrected, stream, position_encoding)
        };
        let decoded: Vec<EstimateResult<DecodedStream>> =
            streams.iter().zip(position_encodings).map(decode).collect();
        let usable: Vec<&DecodedStream> = decoded.iter().flatten().collect();
        let observations: Vec<&PoseObservations> =
            usable.iter().map(|decoded| &decoded.observations).collect();
        let has_zeros = !corrected.is_derived && !are_floating(streams);
        let mut result = EncodingResult {
            encoding: Ok(self.encoding.clone()),
            offsets: Vec::new(),
            scales: Vec::new(),
            couplings: Vec::new(),
            streams: Vec::new(),
        };
        let Some(fitted) = fit(&usable, &observations, corrected) else {
            let why: Vec<NotObservable> = decoded.into_iter().filter_map(Result::err).collect();
            if has_zeros {
                let why = why.first().unwrap_or(&NotObservable::NoOverlap);
                result.offsets = unobservable_offsets(joints.dof, why);
            }
            result.streams = why.into_iter().map(no_diagnosis).collect();
            return result;
        };
        let fitted = &with_timings(fitted, &observations);
        let held_out = &HeldOut::new(&observations, &fitted.model, &fitted.candidates);
        let beside_links = &match corrected.is_derived {
            false => BesideLinks::new(fitted, &usable),
            true => BesideLinks::default(),
        };
        if has_zeros {
            result.offsets = joint_offsets(fitted, &usable, corrected, held_out, beside_links);
            (result.scales, result.couplings) = joint_gains(fitted, corrected);
        }
        let mut index = 0;
        for ((stream, position_encoding), decoded) in
            streams.iter().zip(position_encodings).zip(&decoded)
        {
            result.streams.push(match decoded {
                Ok(decoded) => {
                    let recorded = joints;
                    let of_stream = StreamFit {
                        recorded,
                        stream,
                        position_encoding,
                        decoded,
                        fitted,
                        held_out,
                        beside_links,
                        index,
                    };
                    index += 1;
                    of_stream.diagnose()
                }
                Err(why) => no_diagnosis(why.clone()),
            });
        }
        result
    }

    /// With weak motion, a fault can look like mirrored axes, an inverse or another rotation convention. These are
    /// rejected if as few causes explain the poses as logged. Mirrored axes and an inverse are also rejected near FK.
    fn or_standard(&self, result: EncodingResult) -> EncodingResult {
        let are_otherwise_placed = result.streams.iter().any(is_otherwise_placed);
        let is_misread_slightly =
            |stream: &PoseDiagnosis| is_misread(stream) && may_be_as_logged(stream);
        if !are_otherwise_placed && !result.streams.iter().any(is_misread_slightly) {
            return result;
        }
        let standard: Vec<PositionEncodingEstimate> =
            self.position_encodings.iter().map(PositionEncodingEstimate::standard_only).collect();
        let standard = self.diagnose_with(&standard);
        let is_explained = standard.largest_unexplained().is_none()
            || standard.total_residual_m() <= result.total_residual_m();
        let is_sufficient = is_explained
            && standard.is_close_to_fk()
            && standard.parameter_count() <= result.parameter_count();
        // A small misreading is near FK, too.
        let is_near = are_otherwise_placed && standard.streams.iter().all(is_near_as_logged);
        match is_near || is_sufficient {
            true => EncodingResult { encoding: result.encoding, ..standard },
            false => result,
        }
    }
}

/// Search for the encoding of the joint states.
struct EncodingSearch<'a> {
    logged: EncodedRun<'a>,
    max_lag_s: f64,
    /// Unit of each stream's positions, in metres.
    metres: Vec<f64>,
    as_logged: OnceCell<EncodingResult>,
    has_change: OnceCell<bool>,
}

impl<'a> EncodingSearch<'a> {
    fn new(joints: &'a JointTrack, streams: &'a [PoseStream<'a>], max_lag_s: f64) -> Self {
        let logged = EncodedRun::new(joints, streams, max_lag_s, JointEncoding::default(), false);
        let metres = logged.position_encodings.iter().map(PositionEncodingEstimate::metres);
        Self {
            metres: metres.collect(),
            logged,
            max_lag_s,
            as_logged: OnceCell::new(),
            has_change: OnceCell::new(),
        }
    }

    fn diagnose_as(&self, encoding: JointEncoding) -> EncodingResult {
        if encoding == JointEncoding::default() {
            return self.logged.diagnose();
        }
        let EncodedRun { joints, streams, .. } = self.logged;
        EncodedRun::new(joints, streams, self.max_lag_s, encoding, false).diagnose()
    }

    fn as_logged(&self) -> &EncodingResult {
        self.as_logged.get_or_init(|| self.logged.diagnose())
    }

    /// A stream that agrees with the joint states as logged must still do so.
    fn spoils_agreement(&self, result: &EncodingResult) -> bool {
        self.logged.streams.len() > 1 && !result.preserves_agreement(self.as_logged())
    }

    fn has_change(&self) -> bool {
        let by_motion = || {
            let comparison = self.most_informative(&self.metres);
            comparison.is_some_and(|comparison| comparison.has_change_within_run())
        };
        *self.has_change.get_or_init(by_motion)
    }

    /// Comparison with the stream of the most joints and samples.
    fn most_informative(&self, metres: &[f64]) -> Option<JointComparison<'a>> {
        let streams = self.logged.streams;
        let size = |&index: &usize| (streams[index].columns.len(), streams[index].track.t_s.len());
        let index = (0..streams.len()).max_by_key(size)?;
        Some(self.comparison_with(index, metres[index]))
    }

    fn comparison_with(&self, index: usize, metres: f64) -> JointComparison<'a> {
        let EncodedRun { joints, streams, .. } = self.logged;
        JointComparison { joints, stream: &streams[index], metres, max_lag_s: self.max_lag_s }
    }

    /// Encoding by the motion. Sets the unit of each stream's positions.
    fn estimate(&mut self) -> EstimateResult<JointEncoding> {
        let EncodedRun { corrected, streams, position_encodings, .. } = &self.logged;
        let is_confirmed = |(stream, encoding): (&PoseStream, &PositionEncodingEstimate)| {
            encoding.needs_correction()
                && decode_stream(corrected, stream, encoding).is_ok_and(|it| it.is_confirmed())
        };
        if streams.iter().zip(position_encodings).any(is_confirmed) {
            // The joint states need no other encoding.
            return Ok(JointEncoding::default());
        }
        let no_pose = NotObservable::RestsOn("a pose of the tool");
        let estimate =
            |metres: &[f64]| self.most_informative(metres).ok_or(no_pose.clone())?.encoding();
        let encoding = estimate(&self.metres);
        if encoding.is_ok() {
            return encoding;
        }
        // Wrong joint encodings can imitate another unit.
        for other in [vec![1.0; streams.len()], streams.iter().map(metres_by_reach).collect()] {
            if other != self.metres
                && let Ok(encoding) = estimate(&other)
                && !encoding.is_as_logged()
            {
                self.metres = other;
                return Ok(encoding);
            }
        }
        encoding
    }

    /// Likely encoding that explains far more than `result`, where other faults hid the encoding.
    fn likely(&self, result: &EncodingResult) -> Option<EncodingResult> {
        let before_m = result.total_residual_m();
        if before_m <= FLOOR_M || self.has_change() {
            return None;
        }
        let streams = self.logged.streams;
        let longest = (0..streams.len()).max_by_key(|&index| streams[index].track.t_s.len())?;
        let all = self.comparison_with(longest, self.metres[longest]).likely_encodings();
        let explains = |LikelyEncoding { encoding, by_range }: LikelyEncoding| {
            let by_likely = self.diagnose_as(encoding);
            let after_m = by_likely.total_residual_m();
            let is_better = (by_range && after_m * MIN_IMPROVEMENT_BY_RANGE < before_m)
                || (by_likely.is_credible() && after_m * MIN_IMPROVEMENT < before_m);
            (is_better && !self.spoils_agreement(&by_likely)).then_some(by_likely)
        };
        all.into_iter().find_map(explains)
    }

    /// Encoding that explains the stream with the largest residual, if it explains far more than `result`.
    fn of_unexplained(&self, result: &EncodingResult) -> Option<EncodingResult> {
        let (index, residual) = result.largest_unexplained()?;
        let joints = self.logged.joints;
        let (stream, found) = (&self.logged.streams[index], &result.streams[index]);
        let lag_s = match &found.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(joints, stream, self.max_lag_s),
        };
        // Rotations in an unknown convention show whether the last joint is reversed, positions do not.
        let is_unread = match &found.encoding {
            Ok(encoding) => {
                matches!(encoding.best, PoseEncoding::Numbers(_))
                    && encoding.best_rad > MAX_ENCODING_RESIDUAL_RAD
            }
            Err(why) => matches!(why, NotObservable::DoesNotFollow(_)),
        };
        let comparison = self.comparison_with(index, self.metres[index]);
        let by_residual = match self.has_change() {
            false => comparison.other_encoding(lag_s, residual),
            true => None,
        };
        let last = stream.columns.last().filter(|_| is_unread);
        let other =
            by_residual.or_else(|| last.map(|&last| JointEncoding::reversed(last, residual.m)))?;
        let by_other = self.diagnose_as(other);
        let is_better = by_other.is_credible()
            && by_other.total_residual_m() * MIN_IMPROVEMENT < result.total_residual_m()
            && !self.spoils_agreement(&by_other);
        is_better.then_some(by_other)
    }

    /// The likelier of `result` and the logged encoding: where joints hardly move, other encodings fit as well as
    /// calibrations.
    fn likelier(&self, result: EncodingResult) -> ArmDiagnosis {
        let is_far = result.encoding.as_ref().is_ok_and(JointEncoding::is_far_from_logged);
        let is_plausible = is_far && self.as_logged().is_plausible_for(self.logged.streams);
        let otherwise = result.into_diagnosis();
        let as_logged = self.logged.or_standard(self.as_logged().clone()).into_diagnosis();
        match !is_plausible && log_bayes_factor(&otherwise, &as_logged) > 0.0 {
            true => otherwise,
            false => as_logged,
        }
    }
}

/// Diagnoses joint states in this encoding, without looking for another. Scales and couplings are refined.
pub(super) fn diagnose_arm_encoded(
    joints: &JointTrack,
    streams: &[PoseStream],
    max_lag_s: f64,
    encoding: JointEncoding,
) -> ArmDiagnosis {
    let run = EncodedRun::new(joints, streams, max_lag_s, encoding, false);
    run.or_standard(run.diagnose()).into_diagnosis()
}

/// Counts as 1: less than 0.1° per turn.
const FACTOR_TOLERANCE: f64 = 2e-4;
/// Residual as logged over another joint encoding's.
const MIN_IMPROVEMENT: f64 = 5.0;
/// For degrees indicated by the range of values.
const MIN_IMPROVEMENT_BY_RANGE: f64 = 3.0;
/// Of scales that count as one, as for a round scale.
const MAX_SCALE_RATIO: f64 = 1.01;
/// For a valid joint encoding: of the motion's extent, or m.
const MAX_RESIDUAL_SHARE: f64 = 0.02;
const MAX_RESIDUAL_M: f64 = 5e-3;

#[derive(Clone)]
struct EncodingResult {
    /// Of the joint states, before refining its scales and couplings.
    encoding: EstimateResult<JointEncoding>,
    offsets: Vec<JointOffset>,
    scales: Vec<JointScale>,
    couplings: Vec<JointCoupling>,
    streams: Vec<PoseDiagnosis>,
}

impl EncodingResult {
    fn is_in_other_encoding(&self) -> bool {
        self.encoding.as_ref().is_ok_and(|encoding| !encoding.is_as_logged())
    }

    /// Whether each stream in a known frame is near FK as logged, and each other one is explained.
    fn is_plausible_for(&self, streams: &[PoseStream]) -> bool {
        let is_plausible = |(found, stream): (&PoseDiagnosis, &PoseStream)| {
            if stream.reference_known { is_near_as_logged(found) } else { !is_unexplained(found) }
        };
        self.streams.iter().zip(streams).all(is_plausible)
    }

    /// Of joint zeros, frame errors and rotation conventions.
    fn parameter_count(&self) -> usize {
        const FRAME: usize = 6;
        let frames = self.streams.iter().flat_map(|stream| [&stream.reference, &stream.tool]);
        let zeros = self.offsets.iter().filter(|offset| offset.is_chosen);
        zeros.count()
            + FRAME * frames.flatten().filter(|frame| frame.is_chosen).count()
            + self.streams.iter().filter(|stream| is_misread(stream)).count()
    }

    /// The diagnosis, with refined scales and couplings in the encoding. Those that are 1 and 0 are left out.
    fn into_diagnosis(self) -> ArmDiagnosis {
        let Self { mut encoding, offsets, mut scales, mut couplings, streams } = self;
        if let Ok(encoding) = &mut encoding {
            for unit_error in &mut encoding.unit_errors {
                let refined = scales.iter().find(|scale| scale.column == unit_error.column);
                unit_error.factor = refined.map_or(unit_error.factor, |scale| scale.factor.value);
            }
            let is_one = |factor: f64| (factor - 1.0).abs() < FACTOR_TOLERANCE;
            scales.retain(|scale| !is_one(scale.factor.value));
            encoding.unit_errors.retain(|unit_error| {
                unit_error.unit != JointUnit::Scaled || !is_one(unit_error.factor)
            });
            couplings.retain(|coupling| coupling.factor.value.abs() > FACTOR_TOLERANCE);
            encoding.couplings.clone_from(&couplings);
        }
        ArmDiagnosis { joints: JointDiagnosis::without_changes(encoding, offsets, scales), streams }
    }

    /// Some stream is close to FK.
    fn is_close_to_fk(&self) -> bool {
        let is_close = |stream: &PoseDiagnosis| {
            let max_m = (MAX_RESIDUAL_SHARE * stream.extent_m()).max(MAX_RESIDUAL_M);
            stream.residual.as_ref().is_ok_and(|residual| residual.excess_m.value < max_m)
        };
        self.streams.iter().any(is_close)
    }

    /// Each stream that agrees with FK in `before`, without frame errors, still does.
    fn preserves_agreement(&self, before: &EncodingResult) -> bool {
        let agrees = |stream: &PoseDiagnosis| {
            let is_explained = stream.residual.as_ref().is_ok_and(|residual| {
                residual.rms_m < MAX_EXPLAINED_M
                    && residual.rms_rad < MAX_EXPLAINED_RAD
                    && stream.encoding.is_ok()
            });
            is_explained && is_calibratable_frame(&stream.frame_correction.reference)
        };
        let pairs = self.streams.iter().zip(&before.streams);
        pairs.into_iter().all(|(after, before)| !agrees(before) || agrees(after))
    }

    /// Some stream must be close to FK. A scale that is not a plausible gear ratio must explain everything, and
    /// several such scales must be equal: scales of one joint each fit almost any short motion.
    fn is_credible(&self) -> bool {
        let implausible = || {
            let scales = self.scales.iter().filter(|scale| !scale.is_coded() && !scale.is_round());
            scales.map(|scale| scale.factor.value.abs())
        };
        let (least, most) =
            (implausible().fold(f64::INFINITY, f64::min), implausible().fold(0.0, f64::max));
        let has_implausible_scale =
            most > 0.0 || self.couplings.iter().any(|coupling| !coupling.is_round());
        self.is_close_to_fk()
            && (!has_implausible_scale || self.largest_unexplained().is_none())
            && most <= MAX_SCALE_RATIO * least
    }

    fn is_far_from_fk(&self) -> bool {
        !self.streams.is_empty() && self.streams.iter().all(PoseDiagnosis::is_far_from_fk)
    }

    /// Sum over the streams.
    fn total_residual_m(&self) -> f64 {
        self.streams.iter().map(|stream| combined_m(excess_residual(stream))).sum()
    }

    /// Stream with the largest unexplained excess residual.
    fn largest_unexplained(&self) -> Option<(usize, ResidualSize)> {
        let residuals = self.streams.iter().map(excess_residual).enumerate();
        let worst = residuals.max_by(|a, b| combined_m(a.1).total_cmp(&combined_m(b.1)))?;
        is_unexplained(&self.streams[worst.0]).then_some(worst)
    }
}

/// Whether it differs from FK by no more than a calibration does, without any correction.
fn is_near_as_logged(stream: &PoseDiagnosis) -> bool {
    let is_near =
        |residual: &StreamResidual| is_calibratable([residual.before_m, residual.before_rad]);
    stream.encoding.is_ok() && stream.residual.as_ref().is_ok_and(is_near)
}

/// Whether neither causes nor links explain its excess residual.
fn is_unexplained(stream: &PoseDiagnosis) -> bool {
    let residual = excess_residual(stream);
    // Links do not explain rotations that do not follow the arm.
    exceeds_explained(residual) && !(stream.is_nominal && residual.rad != Some(UNREAD_RAD))
}

/// Whether the causes do not explain this excess residual.
fn exceeds_explained(ResidualSize { m, rad }: ResidualSize) -> bool {
    m > MAX_EXPLAINED_M || rad.is_some_and(|rad| rad > MAX_EXPLAINED_RAD)
}

/// Whether rotations are in another encoding than the logged one.
fn is_misread(stream: &PoseDiagnosis) -> bool {
    stream.encoding.as_ref().is_ok_and(|encoding| !encoding.best.is_as_logged())
}

fn is_otherwise_placed(stream: &PoseDiagnosis) -> bool {
    stream.is_inverted || matches!(stream.axes, Ok(Some(_)))
}

/// Whether joints that are off may explain the rotations as logged.
fn may_be_as_logged(stream: &PoseDiagnosis) -> bool {
    let as_logged_rad = stream.encoding.as_ref().ok().and_then(|encoding| encoding.as_logged_rad);
    as_logged_rad.is_some_and(|rad| rad < MAX_ROTATION_RESIDUAL_RAD)
}

impl ArmDiagnosis {
    /// Whether other frames, encodings or latencies than those found might explain more.
    pub fn is_unexplained(&self) -> bool {
        self.streams.iter().any(|stream| exceeds_explained(excess_residual(stream)))
    }

    /// Whether a rotation is read in the opposite of the usual way, for example `euler:xyz` as a rotation vector, or
    /// positions are in a unit above the metre. The usual error of the reference has the same effect, for rotations
    /// if the frames are equal.
    pub fn has_unusual_misinterpretation(&self) -> bool {
        let is_large = |stream: &PoseDiagnosis| matches!(stream.length_unit, Ok(Some(error)) if error.factor() > 1.0);
        let encodings = self.streams.iter().filter_map(|stream| stream.encoding.as_ref().ok());
        self.streams.iter().any(is_large)
            || encodings.into_iter().any(|encoding| match encoding.best {
                PoseEncoding::Misinterpreted(class) => {
                    class.members.first().is_some_and(|one| one.read_as != Convention::RPY)
                }
                PoseEncoding::QuaternionOrder(error) => {
                    error == QuaternionOrderError::XyzwReadAsWxyz
                }
                _ => false,
            })
    }

    /// Number of streams that differ from the reference by more than constant frames.
    pub fn deviating_streams(&self) -> usize {
        /// Usual delays of drivers, s.
        const MAX_USUAL_LATENCY_S: f64 = 2e-3;
        let is_late = |stream: &PoseDiagnosis| {
            stream.latency_s.as_ref().is_ok_and(|latency| {
                latency.value.abs() > MAX_USUAL_LATENCY_S.max(3.0 * latency.std_error)
            })
        };
        let has_other_encoding = |stream: &PoseDiagnosis| {
            is_otherwise_placed(stream)
                || matches!(stream.length_unit, Ok(Some(_)))
                || is_misread(stream)
        };
        let is_unsteady = |stream: &PoseDiagnosis| {
            stream.latency_profile.as_ref().is_ok_and(|profile| profile.is_unsteady)
                || stream.is_skew_chosen
        };
        let deviates = |stream: &&PoseDiagnosis| {
            is_late(stream)
                || has_other_encoding(stream)
                || is_unsteady(stream)
                || stream.has_changes()
        };
        self.streams.iter().filter(deviates).count()
    }

    /// Residual relative to the motion, so it does not depend on the unit of the reference.
    fn relative_residual(&self) -> f64 {
        let of_stream = |stream: &PoseDiagnosis| {
            let Some(residual) = stream.followed_residual() else { return 1.0 };
            let length = residual.rms_m / stream.extent_m().max(f64::MIN_POSITIVE);
            length.hypot(residual.rms_rad).min(1.0)
        };
        self.streams.iter().map(of_stream).sum()
    }

    /// Whether it leaves far less unexplained than `other`, with another reference.
    pub fn is_far_better_than(&self, other: &Self) -> bool {
        self.relative_residual() * MIN_IMPROVEMENT < other.relative_residual()
    }

    /// Whether it fits about as well as `other`, with another reference.
    pub fn is_as_good_as(&self, other: &Self) -> bool {
        const TOLERANCE: f64 = 1.2;
        self.relative_residual() < TOLERANCE * other.relative_residual()
    }
}

/// Of rotations that do not follow the arm.
const UNREAD_RAD: f64 = 1.0;

/// 1 m and [`UNREAD_RAD`] if not decoded.
fn excess_residual(stream: &PoseDiagnosis) -> ResidualSize {
    let residual = stream.residual.as_ref();
    let m = residual.map(|residual| residual.excess_m.value);
    match &stream.encoding {
        Ok(_) => {
            let rad = residual.map(|residual| residual.excess_rad.value);
            ResidualSize { m: m.unwrap_or(0.0), rad: rad.ok() }
        }
        // Positions may be valid, e.g. if the last joint's sign is wrong.
        Err(NotObservable::DoesNotFollow(_)) => {
            ResidualSize { m: m.unwrap_or(1.0), rad: Some(UNREAD_RAD) }
        }
        Err(_) => ResidualSize { m: m.unwrap_or(0.0), rad: None },
    }
}

fn combined_m(residual: ResidualSize) -> f64 {
    residual.combined_m(LEVER_M)
}

/// Diagnoses a stream computed from the joint states, such as /tf, which is not an independent reference
/// for joint zeros. Compares it with the joint states as recorded and as corrected by `encoding`; the better
/// match counts.
pub fn diagnose_derived(
    joints: &JointTrack,
    encoding: Option<&JointEncoding>,
    stream: &PoseStream,
    max_lag_s: f64,
) -> PoseDiagnosis {
    let streams = std::slice::from_ref(stream);
    let diagnose_as = |encoding: &JointEncoding| {
        let run = EncodedRun::new(joints, streams, max_lag_s, encoding.clone(), true);
        run.diagnose().streams.remove(0)
    };
    let residual_m = |diagnosis: &PoseDiagnosis| {
        diagnosis.residual.as_ref().map_or(f64::INFINITY, StreamResidual::combined_m)
    };
    let as_recorded = diagnose_as(&JointEncoding::default());
    let as_corrected = encoding.filter(|encoding| !encoding.is_as_logged()).map(diagnose_as);
    let better = as_corrected.filter(|it| residual_m(it) < residual_m(&as_recorded));
    better.unwrap_or(as_recorded)
}

/// Best correlation of a pose stream's speeds with FK's. Bare numbers must also be positioned where the arm
/// is, because an array of joint angles correlates too.
pub fn best_lag_peak(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Option<LagPeak> {
    let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
    let peaks = stream_peaks(&arm, stream, max_lag_s);
    let peak = peaks.first().copied()?;
    let is_positioned = as_rotations(&stream.track.orientation).is_some() || {
        let position_encoding = PositionEncodingEstimate::from_speeds(joints, stream, &arm, peaks);
        position_encoding.needs_correction()
            || JointComparison { joints, stream, metres: position_encoding.metres(), max_lag_s }
                .follows_arm(peak.lag_s)
    };
    Some(if is_positioned { peak } else { LagPeak { correlation: 0.0, ..peak } })
}

/// Whether the stream fits the arm closely if the joint states have another sign, unit, order or zero.
pub fn follows_with_other_encoding(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
) -> bool {
    let mut metres = vec![metres_by_size(joints, stream), metres_by_reach(stream)];
    metres.dedup();
    metres.into_iter().any(|metres| {
        let comparison = JointComparison { joints, stream, metres, max_lag_s };
        comparison.encoding().is_ok_and(|encoding| !encoding.is_as_logged())
    })
}

/// Candidate lags from speeds, best first.
pub fn candidate_lags(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Vec<LagPeak> {
    stream_peaks(&ArmSpeeds::from_joints(joints, stream.chain, stream.columns), stream, max_lag_s)
}
