//! Merges table parts: a hundred of one level become one of the next. Rows of logs that may be retried are
//! not merged. The merged part is written before the old ones are deleted; the next call deletes duplicates
//! left by a crash.

use std::collections::HashSet;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use polars::prelude::DataFrame;

use super::{LogRows, Status, Store, StoreError, TABLES, Table, parts};

/// Parts of a level that are merged.
const MERGE_THRESHOLD: usize = 100;

impl Store {
    /// Merges parts if there are many and no other process is merging.
    ///
    /// # Errors
    /// If a part cannot be read or written.
    pub fn compact(&self) -> Result<(), StoreError> {
        let path = self.path().join(".lock");
        let fault = |source| StoreError::File { path: path.clone(), source };
        let lock = File::create(&path).map_err(fault)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(()),
            // Some network file systems do not support locks.
            Err(TryLockError::Error(_)) => return Ok(()),
        }
        self.merge_logs()?;
        self.merge_level(Table::Sources, 0)?;
        for table in TABLES.into_iter().chain([Table::Sources]) {
            for level in 1.. {
                if !self.merge_level(table, level)? {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Logs with a final status, all tables together.
    fn merge_logs(&self) -> Result<(), StoreError> {
        let runs = parts::list(&self.folder.table_path(Table::Runs))?;
        let single: Vec<&PathBuf> = runs.iter().filter(|path| parts::level(path) == 0).collect();
        if single.len() < MERGE_THRESHOLD {
            return Ok(());
        }
        let mut merged = HashSet::new();
        for path in runs.iter().filter(|path| parts::level(path) > 0) {
            merged.extend(self.keys_in(path)?);
        }
        let (mut keys, mut doubled) = (Vec::new(), Vec::new());
        for path in single {
            let Some(key) = parts::key(path) else { continue };
            let frame = match parts::read_part(path, Some(&["status"])) {
                Err(error) if error.is_gone() => continue,
                frame => frame?,
            };
            let status = frame
                .column("status")
                .and_then(|column| column.str().map(|it| it.get(0).map(str::to_owned)));
            let status = status
                .map_err(|source| StoreError::Content { path: path.clone(), source })?
                .and_then(|name| Status::from_name(&name));
            match status.is_some_and(Status::is_final) {
                true if merged.contains(key) => doubled.push(key.to_owned()),
                true => keys.push(key.to_owned()),
                false => {}
            }
        }
        for key in &doubled {
            self.delete_parts(key)?;
        }
        if keys.len() < MERGE_THRESHOLD {
            return Ok(());
        }
        let together = parts::combined_hash(keys.iter().map(String::as_str));
        for table in TABLES {
            let folder = self.folder.table_path(table);
            let paths = keys.iter().map(|key| folder.join(parts::file_name(key)));
            self.merge(table, paths.filter(|path| path.is_file()).collect(), 1, &together)?;
        }
        Ok(())
    }

    /// One merged part per table.
    pub(super) fn commit_merged(&self, logs: Vec<LogRows>) -> Result<(), StoreError> {
        let keys: Vec<String> = logs.iter().map(|log| log.key.clone()).collect();
        let name =
            parts::merged_file_name(1, &parts::combined_hash(keys.iter().map(String::as_str)));
        let mut frames = logs.into_iter().map(|log| log.tables.into_frames()).collect::<Vec<_>>();
        for (at, table) in TABLES.into_iter().enumerate() {
            let own = frames.iter_mut().map(|of| std::mem::take(&mut of[at].1));
            let path = self.folder.table_path(table).join(&name);
            if let Some(mut whole) = stack(own.filter(|frame| frame.height() > 0), &path)? {
                parts::write_part(&path, &mut whole)?;
            }
        }
        // Left by earlier calls.
        keys.iter().try_for_each(|key| self.delete_parts(key))
    }

    fn merge_level(&self, table: Table, level: u32) -> Result<bool, StoreError> {
        let all = parts::list(&self.folder.table_path(table))?;
        let alike: Vec<PathBuf> =
            all.into_iter().filter(|path| parts::level(path) == level).collect();
        if alike.len() < MERGE_THRESHOLD {
            return Ok(false);
        }
        let names = alike.iter().filter_map(|path| path.file_stem()?.to_str());
        let together = parts::combined_hash(names);
        self.merge(table, alike, level + 1, &together)?;
        Ok(true)
    }

    fn merge(
        &self,
        table: Table,
        paths: Vec<PathBuf>,
        level: u32,
        together: &str,
    ) -> Result<(), StoreError> {
        let frames = paths.iter().map(|path| parts::read_part(path, None));
        let frames = frames.collect::<Result<Vec<_>, _>>()?;
        let Some(mut whole) = stack(frames.into_iter(), &self.folder.table_path(table))? else {
            return Ok(());
        };
        let path = self.folder.table_path(table).join(parts::merged_file_name(level, together));
        parts::write_part(&path, &mut whole)?;
        paths.iter().try_for_each(|path| parts::remove_part(path))
    }

    fn keys_in(&self, path: &Path) -> Result<HashSet<String>, StoreError> {
        let frame = match parts::read_part(path, Some(&["key"])) {
            Err(error) if error.is_gone() => return Ok(HashSet::new()),
            frame => frame?,
        };
        let keys = frame.column("key").and_then(|column| Ok(column.str()?.clone()));
        let keys = keys.map_err(|source| StoreError::Content { path: path.to_owned(), source })?;
        Ok(keys.iter().flatten().map(str::to_owned).collect())
    }
}

fn stack(
    mut frames: impl Iterator<Item = DataFrame>,
    path: &Path,
) -> Result<Option<DataFrame>, StoreError> {
    let Some(mut whole) = frames.next() else { return Ok(None) };
    for frame in frames {
        let grown = whole.vstack_mut(&frame);
        grown.map_err(|source| StoreError::Content { path: path.to_owned(), source })?;
    }
    whole.rechunk_mut();
    Ok(Some(whole))
}
