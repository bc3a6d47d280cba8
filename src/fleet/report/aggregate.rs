//! Reads the table parts of the report, one at a time.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use polars::prelude::PolarsResult;

use super::finding_rows::{build_finding_rows, logs_by_value};
use super::table_part::TablePart;
use super::trends::{EstimateSeries, TrendPoint, TrendPosition, natural_sort_key};
use super::{ArmRow, FindingRow, FleetQuery, FleetSubject, LogCounts, LogRow, RuleCount, calendar};
use crate::finding::Severity;
use crate::fleet::outcomes::{Failure, Verdicts};
use crate::fleet::store::{Status, Store, StoreError, Table};
use crate::report::Verdict;

pub struct FleetData {
    pub logs: LogCounts,
    pub arms: Vec<ArmRow>,
    pub rows: Vec<LogRow>,
    pub findings: Vec<FindingRow>,
    pub series: Vec<EstimateSeries>,
    pub errors: Vec<Failure>,
}

struct RunRow {
    path: String,
    content: String,
    version: String,
    settings: String,
    site: Option<String>,
    arm: Option<String>,
    robots: Option<String>,
    status: Status,
    verdict: Option<Verdict>,
    start_ns: Option<i64>,
    /// Episode of a log without calendar time.
    episode: Option<usize>,
}

impl RunRow {
    fn subject(&self) -> FleetSubject {
        let (site, arm, robot) = (self.site.clone(), self.arm.clone(), self.robots.clone());
        FleetSubject { site, arm, robot, ..FleetSubject::default() }
    }

    /// Start, if it is a calendar time.
    fn calendar_ns(&self) -> Option<i64> {
        self.start_ns.filter(|&start_ns| start_ns >= calendar::FIRST_CALENDAR_NS)
    }

    /// `None` without time and episode number.
    fn trend_position(&self) -> Option<TrendPosition> {
        self.calendar_ns().map(TrendPosition::Time).or(self.episode.map(TrendPosition::Episode))
    }

    /// An episode, also within a file.
    fn is_episode(&self) -> bool {
        let name = self.path.rsplit('/').next().unwrap_or_default();
        name.contains('#') || name.starts_with("episode_")
    }
}

pub fn collect(store: &Store, query: &FleetQuery) -> Result<FleetData, StoreError> {
    let (logs, set_aside) = read_runs(store, query)?;
    let mut aggregation = Aggregation::new(&logs, query);
    for (table, columns) in [(Table::Checks, CHECK_COLUMNS), (Table::Findings, FINDING_COLUMNS)] {
        let mut seen = HashSet::new();
        store.for_each_part(table, Some(columns), |frame| {
            let part = TablePart(&frame);
            for (row, key) in new_keys(&part, &mut seen)?.into_iter().enumerate() {
                let Some(log) = key.and_then(|key| logs.get(&key)) else { continue };
                match table {
                    Table::Checks => aggregation.add_check(&part, row, log)?,
                    _ => aggregation.add_finding(&part, row, log)?,
                }
            }
            Ok(())
        })?;
    }
    let mut errors = BTreeSet::new();
    store.for_each_part(Table::Errors, Some(&["key", "what", "do"]), |frame| {
        let part = TablePart(&frame);
        for row in 0..frame.height() {
            let log = part.text("key", row)?.and_then(|key| logs.get(&key));
            let Some(log) = log.filter(|log| query.includes_log(log)) else { continue };
            errors.insert(Failure {
                path: log.path.clone(),
                status: log.status,
                what: part.text("what", row)?.unwrap_or_default(),
                remedy: part.text("do", row)?.unwrap_or_default(),
            });
        }
        Ok(())
    })?;
    let Aggregation { passed, findings: found, series, .. } = aggregation;
    Ok(FleetData {
        logs: log_counts(store, &logs, query, set_aside)?,
        arms: arm_rows(&logs, query, &found),
        rows: log_rows(store, &logs, query, &found),
        findings: build_finding_rows(found, &passed, &logs_by_value(&series)),
        series: series.into_values().collect(),
        errors: errors.into_iter().collect(),
    })
}

impl FleetQuery {
    /// Not if the log precedes the requested time.
    fn includes_log(&self, log: &RunRow) -> bool {
        match (self.since_ns, log.calendar_ns()) {
            (Some(since_ns), Some(start_ns)) => start_ns >= since_ns,
            _ => true,
        }
    }

    fn includes_rule(&self, code: &str) -> bool {
        self.select.is_empty() || self.select.iter().any(|selector| selector.matches(code))
    }
}

