//! The folder that the results are kept in: a folder for each table, and in it Parquet files, the
//! parts of the table.
//!
//! A part takes its place when it is whole, by being renamed. The rows of one log are a part of each
//! table that bears its key, and that of `runs` comes last: a log without it is not done. Who writes
//! the same log again replaces its parts. A hundred parts become one, beside which they are deleted
//! (`compact`); a reader that comes between sees rows twice, and takes each key once.

mod compact;
mod frames;
mod parts;

use std::collections::{HashMap, HashSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use polars::prelude::{Column, DataFrame, PolarsError};
use serde::{Deserialize, Serialize};

use super::content::key_of;
use super::dataset::Shared;
use super::settings::AuditSettings;
use super::task::Answer;
pub use super::task::Status;
use crate::report::{Trouble, TroubleKind};

pub(super) use frames::found;
pub use frames::{LogRows, Row, Tables};

/// A table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Table {
    /// A row a log: how its audit ended.
    Runs,
    /// A row a topic.
    Streams,
    /// A row for every rule and subject.
    Checks,
    /// A row a finding.
    Findings,
    /// A row a log that could not be audited: why.
    Errors,
    /// A row a file as it stood: which content it had.
    Sources,
}

/// The tables whose rows are of a log, in the order in which they are written.
pub const TABLES: [Table; 5] =
    [Table::Streams, Table::Checks, Table::Findings, Table::Errors, Table::Runs];

/// The folder of what settings of a hash are.
const SETTINGS: &str = "settings";
/// Folder of what the logs of a dataset share.
const DATASETS: &str = "datasets";
/// Folder of the pages of logs.
const PAGES: &str = "pages";

impl Table {
    /// Its name, which is that of its folder.
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

/// What is kept in a folder could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// What is in it.
    #[error("{}: {source}", path.display())]
    Content {
        /// Which.
        path: PathBuf,
        /// Why.
        source: PolarsError,
    },
}

impl StoreError {
    fn path(&self) -> &Path {
        match self {
            StoreError::File { path, .. } | StoreError::Content { path, .. } => path,
        }
    }

