//! Change points: a tool slips, the base is moved, a joint loses its zero, or an encoding changes.
//!
//! The run is split where a stream jumps relative to the arm ([`jumps`]). The longest segment, the
//! baseline, is diagnosed alone. The others are corrected by its result and diagnosed again, so their
//! models contain only the differences (after Chow 1960). The whole run is then diagnosed with these
//! corrected. Change points are reported only if this reduces the residual substantially.

mod change_points;
mod constant_frames;
mod encoding_changes;
mod jumps;
mod justification;
mod report;
mod split_run;

use crate::arm::{diagnose_arm, diagnose_other_segment};
use crate::compliance::diagnose_with_compliance;
use crate::residuals::residual_check::align_with_fk;
use crate::samples::sampling::stream_lag_s;
use crate::{
    ArmDiagnosis, EstimateResult, FrameEstimate, JointDiagnosis, PoseDiagnosis, PoseStream,
};
use ground::geometry::Pose;
use ground::stats::Measured;
use ground::stream::{JointTrack, Orientations, PoseTrack};

pub use change_points::{
    ChangePoint, EncodingSpans, FrameChange, JointChange, JointPatch, ScalarChange,
};
pub(super) use constant_frames::constant_frames_suffice;
use encoding_changes::is_same_encoding;
use jumps::{Jump, jumps_in_joints};
use justification::is_justified;
pub(super) use justification::{
    has_large_residual, has_latency_steps, has_slow_residual, log_likelihood_gain, residual_m,
};
use split_run::{MIN_SEGMENT_SAMPLES, Span, SplitRun};

/// Limit for a segment, relative to the baseline's residual; and its floor.
const MAX_RESIDUAL_RATIO: f64 = 4.0;
const RESIDUAL_FLOOR_M: f64 = 1e-3;
/// Smaller ratios of two segments may be the same noise.
const MIN_NOISE_RATIO: f64 = 2.0;
/// Share of the whole run's residual; above it, changes do not explain it.
const MAX_BASELINE_SHARE: f64 = 0.97;

/// Diagnoses the arm as if nothing had changed. `found` is the diagnosis of the whole run. `None` if there
/// are no changes or they do not explain enough of the residual.
pub(super) fn diagnose_with_changes(
    joints: &JointTrack,
    streams: &[PoseStream],
    slides: &[bool],
    found: &ArmDiagnosis,
    most_lag_s: f64,
    most: usize,
) -> Option<ArmDiagnosis> {
    let jumps = jumps_in_joints(joints);
    if jumps.is_empty() && !found.streams.iter().any(has_slow_residual) {
        return None;
    }
    let lags: Vec<f64> = streams
        .iter()
        .zip(&found.streams)
        .map(|(stream, found)| match &found.latency_s {
            Ok(latency) => latency.value,
            Err(_) => stream_lag_s(joints, stream, most_lag_s),
        })
        .collect();
    let run =
        SplitRun { joints, streams, is_prismatic: slides, lags: &lags, max_lag_s: most_lag_s };
    let mut all = run.change_points(found, jumps);
    if all.len() > most {
        all.retain(|jump| jump.window_s == 0.0);
        all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        all.truncate(most);
        all.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    }
    // Jumps that need averaging come second.
    let sharp: Vec<Jump> = all.iter().filter(|jump| jump.window_s == 0.0).copied().collect();
    let is_both = !sharp.is_empty() && sharp.len() < all.len();
    let by_sharp = if is_both { diagnose_with_jumps(&run, &sharp, found) } else { None };
    match by_sharp {
        Some(after) if !after.streams.iter().any(has_slow_residual) => Some(after),
        by_sharp => match (diagnose_with_jumps(&run, &all, found), by_sharp) {
            (Some(all), Some(sharp)) if residual_m(&sharp) <= residual_m(&all) => Some(sharp),
            (all, sharp) => all.or(sharp),
        },
    }
}

