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
use poseaudit::diagnosis::plan::{self, Infeasible, Nearness, Purpose};
use poseaudit::places::Places;
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};
use arm::Planning;
use setup::{Asked, asked};

/// The motion to record so that an audit can tell what it could not, or what a given motion would show
#[derive(Debug, clap::Args)]
#[command(after_help = "\
It knows no obstacle: what stands around the arm is in no model of it. Run a motion slowly at first.

Examples:
  poseaudit plan ur5e --around 0,-1.57,1.57,-1.2,-1.57,0 --for zeros
  poseaudit plan ur5e --around 0,-90,90,-70,-90,0 --degrees --for latency --output latency.script
  poseaudit plan arm.urdf --around 0.1,0.4,0,-1.2,0,1.6,0.8 --for hand-eye --format yaml --output run.yaml
  poseaudit plan ur5e --check mine.csv --for calibration --outside")]
pub struct Args {
    /// A URDF or DH table, a name of the catalogue, or a log with its robot's description
    #[arg(value_name = "ROBOT")]
    robot: String,

    /// A posture that is known to be free, around which the arm moves: rad or m, from base to tip
    #[arg(
        long,
        value_name = "Q",
        value_delimiter = ',',
        allow_hyphen_values = true,
        required_unless_present = "check",
        value_parser = finite
    )]
    around: Vec<f64>,

    /// Turning joints of --around are in degrees
    #[arg(long)]
    degrees: bool,

    /// What the motion is to show
    #[arg(long = "for", value_enum, default_value_t = For::Zeros)]
    purpose: For,

    /// How long it lasts, s
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = within::<2, 3600>)]
    seconds: f64,

    /// How far each joint may go from --around, degrees; one that slides 3.5 mm for each
    #[arg(long, value_name = "DEG", default_value_t = 15.0, value_parser = within::<0, 180>)]
    amplitude: f64,

    /// Highest speed of a joint, rad/s, of one that slides a fifth of it in m/s [default: the model's limit,
    /// else 1]
    #[arg(long, value_name = "RAD/S", value_parser = within::<0, 100>)]
    speed: Option<f64>,

    /// Highest acceleration of a joint, rad/s², of one that slides a fifth of it in m/s²
    #[arg(long, value_name = "RAD/S²", default_value_t = 1.0, value_parser = within::<0, 1000>)]
    acceleration: f64,

    /// Height in the base that nothing of the arm may be below, m
    #[arg(long, value_name = "Z", allow_negative_numbers = true, value_parser = finite)]
    floor: Option<f64>,

    /// Least distance between parts of the arm, and over the floor, m
    #[arg(long, value_name = "M", default_value_t = 0.02, value_parser = within::<0, 10>)]
    clear: f64,

    /// Poses are those of a tracker: neither its frame nor the point on the tool is known
    #[arg(long)]
    outside: bool,

    /// Noise of positions along each axis, mm
    #[arg(long, value_name = "MM", default_value_t = 0.1, value_parser = within::<0, 1000>)]
    noise_mm: f64,

    /// Noise of rotations about each axis, degrees
    #[arg(long, value_name = "DEG", default_value_t = 0.02, value_parser = within::<0, 90>)]
    noise_deg: f64,

    /// Poses a second
    #[arg(long, value_name = "HZ", default_value_t = 100.0, value_parser = within::<0, 10000>)]
    rate: f64,

    /// By how much each link differs from the drawing, mm; 0 for an arm that is its drawing
    #[arg(long, value_name = "MM", default_value_t = 0.1, value_parser = at_least_nothing)]
    links_mm: f64,

    /// How far in front of the tip the target of a camera is, m
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = within::<0, 100>)]
    target: f64,

    /// How far off its axis, the tip's z, the camera sees the target, degrees
    #[arg(long, value_name = "DEG", default_value_t = 30.0, value_parser = within::<0, 180>)]
    view: f64,

    /// The link that poses are in
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// The link whose pose it is
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// The arm of a log with several
    #[arg(long, value_name = "NAME")]
    arm: Option<String>,

    /// Of the random numbers that the search begins with
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// How it is written [default: by the name of --output, else text]
    #[arg(long, value_enum)]
    format: Option<Format>,

    /// Where it is written
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Look at the motion in this file instead: the joints' positions over time as CSV, as JSON or as a
    /// JointTrajectory in YAML
    #[arg(long, value_name = "FILE")]
    check: Option<PathBuf>,
}

/// What a motion is to show, as the command line says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum For {
    /// The zero of each joint
    Zeros,
    /// The deviations of all links from the drawing
    Calibration,
    /// The latency of poses against joint states
    Latency,
    /// The pose of a camera in the hand
    HandEye,
    /// Drift and tilt of an IMU's orientation
    Yaw,
}

impl From<For> for Purpose {
    fn from(asked: For) -> Self {
        match asked {
            For::Zeros => Purpose::Zeros,
            For::Calibration => Purpose::Calibration,
            For::Latency => Purpose::Latency,
            For::HandEye => Purpose::HandEye,
            For::Yaw => Purpose::Yaw,
        }
    }
}

