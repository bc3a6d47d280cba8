use serde_json::{Value, json};

use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::StreamEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::run::FrozenSpan;

rule! {
    /// A stream is frozen while the arm moves.
    ///
    /// ## What it means
    /// For at least 0.25 s and ten samples, a pose stream repeats one pose bit for bit with new stamps,
    /// although the arm moves. The check allows for latency. At no latency within the search range do the
    /// joints rest for half of that time, or at no latency consistent with its speeds do they rest
    /// throughout. Joint states, or some joints, are frozen if they stay constant within their noise for that long and
    /// then jump amid a motion, or stay constant to the end of the log while all pose streams that followed the arm
    /// in its base frame move on.
    ///
    /// ## Why it matters
    /// Rate and stamps are normal, so consumers take an old pose for the current one. The error is as large
    /// as the motion in the meantime.
    ///
    /// ## Evidence
    /// `times` lists each interval with its samples, the minimum motion of a joint in it, and the frozen `joints`
    /// (empty if all are). `count` is their number. The estimate is the longest, in seconds. All other rules ignore
    /// these samples.
    ///
    /// ## How to fix
    /// Find the source that stopped while another node repeated its last value: a driver that lost its
    /// connection, a tracker that lost its target, a filter that holds. Then publish nothing, or mark the
    /// value as stale.
    ///
    /// ## When it misleads
    /// - A source slower than 4 Hz in a fast stream looks the same; its stamps are then the fault.
    /// - A stream frozen until the end of the log may also be late and is not reported. The same applies
    ///   close to a rest of the arm, unless the stream's speeds determine its latency.
    /// - One joint that does not move right after its jump may have rested while its zero changed (ZER001).
    /// - If three or more joints jump together and some moved until then, those at rest are not frozen (MOT003).
    /// - FRM001 checks transforms that do not move with the joints.
    /// - Without such a stream, joint states frozen until the end are indistinguishable from an arm at rest.
    /// - Long runs are checked in excerpts; `samples` counts those checked.
    TIM007 {
        name: "frozen-stream",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states, and no tool pose that can be compared with an arm",
        check: check,
    }
}

/// In the evidence.
const MAX_LISTED: usize = 10;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.frozen_intervals.iter().map(|stream| judge(case, stream)).collect()
}

fn seconds(time: &FrozenSpan) -> f64 {
    time.end.seconds_since(time.start)
}

fn judge(case: &Case, stream: &StreamEvidence<Vec<FrozenSpan>>) -> SubjectResult {
    let longest = stream.iter().max_by(|a, b| seconds(a).total_cmp(&seconds(b)));
    let Some(longest) = longest else {
        return stream.judged(Outcome::pass());
    };
    let others = match stream.len() {
        1 => String::new(),
        2 => ", and once more".to_owned(),
        times => format!(", and {} more times", times - 1),
    };
    let mut joints: Vec<&str> = Vec::new();
    for joint in stream.iter().flat_map(|span| &span.joints) {
        if !joints.contains(&joint.as_str()) {
            joints.push(joint);
        }
    }
    let is_of_joints = stream.iter().all(|span| !span.joints.is_empty());
    let (title, source) = match joints.as_slice() {
        _ if !is_of_joints => {
            ("stream frozen while the arm moves", format!("source of {}", stream.subject.label()))
        }
        [joint] => (
            "a joint is frozen while it moves",
            format!("reading of {joint} in {}", stream.topic()),
        ),
        joints => (
            "joints are frozen while they move",
            format!("reading of {} in {}", joints.join(", "), stream.topic()),
        ),
    };
    let outcome = Outcome::fail(Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Error,
        title,
        message: format!(
            "frozen for {} (from {}) while the arm moved{others}; excluded from all other checks",
            Unit::Second.show(seconds(longest)),
            case.evidence.moment(longest.start),
        ),
        evidence: Evidence::default(),
        fix: format!("check why the {source} stopped then, and what repeated its last value"),
    });
    let times = stream.iter().take(MAX_LISTED).map(|time| {
        json!({
            "start_ns": time.start.to_string(),
            "end_ns": time.end.to_string(),
            "samples": time.samples,
            "moved": time.joint_motion,
            "joints": time.joints,
        })
    });
    stream
        .judged(outcome)
        .estimated(Estimate::exact("stands still", Unit::Second.symbol(), seconds(longest)))
        .with_evidence("count", stream.len())
        .with_evidence("times", times.collect::<Vec<Value>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};

    #[test]
    fn joints_that_are_frozen_together_are_named_once() {
        let mut run = clean_run();
        let span = FrozenSpan {
            stream: 0,
            joints: vec!["elbow".to_owned(), "wrist".to_owned()],
            start: run.origin.shifted(1.0),
            end: run.origin.shifted(2.5),
            samples: 150,
            is_whole_stream: false,
            joint_motion: Some(0.3),
        };
        run.frozen_intervals[0].value = vec![span];
        let (_, findings) = evaluate_rule(&TIM007, &run);
        assert_eq!(findings[0].title, "joints are frozen while they move");
        assert!(findings[0].fix.contains("elbow, wrist"), "{findings:?}");
        assert!(!findings[0].message.contains("once more"), "{findings:?}");
    }
}
