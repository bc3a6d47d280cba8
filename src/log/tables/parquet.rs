//! Parquet: columns of numbers, and lists with the same length in every row.
//!
//! Reads values leaf by leaf with their levels, because pyarrow's fixed-size lists and Hugging Face's
//! sequences have identical leaves.

mod read_ahead;

use std::collections::VecDeque;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ::bytes::Bytes;
use ::parquet::basic::{Encoding, Type};
use ::parquet::column::page::{Page, PageMetadata, PageReader};
use ::parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_column_reader};
use ::parquet::data_type::DataType;
use ::parquet::errors::ParquetError;
use ::parquet::file::metadata::{ParquetMetaData, ParquetMetaDataReader};
use ::parquet::file::serialized_reader::SerializedPageReader;
use ::parquet::file::statistics::Statistics;

use self::read_ahead::FileState;
use super::lerobot::Dataset;
use super::pages::{self, PageHeader};
use super::{
    Column, Episodes, MAX_COLUMNS, MAX_EPISODES, MAX_WIDTH, ReadColumn, ReadContext, RowLoss,
    Table, TableError, first_line, most_frequent,
};
use crate::memory_budget::MemoryBudget;
use ground::boundary::catch_panic;

const EPISODE_COLUMN: &str = "episode_index";
/// Rows per call.
const BATCH_ROWS: usize = 1 << 14;

struct ParquetFile {
    bytes: Arc<Bytes>,
    metadata: Arc<ParquetMetaData>,
    /// If later calls may read other episodes of the file.
    state: Option<FileState>,
}

impl ParquetFile {
    /// Reuses the metadata of the previous file if equal: parsing takes as long as reading one episode of a
    /// dataset.
    fn open(bytes: Bytes) -> Result<Self, TableError> {
        static LAST_METADATA: Mutex<Option<(Vec<u8>, Arc<ParquetMetaData>)>> = Mutex::new(None);
        let mut last = LAST_METADATA.lock().unwrap_or_else(PoisonError::into_inner);
        let footer = footer(&bytes).unwrap_or_default();
        let known = last.as_ref().filter(|(known, _)| !footer.is_empty() && known == footer);
        let metadata = match known {
            Some((_, metadata)) => Arc::clone(metadata),
            None => {
                let read = ParquetMetaDataReader::new().parse_and_finish(&bytes);
                let metadata = Arc::new(read.map_err(|error| read_error(&error))?);
                *last = Some((footer.to_vec(), Arc::clone(&metadata)));
                metadata
            }
        };
        Ok(Self { bytes: Arc::new(bytes), metadata, state: None })
    }

    /// Also returns the list of its unreadable pages, filled while reading.
    fn column(
        &self,
        group: usize,
        at: usize,
        memory: &MemoryBudget,
    ) -> Result<(ColumnReader, SharedPageCounts), TableError> {
        let of = self.metadata.row_group(group);
        let column = of.column(at);
        let rows = usize::try_from(of.num_rows()).unwrap_or(0);
        let start = column.dictionary_page_offset().unwrap_or_else(|| column.data_page_offset());
        let range = usize::try_from(start).ok().zip(usize::try_from(column.compressed_size()).ok());
        let range = range.and_then(|(start, length)| Some(start..start.checked_add(length)?));
        let content =
            range.and_then(|range| self.bytes.get(range)).ok_or("its pages are missing")?;
        let headers: VecDeque<PageHeader> = pages::headers(content).into();
        for page in &headers {
            // A page, its unpacked bytes and its numbers are in memory at the same time.
            memory
                .check_available((page.unpacked_bytes.max(page.values.saturating_mul(8))) as u64)?;
        }
        let pages = SerializedPageReader::new(Arc::clone(&self.bytes), column, rows, None);
        let pages = pages.map_err(|error| read_error(&error))?;
        let declared = usize::try_from(column.num_values()).unwrap_or(0);
        let damaged = Arc::new(Mutex::new(PageCounts { declared, ..PageCounts::default() }));
        let found = Arc::clone(&damaged);
        let pages = IntactPages { pages, headers, found, has_dictionary: false };
        Ok((get_column_reader(column.column_descr_ptr(), Box::new(pages)), damaged))
    }

