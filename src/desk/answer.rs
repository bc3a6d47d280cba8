//! What makes pairs of poses agree, as it is told.

use super::form::Reading;
use super::frames::FixedFrame;
use crate::geometry::{Misreading, Pose, angle_between};

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

/// The pose that `but` should be where the one side is `is`.
pub(super) fn expected(hypothesis: &Hypothesis, is: &Pose) -> Pose {
    let base = hypothesis.base.as_ref().map_or(Pose::identity(), |base| base.transform);
    let tool = match &hypothesis.tool {
        Tool::None => Pose::identity(),
        Tool::Frames(tip) => tip.transform,
        Tool::Fitted(tool) => *tool,
    };
    base * hypothesis.inversion.of(is) * tool
}
