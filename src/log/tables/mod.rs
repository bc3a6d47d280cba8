//! Tables: arrays with one row per instant, without messages or robot schema, in NPY, NPZ, Parquet, LeRobot
//! datasets, HDF5, Zarr, TFRecord, CSV, trajectories (TUM, KITTI) and KUKA RSI packets.
//!
//! A reader makes one [`Table`] per episode; `clock` finds its stamps and `meaning` identifies its columns.
//! `run` compares unidentified columns with the motion of the arm.

mod chunks;
mod clock;
mod configurations;
mod csv;
mod file_names;
mod hdf5;
mod labelled_lines;
mod lerobot;
mod matlab;
mod meaning;
mod names;
mod npy;
mod one_row_files;
mod pages;
mod parquet;
mod records;
mod repeats;
mod rlds;
mod row_labels;
mod row_layout;
mod row_losses;
mod rsi;
mod settings;
#[cfg(test)]
pub(super) mod tests;
mod text_encoding;
mod text_rows;
mod tfrecord;
mod trajectory;
mod vector_cells;
mod velocity_files;
mod xlsx;
mod zarr;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

use ::bytes::Bytes;
use serde_json::Value;

use super::contents::TABLE;
use super::decode::Format;
use super::file_format::{FileFormat, detect_format};
use super::files::LogInput;
use super::intake::{ChannelId, Intake};
use super::losses::Losses;
use super::mapped::MappedFile;
use super::memory_budget::MemoryBudget;
use super::{Cell, Container, Extent, LogError, TableCell, TableNumber, TableShape};
use ground::stream::{
    ArrayColumns, Columns, JointColumn, JointColumns, PoseColumns, Times, is_usable,
};
use ground::time::NANOS_PER_SECOND;

pub use self::row_layout::{DeclaredPose, FileLayout, LayoutError, LayoutItem, Meaning, RowLayout};
pub use self::settings::{ColumnSelector, ColumnSettings};

use self::clock::ClockError;
pub(crate) use self::configurations::names_and_rows;
pub(super) use self::csv::{
    column_names, delimiter_of_numbers, is_header_alone, is_list_of_numbers, is_list_of_pairs,
    is_table, is_table_of_text,
};
pub(super) use self::file_names::are_one_run;
pub(super) use self::hdf5::MAGIC as HDF5_MAGIC;
pub(super) use self::lerobot::dataset_files;
pub use self::lerobot::{enclosing_dataset, is_dataset};
pub(super) use self::matlab::MAGIC as MATLAB_MAGIC;
pub(super) use self::meaning::LayoutColumns;
pub use self::names::COMMAND_WORDS;
pub(super) use self::npy::MAGIC as NPY_MAGIC;
pub(crate) use self::one_row_files::{JoinedRows, join_inputs};
pub(super) use self::records::{
    has_times as has_record_times, is_nested_yaml, is_yaml_list, looks_like_json, looks_like_yaml,
};
pub(super) use self::rlds::metadata_files as declared_beside;
use self::row_labels::RowLabels;
pub(crate) use self::row_layout::{LayoutGroup, LayoutTime};
use self::row_losses::first_line;
pub(super) use self::row_losses::{ReadColumn, RowLoss, TableError};
pub(super) use self::rsi::has_packet;
pub(super) use self::text_encoding::{is_text, to_utf8};
pub(super) use self::tfrecord::has_record;
pub(super) use self::trajectory::{
    detect as detect_trajectory, is_list_of_times, is_tum_by_name,
    times_beside as pose_times_beside,
};
pub(crate) use self::vector_cells::rows_of_lists;
use self::velocity_files::{Velocities, VelocityFile};
pub(super) use self::xlsx::is_workbook;
pub(super) use self::zarr::is_zip_store;
pub use self::zarr::{is_store, store_files};

/// Episodes per audit.
const MAX_EPISODES: usize = 100;
/// Columns per table.
const MAX_COLUMNS: usize = 2000;
/// Numbers per row; larger arrays are images.
const MAX_WIDTH: usize = 256;
/// Real metadata files have up to 100 kB; parsed JSON takes up to 60 times as much memory.
const MAX_METADATA_BYTES: u64 = 4 << 20;
/// Longest array of parameters, such as one number per joint or a matrix. Runs have more rows.
const MAX_PARAMETERS: usize = 16;
/// Nesting of groups and features.
const MAX_DEPTH: usize = 8;

#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub rows: usize,
    pub columns: Vec<Column>,
    /// According to the metadata.
    pub rate_hz: Option<f64>,
    /// Arrays, with the reason.
    pub unread: Vec<(String, String)>,
    /// First cell of each text column.
    pub texts: BTreeMap<String, String>,
    /// Keyed by column index; the lost values are NaN.
    pub lost_rows: BTreeMap<usize, Vec<Range<usize>>>,
    /// Rows and columns missing from the table.
    pub losses: Vec<RowLoss>,
    /// Content of the file that is neither read nor damaged.
    pub notes: Vec<String>,
    /// Line of each row, from 1, in text files.
    pub lines: Vec<usize>,
    /// Topic of the only pose, if its columns do not name it. Empty within a dataset.
    pub stream_name: String,
    /// Whether other files are read with it.
    pub is_one_of_several: bool,
    /// Positions of text columns in a row of the file.
    pub text_columns: Vec<usize>,
    /// Times in text of columns without names, in billionths.
    pub exact_times: BTreeMap<Cell, Vec<Option<i128>>>,
    /// Columns of text with few different values.
    pub labels: Vec<RowLabels>,
    /// Times of its rows from another file, whose name it has.
    pub times: Option<Column>,
}

pub(super) struct ReadContext<'a> {
    pub losses: &'a mut Losses,
    pub memory: &'a mut MemoryBudget,
    /// Positions of times in the rows of a text table without names.
    pub times: Vec<usize>,
}

