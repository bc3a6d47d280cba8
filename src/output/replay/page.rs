//! The report as a page.

use std::fmt::Write as _;

use re_log_types::EntityPath;
use re_sdk_types::archetypes::TextDocument;
use re_sdk_types::components::MediaType;

use super::timeline_writer::{TimelineWriter, entity_path};
use super::{MAX_ROWS, Replay, ReplayCause, findings};
use crate::report::markdown::escape_prose;
use crate::report::outline::Outline;

pub(super) fn report() -> EntityPath {
    entity_path(&["report"])
}

pub(super) fn write(
    writer: &TimelineWriter,
    replay: &Replay<'_>,
    meshes: &[String],
) -> Result<(), ReplayCause> {
    let page = TextDocument::new(markdown(replay, meshes)).with_media_type(MediaType::MARKDOWN);
    writer.log_static(&report(), &page)
}

fn markdown(replay: &Replay<'_>, meshes: &[String]) -> String {
    let report = replay.report;
    let outline = Outline::new(report);
    let mut page =
        format!("# {}\n\n{}\n\n", report.verdict, escape_prose(&outline.verdict_reason()));
    if let Some(extent) = outline.extent() {
        page.push_str(&format!("{extent}\n\n"));
    }
    for finding in &report.findings {
        page.push_str(&findings::markdown(finding, &outline));
    }
    list(&mut page, "Inconclusive", outline.inconclusive_lines());
    list(&mut page, "Ignored", outline.ignored_findings());
    list(&mut page, "Passed", outline.passed_checks().lines());
    list(&mut page, "Skipped", outline.skipped_checks());
    let notes = report.log.notes.iter().map(|note| note.note.clone());
    list(&mut page, "Notes", notes.collect());
    list(
        &mut page,
        "In this recording",
        meshes.iter().cloned().chain(decimation_notes(replay)).collect(),
    );
    page
}

fn list(page: &mut String, title: &str, lines: Vec<String>) {
    if lines.is_empty() {
        return;
    }
    // Writing to a string cannot fail.
    let _ = writeln!(page, "### {title}\n");
    for line in lines {
        let _ = writeln!(page, "- {}", escape_prose(&line));
    }
    page.push('\n');
}

/// Streams of which not all samples are drawn.
fn decimation_notes(replay: &Replay<'_>) -> Vec<String> {
    let joints = replay
        .arms
        .iter()
        .map(|arm| (format!("joint states of {}", arm.name), arm.corrected.len()));
    let streams = replay.arms.iter().flat_map(|arm| &arm.streams);
    let streams =
        streams.map(|stream| (format!("samples of {}", stream.topic), stream.aligned.t_s.len()));
    let imus = replay.arms.iter().flat_map(|arm| &arm.imus);
    let imus = imus.map(|imu| (format!("samples of {}", imu.topic), imu.yaw_error.len()));
    let long = joints.chain(streams).chain(imus).filter(|(_, rows)| *rows > MAX_ROWS);
    let mut lines: Vec<String> =
        long.map(|(what, rows)| format!("{rows} {what}, thinned to about {MAX_ROWS}")).collect();
    if !lines.is_empty() {
        lines.push(
            "thinned evenly for moving objects; plots keep minimum and maximum values".into(),
        );
    }
    lines
}
