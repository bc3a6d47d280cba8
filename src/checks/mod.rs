//! The rules, one file each, and their registry.
//!
//! A rule turns estimates from `diagnosis` into verdicts and messages. Everything that lists or explains
//! rules reads the [`registry`].

mod calibration;
mod changes;
mod confounders;
mod decision;
mod encoding;
mod frames;
mod held_out;
mod joint_groups;
mod merge;
mod observability;
mod residual_attribution;
mod resolving_motion;
mod scalar_rule;
mod settings;
mod supporting;
#[cfg(test)]
mod testing;
mod thresholds;
mod withdraw;

use std::fmt;
use std::sync::LazyLock;

use serde_json::{Map, Value};

use crate::evidence::{RunEvidence, StreamEvidence};
use crate::finding::{
    Cause, CheckRow, Estimate, Finding, IgnoredFinding, Outcome, Ruling, Severity, Span, Status,
    Subject,
};

pub use calibration::UnmovedJoint;
pub(crate) use calibration::{
    MAX_DEVIATION_M, equals_nominal, implausible_links, is_point_moved, max_row_error_m,
    rejection_reason, stream_rejection_reason, suggests_calibration, unmoved_joints,
};
pub use decision::{Decision, FrameThresholds, Threshold, decide, decide_both, decide_frame};
pub(crate) use encoding::encoding_names;
pub(crate) use held_out::HELD_OUT;
pub(crate) use imu::yaw001_yaw_drift::YAW001;
pub(crate) use joints::zer001_joint_zero::ZER001;
pub(crate) use latency::lat001_latency::LAT001;
pub use merge::{SegmentEvaluation, merge_segments};
pub(crate) use observability::unobservable_zero;
pub use observability::{DirectionComponent, StreamObservability, UnobservableDirection};
pub(crate) use poses::mdl001_unexplained_residual::MDL001;
pub(crate) use resolving_motion::{is_blocked_by_residual, motion_description, resolving_motion};
pub use settings::{Exemption, Selector, Settings, UnknownRule};
pub(crate) use supporting::supports;
pub use thresholds::{Limit, Thresholds};

/// Declares a rule. Its doc comment is printed by `explain`.
macro_rules! rule {
    ($(#[doc = $line:literal])* $code:ident {
        limits: $limits:expr, $($field:ident: $value:expr),* $(,)?
    }) => {
        $(#[doc = $line])*
        pub(crate) static $code: $crate::checks::Rule = $crate::checks::Rule {
            code: stringify!($code),
            doc: concat!($($line, "\n"),*),
            limits: $limits,
            $($field: $value),*
        };
    };
    ($(#[doc = $line:literal])* $code:ident { $($field:ident: $value:expr),* $(,)? }) => {
        rule! { $(#[doc = $line])* $code { limits: &[], $($field: $value),* } }
    };
}

mod commands;
mod hand_eye;
mod imu;
mod joints;
mod latency;
mod motion;
mod poses;
mod samples;
mod stamps;
mod topics;

/// Rules on the same kind of stream.
#[derive(Debug)]
pub struct Family {
    /// The kind of stream.
    pub examines: &'static str,
    /// Its rules.
    pub rules: &'static [&'static Rule],
}

/// Every family.
pub static FAMILIES: &[&Family] = &[
    &topics::FAMILY,
    &stamps::FAMILY,
    &samples::FAMILY,
    &latency::FAMILY,
    &poses::FAMILY,
    &joints::FAMILY,
    &motion::FAMILY,
    &imu::FAMILY,
    &hand_eye::FAMILY,
    &commands::FAMILY,
];

/// Evidence key of a row whose stream is computed from joint states.
pub(crate) const DERIVED: &str = "derived";

/// Evidence key of an inconclusive row whose unknown world frame may absorb the fault.
pub(crate) const UNKNOWN_WORLD: &str = "unknown_world";

/// Evidence key of an inconclusive row whose inputs contradict each other. The run does not pass.
pub(crate) const CONTRADICTION: &str = "contradiction";

/// Ordered by code; they are evaluated in this order.
static REGISTRY: LazyLock<Vec<&Rule>> = LazyLock::new(|| {
    let mut rules: Vec<&Rule> = FAMILIES.iter().flat_map(|family| family.rules).copied().collect();
    rules.sort_by_key(|rule| rule.code);
    rules
});

/// All rules, in the order of their codes.
pub fn registry() -> &'static [&'static Rule] {
    &REGISTRY
}

/// Returns the rule with this code, ignoring case.
///
/// # Errors
/// If the code is unknown; lists the most similar codes.
pub fn find(code: &str) -> Result<&'static Rule, UnknownRule> {
    let wanted = code.trim().to_ascii_uppercase();
    let found = REGISTRY.binary_search_by(|rule| rule.code.cmp(&wanted));
    found.map(|place| REGISTRY[place]).map_err(|_| UnknownRule::new(code))
}

/// A rule: code, name, thresholds and check.
#[derive(Debug)]
pub struct Rule {
    /// Never reused for another rule.
    pub code: &'static str,
    /// In kebab-case.
    pub name: &'static str,
    /// Severity of its findings.
    pub grade: Grade,
    /// Further limits.
    pub limits: &'static [Limit],
    /// Whether the rule must decide on a subject for a run to pass. The [residual
    /// check](Rule::is_residual_check) must decide on all of them.
    pub headline: bool,
    /// Whether it needs a robot model.
    pub needs_model: bool,
    /// Reason for skipping if there is no subject.
    missing: &'static str,
    check: fn(&Case) -> Vec<SubjectResult>,
    /// Each line keeps the space after `///`.
    doc: &'static str,
}

impl Rule {
    /// The rule's text in Markdown.
    pub fn doc(&self) -> String {
        let lines = self.doc.lines().map(|line| line.strip_prefix(' ').unwrap_or(line));
        lines.collect::<Vec<_>>().join("\n")
    }

    /// Name in running text, such as `joint zero`.
    pub fn plain_name(&self) -> String {
        let word = |word| match word {
            "imu" => "IMU",
            "dh" => "DH",
            "tf" => "/tf",
            word => word,
        };
        self.name.split('-').map(word).collect::<Vec<_>>().join(" ")
    }

    /// Letters of the code.
    pub fn family(&self) -> &'static str {
        self.code.trim_end_matches(|c: char| c.is_ascii_digit())
    }

    /// Whether all of the rule's subjects must be decided for a run to pass.
    pub fn is_residual_check(&self) -> bool {
        self.code == MDL001.code
    }

    /// Title line without the period.
    pub fn summary(&self) -> &'static str {
        self.doc.lines().next().unwrap_or_default().trim().trim_end_matches('.')
    }
}

