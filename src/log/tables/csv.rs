//! Text tables: comments, column names, optionally a row of units, then one row per line.
//!
//! The first row of numbers determines the delimiter and the decimal mark. A table without names becomes
//! one column, like a NumPy array.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use jiff::civil::{Date, Time};
use memchr::{memchr_iter, memmem};

use super::row_labels::RowLabels;
use super::text_rows::{self, CellsBeside, RowFormat, TextRows};
use super::{
    Cell, Column, Episodes, MAX_COLUMNS, MAX_WIDTH, ReadContext, Table, TableError, clock,
    file_names, labelled_lines, most_frequent, text_encoding, vector_cells,
};
use crate::rtde::{self, unquoted};

const MAX_HEADER_LINES: usize = 200;
/// Same limit as for RTDE tables.
pub(super) const MAX_LINE_BYTES: usize = 1 << 20;
const COMMENT_MARKERS: [&str; 3] = ["#", "%", "//"];
/// In a row of a robot log.
pub(super) const MIN_CELLS: usize = 3;
/// In a row with mostly empty cells: a time and the numbers of the smallest stream.
const MIN_NUMBERS: usize = 2;
const UNIT_NAMES: &[&str] = &[
    "-", "1", "s", "sec", "ms", "us", "ns", "m", "mm", "cm", "rad", "deg", "°", "degree",
    "degrees", "rad/s", "deg/s", "°/s", "m/s", "mm/s", "m/s2", "m/s^2", "n", "nm", "n.m", "a",
    "ma", "v", "hz", "rpm", "count", "counts", "bool", "int", "float", "%", "c", "°c",
];

pub(super) struct TextLayout {
    pub delimiter: u8,
    pub names: Option<Vec<String>>,
    pub width: usize,
    /// Byte offset; `line` counts from 1.
    pub rows_at: usize,
    pub line: usize,
}

/// Whether the first rows have equally many cells.
pub(crate) fn is_table_of_text(bytes: &[u8]) -> bool {
    const CHECKED_ROWS: usize = 20;
    let text = text_encoding::to_utf8(bytes);
    let rows: Vec<&[u8]> = lines(&text).map(|(_, _, row)| row).take(CHECKED_ROWS).collect();
    let counts = |delimiter: u8| rows.iter().map(move |row| cells(row, delimiter).len());
    rows.len() > 2
        && [b',', b';', b'\t'].into_iter().any(|delimiter| {
            let first = counts(delimiter).next().unwrap_or(0);
            first >= MIN_CELLS && counts(delimiter).all(|count| count == first)
        })
}

/// Whether its only line names several columns and a time.
pub(crate) fn is_header_alone(bytes: &[u8]) -> bool {
    let text = text_encoding::to_utf8(bytes);
    let mut rows = lines(&text).map(|(_, _, row)| row).filter(|row| !row.is_empty());
    let (Some(first), None) = (rows.next(), rows.next()) else { return false };
    [b',', b';', b'\t', b' '].into_iter().any(|delimiter| {
        let names = cells(first, delimiter);
        let is_time = |name: &&[u8]| clock::is_time(&String::from_utf8_lossy(name));
        names.len() >= MIN_CELLS && names.iter().any(is_time)
    })
}

/// Whether each of its first lines has one number.
pub(crate) fn is_list_of_numbers(bytes: &[u8]) -> bool {
    const CHECKED_ROWS: usize = 100;
    const MIN_ROWS: usize = 3;
    let rows = || lines(bytes).map(|(_, _, row)| row).take(CHECKED_ROWS);
    rows().count() >= MIN_ROWS && rows().all(|row| is_number(row, b';'))
}

/// Whether each of its first lines has two numbers, such as a time and a value, below names or without them.
pub(crate) fn is_list_of_pairs(bytes: &[u8]) -> bool {
    const CHECKED_ROWS: usize = 100;
    const MIN_ROWS: usize = 3;
    let text = text_encoding::to_utf8(bytes);
    let is_pair = |row: &[u8], delimiter: u8| {
        let own = cells(row, delimiter);
        own.len() == 2 && own.iter().all(|cell| is_number(cell, delimiter))
    };
    [b',', b';', b'\t', b' '].into_iter().any(|delimiter| {
        let rows = lines(&text).map(|(_, _, row)| row).take(CHECKED_ROWS);
        let rows: Vec<&[u8]> = rows.skip_while(|row| !is_pair(row, delimiter)).collect();
        let skipped = lines(&text).take_while(|(_, _, row)| !is_pair(row, delimiter)).count();
        skipped <= 1 && rows.len() >= MIN_ROWS && rows.iter().all(|row| is_pair(row, delimiter))
    })
}

/// Whether it has rows of numbers, with or without column names.
pub(crate) fn is_table(bytes: &[u8]) -> bool {
    to_rows(bytes).is_some() || rows_of_times(&text_encoding::to_utf8(bytes)).is_some()
}

