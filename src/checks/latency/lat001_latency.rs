use std::collections::BTreeSet;

use serde_json::json;

use crate::checks::decision::{Decision, Threshold, decide, not_observable};
use crate::checks::latency::with_stamp_remedy;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{DelayJitter, EstimateResult, Measured};
use crate::evidence::{ArmEvidence, HandEyeEvidence, LateTransforms, StreamEvidence};
use crate::finding::{
    Alternative, Cause, Estimate, Evidence, Fault, Outcome, Ruling, Severity, Span, Subject, Unit,
};

rule! {
    /// A stream is late or early relative to the joint states.
    ///
    /// ## What it means
    /// A sample stamped *t* describes the state at *t − latency*: positive is late, negative is early. The
    /// reference is the joint states. If two or more independent streams are early by the same latency, the
    /// joint states are late, and the only finding is on them.
    ///
    /// ## Why it matters
    /// In motion, a latency shifts every pose by speed times latency: 20 ms at 1 m/s is 20 mm. It scatters
    /// hand-eye calibrations and makes visual servoing oscillate.
    ///
    /// ## Evidence
    /// The lag that best aligns the stream with forward kinematics, with sub-sample resolution and an
    /// interval that allows for correlated noise. For a camera target: the lag that best closes the
    /// hand-eye chain, fitted together with the camera's pose. For one of several topics of an arm's joint
    /// states: the lag at which its joints match the poses together with the others; other rules use the
    /// corrected stamps. For one joint: the delay that explains errors proportional to its speed (a filter, or encoders
    /// that are read one after another). Late transforms of a moving frame, such as odometry, are also corrected for other rules.
    ///
    /// `effect_m` is the position error at this run's top speed. If no third independent stream shows which
    /// of the two is off, `indistinguishable` lists the other one.
    ///
    /// ## How to fix
    /// Stamp samples at acquisition, not when they are published or received, with a single clock. A
    /// constant latency can be corrected by shifting the stamps. An early stream is a prediction or has a clock that is
    /// ahead, or the joint states are late.
    ///
    /// ## When it misleads
    /// - A periodic motion fits several lags. An arm at rest, or a target seen only at rest (stop and go),
    ///   fits any lag. These are inconclusive.
    /// - A filter on the stream adds latency.
    /// - Delays skewed to one side, as in a transport, have no single latency. The estimate is their
    ///   median; `delays` also has the mean.
    /// - /tf from robot_state_publisher copies the joint states' stamps and cannot show whether they are
    ///   late.
    /// - Stamps truncated to the tick of a coarse clock are early by half a tick; the message reports it. The interval
    ///   includes half a tick of each clock. If two topics share their rounded stamps, it includes the accuracy of the
    ///   restored ones. Columns of one table share their times and need neither.
    /// - A stream on another clock (TIM003) is first aligned by minimum delay, which hides a constant
    ///   transport delay.
    LAT001 {
        name: "latency",
        grade: Grade::From(&[THRESHOLD]),
        headline: true,
        needs_model: true,
        missing: "no pose, /tf or IMU stream besides the joint states",
        check: check,
    }
}

pub(super) const THRESHOLD: Threshold =
    Threshold { unit: Unit::Second, warning: 2e-3, error: 10e-3 };

/// Recording that resolves an inconclusive latency.
const SETTLE: &str = "record 10 s of motion that starts, stops and does not repeat";

#[derive(Clone, Copy)]
struct StreamLatency<'a> {
    /// Stamps independent of the joint states'.
    has_independent_stamps: bool,
    latency: &'a EstimateResult<Measured>,
    /// Skewed delays; the latency is their median.
    delays: Option<&'a DelayJitter>,
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let arms = case.evidence.robots.iter().flat_map(|arm| judge_arm(case, arm));
    let targets =
        case.evidence.hand_eyes.iter().filter_map(|target| judge_without_joints(case, target));
    let mut rows: Vec<SubjectResult> = arms.chain(targets).collect();
    report_once_per_topic(&mut rows, case.thresholds.threshold(&LAT001, THRESHOLD).warning);
    rows
}

