//! What the logs of a fleet say together: which arms, sites and topics fail which rules, and how
//! amounts move over time.

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

/// The schema of the report in JSON.
pub const SCHEMA: &str = "poseaudit.fleet/1";

/// What is asked of a folder of results.
#[derive(Clone, Debug, Default)]
pub struct Question {
    /// Findings of this severity fail it; `None`: none does.
    pub fail_on: Option<Severity>,
    /// Whether a verdict that is inconclusive fails it, too.
    pub fails_open: bool,
    /// Findings of runs before this time do not count, ns since 1970. Trends see all runs.
    pub since_ns: Option<i64>,
    /// What paths say they are of, in place of the labels that rows have.
    pub template: Option<super::labels::Template>,
    /// The hash of the settings whose rows are wanted; of none the latest.
    pub settings: Option<String>,
    /// Only these rules; all where there is none.
    pub select: Vec<Selector>,
}

/// The report on a fleet. Its fields stand in the order of the JSON object.
#[derive(Clone, Debug, Serialize)]
pub struct FleetReport {
    schema: &'static str,
    tool: Tool,
    /// Whether something is there that fails it.
    pub failing: bool,
    /// The logs.
    pub logs: LogCounts,
    /// The datasets that they are of, and what these tell of all their logs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<DatasetRow>,
    /// The arms.
    pub arms: Vec<ArmRow>,
    /// Each log, the latest first.
    #[serde(rename = "runs")]
    pub rows: Vec<LogRow>,
    /// What is found, a row a rule and subject, the most frequent of the gravest first.
    pub findings: Vec<FindingRow>,
    /// How amounts moved; what moves stands first.
    pub trends: Vec<TrendRow>,
    /// Logs that could not be audited.
    pub errors: Vec<ErrorRow>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Tool {
    name: &'static str,
    version: &'static str,
}

/// The logs of a fleet, counted.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LogCounts {
    /// Logs, each content once.
    pub total: usize,
    /// How their audits ended.
    pub statuses: Statuses,
    /// What the reports say, where warnings fail a run.
    pub verdicts: Verdicts,
    /// Logs that other paths have too, as copies.
    pub copies: usize,
    /// Logs whose first stamp is of no calendar, so that no trend sees them.
    pub undated: usize,
    /// Logs before the time from which findings count.
    pub before: usize,
    /// First stamp of the first of them, as a decimal string.
    pub start_ns: Option<String>,
    /// First stamp of the last.
    pub end_ns: Option<String>,
    /// The version that audited them.
    pub version: String,
    /// Hash of the settings with which it did.
    pub settings: String,
    /// Logs with rows of other versions or settings, which are left aside.
    pub set_aside: usize,
}

/// Whose log it is, and what in it is meant.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct Whose {
    /// The site, as labelled.
    pub site: Option<String>,
    /// The arm, as labelled.
    pub arm: Option<String>,
    /// The robot, as the log or its model calls it.
    pub robot: Option<String>,
    /// The topic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// The joint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<String>,
    /// The frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
}

impl Whose {
    /// Site, arm and robot in words; a dash where none of them is known.
    pub fn arm_label(&self) -> String {
        let parts = [&self.site, &self.arm, &self.robot].into_iter().flatten();
        let parts: Vec<&str> = parts.map(String::as_str).collect();
        if parts.is_empty() { "unknown arm".to_owned() } else { parts.join(" / ") }
    }

    /// What in the log is meant: joint, topic or frame; empty for the whole of it.
    pub fn part(&self) -> String {
        let parts = [&self.joint, &self.topic, &self.frame].into_iter().flatten();
        parts.map(String::as_str).collect::<Vec<_>>().join(" ")
    }
}

