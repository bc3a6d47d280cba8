use serde::{Deserialize, Serialize};

use super::labels::Labels;
use crate::finding::Severity;
use crate::report::Verdict;

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// Key of its rows.
    pub key: String,
    /// Path as stored in the tables.
    pub path: String,
    pub content: String,
    pub version: String,
    /// Hash.
    pub settings: String,
    pub bytes: u64,
    /// Latest modification, ns since 1970.
    pub mtime_ns: i64,
    pub labels: Labels,
}

/// Status of an audit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Audited.
    Audited,
    /// Readable, but not a log, without an arm, or without a robot model.
    NotAudited,
    /// Not readable. Every call tries again.
    Unreadable,
    /// Exceeded the time limit.
    TimedOut,
    /// Exceeded the memory limit.
    OutOfMemory,
    /// Process crashed.
    Crashed,
}

impl Status {
    /// All.
    pub const ALL: [Status; 6] = [
        Status::Audited,
        Status::NotAudited,
        Status::Unreadable,
        Status::TimedOut,
        Status::OutOfMemory,
        Status::Crashed,
    ];

    /// Name in tables.
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

    /// Status by name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|status| status.name() == name)
    }

    /// Whether a retry gives the same result.
    pub const fn is_final(self) -> bool {
        matches!(self, Status::Audited | Status::NotAudited)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditAnswer {
    pub status: Status,
    /// Warnings count as failures.
    pub verdict: Option<Verdict>,
    /// Errors.
    pub errors: u32,
    /// Warnings.
    pub warnings: u32,
    /// Infos.
    pub infos: u32,
}

impl AuditAnswer {
    pub const fn without_report(status: Status) -> Self {
        Self { status, verdict: None, errors: 0, warnings: 0, infos: 0 }
    }

    /// With findings of severity `fail_on` or above.
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
    fn the_caller_decides_which_severity_fails() {
        let answer = AuditAnswer { warnings: 1, ..AuditAnswer::without_report(Status::Audited) };
        let fails = |fail_on| answer.fails(fail_on);
        assert!(fails(Some(Severity::Warning)) && !fails(Some(Severity::Error)) && !fails(None));
    }
}
