//! What makes pairs of poses agree.
//!
//! Every reading of the one side against every reading of the other, over inversions and fixed frames:
//! `but = base · is · tip`. What is left is judged together with how much was assumed, so that a simple
//! explanation wins over a longer one that leaves about as much.

use crate::geometry::{
    Coding, Misreading, Pose, Rotation, Vec3, angle_between, misreading_classes,
    rotation_from_rotvec, rotvec_from_rotation, xyz_of,
};

use super::error::DeskError;
use super::form::{
    LOCK_RAD, Reading, SAID_DEFECT, Style, defect, gimbal_margin, has_position, readings,
};
use super::frames::{Corrections, FixedFrame};
use super::pairs::Pair;

/// What rounding and a nominal model may leave of poses that agree: rad and m.
const AGREES_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
const AGREES_M: f64 = 0.010;

/// Differences of this size, rad and m, count as one step; a third of it as none.
const STEP_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const STEP_M: f64 = 0.005;
const NO_STEP: f64 = 0.3;

// What an explanation pays for each thing that it assumes, in halvings of what is left.
const PER_RANK: f64 = 0.25;
const ODD_UNIT: f64 = 3.0;
const FRAME: f64 = 1.5;
const AGAINST_NAMES: f64 = 1.5;
const INVERSE: f64 = 2.0;
const TRANSPOSE: f64 = 2.5;
const MISREADING: f64 = 2.5;
const FITTED_TOOL: f64 = 3.0;

/// By less than this an explanation is no better than another.
const NO_BETTER: f64 = 1.5;

/// Explanations that are this much worse than the best so far are dropped.
const HOPELESS: f64 = 8.0;

/// With several pairs, what turns the first this far off, rad, is dropped.
const HOPELESS_RAD: f64 = 0.6;

/// How many pairs the search looks at; what is left is computed over all.
const SEARCHED: usize = 32;

/// How many explanations are kept while others are tried.
const KEPT: usize = 4096;

/// How many explanations are told.
const TOLD: usize = 6;

/// Poses by less than this apart, m and rad, are one.
const SAME: f64 = 1e-9;

/// What is asked.
#[derive(Clone, Debug)]
pub struct Question {
    /// Poses that should agree, at least one pair.
    pub pairs: Vec<Pair>,
    /// What the call says of the one side.
    pub is: Style,
    /// What the call says of the other.
    pub but: Style,
    /// The fixed frames that may lie between them.
    pub frames: Corrections,
}

/// Which of a pose is turned round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inversion {
    /// Nothing.
    None,
    /// The whole pose: parent and child are swapped.
    Pose,
    /// The rotation alone: it is transposed.
    Rotation,
}

impl Inversion {
    const ALL: [Self; 3] = [Self::None, Self::Pose, Self::Rotation];

    fn of(self, pose: &Pose) -> Pose {
        match self {
            Self::None => *pose,
            Self::Pose => pose.inverse(),
            Self::Rotation => Pose::from_parts(pose.translation, pose.rotation.inverse()),
        }
    }

    fn cost(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Pose => INVERSE,
            Self::Rotation => TRANSPOSE,
        }
    }
}

/// What lies between the two poses at the tip.
#[derive(Clone, Debug, PartialEq)]
pub enum Tool {
    /// Nothing.
    None,
    /// Frames that are fixed to each other on known arms.
    Frames(FixedFrame),
    /// A constant `is_from_but`, fitted to several pairs.
    Fitted(Pose),
}

/// What an explanation leaves, over all pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// The angle, rms, rad.
    pub rotation_rad: f64,
    /// The largest angle, rad.
    pub worst_rotation_rad: f64,
    /// The distance, rms, m; none where a side has no positions.
    pub position_m: Option<f64>,
    /// The largest distance, m.
    pub worst_position_m: Option<f64>,
}

impl Residual {
    /// Whether it is no more than rounding and a nominal model leave: 1° and 10 mm.
    pub fn agrees(&self) -> bool {
        self.rotation_rad <= AGREES_RAD && self.position_m.is_none_or(|m| m <= AGREES_M)
    }

    fn of(gaps: &[Gap], has_position: bool) -> Self {
        let mean = |square: &dyn Fn(&Gap) -> f64| {
            (gaps.iter().map(square).sum::<f64>() / gaps.len() as f64).sqrt()
        };
        let worst = |of: &dyn Fn(&Gap) -> f64| gaps.iter().map(of).fold(0.0, f64::max);
        Self {
            rotation_rad: mean(&|gap| gap.rad * gap.rad),
            worst_rotation_rad: worst(&|gap| gap.rad),
            position_m: has_position.then(|| mean(&|gap| gap.m * gap.m)),
            worst_position_m: has_position.then(|| worst(&|gap| gap.m)),
        }
    }

