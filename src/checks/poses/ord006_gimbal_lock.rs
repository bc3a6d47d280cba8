use serde_json::{Value, json};

use crate::checks::decision::DEGREE;
use crate::checks::encoding::declaration;
use crate::checks::{Case, Grade, Limit, SubjectResult};
use crate::evidence::{ArmEvidence, EulerEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Span, Unit};
use crate::geometry::RotationEncoding;

rule! {
    /// Euler angles are near gimbal lock.
    ///
    /// ## What it means
    /// The middle Euler angle comes within 5° of a value that aligns the outer two axes: ±90° for three
    /// different axes (rpy), 0° and 180° if the first and third axis are the same (ZYZ).
    ///
    /// ## Why it matters
    /// There, only the sum or difference of the outer angles is determined. They jump while the tool barely
    /// moves; interpolating, filtering, differentiating or averaging them creates false motion.
    ///
    /// A stay of half a second or more is a warning, a shorter passage is `info`.
    ///
    /// ## Evidence
    /// - `convention`: of the numbers.
    /// - `spans`: times near the lock, with the distance from it; `count`: their number.
    /// - `nearest_rad`: smallest distance.
    /// - The value is the fraction of samples near the lock.
    ///
    /// ## How to fix
    /// Log and exchange quaternions; use Euler angles only for display, or choose an order whose lock is
    /// outside the workspace.
    ///
    /// ## When it misleads
    /// The rotations themselves are right. The rule covers only bare numbers, not quaternions converted from
    /// Euler angles. Near gimbal lock it is inconclusive if the convention is inferred instead of declared.
    ORD006 {
        limits: &[MAX_GIMBAL_MARGIN],
        name: "gimbal-lock",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "gimbal lock: no stream uses Euler angles",
        check: check,
    }
}

const MAX_GIMBAL_MARGIN: Limit = Limit {
    key: "near",
    unit: Unit::Radian,
    value: 5.0 * DEGREE,
    what: "how close to gimbal lock counts as near",
};
/// Shorter spans are passages: at 20°/s, slow for a wrist, the arm crosses the 10° around the lock in this time. Closer
/// spans are merged, s.
const MIN_STAY_S: f64 = 0.5;
/// Spans in the evidence.
const MAX_LISTED: usize = 10;

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        let numbers = arm.poses.iter().filter_map(|stream| {
            let euler = stream.euler.as_ref()?;
            let judged = judge(case, arm, stream, euler);
            Some(judged.within(stream.span))
        });
        numbers.collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

#[derive(Debug, PartialEq)]
struct NearSingularity {
    span: Span,
    samples: usize,
    nearest_rad: f64,
}

