//! What joins the rooms: a log into runs, what is known of each into verdicts, and both into the report.

#[cfg(test)]
mod any_log;
mod calibrate;
mod demo;
mod options;
mod tables;

use crate::checks::{EvaluatedPart, Evaluation, evaluate, merged};
use crate::corrections::Given;
use crate::evidence::{ArmEvidence, Lost, RunEvidence, Undecodable, UndecodableTopic};
use crate::log::Log;
use crate::places::Places;
use crate::report::{
    Figures, FileRow, LogSummary, NoteRow, Report, Trouble, coverage, figures, joined, plans,
    robots, streams, tells_hand_eye,
};
use crate::run::{Arm, Excerpts, Run, Segment, segments, tell_columns};

pub use calibrate::{Calibrated, Taken, calibrate};
pub use demo::{DEMO_LOG, Demo, Planted, demo};
pub use options::{Options, Policy};

/// What the report says of the files themselves.
pub(crate) struct Read {
    summary: LogSummary,
    lost: Lost,
}

impl Read {
    /// Says what a file of corrections changes.
    pub fn note_corrections(&mut self, given: &Given<'_>) {
        let path = given.file.to_owned();
        let notes = given.notes().into_iter().map(|note| NoteRow { path: path.clone(), note });
        self.summary.notes.extend(notes);
    }

    /// Says something of the run, with its first file.
    fn note(&mut self, what: &str) {
        if let Some(file) = self.summary.files.first() {
            let path = file.path.clone();
            self.summary.notes.push(NoteRow { path, note: what.to_owned() });
        }
    }

    pub fn of(log: &Log) -> Self {
        let files = log.files.iter().map(|file| FileRow {
            path: file.path.clone(),
            container: file.container.name(),
            bytes: file.bytes,
            fetched_bytes: file.fetched,
            crc: file.crc.name(),
        });
        let notes = log
            .notes
            .iter()
            .map(|note| NoteRow { path: note.file.clone(), note: note.what.clone() });
        let undecodable = log.topics.iter().filter_map(|topic| {
            let undecodable = topic.undecodable.as_ref()?;
            Some(UndecodableTopic {
                topic: topic.name.clone(),
                what: Undecodable::Messages(topic.type_name.clone()),
                messages: undecodable.messages,
                why: undecodable.first.clone(),
            })
        });
        Self {
            summary: LogSummary {
                files: files.collect(),
                notes: notes.collect(),
                messages: log.messages,
                time_column: log.time_column.clone(),
                start_ns: log.span.map(|span| span.0),
                end_ns: log.span.map(|span| span.1),
                duration_s: log.span.map(|(start, end)| end.seconds_since(start)),
            },
            lost: Lost {
                losses: log.losses.clone(),
                undecodable: undecodable.collect(),
                contradictions: log.contradictions.clone(),
                repeats: log.repeats.clone(),
            },
        }
    }
}

/// An audited run: the report, and what it rests on. Outputs are written of it.
#[derive(Debug)]
#[non_exhaustive]
pub struct Audited {
    /// What the audit says.
    pub report: Report,
    /// The run; where its clock began anew, the longest segment.
    pub run: Run,
    /// What was estimated on it, as the rules read it.
    pub evidence: RunEvidence,
    /// Which of the segments it is.
    pub(crate) segment: usize,
    /// Whether there are others.
    is_part: bool,
    /// What was read.
    pub(crate) read: Places,
}

impl Audited {
    /// Audits `log`, each of its segments as a run of its own. A segment that cannot be audited is left out,
    /// unless it is the longest.
    pub(crate) fn of(
        mut log: Log,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        tell_columns(&mut log, &options.run);
        let mut read = Read::of(&log);
        if let Some(given) = &given {
            read.note_corrections(given);
        }
        let segments = segments(log);
        let longest = segments.iter().map(|segment| segment.seconds).fold(0.0, f64::max);
        let (mut parts, mut main) = (Vec::new(), None);
        for segment in segments {
            let is_main = main.is_none() && segment.seconds >= longest;
            match Part::of(segment, &read, options, given) {
                Ok(part) => {
                    if is_main {
                        main = Some(parts.len());
                    }
                    parts.push(part);
                }
                Err(trouble) if is_main => return Err(trouble),
                Err(_) => {}
            }
        }
        let main = main.unwrap_or_default();
        let report = report(&parts, main, read, options);
        let is_part = parts.len() > 1;
        let Part { run, evidence, .. } = parts.swap_remove(main);
        Ok(Self { report, run, evidence, segment: main, is_part, read: options.places() })
    }

    /// With [`Report::figures`], what the pictures of the report show.
    pub fn with_figures(mut self) -> Self {
        self.report.figures = Some(self.figures());
        self
    }

