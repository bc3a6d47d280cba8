//! Parquet: columns of numbers, and lists of as many numbers in every row.
//!
//! Values are read leaf by leaf with their levels, so that what wrote the file does not matter: pyarrow's
//! fixed lists and Hugging Face's sequences are the same there.

use ::bytes::Bytes;
use ::parquet::basic::Type;
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use ::parquet::data_type::DataType;
use ::parquet::errors::ParquetError;
use ::parquet::file::reader::{FileReader, SerializedFileReader};

use super::lerobot::Dataset;
use super::{Column, MOST_COLUMNS, MOST_NUMBERS, MOST_WIDE, Refusal, Table};

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

/// The episodes of a file: by `episode_index`, where it has that column.
pub(super) fn read(
    bytes: Bytes,
    dataset: Option<&Dataset>,
) -> Result<Vec<(String, Table)>, Refusal> {
    let reader = SerializedFileReader::new(bytes).map_err(|error| worded(&error))?;
    let metadata = reader.metadata();
    let schema = metadata.file_metadata().schema_descr_ptr();
    let mut leaves = Vec::new();
    let mut budget = MOST_NUMBERS;
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
        let mut lengths = Lengths::default();
        let mut values = Vec::new();
        for group in 0..reader.num_row_groups() {
            let group = reader.get_row_group(group).map_err(|error| worded(&error))?;
            let column = group.get_column_reader(at).map_err(|error| worded(&error))?;
            let read = leaf(column, is_list, &mut lengths, &mut values, budget);
            read.map_err(|what| format!("column '{name}': {what}"))?;
        }
        lengths.end();
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
    let reader = SerializedFileReader::new(bytes).map_err(|error| worded(&error))?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let Some(at) =
        (0..schema.num_columns()).find(|&at| schema.column(at).path().string() == EPISODE)
    else {
        return Ok(Vec::new());
    };
    let (mut lengths, mut values) = (Lengths::default(), Vec::new());
    for group in 0..reader.num_row_groups() {
        let group = reader.get_row_group(group).map_err(|error| worded(&error))?;
        let column = group.get_column_reader(at).map_err(|error| worded(&error))?;
        leaf(column, false, &mut lengths, &mut values, MOST_NUMBERS)?;
    }
    values.dedup();
    Ok(values.iter().map(f64::to_string).collect())
}

/// The rows of each episode; the whole where there is no column of them.
fn episodes(leaves: &[Leaf], rows: usize) -> Vec<(String, Table)> {
    let index = leaves.iter().find(|leaf| leaf.name == EPISODE && leaf.width == 1);
    let mut spans: Vec<(String, std::ops::Range<usize>)> = Vec::new();
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
    let table = |span: std::ops::Range<usize>| Table {
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
        rate_hz: None,
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

fn leaf(
    column: ColumnReader,
    is_list: bool,
    lengths: &mut Lengths,
    values: &mut Vec<f64>,
    budget: usize,
) -> Result<(), String> {
    match column {
        ColumnReader::BoolColumnReader(column) => {
            numbers(column, is_list, lengths, values, budget, |value| f64::from(u8::from(value)))
        }
        ColumnReader::Int32ColumnReader(column) => {
            numbers(column, is_list, lengths, values, budget, f64::from)
        }
        ColumnReader::Int64ColumnReader(column) => {
            numbers(column, is_list, lengths, values, budget, |value| value as f64)
        }
        ColumnReader::FloatColumnReader(column) => {
            numbers(column, is_list, lengths, values, budget, f64::from)
        }
        ColumnReader::DoubleColumnReader(column) => {
            numbers(column, is_list, lengths, values, budget, |value| value)
        }
        _ => Err("it holds no numbers".to_owned()),
    }
}

/// Appends the numbers of a leaf in one row group; NaN where there is none.
fn numbers<T: DataType>(
    mut column: ColumnReaderImpl<T>,
    is_list: bool,
    lengths: &mut Lengths,
    values: &mut Vec<f64>,
    budget: usize,
    number: impl Fn(T::T) -> f64,
) -> Result<(), String> {
    let (mut found, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
    loop {
        (found.clear(), definitions.clear(), repetitions.clear());
        let (records, _, levels) = column
            .read_records(BATCH, Some(&mut definitions), Some(&mut repetitions), &mut found)
            .map_err(|error| worded(&error))?;
        if records == 0 {
            return Ok(());
        }
        if values.len() + levels > budget {
            return Err(format!("it has more than {budget} numbers"));
        }
        let most = definitions.iter().copied().max().unwrap_or(0);
        let is_all = definitions.is_empty() || found.len() == levels;
        let mut own = found.drain(..);
        for level in 0..levels {
            lengths.count(!is_list || repetitions.get(level).is_none_or(|level| *level == 0));
            let is_there = is_all || definitions[level] == most;
            values.push(own.next_if(is_there).map_or(f64::NAN, &number));
        }
    }
}

trait NextIf: Iterator + Sized {
    /// The next where there is one.
    fn next_if(&mut self, is_there: bool) -> Option<Self::Item> {
        if is_there { self.next() } else { None }
    }
}

impl<I: Iterator> NextIf for I {}

fn worded(error: &ParquetError) -> Refusal {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    format!("the Parquet file cannot be read: {line}")
}
