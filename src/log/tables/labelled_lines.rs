//! Lines that a program prints with labels between the numbers: `Time: 6.5 Joint Angle [0.1, 0.2]`. The labels, which are
//! the same in each line, become column names.

use super::MAX_COLUMNS;
use super::csv::{TextLayout, comment, is_unit, lines, number};

/// Lines searched for labels, and how many of them must have the same.
const MAX_HEAD_LINES: usize = 50;
const MIN_LINES: usize = 3;
const MIN_NUMBERS: usize = 3;
const DELIMITER: u8 = b'\t';

/// The text with tabs between the numbers of each line, and the layout of these rows. Other lines are copied, so that
/// lines keep their positions. `None` unless most lines have the same labels.
pub(super) fn to_table(bytes: &[u8]) -> Option<(Vec<u8>, TextLayout)> {
    let head = lines(bytes).filter(|(_, _, line)| comment(line).is_none());
    let head: Vec<(usize, usize, &[u8])> = head.take(MAX_HEAD_LINES).collect();
    let (offset, line, first) = head
        .iter()
        .find_map(|&(offset, line, text)| Some((offset, line, LabelledLine::parse(text)?)))?;
    let numbers_of = |line: &[u8]| {
        let own = LabelledLine::parse(line)?;
        let is_row = own.labels == first.labels && own.units == first.units;
        is_row.then(|| own.numbers.join(&DELIMITER))
    };
    let rows = head.iter().filter(|(_, _, line)| numbers_of(line).is_some()).count();
    if rows < MIN_LINES || 2 * rows <= head.len() {
        return None;
    }
    let row = |line: &[u8]| numbers_of(line).unwrap_or_else(|| line.to_vec());
    let text: Vec<Vec<u8>> = bytes[offset..].split(|byte| *byte == b'\n').map(row).collect();
    let names = first.names();
    let width = names.len();
    let layout = TextLayout { delimiter: DELIMITER, names: Some(names), width, rows_at: 0, line };
    Some((text.join(&b'\n'), layout))
}

/// Numbers of a line with their units. `labels` are the texts before each number and behind the last.
#[derive(Default)]
struct LabelledLine<'a> {
    labels: Vec<&'a [u8]>,
    numbers: Vec<&'a [u8]>,
    units: Vec<&'a [u8]>,
}

impl<'a> LabelledLine<'a> {
    /// `None` without a label that ends in a colon, an equals sign or a bracket.
    fn parse(line: &'a [u8]) -> Option<Self> {
        let mut own = Self::default();
        let (mut label_from, mut at) = (0, 0);
        while at < line.len() {
            let end = at + word(&line[at..]).len();
            let from = at + label_length(&line[at..end]);
            let (value, mut unit) = split_unit(&line[from..end]);
            if !number(value, b',').is_finite() && !value.eq_ignore_ascii_case(b"nan") {
                at = end + 1;
                continue;
            }
            own.labels.push(line[label_from..from].trim_ascii());
            own.numbers.push(value);
            at = end;
            let next = line[end..].trim_ascii_start();
            if unit.is_empty() && is_unit(word(next)) {
                unit = word(next);
                at = line.len() - next.len() + unit.len();
            }
            own.units.push(unit);
            label_from = at;
        }
        own.labels.push(line[label_from..].trim_ascii());
        let is_set = |label: &&[u8]| label.last().is_some_and(|byte| b":=[({".contains(byte));
        let is_labelled = own.labels.iter().any(|label| is_set(label) && has_letters(label));
        let is_row = (MIN_NUMBERS..=MAX_COLUMNS).contains(&own.numbers.len());
        (is_labelled && is_row).then_some(own)
    }

    /// A label names all numbers up to the next one.
    fn names(&self) -> Vec<String> {
        let starts = |at: usize| at == 0 || has_letters(self.labels[at]);
        let name = |at: usize| {
            let first = (0..=at).rev().find(|at| starts(*at)).unwrap_or(0);
            let is_alone = first == at && (at + 1 == self.numbers.len() || starts(at + 1));
            let label = String::from_utf8_lossy(self.labels[first]);
            let name = match bare(&label) {
                "" => format!("column {at}"),
                label if is_alone => label.to_owned(),
                label => format!("{label}[{}]", at - first),
            };
            match String::from_utf8_lossy(self.units[at]) {
                unit if unit.is_empty() => name,
                unit => format!("{name} [{unit}]"),
            }
        };
        (0..self.numbers.len()).map(name).collect()
    }
}

