//! Finds what reconciles pairs of poses: `but = base · axes(is) · tip`.
//!
//! The score adds a penalty for assumptions to the residual, so a simple explanation is preferred.

use super::encoding::{
    GIMBAL_LOCK_RAD, KnownEncoding, MIN_NOTED_DEFECT, NumberEncoding, gimbal_margin,
    rotation_defect,
};
use super::error::DeskError;
use super::fixed_frames::FrameCandidates;
use super::pairs::Pair;
use super::reconciliation::{
    EndTransform, Hypothesis, MAX_AGREEING_RAD, PoseDifference, ReconcileVerdict, Reconciliation,
    Residual, SinglePairOffsets,
};
use super::search::{
    EncodingGroup, MAX_SCORE_ABOVE_BEST, MAX_SEARCHED_PAIRS, Search, SearchCandidate,
    group_encodings,
};
use crate::geometry::{Pose, angle_between};

/// Score difference.
const MIN_SCORE_LEAD: f64 = 1.5;

const MAX_LISTED: usize = 6;

/// Input of the search.
#[derive(Clone, Debug)]
pub struct ReconcileInput {
    /// Poses that should agree.
    pub pairs: Vec<Pair>,
    /// Known encoding of one side.
    pub encoding_a: KnownEncoding,
    /// Known encoding of the other side.
    pub encoding_b: KnownEncoding,
    /// Candidate fixed frames.
    pub frames: FrameCandidates,
}

/// Ranks explanations for the pairs of `question`.
///
/// # Errors
/// If there is no pair, or a side is not a pose in its style.
pub fn reconcile(question: &ReconcileInput) -> Result<Reconciliation, DeskError> {
    let count = question.pairs.len();
    let side = |pose_text: &dyn Fn(&Pair) -> &super::PoseText, known: KnownEncoding| {
        let all: Vec<&super::PoseText> = question.pairs.iter().map(pose_text).collect();
        group_encodings(&all, known)
    };
    let is = side(&|pair| &pair.pose_a, question.encoding_a)?;
    let but = side(&|pair| &pair.pose_b, question.encoding_b)?;
    let mut encodings = is.iter().chain(&but).flat_map(|group| &group.encodings);
    let has_position = encodings.all(|encoding| encoding.has_position);
    let step = count.div_ceil(MAX_SEARCHED_PAIRS);
    let mut search = Search {
        side_a: is,
        side_b: but,
        frames: &question.frames,
        has_position,
        searched_pairs: (0..count).step_by(step.max(1)).collect(),
        best: f64::INFINITY,
        tried: 0,
        found: Vec::new(),
    };
    search.search_frames_and_axes();
    search.search_misinterpretations();
    if count > 1 {
        search.search_fitted_offsets();
    }
    let mut answer = search.summarize(count);
    if let Some(best) = answer.hypotheses.first() {
        let is = question.pairs.iter().map(|pair| pair.pose_a.numbers.as_slice());
        let but = question.pairs.iter().map(|pair| pair.pose_b.numbers.as_slice());
        let notes = [
            encoding_warnings("A", &best.encoding_a, is),
            encoding_warnings("B", &best.encoding_b, but),
        ]
        .concat();
        answer.notes.extend(notes);
    }
    Ok(answer)
}

/// Deviation from a rotation, and Euler angles near gimbal lock.
fn encoding_warnings<'a>(
    side: &str,
    encoding: &NumberEncoding,
    numbers: impl Iterator<Item = &'a [f64]> + Clone,
) -> Vec<String> {
    let mut notes = Vec::new();
    let missed = numbers
        .clone()
        .map(|numbers| rotation_defect(encoding.rotation, numbers))
        .fold(0.0, f64::max);
    if missed > MIN_NOTED_DEFECT {
        notes.push(format!(
            "{side} deviates from a rotation by {missed:.1e}: rounded, or not a rotation"
        ));
    }
    let margins_rad = numbers.filter_map(|numbers| gimbal_margin(encoding, numbers));
    let margin_rad = margins_rad.fold(f64::INFINITY, f64::min);
    if margin_rad < GIMBAL_LOCK_RAD {
        notes.push(format!(
            "{side} comes within {:.2}° of gimbal lock of {}: the outer angles are nearly degenerate",
            margin_rad.to_degrees(),
            encoding.rotation
        ));
    }
    notes
}

