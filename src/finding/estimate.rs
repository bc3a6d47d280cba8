//! Estimates in reports: a value with its interval, or a misinterpretation.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::deserialize::{Word, deserialize_number, deserialize_word};
use super::unit::Unit;
use crate::stats::{Measured, MeasuredLength};
use crate::time::Stamp;

/// An estimated value or a misinterpretation, as specified by the contract's table of estimates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Estimate {
    /// A length and an angle: the norms of a frame error, or two rms values.
    Frame {
        /// Name of the quantity.
        #[serde(deserialize_with = "deserialize_word")]
        name: Word,
        /// Length, m.
        #[serde(deserialize_with = "deserialize_number")]
        #[schemars(with = "Option<f64>")]
        value: f64,
        /// SI symbol of `value`.
        #[serde(deserialize_with = "deserialize_word")]
        unit: Word,
        /// 95 % interval of `value`.
        ci95: Option<[f64; 2]>,
        /// Angle, rad.
        rotation: Angle,
        /// The change, if the quantity is not constant over the run.
        #[serde(flatten, skip_serializing_if = "Option::is_none")]
        change: Option<Change>,
    },
    /// A scalar.
    Scalar {
        /// Name of the quantity.
        #[serde(deserialize_with = "deserialize_word")]
        name: Word,
        /// Value, in `unit`.
        #[serde(deserialize_with = "deserialize_number")]
        #[schemars(with = "Option<f64>")]
        value: f64,
        /// SI symbol.
        #[serde(deserialize_with = "deserialize_word")]
        unit: Word,
        /// 95 % interval.
        ci95: Option<[f64; 2]>,
        /// The change, if the quantity is not constant over the run.
        #[serde(flatten, skip_serializing_if = "Option::is_none")]
        change: Option<Change>,
        /// Relation of the joint's error, for a joint that is coupled or off by turns.
        #[serde(flatten)]
        joint: JointRelation,
    },
    /// Three rotation numbers interpreted in the wrong convention.
    Convention {
        /// Always `convention`.
        #[serde(deserialize_with = "deserialize_word")]
        name: Word,
        /// Convention of the numbers.
        is: String,
        /// Assumed convention.
        read_as: String,
        /// Interpretations that are indistinguishable in any log or in this one.
        equivalent: Vec<Interpretation>,
        /// The next best interpretation, with the ratio of its residual to the best.
        runner_up: Option<RunnerUp>,
    },
    /// One of two alternatives mistaken for the other.
    Misinterpretation {
        /// Name of the quantity.
        #[serde(deserialize_with = "deserialize_word")]
        name: Word,
        /// Actual value.
        is: Cow<'static, str>,
        /// Value assumed by the reader.
        read_as: Cow<'static, str>,
    },
    /// Numbers published under the wrong names.
    Order {
        /// Name of the quantity.
        #[serde(deserialize_with = "deserialize_word")]
        name: Word,
        /// Joints in the order of the numbers.
        is: Vec<String>,
        /// Joints in the order of the names.
        read_as: Vec<String>,
        /// Same as `is`: the names in the order of the numbers.
        permutation: Vec<String>,
    },
}

impl Estimate {
    /// Value in SI units; `None` for misinterpretations.
    pub fn value(&self) -> Option<f64> {
        match self {
            Estimate::Scalar { value, .. } | Estimate::Frame { value, .. } => Some(*value),
            Estimate::Convention { .. }
            | Estimate::Misinterpretation { .. }
            | Estimate::Order { .. } => None,
        }
    }

    /// Name of the quantity.
    pub(crate) fn name(&self) -> Word {
        match *self {
            Estimate::Scalar { name, .. }
            | Estimate::Frame { name, .. }
            | Estimate::Convention { name, .. }
            | Estimate::Misinterpretation { name, .. }
            | Estimate::Order { name, .. } => name,
        }
    }