fn diagnose_with_jumps(
    run: &SplitRun,
    moments: &[Jump],
    found: &ArmDiagnosis,
) -> Option<ArmDiagnosis> {
    let SplitRun { joints, streams, is_prismatic: slides, max_lag_s: most_lag_s, .. } = *run;
    let parts = run.split_at(moments);
    let kept = (0..parts.len()).max_by_key(|&part| run.samples(parts[part]))?;
    let kept = (parts.len() > 1).then(|| BaselineSegment::diagnose(run, parts[kept]))?;
    let left = residual_m(&kept.found);
    if left > MAX_BASELINE_SHARE * residual_m(found) {
        // The residual is not due to a change.
        return None;
    }
    let most_m = (MAX_RESIDUAL_RATIO * left)
        .max(RESIDUAL_FLOOR_M)
        .min(residual_m(found).max(MIN_NOISE_RATIO * left));
    let others = kept.other_segments(run, &parts, most_m)?;
    let mut parts: Vec<Span> = others.iter().map(|other| other.span).chain([kept.span]).collect();
    parts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let undone = kept.correct_changes(run, &others)?;
    let tracks = undone.tracks.iter().zip(streams);
    let changed: Vec<PoseStream> = tracks
        .map(|(track, stream)| PoseStream {
            track: track.as_ref().unwrap_or(stream.track),
            ..*stream
        })
        .collect();
    let mut after = diagnose_arm(&undone.joints, &changed, most_lag_s);
    // Compliance persists across change points.
    if let Some(bent) =
        diagnose_with_compliance(&undone.joints, &changed, slides, &after, most_lag_s)
    {
        after = bent;
    }
    let weighed = after.clone();
    for (s, after) in after.streams.iter_mut().enumerate() {
        if undone.tracks[s].is_some() {
            kept.report_encoding(s, &others, after);
        }
    }
    for ((after, track), stream) in after.streams.iter_mut().zip(&undone.tracks).zip(streams) {
        if track.is_some() || !undone.patches.is_empty() {
            restore_recorded(joints, stream, after);
        }
    }
    let moment = |at_s: f64| moments.iter().find(|jump| jump.at_s == at_s);
    kept.report_changes(run, &parts, &others, moment, &mut after);
    after.joints.patches = undone.patches;
    let is_told = !after.joints.changes.is_empty()
        || after.streams.iter().any(|after| after.has_changes() || has_latency_steps(after));
    (is_told && is_justified(found, &weighed, parameter_count(&after, parts.len())))
        .then_some(after)
}

/// Parameters of the changes.
fn parameter_count(after: &ArmDiagnosis, parts: usize) -> usize {
    let of_stream = |found: &PoseDiagnosis| {
        let frames = found.tool_changes.len() + found.reference_changes.len();
        let times = found.latency_profile.as_ref().map_or(0, |course| course.steps.len());
        let EncodingSpans { rotation, degrees, length, axes } = found.encoding_spans;
        let coded = [rotation, degrees, length, axes].into_iter().flatten().count();
        6 * frames + found.radial_scale_changes.len() + times + coded
    };
    let of_joints =
        after.joints.changes.iter().map(|change| {
            usize::from(change.zero.is_some()) + usize::from(change.factor.is_some())
        });
    let moments = parts.saturating_sub(1);
    moments + of_joints.sum::<usize>() + after.streams.iter().map(of_stream).sum::<usize>()
}

/// Restores recorded poses, and FK of recorded joint states, in a corrected stream's samples.
pub(super) fn restore_recorded(
    joints: &JointTrack,
    stream: &PoseStream,
    after: &mut PoseDiagnosis,
) {
    let recorded = align_with_fk(joints, stream, 0.0);
    let aligned = &mut after.aligned;
    for (row, t_s) in aligned.t_s.iter().enumerate() {
        let next = recorded.t_s.partition_point(|at_s| at_s < t_s);
        let nearest = [next.checked_sub(1), Some(next)].into_iter().flatten();
        let away_s = |at: &usize| (recorded.t_s[*at] - t_s).abs();
        let nearest = nearest.filter(|at| *at < recorded.t_s.len());
        if let Some(at) = nearest.min_by(|a, b| away_s(a).total_cmp(&away_s(b))) {
            aligned.fk[row] = recorded.fk[at];
            aligned.logged[row].translation = recorded.logged[at].translation;
            if matches!(stream.track.orientation, Orientations::Rotations(_)) {
                aligned.logged[row].rotation = recorded.logged[at].rotation;
            }
        }
    }
}

