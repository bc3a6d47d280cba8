//! Tests every encoding of one side against every encoding of the other, with inversions, fixed frames and
//! axes.

use super::answer::{End, Gap, Inversion, Residual};
use super::error::DeskError;
use super::fit;
use super::form::{Reading, Style, readings};
use super::frames::{Corrections, FixedFrame, worlds};
use super::paste::Pasted;
use crate::geometry::{
    Axes, Misinterpretation, Pose, Rotation, RotationEncoding, angle_between,
    misinterpretation_classes, pose, rotation_from_rotvec,
};

// Unit: halvings of the residual.
const PER_RANK: f64 = 0.25;
const ODD_UNIT: f64 = 3.0;
const FRAME: f64 = 1.5;
const AGAINST_NAMES: f64 = 1.5;
const MISREADING: f64 = 2.5;
const FITTED: f64 = 3.0;
const KNOWN_WORLD: f64 = 1.5;
const OTHER_WORLD: f64 = 3.0;

/// A closer transform is equal to the identity or to known frames: rad and m.
const NOTHING_RAD: f64 = 0.2 * std::f64::consts::PI / 180.0;
const NOTHING_M: f64 = 0.002;

/// Score above the best.
pub(super) const HOPELESS: f64 = 8.0;

/// With several pairs: rotation error at the first, rad.
const HOPELESS_RAD: f64 = 0.6;

/// Residuals are computed over all pairs.
pub(super) const SEARCHED: usize = 32;

const KEPT: usize = 4096;

/// Equal poses, and equal transformations, m and rad.
const SAME: f64 = 1e-9;
const SAME_CHANGE: f64 = 1e-6;

pub(super) struct Group {
    pub(super) readings: Vec<Reading>,
    pub(super) poses: Vec<Pose>,
    pub(super) cost: f64,
}

impl Group {
    /// Whether both sides have the same unusual unit, which only scales down every difference.
    pub(super) fn is_odd_with(&self, other: &Self) -> bool {
        let [a, b] = [&self.readings[0], &other.readings[0]];
        (a.has_odd_length && b.has_odd_length) || (a.has_odd_angle && b.has_odd_angle)
    }
}

#[derive(Clone, Copy)]
pub(super) enum Place {
    /// 0 for none, otherwise one more than the index in the list.
    Listed(usize),
    Fitted(Pose),
}

impl Place {
    fn among(list: &[FixedFrame]) -> impl Iterator<Item = Self> + use<> {
        (0..=list.len()).map(Self::Listed)
    }

    fn transform(self, list: &[FixedFrame]) -> Pose {
        match self {
            Self::Listed(0) => Pose::identity(),
            Self::Listed(place) => list[place - 1].transform,
            Self::Fitted(transform) => transform,
        }
    }

    fn cost(self, list: &[FixedFrame]) -> f64 {
        match self {
            Self::Listed(0) if list.iter().any(|frame| frame.is_named) => AGAINST_NAMES,
            Self::Listed(0) => 0.0,
            Self::Listed(place) if list[place - 1].is_named => 0.0,
            Self::Listed(_) => FRAME,
            Self::Fitted(_) => FITTED,
        }
    }

    pub(super) fn end(self, list: &[FixedFrame]) -> End {
        match self {
            Self::Listed(0) => End::None,
            Self::Listed(place) => End::Frames(list[place - 1].clone()),
            Self::Fitted(transform) => End::Fitted(transform),
        }
    }

    /// `None` if close to the identity or to listed frames.
    fn fitted(transform: Pose, list: &[FixedFrame]) -> Option<Self> {
        let is_near = |place: Self| {
            let gap = Gap::between(&transform, &place.transform(list));
            gap.rad < NOTHING_RAD && gap.m < NOTHING_M
        };
        (!Self::among(list).any(is_near)).then_some(Self::Fitted(transform))
    }
}

#[derive(Clone, Copy)]
pub(super) struct Steps {
    pub(super) inversion: Inversion,
    pub(super) axes: Axes,
    pub(super) base: Place,
    pub(super) tip: Place,
}

impl Steps {
    const NONE: Self = Self {
        inversion: Inversion::None,
        axes: Axes::STANDARD,
        base: Place::Listed(0),
        tip: Place::Listed(0),
    };

    fn of(&self, is: &Pose, frames: &Corrections) -> Pose {
        let axes = self.axes.pose_from_standard(&self.inversion.of(is));
        self.base.transform(&frames.base) * axes * self.tip.transform(&frames.tip)
    }

