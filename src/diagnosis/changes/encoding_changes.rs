//! Encodings that change within a run, for example when a node is restarted.
//!
//! The run is split where recorded numbers jump or data are missing. Its segments are diagnosed alone. Those with another
//! encoding than the longest one are encoded like it, and the run is diagnosed as a whole. The encodings of segments are
//! reported only if that is likelier.

use std::cell::LazyCell;

use super::jumps::{Jump, gaps, jumps_in_joints, jumps_in_logged_path, strongest};
use super::large_steps::diagnose_with_large_steps;
use super::patches::with_poses;
use super::profile::Profile;
use super::split_run::{Span, SplitRun};
use super::{EncodingSpans, JointChange, JointParameter, JointPatch, constant_frames_suffice};
use crate::arm_run::ArmRun;
use crate::joints::follows_as_logged;
use crate::latency::compensation::with_tracks;
use crate::latency::correlation::stream_lag_s;
use crate::residuals::comparison::{has_slow_residual, residual_m, restore_recorded};
use crate::selection::evidence::log_bayes_factor;
use crate::{
    ArmDiagnosis, AxesError, JointDiagnosis, JointEncoding, PoseDiagnosis, PoseEncoding, PoseStream,
};
use ground::geometry::Pose;
use ground::stats::Measured;
use ground::stream::{JointTrack, PoseTrack};

/// Maximum residual of a segment, relative to the longest one's, and its floor.
const MAX_RESIDUAL_RATIO: f64 = 4.0;
const RESIDUAL_FLOOR_M: f64 = 1e-3;
/// Maximum residual of the longest segment, relative to the whole run's. A larger one is not due to a change.
const MAX_LONGEST_SHARE: f64 = 0.97;

/// Diagnoses the run with all segments encoded alike, by `diagnose`, and reports the encodings. `constant` is the
/// diagnosis with one encoding. `None` if that is likelier.
pub(crate) fn diagnose_with_encoding_changes(
    run: &ArmRun,
    constant: &ArmDiagnosis,
    diagnose: impl Fn(&ArmRun) -> ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    if constant.is_explained(run.streams) {
        return None;
    }
    let lag_s = |(stream, found): (&PoseStream, &PoseDiagnosis)| match &found.latency_s {
        // Its latency is arbitrary.
        _ if found.is_far_from_fk() => 0.0,
        Ok(latency) => latency.value,
        Err(_) => stream_lag_s(run.joints, stream, run.max_lag_s),
    };
    let lags: Vec<f64> = run.streams.iter().zip(&constant.streams).map(lag_s).collect();
    let run = SplitRun { arm: *run, lags: &lags };
    diagnose_with_jumps(&run, &run.recorded_jumps(), constant, &diagnose)
}

/// Same, for a run that follows FK as logged in some segments only, for example because a unit changes. The run
/// itself then needs no search for an encoding that fits all of it. It is split at gaps, or also at jumps of the
/// recorded numbers.
pub(crate) fn diagnose_with_recorded_encoding_changes(
    arm: &ArmRun,
    diagnose: impl Fn(&ArmRun) -> ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    // `None` if the motion determines it for no stream.
    let all_follow = |part: &ArmRun| {
        let streams = part.streams.iter();
        let known = streams.filter_map(|stream| follows_as_logged(part.joints, stream));
        known.reduce(|all, one| all && one)
    };
    // Then each segment follows, even if its own motion does not determine the frames.
    if all_follow(arm) == Some(true) {
        return None;
    }
    let lags = vec![0.0; arm.streams.len()];
    let run = SplitRun { arm: *arm, lags: &lags };
    let as_logged = LazyCell::new(|| arm.diagnose_as_logged());
    let is_explained = |after: &ArmDiagnosis| {
        constant_frames_suffice(after) || !after.streams.iter().any(has_slow_residual)
    };
    let mut attempts = vec![run.recorded_gaps(), run.recorded_jumps()];
    attempts.dedup_by_key(|jumps| run.split_at(jumps));
    attempts.into_iter().find_map(|jumps| {
        let parts: Vec<Option<bool>> =
            run.split_at(&jumps).into_iter().map(|span| run.within(span, all_follow)).collect();
        if parts.len() < 2 || !parts.contains(&Some(true)) {
            return None;
        }
        diagnose_with_jumps(&run, &jumps, &as_logged, &diagnose).filter(is_explained)
    })
}

