//! Text tables with lists of numbers as cells, such as `0.1,"[0.2, 0.3]"`, or as rows. Each list becomes neighbouring cells.

use std::ops::Range;

use memchr::{memchr, memchr_iter, memmem};

use super::csv::{cells, comment, lines, mark_length};
use super::{MAX_COLUMNS, MAX_WIDTH};
use crate::rtde;

/// Lines searched for a list.
const MAX_HEAD_LINES: usize = 50;
const DELIMITERS: [u8; 3] = [b',', b';', b'\t'];
/// Numbers of a line of brackets.
const MIN_NUMBERS: usize = 3;

/// The text with the lists in quotation marks that span several lines each in one line, followed by blank lines so that
/// the other lines keep their numbers. `None` without such lists.
pub(super) fn join_lines(bytes: &[u8]) -> Option<Vec<u8>> {
    memchr(b'"', bytes)?;
    let starts_list = |line: &[u8]| {
        let mark = line.iter().rposition(|byte| *byte == b'"');
        mark.is_some_and(|at| {
            matches!(line[at + 1..].trim_ascii_start().first(), Some(b'[' | b'('))
        })
    };
    let marks = |line: &[u8]| line.iter().filter(|byte| **byte == b'"').count();
    let is_unclosed = |line: &[u8]| marks(line) % 2 == 1 && starts_list(line);
    if !bytes.split(|byte| *byte == b'\n').any(is_unclosed) {
        return None;
    }
    let (mut joined, mut blank) = (Vec::with_capacity(bytes.len()), 0);
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        let is_inside = blank > 0;
        let is_open = is_inside != (marks(line) % 2 == 1);
        match is_open && (is_inside || starts_list(line)) {
            true => {
                joined.extend(line.trim_ascii_end());
                joined.push(b' ');
                blank += 1;
            }
            false => {
                joined.extend(line);
                joined.extend(std::iter::repeat_n(b'\n', std::mem::take(&mut blank)));
            }
        }
    }
    Some(joined)
}

/// The rows of a list of lists, as Python and numpy print it: `q = [`, `[0.1, 0.2],` … or `array([[0.1, 0.2],` … Each row is
/// one line, where its list begins unless that line has several, with spaces between its numbers. `None` for other texts.
pub(crate) fn rows_of_lists(bytes: &[u8]) -> Option<Vec<u8>> {
    let text = &bytes[mark_length(bytes)..];
    let is_word = |byte: u8| byte.is_ascii_alphanumeric() || b"._".contains(&byte);
    let (from, ..) = lines(text).find(|(_, _, line)| comment(line).is_none())?;
    let (mut rows, mut end): (Vec<Range<usize>>, usize) = (Vec::new(), text.len());
    // Whether each open bracket is that of a list, not of a call such as `array(`.
    let (mut open, mut depth) = (Vec::new(), 0_usize);
    for (at, &byte) in text.iter().enumerate().skip(from) {
        let follows_word = at > from && is_word(text[at - 1]);
        match byte {
            b'[' | b'(' => {
                let is_list = byte == b'[' || !follows_word;
                open.push(is_list);
                depth += usize::from(is_list);
                if is_list && depth == 2 {
                    rows.push(at + 1..text.len());
                }
            }
            b']' | b')' => {
                let is_list = open.pop()?;
                if let Some(row) = rows.last_mut().filter(|_| is_list && depth == 2) {
                    row.end = at;
                }
                depth -= usize::from(is_list);
                if open.is_empty() {
                    end = at + 1;
                    break;
                }
            }
            _ if depth >= 2 || byte.is_ascii_whitespace() || b"=,;".contains(&byte) => {}
            // Only names may be outside of the rows.
            _ if !is_word(byte) || (byte.is_ascii_digit() && !follows_word) => return None,
            _ => {}
        }
    }
    if rows.len() < 2 {
        return None;
    }
    let is_separator = |byte: &u8| byte.is_ascii_whitespace() || b"[](),;".contains(byte);
    let line_ends = |part: Range<usize>| memchr_iter(b'\n', &text[part]).count();
    let mut made = text[..from].to_vec();
    // Ends of lines in the text, and in the rows.
    let (mut passed, mut written, mut last) = (0, 0, from);
    for row in rows {
        passed += line_ends(last..row.start);
        last = row.start;
        made.extend(std::iter::repeat_n(b'\n', passed.saturating_sub(written)));
        let numbers = text[row].split(is_separator).filter(|own| !own.is_empty());
        made.extend(numbers.collect::<Vec<_>>().join(&b' '));
        made.push(b'\n');
        written = passed.max(written) + 1;
    }
    if open.is_empty() {
        passed += line_ends(last..end);
        made.extend(std::iter::repeat_n(b'\n', passed.saturating_sub(written)));
        made.extend(text[end..].strip_prefix(b";").unwrap_or(&text[end..]));
    } else {
        // The file ends within its last row.
        made.pop();
    }
    Some(made)
}

