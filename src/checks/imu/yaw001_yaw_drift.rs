use serde_json::{Value, json};

use super::{AXES, unless_fk_is_wrong};
use crate::checks::decision::{DEGREE, Threshold, decide, not_observable};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{HeadingError, Measured, YawJump, YawProfile, YawWarmUp};
use crate::evidence::{ArmEvidence, ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Severity, Unit};

rule! {
    /// IMU yaw drifts or jumps relative to the arm.
    ///
    /// ## What it means
    /// The IMU's heading about gravity changes differently from FK's. The estimate is the rate of (IMU yaw
    /// − FK yaw), or the size of a permanent jump. A constant yaw offset between the IMU's world and the
    /// robot's base is not a fault.
    ///
    /// ## Why it matters
    /// Gravity constrains roll and pitch, but only a magnetometer or another reference constrains yaw.
    /// Anything fused with this IMU rotates away: 1° in 20 s at 3 °/min, or at once if a magnet passes.
    ///
    /// ## Evidence
    /// The slope of the yaw error, corrected for joint zero offsets; its interval allows for correlated
    /// noise. `effect` is the total over the run. `kind` is the model that explains the error with the
    /// fewest parameters:
    ///
    /// - `drift`: a constant rate.
    /// - `jump`: `jumps` lists the time of each, from the start of the log, and its size.
    /// - `random-walk`: `walk_rad_rt_s` is its density in rad/√s. A walk drifts by chance, so it widens the
    ///   interval.
    /// - `heading`: an error that depends on the heading (first and second harmonic: hard and soft iron) of
    ///   the IMU's `axis`.
    /// - `warm-up`: a drift that decays with `time_constant_s`.
    ///
    /// All parts are fitted together. The links may deviate from the model by the usual 0.04° per axis, so an
    /// error that depends on the posture is neither drift nor jump. If poses and FK differ by an unexplained
    /// rotation (MDL001), only a yaw error of five times its size is a finding.
    ///
    /// ## How to fix
    /// Take yaw from kinematics, or give the filter a heading reference. Calibrate the gyro bias while the
    /// arm rests. For a jump, keep the magnetometer away from steel and motors, or disable it.
    ///
    /// ## When it misleads
    /// It needs orientation in the log (`orientation_covariance[0]` not −1). Short runs are inconclusive: 1
    /// s determines a drift to ±0.5 °/min at best. Errors of a magnetometer near motors depend on position
    /// and look like a random walk.
    YAW001 {
        name: "yaw-drift",
        grade: Grade::From(&[THRESHOLD, JUMP]),
        headline: true,
        needs_model: true,
        missing: "no IMU with orientation on the arm",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold {
    unit: Unit::RadianPerSecond,
    warning: 0.2 * DEGREE / 60.0,
    error: 2.0 * DEGREE / 60.0,
};

/// Several times the wander of a good filter; larger jumps affect poses.
const JUMP: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.5 * DEGREE, error: 2.0 * DEGREE };

const SETTLE: &str = "record a minute or more, with rests";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.imus().flat_map(|(arm, imu)| judge(case, arm, imu)).collect()
}

