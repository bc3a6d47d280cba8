//! Result of the search for what reconciles pairs of poses.

use super::form::Reading;
use super::frames::{FixedFrame, worlds};
use crate::geometry::{Axes, Convention, Misinterpretation, Pose, Vec3, angle_between};

/// From rounding and a nominal model: rad and m.
pub(super) const AGREES_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
pub(super) const AGREES_M: f64 = 0.010;

/// One unit of the score, rad and m; the floor is this share.
const STEP_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const STEP_M: f64 = 0.005;
const NO_STEP: f64 = 0.3;

// Unit: halvings of the residual.
const INVERSE: f64 = 2.0;
const TRANSPOSE: f64 = 2.5;

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

    pub(super) fn of(self, pose: &Pose) -> Pose {
        match self {
            Self::None => *pose,
            Self::Pose => pose.inverse(),
            Self::Rotation => Pose::from_parts(pose.translation, pose.rotation.inverse()),
        }
    }

    pub(super) fn cost(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Pose => INVERSE,
            Self::Rotation => TRANSPOSE,
        }
    }
}

/// Transform between the two poses at one end.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// None.
    None,
    /// Fixed frames: at the base `but_from_is`, at the tip `is_from_but`.
    Frames(FixedFrame),
    /// Constant transform in that direction, fitted to several pairs.
    Fitted(Pose),
}

impl End {
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
                let FixedFrame { is, but, arms, .. } = frames;
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
    pub fn agrees(&self) -> bool {
        self.rotation_rad <= AGREES_RAD && self.position_m.is_none_or(|m| m <= AGREES_M)
    }

    pub(super) fn of(gaps: &[Gap], has_position: bool) -> Self {
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

    /// Logarithmic, base 2.
    pub(super) fn size(&self) -> f64 {
        let doublings = |amount: f64, step: f64| (NO_STEP + amount / step).log2();
        doublings(self.rotation_rad, STEP_RAD)
            + self.position_m.map_or(0.0, |m| doublings(m, STEP_M))
    }
}

#[derive(Clone, Copy)]
pub(super) struct Gap {
    pub(super) rad: f64,
    pub(super) m: f64,
}

impl Gap {
    pub(super) fn between(a: &Pose, b: &Pose) -> Self {
        Self {
            rad: angle_between(&a.rotation, &b.rotation),
            m: (a.translation.vector - b.translation.vector).norm(),
        }
    }
}

/// Transforms that would remove a single pair's residual; unconfirmed.
#[derive(Clone, Debug, PartialEq)]
pub struct WouldDo {
    /// Tool offset, after the other steps: `is_from_but`.
    pub tool: Pose,
    /// Base offset: `but_from_is`.
    pub base: Pose,
    /// Whether a pure translation, because the rotations agree.
    pub is_translation: bool,
}

impl WouldDo {
    /// Distance and axis, such as `150.0 mm along tool z`; `None` if the rotations differ.
    pub fn apart(&self) -> Option<String> {
        /// Minimum share of the distance along one axis.
        const ALONG: f64 = 0.995;
        let shift = self.tool.translation.vector;
        let along = |vector: Vec3, end: &str| {
            let axis = vector.iamax();
            let sign = if vector[axis] < 0.0 { "-" } else { "" };
            let is_along = vector[axis].abs() >= ALONG * vector.norm();
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
    pub is: Reading,
    /// Encoding of side B.
    pub but: Reading,
    /// Inversion applied to A first.
    pub inversion: Inversion,
    /// Axes of B's world in terms of A's.
    pub axes: Axes,
    /// Frames at the base.
    pub base: End,
    /// Frames at the tip.
    pub tip: End,
    /// The same three numbers read in two conventions.
    pub misreading: Option<Misinterpretation>,
    /// Residual.
    pub residual: Residual,
    /// Residual and penalties, logarithmic, base 2; lower is better.
    pub score: f64,
    /// Other encodings with the same residual.
    pub equivalents: Vec<[Reading; 2]>,
    /// Other names for the same transformation.
    pub also: Vec<String>,
}

impl Hypothesis {
    /// Its assertions.
    pub fn claims(&self) -> Vec<String> {
        let mut claims = Vec::new();
        if let Some(Misinterpretation { is, read_as }) = self.misreading {
            claims.push(format!(
                "A interprets three numbers as {}, B interprets the same numbers as {}",
                spelt(is),
                spelt(read_as)
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
        claims.extend(said_of_axes(self.axes));
        claims.extend(self.base.claim("in", "a constant base offset between them"));
        claims.extend(self.tip.claim("of", "a constant tool offset between them"));
        claims
    }

    /// Whether all equivalent encodings change both sides equally, which determines the difference.
    pub(super) fn tells_the_change(&self) -> bool {
        let is_alike = |[is, but]: &[Reading; 2]| is.form == but.form;
        self.equivalents.is_empty()
            || self.is.form == self.but.form && self.equivalents.iter().all(is_alike)
    }

    pub(super) fn expected(&self, is: &Pose) -> Pose {
        let axes = self.axes.pose_from_standard(&self.inversion.of(is));
        self.base.transform() * axes * self.tip.transform()
    }
}

fn spelt(convention: Convention) -> String {
    match convention {
        Convention::RotVec => "a rotation vector".to_owned(),
        Convention::RPY => "roll, pitch, yaw (euler:xyz)".to_owned(),
        other => other.to_string(),
    }
}

fn said_of_axes(axes: Axes) -> Option<String> {
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
pub enum Verdict {
    /// One agrees, and no other is as good.
    Reconciled,
    /// Several agree, or one with several conventions.
    Ambiguous,
    /// None agrees.
    Open,
}

/// Result of the search.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Verdict.
    pub verdict: Verdict,
    /// Explanations, best first.
    pub hypotheses: Vec<Hypothesis>,
    /// Number as good as the first, including it.
    pub as_good: usize,
    /// Possible correction of a single pair.
    pub would_do: Option<WouldDo>,
    /// Encodings tried for the two rotations.
    pub tried: usize,
    /// Expected matches this close among that many random rotations; for a single pair.
    pub by_chance: Option<f64>,
    /// Warnings.
    pub notes: Vec<String>,
}
