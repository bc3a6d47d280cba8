//! `poseaudit plan`.

mod arm;
mod labels;
mod read;
mod setup;
mod text;
mod urscript;
mod write;

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use poseaudit::diagnosis::plan::{self, ClearanceViolation, Infeasible, Purpose};
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};
use arm::PlannedArm;
use setup::{PlanTask, build_valid_task};

/// Plan a motion that makes an audit conclusive, or predict what a given motion would show
#[derive(Debug, clap::Args)]
#[command(after_help = "\
There is no collision checking with the cell, the payload or cables. Run a motion slowly first.

Examples:
  poseaudit plan ur5e --around 0,-1.57,1.57,-1.2,-1.57,0 --for zeros
  poseaudit plan ur5e --around 0,-90,90,-70,-90,0 --deg --for latency --output latency.script
  poseaudit plan arm.urdf --around 0.1,0.4,0,-1.2,0,1.6,0.8 --for hand-eye --format yaml --output run.yaml
  poseaudit plan ur5e --check mine.csv --for calibration --outside")]
pub struct Args {
    /// A URDF or DH table, a catalogue name, or a log with its robot's description
    #[arg(value_name = "ROBOT")]
    robot: String,

    /// A collision-free configuration around which the arm moves: rad or m, from base to tip
    #[arg(
        long,
        value_name = "Q",
        value_delimiter = ',',
        allow_hyphen_values = true,
        required_unless_present = "check",
        value_parser = parse_finite
    )]
    around: Vec<f64>,

    /// Revolute joints of --around are in degrees
    #[arg(long)]
    deg: bool,

    /// The purpose of the motion
    #[arg(long = "for", value_enum, default_value_t = PurposeName::Zeros)]
    purpose: PurposeName,

    /// Duration of the motion, s
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = parse_within::<2, 3600>)]
    seconds: f64,

    /// Maximum deviation of each joint from --around, degrees; 3.5 mm per degree for a prismatic joint
    #[arg(long, value_name = "DEG", default_value_t = 15.0, value_parser = parse_within::<0, 180>)]
    amplitude: f64,

    /// Maximum joint speed, rad/s; a fifth of it in m/s for a prismatic joint [default: the model's limit,
    /// else 1]
    #[arg(long, value_name = "RAD/S", value_parser = parse_within::<0, 100>)]
    speed: Option<f64>,

    /// Maximum joint acceleration, rad/s²; a fifth of it in m/s² for a prismatic joint
    #[arg(long, value_name = "RAD/S²", default_value_t = 1.0, value_parser = parse_within::<0, 1000>)]
    acceleration: f64,

    /// Minimum height of all parts of the arm in the base frame, m
    #[arg(long, value_name = "Z", allow_negative_numbers = true, value_parser = parse_finite)]
    floor: Option<f64>,

    /// Minimum distance between parts of the arm, and to the floor, m
    #[arg(long, value_name = "M", default_value_t = 0.02, value_parser = parse_within::<0, 10>)]
    clear: f64,

    /// Poses come from a tracker: neither its world frame nor the marker offset is known
    #[arg(long)]
    outside: bool,

    /// Noise of positions along each axis, mm
    #[arg(long, value_name = "MM", default_value_t = 0.1, value_parser = parse_within::<0, 1000>)]
    noise_mm: f64,

    /// Noise of rotations about each axis, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.02, value_parser = parse_within::<0, 90>)]
    noise_deg: f64,

    /// Pose rate, Hz
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = parse_within::<0, 10000>)]
    rate: f64,

    /// Deviation of each link from the nominal model, mm; 0 for an exact model
    #[arg(long, value_name = "MM", default_value_t = 0.1, value_parser = parse_up_to_100)]
    links_mm: f64,

    /// Distance of the camera target in front of the tip, m
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = parse_within::<0, 100>)]
    target: f64,

    /// Maximum angle of the target from the camera axis (z of the tip), degrees
    #[arg(long, value_name = "DEG", default_value_t = 30.0, value_parser = parse_within::<0, 180>)]
    view: f64,

    /// Base link: the reference frame of the poses
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// Tip link: the link whose pose is measured
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// Arm to use if the log has several
    #[arg(long, value_name = "NAME")]
    arm: Option<String>,

    /// Seed of the random search
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Output format [default: by the extension of --output, else text]
    #[arg(long, value_enum)]
    format: Option<Format>,

    /// Write to this file instead of stdout
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Check the motion in this file instead: joint positions over time as CSV, JSON or a JointTrajectory
    /// in YAML
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
}

/// Purpose of the motion, from the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PurposeName {
    /// The zero offset of each joint
    Zeros,
    /// The deviations of all links from the nominal model
    Calibration,
    /// The latency of poses relative to joint states
    Latency,
    /// The pose of a camera in the hand
    HandEye,
    /// Drift and tilt of an IMU's orientation
    Yaw,
}

