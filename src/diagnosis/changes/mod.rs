//! Changes within a run: a tool slips, the base is moved, a joint loses its zero, or an encoding changes.
//!
//! Steps and drifts of frames, joint zeros and radial scales are columns of the residual ([`cause_changes`]). For other
//! changes, the run is split where a stream jumps relative to the arm, a joint jumps, or data are missing ([`jumps`]).
//! The longest segment, the baseline, is diagnosed alone. The others are corrected by its result and
//! diagnosed again, so their models contain only the differences (after Chow 1960). Correcting these
//! differences gives a run in which the baseline's errors persist from start to end; it is diagnosed as a
//! whole. Change points are reported only if that is likelier ([`crate::selection::evidence`]).

mod cause_changes;
mod change_points;
mod constant_frames;
mod encoding_changes;
mod jumps;
mod report;
mod split_run;
mod step_test;

use crate::arm::diagnose_other_segment;
use crate::arm_run::ArmRun;
use crate::compliance::diagnose_with_compliance;
use crate::joints::follows_as_logged;
use crate::latency::correlation::stream_lag_s;
use crate::residuals::cause_columns::CauseColumns;
use crate::residuals::comparison::{
    MIN_SEGMENT_SAMPLES, has_latency_steps, has_slow_residual, residual_m, restore_recorded,
};
use crate::selection::evidence::{likeliest, log_bayes_factor};
use crate::{
    ArmDiagnosis, EstimateResult, FrameCorrection, FrameEstimate, JointDiagnosis, NotObservable,
    PoseDiagnosis, PoseStream,
};
use ground::geometry::Pose;
use ground::stats::Measured;
use ground::stream::{JointTrack, Orientations, PoseTrack};
use std::cell::LazyCell;
use std::ops::Range;

pub(super) use cause_changes::diagnose_with_cause_changes;
pub use change_points::{
    ChangePoint, EncodingSpans, FrameChange, JointChange, JointPatch, ScalarChange,
};
pub(super) use constant_frames::constant_frames_suffice;
use encoding_changes::is_same_encoding;
use jumps::{Jump, gaps, jumps_in_joints, jumps_in_logged_path, strongest};
use split_run::{Span, SplitRun, set_velocity};
use step_test::has_unusual_zero;

/// Whether usual link deviations and constant frames explain the residual of a stream.
pub(super) fn is_explained_by_links(diagnosis: &PoseDiagnosis, stream: &PoseStream) -> bool {
    let columns = CauseColumns::new(diagnosis, stream.chain);
    let is_far = diagnosis.residual.is_err() || diagnosis.is_far_from_fk();
    !is_far && !columns.has_unexplained_residual() && !has_unusual_zero(&columns)
}

/// Maximum residual of another segment's differences, relative to the baseline's residual; and its floor.
const MAX_RESIDUAL_RATIO: f64 = 4.0;
const RESIDUAL_FLOOR_M: f64 = 1e-3;
/// The whole run's residual is a further limit, but never below this ratio: noise alone may cause it.
const MIN_NOISE_RATIO: f64 = 2.0;
/// Maximum residual of the baseline, relative to the whole run's. A larger one is not due to a change.
const MAX_BASELINE_SHARE: f64 = 0.97;