impl Search<'_> {
    fn summarize(mut self, count: usize) -> Reconciliation {
        let found = std::mem::take(&mut self.found);
        let mut found: Vec<SearchCandidate> = found
            .into_iter()
            .filter(|candidate| candidate.score <= self.best + MAX_SCORE_ABOVE_BEST)
            .collect();
        // Stable: of equal candidates, the most common comes first.
        found.sort_by(|a, b| a.score.total_cmp(&b.score));
        let mut listed: Vec<Hypothesis> = Vec::new();
        let mut first: Vec<SearchCandidate> = Vec::new();
        for candidate in found {
            let is_alike = |known: &SearchCandidate| self.are_equivalent(known, &candidate);
            let encodings = [
                &self.side_a[candidate.index_a].encodings[0],
                &self.side_b[candidate.index_b].encodings[0],
            ];
            match first.iter().position(is_alike) {
                Some(at) => {
                    let is_same_reading = (first[at].index_a, first[at].index_b)
                        == (candidate.index_a, candidate.index_b);
                    let known = &mut listed[at];
                    match (is_same_reading, candidate.misinterpretation) {
                        (false, None) => {
                            known.equivalents.push(encodings.map(|encoding| *encoding))
                        }
                        (true, None) => {
                            let claims = self.hypothesis(&candidate).claims().join("; ");
                            if !claims.is_empty() && claims != known.claims().join("; ") {
                                known.also.push(claims);
                            }
                        }
                        (_, Some(_)) => {}
                    }
                }
                None if listed.len() < MAX_LISTED => {
                    listed.push(self.hypothesis(&candidate));
                    first.push(candidate);
                }
                None => {}
            }
        }
        self.judge_hypotheses(listed, count)
    }

    /// Same transformation, and same numbers or an encoding with the same residual.
    fn are_equivalent(&self, known: &SearchCandidate, other: &SearchCandidate) -> bool {
        if known.misinterpretation.is_some() != other.misinterpretation.is_some()
            || !known.steps.is_equivalent(&other.steps, self.frames)
        {
            return false;
        }
        let difference_rad = (known.residual.rotation_rad - other.residual.rotation_rad).abs();
        let difference_m = known.residual.position_m.zip(other.residual.position_m);
        difference_rad < 1e-6 && difference_m.is_none_or(|(a, b)| (a - b).abs() < 1e-6)
    }

    fn hypothesis(&self, candidate: &SearchCandidate) -> Hypothesis {
        let [is, but] = [&self.side_a[candidate.index_a], &self.side_b[candidate.index_b]];
        let mut equivalents: Vec<[NumberEncoding; 2]> = Vec::new();
        equivalents.extend(is.encodings[1..].iter().map(|other| [*other, but.encodings[0]]));
        equivalents.extend(but.encodings[1..].iter().map(|other| [is.encodings[0], *other]));
        let mut hypothesis = Hypothesis {
            encoding_a: is.encodings[0],
            encoding_b: but.encodings[0],
            inversion: candidate.steps.inversion,
            axes: candidate.steps.axes,
            base: candidate.steps.base.end_transform(&self.frames.base),
            tip: candidate.steps.tip.end_transform(&self.frames.tip),
            misinterpretation: candidate.misinterpretation,
            residual: candidate.residual,
            score: candidate.score,
            equivalents,
            also: Vec::new(),
        };
        if candidate.misinterpretation.is_none() {
            let sides = is.poses.iter().zip(&but.poses);
            let difference =
                |(is, but): (&Pose, &Pose)| PoseDifference::between(&hypothesis.expected(is), but);
            let differences: Vec<PoseDifference> = sides.map(difference).collect();
            hypothesis.residual = Residual::from_differences(&differences, self.has_position);
        }
        hypothesis
    }

    fn judge_hypotheses(&self, hypotheses: Vec<Hypothesis>, count: usize) -> Reconciliation {
        let best = hypotheses.first();
        let explained = best.is_some_and(|best| best.residual.is_agreement());
        let is_as_good = |other: &&Hypothesis| {
            other.residual.is_agreement()
                && best.is_some_and(|best| other.score < best.score + MIN_SCORE_LEAD)
        };
        let equally_good = if explained { hypotheses.iter().filter(is_as_good).count() } else { 0 };
        let is_alone = equally_good == 1 && best.is_some_and(Hypothesis::determines_difference);
        let verdict = match (explained, is_alone) {
            (false, _) => ReconcileVerdict::Unexplained,
            (true, true) => ReconcileVerdict::Reconciled,
            (true, false) => ReconcileVerdict::Ambiguous,
        };
        let offsets =
            best.filter(|best| count == 1 && !best.residual.is_agreement()).and_then(|best| {
                let [is, but] = [
                    self.pose_of(&self.side_a, best.encoding_a)?,
                    self.pose_of(&self.side_b, best.encoding_b)?,
                ];
                let expected = best.expected(&is);
                let is_translation = best.residual.rotation_rad <= MAX_AGREEING_RAD;
                let [tool, base] = [expected.inverse() * but, but * expected.inverse()];
                Some(SinglePairOffsets { tool, base, is_translation })
            });
        let expected_by_chance = best.filter(|_| count == 1).map(|best| {
            // Share of all rotations within an angle: (θ − sin θ) / π.
            let angle = best.residual.rotation_rad.max(0.2_f64.to_radians());
            self.tried as f64 * (angle - angle.sin()) / std::f64::consts::PI
        });
        let mut notes = Vec::new();
        let is_fitted = |best: &Hypothesis| match (&best.base, &best.tip) {
            (EndTransform::Fitted(_), EndTransform::Fitted(_)) => false,
            (base, tip) => {
                [base, tip].into_iter().any(|end| matches!(end, EndTransform::Fitted(_)))
            }
        };
        if best.is_some_and(is_fitted)
            && let Some(spread_rad) = self.spread_rad()
            && spread_rad < 10_f64.to_radians()
        {
            notes.push(format!(
                "the orientations differ by only {:.1}°: a tool offset and a base offset cannot be \
                 distinguished",
                spread_rad.to_degrees()
            ));
        }
        Reconciliation {
            verdict,
            hypotheses,
            equally_good,
            single_pair_offsets: offsets,
            tried: self.tried,
            expected_by_chance,
            notes,
        }
    }

    fn pose_of(&self, side: &[EncodingGroup], encoding: NumberEncoding) -> Option<Pose> {
        let group = side.iter().find(|group| group.encodings.contains(&encoding))?;
        group.poses.first().copied()
    }

    /// Largest angle to the first pose.
    fn spread_rad(&self) -> Option<f64> {
        let poses = &self.side_a.first()?.poses;
        let first = poses.first()?;
        let angles = poses.iter().map(|pose| angle_between(&first.rotation, &pose.rotation));
        Some(angles.fold(0.0, f64::max))
    }
}