const RUN_COLUMNS: &[&str] = &[
    "key", "path", "content", "version", "settings", "site", "arm", "robots", "status", "verdict",
    "start_ns",
];
const CHECK_COLUMNS: &[&str] = &[
    "key", "code", "status", "robot", "topic", "joint", "frame", "value", "unit", "ci95_low",
    "ci95_high", "estimate_json",
];
const FINDING_COLUMNS: &[&str] = &[
    "key", "code", "severity", "title", "message", "robot", "topic", "joint", "frame",
    "ignored_because",
];

/// Logs of one version and settings by key, and the number of other rows.
fn read_runs(
    store: &Store,
    query: &FleetQuery,
) -> Result<(BTreeMap<String, RunRow>, usize), StoreError> {
    let mut logs = BTreeMap::new();
    store.for_each_part(Table::Runs, Some(RUN_COLUMNS), |part| {
        let frame = TablePart(&part);
        for row in 0..part.height() {
            let text = |name: &str| frame.text(name, row);
            let path = text("path")?.unwrap_or_default();
            let said = query.template.as_ref().map(|it| it.labels(path.as_ref()));
            let label = |name: &str| match &said {
                Some(said) => Ok(said.get(name).cloned()),
                None => text(name),
            };
            let status = text("status")?.and_then(|name| Status::from_name(&name));
            let log = RunRow {
                content: text("content")?.unwrap_or_default(),
                version: text("version")?.unwrap_or_default(),
                settings: text("settings")?.unwrap_or_default(),
                site: label("site")?,
                arm: label("arm")?,
                robots: text("robots")?,
                status: status.unwrap_or(Status::Unreadable),
                verdict: text("verdict")?.and_then(|name| Verdict::from_name(&name)),
                start_ns: frame.stamp("start_ns", row)?,
                episode: None,
                path,
            };
            logs.insert(text("key")?.unwrap_or_default(), log);
        }
        Ok(())
    })?;
    let total = logs.len();
    if let Some((version, settings)) = select_settings(store, &logs, query) {
        logs.retain(|_, log| log.version == version && log.settings == settings);
    }
    let set_aside = total - logs.len();
    let is_open = |log: &&mut RunRow| log.calendar_ns().is_none() && log.is_episode();
    let mut episodes: Vec<&mut RunRow> = logs.values_mut().filter(is_open).collect();
    episodes.sort_by_cached_key(|log| natural_sort_key(&log.path));
    for (number, log) in episodes.into_iter().enumerate() {
        log.episode = Some(number);
    }
    Ok((logs, set_aside))
}

/// The requested version and settings, otherwise the latest version with its most recent settings.
fn select_settings(
    store: &Store,
    logs: &BTreeMap<String, RunRow>,
    query: &FleetQuery,
) -> Option<(String, String)> {
    let is_asked = |log: &&RunRow| match &query.settings {
        Some(passed) => log.settings.starts_with(passed.as_str()),
        None => true,
    };
    let number = |part: &str| part.parse::<u64>().unwrap_or(0);
    let rank = |version: &str| version.split(['.', '-', '+']).map(number).collect::<Vec<_>>();
    let kinds: BTreeSet<(&str, &str)> = logs
        .values()
        .filter(is_asked)
        .map(|log| (log.version.as_str(), log.settings.as_str()))
        .collect();
    let kinds = kinds.into_iter().map(|(version, settings)| {
        (rank(version), store.settings_time(settings), version, settings)
    });
    let (.., version, settings) = kinds.max()?;
    Some((version.to_owned(), settings.to_owned()))
}

/// Keys of a part that earlier parts lack. The rows of a log are contiguous.
fn new_keys(part: &TablePart<'_>, seen: &mut HashSet<String>) -> PolarsResult<Vec<Option<String>>> {
    let mut keys = Vec::with_capacity(part.0.height());
    for row in 0..part.0.height() {
        keys.push(part.text("key", row)?.filter(|key| !seen.contains(key)));
    }
    seen.extend(keys.iter().flatten().cloned());
    Ok(keys)
}

/// Start time, episode number and path.
pub(super) type LogPlace = (Option<i64>, Option<usize>, String);

pub(super) struct FindingLogs {
    pub(super) severity: Severity,
    /// Title and message per log.
    pub(super) logs: BTreeMap<LogPlace, (String, String)>,
}

/// Rule and subject.
pub(super) type FindingKey = (String, FleetSubject);

struct Aggregation<'a> {
    query: &'a FleetQuery,
    /// Robot of each log with a single one.
    sole_robots: HashMap<&'a str, &'a str>,
    /// Number of logs that passed, per rule and subject.
    passed: BTreeMap<FindingKey, usize>,
    findings: BTreeMap<FindingKey, FindingLogs>,
    /// Logs without calendar time are separate.
    series: BTreeMap<(FindingKey, String, bool), EstimateSeries>,
}