/// Diagnoses the run with its changes corrected, and reports them. `diagnosis` is of the uncorrected run.
/// `None` if there are no changes or they do not explain enough of the residual.
pub(super) fn diagnose_with_changes(
    arm: &ArmRun,
    diagnosis: &ArmDiagnosis,
    max_changes: usize,
) -> Option<ArmDiagnosis> {
    let ArmRun { joints, streams, max_lag_s, .. } = *arm;
    let jumps = jumps_in_joints(joints);
    let is_slow = diagnosis.streams.iter().any(has_slow_residual);
    if jumps.is_empty() && !is_slow {
        return None;
    }
    let lags: Vec<f64> = streams
        .iter()
        .zip(&diagnosis.streams)
        .map(|(stream, diagnosis)| match &diagnosis.latency_s {
            // Its latency is arbitrary.
            _ if diagnosis.is_far_from_fk() => 0.0,
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(joints, stream, max_lag_s),
        })
        .collect();
    let run = SplitRun { arm: *arm, lags: &lags };
    let mut all = run.change_points(diagnosis, jumps);
    if all.len() > max_changes {
        // Keep the strongest sharp jumps and gaps.
        all.retain(|jump| jump.window_s == 0.0);
        all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        all.truncate(max_changes);
        all.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    }
    // Jumps visible only in averages are dated less accurately: first try without them.
    let sharp: Vec<Jump> = all.iter().filter(|jump| jump.window_s == 0.0).copied().collect();
    let is_both = !sharp.is_empty() && sharp.len() < all.len();
    let by_sharp = if is_both { diagnose_with_jumps(&run, &sharp, diagnosis) } else { None };
    if by_sharp.as_ref().is_some_and(|after| !after.streams.iter().any(has_slow_residual)) {
        return by_sharp;
    }
    likeliest([by_sharp, diagnose_with_jumps(&run, &all, diagnosis)].into_iter().flatten())
}

/// Same, for a run that follows FK as logged in some segments only, for example because a unit changes. The run
/// itself then needs no search for an encoding that fits all of it. It is split at gaps, or also at jumps of the
/// recorded numbers.
pub(super) fn diagnose_with_recorded_changes(arm: &ArmRun) -> Option<ArmDiagnosis> {
    let ArmRun { joints, streams, .. } = *arm;
    let lags = vec![0.0; streams.len()];
    let run = SplitRun { arm: *arm, lags: &lags };
    // `None` if the motion determines it for no stream.
    let all_follow = |span: &Span| {
        let (joints, tracks) = (run.joints_in(*span), run.tracks_in(*span));
        let streams = run.with_tracks(&tracks);
        let known = streams.iter().filter_map(|stream| follows_as_logged(&joints, stream));
        known.reduce(|all, one| all && one)
    };
    let whole = all_follow(&(f64::NEG_INFINITY, f64::INFINITY));
    let as_logged = LazyCell::new(|| arm.diagnose_as_logged());
    let is_explained = |after: &ArmDiagnosis| {
        constant_frames_suffice(after) || !after.streams.iter().any(has_slow_residual)
    };
    let times = streams.iter().map(|stream| &stream.track.t_s).chain([&joints.t_s]);
    let gaps: Vec<Jump> = times.flat_map(|t_s| gaps(t_s)).collect();
    let jumps = streams.iter().flat_map(|stream| jumps_in_logged_path(joints, stream));
    let jumps = [gaps.clone(), jumps_in_joints(joints), jumps.collect()].concat();
    let mut attempts = [gaps, jumps].map(strongest).to_vec();
    attempts.dedup_by_key(|jumps| run.split_at(jumps));
    attempts.into_iter().find_map(|jumps| {
        let parts: Vec<Option<bool>> = run.split_at(&jumps).iter().map(all_follow).collect();
        let differs = whole == Some(false) || parts.contains(&Some(false));
        if parts.len() < 2 || !parts.contains(&Some(true)) || !differs {
            return None;
        }
        diagnose_with_jumps(&run, &jumps, &as_logged).filter(is_explained)
    })
}

