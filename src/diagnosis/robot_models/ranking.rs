//! Ranks arm models by the assumptions they need to explain a stream's positions: none, an active TCP, a
//! joint zero, or another reference frame. Among arms with the same joint names, the log belongs to the one
//! that needs least. The ranking decides no verdict.
//!
//! Each hypothesis is a least-squares fit of `p(s) = reference · FK(q(s − τ) + δ) · tool` with free latency
//! on a few dozen slow samples. No rotation encoding matters.

use super::position_misfit::{MIN_SAMPLES, SlowPositions};
use crate::PoseStream;
use crate::distinct::by_score;
use crate::encodings::position::metres_by_size;
use crate::frames::position_fit::PositionFit;
use crate::latency::correlation::{joint_speed_lags, linear_speed};
use crate::model::jacobian::PoseJacobian;
use crate::model::measurement::pose_of_twist;
use crate::priors::{FLANGE_PRIOR_M, TOOL_PRIOR_M, price};
use crate::solver::linear::{Linear, Normal};
use crate::solver::minimize::{LeastSquares, Limits, MIN_DAMPING, minimize};
use crate::solver::robust::trimmed_rms;
use ground::geometry::{Pose, Rotation, Vec3, pose};
use ground::stream::JointTrack;

/// If all residuals are larger, inverted poses and joints in degrees are tried.
const MIN_LARGE_RESIDUAL_M: f64 = 5e-3;

/// Smaller residuals do not count. Nominal models have 0.1 to 1.3 mm, and a wrong arm with a free tool fits
/// short motion to micrometres.
const RESIDUAL_FLOOR_M: f64 = 1e-3;
/// Limited because samples of one motion are correlated. With 20, an absent zero or tool is never preferred
/// to link deviations (0.3 mm and 0.05° each, rich motion) in 60 generated runs.
const MAX_EFFECTIVE_SAMPLES: f64 = 20.0;

/// Cause that a fit assumes, the most harmless first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FitCause {
    /// No cause.
    Nothing,
    /// Base turned by 180° about z (`base` for `base_link`).
    HalfTurn,
    /// Zero offset of one joint.
    Zero {
        /// Joint index in the chain.
        joint: usize,
    },
    /// Another reference frame.
    Reference,
}

impl FitCause {
    /// Whether it is no fault: none, or the other usual base.
    pub fn is_faultless(self) -> bool {
        matches!(self, Self::Nothing | Self::HalfTurn)
    }

    /// Parameter count, without latency and tool.
    fn parameters(self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::HalfTurn | Self::Zero { .. } => 1,
            Self::Reference => 6,
        }
    }
}

/// A cause, and whether a tool is fitted.
type Assumption = (FitCause, bool);

/// Fit of a model to a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HypothesisFit {
    /// Cause assumed.
    pub cause: FitCause,
    /// Whether a constant tool offset is fitted: an active TCP.
    pub has_tool: bool,
    /// Whether poses are inverted or joints in degrees.
    pub is_misinterpreted: bool,
    /// Position residual over the best 90 %, rms m.
    pub residual_m: f64,
    /// Tool offset, link frame, m.
    pub tool_m: Vec3,
    /// Latency, s.
    pub lag_s: f64,
}

/// Fits of a model to a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelFit {
    /// Latency at which the samples were selected, s.
    lag_s: f64,
    /// Samples fitted.
    pub samples: usize,
    /// Rms distance from the mean, m.
    pub spread_m: f64,
    /// Residual with only latency fitted, m.
    pub as_is_m: f64,
    /// All fits.
    pub fits: Vec<HypothesisFit>,
}

/// Fit with its score; lower is better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredFit {
    /// The fit.
    pub fit: HypothesisFit,
    /// `n ln σ²` plus the price of the parameters.
    pub score: f64,
}

impl ModelFit {
    /// Smallest residual without a fault, m.
    pub fn faultless_residual_m(&self) -> f64 {
        let faultless =
            self.fits.iter().filter(|fit| fit.cause.is_faultless() && !fit.is_misinterpreted);
        faultless.map(|fit| fit.residual_m).fold(f64::INFINITY, f64::min)
    }

