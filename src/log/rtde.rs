//! Tables of Universal Robots' RTDE client, written by its `record.py`.
//!
//! The first line contains column names, each further line a sample. Elements of a vector are numbered from
//! 0 (`actual_q_0` …). `timestamp` is the controller's uptime, s; receive times are not recorded. Fields:
//! Universal Robots, "Real-Time Data Exchange (RTDE) Guide", robot controller outputs; rad, and poses as m
//! and rotation vector.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::{self, Read};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder};

use super::contents::RTDE;
use super::decode::Format;
use super::intake::{ChannelId, Intake};
use super::losses::Losses;
use super::tables;
use super::topic::{Message, MessagePlace};
use super::{Extent, ReadOptions};
use ground::robot::UR_JOINTS;
use ground::stream::{Columns, JointColumns, usable_or_nan};
use ground::time;

/// Controller time, s.
const TIMESTAMP: &str = "timestamp";

const MAX_HEADER_BYTES: usize = 1 << 16;

/// RTDE has a few hundred fields.
const MAX_LINE_BYTES: usize = 1 << 20;

const MAX_LISTED: usize = 1000;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Meaning {
    /// With the name of their velocity vector.
    Positions {
        velocities: &'static str,
    },
    Velocities,
    Numbers,
}

#[derive(Debug)]
struct Vector {
    name: &'static str,
    width: usize,
    meaning: Meaning,
}

const fn vector(name: &'static str, width: usize, meaning: Meaning) -> Vector {
    Vector { name, width, meaning }
}

static VECTORS: [Vector; 8] = [
    vector("actual_q", 6, Meaning::Positions { velocities: "actual_qd" }),
    vector("actual_qd", 6, Meaning::Velocities),
    vector("target_q", 6, Meaning::Positions { velocities: "target_qd" }),
    vector("target_qd", 6, Meaning::Velocities),
    vector("actual_TCP_pose", 6, Meaning::Numbers),
    vector("target_TCP_pose", 6, Meaning::Numbers),
    vector("actual_TCP_speed", 6, Meaning::Numbers),
    vector("actual_tool_accelerometer", 3, Meaning::Numbers),
];

/// Whether the first line names RTDE fields.
pub(super) fn has_header(bytes: &[u8]) -> bool {
    let line = header_line(bytes);
    let cells: Vec<&[u8]> = cells(line, delimiter(line)).collect();
    let vector_part = |cell: &&[u8]| {
        let (stem, part) = part(cell)?;
        let vector = VECTORS.iter().find(|vector| vector.name == stem)?;
        Some(part < vector.width)
    };
    let mut known = cells.iter().filter_map(vector_part).peekable();
    // Other tables' rate may be declared by the caller, and another arm has more joints.
    let is_recording = known.peek().is_some() && known.all(|is_within| is_within);
    is_recording && cells.contains(&TIMESTAMP.as_bytes())
}

fn header_line(bytes: &[u8]) -> &[u8] {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let bytes = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    let end = bytes.iter().position(|byte| matches!(byte, b'\r' | b'\n')).unwrap_or(bytes.len());
    &bytes[..end]
}

/// A space if there is no other.
pub(super) fn delimiter(header: &[u8]) -> u8 {
    let mut usual = [b';', b',', b'\t'].into_iter();
    usual.find(|delimiter| header.contains(delimiter)).unwrap_or(b' ')
}

pub(super) fn cells(line: &[u8], delimiter: u8) -> impl Iterator<Item = &[u8]> {
    line.split(move |&byte| byte == delimiter).map(unquoted)
}

/// Without blanks and quotation marks around it.
pub(super) fn unquoted(cell: &[u8]) -> &[u8] {
    let cell = cell.trim_ascii();
    cell.strip_prefix(b"\"").and_then(|cell| cell.strip_suffix(b"\"")).unwrap_or(cell)
}

/// Splits a name that ends in `_` and a number.
fn part(name: &[u8]) -> Option<(&str, usize)> {
    let (stem, number) = std::str::from_utf8(name).ok()?.rsplit_once('_')?;
    number.parse().ok().map(|number| (stem, number))
}

