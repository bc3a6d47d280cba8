//! Parquet: columns of numbers, and lists of as many numbers in every row.
//!
//! Values are read leaf by leaf with their levels, so that what wrote the file does not matter: pyarrow's
//! fixed lists and Hugging Face's sequences are the same there.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use ::bytes::Bytes;
use ::parquet::basic::Type;
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_column_reader};
use ::parquet::data_type::DataType;
use ::parquet::errors::ParquetError;
use ::parquet::file::metadata::{ParquetMetaData, ParquetMetaDataReader};
use ::parquet::file::serialized_reader::SerializedPageReader;
use ::parquet::file::statistics::Statistics;

use super::lerobot::Dataset;
use super::{Column, Episodes, MOST_COLUMNS, MOST_NUMBERS, MOST_WIDE, Refusal, Table};

/// The column that tells the episodes of a dataset apart.
const EPISODE: &str = "episode_index";
/// Records that are decoded at once.
const BATCH: usize = 1 << 14;

/// The numbers of one leaf: as many in each row.
struct Leaf {
    name: String,
    kind: &'static str,
    width: usize,
    values: Vec<f64>,
}

/// A file, and where in it what is.
struct File {
    bytes: Arc<Bytes>,
    metadata: Arc<ParquetMetaData>,
}

impl File {
    /// Parses the metadata, which takes as long as to read an episode of a dataset, only where those of the
    /// last file were others.
    fn open(bytes: Bytes) -> Result<Self, Refusal> {
        static LAST: Mutex<Option<(Vec<u8>, Arc<ParquetMetaData>)>> = Mutex::new(None);
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        let footer = footer(&bytes).unwrap_or_default();
        let known = last.as_ref().filter(|(known, _)| !footer.is_empty() && known == footer);
        let metadata = match known {
            Some((_, metadata)) => Arc::clone(metadata),
            None => {
                let read = ParquetMetaDataReader::new().parse_and_finish(&bytes);
                let metadata = Arc::new(read.map_err(|error| worded(&error))?);
                *last = Some((footer.to_vec(), Arc::clone(&metadata)));
                metadata
            }
        };
        Ok(Self { bytes: Arc::new(bytes), metadata })
    }

    fn column(&self, group: usize, at: usize) -> Result<ColumnReader, Refusal> {
        let of = self.metadata.row_group(group);
        let rows = usize::try_from(of.num_rows()).unwrap_or(0);
        let pages = SerializedPageReader::new(Arc::clone(&self.bytes), of.column(at), rows, None);
        let pages = pages.map_err(|error| worded(&error))?;
        Ok(get_column_reader(of.column(at).column_descr_ptr(), Box::new(pages)))
    }
}

/// The metadata behind a file's rows, as they stand there.
fn footer(bytes: &[u8]) -> Option<&[u8]> {
    let (rest, end) = bytes.split_last_chunk::<8>()?;
    let [a, b, c, d, ..] = *end;
    let length = usize::try_from(u32::from_le_bytes([a, b, c, d])).ok()?;
    rest.get(rest.len().checked_sub(length)?..)
}

