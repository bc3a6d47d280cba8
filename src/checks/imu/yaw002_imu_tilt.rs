use super::{GRAVITY_M_S2, MAX_GRAVITY_ERROR, signed_axis, wrong_gravity};
use crate::checks::decision::{DEGREE, Threshold, decide_length, not_observable};
use crate::checks::{CONTRADICTION, Case, Grade, SubjectResult};
use crate::diagnosis::{MeasuredLength, UpDirections};
use crate::evidence::{ImuEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit, rounded};

rule! {
    /// The roll and pitch of an IMU disagree with gravity.
    ///
    /// ## What it means
    /// The mean angle between the verticals by the IMU's orientation and by its accelerometer.
    ///
    /// ## Why it matters
    /// 1° appears as an acceleration of 0.17 m/s² and rotates every pose derived from the IMU.
    ///
    /// ## Evidence
    /// The angle between the world frame's vertical and the mean specific force at rest, rotated into that
    /// frame by the logged orientation. If the arm never rests, the acceleration by FK is subtracted from the
    /// forces in motion. The interval comes from the scatter over the run.
    ///
    /// If the tilt is close to 90° or 180°, the finding names the world axis that points up instead of z
    /// (REP 145): z down is NED. `up_in_world` is the measured up direction in that frame, `up_in_base` the
    /// same in the arm's base by FK and the mount. `contradiction`: another encoding of the orientation
    /// explains the tilt, but the motion does not determine it. The run does not pass.
    ///
    /// If the specific force at rest is below a fifth of gravity, gravity was removed from it, unlike REP 145 says. That
    /// is a warning, as the tilt is then not observable. `felt_m_s2` is the force.
    ///
    /// ## How to fix
    /// Calibrate the accelerometer's bias, or level the IMU's world frame.
    ///
    /// ## When it misleads
    /// An accelerometer bias of 0.1 m/s² is a tilt of 0.6°. Without an accelerometer the tilt is not observable.
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

const SETTLE: &str = "record 10 s with rests";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.imus().map(|(_, imu)| judge(case, imu)).collect()
}

fn judge(case: &Case, imu: &StreamEvidence<ImuEvidence>) -> SubjectResult {
    if let Some(ratio) = wrong_gravity(imu).filter(|ratio| *ratio <= MAX_GRAVITY_ERROR) {
        let felt_m_s2 = ratio * GRAVITY_M_S2;
        let outcome = Outcome::fail(without_gravity(imu.topic(), felt_m_s2));
        return imu.judged(outcome).with_evidence("felt_m_s2", felt_m_s2);
    }
    let tilt = match &imu.diagnosis.tilt_rad {
        Ok(tilt) => tilt,
        Err(why) => return imu.judged(not_observable(why, SETTLE)),
    };
    let threshold = case.thresholds.threshold(&YAW002, THRESHOLD);
    let as_logged =
        imu.diagnosis.encoding.as_ref().is_ok_and(|reading| reading.best.is_as_logged());
    let outcome = match as_logged {
        false => Outcome::Inconclusive(
            "the orientation encoding is wrong; correct it first (ORD001 to ORD003)".to_owned(),
        ),
        true => decide_length(tilt, &threshold, case.evidence.subjects())
            .into_outcome(SETTLE, |severity| fault(tilt, imu.diagnosis.up.as_ref(), severity)),
    };
    let estimate = Estimate::length("tilt against gravity", THRESHOLD.unit, tilt);
    let judged = imu.judged(outcome).estimated(estimate);
    let judged = match !as_logged && tilt.norm.value > threshold.warning {
        true => judged.with_evidence(CONTRADICTION, true),
        false => judged,
    };
    match imu.diagnosis.up {
        Some(up) => judged
            .with_evidence("up_in_world", <[f64; 3]>::from(up.in_world).to_vec())
            .with_evidence("up_in_base", <[f64; 3]>::from(up.in_base).to_vec()),
        None => judged,
    }
}

