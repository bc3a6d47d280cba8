//! `poseaudit pose`.

use std::fs;
use std::io::{self, Read, Write};
use std::path::PathBuf;

use poseaudit::desk::{
    ConversionResult, DeskError, FrameCandidates, FrameNames, KnownEncoding, Pair, PoseConversions,
    PoseText, ReconcileInput, ReconcileVerdict, conversions_as_json, convert, pairs_from_csv,
    parse_pose, reconcile, reconciliation_as_json, write_candidates, write_conversions,
    write_reconciliation,
};
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;
use poseaudit::run::load_robot;

use super::output::Format;
use super::{Outcome, fk, misuse, output};

/// Convert a pose to other conventions, or find what makes two poses agree
///
/// A pose has 6 numbers (position and three for the rotation), 7 (position and a quaternion, or axis and
/// angle), 9 (position and two matrix columns), 12 or 16 (a matrix). A rotation alone has 3, 4 or 9. Other
/// inputs: a numpy array, a YAML list, a UR p[…], a KUKA {X …, A …}, a RAPID robtarget, a FANUC X = … W = …,
/// a URDF <origin …/>, a ROS message as YAML, tf2_echo output, or - for stdin. Inferred conventions are
/// printed, ambiguous ones listed. For two poses, A and B, it finds what makes them agree, and exits with 1
/// if nothing does.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit pose --from euler:xyz --deg --mm \"243.69 -249.04 618.32 149.49 -12.78 72.64\"
  poseaudit pose --all --from kuka \"243.69 -249.04 618.32 72.64 -12.78 149.49\"
  poseaudit pose \"p[0.1, -0.2, 0.3, 1.2, -1.7, 0.6]\"
  ros2 topic echo --once /tcp_pose | poseaudit pose -
  poseaudit pose \"0.246 -0.249 0.619 0.170 0.472 -0.074 0.862\" \\
                 \"243.69 -249.04 618.32 149.49 -12.78 72.64\"
  poseaudit pose --pairs poses.csv --is-as ros --but-as mm,deg --robot ur10e")]
pub struct Args {
    /// The pose
    #[arg(value_name = "POSE", allow_hyphen_values = true)]
    pose: Option<String>,

    /// Also every Euler order and who uses it, other axis conventions, and code
    #[arg(long)]
    all: bool,

    /// A second pose, B, that should agree with the first
    #[arg(value_name = "OTHER", allow_hyphen_values = true)]
    other: Option<String>,

    /// The remaining numbers of an unquoted pose
    #[arg(value_name = "NUMBERS", allow_negative_numbers = true, hide = true)]
    rest: Vec<String>,

    /// Convention: rotvec, euler:SEQ, quat:xyzw, quat:wxyz, matrix:rows, matrix:columns, or a manufacturer
    /// such as kuka, fanuc, ur; units may follow, as in euler:ZYX,deg,mm
    #[arg(long, value_name = "CONVENTION", requires = "pose")]
    from: Option<String>,

    /// Angles are in degrees
    #[arg(long, requires = "pose", conflicts_with = "rad")]
    deg: bool,

    /// Angles are in radians
    #[arg(long, requires = "pose")]
    rad: bool,

    /// Lengths are in millimetres
    #[arg(long, requires = "pose", conflicts_with = "m")]
    mm: bool,

    /// Lengths are in metres
    #[arg(long, requires = "pose")]
    m: bool,

