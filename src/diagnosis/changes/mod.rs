//! Change points: a tool slips, the base is moved, a joint loses its zero, or an encoding changes.
//!
//! In such a run, a single model has a residual that no cause explains. A change occurs between two
//! samples, when the stream jumps relative to the arm ([`jumps`]). The run is split there. The longest
//! segment, the baseline, is diagnosed on its own. The other segments are corrected by its result and
//! diagnosed again, so the selected model of each contains only the differences (after Chow 1960). These
//! differences are then corrected, and the whole run is diagnosed as if nothing had changed. The change
//! points are reported only if this reduces the residual substantially.

mod coding;
mod constant;
mod cut;
mod found;
mod jumps;
mod told;
mod weigh;

use super::arm::{diagnose_arm, diagnose_beyond};
use super::bends::without_bends;
use super::proof::beside_fk;
use super::sampling::stream_lag_s;
use super::{
    ArmDiagnosis, EstimateResult, FrameEstimate, JointDiagnosis, PoseDiagnosis, PoseStream,
};
use ground::geometry::Pose;
use ground::stats::Measured;
use ground::stream::{JointTrack, Orientations, PoseTrack};

use coding::same_coding;
pub(super) use constant::constant_frames_suffice;
use cut::{PART_SAMPLES, Span, SplitRun};
pub use found::{ChangePoint, EncodingSpans, FrameChange, JointChange, JointPatch, ScalarChange};
use jumps::{Jump, of_joints};
use weigh::is_worth;
pub(super) use weigh::{gain, jumps_in_time, leaves_much, leaves_slowly, left_m};

/// Maximum residual of a segment, as a multiple of the baseline segment's residual; and a floor for it, m.
const TIMES_LEFT: f64 = 4.0;
const LITTLE_M: f64 = 1e-3;
/// Residuals of two segments whose ratio is below this may have the same noise level.
const NOT_ALIKE: f64 = 2.0;
/// If the baseline segment has at least this fraction of the whole run's residual, change points do not
/// explain it.
const NEARLY_ALL: f64 = 0.97;

