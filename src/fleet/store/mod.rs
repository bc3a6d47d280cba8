//! Results folder: one subfolder per table, with Parquet files as its parts.
//!
//! A log's rows form one part per table, named by its key and renamed into place when complete. The part of
//! `runs` is written last: a log without it is not done. Every hundred parts are merged into one
//! (`compact`). A concurrent reader may see rows twice and must use each key once.

mod compact;
mod frames;
mod parts;

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use polars::prelude::{Column, DataFrame, PolarsError};
use serde::{Deserialize, Serialize};

use super::content::row_key;
use super::dataset::SharedMapping;
use super::settings::AuditSettings;
use super::task::AuditAnswer;
pub use super::task::Status;
use crate::report::Trouble;

pub(super) use frames::count_findings;
pub use frames::{LogRows, RunRow, Tables};

/// Table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Table {
    /// Result per log.
    Runs,
    /// Row per topic.
    Streams,
    /// Row per rule and subject.
    Checks,
    /// Row per finding.
    Findings,
    /// Reason per log not audited.
    Errors,
    /// Content identifier per file state.
    Sources,
}

/// Tables in write order.
pub const TABLES: [Table; 5] =
    [Table::Streams, Table::Checks, Table::Findings, Table::Errors, Table::Runs];

const SETTINGS: &str = "settings";
const DATASETS: &str = "datasets";
const PAGES: &str = "pages";

impl Table {
    /// Name, also of its folder.
    pub const fn name(self) -> &'static str {
        match self {
            Table::Runs => "runs",
            Table::Streams => "streams",
            Table::Checks => "checks",
            Table::Findings => "findings",
            Table::Errors => "errors",
            Table::Sources => "sources",
        }
    }
}

/// Error of the results folder.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// File cannot be accessed.
    #[error("{}: {source}", path.display())]
    File {
        /// File.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// Invalid content.
    #[error("{}: {source}", path.display())]
    Content {
        /// File.
        path: PathBuf,
        /// Cause.
        source: PolarsError,
    },
}

impl StoreError {
    fn path(&self) -> &Path {
        match self {
            StoreError::File { path, .. } | StoreError::Content { path, .. } => path,
        }
    }

