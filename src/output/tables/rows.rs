//! Report content as data frames.

use polars::prelude::{Column, DataFrame, PolarsResult};
use serde::Serialize;

use crate::finding::{Amount, CheckRow, Estimate, Finding, Subject};
use crate::report::WorkspaceRow;
use crate::time::Stamp;

/// Findings in the order of the report.
///
/// # Errors
/// Does not fail for a valid report.
pub fn findings_frame(findings: &[Finding]) -> PolarsResult<DataFrame> {
    let text = |name: &str, of: &dyn Fn(&Finding) -> String| {
        Column::new(name.into(), findings.iter().map(of).collect::<Vec<_>>())
    };
    let mut columns = vec![
        text("code", &|finding| finding.code.to_owned()),
        text("severity", &|finding| finding.severity.name().to_owned()),
        text("title", &|finding| finding.title.to_owned()),
        text("message", &|finding| finding.message.clone()),
    ];
    columns.extend(subject_columns(findings.iter().map(|finding| &finding.subject)));
    columns.extend(estimate_columns(findings.iter().map(|finding| finding.estimate.as_ref())));
    columns.push(text("fix", &|finding| finding.fix.clone()));
    columns.push(text("evidence_json", &|finding| as_json(&finding.evidence)));
    let stamp = |name: &str, of: &dyn Fn(&Finding) -> Option<Stamp>| {
        let nanos = |finding| of(finding).map(|stamp| stamp.nanos());
        Column::new(name.into(), findings.iter().map(nanos).collect::<Vec<Option<i64>>>())
    };
    columns.push(stamp("start_ns", &|finding| finding.start_ns));
    columns.push(stamp("end_ns", &|finding| finding.end_ns));
    DataFrame::new(findings.len(), columns)
}

/// Checks in the order of the report.
///
/// # Errors
/// Does not fail for a valid report.
pub fn checks_frame(checks: &[CheckRow]) -> PolarsResult<DataFrame> {
    let text = |name: &str, of: &dyn Fn(&CheckRow) -> Option<String>| {
        Column::new(name.into(), checks.iter().map(of).collect::<Vec<_>>())
    };
    let mut columns = vec![
        text("code", &|row| Some(row.code.to_owned())),
        text("name", &|row| Some(row.name.to_owned())),
        text("status", &|row| Some(row.status.name().to_owned())),
        text("reason", &|row| row.reason.clone()),
    ];
    columns.extend(subject_columns(checks.iter().map(|row| &row.subject)));
    columns.extend(estimate_columns(checks.iter().map(|row| row.estimate.as_ref())));
    columns.push(text("evidence_json", &|row| Some(as_json(&row.evidence))));
    DataFrame::new(checks.len(), columns)
}

/// Range of motion of each joint, from base to tip.
///
/// # Errors
/// Does not fail for a valid report.
pub fn joints_frame(arms: &[WorkspaceRow]) -> PolarsResult<DataFrame> {
    let rows: Vec<_> =
        arms.iter().flat_map(|arm| arm.joints.iter().map(move |joint| (arm, joint))).collect();
    let robots: Vec<&str> = rows.iter().map(|(arm, _)| arm.robot.as_str()).collect();
    let joints: Vec<&str> = rows.iter().map(|(_, joint)| joint.joint.as_str()).collect();
    let units: Vec<&str> = rows.iter().map(|(_, joint)| joint.unit).collect();
    let number = |name: &str, of: fn(&crate::report::JointCoverage) -> Option<f64>| {
        Column::new(name.into(), rows.iter().map(|(_, joint)| of(joint)).collect::<Vec<_>>())
    };
    DataFrame::new(
        rows.len(),
        vec![
            Column::new("robot".into(), robots),
            Column::new("joint".into(), joints),
            Column::new("unit".into(), units),
            number("lowest", |joint| Some(joint.lowest)),
            number("highest", |joint| Some(joint.highest)),
            number("lower_limit", |joint| joint.lower),
            number("upper_limit", |joint| joint.upper),
            number("visited", |joint| joint.visited),
        ],
    )
}

fn subject_columns<'a>(subjects: impl Iterator<Item = &'a Subject>) -> [Column; 4] {
    let subjects: Vec<&Subject> = subjects.collect();
    let part = |name: &str, of: fn(&Subject) -> &Option<String>| {
        let parts: Vec<Option<&str>> = subjects.iter().map(|one| of(one).as_deref()).collect();
        Column::new(name.into(), parts)
    };
    [
        part("robot", |subject| &subject.robot),
        part("topic", |subject| &subject.topic),
        part("joint", |subject| &subject.joint),
        part("frame", |subject| &subject.frame),
    ]
}

/// Value, interval and JSON of each estimate.
fn estimate_columns<'a>(estimates: impl Iterator<Item = Option<&'a Estimate>>) -> [Column; 5] {
    let estimates: Vec<Option<&Estimate>> = estimates.collect();
    let first =
        |estimate: &Option<&Estimate>| estimate.and_then(|it| it.amounts().first().copied());
    let amounts: Vec<Option<Amount>> = estimates.iter().map(first).collect();
    let number = |name: &str, of: fn(&Amount) -> Option<f64>| {
        let numbers = amounts.iter().map(|amount| amount.as_ref().and_then(of));
        Column::new(name.into(), numbers.collect::<Vec<Option<f64>>>())
    };
    let units: Vec<Option<&str>> = amounts.iter().map(|amount| Some((*amount)?.symbol)).collect();
    let whole: Vec<Option<String>> = estimates.iter().map(|it| it.map(as_json)).collect();
    [
        number("value", |amount| Some(amount.value)),
        Column::new("unit".into(), units),
        number("ci95_low", |amount| Some(amount.ci95?[0])),
        number("ci95_high", |amount| Some(amount.ci95?[1])),
        Column::new("estimate_json".into(), whole),
    ]
}

/// String keys and finite numbers: serialisation cannot fail.
fn as_json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}
