//! A report as it was kept: read back from its JSON, as far as a comparison needs it.

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::finding::{Severity, Status, Subject};
use crate::report::{Report, SCHEMA, Trouble, TroubleKind, Verdict};

/// A report that was kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The answer in one word.
    pub verdict: Verdict,
    /// Why next to nothing could be evaluated, where that is so.
    pub error: Option<KeptTrouble>,
    /// What was read.
    pub log: KeptLog,
    /// A row for every rule and subject.
    pub checks: Vec<KeptCheck>,
    /// What is wrong.
    pub findings: Vec<KeptFinding>,
}

/// What kept an audit from saying more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptTrouble {
    /// What is wrong.
    pub what: String,
}

/// The files of a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptLog {
    /// The files, in the order given.
    pub files: Vec<KeptFile>,
}

/// A file of a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptFile {
    /// Path as it was given.
    pub path: String,
}

/// How asking a rule about a subject ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptCheck {
    /// Code of the rule.
    pub code: String,
    /// What it was asked about.
    pub subject: Subject,
    /// How that ended.
    pub status: Status,
    /// Why, where the status alone does not say.
    pub reason: Option<String>,
}

/// A finding.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptFinding {
    /// Code of the rule.
    pub code: String,
    /// How grave it is.
    pub severity: Severity,
    /// The fault in one clause.
    pub message: String,
    /// What is at fault.
    pub subject: Subject,
    /// By how much.
    pub estimate: Option<KeptEstimate>,
    /// What to do about it.
    pub fix: String,
}

/// An estimate: an amount with its interval, or what numbers are and what they were read as.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptEstimate {
    /// What it is.
    pub name: String,
    /// The number, in `unit`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// SI symbol.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// The angle of a frame, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<KeptAngle>,
    /// What the numbers are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub is: Option<Value>,
    /// What they were read as.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_as: Option<Value>,
}

/// An angle, rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptAngle {
    /// The angle.
    pub value: Option<f64>,
    /// 95 % interval.
    pub ci95: Option<[f64; 2]>,
}

impl Kept {
    /// The report in the file at `path`.
    ///
    /// # Errors
    /// If it cannot be read, or is no report of this schema.
    pub fn from_file(path: &Path) -> Result<Self, Trouble> {
        let trouble = |place: String, what: String| Trouble {
            kind: TroubleKind::Call,
            what,
            place,
            remedy: "make one with `poseaudit audit LOG --format json --output FILE`".to_owned(),
        };
        let place = path.display().to_string();
        let text = fs::read(path)
            .map_err(|error| trouble(place.clone(), format!("it cannot be read: {error}")))?;
        let at = |error: &serde_json::Error| match error.line() {
            0 => place.clone(),
            line => format!("{place}:{line}"),
        };
        let whole: Value = serde_json::from_slice(&text)
            .map_err(|error| trouble(at(&error), format!("no JSON: {error}")))?;
        match whole.get("schema").and_then(Value::as_str) {
            Some(SCHEMA) => {}
            Some(other) => {
                let what = format!("its schema is `{other}`, expected `{SCHEMA}`");
                return Err(trouble(place, what));
            }
            None => {
                return Err(trouble(place, format!("no report: its schema is not `{SCHEMA}`")));
            }
        }
        // Once more from the text: only that knows the lines.
        serde_json::from_slice(&text)
            .map_err(|error| trouble(at(&error), format!("no report: {error}")))
    }

    /// What is kept of `report`.
    ///
    /// # Errors
    /// If its JSON is not that of this schema, which the tests rule out.
    pub fn of(report: &Report) -> Result<Self, serde_json::Error> {
        serde_json::from_value(serde_json::to_value(report)?)
    }

    /// Whom a check or a finding is about, whatever the file is called that it was seen in.
    pub(super) fn whom(&self, subject: &Subject) -> Subject {
        let is_file = |name: &String| self.log.files.iter().any(|file| &file.path == name);
        let topic = subject.topic.clone();
        Subject { topic: topic.filter(|topic| !is_file(topic)), ..subject.clone() }
    }

    /// How asking a rule about a subject ended, if it was asked.
    pub(super) fn check(&self, code: &str, whom: &Subject) -> Option<&KeptCheck> {
        self.checks.iter().find(|row| row.code == code && &self.whom(&row.subject) == whom)
    }
}