/// Drift, and the largest jump, heading error and warm-up if significant.
fn judge(case: &Case, arm: &ArmEvidence, imu: &StreamEvidence<ImuEvidence>) -> Vec<SubjectResult> {
    let subjects = case.evidence.subjects();
    let [drift_threshold, jump_threshold] =
        [THRESHOLD, JUMP].map(|own| case.thresholds.threshold(&YAW001, own));
    let drift = match &imu.diagnosis.yaw_drift_rad_s {
        Ok(drift) => drift,
        Err(why) => return vec![imu.judged(not_observable(why, SETTLE))],
    };
    let profile = &imu.diagnosis.yaw_profile;
    let trusted = |outcome, yaw_rad| unless_fk_is_wrong(outcome, arm, yaw_rad);
    let outcome = decide(drift, &drift_threshold, subjects)
        .into_outcome(&describe_profile(profile), |severity| drift_fault(imu, drift, severity));
    let outcome = trusted(outcome, drift.value * imu.seconds());
    let estimate = Estimate::scalar("yaw drift", THRESHOLD.unit, drift);
    let kind = if profile.walk_rad_per_sqrt_s.is_some() { "random-walk" } else { "drift" };
    let mut judged = vec![with_profile(imu.judged(outcome).estimated(estimate), profile, kind)];
    let size = |jump: &&YawJump| jump.size_rad.value.abs();
    let largest = profile.jumps.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    // Smaller jumps are only removed from the drift.
    if let Some(jump) = largest.filter(|jump| size(jump) >= jump_threshold.warning) {
        let outcome = decide(&jump.size_rad, &jump_threshold, subjects)
            .into_outcome(SETTLE, |severity| jumps(jump, severity));
        let outcome = trusted(outcome, jump.size_rad.value);
        let estimate = Estimate::scalar("yaw jump", JUMP.unit, &jump.size_rad);
        let of_jump = imu.judged(outcome).estimated(estimate);
        judged.push(with_profile(of_jump, profile, "jump"));
    }
    if let Some(heading) = &profile.heading
        && heading.amplitude_rad.value >= jump_threshold.warning
    {
        let amplitude = &heading.amplitude_rad;
        let outcome = decide(amplitude, &jump_threshold, subjects)
            .into_outcome(SETTLE, |severity| depends(heading, severity));
        let outcome = trusted(outcome, amplitude.value);
        let estimate = Estimate::scalar("yaw error by heading", JUMP.unit, amplitude);
        let of_heading = imu.judged(outcome).estimated(estimate).with_evidence("kind", "heading");
        judged.push(of_heading.with_evidence("axis", AXES[heading.axis]));
    }
    if let Some(warm_up) = &profile.warm_up
        && warm_up.at_first_rad_s.value.abs() >= drift_threshold.warning
    {
        let at_first = &warm_up.at_first_rad_s;
        let outcome = decide(at_first, &drift_threshold, subjects)
            .into_outcome(SETTLE, |severity| warm_up_fault(warm_up, severity));
        let outcome = trusted(outcome, warm_up.turned_rad.value);
        let estimate = Estimate::scalar("yaw drift", THRESHOLD.unit, at_first);
        let settling = imu.judged(outcome).estimated(estimate).with_evidence("kind", "warm-up");
        judged.push(settling.with_evidence("time_constant_s", warm_up.time_constant_s));
    }
    judged
}

fn depends(heading: &HeadingError, severity: Severity) -> Fault {
    let size = JUMP.unit.show_measured(&heading.amplitude_rad);
    Fault {
        severity,
        cause: Cause::YawJump,
        title: "IMU yaw depends on heading",
        message: format!(
            "yaw error depends on the heading of imu {}, up to ±{size}: hard or soft iron, not drift",
            AXES[heading.axis]
        ),
        evidence: Evidence::default(),
        fix:
            "calibrate the magnetometer on the arm, keep it away from steel and motors, or disable it"
                .to_owned(),
    }
}

fn warm_up_fault(warm_up: &YawWarmUp, severity: Severity) -> Fault {
    let [rate, total] = [
        THRESHOLD.unit.show_signed(&warm_up.at_first_rad_s),
        JUMP.unit.show_signed(&warm_up.turned_rad),
    ];
    let tau_s = warm_up.time_constant_s;
    Fault {
        severity,
        cause: Cause::YawJump,
        title: "IMU yaw drifts while it warms up",
        message: format!(
            "yaw drifts {rate} at first and settles with a time constant of {tau_s:.1} s: warm-up"
        ),
        evidence: Evidence {
            effect: Some(format!("{total} in total, then no drift")),
            ..Evidence::default()
        },
        fix: format!("power on the IMU {:.0} s before use", (5.0 * tau_s).ceil()),
    }
}

