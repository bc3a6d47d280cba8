//! `poseaudit info`.

use std::io::{self, Write};
use std::path::PathBuf;

use comfy_table::{CellAlignment, Table};
use poseaudit::config::Config;
use poseaudit::log::FileLayout;
use poseaudit::places::PathRegistry;
use poseaudit::report::{
    LogSummary, Report, StreamRow, TableRow, Trouble, sanitize, sanitize_display,
};
use poseaudit::run::RobotSource;
use poseaudit::time::seconds;

use super::audit_options::use_columns;
use super::progress::with_progress;
use super::{Outcome, output};

/// List the topics of a log, with the role of each and why
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit info run.mcap
  poseaudit info run_0.db3 run_1.db3
  poseaudit info episodes.npz --config poseaudit.toml
  poseaudit info run.csv --robot ur10e --columns t,q[6],qd[6],_[18]")]
pub struct Args {
    /// The log, or its URL (s3://, gs://, az://, https://); several files of one run are merged
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,

    /// Config file (TOML), as for an audit: table columns, topics and robot
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// The robot's URDF or DH table, or its name in the catalogue; PREFIX=FILE with several arms
    #[arg(long = "robot", value_name = "FILE|NAME")]
    robots: Vec<RobotSource>,

    /// Meaning of every column of a table without names, as for `audit`
    #[arg(long, value_name = "[FILE=]SPEC")]
    columns: Vec<FileLayout>,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    PathRegistry::check_read_only(args.logs.iter().chain(&args.config))?;
    let config = args.config.as_deref().map(Config::from_file).transpose()?;
    let mut options = config.as_ref().map(Config::options).unwrap_or_default();
    options.logs.clone_from(&args.logs);
    if !args.robots.is_empty() {
        options.run.robots.clone_from(&args.robots);
    }
    use_columns(&mut options, args.columns.clone());
    let report = with_progress(|progress| {
        options.read.progress = Some(progress);
        poseaudit::info(&options)
    })?;
    output::emit(None, |out| write(&report, out))?;
    report.error.map_or(Ok(Outcome::Clean), Err)
}

fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let LogSummary { files, notes, messages, duration_s, .. } = &report.log;
    for file in files {
        let (path, container, bytes) =
            (sanitize_display(file.path.display()), file.container, file.bytes);
        let fetched = file.fetched().map_or(String::new(), |fetched| format!(", {fetched}"));
        writeln!(out, "{path}: {container}, {bytes} bytes{fetched}, checksums: {}", file.crc)?;
    }
    for note in notes {
        writeln!(
            out,
            "note: {}: {}",
            sanitize_display(note.path.display()),
            sanitize_display(&note.note)
        )?;
    }
    let duration = duration_s.map_or(String::new(), |duration_s| format!("{duration_s:.1} s, "));
    writeln!(out, "{duration}{messages} messages")?;
    for robot in &report.robots {
        let joints = robot.joints.join(", ");
        let (name, base, tip, source) = (&robot.name, &robot.base, &robot.tip, &robot.source);
        let line = format!("{name}, {base} → {tip}, from {source}: {joints}");
        writeln!(out, "{}", sanitize_display(line))?;
    }
    for row in &report.comparisons {
        let line = format!("{} compared with {}: {}", row.topic, row.reference, row.reason);
        writeln!(out, "{}", sanitize_display(line))?;
    }
    writeln!(out, "\n{}", stream_table(&report.streams).trim_fmt())?;
    report.log.tables.iter().try_for_each(|table| write_columns(table, out))
}

/// The meaning of each column of a table, and the option that states it.
fn write_columns(table: &TableRow, out: &mut dyn Write) -> io::Result<()> {
    let path = sanitize_display(table.path.display()).to_string();
    writeln!(out, "\n{path}: {} columns", table.width)?;
    let mut rows = output::table(["column", "name", "read as"]);
    for column in &table.columns {
        let cells = [&column.numbers, &column.names, &column.read_as];
        rows.add_row(cells.map(|cell| sanitize(cell).into_owned()));
    }
    writeln!(out, "{}", rows.trim_fmt())?;
    let Some(layout) = &table.layout else { return Ok(()) };
    let layout = format!("--columns '{layout}'");
    // The notes explain why it is only a proposal.
    let line = match &table.layout_reason {
        None => layout,
        Some(_) => format!("proposal: {layout}"),
    };
    writeln!(out, "{}", sanitize_display(line))
}

fn stream_table(streams: &[StreamRow]) -> Table {
    const COUNT_COLUMN: usize = 5;
    const SPAN_COLUMN: usize = 7;
    let header = ["topic", "type", "frames", "role", "source", "count", "Hz", "span s", "why"];
    let mut table = output::table(header);
    for stream in streams {
        table.add_row(
            [
                stream.topic.clone(),
                stream.type_name.clone(),
                frames(stream),
                stream.role.to_owned(),
                stream.source_kind.unwrap_or_default().to_owned(),
                stream.count.to_string(),
                stream.rate_hz.map_or(String::new(), |rate_hz| format!("{rate_hz:.1}")),
                span_s(stream).map_or(String::new(), |span_s| format!("{span_s:.1}")),
                stream.reason.clone(),
            ]
            .map(|cell| sanitize(&cell).into_owned()),
        );
    }
    for number in COUNT_COLUMN..=SPAN_COLUMN {
        if let Some(column) = table.column_mut(number) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

/// `parent → child`, as named in messages.
fn frames(stream: &StreamRow) -> String {
    match (&stream.frame_id, &stream.child_frame_id) {
        (Some(parent), Some(child)) => format!("{parent} → {child}"),
        (Some(frame), None) | (None, Some(frame)) => frame.clone(),
        (None, None) => String::new(),
    }
}

fn span_s(stream: &StreamRow) -> Option<f64> {
    let (start, end) = (stream.start_ns?, stream.end_ns?);
    Some(seconds(end.nanos().saturating_sub(start.nanos())))
}
