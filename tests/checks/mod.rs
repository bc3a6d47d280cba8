//! Tests each rule on a log with its fault, without it, with another rule's fault, and without its input.
//!
//! A case is a line of a family's `cases!` table: the rule, a name, the modification of a sound log, and
//! the expected result. [`Expected`] defines the four kinds. A registered rule without a case of every kind
//! fails here.

mod case;
mod combined_faults;
mod corrections;
mod frm;
mod hec;
mod imu;
mod ing;
mod invariance;
mod lat;
mod long_runs;
pub mod mdl;
mod mid_run_changes;
mod mot;
mod ord;
pub mod recording;
mod reports;
mod tim;
mod timing;
mod vel;
mod yaw;
mod zer;

use std::collections::BTreeSet;

use poseaudit::checks::registry;
use poseaudit::finding::Status;
use poseaudit::report::Verdict;
use poseaudit::synth::POSE;

use case::{Case, Expected, Log};

/// The cases of every family.
const CASES: &[&[Case]] = &[
    frm::CASES,
    hec::CASES,
    imu::CASES,
    ing::CASES,
    lat::CASES,
    mdl::CASES,
    mot::CASES,
    ord::CASES,
    tim::CASES,
    vel::CASES,
    yaw::CASES,
    zer::CASES,
];

#[test]
fn every_rule_has_a_case_of_every_kind() {
    let cases = || CASES.iter().copied().flatten();
    for rule in registry().iter().filter(|rule| !OF_DATASETS.contains(&rule.code)) {
        let kinds: BTreeSet<&str> = cases()
            .filter(|case| case.code == rule.code)
            .map(|case| case.expected.kind())
            .collect();
        let missing: Vec<&str> =
            Expected::KINDS.into_iter().filter(|kind| !kinds.contains(kind)).collect();
        assert!(missing.is_empty(), "{} has no case: {}", rule.code, missing.join(", "));
    }
    let codes: BTreeSet<&str> = registry().iter().map(|rule| rule.code).collect();
    for case in cases() {
        assert!(codes.contains(case.code), "{} is not a rule: {}", case.code, case.name);
    }
}

/// Rules whose input is not in every log, and not in the sound one.
const WITHOUT_INPUT: &[&str] =
    &["FRM006", "LAT004", "META001", "META002", "MOT004", "ORD006", "ORD007"];

/// Rules about tables, with cases in `tests/tables.rs`.
const OF_DATASETS: &[&str] = &["META001", "META002"];

#[test]
fn a_fault_free_log_passes_every_rule_on_every_subject() {
    let report = Log::modified(hec::add_camera).report();
    assert_eq!(report.verdict, Verdict::Pass);
    assert!(report.findings.is_empty(), "{:#?}", report.findings);
    let asked: BTreeSet<&str> = report.checks.iter().map(|row| row.code).collect();
    assert_eq!(asked.len(), registry().len());
    for row in &report.checks {
        let is_too_slow = (row.code, row.subject.label()) == ("MOT001", POSE);
        let has_no_input = WITHOUT_INPUT.contains(&row.code) || is_too_slow;
        let expected = if has_no_input { Status::Skipped } else { Status::Pass };
        assert_eq!(row.status, expected, "{row:#?}");
    }
}
