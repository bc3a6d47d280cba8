//! Summary of a call over many logs.

use serde::Serialize;

use super::store::Status;
use super::task::Answer;
use crate::finding::Severity;
use crate::report::Verdict;

/// Summary of a call.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcomes {
    /// Logs given by the caller.
    pub logs: usize,
    /// Logs with the same content as another log; they share its row.
    pub duplicates: usize,
    /// Logs done by an earlier call.
    pub done_before: usize,
    /// Logs done by this call.
    pub done_now: usize,
    /// Audits by status, each content once.
    pub statuses: Statuses,
    /// Reports by verdict, with warnings counted as failures.
    pub verdicts: Verdicts,
    /// Logs that this call could not audit, sorted by path.
    pub errors: Vec<Failure>,
    /// All answers, for later queries.
    #[serde(skip)]
    answers: Vec<Answer>,
}

/// Number of logs by audit status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Statuses {
    /// See [`Status`] for this and the other fields.
    pub audited: usize,
    /// Readable but not audited.
    pub not_audited: usize,
    /// Not readable.
    pub unreadable: usize,
    /// Exceeded the time limit.
    pub timed_out: usize,
    /// Exceeded the memory limit.
    pub out_of_memory: usize,
    /// The audit process crashed.
    pub crashed: usize,
}

/// Number of logs by verdict.
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
    /// Path of the log.
    pub path: String,
    /// Status of the audit.
    pub status: Status,
    /// Reason.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub what: Option<String>,
}

impl Outcomes {
    /// Number of logs with a finding of severity `fail_on` or above, or, if `fails_open`, with an
    /// inconclusive verdict.
    pub fn failing(&self, fail_on: Option<Severity>, fails_open: bool) -> usize {
        let is_open = |answer: &Answer| fails_open && answer.verdict == Some(Verdict::Inconclusive);
        self.answers.iter().filter(|answer| answer.fails(fail_on) || is_open(answer)).count()
    }

    /// Number of logs without an audit.
    pub fn unaudited(&self) -> usize {
        self.answers.iter().filter(|answer| answer.status != Status::Audited).count()
    }

    pub(super) fn count(&mut self, answer: Answer) {
        self.statuses.count(answer.status);
        self.verdicts.count(answer.verdict);
        self.answers.push(answer);
    }
}

impl Statuses {
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
    pub(super) fn count(&mut self, verdict: Option<Verdict>) {
        match verdict {
            Some(Verdict::Pass) => self.pass += 1,
            Some(Verdict::Fail) => self.fail += 1,
            Some(Verdict::Inconclusive) => self.inconclusive += 1,
            None => {}
        }
    }
}
