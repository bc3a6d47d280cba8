//! What an audit hands out: the report, and one file for each format of it.
//!
//! A format only renders. What is in a report is settled when it is made.

pub(crate) mod amounts;
pub mod compare;
mod drawn;
pub mod figures;
mod file;
mod format;
pub mod github;
pub mod html;
pub mod json;
pub mod junit;
mod kept;
pub mod markdown;
pub(crate) mod outline;
mod plans;
mod rows;
pub mod sarif;
mod spark;
mod tame;
pub mod text;
mod trouble;
mod workspace;

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{self, Evaluation, Rule, StreamObservability, Thresholds};
use crate::finding::{CheckRow, Finding, Ignored, Severity, Status, Unit, Word, word};
use crate::time::Stamp;

pub(crate) use drawn::figures;
pub use figures::Figures;
pub use file::write_whole;
pub(crate) use file::{is_descriptor, replaceable};
pub use format::{FORMATS, Format};
pub use plans::PlanRow;
pub(crate) use plans::{PlanOf, plan_around, plans};
pub use rows::{RobotRow, StreamRow};
pub(crate) use rows::{joined, robots, streams};
pub(crate) use tame::quoted;
pub use tame::{foreign, tame, upright};
pub use trouble::{Trouble, TroubleKind};
pub(crate) use workspace::{ArmWorkspace, coverage, reached};
pub use workspace::{JointCoverage, WorkspaceRow};

/// The schema of the JSON report.
pub const SCHEMA: &str = "poseaudit.report/1";

#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
enum Schema {
    #[serde(rename = "poseaudit.report/1")]
    One,
}

/// The report on one run. Its fields stand in the order of the JSON object.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(title = "poseaudit.report/1")]
pub struct Report {
    schema: Schema,
    tool: Tool,
    /// The answer in one word.
    pub verdict: Verdict,
    /// Why next to nothing could be evaluated, where that is so.
    pub error: Option<Trouble>,
    /// The files.
    pub log: LogSummary,
    /// The arms.
    pub robots: Vec<RobotRow>,
    /// The topics.
    pub streams: Vec<StreamRow>,
    /// A row for every rule asked and every subject it was asked about.
    pub checks: Vec<CheckRow>,
    /// What is wrong: the gravest first, then what moves the arm's tip most.
    pub findings: Vec<Finding>,
    /// What is wrong, known to the caller and not counted, with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ignored: Vec<Ignored>,
    /// What each pose stream cannot show, and the motion that would.
    #[serde(default)]
    pub observability: Vec<StreamObservability>,
    /// Over which part of its ranges each arm moved.
    #[serde(default)]
    pub workspace: Vec<WorkspaceRow>,
    /// The motions that would settle what was left open.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub plans: Vec<PlanRow>,
    /// The call that made it, as a shell takes it.
    #[serde(skip)]
    call: Option<String>,
    /// The least severity that fails the run; `None` where nothing does.
    #[serde(skip)]
    fail_on: Option<Severity>,
    /// Whether an inconclusive verdict fails the run, too.
    #[serde(skip)]
    pub fails_open: bool,
    /// What its pictures show, where they were asked for.
    #[serde(skip)]
    pub figures: Option<Figures>,
    /// The amounts that the caller set instead of the rules' own.
    #[serde(skip)]
    pub(crate) thresholds: Thresholds,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
struct Tool {
    #[serde(deserialize_with = "word")]
    name: Word,
    #[serde(deserialize_with = "word")]
    version: Word,
}

/// The answer in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing wrong, and the headline rules could tell.
    Pass,
    /// There is a finding at or above the severity that fails.
    Fail,
    /// Nothing wrong was found, but a headline rule could not tell.
    Inconclusive,
}

/// What was read.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct LogSummary {
    /// The files, in the order given.
    pub files: Vec<FileRow>,
    /// Messages read.
    pub messages: u64,
    /// First log time.
    #[schemars(with = "Option<String>")]
    pub start_ns: Option<Stamp>,
    /// Last log time.
    #[schemars(with = "Option<String>")]
    pub end_ns: Option<Stamp>,
    /// From the first to the last log time, s.
    pub duration_s: Option<f64>,
    /// The column of a table that holds times, where its numbers told it and not its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_column: Option<String>,
    /// What a reader should know of the files, and is no damage.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<NoteRow>,
}

