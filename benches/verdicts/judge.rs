//! Compares an audit with its case: the outcome of each planted fault, false findings, and coverage of
//! intervals.

use poseaudit::finding::{Cause, CheckRow, Estimate, Finding, Severity, Status, Subject};
use poseaudit::geometry::{Misinterpretation, misinterpretation_classes};
use poseaudit::report::{self, Report};
use poseaudit::synth::{self, Giving};

use crate::cases::Case;
use crate::kinds::{Kind, Planted, SURE, Truth, chain};

/// Rules whose value is a norm or an rms.
const NORMS: [&str; 6] = ["FRM", "HEC", "VEL", "YAW002", "YAW003", "YAW004"];
/// Families in which a finding without a planted fault is a false alarm.
pub const CORE: [&str; 9] = ["ORD", "LAT", "ZER", "FRM", "YAW", "MDL", "HEC", "MOT", "VEL"];

/// Result of an audit.
pub type Outcome = Result<Verdict, Trouble>;

/// Why there is no verdict.
#[derive(Debug)]
pub enum Trouble {
    Panic,
    /// With the program's message.
    Refused(String),
}

/// Outcome of a planted fault.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fate {
    /// Named with its subject.
    Named,
    /// Another cause is named, with this one as indistinguishable.
    NamedAsTwin,
    /// Undetermined according to the rule.
    Undecided,
    /// The rule passed it.
    Passed,
    /// There is no row for it.
    Absent,
}

impl Fate {
    pub fn is_named(self) -> bool {
        matches!(self, Fate::Named | Fate::NamedAsTwin)
    }
}

pub struct Verdict {
    pub fates: Vec<Fate>,
    /// Whether the report passes a log without mentioning a fault that must be found.
    pub is_wrong_pass: bool,
    /// Wrong outcomes: short kind, and full description.
    pub wrongs: Vec<(String, String)>,
    /// False findings of the core families, by code.
    pub strangers: Vec<&'static str>,
    /// Findings of the other families, by code.
    pub other: Vec<&'static str>,
    pub intervals: Vec<Interval>,
    /// Whether a change within the run is reported although nothing changes.
    pub is_falsely_changed: bool,
    /// Whether the convention was right, for each planted ORD001 with at least three dwells.
    pub convention: Vec<bool>,
}

pub struct Interval {
    /// Code of the rule, and the quantity if it has two.
    pub code: String,
    pub topic: String,
    /// The planted fault.
    pub planted: Option<Kind>,
    pub error: f64,
    pub truth: f64,
    pub covers: bool,
    /// Whether it is a norm or an rms.
    pub is_norm: bool,
}

