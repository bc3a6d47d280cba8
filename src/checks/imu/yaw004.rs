use serde_json::{Value, json};

use crate::checks::decision::{DEGREE, Threshold, decide_length, unseen};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{GyroBias, GyroShape, Measured};
use crate::evidence::{ImuEvidence, Of};
use crate::finding::{Cause, Estimate, Evidence, Fault, Severity, Unit};

rule! {
    /// A gyro has a bias.
    ///
    /// ## What it means
    /// The gyro reads a constant rate beside the one that the arm's kinematics say; the amount is
    /// its norm.
    ///
    /// ## Why it matters
    /// Whoever integrates it turns away at that rate: 0.1 °/s is 6° after a minute.
    ///
    /// ## Evidence
    /// The constant part of (gyro − angular rate by FK), fitted together with the IMU's latency and
    /// mount to the turns between moments: `vector_rad_s` in the sensor's frame, and
    /// `yaw_rate_rad_s`, what yaw that is integrated from this gyro would drift by. Where the gyro
    /// surely reads rates too large, too small or askew, `scale` (along x, y and z) and
    /// `misalignment_rad` (of y and z, x and z, x and y) say by how much; they are no part of the
    /// bias.
    ///
    /// ## How to fix
    /// Subtract the bias; estimate it anew whenever the arm rests, since it moves with temperature.
    ///
    /// ## When it misleads
    /// The Earth turns at 0.004 °/s, which is below the threshold. A driver that removes the bias by
    /// itself leaves what it has not yet learnt.
    YAW004 {
        name: "gyro-bias",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no IMU on the arm",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::GyroRate, warning: 0.1 * DEGREE, error: 1.0 * DEGREE };

/// What would tell where the bias could not be had.
const SETTLE: &str = "record 10 s with rests";

fn check(case: &Case) -> Vec<Judged> {
    case.evidence.imus().map(|(_, imu)| judge(case, imu)).collect()
}

fn judge(case: &Case, imu: &Of<ImuEvidence>) -> Judged {
    let bias = match &imu.diagnosis.gyro_bias {
        Ok(bias) => bias,
        Err(why) => return imu.judged(unseen(why, SETTLE)),
    };
    let decision = decide_length(
        &bias.length_rad_s,
        &case.thresholds.of(&YAW004, THRESHOLD),
        case.evidence.subjects(),
    );
    let outcome = decision.into_outcome(SETTLE, |severity| fault(bias, severity));
    let judged = imu.judged(outcome).estimated(Estimate::length(
        "gyro bias",
        THRESHOLD.unit,
        &bias.length_rad_s,
    ));
    match &bias.shape {
        Some(GyroShape { scale, misalignment_rad }) => judged
            .with_evidence("scale", scale.map(shown).to_vec())
            .with_evidence("misalignment_rad", misalignment_rad.map(shown).to_vec()),
        None => judged,
    }
}

/// A number with its interval, as evidence.
fn shown(measured: Measured) -> Value {
    json!({"value": measured.value, "ci95": measured.interval(0.95)})
}

fn fault(bias: &GyroBias, severity: Severity) -> Fault {
    let vector: [f64; 3] = bias.vector_rad_s.into();
    let [x, y, z] = vector.map(|rate| format!("{rate:+.4}"));
    let drift = Unit::RadianPerSecond.show(bias.yaw_rate_rad_s);
    let shown = THRESHOLD.unit.show_measured(&bias.length_rad_s.norm);
    let mut evidence = Evidence {
        effect: Some(format!("yaw that is integrated from it drifts {drift}")),
        ..Evidence::default()
    };
    evidence.more.insert("vector_rad_s".to_owned(), json!(vector));
    evidence.more.insert("yaw_rate_rad_s".to_owned(), json!(bias.yaw_rate_rad_s));
    Fault {
        cause: Cause::Other,
        severity,
        title: "gyro bias",
        message: format!("gyro reads {shown} at rest"),
        evidence,
        fix: format!("subtract ({x}, {y}, {z}) rad/s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, length};
    use crate::geometry::Vec3;

    #[test]
    fn a_bias_is_named_with_its_vector() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.gyro_bias = Ok(GyroBias {
            vector_rad_s: Vec3::new(0.0, 0.03, -0.04),
            length_rad_s: length(0.05),
            yaw_rate_rad_s: -0.04,
            shape: None,
        });
        let (_, findings) = ask(&YAW004, &run);
        assert_eq!(findings[0].severity, Severity::Error);
        assert_eq!(findings[0].fix, "subtract (+0.0000, +0.0300, -0.0400) rad/s");
    }
}