/// With `decimal_comma`, `1,5` is one and a half.
pub(super) fn number(cell: &[u8], decimal_comma: bool) -> Option<f64> {
    let cell = std::str::from_utf8(unquoted(cell)).ok()?;
    if decimal_comma && cell.contains(',') {
        return cell.replace(',', ".").parse().ok();
    }
    cell.parse().ok()
}

/// Bytes of a table up to an overlong line, which would take unlimited memory.
struct Lines<'a> {
    rest: &'a [u8],
    line: usize,
}

impl Read for Lines<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.line > MAX_LINE_BYTES {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let count = self.rest.read(buffer)?;
        let end = buffer[..count].iter().rposition(|byte| matches!(byte, b'\n' | b'\r'));
        self.line = end.map_or(self.line + count, |end| count - end);
        Ok(count)
    }
}

/// Samples of all tables of a run, whose columns may be in different files.
#[derive(Default)]
pub(super) struct Recording {
    /// Samples in the order of [`VECTORS`].
    samples: [Option<Samples>; VECTORS.len()],
}

struct Samples {
    channel: ChannelId,
    /// ns since the controller started.
    stamps: Vec<i64>,
    /// Row-major.
    values: Vec<f64>,
}

struct Layout {
    columns: usize,
    timestamp: usize,
    /// Index into [`VECTORS`], and the columns.
    vectors: Vec<(usize, Vec<usize>)>,
    /// Channels that are only counted.
    others: Vec<ChannelId>,
}

impl Recording {
    pub(super) fn read(
        &mut self,
        path: &Path,
        bytes: &[u8],
        options: &ReadOptions,
        losses: &mut Losses,
        intake: &mut Intake,
    ) {
        let header = header_line(bytes);
        let delimiter = delimiter(header);
        let names: Vec<&[u8]> = cells(header, delimiter).collect();
        let Some(layout) = self.layout(path, &names, intake) else {
            let what = format!("no column is named `{TIMESTAMP}`; record it as well");
            return losses.add(0, Extent::Messages, None, what);
        };
        // Numbers are not quoted; a stray quote must not swallow lines.
        let mut reader = ReaderBuilder::new()
            .delimiter(delimiter)
            .quoting(false)
            .flexible(true)
            .has_headers(false)
            .from_reader(Lines { rest: bytes, line: 0 });
        let ends_in_line = matches!(bytes.last(), Some(b'\n' | b'\r'));
        let mut table = Table { layout, delimiter, row: vec![Vec::new(); VECTORS.len()] };
        let mut record = ByteRecord::new();
        let mut is_first = true;
        loop {
            let more = reader.read_byte_record(&mut record);
            let (offset, line) =
                record.position().map_or((0, 0), |position| (position.byte(), position.line()));
            match more {
                Ok(true) => {}
                Ok(false) => break,
                Err(_) => {
                    let rest = bytes.get(offset as usize..).unwrap_or_default();
                    let (extent, what) = match rest.iter().all(|byte| *byte == 0) {
                        true => {
                            (Extent::Tail, "the file ends in zeros, as after a crash".to_owned())
                        }
                        false => {
                            let what = format!(
                                "line {line} has more than {MAX_LINE_BYTES} bytes; it and the rest are not \
                                 read"
                            );
                            (Extent::Messages, what)
                        }
                    };
                    losses.add(offset as usize, extent, None, what);
                    break;
                }
            }
            options.set_position(offset as usize);
            if std::mem::take(&mut is_first)
                || record.iter().map(unquoted).eq(names.iter().copied())
            {
                continue;
            }
            let is_last = reader.position().byte() >= bytes.len() as u64 && !ends_in_line;
            match table.parse(&record, is_last) {
                Ok(stamp) => self.take(&table, stamp, offset, intake),
                Err(Malformed::Cut) => {
                    let what = format!("the file ends within line {line}");
                    losses.add(offset as usize, Extent::Tail, Some(table.topics()), what);
                }
                Err(Malformed::Row(cause)) => {
                    let what = format!("line {line}: {cause}");
                    losses.add(offset as usize, Extent::Messages, Some(table.topics()), what);
                }
            }
        }
    }