/// How a rule grades findings.
#[derive(Clone, Copy, Debug)]
pub enum Grade {
    /// The most severe grade, without thresholds.
    Fixed(Severity),
    /// Reaching any threshold is enough.
    From(&'static [Threshold]),
}

impl Grade {
    /// Empty for [`Grade::Fixed`].
    pub fn thresholds(&self) -> &'static [Threshold] {
        match self {
            Grade::Fixed(_) => &[],
            Grade::From(thresholds) => thresholds,
        }
    }

    /// The most severe grade.
    pub fn max_severity(&self) -> Severity {
        match self {
            Grade::Fixed(severity) => *severity,
            Grade::From(_) => Severity::Error,
        }
    }
}

impl fmt::Display for Grade {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Grade::Fixed(severity) => f.write_str(severity.name()),
            Grade::From(thresholds) => {
                let join = |amount: fn(&Threshold) -> f64| {
                    let shown =
                        thresholds.iter().map(|threshold| threshold.unit.show(amount(threshold)));
                    shown.collect::<Vec<_>>().join(" or ")
                };
                let (warning, error) =
                    (join(|threshold| threshold.warning), join(|threshold| threshold.error));
                write!(f, "warning {warning}, error {error}")
            }
        }
    }
}

/// Result of a rule on one subject.
#[derive(Clone, Debug)]
pub struct SubjectResult {
    subject: Subject,
    span: Option<Span>,
    estimate: Option<Estimate>,
    evidence: Map<String, Value>,
    outcome: Outcome,
}

impl<T> StreamEvidence<T> {
    fn judged(&self, outcome: Outcome) -> SubjectResult {
        SubjectResult::new(self.subject.clone(), outcome).within(self.span)
    }
}

impl SubjectResult {
    fn new(subject: Subject, outcome: Outcome) -> Self {
        Self { subject, span: None, estimate: None, evidence: Map::new(), outcome }
    }

    fn within(self, span: impl Into<Option<Span>>) -> Self {
        Self { span: span.into(), ..self }
    }

    fn estimated(self, estimate: impl Into<Option<Estimate>>) -> Self {
        Self { estimate: estimate.into(), ..self }
    }

    /// Sets the cause if it is a fault.
    fn caused_by(&mut self, cause: Cause) {
        if let Outcome::Evaluated(Ruling::Fail(fault)) = &mut self.outcome {
            fault.cause = cause;
        }
    }

    /// A stream computed from joint states is evidence for no other stream.
    fn derived_if(self, is_derived: bool) -> Self {
        if is_derived { self.with_evidence(DERIVED, true) } else { self }
    }

    fn with_evidence(mut self, key: &str, value: impl Into<Value>) -> Self {
        self.evidence.insert(key.to_owned(), value.into());
        self
    }
}