/// The episodes of a file: by `episode_index`, where it has that column. Of one that is `wanted` only its rows
/// are decoded.
pub(super) fn read(
    bytes: Bytes,
    dataset: Option<&Dataset>,
    wanted: Option<&str>,
) -> Result<Episodes, Refusal> {
    let reader = File::open(bytes)?;
    let schema = reader.metadata.file_metadata().schema_descr_ptr();
    let mut leaves = Vec::new();
    let mut budget = MOST_NUMBERS;
    let rows = match wanted {
        Some(wanted) => {
            let Some(rows) = rows_of(&reader, wanted)? else { return Ok(Vec::new()) };
            rows
        }
        None => 0..usize::MAX,
    };
    for at in 0..schema.num_columns().min(MOST_COLUMNS) {
        let column = schema.column(at);
        let kind = match column.physical_type() {
            Type::BOOLEAN => "bool",
            Type::INT32 => "int32",
            Type::INT64 => "int64",
            Type::FLOAT => "float32",
            Type::DOUBLE => "float64",
            _ => continue,
        };
        // The parts of a list's path that the format adds are no name.
        let path = column.path();
        let parts = path.parts();
        let is_list = column.max_rep_level() == 1;
        let named = if is_list { parts.len().saturating_sub(2).max(1) } else { parts.len() };
        let name = parts[..named].join(".");
        let is_wanted = dataset.is_none_or(|dataset| dataset.is_numeric(&name));
        if column.max_rep_level() > 1 || !is_wanted {
            continue;
        }
        let mut of = Numbers { is_list, budget, rows: rows.clone(), ..Numbers::default() };
        of.read(&reader, at).map_err(|what| format!("column '{name}': {what}"))?;
        let Numbers { lengths, values, .. } = of;
        budget = budget.saturating_sub(values.len());
        // A list of other lengths from row to row is no vector.
        let Some(width) = lengths.width().filter(|width| *width <= MOST_WIDE) else { continue };
        leaves.push(Leaf { name, kind, width, values });
    }
    let rows = leaves.iter().map(|leaf| leaf.values.len() / leaf.width).max().unwrap_or(0);
    leaves.retain(|leaf| leaf.values.len() == rows * leaf.width);
    if leaves.is_empty() || rows == 0 {
        return Err("it holds no column of numbers".to_owned());
    }
    Ok(episodes(&leaves, rows))
}

/// The names of the episodes of a file.
pub(super) fn episodes_in(bytes: Bytes) -> Result<Vec<String>, Refusal> {
    let mut index = index(&File::open(bytes)?)?;
    index.dedup();
    Ok(index.iter().map(f64::to_string).collect())
}

/// The episode of each row; empty where no column says it.
fn index(reader: &File) -> Result<Vec<f64>, Refusal> {
    let Some(at) = index_column(reader) else { return Ok(Vec::new()) };
    let mut of = Numbers { budget: MOST_NUMBERS, rows: 0..usize::MAX, ..Numbers::default() };
    of.read(reader, at)?;
    Ok(of.values)
}

fn index_column(reader: &File) -> Option<usize> {
    let schema = reader.metadata.file_metadata().schema_descr_ptr();
    (0..schema.num_columns()).find(|at| schema.column(*at).path().string() == EPISODE)
}

/// The rows of one episode. Row groups whose statistics say that it is not in them are passed over.
fn rows_of(reader: &File, wanted: &str) -> Result<Option<Range<usize>>, Refusal> {
    let (Some(at), Ok(number)) = (index_column(reader), wanted.parse::<i64>()) else {
        return Ok(None);
    };
    let (mut first, mut found) = (0_usize, None::<Range<usize>>);
    for group in reader.metadata.row_groups() {
        let count = usize::try_from(group.num_rows()).unwrap_or(0);
        let own = first..first.saturating_add(count);
        first = own.end;
        let may_hold = match group.column(at).statistics() {
            Some(Statistics::Int64(of)) => {
                of.min_opt().is_none_or(|least| *least <= number)
                    && of.max_opt().is_none_or(|most| *most >= number)
            }
            _ => true,
        };
        if !may_hold {
            continue;
        }
        let mut of = Numbers { budget: MOST_NUMBERS, rows: own.clone(), ..Numbers::default() };
        of.read(reader, at)?;
        let is_its = |value: &f64| *value == number as f64;
        let Some(start) = of.values.iter().position(is_its) else { continue };
        let length = of.values[start..].iter().take_while(|value| is_its(value)).count();
        let rows = own.start + start..own.start + start + length;
        match &mut found {
            Some(found) if found.end == rows.start => found.end = rows.end,
            Some(_) => {}
            None => found = Some(rows),
        }
    }
    Ok(found)
}

/// The rows of each episode; the whole where there is no column of them.
fn episodes(leaves: &[Leaf], rows: usize) -> Episodes {
    let index = leaves.iter().find(|leaf| leaf.name == EPISODE && leaf.width == 1);
    let mut spans: Vec<(String, Range<usize>)> = Vec::new();
    match index {
        Some(index) => {
            for row in 0..rows {
                let name = format!("{}", index.values[row]);
                match spans.last_mut().filter(|(last, _)| *last == name) {
                    Some((_, span)) => span.end = row + 1,
                    None => spans.push((name, row..row + 1)),
                }
            }
        }
        None => spans.push(("0".to_owned(), 0..rows)),
    }
    let table = |span: Range<usize>| Table {
        rows: span.len(),
        columns: leaves
            .iter()
            .map(|leaf| Column {
                name: leaf.name.clone(),
                kind: leaf.kind.to_owned(),
                width: leaf.width,
                parts: Vec::new(),
                values: leaf.values[span.start * leaf.width..span.end * leaf.width].to_vec(),
            })
            .collect(),
        ..Table::default()
    };
    spans.into_iter().map(|(name, span)| (name, table(span))).collect()
}

