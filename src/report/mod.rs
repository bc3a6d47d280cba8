//! The audit report, with one file per output format. Formats only render: a report is complete when
//! created.

pub(crate) mod amounts;
pub mod compare;
mod comparisons;
mod figure_builder;
pub mod figures;
mod file;
mod format;
pub mod github;
pub mod html;
pub mod json;
pub mod junit;
pub mod markdown;
pub(crate) mod outline;
mod plans;
mod rows;
mod sanitize;
pub mod sarif;
mod sparkline;
mod stored;
pub(crate) mod styles;
pub mod text;
mod trouble;
mod workspace;

use std::fmt;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{self, Evaluation, Rule, StreamObservability, Thresholds};
use crate::finding::{
    Cause, CheckRow, Finding, IgnoredFinding, Severity, Status, Unit, Word, deserialize_word,
};
use crate::run::Role;
use crate::time::Stamp;

pub(crate) use comparisons::comparison_rows;
pub use comparisons::{ComparisonRow, TrajectoryErrorRow};
pub(crate) use figure_builder::{Plots, build_figures};
pub use figures::Figures;
pub use file::write_whole;
pub(crate) use file::{is_descriptor, resolve_local_link};
pub use format::{FORMATS, Format};
pub use plans::PlanRow;
pub(crate) use plans::{PlanInputs, plan_command, plans};
pub use rows::{RobotRow, StreamRow};
pub(crate) use rows::{join_segments, robot_rows, stream_rows, table_rows};
pub(crate) use sanitize::quote_line;
pub use sanitize::{escape_direction, quote_for_shell, sanitize, sanitize_display};
pub(crate) use sparkline::has_fault;
pub use trouble::{Trouble, TroubleKind};
pub(crate) use workspace::{ArmWorkspace, reached_workspaces, workspace_coverage};
pub use workspace::{JointCoverage, WorkspaceRow};

/// Schema of the JSON report.
pub const SCHEMA: &str = "poseaudit.report/1";

#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
enum Schema {
    #[serde(rename = "poseaudit.report/1")]
    One,
}

/// Report on one run. The fields are in the order of the JSON object.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[schemars(title = "poseaudit.report/1")]
pub struct Report {
    schema: Schema,
    tool: Tool,
    /// Overall result.
    pub verdict: Verdict,
    /// Why almost nothing could be evaluated, if so.
    pub error: Option<Trouble>,
    /// The audited files.
    pub log: LogSummary,
    /// The arms.
    pub robots: Vec<RobotRow>,
    /// Pose streams compared with each other, without joint states.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub comparisons: Vec<ComparisonRow>,
    /// The topics.
    pub streams: Vec<StreamRow>,
    /// One row for each rule and each subject it was evaluated on.
    pub checks: Vec<CheckRow>,
    /// Problems found: by severity, then by their effect at the arm's tip.
    pub findings: Vec<Finding>,
    /// Problems that the configuration ignores, with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ignored: Vec<IgnoredFinding>,
    /// Parameters that are not observable in each pose stream, and a motion that would show them.
    #[serde(default)]
    pub observability: Vec<StreamObservability>,
    /// Part of its joint ranges that each arm covered.
    #[serde(default)]
    pub workspace: Vec<WorkspaceRow>,
    /// Motions that would resolve inconclusive checks.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub plans: Vec<PlanRow>,
    /// Shell command that created it.
    #[serde(skip)]
    command_line: Option<String>,
    /// Lowest severity that fails the run; `None` for none.
    #[serde(skip)]
    fail_on: Option<Severity>,
    /// An inconclusive verdict fails the run.
    #[serde(skip)]
    pub fails_if_inconclusive: bool,
    /// Rules that must be decided, or the run fails.
    #[serde(skip)]
    pub required: Vec<checks::Selector>,
    /// The text report also lists passed and skipped checks.
    #[serde(skip)]
    pub is_verbose: bool,
    /// If requested.
    #[serde(skip)]
    pub figures: Option<Figures>,
    /// Includes overrides from the configuration.
    #[serde(skip)]
    pub(crate) thresholds: Thresholds,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
struct Tool {
    #[serde(deserialize_with = "deserialize_word")]
    name: Word,
    #[serde(deserialize_with = "deserialize_word")]
    version: Word,
}

/// Overall result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// No problem found, and the headline rules were decided.
    Pass,
    /// A finding reaches the severity that fails the run.
    Fail,
    /// No problem found, but a headline rule could not be decided.
    Inconclusive,
}