    /// What the pictures of the report show.
    pub(crate) fn figures(&self) -> Figures {
        let corrected =
            |arm: &Arm, of: &ArmEvidence| of.diagnosis.corrected_joints(&arm.joints, &arm.slides());
        let drawn = figures(&self.run, &self.evidence, corrected, &self.report.findings);
        Figures { of_longest_segment: self.is_part, ..drawn }
    }

    /// The report alone. To give back the columns of a long log takes as long as to write the report on it:
    /// that is done beside.
    pub fn into_report(self) -> Report {
        let Self { report, run, evidence, .. } = self;
        rayon::spawn(|| drop((run, evidence)));
        report
    }
}

/// A segment of a run, audited.
struct Part {
    run: Run,
    evidence: RunEvidence,
    evaluation: Evaluation,
    seconds: f64,
}

/// The report on all segments, of which `main` is the longest.
fn report(parts: &[Part], main: usize, mut read: Read, options: &Options) -> Report {
    /// A segment of less than this share of the longest is short.
    const SHORT: f64 = 0.2;
    let (segment, main) = (main, &parts[main]);
    if let Some((count, seconds)) = main.run.excerpts.as_ref().map(Excerpts::extent) {
        read.note(&format!(
            "a long run: causes are sought in {count} excerpts of {:.0} s where the joints move \
             most; clocks, rates and gaps are of all of it",
            seconds / count.max(1) as f64
        ));
    }
    if main.run.arms.iter().all(|arm| arm.poses.is_empty()) {
        for &stream in &main.run.undecided {
            let topic = &main.run.streams[stream].topic;
            read.note(&format!(
                "'{topic}' may be the tool's pose, and the motion does not tell: [stream.\"{topic}\"] with role = \
                 \"pose\" in poseaudit.toml says that it is"
            ));
        }
    }
    let evaluation = match parts {
        [only] => only.evaluation.clone(),
        segments => {
            read.note(&note(segments));
            let parts = segments.iter().map(|segment| EvaluatedPart {
                evaluation: segment.evaluation.clone(),
                is_short: segment.seconds < SHORT * main.seconds,
            });
            merged(parts.collect(), segment)
        }
    };
    let streams = match parts {
        [only] => streams(&only.run),
        segments => joined(segments.iter().flat_map(|segment| streams(&segment.run))),
    };
    if let Some(config) = &options.config {
        let row = |note: String| NoteRow { path: config.clone(), note };
        read.summary.notes.push(row("settings are taken from this file".to_owned()));
        let unused = options.policy.rules.unused(&evaluation.checks).into_iter();
        let unused = unused.map(|known| {
            row(format!("nothing was asked that `ignore` names: {known} ({})", known.place))
        });
        read.summary.notes.extend(unused);
    }
    let workspace = coverage(&main.run, &evaluation);
    let mut report =
        Report::new(read.summary, robots(&main.run), streams, evaluation, options.policy.fail_on);
    report.workspace = workspace;
    report.thresholds = options.policy.rules.thresholds.clone();
    report.plans = plans(
        &main.run,
        &main.evidence,
        &report.checks,
        &report.findings,
        &options.run,
        &options.logs,
    );
    report.fails_open = options.policy.fail_on_inconclusive;
    match &main.run.no_arm {
        Some(error) if options.policy.rules.need_model() && !tells_hand_eye(&report.checks) => {
            report.with_trouble(error.into())
        }
        _ => report,
    }
}

/// What became of a run of several segments.
fn note(parts: &[Part]) -> String {
    let lengths: Vec<String> =
        parts.iter().map(|segment| format!("{:.1} s", segment.seconds)).collect();
    let (count, lengths) = (lengths.len(), lengths.join(", "));
    format!("all stamps step back: the clock began anew. Audited in {count} segments: {lengths}")
}

impl Part {
    fn of(
        segment: Segment,
        read: &Read,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        let Segment { log, seconds } = segment;
        let run = &options.run;
        options.read.begins("sorting");
        let mut run = Run::complete(log, run, |run| match given {
            Some(given) => given.apply(run, options.run.max_latency_s),
            None => Ok(()),
        })?;
        options.read.begins("estimating");
        let evidence = RunEvidence::of(&mut run, &read.lost, &options.run);
        options.read.begins("judging");
        let evaluation = evaluate(&evidence, &options.policy.rules);
        Ok(Self { run, evidence, evaluation, seconds })
    }
}

/// The report on a run that was only looked at.
pub(crate) fn summary(run: &Run, read: Read) -> Report {
    Report::of_log(read.summary, robots(run), streams(run))
}
