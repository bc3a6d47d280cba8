use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::Duration;

use polars::prelude::{
    DataFrame, ParquetCompression, ParquetReader, ParquetWriter, PolarsError, SerReader,
};

use super::StoreError;

const SUFFIX: &str = ".parquet";

/// Followed by the level.
const MERGED_PREFIX: &str = "merged-";

/// Incomplete files: see [`crate::report::write_whole`].
const STAGED_PREFIX: &str = ".poseaudit-";

/// Age of abandoned incomplete files.
const MAX_STAGED_AGE: Duration = Duration::from_secs(3600);

/// Scans of a folder during concurrent merges.
pub const MAX_TRIES: usize = 5;

pub fn file_name(key: &str) -> String {
    format!("{key}{SUFFIX}")
}

pub fn merged_file_name(level: u32, keys: &str) -> String {
    format!("{MERGED_PREFIX}{level}-{keys}{SUFFIX}")
}

/// Hash independent of the order.
pub fn combined_hash<'a>(keys: impl IntoIterator<Item = &'a str>) -> String {
    let mut keys: Vec<&str> = keys.into_iter().collect();
    keys.sort_unstable();
    blake3::hash(keys.join("\n").as_bytes()).to_hex()[..32].to_owned()
}

/// 0 for a single log.
pub fn level(path: &Path) -> u32 {
    let level =
        || path.file_stem()?.to_str()?.strip_prefix(MERGED_PREFIX)?.split('-').next()?.parse().ok();
    level().unwrap_or(0)
}

/// Key, if the part is of a single log.
pub fn key(path: &Path) -> Option<&str> {
    path.file_stem()?.to_str().filter(|_| level(path) == 0)
}

/// Complete files, sorted by name.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>, StoreError> {
    let fault = |source| StoreError::File { path: folder.to_owned(), source };
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(fault)?,
    };
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(fault)?.path();
        let is_part = |name: &str| name.ends_with(SUFFIX) && !name.starts_with('.');
        if path.file_name().and_then(|name| name.to_str()).is_some_and(is_part) {
            parts.push(path);
        }
    }
    parts.sort();
    Ok(parts)
}

/// Reads only the given columns, if any.
pub fn read_part(path: &Path, columns: Option<&[&str]>) -> Result<DataFrame, StoreError> {
    let file =
        File::open(path).map_err(|source| StoreError::File { path: path.to_owned(), source })?;
    let columns = columns.map(|names| names.iter().map(|name| (*name).to_owned()).collect());
    let reader = ParquetReader::new(file).with_columns(columns);
    reader.finish().map_err(|source| StoreError::Content { path: path.to_owned(), source })
}

/// Atomic and durable.
pub fn write_part(path: &Path, frame: &mut DataFrame) -> Result<(), StoreError> {
    crate::report::write_whole(path, |staged| write_durably(staged, frame)).map_err(|fault| {
        match fault {
            PartWriteError::File(source) => StoreError::File { path: path.to_owned(), source },
            PartWriteError::Frame(source) => StoreError::Content { path: path.to_owned(), source },
        }
    })?;
    // Makes the rename durable; not supported on every system.
    if let Some(Ok(folder)) = path.parent().map(File::open) {
        let _ = folder.sync_all();
    }
    Ok(())
}

/// Removes the file if it exists.
pub fn remove_part(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            Err(StoreError::File { path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}

/// Deletes old incomplete files.
pub fn delete_abandoned(folder: &Path) {
    let is_old = |path: &Path| {
        let changed = fs::metadata(path).and_then(|metadata| metadata.modified());
        matches!(changed.map(|time| time.elapsed()), Ok(Ok(age)) if age > MAX_STAGED_AGE)
    };
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_staged = entry.file_name().to_string_lossy().starts_with(STAGED_PREFIX);
        if is_staged && is_old(&entry.path()) {
            // Another process may have deleted it.
            let _ = fs::remove_file(entry.path());
        }
    }
}

fn write_durably(path: &Path, frame: &mut DataFrame) -> Result<(), PartWriteError> {
    let file = File::create(path)?;
    let to_disk = file.try_clone()?;
    ParquetWriter::new(BufWriter::new(file))
        .with_compression(ParquetCompression::Zstd(None))
        .finish(frame)?;
    to_disk.sync_all()?;
    Ok(())
}

#[derive(Debug, thiserror::Error)]
enum PartWriteError {
    #[error(transparent)]
    File(#[from] io::Error),
    #[error(transparent)]
    Frame(#[from] PolarsError),
}
