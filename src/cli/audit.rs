//! `poseaudit audit`.

use std::path::PathBuf;

use poseaudit::checks::Selector;
use poseaudit::diagnosis::full_fit_count;
use poseaudit::output::replay::{BaseRecording, Recording};
use poseaudit::output::{fix, foxglove, plotjuggler, tables, tum};
use poseaudit::report::{Format, Report, Trouble};
use poseaudit::{Audited, Options};

use super::audit_options::{AuditOptions, first_non_empty};
use super::progress::with_progress;
use super::{Outcome, messages, misuse, output, reports, statistics, view};

const BASELINE_OPTION: &str = "--write-baseline";

/// Audit one recorded run: find wrong poses, timestamps and conventions, with size and uncertainty
///
/// Exit status: 0 nothing at or above --fail-on; 1 a finding, an inconclusive rule of --require, or, with
/// --fail-on inconclusive, an inconclusive verdict; 2 invalid call; 3 the log cannot be audited; 70
/// internal error.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit audit run.mcap
  poseaudit audit run.mcap --robot my_arm.urdf --tip tool0 --fail-on error
  poseaudit audit run.mcap --format json --format sarif --format junit --output reports
  poseaudit audit run.mcap --fix corrections
  poseaudit audit run.mcap --write-baseline baseline.json
  poseaudit audit run.mcap --config auto --statistics -q
  poseaudit audit run.mcap --rrd run.rrd --mesh-root ~/ws/install/ur_description/share
  poseaudit audit s3://bucket/cell7/run.mcap
  poseaudit audit run_0.mcap run_1.mcap --select LAT,ZER001 --require LAT001")]
pub struct Args {
    /// The log, or its URL (s3://, gs://, az://, https://); several files of one run are merged
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,

    #[command(flatten)]
    audit_options: AuditOptions,

    #[command(flatten)]
    reports: reports::ReportOptions,

    /// Write a Rerun recording of the run
    #[arg(long, value_name = "FILE")]
    rrd: Option<PathBuf>,

    /// Write the recording as a layer of this Rerun recording of the log: the viewer shows both as one
    #[arg(long, value_name = "RRD")]
    rrd_layer: Option<PathBuf>,

    /// Of --rrd-layer
    #[arg(skip)]
    base_recording: Option<BaseRecording>,

    /// Write findings and errors as messages for Foxglove, to open together with the log, and a layout
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,

    /// Write errors, corrected errors and limits as CSV for PlotJuggler, and a layout
    #[arg(long, value_name = "FILE")]
    plotjuggler: Option<PathBuf>,

    /// Open the recording in the Rerun viewer, which must be on the PATH
    #[arg(long)]
    view: bool,

    /// Folder with the meshes of the robot's URDF, for the recording; repeatable
    #[arg(long = "mesh-root", value_name = "DIR")]
    mesh_roots: Vec<PathBuf>,

    /// Write tables as Parquet into this folder: aligned samples, reach map, findings, checks
    #[arg(long, value_name = "DIR")]
    parquet: Option<PathBuf>,

    /// Write the aligned poses of each stream, and of its reference at the same times, as TUM trajectories into
    /// this folder, for example for evo
    #[arg(long, value_name = "DIR")]
    tum: Option<PathBuf>,

    /// Write corrections (offsets, latencies, frames, code, patched URDF) into this folder
    #[arg(long, value_name = "DIR")]
    fix: Option<PathBuf>,

    /// Apply a corrections.toml written by --fix to the streams, then audit
    #[arg(long, value_name = "FILE", conflicts_with = "fix")]
    corrections: Option<PathBuf>,

    /// Also write the report as JSON to this file: a baseline for `compare`
    #[arg(long, value_name = "FILE")]
    write_baseline: Option<PathBuf>,

    /// Print the number of findings per rule instead of the report
    #[arg(long)]
    statistics: bool,

    /// Fail if one of these rules is inconclusive
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    require: Vec<Selector>,
}

