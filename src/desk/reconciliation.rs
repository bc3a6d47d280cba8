//! Result of the search for what reconciles pairs of poses.

use super::encoding::NumberEncoding;
use super::fixed_frames::{FixedFrame, worlds};
use crate::geometry::{Axes, Convention, Misinterpretation, Pose, Vec3, angle_between};

/// From rounding and a nominal model: rad and m.
pub(super) const MAX_AGREEING_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
pub(super) const MAX_AGREEING_M: f64 = 0.010;

/// One unit of the score, rad and m; the floor is this share.
const SCORE_UNIT_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const SCORE_UNIT_M: f64 = 0.005;
const SCORE_FLOOR_RATIO: f64 = 0.3;

// Unit: halvings of the residual.
const INVERSE_PENALTY: f64 = 2.0;
const TRANSPOSE_PENALTY: f64 = 2.5;

/// Inverted part of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inversion {
    /// None.
    None,
    /// Whole pose: parent and child swapped.
    Pose,
    /// Rotation only: transposed.
    Rotation,
}

impl Inversion {
    pub(super) const ALL: [Self; 3] = [Self::None, Self::Pose, Self::Rotation];

    pub(super) fn apply(self, pose: &Pose) -> Pose {
        match self {
            Self::None => *pose,
            Self::Pose => pose.inverse(),
            Self::Rotation => Pose::from_parts(pose.translation, pose.rotation.inverse()),
        }
    }

    pub(super) fn penalty(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Pose => INVERSE_PENALTY,
            Self::Rotation => TRANSPOSE_PENALTY,
        }
    }
}

/// Transform between the two poses at one end.
#[derive(Clone, Debug, PartialEq)]
pub enum EndTransform {
    /// None.
    None,
    /// Fixed frames: at the base `but_from_is`, at the tip `is_from_but`.
    Frames(FixedFrame),
    /// Constant transform in that direction, fitted to several pairs.
    Fitted(Pose),
}

impl EndTransform {
    /// The transform, or identity.
    pub fn transform(&self) -> Pose {
        match self {
            Self::None => Pose::identity(),
            Self::Frames(frames) => frames.transform,
            Self::Fitted(transform) => *transform,
        }
    }

    fn claim(&self, relation: &str, fitted: &str) -> Option<String> {
        match self {
            Self::None => None,
            Self::Fitted(_) => Some(fitted.to_owned()),
            Self::Frames(frames) => {
                let FixedFrame { frame_a: is, frame_b: but, arms, .. } = frames;
                Some(match frames.is_either_way() {
                    true => format!("one is {relation} {is}, the other {relation} {but} ({arms})"),
                    false => format!("A is {relation} {is}, B {relation} {but} ({arms})"),
                })
            }
        }
    }
}

/// Residual of an explanation over all pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Rotation, rms rad.
    pub rotation_rad: f64,
    /// Largest rotation, rad.
    pub worst_rotation_rad: f64,
    /// Position, rms m; `None` if a side lacks it.
    pub position_m: Option<f64>,
    /// Largest position residual, m.
    pub worst_position_m: Option<f64>,
}

impl Residual {
    /// Whether within rounding and nominal model errors: 1° and 10 mm.
    pub fn is_agreement(&self) -> bool {
        self.rotation_rad <= MAX_AGREEING_RAD && self.position_m.is_none_or(|m| m <= MAX_AGREEING_M)
    }

    pub(super) fn from_differences(gaps: &[PoseDifference], has_position: bool) -> Self {
        let mean = |square: &dyn Fn(&PoseDifference) -> f64| {
            (gaps.iter().map(square).sum::<f64>() / gaps.len() as f64).sqrt()
        };
        let worst = |of: &dyn Fn(&PoseDifference) -> f64| gaps.iter().map(of).fold(0.0, f64::max);
        Self {
            rotation_rad: mean(&|gap| gap.rad * gap.rad),
            worst_rotation_rad: worst(&|gap| gap.rad),
            position_m: has_position.then(|| mean(&|gap| gap.m * gap.m)),
            worst_position_m: has_position.then(|| worst(&|gap| gap.m)),
        }
    }

    /// Logarithmic, base 2.
    pub(super) fn score(&self) -> f64 {
        let doublings = |amount: f64, step: f64| (SCORE_FLOOR_RATIO + amount / step).log2();
        doublings(self.rotation_rad, SCORE_UNIT_RAD)
            + self.position_m.map_or(0.0, |m| doublings(m, SCORE_UNIT_M))
    }
}

#[derive(Clone, Copy)]
pub(super) struct PoseDifference {
    pub(super) rad: f64,
    pub(super) m: f64,
}

impl PoseDifference {
    pub(super) fn between(a: &Pose, b: &Pose) -> Self {
        Self {
            rad: angle_between(&a.rotation, &b.rotation),
            m: (a.translation.vector - b.translation.vector).norm(),
        }
    }
}

/// Transforms that would remove a single pair's residual; unconfirmed.
#[derive(Clone, Debug, PartialEq)]
pub struct SinglePairOffsets {
    /// Tool offset, after the other steps: `is_from_but`.
    pub tool: Pose,
    /// Base offset: `but_from_is`.
    pub base: Pose,
    /// Whether a pure translation, because the rotations agree.
    pub is_translation: bool,
}

