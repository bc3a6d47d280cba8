//! Pose desk results as text.

use std::io::{self, Write};

use super::{
    ConventionRow, ConversionCandidate, ConversionResult, EndTransform, Hypothesis, NumberEncoding,
    PoseConversions, PoseText, ReconcileVerdict, Reconciliation, Residual, SinglePairOffsets,
};
use crate::finding::rounded;
use crate::geometry::vendors::{self, VendorUse};
use crate::geometry::{Convention, Pose, RotationEncoding, xyz_of, xyzw_from_rotation};

const MAX_USERS_WIDTH: usize = 56;

fn format_numbers(numbers: &[f64], digits: usize) -> String {
    let width = digits + 5;
    let numbers = numbers.iter().map(|number| format!(" {:>width$}", rounded(*number, digits)));
    numbers.collect()
}

fn to_degrees(numbers: &[f64]) -> Vec<f64> {
    numbers.iter().map(|angle| angle.to_degrees()).collect()
}

/// Unconfirmed ones are marked with `(?)`.
fn user_names(uses: &[&'static VendorUse]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for entry in uses {
        let name = format!("{}{}", entry.who, if entry.is_confirmed { "" } else { " (?)" });
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

fn wrap_names(names: &[String], width: usize) -> Vec<String> {
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
fn write_side_by_side(
    out: &mut dyn Write,
    name: &str,
    left: &[String],
    right: &[String],
) -> io::Result<()> {
    let width = left.iter().map(|line| line.chars().count()).max().unwrap_or(0).max(44);
    for at in 0..left.len().max(right.len()) {
        let name = if at == 0 { name } else { "" };
        let [left, right] = [left, right].map(|lines| lines.get(at).map_or("", String::as_str));
        writeln!(out, "{}", format!("{name:15} {left:width$}  {right}").trim_end())?;
    }
    Ok(())
}

/// Writes the result for one pose.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_conversions(
    conversions: &ConversionResult,
    pose_text: &PoseText,
    out: &mut dyn Write,
) -> io::Result<()> {
    match conversions {
        ConversionResult::Determined(conversions) => write_determined(conversions, pose_text, out),
        ConversionResult::Ambiguous { candidates, notes } => {
            write_candidates(candidates, notes, true, out)
        }
    }
}

fn write_determined(
    conversions: &PoseConversions,
    pose_text: &PoseText,
    out: &mut dyn Write,
) -> io::Result<()> {
    writeln!(out, "{:16}{} ({})", "read as", conversions.encoding, pose_text.kind)?;
    for note in &conversions.notes {
        writeln!(out, "{:16}{note}", "")?;
    }
    writeln!(out)?;
    if conversions.has_position {
        let xyz = xyz_of(&conversions.pose);
        let left = [
            format!("m  {}", format_numbers(&xyz, 6)),
            format!("mm {}", format_numbers(&xyz.map(|x| 1e3 * x), 3)),
        ];
        write_side_by_side(out, "position", &left, &[])?;
    }
    for row in &conversions.rows {
        write_row(row, out)?;
    }
    let others: Vec<&ConventionRow> =
        conversions.rows.iter().filter(|row| row.uses.is_empty()).collect();
    writeln!(out, "\nother orders, °")?;
    for pair in others.chunks(2) {
        let shown = pair.iter().map(|row| {
            let mark = if row.is_near_gimbal_lock() { "!" } else { " " };
            format!(
                "{:15}{mark}{}",
                row.rotation.to_string(),
                format_numbers(&to_degrees(&row.numbers), 4)
            )
        });
        writeln!(out, "{}", shown.collect::<Vec<_>>().join("    ").trim_end())?;
    }
    if others.iter().any(|row| row.is_near_gimbal_lock()) {
        writeln!(out, "! within 5° of gimbal lock")?;
    }
    writeln!(out, "\nin other axis conventions, m and x y z w")?;
    for (who, pose) in &conversions.worlds {
        let xyz =
            if conversions.has_position { format_numbers(&xyz_of(pose), 4) } else { String::new() };
        writeln!(out, "{who:32}{xyz}  {}", format_numbers(&xyzw_from_rotation(&pose.rotation), 6))?;
    }
    let of_numbers = format!("code, from {}", conversions.encoding.rotation);
    for (title, lines) in [
        (of_numbers.as_str(), &conversions.numbers_code),
        ("code, from the quaternion", &conversions.quaternion_code),
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

fn write_row(row: &ConventionRow, out: &mut dyn Write) -> io::Result<()> {
    if row.uses.is_empty() {
        return Ok(());
    }
    let mut left = match row.rotation {
        RotationEncoding::Three(_) => vec![
            format!("deg{}", format_numbers(&to_degrees(&row.numbers), 4)),
            format!("rad{}", format_numbers(&row.numbers, 6)),
        ],
        RotationEncoding::Xyzw | RotationEncoding::Wxyz => {
            vec![format!("   {}", format_numbers(&row.numbers, 6))]
        }
        RotationEncoding::Rows => {
            row.numbers.chunks(3).map(|line| format!("   {}", format_numbers(line, 6))).collect()
        }
        // Same values, transposed.
        RotationEncoding::Columns => vec!["   the same, column by column".to_owned()],
        RotationEncoding::TwoColumns | RotationEncoding::TwoRows => {
            vec![format!("   {}", format_numbers(&row.numbers, 6))]
        }
        RotationEncoding::AxisAngle => {
            let angle = row.numbers[3].to_degrees();
            vec![format!("   {}  {}°", format_numbers(&row.numbers[..3], 6), rounded(angle, 4))]
        }
    };
    if let (true, Some(margin_rad)) = (row.is_near_gimbal_lock(), row.gimbal_margin_rad) {
        left.push(format!("   {:.2}° from gimbal lock", margin_rad.to_degrees()));
    }
    let mut names = user_names(&row.uses);
    let named = row.names.iter().filter(|library| !library.who.starts_with("SciPy"));
    names.extend(named.map(|library| format!("{} {}", library.who, library.name)));
    write_side_by_side(out, &row.rotation.to_string(), &left, &wrap_names(&names, MAX_USERS_WIDTH))
}

/// Writes the possible conventions of ambiguous numbers; without `all`, one line for each.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_candidates(
    candidates: &[ConversionCandidate],
    notes: &[String],
    all: bool,
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
        let left = [format_numbers(&xyzw_from_rotation(&candidate.pose.rotation), 6)];
        let mut right = wrap_names(&user_names(&candidate.uses), MAX_USERS_WIDTH);
        if right.len() > 1 && !all {
            right.truncate(1);
            right[0] += " …";
        }
        write_side_by_side(out, &candidate.encoding.rotation.to_string(), &left, &right)?;
    }
    if !all {
        return writeln!(
            out,
            "{:16}--all: everyone who uses each, and all names for --from",
            "more"
        );
    }
    let vendor_names: Vec<String> = vendors::names().map(str::to_owned).collect();
    writeln!(out)?;
    for (at, line) in wrap_names(&vendor_names, 80).iter().enumerate() {
        writeln!(out, "{:16}{line}", if at == 0 { "also --from" } else { "" })?;
    }
    Ok(())
}

fn format_residual(residual: &Residual) -> String {
    let mut text = format!("{:.2}°", residual.rotation_rad.to_degrees());
    if let Some(position_m) = residual.position_m {
        text += &format!(", {:.2} mm", 1e3 * position_m);
    }
    text
}

/// Position in mm, rpy in degrees.
fn frame_text(pose: &Pose) -> String {
    let joined = |numbers: &[f64]| {
        let numbers: Vec<String> = numbers.iter().map(|number| rounded(*number, 2)).collect();
        numbers.join(" ")
    };
    let xyz = joined(&xyz_of(pose).map(|x| 1e3 * x));
    let rpy = joined(&to_degrees(&Convention::RPY.numbers(&pose.rotation)));
    format!("xyz {xyz} mm, rpy {rpy}°")
}

/// Writes the result for pairs of poses.
///
/// # Errors
/// If `out` cannot be written.
pub fn write_reconciliation(
    answer: &Reconciliation,
    pairs: usize,
    out: &mut dyn Write,
) -> io::Result<()> {
    let of = if pairs == 1 { "one pair".to_owned() } else { format!("{pairs} pairs, rms") };
    let head = match answer.verdict {
        ReconcileVerdict::Reconciled => "reconciled",
        ReconcileVerdict::Ambiguous => "ambiguous",
        ReconcileVerdict::Unexplained => "not reconciled",
    };
    let apart = answer.single_pair_offsets.as_ref().and_then(SinglePairOffsets::translation_text);
    let apart = apart.filter(|_| answer.verdict == ReconcileVerdict::Unexplained);
    if let Some(apart) = &apart {
        writeln!(out, "orientations agree, {apart}")?;
    }
    if answer.hypotheses.is_empty() {
        writeln!(out, "{head:16}no explanation comes close")?;
    }
    let mut last = "";
    for (at, hypothesis) in answer.hypotheses.iter().enumerate() {
        if at < answer.equally_good.max(1) {
            write_hypothesis(if at == 0 { head } else { "equally good" }, hypothesis, &of, out)?;
            continue;
        }
        // The remaining difference is listed separately.
        if apart.is_some() {
            break;
        }
        let label = if hypothesis.residual.is_agreement() { "more complex" } else { "worse" };
        let name = if label == last { "" } else { label };
        last = label;
        writeln!(
            out,
            "{name:15} {:21} {}",
            format_residual(&hypothesis.residual),
            short_text(hypothesis)
        )?;
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
        let done = writeln!(out, "{name:15} {text}");
        name = "";
        done
    };
    line(out, &format!("residual {} ({of})", format_residual(&hypothesis.residual)))?;
    for (side, encoding) in [("A", hypothesis.encoding_a), ("B", hypothesis.encoding_b)] {
        let names = wrap_names(&user_names(&uses_with_units(&encoding)), MAX_USERS_WIDTH);
        let names = names.first().map_or(String::new(), |first| match names.len() {
            1 => first.clone(),
            _ => format!("{first} …"),
        });
        line(out, format!("{side}  {:25} {names}", encoding.to_string()).trim_end())?;
    }
    for claim in &claims {
        line(out, claim)?;
    }
    for (name, end) in [("base", &hypothesis.base), ("tool", &hypothesis.tip)] {
        match end {
            EndTransform::None => {}
            EndTransform::Frames(frames) => {
                let transform = frame_text(&frames.transform);
                line(out, &format!("{} → {}: {transform}", frames.frame_a, frames.frame_b))?;
                if !frames.also.is_empty() {
                    line(out, &format!("same transform: {}", frames.also.join(", ")))?;
                }
            }
            EndTransform::Fitted(transform) => {
                line(out, &format!("{name}: {}", frame_text(transform)))?
            }
        }
    }
    for also in &hypothesis.also {
        line(out, &format!("the same as: {also}"))?;
    }
    if !hypothesis.equivalents.is_empty() {
        let names = equivalent_encodings(hypothesis);
        line(out, "these numbers are equally consistent with:")?;
        for names in wrap_names(&names, 80) {
            line(out, &format!("  {names}"))?;
        }
    }
    Ok(())
}

fn equivalent_encodings(hypothesis: &Hypothesis) -> Vec<String> {
    let (alike, unlike): (Vec<&[NumberEncoding; 2]>, Vec<&[NumberEncoding; 2]>) =
        hypothesis.equivalents.iter().partition(|[is, but]| is.rotation == but.rotation);
    let mut names: Vec<String> = Vec::new();
    for [is, but] in unlike {
        let name = match (
            is.rotation == hypothesis.encoding_a.rotation,
            but.rotation == hypothesis.encoding_b.rotation,
        ) {
            (true, _) => format!("B as {}", but.rotation),
            (_, true) => format!("A as {}", is.rotation),
            _ => format!("{} and {}", is.rotation, but.rotation),
        };
        if !names.contains(&name) {
            names.push(name);
        }
    }
    match alike.as_slice() {
        [] => {}
        [[both, _]] => names.push(format!("both as {}", both.rotation)),
        several => names.push(format!("both in one of {} other conventions", several.len())),
    }
    names
}

fn short_text(hypothesis: &Hypothesis) -> String {
    let mut parts = vec![format!("A {}; B {}", hypothesis.encoding_a, hypothesis.encoding_b)];
    parts.extend(hypothesis.claims());
    parts.join("; ")
}

fn write_cautions(answer: &Reconciliation, out: &mut dyn Write) -> io::Result<()> {
    if let Some(offsets) = &answer.single_pair_offsets {
        match offsets.is_translation {
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
        writeln!(out, "{:16}tool: {}", "", frame_text(&offsets.tool))?;
        if offsets.is_translation {
            writeln!(out, "{:16}base: {}", "", frame_text(&offsets.base))?;
        }
    }
    if let Some(expected_by_chance) =
        answer.expected_by_chance.filter(|expected_by_chance| *expected_by_chance >= 0.01)
        && answer.verdict != ReconcileVerdict::Unexplained
    {
        writeln!(
            out,
            "\n{:16}{} encodings tried; expected random matches this close: {expected_by_chance:.2}",
            "chance", answer.tried
        )?;
    }
    for note in &answer.notes {
        writeln!(out, "\n{:16}{note}", "caution")?;
    }
    Ok(())
}

fn uses_with_units(encoding: &NumberEncoding) -> Vec<&'static VendorUse> {
    let in_units = |entry: &&'static VendorUse| {
        (!encoding.has_position || entry.units.length == Some(encoding.length))
            && (!encoding.rotation.has_angles() || entry.units.angle == Some(encoding.angle))
    };
    vendors::uses_of(encoding.rotation).filter(in_units).collect()
}
