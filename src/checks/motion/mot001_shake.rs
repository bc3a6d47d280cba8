use crate::checks::decision::Threshold;
use crate::checks::motion::mot003_limits_exceeded::motion_doubt;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{Vibration, VibrationFailure};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence, VibrationEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};

rule! {
    /// Tool vibration above the band of the motion.
    ///
    /// ## What it means
    /// The rms of the tool's path above 10 Hz, beyond noise, in the 1.5 s in which it is largest. The path is
    /// FK of the joint states, or a pose stream. For a pose stream the band starts at the upper end of the
    /// joint motion, but not below 4 Hz. A tone that the joints do not show is thus also vibration. White
    /// noise is estimated and subtracted.
    ///
    /// ## Why it matters
    /// It blurs camera images and adds to every pose error. Typical causes: a servo hunting in its dead
    /// band, a loose joint, an excessive gain, a stepped command.
    ///
    /// ## Evidence
    /// - The estimate is the rms in metres.
    /// - `frequency_hz`: strongest frequency; `at_ns`: time of the window.
    /// - `from_hz`: lower end of the band; `noise_m`: rms noise above it.
    /// - `resolved_m`: smallest vibration distinguishable from the noise.
    ///
    /// ## How to fix
    /// Compare the streams: vibration in the joint states comes from the servos. Vibration only in an
    /// independent pose stream comes from the structure or the sensor. Widen the dead band, lower the gain,
    /// or interpolate the command at the controller's rate.
    ///
    /// ## When it misleads
    /// - Streams below 25 Hz are skipped. Vibration above half the sample rate appears at an aliased
    ///   frequency.
    /// - Quantization steps of coarse encoders (6 mrad at 10 bits) mask vibration below 1.5 times the tip
    ///   motion of one step.
    /// - Some tools, such as sanders, vibrate by design.
    /// - The ringing after an abrupt stop (MOT002) is shorter than the window.
    /// - A single step in the path, as of a slipping tool, is removed. Windows with a latency step (LAT003)
    ///   are skipped.
    MOT001 {
        name: "shake",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no joint states",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::Metre, warning: 0.5e-3, error: 2e-3 };
const SETTLE: &str = "log evenly spaced samples at 100 Hz or more";

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        arm.vibrations.iter().map(|stream| judge(case, arm, stream)).collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<VibrationEvidence>,
) -> SubjectResult {
    let judged = |outcome| stream.judged(outcome);
    let why = match stream.topic() == arm.joints_topic {
        true => motion_doubt(arm),
        false => stream.in_other_units.then(|| {
            let of_topic = |pose: &&StreamEvidence<PoseEvidence>| pose.topic() == stream.topic();
            let code = arm.poses.iter().find(of_topic).map_or("ORD008", |pose| pose.unit_rule());
            format!("its positions are not in metres ({code})")
        }),
    };
    if let Some(why) = why {
        return judged(Outcome::Inconclusive(why));
    }
    let found = match &stream.vibration {
        Ok(found) => found,
        Err(VibrationFailure::Slow(rate_hz)) => {
            let why = format!("a rate of {rate_hz:.0} Hz cannot show vibration above 10 Hz");
            return judged(Outcome::Skipped(why));
        }
        Err(VibrationFailure::Uneven) => {
            let why = "needs 1.5 s of evenly spaced samples";
            return judged(Outcome::Inconclusive(format!("{why}; {SETTLE}")));
        }
    };
    let threshold = case.thresholds.threshold(&MOT001, THRESHOLD);
    let outcome = match threshold.severity(found.rms_m) {
        Some(severity) => Outcome::fail(fault(case, stream, found, severity)),
        None if found.resolved_m > threshold.warning => {
            let [resolved, needed] =
                [found.resolved_m, threshold.warning].map(|m| THRESHOLD.unit.show(m));
            let why =
                format!("noise hides vibration below {resolved}; {needed} must be detectable");
            Outcome::Inconclusive(format!("{why}; {SETTLE}"))
        }
        None => Outcome::pass(),
    };
    judged(outcome)
        .estimated(Estimate::exact("shake", THRESHOLD.unit.symbol(), found.rms_m))
        .with_evidence("frequency_hz", found.frequency_hz)
        .with_evidence("from_hz", found.from_hz)
        .with_evidence("at_ns", case.evidence.origin.shifted(found.at_s).to_string())
        .with_evidence("noise_m", found.noise_m)
        .with_evidence("resolved_m", found.resolved_m)
}

fn fault(
    case: &Case,
    stream: &StreamEvidence<VibrationEvidence>,
    found: &Vibration,
    severity: Severity,
) -> Fault {
    Fault {
        cause: Cause::Pictured(Picture::Vibration),
        severity,
        title: "tool vibration",
        message: format!(
            "tool vibration {} rms above {:.0} Hz, peak at {:.0} Hz, at {}",
            THRESHOLD.unit.show(found.rms_m),
            found.from_hz,
            found.frequency_hz,
            case.evidence.moment_at(found.at_s),
        ),
        evidence: Evidence { effect_m: Some(found.rms_m), ..Evidence::default() },
        fix: format!("check servo dead band, loose joints and gains; seen in {}", stream.topic()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::finding::Status;

    #[test]
    fn positions_in_another_unit_name_the_rule_that_reports_the_unit() {
        for (is_undeclared, code) in [(false, "ORD008"), (true, "ORD001")] {
            let mut run = clean_run();
            let arm = &mut run.robots[0];
            let topic = arm.poses[0].topic().to_owned();
            arm.poses[0].is_undeclared = is_undeclared;
            arm.vibrations[0].subject = arm.topic(&topic);
            arm.vibrations[0].in_other_units = true;
            let (rows, _) = evaluate_rule(&MOT001, &run);
            assert!(rows[0].reason.as_ref().is_some_and(|why| why.contains(code)), "{:?}", rows[0]);
        }
    }

    #[test]
    fn noise_that_hides_shake_is_inconclusive() {
        for (rms_m, resolved_m, status) in [
            (1e-3, 1e-3, Status::Fail),
            (0.0, 1e-3, Status::Inconclusive),
            (1e-4, 1e-5, Status::Pass),
        ] {
            let mut run = clean_run();
            let shake = Vibration { rms_m, resolved_m, frequency_hz: 12.0, ..Vibration::default() };
            run.robots[0].vibrations[0].vibration = Ok(shake);
            let (rows, _) = evaluate_rule(&MOT001, &run);
            assert_eq!(rows[0].status, status, "{:?}", rows[0]);
        }
    }
}
