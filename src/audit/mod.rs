//! What joins the rooms: a run's streams into the diagnosis, its results into facts for the rules,
//! and both into the report.

mod arms;
mod estimate;
mod facts;
mod hand_eye;
mod options;
mod pictures;
mod references;
mod rows;
mod settle;
mod tables;
mod workspace;

use std::path::Path;

use crate::checks::{
    ArmFacts, EvaluatedPart, Evaluation, Facts, Undecodable, UndecodableTopic, evaluate, merged,
};
use crate::corrections::{Given, Mending};
use crate::log::{Log, Loss};
use crate::places::Places;
use crate::report::{
    Figures, FileRow, LogSummary, NoteRow, Report, Trouble, TroubleKind, tells_hand_eye,
};
use crate::run::{Arm, Excerpts, Run, Segment, segments};

use estimate::{diagnose, readable_joints};
use facts::facts;
use hand_eye::hand_eyes;
pub(crate) use hand_eye::settle_hands;
pub use options::Options;
use pictures::figures;
use references::references;
use rows::{joined, robots, streams};
pub(crate) use settle::settle;
pub(crate) use tables::write_tables;
use workspace::{coverage, reached};

/// What the report says of the files themselves.
pub(crate) struct Read {
    summary: LogSummary,
    losses: Vec<Loss>,
    undecodable: Vec<UndecodableTopic>,
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
                start_ns: log.span.map(|span| span.0),
                end_ns: log.span.map(|span| span.1),
                duration_s: log.span.map(|(start, end)| end.seconds_since(start)),
            },
            losses: log.losses.clone(),
            undecodable: undecodable.collect(),
        }
    }
}

/// A segment of a run, audited.
pub(crate) struct Audited {
    pub run: Run,
    pub facts: Facts,
    evaluation: Evaluation,
    seconds: f64,
}

/// The audits of all segments, one at least.
pub(crate) struct Audits {
    segments: Vec<Audited>,
    /// The longest.
    main: usize,
}

impl Audits {
    /// Audits the segments of `log`, each as a run of its own. One that cannot be is left out, unless
    /// it is the longest.
    pub fn of(
        log: Log,
        read: &Read,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        let segments = segments(log);
        let longest = segments.iter().map(|segment| segment.seconds).fold(0.0, f64::max);
        let mut audits = Audits { segments: Vec::new(), main: 0 };
        let mut has_main = false;
        for segment in segments {
            let is_main = !has_main && segment.seconds >= longest;
            match Audited::of(segment, read, options, given) {
                Ok(audited) => {
                    if is_main {
                        (audits.main, has_main) = (audits.segments.len(), true);
                    }
                    audits.segments.push(audited);
                }
                Err(trouble) if is_main => return Err(trouble),
                Err(_) => {}
            }
        }
        Ok(audits)
    }

    /// The longest segment.
    pub fn main(&self) -> &Audited {
        &self.segments[self.main]
    }

    /// What the pictures of the longest segment show that belong to `report`.
    pub fn figures(&self, report: &Report) -> Figures {
        let Audited { run, facts, .. } = self.main();
        let corrected = |arm: &Arm, facts: &ArmFacts| {
            facts.diagnosis.corrected_joints(&arm.joints, &arm.slides())
        };
        let of_longest_segment = self.segments.len() > 1;
        let is_told = |topic: &str| {
            report.findings.iter().any(|found| found.subject.topic.as_deref() == Some(topic))
        };
        Figures { of_longest_segment, ..figures(run, facts, corrected, is_told) }
    }

    /// Writes what mends the findings of `report`, which is on these, into `folder`.
    pub fn write_fixes(&self, report: &Report, of: &Options, folder: &Path) -> Result<(), Trouble> {
        let Audited { run, facts, .. } = self.main();
        let mending = Mending::of(report, run, facts, self.main);
        mending.write(folder, &Places::of(of)).map_err(|(place, error)| Trouble {
            kind: TroubleKind::Call,
            what: format!("cannot be written: {error}"),
            place,
            remedy: "name a folder that can be written to with --fix".to_owned(),
        })
    }

    /// The report on all of them.
    pub fn report(&self, mut read: Read, options: &Options) -> Report {
        /// A segment of less than this share of the longest is short.
        const SHORT: f64 = 0.2;
        let main = self.main();
        if let Some((count, seconds)) = main.run.excerpts.as_ref().map(Excerpts::extent) {
            read.note(&format!(
                "a long run: causes are sought in {count} excerpts of {:.0} s where the joints move \
                 most; clocks, rates and gaps are of all of it",
                seconds / count.max(1) as f64
            ));
        }
        let evaluation = match self.segments.as_slice() {
            [only] => only.evaluation.clone(),
            segments => {
                read.note(&self.note());
                let parts = segments.iter().map(|segment| EvaluatedPart {
                    evaluation: segment.evaluation.clone(),
                    is_short: segment.seconds < SHORT * main.seconds,
                });
                merged(parts.collect(), self.main)
            }
        };
        let streams = match self.segments.as_slice() {
            [only] => streams(&only.run),
            segments => joined(segments.iter().flat_map(|segment| streams(&segment.run))),
        };
        if let Some(config) = &options.config {
            let row = |note: String| NoteRow { path: config.clone(), note };
            read.summary.notes.push(row("settings are taken from this file".to_owned()));
            let unused = options.rules.unused(&evaluation.checks).into_iter();
            let unused = unused.map(|known| {
                row(format!("nothing was asked that `ignore` names: {known} ({})", known.place))
            });
            read.summary.notes.extend(unused);
        }
        let workspace = coverage(&main.run, &evaluation);
        let mut report =
            Report::new(read.summary, robots(&main.run), streams, evaluation, options.fail_on);
        report.workspace = workspace;
        report.fails_open = options.fail_on_inconclusive;
        match &main.run.no_arm {
            Some(error) if options.rules.need_model() && !tells_hand_eye(&report.checks) => {
                report.with_trouble(error.into())
            }
            _ => report,
        }
    }

    /// What became of the run.
    fn note(&self) -> String {
        let lengths: Vec<String> =
            self.segments.iter().map(|segment| format!("{:.1} s", segment.seconds)).collect();
        let (count, lengths) = (lengths.len(), lengths.join(", "));
        format!(
            "all stamps step back: the clock began anew. Audited in {count} segments: {lengths}"
        )
    }
}

impl Audited {
    fn of(
        segment: Segment,
        read: &Read,
        options: &Options,
        given: Option<Given<'_>>,
    ) -> Result<Self, Trouble> {
        let Segment { log, seconds } = segment;
        let mut run = Run::assemble(log, &options.run()).map_err(|error| Trouble::from(&error))?;
        if let Some(given) = given {
            given.apply(&mut run, options.max_latency_s)?;
        }
        settle(&mut run, options.max_latency_s);
        settle_hands(&mut run, options.max_latency_s);
        let diagnoses = diagnose(&mut run, options.max_latency_s);
        let joints = |arm: usize| readable_joints(&run.arms[arm], &diagnoses[arm].arm);
        let hand_eyes = hand_eyes(&run, joints, options.max_latency_s);
        let mut facts = Facts { hand_eyes, ..facts(&run, diagnoses, read, options) };
        for (index, arm) in facts.robots.iter_mut().enumerate() {
            arm.references = references(&run, index, arm, options.max_latency_s);
        }
        let evaluation = evaluate(&facts, &options.rules);
        Ok(Self { run, facts, evaluation, seconds })
    }
}

/// The report on a run that was only looked at.
pub(crate) fn summary(run: &Run, read: Read) -> Report {
    Report::of_log(read.summary, robots(run), streams(run))
}
