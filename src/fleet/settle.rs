use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use polars::prelude::PolarsError;

use super::store::{LogRows, Row, Status, Store, StoreError, Tables, found};
use super::task::{Answer, Task};
use crate::boundary::catch_panic;
use crate::finding::Severity;
use crate::report::{Report, Trouble, TroubleKind, html, write_whole};
use crate::{Audited, Options, audit};

/// Audits one log. Returns its rows, and why it could not be audited, if so. Panics are stored in the row.
/// If `paged`, the report is also saved as a page.
///
/// # Errors
/// If the page cannot be written.
pub fn settle(
    task: &Task,
    options: &Options,
    store: &Store,
    paged: bool,
) -> Result<(LogRows, Option<String>), StoreError> {
    let mut options = options.clone();
    options.policy.fail_on = Some(Severity::Warning);
    let pictured = |it: Audited| if paged { it.with_figures() } else { it };
    let audited = catch_panic(|| audit(&options).map(|audited| pictured(audited).into_report()));
    let ((answer, tables), trouble) = match audited {
        Ok(Ok(report)) => {
            if paged {
                write_page(&store.page(&task.key), &report)?;
            }
            (of_report(task, &report), report.error)
        }
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
    Ok((rows(task, answer, tables, store)?, trouble.map(|trouble| trouble.what)))
}

fn write_page(path: &Path, report: &Report) -> Result<(), StoreError> {
    let write = |staged: &Path| html::write(report, &mut BufWriter::new(File::create(staged)?));
    write_whole(path, write).map_err(|source| StoreError::File { path: path.to_owned(), source })
}

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

/// Stores the row of a log without a report.
pub fn give_up(
    task: &Task,
    status: Status,
    trouble: &Trouble,
    store: &Store,
) -> Result<Answer, StoreError> {
    let (answer, tables) = of_trouble(task, status, trouble);
    store.commit(vec![rows(task, answer, tables, store)?])?;
    Ok(answer)
}

fn rows(
    task: &Task,
    answer: Answer,
    tables: Result<Tables, PolarsError>,
    store: &Store,
) -> Result<LogRows, StoreError> {
    let fault = |source| StoreError::Content { path: store.path().to_owned(), source };
    Ok(LogRows { key: task.key.clone(), answer, tables: tables.map_err(fault)? })
}

pub fn crashed(task: &Task, what: String) -> Trouble {
    Trouble {
        kind: TroubleKind::Log,
        what,
        place: task.path.clone(),
        remedy: "report this as a bug and attach the log".to_owned(),
    }
}

/// Whether a message indicates a failed memory allocation.
pub(super) fn is_of_memory(words: &str) -> bool {
    // Messages of the allocator, the operating system, and SQLite.
    ["memory allocation of", "Cannot allocate memory", "out of memory"]
        .iter()
        .any(|part| words.contains(part))
}
