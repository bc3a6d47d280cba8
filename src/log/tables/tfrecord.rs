//! TFRecord files of `tf.train.Example` and `SequenceExample`, as RLDS stores them: one record per episode.
//! Each feature contains its steps in sequence; `features.json` declares the numbers per step. A record
//! without `steps/…` is a single step.
//!
//! Framing: `tensorflow/core/lib/io/record_writer.h`.

use std::collections::{BTreeMap, BTreeSet};

use super::{
    Column, Episodes, MAX_COLUMNS, MAX_EPISODES, MAX_WIDTH, ReadColumn, ReadContext, RowLoss,
    Table, TableError, most_frequent, rate_by_name,
};
use crate::Extent;
use crate::decode::{Reader, Value, WireError};
use crate::memory_budget::MemoryBudget;

/// Prefix of step features.
pub(super) const STEP_PREFIX: &str = "steps/";
/// One number per step.
const SCALAR_FEATURES: &[&str] = &["is_first", "is_last", "is_terminal", "reward", "discount"];
/// Before a record: length and its checksum; after it: its checksum.
const HEADER_BYTES: usize = 12;
const FOOTER_BYTES: usize = 4;

/// Whether a length with a valid checksum comes first.
pub(crate) fn has_record(bytes: &[u8]) -> bool {
    record_length(bytes).is_some()
}

/// `None` if its checksum is wrong.
fn record_length(bytes: &[u8]) -> Option<u64> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    (masked_checksum(length) == *rest.first_chunk()?).then_some(u64::from_le_bytes(*length))
}

fn masked_checksum(bytes: &[u8]) -> [u8; 4] {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

/// With offsets, up to the first truncated record.
struct Records<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Iterator for Records<'a> {
    type Item = (usize, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let start = self.at;
        let length = usize::try_from(record_length(self.bytes.get(start..)?)?).ok()?;
        let end = start.checked_add(HEADER_BYTES)?.checked_add(length)?;
        let record = self.bytes.get(start + HEADER_BYTES..end)?;
        self.bytes.get(end..end.checked_add(FOOTER_BYTES)?)?;
        self.at = end + FOOTER_BYTES;
        Some((start, record))
    }
}

pub(super) fn episodes_in(bytes: &[u8]) -> Result<Vec<String>, TableError> {
    let mut records = Records { bytes, at: 0 };
    let is_episode = records.next().is_some_and(|(_, first)| {
        let example = Example::parse(first);
        example.is_ok_and(|example| example.is_episode())
    });
    let count = if is_episode { 1 + records.count() } else { 1 };
    Ok((0..count).map(|number| number.to_string()).collect())
}

/// `width` returns the declared width of a feature.
pub(super) fn read(
    bytes: &[u8],
    wanted: Option<&str>,
    width: impl Fn(&str) -> Option<usize>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let ReadContext { losses, memory, .. } = context;
    let (mut found, mut steps) = (Vec::new(), Vec::new());
    let mut records = Records { bytes, at: 0 };
    for (number, (start, record)) in records.by_ref().enumerate() {
        let name = number.to_string();
        let is_other = wanted.is_some_and(|wanted| wanted != name);
        if is_other && steps.is_empty() && number > 0 {
            continue;
        }
        let crc = &bytes[start + HEADER_BYTES + record.len()..][..FOOTER_BYTES];
        if masked_checksum(record) != *crc {
            let what = format!("record {number}: wrong checksum");
            losses.add(start, Extent::Messages, Some(1), what);
            continue;
        }
        let mut lost = |what: &dyn std::fmt::Display| {
            losses.add(start, Extent::Messages, Some(1), format!("record {number}: {what}"));
        };
        // Numbers take 4 bytes in the file (1 if small), 8 in memory.
        if !is_other || number == 0 {
            memory.reserve(record.len())?;
        }
        if wanted.is_none() && found.len() > MAX_EPISODES {
            return Err(TableError::Episodes);
        }
        match Example::parse(record) {
            Ok(example) if example.is_episode() && is_other => {}
            Ok(example) if example.is_episode() => match example.table(&width, memory) {
                Ok(table) => found.push((name, table)),
                Err(what) => lost(&what),
            },
            Ok(example) => steps.push(example),
            Err(error) => lost(&error),
        }
    }
    let end = records.at;
    if end < bytes.len() {
        let what = "the file ends within a record, or is damaged from here on".to_owned();
        losses.add(end, Extent::Tail, None, what);
    }
    if found.is_empty() && !steps.is_empty() {
        found.push(("0".to_owned(), table_of_single_steps(&steps, memory)?));
    }
    Ok(found)
}