/// One file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct FileRow {
    /// Path as given.
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// What kind of file it is.
    #[serde(deserialize_with = "word")]
    pub container: Word,
    /// Its size.
    pub bytes: u64,
    /// How many bytes were fetched to read it, where it is an object in a store.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fetched_bytes: Option<u64>,
    /// How much of it a checksum vouches for: `all`, `partial` or `none`.
    #[serde(deserialize_with = "word")]
    pub crc: Word,
}

impl FileRow {
    /// How much of an object was fetched, in words; `None` for a local file.
    pub fn fetched(&self) -> Option<String> {
        let (fetched, size) = (self.fetched_bytes? as f64, self.bytes as f64);
        let (megabytes, percent) = (fetched / 1e6, 100.0 * fetched / size.max(1.0));
        Some(format!("{megabytes:.1} of {:.1} MB fetched ({percent:.1} %)", size / 1e6))
    }
}

/// What a reader should know of a file, and is no damage.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct NoteRow {
    /// The file, or the folder.
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// What there is to know.
    pub note: String,
}

impl Report {
    /// The report on what was read and evaluated. A finding of severity `fail_on` or above fails
    /// the run; `None` lets nothing fail it.
    pub fn new(
        log: LogSummary,
        robots: Vec<RobotRow>,
        streams: Vec<StreamRow>,
        evaluation: Evaluation,
        fail_on: Option<Severity>,
    ) -> Self {
        let Evaluation { checks, findings, ignored, observability } = evaluation;
        let verdict = verdict(&checks, &findings, fail_on);
        let trouble = nothing_evaluated(&log, &checks);
        let report = Self {
            verdict,
            log,
            robots,
            streams,
            checks,
            findings,
            ignored,
            observability,
            fail_on,
            ..Self::empty()
        };
        match trouble {
            Some(trouble) => report.with_trouble(trouble),
            None => report,
        }
    }

    /// The call that writes a recording of the same audit.
    fn replay(&self) -> String {
        let call = self.call.clone().unwrap_or_else(|| {
            let logs = self.log.files.iter().map(|file| file.path.display().to_string());
            let logs: Vec<String> = logs.map(|log| tame::shell_word(&log)).collect();
            format!("poseaudit audit {}", logs.join(" "))
        });
        format!("{call} --rrd run.rrd")
    }

    /// Keeps the words of the call that made it.
    pub fn called(mut self, words: &[String]) -> Self {
        let words: Vec<String> = words.iter().map(|word| tame::shell_word(word)).collect();
        self.call = Some(words.join(" "));
        self
    }

    /// The report on what a log holds, with nothing evaluated.
    pub fn of_log(log: LogSummary, robots: Vec<RobotRow>, streams: Vec<StreamRow>) -> Self {
        Self { log, robots, streams, ..Self::empty() }
    }

    /// The report where there is nothing to report on but the trouble.
    pub fn of_trouble(trouble: Trouble) -> Self {
        Self { error: Some(trouble), ..Self::empty() }
    }

    /// This report, with what kept it from saying more. It cannot be a pass then.
    pub fn with_trouble(self, trouble: Trouble) -> Self {
        let verdict = match self.verdict {
            Verdict::Pass => Verdict::Inconclusive,
            verdict => verdict,
        };
        Self { verdict, error: Some(trouble), ..self }
    }

