use std::collections::HashMap;

use serde_json::{Value, json};

use crate::checks::topics::tim006_incomplete_stream::{SlowRateLimits, slow_stretches};
use crate::checks::{Case, Grade, Limit, SubjectResult};
use crate::evidence::{ExpectedTiming, RhythmEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::{Cadence, MissingRows, RateSpan};
use crate::time::Stamp;

rule! {
    /// A stream has gaps or loses samples.
    ///
    /// ## What it means
    /// No samples arrived for more than ten periods and 0.1 s while the arm moved, or more than 1 % of the
    /// samples are missing in between. The period is the most common interval. If the publisher numbers its
    /// messages per topic (`header.seq` in ROS 1, `sequence` in MCAP), skipped numbers also count as lost.
    ///
    /// ## Why it matters
    /// Interpolation over a gap invents a path. Samples are lost under load, when they matter most, and a
    /// controller that depends on them stutters.
    ///
    /// ## Evidence
    /// - `gaps`: start and length of each; `count`: their number.
    /// - `lost`, `samples`: missing and received samples; `skipped`: missing by sequence number.
    /// - `made_by`: `recorder` or `transport` if the log shows the cause, otherwise null.
    /// - The estimate is the longest gap in seconds; without gaps, the fraction of lost samples.
    ///
    /// Two nodes on one topic are counted separately.
    ///
    /// ## How to fix
    /// If all streams stop at once, check the recorder's disk and CPU. If sequence numbers are skipped,
    /// messages were sent and lost: use reliable transport or a longer queue. Otherwise the log does not
    /// show whether the publisher stopped or messages were lost.
    ///
    /// ## When it misleads
    /// A stream published on change is silent while the arm rests: not a gap. Without a fixed period, only
    /// sequence numbers show losses. TIM006 reports a lower rate over seconds. Commands and camera
    /// detections are not judged. A stream without an assigned role is judged only if it is periodic. Streams
    /// with less than one sample per second are not judged: they are measurements at rest. A pose that some messages of
    /// a list (PoseArray) do not contain was not seen, not lost.
    TIM002 {
        limits: &[GAP_PERIODS, GAP, LOST],
        name: "gaps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no periodic stream in this log",
        check: check,
    }
}

/// [`GAP`] must also be exceeded.
const GAP_PERIODS: Limit = Limit {
    key: "gap_periods",
    unit: Unit::One,
    value: 10.0,
    what: "minimum length of a gap in periods",
};
const GAP: Limit = Limit {
    key: "gap",
    unit: Unit::Second,
    value: 0.1,
    what: "minimum length of a gap; both limits apply",
};
const LOST: Limit = Limit {
    key: "lost",
    unit: Unit::One,
    value: 0.01,
    what: "fraction of lost samples above which they are reported",
};
/// Minimum for a significant fraction.
const MIN_LOST_SAMPLES: usize = 3;
const MAX_LISTED_GAPS: usize = 10;

const SETTLE: &str = "record the joint states too";

#[derive(Clone, Copy)]
struct GapLimits {
    gap_periods: f64,
    gap_s: f64,
    lost: f64,
    /// A lower rate is not a loss.
    pace: SlowRateLimits,
    declared_period_s: Option<f64>,
}

impl GapLimits {
    fn for_stream(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> Self {
        let [gap_periods, gap_s, lost] =
            [&GAP_PERIODS, &GAP, &LOST].map(|limit| case.thresholds.limit(&TIM002, limit));
        let declared_period_s = rhythm.declared_hz.map(|rate_hz| 1.0 / rate_hz);
        Self {
            gap_periods,
            gap_s,
            lost,
            pace: SlowRateLimits::from_thresholds(case),
            declared_period_s,
        }
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let steady =
        case.evidence.rhythms.iter().filter(|rhythm| rhythm.due != ExpectedTiming::Occasional);
    // First stream with each list of gaps, to the nanosecond, like columns of one table.
    let mut reported: HashMap<Vec<(Stamp, Stamp)>, &StreamEvidence<RhythmEvidence>> =
        HashMap::new();
    let judge_once = |rhythm| {
        let bounds = gap_bounds(rhythm);
        if let Some(first) = reported.get(&bounds).filter(|_| !bounds.is_empty()) {
            let why = format!("same stamps as {}, whose gaps are reported", first.topic());
            return rhythm.judged(Outcome::pass_with_remark(why));
        }
        reported.insert(bounds, rhythm);
        judge(case, rhythm)
    };
    steady.map(judge_once).collect()
}

fn gap_bounds(rhythm: &StreamEvidence<RhythmEvidence>) -> Vec<(Stamp, Stamp)> {
    let holes = rhythm.required_parts().flat_map(|part| &part.missing_rows);
    holes.map(|hole| (hole.span.start, hole.span.end)).collect()
}

/// Parts expected to be periodic; for a stream without a role, those that are.
fn judged_parts(rhythm: &StreamEvidence<RhythmEvidence>) -> impl Iterator<Item = &Cadence> {
    /// Slower samples are measurements at rest, such as those of a laser tracker, which may pause.
    const MAX_PERIOD_S: f64 = 1.0;
    let is_known = rhythm.due.is_expected();
    let is_sampled = |part: &Cadence| part.period_s.is_none_or(|own| own <= MAX_PERIOD_S);
    rhythm.required_parts().filter(move |part| is_sampled(part) && (is_known || part.is_regular))
}

fn judge(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> SubjectResult {
    let by = &GapLimits::for_stream(case, rhythm);
    let silent = |moving: Option<bool>| {
        let gaps = judged_parts(rhythm).flat_map(|part| gaps(by, part));
        gaps.filter(move |gap| gap.is_arm_moving == moving).max_by(|a, b| compare_length(a, b))
    };
    let concerned: Vec<&Cadence> =
        judged_parts(rhythm).filter(|part| has_gaps(by, part) || has_losses(by, part)).collect();
    let subject = rhythm.subject_of(&concerned);
    if !concerned.is_empty() && case.evidence.lost_messages() {
        let why = "samples are missing, but so are messages of the log itself (ING001)";
        let outcome = Outcome::Inconclusive(format!("{why}; record it again"));
        return SubjectResult::new(subject, outcome).within(rhythm.span);
    }
    let missing: usize =
        concerned.iter().flat_map(|part| holes(by, part)).map(|hole| hole.count).sum();
    let skipped: usize = concerned.iter().filter_map(|part| part.skipped_numbers).sum();
    if rhythm.omitted > 0 && missing.max(skipped) as u64 <= 2 * rhythm.omitted {
        let why = format!(
            "{} messages do not list it, as a tracker's that does not see the body: they were received",
            rhythm.omitted
        );
        return SubjectResult::new(subject, Outcome::pass_with_remark(why)).within(rhythm.span);
    }
    let came = rhythm.unusable + rhythm.unstamped + rhythm.in_other_frames;
    if !concerned.is_empty() && came > 0 && missing as u64 <= 2 * came {
        let why = format!(
            "the missing samples were received: {} have unusable values (ING003), {} have no stamp (TIM005), \
             {} are in another frame (FRM007); record it again",
            rhythm.unusable, rhythm.unstamped, rhythm.in_other_frames
        );
        return SubjectResult::new(subject, Outcome::Inconclusive(why)).within(rhythm.span);
    }
    if !concerned.is_empty() {
        return fault(case, by, rhythm, &concerned).within(rhythm.span);
    }
    let shown = |gap: &RateSpan| {
        format!("{} at {}", Unit::Second.show(gap.seconds()), case.evidence.moment(gap.start))
    };
    let outcome = if rhythm.required_parts().next().is_none() {
        Outcome::Skipped("no robot defines which of its transforms are needed".to_owned())
    } else if judged_parts(rhythm).next().is_none() {
        let why = "no fixed period, and none is expected, or less than one sample per second";
        Outcome::Skipped(why.to_owned())
    } else if let Some(gap) = silent(None) {
        let gap = shown(gap);
        Outcome::Inconclusive(format!(
            "no samples for {gap}, and no joint states show whether the arm moved; {SETTLE}"
        ))
    } else if judged_parts(rhythm).any(|part| lost_samples(by, part).is_none()) {
        let why = "no fixed period, so lost samples cannot be counted";
        Outcome::Inconclusive(format!("{why}; publish at a fixed rate, or number the messages"))
    } else if let Some(gap) = silent(Some(false)) {
        Outcome::pass_with_remark(format!("no samples for {}, while the arm rested", shown(gap)))
    } else {
        Outcome::pass()
    };
    SubjectResult::new(subject, outcome).within(rhythm.span)
}

fn compare_length(a: &RateSpan, b: &RateSpan) -> std::cmp::Ordering {
    a.seconds().total_cmp(&b.seconds())
}

/// Longer than any message delay.
fn is_long(by: &GapLimits, part: &Cadence, hole: &MissingRows) -> bool {
    let length_s = hole.span.seconds();
    let stream_period_s = part.period_s.unwrap_or(f64::INFINITY);
    // The declared rate of a /tf topic applies to its fastest transform.
    let declared_s = by
        .declared_period_s
        .filter(|declared_s| stream_period_s < 2.0 * declared_s || stream_period_s.is_infinite());
    let period_s = declared_s.unwrap_or(stream_period_s);
    length_s > by.gap_s && length_s > by.gap_periods * period_s
}

/// Outside stretches with a lower rate.
fn holes<'a>(by: &GapLimits, part: &'a Cadence) -> impl Iterator<Item = &'a MissingRows> {
    let slow: Vec<&RateSpan> = slow_stretches(by.pace, part).collect();
    let is_slow = move |at: Stamp| slow.iter().any(|lull| lull.start <= at && at < lull.end);
    part.missing_rows.iter().filter(move |hole| !is_slow(hole.span.start))
}

/// Long silent holes.
fn gaps<'a>(by: &GapLimits, part: &'a Cadence) -> impl Iterator<Item = &'a RateSpan> {
    let long = holes(by, part).filter(|hole| hole.is_silent && is_long(by, part, hole));
    long.map(|hole| &hole.span)
}

