//! Text shared by all human-readable formats.

mod finding_groups;
mod inconclusive;
mod passed;

use std::collections::{BTreeSet, HashMap, HashSet};
use std::hash::Hash;

use super::{Report, RobotRow, StreamRow, Verdict, undecided};
use crate::finding::{CheckRow, IgnoredFinding, Severity, Status, Subject};

pub(crate) use finding_groups::{FIX, FindingGroup};
pub(crate) use inconclusive::OpenChecks;
pub(crate) use passed::{AmountBound, PassedChecks};

pub(crate) struct Outline<'a> {
    report: &'a Report,
    /// Whether there are several, so subjects must include the robot.
    has_several_robots: bool,
}

impl<'a> Outline<'a> {
    pub fn new(report: &'a Report) -> Self {
        Self { report, has_several_robots: report.robots.len() > 1 }
    }

    /// `2 errors; 46 passed, 3 inconclusive (LAT001–003), 8 not applicable`.
    pub fn verdict_reason(&self) -> String {
        let counts = self.check_counts();
        match self.report.verdict {
            Verdict::Pass if self.report.findings.is_empty() => counts,
            Verdict::Pass | Verdict::Fail => format!("{}; {counts}", self.finding_counts()),
            Verdict::Inconclusive => format!("{}; {counts}", self.undecided_text()),
        }
    }

    /// `46 passed, 3 inconclusive (LAT001–003), 8 not applicable, 1 finding ignored`.
    pub fn check_counts(&self) -> String {
        let count = |status: Status| self.rows_of(status).count();
        let ignored = self.report.ignored.len();
        let others = [
            (count(Status::Inconclusive), format!("inconclusive{}", self.inconclusive_codes())),
            (count(Status::Skipped), "not applicable".to_owned()),
            (ignored, format!("{} ignored", if ignored == 1 { "finding" } else { "findings" })),
        ];
        let others = others.into_iter().filter(|(count, _)| *count > 0);
        let others = others.map(|(count, what)| format!(", {count} {what}"));
        format!("{} passed{}", count(Status::Pass), others.collect::<String>())
    }

    fn rows_of(&self, status: Status) -> impl Iterator<Item = &'a CheckRow> {
        self.report.checks.iter().filter(move |row| row.status == status)
    }

    /// ` (LAT001–003)`, or empty if there are many.
    fn inconclusive_codes(&self) -> String {
        const MAX_RANGES: usize = 4;
        let mut codes: Vec<&str> = self.rows_of(Status::Inconclusive).map(|row| row.code).collect();
        codes.dedup();
        let ranges = code_ranges(&codes);
        match ranges.len() {
            1..=MAX_RANGES => format!(" ({})", ranges.join(", ")),
            _ => String::new(),
        }
    }

    /// `3 errors, 1 warning`; a cause on several subjects counts once.
    fn finding_counts(&self) -> String {
        let severities = [Severity::Error, Severity::Warning, Severity::Info];
        let groups = self.finding_groups();
        let counts = severities.into_iter().filter_map(|severity| {
            match groups.iter().filter(|group| group.severity() == severity).count() {
                0 => None,
                1 => Some(format!("1 {}", severity.name())),
                many if severity == Severity::Info => Some(format!("{many} {}", severity.name())),
                many => Some(format!("{many} {}s", severity.name())),
            }
        });
        counts.collect::<Vec<_>>().join(", ")
    }

    /// `no problems found, but not decided: joint zero (ZER001)`.
    pub fn undecided_text(&self) -> String {
        let faults = self.report.findings.iter().filter(|found| found.severity > Severity::Info);
        let found = match faults.count() {
            0 => "no problems found".to_owned(),
            _ => self.finding_counts(),
        };
        let named = undecided(&self.report.checks)
            .map(|rule| format!("{} ({})", rule.plain_name(), rule.code));
        let named: Vec<String> = named.collect();
        match named.len() {
            0 => found,
            _ => format!("{found}, but not decided: {}", named.join(", ")),
        }
    }

    /// `12.0 s, 2,102 messages, 6 topics`. `None` without a log.
    pub fn extent(&self) -> Option<String> {
        let log = &self.report.log;
        let topics = self.report.streams.iter().map(|stream| stream.topic.as_str());
        let topics = topics.collect::<BTreeSet<_>>().len();
        let duration_s = log.duration_s?;
        let topics = if topics == 1 { "1 topic".to_owned() } else { format!("{topics} topics") };
        Some(format!("{duration_s:.1} s, {} messages, {topics}", group_digits(log.messages)))
    }

    pub fn subject(&self, subject: &Subject) -> String {
        subject.label_among(self.has_several_robots)
    }

    /// Combines all joints of an arm.
    fn subjects(&self, rows: &[&CheckRow]) -> String {
        let mut said = Vec::new();
        let mut rows = rows.to_vec();
        for robot in self.report.robots.iter().filter(|robot| robot.joints.len() > 1) {
            let is_its = |row: &&CheckRow| is_joint_of(&row.subject, robot);
            let joints: BTreeSet<&str> =
                rows.iter().filter(|row| is_its(row)).map(|row| row.subject.label()).collect();
            if joints.len() == robot.joints.len() {
                let of = if self.has_several_robots {
                    format!(" of {}", robot.name)
                } else {
                    String::new()
                };
                said.push(format!("all {} joints{of}", joints.len()));
                rows.retain(|row| !is_its(row));
            }
        }
        said.extend(rows.iter().map(|row| self.subject(&row.subject)));
        said.join(", ")
    }

    /// ` on /pose, /tf`. Empty for the whole run.
    fn subject_suffix(&self, rows: &[&CheckRow]) -> String {
        match self.subjects(rows) {
            none if none.is_empty() => String::new(),
            subjects => format!(" on {subjects}"),
        }
    }

    /// Parameters observable only in combination, one line per motion that would separate them.
    pub fn unobservable_parameters(&self) -> Vec<String> {
        let streams = self.report.observability.iter();
        let lines = streams
            .flat_map(|stream| stream.combined.iter().map(|one| one.sentence(&stream.topic)));
        lines.collect()
    }

    /// One line each, with the reason.
    pub fn ignored_findings(&self) -> Vec<String> {
        let said = self.report.ignored.iter().map(|IgnoredFinding { finding, reason, place }| {
            let (code, subject) = (finding.code, self.subject(&finding.subject));
            let on = if subject.is_empty() { String::new() } else { format!(" on {subject}") };
            format!("{code}{on}: {} ({reason}; {place})", finding.message)
        });
        said.collect()
    }

    /// Topics and table columns that the audit did not use and no finding names, one line per reason.
    pub fn unused_streams(&self) -> Vec<String> {
        let is_found = |topic: &str| {
            self.report.findings.iter().any(|found| found.subject.topic.as_deref() == Some(topic))
        };
        let is_unused = |row: &&StreamRow| ["ignored", "unassigned"].contains(&row.role);
        let rows = self.report.streams.iter().filter(is_unused);
        let rows = rows.filter(|row| !is_found(&row.topic));
        let groups = group_by_key(rows, |row| row.reason.as_str()).into_iter();
        let lines = groups.map(|(reason, rows)| {
            let name = |row: &&StreamRow| match row.columns.as_slice() {
                [] | [_] => row.topic.clone(),
                [first, .., last] => format!("{first}…{last}"),
            };
            let mut names: Vec<String> = rows.iter().map(name).collect();
            names.dedup();
            format!("{}: {reason}", list_names(&names))
        });
        lines.collect()
    }

    /// One line per reason.
    pub fn skipped_checks(&self) -> Vec<String> {
        let ignored = self.report.ignored.iter().map(|known| &known.finding);
        let ignored: HashSet<(&str, &Subject)> = ignored.map(|it| (it.code, &it.subject)).collect();
        let rows = self.report.checks.iter().filter(|row| row.status == Status::Skipped);
        let rows = rows.filter(|row| !ignored.contains(&(row.code, &row.subject)));
        let said = self.report.error.as_ref().map(|trouble| trouble.what.as_str());
        let groups = group_by_key(rows, |row| row.reason.as_deref()).into_iter();
        let lines = groups.map(|(reason, rows)| {
            let mut codes: Vec<&str> = rows.iter().map(|row| row.code).collect();
            codes.dedup();
            let reason = if reason == said { "as said above" } else { reason.unwrap_or_default() };
            format!("{}: {reason}", code_ranges(&codes).join(", "))
        });
        lines.collect()
    }
}

