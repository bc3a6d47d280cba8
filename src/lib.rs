//! Audits robot-arm pose logs: reads one recorded run, recomputes its poses by forward kinematics, and
//! finds wrong poses, timestamps and conventions, with size and uncertainty.
//!
//! ```no_run
//! let options = poseaudit::Options { logs: vec!["run.mcap".into()], ..Default::default() };
//! let audited = poseaudit::audit(&options)?;
//! for finding in &audited.report.findings {
//!     println!("{} {}", finding.code, finding.message);
//! }
//! audited.write_fixes("corrections".as_ref())?;
//! # Ok::<(), poseaudit::report::Trouble>(())
//! ```
//!
//! Data flows in one direction: bytes → [`log`] → [`run`] → [`evidence`] → [`checks`] → [`report`] →
//! [`output`]. [`diagnosis`] estimates causes with models of [`robot`]. [`stream`], [`geometry`] and
//! [`time`] are the base modules. [`desk`] converts and compares single poses.
// Public items document units and frames; input must not cause a panic.
#![warn(missing_docs, clippy::unwrap_used)]
#![cfg_attr(
    not(all(feature = "fix", feature = "recording", feature = "tables")),
    allow(dead_code, unused_imports, reason = "used by the output features")
)]

mod audit;

pub mod checks;
pub mod config;
pub mod corrections;
pub mod desk;
pub mod evidence;
pub mod finding;
#[cfg(feature = "tables")]
pub mod fleet;
pub mod output;
pub mod places;
pub mod report;
pub mod run;
pub mod synth;

pub use ground::{boundary, geometry, robot, stats, stream, time};
pub use poseaudit_diagnosis as diagnosis;
pub use poseaudit_log as log;

pub use audit::{
    Audited, CalibrationInput, CalibrationResult, DEMO_LOG, DEMO_PAIR_LOG, Demo, Measurement,
    Options, PlantedFault, Policy, calibrate, calibrate_at_fixed_points, demo, demo_pair, prepare,
};
pub use report::compare;

use corrections::{Corrections, GivenCorrections};
use report::{Report, Trouble};
use run::Run;

/// Audits one run without writing files.
///
/// # Errors
/// If the call is invalid or the log cannot be read. Without an arm or a model, [`Report::error`] is set
/// instead.
pub fn audit(options: &Options) -> Result<Audited, Trouble> {
    options.places().check()?;
    let corrections = options.corrections.as_deref().map(Corrections::from_file).transpose()?;
    let given = corrections.as_ref().zip(options.corrections.as_deref());
    let given = given.map(|(corrections, file)| GivenCorrections { corrections, file });
    let mut log = audit::open(options)?;
    audit::prepare_corrected(&mut log, &options.run, given.as_ref())?;
    Audited::audit(log, options, given)
}

/// Audits the data so far of a growing log ([`log::LogFollower`]), without corrections.
///
/// # Errors
/// If the call is invalid. Without an arm or a model, the report has the error.
pub fn audit_read(mut log: log::Log, options: &Options) -> Result<Audited, Trouble> {
    prepare(&mut log, &options.run)?;
    audit_prepared(log, options)
}

/// Audits a log after [`prepare`], without corrections.
///
/// # Errors
/// As [`audit_read`].
pub fn audit_prepared(log: log::Log, options: &Options) -> Result<Audited, Trouble> {
    Audited::audit(log, options, None)
}

/// Lists the topics of a log with their roles, without an audit. If the rows of a table have no times, the report lists
/// its columns, and [`Report::error`] asks for the rate.
///
/// # Errors
/// If the log cannot be read.
pub fn info(options: &Options) -> Result<Report, Trouble> {
    let (mut log, missing_rate) = audit::open_listing(options)?;
    if let Err(error) = prepare(&mut log, &options.run) {
        return Err(missing_rate.unwrap_or(error));
    }
    let read = audit::ReadLog::from_log(&log);
    let run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()))?;
    let report = audit::summarize(&run, read);
    Ok(match missing_rate {
        Some(trouble) => report.without_stamps().with_trouble(trouble),
        None => report,
    })
}
