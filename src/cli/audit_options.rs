//! Options of an audit, shared by every command that audits.

use std::path::{Path, PathBuf};

use poseaudit::checks::Selector;
use poseaudit::config::{self, ClockName, Config, FILE_NAME};
use poseaudit::log::{FileLayout, is_url};
use poseaudit::report::Trouble;
use poseaudit::run::{CalibrationSource, Declaration, JointName, RobotSource, RunOptions};

use super::{messages, misuse};

const AUTO: &str = "auto";
/// Calibrations next to a config.
const CALIBRATION_FILES: [&str; 2] = ["calibration.json", "calibration.yaml"];

/// The audit options.
#[derive(Clone, Debug, clap::Args)]
pub struct AuditOptions {
    /// The robot's URDF or DH table, or its name in the catalogue; PREFIX=FILE with several arms
    #[arg(long = "robot", value_name = "FILE|NAME")]
    robots: Vec<RobotSource>,

    /// A calibration written by `calibrate`, or a UR calibration extracted by ur_calibration; PREFIX=FILE
    /// with several arms; auto: calibration.json or calibration.yaml next to the config
    #[arg(long = "calibration", value_name = "FILE|auto")]
    calibrations: Vec<CalibrationSource>,

    /// Map log joint names to model joint names [default: matched by name, else by order]
    #[arg(long, value_name = "LOG=MODEL", value_delimiter = ',')]
    joint_map: Vec<JointName>,

    /// Base link of the kinematic chain
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// Tip link; pose streams are assumed to be poses of this link
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// Pose topic that the others are compared with, if the log has no joint states [default: the one with the
    /// least noise]
    #[arg(long, value_name = "TOPIC")]
    reference: Option<String>,

    /// Config file (TOML): robot, topics, thresholds, ignored findings; auto: the nearest poseaudit.toml in
    /// the folder of the log or above
    #[arg(long, value_name = "FILE|auto")]
    config: Option<PathBuf>,

    /// Run only these rules: codes or prefixes, such as LAT,ZER001
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    select: Vec<Selector>,

    /// Do not run these rules
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    ignore: Vec<Selector>,

    /// Exit with 1 from this severity on; inconclusive: also for an inconclusive verdict [default: warning]
    #[arg(long, value_enum, value_name = "SEVERITY")]
    fail_on: Option<config::FailOn>,

    /// Clock of the samples; streams without header stamps fall back to log time [default: header]
    #[arg(long, value_enum, value_name = "CLOCK")]
    stamp: Option<ClockName>,

    /// Largest latency to search, in seconds; larger offsets are reported as clock errors [default: 5]
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    max_latency: Option<f64>,

    /// Check every checksum in the files
    #[arg(long)]
    verify: bool,

    /// Maximum unpacked size of a file; without it 16 GiB and 2000 times the file size
    #[arg(long, value_name = "GIB")]
    max_unpacked: Option<u32>,

    /// Meaning of every column of a table without names, in order, such as 't,q[6],qd[6],_[6],x,y,z,rotvec'; see
    /// docs/datasets.md. FILE=SPEC for one of several tables
    #[arg(long, value_name = "[FILE=]SPEC")]
    columns: Vec<FileLayout>,

    /// Encoding of a stream: rotvec, euler:SEQ, quat:xyzw, quat:wxyz, or a manufacturer such as kuka
    #[arg(long, value_name = "TOPIC=CONVENTION[,deg][,mm]")]
    declare: Vec<Declaration>,
}

pub fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a positive number of seconds".to_owned()),
    }
}

impl AuditOptions {
    /// Finds the config for `--config auto`, and the calibration for `--calibration auto`. Fails if no log has a
    /// config, the logs have different ones, or there is no calibration.
    pub fn find_config(&mut self, logs: &[impl AsRef<Path>]) -> Result<(), Trouble> {
        self.find_nearest_config(logs)?;
        self.find_calibration()
    }

    fn find_calibration(&mut self) -> Result<(), Trouble> {
        let is_auto = |source: &CalibrationSource| source.file == Path::new(AUTO);
        if !self.calibrations.iter().any(is_auto) {
            return Ok(());
        }
        let refused = |what: String, remedy: &str| Err(misuse("--calibration auto", what, remedy));
        let Some(config) = &self.config else {
            return refused("there is no config".to_owned(), "add --config FILE or --config auto");
        };
        let candidates = CALIBRATION_FILES.map(|name| config.with_file_name(name));
        let Some(file) = candidates.iter().find(|file| file.is_file()) else {
            return refused(
                format!(
                    "neither {} nor {} exists",
                    candidates[0].display(),
                    candidates[1].display()
                ),
                "write it with `poseaudit calibrate LOG --out FOLDER`, or omit the option",
            );
        };
        messages::print_detail("calibration", || file.display().to_string());
        for source in self.calibrations.iter_mut().filter(|source| is_auto(source)) {
            source.file.clone_from(file);
        }
        Ok(())
    }

