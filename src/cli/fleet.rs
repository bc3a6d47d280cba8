//! `poseaudit fleet`.

use std::ffi::OsString;
use std::io::{self, Write};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::process;
use std::thread;
use std::time::Duration;

use clap::{Subcommand, ValueEnum};
use poseaudit::Options;
use poseaudit::finding::Severity;
use poseaudit::fleet::{
    AuditSettings, FailureGroup, FleetCall, Identity, Limits, LogSource, Outcomes, Store, Template,
    available_memory_bytes, find_sources, pending, run as audit_all, serve,
};
use poseaudit::log::{SourceName, is_url};
use poseaudit::places::PathRegistry;
use poseaudit::report::{Trouble, quote_for_shell, sanitize};
use serde::Serialize;

use super::audit_options::AuditOptions;
use super::output::Format;
use super::progress::FleetProgressBar;
use super::{Outcome, fleet_report, misuse, output};

/// Default limit per log, at least.
const MIN_MEMORY_BYTES: u64 = 512 << 20;

/// Audit many logs, each in its own process, and store the results as Parquet
///
/// Logs with existing results (same content, version and settings) are skipped, so an interrupted call can
/// be repeated. Exit status: 0 nothing at or above --fail-on in any log; 1 a finding, or a log that could
/// not be audited; 2 invalid call; 3 no log could be audited.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "\
Examples:
  poseaudit fleet runs --out results
  poseaudit fleet \"runs/*/*.mcap\" --out results --labels-from \"{site}/{arm}/*\"
  find /data -name \"*.bag\" | poseaudit fleet - --out results --robot ur5e --timeout 60
  poseaudit fleet report results"
)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,

    /// Logs, folders of logs, quoted patterns, or - for a list on stdin
    #[arg(value_name = "SOURCE", required = true)]
    sources: Vec<String>,

    /// Folder for the results
    #[arg(long, value_name = "DIR", required = true)]
    out: Option<PathBuf>,

    #[command(flatten)]
    audit_options: AuditOptions,

    /// Label for all these logs: site=berlin, arm=cell3, or any other name
    #[arg(long = "label", value_name = "NAME=VALUE", value_parser = parse_label)]
    labels: Vec<(String, String)>,

    /// Template that reads labels from the ends of the paths, such as {site}/{arm}/*
    #[arg(long, value_name = "TEMPLATE")]
    labels_from: Option<Template>,

    /// Number of parallel audits [default: one per core]
    #[arg(long, value_name = "N")]
    jobs: Option<NonZero<usize>>,

    /// Time limit for the audit of one log, seconds
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = super::audit_options::positive_seconds)]
    timeout: f64,

    /// Memory limit for the audit of one log, such as 2GiB [default: its share of the machine's]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    memory: Option<u64>,

    /// Retry logs that exceeded a limit or crashed the audit
    #[arg(long)]
    retry: bool,

    /// Keep the HTML report of each log audited by this call in DIR/pages; the fleet page links to them
    #[arg(long)]
    pages: bool,

    /// List the logs without results, one per line, and audit none: for external schedulers
    #[arg(long)]
    pending: bool,

    /// What identifies a log: its content, or its path, size and modification time, which needs no reading
    #[arg(long, value_enum, value_name = "HOW", default_value_t = IdentityName::Content)]
    identity: IdentityName,

    /// Format of the summary
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,

    /// Write the summary to this file instead of stdout
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,

    /// Audit the logs named on stdin (internal)
    #[arg(long, hide = true)]
    worker: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Report(fleet_report::Args),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum IdentityName {
    /// A hash of the content: copies are the same log
    Content,
    /// Path, size and modification time
    File,
}

impl From<IdentityName> for Identity {
    fn from(by: IdentityName) -> Self {
        match by {
            IdentityName::Content => Identity::Content,
            IdentityName::File => Identity::File,
        }
    }
}

fn parse_label(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected NAME=VALUE, such as site=berlin".to_owned()),
    }
}

/// Bytes, with an optional unit KiB, MiB or GiB (K, M, G).
fn parse_size(text: &str) -> Result<u64, String> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let shift = match text[end..].trim().to_ascii_lowercase().as_str() {
        "" | "b" => Some(0),
        "k" | "kib" => Some(10),
        "m" | "mib" => Some(20),
        "g" | "gib" => Some(30),
        _ => None,
    };
    let bytes = shift.zip(text[..end].parse::<u64>().ok());
    let bytes = bytes.and_then(|(shift, number)| number.checked_mul(1 << shift));
    bytes.filter(|&bytes| bytes > 0).ok_or_else(|| "expected a size such as 2GiB".to_owned())
}

pub fn run(mut args: Args) -> Result<Outcome, Trouble> {
    if let Some(Command::Report(args)) = args.command.take() {
        return fleet_report::run(args);
    }
    args.audit_options.find_config(&args.sources)?;
    let options = args.audit_options.clone().into_options()?;
    let out = args.out.clone().unwrap_or_default();
    if args.worker {
        return run_worker(&options, &Store::create(&out)?, args.pages);
    }
    let sources = find_sources(&args.sources, io::stdin().lock())?;
    register_places(&args, &options, &out, &sources).check()?;
    if args.pending {
        return list_pending(&args, &options, &out, sources);
    }
    let (fail_on, fails_open) = (options.policy.fail_on, options.policy.fail_on_inconclusive);
    let outcomes = audit(&args, &options, &out, sources)?;
    let summary = Summary::new(&out, &outcomes, (fail_on, fails_open));
    output::emit(args.output.as_deref(), |to| match args.format {
        Format::Text => summary.text(to),
        Format::Json => output::write_json(to, &summary),
    })?;
    let logs = outcomes.logs - outcomes.duplicates;
    Ok(match outcomes.count_unaudited() {
        unaudited if unaudited == logs => Outcome::Unusable,
        0 if summary.failing == 0 => Outcome::Clean,
        _ if fail_on.is_none() => Outcome::Clean,
        _ => Outcome::Findings,
    })
}

