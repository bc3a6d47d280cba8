//! Plans the motion to record for an audit or calibration, and predicts the precision of a given motion.
//!
//! A motion is evaluated by the information matrix of the estimators: their Jacobians at its
//! configurations, weighted by the expected pose noise. The search maximises the determinant of the
//! information on the requested parameters, marginalised over all other unknowns (D-optimality: Fedorov,
//! *Theory of Optimal Experiments*, 1972; for robot motions: Swevers et al., "Optimal robot excitation and
//! identification", IEEE Trans. Robotics and Automation 13(5), 1997).

mod distance;
mod fourier;
mod limits;
mod precision;
mod search;

#[cfg(test)]
mod tests;

use ground::geometry::Pose;
use ground::robot::Chain;
use ground::stream::JointTrack;

pub use distance::{ArmCapsules, ClearanceViolation, Clearances, TargetVisibility};
pub use fourier::FourierMotion;
pub use limits::{JointRange, LimitKind, LimitViolation, joint_ranges, limit_violations};
pub use precision::{ExpectedPrecision, PlannedQuantity, expected_precisions, geometric_mean};
pub use search::{Infeasible, MotionPlan, plan, sample_motion};

/// Quantity to estimate from a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Zero offsets of the joints.
    Zeros,
    /// Deviations of all links from the nominal model.
    Calibration,
    /// Latency of poses against the joint states.
    Latency,
    /// Pose of a camera in the hand.
    HandEye,
    /// Drift and tilt of an IMU's orientation.
    Yaw,
}

impl Purpose {
    /// All purposes, most common first.
    pub const ALL: [Purpose; 5] =
        [Purpose::Zeros, Purpose::Calibration, Purpose::Latency, Purpose::HandEye, Purpose::Yaw];

    /// Whether it is estimated from poses in a known or unknown frame.
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

/// Properties of the measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Standard deviation of a position along each axis, m.
    pub noise_m: f64,
    /// Standard deviation of a rotation about each axis, rad.
    pub noise_rad: f64,
    /// Pose rate, Hz.
    pub rate_hz: f64,
    /// Whether the reference frame and the measured point are unknown, as for a tracker.
    pub outside: bool,
    /// Standard deviation of the link deviations from the nominal model, m (and 0.1° per mm).
    pub link_m: f64,
    /// Pose of the camera in the hand.
    pub hand_from_camera: Pose,
    /// Distance of the target along the camera's z axis in the start configuration, m.
    pub target_m: f64,
}

/// Limits of one joint's motion relative to its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMargins {
    /// Downwards, rad or m, not negative.
    pub below: f64,
    /// Upwards, rad or m, not negative.
    pub above: f64,
    /// Maximum speed, rad/s or m/s.
    pub velocity: f64,
    /// Maximum acceleration, rad/s² or m/s².
    pub acceleration: f64,
}

/// Requirements on a motion.
#[derive(Clone, Debug)]
pub struct PlanRequirements<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// Start and end configuration, in the chain's order, rad or m.
    pub around: &'a [f64],
    /// Limits of each joint.
    pub margins: &'a [JointMargins],
    /// Total duration including rests, s.
    pub seconds: f64,
    /// Quantity to estimate.
    pub purpose: Purpose,
    /// Measurement used for it.
    pub sensing: Sensing,
    /// Clearances.
    pub clearances: &'a Clearances,
    /// Random seed.
    pub seed: u64,
}

/// Expected precision of a motion.
pub fn expected_precision(
    chain: &Chain,
    motion: &JointTrack,
    purpose: Purpose,
    sensing: &Sensing,
) -> Option<Vec<ExpectedPrecision>> {
    expected_precisions(chain, &sample_motion(motion, chain)?, purpose, sensing)
}