    /// Its size in doublings.
    fn size(&self) -> f64 {
        let doublings = |amount: f64, step: f64| (NO_STEP + amount / step).log2();
        doublings(self.rotation_rad, STEP_RAD)
            + self.position_m.map_or(0.0, |m| doublings(m, STEP_M))
    }
}

#[derive(Clone, Copy)]
struct Gap {
    rad: f64,
    m: f64,
}

impl Gap {
    fn between(a: &Pose, b: &Pose) -> Self {
        Self {
            rad: angle_between(&a.rotation, &b.rotation),
            m: (a.translation.vector - b.translation.vector).norm(),
        }
    }
}

/// A tool that would close what is left of one pair, which no one pair can confirm.
#[derive(Clone, Debug, PartialEq)]
pub struct WouldDo {
    /// `is_from_but` after the explanation's own steps.
    pub tool: Pose,
    /// Whether it is a translation alone, the rotations being explained.
    pub is_translation: bool,
}

/// An explanation of the difference.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// How the one side is read.
    pub is: Reading,
    /// How the other side is read.
    pub but: Reading,
    /// What of the one side is turned round first.
    pub inversion: Inversion,
    /// The frames at the base.
    pub base: Option<FixedFrame>,
    /// The frames at the tip.
    pub tool: Tool,
    /// Three numbers that were read in two ways on the way to the two poses.
    pub misreading: Option<Misreading>,
    /// What is left.
    pub residual: Residual,
    /// What is left and what was assumed, in doublings; the lower the better.
    pub score: f64,
    /// Other readings that leave as much.
    pub equivalents: Vec<[Reading; 2]>,
}

impl Hypothesis {
    /// What it says, a clause each.
    pub fn claims(&self) -> Vec<String> {
        let mut claims = Vec::new();
        if let Some(Misreading { is, read_as }) = self.misreading {
            claims.push(format!(
                "three numbers that were taken as {is} in `is` were taken as {read_as} in `but`"
            ));
        }
        match self.inversion {
            Inversion::None => {}
            Inversion::Pose => claims
                .push("one is the inverse of the other: parent and child are swapped".to_owned()),
            Inversion::Rotation => {
                claims.push("the rotation of one is the transpose of the other's".to_owned())
            }
        }
        if let Some(base) = &self.base {
            claims.push(match base.is_either_way() {
                true => format!("one is in {}, the other in {} ({})", base.is, base.but, base.arms),
                false => format!("`is` is in {}, `but` in {} ({})", base.is, base.but, base.arms),
            });
        }
        match &self.tool {
            Tool::None => {}
            Tool::Frames(tip) if tip.is_either_way() => {
                claims
                    .push(format!("one is of {}, the other of {} ({})", tip.is, tip.but, tip.arms));
            }
            Tool::Frames(tip) => {
                claims.push(format!("`is` is of {}, `but` of {} ({})", tip.is, tip.but, tip.arms));
            }
            Tool::Fitted(_) => claims.push("a constant tool lies between them".to_owned()),
        }
        claims
    }
}

/// How far the pairs are explained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The first explanation leaves no more than rounding and a nominal model, and no other is as good.
    Reconciled,
    /// Several do, or one does with several conventions.
    Ambiguous,
    /// None does.
    Open,
}

/// What reconciles the pairs.
#[derive(Clone, Debug)]
pub struct Answer {
    /// How far they are explained.
    pub verdict: Verdict,
    /// Explanations, the best first.
    pub hypotheses: Vec<Hypothesis>,
    /// How many of them are as good as the first, with it; zero where none explains the pairs.
    pub as_good: usize,
    /// A tool that would close what the first leaves of a single pair.
    pub would_do: Option<WouldDo>,
    /// How many ways to read the two rotations were tried.
    pub tried: usize,
    /// How many of as many random rotations would come as close, on average; of a single pair.
    pub by_chance: Option<f64>,
    /// What to look out for.
    pub notes: Vec<String>,
}

/// Readings of one side that are the same poses.
struct Group {
    readings: Vec<Reading>,
    poses: Vec<Pose>,
    cost: f64,
}