    /// Pose A, which should agree with pose B of --but (repeatable in pairs)
    #[arg(
        long,
        value_name = "POSE",
        allow_hyphen_values = true,
        requires = "but",
        conflicts_with = "pose"
    )]
    is: Vec<String>,

    /// Pose B
    #[arg(long, value_name = "POSE", allow_hyphen_values = true, requires = "is")]
    but: Vec<String>,

    /// A CSV of pose pairs: two columns with a pose each, or columns named is… and but…
    #[arg(long, value_name = "FILE", conflicts_with_all = ["pose", "is"])]
    pairs: Option<PathBuf>,

    /// Encoding of A, as for --from; units alone suffice
    #[arg(long, value_name = "CONVENTION")]
    is_as: Option<String>,

    /// Encoding of B
    #[arg(long, value_name = "CONVENTION")]
    but_as: Option<String>,

    /// Frames of A, parent and child
    #[arg(long, value_name = "PARENT,CHILD")]
    is_frames: Option<String>,

    /// Frames of B, parent and child
    #[arg(long, value_name = "PARENT,CHILD")]
    but_frames: Option<String>,

    /// The arm: a URDF, a table, or a catalogue name. One pose is compared with its reach; between two, its
    /// fixed frames may lie
    #[arg(long, value_name = "ROBOT")]
    robot: Option<String>,

    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let poses = pose_texts(args);
    match (poses.as_slice(), &args.pairs, args.is.is_empty()) {
        ([], None, true) => {
            let remedy =
                "give a pose, two that should agree, or --pairs; see `poseaudit pose --help`";
            Err(misuse("pose", "no pose was given", remedy))
        }
        ([pose], ..) => print_conventions(pose, args),
        ([_, _], ..) => {
            let [is, but] = [0, 1].map(|at| parse_pose(&poses[at]).map_err(trouble("POSE")));
            reconcile_pairs(vec![Pair { pose_a: is?, pose_b: but? }], "POSE", args)
        }
        _ => {
            let place = if args.pairs.is_some() { "--pairs" } else { "--is, --but" };
            reconcile_pairs(read_pairs(args)?, place, args)
        }
    }
}

/// One or two texts, or the numbers of one unquoted pose.
fn pose_texts(args: &Args) -> Vec<String> {
    let first: Vec<String> = [&args.pose, &args.other].into_iter().flatten().cloned().collect();
    match args.rest.is_empty() {
        true => first,
        false => vec![[first, args.rest.clone()].concat().join(" ")],
    }
}

fn trouble(place: &str) -> impl Fn(DeskError) -> Trouble + '_ {
    move |error| misuse(place, error.to_string(), error.remedy())
}

fn style(option: &str, given: Option<&str>) -> Result<KnownEncoding, Trouble> {
    let style: Option<Result<KnownEncoding, DeskError>> = given.map(str::parse);
    style.transpose().map(Option::unwrap_or_default).map_err(trouble(option))
}

fn print_conventions(pose: &str, args: &Args) -> Result<Outcome, Trouble> {
    let options = [
        ("--is-as", &args.is_as),
        ("--but-as", &args.but_as),
        ("--is-frames", &args.is_frames),
        ("--but-frames", &args.but_frames),
    ];
    if let Some((option, _)) = options.iter().find(|(_, given)| given.is_some()) {
        return Err(misuse(*option, "it applies to two poses", "give a second pose"));
    }
    let mut text = pose.to_owned();
    if pose == "-" {
        text.clear();
        let read = io::stdin().take(1 << 20).read_to_string(&mut text);
        read.map_err(|error| misuse("stdin", error.to_string(), "give the pose as text"))?;
    }
    let flags = [(args.deg, "deg"), (args.rad, "rad"), (args.mm, "mm"), (args.m, "m")];
    let units = flags.into_iter().filter(|(is_given, _)| *is_given).map(|(_, unit)| unit);
    let convention: Vec<&str> = args.from.as_deref().into_iter().chain(units).collect();
    let convention = (!convention.is_empty()).then(|| convention.join(","));
    let style = style("--from", convention.as_deref())?;
    let pose_text = parse_pose(&text).map_err(trouble("POSE"))?;
    let conversions = convert(&pose_text, style).map_err(trouble("POSE"))?;
    if let (Some(name), ConversionResult::Determined(conversions)) = (&args.robot, &conversions) {
        warn_beyond_reach(name, conversions)?;
    }
    output::emit(None, |out| match (args.format, &conversions) {
        (Format::Json, _) => writeln!(out, "{:#}", conversions_as_json(&conversions)),
        (Format::Text, ConversionResult::Determined(pose)) if !args.all => {
            write_summary(pose, &pose_text, out)
        }
        (Format::Text, ConversionResult::Ambiguous { candidates, notes }) if !args.all => {
            write_candidates(candidates, notes, false, out)
        }
        (Format::Text, _) => write_conversions(&conversions, &pose_text, out),
    })?;
    Ok(Outcome::Clean)
}

/// The pose in the usual conventions.
fn write_summary(
    conversions: &PoseConversions,
    pose_text: &PoseText,
    out: &mut dyn Write,
) -> io::Result<()> {
    writeln!(out, "{:21}{} ({})", "read as", conversions.encoding, pose_text.kind)?;
    for note in &conversions.notes {
        writeln!(out, "{:21}{note}", "")?;
    }
    fk::write_pose(&conversions.pose, conversions.has_position, out)?;
    writeln!(out, "{:21}--all: every Euler order and who uses it, axis conventions, code", "more")
}