    /// Identifies columns by name. `None` without a time column.
    fn layout(&mut self, path: &Path, names: &[&[u8]], intake: &mut Intake) -> Option<Layout> {
        let timestamp = names.iter().position(|name| *name == TIMESTAMP.as_bytes())?;
        let mut by_name: HashMap<&[u8], usize> = HashMap::new();
        for (column, name) in names.iter().enumerate() {
            by_name.entry(name).or_insert(column);
        }
        let mut layout =
            Layout { columns: names.len(), timestamp, vectors: Vec::new(), others: Vec::new() };
        for (index, vector) in VECTORS.iter().enumerate() {
            let parts: Vec<String> =
                (0..vector.width).map(|part| format!("{}_{part}", vector.name)).collect();
            let found: Vec<usize> =
                parts.iter().filter_map(|part| by_name.get(part.as_bytes()).copied()).collect();
            if found.len() == vector.width {
                let type_name = format!("VECTOR{}D", vector.width);
                let format = Format::without_schema(RTDE, &type_name);
                let Some(channel) = intake.channel(vector.name, format) else { continue };
                self.samples[index].get_or_insert_with(|| Samples {
                    channel,
                    stamps: Vec::new(),
                    values: Vec::new(),
                });
                layout.vectors.push((index, found));
            } else if !found.is_empty() {
                let (name, there, width) = (vector.name, found.len(), vector.width);
                let what =
                    format!("has {there} of the {width} columns of `{name}`; they are not used");
                intake.note(path, what);
            }
        }
        let others = others(names);
        if others.len() > MAX_LISTED {
            let what =
                format!("has {} further columns, of which {MAX_LISTED} are listed", others.len());
            intake.note(path, what);
        }
        let listed = others.iter().take(MAX_LISTED);
        let format = Format::without_schema(RTDE, "");
        layout.others = listed.filter_map(|name| intake.channel(name, format)).collect();
        Some(layout)
    }

    fn take(&mut self, table: &Table, stamp: i64, offset: u64, intake: &mut Intake) {
        let time = u64::try_from(stamp).unwrap_or(0);
        let message = Message {
            log_time: time,
            publish_time: time,
            sequence: 0,
            data: &[],
            place: MessagePlace::Byte(offset),
            latched: false,
        };
        for &(vector, _) in &table.layout.vectors {
            let values = &table.row[vector];
            if let (Some(samples), false) = (&mut self.samples[vector], values.is_empty()) {
                samples.stamps.push(stamp);
                samples.values.extend_from_slice(values);
                intake.message(samples.channel, message);
            }
        }
        for &channel in &table.layout.others {
            intake.message(channel, message);
        }
    }

    pub(super) fn hand_over(self, intake: &mut Intake) {
        for (vector, samples) in VECTORS.iter().zip(&self.samples) {
            let Some(samples) = samples else {
                continue;
            };
            let columns = match vector.meaning {
                Meaning::Positions { velocities } => {
                    let place = VECTORS.iter().position(|vector| vector.name == velocities);
                    let velocities = place.and_then(|place| self.samples[place].as_ref());
                    Columns::Joints(samples.joints(velocities))
                }
                Meaning::Numbers => {
                    let stamps: Vec<_> = samples.stamps.iter().map(|&stamp| stamp.into()).collect();
                    Columns::Array(tables::array_columns(&stamps, vector.width, &samples.values))
                }
                Meaning::Velocities => continue,
            };
            intake.columns(samples.channel, columns);
        }
    }
}

struct Table {
    layout: Layout,
    delimiter: u8,
    /// Numbers of the last row, in the order of [`VECTORS`]; empty if all are missing.
    row: Vec<Vec<f64>>,
}

enum Malformed {
    Cut,
    Row(String),
}

