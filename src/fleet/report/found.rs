//! Findings: the latest log, and the one with the largest value.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::gather::{Cause, Found};
use super::trends::{Point, Series};
use super::{FindingRow, Worst};

/// Paths per rule and subject, largest value first.
pub(super) fn worst_logs(
    series: &BTreeMap<(Cause, String, bool), Series>,
) -> BTreeMap<Cause, Vec<String>> {
    let mut points: BTreeMap<&Cause, Vec<&Point>> = BTreeMap::new();
    for ((cause, ..), series) in series {
        points.entry(cause).or_default().extend(&series.points);
    }
    let sorted = |(cause, mut points): (&Cause, Vec<&Point>)| {
        points.sort_by(|a, b| b.value.abs().total_cmp(&a.value.abs()).then(a.path.cmp(&b.path)));
        (cause.clone(), points.into_iter().map(|point| point.path.clone()).collect())
    };
    points.into_iter().map(sorted).collect()
}

pub(super) fn finding_rows(
    found: BTreeMap<Cause, Found>,
    asked: &BTreeMap<Cause, usize>,
    worst: &BTreeMap<Cause, Vec<String>>,
) -> Vec<FindingRow> {
    let rows = found.into_iter().filter_map(|(cause, found)| {
        let ((start_ns, _, path), (title, message)) = found.logs.last_key_value()?;
        let of = |wanted: &String| {
            let (_, (_, message)) = found.logs.iter().find(|((.., path), _)| path == wanted)?;
            Some(Worst { message: message.clone(), path: wanted.clone() })
        };
        let worst = worst.get(&cause).into_iter().flatten().find_map(of);
        Some(FindingRow {
            worst: worst.filter(|worst| worst.path != *path),
            severity: found.severity,
            logs: found.logs.len(),
            sound: asked.get(&cause).copied().unwrap_or_default(),
            message: message.clone(),
            path: path.clone(),
            start_ns: start_ns.map(|start_ns| start_ns.to_string()),
            title: title.clone(),
            code: cause.0,
            whose: cause.1,
        })
    });
    let mut rows: Vec<FindingRow> = rows.collect();
    rows.sort_by_key(|row| Reverse((row.severity, row.logs)));
    rows
}
