//! Plans the motion to record for an audit or calibration, and predicts the precision of a given motion.
//!
//! A motion is evaluated by the estimators' information matrix under the expected pose noise. The search
//! maximises the determinant of the information on the requested parameters, marginalised over all others
//! (D-optimality: Fedorov, *Theory of Optimal Experiments*, 1972; for robot motions: Swevers et al.,
//! "Optimal robot excitation and identification", IEEE Trans. Robotics and Automation 13(5), 1997).

mod distance;
mod fourier;
mod limits;
mod precision;
mod search;

#[cfg(test)]
mod tests;

use ground::geometry::Pose;
use ground::robot::Chain;

pub use distance::{ClearanceViolation, Clearances, TargetVisibility};
pub use fourier::FourierMotion;
pub use limits::{JointRange, LimitKind, LimitViolation, joint_ranges, limit_violations};
pub use precision::{ExpectedPrecision, PlannedQuantity, geometric_mean};
pub use search::{Infeasible, MotionPlan, expected_precision, plan};

/// Quantity to estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Joint offsets.
    Zeros,
    /// All link deviations from the nominal model.
    Calibration,
    /// Poses against joint states.
    Latency,
    /// Camera in the hand.
    HandEye,
    /// Drift and tilt of an IMU.
    Yaw,
}

impl Purpose {
    /// Most common first.
    pub const ALL: [Purpose; 5] =
        [Purpose::Zeros, Purpose::Calibration, Purpose::Latency, Purpose::HandEye, Purpose::Yaw];

    /// Whether it is estimated from poses.
    pub const fn is_of_poses(self) -> bool {
        matches!(self, Purpose::Zeros | Purpose::Calibration | Purpose::Latency)
    }

    /// Name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Purpose::Zeros => "zeros",
            Purpose::Calibration => "calibration",
            Purpose::Latency => "latency",
            Purpose::HandEye => "hand-eye",
            Purpose::Yaw => "yaw",
        }
    }
}

/// Properties of the measurement; noise is per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Position noise.
    pub noise_m: f64,
    /// Rotation noise.
    pub noise_rad: f64,
    /// Pose rate.
    pub rate_hz: f64,
    /// Whether reference frame and measured point are unknown (tracker).
    pub outside: bool,
    /// Link deviations from the nominal model, m (and 0.1° per mm).
    pub link_m: f64,
    /// Camera pose.
    pub hand_from_camera: Pose,
    /// Target's distance along the camera's z axis at the start.
    pub target_m: f64,
}

/// Limits relative to the start; distances are not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMargins {
    /// Downwards, rad or m.
    pub below: f64,
    /// Upwards, rad or m.
    pub above: f64,
    /// Maximum, rad/s or m/s.
    pub velocity: f64,
    /// Maximum, rad/s² or m/s².
    pub acceleration: f64,
}

/// Requirements on a motion.
#[derive(Clone, Debug)]
pub struct PlanRequirements<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// Start and end, in chain order, rad or m.
    pub around: &'a [f64],
    /// Per joint.
    pub margins: &'a [JointMargins],
    /// Including rests.
    pub seconds: f64,
    /// Quantities to estimate.
    pub purpose: Purpose,
    /// Its measurement.
    pub sensing: Sensing,
    /// Clearances.
    pub clearances: &'a Clearances,
    /// Random seed.
    pub seed: u64,
}
