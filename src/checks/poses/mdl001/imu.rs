//! An IMU against FK: what it leaves, the gain of its gyro, and where that saturates.

use serde_json::json;

use super::MDL001;
use crate::checks::decision::{FrameThresholds, decide};
use crate::checks::standing::Left;
use crate::checks::{Case, Judged, Threshold};
use crate::diagnosis::{Clipped, Measured, Rates};
use crate::evidence::{ImuEvidence, Of};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Sight, Unit};

/// The gain of a gyro less 1, and the share of its samples that saturate: data sheets of MEMS gyros allow
/// three percent.
pub const GAIN: Threshold = Threshold { unit: Unit::One, warning: 0.04, error: 0.1 };

/// What would tell where the gain could not be had.
const SETTLE: &str = "turn the IMU through 60° about three axes";

/// The axes of a gyro.
const AXES: [&str; 3] = ["x", "y", "z"];

/// What is wrong with the gyro itself, else whether the IMU turns as the arm does.
pub fn judge(case: &Case, thresholds: &FrameThresholds, imu: &Of<ImuEvidence>) -> Vec<Judged> {
    let threshold = case.thresholds.of(&MDL001, GAIN);
    let clipped = imu.diagnosis.numbers.clipped.as_ref();
    let clipped = clipped.map(|clipped| saturates(imu, clipped, &threshold));
    let found: Vec<Judged> = clipped.into_iter().chain(gain(case, imu, &threshold)).collect();
    let odd = odd(thresholds, imu);
    match (found.is_empty(), odd) {
        (false, Outcome::Evaluated(_)) => found,
        (_, odd) => found.into_iter().chain([imu.judged(odd).within(imu.span)]).collect(),
    }
}

/// Whether an IMU turns as the arm does, by its orientation, which is a filter's and so judged from the
/// second threshold on, by its gyro, and by the gravity that it feels.
fn odd(thresholds: &FrameThresholds, imu: &Of<ImuEvidence>) -> Outcome {
    /// A gyro that leaves a larger share of the arm's rate says something else.
    const SHARE: f64 = 0.3;
    /// Standard gravity, m/s², and by which share of it a healthy accelerometer's median may be off on
    /// an arm that moves.
    const GRAVITY: (f64, f64) = (9.81, 0.2);
    let Some(proof) = &imu.proof else {
        return Outcome::Skipped("it does not turn with the arm".to_owned());
    };
    let mut odd = Vec::new();
    let angle = Threshold { warning: thresholds.angle.error, ..thresholds.angle };
    let coarse = FrameThresholds { angle, ..*thresholds };
    if let Some(left) = proof.turning.as_ref().and_then(|error| Left::beyond(error, &coarse)) {
        let most = Unit::Radian.show(left.worst.amount.most);
        odd.push(format!("its orientation is up to {most} off beside what was found"));
    }
    if let Some(Rates { scale, left, by_fk, noise }) = proof.rates
        && left > SHARE * by_fk
        && left > 2.0 * noise
    {
        odd.push(format!(
            "its gyro turns {scale:.2} times as fast as the arm, and leaves {} of {}",
            Unit::GyroRate.show(left),
            Unit::GyroRate.show(by_fk)
        ));
    }
    let (standard, share) = GRAVITY;
    if let Some(felt) = proof.gravity_m_s2.filter(|felt| (felt / standard - 1.0).abs() > share) {
        odd.push(format!("its accelerometer feels {felt:.2} m/s², where gravity is {standard}"));
    }
    if odd.is_empty() {
        return Outcome::sound();
    }
    Outcome::Inconclusive(format!(
        "{}; no finding accounts for that: check its units and axes",
        odd.join("; ")
    ))
}