impl<'a> Aggregation<'a> {
    fn new(logs: &'a BTreeMap<String, RunRow>, query: &'a FleetQuery) -> Self {
        let sole = logs.values().filter_map(|log| {
            let robots = log.robots.as_deref().filter(|robots| !robots.contains(", "))?;
            Some((log.path.as_str(), robots))
        });
        Self {
            query,
            sole_robots: sole.collect(),
            passed: BTreeMap::new(),
            findings: BTreeMap::new(),
            series: BTreeMap::new(),
        }
    }

    /// If the topic is the log file, the subject is the log.
    fn subject(
        &self,
        part: &TablePart<'_>,
        row: usize,
        log: &RunRow,
    ) -> PolarsResult<FleetSubject> {
        let named = part.text("robot", row)?;
        let sole = || self.sole_robots.get(log.path.as_str()).map(|name| (*name).to_owned());
        Ok(FleetSubject {
            site: log.site.clone(),
            arm: log.arm.clone(),
            robot: named.or_else(sole),
            topic: part.text("topic", row)?.filter(|topic| !log.path.ends_with(topic.as_str())),
            joint: part.text("joint", row)?,
            frame: part.text("frame", row)?,
        })
    }

    fn add_check(&mut self, part: &TablePart<'_>, row: usize, log: &RunRow) -> PolarsResult<()> {
        let code = part.text("code", row)?.unwrap_or_default();
        if !self.query.includes_rule(&code) {
            return Ok(());
        }
        let passes = part.text("status", row)?.as_deref() == Some("pass");
        let amount = part.number("value", row)?.zip(part.text("unit", row)?);
        let ends = part.number("ci95_low", row)?.zip(part.number("ci95_high", row)?);
        let point = log.trend_position().zip(amount).zip(ends);
        if !passes && point.is_none() {
            return Ok(());
        }
        let cause = (code, self.subject(part, row, log)?);
        if let Some(((at, (value, unit)), (low, high))) = point {
            let is_dated = matches!(at, TrendPosition::Time(_));
            let series = self.series.entry((cause.clone(), unit.clone(), is_dated));
            let series = match series {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(EstimateSeries {
                    code: cause.0.clone(),
                    name: part.estimate_name(row)?,
                    unit,
                    subject: cause.1.clone(),
                    points: Vec::new(),
                }),
            };
            series.points.push(TrendPoint { at, value, ci95: [low, high], path: log.path.clone() });
        }
        if passes && self.query.includes_log(log) {
            *self.passed.entry(cause).or_default() += 1;
        }
        Ok(())
    }

    fn add_finding(&mut self, part: &TablePart<'_>, row: usize, log: &RunRow) -> PolarsResult<()> {
        let code = part.text("code", row)?.unwrap_or_default();
        let is_ignored = part.text("ignored_because", row)?.is_some();
        if is_ignored || !self.query.includes_rule(&code) || !self.query.includes_log(log) {
            return Ok(());
        }
        let severity = part.text("severity", row)?;
        let severity = match severity.as_deref() {
            Some("error") => Severity::Error,
            Some("warning") => Severity::Warning,
            _ => Severity::Info,
        };
        let title = part.text("title", row)?.unwrap_or_default();
        let subject = self.subject(part, row, log)?;
        let found = self
            .findings
            .entry((code, subject))
            .or_insert_with(|| FindingLogs { severity, logs: BTreeMap::new() });
        found.severity = found.severity.max(severity);
        let message = part.text("message", row)?.unwrap_or_default();
        found.logs.insert((log.start_ns, log.episode, log.path.clone()), (title, message));
        Ok(())
    }
}

/// Latest first.
fn log_rows(
    store: &Store,
    logs: &BTreeMap<String, RunRow>,
    query: &FleetQuery,
    found: &BTreeMap<FindingKey, FindingLogs>,
) -> Vec<LogRow> {
    let mut codes: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for ((code, _), found) in found.iter().filter(|(_, it)| it.severity > Severity::Info) {
        for (.., path) in found.logs.keys() {
            codes.entry(path.as_str()).or_default().insert(code.as_str());
        }
    }
    let row = |(key, log): &(&String, &RunRow)| LogRow {
        page: store.page_path(key).canonicalize().ok(),
        path: log.path.clone(),
        subject: log.subject(),
        status: log.status,
        verdict: log.verdict,
        start_ns: log.start_ns.map(|start_ns| start_ns.to_string()),
        codes: codes
            .get(log.path.as_str())
            .into_iter()
            .flatten()
            .map(|&it| it.to_owned())
            .collect(),
    };
    let mut counted: Vec<(&String, &RunRow)> =
        logs.iter().filter(|(_, log)| query.includes_log(log)).collect();
    counted.sort_by(|(_, a), (_, b)| {
        let own = |log: &RunRow| (log.episode, log.path.clone());
        b.start_ns.cmp(&a.start_ns).then_with(|| own(a).cmp(&own(b)))
    });
    counted.iter().map(row).collect()
}