impl SplitRun<'_> {
    /// On the joint states' clock.
    fn jumps_in_streams(&self, jumps_in: impl Fn(&PoseStream) -> Vec<Jump>) -> Vec<Jump> {
        let of_stream = |(stream, lag_s): (&PoseStream, &f64)| {
            let mut jumps = jumps_in(stream);
            jumps.iter_mut().for_each(|jump| jump.at_s -= lag_s);
            jumps
        };
        self.arm.streams.iter().zip(self.lags).flat_map(of_stream).collect()
    }

    fn recorded_gaps(&self) -> Vec<Jump> {
        let of_streams = self.jumps_in_streams(|stream| gaps(&stream.track.t_s));
        strongest([of_streams, gaps(&self.arm.joints.t_s)].concat())
    }

    /// Jumps of the recorded numbers, and gaps.
    fn recorded_jumps(&self) -> Vec<Jump> {
        let joints = self.arm.joints;
        let of_streams = self.jumps_in_streams(|stream| jumps_in_logged_path(joints, stream));
        strongest([of_streams, jumps_in_joints(joints), self.recorded_gaps()].concat())
    }
}

fn diagnose_with_jumps(
    run: &SplitRun,
    jumps: &[Jump],
    constant: &ArmDiagnosis,
    diagnose: &impl Fn(&ArmRun) -> ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let segments = Segments::diagnose(run, &run.split_at(jumps), residual_m(constant))?;
    let (patches, tracks) = segments.encoded_alike(run);
    if patches.is_empty() && tracks.iter().all(Option::is_none) {
        let after = diagnose_with_large_steps(run, &segments, jumps)?;
        return (log_bayes_factor(&after, constant) > 0.0).then_some(after);
    }
    let mut joints = run.arm.joints.clone();
    patches.iter().for_each(|patch| patch.apply(&mut joints));
    let streams = with_tracks(run.arm.streams, &tracks);
    let mut after = diagnose(&ArmRun { joints: &joints, streams: &streams, ..run.arm });
    for (s, (after, stream)) in after.streams.iter_mut().zip(run.arm.streams).enumerate() {
        if tracks[s].is_some() {
            segments.report_encoding(s, after);
        }
        if tracks[s].is_some() || !patches.is_empty() {
            restore_recorded(run.arm.joints, stream, after);
        }
    }
    after.joints.changes.extend(segments.factor_changes(jumps, run.arm.joints.dof));
    after.joints.patches.splice(0..0, patches);
    after.joints.partial_encoding = segments.partial_joint_encoding();
    (log_bayes_factor(&after, constant) > 0.0).then_some(after)
}

pub(super) struct Segment {
    pub span: Span,
    /// Diagnosis of the segment alone.
    pub found: ArmDiagnosis,
}

pub(super) struct Segments {
    pub longest: Segment,
    /// In order of time.
    others: Vec<Segment>,
}