    /// Fit with the lowest score.
    pub fn best(&self) -> Option<ScoredFit> {
        let fits = self.fits.iter().map(|fit| ScoredFit { fit: *fit, score: self.score(fit) });
        fits.min_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// Adds fits with a fault, unless one with all faults together would score more than `max_score`. The arguments are
    /// those of [`fit_model`].
    pub fn add_faulty_fits(
        &mut self,
        joints: &JointTrack,
        stream: &PoseStream,
        max_lag_s: f64,
        max_score: f64,
    ) {
        let min_score = |residual_m: f64| self.price(residual_m, 1.0);
        let own_score = self.best().map_or(f64::INFINITY, |best| best.score);
        if own_score <= min_score(0.0) {
            return;
        }
        let scale = metres_by_size(joints, stream);
        let lags_s = (self.lag_s, max_lag_s);
        let Some(stream_with_fk) = StreamWithFk::new(joints, stream, scale, lags_s) else { return };
        if own_score > max_score && min_score(stream_with_fk.least_residual_m()) > max_score {
            return;
        }
        self.fits.extend(stream_with_fk.faulty_fits());
        if self.fits.iter().all(|fit| fit.residual_m > MIN_LARGE_RESIDUAL_M) {
            self.fits.extend(stream_with_fk.misinterpreted_fits());
        }
    }

    /// Score of a perfect fit without parameters. No model scores lower.
    pub fn lowest_score(&self) -> f64 {
        self.price(0.0, 0.0)
    }

    fn score(&self, fit: &HypothesisFit) -> f64 {
        let misread = if fit.is_misinterpreted { 3.0 } else { 0.0 };
        let parameters = fit.cause.parameters() as f64 + misread;
        self.price(fit.residual_m, parameters) + self.tool_price(&fit.tool_m)
    }

    /// The cheapest of a link deviation, an offset along the flange axis, and an arbitrary tool.
    fn tool_price(&self, tool_m: &Vec3) -> f64 {
        let of_parameter = price(self.effective_samples());
        let deviation = |length_m: f64| 0.5 * (length_m / FLANGE_PRIOR_M).powi(2);
        let prior = (tool_m.norm() / TOOL_PRIOR_M).powi(2);
        let along_axis = of_parameter + deviation(tool_m.xy().norm()) + prior;
        deviation(tool_m.norm()).min(along_axis).min(3.0 * of_parameter + prior)
    }

    fn price(&self, residual_m: f64, parameters: f64) -> f64 {
        let n = self.effective_samples();
        n * (residual_m.powi(2) + RESIDUAL_FLOOR_M.powi(2)).ln() + price(n) * parameters
    }

    fn effective_samples(&self) -> f64 {
        (self.samples as f64).min(MAX_EFFECTIVE_SAMPLES)
    }
}

/// Which hypotheses to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitHypotheses {
    /// Only [`FitCause::Nothing`] without a tool, from zero latency.
    Nothing,
    /// Those without a fault.
    Faultless,
}

/// Fits the model of `stream`'s chain, without a fault. `None` if the joint states cover too few samples.
pub fn fit_model(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
    tried: FitHypotheses,
) -> Option<ModelFit> {
    let scale = metres_by_size(joints, stream);
    if tried == FitHypotheses::Nothing {
        let at_zero = StreamWithFk::new(joints, stream, scale, (0.0, max_lag_s))?;
        return Some(at_zero.fit_under(&[(FitCause::Nothing, false)]));
    }
    let lag_s = candidate_lags(joints, stream, max_lag_s);
    let is_only = lag_s.len() == 1;
    let at_lag = |lag_s| {
        let stream_with_fk = StreamWithFk::new(joints, stream, scale, (lag_s, max_lag_s))?;
        let residual_m = if is_only { 0.0 } else { stream_with_fk.residual_with_tool_m() };
        Some((residual_m, stream_with_fk))
    };
    let candidates = lag_s.into_iter().filter_map(at_lag);
    let (_, stream_with_fk) = candidates.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(stream_with_fk.fit())
}