/// Whether the last of `others` and `after` fit as well merged.
fn is_as_good(
    run: &SplitRun,
    both: &OtherSegment,
    others: &[OtherSegment],
    after: &OtherSegment,
) -> bool {
    /// A factor, and a length in m.
    const RESIDUAL_TOLERANCE: f64 = 1.03;
    const RESIDUAL_TOLERANCE_M: f64 = 1e-5;
    let apart = || others.last().into_iter().chain([after]);
    let samples = |other: &OtherSegment| run.samples(other.span) as f64;
    let all: f64 = apart().map(samples).sum();
    let squares: f64 =
        apart().map(|other| samples(other) * residual_m(&other.difference).powi(2)).sum();
    residual_m(&both.difference)
        <= RESIDUAL_TOLERANCE * (squares / all.max(1.0)).sqrt() + RESIDUAL_TOLERANCE_M
}

struct BaselineSegment {
    span: Span,
    found: ArmDiagnosis,
}

/// Any other segment.
struct OtherSegment {
    span: Span,
    /// Diagnosis on its own.
    own: ArmDiagnosis,
    /// Diagnosis after correction by the baseline: only the differences.
    difference: ArmDiagnosis,
}

impl BaselineSegment {
    fn diagnose(run: &SplitRun, span: Span) -> Self {
        Self { span, found: run.diagnose(span).1 }
    }

    /// Merges a segment whose residual exceeds `most_m` with the previous one. `None` if the residual is
    /// then still too large.
    fn other_segments(
        &self,
        run: &SplitRun,
        parts: &[Span],
        most_m: f64,
    ) -> Option<Vec<OtherSegment>> {
        let leaves_little = |other: &OtherSegment| {
            residual_m(&other.difference) <= most_m && self.is_reliable(other)
        };
        let mut others: Vec<OtherSegment> = Vec::new();
        for &part in parts.iter().filter(|part| **part != self.span) {
            let mut other = self.other_segment(run, part);
            if !leaves_little(&other) {
                let before = others.pop_if(|before| before.span.1 == part.0)?;
                other = self.other_segment(run, (before.span.0, part.1));
            }
            let other = Some(other).filter(leaves_little)?;
            // They may differ from the baseline in the same way.
            let before = others.last().filter(|before| before.span.1 == part.0);
            let both = before.map(|before| self.other_segment(run, (before.span.0, part.1)));
            let is_one =
                |both: &OtherSegment| leaves_little(both) && is_as_good(run, both, &others, &other);
            match both.filter(is_one) {
                Some(both) => {
                    others.pop();
                    others.push(both);
                }
                None => others.push(other),
            }
        }
        Some(others)
    }

    fn other_segment(&self, run: &SplitRun, span: Span) -> OtherSegment {
        let (joints, alone) = run.diagnose(span);
        let joints = self.found.joints.corrected_joints(&joints, run.is_prismatic);
        let tracks: Vec<PoseTrack> = (0..run.streams.len())
            .map(|s| {
                let read = decoded_poses(&alone.streams[s]);
                let taken = &self.found.streams[s].frame_correction;
                with_poses(&alone.streams[s], read.map(|pose| taken.apply(&pose)))
            })
            .collect();
        let known: Vec<PoseStream> = run
            .with_tracks(&tracks)
            .into_iter()
            .map(|stream| PoseStream { reference_known: true, ..stream })
            .collect();
        let beyond = diagnose_other_segment(&joints, &known, run.max_lag_s);
        OtherSegment { span, own: alone, difference: beyond }
    }

