//! Compares an audit with its case: the outcome of each planted fault, false findings, and coverage of
//! intervals.

use poseaudit::finding::{Cause, CheckRow, Estimate, Finding, Severity, Status, Subject};
use poseaudit::geometry::{Misinterpretation, misinterpretation_classes};
use poseaudit::report::{self, Report};
use poseaudit::synth::{self, SynthComplianceKind};

use crate::cases::Case;
use crate::fault_kinds::{FaultKind, MIN_MAGNITUDE_TO_FIND, PlantedFault, TrueValue, chain};

/// Rules whose value is a norm or an rms.
const RULES_WITH_NORMS: [&str; 6] = ["FRM", "HEC", "VEL", "YAW002", "YAW003", "YAW004"];
/// Families in which a finding without a planted fault is a false alarm.
pub const CORE_FAMILIES: [&str; 9] =
    ["ORD", "LAT", "ZER", "FRM", "YAW", "MDL", "HEC", "MOT", "VEL"];

/// Result of an audit.
pub type Outcome = Result<Grade, AuditFailure>;

/// Why there is no verdict.
#[derive(Debug)]
pub enum AuditFailure {
    Panic,
    /// With the program's message.
    Refused(String),
}

/// Outcome of a planted fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum FaultOutcome {
    /// Named with its subject.
    Named,
    /// Another cause is named, with this one as indistinguishable.
    NamedAsConfounder,
    /// Undetermined according to the rule.
    Inconclusive,
    /// The rule passed it.
    Passed,
    /// There is no row for it.
    Absent,
}

impl FaultOutcome {
    pub fn is_named(self) -> bool {
        matches!(self, FaultOutcome::Named | FaultOutcome::NamedAsConfounder)
    }
}

pub struct Grade {
    pub fault_outcomes: Vec<FaultOutcome>,
    /// Whether the report passes a log without mentioning a fault that must be found.
    pub is_wrong_pass: bool,
    /// Wrong outcomes: short kind, and full description.
    pub wrong_outcomes: Vec<(String, String)>,
    /// False findings of the core families, by code.
    pub false_findings: Vec<&'static str>,
    /// Findings of the other families, by code.
    pub other_false_findings: Vec<&'static str>,
    pub intervals: Vec<Interval>,
    /// Whether a change within the run is reported although nothing changes.
    pub has_false_change: bool,
    /// Whether the convention was right, for each planted ORD001 with at least three dwells.
    pub conventions_right: Vec<bool>,
}

pub struct Interval {
    /// Code of the rule, and the quantity if it has two.
    pub code: String,
    pub topic: String,
    /// The planted fault.
    pub planted: Option<FaultKind>,
    pub error: f64,
    pub truth: f64,
    pub is_covered: bool,
    /// Whether it is a norm or an rms.
    pub is_norm: bool,
}