/// Cheapest fit without a fault, or, if `with_zero`, with one joint zero. An unknown frame is free. `None`
/// if the joint states cover too few samples.
pub(crate) fn tool_fit(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
    with_zero: bool,
) -> Option<ScoredFit> {
    let scale = metres_by_size(joints, stream);
    let zeros = (0..stream.chain.dof()).map(|joint| (FitCause::Zero { joint }, true));
    let zeros: Vec<Assumption> = zeros.collect();
    let candidates = candidate_lags(joints, stream, max_lag_s).into_iter();
    let candidates =
        candidates.filter_map(|lag_s| StreamWithFk::new(joints, stream, scale, (lag_s, max_lag_s)));
    let best = candidates.filter_map(|stream_with_fk| {
        let fit = match with_zero {
            true => stream_with_fk.fit_under(&zeros),
            false => stream_with_fk.fit(),
        };
        fit.best()
    });
    best.min_by(|a, b| a.score.total_cmp(&b.score))
}

pub(crate) fn frame_price(samples: usize) -> f64 {
    let free = FitCause::Reference.parameters() as f64;
    free * price((samples as f64).min(MAX_EFFECTIVE_SAMPLES))
}

/// From the correlation of stream and joint speeds, and zero.
fn candidate_lags(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let mut lags = joint_speed_lags(joints, &vec![1.0; joints.dof], &speed, max_lag_s);
    lags.retain(|lag_s| lag_s.abs() > 0.02);
    lags.insert(0, 0.0);
    lags
}

fn half_turn() -> Pose {
    Pose::rotation(Vec3::z() * std::f64::consts::PI)
}

#[derive(Clone)]
struct StreamWithFk<'a> {
    joints: &'a JointTrack,
    stream: PoseStream<'a>,
    lag_s: f64,
    max_lag_s: f64,
    samples: SlowPositions,
    in_degrees: bool,
}

#[derive(Clone)]
struct FittedParameters {
    lag_s: f64,
    zeros: Vec<f64>,
    reference: Pose,
    tool: Vec3,
}

impl<'a> StreamWithFk<'a> {
    fn new(
        joints: &'a JointTrack,
        stream: &PoseStream<'a>,
        scale: f64,
        (lag_s, max_lag_s): (f64, f64),
    ) -> Option<Self> {
        let samples = SlowPositions::new(joints, stream, scale, lag_s)?;
        Some(Self { joints, stream: *stream, lag_s, max_lag_s, samples, in_degrees: false })
    }

    fn fit(&self) -> ModelFit {
        self.fit_under(&[
            (FitCause::Nothing, false),
            (FitCause::Nothing, true),
            (FitCause::HalfTurn, false),
            (FitCause::HalfTurn, true),
        ])
    }

    fn fit_under(&self, assumptions: &[Assumption]) -> ModelFit {
        let fits = assumptions.iter().flat_map(|assumption| self.fits_under(*assumption)).collect();
        let unfitted = self.solve(self.start(Pose::identity()), &[0], ToolPrior::None);
        ModelFit {
            lag_s: self.lag_s,
            samples: self.samples.t_s.len(),
            spread_m: crate::frames::position_fit::spread(&self.samples.xyz),
            as_is_m: unfitted.0,
            fits,
        }
    }

    /// Residual with any tool, which every hypothesis without a fault restricts.
    fn residual_with_tool_m(&self) -> f64 {
        let faultless = [FitCause::Nothing, FitCause::HalfTurn];
        let fits = faultless.into_iter().filter_map(|it| self.fit_with(it, ToolPrior::None));
        fits.map(|fit| fit.residual_m).fold(f64::INFINITY, f64::min)
    }

    /// Residual with zeros of all joints, any reference and any tool, which every hypothesis restricts.
    fn least_residual_m(&self) -> f64 {
        let all = self.parameters(0..self.stream.chain.dof(), true);
        let starts = self.starts(true).into_iter();
        starts.map(|start| self.solve(start, &all, ToolPrior::None).0).fold(f64::INFINITY, f64::min)
    }

