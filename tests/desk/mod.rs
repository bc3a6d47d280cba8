//! Pairs of poses in two conventions, computed by other programs: `riddles.csv`, from `make.py`.

use poseaudit::desk::{
    FrameCandidates, FrameNames, KnownEncoding, Pair, ReconcileInput, ReconcileVerdict,
    Reconciliation, parse_pose, reconcile,
};
use serde::Deserialize;

/// A pair of poses, and the expected answer.
#[derive(Debug, Deserialize)]
struct Row {
    riddle: String,
    /// Interpretation of B.
    read: String,
    /// Expected claim; empty if there is none.
    claim: String,
    /// Minimum number of pairs to reconcile them.
    pairs: usize,
    is: String,
    but: String,
}

fn reconcile_pairs(rows: &[Row]) -> Reconciliation {
    let pasted = |text: &str| parse_pose(text).expect("a pose");
    let pair = |row: &Row| Pair { pose_a: pasted(&row.is), pose_b: pasted(&row.but) };
    let names = FrameNames::default();
    let question = ReconcileInput {
        pairs: rows.iter().map(pair).collect(),
        encoding_a: KnownEncoding::default(),
        encoding_b: KnownEncoding::default(),
        frames: FrameCandidates::from_robot(None, &names, &names),
    };
    reconcile(&question).expect("poses")
}

/// Describes what is wrong with the answer for the first `count` pairs.
fn describe_mismatch(rows: &[Row], count: usize) -> Option<String> {
    let row = &rows[0];
    let answer = reconcile_pairs(&rows[..count]);
    let best = &answer.hypotheses[0];
    let claims = best.claims();
    let is_claimed = match row.claim.as_str() {
        "" => claims.is_empty() || row.riddle.starts_with("Eigen"),
        claim => claims.iter().chain(&best.also).any(|text| text.contains(claim)),
    };
    let is_reconciled =
        answer.verdict == ReconcileVerdict::Reconciled && best.encoding_b.to_string() == row.read;
    (!is_reconciled || !is_claimed).then(|| {
        format!(
            "{} from {count}: {:?}, {}, {claims:?}",
            row.riddle, answer.verdict, best.encoding_b
        )
    })
}

#[test]
fn pose_pairs_of_other_programs_are_reconciled_and_named() {
    let mut reader = csv::Reader::from_reader(include_str!("riddles.csv").as_bytes());
    let rows: Vec<Row> = reader.deserialize().collect::<Result<_, _>>().expect("the table");
    let wrong: Vec<String> = rows
        .chunk_by(|a, b| a.riddle == b.riddle)
        .flat_map(|riddle| {
            let all = riddle.len();
            let first = riddle[0].pairs;
            [first, all]
                .into_iter()
                .filter_map(|count| describe_mismatch(riddle, count))
                .collect::<Vec<_>>()
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn one_pair_determines_neither_tool_nor_base() {
    let mut reader = csv::Reader::from_reader(include_str!("riddles.csv").as_bytes());
    let rows: Vec<Row> = reader.deserialize().collect::<Result<_, _>>().expect("the table");
    for riddle in rows.chunk_by(|a, b| a.riddle == b.riddle).filter(|riddle| riddle[0].pairs > 1) {
        let answer = reconcile_pairs(&riddle[..1]);
        assert_eq!(answer.verdict, ReconcileVerdict::Unexplained, "{}", riddle[0].riddle);
        assert!(answer.single_pair_offsets.is_some(), "{}", riddle[0].riddle);
    }
}