/// Names of the columns of a table with times.
pub(crate) fn column_names(bytes: &[u8]) -> Option<Vec<String>> {
    let names = to_rows(bytes)?.1.names?;
    names.iter().any(|name| clock::is_time(name)).then_some(names)
}

/// The text in UTF-8 with a cell for each number of a row, and the layout of its rows.
fn to_rows(bytes: &[u8]) -> Option<(Cow<'_, [u8]>, TextLayout)> {
    if let Some((text, layout)) = labelled_lines::to_table(&text_encoding::to_utf8(bytes)) {
        return Some((Cow::Owned(text), layout));
    }
    let text = with_single_numbers(bytes);
    let layout = detect_layout(&text)?;
    Some((text, layout))
}

/// The text in UTF-8, with a cell for each number of a list.
fn with_single_numbers(bytes: &[u8]) -> Cow<'_, [u8]> {
    let text = text_encoding::to_utf8(bytes);
    let text = vector_cells::without_numpy_scalars(&text).map_or(text, Cow::Owned);
    if let Some(rows) = vector_cells::rows_of_lists(&text) {
        return Cow::Owned(rows);
    }
    let text = vector_cells::join_lines(&text).map_or(text, Cow::Owned);
    match vector_cells::expand(&text).or_else(|| vector_cells::without_brackets(&text)) {
        Some(expanded) => Cow::Owned(expanded),
        None => text,
    }
}

/// Delimiters within quotation marks are text.
pub(super) fn cells(line: &[u8], delimiter: u8) -> Vec<&[u8]> {
    let mut cells = Vec::new();
    split_cells(line, delimiter, &mut cells);
    cells
}

/// Replaces `cells` by the cells in the line.
pub(super) fn split_cells<'a>(line: &'a [u8], delimiter: u8, cells: &mut Vec<&'a [u8]>) {
    cells.clear();
    if delimiter == b' ' {
        let words = line.split(u8::is_ascii_whitespace).filter(|cell| !cell.is_empty());
        return cells.extend(words.map(unquoted));
    }
    let mut quoted = false;
    let split = line.split(|byte| {
        quoted ^= *byte == b'"';
        *byte == delimiter && !quoted
    });
    cells.extend(split.map(unquoted));
    // An unmatched quotation mark does not quote.
    if quoted {
        cells.clear();
        cells.extend(rtde::cells(line, delimiter));
    }
}

/// Delimiter of the first row of numbers.
pub(crate) fn delimiter_of_numbers(bytes: &[u8]) -> Option<u8> {
    let mut rows = lines(bytes).map(|(_, _, line)| detect_delimiter(line));
    rows.find(|(_, count)| *count > 0).map(|(delimiter, _)| delimiter)
}

/// Delimiter with the most numbers, and their count.
fn detect_delimiter(row: &[u8]) -> (u8, usize) {
    let count = |delimiter: u8| {
        let cells = cells(row, delimiter);
        let numbers = cells.iter().filter(|cell| is_number(cell, delimiter)).count();
        let filled = cells.iter().filter(|cell| !cell.is_empty()).count();
        // Streams of other rates leave cells empty.
        let is_row = cells.len() >= MIN_CELLS
            && (2 * numbers > cells.len() || (numbers >= MIN_NUMBERS && 2 * numbers > filled));
        if is_row { numbers } else { 0 }
    };
    let all = [b';', b'\t', b',', b' '].map(|delimiter| (delimiter, count(delimiter)));
    // On a tie, the first one wins.
    all.into_iter().rev().max_by_key(|(_, count)| *count).unwrap_or((b',', 0))
}

/// Whether a text is the name of a unit.
pub(super) fn is_unit(text: &[u8]) -> bool {
    let unit = String::from_utf8_lossy(text).to_lowercase();
    unit.starts_with(|c: char| c.is_alphabetic() || c == '°') && UNIT_NAMES.contains(&&*unit)
}

fn is_number(cell: &[u8], delimiter: u8) -> bool {
    rtde::number(cell, delimiter != b',').is_some()
}

pub(super) fn comment(line: &[u8]) -> Option<&[u8]> {
    let line = line.trim_ascii();
    COMMENT_MARKERS
        .iter()
        .find_map(|mark| line.strip_prefix(mark.as_bytes()))
        .map(<[u8]>::trim_ascii)
}

/// Offset, number from 1 and text of each nonblank line. Tabs stay: they may delimit empty cells.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, usize, &[u8])> {
    let mut at = 0;
    let all = bytes.split_inclusive(|byte| *byte == b'\n').enumerate().map(move |(index, line)| {
        let offset = at;
        at += line.len();
        (offset, index + 1, text_rows::trim_line(line))
    });
    all.filter(|(_, _, line)| !line.trim_ascii().is_empty())
}

/// Of the byte-order mark.
pub(super) fn mark_length(bytes: &[u8]) -> usize {
    if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 }
}

