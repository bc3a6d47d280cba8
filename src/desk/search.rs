//! Tests every encoding of one side against every encoding of the other, with inversions, fixed frames and
//! axes.

use super::encoding::{KnownEncoding, NumberEncoding, possible_encodings};
use super::error::DeskError;
use super::fit_offsets;
use super::fixed_frames::{FixedFrame, FrameCandidates, worlds};
use super::parse::PoseText;
use super::reconciliation::{EndTransform, Inversion, PoseDifference, Residual};
use crate::geometry::{
    Axes, Misinterpretation, Pose, Rotation, RotationEncoding, angle_between,
    misinterpretation_classes, pose, rotation_from_rotvec,
};

// Unit: halvings of the residual.
const RANK_PENALTY: f64 = 0.25;
const UNUSUAL_UNIT_PENALTY: f64 = 3.0;
const FRAME_PENALTY: f64 = 1.5;
const UNDECLARED_FRAME_PENALTY: f64 = 1.5;
const MISINTERPRETATION_PENALTY: f64 = 2.5;
const FIT_PENALTY: f64 = 3.0;
const KNOWN_WORLD_PENALTY: f64 = 1.5;
const OTHER_WORLD_PENALTY: f64 = 3.0;

/// A closer transform is equal to the identity or to known frames: rad and m.
const MIN_TRANSFORM_RAD: f64 = 0.2 * std::f64::consts::PI / 180.0;
const MIN_TRANSFORM_M: f64 = 0.002;

/// Score above the best.
pub(super) const MAX_SCORE_ABOVE_BEST: f64 = 8.0;

/// With several pairs: rotation error at the first, rad.
const MAX_FIRST_ERROR_RAD: f64 = 0.6;

/// Residuals are computed over all pairs.
pub(super) const MAX_SEARCHED_PAIRS: usize = 32;

const MAX_CANDIDATES: usize = 4096;

/// Equal poses, and equal transformations, m and rad.
const MAX_EQUAL_DIFFERENCE: f64 = 1e-9;
const MAX_EQUAL_TRANSFORM_DIFFERENCE: f64 = 1e-6;

pub(super) struct EncodingGroup {
    pub(super) encodings: Vec<NumberEncoding>,
    pub(super) poses: Vec<Pose>,
    pub(super) penalty: f64,
}

impl EncodingGroup {
    /// Whether both sides have the same unusual unit, which only scales down every difference.
    pub(super) fn shares_unusual_unit(&self, other: &Self) -> bool {
        let [a, b] = [&self.encodings[0], &other.encodings[0]];
        (a.has_unusual_length && b.has_unusual_length)
            || (a.has_unusual_angle && b.has_unusual_angle)
    }
}

#[derive(Clone, Copy)]
pub(super) enum EndCandidate {
    /// 0 for none, otherwise one more than the index in the list.
    Listed(usize),
    Fitted(Pose),
}

impl EndCandidate {
    fn candidates(list: &[FixedFrame]) -> impl Iterator<Item = Self> + use<> {
        (0..=list.len()).map(Self::Listed)
    }

    fn transform(self, list: &[FixedFrame]) -> Pose {
        match self {
            Self::Listed(0) => Pose::identity(),
            Self::Listed(place) => list[place - 1].transform,
            Self::Fitted(transform) => transform,
        }
    }

    fn penalty(self, list: &[FixedFrame]) -> f64 {
        match self {
            Self::Listed(0) if list.iter().any(|frame| frame.is_declared) => {
                UNDECLARED_FRAME_PENALTY
            }
            Self::Listed(0) => 0.0,
            Self::Listed(place) if list[place - 1].is_declared => 0.0,
            Self::Listed(_) => FRAME_PENALTY,
            Self::Fitted(_) => FIT_PENALTY,
        }
    }

    pub(super) fn end_transform(self, list: &[FixedFrame]) -> EndTransform {
        match self {
            Self::Listed(0) => EndTransform::None,
            Self::Listed(place) => EndTransform::Frames(list[place - 1].clone()),
            Self::Fitted(transform) => EndTransform::Fitted(transform),
        }
    }

    /// `None` if close to the identity or to listed frames.
    fn new_fitted(transform: Pose, list: &[FixedFrame]) -> Option<Self> {
        let is_near = |place: Self| {
            let difference = PoseDifference::between(&transform, &place.transform(list));
            difference.rad < MIN_TRANSFORM_RAD && difference.m < MIN_TRANSFORM_M
        };
        (!Self::candidates(list).any(is_near)).then_some(Self::Fitted(transform))
    }
}