fn register_places(
    args: &Args,
    options: &Options,
    out: &Path,
    sources: &[LogSource],
) -> PathRegistry {
    let mut places = options.places();
    Store::folders(out).iter().for_each(|folder| places.reserve_folder("--out", folder));
    sources.iter().for_each(|source| places.add_log(&source.path));
    args.output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places
}

fn list_pending(
    args: &Args,
    options: &Options,
    out: &Path,
    sources: Vec<LogSource>,
) -> Result<Outcome, Trouble> {
    let settings = AuditSettings::from_options(options)?;
    let pending = match Store::open(out) {
        Some(store) => pending(sources, &store, &settings, args.identity.into(), args.retry)?,
        None => sources,
    };
    output::emit_unescaped(args.output.as_deref(), |to| {
        for source in &pending {
            match is_url(&source.path) {
                true => write!(to, "{}", SourceName::from_path(&source.path))?,
                // Paths may contain any bytes.
                false => to.write_all(source.path.as_os_str().as_encoded_bytes())?,
            }
            writeln!(to)?;
        }
        Ok(())
    })?;
    Ok(Outcome::Clean)
}

fn audit(
    args: &Args,
    options: &Options,
    out: &Path,
    sources: Vec<LogSource>,
) -> Result<Outcomes, Trouble> {
    let settings = AuditSettings::from_options(options)?;
    let store = Store::create(out)?;
    let jobs = args.jobs.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZero::get);
    let share = || Some((available_memory_bytes()? / jobs as u64).max(MIN_MEMORY_BYTES));
    let limits = Limits {
        time: Some(Duration::from_secs_f64(args.timeout.min(1e9))),
        memory_bytes: args.memory.or_else(share),
    };
    let progress = FleetProgressBar::new(sources.len());
    let outcomes = audit_all(&FleetCall {
        sources,
        store: &store,
        settings: &settings,
        identity: args.identity.into(),
        labels: args.labels.iter().cloned().collect(),
        template: args.labels_from.clone(),
        jobs,
        limits,
        retry: args.retry,
        worker: &worker_command,
        progress: &|course| progress.show(course),
    });
    progress.end();
    outcomes
}

/// This call with `--worker`.
fn worker_command() -> io::Result<process::Command> {
    let mut command = process::Command::new(std::env::current_exe()?);
    // Only global options may precede the command.
    let args: Vec<OsString> = std::env::args_os().skip(1).collect();
    let name = args.iter().position(|word| word == "fleet").map_or(0, |at| at + 1);
    command.args(&args[..name]).arg("--worker").args(&args[name..]);
    Ok(command)
}

fn run_worker(options: &Options, store: &Store, with_pages: bool) -> Result<Outcome, Trouble> {
    serve(options, store, with_pages)
        .map_err(|error| misuse("--worker", error, "this option is internal"))?;
    Ok(Outcome::Clean)
}

#[derive(Serialize)]
struct Summary<'a> {
    schema: &'static str,
    out: String,
    /// With a finding at or above `--fail-on`.
    failing: usize,
    #[serde(flatten)]
    outcomes: &'a Outcomes,
}

const MAX_LISTED_REASONS: usize = 10;

impl<'a> Summary<'a> {
    fn new(out: &Path, outcomes: &'a Outcomes, fail: (Option<Severity>, bool)) -> Self {
        let out = out.display().to_string();
        let failing = outcomes.count_failing(fail.0, fail.1);
        Self { schema: "poseaudit.fleet-run/1", out, failing, outcomes }
    }

    fn text(&self, to: &mut dyn Write) -> io::Result<()> {
        let Outcomes {
            logs, duplicates, done_before, done_now, statuses, verdicts, errors, ..
        } = self.outcomes;
        writeln!(to, "{logs} logs: {done_now} done now, {done_before} before")?;
        if *duplicates > 0 {
            writeln!(to, "{duplicates} are duplicates of another log")?;
        }
        writeln!(
            to,
            "{} audited: {} pass, {} fail, {} inconclusive",
            statuses.audited, verdicts.pass, verdicts.fail, verdicts.inconclusive
        )?;
        let unaudited = [
            (statuses.not_audited, "could not be audited"),
            (statuses.unreadable, "could not be read"),
            (statuses.timed_out, "took too long"),
            (statuses.out_of_memory, "exceeded the memory limit"),
            (statuses.crashed, "crashed the audit"),
        ];
        for (count, how) in unaudited.into_iter().filter(|(count, _)| *count > 0) {
            writeln!(to, "{count} {how}")?;
        }
        let groups = FailureGroup::group(errors);
        for line in groups.iter().take(MAX_LISTED_REASONS).flat_map(FailureGroup::lines) {
            writeln!(to, "  {}", sanitize(&line))?;
        }
        if groups.len() > MAX_LISTED_REASONS {
            writeln!(to, "  and {} other reasons", groups.len() - MAX_LISTED_REASONS)?;
        }
        writeln!(to, "next: poseaudit fleet report {}", quote_for_shell(&self.out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_parse_with_units() {
        assert_eq!(parse_size("2GiB"), Ok(2 << 30));
        assert_eq!(parse_size("512 m"), Ok(512 << 20));
        assert_eq!(parse_size("1000"), Ok(1000));
        for text in ["", "GiB", "0", "-1", "2 TB", "99999999999G"] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }
}