    /// Rows of each row group.
    fn groups(&self) -> impl Iterator<Item = usize> {
        self.metadata.row_groups().iter().map(|of| usize::try_from(of.num_rows()).unwrap_or(0))
    }
}

/// Pages of a column in a row group.
#[derive(Debug, Default)]
struct PageCounts {
    /// Count in all pages so far.
    values: usize,
    /// Number of values before the page and in it, and the reason.
    damaged: Vec<(usize, usize, String)>,
    declared: usize,
}

type SharedPageCounts = Arc<Mutex<PageCounts>>;

struct IntactPages {
    pages: SerializedPageReader<Bytes>,
    /// Headers of the pages not yet read.
    headers: VecDeque<PageHeader>,
    found: SharedPageCounts,
    /// Whether the dictionary page was read.
    has_dictionary: bool,
}

impl IntactPages {
    /// Returns the number of values before the next page.
    fn count_page(&mut self) -> (usize, Option<PageHeader>) {
        let header = self.headers.pop_front();
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        let before = found.values;
        let own = header.filter(|header| !header.is_dictionary).map_or(0, |header| header.values);
        found.values = before.saturating_add(own);
        (before, header)
    }

    /// Rejects a page that needs a missing dictionary: the decoder of the crate panics on it.
    fn check_decodable(&mut self, page: Option<Page>) -> ::parquet::errors::Result<Option<Page>> {
        let is_coded = |page: &Page| {
            matches!(page.encoding(), Encoding::PLAIN_DICTIONARY | Encoding::RLE_DICTIONARY)
        };
        match &page {
            Some(Page::DictionaryPage { .. }) => self.has_dictionary = true,
            Some(page) if is_coded(page) && !self.has_dictionary => {
                let what = "a page needs a dictionary, but its column has none";
                return Err(ParquetError::General(what.to_owned()));
            }
            _ => {}
        }
        Ok(page)
    }
}