/// If another axis of the orientation's world points up; `None` if it is only tilted.
fn world(up: &UpDirections) -> Option<(&'static str, String, String)> {
    /// Maximum angle to the vertical, rad.
    const UP: f64 = 10.0 * DEGREE;
    let axis = up.in_world.iamax();
    if up.in_world[axis].abs() < UP.cos() || (axis == 2 && up.in_world.z > 0.0) {
        return None;
    }
    if axis == 2 && up.in_base.z < -UP.cos() {
        return Some((
            "accelerometer reversed",
            "the accelerometer's sign is reversed: at rest it reads gravity instead of the specific force, \
             which points up (REP 145)"
                .to_owned(),
            "negate the linear acceleration; if the arm hangs upside down, check for an NED orientation \
             instead"
                .to_owned(),
        ));
    }
    if axis == 2 {
        return Some((
            "IMU world is NED",
            "the orientation's world frame has z down (NED); REP 145 requires ENU, z up".to_owned(),
            "convert the orientation from NED to ENU: swap the world's x and y, and negate its z"
                .to_owned(),
        ));
    }
    let up = signed_axis(axis, up.in_world[axis]);
    Some((
        "IMU world is not z up",
        format!("{up} of the orientation's world frame points up; REP 145 requires z"),
        format!("rotate the orientation's world frame so that its {up} becomes z"),
    ))
}

fn without_gravity(topic: &str, felt_m_s2: f64) -> Fault {
    Fault {
        cause: Cause::Pictured(Picture::Stream),
        severity: Severity::Warning,
        title: "linear acceleration lacks gravity",
        message: format!(
            "gravity was removed from the linear acceleration: it reads {} m/s² at rest, while REP 145 requires the \
             specific force, {GRAVITY_M_S2} m/s²",
            rounded(felt_m_s2, 2)
        ),
        evidence: Evidence::default(),
        fix: format!("publish the accelerometer's own values on {topic}, with gravity"),
    }
}

fn fault(tilt: &MeasuredLength, up: Option<&UpDirections>, severity: Severity) -> Fault {
    let shown = THRESHOLD.unit.show_measured(&tilt.norm);
    let off = format!("roll and pitch are {shown} off gravity");
    let (title, message, fix) = match up.and_then(world) {
        Some((title, message, fix)) => (title, format!("{message}; {off}"), fix),
        None => (
            "IMU is tilted",
            off,
            "calibrate the accelerometer's bias, or level the IMU's world frame".to_owned(),
        ),
    };
    Fault {
        cause: Cause::Pictured(Picture::Tilt),
        severity,
        title,
        message,
        evidence: Evidence::default(),
        fix,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{IMU, clean_run, evaluate_rule, length};

    #[test]
    fn a_world_frame_without_z_up_is_named() {
        let said = |in_world: [f64; 3], base_z: f64| {
            let mut run = clean_run();
            let imu = &mut run.robots[0].imus[0].diagnosis;
            imu.tilt_rad = Ok(length(3.0));
            imu.up = Some(UpDirections {
                in_world: in_world.into(),
                in_base: [0.0, 0.0, base_z].into(),
                base_tilt_rad: length(0.0),
            });
            let (_, findings) = evaluate_rule(&YAW002, &run);
            findings[0].title.to_owned()
        };
        assert_eq!(said([0.0, 0.0, -1.0], 1.0), "IMU world is NED");
        assert_eq!(said([0.0, 0.0, -1.0], -1.0), "accelerometer reversed");
        assert_eq!(said([0.0, 1.0, 0.0], 1.0), "IMU world is not z up");
        assert_eq!(said([0.5, 0.5, -0.7], 1.0), "IMU is tilted");
    }

    #[test]
    fn a_tilt_above_the_threshold_is_reported_on_its_topic() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.tilt_rad = Ok(length(1.0 * DEGREE));
        let (_, findings) = evaluate_rule(&YAW002, &run);
        assert_eq!(findings[0].subject.topic.as_deref(), Some(IMU));
        assert_eq!(findings[0].message, "roll and pitch are 1.000 ± 0.001° off gravity");
    }
}
