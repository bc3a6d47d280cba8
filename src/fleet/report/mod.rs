//! Fleet report: which arms, sites and topics violate which rules, and trends of estimates over time.

mod calendar;
mod found;
mod gather;
mod html;
mod markdown;
mod part;
mod text;
mod trends;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::outcomes::{Statuses, Verdicts};
use super::store::{KeptDataset, Status, Store, StoreError};
use crate::checks::Selector;
use crate::finding::Severity;
use crate::report::Verdict;
use crate::run::{SharedColumns, SharedRow};

pub use calendar::{Day, day};
pub use html::write as write_html;
pub use markdown::write as write_markdown;
pub use text::write as write_text;
pub use trends::{At, Course, Moved, Point, TrendRow};

/// Schema of the JSON report.
pub const SCHEMA: &str = "poseaudit.fleet/1";

/// Query of a results folder.
#[derive(Clone, Debug, Default)]
pub struct Question {
    /// Minimum severity of a finding that fails the report; `None`: no finding does.
    pub fail_on: Option<Severity>,
    /// Whether an inconclusive verdict fails the report.
    pub fails_open: bool,
    /// Ignore findings of runs before this time, ns since 1970. Trends use all runs.
    pub since_ns: Option<i64>,
    /// Template that derives labels from paths, in place of the stored labels.
    pub template: Option<super::labels::Template>,
    /// Hash of the settings to report; the latest if `None`.
    pub settings: Option<String>,
    /// Rules to report; all if empty.
    pub select: Vec<Selector>,
}

/// Fleet report. The fields are in the order of the JSON object.
#[derive(Clone, Debug, Serialize)]
pub struct FleetReport {
    schema: &'static str,
    tool: Tool,
    /// Whether the report fails.
    pub failing: bool,
    /// Number of logs.
    pub logs: LogCounts,
    /// Datasets of the logs, with their shared properties.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<DatasetRow>,
    /// Arms.
    pub arms: Vec<ArmRow>,
    /// Logs, latest first.
    #[serde(rename = "runs")]
    pub rows: Vec<LogRow>,
    /// Findings, one row per rule and subject, by severity and frequency.
    pub findings: Vec<FindingRow>,
    /// Trends; found trends first.
    pub trends: Vec<TrendRow>,
    /// Logs that could not be audited.
    pub errors: Vec<ErrorRow>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Tool {
    name: &'static str,
    version: &'static str,
}

/// Counts of the logs of a fleet.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LogCounts {
    /// Logs, each content once.
    pub total: usize,
    /// Logs by audit status.
    pub statuses: Statuses,
    /// Reports by verdict, with warnings counted as failures.
    pub verdicts: Verdicts,
    /// Additional paths with the same content.
    pub copies: usize,
    /// Logs without calendar time, which are excluded from trends.
    pub undated: usize,
    /// Logs before the time from which findings count.
    pub before: usize,
    /// Earliest start stamp, as a decimal string.
    pub start_ns: Option<String>,
    /// Latest start stamp, as a decimal string.
    pub end_ns: Option<String>,
    /// Program version of the audits.
    pub version: String,
    /// Hash of the audit settings.
    pub settings: String,
    /// Logs with rows of other versions or settings, which are excluded.
    pub set_aside: usize,
}

/// Subject: a site, arm and robot, and a part of the log.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Whose {
    /// Site label.
    pub site: Option<String>,
    /// Arm label.
    pub arm: Option<String>,
    /// Robot name in the log or model.
    pub robot: Option<String>,
    /// Topic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// Frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
}

impl Whose {
    /// Site, arm and robot as text.
    pub fn arm_label(&self) -> String {
        let parts = [&self.site, &self.arm, &self.robot].into_iter().flatten();
        let parts: Vec<&str> = parts.map(String::as_str).collect();
        if parts.is_empty() { "unknown arm".to_owned() } else { parts.join(" / ") }
    }

    /// Joint, topic and frame as text; empty for the whole log.
    pub fn part(&self) -> String {
        let parts = [&self.joint, &self.topic, &self.frame].into_iter().flatten();
        parts.map(String::as_str).collect::<Vec<_>>().join(" ")
    }
}

/// Dataset and the shared properties of its logs.
#[derive(Clone, Debug, Serialize)]
pub struct DatasetRow {
    /// Folder or file.
    pub dataset: String,
    /// Logs sampled.
    pub asked: Vec<String>,
    /// Arm of the catalogue.
    pub robot: Option<String>,
    /// Content of columns not identified by their names.
    pub columns: Vec<SharedRow>,
    /// Open question, if any.
    pub open: Option<String>,
}

