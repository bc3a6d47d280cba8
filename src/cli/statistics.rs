//! Number of findings per rule, instead of a report.

use poseaudit::checks;
use poseaudit::finding::{Finding, Severity};
use poseaudit::report::{Report, Trouble};
use serde::Serialize;

use super::output;
use super::reports::ReportOptions;

const STATISTICS_OPTION: &str = "--statistics";

#[derive(Serialize)]
struct RuleCount {
    code: &'static str,
    name: &'static str,
    /// Highest.
    severity: Severity,
    count: usize,
}

/// Fails if the format has no statistics.
pub fn check_format(reports: &ReportOptions) -> Result<(), Trouble> {
    match reports.single_format() {
        Some((format, _)) if matches!(format.name, "text" | "json") => Ok(()),
        _ => {
            let what = "statistics are text or JSON";
            Err(super::misuse(STATISTICS_OPTION, what, "use one --format: text or json"))
        }
    }
}

/// Counts in descending order.
pub fn emit(report: &Report, reports: &ReportOptions) -> Result<(), Trouble> {
    let Some((format, path)) = reports.single_format() else { return Ok(()) };
    let rows = count_by_rule(&report.findings);
    output::emit(path, |out| {
        if !format.is_text() {
            return output::write_json(out, &rows);
        }
        let mut table = output::table(["count", "code", "name", "severity"]);
        for RuleCount { code, name, severity, count } in &rows {
            table.add_row([&count.to_string(), *code, *name, severity.name()]);
        }
        if !rows.is_empty() {
            writeln!(out, "{}\n", table.trim_fmt())?;
        }
        writeln!(out, "{}", report.verdict)
    })
}

fn count_by_rule(findings: &[Finding]) -> Vec<RuleCount> {
    let of = |rule: &&'static checks::Rule| {
        let found = || findings.iter().filter(|finding| *finding.code == *rule.code);
        let severity = found().map(|finding| finding.severity).max()?;
        Some(RuleCount { code: rule.code, name: rule.name, severity, count: found().count() })
    };
    let mut rows: Vec<RuleCount> = checks::registry().iter().filter_map(of).collect();
    rows.sort_by_key(|row| std::cmp::Reverse((row.count, row.severity)));
    rows
}
