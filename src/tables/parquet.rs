//! Frames as Parquet files in a folder.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use polars::prelude::{DataFrame, ParquetCompression, ParquetWriter, PolarsError};

use crate::report::write_whole;

/// A file that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {cause}", path.display())]
pub struct TableError {
    /// Which.
    pub path: PathBuf,
    /// Why.
    pub cause: String,
}

/// Writes `frame` as `{name}.parquet` into `folder`, which is made. A file of that name is replaced
/// once the new one is whole. Equal frames make equal bytes.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_table(folder: &Path, name: &str, frame: &mut DataFrame) -> Result<(), TableError> {
    let path = folder.join(format!("{name}.parquet"));
    let written = write_whole(&path, |staged| -> Result<(), WriteError> {
        let file = BufWriter::new(File::create(staged)?);
        ParquetWriter::new(file).with_compression(ParquetCompression::Zstd(None)).finish(frame)?;
        Ok(())
    });
    written.map_err(|error| TableError { path, cause: error.to_string() })
}

#[derive(Debug, thiserror::Error)]
enum WriteError {
    #[error(transparent)]
    File(#[from] io::Error),
    #[error(transparent)]
    Frame(#[from] PolarsError),
}
