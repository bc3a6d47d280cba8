//! The Rerun viewer: whether it is there, and how it opens a recording.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use poseaudit::report::Trouble;

use super::misuse;

/// What the viewer's program is called.
const PROGRAM: &str = "rerun";

/// The viewer's program.
///
/// # Errors
/// If it is not on the path.
pub fn viewer() -> Result<PathBuf, Trouble> {
    let name = format!("{PROGRAM}{}", env::consts::EXE_SUFFIX);
    let folders = env::var_os("PATH").unwrap_or_default();
    let program = env::split_paths(&folders).map(|folder| folder.join(&name));
    program.into_iter().find(|program| program.is_file()).ok_or_else(|| {
        let remedy = "install it with `pip install rerun-sdk==0.36.*`, or write a file with --rrd";
        misuse("--view", format!("the viewer `{PROGRAM}` is not on the path"), remedy)
    })
}

/// A place for a recording that nobody named, which the viewer can still read when this program has
/// ended: a new file that is this user's alone.
///
/// # Errors
/// If no file can be made there.
pub fn place() -> Result<PathBuf, Trouble> {
    let made = tempfile::Builder::new().prefix("poseaudit-").suffix(".rrd").tempfile();
    let kept = made.and_then(|file| file.keep().map_err(|error| error.error));
    kept.map(|(_, path)| path).map_err(|error| {
        let what = format!("no recording can be made in {}: {error}", env::temp_dir().display());
        misuse("--view", what, "make room, or let TMPDIR name another folder")
    })
}

/// Opens a recording in the viewer, and does not wait for it to be closed.
///
/// # Errors
/// If it cannot be started.
pub fn open(viewer: &Path, recording: &Path) -> Result<(), Trouble> {
    let mut command = Command::new(viewer);
    command.arg(recording).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().map(drop).map_err(|error| {
        let place = viewer.display().to_string();
        let remedy = format!("open {} by hand", recording.display());
        misuse(place, format!("the viewer cannot be started: {error}"), remedy)
    })
}
