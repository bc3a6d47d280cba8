//! Zarr stores, of the second version and of the third: folders, and zip archives of them. Arrays of as many
//! rows are one table; `meta/episode_ends` of diffusion policy's replay buffers says where its episodes end.

mod array;
mod blosc;
mod codec;
mod store;

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use self::array::Array;
use self::store::Store;
use super::{Column, Episodes, MOST_NUMBERS, Refusal, Table, rate_in, usual};
use crate::Extent;
use crate::losses::Losses;

#[cfg(test)]
pub(crate) use self::blosc::unpacked as unpacked_blosc;
pub use self::store::is_store;
pub(crate) use self::store::is_zip_store;

/// The array of where each episode ends.
const ENDS: &str = "episode_ends";
/// The group of the arrays, which is no part of their names.
const DATA: &str = "data/";

/// A store, in a folder or in the bytes of an archive.
#[derive(Clone, Copy)]
pub(super) enum At<'a> {
    Folder(&'a Path),
    Bytes(&'a [u8]),
}

/// The arrays of a store that are read, and its episodes.
struct Contents<'a> {
    store: Store<'a>,
    arrays: Vec<Array>,
    /// Why the first array of numbers that is not read is not.
    refused: Option<Refusal>,
    episodes: Vec<Range<usize>>,
}

/// The episodes of a store; the only one that is `wanted`, if one is.
pub(super) fn read(at: At, wanted: Option<&str>, losses: &mut Losses) -> Result<Episodes, Refusal> {
    let Contents { mut store, arrays, refused, episodes } = opened(at)?;
    if let Some(what) = refused {
        losses.add_unplaced(Extent::Messages, None, what);
    }
    let mut groups = vec![String::new(), DATA.trim_end_matches('/').to_owned()];
    groups.extend(arrays.iter().map(|array| array.path.clone()));
    let rate_hz = groups.iter().find_map(|path| rate_in(&store.attributes(path)?));
    let mut budget = MOST_NUMBERS;
    let mut found = Vec::new();
    for (number, span) in episodes.into_iter().enumerate() {
        let name = number.to_string();
        if wanted.is_some_and(|wanted| wanted != name) {
            continue;
        }
        let mut columns = Vec::new();
        for array in &arrays {
            let width = array.width().unwrap_or(1);
            budget = budget
                .checked_sub(span.len().saturating_mul(width))
                .ok_or_else(|| format!("it has more than {MOST_NUMBERS} numbers"))?;
            columns.push(Column {
                name: match array.path.strip_prefix(DATA).unwrap_or(&array.path) {
                    "" => "array".to_owned(),
                    path => path.to_owned(),
                },
                kind: array.kind(),
                width,
                parts: Vec::new(),
                values: array.read(&mut store, span.clone())?,
            });
        }
        found.push((name, Table { rows: span.len(), columns, rate_hz, ..Table::default() }));
    }
    Ok(found)
}

/// The files in a folder that its tables are read from.
pub fn files_of_store(folder: &Path) -> Vec<PathBuf> {
    let arrays = opened(At::Folder(folder)).map(|contents| contents.arrays).unwrap_or_default();
    let mut open: Vec<PathBuf> = arrays.iter().map(|array| folder.join(&array.path)).collect();
    open.push(folder.join("meta").join(ENDS));
    let mut found = Vec::new();
    while let Some(path) = open.pop() {
        let inside = fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
        for entry in inside {
            let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
            if is_folder { &mut open } else { &mut found }.push(entry.path());
        }
    }
    found.sort();
    found
}

/// The names of the episodes of a store.
pub(super) fn episodes_in(at: At) -> Result<Vec<String>, Refusal> {
    Ok((0..opened(at)?.episodes.len()).map(|number| number.to_string()).collect())
}

fn opened(at: At) -> Result<Contents, Refusal> {
    let mut store = match at {
        At::Folder(path) => Store::Folder(path.to_owned()),
        At::Bytes(bytes) => Store::zip(bytes)?,
    };
    let (mut arrays, mut ends, mut refused) = (Vec::new(), None, None);
    for (path, metadata) in store.arrays() {
        match Array::of(&path, &metadata) {
            Some(Ok(array)) if path.rsplit('/').next() == Some(ENDS) => ends = Some(array),
            Some(Ok(array)) if array.width().is_some() => arrays.push(array),
            Some(Err(what)) => _ = refused.get_or_insert(what),
            _ => {}
        }
    }
    let ends = ends.map(|ends| ends.read(&mut store, 0..ends.rows())).transpose()?;
    let rows = match ends.as_ref().and_then(|ends| ends.last()) {
        Some(last) => *last as usize,
        None => usual(arrays.iter().map(Array::rows)),
    };
    arrays.retain(|array| array.rows() >= rows && (array.rows() == rows || ends.is_some()));
    if arrays.is_empty() || rows == 0 {
        return Err(refused
            .unwrap_or_else(|| "it holds no arrays of numbers, as many rows each".to_owned()));
    }
    Ok(Contents { store, arrays, refused, episodes: episodes(ends.as_deref(), rows)? })
}

/// The rows of each episode.
fn episodes(ends: Option<&[f64]>, rows: usize) -> Result<Vec<Range<usize>>, Refusal> {
    let whole = [rows as f64];
    let mut first = 0;
    let mut span = |end: &f64| {
        let span = first..*end as usize;
        first = span.end;
        let is_sound = span.start < span.end && span.end <= rows;
        is_sound.then_some(span).ok_or_else(|| format!("'{ENDS}' does not rise"))
    };
    ends.unwrap_or(&whole).iter().map(&mut span).collect()
}
