use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use polars::prelude::{
    AnyValue, Column, DataFrame, ParquetCompression, ParquetWriter, PolarsError, PolarsResult,
};

use crate::report::write_whole;

/// Error of a table file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {cause}", path.display())]
pub struct TableError {
    /// File.
    pub path: PathBuf,
    /// Cause.
    pub cause: String,
}

/// Writes `frame` as `{name}.parquet` into `folder`, creating it. An existing file is replaced as a whole.
/// Equal frames have equal bytes.
///
/// # Errors
/// If the file cannot be written.
pub fn write_table(folder: &Path, name: &str, frame: &mut DataFrame) -> Result<(), TableError> {
    write_frame(&folder.join(format!("{name}.parquet")), frame)
}

/// Writes `frame` as CSV or Parquet, by extension.
///
/// # Errors
/// If the file cannot be written or has another extension.
pub fn write_frame(path: &Path, frame: &mut DataFrame) -> Result<(), TableError> {
    let fault = |cause: String| TableError { path: path.to_owned(), cause };
    let write: fn(&Path, &mut DataFrame) -> Result<(), WriteError> =
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("parquet") => write_parquet,
            Some("csv") => write_csv,
            _ => return Err(fault("its name must end in .csv or .parquet".to_owned())),
        };
    write_whole(path, |staged| write(staged, frame)).map_err(|error| fault(error.to_string()))
}

fn write_parquet(path: &Path, frame: &mut DataFrame) -> Result<(), WriteError> {
    let file = BufWriter::new(File::create(path)?);
    ParquetWriter::new(file).with_compression(ParquetCompression::Zstd(None)).finish(frame)?;
    Ok(())
}

fn write_csv(path: &Path, frame: &mut DataFrame) -> Result<(), WriteError> {
    let mut writer = csv::Writer::from_path(path)?;
    writer.write_record(frame.columns().iter().map(|column| column.name().as_str()))?;
    for row in 0..frame.height() {
        let cell = |column: &Column| match column.get(row)? {
            // Polars' display would omit digits.
            AnyValue::Float64(number) => Ok(number.to_string()),
            other => Ok(other.str_value().into_owned()),
        };
        let cells: PolarsResult<Vec<String>> = frame.columns().iter().map(cell).collect();
        writer.write_record(cells?)?;
    }
    writer.flush()?;
    Ok(())
}

#[derive(Debug, thiserror::Error)]
enum WriteError {
    #[error(transparent)]
    File(#[from] io::Error),
    #[error(transparent)]
    Frame(#[from] PolarsError),
    #[error(transparent)]
    Text(#[from] csv::Error),
}