impl Iterator for IntactPages {
    type Item = ::parquet::errors::Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for IntactPages {
    fn get_next_page(&mut self) -> ::parquet::errors::Result<Option<Page>> {
        loop {
            let page = self.pages.get_next_page().and_then(|page| self.check_decodable(page));
            let (before, header) = self.count_page();
            match (page, header) {
                (Ok(page), _) => return Ok(page),
                (Err(error), Some(header)) if !header.is_dictionary => {
                    let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
                    found.damaged.push((before, header.values, read_error(&error).to_string()));
                }
                // Without its dictionary no page can be decoded.
                (Err(error), _) => return Err(error),
            }
        }
    }

    fn peek_next_page(&mut self) -> ::parquet::errors::Result<Option<PageMetadata>> {
        Ok(self.headers.front().map(|header| header.metadata()))
    }

    fn skip_next_page(&mut self) -> ::parquet::errors::Result<()> {
        self.pages.skip_next_page()?;
        self.count_page();
        Ok(())
    }

    fn at_record_boundary(&mut self) -> ::parquet::errors::Result<bool> {
        self.pages.at_record_boundary()
    }
}

/// Metadata at the end of a file.
fn footer(bytes: &[u8]) -> Option<&[u8]> {
    let (rest, end) = bytes.split_last_chunk::<8>()?;
    let [a, b, c, d, ..] = *end;
    let length = usize::try_from(u32::from_le_bytes([a, b, c, d])).ok()?;
    rest.get(rest.len().checked_sub(length)?..)
}

/// Splits by `episode_index`, if present. Returns only the `wanted` episode. `bytes` is the content of the file
/// at `place`.
pub(super) fn read(
    place: &Path,
    bytes: Bytes,
    dataset: Option<&Dataset>,
    wanted: Option<&str>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let mut reader = ParquetFile::open(bytes)?;
    reader.state = wanted.and_then(|_| FileState::read(place));
    let schema = reader.metadata.file_metadata().schema_descr_ptr();
    let all: usize = reader.groups().fold(0, usize::saturating_add);
    let rows = match wanted {
        Some(wanted) => {
            let Some(rows) = rows_of_episode(&reader, wanted, context.memory)? else {
                return Ok(Vec::new());
            };
            rows
        }
        None => 0..all,
    };
    let declared = usize::try_from(reader.metadata.file_metadata().num_rows()).unwrap_or(0);
    if wanted.is_none() && declared > all {
        let what = format!("the footer declares {declared} rows, the row groups {all}");
        TableError::from(what).report(Some((declared - all) as u64), context.losses);
    }
    if schema.num_columns() > MAX_COLUMNS {
        let what = format!("{} columns; only {MAX_COLUMNS} are read", schema.num_columns());
        TableError::from(what).report(None, context.losses);
    }
    let (mut candidates, mut unread) = (Vec::new(), Vec::new());
    for at in 0..schema.num_columns().min(MAX_COLUMNS) {
        let column = schema.column(at);
        let kind = match column.physical_type() {
            Type::BOOLEAN => "bool",
            Type::INT32 => "int32",
            Type::INT64 => "int64",
            Type::FLOAT => "float32",
            Type::DOUBLE => "float64",
            _ => continue,
        };
        // Omit the levels that the format adds to a list.
        let path = column.path();
        let parts = path.parts();
        let is_list = column.max_rep_level() == 1;
        let named = if is_list { parts.len().saturating_sub(2).max(1) } else { parts.len() };
        let name = parts[..named].join(".");
        let is_wanted = dataset.is_none_or(|dataset| dataset.is_numeric(&name));
        if column.max_rep_level() > 1 || !is_wanted {
            continue;
        }
        let mut of = LeafValues::new(&reader, at, rows.clone());
        if let Err(what) = of.read(&reader, at, context.memory) {
            candidates.push(ReadColumn::unreadable(&name, rows.len(), what));
            continue;
        }
        let column = Column { name, kind: kind.to_owned(), ..Column::default() };
        match of.into_column(column) {
            Ok(candidate) => candidates.push(candidate),
            Err(name) => unread.push((name, "lists of different lengths".to_owned())),
        }
    }
    if candidates.is_empty() || rows.is_empty() {
        return Err("it contains no column of numbers".into());
    }
    let mut whole = Table::from_columns(candidates, Some(rows.len()), context.memory);
    whole.unread.extend(unread);
    if whole.columns.is_empty() {
        let first = whole.losses.into_iter().next();
        return Err(
            first.map_or_else(|| "it contains no column of numbers".into(), |loss| loss.what)
        );
    }
    split_episodes(whole, wanted)
}

pub(super) fn episodes_in(bytes: Bytes) -> Result<Vec<String>, TableError> {
    let mut memory = MemoryBudget::new(None);
    memory.add_file(bytes.len() as u64);
    let mut index = read_episode_index(&ParquetFile::open(bytes)?, &mut memory)?;
    index.dedup();
    Ok(index.iter().map(f64::to_string).collect())
}

/// One per row; empty if there is no such column.
fn read_episode_index(
    reader: &ParquetFile,
    memory: &mut MemoryBudget,
) -> Result<Vec<f64>, TableError> {
    let Some(at) = index_column(reader) else { return Ok(Vec::new()) };
    let mut of = LeafValues::new(reader, at, 0..reader.groups().fold(0, usize::saturating_add));
    of.read(reader, at, memory)?;
    Ok(of.values)
}

fn index_column(reader: &ParquetFile) -> Option<usize> {
    let schema = reader.metadata.file_metadata().schema_descr_ptr();
    (0..schema.num_columns()).find(|at| schema.column(*at).path().string() == EPISODE_COLUMN)
}

/// Skips row groups whose statistics exclude the episode.
fn rows_of_episode(
    reader: &ParquetFile,
    wanted: &str,
    memory: &mut MemoryBudget,
) -> Result<Option<Range<usize>>, TableError> {
    let (Some(at), Ok(number)) = (index_column(reader), wanted.parse::<i64>()) else {
        return Ok(None);
    };
    let (mut first, mut found) = (0_usize, None::<Range<usize>>);
    for (index, group) in reader.metadata.row_groups().iter().enumerate() {
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
        let episodes = match read_ahead::episodes(reader, index) {
            Some(episodes) => episodes,
            None => {
                let mut of = LeafValues::new(reader, at, own.clone());
                of.read(reader, at, memory)?;
                memory.release(of.values.len());
                let episodes = spans_of_equal_numbers(&of.values);
                read_ahead::keep_episodes(reader, index, &episodes);
                episodes
            }
        };
        let is_its = |(episode, _): &&(f64, Range<usize>)| *episode == number as f64;
        let Some((_, span)) = episodes.iter().find(is_its) else { continue };
        let rows = own.start + span.start..own.start + span.end;
        match &mut found {
            Some(found) if found.end == rows.start => found.end = rows.end,
            Some(_) => {}
            None => found = Some(rows),
        }
    }
    Ok(found)
}

fn spans_of_equal_numbers(values: &[f64]) -> Vec<(f64, Range<usize>)> {
    let mut end = 0;
    let spans = values.chunk_by(|a, b| a == b).map(|equal| {
        let start = end;
        end += equal.len();
        (equal[0], start..end)
    });
    spans.collect()
}

/// Returns the table whole if it has no episode column.
fn split_episodes(whole: Table, wanted: Option<&str>) -> Result<Episodes, TableError> {
    let index =
        whole.columns.iter().position(|column| column.name == EPISODE_COLUMN && column.width == 1);
    let Some(index) = index else { return Ok(vec![("0".to_owned(), whole)]) };
    let mut spans: Vec<(f64, Range<usize>)> = Vec::new();
    let number = |row: usize| whole.columns[index].values[row];
    for row in (0..whole.rows).filter(|row| number(*row).is_finite()) {
        match spans.last_mut().filter(|(last, _)| *last == number(row)) {
            Some((_, span)) => span.end = row + 1,
            None => spans.push((number(row), row..row + 1)),
        }
        if wanted.is_none() && spans.len() > MAX_EPISODES {
            return Err(TableError::Episodes);
        }
    }
    let of = |(number, span): (f64, Range<usize>), losses: Vec<RowLoss>| {
        let columns = whole.columns.iter().map(|column| Column {
            name: column.name.clone(),
            kind: column.kind.clone(),
            width: column.width,
            values: column.values[span.start * column.width..span.end * column.width].to_vec(),
            ..Column::default()
        });
        let lost_in = |lost: &Vec<Range<usize>>| -> Vec<Range<usize>> {
            let own = lost.iter().map(|lost| lost.start.max(span.start)..lost.end.min(span.end));
            let own = own.filter(|lost| !lost.is_empty());
            own.map(|lost| lost.start - span.start..lost.end - span.start).collect()
        };
        let lost_rows = whole.lost_rows.iter().map(|(at, lost)| (*at, lost_in(lost)));
        let table = Table {
            rows: span.len(),
            columns: columns.collect(),
            unread: whole.unread.clone(),
            lost_rows: lost_rows.filter(|(_, lost)| !lost.is_empty()).collect(),
            losses,
            ..Table::default()
        };
        (number.to_string(), table)
    };
    // Report losses of the file once, with the first episode.
    let mut losses = Some(whole.losses.clone());
    Ok(spans.into_iter().map(|span| of(span, losses.take().unwrap_or_default())).collect())
}

/// NaN if missing.
struct LeafValues {
    is_list: bool,
    /// Definition levels of a number and of a list element.
    defined: i16,
    element: i16,
    /// Row range within the file.
    rows: Range<usize>,
    values: Vec<f64>,
    /// Values per row of a list.
    lengths: Vec<u32>,
    /// Lost rows relative to the start of `rows`.
    lost: Vec<Range<usize>>,
    why: Option<TableError>,
}

impl LeafValues {
    fn new(reader: &ParquetFile, at: usize, rows: Range<usize>) -> Self {
        let column = reader.metadata.file_metadata().schema_descr_ptr().column(at);
        let defined = column.max_def_level();
        let is_list = column.max_rep_level() == 1;
        let element = defined - i16::from(column.self_type().is_optional());
        let (values, lengths, lost) = (Vec::new(), Vec::new(), Vec::new());
        Self { is_list, defined, element, rows, values, lengths, lost, why: None }
    }

