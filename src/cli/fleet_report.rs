//! `poseaudit fleet report`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use poseaudit::checks::Selector;
use poseaudit::config::FailOn;
use poseaudit::fleet::report::{
    Day, FleetReport, Question, write_html, write_markdown, write_text,
};
use poseaudit::fleet::{Store, Template};
use poseaudit::log;
use poseaudit::places::Places;
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};

/// Say what the logs of a fleet tell together: which arms fail which rules, and what moves over time
///
/// Exit status: 0 nothing at or above --fail-on; 1 a finding that is, a log that could not be audited, or
/// an amount that creeps or steps, which counts as a warning; 2 the call is wrong.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit fleet report results
  poseaudit fleet report results --format html --output fleet.html
  poseaudit fleet report results --select ZER --since 2026-05-01 --fail-on error")]
pub struct Args {
    /// The folder that `poseaudit fleet --out` wrote
    #[arg(value_name = "DIR")]
    folder: PathBuf,

    /// How it is printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,

    /// Write it to this file instead of stdout
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,

    /// Exit with 1 from findings of this severity, or also where a verdict is open
    #[arg(long, value_enum, value_name = "SEVERITY", default_value = "warning")]
    fail_on: FailOn,

    /// Findings of logs from before this day, in UTC, do not count; trends see all logs
    #[arg(long, value_name = "YYYY-MM-DD")]
    since: Option<Day>,

    /// Only these rules: codes, or the letters a family begins with
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    select: Vec<Selector>,

    /// What the ends of paths say logs are of, as in {site}/{arm}/*, in place of their labels
    #[arg(long, value_name = "TEMPLATE")]
    labels_from: Option<Template>,

    /// Hash of the settings whose results are wanted [default: the latest]
    #[arg(long, value_name = "HASH")]
    settings: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    Text,
    /// For programs, in SI units
    Json,
    /// For people: one page with its plots, which opens in any browser
    Html,
    /// For the page of a dataset
    Markdown,
}

pub fn run(args: Args) -> Result<Outcome, Trouble> {
    let mut places = Places::default();
    Store::folders(&args.folder).iter().for_each(|folder| places.keeps("DIR", folder));
    places.reads_results(&args.folder);
    if log::is_dataset(&args.folder) || log::is_store(&args.folder) {
        places.reads_log(&args.folder);
    }
    args.output.iter().for_each(|path| places.writes(output::OUTPUT, path));
    places.check()?;
    let Some(store) = Store::open(&args.folder) else {
        let place = args.folder.display().to_string();
        let what = "there are no results of a fleet in it";
        return Err(misuse(place, what, "name the folder that `poseaudit fleet --out` wrote"));
    };
    let question = Question {
        fail_on: args.fail_on.into(),
        fails_open: args.fail_on == FailOn::Inconclusive,
        since_ns: args.since.map(Day::start_ns),
        template: args.labels_from,
        settings: args.settings,
        select: args.select,
    };
    let report = FleetReport::of(&store, &question)?;
    // Of stdout nobody knows where it leads.
    let report = match args.output.as_deref().map(|path| path.parent()) {
        Some(Some(folder)) if !folder.as_os_str().is_empty() => report.linked_from(folder),
        Some(_) => report.linked_from(Path::new(".")),
        None => report,
    };
    output::emit(args.output.as_deref(), |out| match args.format {
        Format::Text => write_text(&report, out),
        Format::Html => write_html(&report, out),
        Format::Markdown => write_markdown(&report, out),
        Format::Json => {
            serde_json::to_writer_pretty(&mut *out, &report)?;
            writeln!(out)
        }
    })?;
    Ok(if report.failing { Outcome::Findings } else { Outcome::Clean })
}
