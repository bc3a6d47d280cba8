//! Report for a dataset card.

use std::io::{self, Write};

use super::text::{arm_text, frequency_text, header_lines, totals_text};
use super::{FindingRow, FleetReport, trends};
use crate::fleet::FailureGroup;
use crate::report::markdown::{escape_prose, inline_code};

/// JSON and HTML contain more.
const MAX_ROWS: usize = 20;

/// Writes the report as Markdown.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &FleetReport, out: &mut dyn Write) -> io::Result<()> {
    let verdict = report.verdict();
    writeln!(out, "## Pose audit: {verdict}\n\n{}\n", escape_prose(&totals_text(report)))?;
    for (label, text) in header_lines(report) {
        writeln!(out, "- {label}: {}", escape_prose(&text))?;
    }
    writeln!(out, "- trends: {}", escape_prose(&trends::counts_text(&report.trends)))?;
    report.arms.iter().try_for_each(|row| writeln!(out, "- {}", escape_prose(&arm_text(row))))?;
    for dataset in &report.datasets {
        let lines = dataset.lines();
        let head = lines.first().map(String::as_str).unwrap_or_default();
        writeln!(out, "\n### Columns of {}\n", escape_prose(head))?;
        if !dataset.columns.is_empty() {
            writeln!(out, "| what | columns | by |\n|---|---|---|")?;
        }
        for row in &dataset.columns {
            let columns: Vec<String> = row.columns.iter().map(|name| inline_code(name)).collect();
            writeln!(
                out,
                "| {} | {} | {} |",
                escape_prose(&row.is),
                columns.join(", "),
                escape_prose(&row.why)
            )?;
        }
        dataset
            .open_question
            .iter()
            .try_for_each(|open| writeln!(out, "\n{}", escape_prose(open)))?;
    }
    if !report.findings.is_empty() {
        let head = "| severity | rule | subject | found | worst in | last in |";
        writeln!(out, "\n{head}\n|---|---|---|---|---|---|")?;
    }
    report.findings.iter().take(MAX_ROWS).try_for_each(|row| write_finding(row, out))?;
    if !report.errors.is_empty() {
        writeln!(out, "\n| not audited | logs | what to do |\n|---|---|---|")?;
    }
    for group in FailureGroup::group(&report.errors).iter().take(MAX_ROWS) {
        let [what, paths, _] = group.lines();
        let [what, remedy] = [&what, group.remedy].map(escape_prose);
        writeln!(out, "| {what} | {} | {remedy} |", inline_code(&paths))?;
    }
    writeln!(out, "\nNext:\n")?;
    report.next_commands().iter().try_for_each(|next| {
        let purpose = escape_prose(&next.purpose);
        writeln!(out, "- {}: {purpose}", inline_code(&next.command))
    })
}

fn write_finding(row: &FindingRow, out: &mut dyn Write) -> io::Result<()> {
    let (severity, often) = (row.severity.name(), frequency_text(row));
    let subject = if row.subject.part_label().is_empty() {
        row.subject.arm_label()
    } else {
        row.subject.part_label()
    };
    let found = format!("{}, {often}: {}", row.title, row.message);
    let worst = row.worst.as_ref().map_or(&row.path, |worst| &worst.path);
    writeln!(
        out,
        "| {severity} | {} | {} | {} | {} | {} |",
        row.code,
        escape_prose(&subject),
        escape_prose(&found),
        inline_code(worst),
        inline_code(&row.path)
    )
}