fn diagnose_with_jumps(
    run: &SplitRun,
    jumps: &[Jump],
    diagnosis: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let ArmRun { joints, streams, .. } = run.arm;
    let spans = run.split_at(jumps);
    let baseline = (0..spans.len()).max_by_key(|&part| run.samples(spans[part]))?;
    let baseline = (spans.len() > 1).then(|| BaselineSegment::diagnose(run, spans[baseline]))?;
    let residual = residual_m(&baseline.diagnosis);
    let is_far = baseline.diagnosis.streams.iter().all(PoseDiagnosis::is_far_from_fk);
    if is_far || residual > MAX_BASELINE_SHARE * residual_m(diagnosis) {
        return None;
    }
    let max_residual_m = (MAX_RESIDUAL_RATIO * residual)
        .max(RESIDUAL_FLOOR_M)
        .min(residual_m(diagnosis).max(MIN_NOISE_RATIO * residual));
    let others = baseline.other_segments(run, &spans, max_residual_m)?;
    let mut spans: Vec<Span> =
        others.iter().map(|other| other.span).chain([baseline.span]).collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Link deviations act differently in each segment, so with another encoding nothing else must change if
    // constant frames explain the run.
    let by_encoding: Vec<OtherSegment> =
        others.iter().map(OtherSegment::with_encoding_only).collect();
    let by_encoding = baseline
        .diagnose_corrected(run, &by_encoding)
        .filter(|(_, after)| constant_frames_suffice(after))
        .map(|corrected| (corrected, by_encoding));
    let ((corrected, mut after), others) = match by_encoding {
        Some(by_encoding) => by_encoding,
        None => (baseline.diagnose_corrected(run, &others)?, others),
    };
    for (s, after) in after.streams.iter_mut().enumerate() {
        if corrected.tracks[s].is_some() {
            baseline.report_encoding(s, &others, after);
        }
    }
    for ((after, track), stream) in after.streams.iter_mut().zip(&corrected.tracks).zip(streams) {
        if track.is_some() || !corrected.patches.is_empty() {
            restore_recorded(joints, stream, after);
        }
    }
    let jump_at = |at_s: f64| jumps.iter().find(|jump| jump.at_s == at_s);
    baseline.report_changes(run, &spans, &others, jump_at, &mut after);
    after.joints.patches = corrected.patches;
    after.joints.partial_encoding = baseline.partial_joint_encoding(&others);
    let reports_a_change = !after.joints.changes.is_empty()
        || after.joints.partial_encoding.is_some()
        || after.streams.iter().any(|after| after.has_changes() || has_latency_steps(after));
    (reports_a_change && log_bayes_factor(&after, diagnosis) > 0.0).then_some(after)
}

/// Whether `both`, the last of `others` merged with `after`, fits about as well as the two apart.
fn is_as_good(
    run: &SplitRun,
    both: &OtherSegment,
    others: &[OtherSegment],
    after: &OtherSegment,
) -> bool {
    /// A factor, and a length in m.
    const RESIDUAL_TOLERANCE: f64 = 1.03;
    const RESIDUAL_TOLERANCE_M: f64 = 1e-5;
    let separate = || others.last().into_iter().chain([after]);
    let samples = |other: &OtherSegment| run.samples(other.span) as f64;
    let all: f64 = separate().map(samples).sum();
    let squares: f64 =
        separate().map(|other| samples(other) * residual_m(&other.difference).powi(2)).sum();
    residual_m(&both.difference)
        <= RESIDUAL_TOLERANCE * (squares / all.max(1.0)).sqrt() + RESIDUAL_TOLERANCE_M
}

struct BaselineSegment {
    span: Span,
    diagnosis: ArmDiagnosis,
}

struct OtherSegment {
    span: Span,
    /// Diagnosis without the baseline.
    alone: ArmDiagnosis,
    /// Diagnosis after correction by the baseline: only the differences.
    difference: ArmDiagnosis,
}

impl BaselineSegment {
    fn diagnose(run: &SplitRun, span: Span) -> Self {
        Self { span, diagnosis: run.diagnose(span).1 }
    }

    /// Diagnoses the other segments. Merges one whose residual exceeds `max_residual_m` with the adjacent one
    /// before it, and two that fit as well together. `None` if a residual remains too large.
    fn other_segments(
        &self,
        run: &SplitRun,
        spans: &[Span],
        max_residual_m: f64,
    ) -> Option<Vec<OtherSegment>> {
        let diagnose = |span: Span| self.other_segment(run, span, max_residual_m);
        let mut others: Vec<OtherSegment> = Vec::new();
        for &part in spans.iter().filter(|part| **part != self.span) {
            let other = match diagnose(part) {
                Some(other) => other,
                None => {
                    let before = others.pop_if(|before| before.span.1 == part.0)?;
                    diagnose((before.span.0, part.1))?
                }
            };
            // Adjacent segments may differ from the baseline in the same way.
            let before = others
                .last()
                .filter(|before| before.span.1 == part.0 && before.has_encoding_of(&other));
            let both = before.and_then(|before| diagnose((before.span.0, part.1)));
            match both.filter(|both| is_as_good(run, both, &others, &other)) {
                Some(both) => {
                    others.pop();
                    others.push(both);
                }
                None => others.push(other),
            }
        }
        Some(others)
    }

