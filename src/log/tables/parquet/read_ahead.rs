//! Decodes the rows after an episode together with it, because a fleet reads the episodes of a file in order.
//! Otherwise each episode decodes the rows before it again, to skip them.

use std::collections::HashMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::SystemTime;

use ::parquet::file::metadata::ParquetMetaData;

use super::{LeafValues, ParquetFile};
use crate::memory_budget::MemoryBudget;

/// Rows decoded at once.
const WINDOW_ROWS: usize = 1 << 16;
/// Limit of all windows, 64 MiB.
const MAX_NUMBERS: usize = 1 << 23;

/// Identifies the content of a file on disk.
#[derive(Clone, PartialEq)]
pub(super) struct FileState {
    path: PathBuf,
    bytes: u64,
    modified: SystemTime,
}

impl FileState {
    pub fn read(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        let modified = metadata.modified().ok()?;
        Some(Self { path: path.to_owned(), bytes: metadata.len(), modified })
    }
}

/// The row group that was read last.
pub(super) struct LastGroup {
    file: FileState,
    metadata: Arc<ParquetMetaData>,
    group: usize,
    /// Spans of equal episode numbers, in rows of the group.
    episodes: Option<Vec<(f64, Range<usize>)>>,
    leaves: HashMap<usize, Leaf>,
    /// In all windows.
    numbers: usize,
}

enum Leaf {
    /// Read once, up to this row: the next episode may follow.
    ReadTo(usize),
    /// Rows from `first` on.
    Window { first: usize, values: LeafValues },
    /// Damaged or too large.
    Unusable,
}

static LAST_GROUP: Mutex<Option<LastGroup>> = Mutex::new(None);

/// `None` without a file on disk, or while another thread reads.
fn last_group(
    reader: &ParquetFile,
    group: usize,
) -> Option<MutexGuard<'static, Option<LastGroup>>> {
    let file = reader.state.as_ref()?;
    let mut last = match LAST_GROUP.try_lock() {
        Ok(last) => last,
        Err(TryLockError::Poisoned(last)) => last.into_inner(),
        Err(TryLockError::WouldBlock) => return None,
    };
    let is_it = |last: &LastGroup| {
        last.group == group && last.file == *file && Arc::ptr_eq(&last.metadata, &reader.metadata)
    };
    if !last.as_ref().is_some_and(is_it) {
        *last = Some(LastGroup {
            file: file.clone(),
            metadata: Arc::clone(&reader.metadata),
            group,
            episodes: None,
            leaves: HashMap::new(),
            numbers: 0,
        });
    }
    Some(last)
}

/// Spans of the group, if known.
pub(super) fn episodes(reader: &ParquetFile, group: usize) -> Option<Vec<(f64, Range<usize>)>> {
    last_group(reader, group)?.as_ref()?.episodes.clone()
}

pub(super) fn keep_episodes(reader: &ParquetFile, group: usize, episodes: &[(f64, Range<usize>)]) {
    if let Some(last) = last_group(reader, group).as_mut().and_then(|last| last.as_mut()) {
        last.episodes = Some(episodes.to_vec());
    }
}

/// Appends rows of a group to `leaf`. Returns false if they must be decoded: the first rows of a leaf, earlier
/// rows than before, and rows of a damaged or large one.
pub(super) fn append_rows(
    reader: &ParquetFile,
    (group, at): (usize, usize),
    rows: &Range<usize>,
    leaf: &mut LeafValues,
) -> bool {
    let Some(mut last) = last_group(reader, group) else { return false };
    let Some(last) = last.as_mut() else { return false };
    let follows = match last.leaves.get(&at) {
        None => false,
        Some(Leaf::Unusable) => return false,
        Some(Leaf::ReadTo(end)) => *end <= rows.start,
        Some(Leaf::Window { first, values }) => {
            let end = first + values.count();
            if *first <= rows.start && rows.end <= end {
                leaf.append_from(values, rows.start - first..rows.end - first);
                return true;
            }
            *first <= rows.start
        }
    };
    if let Some(Leaf::Window { values, .. }) = last.leaves.insert(at, Leaf::ReadTo(rows.end)) {
        last.numbers -= values.values.len();
    }
    let count = reader.groups().nth(group).unwrap_or(0);
    let end = count.min(rows.start + WINDOW_ROWS);
    if !follows || rows.end > end {
        return false;
    }
    let values = window(reader, (group, at), rows.start..end, MAX_NUMBERS - last.numbers);
    let is_read = values.is_some();
    let new = values.map_or(Leaf::Unusable, |values| {
        last.numbers += values.values.len();
        leaf.append_from(&values, 0..rows.len());
        Leaf::Window { first: rows.start, values }
    });
    last.leaves.insert(at, new);
    is_read
}

/// `None` if a row is lost, or if there are more than `limit` numbers.
fn window(
    reader: &ParquetFile,
    (group, at): (usize, usize),
    rows: Range<usize>,
    limit: usize,
) -> Option<LeafValues> {
    let mut values = LeafValues::new(reader, at, rows.clone());
    let mut memory = MemoryBudget::with_limit((limit as u64).saturating_mul(8));
    values.decode(reader, (group, at), rows.clone(), &mut memory).ok()?;
    let is_whole = values.count() == rows.len() && values.lost.is_empty() && values.why.is_none();
    is_whole.then_some(values)
}
