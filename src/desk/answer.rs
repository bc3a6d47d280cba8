//! What makes pairs of poses agree, as it is told.

use super::form::Reading;
use super::frames::{FixedFrame, worlds};
use crate::geometry::{Axes, Convention, Misreading, Pose, Vec3, angle_between};

/// What rounding and a nominal model may leave of poses that agree: rad and m.
pub(super) const AGREES_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
pub(super) const AGREES_M: f64 = 0.010;

/// Differences of this size, rad and m, count as one step; a third of it as none.
const STEP_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const STEP_M: f64 = 0.005;
const NO_STEP: f64 = 0.3;

// What an explanation pays for an inversion, in halvings of what is left.
const INVERSE: f64 = 2.0;
const TRANSPOSE: f64 = 2.5;

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

/// What lies between the two poses at one end.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// Nothing.
    None,
    /// Frames that are fixed to each other: at the base `but_from_is`, at the tip `is_from_but`.
    Frames(FixedFrame),
    /// A constant transform of the same sense, fitted to several pairs.
    Fitted(Pose),
}

impl End {
    /// The transform.
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

    /// Its size in doublings.
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

/// What would close what is left of one pair, which no one pair can confirm.
#[derive(Clone, Debug, PartialEq)]
pub struct WouldDo {
    /// A tool: `is_from_but` after the explanation's own steps.
    pub tool: Pose,
    /// Or an offset of the base: `but_from_is`.
    pub base: Pose,
    /// Whether it is a translation alone, the rotations being explained.
    pub is_translation: bool,
}

impl WouldDo {
    /// How far apart the positions are, and along what: `150.0 mm along tool z`. `None` where the rotations
    /// are apart, too.
    pub fn apart(&self) -> Option<String> {
        /// A distance is along an axis where so much of it is.
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

/// An explanation of the difference: B is `base · axes(inversion(A)) · tip`.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// How the one side, A, is read.
    pub is: Reading,
    /// How the other side, B, is read.
    pub but: Reading,
    /// What of A is turned round first.
    pub inversion: Inversion,
    /// The axes that B's whole world is written in, by those of A's.
    pub axes: Axes,
    /// The frames at the base.
    pub base: End,
    /// The frames at the tip.
    pub tip: End,
    /// Three numbers that were read in two ways on the way to the two poses.
    pub misreading: Option<Misreading>,
    /// What is left.
    pub residual: Residual,
    /// What is left and what was assumed, in doublings; the lower the better.
    pub score: f64,
    /// Other readings that leave as much.
    pub equivalents: Vec<[Reading; 2]>,
    /// Other names for the same change.
    pub also: Vec<String>,
}

impl Hypothesis {
    /// What it says, a clause each.
    pub fn claims(&self) -> Vec<String> {
        let mut claims = Vec::new();
        if let Some(Misreading { is, read_as }) = self.misreading {
            claims.push(format!(
                "A read three numbers as {}, B read the same numbers as {}",
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
        claims.extend(self.base.claim("in", "a constant offset of the base lies between them"));
        claims.extend(self.tip.claim("of", "a constant tool lies between them"));
        claims
    }

    /// Whether both sides can be read otherwise only in the same way: what differs between them is told.
    pub(super) fn tells_the_change(&self) -> bool {
        let is_alike = |[is, but]: &[Reading; 2]| is.form == but.form;
        self.equivalents.is_empty()
            || self.is.form == self.but.form && self.equivalents.iter().all(is_alike)
    }

    /// The pose that B should be where A is `is`.
    pub(super) fn expected(&self, is: &Pose) -> Pose {
        let axes = self.axes.of_pose(&self.inversion.of(is));
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

/// What other axes say, and whose they are.
fn said_of_axes(axes: Axes) -> Option<String> {
    if axes == Axes::STANDARD {
        return None;
    }
    let [x, y, z] = axes.inverse().standard_names(false);
    let whose = |axes: Axes| worlds().iter().find(|world| world.axes == axes);
    let whose = match (whose(axes), whose(axes.inverse())) {
        (Some(both), Some(_)) if axes == axes.inverse() => {
            format!(" ({}, one of the two)", both.who)
        }
        (Some(but), _) => format!(" (B: {})", but.who),
        (None, Some(is)) => format!(" (A: {})", is.who),
        (None, None) => String::new(),
    };
    let hand = if axes.are_left_handed() { ", the other hand" } else { "" };
    Some(format!("B's x, y, z are A's {x}, {y}, {z}, in world and body{hand}{whose}"))
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
    /// What would close what the first leaves of a single pair.
    pub would_do: Option<WouldDo>,
    /// How many ways to read the two rotations were tried.
    pub tried: usize,
    /// How many of as many random rotations would come as close, on average; of a single pair.
    pub by_chance: Option<f64>,
    /// What to look out for.
    pub notes: Vec<String>,
}
