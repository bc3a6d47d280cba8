//! Tables: arrays with a row for each moment, without messages and without a schema of a robot. NPY and
//! NPZ, Parquet, LeRobot datasets, HDF5, Zarr, TFRecord, CSV and KUKA's RSI packets.
//!
//! A reader makes a [`Table`] of each episode; `clock` finds its stamps, `meaning` what its columns hold.
//! What is left open there is listed as bare numbers: whether they follow the arm is decided further up.

mod clock;
mod csv;
mod hdf5;
mod lerobot;
mod meaning;
mod names;
mod npy;
mod parquet;
mod repeats;
mod rlds;
mod rsi;
mod settings;
#[cfg(test)]
mod tests;
mod tfrecord;
mod zarr;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ::bytes::Bytes;
use serde_json::Value;

use super::decode::Format;
use super::intake::{ChannelId, Intake};
use super::losses::Losses;
use super::mapped::Mapped;
use super::{Container, Extent, LogError, TableCell};
use ground::stream::{ArrayColumns, Columns, JointColumns, PoseColumns, Times, usable};
use ground::time::NANOS_PER_SECOND;

pub use self::settings::{ColumnSelector, ColumnSettings};

pub(super) use self::csv::{has_time, is_table};
pub(super) use self::hdf5::MAGIC as HDF5_MAGIC;
pub use self::lerobot::dataset_of;
pub(super) use self::lerobot::{files_of, is_dataset};
pub(super) use self::npy::MAGIC as NPY_MAGIC;
pub(super) use self::rsi::has_packet;
pub(super) use self::tfrecord::has_record;
pub(super) use self::zarr::is_zip_store;
pub use self::zarr::{files_of_store, is_store};

/// Most numbers that a table may hold, of all its columns.
const MOST_NUMBERS: usize = 1 << 28;
/// Most episodes that are one audit.
const MOST_EPISODES: usize = 100;
/// Most columns of a table that are looked at.
const MOST_COLUMNS: usize = 2000;
/// Most numbers a row of one column; more is an image.
const MOST_WIDE: usize = 256;
/// Numbers that a byte of a file may unpack to, and those that any file may hold.
const MOST_PACKED: usize = 1000;
const MOST_SMALL: usize = 1 << 20;
/// Names of rates, in attributes.
const RATES: &[&str] = &["fps", "control_freq", "control_frequency", "frequency", "rate_hz", "hz"];

/// The rows of one episode.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub rows: usize,
    pub columns: Vec<Column>,
    /// Rows a second, as the metadata say.
    pub rate_hz: Option<f64>,
    /// What is in the file and is no column: names, and why not.
    pub unread: Vec<(String, String)>,
    /// First cells of columns of text, by their names.
    pub texts: BTreeMap<String, String>,
}

impl Table {
    /// The place of the column of that name, with its unit or without.
    fn column(&self, name: &str) -> Option<usize> {
        let place = |is_it: &dyn Fn(&str) -> bool| {
            self.columns.iter().position(|column| is_it(&column.name))
        };
        let bare = |own: &str| own.split_once(" [").is_some_and(|(own, _)| own == name);
        place(&|own| own == name).or_else(|| place(&bare))
    }
}

/// A column: as many numbers a row as it is wide.
#[derive(Clone, Debug, Default)]
pub(super) struct Column {
    pub name: String,
    /// What the file calls the type of its numbers.
    pub kind: String,
    pub width: usize,
    /// What each of its numbers is called, where the file says.
    pub parts: Vec<String>,
    /// Row-major.
    pub values: Vec<f64>,
}

/// The times of one row, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowStamps {
    /// Of the numbers, if they have a clock of their own.
    own: i64,
    /// Of the table's row.
    row: i64,
}

impl From<i64> for RowStamps {
    fn from(stamp: i64) -> Self {
        Self { own: stamp, row: stamp }
    }
}

/// Episodes by their names.
type Episodes = Vec<(String, Table)>;

/// A kind of file that holds tables.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    Npy,
    Npz,
    Parquet,
    Hdf5,
    Csv,
    Rsi,
    Zarr,
    TfRecord,
}

impl Kind {
    pub(super) fn container(self) -> Container {
        match self {
            Self::Npy => Container::Npy,
            Self::Npz => Container::Npz,
            Self::Parquet => Container::Parquet,
            Self::Hdf5 => Container::Hdf5,
            Self::Csv => Container::Csv,
            Self::Rsi => Container::Rsi,
            Self::TfRecord => Container::TfRecord,
            Self::Zarr => Container::Zarr,
        }
    }
}

