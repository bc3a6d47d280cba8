//! `poseaudit pose`.

use std::fs;
use std::io::{self, Read, Write};
use std::path::PathBuf;

use poseaudit::desk::{
    Answer, Candidate, Corrections, DeskError, FrameNames, Hypothesis, Inversion, Pair, Pasted,
    Question, Reading, Residual, Row, Sheet, Sheets, Style, Tool, Verdict, pairs_from_csv, paste,
    reconcile, sheet,
};
use poseaudit::finding::rounded;
use poseaudit::geometry::vendors::{self, Use};
use poseaudit::geometry::{Coding, Convention, Pose, xyz_of, xyzw_from_rotation};
use poseaudit::places::Places;
use poseaudit::report::Trouble;
use poseaudit::run::robot_of;
use serde_json::{Value, json};

use super::output::Format;
use super::{Outcome, misuse, output};

/// One pose in every convention, or what makes two poses agree
///
/// A pose is 6 numbers (position and three of a rotation), 7 (and a quaternion), 12 or 16 (a matrix);
/// a rotation alone is 3, 4 or 9. Or it is a UR's p[…], a URDF <origin …/>, a ROS message as YAML, what
/// tf2_echo prints, or - for stdin. What is inferred is said; what cannot be is listed.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit pose --from euler:xyz --deg --mm \"243.69 -249.04 618.32 149.49 -12.78 72.64\"
  poseaudit pose --from kuka \"243.69 -249.04 618.32 72.64 -12.78 149.49\"
  poseaudit pose \"p[0.1, -0.2, 0.3, 1.2, -1.7, 0.6]\"
  ros2 topic echo --once /tcp_pose | poseaudit pose -
  poseaudit pose --is \"0.246 -0.249 0.619 0.170 0.472 -0.074 0.862\" \\
                 --but \"243.69 -249.04 618.32 149.49 -12.78 72.64\"
  poseaudit pose --pairs poses.csv --is-as ros --but-as mm,deg --robot ur10e")]
pub struct Args {
    /// The pose
    #[arg(value_name = "POSE", allow_hyphen_values = true)]
    pose: Option<String>,

    /// Its convention: rotvec, euler:SEQ, quat:xyzw, quat:wxyz, matrix:rows, matrix:columns, or a
    /// maker's as kuka, fanuc, ur; units may follow, as in euler:ZYX,deg,mm
    #[arg(long, value_name = "CONVENTION", requires = "pose")]
    from: Option<String>,

    /// Its angles are in degrees
    #[arg(long, requires = "pose", conflicts_with = "rad")]
    deg: bool,

    /// Its angles are in radians
    #[arg(long, requires = "pose")]
    rad: bool,

    /// Its lengths are in millimetres
    #[arg(long, requires = "pose", conflicts_with = "m")]
    mm: bool,

    /// Its lengths are in metres
    #[arg(long, requires = "pose")]
    m: bool,

    /// A pose that should agree with that of --but (repeatable, each with its --but)
    #[arg(
        long,
        value_name = "POSE",
        allow_hyphen_values = true,
        requires = "but",
        conflicts_with = "pose"
    )]
    is: Vec<String>,

    /// The other pose
    #[arg(long, value_name = "POSE", allow_hyphen_values = true, requires = "is")]
    but: Vec<String>,

    /// A CSV of such pairs: two columns with a pose each, or columns named is… and but…
    #[arg(long, value_name = "FILE", conflicts_with_all = ["pose", "is"])]
    pairs: Option<PathBuf>,

    /// How the one side is coded, as --from; units alone will do
    #[arg(long, value_name = "CONVENTION", conflicts_with = "pose")]
    is_as: Option<String>,

    /// How the other side is coded
    #[arg(long, value_name = "CONVENTION", conflicts_with = "pose")]
    but_as: Option<String>,

    /// The frames of the one side, parent and child
    #[arg(long, value_name = "PARENT,CHILD", conflicts_with = "pose")]
    is_frames: Option<String>,

    /// The frames of the other side
    #[arg(long, value_name = "PARENT,CHILD", conflicts_with = "pose")]
    but_frames: Option<String>,

    /// The arm whose fixed frames may lie between the two: a URDF, a table, or a catalogue name
    #[arg(long, value_name = "ROBOT", conflicts_with = "pose")]
    robot: Option<String>,

    /// How the answer is printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    match (&args.pose, &args.pairs, args.is.is_empty()) {
        (Some(pose), ..) => one(pose, args)?,
        (None, None, true) => {
            let remedy = "give a pose, --is with --but, or --pairs; see `poseaudit pose --help`";
            return Err(misuse("pose", "no pose was given", remedy));
        }
        _ => several(args)?,
    }
    Ok(Outcome::Clean)
}

