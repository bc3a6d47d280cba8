//! The watched log: its last printed state, and when to audit again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use poseaudit::finding::{Finding, Severity};
use poseaudit::log::{self, Extent, Growth, Log, LogFollower};
use poseaudit::report::{Report, Trouble, TroubleKind, Verdict, tame};
use poseaudit::{Audited, Options, audit, audit_read};
use serde_json::json;

use super::super::output::Format;
use super::super::{Outcome, output};
use super::screen::Screen;

#[derive(Clone, Copy, Debug)]
pub struct Pace {
    pub every: Duration,
    pub idle: Duration,
    pub format: Format,
}

pub struct Current {
    path: PathBuf,
    options: Options,
    pace: Pace,
    reading: Reading,
    /// Last write.
    written: Instant,
    /// Time and duration of the last audit, and whether data followed.
    audited: Option<(Instant, Duration)>,
    is_stale: bool,
    said: Said,
    /// Bytes.
    came: u64,
    /// Bytes.
    again: u64,
    outcome: Outcome,
    has_ended: bool,
}

enum Reading {
    /// File type unknown.
    Unknown,
    Grown(Box<LogFollower>),
    /// As a whole; last size.
    Whole(u64),
}

/// Last printed state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Said {
    /// Verdict, or why it is missing.
    verdict: String,
    /// Keyed by rule and subject.
    findings: BTreeMap<String, Severity>,
}

impl Said {
    fn of(report: &Report) -> Self {
        let verdict = match &report.error {
            Some(trouble) => format!("NO AUDIT ({})", trouble.what),
            None => report.verdict.to_string(),
        };
        Self { verdict, findings: told(report).map(|it| (name(it), it.severity)).collect() }
    }
}

fn told(report: &Report) -> impl Iterator<Item = &Finding> {
    report.findings.iter().filter(|finding| finding.severity >= Severity::Warning)
}