impl Group {
    /// Whether both are in millimetres, or in degrees, against the size of their numbers: that makes
    /// every difference small and explains none.
    fn is_odd_with(&self, other: &Self) -> bool {
        let [a, b] = [&self.readings[0], &other.readings[0]];
        (a.has_odd_length && b.has_odd_length) || (a.has_odd_angle && b.has_odd_angle)
    }
}

/// An explanation as numbers, before it is told.
#[derive(Clone, Copy)]
struct Candidate {
    is: usize,
    but: usize,
    inversion: Inversion,
    /// 0 for none, else one more than the place in the list.
    base: usize,
    tip: usize,
    fitted: Option<Pose>,
    misreading: Option<Misreading>,
    residual: Residual,
    score: f64,
}

struct Search<'a> {
    is: Vec<Group>,
    but: Vec<Group>,
    frames: &'a Corrections,
    has_position: bool,
    /// The pairs that are looked at.
    seen: Vec<usize>,
    best: f64,
    tried: usize,
    found: Vec<Candidate>,
}

/// Ranks what makes the pairs of `question` agree.
///
/// # Errors
/// Where there is no pair, or a side is no pose in its style.
pub fn reconcile(question: &Question) -> Result<Answer, DeskError> {
    let count = question.pairs.len();
    let side = |pasted: &dyn Fn(&Pair) -> &super::Pasted, style: Style| {
        let all: Vec<&super::Pasted> = question.pairs.iter().map(pasted).collect();
        groups(&all, style)
    };
    let is = side(&|pair| &pair.is, question.is)?;
    let but = side(&|pair| &pair.but, question.but)?;
    let has_position = question
        .pairs
        .iter()
        .all(|pair| has_position(pair.is.numbers.len()) && has_position(pair.but.numbers.len()));
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
        let mut notes = Vec::new();
        for (side, reading) in [("is", best.is), ("but", best.but)] {
            let numbers = question.pairs.iter().map(|pair| match side {
                "is" => pair.is.numbers.as_slice(),
                _ => pair.but.numbers.as_slice(),
            });
            notes.extend(flaws(side, &reading, numbers));
        }
        answer.notes.extend(notes);
    }
    Ok(answer)
}

/// What of the numbers of a side blurs the answer: rotations that are not quite rotations, and Euler
/// angles near gimbal lock.
fn flaws<'a>(
    side: &str,
    reading: &Reading,
    numbers: impl Iterator<Item = &'a [f64]> + Clone,
) -> Vec<String> {
    let mut notes = Vec::new();
    let missed = numbers.clone().map(|numbers| defect(reading.form, numbers)).fold(0.0, f64::max);
    if missed > SAID_DEFECT {
        notes.push(format!(
            "`{side}` misses a rotation by {missed:.1e}: it was rounded, or is no rotation"
        ));
    }
    let margins_rad = numbers.filter_map(|numbers| gimbal_margin(reading, numbers));
    let margin_rad = margins_rad.fold(f64::INFINITY, f64::min);
    if margin_rad < LOCK_RAD {
        notes.push(format!(
            "`{side}` comes within {:.2}° of gimbal lock of {}: its outer angles are hardly told apart",
            margin_rad.to_degrees(),
            reading.form
        ));
    }
    notes
}

/// The readings of `all` in `style`, those that are the same poses together.
fn groups(all: &[&super::Pasted], style: Style) -> Result<Vec<Group>, DeskError> {
    let first = all.first().ok_or(DeskError::NoPairs)?;
    if let Some(other) = all.iter().find(|other| other.numbers.len() != first.numbers.len()) {
        return Err(DeskError::Counts { first: first.numbers.len(), other: other.numbers.len() });
    }
    let known = style.or(first.style);
    let samples: Vec<&[f64]> = all.iter().map(|pasted| pasted.numbers.as_slice()).collect();
    let mut groups: Vec<Group> = Vec::new();
    for reading in readings(&samples, known)? {
        let poses: Result<Vec<Pose>, DeskError> =
            samples.iter().map(|numbers| reading.pose(numbers)).collect();
        let poses = poses?;
        let rank = if known.form.is_some() { 0 } else { reading.form.usual_rank() };
        let cost = PER_RANK * f64::from(rank) + ODD_UNIT * f64::from(reading.odd_units());
        let is_same = |group: &&mut Group| {
            group.poses.iter().zip(&poses).all(|(a, b)| {
                let gap = Gap::between(a, b);
                gap.rad < SAME && gap.m < SAME
            })
        };
        match groups.iter_mut().find(is_same) {
            Some(group) => group.readings.push(reading),
            None => groups.push(Group { readings: vec![reading], poses, cost }),
        }
    }
    Ok(groups)
}

