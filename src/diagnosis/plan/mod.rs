//! The motion to record so that an audit can tell what it could not, and what a given motion would show.
//!
//! A motion is judged by the information matrix of the estimators themselves: their Jacobians at its
//! postures, weighed by the noise that the poses are expected to have. Of motions within the limits around
//! a posture the one is sought whose information on what is asked has the largest determinant, beside
//! everything else that is unknown (D-optimality: Fedorov, *Theory of Optimal Experiments*, 1972; of
//! robot motions: Swevers et al., "Optimal robot excitation and identification", IEEE Trans. Robotics and
//! Automation 13(5), 1997).

mod distance;
mod fourier;
mod limits;
mod search;
mod shown;

#[cfg(test)]
mod tests;

use ground::geometry::Pose;
use ground::robot::Chain;
use ground::stream::JointTrack;

pub use distance::{Body, Keep, Nearness, View};
pub use fourier::Series;
pub use limits::{Beyond, Bound, Extent, beyond, extents};
pub use search::{Infeasible, Planned, plan, sampled};
pub use shown::{Promise, Showable, geometric_mean, promises};

/// What a motion is to show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// The zeros of the joints.
    Zeros,
    /// The deviations of all links from the drawing.
    Calibration,
    /// The latency of poses against the joint states.
    Latency,
    /// The pose of a camera in the hand.
    HandEye,
    /// Drift and tilt of an IMU's orientation.
    Yaw,
}

impl Purpose {
    /// Every one, the most asked for first.
    pub const ALL: [Purpose; 5] =
        [Purpose::Zeros, Purpose::Calibration, Purpose::Latency, Purpose::HandEye, Purpose::Yaw];

    /// Whether poses in a frame show it, known or not.
    pub const fn is_of_poses(self) -> bool {
        matches!(self, Purpose::Zeros | Purpose::Calibration | Purpose::Latency)
    }

    /// Its name on the command line and in reports.
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

/// By what the motion is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Standard deviation of a position along each axis, m.
    pub noise_m: f64,
    /// Standard deviation of a rotation about each axis, rad.
    pub noise_rad: f64,
    /// Poses a second.
    pub rate_hz: f64,
    /// Whether the frame that the poses are in and the point that they are of are unknown, as those of
    /// a tracker are.
    pub outside: bool,
    /// By how much the links differ from the drawing, as a standard deviation, m; angles by 0.1° where
    /// that is 1 mm.
    pub link_m: f64,
    /// The camera in the hand.
    pub hand_from_camera: Pose,
    /// How far in front of the camera, along its z axis, the target is in the posture of the start, m.
    pub target_m: f64,
}

/// How far, how fast and how abruptly one joint may move from where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Room {
    /// Downwards, rad or m, not negative.
    pub below: f64,
    /// Upwards, likewise.
    pub above: f64,
    /// Highest speed, rad/s or m/s.
    pub velocity: f64,
    /// Highest acceleration, rad/s² or m/s².
    pub acceleration: f64,
}

/// A motion that is asked for.
#[derive(Clone, Debug)]
pub struct Task<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// The posture at which the motion begins and ends, in the chain's order, rad or m.
    pub around: &'a [f64],
    /// The room of each joint.
    pub rooms: &'a [Room],
    /// How long it lasts with its rests, s.
    pub seconds: f64,
    /// What it is to show.
    pub purpose: Purpose,
    /// By what.
    pub sensing: Sensing,
    /// What it keeps off.
    pub keep: &'a Keep,
    /// Of the random numbers.
    pub seed: u64,
}

/// What a motion shows.
pub fn shown(
    chain: &Chain,
    motion: &JointTrack,
    purpose: Purpose,
    sensing: &Sensing,
) -> Option<Vec<Promise>> {
    promises(chain, &sampled(motion, chain)?, purpose, sensing)
}
