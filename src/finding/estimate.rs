//! Estimates, as reports have them: an amount, or what numbers are and what they were read as.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::read::{Word, number, word};
use super::unit::Unit;
use crate::stats::{Length, Measured};
use crate::time::Stamp;

/// An amount, or a reading, as the contract's table of estimates has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Estimate {
    /// A length and an angle: the norms of a frame error, or two rms.
    Frame {
        /// What it is.
        #[serde(deserialize_with = "word")]
        name: Word,
        /// Length, m.
        #[serde(deserialize_with = "number")]
        #[schemars(with = "Option<f64>")]
        value: f64,
        /// SI symbol of `value`.
        #[serde(deserialize_with = "word")]
        unit: Word,
        /// 95 % interval of `value`.
        ci95: Option<[f64; 2]>,
        /// The angle, rad.
        rotation: Angle,
        /// When it changes, where it is not one over the run.
        #[serde(flatten, skip_serializing_if = "Option::is_none")]
        change: Option<Change>,
    },
    /// One number.
    Amount {
        /// What it is.
        #[serde(deserialize_with = "word")]
        name: Word,
        /// The number, in `unit`.
        #[serde(deserialize_with = "number")]
        #[schemars(with = "Option<f64>")]
        value: f64,
        /// SI symbol.
        #[serde(deserialize_with = "word")]
        unit: Word,
        /// 95 % interval.
        ci95: Option<[f64; 2]>,
        /// When it changes, where it is not one over the run.
        #[serde(flatten, skip_serializing_if = "Option::is_none")]
        change: Option<Change>,
        /// How the joint's positions are wrong, for a joint that is coupled or off by turns.
        #[serde(flatten)]
        joint: JointRelation,
    },
    /// Three numbers that are of one convention, and that somebody read as another.
    Convention {
        /// Always `convention`.
        #[serde(deserialize_with = "word")]
        name: Word,
        /// What the numbers are.
        is: String,
        /// What they were read as.
        read_as: String,
        /// Readings that no log, or not this one, can tell from it.
        equivalent: Vec<ReadAs>,
        /// The next best reading, and how many times more it leaves.
        runner_up: Option<RunnerUp>,
    },
    /// One of two ways to write the same thing, taken for the other.
    Slip {
        /// What was mixed up.
        #[serde(deserialize_with = "word")]
        name: Word,
        /// What it is.
        is: Cow<'static, str>,
        /// What it was read as.
        read_as: Cow<'static, str>,
    },
    /// Numbers that stand under the wrong names.
    Order {
        /// What is out of order.
        #[serde(deserialize_with = "word")]
        name: Word,
        /// Whose number stands at each place.
        is: Vec<String>,
        /// Whose name stands at each place.
        read_as: Vec<String>,
        /// The same as `is`: the names in the order that the numbers are in.
        permutation: Vec<String>,
    },
}