impl Table {
    /// Line in a text file, otherwise the index from 0.
    fn place(&self, row: usize) -> String {
        match self.lines.get(row) {
            Some(line) => format!("line {line}"),
            None => format!("row {row} of {}", self.rows),
        }
    }

    /// The numbers in a row, in the order of the file; `None` for text.
    fn row_cells(&self) -> Vec<Option<Cell>> {
        let columns = self.columns.iter().enumerate();
        let mut numbers =
            columns.flat_map(|(column, own)| (0..own.width).map(move |part| Cell { column, part }));
        let width = self.columns.iter().map(|column| column.width).sum::<usize>();
        let is_text = |at: &usize| self.text_columns.contains(at);
        let all = 0..width + self.text_columns.len();
        all.map(|at| if is_text(&at) { None } else { numbers.next() }).collect()
    }

    /// NaN if the row is missing.
    fn number(&self, row: usize, Cell { column, part }: Cell) -> f64 {
        let column = &self.columns[column];
        column.values.get(row * column.width + part).copied().unwrap_or(f64::NAN)
    }

    /// Name of a number in `[columns]` of a config.
    fn cell_name(&self, Cell { column, part }: Cell) -> String {
        let Column { name, width, .. } = &self.columns[column];
        if *width == 1 { name.clone() } else { format!("{name}[{part}]") }
    }

    fn shape(&self, path: &Path, clock: &clock::Clock) -> TableShape {
        let number = |cell: Option<Cell>| TableNumber {
            at: cell,
            name: cell.map_or_else(|| "text".to_owned(), |cell| self.cell_name(cell)),
        };
        TableShape {
            file: path.to_owned(),
            numbers: self.row_cells().into_iter().map(number).collect(),
            time: clock.cell,
            nanos: clock.nanos,
            time_unit_s: clock.unit_s,
            rate_hz: clock.rate_hz,
            lacks_times: false,
            time_without_unit: None,
            layout: None,
            layout_reason: None,
            given_layout: None,
        }
    }

    /// Makes one row of each homogeneous matrix if the rows are those of such matrices, side by side or below each other.
    fn join_matrices(&mut self) {
        const SIDE: usize = 4;
        const BOTTOM: [f64; SIDE] = [0.0, 0.0, 0.0, 1.0];
        let [column] = self.columns.as_mut_slice() else { return };
        let (rows, width) = (self.rows, column.width);
        let has_gaps = !self.text_columns.is_empty() || column.values.len() != rows * width;
        let below = column.values.get((SIDE - 1) * width..).unwrap_or_default();
        if column.name != file_names::UNNAMED_COLUMN
            || has_gaps
            || !rows.is_multiple_of(SIDE)
            || !width.is_multiple_of(SIDE)
            || below.first_chunk::<SIDE>() != Some(&BOTTOM)
        {
            return;
        }
        let per_row = width / SIDE;
        let count = rows / SIDE * per_row;
        let element = |matrix: usize, at: usize| {
            let row = matrix / per_row * SIDE + at / SIDE;
            column.values[row * width + matrix % per_row * SIDE + at % SIDE]
        };
        let elements = |matrix: usize| (0..SIDE * SIDE).map(move |at| element(matrix, at));
        let values = (0..count).flat_map(elements).collect();
        let kind = column.kind.clone();
        let joined = Column { kind, ..Column::untyped(&column.name, SIDE * SIDE, values) };
        if !meaning::are_homogeneous(&joined) {
            return;
        }
        *column = joined;
        self.rows = count;
        self.lines.clear();
        self.exact_times.clear();
        self.notes.push(format!("read as {count} matrices of 4×4 numbers, each a row"));
    }

    /// Leaves out the rows of zeros at the end, as of an array that was made for more rows: all numbers are zero, or the
    /// times, which were not before.
    fn drop_zeros_at_end(&mut self) {
        if !self.text_columns.is_empty() {
            return;
        }
        let zeros_from = |columns: &[&Column]| -> usize {
            let is_zero = |row: usize| {
                columns.iter().all(|column| {
                    let own = column.values.get(row * column.width..(row + 1) * column.width);
                    own.is_some_and(|own| own.iter().all(|number| *number == 0.0))
                })
            };
            (0..self.rows).rev().take_while(|row| is_zero(*row)).last().unwrap_or(self.rows)
        };
        let all: Vec<&Column> = self.columns.iter().chain(&self.times).collect();
        let is_time = |column: &Column| column.width == 1 && clock::is_time(&column.name);
        let times = self.columns.iter().filter(|column| is_time(column)).chain(&self.times);
        let mut has_times = false;
        let end_of_times = |column: &Column| {
            has_times = true;
            let end = zeros_from(&[column]);
            let mut before = column.values.iter().take(end);
            // Nanoseconds after whole seconds may be zero.
            let increases = before.clone().is_sorted_by(|one, next| one <= next);
            // Times that end at their zero are complete.
            let is_negative = before.next_back().is_some_and(|last| *last < 0.0);
            increases.then_some(if is_negative { self.rows } else { end })
        };
        // Other times may be of a topic that ended before.
        let latest = times.filter_map(end_of_times).max();
        // Velocities in a file of their own may end with zeros.
        let is_alone = has_times || !self.is_one_of_several;
        let ends = latest.into_iter();
        let ends = ends.chain(is_alone.then(|| zeros_from(&all)));
        // Numbers that are always zero state nothing.
        let Some(rows) = ends.filter(|end| (1..self.rows).contains(end)).min() else { return };
        self.notes.push(format!(
            "left out the last {} of {} rows: they hold zeros, as in a preallocated array",
            self.rows - rows,
            self.rows
        ));
        self.rows = rows;
        for column in self.columns.iter_mut().chain(&mut self.times) {
            column.values.truncate(rows * column.width);
            column.billionths.truncate(rows * column.width);
        }
        self.lines.truncate(rows);
        self.exact_times.values_mut().for_each(|times| times.truncate(rows));
        self.labels.iter_mut().for_each(|own| own.rows.truncate(rows));
    }

