//! Kinematic calibration: estimates the deviation of each link from the nominal model.
//!
//! The six deviations of every link have a prior N(0, s²), with 0.1° per mm; s maximises the marginal
//! likelihood, as for the zeros in [`crate::nominal_uncertainty`]. Gauss–Newton starts at the nominal model and
//! maximises the posterior. Its weights are robust against outliers and account for autocorrelation.
//! Covariances are sandwich estimates (White 1980) that include the prior. Reference: Hollerbach, Khalil,
//! Gautier, *Model Identification*, in Springer Handbook of Robotics, 2016, ch. 6.

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

/// Pose stream used for the calibration.
#[derive(Clone, Debug)]
pub struct CalibrationStream<'a> {
    /// Joint states with the encoding corrected, without zero correction.
    pub joints: &'a JointTrack,
    /// Column of each joint of the chain.
    pub columns: Vec<usize>,
    /// Reference link of the poses, or its nominal counterpart if the reference is free.
    pub base: LinkId,
    /// Link whose poses are measured, apart from the tool.
    pub tip: LinkId,
    /// Stamps, s.
    pub t_s: Vec<f64>,
    /// Poses with the encoding corrected.
    pub poses: Vec<Pose>,
    /// Coordinates without information.
    pub excluded: [bool; 3],
    /// Whether the rotations carry no information.
    pub is_rotation_excluded: bool,
    /// Latency, s: known, or the initial value if it is free.
    pub latency_s: f64,
    /// Whether the latency is estimated.
    pub latency_is_free: bool,
    /// Growth of the latency about the middle of the stream, s/s.
    pub skew: f64,
    /// `stream_from_base`: known, or the initial value if it is free.
    pub reference: Pose,
    /// Whether the base frame is estimated.
    pub reference_is_free: bool,
    /// `tip_from_tool`: known, or the initial value if it is free.
    pub tool: Pose,
    /// Whether the tool frame is estimated.
    pub tool_is_free: bool,
}

/// Component of a link's deviation along or about a direction in its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkParameter {
    /// Index of the link in [`ground::robot::LinkPath`].
    pub link: usize,
    /// Whether it is a rotation, rad, rather than a translation, m.
    pub is_rotation: bool,
    /// Unit vector in the link's frame.
    pub direction: [f64; 3],
}

/// Rms residual of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibrationResidual {
    /// Positions, m.
    pub m: f64,
    /// Rotations, rad.
    pub rad: f64,
}

/// Residuals of a stream before and after calibration.
#[derive(Clone, Debug)]
pub struct StreamCalibration {
    /// Number of samples used.
    pub samples: usize,
    /// Latency, s, if estimated.
    pub latency_s: Option<Measured>,
    /// `stream_from_base`, if estimated.
    pub reference: Option<Pose>,
    /// `tip_from_tool`, if estimated.
    pub tool: Option<Pose>,
    /// Residual with nominal links, after fitting all other parameters.
    pub before: CalibrationResidual,
    /// Residual with calibrated links.
    pub after: CalibrationResidual,
    /// Cross-validated residual with nominal links, over five folds of contiguous blocks.
    pub held_out_before: CalibrationResidual,
    /// Cross-validated residual with calibrated links, over the same folds.
    pub held_out_after: CalibrationResidual,
    /// Noise per component of positions, m, and rotations, rad.
    pub noise: [f64; 2],
    /// Factor by which autocorrelation inflates the variance of a mean.
    pub inflation: [f64; 2],
    /// Range of each joint of the chain, rad or m.
    pub spans: Vec<f64>,
}

/// Direction of the link parameters that the logs do not determine.
#[derive(Clone, Debug)]
pub struct UndeterminedDirection {
    /// Parameters with their components of the direction (a unit vector, scaled by the prior), largest
    /// first.
    pub parts: Vec<(usize, f64)>,
    /// Ratio of posterior to prior variance: 1 if nothing was learned.
    pub share: f64,
    /// Tip displacement over the workspace by the remaining uncertainty, rms m.
    pub effect_m: f64,
}

/// Rms error of FK over the whole workspace, up to free constant frames.
pub type FkUncertainty = CalibrationResidual;

/// Calibrated arm.
#[derive(Clone, Debug)]
pub struct ArmCalibration {
    /// Robot model with the deviations.
    pub robot: Robot,
    /// Names of the links with estimated deviations.
    pub links: Vec<String>,
    /// Deviation of each link in its own frame: translation, m, and rotation vector, rad.
    pub deviations: Vec<[f64; 6]>,
    /// Standard deviation of the link deviations, m (and 0.1° per mm).
    pub link_m: f64,
    /// Estimated link parameters.
    pub parameters: Vec<LinkParameter>,
    /// Joints of the chain with a free zero. Their values follow those of the links.
    pub zeros: Vec<usize>,
    /// Estimates: link parameters, then zeros, m and rad.
    pub values: Vec<f64>,
    /// Covariance of the values.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of the noise.
    pub dof: f64,
    /// Results for each stream.
    pub streams: Vec<StreamCalibration>,
    /// Directions that the logs do not determine.
    pub undetermined: Vec<UndeterminedDirection>,
    /// Last step of the iteration, rms in standard deviations. `None` if it converged.
    pub remaining_step: Option<f64>,
    /// Uncertainty of the calibrated FK over the whole workspace.
    pub calibrated_uncertainty: FkUncertainty,
    /// Uncertainty of the nominal FK, from the size of the deviations.
    pub nominal_uncertainty: FkUncertainty,
}

/// Reason why a calibration is not possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationFailure {
    /// The chain passes a joint from child to parent, or a mimic joint.
    Chain,
    /// The streams have chains with different joints.
    OtherJoints,
    /// Too few samples.
    TooFewSamples,
    /// The iteration diverges.
    Diverges,
}

impl ArmCalibration {
    /// Value with its standard error.
    pub fn value(&self, index: usize) -> Measured {
        let std_error = self.covariance[(index, index)].max(0.0).sqrt();
        Measured { value: self.values[index], std_error, dof: self.dof }
    }

    /// Standard errors of a link's deviation; zero for components fixed by convention.
    pub fn std_errors(&self, link: usize) -> [f64; 6] {
        std::array::from_fn(|axis| {
            let (turns, axis) = (axis >= 3, axis % 3);
            let own: Vec<(usize, f64)> = self
                .parameters
                .iter()
                .enumerate()
                .filter(|(_, one)| one.link == link && one.is_rotation == turns)
                .map(|(at, one)| (at, one.direction[axis]))
                .collect();
            let pairs = own.iter().flat_map(|a| own.iter().map(move |b| (a, b)));
            let variance: f64 = pairs.map(|(a, b)| a.1 * b.1 * self.covariance[(a.0, b.0)]).sum();
            variance.max(0.0).sqrt()
        })
    }
}

/// Calibrates `robot` from `streams`. The zeros of the chain's joints `zeros` are free.
///
/// # Errors
/// If the chain or the samples do not permit a calibration.
pub fn calibrate_arm(
    robot: &Robot,
    streams: &[CalibrationStream],
    zeros: &[usize],
) -> Result<ArmCalibration, CalibrationFailure> {
    fit::fit(robot, streams, zeros)
}