/// The log that was read.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
pub struct LogSummary {
    /// The files, in the order given.
    pub files: Vec<FileRow>,
    /// Number of messages read.
    pub messages: u64,
    /// First log time.
    #[schemars(with = "Option<String>")]
    pub start_ns: Option<Stamp>,
    /// Last log time.
    #[schemars(with = "Option<String>")]
    pub end_ns: Option<Stamp>,
    /// Time from the first to the last log time, s.
    pub duration_s: Option<f64>,
    /// Time column of a table, if it was identified by its values instead of its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_column: Option<String>,
    /// Remarks on the files that are not damage.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<NoteRow>,
    /// Tables, with the meaning of their columns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tables: Vec<TableRow>,
}

/// One table; episodes with the same columns are one.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct TableRow {
    /// Its first file.
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// Columns of a row.
    pub width: usize,
    /// Meaning of the columns as a value of `--columns`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<String>,
    /// Why the layout is only a proposal; absent if the columns were read like that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout_reason: Option<String>,
    /// Neighbouring columns with the same meaning.
    pub columns: Vec<ColumnRow>,
}

/// Neighbouring columns with the same meaning.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ColumnRow {
    /// Positions in the row, from 1, as in `2-7`.
    pub numbers: String,
    /// Names, as in `[columns]` of a config.
    pub names: String,
    /// Topic that they are part of, or why they are not read.
    pub read_as: String,
}

/// One file.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct FileRow {
    /// Path as given.
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// File type.
    #[serde(deserialize_with = "deserialize_word")]
    pub container: Word,
    /// Size in bytes.
    pub bytes: u64,
    /// Bytes fetched, if the file is an object in a store.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fetched_bytes: Option<u64>,
    /// Share of the file that is covered by a checksum: `all`, `partial` or `none`.
    #[serde(deserialize_with = "deserialize_word")]
    pub crc: Word,
}

impl FileRow {
    /// How much of an object was fetched; `None` for a local file.
    pub fn fetched(&self) -> Option<String> {
        let (fetched, size) = (self.fetched_bytes? as f64, self.bytes as f64);
        let (megabytes, percent) = (fetched / 1e6, 100.0 * fetched / size.max(1.0));
        Some(format!("{megabytes:.1} of {:.1} MB fetched ({percent:.1} %)", size / 1e6))
    }
}

/// Remark on a file that is not damage.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct NoteRow {
    /// The file or folder.
    #[schemars(with = "String")]
    pub path: PathBuf,
    /// Text of the remark.
    pub note: String,
}