#[derive(Clone, Copy)]
pub(super) struct TransformSteps {
    pub(super) inversion: Inversion,
    pub(super) axes: Axes,
    pub(super) base: EndCandidate,
    pub(super) tip: EndCandidate,
}

impl TransformSteps {
    const NONE: Self = Self {
        inversion: Inversion::None,
        axes: Axes::STANDARD,
        base: EndCandidate::Listed(0),
        tip: EndCandidate::Listed(0),
    };

    fn apply(&self, is: &Pose, frames: &FrameCandidates) -> Pose {
        let axes = self.axes.pose_from_standard(&self.inversion.apply(is));
        self.base.transform(&frames.base) * axes * self.tip.transform(&frames.tip)
    }

    fn penalty(&self, frames: &FrameCandidates) -> f64 {
        let is_known = |world: Axes| {
            let known = worlds().iter().map(|known| known.axes);
            world == Axes::STANDARD || known.into_iter().any(|known| known == world)
        };
        let axes = match self.axes {
            Axes::STANDARD => 0.0,
            axes if is_known(axes) || is_known(axes.inverse()) => KNOWN_WORLD_PENALTY,
            _ => OTHER_WORLD_PENALTY,
        };
        let ends = self.base.penalty(&frames.base) + self.tip.penalty(&frames.tip);
        self.inversion.penalty() + axes + ends
    }

    pub(super) fn is_equivalent(&self, other: &Self, frames: &FrameCandidates) -> bool {
        let probes = [([0.3, -0.7, 0.5], [0.4, -0.9, 1.3]), ([-0.6, 0.2, 0.9], [-1.1, 0.5, 0.2])];
        probes.into_iter().all(|(xyz, rotvec)| {
            let probe = pose(xyz, rotation_from_rotvec(rotvec.into()));
            let difference =
                PoseDifference::between(&self.apply(&probe, frames), &other.apply(&probe, frames));
            difference.rad < MAX_EQUAL_TRANSFORM_DIFFERENCE
                && difference.m < MAX_EQUAL_TRANSFORM_DIFFERENCE
        })
    }
}

#[derive(Clone, Copy)]
pub(super) struct SearchCandidate {
    pub(super) index_a: usize,
    pub(super) index_b: usize,
    pub(super) steps: TransformSteps,
    pub(super) misinterpretation: Option<Misinterpretation>,
    pub(super) residual: Residual,
    pub(super) score: f64,
}

pub(super) struct Search<'a> {
    pub(super) side_a: Vec<EncodingGroup>,
    pub(super) side_b: Vec<EncodingGroup>,
    pub(super) frames: &'a FrameCandidates,
    pub(super) has_position: bool,
    pub(super) searched_pairs: Vec<usize>,
    pub(super) best: f64,
    pub(super) tried: usize,
    pub(super) found: Vec<SearchCandidate>,
}

pub(super) fn group_encodings(
    all: &[&PoseText],
    known: KnownEncoding,
) -> Result<Vec<EncodingGroup>, DeskError> {
    let first = all.first().ok_or(DeskError::NoPairs)?;
    if let Some(other) = all.iter().find(|other| other.numbers.len() != first.numbers.len()) {
        return Err(DeskError::Counts { first: first.numbers.len(), other: other.numbers.len() });
    }
    let known = known.or(first.encoding);
    let samples: Vec<&[f64]> = all.iter().map(|pose_text| pose_text.numbers.as_slice()).collect();
    let mut groups: Vec<EncodingGroup> = Vec::new();
    for encoding in possible_encodings(&samples, known)? {
        let poses: Result<Vec<Pose>, DeskError> =
            samples.iter().map(|numbers| encoding.pose(numbers)).collect();
        let poses = poses?;
        let rank = if known.rotation.is_some() { 0 } else { encoding.rotation.usual_rank() };
        let penalty = RANK_PENALTY * f64::from(rank)
            + UNUSUAL_UNIT_PENALTY * f64::from(encoding.count_unusual_units());
        let is_same = |group: &&mut EncodingGroup| {
            group.poses.iter().zip(&poses).all(|(a, b)| {
                let difference = PoseDifference::between(a, b);
                difference.rad < MAX_EQUAL_DIFFERENCE && difference.m < MAX_EQUAL_DIFFERENCE
            })
        };
        match groups.iter_mut().find(is_same) {
            Some(group) => group.encodings.push(encoding),
            None => groups.push(EncodingGroup { encodings: vec![encoding], poses, penalty }),
        }
    }
    Ok(groups)
}

