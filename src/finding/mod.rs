//! What an audit says: a finding, its estimate with the interval, and the outcome it comes from.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};

mod cause;
mod unit;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

use crate::stats::{Length, Measured};
use crate::time::Stamp;

pub use cause::{Cause, JointScaling};
pub use unit::{Unit, rounded};

/// How grave a finding is.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Worth knowing; nothing is wrong.
    Info,
    /// Wrong, by more than the rule's first threshold.
    Warning,
    /// Wrong, by more than the rule's second threshold, or a fault that has no amount.
    Error,
}

impl Severity {
    /// The word used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Severity::Info => "info",
            Severity::Warning => "warning",
            Severity::Error => "error",
        }
    }
}

/// What a rule was asked about.
#[derive(
    Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
pub struct Subject {
    /// Name of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Topic, or the file where a whole file is meant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Joint name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// Name of a coordinate frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
}

impl Subject {
    /// Joint, topic, or whatever says most shortly what is meant; empty for the whole run.
    pub fn label(&self) -> &str {
        let first =
            [&self.joint, &self.topic, &self.frame, &self.robot].into_iter().flatten().next();
        first.map_or("", String::as_str)
    }

    /// Its label, behind the name of its robot where there are several.
    pub(crate) fn label_among(&self, several_robots: bool) -> String {
        match (&self.robot, self.label()) {
            (Some(robot), label) if several_robots && label != robot => format!("{robot} {label}"),
            (_, label) => label.to_owned(),
        }
    }

    /// Its parts with what each of them is, from the robot to the frame.
    pub fn parts(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let parts = [
            ("robot", &self.robot),
            ("topic", &self.topic),
            ("joint", &self.joint),
            ("frame", &self.frame),
        ];
        parts.into_iter().filter_map(|(kind, part)| Some((kind, part.as_deref()?)))
    }
}

/// First and last stamp of what was looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// First stamp.
    pub start: Stamp,
    /// Last stamp.
    pub end: Stamp,
}

impl Span {
    /// Length of the span, s.
    pub fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

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
        }
    }

    /// A number that was read off the log and not estimated, so that it has no interval.
    pub fn counted(name: &'static str, unit: &'static str, value: f64) -> Self {
        Estimate::Amount { name, value, unit, ci95: None }
    }

    /// An estimate of a length, which cannot be negative.
    pub fn length(name: &'static str, unit: Unit, length: &Length) -> Self {
        let Length { norm, .. } = length;
        let ci95 = unit.interval95(norm).map(|ends| ends.map(|end| end.max(0.0)));
        Estimate::Amount { name, value: norm.value, unit: unit.symbol(), ci95 }
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
        }
    }
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

/// Another cause that does the same to this log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alternative {
    /// The rule that would name it.
    #[serde(deserialize_with = "word")]
    pub code: Word,
    /// Its subject.
    pub subject: Subject,
    /// How much of it would be needed.
    pub estimate: Option<Estimate>,
}

/// What a finding rests on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evidence {
    /// Causes that this log cannot tell from the one named.
    pub indistinguishable: Vec<Alternative>,
    /// What the fault does, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effect: Option<String>,
    /// What the fault moves the tip by, m, where that can be said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effect_m: Option<f64>,
    /// What the rule adds; its documentation names the keys.
    #[serde(flatten)]
    pub more: Map<String, Value>,
}

/// What a rule found wrong with its subject.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// How grave it is.
    pub severity: Severity,
    /// What is wrong, with the amounts that mend it.
    pub cause: Cause,
    /// The fault in a few words, without amounts.
    pub title: &'static str,
    /// The fault in one clause: lower-case start, no final period, the amount with its unit.
    pub message: String,
    /// What it rests on.
    pub evidence: Evidence,
    /// What to do about it.
    pub fix: String,
}

/// What came of asking a rule about a subject.
///
/// "Not looked at" cannot be taken for "fine": only [`Outcome::Evaluated`] decides.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The rule decided.
    Evaluated(Ruling),
    /// The log does not tell; why, and what would.
    Inconclusive(String),
    /// No such log could tell it from another cause; from which.
    Indistinguishable(String),
    /// The input is not in the log; which.
    Skipped(String),
}

/// What a rule decided.
#[derive(Clone, Debug, PartialEq)]
pub enum Ruling {
    /// Nothing is wrong; a remark where that needs one.
    Sound(Option<String>),
    /// Something is.
    Faulty(Box<Fault>),
}

impl Outcome {
    /// Nothing is wrong.
    pub fn sound() -> Self {
        Outcome::Evaluated(Ruling::Sound(None))
    }

    /// Nothing is wrong, and why that can be said.
    pub fn sound_because(remark: impl Into<String>) -> Self {
        Outcome::Evaluated(Ruling::Sound(Some(remark.into())))
    }

    /// Something is wrong.
    pub fn faulty(fault: Fault) -> Self {
        Outcome::Evaluated(Ruling::Faulty(Box::new(fault)))
    }
}

