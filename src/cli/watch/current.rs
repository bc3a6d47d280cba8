//! The log that is watched: what was said of it last, and when it is looked at again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use poseaudit::finding::{Finding, Severity};
use poseaudit::log::{Follow, Growth};
use poseaudit::report::{Report, Trouble, TroubleKind, Verdict, tame};
use poseaudit::{Audited, Options, audit, audit_read};
use serde_json::json;

use super::super::output::Format;
use super::super::{Outcome, output};
use super::screen::Screen;

/// How often a log is audited, when it has ended, and how that is said.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    pub every: Duration,
    pub idle: Duration,
    pub format: Format,
}

/// The log.
pub struct Current {
    path: PathBuf,
    options: Options,
    pace: Pace,
    reading: Reading,
    /// When something was written last.
    written: Instant,
    /// When it was audited last, how long that took, and whether something was written since.
    audited: Option<(Instant, Duration)>,
    is_stale: bool,
    said: Said,
    /// Bytes that were read as they came, …
    came: u64,
    /// … and those that were read again.
    again: u64,
    outcome: Outcome,
    has_ended: bool,
}

/// How what is new of it is had.
enum Reading {
    /// It is not known yet what it is.
    Unknown,
    /// Piece by piece.
    Grown(Box<Follow>),
    /// Whole each time; its size when it was looked at last.
    Whole(u64),
}

/// What was said last.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Said {
    /// The verdict, or why there is none.
    verdict: String,
    /// What was found, by rule and subject.
    findings: BTreeMap<String, String>,
}

impl Said {
    fn of(report: &Report) -> Self {
        let verdict = match &report.error {
            Some(trouble) => format!("NO AUDIT ({})", trouble.what),
            None => report.verdict.to_string(),
        };
        let told = report.findings.iter().filter(|finding| finding.severity >= Severity::Warning);
        Self { verdict, findings: told.map(entry).collect() }
    }
}

/// A finding by its rule and subject, and what it says.
fn entry(finding: &Finding) -> (String, String) {
    let subject = &finding.subject;
    let whom = [&subject.robot, &subject.topic, &subject.joint, &subject.frame];
    let whom: Vec<&str> = whom.into_iter().skip(1).filter_map(Option::as_deref).collect();
    let key = format!("{} {}", finding.code, whom.join(" ")).trim_end().to_owned();
    (key, format!("{} {}", finding.severity.name(), finding.message))
}