    /// An undetermined encoding must match the baseline's, and no frame may rotate by much.
    fn is_reliable(&self, other: &OtherSegment) -> bool {
        /// A misread rotation can imitate it in a few configurations.
        const MAX_FRAME_ROTATION_RAD: f64 = 0.1;
        let streams =
            self.found.streams.iter().zip(&other.own.streams).zip(&other.difference.streams);
        streams.into_iter().all(|((own, alone), beyond)| {
            let is_told = alone.encoding.as_ref().is_ok_and(|reading| reading.is_determined);
            let is_little = |frame: &EstimateResult<FrameEstimate>| {
                !is_chosen(frame)
                    || frame
                        .as_ref()
                        .is_ok_and(|frame| frame.rotation_rad.value < MAX_FRAME_ROTATION_RAD)
            };
            let is_little = is_little(&beyond.tool) && is_little(&beyond.reference);
            is_told || (is_same_encoding(own, alone) && is_little)
        })
    }

    fn has_other_encoding(&self, s: usize, other: &OtherSegment) -> bool {
        let (own, its) = (&self.found.streams[s], &other.own.streams[s]);
        let told = own.encoding.is_ok() && its.encoding.as_ref().is_ok_and(|its| its.is_determined);
        told && !is_same_encoding(own, its)
    }

    /// Increase over the baseline's latency extrapolated with its skew, s. `None` if not significant.
    fn latency_increase(&self, s: usize, other: &OtherSegment) -> Option<Measured> {
        /// Smaller steps are left to the latency profile.
        const MIN_LATENCY_STEP_S: f64 = 1e-3;
        const MIN_STD_ERRORS: f64 = 6.0;
        let (here, there) = (&self.found.streams[s], &other.difference.streams[s]);
        let (own, its) = (here.latency_s.as_ref().ok()?, there.latency_s.as_ref().ok()?);
        let apart_s = there.aligned.middle_s() - here.aligned.middle_s();
        let grown = here.skew.as_ref().map_or(own.scaled(0.0), |skew| skew.scaled(apart_s));
        let std_error = its.std_error.hypot(own.std_error).hypot(grown.std_error);
        let by = Measured { value: its.value - own.value - grown.value, std_error, ..*its };
        (by.value.abs() > MIN_LATENCY_STEP_S.max(MIN_STD_ERRORS * std_error)).then_some(by)
    }

    /// `None` if nothing changed.
    fn correct_changes(&self, run: &SplitRun, others: &[OtherSegment]) -> Option<CorrectedRun> {
        let mut joints = run.joints.clone();
        let mut patches = Vec::new();
        for other in others {
            let (from_s, to_s) = other.span;
            let map = joint_map(&self.found.joints, &other.difference.joints, run);
            let own = map.into_iter().map(|(column, factor, offset)| JointPatch {
                column,
                from_s,
                to_s,
                factor,
                offset,
            });
            patches.extend(own);
        }
        patches.iter().for_each(|patch: &JointPatch| patch.apply(&mut joints));
        let tracks: Vec<Option<PoseTrack>> = (0..run.streams.len())
            .map(|s| {
                let moves = |other: &&OtherSegment| {
                    let beyond = &other.difference.streams[s];
                    self.has_other_encoding(s, other)
                        || self.latency_increase(s, other).is_some()
                        || beyond.is_radial_scale_chosen
                        || is_chosen(&beyond.reference)
                        || is_chosen(&beyond.tool)
                };
                others.iter().any(|other| moves(&other)).then(|| self.corrected_track(s, others))
            })
            .collect();
        let is_changed = !patches.is_empty() || tracks.iter().any(Option::is_some);
        is_changed.then_some(CorrectedRun { joints, patches, tracks })
    }