/// One row per site, arm and robot.
fn arm_rows(
    logs: &BTreeMap<String, RunRow>,
    query: &FleetQuery,
    found: &BTreeMap<FindingKey, FindingLogs>,
) -> Vec<ArmRow> {
    type Name = (Option<String>, Option<String>, Option<String>);
    let mut arms: BTreeMap<Name, ArmRow> = BTreeMap::new();
    for log in logs.values().filter(|log| query.includes_log(log)) {
        let name = (log.site.clone(), log.arm.clone(), log.robots.clone());
        let arm = arms.entry(name).or_insert_with(|| ArmRow {
            subject: log.subject(),
            logs: 0,
            not_audited: 0,
            verdicts: Verdicts::default(),
            fails: Vec::new(),
        });
        arm.logs += 1;
        arm.not_audited += usize::from(log.status != Status::Audited);
        arm.verdicts.add(log.verdict);
    }
    for arm in arms.values_mut() {
        let mut by_code: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        let is_its = |subject: &FleetSubject| {
            (&subject.site, &subject.arm) == (&arm.subject.site, &arm.subject.arm)
                && match (&subject.robot, &arm.subject.robot) {
                    (Some(one), Some(all)) => all.split(", ").any(|name| name == one),
                    (None, _) => true,
                    (Some(_), None) => false,
                }
        };
        let grave = found.iter().filter(|(_, found)| found.severity > Severity::Info);
        for ((code, _), found) in grave.filter(|((_, subject), _)| is_its(subject)) {
            let paths = found.logs.keys().map(|(.., path)| path.as_str());
            by_code.entry(code.as_str()).or_default().extend(paths);
        }
        let fails = by_code
            .into_iter()
            .map(|(code, paths)| RuleCount { code: code.to_owned(), logs: paths.len() });
        arm.fails = fails.collect();
    }
    arms.into_values().collect()
}

fn log_counts(
    store: &Store,
    logs: &BTreeMap<String, RunRow>,
    query: &FleetQuery,
    set_aside: usize,
) -> Result<LogCounts, StoreError> {
    let mut counts = LogCounts { total: logs.len(), set_aside, ..LogCounts::default() };
    for log in logs.values() {
        counts.statuses.add(log.status);
        counts.verdicts.add(log.verdict);
        let is_undated = log.status == Status::Audited && log.trend_position().is_none();
        counts.undated += usize::from(is_undated);
        counts.before += usize::from(!query.includes_log(log));
        (counts.version, counts.settings) = (log.version.clone(), log.settings.clone());
    }
    let dated = || logs.values().filter_map(RunRow::calendar_ns);
    counts.start_ns = dated().min().map(|stamp| stamp.to_string());
    counts.end_ns = dated().max().map(|stamp| stamp.to_string());
    let known: HashSet<&str> = logs.values().map(|log| log.content.as_str()).collect();
    let mut paths: HashSet<(String, String)> = HashSet::new();
    store.for_each_part(Table::Sources, Some(&["path", "content"]), |frame| {
        let part = TablePart(&frame);
        for row in 0..frame.height() {
            let (path, content) = (part.text("path", row)?, part.text("content", row)?);
            paths.extend(path.zip(content).filter(|(_, content)| known.contains(content.as_str())));
        }
        Ok(())
    })?;
    let contents: HashSet<&str> = paths.iter().map(|(_, content)| content.as_str()).collect();
    counts.copies = paths.len() - contents.len();
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn title_and_message_come_from_the_same_log() {
        let words = |name: &str| (format!("title of {name}"), format!("message of {name}"));
        let logs = ["a", "b"].map(|name| ((Some(1), None, name.to_owned()), words(name)));
        let found = FindingLogs { severity: Severity::Warning, logs: logs.into() };
        let cause = ("LAT001".to_owned(), FleetSubject::default());
        let rows = build_finding_rows([(cause, found)].into(), &BTreeMap::new(), &BTreeMap::new());
        let said = [&rows[0].title, &rows[0].message, &rows[0].path];
        assert_eq!(said, ["title of b", "message of b", "b"]);
    }
}