    fn empty() -> Self {
        Self {
            schema: Schema::One,
            tool: Tool { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") },
            verdict: Verdict::Inconclusive,
            error: None,
            log: LogSummary::default(),
            robots: Vec::new(),
            streams: Vec::new(),
            checks: Vec::new(),
            findings: Vec::new(),
            ignored: Vec::new(),
            observability: Vec::new(),
            workspace: Vec::new(),
            plans: Vec::new(),
            fail_on: None,
            call: None,
            fails_open: false,
            figures: None,
            thresholds: Thresholds::default(),
        }
    }

    /// From which amount in `unit` a rule warns; `None` where it judges none in that unit.
    pub(crate) fn warns_from(&self, rule: &Rule, unit: Unit) -> Option<f64> {
        let own = rule.grade.thresholds().iter().find(|threshold| threshold.unit == unit)?;
        Some(self.thresholds.of(rule, *own).warning)
    }

    /// Whether a finding of this severity fails the run.
    pub fn fails_on(&self, severity: Severity) -> bool {
        self.fail_on.is_some_and(|least| severity >= least)
    }

    /// The codes of the rules that leave a verdict INCONCLUSIVE.
    pub fn undecided(&self) -> Vec<&'static str> {
        undecided(&self.checks).map(|rule| rule.code).collect()
    }

    /// The file that what kept the audit from saying more is shown at: the first of the log, else the
    /// one that could not be read.
    fn file_in_trouble(&self) -> Option<&Path> {
        let first = self.log.files.first().map(|file| file.path.as_path());
        let of_log = self.error.as_ref().filter(|trouble| trouble.kind == TroubleKind::Log);
        first.or_else(|| of_log.map(|trouble| Path::new(&trouble.place)))
    }

    /// The rules in `required` that decided nothing, or left a subject open that could be decided.
    pub fn not_concluded(&self, required: &[checks::Selector]) -> Vec<&'static str> {
        let rules = checks::registry().iter().map(|rule| rule.code);
        let required = rules.filter(|code| required.iter().any(|selector| selector.names(code)));
        required
            .filter(|code| {
                let mut rows = self.checks.iter().filter(|row| row.code == *code);
                let open =
                    |row: &CheckRow| row.status == Status::Inconclusive && !row.indistinguishable;
                rows.clone().any(open) || !rows.any(|row| row.status.is_decided())
            })
            .collect()
    }
}

/// The trouble where rules about an arm were asked and none found its input in the log.
fn nothing_evaluated(log: &LogSummary, checks: &[CheckRow]) -> Option<Trouble> {
    let needs_model = |row: &&CheckRow| checks::find(row.code).is_ok_and(|rule| rule.needs_model);
    let about_arm: Vec<&CheckRow> = checks.iter().filter(needs_model).collect();
    let is_evaluated = |row: &&CheckRow| row.status != Status::Skipped || row.exempt;
    if about_arm.iter().any(is_evaluated) || tells_hand_eye(checks) {
        return None;
    }
    let why = about_arm.first()?.reason.as_deref().unwrap_or_default();
    let file = log.files.first().map(|file| file.path.display().to_string());
    Some(Trouble {
        kind: TroubleKind::Log,
        what: format!("nothing can be audited: {why}"),
        place: file.unwrap_or_else(|| "the log".to_owned()),
        remedy: "record the joint states with a pose, /tf or an IMU".to_owned(),
    })
}

/// Whether hand and eye were judged, which needs no arm.
pub(crate) fn tells_hand_eye(checks: &[CheckRow]) -> bool {
    checks.iter().any(|row| row.code.starts_with("HEC") && row.status.is_decided())
}

/// Fail with a finding at or above `fail_on`; else inconclusive where a headline rule found its
/// input and decided none of its subjects, or what proves a pass left one open; else pass. Subjects that
/// no such log could decide do not count.
fn verdict(checks: &[CheckRow], findings: &[Finding], fail_on: Option<Severity>) -> Verdict {
    if fail_on.is_some_and(|least| findings.iter().any(|finding| finding.severity >= least)) {
        return Verdict::Fail;
    }
    let is_open = undecided(checks).next().is_some();
    if is_open { Verdict::Inconclusive } else { Verdict::Pass }
}

