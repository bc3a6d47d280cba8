//! Reads the table parts of the report, one at a time.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use polars::prelude::PolarsResult;

use super::found::{finding_rows, worst_logs};
use super::part::Part;
use super::trends::{At, Point, Series, natural};
use super::{
    ArmRow, ErrorRow, FindingRow, LogCounts, LogRow, Question, RuleCount, Whose, calendar,
};
use crate::finding::Severity;
use crate::fleet::outcomes::Verdicts;
use crate::fleet::store::{Status, Store, StoreError, Table};
use crate::report::Verdict;

pub struct Gathered {
    pub logs: LogCounts,
    pub arms: Vec<ArmRow>,
    pub rows: Vec<LogRow>,
    pub findings: Vec<FindingRow>,
    pub series: Vec<Series>,
    pub errors: Vec<ErrorRow>,
}

struct Log {
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

impl Log {
    fn whose(&self) -> Whose {
        let (site, arm, robot) = (self.site.clone(), self.arm.clone(), self.robots.clone());
        Whose { site, arm, robot, ..Whose::default() }
    }

    /// Start, if it is a calendar time.
    fn dated_ns(&self) -> Option<i64> {
        self.start_ns.filter(|&start_ns| start_ns >= calendar::FIRST_NS)
    }

    /// `None` without time and episode number.
    fn at(&self) -> Option<At> {
        self.dated_ns().map(At::Time).or(self.episode.map(At::Episode))
    }

    /// An episode, also within a file.
    fn is_episode(&self) -> bool {
        let name = self.path.rsplit('/').next().unwrap_or_default();
        name.contains('#') || name.starts_with("episode_")
    }
}

pub fn gather(store: &Store, question: &Question) -> Result<Gathered, StoreError> {
    let (logs, set_aside) = logs(store, question)?;
    let mut gathering = Gathering::of(&logs, question);
    for (table, columns) in [(Table::Checks, CHECKS), (Table::Findings, FINDINGS)] {
        let mut seen = HashSet::new();
        store.each(table, Some(columns), |frame| {
            let part = Part(&frame);
            for (row, key) in new_keys(&part, &mut seen)?.into_iter().enumerate() {
                let Some(log) = key.and_then(|key| logs.get(&key)) else { continue };
                match table {
                    Table::Checks => gathering.check(&part, row, log)?,
                    _ => gathering.finding(&part, row, log)?,
                }
            }
            Ok(())
        })?;
    }
    let mut errors = BTreeSet::new();
    store.each(Table::Errors, Some(&["key", "what", "do"]), |frame| {
        let part = Part(&frame);
        for row in 0..frame.height() {
            let log = part.text("key", row)?.and_then(|key| logs.get(&key));
            let Some(log) = log.filter(|log| question.counts(log)) else { continue };
            errors.insert(ErrorRow {
                path: log.path.clone(),
                status: log.status,
                what: part.text("what", row)?.unwrap_or_default(),
                remedy: part.text("do", row)?.unwrap_or_default(),
            });
        }
        Ok(())
    })?;
    let Gathering { asked, found, series, .. } = gathering;
    Ok(Gathered {
        logs: log_counts(store, &logs, question, set_aside)?,
        arms: arms(&logs, question, &found),
        rows: log_rows(store, &logs, question, &found),
        findings: finding_rows(found, &asked, &worst_logs(&series)),
        series: series.into_values().collect(),
        errors: errors.into_iter().collect(),
    })
}

impl Question {
    /// Not if the log precedes the requested time.
    fn counts(&self, log: &Log) -> bool {
        match (self.since_ns, log.dated_ns()) {
            (Some(since_ns), Some(start_ns)) => start_ns >= since_ns,
            _ => true,
        }
    }

