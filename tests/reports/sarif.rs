//! SARIF against its schema, and the requirements of code scanning.

use std::collections::BTreeSet;

use boon::{Compiler, Schemas};
use poseaudit::checks::registry;
use poseaudit::finding::{IgnoredFinding, Severity, Status};
use poseaudit::report::{Report, Trouble, TroubleKind};
use serde_json::Value;

use super::sample_reports::{FAULTY_REPORT, HOSTILE_NAME, hostile_report, render};

fn sarif(report: &Report) -> Value {
    serde_json::from_str(&render("sarif", report)).expect("JSON")
}

fn error_report() -> Report {
    Report::from_trouble(Trouble {
        kind: TroubleKind::Log,
        what: "the file is empty (0 bytes)".to_owned(),
        place: HOSTILE_NAME.to_owned(),
        remedy: "check whether the recorder wrote it".to_owned(),
    })
}

#[test]
fn every_sarif_report_is_valid() {
    let path =
        concat!(env!("CARGO_MANIFEST_DIR"), "/tests/reports/schemas/sarif-schema-2.1.0.json");
    let (mut schemas, mut compiler) = (Schemas::new(), Compiler::new());
    compiler.enable_format_assertions();
    let schema = compiler.compile(path, &mut schemas).expect("a schema");
    for report in [&*FAULTY_REPORT, &hostile_report(Some(Severity::Warning)), &error_report()] {
        let log = sarif(report);
        schemas.validate(&log, schema).unwrap_or_else(|error| panic!("{error:#}"));
    }
    let mut wrong = sarif(&FAULTY_REPORT);
    wrong["runs"][0]["results"][0]["level"] = "fatal".into();
    assert!(schemas.validate(&wrong, schema).is_err(), "the schema must look at results");
}

#[test]
fn a_finding_is_a_sarif_result_and_an_inconclusive_check_a_notification() {
    let mut report = FAULTY_REPORT.clone();
    let row = report.checks.iter_mut().find(|row| row.status == Status::Pass).expect("a pass");
    (row.status, row.reason) = (Status::Inconclusive, Some("too little motion".to_owned()));
    let log = sarif(&report);
    let run = &log["runs"][0];
    let rules = run["tool"]["driver"]["rules"].as_array().expect("rules");
    assert_eq!(rules.len(), registry().len());
    let results = run["results"].as_array().expect("results");
    assert_eq!(results.len(), FAULTY_REPORT.findings.len());
    for (result, finding) in results.iter().zip(&FAULTY_REPORT.findings) {
        let rule = &rules[result["ruleIndex"].as_u64().expect("an index") as usize];
        assert_eq!((&rule["id"], &result["ruleId"]), (&result["ruleId"], &finding.code.into()));
        assert!(result["message"]["text"].as_str().expect("a text").contains(&finding.message));
        let value = finding.estimate.as_ref().and_then(|estimate| estimate.value());
        assert_eq!(result["properties"]["estimate"]["value"].as_f64(), value);
    }
    let open = report.checks.iter().filter(|row| row.status == Status::Inconclusive).count();
    let invocation = &run["invocations"][0];
    assert!(open > 0 && invocation["executionSuccessful"] == true);
    assert_eq!(invocation["toolExecutionNotifications"].as_array().map(Vec::len), Some(open));
}

#[test]
fn an_ignored_finding_is_a_suppressed_result_with_its_reason() {
    let mut report = FAULTY_REPORT.clone();
    let finding = report.findings.remove(0);
    let (reason, place) = ("known since May".to_owned(), "poseaudit.toml:3".to_owned());
    report.ignored.push(IgnoredFinding { finding, reason, place });
    let log = sarif(&report);
    let results = log["runs"][0]["results"].as_array().expect("results");
    assert_eq!(results.len(), FAULTY_REPORT.findings.len());
    let of_ignored: Vec<&Value> =
        results.iter().filter(|result| result.get("suppressions").is_some()).collect();
    assert_eq!(of_ignored.len(), 1);
    assert_eq!(of_ignored[0]["ruleId"], FAULTY_REPORT.findings[0].code);
    let justification = &of_ignored[0]["suppressions"][0]["justification"];
    assert_eq!(justification, "known since May (poseaudit.toml:3)");
    for format in ["text", "html", "markdown", "github"] {
        assert!(render(format, &report).contains("known since May"), "{format}");
    }
}

#[test]
fn an_unaudited_log_is_a_failed_execution() {
    let log = sarif(&error_report());
    let invocation = &log["runs"][0]["invocations"][0];
    assert_eq!(invocation["executionSuccessful"], false);
    let notification = &invocation["toolExecutionNotifications"][0];
    assert_eq!(notification["level"], "error");
    assert!(notification["message"]["text"].as_str().is_some_and(|text| text.contains("0 bytes")));
}

#[test]
fn a_fingerprint_depends_on_the_cause_and_not_on_the_value() {
    let fingerprints = |report: &Report| -> BTreeSet<String> {
        let log = sarif(report);
        let results = log["runs"][0]["results"].as_array().expect("results").iter();
        results.map(|result| result["partialFingerprints"].to_string()).collect()
    };
    let mut later = FAULTY_REPORT.clone();
    for finding in &mut later.findings {
        finding.message.push_str(", and more than before");
        finding.severity = Severity::Warning;
        finding.estimate = None;
    }
    later.log.files[0].path = "another.mcap".into();
    assert_eq!(fingerprints(&FAULTY_REPORT), fingerprints(&later));
    assert_eq!(fingerprints(&FAULTY_REPORT).len(), FAULTY_REPORT.findings.len());
    later.findings[0].subject.topic = Some("/another".to_owned());
    assert_ne!(fingerprints(&FAULTY_REPORT), fingerprints(&later));
}
