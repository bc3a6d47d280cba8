//! Fleet report: rules violated by arms, sites and topics, and trends of estimates.

mod aggregate;
mod calendar;
mod finding_rows;
mod html;
mod markdown;
mod next_commands;
mod table_part;
mod text;
mod trends;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::outcomes::{Failure, Statuses, Verdicts};
use super::store::{Status, Store, StoreError, StoredDataset};
use crate::checks::Selector;
use crate::finding::Severity;
use crate::report::Verdict;
use crate::run::{SharedColumns, SharedRow};

pub use calendar::{Day, format_day};
pub use html::write as write_html;
pub use markdown::write as write_markdown;
pub use text::write as write_text;
pub use trends::{TrendKind, TrendPoint, TrendPosition, TrendRow, TrendValue};

/// JSON schema.
pub const SCHEMA: &str = "poseaudit.fleet/1";

/// Query of a results folder.
#[derive(Clone, Debug, Default)]
pub struct FleetQuery {
    /// Lowest severity that fails the report, if any.
    pub fail_on: Option<Severity>,
    /// Inconclusive verdicts fail the report.
    pub fails_if_inconclusive: bool,
    /// Start of the counted findings, ns since 1970. Trends use all runs.
    pub since_ns: Option<i64>,
    /// Derives labels from paths, in place of the stored ones.
    pub template: Option<super::labels::Template>,
    /// Hash of the settings; `None`: the latest.
    pub settings: Option<String>,
    /// Rules; all if empty.
    pub select: Vec<Selector>,
}

/// Fleet report. Fields are in the order of the JSON object.
#[derive(Clone, Debug, Serialize)]
pub struct FleetReport {
    schema: &'static str,
    tool: Tool,
    /// Whether the report fails.
    pub failing: bool,
    /// Counts of logs.
    pub logs: LogCounts,
    /// Datasets and their shared properties.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<DatasetRow>,
    /// Arms.
    pub arms: Vec<ArmRow>,
    /// Logs, latest first.
    #[serde(rename = "runs")]
    pub rows: Vec<LogRow>,
    /// Sorted by severity and frequency, one row per rule and subject.
    pub findings: Vec<FindingRow>,
    /// Found trends first.
    pub trends: Vec<TrendRow>,
    /// Logs not audited.
    pub errors: Vec<Failure>,
    /// Folder of the results.
    #[serde(skip)]
    pub folder: PathBuf,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Tool {
    name: &'static str,
    version: &'static str,
}

/// Counts of the logs of a fleet.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LogCounts {
    /// Each content once.
    pub total: usize,
    /// Counts per audit status.
    pub statuses: Statuses,
    /// Counts per verdict; warnings count as failures.
    pub verdicts: Verdicts,
    /// Further paths of the same content.
    pub copies: usize,
    /// Without calendar time: not in trends.
    pub undated: usize,
    /// Logs before the start of the reported period.
    pub before: usize,
    /// Earliest start stamp, decimal.
    pub start_ns: Option<String>,
    /// Latest start stamp, decimal.
    pub end_ns: Option<String>,
    /// Program version.
    pub version: String,
    /// Settings hash.
    pub settings: String,
    /// Excluded: other versions or settings.
    pub set_aside: usize,
}

/// Subject: a site, arm and robot, and a part of the log.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct FleetSubject {
    /// Site.
    pub site: Option<String>,
    /// Arm.
    pub arm: Option<String>,
    /// Robot in the log or model.
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

impl FleetSubject {
    /// Site, arm and robot.
    pub fn arm_label(&self) -> String {
        let parts = [&self.site, &self.arm, &self.robot].into_iter().flatten();
        let parts: Vec<&str> = parts.map(String::as_str).collect();
        if parts.is_empty() { "unknown arm".to_owned() } else { parts.join(" / ") }
    }

    /// Joint, topic and frame; empty for the whole log.
    pub fn part_label(&self) -> String {
        let parts = [&self.joint, &self.topic, &self.frame].into_iter().flatten();
        parts.map(String::as_str).collect::<Vec<_>>().join(" ")
    }
}

/// Dataset with shared properties.
#[derive(Clone, Debug, Serialize)]
pub struct DatasetRow {
    /// Folder or file.
    pub dataset: String,
    /// Logs sampled.
    #[serde(rename = "asked")]
    pub sampled: Vec<String>,
    /// Catalogue arm.
    pub robot: Option<String>,
    /// Columns not identified by name.
    pub columns: Vec<SharedRow>,
    /// Open question.
    #[serde(rename = "open")]
    pub open_question: Option<String>,
}

impl DatasetRow {
    fn from_stored(stored: StoredDataset) -> Self {
        let StoredDataset { dataset, shared, .. } = stored;
        let columns = shared.columns.as_ref();
        Self {
            dataset,
            sampled: shared.from,
            robot: shared.robot,
            columns: columns.map(SharedColumns::rows).unwrap_or_default(),
            open_question: columns.and_then(SharedColumns::question).map(str::to_owned),
        }
    }