/// The numbers of lines such as `0.1 [0.2, 0.3] p[0.4, 0.5]` or `{0.1; 0.2}`, by spaces. `None` if a line has no
/// bracket, text or another count of numbers.
pub(super) fn without_brackets(bytes: &[u8]) -> Option<Vec<u8>> {
    let is_bracket = |byte: u8| b"[](){}".contains(&byte);
    let plain = |line: &[u8]| -> Vec<u8> {
        let separator = |at: usize| {
            let (byte, next) = (line[at], line.get(at + 1).copied());
            let opens = next.is_some_and(|next| b"[({".contains(&next));
            is_bracket(byte) || b",;".contains(&byte) || (byte.is_ascii_alphabetic() && opens)
        };
        (0..line.len()).map(|at| if separator(at) { b' ' } else { line[at] }).collect()
    };
    let count = |line: &[u8]| {
        let plain = plain(line);
        let cells = cells(&plain, b' ');
        let is_number =
            |cell: &&[u8]| std::str::from_utf8(cell).is_ok_and(|it| it.parse::<f64>().is_ok());
        (line.iter().any(|byte| is_bracket(*byte)) && cells.iter().all(is_number))
            .then_some(cells.len())
    };
    let lines = || bytes[mark_length(bytes)..].split(|byte| *byte == b'\n');
    let is_data = |line: &&[u8]| !line.trim_ascii().is_empty() && comment(line).is_none();
    let counts: Vec<Option<usize>> =
        lines().filter(is_data).take(MAX_HEAD_LINES).map(count).collect();
    let width = (*counts.first()?)?;
    let is_table = counts.len() > 1
        && (MIN_NUMBERS..=MAX_WIDTH).contains(&width)
        && counts.iter().all(|own| *own == Some(width));
    is_table.then(|| lines().map(plain).collect::<Vec<_>>().join(&b'\n'))
}

/// The text with `0.1` for `np.float64(0.1)`, as numpy 2 prints numbers in lists. `None` without such numbers.
pub(super) fn without_numpy_scalars(bytes: &[u8]) -> Option<Vec<u8>> {
    const PREFIX: &[u8] = b"np.float";
    memmem::find(bytes, PREFIX)?;
    let mut plain = Vec::with_capacity(bytes.len());
    let mut rest = bytes;
    while let Some(at) = memmem::find(rest, PREFIX) {
        let number = &rest[at + PREFIX.len()..];
        let bits = number.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let end = memchr(b')', number).filter(|_| number.get(bits) == Some(&b'('))?;
        plain.extend_from_slice(&rest[..at]);
        plain.extend_from_slice(&number[bits + 1..end]);
        rest = &number[end + 1..];
    }
    plain.extend_from_slice(rest);
    Some(plain)
}

/// Columns of a text with lists.
struct VectorLayout {
    delimiter: u8,
    /// Numbers of each cell; `None` without a list.
    widths: Vec<Option<usize>>,
}

/// The text with a cell for each number; `None` without lists. Lines keep their numbers.
pub(super) fn expand(bytes: &[u8]) -> Option<Vec<u8>> {
    let text = &bytes[mark_length(bytes)..];
    let lines = || text.split(|byte| *byte == b'\n');
    let layout = lines().take(MAX_HEAD_LINES).find_map(VectorLayout::of_line)?;
    let mut expanded = Vec::with_capacity(text.len());
    let mut is_below_header = false;
    for line in lines() {
        let row = split(line, layout.delimiter);
        let has_list = row.iter().any(|cell| list(cell).is_some());
        is_below_header |= has_list;
        match comment(line) {
            None if row.len() == layout.widths.len() => {
                layout.write_row(&row, is_below_header, &mut expanded);
            }
            _ => expanded.extend_from_slice(line),
        }
        expanded.push(b'\n');
    }
    expanded.pop();
    Some(expanded)
}

