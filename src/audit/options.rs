use std::path::PathBuf;

use bytes::Bytes;

use crate::checks::Settings;
use crate::finding::Severity;
use crate::log::ReadOptions;
use crate::places::PathRegistry;
use crate::report::Trouble;
use crate::run::{RobotSource, RunOptions};

/// Input and settings of an audit.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Files of one run.
    pub logs: Vec<PathBuf>,
    /// Read options.
    pub read: ReadOptions,
    /// Settings for the run.
    pub run: RunOptions,
    /// Corrections applied to the streams before the audit.
    pub corrections: Option<PathBuf>,
    /// Origin of the settings, for the report.
    pub config: Option<PathBuf>,
    /// Criteria for failure.
    pub policy: Policy,
}

/// Criteria for failure.
#[derive(Clone, Debug)]
pub struct Policy {
    /// Selection and thresholds.
    pub rules: Settings,
    /// Lowest severity that fails the run; `None` for none.
    pub fail_on: Option<Severity>,
    /// An inconclusive verdict fails the run.
    pub fail_on_inconclusive: bool,
}

impl Default for Policy {
    fn default() -> Self {
        let rules = Settings::default();
        Self { rules, fail_on: Some(Severity::Warning), fail_on_inconclusive: false }
    }
}

impl Options {
    /// Sets the logs to files in memory, by name.
    ///
    /// # Errors
    /// If two have the same name.
    pub fn with_given(mut self, logs: Vec<(PathBuf, Bytes)>) -> Result<Self, Trouble> {
        self.logs = logs.iter().map(|(name, _)| name.clone()).collect();
        self.read.given = logs.into_iter().collect();
        match self.logs.len() == self.read.given.len() {
            true => Ok(self),
            false => Err(Trouble::call(
                "the files",
                "two files have the same name",
                "use a different name for each",
            )),
        }
    }

    /// Files that the audit reads.
    pub fn places(&self) -> PathRegistry {
        let mut places = PathRegistry::default();
        self.logs.iter().for_each(|log| places.add_log(log));
        // Other robots are catalogue names.
        let robots = self.run.robots.iter().filter_map(RobotSource::file);
        robots.for_each(|robot| places.add_input("the robot", robot));
        let calibrations = self.run.calibrations.iter();
        calibrations.for_each(|one| places.add_input("the calibration", &one.file));
        self.config.iter().for_each(|config| places.add_input("the config", config));
        self.corrections.iter().for_each(|file| places.add_input("the corrections", file));
        places
    }
}
