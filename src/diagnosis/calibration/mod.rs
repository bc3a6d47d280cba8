//! Kinematic calibration: estimates the deviation of each link from the nominal model.
//!
//! Deviations have a prior N(0, s²), with 0.1° per mm; s maximises the marginal likelihood, as for the
//! zeros in [`crate::selection::deviation_model`]. Gauss–Newton from the nominal model maximises the posterior,
//! with weights for outliers and autocorrelation and sandwich covariances (White 1980). A point of the tool that
//! stays at an unknown place (a ball in a socket) is a stream of positions in a frame with a free origin. Reference:
//! Hollerbach, Khalil, Gautier, *Model Identification*, in Springer Handbook of Robotics, 2016, ch. 6.

mod fit;
mod fixed_point;
mod parameters;
mod system;
#[cfg(test)]
mod tests;
mod undetermined;
pub(crate) mod workspace;

pub use self::fit::calibrate_arm;
pub use self::fixed_point::FixedPoint;
use crate::Measured;
use crate::priors::LINK_PRIOR_M;
use crate::selection::deviation_model::DEVIATION_GRID_M;
use ground::geometry::Pose;
use ground::robot::{LinkId, Robot};
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVector};

/// Bound of the deviations' standard deviation, m. Four times that of an audit: zeros that are not free parameters, of
/// arms without a factory calibration, count as deviations as well.
const MAX_LINK_SIZE_M: f64 = 4.0 * DEVIATION_GRID_M.1;

/// Pose stream to calibrate from.
#[derive(Clone, Debug)]
pub struct CalibrationStream<'a> {
    /// Encoding corrected, zeros not.
    pub joints: &'a JointTrack,
    /// Column per joint of the chain.
    pub columns: Vec<usize>,
    /// Reference link of the poses (nominal if free).
    pub base: LinkId,
    /// Measured link, apart from the tool.
    pub tip: LinkId,
    /// Stamps.
    pub t_s: Vec<f64>,
    /// Encoding corrected.
    pub poses: Vec<Pose>,
    /// Coordinates without information.
    pub excluded: [bool; 3],
    /// Rotations without information.
    pub is_rotation_excluded: bool,
    /// Known, or initial if free.
    pub latency_s: f64,
    /// Whether it is estimated.
    pub latency_is_free: bool,
    /// Growth of the latency about the stream's middle.
    pub skew: f64,
    /// `stream_from_base`: known, or initial if free.
    pub reference: Pose,
    /// Its estimated part.
    pub reference_freedom: FrameFreedom,
    /// `tip_from_tool`: known, or initial if free.
    pub tool: Pose,
    /// Its estimated part.
    pub tool_freedom: FrameFreedom,
    /// Streams of one group are held out together; `None` holds out blocks of samples.
    pub held_out_group: Option<usize>,
}

/// Estimated part of a frame. Streams whose frames have the same number share one frame, with the same initial
/// value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameFreedom {
    /// Known.
    Known,
    /// Its origin; the stream has no rotations.
    Position(usize),
    /// Origin and rotation.
    Pose(usize),
}

impl FrameFreedom {
    /// Number of estimated components.
    pub fn width(self) -> usize {
        match self {
            Self::Known => 0,
            Self::Position(_) => 3,
            Self::Pose(_) => 6,
        }
    }
}

/// Known distance of the points of two streams, whose poses are a fixed point at their origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointDistance {
    /// Indices of the streams.
    pub streams: [usize; 2],
    /// Distance, m.
    pub distance_m: f64,
    /// Its standard deviation, m.
    pub std_error_m: f64,
}

/// Component of a link's deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkParameter {
    /// Index in [`ground::robot::LinkPath`].
    pub link: usize,
    /// Rotation, rad, or translation, m.
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

