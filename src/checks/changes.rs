//! Findings for parameters that change during the run.

use serde_json::{Value, json};

use crate::checks::decision::{
    Decision, FrameThresholds, PASS_CONFIDENCE, Threshold, decide, decide_frame,
};
use crate::checks::frames::{pose_json, show};
use crate::checks::{Case, SubjectResult};
use crate::diagnosis::{ChangePoint, Course, EncodingSpans, FrameChange, Measured, ScalarChange};
use crate::evidence::ArmEvidence;
use crate::finding::{
    Cause, Change as Changes, Estimate, Evidence, Fault, Outcome, Ruling, Severity, Span, Subject,
    Unit,
};
use crate::geometry::Pose;
use crate::time::Stamp;

/// Result of a value that may change: its change, unless only its constant part is wrong or undecided.
pub fn judge_with_change(
    subject: Subject,
    change: Option<(Outcome, Estimate)>,
    judge_constant: impl FnOnce(Subject) -> SubjectResult,
) -> SubjectResult {
    let Some((outcome, estimate)) = change else { return judge_constant(subject) };
    if !matches!(outcome, Outcome::Evaluated(Ruling::Fail(_))) {
        let constant = judge_constant(subject.clone());
        if !matches!(constant.outcome, Outcome::Evaluated(Ruling::Pass(_))) {
            return constant;
        }
    }
    SubjectResult::new(subject, outcome).estimated(estimate)
}

struct ChangeReport {
    /// `at +14.00 s`.
    at: String,
    from: String,
    to: String,
    by: String,
    /// For example "tool frame".
    name: &'static str,
    title: &'static str,
    effect_m: f64,
    /// Where the change acts: tip or body.
    at_which: &'static str,
    /// Course of a gradual change, as text.
    course: Option<String>,
    all: Vec<Value>,
}

impl ChangeReport {
    fn fault(self, severity: Severity) -> Fault {
        let Self { at, from, to, by, name, title, effect_m, at_which, course, all } = self;
        let effect = Unit::Metre.show(effect_m);
        let (message, effect, fix) = match course {
            Some(course) => (
                format!("drifts by {by} {course}"),
                format!("{effect} at the {at_which} at the end"),
                format!("find out why the {name} drifts, or estimate it again at short intervals"),
            ),
            None => {
                let often = match all.len() {
                    1 => String::new(),
                    times => format!(" ({times} changes in total)"),
                };
                (
                    format!("changes by {by} {at}{often}: from {from} to {to}"),
                    format!("{effect} at the {at_which} from then on"),
                    format!("check what happened {at}; use a separate {name} for each segment"),
                )
            }
        };
        Fault {
            severity,
            cause: Cause::ParameterChange,
            title,
            message,
            evidence: Evidence {
                effect: Some(effect),
                effect_m: Some(effect_m),
                more: std::iter::once(("changes".to_owned(), all.into())).collect(),
                ..Evidence::default()
            },
            fix,
        }
    }
}

/// `None` if the value is within the noise.
fn show_if_significant(unit: Unit, value: f64, by: &Measured) -> Option<String> {
    /// Ratio to the standard error of the change.
    const MIN_VALUE_NOISE_RATIO: f64 = 4.0;
    let is_there =
        value.abs() > (MIN_VALUE_NOISE_RATIO * by.std_error).max(2.0 * unit.noise_floor());
    is_there.then(|| unit.show_measured(&Measured { value, ..*by }))
}

fn change_stamps<V, S>(case: &Case, change: &ChangePoint<V, S>) -> (Stamp, [Stamp; 2]) {
    let origin = case.evidence.origin;
    let at = |by_s: f64| origin.shifted(change.at_s + by_s);
    (at(0.0), [at(-change.within_s), at(change.within_s)])
}

/// `None` for a step. `rate` shows the change of some minutes.
fn gradual_course<V, S>(
    case: &Case,
    change: &ChangePoint<V, S>,
    rate: impl Fn(f64) -> String,
) -> Option<String> {
    let (_, within) = change_stamps(case, change);
    let [from, to] = within.map(|at| case.evidence.moment(at));
    match change.course {
        Course::Step => None,
        Course::Ramp => {
            let rate = rate(30.0 / change.within_s);
            Some(format!("from {from} to {to}, {rate} per minute"))
        }
        Course::Settling(tau_s) => {
            Some(format!("from {from} to {to}, settling with a time constant of {tau_s:.1} s"))
        }
    }
}

