//! `poseaudit fk`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use poseaudit::geometry::{Convention, Pose, xyz_of, xyzw_from_rotation};
use poseaudit::output::tables::{Configurations, TableError, kinematics_frame, write_frame};
use poseaudit::places::PathRegistry;
use poseaudit::report::{Trouble, sanitize_display};
use poseaudit::robot::{Chain, JointKind, Robot};
use poseaudit::run::load_robot;
use serde_json::json;

use super::output::Format;
use super::{Outcome, messages, misuse, output};

/// Forward kinematics: the pose of one link in another, for one configuration or a file of them
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit fk ur5e 0 -1.57 1.57 0 0 0
  poseaudit fk arm.urdf --base base_link --tip camera --deg 10 20 30 0 45 0
  poseaudit fk ur5e --file joints.csv --output poses.parquet")]
pub struct Args {
    /// A URDF or DH table, or a catalogue name
    #[arg(value_name = "ROBOT")]
    robot: String,

    /// Joint positions from base to tip, rad or m
    #[arg(
        value_name = "Q",
        allow_negative_numbers = true,
        conflicts_with = "file",
        value_parser = parse_finite
    )]
    q: Vec<f64>,

    /// A CSV or Parquet file with one column per joint
    #[arg(long, value_name = "FILE", requires = "output")]
    file: Option<PathBuf>,

    /// Output file for the poses (.csv or .parquet)
    #[arg(short, long, value_name = "FILE", requires = "file")]
    output: Option<PathBuf>,

    /// Base link: the reference frame of the pose
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// Tip link: the link whose pose is computed
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// Revolute joints are in degrees, unless the column name states the unit
    #[arg(long)]
    deg: bool,

    /// Output format for a single pose
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

fn parse_finite(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| "expected a finite number".to_owned())
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut places = PathRegistry::default();
    places.add_input("the robot", Path::new(&args.robot));
    args.file.iter().for_each(|file| places.add_input("the file of joint positions", file));
    args.output.iter().for_each(|path| places.add_output(output::OUTPUT_OPTION, path));
    places.check()?;
    let robot = load_robot(&args.robot)
        .map_err(|error| Trouble { place: args.robot.clone(), ..Trouble::from(&error) })?;
    let chain = chain(&robot, args.base.as_deref(), args.tip.as_deref())?;
    match (&args.file, &args.output) {
        (Some(file), Some(output)) => convert_file(&chain, args, file, output)?,
        _ => print_one(&robot, &chain, args)?,
    }
    Ok(Outcome::Clean)
}

/// Chain between two links. Defaults to the usual base and tip.
pub(super) fn chain(
    robot: &Robot,
    base: Option<&str>,
    tip: Option<&str>,
) -> Result<Chain, Trouble> {
    let link = |option: &str, given: Option<&str>, usual: &Option<String>| {
        let name = given.or(usual.as_deref());
        name.map(|name| robot.link_or_nearest(name))
            .transpose()
            .map_err(|error| misuse(option, error, "name a link of the model"))
    };
    let base = link("--base", base, &robot.default_base)?.unwrap_or_else(|| robot.root());
    let tip = link("--tip", tip, &robot.default_tip)?;
    let tip = tip.or_else(|| robot.leaf_links().last()).unwrap_or(base);
    robot
        .chain(base, tip)
        .map_err(|error| misuse("--tip", error, "name two links with joints between them"))
}

/// Converts one position per joint, given at `place`, to SI units.
pub(super) fn configuration(
    chain: &Chain,
    given: &[f64],
    deg: bool,
    place: &str,
) -> Result<Vec<f64>, Trouble> {
    let (found, wanted) = (given.len(), chain.dof());
    if found != wanted {
        let names = chain.joint_names().join(", ");
        let what = format!("{found} joint positions given for {wanted} joints");
        return Err(misuse(place, what, format!("give one for each of {names}")));
    }
    let in_si = |(&q, kind): (&f64, &JointKind)| match deg && *kind != JointKind::Prismatic {
        true => q.to_radians(),
        false => q,
    };
    Ok(given.iter().zip(chain.joint_kinds()).map(in_si).collect())
}

