//! Merges the evaluations of several segments of one run.

use std::collections::{HashMap, HashSet};

use serde_json::{Value, json};

use super::{Evaluation, rank};
use crate::finding::{CheckRow, Status, Subject};

/// Evaluation of one segment.
#[derive(Clone, Debug)]
pub struct SegmentEvaluation {
    /// The evaluation.
    pub evaluation: Evaluation,
    /// Too short for its inconclusive checks to count.
    pub is_short: bool,
}

/// Merges evaluations of segments in order of time.
///
/// Keeps the most severe status per rule and subject, and all findings with their segment number. Findings
/// about files are kept once. Observability is that of segment `main`.
pub fn merge_segments(parts: Vec<SegmentEvaluation>, main: usize) -> Evaluation {
    let count = parts.len();
    let mut whole = Evaluation::default();
    let mut ranks: Vec<u8> = Vec::new();
    let mut places: HashMap<(&str, Subject), usize> = HashMap::new();
    for (index, SegmentEvaluation { evaluation, is_short }) in parts.into_iter().enumerate() {
        let is_reported = |code: &str| index > 0 && is_rule_on_files(code);
        for mut row in evaluation.checks.into_iter().filter(|row| !is_reported(row.code)) {
            let rank = status_rank(&row, is_short);
            if row.status != Status::Skipped
                && let Some(reason) = &mut row.reason
            {
                *reason = format!("in segment {} of {count}: {reason}", index + 1);
            }
            let place = places.entry((row.code, row.subject.clone()));
            let place = *place.or_insert(ranks.len());
            if place == ranks.len() {
                whole.checks.push(row);
                ranks.push(rank);
            } else if rank > ranks[place] {
                (whole.checks[place], ranks[place]) = (row, rank);
            }
        }
        for mut finding in evaluation.findings.into_iter().filter(|found| !is_reported(found.code))
        {
            if !is_rule_on_files(finding.code) {
                finding.message += &format!(", in segment {} of {count}", index + 1);
                finding.segment = Some(index);
                let segment: Value = json!({ "number": index + 1, "of": count });
                finding.evidence.more.insert("segment".to_owned(), segment);
            }
            whole.findings.push(finding);
        }
        whole.ignored.extend(evaluation.ignored.into_iter().map(|mut known| {
            known.finding.message += &format!(", in segment {} of {count}", index + 1);
            known
        }));
        if index == main {
            whole.observability = evaluation.observability;
        }
    }
    drop_undecided_short_segments(&mut whole.checks, &ranks);
    drop_skipped_if_evaluated(&mut whole.checks);
    whole.checks.sort_by_key(|row| row.code);
    rank(&mut whole.findings);
    whole
}

/// Rules on files are independent of segments.
fn is_rule_on_files(code: &str) -> bool {
    // Unusable samples are counted in each segment.
    (code.starts_with("ING") && code != "ING003") || code.starts_with("META")
}

/// The highest rank of a rule and subject is kept. Inconclusive in a short segment ranks below a pass.
fn status_rank(row: &CheckRow, is_short: bool) -> u8 {
    match row.status {
        Status::Fail => 4,
        Status::Inconclusive if !is_short => 3,
        Status::Pass => 2,
        Status::Inconclusive => 1,
        Status::Skipped => 0,
    }
}

/// Drops whole-arm rows that only short segments leave inconclusive if another segment decides the rule.
fn drop_undecided_short_segments(rows: &mut Vec<CheckRow>, ranks: &[u8]) {
    let decided: HashSet<&str> =
        rows.iter().zip(ranks).filter(|(_, rank)| **rank > 1).map(|(row, _)| row.code).collect();
    let mut ranks = ranks.iter();
    rows.retain(|row| {
        let is_open = ranks.next() == Some(&1);
        let is_of_arm = row.subject.topic.is_none() && row.subject.joint.is_none();
        !(is_open && is_of_arm && decided.contains(row.code))
    });
}

/// Drops the skipped row without a subject if another segment had a subject.
fn drop_skipped_if_evaluated(rows: &mut Vec<CheckRow>) {
    let evaluated: HashSet<&str> =
        rows.iter().filter(|row| row.status != Status::Skipped).map(|row| row.code).collect();
    let is_skipped =
        |row: &CheckRow| row.status == Status::Skipped && row.subject == Default::default();
    rows.retain(|row| !(is_skipped(row) && evaluated.contains(row.code)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, precise};
    use crate::checks::{Settings, evaluate};
    use crate::diagnosis::NotObservable;

    fn part(latency: Result<f64, NotObservable>, is_short: bool) -> SegmentEvaluation {
        let mut run = clean_run();
        run.robots[0].poses[0].diagnosis.latency_s = latency.map(precise);
        SegmentEvaluation { evaluation: evaluate(&run, &Settings::default()), is_short }
    }

    fn latency(parts: Vec<SegmentEvaluation>) -> (Vec<Status>, usize) {
        let whole = merge_segments(parts, 0);
        let rows = whole.checks.iter().filter(|row| row.code == "LAT001");
        let of_pose = rows.filter(|row| row.subject.label() == crate::checks::testing::POSE);
        (of_pose.map(|row| row.status).collect(), whole.findings.len())
    }

    #[test]
    fn the_worst_outcome_wins_and_a_short_segment_is_ignored() {
        let at_rest = || Err(NotObservable::AtRest);
        assert_eq!(
            latency(vec![part(Ok(0.0), false), part(Ok(0.0), false)]),
            (vec![Status::Pass], 0)
        );
        assert_eq!(
            latency(vec![part(Ok(0.0), false), part(at_rest(), true)]),
            (vec![Status::Pass], 0)
        );
        let open = latency(vec![part(Ok(0.0), false), part(at_rest(), false)]);
        assert_eq!(open, (vec![Status::Inconclusive], 0));
        let late = latency(vec![part(at_rest(), false), part(Ok(0.02), true)]);
        assert_eq!(late, (vec![Status::Fail], 1));
    }

    #[test]
    fn a_finding_names_its_segment() {
        let whole = merge_segments(vec![part(Ok(0.0), false), part(Ok(0.02), false)], 0);
        assert!(whole.findings[0].message.ends_with(", in segment 2 of 2"));
        assert_eq!(whole.findings[0].evidence.more["segment"]["number"], 2);
    }
}
