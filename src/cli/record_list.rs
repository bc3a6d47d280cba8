//! `poseaudit record-list`.

mod questions;

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use poseaudit::Options;
use poseaudit::log::is_url;
use poseaudit::places::PathRegistry;
use poseaudit::report::{Report, Trouble, sanitize};
use poseaudit::robot::{Robot, catalogue};
use serde::Deserialize;
use serde_json::{Value, json};

use self::questions::{Need, QUESTIONS, Question};
use super::output::Format;
use super::progress::with_progress;
use super::{Outcome, misuse, output};

/// List the topics to record for each question: those missing in a log, or those published by an arm's drivers
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit record-list run.mcap
  poseaudit record-list ur5e
  poseaudit record-list ur5e --format json")]
pub struct Args {
    /// A log, or its URL, or the catalogue name of an arm
    #[arg(value_name = "LOG|ROBOT")]
    log_or_robot: PathBuf,

    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Published topics, from `drivers.toml`.
#[derive(Debug, Deserialize)]
struct Drivers {
    driver: Vec<Driver>,
}

#[derive(Debug, Deserialize)]
struct Driver {
    /// `None` for topics that every arm has.
    vendor: Option<String>,
    name: String,
    source: String,
    topics: Vec<Topic>,
}

#[derive(Clone, Debug, Deserialize)]
struct Topic {
    topic: String,
    #[serde(rename = "type")]
    type_name: String,
    role: String,
}

static DRIVERS: LazyLock<Drivers> = LazyLock::new(|| {
    toml::from_str(include_str!("record_list/drivers.toml")).expect("the embedded table is valid")
});

enum Source {
    Log(Box<Report>),
    Arm(&'static Robot),
}

/// Available topics and unmet needs of a question.
struct Answer {
    question: &'static Question,
    topics: Vec<Topic>,
    missing: Vec<Need>,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let source = open_source(&args.log_or_robot)?;
    if let Source::Log(report) = &source
        && let Some(trouble) = report.error.as_ref().filter(|_| report.streams.is_empty())
    {
        return Err(trouble.clone());
    }
    let answers: Vec<Answer> = QUESTIONS.iter().map(|question| source.answer(question)).collect();
    output::emit(None, |out| match args.format {
        Format::Text => source.write(&answers, out),
        Format::Json => output::write_json(out, &source.as_json(&answers)),
    })?;
    Ok(Outcome::Clean)
}

fn open_source(of: &Path) -> Result<Source, Trouble> {
    let name = of.display().to_string();
    if of.exists() || is_url(of) {
        PathRegistry::check_read_only([of.to_owned()].iter())?;
        let mut options = Options { logs: vec![of.to_owned()], ..Options::default() };
        let mut report = with_progress(|progress| {
            options.read.progress = Some(progress);
            poseaudit::info(&options)
        })?;
        return match report.error.take() {
            Some(trouble) => Err(trouble),
            None => Ok(Source::Log(Box::new(report))),
        };
    }
    catalogue::find(&name).map(Source::Arm).ok_or_else(|| {
        let similar = catalogue::nearest_names(&name);
        let remedy = match similar.as_slice() {
            [] => "name a log, or an arm of `poseaudit robots`".to_owned(),
            similar => format!("name a log, or an arm; is it {}?", similar.join(", ")),
        };
        misuse(name, "no such file, and no arm of this name in the catalogue", remedy)
    })
}

impl Source {
    /// General drivers for a log.
    fn drivers(&self) -> impl Iterator<Item = &'static Driver> {
        let vendor = match self {
            Source::Arm(robot) => robot.provenance.as_ref().map(|maker| maker.vendor.as_str()),
            Source::Log(_) => None,
        };
        DRIVERS
            .driver
            .iter()
            .filter(move |driver| driver.vendor.is_none() || driver.vendor.as_deref() == vendor)
    }

    fn topics(&self, need: Need) -> Vec<Topic> {
        match self {
            Source::Log(report) => need
                .streams(report)
                .into_iter()
                .map(|stream| Topic {
                    topic: stream.topic.clone(),
                    type_name: stream.type_name.clone(),
                    role: stream.role.to_owned(),
                })
                .collect(),
            // Drivers publish no independent poses.
            Source::Arm(_) if need == Need::Tracker => Vec::new(),
            Source::Arm(_) => {
                let topics = self.drivers().flat_map(|driver| &driver.topics);
                topics
                    .filter(|topic| need.roles().contains(&topic.role.as_str()))
                    .cloned()
                    .collect()
            }
        }
    }

