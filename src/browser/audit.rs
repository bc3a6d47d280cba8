//! Audits files from the page.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytes::Bytes;
use poseaudit::config::Config;
use poseaudit::log::Progress;
use poseaudit::report::{Format, Report, Trouble, TroubleKind};
use poseaudit::run::RobotSource;
use poseaudit::{Audited, Options};
use serde::Deserialize;

use crate::Answer;

/// An audit request.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuditRequest {
    files: Vec<RequestFile>,
    /// Catalogue name.
    robot: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RequestFile {
    name: PathBuf,
    #[serde(rename = "as")]
    kind: FileKind,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FileKind {
    Log,
    Robot,
    Config,
}

pub fn answer(
    request: &AuditRequest,
    files: Vec<Bytes>,
    progress: Progress,
) -> Result<Answer, Trouble> {
    let progress = Arc::new(progress);
    let audited = request.options(files).and_then(|(mut options, words)| {
        options.read.progress = Some(Arc::clone(&progress));
        Ok((poseaudit::audit(&options)?, words))
    });
    let report = match audited {
        Err(trouble) => Report::from_trouble(trouble),
        Ok((audited, words)) => {
            progress.set_activity("drawing");
            let Audited { report, .. } = audited.with_figures();
            report.with_command_line(&words)
        }
    };
    Ok(Answer {
        status: status(&report),
        error: report.error.as_ref().map(ToString::to_string),
        json: write_report(&report, "json"),
        shown: write_report(&report, "html"),
    })
}

fn write_report(report: &Report, format: &str) -> String {
    let mut bytes = Vec::new();
    let done = Format::from_name(format).map(|format| format.write(report, &mut bytes));
    debug_assert!(matches!(done, Some(Ok(()))), "memory takes every report");
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Exit status on the command line.
fn status(report: &Report) -> u8 {
    match &report.error {
        Some(Trouble { kind: TroubleKind::Call, .. }) => 2,
        Some(Trouble { kind: TroubleKind::Log, .. }) => 3,
        None => u8::from(report.fails()),
    }
}

impl AuditRequest {
    /// Options, and the words of the equivalent command line.
    fn options(&self, files: Vec<Bytes>) -> Result<(Options, Vec<String>), Trouble> {
        let (mut logs, mut robots, mut configs) = (Vec::new(), Vec::new(), Vec::new());
        for (RequestFile { name, kind }, content) in self.files.iter().zip(files) {
            match kind {
                FileKind::Log => logs.push((name.clone(), content)),
                FileKind::Robot => robots.push((name, text(name, &content)?)),
                FileKind::Config => configs.push((name, text(name, &content)?)),
            }
        }
        let mut words = vec!["poseaudit".to_owned(), "audit".to_owned()];
        words.extend(logs.iter().map(|(name, _)| name.display().to_string()));
        let mut options = match configs.pop() {
            None => Options::default(),
            Some((name, text)) => {
                words.extend(["--config".to_owned(), name.display().to_string()]);
                Config::from_text(text, name)?.options()
            }
        };
        let run = &mut options.run;
        let given = robots.into_iter().map(|(name, text)| RobotSource {
            prefix: None,
            model: name.display().to_string(),
            text: Some(text),
        });
        let given: Vec<RobotSource> = given.collect();
        let named = self.robot.as_deref().map(RobotSource::from);
        // A given model that the config does not name is the robot.
        for source in &mut run.robots {
            let file = given.iter().find(|file| file.model == source.model);
            source.text = file.and_then(|file| file.text.clone());
        }
        if run.robots.iter().all(|source| source.text.is_none()) {
            let own: Vec<RobotSource> = named.into_iter().chain(given).collect();
            for source in &own {
                words.extend(["--robot".to_owned(), source.model.clone()]);
            }
            if !own.is_empty() {
                run.robots = own;
            }
        }
        Ok((options.with_given(logs)?, words))
    }
}

fn text(name: &Path, content: &Bytes) -> Result<String, Trouble> {
    let text = String::from_utf8(content.to_vec());
    text.map_err(|_| Trouble::call(name.display(), "it is not text", "save it as UTF-8"))
}