fn describe_profile(profile: &YawProfile) -> String {
    match profile.walk_rad_per_sqrt_s {
        Some(density) => {
            format!("the yaw wanders by {}/√s; {SETTLE}", Unit::Radian.show(density))
        }
        None => SETTLE.to_owned(),
    }
}

fn with_profile(judged: SubjectResult, profile: &YawProfile, kind: &str) -> SubjectResult {
    let mut judged = judged.with_evidence("kind", kind);
    if let Some(density) = profile.walk_rad_per_sqrt_s {
        judged = judged.with_evidence("walk_rad_rt_s", density);
    }
    if !profile.jumps.is_empty() {
        judged =
            judged.with_evidence("jumps", profile.jumps.iter().map(jump_json).collect::<Vec<_>>());
    }
    judged
}

fn jump_json(jump: &YawJump) -> Value {
    let size = jump.size_rad;
    json!({"at_s": jump.at_s, "rad": size.value, "ci95": size.interval(0.95)})
}

fn drift_fault(imu: &StreamEvidence<ImuEvidence>, drift: &Measured, severity: Severity) -> Fault {
    let seconds = imu.seconds();
    let drifted = Unit::Radian.show(drift.value.abs() * seconds);
    let reference = imu.subject.reference.as_deref();
    Fault {
        severity,
        cause: Cause::YawDrift(*drift),
        title: "IMU yaw drifts",
        message: format!(
            "yaw drifts {} against {}",
            THRESHOLD.unit.show_signed(drift),
            reference.unwrap_or("the arm")
        ),
        evidence: Evidence {
            effect: Some(format!("{drifted} over this run of {seconds:.1} s")),
            ..Evidence::default()
        },
        fix: format!(
            "take yaw from {}, or enable a magnetometer or another heading reference in the filter",
            reference.unwrap_or("FK")
        ),
    }
}

fn jumps(jump: &YawJump, severity: Severity) -> Fault {
    let size = JUMP.unit.show_signed(&jump.size_rad);
    Fault {
        severity,
        cause: Cause::YawJump,
        title: "IMU yaw jumps",
        message: format!("yaw jumps by {size} against the arm at +{:.2} s", jump.at_s),
        evidence: Evidence::default(),
        fix: "take yaw from FK, or keep the magnetometer away from steel and motors".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, precise};
    use crate::finding::Status;

    #[test]
    fn a_jump_is_a_finding_although_the_drift_passes() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.yaw_profile.jumps =
            vec![YawJump { at_s: 4.5, size_rad: precise(-DEGREE) }];
        let (rows, findings) = evaluate_rule(&YAW001, &run);
        assert_eq!([rows[0].status, rows[1].status], [Status::Pass, Status::Fail]);
        assert_eq!(findings[0].message, "yaw jumps by -1.000 ± 0.001° against the arm at +4.50 s");
        assert_eq!(findings[0].evidence.more["kind"], "jump");
        assert_eq!(findings[0].evidence.more["jumps"][0]["at_s"], 4.5);
    }

    #[test]
    fn a_small_jump_is_corrected_and_not_reported() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.yaw_profile.jumps =
            vec![YawJump { at_s: 4.5, size_rad: precise(0.3 * DEGREE) }];
        let (rows, findings) = evaluate_rule(&YAW001, &run);
        assert!(rows.len() == 1 && findings.is_empty(), "{rows:?}");
    }

    #[test]
    fn a_drift_within_a_random_walk_is_described() {
        let mut run = clean_run();
        let imu = &mut run.robots[0].imus[0].diagnosis;
        imu.yaw_drift_rad_s = Ok(Measured { std_error: 1e-2, ..precise(1e-3) });
        imu.yaw_profile.walk_rad_per_sqrt_s = Some(0.5 * DEGREE);
        let (rows, _) = evaluate_rule(&YAW001, &run);
        assert_eq!(rows[0].status, Status::Inconclusive);
        let reason = rows[0].reason.as_deref().unwrap_or_default();
        assert!(reason.contains("the yaw wanders by 0.5°/√s"), "{reason}");
    }
}
