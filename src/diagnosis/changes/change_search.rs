//! Search for the likeliest changes.
//!
//! Several searches add one change after another, each among other kinds of changes. Their results compete by their
//! likelihood, with the same weights for all. Changes that later ones make needless are removed.

use super::change::{Change, Subject};
use super::change_fit::{Candidate, Equations, Weights};
use super::changing_stream::Stream;
use super::jumps::{Jump, jumps_in_joints, jumps_in_logged_path};
use super::profile::Profile;
use super::score_test::{ChangeKind, ScoreTest};
use crate::ArmDiagnosis;
use crate::arm_run::ArmRun;
use crate::priors::LEVER_M;
use crate::residuals::comparison::has_slow_residual;
use crate::solver::linear::{Linear, StreamEquations, Weight};
use ground::stats::{highest, lowest};
use ground::stream::encoder_tick;

/// `None` if no change is likely.
pub(super) fn likeliest_changes(run: &ArmRun, diagnosis: &ArmDiagnosis) -> Option<Vec<Change>> {
    let streams = Stream::all(run, diagnosis);
    if !streams.iter().any(|stream| has_slow_residual(stream.found)) {
        return None;
    }
    let jumps = RecordedJumps::new(run);
    let mut found = Vec::new();
    let none = Candidate::new(Vec::new(), &streams);
    search(&streams, &jumps, none, &ChangeKind::ALL, &mut found);
    found.retain(|(it, _)| !it.changes.iter().any(|change| jumps.is_rounding(change)));
    // With its own noise, a candidate with a correlated residual would score less than a candidate with a larger white
    // residual.
    let weights = found.iter().map(|(_, weights)| weights);
    let noise = lowest(weights, |it| sigma_m(it))?.clone();
    let candidates = found.into_iter().map(|(candidate, _)| candidate);
    let mut changed = highest(candidates, |it| it.score(&streams, &noise))?;
    while let Some(fewer) = changed.reduced(&streams, &noise) {
        changed = fewer;
    }
    if let Some(other) = changed.with_tools(&streams)
        && other.score(&streams, &noise) > changed.score(&streams, &noise)
    {
        changed = other;
    }
    (!changed.changes.is_empty()).then_some(changed.changes)
}

/// Adds `current` to `found`, then the same with the likeliest change of each of these kinds, until none is likely. Kinds with
/// the same changes share their fit. The search uses the noise within tenths of the run, because the residual still contains
/// the other changes.
fn search(
    streams: &[Stream],
    jumps: &RecordedJumps,
    current: Candidate,
    kinds: &[ChangeKind],
    found: &mut Vec<(Candidate, Weights)>,
) {
    const MAX_CHANGES: usize = 4;
    let steady = current.steady(streams);
    let equations = Equations::new(&steady, &current.changes, None);
    let can_grow = current.changes.len() < MAX_CHANGES * streams.len();
    let pairs = steady.iter().zip(&equations.shared.streams).filter(|_| can_grow);
    let next = |(stream, equations): (&Stream, &StreamEquations)| {
        stream.next_changes(&current.changes, &equations.linear, kinds)
    };
    let by_stream: Vec<Vec<Option<(Change, f64)>>> = pairs.filter_map(next).collect();
    let mut grown: Vec<(Candidate, Vec<ChangeKind>)> = Vec::new();
    for (at, kind) in kinds.iter().enumerate() {
        let all = by_stream.iter().filter_map(|of_kinds| of_kinds[at].clone());
        let Some((mut next, _)) = highest(all, |next| next.1) else { continue };
        let is_recorded = jumps.date(&mut next);
        // The joint states show a lost zero, and not a turn of the tool.
        let is_last = |stream: &Stream| {
            stream.seen(&next).is_none_or(|it| it.columns.start == stream.columns.last_zero())
        };
        if !is_recorded && next.subject.stream().is_none() && streams.iter().all(is_last) {
            continue;
        }
        let mut with_next = current.clone();
        with_next.changes.push(next);
        match grown.iter_mut().find(|(known, _)| known.has_changes_of(&with_next)) {
            Some((_, kinds)) => kinds.push(*kind),
            None => grown.push((with_next, vec![*kind])),
        }
    }
    let weights = current.weights(&steady, equations);
    found.push((current, weights));
    drop(steady);
    for (with_next, kinds) in grown {
        search(streams, jumps, with_next.fitted(streams), &kinds, found);
    }
}