    /// Arm, columns, open question.
    fn lines(&self) -> Vec<String> {
        let robot = self.robot.as_deref().map_or(String::new(), |robot| format!(": {robot}"));
        let head = format!("{}{robot}, by {}", self.dataset, self.sampled.join(", "));
        let row =
            |row: &SharedRow| format!("{} = {} ({})", row.is, row.columns.join(", "), row.why);
        let open = self.open_question.iter().map(|open| format!("open: {open}"));
        std::iter::once(head).chain(self.columns.iter().map(row)).chain(open).collect()
    }
}

/// Summary of one arm.
#[derive(Clone, Debug, Serialize)]
pub struct ArmRow {
    /// Site, arm and robot.
    #[serde(flatten)]
    pub subject: FleetSubject,
    /// Logs.
    pub logs: usize,
    /// Logs without an audit.
    pub not_audited: usize,
    /// Logs by verdict.
    pub verdicts: Verdicts,
    /// Logs with warnings or errors, by rule.
    pub fails: Vec<RuleCount>,
}

/// Summary of one log.
#[derive(Clone, Debug, Serialize)]
pub struct LogRow {
    /// Path.
    pub path: String,
    /// Site, arm and robots.
    #[serde(flatten)]
    pub subject: FleetSubject,
    /// Audit status.
    pub status: Status,
    /// Warnings count as failures.
    pub verdict: Option<Verdict>,
    /// Start stamp, decimal.
    pub start_ns: Option<String>,
    /// Report page, if stored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PathBuf>,
    /// Rules with warnings or errors.
    pub codes: Vec<String>,
}

/// Logs with a finding of a rule.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RuleCount {
    /// Rule.
    pub code: String,
    /// Logs.
    pub logs: usize,
}

/// Finding of a rule on a subject.
#[derive(Clone, Debug, Serialize)]
pub struct FindingRow {
    /// Rule.
    pub code: String,
    /// Title.
    pub title: String,
    /// Highest severity.
    pub severity: Severity,
    /// Subject.
    #[serde(flatten)]
    pub subject: FleetSubject,
    /// Logs with the finding.
    pub logs: usize,
    /// Logs that passed the rule.
    #[serde(rename = "sound")]
    pub passed: usize,
    /// Message in the latest log.
    pub message: String,
    /// Paths of the logs with the finding, latest last.
    #[serde(skip)]
    pub paths: Vec<String>,
    /// Path of the latest log.
    pub path: String,
    /// Start of the latest log, decimal.
    pub start_ns: Option<String>,
    /// Log with the largest value, unless it is the latest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub worst: Option<WorstLog>,
}

/// Log with the largest value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct WorstLog {
    /// Message.
    pub message: String,
    /// Log.
    pub path: String,
}

impl FleetReport {
    /// Makes page paths below `folder` relative.
    pub fn with_links_relative_to(mut self, folder: &Path) -> Self {
        let Ok(folder) = folder.canonicalize() else { return self };
        for page in self.rows.iter_mut().filter_map(|row| row.page.as_mut()) {
            if let Ok(below) = page.strip_prefix(&folder) {
                *page = below.to_owned();
            }
        }
        self
    }

    /// Report on `store`.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn build(store: &Store, query: &FleetQuery) -> Result<Self, StoreError> {
        let data = aggregate::collect(store, query)?;
        let fails = |severity: Severity| query.fail_on.is_some_and(|least| severity >= least);
        let trends = trends::trend_rows(data.series);
        let has_trend = trends.iter().any(|row| row.kind.is_trend());
        let failing = data.findings.iter().any(|row| fails(row.severity))
            || (has_trend && fails(Severity::Warning))
            || (query.fails_if_inconclusive && data.logs.verdicts.inconclusive > 0)
            || (!data.errors.is_empty() && query.fail_on.is_some());
        let datasets = store.load_datasets(&data.logs.settings);
        Ok(Self {
            schema: SCHEMA,
            tool: Tool { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") },
            failing,
            datasets: datasets.into_iter().map(DatasetRow::from_stored).collect(),
            logs: data.logs,
            arms: data.arms,
            rows: data.rows,
            findings: data.findings,
            trends,
            errors: data.errors,
            folder: store.path().to_owned(),
        })
    }

    /// No pass if a log was not audited or not decided.
    pub fn verdict(&self) -> Verdict {
        let verdicts = &self.logs.verdicts;
        let is_open = verdicts.inconclusive > 0 || !self.errors.is_empty();
        let is_decided = verdicts.pass + verdicts.fail > 0;
        match self.failing {
            true => Verdict::Fail,
            false if is_open || !is_decided => Verdict::Inconclusive,
            false => Verdict::Pass,
        }
    }

    /// Trends found.
    pub fn found_trends(&self) -> impl Iterator<Item = &TrendRow> {
        self.trends.iter().filter(|row| row.kind.is_trend())
    }
}
