//! Rows of a text table, read by blocks of lines on all threads.

use std::ops::Range;

use memchr::{memchr, memchr_iter};
use rayon::prelude::*;

use super::csv::{
    MAX_LINE_BYTES, comment, decimal_billionths, is_text, number, repeats_names, split_cells,
    table_width, trailing_empty_cells,
};
use super::row_labels::Levels;
use super::{ReadContext, TableError};
use crate::Extent;

/// Bytes of a block: its numbers stay in the cache until they are appended to the columns.
const BLOCK_BYTES: usize = 1 << 18;
/// Blocks per thread that are read before their memory is reserved.
const BLOCKS_PER_THREAD: usize = 4;

pub(super) struct RowFormat<'a> {
    pub delimiter: u8,
    pub names: Option<&'a [String]>,
    pub width: usize,
    /// Columns of times.
    pub times: &'a [usize],
}

/// Columns of a text table.
pub(super) struct TextRows<'a> {
    /// Per column.
    pub values: Vec<Vec<f64>>,
    /// Per column; empty unless it holds times.
    pub billionths: Vec<Vec<Option<i128>>>,
    /// First cell of each column that is no number, not empty if possible.
    pub texts: Vec<Option<&'a [u8]>>,
    /// Number of texts in each column.
    pub text_counts: Vec<usize>,
    /// The texts of each column, unless they are many.
    pub levels: Vec<Levels<&'a [u8]>>,
    /// Line of each row, from `first_line`.
    pub lines: Vec<usize>,
    pub beside: Option<CellsBeside>,
}

/// Cells beside a table, which an empty cell separates from its rows, such as notes in a spreadsheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CellsBeside {
    count: usize,
    /// Line of the first.
    line: usize,
}

impl CellsBeside {
    pub fn add(known: &mut Option<Self>, count: usize, line: usize) {
        if count > 0 {
            known.get_or_insert(Self { count: 0, line }).count += count;
        }
    }

    pub fn note(self) -> String {
        let Self { count, line } = self;
        format!("cells beside the table are not used: {count}, from line {line} on")
    }
}

impl<'a> TextRows<'a> {
    fn empty(width: usize) -> Self {
        Self {
            values: vec![Vec::new(); width],
            billionths: vec![Vec::new(); width],
            texts: vec![None; width],
            text_counts: vec![0; width],
            levels: vec![Levels::default(); width],
            lines: Vec::new(),
            beside: None,
        }
    }

    /// Appends rows whose line 0 is `first_line`.
    fn extend(&mut self, more: &Self, first_line: usize) {
        for (all, own) in self.values.iter_mut().zip(&more.values) {
            all.extend_from_slice(own);
        }
        for (all, own) in self.billionths.iter_mut().zip(&more.billionths) {
            all.extend_from_slice(own);
        }
        for (all, own) in self.texts.iter_mut().zip(&more.texts) {
            prefer_text(all, *own);
        }
        for (all, own) in self.text_counts.iter_mut().zip(&more.text_counts) {
            *all += own;
        }
        for (all, own) in self.levels.iter_mut().zip(&more.levels) {
            all.extend(own, self.lines.len());
        }
        self.lines.extend(more.lines.iter().map(|own| first_line + own));
        if let Some(CellsBeside { count, line }) = more.beside {
            CellsBeside::add(&mut self.beside, count, first_line + line);
        }
    }
}