impl Current {
    pub fn of(path: PathBuf, options: &Options, pace: Pace) -> Self {
        let options = Options { logs: vec![path.clone()], ..options.clone() };
        Self {
            path,
            options,
            pace,
            reading: Reading::Unknown,
            written: Instant::now(),
            audited: None,
            is_stale: false,
            said: Said::default(),
            came: 0,
            again: 0,
            outcome: Outcome::Clean,
            has_ended: false,
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Reads what was written since, and audits it if it is time to.
    pub fn look(&mut self, screen: &mut Screen) -> Result<(), Trouble> {
        if matches!(self.reading, Reading::Unknown) && self.size() > 0 {
            self.reading = match Follow::can(&self.path) {
                true => Reading::Grown(Box::new(Follow::of(&self.path, &self.options.read))),
                false => Reading::Whole(0),
            };
        }
        let size = self.size();
        let growth = match &mut self.reading {
            Reading::Unknown => Growth::None,
            // A file that is not there for a moment is being replaced.
            Reading::Grown(follow) => {
                let growth = follow.advance().unwrap_or(Growth::None);
                self.came = follow.read();
                growth
            }
            Reading::Whole(before) if *before == size => Growth::None,
            Reading::Whole(before) => {
                let is_shorter = size < *before;
                *before = size;
                if is_shorter { Growth::BegunAgain } else { Growth::More }
            }
        };
        match growth {
            Growth::None => {}
            Growth::More => {
                self.has_ended = false;
                (self.written, self.is_stale) = (Instant::now(), true);
            }
            Growth::BegunAgain => self.begin_again()?,
            Growth::Ended if self.has_ended => {}
            Growth::Ended if is_closed(&self.path) => return self.finish(screen),
            // It is damaged, or its end is just being written.
            Growth::Ended => self.reading = Reading::Whole(0),
        }
        if self.written.elapsed() >= self.pace.idle && !self.has_ended && self.size() > 0 {
            return self.finish(screen);
        }
        // A long log is not audited all the time.
        let is_time =
            self.audited.is_none_or(|(at, took)| at.elapsed() >= self.pace.every.max(2 * took));
        if self.is_stale && is_time { self.audit(screen) } else { Ok(()) }
    }

    /// Audits the whole of a log that has ended, as `poseaudit audit` does.
    pub fn finish(&mut self, screen: &mut Screen) -> Result<(), Trouble> {
        if self.has_ended || self.size() == 0 {
            return Ok(());
        }
        let audited = self.whole();
        self.has_ended = true;
        self.tell(audited, screen)
    }

    fn begin_again(&mut self) -> Result<(), Trouble> {
        (self.written, self.is_stale, self.audited) = (Instant::now(), false, None);
        (self.said, self.has_ended) = (Said::default(), false);
        (self.came, self.again) = (0, 0);
        self.reading = Reading::Unknown;
        let path = self.path.display().to_string();
        output::emit(None, |out| match self.pace.format {
            Format::Text => {
                writeln!(out, "{}  begun again: what was read before is forgotten", tame(&path))
            }
            Format::Json => {
                writeln!(
                    out,
                    "{}",
                    json!({"schema": "poseaudit.watch/1", "log": path, "event": "begun-again"})
                )
            }
        })
    }

    /// Audits what is there.
    fn audit(&mut self, screen: &mut Screen) -> Result<(), Trouble> {
        let began = Instant::now();
        let log = match &self.reading {
            Reading::Grown(follow) => follow.log().map(Some),
            _ => Some(None),
        };
        // Nothing to audit before the first message.
        let Some(log) = log else { return Ok(()) };
        let audited = match log {
            Some(log) => match audit_read(log, &self.options) {
                Err(trouble) => Err(called(trouble)?),
                audited => audited,
            },
            None => self.whole(),
        };
        (self.audited, self.is_stale) = (Some((Instant::now(), began.elapsed())), false);
        self.tell(audited, screen)
    }

    /// The audit of the whole file. One that cannot be read now may be later.
    fn whole(&mut self) -> Result<Audited, Trouble> {
        self.again += self.size();
        audit(&self.options)
    }

    /// Says what an audit gives if that is new, and draws it.
    fn tell(
        &mut self,
        audited: Result<Audited, Trouble>,
        screen: &mut Screen,
    ) -> Result<(), Trouble> {
        match audited {
            Err(trouble) => self.say(&Report::of_trouble(trouble)).map(drop),
            Ok(mut audited) => match self.say(&audited.report)? {
                true => screen.draw(&mut audited),
                false => Ok(()),
            },
        }
    }

    fn size(&self) -> u64 {
        fs::metadata(&self.path).map_or(0, |metadata| metadata.len())
    }

    /// Prints a line if the verdict or what is found changed, or where the log has ended; whether it did.
    fn say(&mut self, report: &Report) -> Result<bool, Trouble> {
        self.outcome = Outcome::from(report);
        let said = Said::of(report);
        if said == self.said_before(&said) && !self.has_ended {
            return Ok(false);
        }
        let before = std::mem::replace(&mut self.said, said);
        let line = Line { current: self, before: &before, report };
        output::emit(None, |out| match self.pace.format {
            Format::Text => writeln!(out, "{}", tame(&line.text())),
            Format::Json => writeln!(out, "{}", line.json()),
        })?;
        Ok(true)
    }

    /// What was said last, with the amounts that are known now: that these become surer is no change.
    fn said_before(&self, now: &Said) -> Said {
        let known = |(key, old): (&String, &String)| {
            let text = now.findings.get(key).unwrap_or(old);
            let severity = |text: &str| text.split(' ').next().map(str::to_owned);
            let kept = if severity(text) == severity(old) { text } else { old };
            (key.clone(), kept.clone())
        };
        Said {
            verdict: self.said.verdict.clone(),
            findings: self.said.findings.iter().map(known).collect(),
        }
    }
}

/// A trouble of the log is said and may go; one of the call ends the watch.
fn called(trouble: Trouble) -> Result<Trouble, Trouble> {
    match trouble.kind {
        TroubleKind::Log => Ok(trouble),
        TroubleKind::Call => Err(trouble),
    }
}

/// Whether an MCAP file has its end.
fn is_closed(path: &Path) -> bool {
    use mcap::MAGIC;
    use std::io::{Read, Seek, SeekFrom};
    let mut end = [0; MAGIC.len()];
    let read = fs::File::open(path).and_then(|mut file| {
        file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
        file.read_exact(&mut end)
    });
    read.is_ok() && end == MAGIC
}

/// What became of the log since the line before.
struct Line<'a> {
    current: &'a Current,
    before: &'a Said,
    report: &'a Report,
}

impl Line<'_> {
    fn now(&self) -> &Said {
        &self.current.said
    }

    fn found(&self) -> impl Iterator<Item = (&String, &String)> {
        self.now().findings.iter().filter(|(key, _)| !self.before.findings.contains_key(*key))
    }

    fn gone(&self) -> impl Iterator<Item = &String> {
        self.before.findings.keys().filter(|key| !self.now().findings.contains_key(*key))
    }

    /// The rules that keep the verdict open.
    fn undecided(&self) -> Vec<&'static str> {
        let is_open = self.report.verdict == Verdict::Inconclusive;
        if is_open { self.report.undecided() } else { Vec::new() }
    }

    fn text(&self) -> String {
        let seconds = self.report.log.duration_s.unwrap_or(0.0);
        let mut line = format!("{}  +{seconds:.1} s  ", self.current.path.display());
        if self.current.has_ended {
            line += "ended  ";
        }
        if !self.before.verdict.is_empty() && self.before.verdict != self.now().verdict {
            line += &format!("{} → ", self.before.verdict);
        }
        line += &self.now().verdict;
        let undecided = self.undecided();
        if !undecided.is_empty() {
            line += &format!(" (not decided: {})", undecided.join(", "));
        }
        for (key, text) in self.found() {
            let (severity, message) = text.split_once(' ').unwrap_or((text, ""));
            line += &format!("; new {severity} {key}: {message}");
        }
        for key in self.gone() {
            line += &format!("; no longer {key}");
        }
        let Current { came, again, .. } = self.current;
        if self.current.has_ended {
            line += &format!("; {came} bytes read as they came, {again} read again");
        }
        line
    }

    fn json(&self) -> serde_json::Value {
        json!({
            "schema": "poseaudit.watch/1",
            "log": self.current.path,
            "event": if self.current.has_ended { "ended" } else { "changed" },
            "duration_s": self.report.log.duration_s,
            "verdict": self.report.verdict,
            "undecided": self.undecided(),
            "error": self.report.error.as_ref().map(|trouble| &trouble.what),
            "new": self.found().map(|(key, text)| json!({ "finding": key, "says": text })).collect::<Vec<_>>(),
            "gone": self.gone().collect::<Vec<_>>(),
            "read_bytes": self.current.has_ended.then_some(self.current.came),
            "read_again_bytes": self.current.again,
        })
    }
}