    /// Fits to poses and joints as logged.
    fn faulty_fits(&self) -> Vec<HypothesisFit> {
        let zeros = [false, true].into_iter().flat_map(|tool| {
            let joints = self.likely_zeros(tool).into_iter();
            joints.map(move |joint| (FitCause::Zero { joint }, tool))
        });
        let references = [false, true].map(|tool| (FitCause::Reference, tool));
        references.into_iter().chain(zeros).flat_map(|it| self.fits_under(it)).collect()
    }

    /// Inverted poses, joints in degrees.
    fn misinterpreted_fits(&self) -> Vec<HypothesisFit> {
        const ASSUMPTIONS: [Assumption; 3] =
            [(FitCause::Nothing, false), (FitCause::Nothing, true), (FitCause::Reference, true)];
        let of = |stream_with_fk: StreamWithFk<'_>| {
            let fits = ASSUMPTIONS.into_iter().flat_map(|it| stream_with_fk.fits_under(it));
            fits.map(|fit| HypothesisFit { is_misinterpreted: true, ..fit }).collect::<Vec<_>>()
        };
        let inverted = self.samples.inverse_xyz.clone().map(|xyz| {
            of(StreamWithFk { samples: SlowPositions { xyz, ..self.samples.clone() }, ..*self })
        });
        let mut in_radians = StreamWithFk { in_degrees: true, ..self.clone() };
        in_radians.samples.fk = in_radians.poses();
        inverted.into_iter().flatten().chain(of(in_radians)).collect()
    }

    fn poses(&self) -> Vec<Pose> {
        let mut poses = Vec::with_capacity(self.samples.t_s.len());
        self.predict(&self.start(Pose::identity()), |jacobian, _, _| poses.push(jacobian.pose));
        poses
    }

    fn start(&self, reference: Pose) -> FittedParameters {
        let zeros = vec![0.0; self.stream.chain.dof()];
        FittedParameters { lag_s: self.lag_s, zeros, reference, tool: Vec3::zeros() }
    }

    /// Indices of the latency, these joint zeros, the reference if it is free, and the tool.
    fn parameters(
        &self,
        zeros: impl IntoIterator<Item = usize>,
        is_reference_free: bool,
    ) -> Vec<usize> {
        let dof = self.stream.chain.dof();
        let reference = 1 + dof..if is_reference_free { 7 + dof } else { 1 + dof };
        let zeros = zeros.into_iter().map(|joint| 1 + joint);
        [0].into_iter().chain(zeros).chain(reference).chain(7 + dof..10 + dof).collect()
    }

    /// Joints whose zeros reduce the linearised residual most.
    fn likely_zeros(&self, tool: bool) -> Vec<usize> {
        const MAX_JOINTS: usize = 3;
        let dof = self.stream.chain.dof();
        let is_free = !self.stream.reference_known;
        let free = self.parameters(0..dof, is_free);
        let prior = if tool { ToolPrior::None } else { ToolPrior::Deviation };
        let hypothesis = Hypothesis { stream: self, free: &free, prior };
        let starts = self.starts(is_free).into_iter();
        let linear = starts.filter_map(|start| hypothesis.linearize(&start));
        let Some(linear) = linear.min_by(|a, b| a.cost.total_cmp(&b.cost)) else {
            return Vec::new();
        };
        let cost_with = |joint: usize| {
            let is_free = |at: &usize| !(1..=dof).contains(at) || *at == 1 + joint;
            let parameters: Vec<usize> = (0..free.len()).filter(is_free).collect();
            let own = linear.selected(&parameters);
            let step = own.damped_step(MIN_DAMPING);
            step.map_or(f64::INFINITY, |step| own.cost - own.right.dot(&step))
        };
        let joints = (0..dof).map(|joint| (cost_with(joint), joint));
        by_score(joints).take(MAX_JOINTS).collect()
    }

    /// Collinear positions leave the rotation about the line free, so a free reference starts from each usual frame.
    fn starts(&self, is_reference_free: bool) -> Vec<FittedParameters> {
        if !is_reference_free {
            return vec![self.start(Pose::identity())];
        }
        let fit = PositionFit { fk: &self.samples.fk, xyz: &self.samples.xyz };
        let (rigid, _) = fit.fit_rigid_or_collinear();
        let frames = [Pose::identity(), half_turn(), rigid];
        frames.map(|reference| self.start(reference)).to_vec()
    }

    /// Fits the parameters of the cause, and an unknown reference. A tool is fitted twice: in any
    /// direction, and along the flange axis. Without a tool, a link deviation is fitted.
    fn fits_under(&self, (cause, has_tool): Assumption) -> Vec<HypothesisFit> {
        let priors: &[ToolPrior] = match has_tool {
            false => &[ToolPrior::Deviation],
            true => &[ToolPrior::None, ToolPrior::AlongAxis],
        };
        priors.iter().filter_map(|&prior| self.fit_with(cause, prior)).collect()
    }

    fn fit_with(&self, cause: FitCause, prior: ToolPrior) -> Option<HypothesisFit> {
        let is_free = !self.stream.reference_known;
        if is_free && matches!(cause, FitCause::Reference | FitCause::HalfTurn) {
            return None;
        }
        let reference = is_free || cause == FitCause::Reference;
        let zero = match cause {
            FitCause::Zero { joint } => Some(joint),
            _ => None,
        };
        let free = self.parameters(zero, reference);
        let starts = match cause {
            FitCause::HalfTurn => vec![self.start(half_turn())],
            _ => self.starts(reference),
        };
        let solutions = starts.into_iter().map(|start| self.solve(start, &free, prior));
        let (residual_m, parameters) = solutions.min_by(|a, b| a.0.total_cmp(&b.0))?;
        residual_m.is_finite().then_some(HypothesisFit {
            cause,
            has_tool: !matches!(prior, ToolPrior::Deviation),
            is_misinterpreted: false,
            residual_m,
            tool_m: parameters.tool,
            lag_s: parameters.lag_s,
        })
    }

    /// Fits `free`, indexed as latency, joint zeros, reference, tool. Returns the residual over the best 90 %, rms m;
    /// infinite if joint states cover too few samples.
    fn solve(
        &self,
        parameters: FittedParameters,
        free: &[usize],
        prior: ToolPrior,
    ) -> (f64, FittedParameters) {
        const LIMITS: Limits = Limits { steps: 10, min_gain: 2e-5 };
        let hypothesis = Hypothesis { stream: self, free, prior };
        let Some((_, fitted)) = minimize(&hypothesis, parameters.clone(), LIMITS) else {
            return (f64::INFINITY, parameters);
        };
        let mut squares = Vec::with_capacity(self.samples.t_s.len());
        self.predict(&fitted, |jacobian, _, logged| {
            squares.push((logged - jacobian.pose.translation.vector).norm_squared());
        });
        (trimmed_rms(squares), fitted)
    }

    /// Visits the covered samples: predicted pose with derivatives, joint velocities, logged position.
    fn predict(
        &self,
        parameters: &FittedParameters,
        mut visit: impl FnMut(&PoseJacobian, &[f64], &Vec3),
    ) {
        let (chain, columns) = (self.stream.chain, self.stream.columns);
        let mut sequence = self.joints.sequence();
        let (mut q, mut qd) = (vec![0.0; chain.dof()], vec![0.0; chain.dof()]);
        let mut link_columns = vec![[0.0; 6]; chain.dof()];
        let tool = pose(parameters.tool.into(), Rotation::identity());
        for (&t_s, logged) in self.samples.t_s.iter().zip(&self.samples.xyz) {
            let Some((track_q, track_qd)) = sequence.at(t_s - parameters.lag_s) else { continue };
            for (at, &column) in columns.iter().enumerate() {
                let turns = self.in_degrees && !chain.slides(at);
                let unit = if turns { 1_f64.to_radians() } else { 1.0 };
                q[at] = unit * track_q[column] + parameters.zeros[at];
                qd[at] = unit * track_qd[column];
            }
            let link = chain.forward_with_jacobian(&q, &mut link_columns);
            let jacobian = PoseJacobian::new(&link_columns, &parameters.reference, &link, &tool);
            visit(&jacobian, &qd, logged);
        }
    }
}

