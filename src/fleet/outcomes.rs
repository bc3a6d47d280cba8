//! How a call over many logs ended.

use serde::Serialize;

use super::store::Status;
use super::task::Answer;
use crate::finding::Severity;
use crate::report::Verdict;

/// How a call ended.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcomes {
    /// Logs that were named.
    pub logs: usize,
    /// Logs that have the content of another of them, whose row is theirs.
    pub duplicates: usize,
    /// Logs that an earlier call had done.
    pub done_before: usize,
    /// Logs that this call did.
    pub done_now: usize,
    /// How the audits ended, of all that were named, each content once.
    pub statuses: Statuses,
    /// What the reports say, where warnings fail a run.
    pub verdicts: Verdicts,
    /// Logs that this call could not audit, by their paths.
    pub errors: Vec<Failure>,
    /// Each answer, for what is yet to be asked.
    #[serde(skip)]
    answers: Vec<Answer>,
}

/// Logs by the status of their audit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Statuses {
    /// See [`Status`], here and below.
    pub audited: usize,
    /// It could be read, and not audited.
    pub not_audited: usize,
    /// It could not be read.
    pub unreadable: usize,
    /// It took too long.
    pub timed_out: usize,
    /// It took too much memory.
    pub out_of_memory: usize,
    /// The audit of it died.
    pub crashed: usize,
}

/// Logs by their verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Verdicts {
    /// Nothing wrong.
    pub pass: usize,
    /// A warning or an error.
    pub fail: usize,
    /// A main question stayed open.
    pub inconclusive: usize,
}

/// A log that could not be audited.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Failure {
    /// Its path.
    pub path: String,
    /// How its audit ended.
    pub status: Status,
    /// Why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub what: Option<String>,
}

impl Outcomes {
    /// Logs with a finding of severity `fail_on` or above; where `fails_open`, those whose verdict is
    /// inconclusive, too.
    pub fn failing(&self, fail_on: Option<Severity>, fails_open: bool) -> usize {
        let is_open = |answer: &Answer| fails_open && answer.verdict == Some(Verdict::Inconclusive);
        self.answers.iter().filter(|answer| answer.fails(fail_on) || is_open(answer)).count()
    }

    /// Logs on which there is no audit.
    pub fn unaudited(&self) -> usize {
        self.answers.iter().filter(|answer| answer.status != Status::Audited).count()
    }

    /// Counts one more.
    pub(super) fn count(&mut self, answer: Answer) {
        self.statuses.count(answer.status);
        self.verdicts.count(answer.verdict);
        self.answers.push(answer);
    }
}

impl Statuses {
    /// Counts one more.
    pub(super) fn count(&mut self, status: Status) {
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
    /// Counts one more.
    pub(super) fn count(&mut self, verdict: Option<Verdict>) {
        match verdict {
            Some(Verdict::Pass) => self.pass += 1,
            Some(Verdict::Fail) => self.fail += 1,
            Some(Verdict::Inconclusive) => self.inconclusive += 1,
            None => {}
        }
    }
}
