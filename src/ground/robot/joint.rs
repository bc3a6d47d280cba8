//! Joints: how they move, within which limits, and as a text declares them.

use crate::geometry::{Pose, Vec3};

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its axis between limits, rad.
    Revolute,
    /// Turns about its axis without end, rad.
    Continuous,
    /// Slides along its axis, m.
    Prismatic,
    /// Does not move.
    Fixed,
    /// Moves freely; no chain leads over it.
    Floating,
    /// Moves in a plane; no chain leads over it.
    Planar,
}

impl JointKind {
    const ALL: [JointKind; 6] = [
        Self::Revolute,
        Self::Continuous,
        Self::Prismatic,
        Self::Fixed,
        Self::Floating,
        Self::Planar,
    ];

    /// The name that URDF gives it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Revolute => "revolute",
            Self::Continuous => "continuous",
            Self::Prismatic => "prismatic",
            Self::Fixed => "fixed",
            Self::Floating => "floating",
            Self::Planar => "planar",
        }
    }

    /// The kind of that URDF name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether one number says where the joint stands.
    pub const fn has_position(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// No length, position or factor of a model is beyond this: 1000 km, or as many turns. Squares and sums
/// of what is taken stay finite, and exact to a micrometre.
pub(super) const MOST: f64 = 1e6;

/// A joint's limits, each where the model states it: rad and rad/s, or m and m/s if prismatic.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// The lowest position.
    pub lower: Option<f64>,
    /// The highest position.
    pub upper: Option<f64>,
    /// The highest speed.
    pub velocity: Option<f64>,
}

impl Limits {
    /// The limits that limit anything: 1e308 says that there is none.
    pub(super) fn within_reason(self) -> Self {
        let kept = |limit: Option<f64>| limit.filter(|limit| limit.abs() <= MOST);
        Self { lower: kept(self.lower), upper: kept(self.upper), velocity: kept(self.velocity) }
    }
}

/// `position = multiplier · master's position + offset`, as URDF's `<mimic>`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mimic {
    /// The name of the driving joint.
    pub joint: String,
    /// The factor on its position.
    pub multiplier: f64,
    /// What is added, rad or m.
    pub offset: f64,
}

/// A name and where in the text it was declared, byte offset.
pub(super) struct LinkDraft {
    pub name: String,
    pub at: usize,
}

/// A joint as read, its links still names.
pub(super) struct JointDraft {
    pub name: String,
    pub kind: JointKind,
    pub parent: String,
    pub child: String,
    pub parent_from_joint: Pose,
    pub axis: Vec3,
    pub limits: Limits,
    pub mimic: Option<Mimic>,
    pub at: usize,
}
