//! Audits robot-arm pose logs.
//!
//! poseaudit reads one recorded run of a robot arm, recomputes by forward kinematics where the arm
//! must have been, and finds wrong poses, timestamps and conventions, by
//! how much, and how sure it is.
//!
//! ```no_run
//! let options = poseaudit::Options { logs: vec!["run.mcap".into()], ..Default::default() };
//! let audited = poseaudit::audit(&options)?;
//! for finding in &audited.report.findings {
//!     println!("{} {}", finding.code, finding.message);
//! }
//! audited.write_fixes("mend".as_ref())?;
//! # Ok::<(), poseaudit::report::Trouble>(())
//! ```
//!
//! Data walks one way: bytes → [`log`] → [`run`] → [`evidence`] → [`checks`] → [`report`] → [`output`].
//! [`diagnosis`] estimates, [`robot`] feeds it; [`stream`], [`geometry`] and [`time`] are the ground floor.
//! Beside it, [`desk`] says what single poses are.
// Items say units and frames, and nothing that came from a file ends in a panic.
#![warn(missing_docs, clippy::unwrap_used)]
#![cfg_attr(
    not(all(feature = "fix", feature = "recording", feature = "tables")),
    allow(dead_code, unused_imports, reason = "the outputs read it")
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
    Audited, Calibrated, DEMO_LOG, Demo, Options, Planted, Policy, Taken, calibrate, demo,
};
pub use report::compare;

use corrections::{Corrections, Given};
use report::{Report, Trouble};
use run::Run;

/// Audits one run, and writes nothing.
///
/// # Errors
/// Where the call is wrong or the log cannot be read. A log without an arm or a model is reported
/// on, with the trouble in [`Report::error`].
pub fn audit(options: &Options) -> Result<Audited, Trouble> {
    options.places().check()?;
    let corrections = options.corrections.as_deref().map(Corrections::from_file).transpose()?;
    let given = corrections.as_ref().zip(options.corrections.as_deref());
    let given = given.map(|(corrections, file)| Given { corrections, file });
    let mut log = log::open(&options.logs, &options.read)?;
    if let Some(given) = &given {
        given.shift(&mut log)?;
    }
    Audited::of(log, options, given)
}

/// Audits what was read of a log that is still being written ([`log::Follow`]). Corrections are not applied.
///
/// # Errors
/// Where the call is wrong. A log without an arm or a model is reported on.
pub fn audit_read(log: log::Log, options: &Options) -> Result<Audited, Trouble> {
    Audited::of(log, options, None)
}

/// What a log holds: its topics, and which role each gets and why. Nothing is audited.
///
/// # Errors
/// Where the log cannot be read.
pub fn info(options: &Options) -> Result<Report, Trouble> {
    let mut log = log::open(&options.logs, &options.read)?;
    run::tell_columns(&mut log, &options.run);
    let read = audit::Read::of(&log);
    let run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()))?;
    Ok(audit::summary(&run, read))
}