    /// `None` if its residual exceeds `max_residual_m` or its encoding is unreliable. A residual far above, which
    /// the segment has even alone, is not due to the baseline.
    fn other_segment(
        &self,
        run: &SplitRun,
        span: Span,
        max_residual_m: f64,
    ) -> Option<OtherSegment> {
        let (joints, alone) = run.diagnose(span);
        if residual_m(&alone) > MAX_RESIDUAL_RATIO * max_residual_m {
            return None;
        }
        let joints =
            self.joints_in_encoding_of(&alone).corrected_joints(&joints, run.arm.is_prismatic);
        let tracks: Vec<PoseTrack> = (0..run.arm.streams.len())
            .map(|s| {
                let decoded = decoded_poses(&alone.streams[s]);
                let frame_correction = &self.diagnosis.streams[s].frame_correction;
                with_poses(&alone.streams[s], decoded.map(|pose| frame_correction.apply(&pose)))
            })
            .collect();
        let known: Vec<PoseStream> = run
            .with_tracks(&tracks)
            .into_iter()
            .map(|stream| PoseStream { reference_known: true, ..stream })
            .collect();
        let difference = diagnose_other_segment(&joints, &known, run.arm.max_lag_s);
        let other = OtherSegment { span, alone, difference };
        let is_explained =
            residual_m(&other.difference) <= max_residual_m && self.is_reliable(&other);
        is_explained.then_some(other)
    }

    /// If a segment's encoding is undetermined, it must match the baseline's, and no frame may rotate much.
    fn is_reliable(&self, other: &OtherSegment) -> bool {
        /// In few configurations, a wrong rotation encoding resembles a rotated frame.
        const MAX_FRAME_ROTATION_RAD: f64 = 0.1;
        let streams =
            self.diagnosis.streams.iter().zip(&other.alone.streams).zip(&other.difference.streams);
        streams.into_iter().all(|((baseline, alone), difference)| {
            let is_determined =
                alone.encoding.as_ref().is_ok_and(|encoding| encoding.is_determined);
            let is_small = |frame: &EstimateResult<FrameEstimate>| {
                !is_chosen(frame)
                    || frame
                        .as_ref()
                        .is_ok_and(|frame| frame.rotation_rad.value < MAX_FRAME_ROTATION_RAD)
            };
            let is_small = is_small(&difference.tool) && is_small(&difference.reference);
            is_determined || (is_same_encoding(baseline, alone) && is_small)
        })
    }

    fn has_other_encoding(&self, s: usize, other: &OtherSegment) -> bool {
        let (baseline, alone) = (&self.diagnosis.streams[s], &other.alone.streams[s]);
        let are_determined = baseline.encoding.is_ok()
            && alone.encoding.as_ref().is_ok_and(|encoding| encoding.is_determined);
        are_determined && !is_same_encoding(baseline, alone)
    }

    /// Increase over the baseline's latency extrapolated with its skew, s. `None` if not significant.
    fn latency_increase(&self, s: usize, other: &OtherSegment) -> Option<Measured> {
        /// The latency profile detects smaller steps.
        const MIN_LATENCY_STEP_S: f64 = 1e-3;
        const MIN_STD_ERRORS: f64 = 6.0;
        let (here, there) = (&self.diagnosis.streams[s], &other.difference.streams[s]);
        let (latency_here, latency_there) =
            (here.latency_s.as_ref().ok()?, there.latency_s.as_ref().ok()?);
        let distance_s = there.aligned.middle_s() - here.aligned.middle_s();
        let drift =
            here.skew.as_ref().map_or(latency_here.scaled(0.0), |skew| skew.scaled(distance_s));
        let std_error =
            latency_there.std_error.hypot(latency_here.std_error).hypot(drift.std_error);
        let increase = Measured {
            value: latency_there.value - latency_here.value - drift.value,
            std_error,
            ..*latency_there
        };
        (increase.value.abs() > MIN_LATENCY_STEP_S.max(MIN_STD_ERRORS * std_error))
            .then_some(increase)
    }

