//! Removal of changes from joint states and poses.
//!
//! The run without the changes is diagnosed again. The changes count only if that explains more of the residuals.

use super::JointPatch;
use super::change::{Change, Subject, value_at};
use super::change_fit::Candidate;
use super::changing_stream::Stream;
use crate::ArmDiagnosis;
use crate::arm_run::ArmRun;
use crate::latency::compensation::with_tracks;
use ground::stream::PoseTrack;

/// Changes, and the run without them.
pub(super) struct Removal {
    pub changes: Vec<Change>,
    /// Per stream, if it is affected.
    pub tracks: Vec<Option<PoseTrack>>,
    pub after: ArmDiagnosis,
}

/// `None` if the unexplained residual does not fall.
pub(super) fn remove(run: &ArmRun, before: &ArmDiagnosis, changes: &[Change]) -> Option<Removal> {
    let none = changes.iter().map(Change::without_amount).collect();
    let tracks = vec![None; run.streams.len()];
    let nothing = Removal { changes: none, tracks, after: before.clone() };
    Some(nothing.with_more(run, before, changes)?.refined(run, before))
}

/// Spans between steps of a joint's zero, or in which it changes linearly.
fn zero_spans(changes: &[Change], column: usize) -> Vec<JointPatch> {
    let subject = Subject::Zero { column };
    let own = changes.iter().filter(|change| change.subject == subject);
    let mut knots: Vec<f64> = own.flat_map(|change| change.profile.knots_s()).collect();
    knots.sort_by(f64::total_cmp);
    let starts = std::iter::once(f64::NEG_INFINITY).chain(knots.iter().copied());
    let ends = knots.iter().copied().chain([f64::INFINITY]);
    let span = |(from_s, to_s): (f64, f64)| {
        // A step at the end belongs to the next span.
        let [offset, last] =
            [from_s, to_s.next_down()].map(|t_s| value_at(changes.iter(), subject, t_s));
        let span_s = to_s - from_s;
        let rate = if span_s.is_finite() && span_s > 0.0 { (last - offset) / span_s } else { 0.0 };
        JointPatch { offset, rate, ..JointPatch::unchanged(column, from_s, to_s) }
    };
    starts.zip(ends).map(span).collect()
}

impl Removal {
    /// `tracks` are without the changes of frames and radial scales.
    pub fn new(
        run: &ArmRun,
        before: &ArmDiagnosis,
        tracks: Vec<Option<PoseTrack>>,
        changes: Vec<Change>,
    ) -> Self {
        // Corrects joint zeros to the first one.
        let spans = (0..run.joints.dof).flat_map(|column| zero_spans(&changes, column));
        let patches: Vec<JointPatch> =
            spans.filter(|span| span.offset != 0.0 || span.rate != 0.0).collect();
        let mut joints = run.joints.clone();
        patches.iter().for_each(|patch| patch.apply(&mut joints));
        let streams = with_tracks(run.streams, &tracks);
        let mut after =
            ArmRun { joints: &joints, streams: &streams, ..*run }.diagnose_again(before);
        after.joints.patches = patches;
        Self { changes, tracks, after }
    }

    /// The changes, larger by `more`.
    fn changes_with(&self, more: &[Change]) -> Vec<Change> {
        let larger = |(change, more): (&Change, &Change)| Change {
            half: &change.half + &more.half,
            ..change.clone()
        };
        self.changes.iter().zip(more).map(larger).collect()
    }

    /// Also removes `more` of each change. `None` if a stream no longer follows FK, or the unexplained residual does not
    /// fall.
    fn with_more(&self, run: &ArmRun, before: &ArmDiagnosis, more: &[Change]) -> Option<Self> {
        let streams = Stream::all(run, &self.after);
        let mut tracks = self.tracks.clone();
        for stream in &streams {
            if more.iter().any(|change| change.subject.stream() == Some(stream.index)) {
                tracks[stream.index] = Some(stream.steady_track(more));
            }
        }
        let mut next = Self::new(run, before, tracks, self.changes_with(more));
        // Positions were divided by the radial scale so far: a tool that becomes longer looks like a scale.
        for Change { subject, columns, half, .. } in &mut next.changes {
            let Subject::Frame { stream, frame } = *subject else { continue };
            let [from, to] = [&self.after, &next.after]
                .map(|it| 1.0 + it.streams[stream].frame_correction.radial_scale);
            let lengths = columns.clone().zip(half.iter_mut());
            let lengths = lengths.filter(|(column, _)| frame.translation().contains(column));
            lengths.for_each(|(_, half)| *half *= from / to);
        }
        let after = Stream::all(run, &next.after);
        let [after_m, last_m] = [&after, &streams]
            .map(|all| all.iter().map(|stream| stream.columns.unexplained_m()).sum::<f64>());
        let explains_more = after.len() >= streams.len() && after_m < last_m;
        explains_more.then_some(next)
    }

    /// Refines the changes: the diagnosis without them shows the part that constant causes had absorbed.
    pub fn refined(mut self, run: &ArmRun, before: &ArmDiagnosis) -> Self {
        const MAX_ROUNDS: usize = 2;
        /// Relative to the changes so far; a larger step needs another diagnosis.
        const MIN_RELATIVE_STEP: f64 = 0.02;
        let norm = |changes: &[Change]| -> f64 {
            changes.iter().map(|change| change.half.norm_squared()).sum::<f64>().sqrt()
        };
        for _ in 0..MAX_ROUNDS {
            let steady = Stream::all(run, &self.after);
            let none = self.changes.iter().map(Change::without_amount).collect();
            let mut more = Candidate::new(none, &steady);
            more.step(&steady);
            let more = more.changes;
            if norm(&more) < MIN_RELATIVE_STEP * norm(&self.changes) {
                self.changes = self.changes_with(&more);
                break;
            }
            let Some(next) = self.with_more(run, before, &more) else { break };
            self = next;
        }
        self
    }
}