impl VectorLayout {
    fn of_line(line: &[u8]) -> Option<Self> {
        if comment(line).is_some() {
            return None;
        }
        DELIMITERS.into_iter().find_map(|delimiter| {
            let row = split(line, delimiter);
            let widths: Vec<Option<usize>> =
                row.iter().map(|cell| list(cell).map(|own| own.len())).collect();
            let total: usize = widths.iter().map(|width| width.unwrap_or(1)).sum();
            let has_list = widths.iter().any(Option::is_some);
            (has_list && total <= MAX_COLUMNS).then_some(Self { delimiter, widths })
        })
    }

    fn write_row(&self, row: &[&[u8]], is_data: bool, out: &mut Vec<u8>) {
        for (at, (cell, width)) in row.iter().zip(&self.widths).enumerate() {
            if at > 0 {
                out.push(self.delimiter);
            }
            match (width, list(cell)) {
                (None, _) => out.extend_from_slice(cell),
                (Some(_), Some(numbers)) => out.extend(numbers.join(&self.delimiter)),
                (Some(width), None) => {
                    let name = unquoted(cell);
                    for part in 0..*width {
                        if part > 0 {
                            out.push(self.delimiter);
                        }
                        if !is_data && !name.is_empty() {
                            out.extend_from_slice(name);
                            out.extend(format!("[{part}]").bytes());
                        }
                    }
                }
            }
        }
    }
}

fn unquoted(cell: &[u8]) -> &[u8] {
    rtde::unquoted(cell).trim_ascii()
}

/// Numbers of a list, as text; nested lists are flattened.
fn list(cell: &[u8]) -> Option<Vec<&[u8]>> {
    let cell = unquoted(cell);
    let is_list = (cell.starts_with(b"[") && cell.ends_with(b"]"))
        || (cell.starts_with(b"(") && cell.ends_with(b")"));
    if !is_list {
        return None;
    }
    let is_separator = |byte: &u8| byte.is_ascii_whitespace() || b"[](),;".contains(byte);
    let numbers: Vec<&[u8]> = cell.split(is_separator).filter(|own| !own.is_empty()).collect();
    let is_number =
        |own: &&[u8]| std::str::from_utf8(own).is_ok_and(|text| text.parse::<f64>().is_ok());
    ((2..=MAX_WIDTH).contains(&numbers.len()) && numbers.iter().all(is_number)).then_some(numbers)
}