fn is_joint_of(subject: &Subject, robot: &RobotRow) -> bool {
    subject.robot.as_ref() == Some(&robot.name)
        && subject.joint.as_ref().is_some_and(|joint| robot.joints.contains(joint))
}

/// `a, b and 3 more`.
fn list_names(names: &[String]) -> String {
    const MAX_LISTED: usize = 6;
    match names.len() {
        count if count > MAX_LISTED => {
            let shown = MAX_LISTED - 1;
            format!("{} and {} more", names[..shown].join(", "), count - shown)
        }
        _ => names.join(", "),
    }
}

fn group_digits(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Groups in the order of their first rows.
fn group_by_key<'a, R, K: Copy + Eq + Hash>(
    rows: impl Iterator<Item = &'a R>,
    key: impl Fn(&'a R) -> K,
) -> Vec<(K, Vec<&'a R>)> {
    let mut groups: Vec<(K, Vec<&R>)> = Vec::new();
    let mut places: HashMap<K, usize> = HashMap::new();
    for row in rows {
        let key = key(row);
        let place = *places.entry(key).or_insert(groups.len());
        if place == groups.len() {
            groups.push((key, Vec::new()));
        }
        groups[place].1.push(row);
    }
    groups
}

/// `ORD002–005` for three or more codes.
fn code_ranges(codes: &[&str]) -> Vec<String> {
    let split = |code: &str| -> Option<(String, u32)> {
        let (family, number) = code.split_at_checked(3)?;
        Some((family.to_owned(), number.parse().ok()?))
    };
    let follows = |a: &&str, b: &&str| match (split(a), split(b)) {
        (Some((a_family, a)), Some((b_family, b))) => a_family == b_family && b == a + 1,
        _ => false,
    };
    let mut texts = Vec::new();
    for run in codes.chunk_by(follows) {
        match run {
            [first, _, .., last] => texts.push(format!("{first}–{}", &last[3..])),
            run => texts.extend(run.iter().map(|&code| code.to_owned())),
        }
    }
    texts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_grouped_in_threes() {
        assert_eq!(
            ["1", "999", "20,001", "1,234,567"],
            [1, 999, 20_001, 1_234_567].map(group_digits)
        );
    }

    #[test]
    fn consecutive_codes_become_ranges() {
        let codes = ["FRM001", "FRM002", "ORD002", "ORD003", "ORD004", "ORD005", "ORD008"];
        assert_eq!(code_ranges(&codes), ["FRM001", "FRM002", "ORD002–005", "ORD008"]);
    }
}
