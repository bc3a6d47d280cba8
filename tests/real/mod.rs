//! Recordings of real arms: the table of expected answers, and one short excerpt.
//!
//! `ur3e.csv` contains the joints and the TCP pose of one run of a UR3e at 25 Hz, merged from five files of
//! ubc-systopia/dsn-2022-rad-artifact at 7d954a99 (MIT, see `NOTICE.md`).

use std::fs;
use std::path::Path;

use poseaudit::finding::{Estimate, Severity};

#[allow(dead_code, reason = "only the example runs audits")]
mod table;

fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn the_page_on_real_logs_is_current() {
    let sources = table::sources().expect("tests/real/expected.toml");
    let page = fs::read_to_string(project().join("docs/real-logs.md")).expect("docs/real-logs.md");
    let command = "cargo run --example real_logs -- --markdown > docs/real-logs.md";
    assert!(page == table::markdown(&sources), "out of date, run: {command}");
}

/// The tool is 149.9 mm long, and the nominal model has a residual of 0.04 to 0.31 mm.
#[test]
fn a_real_ur3e_is_identified_without_findings() {
    let log = project().join("tests/real/ur3e.csv");
    let options = poseaudit::Options { logs: vec![log], ..Default::default() };
    let report = poseaudit::audit(&options).expect("the log can be read").into_report();
    assert_eq!(report.robots[0].name, "ur3e");
    let wrong: Vec<_> =
        report.findings.iter().filter(|finding| finding.severity > Severity::Info).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
    let tool = report.findings.iter().find(|finding| finding.code == "FRM003");
    let length_m = tool.and_then(|tool| tool.estimate.as_ref()).and_then(Estimate::value);
    assert!(length_m.is_some_and(|length_m| (length_m - 0.1499).abs() < 0.5e-3), "{length_m:?}");
}
