//! Estimates for the joint states.

use crate::{EstimateResult, UnitResiduals};
use ground::stats::Measured;

/// Zero offset of one joint: `q_true = q_reported + offset`.
#[derive(Clone, Debug)]
pub struct JointOffset {
    /// Offset, rad or m.
    pub offset: EstimateResult<Measured>,
    /// Whether the selected model contains it.
    pub is_chosen: bool,
    /// Displacement of the tip by the offset at full reach, m.
    pub effect_m: f64,
    /// Distance from the joint's axis to the tip at full reach, m/rad; 1 for a prismatic joint.
    pub lever_m: f64,
    /// Confounders: causes that this log cannot distinguish from it.
    pub confounders: Vec<Confounder>,
}

/// Encoding of the joint states; as logged by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointEncoding {
    /// Set if the positions of all revolute joints are in degrees.
    pub degrees: Option<UnitResiduals>,
    /// Actual order of the positions: entry `i` is the index of the joint whose position is logged under
    /// the name of joint `i`.
    pub permutation: Option<(Vec<usize>, UnitResiduals)>,
    /// Joints with an individual unit or scale.
    pub unit_errors: Vec<JointUnitError>,
    /// Couplings, applied after the slips.
    pub couplings: Vec<JointCoupling>,
    /// Approximate zero to add to each joint's positions, rad or m; empty if there is none.
    pub zeros: Vec<f64>,
    /// Position residual as logged and as corrected, m, if the encoding differs from the logged one.
    pub residual: Option<UnitResiduals>,
    /// Residual of the next best encoding, m.
    pub runner_up_m: Option<f64>,
}

impl JointEncoding {
    /// Whether the encoding is as logged, apart from zeros.
    pub fn is_as_logged(&self) -> bool {
        self.degrees.is_none()
            && self.permutation.is_none()
            && self.unit_errors.is_empty()
            && self.couplings.is_empty()
    }

    /// Joints with this individual unit, with the residual as logged and as corrected.
    pub fn unit_errors(
        &self,
        unit: JointUnit,
    ) -> impl Iterator<Item = (&JointUnitError, UnitResiduals)> {
        let left = self.residual.into_iter();
        left.flat_map(move |left| {
            let own = self.unit_errors.iter().filter(move |slip| slip.unit == unit);
            own.map(move |slip| (slip, left))
        })
    }
}

/// Joint coupled to another: `q_true[column] = q_reported[column] + factor · q_reported[by]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointCoupling {
    /// Column of the driven joint.
    pub column: usize,
    /// Column of the driving joint.
    pub by: usize,
    /// Radians of the driven joint per radian of the driving joint.
    pub factor: Measured,
}

impl JointCoupling {
    /// Whether the factor is ±1, as for a controller that reports the joint's angle from the horizon.
    pub fn is_round(&self) -> bool {
        is_round(self.factor.value)
    }
}

/// Joint whose values need a scale factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointUnitError {
    /// Column of the joint.
    pub column: usize,
    /// Unit of its values.
    pub unit: JointUnit,
    /// Factor from logged values to rad or m; approximate for `Scaled`.
    pub factor: f64,
}

/// Unit of a joint's values, if not rad or m.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointUnit {
    /// Degrees.
    Degrees,
    /// Millimetres.
    Millimetres,
    /// Centimetres.
    Centimetres,
    /// Reversed, geared, encoder ticks, or shares of the range.
    Scaled,
}

/// Scale and direction of a joint: `q_true = factor · q_reported + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointScale {
    /// Column of the joint.
    pub column: usize,
    /// Factor, 1 for rad or m.
    pub factor: Measured,
    /// Associated offset, rad or m; 0 if the zero is right.
    pub offset: f64,
}

impl JointScale {
    /// Whether the values are not angles or lengths but, for example, ticks or a percentage. Their zero is
    /// then part of the encoding and not a fault.
    pub fn is_coded(&self) -> bool {
        is_coded(self.factor.value)
    }

    /// Whether the factor is an integer or its reciprocal, as for a reversed joint or a gear.
    pub fn is_round(&self) -> bool {
        let size = self.factor.value.abs();
        is_round(size.max(size.recip()))
    }
}

/// Whether a factor is an integer within 1 %, as for reversed, geared or coupled joints.
fn is_round(factor: f64) -> bool {
    const ROUND_TOLERANCE: f64 = 0.01;
    let size = factor.abs();
    size.round() > 0.0 && (size - size.round()).abs() < ROUND_TOLERANCE * size
}

/// Whether values with this scale factor are not angles or lengths.
pub(super) fn is_coded(factor: f64) -> bool {
    /// Factors up to this, or its reciprocal, are gear ratios between motor and joint.
    const MAX_GEAR_RATIO: f64 = 4.0;
    !(1.0 / MAX_GEAR_RATIO..=MAX_GEAR_RATIO).contains(&factor.abs())
}

/// Confounder: a cause with the same effect on this log.
#[derive(Clone, Debug, PartialEq)]
pub enum Confounder {
    /// Zero offset of a joint (index in the chain), rad or m.
    JointZero(usize, f64),
    /// Rotation or shift of the reference frame of pose stream `usize`, rad or m.
    Reference(usize, f64),
    /// Rotation or shift of the tool frame of pose stream `usize`, rad or m.
    Tool(usize, f64),
    /// Sag of a joint (index in the chain): maximum over the run, rad.
    Sag(usize, f64),
}
