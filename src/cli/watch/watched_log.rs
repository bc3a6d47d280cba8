//! The watched log: its last printed state, and when to audit again.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use poseaudit::finding::{Finding, Severity};
use poseaudit::log::{self, Extent, Growth, Log, LogFollower};
use poseaudit::report::{Report, Trouble, TroubleKind, Verdict, sanitize};
use poseaudit::{Audited, Options, audit, audit_read};
use serde_json::json;

use super::super::output::Format;
use super::super::{Outcome, output};
use super::recording_sink::RecordingSink;

#[derive(Clone, Copy, Debug)]
pub struct WatchSettings {
    pub min_interval: Duration,
    pub idle: Duration,
    pub format: Format,
}

pub struct WatchedLog {
    path: PathBuf,
    options: Options,
    settings: WatchSettings,
    read_mode: ReadMode,
    /// Last write.
    last_write: Instant,
    /// Time and duration of the last audit, and whether data followed.
    last_audit: Option<(Instant, Duration)>,
    is_stale: bool,
    printed: PrintedState,
    /// Bytes.
    read_bytes: u64,
    /// Bytes.
    reread_bytes: u64,
    outcome: Outcome,
    has_ended: bool,
}

enum ReadMode {
    /// File type unknown.
    Unknown,
    Incremental(Box<LogFollower>),
    /// As a whole; last size.
    Whole(u64),
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct PrintedState {
    /// Verdict, or why it is missing.
    verdict: String,
    /// Keyed by rule and subject.
    findings: BTreeMap<String, Severity>,
}

impl PrintedState {
    fn from_report(report: &Report) -> Self {
        let verdict = match &report.error {
            Some(trouble) => format!("NO AUDIT ({})", trouble.what),
            None => report.verdict.to_string(),
        };
        Self {
            verdict,
            findings: reported_findings(report).map(|it| (finding_name(it), it.severity)).collect(),
        }
    }
}

fn reported_findings(report: &Report) -> impl Iterator<Item = &Finding> {
    report.findings.iter().filter(|finding| finding.severity >= Severity::Warning)
}

fn finding_name(finding: &Finding) -> String {
    let subject = &finding.subject;
    let subject_names = [&subject.topic, &subject.joint, &subject.frame].into_iter();
    let subject_names: Vec<&str> = subject_names.filter_map(Option::as_deref).collect();
    format!("{} {}", finding.code, subject_names.join(" ")).trim_end().to_owned()
}

impl WatchedLog {
    pub fn new(path: PathBuf, options: &Options, pace: WatchSettings) -> Self {
        let options = Options { logs: vec![path.clone()], ..options.clone() };
        Self {
            path,
            options,
            settings: pace,
            read_mode: ReadMode::Unknown,
            last_write: Instant::now(),
            last_audit: None,
            is_stale: false,
            printed: PrintedState::default(),
            read_bytes: 0,
            reread_bytes: 0,
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
    pub fn poll(&mut self, sink: &mut RecordingSink) -> Result<(), Trouble> {
        if matches!(self.read_mode, ReadMode::Unknown) && self.size() > 0 {
            self.read_mode = match LogFollower::is_supported(&self.path) {
                true => ReadMode::Incremental(Box::new(LogFollower::new(
                    &self.path, &self.options.read,
                ))),
                false => ReadMode::Whole(0),
            };
        }
        let size = self.size();
        let growth = match &mut self.read_mode {
            ReadMode::Unknown => Growth::None,
            // A missing file is being replaced.
            ReadMode::Incremental(follow) => {
                let growth = follow.advance().unwrap_or(Growth::None);
                self.read_bytes = follow.read();
                growth
            }
            ReadMode::Whole(before) if *before == size => Growth::None,
            ReadMode::Whole(before) => {
                let is_shorter = size < *before;
                *before = size;
                if is_shorter { Growth::Restarted } else { Growth::More }
            }
        };
        match growth {
            Growth::None => {}
            Growth::More => {
                self.has_ended = false;
                (self.last_write, self.is_stale) = (Instant::now(), true);
            }
            Growth::Restarted => self.restart()?,
            Growth::Ended if self.has_ended => {}
            Growth::Ended if is_closed(&self.path) => return self.finish(sink),
            // Damaged, or its end is being written.
            Growth::Ended => self.read_mode = ReadMode::Whole(0),
        }
        if self.last_write.elapsed() >= self.settings.idle && !self.has_ended && self.size() > 0 {
            return self.finish(sink);
        }
        // Limits the time share of audits.
        let is_time = self
            .last_audit
            .is_none_or(|(at, took)| at.elapsed() >= self.settings.min_interval.max(2 * took));
        if self.is_stale && is_time { self.audit(sink) } else { Ok(()) }
    }

    /// Audits a complete log like `poseaudit audit`.
    pub fn finish(&mut self, sink: &mut RecordingSink) -> Result<(), Trouble> {
        if self.has_ended || self.size() == 0 {
            return Ok(());
        }
        let audited = self.audit_whole();
        self.has_ended = true;
        self.publish(audited, sink)
    }

    fn restart(&mut self) -> Result<(), Trouble> {
        (self.last_write, self.is_stale, self.last_audit) = (Instant::now(), false, None);
        (self.printed, self.has_ended) = (PrintedState::default(), false);
        (self.read_bytes, self.reread_bytes) = (0, 0);
        self.read_mode = ReadMode::Unknown;
        let path = self.path.display().to_string();
        output::emit(None, |out| match self.settings.format {
            Format::Text => {
                writeln!(out, "{}  restarted: earlier data discarded", sanitize(&path))
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

    fn audit(&mut self, sink: &mut RecordingSink) -> Result<(), Trouble> {
        let began = Instant::now();
        let log = match &self.read_mode {
            ReadMode::Incremental(follow) => match follow.log() {
                Some(log) => Ok(log),
                // No message yet.
                None => return Ok(()),
            },
            _ => self.read_unfinished(),
        };
        let audited = match log.and_then(|log| audit_read(log, &self.options)) {
            Err(trouble) => Err(tolerate_log_trouble(trouble)?),
            audited => audited,
        };
        (self.last_audit, self.is_stale) = (Some((Instant::now(), began.elapsed())), false);
        self.publish(audited, sink)
    }

    /// A missing end does not count as damage while the log is written.
    fn read_unfinished(&mut self) -> Result<Log, Trouble> {
        self.reread_bytes += self.size();
        let mut log = log::open(&self.options.logs, &self.options.read)?;
        log.losses.retain(|loss| !matches!(loss.extent, Extent::Tail | Extent::Index));
        Ok(log)
    }

    fn audit_whole(&mut self) -> Result<Audited, Trouble> {
        self.reread_bytes += self.size();
        audit(&self.options)
    }

    /// Prints and draws new results.
    fn publish(
        &mut self,
        audited: Result<Audited, Trouble>,
        sink: &mut RecordingSink,
    ) -> Result<(), Trouble> {
        match audited {
            Err(trouble) => self.print_changes(&Report::from_trouble(trouble)).map(drop),
            Ok(mut audited) => match self.print_changes(&audited.report)? {
                true => sink.write(&mut audited),
                false => Ok(()),
            },
        }
    }

    fn size(&self) -> u64 {
        fs::metadata(&self.path).map_or(0, |metadata| metadata.len())
    }

    /// Prints a line if verdict or findings changed, or the log ended. Returns whether it did.
    fn print_changes(&mut self, report: &Report) -> Result<bool, Trouble> {
        self.outcome = Outcome::from(report);
        let current = PrintedState::from_report(report);
        if current == self.printed && !self.has_ended {
            return Ok(false);
        }
        let before = std::mem::replace(&mut self.printed, current);
        let line = ChangeLine { log: self, previous: &before, report };
        output::emit(None, |out| match self.settings.format {
            Format::Text => writeln!(out, "{}", sanitize(&line.text())),
            Format::Json => writeln!(out, "{}", line.json()),
        })?;
        Ok(true)
    }
}

/// A trouble with the log may pass; one with the call ends the watch.
fn tolerate_log_trouble(trouble: Trouble) -> Result<Trouble, Trouble> {
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

struct ChangeLine<'a> {
    log: &'a WatchedLog,
    previous: &'a PrintedState,
    report: &'a Report,
}

impl ChangeLine<'_> {
    fn printed(&self) -> &PrintedState {
        &self.log.printed
    }

    /// New findings or severities, by name.
    fn new_findings(&self) -> impl Iterator<Item = (String, &Finding)> {
        let named = reported_findings(self.report).map(|finding| (finding_name(finding), finding));
        named.filter(|(name, now)| self.previous.findings.get(name) != Some(&now.severity))
    }

    fn removed_findings(&self) -> impl Iterator<Item = &String> {
        self.previous.findings.keys().filter(|key| !self.printed().findings.contains_key(*key))
    }

    fn undecided_rules(&self) -> Vec<&'static str> {
        let is_open = self.report.verdict == Verdict::Inconclusive;
        if is_open { self.report.undecided() } else { Vec::new() }
    }

    fn text(&self) -> String {
        let seconds = self.report.log.duration_s.unwrap_or(0.0);
        let mut line = format!("{}  +{seconds:.1} s  ", self.log.path.display());
        if self.log.has_ended {
            line += "ended  ";
        }
        if !self.previous.verdict.is_empty() && self.previous.verdict != self.printed().verdict {
            line += &format!("{} → ", self.previous.verdict);
        }
        line += &self.printed().verdict;
        let undecided = self.undecided_rules();
        if !undecided.is_empty() {
            line += &format!(" (undetermined: {})", undecided.join(", "));
        }
        for (name, Finding { severity, message, .. }) in self.new_findings() {
            line += &format!("; new {} {name}: {message}", severity.name());
        }
        for key in self.removed_findings() {
            line += &format!("; no longer {key}");
        }
        let WatchedLog { read_bytes, reread_bytes, .. } = self.log;
        if self.log.has_ended {
            line += &format!("; {read_bytes} bytes read incrementally, {reread_bytes} read again");
        }
        line
    }

    fn json(&self) -> serde_json::Value {
        let new = |(name, Finding { severity, message, .. }): (String, &Finding)| json!({ "finding": name, "says": format!("{} {message}", severity.name()) });
        json!({
            "schema": "poseaudit.watch/1",
            "log": self.log.path,
            "event": if self.log.has_ended { "ended" } else { "changed" },
            "duration_s": self.report.log.duration_s,
            "verdict": self.report.verdict,
            "undecided": self.undecided_rules(),
            "error": self.report.error.as_ref().map(|trouble| &trouble.what),
            "new": self.new_findings().map(new).collect::<Vec<_>>(),
            "gone": self.removed_findings().collect::<Vec<_>>(),
            "read_bytes": self.log.has_ended.then_some(self.log.read_bytes),
            "read_again_bytes": self.log.reread_bytes,
        })
    }
}