/// The options, checked so that no output overwrites an input.
fn check_options(args: &Args, options: Options) -> Result<Options, Trouble> {
    let options =
        Options { logs: args.logs.clone(), corrections: args.corrections.clone(), ..options };
    let mut places = options.places();
    if let Some(recording) = args.recording() {
        recording.register_outputs(&mut places);
    }
    if let Some(path) = &args.mcap {
        foxglove::register_outputs(path, &mut places);
    }
    if let Some(path) = &args.plotjuggler {
        plotjuggler::register_outputs(path, &mut places);
    }
    if let Some(folder) = &args.parquet {
        tables::register_outputs(folder, &mut places);
    }
    if let Some(folder) = &args.tum {
        tum::register_outputs(folder, &mut places);
    }
    if let Some(folder) = &args.fix {
        fix::register_outputs(folder, &options.run.robots, &mut places);
    }
    args.write_baseline.iter().for_each(|path| places.add_output(BASELINE_OPTION, path));
    args.reports.register_outputs(&mut places);
    places.check()?;
    Ok(options)
}

impl Args {
    fn recording(&self) -> Option<Recording> {
        let (path, mesh_roots) = (self.rrd.clone()?, self.mesh_roots.clone());
        let recording = Recording { path, mesh_roots, ..Recording::default() };
        Some(match (&self.rrd_layer, &self.base_recording) {
            (Some(path), Some(base)) => recording.with_base(path.clone(), base),
            _ => recording,
        })
    }

    /// Returns the outputs that failed.
    fn write_outputs(&self, audited: &mut Audited) -> Vec<Trouble> {
        let recorded = self.rrd.as_deref().zip(self.recording());
        let recorded = recorded.map(|(path, recording)| (path, audited.record(&recording)));
        let messages = self.mcap.as_deref().map(|path| (path, audited.write_foxglove(path)));
        let plots = self.plotjuggler.as_deref();
        let plots = plots.map(|path| (path, audited.write_plotjuggler(path)));
        let tables = self.parquet.as_deref().map(|folder| (folder, audited.write_tables(folder)));
        let trajectories = self.tum.as_deref().map(|folder| (folder, audited.write_tum(folder)));
        let fixes = self.fix.as_deref().map(|folder| (folder, audited.write_fixes(folder)));
        let outputs =
            [recorded, messages, plots, tables, trajectories, fixes].into_iter().flatten();
        let unwritten =
            outputs.filter_map(|(path, done)| done.map(|()| messages::print_written(path)).err());
        unwritten.collect()
    }

    fn emit(&self, report: &Report) -> Result<(), Trouble> {
        let written = match self.statistics {
            true => statistics::emit(report, &self.reports),
            false => self.reports.emit(report),
        };
        let baseline_written = match (&self.write_baseline, Format::from_name("json")) {
            (Some(path), _) if report.error.is_some() => {
                let what = "not written: a log that could not be audited cannot be a baseline";
                Err(misuse(path.display(), what, "see the error of the audit"))
            }
            (Some(path), Some(format)) => reports::emit(format, report, Some(path)),
            _ => Ok(()),
        };
        // One error does not prevent the other.
        written.and(baseline_written)
    }
}

/// Mesh folders must exist, and a recording must be written.
fn check_mesh_roots(args: &Args) -> Result<(), Trouble> {
    if let Some(missing) = args.mesh_roots.iter().find(|root| !root.is_dir()) {
        let what = if missing.exists() { "not a folder" } else { "no such folder" };
        let remedy = "name the folder of the robot's meshes with --mesh-root";
        return Err(misuse(missing.display(), what, remedy));
    }
    if !args.mesh_roots.is_empty() && args.rrd.is_none() && !args.view {
        let what = "meshes are only used in a recording";
        return Err(misuse("--mesh-root", what, "add --rrd FILE or --view"));
    }
    Ok(())
}

/// The recording must be one of a log, and a layer must be written.
fn read_base(args: &Args) -> Result<Option<BaseRecording>, Trouble> {
    let Some(path) = &args.rrd_layer else { return Ok(None) };
    if args.rrd.is_none() && !args.view {
        return Err(misuse("--rrd-layer", "no recording is written", "add --rrd FILE or --view"));
    }
    let remedy = "name a recording of the log, such as one that `rerun mcap convert` wrote";
    let base = BaseRecording::read(path).map_err(|error| misuse(path.display(), error, remedy))?;
    if base.shared_timeline().is_none() {
        let names = base.timelines.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
        return Err(misuse(
            path.display(),
            format!("its timelines are not those of a log: {names}"),
            remedy,
        ));
    }
    Ok(Some(base))
}