    /// Run with the changes corrected, and its diagnosis. `None` if nothing changed.
    fn diagnose_corrected(
        &self,
        run: &SplitRun,
        others: &[OtherSegment],
    ) -> Option<(CorrectedRun, ArmDiagnosis)> {
        let corrected = self.correct_changes(run, others)?;
        let tracks = corrected.tracks.iter().zip(run.arm.streams);
        let streams: Vec<PoseStream> = tracks
            .map(|(track, stream)| PoseStream {
                track: track.as_ref().unwrap_or(stream.track),
                ..*stream
            })
            .collect();
        let arm = ArmRun { joints: &corrected.joints, streams: &streams, ..run.arm };
        let after = arm.diagnose_again(&self.diagnosis);
        // Compliance persists across change points.
        let with_compliance = diagnose_with_compliance(&arm, &after);
        Some((corrected, with_compliance.unwrap_or(after)))
    }

    /// `None` if nothing changed.
    fn correct_changes(&self, run: &SplitRun, others: &[OtherSegment]) -> Option<CorrectedRun> {
        let mut joints = run.arm.joints.clone();
        let mut patches = Vec::new();
        for other in others {
            let (from_s, to_s) = other.span;
            let in_its_encoding = self.joints_in_encoding_of(&other.alone);
            let unchanged = JointPatch {
                column: 0,
                exchanged_with: None,
                from_s,
                to_s,
                factor: 1.0,
                offset: 0.0,
            };
            let exchanges = exchanges(&self.diagnosis.joints, &in_its_encoding, run.arm.joints.dof);
            patches.extend(exchanges.into_iter().map(|(column, other)| JointPatch {
                column,
                exchanged_with: Some(other),
                ..unchanged
            }));
            let map =
                joint_map(&self.diagnosis.joints, &in_its_encoding, &other.difference.joints, run);
            let own_patches = map.into_iter().map(|(column, factor, offset)| JointPatch {
                column,
                factor,
                offset,
                ..unchanged
            });
            patches.extend(own_patches);
        }
        patches.iter().for_each(|patch: &JointPatch| patch.apply(&mut joints));
        let tracks: Vec<Option<PoseTrack>> = (0..run.arm.streams.len())
            .map(|s| {
                let differs = |other: &&OtherSegment| {
                    let difference = &other.difference.streams[s];
                    self.has_other_encoding(s, other)
                        || self.latency_increase(s, other).is_some()
                        || difference.is_radial_scale_chosen
                        || is_chosen(&difference.reference)
                        || is_chosen(&difference.tool)
                };
                others.iter().any(|other| differs(&other)).then(|| self.corrected_track(s, others))
            })
            .collect();
        let is_changed = !patches.is_empty() || tracks.iter().any(Option::is_some);
        is_changed.then_some(CorrectedRun { joints, patches, tracks })
    }