pub fn judge(case: &Case, report: &Report) -> Verdict {
    let mut verdict = Verdict {
        fates: Vec::new(),
        is_wrong_pass: false,
        wrongs: Vec::new(),
        strangers: Vec::new(),
        other: Vec::new(),
        intervals: Vec::new(),
        is_falsely_changed: false,
        convention: Vec::new(),
    };
    let does_change = |planted: &Planted| planted.kind.comes_later() || planted.kind.is_late();
    let grave = |finding: &&Finding| finding.severity >= Severity::Warning;
    let findings: Vec<&Finding> = report.findings.iter().filter(grave).collect();
    let is_changed = |finding: &&Finding| {
        let when = finding.estimate.as_ref().and_then(Estimate::change);
        when.is_some() || matches!(finding.cause, Cause::ParameterChange | Cause::VaryingLatency)
    };
    verdict.is_falsely_changed =
        findings.iter().any(is_changed) && !case.planted.iter().any(does_change);
    for planted in &case.planted {
        let fate = fate(planted, &findings, &report.checks);
        verdict.fates.push(fate);
        let described =
            || match report.checks.iter().find(|row| is_about(planted, row.code, &row.subject)) {
                Some(row) => {
                    format!("{planted}: {:?} {}", row.status, row.reason.as_deref().unwrap_or(""))
                }
                None => format!("{planted}: no row"),
            };
        match fate {
            Fate::Named | Fate::NamedAsTwin => {}
            Fate::Passed | Fate::Absent if planted.times >= SURE => {
                verdict
                    .wrong(format!("missed {} {:?}", planted.codes[0], planted.kind), described());
            }
            Fate::Undecided if case.must_find(planted) => {
                verdict.wrong(
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
        if let (Truth::Amount(truth), Some(value)) = (planted.truth, estimate.value()) {
            let value = if unsigned(Some(planted.kind)) { value.abs() } else { value };
            let threshold = truth.abs() / planted.times;
            if (value - truth).abs() > (0.5 * threshold).max(0.05 * truth.abs()) {
                let what = format!("{planted}: found {value:.6}");
                verdict
                    .wrong(format!("wrong amount {} {:?}", planted.codes[0], planted.kind), what);
            }
            if planted.times < 0.5 {
                let what = format!("{planted}: found {value:.6}");
                verdict.wrong(format!("overcalled {} {:?}", planted.codes[0], planted.kind), what);
            }
        }
        if let (Truth::Frame { length_m, .. }, Some(value)) = (planted.truth, estimate.value())
            && (value - length_m).abs() > (0.5e-3_f64).max(0.05 * length_m)
        {
            let what = format!("{planted}: found {:.3} mm", value * 1e3);
            verdict.wrong(format!("wrong amount {} {:?}", planted.codes[0], planted.kind), what);
        }
        if let Truth::Convention(truth) = planted.truth {
            let right = is_named(&truth, estimate);
            if !right {
                let what = format!("{planted}: found {:?}", estimate.convention());
                verdict.wrong(format!("wrong convention {:?}", planted.kind), what);
            }
        }
    }
    for planted in &case.planted {
        if let Truth::Convention(truth) = planted.truth
            && case.excited
            && case.motion != "continuous"
        {
            let finding =
                findings.iter().find(|finding| is_about(planted, finding.code, &finding.subject));
            let estimate = finding.and_then(|finding| finding.estimate.as_ref());
            verdict.convention.push(estimate.is_some_and(|estimate| is_named(&truth, estimate)));
        }
    }
    // A hand that rotates too little cannot be calibrated.
    let is_still = |code: &str| code == "HEC002" && !case.excited;
    let allowed = |code: &str| {
        case.scene.allows(code)
            || case.background.allows(code, &case.scenario, case.excited)
            || is_still(code)
    };
    for finding in &findings {
        let is_its = |planted: &Planted| {
            is_about(planted, finding.code, &finding.subject)
                || is_twin(planted, finding)
                || planted.also.iter().any(|code| finding.code.starts_with(code))
        };
        if case.planted.iter().any(is_its) || allowed(finding.code) {
            continue;
        }
        if CORE.iter().any(|family| finding.code.starts_with(family)) {
            verdict.strangers.push(finding.code);
            let kind = if case.planted.is_empty() { "false alarm" } else { "misattributed" };
            let codes: Vec<String> = case.planted.iter().map(|p| format!("{:?}", p.kind)).collect();
            verdict.wrong(
                format!("{kind} {}", finding.code),
                format!("{} on {} [{}]", finding.message, finding.subject.label(), codes.join("+")),
            );
        } else {
            verdict.other.push(finding.code);
            verdict.wrong(
                format!("other {}", finding.code),
                format!("{} on {}", finding.message, finding.subject.label()),
            );
        }
    }
    let is_mentioned = |planted: &Planted| {
        let said = report.findings.iter().map(|finding| (finding.code, &finding.subject));
        let ignored = report.ignored.iter().map(|one| (one.finding.code, &one.finding.subject));
        said.chain(ignored).any(|(code, subject)| {
            is_about(planted, code, subject)
                || planted.also.iter().any(|also| code.starts_with(also))
        })
    };
    let unsaid = case.planted.iter().find(|one| case.must_find(one) && !is_mentioned(one));
    if let (report::Verdict::Pass, Some(planted)) = (report.verdict, unsaid) {
        verdict.is_wrong_pass = true;
        let kind = format!("WRONG PASS {} {:?}", planted.codes[0], planted.kind);
        verdict.wrong(kind, format!("{planted} in {}", case.scene.name()));
    }
    for row in &report.checks {
        verdict.intervals.extend(interval(case, row));
    }
    verdict
}

impl Verdict {
    fn wrong(&mut self, kind: String, what: String) {
        self.wrongs.push((kind, what));
    }
}

pub fn is_about(planted: &Planted, code: &str, subject: &Subject) -> bool {
    let is_its = match &planted.subject {
        Some(name) => subject_name(subject) == Some(name),
        None => true,
    };
    planted.codes.contains(&code) && is_its
}

pub fn subject_name(subject: &Subject) -> Option<&str> {
    subject.joint.as_deref().or(subject.topic.as_deref())
}

/// Whether the finding lists the planted fault as indistinguishable.
pub fn is_twin(planted: &Planted, finding: &Finding) -> bool {
    let mut twins = finding.evidence.indistinguishable.iter();
    twins.any(|twin| is_about(planted, twin.code, &twin.subject))
}

pub fn fate(planted: &Planted, findings: &[&Finding], rows: &[CheckRow]) -> Fate {
    if findings.iter().any(|finding| is_about(planted, finding.code, &finding.subject)) {
        return Fate::Named;
    }
    if findings.iter().any(|finding| is_twin(planted, finding)) {
        return Fate::NamedAsTwin;
    }
    match rows.iter().find(|row| is_about(planted, row.code, &row.subject)).map(|row| row.status) {
        Some(Status::Inconclusive | Status::Skipped) => Fate::Undecided,
        Some(_) => Fate::Passed,
        None => Fate::Absent,
    }
}

pub fn is_named(truth: &Misinterpretation, estimate: &Estimate) -> bool {
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
const TOOL: &str = "tool frame";

/// Whether the sign of the value is ignored: a ramp is measured from minimum to maximum, or as an increase.
fn unsigned(kind: Option<Kind>) -> bool {
    matches!(kind, Some(Kind::LatencyRamp | Kind::VelocityScale | Kind::Sag | Kind::Play))
}

/// True value of a row's quantity that comes from the background rather than a fault.
fn given(case: &Case, row: &CheckRow, is_jump: bool) -> f64 {
    let imu = &case.scenario.imu;
    match row.code {
        "YAW001" if !is_jump => imu.yaw_drift_rad_s,
        "YAW004" => imu.gyro_bias_rad_s.norm(),
        _ => given_rad(case, row).unwrap_or(0.0),
    }
}

/// Compliance of a row's joint, rad.
fn given_rad(case: &Case, row: &CheckRow) -> Option<f64> {
    let is_its = |how: &Giving| {
        matches!((row.code, how), ("MOT006", Giving::Play) | ("ZER003", Giving::Sag))
    };
    let joint = row.subject.joint.as_deref()?;
    let chain = chain(&case.scenario);
    let at = chain.joint_names().iter().position(|name| name == joint)?;
    let mut gives = case.scenario.gives.iter();
    gives.find(|gives| gives.joint == at && is_its(&gives.how)).map(|gives| gives.by_rad)
}

/// Error and coverage of a row's interval, if both interval and truth are known.
pub fn interval(case: &Case, row: &CheckRow) -> Vec<Interval> {
    let estimate = match &row.estimate {
        Some(estimate) if !row.is_indistinguishable => estimate,
        _ => return Vec::new(),
    };
    // Motion and residuals are not planted.
    let is_of_motion = row.code.starts_with("MOT") && row.code != "MOT006";
    if is_of_motion
        || row.code.starts_with("MDL")
        || !CORE.iter().any(|family| row.code.starts_with(family))
    {
        return Vec::new();
    }
    // Link deviations then also move the ends of the chain and the mount.
    let of_ends = matches!(row.code, "FRM002" | "FRM003" | "YAW003");
    if case.background.moves_frames() && of_ends {
        return Vec::new();
    }
    let planted = case.planted.iter().find(|planted| is_about(planted, row.code, &row.subject));
    if planted.is_some_and(|planted| planted.times < SURE || matches!(planted.truth, Truth::There))
    {
        return Vec::new();
    }
    // The delay of an arm behind its leader is not planted. A fault reported for all joints has no values
    // for each joint.
    let of_all = |one: &Planted| matches!(one.kind, Kind::VelocityScale | Kind::VelocityLate);
    let is_told_of_all = row.code == "VEL001" && case.planted.iter().any(of_all);
    if planted.is_none() && (row.code == "LAT004" || is_told_of_all) {
        return Vec::new();
    }
    // With a skew, the latency at mid-run is known only to milliseconds; with a change, it depends on the
    // part of the run.
    let timing = &case.scenario.pose.timing;
    let skewed = timing.skew != 0.0 || timing.ages.is_some();
    if row.code == "LAT001" && skewed && row.subject.topic.as_deref() == Some(synth::POSE) {
        return Vec::new();
    }
    let joints_late = case.scenario.joints.timing.latency_s;
    let of_joints = (row.code == "LAT001" && joints_late != 0.0).then_some(Kind::JointsLate);
    let kind = planted.map(|planted| planted.kind).or(of_joints);
    let make = |code: String, value: f64, ci95: Option<[f64; 2]>, truth: f64| {
        let [low, high] = ci95?;
        let covers = (low..=high).contains(&truth);
        let mut topic = row.subject.topic.clone().unwrap_or("joints".to_owned());
        if topic == synth::TF && case.scenario.tf.timing.phase_s == 0.0 {
            topic += " with the joints' stamps";
        }
        let is_norm = NORMS.iter().any(|norm| code.starts_with(norm));
        Some(Interval { code, topic, planted: kind, error: value - truth, truth, covers, is_norm })
    };
    match *estimate {
        Estimate::Scalar { name, value, ci95, .. } => {
            // A yaw jump and a yaw drift have one row each.
            let is_jump = name == "yaw jump";
            let planted = planted.filter(|one| (one.kind == Kind::YawJump) == is_jump);
            let mut truth = match planted.map(|planted| planted.truth) {
                Some(Truth::Amount(truth)) => truth,
                _ => given(case, row, is_jump),
            };
            let value = if unsigned(kind) { value.abs() } else { value };
            let ci95 = ci95.map(|[low, high]| match unsigned(kind) && high < 0.0 {
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
            let planted = planted.filter(|one| one.kind != Kind::Alternates || name != TOOL);
            let (length_m, angle_rad) = match planted.map(|planted| planted.truth) {
                Some(Truth::Frame { length_m, angle_rad }) => (length_m, angle_rad),
                _ => (0.0, 0.0),
            };
            let length = make(format!("{} m", row.code), value, ci95, length_m);
            let angle = make(format!("{} rad", row.code), rotation.value, rotation.ci95, angle_rad);
            length.into_iter().chain(angle).collect()
        }
        _ => Vec::new(),
    }
}
