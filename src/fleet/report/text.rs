//! Fleet report as text.

use std::io::{self, Write};

use anstyle::Style;

use super::{ArmRow, FindingRow, FleetReport, TrendRow, calendar, trends};
use crate::fleet::FailureGroup;
use crate::report::styles::{ERROR, STRONG, WARNING, severity_style, verdict_style, write_line};

/// Limit per table; JSON and HTML contain more.
const MAX_ROWS: usize = 20;

/// Writes the report. The verdict and the next commands come last.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &FleetReport, out: &mut dyn Write) -> io::Result<()> {
    for (label, text) in header_lines(report) {
        write_line(out, Style::new(), label, &text)?;
    }
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
    write_rows(out, &report.findings, write_finding)?;
    write_rows(out, &report.arms, |out, row| write_line(out, STRONG, "arm", &arm_text(row)))?;
    write_rows(out, &FailureGroup::group(&report.errors), |out, group| {
        let [what, paths, remedy] = group.lines();
        write_line(out, ERROR, "not audited", &what)?;
        write_line(out, Style::new(), "", &paths)?;
        write_line(out, Style::new(), "", &remedy)
    })?;
    writeln!(out)?;
    write_line(out, STRONG, "trends", &trends::counts_text(&report.trends))?;
    let verdict = report.verdict();
    let style = verdict_style(verdict);
    write_line(out, style, &verdict.to_string(), &totals_text(report))?;
    let mut label = "next";
    for next in report.next_commands() {
        write_line(out, STRONG, label, &format!("{}    # {}", next.command, next.purpose))?;
        label = "";
    }
    Ok(())
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

/// `berlin / cell1: 16 logs, 9 pass, 7 fail: ZER001 in 7`.
pub fn arm_text(row: &ArmRow) -> String {
    let fails: Vec<String> =
        row.fails.iter().map(|fail| format!("{} in {}", fail.code, fail.logs)).collect();
    let fails = if fails.is_empty() { String::new() } else { format!(": {}", fails.join(", ")) };
    format!("{}: {}{fails}", row.subject.arm_label(), arm_counts(row))
}

/// `16 logs, 9 pass, 7 fail`.
pub fn arm_counts(row: &ArmRow) -> String {
    let counts = [
        (row.verdicts.pass, "pass"),
        (row.verdicts.fail, "fail"),
        (row.verdicts.inconclusive, "inconclusive"),
        (row.not_audited, "not audited"),
    ];
    let logs = format!("{} {}", row.logs, if row.logs == 1 { "log" } else { "logs" });
    let present = counts.iter().filter(|(count, _)| *count > 0);
    let parts = present.map(|(count, how)| format!("{count} {how}"));
    std::iter::once(logs).chain(parts).collect::<Vec<_>>().join(", ")
}

pub fn frequency_text(row: &FindingRow) -> String {
    let of = row.logs + row.passed;
    match (row.logs, row.passed) {
        (1, 0) => "in its only log".to_owned(),
        (logs, 0) => format!("in all {logs} logs"),
        (logs, _) => format!("in {logs} of {of} logs"),
    }
}

fn write_finding(out: &mut dyn Write, row: &FindingRow) -> io::Result<()> {
    let style = severity_style(row.severity);
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
