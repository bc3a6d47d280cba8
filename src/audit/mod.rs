//! Reads a log into runs, evaluates the rules on each, and builds the report.

#[cfg(test)]
mod any_log;
mod calibrate;
mod calibration_input;
mod competing_arm;
mod demo;
mod fixed_point;
mod missing_rate;
mod options;
mod tables;

use crate::checks::{Evaluation, SegmentEvaluation, evaluate, merge_segments};
use crate::corrections::GivenCorrections;
use crate::evidence::{ArmEvidence, ReadLosses, RunEvidence, UndecodableContent, UndecodableTopic};
use crate::log::{Extent, Log, Loss};
use crate::places::PathRegistry;
use crate::report::{
    Figures, FileRow, LogSummary, NoteRow, Plots, Report, Trouble, build_figures, comparison_rows,
    has_decided_hand_eye, has_fault, join_segments, plans, robot_rows, stream_rows, table_rows,
    workspace_coverage,
};
use crate::run::{
    Arm, Cut, Excerpts, Run, RunOptions, Segment, align_table_clocks, identify_columns, segments,
};

pub use calibrate::{CalibrationResult, calibrate, calibrate_at_fixed_points};
pub use calibration_input::{CalibrationInput, Measurement};
pub use demo::{DEMO_LOG, DEMO_PAIR_LOG, Demo, PlantedFault, demo, demo_pair};
pub(crate) use missing_rate::{open, open_listing};
pub use options::{Options, Policy};

pub(crate) struct ReadLog {
    summary: LogSummary,
    losses: ReadLosses,
}

impl ReadLog {
    pub fn note_corrections(&mut self, given: &GivenCorrections<'_>) {
        let path = given.file.to_owned();
        let notes = given.notes().into_iter().map(|note| NoteRow { path: path.clone(), note });
        self.summary.notes.extend(notes);
    }

    fn segments_note(&mut self, what: &str) {
        if let Some(file) = self.summary.files.first() {
            let path = file.path.clone();
            self.summary.notes.push(NoteRow { path, note: what.to_owned() });
        }
    }

    pub fn from_log(log: &Log) -> Self {
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
                what: UndecodableContent::Messages(topic.type_name.clone()),
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
                tables: table_rows(log),
                start_ns: log.span.map(|span| span.0),
                end_ns: log.span.map(|span| span.1),
                duration_s: log.span.map(|(start, end)| end.seconds_since(start)),
            },
            losses: ReadLosses {
                losses: log.losses.clone(),
                undecodable: undecodable.collect(),
                contradictions: log.contradictions.clone(),
                repeats: log.repeats.clone(),
            },
        }
    }
}

/// An audited run: the report and its data.
#[derive(Debug)]
#[non_exhaustive]
pub struct Audited {
    /// Report.
    pub report: Report,
    /// Its longest segment if the clock restarted.
    pub run: Run,
    /// Estimates used by the rules.
    pub evidence: RunEvidence,
    /// Index of that segment.
    pub(crate) segment: usize,
    is_part: bool,
    pub(crate) read: PathRegistry,
}

/// Identifies the columns of tables and aligns their clocks: the first step of an audit.
///
/// # Errors
/// If tables with different time origins cannot be aligned.
pub fn prepare(log: &mut Log, options: &RunOptions) -> Result<(), Trouble> {
    prepare_corrected(log, options, None)
}

/// The same, with corrected stamps. Topics that consist of identified columns are corrected too.
///
/// # Errors
/// As [`prepare`], and if a corrected topic is not in the log.
pub(crate) fn prepare_corrected(
    log: &mut Log,
    options: &RunOptions,
    given: Option<&GivenCorrections<'_>>,
) -> Result<(), Trouble> {
    identify_columns(log, options);
    given.map_or(Ok(()), |given| given.correct_stamps(log))?;
    align_table_clocks(log, options).map_err(Trouble::from)
}

