//! Rows of one log as data frames. `docs/fleet.md` lists the columns.

use polars::prelude::{Column, DataFrame, NamedFrom, PolarsError, PolarsResult, Series};
use serde::Serialize;

use super::{Status, TABLES, Table};
use crate::finding::{Finding, Severity, Status as Decided};
use crate::fleet::task::{AuditAnswer, Task};
use crate::output::tables::{checks_frame, findings_frame};
use crate::report::{Report, StreamRow, Trouble, Verdict};
use crate::time::Stamp;

/// Columns of `runs` for an [`AuditAnswer`], with the key.
pub const ANSWER_COLUMNS: &[&str] = &["key", "status", "verdict", "errors", "warnings", "infos"];

#[derive(Debug)]
pub struct Tables {
    frames: Vec<(Table, DataFrame)>,
}

#[derive(Debug)]
pub struct LogRows {
    pub key: String,
    pub answer: AuditAnswer,
    pub tables: Tables,
}

/// Row of `runs`, without the report.
#[derive(Clone, Copy, Debug)]
pub struct RunRow<'a> {
    pub task: &'a Task,
    pub answer: &'a AuditAnswer,
}

impl Tables {
    /// # Errors
    /// Does not fail for valid reports.
    pub fn from_report(row: RunRow<'_>, report: &Report) -> PolarsResult<Self> {
        let key = row.task.key.as_str();
        let ignored = report.ignored.iter().map(|ignored| &ignored.finding);
        let findings: Vec<Finding> = report.findings.iter().chain(ignored).cloned().collect();
        let mut found = findings_frame(&findings)?;
        let counted = report.findings.iter().map(|_| None);
        let reasons = report.ignored.iter().map(|ignored| Some(ignored.reason.as_str()));
        found.with_column(text_column("ignored_because", counted.chain(reasons)))?;
        let frames = TABLES.into_iter().map(|table| {
            let frame = match table {
                Table::Streams => with_row_numbers(key, streams_frame(&report.streams)?)?,
                Table::Checks => with_row_numbers(key, checks_frame(&report.checks)?)?,
                Table::Findings => with_row_numbers(key, found.clone())?,
                Table::Errors => errors_frame(row, report.error.as_ref())?,
                Table::Runs | Table::Sources => runs_frame(row, Some(report))?,
            };
            Ok((table, frame))
        });
        Ok(Self { frames: frames.collect::<PolarsResult<_>>()? })
    }

    /// # Errors
    /// Does not fail for valid input.
    pub fn from_trouble(row: RunRow<'_>, trouble: &Trouble) -> PolarsResult<Self> {
        let frames = TABLES.into_iter().map(|table| {
            let frame = match table {
                Table::Errors => errors_frame(row, Some(trouble))?,
                Table::Runs => runs_frame(row, None)?,
                _ => DataFrame::empty(),
            };
            Ok((table, frame))
        });
        Ok(Self { frames: frames.collect::<PolarsResult<_>>()? })
    }

    pub(super) fn into_frames(self) -> Vec<(Table, DataFrame)> {
        self.frames
    }
}

/// Answers with their keys. Unknown statuses are not final.
pub fn read_answers(frame: &DataFrame) -> PolarsResult<Vec<(String, AuditAnswer)>> {
    let text = |name: &str| Ok::<_, PolarsError>(frame.column(name)?.str()?.iter());
    let count = |name: &str| -> PolarsResult<Vec<u32>> {
        Ok(frame.column(name)?.u32()?.iter().map(Option::unwrap_or_default).collect())
    };
    let counts = [count("errors")?, count("warnings")?, count("infos")?];
    let rows = text("key")?.zip(text("status")?).zip(text("verdict")?).enumerate();
    let answers = rows.filter_map(|(row, ((key, status), verdict))| {
        let answer = AuditAnswer {
            status: status.and_then(Status::from_name).unwrap_or(Status::Unreadable),
            verdict: verdict.and_then(Verdict::from_name),
            errors: counts[0][row],
            warnings: counts[1][row],
            infos: counts[2][row],
        };
        Some((key?.to_owned(), answer))
    });
    Ok(answers.collect())
}