impl Report {
    /// Report of the evaluated checks. Findings of severity `fail_on` or above fail the run; with `None`,
    /// none do.
    pub fn new(
        log: LogSummary,
        robots: Vec<RobotRow>,
        streams: Vec<StreamRow>,
        evaluation: Evaluation,
        fail_on: Option<Severity>,
    ) -> Self {
        let Evaluation { checks, findings, ignored, observability } = evaluation;
        let verdict = verdict(&checks, &findings, fail_on);
        let trouble = no_evaluation_trouble(&log, &checks);
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

    /// The same audit with further options.
    fn command_with(&self, options: &str) -> String {
        let call = self.command_line.clone().unwrap_or_else(|| {
            let logs = self.log.files.iter().map(|file| file.path.display().to_string());
            let logs: Vec<String> = logs.map(|log| quote_for_shell(&log)).collect();
            format!("poseaudit audit {}", logs.join(" "))
        });
        format!("{call} {options}")
    }

    /// Whether a correction of the finding's topic would be of several streams. Frames are corrected in poses, not in /tf
    /// as a whole.
    pub(crate) fn has_shared_topic(&self, finding: &Finding) -> bool {
        let Finding { cause, subject, .. } = finding;
        let is_of_poses = matches!(cause, Cause::ReferenceFrame(_) | Cause::ToolFrame(_));
        let is_corrected = |row: &&StreamRow| {
            let is_of_topic = subject.topic.as_ref() == Some(&row.topic);
            is_of_topic && !(is_of_poses && row.role == Role::Tf.name())
        };
        !cause.is_of_joints() && self.streams.iter().filter(is_corrected).count() > 1
    }

    /// `None` if no value corrects a finding, or if the audit applies corrections already.
    fn fix_command(&self) -> Option<String> {
        let is_given = self.command_line.as_ref().is_some_and(|it| it.contains(" --corrections"));
        let has_correction =
            |found: &Finding| found.cause.has_correction() && !self.has_shared_topic(found);
        (self.findings.iter().any(has_correction) && !is_given)
            .then(|| self.command_with("--fix corrections"))
    }

    /// If a finding suggests to estimate the links: the call, with the options of this audit. `None` if the audit has
    /// options that `calibrate` has not, or several files: `audit` merges them, but each log of `calibrate` is a run.
    fn calibrate_command(&self) -> Option<String> {
        const OF_AUDIT_ONLY: [&str; 3] = [" --corrections", " --require", " --mesh-root"];
        let call = self.command_with("--out calibrated");
        let options = call.strip_prefix("poseaudit audit ")?;
        let is_shared = !OF_AUDIT_ONLY.iter().any(|option| options.contains(option));
        let is_one = self.log.files.len() <= 1;
        (self.findings.iter().any(Finding::suggests_calibration) && is_shared && is_one)
            .then(|| format!("poseaudit calibrate {options}"))
    }

    /// Stores the command line.
    pub fn with_command_line(mut self, words: &[String]) -> Self {
        let words: Vec<String> = words.iter().map(|word| quote_for_shell(word)).collect();
        self.command_line = Some(words.join(" "));
        self
    }

    /// Report without any evaluation.
    pub fn from_log(log: LogSummary, robots: Vec<RobotRow>, streams: Vec<StreamRow>) -> Self {
        Self { log, robots, streams, ..Self::empty() }
    }

    /// Report with only an error.
    pub fn from_trouble(trouble: Trouble) -> Self {
        Self { error: Some(trouble), ..Self::empty() }
    }

    /// Adds an error that limited the audit: a pass becomes inconclusive.
    pub fn with_trouble(self, trouble: Trouble) -> Self {
        let verdict = match self.verdict {
            Verdict::Pass => Verdict::Inconclusive,
            verdict => verdict,
        };
        Self { verdict, error: Some(trouble), ..self }
    }

    /// Omits stamps and rates, because they are assumed.
    pub(crate) fn without_stamps(mut self) -> Self {
        (self.log.start_ns, self.log.end_ns, self.log.duration_s) = (None, None, None);
        for stream in &mut self.streams {
            (stream.rate_hz, stream.start_ns, stream.end_ns) = (None, None, None);
        }
        self
    }

    fn empty() -> Self {
        Self {
            schema: Schema::One,
            tool: Tool { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") },
            verdict: Verdict::Inconclusive,
            error: None,
            log: LogSummary::default(),
            robots: Vec::new(),
            comparisons: Vec::new(),
            streams: Vec::new(),
            checks: Vec::new(),
            findings: Vec::new(),
            ignored: Vec::new(),
            observability: Vec::new(),
            workspace: Vec::new(),
            plans: Vec::new(),
            fail_on: None,
            command_line: None,
            fails_if_inconclusive: false,
            required: Vec::new(),
            is_verbose: false,
            figures: None,
            thresholds: Thresholds::default(),
        }
    }

    /// `None` if the rule has no amount in `unit`.
    pub(crate) fn warning_threshold(&self, rule: &Rule, unit: Unit) -> Option<f64> {
        let threshold = rule.grade.thresholds().iter().find(|threshold| threshold.unit == unit)?;
        Some(self.thresholds.threshold(rule, *threshold).warning)
    }

    /// A finding of this severity fails the run.
    pub fn fails_on(&self, severity: Severity) -> bool {
        self.fail_on.is_some_and(|least| severity >= least)
    }

    /// Rules that make the verdict INCONCLUSIVE.
    pub fn undecided(&self) -> Vec<&'static str> {
        undecided(&self.checks).map(|rule| rule.code).collect()
    }

    /// The log's first file, else the unreadable one.
    fn main_file(&self) -> Option<&Path> {
        let first = self.log.files.first().map(|file| file.path.as_path());
        let of_log = self.error.as_ref().filter(|trouble| trouble.kind == TroubleKind::Log);
        first.or_else(|| of_log.map(|trouble| Path::new(&trouble.place)))
    }

    /// Required rules that decided nothing, or left a decidable subject inconclusive.
    pub fn undecided_requirements(&self) -> Vec<&'static str> {
        let rules = checks::registry().iter().map(|rule| rule.code);
        let required =
            rules.filter(|code| self.required.iter().any(|selector| selector.matches(code)));
        required
            .filter(|code| {
                let mut rows = self.checks.iter().filter(|row| row.code == *code);
                let open = |row: &CheckRow| {
                    row.status == Status::Inconclusive && !row.is_indistinguishable
                };
                rows.clone().any(open) || !rows.any(|row| row.status.is_decided())
            })
            .collect()
    }

