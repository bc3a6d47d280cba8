//! Joint types, limits and declarations.

use crate::geometry::{Pose, Vec3};

/// Type of motion of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// About its axis between limits, rad.
    Revolute,
    /// About its axis without limits, rad.
    Continuous,
    /// Along its axis, m.
    Prismatic,
    /// Does not move.
    Fixed,
    /// Not supported in a chain.
    Floating,
    /// Not supported in a chain.
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

    /// Name in URDF.
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

    /// From a URDF name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether one number is its position.
    pub const fn has_position(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

/// Largest length, position or factor: 1000 km, or as many turns. Squares and sums stay finite and accurate
/// to a micrometre.
pub(super) const MAX_MAGNITUDE: f64 = 1e6;

/// Stated limits of a joint: rad and rad/s, or m and m/s if prismatic.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Limits {
    /// Lowest position.
    pub lower: Option<f64>,
    /// Highest position.
    pub upper: Option<f64>,
    /// Highest speed.
    pub velocity: Option<f64>,
}

impl Limits {
    /// Removes limits without effect, such as 1e308.
    pub(super) fn within_reason(self) -> Self {
        let kept = |limit: Option<f64>| limit.filter(|limit| limit.abs() <= MAX_MAGNITUDE);
        Self { lower: kept(self.lower), upper: kept(self.upper), velocity: kept(self.velocity) }
    }
}

/// URDF's `<mimic>`: `position = multiplier · master's position + offset`.
#[derive(Debug, Clone, PartialEq)]
pub struct Mimic {
    /// Driving joint.
    pub joint: String,
    /// Factor.
    pub multiplier: f64,
    /// Offset, rad or m.
    pub offset: f64,
}

pub(super) struct LinkDraft {
    pub name: String,
    pub at: usize,
}

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