fn trouble(place: &str) -> impl Fn(DeskError) -> Trouble + '_ {
    move |error| misuse(place, error.to_string(), error.advice())
}

fn style(option: &str, given: Option<&str>) -> Result<Style, Trouble> {
    let style: Option<Result<Style, DeskError>> = given.map(str::parse);
    style.transpose().map(Option::unwrap_or_default).map_err(trouble(option))
}

fn one(pose: &str, args: &Args) -> Result<(), Trouble> {
    let mut text = pose.to_owned();
    if pose == "-" {
        text.clear();
        let read = io::stdin().take(1 << 20).read_to_string(&mut text);
        read.map_err(|error| misuse("stdin", error.to_string(), "give the pose as text"))?;
    }
    let flags = [(args.deg, "deg"), (args.rad, "rad"), (args.mm, "mm"), (args.m, "m")];
    let units = flags.into_iter().filter(|(is_given, _)| *is_given).map(|(_, unit)| unit);
    let said: Vec<&str> = args.from.as_deref().into_iter().chain(units).collect();
    let said = (!said.is_empty()).then(|| said.join(","));
    let style = style("--from", said.as_deref())?;
    let pasted = paste(&text).map_err(trouble("POSE"))?;
    let sheets = sheet(&pasted, style).map_err(trouble("POSE"))?;
    output::emit(None, |out| match (args.format, &sheets) {
        (Format::Json, sheets) => writeln!(out, "{:#}", sheets_as_json(sheets)),
        (Format::Text, Sheets::One(sheet)) => write_sheet(sheet, &pasted, out),
        (Format::Text, Sheets::Several { candidates, notes }) => {
            write_candidates(candidates, notes, out)
        }
    })
}

fn several(args: &Args) -> Result<(), Trouble> {
    let pairs = pairs(args)?;
    let is: Vec<&Pasted> = pairs.iter().map(|pair| &pair.is).collect();
    let is = frame_names(&is, "--is-frames", args.is_frames.as_deref())?;
    let but: Vec<&Pasted> = pairs.iter().map(|pair| &pair.but).collect();
    let but = frame_names(&but, "--but-frames", args.but_frames.as_deref())?;
    let robot = args.robot.as_deref().map(robot_of).transpose();
    let robot = robot.map_err(|error| Trouble::from(&error))?;
    // What a message names may be a world or a camera; what the call names is a link.
    for (option, given, names) in
        [("--is-frames", &args.is_frames, &is), ("--but-frames", &args.but_frames, &but)]
    {
        if given.is_some() {
            names.check(robot.as_ref()).map_err(trouble(option))?;
        }
    }
    let question = Question {
        is: style("--is-as", args.is_as.as_deref())?,
        but: style("--but-as", args.but_as.as_deref())?,
        frames: Corrections::of(robot.as_ref(), &is, &but),
        pairs,
    };
    let place = if args.pairs.is_some() { "--pairs" } else { "--is, --but" };
    let answer = reconcile(&question).map_err(trouble(place))?;
    output::emit(None, |out| match args.format {
        Format::Text => write_answer(&answer, question.pairs.len(), out),
        Format::Json => {
            writeln!(out, "{:#}", answer_as_json(&answer, question.pairs.len()))
        }
    })
}

/// The frames that `option` gives, else those that the pasted texts name.
fn frame_names(
    pasted: &[&Pasted],
    option: &str,
    given: Option<&str>,
) -> Result<FrameNames, Trouble> {
    let Some(given) = given else {
        let mut named = pasted.iter().map(|pasted| FrameNames {
            parent: pasted.parent.clone(),
            child: pasted.child.clone(),
        });
        let first = named.next().unwrap_or_default();
        if named.any(|other| other != first) {
            let remedy = "give the pairs of each frame apart, or name the frames";
            return Err(misuse(option, "the messages name several frames", remedy));
        }
        return Ok(first);
    };
    let (parent, child) = given.split_once(',').ok_or_else(|| {
        misuse(option, format!("`{given}` is not two frames"), "write PARENT,CHILD, as base,tool0")
    })?;
    let name = |text: &str| Some(text.trim().to_owned()).filter(|name| !name.is_empty());
    Ok(FrameNames { parent: name(parent), child: name(child) })
}

