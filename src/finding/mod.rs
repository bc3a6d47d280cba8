//! What an audit says: a finding, its estimate with the interval, and the outcome it comes from.

mod cause;
mod estimate;
mod read;
mod unit;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::time::Stamp;

pub use cause::{Cause, JointScaling, Sight};
pub use estimate::{Angle, Change, Estimate, JointRelation, ReadAs, RunnerUp};
pub use read::Word;
pub(crate) use read::{maybe_word, number, word};
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
