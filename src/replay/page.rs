//! The findings: on the time line, and as a page.

use std::fmt::Write as _;

use re_sdk_types::archetypes::{TextDocument, TextLog};
use re_sdk_types::components::{MediaType, TextLogLevel};
use rerun::EntityPath;

use super::tape::{Tape, entity};
use super::{Replay, ReplayCause};
use crate::finding::{Finding, Severity};

/// The entity of the findings on the time line.
pub(super) fn findings() -> EntityPath {
    entity(&["findings"])
}

/// The entity of the page.
pub(super) fn report() -> EntityPath {
    entity(&["report"])
}

/// Adds the page, and each finding at the first stamp of what it is about.
pub(super) fn write(tape: &Tape, replay: &Replay<'_>) -> Result<(), ReplayCause> {
    let page = TextDocument::new(markdown(replay)).with_media_type(MediaType::MARKDOWN);
    tape.still(&report(), &page)?;
    let all = replay.findings;
    let start = |finding: &Finding| finding.start_ns.unwrap_or(replay.origin).nanos();
    let stamps_ns: Vec<i64> = all.iter().map(start).collect();
    let lines = TextLog::update_fields()
        .with_many_text(all.iter().map(line))
        .with_many_level(all.iter().map(|finding| level(finding.severity)));
    tape.columns(&findings(), &stamps_ns, lines.columns_of_unit_batches()?)?;
    Ok(())
}

fn line(finding: &Finding) -> String {
    let Finding { code, message, .. } = finding;
    match finding.subject.label() {
        "" => format!("{code} {message}"),
        subject => format!("{code} {subject}: {message}"),
    }
}

const fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => TextLogLevel::ERROR,
        Severity::Warning => TextLogLevel::WARN,
        Severity::Info => TextLogLevel::INFO,
    }
}

fn markdown(replay: &Replay<'_>) -> String {
    let mut page = format!("# {}\n", replay.verdict);
    if replay.findings.is_empty() {
        page.push_str("\nNo findings.\n");
    }
    for finding in replay.findings {
        let Finding { code, title, message, fix, .. } = finding;
        let severity = finding.severity.name();
        // Writing to a string cannot fail.
        let _ = writeln!(page, "\n### {severity} {code} {title}\n");
        let subject = finding.subject.label();
        if !subject.is_empty() {
            let _ = writeln!(page, "`{subject}`\n");
        }
        let _ = writeln!(page, "{message}\n");
        if let Some(effect) = &finding.evidence.effect {
            let _ = writeln!(page, "- {effect}");
        }
        let _ = writeln!(page, "- **fix** {fix}");
    }
    page
}
