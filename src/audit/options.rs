//! What to audit, and how.

use std::path::PathBuf;

use crate::checks::Settings;
use crate::finding::Severity;
use crate::log::ReadOptions;
use crate::places::Places;
use crate::run::{RobotSource, RunOptions};

/// What to audit, and how.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The files of one run.
    pub logs: Vec<PathBuf>,
    /// How they are read.
    pub read: ReadOptions,
    /// What is said of the run.
    pub run: RunOptions,
    /// A file of corrections, which are applied to the streams before anything is judged.
    pub corrections: Option<PathBuf>,
    /// The config that settings were taken from, to be named in the report.
    pub config: Option<PathBuf>,
    /// What counts as wrong.
    pub policy: Policy,
}

/// What counts as wrong.
#[derive(Clone, Debug)]
pub struct Policy {
    /// Which rules are asked, and from where on they object.
    pub rules: Settings,
    /// Findings of this severity or above fail the run; `None`: none does.
    pub fail_on: Option<Severity>,
    /// Whether a verdict that is inconclusive fails the run, too.
    pub fail_on_inconclusive: bool,
}

impl Default for Policy {
    fn default() -> Self {
        let rules = Settings::default();
        Self { rules, fail_on: Some(Severity::Warning), fail_on_inconclusive: false }
    }
}

impl Options {
    /// The files that the audit reads.
    pub fn places(&self) -> Places {
        let mut places = Places::default();
        self.logs.iter().for_each(|log| places.reads_log(log));
        // What is no file is a name of the catalogue.
        let robots = self.run.robots.iter().filter_map(RobotSource::file);
        robots.for_each(|robot| places.reads("the robot", robot));
        let calibrations = self.run.calibrations.iter();
        calibrations.for_each(|one| places.reads("the calibration", &one.file));
        self.config.iter().for_each(|config| places.reads("the config", config));
        self.corrections.iter().for_each(|file| places.reads("the corrections", file));
        places
    }
}
