use crate::checks::decision::Threshold;
use crate::checks::motion::mot003::motion_doubt;
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{NoShake, Shake};
use crate::evidence::{ArmEvidence, Of, ShakeEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Unit};

rule! {
    /// Tool vibration above the band of the motion.
    ///
    /// ## What it means
    /// Above 10 Hz the path of the tool, by forward kinematics of the joint states or as a pose
    /// stream has it, holds more than noise does: this much, rms, in the second and a half where it
    /// is most. Of a pose stream the band begins where the motion of the joints ends, at 4 Hz at the
    /// lowest: what the joints do not do is shake there too, if it is a tone. Noise has the same power at all frequencies and is taken off; where the arm was going
    /// is slower than that and is not in it.
    ///
    /// ## Why it matters
    /// That is a servo with a dead band that hunts for its target, a loose joint, a gain too high, or
    /// a command that comes in steps. It blurs cameras, and every pose is off by it.
    ///
    /// ## Evidence
    /// `frequency_hz` is the frequency that is strongest, `at_ns` says when, `noise_m` is the rms of
    /// noise above `from_hz` there, and `resolved_m` the least shake that stands out from it. The
    /// estimate is the rms in metres.
    ///
    /// ## How to fix
    /// Compare the streams: what the joint states show is the servos' doing, what only an outside
    /// witness shows is in the structure or in the witness. Widen the dead band, lower the gain, or
    /// interpolate the command at the controller's rate.
    ///
    /// ## When it misleads
    /// Less than 25 samples a second show nothing of it, and what shakes faster than half the rate
    /// shows at another frequency. Steps of coarse encoders (10 bits are 6 mrad) hide what is below one and
    /// a half times what they move the tip by. Tools that vibrate by design, such as a sander, do so. A stop hard
    /// enough for MOT002 shakes for a moment, which is less than is looked at. A single step of the
    /// path, as of a tool that slips, is taken off, and where the latency jumps (LAT003) nothing is
    /// looked at.
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
/// What would tell.
const SETTLE: &str = "log it evenly, at 100 Hz or more";

fn check(case: &Case) -> Vec<Judged> {
    let of_arm = |arm: &ArmEvidence| -> Vec<Judged> {
        arm.shakes.iter().map(|stream| judge(case, arm, stream)).collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

fn judge(case: &Case, arm: &ArmEvidence, stream: &Of<ShakeEvidence>) -> Judged {
    let judged = |outcome| stream.judged(outcome);
    let why = match stream.topic() == arm.joints_topic {
        true => motion_doubt(arm),
        false => stream.in_other_units.then(|| "its unit is not metres (ORD008)".to_owned()),
    };
    if let Some(why) = why {
        return judged(Outcome::Inconclusive(why));
    }
    let found = match &stream.shake {
        Ok(found) => found,
        Err(NoShake::Slow(rate_hz)) => {
            let why = format!("{rate_hz:.0} samples a second do not show what is above 10 Hz");
            return judged(Outcome::Skipped(why));
        }
        Err(NoShake::Uneven) => {
            let why = "it has no second and a half of even samples";
            return judged(Outcome::Inconclusive(format!("{why}; {SETTLE}")));
        }
    };
    let threshold = case.thresholds.of(&MOT001, THRESHOLD);
    let outcome = match threshold.severity(found.rms_m) {
        Some(severity) => Outcome::faulty(fault(case, stream, found, severity)),
        None if found.resolved_m > threshold.warning => {
            let [resolved, needed] =
                [found.resolved_m, threshold.warning].map(|m| THRESHOLD.unit.show(m));
            let why = format!("its noise hides shake below {resolved}, and {needed} is needed");
            Outcome::Inconclusive(format!("{why}; {SETTLE}"))
        }
        None => Outcome::sound(),
    };
    judged(outcome)
        .estimated(Estimate::counted("shake", THRESHOLD.unit.symbol(), found.rms_m))
        .with_evidence("frequency_hz", found.frequency_hz)
        .with_evidence("from_hz", found.from_hz)
        .with_evidence("at_ns", case.evidence.origin.shifted(found.at_s).to_string())
        .with_evidence("noise_m", found.noise_m)
        .with_evidence("resolved_m", found.resolved_m)
}

fn fault(case: &Case, stream: &Of<ShakeEvidence>, found: &Shake, severity: Severity) -> Fault {
    Fault {
        cause: Cause::Seen(Sight::Shake),
        severity,
        title: "tool vibration",
        message: format!(
            "tool vibration {} rms above {:.0} Hz, peak at {:.0} Hz, at {}",
            THRESHOLD.unit.show(found.rms_m),
            found.from_hz,
            found.frequency_hz,
            case.evidence.moment(case.evidence.origin.shifted(found.at_s)),
        ),
        evidence: Evidence { effect_m: Some(found.rms_m), ..Evidence::default() },
        fix: format!("check servo dead band, loose joints and gains; seen in {}", stream.topic()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run};
    use crate::finding::Status;

    #[test]
    fn noise_that_hides_shake_leaves_it_open() {
        for (rms_m, resolved_m, status) in [
            (1e-3, 1e-3, Status::Fail),
            (0.0, 1e-3, Status::Inconclusive),
            (1e-4, 1e-5, Status::Pass),
        ] {
            let mut run = clean_run();
            let shake = Shake { rms_m, resolved_m, frequency_hz: 12.0, ..Shake::default() };
            run.robots[0].shakes[0].shake = Ok(shake);
            let (rows, _) = ask(&MOT001, &run);
            assert_eq!(rows[0].status, status, "{:?}", rows[0]);
        }
    }
}