    fn count(&self) -> usize {
        if self.is_list { self.lengths.len() } else { self.values.len() }
    }

    /// Reads all row groups that overlap the rows.
    fn read(
        &mut self,
        reader: &ParquetFile,
        at: usize,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let mut first = 0_usize;
        for (group, count) in reader.groups().enumerate() {
            let end = first.saturating_add(count);
            let own = self.rows.start.max(first)..self.rows.end.min(end);
            if !own.is_empty() {
                let rows = own.start - first..own.end - first;
                let before = self.values.len();
                if read_ahead::append_rows(reader, (group, at), &rows, self) {
                    memory.reserve(self.values.len() - before)?;
                } else {
                    self.decode(reader, (group, at), rows, memory)?;
                }
            }
            first = end;
        }
        Ok(())
    }

    /// Appends rows of a row group. Lost rows are NaN.
    fn decode(
        &mut self,
        reader: &ParquetFile,
        (group, at): (usize, usize),
        rows: Range<usize>,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let begin = self.count();
        let decode = || {
            let (column, damaged) = reader.column(group, at, memory)?;
            self.column(column, rows.clone(), &damaged, memory)
        };
        // Damaged levels and indices overflow in the decoder, which panics in builds that check it.
        let read = catch_panic(decode)
            .unwrap_or_else(|what| Err(format!("its decoder failed: {what}").into()));
        match read {
            // The memory limit ends the reading.
            Err(refusal @ TableError::Memory(_)) => Err(refusal),
            read => self.complete_row_group(begin, rows.len(), read.err(), memory),
        }
    }