/// Values per feature; sequences row by row.
#[derive(Default)]
struct Example {
    features: BTreeMap<String, Vec<f64>>,
    sequences: BTreeMap<String, Vec<Vec<f64>>>,
}

impl Example {
    fn parse(record: &[u8]) -> Result<Self, WireError> {
        let mut example = Self::default();
        let mut reader = Reader::new(record);
        while let Some((number, value)) = reader.field()? {
            let Value::Bytes(bytes) = value else { continue };
            match number {
                1 => example.features.extend(parse_entries(bytes, parse_numbers)?),
                2 => example.sequences.extend(parse_entries(bytes, parse_rows)?),
                _ => {}
            }
        }
        Ok(example)
    }

    fn is_episode(&self) -> bool {
        !self.sequences.is_empty() || self.features.keys().any(|name| name.starts_with(STEP_PREFIX))
    }

    fn rate_hz(&self) -> Option<f64> {
        self.features.iter().find_map(|(name, own)| match own.as_slice() {
            [value] => rate_by_name(name.rsplit('/').next().unwrap_or(name), *value),
            _ => None,
        })
    }

    fn table(
        self,
        width: &impl Fn(&str) -> Option<usize>,
        memory: &mut MemoryBudget,
    ) -> Result<Table, TableError> {
        let rate_hz = self.rate_hz();
        let (mut unread, mut candidates) = (Vec::new(), Vec::new());
        for (name, rows) in self.sequences {
            match step_column(&name, rows.iter().map(|row| Some(row.as_slice()))) {
                Some(candidate) => candidates.push(candidate),
                None => unread.push((name, "rows of different lengths, or images".to_owned())),
            }
        }
        let mut columns = Vec::new();
        for (name, values) in self.features {
            let Some(name) = name.strip_prefix(STEP_PREFIX).filter(|_| !values.is_empty()) else {
                continue;
            };
            let width = if SCALAR_FEATURES.contains(&name) { Some(1) } else { width(name) };
            columns.push((name.to_owned(), width.filter(|width| *width > 0), values));
        }
        let single = columns.iter().find(|(name, ..)| SCALAR_FEATURES.contains(&name.as_str()));
        let declared =
            columns.iter().filter_map(|(_, width, values)| Some(values.len() / (*width)?));
        let declared = declared.chain(candidates.iter().map(|candidate| candidate.rows));
        let rows = match single {
            Some((_, _, values)) => values.len(),
            None if columns.iter().any(|(_, width, _)| width.is_some()) || columns.is_empty() => {
                most_frequent(declared)
            }
            None => columns.iter().map(|(_, _, values)| values.len()).min().unwrap_or(0),
        };
        if rows == 0 {
            return Err("it contains no steps with numbers".into());
        }
        let mut losses = Vec::new();
        for (name, width, values) in columns {
            let count = values.len();
            if count / rows > MAX_WIDTH {
                unread.push((name, "its rows are images".to_owned()));
            } else if !count.is_multiple_of(rows) {
                let whole = width.map_or(rows, |width| count / width);
                let what = format!(
                    "'{name}' has {count} numbers for {rows} steps: it is unknown which are missing"
                );
                losses.push(RowLoss { rows: whole, what: what.into() });
                unread.push((name, format!("{count} numbers, not a multiple of {rows} steps")));
            } else {
                let column = Column::untyped(&name, count / rows, values);
                candidates.push(ReadColumn::complete(column));
            }
        }
        if candidates.len() > MAX_COLUMNS {
            let what = format!("{} features; only {MAX_COLUMNS} are read", candidates.len());
            losses.push(RowLoss { rows: 0, what: what.into() });
            candidates.truncate(MAX_COLUMNS);
        }
        let mut table = Table::from_columns(candidates, Some(rows), memory);
        table.rate_hz = rate_hz;
        table.unread.extend(unread);
        table.losses.extend(losses);
        Ok(table)
    }
}