impl Audited {
    /// Audits each segment as a separate run. Reports a segment that cannot be audited (ING001); returns
    /// the error of the longest. The log must be [`prepare`]d.
    pub(crate) fn audit(
        log: Log,
        options: &Options,
        given: Option<GivenCorrections<'_>>,
    ) -> Result<Self, Trouble> {
        let mut read = ReadLog::from_log(&log);
        if let Some(given) = &given {
            read.note_corrections(given);
        }
        let segments = segments(log);
        let longest = segments.iter().map(|segment| segment.duration_s).fold(0.0, f64::max);
        let (mut parts, mut main) = (Vec::new(), None);
        let (count, mut not_audited) = (segments.len(), Vec::new());
        for (index, segment) in segments.into_iter().enumerate() {
            let is_main = main.is_none() && segment.duration_s >= longest;
            let file = segment.log.files.first().map(|file| file.path.clone());
            let messages = segment.messages();
            match AuditedSegment::audit(segment, &read, options, given) {
                Ok(part) => {
                    if is_main {
                        main = Some(parts.len());
                    }
                    parts.push(part);
                }
                Err(trouble) if is_main => return Err(trouble),
                Err(trouble) => not_audited.push(Loss {
                    file: file.unwrap_or_default(),
                    offset: None,
                    what: format!(
                        "segment {} of {count} cannot be audited: {}",
                        index + 1,
                        trouble.what
                    ),
                    messages: Some(messages),
                    span: None,
                    extent: Extent::NotAudited,
                }),
            }
        }
        // Losses of the file belong to the first segment.
        if let Some(first) = parts.first_mut().filter(|_| !not_audited.is_empty()) {
            first.evidence.losses.extend(not_audited);
            first.evaluation = evaluate(&first.evidence, &options.policy.rules);
        }
        let main = main.unwrap_or_default();
        let report = build_report(&parts, main, read, options);
        let is_part = parts.len() > 1;
        let AuditedSegment { run, evidence, .. } = parts.swap_remove(main);
        Ok(Self { report, run, evidence, segment: main, is_part, read: options.places() })
    }

    /// Adds [`Report::figures`].
    pub fn with_figures(mut self) -> Self {
        self.report.figures = Some(self.figures(Plots::All));
        self
    }

    /// Adds the figures of the text format, which draws the errors that a fault explains.
    pub fn with_error_series(mut self) -> Self {
        if has_fault(&self.report.findings) {
            self.report.figures = Some(self.figures(Plots::OverTime));
        }
        self
    }

    pub(crate) fn figures(&self, plots: Plots) -> Figures {
        let corrected = |arm: &Arm, of: &ArmEvidence| {
            of.diagnosis.corrected_joints(&arm.joints, &arm.are_prismatic())
        };
        let drawn =
            build_figures(&self.run, &self.evidence, corrected, &self.report.findings, plots);
        Figures { is_longest_segment: self.is_part, ..drawn }
    }

    /// The report alone. Columns are freed in the background, if there are threads for it: for a long log that takes as
    /// long as writing the report.
    pub fn into_report(self) -> Report {
        let Self { report, run, evidence, .. } = self;
        if rayon::current_num_threads() > 1 {
            rayon::spawn(|| drop((run, evidence)));
        }
        report
    }
}

struct AuditedSegment {
    run: Run,
    evidence: RunEvidence,
    evaluation: Evaluation,
    duration_s: f64,
    cut: Option<Cut>,
}