pub(super) fn trailing_empty_cells(row: &[&[u8]]) -> usize {
    row.iter().rev().take_while(|cell| cell.is_empty()).count()
}

/// Number of cells of a row that belong to a table with `width` columns: an empty cell separates those beside it.
pub(super) fn table_width(row: &[&[u8]], width: usize) -> usize {
    if row.get(width).is_some_and(|cell| cell.is_empty()) { width } else { row.len() }
}

fn detect_layout(bytes: &[u8]) -> Option<TextLayout> {
    let mark = mark_length(bytes);
    let all = lines(&bytes[mark..]).map(|(offset, line, text)| (offset + mark, line, text));
    let mut above: Vec<&[u8]> = Vec::new();
    let mut places: Vec<(usize, usize)> = Vec::new();
    let head: Vec<(usize, usize, &[u8])> = all.take(MAX_HEADER_LINES).collect();
    for (at, &(rows_at, line, text)) in head.iter().enumerate() {
        let (delimiter, count) = match comment(text) {
            _ if text.len() > MAX_LINE_BYTES => (b',', 0),
            Some(_) => (b',', 0),
            None => detect_delimiter(text),
        };
        if count == 0 {
            above.push(text);
            places.push((rows_at, line));
            continue;
        }
        let first = cells(text, delimiter);
        if first.len() > MAX_COLUMNS {
            return None;
        }
        let below = &head[at + 1..];
        let (mut row, next) = typical_rows(first, below, delimiter);
        let has_numbers = |row: &[&[u8]]| row.iter().any(|cell| is_number(cell, delimiter));
        let is_table = match below.first() {
            Some((_, _, next)) if next.len() > MAX_LINE_BYTES => false,
            // The next row is shorter if only the head of the file is read.
            Some((_, _, line)) => {
                let line = cells(line, delimiter);
                has_numbers(&next)
                    || (table_width(&line, row.len()) <= row.len() && has_numbers(&line))
            }
            None => !above.is_empty(),
        };
        if !is_table {
            return None;
        }
        // pandas writes arrays with a header of column indices, after an empty cell above its index.
        let columns =
            if row.first().is_some_and(|cell| cell.is_empty()) { &row[1..] } else { &row[..] };
        let counts = |first: usize| {
            let mut cells = columns.iter().enumerate();
            cells.all(|(at, cell)| *cell == (at + first).to_string().as_bytes())
        };
        if (counts(0) || counts(1)) && above.is_empty() && !below.is_empty() {
            continue;
        }
        let names = names_above(&above, delimiter, &row);
        // Delimiters at the end of each row are cells only below names.
        let open = trailing_empty_cells(&next);
        row.truncate(row.len() - open.min(trailing_empty_cells(&row)));
        let width = names.as_ref().map_or(row.len(), Vec::len);
        if names.is_none() && width > MAX_WIDTH {
            return None;
        }
        // The first rows may be mostly empty until the sensors are ready.
        let sparse = above.iter().rev().take_while(|text| is_sparse_row(text, delimiter, width));
        let (rows_at, line) = match sparse.count() {
            0 => (rows_at, line),
            count => places[places.len() - count],
        };
        return Some(TextLayout { delimiter, names, width, rows_at, line });
    }
    None
}

