//! Finds the Rerun viewer and opens one recording or a sequence.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::{env, fs, io};

use poseaudit::report::Trouble;
use tempfile::TempPath;

use super::{find_program, misuse};

pub const VIEW_OPTION: &str = "--view";

const PROGRAM: &str = "rerun";

/// Finds the viewer for an option. Fails if it is not on the PATH.
pub fn find_viewer(option: &str) -> Result<PathBuf, Trouble> {
    find_program(PROGRAM, None).ok_or_else(|| {
        let remedy = "install it with `pip install rerun-sdk==0.36.*`, or write a file with --rrd";
        misuse(option, format!("the viewer `{PROGRAM}` is not on the PATH"), remedy)
    })
}

/// File for an unnamed recording, readable only by this user. It outlives this program, so the viewer can
/// read it.
pub fn create_recording_file() -> Result<PathBuf, Trouble> {
    temporary_recording(VIEW_OPTION)?
        .keep()
        .map_err(|error| creation_trouble(VIEW_OPTION, &error.error))
}

/// Deleted when the returned path is dropped.
fn temporary_recording(option: &str) -> Result<TempPath, Trouble> {
    let made = tempfile::Builder::new().prefix("poseaudit-").suffix(".rrd").tempfile();
    made.map(tempfile::NamedTempFile::into_temp_path)
        .map_err(|error| creation_trouble(option, &error))
}

fn creation_trouble(option: &str, error: &io::Error) -> Trouble {
    let what = format!("cannot create a recording in {}: {error}", env::temp_dir().display());
    misuse(option, what, "free some space, or set TMPDIR to another folder")
}

/// Opens recordings together. Does not wait for the viewer to close.
pub fn open<'a>(
    viewer: &Path,
    recordings: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), Trouble> {
    let mut command = Command::new(viewer);
    let recordings: Vec<&PathBuf> = recordings.into_iter().collect();
    command.args(&recordings).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let started = command.spawn().map(drop);
    started.map_err(|error| {
        let files: Vec<String> = recordings.iter().map(|path| path.display().to_string()).collect();
        start_trouble(viewer, &error, format!("open {} manually", files.join(" and ")))
    })
}

fn start_trouble(viewer: &Path, error: &io::Error, remedy: impl Display) -> Trouble {
    misuse(viewer.display(), format!("the viewer cannot be started: {error}"), remedy)
}

/// Viewer for a sequence of recordings: the one listening on a local port, or a new one.
pub struct LiveViewer {
    /// Forwards its input to the listening viewer, or opens it.
    program: Child,
    port: u16,
    /// Next recording.
    recording: TempPath,
}

impl LiveViewer {
    /// Fails if the viewer cannot be started or no recording can be created.
    pub fn start(option: &str, port: u16) -> Result<Self, Trouble> {
        let (viewer, next) = (find_viewer(option)?, temporary_recording(option)?);
        let mut command = Command::new(&viewer);
        command.args(["--port", &port.to_string(), "-"]);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let remedy = "or write a file with --rrd";
        let program = command.spawn().map_err(|error| start_trouble(&viewer, &error, remedy))?;
        Ok(Self { program, port, recording: next })
    }

    /// Next recording.
    pub fn recording(&self) -> &Path {
        &self.recording
    }

    /// Shows that recording. Fails if the viewer does not accept it, for instance because it was closed.
    pub fn show(&mut self) -> Result<(), Trouble> {
        let Some(pipe) = &mut self.program.stdin else { return Ok(()) };
        let given = fs::File::open(&self.recording).and_then(|mut file| io::copy(&mut file, pipe));
        given.map(drop).map_err(|error| {
            let what = format!("does not accept recordings: {error}");
            let remedy =
                format!("if it was not closed, run `{PROGRAM} --port {}` to see why", self.port);
            misuse(format!("viewer at port {}", self.port), what, remedy)
        })
    }
}
