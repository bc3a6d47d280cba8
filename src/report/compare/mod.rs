//! Compares two reports.
//!
//! Causes are matched by rule and subject. An amount has changed if the two 95 % intervals do not overlap
//! and it differs by a tenth or more: good logs' intervals are narrower than the differences between runs.

mod format;

use serde::Serialize;

use crate::finding::{Amount, CheckRow, Estimate, Finding, Severity, Status, Subject, Word};
use crate::report::{Report, Verdict};

pub use format::{markdown, text};

/// Minimum relative change of an amount.
const MIN_RELATIVE_CHANGE: f64 = 0.1;

/// Change of a cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChangeKind {
    /// Not in the old report.
    Appeared,
    /// Larger or more severe.
    Grew,
    /// Neither larger nor smaller, such as another sign.
    Changed,
    /// Unchanged within the intervals.
    Same,
    /// Smaller.
    Shrank,
    /// No longer found, but not decided either.
    #[serde(rename = "untold")]
    Undetermined,
    /// The check passes.
    Gone,
}

/// Cause in either report.
#[derive(Clone, Debug, Serialize)]
pub struct Change {
    /// Kind of change.
    #[serde(rename = "course")]
    pub kind: ChangeKind,
    /// It fails the comparison.
    pub regression: bool,
    /// Rule.
    pub code: Word,
    /// Subject.
    pub subject: Subject,
    /// Old finding.
    pub old: Option<Finding>,
    /// New finding.
    pub new: Option<Finding>,
    /// Why it is no longer decided.
    pub reason: Option<String>,
}

/// Check that passed before and is now undecided.
#[derive(Clone, Debug, Serialize)]
pub struct LostCheck {
    /// Rule.
    pub code: Word,
    /// Subject.
    pub subject: Subject,
    /// Inconclusive or skipped.
    pub status: Status,
    /// Reason for the status.
    pub reason: Option<String>,
}

/// Comparison of two reports.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    schema: &'static str,
    /// The new report is worse.
    pub regression: bool,
    /// Old and new.
    pub verdicts: [Verdict; 2],
    /// Limited the new audit and not the old one.
    pub error: Option<String>,
    /// Regressions first.
    pub causes: Vec<Change>,
    /// No longer decided.
    pub lost: Vec<LostCheck>,
}

/// Compares two reports. Regressions are new, larger or different findings of severity `fail_on` or above,
/// a pass that became inconclusive, and a log that can no longer be audited. With `None`, nothing is.
pub fn compare(old: &Report, new: &Report, fail_on: Option<Severity>) -> Comparison {
    let fails = |severity: Severity| fail_on.is_some_and(|least| severity >= least);
    let mut causes: Vec<Change> = Vec::new();
    for finding in causes_of(new) {
        let before = find_same_cause(old, new, finding);
        let kind = before.map_or(ChangeKind::Appeared, |before| classify_change(before, finding));
        let is_worse =
            matches!(kind, ChangeKind::Appeared | ChangeKind::Grew | ChangeKind::Changed);
        causes.push(Change {
            kind,
            regression: is_worse && fails(finding.severity),
            code: finding.code,
            subject: finding.subject.clone(),
            old: before.cloned(),
            new: Some(finding.clone()),
            reason: None,
        });
    }
    for finding in causes_of(old).filter(|finding| find_same_cause(new, old, finding).is_none()) {
        // Some rules pass on the whole log and fail on a part.
        let row = find_check(new, finding.code, &comparable_subject(old, &finding.subject))
            .or_else(|| find_check(new, finding.code, &Subject::default()));
        let (kind, reason) = match row {
            Some(row) if row.status == Status::Pass => (ChangeKind::Gone, None),
            Some(row) => (ChangeKind::Undetermined, row.reason.clone()),
            None => (ChangeKind::Undetermined, Some("the rule was not evaluated on it".to_owned())),
        };
        causes.push(Change {
            kind,
            regression: false,
            code: finding.code,
            subject: finding.subject.clone(),
            old: Some(finding.clone()),
            new: None,
            reason,
        });
    }
    causes.sort_by_key(|change| (!change.regression, change.kind));
    let error = new.error.as_ref().filter(|_| old.error.is_none());
    let verdicts = [old.verdict, new.verdict];
    let is_open = verdicts == [Verdict::Pass, Verdict::Inconclusive];
    let is_worse = fail_on.is_some() && (is_open || error.is_some());
    Comparison {
        schema: "poseaudit.comparison/1",
        regression: is_worse || causes.iter().any(|change| change.regression),
        verdicts,
        error: error.map(|trouble| trouble.what.clone()),
        lost: lost_checks(old, new),
        causes,
    }
}