    /// Whether the part is gone since it was seen.
    fn is_gone(&self) -> bool {
        matches!(self, StoreError::File { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

impl From<StoreError> for Trouble {
    fn from(error: StoreError) -> Self {
        let place = error.path().display().to_string();
        let (what, remedy) = match &error {
            StoreError::File { source, .. } => (
                format!("it cannot be read or written: {source}"),
                "name a folder of your own with --out",
            ),
            StoreError::Content { source, .. } => (
                format!(
                    "no table of a fleet: {}",
                    source.to_string().lines().next().unwrap_or_default()
                ),
                "delete the file, and call again: what it held is done anew",
            ),
        };
        Trouble { kind: TroubleKind::Call, what, place, remedy: remedy.to_owned() }
    }
}

/// What is known of the files of a folder, as far as parts are concerned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Folder(PathBuf);

impl Folder {
    /// Where the parts of a table are.
    pub fn of(&self, table: Table) -> PathBuf {
        self.0.join(table.name())
    }
}

/// A folder with the results of audits.
#[derive(Clone, Debug)]
pub struct Store {
    folder: Folder,
}

impl Store {
    /// The store in `folder`, which is made where it is not there.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn create(folder: &Path) -> Result<Self, StoreError> {
        let store = Self { folder: Folder(folder.to_owned()) };
        for table in TABLES.into_iter().chain([Table::Sources]) {
            let path = store.folder.of(table);
            if let Err(source) = fs::create_dir_all(&path) {
                return Err(StoreError::File { path, source });
            }
            parts::sweep(&path);
        }
        Ok(store)
    }

    /// The folders below `folder` that it keeps its files in.
    pub fn folders(folder: &Path) -> Vec<PathBuf> {
        let tables = TABLES.into_iter().chain([Table::Sources]).map(Table::name);
        tables.chain([SETTINGS, DATASETS, PAGES]).map(|name| folder.join(name)).collect()
    }

    /// The store that is in `folder`; `None` where there is none.
    pub fn open(folder: &Path) -> Option<Self> {
        let folder = Folder(folder.to_owned());
        folder.of(Table::Runs).is_dir().then_some(Self { folder })
    }

    /// Where the page of the log with this key is, if it was asked for.
    pub fn page(&self, key: &str) -> PathBuf {
        self.path().join(PAGES).join(format!("{key}.html"))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.folder.0
    }

    /// Keeps what the settings of a hash are, for who reads the tables.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep_settings(&self, settings: &AuditSettings) -> Result<(), StoreError> {
        let path = self.path().join(SETTINGS).join(format!("{}.json", settings.hash));
        if path.is_file() {
            return Ok(());
        }
        let text = format!("{:#}\n", settings.said);
        crate::report::write_whole(&path, |staged| fs::write(staged, &text))
            .map_err(|source| StoreError::File { path, source })
    }

    /// What the logs of a dataset share, as it was learnt with settings of a hash.
    pub fn dataset(&self, dataset: &Path, settings: &str) -> Option<Shared> {
        let text = fs::read_to_string(self.dataset_file(dataset, settings)).ok()?;
        let kept: KeptDataset = serde_json::from_str(&text).ok()?;
        Some(kept.shared)
    }

    /// What the logs of each dataset share, as it was learnt with settings of a hash, by their names.
    pub fn datasets(&self, settings: &str) -> Vec<KeptDataset> {
        let files = fs::read_dir(self.path().join(DATASETS)).into_iter().flatten().flatten();
        let texts = files.filter_map(|file| fs::read_to_string(file.path()).ok());
        let kept = texts.filter_map(|text| serde_json::from_str(&text).ok());
        let mut kept: Vec<KeptDataset> =
            kept.filter(|kept: &KeptDataset| kept.settings == settings).collect();
        kept.sort_by(|a, b| a.dataset.cmp(&b.dataset));
        kept
    }

    /// Keeps what the logs of a dataset share.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep_dataset(
        &self,
        dataset: &Path,
        settings: &str,
        shared: &Shared,
    ) -> Result<(), StoreError> {
        let path = self.dataset_file(dataset, settings);
        let dataset = dataset.display().to_string();
        let kept = KeptDataset { dataset, settings: settings.to_owned(), shared: shared.clone() };
        let write = |staged: &Path| fs::write(staged, serde_json::to_vec_pretty(&kept)?);
        crate::report::write_whole(&path, write).map_err(|source| StoreError::File { path, source })
    }

    fn dataset_file(&self, dataset: &Path, settings: &str) -> PathBuf {
        let version = env!("CARGO_PKG_VERSION");
        let name = key_of(&dataset.display().to_string(), version, settings);
        self.path().join(DATASETS).join(format!("{name}.json"))
    }

    /// When the settings of this hash were written down first; nothing where they were not.
    pub(super) fn settings_written(&self, hash: &str) -> Option<std::time::SystemTime> {
        let path = self.path().join(SETTINGS).join(format!("{hash}.json"));
        fs::metadata(path).and_then(|metadata| metadata.modified()).ok()
    }

    /// Puts the rows of some logs in their places, those of `runs` last: of several that are done for good
    /// together.
    ///
    /// # Errors
    /// Where a part cannot be written.
    pub fn commit(&self, logs: Vec<LogRows>) -> Result<(), StoreError> {
        let (done, others): (Vec<_>, Vec<_>) =
            logs.into_iter().partition(|log| log.answer.status.is_final());
        match done.len() {
            0 | 1 => done.into_iter().try_for_each(|log| self.commit_one(&log.key, log.tables))?,
            _ => self.commit_together(done)?,
        }
        others.into_iter().try_for_each(|log| self.commit_one(&log.key, log.tables))
    }

    fn commit_one(&self, key: &str, tables: Tables) -> Result<(), StoreError> {
        for (table, mut frame) in tables.into_frames() {
            let path = self.folder.of(table).join(parts::name(key));
            match frame.height() {
                // An earlier call may have left some there and died.
                0 => parts::remove(&path)?,
                _ => parts::write(&path, &mut frame)?,
            }
        }
        Ok(())
    }

    /// Forgets the rows of a key that a log of its own does not have any more.
    ///
    /// # Errors
    /// Where a part is there and cannot be deleted.
    pub fn forget(&self, key: &str) -> Result<(), StoreError> {
        let paths = TABLES.into_iter().map(|table| self.folder.of(table).join(parts::name(key)));
        paths.rev().try_for_each(|path| parts::remove(&path))
    }

    /// How the logs ended that are done, by their keys.
    ///
    /// # Errors
    /// Where a part cannot be read.
    pub fn done(&self) -> Result<HashMap<String, Answer>, StoreError> {
        let mut done = HashMap::new();
        self.each(Table::Runs, Some(frames::ANSWER_COLUMNS), |frame| {
            done.extend(frames::answers(&frame)?);
            Ok(())
        })?;
        Ok(done)
    }

    /// Which content files had as they stood, by the names of their stand.
    ///
    /// # Errors
    /// Where a part cannot be read.
    pub fn contents(&self) -> Result<HashMap<String, String>, StoreError> {
        let mut contents = HashMap::new();
        self.each(Table::Sources, Some(&["source", "content"]), |frame| {
            let texts = |name: &str| frame.column(name)?.str();
            for (source, content) in texts("source")?.iter().zip(texts("content")?.iter()) {
                contents.extend(source.zip(content).map(|(a, b)| (a.to_owned(), b.to_owned())));
            }
            Ok(())
        })?;
        Ok(contents)
    }

    /// Keeps which content files had as they stood.
    ///
    /// # Errors
    /// Where the part cannot be written.
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
        let path = self.folder.of(Table::Sources).join(parts::name(&parts::together(names)));
        let frame = DataFrame::new(rows.len(), columns);
        let mut frame =
            frame.map_err(|source| StoreError::Content { path: path.clone(), source })?;
        parts::write(&path, &mut frame)
    }

    /// Hands each part of a table to `take`, with those of its columns that are named.
    ///
    /// # Errors
    /// Where a part cannot be read, or `take` cannot.
    pub fn each(
        &self,
        table: Table,
        columns: Option<&[&str]>,
        mut take: impl FnMut(DataFrame) -> Result<(), PolarsError>,
    ) -> Result<(), StoreError> {
        let mut taken = HashSet::new();
        // Parts that were there are gone where another process has made one of them meanwhile, which
        // is there then.
        for _ in 0..parts::MOST_TRIES {
            let mut is_gone = false;
            for path in parts::of(&self.folder.of(table))? {
                if taken.contains(&path) {
                    continue;
                }
                match parts::read(&path, columns) {
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

/// What the logs of a dataset share, as it is kept.
#[derive(Debug, Serialize, Deserialize)]
pub struct KeptDataset {
    /// The folder or file of the dataset.
    pub dataset: String,
    /// Hash of the settings.
    pub settings: String,
    /// What its logs share.
    pub shared: Shared,
}

/// Which content a file had as it stood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceRow {
    /// Name of the file as it stood.
    pub source: String,
    /// Its path.
    pub path: String,
    /// Its size.
    pub bytes: u64,
    /// When it was last changed, ns since 1970.
    pub mtime_ns: i64,
    /// The name of its content.
    pub content: String,
}