fn has_letters(text: &[u8]) -> bool {
    text.iter().any(u8::is_ascii_alphabetic)
}

/// Up to a blank, a separator or a bracket.
fn word(text: &[u8]) -> &[u8] {
    let is_end = |byte: &u8| byte.is_ascii_whitespace() || b",;|[](){}".contains(byte);
    text.split(is_end).next().unwrap_or_default()
}

/// Length of a label attached to its number, as in `x=0.1` or `x:0.1`.
fn label_length(word: &[u8]) -> usize {
    let is_mark = |byte: &u8| *byte == b'=' || (*byte == b':' && has_letters(word));
    word.iter().rposition(is_mark).map_or(0, |mark| mark + 1)
}

/// A number and its unit, as in `6.5s`.
fn split_unit(word: &[u8]) -> (&[u8], &[u8]) {
    let digits = word.iter().rposition(|byte| byte.is_ascii_digit() || *byte == b'.');
    let (value, unit) = word.split_at(digits.map_or(0, |last| last + 1));
    if is_unit(unit) { (value, unit) } else { (word, b"") }
}

/// A label without marks around it and without text that a bracket before the number closes.
fn bare(label: &str) -> &str {
    let mut depth = 0_i32;
    let mut from = 0;
    for (at, byte) in label.bytes().enumerate() {
        match byte {
            b'[' | b'(' | b'{' => depth += 1,
            b']' | b')' | b'}' if depth == 0 => from = at + 1,
            b']' | b')' | b'}' => depth -= 1,
            _ => {}
        }
    }
    let is_mark = |c: char| c.is_whitespace() || ",;|:=".contains(c);
    label[from..].trim_start_matches(is_mark).trim_end_matches(|c| is_mark(c) || "[({".contains(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_name_the_numbers_behind_them() {
        for (line, names) in [
            ("Time: 6.5 Joint Angle [0.1, 0.2]", &["Time", "Joint Angle[0]", "Joint Angle[1]"][..]),
            ("t=0.1 x=-1e-3 y=nan", &["t", "x", "y"]),
            (
                "0.5 s, Joint 1: 10.0 deg, Joint 2: 20.0 deg",
                &["column 0 [s]", "Joint 1 [deg]", "Joint 2 [deg]"],
            ),
            (
                "[INFO] [12.5] [arm]: q 0.1 0.2, [rad]: 3",
                &["[INFO]", "[arm]: q[0]", "[arm]: q[1]", "[rad]"],
            ),
            ("10:40:34.5 pos (rad): 1 2 end", &["column 0", "pos (rad)[0]", "pos (rad)[1]"]),
        ] {
            let owned: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            let text = format!("started\n{line}\n{line}\n\nlost 5\n{line}\n");
            let (rows, layout) = to_table(text.as_bytes()).expect(line);
            assert_eq!(layout.names.as_deref(), Some(&owned[..]), "{line}");
            assert_eq!(layout.line, 2);
            let rows: Vec<&[u8]> = rows.split(|byte| *byte == b'\n').collect();
            assert_eq!(rows.len(), 6, "{line}");
            assert_eq!(rows[4].split(|byte| *byte == b'\t').count(), names.len(), "{line}");
        }
    }

    #[test]
    fn other_texts_are_not_labelled_lines() {
        for line in [
            "0.1,0.2,on", "left 0.1 0.2 0.3", "0.1 [0.2, 0.3] [0.4]", "2026-01-02 10:00:00.5,1,2",
            "N10 G1 X0.1 Y0.2 Z0.3", "x: 0.1, y: 0.2",
        ] {
            assert!(to_table(format!("{line}\n").repeat(5).as_bytes()).is_none(), "{line}");
        }
        let rising: String = (0..9).map(|at| format!("q{at}: 1 2 3\n")).collect();
        assert!(to_table(rising.as_bytes()).is_none());
    }
}