impl Segments {
    /// Diagnoses the segments. One that is not explained is merged with the one before it. `None` if that is not
    /// explained either, or the longest is not explained better than the run.
    fn diagnose(run: &SplitRun, spans: &[Span], residual_of_run_m: f64) -> Option<Self> {
        let longest = (0..spans.len()).max_by_key(|&part| run.samples(spans[part]))?;
        let diagnose =
            |span: Span| Segment { span, found: run.within(span, |part| part.diagnose()) };
        let longest = (spans.len() > 1).then(|| diagnose(spans[longest]))?;
        let residual = residual_m(&longest.found);
        let is_far = longest.found.streams.iter().all(PoseDiagnosis::is_far_from_fk);
        if is_far || residual > MAX_LONGEST_SHARE * residual_of_run_m {
            return None;
        }
        let max_residual_m = (MAX_RESIDUAL_RATIO * residual).max(RESIDUAL_FLOOR_M);
        let is_explained = |segment: &Segment| {
            residual_m(&segment.found) <= max_residual_m && longest.is_comparable(segment)
        };
        let explained = |span: Span| Some(diagnose(span)).filter(is_explained);
        let mut others: Vec<Segment> = Vec::new();
        for &span in spans.iter().filter(|span| **span != longest.span) {
            let segment = explained(span).or_else(|| {
                let before = others.pop_if(|before| before.span.1 == span.0)?;
                explained((before.span.0, span.1))
            })?;
            others.push(segment);
        }
        Some(Self { longest, others })
    }

    /// Corrections that convert the run to the encodings of its longest segment: joint patches, and decoded poses of the
    /// streams whose encoding changes.
    fn encoded_alike(&self, run: &SplitRun) -> (Vec<JointPatch>, Vec<Option<PoseTrack>>) {
        let patches = self.others.iter().flat_map(|other| self.longest.patches(other, run));
        let track = |s: usize| {
            let changes = self.others.iter().any(|other| self.longest.has_other_encoding(s, other));
            changes.then(|| self.decoded_track(s, |_| [Pose::identity(); 2]))
        };
        (patches.collect(), (0..run.arm.streams.len()).map(track).collect())
    }

    /// In order of time.
    pub fn all(&self) -> Vec<&Segment> {
        let mut all: Vec<&Segment> = self.others.iter().chain([&self.longest]).collect();
        all.sort_by(|a, b| a.span.0.total_cmp(&b.span.0));
        all
    }

    /// Poses with only the encoding corrected, between two poses for each segment. Frame errors are included.
    pub fn decoded_track(&self, s: usize, between: impl Fn(usize) -> [Pose; 2]) -> PoseTrack {
        let all = self.all();
        let decoded = |at: usize| {
            let found = &all[at].found.streams[s];
            let corrected = found.aligned.corrected.iter();
            let poses = corrected.map(|pose| found.frame_correction.invert(pose));
            let mut track = with_poses(found, poses);
            let [left, right] = between(at);
            track.transform(&left, &right);
            track
        };
        let mut joined = decoded(0);
        (1..all.len()).for_each(|at| joined.append(decoded(at)));
        joined
    }

    /// If an encoding differs between segments, reports the one not as logged, with its time span.
    fn report_encoding(&self, s: usize, after: &mut PoseDiagnosis) {
        let (found, rotation) =
            self.component(s, rotation, |(best, is_inverted)| best.is_as_logged() && !is_inverted);
        after.encoding.clone_from(&found.encoding);
        after.is_inverted = found.is_inverted;
        let (found, degrees) = self.component(s, is_in_degrees, |is_in_degrees| !is_in_degrees);
        after.degrees = found.degrees;
        let (found, length) = self.component(s, length_factor, Option::is_none);
        after.length_unit.clone_from(&found.length_unit);
        let (found, axes) = self.component(s, axes, Option::is_none);
        after.axes.clone_from(&found.axes);
        let longest = &self.longest.found.streams[s];
        after.constant_coordinates.clone_from(&longest.constant_coordinates);
        after.encoding_spans = EncodingSpans { rotation, degrees, length, axes };
    }