/// A finding, as reports list it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Finding {
    /// Code of the rule.
    #[serde(deserialize_with = "word")]
    pub code: Word,
    /// How grave it is.
    pub severity: Severity,
    /// The fault in a few words.
    #[serde(deserialize_with = "word")]
    pub title: Word,
    /// The fault in one clause, with its amount.
    pub message: String,
    /// What is at fault.
    pub subject: Subject,
    /// What is wrong, with the amounts that mend it.
    #[serde(skip)]
    pub cause: Cause,
    /// Which segment of the run it is of, from 0, where there are several.
    #[serde(skip)]
    pub segment: Option<usize>,
    /// By how much.
    pub estimate: Option<Estimate>,
    /// What it rests on.
    pub evidence: Evidence,
    /// What to do about it.
    pub fix: String,
    /// First stamp of what was looked at.
    #[schemars(with = "Option<String>")]
    pub start_ns: Option<Stamp>,
    /// Last stamp of what was looked at.
    #[schemars(with = "Option<String>")]
    pub end_ns: Option<Stamp>,
}

/// A finding that the caller knows of and does not want counted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Ignored {
    /// What was found.
    #[serde(flatten)]
    pub finding: Finding,
    /// Why it does not count.
    pub reason: String,
    /// Where that is said.
    pub place: String,
}

/// A word that this program has for something: a rule's code, what an estimate is of, a unit.
pub type Word = &'static str;

/// Reads a word. Each is kept once and for as long as the process lives; reports have few.
pub(crate) fn word<'de, D: Deserializer<'de>>(from: D) -> Result<Word, D::Error> {
    static KNOWN: Mutex<BTreeSet<Word>> = Mutex::new(BTreeSet::new());
    let text = String::deserialize(from)?;
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let word = known.get(text.as_str()).copied().unwrap_or_else(|| text.leak());
    known.insert(word);
    Ok(word)
}

/// Reads a number, of which what is not finite was written as `null`.
pub(crate) fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

/// How asking a rule about a subject ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Decided: nothing wrong.
    Pass,
    /// Decided: there is a finding.
    Fail,
    /// The log does not tell.
    Inconclusive,
    /// The input is not in the log.
    Skipped,
}

impl Status {
    /// Its name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Status::Pass => "pass",
            Status::Fail => "fail",
            Status::Inconclusive => "inconclusive",
            Status::Skipped => "skipped",
        }
    }

    /// Whether the rule decided.
    pub fn is_decided(self) -> bool {
        matches!(self, Status::Pass | Status::Fail)
    }
}

/// A rule and a subject it was asked about, as reports list them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CheckRow {
    /// Code of the rule.
    #[serde(deserialize_with = "word")]
    pub code: Word,
    /// Name of the rule.
    #[serde(deserialize_with = "word")]
    pub name: Word,
    /// What it was asked about.
    pub subject: Subject,
    /// How that ended.
    pub status: Status,
    /// Why, where the status alone does not say.
    pub reason: Option<String>,
    /// What was estimated, whether or not it decided anything.
    pub estimate: Option<Estimate>,
    /// What else was seen, where no finding says it.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub evidence: Map<String, Value>,
    /// Whether no such log could decide it, so that it does not count against the verdict.
    #[serde(skip)]
    pub indistinguishable: bool,
    /// Whether it was evaluated, and is skipped because the caller said not to count it.
    #[serde(skip)]
    pub exempt: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(value: f64, std_error: f64) -> Measured {
        Measured { value, std_error, dof: 1e6 }
    }

    #[test]
    fn amounts_read_as_people_say_them() {
        assert_eq!(Unit::Second.show(0.0231), "23.1 ms");
        assert_eq!(Unit::Second.show(2.5e-5), "25 µs");
        assert_eq!(Unit::Metre.show(0.002), "2 mm");
        assert_eq!(Unit::Metre.show(0.8512), "851 mm");
        assert_eq!(Unit::Radian.show(0.1f64.to_radians()), "0.1°");
        assert_eq!(Unit::RadianPerSecond.show(0.2f64.to_radians() / 60.0), "0.2 °/min");
    }

    #[test]
    fn an_interval_gives_the_digits_and_is_rounded_up() {
        assert_eq!(Unit::Second.show_measured(&measured(0.02203, 1.05e-5)), "22.03 ± 0.03 ms");
        assert_eq!(
            Unit::Radian.show_signed(&measured(0.5f64.to_radians(), 1e-9)),
            "+0.500 ± 0.001°"
        );
        assert_eq!(Unit::Metre.show_measured(&measured(0.002, f64::NAN)), "2 mm ± ?");
        assert_eq!(Unit::Radian.show_signed(&measured(-1e-9, 1e-9)), "0.000 ± 0.001°");
    }

    #[test]
    fn an_interval_is_never_narrower_than_the_noise_floor() {
        assert_eq!(Unit::Metre.interval95(&measured(0.0, 0.0)), Some([-1e-6, 1e-6]));
        assert_eq!(Unit::Metre.interval95(&measured(0.0, f64::INFINITY)), None);
    }

    #[test]
    fn what_is_not_finite_becomes_null() -> Result<(), serde_json::Error> {
        let estimate = Estimate::amount("latency", Unit::Second, &measured(f64::NAN, 1.0));
        let json = serde_json::to_string(&estimate)?;
        assert_eq!(json, r#"{"name":"latency","value":null,"unit":"s","ci95":null}"#);
        Ok(())
    }
}
