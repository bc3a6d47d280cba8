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
    /// If the stamp stands still, for example while the arm rests, fill it anew in every message. If the clock was set back
    /// (TIM001), slew it. Otherwise look for two nodes that publish the same, or a driver that stamps a batch of
    /// measurements with the read time of the buffer. Stamp every measurement. In a table, write the source's own stamp in every
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
        fix: fix(rhythm, worst),
    };
    SubjectResult::new(subject, Outcome::fail(fault))
        .within(rhythm.span)
        .estimated(Estimate::exact("duplicates", "1", share(worst)))
        .with_evidence("conflicts", worst.conflicts)
        .with_evidence("repeats", repeats)
}

/// By the order of the stamps: two publishers alternate, and neither holds a stamp nor repeats a series of them.
fn fix(rhythm: &StreamEvidence<RhythmEvidence>, part: &Cadence) -> String {
    let topic = rhythm.subject.label();
    match () {
        () if rhythm.is_from_table => {
            "write the source's own stamp in every row, and each row once".to_owned()
        }
        () if 2 * part.held > part.conflicts => format!(
            "stamp every message on {topic} anew: its stamp stands still while its content changes"
        ),
        () if part.set_back > 0 && part.set_back == part.steps_back.len() => {
            "the clock was set back, so its stamps occur again (TIM001): slew it instead of setting it \
             (chrony, PTP)"
                .to_owned()
        }
        () => format!("check for a second publisher on {topic}, and stamp every measurement"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::evidence::ExpectedTiming;

    #[test]
    fn the_fix_names_a_second_publisher_only_if_the_stamps_alternate() {
        let back = vec![(crate::time::Stamp::from_nanos(0), 2.5)];
        for (part, expected) in [
            (Cadence { held: 400, ..Cadence::default() }, "its stamp stands still"),
            (Cadence { set_back: 1, steps_back: back, ..Cadence::default() }, "slew it"),
            (Cadence::default(), "second publisher"),
        ] {
            let part = Cadence { rows: 1000, conflicts: 400, has_header_stamps: true, ..part };
            let mut run = clean_run();
            run.rhythms = vec![run.robots[0].poses[0].with_value(RhythmEvidence {
                due: ExpectedTiming::Always,
                rate_hz: Some(100.0),
                is_from_table: false,
                declared_hz: None,
                unusable: 0,
                unstamped: 0,
                omitted: 0,
                in_other_frames: 0,
                parts: vec![part],
                extent: None,
            })];
            let (_, findings) = evaluate_rule(&TIM004, &run);
            assert!(findings[0].fix.contains(expected), "{}", findings[0].fix);
        }
    }
}