    /// The scalar, or the length and the angle, if it was compared; none of a misinterpretation.
    pub(crate) fn amounts(&self) -> Vec<Amount> {
        match *self {
            Estimate::Scalar { name, value, unit: symbol, ci95, .. } => {
                vec![Amount { name, symbol, value, ci95 }]
            }
            Estimate::Frame { name, value, unit: symbol, ci95, rotation, .. } => {
                let Angle { value: angle, ci95: angle_ci95 } = rotation;
                let radian = Unit::Radian.symbol();
                let angle = Amount { name, symbol: radian, value: angle, ci95: angle_ci95 };
                let length = Amount { name, symbol, value, ci95 };
                let angle = Some(angle).filter(|angle| !angle.value.is_nan());
                std::iter::once(length).chain(angle).collect()
            }
            Estimate::Convention { .. }
            | Estimate::Misinterpretation { .. }
            | Estimate::Order { .. } => Vec::new(),
        }
    }

    /// What the numbers are, and as what they were read; `None` for amounts.
    pub(crate) fn interpretation(&self) -> Option<[String; 2]> {
        match self {
            Estimate::Scalar { .. } | Estimate::Frame { .. } => None,
            Estimate::Convention { is, read_as, .. } => Some([is.clone(), read_as.clone()]),
            Estimate::Misinterpretation { is, read_as, .. } => {
                Some([is.to_string(), read_as.to_string()])
            }
            Estimate::Order { is, read_as, .. } => Some([is.join(", "), read_as.join(", ")]),
        }
    }

    /// Actual and assumed convention; `None` for other estimates.
    pub fn convention(&self) -> Option<(&str, &str)> {
        match self {
            Estimate::Convention { is, read_as, .. } => Some((is, read_as)),
            _ => None,
        }
    }

    /// An estimate of a misinterpretation.
    pub fn misinterpretation(
        name: &'static str,
        is: impl Into<Cow<'static, str>>,
        read_as: impl Into<Cow<'static, str>>,
    ) -> Self {
        Estimate::Misinterpretation { name, is: is.into(), read_as: read_as.into() }
    }

    /// An estimate of a scalar.
    pub fn scalar(name: &'static str, unit: Unit, measured: &Measured) -> Self {
        Self::new_scalar(name, unit.symbol(), measured.value, unit.interval95(measured))
    }

    /// A scalar that was counted rather than estimated, so it has no interval.
    pub fn exact(name: &'static str, unit: &'static str, value: f64) -> Self {
        Self::new_scalar(name, unit, value, None)
    }

    /// An estimate of a length, which cannot be negative.
    pub fn length(name: &'static str, unit: Unit, length: &MeasuredLength) -> Self {
        let norm = &length.norm;
        Self::new_scalar(name, unit.symbol(), norm.value, interval_of_norm(unit, norm))
    }

    fn new_scalar(name: Word, unit: Word, value: f64, ci95: Option<[f64; 2]>) -> Self {
        Estimate::Scalar { name, value, unit, ci95, change: None, joint: JointRelation::default() }
    }

    /// An estimate of a length in m and an angle in rad; neither can be negative.
    pub fn frame(name: &'static str, length: &Measured, angle: &Measured) -> Self {
        Estimate::Frame {
            name,
            value: length.value,
            unit: Unit::Metre.symbol(),
            ci95: interval_of_norm(Unit::Metre, length),
            rotation: Angle { value: angle.value, ci95: interval_of_norm(Unit::Radian, angle) },
            change: None,
        }
    }

    /// Marks the quantity as changing during the run; `value` is then the size of the change.
    pub fn with_change(mut self, when: Change) -> Self {
        if let Estimate::Scalar { change, .. } | Estimate::Frame { change, .. } = &mut self {
            *change = Some(when);
        }
        self
    }

    /// Marks the joint as coupled: it moves by `factor` per unit of the joint `with`.
    pub fn with_coupling(mut self, with: &str, factor: f64) -> Self {
        if let Estimate::Scalar { joint, .. } = &mut self {
            *joint = JointRelation {
                with: Some(with.to_owned()),
                factor: Some(factor),
                ..JointRelation::default()
            };
        }
        self
    }

    /// Marks the joint as off by this many turns.
    pub fn with_turns(mut self, turns: f64) -> Self {
        if let Estimate::Scalar { joint, .. } = &mut self {
            joint.turns = Some(turns);
        }
        self
    }

    /// The change during the run; `None` if the quantity is constant.
    pub fn change(&self) -> Option<&Change> {
        match self {
            Estimate::Scalar { change, .. } | Estimate::Frame { change, .. } => change.as_ref(),
            Estimate::Convention { .. }
            | Estimate::Misinterpretation { .. }
            | Estimate::Order { .. } => None,
        }
    }
}

