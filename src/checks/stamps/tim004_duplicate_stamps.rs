use crate::checks::{Case, Grade, Limit, SubjectResult};
use crate::evidence::{RhythmEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::Cadence;

rule! {
    /// Several samples have the same stamp but different content.
    ///
    /// ## What it means
    /// More than 0.1 % of a stream's samples have an earlier one's stamp, but different content. /tf is
    /// checked per transform, joint states per publisher.
    ///
    /// ## Why it matters
    /// The arm has one pose at a time. Interpolation divides by zero time, and tf2 keeps an arbitrary
    /// sample with a warning.
    ///
    /// ## Evidence
    /// `conflicts`: samples that contradict an earlier one with the same stamp; `repeats`: identical
    /// repeats. The estimate is the fraction of conflicts.
    ///
    /// ## How to fix
    /// Look for two nodes that publish the same, or a driver that stamps a batch of measurements with the
    /// read time of the buffer. Stamp every measurement. In a table, write the source's own stamp in every
    /// row.
    ///
    /// ## When it misleads
    /// A node that resends its last value with its old stamp, such as a state publisher polled faster than
    /// it is updated, is not counted. Stamps rounded to milliseconds may collide in a stream faster than 1
    /// kHz.
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

const DUPLICATES: Limit = Limit {
    key: "duplicates",
    unit: Unit::One,
    value: 1e-3,
    what: "fraction of samples above which duplicate stamps are a fault",
};

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.rhythms.iter().map(|rhythm| judge(case, rhythm)).collect()
}

fn share(part: &Cadence) -> f64 {
    part.conflicts as f64 / part.rows.max(1) as f64
}

fn judge(case: &Case, rhythm: &StreamEvidence<RhythmEvidence>) -> SubjectResult {
    let most = case.thresholds.limit(&TIM004, &DUPLICATES);
    let concerned: Vec<&Cadence> = rhythm.parts.iter().filter(|part| share(part) > most).collect();
    let subject = rhythm.subject_of(&concerned);
    if !rhythm.parts.iter().any(|part| part.has_header_stamps) {
        let outcome = Outcome::Skipped("its messages have no stamps".to_owned());
        return SubjectResult::new(subject, outcome).within(rhythm.span);
    }
    let repeats: usize = rhythm.parts.iter().map(|part| part.repeats).sum();
    let worst = concerned.iter().copied().max_by(|a, b| share(a).total_cmp(&share(b)));
    let Some(worst) = worst else {
        let outcome = match repeats {
            0 => Outcome::pass(),
            _ => Outcome::pass_with_remark(format!(
                "{repeats} samples are sent twice with equal content"
            )),
        };
        return SubjectResult::new(subject, outcome).within(rhythm.span);
    };
    let fault = Fault {
        cause: Cause::Stamps,
        severity: Severity::Warning,
        title: "stamps are used twice",
        message: format!(
            "{} of {} samples have the stamp of another sample but different content",
            worst.conflicts, worst.rows
        ),
        evidence: Evidence::default(),
        fix: match rhythm.is_from_table {
            true => "write the source's own stamp in every row, and each row once".to_owned(),
            false => format!(
                "check for a second publisher on {}, and stamp every measurement",
                rhythm.subject.label()
            ),
        },
    };
    SubjectResult::new(subject, Outcome::fail(fault))
        .within(rhythm.span)
        .estimated(Estimate::exact("duplicates", "1", share(worst)))
        .with_evidence("conflicts", worst.conflicts)
        .with_evidence("repeats", repeats)
}
