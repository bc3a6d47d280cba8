//! Two reports side by side: what appeared, what went, what grew or shrank, and what can no longer
//! be told.
//!
//! A cause is the same in both where the rule and the subject are. Its amount has grown or shrunk
//! where the two 95 % intervals share no value and it changed by a tenth or more: intervals of sound
//! logs are narrower than one run differs from the next.

mod words;

use serde::Serialize;

use crate::finding::{CheckRow, Estimate, Finding, Severity, Status, Subject, Word};
use crate::report::{Report, Verdict};

pub use words::{markdown, text};

/// Amounts that differ by a smaller share are the same.
const MATERIAL: f64 = 0.1;

/// What became of a cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Course {
    /// The old report has no such finding.
    Appeared,
    /// It is more than it was, or graver.
    Grew,
    /// It is another amount or reading, neither more nor less: another sign, another convention.
    Changed,
    /// It is as it was, as far as the intervals tell.
    Same,
    /// It is less than it was.
    Shrank,
    /// There is no such finding any more, but the new log does not tell that nothing is wrong.
    Untold,
    /// It is gone: its check passes.
    Gone,
}

/// A cause in the old report, in the new one, or in both.
#[derive(Clone, Debug, Serialize)]
pub struct Change {
    /// What became of it.
    pub course: Course,
    /// Whether it fails the comparison.
    pub regression: bool,
    /// Code of the rule.
    pub code: Word,
    /// What is at fault.
    pub subject: Subject,
    /// The finding of the old report.
    pub old: Option<Finding>,
    /// That of the new one.
    pub new: Option<Finding>,
    /// Why nothing is told of it any more, where that is so.
    pub reason: Option<String>,
}

/// A check that passed, and of which the new log does not tell.
#[derive(Clone, Debug, Serialize)]
pub struct Lost {
    /// Code of the rule.
    pub code: Word,
    /// What it was asked about.
    pub subject: Subject,
    /// How it ended now: inconclusive, or skipped.
    pub status: Status,
    /// Why.
    pub reason: Option<String>,
}

/// Two reports side by side.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    schema: &'static str,
    /// Whether the new report is worse.
    pub regression: bool,
    /// The verdicts, old and new.
    pub verdicts: [Verdict; 2],
    /// What kept the new audit from saying more, where that is new.
    pub error: Option<String>,
    /// Every cause of either report; what fails the comparison stands first.
    pub causes: Vec<Change>,
    /// Checks that passed and now tell nothing.
    pub lost: Vec<Lost>,
}

/// Puts `old` and `new` side by side. What appeared, grew or became another thing is a regression
/// from the severity `fail_on`; so is a pass that became inconclusive, and a log that cannot be
/// audited any more. `None` lets nothing fail.
pub fn compare(old: &Report, new: &Report, fail_on: Option<Severity>) -> Comparison {
    let fails = |severity: Severity| fail_on.is_some_and(|least| severity >= least);
    let mut causes: Vec<Change> = Vec::new();
    for finding in causes_of(new) {
        let before = same_cause(old, new, finding);
        let course = before.map_or(Course::Appeared, |before| course(before, finding));
        let is_worse = matches!(course, Course::Appeared | Course::Grew | Course::Changed);
        causes.push(Change {
            course,
            regression: is_worse && fails(finding.severity),
            code: finding.code,
            subject: finding.subject.clone(),
            old: before.cloned(),
            new: Some(finding.clone()),
            reason: None,
        });
    }
    for finding in causes_of(old).filter(|finding| same_cause(new, old, finding).is_none()) {
        // Some rules pass on the whole log and fault a part of it.
        let row = check(new, finding.code, &whom(old, &finding.subject))
            .or_else(|| check(new, finding.code, &Subject::default()));
        let (course, reason) = match row {
            Some(row) if row.status == Status::Pass => (Course::Gone, None),
            Some(row) => (Course::Untold, row.reason.clone()),
            None => (Course::Untold, Some("the rule was not asked about it".to_owned())),
        };
        causes.push(Change {
            course,
            regression: false,
            code: finding.code,
            subject: finding.subject.clone(),
            old: Some(finding.clone()),
            new: None,
            reason,
        });
    }
    causes.sort_by_key(|change| (!change.regression, change.course));
    let error = new.error.as_ref().filter(|_| old.error.is_none());
    let verdicts = [old.verdict, new.verdict];
    let is_open = verdicts == [Verdict::Pass, Verdict::Inconclusive];
    let is_worse = fail_on.is_some() && (is_open || error.is_some());
    Comparison {
        schema: "poseaudit.comparison/1",
        regression: is_worse || causes.iter().any(|change| change.regression),
        verdicts,
        error: error.map(|trouble| trouble.what.clone()),
        lost: lost(old, new),
        causes,
    }
}