impl SinglePairOffsets {
    /// Distance and axis, such as `150.0 mm along tool z`; `None` if the rotations differ.
    pub fn translation_text(&self) -> Option<String> {
        /// Minimum share of the distance along one axis.
        const MIN_AXIS_SHARE: f64 = 0.995;
        let shift = self.tool.translation.vector;
        let along = |vector: Vec3, end: &str| {
            let axis = vector.iamax();
            let sign = if vector[axis] < 0.0 { "-" } else { "" };
            let is_along = vector[axis].abs() >= MIN_AXIS_SHARE * vector.norm();
            is_along.then(|| format!("{end} {sign}{}", ["x", "y", "z"][axis]))
        };
        let ends = [along(shift, "tool"), along(self.base.translation.vector, "base")];
        let ends: Vec<String> = ends.into_iter().flatten().collect();
        let along = match ends.is_empty() {
            true => "apart".to_owned(),
            false => format!("along {}", ends.join(" or ")),
        };
        self.is_translation.then(|| format!("{:.1} mm {along}", 1e3 * shift.norm()))
    }
}

/// Explanation: B is `base · axes(inversion(A)) · tip`.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// Encoding of side A.
    pub encoding_a: NumberEncoding,
    /// Encoding of side B.
    pub encoding_b: NumberEncoding,
    /// Inversion applied to A first.
    pub inversion: Inversion,
    /// Axes of B's world in terms of A's.
    pub axes: Axes,
    /// Frames at the base.
    pub base: EndTransform,
    /// Frames at the tip.
    pub tip: EndTransform,
    /// The same three numbers read in two conventions.
    pub misinterpretation: Option<Misinterpretation>,
    /// Residual.
    pub residual: Residual,
    /// Residual and penalties, logarithmic, base 2; lower is better.
    pub score: f64,
    /// Other encodings with the same residual.
    pub equivalents: Vec<[NumberEncoding; 2]>,
    /// Other names for the same transformation.
    pub also: Vec<String>,
}

impl Hypothesis {
    /// Its assertions.
    pub fn claims(&self) -> Vec<String> {
        let mut claims = Vec::new();
        if let Some(Misinterpretation { is, read_as }) = self.misinterpretation {
            claims.push(format!(
                "A interprets three numbers as {}, B interprets the same numbers as {}",
                convention_text(is),
                convention_text(read_as)
            ));
        }
        match self.inversion {
            Inversion::None => {}
            Inversion::Pose => claims
                .push("one is the inverse of the other: parent and child are swapped".to_owned()),
            Inversion::Rotation => {
                claims.push("the rotation of one is the transpose of the other's".to_owned());
            }
        }
        claims.extend(axes_claim(self.axes));
        claims.extend(self.base.claim("in", "a constant base offset between them"));
        claims.extend(self.tip.claim("of", "a constant tool offset between them"));
        claims
    }

    /// Whether all equivalent encodings change both sides equally, which determines the difference.
    pub(super) fn determines_difference(&self) -> bool {
        let is_alike = |[is, but]: &[NumberEncoding; 2]| is.rotation == but.rotation;
        self.equivalents.is_empty()
            || self.encoding_a.rotation == self.encoding_b.rotation
                && self.equivalents.iter().all(is_alike)
    }

    pub(super) fn expected(&self, is: &Pose) -> Pose {
        let axes = self.axes.pose_from_standard(&self.inversion.apply(is));
        self.base.transform() * axes * self.tip.transform()
    }
}

fn convention_text(convention: Convention) -> String {
    match convention {
        Convention::RotVec => "a rotation vector".to_owned(),
        Convention::RPY => "roll, pitch, yaw (euler:xyz)".to_owned(),
        other => other.to_string(),
    }
}

fn axes_claim(axes: Axes) -> Option<String> {
    if axes == Axes::STANDARD {
        return None;
    }
    let [x, y, z] = axes.inverse().standard_names(false);
    let whose = |axes: Axes| worlds().iter().find(|world| world.axes == axes);
    let whose = match (whose(axes), whose(axes.inverse())) {
        (Some(both), Some(_)) if axes == axes.inverse() => {
            format!(" ({}, either side)", both.who)
        }
        (Some(but), _) => format!(" (B: {})", but.who),
        (None, Some(is)) => format!(" (A: {})", is.who),
        (None, None) => String::new(),
    };
    let hand = if axes.are_left_handed() { ", opposite handedness" } else { "" };
    Some(format!("B's x, y, z are A's {x}, {y}, {z}, in world and body{hand}{whose}"))
}

/// Verdict on the pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReconcileVerdict {
    /// One agrees, and no other is as good.
    Reconciled,
    /// Several agree, or one with several conventions.
    Ambiguous,
    /// None agrees.
    Unexplained,
}

/// Result of the search.
#[derive(Clone, Debug)]
pub struct Reconciliation {
    /// Verdict.
    pub verdict: ReconcileVerdict,
    /// Explanations, best first.
    pub hypotheses: Vec<Hypothesis>,
    /// Number as good as the first, including it.
    pub equally_good: usize,
    /// Possible correction of a single pair.
    pub single_pair_offsets: Option<SinglePairOffsets>,
    /// Encodings tried for the two rotations.
    pub tried: usize,
    /// Expected matches this close among that many random rotations; for a single pair.
    pub expected_by_chance: Option<f64>,
    /// Warnings.
    pub notes: Vec<String>,
}
