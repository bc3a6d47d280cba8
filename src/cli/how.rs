//! How a log is audited, as every command that audits with options takes it.

use std::path::{Path, PathBuf};

use poseaudit::checks::Selector;
use poseaudit::config::{self, ClockName, Config, FILE_NAME};
use poseaudit::log::is_url;
use poseaudit::report::Trouble;
use poseaudit::run::{CalibrationSource, Declaration, JointName, RobotSource, RunOptions};

use super::{misuse, say};

/// In the place of a config: it is looked for.
const AUTO: &str = "auto";

/// The options that say so.
#[derive(Clone, Debug, clap::Args)]
pub struct How {
    /// The robot's URDF or DH table, or its name in the catalogue; PREFIX=FILE with several arms
    #[arg(long = "robot", value_name = "FILE|NAME")]
    robots: Vec<RobotSource>,

    /// What `calibrate` wrote, or a UR's calibration as ur_calibration extracts it; PREFIX=FILE with
    /// several arms
    #[arg(long = "calibration", value_name = "FILE")]
    calibrations: Vec<CalibrationSource>,

    /// Joints that the log and the model name otherwise [default: matched by name, else by order]
    #[arg(long, value_name = "LOG=MODEL", value_delimiter = ',')]
    joint_map: Vec<JointName>,

    /// Link that the chain begins at
    #[arg(long, value_name = "LINK")]
    base: Option<String>,

    /// End link; the pose streams are assumed to be this link's pose
    #[arg(long, value_name = "LINK")]
    tip: Option<String>,

    /// Config file (TOML): robot, topics, thresholds, ignored findings; auto: the poseaudit.toml in the
    /// folder of the log, or in the nearest above it
    #[arg(long, value_name = "FILE|auto")]
    config: Option<PathBuf>,

    /// Run only these rules: codes or prefixes, as in LAT,ZER001
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    select: Vec<Selector>,

    /// Do not run these rules
    #[arg(long, value_name = "CODES", value_delimiter = ',')]
    ignore: Vec<Selector>,

    /// Exit with 1 from findings of this severity, or where the verdict is open, too [default: warning]
    #[arg(long, value_enum, value_name = "SEVERITY")]
    fail_on: Option<config::FailOn>,

    /// The time that places a sample; streams without header stamps fall back to log time [default:
    /// header]
    #[arg(long, value_enum, value_name = "CLOCK")]
    stamp: Option<ClockName>,

    /// Largest latency in seconds; what is off by more is on another clock [default: 5]
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    max_latency: Option<f64>,

    /// Check every checksum in the files
    #[arg(long)]
    verify: bool,

    /// Unpack up to this much of a file; without it 16 GiB and 2000 times its size
    #[arg(long, value_name = "GIB")]
    max_unpacked: Option<u32>,

    /// How a stream is coded: rotvec, euler:SEQ, quat:xyzw, quat:wxyz, or a maker such as kuka
    #[arg(long, value_name = "TOPIC=CONVENTION[,deg][,mm]")]
    declare: Vec<Declaration>,
}

pub fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a number of seconds above 0".to_owned()),
    }
}

impl How {
    /// Takes the config that is nearest to the logs where the command line says `--config auto`.
    ///
    /// # Errors
    /// Where there is none, or not one for all logs.
    pub fn find_config(&mut self, logs: &[impl AsRef<Path>]) -> Result<(), Trouble> {
        if self.config.as_deref() != Some(Path::new(AUTO)) {
            return Ok(());
        }
        let refused = |what: String| {
            let remedy =
                format!("name the file with --config {FILE_NAME}, or leave the option out");
            Err(misuse("--config auto", what, remedy))
        };
        let mut found: Vec<PathBuf> = Vec::new();
        for log in logs.iter().map(AsRef::as_ref) {
            if is_url(log) || log == Path::new("-") {
                return refused(format!("{} is in no folder", log.display()));
            }
            match Config::nearest_to(&before_wildcards(log)) {
                Some(file) if found.contains(&file) => {}
                Some(file) => found.push(file),
                None => {
                    let place = log.display();
                    return refused(format!("there is no {FILE_NAME} beside {place} or above it"));
                }
            }
        }
        match found.as_slice() {
            [file] => say::detail("config", || file.display().to_string()),
            [first, second, ..] => {
                let (first, second) = (first.display(), second.display());
                return refused(format!("the logs have several: {first} and {second}"));
            }
            [] => {}
        }
        self.config = found.pop();
        Ok(())
    }

    /// The files that the command line names, before the config is read.
    pub fn named(&self) -> poseaudit::Options {
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

    /// The options of an audit: those of the config, overridden by the command line.
    ///
    /// # Errors
    /// Where the config cannot be read.
    pub fn options(self) -> Result<poseaudit::Options, Trouble> {
        let config = self.config.as_deref().map(Config::from_file).transpose()?;
        let mut options = config.as_ref().map(Config::options).unwrap_or_default();
        let (run, policy) = (&mut options.run, &mut options.policy);
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
        run.stamp = self.stamp.map_or(run.stamp, Into::into);
        run.max_latency_s = self.max_latency.unwrap_or(run.max_latency_s);
        // A declaration is of one topic: what the config says of others stands.
        run.declared.retain(|of| !self.declare.iter().any(|said| said.is_of(&of.topic)));
        run.declared.splice(..0, self.declare);
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

/// The folders of a pattern that are named in full.
fn before_wildcards(pattern: &Path) -> PathBuf {
    let is_plain = |part: &std::path::Component<'_>| {
        !part.as_os_str().to_string_lossy().contains(['*', '?', '[', '{'])
    };
    match pattern.exists() {
        true => pattern.to_owned(),
        false => pattern.components().take_while(is_plain).collect(),
    }
}

/// What was given, else `other`.
pub fn first<T>(given: Vec<T>, other: Vec<T>) -> Vec<T> {
    if given.is_empty() { other } else { given }
}