/// Diagnoses an arm whose streams or joints change during the run, as if nothing had changed. `found` is
/// the diagnosis of the whole run. Tests at most `most` change points. `None` if there are none or if they
/// do not explain enough of the residual.
pub(super) fn without_changes(
    joints: &JointTrack,
    streams: &[PoseStream],
    slides: &[bool],
    found: &ArmDiagnosis,
    most_lag_s: f64,
    most: usize,
) -> Option<ArmDiagnosis> {
    let jumps = of_joints(joints);
    if jumps.is_empty() && !found.streams.iter().any(leaves_slowly) {
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
    let run = SplitRun { joints, streams, slides, lags: &lags, most_lag_s };
    let mut all = run.moments(found, jumps);
    if all.len() > most {
        all.retain(|jump| jump.over_s == 0.0);
        all.sort_by(|a, b| b.times.total_cmp(&a.times));
        all.truncate(most);
        all.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    }
    // Test jumps between two samples first, then those that need averaging.
    let sharp: Vec<Jump> = all.iter().filter(|jump| jump.over_s == 0.0).copied().collect();
    let is_both = !sharp.is_empty() && sharp.len() < all.len();
    let by_sharp = if is_both { without_jumps(&run, &sharp, found) } else { None };
    match by_sharp {
        Some(after) if !after.streams.iter().any(leaves_slowly) => Some(after),
        by_sharp => match (without_jumps(&run, &all, found), by_sharp) {
            (Some(all), Some(sharp)) if left_m(&sharp) <= left_m(&all) => Some(sharp),
            (all, sharp) => all.or(sharp),
        },
    }
}

/// Diagnoses a run with change points at some of `moments`, as if nothing had changed.
fn without_jumps(run: &SplitRun, moments: &[Jump], found: &ArmDiagnosis) -> Option<ArmDiagnosis> {
    let SplitRun { joints, streams, slides, most_lag_s, .. } = *run;
    let parts = run.parts(moments);
    let kept = (0..parts.len()).max_by_key(|&part| run.samples(parts[part]))?;
    let kept = (parts.len() > 1).then(|| BaselineSegment::of(run, parts[kept]))?;
    let left = left_m(&kept.found);
    if left > NEARLY_ALL * left_m(found) {
        // The baseline segment has the same residual, so it is not due to a change.
        return None;
    }
    let most_m = (TIMES_LEFT * left).max(LITTLE_M).min(left_m(found).max(NOT_ALIKE * left));
    let others = kept.others(run, &parts, most_m)?;
    let mut parts: Vec<Span> = others.iter().map(|other| other.span).chain([kept.span]).collect();
    parts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let undone = kept.undone(run, &others)?;
    let tracks = undone.tracks.iter().zip(streams);
    let changed: Vec<PoseStream> = tracks
        .map(|(track, stream)| PoseStream {
            track: track.as_ref().unwrap_or(stream.track),
            ..*stream
        })
        .collect();
    let mut after = diagnose_arm(&undone.joints, &changed, most_lag_s);
    // Joint compliance persists across change points.
    if let Some(bent) = without_bends(&undone.joints, &changed, slides, &after, most_lag_s) {
        after = bent;
    }
    let weighed = after.clone();
    for (s, after) in after.streams.iter_mut().enumerate() {
        if undone.tracks[s].is_some() {
            kept.read_as(s, &others, after);
        }
    }
    for ((after, track), stream) in after.streams.iter_mut().zip(&undone.tracks).zip(streams) {
        if track.is_some() || !undone.patches.is_empty() {
            as_recorded(joints, stream, after);
        }
    }
    let moment = |at_s: f64| moments.iter().find(|jump| jump.at_s == at_s);
    kept.tell(run, &parts, &others, moment, &mut after);
    after.joints.patches = undone.patches;
    let is_told = !after.joints.changes.is_empty()
        || after.streams.iter().any(|after| after.changes() || jumps_in_time(after));
    (is_told && is_worth(found, &weighed, parameters(&after, parts.len()))).then_some(after)
}

/// Number of parameters that describe the changes in a run with `parts` segments.
fn parameters(after: &ArmDiagnosis, parts: usize) -> usize {
    let of_stream = |found: &PoseDiagnosis| {
        let frames = found.tool_changes.len() + found.reference_changes.len();
        let times = found.course.as_ref().map_or(0, |course| course.jumps.len());
        let EncodingSpans { rotation, degrees, length, axes } = found.coded;
        let coded = [rotation, degrees, length, axes].into_iter().flatten().count();
        6 * frames + found.growth_changes.len() + times + coded
    };
    let of_joints =
        after.joints.changes.iter().map(|change| {
            usize::from(change.zero.is_some()) + usize::from(change.factor.is_some())
        });
    let moments = parts.saturating_sub(1);
    moments + of_joints.sum::<usize>() + after.streams.iter().map(of_stream).sum::<usize>()
}

/// Restores the recorded poses, and FK of the recorded joint states, in the samples of a corrected stream.
pub(super) fn as_recorded(joints: &JointTrack, stream: &PoseStream, after: &mut PoseDiagnosis) {
    let recorded = beside_fk(joints, stream, 0.0);
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

/// Returns whether the last of `others` and `after`, merged, fit as well as each on its own.
fn is_as_good(
    run: &SplitRun,
    both: &OtherSegment,
    others: &[OtherSegment],
    after: &OtherSegment,
) -> bool {
    /// Tolerance: a factor, and a length in m.
    const NEARLY: f64 = 1.03;
    const ARITHMETIC_M: f64 = 1e-5;
    let apart = || others.last().into_iter().chain([after]);
    let samples = |other: &OtherSegment| run.samples(other.span) as f64;
    let all: f64 = apart().map(samples).sum();
    let squares: f64 = apart().map(|other| samples(other) * left_m(&other.beyond).powi(2)).sum();
    left_m(&both.beyond) <= NEARLY * (squares / all.max(1.0)).sqrt() + ARITHMETIC_M
}

/// Baseline segment.
struct BaselineSegment {
    span: Span,
    found: ArmDiagnosis,
}

/// Segment other than the baseline.
struct OtherSegment {
    span: Span,
    /// Diagnosis of the segment on its own.
    alone: ArmDiagnosis,
    /// Diagnosis of the segment after correcting it by the baseline's result. It contains only the
    /// differences.
    beyond: ArmDiagnosis,
}

impl BaselineSegment {
    fn of(run: &SplitRun, span: Span) -> Self {
        Self { span, found: run.diagnose(span).1 }
    }

    /// Diagnoses the other segments. A segment whose residual exceeds `most_m` is merged with the previous
    /// one. `None` if the residual is then still too large.
    fn others(&self, run: &SplitRun, parts: &[Span], most_m: f64) -> Option<Vec<OtherSegment>> {
        let leaves_little =
            |other: &OtherSegment| left_m(&other.beyond) <= most_m && self.is_believed(other);
        let mut others: Vec<OtherSegment> = Vec::new();
        for &part in parts.iter().filter(|part| **part != self.span) {
            let mut other = self.other(run, part);
            if !leaves_little(&other) {
                let before = others.pop_if(|before| before.span.1 == part.0)?;
                other = self.other(run, (before.span.0, part.1));
            }
            let other = Some(other).filter(leaves_little)?;
            // Merge two segments that differ from the baseline in the same way.
            let before = others.last().filter(|before| before.span.1 == part.0);
            let both = before.map(|before| self.other(run, (before.span.0, part.1)));
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

    /// Diagnoses another segment.
    fn other(&self, run: &SplitRun, span: Span) -> OtherSegment {
        let (joints, alone) = run.diagnose(span);
        let joints = self.found.joints.corrected_joints(&joints, run.slides);
        let tracks: Vec<PoseTrack> = (0..run.streams.len())
            .map(|s| {
                let read = as_read(&alone.streams[s]);
                let taken = &self.found.streams[s].frame_correction;
                with_poses(&alone.streams[s], read.map(|pose| taken.apply(&pose)))
            })
            .collect();
        let known: Vec<PoseStream> = run
            .with(&tracks)
            .into_iter()
            .map(|stream| PoseStream { reference_known: true, ..stream })
            .collect();
        let beyond = diagnose_beyond(&joints, &known, run.most_lag_s);
        OtherSegment { span, alone, beyond }
    }

    /// Returns whether the diagnosis of another segment is reliable. If its encoding is undetermined, it
    /// must match the baseline's, and no frame may rotate by much.
    fn is_believed(&self, other: &OtherSegment) -> bool {
        /// Frame rotation that a misread rotation can imitate in a few configurations, rad.
        const MUCH_RAD: f64 = 0.1;
        let streams =
            self.found.streams.iter().zip(&other.alone.streams).zip(&other.beyond.streams);
        streams.into_iter().all(|((own, alone), beyond)| {
            let is_told = alone.reading.as_ref().is_ok_and(|reading| reading.is_told);
            let is_little = |frame: &EstimateResult<FrameEstimate>| {
                !is_chosen(frame)
                    || frame.as_ref().is_ok_and(|frame| frame.rotation_rad.value < MUCH_RAD)
            };
            let is_little = is_little(&beyond.tool) && is_little(&beyond.reference);
            is_told || (same_coding(own, alone) && is_little)
        })
    }

    /// Returns whether the encoding of stream `s` differs in another segment.
    fn is_reread(&self, s: usize, other: &OtherSegment) -> bool {
        let (own, its) = (&self.found.streams[s], &other.alone.streams[s]);
        let told = own.reading.is_ok() && its.reading.as_ref().is_ok_and(|its| its.is_told);
        told && !same_coding(own, its)
    }

    /// Increase of the stream's latency in another segment over the baseline's, extrapolated with its skew,
    /// s. `None` if it is not significant.
    fn later_by(&self, s: usize, other: &OtherSegment) -> Option<Measured> {
        /// Smaller steps are left to the latency profile, s.
        const LEAST_S: f64 = 1e-3;
        const SURE: f64 = 6.0;
        let (here, there) = (&self.found.streams[s], &other.beyond.streams[s]);
        let (own, its) = (here.latency_s.as_ref().ok()?, there.latency_s.as_ref().ok()?);
        let apart_s = there.aligned.middle_s() - here.aligned.middle_s();
        let grown = here.skew.as_ref().map_or(own.scaled(0.0), |skew| skew.scaled(apart_s));
        let std_error = its.std_error.hypot(own.std_error).hypot(grown.std_error);
        let by = Measured { value: its.value - own.value - grown.value, std_error, ..*its };
        (by.value.abs() > LEAST_S.max(SURE * std_error)).then_some(by)
    }

    /// Corrects all changes. `None` if nothing changed.
    fn undone(&self, run: &SplitRun, others: &[OtherSegment]) -> Option<CorrectedRun> {
        let mut joints = run.joints.clone();
        let mut patches = Vec::new();
        for other in others {
            let (from_s, to_s) = other.span;
            let map = joint_map(&self.found.joints, &other.beyond.joints, run);
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
                    let beyond = &other.beyond.streams[s];
                    self.is_reread(s, other)
                        || self.later_by(s, other).is_some()
                        || beyond.growth_chosen
                        || is_chosen(&beyond.reference)
                        || is_chosen(&beyond.tool)
                };
                others.iter().any(|other| moves(&other)).then(|| self.track(s, others))
            })
            .collect();
        let is_changed = !patches.is_empty() || tracks.iter().any(Option::is_some);
        is_changed.then_some(CorrectedRun { joints, patches, tracks })
    }

    /// Decoded poses of a stream, with the differences of the other segments corrected.
    fn track(&self, s: usize, others: &[OtherSegment]) -> PoseTrack {
        let own = &self.found.streams[s];
        let mut parts = vec![(self.span, with_poses(own, as_read(own)))];
        for other in others {
            let beyond = &other.beyond.streams[s];
            let poses = as_read(beyond)
                .map(|pose| own.frame_correction.invert(&beyond.frame_correction.apply(&pose)));
            let mut track = with_poses(beyond, poses);
            let late_s = self.later_by(s, other).map_or(0.0, |by| by.value);
            track.t_s.iter_mut().for_each(|t_s| *t_s -= late_s);
            parts.push((other.span, track));
        }
        parts.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        let mut parts = parts.into_iter().map(|(_, track)| track);
        let first = parts.next().unwrap_or_else(|| with_poses(own, as_read(own)));
        parts.fold(first, |mut all, part| {
            // Correcting a latency can make segments overlap, so drop the overlap.
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

/// Run with its changes corrected.
struct CorrectedRun {
    joints: JointTrack,
    patches: Vec<JointPatch>,
    /// Corrected poses, for the streams that changed.
    tracks: Vec<Option<PoseTrack>>,
}

impl JointPatch {
    /// Maps the joint's positions in this segment to the baseline segment.
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

/// Corrections that map joint positions of another segment to the baseline: column, factor and offset of
/// each joint that differs. Empty if joint names or units are wrong as well.
fn joint_map(
    kept: &JointDiagnosis,
    beyond: &JointDiagnosis,
    run: &SplitRun,
) -> Vec<(usize, f64, f64)> {
    let is_plain = |found: &JointDiagnosis| {
        found.reading.as_ref().is_ok_and(|reading| reading.permutation.is_none())
    };
    if !is_plain(beyond) || !is_plain(kept) {
        return Vec::new();
    }
    let dof = run.joints.dof;
    // Probe every joint at positions 0 and 1: corrected by the baseline, then by the other segment.
    let probe = JointTrack {
        t_s: vec![0.0, 1.0],
        dof,
        q: [vec![0.0; dof], vec![1.0; dof]].concat(),
        qd: vec![0.0; 2 * dof],
        noise: Vec::new(),
    };
    let mut once = kept.clone();
    once.patches.clear();
    let by_kept = once.corrected_joints(&probe, run.slides);
    let by_both = beyond.corrected_joints(&by_kept, run.slides);
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
    frame.as_ref().is_ok_and(|frame| frame.chosen)
}

/// Decoded poses of a stream, in its reference frame, without any other correction.
fn as_read(found: &PoseDiagnosis) -> impl Iterator<Item = Pose> {
    found.aligned.corrected.iter().map(|pose| found.frame_correction.invert(pose))
}

/// Track with the given poses at the stamps of a stream's samples.
fn with_poses(found: &PoseDiagnosis, poses: impl Iterator<Item = Pose>) -> PoseTrack {
    let (xyz, rotations): (Vec<_>, Vec<_>) =
        poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let orientation = match &found.reading {
        Ok(_) => Orientations::Rotations(rotations),
        Err(_) => Orientations::Unset(rotations.len()),
    };
    PoseTrack { t_s: found.aligned.t_s.clone(), xyz, orientation, declared: None }
}
