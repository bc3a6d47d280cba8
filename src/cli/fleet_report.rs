//! `poseaudit fleet report`.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use poseaudit::checks::Selector;
use poseaudit::config::FailOn;
use poseaudit::fleet::report::{
    Day, FleetQuery, FleetReport, write_html, write_markdown, write_text,
};
use poseaudit::fleet::{Store, Template};
use poseaudit::log;
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};

/// Summarise the results of a fleet: which arms fail which rules, and which quantities change over time
///
/// Exit status: 0 nothing at or above --fail-on; 1 a finding, a log that could not be audited, or a
/// quantity with a trend or a step (counts as a warning); 2 invalid call.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit fleet report results
  poseaudit fleet report results --format html --output fleet.html
  poseaudit fleet report results --select ZER --since 2026-05-01 --fail-on error")]
pub struct Args {
    /// The folder written by `poseaudit fleet --out`
    #[arg(value_name = "DIR")]
    folder: PathBuf,

    /// Format of the report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,

    /// Write to this file instead of stdout
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,

    /// Exit with 1 from this severity on; inconclusive: also for an inconclusive verdict
    #[arg(long, value_enum, value_name = "SEVERITY", default_value = "warning")]
    fail_on: FailOn,

    /// Ignore findings of logs before this day (UTC); trends use all logs
    #[arg(long, value_name = "YYYY-MM-DD")]
    since: Option<Day>,

    /// Only these rules: codes or prefixes
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    select: Vec<Selector>,

    /// Template that reads labels from the ends of the paths, such as {site}/{arm}/*, instead of stored
    /// labels
    #[arg(long, value_name = "TEMPLATE")]
    labels_from: Option<Template>,

    /// Settings hash of the results to use [default: the latest]
    #[arg(long, value_name = "HASH")]
    settings: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// For people
    Text,
    /// For programs, in SI units
    Json,
    /// For people: one page with plots, for any browser
    Html,
    /// For a dataset card
    Markdown,
}

pub fn run(args: Args) -> Result<Outcome, Trouble> {
    let mut places = PathRegistry::default();
    Store::folders(&args.folder).iter().for_each(|folder| places.reserve_folder("DIR", folder));
    places.add_results_folder(&args.folder);
    if log::is_dataset(&args.folder) || log::is_store(&args.folder) {
        places.add_log(&args.folder);
    }
    args.output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places.check()?;
    let Some(store) = Store::open(&args.folder) else {
        let what = "no fleet results in this folder";
        let remedy = "name the folder written by `poseaudit fleet --out`";
        return Err(misuse(args.folder.display(), what, remedy));
    };
    let question = FleetQuery {
        fail_on: args.fail_on.into(),
        fails_if_inconclusive: args.fail_on == FailOn::Inconclusive,
        since_ns: args.since.map(Day::start_ns),
        template: args.labels_from,
        settings: args.settings,
        select: args.select,
    };
    let report = FleetReport::build(&store, &question)?;
    // Links need a base folder; stdout has none.
    let report = match args.output.as_deref().map(|path| path.parent()) {
        Some(Some(folder)) if !folder.as_os_str().is_empty() => {
            report.with_links_relative_to(folder)
        }
        Some(_) => report.with_links_relative_to(Path::new(".")),
        None => report,
    };
    output::emit(args.output.as_deref(), |out| match args.format {
        Format::Text => write_text(&report, out),
        Format::Html => write_html(&report, out),
        Format::Markdown => write_markdown(&report, out),
        Format::Json => output::write_json(out, &report),
    })?;
    Ok(if report.failing { Outcome::Findings } else { Outcome::Clean })
}
