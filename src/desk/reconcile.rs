//! Finds what reconciles pairs of poses: `but = base · axes(is) · tip`.
//!
//! The score adds a penalty for assumptions to the residual, so a simple explanation is preferred.

use super::answer::{AGREES_RAD, Answer, End, Gap, Hypothesis, Residual, Verdict, WouldDo};
use super::error::DeskError;
use super::form::{LOCK_RAD, Reading, SAID_DEFECT, Style, defect, gimbal_margin};
use super::frames::Corrections;
use super::pairs::Pair;
use super::search::{Candidate, Group, HOPELESS, SEARCHED, Search, groups};
use crate::geometry::{Pose, angle_between};

/// Score difference.
const NO_BETTER: f64 = 1.5;

const TOLD: usize = 6;

/// Input of the search.
#[derive(Clone, Debug)]
pub struct Question {
    /// Poses that should agree.
    pub pairs: Vec<Pair>,
    /// Known encoding of one side.
    pub is: Style,
    /// Known encoding of the other side.
    pub but: Style,
    /// Candidate fixed frames.
    pub frames: Corrections,
}

/// Ranks explanations for the pairs of `question`.
///
/// # Errors
/// If there is no pair, or a side is not a pose in its style.
pub fn reconcile(question: &Question) -> Result<Answer, DeskError> {
    let count = question.pairs.len();
    let side = |pasted: &dyn Fn(&Pair) -> &super::Pasted, style: Style| {
        let all: Vec<&super::Pasted> = question.pairs.iter().map(pasted).collect();
        groups(&all, style)
    };
    let is = side(&|pair| &pair.is, question.is)?;
    let but = side(&|pair| &pair.but, question.but)?;
    let mut readings = is.iter().chain(&but).flat_map(|group| &group.readings);
    let has_position = readings.all(|reading| reading.has_position);
    let step = count.div_ceil(SEARCHED);
    let mut search = Search {
        is,
        but,
        frames: &question.frames,
        has_position,
        seen: (0..count).step_by(step.max(1)).collect(),
        best: f64::INFINITY,
        tried: 0,
        found: Vec::new(),
    };
    search.plain();
    search.misread();
    if count > 1 {
        search.fitted();
    }
    let mut answer = search.answer(count);
    if let Some(best) = answer.hypotheses.first() {
        let is = question.pairs.iter().map(|pair| pair.is.numbers.as_slice());
        let but = question.pairs.iter().map(|pair| pair.but.numbers.as_slice());
        let notes = [flaws("A", &best.is, is), flaws("B", &best.but, but)].concat();
        answer.notes.extend(notes);
    }
    Ok(answer)
}

/// Deviation from a rotation, and Euler angles near gimbal lock.
fn flaws<'a>(
    side: &str,
    reading: &Reading,
    numbers: impl Iterator<Item = &'a [f64]> + Clone,
) -> Vec<String> {
    let mut notes = Vec::new();
    let missed = numbers.clone().map(|numbers| defect(reading.form, numbers)).fold(0.0, f64::max);
    if missed > SAID_DEFECT {
        notes.push(format!(
            "{side} deviates from a rotation by {missed:.1e}: rounded, or not a rotation"
        ));
    }
    let margins_rad = numbers.filter_map(|numbers| gimbal_margin(reading, numbers));
    let margin_rad = margins_rad.fold(f64::INFINITY, f64::min);
    if margin_rad < LOCK_RAD {
        notes.push(format!(
            "{side} comes within {:.2}° of gimbal lock of {}: the outer angles are nearly degenerate",
            margin_rad.to_degrees(),
            reading.form
        ));
    }
    notes
}