/// What is read of all tables of a run.
#[derive(Default)]
pub(super) struct Tables {
    streams: BTreeMap<String, Stream>,
    /// Episodes read.
    episodes: usize,
    /// The last time of receipt that was made up, ns.
    until: Option<i64>,
    told: bool,
    repeats: repeats::Repeats,
}

/// A topic that is made of columns.
struct Stream {
    channel: ChannelId,
    columns: Columns,
}

/// Columns that belong together, and why.
pub(super) struct Found {
    pub topic: String,
    pub kind: String,
    pub why: String,
    pub cells: Vec<TableCell>,
    /// What its names say that its numbers are not.
    pub contradiction: Option<String>,
    pub columns: Option<Columns>,
    pub rows: u64,
}

/// Why a file of tables cannot be read, or a part of it.
pub(super) type Refusal = String;

/// Why an episode is not taken in.
enum Refused {
    /// Nothing says what its columns are.
    Question(Refusal),
    /// Its rows are of no use.
    Rows(Refusal),
}

impl Tables {
    /// Reads the tables in `bytes`, which are at `path`. What is wrong with them goes to `losses`.
    pub(super) fn read(
        &mut self,
        kind: Kind,
        (path, place): (&Path, &Path),
        bytes: &[u8],
        (settings, wanted): (&ColumnSettings, Option<&str>),
        losses: &mut Losses,
        intake: &mut Intake,
    ) -> Result<(), LogError> {
        let dataset = match kind {
            Kind::Parquet => lerobot::above(path),
            Kind::TfRecord => rlds::beside(path),
            _ => None,
        };
        let read = match kind {
            Kind::Npy => npy::npy(bytes),
            Kind::Npz => npy::npz(bytes),
            Kind::Csv => csv::read(bytes, losses),
            Kind::Rsi => rsi::read(bytes, losses),
            Kind::Parquet => parquet::read(owned(place, bytes), dataset.as_ref(), wanted),
            Kind::Hdf5 => hdf5::read(owned(place, bytes), wanted, losses),
            Kind::Zarr if place.is_dir() => zarr::read(zarr::At::Folder(place), wanted, losses),
            Kind::Zarr => zarr::read(zarr::At::Bytes(bytes), wanted, losses),
            Kind::TfRecord => {
                let declared = dataset.as_ref();
                let width = |name: &str| declared.and_then(|dataset| dataset.width(name));
                tfrecord::read(bytes, wanted, width, losses)
            }
        };
        let mut episodes = match read {
            Ok(episodes) => episodes,
            Err(what) => {
                losses.add_unplaced(Extent::Messages, None, what);
                return Ok(());
            }
        };
        if let Some(wanted) = wanted {
            episodes.retain(|(name, _)| name == wanted);
            // Another file of the dataset may have it.
            if episodes.is_empty() && dataset.is_none() {
                let what = format!("there is no episode '{wanted}' in it");
                losses.add_unplaced(Extent::Messages, None, what);
                return Ok(());
            }
        }
        let count = episodes.len();
        self.episodes += count;
        if self.episodes > MOST_EPISODES {
            return Err(LogError::Episodes { path: path.to_owned(), most: MOST_EPISODES });
        }
        if let Some(dataset) = dataset {
            for (_, table) in &mut episodes {
                dataset.describe(table);
            }
            intake.declared(dataset.robot.as_deref());
            for what in dataset.contradictions(&episodes) {
                intake.contradiction(path, what);
            }
        }
        let (mut lost, mut first) = (0, None);
        for (name, table) in episodes {
            match self.take(path, &table, settings, intake) {
                Ok(()) => {}
                Err(Refused::Question(what)) => {
                    return Err(LogError::Columns { path: path.to_owned(), what });
                }
                Err(Refused::Rows(what)) => {
                    lost += 1;
                    first.get_or_insert(if count > 1 {
                        format!("episode {name}: {what}")
                    } else {
                        what
                    });
                }
            }
        }
        if let Some(first) = first {
            let more = if lost > 1 { format!("; so are {} more", lost - 1) } else { String::new() };
            losses.add_unplaced(Extent::Messages, None, format!("{first}{more}"));
        }
        Ok(())
    }