pub fn grade(case: &Case, report: &Report) -> Grade {
    let mut verdict = Grade {
        fault_outcomes: Vec::new(),
        is_wrong_pass: false,
        wrong_outcomes: Vec::new(),
        false_findings: Vec::new(),
        other_false_findings: Vec::new(),
        intervals: Vec::new(),
        has_false_change: false,
        conventions_right: Vec::new(),
    };
    let does_change =
        |planted: &PlantedFault| planted.kind.starts_mid_run() || planted.kind.is_within_run();
    let is_counted = |finding: &&Finding| finding.severity >= Severity::Warning;
    let findings: Vec<&Finding> = report.findings.iter().filter(is_counted).collect();
    let is_changed = |finding: &&Finding| {
        let change = finding.estimate.as_ref().and_then(Estimate::change);
        change.is_some() || matches!(finding.cause, Cause::ParameterChange | Cause::VaryingLatency)
    };
    verdict.has_false_change =
        findings.iter().any(is_changed) && !case.planted.iter().any(does_change);
    for planted in &case.planted {
        let outcome = outcome_of_fault(planted, &findings, &report.checks);
        verdict.fault_outcomes.push(outcome);
        let described =
            || match report.checks.iter().find(|row| is_about(planted, row.code, &row.subject)) {
                Some(row) => {
                    format!("{planted}: {:?} {}", row.status, row.reason.as_deref().unwrap_or(""))
                }
                None => format!("{planted}: no row"),
            };
        match outcome {
            FaultOutcome::Named | FaultOutcome::NamedAsConfounder => {}
            FaultOutcome::Passed | FaultOutcome::Absent
                if planted.magnitude >= MIN_MAGNITUDE_TO_FIND =>
            {
                verdict.add_wrong_outcome(
                    format!("missed {} {:?}", planted.codes[0], planted.kind),
                    described(),
                );
            }
            FaultOutcome::Inconclusive if case.must_find(planted) => {
                verdict.add_wrong_outcome(
                    format!("undecided {} {:?}", planted.codes[0], planted.kind),
                    described(),
                );
            }
            _ => {}
        }
        let finding =
            findings.iter().find(|finding| is_about(planted, finding.code, &finding.subject));
        let Some(estimate) = finding.and_then(|finding| finding.estimate.as_ref()) else {
            continue;
        };
        if let (TrueValue::Amount(truth), Some(value)) = (planted.truth, estimate.value()) {
            let value = if ignores_sign(Some(planted.kind)) { value.abs() } else { value };
            let threshold = truth.abs() / planted.magnitude;
            if (value - truth).abs() > (0.5 * threshold).max(0.05 * truth.abs()) {
                let what = format!("{planted}: found {value:.6}");
                verdict.add_wrong_outcome(
                    format!("wrong amount {} {:?}", planted.codes[0], planted.kind),
                    what,
                );
            }
            if planted.magnitude < 0.5 {
                let what = format!("{planted}: found {value:.6}");
                verdict.add_wrong_outcome(
                    format!("overcalled {} {:?}", planted.codes[0], planted.kind),
                    what,
                );
            }
        }
        if let (TrueValue::Frame { length_m, .. }, Some(value)) = (planted.truth, estimate.value())
            && (value - length_m).abs() > (0.5e-3_f64).max(0.05 * length_m)
        {
            let what = format!("{planted}: found {:.3} mm", value * 1e3);
            verdict.add_wrong_outcome(
                format!("wrong amount {} {:?}", planted.codes[0], planted.kind),
                what,
            );
        }
        if let TrueValue::Convention(truth) = planted.truth {
            let right = is_true_misinterpretation(&truth, estimate);
            if !right {
                let what = format!("{planted}: found {:?}", estimate.convention());
                verdict.add_wrong_outcome(format!("wrong convention {:?}", planted.kind), what);
            }
        }
    }
    for planted in &case.planted {
        if let TrueValue::Convention(truth) = planted.truth
            && case.is_excited
            && case.motion != "continuous"
        {
            let finding =
                findings.iter().find(|finding| is_about(planted, finding.code, &finding.subject));
            let estimate = finding.and_then(|finding| finding.estimate.as_ref());
            verdict
                .conventions_right
                .push(estimate.is_some_and(|estimate| is_true_misinterpretation(&truth, estimate)));
        }
    }
    // A hand that rotates too little cannot be calibrated.
    let is_too_little_rotation = |code: &str| code == "HEC002" && !case.is_excited;
    let allowed = |code: &str| {
        case.scene.allows(code)
            || case.background.allows(code, &case.scenario, case.is_excited)
            || is_too_little_rotation(code)
    };
    for finding in &findings {
        let is_expected = |planted: &PlantedFault| {
            is_about(planted, finding.code, &finding.subject)
                || lists_as_confounder(planted, finding)
                || planted.related_codes.iter().any(|code| finding.code.starts_with(code))
        };
        if case.planted.iter().any(is_expected) || allowed(finding.code) {
            continue;
        }
        if CORE_FAMILIES.iter().any(|family| finding.code.starts_with(family)) {
            verdict.false_findings.push(finding.code);
            let kind = if case.planted.is_empty() { "false alarm" } else { "misattributed" };
            let codes: Vec<String> = case.planted.iter().map(|p| format!("{:?}", p.kind)).collect();
            verdict.add_wrong_outcome(
                format!("{kind} {}", finding.code),
                format!("{} on {} [{}]", finding.message, finding.subject.label(), codes.join("+")),
            );
        } else {
            verdict.other_false_findings.push(finding.code);
            verdict.add_wrong_outcome(
                format!("other {}", finding.code),
                format!("{} on {}", finding.message, finding.subject.label()),
            );
        }
    }
    let is_mentioned = |planted: &PlantedFault| {
        let reported = report.findings.iter().map(|finding| (finding.code, &finding.subject));
        let ignored = report.ignored.iter().map(|one| (one.finding.code, &one.finding.subject));
        reported.chain(ignored).any(|(code, subject)| {
            is_about(planted, code, subject)
                || planted.related_codes.iter().any(|also| code.starts_with(also))
        })
    };
    let unmentioned = case.planted.iter().find(|one| case.must_find(one) && !is_mentioned(one));
    if let (report::Verdict::Pass, Some(planted)) = (report.verdict, unmentioned) {
        verdict.is_wrong_pass = true;
        let kind = format!("WRONG PASS {} {:?}", planted.codes[0], planted.kind);
        verdict.add_wrong_outcome(kind, format!("{planted} in {}", case.scene.name()));
    }
    for row in &report.checks {
        verdict.intervals.extend(check_intervals(case, row));
    }
    verdict
}