/// The headline rules that found their input and decided none of their subjects, or of which one open
/// subject is too many.
fn undecided(checks: &[CheckRow]) -> impl Iterator<Item = &'static Rule> {
    let headline = checks::registry().iter().copied().filter(|rule| rule.headline);
    headline.filter(|rule| {
        let rows = checks.iter().filter(|row| row.code == rule.code);
        let asked = rows.filter(|row| row.status != Status::Skipped && !row.indistinguishable);
        let (derived, witnesses): (Vec<&CheckRow>, Vec<&CheckRow>) =
            asked.partition(|row| row.evidence.contains_key(checks::DERIVED));
        // A stream that is computed from the joint states decides nothing for another.
        let asked = if witnesses.is_empty() { derived } else { witnesses };
        let is_hidden = |row: &&CheckRow| row.evidence.contains_key(checks::UNKNOWN_WORLD);
        if asked.iter().any(is_hidden) {
            return true;
        }
        let decided: Vec<bool> = asked.iter().map(|row| row.status.is_decided()).collect();
        match rule.is_proof() {
            true => decided.contains(&false),
            false => !decided.is_empty() && !decided.contains(&true),
        }
    })
}

impl Verdict {
    /// Its name in JSON and in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Verdict::Pass => "pass",
            Verdict::Fail => "fail",
            Verdict::Inconclusive => "inconclusive",
        }
    }

    /// The verdict of this name.
    pub fn named(name: &str) -> Option<Self> {
        let all = [Verdict::Pass, Verdict::Fail, Verdict::Inconclusive];
        all.into_iter().find(|verdict| verdict.name() == name)
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Verdict::Pass => "PASS",
            Verdict::Fail => "FAIL",
            Verdict::Inconclusive => "INCONCLUSIVE",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Subject;
    use serde_json::Map;

    fn row(code: &'static str, status: Status, indistinguishable: bool) -> CheckRow {
        CheckRow {
            code,
            name: "",
            subject: Subject::default(),
            status,
            reason: None,
            estimate: None,
            evidence: Map::new(),
            indistinguishable,
            exempt: false,
        }
    }

    fn verdict_of(checks: Vec<CheckRow>) -> Verdict {
        verdict(&checks, &[], Some(Severity::Warning))
    }

    #[test]
    fn a_headline_rule_that_decided_nothing_is_no_pass() {
        let (open, decided) = (Status::Inconclusive, Status::Pass);
        assert_eq!(verdict_of(vec![row("LAT001", open, false)]), Verdict::Inconclusive);
        let one_decided = vec![row("LAT001", open, false), row("LAT001", decided, false)];
        assert_eq!(verdict_of(one_decided), Verdict::Pass);
        let known = CheckRow { exempt: true, ..row("LAT001", Status::Skipped, false) };
        assert_eq!(nothing_evaluated(&LogSummary::default(), &[known]), None);
        let skipped = vec![row("LAT001", Status::Skipped, false)];
        assert_eq!(verdict_of(skipped.clone()), Verdict::Pass);
        let evaluation = Evaluation { checks: skipped, ..Evaluation::default() };
        let report = Report::new(LogSummary::default(), vec![], vec![], evaluation, None);
        assert!(report.error.is_some() && report.verdict == Verdict::Inconclusive);
        assert_eq!(verdict_of(vec![row("FRM001", open, false)]), Verdict::Pass);
        assert_eq!(verdict_of(vec![row("ZER001", open, true)]), Verdict::Pass);
        let one_unproven = vec![row("MDL001", open, false), row("MDL001", decided, false)];
        assert_eq!(verdict_of(one_unproven), Verdict::Inconclusive);
    }

    #[test]
    fn a_required_rule_must_decide_and_leave_nothing_open() -> Result<(), checks::UnknownRule> {
        let required = ["LAT001".parse()?];
        let not_concluded = |checks| {
            Report::new(
                LogSummary::default(),
                vec![],
                vec![],
                Evaluation { checks, ..Evaluation::default() },
                None,
            )
            .not_concluded(&required)
        };
        let pass = row("LAT001", Status::Pass, false);
        assert!(not_concluded(vec![pass.clone()]).is_empty());
        assert_eq!(not_concluded(vec![]), ["LAT001"]);
        assert_eq!(not_concluded(vec![row("LAT001", Status::Skipped, false)]), ["LAT001"]);
        let open = row("LAT001", Status::Inconclusive, false);
        assert_eq!(not_concluded(vec![pass.clone(), open]), ["LAT001"]);
        let by_construction = row("LAT001", Status::Inconclusive, true);
        assert!(not_concluded(vec![pass, by_construction]).is_empty());
        Ok(())
    }
}