fn gaps_in_motion<'a>(by: &GapLimits, part: &'a Cadence) -> impl Iterator<Item = &'a RateSpan> {
    gaps(by, part).filter(|gap| gap.is_arm_moving == Some(true))
}

fn has_gaps(by: &GapLimits, part: &Cadence) -> bool {
    gaps_in_motion(by, part).next().is_some()
}

/// Counted by period or sequence numbers; `None` if neither is available.
fn lost_samples(by: &GapLimits, part: &Cadence) -> Option<usize> {
    // Unbroken numbers may be assigned by the recorder, so they prove nothing.
    let by_number = part.skipped_numbers.filter(|skipped| *skipped > 0);
    lost_samples_by_period(by, part).max(by_number)
}

fn lost_samples_by_period(by: &GapLimits, part: &Cadence) -> Option<usize> {
    let is_lost = |hole: &&MissingRows| {
        let rests = hole.span.is_arm_moving == Some(false);
        !is_long(by, part, hole) || (hole.is_silent && !rests)
    };
    let missing: usize = holes(by, part).filter(is_lost).map(|hole| hole.count).sum();
    // Late samples, and old ones or ones with the stamp of another in the place of a new one, are not missing.
    let others = part.bunched + part.conflicts + part.stale;
    part.is_regular.then(|| missing.saturating_sub(others))
}