/// Result of all rules on a run.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    /// One per selected rule and subject.
    pub checks: Vec<CheckRow>,
    /// Sorted by severity, then by effect at the tip.
    pub findings: Vec<Finding>,
    /// Exempted in the config.
    pub ignored: Vec<IgnoredFinding>,
    /// Per pose stream.
    pub observability: Vec<StreamObservability>,
}

/// Input of the rules.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// Evidence on the run.
    pub evidence: &'a RunEvidence,
    /// Overrides of the rules' thresholds.
    pub thresholds: &'a Thresholds,
    /// Rules that must be conclusive.
    pub required: &'a [Selector],
}

impl Case<'_> {
    fn requires(&self, rule: &Rule) -> bool {
        self.required.iter().any(|selector| selector.matches(rule.code))
    }
}

/// Evaluates every selected rule on each of its subjects.
pub fn evaluate(evidence: &RunEvidence, settings: &Settings) -> Evaluation {
    let case = &Case { evidence, thresholds: &settings.thresholds, required: &settings.required };
    let mut evaluation = Evaluation::default();
    for rule in REGISTRY.iter().filter(|rule| settings.selects(rule)) {
        let mut judged = (rule.check)(case);
        if joints::FAMILY.rules.iter().any(|of_joints| std::ptr::eq(*of_joints, *rule)) {
            judged.retain(|judged| judged.subject.reference.is_none());
        }
        if judged.is_empty() {
            let why = match &case.evidence.no_robot {
                Some(why) if rule.needs_model => why.clone(),
                _ => rule.missing.to_owned(),
            };
            judged.push(SubjectResult::new(Subject::default(), Outcome::Skipped(why)));
        }
        for judged in judged {
            let judged = held_out::with_held_out(case, rule, judged);
            let judged = changes::limit_to_segment(case, judged);
            evaluation.enter(rule, judged, settings);
        }
    }
    withdraw::withdraw_findings_within_residual(case, &mut evaluation);
    withdraw::withdraw_findings_on_disagreement(case, &mut evaluation);
    evaluation.observability = observability::observability(case, &mut evaluation.checks);
    rank(&mut evaluation.findings);
    evaluation
}

/// Sorts a wrong model first, because other findings may follow from it; then by severity and effect.
fn rank(findings: &mut [Finding]) {
    findings.sort_by(|a, b| {
        let effect = |finding: &Finding| finding.evidence.effect_m.unwrap_or(0.0);
        let is_model = |finding: &Finding| {
            finding.severity > Severity::Info
                && matches!(finding.cause, Cause::OtherRobot(_) | Cause::DhConvention(_))
        };
        let by_model = is_model(b).cmp(&is_model(a));
        by_model.then(b.severity.cmp(&a.severity)).then(effect(b).total_cmp(&effect(a)))
    });
}

impl Evaluation {
    fn enter(&mut self, rule: &Rule, judged: SubjectResult, settings: &Settings) {
        let SubjectResult { subject, span, estimate, evidence, outcome } = judged;
        let mut row = CheckRow {
            code: rule.code,
            name: rule.name,
            subject,
            status: Status::Pass,
            reason: None,
            estimate,
            evidence,
            is_indistinguishable: false,
            is_exempt: false,
        };
        let mut found = None;
        match outcome {
            Outcome::Evaluated(Ruling::Pass(remark)) => row.reason = remark,
            Outcome::Evaluated(Ruling::Fail(fault)) => {
                row.status = Status::Fail;
                let mut evidence = fault.evidence;
                evidence.more.append(&mut row.evidence);
                found = Some(Finding {
                    code: rule.code,
                    severity: settings.severity(rule, fault.severity),
                    title: fault.title,
                    message: fault.message,
                    subject: row.subject.clone(),
                    cause: fault.cause,
                    segment: None,
                    estimate: row.estimate.clone(),
                    evidence,
                    fix: fault.fix,
                    start_ns: span.map(|span| span.start),
                    end_ns: span.map(|span| span.end),
                });
            }
            Outcome::Inconclusive(why) => {
                (row.status, row.reason) = (Status::Inconclusive, Some(why));
            }
            Outcome::Indistinguishable(why) => {
                (row.status, row.reason) = (Status::Inconclusive, Some(why));
                row.is_indistinguishable = true;
            }
            Outcome::Skipped(why) => (row.status, row.reason) = (Status::Skipped, Some(why)),
        }
        match settings.exemption(&row) {
            Some(exemption) if !matches!(row.status, Status::Pass | Status::Skipped) => {
                (row.status, row.is_indistinguishable) = (Status::Skipped, false);
                row.is_exempt = true;
                row.reason = Some(exemption.reason_text());
                self.ignored.extend(found.map(|finding| exemption.ignored(finding)));
            }
            _ => self.findings.extend(found),
        }
        self.checks.push(row);
    }
}

#[cfg(test)]
mod tests;
