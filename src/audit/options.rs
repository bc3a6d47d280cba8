//! What to audit, and how.

use std::path::PathBuf;
use std::sync::Arc;

use crate::checks::Settings;
use crate::finding::Severity;
use crate::log::Progress;
use crate::replay::Recording;
use crate::run::{CalibrationSource, Declaration, RobotSource, RunOptions, TopicSettings};
use crate::time::Clock;

/// What to audit, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// The files of one run.
    pub logs: Vec<PathBuf>,
    /// The robots in it; where none is named, the log is asked and then the catalogue.
    pub robots: Vec<RobotSource>,
    /// Calibrations of the URs among them; where none is named, the log may hold one.
    pub calibrations: Vec<CalibrationSource>,
    /// The link that the chain begins at.
    pub base: Option<String>,
    /// The link that it ends at.
    pub tip: Option<String>,
    /// The time that places a sample.
    pub stamp: Clock,
    /// The largest latency that is sought, s; what is off by more is on another clock.
    pub max_latency_s: f64,
    /// Whether every checksum in the files is checked.
    pub verify: bool,
    /// What the compressed parts of a file may unpack to, GiB, where that is more than 16 GiB and 2000 times
    /// its size.
    pub max_unpacked_gib: Option<u32>,
    /// How the rotations of single streams are coded.
    pub declarations: Vec<Declaration>,
    /// What else is said of single topics.
    pub topics: Vec<TopicSettings>,
    /// The config that all this was taken from, to be named in the report.
    pub config: Option<PathBuf>,
    /// A file of corrections, which are applied to the streams before anything is judged.
    pub corrections: Option<PathBuf>,
    /// The folder to write what mends the findings into. Where `corrections` are applied that is what
    /// they leave, to be mended after them.
    pub fix: Option<PathBuf>,
    /// Which rules are asked.
    pub rules: Settings,
    /// Findings of this severity or above fail the run; `None`: none does.
    pub fail_on: Option<Severity>,
    /// Whether a verdict that is inconclusive fails the run, too.
    pub fail_on_inconclusive: bool,
    /// The recording for the Rerun viewer to write.
    pub recording: Option<Recording>,
    /// The folder to write tables into, as Parquet.
    pub tables: Option<PathBuf>,
    /// Whether the report carries what its pictures show.
    pub figures: bool,
    /// Kept up to date while the files are read.
    pub progress: Option<Arc<Progress>>,
}

impl Default for Options {
    fn default() -> Self {
        let run = RunOptions::default();
        Self {
            logs: Vec::new(),
            robots: run.robots,
            calibrations: run.calibrations,
            base: run.base,
            tip: run.tip,
            stamp: run.stamp,
            max_latency_s: run.max_latency_s,
            verify: false,
            max_unpacked_gib: None,
            declarations: run.declared,
            topics: run.topics,
            config: None,
            corrections: None,
            fix: None,
            rules: Settings::default(),
            fail_on: Some(Severity::Warning),
            fail_on_inconclusive: false,
            recording: None,
            tables: None,
            figures: false,
            progress: None,
        }
    }
}

impl Options {
    /// The part that concerns the run.
    pub(crate) fn run(&self) -> RunOptions {
        RunOptions {
            robots: self.robots.clone(),
            calibrations: self.calibrations.clone(),
            base: self.base.clone(),
            tip: self.tip.clone(),
            stamp: self.stamp,
            max_latency_s: self.max_latency_s,
            declared: self.declarations.clone(),
            topics: self.topics.clone(),
        }
    }
}