fn pairs(args: &Args) -> Result<Vec<Pair>, Trouble> {
    if let Some(path) = &args.pairs {
        Places::only_read([path])?;
        let place = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|error| {
            misuse(&place, format!("cannot be read: {error}"), "name a CSV with a pair in each row")
        })?;
        return pairs_from_csv(&text).map_err(trouble(&place));
    }
    let (is, but) = (args.is.len(), args.but.len());
    if is != but {
        let what = format!("{is} poses, and {but} of --but");
        return Err(misuse("--is", what, "give a --but for each --is"));
    }
    let pairs = args.is.iter().zip(&args.but).map(|(is, but)| {
        Ok(Pair {
            is: paste(is).map_err(trouble("--is"))?,
            but: paste(but).map_err(trouble("--but"))?,
        })
    });
    pairs.collect()
}

/// How wide the names of users run.
const USERS_WIDTH: usize = 56;

fn listed(numbers: &[f64], digits: usize) -> String {
    let width = digits + 6;
    let numbers = numbers.iter().map(|number| format!("{:>width$}", rounded(*number, digits)));
    numbers.collect::<Vec<_>>().join("")
}

fn degrees(numbers: &[f64]) -> Vec<f64> {
    numbers.iter().map(|angle| angle.to_degrees()).collect()
}