impl Grade {
    fn add_wrong_outcome(&mut self, kind: String, what: String) {
        self.wrong_outcomes.push((kind, what));
    }
}

pub fn is_about(planted: &PlantedFault, code: &str, subject: &Subject) -> bool {
    let is_expected = match &planted.subject {
        Some(name) => subject_name(subject) == Some(name),
        None => true,
    };
    planted.codes.contains(&code) && is_expected
}

pub fn subject_name(subject: &Subject) -> Option<&str> {
    subject.joint.as_deref().or(subject.topic.as_deref())
}

/// Whether the finding lists the planted fault as indistinguishable.
pub fn lists_as_confounder(planted: &PlantedFault, finding: &Finding) -> bool {
    let mut twins = finding.evidence.indistinguishable.iter();
    twins.any(|twin| is_about(planted, twin.code, &twin.subject))
}

pub fn outcome_of_fault(
    planted: &PlantedFault,
    findings: &[&Finding],
    rows: &[CheckRow],
) -> FaultOutcome {
    if findings.iter().any(|finding| is_about(planted, finding.code, &finding.subject)) {
        return FaultOutcome::Named;
    }
    if findings.iter().any(|finding| lists_as_confounder(planted, finding)) {
        return FaultOutcome::NamedAsConfounder;
    }
    match rows.iter().find(|row| is_about(planted, row.code, &row.subject)).map(|row| row.status) {
        Some(Status::Inconclusive | Status::Skipped) => FaultOutcome::Inconclusive,
        Some(_) => FaultOutcome::Passed,
        None => FaultOutcome::Absent,
    }
}

pub fn is_true_misinterpretation(truth: &Misinterpretation, estimate: &Estimate) -> bool {
    let Some((is, read_as)) = estimate.convention() else { return false };
    let class = misinterpretation_classes().iter().find(|class| class.members.contains(truth));
    class.is_some_and(|class| {
        class
            .members
            .iter()
            .any(|one| one.is.to_string() == is && one.read_as.to_string() == read_as)
    })
}

/// Name of FRM003's value for a tool.
const TOOL_ESTIMATE: &str = "tool frame";

/// Whether the sign of the value is ignored: a ramp is measured from minimum to maximum, or as an increase.
fn ignores_sign(kind: Option<FaultKind>) -> bool {
    matches!(
        kind,
        Some(FaultKind::LatencyRamp | FaultKind::VelocityScale | FaultKind::Sag | FaultKind::Play)
    )
}

/// True value of a row's quantity that comes from the background rather than a fault.
fn true_value_without_fault(case: &Case, row: &CheckRow, is_jump: bool) -> f64 {
    let imu = &case.scenario.imu;
    match row.code {
        "YAW001" if !is_jump => imu.yaw_drift_rad_s,
        "YAW004" => imu.gyro_bias_rad_s.norm(),
        _ => true_compliance_rad(case, row).unwrap_or(0.0),
    }
}

/// Compliance of a row's joint, rad.
fn true_compliance_rad(case: &Case, row: &CheckRow) -> Option<f64> {
    let is_expected = |how: &SynthComplianceKind| {
        matches!(
            (row.code, how),
            ("MOT006", SynthComplianceKind::Backlash) | ("ZER003", SynthComplianceKind::Sag)
        )
    };
    let joint = row.subject.joint.as_deref()?;
    let chain = chain(&case.scenario);
    let at = chain.joint_names().iter().position(|name| name == joint)?;
    let mut gives = case.scenario.compliance.iter();
    gives
        .find(|gives| gives.joint == at && is_expected(&gives.kind))
        .map(|gives| gives.amplitude_rad)
}

