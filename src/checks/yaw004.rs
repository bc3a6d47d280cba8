use serde_json::json;

use crate::checks::decision::{DEGREE, Decision, Figure, decide, unseen};
use crate::checks::{Facts, Grade, Judged};
use crate::diagnosis::GyroBias;
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// A gyro has a bias.
    ///
    /// ## What it means
    /// The gyro reads a constant rate beside the one that the arm's kinematics say; the figure is
    /// its norm.
    ///
    /// ## Why it matters
    /// Whoever integrates it turns away at that rate: 0.1 °/s is 6° after a minute.
    ///
    /// ## Evidence
    /// The constant part of (gyro − angular rate by FK), fitted together with the IMU's latency and
    /// mount: `vector_rad_s` in the sensor's frame, and `yaw_rate_rad_s`, what yaw that is integrated
    /// from this gyro would drift by.
    ///
    /// ## How to fix
    /// Subtract the bias; estimate it anew whenever the arm rests, since it moves with temperature.
    ///
    /// ## When it misleads
    /// The Earth turns at 0.004 °/s, which is below the figure. A driver that removes the bias by
    /// itself leaves what it has not yet learnt.
    YAW004 {
        name: "gyro-bias",
        grade: Grade::From(&[FIGURE]),
        headline: false,
        needs_model: true,
        missing: "no IMU on the arm",
        check: check,
    }
}

const FIGURE: Figure =
    Figure { unit: Unit::GyroRate, warning: 0.1 * DEGREE, error: 1.0 * DEGREE };

/// What would tell where the bias could not be had.
const SETTLE: &str = "record 10 s with rests";

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    let imus = facts.robots.iter().flat_map(|arm| arm.imus.iter().map(move |imu| (arm, imu)));
    let judged = imus.map(|(arm, (imu, diagnosis))| {
        let subject = arm.topic(&imu.topic);
        let bias = match &diagnosis.gyro_bias {
            Ok(bias) => bias,
            Err(why) => return Judged::new(subject, unseen(why, SETTLE)).within(imu.span),
        };
        let outcome = match decide(&bias.norm_rad_s, &FIGURE, subjects) {
            Decision::Pass => Outcome::sound(),
            Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
            Decision::Fail(severity) => Outcome::faulty(fault(bias, severity)),
        };
        Judged::new(subject, outcome)
            .within(imu.span)
            .estimated(Estimate::amount("gyro bias", FIGURE.unit, &bias.norm_rad_s))
    });
    judged.collect()
}

fn fault(bias: &GyroBias, severity: Severity) -> Fault {
    let vector: [f64; 3] = bias.vector_rad_s.into();
    let [x, y, z] = vector.map(|rate| format!("{rate:+.4}"));
    let drift = Unit::RadianPerSecond.show(bias.yaw_rate_rad_s);
    let mut evidence = Evidence {
        effect: Some(format!("yaw that is integrated from it drifts {drift}")),
        ..Evidence::default()
    };
    evidence.more.insert("vector_rad_s".to_owned(), json!(vector));
    evidence.more.insert("yaw_rate_rad_s".to_owned(), json!(bias.yaw_rate_rad_s));
    Fault {
        severity,
        title: "gyro bias",
        message: format!("gyro reads {} at rest", FIGURE.unit.show_measured(&bias.norm_rad_s)),
        evidence,
        fix: format!("subtract ({x}, {y}, {z}) rad/s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, sure};
    use crate::geometry::Vec3;

    #[test]
    fn a_bias_is_named_with_its_vector() {
        let mut facts = clean_run();
        facts.robots[0].imus[0].1.gyro_bias = Ok(GyroBias {
            vector_rad_s: Vec3::new(0.0, 0.03, -0.04),
            norm_rad_s: sure(0.05),
            yaw_rate_rad_s: -0.04,
        });
        let (_, findings) = ask(&YAW004, &facts);
        assert_eq!(findings[0].severity, Severity::Error);
        assert_eq!(findings[0].fix, "subtract (+0.0000, +0.0300, -0.0400) rad/s");
    }
}