/// Those who use something, each once; `?` behind those that are not confirmed.
fn users(uses: &[&'static Use]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for entry in uses {
        let name = format!("{}{}", entry.who, if entry.is_confirmed { "" } else { " (?)" });
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Names with commas, in lines.
fn in_lines(names: &[String], width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for (at, name) in names.iter().enumerate() {
        let comma = if at + 1 < names.len() { "," } else { "" };
        let word = format!("{name}{comma}");
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < width => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}

/// `left` and `right` beside each other, behind a name of 16 columns.
fn beside(out: &mut dyn Write, name: &str, left: &[String], right: &[String]) -> io::Result<()> {
    let width = left.iter().map(|line| line.chars().count()).max().unwrap_or(0).max(44);
    for at in 0..left.len().max(right.len()) {
        let name = if at == 0 { name } else { "" };
        let [left, right] = [left, right].map(|lines| lines.get(at).map_or("", String::as_str));
        writeln!(out, "{}", format!("{name:16}{left:width$}  {right}").trim_end())?;
    }
    Ok(())
}

fn write_sheet(sheet: &Sheet, pasted: &Pasted, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{:16}{} ({})", "read as", sheet.reading, pasted.kind)?;
    for note in &sheet.notes {
        writeln!(out, "{:16}{note}", "")?;
    }
    writeln!(out)?;
    if sheet.has_position {
        let xyz = xyz_of(&sheet.pose);
        let left =
            [format!("m  {}", listed(&xyz, 6)), format!("mm {}", listed(&xyz.map(|x| 1e3 * x), 3))];
        beside(out, "position", &left, &[])?;
    }
    for row in &sheet.rows {
        write_row(row, out)?;
    }
    let others: Vec<&Row> = sheet.rows.iter().filter(|row| row.uses.is_empty()).collect();
    writeln!(out, "\nother orders, °")?;
    for pair in others.chunks(2) {
        let shown = pair.iter().map(|row| {
            let mark = if row.is_near_lock() { "!" } else { " " };
            format!("{:15}{mark}{}", row.form.to_string(), listed(&degrees(&row.numbers), 4))
        });
        writeln!(out, "{}", shown.collect::<Vec<_>>().join("    ").trim_end())?;
    }
    if others.iter().any(|row| row.is_near_lock()) {
        writeln!(out, "! within 5° of gimbal lock")?;
    }
    let of_numbers = format!("code, from {}", sheet.reading.form);
    for (title, lines) in [
        (of_numbers.as_str(), &sheet.code_of_numbers),
        ("code, from the quaternion", &sheet.code_of_quaternion),
    ] {
        if lines.is_empty() {
            continue;
        }
        writeln!(out, "\n{title}")?;
        for line in lines {
            writeln!(out, "{:20}{}", line.library, line.line)?;
        }
    }
    Ok(())
}

/// A convention that somebody uses.
fn write_row(row: &Row, out: &mut dyn Write) -> io::Result<()> {
    if row.uses.is_empty() {
        return Ok(());
    }
    let mut left = match row.form {
        Coding::Three(_) => vec![
            format!("deg{}", listed(&degrees(&row.numbers), 4)),
            format!("rad{}", listed(&row.numbers, 6)),
        ],
        Coding::Xyzw | Coding::Wxyz => vec![format!("   {}", listed(&row.numbers, 6))],
        Coding::Rows => {
            row.numbers.chunks(3).map(|line| format!("   {}", listed(line, 6))).collect()
        }
        // Those of the rows, turned.
        Coding::Columns => vec!["   the same, column by column".to_owned()],
    };
    if let (true, Some(margin_rad)) = (row.is_near_lock(), row.gimbal_margin_rad) {
        left.push(format!("   {:.2}° from gimbal lock", margin_rad.to_degrees()));
    }
    let mut names = users(&row.uses);
    let named = row.names.iter().filter(|library| !library.who.starts_with("SciPy"));
    names.extend(named.map(|library| format!("{} {}", library.who, library.name)));
    beside(out, &row.form.to_string(), &left, &in_lines(&names, USERS_WIDTH))
}

fn write_candidates(
    candidates: &[Candidate],
    notes: &[String],
    out: &mut dyn Write,
) -> io::Result<()> {
    writeln!(
        out,
        "{:16}the numbers do not say in which convention they are; --from does",
        "left open"
    )?;
    for note in notes {
        writeln!(out, "{:16}{note}", "")?;
    }
    writeln!(out, "\n{:16}{:46}used by", "if it is", "the rotation is x y z w")?;
    for candidate in candidates {
        let left = [listed(&xyzw_from_rotation(&candidate.pose.rotation), 6)];
        let right = in_lines(&users(&candidate.uses), USERS_WIDTH);
        beside(out, &candidate.reading.form.to_string(), &left, &right)?;
    }
    let makers: Vec<String> = vendors::names().map(str::to_owned).collect();
    writeln!(out)?;
    for (at, line) in in_lines(&makers, 80).iter().enumerate() {
        writeln!(out, "{:16}{line}", if at == 0 { "also --from" } else { "" })?;
    }
    Ok(())
}

fn left(residual: &Residual) -> String {
    let mut left = format!("{:.2}°", residual.rotation_rad.to_degrees());
    if let Some(position_m) = residual.position_m {
        left += &format!(", {:.2} mm", 1e3 * position_m);
    }
    left
}

/// Position in mm, then roll, pitch and yaw in degrees.
fn frame_text(pose: &Pose) -> String {
    let joined = |numbers: &[f64]| {
        let numbers: Vec<String> = numbers.iter().map(|number| rounded(*number, 2)).collect();
        numbers.join(" ")
    };
    let xyz = joined(&xyz_of(pose).map(|x| 1e3 * x));
    let rpy = joined(&degrees(&Convention::RPY.numbers(&pose.rotation)));
    format!("xyz {xyz} mm, rpy {rpy}°")
}

fn write_answer(answer: &Answer, pairs: usize, out: &mut dyn Write) -> io::Result<()> {
    let of = if pairs == 1 { "one pair".to_owned() } else { format!("{pairs} pairs, rms") };
    let head = match answer.verdict {
        Verdict::Reconciled => "reconciled",
        Verdict::Ambiguous => "ambiguous",
        Verdict::Open => "not reconciled",
    };
    if answer.hypotheses.is_empty() {
        writeln!(out, "{head:16}nothing that was tried comes near")?;
    }
    let mut last = "";
    for (at, hypothesis) in answer.hypotheses.iter().enumerate() {
        if at < answer.as_good.max(1) {
            write_hypothesis(if at == 0 { head } else { "or as well" }, hypothesis, &of, out)?;
            continue;
        }
        let label = if hypothesis.residual.agrees() { "the longer way" } else { "worse" };
        let name = if label == last { "" } else { label };
        last = label;
        writeln!(out, "{name:16}{:22}{}", left(&hypothesis.residual), in_short(hypothesis))?;
    }
    write_cautions(answer, out)
}

fn write_hypothesis(
    name: &str,
    hypothesis: &Hypothesis,
    of: &str,
    out: &mut dyn Write,
) -> io::Result<()> {
    let claims = hypothesis.claims();
    let mut name = name;
    let mut line = |out: &mut dyn Write, text: &str| {
        let done = writeln!(out, "{name:16}{text}");
        name = "";
        done
    };
    line(out, &format!("{} left ({of})", left(&hypothesis.residual)))?;
    for (side, reading) in [("is ", hypothesis.is), ("but", hypothesis.but)] {
        let names = in_lines(&users(&uses_with_units(&reading)), USERS_WIDTH);
        let names = names.first().map_or(String::new(), |first| match names.len() {
            1 => first.clone(),
            _ => format!("{first} …"),
        });
        line(out, format!("{side}  {:24}{names}", reading.to_string()).trim_end())?;
    }
    for claim in &claims {
        line(out, claim)?;
    }
    match &hypothesis.tool {
        Tool::None => {}
        Tool::Frames(frames) => {
            let transform = frame_text(&frames.transform);
            line(out, &format!("{} → {}: {transform}", frames.is, frames.but))?;
            if !frames.also.is_empty() {
                line(out, &format!("as far apart: {}", frames.also.join(", ")))?;
            }
        }
        Tool::Fitted(tool) => line(out, &format!("tool: {}", frame_text(tool)))?,
    }
    if !hypothesis.equivalents.is_empty() {
        let names = equivalents(hypothesis);
        line(out, "these numbers cannot tell it from:")?;
        for names in in_lines(&names, 80) {
            line(out, &format!("  {names}"))?;
        }
    }
    Ok(())
}

/// The other readings that leave as much.
fn equivalents(hypothesis: &Hypothesis) -> Vec<String> {
    let (alike, unlike): (Vec<&[Reading; 2]>, Vec<&[Reading; 2]>) =
        hypothesis.equivalents.iter().partition(|[is, but]| is.form == but.form);
    let mut names: Vec<String> = Vec::new();
    for [is, but] in unlike {
        let name = match (is.form == hypothesis.is.form, but.form == hypothesis.but.form) {
            (true, _) => format!("`but` as {}", but.form),
            (_, true) => format!("`is` as {}", is.form),
            _ => format!("{} and {}", is.form, but.form),
        };
        if !names.contains(&name) {
            names.push(name);
        }
    }
    match alike.as_slice() {
        [] => {}
        [[both, _]] => names.push(format!("both as {}", both.form)),
        several => names.push(format!("both in one of {} other conventions", several.len())),
    }
    names
}

/// An explanation on one line.
fn in_short(hypothesis: &Hypothesis) -> String {
    let mut parts = vec![format!("is {}; but {}", hypothesis.is, hypothesis.but)];
    parts.extend(hypothesis.claims());
    parts.join("; ")
}

/// Those who use the form of `reading` in its units.
fn uses_with_units(reading: &Reading) -> Vec<&'static Use> {
    let in_units = |entry: &&'static Use| {
        (!reading.has_position || entry.units.length == Some(reading.length))
            && (!reading.form.has_angles() || entry.units.angle == Some(reading.angle))
    };
    vendors::uses_of(reading.form).filter(in_units).collect()
}

fn write_cautions(answer: &Answer, out: &mut dyn Write) -> io::Result<()> {
    if let Some(would_do) = &answer.would_do {
        let what = match would_do.is_translation {
            true => "the rotations agree; this constant tool would do for the rest",
            false => "this constant tool would do, as some tool does for any one pair",
        };
        writeln!(out, "\n{:16}{what}; several pairs would tell", "no claim")?;
        writeln!(out, "{:16}tool: {}", "", frame_text(&would_do.tool))?;
    }
    if let Some(by_chance) = answer.by_chance.filter(|by_chance| *by_chance >= 0.01)
        && answer.verdict != Verdict::Open
    {
        writeln!(
            out,
            "\n{:16}{} readings were tried; of as many random rotations {by_chance:.2} would come as close",
            "chance", answer.tried
        )?;
    }
    for note in &answer.notes {
        writeln!(out, "\n{:16}{note}", "caution")?;
    }
    Ok(())
}

fn pose_as_json(pose: &Pose) -> Value {
    let matrix = pose.to_homogeneous();
    let rows: [[f64; 4]; 4] =
        std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] + 0.0));
    json!({
        "xyz_m": xyz_of(pose),
        "xyzw": xyzw_from_rotation(&pose.rotation),
        "matrix": rows,
    })
}