/// One program stamps all transforms of a topic. Findings on one topic that agree within `max_difference_s`
/// are therefore reported once, on the first; the others pass.
fn report_once_per_topic(rows: &mut [SubjectResult], max_difference_s: f64) {
    let is_finding =
        |row: &SubjectResult| matches!(row.outcome, Outcome::Evaluated(Ruling::Fail(_)));
    for at in 1..rows.len() {
        let (earlier, rest) = rows.split_at_mut(at);
        let Some(row) = rest.first_mut().filter(|row| is_finding(row)) else { continue };
        let value = |row: &SubjectResult| row.estimate.as_ref().and_then(Estimate::value);
        let is_same = |other: &&mut SubjectResult| {
            let is_similar =
                value(other).zip(value(row)).is_some_and(|(a, b)| (a - b).abs() < max_difference_s);
            other.subject.topic == row.subject.topic && is_finding(other) && is_similar
        };
        let Some(first) = earlier.iter_mut().find(is_same) else { continue };
        let others = first.evidence.get("others_late").and_then(|count| count.as_u64());
        first.evidence.insert("others_late".to_owned(), (others.unwrap_or(0) + 1).into());
        row.outcome = Outcome::pass_with_remark("same latency as the whole topic, reported once");
    }
}

fn judge_arm(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    let poses = arm.poses_and_tf().map(|stream| {
        let latency = &stream.diagnosis.latency_s;
        let delays = stream.diagnosis.delay_jitter.as_ref();
        stream.with_value(StreamLatency {
            has_independent_stamps: stream.has_independent_stamps,
            latency,
            delays,
        })
    });
    let imus = arm.imus.iter().map(|imu| {
        let latency = &imu.diagnosis.latency_s;
        imu.with_value(StreamLatency {
            has_independent_stamps: imu.has_independent_stamps,
            latency,
            delays: None,
        })
    });
    let is_of_arm = |target: &&HandEyeEvidence| {
        target.hand_is_of_joints && target.robot.as_ref() == Some(&arm.name)
    };
    let targets = case.evidence.hand_eyes.iter().filter(is_of_arm).map(|target| StreamEvidence {
        subject: target.subject(),
        span: target.span,
        value: StreamLatency {
            has_independent_stamps: true,
            latency: &target.diagnosis.latency_s,
            delays: None,
        },
    });
    let streams: Vec<StreamEvidence<StreamLatency>> = poses.chain(imus).chain(targets).collect();
    let of_topic =
        arm.joint_topic.iter().map(|(late, other)| judge_joint_topic(case, arm, late, other));
    let of_transforms = arm.poses.iter().filter_map(|stream| {
        Some(judge_transforms(case, arm, stream.late_transforms.as_ref()?, stream.span))
    });
    let of_joints = arm
        .diagnosis
        .compliance
        .iter()
        .filter_map(|late| Some(judge_joint(case, arm, late.column, &late.delay_s()?)));
    let of_groups: Vec<SubjectResult> = of_topic.chain(of_transforms).chain(of_joints).collect();
    of_groups.into_iter().chain(judge_streams(case, arm, &streams)).collect()
}

fn judge_streams(
    case: &Case,
    arm: &ArmEvidence,
    streams: &[StreamEvidence<StreamLatency>],
) -> Vec<SubjectResult> {
    match joint_state_latency(case, streams) {
        Some(lateness) => {
            let joints = late_joint_states(case, arm, streams, &lateness);
            let results = streams.iter().map(|stream| judge_with_late_joints(case, arm, stream));
            std::iter::once(joints).chain(results).collect()
        }
        None => streams.iter().map(|stream| judge_stream(case, arm, stream, streams)).collect(),
    }
}

/// Latency of a topic with some of the arm's joints against the topic with the others.
fn judge_joint_topic(
    case: &Case,
    arm: &ArmEvidence,
    late: &StreamEvidence<Measured>,
    other: &str,
) -> SubjectResult {
    let latency = &late.value;
    let outcome = decide_latency(case, latency).into_outcome(SETTLE, |severity| {
        let (effect, effect_m) = effect(arm, latency);
        Fault {
            severity,
            cause: Cause::Latency(*latency),
            title: "joint states of one topic are not simultaneous with the others",
            message: message(latency, other),
            evidence: Evidence { effect, effect_m, ..Evidence::default() },
            fix: format!(
                "stamp all joints when the encoders are read, or shift {} by {}",
                late.topic(),
                shift(latency)
            ),
        }
    });
    late.judged(outcome).estimated(as_estimate(latency))
}

