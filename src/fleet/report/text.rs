//! Fleet report as text.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};

use super::{ArmRow, FindingRow, FleetReport, TrendRow, calendar};
use crate::finding::Severity;
use crate::report::sanitize;

const LABEL_WIDTH: usize = 16;

/// Limit per table; JSON and HTML contain more.
const MAX_ROWS: usize = 20;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const INFO: Style = AnsiColor::Cyan.on_default().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const STRONG: Style = Style::new().bold();

/// Writes the report.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &FleetReport, out: &mut dyn Write) -> io::Result<()> {
    for (label, text) in header_lines(report) {
        write_line(out, Style::new(), label, &text)?;
    }
    writeln!(out)?;
    let (style, word) = if report.failing { (ERROR, "FAIL") } else { (GOOD, "PASS") };
    write_line(out, style, word, &totals_text(report))?;
    for dataset in &report.datasets {
        let mut label = "dataset";
        for text in dataset.lines() {
            write_line(out, STRONG, label, &text)?;
            label = "";
        }
    }
    let found_trends: Vec<&TrendRow> = report.found_trends().collect();
    write_rows(out, &found_trends, |out, row| {
        let what =
            format!("{} {}: {}", row.subject.arm_label(), row.subject.part_label(), row.summary());
        write_line(out, WARNING, &format!("{} {}", row.kind.name(), row.code), &what)
    })?;
    let found: Vec<&FindingRow> = report.findings.iter().collect();
    write_rows(out, &found, |out, row| write_finding(row, out))?;
    let arms: Vec<&ArmRow> = report.arms.iter().collect();
    write_rows(out, &arms, |out, row| write_line(out, STRONG, "arm", &arm_text(row)))?;
    let errors: Vec<_> = report.errors.iter().collect();
    write_rows(out, &errors, |out, row| {
        write_line(out, ERROR, "not audited", &format!("{}: {}", row.path, row.what))
    })
}

pub fn header_lines(report: &FleetReport) -> Vec<(&'static str, String)> {
    let logs = &report.logs;
    let mut text = format!("{}", logs.total);
    if logs.copies > 0 {
        text += &format!(", and {} copies", logs.copies);
    }
    if let (Some(start), Some(end)) = (&logs.start_ns, &logs.end_ns) {
        let [start, end] =
            [start, end].map(|stamp| calendar::format_day(stamp.parse().unwrap_or(0)));
        text += &format!(", {start} to {end}");
    }
    let mut head = vec![("logs", text)];
    if logs.before > 0 {
        head.push(("not counted", format!("{} logs before the requested day", logs.before)));
    }
    if logs.undated > 0 {
        let text = format!("{} logs without calendar time: not included in trends", logs.undated);
        head.push(("undated", text));
    }
    if logs.set_aside > 0 {
        let text = format!(
            "{} rows of other versions or settings; shown: version {}, settings {}",
            logs.set_aside, logs.version, logs.settings
        );
        head.push(("set aside", text));
    }
    head
}

pub fn totals_text(report: &FleetReport) -> String {
    let verdicts = &report.logs.verdicts;
    let found_trends = report.found_trends().count();
    let mut parts = vec![
        format!("{} pass", verdicts.pass),
        format!("{} fail", verdicts.fail),
        format!("{} inconclusive", verdicts.inconclusive),
    ];
    if !report.errors.is_empty() {
        parts.push(format!("{} not audited", report.errors.len()));
    }
    if found_trends > 0 {
        parts
            .push(format!("{found_trends} {}", if found_trends == 1 { "trend" } else { "trends" }));
    }
    parts.join(", ")
}

pub fn arm_text(row: &ArmRow) -> String {
    let fails: Vec<String> =
        row.fails.iter().map(|fail| format!("{} in {}", fail.code, fail.logs)).collect();
    let fails = if fails.is_empty() { "no problems found".to_owned() } else { fails.join(", ") };
    format!("{}: {} logs, {} fail: {fails}", row.subject.arm_label(), row.logs, row.verdicts.fail)
}

pub fn frequency_text(row: &FindingRow) -> String {
    let of = row.logs + row.passed;
    match (row.logs, row.passed) {
        (1, 0) => "in its only log".to_owned(),
        (logs, 0) => format!("in all {logs} logs"),
        (logs, _) => format!("in {logs} of {of} logs"),
    }
}

fn write_finding(row: &FindingRow, out: &mut dyn Write) -> io::Result<()> {
    let style = match row.severity {
        Severity::Error => ERROR,
        Severity::Warning => WARNING,
        Severity::Info => INFO,
    };
    let part = row.subject.part_label();
    let part = if part.is_empty() { String::new() } else { format!(" {part}") };
    let text = format!("{}{part}: {}, {}", row.subject.arm_label(), row.title, frequency_text(row));
    write_line(out, style, &format!("{} {}", row.severity.name(), row.code), &text)?;
    if let Some(worst) = &row.worst {
        write_line(out, Style::new(), "", &format!("worst: {}, {}", worst.message, worst.path))?;
    }
    write_line(out, Style::new(), "", &format!("last: {}, {}", row.message, row.path))
}

fn write_rows<T>(
    out: &mut dyn Write,
    rows: &[T],
    mut write: impl FnMut(&mut dyn Write, &T) -> io::Result<()>,
) -> io::Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(out)?;
    for row in rows.iter().take(MAX_ROWS) {
        write(out, row)?;
    }
    if rows.len() > MAX_ROWS {
        write_line(out, Style::new(), "", &format!("and {} more", rows.len() - MAX_ROWS))?;
    }
    Ok(())
}

fn write_line(out: &mut dyn Write, style: Style, label: &str, text: &str) -> io::Result<()> {
    let room = LABEL_WIDTH.saturating_sub(label.len()).max(1);
    writeln!(out, "{style}{label}{style:#}{:room$}{}", "", sanitize(text))
}
