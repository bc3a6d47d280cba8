use crate::checks::decision::{DEGREE, Threshold, decide_length, unseen};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::Length;
use crate::evidence::{ImuEvidence, Of};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// The roll and pitch of an IMU disagree with gravity.
    ///
    /// ## What it means
    /// The orientation says where up is, and the accelerometer feels it; the two differ by this
    /// angle on average over the run.
    ///
    /// ## Why it matters
    /// A tilt of 1° feigns an acceleration of 0.17 m/s² and turns every pose that is taken from the
    /// IMU.
    ///
    /// ## Evidence
    /// The angle between the mean specific force, turned into the world by the logged orientation,
    /// and the world's vertical, while the arm rests, with an interval from its spread.
    ///
    /// ## How to fix
    /// Calibrate the accelerometer's bias, or level the IMU's world.
    ///
    /// ## When it misleads
    /// An accelerometer whose bias is 0.1 m/s² leans by 0.6°. A run that ends far from where it
    /// began has a mean acceleration, but a small one. Without an accelerometer it cannot be told.
    YAW002 {
        name: "imu-tilt",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no IMU on the arm",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.5 * DEGREE, error: 2.0 * DEGREE };

/// What would tell where the tilt could not be had.
const SETTLE: &str = "record 10 s with rests";

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.imus().map(|(_, imu)| judge(case, imu)).collect()
}

fn judge(case: &Case, imu: &Of<ImuEvidence>) -> Judged {
    let tilt = match &imu.diagnosis.tilt_rad {
        Ok(tilt) => tilt,
        Err(why) => return imu.judged(unseen(why, SETTLE)),
    };
    let as_logged = imu.diagnosis.reading.as_ref().is_ok_and(|reading| reading.best.is_as_logged());
    let outcome = match as_logged {
        false => Outcome::Inconclusive(
            "the orientation is not as logged; read it right first (ORD001 to ORD003)".to_owned(),
        ),
        true => {
            decide_length(tilt, &case.thresholds.of(&YAW002, THRESHOLD), case.evidence.subjects())
                .into_outcome(SETTLE, |severity| fault(tilt, severity))
        }
    };
    let estimate = Estimate::length("tilt against gravity", THRESHOLD.unit, tilt);
    imu.judged(outcome).estimated(estimate)
}

fn fault(tilt: &Length, severity: Severity) -> Fault {
    let shown = THRESHOLD.unit.show_measured(&tilt.norm);
    Fault {
        cause: Cause::Other,
        severity,
        title: "IMU leans",
        message: format!("roll and pitch are {shown} off gravity"),
        evidence: Evidence::default(),
        fix: "calibrate the accelerometer's bias, or level the IMU's world".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{IMU, ask, clean_run, length};

    #[test]
    fn a_lean_beyond_the_figure_is_named_on_its_topic() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.tilt_rad = Ok(length(1.0 * DEGREE));
        let (_, findings) = ask(&YAW002, &run);
        assert_eq!(findings[0].subject.topic.as_deref(), Some(IMU));
        assert_eq!(findings[0].message, "roll and pitch are 1.000 ± 0.001° off gravity");
    }
}