    /// Takes one episode in.
    fn take(
        &mut self,
        path: &Path,
        table: &Table,
        settings: &ColumnSettings,
        intake: &mut Intake,
    ) -> Result<(), Refused> {
        if table.rows < 2 {
            return Err(Refused::Rows(format!("it has {} rows", table.rows)));
        }
        let clock = clock::of(table, settings).map_err(Refused::Question)?;
        let found = meaning::of(table, &clock, settings).map_err(Refused::Question)?;
        if found.iter().all(|found| found.columns.is_none()) {
            return Err(Refused::Rows("it holds no numbers beside its times".to_owned()));
        }
        let shift = self.shift(clock.first(), clock.last());
        let span = [clock.first(), clock.last()].map(|stamp| (stamp + shift).max(0) as u64);
        if !std::mem::replace(&mut self.told, true) {
            intake.note(path, clock.said.clone());
        }
        intake.timed_by(clock.told.as_deref());
        if table.rate_hz.is_some() {
            intake.declared(None);
        }
        self.repeats.count(&found);
        if let Some(what) = clock.contradiction(table) {
            intake.contradiction(path, what);
        }
        for Found { topic, kind, why, cells, contradiction, columns, rows } in found {
            if let Some(what) = contradiction {
                intake.contradiction(path, what);
            }
            let format =
                Format { encoding: "table", type_name: &kind, schema_encoding: "", schema: &[] };
            let Some(channel) = intake.channel(&topic, format) else { continue };
            intake.count(channel, rows, (span[0], span[1]));
            intake.read_as(channel, why, cells);
            let Some(mut columns) = columns else { continue };
            for times in columns.times_mut() {
                times.log.iter_mut().for_each(|received| *received += shift);
            }
            match self.streams.get_mut(&topic) {
                Some(stream) => append(&mut stream.columns, columns),
                None => {
                    self.streams.insert(topic, Stream { channel, columns });
                }
            }
        }
        Ok(())
    }

    /// By how much the rows of an episode are received after their stamps, ns: episodes begin their clocks
    /// anew, and are received one after another.
    fn shift(&mut self, first: i64, last: i64) -> i64 {
        const APART: i64 = NANOS_PER_SECOND / 1000;
        let shift = match self.until {
            Some(until) if first <= until => until + APART - first,
            _ => 0,
        };
        self.until = Some(last + shift);
        shift
    }

    /// Hands the columns of all tables to `intake`.
    pub(super) fn hand_over(self, intake: &mut Intake) {
        if self.told {
            intake.repeats(self.repeats.in_all());
        }
        for Stream { channel, columns } in self.streams.into_values() {
            intake.columns(channel, columns);
        }
    }
}

/// The bytes of a file as those that readers of a file want: the file's own where it is at `place`.
fn owned(place: &Path, bytes: &[u8]) -> Bytes {
    const HEAD: usize = 64;
    let is_it = |mapped: &Mapped| {
        let own = mapped.bytes();
        let head = HEAD.min(bytes.len());
        own.len() == bytes.len() && own[..head] == bytes[..head]
    };
    match Mapped::open(place).ok().filter(is_it) {
        Some(mapped) => Bytes::from_owner(mapped),
        None => Bytes::copy_from_slice(bytes),
    }
}

/// Appends the rows of a further episode; of another shape they are left out.
fn append(to: &mut Columns, more: Columns) {
    match (to, more) {
        (Columns::Joints(to), Columns::Joints(more)) => {
            let names =
                |of: &JointColumns| of.joints.iter().map(|it| it.name.clone()).collect::<Vec<_>>();
            if names(to) != names(&more) {
                return;
            }
            extend(&mut to.times, &more.times);
            for (to, more) in to.joints.iter_mut().zip(more.joints) {
                to.position.extend(more.position);
                to.velocity.extend(more.velocity);
            }
            to.not_finite += more.not_finite;
        }
        (Columns::Array(to), Columns::Array(more)) if to.width == more.width => {
            extend(&mut to.times, &more.times);
            to.values.extend(more.values);
            to.not_finite += more.not_finite;
        }
        (Columns::Poses(to), Columns::Poses(more)) => {
            for (to, more) in to.iter_mut().zip(more) {
                extend(&mut to.times, &more.times);
                to.xyz.extend(more.xyz);
                to.q_xyzw.extend(more.q_xyzw);
                to.not_finite += more.not_finite;
            }
        }
        _ => {}
    }
}

fn extend(to: &mut Times, more: &Times) {
    more.header
        .iter()
        .zip(&more.log)
        .for_each(|(&stamp, &received)| to.push(stamp, received, received));
}

