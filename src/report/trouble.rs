use std::fmt::Display;
use std::io::ErrorKind;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::log::{
    CONFIGURATION_COLUMNS_REMEDY, LogError, POSE_TIMES_REMEDY, SourceName, rate_remedy,
};
use crate::run::RunError;

/// Why a call or a log cannot be processed, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, thiserror::Error)]
#[error("{place}: {what}; {remedy}")]
pub struct Trouble {
    /// Origin of the error.
    #[serde(skip)]
    pub kind: TroubleKind,
    /// The problem.
    pub what: String,
    /// Location: a file, a topic or an option.
    #[serde(rename = "where")]
    pub place: String,
    /// Suggested action.
    #[serde(rename = "do")]
    pub remedy: String,
}

/// Origin of a [`Trouble`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TroubleKind {
    /// An option or a missing file.
    Call,
    /// Unreadable, without an arm, or without its model.
    #[default]
    Log,
}

impl Trouble {
    /// An option or a file that the call names.
    pub fn call(place: impl Display, what: impl Display, remedy: impl Display) -> Self {
        Self { kind: TroubleKind::Call, ..Self::log(place, what, remedy) }
    }

    /// A log.
    pub fn log(place: impl Display, what: impl Display, remedy: impl Display) -> Self {
        Self {
            kind: TroubleKind::Log,
            what: what.to_string(),
            place: place.to_string(),
            remedy: remedy.to_string(),
        }
    }
}

impl From<RunError> for Trouble {
    fn from(error: RunError) -> Self {
        Self::from(&error)
    }
}

impl From<&RunError> for Trouble {
    fn from(error: &RunError) -> Self {
        let kind = match error {
            RunError::NoJointStates { .. }
            | RunError::NoSamples { .. }
            | RunError::NoModel { .. }
            | RunError::Ambiguous { .. }
            | RunError::Undistinguished { .. }
            | RunError::Numbered { .. }
            | RunError::SameMotion { .. }
            | RunError::UnknownJoints { .. }
            | RunError::TimeOrigins { .. }
            | RunError::MissingJoints { .. } => TroubleKind::Log,
            RunError::UnknownRobot { .. }
            | RunError::Robot(_)
            | RunError::Calibration(_)
            | RunError::CalibrationOf { .. }
            | RunError::UnknownLink { .. }
            | RunError::Chain(_)
            | RunError::JointMap { .. }
            | RunError::Declared { .. } => TroubleKind::Call,
        };
        let remedy = error.remedy().to_owned();
        Trouble { kind, what: error.what(), place: error.place(), remedy }
    }
}

impl From<LogError> for Trouble {
    fn from(error: LogError) -> Self {
        let kind = match error {
            LogError::NotFound { .. }
            | LogError::Twice { .. }
            | LogError::Temporary { .. }
            | LogError::Layout { .. } => TroubleKind::Call,
            LogError::Remote { ref fault, .. } if fault.is_of_the_call() => TroubleKind::Call,
            _ => TroubleKind::Log,
        };
        let another = "pass a log that a recorder wrote";
        let of_rate = match error {
            LogError::NoTimes { rows, numbers, .. } => rate_remedy(rows, numbers),
            _ => String::new(),
        };
        let (path, what, remedy) = match error {
            LogError::NotFound { path } => (path, "no such file".to_owned(), another),
            LogError::Permission { path } => {
                (path, "permission denied".to_owned(), "make it readable")
            }
            LogError::Directory { path, cause } => {
                (path, format!("it is a directory {cause}"), "pass the log files in it")
            }
            LogError::Runs { path } => (
                path,
                "it is a directory with logs of several runs, or of one without its metadata.yaml"
                    .to_owned(),
                "audit several runs with `poseaudit fleet FOLDER --out DIR`, or pass the files of one",
            ),
            LogError::Twice { path, first } => {
                (path, format!("it is the same as {}", first.display()), "name it once")
            }
            LogError::NotAFile { path } => {
                (path, "it is not a regular file".to_owned(), "save the log to a file first")
            }
            LogError::Io { path, source } => {
                let remedy = match source.kind() {
                    ErrorKind::OutOfMemory => "allow more memory",
                    _ => another,
                };
                (path, format!("it cannot be read: {source}"), remedy)
            }
            LogError::Empty { path } => (
                path,
                "the file is empty (0 bytes)".to_owned(),
                "check whether the recorder wrote it",
            ),
            LogError::Unsupported { path, looks, instead } => {
                (path, format!("it is {looks}, which is not supported"), instead)
            }
            LogError::NotALog { path, looks } => (
                path,
                format!("not a robot log: it looks like {looks}"),
                "name an MCAP file, a bag or a table (CSV, TUM, NPY, NPZ, Parquet, HDF5)",
            ),
            LogError::Columns { path, what } => (
                path,
                what,
                "declare it with --columns, or in [columns] of the config (docs/datasets.md)",
            ),
            LogError::NoTimes { path, what, .. } => (path, what, of_rate.as_str()),
            LogError::Layout { path, what } => {
                (path, what, "correct --columns; `_` ignores a column (docs/datasets.md)")
            }
            LogError::Configurations { path, what, remedy } => (path, what, remedy),
            LogError::ConfigurationColumns { path, what } => {
                (path, what, CONFIGURATION_COLUMNS_REMEDY)
            }
            LogError::PoseTimes { path, what } => (path, what, POSE_TIMES_REMEDY),
            LogError::Episodes { path, most } => (
                path,
                format!("it holds more than {most} episodes"),
                "select one as FILE#EPISODE, or audit each with `poseaudit fleet`",
            ),
            LogError::NoMessages { path, cause } => (
                path,
                format!("no messages can be read: {cause}"),
                "correct the file, or record again",
            ),
            LogError::Temporary { path, source } => {
                let folder = std::env::temp_dir();
                let what = format!("it cannot be unpacked in {}: {source}", folder.display());
                (path, what, "free some space, or set TMPDIR to another folder")
            }
            LogError::Remote { url, fault } => (url, fault.to_string(), fault.remedy()),
        };
        let (place, remedy) = (SourceName::from_path(&path).to_string(), remedy.to_owned());
        Trouble { kind, what, place, remedy }
    }
}
