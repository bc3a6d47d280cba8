//! HDF5 as h5py writes it: numeric data sets, named by path. Groups that contain one episode each
//! (`data/demo_0` of robomimic and LIBERO) become separate tables.

use std::collections::HashSet;

use ::bytes::Bytes;
use hdf5_reader::group::Group;
use hdf5_reader::{
    Attribute, ByteOrder, Dataset, Datatype, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem,
};

use super::chunks::{ChunkAssembly, ChunkGrid, checked_product};
use super::npy;
use super::row_losses::may_be_clock;
use super::{
    Column, Episodes, MAX_COLUMNS, MAX_DEPTH, MAX_EPISODES, MAX_METADATA_BYTES, MAX_WIDTH,
    ReadColumn, ReadContext, RowLoss, Table, TableError, first_line, is_transposed,
    most_frequent_rows, names, rate_by_name, rate_in, row_counts,
};
use crate::memory_budget::MemoryBudget;

pub(crate) const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
const MAX_GROUPS: usize = 10_000;
/// For unchunked data sets that cannot be read whole.
const FALLBACK_PARTS: usize = 64;
/// Limit per group or data set.
const MAX_HEADER_BYTES: usize = 4 << 20;
const EPISODE_PREFIXES: &[&str] = &[
    "demo", "episode", "ep", "traj", "trajectory", "trial", "run", "rollout", "take", "recording",
    "session", "experiment", "repetition", "attempt",
];
/// Groups of episodes.
const PERSON_PREFIXES: &[&str] =
    &["user", "subject", "participant", "person", "operator", "demonstrator"];

pub(super) fn read(
    bytes: Bytes,
    wanted: Option<&str>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let (home, episodes, rate_hz) = open_file(bytes, context.memory.remaining())?;
    if wanted.is_none() && episodes.len() > MAX_EPISODES {
        return Err(TableError::Episodes);
    }
    let names = match episodes.is_empty() {
        true => vec![None],
        false => episodes.into_iter().map(Some).collect(),
    };
    let is_one = names.len() == 1;
    let mut found = Vec::new();
    for name in names {
        let label = name.clone().unwrap_or_else(|| "0".to_owned());
        if wanted.is_some_and(|wanted| *wanted != label) {
            continue;
        }
        let mut parts = name.iter().flat_map(|name| name.split('/'));
        let group = parts.try_fold(home.clone(), |group, part| group.group(part));
        let group = match group {
            Ok(group) => group,
            Err(error) if is_one => return Err(read_error(&error)),
            Err(error) => {
                read_error(&error).in_part(&label).report(None, context.losses);
                continue;
            }
        };
        let mut walk = GroupWalk::default();
        walk.descend(&group, "", 0);
        let mut tables = walk.tables(context.memory);
        tables[0].rate_hz = rate_of(&group).or(rate_hz);
        found.extend(tables.into_iter().map(|table| (label.clone(), table)));
    }
    Ok(found)
}

pub(super) fn episodes_in(bytes: Bytes) -> Result<Vec<String>, TableError> {
    open_file(bytes, MAX_METADATA_BYTES).map(|(_, episodes, _)| episodes)
}

/// Returns the group of the episodes, their names and the declared rate. Data sets of more than `most`
/// bytes are not read.
fn open_file(bytes: Bytes, most: u64) -> Result<(Group, Vec<String>, Option<f64>), TableError> {
    let most = usize::try_from(most).unwrap_or(usize::MAX);
    let options = OpenOptions::default()
        .with_max_read_bytes(most)
        .with_max_chunk_bytes(most.min(1 << 30))
        .with_max_object_header_bytes(MAX_HEADER_BYTES);
    let file = Hdf5File::from_owner(bytes, options).map_err(|error| read_error(&error))?;
    let root = file.root_group().map_err(|error| read_error(&error))?;
    let rate_hz = rate_of(&root);
    let episodes = episode_groups(&root);
    if let (true, Ok(data)) = (episodes.is_empty(), root.group("data")) {
        let own = episode_groups(&data);
        if !own.is_empty() {
            let rate_hz = rate_hz.or_else(|| rate_of(&data));
            return Ok((data, own, rate_hz));
        }
    }
    Ok((root, episodes, rate_hz))
}