    /// Decoded poses with the differences of the other segments corrected, so that the baseline's errors apply
    /// to all.
    fn corrected_track(&self, s: usize, others: &[OtherSegment]) -> PoseTrack {
        let baseline = &self.diagnosis.streams[s];
        let mut segments = vec![(self.span, with_poses(baseline, decoded_poses(baseline)))];
        for other in others {
            let difference = &other.difference.streams[s];
            let poses = decoded_poses(difference).map(|pose| {
                baseline.frame_correction.invert(&difference.frame_correction.apply(&pose))
            });
            let mut track = with_poses(difference, poses);
            let delay_s = self.latency_increase(s, other).map_or(0.0, |increase| increase.value);
            track.t_s.iter_mut().for_each(|t_s| *t_s -= delay_s);
            segments.push((other.span, track));
        }
        segments.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let mut segments = segments.into_iter().map(|(_, track)| track);
        let first =
            segments.next().unwrap_or_else(|| with_poses(baseline, decoded_poses(baseline)));
        segments.fold(first, |mut all, segment| {
            // Correcting a latency can make segments overlap.
            let end_s = segment.t_s.first().copied().unwrap_or(f64::INFINITY);
            let retained = all.t_s.partition_point(|t_s| *t_s < end_s);
            all.t_s.truncate(retained);
            all.xyz.truncate(retained);
            if let Orientations::Rotations(all) = &mut all.orientation {
                all.truncate(retained);
            }
            all.t_s.extend(segment.t_s);
            all.xyz.extend(segment.xyz);
            if let (Orientations::Rotations(all), Orientations::Rotations(segment)) =
                (&mut all.orientation, segment.orientation)
            {
                all.extend(segment);
            }
            all
        })
    }
}

impl OtherSegment {
    fn has_encoding_of(&self, other: &OtherSegment) -> bool {
        let (own, theirs) = (&self.alone, &other.alone);
        let is_same_of_joints = match (&own.joints.encoding, &theirs.joints.encoding) {
            (Ok(own), Ok(theirs)) => own.is_same(theirs),
            (own, theirs) => own.is_ok() == theirs.is_ok(),
        };
        let mut streams = own.streams.iter().zip(&theirs.streams);
        is_same_of_joints && streams.all(|(own, theirs)| is_same_encoding(own, theirs))
    }

    /// Same, but only the encoding differs from the baseline's.
    fn with_encoding_only(&self) -> Self {
        let Self { span, alone, difference } = self;
        let mut difference = difference.clone();
        difference.joints.offsets.iter_mut().for_each(|offset| offset.is_chosen = false);
        for stream in &mut difference.streams {
            stream.aligned.corrected = decoded_poses(stream).collect();
            stream.frame_correction = FrameCorrection::default();
            for frame in [&mut stream.tool, &mut stream.reference].into_iter().flatten() {
                frame.is_chosen = false;
            }
            stream.is_radial_scale_chosen = false;
            stream.latency_s = Err(NotObservable::NotExcited);
        }
        Self { span: *span, alone: alone.clone(), difference }
    }
}

struct CorrectedRun {
    joints: JointTrack,
    patches: Vec<JointPatch>,
    /// Corrected poses of the streams that changed.
    tracks: Vec<Option<PoseTrack>>,
}

impl JointPatch {
    /// Maps the joint's positions to the baseline segment.
    pub(super) fn apply(&self, joints: &mut JointTrack) {
        let dof = joints.dof.max(1);
        let rows = self.rows(&joints.t_s);
        for row in rows.clone() {
            let at = row * dof + self.column;
            if let Some(other) = self.exchanged_with {
                let other = row * dof + other;
                joints.q.swap(at, other);
                joints.qd.swap(at, other);
            }
            self.apply_to_value(&mut joints.q[at], &mut joints.qd[at]);
        }
        for edge in [rows.start, rows.end].into_iter().filter(|edge| *edge > 1) {
            for column in std::iter::once(self.column).chain(self.exchanged_with) {
                set_velocity(joints, column, edge - 1, edge - 2);
                set_velocity(joints, column, edge, edge + 1);
            }
        }
    }

    /// The same for the joint's own samples.
    pub fn apply_to_samples(&self, t_s: &[f64], position: &mut [f64], velocity: &mut [f64]) {
        for row in self.rows(t_s) {
            self.apply_to_value(&mut position[row], &mut velocity[row]);
        }
    }

    /// Rows of the segment.
    pub fn rows(&self, t_s: &[f64]) -> Range<usize> {
        let [from, to] =
            [self.from_s, self.to_s].map(|at_s| t_s.partition_point(|t_s| *t_s < at_s));
        from..to
    }

    fn apply_to_value(&self, position: &mut f64, velocity: &mut f64) {
        *position = self.factor * *position + self.offset;
        *velocity *= self.factor;
    }
}