/// Reads all rows of `bytes`, whose first line is `first_line`.
///
/// # Errors
/// If they exceed the memory limit.
pub(super) fn read<'a>(
    bytes: &'a [u8],
    first_line: usize,
    format: &RowFormat<'_>,
    context: &mut ReadContext,
) -> Result<TextRows<'a>, TableError> {
    let width = format.width;
    let mut all = TextRows::empty(width);
    let mut malformed: Option<(u64, String)> = None;
    let mut line = first_line;
    let blocks: Vec<Range<usize>> = split_at_lines(bytes).collect();
    for group in blocks.chunks(BLOCKS_PER_THREAD * rayon::current_num_threads()) {
        let group = group.par_iter().map(|block| Block::read(&bytes[block.clone()], format));
        let group: Vec<Block<'a>> = group.collect();
        let rows: usize = group.iter().map(|block| block.rows.lines.len()).sum();
        // Times take two more numbers, and the mark for a missing one.
        let levels = group.iter().flat_map(|block| &block.rows.levels);
        let texts = levels.map(Levels::row_count).sum::<usize>();
        context.memory.reserve(rows * (width + 1 + 4 * format.times.len()) + 2 * texts)?;
        for block in group {
            all.extend(&block.rows, line);
            if let Some(own) = block.cut_off {
                let what = format!("the file ends within line {}", line + own);
                context.losses.add_unplaced(Extent::Tail, Some(1), what);
            }
            if let Some((count, own, what)) = block.malformed {
                let first = || (0, format!("line {}{what}", line + own));
                malformed.get_or_insert_with(first).0 += count;
            }
            line += block.line_count;
        }
    }
    if let Some((count, first)) = malformed {
        context.losses.add_unplaced(Extent::Messages, Some(count), first);
    }
    Ok(all)
}

/// Blocks of whole lines.
fn split_at_lines(bytes: &[u8]) -> impl Iterator<Item = Range<usize>> {
    let mut start = 0;
    std::iter::from_fn(move || {
        let end = bytes.len().min(start + BLOCK_BYTES);
        let end = end + memchr(b'\n', &bytes[end..]).map_or(bytes.len() - end, |at| at + 1);
        let block = start..end;
        start = end;
        (!block.is_empty()).then_some(block)
    })
}

/// Rows of a block. Lines count from 0.
struct Block<'a> {
    rows: TextRows<'a>,
    line_count: usize,
    /// Line within which the file ends.
    cut_off: Option<usize>,
    /// Number of rows, and line and defect of the first.
    malformed: Option<(u64, usize, String)>,
}

impl<'a> Block<'a> {
    fn read(bytes: &'a [u8], format: &RowFormat<'_>) -> Self {
        let width = format.width;
        let rows = TextRows::empty(width);
        let mut block = Self { rows, line_count: 0, cut_off: None, malformed: None };
        let mut decimals = vec![Decimal::default(); width];
        let (mut row, mut numbers): (Vec<&[u8]>, Vec<f64>) = Default::default();
        let mut start = 0;
        let ends = memchr_iter(b'\n', bytes).chain([bytes.len()]);
        for (line, end) in ends.enumerate() {
            if start == bytes.len() {
                break;
            }
            let text = trim_line(&bytes[start..end]);
            start = bytes.len().min(end + 1);
            block.line_count = line + 1;
            if text.len() <= MAX_LINE_BYTES
                && parse_plain_row(text, format.delimiter, &mut decimals).is_some()
            {
                block.rows.lines.push(line);
                for (column, decimal) in block.rows.values.iter_mut().zip(&decimals) {
                    column.push(decimal.value);
                }
                for &at in format.times {
                    block.rows.billionths[at].push(decimals[at].billionths());
                }
                continue;
            }
            if text.trim_ascii().is_empty() || comment(text).is_some() {
                continue;
            }
            let is_last = end == bytes.len();
            block.add_line(line, text, is_last, format, (&mut row, &mut numbers));
        }
        block
    }