/// Sorted by number. Episodes in groups of people have both names: `user1/demo2`.
fn episode_groups(group: &Group) -> Vec<String> {
    let own = numbered_groups(group, EPISODE_PREFIXES);
    if !own.is_empty() {
        return own;
    }
    let of_person = |person: String| {
        let episodes = group.group(&person).map(|inner| numbered_groups(&inner, EPISODE_PREFIXES));
        let episodes = episodes.unwrap_or_default().into_iter();
        episodes.map(move |episode| format!("{person}/{episode}"))
    };
    numbered_groups(group, PERSON_PREFIXES).into_iter().flat_map(of_person).collect()
}

/// Groups whose names are one of these words and a number.
fn numbered_groups(group: &Group, prefixes: &[&str]) -> Vec<String> {
    let Ok((groups, _)) = group.member_names() else { return Vec::new() };
    let numbered = groups.into_iter().filter_map(|name| {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        let stem = name[..name.len() - digits.len()].trim_end_matches(['_', '-']).to_lowercase();
        let number: u64 = digits.parse().ok()?;
        (stem.is_empty() || prefixes.contains(&stem.as_str())).then_some((number, name))
    });
    let mut numbered: Vec<(u64, String)> = numbered.collect();
    numbered.sort();
    numbered.into_iter().map(|(_, name)| name).collect()
}

#[derive(Default)]
struct GroupWalk {
    /// Data sets by path.
    found: Vec<(String, Dataset)>,
    /// Addresses; links may form cycles.
    visited: HashSet<u64>,
    losses: Vec<RowLoss>,
}

impl GroupWalk {
    fn descend(&mut self, group: &Group, path: &str, depth: usize) {
        if self.visited.len() >= MAX_GROUPS || !self.visited.insert(group.address()) {
            return;
        }
        let (groups, datasets) = match group.members() {
            Ok(members) => members,
            Err(error) => {
                let what = read_error(&error).in_part(&format!("/{path}"));
                self.losses.push(RowLoss { rows: 0, what });
                return;
            }
        };
        let below = |name: &str| {
            let name = name.rsplit('/').next().unwrap_or(name);
            if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
        };
        for dataset in datasets {
            if self.found.len() == MAX_COLUMNS {
                let what = format!("more than {MAX_COLUMNS} data sets; the others are not read");
                self.losses.push(RowLoss { rows: 0, what: what.into() });
                return;
            }
            let name = below(dataset.name());
            self.found.push((name, dataset));
        }
        if depth < MAX_DEPTH {
            // MATLAB's objects.
            let own =
                |group: &Group| !group.name().rsplit('/').next().unwrap_or("").starts_with('#');
            for group in groups.into_iter().filter(own) {
                self.descend(&group, &below(group.name()), depth + 1);
            }
        }
    }

    /// See [`Table::by_row_count`].
    fn tables(self, memory: &mut MemoryBudget) -> Vec<Table> {
        let sides = |dataset: &Dataset| -> Vec<usize> {
            dataset
                .shape()
                .iter()
                .map(|side| usize::try_from(*side).unwrap_or(usize::MAX))
                .collect()
        };
        let numeric =
            self.found.iter().filter(|(_, dataset)| number_type(dataset.dtype()).is_some());
        let shapes: Vec<Vec<usize>> = numeric.map(|(_, dataset)| sides(dataset)).collect();
        let common = row_counts(&shapes);
        let arrays: Vec<DataSetColumn> = self
            .found
            .iter()
            .filter_map(|(name, dataset)| {
                let is_on_side = is_transposed(&sides(dataset), &common);
                DataSetColumn::new(name, dataset, sides(dataset), is_on_side)
            })
            .collect();
        let main = most_frequent_rows(arrays.iter().map(|array| array.rows));
        let with_clock = arrays.iter().filter(|array| may_be_clock(array.column.width));
        let clocks: HashSet<usize> = with_clock.map(|array| array.rows).collect();
        let mut read = |array: DataSetColumn| {
            // Data sets with another number of rows are columns only of a table with a clock.
            let is_read = array.rows == main || clocks.contains(&array.rows);
            if is_read { array.read(memory) } else { array.unread() }
        };
        let candidates = arrays.into_iter().map(&mut read).collect();
        let mut tables = Table::by_row_count(candidates, memory);
        tables[0].losses.extend(self.losses);
        tables
    }
}