/// Warns if a revolute joint is turned so far that its angle is probably in degrees.
fn warn_of_degrees(chain: &Chain, q: &[f64], args: &Args) {
    /// More than a turn, rad.
    const MAX_USUAL_ANGLE: f64 = 1.1 * std::f64::consts::TAU;
    let kinds = chain.joint_kinds().iter().cycle();
    let angles = q.iter().zip(kinds).filter(|(_, kind)| **kind != JointKind::Prismatic);
    let widest = angles.fold(0.0, |widest: f64, (angle, _)| widest.max(angle.abs()));
    if !args.deg && widest > MAX_USUAL_ANGLE {
        output::warning(format!(
            "a joint at {widest} rad is turned more than once; if the angles are degrees, add --deg"
        ));
    }
}

fn convert_file(chain: &Chain, args: &Args, file: &Path, output: &Path) -> Result<(), Trouble> {
    let trouble = |option: &str, TableError { path, cause }: TableError| {
        misuse(path.display(), cause, format!("see {option} in `poseaudit fk --help`"))
    };
    let read =
        Configurations::read(file, chain, args.deg).map_err(|error| trouble("--file", error))?;
    let q = read.q;
    warn_of_degrees(chain, &q, args);
    let mut poses = Vec::new();
    chain.forward_batch(&q, &mut poses);
    let written = kinematics_frame(chain, &q, &poses)
        .map_err(|error| TableError { path: output.to_owned(), cause: error.to_string() })
        .and_then(|mut frame| write_frame(output, &mut frame));
    written.map_err(|error| trouble("--output", error))?;
    messages::print_written(output);
    Ok(())
}

fn print_one(robot: &Robot, chain: &Chain, args: &Args) -> Result<(), Trouble> {
    let q = configuration(chain, &args.q, args.deg, "fk")?;
    warn_of_degrees(chain, &q, args);
    let base_from_tip = chain.forward(&q);
    output::emit(None, |out| match args.format {
        Format::Text => write_text(robot, chain, &base_from_tip, out),
        Format::Json => {
            let json_text = json!({
                "robot": robot.name,
                "base": chain.base_name(),
                "tip": chain.tip_name(),
                "joints": chain.joint_names(),
                "q": q,
                "xyz_m": xyz_of(&base_from_tip),
                "xyzw": xyzw_from_rotation(&base_from_tip.rotation),
                "matrix": matrix(&base_from_tip),
            });
            writeln!(out, "{json_text:#}")
        }
    })
}

pub(super) fn matrix(pose: &Pose) -> [[f64; 4]; 4] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

fn write_text(robot: &Robot, chain: &Chain, pose: &Pose, out: &mut dyn Write) -> io::Result<()> {
    let (name, base, tip) = (&robot.name, chain.base_name(), chain.tip_name());
    writeln!(out, "{}", sanitize_display(format_args!("{name}: {base} → {tip}")))?;
    write_pose(pose, true, out)
}

/// In the usual conventions; without a position, only the rotation.
pub(super) fn write_pose(pose: &Pose, has_position: bool, out: &mut dyn Write) -> io::Result<()> {
    let listed = |numbers: &[f64], digits: usize| {
        let number = |number: &f64| {
            // Adding zero makes a negative zero positive.
            let scale = 10_f64.powi(digits as i32);
            let rounded = (number * scale).round() / scale + 0.0;
            format!("{rounded:>11.digits$}")
        };
        numbers.iter().map(number).collect::<Vec<_>>().join(" ")
    };
    let rpy = Convention::RPY.numbers(&pose.rotation).map(f64::to_degrees);
    let rotvec = Convention::RotVec.numbers(&pose.rotation);
    let [x, y, z, w] = xyzw_from_rotation(&pose.rotation);
    if has_position {
        writeln!(out, "position, m          {}", listed(&xyz_of(pose), 6))?;
    }
    writeln!(out, "quaternion, x y z w  {}", listed(&[x, y, z, w], 6))?;
    writeln!(out, "quaternion, w x y z  {}", listed(&[w, x, y, z], 6))?;
    writeln!(out, "roll pitch yaw, °    {}", listed(&rpy, 4))?;
    writeln!(out, "rotation vector, rad {}", listed(&rotvec, 6))?;
    let size = if has_position { 4 } else { 3 };
    for (label, row) in ["matrix", "", "", ""].into_iter().zip(matrix(pose)).take(size) {
        writeln!(out, "{label:20} {}", listed(&row[..size], 6))?;
    }
    Ok(())
}