    fn cost(&self, frames: &Corrections) -> f64 {
        let is_known = |world: Axes| {
            let known = worlds().iter().map(|known| known.axes);
            world == Axes::STANDARD || known.into_iter().any(|known| known == world)
        };
        let axes = match self.axes {
            Axes::STANDARD => 0.0,
            axes if is_known(axes) || is_known(axes.inverse()) => KNOWN_WORLD,
            _ => OTHER_WORLD,
        };
        let ends = self.base.cost(&frames.base) + self.tip.cost(&frames.tip);
        self.inversion.cost() + axes + ends
    }

    pub(super) fn are(&self, other: &Self, frames: &Corrections) -> bool {
        let probes = [([0.3, -0.7, 0.5], [0.4, -0.9, 1.3]), ([-0.6, 0.2, 0.9], [-1.1, 0.5, 0.2])];
        probes.into_iter().all(|(xyz, rotvec)| {
            let probe = pose(xyz, rotation_from_rotvec(rotvec.into()));
            let gap = Gap::between(&self.of(&probe, frames), &other.of(&probe, frames));
            gap.rad < SAME_CHANGE && gap.m < SAME_CHANGE
        })
    }
}

#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub(super) is: usize,
    pub(super) but: usize,
    pub(super) steps: Steps,
    pub(super) misreading: Option<Misinterpretation>,
    pub(super) residual: Residual,
    pub(super) score: f64,
}

pub(super) struct Search<'a> {
    pub(super) is: Vec<Group>,
    pub(super) but: Vec<Group>,
    pub(super) frames: &'a Corrections,
    pub(super) has_position: bool,
    pub(super) seen: Vec<usize>,
    pub(super) best: f64,
    pub(super) tried: usize,
    pub(super) found: Vec<Candidate>,
}

