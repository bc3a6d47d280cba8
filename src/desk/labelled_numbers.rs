//! Parses poses whose numbers have names or units, as printed by controllers.

use super::encoding::KnownEncoding;
use super::error::DeskError;
use super::parse::PoseText;
use crate::geometry::{AngleUnit, Convention, LengthScale, RotationEncoding, Units, vendors};

enum Token<'a> {
    Number(f64),
    Word(&'a str),
    Mark(char),
}

struct NumberNames {
    names: &'static [&'static str],
    rotation: Option<RotationEncoding>,
    /// Name in the table of conventions.
    vendor: Option<&'static str>,
    kind: &'static str,
}

const NUMBER_NAMES: [NumberNames; 8] = [
    number_names(
        &["qx", "qy", "qz", "qw"],
        Some(RotationEncoding::Xyzw),
        None,
        "numbers with names",
    ),
    number_names(&["q1", "q2", "q3", "q4"], None, Some("abb"), "ABB's numbers with names"),
    number_names(
        &["roll", "pitch", "yaw"],
        Some(RotationEncoding::Three(Convention::RPY)),
        None,
        "roll, pitch, yaw",
    ),
    number_names(&["a", "b", "c"], None, Some("kuka"), "X, Y, Z, A, B, C"),
    number_names(&["w", "p", "r"], None, Some("fanuc"), "FANUC's X, Y, Z, W, P, R"),
    number_names(&["u", "v", "w"], None, Some("epson"), "Epson's X, Y, Z, U, V, W"),
    number_names(&["o", "a", "t"], None, Some("kawasaki"), "Kawasaki's X, Y, Z, O, A, T"),
    number_names(&["rx", "ry", "rz"], None, None, "numbers with names"),
];

const fn number_names(
    names: &'static [&'static str],
    coding: Option<RotationEncoding>,
    vendor: Option<&'static str>,
    kind: &'static str,
) -> NumberNames {
    NumberNames { names, rotation: coding, vendor, kind }
}

/// `None` if the numbers have neither names nor units.
///
/// # Errors
/// If a name occurs twice.
pub(super) fn parse_labelled(text: &str) -> Result<Option<PoseText>, DeskError> {
    let tokens = tokenize(text);
    let units = units_in(&tokens);
    let mut found: Vec<(String, f64)> = Vec::new();
    let mut name = None;
    for token in &tokens {
        match token {
            Token::Word(word) => name = Some(word.to_ascii_lowercase()),
            Token::Mark('=' | ':') => {}
            Token::Mark(_) => name = None,
            Token::Number(number) => found.extend(name.take().map(|name| (name, *number))),
        }
    }
    let value = |name: &str| found.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
    let values =
        |names: &[&str]| names.iter().map(|name| value(name)).collect::<Option<Vec<f64>>>();
    let rotation = NUMBER_NAMES.iter().find_map(|set| Some((set, values(set.names)?)));
    let Some((set, rotation)) = rotation else {
        return Ok(parse_numbers_with_units(&tokens, units));
    };
    let position = values(&["x", "y", "z"]).unwrap_or_default();
    let count = |name: &&str| found.iter().filter(|(known, _)| known == name).count();
    if let Some(count) = set.names.iter().map(count).find(|count| *count > 1) {
        return Err(DeskError::Several(count));
    }
    // Mitsubishi also uses A, B and C, about x, y and z; only KUKA encloses them in braces.
    let is_vendor_certain = set.vendor != Some("kuka") || text.contains('{');
    let vendor = set.vendor.filter(|_| is_vendor_certain).and_then(vendors::find);
    let known = KnownEncoding {
        rotation: set.rotation.or(vendor.map(|vendor| vendor.coding)),
        units: units.or(vendor.map_or_else(Units::default, |vendor| vendor.units)),
    };
    Ok(Some(PoseText::new([position, rotation].concat(), known, set.kind)))
}

