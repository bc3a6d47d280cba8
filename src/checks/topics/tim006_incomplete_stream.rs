use crate::checks::{Case, Grade, Limit, SubjectResult};
use crate::evidence::{EmptyStreamEvidence, ExpectedTiming, RhythmEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Subject, Unit};
use crate::run::{Cadence, RateSpan};

rule! {
    /// An expected stream is empty, incomplete or slow.
    ///
    /// ## What it means
    /// - A topic of joint states, transforms, tool poses or an IMU has no messages, or none with finite
    ///   values.
    /// - It begins or ends more than a second apart from the others, by receive time.
    /// - It runs below its usual rate for two seconds or more, or below a config's declared rate.
    /// - A config names a topic that the log does not have.
    ///
    /// ## Why it matters
    /// Missing data were not audited. An early end indicates a crashed driver; a low rate, an overloaded
    /// machine.
    ///
    /// ## Evidence
    /// `late_start_s` and `early_end_s` are relative to the median of the other streams. The estimate is
    /// the missed time in seconds, the offset of clocks with different origins, or the rate in the slowest stretch.
    ///
    /// ## How to fix
    /// Start the recorder when all drivers run and stop it before them. Check the driver's log when its
    /// stream ends.
    ///
    /// ## When it misleads
    /// Streams published on change start and end with the motion; this is not a fault if the arm rested
    /// otherwise. A driver that is too slow throughout is detected only if a config declares its `rate_hz`.
    /// Commands, camera detections and streams without an assigned role may be empty or short.
    TIM006 {
        limits: &[MAX_EDGE_DIFFERENCE, MIN_SLOW_INTERVAL_RATIO, MIN_SLOW_DURATION, MIN_DECLARED_RATE_RATIO],
        name: "incomplete-stream",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stream that must be complete in this log",
        check: check,
    }
}

const MAX_EDGE_DIFFERENCE: Limit = Limit {
    key: "together",
    unit: Unit::Second,
    value: 1.0,
    what: "maximum difference in start and end times of complete streams",
};
/// Of a Julian year, s.
const SECONDS_PER_YEAR: f64 = 365.25 * 86400.0;
/// Three years: no recording is as long, so the clocks of the streams have different origins, s.
const MIN_EPOCH_DIFFERENCE_S: f64 = 1e8;
const MIN_SLOW_INTERVAL_RATIO: Limit = Limit {
    key: "slow",
    unit: Unit::One,
    value: 1.4,
    what: "minimum ratio of a slow stream's interval to the usual one",
};
const MIN_SLOW_DURATION: Limit = Limit {
    key: "lasts",
    unit: Unit::Second,
    value: 2.0,
    what: "minimum duration of a slow stretch",
};
const MIN_DECLARED_RATE_RATIO: Limit = Limit {
    key: "below",
    unit: Unit::One,
    value: 0.9,
    what: "minimum ratio of the measured to the declared rate",
};

#[derive(Clone, Copy)]
pub(in crate::checks) struct SlowRateLimits {
    slow: f64,
    min_duration_s: f64,
}