fn reading_as_json(reading: &Reading) -> Value {
    let angle = reading.form.has_angles().then(|| reading.angle.symbol());
    json!({
        "convention": reading.form.to_string(),
        "angles": angle,
        "lengths": reading.has_position.then(|| reading.length.to_string()),
    })
}

fn uses_as_json(uses: &[&'static Use]) -> Vec<Value> {
    let entry = |entry: &&'static Use| {
        json!({
            "who": entry.who,
            "what": entry.what,
            "units": entry.units.to_string(),
            "confirmed": entry.is_confirmed,
            "source": entry.source,
        })
    };
    uses.iter().map(entry).collect()
}

fn sheets_as_json(sheets: &Sheets) -> Value {
    let schema = "poseaudit.pose/1";
    match sheets {
        Sheets::One(sheet) => {
            let rows = sheet.rows.iter().map(|row| {
                let names = row
                    .names
                    .iter()
                    .map(|library| json!({"who": library.who, "name": library.name}));
                json!({
                    "convention": row.form.to_string(),
                    "numbers": row.numbers,
                    "gimbal_margin_rad": row.gimbal_margin_rad,
                    "used_by": uses_as_json(&row.uses),
                    "called": names.collect::<Vec<_>>(),
                })
            });
            let code = sheet.code_of_numbers.iter().chain(&sheet.code_of_quaternion);
            let code = code.map(|line| json!({"library": line.library, "line": line.line}));
            json!({
                "schema": schema,
                "read_as": reading_as_json(&sheet.reading),
                "notes": sheet.notes,
                "has_position": sheet.has_position,
                "pose": pose_as_json(&sheet.pose),
                "conventions": rows.collect::<Vec<_>>(),
                "code": code.collect::<Vec<_>>(),
            })
        }
        Sheets::Several { candidates, notes } => {
            let candidates = candidates.iter().map(|candidate| {
                json!({
                    "read_as": reading_as_json(&candidate.reading),
                    "pose": pose_as_json(&candidate.pose),
                    "used_by": uses_as_json(&candidate.uses),
                })
            });
            json!({"schema": schema, "notes": notes, "candidates": candidates.collect::<Vec<_>>()})
        }
    }
}

