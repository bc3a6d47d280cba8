//! The findings: on the time line, and on a page.

use std::fmt::Write;

use re_sdk_types::archetypes::{TextDocument, TextLog};
use re_sdk_types::components::TextLogLevel;

use crate::finding::{Finding, Severity, Status};
use crate::report::Report;
use crate::time::Stamp;

use super::recorder::{Recorded, Recorder};
use super::{MOST_POINTS, MOST_POSES, Replay, palette};

/// The entity of the findings on the time line.
pub const FINDINGS: &str = "findings";
/// The entity of the page.
pub const REPORT: &str = "report";

/// The recording's name: that of the first file.
pub fn name(report: &Report) -> String {
    let file = report.log.files.first().and_then(|file| file.path.file_name());
    file.map_or_else(|| "run".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Records every finding where what it looked at begins, and all of them on a page.
pub fn record(replay: &Replay, recorder: &Recorder) -> Recorded {
    let findings = &replay.report.findings;
    let at = |finding: &Finding| start_s(finding, replay.origin);
    let columns = TextLog::update_fields()
        .with_many_text(findings.iter().map(sentence))
        .with_many_level(findings.iter().map(|finding| level(finding.severity)))
        .with_many_color(findings.iter().map(|finding| match finding.severity {
            Severity::Error => palette::ERROR,
            Severity::Warning => palette::WARNING,
            Severity::Info => palette::INFO,
        }))
        .columns_of_unit_batches();
    let t_s: Vec<f64> = findings.iter().map(at).collect();
    recorder.moving(FINDINGS.into(), &t_s, columns)?;
    recorder.fixed(REPORT.into(), &TextDocument::from_markdown(page(replay.report)))
}

/// When what a finding looked at begins, s from the origin, where a finding without a time stands
/// too.
fn start_s(finding: &Finding, origin: Stamp) -> f64 {
    finding.start_ns.map_or(0.0, |start| start.seconds_since(origin))
}

fn sentence(finding: &Finding) -> String {
    format!("{} {}: {}", finding.code, finding.subject.label(), finding.message)
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => TextLogLevel::ERROR,
        Severity::Warning => TextLogLevel::WARN,
        Severity::Info => TextLogLevel::INFO,
    }
}

/// The page, as Markdown.
fn page(report: &Report) -> String {
    let mut page = format!("# {} · {}\n\n", report.verdict, name(report));
    if let Some(trouble) = &report.error {
        page += &format!("{trouble}\n\n");
    }
    for finding in &report.findings {
        page += &block(finding);
    }
    for (status, words) in [(Status::Pass, "Passed"), (Status::Inconclusive, "Could not tell")] {
        let mut codes: Vec<&str> = report
            .checks
            .iter()
            .filter(|row| row.status == status)
            .map(|row| row.code)
            .collect();
        codes.dedup();
        if !codes.is_empty() {
            page += &format!("{words}: {}\n\n", codes.join(", "));
        }
    }
    page + &legend()
}

fn block(finding: &Finding) -> String {
    let mut block = format!(
        "**{} {}** `{}`: {}\n\n",
        finding.severity.name(),
        finding.code,
        finding.subject.label(),
        finding.message
    );
    if let Some(effect) = &finding.evidence.effect {
        let _ = writeln!(block, "- {effect}");
    }
    let _ = writeln!(block, "- *fix:* {}\n", finding.fix);
    block
}

fn legend() -> String {
    format!(
        "## What is shown\n\n\
         - **arm**: FK of the joint states, everything found taken off; **arm_as_recorded**: without \
         that, where the joint states are at fault\n\
         - **logged**: the pose as logged, at its stamp; **corrected**: its ghost, everything found \
         taken off, when it was true. The ghost sits on the arm where the findings explain the log\n\
         - of more than {MOST_POSES} poses every k-th is shown, of trails of more than {MOST_POINTS} \
         points likewise; of longer series the extremes of equal stretches\n"
    )
}