/// Cells with their quotation marks. Delimiters in brackets are not split at, unless a bracket is open.
fn split(line: &[u8], delimiter: u8) -> Vec<&[u8]> {
    let (mut quoted, mut depth) = (false, 0_usize);
    let row: Vec<&[u8]> = line
        .split(|byte| {
            match byte {
                b'"' => quoted ^= true,
                b'[' | b'(' => depth += 1,
                b']' | b')' => depth = depth.saturating_sub(1),
                _ => {}
            }
            *byte == delimiter && !quoted && depth == 0
        })
        .map(<[u8]>::trim_ascii)
        .collect();
    if quoted || depth > 0 { cells(line, delimiter) } else { row }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_brackets_are_rows() {
        for (text, expected) in [
            ("0.1 [0.2, 0.3] p[4, 5]\n\n0.2 [0.4, 0.5] p[6, 7]\n", Some(5)),
            ("{1;0.2;0.3}\n{2;0.4;0.5}\n", Some(3)),
            ("[1, 2, 3]\n[1, 2]\n", None),
            ("1, 2, 3\n4, 5, 6\n", None),
            ("x [1, 2, 3]\nx [1, 2, 3]\n", None),
        ] {
            let rows = without_brackets(text.as_bytes());
            let count =
                rows.map(|rows| cells(rows.split(|b| *b == b'\n').next().unwrap(), b' ').len());
            assert_eq!(count, expected, "{text}");
        }
    }

    #[test]
    fn lists_within_a_list_are_rows() {
        for (text, expected) in [
            ("q = [\n  [1, 2, 3],\n  [4, 5, 6]\n]\n", Some("\n1 2 3\n4 5 6\n\n")),
            ("# by hand\nq = [(1, 2, 3),\n(4, 5, 6),]", Some("# by hand\n1 2 3\n4 5 6\n")),
            ("array([[1., 2.,\n  3.],\n [4., 5.,\n  6.]])", Some("1. 2. 3.\n\n4. 5. 6.\n")),
            ("q = np.array([[1, 2, 3], [4, 5, 6]], dtype=float32);\n", Some("1 2 3\n4 5 6\n\n")),
            ("[array([1, 2, 3]),\n array([4, 5, 6])]", Some("1 2 3\n4 5 6\n")),
            ("t = [[[1, 2],\n [3, 4]],\n [[5, 6],\n [7, 8]]]", Some("1 2 3 4\n\n5 6 7 8\n")),
            ("q = [\n [1, 2, 3],\n [4, 5", Some("\n1 2 3\n4 5")),
            ("[1, 2, 3]\n[4, 5, 6]\n", None),
            ("q = [1, 2, 3]\n", None),
            ("q = [[1, 2, 3]]\n", None),
            ("q = [\n 1, [2, 3, 4],\n 5, [6, 7, 8]\n]\n", None),
            ("{'q': [[1, 2, 3], [4, 5, 6]]}\n", None),
            ("t,q [rad]\n0.1,0.2\n", None),
            ("0.1 [0.2, 0.3] p[4, 5]\n", None),
            ("q]\n", None),
        ] {
            let rows = rows_of_lists(text.as_bytes()).map(|own| String::from_utf8(own).unwrap());
            assert_eq!(rows.as_deref(), expected, "{text}");
        }
    }

    #[test]
    fn numpy_scalars_are_numbers() {
        let plain = |text: &str| {
            without_numpy_scalars(text.as_bytes()).map(|own| String::from_utf8(own).unwrap())
        };
        let text = "t,q\n0.1,\"[np.float64(0.2), np.float32(-3e-2)]\"\n";
        assert_eq!(plain(text).as_deref(), Some("t,q\n0.1,\"[0.2, -3e-2]\"\n"));
        for text in ["t,q\n0.1,0.2\n", "np.float64", "np.float64(0.1"] {
            assert_eq!(plain(text), None, "{text}");
        }
    }

    #[test]
    fn a_list_over_several_lines_is_one_cell() {
        let text = "t,q\n0.1,\"[[1 2]\n [3 4]]\"\n0.2,\"[[5 6]\n [7 8]]\"\n";
        let joined = join_lines(text.as_bytes()).and_then(|joined| expand(&joined)).unwrap();
        let expected = "t,q[0],q[1],q[2],q[3]\n0.1,1,2,3,4\n\n0.2,5,6,7,8\n\n";
        assert_eq!(String::from_utf8(joined).unwrap(), expected);
        // numpy breaks lines only if a number needs more digits.
        let late = format!("t,q\n{}0.2,\"[5\n 6]\"\n", "0.1,\"[1 2]\"\n".repeat(MAX_HEAD_LINES));
        let joined = join_lines(late.as_bytes()).and_then(|joined| expand(&joined)).unwrap();
        assert!(joined.ends_with(b"0.1,1,2\n0.2,5,6\n\n"));
        for text in ["t,q\n0.1,\"[1]\"\n", "t,\"a\nb\"\n1,2\n", "t,5\"\n1,2\n"] {
            assert_eq!(join_lines(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn each_number_of_a_list_becomes_a_cell() {
        for (text, expanded) in [
            (
                "t,q,mode\n0.1,\"[0.2, 0.3]\",on\n0.2,\"[0.4, 0.5]\",on\n",
                "t,q[0],q[1],mode\n0.1,0.2,0.3,on\n0.2,0.4,0.5,on\n",
            ),
            ("t;q\n0,1;[1 2]\n\n0,2;\n", "t;q[0];q[1]\n0,1;1;2\n\n0,2;;\n"),
            ("# by hand\n1,[[1, 2], [3, 4]]", "# by hand\n1,1,2,3,4"),
            ("1,(1, 2)\n2,(1, 2, 3)\n", "1,1,2\n2,1,2,3\n"),
        ] {
            let found = expand(text.as_bytes()).map(|own| String::from_utf8(own).unwrap());
            assert_eq!(found.as_deref(), Some(expanded), "{text}");
        }
        for text in ["t,q\n0.1,0.2\n", "t,q\n0.1,[a, b]\n", "t [s],q\n1,[5]\n", ""] {
            assert_eq!(expand(text.as_bytes()), None, "{text}");
        }
    }
}
