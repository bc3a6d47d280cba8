use serde_json::{Value, json};

use crate::checks::{Case, Grade, Judged};
use crate::evidence::{Of, RhythmEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::Cadence;
use crate::time::Stamp;

rule! {
    /// Stamps run backwards.
    ///
    /// ## What it means
    /// A message carries a stamp that is before that of the message received ahead of it, by more
    /// than a period of its stream. Of /tf each transform is looked at by itself, of joint states
    /// each sender. Where all streams step back by more than a second it is the clock that began
    /// anew: the run is split there, and this rule does not speak up.
    ///
    /// ## Why it matters
    /// tf2 refuses a transform that is older than what it has, or throws its buffer away; filters
    /// that integrate over time integrate backwards.
    ///
    /// ## Evidence
    /// `steps` says where (the stamp before the step) and by how much, `count` how often. The
    /// estimate is the largest step.
    ///
    /// ## How to fix
    /// Look for two nodes that publish on one topic, a clock that is set while recording (use a
    /// slewing NTP client), or messages that are queued and sent out of order.
    ///
    /// ## When it misleads
    /// A transport that may reorder messages (UDP, best effort) makes small steps that a receiver
    /// has to live with.
    TIM001 {
        name: "backward-stamps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stamped stream in this log",
        check: check,
    }
}

/// A step of this many periods or less is two samples that change places, and what their stamps
/// jitter.
const PLACES: f64 = 1.2;
/// Steps that the evidence lists.
const LISTED: usize = 10;

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.rhythms.iter().map(|rhythm| judge(case, rhythm)).collect()
}

/// Where a part's stamps step back by more than a period, and by how much, s.
fn steps_back(part: &Cadence) -> impl Iterator<Item = &(Stamp, f64)> {
    let least_s = PLACES * part.period_s.unwrap_or(0.0);
    part.steps_back.iter().filter(move |(_, by_s)| *by_s > least_s)
}

fn judge(case: &Case, rhythm: &Of<RhythmEvidence>) -> Judged {
    let concerned: Vec<&Cadence> =
        rhythm.parts.iter().filter(|part| steps_back(part).next().is_some()).collect();
    let subject = rhythm.subject_of(&concerned);
    if !rhythm.parts.iter().any(|part| part.stamped) {
        let outcome = Outcome::Skipped("its messages carry no stamps".to_owned());
        return Judged::new(subject, outcome).within(rhythm.span);
    }
    let steps = || concerned.iter().flat_map(|part| steps_back(part));
    let Some(&(at, by_s)) = steps().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return Judged::new(subject, Outcome::sound()).within(rhythm.span);
    };
    let listed: Vec<Value> = steps()
        .take(LISTED)
        .map(|(at, by_s)| json!({ "at_ns": at.to_string(), "by_s": by_s }))
        .collect();
    let (count, largest) = (steps().count(), Unit::Second.show(by_s));
    let message = match count {
        1 => format!("stamps step back by {largest} at {}", case.evidence.moment(at)),
        _ => format!(
            "stamps step back {count} times, by {largest} at most (at {})",
            case.evidence.moment(at)
        ),
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title: "stamps run backwards",
        message,
        evidence: Evidence::default(),
        fix: format!(
            "look for a second publisher on {}, or a clock that is set",
            rhythm.subject.label()
        ),
    };
    Judged::new(subject, Outcome::faulty(fault))
        .within(rhythm.span)
        .estimated(Estimate::counted("step back", Unit::Second.symbol(), by_s))
        .with_evidence("count", count)
        .with_evidence("steps", listed)
}
