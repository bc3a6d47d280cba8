use crate::checks::decision::Threshold;
use crate::checks::{Case, Grade, Judged};
use crate::evidence::{HeldEvidence, Of};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Unit};
use crate::run::Held;

rule! {
    /// Rows repeat values with new stamps while the arm moves.
    ///
    /// ## What it means
    /// From 5 % of the rows on, those of a stream of joint states, poses, transforms or an IMU say what
    /// the row before said, to the last bit, under a stamp of their own, though the arm moves: a script
    /// that polls faster than there is something new, or a node that fills a rate up.
    ///
    /// ## Why it matters
    /// The stamps say that the values are new, and they are not: each is as old as it was held. Whoever
    /// takes differences finds standstill and leaps, accelerations that no arm has and a shake at the true
    /// rate; whoever joins by stamp is late by half of the time that values are held.
    ///
    /// ## Evidence
    /// `repeated` of `rows` in motion repeat the row before; `rows_hz` is their rate and `values_hz` the
    /// true one, of new values. `mean_age_s` is how long a row's value had been there, in the mean. The
    /// estimate is the share of rows that repeat. The other rules take each value once: joint states, and
    /// what repeats with them, at the time they were new; other streams at the middle of the time that
    /// they are held, so that a latency (LAT001) holds the mean age.
    ///
    /// ## How to fix
    /// Subscribe instead of polling, or stamp a value when it is read and send it once. Where a consumer
    /// wants a fixed rate, let it interpolate.
    ///
    /// ## When it misleads
    /// An arm at rest repeats values, and so does a slow joint with a coarse encoder: neither is counted.
    /// Where the topic's name says that it is latched, it is told as `info`. Rows that repeat with their
    /// old stamp are sent twice, which is no fault (TIM004); what repeats for a quarter of a second and
    /// more while the arm moves is TIM007's.
    TIM008 {
        name: "repeated-rows",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: false,
        missing: "no stream whose values could repeat",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::One, warning: 0.05, error: 0.5 };

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.held.iter().map(|stream| judge(case, stream)).collect()
}

fn judge(case: &Case, stream: &Of<HeldEvidence>) -> Judged {
    let worst = stream.parts.iter().max_by(|a, b| a.share().total_cmp(&b.share()));
    let Some(worst) = worst else { return stream.judged(Outcome::sound()) };
    let outcome = match case.thresholds.of(&TIM008, THRESHOLD).severity(worst.share()) {
        None => Outcome::sound(),
        Some(_) if stream.is_of_joints => {
            Outcome::sound_because("what it repeats are the joint states' repeats".to_owned())
        }
        Some(severity) => Outcome::faulty(fault(stream, worst, severity)),
    };
    let Held { rows, repeated, rows_hz, values_hz, mean_age_s, .. } = *worst;
    stream
        .judged(outcome)
        .estimated(Estimate::counted("repeated rows", "1", worst.share()))
        .with_evidence("rows", rows)
        .with_evidence("repeated", repeated)
        .with_evidence("rows_hz", rows_hz)
        .with_evidence("values_hz", values_hz)
        .with_evidence("mean_age_s", mean_age_s)
}

fn fault(stream: &Of<HeldEvidence>, held: &Held, severity: Severity) -> Fault {
    let frame = match (&held.frame, stream.parts.len()) {
        (Some(frame), 2..) => format!(" (most of all '{frame}')"),
        _ => String::new(),
    };
    Fault {
        cause: Cause::Seen(Sight::Stream),
        severity: if stream.is_latched { Severity::Info } else { severity },
        title: "rows repeat old values",
        message: format!(
            "{:.0} % of the rows in motion repeat the one before{frame}: values are new at {:.1} Hz and \
             sent at {:.1} Hz, and are {} old in the mean",
            100.0 * held.share(),
            held.values_hz,
            held.rows_hz,
            Unit::Second.show(held.mean_age_s),
        ),
        evidence: Evidence::default(),
        fix: format!(
            "send each value of {} once, with the time at which it was read",
            stream.subject.label()
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run};
    use crate::evidence::RunEvidence;
    use crate::finding::{Finding, Subject};

    fn asked(found: HeldEvidence) -> Vec<Finding> {
        let subject = Subject { topic: Some("/pose".to_owned()), ..Subject::default() };
        let held = vec![Of { subject, span: None, found }];
        ask(&TIM008, &RunEvidence { held, ..clean_run() }).1
    }

    fn stream(repeated: usize) -> HeldEvidence {
        let mut held = Held::default();
        (held.rows, held.repeated) = (1000, repeated);
        (held.rows_hz, held.values_hz, held.mean_age_s) = (125.0, 25.0, 0.016);
        HeldEvidence { parts: vec![held], is_latched: false, is_of_joints: false }
    }

    #[test]
    fn the_share_decides_and_a_latched_topic_is_told() {
        for (repeated, severity) in
            [(800, Some(Severity::Error)), (80, Some(Severity::Warning)), (20, None)]
        {
            let findings = asked(stream(repeated));
            assert_eq!(findings.first().map(|found| found.severity), severity, "{findings:?}");
        }
        let latched = HeldEvidence { is_latched: true, ..stream(800) };
        assert_eq!(asked(latched)[0].severity, Severity::Info);
        let inherited = HeldEvidence { is_of_joints: true, ..stream(800) };
        assert!(asked(inherited).is_empty());
    }
}
