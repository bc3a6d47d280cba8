use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use polars::prelude::PolarsError;

use super::store::{LogRows, RunRow, Status, Store, StoreError, Tables, count_findings};
use super::task::{AuditAnswer, Task};
use crate::boundary::catch_panic;
use crate::finding::Severity;
use crate::report::{Report, Trouble, html, write_whole};
use crate::{Audited, Options, audit};

/// Audits one log. Returns its rows, and why it could not be audited, if it was not. Panics are stored in the row.
/// If `with_page`, the report is also saved as a page.
///
/// # Errors
/// If the page cannot be written.
pub fn audit_log(
    task: &Task,
    options: &Options,
    store: &Store,
    with_page: bool,
) -> Result<(LogRows, Option<Trouble>), StoreError> {
    let mut options = options.clone();
    options.policy.fail_on = Some(Severity::Warning);
    let with_figures = |it: Audited| if with_page { it.with_figures() } else { it };
    let audited =
        catch_panic(|| audit(&options).map(|audited| with_figures(audited).into_report()));
    let ((answer, tables), trouble) = match audited {
        Ok(Ok(report)) => {
            if with_page {
                write_page(&store.page_path(&task.key), &report)?;
            }
            (rows_from_report(task, &report), report.error)
        }
        Ok(Err(trouble)) => {
            let status = refine_status(Status::NotAudited, &trouble);
            (rows_from_trouble(task, status, &trouble), Some(trouble))
        }
        Err(panic) => {
            let trouble = crash_trouble(task, format!("the audit failed: {panic}"));
            let status = refine_status(Status::Crashed, &trouble);
            (rows_from_trouble(task, status, &trouble), Some(trouble))
        }
    };
    Ok((log_rows(task, answer, tables, store)?, trouble))
}

fn write_page(path: &Path, report: &Report) -> Result<(), StoreError> {
    let write = |staged: &Path| html::write(report, &mut BufWriter::new(File::create(staged)?));
    write_whole(path, write).map_err(|source| StoreError::File { path: path.to_owned(), source })
}

fn refine_status(status: Status, trouble: &Trouble) -> Status {
    if is_allocation_failure(&trouble.what) { Status::OutOfMemory } else { status }
}

fn rows_from_report(task: &Task, report: &Report) -> (AuditAnswer, Result<Tables, PolarsError>) {
    let is_complete = report.error.is_none();
    let answer = AuditAnswer {
        status: if is_complete { Status::Audited } else { Status::NotAudited },
        verdict: is_complete.then_some(report.verdict),
        errors: count_findings(report, Severity::Error),
        warnings: count_findings(report, Severity::Warning),
        infos: count_findings(report, Severity::Info),
    };
    (answer, Tables::from_report(RunRow { task, answer: &answer }, report))
}

fn rows_from_trouble(
    task: &Task,
    status: Status,
    trouble: &Trouble,
) -> (AuditAnswer, Result<Tables, PolarsError>) {
    let answer = AuditAnswer::without_report(status);
    (answer, Tables::from_trouble(RunRow { task, answer: &answer }, trouble))
}

/// Stores the row of a log without a report.
pub fn store_failure(
    task: &Task,
    status: Status,
    trouble: &Trouble,
    store: &Store,
) -> Result<AuditAnswer, StoreError> {
    let (answer, tables) = rows_from_trouble(task, status, trouble);
    store.commit(vec![log_rows(task, answer, tables, store)?])?;
    Ok(answer)
}

fn log_rows(
    task: &Task,
    answer: AuditAnswer,
    tables: Result<Tables, PolarsError>,
    store: &Store,
) -> Result<LogRows, StoreError> {
    let fault = |source| StoreError::Content { path: store.path().to_owned(), source };
    Ok(LogRows { key: task.key.clone(), answer, tables: tables.map_err(fault)? })
}

pub fn crash_trouble(task: &Task, what: String) -> Trouble {
    Trouble::log(&task.path, what, "report this as a bug and attach the log")
}

/// Whether a message indicates a failed memory allocation.
pub(super) fn is_allocation_failure(message: &str) -> bool {
    // Messages of the allocator, the operating system, and SQLite.
    ["memory allocation of", "Cannot allocate memory", "out of memory"]
        .iter()
        .any(|part| message.contains(part))
}
