//! Estimates for the joint states.

use crate::{EstimateResult, HeldOutResidual, UnitResiduals};
use ground::stats::Measured;

/// Zero offset of one joint: `q_true = q_reported + offset`.
#[derive(Clone, Debug)]
pub struct JointOffset {
    /// Offset, rad or m.
    pub offset: EstimateResult<Measured>,
    /// Whether the model contains it.
    pub is_chosen: bool,
    /// Displacement of the tip at full reach.
    pub effect_m: f64,
    /// Axis to tip at full reach, m/rad; 1 if prismatic.
    pub lever_m: f64,
    /// Causes that this log cannot distinguish.
    pub confounders: Vec<Confounder>,
    /// Prediction of held-out samples, if the model contains it.
    pub held_out: Option<HeldOutResidual>,
}

impl JointOffset {
    /// Offset in the model; 0 if the model does not contain it.
    pub(crate) fn chosen(&self) -> f64 {
        self.offset.as_ref().ok().filter(|_| self.is_chosen).map_or(0.0, |offset| offset.value)
    }
}

/// Encoding of the joint states; as logged by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointEncoding {
    /// Whether all revolute joints are in degrees.
    pub is_in_degrees: bool,
    /// Actual order: entry `i` is the joint logged under the name of joint `i`.
    pub permutation: Option<Vec<usize>>,
    /// Joints with individual unit or scale.
    pub unit_errors: Vec<JointUnitError>,
    /// Applied after the slips.
    pub couplings: Vec<JointCoupling>,
    /// Approximate zeros to add per joint, rad or m; may be empty.
    pub zeros: Vec<f64>,
    /// Position residuals, m, if the search did not accept the joint states as logged.
    pub residual: Option<UnitResiduals>,
    /// Residual of the next best encoding.
    pub runner_up_m: Option<f64>,
}

impl JointEncoding {
    /// One joint is reversed, which leaves this residual of the positions.
    pub(crate) fn reversed(column: usize, residual_m: f64) -> Self {
        let unit_error = JointUnitError { column, unit: JointUnit::Scaled, factor: -1.0 };
        let residual = UnitResiduals { as_logged: residual_m, corrected: residual_m };
        Self { unit_errors: vec![unit_error], residual: Some(residual), ..Self::default() }
    }

    /// Approximate scale of a joint with an individual unit or scale.
    pub(crate) fn factor(&self, column: usize) -> f64 {
        let own = self.unit_errors.iter().find(|error| error.column == column);
        own.map_or(1.0, |error| error.factor)
    }

    /// With estimated scales, and with these couplings.
    pub(crate) fn refined(&self, scales: &[JointScale], couplings: Vec<JointCoupling>) -> Self {
        let mut refined = Self { couplings, ..self.clone() };
        for error in &mut refined.unit_errors {
            let scale = scales.iter().find(|scale| scale.column == error.column);
            error.factor = scale.map_or(error.factor, |scale| scale.factor.value);
        }
        refined
    }

    /// Apart from zeros.
    pub fn is_as_logged(&self) -> bool {
        !self.is_in_degrees
            && self.permutation.is_none()
            && self.unit_errors.is_empty()
            && self.couplings.is_empty()
    }

    /// Whether it differs by more than scales near 1 and couplings.
    pub(crate) fn is_far_from_logged(&self) -> bool {
        /// Usual gear ratios are larger.
        const MAX_SCALE_ERROR: f64 = 0.1;
        let is_far = |error: &JointUnitError| (error.factor - 1.0).abs() > MAX_SCALE_ERROR;
        self.is_in_degrees || self.permutation.is_some() || self.unit_errors.iter().any(is_far)
    }

    /// Same units, order and couplings, whatever the amounts.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        let kind = |it: &Self| {
            let units = it.unit_errors.iter().map(|error| (error.column, error.unit));
            let couplings = it.couplings.iter().map(|coupling| (coupling.column, coupling.by));
            let (units, couplings): (Vec<_>, Vec<_>) = (units.collect(), couplings.collect());
            (it.is_in_degrees, it.permutation.clone(), units, couplings)
        };
        kind(self) == kind(other)
    }

    /// Joints with this unit, with the residual as logged and as corrected.
    pub fn unit_errors(
        &self,
        unit: JointUnit,
    ) -> impl Iterator<Item = (&JointUnitError, UnitResiduals)> {
        let residuals = self.residual.into_iter();
        residuals.flat_map(move |residuals| {
            let own = self.unit_errors.iter().filter(move |unit_error| unit_error.unit == unit);
            own.map(move |unit_error| (unit_error, residuals))
        })
    }
}

/// Joint coupled to another: `q_true[column] = q_reported[column] + factor · q_reported[by]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointCoupling {
    /// Driven joint.
    pub column: usize,
    /// Driving joint.
    pub by: usize,
    /// Per radian of the driving joint.
    pub factor: Measured,
}

impl JointCoupling {
    /// Whether the factor is ±1, as if the angle is from the horizon.
    pub fn is_round(&self) -> bool {
        is_round(self.factor.value)
    }
}

/// Joint whose values need a scale factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointUnitError {
    /// Joint's column.
    pub column: usize,
    /// Unit of its values.
    pub unit: JointUnit,
    /// Factor to rad or m; approximate for `Scaled`.
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
    /// Reversed, geared, ticks, or shares of the range.
    Scaled,
}

/// Scale and direction of a joint: `q_true = factor · q_reported + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointScale {
    /// Joint's column.
    pub column: usize,
    /// 1 for rad or m.
    pub factor: Measured,
    /// Offset, rad or m; 0 if the zero is right.
    pub offset: f64,
}

impl JointScale {
    /// Whether the values are ticks, a percentage or similar. Their zero is then part of the encoding and
    /// no fault.
    pub fn is_coded(&self) -> bool {
        is_coded(self.factor.value)
    }

    /// Whether the factor or its reciprocal is an integer.
    pub fn is_round(&self) -> bool {
        let size = self.factor.value.abs();
        is_round(size.max(size.recip()))
    }
}

/// Integers within 1 %: reversed, geared or coupled joints.
fn is_round(factor: f64) -> bool {
    const ROUND_TOLERANCE: f64 = 0.01;
    let size = factor.abs();
    size.round() > 0.0 && (size - size.round()).abs() < ROUND_TOLERANCE * size
}

/// Whether the values are neither angles nor lengths.
pub(super) fn is_coded(factor: f64) -> bool {
    /// Between motor and joint; its reciprocal likewise.
    const MAX_GEAR_RATIO: f64 = 4.0;
    !(1.0 / MAX_GEAR_RATIO..=MAX_GEAR_RATIO).contains(&factor.abs())
}

/// Cause with the same effect on this log. Joints are indices in the chain, poses stream indices; rad or m.
#[derive(Clone, Debug, PartialEq)]
pub enum Confounder {
    /// Zero offset of a joint.
    JointZero(usize, f64),
    /// Reference frame of a pose stream.
    Reference(usize, f64),
    /// Tool frame of a pose stream.
    Tool(usize, f64),
    /// Joint's maximum over the run.
    Sag(usize, f64),
}

impl Confounder {
    /// Whether both are the same end of the same stream.
    pub(crate) fn is_same_frame(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Reference(one, _), Self::Reference(other, _))
            | (Self::Tool(one, _), Self::Tool(other, _)) => one == other,
            _ => false,
        }
    }
}
