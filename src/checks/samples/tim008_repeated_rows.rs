use crate::checks::decision::Threshold;
use crate::checks::joints::vel001_velocity_mismatch::is_error_reported;
use crate::checks::{Case, Grade, SubjectResult};
use crate::evidence::{RepeatedValueEvidence, Resampling, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::run::RepeatedValues;

rule! {
    /// Rows repeat values with new stamps while the arm moves.
    ///
    /// ## What it means
    /// At least 5 % of a stream's rows (joint states, poses, transforms or IMU) repeat the previous row bit
    /// for bit under a new stamp while the arm moves. Typical causes: a script that polls faster than
    /// values arrive, or a node that upsamples by repetition. Joint states are also reported at any share if
    /// their velocities show that the recorder resampled them and set new stamps.
    ///
    /// ## Why it matters
    /// The stamps hide the age of the values. Differentiation gives standstills and jumps, impossible
    /// accelerations and vibration at the true rate. Joining by stamp is late by half the hold time.
    ///
    /// ## Evidence
    /// - `repeated` of `rows` in motion repeat the previous row.
    /// - `rows_hz`: row rate; `values_hz`: rate of new values.
    /// - `mean_age_s`: mean age of a row's value, if it was new half a row before its first row.
    /// - `step_error_s`: rms difference between the steps of the stamps and of the values. The velocities of
    ///   all joints give the steps of the values. Reported if these steps explain at least four fifths of
    ///   the velocities' squared error, which VEL001 would report otherwise.
    /// - The estimate is the fraction of repeated rows.
    ///
    /// The other rules use each value once: joint states, and streams that repeat with them, at the time
    /// the value was new; other streams at the middle of the hold time, so their latency (LAT001) includes
    /// the mean age.
    ///
    /// ## How to fix
    /// Subscribe instead of polling, or stamp a value when it is read and publish it once. Interpolate in
    /// the consumer that needs a fixed rate.
    ///
    /// ## When it misleads
    /// Repeats of an arm at rest, or of a slow joint with a coarse encoder, are not counted. A topic whose
    /// name indicates latching is `info`. Rows repeated with their old stamp are sent twice, which is not a
    /// fault (TIM004). TIM007 reports values repeated for 0.25 s or more while the arm moves.
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

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.repeated_values.iter().map(|stream| judge(case, stream)).collect()
}

fn judge(case: &Case, stream: &StreamEvidence<RepeatedValueEvidence>) -> SubjectResult {
    let worst = stream.parts.iter().max_by(|a, b| a.share().total_cmp(&b.share()));
    let threshold = case.thresholds.threshold(&TIM008, THRESHOLD);
    let severity = worst.and_then(|worst| threshold.severity(worst.share()));
    if severity.is_none()
        && let Some(resampling) = resampling(case, stream.topic())
    {
        return report_resampling(stream, resampling);
    }
    let Some(worst) = worst else { return stream.judged(Outcome::pass()) };
    let outcome = match severity {
        None => Outcome::pass(),
        Some(_) if stream.is_of_joints => {
            Outcome::pass_with_remark("its repeats are those of the joint states".to_owned())
        }
        Some(severity) => Outcome::fail(fault(stream, worst, severity)),
    };
    let RepeatedValues { rows, repeated, rows_hz, values_hz, mean_age_s, .. } = *worst;
    stream
        .judged(outcome)
        .estimated(Estimate::exact("repeated rows", "1", worst.share()))
        .with_evidence("rows", rows)
        .with_evidence("repeated", repeated)
        .with_evidence("rows_hz", rows_hz)
        .with_evidence("values_hz", values_hz)
        .with_evidence("mean_age_s", mean_age_s)
}

/// Of joint states, if their stamps are why velocities do not follow the positions.
fn resampling<'a>(case: &'a Case, topic: &str) -> Option<&'a Resampling> {
    let mut arms = case.evidence.arms_with_or_without_model();
    let arm = arms.find(|arm| arm.joints_topic == topic)?;
    let found = arm.stamps.resampling.as_ref()?;
    found.velocity_errors.iter().any(|error| is_error_reported(case, error)).then_some(found)
}