fn parse_numbers_with_units(tokens: &[Token], units: Units) -> Option<PoseText> {
    let words = tokens.iter().filter(|token| matches!(token, Token::Word(_))).count();
    let of_units = tokens.iter().filter(|token| unit_of(token).is_some()).count();
    if words == 0 || words != of_units {
        return None;
    }
    let numbers = tokens.iter().filter_map(|token| match token {
        Token::Number(number) => Some(*number),
        _ => None,
    });
    let known = KnownEncoding { rotation: None, units };
    Some(PoseText::new(numbers.collect(), known, "numbers with units"))
}

/// The first if there are several.
fn units_in(tokens: &[Token]) -> Units {
    let mut units = Units::default();
    for found in tokens.iter().filter_map(unit_of) {
        units = units.or(found);
    }
    units
}

fn unit_of(token: &Token) -> Option<Units> {
    let Token::Word(word) = token else { return None };
    let length = |length: LengthScale| Units { length: Some(length), angle: None };
    let angle = |angle: AngleUnit| Units { length: None, angle: Some(angle) };
    Some(match *word {
        "m" => length(LengthScale::METRE),
        "mm" => length(LengthScale::MILLIMETRE),
        "cm" => length(LengthScale::from_m(1e-2)),
        "µm" | "um" => length(LengthScale::from_m(1e-6)),
        "in" | "inch" => length(LengthScale::from_m(0.0254)),
        "rad" => angle(AngleUnit::Radian),
        "deg" | "°" | "degree" | "degrees" => angle(AngleUnit::Degree),
        _ => return None,
    })
}

fn tokenize(text: &str) -> Vec<Token<'_>> {
    let mut tokens = Vec::new();
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let begins_number = first.is_ascii_digit() || "+-.−".contains(first);
        let length = match begins_number {
            true => number_length(rest),
            false => word_length(rest),
        };
        let (token, after) = rest.split_at(length.max(first.len_utf8()));
        let number = begins_number.then(|| token.replace('−', "-").parse().ok()).flatten();
        tokens.push(match number {
            Some(number) => Token::Number(number),
            None if length > 0 && !begins_number => Token::Word(token),
            None => Token::Mark(first),
        });
        rest = after.trim_start();
    }
    tokens
}

/// Length in bytes, with sign and exponent.
fn number_length(text: &str) -> usize {
    let mut last = ' ';
    let mut chars = text.char_indices().peekable();
    while let Some((at, c)) = chars.next() {
        let is_sign = "+-−".contains(c) && (at == 0 || "eE".contains(last));
        let next = chars.peek().map(|(_, next)| *next);
        let is_exponent = "eE".contains(c)
            && (last.is_ascii_digit() || last == '.')
            && next.is_some_and(|next| next.is_ascii_digit() || "+-".contains(next));
        if !(c.is_ascii_digit() || c == '.' || is_sign || is_exponent) {
            return at;
        }
        last = c;
    }
    text.len()
}

fn word_length(text: &str) -> usize {
    let is_of_word = |c: char| c.is_alphanumeric() || c == '_' || c == '°';
    text.find(|c| !is_of_word(c)).unwrap_or(text.len())
}

/// Innermost bracketed groups, as nested in RAPID and VAL3.
pub(super) fn bracketed_groups(text: &str, [open, close]: [char; 2]) -> Vec<Vec<f64>> {
    let mut groups = Vec::new();
    let mut inner = None;
    for (at, c) in text.char_indices() {
        if c == open {
            inner = Some(at + c.len_utf8());
        } else if c == close
            && let Some(from) = inner.take()
        {
            let numbers = tokenize(&text[from..at]).into_iter().map(|token| match token {
                Token::Number(number) => Some(Some(number)),
                Token::Mark(',') => Some(None),
                _ => None,
            });
            let numbers: Option<Vec<Option<f64>>> = numbers.collect();
            groups.push(numbers.unwrap_or_default().into_iter().flatten().collect());
        }
    }
    groups
}