/// Latency of one joint's positions against the other joints.
fn judge_joint(case: &Case, arm: &ArmEvidence, column: usize, latency: &Measured) -> SubjectResult {
    let threshold = case.thresholds.threshold(&LAT001, THRESHOLD);
    let outcome = decide(latency, &threshold, case.evidence.subjects()).into_outcome(SETTLE, |severity| {
        let side = if latency.value > 0.0 { "late" } else { "early" };
        let size = Measured { value: latency.value.abs(), ..*latency };
        Fault {
            severity,
            cause: Cause::Stamps,
            title: "one joint's positions are not simultaneous with the others",
            message: format!("{} {side} against the other joints", THRESHOLD.unit.show_measured(&size)),
            evidence: Evidence::default(),
            fix: format!(
                "read all encoders at one time and filter all joints alike, or shift this joint by {}",
                shift(latency)
            ),
        }
    });
    let estimate = Estimate::scalar("latency", THRESHOLD.unit, latency);
    SubjectResult::new(arm.joint(column), outcome).within(arm.span).estimated(estimate)
}

/// Latency of the transforms of a moving reference frame, such as odometry.
fn judge_transforms(
    case: &Case,
    arm: &ArmEvidence,
    LateTransforms { topic, frame, latency_s: latency }: &LateTransforms,
    span: Option<Span>,
) -> SubjectResult {
    let outcome = decide_latency(case, latency).into_outcome(SETTLE, |severity| Fault {
        severity,
        cause: Cause::Stamps,
        title: if latency.value > 0.0 { "transforms are late" } else { "transforms are early" },
        message: format!("the transforms of {frame} are {}", message(latency, &arm.joints_topic)),
        evidence: Evidence::default(),
        fix: format!("stamp them when {frame} is measured, or shift them by {}", shift(latency)),
    });
    let judged = SubjectResult::new(arm.frame(topic, frame), outcome).within(span);
    judged.estimated(as_estimate(latency))
}

/// Latency of a target relative to a hand without joint states; which of the two is off is undetermined.
fn judge_without_joints(case: &Case, target: &HandEyeEvidence) -> Option<SubjectResult> {
    let latency = target.diagnosis.latency_s.as_ref().ok().filter(|_| !target.hand_is_of_joints)?;
    let Decision::Fail(_) = decide_latency(case, latency) else { return None };
    let why = format!(
        "{}; without joint states of a known model nothing shows which of the two is off: record them, or name the \
         arm with --robot",
        message(latency, &target.hand),
    );
    let judged = SubjectResult::new(target.subject(), Outcome::Inconclusive(why));
    Some(judged.within(target.span).estimated(as_estimate(latency)))
}

/// Latency of the joint states, if two or more independent streams are early by it and none disagrees. Common
/// lateness is not attributed to them: drivers may stamp too late, but not before the measurement.
fn joint_state_latency(case: &Case, streams: &[StreamEvidence<StreamLatency>]) -> Option<Measured> {
    let threshold = case.thresholds.threshold(&LAT001, THRESHOLD);
    let (mut latencies, mut topics) = (Vec::new(), BTreeSet::new());
    for stream in streams.iter().filter(|stream| stream.has_independent_stamps) {
        let Some(latency) = estimate(stream) else { continue };
        match decide_latency(case, latency) {
            Decision::Fail(_) if latency.value < 0.0 => {
                latencies.push(*latency);
                // One program stamps a topic, so its transforms count as one stream.
                topics.insert(stream.topic());
            }
            // Too uncertain to agree or disagree.
            Decision::Undecided(_) => {}
            Decision::Fail(_) | Decision::Pass => return None,
        }
    }
    let early = (topics.len() >= 2).then(|| weighted_mean(&latencies))??;
    let agree = latencies.iter().all(|one| (one.value - early.value).abs() < threshold.warning);
    agree.then(|| early.scaled(-1.0))
}

fn estimate<'a>(stream: &StreamEvidence<StreamLatency<'a>>) -> Option<&'a Measured> {
    stream.latency.as_ref().ok()
}

