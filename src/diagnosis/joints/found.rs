//! What is estimated on joint states.

use crate::{Seen, UnitSlip};
use ground::stats::Measured;

/// The zero offset of one joint: `q_true = q_reported + offset`.
#[derive(Clone, Debug)]
pub struct JointOffset {
    /// The offset, rad or m.
    pub offset: Seen<Measured>,
    /// Whether the smallest explanation of the log contains it.
    pub chosen: bool,
    /// What the offset moves the tip by at full stretch, m.
    pub effect_m: f64,
    /// Distance from the joint's axis to the tip at full stretch, m a rad; 1 where it slides.
    pub lever_m: f64,
    /// Causes that this log cannot tell from it.
    pub twins: Vec<Twin>,
}

/// How the joint states must be read; as logged by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointReading {
    /// Whether the positions of all turning joints are degrees.
    pub degrees: Option<UnitSlip>,
    /// The order that positions are really in: entry `i` is the index of the joint whose position
    /// stands under the name of joint `i`.
    pub permutation: Option<(Vec<usize>, UnitSlip)>,
    /// Joints whose numbers are of another unit or scale, each by itself.
    pub slips: Vec<JointSlip>,
    /// Joints that move with another joint, applied after the slips.
    pub couplings: Vec<JointCoupling>,
    /// What then must be added to each joint's positions about, rad or m; empty where nothing.
    pub zeros: Vec<f64>,
    /// Residual of the positions as logged and so read, m, where they are not read as logged.
    pub left: Option<UnitSlip>,
    /// Residual of the next best reading, m.
    pub runner_up_m: Option<f64>,
}

impl JointReading {
    /// Whether the numbers mean what they say, up to their zeros.
    pub fn is_as_logged(&self) -> bool {
        self.degrees.is_none()
            && self.permutation.is_none()
            && self.slips.is_empty()
            && self.couplings.is_empty()
    }

    /// The joints whose numbers alone are of one unit, with what is left as logged and so read.
    pub fn slips_of(&self, unit: JointUnit) -> impl Iterator<Item = (&JointSlip, UnitSlip)> {
        let left = self.left.into_iter();
        left.flat_map(move |left| {
            let own = self.slips.iter().filter(move |slip| slip.unit == unit);
            own.map(move |slip| (slip, left))
        })
    }
}

/// A joint that moves with another one: `q_true[column] = q_reported[column] + factor · q_reported[by]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointCoupling {
    /// The joint's column.
    pub column: usize,
    /// The column of the joint that drives it.
    pub by: usize,
    /// Radians of the joint per radian of the driving joint.
    pub factor: Measured,
}

impl JointCoupling {
    /// Whether the joint moves by exactly as much as the driving joint, as in a controller that counts
    /// the joint's angle from the horizon.
    pub fn is_round(&self) -> bool {
        is_round(self.factor.value)
    }
}

/// A joint whose numbers must be multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSlip {
    /// The joint's column.
    pub column: usize,
    /// What its numbers are.
    pub unit: JointUnit,
    /// What takes its numbers to rad or m; of a scale about that.
    pub factor: f64,
}

/// What a joint's numbers are in the place of rad or m.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointUnit {
    /// Degrees.
    Degrees,
    /// Millimetres.
    Millimetres,
    /// Centimetres.
    Centimetres,
    /// Reversed, behind a gear, ticks, shares of the range.
    Scaled,
}

/// The scale and direction of a joint: `q_true = factor · q_reported + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointScale {
    /// The joint's column.
    pub column: usize,
    /// The factor, 1 for rad or m.
    pub factor: Measured,
    /// The offset that belongs to it, rad or m; 0 where the zero is right.
    pub offset: f64,
}

impl JointScale {
    /// Whether the joint's numbers are of another kind than rad or m, such as ticks or a percentage,
    /// so that their zero is a part of what they mean and no fault of its own.
    pub fn is_coded(&self) -> bool {
        is_coded(self.factor.value)
    }

    /// Whether the factor is a whole number, or one part of one, as of a reversed joint or a gear.
    pub fn is_round(&self) -> bool {
        let size = self.factor.value.abs();
        is_round(size.max(size.recip()))
    }
}

/// Whether a factor is a whole number within 1 %, as of reversed, geared or coupled joints.
fn is_round(factor: f64) -> bool {
    const SHARE: f64 = 0.01;
    let size = factor.abs();
    size.round() > 0.0 && (size - size.round()).abs() < SHARE * size
}

/// Whether a joint's numbers that must be multiplied by `factor` are of another kind than rad or m.
pub(super) fn is_coded(factor: f64) -> bool {
    /// A gear between a motor and its joint, or its inverse, counts as one up to this.
    const GEAR: f64 = 4.0;
    !(1.0 / GEAR..=GEAR).contains(&factor.abs())
}

/// A cause that does to this log what another one does.
#[derive(Clone, Debug, PartialEq)]
pub enum Twin {
    /// Zero offset of a joint (index in the chain), rad or m.
    JointZero(usize, f64),
    /// Rotation or shift of the reference frame of pose stream `usize`: amount in rad or m.
    Reference(usize, f64),
    /// Rotation or shift of the tool frame of pose stream `usize`: amount in rad or m.
    Tool(usize, f64),
    /// Sag of a joint (index in the chain): the largest over the run, rad.
    Sag(usize, f64),
}