pub fn run(mut args: Args) -> Result<Outcome, Trouble> {
    args.reports.check_destination()?;
    if args.statistics {
        statistics::check_format(&args.reports)?;
    }
    args.audit_options.find_config(&args.logs)?;
    check_mesh_roots(&args)?;
    args.base_recording = read_base(&args)?;
    // Before reading the config: an error report must not overwrite a file.
    check_options(&args, args.audit_options.options_without_config())?;
    let viewer = args.view.then(|| view::find_viewer(view::VIEW_OPTION)).transpose()?;
    if viewer.is_some() && args.rrd.is_none() {
        args.rrd = Some(view::create_recording_file()?);
    }
    let audited = match args.audit_options.clone().into_options() {
        Err(trouble) => Err(trouble),
        Ok(options) => {
            let mut options = check_options(&args, options)?;
            let rules = &mut options.policy.rules;
            rules.required =
                first_non_empty(args.require.clone(), std::mem::take(&mut rules.required));
            let audited = with_progress(|progress| {
                options.read.progress = Some(progress);
                poseaudit::audit(&options)
            });
            messages::print_detail("fits", || format!("{} of the arm", full_fit_count()));
            audited
        }
    };
    let (report, unwritten) = match audited {
        Err(trouble) if !args.reports.has_trouble_format() => return Err(trouble),
        Err(trouble) => (Report::from_trouble(trouble), Vec::new()),
        Ok(audited) => {
            let mut audited = match args.reports.has_plots() {
                true => audited.with_figures(),
                false if args.reports.has_text() => audited.with_error_series(),
                false => audited,
            };
            let unwritten = args.write_outputs(&mut audited);
            (audited.into_report(), unwritten)
        }
    };
    let mut report = report.with_command_line(&call_without_outputs());
    report.is_verbose = messages::is_verbose();
    // Even if another output failed.
    let emitted = args.emit(&report);
    report.error.iter().chain(&unwritten).for_each(output::error);
    emitted?;
    if let Some(trouble) = unwritten.first() {
        return Ok(trouble.kind.into());
    }
    if let (Some(viewer), Some(recording), None) = (&viewer, &args.rrd, &report.error) {
        view::open(viewer, args.rrd_layer.iter().chain([recording]))?;
    }
    let open = report.undecided_requirements();
    let is_shown = args.reports.prints_text() && !args.statistics;
    if report.error.is_none() && !open.is_empty() && !is_shown {
        output::error(format_args!("--require {}: inconclusive", open.join(",")));
    }
    Ok(Outcome::from(&report))
}

/// The call without output options and verbosity.
fn call_without_outputs() -> Vec<String> {
    const OPTIONS_WITH_VALUE: [&str; 12] = [
        "--format", "--output", "-o", "--fix", "--mcap", "--parquet", "--plotjuggler", "--rrd",
        "--rrd-layer", "--tum", BASELINE_OPTION, "--color",
    ];
    const FLAGS: [&str; 6] = ["--view", "--statistics", "-q", "--quiet", "-v", "--verbose"];
    let words = std::env::args_os().skip(1).map(|word| word.display().to_string());
    let words: Vec<String> = words.collect();
    // Words after a final `--` are logs if none is an option.
    let is_plain = |word: &String| word == "--" || !word.starts_with('-');
    let logs =
        words.iter().rposition(|word| word == "--").filter(|&at| words[at..].iter().all(is_plain));
    let words = words.into_iter().enumerate().filter(|(at, _)| Some(*at) != logs);
    let mut words = words.map(|(_, word)| word);
    let mut asked = vec!["poseaudit".to_owned()];
    while let Some(word) = words.next() {
        let option = word.split('=').next().unwrap_or_default();
        let is_joined = word.starts_with("-o") && word.len() > 2;
        if OPTIONS_WITH_VALUE.contains(&word.as_str()) {
            words.next();
        } else if !is_joined && !FLAGS.contains(&option) && !OPTIONS_WITH_VALUE.contains(&option) {
            asked.push(word);
        }
    }
    asked
}
