//! Number of findings per rule, instead of a report.

use poseaudit::checks;
use poseaudit::finding::{Finding, Severity};
use poseaudit::report::{Report, Trouble};
use serde::Serialize;

use super::output;
use super::reports::Reports;

const STATISTICS: &str = "--statistics";

/// Findings of one rule.
#[derive(Serialize)]
struct Row {
    code: &'static str,
    name: &'static str,
    /// Highest.
    severity: Severity,
    count: usize,
}

/// Fails if the format has no statistics.
pub fn can_be_followed(reports: &Reports) -> Result<(), Trouble> {
    match reports.only() {
        Some((format, _)) if matches!(format.name, "text" | "json") => Ok(()),
        _ => {
            let what = "statistics are text or JSON";
            Err(super::misuse(STATISTICS, what, "use one --format: text or json"))
        }
    }
}

/// Counts in descending order.
pub fn emit(report: &Report, reports: &Reports) -> Result<(), Trouble> {
    let Some((format, path)) = reports.only() else { return Ok(()) };
    let rows = rows(&report.findings);
    output::emit(path, |out| {
        if !format.is_text() {
            serde_json::to_writer_pretty(&mut *out, &rows)?;
            return writeln!(out);
        }
        let mut table = output::table(["count", "code", "name", "severity"]);
        for Row { code, name, severity, count } in &rows {
            table.add_row([&count.to_string(), *code, *name, severity.name()]);
        }
        if !rows.is_empty() {
            writeln!(out, "{}\n", table.trim_fmt())?;
        }
        writeln!(out, "{}", report.verdict)
    })
}

fn rows(findings: &[Finding]) -> Vec<Row> {
    let of = |rule: &&'static checks::Rule| {
        let found = || findings.iter().filter(|finding| *finding.code == *rule.code);
        let severity = found().map(|finding| finding.severity).max()?;
        Some(Row { code: rule.code, name: rule.name, severity, count: found().count() })
    };
    let mut rows: Vec<Row> = checks::registry().iter().filter_map(of).collect();
    rows.sort_by_key(|row| std::cmp::Reverse((row.count, row.severity)));
    rows
}