impl Estimate {
    /// The number, in SI units, where it is one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Estimate::Amount { value, .. } | Estimate::Frame { value, .. } => Some(*value),
            Estimate::Convention { .. } | Estimate::Slip { .. } | Estimate::Order { .. } => None,
        }
    }

    /// What the numbers are and what they were read as, where it is a convention.
    pub fn convention(&self) -> Option<(&str, &str)> {
        match self {
            Estimate::Convention { is, read_as, .. } => Some((is, read_as)),
            _ => None,
        }
    }

    /// The estimate of what was taken for something else.
    pub fn slip(
        name: &'static str,
        is: impl Into<Cow<'static, str>>,
        read_as: impl Into<Cow<'static, str>>,
    ) -> Self {
        Estimate::Slip { name, is: is.into(), read_as: read_as.into() }
    }

    /// The estimate of one number.
    pub fn amount(name: &'static str, unit: Unit, measured: &Measured) -> Self {
        Estimate::Amount {
            name,
            value: measured.value,
            unit: unit.symbol(),
            ci95: unit.interval95(measured),
            change: None,
            joint: JointRelation::default(),
        }
    }

    /// A number that was read off the log and not estimated, so that it has no interval.
    pub fn counted(name: &'static str, unit: &'static str, value: f64) -> Self {
        Estimate::Amount {
            name,
            value,
            unit,
            ci95: None,
            change: None,
            joint: JointRelation::default(),
        }
    }

    /// An estimate of a length, which cannot be negative.
    pub fn length(name: &'static str, unit: Unit, length: &Length) -> Self {
        let Length { norm, .. } = length;
        let ci95 = unit.interval95(norm).map(|ends| ends.map(|end| end.max(0.0)));
        let (value, unit) = (norm.value, unit.symbol());
        Estimate::Amount { name, value, unit, ci95, change: None, joint: JointRelation::default() }
    }

    /// The estimate of a length in m and an angle in rad, neither of which can be negative.
    pub fn frame(name: &'static str, length: &Measured, angle: &Measured) -> Self {
        let of_norm = |ends: [f64; 2]| ends.map(|end| end.max(0.0));
        Estimate::Frame {
            name,
            value: length.value,
            unit: Unit::Metre.symbol(),
            ci95: Unit::Metre.interval95(length).map(of_norm),
            rotation: Angle {
                value: angle.value,
                ci95: Unit::Radian.interval95(angle).map(of_norm),
            },
            change: None,
        }
    }

    /// The same estimate of an amount that changes within the run; `value` is then the size of the
    /// change.
    pub fn changing(mut self, when: Change) -> Self {
        if let Estimate::Amount { change, .. } | Estimate::Frame { change, .. } = &mut self {
            *change = Some(when);
        }
        self
    }

    /// The same estimate of a joint that moves by `factor` per unit of the joint `with`.
    pub fn coupled(mut self, with: &str, factor: f64) -> Self {
        if let Estimate::Amount { joint, .. } = &mut self {
            *joint = JointRelation {
                with: Some(with.to_owned()),
                factor: Some(factor),
                ..JointRelation::default()
            };
        }
        self
    }

    /// The same estimate of a joint that is off by so many turns.
    pub fn off_by_turns(mut self, turns: f64) -> Self {
        if let Estimate::Amount { joint, .. } = &mut self {
            joint.turns = Some(turns);
        }
        self
    }

    /// When the amount changes, from what and to what, where it is not one over the run.
    pub fn change(&self) -> Option<&Change> {
        match self {
            Estimate::Amount { change, .. } | Estimate::Frame { change, .. } => change.as_ref(),
            Estimate::Convention { .. } | Estimate::Slip { .. } | Estimate::Order { .. } => None,
        }
    }
}

/// How a joint's positions are wrong, beyond one number.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct JointRelation {
    /// The joint that drives this one, if the two are coupled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub with: Option<String>,
    /// How far this joint moves per unit of `with`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub factor: Option<f64>,
    /// The turns by which the positions are off: 1, 0.5 or 0.25, without a sign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turns: Option<f64>,
}

/// An amount that is one until some moment and another from there on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Change {
    /// What it is before, in the unit of the estimate's `value`.
    #[serde(deserialize_with = "number")]
    #[schemars(with = "Option<f64>")]
    pub from: f64,
    /// What it is from then on, in the same unit.
    #[serde(deserialize_with = "number")]
    #[schemars(with = "Option<f64>")]
    pub to: f64,
    /// When it changes.
    #[schemars(with = "String")]
    pub change_ns: Stamp,
    /// 95 % interval of that moment.
    #[schemars(with = "Option<[String; 2]>")]
    pub change_ci95_ns: Option<[Stamp; 2]>,
}

/// The angle of a frame estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Angle {
    /// The angle, rad.
    #[serde(deserialize_with = "number")]
    #[schemars(with = "Option<f64>")]
    pub value: f64,
    /// 95 % interval, rad.
    pub ci95: Option<[f64; 2]>,
}

/// What numbers are, and what they were read as.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ReadAs {
    /// What they are.
    pub is: String,
    /// What they were read as.
    pub read_as: String,
}

/// The reading that comes second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunnerUp {
    /// What the numbers would be.
    pub is: String,
    /// What they would have been read as.
    pub read_as: String,
    /// Its residual over that of the best reading.
    #[serde(deserialize_with = "number")]
    #[schemars(with = "Option<f64>")]
    pub ratio: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finite_becomes_null() -> Result<(), serde_json::Error> {
        let estimate = Estimate::amount(
            "latency",
            Unit::Second,
            &Measured { value: f64::NAN, std_error: 1.0, dof: 1e6 },
        );
        let json = serde_json::to_string(&estimate)?;
        assert_eq!(json, r#"{"name":"latency","value":null,"unit":"s","ci95":null}"#);
        Ok(())
    }

    #[test]
    fn a_change_says_from_what_to_what_and_when_beside_its_size() -> Result<(), serde_json::Error> {
        let at = Stamp::from_nanos;
        let estimate = Estimate::counted("gyro bias", "rad/s", 0.25).changing(Change {
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
