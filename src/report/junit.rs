//! Report as JUnit XML: one suite per rule, with one case per subject.
//!
//! A case fails if its finding fails the run; other findings go to the output of their case. Inconclusive
//! and inapplicable checks are skipped, with the reason.

use std::io::{self, Write};

use quick_junit::{NonSuccessKind, TestCase, TestCaseStatus, TestSuite};

use super::Report;
use super::outline::Outline;
use crate::finding::{CheckRow, Finding, Status};

/// Writes the report.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let outline = Outline::new(report);
    let mut tests = quick_junit::Report::new("poseaudit");
    if let Some(trouble) = &report.error {
        let mut status = TestCaseStatus::non_success(NonSuccessKind::Error);
        status.set_message(&*trouble.what).set_type("error");
        status.set_description(format!("{trouble}"));
        tests.add_test_suite(suite("audit", [case("poseaudit.audit", &trouble.place, status)]));
    }
    for rows in report.checks.chunk_by(|a, b| a.code == b.code) {
        let cases = rows.iter().map(|row| {
            let class = format!("poseaudit.{}", row.code);
            let subject = outline.subject(&row.subject);
            let name = if subject.is_empty() { row.name } else { &subject };
            let found: Vec<&Finding> = report
                .findings
                .iter()
                .filter(|finding| finding.code == row.code && finding.subject == row.subject)
                .collect();
            let mut case = case(&class, name, outcome(report, &outline, row, &found));
            let said = match (row.status, &row.reason) {
                (Status::Pass, Some(remark)) => Some(remark.clone()),
                (Status::Fail, _) if !has_failing_finding(report, &found) => {
                    Some(describe_findings(&outline, &found))
                }
                _ => None,
            };
            if let Some(said) = said {
                case.set_system_out(said);
            }
            case
        });
        tests.add_test_suite(suite(&format!("{} {}", rows[0].code, rows[0].name), cases));
    }
    let text = tests.to_string().map_err(io::Error::other)?;
    // XML forbids these two, and the writer does not escape them.
    let text = text.replace(['\u{fffe}', '\u{ffff}'], "\u{fffd}");
    // Jenkins' schema does not allow it on the root.
    let skipped = format!(" skipped=\"{}\"", tests.skipped);
    out.write_all(text.replacen(&skipped, "", 1).as_bytes())
}

fn suite(name: &str, cases: impl IntoIterator<Item = TestCase>) -> TestSuite {
    let mut suite = TestSuite::new(name);
    suite.add_test_cases(cases);
    suite
}

fn case(class: &str, name: &str, status: TestCaseStatus) -> TestCase {
    let mut case = TestCase::new(name, status);
    case.set_classname(class);
    case
}

fn outcome(
    report: &Report,
    outline: &Outline,
    row: &CheckRow,
    found: &[&Finding],
) -> TestCaseStatus {
    let reason = row.reason.as_deref().unwrap_or_default();
    match (row.status, found) {
        (Status::Fail, [first, ..]) if has_failing_finding(report, found) => {
            let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
            status.set_message(&*first.message).set_type(first.severity.name());
            status.set_description(describe_findings(outline, found));
            status
        }
        (Status::Pass | Status::Fail, _) => TestCaseStatus::success(),
        (Status::Inconclusive, _) => skipped_status(format!("inconclusive: {reason}")),
        (Status::Skipped, _) => skipped_status(format!("skipped: {reason}")),
    }
}

fn has_failing_finding(report: &Report, found: &[&Finding]) -> bool {
    found.iter().any(|finding| report.fails_on(finding.severity))
}

fn skipped_status(why: String) -> TestCaseStatus {
    let mut status = TestCaseStatus::skipped();
    status.set_message(why);
    status
}

fn describe_findings(outline: &Outline, found: &[&Finding]) -> String {
    let blocks = found.iter().map(|finding| {
        let head = format!("{}: {}", finding.severity.name(), finding.message);
        let fix = format!("fix: {}", finding.fix);
        [vec![head], outline.finding_lines(finding), vec![fix]].concat().join("\n")
    });
    blocks.collect::<Vec<_>>().join("\n\n")
}