    fn find_nearest_config(&mut self, logs: &[impl AsRef<Path>]) -> Result<(), Trouble> {
        if self.config.as_deref() != Some(Path::new(AUTO)) {
            return Ok(());
        }
        let refused = |what: String| {
            let remedy = format!("name the file with --config {FILE_NAME}, or omit the option");
            Err(misuse("--config auto", what, remedy))
        };
        let mut found: Vec<PathBuf> = Vec::new();
        for log in logs.iter().map(AsRef::as_ref) {
            if is_url(log) || log == Path::new("-") {
                return refused(format!("{} has no folder", log.display()));
            }
            match Config::nearest_to(&path_before_wildcards(log)) {
                Some(file) if found.contains(&file) => {}
                Some(file) => found.push(file),
                None => {
                    let place = log.display();
                    return refused(format!("no {FILE_NAME} in the folder of {place} or above"));
                }
            }
        }
        match found.as_slice() {
            [file] => messages::print_detail("config", || file.display().to_string()),
            [first, second, ..] => {
                let (first, second) = (first.display(), second.display());
                return refused(format!("the logs have different configs: {first} and {second}"));
            }
            [] => {}
        }
        self.config = found.pop();
        Ok(())
    }

    /// Files on the command line, before reading the config.
    pub fn options_without_config(&self) -> poseaudit::Options {
        poseaudit::Options {
            run: RunOptions {
                robots: self.robots.clone(),
                calibrations: self.calibrations.clone(),
                ..RunOptions::default()
            },
            config: self.config.clone(),
            ..poseaudit::Options::default()
        }
    }

    /// Options of the config, overridden by the command line.
    pub fn into_options(self) -> Result<poseaudit::Options, Trouble> {
        let config = self.config.as_deref().map(Config::from_file).transpose()?;
        let mut options = config.as_ref().map(Config::options).unwrap_or_default();
        let run = &mut options.run;
        if !self.robots.is_empty() {
            run.robots = self.robots;
        }
        if !self.calibrations.is_empty() {
            run.calibrations = self.calibrations;
        }
        if !self.joint_map.is_empty() {
            run.joint_map = self.joint_map;
        }
        run.base = self.base.or(run.base.take());
        run.tip = self.tip.or(run.tip.take());
        run.reference = self.reference.or(run.reference.take());
        run.stamp = self.stamp.map_or(run.stamp, Into::into);
        run.max_latency_s = self.max_latency.unwrap_or(run.max_latency_s);
        // Replaces the config's declaration of the same topic only.
        run.declared.retain(|config| !self.declare.iter().any(|given| given.is_of(&config.topic)));
        run.declared.splice(..0, self.declare);
        use_columns(&mut options, self.columns);
        let policy = &mut options.policy;
        if !self.select.is_empty() {
            policy.rules.select = self.select;
        }
        policy.rules.ignore = self.ignore;
        if let Some(fail_on) = self.fail_on {
            policy.fail_on = fail_on.into();
            policy.fail_on_inconclusive = fail_on == config::FailOn::Inconclusive;
        }
        options.read.verify = self.verify;
        options.read.max_unpacked_gib = self.max_unpacked;
        Ok(options)
    }
}

/// Replaces the layouts of the config.
pub fn use_columns(options: &mut poseaudit::Options, columns: Vec<FileLayout>) {
    if !columns.is_empty() {
        options.read.columns.layouts = columns;
    }
}

fn path_before_wildcards(pattern: &Path) -> PathBuf {
    let is_plain = |part: &std::path::Component<'_>| {
        !part.as_os_str().to_string_lossy().contains(['*', '?', '[', '{'])
    };
    match pattern.exists() {
        true => pattern.to_owned(),
        false => pattern.components().take_while(is_plain).collect(),
    }
}

pub fn first_non_empty<T>(given: Vec<T>, other: Vec<T>) -> Vec<T> {
    if given.is_empty() { other } else { given }
}
