//! TFRecord files of `tf.train.Example` and `SequenceExample`, as RLDS keeps episodes: a record each, its steps
//! one after another in every feature. `features.json` beside them says how many numbers a step has.
//!
//! Framing: `tensorflow/core/lib/io/record_writer.h`. A record without `steps/…` is a single step.

use std::collections::BTreeMap;

use super::{
    Column, Episodes, MOST_COLUMNS, MOST_NUMBERS, MOST_WIDE, RATES, Refusal, Table, usual,
};
use crate::Extent;
use crate::decode::{Reader, Value, WireError};
use crate::losses::Losses;

/// What the names of a step's features begin with.
pub(super) const STEPS: &str = "steps/";
/// Features that each step has one number of.
const SINGLE: &[&str] = &["is_first", "is_last", "is_terminal", "reward", "discount"];
/// A record's length and its checksum, and the checksum behind it.
const HEAD: usize = 12;
const FOOT: usize = 4;

/// Whether `bytes` begin with a record: its length, and a checksum that holds for it.
pub(crate) fn has_record(bytes: &[u8]) -> bool {
    length(bytes).is_some()
}

/// The length of the record that `bytes` begin with; `None` where its checksum does not hold.
fn length(bytes: &[u8]) -> Option<u64> {
    let (length, rest) = bytes.split_first_chunk::<8>()?;
    (masked(length) == *rest.first_chunk()?).then_some(u64::from_le_bytes(*length))
}

/// The checksum of some bytes as it stands in the file.
fn masked(bytes: &[u8]) -> [u8; 4] {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

/// The records of a file with their places, up to the first that is cut off.
struct Records<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Iterator for Records<'a> {
    type Item = (usize, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let start = self.at;
        let length = usize::try_from(length(self.bytes.get(start..)?)?).ok()?;
        let end = start.checked_add(HEAD)?.checked_add(length)?;
        let record = self.bytes.get(start + HEAD..end)?;
        self.bytes.get(end..end.checked_add(FOOT)?)?;
        self.at = end + FOOT;
        Some((start, record))
    }
}

/// The names of the episodes of a file.
pub(super) fn episodes_in(bytes: &[u8]) -> Result<Vec<String>, Refusal> {
    let mut records = Records { bytes, at: 0 };
    let is_episode = records.next().is_some_and(|(_, first)| {
        let example = Example::of(first);
        example.is_ok_and(|example| example.is_episode())
    });
    let count = if is_episode { 1 + records.count() } else { 1 };
    Ok((0..count).map(|number| number.to_string()).collect())
}