/// Mean weighted by inverse variance. The standard error is inflated if the values scatter more than
/// predicted (Birge ratio; Particle Data Group, *Review of Particle Physics*, §5.2.2).
fn weighted_mean(latencies: &[Measured]) -> Option<Measured> {
    let variance = |latency: &Measured| latency.std_error.max(THRESHOLD.unit.noise_floor()).powi(2);
    let weight: f64 = latencies.iter().map(|latency| 1.0 / variance(latency)).sum();
    let value =
        latencies.iter().map(|latency| latency.value / variance(latency)).sum::<f64>() / weight;
    let dof = latencies.iter().map(|latency| latency.dof).fold(f64::INFINITY, f64::min);
    let chi2: f64 =
        latencies.iter().map(|latency| (latency.value - value).powi(2) / variance(latency)).sum();
    let birge = (chi2 / (latencies.len() as f64 - 1.0)).sqrt().max(1.0);
    let common = Measured { value, std_error: birge / weight.sqrt(), dof };
    common.value.is_finite().then_some(common)
}

fn late_joint_states(
    case: &Case,
    arm: &ArmEvidence,
    streams: &[StreamEvidence<StreamLatency>],
    lateness: &Measured,
) -> SubjectResult {
    let independent_streams: Vec<&StreamEvidence<StreamLatency>> =
        streams.iter().filter(|stream| stream.has_independent_stamps).collect();
    let mut topics: Vec<&str> = independent_streams.iter().map(|stream| stream.topic()).collect();
    topics.dedup();
    let topics = list_topics(&topics);
    let alternatives = independent_streams
        .iter()
        .filter_map(|stream| Some(alternative(stream.subject.clone(), estimate(stream)?)));
    let (effect, effect_m) = effect(arm, lateness);
    let fault = Fault {
        severity: case
            .thresholds
            .threshold(&LAT001, THRESHOLD)
            .severity(lateness.value)
            .unwrap_or(Severity::Warning),
        cause: Cause::Latency(*lateness),
        title: arm.arm_or_body("joint states are late", "stream is late"),
        message: message(lateness, &topics),
        evidence: Evidence {
            indistinguishable: alternatives.collect(),
            effect,
            effect_m,
            ..Evidence::default()
        },
        fix: format!(
            "stamp {}, or shift {} by {}",
            arm.arm_or_body(
                "the joint states when the encoders are read",
                "its poses at acquisition, not at publishing"
            ),
            arm.joints_topic,
            shift(lateness),
        ),
    };
    SubjectResult::new(arm.topic(&arm.joints_topic), Outcome::fail(fault))
        .within(arm.span)
        .estimated(as_estimate(lateness))
}

/// As `/a and /b`, or `/a, /b and 5 more topics`.
fn list_topics(topics: &[&str]) -> String {
    match topics {
        [a, b, _, others @ ..] => format!("{a}, {b} and {} more topics", others.len() + 1),
        few => few.join(" and "),
    }
}

/// Passes an independent stream: late joint states explain its latency. Judges others as usual.
fn judge_with_late_joints(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<StreamLatency>,
) -> SubjectResult {
    let remark = format!("its apparent latency is explained by {}", arm.joints_topic);
    let outcome = match stream.latency {
        Ok(_) if stream.has_independent_stamps => Outcome::pass_with_remark(remark),
        _ => return judge_stream(case, arm, stream, &[]),
    };
    stream.judged(outcome).estimated(estimate(stream).map(as_estimate))
}