    /// Appends decoded rows of `other`.
    fn append_from(&mut self, other: &Self, rows: Range<usize>) {
        if !self.is_list {
            return self.values.extend_from_slice(&other.values[rows]);
        }
        let count = |lengths: &[u32]| lengths.iter().map(|length| *length as usize).sum::<usize>();
        let (start, lengths) = (count(&other.lengths[..rows.start]), &other.lengths[rows]);
        self.values.extend_from_slice(&other.values[start..start + count(lengths)]);
        self.lengths.extend_from_slice(lengths);
    }

    fn complete_row_group(
        &mut self,
        begin: usize,
        rows: usize,
        why: Option<TableError>,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let read = self.count() - begin;
        if read < rows {
            memory.reserve(rows - read)?;
            self.lost.push(begin + read..begin + rows);
            self.why = self
                .why
                .take()
                .or(why)
                .or_else(|| Some("a row group has fewer rows than it declares".into()));
            match self.is_list {
                true => self.lengths.resize(begin + rows, 0),
                false => self.values.resize(begin + rows, f64::NAN),
            }
        }
        Ok(())
    }

    fn column(
        &mut self,
        column: ColumnReader,
        rows: Range<usize>,
        damaged: &SharedPageCounts,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let rest = (rows, damaged, memory);
        match column {
            ColumnReader::BoolColumnReader(column) => {
                self.append(column, rest, |value| f64::from(u8::from(value)))
            }
            ColumnReader::Int32ColumnReader(column) => self.append(column, rest, f64::from),
            ColumnReader::Int64ColumnReader(column) => {
                self.append(column, rest, |value| value as f64)
            }
            ColumnReader::FloatColumnReader(column) => self.append(column, rest, f64::from),
            ColumnReader::DoubleColumnReader(column) => self.append(column, rest, |value| value),
            _ => Err("its type is not numeric".into()),
        }
    }