impl Table {
    /// Returns the row's stamp, ns. `is_last`: without a line end.
    fn parse(&mut self, record: &ByteRecord, is_last: bool) -> Result<i64, Malformed> {
        let Layout { columns, timestamp, ref vectors, .. } = self.layout;
        if record.len() != columns {
            let comma = self.delimiter == b',' && record.len() > columns;
            let hint = if comma { "; decimal commas need `;` between the columns" } else { "" };
            let what =
                format!("{} columns, but the first line names {columns}{hint}", record.len());
            return Err(if is_last { Malformed::Cut } else { Malformed::Row(what) });
        }
        let decimal_comma = self.delimiter != b',';
        let value = |column: usize| {
            let cell = record.get(column).unwrap_or_default();
            if unquoted(cell).is_empty() {
                return Ok(f64::NAN);
            }
            // Digits may be missing at the end of the file.
            let is_cut = is_last && column + 1 == columns;
            match number(cell, decimal_comma) {
                Some(_) if is_cut => Err(Malformed::Cut),
                Some(value) => Ok(value),
                None => {
                    let shown = String::from_utf8_lossy(&cell[..cell.len().min(40)]).into_owned();
                    let what = format!(
                        "column {}: `{}` is not a number",
                        column + 1,
                        shown.escape_debug()
                    );
                    Err(Malformed::Row(what))
                }
            }
        };
        let seconds = value(timestamp)?;
        if !(0.0..=MAX_TIMESTAMP_S).contains(&seconds) {
            return Err(Malformed::Row(format!("`{TIMESTAMP}` is not a valid time: {seconds}")));
        }
        for (vector, columns) in vectors {
            let row = &mut self.row[*vector];
            row.clear();
            let is_empty =
                |column: &usize| unquoted(record.get(*column).unwrap_or_default()).is_empty();
            if columns.iter().all(is_empty) {
                continue;
            }
            for &column in columns {
                row.push(value(column)?);
            }
        }
        Ok(time::nanos(seconds))
    }

    /// Topics with a message in each row.
    fn topics(&self) -> u64 {
        (self.layout.vectors.len() + self.layout.others.len()) as u64
    }
}

/// Nanoseconds cannot represent more, s.
const MAX_TIMESTAMP_S: f64 = 9e9;

impl Samples {
    fn joints(&self, velocities: Option<&Samples>) -> JointColumns {
        let by_stamp: HashMap<i64, &[f64]> = velocities
            .into_iter()
            .flat_map(|samples| samples.stamps.iter().copied().zip(samples.rows(UR_JOINTS.len())))
            .collect();
        let stamps: Vec<_> = self.stamps.iter().map(|&stamp| stamp.into()).collect();
        let positions = UR_JOINTS.iter().enumerate().map(|(joint, name)| {
            let position = self.rows(UR_JOINTS.len()).map(|row| usable_or_nan(row[joint]));
            ((*name).to_owned(), position.collect())
        });
        let mut joints = tables::joint_columns(&stamps, positions);
        for (at, joint) in joints.joints.iter_mut().enumerate() {
            let velocity =
                |stamp| by_stamp.get(stamp).map_or(f64::NAN, |row| usable_or_nan(row[at]));
            joint.velocity = self.stamps.iter().map(velocity).collect();
        }
        joints
    }

    fn rows(&self, width: usize) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(width)
    }
}

/// Names of unused columns in order; a vector is one name.
fn others(names: &[&[u8]]) -> Vec<String> {
    let all: HashSet<&[u8]> = names.iter().copied().collect();
    let mut by_name: BTreeMap<String, usize> = BTreeMap::new();
    for (column, name) in names.iter().enumerate() {
        let is_vector = |stem: &&str| all.contains(format!("{stem}_0").as_bytes());
        let stem = part(name).map(|(stem, _)| stem).filter(is_vector);
        let is_read = stem.is_some_and(|stem| VECTORS.iter().any(|vector| vector.name == stem));
        if is_read || name.is_empty() || *name == TIMESTAMP.as_bytes() {
            continue;
        }
        let name = stem.map_or_else(|| String::from_utf8_lossy(name).into_owned(), str::to_owned);
        by_name.entry(name).or_insert(column);
    }
    let mut names: Vec<(String, usize)> = by_name.into_iter().collect();
    names.sort_by_key(|&(_, column)| column);
    names.into_iter().map(|(name, _)| name).collect()
}