/// The episodes of a file; the only one that is `wanted`, if one is. `width` is that of a feature as declared.
pub(super) fn read(
    bytes: &[u8],
    wanted: Option<&str>,
    width: impl Fn(&str) -> Option<usize>,
    losses: &mut Losses,
) -> Result<Episodes, Refusal> {
    let (mut found, mut steps) = (Vec::new(), Vec::new());
    let mut records = Records { bytes, at: 0 };
    for (number, (start, record)) in records.by_ref().enumerate() {
        let name = number.to_string();
        let is_other = wanted.is_some_and(|wanted| wanted != name);
        if is_other && steps.is_empty() && number > 0 {
            continue;
        }
        let crc = &bytes[start + HEAD + record.len()..][..FOOT];
        if masked(record) != *crc {
            let what = format!("record {number}: its checksum does not hold");
            losses.add(start, Extent::Messages, Some(1), what);
            continue;
        }
        let mut lost = |what: &dyn std::fmt::Display| {
            losses.add(start, Extent::Messages, Some(1), format!("record {number}: {what}"));
        };
        match Example::of(record) {
            Ok(example) if example.is_episode() && is_other => {}
            Ok(example) if example.is_episode() => match example.table(&width) {
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
        found.push(("0".to_owned(), single_steps(steps)?));
    }
    Ok(found)
}

/// What an example holds: numbers by the names of its features, and those of a sequence row by row.
#[derive(Default)]
struct Example {
    features: BTreeMap<String, Vec<f64>>,
    sequences: BTreeMap<String, Vec<Vec<f64>>>,
}

impl Example {
    fn of(record: &[u8]) -> Result<Self, WireError> {
        let mut example = Self::default();
        let mut reader = Reader::new(record);
        while let Some((number, value)) = reader.field()? {
            let Value::Bytes(bytes) = value else { continue };
            match number {
                1 => example.features.extend(entries(bytes, numbers)?),
                2 => example.sequences.extend(entries(bytes, rows)?),
                _ => {}
            }
        }
        Ok(example)
    }

    fn is_episode(&self) -> bool {
        !self.sequences.is_empty() || self.features.keys().any(|name| name.starts_with(STEPS))
    }

    /// The rate that a feature of the whole says.
    fn rate_hz(&self) -> Option<f64> {
        let is_rate = |name: &str| RATES.contains(&name.rsplit('/').next().unwrap_or(name));
        let rate = self.features.iter().find(|(name, own)| is_rate(name) && own.len() == 1);
        rate.map(|(_, own)| own[0]).filter(|rate| rate.is_finite() && *rate > 0.0)
    }

    /// The steps of an episode.
    fn table(self, width: &impl Fn(&str) -> Option<usize>) -> Result<Table, Refusal> {
        let rate_hz = self.rate_hz();
        let mut columns = Vec::new();
        for (name, rows) in self.sequences {
            let wide = rows.first().map_or(0, Vec::len);
            let is_even = rows.iter().all(|row| row.len() == wide);
            columns.extend((is_even && wide > 0).then(|| (name, Some(wide), rows.concat())));
        }
        for (name, values) in self.features {
            let Some(name) = name.strip_prefix(STEPS).filter(|_| !values.is_empty()) else {
                continue;
            };
            let width = if SINGLE.contains(&name) { Some(1) } else { width(name) };
            columns.push((name.to_owned(), width, values));
        }
        let single = columns.iter().find(|(name, ..)| SINGLE.contains(&name.as_str()));
        let declared =
            columns.iter().filter_map(|(_, width, values)| Some(values.len() / (*width)?));
        let rows = match single {
            Some((_, _, values)) => values.len(),
            None if columns.iter().any(|(_, width, _)| width.is_some()) => usual(declared),
            None => columns.iter().map(|(_, _, values)| values.len()).min().unwrap_or(0),
        };
        if rows == 0 {
            return Err("it holds no steps with numbers".to_owned());
        }
        let is_of = |count: usize| count.is_multiple_of(rows) && count / rows <= MOST_WIDE;
        let columns = columns.into_iter().filter(|(_, _, values)| is_of(values.len()));
        let columns =
            columns.take(MOST_COLUMNS).map(|(name, _, values)| column(name, rows, values));
        Ok(Table { rows, columns: columns.collect(), rate_hz, ..Table::default() })
    }
}

/// Records of a step each, as one table.
fn single_steps(steps: Vec<Example>) -> Result<Table, Refusal> {
    let (rows, rate_hz) = (steps.len(), steps[0].rate_hz());
    let widths: Vec<(String, usize)> = steps[0]
        .features
        .iter()
        .filter(|(_, values)| (1..=MOST_WIDE).contains(&values.len()))
        .map(|(name, values)| (name.clone(), values.len()))
        .take(MOST_COLUMNS)
        .collect();
    if widths.iter().map(|(_, width)| width * rows).sum::<usize>() > MOST_NUMBERS {
        return Err(format!("it has more than {MOST_NUMBERS} numbers"));
    }
    let columns = widths.into_iter().map(|(name, width)| {
        let own = |step: &Example| {
            let values = step.features.get(&name).filter(|values| values.len() == width);
            values.cloned().unwrap_or_else(|| vec![f64::NAN; width])
        };
        let values = steps.iter().flat_map(own).collect();
        column(name.clone(), rows, values)
    });
    Ok(Table { rows, columns: columns.collect(), rate_hz, ..Table::default() })
}

fn column(name: String, rows: usize, values: Vec<f64>) -> Column {
    let width = values.len() / rows;
    Column { name, kind: "number".to_owned(), width, parts: Vec::new(), values }
}

/// The entries of a map of features: names, and what `read` makes of each; without those that hold no numbers.
fn entries<T>(
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

/// The numbers of a feature; `None` of one of bytes.
fn numbers(feature: &[u8]) -> Result<Option<Vec<f64>>, WireError> {
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

/// The rows of a list of features.
fn rows(list: &[u8]) -> Result<Option<Vec<Vec<f64>>>, WireError> {
    let (mut reader, mut rows) = (Reader::new(list), Vec::new());
    while let Some((_, feature)) = reader.field()? {
        let Value::Bytes(feature) = feature else { continue };
        let Some(row) = numbers(feature)? else { return Ok(None) };
        rows.push(row);
    }
    Ok(Some(rows))
}