    fn column_names(&self) -> Vec<String> {
        self.columns.iter().map(|column| column.name.clone()).collect()
    }

    /// The unit in the name is optional.
    fn column(&self, name: &str) -> Option<usize> {
        let place = |is_it: &dyn Fn(&str) -> bool| {
            self.columns.iter().position(|column| is_it(&column.name))
        };
        let bare = |own: &str| own.split_once(" [").is_some_and(|(own, _)| own == name);
        place(&|own| own == name).or_else(|| place(&bare))
    }
}

impl TableShape {
    /// Columns that are named as the velocities of these joint positions: `Velocity[2]` of `Position[2]`. Empty if a
    /// joint has none.
    pub fn velocities_of(&self, joints: &[TableCell]) -> Vec<TableCell> {
        let numbered = |name: &str| {
            let (stem, number) = names::numbered(name)?;
            Some((names::is_joint_velocities(&stem), names::shared_words(&stem), number))
        };
        let velocity = |joint: &TableCell| {
            let (_, words, number) = numbered(&joint.name)?;
            let wanted = Some((true, words, number));
            let own = self.numbers.iter().find(|own| numbered(&own.name) == wanted)?;
            Some(TableCell { at: own.at?, name: own.name.clone(), ..joint.clone() })
        };
        joints.iter().map(velocity).collect::<Option<_>>().unwrap_or_default()
    }
}

/// Has `width` numbers per row.
#[derive(Clone, Debug, Default)]
pub(super) struct Column {
    pub name: String,
    /// Type as written in the file.
    pub kind: String,
    pub width: usize,
    /// Names of the numbers in a row, if known.
    pub parts: Vec<String>,
    pub values: Vec<f64>,
    /// Times in text, in billionths, because `f64` rounds stamps since 1970. Empty for other columns; `None`
    /// if a cell is no decimal number.
    pub billionths: Vec<Option<i128>>,
}

impl Column {
    /// Numbers of a format that does not declare their type.
    fn untyped(name: &str, width: usize, values: Vec<f64>) -> Self {
        let (name, kind) = (name.to_owned(), "number".to_owned());
        Self { name, kind, width, values, ..Self::default() }
    }

    /// The numbers at one index of each row.
    fn numbers(&self, part: usize) -> impl Iterator<Item = f64> + Clone {
        self.values.iter().skip(part).step_by(self.width).copied()
    }

