//! `poseaudit init`.

use std::path::PathBuf;

use poseaudit::Options;
use poseaudit::config;
use poseaudit::log::{FileLayout, ReadOptions};
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;

use super::audit_options::use_columns;
use super::progress::with_progress;
use super::{Outcome, misuse, output};

/// Generate a config from a log: the settings that differ from the defaults, or every key with --all
///
/// Use it with `poseaudit audit LOG --config FILE`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit init run.mcap --output poseaudit.toml
  poseaudit init run.mcap --all
  poseaudit init --schema --output poseaudit.schema.json")]
pub struct Args {
    /// The log, or its URL (s3://, gs://, az://, https://); several files of one run are merged
    #[arg(value_name = "LOG", required_unless_present = "schema")]
    logs: Vec<PathBuf>,

    /// Write to this new file instead of stdout
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Meaning of every column of a table without names, as for `audit`
    #[arg(long, value_name = "[FILE=]SPEC", conflicts_with = "schema")]
    columns: Vec<FileLayout>,

    /// Also list all other keys as comments, with their defaults
    #[arg(long, conflicts_with = "schema")]
    all: bool,

    /// Write the JSON schema of the config instead, for editors
    #[arg(long, conflicts_with = "logs")]
    schema: bool,
}

pub fn run(args: Args) -> Result<Outcome, Trouble> {
    let Args { logs, output, columns, all, schema } = args;
    if let Some(path) = output.as_ref().filter(|path| path.symlink_metadata().is_ok()) {
        let what = "exists already and is not overwritten";
        return Err(misuse(path.display(), what, "name another --output, or move it"));
    }
    let mut places = PathRegistry::default();
    logs.iter().for_each(|log| places.add_log(log));
    output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places.check()?;
    if schema {
        output::emit(output.as_deref(), |out| out.write_all(config::schema().as_bytes()))?;
        return Ok(Outcome::Clean);
    }
    let audited = with_progress(|progress| {
        let read = ReadOptions { progress: Some(progress), ..ReadOptions::default() };
        let mut options = Options { logs, read, ..Options::default() };
        use_columns(&mut options, columns);
        poseaudit::audit(&options)
    })?;
    let report = audited.into_report();
    output::emit(output.as_deref(), |out| {
        out.write_all(config::template(&report, all).as_bytes())
    })?;
    report.error.map_or(Ok(Outcome::Clean), Err)
}
