//! Findings on the time line: as log messages, time spans and pages.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use re_log_types::EntityPath;
use re_sdk_types::AnyValues;
use re_sdk_types::archetypes::{StateChange, StateConfiguration, TextDocument, TextLog};
use re_sdk_types::components::{MediaType, Text, TextLogLevel};

use super::row_times::RowTimes;
use super::timeline_writer::{TimelineWriter, entity_path};
use super::{Replay, ReplayArm, ReplayCause, finding_views, layout};
use crate::finding::{Finding, Severity};
use crate::report::markdown::{escape_prose, inline_code};
use crate::report::outline::Outline;
use crate::time::Stamp;

/// Log messages; parent of the pages.
pub(super) fn log() -> EntityPath {
    entity_path(&["findings"])
}

pub(super) fn spans() -> EntityPath {
    entity_path(&["spans"])
}

/// The number keeps the order.
pub(super) fn lane(index: usize, finding: &Finding) -> EntityPath {
    spans().join(&entity_path(&[&format!("{:02}-{}", index + 1, finding.code)]))
}

pub(super) fn page(index: usize) -> EntityPath {
    log().join(&entity_path(&[&format!("page_{}", index + 1)]))
}

/// Each finding at its first stamp, with its time span and page.
pub(super) fn write(writer: &TimelineWriter, replay: &Replay<'_>) -> Result<(), ReplayCause> {
    let outline = Outline::new(replay.report);
    let mut on: BTreeMap<EntityPath, (Vec<Text>, Vec<Text>)> = BTreeMap::new();
    for (index, finding) in replay.report.findings.iter().enumerate() {
        let (start, end) = replay.span_of(finding);
        let subject = outline.subject(&finding.subject);
        let line = TextLog::new(format!("{}{}", heading(finding, &subject), finding.message))
            .with_level(level(finding.severity));
        // One column cannot hold different levels.
        writer.log_columns(
            &log(),
            &finding_times(writer, replay, finding, &[start]),
            line.columns([1])?,
        )?;
        let links = links(replay, index);
        let text = format!("{}{}", markdown(finding, &outline), links_markdown(&links));
        let text = TextDocument::new(text).with_media_type(MediaType::MARKDOWN);
        writer.log_static(&page(index), &text)?;
        for (_, entity) in links {
            let said = format!("{}{}", heading(finding, &subject), finding.message);
            let (all, pages) = on.entry(entity).or_default();
            all.push(Text::from(said));
            pages.push(Text::from(recording_url(&page(index))));
        }
        draw_span(writer, replay, index, [start, end])?;
    }
    // Selecting an entity shows its findings.
    for (entity, (all, pages)) in on {
        let back = AnyValues::default()
            .with_component::<Text>("findings", all)
            .with_component::<Text>("finding_pages", pages);
        writer.log_static(&entity, &back)?;
    }
    Ok(())
}

/// Titles and links: time span, plots, and stream or joint.
fn links(replay: &Replay<'_>, index: usize) -> Vec<(String, EntityPath)> {
    let finding = &replay.report.findings[index];
    let own = finding_views::list(replay.report, index).into_iter();
    let own = own.map(|view| (view.title.to_owned(), view.path));
    let plots =
        replay.arm_of(finding).map(|arm| layout::plot_entities(finding, arm)).unwrap_or_default();
    std::iter::once(("when".to_owned(), lane(index, finding))).chain(own).chain(plots).collect()
}

fn links_markdown(links: &[(String, EntityPath)]) -> String {
    let links = links
        .iter()
        .map(|(title, path)| format!("[{}]({})", escape_prose(title), recording_url(path)));
    format!("\nSelect: {}\n", links.collect::<Vec<_>>().join(" · "))
}

fn recording_url(path: &EntityPath) -> String {
    format!("recording://{}", path.to_string().trim_start_matches('/'))
}

/// `LAT001 /tcp/pose: `.
fn heading(finding: &Finding, subject: &str) -> String {
    match subject {
        "" => format!("{} ", finding.code),
        subject => format!("{} {subject}: ", finding.code),
    }
}

/// On the timelines of the arm's joint states.
pub(super) fn finding_times(
    writer: &TimelineWriter,
    replay: &Replay<'_>,
    finding: &Finding,
    stamps: &[Stamp],
) -> RowTimes {
    match replay.arm_of(finding) {
        Some(arm) => arm_times(writer, arm, stamps),
        None => {
            let nanos: Vec<i64> = stamps.iter().map(|stamp| stamp.nanos()).collect();
            RowTimes { logs_ns: nanos.clone(), samples: vec![0; nanos.len()], stamps_ns: nanos }
        }
    }
}

fn arm_times(writer: &TimelineWriter, arm: &ReplayArm<'_>, stamps: &[Stamp]) -> RowTimes {
    writer.row_times(arm, &arm.received, stamps.iter().copied())
}

/// A bar from the first to the last stamp.
fn draw_span(
    writer: &TimelineWriter,
    replay: &Replay<'_>,
    index: usize,
    ends: [Stamp; 2],
) -> Result<(), ReplayCause> {
    let finding = &replay.report.findings[index];
    let path = lane(index, finding);
    let bar = format!("{}{}", heading(finding, finding.subject.label()), finding.message);
    let bar = bar.as_str();
    let style = StateConfiguration::new().with_values([bar]).with_colors([rgb(finding.severity)]);
    writer.log_static(&path, &style)?;
    let states = StateChange::new().with_state([Text::from(bar), Text::from("")]);
    let times = finding_times(writer, replay, finding, &ends);
    writer.log_columns(&path, &times, states.columns_of_unit_batches()?)
}

const fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => TextLogLevel::ERROR,
        Severity::Warning => TextLogLevel::WARN,
        Severity::Info => TextLogLevel::INFO,
    }
}

const fn rgb(severity: Severity) -> [u8; 3] {
    match severity {
        Severity::Error => [200, 66, 50],
        Severity::Warning => [176, 124, 30],
        Severity::Info => [70, 104, 150],
    }
}

/// Message, subject, amount and fix.
pub(super) fn markdown(finding: &Finding, outline: &Outline<'_>) -> String {
    let Finding { code: rule, title, message, fix, .. } = finding;
    let mut text = format!("### {} {rule} {}\n\n", finding.severity.name(), escape_prose(title));
    let subject = outline.subject(&finding.subject);
    if !subject.is_empty() {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{}\n", inline_code(&subject));
    }
    let _ = writeln!(text, "{}\n", escape_prose(message));
    for about in outline.finding_lines(finding) {
        let _ = writeln!(text, "- {}", escape_prose(&about));
    }
    let _ = writeln!(text, "- **fix** {}\n", escape_prose(fix));
    text
}
