//! Expected precision of a motion, from the estimator's information matrix.

use super::{Purpose, Sensing};
use crate::arm::FIT_SAMPLES;
use crate::calibration::FkUncertainty;
use crate::calibration::workspace::{TipSensitivity, random_configurations, tip_derivatives};
use crate::hand_eye;
use crate::imu;
use crate::priors::{FREE_PRIOR, LINK_PRIOR_M, LINK_PRIOR_RAD, RAD_PER_M, ZERO_PRIOR};
use crate::selection::deviation_model::MAX_DEVIATION_SAMPLES;
use crate::solver::linear::Linear;
use crate::solver::robust::sandwich;
use ground::geometry::Vec3;
use ground::robot::{Chain, JointKind};
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// For a 95 % interval.
const HALF_WIDTH_SIGMAS: f64 = 1.959_963_985;
/// Over the workspace, to evaluate a calibrated model.
const CONFIGURATIONS: usize = 150;
const RANDOM_SEED: u64 = 1;
/// Share of the prior; an observable parameter is below it.
const MAX_STD_DEVIATION_SHARE: f64 = 0.5;
/// On a camera's or IMU's mount and time, m, rad and s. It keeps the score finite for unobservable
/// parameters.
const WEAK_PRIOR: f64 = 1.0;

/// Quantity to determine. Joints in chain order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlannedQuantity {
    /// All zeros free, rad or m.
    Zero(usize),
    /// The only zero that is off.
    ZeroAlone(usize),
    /// Tip position of the calibrated model, rms m.
    FkPosition {
        /// Whether over the workspace instead of the motion.
        everywhere: bool,
    },
    /// Tip rotation, rms rad.
    FkRotation {
        /// Whether over the workspace.
        everywhere: bool,
    },
    /// Latency, s.
    Latency,
    /// Position along an axis (0 to 2), m.
    CameraShift(usize),
    /// Rotation about an axis, rad.
    CameraTurn(usize),
    /// Yaw drift, rad/s.
    YawDrift,
    /// IMU's world about the base's x or y (0 or 1), rad.
    Tilt(usize),
}

/// Expected precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedPrecision {
    /// Its quantity.
    pub quantity: PlannedQuantity,
    /// Half of the 95 % interval, or rms at the tip. Infinite if undetermined.
    pub half_width: f64,
}

/// Free parameters, prior standard deviations (infinite if flat), and which are requested.
#[derive(Clone)]
struct PrecisionQuery {
    parameters: Vec<usize>,
    prior: Vec<f64>,
    requested: Vec<usize>,
}

impl PrecisionQuery {
    /// Infinite for unobservable ones.
    fn covariance(&self, information: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.parameters.len();
        let at = |i: usize, j: usize| information[(self.parameters[i], self.parameters[j])];
        let mut precision = DMatrix::from_fn(n, n, at);
        for (i, before) in self.prior.iter().enumerate() {
            precision[(i, i)] += before.powi(-2);
        }
        let covariance = match precision.clone().cholesky().map(|cholesky| cholesky.inverse()) {
            Some(covariance) if self.prior.iter().all(|before| before.is_finite()) => covariance,
            _ => sandwich(&precision, &precision),
        };
        covariance.select_rows(&self.requested).select_columns(&self.requested)
    }

    /// Half widths of the requested parameters; `quantity` names each.
    fn precisions(
        &self,
        information: &DMatrix<f64>,
        quantity: impl Fn(usize) -> PlannedQuantity,
    ) -> Vec<ExpectedPrecision> {
        let covariance = self.covariance(information);
        let half_width = |at: usize| {
            let error = covariance[(at, at)].max(0.0).sqrt();
            match error < MAX_STD_DEVIATION_SHARE * self.prior[self.requested[at]] {
                true => HALF_WIDTH_SIGMAS * error,
                false => f64::INFINITY,
            }
        };
        (0..self.requested.len())
            .map(|at| ExpectedPrecision { quantity: quantity(at), half_width: half_width(at) })
            .collect()
    }

    fn score(&self, information: &DMatrix<f64>) -> f64 {
        let prior = self.prior.iter().map(|before| before.min(WEAK_PRIOR)).collect();
        let cholesky = Self { prior, ..self.clone() }.covariance(information).cholesky();
        cholesky.map_or(f64::INFINITY, |cholesky| {
            cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum()
        })
    }
}

pub(super) struct LinearizedMotion<'a> {
    chain: &'a Chain,
    motion: &'a JointTrack,
    purpose: Purpose,
    sensing: &'a Sensing,
    seconds: f64,
    linear: Linear,
}