/// The findings, of a cause that was found several times (in segments of a run) the gravest.
fn causes_of(report: &Report) -> impl Iterator<Item = &Finding> {
    report.findings.iter().enumerate().filter_map(|(index, finding)| {
        let is_same =
            |other: &Finding| other.code == finding.code && other.subject == finding.subject;
        (!report.findings[..index].iter().any(is_same)).then_some(finding)
    })
}

/// The finding in `report` that names the same cause as `finding`, which is one of `its`.
fn same_cause<'a>(report: &'a Report, its: &Report, finding: &Finding) -> Option<&'a Finding> {
    let subject = whom(its, &finding.subject);
    let is_same =
        |other: &&Finding| other.code == finding.code && whom(report, &other.subject) == subject;
    report.findings.iter().find(is_same)
}

/// Whom a check or a finding of `report` is about, whatever the file is called that it was seen in.
fn whom(report: &Report, subject: &Subject) -> Subject {
    let is_file =
        |name: &String| report.log.files.iter().any(|file| file.path.to_str() == Some(name));
    let topic = subject.topic.clone();
    Subject { topic: topic.filter(|topic| !is_file(topic)), ..subject.clone() }
}

/// How asking a rule about a subject ended, if it was asked.
fn check<'a>(report: &'a Report, code: &str, subject: &Subject) -> Option<&'a CheckRow> {
    let mut rows = report.checks.iter();
    rows.find(|row| row.code == code && &whom(report, &row.subject) == subject)
}

fn lost(old: &Report, new: &Report) -> Vec<Lost> {
    let passed = old.checks.iter().filter(|row| row.status == Status::Pass);
    let lost = passed.filter_map(|row| {
        let now = check(new, row.code, &whom(old, &row.subject))?;
        (!now.status.is_decided()).then(|| Lost {
            code: row.code,
            subject: row.subject.clone(),
            status: now.status,
            reason: now.reason.clone(),
        })
    });
    lost.collect()
}

fn course(old: &Finding, new: &Finding) -> Course {
    if new.severity > old.severity {
        return Course::Grew;
    }
    let amounts = match (&old.estimate, &new.estimate) {
        (Some(old), Some(new)) => between(old, new),
        _ => Course::Same,
    };
    match amounts {
        Course::Same if new.severity < old.severity => Course::Shrank,
        course => course,
    }
}

fn between(old: &Estimate, new: &Estimate) -> Course {
    use Estimate::{Amount, Convention, Frame, Order, Slip};
    let name = |estimate: &Estimate| match estimate {
        Amount { name, .. } | Frame { name, .. } | Convention { name, .. } => *name,
        Slip { name, .. } | Order { name, .. } => *name,
    };
    if name(old) != name(new) {
        return Course::Changed;
    }
    let course = |is_same| if is_same { Course::Same } else { Course::Changed };
    match (old, new) {
        (
            Amount { unit, value, ci95, .. },
            Amount { unit: now, value: new, ci95: new_ci95, .. },
        ) if unit == now => amount(*value, *ci95, *new, *new_ci95),
        (
            Frame { value, ci95, rotation, .. },
            Frame { value: new, ci95: new_ci95, rotation: turned, .. },
        ) => {
            let length = amount(*value, *ci95, *new, *new_ci95);
            let angle = amount(rotation.value, rotation.ci95, turned.value, turned.ci95);
            // Worse in one way is worse.
            match length.min(angle) {
                Course::Same => length.max(angle),
                course => course,
            }
        }
        (Convention { is, read_as, .. }, Convention { is: now, read_as: new, .. }) => {
            course((is, read_as) == (now, new))
        }
        (Slip { is, read_as, .. }, Slip { is: now, read_as: new, .. }) => {
            course((is, read_as) == (now, new))
        }
        (Order { is, read_as, .. }, Order { is: now, read_as: new, .. }) => {
            course((is, read_as) == (now, new))
        }
        _ => Course::Changed,
    }
}

/// What became of a number.
fn amount(old: f64, old_ci95: Option<[f64; 2]>, new: f64, new_ci95: Option<[f64; 2]>) -> Course {
    let half = |value: f64, ci95: Option<[f64; 2]>| {
        ci95.map_or(0.0, |[low, high]| (high - value).max(value - low))
    };
    let halves = half(old, old_ci95) + half(new, new_ci95);
    let is_material = |change: f64| change > halves && change >= MATERIAL * old.abs();
    match new.abs() - old.abs() {
        change if is_material(change) => Course::Grew,
        change if is_material(-change) => Course::Shrank,
        _ if old * new < 0.0 && is_material((new - old).abs()) => Course::Changed,
        _ => Course::Same,
    }
}