fn saturates(imu: &Of<ImuEvidence>, clipped: &Clipped, threshold: &Threshold) -> Judged {
    let Clipped { limit_rad_s, axes, share, by_fk_rad_s } = clipped;
    let [limit, by_fk] = [*limit_rad_s, *by_fk_rad_s].map(|rate| Unit::GyroRate.show(rate));
    let names: Vec<&str> = axes.iter().map(|&axis| AXES[axis]).collect();
    let on = names.join(", ");
    let percent = 100.0 * share;
    let fault = Fault {
        severity: threshold.severity(*share).unwrap_or(Severity::Warning),
        cause: Cause::Seen(Sight::Stream),
        title: "gyro saturates",
        message: format!(
            "gyro saturates at {limit} on {on} while the arm turns at up to {by_fk} ({percent:.1} % of \
             the samples)"
        ),
        evidence: Evidence {
            effect: Some("what is integrated from it turns too little".to_owned()),
            ..Evidence::default()
        },
        fix: format!("set the gyro's full-scale range above {by_fk}, or turn more slowly"),
    };
    let unit = Unit::GyroRate.symbol();
    imu.judged(Outcome::faulty(fault))
        .within(imu.span)
        .estimated(Estimate::counted("gyro saturation", unit, *limit_rad_s))
        .with_evidence("axes", names)
        .with_evidence("share", *share)
        .with_evidence("by_fk_rad_s", *by_fk_rad_s)
}

/// The gain of the axis on which it is furthest from 1; `None` where the gyro surely has none.
fn gain(case: &Case, imu: &Of<ImuEvidence>, threshold: &Threshold) -> Option<Judged> {
    let scale = imu.diagnosis.gyro_bias.as_ref().ok()?.shape?.scale;
    let worst = scale.iter().max_by(|a, b| a.value.abs().total_cmp(&b.value.abs()))?;
    let subjects = scale.len() * case.evidence.subjects();
    let decision = decide(worst, threshold, subjects);
    if worst.value.abs() < threshold.warning {
        return None;
    }
    let outcome = decision.into_outcome(SETTLE, |severity| reads(imu, &scale, worst, severity));
    let shown = |one: &Measured| json!({"value": one.value, "ci95": one.interval(0.95)});
    let judged = imu.judged(outcome).within(imu.span);
    let judged = judged.estimated(Estimate::amount("gyro gain", GAIN.unit, worst));
    Some(judged.with_evidence("scale", scale.iter().map(shown).collect::<Vec<_>>()))
}

/// A gyro that reads too much or too little.
fn reads(
    imu: &Of<ImuEvidence>,
    scale: &[Measured; 3],
    worst: &Measured,
    severity: Severity,
) -> Fault {
    /// Axes whose gains are this near that of the worst share it.
    const SHARED: f64 = 0.5;
    let shares = |one: &Measured| (one.value - worst.value).abs() < SHARED * worst.value.abs();
    let axes = AXES.iter().zip(scale).filter(|(_, one)| shares(one)).map(|(axis, _)| *axis);
    let axes: Vec<&str> = axes.collect();
    let on = match axes.len() {
        3 => "all axes".to_owned(),
        _ => axes.join(", "),
    };
    let (gain, half) = (1.0 + worst.value, worst.half_width(0.95));
    let percent = GAIN.unit.show_interval(100.0 * worst.value.abs(), 100.0 * half, false);
    let much = if worst.value > 0.0 { "much" } else { "little" };
    let by: Vec<String> = scale.iter().map(|one| format!("{:.4}", 1.0 + one.value)).collect();
    Fault {
        severity,
        cause: Cause::Seen(Sight::Stream),
        title: "gyro gain",
        message: format!(
            "gyro gain {gain:.3} on {on}: it reads {percent} % too {much} against the \
             arm's rate"
        ),
        evidence: Evidence {
            effect: Some(format!("a turn of 90° integrates to {:.1}°", 90.0 * gain)),
            ..Evidence::default()
        },
        fix: format!("divide the rates of {} by ({})", imu.topic(), by.join(", ")),
    }
}