    /// Whether a completed audit exits with 1.
    pub fn fails(&self) -> bool {
        match self.verdict {
            Verdict::Fail => true,
            Verdict::Inconclusive if self.fails_if_inconclusive => true,
            Verdict::Inconclusive | Verdict::Pass => !self.undecided_requirements().is_empty(),
        }
    }

    /// Whether rules other than those of the file itself fail a log without an arm.
    pub fn fails_without_arm(&self) -> bool {
        let mut findings = self.findings.iter().filter(|it| !it.code.starts_with("ING"));
        findings.any(|finding| self.fails_on(finding.severity))
    }

    /// Exit status with its reason, if the verdict does not imply it.
    pub fn exit_explanation(&self) -> Option<String> {
        let open = self.undecided_requirements();
        let has_fault = self.findings.iter().any(|finding| finding.severity > Severity::Info);
        Some(match self.verdict {
            Verdict::Fail => return None,
            _ if !open.is_empty() => {
                format!("exit status 1: --require {} is inconclusive", open.join(","))
            }
            Verdict::Inconclusive if self.fails_if_inconclusive => {
                "exit status 1: --fail-on inconclusive".to_owned()
            }
            Verdict::Inconclusive => {
                "exit status 0: an inconclusive run fails only with --fail-on inconclusive"
                    .to_owned()
            }
            Verdict::Pass if has_fault => {
                let least = self.fail_on.map_or("never", Severity::name);
                format!("exit status 0: --fail-on {least}")
            }
            Verdict::Pass => return None,
        })
    }
}

/// Error if rules about an arm were requested and none found its input.
fn no_evaluation_trouble(log: &LogSummary, checks: &[CheckRow]) -> Option<Trouble> {
    let needs_model = |row: &&CheckRow| checks::find(row.code).is_ok_and(|rule| rule.needs_model);
    let about_arm: Vec<&CheckRow> = checks.iter().filter(needs_model).collect();
    let is_evaluated = |row: &&CheckRow| row.status != Status::Skipped || row.is_exempt;
    if about_arm.iter().any(is_evaluated) || has_decided_hand_eye(checks) {
        return None;
    }
    let why = about_arm.first()?.reason.as_deref().unwrap_or_default();
    let file = log.files.first().map(|file| file.path.display().to_string());
    Some(Trouble::log(
        file.unwrap_or_else(|| "the log".to_owned()),
        format_args!("nothing can be audited: {why}"),
        "record the joint states with a pose, /tf or an IMU",
    ))
}

/// A hand-eye check does not require an arm.
pub(crate) fn has_decided_hand_eye(checks: &[CheckRow]) -> bool {
    checks.iter().any(|row| row.code.starts_with("HEC") && row.status.is_decided())
}

/// Fail if a finding reaches `fail_on`; else inconclusive if a headline rule is [`undecided`].
fn verdict(checks: &[CheckRow], findings: &[Finding], fail_on: Option<Severity>) -> Verdict {
    if fail_on.is_some_and(|least| findings.iter().any(|finding| finding.severity >= least)) {
        return Verdict::Fail;
    }
    let is_open = undecided(checks).next().is_some();
    if is_open { Verdict::Inconclusive } else { Verdict::Pass }
}

/// Headline rules with input that decided none of their subjects, or must decide every subject and did not, and rules with
/// contradictory inputs. Ignores subjects that no such log can decide, unless all are.
fn undecided(checks: &[CheckRow]) -> impl Iterator<Item = &'static Rule> {
    let is_contradicted = |row: &CheckRow| {
        row.status == Status::Inconclusive && row.evidence.contains_key(checks::CONTRADICTION)
    };
    checks::registry().iter().copied().filter(move |rule| {
        if checks.iter().any(|row| row.code == rule.code && is_contradicted(row)) {
            return true;
        }
        if !rule.headline {
            return false;
        }
        let rows = checks.iter().filter(|row| row.code == rule.code);
        let evaluated: Vec<&CheckRow> = rows.filter(|row| row.status != Status::Skipped).collect();
        if !evaluated.is_empty() && evaluated.iter().all(|row| row.is_indistinguishable) {
            return true;
        }
        let evaluated = evaluated.into_iter().filter(|row| !row.is_indistinguishable);
        let (derived, independent): (Vec<&CheckRow>, Vec<&CheckRow>) =
            evaluated.partition(|row| row.evidence.contains_key(checks::DERIVED));
        // A stream derived from the joint states is not independent evidence.
        let evaluated = if independent.is_empty() { derived } else { independent };
        let has_unknown_world = |row: &&CheckRow| row.evidence.contains_key(checks::UNKNOWN_WORLD);
        if evaluated.iter().any(has_unknown_world) {
            return true;
        }
        let decided: Vec<bool> = evaluated.iter().map(|row| row.status.is_decided()).collect();
        match rule.is_residual_check() {
            true => decided.contains(&false),
            false => !decided.is_empty() && !decided.contains(&true),
        }
    })
}