fn lost_share(by: &GapLimits, part: &Cadence) -> f64 {
    let lost = lost_samples(by, part).unwrap_or(0);
    lost as f64 / (lost + part.rows).max(1) as f64
}

fn has_losses(by: &GapLimits, part: &Cadence) -> bool {
    lost_samples(by, part).is_some_and(|lost| lost >= MIN_LOST_SAMPLES)
        && lost_share(by, part) > by.lost
}

fn fault(
    case: &Case,
    by: &GapLimits,
    rhythm: &StreamEvidence<RhythmEvidence>,
    concerned: &[&Cadence],
) -> SubjectResult {
    let gaps = || concerned.iter().flat_map(|part| gaps_in_motion(by, part));
    let worst =
        concerned.iter().copied().max_by(|a, b| lost_share(by, a).total_cmp(&lost_share(by, b)));
    let (lost, samples) =
        worst.map_or((0, 0), |part| (lost_samples(by, part).unwrap_or(0), part.rows));
    let skipped = worst.and_then(|part| part.skipped_numbers);
    let share = worst.map_or(0.0, |part| lost_share(by, part));
    let loss = format!("{:.1} % of samples lost: {lost} of {}", 100.0 * share, lost + samples);
    let (title, message, estimate) = match gaps().max_by(|a, b| compare_length(a, b)) {
        Some(gap) => {
            let (length, at) = (Unit::Second.show(gap.seconds()), case.evidence.moment(gap.start));
            let message = match gaps().count() {
                1 => format!("no samples for {length} at {at} while the arm moved"),
                count => {
                    format!("{count} gaps while the arm moved, longest {length} at {at}")
                }
            };
            let estimate = Estimate::exact("longest gap", Unit::Second.symbol(), gap.seconds());
            ("stream has gaps", message, estimate)
        }
        None => ("samples are lost", loss, Estimate::exact("lost samples", "1", share)),
    };
    let longest = gaps().max_by(|a, b| compare_length(a, b));
    let cause = determine_cause(case, rhythm, longest, skipped);
    let message = format!("{message}{}", cause.suffix);
    let listed: Vec<Value> = gaps()
        .take(MAX_LISTED_GAPS)
        .map(|gap| json!({ "start_ns": gap.start.to_string(), "length_s": gap.seconds() }))
        .collect();
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title,
        message,
        evidence: Evidence::default(),
        fix: cause.fix.to_owned(),
    };
    SubjectResult::new(rhythm.subject_of(concerned), Outcome::fail(fault))
        .estimated(estimate)
        .with_evidence("count", gaps().count())
        .with_evidence("gaps", listed)
        .with_evidence("lost", lost)
        .with_evidence("samples", samples)
        .with_evidence("skipped", skipped)
        .with_evidence("made_by", cause.made_by)
}

