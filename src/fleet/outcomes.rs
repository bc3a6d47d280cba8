use std::cmp::Reverse;
use std::collections::BTreeMap;

use serde::Serialize;

use super::store::Status;
use super::task::AuditAnswer;
use crate::finding::Severity;
use crate::report::Verdict;

/// Summary of a call.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcomes {
    /// Given logs.
    pub logs: usize,
    /// Copies of other logs, which share their row.
    pub duplicates: usize,
    /// Done by an earlier call.
    pub done_before: usize,
    /// Done by this call.
    pub done_now: usize,
    /// Counts per status, each content once.
    pub statuses: Statuses,
    /// Counts per verdict; warnings count as failures.
    pub verdicts: Verdicts,
    /// Logs not audited by this call, by path.
    pub errors: Vec<Failure>,
    #[serde(skip)]
    answers: Vec<AuditAnswer>,
}

/// Logs by status: see [`Status`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Statuses {
    /// Audited.
    pub audited: usize,
    /// Readable but not audited.
    pub not_audited: usize,
    /// Not readable.
    pub unreadable: usize,
    /// Exceeded the time limit.
    pub timed_out: usize,
    /// Exceeded the memory limit.
    pub out_of_memory: usize,
    /// Process crashed.
    pub crashed: usize,
}

/// Logs by verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Verdicts {
    /// No problem found.
    pub pass: usize,
    /// A warning or an error.
    pub fail: usize,
    /// A main question could not be answered.
    pub inconclusive: usize,
}

/// Log that could not be audited.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Failure {
    /// Log.
    pub path: String,
    /// Status.
    pub status: Status,
    /// Reason.
    pub what: String,
    /// Suggested action.
    #[serde(rename = "do")]
    pub remedy: String,
}

/// Logs that could not be audited for one reason.
#[derive(Debug)]
pub struct FailureGroup<'a> {
    /// Reason.
    pub what: &'a str,
    /// Suggested action.
    pub remedy: &'a str,
    /// Logs, by path.
    pub logs: Vec<&'a Failure>,
}

impl<'a> FailureGroup<'a> {
    /// Groups failures by reason, the most frequent first.
    pub fn group(failures: &'a [Failure]) -> Vec<Self> {
        let mut by_reason: BTreeMap<(&str, &str), Vec<&Failure>> = BTreeMap::new();
        for failure in failures {
            by_reason.entry((&failure.what, &failure.remedy)).or_default().push(failure);
        }
        let groups = by_reason.into_iter();
        let mut groups: Vec<Self> =
            groups.map(|((what, remedy), logs)| Self { what, remedy, logs }).collect();
        groups.sort_by_key(|group| Reverse(group.logs.len()));
        groups
    }

    /// Reason, first logs, and action.
    pub fn lines(&self) -> [String; 3] {
        /// The table `errors` has all.
        const MAX_PATHS: usize = 3;
        let count = self.logs.len();
        let paths = self.logs.iter().take(MAX_PATHS).map(|failure| failure.path.as_str());
        let mut paths = paths.collect::<Vec<_>>().join(", ");
        if count > MAX_PATHS {
            paths += &format!(" and {} more", count - MAX_PATHS);
        }
        let logs = if count == 1 { "log" } else { "logs" };
        [format!("{count} {logs}: {}", self.what), paths, format!("do: {}", self.remedy)]
    }
}

impl Outcomes {
    /// Logs with a finding of severity `fail_on` or above, or, if `fails_open`, an inconclusive verdict.
    pub fn count_failing(&self, fail_on: Option<Severity>, fails_open: bool) -> usize {
        let is_open =
            |answer: &AuditAnswer| fails_open && answer.verdict == Some(Verdict::Inconclusive);
        self.answers.iter().filter(|answer| answer.fails(fail_on) || is_open(answer)).count()
    }

    /// Logs without an audit.
    pub fn count_unaudited(&self) -> usize {
        self.answers.iter().filter(|answer| answer.status != Status::Audited).count()
    }

    pub(super) fn add(&mut self, answer: AuditAnswer) {
        self.statuses.add(answer.status);
        self.verdicts.add(answer.verdict);
        self.answers.push(answer);
    }
}

impl Statuses {
    pub(super) fn add(&mut self, status: Status) {
        *match status {
            Status::Audited => &mut self.audited,
            Status::NotAudited => &mut self.not_audited,
            Status::Unreadable => &mut self.unreadable,
            Status::TimedOut => &mut self.timed_out,
            Status::OutOfMemory => &mut self.out_of_memory,
            Status::Crashed => &mut self.crashed,
        } += 1;
    }
}

impl Verdicts {
    pub(super) fn add(&mut self, verdict: Option<Verdict>) {
        match verdict {
            Some(Verdict::Pass) => self.pass += 1,
            Some(Verdict::Fail) => self.fail += 1,
            Some(Verdict::Inconclusive) => self.inconclusive += 1,
            None => {}
        }
    }
}