fn report_resampling(
    stream: &StreamEvidence<RepeatedValueEvidence>,
    resampling: &Resampling,
) -> SubjectResult {
    let Resampling { rows, repeated, rows_hz, values_hz, step_error_s, .. } = *resampling;
    let share = repeated as f64 / rows.max(1) as f64;
    let rates = match repeated {
        0 => String::new(),
        _ => format!(
            ": {:.1} % of the rows in motion repeat the previous row, so values come at {values_hz:.1} Hz and are \
             stamped at {rows_hz:.1} Hz",
            100.0 * share
        ),
    };
    let fault = Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Warning,
        title: "stamps are not those of the values",
        message: format!(
            "by the velocities of all joints, the times between values differ from the stamps' by {} rms{rates}",
            Unit::Second.show(step_error_s)
        ),
        evidence: Evidence::default(),
        fix: stamp_values(stream),
    };
    stream
        .judged(Outcome::fail(fault))
        .estimated(Estimate::exact("repeated rows", "1", share))
        .with_evidence("rows", rows)
        .with_evidence("repeated", repeated)
        .with_evidence("rows_hz", rows_hz)
        .with_evidence("values_hz", values_hz)
        .with_evidence("step_error_s", step_error_s)
}

fn stamp_values(stream: &StreamEvidence<RepeatedValueEvidence>) -> String {
    format!("publish each value of {} once, stamped when it was read", stream.subject.label())
}

fn fault(
    stream: &StreamEvidence<RepeatedValueEvidence>,
    repeated_values: &RepeatedValues,
    severity: Severity,
) -> Fault {
    let frame = match (&repeated_values.frame, stream.parts.len()) {
        (Some(frame), 2..) => format!(" (worst: '{frame}')"),
        _ => String::new(),
    };
    Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: if stream.is_latched { Severity::Info } else { severity },
        title: "rows repeat old values",
        message: format!(
            "{:.0} % of the rows in motion repeat the previous row{frame}: new values at {:.1} Hz, sent at \
             {:.1} Hz, {} old on average",
            100.0 * repeated_values.share(),
            repeated_values.values_hz,
            repeated_values.rows_hz,
            Unit::Second.show(repeated_values.mean_age_s),
        ),
        evidence: Evidence::default(),
        fix: stamp_values(stream),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{JOINTS, clean_run, evaluate_rule, precise};
    use crate::evidence::RunEvidence;
    use crate::finding::{Finding, Subject};

    fn findings_for(value: RepeatedValueEvidence) -> Vec<Finding> {
        let subject = Subject { topic: Some("/pose".to_owned()), ..Subject::default() };
        let repeated_values = vec![StreamEvidence { subject, span: None, value }];
        evaluate_rule(&TIM008, &RunEvidence { repeated_values, ..clean_run() }).1
    }

    fn stream(repeated: usize) -> RepeatedValueEvidence {
        let mut repeated_values = RepeatedValues::default();
        (repeated_values.rows, repeated_values.repeated) = (1000, repeated);
        (repeated_values.rows_hz, repeated_values.values_hz, repeated_values.mean_age_s) =
            (125.0, 25.0, 0.016);
        RepeatedValueEvidence {
            parts: vec![repeated_values],
            is_latched: false,
            is_of_joints: false,
        }
    }

    #[test]
    fn the_repeated_share_decides_and_a_latched_topic_is_named() {
        for (repeated, severity) in
            [(800, Some(Severity::Error)), (80, Some(Severity::Warning)), (20, None)]
        {
            let findings = findings_for(stream(repeated));
            assert_eq!(findings.first().map(|found| found.severity), severity, "{findings:?}");
        }
        let latched = RepeatedValueEvidence { is_latched: true, ..stream(800) };
        assert_eq!(findings_for(latched)[0].severity, Severity::Info);
        let inherited = RepeatedValueEvidence { is_of_joints: true, ..stream(800) };
        assert!(findings_for(inherited).is_empty());
    }

    #[test]
    fn stamps_that_explain_wrong_velocities_are_reported_at_any_share() {
        for (error, repeated, rates) in [(0.067, 14, true), (0.067, 0, false), (0.03, 14, false)] {
            let subject = Subject { topic: Some(JOINTS.to_owned()), ..Subject::default() };
            let value =
                RepeatedValueEvidence { parts: Vec::new(), is_latched: false, is_of_joints: false };
            let repeated_values = vec![StreamEvidence { subject, span: None, value }];
            let mut run = RunEvidence { repeated_values, ..clean_run() };
            run.robots[0].stamps.resampling = Some(Resampling {
                rows: 727,
                repeated,
                rows_hz: 30.0,
                values_hz: 29.4,
                step_error_s: 0.0048,
                velocity_errors: vec![precise(error)],
            });
            let (_, findings) = evaluate_rule(&TIM008, &run);
            assert_eq!(findings.len(), usize::from(error > 0.05), "{findings:?}");
            for found in findings {
                assert_eq!(found.severity, Severity::Warning);
                assert!(found.message.contains("by 4.8 ms rms"), "{}", found.message);
                let has_rates = found.message.contains("1.9 % of the rows")
                    && found.message.contains("29.4 Hz");
                assert_eq!(has_rates, rates, "{}", found.message);
            }
        }
    }
}