impl Search<'_> {
    /// The transform of a place in a list of frames, and what it costs to assume it.
    fn frame(list: &[FixedFrame], place: usize) -> (Pose, f64) {
        let is_named = list.iter().any(|frame| frame.is_named);
        match place.checked_sub(1).map(|at| &list[at]) {
            None => (Pose::identity(), if is_named { AGAINST_NAMES } else { 0.0 }),
            Some(frame) => (frame.transform, if frame.is_named { 0.0 } else { FRAME }),
        }
    }

    fn push(&mut self, candidate: Candidate) {
        self.best = self.best.min(candidate.score);
        if candidate.score <= self.best + HOPELESS {
            self.found.push(candidate);
        }
        if self.found.len() >= 2 * KEPT {
            // Stable, as at the end.
            self.found.sort_by(|a, b| a.score.total_cmp(&b.score));
            self.found.truncate(KEPT);
        }
    }

    /// Every reading against every other, over inversions and fixed frames.
    fn plain(&mut self) {
        let several = self.seen.len() > 1;
        for is in 0..self.is.len() {
            for inversion in Inversion::ALL {
                for base in 0..=self.frames.base.len() {
                    for tip in 0..=self.frames.tip.len() {
                        let (base_pose, base_cost) = Self::frame(&self.frames.base, base);
                        let (tip_pose, tip_cost) = Self::frame(&self.frames.tip, tip);
                        let steps = self.is[is].cost + inversion.cost() + base_cost + tip_cost;
                        let expected: Vec<Pose> = self
                            .seen
                            .iter()
                            .map(|&at| base_pose * inversion.of(&self.is[is].poses[at]) * tip_pose)
                            .collect();
                        for but in 0..self.but.len() {
                            let group = &self.but[but];
                            if self.is[is].is_odd_with(group) {
                                continue;
                            }
                            self.tried += 1;
                            let gap = |(expected, &at): (&Pose, &usize)| {
                                Gap::between(expected, &group.poses[at])
                            };
                            let first = gap((&expected[0], &self.seen[0]));
                            if several && first.rad > HOPELESS_RAD {
                                continue;
                            }
                            let gaps: Vec<Gap> = expected.iter().zip(&self.seen).map(gap).collect();
                            let residual = Residual::of(&gaps, self.has_position);
                            let score = residual.size() + steps + group.cost;
                            self.push(Candidate {
                                is,
                                but,
                                inversion,
                                base,
                                tip,
                                fitted: None,
                                misreading: None,
                                residual,
                                score,
                            });
                        }
                    }
                }
            }
        }
    }

    /// Two rotations that were made of the same three numbers in two conventions, none of them bare
    /// numbers now.
    fn misread(&mut self) {
        if !is_settled(&self.is) || !is_settled(&self.but) {
            return;
        }
        let mut truths: Vec<Rotation> = Vec::new();
        for but in 0..self.but.len() {
            for class in misreading_classes() {
                let Some(&misreading) = class.members.first() else { continue };
                let ranks = misreading.is.usual_rank() + misreading.read_as.usual_rank();
                let candidates: Vec<Vec<Rotation>> = self
                    .seen
                    .iter()
                    .map(|&at| {
                        misreading.truths(&self.but[but].poses[at].rotation, &mut truths);
                        truths.clone()
                    })
                    .collect();
                for is in 0..self.is.len() {
                    if self.is[is].is_odd_with(&self.but[but]) {
                        continue;
                    }
                    for base in 0..=self.frames.base.len() {
                        let (base_pose, base_cost) = Self::frame(&self.frames.base, base);
                        let (_, tip_cost) = Self::frame(&self.frames.tip, 0);
                        let cost = self.is[is].cost
                            + self.but[but].cost
                            + base_cost
                            + tip_cost
                            + MISREADING
                            + PER_RANK * f64::from(ranks);
                        self.tried += candidates[0].len();
                        let gaps: Vec<Gap> = self
                            .seen
                            .iter()
                            .zip(&candidates)
                            .map(|(&at, truths)| {
                                let expected = base_pose * self.is[is].poses[at];
                                let logged = &self.but[but].poses[at];
                                let rad = truths
                                    .iter()
                                    .map(|truth| angle_between(truth, &expected.rotation))
                                    .fold(f64::INFINITY, f64::min);
                                Gap { rad, m: Gap::between(&expected, logged).m }
                            })
                            .collect();
                        let residual = Residual::of(&gaps, self.has_position);
                        self.push(Candidate {
                            is,
                            but,
                            inversion: Inversion::None,
                            base,
                            tip: 0,
                            fitted: None,
                            misreading: Some(misreading),
                            residual,
                            score: residual.size() + cost,
                        });
                    }
                }
            }
        }
    }

    /// A constant tool that is not known beforehand.
    fn fitted(&mut self) {
        for is in 0..self.is.len() {
            for inversion in [Inversion::None, Inversion::Pose] {
                for base in 0..=self.frames.base.len() {
                    let (base_pose, base_cost) = Self::frame(&self.frames.base, base);
                    let before: Vec<Pose> = self
                        .seen
                        .iter()
                        .map(|&at| base_pose * inversion.of(&self.is[is].poses[at]))
                        .collect();
                    for but in 0..self.but.len() {
                        let group = &self.but[but];
                        if self.is[is].is_odd_with(group) {
                            continue;
                        }
                        let after: Vec<Pose> =
                            self.seen.iter().map(|&at| group.poses[at]).collect();
                        let Some(tool) = constant_tool(&before, &after) else { continue };
                        let gaps: Vec<Gap> = before
                            .iter()
                            .zip(&after)
                            .map(|(before, after)| Gap::between(&(before * tool), after))
                            .collect();
                        let residual = Residual::of(&gaps, self.has_position);
                        let cost = self.is[is].cost + group.cost + inversion.cost() + base_cost;
                        self.push(Candidate {
                            is,
                            but,
                            inversion,
                            base,
                            tip: 0,
                            fitted: Some(tool),
                            misreading: None,
                            residual,
                            score: residual.size() + cost + FITTED_TOOL,
                        });
                    }
                }
            }
        }
    }

    fn answer(mut self, count: usize) -> Answer {
        let found = std::mem::take(&mut self.found);
        let mut found: Vec<Candidate> =
            found.into_iter().filter(|candidate| candidate.score <= self.best + HOPELESS).collect();
        // Stable: of equals the one that was tried first, which is the most usual.
        found.sort_by(|a, b| a.score.total_cmp(&b.score));
        let mut told: Vec<(Candidate, Vec<[Reading; 2]>)> = Vec::new();
        for candidate in found {
            let is_alike = |(known, _): &(Candidate, Vec<[Reading; 2]>)| {
                let left = (known.residual.rotation_rad - candidate.residual.rotation_rad).abs();
                let left_m = known.residual.position_m.zip(candidate.residual.position_m);
                (known.inversion, known.base, known.tip, known.misreading.is_some())
                    == (
                        candidate.inversion,
                        candidate.base,
                        candidate.tip,
                        candidate.misreading.is_some(),
                    )
                    && known.fitted.is_some() == candidate.fitted.is_some()
                    && left < 1e-6
                    && left_m.is_none_or(|(a, b)| (a - b).abs() < 1e-6)
            };
            let readings =
                [&self.is[candidate.is].readings[0], &self.but[candidate.but].readings[0]];
            match told.iter().position(is_alike) {
                Some(at) => {
                    let (known, equivalents) = &mut told[at];
                    let is_new = (known.is, known.but) != (candidate.is, candidate.but);
                    if is_new && candidate.misreading.is_none() {
                        equivalents.push(readings.map(|reading| *reading));
                    }
                }
                None if told.len() < TOLD => told.push((candidate, Vec::new())),
                None => {}
            }
        }
        let hypotheses: Vec<Hypothesis> =
            told.into_iter().map(|(candidate, more)| self.hypothesis(candidate, more)).collect();
        self.judged(hypotheses, count)
    }

    fn hypothesis(&self, candidate: Candidate, more: Vec<[Reading; 2]>) -> Hypothesis {
        let [is, but] = [&self.is[candidate.is], &self.but[candidate.but]];
        let frame =
            |list: &[FixedFrame], place: usize| place.checked_sub(1).map(|at| list[at].clone());
        let mut equivalents: Vec<[Reading; 2]> = Vec::new();
        equivalents.extend(is.readings[1..].iter().map(|other| [*other, but.readings[0]]));
        equivalents.extend(but.readings[1..].iter().map(|other| [is.readings[0], *other]));
        equivalents.extend(more);
        let tool = match (candidate.fitted, frame(&self.frames.tip, candidate.tip)) {
            (Some(tool), _) => Tool::Fitted(tool),
            (None, Some(tip)) => Tool::Frames(tip),
            (None, None) => Tool::None,
        };
        let mut hypothesis = Hypothesis {
            is: is.readings[0],
            but: but.readings[0],
            inversion: candidate.inversion,
            base: frame(&self.frames.base, candidate.base),
            tool,
            misreading: candidate.misreading,
            residual: candidate.residual,
            score: candidate.score,
            equivalents,
        };
        if candidate.misreading.is_none() {
            let gaps: Vec<Gap> = is
                .poses
                .iter()
                .zip(&but.poses)
                .map(|(is, but)| Gap::between(&expected(&hypothesis, is), but))
                .collect();
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
        let is_alone = as_good == 1 && best.is_some_and(|best| best.equivalents.is_empty());
        let verdict = match (explained, is_alone) {
            (false, _) => Verdict::Open,
            (true, true) => Verdict::Reconciled,
            (true, false) => Verdict::Ambiguous,
        };
        let would_do = best.filter(|best| count == 1 && !best.residual.agrees()).and_then(|best| {
            let [is, but] = [self.pose_of(&self.is, best.is)?, self.pose_of(&self.but, best.but)?];
            let tool = expected(best, &is).inverse() * but;
            let is_translation = best.residual.rotation_rad <= AGREES_RAD;
            Some(WouldDo { tool, is_translation })
        });
        let by_chance = best.filter(|_| count == 1).map(|best| {
            // The share of all rotations within an angle of one: (θ − sin θ) / π.
            let angle = best.residual.rotation_rad.max(0.2_f64.to_radians());
            self.tried as f64 * (angle - angle.sin()) / std::f64::consts::PI
        });
        let mut notes = Vec::new();
        let fits = matches!(best.map(|best| &best.tool), Some(Tool::Fitted(_)));
        if fits
            && let Some(spread_rad) = self.spread_rad()
            && spread_rad < 10_f64.to_radians()
        {
            notes.push(format!(
                "the orientations differ by {:.1}° only: a constant tool and a moved base look alike",
                spread_rad.to_degrees()
            ));
        }
        Answer { verdict, hypotheses, as_good, would_do, tried: self.tried, by_chance, notes }
    }

    fn pose_of(&self, side: &[Group], reading: Reading) -> Option<Pose> {
        let group = side.iter().find(|group| group.readings.contains(&reading))?;
        group.poses.first().copied()
    }

    /// The largest angle between the first pose of a side and another.
    fn spread_rad(&self) -> Option<f64> {
        let poses = &self.is.first()?.poses;
        let first = poses.first()?;
        let angles = poses.iter().map(|pose| angle_between(&first.rotation, &pose.rotation));
        Some(angles.fold(0.0, f64::max))
    }
}

