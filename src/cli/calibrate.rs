//! `poseaudit calibrate`.

use std::path::PathBuf;

use poseaudit::report::Trouble;
use poseaudit::{Options, calibrate, calibrate_at_fixed_points};

use super::audit_options::AuditOptions;
use super::output::{self, Format};
use super::progress::with_progress;
use super::{Outcome, messages, misuse};

/// Estimate the link parameters of an arm from logs, and write a calibrated model
///
/// Each LOG is a separate run of the same arm. A table of static poses without stamps (CSV with columns for
/// the joints and the measured pose, or one file of each with as many rows) also works, with --robot. Poses
/// of the arm's own controller calibrate the controller's kinematics, poses of a tracker the arm itself.
///
/// With --fixed-point, each LOG is a list of joint positions (CSV, YAML, JSON, with or without names), or a log in
/// which the arm rests in each of them. A point of the tool stays at one unknown place, such as a ball in a socket.
/// This calibrates the arm itself without a sensor.
///
/// Exit status: 0 the files are written, or the arm equals its model and nothing needs to be written; 1 the logs do not determine a calibration, and nothing is written;
/// 2 invalid call; 3 a log cannot be used; 70 internal error.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit calibrate run.mcap --out calibrated
  poseaudit calibrate monday.mcap tuesday.mcap --robot my_arm.urdf --out calibrated
  poseaudit calibrate postures.csv --robot ur10 --tip wrist_3_link --out calibrated --format json
  poseaudit calibrate --fixed-point */hole_?.csv --distance 0.05 --robot panda.urdf --out calibrated")]
pub struct Args {
    /// A log, or its URL (s3://, gs://, az://, https://), or a table of static poses
    #[arg(value_name = "LOG", required = true)]
    logs: Vec<PathBuf>,

    #[command(flatten)]
    audit_options: AuditOptions,

    /// Write robot.urdf, calibration.json and, for a UR, calibration.yaml into this folder
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Write the files even if the arm equals its model
    #[arg(long)]
    force: bool,

    /// Calibrate only with the poses on this topic
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,

    /// In each LOG, one point of the tool stays at one place while the joints take different positions
    #[arg(long, conflicts_with = "topic")]
    fixed_point: bool,

    /// Distance of the points of the two files in a folder, m
    #[arg(long, value_name = "M", requires = "fixed_point", value_parser = distance_m)]
    distance: Option<f64>,

    /// Format of the report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

pub fn run(args: Args) -> Result<Outcome, Trouble> {
    let Args { logs, mut audit_options, out, force, topic, fixed_point, distance, format } = args;
    audit_options.find_config(&logs)?;
    let with = |options: Options| Options { logs: logs.clone(), ..options };
    // Before reading the config, so a file that would be overwritten is reported first.
    let mut places = with(audit_options.options_without_config()).places();
    poseaudit::output::calibration::register_outputs(&out, &mut places);
    places.check()?;
    if out.exists() && !out.is_dir() {
        return Err(misuse(out.display(), "is not a folder", "name a folder with --out"));
    }
    let options = audit_options.into_options()?;
    let options = with(options);
    let found = with_progress(|progress| {
        let mut options = options;
        options.read.progress = Some(progress);
        match fixed_point {
            true => calibrate_at_fixed_points(&options, distance),
            false => calibrate(&options, topic.as_deref()),
        }
    })?;
    let written = found.write(&out, force)?;
    let files: Vec<PathBuf> = written.iter().map(|name| out.join(name)).collect();
    files.iter().for_each(|file| messages::print_written(file));
    let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    output::emit(None, |stdout| match format {
        Format::Text => found.write_text(&files, stdout),
        Format::Json => writeln!(stdout, "{:#}", found.json(!files.is_empty())),
    })?;
    Ok(match found.rejection {
        None => Outcome::Clean,
        Some(_) => Outcome::Findings,
    })
}

fn distance_m(text: &str) -> Result<f64, String> {
    let metres = text.parse().ok().filter(|metres: &f64| *metres > 0.0 && metres.is_finite());
    metres.ok_or_else(|| "give a distance in m, such as 0.05".to_owned())
}
