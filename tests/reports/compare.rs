//! `compare`: two reports on the same robot.

use std::fs;

use poseaudit::compare::{ChangeKind, Comparison, compare};
use poseaudit::finding::{Estimate, Finding, Severity, Status};
use poseaudit::report::{Report, Verdict};
use serde_json::Value;

use super::sample_reports::{FAULTY_REPORT, render};
use super::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};

const WARNING: Option<Severity> = Some(Severity::Warning);

/// The report on the faulty log without its findings.
fn report_without_findings() -> Report {
    let mut report = FAULTY_REPORT.clone();
    report.findings.clear();
    report.verdict = Verdict::Pass;
    for row in &mut report.checks {
        if row.status == Status::Fail {
            row.status = Status::Pass;
        }
    }
    report
}

/// The report on the faulty log with another latency value and half interval.
fn report_with_latency(value: f64, half: f64) -> Report {
    let mut report = FAULTY_REPORT.clone();
    let latency = finding_mut(&mut report, "LAT001").estimate.as_mut();
    let Some(Estimate::Scalar { value: was, ci95, .. }) = latency else { panic!("no amount") };
    (*was, *ci95) = (value, Some([value - half, value + half]));
    report
}

fn finding_mut<'a>(report: &'a mut Report, code: &str) -> &'a mut Finding {
    report.findings.iter_mut().find(|finding| finding.code == code).expect("a finding")
}

fn course_of(comparison: &Comparison, code: &str) -> ChangeKind {
    comparison.causes.iter().find(|change| change.code == code).expect("a cause").kind
}

#[test]
fn a_json_report_is_read_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("report.json");
    fs::write(&path, render("json", &FAULTY_REPORT)).expect("a file");
    let read = Report::from_file(&path).expect("a report");
    assert_eq!(render("json", &read), render("json", &FAULTY_REPORT));
    assert_eq!(read.findings[0].estimate, FAULTY_REPORT.findings[0].estimate);
}

#[test]
fn a_report_without_newer_keys_is_read() {
    let mut old = serde_json::to_value(&*FAULTY_REPORT).expect("JSON");
    for key in ["observability", "workspace"] {
        old.as_object_mut().expect("an object").remove(key).expect("the key");
    }
    let read: Report = serde_json::from_value(old).expect("a report");
    assert_eq!(read.findings.len(), FAULTY_REPORT.findings.len());
    assert!(!compare(&read, &FAULTY_REPORT, WARNING).regression);
}

#[test]
fn a_report_is_no_worse_than_itself() {
    let report = FAULTY_REPORT.clone();
    let comparison = compare(&report, &report, WARNING);
    assert!(!comparison.regression && comparison.lost.is_empty());
    assert!(comparison.causes.iter().all(|change| change.kind == ChangeKind::Same));
    assert_eq!(comparison.causes.len(), FAULTY_REPORT.findings.len());
}

#[test]
fn new_findings_fail_from_a_severity_and_resolved_ones_do_not() {
    let (sound, faulty) = (report_without_findings(), FAULTY_REPORT.clone());
    let there = compare(&sound, &faulty, WARNING);
    assert!(there.regression && there.causes.iter().all(|it| it.kind == ChangeKind::Appeared));
    assert!(!compare(&sound, &faulty, None).regression);
    let mut milder = faulty.clone();
    milder.findings.iter_mut().for_each(|finding| finding.severity = Severity::Warning);
    assert!(compare(&sound, &milder, WARNING).regression);
    assert!(!compare(&sound, &milder, Some(Severity::Error)).regression);
    let back = compare(&faulty, &sound, WARNING);
    assert!(!back.regression && back.causes.iter().all(|it| it.kind == ChangeKind::Gone));
}

#[test]
fn a_value_grows_only_beyond_both_intervals_and_by_a_tenth() {
    let old = report_with_latency(15e-3, 1e-3);
    let cases = [
        (20e-3, 1e-3, ChangeKind::Grew),
        (20e-3, 5e-3, ChangeKind::Same),
        (16e-3, 1e-6, ChangeKind::Same),
        (10e-3, 1e-3, ChangeKind::Shrank),
        (-15e-3, 1e-3, ChangeKind::Changed),
        (-20e-3, 1e-3, ChangeKind::Grew),
    ];
    for (value, half, expected) in cases {
        let comparison = compare(&old, &report_with_latency(value, half), WARNING);
        assert_eq!(course_of(&comparison, "LAT001"), expected, "{value} ± {half}");
        assert_eq!(comparison.regression, expected < ChangeKind::Same, "{value} ± {half}");
    }
    // Narrow intervals alone are not an increase: runs differ by more.
    let narrow = report_with_latency(15e-3, 1e-7);
    assert_eq!(
        course_of(&compare(&narrow, &report_with_latency(15.2e-3, 1e-7), WARNING), "LAT001"),
        ChangeKind::Same
    );
}

#[test]
fn a_higher_severity_counts_as_grown_and_another_misinterpretation_as_changed() {
    let mut old = FAULTY_REPORT.clone();
    finding_mut(&mut old, "ZER001").severity = Severity::Warning;
    assert_eq!(
        course_of(&compare(&old, &FAULTY_REPORT.clone(), WARNING), "ZER001"),
        ChangeKind::Grew
    );
    let report_with_encoding = |is: &str| {
        let mut report = FAULTY_REPORT.clone();
        let is = is.to_owned();
        finding_mut(&mut report, "ZER001").estimate =
            Some(Estimate::misinterpretation("rotations", is, "euler:xyz"));
        report
    };
    let comparison =
        compare(&report_with_encoding("rotvec"), &report_with_encoding("euler:ZYX"), WARNING);
    assert_eq!(course_of(&comparison, "ZER001"), ChangeKind::Changed);
    assert!(comparison.regression);
}