impl From<PurposeName> for Purpose {
    fn from(name: PurposeName) -> Self {
        match name {
            PurposeName::Zeros => Purpose::Zeros,
            PurposeName::Calibration => Purpose::Calibration,
            PurposeName::Latency => Purpose::Latency,
            PurposeName::HandEye => Purpose::HandEye,
            PurposeName::Yaw => Purpose::Yaw,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// The prediction, for people
    Text,
    /// Time, positions and speeds, one row per sample
    Csv,
    /// Everything, for programs
    Json,
    /// A trajectory_msgs/JointTrajectory
    Yaml,
    /// A URScript program for Universal Robots
    Urscript,
}

impl Format {
    fn from_extension(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()? {
            "csv" => Some(Self::Csv),
            "json" => Some(Self::Json),
            "yaml" | "yml" => Some(Self::Yaml),
            "script" | "urscript" => Some(Self::Urscript),
            "txt" => Some(Self::Text),
            _ => None,
        }
    }
}

fn parse_finite(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "expected a finite number".to_owned())
}

fn parse_up_to_100(text: &str) -> Result<f64, String> {
    let number = parse_finite(text)?;
    match number {
        0.0..=100.0 => Ok(number),
        _ => Err("expected a number from 0 to 100".to_owned()),
    }
}

/// Number above `LOW` and at most `HIGH`.
fn parse_within<const LOW: u32, const HIGH: u32>(text: &str) -> Result<f64, String> {
    let number = parse_finite(text)?;
    match number > f64::from(LOW) && number <= f64::from(HIGH) {
        true => Ok(number),
        false => Err(format!("expected a number above {LOW}, up to {HIGH}")),
    }
}

const COLLISION_WARNING: &str = "NO COLLISION CHECKING: the cell, the payload and cables are not modelled; run at \
    low speed first, with a hand on the e-stop";

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut places = PathRegistry::default();
    places.add_input("the robot", Path::new(&args.robot));
    args.check.iter().for_each(|file| places.add_input("the motion", file));
    args.output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places.check()?;
    let arm = PlannedArm::from_args(args)?;
    match &args.check {
        Some(file) => check_motion(args, &arm, file),
        None => plan_motion(args, &arm),
    }
}

fn plan_motion(args: &Args, arm: &PlannedArm) -> Result<Outcome, Trouble> {
    let around = arm.around(args)?;
    let task = build_valid_task(args, arm, around)?;
    let format = args.format.or_else(|| Format::from_extension(args.output.as_deref()?));
    let format = format.unwrap_or(Format::Text);
    if format == Format::Urscript {
        urscript::check_is_ur(&arm.chain)?;
    }
    let planned =
        plan::plan(&task.requirements(&arm.chain)).map_err(|why| infeasible_trouble(&task, why))?;
    let motion = task.motion(&planned);
    let emit = |format: Format, path: Option<&Path>| {
        output::emit(path, |out| match format {
            Format::Text => text::write_plan(arm, &task, &planned, &motion, out),
            Format::Csv => write::write_csv(arm, &motion, out),
            Format::Json => write::write_json(arm, &task, &planned, &motion, out),
            Format::Yaml => write::write_yaml(arm, &planned.series, out),
            Format::Urscript => urscript::write_program(arm, &task, &planned.series, out),
        })
    };
    emit(format, args.output.as_deref())?;
    if format == Format::Text {
        return Ok(Outcome::Clean);
    }
    match args.output {
        // Describes the file on stdout.
        Some(_) => emit(Format::Text, None)?,
        None => output::warning(COLLISION_WARNING),
    }
    Ok(Outcome::Clean)
}

fn check_motion(args: &Args, arm: &PlannedArm, file: &Path) -> Result<Outcome, Trouble> {
    let motion = read::read_motion(file, &arm.chain)?;
    let around = match args.around.is_empty() {
        true => motion.row(0).to_vec(),
        false => arm.around(args)?,
    };
    let task = PlanTask::from_configuration(args, arm, around);
    let sensing = &task.sensing;
    let purpose = args.purpose.into();
    let precision =
        plan::expected_precision(&arm.chain, &motion, purpose, sensing).ok_or_else(|| {
            let what = "its points are more than 2 s apart; the motion between them is unknown";
            misuse(file.display(), what, "provide at least 10 points per second")
        })?;
    let checked = setup::MotionCheck::new(arm, &task, &motion, precision);
    let format = args.format.or_else(|| Format::from_extension(args.output.as_deref()?));
    output::emit(args.output.as_deref(), |out| match format {
        Some(Format::Json) => write::write_check_json(arm, &task, &checked, &motion, out),
        Some(Format::Csv) => write::write_csv(arm, &motion, out),
        _ => text::write_check(arm, &task, &checked, &motion, out),
    })?;
    Ok(if checked.is_within() { Outcome::Clean } else { Outcome::Findings })
}

/// Error, and what would help, if no motion was found.
fn infeasible_trouble(task: &PlanTask, why: Infeasible) -> Trouble {
    match why {
        Infeasible::NoMargin => misuse(
            "--around",
            "no joint can move: each is at a limit, or --amplitude leaves no room",
            "choose a configuration farther from the limits",
        ),
        Infeasible::ClearanceViolated(violation) => {
            let violation = violation.map_or_else(String::new, |violation| {
                format!(": {}", task.violation_text(&violation))
            });
            let remedy = match is_view_violated(&why) {
                true => "reduce --amplitude, or increase --view or --target",
                false => "reduce --amplitude or --clear, or choose a more open configuration",
            };
            misuse("--around", format!("every motion tried comes too close{violation}"), remedy)
        }
        Infeasible::NothingObservable => misuse(
            "--for",
            "no motion of these joints makes it observable",
            "choose another purpose, or increase --amplitude",
        ),
    }
}

fn is_view_violated(why: &Infeasible) -> bool {
    matches!(why, Infeasible::ClearanceViolated(Some(ClearanceViolation::View(_))))
}
