//! IMUs on the arm: yaw drift, tilt, mount and gyro bias.

pub(super) mod yaw001_yaw_drift;
pub(super) mod yaw002_imu_tilt;
pub(super) mod yaw003_imu_mount;
pub(super) mod yaw004_gyro_bias;

use super::Family;
use super::decision::DEGREE;
use crate::evidence::{ArmEvidence, ImuEvidence};
use crate::finding::{Outcome, Ruling, Unit};

pub(super) static FAMILY: Family = Family {
    examines: "IMUs on the arm",
    rules: &[
        &yaw001_yaw_drift::YAW001,
        &yaw002_imu_tilt::YAW002,
        &yaw003_imu_mount::YAW003,
        &yaw004_gyro_bias::YAW004,
    ],
};

/// Standard gravity, m/s².
pub(super) const GRAVITY_M_S2: f64 = 9.81;
/// Largest relative error of a healthy accelerometer's median, on a resting or moving arm.
pub(super) const MAX_GRAVITY_ERROR: f64 = 0.2;

/// Specific force at rest over gravity, if it differs by more than an accelerometer's error.
pub(super) fn wrong_gravity(imu: &ImuEvidence) -> Option<f64> {
    let ratio = imu.diagnosis.conventions.force_at_rest_m_s2? / GRAVITY_M_S2;
    ((ratio - 1.0).abs() > MAX_GRAVITY_ERROR).then_some(ratio)
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// `-y`, for example, if the cosine of the angle to y is negative.
fn signed_axis(axis: usize, cosine: f64) -> String {
    format!("{}{}", if cosine < 0.0 { "-" } else { "" }, AXES[axis])
}

/// Withdraws a finding if FK has an unexplained rotation error that is not much smaller than this one.
fn unless_fk_is_wrong(outcome: Outcome, arm: &ArmEvidence, error_rad: f64) -> Outcome {
    /// Nominal kinematics stay below it (MDL001).
    const MIN_UNEXPLAINED_RAD: f64 = 0.5 * DEGREE;
    const MIN_RATIO: f64 = 5.0;
    let residuals = arm.poses.iter().filter_map(|stream| stream.diagnosis.residual.as_ref().ok());
    let unexplained = residuals.map(|residual| residual.excess_rad.value).fold(0.0, f64::max);
    let is_wrong = unexplained > MIN_UNEXPLAINED_RAD && error_rad.abs() < MIN_RATIO * unexplained;
    match outcome {
        Outcome::Evaluated(Ruling::Fail(_)) if is_wrong => {
            let residual = Unit::Radian.show(unexplained);
            Outcome::Inconclusive(format!(
                "poses and FK differ by an unexplained {residual} (MDL001); check the model"
            ))
        }
        outcome => outcome,
    }
}