pub(super) fn groups(all: &[&Pasted], style: Style) -> Result<Vec<Group>, DeskError> {
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
    fn push(&mut self, candidate: Candidate) {
        self.best = self.best.min(candidate.score);
        if candidate.score <= self.best + HOPELESS {
            self.found.push(candidate);
        }
        if self.found.len() >= 2 * KEPT {
            self.found.sort_by(|a, b| a.score.total_cmp(&b.score));
            self.found.truncate(KEPT);
        }
    }

    pub(super) fn plain(&mut self) {
        let frames = self.frames;
        for is in 0..self.is.len() {
            for inversion in Inversion::ALL {
                for base in Place::among(&frames.base) {
                    for tip in Place::among(&frames.tip) {
                        self.try_steps(is, Steps { inversion, base, tip, ..Steps::NONE });
                    }
                }
            }
            for inversion in [Inversion::None, Inversion::Pose] {
                for &axes in Axes::all().iter().filter(|axes| **axes != Axes::STANDARD) {
                    self.try_steps(is, Steps { inversion, axes, ..Steps::NONE });
                }
            }
        }
    }

    fn try_steps(&mut self, is: usize, steps: Steps) {
        let several = self.seen.len() > 1;
        let expected = self.expected(is, &steps);
        for but in 0..self.but.len() {
            let group = &self.but[but];
            if self.is[is].is_odd_with(group) {
                continue;
            }
            self.tried += 1;
            if several
                && angle_between(&expected[0].rotation, &group.poses[self.seen[0]].rotation)
                    > HOPELESS_RAD
            {
                continue;
            }
            self.judge(is, but, steps, &expected);
        }
    }

    fn expected(&self, is: usize, steps: &Steps) -> Vec<Pose> {
        let poses = &self.is[is].poses;
        self.seen.iter().map(|&at| steps.of(&poses[at], self.frames)).collect()
    }

    fn judge(&mut self, is: usize, but: usize, steps: Steps, expected: &[Pose]) {
        let group = &self.but[but];
        let gap = |(expected, &at): (&Pose, &usize)| Gap::between(expected, &group.poses[at]);
        let gaps: Vec<Gap> = expected.iter().zip(&self.seen).map(gap).collect();
        let residual = Residual::of(&gaps, self.has_position);
        let cost = self.is[is].cost + group.cost + steps.cost(self.frames);
        let score = residual.size() + cost;
        self.push(Candidate { is, but, steps, misreading: None, residual, score });
    }

    /// The same three numbers in two conventions, if both sides are in determined encodings.
    pub(super) fn misread(&mut self) {
        if !is_settled(&self.is) || !is_settled(&self.but) {
            return;
        }
        let frames = self.frames;
        let of_arms = |base: &Place| match base {
            Place::Listed(place @ 1..) => !frames.base[place - 1].is_turn,
            _ => true,
        };
        let mut truths: Vec<Rotation> = Vec::new();
        for but in 0..self.but.len() {
            for class in misinterpretation_classes() {
                let Some(&misreading) = class.members.first() else { continue };
                let ranks = misreading.is.usual_rank() + misreading.read_as.usual_rank();
                let candidates: Vec<Vec<Rotation>> = self
                    .seen
                    .iter()
                    .map(|&at| {
                        misreading.true_rotations(&self.but[but].poses[at].rotation, &mut truths);
                        truths.clone()
                    })
                    .collect();
                for is in 0..self.is.len() {
                    if self.is[is].is_odd_with(&self.but[but]) {
                        continue;
                    }
                    for base in Place::among(&frames.base).filter(of_arms) {
                        let steps = Steps { base, ..Steps::NONE };
                        self.tried += candidates[0].len();
                        let expected = self.expected(is, &steps);
                        let gap = |((expected, truths), &at): ((&Pose, &Vec<Rotation>), &usize)| {
                            let away = |truth| angle_between(truth, &expected.rotation);
                            Gap {
                                rad: truths.iter().map(away).fold(f64::INFINITY, f64::min),
                                m: Gap::between(expected, &self.but[but].poses[at]).m,
                            }
                        };
                        let sides = expected.iter().zip(&candidates).zip(&self.seen);
                        let gaps: Vec<Gap> = sides.map(gap).collect();
                        let residual = Residual::of(&gaps, self.has_position);
                        let cost = self.is[is].cost
                            + self.but[but].cost
                            + steps.cost(frames)
                            + MISREADING
                            + PER_RANK * f64::from(ranks);
                        self.push(Candidate {
                            is,
                            but,
                            steps,
                            misreading: Some(misreading),
                            residual,
                            score: residual.size() + cost,
                        });
                    }
                }
            }
        }
    }

    /// Fits a constant tool offset, base offset, or both.
    pub(super) fn fitted(&mut self) {
        let frames = self.frames;
        let other_hand = Axes::all().iter().copied().find(|axes| axes.are_left_handed());
        for is in 0..self.is.len() {
            for inversion in [Inversion::None, Inversion::Pose] {
                let inverted = Steps { inversion, ..Steps::NONE };
                let known = worlds().iter().map(|world| Steps { axes: world.axes, ..inverted });
                let bases = Place::among(&frames.base).map(|base| Steps { base, ..inverted });
                for steps in bases.chain(known.clone()) {
                    self.fit(is, steps, |before, after| {
                        let tip = Place::fitted(fit::tip(before, after)?, &frames.tip)?;
                        Some(Steps { tip, ..steps })
                    });
                }
                let tips = Place::among(&frames.tip).map(|tip| Steps { tip, ..inverted });
                for steps in tips.chain(known) {
                    self.fit(is, steps, |before, after| {
                        let base = Place::fitted(fit::base(before, after)?, &frames.base)?;
                        Some(Steps { base, ..steps })
                    });
                }
                for axes in [Some(Axes::STANDARD), other_hand].into_iter().flatten() {
                    let steps = Steps { axes, ..inverted };
                    self.fit(is, steps, |before, after| {
                        let (base, tip) = fit::both(before, after)?;
                        let base = Place::fitted(base, &frames.base)?;
                        Some(Steps { base, tip: Place::fitted(tip, &frames.tip)?, ..steps })
                    });
                }
            }
        }
    }

    fn fit(&mut self, is: usize, steps: Steps, with: impl Fn(&[Pose], &[Pose]) -> Option<Steps>) {
        let before = self.expected(is, &steps);
        for but in 0..self.but.len() {
            if self.is[is].is_odd_with(&self.but[but]) {
                continue;
            }
            let after: Vec<Pose> = self.seen.iter().map(|&at| self.but[but].poses[at]).collect();
            if let Some(steps) = with(&before, &after) {
                let expected = self.expected(is, &steps);
                self.judge(is, but, steps, &expected);
            }
        }
    }
}

/// Whether the convention of three numbers is determined.
fn is_settled(side: &[Group]) -> bool {
    let mut forms = side.iter().flat_map(|group| &group.readings).map(|reading| reading.form);
    let first = forms.next();
    !matches!(first, Some(RotationEncoding::Three(_))) || forms.all(|form| Some(form) == first)
}