impl DatasetRow {
    fn of(kept: KeptDataset) -> Self {
        let KeptDataset { dataset, shared, .. } = kept;
        let columns = shared.columns.as_ref();
        Self {
            dataset,
            asked: shared.from,
            robot: shared.robot,
            columns: columns.map(SharedColumns::rows).unwrap_or_default(),
            open: columns.and_then(SharedColumns::question).map(str::to_owned),
        }
    }

    /// Summary lines: arm, columns, open question.
    fn lines(&self) -> Vec<String> {
        let robot = self.robot.as_deref().map_or(String::new(), |robot| format!(": {robot}"));
        let head = format!("{}{robot}, by {}", self.dataset, self.asked.join(", "));
        let row =
            |row: &SharedRow| format!("{} = {} ({})", row.is, row.columns.join(", "), row.why);
        let open = self.open.iter().map(|open| format!("open: {open}"));
        std::iter::once(head).chain(self.columns.iter().map(row)).chain(open).collect()
    }
}

/// Summary of one arm.
#[derive(Clone, Debug, Serialize)]
pub struct ArmRow {
    /// Site, arm and robot.
    #[serde(flatten)]
    pub whose: Whose,
    /// Number of logs.
    pub logs: usize,
    /// Logs by verdict.
    pub verdicts: Verdicts,
    /// Rules with warnings or errors, with the number of logs.
    pub fails: Vec<RuleCount>,
}

/// Summary of one log.
#[derive(Clone, Debug, Serialize)]
pub struct LogRow {
    /// Path.
    pub path: String,
    /// Site, arm and robots.
    #[serde(flatten)]
    pub whose: Whose,
    /// Status of the audit.
    pub status: Status,
    /// Verdict of the report, with warnings counted as failures.
    pub verdict: Option<Verdict>,
    /// Start stamp, as a decimal string.
    pub start_ns: Option<String>,
    /// Report page, if stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PathBuf>,
    /// Rules with warnings or errors in this log.
    pub codes: Vec<String>,
}

/// Number of logs with a finding of a rule.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RuleCount {
    /// Code of the rule.
    pub code: String,
    /// Number of logs.
    pub logs: usize,
}

/// Finding of a rule on a subject.
#[derive(Clone, Debug, Serialize)]
pub struct FindingRow {
    /// Code of the rule.
    pub code: String,
    /// Short title.
    pub title: String,
    /// Highest severity.
    pub severity: Severity,
    /// Subject.
    #[serde(flatten)]
    pub whose: Whose,
    /// Logs with the finding.
    pub logs: usize,
    /// Logs in which the rule passed on this subject.
    pub sound: usize,
    /// Message in the latest log.
    pub message: String,
    /// Path of the latest log.
    pub path: String,
    /// Start of the latest log, as a decimal string.
    pub start_ns: Option<String>,
    /// Log with the largest value, if it is not the latest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub worst: Option<Worst>,
}

/// Log with the largest value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Worst {
    /// Message in this log.
    pub message: String,
    /// Path of the log.
    pub path: String,
}

/// Log that could not be audited.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct ErrorRow {
    /// Path.
    pub path: String,
    /// Status of the audit.
    pub status: Status,
    /// Problem.
    pub what: String,
    /// Remedy.
    #[serde(rename = "do")]
    pub remedy: String,
}

impl FleetReport {
    /// Makes page paths below `folder` relative to it.
    pub fn linked_from(mut self, folder: &Path) -> Self {
        let Ok(folder) = folder.canonicalize() else { return self };
        for page in self.rows.iter_mut().filter_map(|row| row.page.as_mut()) {
            if let Ok(below) = page.strip_prefix(&folder) {
                *page = below.to_owned();
            }
        }
        self
    }

    /// Report on the results in `store`.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn of(store: &Store, question: &Question) -> Result<Self, StoreError> {
        let gathered = gather::gather(store, question)?;
        let fails = |severity: Severity| question.fail_on.is_some_and(|least| severity >= least);
        let trends = trends::rows(gathered.series);
        let moves = trends.iter().any(|row| row.course.is_moving());
        let failing = gathered.findings.iter().any(|row| fails(row.severity))
            || (moves && fails(Severity::Warning))
            || (question.fails_open && gathered.logs.verdicts.inconclusive > 0)
            || (!gathered.errors.is_empty() && question.fail_on.is_some());
        let datasets = store.datasets(&gathered.logs.settings);
        Ok(Self {
            schema: SCHEMA,
            tool: Tool { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") },
            failing,
            datasets: datasets.into_iter().map(DatasetRow::of).collect(),
            logs: gathered.logs,
            arms: gathered.arms,
            rows: gathered.rows,
            findings: gathered.findings,
            trends,
            errors: gathered.errors,
        })
    }

    /// Trends that were found.
    pub fn moving(&self) -> impl Iterator<Item = &TrendRow> {
        self.trends.iter().filter(|row| row.course.is_moving())
    }
}
