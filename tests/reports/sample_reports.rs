//! Reports for the format tests: a real one, and one with hostile names.

use std::path::PathBuf;
use std::sync::LazyLock;

use poseaudit::checks::Evaluation;
use poseaudit::finding::{Cause, CheckRow, Estimate, Evidence, Finding, Severity, Status, Subject};
use poseaudit::report::{FileRow, Format, LogSummary, Report};
use poseaudit::{Options, audit};

use super::FAULTY;

/// A report with two faults, one undetermined check, and some skipped ones.
pub static FAULTY_REPORT: LazyLock<Report> = LazyLock::new(|| {
    audit(&Options { logs: vec![FAULTY.into()], ..Options::default() }).expect("a report").report
});

/// A hostile topic name.
pub const HOSTILE_NAME: &str =
    "/a|b\\|c\\\\|`d`</td><script>*e*_f_[g](https://h.i)@j ]]>&amp;\"'%0A::error::,k=\nl\u{1b}[31m";

/// A report in which every name and sentence is [`HOSTILE_NAME`]. Its severity is below `fail_on`, if that is
/// set.
pub fn hostile_report(fail_on: Option<Severity>) -> Report {
    let subject = Subject { topic: Some(HOSTILE_NAME.to_owned()), ..Subject::default() };
    let row = |code, status, reason: Option<&str>| CheckRow {
        code,
        name: "a-rule",
        subject: subject.clone(),
        status,
        reason: reason.map(str::to_owned),
        estimate: None,
        evidence: Default::default(),
        is_indistinguishable: false,
        is_exempt: false,
    };
    let finding = Finding {
        code: "LAT001",
        severity: Severity::Warning,
        title: "stream is late",
        message: format!("3 ms late against {HOSTILE_NAME}"),
        subject: subject.clone(),
        cause: Cause::Other,
        segment: None,
        estimate: Some(Estimate::exact("latency", "s", 3e-3)),
        evidence: Evidence { effect: Some(HOSTILE_NAME.to_owned()), ..Evidence::default() },
        fix: format!("shift {HOSTILE_NAME}"),
        start_ns: None,
        end_ns: None,
    };
    let log = LogSummary {
        files: vec![FileRow {
            path: PathBuf::from(HOSTILE_NAME),
            container: "mcap",
            bytes: 1,
            fetched_bytes: None,
            crc: "all",
        }],
        messages: 1,
        duration_s: Some(1.0),
        ..LogSummary::default()
    };
    let evaluation = Evaluation {
        ignored: Vec::new(),
        checks: vec![
            row("FRM001", Status::Pass, Some(HOSTILE_NAME)),
            row("LAT001", Status::Fail, None),
            row("LAT002", Status::Inconclusive, Some(HOSTILE_NAME)),
            row("LAT003", Status::Skipped, Some(HOSTILE_NAME)),
        ],
        findings: vec![finding],
        observability: vec![],
    };
    Report::new(log, vec![], vec![], evaluation, fail_on)
}

/// `report` in the named format.
pub fn render(format: &str, report: &Report) -> String {
    let mut out = Vec::new();
    Format::from_name(format).expect("a format").write(report, &mut out).expect("a report");
    String::from_utf8(out).expect("UTF-8")
}

#[test]
fn no_topic_name_is_printed_with_control_characters() {
    let text = render("text", &hostile_report(Some(Severity::Warning)));
    let names = text.matches("k=").count();
    assert!(names > 0, "{text}");
    assert_eq!(text.matches("k=\u{fffd}l\u{fffd}[31m").count(), names, "{text}");
}