/// `main` is the longest segment.
fn build_report(
    parts: &[AuditedSegment],
    main: usize,
    mut read: ReadLog,
    options: &Options,
) -> Report {
    /// Fraction of the longest segment.
    const MAX_SHORT_SEGMENT_SHARE: f64 = 0.2;
    let (segment, main) = (main, &parts[main]);
    if let Some((count, seconds)) = main.run.excerpts.as_ref().map(Excerpts::extent) {
        read.segments_note(&format!(
            "long run: causes are estimated from {count} excerpts of {:.0} s with the most joint motion; \
             clocks, rates and gaps cover the whole run",
            seconds / count.max(1) as f64
        ));
    }
    if main.run.arms.iter().all(|arm| arm.poses.is_empty()) {
        for &stream in &main.run.undecided {
            let topic = &main.run.streams[stream].topic;
            read.segments_note(&format!(
                "'{topic}' may be the tool's pose, but the motion does not confirm it; set role = \"pose\" \
                 in [stream.\"{topic}\"] of poseaudit.toml if it is"
            ));
        }
    }
    let evaluation = match parts {
        [only] => only.evaluation.clone(),
        segments => {
            read.segments_note(&note(segments));
            let parts = segments.iter().map(|segment| SegmentEvaluation {
                evaluation: segment.evaluation.clone(),
                is_short: segment.duration_s < MAX_SHORT_SEGMENT_SHARE * main.duration_s,
            });
            merge_segments(parts.collect(), segment)
        }
    };
    let streams = match parts {
        [only] => stream_rows(&only.run),
        segments => join_segments(segments.iter().flat_map(|segment| stream_rows(&segment.run))),
    };
    if let Some(config) = &options.config {
        let row = |note: String| NoteRow { path: config.clone(), note };
        read.summary.notes.push(row("settings are from this file".to_owned()));
        let unused = options.policy.rules.unused_exemptions(&evaluation.checks).into_iter();
        let unused = unused.map(|known| {
            row(format!("`ignore` entry matches no check: {known} ({})", known.place))
        });
        read.summary.notes.extend(unused);
    }
    if let (Some(reference), Some(log)) = (&options.run.reference, options.logs.first())
        && main.run.arms.iter().all(|arm| arm.trajectory.is_none())
    {
        let note = format!(
            "'{reference}' is not the reference: forward kinematics of the joint states is (--reference)"
        );
        read.summary.notes.push(NoteRow { path: log.clone(), note });
    }
    let workspace = workspace_coverage(&main.run, &evaluation);
    let mut report = Report::new(
        read.summary,
        robot_rows(&main.run),
        streams,
        evaluation,
        options.policy.fail_on,
    );
    report.workspace = workspace;
    report.comparisons = comparison_rows(&main.run);
    report.thresholds = options.policy.rules.thresholds.clone();
    report.plans = plans(
        &main.run, &main.evidence, &report.checks, &report.findings, &options.run, &options.logs,
    );
    report.fails_if_inconclusive = options.policy.fail_on_inconclusive;
    report.required.clone_from(&options.policy.rules.required);
    match &main.run.no_arm {
        Some(error)
            if options.policy.rules.needs_model()
                && main.evidence.unmodelled_arms.is_empty()
                && !has_decided_hand_eye(&report.checks) =>
        {
            report.with_trouble(error.into())
        }
        _ => report,
    }
}

fn note(parts: &[AuditedSegment]) -> String {
    let lengths: Vec<String> =
        parts.iter().map(|segment| format!("{:.1} s", segment.duration_s)).collect();
    let (count, lengths) = (lengths.len(), lengths.join(", "));
    let why = match parts.first().and_then(|segment| segment.cut) {
        Some(Cut::Seam) => {
            "the joints jump within one row: another recording follows, or rows are missing"
        }
        _ => "all stamps start again: the clock restarted, or another recording follows",
    };
    format!("{why}. Audited in {count} segments: {lengths}")
}

impl AuditedSegment {
    fn audit(
        segment: Segment,
        read: &ReadLog,
        options: &Options,
        given: Option<GivenCorrections<'_>>,
    ) -> Result<Self, Trouble> {
        let Segment { log, duration_s, cut } = segment;
        let run = &options.run;
        options.read.set_activity("sorting");
        let mut run = Run::complete(log, run, |run| match given {
            Some(given) => given.apply(run, options.run.max_latency_s),
            None => Ok(()),
        })?;
        options.read.set_activity("estimating");
        let evidence = RunEvidence::collect(&mut run, &read.losses, &options.run);
        options.read.set_activity("judging");
        let evaluation = evaluate(&evidence, &options.policy.rules);
        Ok(Self { run, evidence, evaluation, duration_s, cut })
    }
}

pub(crate) fn summarize(run: &Run, read: ReadLog) -> Report {
    let mut report = Report::from_log(read.summary, robot_rows(run), stream_rows(run));
    report.comparisons = comparison_rows(run);
    report
}