impl Search<'_> {
    fn push(&mut self, candidate: SearchCandidate) {
        self.best = self.best.min(candidate.score);
        if candidate.score <= self.best + MAX_SCORE_ABOVE_BEST {
            self.found.push(candidate);
        }
        if self.found.len() >= 2 * MAX_CANDIDATES {
            self.found.sort_by(|a, b| a.score.total_cmp(&b.score));
            self.found.truncate(MAX_CANDIDATES);
        }
    }

    pub(super) fn search_frames_and_axes(&mut self) {
        let frames = self.frames;
        for is in 0..self.side_a.len() {
            for inversion in Inversion::ALL {
                for base in EndCandidate::candidates(&frames.base) {
                    for tip in EndCandidate::candidates(&frames.tip) {
                        self.try_steps(
                            is,
                            TransformSteps { inversion, base, tip, ..TransformSteps::NONE },
                        );
                    }
                }
            }
            for inversion in [Inversion::None, Inversion::Pose] {
                for &axes in Axes::all().iter().filter(|axes| **axes != Axes::STANDARD) {
                    self.try_steps(is, TransformSteps { inversion, axes, ..TransformSteps::NONE });
                }
            }
        }
    }

    fn try_steps(&mut self, is: usize, steps: TransformSteps) {
        let several = self.searched_pairs.len() > 1;
        let expected = self.expected(is, &steps);
        for but in 0..self.side_b.len() {
            let group = &self.side_b[but];
            if self.side_a[is].shares_unusual_unit(group) {
                continue;
            }
            self.tried += 1;
            if several
                && angle_between(
                    &expected[0].rotation,
                    &group.poses[self.searched_pairs[0]].rotation,
                ) > MAX_FIRST_ERROR_RAD
            {
                continue;
            }
            self.judge(is, but, steps, &expected);
        }
    }

    fn expected(&self, is: usize, steps: &TransformSteps) -> Vec<Pose> {
        let poses = &self.side_a[is].poses;
        self.searched_pairs.iter().map(|&at| steps.apply(&poses[at], self.frames)).collect()
    }

    fn judge(&mut self, is: usize, but: usize, steps: TransformSteps, expected: &[Pose]) {
        let group = &self.side_b[but];
        let difference =
            |(expected, &at): (&Pose, &usize)| PoseDifference::between(expected, &group.poses[at]);
        let differences: Vec<PoseDifference> =
            expected.iter().zip(&self.searched_pairs).map(difference).collect();
        let residual = Residual::from_differences(&differences, self.has_position);
        let penalty = self.side_a[is].penalty + group.penalty + steps.penalty(self.frames);
        let score = residual.score() + penalty;
        self.push(SearchCandidate {
            index_a: is,
            index_b: but,
            steps,
            misinterpretation: None,
            residual,
            score,
        });
    }

    /// The same three numbers in two conventions, if both sides are in determined encodings.
    pub(super) fn search_misinterpretations(&mut self) {
        if !is_convention_determined(&self.side_a) || !is_convention_determined(&self.side_b) {
            return;
        }
        let frames = self.frames;
        let of_arms = |base: &EndCandidate| match base {
            EndCandidate::Listed(place @ 1..) => !frames.base[place - 1].is_turn,
            _ => true,
        };
        let mut truths: Vec<Rotation> = Vec::new();
        for but in 0..self.side_b.len() {
            for class in misinterpretation_classes() {
                let Some(&misinterpretation) = class.members.first() else { continue };
                let ranks =
                    misinterpretation.is.usual_rank() + misinterpretation.read_as.usual_rank();
                let candidates: Vec<Vec<Rotation>> = self
                    .searched_pairs
                    .iter()
                    .map(|&at| {
                        misinterpretation
                            .true_rotations(&self.side_b[but].poses[at].rotation, &mut truths);
                        truths.clone()
                    })
                    .collect();
                for is in 0..self.side_a.len() {
                    if self.side_a[is].shares_unusual_unit(&self.side_b[but]) {
                        continue;
                    }
                    for base in EndCandidate::candidates(&frames.base).filter(of_arms) {
                        let steps = TransformSteps { base, ..TransformSteps::NONE };
                        self.tried += candidates[0].len();
                        let expected = self.expected(is, &steps);
                        let difference =
                            |((expected, truths), &at): ((&Pose, &Vec<Rotation>), &usize)| {
                                let away = |truth| angle_between(truth, &expected.rotation);
                                PoseDifference {
                                    rad: truths.iter().map(away).fold(f64::INFINITY, f64::min),
                                    m: PoseDifference::between(
                                        expected, &self.side_b[but].poses[at],
                                    )
                                    .m,
                                }
                            };
                        let sides = expected.iter().zip(&candidates).zip(&self.searched_pairs);
                        let differences: Vec<PoseDifference> = sides.map(difference).collect();
                        let residual = Residual::from_differences(&differences, self.has_position);
                        let penalty = self.side_a[is].penalty
                            + self.side_b[but].penalty
                            + steps.penalty(frames)
                            + MISINTERPRETATION_PENALTY
                            + RANK_PENALTY * f64::from(ranks);
                        self.push(SearchCandidate {
                            index_a: is,
                            index_b: but,
                            steps,
                            misinterpretation: Some(misinterpretation),
                            residual,
                            score: residual.score() + penalty,
                        });
                    }
                }
            }
        }
    }

    /// Fits a constant tool offset, base offset, or both.
    pub(super) fn search_fitted_offsets(&mut self) {
        let frames = self.frames;
        let other_hand = Axes::all().iter().copied().find(|axes| axes.are_left_handed());
        for is in 0..self.side_a.len() {
            for inversion in [Inversion::None, Inversion::Pose] {
                let inverted = TransformSteps { inversion, ..TransformSteps::NONE };
                let known =
                    worlds().iter().map(|world| TransformSteps { axes: world.axes, ..inverted });
                let bases = EndCandidate::candidates(&frames.base)
                    .map(|base| TransformSteps { base, ..inverted });
                for steps in bases.chain(known.clone()) {
                    self.fit(is, steps, |before, after| {
                        let tip = EndCandidate::new_fitted(
                            fit_offsets::fit_tip(before, after)?,
                            &frames.tip,
                        )?;
                        Some(TransformSteps { tip, ..steps })
                    });
                }
                let tips = EndCandidate::candidates(&frames.tip)
                    .map(|tip| TransformSteps { tip, ..inverted });
                for steps in tips.chain(known) {
                    self.fit(is, steps, |before, after| {
                        let base = EndCandidate::new_fitted(
                            fit_offsets::fit_base(before, after)?,
                            &frames.base,
                        )?;
                        Some(TransformSteps { base, ..steps })
                    });
                }
                for axes in [Some(Axes::STANDARD), other_hand].into_iter().flatten() {
                    let steps = TransformSteps { axes, ..inverted };
                    self.fit(is, steps, |before, after| {
                        let (base, tip) = fit_offsets::fit_base_and_tip(before, after)?;
                        let base = EndCandidate::new_fitted(base, &frames.base)?;
                        Some(TransformSteps {
                            base,
                            tip: EndCandidate::new_fitted(tip, &frames.tip)?,
                            ..steps
                        })
                    });
                }
            }
        }
    }

    fn fit(
        &mut self,
        is: usize,
        steps: TransformSteps,
        with: impl Fn(&[Pose], &[Pose]) -> Option<TransformSteps>,
    ) {
        let before = self.expected(is, &steps);
        for but in 0..self.side_b.len() {
            if self.side_a[is].shares_unusual_unit(&self.side_b[but]) {
                continue;
            }
            let after: Vec<Pose> =
                self.searched_pairs.iter().map(|&at| self.side_b[but].poses[at]).collect();
            if let Some(steps) = with(&before, &after) {
                let expected = self.expected(is, &steps);
                self.judge(is, but, steps, &expected);
            }
        }
    }
}

/// Whether the convention of three numbers is determined.
fn is_convention_determined(side: &[EncodingGroup]) -> bool {
    let mut forms =
        side.iter().flat_map(|group| &group.encodings).map(|encoding| encoding.rotation);
    let first = forms.next();
    !matches!(first, Some(RotationEncoding::Three(_))) || forms.all(|form| Some(form) == first)
}