/// The joint under each joint's name.
fn joint_order(diagnosis: &JointDiagnosis, dof: usize) -> Vec<usize> {
    let permutation =
        diagnosis.encoding.as_ref().ok().and_then(|encoding| encoding.permutation.as_ref());
    permutation.map_or_else(|| (0..dof).collect(), |(order, _)| order.clone())
}

/// Exchanges of two columns, one after another, that put joints of another segment into the baseline's order.
fn exchanges(
    baseline: &JointDiagnosis,
    in_its_encoding: &JointDiagnosis,
    dof: usize,
) -> Vec<(usize, usize)> {
    let (wanted, mut own) = (joint_order(baseline, dof), joint_order(in_its_encoding, dof));
    let mut exchanges = Vec::new();
    for (column, joint) in wanted.into_iter().enumerate() {
        let at = own.iter().position(|one| *one == joint).filter(|at| *at != column);
        if let Some(at) = at {
            own.swap(column, at);
            exchanges.push((column, at));
        }
    }
    exchanges
}

/// Column, factor and offset that map joints of another segment to the baseline, from two test positions,
/// after [`exchanges`]. `in_its_encoding` is the baseline in the other segment's unit and order. Empty if an
/// encoding is undetermined.
fn joint_map(
    baseline: &JointDiagnosis,
    in_its_encoding: &JointDiagnosis,
    difference: &JointDiagnosis,
    run: &SplitRun,
) -> Vec<(usize, f64, f64)> {
    let dof = run.arm.joints.dof;
    let order = joint_order(baseline, dof);
    let is_in_order =
        difference.encoding.as_ref().is_ok_and(|encoding| encoding.permutation.is_none());
    if !is_in_order || baseline.encoding.is_err() {
        return Vec::new();
    }
    // Corrected by the baseline, then by the other segment.
    let probe = JointTrack {
        t_s: vec![0.0, 1.0],
        dof,
        q: [vec![0.0; dof], vec![1.0; dof]].concat(),
        qd: vec![0.0; 2 * dof],
        noise: Vec::new(),
    };
    let corrected = |diagnosis: &JointDiagnosis, joints: &JointTrack| {
        let unpatched = JointDiagnosis { patches: Vec::new(), ..diagnosis.clone() };
        unpatched.corrected_joints(joints, run.arm.is_prismatic)
    };
    let by_baseline = corrected(baseline, &probe);
    let by_both = corrected(difference, &corrected(in_its_encoding, &probe));
    let map = |column: usize| {
        let at = |row: usize| {
            let at = row * dof + order[column];
            (by_baseline.q[at], by_both.q[at])
        };
        let ((zero, zero_both), (one, one_both)) = (at(0), at(1));
        let factor = one - zero;
        (column, (one_both - zero_both) / factor, (zero_both - zero) / factor)
    };
    let is_changed = |&(_, factor, offset): &(usize, f64, f64)| {
        let is_identity = (factor - 1.0).abs() < 1e-12 && offset.abs() < 1e-12;
        factor.is_finite() && offset.is_finite() && !is_identity
    };
    (0..dof).map(map).filter(is_changed).collect()
}

fn is_chosen(frame: &EstimateResult<FrameEstimate>) -> bool {
    frame.as_ref().is_ok_and(|frame| frame.is_chosen)
}

/// Poses with only the encoding corrected: as logged, frame errors included.
fn decoded_poses(diagnosis: &PoseDiagnosis) -> impl Iterator<Item = Pose> {
    diagnosis.aligned.corrected.iter().map(|pose| diagnosis.frame_correction.invert(pose))
}

fn with_poses(diagnosis: &PoseDiagnosis, poses: impl Iterator<Item = Pose>) -> PoseTrack {
    let (xyz, rotations): (Vec<_>, Vec<_>) =
        poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let orientation = match &diagnosis.encoding {
        Ok(_) => Orientations::Rotations(rotations),
        Err(_) => Orientations::Unset(rotations.len()),
    };
    PoseTrack { t_s: diagnosis.aligned.t_s.clone(), xyz, orientation, declared: None }
}