impl<'a> LinearizedMotion<'a> {
    /// `None` if joint positions between the rows are unknown.
    pub fn new(
        chain: &'a Chain,
        motion: &'a JointTrack,
        purpose: Purpose,
        sensing: &'a Sensing,
    ) -> Option<Self> {
        let linear = match purpose {
            Purpose::HandEye => {
                let hands = (0..motion.len()).map(|row| chain.forward(motion.row(row)));
                let (camera, ahead) = (sensing.hand_from_camera, Vec3::z() * sensing.target_m);
                hand_eye::design(&motion.t_s, hands.collect(), camera, ahead)
            }
            _ => tip_derivatives(chain, motion),
        };
        let (first_s, last_s) = motion.span()?;
        let seconds = last_s - first_s;
        let is_whole = linear.len() == motion.len();
        is_whole.then_some(Self { chain, motion, purpose, sensing, seconds, linear })
    }

    /// Information in at most `most` samples.
    fn information(&self, most: usize) -> DMatrix<f64> {
        let &Sensing { noise_m, noise_rad, rate_hz, .. } = self.sensing;
        let mut weights = self.linear.even_weights();
        weights[0].noise.sigma = if self.purpose == Purpose::Yaw { f64::INFINITY } else { noise_m };
        weights[1].noise.sigma = noise_rad;
        let logged = (self.seconds * rate_hz) as usize + 1;
        let used = logged.div_ceil(logged.div_ceil(most).max(1));
        let share = used as f64 / self.linear.len().max(1) as f64;
        let information = self.linear.information(&weights);
        match self.purpose {
            Purpose::Yaw => self.with_drift(information, noise_rad) * share,
            _ => information * share,
        }
    }

    fn with_drift(&self, information: DMatrix<f64>, noise_rad: f64) -> DMatrix<f64> {
        let (width, samples) = (information.ncols(), self.linear.len());
        let middle_s = self.motion.t_s[0] + 0.5 * self.seconds;
        let derivative = |row: usize, column: usize| self.linear.row(row / 3, 3 + row % 3)[column];
        let rotations = DMatrix::from_fn(3 * samples, width, derivative);
        let drift = DVector::from_fn(3 * samples, |row, _| {
            rotations[(row, YAW_PARAMETER)] * (self.motion.t_s[row / 3] - middle_s)
        });
        let both = rotations.tr_mul(&drift).push(drift.norm_squared()) / noise_rad.powi(2);
        let mut with = information.resize(width + 1, width + 1, 0.0);
        with.set_column(width, &both);
        with.set_row(width, &both.transpose());
        with
    }

    fn links(&self) -> usize {
        6 * (self.chain.dof() + 1)
    }

    /// The latency follows the links.
    fn latency(&self) -> usize {
        self.links()
    }

    fn zero(&self, joint: usize) -> usize {
        self.latency() + 1 + joint
    }

    /// Reference and tool frame, if unknown.
    fn frames(&self) -> Vec<usize> {
        let last = self.links() - 6;
        let outside = self.sensing.outside;
        (0..6).chain(last..last + 6).filter(|_| outside).collect()
    }

    /// Link deviations (prior `link`) and latency are free.
    fn zeros_with_links_query(&self, zeros: Range<usize>, link: (f64, f64)) -> PrecisionQuery {
        let frames = self.frames();
        let before = |i: usize| match i % 6 {
            _ if frames.contains(&i) => FREE_PRIOR,
            0..3 => link.0,
            _ => link.1,
        };
        let links = (0..self.links()).map(|i| (i, before(i)));
        let zeros = zeros.map(|joint| (self.zero(joint), ZERO_PRIOR));
        let all = links.chain([(self.latency(), FREE_PRIOR)]).chain(zeros);
        let (parameters, prior): (Vec<usize>, Vec<f64>) = all.unzip();
        let requested = (self.links() + 1..parameters.len()).collect();
        PrecisionQuery { parameters, prior, requested }
    }

    /// Query about the first `requested` parameters.
    fn flat_query(parameters: impl Iterator<Item = usize>, requested: usize) -> PrecisionQuery {
        let parameters: Vec<usize> = parameters.collect();
        let prior = vec![f64::INFINITY; parameters.len()];
        PrecisionQuery { parameters, prior, requested: (0..requested).collect() }
    }

    fn link(&self) -> (f64, f64) {
        (self.sensing.link_m, RAD_PER_M * self.sensing.link_m)
    }