/// One row per instant, or one column if transposed.
struct DataSetColumn<'a> {
    dataset: &'a Dataset,
    column: Column,
    shape: Vec<usize>,
    rows: usize,
    is_on_side: bool,
}

impl<'a> DataSetColumn<'a> {
    /// `None` for images and data sets without numbers.
    fn new(name: &str, dataset: &'a Dataset, shape: Vec<usize>, is_on_side: bool) -> Option<Self> {
        let kind = number_type(dataset.dtype())?;
        let mut sides = shape.clone();
        if is_on_side {
            sides.reverse();
        }
        let [rows, inner @ ..] = sides.as_slice() else { return None };
        // Integers in more than two dimensions are images.
        if inner.len() > 1 && !kind.starts_with("float") {
            return None;
        }
        let width = checked_product(inner).filter(|width| (1..=MAX_WIDTH).contains(width))?;
        rows.checked_mul(width).filter(|count| *count > 0)?;
        let column = Column { name: name.to_owned(), kind, width, ..Column::default() };
        Some(Self { dataset, column, shape, rows: *rows, is_on_side })
    }

    fn unread(self) -> ReadColumn {
        ReadColumn { column: self.column, rows: self.rows, ..ReadColumn::default() }
    }

    fn read(self, memory: &mut MemoryBudget) -> ReadColumn {
        let (rows, width) = (self.rows, self.column.width);
        if let Err(refusal) = memory.reserve(rows * width) {
            return ReadColumn::unreadable(&self.column.name, rows, refusal.into());
        }
        let grid = (!self.is_on_side).then(|| self.grid()).flatten();
        if let Some(grid) = grid {
            return self.read_chunked(&grid);
        }
        match values(self.dataset) {
            Ok(mut values) => {
                if self.is_on_side {
                    let turned = (0..rows * width).map(|at| values[at % width * rows + at / width]);
                    values = turned.collect();
                }
                ReadColumn {
                    column: Column { values, ..self.column },
                    rows,
                    ..ReadColumn::default()
                }
            }
            Err(error) if self.is_on_side => {
                ReadColumn::unreadable(&self.column.name, rows, read_error(&error))
            }
            Err(error) => self.read_by_parts(read_error(&error)),
        }
    }

    /// `None` if unchunked.
    fn grid(&self) -> Option<ChunkGrid> {
        let chunks = self.dataset.chunks()?;
        let chunks: Vec<usize> = chunks.iter().map(|side| *side as usize).collect();
        let kind = element_type(self.dataset.dtype())?;
        let is_sound = chunks.len() == self.shape.len() && !chunks.contains(&0);
        let value = self.dataset.fill_value().and_then(|fill| fill.value.as_deref());
        let fill =
            value.filter(|value| value.len() == kind.size()).map_or(0.0, |value| kind.read(value));
        let shape = self.shape.clone();
        is_sound.then_some(ChunkGrid { shape, chunks, kind, fill, is_fortran: false })
    }

    fn read_chunked(self, grid: &ChunkGrid) -> ReadColumn {
        let rows = self.rows;
        let chunks = match self.dataset.iter_chunks() {
            Ok(chunks) => chunks,
            Err(error) => {
                return ReadColumn::unreadable(&self.column.name, rows, read_error(&error));
            }
        };
        let mut all = ChunkAssembly::new(grid, 0..rows);
        let mut failed = None;
        for chunk in chunks {
            match chunk {
                Ok(chunk) => {
                    let place = chunk.offsets().iter().zip(&grid.chunks);
                    let place: Vec<usize> = place.map(|(at, side)| *at as usize / side).collect();
                    all.add_chunk(&place, Ok(Some(chunk.bytes().to_vec())));
                }
                Err(error) => _ = failed.get_or_insert_with(|| read_error(&error)),
            }
        }
        if let Some(why) = failed {
            all.mark_absent_damaged(why);
        }
        let read = all.finish(names::is_joints_or_pose(&self.column.name));
        let column = Column { values: read.values, ..self.column };
        ReadColumn { column, rows, lost: read.lost, why: read.why }
    }

