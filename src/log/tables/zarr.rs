//! Zarr stores, versions 2 and 3: folders and zip archives. Arrays with the same number of rows form one
//! table. `meta/episode_ends`, from the replay buffers of diffusion policy, marks the end of each episode.

mod array;
mod blosc;
mod codec;
mod store;

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use self::array::ZarrArray;
use self::store::ZarrStore;
use super::{
    Column, Episodes, MAX_EPISODES, ReadColumn, ReadContext, Table, TableError, most_frequent_rows,
    rate_in,
};
use crate::containment::Containment;
use crate::memory_budget::MemoryBudget;

#[cfg(test)]
pub(crate) use self::blosc::unpack as unpacked_blosc;
pub use self::store::is_store;
pub(crate) use self::store::is_zip_store;

const EPISODE_ENDS: &str = "episode_ends";
/// Omitted from array names.
const DATA_PREFIX: &str = "data/";

#[derive(Clone, Copy)]
pub(super) enum StoreLocation<'a> {
    Folder(&'a Path),
    Bytes(&'a [u8]),
}

struct StoreContents<'a> {
    store: ZarrStore<'a>,
    arrays: Vec<ZarrArray>,
    refused: Vec<TableError>,
    has_ends: bool,
    episodes: Vec<Range<usize>>,
}

pub(super) fn read(
    at: StoreLocation,
    wanted: Option<&str>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let StoreContents { mut store, arrays, refused, has_ends, episodes } = open_store(at)?;
    for what in refused {
        what.report(None, context.losses);
    }
    if wanted.is_none() && episodes.len() > MAX_EPISODES {
        return Err(TableError::Episodes);
    }
    let mut groups = vec![String::new(), DATA_PREFIX.trim_end_matches('/').to_owned()];
    groups.extend(arrays.iter().map(|array| array.path.clone()));
    let rate_hz = groups.iter().find_map(|path| rate_in(&store.attributes(path)?));
    let mut found = Vec::new();
    for (number, span) in episodes.into_iter().enumerate() {
        let name = number.to_string();
        if wanted.is_some_and(|wanted| wanted != name) {
            continue;
        }
        let mut candidates = Vec::new();
        for array in &arrays {
            let column = Column {
                name: match array.path.strip_prefix(DATA_PREFIX).unwrap_or(&array.path) {
                    "" => "array".to_owned(),
                    path => path.to_owned(),
                },
                kind: array.kind(),
                width: array.width().unwrap_or(1),
                ..Column::default()
            };
            // With several episodes, a short array lacks the last rows.
            let declared = if has_ends { span.len() } else { array.rows() };
            if declared != span.len() {
                candidates.push(ReadColumn { column, rows: declared, ..ReadColumn::default() });
                continue;
            }
            let own = span.start.min(array.rows())..span.end.min(array.rows());
            candidates.push(match array.read(&mut store, own, context.memory) {
                Ok(read) => ReadColumn {
                    column: Column { values: read.values, ..column },
                    rows: declared,
                    lost: read.lost,
                    why: read.why,
                },
                Err(why) => ReadColumn::unreadable(&column.name, declared, why),
            });
        }
        let table =
            Table { rate_hz, ..Table::from_columns(candidates, Some(span.len()), context.memory) };
        found.push((name, table));
    }
    Ok(found)
}

/// Files that belong to the table.
pub fn store_files(folder: &Path) -> Vec<PathBuf> {
    let arrays = open_store(StoreLocation::Folder(folder))
        .map(|contents| contents.arrays)
        .unwrap_or_default();
    let mut open: Vec<PathBuf> = arrays.iter().map(|array| folder.join(&array.path)).collect();
    open.push(folder.join("meta").join(EPISODE_ENDS));
    let (mut found, mut contained) = (Vec::new(), Containment::new(folder));
    while let Some(path) = open.pop() {
        let inside = fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
        for entry in inside.filter(|entry| contained.holds(&entry.path())) {
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            if is_folder { &mut open } else { &mut found }.push(entry.path());
        }
    }
    found.sort();
    found
}

pub(super) fn episodes_in(at: StoreLocation) -> Result<Vec<String>, TableError> {
    Ok((0..open_store(at)?.episodes.len()).map(|number| number.to_string()).collect())
}

fn open_store(at: StoreLocation) -> Result<StoreContents, TableError> {
    let mut store = match at {
        StoreLocation::Folder(path) => ZarrStore::folder(path),
        StoreLocation::Bytes(bytes) => ZarrStore::zip(bytes)?,
    };
    let (mut arrays, mut ends, mut refused) = (Vec::new(), None, Vec::new());
    for (path, metadata) in store.arrays() {
        match metadata.map(|metadata| ZarrArray::from_metadata(&path, &metadata)) {
            Ok(Some(Ok(array))) if path.rsplit('/').next() == Some(EPISODE_ENDS) => {
                ends = Some(array)
            }
            Ok(Some(Ok(array))) if array.width().is_some() => arrays.push(array),
            Ok(Some(Err(what))) | Err(what) => refused.push(what),
            Ok(_) => {}
        }
    }
    let mut memory = MemoryBudget::new(None);
    let ends = ends.map(|ends| ends.read(&mut store, 0..ends.rows(), &mut memory)).transpose()?;
    if let Some(ends) = ends.as_ref().filter(|ends| !ends.lost.is_empty()) {
        let why = ends.why.clone();
        return Err(why.unwrap_or_else(|| "some chunks are missing".into()).in_part(EPISODE_ENDS));
    }
    let rows = match ends.as_ref().and_then(|ends| ends.values.last()) {
        Some(last) => *last as usize,
        None => most_frequent_rows(arrays.iter().map(ZarrArray::rows)),
    };
    // With episodes, shorter arrays cannot be aligned.
    arrays.retain(|array| ends.is_none() || array.rows() > rows / 2);
    if arrays.is_empty() || rows == 0 {
        let none = || "it contains no arrays of numbers with a common number of rows".into();
        return Err(refused.into_iter().next().unwrap_or_else(none));
    }
    let episodes = episode_spans(ends.as_ref().map(|ends| ends.values.as_slice()), rows)?;
    Ok(StoreContents { store, arrays, refused, has_ends: ends.is_some(), episodes })
}

fn episode_spans(ends: Option<&[f64]>, rows: usize) -> Result<Vec<Range<usize>>, TableError> {
    let whole = [rows as f64];
    let mut first = 0;
    let mut span = |end: &f64| {
        let span = first..*end as usize;
        first = span.end;
        let is_sound = span.start < span.end && span.end <= rows;
        is_sound.then_some(span).ok_or_else(|| format!("'{EPISODE_ENDS}' does not increase").into())
    };
    ends.unwrap_or(&whole).iter().map(&mut span).collect()
}
