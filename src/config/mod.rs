//! The config of an audit, `poseaudit.toml`: the robot, its topics and the thresholds of the rules.
//!
//! An audit reads only the file that the caller names, so the same call gives the same report everywhere.
//! `--config auto` uses the nearest `poseaudit.toml` in the log's folder or above.

mod file;
mod quantity;
mod read;
mod rules;
mod schema;
mod template;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use crate::audit::{Options, Policy};
use crate::checks::Exemption;
use crate::finding::Subject;
use crate::log::ReadOptions;
use crate::report::Trouble;
use crate::robot::catalogue;
use crate::run::{
    CalibrationSource, Declaration, JointName, RobotSource, RoleSetting, RunOptions, TopicSettings,
};

use self::file::{ByPrefix, ConfigFile, Ignore, Stream};

pub use crate::places::CONFIG_FILE_NAME as FILE_NAME;
pub use file::{ClockName, FailOn};
pub use schema::schema;
pub use template::template;

/// A parsed config.
#[derive(Clone, Debug)]
pub struct Config {
    file: ConfigFile,
    path: PathBuf,
    text: String,
}

impl Config {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// With the line, if it cannot be read or parsed.
    pub fn from_file(path: &Path) -> Result<Self, Trouble> {
        let text = read::read_text(path)?;
        Self::from_text(text, path)
    }

    /// The nearest config in the folder of `log` (or in `log`) or above.
    pub fn nearest_to(log: &Path) -> Option<PathBuf> {
        let parent = || log.parent().filter(|parent| *parent != Path::new(""));
        let folder = if log.is_dir() { log } else { parent().unwrap_or(Path::new(".")) };
        let folder = folder.canonicalize().ok()?;
        folder.ancestors().map(|folder| folder.join(FILE_NAME)).find(|file| file.is_file())
    }

    /// Parses the text of the file at `path`.
    ///
    /// # Errors
    /// With the line, if it cannot be parsed.
    pub fn from_text(text: String, path: &Path) -> Result<Self, Trouble> {
        let file = read::parse(&text, path)?;
        let config = Self { file, path: path.to_owned(), text };
        config.check_robots()?;
        Ok(config)
    }

    /// Options for an audit; unset keys keep their defaults.
    pub fn options(&self) -> Options {
        let ConfigFile { stamp, max_latency, fail_on, base, tip, reference, .. } = &self.file;
        let mut run = RunOptions {
            robots: self.robots(),
            calibrations: self.calibrations(),
            joint_map: self.joint_map(),
            base: base.clone(),
            tip: tip.clone(),
            reference: reference.clone(),
            declared: self.declarations(),
            topics: self.topics(),
            ..RunOptions::default()
        };
        if let Some(clock) = stamp {
            run.stamp = (*clock).into();
        }
        if let Some(latency) = max_latency {
            run.max_latency_s = latency.0;
        }
        let mut policy = Policy::default();
        if let Some(fail_on) = fail_on {
            policy.fail_on = (*fail_on).into();
            policy.fail_on_inconclusive = *fail_on == FailOn::Inconclusive;
        }
        policy.rules.select = self.file.select.iter().map(|code| code.0.clone()).collect();
        policy.rules.required = self.file.require.iter().map(|code| code.0.clone()).collect();
        policy.rules.exemptions = self.exemptions();
        self.file.rules.apply(&mut policy.rules);
        let read = ReadOptions { columns: self.file.columns.settings(), ..ReadOptions::default() };
        Options { read, run, policy, config: Some(self.path.clone()), ..Options::default() }
    }

    /// File and line.
    fn place(&self, at: usize) -> String {
        read::line_place(&self.path, &self.text, at)
    }

    /// Paths are relative to the config file.
    fn resolve_path(&self, path: &str) -> PathBuf {
        match self.path.parent() {
            Some(folder) if folder != Path::new("") => folder.join(path),
            _ => PathBuf::from(path),
        }
    }

    /// `None` if `model` is a catalogue name.
    fn robot_file(&self, model: &str) -> Option<PathBuf> {
        let path = self.resolve_path(model);
        let is_path =
            path.is_file() || Path::new(model).extension().is_some() || model.contains('/');
        is_path.then_some(path)
    }