/// Error and coverage of a row's interval, if both interval and truth are known.
pub fn check_intervals(case: &Case, row: &CheckRow) -> Vec<Interval> {
    let estimate = match &row.estimate {
        Some(estimate) if !row.is_indistinguishable => estimate,
        _ => return Vec::new(),
    };
    // Motion and residuals are not planted.
    let is_of_motion = row.code.starts_with("MOT") && row.code != "MOT006";
    if is_of_motion
        || row.code.starts_with("MDL")
        || !CORE_FAMILIES.iter().any(|family| row.code.starts_with(family))
    {
        return Vec::new();
    }
    // Link deviations then also move the ends of the chain and the mount.
    let of_ends = matches!(row.code, "FRM002" | "FRM003" | "YAW003");
    if case.background.moves_frames() && of_ends {
        return Vec::new();
    }
    let planted = case.planted.iter().find(|planted| is_about(planted, row.code, &row.subject));
    if planted.is_some_and(|planted| {
        planted.magnitude < MIN_MAGNITUDE_TO_FIND || matches!(planted.truth, TrueValue::NoValue)
    }) {
        return Vec::new();
    }
    // The delay of an arm behind its leader is not planted. A fault reported for all joints has no values
    // for each joint.
    let is_for_all_joints =
        |one: &PlantedFault| matches!(one.kind, FaultKind::VelocityScale | FaultKind::VelocityLate);
    let is_reported_for_all = row.code == "VEL001" && case.planted.iter().any(is_for_all_joints);
    if planted.is_none() && (row.code == "LAT004" || is_reported_for_all) {
        return Vec::new();
    }
    // With a skew, the latency at mid-run is known only to milliseconds; with a change, it depends on the
    // part of the run.
    let timing = &case.scenario.pose.timing;
    let has_varying_latency = timing.skew != 0.0 || timing.latency_ramp.is_some();
    if row.code == "LAT001"
        && has_varying_latency
        && row.subject.topic.as_deref() == Some(synth::POSE)
    {
        return Vec::new();
    }
    let joints_late = case.scenario.joints.timing.latency_s;
    let of_joints = (row.code == "LAT001" && joints_late != 0.0).then_some(FaultKind::JointsLate);
    let kind = planted.map(|planted| planted.kind).or(of_joints);
    let make = |code: String, value: f64, ci95: Option<[f64; 2]>, truth: f64| {
        let [low, high] = ci95?;
        let is_covered = (low..=high).contains(&truth);
        let mut topic = row.subject.topic.clone().unwrap_or("joints".to_owned());
        if topic == synth::TF && case.scenario.tf.timing.phase_s == 0.0 {
            topic += " with the joints' stamps";
        }
        let is_norm = RULES_WITH_NORMS.iter().any(|norm| code.starts_with(norm));
        Some(Interval {
            code,
            topic,
            planted: kind,
            error: value - truth,
            truth,
            is_covered,
            is_norm,
        })
    };
    match *estimate {
        Estimate::Scalar { name, value, ci95, .. } => {
            // A yaw jump and a yaw drift have one row each.
            let is_jump = name == "yaw jump";
            let planted = planted.filter(|one| (one.kind == FaultKind::YawJump) == is_jump);
            let mut truth = match planted.map(|planted| planted.truth) {
                Some(TrueValue::Amount(truth)) => truth,
                _ => true_value_without_fault(case, row, is_jump),
            };
            let value = if ignores_sign(kind) { value.abs() } else { value };
            let ci95 = ci95.map(|[low, high]| match ignores_sign(kind) && high < 0.0 {
                true => [-high, -low],
                false => [low, high],
            });
            if row.code == "LAT001" && row.subject.topic.as_deref() != Some(synth::JOINT_STATES) {
                truth -= joints_late;
            }
            let code = if is_jump { format!("{} jump", row.code) } else { row.code.to_owned() };
            make(code, value, ci95, truth).into_iter().collect()
        }
        Estimate::Frame { name, value, ci95, rotation, .. } => {
            // The main body has its own row.
            let planted =
                planted.filter(|one| one.kind != FaultKind::Alternates || name != TOOL_ESTIMATE);
            let (length_m, angle_rad) = match planted.map(|planted| planted.truth) {
                Some(TrueValue::Frame { length_m, angle_rad }) => (length_m, angle_rad),
                _ => (0.0, 0.0),
            };
            let length = make(format!("{} m", row.code), value, ci95, length_m);
            let angle = make(format!("{} rad", row.code), rotation.value, rotation.ci95, angle_rad);
            length.into_iter().chain(angle).collect()
        }
        _ => Vec::new(),
    }
}