/// Of all residuals, m. Angles are weighted by 0.3 m.
fn sigma_m(weights: &Weights) -> f64 {
    let of_stream = |own: &Vec<Weight>| own[0].noise.sigma.hypot(LEVER_M * own[1].noise.sigma);
    weights.iter().map(of_stream).sum()
}

impl Stream<'_> {
    /// The likeliest change of each kind in addition to these, with its score. `None` without one, or if another change, such
    /// as one of the latency, is likelier.
    fn next_changes(
        &self,
        changes: &[Change],
        linear: &Linear,
        kinds: &[ChangeKind],
    ) -> Option<Vec<Option<(Change, f64)>>> {
        if !has_slow_residual(self.found) {
            return None;
        }
        let seen = self.all_seen(changes);
        let weights = self.columns.local_weights(linear);
        let test = ScoreTest::new(&self.columns, linear, &weights)?;
        let next = |kind: &ChangeKind| {
            let (mut profile, mut columns, mut score) = test.likeliest_change(&seen, *kind)?;
            if kind.with_drifts {
                // The residual after this change has the weights that resolve its shape.
                let beside =
                    self.columns.linearize(&[self.variable(&columns, |t_s| profile.factor(t_s))]);
                let weights = self.columns.local_weights(&beside);
                let test = ScoreTest::new(&self.columns, linear, &weights)?;
                (profile, columns, score) = test.likeliest_change(&seen, *kind)?;
            }
            Some((self.change(profile, columns)?, score))
        };
        Some(kinds.iter().map(next).collect())
    }
}

/// Jumps of the recorded numbers, of the joint states and of each stream.
struct RecordedJumps {
    of_joints: Vec<Jump>,
    of_streams: Vec<Vec<Jump>>,
    /// Tick of each joint's encoder; 0 if it is too small to show.
    ticks: Vec<f64>,
}

impl RecordedJumps {
    fn new(run: &ArmRun) -> Self {
        /// Of numbers with seven digits.
        const ROUNDING_RAD: f64 = 1e-6;
        let joints = run.joints;
        let tick = |column: usize| {
            let q = |row: usize| joints.row(row)[column];
            let distance = |a: usize, b: usize| (q(a) - q(b)).abs();
            encoder_tick(joints.len(), distance, ROUNDING_RAD).unwrap_or(0.0)
        };
        let of_stream = |stream| jumps_in_logged_path(run.joints, stream);
        Self {
            of_joints: jumps_in_joints(run.joints),
            of_streams: run.streams.iter().map(of_stream).collect(),
            ticks: (0..run.joints.dof).map(tick).collect(),
        }
    }

    /// Whether a change is rounding: positions at rest keep their error, which differs by up to a tick.
    fn is_rounding(&self, change: &Change) -> bool {
        matches!(change.subject, Subject::Zero { column } if 2.0 * change.half[0].abs() < self.ticks[column])
    }

    /// Dates a step by the jump in its interval. If it is dated late, a few samples keep its whole error. Whether there is a jump.
    fn date(&self, Change { subject, profile, .. }: &mut Change) -> bool {
        let Profile::Step(step) = profile else { return false };
        let jumps = subject.stream().map_or(&self.of_joints, |stream| &self.of_streams[stream]);
        let within = jumps.iter().filter(|jump| jump.overlaps(step));
        let strongest = highest(within, |jump| jump.strength);
        if let Some(&Jump { at_s, within_s, .. }) = strongest {
            *step = Jump { at_s, within_s, ..*step };
        }
        strongest.is_some()
    }
}