/// If a cause occurs in several segments, only the most severe finding.
fn causes_of(report: &Report) -> impl Iterator<Item = &Finding> {
    report.findings.iter().enumerate().filter_map(|(index, finding)| {
        let is_same =
            |other: &Finding| other.code == finding.code && other.subject == finding.subject;
        (!report.findings[..index].iter().any(is_same)).then_some(finding)
    })
}

fn find_same_cause<'a>(report: &'a Report, its: &Report, finding: &Finding) -> Option<&'a Finding> {
    let subject = comparable_subject(its, &finding.subject);
    let is_same = |other: &&Finding| {
        other.code == finding.code && comparable_subject(report, &other.subject) == subject
    };
    report.findings.iter().find(is_same)
}

/// Subject without the log's file name.
fn comparable_subject(report: &Report, subject: &Subject) -> Subject {
    let is_file =
        |name: &String| report.log.files.iter().any(|file| file.path.to_str() == Some(name));
    let topic = subject.topic.clone();
    Subject { topic: topic.filter(|topic| !is_file(topic)), ..subject.clone() }
}

fn find_check<'a>(report: &'a Report, code: &str, subject: &Subject) -> Option<&'a CheckRow> {
    let mut rows = report.checks.iter();
    rows.find(|row| row.code == code && &comparable_subject(report, &row.subject) == subject)
}

fn lost_checks(old: &Report, new: &Report) -> Vec<LostCheck> {
    let passed = old.checks.iter().filter(|row| row.status == Status::Pass);
    let lost = passed.filter_map(|row| {
        let now = find_check(new, row.code, &comparable_subject(old, &row.subject))?;
        (!now.status.is_decided()).then(|| LostCheck {
            code: row.code,
            subject: row.subject.clone(),
            status: now.status,
            reason: now.reason.clone(),
        })
    });
    lost.collect()
}

fn classify_change(old: &Finding, new: &Finding) -> ChangeKind {
    if new.severity > old.severity {
        return ChangeKind::Grew;
    }
    let amounts = match (&old.estimate, &new.estimate) {
        (Some(old), Some(new)) => compare_estimates(old, new),
        _ => ChangeKind::Same,
    };
    match amounts {
        ChangeKind::Same if new.severity < old.severity => ChangeKind::Shrank,
        kind => kind,
    }
}

fn compare_estimates(old: &Estimate, new: &Estimate) -> ChangeKind {
    let (before, now) = (old.amounts(), new.amounts());
    let units = |amounts: &[Amount]| -> Vec<Word> { amounts.iter().map(|it| it.symbol).collect() };
    if old.name() != new.name()
        || units(&before) != units(&now)
        || old.interpretation() != new.interpretation()
    {
        return ChangeKind::Changed;
    }
    let kinds = before.iter().zip(&now).map(|(before, now)| compare_amounts(before, now));
    let kinds: Vec<ChangeKind> = kinds.collect();
    // Worse in one component is worse overall.
    let of_least = kinds.iter().min().filter(|kind| **kind != ChangeKind::Same);
    *of_least.or(kinds.iter().max()).unwrap_or(&ChangeKind::Same)
}

fn compare_amounts(old: &Amount, new: &Amount) -> ChangeKind {
    let half = |Amount { value, ci95, .. }: &Amount| {
        ci95.map_or(0.0, |[low, high]| (high - value).max(value - low))
    };
    let halves = half(old) + half(new);
    let (old, new) = (old.value, new.value);
    let is_material = |change: f64| change > halves && change >= MIN_RELATIVE_CHANGE * old.abs();
    match new.abs() - old.abs() {
        change if is_material(change) => ChangeKind::Grew,
        change if is_material(-change) => ChangeKind::Shrank,
        _ if old * new < 0.0 && is_material((new - old).abs()) => ChangeKind::Changed,
        _ => ChangeKind::Same,
    }
}
