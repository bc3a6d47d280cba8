//! `poseaudit audit`.

use std::path::PathBuf;

use clap::ValueEnum;
use poseaudit::checks::{Selector, Settings};
use poseaudit::config::Config;
use poseaudit::finding::Severity;
use poseaudit::replay::Recording;
use poseaudit::report::{Report, Trouble};
use poseaudit::run::{CalibrationSource, Declaration, RobotSource};
use poseaudit::time::Clock;

use super::progress::watched;
use super::{Outcome, misuse, output, reports, view};

/// Audit one recorded run: what is wrong with its poses, by how much, and how sure that is
///
/// Exit status: 0 nothing at or above --fail-on; 1 a finding, or a rule of --require that could not
/// conclude; 2 the call is wrong; 3 the log cannot be audited.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit audit run.mcap
  poseaudit audit run.mcap --robot my_arm.urdf --tip tool0 --fail-on error
  poseaudit audit run.mcap --format json --format sarif --format junit --output reports
  poseaudit audit run.mcap --fix mend
  poseaudit audit run.mcap --rrd run.rrd --mesh-root ~/ws/install/ur_description/share
  poseaudit audit run_0.mcap run_1.mcap --select LAT,ZER001 --require LAT001")]
pub struct Args {
    /// The log; several files of one run are merged
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,

    /// The robot's URDF or DH table, or its name in the catalogue; PREFIX=FILE with several arms
    #[arg(long = "robot", value_name = "FILE|NAME")]
    robots: Vec<RobotSource>,

    /// A UR's calibration, as ur_calibration extracts it; PREFIX=FILE with several arms
    #[arg(long = "calibration", value_name = "FILE")]
    calibrations: Vec<CalibrationSource>,

    /// Link that the chain begins at
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// Link that the chain ends at, and whose poses the streams are
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// The settings of an audit: robot, topics, figures of rules, what is known and to be ignored
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    #[command(flatten)]
    reports: reports::Reports,

    /// Write a Rerun recording of the run
    #[arg(long, value_name = "FILE")]
    rrd: Option<PathBuf>,

    /// Open the recording in the Rerun viewer, which must be on the path
    #[arg(long)]
    view: bool,

    /// Folder that the meshes of the robot's URDF are sought below, for the recording; repeatable
    #[arg(long = "mesh-root", value_name = "DIR")]
    mesh_roots: Vec<PathBuf>,

    /// Write tables as Parquet into this folder: aligned samples, reach map, findings, checks
    #[arg(long, value_name = "DIR")]
    parquet: Option<PathBuf>,
    /// Write what mends the findings into this folder: offsets, latencies, code, frames, a patched model
    #[arg(long, value_name = "DIR")]
    fix: Option<PathBuf>,

    /// Apply the corrections.toml that --fix wrote to the streams, then audit
    #[arg(long, value_name = "FILE", conflicts_with = "fix")]
    corrections: Option<PathBuf>,

    /// Ask only these rules: codes, or the letters a family begins with
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    select: Vec<Selector>,

    /// Do not ask these rules
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    ignore: Vec<Selector>,

    /// Exit with 1 from findings of this severity [default: warning]
    #[arg(long, value_enum, value_name = "SEVERITY")]
    fail_on: Option<FailOn>,

    /// Exit with 1 also where one of these rules cannot conclude
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    require: Vec<Selector>,

    /// The time that places a sample; streams without header stamps fall back to log time [default:
    /// header]
    #[arg(long, value_enum, value_name = "CLOCK")]
    stamp: Option<StampSource>,

    /// Largest latency in seconds; what is off by more is on another clock [default: 5]
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    max_latency: Option<f64>,

    /// Check every checksum in the files
    #[arg(long)]
    verify: bool,

