//! Every reading of the one side against every reading of the other, over inversions and fixed frames.

use super::answer::{Gap, Inversion, Residual};
use super::error::DeskError;
use super::form::{Reading, Style, readings};
use super::frames::{Corrections, FixedFrame};
use super::paste::Pasted;
use crate::geometry::{
    Coding, Misreading, Pose, Rotation, Vec3, angle_between, misreading_classes,
    rotation_from_rotvec, rotvec_from_rotation, xyz_of,
};

// What an explanation pays for each thing that it assumes, in halvings of what is left.
const PER_RANK: f64 = 0.25;
const ODD_UNIT: f64 = 3.0;
const FRAME: f64 = 1.5;
const AGAINST_NAMES: f64 = 1.5;
const MISREADING: f64 = 2.5;
const FITTED_TOOL: f64 = 3.0;

/// Explanations that are this much worse than the best so far are dropped.
pub(super) const HOPELESS: f64 = 8.0;

/// With several pairs, what turns the first this far off, rad, is dropped.
const HOPELESS_RAD: f64 = 0.6;

/// How many pairs the search looks at; what is left is computed over all.
pub(super) const SEARCHED: usize = 32;

/// How many explanations are kept while others are tried.
const KEPT: usize = 4096;

/// Poses by less than this apart, m and rad, are one.
const SAME: f64 = 1e-9;

/// Readings of one side that are the same poses.
pub(super) struct Group {
    pub(super) readings: Vec<Reading>,
    pub(super) poses: Vec<Pose>,
    pub(super) cost: f64,
}

impl Group {
    /// Whether both are in millimetres, or in degrees, against the size of their numbers: that makes
    /// every difference small and explains none.
    pub(super) fn is_odd_with(&self, other: &Self) -> bool {
        let [a, b] = [&self.readings[0], &other.readings[0]];
        (a.has_odd_length && b.has_odd_length) || (a.has_odd_angle && b.has_odd_angle)
    }
}

/// An explanation as numbers, before it is told.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub(super) is: usize,
    pub(super) but: usize,
    pub(super) inversion: Inversion,
    /// 0 for none, else one more than the place in the list.
    pub(super) base: usize,
    pub(super) tip: usize,
    pub(super) fitted: Option<Pose>,
    pub(super) misreading: Option<Misreading>,
    pub(super) residual: Residual,
    pub(super) score: f64,
}

pub(super) struct Search<'a> {
    pub(super) is: Vec<Group>,
    pub(super) but: Vec<Group>,
    pub(super) frames: &'a Corrections,
    pub(super) has_position: bool,
    /// The pairs that are looked at.
    pub(super) seen: Vec<usize>,
    pub(super) best: f64,
    pub(super) tried: usize,
    pub(super) found: Vec<Candidate>,
}

/// The readings of `all` in `style`, those that are the same poses together.
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
    /// The transform of a place in a list of frames, and what it costs to assume it.
    pub(super) fn frame(list: &[FixedFrame], place: usize) -> (Pose, f64) {
        let is_named = list.iter().any(|frame| frame.is_named);
        match place.checked_sub(1).map(|at| &list[at]) {
            None => (Pose::identity(), if is_named { AGAINST_NAMES } else { 0.0 }),
            Some(frame) => (frame.transform, if frame.is_named { 0.0 } else { FRAME }),
        }
    }

    pub(super) fn push(&mut self, candidate: Candidate) {
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
    pub(super) fn plain(&mut self) {
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
    pub(super) fn misread(&mut self) {
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
    pub(super) fn fitted(&mut self) {
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
}

/// Whether it is known which convention the three numbers of a side are in, if they are three.
fn is_settled(side: &[Group]) -> bool {
    let mut forms = side.iter().flat_map(|group| &group.readings).map(|reading| reading.form);
    let first = forms.next();
    !matches!(first, Some(Coding::Three(_))) || forms.all(|form| Some(form) == first)
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