impl Verdict {
    /// In JSON and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Verdict::Pass => "pass",
            Verdict::Fail => "fail",
            Verdict::Inconclusive => "inconclusive",
        }
    }

    /// Verdict with this name.
    pub fn from_name(name: &str) -> Option<Self> {
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
    use crate::finding::{Evidence, Subject};
    use crate::geometry::Pose;
    use serde_json::{Map, json};

    fn row(code: &'static str, status: Status, indistinguishable: bool) -> CheckRow {
        CheckRow {
            code,
            name: "",
            subject: Subject::default(),
            status,
            reason: None,
            estimate: None,
            evidence: Map::new(),
            is_indistinguishable: indistinguishable,
            is_exempt: false,
        }
    }

    #[test]
    fn corrections_are_offered_only_if_a_finding_has_one() {
        let row = |role: &&str| -> StreamRow {
            let fields = json!({"topic": "/tf", "type": "", "role": role, "reason": "", "count": 1, "dropped": 0});
            serde_json::from_value(fields).expect("a row")
        };
        let is_offered = |cause: Cause, roles: &[&str]| {
            let finding = Finding {
                code: "FRM003",
                severity: Severity::Error,
                title: "",
                message: String::new(),
                subject: Subject { topic: Some("/tf".to_owned()), ..Subject::default() },
                cause,
                segment: None,
                estimate: None,
                evidence: Evidence::default(),
                fix: String::new(),
                start_ns: None,
                end_ns: None,
            };
            let streams = roles.iter().map(row).collect();
            Report { findings: vec![finding], streams, ..Report::empty() }.fix_command().is_some()
        };
        let frame = || Cause::ToolFrame(Pose::identity());
        assert!(is_offered(frame(), &["tf", "pose"]));
        assert!(!is_offered(frame(), &["tf", "pose", "pose"]));
        assert!(!is_offered(Cause::Other, &["pose"]));
        let camera = |in_hand| Cause::CameraMount {
            in_hand,
            parent: Some("tool0".to_owned()),
            pose: Pose::identity(),
        };
        assert!(is_offered(camera(Some(true)), &["target"]));
        assert!(!is_offered(camera(None), &["target"]));
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
        let known = CheckRow { is_exempt: true, ..row("LAT001", Status::Skipped, false) };
        assert_eq!(no_evaluation_trouble(&LogSummary::default(), &[known]), None);
        let skipped = vec![row("LAT001", Status::Skipped, false)];
        assert_eq!(verdict_of(skipped.clone()), Verdict::Pass);
        let evaluation = Evaluation { checks: skipped, ..Evaluation::default() };
        let report = Report::new(LogSummary::default(), vec![], vec![], evaluation, None);
        assert!(report.error.is_some() && report.verdict == Verdict::Inconclusive);
        assert_eq!(verdict_of(vec![row("FRM001", open, false)]), Verdict::Pass);
        assert_eq!(verdict_of(vec![row("ZER001", open, true)]), Verdict::Inconclusive);
        let others_decided = vec![row("ZER001", open, true), row("ZER001", decided, false)];
        assert_eq!(verdict_of(others_decided), Verdict::Pass);
        let contradicted = CheckRow {
            evidence: Map::from_iter([(checks::CONTRADICTION.to_owned(), true.into())]),
            ..row("YAW003", open, false)
        };
        assert_eq!(verdict_of(vec![contradicted]), Verdict::Inconclusive);
        assert_eq!(verdict_of(vec![row("YAW003", open, false)]), Verdict::Pass);
        let one_unproven = vec![row("MDL001", open, false), row("MDL001", decided, false)];
        assert_eq!(verdict_of(one_unproven), Verdict::Inconclusive);
    }

    #[test]
    fn a_required_rule_must_decide_and_leave_nothing_open() -> Result<(), checks::UnknownRule> {
        let required = vec!["LAT001".parse()?];
        let not_concluded = |checks| {
            let evaluation = Evaluation { checks, ..Evaluation::default() };
            let mut report = Report::new(LogSummary::default(), vec![], vec![], evaluation, None);
            report.required.clone_from(&required);
            report.undecided_requirements()
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
