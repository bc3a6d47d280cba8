//! Outputs of an audited run in addition to its report. Each takes an [`Audited`](crate::Audited) run and
//! first checks that it does not overwrite an input file. Outputs do not change the findings.

pub mod calibration;
mod error_series;
#[cfg(feature = "fix")]
pub mod fix;
pub mod foxglove;
pub mod plotjuggler;
#[cfg(feature = "recording")]
pub mod replay;
#[cfg(feature = "tables")]
pub mod tables;
pub mod tum;

use std::path::Path;
use std::{fs, io};

use crate::report::{Trouble, write_whole};
use crate::time::{NANOS_PER_SECOND, Stamp};

/// Every nanosecond is kept.
fn decimal_seconds(stamp: Stamp) -> String {
    let sign = if stamp.nanos() < 0 { "-" } else { "" };
    let (nanos, second) = (stamp.nanos().unsigned_abs(), NANOS_PER_SECOND.unsigned_abs());
    format!("{sign}{}.{:09}", nanos / second, nanos % second)
}

/// Writes a file as a whole.
fn write_file(path: &Path, content: impl AsRef<[u8]>, remedy: &str) -> Result<(), Trouble> {
    let written: io::Result<()> = write_whole(path, |staged| fs::write(staged, content));
    written.map_err(|error| Trouble::call(path.display(), error, remedy))
}

/// Writes texts by file name into the folder of an option, creating it. Each file is replaced as a whole.
fn write_folder<N: AsRef<Path>>(
    option: &str,
    folder: &Path,
    texts: &[(N, String)],
) -> Result<(), Trouble> {
    let unwritable = |path: &Path, error: io::Error| {
        let remedy = format!("set {option} to a writable folder");
        Trouble::call(path.display(), format_args!("cannot be written: {error}"), remedy)
    };
    fs::create_dir_all(folder).map_err(|error| unwritable(folder, error))?;
    texts.iter().try_for_each(|(name, text)| {
        let path = folder.join(name);
        write_whole(&path, |staged| fs::write(staged, text))
            .map_err(|error| unwritable(&path, error))
    })
}