    /// Adds a line of any content.
    fn add_line(
        &mut self,
        line: usize,
        text: &'a [u8],
        is_last: bool,
        format: &RowFormat<'_>,
        (row, numbers): (&mut Vec<&'a [u8]>, &mut Vec<f64>),
    ) {
        let &RowFormat { delimiter, names, width, times } = format;
        match text.len() > MAX_LINE_BYTES {
            true => row.clear(),
            false => split_cells(text, delimiter, row),
        }
        row.truncate(row.len() - trailing_empty_cells(row).min(row.len().saturating_sub(width)));
        let others = row.drain(table_width(row, width)..).filter(|cell| !cell.is_empty()).count();
        CellsBeside::add(&mut self.rows.beside, others, line);
        numbers.clear();
        numbers.extend(row.iter().map(|cell| number(cell, delimiter)));
        let texts_in_row =
            row.iter().zip(&*numbers).filter(|(cell, own)| is_text(cell, **own)).count();
        let is_header = || names.is_some_and(|names| repeats_names(row, names));
        if row.len() == width && 2 * texts_in_row > width && is_header() {
            return;
        }
        if row.len() != width && is_last {
            self.cut_off = Some(line);
            return;
        }
        if row.len() != width || 2 * texts_in_row > width {
            let what = match () {
                () if text.len() > MAX_LINE_BYTES => format!(" has {} bytes", text.len()),
                () if row.len() == width => {
                    format!(": {texts_in_row} of {width} cells are not numbers")
                }
                () => format!(": {} columns, not {width}", row.len()),
            };
            self.malformed.get_or_insert((0, line, what)).0 += 1;
            return;
        }
        self.rows.lines.push(line);
        for &at in times {
            self.rows.billionths[at].push(decimal_billionths(row[at], delimiter != b','));
        }
        for (at, (cell, own)) in row.iter().zip(numbers).enumerate() {
            self.rows.values[at].push(*own);
            if is_text(cell, *own) {
                self.rows.text_counts[at] += 1;
                self.rows.levels[at].push(self.rows.lines.len() - 1, *cell);
            }
            if own.is_nan() {
                prefer_text(&mut self.rows.texts[at], Some(*cell));
            }
        }
    }
}

/// A later text is preferred to an empty cell.
fn prefer_text<'a>(known: &mut Option<&'a [u8]>, other: Option<&'a [u8]>) {
    if known.is_none_or(<[u8]>::is_empty) {
        *known = other.or(*known);
    }
}

/// Without blanks around it. Tabs stay: they may delimit empty cells.
pub(super) fn trim_line(line: &[u8]) -> &[u8] {
    let is_space = |byte: &u8| matches!(byte, b' ' | b'\r' | b'\n');
    let start = line.iter().position(|byte| !is_space(byte)).unwrap_or(line.len());
    let end = line.iter().rposition(|byte| !is_space(byte)).map_or(start, |last| last + 1);
    &line[start..end]
}

/// Decimal number without an exponent.
#[derive(Clone, Copy, Debug, Default)]
struct Decimal {
    value: f64,
    /// All digits as one integer.
    digits: i128,
    /// How many of them are behind the mark.
    fraction: usize,
}

impl Decimal {
    /// The number times 10⁹, rounded to an integer.
    fn billionths(&self) -> Option<i128> {
        const PLACES: usize = 9;
        if self.fraction <= PLACES {
            return Some(self.digits * 10_i128.pow((PLACES - self.fraction) as u32));
        }
        let divisor = 10_i128.pow((self.fraction - PLACES) as u32);
        Some((self.digits + self.digits.signum() * divisor / 2) / divisor)
    }
}