    /// Whether a row has a number. False for rows beyond the last one.
    fn has_numbers(&self, row: usize) -> bool {
        let own = self.values.get(row * self.width..(row + 1) * self.width);
        own.is_some_and(|own| own.iter().any(|value| value.is_finite()))
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct RowStamps {
    /// From the column's own clock, if any.
    column_ns: i64,
    row_ns: i64,
}

impl RowStamps {
    /// Receive times increase from row to row, also where the clock is set back or another recording begins.
    fn put_in_row_order(stamps: &mut [Self]) {
        let (mut offset, mut last) = (0_i64, i64::MIN);
        for stamp in stamps {
            let row_ns = stamp.row_ns;
            offset = offset.saturating_add(last.saturating_sub(row_ns).max(0));
            stamp.row_ns = row_ns.saturating_add(offset);
            last = row_ns;
        }
    }
}

impl From<i64> for RowStamps {
    fn from(stamp: i64) -> Self {
        Self { column_ns: stamp, row_ns: stamp }
    }
}

/// Tables with the name of their episode; those of one episode follow each other.
type Episodes = Vec<(String, Table)>;

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum TableFormat {
    Npy,
    Npz,
    Parquet,
    Hdf5,
    /// MATLAB before 7.3.
    Matlab,
    Csv,
    Tum,
    Kitti,
    /// Times of the rows of another file.
    Times,
    Rsi,
    Zarr,
    TfRecord,
    Xlsx,
    /// JSON, or JSON lines.
    Json,
    Yaml,
}

impl TableFormat {
    pub(super) fn container(self) -> Container {
        match self {
            Self::Npy => Container::Npy,
            Self::Npz => Container::Npz,
            Self::Parquet => Container::Parquet,
            Self::Hdf5 => Container::Hdf5,
            Self::Matlab => Container::Matlab,
            Self::Csv => Container::Csv,
            Self::Tum => Container::Tum,
            Self::Kitti => Container::Kitti,
            Self::Times => Container::Times,
            Self::Rsi => Container::Rsi,
            Self::TfRecord => Container::TfRecord,
            Self::Zarr => Container::Zarr,
            Self::Xlsx => Container::Xlsx,
            Self::Json => Container::Json,
            Self::Yaml => Container::Yaml,
        }
    }
}

#[derive(Default)]
pub(super) struct Tables {
    streams: BTreeMap<String, TableStream>,
    episodes: Vec<Episode>,
    has_noted_clock: bool,
    has_used_layout: bool,
    repeats: repeats::RepeatCounts,
    inputs: Vec<LogInput>,
    /// Keyed by file.
    stream_names: HashMap<PathBuf, String>,
    /// From stamps to receive times, in the current episode.
    shift_ns: Option<i64>,
    /// Files of [`TableFormat::Times`], and whether rows use them.
    row_times: BTreeMap<PathBuf, bool>,
    /// Names of tables without column names, by file.
    table_names: HashMap<PathBuf, String>,
    velocity_files: Vec<VelocityFile>,
}

struct Episode {
    /// File or dataset; its episodes should have the same columns.
    home: PathBuf,
    file: PathBuf,
    name: String,
    rows: usize,
}

struct TableStream {
    channel: ChannelId,
    columns: Columns,
    /// Indices of its episodes.
    episodes: BTreeSet<usize>,
}

#[derive(Default)]
pub(super) struct TableTopic {
    pub topic: String,
    pub kind: String,
    pub why: String,
    pub cells: Vec<TableCell>,
    /// Joint velocities, in the order of the cells.
    pub velocity_cells: Vec<TableCell>,
    /// Velocities of joints in another table.
    pub velocities: Option<Velocities>,
    /// Contradiction between column names and numbers.
    pub contradiction: Option<String>,
    pub columns: Option<Columns>,
    pub rows: u64,
    /// Rows omitted because their own clock has no valid stamp.
    pub unstamped: u64,
    /// Number of damaged rows, and the first one.
    pub damaged: Option<(u64, String)>,
}

enum EpisodeError {
    Refused(LogError),
    UnusableRows(String),
}

impl From<LogError> for EpisodeError {
    fn from(refusal: LogError) -> Self {
        Self::Refused(refusal)
    }
}

impl Tables {
    /// `inputs` are all files of the run.
    pub(super) fn new(inputs: &[LogInput]) -> Self {
        let paths: Vec<&Path> = inputs.iter().map(|input| input.path.as_path()).collect();
        let names = trajectory::stream_names(&paths);
        let table_names = file_names::table_names(&paths);
        let stream_names = paths.into_iter().map(Path::to_owned).zip(names).collect();
        Self { inputs: inputs.to_owned(), stream_names, table_names, ..Self::default() }
    }

    /// `bytes` is the content of the file at `path`. Adds damage and lost rows to the losses.
    pub(super) fn read(
        &mut self,
        kind: TableFormat,
        (path, place): (&Path, &Path),
        bytes: &[u8],
        (settings, wanted): (&ColumnSettings, Option<&str>),
        context: &mut ReadContext<'_>,
        intake: &mut Intake,
    ) -> Result<(), LogError> {
        let dataset = match kind {
            TableFormat::Parquet => lerobot::enclosing_metadata(path),
            TableFormat::TfRecord => rlds::declared_dataset(path),
            _ => None,
        };
        let dataset = dataset.and_then(|read| {
            read.map_err(|what| context.losses.add_unplaced(Extent::Index, None, what)).ok()
        });
        let layout = settings.layout_of(path);
        context.times = layout.map(RowLayout::time_positions).unwrap_or_default();
        let read = match kind {
            TableFormat::Npy => npy::read_npy(bytes, context),
            TableFormat::Npz => npy::read_npz(bytes, context),
            TableFormat::Matlab => matlab::read(bytes, context),
            TableFormat::Csv => csv::read(bytes, context),
            TableFormat::Xlsx => xlsx::read(bytes, context),
            TableFormat::Json => records::read_json(bytes, context),
            TableFormat::Yaml => records::read_yaml(bytes, context),
            TableFormat::Tum => trajectory::read_tum(bytes, context),
            TableFormat::Kitti => {
                let times = match trajectory::pose_times(path, bytes, &self.inputs) {
                    Ok((file, times)) => {
                        intake.note(path, format!("times of its poses from {}", file.display()));
                        self.row_times.insert(file, true);
                        Some(times)
                    }
                    Err(_) if settings.rate_hz.is_some() => None,
                    Err(refusal) => return Err(refusal),
                };
                trajectory::read_kitti(bytes, times.as_deref(), context)
            }
            TableFormat::Times => {
                if self.inputs.len() == 1 {
                    let looks = "a list of times without other numbers";
                    let instead = "pass it together with the file of its rows";
                    return Err(LogError::Unsupported { path: path.to_owned(), looks, instead });
                }
                self.row_times.entry(path.to_owned()).or_default();
                return Ok(());
            }
            TableFormat::Rsi => rsi::read(bytes, context),
            TableFormat::Parquet => {
                let bytes = owned_bytes(place, bytes);
                parquet::read(place, bytes, dataset.as_ref(), wanted, context)
            }
            TableFormat::Hdf5 => hdf5::read(owned_bytes(place, bytes), wanted, context),
            TableFormat::Zarr if place.is_dir() => {
                zarr::read(zarr::StoreLocation::Folder(place), wanted, context)
            }
            TableFormat::Zarr => zarr::read(zarr::StoreLocation::Bytes(bytes), wanted, context),
            TableFormat::TfRecord => {
                let declared = dataset.as_ref();
                let width = |name: &str| declared.and_then(|dataset| dataset.width(name));
                tfrecord::read(bytes, wanted, width, context)
            }
        };
        let too_many = || LogError::Episodes { path: path.to_owned(), most: MAX_EPISODES };
        let mut episodes = match read {
            Ok(episodes) => episodes,
            Err(TableError::Episodes) => return Err(too_many()),
            Err(refusal) => {
                refusal.report(None, context.losses);
                return Ok(());
            }
        };
        if let Some(wanted) = wanted {
            episodes.retain(|(name, _)| name == wanted);
            // Another file of the dataset may have it.
            if episodes.is_empty() && dataset.is_none() {
                let what = format!("there is no episode '{wanted}'");
                context.losses.add_unplaced(Extent::Messages, None, what);
                return Ok(());
            }
        }
        let count = episodes.chunk_by(|one, other| one.0 == other.0).count();
        if self.episodes.len() + count > MAX_EPISODES {
            return Err(too_many());
        }
        if let ([(_, table)], None, None) = (episodes.as_mut_slice(), &dataset, wanted) {
            table.stream_name = self.stream_names.get(path).cloned().unwrap_or_default();
            table.is_one_of_several = self.stream_names.len() > 1;
            table.name_only_array(path);
        }
        if let ([(_, table)], TableFormat::Csv | TableFormat::Npy) = (episodes.as_mut_slice(), kind)
        {
            table.join_matrices();
            if self.is_list_of_times(table) {
                self.row_times.entry(path.to_owned()).or_default();
                return Ok(());
            }
            self.add_times(path, bytes, table);
            if let (Some(name), None) = (self.table_names.get(path), layout)
                && !settings.has_column(file_names::UNNAMED_COLUMN)
            {
                table.name_columns(name);
            }
        }
        let home = enclosing_dataset(path).filter(|_| kind == TableFormat::Parquet);
        let home = home.unwrap_or_else(|| path.to_owned());
        if let Some(dataset) = dataset {
            for (_, table) in &mut episodes {
                dataset.describe(table);
            }
            intake.declare_metadata(dataset.robot.as_deref());
            for what in dataset.contradictions(&episodes) {
                intake.contradiction(path, what);
            }
        }
        let names: Vec<(String, Vec<String>)> =
            episodes.iter().map(|(name, table)| (name.clone(), table.column_names())).collect();
        let mut previous = None;
        for (at, (name, mut table)) in episodes.into_iter().enumerate() {
            let label = if count > 1 { format!("episode {name}: ") } else { String::new() };
            for loss in &table.losses {
                loss.report(&label, context.losses);
            }
            table.drop_zeros_at_end();
            table.notes.drain(..).for_each(|note| intake.note(path, note));
            // The losses explain why it is empty.
            if table.columns.is_empty() && !table.losses.is_empty() {
                continue;
            }
            let is_first = previous.as_ref() != Some(&name);
            if is_first {
                let (home, file) = (home.clone(), path.to_owned());
                self.episodes.push(Episode { home, file, name: name.clone(), rows: table.rows });
                self.shift_ns = None;
            }
            let siblings = names.iter().enumerate();
            let siblings = siblings.filter(|(other, own)| *other != at && own.0 == name);
            let of_siblings: Vec<&String> = siblings.flat_map(|(_, (_, names))| names).collect();
            let own_settings = settings.without(&of_siblings, &table);
            let of_layout = layout.filter(|_| is_first);
            previous = Some(name);
            let of_table = (&own_settings, of_layout);
            match self.add_table(path, &label, &mut table, of_table, (context.losses, intake)) {
                Ok(()) => {}
                Err(EpisodeError::Refused(refusal)) => return Err(refusal),
                Err(EpisodeError::UnusableRows(what)) => {
                    let rows = (table.rows > 0).then_some(table.rows as u64);
                    context.losses.add_unplaced(Extent::Messages, rows, format!("{label}{what}"));
                }
            }
        }
        Ok(())
    }

    /// Whether the numbers of an array are the times of rows in the other files of the run.
    fn is_list_of_times(&self, table: &Table) -> bool {
        let [Column { name, width: 1, values, kind, .. }] = table.columns.as_slice() else {
            return false;
        };
        name == file_names::UNNAMED_COLUMN
            && self.inputs.len() > 1
            && clock::increases_like_times(values, kind)
    }

    /// Adds the times that another file of the run has, one for each row.
    fn add_times(&mut self, path: &Path, bytes: &[u8], table: &mut Table) {
        if table.columns.iter().any(|column| clock::is_time(&column.name)) {
            return;
        }
        let lines = match table.lines.first() {
            Some(first) => trajectory::row_lines(bytes, *first),
            None => (0..table.rows).collect(),
        };
        let Some((file, times)) = trajectory::given_times(path, lines.len(), &self.inputs) else {
            return;
        };
        let time = |row: usize| {
            let line = table.lines.get(row).copied().unwrap_or(row);
            times[lines.binary_search(&line).ok()?]
        };
        let billionths: Vec<Option<i128>> = (0..table.rows).map(time).collect();
        let value = |own: &Option<i128>| own.map_or(f64::NAN, |own| own as f64 * 1e-9);
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let times = Column::untyped(&name, 1, billionths.iter().map(value).collect());
        table.times = Some(Column { billionths, ..times });
        self.row_times.insert(file, true);
    }

    fn add_table(
        &mut self,
        path: &Path,
        label: &str,
        table: &mut Table,
        (settings, row_layout): (&ColumnSettings, Option<&RowLayout>),
        (losses, intake): (&mut Losses, &mut Intake),
    ) -> Result<(), EpisodeError> {
        if table.rows < 2 {
            let what = if table.rows == 0 { "it has no rows" } else { "it has only one row" };
            return Err(EpisodeError::UnusableRows(what.to_owned()));
        }
        let contradicts = |what| LogError::Layout { path: path.to_owned(), what };
        let unidentified = |what| LogError::Columns { path: path.to_owned(), what };
        self.has_used_layout |= row_layout.is_some();
        let layout = row_layout.map(|layout| LayoutColumns::resolve(layout, table)).transpose();
        let layout = layout.map_err(contradicts)?;
        let table = &*table;
        let clock = match layout.as_ref().map(|layout| &layout.time) {
            Some(time) => clock::of_layout(table, time).map_err(contradicts)?,
            None => None,
        };
        let found = clock.map_or_else(|| clock::detect(table, settings), Ok);
        let (clock, lacks_times) = match (found, settings.assumed_rate_hz) {
            (Ok(clock), _) => (clock, false),
            (Err(ClockError::NoTimes(_)), Some(rate_hz)) => {
                (clock::from_rate(table, rate_hz, "which is assumed"), true)
            }
            (Err(ClockError::NoTimes(what)), None) => {
                let numbers = table.columns.iter().map(|column| column.width).sum();
                let (path, rows) = (path.to_owned(), table.rows);
                return Err(LogError::NoTimes { path, what, rows, numbers }.into());
            }
            (Err(ClockError::Other(what)), _) => return Err(unidentified(what).into()),
        };
        let found = meaning::identify_topics(table, &clock, settings, layout.as_ref())
            .map_err(unidentified)?;
        // A file of other quantities, such as accelerations, may accompany the joints.
        let is_unused = |found: &TableTopic| found.columns.is_none() && !found.cells.is_empty();
        let accompanies = self.inputs.len() > 1 && found.iter().all(is_unused);
        if found.iter().all(|found| found.columns.is_none()) && !accompanies {
            return Err(EpisodeError::UnusableRows(no_signal(&found)));
        }
        row_losses::report_unstamped(table, &clock, label, losses);
        let is_episode = self.is_episode(&found);
        let shift = *self.shift_ns.get_or_insert_with(|| match is_episode {
            true => receive_offset_ns(&self.streams, clock.first(), &found),
            false => 0,
        });
        let span =
            [clock.first(), clock.last()].map(|stamp| stamp.saturating_add(shift).max(0) as u64);
        if !std::mem::replace(&mut self.has_noted_clock, true) {
            intake.note(path, clock.description.clone());
        }
        intake.set_time_column(clock.unnamed_column.as_deref());
        if table.rate_hz.is_some() {
            intake.declare_metadata(None);
        }
        self.repeats.count(&found);
        if let Some(what) = clock.contradiction(table) {
            intake.contradiction(path, what);
        }
        let shape = table.shape(path, &clock);
        let shape = TableShape {
            layout: row_layout.map(RowLayout::to_string),
            given_layout: row_layout.cloned(),
            rate_hz: shape.rate_hz.filter(|_| !lacks_times),
            lacks_times,
            time_without_unit: lacks_times.then(|| clock::time_without_unit(table)).flatten(),
            ..shape
        };
        let shape = intake.table(shape);
        let episode = self.episodes.len().saturating_sub(1);
        for mut found in found {
            if let Some(velocities) = found.velocities.take() {
                let cells = found.cells.into_iter().map(|cell| TableCell { table: shape, ..cell });
                self.velocity_files.push(VelocityFile {
                    topic: found.topic,
                    kind: found.kind,
                    why: found.why,
                    cells: cells.collect(),
                    velocities,
                    span,
                });
                continue;
            }
            let (unstamped, damaged) = (found.unstamped, found.damaged.take());
            let TableTopic { mut topic, kind, why, contradiction, columns, rows, .. } = found;
            if !is_episode && self.streams.contains_key(&topic) {
                let file = path.file_stem().unwrap_or_default().to_string_lossy();
                topic = format!("{file}/{topic}");
            }
            let [cells, velocity_cells] = [found.cells, found.velocity_cells].map(|cells| {
                cells.into_iter().map(|cell| TableCell { table: shape, ..cell }).collect()
            });
            if let Some(what) = contradiction {
                intake.contradiction(path, what);
            }
            let mut lose = |rows: u64, what: &str| {
                let what = format!("{label}'{topic}': {what}");
                losses.add_unplaced(Extent::Messages, Some(rows), what);
            };
            if unstamped > 0 {
                lose(unstamped, &format!("{unstamped} rows without a stamp in their own clock"));
            }
            if let Some((damaged, first)) = &damaged {
                lose(*damaged, first);
            }
            let format = Format::without_schema(TABLE, &kind);
            let Some(channel) = intake.channel(&topic, format) else {
                lose(rows, "exceeds the limit on columns");
                continue;
            };
            intake.count(channel, rows, (span[0], span[1]));
            intake.read_as(channel, why, cells, velocity_cells);
            let Some(mut columns) = columns else { continue };
            for times in columns.times_mut() {
                let all = times.log.iter_mut();
                all.for_each(|received| *received = received.saturating_add(shift));
            }
            match self.streams.get_mut(&topic) {
                Some(stream) => {
                    stream.episodes.insert(episode);
                    if !append(&mut stream.columns, columns) {
                        lose(rows, "its type or width differs from that in earlier episodes");
                    }
                }
                None => {
                    let episodes = BTreeSet::from([episode]);
                    self.streams.insert(topic, TableStream { channel, columns, episodes });
                }
            }
        }
        Ok(())
    }

    /// Whether earlier tables have the same joints or poses. Other names, such as those of counters, are the same in
    /// tables of one run.
    fn is_episode(&self, found: &[TableTopic]) -> bool {
        let is_known = |found: &&TableTopic| {
            found.columns.as_ref().is_some_and(|columns| !is_unnamed(columns))
        };
        let has_earlier = |found: &TableTopic| self.streams.contains_key(&found.topic);
        match found.iter().any(|found| is_known(&found)) {
            true => found.iter().filter(is_known).any(has_earlier),
            false => found.iter().any(has_earlier),
        }
    }

    /// Whether the file names the joints or the pose of a run.
    pub(super) fn names_signal(&self, path: &Path) -> bool {
        file_names::table_names(&[path]).contains_key(path)
    }

    /// Whether a table was read by a given layout.
    pub(super) fn has_used_layout(&self) -> bool {
        self.has_used_layout
    }

    pub(super) fn finish(mut self, intake: &mut Intake) {
        for file in std::mem::take(&mut self.velocity_files) {
            file.add_to(&mut self.streams, intake);
        }
        for (topic, stream) in &self.streams {
            self.report_missing(topic, stream, intake);
        }
        if self.has_noted_clock {
            intake.repeats(self.repeats.in_all());
        }
        for (path, _) in self.row_times.iter().filter(|(_, is_used)| !**is_used) {
            let what =
                "is a list of times, but no other file has as many rows without times".to_owned();
            intake.note(path, what);
        }
        for TableStream { channel, columns, .. } in self.streams.into_values() {
            intake.columns(channel, columns);
        }
    }

    /// Reports a topic that at most half of the episodes of a file lack.
    fn report_missing(&self, topic: &str, stream: &TableStream, intake: &mut Intake) {
        let of_home = |home: &Path| {
            let all = self.episodes.iter().enumerate();
            all.filter(|(_, episode)| episode.home == home).map(|(at, _)| at).collect::<Vec<_>>()
        };
        let homes: BTreeSet<&Path> =
            stream.episodes.iter().map(|at| self.episodes[*at].home.as_path()).collect();
        for home in homes {
            let all = of_home(home);
            let missing: Vec<usize> =
                all.iter().copied().filter(|at| !stream.episodes.contains(at)).collect();
            if 2 * missing.len() > all.len() {
                continue;
            }
            for Episode { file, name, rows, .. } in missing.iter().map(|at| &self.episodes[*at]) {
                let mut losses = Losses::new(file);
                let what =
                    format!("episode {name} has no usable '{topic}', which other episodes have");
                losses.add_unplaced(Extent::Messages, Some(*rows as u64), what);
                intake.losses(losses);
            }
        }
    }
}

/// Why a table is no log, if it holds neither joints nor poses.
fn no_signal(found: &[TableTopic]) -> String {
    const SHOWN: usize = 4;
    let names: Vec<&str> = found.iter().map(|found| found.topic.as_str()).collect();
    let shown = names[..names.len().min(SHOWN)].join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 if names.is_empty() => "it holds no numbers besides its times".to_owned(),
        0 => format!("its columns hold neither joint positions nor poses: {shown}"),
        more => {
            format!("its columns hold neither joint positions nor poses: {shown} and {more} more")
        }
    }
}

/// Offset from stamps to receive times. Each episode restarts its clock, so episodes of the same topics
/// are placed one after another. Tables of other topics are recordings of the same run.
fn receive_offset_ns(
    streams: &BTreeMap<String, TableStream>,
    first: i64,
    found: &[TableTopic],
) -> i64 {
    const EPISODE_GAP_NS: i64 = NANOS_PER_SECOND / 1000;
    let same = found.iter().filter_map(|found| streams.get(&found.topic));
    let episodes: BTreeSet<usize> =
        same.flat_map(|stream| stream.episodes.iter().copied()).collect();
    let earlier = streams.values().filter(|stream| !stream.episodes.is_disjoint(&episodes));
    let times = earlier.flat_map(|stream| stream.columns.times());
    match times.filter_map(|times| times.log.last().copied()).max() {
        Some(until) if first <= until => until.saturating_add(EPISODE_GAP_NS).saturating_sub(first),
        _ => 0,
    }
}

fn is_unnamed(columns: &Columns) -> bool {
    matches!(columns, Columns::Array(array) if array.unnamed)
}

/// Maps the file at `place` if it has the same content; otherwise copies.
fn owned_bytes(place: &Path, bytes: &[u8]) -> Bytes {
    const COMPARED_BYTES: usize = 64;
    let is_it = |mapped: &MappedFile| {
        let own = mapped.bytes();
        let head = COMPARED_BYTES.min(bytes.len());
        own.len() == bytes.len() && own[..head] == bytes[..head]
    };
    match MappedFile::open(place).ok().filter(is_it) {
        Some(mapped) => Bytes::from_owner(mapped),
        None => Bytes::copy_from_slice(bytes),
    }
}

/// Returns false if the shapes differ.
fn append(to: &mut Columns, more: Columns) -> bool {
    match (to, more) {
        (Columns::Joints(to), Columns::Joints(more)) => {
            let names =
                |of: &JointColumns| of.joints.iter().map(|it| it.name.clone()).collect::<Vec<_>>();
            if names(to) != names(&more) {
                return false;
            }
            extend(&mut to.times, &more.times);
            for (joint, count) in more.unusable.iter().enumerate() {
                to.count_unusable(joint, *count);
            }
            for (to, more) in to.joints.iter_mut().zip(more.joints) {
                to.position.extend(more.position);
                to.velocity.extend_from(&more.velocity);
            }
            to.not_finite += more.not_finite;
        }
        (Columns::Array(to), Columns::Array(more)) if to.width == more.width => {
            extend(&mut to.times, &more.times);
            to.values.extend(more.values);
            to.not_finite += more.not_finite;
        }
        (Columns::Poses(to), Columns::Poses(more)) if to.len() == more.len() => {
            for (to, more) in to.iter_mut().zip(more) {
                extend(&mut to.times, &more.times);
                to.xyz.extend_from(&more.xyz);
                to.q_xyzw.extend_from(&more.q_xyzw);
                to.not_finite += more.not_finite;
            }
        }
        _ => return false,
    }
    true
}

fn extend(to: &mut Times, more: &Times) {
    more.header
        .iter()
        .zip(&more.log)
        .for_each(|(&stamp, &received)| to.push(stamp, received, received));
}

/// Counts and omits rows with an unusable number.
pub(super) fn array_columns(stamps: &[RowStamps], width: usize, values: &[f64]) -> ArrayColumns {
    let mut array = ArrayColumns { width, ..ArrayColumns::default() };
    for (stamp, row) in stamps.iter().zip(values.chunks_exact(width)) {
        if row.iter().all(|value| is_usable(*value)) {
            array.times.push(stamp.column_ns, stamp.row_ns, stamp.row_ns);
            array.values.extend_from_slice(row);
        } else {
            array.not_finite += 1;
        }
    }
    array
}

/// Joints by name. Their positions are usable or NaN.
pub(super) fn joint_columns(
    stamps: &[RowStamps],
    positions: impl Iterator<Item = (String, Vec<f64>)>,
) -> JointColumns {
    let mut times = Times::default();
    stamps.iter().for_each(|stamp| times.push(stamp.column_ns, stamp.row_ns, stamp.row_ns));
    let mut joints = JointColumns { times, ..JointColumns::default() };
    for (at, (name, position)) in positions.enumerate() {
        let unusable = position.iter().filter(|value| value.is_nan()).count();
        (0..unusable).for_each(|_| joints.drop_value(at));
        joints.joints.push(JointColumn::from_positions(name, position));
    }
    joints
}

/// Rows of positions (`width` 3), or of positions and quaternions xyzw (7).
fn pose_columns(stamps: &[RowStamps], width: usize, values: &[f64]) -> PoseColumns {
    let array = array_columns(stamps, width, values);
    let q_xyzw = |row: &[f64]| row.get(3..).and_then(|q| q.try_into().ok()).unwrap_or([0.0; 4]);
    PoseColumns {
        xyz: array.values.chunks_exact(width).map(|row| [row[0], row[1], row[2]]).collect(),
        q_xyzw: array.values.chunks_exact(width).map(q_xyzw).collect(),
        not_finite: array.not_finite,
        times: array.times.into(),
        ..PoseColumns::default()
    }
}

/// Sampling rate, Hz, if a number is named as one.
fn rate_by_name(name: &str, value: f64) -> Option<f64> {
    const RATES: &[&str] =
        &["fps", "control_freq", "control_frequency", "frequency", "rate_hz", "rate", "hz"];
    let is_named = RATES.iter().any(|rate| name.eq_ignore_ascii_case(rate));
    Some(value).filter(|rate_hz| is_named && is_rate(rate_hz))
}

/// Sampling rate, Hz, by the scalars that are stored with arrays: a rate, or else a sampling period.
fn rate_of_scalars(scalars: &[(String, f64)]) -> Option<f64> {
    const PERIODS: &[&str] = &["dt", "sample_time", "sampling_time", "sampling_period"];
    /// Periods in s. Longer ones may be those of a motion, or in another unit.
    const PERIODS_S: Range<f64> = 1e-4..1.0;
    let is_period = |(name, value): &&(String, f64)| {
        PERIODS.iter().any(|period| name.eq_ignore_ascii_case(period)) && PERIODS_S.contains(value)
    };
    let rate_hz = scalars.iter().find_map(|(name, value)| rate_by_name(name, *value));
    rate_hz.or_else(|| Some(1.0 / scalars.iter().find(is_period)?.1))
}

fn is_rate(rate_hz: &f64) -> bool {
    (1e-3..=1e6).contains(rate_hz)
}

fn rate_in(value: &Value) -> Option<f64> {
    let all = value.as_object()?;
    let own = all.iter().find_map(|(name, value)| rate_by_name(name, value.as_f64()?));
    own.or_else(|| all.values().find_map(rate_in))
}

/// Number of arrays that may have each number of rows. A `k` by `N` array has `k` or `N`.
type RowCounts = BTreeMap<usize, usize>;

fn row_counts(shapes: &[Vec<usize>]) -> RowCounts {
    let mut counts = RowCounts::new();
    for shape in shapes {
        let sides = [shape.first().copied(), long_side(shape)];
        sides.into_iter().flatten().for_each(|rows| *counts.entry(rows).or_default() += 1);
    }
    if counts.keys().any(|rows| *rows > MAX_PARAMETERS) {
        counts.retain(|rows, _| *rows > MAX_PARAMETERS);
    }
    counts
}

/// Second side of an array that may be transposed.
fn long_side(shape: &[usize]) -> Option<usize> {
    /// Minimum ratio of rows to columns in a transposed array.
    const MIN_ASPECT: usize = 4;
    let &[columns, rows] = shape else { return None };
    ((1..=MAX_WIDTH).contains(&columns) && rows / MIN_ASPECT > columns).then_some(rows)
}

/// Whether more arrays have the second side as their number of rows than the first, or as many.
fn is_transposed(shape: &[usize], counts: &RowCounts) -> bool {
    let most = counts.iter().max_by_key(|&(rows, count)| (count, rows)).map(|(rows, _)| *rows);
    let is_most = matches!(shape, &[columns, rows] if Some(rows) == most && columns < rows);
    let count = |rows: usize| counts.get(&rows).copied().unwrap_or(0);
    is_most
        || long_side(shape).is_some_and(|rows| count(rows) > 1 && count(rows) >= count(shape[0]))
}

/// Most frequent number of rows. Arrays of parameters count only if there are no longer ones.
fn most_frequent_rows(rows: impl Iterator<Item = usize>) -> usize {
    let (long, short): (Vec<usize>, Vec<usize>) = rows.partition(|rows| *rows > MAX_PARAMETERS);
    most_frequent(if long.is_empty() { short } else { long }.into_iter())
}

fn most_frequent(rows: impl Iterator<Item = usize>) -> usize {
    let rows: Vec<usize> = rows.collect();
    let count = |of: usize| rows.iter().filter(|own| **own == of).count();
    rows.iter().copied().max_by_key(|&of| (count(of), of)).unwrap_or(0)
}

/// Names of the episodes at `path`. Empty if there is only one or no table. A data file of LeRobot v3 also
/// names its only episode, because the file's name does not.
pub fn episodes(path: &Path) -> Vec<String> {
    if is_store(path) {
        return if_several(zarr::episodes_in(zarr::StoreLocation::Folder(path)));
    }
    let Ok(mapped) = MappedFile::open(path) else { return Vec::new() };
    let FileFormat::Table(format) = detect_format(mapped.bytes()) else { return Vec::new() };
    if_several(match format {
        TableFormat::Parquet => {
            let names = parquet::episodes_in(Bytes::from_owner(mapped));
            if lerobot::is_shared_file(path) {
                return names.unwrap_or_default();
            }
            names
        }
        TableFormat::Hdf5 => hdf5::episodes_in(Bytes::from_owner(mapped)),
        TableFormat::Zarr => zarr::episodes_in(zarr::StoreLocation::Bytes(mapped.bytes())),
        TableFormat::TfRecord => tfrecord::episodes_in(mapped.bytes()),
        _ => return Vec::new(),
    })
}

fn if_several(names: Result<Vec<String>, TableError>) -> Vec<String> {
    names.ok().filter(|names| names.len() > 1).unwrap_or_default()
}

/// Splits `PATH#EPISODE`, unless the whole path exists as a file.
pub fn split_episode(path: &Path) -> (PathBuf, Option<String>) {
    let split = || {
        let (file, episode) = path.to_str()?.rsplit_once('#')?;
        let file = PathBuf::from(file);
        (!path.exists() && file.exists()).then(|| (file, Some(episode.to_owned())))
    };
    split().unwrap_or_else(|| (path.to_owned(), None))
}
