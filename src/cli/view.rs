//! The Rerun viewer: whether it is there, and how it opens a recording, or one after the other.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::{env, fs, io};

use poseaudit::report::Trouble;
use tempfile::TempPath;

use super::misuse;

/// The option that opens the viewer.
pub const OPTION: &str = "--view";

/// What the viewer's program is called.
const PROGRAM: &str = "rerun";

/// The viewer's program, for an option of the call.
///
/// # Errors
/// If it is not on the path.
pub fn viewer(option: &str) -> Result<PathBuf, Trouble> {
    let name = format!("{PROGRAM}{}", env::consts::EXE_SUFFIX);
    let folders = env::var_os("PATH").unwrap_or_default();
    let program = env::split_paths(&folders).map(|folder| folder.join(&name));
    program.into_iter().find(|program| program.is_file()).ok_or_else(|| {
        let remedy = "install it with `pip install rerun-sdk==0.36.*`, or write a file with --rrd";
        misuse(option, format!("the viewer `{PROGRAM}` is not on the path"), remedy)
    })
}

/// A place for a recording that nobody named, which the viewer can still read when this program has
/// ended: a new file that is this user's alone.
///
/// # Errors
/// If no file can be made there.
pub fn place() -> Result<PathBuf, Trouble> {
    draft(OPTION)?.keep().map_err(|error| no_room(OPTION, &error.error))
}

/// A new file for a recording, which goes with what is returned.
fn draft(option: &str) -> Result<TempPath, Trouble> {
    let made = tempfile::Builder::new().prefix("poseaudit-").suffix(".rrd").tempfile();
    made.map(tempfile::NamedTempFile::into_temp_path).map_err(|error| no_room(option, &error))
}

fn no_room(option: &str, error: &io::Error) -> Trouble {
    let what = format!("no recording can be made in {}: {error}", env::temp_dir().display());
    misuse(option, what, "make room, or let TMPDIR name another folder")
}

/// Opens a recording in the viewer, and does not wait for it to be closed.
///
/// # Errors
/// If it cannot be started.
pub fn open(viewer: &Path, recording: &Path) -> Result<(), Trouble> {
    let mut command = Command::new(viewer);
    command.arg(recording).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let started = command.spawn().map(drop);
    started
        .map_err(|error| unstarted(viewer, &error, format!("open {} by hand", recording.display())))
}

fn unstarted(viewer: &Path, error: &io::Error, remedy: impl Into<String>) -> Trouble {
    misuse(viewer.display().to_string(), format!("the viewer cannot be started: {error}"), remedy)
}

/// A viewer that is given one recording after the other: the one that listens at a port of this machine, or
/// a new one.
pub struct LiveViewer {
    /// The viewer's program: it hands on what it reads to the one that listens, or opens it itself.
    program: Child,
    port: u16,
    /// The recording that is next.
    next: TempPath,
}

impl LiveViewer {
    /// # Errors
    /// If the viewer's program is not on the path or cannot be started, or no recording can be made.
    pub fn at(option: &str, port: u16) -> Result<Self, Trouble> {
        let (viewer, next) = (viewer(option)?, draft(option)?);
        let mut command = Command::new(&viewer);
        command.args(["--port", &port.to_string(), "-"]);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let remedy = "or write a file with --rrd";
        let program = command.spawn().map_err(|error| unstarted(&viewer, &error, remedy))?;
        Ok(Self { program, port, next })
    }

    /// Where the next recording is written.
    pub fn next(&self) -> &Path {
        &self.next
    }

    /// Shows the recording that was written there.
    ///
    /// # Errors
    /// If the viewer does not take it, as one does not that was closed.
    pub fn show(&mut self) -> Result<(), Trouble> {
        let Some(pipe) = &mut self.program.stdin else { return Ok(()) };
        let given = fs::File::open(&self.next).and_then(|mut file| io::copy(&mut file, pipe));
        given.map(drop).map_err(|error| {
            let what = format!("takes no more recordings: {error}");
            let remedy = format!("`{PROGRAM} --port {}` says why, if it was not closed", self.port);
            misuse(format!("viewer at port {}", self.port), what, remedy)
        })
    }
}
