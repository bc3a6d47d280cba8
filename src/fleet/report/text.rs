//! Fleet report as text.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};

use super::{ArmRow, FindingRow, FleetReport, TrendRow, calendar};
use crate::finding::Severity;
use crate::report::sanitize;

const LABEL: usize = 16;

/// Limit per table; JSON and HTML contain more.
const MOST_ROWS: usize = 20;

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
    for (label, said) in head(report) {
        line(out, Style::new(), label, &said)?;
    }
    writeln!(out)?;
    let (style, word) = if report.failing { (ERROR, "FAIL") } else { (GOOD, "PASS") };
    line(out, style, word, &totals(report))?;
    for dataset in &report.datasets {
        let mut label = "dataset";
        for said in dataset.lines() {
            line(out, STRONG, label, &said)?;
            label = "";
        }
    }
    let moving: Vec<&TrendRow> = report.moving().collect();
    rows(out, &moving, |out, row| {
        let what = format!("{} {}: {}", row.whose.arm_label(), row.whose.part(), row.says());
        line(out, WARNING, &format!("{} {}", row.course.name(), row.code), &what)
    })?;
    let found: Vec<&FindingRow> = report.findings.iter().collect();
    rows(out, &found, |out, row| finding(row, out))?;
    let arms: Vec<&ArmRow> = report.arms.iter().collect();
    rows(out, &arms, |out, row| line(out, STRONG, "arm", &arm(row)))?;
    let errors: Vec<_> = report.errors.iter().collect();
    rows(out, &errors, |out, row| {
        line(out, ERROR, "not audited", &format!("{}: {}", row.path, row.what))
    })
}

pub fn head(report: &FleetReport) -> Vec<(&'static str, String)> {
    let logs = &report.logs;
    let mut said = format!("{}", logs.total);
    if logs.copies > 0 {
        said += &format!(", and {} copies", logs.copies);
    }
    if let (Some(start), Some(end)) = (&logs.start_ns, &logs.end_ns) {
        let [start, end] = [start, end].map(|stamp| calendar::day(stamp.parse().unwrap_or(0)));
        said += &format!(", {start} to {end}");
    }
    let mut head = vec![("logs", said)];
    if logs.before > 0 {
        head.push(("not counted", format!("{} logs before the requested day", logs.before)));
    }
    if logs.undated > 0 {
        let said = format!("{} logs without calendar time: not included in trends", logs.undated);
        head.push(("undated", said));
    }
    if logs.set_aside > 0 {
        let said = format!(
            "{} rows of other versions or settings; shown: version {}, settings {}",
            logs.set_aside, logs.version, logs.settings
        );
        head.push(("set aside", said));
    }
    head
}

pub fn totals(report: &FleetReport) -> String {
    let verdicts = &report.logs.verdicts;
    let moving = report.moving().count();
    let mut parts = vec![
        format!("{} pass", verdicts.pass),
        format!("{} fail", verdicts.fail),
        format!("{} inconclusive", verdicts.inconclusive),
    ];
    if !report.errors.is_empty() {
        parts.push(format!("{} not audited", report.errors.len()));
    }
    if moving > 0 {
        parts.push(format!("{moving} {}", if moving == 1 { "trend" } else { "trends" }));
    }
    parts.join(", ")
}

pub fn arm(row: &ArmRow) -> String {
    let fails: Vec<String> =
        row.fails.iter().map(|fail| format!("{} in {}", fail.code, fail.logs)).collect();
    let fails = if fails.is_empty() { "no problems found".to_owned() } else { fails.join(", ") };
    format!("{}: {} logs, {} fail: {fails}", row.whose.arm_label(), row.logs, row.verdicts.fail)
}

pub fn how_often(row: &FindingRow) -> String {
    let of = row.logs + row.sound;
    match (row.logs, row.sound) {
        (1, 0) => "in its only log".to_owned(),
        (logs, 0) => format!("in all {logs} logs"),
        (logs, _) => format!("in {logs} of {of} logs"),
    }
}

fn finding(row: &FindingRow, out: &mut dyn Write) -> io::Result<()> {
    let style = match row.severity {
        Severity::Error => ERROR,
        Severity::Warning => WARNING,
        Severity::Info => INFO,
    };
    let part = row.whose.part();
    let part = if part.is_empty() { String::new() } else { format!(" {part}") };
    let said = format!("{}{part}: {}, {}", row.whose.arm_label(), row.title, how_often(row));
    line(out, style, &format!("{} {}", row.severity.name(), row.code), &said)?;
    if let Some(worst) = &row.worst {
        line(out, Style::new(), "", &format!("worst: {}, {}", worst.message, worst.path))?;
    }
    line(out, Style::new(), "", &format!("last: {}, {}", row.message, row.path))
}

fn rows<T>(
    out: &mut dyn Write,
    rows: &[T],
    mut write: impl FnMut(&mut dyn Write, &T) -> io::Result<()>,
) -> io::Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(out)?;
    for row in rows.iter().take(MOST_ROWS) {
        write(out, row)?;
    }
    if rows.len() > MOST_ROWS {
        line(out, Style::new(), "", &format!("and {} more", rows.len() - MOST_ROWS))?;
    }
    Ok(())
}

fn line(out: &mut dyn Write, style: Style, label: &str, said: &str) -> io::Result<()> {
    let room = LABEL.saturating_sub(label.len()).max(1);
    writeln!(out, "{style}{label}{style:#}{:room$}{}", "", sanitize(said))
}