    /// How a stream is coded: rotvec, euler:SEQ, quat:xyzw, quat:wxyz, or a maker such as kuka
    #[arg(long, value_name = "TOPIC=CONVENTION[,deg][,mm]")]
    declare: Vec<Declaration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOn {
    /// Errors
    Error,
    /// Warnings and errors
    Warning,
    /// Nothing
    Never,
}

impl From<FailOn> for Option<Severity> {
    fn from(fail_on: FailOn) -> Self {
        match fail_on {
            FailOn::Error => Some(Severity::Error),
            FailOn::Warning => Some(Severity::Warning),
            FailOn::Never => None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StampSource {
    /// The stamp in the message's header
    Header,
    /// When the recorder received the message
    Log,
    /// When the sender published the message
    Publish,
}

impl From<StampSource> for Clock {
    fn from(source: StampSource) -> Self {
        match source {
            StampSource::Header => Clock::Header,
            StampSource::Log => Clock::Log,
            StampSource::Publish => Clock::Publish,
        }
    }
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a number of seconds above 0".to_owned()),
    }
}

/// What the config says of an audit, and before it the command line; and the rules that must conclude.
fn configured(args: Args) -> Result<(poseaudit::Options, Vec<Selector>), Trouble> {
    let config = args.config.as_deref().map(Config::from_file).transpose()?;
    let required = config.as_ref().map(Config::required).unwrap_or_default();
    let by_config = config.as_ref().map(Config::options).unwrap_or_default();
    let rules = Settings {
        select: first(args.select, by_config.rules.select),
        ignore: args.ignore,
        ..by_config.rules
    };
    // A declaration is of one topic: what the config says of others stands.
    let is_other = |of: &Declaration| !args.declare.iter().any(|said| said.is_of(&of.topic));
    let others = by_config.declarations.into_iter().filter(is_other);
    let declarations = args.declare.iter().cloned().chain(others).collect();
    let options = poseaudit::Options {
        logs: args.logs,
        robots: first(args.robots, by_config.robots),
        calibrations: first(args.calibrations, by_config.calibrations),
        base: args.base.or(by_config.base),
        tip: args.tip.or(by_config.tip),
        stamp: args.stamp.map_or(by_config.stamp, Into::into),
        max_latency_s: args.max_latency.unwrap_or(by_config.max_latency_s),
        verify: args.verify,
        declarations,
        corrections: args.corrections,
        fix: args.fix,
        rules,
        fail_on: args.fail_on.map_or(by_config.fail_on, Into::into),
        recording: args.rrd.map(|path| Recording {
            path,
            mesh_roots: args.mesh_roots,
            ..Recording::default()
        }),
        tables: args.parquet,
        figures: args.reports.are_pictured(),
        ..by_config
    };
    Ok((options, first(args.require, required)))
}

/// What was given, else `other`.
fn first<T>(given: Vec<T>, other: Vec<T>) -> Vec<T> {
    if given.is_empty() { other } else { given }
}

/// Whether the folders of meshes are there, and there is a recording to draw them in.
fn meshes_can_be_drawn(args: &Args) -> Result<(), Trouble> {
    if let Some(missing) = args.mesh_roots.iter().find(|root| !root.is_dir()) {
        let place = missing.display().to_string();
        let what = if missing.exists() { "no folder" } else { "no such folder" };
        return Err(misuse(place, what, "name the folder of the robot's meshes with --mesh-root"));
    }
    if !args.mesh_roots.is_empty() && args.rrd.is_none() && !args.view {
        let what = "only a recording shows meshes";
        return Err(misuse("--mesh-root", what, "ask for one with --rrd FILE or --view"));
    }
    Ok(())
}

pub fn run(mut args: Args) -> Result<Outcome, Trouble> {
    let reports = args.reports.clone();
    reports.can_be_followed()?;
    meshes_can_be_drawn(&args)?;
    let viewer = args.view.then(view::viewer).transpose()?;
    if viewer.is_some() {
        args.rrd.get_or_insert_with(view::place);
    }
    let recording = args.rrd.clone();
    let configured = configured(args);
    let audited = configured.and_then(|(options, require)| {
        let report = watched(|progress| {
            poseaudit::audit(&poseaudit::Options { progress: Some(progress), ..options })
        });
        Ok((report?, require))
    });
    let (report, require) = match audited {
        Ok(audited) => audited,
        Err(trouble) if reports.tell_trouble() => (Report::of_trouble(trouble), Vec::new()),
        Err(trouble) => return Err(trouble),
    };
    reports.emit(&report)?;
    if let Some(trouble) = &report.error {
        output::error(trouble);
    }
    if let (Some(viewer), Some(recording), None) = (&viewer, &recording, &report.error) {
        view::open(viewer, recording)?;
    }
    let outcome = Outcome::from(&report);
    let open = report.not_concluded(&require);
    if outcome == Outcome::Clean && !open.is_empty() {
        output::error(format_args!("--require {}: could not conclude", open.join(",")));
        return Ok(Outcome::Findings);
    }
    Ok(outcome)
}
