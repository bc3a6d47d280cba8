//! Findings: the latest log, and the one with the largest value.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::aggregate::{FindingKey, FindingLogs};
use super::trends::{EstimateSeries, TrendPoint};
use super::{FindingRow, WorstLog};

/// Paths per rule and subject, largest value first.
pub(super) fn logs_by_value(
    series: &BTreeMap<(FindingKey, String, bool), EstimateSeries>,
) -> BTreeMap<FindingKey, Vec<String>> {
    let mut points: BTreeMap<&FindingKey, Vec<&TrendPoint>> = BTreeMap::new();
    for ((cause, ..), series) in series {
        points.entry(cause).or_default().extend(&series.points);
    }
    let sorted = |(cause, mut points): (&FindingKey, Vec<&TrendPoint>)| {
        points.sort_by(|a, b| b.value.abs().total_cmp(&a.value.abs()).then(a.path.cmp(&b.path)));
        (cause.clone(), points.into_iter().map(|point| point.path.clone()).collect())
    };
    points.into_iter().map(sorted).collect()
}

pub(super) fn build_finding_rows(
    found: BTreeMap<FindingKey, FindingLogs>,
    passed: &BTreeMap<FindingKey, usize>,
    worst: &BTreeMap<FindingKey, Vec<String>>,
) -> Vec<FindingRow> {
    let rows = found.into_iter().filter_map(|(cause, found)| {
        let ((start_ns, _, path), (title, message)) = found.logs.last_key_value()?;
        let of = |wanted: &String| {
            let (_, (_, message)) = found.logs.iter().find(|((.., path), _)| path == wanted)?;
            Some(WorstLog { message: message.clone(), path: wanted.clone() })
        };
        let worst = worst.get(&cause).into_iter().flatten().find_map(of);
        Some(FindingRow {
            worst: worst.filter(|worst| worst.path != *path),
            severity: found.severity,
            logs: found.logs.len(),
            passed: passed.get(&cause).copied().unwrap_or_default(),
            message: message.clone(),
            paths: found.logs.keys().map(|(.., path)| path.clone()).collect(),
            path: path.clone(),
            start_ns: start_ns.map(|start_ns| start_ns.to_string()),
            title: title.clone(),
            code: cause.0,
            subject: cause.1,
        })
    });
    let mut rows: Vec<FindingRow> = rows.collect();
    rows.sort_by_key(|row| Reverse((row.severity, row.logs)));
    rows
}