    /// A stream's diagnosis with the component of its encoding that is reported, and the span of that if it changes.
    fn component<T: PartialEq>(
        &self,
        s: usize,
        component: impl Fn(&PoseDiagnosis) -> T,
        is_as_logged: impl Fn(&T) -> bool,
    ) -> (&PoseDiagnosis, Option<Span>) {
        let of = |segment: &Segment| component(&segment.found.streams[s]);
        let longest = of(&self.longest);
        let first = self.others.iter().find(|other| self.longest.has_other_encoding(s, other));
        match first.filter(|first| of(first) != longest) {
            None => (&self.longest.found.streams[s], None),
            Some(_) if !is_as_logged(&longest) => {
                (&self.longest.found.streams[s], Some(self.longest.span))
            }
            Some(first) => {
                let same = self.others.iter().filter(|other| of(other) == of(first));
                let span = same.map(|other| other.span).reduce(|a, b| (a.0, b.1));
                (&first.found.streams[s], span)
            }
        }
    }

    /// Encoding and span of the segments whose joints are in degrees or in another order, if others are not.
    fn partial_joint_encoding(&self) -> Option<(JointEncoding, Span)> {
        let encoding = |segment: &'_ Segment| segment.found.joints.encoding.clone().ok();
        let all = self.all();
        let known = all.iter().filter_map(|segment| Some((segment.span, encoding(segment)?)));
        let (wrong, right): (Vec<_>, Vec<_>) = known
            .partition(|(_, encoding)| encoding.is_in_degrees || encoding.permutation.is_some());
        let (_, encoding) = wrong.first().filter(|_| !right.is_empty())?;
        let ends = wrong.iter().map(|(span, _)| *span);
        let span = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        Some((encoding.clone(), span))
    }

    /// Changes of joint scales between segments.
    fn factor_changes(&self, jumps: &[Jump], dof: usize) -> Vec<JointChange> {
        let change = |pair: &[&Segment], column: usize| {
            let jump = jumps.iter().find(|jump| jump.at_s == pair[1].span.0)?;
            let factors = [pair[0], pair[1]].map(|segment| segment.factor(column));
            let [from, to] = factors.map(|factor| factor.map_or(1.0, |factor| factor.value));
            let std_error =
                factors.iter().flatten().fold(0.0_f64, |sum, it| sum.hypot(it.std_error));
            let surest = factors[1].or(factors[0])?;
            let size = Measured { value: to - from, std_error, ..surest };
            let is_same = size.value.abs() < 4.0 * std_error + 1e-5;
            let factor = Profile::Step(*jump).change_point(from, to, size);
            let parameter = JointParameter::Factor;
            (!is_same).then_some(JointChange { column, parameter, change: factor })
        };
        let all = self.all();
        let changes =
            all.windows(2).flat_map(|pair| (0..dof).filter_map(|column| change(pair, column)));
        changes.collect()
    }
}

impl Segment {
    /// Whether each encoding of the other segment is determined, or the same.
    fn is_comparable(&self, other: &Segment) -> bool {
        let mut streams = self.found.streams.iter().zip(&other.found.streams);
        streams.all(|(own, other)| {
            let is_determined =
                other.encoding.as_ref().is_ok_and(|encoding| encoding.is_determined);
            is_determined || is_same_encoding(own, other)
        })
    }

    fn has_other_encoding(&self, s: usize, other: &Segment) -> bool {
        let (own, other) = (&self.found.streams[s], &other.found.streams[s]);
        let are_determined = own.encoding.is_ok()
            && other.encoding.as_ref().is_ok_and(|encoding| encoding.is_determined);
        are_determined && !is_same_encoding(own, other)
    }

    /// Scale of a joint, if it is not 1.
    fn factor(&self, column: usize) -> Option<Measured> {
        let scales = &self.found.joints.scales;
        scales.iter().find(|scale| scale.column == column).map(|scale| scale.factor)
    }

    /// Corrections that put the joints of another segment into this one's encoding.
    fn patches(&self, other: &Segment, run: &SplitRun) -> Vec<JointPatch> {
        let (from_s, to_s) = other.span;
        let unchanged = JointPatch::unchanged(0, from_s, to_s);
        let (own, other) = (&self.found.joints, &other.found.joints);
        let exchanges = exchanges(own, other, run.arm.joints.dof);
        let exchanged =
            |(column, other)| JointPatch { column, exchanged_with: Some(other), ..unchanged };
        let mapped = |(column, factor, offset)| JointPatch { column, factor, offset, ..unchanged };
        let maps = joint_map(own, other, run).into_iter().map(mapped);
        exchanges.into_iter().map(exchanged).chain(maps).collect()
    }
}