impl SlowRateLimits {
    pub(in crate::checks) fn from_thresholds(case: &Case) -> Self {
        let [slow, min_duration_s] = [&MIN_SLOW_INTERVAL_RATIO, &MIN_SLOW_DURATION]
            .map(|limit| case.thresholds.limit(&TIM006, limit));
        Self { slow, min_duration_s }
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let missing = case
        .evidence
        .missing_topics
        .iter()
        .map(|(subject, place)| judge_missing(subject.clone(), place));
    let empty = case.evidence.empty_streams.iter().map(|empty| judge_empty(case, empty));
    let empty = missing.chain(empty);
    let expected = case.evidence.rhythms.iter().filter(|rhythm| rhythm.due.is_expected());
    empty.chain(expected.map(|rhythm| judge(case, rhythm))).collect()
}

fn judge_empty(case: &Case, empty: &EmptyStreamEvidence) -> SubjectResult {
    let topic = empty.subject.label();
    if empty.messages == 0 && case.evidence.lost_messages() {
        let why = "it is empty, but messages of the log itself are lost (ING001); record it again";
        return SubjectResult::new(empty.subject.clone(), Outcome::Inconclusive(why.to_owned()));
    }
    let (message, fix) = match empty.messages {
        0 => (
            "topic recorded but empty".to_owned(),
            format!("check that {topic} was published, with a compatible QoS"),
        ),
        messages => (
            format!("none of its {messages} messages has finite values"),
            format!("check the source of {topic}"),
        ),
    };
    SubjectResult::new(
        empty.subject.clone(),
        Outcome::fail(Fault {
            cause: Cause::Stamps,
            severity: Severity::Warning,
            title: "stream is empty",
            message,
            evidence: Evidence::default(),
            fix,
        }),
    )
}

fn judge_missing(subject: Subject, place: &str) -> SubjectResult {
    let topic = subject.label().to_owned();
    SubjectResult::new(
        subject,
        Outcome::fail(Fault {
            cause: Cause::Stamps,
            severity: Severity::Warning,
            title: "stream is missing",
            message: format!("the log has no such topic, but {place} expects it"),
            evidence: Evidence::default(),
            fix: format!("record {topic}, or correct its name there"),
        }),
    )
}

/// Measured and declared rate, Hz, if too slow.
fn below_declared_rate(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> Option<(f64, f64)> {
    let (declared_hz, rate_hz) = (rhythm.declared_hz?, rhythm.rate_hz?);
    (rate_hz < case.thresholds.limit(&TIM006, &MIN_DECLARED_RATE_RATIO) * declared_hz)
        .then_some((rate_hz, declared_hz))
}

fn judge(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> SubjectResult {
    let (pace, together_s) = (
        SlowRateLimits::from_thresholds(case),
        case.thresholds.limit(&TIM006, &MAX_EDGE_DIFFERENCE),
    );
    let slowest = |part| slowest_stretch(pace, rhythm, part);
    let (missing_at_start_s, missing_at_end_s) = missed_at_ends(rhythm);
    let slow: Vec<&Cadence> =
        rhythm.required_parts().filter(|part| slowest(part).is_some()).collect();
    let worst = slow.iter().filter_map(|part| Some((part.period_s?, slowest(part)?)));
    let worst = worst.min_by(|a, b| (a.0 * a.1.rate_hz).total_cmp(&(b.0 * b.1.rate_hz)));
    let shown = |missed_s: f64| Unit::Second.show(missed_s);
    let missed_s = missing_at_start_s.max(missing_at_end_s);
    let is_other_epoch = missed_s > MIN_EPOCH_DIFFERENCE_S;
    let (title, message, estimate) = if is_other_epoch {
        let message = format!(
            "its stamps are {:.0} years from those of the other streams, so it is not compared with them",
            missed_s / SECONDS_PER_YEAR
        );
        let apart = Estimate::exact("clock offset", Unit::Second.symbol(), missed_s);
        ("clocks have different origins", message, apart)
    } else if missing_at_start_s.max(missing_at_end_s) > together_s {
        let message = match (missing_at_start_s > together_s, missing_at_end_s > together_s) {
            (true, false) => {
                format!("begins {} after the other streams", shown(missing_at_start_s))
            }
            (false, _) => format!("ends {} before the other streams", shown(missing_at_end_s)),
            (true, true) => format!(
                "begins {} after the other streams and ends {} before them",
                shown(missing_at_start_s),
                shown(missing_at_end_s)
            ),
        };
        let missed = Estimate::exact("time missed", Unit::Second.symbol(), missed_s);
        ("stream is incomplete", message, missed)
    } else if let Some((period_s, stretch)) = worst {
        let (usual_hz, rate_hz) = (1.0 / period_s, stretch.rate_hz);
        let (length, at) = (shown(stretch.seconds()), case.evidence.moment(stretch.start));
        let message =
            format!("runs at {rate_hz:.1} Hz for {length} from {at}, usually at {usual_hz:.1} Hz");
        ("stream is slow", message, Estimate::exact("rate", "Hz", rate_hz))
    } else if let Some((rate_hz, declared_hz)) = below_declared_rate(case, rhythm) {
        let message = format!("runs at {rate_hz:.1} Hz; declared are {declared_hz:.1} Hz");
        ("stream is slow", message, Estimate::exact("rate", "Hz", rate_hz))
    } else {
        return SubjectResult::new(rhythm.subject_of(&[]), Outcome::pass()).within(rhythm.span);
    };
    if case.evidence.lost_messages() {
        let why = format!("it {message}, but messages of the log itself are lost (ING001)");
        let outcome = Outcome::Inconclusive(format!("{why}; record it again"));
        return SubjectResult::new(rhythm.subject_of(&slow), outcome).within(rhythm.span);
    }
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title,
        message,
        evidence: Evidence::default(),
        fix: match is_other_epoch {
            true => "give the stamps of all files one origin, such as Unix time".to_owned(),
            false => format!("check the publisher of {} at that time", rhythm.subject.label()),
        },
    };
    SubjectResult::new(rhythm.subject_of(&slow), Outcome::fail(fault))
        .within(rhythm.span)
        .estimated(estimate)
        .with_evidence("late_start_s", missing_at_start_s)
        .with_evidence("early_end_s", missing_at_end_s)
}

/// At start and end, s. Zero if the stream may be silent because the arm rests.
fn missed_at_ends(rhythm: &StreamEvidence<RhythmEvidence>) -> (f64, f64) {
    let Some(extent) = rhythm.extent else { return (0.0, 0.0) };
    // The next sample is due one period after the last.
    let period_s = rhythm.required_parts().filter_map(|part| part.period_s).fold(0.0, f64::max);
    let counted = |missed_s: f64, moving: Option<bool>| match moving {
        Some(false) if rhythm.due == ExpectedTiming::WhileMoving => 0.0,
        _ => (missed_s - period_s).max(0.0),
    };
    let [before, after] = extent.is_arm_moving;
    (counted(extent.late_start_s, before), counted(extent.early_end_s, after))
}

pub(in crate::checks) fn slow_stretches(
    pace: SlowRateLimits,
    part: &Cadence,
) -> impl Iterator<Item = &RateSpan> {
    let usual_s = part.period_s.unwrap_or(f64::INFINITY);
    let is_slow = move |lull: &&RateSpan| lull.rate_hz * usual_s * pace.slow < 1.0;
    part.slow_spans.iter().filter(is_slow).filter(move |lull| lull.seconds() >= pace.min_duration_s)
}

/// Except at rest if the stream may be slow then.
fn slowest_stretch<'a>(
    pace: SlowRateLimits,
    rhythm: &StreamEvidence<RhythmEvidence>,
    part: &'a Cadence,
) -> Option<&'a RateSpan> {
    let is_due = |lull: &&RateSpan| {
        lull.is_arm_moving == Some(true) || rhythm.due != ExpectedTiming::WhileMoving
    };
    let stretches = slow_stretches(pace, part).filter(is_due);
    stretches.min_by(|a, b| a.rate_hz.total_cmp(&b.rate_hz))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::run::StreamExtent;

    #[test]
    fn stamps_that_are_years_apart_have_another_origin() {
        let found = |late_start_s: f64| {
            let mut run = clean_run();
            run.rhythms = vec![run.robots[0].poses[0].with_value(RhythmEvidence {
                due: ExpectedTiming::Always,
                rate_hz: Some(50.0),
                is_from_table: true,
                declared_hz: None,
                unusable: 0,
                unstamped: 0,
                omitted: 0,
                in_other_frames: 0,
                parts: vec![Cadence { is_audited: true, rows: 1000, ..Cadence::default() }],
                extent: Some(StreamExtent {
                    late_start_s,
                    early_end_s: 0.0,
                    is_arm_moving: [None; 2],
                }),
            })];
            let (_, findings) = evaluate_rule(&TIM006, &run);
            (findings[0].title, findings[0].message.clone(), findings[0].fix.clone())
        };
        assert_eq!(found(3.0).0, "stream is incomplete");
        let (title, message, fix) = found(1.8e9);
        assert!(message.starts_with("its stamps are 57 years from"), "{message}");
        assert_eq!(title, "clocks have different origins");
        assert!(fix.contains("one origin"), "{fix}");
    }
}