fn name(finding: &Finding) -> String {
    let subject = &finding.subject;
    let whom = [&subject.topic, &subject.joint, &subject.frame].into_iter();
    let whom: Vec<&str> = whom.filter_map(Option::as_deref).collect();
    format!("{} {}", finding.code, whom.join(" ")).trim_end().to_owned()
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

    /// Reads new data; audits if due.
    pub fn look(&mut self, screen: &mut Screen) -> Result<(), Trouble> {
        if matches!(self.reading, Reading::Unknown) && self.size() > 0 {
            self.reading = match LogFollower::is_supported(&self.path) {
                true => Reading::Grown(Box::new(LogFollower::new(&self.path, &self.options.read))),
                false => Reading::Whole(0),
            };
        }
        let size = self.size();
        let growth = match &mut self.reading {
            Reading::Unknown => Growth::None,
            // A missing file is being replaced.
            Reading::Grown(follow) => {
                let growth = follow.advance().unwrap_or(Growth::None);
                self.came = follow.read();
                growth
            }
            Reading::Whole(before) if *before == size => Growth::None,
            Reading::Whole(before) => {
                let is_shorter = size < *before;
                *before = size;
                if is_shorter { Growth::Restarted } else { Growth::More }
            }
        };
        match growth {
            Growth::None => {}
            Growth::More => {
                self.has_ended = false;
                (self.written, self.is_stale) = (Instant::now(), true);
            }
            Growth::Restarted => self.begin_again()?,
            Growth::Ended if self.has_ended => {}
            Growth::Ended if is_closed(&self.path) => return self.finish(screen),
            // Damaged, or its end is being written.
            Growth::Ended => self.reading = Reading::Whole(0),
        }
        if self.written.elapsed() >= self.pace.idle && !self.has_ended && self.size() > 0 {
            return self.finish(screen);
        }
        // Limits the time share of audits.
        let is_time =
            self.audited.is_none_or(|(at, took)| at.elapsed() >= self.pace.every.max(2 * took));
        if self.is_stale && is_time { self.audit(screen) } else { Ok(()) }
    }

    /// Audits a complete log like `poseaudit audit`.
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
                writeln!(out, "{}  restarted: earlier data discarded", tame(&path))
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

    fn audit(&mut self, screen: &mut Screen) -> Result<(), Trouble> {
        let began = Instant::now();
        let log = match &self.reading {
            Reading::Grown(follow) => match follow.log() {
                Some(log) => Ok(log),
                // No message yet.
                None => return Ok(()),
            },
            _ => self.so_far(),
        };
        let audited = match log.and_then(|log| audit_read(log, &self.options)) {
            Err(trouble) => Err(called(trouble)?),
            audited => audited,
        };
        (self.audited, self.is_stale) = (Some((Instant::now(), began.elapsed())), false);
        self.tell(audited, screen)
    }

    /// A missing end does not count as damage while the log is written.
    fn so_far(&mut self) -> Result<Log, Trouble> {
        self.again += self.size();
        let mut log = log::open(&self.options.logs, &self.options.read)?;
        log.losses.retain(|loss| !matches!(loss.extent, Extent::Tail | Extent::Index));
        Ok(log)
    }

    fn whole(&mut self) -> Result<Audited, Trouble> {
        self.again += self.size();
        audit(&self.options)
    }

    /// Prints and draws new results.
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

    /// Prints a line if verdict or findings changed, or the log ended. Returns whether it did.
    fn say(&mut self, report: &Report) -> Result<bool, Trouble> {
        self.outcome = Outcome::from(report);
        let said = Said::of(report);
        if said == self.said && !self.has_ended {
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
}

/// A trouble with the log may pass; one with the call ends the watch.
fn called(trouble: Trouble) -> Result<Trouble, Trouble> {
    match trouble.kind {
        TroubleKind::Log => Ok(trouble),
        TroubleKind::Call => Err(trouble),
    }
}

/// Whether an MCAP file has its end magic.
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

/// Changes since the last line.
struct Line<'a> {
    current: &'a Current,
    before: &'a Said,
    report: &'a Report,
}

impl Line<'_> {
    fn now(&self) -> &Said {
        &self.current.said
    }

    /// New findings or severities, by name.
    fn found(&self) -> impl Iterator<Item = (String, &Finding)> {
        let named = told(self.report).map(|finding| (name(finding), finding));
        named.filter(|(name, now)| self.before.findings.get(name) != Some(&now.severity))
    }

    fn gone(&self) -> impl Iterator<Item = &String> {
        self.before.findings.keys().filter(|key| !self.now().findings.contains_key(*key))
    }

    /// Rules that make the verdict inconclusive.
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
            line += &format!(" (undetermined: {})", undecided.join(", "));
        }
        for (name, Finding { severity, message, .. }) in self.found() {
            line += &format!("; new {} {name}: {message}", severity.name());
        }
        for key in self.gone() {
            line += &format!("; no longer {key}");
        }
        let Current { came, again, .. } = self.current;
        if self.current.has_ended {
            line += &format!("; {came} bytes read incrementally, {again} read again");
        }
        line
    }

    fn json(&self) -> serde_json::Value {
        let new = |(name, Finding { severity, message, .. }): (String, &Finding)| json!({ "finding": name, "says": format!("{} {message}", severity.name()) });
        json!({
            "schema": "poseaudit.watch/1",
            "log": self.current.path,
            "event": if self.current.has_ended { "ended" } else { "changed" },
            "duration_s": self.report.log.duration_s,
            "verdict": self.report.verdict,
            "undecided": self.undecided(),
            "error": self.report.error.as_ref().map(|trouble| &trouble.what),
            "new": self.found().map(new).collect::<Vec<_>>(),
            "gone": self.gone().collect::<Vec<_>>(),
            "read_bytes": self.current.has_ended.then_some(self.current.came),
            "read_again_bytes": self.current.again,
        })
    }
}