/// Bare numbers, `width` a row; rows with one that nothing can be are counted and left out.
pub(super) fn array(stamps: &[RowStamps], width: usize, values: &[f64]) -> ArrayColumns {
    let mut array = ArrayColumns { width, ..ArrayColumns::default() };
    for (stamp, row) in stamps.iter().zip(values.chunks_exact(width)) {
        if row.iter().all(|value| usable(*value)) {
            array.times.push(stamp.own, stamp.row, stamp.row);
            array.values.extend_from_slice(row);
        } else {
            array.not_finite += 1;
        }
    }
    array
}

/// Positions without orientations.
fn positions(stamps: &[RowStamps], values: &[f64]) -> PoseColumns {
    let array = array(stamps, 3, values);
    PoseColumns {
        xyz: array.values.chunks_exact(3).map(|row| [row[0], row[1], row[2]]).collect(),
        q_xyzw: vec![[0.0; 4]; array.times.len()],
        not_finite: array.not_finite,
        times: array.times,
        ..PoseColumns::default()
    }
}

/// The rate that attributes name.
fn rate_in(value: &Value) -> Option<f64> {
    let all = value.as_object()?;
    let own = RATES.iter().find_map(|name| all.get(*name)?.as_f64());
    own.or_else(|| all.values().find_map(rate_in)).filter(|rate| rate.is_finite() && *rate > 0.0)
}

/// The number of rows that arrays of these shapes have in common. Arrays of `k` by `N` numbers lie on their
/// side if `N` is that number.
fn common_rows(shapes: &[Vec<usize>]) -> usize {
    /// No table has so many times more columns than rows.
    const WIDER: usize = 4;
    let mut votes: BTreeMap<usize, usize> = BTreeMap::new();
    for shape in shapes {
        if let Some(rows) = shape.first() {
            *votes.entry(*rows).or_default() += 1;
        }
        if let &[columns, rows] = shape.as_slice()
            && (1..=MOST_WIDE).contains(&columns)
            && rows / WIDER > columns
        {
            *votes.entry(rows).or_default() += 1;
        }
    }
    let most = votes.into_iter().max_by_key(|&(rows, votes)| (votes, rows));
    most.map_or(0, |(rows, _)| rows)
}

/// Whether an array of that shape lies on its side in a table of so many rows.
fn lies_on_side(shape: &[usize], rows: usize) -> bool {
    matches!(shape, &[columns, own] if own == rows && columns < rows)
}

/// The number of rows that most columns have.
fn usual(rows: impl Iterator<Item = usize>) -> usize {
    let rows: Vec<usize> = rows.collect();
    let count = |of: usize| rows.iter().filter(|own| **own == of).count();
    rows.iter().copied().max_by_key(|&of| (count(of), of)).unwrap_or(0)
}

/// The names of the episodes in the file or store at `path`; none where it holds but one, or is no file of tables.
pub fn episodes(path: &Path) -> Vec<String> {
    if is_store(path) {
        return several(zarr::episodes_in(zarr::At::Folder(path)));
    }
    let Some(mapped) = Mapped::open(path).ok() else { return Vec::new() };
    several(match crate::sniff::kind(mapped.bytes()) {
        crate::sniff::Kind::Table(Kind::Parquet) => parquet::episodes_in(Bytes::from_owner(mapped)),
        crate::sniff::Kind::Table(Kind::Hdf5) => hdf5::episodes_in(Bytes::from_owner(mapped)),
        crate::sniff::Kind::Table(Kind::Zarr) => zarr::episodes_in(zarr::At::Bytes(mapped.bytes())),
        crate::sniff::Kind::Table(Kind::TfRecord) => tfrecord::episodes_in(mapped.bytes()),
        _ => return Vec::new(),
    })
}

fn several(names: Result<Vec<String>, Refusal>) -> Vec<String> {
    names.ok().filter(|names| names.len() > 1).unwrap_or_default()
}

/// A path, and the episode that is named behind a `#`, where the whole is no file.
pub fn episode_of(path: &Path) -> (PathBuf, Option<String>) {
    let split = || {
        let (file, episode) = path.to_str()?.rsplit_once('#')?;
        let file = PathBuf::from(file);
        (!path.exists() && file.exists()).then(|| (file, Some(episode.to_owned())))
    };
    split().unwrap_or_else(|| (path.to_owned(), None))
}