/// Whether it is known which convention the three numbers of a side are in, if they are three.
fn is_settled(side: &[Group]) -> bool {
    let mut forms = side.iter().flat_map(|group| &group.readings).map(|reading| reading.form);
    let first = forms.next();
    !matches!(first, Some(Coding::Three(_))) || forms.all(|form| Some(form) == first)
}

/// The pose that `but` should be where the one side is `is`.
fn expected(hypothesis: &Hypothesis, is: &Pose) -> Pose {
    let base = hypothesis.base.as_ref().map_or(Pose::identity(), |base| base.transform);
    let tool = match &hypothesis.tool {
        Tool::None => Pose::identity(),
        Tool::Frames(tip) => tip.transform,
        Tool::Fitted(tool) => *tool,
    };
    base * hypothesis.inversion.of(is) * tool
}

/// The constant `before_from_after` that is nearest to all pairs.
fn constant_tool(before: &[Pose], after: &[Pose]) -> Option<Pose> {
    let tools: Vec<Pose> =
        before.iter().zip(after).map(|(before, after)| before.inverse() * after).collect();
    let mut rotation = tools.first()?.rotation;
    for _ in 0..5 {
        let mean = tools
            .iter()
            .map(|tool| rotvec_from_rotation(&(rotation.inverse() * tool.rotation)))
            .sum::<Vec3>()
            / tools.len() as f64;
        rotation *= rotation_from_rotvec(mean);
    }
    let xyz = tools.iter().map(|tool| Vec3::from(xyz_of(tool))).sum::<Vec3>() / tools.len() as f64;
    Some(crate::geometry::pose(xyz.into(), rotation))
}
