//! Findings, their estimates and the outcomes of rules.

mod cause;
mod deserialize;
mod estimate;
mod unit;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::time::Stamp;

pub use cause::{Cause, JointScaleCorrection, Picture};
pub use deserialize::Word;
pub(crate) use deserialize::{deserialize_number, deserialize_optional_word, deserialize_word};
pub(crate) use estimate::Amount;
pub use estimate::{Angle, Change, Estimate, Interpretation, JointRelation, RunnerUp};
pub(crate) use unit::trimmed;
pub use unit::{Unit, rounded};

/// Severity of a finding.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Information; nothing is wrong.
    Info,
    /// A fault at or above the rule's warning threshold.
    Warning,
    /// A fault at or above the rule's error threshold, or without a threshold.
    Error,
}

impl Severity {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Severity::Info => "info",
            Severity::Warning => "warning",
            Severity::Error => "error",
        }
    }
}

/// Subject of a rule.
#[derive(
    Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema, Hash,
)]
pub struct Subject {
    /// Name of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Topic, or the file for rules on whole files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Joint name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// Name of a coordinate frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
    /// Topic with which the topic is compared, if the log has no joint states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
}

impl Subject {
    /// The robot, or the topic in its place.
    pub fn arm(&self) -> Option<&String> {
        self.robot.as_ref().or(self.reference.as_ref())
    }

    /// Joint or topic; empty for the whole run.
    pub fn label(&self) -> &str {
        let first =
            [&self.joint, &self.topic, &self.frame, &self.robot].into_iter().flatten().next();
        first.map_or("", String::as_str)
    }

    /// With the robot's name if there are several.
    pub(crate) fn label_among(&self, several_robots: bool) -> String {
        match (&self.robot, self.label()) {
            (Some(robot), label) if several_robots && label != robot => format!("{robot} {label}"),
            (_, label) => label.to_owned(),
        }
    }

    /// Parts with their kinds, from robot to frame.
    pub fn parts(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let parts = [
            ("robot", &self.robot),
            ("topic", &self.topic),
            ("joint", &self.joint),
            ("frame", &self.frame),
            ("reference", &self.reference),
        ];
        parts.into_iter().filter_map(|(kind, part)| Some((kind, part.as_deref()?)))
    }
}

/// Span of the examined data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// First stamp.
    pub start: Stamp,
    /// Last stamp.
    pub end: Stamp,
}

impl Span {
    /// Duration, s.
    pub fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

/// Another cause with the same effect on this log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alternative {
    /// Rule that would report it.
    #[serde(deserialize_with = "deserialize_word")]
    pub code: Word,
    /// Subject of that finding.
    pub subject: Subject,
    /// The value it would need.
    pub estimate: Option<Estimate>,
}

/// Evidence for a finding.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evidence {
    /// Causes that are indistinguishable from the reported one in this log.
    pub indistinguishable: Vec<Alternative>,
    /// Effect of the fault, for messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effect: Option<String>,
    /// Displacement of the tip by the fault, m, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub effect_m: Option<f64>,
    /// Keys added by the rule, described in its documentation.
    #[serde(flatten)]
    pub more: Map<String, Value>,
}

/// A fault found by a rule.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Severity.
    pub severity: Severity,
    /// Cause, with the values that correct it.
    pub cause: Cause,
    /// Summary without values.
    pub title: &'static str,
    /// One clause: lower-case start, no final period, the value with its unit.
    pub message: String,
    /// Evidence.
    pub evidence: Evidence,
    /// Recommended action.
    pub fix: String,
}

/// Outcome of a rule on a subject. Only [`Outcome::Evaluated`] is a decision.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The rule decided.
    Evaluated(Ruling),
    /// Not observable in this log; why, and what would resolve it.
    Inconclusive(String),
    /// Indistinguishable from this other cause in any such log.
    Indistinguishable(String),
    /// The log lacks this input.
    Skipped(String),
}

/// Decision.
#[derive(Clone, Debug, PartialEq)]
pub enum Ruling {
    /// With an optional remark.
    Pass(Option<String>),
    /// A fault.
    Fail(Box<Fault>),
}

impl Outcome {
    /// No fault.
    pub fn pass() -> Self {
        Outcome::Evaluated(Ruling::Pass(None))
    }

    /// With a remark.
    pub fn pass_with_remark(remark: impl Into<String>) -> Self {
        Outcome::Evaluated(Ruling::Pass(Some(remark.into())))
    }

    /// A fault.
    pub fn fail(fault: Fault) -> Self {
        Outcome::Evaluated(Ruling::Fail(Box::new(fault)))
    }
}

/// A finding in a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Finding {
    /// Code of the rule.
    #[serde(deserialize_with = "deserialize_word")]
    pub code: Word,
    /// How grave it is.
    pub severity: Severity,
    /// The fault in a few words.
    #[serde(deserialize_with = "deserialize_word")]
    pub title: Word,
    /// The fault in one clause, with its value.
    pub message: String,
    /// The faulty subject.
    pub subject: Subject,
    /// Cause, with the values that correct it.
    #[serde(skip)]
    pub cause: Cause,
    /// Segment of the run, from 0, if there are several.
    #[serde(skip)]
    pub segment: Option<usize>,
    /// The estimated value.
    pub estimate: Option<Estimate>,
    /// Evidence for it.
    pub evidence: Evidence,
    /// Recommended action.
    pub fix: String,
    /// First stamp of the examined data.
    #[schemars(with = "Option<String>")]
    pub start_ns: Option<Stamp>,
    /// Last stamp of the examined data.
    #[schemars(with = "Option<String>")]
    pub end_ns: Option<Stamp>,
}

impl Finding {
    /// Whether its fix is to estimate the links with `poseaudit calibrate`.
    pub(crate) fn suggests_calibration(&self) -> bool {
        self.fix.contains("poseaudit calibrate")
    }
}

/// A known finding that does not count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Ignored")]
pub struct IgnoredFinding {
    /// The finding.
    #[serde(flatten)]
    pub finding: Finding,
    /// Why it does not count.
    pub reason: String,
    /// File and line of the exemption.
    pub place: String,
}

/// Status of a rule on a subject.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Decided: no fault.
    Pass,
    /// Decided: a finding.
    Fail,
    /// Not observable in this log.
    Inconclusive,
    /// The input is not in the log.
    Skipped,
}

impl Status {
    /// Name in reports.
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

/// Result of one rule on one subject.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CheckRow {
    /// Code of the rule.
    #[serde(deserialize_with = "deserialize_word")]
    pub code: Word,
    /// Name of the rule.
    #[serde(deserialize_with = "deserialize_word")]
    pub name: Word,
    /// Subject of the rule.
    pub subject: Subject,
    /// Status.
    pub status: Status,
    /// Reason for the status, if needed.
    pub reason: Option<String>,
    /// The estimate, whether or not it was decisive.
    pub estimate: Option<Estimate>,
    /// Further evidence, if there is no finding to hold it.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub evidence: Map<String, Value>,
    /// No such log could decide it, so it does not affect the verdict.
    #[serde(skip)]
    pub is_indistinguishable: bool,
    /// Skipped because of an exemption.
    #[serde(skip)]
    pub is_exempt: bool,
}