/// `None` if the frame is constant.
pub fn judge_frame_change(
    case: &Case,
    arm: &ArmEvidence,
    name: &'static str,
    changes: &[FrameChange],
    thresholds: &FrameThresholds,
) -> Option<(Outcome, Estimate)> {
    let effect_m = |change: &FrameChange| {
        change.size.translation_m.value + change.size.rotation_rad.value * arm.reach_m
    };
    let change = changes.iter().max_by(|a, b| effect_m(a).total_cmp(&effect_m(b)))?;
    let (at, within) = change_stamps(case, change);
    let estimate = Estimate::frame(name, &change.size.translation_m, &change.size.rotation_rad)
        .with_change(Changes {
            from: change.from.translation.vector.norm(),
            to: change.to.translation.vector.norm(),
            change_ns: at,
            change_ci95_ns: Some(within),
        });
    let size = |pose: &Pose| {
        let length = show_if_significant(
            Unit::Metre,
            pose.translation.vector.norm(),
            &change.size.translation_m,
        );
        let angle =
            show_if_significant(Unit::Radian, pose.rotation.angle(), &change.size.rotation_rad);
        match (length, angle) {
            (None, None) => "0".to_owned(),
            (Some(one), None) | (None, Some(one)) => one,
            (Some(length), Some(angle)) => format!("{length} and {angle}"),
        }
    };
    let listed = |change: &FrameChange| {
        json!({
            "at_ns": change_stamps(case, change).0.to_string(),
            "is_gradual": change.is_gradual(),
            "time_constant_s": change.time_constant_s(),
            "from": pose_json(&change.from),
            "to": pose_json(&change.to),
        })
    };
    let rate = |per_minute: f64| {
        let length = Unit::Metre.show_measured(&change.size.translation_m.scaled(per_minute));
        let angle = Unit::Radian.show_measured(&change.size.rotation_rad.scaled(per_minute));
        format!("{length} and {angle}")
    };
    let title = match (name, change.course) {
        ("tool frame", Course::Step) => "tool frame changes mid-run",
        ("tool frame", _) => "tool frame drifts",
        (_, Course::Step) => "reference frame changes mid-run",
        (_, _) => "reference frame drifts",
    };
    let report = ChangeReport {
        at_which: arm.arm_or_body("tip", "body"),
        course: gradual_course(case, change, rate),
        at: format!("at {}", case.evidence.moment(at)),
        from: size(&change.from),
        to: size(&change.to),
        by: show(&change.size),
        name,
        title,
        effect_m: effect_m(change),
        all: changes.iter().map(listed).collect(),
    };
    let decision = decide_frame(&change.size, thresholds, case.evidence.subjects());
    Some((outcome(decision, report), estimate))
}

pub fn judge_scalar_change(
    case: &Case,
    name: &'static str,
    [title, title_of_drift]: [&'static str; 2],
    changes: &[&ScalarChange],
    threshold: &Threshold,
    effect_m: impl Fn(&ScalarChange) -> f64,
) -> Option<(Outcome, Estimate)> {
    let change = first_of_the_largest(changes)?;
    let (at, within) = change_stamps(case, change);
    let unit = threshold.unit;
    let estimate = Estimate::scalar(name, unit, &change.size).with_change(Changes {
        from: change.from,
        to: change.to,
        change_ns: at,
        change_ci95_ns: Some(within),
    });
    let listed = |change: &ScalarChange| {
        let (at, _) = change_stamps(case, change);
        json!({
            "at_ns": at.to_string(),
            "is_gradual": change.is_gradual(),
            "time_constant_s": change.time_constant_s(),
            "from": change.from,
            "to": change.to,
        })
    };
    let rate = |per_minute: f64| unit.show_signed(&change.size.scaled(per_minute));
    let report = ChangeReport {
        at_which: "tip",
        course: gradual_course(case, change, rate),
        at: format!("at {}", case.evidence.moment(at)),
        from: show_if_significant(unit, change.from, &change.size)
            .unwrap_or_else(|| "0".to_owned()),
        to: show_if_significant(unit, change.to, &change.size).unwrap_or_else(|| "0".to_owned()),
        by: unit.show_signed(&change.size),
        name,
        title: if change.is_gradual() { title_of_drift } else { title },
        effect_m: effect_m(change),
        all: changes.iter().map(|change| listed(change)).collect(),
    };
    // The selection of the change has shown that it is not zero, so the 95 % interval suffices.
    let is_significant =
        change.size.value.abs() > threshold.unit.half_width(&change.size, PASS_CONFIDENCE);
    let decision = match threshold.severity(change.size.value.abs()) {
        Some(severity) if is_significant => Decision::Fail(severity),
        _ => decide(&change.size, threshold, case.evidence.subjects()),
    };
    Some((outcome(decision, report), estimate))
}

/// The first of the changes that are about as large as the largest: a value that returns has changed at first.
fn first_of_the_largest<'a>(changes: &[&'a ScalarChange]) -> Option<&'a ScalarChange> {
    let size = |change: &&ScalarChange| change.size.value.abs();
    let largest = changes.iter().map(size).fold(0.0, f64::max);
    let is_as_large =
        |change: &&&ScalarChange| size(change) + change.size.half_width(0.95) >= largest;
    changes.iter().filter(is_as_large).min_by(|a, b| a.at_s.total_cmp(&b.at_s)).copied()
}

