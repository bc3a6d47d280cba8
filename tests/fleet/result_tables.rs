//! Reads the result folder like any Parquet reader.

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::path::Path;

use anyhow::Result;
use polars::prelude::{DataFrame, ParquetReader, SerReader};

/// The tables of logs, each with all its parts.
pub struct ResultTables(BTreeMap<String, DataFrame>);

impl ResultTables {
    /// Reads every file named as a part; each must be complete.
    pub fn read(folder: &Path) -> Result<Self> {
        let mut tables = BTreeMap::new();
        for table in ["runs", "streams", "checks", "findings", "errors"] {
            let mut whole = DataFrame::empty();
            let mut parts = Vec::new();
            for part in fs::read_dir(folder.join(table))? {
                parts.push(part?.path());
            }
            parts.retain(|path| path.extension().is_some_and(|ending| ending == "parquet"));
            parts.sort();
            for path in parts {
                let part = ParquetReader::new(File::open(&path)?).finish()?;
                if whole.width() == 0 {
                    whole = part;
                } else {
                    whole.vstack_mut(&part)?;
                }
            }
            tables.insert(table.to_owned(), whole);
        }
        Ok(Self(tables))
    }

    /// A text column, without nulls.
    pub fn text_column(&self, table: &str, column: &str) -> Vec<String> {
        let column = self.0[table].column(column).and_then(|column| column.str().cloned());
        column.map_or(Vec::new(), |texts| texts.iter().flatten().map(str::to_owned).collect())
    }

    /// Keys of all rows.
    pub fn keys(&self, table: &str) -> Vec<String> {
        self.text_column(table, "key")
    }

    /// Number of logs with rows.
    pub fn count_logs(&self, table: &str) -> usize {
        self.keys(table).into_iter().collect::<HashSet<_>>().len()
    }

    /// Whether all rows are distinct.
    pub fn has_unique_rows(&self, table: &str) -> bool {
        let numbers = self.0[table].column("row").and_then(|column| column.u32().cloned());
        let Ok(numbers) = numbers else { return false };
        let mut seen = HashSet::new();
        self.keys(table).into_iter().zip(numbers.iter()).all(|row| seen.insert(row))
    }

    /// Key of the log whose path ends with `ending`.
    pub fn key_of(&self, ending: &str) -> Option<String> {
        let at = self.text_column("runs", "path").iter().position(|path| path.ends_with(ending))?;
        self.keys("runs").get(at).cloned()
    }
}