/// The first two rows with as many cells as most of these rows. The first of all, alone, if it has another number of
/// cells although nothing is beside the table.
fn typical_rows<'a>(
    first: Vec<&'a [u8]>,
    below: &[(usize, usize, &'a [u8])],
    delimiter: u8,
) -> (Vec<&'a [u8]>, Vec<&'a [u8]>) {
    let below = below.iter().map(|(_, _, line)| *line).filter(|line| comment(line).is_none());
    let below =
        below.take_while(|line| line.len() <= MAX_LINE_BYTES).map(|line| cells(line, delimiter));
    let is_row = |row: &Vec<&[u8]>| row.iter().any(|cell| is_number(cell, delimiter));
    let rows = || std::iter::once(first.clone()).chain(below.clone().take_while(is_row));
    let most = most_frequent(rows().map(|row| row.len()));
    let width = if table_width(&first, most) == most { most } else { first.len() };
    let mut typical = rows().filter(|row| row.len() == width);
    (typical.next().unwrap_or_default(), typical.next().unwrap_or_default())
}

fn is_sparse_row(line: &[u8], delimiter: u8, width: usize) -> bool {
    if line.len() > MAX_LINE_BYTES || comment(line).is_some() {
        return false;
    }
    let row = cells(line, delimiter);
    let open = trailing_empty_cells(&row);
    let numbers: Vec<f64> = row.iter().map(|cell| number(cell, delimiter)).collect();
    let has_text = row.iter().zip(&numbers).any(|(cell, own)| is_text(cell, *own));
    let fits = row.len() >= width && row.len() - open <= width;
    fits && !has_text && numbers.iter().any(|own| own.is_finite())
}

fn names_above(above: &[&[u8]], delimiter: u8, row: &[&[u8]]) -> Option<Vec<String>> {
    let texts = |line: &[u8]| -> Option<Vec<String>> {
        let own = comment(line).unwrap_or(line);
        let mut cells = cells(own, delimiter);
        cells.truncate(table_width(&cells, row.len()));
        // Rows may end in delimiters or begin with an unnamed index.
        let open = trailing_empty_cells(row);
        let fits = match cells.len() {
            count if count <= row.len() && count + open >= row.len() => true,
            count if count + 1 == row.len() && count >= MIN_CELLS => {
                cells.insert(0, b"");
                true
            }
            _ => false,
        };
        let is_text = cells.iter().all(|cell| !is_number(cell, delimiter))
            && cells.iter().any(|cell| !cell.is_empty());
        let all = || cells.iter().map(|cell| String::from_utf8_lossy(cell).trim().to_owned());
        (fits && is_text).then(|| all().collect())
    };
    let above = above.iter().rev().filter(|line| line.len() <= MAX_LINE_BYTES);
    let mut known = above.filter_map(|line| texts(line));
    let last = known.next()?;
    let unit = |text: &str| text.trim_matches(['[', ']', '(', ')', ' ']).to_lowercase();
    let are_units =
        last.iter().all(|text| text.is_empty() || UNIT_NAMES.contains(&unit(text).as_str()));
    match known.next() {
        Some(names) if are_units && names.len() == last.len() => {
            let with_unit = |(name, text): (String, &String)| match unit(text).as_str() {
                "" | "-" => name,
                unit => format!("{name} [{unit}]"),
            };
            Some(names.into_iter().zip(&last).map(with_unit).collect())
        }
        above => Some(with_headings(last, above.as_deref())),
    }
}

/// Repeated names with the headings above them, as in `Position/elbow` and `Velocity/elbow`. A merged heading is followed
/// by empty cells.
fn with_headings(names: Vec<String>, headings: Option<&[String]>) -> Vec<String> {
    let Some(headings) = headings.filter(|own| own.len() == names.len()) else { return names };
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    names.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let is_repeated = |name: &String| counts.get(name.as_str()).is_some_and(|count| *count > 1);
    let mut heading = "";
    let named = names.iter().zip(headings).map(|(name, own)| {
        heading = if own.is_empty() { heading } else { own };
        match is_repeated(name) && !name.is_empty() && !heading.is_empty() {
            true => format!("{heading}/{name}"),
            false => name.clone(),
        }
    });
    named.collect()
}

pub(super) fn read(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let table = match to_rows(bytes) {
        Some((text, layout)) => read_rows(&text, layout, context)?,
        None => {
            let text = text_encoding::to_utf8(bytes);
            let (delimiter, rows) = rows_of_times(&text).ok_or("it contains no rows of numbers")?;
            read_transposed(delimiter, &rows, context)?
        }
    };
    Ok(vec![("0".to_owned(), table)])
}

/// Delimiter and lines of a table whose columns are times, as MATLAB writes a 6 by N matrix.
fn rows_of_times(bytes: &[u8]) -> Option<(u8, Vec<&[u8]>)> {
    /// Quantities, and minimum ratio of times to quantities.
    const QUANTITIES: RangeInclusive<usize> = 2..=64;
    const MIN_ASPECT: usize = 8;
    const MAX_ROW_BYTES: usize = 4 << 20;
    let own = lines(bytes).map(|(_, _, line)| line).filter(|line| comment(line).is_none());
    let rows: Vec<&[u8]> = own.take(QUANTITIES.end() + 1).collect();
    if rows.iter().any(|row| row.len() > MAX_ROW_BYTES) {
        return None;
    }
    let (delimiter, width) = detect_delimiter(rows.first()?);
    let is_row = |row: &&[u8]| {
        let cells = cells(row, delimiter);
        cells.len() == width && cells.iter().all(|cell| is_number(cell, delimiter))
    };
    let is_table = QUANTITIES.contains(&rows.len())
        && width > MAX_WIDTH.max(MIN_ASPECT * rows.len())
        && rows.iter().all(is_row);
    is_table.then_some((delimiter, rows))
}

fn read_transposed(
    delimiter: u8,
    rows: &[&[u8]],
    context: &mut ReadContext,
) -> Result<Table, TableError> {
    let parse = |row: &&[u8]| -> Vec<f64> {
        cells(row, delimiter).into_iter().map(|cell| number(cell, delimiter)).collect()
    };
    let count = cells(rows[0], delimiter).len();
    context.memory.reserve(2 * count * rows.len())?;
    let series: Vec<Vec<f64>> = rows.iter().map(parse).collect();
    let values = (0..count).flat_map(|at| series.iter().map(move |own| own[at])).collect();
    let column = Column::untyped(file_names::UNNAMED_COLUMN, series.len(), values);
    Ok(Table { rows: count, columns: vec![column], ..Table::default() })
}

pub(super) fn read_rows(
    bytes: &[u8],
    layout: TextLayout,
    context: &mut ReadContext,
) -> Result<Table, TableError> {
    let TextLayout { delimiter, names, width, rows_at, line } = layout;
    let times: Vec<usize> = match &names {
        Some(names) => (0..width).filter(|&at| clock::is_time(&names[at])).collect(),
        None => (0..width).filter(|at| context.times.contains(at)).collect(),
    };
    let format = RowFormat { delimiter, names: names.as_deref(), width, times: &times };
    let next = next_table(&bytes[rows_at..], &format);
    let end = next.map_or(bytes.len(), |at| rows_at + at);
    let mut rows = text_rows::read(&bytes[rows_at..end], line, &format, context)?;
    let first = bytes[rows_at..].split(|byte| *byte == b'\n').next().unwrap_or_default();
    for (at, cell) in cells(first, delimiter).into_iter().enumerate() {
        if let (Some(period_s), Some(own)) = (clock_period_s(cell), rows.values.get_mut(at)) {
            continue_times(own, period_s);
        }
    }
    let mut table = build_table(names, rows);
    if next.is_some() {
        let line = line + memchr_iter(b'\n', &bytes[rows_at..end]).count();
        table.notes.push(format!(
            "another table follows from line {line} and is not read; to use it, save it as a file of its own"
        ));
    }
    Ok(table)
}

/// Offset of another table below these rows: an empty line and other column names are before its rows.
fn next_table(bytes: &[u8], format: &RowFormat<'_>) -> Option<usize> {
    /// Places searched for names. A damaged file may have any number of them.
    const MAX_PLACES: usize = 100;
    let is_row = |line: &[u8]| {
        cells(line, format.delimiter).iter().any(|cell| is_number(cell, format.delimiter))
    };
    let ends: [&[u8]; 2] = [b"\n\n", b"\n\r\n"];
    let places = ends.into_iter().flat_map(|end| {
        memmem::find_iter(bytes, end).filter_map(move |at| {
            let from = at + end.len();
            let (offset, _, line) = lines(&bytes[from..]).next()?;
            (!is_row(line)).then_some(from + offset)
        })
    });
    let has_other_names = |at: &usize| {
        let names = detect_layout(&bytes[*at..]).and_then(|layout| layout.names);
        names.is_some_and(|names| Some(&*names) != format.names)
    };
    places.take(MAX_PLACES).find(has_other_names)
}

/// When a time of day without its date starts again: `40:34.4` each hour, `10:40:34` each day.
fn clock_period_s(cell: &[u8]) -> Option<f64> {
    let cell = unquoted(cell);
    let is_time = |byte: &u8| byte.is_ascii_digit() || b":.,".contains(byte);
    match cell.iter().filter(|byte| **byte == b':').count() {
        _ if !cell.iter().all(is_time) => None,
        1 => Some(3600.0),
        2 => Some(86_400.0),
        _ => None,
    }
}

/// Counts on where times fall by more than half the period.
fn continue_times(values: &mut [f64], period_s: f64) {
    let (mut periods, mut last) = (0.0, f64::NAN);
    for value in values.iter_mut().filter(|value| value.is_finite()) {
        if last - *value > 0.5 * period_s {
            periods += 1.0;
        }
        last = *value;
        *value += periods * period_s;
    }
}

/// Markers for missing numbers are not text.
pub(super) fn is_text(cell: &[u8], number: f64) -> bool {
    const MISSING_MARKERS: [&[u8]; 9] =
        [b"", b"-", b"nan", b"-nan", b"-nan(ind)", b"na", b"n/a", b"null", b"none"];
    number.is_nan() && !MISSING_MARKERS.iter().any(|mark| cell.eq_ignore_ascii_case(mark))
}

/// Whether a row repeats the header, as in concatenated files.
pub(super) fn repeats_names(row: &[&[u8]], names: &[String]) -> bool {
    let is_name = |(cell, name): (&&[u8], &String)| {
        // Names include the units below them.
        let name = name.rsplit_once(" [").map_or(name.as_str(), |(name, _)| name);
        // And the headings above them.
        let below = || name.rsplit_once('/').map_or(name, |(_, name)| name);
        *cell == name.as_bytes() || *cell == below().as_bytes()
    };
    row.iter().zip(names).all(is_name)
}

fn build_table(names: Option<Vec<String>>, rows: TextRows<'_>) -> Table {
    let TextRows { values, mut billionths, texts, text_counts, levels, lines, beside } = rows;
    let rows = values.first().map_or(0, Vec::len);
    let is_numeric = |at: &usize| {
        let finite = values[*at].iter().filter(|value| value.is_finite()).count();
        // A stream with fewer rows leaves its cells empty.
        rows == 0 || (finite > 0 && finite >= text_counts[*at])
    };
    let (numeric, text_columns): (Vec<usize>, Vec<usize>) = (0..values.len()).partition(is_numeric);
    let notes = beside.map(CellsBeside::note).into_iter().collect();
    let name = |at: usize| names.as_ref().map_or("", |names| &names[at]);
    let labels = text_columns.iter();
    let labels =
        labels.filter_map(|&at| RowLabels::of_texts(name(at), rows, &levels[at])).collect();
    let mut made = Table { rows, lines, text_columns, notes, labels, ..Table::default() };
    let Some(names) = names else {
        let columns: Vec<&Vec<f64>> = numeric.iter().map(|&at| &values[at]).collect();
        let all = (0..rows).flat_map(|row| columns.iter().map(move |column| column[row])).collect();
        made.columns.push(Column::untyped(file_names::UNNAMED_COLUMN, columns.len(), all));
        for (part, &at) in numeric.iter().enumerate() {
            let exact = std::mem::take(&mut billionths[at]);
            if !exact.is_empty() {
                made.exact_times.insert(Cell { column: 0, part }, exact);
            }
        }
        if !made.text_columns.is_empty() {
            let what = format!("{} of its {} columns", made.text_columns.len(), values.len());
            made.unread.push((what, "text, not numbers".to_owned()));
        }
        return made;
    };
    for (at, ((name, values), billionths)) in
        names.into_iter().zip(values).zip(billionths).enumerate()
    {
        let name = if name.is_empty() { format!("column {at}") } else { name };
        if numeric.contains(&at) {
            made.columns.push(Column { billionths, ..Column::untyped(&name, 1, values) });
            continue;
        }
        let text = texts[at].unwrap_or_default();
        if !text.is_empty() {
            made.texts.insert(name.clone(), String::from_utf8_lossy(text).into_owned());
            made.unread.push((name, "text, not numbers".to_owned()));
        }
    }
    made
}

/// Converts dates with time to seconds since 1970, times of day to seconds since midnight, and other text
/// to NaN.
pub(super) fn number(cell: &[u8], delimiter: u8) -> f64 {
    let text = || std::str::from_utf8(unquoted(cell)).ok().and_then(seconds);
    rtde::number(cell, delimiter != b',').or_else(text).unwrap_or(f64::NAN)
}

/// A number, a date or a time of day in text with decimal points; NaN for other text.
pub(super) fn text_number(text: &[u8]) -> f64 {
    number(text, b',')
}

/// The number times 10⁹, rounded to an integer.
pub(super) fn decimal_billionths(cell: &[u8], decimal_comma: bool) -> Option<i128> {
    /// Beyond any stamp.
    const MAX_EXPONENT: i32 = 30;
    let text = std::str::from_utf8(unquoted(cell)).ok()?;
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse().ok()?),
        None => (text, 0_i32),
    };
    let is_mark = |c: char| c == '.' || (decimal_comma && c == ',');
    let (whole, fraction) = mantissa.split_once(is_mark).unwrap_or((mantissa, ""));
    let (sign, whole) = match whole.strip_prefix('-') {
        Some(whole) => (-1, whole),
        None => (1, whole.strip_prefix('+').unwrap_or(whole)),
    };
    let mut digits = whole.bytes().chain(fraction.bytes()).peekable();
    digits.peek()?;
    let digits = digits.try_fold(0_i128, |sum, digit| {
        let digit = digit.is_ascii_digit().then(|| sign * i128::from(digit - b'0'))?;
        sum.checked_mul(10)?.checked_add(digit)
    })?;
    if exponent.abs() > MAX_EXPONENT {
        return None;
    }
    match exponent + 9 - fraction.len() as i32 {
        power @ 0.. => digits.checked_mul(10_i128.checked_pow(power.unsigned_abs())?),
        power => {
            let divisor = 10_i128.checked_pow(power.unsigned_abs())?;
            Some((digits + digits.signum() * divisor / 2) / divisor)
        }
    }
}