fn answer_as_json(answer: &Answer, pairs: usize) -> Value {
    let hypotheses: Vec<Value> = answer.hypotheses.iter().map(hypothesis_as_json).collect();
    let would_do = answer.would_do.as_ref().map(|would_do| {
        json!({"is_from_but": pose_as_json(&would_do.tool), "is_translation": would_do.is_translation})
    });
    json!({
        "schema": "poseaudit.reconciled/1",
        "verdict": match answer.verdict {
            Verdict::Reconciled => "reconciled",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Open => "open",
        },
        "pairs": pairs,
        "as_good": answer.as_good,
        "hypotheses": hypotheses,
        "would_do": would_do,
        "tried": answer.tried,
        "by_chance": answer.by_chance,
        "notes": answer.notes,
    })
}

fn hypothesis_as_json(hypothesis: &Hypothesis) -> Value {
    let equivalents = hypothesis
        .equivalents
        .iter()
        .map(|[is, but]| json!({"is": reading_as_json(is), "but": reading_as_json(but)}));
    let base = hypothesis.base.as_ref().map(|base| {
        json!({"is": base.is, "but": base.but, "arms": base.arms, "but_from_is": pose_as_json(&base.transform)})
    });
    let tool = match &hypothesis.tool {
        Tool::None => Value::Null,
        Tool::Frames(tip) => {
            json!({"is": tip.is, "but": tip.but, "arms": tip.arms, "also": tip.also, "is_from_but": pose_as_json(&tip.transform)})
        }
        Tool::Fitted(tool) => json!({"fitted": true, "is_from_but": pose_as_json(tool)}),
    };
    let residual = &hypothesis.residual;
    json!({
        "is": reading_as_json(&hypothesis.is),
        "but": reading_as_json(&hypothesis.but),
        "inversion": match hypothesis.inversion {
            Inversion::None => Value::Null,
            Inversion::Pose => "pose-inverse".into(),
            Inversion::Rotation => "transpose".into(),
        },
        "misreading": hypothesis.misreading.map(|misreading| {
            json!({"is": misreading.is.to_string(), "read_as": misreading.read_as.to_string()})
        }),
        "base": base,
        "tool": tool,
        "claims": hypothesis.claims(),
        "residual": {
            "rotation_rad": residual.rotation_rad,
            "position_m": residual.position_m,
            "worst_rotation_rad": residual.worst_rotation_rad,
            "worst_position_m": residual.worst_position_m,
        },
        "agrees": residual.agrees(),
        "score": hypothesis.score,
        "equivalents": equivalents.collect::<Vec<_>>(),
    })
}