fn judge_stream(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<StreamLatency>,
    streams: &[StreamEvidence<StreamLatency>],
) -> SubjectResult {
    let latency = match stream.latency {
        Ok(latency) => latency,
        Err(why) => return stream.judged(not_observable(why, SETTLE)),
    };
    let outcome = decide_latency(case, latency).into_outcome(SETTLE, |severity| {
        let has_other_stream = streams.iter().any(|other| {
            other.has_independent_stamps && other.topic() != stream.topic() && other.latency.is_ok()
        });
        let mut indistinguishable = Vec::new();
        if stream.has_independent_stamps && !has_other_stream {
            let joints = arm.topic(&arm.joints_topic);
            indistinguishable.push(alternative(joints, &latency.scaled(-1.0)));
        }
        let (effect, effect_m) = effect(arm, latency);
        Fault {
            severity,
            cause: Cause::Latency(*latency),
            title: if latency.value > 0.0 { "stream is late" } else { "stream is early" },
            message: message(latency, &arm.joints_topic)
                + &tick_suffix(case, arm, stream, latency)
                + &mean_suffix(stream),
            evidence: Evidence { indistinguishable, effect, effect_m, ..Evidence::default() },
            fix: stream_fix(arm, stream.topic(), latency),
        }
    });
    let judged = stream.judged(outcome).estimated(as_estimate(latency));
    let judged = with_stamp_remedy(case, arm, judged, SETTLE);
    match stream.delays {
        Some(delays) => judged.with_evidence(
            "delays",
            json!({ "median_s": delays.median_s.value, "mean_s": delays.mean_s.value }),
        ),
        None => judged,
    }
}

/// Stamping at publishing makes a stream late, so an early one is ahead of its measurement, or its reference is late.
fn stream_fix(arm: &ArmEvidence, topic: &str, latency: &Measured) -> String {
    let shift = shift(latency);
    match latency.value > 0.0 {
        true => format!("stamp at acquisition, not at publishing; or shift {topic} by {shift}"),
        false => format!(
            "check whether {topic} is stamped before it is measured (a prediction, a clock ahead), or {} when it is \
             published; or shift {topic} by {shift}",
            arm.joints_topic
        ),
    }
}

fn decide_latency(case: &Case, latency: &Measured) -> Decision {
    let threshold = case.thresholds.threshold(&LAT001, THRESHOLD);
    decide(latency, &threshold, case.evidence.subjects())
}

fn as_estimate(latency: &Measured) -> Estimate {
    Estimate::scalar("latency", THRESHOLD.unit, latency)
}

fn message(latency: &Measured, other: &str) -> String {
    let side = if latency.value > 0.0 { "late" } else { "early" };
    format!("{} {side} against {other}", THRESHOLD.unit.show_measured(&latency.abs()))
}

/// For a latency that is the median of skewed delays.
fn mean_suffix(stream: &StreamEvidence<StreamLatency>) -> String {
    let mean = |delays: &DelayJitter| {
        let mean = delays.mean_s.abs();
        let side = if delays.mean_s.value > 0.0 { "late" } else { "early" };
        format!(" (median; delays are skewed, mean {} {side})", THRESHOLD.unit.show_measured(&mean))
    };
    stream.delays.map(mean).unwrap_or_default()
}

/// Explains a latency of half a clock tick by truncated stamps: the stream's if it is early, the joint states'
/// if it is late.
fn tick_suffix(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<StreamLatency>,
    latency: &Measured,
) -> String {
    /// In ticks.
    const MAX_TICK_DEVIATION: f64 = 0.1;
    let tick_s = |topic: &str| {
        let rhythm_of_topic = case.evidence.rhythms.iter().filter(|rhythm| rhythm.topic() == topic);
        rhythm_of_topic.into_iter().flat_map(|rhythm| &rhythm.parts).find_map(|part| part.tick_s)
    };
    let is_half = |tick_s: f64, sign: f64| {
        (latency.value - 0.5 * sign * tick_s).abs()
            < MAX_TICK_DEVIATION * tick_s + 2.0 * latency.std_error
    };
    let truncated = |topic: &str, sign: f64| {
        let tick_s = tick_s(topic).filter(|tick_s| is_half(*tick_s, sign))?;
        let tick = THRESHOLD.unit.show(tick_s);
        Some(format!(": half a clock tick of {tick}; the stamps of {topic} are truncated to it"))
    };
    truncated(stream.topic(), -1.0)
        .or_else(|| truncated(&arm.joints_topic, 1.0))
        .unwrap_or_default()
}

/// Signed shift that corrects `latency`.
fn shift(latency: &Measured) -> String {
    let sign = if latency.value > 0.0 { "-" } else { "+" };
    format!("{sign}{}", THRESHOLD.unit.show(latency.value.abs()))
}

fn effect(arm: &ArmEvidence, latency: &Measured) -> (Option<String>, Option<f64>) {
    let speed = arm.top_speed_m_s();
    if speed <= 0.0 {
        return (None, None);
    }
    let effect_m = latency.value.abs() * speed;
    let text = format!("{} at this run's top speed of {speed:.2} m/s", Unit::Metre.show(effect_m));
    (Some(text), Some(effect_m))
}

