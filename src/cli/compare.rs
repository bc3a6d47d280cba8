//! `poseaudit compare`.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use poseaudit::Options;
use poseaudit::compare::{compare, markdown, text};
use poseaudit::log::{self, LogError, ReadOptions};
use poseaudit::report::{Report, Trouble, TroubleKind, Verdict};

use super::audit_options::AuditOptions;
use super::progress::with_progress;
use super::{Outcome, output};

/// Compare two reports or logs, or a log with its baseline: new, fixed and worse findings
///
/// A log is audited first, with the options of `audit`. Exit status: 0 no regression; 1 a new or larger
/// finding at or above --fail-on, a pass that was lost, a log that can no longer be audited or, with
/// --fail-on inconclusive, an inconclusive new verdict; 2 invalid call.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit compare baseline.json today.json
  poseaudit compare baseline.json run.mcap --fail-on error
  poseaudit compare monday.mcap tuesday.mcap --robot my_arm.urdf --select ZER,LAT
  poseaudit compare baseline.json run.mcap --format markdown -o comment.md")]
pub struct Args {
    /// The baseline: a report written by --write-baseline or --format json, or a log
    #[arg(value_name = "OLD")]
    old: PathBuf,

    /// The report or log to compare with it
    #[arg(value_name = "NEW")]
    new: PathBuf,

    #[command(flatten)]
    audit_options: AuditOptions,

    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,

    /// Write to this file instead of stdout
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    Text,
    /// For programs, in SI units
    Json,
    /// For a comment on a pull request
    Markdown,
}

pub fn run(mut args: Args) -> Result<Outcome, Trouble> {
    let sides = [&args.old, &args.new];
    let logs: Vec<&PathBuf> = sides.into_iter().filter(|path| !is_json(path)).collect();
    args.audit_options.find_config(&logs)?;
    let mut places = args.audit_options.options_without_config().places();
    sides.into_iter().for_each(|path| places.add_log(path));
    args.output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places.check()?;
    let options = args.audit_options.into_options()?;
    let (old, new) = (
        load_report(&args.old, Side::Old, &options)?,
        load_report(&args.new, Side::New, &options)?,
    );
    let comparison = compare(&old, &new, options.policy.fail_on);
    output::emit(args.output.as_deref(), |out| match args.format {
        Format::Text => text(&comparison, out),
        Format::Markdown => markdown(&comparison, out),
        Format::Json => output::write_json(out, &comparison),
    })?;
    let is_open = options.policy.fail_on_inconclusive && new.verdict == Verdict::Inconclusive;
    Ok(if comparison.regression || is_open { Outcome::Findings } else { Outcome::Clean })
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Old,
    New,
}

/// The report at `path`, or of that log. A new log that cannot be audited yields a report that is worse
/// than any baseline.
fn load_report(path: &Path, side: Side, options: &Options) -> Result<Report, Trouble> {
    if is_json(path) {
        return Report::from_file(path);
    }
    let audited = with_progress(|progress| {
        let read = ReadOptions { progress: Some(progress), ..options.read.clone() };
        poseaudit::audit(&Options { logs: vec![path.to_owned()], read, ..options.clone() })
    });
    match audited {
        Err(trouble) if side == Side::New && trouble.kind == TroubleKind::Log && is_log(path) => {
            Ok(Report::from_trouble(trouble))
        }
        // An unreadable OLD cannot be a baseline, and other files are invalid calls.
        Err(trouble) => Err(Trouble { kind: TroubleKind::Call, ..trouble }),
        Ok(audited) => Ok(audited.into_report()),
    }
}

/// Whether the file is a log, possibly damaged.
fn is_log(path: &Path) -> bool {
    let opened = log::open(&[path.to_owned()], &ReadOptions::default());
    !matches!(opened, Err(LogError::NotALog { .. } | LogError::Unsupported { .. }))
}

/// Whether the first character opens a JSON object.
fn is_json(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(64).read_to_end(&mut head));
    let first = head.iter().find(|byte| !byte.is_ascii_whitespace());
    read.is_ok() && first == Some(&b'{')
}