fn outcome(decision: Decision, report: ChangeReport) -> Outcome {
    match decision {
        Decision::Fail(severity) => Outcome::fail(report.fault(severity)),
        Decision::Pass => {
            Outcome::pass_with_remark(format!("changes by {} {}", report.by, report.at))
        }
        Decision::Undecided(why) => {
            Outcome::Inconclusive(format!("changes by {} {}; {why}", report.by, report.at))
        }
    }
}

/// Limits an encoding finding to the part of the run in which it occurs.
pub fn limit_to_segment(case: &Case, mut judged: SubjectResult) -> SubjectResult {
    let joints_segment_s = |subject: &Subject| {
        let mut arms = case.evidence.robots.iter();
        let arm = arms.find(|arm| arm.topic(&arm.joints_topic) == *subject)?;
        arm.diagnosis.partial_encoding.as_ref().map(|(_, span_s)| *span_s)
    };
    let segment_s = |subject: &Subject, cause: &Cause| {
        if let (Cause::AngleUnit(_) | Cause::JointOrder { .. }, Some(span_s)) =
            (cause, joints_segment_s(subject))
        {
            return Some(span_s);
        }
        let mut streams = case.evidence.poses_and_tf();
        let topic = subject.topic.as_deref()?;
        let (_, stream) = streams.find(|(arm, stream)| {
            stream.topic() == topic && subject.arm().is_none_or(|name| *name == arm.name)
        })?;
        let EncodingSpans { rotation, degrees, length, axes } = stream.diagnosis.encoding_spans;
        match cause {
            Cause::Rotation(_) | Cause::InferredEncoding { .. } => rotation,
            Cause::AngleUnit(_) => degrees,
            Cause::LengthUnit(_) => length,
            Cause::Axes { .. } => axes,
            _ => None,
        }
    };
    let Outcome::Evaluated(Ruling::Fail(fault)) = &mut judged.outcome else { return judged };
    let Some((from_s, to_s)) = segment_s(&judged.subject, &fault.cause) else { return judged };
    let at = |at_s: f64| Some(case.evidence.origin.shifted(at_s)).filter(|_| at_s.is_finite());
    let (from, to) = (at(from_s), at(to_s));
    let when = match (from, to) {
        (Some(from), None) => format!("from {} on", case.evidence.moment(from)),
        (None, Some(to)) => format!("until {}", case.evidence.moment(to)),
        (Some(from), Some(to)) => {
            format!("from {} to {}", case.evidence.moment(from), case.evidence.moment(to))
        }
        (None, None) => return judged,
    };
    fault.title = "the encoding of the numbers changes mid-run";
    fault.cause = Cause::ParameterChange;
    fault.message = format!("{when}: {}", fault.message);
    fault.fix = format!("{}, for the samples {when}", fault.fix);
    let changes: Vec<Value> =
        [from, to].into_iter().flatten().map(|at| at.to_string().into()).collect();
    let span = judged
        .span
        .map(|span| Span { start: from.unwrap_or(span.start), end: to.unwrap_or(span.end) });
    SubjectResult { span, ..judged }.with_evidence("change_ns", changes)
}