/// The joint under each joint's name.
fn joint_order(diagnosis: &JointDiagnosis, dof: usize) -> Vec<usize> {
    let permutation =
        diagnosis.encoding.as_ref().ok().and_then(|encoding| encoding.permutation.as_ref());
    permutation.cloned().unwrap_or_else(|| (0..dof).collect())
}

/// Exchanges of two columns, one after another, that put the joints of `other` into the order of `own`.
fn exchanges(own: &JointDiagnosis, other: &JointDiagnosis, dof: usize) -> Vec<(usize, usize)> {
    let (wanted, mut order) = (joint_order(own, dof), joint_order(other, dof));
    let mut exchanges = Vec::new();
    for (column, joint) in wanted.into_iter().enumerate() {
        let at = order.iter().position(|one| *one == joint).filter(|at| *at != column);
        if let Some(at) = at {
            order.swap(column, at);
            exchanges.push((column, at));
        }
    }
    exchanges
}

/// Column, factor and offset that map joints of `other` to the encoding of `own`, from two test positions, after
/// [`exchanges`]. Empty if an encoding is undetermined.
fn joint_map(
    own: &JointDiagnosis,
    other: &JointDiagnosis,
    run: &SplitRun,
) -> Vec<(usize, f64, f64)> {
    if own.encoding.is_err() || other.encoding.is_err() {
        return Vec::new();
    }
    let dof = run.arm.joints.dof;
    let order = joint_order(own, dof);
    // Zeros are no encoding.
    let decoded = |joints: &JointDiagnosis, q: f64| {
        let (q, qd) = (vec![q; dof], vec![0.0; dof]);
        let probe = JointTrack { t_s: vec![0.0], dof, q, qd, noise: Vec::new() };
        let (encoding, scales) = (joints.encoding.clone(), joints.scales.clone());
        JointDiagnosis::without_changes(encoding, own.offsets.clone(), scales)
            .corrected_joints(&probe, run.arm.is_prismatic)
            .q
    };
    let [[zero, one], [zero_other, one_other]] =
        [own, other].map(|joints| [0.0, 1.0].map(|q| decoded(joints, q)));
    let map = |column: usize| {
        let joint = order[column];
        let factor = one[joint] - zero[joint];
        let difference = one_other[joint] - zero_other[joint];
        (column, difference / factor, (zero_other[joint] - zero[joint]) / factor)
    };
    let is_changed = |&(_, factor, offset): &(usize, f64, f64)| {
        let is_identity = (factor - 1.0).abs() < 1e-12 && offset.abs() < 1e-12;
        factor.is_finite() && offset.is_finite() && !is_identity
    };
    (0..dof).map(map).filter(is_changed).collect()
}

fn rotation(diagnosis: &PoseDiagnosis) -> (PoseEncoding, bool) {
    let best = diagnosis.encoding.as_ref().map_or(PoseEncoding::AsLogged, |it| it.best);
    (best, diagnosis.is_inverted)
}

fn is_in_degrees(diagnosis: &PoseDiagnosis) -> bool {
    diagnosis.degrees.is_some()
}

fn length_factor(diagnosis: &PoseDiagnosis) -> Option<f64> {
    Some(diagnosis.length_unit.as_ref().ok()?.as_ref()?.factor())
}

fn axes(diagnosis: &PoseDiagnosis) -> Option<AxesError> {
    diagnosis.axes.as_ref().ok().copied().flatten()
}

fn is_same_encoding(a: &PoseDiagnosis, b: &PoseDiagnosis) -> bool {
    let components = |of| (rotation(of), is_in_degrees(of), length_factor(of), axes(of));
    components(a) == components(b)
}