/// One amount of an estimate, in SI units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amount {
    /// Name of the estimate.
    pub name: Word,
    /// SI symbol.
    pub symbol: Word,
    pub value: f64,
    pub ci95: Option<[f64; 2]>,
}

impl Amount {
    /// `None` if the symbol is unknown.
    pub fn unit(&self) -> Option<Unit> {
        Unit::from_symbol(self.symbol, self.name)
    }
}

/// 95 % interval of a quantity that cannot be negative.
fn interval_of_norm(unit: Unit, norm: &Measured) -> Option<[f64; 2]> {
    Some(unit.interval95(norm)?.map(|end| end.max(0.0)))
}

/// Further properties of a joint's error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JointRelation {
    /// Joint that drives this one, if they are coupled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub with: Option<String>,
    /// Motion of this joint per unit of `with`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor: Option<f64>,
    /// Error of the positions in turns: 1, 0.5 or 0.25, unsigned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turns: Option<f64>,
}

/// A change of a quantity from one value to another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Change {
    /// Value before, in the unit of the estimate's `value`.
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub from: f64,
    /// Value after, in the same unit.
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub to: f64,
    /// Time of the change.
    #[schemars(with = "String")]
    pub change_ns: Stamp,
    /// 95 % interval of the time.
    #[schemars(with = "Option<[String; 2]>")]
    pub change_ci95_ns: Option<[Stamp; 2]>,
}

/// Angle of a frame estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Angle {
    /// Angle, rad.
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub value: f64,
    /// 95 % interval, rad.
    pub ci95: Option<[f64; 2]>,
}

/// Actual and assumed interpretation of numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "ReadAs")]
pub struct Interpretation {
    /// Actual interpretation.
    pub is: String,
    /// Assumed interpretation.
    pub read_as: String,
}

/// The second-best interpretation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunnerUp {
    /// Actual interpretation according to it.
    pub is: String,
    /// Assumed interpretation according to it.
    pub read_as: String,
    /// Ratio of its residual to the best interpretation's.
    #[serde(deserialize_with = "deserialize_number")]
    #[schemars(with = "Option<f64>")]
    pub ratio: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn non_finite_numbers_become_null() -> Result<(), serde_json::Error> {
        let estimate = Estimate::scalar(
            "latency",
            Unit::Second,
            &Measured { value: f64::NAN, std_error: 1.0, dof: 1e6 },
        );
        let json = serde_json::to_string(&estimate)?;
        assert_eq!(json, r#"{"name":"latency","value":null,"unit":"s","ci95":null}"#);
        Ok(())
    }

    #[test]
    fn an_angle_that_was_not_compared_is_null_and_not_shown() -> Result<(), serde_json::Error> {
        let length = Measured { value: 0.001, std_error: 0.0, dof: 1e6 };
        let unknown = Measured { value: f64::NAN, std_error: f64::INFINITY, dof: f64::INFINITY };
        let estimate = Estimate::frame("residual", &length, &unknown);
        let json = serde_json::to_string(&estimate)?;
        assert!(json.contains(r#""rotation":{"value":null,"ci95":null}"#), "{json}");
        assert_eq!(estimate.amounts().len(), 1);
        Ok(())
    }

    #[test]
    fn a_change_has_both_values_and_its_time() -> Result<(), serde_json::Error> {
        let at = Stamp::from_nanos;
        let estimate = Estimate::exact("gyro bias", "rad/s", 0.25).with_change(Change {
            from: 0.5,
            to: 0.75,
            change_ns: at(3),
            change_ci95_ns: Some([at(2), at(4)]),
        });
        let json = serde_json::to_string(&estimate)?;
        let whole = r#"{"name":"gyro bias","value":0.25,"unit":"rad/s","ci95":null,"from":0.5,"#;
        assert_eq!(
            json,
            format!(r#"{whole}"to":0.75,"change_ns":"3","change_ci95_ns":["2","4"]}}"#)
        );
        assert_eq!(serde_json::from_str::<Estimate>(&json)?, estimate);
        Ok(())
    }
}