fn runs_frame(row: RunRow<'_>, report: Option<&Report>) -> PolarsResult<DataFrame> {
    let RunRow { task, answer } = row;
    let log = report.map(|report| &report.log);
    let robots = report.map(|report| report.robots.as_slice()).unwrap_or_default();
    let names: Vec<&str> = robots.iter().map(|robot| robot.name.as_str()).collect();
    let of_label = |name: &str| task.labels.get(name).map(String::as_str);
    let stamp = |of: Option<Stamp>| of.map(Stamp::nanos);
    let open = |report: &Report| {
        let open = report.checks.iter().filter(|check| check.status == Decided::Inconclusive);
        open.count() as u32
    };
    DataFrame::new(
        1,
        vec![
            scalar_column("key", task.key.as_str()),
            scalar_column("path", task.path.as_str()),
            scalar_column("content", task.content.as_str()),
            scalar_column("version", task.version.as_str()),
            scalar_column("settings", task.settings.as_str()),
            scalar_column("bytes", task.bytes),
            scalar_column("mtime_ns", task.mtime_ns),
            scalar_column("site", of_label("site")),
            scalar_column("arm", of_label("arm")),
            scalar_column("labels_json", as_json(&task.labels)),
            scalar_column("status", answer.status.name()),
            scalar_column("verdict", answer.verdict.map(Verdict::name)),
            scalar_column("errors", answer.errors),
            scalar_column("warnings", answer.warnings),
            scalar_column("infos", answer.infos),
            scalar_column("inconclusive", report.map(open)),
            scalar_column("container", log.and_then(|log| Some(log.files.first()?.container))),
            scalar_column("messages", log.map(|log| log.messages)),
            scalar_column("start_ns", log.and_then(|log| stamp(log.start_ns))),
            scalar_column("end_ns", log.and_then(|log| stamp(log.end_ns))),
            scalar_column("duration_s", log.and_then(|log| log.duration_s)),
            scalar_column("robots", (!names.is_empty()).then(|| names.join(", "))),
            scalar_column("robots_json", as_json(&robots)),
            scalar_column("notes_json", as_json(&log.map(|log| &log.notes))),
        ],
    )
}

fn streams_frame(streams: &[StreamRow]) -> PolarsResult<DataFrame> {
    let of =
        |name: &str, of: fn(&StreamRow) -> Option<&str>| text_column(name, streams.iter().map(of));
    let count = |name: &str, of: fn(&StreamRow) -> u64| {
        Column::new(name.into(), streams.iter().map(of).collect::<Vec<_>>())
    };
    let stamp = |name: &str, of: fn(&StreamRow) -> Option<Stamp>| {
        let stamps = streams.iter().map(|row| of(row).map(Stamp::nanos));
        Column::new(name.into(), stamps.collect::<Vec<Option<i64>>>())
    };
    let rates: Vec<Option<f64>> = streams.iter().map(|row| row.rate_hz).collect();
    DataFrame::new(
        streams.len(),
        vec![
            of("topic", |row| Some(&row.topic)),
            of("type", |row| Some(&row.type_name)),
            of("role", |row| Some(row.role)),
            of("reason", |row| Some(&row.reason)),
            of("robot", |row| row.robot.as_deref()),
            of("frame_id", |row| row.frame_id.as_deref()),
            of("child_frame_id", |row| row.child_frame_id.as_deref()),
            of("reference", |row| row.reference.as_deref()),
            of("link", |row| row.link.as_deref()),
            of("witness", |row| row.source_kind),
            count("count", |row| row.count),
            count("dropped", |row| row.dropped),
            Column::new("rate_hz".into(), rates),
            stamp("start_ns", |row| row.start_ns),
            stamp("end_ns", |row| row.end_ns),
        ],
    )
}

fn errors_frame(row: RunRow<'_>, trouble: Option<&Trouble>) -> PolarsResult<DataFrame> {
    let Some(trouble) = trouble else { return Ok(DataFrame::empty()) };
    let columns = vec![
        scalar_column("path", row.task.path.as_str()),
        scalar_column("status", row.answer.status.name()),
        scalar_column("what", trouble.what.as_str()),
        scalar_column("where", trouble.place.as_str()),
        scalar_column("do", trouble.remedy.as_str()),
    ];
    with_row_numbers(&row.task.key, DataFrame::new(1, columns)?)
}

/// Key and row number identify a row in any part.
fn with_row_numbers(key: &str, mut frame: DataFrame) -> PolarsResult<DataFrame> {
    let rows = frame.height();
    let numbers: Vec<u32> = (0..rows as u32).collect();
    frame.insert_column(0, Column::new("key".into(), vec![key; rows]))?;
    frame.insert_column(1, Column::new("row".into(), numbers))?;
    Ok(frame)
}

fn text_column<'a>(name: &str, values: impl Iterator<Item = Option<&'a str>>) -> Column {
    Column::new(name.into(), values.collect::<Vec<_>>())
}

fn scalar_column<T, P: ?Sized>(name: &str, value: T) -> Column
where
    Series: NamedFrom<Vec<T>, P>,
{
    Column::new(name.into(), vec![value])
}

/// String keys and finite numbers: JSON cannot fail.
fn as_json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Number of findings, without ignored ones.
pub(in crate::fleet) fn count_findings(report: &Report, severity: Severity) -> u32 {
    report.findings.iter().filter(|finding| finding.severity == severity).count() as u32
}