/// How a motion is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// What it shows, for people
    Text,
    /// Time, positions and speeds, a row each
    Csv,
    /// All of it, for programs
    Json,
    /// A trajectory_msgs/JointTrajectory
    Yaml,
    /// A program of Universal Robots' arms
    Urscript,
}

impl Format {
    fn of(path: &Path) -> Option<Self> {
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

fn finite(text: &str) -> Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "expected a finite number".to_owned())
}

fn at_least_nothing(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    match number {
        0.0..=100.0 => Ok(number),
        _ => Err("expected a number from 0 to 100".to_owned()),
    }
}

/// A number above `LOW`, and no higher than `HIGH`.
fn within<const LOW: u32, const HIGH: u32>(text: &str) -> Result<f64, String> {
    let number = finite(text)?;
    match number > f64::from(LOW) && number <= f64::from(HIGH) {
        true => Ok(number),
        false => Err(format!("expected a number above {LOW}, up to {HIGH}")),
    }
}

/// What is said wherever a motion is handed out.
const OBSTACLES: &str = "THIS MOTION KNOWS NO OBSTACLE: what stands around the arm, what it carries and \
                         its cables are in no model of it; run it at low speed first, with a hand on the \
                         stop";

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut places = Places::default();
    places.reads("the robot", Path::new(&args.robot));
    args.check.iter().for_each(|file| places.reads("the motion", file));
    args.output.iter().for_each(|path| places.writes(output::OUTPUT, path));
    places.check()?;
    let planning = Planning::of(args)?;
    match &args.check {
        Some(file) => check(args, &planning, file),
        None => planned(args, &planning),
    }
}

fn planned(args: &Args, planning: &Planning) -> Result<Outcome, Trouble> {
    let around = planning.posture(&args.around, args.degrees)?;
    let asked = asked(args, planning, around)?;
    let format = args.format.or_else(|| Format::of(args.output.as_deref()?));
    let format = format.unwrap_or(Format::Text);
    if format == Format::Urscript {
        urscript::is_theirs(&planning.chain)?;
    }
    let planned = plan::plan(&asked.task(&planning.chain)).map_err(|why| refusal(&asked, why))?;
    let motion = asked.motion(&planned);
    let emit = |format: Format, path: Option<&Path>| {
        output::emit(path, |out| match format {
            Format::Text => text::planned(planning, &asked, &planned, &motion, out),
            Format::Csv => write::csv(planning, &motion, out),
            Format::Json => write::json(planning, &asked, &planned, &motion, out),
            Format::Yaml => write::yaml(planning, &planned.series, out),
            Format::Urscript => urscript::program(planning, &asked, &planned.series, out),
        })
    };
    emit(format, args.output.as_deref())?;
    if format == Format::Text {
        return Ok(Outcome::Clean);
    }
    match args.output {
        // What goes to a file is told of beside it.
        Some(_) => emit(Format::Text, None)?,
        None => output::warning(OBSTACLES),
    }
    Ok(Outcome::Clean)
}

fn check(args: &Args, planning: &Planning, file: &Path) -> Result<Outcome, Trouble> {
    let motion = read::motion(file, &planning.chain)?;
    let around = match args.around.is_empty() {
        true => motion.row(0).to_vec(),
        false => planning.posture(&args.around, args.degrees)?,
    };
    let asked = Asked::of_given(args, planning, around);
    let sensing = &asked.sensing;
    let purpose = args.purpose.into();
    let promises = plan::shown(&planning.chain, &motion, purpose, sensing).ok_or_else(|| {
        let what = "its points are more than 2 s apart, and between them the motion is not known";
        misuse(file.display().to_string(), what, "give it at 10 points a second or more")
    })?;
    let checked = setup::Checked::of(planning, &asked, &motion, promises);
    let format = args.format.or_else(|| Format::of(args.output.as_deref()?));
    output::emit(args.output.as_deref(), |out| match format {
        Some(Format::Json) => write::checked_json(planning, &asked, &checked, &motion, out),
        Some(Format::Csv) => write::csv(planning, &motion, out),
        _ => text::checked(planning, &asked, &checked, &motion, out),
    })?;
    Ok(if checked.is_within() { Outcome::Clean } else { Outcome::Findings })
}

/// Why no motion was found, and what would help.
fn refusal(asked: &Asked, why: Infeasible) -> Trouble {
    match why {
        Infeasible::NoRoom => misuse(
            "--around",
            "no joint can move: each is at a limit, or --amplitude leaves it no room",
            "name a posture farther from the limits",
        ),
        Infeasible::TooNear(near) => {
            let near = near.map_or_else(String::new, |near| format!(": {}", asked.nearness(&near)));
            let remedy = match near_view(&why) {
                true => "lessen --amplitude, or widen --view or --target",
                false => "lessen --amplitude or --clear, or name a posture that is more open",
            };
            misuse("--around", format!("every motion that was tried comes too near{near}"), remedy)
        }
        Infeasible::NothingShown => misuse(
            "--for",
            "no motion of these joints shows it",
            "ask for something else, or more --amplitude",
        ),
    }
}

fn near_view(why: &Infeasible) -> bool {
    matches!(why, Infeasible::TooNear(Some(Nearness::View(_))))
}
