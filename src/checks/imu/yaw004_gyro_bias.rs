use serde_json::{Value, json};

use crate::checks::decision::{DEGREE, Decision, Threshold, decide_length, not_observable};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{GyroBias, GyroBiasChange, GyroBiasProfile, GyroScaleError, Measured};
use crate::evidence::{ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Change, Estimate, Evidence, Fault, Picture, Severity, Unit};
use crate::geometry::Vec3;

rule! {
    /// A gyro has a bias.
    ///
    /// ## What it means
    /// The gyro reads a constant rate in addition to the angular rate by FK. The estimate is its norm.
    ///
    /// ## Why it matters
    /// Integrated, it drifts the heading: 0.1 °/s is 6° after a minute.
    ///
    /// ## Evidence
    /// The constant part of (gyro − angular rate by FK), fitted with the IMU's latency and mount to
    /// rotations over time intervals.
    ///
    /// - `vector_rad_s`: the bias in the sensor frame.
    /// - `yaw_rate_rad_s`: drift of a yaw integrated from this gyro.
    /// - `scale` (along x, y, z) and `misalignment_rad` (of y and z, x and z, x and y): not part of the
    ///   bias; given if significant. If one scale explains the rates about all axes that turn, it is given three times,
    ///   without misalignment.
    /// - `kind`: `step` or `warm-up` if the bias changes significantly. `from_vector_rad_s`,
    ///   `to_vector_rad_s`: bias before and after. `change_ns`: time of a step. `time_constant_s`: of a
    ///   warm-up. `value` is the size of the change if that reaches the threshold, otherwise the larger
    ///   bias.
    ///
    /// ## How to fix
    /// Subtract the bias. Re-estimate it whenever the arm rests, because it depends on temperature.
    ///
    /// ## When it misleads
    /// The Earth rotates at 0.004 °/s, below the threshold. A driver that removes the bias itself may not
    /// yet have converged.
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

const SETTLE: &str = "record 10 s with rests";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.imus().map(|(_, imu)| judge(case, imu)).collect()
}

fn judge(case: &Case, imu: &StreamEvidence<ImuEvidence>) -> SubjectResult {
    let bias = match &imu.diagnosis.gyro_bias {
        Ok(bias) => bias,
        Err(why) => return imu.judged(not_observable(why, SETTLE)),
    };
    let threshold = case.thresholds.threshold(&YAW004, THRESHOLD);
    let subjects = case.evidence.subjects();
    let changes = bias.change.as_ref().and_then(|change| {
        let decision = decide_length(&change.size_rad_s, &threshold, subjects);
        matches!(decision, Decision::Fail(_)).then_some((decision, change))
    });
    let mut judged = match changes {
        Some((decision, change)) if !is_mostly_constant(change) => {
            let outcome = decision.into_outcome(SETTLE, |severity| changed(case, change, severity));
            imu.judged(outcome).estimated(estimate(case, change))
        }
        _ => {
            let decision = decide_length(&bias.length_rad_s, &threshold, subjects);
            let outcome = decision.into_outcome(SETTLE, |severity| fault(bias, severity));
            let estimate = Estimate::length("gyro bias", THRESHOLD.unit, &bias.length_rad_s);
            imu.judged(outcome).estimated(estimate)
        }
    };
    if let Some(change) = &bias.change {
        judged = with_change(judged, change);
    }
    if let Some(GyroScaleError { scale, misalignment_rad }) = &bias.scale_error {
        judged = judged.with_evidence("scale", scale.map(measured_json).to_vec());
        if let Some(angles) = misalignment_rad {
            judged = judged.with_evidence("misalignment_rad", angles.map(measured_json).to_vec());
        }
    }
    judged
}

/// The fault is then the bias, and the change is evidence.
fn is_mostly_constant(change: &GyroBiasChange) -> bool {
    let smaller = change.before_rad_s.norm().min(change.after_rad_s.norm());
    smaller > change.size_rad_s.norm.value
}

/// For a step, with the values before and after, and the time.
fn estimate(case: &Case, change: &GyroBiasChange) -> Estimate {
    let size = Estimate::length("gyro bias", THRESHOLD.unit, &change.size_rad_s);
    match change.profile {
        GyroBiasProfile::Step { at_s, interval_s } => size.with_change(Change {
            from: change.before_rad_s.norm(),
            to: change.after_rad_s.norm(),
            change_ns: case.evidence.origin.shifted(at_s),
            change_ci95_ns: Some(interval_s.map(|end_s| case.evidence.origin.shifted(end_s))),
        }),
        GyroBiasProfile::WarmUp { .. } => size,
    }
}

fn with_change(judged: SubjectResult, change: &GyroBiasChange) -> SubjectResult {
    let [before, after] = [change.before_rad_s, change.after_rad_s].map(<[f64; 3]>::from);
    let judged = judged
        .with_evidence("from_vector_rad_s", before.to_vec())
        .with_evidence("to_vector_rad_s", after.to_vec());
    match change.profile {
        GyroBiasProfile::Step { .. } => judged.with_evidence("kind", "step"),
        GyroBiasProfile::WarmUp { time_constant_s } => judged
            .with_evidence("kind", "warm-up")
            .with_evidence("time_constant_s", time_constant_s),
    }
}