    fn check_robots(&self) -> Result<(), Trouble> {
        let Some(robot) = &self.file.robot else { return Ok(()) };
        let is_unknown =
            |model: &str| self.robot_file(model).is_none() && catalogue::find(model).is_none();
        let unknown = robot.as_ref().all().into_iter().find(|(_, model)| is_unknown(model));
        let Some((_, model)) = unknown else { return Ok(()) };
        let nearest = match catalogue::nearest_names(model).first() {
            Some(name) => format!("; did you mean `{name}`?"),
            None => String::new(),
        };
        let what = format!("`{model}` is neither a file nor a catalogue arm{nearest}");
        let remedy = "name a URDF or TOML file, or an arm listed by `poseaudit robots`";
        Err(Trouble::call(self.place(robot.span().start), what, remedy))
    }

    fn robots(&self) -> Vec<RobotSource> {
        let all = self.file.robot.iter().flat_map(|robot| robot.as_ref().all());
        let source = |(prefix, model): (Option<&str>, &str)| RobotSource {
            prefix: prefix.map(str::to_owned),
            model: match self.robot_file(model) {
                Some(path) => path.display().to_string(),
                None => model.to_owned(),
            },
            text: None,
        };
        all.map(source).collect()
    }

    fn calibrations(&self) -> Vec<CalibrationSource> {
        let all = self.file.calibration.iter().flat_map(ByPrefix::all);
        let source = |(prefix, file): (Option<&str>, &str)| CalibrationSource {
            prefix: prefix.map(str::to_owned),
            file: self.resolve_path(file),
        };
        all.map(source).collect()
    }

    fn joint_map(&self) -> Vec<JointName> {
        let names = self.file.joint_map.iter();
        let name = |(logged, modelled): (&String, &String)| JointName {
            logged: logged.clone(),
            modelled: modelled.clone(),
        };
        names.map(name).collect()
    }

    fn declarations(&self) -> Vec<Declaration> {
        let streams = self.file.stream.iter();
        let declared = streams.filter_map(|(topic, Stream { table, coding })| {
            let (coding, units) = (*coding)?;
            Some(Declaration {
                topic: topic.as_ref().clone(),
                place: self.place(topic.span().start),
                coding,
                length: units.length.unwrap_or_default(),
                angle: units.angle.unwrap_or_default(),
                is_of_vendor: table.convention.is_none(),
            })
        });
        declared.collect()
    }

    fn topics(&self) -> Vec<TopicSettings> {
        let streams = self.file.stream.iter();
        let topic =
            |(topic, Stream { table, .. }): (&toml::Spanned<String>, &Stream)| TopicSettings {
                topic: topic.as_ref().clone(),
                place: self.place(topic.span().start),
                role: table.role,
                source_kind: table.witness,
                frame: table.frame.clone(),
                link: table.link.clone(),
                rate_hz: table.rate_hz.map(|rate| rate.0),
                vendor: table.vendor.as_ref().map(|vendor| vendor.0.description()),
                of_columns: false,
            };
        let mut topics: Vec<TopicSettings> = streams.map(topic).collect();
        // Audited as poses even if they do not follow the arm.
        for (topic, key) in self.file.columns.poses() {
            let columns = TopicSettings {
                topic,
                place: format!("`{key}` in {}", self.path.display()),
                role: Some(RoleSetting::Pose),
                of_columns: true,
                ..TopicSettings::default()
            };
            match topics.iter_mut().find(|settings| settings.is_of(&columns.topic)) {
                Some(settings) => settings.role = settings.role.or(columns.role),
                None => topics.push(columns),
            }
        }
        topics
    }

    fn exemptions(&self) -> Vec<Exemption> {
        let exemption = |known: &toml::Spanned<Ignore>| {
            let Ignore { code, reason, topic, joint, frame, robot } = known.as_ref().clone();
            Exemption {
                rules: code.0,
                subject: Subject { robot, topic, joint, frame, reference: None },
                reason: reason.0,
                place: self.place(known.span().start),
            }
        };
        self.file.ignore.iter().map(exemption).collect()
    }
}
