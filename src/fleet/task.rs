//! One log of a fleet: what is asked of it, and how it ended.

use serde::{Deserialize, Serialize};

use super::labels::Labels;
use crate::finding::Severity;
use crate::report::Verdict;

/// A log to audit, and under which key its rows are kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// The key of its rows.
    pub key: String,
    /// Its path, as the tables name it.
    pub path: String,
    /// The name of its content.
    pub content: String,
    /// Version of the program.
    pub version: String,
    /// Hash of the settings.
    pub settings: String,
    /// Size of its files.
    pub bytes: u64,
    /// When one of them was last changed, ns since 1970.
    pub mtime_ns: i64,
    /// Which site, arm or anything else it is of.
    pub labels: Labels,
}

/// How the audit of a log ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// It was audited.
    Audited,
    /// It was read, and could not be audited: it is no log, has no arm in it, or no model is known.
    NotAudited,
    /// It could not be read. Every call tries again.
    Unreadable,
    /// It took longer than a log may.
    TimedOut,
    /// It needed more memory than a log may.
    OutOfMemory,
    /// The audit of it died.
    Crashed,
}

impl Status {
    /// All of them.
    pub const ALL: [Status; 6] = [
        Status::Audited,
        Status::NotAudited,
        Status::Unreadable,
        Status::TimedOut,
        Status::OutOfMemory,
        Status::Crashed,
    ];

    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Status::Audited => "audited",
            Status::NotAudited => "not_audited",
            Status::Unreadable => "unreadable",
            Status::TimedOut => "timed_out",
            Status::OutOfMemory => "out_of_memory",
            Status::Crashed => "crashed",
        }
    }

    /// The status of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|status| status.name() == name)
    }

    /// Whether to try again leads to the same.
    pub const fn is_final(self) -> bool {
        matches!(self, Status::Audited | Status::NotAudited)
    }
}

/// How the audit of a log ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// Whether it was audited.
    pub status: Status,
    /// What the report says where warnings fail a run.
    pub verdict: Option<Verdict>,
    /// Findings that are errors, …
    pub errors: u32,
    /// … warnings …
    pub warnings: u32,
    /// … and worth knowing.
    pub infos: u32,
}

impl Answer {
    /// The answer where there is no report.
    pub const fn without_report(status: Status) -> Self {
        Self { status, verdict: None, errors: 0, warnings: 0, infos: 0 }
    }

    /// Whether findings of severity `fail_on` or above were found.
    pub fn fails(&self, fail_on: Option<Severity>) -> bool {
        match fail_on {
            None => false,
            Some(Severity::Error) => self.errors > 0,
            Some(Severity::Warning) => self.errors + self.warnings > 0,
            Some(Severity::Info) => self.errors + self.warnings + self.infos > 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_is_what_the_caller_says() {
        let answer = Answer { warnings: 1, ..Answer::without_report(Status::Audited) };
        let fails = |fail_on| answer.fails(fail_on);
        assert!(fails(Some(Severity::Warning)) && !fails(Some(Severity::Error)) && !fails(None));
    }
}