    /// Decoded poses with the differences of the other segments corrected.
    fn corrected_track(&self, s: usize, others: &[OtherSegment]) -> PoseTrack {
        let own = &self.found.streams[s];
        let mut parts = vec![(self.span, with_poses(own, decoded_poses(own)))];
        for other in others {
            let beyond = &other.difference.streams[s];
            let poses = decoded_poses(beyond)
                .map(|pose| own.frame_correction.invert(&beyond.frame_correction.apply(&pose)));
            let mut track = with_poses(beyond, poses);
            let late_s = self.latency_increase(s, other).map_or(0.0, |by| by.value);
            track.t_s.iter_mut().for_each(|t_s| *t_s -= late_s);
            parts.push((other.span, track));
        }
        parts.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let mut parts = parts.into_iter().map(|(_, track)| track);
        let first = parts.next().unwrap_or_else(|| with_poses(own, decoded_poses(own)));
        parts.fold(first, |mut all, part| {
            // Correcting a latency can make segments overlap.
            let end_s = part.t_s.first().copied().unwrap_or(f64::INFINITY);
            let kept = all.t_s.partition_point(|t_s| *t_s < end_s);
            all.t_s.truncate(kept);
            all.xyz.truncate(kept);
            if let Orientations::Rotations(all) = &mut all.orientation {
                all.truncate(kept);
            }
            all.t_s.extend(part.t_s);
            all.xyz.extend(part.xyz);
            if let (Orientations::Rotations(all), Orientations::Rotations(part)) =
                (&mut all.orientation, part.orientation)
            {
                all.extend(part);
            }
            all
        })
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
        let Self { column, from_s, to_s, factor, offset } = *self;
        let dof = joints.dof.max(1);
        let [from, to] = [from_s, to_s].map(|at_s| joints.t_s.partition_point(|t_s| *t_s < at_s));
        for row in from..to {
            let at = row * dof + column;
            joints.q[at] = factor * joints.q[at] + offset;
            joints.qd[at] *= factor;
        }
    }
}

/// Column, factor and offset that map joints of another segment to the baseline. Empty if joint names or
/// units are wrong as well.
fn joint_map(
    kept: &JointDiagnosis,
    beyond: &JointDiagnosis,
    run: &SplitRun,
) -> Vec<(usize, f64, f64)> {
    let is_plain = |found: &JointDiagnosis| {
        found.encoding.as_ref().is_ok_and(|reading| reading.permutation.is_none())
    };
    if !is_plain(beyond) || !is_plain(kept) {
        return Vec::new();
    }
    let dof = run.joints.dof;
    // Corrected by the baseline, then by the other segment.
    let probe = JointTrack {
        t_s: vec![0.0, 1.0],
        dof,
        q: [vec![0.0; dof], vec![1.0; dof]].concat(),
        qd: vec![0.0; 2 * dof],
        noise: Vec::new(),
    };
    let mut once = kept.clone();
    once.patches.clear();
    let by_kept = once.corrected_joints(&probe, run.is_prismatic);
    let by_both = beyond.corrected_joints(&by_kept, run.is_prismatic);
    let map = |column: usize| {
        let at = |row: usize| {
            let at = row * dof + column;
            (by_kept.q[at], by_both.q[at])
        };
        let ((zero, zero_both), (one, one_both)) = (at(0), at(1));
        let factor = one - zero;
        (column, (one_both - zero_both) / factor, (zero_both - zero) / factor)
    };
    let is_other = |&(_, factor, offset): &(usize, f64, f64)| {
        let is_one = (factor - 1.0).abs() < 1e-12 && offset.abs() < 1e-12;
        factor.is_finite() && offset.is_finite() && !is_one
    };
    (0..dof).map(map).filter(is_other).collect()
}

fn is_chosen(frame: &EstimateResult<FrameEstimate>) -> bool {
    frame.as_ref().is_ok_and(|frame| frame.is_chosen)
}

/// Poses in the reference frame, without any other correction.
fn decoded_poses(found: &PoseDiagnosis) -> impl Iterator<Item = Pose> {
    found.aligned.corrected.iter().map(|pose| found.frame_correction.invert(pose))
}

fn with_poses(found: &PoseDiagnosis, poses: impl Iterator<Item = Pose>) -> PoseTrack {
    let (xyz, rotations): (Vec<_>, Vec<_>) =
        poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let orientation = match &found.encoding {
        Ok(_) => Orientations::Rotations(rotations),
        Err(_) => Orientations::Unset(rotations.len()),
    };
    PoseTrack { t_s: found.aligned.t_s.clone(), xyz, orientation, declared: None }
}
