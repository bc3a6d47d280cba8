//! The arm itself: by how much each of its links differs from the drawing, as far as logs tell.
//!
//! The six deviations of every link have a prior N(0, s²), lengths to angles as 1 mm to 0.1°, and s is
//! the one under which the logs are likeliest, as for the zeros of [`crate::drawing`]. Gauss–Newton
//! goes from the drawing to where the posterior is largest, with weights that are robust against
//! outliers and count for correlation. Covariances are sandwiches (White 1980) with the prior in them.
//! Kinematic calibration: Hollerbach, Khalil, Gautier, *Model Identification*, in Springer Handbook of
//! Robotics, 2016, ch. 6.

mod fit;
mod observed;
mod parameters;
#[cfg(test)]
mod tests;
mod workspace;

use super::Measured;
use ground::geometry::Pose;
use ground::robot::{LinkId, Robot};
use ground::stream::JointTrack;
use nalgebra::DMatrix;

/// A stream of poses that an arm is calibrated by.
#[derive(Clone, Debug)]
pub struct CalibrationStream<'a> {
    /// The joint states, read rightly, with no zero taken off.
    pub joints: &'a JointTrack,
    /// For each joint of the chain, its column in them.
    pub columns: Vec<usize>,
    /// The link that poses are in, or stand in for where the reference is free.
    pub base: LinkId,
    /// The link whose poses they are, up to the tool.
    pub tip: LinkId,
    /// Stamps, s.
    pub t_s: Vec<f64>,
    /// The poses, read rightly.
    pub poses: Vec<Pose>,
    /// Which coordinates say nothing.
    pub blind: [bool; 3],
    /// Whether the rotations say nothing.
    pub rotation_is_blind: bool,
    /// The latency, s; known where it is not free.
    pub latency_s: f64,
    /// Whether the latency is estimated.
    pub latency_is_free: bool,
    /// By how much the latency grows, s/s, about the middle of the stream.
    pub skew: f64,
    /// `stream_from_base`, to begin with where it is free.
    pub reference: Pose,
    /// Whether the base may be anywhere in the stream's frame.
    pub reference_is_free: bool,
    /// `tip_from_tool`, to begin with where it is free.
    pub tool: Pose,
    /// Whether the tool may be anything.
    pub tool_is_free: bool,
}

/// A number of a link's deviation: along or about a direction in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkParameter {
    /// The link, as [`ground::robot::LinkPath`] numbers them.
    pub link: usize,
    /// Whether it is a turn, rad, and not a shift, m.
    pub turns: bool,
    /// A unit vector in the link's frame.
    pub direction: [f64; 3],
}

/// What is left of poses: rms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LeftOver {
    /// Of positions, m.
    pub m: f64,
    /// Of rotations, rad.
    pub rad: f64,
}

/// What a calibration leaves of a stream, and what the drawing did.
#[derive(Clone, Debug)]
pub struct StreamCalibration {
    /// Samples that were used.
    pub samples: usize,
    /// Latency, s, where it was estimated.
    pub latency_s: Option<Measured>,
    /// `stream_from_base`, where it was estimated.
    pub reference: Option<Pose>,
    /// `tip_from_tool`, where it was estimated.
    pub tool: Option<Pose>,
    /// With the drawing's links, with everything else refitted.
    pub before: LeftOver,
    /// With the calibrated links.
    pub after: LeftOver,
    /// With the drawing's links: of every fifth stretch, foretold by the others, for all five.
    pub held_out_before: LeftOver,
    /// With links that were calibrated without the stretches that they foretell, likewise.
    pub held_out_after: LeftOver,
    /// The noise of positions, m, and of rotations, rad, a component.
    pub noise: [f64; 2],
    /// What correlation from sample to sample makes of the variance of a mean.
    pub inflation: [f64; 2],
    /// How far each joint of the chain moved, rad or m.
    pub spans: Vec<f64>,
}

/// A direction of the links' parameters that the logs do not tell from the drawing.
#[derive(Clone, Debug)]
pub struct Untold {
    /// The parameters that it is made of, each with its share of the direction (a unit vector of
    /// parameters by their prior), the largest first.
    pub parts: Vec<(usize, f64)>,
    /// How much narrower than before it is known: 1 is no narrower.
    pub share: f64,
    /// By how much what is unknown of it moves the tip over the workspace, rms m.
    pub effect_m: f64,
}

/// By how much FK is off over the whole workspace, up to constant frames that are free: rms.
pub type Uncertainty = LeftOver;

/// An arm as logs tell it.
#[derive(Clone, Debug)]
pub struct ArmCalibration {
    /// The model with the deviations in it.
    pub robot: Robot,
    /// The names of the links whose deviations are estimated.
    pub links: Vec<String>,
    /// By how much each of them deviates from the drawing, in its own frame: m, and a rotation vector
    /// in rad.
    pub deviations: Vec<[f64; 6]>,
    /// By how much links deviate, as a standard deviation, m; 0.1° to 1 mm.
    pub link_m: f64,
    /// The numbers that were estimated of the links.
    pub parameters: Vec<LinkParameter>,
    /// The joints of the chain whose zero was free, as they stand in it; after the links' numbers.
    pub zeros: Vec<usize>,
    /// Their values: first the links', then the zeros', m and rad.
    pub values: Vec<f64>,
    /// The covariance of the values.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom behind the noise.
    pub dof: f64,
    /// What became of each stream.
    pub streams: Vec<StreamCalibration>,
    /// What the logs do not tell.
    pub untold: Vec<Untold>,
    /// How far the last round of fitting moved the numbers, rms standard deviations; none where they settled.
    pub unsettled: Option<f64>,
    /// How well FK of the robot is known over the whole workspace.
    pub expected: Uncertainty,
    /// How well FK of the drawing is, by the size of the deviations.
    pub drawing: Uncertainty,
}

/// Why there is no calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoCalibration {
    /// The chain leads over a joint from child to parent, or over one that mimics another.
    Chain,
    /// The streams are of chains with other joints.
    OtherJoints,
    /// Too few samples.
    TooFewSamples,
    /// The numbers do not settle.
    Diverges,
}

impl ArmCalibration {
    /// A value with its standard error.
    pub fn value(&self, index: usize) -> Measured {
        let std_error = self.covariance[(index, index)].max(0.0).sqrt();
        Measured { value: self.values[index], std_error, dof: self.dof }
    }

    /// The standard error of each number of a link's deviation; zero where it is fixed by convention.
    pub fn std_errors(&self, link: usize) -> [f64; 6] {
        std::array::from_fn(|axis| {
            let (turns, axis) = (axis >= 3, axis % 3);
            let own: Vec<(usize, f64)> = self
                .parameters
                .iter()
                .enumerate()
                .filter(|(_, one)| one.link == link && one.turns == turns)
                .map(|(at, one)| (at, one.direction[axis]))
                .collect();
            let pairs = own.iter().flat_map(|a| own.iter().map(move |b| (a, b)));
            let variance: f64 = pairs.map(|(a, b)| a.1 * b.1 * self.covariance[(a.0, b.0)]).sum();
            variance.max(0.0).sqrt()
        })
    }
}

/// Calibrates `robot` by `streams`; the zeros of the joints `zeros` of the chain are whatever they are.
///
/// # Errors
/// Where the chain or the samples do not allow it.
pub fn calibrate_arm(
    robot: &Robot,
    streams: &[CalibrationStream],
    zeros: &[usize],
) -> Result<ArmCalibration, NoCalibration> {
    fit::fit(robot, streams, zeros)
}