struct GapCause {
    made_by: Option<&'static str>,
    suffix: &'static str,
    fix: &'static str,
}

/// The recorder or its machine if all streams stop, the transport if sequence numbers are skipped.
fn determine_cause(
    case: &Case,
    rhythm: &StreamEvidence<RhythmEvidence>,
    gap: Option<&RateSpan>,
    skipped: Option<usize>,
) -> GapCause {
    let others = || {
        let others = case
            .evidence
            .rhythms
            .iter()
            .filter(|other| other.subject.topic != rhythm.subject.topic);
        others.filter(|other| other.due.is_expected())
    };
    let stops = |other: &StreamEvidence<RhythmEvidence>, gap: &RateSpan| {
        let holes = other
            .required_parts()
            .flat_map(|part| &part.missing_rows)
            .filter(|hole| hole.is_silent);
        let shared_s = |hole: &MissingRows| {
            hole.span.end.min(gap.end).seconds_since(hole.span.start.max(gap.start))
        };
        holes.into_iter().any(|hole| 2.0 * shared_s(hole) > gap.seconds())
    };
    let all_stop =
        |gap: &RateSpan| others().next().is_some() && others().all(|other| stops(other, gap));
    if gap.is_some_and(all_stop) {
        return GapCause {
            made_by: Some("recorder"),
            suffix: "; all other streams stop too",
            fix: "check the recorder's disk and CPU load at that time",
        };
    }
    match skipped {
        Some(1..) => GapCause {
            made_by: Some("transport"),
            suffix: "; sequence numbers are skipped: messages were sent but lost",
            fix: "check the load of recorder and network, and use a reliable, longer queue",
        },
        _ => GapCause {
            made_by: None,
            suffix: "",
            fix: "check the publisher's log, and the load of recorder and network; number the messages to \
                distinguish the two",
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{as_case, clean_run, evaluate_rule};
    use crate::evidence::RunEvidence;

    const MS: i64 = 1_000_000;

    fn default_limits() -> GapLimits {
        let run = RunEvidence::default();
        let [gap_periods, gap_s, lost] = [GAP_PERIODS, GAP, LOST].map(|limit| limit.value);
        GapLimits {
            gap_periods,
            gap_s,
            lost,
            pace: SlowRateLimits::from_thresholds(&as_case(&run)),
            declared_period_s: None,
        }
    }

    /// 1000 samples at 100 Hz.
    fn with_hole(periods: i64, is_silent: bool) -> Cadence {
        let (start, end) = (Stamp::from_nanos(0), Stamp::from_nanos(10 * periods * MS));
        let stretch =
            RateSpan { start, end, rate_hz: 100.0 / periods as f64, is_arm_moving: Some(true) };
        let missing = usize::try_from(periods - 1).expect("more than one");
        Cadence {
            is_audited: true,
            rows: 1000,
            period_s: Some(0.01),
            is_regular: true,
            missing_rows: vec![MissingRows { span: stretch, count: missing, is_silent }],
            ..Cadence::default()
        }
    }

    #[test]
    fn a_gap_has_no_samples_for_more_than_ten_periods() {
        assert!(has_gaps(&default_limits(), &with_hole(11, true)));
        assert!(!has_gaps(&default_limits(), &with_hole(10, true)));
        assert!(!has_gaps(&default_limits(), &with_hole(70, false)));
        // A hole too short for a gap may be a loss; a clock that is set forward loses nothing.
        let lost = [with_hole(9, true), with_hole(9, false), with_hole(70, false)];
        assert_eq!(
            lost.map(|part| lost_samples_by_period(&default_limits(), &part)),
            [Some(8), Some(8), Some(0)]
        );
    }

    #[test]
    fn late_samples_and_slow_stretches_are_not_lost() {
        let late = Cadence { bunched: 4, conflicts: 1, stale: 1, ..with_hole(9, true) };
        assert_eq!(lost_samples(&default_limits(), &late), Some(2));
        let mut slow = with_hole(9, true);
        let end = Stamp::from_nanos(3000 * MS);
        slow.slow_spans.push(RateSpan { end, rate_hz: 20.0, ..slow.missing_rows[0].span });
        assert_eq!(lost_samples(&default_limits(), &slow), Some(0));
    }

    #[test]
    fn messages_that_do_not_list_a_pose_are_not_lost() {
        for (omitted, findings) in [(0, 1), (30, 0)] {
            let mut run = clean_run();
            let part = Cadence { skipped_numbers: Some(30), ..with_hole(9, true) };
            run.rhythms = vec![run.robots[0].poses[0].with_value(RhythmEvidence {
                due: ExpectedTiming::Always,
                rate_hz: Some(100.0),
                is_from_table: false,
                declared_hz: None,
                unusable: 0,
                unstamped: 0,
                omitted,
                in_other_frames: 0,
                parts: vec![part],
                extent: None,
            })];
            let (rows, found) = evaluate_rule(&TIM002, &run);
            assert_eq!(found.len(), findings, "{rows:?}");
        }
    }

    #[test]
    fn sequence_numbers_reveal_losses_without_a_period() {
        let mut part = Cadence { is_regular: false, ..with_hole(2, true) };
        assert_eq!(lost_samples(&default_limits(), &part), None);
        part.skipped_numbers = Some(0);
        assert_eq!(lost_samples(&default_limits(), &part), None);
        part.skipped_numbers = Some(30);
        assert!(
            lost_samples(&default_limits(), &part) == Some(30)
                && has_losses(&default_limits(), &part)
        );
    }
}