    /// Query of the purpose, and the number of samples that its estimator uses.
    fn query(&self) -> (PrecisionQuery, usize) {
        let joints = self.chain.dof();
        // Latency and frames are free.
        let beside = [self.latency()].into_iter().chain(self.frames());
        match self.purpose {
            Purpose::Zeros if self.sensing.link_m > 0.0 => {
                (self.zeros_with_links_query(0..joints, self.link()), MAX_DEVIATION_SAMPLES)
            }
            Purpose::Zeros => {
                let zeros = (0..joints).map(|joint| self.zero(joint));
                (Self::flat_query(zeros.chain(beside), joints), FIT_SAMPLES)
            }
            Purpose::Calibration => {
                let links = self.zeros_with_links_query(0..0, (LINK_PRIOR_M, LINK_PRIOR_RAD));
                (PrecisionQuery { requested: (0..self.links()).collect(), ..links }, FIT_SAMPLES)
            }
            Purpose::Latency => (Self::flat_query(beside, 1), FIT_SAMPLES),
            Purpose::HandEye => (Self::flat_query(0..hand_eye::WIDTH, 6), hand_eye::MAX_FIT_POSES),
            Purpose::Yaw => {
                let requested = [self.linear.width, TILT_PARAMETER, TILT_PARAMETER + 1];
                let mount = self.links() - 3..self.links();
                let free = [YAW_PARAMETER, self.latency()].into_iter().chain(mount);
                let all = requested.into_iter().chain(free);
                (Self::flat_query(all, 3), imu::MAX_IMU_FIT_SAMPLES)
            }
        }
    }

    /// Log determinant of the covariance; lower is better.
    pub fn score(&self) -> f64 {
        let (query, most) = self.query();
        query.score(&self.information(most))
    }

    /// Precision of the requested quantities.
    pub fn expected_precisions(&self) -> Vec<ExpectedPrecision> {
        let (query, most) = self.query();
        let information = self.information(most);
        if self.purpose == Purpose::Calibration {
            return self.calibrated(&query.covariance(&information));
        }
        let mut found = query.precisions(&information, |at| match self.purpose {
            Purpose::Zeros | Purpose::Calibration => PlannedQuantity::Zero(at),
            Purpose::Latency => PlannedQuantity::Latency,
            Purpose::HandEye if at < 3 => PlannedQuantity::CameraShift(at),
            Purpose::HandEye => PlannedQuantity::CameraTurn(at - 3),
            Purpose::Yaw if at == 0 => PlannedQuantity::YawDrift,
            Purpose::Yaw => PlannedQuantity::Tilt(at - 1),
        });
        if self.purpose == Purpose::Zeros && self.sensing.link_m > 0.0 {
            let kinds = self.chain.joint_kinds();
            for joint in 0..kinds.len() {
                let query = self.zeros_with_links_query(joint..joint + 1, self.link());
                found.extend(query.precisions(&information, |_| PlannedQuantity::ZeroAlone(joint)));
            }
            for (at, precision) in found.iter_mut().enumerate() {
                // Zeros scatter as links do.
                let scatter = match kinds[at % kinds.len()] {
                    JointKind::Prismatic => self.link().0,
                    _ => self.link().1,
                };
                precision.half_width = precision.half_width.hypot(HALF_WIDTH_SIGMAS * scatter);
            }
        }
        found
    }

    /// Tip error along the motion and over the workspace, given the covariance of the links.
    fn calibrated(&self, covariance: &DMatrix<f64>) -> Vec<ExpectedPrecision> {
        let everywhere = random_configurations(self.chain, CONFIGURATIONS, RANDOM_SEED);
        let far = tip_derivatives(self.chain, &everywhere);
        let of = |everywhere: bool, linear: &Linear| {
            let tip = TipSensitivity::from_derivatives(linear, self.links());
            let FkUncertainty { m, rad } = tip.uncertainty(covariance);
            let position = PlannedQuantity::FkPosition { everywhere };
            let rotation = PlannedQuantity::FkRotation { everywhere };
            [(position, m), (rotation, rad)]
                .map(|(quantity, half_width)| ExpectedPrecision { quantity, half_width })
        };
        [of(false, &self.linear), of(true, &far)].concat()
    }
}

/// World rotation about z and x, in the link frames' parameters.
const YAW_PARAMETER: usize = 5;
const TILT_PARAMETER: usize = 3;

/// Mean of `one / other` over the quantities that both determine.
pub fn geometric_mean(one: &[ExpectedPrecision], other: &[ExpectedPrecision]) -> Option<f64> {
    let both = one.iter().zip(other).map(|(one, other)| (one.half_width / other.half_width).ln());
    let logs: Vec<f64> = both.filter(|log| log.is_finite()).collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}