/// Warns of a position that the arm cannot reach in the base frame.
fn warn_beyond_reach(name: &str, conversions: &PoseConversions) -> Result<(), Trouble> {
    let robot = load_robot(name).map_err(|error| Trouble::from(&error))?;
    let reach_m = fk::chain(&robot, None, None)?.max_reach_m();
    let distance_m = conversions.pose.translation.vector.norm();
    if conversions.has_position && distance_m > reach_m {
        output::warning(format!(
            "the position is {distance_m:.3} m from the origin, but {} reaches {reach_m:.3} m; check units and \
             frames",
            robot.name
        ));
    }
    Ok(())
}

fn reconcile_pairs(pairs: Vec<Pair>, place: &str, args: &Args) -> Result<Outcome, Trouble> {
    let is: Vec<&PoseText> = pairs.iter().map(|pair| &pair.pose_a).collect();
    let is = frame_names(&is, "--is-frames", args.is_frames.as_deref())?;
    let but: Vec<&PoseText> = pairs.iter().map(|pair| &pair.pose_b).collect();
    let but = frame_names(&but, "--but-frames", args.but_frames.as_deref())?;
    let robot = args.robot.as_deref().map(load_robot).transpose();
    let robot = robot.map_err(|error| Trouble::from(&error))?;
    // Message frames may be a world or camera; frames on the command line must be links.
    for (option, given, names) in
        [("--is-frames", &args.is_frames, &is), ("--but-frames", &args.but_frames, &but)]
    {
        if given.is_some() {
            names.check(robot.as_ref()).map_err(trouble(option))?;
        }
    }
    let question = ReconcileInput {
        encoding_a: style("--is-as", args.is_as.as_deref())?,
        encoding_b: style("--but-as", args.but_as.as_deref())?,
        frames: FrameCandidates::from_robot(robot.as_ref(), &is, &but),
        pairs,
    };
    let answer = reconcile(&question).map_err(trouble(place))?;
    output::emit(None, |out| match args.format {
        Format::Text => write_reconciliation(&answer, question.pairs.len(), out),
        Format::Json => {
            writeln!(out, "{:#}", reconciliation_as_json(&answer, question.pairs.len()))
        }
    })?;
    Ok(if answer.verdict == ReconcileVerdict::Unexplained {
        Outcome::Findings
    } else {
        Outcome::Clean
    })
}

/// Frames given by `option`, otherwise of the pasted texts.
fn frame_names(
    pose_text: &[&PoseText],
    option: &str,
    given: Option<&str>,
) -> Result<FrameNames, Trouble> {
    let Some(given) = given else {
        let mut named = pose_text.iter().map(|pose_text| FrameNames {
            parent: pose_text.parent.clone(),
            child: pose_text.child.clone(),
        });
        let first = named.next().unwrap_or_default();
        if named.any(|other| other != first) {
            let remedy = "separate the pairs by frame, or name the frames";
            return Err(misuse(option, "the messages name several frames", remedy));
        }
        return Ok(first);
    };
    let (parent, child) = given.split_once(',').ok_or_else(|| {
        misuse(
            option,
            format!("`{given}` is not two frames"),
            "write PARENT,CHILD, such as base,tool0",
        )
    })?;
    let name = |text: &str| Some(text.trim().to_owned()).filter(|name| !name.is_empty());
    Ok(FrameNames { parent: name(parent), child: name(child) })
}

fn read_pairs(args: &Args) -> Result<Vec<Pair>, Trouble> {
    if let Some(path) = &args.pairs {
        PathRegistry::check_read_only([path])?;
        let place = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| {
            misuse(&place, format!("cannot be read: {error}"), "name a CSV with one pair per row")
        })?;
        return pairs_from_csv(&text).map_err(trouble(&place));
    }
    let (is, but) = (args.is.len(), args.but.len());
    if is != but {
        let what = format!("{is} poses for {but} of --but");
        return Err(misuse("--is", what, "give one --but for each --is"));
    }
    let pairs = args.is.iter().zip(&args.but).map(|(is, but)| {
        Ok(Pair {
            pose_a: parse_pose(is).map_err(trouble("--is"))?,
            pose_b: parse_pose(but).map_err(trouble("--but"))?,
        })
    });
    pairs.collect()
}
