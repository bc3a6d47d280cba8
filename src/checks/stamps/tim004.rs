use crate::checks::{Case, Grade, Judged, Limit};
use crate::evidence::{Of, RhythmEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::Cadence;

rule! {
    /// Several messages carry one stamp and say different things.
    ///
    /// ## What it means
    /// More than 0.1 % of a stream's samples have the stamp of an earlier one, but not its content.
    /// Of /tf each transform is looked at by itself, of joint states each sender.
    ///
    /// ## Why it matters
    /// At one time the arm is in one place. Interpolation divides by a time of zero, tf2 keeps one of
    /// the two and warns of the other, and which one is chance.
    ///
    /// ## Evidence
    /// `conflicts` is how many samples contradict an earlier one of the same stamp, `repeats` how
    /// many only repeat it. The estimate is the share of those that contradict.
    ///
    /// ## How to fix
    /// Look for two nodes that publish the same, or a driver that stamps a whole batch of readings
    /// with the time at which it read the buffer. Stamp every reading.
    ///
    /// ## When it misleads
    /// A node that sends its last value again with its old stamp, such as a state publisher that is
    /// asked more often than it is told, repeats and does not contradict; that is not counted. Stamps
    /// that are rounded to milliseconds may collide where the stream is faster than that.
    TIM004 {
        limits: &[DUPLICATES],
        name: "duplicate-stamps",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: false,
        missing: "no stamped stream in this log",
        check: check,
    }
}

/// The share of samples from which on duplicates are a fault.
const DUPLICATES: Limit = Limit {
    key: "duplicates",
    unit: Unit::One,
    value: 1e-3,
    what: "the share of samples from which on duplicates are a fault",
};

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.rhythms.iter().map(|rhythm| judge(case, rhythm)).collect()
}

fn share(part: &Cadence) -> f64 {
    part.conflicts as f64 / part.rows.max(1) as f64
}

fn judge(case: &Case, rhythm: &Of<RhythmEvidence>) -> Judged {
    let most = case.thresholds.limit(&TIM004, &DUPLICATES);
    let concerned: Vec<&Cadence> = rhythm.parts.iter().filter(|part| share(part) > most).collect();
    let subject = rhythm.subject_of(&concerned);
    if !rhythm.parts.iter().any(|part| part.stamped) {
        let outcome = Outcome::Skipped("its messages carry no stamps".to_owned());
        return Judged::new(subject, outcome).within(rhythm.span);
    }
    let repeats: usize = rhythm.parts.iter().map(|part| part.repeats).sum();
    let worst = concerned.iter().copied().max_by(|a, b| share(a).total_cmp(&share(b)));
    let Some(worst) = worst else {
        let outcome = match repeats {
            0 => Outcome::sound(),
            _ => Outcome::sound_because(format!("{repeats} samples are sent twice, and are equal")),
        };
        return Judged::new(subject, outcome).within(rhythm.span);
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title: "stamps are used twice",
        message: format!(
            "{} of {} samples have the stamp of another, and other content",
            worst.conflicts, worst.rows
        ),
        evidence: Evidence::default(),
        fix: format!(
            "look for a second publisher on {}, and stamp every reading",
            rhythm.subject.label()
        ),
    };
    Judged::new(subject, Outcome::faulty(fault))
        .within(rhythm.span)
        .estimated(Estimate::counted("duplicates", "1", share(worst)))
        .with_evidence("conflicts", worst.conflicts)
        .with_evidence("repeats", repeats)
}