/// Parses a row of decimal numbers without exponents, blanks and quotation marks. `None` for any other row, and for one
/// with another number of cells.
fn parse_plain_row(text: &[u8], delimiter: u8, row: &mut [Decimal]) -> Option<()> {
    /// Digits that always fit into 64 bits.
    const MAX_DIGITS: usize = 19;
    let mut at = 0;
    let last = row.len().checked_sub(1)?;
    for (index, decimal) in row.iter_mut().enumerate() {
        let start = at;
        let is_negative = text.get(at) == Some(&b'-');
        at += usize::from(is_negative);
        let mut digits = 0_u64;
        let whole = take_digits(&text[at..], &mut digits);
        at += whole;
        let mut fraction = 0;
        let mark = text.get(at).copied();
        if mark == Some(b'.') || (mark == Some(b',') && delimiter != b',') {
            fraction = take_digits(&text[at + 1..], &mut digits);
            at += 1 + fraction;
        }
        if !(1..=MAX_DIGITS).contains(&(whole + fraction)) {
            return None;
        }
        let value = match exact_quotient(digits, fraction) {
            Some(value) if is_negative => -value,
            Some(value) => value,
            None if mark == Some(b',') && delimiter != b',' => return None,
            None => std::str::from_utf8(&text[start..at]).ok()?.parse().ok()?,
        };
        let digits = i128::from(digits);
        *decimal = Decimal { value, digits: if is_negative { -digits } else { digits }, fraction };
        match text.get(at) {
            Some(byte) if *byte == delimiter && index < last => at += 1,
            None if index == last => {}
            _ => return None,
        }
    }
    Some(())
}

/// Appends the leading decimal digits to `digits`, and counts them.
fn take_digits(text: &[u8], digits: &mut u64) -> usize {
    let mut count = 0;
    while let Some(digit) = text.get(count).map(|byte| byte.wrapping_sub(b'0'))
        && digit < 10
    {
        *digits = digits.wrapping_mul(10).wrapping_add(u64::from(digit));
        count += 1;
    }
    count
}

/// `digits` / 10^`fraction` if both are exact in `f64`, so that the quotient is rounded once (Clinger 1990).
fn exact_quotient(digits: u64, fraction: usize) -> Option<f64> {
    const MAX_EXACT: u64 = 1 << f64::MANTISSA_DIGITS;
    const POWERS: [f64; 23] = [
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
        1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
    ];
    let power = POWERS.get(fraction)?;
    (digits <= MAX_EXACT).then(|| digits as f64 / power)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn plain_row(text: &str, delimiter: u8, width: usize) -> Option<Vec<Decimal>> {
        let mut row = vec![Decimal::default(); width];
        parse_plain_row(text.as_bytes(), delimiter, &mut row)?;
        Some(row)
    }

    fn assert_equals_general_path(cell: &str, delimiter: u8) {
        let Some(row) = plain_row(cell, delimiter, 1) else { return };
        let expected = number(cell.as_bytes(), delimiter);
        assert_eq!(row[0].value.to_bits(), expected.to_bits(), "{cell}");
        let expected = decimal_billionths(cell.as_bytes(), delimiter != b',');
        assert_eq!(row[0].billionths(), expected, "{cell}");
    }

    #[test]
    fn plain_numbers_are_read_as_by_the_general_path() {
        for cell in [
            "0", "-0", "-0.0", "1.", ".5", "-.25", "007", "0.1", "9007199254740992",
            "9007199254740993", "1764253999.123456789", "1764253999123456789",
            "0.1234567890123456789", "123456789.0000000005", "-1.0000000015", "3,5",
        ] {
            assert_equals_general_path(cell, b',');
            assert_equals_general_path(cell, b';');
        }
        assert!(plain_row("1.5,2,-3", b',', 3).is_some());
        assert!(plain_row("1,5;2;-3", b';', 3).is_some());
    }

    #[test]
    fn other_rows_take_the_general_path() {
        for text in [
            "", "1,2", "1,2,3,4", "1,2,", "1, 2,3", "\"1\",2,3", "1e3,2,3", "nan,2,3", "1,-,3",
            "1,.,3", "+1,2,3", "1,2,3 ", "12345678901234567890,2,3",
        ] {
            assert!(plain_row(text, b',', 3).is_none(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_plain_number_is_read_as_by_the_general_path(cell in "-?[0-9]{0,12}[.,]?[0-9]{0,12}") {
            assert_equals_general_path(&cell, b',');
            assert_equals_general_path(&cell, b';');
        }
    }
}
