use serde_json::{Value, json};

use crate::checks::decision::DEGREE;
use crate::checks::{Case, Grade, Judged, Limit};
use crate::evidence::{ArmEvidence, EulerEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Span, Unit};

rule! {
    /// An Euler-coded stream works near gimbal lock.
    ///
    /// ## What it means
    /// The rotations of a stream are three turns about axes, and the middle one comes within 5° of
    /// where the outer two turn about the same axis: ±90° where three axes take part (rpy), 0° and
    /// 180° where the first is the third (ZYZ).
    ///
    /// ## Why it matters
    /// There only the sum of the outer turns is told: the numbers jump while the tool hardly moves,
    /// and whoever interpolates, filters, differentiates or averages them invents motion.
    ///
    /// ## Evidence
    /// `convention` is what the numbers are; `spans` lists when they are near the lock, with how
    /// near, and `count` says how many such spans there are; `nearest_rad` is the least distance.
    /// The estimate is the share of the stream's samples that is near.
    ///
    /// ## How to fix
    /// Log and pass on quaternions, and make Euler angles only for people to read. Where angles must
    /// be, choose an order whose lock lies outside the work.
    ///
    /// ## When it misleads
    /// Nothing is wrong with the rotations themselves, which the audit reads right. Only bare
    /// numbers are looked at whose convention was declared or told from the arm: whether a
    /// quaternion was Euler angles before, the log does not say.
    ORD006 {
        limits: &[NEAR],
        name: "gimbal-lock",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "gimbal lock: no stream is coded in Euler angles",
        check: check,
    }
}

/// So near the lock is near.
const NEAR: Limit = Limit {
    key: "near",
    unit: Unit::Radian,
    value: 5.0 * DEGREE,
    what: "so close to gimbal lock is near",
};
/// Spans that are less than this apart are one, s.
const APART_S: f64 = 0.5;
/// Spans that the evidence lists.
const LISTED: usize = 10;

fn check(case: &Case) -> Vec<Judged> {
    let of_arm = |arm: &ArmEvidence| -> Vec<Judged> {
        let numbers = arm.poses.iter().filter_map(|stream| {
            let coded = stream.euler.as_ref()?;
            let judged = match stream.bare {
                true => Judged::new(
                    stream.subject.clone(),
                    Outcome::sound_because("nobody declared how it is coded".to_owned()),
                ),
                false => judge(case, arm, stream.topic(), coded),
            };
            Some(judged.within(stream.span))
        });
        numbers.collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

/// A time near the lock.
#[derive(Debug, PartialEq)]
struct Near {
    span: Span,
    samples: usize,
    nearest_rad: f64,
}

fn near(coded: &EulerEvidence, within_rad: f64) -> Vec<Near> {
    let mut found: Vec<Near> = Vec::new();
    for &(at, margin_rad) in coded.margins_rad.iter().filter(|(_, margin)| *margin < within_rad) {
        match found.last_mut().filter(|last| at.seconds_since(last.span.end) < APART_S) {
            Some(last) => {
                (last.span.end, last.samples) = (at, last.samples + 1);
                last.nearest_rad = last.nearest_rad.min(margin_rad);
            }
            None => found.push(Near {
                span: Span { start: at, end: at },
                samples: 1,
                nearest_rad: margin_rad,
            }),
        }
    }
    found
}

fn judge(case: &Case, arm: &ArmEvidence, topic: &str, coded: &EulerEvidence) -> Judged {
    let subject = arm.topic(topic);
    let Some(convention) = coded.convention else {
        let why = "which convention its numbers are is not told; declare it with --declare";
        return Judged::new(subject, Outcome::Inconclusive(why.to_owned()));
    };
    if coded.margins_rad.is_empty() {
        let why = format!("{convention} has no gimbal lock");
        return Judged::new(subject, Outcome::sound_because(why));
    }
    let within_rad = case.thresholds.limit(&ORD006, &NEAR);
    let found = near(coded, within_rad);
    let samples: usize = found.iter().map(|near| near.samples).sum();
    let share = samples as f64 / coded.margins_rad.len() as f64;
    let least_rad =
        coded.margins_rad.iter().map(|(_, margin)| *margin).fold(f64::INFINITY, f64::min);
    let longest = found.iter().max_by(|a, b| a.span.seconds().total_cmp(&b.span.seconds()));
    let outcome = match longest {
        None => Outcome::sound(),
        Some(longest) => Outcome::faulty(Fault {
            cause: Cause::Seen(Sight::Stream),
            severity: Severity::Warning,
            title: "Euler angles near gimbal lock",
            message: format!(
                "{convention} is within {} of gimbal lock in {:.1} % of the samples, longest for \
                 {} from {} on, {} at the nearest",
                Unit::Radian.show(within_rad),
                100.0 * share,
                Unit::Second.show(longest.span.seconds()),
                case.evidence.moment(longest.span.start),
                Unit::Radian.show(least_rad),
            ),
            evidence: Evidence::default(),
            fix: format!("log {topic} as quaternions"),
        }),
    };
    let spans: Vec<Value> = found
        .iter()
        .take(LISTED)
        .map(|Near { span, nearest_rad, .. }| {
            json!({
                "start_ns": span.start.to_string(),
                "end_ns": span.end.to_string(),
                "nearest_rad": nearest_rad,
            })
        })
        .collect();
    Judged::new(subject, outcome)
        .estimated(Estimate::counted("share near gimbal lock", Unit::One.symbol(), share))
        .with_evidence("convention", convention.to_string())
        .with_evidence("nearest_rad", least_rad)
        .with_evidence("count", found.len())
        .with_evidence("spans", spans)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Convention;
    use crate::time::Stamp;

    #[test]
    fn samples_near_the_lock_are_gathered_into_spans() {
        let at = |tenth: i64| Stamp::from_nanos(tenth * 100_000_000);
        let margin = |tenth: i64| match tenth {
            10..=12 | 15 => 0.02,
            40 => 0.01,
            _ => 0.3,
        };
        let coded = EulerEvidence {
            convention: Some(Convention::RPY),
            margins_rad: (0..60).map(|tenth| (at(tenth), margin(tenth))).collect(),
        };
        let found = near(&coded, NEAR.value);
        let first = Span { start: at(10), end: at(15) };
        assert_eq!(found[0], Near { span: first, samples: 4, nearest_rad: 0.02 });
        assert_eq!((found.len(), found[1].nearest_rad), (2, 0.01));
    }
}