    /// Called after reading the whole failed because of `why`.
    fn read_by_parts(self, why: TableError) -> ReadColumn {
        let (rows, width) = (self.rows, self.column.width);
        let mut values = vec![f64::NAN; rows * width];
        let mut lost = Vec::new();
        let deep = rows.div_ceil(FALLBACK_PARTS).max(1);
        for start in (0..rows).step_by(deep) {
            let part = start..rows.min(start + deep);
            let whole =
                |side: &usize| SliceInfoElem::Slice { start: 0, end: *side as u64, step: 1 };
            let mut selections: Vec<SliceInfoElem> = self.shape.iter().map(whole).collect();
            selections[0] =
                SliceInfoElem::Slice { start: part.start as u64, end: part.end as u64, step: 1 };
            match slice(self.dataset, &SliceInfo { selections }) {
                Ok(own) if own.len() == part.len() * width => {
                    values[part.start * width..part.end * width].copy_from_slice(&own);
                }
                _ => lost.push(part),
            }
        }
        ReadColumn { column: Column { values, ..self.column }, rows, lost, why: Some(why) }
    }
}

fn values(dataset: &Dataset) -> Result<Vec<f64>, hdf5_reader::error::Error> {
    let all = dataset.shape().iter();
    let whole = |side: &u64| SliceInfoElem::Slice { start: 0, end: *side, step: 1 };
    slice(dataset, &SliceInfo { selections: all.map(whole).collect() })
}

fn slice(dataset: &Dataset, part: &SliceInfo) -> Result<Vec<f64>, hdf5_reader::error::Error> {
    macro_rules! read {
        ($kind:ty) => {
            dataset
                .read_slice::<$kind>(part)
                .map(|array| array.into_iter().map(|value| value as f64).collect())
        };
    }
    match dataset.dtype() {
        Datatype::FloatingPoint { size: 4, .. } => read!(f32),
        Datatype::FixedPoint { size: 1, signed: true, .. } => read!(i8),
        Datatype::FixedPoint { size: 1, signed: false, .. } => read!(u8),
        Datatype::FixedPoint { size: 2, signed: true, .. } => read!(i16),
        Datatype::FixedPoint { size: 2, signed: false, .. } => read!(u16),
        Datatype::FixedPoint { size: 4, signed: true, .. } => read!(i32),
        Datatype::FixedPoint { size: 4, signed: false, .. } => read!(u32),
        Datatype::FixedPoint { size: 8, signed: true, .. } => read!(i64),
        Datatype::FixedPoint { size: 8, signed: false, .. } => read!(u64),
        _ => read!(f64),
    }
}

/// `None` if not numeric.
fn element_type(datatype: &Datatype) -> Option<npy::ElementType> {
    let (letter, size, order) = match datatype {
        Datatype::FloatingPoint { size, byte_order, .. } => ('f', size, byte_order),
        Datatype::FixedPoint { size, signed: true, byte_order, .. } => ('i', size, byte_order),
        Datatype::FixedPoint { size, signed: false, byte_order, .. } => ('u', size, byte_order),
        _ => return None,
    };
    let order = if matches!(order, ByteOrder::BigEndian) { '>' } else { '<' };
    npy::ElementType::parse(&format!("{order}{letter}{size}"))
}

/// Name of the type. `None` if not numeric, and for half floats, which are not read.
fn number_type(datatype: &Datatype) -> Option<String> {
    let kind = element_type(datatype)?;
    (!kind.is_float() || kind.size() > 2).then(|| kind.name())
}

/// robomimic writes it in `env_args`.
fn rate_of(group: &Group) -> Option<f64> {
    let attributes = group.attributes().ok()?;
    let plain =
        |attribute: &Attribute| rate_by_name(&attribute.name, attribute.read_as_f64().ok()?);
    let in_text = |attribute: &Attribute| {
        let text =
            (attribute.name == "env_args").then(|| attribute.read_string().ok()).flatten()?;
        if text.len() as u64 > MAX_METADATA_BYTES {
            return None;
        }
        rate_in(&serde_json::from_str(&text).ok()?)
    };
    attributes.iter().find_map(plain).or_else(|| attributes.iter().find_map(in_text))
}

fn read_error(error: &hdf5_reader::error::Error) -> TableError {
    let line = first_line(error);
    // LZF of h5py, or filters from plugins.
    let advice = if line.contains("unsupported filter") { "; write it with gzip" } else { "" };
    format!("the HDF5 file cannot be read: {line}{advice}").into()
}