    fn answer(&self, question: &'static Question) -> Answer {
        let mut topics: Vec<Topic> = Vec::new();
        let mut missing = Vec::new();
        for &need in question.needs {
            let streams = self.topics(need);
            let is_met = match self {
                Source::Log(report) => need.is_met(report),
                Source::Arm(_) => need == Need::Model || !streams.is_empty(),
            };
            if !is_met {
                missing.push(need);
            }
            for topic in streams {
                if topics.iter().all(|known| known.topic != topic.topic) {
                    topics.push(topic);
                }
            }
        }
        Answer { question, topics, missing }
    }

    fn write(&self, answers: &[Answer], out: &mut dyn Write) -> io::Result<()> {
        // First, and without a label, so that it can be copied.
        writeln!(out, "{}\n", sanitize(&command(answers)))?;
        let motion = "30 s or more in which every joint moves by 30° or more, one after another";
        writeln!(out, "motion         {motion}; `poseaudit plan` writes one")?;
        match self {
            Source::Log(report) => {
                let names = report.log.files.iter().map(|file| file.path.display().to_string());
                writeln!(
                    out,
                    "log            {}",
                    sanitize(&names.collect::<Vec<_>>().join(", "))
                )?;
            }
            Source::Arm(robot) => {
                let maker =
                    robot.provenance.as_ref().map(|it| format!(", {} {}", it.vendor, it.model));
                let name = format!("{}{}", robot.name, maker.unwrap_or_default());
                writeln!(out, "robot          {}", sanitize(&name))?;
                for driver in self.drivers() {
                    writeln!(out, "topics of      {} ({})", driver.name, driver.source)?;
                }
                if self.drivers().all(|driver| driver.vendor.is_none()) {
                    writeln!(
                        out,
                        "               the topics of this manufacturer's drivers are unknown"
                    )?;
                }
            }
        }
        for answer in answers {
            writeln!(out, "\n{}", answer.question.text)?;
            writeln!(out, "  rules        {}", answer.question.rules.join(", "))?;
            for topic in &answer.topics {
                let (name, kind) = (sanitize(&topic.topic), sanitize(&topic.type_name));
                writeln!(out, "  {:<13}{name} ({kind})", topic.role)?;
            }
            if answer.question.needs.is_empty() {
                writeln!(out, "  any          every recorded topic")?;
            }
            for need in &answer.missing {
                writeln!(out, "  missing      {}", need.description())?;
            }
        }
        Ok(())
    }

    fn as_json(&self, answers: &[Answer]) -> Value {
        let questions = answers.iter().map(|Answer { question, topics, missing }| {
            let topics = topics.iter().map(|topic| {
                json!({ "topic": topic.topic, "type": topic.type_name, "role": topic.role })
            });
            json!({
                "question": question.text,
                "rules": question.rules,
                "topics": topics.collect::<Vec<_>>(),
                "missing": missing.iter().map(|need| need.description()).collect::<Vec<_>>(),
            })
        });
        let (log, robot) = match self {
            Source::Log(report) => {
                (Some(report.log.files.iter().map(|file| &file.path).collect::<Vec<_>>()), None)
            }
            Source::Arm(robot) => (None, Some(&robot.name)),
        };
        let drivers = self.drivers().filter(|_| robot.is_some());
        json!({
            "schema": "poseaudit.record-list/1",
            "log": log,
            "robot": robot,
            "drivers": drivers.map(|driver| json!({ "name": driver.name, "source": driver.source })).collect::<Vec<_>>(),
            "questions": questions.collect::<Vec<_>>(),
            "command": command(answers),
        })
    }
}

/// Records all topics that a question needs.
fn command(answers: &[Answer]) -> String {
    let mut topics: Vec<&str> = Vec::new();
    for topic in answers.iter().flat_map(|answer| &answer.topics) {
        if !topics.contains(&topic.topic.as_str()) {
            topics.push(&topic.topic);
        }
    }
    match topics.is_empty() {
        true => "no known topic is worth recording".to_owned(),
        false => format!("ros2 bag record -s mcap -o run {}", topics.join(" ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_driver_is_of_a_maker_in_the_catalogue_and_says_where_its_topics_are_from() {
        let vendors: Vec<&str> = catalogue::entries()
            .filter_map(|robot| robot.provenance.as_ref())
            .map(|maker| maker.vendor.as_str())
            .collect();
        let roles: Vec<&str> = QUESTIONS
            .iter()
            .flat_map(|it| it.needs)
            .flat_map(|need| need.roles())
            .copied()
            .collect();
        for driver in &DRIVERS.driver {
            assert!(!driver.source.is_empty() && !driver.topics.is_empty(), "{}", driver.name);
            assert!(
                driver.vendor.as_deref().is_none_or(|it| vendors.contains(&it)),
                "{}",
                driver.name
            );
            for topic in &driver.topics {
                assert!(roles.contains(&topic.role.as_str()), "{}", topic.topic);
            }
        }
    }
}
