//! Rerun importer: shows the audit of a log opened in the Rerun viewer. The viewer (0.36 to 0.41) runs the
//! programs `rerun-importer-*` on the PATH for each opened file, for MCAP in addition to its own reader,
//! with the file and its recording as arguments
//! (<https://rerun.io/docs/concepts/logging-and-ingestion/importers/overview>). The program writes a
//! recording to stdout.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use poseaudit::Options;
use poseaudit::boundary::ReportingAllocator;
use poseaudit::output::replay::Recording;

#[global_allocator]
static MEMORY: ReportingAllocator = ReportingAllocator;

/// Not a log, or nothing to add.
const INCOMPATIBLE: u8 = 66;

fn main() -> ExitCode {
    let Some(call) = Call::of(std::env::args_os().skip(1)) else {
        eprintln!("error: no file given; the Rerun viewer calls this program with one");
        return ExitCode::from(2);
    };
    match call.import() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(INCOMPATIBLE),
        Err(error) => {
            eprintln!("error: {}: cannot send the recording: {error}", call.log.display());
            ExitCode::FAILURE
        }
    }
}

#[derive(Debug, PartialEq, Eq)]
struct Call {
    log: PathBuf,
    application: Option<String>,
    recording: Option<String>,
}

impl Call {
    /// Ignores irrelevant and unknown options.
    fn of(arguments: impl Iterator<Item = OsString>) -> Option<Self> {
        let mut call = Self { log: PathBuf::new(), application: None, recording: None };
        let mut arguments = arguments.peekable();
        let mut opened = (None, None);
        while let Some(argument) = arguments.next() {
            let name = argument.to_string_lossy().into_owned();
            if !name.starts_with("--") {
                if call.log.as_os_str().is_empty() {
                    call.log = argument.into();
                }
                continue;
            }
            let (name, value) = match name.split_once('=') {
                Some((name, value)) => (name.to_owned(), Some(value.to_owned())),
                None => {
                    let value = arguments.next_if(|next| !next.to_string_lossy().starts_with("--"));
                    (name, value.map(|value| value.to_string_lossy().into_owned()))
                }
            };
            match name.as_str() {
                "--application-id" => call.application = value,
                "--recording-id" => call.recording = value,
                "--opened-application-id" => opened.0 = value,
                "--opened-recording-id" => opened.1 = value,
                _ => {}
            }
        }
        // Layers belong to the recording that is open, if any.
        let Self { log, application, recording } = call;
        let call =
            Self { log, application: opened.0.or(application), recording: opened.1.or(recording) };
        (!call.log.as_os_str().is_empty()).then_some(call)
    }

    /// `false` if nothing was recorded.
    fn import(&self) -> io::Result<bool> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("audit.rrd");
        let recording = Recording {
            path: path.clone(),
            application: self.application.clone(),
            id: self.recording.clone(),
            shares_log_timelines: true,
            ..Recording::default()
        };
        let options = Options { logs: vec![self.log.clone()], ..Options::default() };
        let Ok(mut audited) = poseaudit::audit(&options) else { return Ok(false) };
        if audited.report.error.is_some() || audited.record(&recording).is_err() {
            return Ok(false);
        }
        let mut stdout = io::stdout().lock();
        io::copy(&mut File::open(&path)?, &mut stdout)?;
        stdout.flush()?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(arguments: &[&str]) -> Option<Call> {
        Call::of(arguments.iter().map(OsString::from))
    }

    #[test]
    fn the_recording_that_is_open_stands_before_a_new_one() {
        let arguments = ["run.mcap", "--application-id", "a", "--recording-id", "b"];
        let some = |text: &str| Some(text.to_owned());
        let fresh = Call { log: "run.mcap".into(), application: some("a"), recording: some("b") };
        assert_eq!(call(&arguments), Some(fresh));
        let opened = Call { log: "run.mcap".into(), application: some("c"), recording: some("d") };
        let all = [&arguments[..], &["--opened-application-id=c", "--opened-recording-id", "d"]];
        assert_eq!(call(&all.concat()), Some(opened));
    }

    #[test]
    fn options_of_no_use_are_passed_over() {
        let only = Call { log: "run.mcap".into(), application: None, recording: None };
        assert_eq!(call(&["run.mcap", "--static", "--entity-path-prefix", "x"]), Some(only));
        assert_eq!(call(&["--static"]), None);
    }
}