    fn is_gone(&self) -> bool {
        matches!(self, StoreError::File { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

impl From<StoreError> for Trouble {
    fn from(error: StoreError) -> Self {
        let (what, remedy) = match &error {
            StoreError::File { source, .. } => (
                format!("cannot be read or written: {source}"),
                "choose a writable folder with --out",
            ),
            StoreError::Content { source, .. } => (
                format!(
                    "not a fleet table: {}",
                    source.to_string().lines().next().unwrap_or_default()
                ),
                "delete the file and run again; its logs are then audited again",
            ),
        };
        Trouble::call(error.path().display(), what, remedy)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreFolder(PathBuf);

impl StoreFolder {
    pub fn table_path(&self, table: Table) -> PathBuf {
        self.0.join(table.name())
    }
}

/// Folder with audit results.
#[derive(Clone, Debug)]
pub struct Store {
    folder: StoreFolder,
}

impl Store {
    /// Opens or creates the store in `folder`.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn create(folder: &Path) -> Result<Self, StoreError> {
        let store = Self { folder: StoreFolder(folder.to_owned()) };
        for table in TABLES.into_iter().chain([Table::Sources]) {
            let path = store.folder.table_path(table);
            if let Err(source) = fs::create_dir_all(&path) {
                return Err(StoreError::File { path, source });
            }
            parts::delete_abandoned(&path);
        }
        Ok(store)
    }

    /// Subfolders that a store uses.
    pub fn folders(folder: &Path) -> Vec<PathBuf> {
        let tables = TABLES.into_iter().chain([Table::Sources]).map(Table::name);
        tables.chain([SETTINGS, DATASETS, PAGES]).map(|name| folder.join(name)).collect()
    }

    /// Opens the store in `folder`, if any.
    pub fn open(folder: &Path) -> Option<Self> {
        let folder = StoreFolder(folder.to_owned());
        folder.table_path(Table::Runs).is_dir().then_some(Self { folder })
    }

    /// Report page of a log.
    pub fn page_path(&self, key: &str) -> PathBuf {
        self.path().join(PAGES).join(format!("{key}.html"))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.folder.0
    }

    /// Stores the settings under their hash.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_settings(&self, settings: &AuditSettings) -> Result<(), StoreError> {
        let path = self.path().join(SETTINGS).join(format!("{}.json", settings.hash));
        if path.is_file() {
            return Ok(());
        }
        let text = format!("{:#}\n", settings.readable);
        crate::report::write_whole(&path, |staged| fs::write(staged, &text))
            .map_err(|source| StoreError::File { path, source })
    }

    /// Shared properties of a dataset under these settings.
    pub fn load_dataset(&self, dataset: &Path, settings: &str) -> Option<SharedMapping> {
        let text = fs::read_to_string(self.dataset_file(dataset, settings)).ok()?;
        let kept: StoredDataset = serde_json::from_str(&text).ok()?;
        Some(kept.shared)
    }

    /// Shared properties of all datasets under these settings, by name.
    pub fn load_datasets(&self, settings: &str) -> Vec<StoredDataset> {
        let files = fs::read_dir(self.path().join(DATASETS)).into_iter().flatten().flatten();
        let texts = files.filter_map(|file| fs::read_to_string(file.path()).ok());
        let kept = texts.filter_map(|text| serde_json::from_str(&text).ok());
        let mut kept: Vec<StoredDataset> =
            kept.filter(|kept: &StoredDataset| kept.settings == settings).collect();
        kept.sort_by(|a, b| a.dataset.cmp(&b.dataset));
        kept
    }

    /// Stores the shared properties of a dataset.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save_dataset(
        &self,
        dataset: &Path,
        settings: &str,
        shared: &SharedMapping,
    ) -> Result<(), StoreError> {
        let path = self.dataset_file(dataset, settings);
        let dataset = dataset.display().to_string();
        let kept = StoredDataset { dataset, settings: settings.to_owned(), shared: shared.clone() };
        let write = |staged: &Path| fs::write(staged, serde_json::to_vec_pretty(&kept)?);
        crate::report::write_whole(&path, write).map_err(|source| StoreError::File { path, source })
    }

    fn dataset_file(&self, dataset: &Path, settings: &str) -> PathBuf {
        let version = env!("CARGO_PKG_VERSION");
        let name = row_key(&dataset.display().to_string(), version, settings);
        self.path().join(DATASETS).join(format!("{name}.json"))
    }

    /// Time when these settings were first stored.
    pub(super) fn settings_time(&self, hash: &str) -> Option<std::time::SystemTime> {
        let path = self.path().join(SETTINGS).join(format!("{hash}.json"));
        fs::metadata(path).and_then(|metadata| metadata.modified()).ok()
    }

    /// Stores rows of several logs, `runs` last.
    ///
    /// # Errors
    /// If a part cannot be written.
    pub fn commit(&self, logs: Vec<LogRows>) -> Result<(), StoreError> {
        let (done, others): (Vec<_>, Vec<_>) =
            logs.into_iter().partition(|log| log.answer.status.is_final());
        match done.len() {
            0 | 1 => done.into_iter().try_for_each(|log| self.commit_one(&log.key, log.tables))?,
            _ => self.commit_merged(done)?,
        }
        others.into_iter().try_for_each(|log| self.commit_one(&log.key, log.tables))
    }

    fn commit_one(&self, key: &str, tables: Tables) -> Result<(), StoreError> {
        for (table, mut frame) in tables.into_frames() {
            let path = self.folder.table_path(table).join(parts::file_name(key));
            match frame.height() {
                // Left by an interrupted call.
                0 => parts::remove_part(&path)?,
                _ => parts::write_part(&path, &mut frame)?,
            }
        }
        Ok(())
    }

    /// Deletes the separate parts of a key.
    ///
    /// # Errors
    /// If a part cannot be deleted.
    pub fn delete_parts(&self, key: &str) -> Result<(), StoreError> {
        let paths = TABLES
            .into_iter()
            .map(|table| self.folder.table_path(table).join(parts::file_name(key)));
        paths.rev().try_for_each(|path| parts::remove_part(&path))
    }

    /// Results of finished logs, by key.
    ///
    /// # Errors
    /// If a part cannot be read.
    pub fn finished_answers(&self) -> Result<HashMap<String, AuditAnswer>, StoreError> {
        let mut done = HashMap::new();
        self.for_each_part(Table::Runs, Some(frames::ANSWER_COLUMNS), |frame| {
            done.extend(frames::read_answers(&frame)?);
            Ok(())
        })?;
        Ok(done)
    }

    /// Known contents by file state.
    ///
    /// # Errors
    /// If a part cannot be read.
    pub fn known_contents(&self) -> Result<HashMap<String, String>, StoreError> {
        let mut contents = HashMap::new();
        self.for_each_part(Table::Sources, Some(&["source", "content"]), |frame| {
            let texts = |name: &str| frame.column(name)?.str();
            for (source, content) in texts("source")?.iter().zip(texts("content")?.iter()) {
                contents.extend(source.zip(content).map(|(a, b)| (a.to_owned(), b.to_owned())));
            }
            Ok(())
        })?;
        Ok(contents)
    }

    /// Stores contents by file state.
    ///
    /// # Errors
    /// If the part cannot be written.
    pub fn add_sources(&self, rows: &[SourceRow]) -> Result<(), StoreError> {
        if rows.is_empty() {
            return Ok(());
        }
        let text = |name: &str, of: fn(&SourceRow) -> &str| {
            Column::new(name.into(), rows.iter().map(of).collect::<Vec<_>>())
        };
        let bytes: Vec<u64> = rows.iter().map(|row| row.bytes).collect();
        let mtimes: Vec<i64> = rows.iter().map(|row| row.mtime_ns).collect();
        let columns = vec![
            text("source", |row| &row.source),
            text("path", |row| &row.path),
            Column::new("bytes".into(), bytes),
            Column::new("mtime_ns".into(), mtimes),
            text("content", |row| &row.content),
        ];
        let names: HashSet<&str> = rows.iter().map(|row| row.source.as_str()).collect();
        let path = self
            .folder
            .table_path(Table::Sources)
            .join(parts::file_name(&parts::combined_hash(names)));
        let frame = DataFrame::new(rows.len(), columns);
        let mut frame =
            frame.map_err(|source| StoreError::Content { path: path.clone(), source })?;
        parts::write_part(&path, &mut frame)
    }

    /// Passes each part of a table to `take`, with the given columns.
    ///
    /// # Errors
    /// If a part cannot be read, or `take` fails.
    pub fn for_each_part(
        &self,
        table: Table,
        columns: Option<&[&str]>,
        mut take: impl FnMut(DataFrame) -> Result<(), PolarsError>,
    ) -> Result<(), StoreError> {
        let mut taken = HashSet::new();
        // A concurrent merge may replace parts.
        for _ in 0..parts::MAX_TRIES {
            let mut is_gone = false;
            for path in parts::list(&self.folder.table_path(table))? {
                if taken.contains(&path) {
                    continue;
                }
                match parts::read_part(&path, columns) {
                    Err(error) if error.is_gone() => is_gone = true,
                    Err(error) => return Err(error),
                    Ok(frame) => {
                        take(frame)
                            .map_err(|source| StoreError::Content { path: path.clone(), source })?;
                        taken.insert(path);
                    }
                }
            }
            if !is_gone {
                break;
            }
        }
        Ok(())
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub struct StoredDataset {
    /// Folder or file.
    pub dataset: String,
    /// Hash.
    pub settings: String,
    pub shared: SharedMapping,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceRow {
    /// Hash of path and state.
    pub source: String,
    pub path: String,
    pub bytes: u64,
    /// ns since 1970.
    pub mtime_ns: i64,
    pub content: String,
}