impl Search<'_> {
    fn answer(mut self, count: usize) -> Answer {
        let found = std::mem::take(&mut self.found);
        let mut found: Vec<Candidate> =
            found.into_iter().filter(|candidate| candidate.score <= self.best + HOPELESS).collect();
        // Stable: of equal candidates, the most common comes first.
        found.sort_by(|a, b| a.score.total_cmp(&b.score));
        let mut told: Vec<Hypothesis> = Vec::new();
        let mut first: Vec<Candidate> = Vec::new();
        for candidate in found {
            let is_alike = |known: &Candidate| self.are_alike(known, &candidate);
            let readings =
                [&self.is[candidate.is].readings[0], &self.but[candidate.but].readings[0]];
            match first.iter().position(is_alike) {
                Some(at) => {
                    let is_same_reading =
                        (first[at].is, first[at].but) == (candidate.is, candidate.but);
                    let known = &mut told[at];
                    match (is_same_reading, candidate.misreading) {
                        (false, None) => known.equivalents.push(readings.map(|reading| *reading)),
                        (true, None) => {
                            let claims = self.hypothesis(&candidate).claims().join("; ");
                            if !claims.is_empty() && claims != known.claims().join("; ") {
                                known.also.push(claims);
                            }
                        }
                        (_, Some(_)) => {}
                    }
                }
                None if told.len() < TOLD => {
                    told.push(self.hypothesis(&candidate));
                    first.push(candidate);
                }
                None => {}
            }
        }
        self.judged(told, count)
    }

    /// Same transformation, and same numbers or an encoding with the same residual.
    fn are_alike(&self, known: &Candidate, other: &Candidate) -> bool {
        if known.misreading.is_some() != other.misreading.is_some()
            || !known.steps.are(&other.steps, self.frames)
        {
            return false;
        }
        let left = (known.residual.rotation_rad - other.residual.rotation_rad).abs();
        let left_m = known.residual.position_m.zip(other.residual.position_m);
        left < 1e-6 && left_m.is_none_or(|(a, b)| (a - b).abs() < 1e-6)
    }

    fn hypothesis(&self, candidate: &Candidate) -> Hypothesis {
        let [is, but] = [&self.is[candidate.is], &self.but[candidate.but]];
        let mut equivalents: Vec<[Reading; 2]> = Vec::new();
        equivalents.extend(is.readings[1..].iter().map(|other| [*other, but.readings[0]]));
        equivalents.extend(but.readings[1..].iter().map(|other| [is.readings[0], *other]));
        let mut hypothesis = Hypothesis {
            is: is.readings[0],
            but: but.readings[0],
            inversion: candidate.steps.inversion,
            axes: candidate.steps.axes,
            base: candidate.steps.base.end(&self.frames.base),
            tip: candidate.steps.tip.end(&self.frames.tip),
            misreading: candidate.misreading,
            residual: candidate.residual,
            score: candidate.score,
            equivalents,
            also: Vec::new(),
        };
        if candidate.misreading.is_none() {
            let sides = is.poses.iter().zip(&but.poses);
            let gap = |(is, but): (&Pose, &Pose)| Gap::between(&hypothesis.expected(is), but);
            let gaps: Vec<Gap> = sides.map(gap).collect();
            hypothesis.residual = Residual::of(&gaps, self.has_position);
        }
        hypothesis
    }

    fn judged(&self, hypotheses: Vec<Hypothesis>, count: usize) -> Answer {
        let best = hypotheses.first();
        let explained = best.is_some_and(|best| best.residual.agrees());
        let is_as_good = |other: &&Hypothesis| {
            other.residual.agrees() && best.is_some_and(|best| other.score < best.score + NO_BETTER)
        };
        let as_good = if explained { hypotheses.iter().filter(is_as_good).count() } else { 0 };
        let is_alone = as_good == 1 && best.is_some_and(Hypothesis::tells_the_change);
        let verdict = match (explained, is_alone) {
            (false, _) => Verdict::Open,
            (true, true) => Verdict::Reconciled,
            (true, false) => Verdict::Ambiguous,
        };
        let would_do = best.filter(|best| count == 1 && !best.residual.agrees()).and_then(|best| {
            let [is, but] = [self.pose_of(&self.is, best.is)?, self.pose_of(&self.but, best.but)?];
            let expected = best.expected(&is);
            let is_translation = best.residual.rotation_rad <= AGREES_RAD;
            let [tool, base] = [expected.inverse() * but, but * expected.inverse()];
            Some(WouldDo { tool, base, is_translation })
        });
        let by_chance = best.filter(|_| count == 1).map(|best| {
            // Share of all rotations within an angle: (θ − sin θ) / π.
            let angle = best.residual.rotation_rad.max(0.2_f64.to_radians());
            self.tried as f64 * (angle - angle.sin()) / std::f64::consts::PI
        });
        let mut notes = Vec::new();
        let is_fitted = |best: &Hypothesis| match (&best.base, &best.tip) {
            (End::Fitted(_), End::Fitted(_)) => false,
            (base, tip) => [base, tip].into_iter().any(|end| matches!(end, End::Fitted(_))),
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
        Answer { verdict, hypotheses, as_good, would_do, tried: self.tried, by_chance, notes }
    }

    fn pose_of(&self, side: &[Group], reading: Reading) -> Option<Pose> {
        let group = side.iter().find(|group| group.readings.contains(&reading))?;
        group.poses.first().copied()
    }

    /// Largest angle to the first pose.
    fn spread_rad(&self) -> Option<f64> {
        let poses = &self.is.first()?.poses;
        let first = poses.first()?;
        let angles = poses.iter().map(|pose| angle_between(&first.rotation, &pose.rotation));
        Some(angles.fold(0.0, f64::max))
    }
}