    fn asks(&self, code: &str) -> bool {
        self.select.is_empty() || self.select.iter().any(|selector| selector.matches(code))
    }
}

const RUNS: &[&str] = &[
    "key", "path", "content", "version", "settings", "site", "arm", "robots", "status", "verdict",
    "start_ns",
];
const CHECKS: &[&str] = &[
    "key",
    "code",
    "status",
    "robot",
    "topic",
    "joint",
    "frame",
    "value",
    "unit",
    "ci95_low",
    "ci95_high",
    "estimate_json",
];
const FINDINGS: &[&str] = &[
    "key",
    "code",
    "severity",
    "title",
    "message",
    "robot",
    "topic",
    "joint",
    "frame",
    "ignored_because",
];

/// Logs of one version and settings by key, and the number of other rows.
fn logs(store: &Store, question: &Question) -> Result<(BTreeMap<String, Log>, usize), StoreError> {
    let mut logs = BTreeMap::new();
    store.each(Table::Runs, Some(RUNS), |part| {
        let frame = Part(&part);
        for row in 0..part.height() {
            let text = |name: &str| frame.text(name, row);
            let path = text("path")?.unwrap_or_default();
            let said = question.template.as_ref().map(|it| it.labels(path.as_ref()));
            let label = |name: &str| match &said {
                Some(said) => Ok(said.get(name).cloned()),
                None => text(name),
            };
            let status = text("status")?.and_then(|name| Status::named(&name));
            let log = Log {
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
    if let Some((version, settings)) = wanted(store, &logs, question) {
        logs.retain(|_, log| log.version == version && log.settings == settings);
    }
    let set_aside = total - logs.len();
    let is_open = |log: &&mut Log| log.dated_ns().is_none() && log.is_episode();
    let mut episodes: Vec<&mut Log> = logs.values_mut().filter(is_open).collect();
    episodes.sort_by_cached_key(|log| natural(&log.path));
    for (number, log) in episodes.into_iter().enumerate() {
        log.episode = Some(number);
    }
    Ok((logs, set_aside))
}

/// The requested version and settings, otherwise the latest version with its most recent settings.
fn wanted(
    store: &Store,
    logs: &BTreeMap<String, Log>,
    question: &Question,
) -> Option<(String, String)> {
    let is_asked = |log: &&Log| match &question.settings {
        Some(asked) => log.settings.starts_with(asked.as_str()),
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
        (rank(version), store.settings_written(settings), version, settings)
    });
    let (.., version, settings) = kinds.max()?;
    Some((version.to_owned(), settings.to_owned()))
}

/// Keys of a part that earlier parts lack. The rows of a log are contiguous.
fn new_keys(part: &Part<'_>, seen: &mut HashSet<String>) -> PolarsResult<Vec<Option<String>>> {
    let mut keys = Vec::with_capacity(part.0.height());
    for row in 0..part.0.height() {
        keys.push(part.text("key", row)?.filter(|key| !seen.contains(key)));
    }
    seen.extend(keys.iter().flatten().cloned());
    Ok(keys)
}

/// Start time, episode number and path.
pub(super) type LogPlace = (Option<i64>, Option<usize>, String);

pub(super) struct Found {
    pub(super) severity: Severity,
    /// Title and message per log.
    pub(super) logs: BTreeMap<LogPlace, (String, String)>,
}

/// Rule and subject.
pub(super) type Cause = (String, Whose);

struct Gathering<'a> {
    question: &'a Question,
    /// Robot of each log with a single one.
    sole_robots: HashMap<&'a str, &'a str>,
    /// Number of logs that passed, per rule and subject.
    asked: BTreeMap<Cause, usize>,
    found: BTreeMap<Cause, Found>,
    /// Logs without calendar time are separate.
    series: BTreeMap<(Cause, String, bool), Series>,
}

impl<'a> Gathering<'a> {
    fn of(logs: &'a BTreeMap<String, Log>, question: &'a Question) -> Self {
        let sole = logs.values().filter_map(|log| {
            let robots = log.robots.as_deref().filter(|robots| !robots.contains(", "))?;
            Some((log.path.as_str(), robots))
        });
        Self {
            question,
            sole_robots: sole.collect(),
            asked: BTreeMap::new(),
            found: BTreeMap::new(),
            series: BTreeMap::new(),
        }
    }

    /// If the topic is the log file, the subject is the log.
    fn whose(&self, part: &Part<'_>, row: usize, log: &Log) -> PolarsResult<Whose> {
        let named = part.text("robot", row)?;
        let sole = || self.sole_robots.get(log.path.as_str()).map(|name| (*name).to_owned());
        Ok(Whose {
            site: log.site.clone(),
            arm: log.arm.clone(),
            robot: named.or_else(sole),
            topic: part.text("topic", row)?.filter(|topic| !log.path.ends_with(topic.as_str())),
            joint: part.text("joint", row)?,
            frame: part.text("frame", row)?,
        })
    }

    fn check(&mut self, part: &Part<'_>, row: usize, log: &Log) -> PolarsResult<()> {
        let code = part.text("code", row)?.unwrap_or_default();
        if !self.question.asks(&code) {
            return Ok(());
        }
        let passes = part.text("status", row)?.as_deref() == Some("pass");
        let amount = part.number("value", row)?.zip(part.text("unit", row)?);
        let ends = part.number("ci95_low", row)?.zip(part.number("ci95_high", row)?);
        let point = log.at().zip(amount).zip(ends);
        if !passes && point.is_none() {
            return Ok(());
        }
        let cause = (code, self.whose(part, row, log)?);
        if let Some(((at, (value, unit)), (low, high))) = point {
            let is_dated = matches!(at, At::Time(_));
            let series = self.series.entry((cause.clone(), unit.clone(), is_dated));
            let series = match series {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(Series {
                    code: cause.0.clone(),
                    name: part.name_of_estimate(row)?,
                    unit,
                    whose: cause.1.clone(),
                    points: Vec::new(),
                }),
            };
            series.points.push(Point { at, value, ci95: [low, high], path: log.path.clone() });
        }
        if passes && self.question.counts(log) {
            *self.asked.entry(cause).or_default() += 1;
        }
        Ok(())
    }

    fn finding(&mut self, part: &Part<'_>, row: usize, log: &Log) -> PolarsResult<()> {
        let code = part.text("code", row)?.unwrap_or_default();
        let is_ignored = part.text("ignored_because", row)?.is_some();
        if is_ignored || !self.question.asks(&code) || !self.question.counts(log) {
            return Ok(());
        }
        let severity = part.text("severity", row)?;
        let severity = match severity.as_deref() {
            Some("error") => Severity::Error,
            Some("warning") => Severity::Warning,
            _ => Severity::Info,
        };
        let title = part.text("title", row)?.unwrap_or_default();
        let whose = self.whose(part, row, log)?;
        let found = self
            .found
            .entry((code, whose))
            .or_insert_with(|| Found { severity, logs: BTreeMap::new() });
        found.severity = found.severity.max(severity);
        let message = part.text("message", row)?.unwrap_or_default();
        found.logs.insert((log.start_ns, log.episode, log.path.clone()), (title, message));
        Ok(())
    }
}

/// Latest first.
fn log_rows(
    store: &Store,
    logs: &BTreeMap<String, Log>,
    question: &Question,
    found: &BTreeMap<Cause, Found>,
) -> Vec<LogRow> {
    let mut codes: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for ((code, _), found) in found.iter().filter(|(_, it)| it.severity > Severity::Info) {
        for (.., path) in found.logs.keys() {
            codes.entry(path.as_str()).or_default().insert(code.as_str());
        }
    }
    let row = |(key, log): &(&String, &Log)| LogRow {
        page: store.page(key).canonicalize().ok(),
        path: log.path.clone(),
        whose: log.whose(),
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
    let mut counted: Vec<(&String, &Log)> =
        logs.iter().filter(|(_, log)| question.counts(log)).collect();
    counted.sort_by(|(_, a), (_, b)| {
        let own = |log: &Log| (log.episode, log.path.clone());
        b.start_ns.cmp(&a.start_ns).then_with(|| own(a).cmp(&own(b)))
    });
    counted.iter().map(row).collect()
}

/// One row per site, arm and robot.
fn arms(
    logs: &BTreeMap<String, Log>,
    question: &Question,
    found: &BTreeMap<Cause, Found>,
) -> Vec<ArmRow> {
    type Name = (Option<String>, Option<String>, Option<String>);
    let mut arms: BTreeMap<Name, ArmRow> = BTreeMap::new();
    for log in logs.values().filter(|log| question.counts(log)) {
        let name = (log.site.clone(), log.arm.clone(), log.robots.clone());
        let arm = arms.entry(name).or_insert_with(|| ArmRow {
            whose: log.whose(),
            logs: 0,
            verdicts: Verdicts::default(),
            fails: Vec::new(),
        });
        arm.logs += 1;
        arm.verdicts.count(log.verdict);
    }
    for arm in arms.values_mut() {
        let mut by_code: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        let is_its = |whose: &Whose| {
            (&whose.site, &whose.arm) == (&arm.whose.site, &arm.whose.arm)
                && match (&whose.robot, &arm.whose.robot) {
                    (Some(one), Some(all)) => all.split(", ").any(|name| name == one),
                    (None, _) => true,
                    (Some(_), None) => false,
                }
        };
        let grave = found.iter().filter(|(_, found)| found.severity > Severity::Info);
        for ((code, _), found) in grave.filter(|((_, whose), _)| is_its(whose)) {
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
    logs: &BTreeMap<String, Log>,
    question: &Question,
    set_aside: usize,
) -> Result<LogCounts, StoreError> {
    let mut counts = LogCounts { total: logs.len(), set_aside, ..LogCounts::default() };
    for log in logs.values() {
        counts.statuses.count(log.status);
        counts.verdicts.count(log.verdict);
        let is_undated = log.status == Status::Audited && log.at().is_none();
        counts.undated += usize::from(is_undated);
        counts.before += usize::from(!question.counts(log));
        (counts.version, counts.settings) = (log.version.clone(), log.settings.clone());
    }
    let dated = || logs.values().filter_map(Log::dated_ns);
    counts.start_ns = dated().min().map(|stamp| stamp.to_string());
    counts.end_ns = dated().max().map(|stamp| stamp.to_string());
    let known: HashSet<&str> = logs.values().map(|log| log.content.as_str()).collect();
    let mut paths: HashSet<(String, String)> = HashSet::new();
    store.each(Table::Sources, Some(&["path", "content"]), |frame| {
        let part = Part(&frame);
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
    fn title_and_message_are_of_one_log() {
        let words = |name: &str| (format!("title of {name}"), format!("message of {name}"));
        let logs = ["a", "b"].map(|name| ((Some(1), None, name.to_owned()), words(name)));
        let found = Found { severity: Severity::Warning, logs: logs.into() };
        let cause = ("LAT001".to_owned(), Whose::default());
        let rows = finding_rows([(cause, found)].into(), &BTreeMap::new(), &BTreeMap::new());
        let said = [&rows[0].title, &rows[0].message, &rows[0].path];
        assert_eq!(said, ["title of b", "message of b", "b"]);
    }
}