/// Calibration of a stream. `held_out` is cross-validated over the groups of streams, otherwise over five folds of
/// contiguous blocks. The own frames of a held-out group are fitted to it.
#[derive(Clone, Debug)]
pub struct StreamCalibration {
    /// Samples used.
    pub samples: usize,
    /// Latency, if estimated.
    pub latency_s: Option<Measured>,
    /// `stream_from_base`, if estimated.
    pub reference: Option<Pose>,
    /// `tip_from_tool`, if estimated.
    pub tool: Option<Pose>,
    /// Nominal links, all else fitted.
    pub before: CalibrationResidual,
    /// Calibrated links.
    pub after: CalibrationResidual,
    /// Nominal links.
    pub held_out_before: CalibrationResidual,
    /// Calibrated links.
    pub held_out_after: CalibrationResidual,
    /// Per component of positions, m, and rotations, rad.
    pub noise: [f64; 2],
    /// Variance inflation of a mean by autocorrelation.
    pub inflation: [f64; 2],
    /// Range per joint, rad or m.
    pub spans: Vec<f64>,
    /// Position error of each sample with the calibrated links, m.
    pub errors_m: Vec<f64>,
}

/// Link parameters that the logs do not determine.
#[derive(Clone, Debug)]
pub struct UndeterminedDirection {
    /// Parameter and component (of a unit vector, scaled by the prior), largest first.
    pub parts: Vec<(usize, f64)>,
    /// Posterior over prior variance: 1 if nothing was learned.
    pub share: f64,
    /// Remaining tip displacement over the workspace, rms.
    pub effect_m: f64,
}

/// Rms FK error over the workspace, up to constant frames.
pub type FkUncertainty = CalibrationResidual;

/// Calibrated arm.
#[derive(Clone, Debug)]
pub struct ArmCalibration {
    /// Robot with the deviations.
    pub robot: Robot,
    /// Links with estimated deviations.
    pub links: Vec<String>,
    /// Deviations in each link's own frame: translation, m, and rotation vector, rad.
    pub deviations: Vec<[f64; 6]>,
    /// Standard deviation of the deviations, m (and 0.1° per mm).
    pub link_m: f64,
    /// Largest one that the logs do not exclude at 95 %, m.
    pub max_link_m: f64,
    /// Estimated link parameters.
    pub parameters: Vec<LinkParameter>,
    /// Chain joints with free zero; values follow the links'.
    pub zeros: Vec<usize>,
    /// Link parameters, then zeros, m and rad.
    pub values: Vec<f64>,
    /// Covariance of the values.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of the noise.
    pub dof: f64,
    /// Per stream.
    pub streams: Vec<StreamCalibration>,
    /// Distance of each pair of points with the nominal and the calibrated links, m.
    pub distances_m: Vec<[f64; 2]>,
    /// Directions that the logs do not determine.
    pub undetermined: Vec<UndeterminedDirection>,
    /// Rms in standard deviations. `None` if converged.
    pub remaining_step: Option<f64>,
    /// Calibrated FK.
    pub calibrated_uncertainty: FkUncertainty,
    /// Nominal FK, from the deviations' size.
    pub nominal_uncertainty: FkUncertainty,
}

/// Why calibration is not possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationFailure {
    /// A joint is passed from child to parent, or mimics.
    Chain,
    /// Chains with different joints.
    OtherJoints,
    /// Too few samples.
    TooFewSamples,
    /// The iteration diverges.
    Diverges,
}

impl ArmCalibration {
    /// Ratio of usual link deviations to the largest that the logs do not exclude.
    pub fn excluded_ratio(&self) -> f64 {
        LINK_PRIOR_M / self.max_link_m
    }

    /// Whether the standard deviation of the deviations is the largest one tried, so a larger one may be likelier.
    pub fn is_link_size_at_bound(&self) -> bool {
        self.link_m * DEVIATION_GRID_M.2 >= MAX_LINK_SIZE_M
    }

    /// Value with standard error.
    pub fn value(&self, index: usize) -> Measured {
        let std_error = self.covariance[(index, index)].max(0.0).sqrt();
        Measured { value: self.values[index], std_error, dof: self.dof }
    }

    /// Standard errors of a deviation; zero for components fixed by convention.
    pub fn std_errors(&self, link: usize) -> [f64; 6] {
        std::array::from_fn(|axis| {
            let direction = |one: &LinkParameter| match one.link == link {
                true if one.is_rotation == (axis >= 3) => one.direction[axis % 3],
                _ => 0.0,
            };
            let links = self.parameters.len();
            let along = DVector::from_fn(links, |at, _| direction(&self.parameters[at]));
            let covariance = self.covariance.view((0, 0), (links, links));
            along.dot(&(covariance * &along)).max(0.0).sqrt()
        })
    }
}