fn near_singularities(euler: &EulerEvidence, within_rad: f64) -> Vec<NearSingularity> {
    let mut found: Vec<NearSingularity> = Vec::new();
    let mut last_row = None;
    let rows = euler.margins_rad.iter().enumerate();
    for (row, &(at, margin_rad)) in rows.filter(|(_, (_, margin))| *margin < within_rad) {
        // At a low rate, consecutive samples are further apart than the shortest stay.
        let is_next = last_row.replace(row).is_some_and(|last| last + 1 == row);
        let is_same =
            |last: &&mut NearSingularity| is_next || at.seconds_since(last.span.end) < MIN_STAY_S;
        match found.last_mut().filter(is_same) {
            Some(last) => {
                (last.span.end, last.samples) = (at, last.samples + 1);
                last.nearest_rad = last.nearest_rad.min(margin_rad);
            }
            None => found.push(NearSingularity {
                span: Span { start: at, end: at },
                samples: 1,
                nearest_rad: margin_rad,
            }),
        }
    }
    found
}

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    euler: &EulerEvidence,
) -> SubjectResult {
    let topic = stream.topic();
    let subject = arm.topic(topic);
    let Some(convention) = euler.convention else {
        let why = "its convention is undetermined; declare it with --declare";
        return SubjectResult::new(subject, Outcome::Inconclusive(why.to_owned()));
    };
    if euler.margins_rad.is_empty() {
        let why = format!("{convention} has no gimbal lock");
        return SubjectResult::new(subject, Outcome::pass_with_remark(why));
    }
    let within_rad = case.thresholds.limit(&ORD006, &MAX_GIMBAL_MARGIN);
    let found = near_singularities(euler, within_rad);
    let samples: usize = found.iter().map(|singularity| singularity.samples).sum();
    let share = samples as f64 / euler.margins_rad.len() as f64;
    let min_rad = euler.margins_rad.iter().map(|(_, margin)| *margin).fold(f64::INFINITY, f64::min);
    let longest = found.iter().max_by(|a, b| a.span.seconds().total_cmp(&b.span.seconds()));
    let nearest = found.iter().min_by(|a, b| a.nearest_rad.total_cmp(&b.nearest_rad));
    let (limit, percent) = (Unit::Radian.show(within_rad), 100.0 * share);
    let fault = |severity, message: String| Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity,
        title: "Euler angles near gimbal lock",
        message,
        evidence: Evidence::default(),
        fix: format!("log {topic} as quaternions"),
    };
    let outcome = match longest.zip(nearest) {
        None => Outcome::pass(),
        Some((longest, nearest)) if longest.span.seconds() < MIN_STAY_S => {
            let times = match found.len() {
                1 => "once".to_owned(),
                times => format!("{times} times"),
            };
            let message = format!(
                "{convention} passes within {limit} of gimbal lock {times}, for less than {}; closest {} from it, in the \
                 passage at {}",
                Unit::Second.show(MIN_STAY_S),
                Unit::Radian.show(min_rad),
                case.evidence.moment(nearest.span.start),
            );
            match stream.is_undeclared {
                true => Outcome::pass_with_remark(message),
                false => Outcome::fail(fault(Severity::Info, message)),
            }
        }
        // Numbers without a declared convention violate none.
        Some(_) if stream.is_undeclared => {
            let form = RotationEncoding::Three(convention);
            Outcome::Inconclusive(format!(
                "not checked: its convention is not declared, and as {convention} {percent:.1} % of the samples \
                 are within {limit} of gimbal lock; declare it with {}",
                declaration(topic, form, &stream.diagnosis)
            ))
        }
        Some((longest, _)) => {
            let message = format!(
                "{convention} is within {limit} of gimbal lock in {percent:.1} % of the samples, longest for \
                 {} from {} on; the nearest sample is at {}",
                Unit::Second.show(longest.span.seconds()),
                case.evidence.moment(longest.span.start),
                Unit::Radian.show(min_rad),
            );
            Outcome::fail(fault(Severity::Warning, message))
        }
    };
    let spans: Vec<Value> = found
        .iter()
        .take(MAX_LISTED)
        .map(|NearSingularity { span, nearest_rad, .. }| {
            json!({
                "start_ns": span.start.to_string(),
                "end_ns": span.end.to_string(),
                "nearest_rad": nearest_rad,
            })
        })
        .collect();
    SubjectResult::new(subject, outcome)
        .estimated(Estimate::exact("share near gimbal lock", Unit::One.symbol(), share))
        .with_evidence("convention", convention.to_string())
        .with_evidence("nearest_rad", min_rad)
        .with_evidence("count", found.len())
        .with_evidence("spans", spans)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{POSE, clean_run, evaluate_rule};
    use crate::finding::{CheckRow, Finding, Status};
    use crate::geometry::Convention;
    use crate::time::Stamp;

    #[test]
    fn samples_near_gimbal_lock_are_grouped_into_spans() {
        let at = |tenth: i64| Stamp::from_nanos(tenth * 100_000_000);
        let margin = |tenth: i64| match tenth {
            10..=12 | 15 => 0.02,
            40 => 0.01,
            _ => 0.3,
        };
        let euler = EulerEvidence {
            convention: Some(Convention::RPY),
            margins_rad: (0..60).map(|tenth| (at(tenth), margin(tenth))).collect(),
        };
        let found = near_singularities(&euler, MAX_GIMBAL_MARGIN.value);
        let first = Span { start: at(10), end: at(15) };
        assert_eq!(found[0], NearSingularity { span: first, samples: 4, nearest_rad: 0.02 });
        assert_eq!((found.len(), found[1].nearest_rad), (2, 0.01));
    }

    #[test]
    fn consecutive_samples_are_one_stay_at_any_rate() {
        let at = |second: i64| Stamp::from_nanos(second * 1_000_000_000);
        let margin = |second: i64| if [20, 22].contains(&second) { 0.3 } else { 0.01 };
        let euler = EulerEvidence {
            convention: Some(Convention::RPY),
            margins_rad: (0..60).map(|second| (at(second), margin(second))).collect(),
        };
        let found = near_singularities(&euler, MAX_GIMBAL_MARGIN.value);
        let samples: Vec<usize> = found.iter().map(|stay| stay.samples).collect();
        assert_eq!(samples, [20, 1, 37]);
        assert_eq!(found[0].span, Span { start: at(0), end: at(19) });
    }

    /// Of a stream that is at the lock during `near`, tenths of a second.
    fn judged(near: std::ops::Range<i64>, is_undeclared: bool) -> (CheckRow, Vec<Finding>) {
        let mut run = clean_run();
        run.start = Some(Stamp::from_nanos(0));
        let pose = &mut run.robots[0].poses[0];
        pose.is_undeclared = is_undeclared;
        let margin = |tenth: i64| if near.contains(&tenth) { 0.07 } else { 0.3 };
        let margins =
            (0..400).map(|tenth| (Stamp::from_nanos(tenth * 100_000_000), margin(tenth))).collect();
        pose.euler =
            Some(EulerEvidence { convention: Some(Convention::RPY), margins_rad: margins });
        let (mut rows, findings) = evaluate_rule(&ORD006, &run);
        let at = rows.iter().position(|row| row.subject.topic.as_deref() == Some(POSE));
        (rows.swap_remove(at.expect("a row")), findings)
    }

    #[test]
    fn a_passage_is_no_stay() {
        let (_, findings) = judged(100..101, false);
        let [passage] = findings.as_slice() else { panic!("{findings:?}") };
        assert_eq!(passage.severity, Severity::Info);
        assert_eq!(
            passage.message,
            "euler:xyz passes within 5° of gimbal lock once, for less than 500 ms; closest 4.01° from it, in the \
             passage at +10.00 s"
        );
        let (_, findings) = judged(100..107, false);
        let [stay] = findings.as_slice() else { panic!("{findings:?}") };
        assert_eq!(stay.severity, Severity::Warning);
        assert!(stay.message.contains("longest for 600 ms from +10.00 s on"), "{}", stay.message);
    }

    #[test]
    fn only_a_stay_leaves_an_undeclared_convention_open() {
        let (row, findings) = judged(100..101, true);
        assert_eq!((row.status, findings.len()), (Status::Pass, 0));
        let (row, findings) = judged(100..107, true);
        assert_eq!((row.status, findings.len()), (Status::Inconclusive, 0));
        let reason = row.reason.unwrap_or_default();
        assert!(reason.ends_with("declare it with --declare /pose=euler:xyz"), "{reason}");
    }
}
