//! IMU against FK: residuals, gyro gain and saturation.

use serde_json::json;

use super::MDL001;
use crate::checks::decision::{FrameThresholds, decide};
use crate::checks::imu::{GRAVITY_M_S2, MAX_GRAVITY_ERROR, wrong_gravity};
use crate::checks::residual_attribution::ExceedingResidual;
use crate::checks::{Case, SubjectResult, Threshold};
use crate::diagnosis::{GyroResidual, GyroSaturation, GyroScaleError, Measured};
use crate::evidence::{ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};

/// Also of the fraction of saturated samples. Data sheets of MEMS gyros allow a gain error of 3 %.
pub const GAIN: Threshold = Threshold { unit: Unit::One, warning: 0.04, error: 0.1 };

pub(super) const SETTLE: &str = "turn the IMU through 60° about three axes";

const AXES: [&str; 3] = ["x", "y", "z"];

/// Findings on the gyro; if none, whether the IMU rotates with the arm.
pub fn judge(
    case: &Case,
    thresholds: &FrameThresholds,
    imu: &StreamEvidence<ImuEvidence>,
) -> Vec<SubjectResult> {
    let threshold = case.thresholds.threshold(&MDL001, GAIN);
    let clipped = imu.diagnosis.conventions.saturation.as_ref();
    let clipped = clipped.map(|clipped| saturates(imu, clipped, &threshold));
    let found: Vec<SubjectResult> =
        clipped.into_iter().chain(gain(case, imu, &threshold)).collect();
    let deviations = deviations(thresholds, imu);
    match (found.is_empty(), deviations) {
        (false, Outcome::Evaluated(_)) => found,
        (_, deviations) => found.into_iter().chain([imu.judged(deviations)]).collect(),
    }
}

/// Rest by orientation, gyro and measured gravity. The orientation is filtered, so only the error threshold
/// applies.
fn deviations(thresholds: &FrameThresholds, imu: &StreamEvidence<ImuEvidence>) -> Outcome {
    /// Gyro residual over the arm's rate.
    const SHARE: f64 = 0.3;
    let Some(proof) = &imu.proof else {
        return Outcome::Skipped("it does not rotate with the arm".to_owned());
    };
    let mut deviations = Vec::new();
    let angle = Threshold { warning: thresholds.angle.error, ..thresholds.angle };
    let coarse = FrameThresholds { angle, ..*thresholds };
    if let Some(exceeding) = proof
        .orientation
        .as_ref()
        .and_then(|error| ExceedingResidual::from_error_above_noise(error, &coarse))
    {
        let quantile = Unit::Radian.show(exceeding.worst.magnitude.quantile_95);
        deviations.push(format!("its orientation is off by up to {quantile} after correction"));
    }
    if let Some(GyroResidual { scale, residual: exceeding, by_fk, noise }) = proof.gyro
        && (exceeding > SHARE * by_fk || (scale - 1.0).abs() > GAIN.error)
        && exceeding > 2.0 * noise
    {
        deviations.push(format!(
            "its gyro rate is {scale:.2} times the arm's (residual {} of {})",
            Unit::GyroRate.show(exceeding),
            Unit::GyroRate.show(by_fk)
        ));
    }
    // ORD008 and YAW002 report a wrong force at rest.
    if let Some(gravity) = proof.gravity_m_s2.filter(|gravity| {
        wrong_gravity(imu).is_none() && (gravity / GRAVITY_M_S2 - 1.0).abs() > MAX_GRAVITY_ERROR
    }) {
        deviations.push(format!(
            "its accelerometer measures {gravity:.2} m/s² instead of {GRAVITY_M_S2} m/s²"
        ));
    }
    if deviations.is_empty() {
        return Outcome::pass();
    }
    Outcome::Inconclusive(format!(
        "{}; no finding explains this: check its units and axes",
        deviations.join("; ")
    ))
}

