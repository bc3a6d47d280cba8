//! Tables as text: names of columns in the first line, a row in each line after it.

use ::csv::{ReaderBuilder, StringRecord, Trim};
use jiff::civil::DateTime;

use super::{Column, Episodes, MOST_COLUMNS, MOST_NUMBERS, Refusal, Table, clock};
use crate::Extent;
use crate::losses::Losses;
use crate::rtde;

/// Of the cells of a column this share holds numbers, or it is one of text.
const NUMERIC: f64 = 0.5;

/// Whether the text `bytes` is a table: a line of several names, and numbers in the next.
pub(crate) fn first_line(bytes: &[u8]) -> bool {
    let mut lines =
        bytes.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
    let (Some(header), Some(row)) = (lines.next(), lines.next()) else { return false };
    let header = header.strip_prefix(b"\xef\xbb\xbf").unwrap_or(header);
    let delimiter = rtde::delimiter(header);
    let names: Vec<&[u8]> = rtde::cells(header, delimiter).collect();
    let cells: Vec<&[u8]> = rtde::cells(row, delimiter).collect();
    let is_number = |cell: &&[u8]| rtde::number(cell, delimiter != b',').is_some();
    let numbers = cells.iter().filter(|cell| is_number(cell)).count();
    names.len() > 2 && !names.iter().any(is_number) && 2 * numbers > names.len()
        // The last cell of a row may be cut off where only a beginning was read.
        && cells.len() <= names.len()
}

/// Whether a table in text names a column of times, so that it is a log and no table of postures.
pub(crate) fn has_time(bytes: &[u8]) -> bool {
    let header = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let delimiter = rtde::delimiter(header);
    rtde::cells(header, delimiter).any(|name| std::str::from_utf8(name).is_ok_and(clock::is_time))
}

pub(super) fn read(bytes: &[u8], losses: &mut Losses) -> Result<Episodes, Refusal> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let header = bytes.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let delimiter = rtde::delimiter(header);
    let names: Vec<String> = rtde::cells(header, delimiter)
        .map(|name| String::from_utf8_lossy(name).into_owned())
        .collect();
    if names.len() > MOST_COLUMNS {
        return Err(format!("its first line names {} columns", names.len()));
    }
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .quoting(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(bytes);
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    let mut record = StringRecord::new();
    let ends_in_line = bytes.last() == Some(&b'\n');
    let mut malformed: Option<(u64, u64, String)> = None;
    loop {
        match reader.read_record(&mut record) {
            Ok(false) => break,
            Ok(true) => {}
            Err(error) if error.is_io_error() => break,
            Err(_) => record.clear(),
        }
        let line = record.position().map_or(0, |position| position.line());
        let is_last = reader.position().byte() >= bytes.len() as u64 && !ends_in_line;
        if record.len() != names.len() {
            if is_last {
                losses.add_unplaced(
                    Extent::Tail,
                    Some(1),
                    format!("the file ends within line {line}"),
                );
            } else {
                let what = format!(
                    "line {line}: {} columns, the first line names {}",
                    record.len(),
                    names.len()
                );
                malformed.get_or_insert((line, 0, what)).1 += 1;
            }
            continue;
        }
        if values.first().is_some_and(|column| column.len() * names.len() > MOST_NUMBERS) {
            return Err(format!("it has more than {MOST_NUMBERS} numbers"));
        }
        for (column, cell) in values.iter_mut().zip(&record) {
            column.push(number(cell, delimiter != b','));
        }
    }
    if let Some((_, count, first)) = malformed {
        losses.add_unplaced(Extent::Messages, Some(count), first);
    }
    let rows = values.first().map_or(0, Vec::len);
    let is_numeric = |values: &[f64]| {
        let finite = values.iter().filter(|value| value.is_finite()).count();
        finite as f64 >= NUMERIC * rows as f64
    };
    let columns = names
        .into_iter()
        .zip(values)
        .filter(|(name, values)| !name.is_empty() && is_numeric(values));
    let columns = columns.map(|(name, values)| Column {
        name,
        kind: "number".to_owned(),
        width: 1,
        parts: Vec::new(),
        values,
    });
    Ok(vec![("0".to_owned(), Table { rows, columns: columns.collect(), rate_hz: None })])
}

/// The number in a cell; of a date and time of day the seconds since 1970; NaN where there is neither.
fn number(cell: &str, decimal_comma: bool) -> f64 {
    rtde::number(cell.as_bytes(), decimal_comma)
        .or_else(|| seconds(cell.trim_matches('"')))
        .unwrap_or(f64::NAN)
}

fn seconds(cell: &str) -> Option<f64> {
    let is_date = cell.len() >= 16 && cell.as_bytes()[4] == b'-';
    let moment = is_date.then(|| {
        cell.parse::<jiff::Timestamp>().ok().or_else(|| {
            let civil: DateTime = cell.parse().ok()?;
            Some(civil.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp())
        })
    });
    Some(moment.flatten()?.as_nanosecond() as f64 * 1e-9)
}