fn seconds(cell: &str) -> Option<f64> {
    // Marks a text in a spreadsheet.
    let cell = cell.strip_prefix('\'').unwrap_or(cell);
    if !(cell.starts_with(|c: char| c.is_ascii_digit()) && cell.contains([':', '-', '_', '/'])) {
        return None;
    }
    let stamp = match cell.parse::<jiff::Timestamp>() {
        Ok(stamp) => stamp,
        Err(_) => return moment(cell),
    };
    Some(stamp.as_nanosecond() as f64 * 1e-9)
}

/// A date with time of day, a time of day or a duration such as `1 day, 0:00:01.5`, without time zone. Seconds are
/// required: times in whole minutes are not stamps.
fn moment(cell: &str) -> Option<f64> {
    let lower = cell.to_ascii_lowercase();
    let (text, noon_h) = match (lower.strip_suffix("am"), lower.strip_suffix("pm")) {
        (Some(text), _) => (text.trim_end(), Some(0)),
        (_, Some(text)) => (text.trim_end(), Some(12)),
        _ => (lower.as_str(), None),
    };
    let (days, text) = match text.split_once(" day") {
        Some((days, rest)) => (days.parse::<u32>().ok()?, rest.trim_start_matches(['s', ',', ' '])),
        None => (0, text),
    };
    let separators: Vec<char> = text.chars().filter(|c| !c.is_ascii_digit()).collect();
    if !separators.iter().all(|c| " -_/.:,t".contains(*c)) {
        return None;
    }
    let is_separator = |c: char| !c.is_ascii_digit();
    let groups: Vec<&str> = text.split(is_separator).filter(|group| !group.is_empty()).collect();
    let sides = |group: &str| group.len();
    let (date, time) = match groups.as_slice() {
        [day, time @ ..] if sides(day) == 8 => {
            (Some([day.get(..4)?, day.get(4..6)?, day.get(6..)?]), time)
        }
        [year, month, day, time @ ..] if sides(year) == 4 => (Some([*year, *month, *day]), time),
        [first, second, year, time @ ..]
            if sides(year) == 4 && sides(first) <= 2 && separators.first() != Some(&':') =>
        {
            // The day comes first with dots. Otherwise the month does, unless it exceeds 12.
            let is_day_first = separators.first() == Some(&'.') || first.parse::<u8>().ok()? > 12;
            let [month, day] = if is_day_first { [*second, *first] } else { [*first, *second] };
            (Some([*year, month, day]), time)
        }
        time => (None, time),
    };
    let (clock, fraction) = match time {
        // Spreadsheets show minutes, seconds and tenths by default.
        [minute, second, fraction]
            if date.is_none() && matches!(separators[..], [':', '.' | ',']) =>
        {
            (["0", *minute, *second], std::slice::from_ref(fraction))
        }
        [clock, fraction @ ..] if sides(clock) == 6 => {
            ([clock.get(..2)?, clock.get(2..4)?, clock.get(4..)?], fraction)
        }
        [hour, minute, second, fraction @ ..] if separators.contains(&':') || date.is_some() => {
            ([*hour, *minute, *second], fraction)
        }
        _ => return None,
    };
    let fraction = match fraction {
        [] => "0",
        [own] if sides(own) <= 9 => own,
        _ => return None,
    };
    let number = |group: &str| group.parse::<i16>().ok();
    let hour = match noon_h {
        Some(noon_h) => number(clock[0])? % 12 + noon_h,
        None => number(clock[0])?,
    };
    let nanos: i32 = format!("{fraction:0<9}").parse().ok()?;
    let part = |group: &str| i8::try_from(number(group)?).ok();
    let time = Time::new(i8::try_from(hour).ok()?, part(clock[1])?, part(clock[2])?, nanos).ok()?;
    let of_day = (time - Time::midnight()).total(jiff::Unit::Second).ok()?;
    let Some([year, month, day]) = date else { return Some(f64::from(days) * 86_400.0 + of_day) };
    let date = Date::new(number(year)?, part(month)?, part(day)?).ok()?;
    let midnight = date.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    Some(midnight.as_second() as f64 + of_day)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Option<(u8, Option<Vec<String>>, usize)> {
        detect_layout(text.as_bytes()).map(|layout| (layout.delimiter, layout.names, layout.width))
    }

    fn owned_names(names: &[&str]) -> Option<Vec<String>> {
        Some(names.iter().map(|&name| name.to_owned()).collect())
    }

    #[test]
    fn column_names_are_found_above_the_rows() {
        for (text, delimiter, expected, width) in [
            ("t,q1,q2\n0,1,2\n", b',', owned_names(&["t", "q1", "q2"]), 3),
            ("# a log\n#t q1 q2\n0 1 2\n1 2 3\n", b' ', owned_names(&["t", "q1", "q2"]), 3),
            ("Robot 7\n\nt;q1;q2\n0,5;1,5;2,5\n", b';', owned_names(&["t", "q1", "q2"]), 3),
            ("t,q1,x\ns,deg,mm\n0,1,2\n", b',', owned_names(&["t [s]", "q1 [deg]", "x [mm]"]), 3),
            ("t\tq1\tq2\n0,5\t1,5\t2,5\n", b'\t', owned_names(&["t", "q1", "q2"]), 3),
            (
                "\"t\",\"q,1\",\"q2\"\n\"0\",\"1\",\"2\"\n",
                b',',
                owned_names(&["t", "q,1", "q2"]),
                3,
            ),
            (
                "%time,field.a0,field.a1\n1,2,3\n",
                b',',
                owned_names(&["time", "field.a0", "field.a1"]),
                3,
            ),
            ("t,q1,q2\n0,1,2,\n0,1,2,\n", b',', owned_names(&["t", "q1", "q2"]), 3),
            ("q1,q2,q3\n0,1,2,3\n1,2,3,4\n", b',', owned_names(&["", "q1", "q2", "q3"]), 4),
            ("0.5 1.5 2.5\n0.6 1.6 2.6\n", b' ', None, 3),
            ("0,1,2\n0.5,1.5,2.5\n0.6,1.6,2.6\n", b',', None, 3),
            ("t\tq1\tq2\t\t\n0\t1\t2\n1\t2\t3\n", b'\t', owned_names(&["t", "q1", "q2"]), 3),
            ("t\tq1\tq2\n0\t1\t2\t\t\n1\t2\t3\t\t\n", b'\t', owned_names(&["t", "q1", "q2"]), 3),
            (
                "of,q,,qd,\nt,a,b,a,b\n0,1,2,3,4\n",
                b',',
                owned_names(&["t", "q/a", "q/b", "qd/a", "qd/b"]),
                5,
            ),
            (
                "t\tq1\tq2\tx\n0\t1\t2\t\n1\t2\t3\t4\n",
                b'\t',
                owned_names(&["t", "q1", "q2", "x"]),
                4,
            ),
            ("0.5,1.5,2.5,,\n0.6,1.6,2.6,,\n", b',', None, 3),
            ("t,q1,q2,,by hand\n0,1,2\n1,2,3\n", b',', owned_names(&["t", "q1", "q2"]), 3),
            (
                "t,q1,q2\n0,1,2,,by hand\n1,2,3,,7\n2,3,4\n3,4,5\n4,5,6\n",
                b',',
                owned_names(&["t", "q1", "q2"]),
                3,
            ),
            (" # a log\n\t% by hand\nt,q1,q2\n0,1,2\n", b',', owned_names(&["t", "q1", "q2"]), 3),
        ] {
            assert_eq!(names(text), Some((delimiter, expected, width)), "{text:?}");
        }
        for text in ["", "a,b\n1,2\n", "text that is none\nin two lines\n", "1,2,3\n", "x,y,z\n"] {
            assert_eq!(names(text), None, "{text:?}");
        }
    }

    #[test]
    fn a_table_with_a_column_for_each_time_is_transposed() {
        let line = |quantity: usize| -> String {
            let cells: Vec<String> = (0..300).map(|at| format!("{}.5", quantity + at)).collect();
            cells.join(",") + "\n"
        };
        let text = line(0) + &line(1000);
        let (delimiter, rows) = rows_of_times(text.as_bytes()).expect("a table");
        assert_eq!((delimiter, rows.len()), (b',', 2));
        let wide: String = (0..64).map(line).collect();
        for text in [line(0), text.replace("7.5,", "x,"), wide] {
            assert_eq!(rows_of_times(text.as_bytes()), None);
        }
    }

    #[test]
    fn decimal_stamps_keep_every_nanosecond() {
        for (cell, expected) in [
            ("1311868164.363181", Some(1_311_868_164_363_181_000)),
            ("1.403715529112143517e+09", Some(1_403_715_529_112_143_517)),
            ("1403715524907143168", Some(1_403_715_524_907_143_168_000_000_000)),
            ("-0,5", Some(-500_000_000)),
            ("0.0000000015", Some(2)),
            ("+7.", Some(7_000_000_000)),
            ("1e31", None),
            ("nan", None),
            ("12:30:00", None),
            ("0.5 s", None),
            ("1.2.3", None),
        ] {
            assert_eq!(decimal_billionths(cell.as_bytes(), true), expected, "{cell}");
        }
        assert_eq!(decimal_billionths(b"0,5", false), None);
    }

    #[test]
    fn dates_and_times_of_day_are_seconds() {
        for (cell, expected) in [
            ("1970-01-02 00:00:01.5", 86401.5),
            ("1970/01/02 00:00:01.5", 86401.5),
            ("02.01.1970 00:00:01,5", 86401.5),
            ("1970-01-02T00:00:01.5Z", 86401.5),
            ("01:00:01.25", 3601.25),
            ("01:00:01:250", 3601.25),
            ("59:01.5", 3541.5),
            ("1/2/1970 12:00:01.500 AM", 86401.5),
            ("13/01/1970 00:00:01.5", 12.0 * 86400.0 + 1.5),
            ("1/2/1970 1:00:00 PM", 86400.0 + 13.0 * 3600.0),
            ("19700102_000001.500", 86401.5),
            ("19700102-00:00:01,5", 86401.5),
            ("1970-01-02-00-00-01-500000", 86401.5),
            ("1970-01-02 00:00:01:500", 86401.5),
            ("1970-01-02T02:00:01.5+02:00", 86401.5),
            ("1 days 00:00:01.500000", 86401.5),
            ("1 day, 0:00:01.5", 86401.5),
            ("'02.01.1970 00:00:01.5", 86401.5),
        ] {
            assert_eq!(seconds(cell), Some(expected), "{cell}");
        }
        for cell in ["IDLE", "1970-01-02", "12:30", "1.2.3", "10-20-30", "192.168.0.1:80", "1-2"] {
            assert_eq!(seconds(cell), None, "{cell}");
        }
    }
}