fn saturates(
    imu: &StreamEvidence<ImuEvidence>,
    clipped: &GyroSaturation,
    threshold: &Threshold,
) -> SubjectResult {
    let GyroSaturation { limit_rad_s, axes, share, by_fk_rad_s } = clipped;
    let [limit, by_fk] = [*limit_rad_s, *by_fk_rad_s].map(|rate| Unit::GyroRate.show(rate));
    let names: Vec<&str> = axes.iter().map(|&axis| AXES[axis]).collect();
    let on = names.join(", ");
    let percent = 100.0 * share;
    let fault = Fault {
        severity: threshold.severity(*share).unwrap_or(Severity::Warning),
        cause: Cause::Pictured(Picture::Stream),
        title: "gyro saturates",
        message: format!(
            "gyro saturates at {limit} on {on} while the arm turns at up to {by_fk} ({percent:.1} % of \
             the samples)"
        ),
        evidence: Evidence {
            effect: Some("rotations integrated from it are too small".to_owned()),
            ..Evidence::default()
        },
        fix: format!("set the gyro's full-scale range above {by_fk}, or turn more slowly"),
    };
    let unit = Unit::GyroRate.symbol();
    imu.judged(Outcome::fail(fault))
        .estimated(Estimate::exact("gyro saturation", unit, *limit_rad_s))
        .with_evidence("axes", names)
        .with_evidence("share", *share)
        .with_evidence("by_fk_rad_s", *by_fk_rad_s)
}

/// Gain of the worst axis; `None` below the warning threshold.
fn gain(
    case: &Case,
    imu: &StreamEvidence<ImuEvidence>,
    threshold: &Threshold,
) -> Option<SubjectResult> {
    let found = imu.diagnosis.gyro_bias.as_ref().ok()?.scale_error?;
    let scale = found.scale;
    let worst = scale.iter().max_by(|a, b| a.value.abs().total_cmp(&b.value.abs()))?;
    let subjects = scale.len() * case.evidence.subjects();
    let decision = decide(worst, threshold, subjects);
    if worst.value.abs() < threshold.warning {
        return None;
    }
    let outcome = decision.into_outcome(SETTLE, |severity| reads(imu, &found, worst, severity));
    let shown = |one: &Measured| json!({"value": one.value, "ci95": one.interval(0.95)});
    let judged = imu.judged(outcome);
    let judged = judged.estimated(Estimate::scalar("gyro gain", GAIN.unit, worst));
    Some(judged.with_evidence("scale", scale.iter().map(shown).collect::<Vec<_>>()))
}

fn reads(
    imu: &StreamEvidence<ImuEvidence>,
    GyroScaleError { scale, misalignment_rad }: &GyroScaleError,
    worst: &Measured,
    severity: Severity,
) -> Fault {
    /// Axes whose gain error is this close to the worst one are listed with it.
    const SHARED: f64 = 0.5;
    let shares = |one: &Measured| (one.value - worst.value).abs() < SHARED * worst.value.abs();
    let axes = AXES.iter().zip(scale).filter(|(_, one)| shares(one)).map(|(axis, _)| *axis);
    let axes: Vec<&str> = axes.collect();
    let on = match axes.len() {
        _ if misalignment_rad.is_none() => "the axes that turn".to_owned(),
        3 => "all axes".to_owned(),
        _ => axes.join(", "),
    };
    let (gain, half) = (1.0 + worst.value, worst.half_width(0.95));
    let percent = GAIN.unit.show_interval(100.0 * worst.value.abs(), 100.0 * half, false);
    let much = if worst.value > 0.0 { "much" } else { "little" };
    let by: Vec<String> = scale.iter().map(|one| format!("{:.4}", 1.0 + one.value)).collect();
    Fault {
        severity,
        cause: Cause::Pictured(Picture::Stream),
        title: "gyro gain",
        message: format!(
            "gyro gain {gain:.3} on {on}: it reads {percent} % too {much} compared with the arm's rate"
        ),
        evidence: Evidence {
            effect: Some(format!("a turn of 90° integrates to {:.1}°", 90.0 * gain)),
            ..Evidence::default()
        },
        fix: format!("divide the rates of {} by ({})", imu.topic(), by.join(", ")),
    }
}