fn alternative(subject: Subject, latency: &Measured) -> Alternative {
    Alternative { code: LAT001.code, subject, estimate: Some(as_estimate(latency)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{as_case, clean_run};
    use crate::diagnosis::NotObservable;

    fn latency(value: f64) -> EstimateResult<Measured> {
        Ok(Measured { value, std_error: 1e-5, dof: 1e3 })
    }

    fn stream<'a>(
        topic: &str,
        has_independent_stamps: bool,
        latency: &'a EstimateResult<Measured>,
    ) -> StreamEvidence<StreamLatency<'a>> {
        let subject = clean_run().robots[0].topic(topic);
        StreamEvidence {
            subject,
            span: None,
            value: StreamLatency { has_independent_stamps, latency, delays: None },
        }
    }

    fn lateness(latencies: &[(bool, EstimateResult<Measured>)]) -> Option<f64> {
        let topics = ["/pose", "/tracker", "/imu"];
        let streams = topics.iter().zip(latencies);
        let streams = streams.map(|(topic, (has_independent_stamps, latency))| {
            stream(topic, *has_independent_stamps, latency)
        });
        Some(joint_state_latency(&as_case(&clean_run()), &streams.collect::<Vec<_>>())?.value)
    }

    #[test]
    fn streams_that_are_all_early_indicate_late_joint_states() {
        let late =
            lateness(&[(true, latency(-0.02)), (true, latency(-0.0201)), (false, latency(0.0))]);
        assert!(late.is_some_and(|late| (late - 0.02005).abs() < 1e-9), "{late:?}");
    }

    #[test]
    fn one_stream_or_a_disagreement_does_not_blame_the_joints() {
        assert_eq!(lateness(&[(true, latency(-0.02)), (false, latency(-0.02))]), None);
        assert_eq!(
            lateness(&[(true, latency(-0.02)), (true, latency(-0.02)), (true, latency(0.0))]),
            None
        );
        assert_eq!(lateness(&[(true, latency(-0.02)), (true, latency(-0.05))]), None);
        assert_eq!(lateness(&[(true, latency(0.02)), (true, latency(0.02))]), None);
        assert_eq!(lateness(&[(true, latency(-0.02)), (true, Err(NotObservable::AtRest))]), None);
    }

    #[test]
    fn the_fix_of_an_early_stream_is_not_to_stamp_earlier() {
        let run = clean_run();
        let fix = |value: f64| {
            let latency = Measured { value, std_error: 1e-5, dof: 1e3 };
            stream_fix(&run.robots[0], "/pose", &latency)
        };
        assert_eq!(fix(0.02), "stamp at acquisition, not at publishing; or shift /pose by -20 ms");
        let early = fix(-0.02);
        assert!(early.contains("/joint_states when it is published"), "{early}");
        assert!(early.ends_with("or shift /pose by +20 ms"), "{early}");
    }

    #[test]
    fn transforms_of_one_topic_are_one_stream_and_one_finding() {
        let late = latency(-0.03);
        let streams: Vec<StreamEvidence<StreamLatency>> =
            (0..5).map(|_| stream("/tf", true, &late)).collect();
        let run = clean_run();
        assert_eq!(joint_state_latency(&as_case(&run), &streams), None);
        let arm = &run.robots[0];
        let mut rows: Vec<SubjectResult> = streams
            .iter()
            .map(|stream| judge_stream(&as_case(&run), arm, stream, &streams))
            .collect();
        let other = stream("/pose", true, &late);
        rows.push(judge_stream(&as_case(&run), arm, &other, &[]));
        let apart = latency(-0.05);
        rows.push(judge_stream(&as_case(&run), arm, &stream("/tf", true, &apart), &[]));
        report_once_per_topic(&mut rows, 2e-3);
        let named: Vec<bool> = rows
            .iter()
            .map(|row| matches!(row.outcome, Outcome::Evaluated(Ruling::Fail(_))))
            .collect();
        assert_eq!(named, [true, false, false, false, false, true, true]);
        assert_eq!(rows[0].evidence["others_late"], 4);
    }
}
