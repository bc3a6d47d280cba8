//! Audits robot-arm pose logs.
//!
//! poseaudit reads one recorded run of a robot arm, recomputes by forward kinematics where the arm
//! must have been, and says which of the recorded poses, stamps and conventions cannot be right, by
//! how much, and how sure it is.
//!
//! ```no_run
//! let options = poseaudit::Options { logs: vec!["run.mcap".into()], ..Default::default() };
//! let report = poseaudit::audit(&options)?;
//! for finding in &report.findings {
//!     println!("{} {}", finding.code, finding.message);
//! }
//! # Ok::<(), poseaudit::report::Trouble>(())
//! ```
//!
//! Data walks one way: bytes → [`log`] → [`run`] → [`diagnosis`] → [`checks`] → [`report`].
//! [`robot`] feeds the diagnosis; [`stream`], [`geometry`] and [`time`] are the ground floor.
//! Beside it, [`desk`] says what single poses are.
#![warn(missing_docs)]

#[cfg(test)]
mod any_log;
mod audit;
mod demo;
mod recording;

pub mod boundary;
pub mod checks;
pub mod compare;
pub mod config;
pub mod corrections;
pub mod desk;
pub mod diagnosis;
pub mod finding;
pub mod fleet;
pub mod geometry;
pub mod log;
pub mod places;
pub mod replay;
pub mod report;
pub mod robot;
pub mod run;
pub mod stats;
pub mod stream;
pub mod synth;
pub mod tables;
pub mod time;

pub use audit::Options;
pub use demo::{DEMO_LOG, Demo, Planted, demo};

use std::path::PathBuf;

use corrections::{Corrections, Given};
use log::ReadOptions;
use places::Places;
use report::{Report, Trouble};
use run::{Run, RunOptions};

/// Audits one run.
///
/// # Errors
/// Where the call is wrong or the log cannot be read. A log without an arm or a model is reported
/// on, with the trouble in [`Report::error`].
pub fn audit(options: &Options) -> Result<Report, Trouble> {
    Places::of(options).check()?;
    let how = ReadOptions {
        verify: options.verify,
        max_unpacked_gib: options.max_unpacked_gib,
        progress: options.progress.as_deref(),
    };
    let corrections = options.corrections.as_deref().map(Corrections::from_file).transpose()?;
    let given = corrections.as_ref().zip(options.corrections.as_deref());
    let given = given.map(|(corrections, file)| Given { corrections, file });
    let mut log = log::open(&options.logs, &how)?;
    let mut read = audit::Read::of(&log);
    if let Some(given) = &given {
        given.shift(&mut log)?;
        read.note_corrections(given);
    }
    let audits = audit::Audits::of(log, &read, options, given)?;
    let mut report = audits.report(read, options);
    if options.figures {
        report.figures = Some(audits.figures(&report));
    }
    if let Some(recording) = &options.recording {
        let main = audits.main();
        let notes = recording::record(recording, &main.run, &main.facts, &report)?;
        report.log.notes.extend(notes);
    }
    if let Some(folder) = &options.tables {
        let main = audits.main();
        audit::write_tables(folder, &main.run, &main.facts, &report)?;
    }
    if let Some(folder) = &options.fix {
        audits.write_fixes(&report, options, folder)?;
    }
    // To give back the columns of a long log takes as long as to write the report on it.
    rayon::spawn(|| drop(audits));
    Ok(report)
}

/// What a log holds: its topics, and which role each gets and why. Nothing is audited.
///
/// # Errors
/// Where the log cannot be read.
pub fn info(logs: &[PathBuf], how: &ReadOptions<'_>) -> Result<Report, Trouble> {
    let log = log::open(logs, how)?;
    let read = audit::Read::of(&log);
    let options = RunOptions::default();
    let mut run = Run::assemble(log, &options).map_err(|error| Trouble::from(&error))?;
    audit::settle(&mut run, options.max_latency_s);
    audit::settle_hands(&mut run, options.max_latency_s);
    Ok(audit::summary(&run, read))
}