fn changed(case: &Case, change: &GyroBiasChange, severity: Severity) -> Fault {
    let [from, to] =
        [change.before_rad_s, change.after_rad_s].map(|bias| Unit::GyroRate.show(bias.norm()));
    let size = THRESHOLD.unit.show_measured(&change.size_rad_s.norm);
    let subtract = subtraction(change.after_rad_s);
    let (title, message, fix) = match change.profile {
        GyroBiasProfile::Step { at_s, .. } => {
            let when = case.evidence.moment(case.evidence.origin.shifted(at_s));
            (
                "gyro bias changes",
                format!("gyro bias steps by {size} at {when}, from {from} to {to}"),
                format!("re-estimate the bias after {when}: {subtract} from then on"),
            )
        }
        GyroBiasProfile::WarmUp { time_constant_s } => (
            "gyro bias settles",
            format!(
                "gyro bias settles by {size} with a time constant of {time_constant_s:.1} s, from \
                 {from} to {to}: warm-up"
            ),
            format!(
                "power on the IMU {:.0} s before use, then {subtract}",
                (5.0 * time_constant_s).ceil()
            ),
        ),
    };
    Fault {
        severity,
        cause: Cause::Pictured(Picture::Gyro),
        title,
        message,
        evidence: Evidence::default(),
        fix,
    }
}

/// Correction of a bias in words.
fn subtraction(bias_rad_s: Vec3) -> String {
    let [x, y, z] = <[f64; 3]>::from(bias_rad_s).map(|rate| format!("{rate:+.4}"));
    format!("subtract ({x}, {y}, {z}) rad/s")
}

/// Value with its 95 % interval.
fn measured_json(measured: Measured) -> Value {
    json!({"value": measured.value, "ci95": measured.interval(0.95)})
}

fn fault(bias: &GyroBias, severity: Severity) -> Fault {
    let vector: [f64; 3] = bias.vector_rad_s.into();
    let drift = Unit::RadianPerSecond.show(bias.yaw_rate_rad_s);
    let shown = THRESHOLD.unit.show_measured(&bias.length_rad_s.norm);
    let change = bias.change.as_ref().map_or(String::new(), |change| {
        format!(
            "; it changes by {} within the run",
            Unit::GyroRate.show(change.size_rad_s.norm.value)
        )
    });
    let mut evidence = Evidence {
        effect: Some(format!("integrating it drifts yaw by {drift}")),
        ..Evidence::default()
    };
    evidence.more.insert("vector_rad_s".to_owned(), json!(vector));
    evidence.more.insert("yaw_rate_rad_s".to_owned(), json!(bias.yaw_rate_rad_s));
    Fault {
        cause: Cause::Pictured(Picture::Gyro),
        severity,
        title: "gyro bias",
        message: format!("gyro reads {shown} at rest{change}"),
        evidence,
        fix: subtraction(bias.vector_rad_s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, length};

    #[test]
    fn a_bias_step_reports_values_and_time() {
        let mut run = clean_run();
        run.start = Some(run.origin);
        let bias = run.robots[0].imus[0].diagnosis.gyro_bias.as_mut().unwrap();
        let profile = GyroBiasProfile::Step { at_s: 15.0, interval_s: [14.9, 15.1] };
        let (before_rad_s, after_rad_s) = (Vec3::zeros(), Vec3::new(0.0, 2.0 * DEGREE, 0.0));
        let size_rad_s = length(2.0 * DEGREE);
        bias.change = Some(GyroBiasChange { profile, before_rad_s, after_rad_s, size_rad_s });
        let (_, findings) = evaluate_rule(&YAW004, &run);
        assert_eq!(
            findings[0].message,
            "gyro bias steps by 2.000 ± 0.001 °/s at +15.00 s, from 0 °/s to 2 °/s"
        );
        let change = findings[0].estimate.as_ref().and_then(Estimate::change).unwrap();
        assert_eq!((change.from, change.change_ns.nanos()), (0.0, 15_000_000_000));
        bias_of(&mut run).change.as_mut().unwrap().profile =
            GyroBiasProfile::WarmUp { time_constant_s: 8.0 };
        let (_, findings) = evaluate_rule(&YAW004, &run);
        assert_eq!(findings[0].title, "gyro bias settles");
        assert_eq!(findings[0].evidence.more["kind"], "warm-up");
    }

    #[test]
    fn a_small_step_of_a_large_bias_is_reported_as_bias() {
        let mut run = clean_run();
        let bias = bias_of(&mut run);
        let profile = GyroBiasProfile::Step { at_s: 15.0, interval_s: [14.9, 15.1] };
        let before_rad_s = Vec3::new(0.0, 2.4 * DEGREE, 0.0);
        let after_rad_s = Vec3::new(0.0, 2.65 * DEGREE, 0.0);
        let size_rad_s = length(0.25 * DEGREE);
        bias.change = Some(GyroBiasChange { profile, before_rad_s, after_rad_s, size_rad_s });
        (bias.vector_rad_s, bias.length_rad_s) = (after_rad_s, length(2.65 * DEGREE));
        let (_, findings) = evaluate_rule(&YAW004, &run);
        assert_eq!(findings[0].title, "gyro bias");
        assert_eq!(
            findings[0].message,
            "gyro reads 2.650 ± 0.001 °/s at rest; it changes by 0.25 °/s within the run"
        );
    }

    fn bias_of(run: &mut crate::evidence::RunEvidence) -> &mut GyroBias {
        run.robots[0].imus[0].diagnosis.gyro_bias.as_mut().unwrap()
    }

    #[test]
    fn a_bias_is_reported_with_its_vector() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.gyro_bias = Ok(GyroBias {
            vector_rad_s: Vec3::new(0.0, 0.03, -0.04),
            length_rad_s: length(0.05),
            yaw_rate_rad_s: -0.04,
            scale_error: None,
            change: None,
        });
        let (_, findings) = evaluate_rule(&YAW004, &run);
        assert_eq!(findings[0].severity, Severity::Error);
        assert_eq!(findings[0].fix, "subtract (+0.0000, +0.0300, -0.0400) rad/s");
    }
}
