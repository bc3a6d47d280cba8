use serde_json::{Value, json};

use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{RhythmEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::Cadence;
use crate::time::Stamp;

rule! {
    /// Stamps run backwards.
    ///
    /// ## What it means
    /// A message has an earlier stamp than the one received before it, by more than the stream's period.
    /// /tf is checked per transform, joint states per publisher. If all streams step back by more than a
    /// second, the clock was restarted: the run is split there, and nothing is reported here.
    ///
    /// ## Why it matters
    /// tf2 rejects a transform older than its latest, or clears its buffer. Filters integrate backwards.
    ///
    /// ## Evidence
    /// `steps`: the stamp before each step, and its size; `count`: their number. The estimate is the
    /// largest step.
    ///
    /// ## How to fix
    /// If the stamps go on from the earlier one, the clock was set while recording: use a slewing NTP client. Otherwise
    /// look for messages that are queued and sent late, or two nodes that publish on one topic.
    ///
    /// ## When it misleads
    /// A transport that may reorder messages (UDP, best effort) causes small steps that receivers must
    /// tolerate.
    TIM001 {
        name: "backward-stamps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stamped stream in this log",
        check: check,
    }
}

/// Smaller steps are two swapped samples with stamp jitter.
const MIN_STEP_PERIODS: f64 = 1.2;
const MAX_LISTED_STEPS: usize = 10;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.rhythms.iter().map(|rhythm| judge(case, rhythm)).collect()
}

/// Stamp before the step, and its size, s.
fn steps_back(part: &Cadence) -> impl Iterator<Item = &(Stamp, f64)> {
    let min_step_s = MIN_STEP_PERIODS * part.period_s.unwrap_or(0.0);
    part.steps_back.iter().filter(move |(_, by_s)| *by_s > min_step_s)
}

fn judge(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> SubjectResult {
    let concerned: Vec<&Cadence> =
        rhythm.parts.iter().filter(|part| steps_back(part).next().is_some()).collect();
    let subject = rhythm.subject_of(&concerned);
    if !rhythm.parts.iter().any(|part| part.has_header_stamps) {
        let outcome = Outcome::Skipped("its messages have no stamps".to_owned());
        return SubjectResult::new(subject, outcome).within(rhythm.span);
    }
    // The transforms of one message step back together.
    let mut steps: Vec<(Stamp, f64)> =
        concerned.iter().flat_map(|part| steps_back(part)).copied().collect();
    steps.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    steps.dedup();
    let Some(&(at, by_s)) = steps.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return SubjectResult::new(subject, Outcome::pass()).within(rhythm.span);
    };
    let listed: Vec<Value> = steps
        .iter()
        .take(MAX_LISTED_STEPS)
        .map(|(at, by_s)| json!({ "at_ns": at.to_string(), "by_s": by_s }))
        .collect();
    let (count, largest) = (steps.len(), Unit::Second.show(by_s));
    let topic = rhythm.subject.label();
    let is_set_back = concerned.iter().all(|part| part.set_back == part.steps_back.len());
    let message = match count {
        1 => format!("stamps step back by {largest} at {}", case.evidence.moment(at)),
        _ => format!(
            "stamps step back {count} times, by up to {largest} (at {})",
            case.evidence.moment(at)
        ),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title: "stamps run backwards",
        message,
        evidence: Evidence::default(),
        fix: match is_set_back {
            true => format!(
                "the clock of {topic} was set back: slew it instead of setting it (chrony, PTP)"
            ),
            false => {
                format!("check for messages that are sent late, or a second publisher, on {topic}")
            }
        },
    };
    SubjectResult::new(subject, Outcome::fail(fault))
        .within(rhythm.span)
        .estimated(Estimate::exact("step back", Unit::Second.symbol(), by_s))
        .with_evidence("count", count)
        .with_evidence("steps", listed)
}