/// `None` for images and lists of varying length. Steps with a different number of values are lost.
fn step_column<'a>(
    name: &str,
    steps: impl ExactSizeIterator<Item = Option<&'a [f64]>> + Clone,
) -> Option<ReadColumn> {
    let rows = steps.len();
    let width = most_frequent(steps.clone().flatten().map(<[f64]>::len).filter(|own| *own > 0));
    let fits = |own: &Option<&[f64]>| own.is_some_and(|own| own.len() == width);
    if !(1..=MAX_WIDTH).contains(&width) || 2 * steps.clone().filter(fits).count() <= rows {
        return None;
    }
    let (mut values, mut lost, mut why) = (Vec::with_capacity(rows * width), Vec::new(), None);
    for (row, own) in steps.enumerate() {
        match own.filter(|own| own.len() == width) {
            Some(own) => values.extend_from_slice(own),
            None => {
                values.resize(values.len() + width, f64::NAN);
                lost.push(row..row + 1);
                let count = own.map_or(0, <[f64]>::len);
                why.get_or_insert_with(|| {
                    format!("step {row} has {count} numbers, not {width}").into()
                });
            }
        }
    }
    Some(ReadColumn { column: Column::untyped(name, width, values), rows, lost, why })
}

fn table_of_single_steps(
    steps: &[Example],
    memory: &mut MemoryBudget,
) -> Result<Table, TableError> {
    let names: BTreeSet<&String> = steps.iter().flat_map(|step| step.features.keys()).collect();
    let (mut unread, mut candidates) = (Vec::new(), Vec::new());
    if names.len() > MAX_COLUMNS {
        return Err(format!("{} features, more than {MAX_COLUMNS}", names.len()).into());
    }
    for name in names {
        let own = steps.iter().map(|step| step.features.get(name).map(Vec::as_slice));
        memory.reserve(own.clone().flatten().map(<[f64]>::len).sum())?;
        match step_column(name, own) {
            Some(candidate) => candidates.push(candidate),
            None => unread.push((name.clone(), "rows of different lengths, or images".to_owned())),
        }
    }
    let mut table = Table::from_columns(candidates, Some(steps.len()), memory);
    table.rate_hz = steps.first().and_then(Example::rate_hz);
    table.unread.extend(unread);
    Ok(table)
}

/// Omits features without numbers.
fn parse_entries<T>(
    bytes: &[u8],
    read: impl Fn(&[u8]) -> Result<Option<T>, WireError>,
) -> Result<Vec<(String, T)>, WireError> {
    let (mut reader, mut found) = (Reader::new(bytes), Vec::new());
    while let Some((_, entry)) = reader.field()? {
        let Value::Bytes(entry) = entry else { continue };
        let (mut entry, mut name, mut feature) = (Reader::new(entry), String::new(), None);
        while let Some((number, value)) = entry.field()? {
            match (number, value) {
                (1, Value::Bytes(text)) => name = String::from_utf8_lossy(text).into_owned(),
                (2, Value::Bytes(bytes)) => feature = read(bytes)?,
                _ => {}
            }
        }
        found.extend(feature.map(|feature| (name, feature)));
    }
    Ok(found)
}

/// `None` if it holds bytes.
fn parse_numbers(feature: &[u8]) -> Result<Option<Vec<f64>>, WireError> {
    let mut reader = Reader::new(feature);
    while let Some((kind, list)) = reader.field()? {
        let (Value::Bytes(list), 2 | 3) = (list, kind) else { continue };
        let (mut list, mut values) = (Reader::new(list), Vec::new());
        while let Some((_, value)) = list.field()? {
            match (kind, value) {
                (2, Value::Bytes(packed)) => {
                    let (all, _) = packed.as_chunks();
                    values.extend(all.iter().map(|four| f64::from(f32::from_le_bytes(*four))));
                }
                (2, Value::Fixed32(four)) => values.push(f32::from_le_bytes(four).into()),
                (3, Value::Bytes(packed)) => {
                    let mut packed = Reader::new(packed);
                    while !packed.is_at_end() {
                        let number = packed.varint().map_err(|fault| packed.error(fault))?;
                        values.push(number.cast_signed() as f64);
                    }
                }
                (3, Value::Varint(number)) => values.push(number.cast_signed() as f64),
                _ => {}
            }
        }
        return Ok(Some(values));
    }
    Ok(None)
}

fn parse_rows(list: &[u8]) -> Result<Option<Vec<Vec<f64>>>, WireError> {
    let (mut reader, mut rows) = (Reader::new(list), Vec::new());
    while let Some((_, feature)) = reader.field()? {
        let Value::Bytes(feature) = feature else { continue };
        let Some(row) = parse_numbers(feature)? else { return Ok(None) };
        rows.push(row);
    }
    Ok(Some(rows))
}