struct Hypothesis<'a> {
    stream: &'a StreamWithFk<'a>,
    free: &'a [usize],
    prior: ToolPrior,
}

impl LeastSquares for Hypothesis<'_> {
    type State = FittedParameters;

    fn linearize(&self, parameters: &FittedParameters) -> Option<Normal> {
        /// At the fitted latency. Few covered samples fit too easily.
        const MIN_COVERED_SHARE: f64 = 0.75;
        let dof = parameters.zeros.len();
        let mut linear = Linear::new(self.free.len(), &[0.0]);
        self.stream.predict(parameters, |jacobian, qd, logged| {
            let derivative = |&parameter: &usize| match parameter {
                0 => -jacobian.velocity(qd)[0],
                p if p <= dof => jacobian.joint(p - 1)[0],
                p if p <= 6 + dof => jacobian.reference(p - 1 - dof)[0],
                p => jacobian.tool(p - 7 - dof)[0],
            };
            let mut rows = linear.push(&[logged - jacobian.pose.translation.vector]);
            rows.set_from(0, self.free.iter().map(derivative));
        });
        let min_covered = (MIN_COVERED_SHARE * self.stream.samples.t_s.len() as f64) as usize;
        if linear.len() < MIN_SAMPLES.max(min_covered) {
            return None;
        }
        let mut normal = linear.normal(&linear.even_weights());
        let weights = self.prior.weights() * (linear.len() as f64).sqrt();
        for (at, &parameter) in self.free.iter().enumerate() {
            if let Some(axis) = parameter.checked_sub(7 + dof) {
                normal.add_prior(at, weights[axis], -parameters.tool[axis]);
            }
        }
        Some(normal)
    }

    fn moved(&self, parameters: &FittedParameters, step: &[f64]) -> FittedParameters {
        let mut moved = parameters.clone();
        let (dof, max_lag_s) = (moved.zeros.len(), self.stream.max_lag_s);
        let mut twist = [0.0; 6];
        for (&at, change) in self.free.iter().zip(step) {
            match at {
                0 => moved.lag_s = (moved.lag_s + change).clamp(-max_lag_s, max_lag_s),
                at if at <= dof => moved.zeros[at - 1] += change,
                at if at <= 6 + dof => twist[at - 1 - dof] = *change,
                at => moved.tool[at - 7 - dof] += change,
            }
        }
        moved.reference = pose_of_twist(&twist) * moved.reference;
        moved
    }
}

/// Rms distance from the median over the best 90 %, comparable with residuals.
pub(crate) fn extent(xyz: &[Vec3]) -> f64 {
    let middle: [f64; 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = xyz.iter().map(|xyz| xyz[axis]).collect();
        ground::stats::median(&mut values).unwrap_or(0.0)
    });
    let middle = Vec3::from(middle);
    trimmed_rms(xyz.iter().map(|xyz| (xyz - middle).norm_squared()).collect())
}

#[derive(Clone, Copy)]
enum ToolPrior {
    /// Flat prior.
    None,
    /// Tool on the flange axis, up to link deviations.
    AlongAxis,
    /// Zero tool, up to link deviations.
    Deviation,
}

impl ToolPrior {
    /// Weights relative to the rms residual.
    fn weights(self) -> Vec3 {
        let each = RESIDUAL_FLOOR_M / FLANGE_PRIOR_M / MAX_EFFECTIVE_SAMPLES.sqrt();
        match self {
            Self::None => Vec3::zeros(),
            Self::AlongAxis => Vec3::new(each, each, 0.0),
            Self::Deviation => Vec3::repeat(each),
        }
    }
}