    fn append<T: DataType>(
        &mut self,
        mut column: ColumnReaderImpl<T>,
        (rows, damaged, memory): (Range<usize>, &SharedPageCounts, &mut MemoryBudget),
        number: impl Fn(T::T) -> f64,
    ) -> Result<(), TableError> {
        let (mut found, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
        let begin = (self.count(), self.values.len());
        column.skip_records(rows.start).map_err(|error| read_error(&error))?;
        let mut remaining = rows.len();
        let mut read = Ok(());
        while remaining > 0 {
            found.clear();
            definitions.clear();
            repetitions.clear();
            let most = BATCH_ROWS.min(remaining);
            let records = column.read_records(
                most,
                Some(&mut definitions),
                Some(&mut repetitions),
                &mut found,
            );
            let (records, levels) = match records {
                Ok((0, ..)) => break,
                Ok((records, _, levels)) => (records, levels),
                Err(error) => {
                    read = Err(read_error(&error));
                    break;
                }
            };
            remaining -= records.min(remaining);
            memory.reserve(levels)?;
            let is_all = definitions.is_empty() || found.len() == levels;
            let mut own = found.drain(..);
            for level in 0..levels {
                let defined = definitions.get(level).copied().unwrap_or(self.defined);
                if self.is_list && repetitions.get(level).is_none_or(|level| *level == 0) {
                    self.lengths.push(0);
                }
                // An empty or null list.
                if self.is_list && !is_all && defined < self.element {
                    continue;
                }
                let is_there = is_all || defined == self.defined;
                let value = if is_there { own.next() } else { None };
                self.values.push(value.map_or(f64::NAN, &number));
                if let (true, Some(length)) = (self.is_list, self.lengths.last_mut()) {
                    *length += 1;
                }
            }
        }
        self.insert_damaged(begin, rows.start, damaged)?;
        read
    }

    /// Inserts NaN rows in place of the unreadable pages. `begin` counts the rows and values before this
    /// row group, `skipped` the rows skipped at its start.
    fn insert_damaged(
        &mut self,
        begin: (usize, usize),
        skipped: usize,
        damaged: &SharedPageCounts,
    ) -> Result<(), TableError> {
        let found = std::mem::take(&mut *damaged.lock().unwrap_or_else(PoisonError::into_inner));
        let PageCounts { values, declared, damaged } = found;
        let Some((_, _, what)) = damaged.first() else { return Ok(()) };
        self.why.get_or_insert_with(|| what.clone().into());
        // Lost rows cannot be located if rows were skipped, pages split rows, or the number of values is
        // not the declared one.
        let width = match self.is_list {
            true => most_frequent(self.lengths[begin.0..].iter().map(|length| *length as usize)),
            false => 1,
        };
        let is_even = width > 0
            && damaged
                .iter()
                .all(|(at, own, _)| at.is_multiple_of(width) && own.is_multiple_of(width))
            && (!self.is_list || self.lengths[begin.0..].iter().all(|own| *own as usize == width));
        if skipped > 0 || values != declared || !is_even {
            self.values.truncate(begin.1);
            self.lengths.truncate(if self.is_list { begin.0 } else { 0 });
            return Err(what.as_str().into());
        }
        for (at, own, _) in &damaged {
            let (row, rows) = (begin.0 + at / width, own / width);
            if row > self.count() {
                return Err("pages are missing".into());
            }
            self.lost.push(row..row + rows);
            match self.is_list {
                true => _ = self.lengths.splice(row..row, std::iter::repeat_n(0, rows)),
                false => _ = self.values.splice(row..row, std::iter::repeat_n(f64::NAN, rows)),
            }
        }
        Ok(())
    }

    /// Returns the column's name if its lists differ in length.
    fn into_column(self, column: Column) -> Result<ReadColumn, String> {
        let Self { is_list, rows, values, lengths, mut lost, mut why, .. } = self;
        if !is_list {
            let column = Column { width: 1, values, ..column };
            return Ok(ReadColumn { column, rows: rows.len(), lost, why });
        }
        let there = lengths.iter().filter(|length| **length > 0).map(|length| *length as usize);
        let width = most_frequent(there);
        let others = |length: &&u32| **length as usize != width && **length > 0;
        // Lists of varying lengths, such as point clouds.
        if width == 0
            || width > MAX_WIDTH
            || 2 * lengths.iter().filter(others).count() >= lengths.len()
        {
            return Err(column.name);
        }
        // With many empty lists, the table has other streams; nothing is lost.
        const MIN_EMPTY_PERCENT: usize = 25;
        let empty = lengths.iter().filter(|length| **length == 0).count();
        let is_sparse = 100 * empty >= MIN_EMPTY_PERCENT * lengths.len();
        let mut whole = Vec::with_capacity(width * lengths.len());
        let mut at = 0;
        for (row, length) in lengths.iter().enumerate() {
            let own = &values[at..at + *length as usize];
            at += *length as usize;
            if own.len() == width {
                whole.extend_from_slice(own);
                continue;
            }
            whole.resize(whole.len() + width, f64::NAN);
            if own.is_empty() && is_sparse {
                continue;
            }
            match lost.last_mut().filter(|last| last.end == row) {
                Some(last) => last.end = row + 1,
                None => lost.push(row..row + 1),
            }
            if why.is_none() {
                let what = if own.is_empty() {
                    "no numbers".to_owned()
                } else {
                    format!("{} numbers, not {width}", own.len())
                };
                why = Some(format!("row {row} has {what}").into());
            }
        }
        let column = Column { width, values: whole, ..column };
        Ok(ReadColumn { column, rows: rows.len(), lost, why })
    }
}

fn read_error(error: &ParquetError) -> TableError {
    format!("the Parquet file cannot be read: {}", first_line(error)).into()
}
