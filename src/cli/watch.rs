//! `poseaudit watch`.

mod recording_sink;
mod watched_log;

use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, SystemTime};

use clap::ValueEnum;
use poseaudit::log::{HEAD_BYTES, looks_like_log};
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;
use walkdir::WalkDir;

use self::recording_sink::RecordingSink;
use self::watched_log::{WatchSettings, WatchedLog};
use super::audit_options::{AuditOptions, positive_seconds};
use super::output::Format;
use super::{Outcome, messages, misuse};

/// Interval between checks for new data.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Audit a log while it is recorded, and once more when it has ended; prints a line when the verdict
/// changes
///
/// An MCAP file is read incrementally while it is written, and once as a whole at its end. Other logs are
/// read as a whole for each audit. Exit status: as for `audit`, by the last verdict.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit watch run.mcap
  poseaudit watch run.mcap --until fail --robot ur5e
  poseaudit watch ~/bags --every 5 --format json
  poseaudit watch run.mcap --rrd-connect")]
pub struct Args {
    /// A log that is being written, or a folder: its most recently written log
    #[arg(value_name = "FOLDER|LOG")]
    path: PathBuf,

    #[command(flatten)]
    audit_options: AuditOptions,

    /// Exit at the verdict FAIL, or when the log has ended (always the case for a LOG); repeatable
    #[arg(long, value_enum, value_delimiter = ',')]
    until: Vec<Until>,

    /// Minimum interval between two audits, seconds
    #[arg(long, value_name = "S", default_value = "2", value_parser = positive_seconds)]
    every: f64,

    /// Idle time after which an unclosed log has ended, seconds
    #[arg(long, value_name = "S", default_value = "10", value_parser = positive_seconds)]
    idle: f64,

    /// Write a Rerun recording with each printed audit
    #[arg(long, value_name = "FILE")]
    rrd: Option<PathBuf>,

    /// Show these recordings in the Rerun viewer that listens on this local port, or in a new one
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "9876", conflicts_with = "rrd")]
    rrd_connect: Option<u16>,

    /// Format of a line: text, or a JSON object
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Until {
    /// The verdict is FAIL
    Fail,
    /// The log has ended
    End,
}

pub fn run(mut args: Args) -> Result<Outcome, Trouble> {
    if !args.path.exists() {
        let remedy = "start the watch after the recorder";
        return Err(misuse(args.path.display(), "no such file or folder", remedy));
    }
    let mut places = PathRegistry::default();
    places.add_log(&args.path);
    args.rrd.iter().for_each(|path| places.add_output("--rrd", path));
    places.check()?;
    args.audit_options.find_config(std::slice::from_ref(&args.path))?;
    let options = args.audit_options.clone().into_options()?;
    let pace = WatchSettings {
        min_interval: Duration::from_secs_f64(args.every),
        idle: Duration::from_secs_f64(args.idle),
        format: args.format,
    };
    let mut sink = RecordingSink::new(args.rrd, args.rrd_connect)?;
    let is_folder = args.path.is_dir();
    let ends_with_log = !is_folder || args.until.contains(&Until::End);
    let until_fail = args.until.contains(&Until::Fail);
    let is_over = |log: &WatchedLog| {
        (until_fail && log.outcome() == Outcome::Findings) || (ends_with_log && log.has_ended())
    };
    let mut current: Option<WatchedLog> = None;
    let idle_s = ends_with_log.then_some(args.idle);
    messages::print_waiting(&waiting_text(&args.path, until_fail, idle_s));
    loop {
        if let Some(newest) = newest_log(&args.path)
            && current.as_ref().is_none_or(|current| *current.path() != newest)
        {
            // A newer log ends the previous one.
            if let Some(before) = &mut current {
                before.finish(&mut sink)?;
                if is_over(before) {
                    return Ok(before.outcome());
                }
            }
            current = Some(WatchedLog::new(newest, &options, pace));
        }
        if let Some(current) = &mut current {
            current.poll(&mut sink)?;
            if is_over(current) {
                return Ok(current.outcome());
            }
        }
        thread::sleep(POLL_INTERVAL);
    }
}

/// Message about the expected data and the end of the watch.
fn waiting_text(path: &Path, ends_at_fail: bool, idle_s: Option<f64>) -> String {
    let what = if path.is_dir() { "a log in" } else { "data in" };
    let fail = ends_at_fail.then(|| "at the verdict FAIL".to_owned());
    let idle = idle_s.map(|idle_s| format!("{idle_s} s after the last write"));
    let ends: Vec<String> =
        [fail, idle, Some("with Ctrl-C".to_owned())].into_iter().flatten().collect();
    format!("for {what} {}; ends {}", path.display(), ends.join(", or "))
}

/// The path, or the most recently written log in it.
fn newest_log(path: &Path) -> Option<PathBuf> {
    /// Recorders create one folder per run.
    const MAX_DEPTH: usize = 3;
    if !path.is_dir() {
        return Some(path.to_owned());
    }
    let files = WalkDir::new(path).max_depth(MAX_DEPTH).into_iter().flatten();
    let dated = files.filter(|entry| entry.file_type().is_file()).filter_map(|entry| {
        let written: SystemTime = entry.metadata().ok()?.modified().ok()?;
        Some((written, entry.into_path()))
    });
    let mut dated: Vec<_> = dated.collect();
    dated.sort();
    dated.into_iter().rev().map(|(_, path)| path).find(|path| is_log(path))
}

fn is_log(path: &Path) -> bool {
    use std::io::Read;
    let mut head = Vec::new();
    let file = std::fs::File::open(path);
    let read = file.and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    read.is_ok() && looks_like_log(&head)
}
