//! Pose desk results as text.

use std::io::{self, Write};

use super::{
    Answer, Candidate, End, Hypothesis, Pasted, Reading, Residual, Row, Sheet, Sheets, Verdict,
    WouldDo,
};
use crate::finding::rounded;
use crate::geometry::vendors::{self, VendorUse};
use crate::geometry::{Convention, Pose, RotationEncoding, xyz_of, xyzw_from_rotation};

const USERS_WIDTH: usize = 56;

fn listed(numbers: &[f64], digits: usize) -> String {
    let width = digits + 6;
    let numbers = numbers.iter().map(|number| format!("{:>width$}", rounded(*number, digits)));
    numbers.collect::<Vec<_>>().join("")
}

fn degrees(numbers: &[f64]) -> Vec<f64> {
    numbers.iter().map(|angle| angle.to_degrees()).collect()
}

/// Unconfirmed ones are marked with `(?)`.
fn users(uses: &[&'static VendorUse]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for entry in uses {
        let name = format!("{}{}", entry.who, if entry.is_confirmed { "" } else { " (?)" });
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

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

/// Two columns after a label of 16 characters.
fn beside(out: &mut dyn Write, name: &str, left: &[String], right: &[String]) -> io::Result<()> {
    let width = left.iter().map(|line| line.chars().count()).max().unwrap_or(0).max(44);
    for at in 0..left.len().max(right.len()) {
        let name = if at == 0 { name } else { "" };
        let [left, right] = [left, right].map(|lines| lines.get(at).map_or("", String::as_str));
        writeln!(out, "{}", format!("{name:16}{left:width$}  {right}").trim_end())?;
    }
    Ok(())
}

/// Writes the result for one pose.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_sheets(sheets: &Sheets, pasted: &Pasted, out: &mut dyn Write) -> io::Result<()> {
    match sheets {
        Sheets::One(sheet) => write_sheet(sheet, pasted, out),
        Sheets::Several { candidates, notes } => write_candidates(candidates, notes, out),
    }
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
    writeln!(out, "\nin other axis conventions, m and x y z w")?;
    for (who, pose) in &sheet.worlds {
        let xyz = if sheet.has_position { listed(&xyz_of(pose), 4) } else { String::new() };
        writeln!(out, "{who:32}{xyz}  {}", listed(&xyzw_from_rotation(&pose.rotation), 6))?;
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

fn write_row(row: &Row, out: &mut dyn Write) -> io::Result<()> {
    if row.uses.is_empty() {
        return Ok(());
    }
    let mut left = match row.form {
        RotationEncoding::Three(_) => vec![
            format!("deg{}", listed(&degrees(&row.numbers), 4)),
            format!("rad{}", listed(&row.numbers, 6)),
        ],
        RotationEncoding::Xyzw | RotationEncoding::Wxyz => {
            vec![format!("   {}", listed(&row.numbers, 6))]
        }
        RotationEncoding::Rows => {
            row.numbers.chunks(3).map(|line| format!("   {}", listed(line, 6))).collect()
        }
        // Same values, transposed.
        RotationEncoding::Columns => vec!["   the same, column by column".to_owned()],
        RotationEncoding::TwoColumns | RotationEncoding::TwoRows => {
            vec![format!("   {}", listed(&row.numbers, 6))]
        }
        RotationEncoding::AxisAngle => {
            let angle = row.numbers[3].to_degrees();
            vec![format!("   {}{}°", listed(&row.numbers[..3], 6), rounded(angle, 4))]
        }
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
        "{:16}the numbers do not determine the convention; set it with --from",
        "ambiguous"
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

/// Position in mm, rpy in degrees.
fn frame_text(pose: &Pose) -> String {
    let joined = |numbers: &[f64]| {
        let numbers: Vec<String> = numbers.iter().map(|number| rounded(*number, 2)).collect();
        numbers.join(" ")
    };
    let xyz = joined(&xyz_of(pose).map(|x| 1e3 * x));
    let rpy = joined(&degrees(&Convention::RPY.numbers(&pose.rotation)));
    format!("xyz {xyz} mm, rpy {rpy}°")
}

/// Writes the result for pairs of poses.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_answer(answer: &Answer, pairs: usize, out: &mut dyn Write) -> io::Result<()> {
    let of = if pairs == 1 { "one pair".to_owned() } else { format!("{pairs} pairs, rms") };
    let head = match answer.verdict {
        Verdict::Reconciled => "reconciled",
        Verdict::Ambiguous => "ambiguous",
        Verdict::Open => "not reconciled",
    };
    let apart = answer.would_do.as_ref().and_then(WouldDo::apart);
    let apart = apart.filter(|_| answer.verdict == Verdict::Open);
    if let Some(apart) = &apart {
        writeln!(out, "orientations agree, {apart}")?;
    }
    if answer.hypotheses.is_empty() {
        writeln!(out, "{head:16}no explanation comes close")?;
    }
    let mut last = "";
    for (at, hypothesis) in answer.hypotheses.iter().enumerate() {
        if at < answer.as_good.max(1) {
            write_hypothesis(if at == 0 { head } else { "equally good" }, hypothesis, &of, out)?;
            continue;
        }
        // The remaining difference is listed separately.
        if apart.is_some() {
            break;
        }
        let label = if hypothesis.residual.agrees() { "more complex" } else { "worse" };
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
    line(out, &format!("residual {} ({of})", left(&hypothesis.residual)))?;
    for (side, reading) in [("A", hypothesis.is), ("B", hypothesis.but)] {
        let names = in_lines(&users(&uses_with_units(&reading)), USERS_WIDTH);
        let names = names.first().map_or(String::new(), |first| match names.len() {
            1 => first.clone(),
            _ => format!("{first} …"),
        });
        line(out, format!("{side}  {:25} {names}", reading.to_string()).trim_end())?;
    }
    for claim in &claims {
        line(out, claim)?;
    }
    for (name, end) in [("base", &hypothesis.base), ("tool", &hypothesis.tip)] {
        match end {
            End::None => {}
            End::Frames(frames) => {
                let transform = frame_text(&frames.transform);
                line(out, &format!("{} → {}: {transform}", frames.is, frames.but))?;
                if !frames.also.is_empty() {
                    line(out, &format!("same transform: {}", frames.also.join(", ")))?;
                }
            }
            End::Fitted(transform) => line(out, &format!("{name}: {}", frame_text(transform)))?,
        }
    }
    for also in &hypothesis.also {
        line(out, &format!("the same as: {also}"))?;
    }
    if !hypothesis.equivalents.is_empty() {
        let names = equivalents(hypothesis);
        line(out, "these numbers are equally consistent with:")?;
        for names in in_lines(&names, 80) {
            line(out, &format!("  {names}"))?;
        }
    }
    Ok(())
}

fn equivalents(hypothesis: &Hypothesis) -> Vec<String> {
    let (alike, unlike): (Vec<&[Reading; 2]>, Vec<&[Reading; 2]>) =
        hypothesis.equivalents.iter().partition(|[is, but]| is.form == but.form);
    let mut names: Vec<String> = Vec::new();
    for [is, but] in unlike {
        let name = match (is.form == hypothesis.is.form, but.form == hypothesis.but.form) {
            (true, _) => format!("B as {}", but.form),
            (_, true) => format!("A as {}", is.form),
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

fn in_short(hypothesis: &Hypothesis) -> String {
    let mut parts = vec![format!("A {}; B {}", hypothesis.is, hypothesis.but)];
    parts.extend(hypothesis.claims());
    parts.join("; ")
}

fn write_cautions(answer: &Answer, out: &mut dyn Write) -> io::Result<()> {
    if let Some(would_do) = &answer.would_do {
        match would_do.is_translation {
            true => writeln!(
                out,
                "\n{:16}probably a TCP or a base offset; give a second pair with another orientation",
                "to confirm"
            )?,
            false => writeln!(
                out,
                "\n{:16}some constant tool explains any single pair; give more pairs",
                "not enough data"
            )?,
        }
        writeln!(out, "{:16}tool: {}", "", frame_text(&would_do.tool))?;
        if would_do.is_translation {
            writeln!(out, "{:16}base: {}", "", frame_text(&would_do.base))?;
        }
    }
    if let Some(by_chance) = answer.by_chance.filter(|by_chance| *by_chance >= 0.01)
        && answer.verdict != Verdict::Open
    {
        writeln!(
            out,
            "\n{:16}{} encodings tried; expected random matches this close: {by_chance:.2}",
            "chance", answer.tried
        )?;
    }
    for note in &answer.notes {
        writeln!(out, "\n{:16}{note}", "caution")?;
    }
    Ok(())
}

fn uses_with_units(reading: &Reading) -> Vec<&'static VendorUse> {
    let in_units = |entry: &&'static VendorUse| {
        (!reading.has_position || entry.units.length == Some(reading.length))
            && (!reading.form.has_angles() || entry.units.angle == Some(reading.angle))
    };
    vendors::uses_of(reading.form).filter(in_units).collect()
}
