//! One log of a fleet: what is asked of it, and how it ended.

use std::path::Path;

use polars::prelude::PolarsError;
use serde::{Deserialize, Serialize};

use super::child::is_of_memory;
use super::labels::Labels;
use super::store::{Row, Status, Store, StoreError, Tables, found};
use crate::boundary::caught;
use crate::finding::Severity;
use crate::report::{Report, Trouble, TroubleKind, Verdict};
use crate::{Audited, Options, audit};

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

/// Audits the log at `path` as `options` say, and puts its rows into `store`. A panic is caught, and
/// becomes its row. Returns also what kept it from being audited.
///
/// # Errors
/// Where its rows cannot be written.
pub fn settle(
    path: &Path,
    task: &Task,
    options: &Options,
    store: &Store,
) -> Result<(Answer, Option<String>), StoreError> {
    let mut options = Options { logs: vec![path.to_owned()], ..options.clone() };
    options.policy.fail_on = Some(Severity::Warning);
    let ((answer, tables), trouble) = match caught(|| audit(&options).map(Audited::into_report)) {
        Ok(Ok(report)) => (of_report(task, &report), report.error),
        Ok(Err(trouble)) => {
            let status = or_out_of_memory(Status::NotAudited, &trouble);
            (of_trouble(task, status, &trouble), Some(trouble))
        }
        Err(panic) => {
            let trouble = crashed(task, format!("the audit failed: {panic}"));
            let status = or_out_of_memory(Status::Crashed, &trouble);
            (of_trouble(task, status, &trouble), Some(trouble))
        }
    };
    let tables = tables.map_err(|source| StoreError::Content { path: path.to_owned(), source })?;
    store.commit(&task.key, tables)?;
    Ok((answer, trouble.map(|trouble| trouble.what)))
}

/// `status`, unless it was memory that was missing.
fn or_out_of_memory(status: Status, trouble: &Trouble) -> Status {
    if is_of_memory(&trouble.what) { Status::OutOfMemory } else { status }
}

fn of_report(task: &Task, report: &Report) -> (Answer, Result<Tables, PolarsError>) {
    let trouble = report.error.as_ref();
    let answer = Answer {
        status: if trouble.is_some() { Status::NotAudited } else { Status::Audited },
        verdict: trouble.is_none().then_some(report.verdict),
        errors: found(report, Severity::Error),
        warnings: found(report, Severity::Warning),
        infos: found(report, Severity::Info),
    };
    (answer, Tables::of(Row { task, answer: &answer }, report, trouble))
}

fn of_trouble(
    task: &Task,
    status: Status,
    trouble: &Trouble,
) -> (Answer, Result<Tables, PolarsError>) {
    let answer = Answer::without_report(status);
    (answer, Tables::of_trouble(Row { task, answer: &answer }, trouble))
}

/// Puts the row of a log into `store` on which there is no report.
///
/// # Errors
/// Where it cannot be written.
pub fn give_up(
    task: &Task,
    status: Status,
    trouble: &Trouble,
    store: &Store,
) -> Result<Answer, StoreError> {
    let (answer, tables) = of_trouble(task, status, trouble);
    let path = || store.path().to_owned();
    let tables = tables.map_err(|source| StoreError::Content { path: path(), source })?;
    store.commit(&task.key, tables)?;
    Ok(answer)
}

/// The trouble with a log that makes the program fail.
pub fn crashed(task: &Task, what: String) -> Trouble {
    Trouble {
        kind: TroubleKind::Log,
        what,
        place: task.path.clone(),
        remedy: "report this as a bug, with the log".to_owned(),
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
