//! The Rerun viewer: finds it and opens recordings, one or a sequence.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::{env, fs, io};

use poseaudit::report::Trouble;
use tempfile::TempPath;

use super::misuse;

/// The option that opens the viewer.
pub const OPTION: &str = "--view";

/// Name of the viewer's program.
const PROGRAM: &str = "rerun";

/// Finds the viewer's program for an option of the call.
///
/// # Errors
/// If it is not on the PATH.
pub fn viewer(option: &str) -> Result<PathBuf, Trouble> {
    let name = format!("{PROGRAM}{}", env::consts::EXE_SUFFIX);
    let folders = env::var_os("PATH").unwrap_or_default();
    let program = env::split_paths(&folders).map(|folder| folder.join(&name));
    program.into_iter().find(|program| program.is_file()).ok_or_else(|| {
        let remedy = "install it with `pip install rerun-sdk==0.36.*`, or write a file with --rrd";
        misuse(option, format!("the viewer `{PROGRAM}` is not on the PATH"), remedy)
    })
}

/// Creates a file for an unnamed recording. It is readable only by this user and outlives this program, so
/// that the viewer can read it.
///
/// # Errors
/// If the file cannot be created.
pub fn place() -> Result<PathBuf, Trouble> {
    draft(OPTION)?.keep().map_err(|error| no_room(OPTION, &error.error))
}

/// Creates a file for a recording; it is deleted when the returned path is dropped.
fn draft(option: &str) -> Result<TempPath, Trouble> {
    let made = tempfile::Builder::new().prefix("poseaudit-").suffix(".rrd").tempfile();
    made.map(tempfile::NamedTempFile::into_temp_path).map_err(|error| no_room(option, &error))
}

fn no_room(option: &str, error: &io::Error) -> Trouble {
    let what = format!("cannot create a recording in {}: {error}", env::temp_dir().display());
    misuse(option, what, "free some space, or set TMPDIR to another folder")
}

/// Opens a recording in the viewer without waiting for it to close.
///
/// # Errors
/// If the viewer cannot be started.
pub fn open(viewer: &Path, recording: &Path) -> Result<(), Trouble> {
    let mut command = Command::new(viewer);
    command.arg(recording).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let started = command.spawn().map(drop);
    started.map_err(|error| {
        unstarted(viewer, &error, format!("open {} manually", recording.display()))
    })
}

fn unstarted(viewer: &Path, error: &io::Error, remedy: impl Into<String>) -> Trouble {
    misuse(viewer.display().to_string(), format!("the viewer cannot be started: {error}"), remedy)
}

/// A viewer that receives a sequence of recordings: the one listening on a local port, or a new one.
pub struct LiveViewer {
    /// The viewer's program. It forwards its input to the listening viewer, or opens it itself.
    program: Child,
    port: u16,
    /// Path of the next recording.
    next: TempPath,
}

impl LiveViewer {
    /// # Errors
    /// If the viewer's program is not on the PATH or cannot be started, or no recording can be created.
    pub fn at(option: &str, port: u16) -> Result<Self, Trouble> {
        let (viewer, next) = (viewer(option)?, draft(option)?);
        let mut command = Command::new(&viewer);
        command.args(["--port", &port.to_string(), "-"]);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let remedy = "or write a file with --rrd";
        let program = command.spawn().map_err(|error| unstarted(&viewer, &error, remedy))?;
        Ok(Self { program, port, next })
    }

    /// Path for the next recording.
    pub fn next(&self) -> &Path {
        &self.next
    }

    /// Shows the recording at that path.
    ///
    /// # Errors
    /// If the viewer does not accept it, for instance because it was closed.
    pub fn show(&mut self) -> Result<(), Trouble> {
        let Some(pipe) = &mut self.program.stdin else { return Ok(()) };
        let given = fs::File::open(&self.next).and_then(|mut file| io::copy(&mut file, pipe));
        given.map(drop).map_err(|error| {
            let what = format!("does not accept recordings: {error}");
            let remedy =
                format!("if it was not closed, run `{PROGRAM} --port {}` to see why", self.port);
            misuse(format!("viewer at port {}", self.port), what, remedy)
        })
    }
}