/// How many numbers the rows of a leaf have.
#[derive(Default)]
struct Lengths {
    open: Option<usize>,
    all: Option<usize>,
    differ: bool,
}

impl Lengths {
    /// Counts a number; whether it is the first of its row.
    fn count(&mut self, is_first: bool) {
        if is_first {
            self.end();
        }
        *self.open.get_or_insert(0) += 1;
    }

    fn end(&mut self) {
        let Some(length) = self.open.take() else { return };
        self.differ |= *self.all.get_or_insert(length) != length;
    }

    fn width(&self) -> Option<usize> {
        self.all.filter(|_| !self.differ)
    }
}

/// The numbers of a leaf in some rows; NaN where there is none.
#[derive(Default)]
struct Numbers {
    is_list: bool,
    budget: usize,
    /// The rows of the file that are read.
    rows: Range<usize>,
    lengths: Lengths,
    values: Vec<f64>,
}

impl Numbers {
    /// Reads column `at` of all row groups that have any of the rows.
    fn read(&mut self, reader: &File, at: usize) -> Result<(), Refusal> {
        let mut first = 0;
        for (group, count) in
            reader.metadata.row_groups().iter().map(|of| of.num_rows()).enumerate()
        {
            let count = usize::try_from(count).unwrap_or(0);
            let own = self.rows.start.max(first)..self.rows.end.min(first + count);
            if !own.is_empty() {
                self.column(reader.column(group, at)?, own.start - first..own.end - first)?;
            }
            first += count;
        }
        self.lengths.end();
        Ok(())
    }

    fn column(&mut self, column: ColumnReader, rows: Range<usize>) -> Result<(), Refusal> {
        match column {
            ColumnReader::BoolColumnReader(column) => {
                self.append(column, rows, |value| f64::from(u8::from(value)))
            }
            ColumnReader::Int32ColumnReader(column) => self.append(column, rows, f64::from),
            ColumnReader::Int64ColumnReader(column) => {
                self.append(column, rows, |value| value as f64)
            }
            ColumnReader::FloatColumnReader(column) => self.append(column, rows, f64::from),
            ColumnReader::DoubleColumnReader(column) => self.append(column, rows, |value| value),
            _ => Err("it holds no numbers".to_owned()),
        }
    }

    fn append<T: DataType>(
        &mut self,
        mut column: ColumnReaderImpl<T>,
        rows: Range<usize>,
        number: impl Fn(T::T) -> f64,
    ) -> Result<(), Refusal> {
        let (mut found, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
        column.skip_records(rows.start).map_err(|error| worded(&error))?;
        let mut left = rows.len();
        while left > 0 {
            found.clear();
            definitions.clear();
            repetitions.clear();
            let most = BATCH.min(left);
            let (records, _, levels) = column
                .read_records(most, Some(&mut definitions), Some(&mut repetitions), &mut found)
                .map_err(|error| worded(&error))?;
            if records == 0 {
                return Ok(());
            }
            left -= records.min(left);
            if self.values.len() + levels > self.budget {
                return Err(format!("it has more than {} numbers", self.budget));
            }
            let most = definitions.iter().copied().max().unwrap_or(0);
            let is_all = definitions.is_empty() || found.len() == levels;
            let mut own = found.drain(..);
            for level in 0..levels {
                let starts = repetitions.get(level).is_none_or(|level| *level == 0);
                self.lengths.count(!self.is_list || starts);
                let is_there = is_all || definitions.get(level) == Some(&most);
                let value = if is_there { own.next() } else { None };
                self.values.push(value.map_or(f64::NAN, &number));
            }
        }
        Ok(())
    }
}

fn worded(error: &ParquetError) -> Refusal {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    format!("the Parquet file cannot be read: {line}")
}