/// A dataset, and what was learnt of some of its logs for all.
#[derive(Clone, Debug, Serialize)]
pub struct DatasetRow {
    /// Its folder or file.
    pub dataset: String,
    /// The logs that were asked.
    pub asked: Vec<String>,
    /// The arm of the catalogue that they are of.
    pub robot: Option<String>,
    /// What its columns hold, where their names do not say it.
    pub columns: Vec<SharedRow>,
    /// What they leave open.
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

    /// It in lines: its arm, its columns, what they leave open.
    fn lines(&self) -> Vec<String> {
        let robot = self.robot.as_deref().map_or(String::new(), |robot| format!(": {robot}"));
        let head = format!("{}{robot}, by {}", self.dataset, self.asked.join(", "));
        let row =
            |row: &SharedRow| format!("{} = {} ({})", row.is, row.columns.join(", "), row.why);
        let open = self.open.iter().map(|open| format!("open: {open}"));
        std::iter::once(head).chain(self.columns.iter().map(row)).chain(open).collect()
    }
}

/// An arm.
#[derive(Clone, Debug, Serialize)]
pub struct ArmRow {
    /// Site, arm and robot.
    #[serde(flatten)]
    pub whose: Whose,
    /// Logs of it.
    pub logs: usize,
    /// What their reports say.
    pub verdicts: Verdicts,
    /// The rules that found a warning or an error, with the number of logs.
    pub fails: Vec<RuleCount>,
}

/// One log.
#[derive(Clone, Debug, Serialize)]
pub struct LogRow {
    /// Its path.
    pub path: String,
    /// Site, arm and robots.
    #[serde(flatten)]
    pub whose: Whose,
    /// How its audit ended.
    pub status: Status,
    /// What its report says, where warnings fail a run.
    pub verdict: Option<Verdict>,
    /// First stamp, as a decimal string.
    pub start_ns: Option<String>,
    /// Its report as a page, where that was kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub page: Option<PathBuf>,
    /// The rules that found a warning or an error in it.
    pub codes: Vec<String>,
}

/// In how many logs a rule found something.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RuleCount {
    /// Code of the rule.
    pub code: String,
    /// Logs.
    pub logs: usize,
}

/// A rule that found something on a subject.
#[derive(Clone, Debug, Serialize)]
pub struct FindingRow {
    /// Code of the rule.
    pub code: String,
    /// The fault in a few words.
    pub title: String,
    /// The gravest of them.
    pub severity: Severity,
    /// What is at fault.
    #[serde(flatten)]
    pub whose: Whose,
    /// Logs in which it was found, …
    pub logs: usize,
    /// … and in which it was looked at and not found.
    pub sound: usize,
    /// The latest of them in words, …
    pub message: String,
    /// … where it is, …
    pub path: String,
    /// … and when it began, as a decimal string.
    pub start_ns: Option<String>,
    /// The log whose amount is the largest, where it is another.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub worst: Option<Worst>,
}

/// The log in which an amount is the largest.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Worst {
    /// It in words.
    pub message: String,
    /// The log.
    pub path: String,
}

/// A log that could not be audited.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct ErrorRow {
    /// Its path.
    pub path: String,
    /// How its audit ended.
    pub status: Status,
    /// What is wrong.
    pub what: String,
    /// What to do.
    #[serde(rename = "do")]
    pub remedy: String,
}

impl FleetReport {
    /// The same with pages named from `folder`, where that holds them.
    pub fn linked_from(mut self, folder: &Path) -> Self {
        let Ok(folder) = folder.canonicalize() else { return self };
        for page in self.rows.iter_mut().filter_map(|row| row.page.as_mut()) {
            if let Ok(below) = page.strip_prefix(&folder) {
                *page = below.to_owned();
            }
        }
        self
    }

    /// The report on what `store` holds.
    ///
    /// # Errors
    /// Where it cannot be read.
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

    /// Trends that say that something moves.
    pub fn moving(&self) -> impl Iterator<Item = &TrendRow> {
        self.trends.iter().filter(|row| row.course.is_moving())
    }
}
