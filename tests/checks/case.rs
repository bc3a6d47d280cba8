//! A test case: a modified log, and the expected result of its audit.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, LazyLock, Mutex, OnceLock};

use poseaudit::finding::{CheckRow, Estimate, Finding, Severity, Status, Subject};
use poseaudit::report::{Report, Trouble};
use poseaudit::synth::Scenario;
use poseaudit::{Options, audit};

use crate::checks::recording::{self, Message};

/// Cached result of an audit.
type CachedReport = Arc<OnceLock<Result<Report, Trouble>>>;

/// The log of a case, before it is written.
pub struct Log {
    /// Scenario of the log.
    pub run: Scenario,
    /// Modification of its messages.
    pub edit: Option<fn(&mut Vec<Message>)>,
    /// Modification of the file's bytes.
    pub damage: Option<fn(&mut Vec<u8>)>,
    /// Audit options.
    pub options: Options,
    /// Output folder for corrections.
    pub fix: Option<PathBuf>,
}

/// One rule, one log, one expectation.
pub struct Case {
    pub code: &'static str,
    pub name: &'static str,
    pub log: fn(&mut Log),
    pub expected: Expected,
}

/// Expected result for the rule of the case.
pub enum Expected {
    /// Planted fault: exactly one finding, of this rule.
    Finding(Severity, ExpectedSubject, ExpectedEstimate),
    /// Healthy log: the rule passes for all subjects, without findings.
    NoFindings,
    /// Fault of another kind: only the rule named here finds it. The rule of the case passes, or explains
    /// that no log could show it.
    OnlyOtherFinding(&'static str),
    /// Fault of another kind: only the rule named here finds it. It leaves the rule of the case
    /// undetermined for some subjects, with this reason.
    OtherFindingAndInconclusive(&'static str, &'static str),
    /// Missing input: the rule is skipped with this reason.
    Skipped(&'static str),
    /// Missing input: the rule is undetermined for every subject, with this reason, and there are no
    /// findings.
    Inconclusive(&'static str),
    /// Missing input: the log is refused without a report.
    Refused(&'static str),
}

/// Subject of a finding.
#[derive(Clone, Copy)]
pub enum ExpectedSubject {
    Topic(&'static str),
    Joint(&'static str),
    /// Topic and joint.
    JointOf(&'static str, &'static str),
    /// Topic and frame.
    Frame(&'static str, &'static str),
    /// A whole robot.
    Robot,
    /// The file.
    File,
    /// The whole run.
    Run,
}

/// Estimate of a finding.
#[derive(Clone, Copy)]
pub enum ExpectedEstimate {
    /// Value and tolerance, SI, with an interval.
    Amount(f64, f64),
    /// Value and tolerance, SI, without an interval.
    AmountWithoutInterval(f64, f64),
    /// `Amount` in degrees.
    Degrees(f64, f64),
    /// `Amount` in degrees per minute.
    DegreesPerMinute(f64, f64),
    /// Length and its tolerance, m; angle and its tolerance, degrees.
    Frame([f64; 2], [f64; 2]),
    /// Bounds of the residual's length, m.
    ResidualBetween(f64, f64),
    /// Actual encoding, and the misinterpretation.
    IsReadAs(&'static str, &'static str),
    /// The joints in the order of the logged numbers.
    Order(&'static [&'static str]),
    /// No estimate.
    None,
}

/// Defines a family's `CASES`, and a test for each.
macro_rules! cases {
    ($($code:ident $name:ident: $log:expr => $expected:expr;)*) => {
        pub(crate) const CASES: &[$crate::checks::case::Case] = &[$($crate::checks::case::Case {
            code: stringify!($code),
            name: stringify!($name),
            log: $log,
            expected: $expected,
        }),*];

        $(
            #[test]
            fn $name() {
                let case = CASES.iter().find(|case| case.name == stringify!($name));
                case.expect("a test is made of its case").check();
            }
        )*
    };
}
pub(crate) use cases;

pub const fn error(on: ExpectedSubject, what: ExpectedEstimate) -> Expected {
    Expected::Finding(Severity::Error, on, what)
}

pub const fn warning(on: ExpectedSubject, what: ExpectedEstimate) -> Expected {
    Expected::Finding(Severity::Warning, on, what)
}

pub const fn info(on: ExpectedSubject, what: ExpectedEstimate) -> Expected {
    Expected::Finding(Severity::Info, on, what)
}

impl Log {
    /// 8 s of a UR5e, at low rates for a fast audit. Streams share no stamps.
    pub fn fault_free() -> Self {
        let mut run = Scenario { duration_s: 8.0, ..Scenario::ur5e() };
        (run.amplitude, run.speed) = (1.0, 2.0);
        run.joints.timing.rate_hz = 50.0;
        run.pose.timing.rate_hz = 25.0;
        run.tf.timing.rate_hz = 12.5;
        run.imu.timing.rate_hz = 100.0;
        Self { run, edit: None, damage: None, options: Options::default(), fix: None }
    }

    /// A modified sound log.
    pub fn modified(change: impl FnOnce(&mut Self)) -> Self {
        let mut log = Self::fault_free();
        change(&mut log);
        log
    }

    #[track_caller]
    pub fn report(&self) -> Report {
        self.try_report().expect("the log is audited")
    }

    /// The report, or the error.
    pub fn try_report(&self) -> Result<Report, Trouble> {
        if self.edit.is_some() || self.damage.is_some() || self.fix.is_some() {
            return self.run_audit();
        }
        // Cases share logs, so each log is audited once.
        static CACHE: LazyLock<Mutex<HashMap<String, CachedReport>>> =
            LazyLock::new(Mutex::default);
        let key = format!("{:?} {:?}", self.run, self.options);
        let audited = Arc::clone(CACHE.lock().expect("no panic within").entry(key).or_default());
        audited.get_or_init(|| self.run_audit()).clone()
    }

    fn run_audit(&self) -> Result<Report, Trouble> {
        let mut bytes = recording::write(&self.run, self.edit);
        if let Some(damage) = self.damage {
            damage(&mut bytes);
        }
        let file = tempfile::Builder::new().suffix(".mcap").tempfile().expect("a file");
        std::fs::write(file.path(), bytes).expect("the file is written");
        let audited =
            audit(&Options { logs: vec![file.path().to_owned()], ..self.options.clone() })?;
        self.fix.as_deref().map_or(Ok(()), |folder| audited.write_fixes(folder))?;
        Ok(audited.into_report())
    }
}

impl Case {
    #[track_caller]
    pub fn check(&self) {
        let log = Log::modified(self.log);
        if let Expected::Refused(part) = self.expected {
            let trouble = log.try_report().expect_err("there is no log");
            assert!(trouble.to_string().contains(part), "{trouble}");
            return;
        }
        let report = log.report();
        let rows: Vec<&CheckRow> =
            report.checks.iter().filter(|row| row.code == self.code).collect();
        assert!(!rows.is_empty(), "{} was not asked", self.code);
        let found = summary(&report.findings);
        report.findings.iter().for_each(assert_predicts);
        match &self.expected {
            Expected::Finding(severity, on, what) => {
                let [finding] = report.findings.as_slice() else {
                    panic!("{} alone was expected, found:\n{found}", self.code)
                };
                assert_eq!(finding.code, self.code, "found:\n{found}");
                on.assert_matches(&finding.subject);
                what.assert_matches(finding.estimate.as_ref());
                assert_eq!(finding.severity, *severity, "{found}");
                let failed = rows.iter().filter(|row| row.status == Status::Fail);
                assert_eq!(failed.count(), 1, "{rows:#?}");
            }
            Expected::NoFindings => {
                assert!(report.findings.is_empty(), "found:\n{found}");
                for row in rows {
                    assert_eq!(row.status, Status::Pass, "{row:#?}");
                }
            }
            Expected::OnlyOtherFinding(code) => {
                assert!(!report.findings.is_empty(), "the neighbour's fault was not found");
                let others = report.findings.iter().any(|finding| finding.code != *code);
                assert!(!others, "{code} alone was expected, found:\n{found}");
                for row in rows {
                    let is_fine = row.status == Status::Pass || row.is_indistinguishable;
                    assert!(is_fine, "{row:#?}");
                }
            }
            Expected::OtherFindingAndInconclusive(code, part) => {
                let found_by: Vec<&str> = report.findings.iter().map(|found| found.code).collect();
                assert_eq!(found_by, [*code], "found:\n{found}");
                let open = rows.iter().copied().filter(|row| row.status != Status::Pass);
                let open: Vec<&CheckRow> = open.collect();
                assert!(!open.is_empty(), "nothing is undetermined");
                assert_reasons(&open, Status::Inconclusive, part);
            }
            Expected::Skipped(part) => {
                assert_reasons(&rows, Status::Skipped, part);
                assert!(report.findings.is_empty(), "found:\n{found}");
            }
            Expected::Inconclusive(part) => {
                assert_reasons(&rows, Status::Inconclusive, part);
                assert!(report.findings.is_empty(), "found:\n{found}");
            }
            Expected::Refused(_) => unreachable!("answered above"),
        }
    }
}

#[track_caller]
fn assert_reasons(rows: &[&CheckRow], status: Status, part: &str) {
    for row in rows {
        assert_eq!(row.status, status, "{row:#?}");
        let reason = row.reason.as_deref().unwrap_or_default();
        assert!(reason.contains(part), "`{part}` is missing in: {reason}");
    }
}

/// The correction reduces the error on samples that were not fitted.
#[track_caller]
fn assert_predicts(finding: &Finding) {
    let Some(held_out) = finding.evidence.more.get("held_out") else { return };
    let error = |of: &str| {
        let number = |unit: &str| held_out[of][unit].as_f64().expect("a number");
        number("m").hypot(0.3 * number("rad"))
    };
    assert!(error("after") < error("before"), "{} {held_out}", finding.code);
}

/// One line per finding, for messages.
pub fn summary(findings: &[Finding]) -> String {
    let line = |finding: &Finding| {
        let (severity, label) = (finding.severity.name(), finding.subject.label());
        format!("  {severity} {} {label}: {}\n", finding.code, finding.message)
    };
    findings.iter().map(line).collect()
}

/// The only finding of `code` on `label`.
#[track_caller]
pub fn single_finding<'a>(report: &'a Report, code: &str, label: &str) -> &'a Finding {
    let is_meant = |finding: &&Finding| finding.code == code && finding.subject.label() == label;
    let meant: Vec<&Finding> = report.findings.iter().filter(is_meant).collect();
    let [finding] = meant.as_slice() else {
        panic!("one {code} on {label} was expected, found:\n{}", summary(&report.findings))
    };
    finding
}

impl Expected {
    pub const KINDS: [&str; 4] = ["planted fault", "clean", "neighbouring fault", "missing input"];

    /// Its entry in [`Self::KINDS`].
    pub fn kind(&self) -> &'static str {
        let [planted, clean, neighbour, missing] = Self::KINDS;
        match self {
            Self::Finding(..) => planted,
            Self::NoFindings => clean,
            Self::OnlyOtherFinding(_) | Self::OtherFindingAndInconclusive(..) => neighbour,
            Self::Skipped(_) | Self::Inconclusive(_) | Self::Refused(_) => missing,
        }
    }
}

impl ExpectedSubject {
    #[track_caller]
    pub fn assert_matches(self, subject: &Subject) {
        let Subject { topic, joint, frame, .. } = subject;
        let found = [topic, joint, frame].map(|name| name.as_deref().unwrap_or_default());
        match self {
            Self::Topic(topic) => assert_eq!(found, [topic, "", ""]),
            Self::Joint(joint) => assert_eq!(found, ["", joint, ""]),
            Self::JointOf(topic, joint) => assert_eq!(found, [topic, joint, ""]),
            Self::Frame(topic, frame) => assert_eq!(found, [topic, "", frame]),
            Self::Robot => {
                assert_eq!(found, ["", "", ""]);
                assert!(subject.robot.is_some());
            }
            Self::File => assert!(found[0].ends_with(".mcap"), "{subject:?}"),
            Self::Run => assert_eq!(*subject, Subject::default()),
        }
    }
}

impl ExpectedEstimate {
    #[track_caller]
    pub fn assert_matches(self, estimate: Option<&Estimate>) {
        const MINUTE_S: f64 = 60.0;
        match (self, estimate) {
            (Self::None, None) => {}
            (Self::Amount(value, tolerance), Some(found)) => {
                assert_near(found, value, tolerance);
            }
            (
                Self::AmountWithoutInterval(value, tolerance),
                Some(Estimate::Scalar { value: found, ci95, .. }),
            ) => {
                assert!((found - value).abs() <= tolerance, "{found} is not {value} ± {tolerance}");
                assert_eq!(*ci95, None);
            }
            (Self::Degrees(value, tolerance), Some(found)) => {
                assert_near(found, value.to_radians(), tolerance.to_radians());
            }
            (Self::DegreesPerMinute(value, tolerance), Some(found)) => {
                let rate = |degrees: f64| degrees.to_radians() / MINUTE_S;
                assert_near(found, rate(value), rate(tolerance));
            }
            (
                Self::Frame([length, m], [angle, degrees]),
                Some(found @ Estimate::Frame { rotation, .. }),
            ) => {
                assert_near(found, length, m);
                let off = (rotation.value - angle.to_radians()).abs();
                assert!(off <= degrees.to_radians(), "{rotation:?} is not {angle} ± {degrees}°");
                assert!(rotation.ci95.is_some(), "{rotation:?}");
            }
            (Self::ResidualBetween(low, high), Some(Estimate::Frame { value, .. })) => {
                assert!((low..high).contains(value), "{value} is not within {low} to {high}");
            }
            (Self::IsReadAs(is, read_as), Some(found)) => assert_read_as(found, is, read_as),
            (Self::Order(expected), Some(Estimate::Order { permutation, .. })) => {
                assert_eq!(permutation, expected);
            }
            (_, found) => panic!("another estimate was expected than {found:?}"),
        }
    }
}

/// Asserts that the value is `expected` within `tolerance`, and that twice the interval contains it.
#[track_caller]
fn assert_near(found: &Estimate, expected: f64, tolerance: f64) {
    let (Estimate::Scalar { value, ci95, .. } | Estimate::Frame { value, ci95, .. }) = found else {
        panic!("an amount was expected, not {found:?}")
    };
    let off = (value - expected).abs();
    assert!(off <= tolerance, "{value} is not {expected} ± {tolerance}");
    let half = half_width(found).unwrap_or_else(|| panic!("{value} has no interval: {ci95:?}"));
    assert!(off <= 2.0 * half, "{value} ± {half} is not {expected}");
}

/// Half the width of the 95 % interval.
pub fn half_width(estimate: &Estimate) -> Option<f64> {
    match estimate {
        Estimate::Scalar { value, ci95, .. } | Estimate::Frame { value, ci95, .. } => {
            ci95.map(|ends| ends[1] - value)
        }
        _ => None,
    }
}

#[track_caller]
fn assert_read_as(found: &Estimate, expected: &str, expected_read_as: &str) {
    let found = match found {
        Estimate::Convention { is, read_as, .. } => [is.as_str(), read_as.as_str()],
        Estimate::Misinterpretation { is, read_as, .. } => [is.as_ref(), read_as.as_ref()],
        other => panic!("a reading was expected, not {other:?}"),
    };
    assert_eq!(found, [expected, expected_read_as]);
}