#[test]
fn a_cause_that_became_inconclusive_is_not_gone() {
    let faulty = FAULTY_REPORT.clone();
    let mut open = report_without_findings();
    for row in open.checks.iter_mut().filter(|row| row.code == "LAT001") {
        row.status = Status::Inconclusive;
        row.reason = Some("the arm never moves".to_owned());
    }
    let comparison = compare(&faulty, &open, WARNING);
    assert_eq!(course_of(&comparison, "LAT001"), ChangeKind::Undetermined);
    assert_eq!(course_of(&comparison, "ZER001"), ChangeKind::Gone);
    assert!(!comparison.lost.is_empty() && comparison.lost.iter().all(|it| it.code == "LAT001"));
    assert!(!comparison.regression);
    open.verdict = Verdict::Inconclusive;
    assert!(
        compare(&report_without_findings(), &open, WARNING).regression,
        "a pass became undetermined"
    );
    assert!(!compare(&report_without_findings(), &open, None).regression);
}

#[test]
fn a_renamed_file_is_the_same_log() {
    let damaged = |file: &str| {
        let mut report = FAULTY_REPORT.clone();
        report.log.files[0].path = file.into();
        let finding = finding_mut(&mut report, "LAT001");
        finding.code = "ING001";
        finding.subject.topic = Some(file.to_owned());
        report
    };
    let comparison = compare(&damaged("monday.mcap"), &damaged("tuesday.mcap"), WARNING);
    assert_eq!(course_of(&comparison, "ING001"), ChangeKind::Same);
}

#[test]
fn a_log_is_compared_with_its_baseline() {
    let folder = tempfile::tempdir().expect("a folder");
    let baseline = folder.path().join("baseline.json").display().to_string();
    fs::write(&baseline, render("json", &FAULTY_REPORT)).expect("a file");
    let same = poseaudit(&["compare", &baseline, FAULTY]);
    assert_eq!(status(&same), 0, "{}{}", stdout(&same), stderr(&same));
    assert!(stdout(&same).contains("NO REGRESSION   2 same"), "{}", stdout(&same));
    let worse = poseaudit(&["compare", CLEAN, &baseline, "--format", "json"]);
    assert_eq!(status(&worse), 1, "{}", stderr(&worse));
    let json: Value = serde_json::from_slice(&worse.stdout).expect("JSON");
    assert_eq!(json["schema"], "poseaudit.comparison/1");
    assert_eq!(json["verdicts"], serde_json::json!(["pass", "fail"]));
    assert!(json["causes"].as_array().expect("a list").iter().all(|it| it["regression"] == true));
    let never = poseaudit(&["compare", CLEAN, &baseline, "--fail-on", "never"]);
    assert_eq!(status(&never), 0, "{}", stdout(&never));
}

#[test]
fn an_unreadable_new_log_is_a_regression_and_an_unreadable_old_one_a_wrong_call() {
    let folder = tempfile::tempdir().expect("a folder");
    let empty = folder.path().join("empty.mcap");
    fs::write(&empty, "").expect("a file");
    let empty = empty.display().to_string();
    let new = poseaudit(&["compare", CLEAN, &empty]);
    assert_eq!(status(&new), 1, "{}", stderr(&new));
    assert!(stdout(&new).contains("was not audited: the file is empty"), "{}", stdout(&new));
    assert_eq!(status(&poseaudit(&["compare", &empty, CLEAN])), 2);
}

#[test]
fn the_markdown_of_a_comparison_is_current() {
    let (mut old, new) = (report_with_latency(5e-3, 1e-5), FAULTY_REPORT.clone());
    old.findings.retain(|finding| finding.code == "LAT001");
    old.findings[0].severity = Severity::Warning;
    let comparison = compare(&old, &new, WARNING);
    let mut out = Vec::new();
    poseaudit::compare::markdown(&comparison, &mut out).expect("a text");
    insta::assert_snapshot!("compared.md", String::from_utf8(out).expect("UTF-8"));
}

#[test]
fn an_invalid_report_is_refused_with_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("a file");
        path.display().to_string()
    };
    let report = render("json", &FAULTY_REPORT);
    let sound = write("sound.json", &report);
    let other = report.replace("poseaudit.report/1", "poseaudit.report/9");
    let broken = report.replace("\"verdict\": \"fail\"", "\"verdict\": 7");
    assert_ne!(report, broken);
    for (path, parts) in [
        (write("other.json", &other), ["other.json", "poseaudit.report/9", "--format json"]),
        (write("cut.json", &report[..300]), ["cut.json:", "no JSON", "--format json"]),
        (write("broken.json", &broken), ["broken.json:7", "not a report", "--format json"]),
        (write("object.json", "{}"), ["object.json", "not a report", "--format json"]),
        (write("text.txt", "a,b\n1,2\n"), ["text.txt", "not a robot log", "name"]),
        ("no/such.json".to_owned(), ["no/such.json", "no such file", ""]),
    ] {
        let output = poseaudit(&["compare", &sound, &path]);
        let line = stderr(&output).trim_end();
        assert_eq!(status(&output), 2, "{line}");
        assert!(output.stdout.is_empty() && !line.contains('\n'), "{line}");
        assert!(parts.iter().all(|part| line.contains(part)), "{line}");
    }
}
