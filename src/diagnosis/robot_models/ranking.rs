//! Ranks arm models by the assumptions they need to explain a stream's positions: none, an active TCP, a
//! joint zero, or another reference frame. Among arms with the same joint names, the log belongs to the one
//! that needs least. The ranking decides no verdict.
//!
//! Each hypothesis is a Gauss–Newton fit of `p(s) = reference · FK(q(s − τ) + δ) · tool` with free latency
//! on a few dozen slow samples. No rotation encoding matters.

use crate::PoseStream;
use crate::encodings::position::metres_by_size;
use crate::frames::position_fit::FkColumns;
use crate::latency::correlation::{joint_activity, lag_peaks, linear_speed};
use crate::model::measurement::pose_of_twist;
use crate::samples::sampling::slow_samples;
use ground::geometry::{Pose, Vec3};
use ground::robot::JointKind;
use ground::stream::{JointTrack, Orientations};
use nalgebra::{DMatrix, DVector, Point3};

const MIN_SAMPLES: usize = 12;
/// If all residuals are larger, inverted poses and joints in degrees are tried.
const MIN_LARGE_RESIDUAL_M: f64 = 5e-3;

/// Prior on tool length: grippers are 0.1 to 0.3 m long; a TCP beyond 0.5 m is rare.
const TOOL_PRIOR_M: f64 = 0.2;
/// Prior on the flange deviation of a calibrated arm. Healthy UR5e of two public data sets deviate by 0.1
/// to 1.6 mm (docs/real-logs.md).
const DEVIATION_PRIOR_M: f64 = 1e-3;
/// Smaller residuals do not count. Nominal models have 0.1 to 1.3 mm, and a wrong arm with a free tool fits
/// short motion to micrometres.
const RESIDUAL_FLOOR_M: f64 = 1e-3;
/// Limited because samples of one motion are correlated. With 20, an absent zero or tool is never preferred
/// to link deviations (0.3 mm and 0.05° each, rich motion) in 60 generated runs.
const MAX_EFFECTIVE_SAMPLES: f64 = 20.0;

/// Assumption of a fit, the most harmless first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FitAssumption {
    /// No assumption.
    Nothing,
    /// Constant tool offset: an active TCP.
    Tool,
    /// Base turned by 180° about z (`base` for `base_link`).
    HalfTurn {
        /// Whether a tool is fitted.
        tool: bool,
    },
    /// Zero offset of one joint.
    Zero {
        /// Joint index in the chain.
        joint: usize,
        /// Whether a tool is fitted.
        tool: bool,
    },
    /// Another reference frame.
    Reference {
        /// Whether a tool is fitted.
        tool: bool,
    },
}

impl FitAssumption {
    /// Whether it is no fault: none, an active TCP, or the other usual base.
    pub fn is_faultless(self) -> bool {
        matches!(
            self,
            FitAssumption::Nothing | FitAssumption::Tool | FitAssumption::HalfTurn { .. }
        )
    }

    /// Whether a tool is fitted.
    pub fn has_tool(self) -> bool {
        match self {
            FitAssumption::Nothing => false,
            FitAssumption::Tool => true,
            FitAssumption::HalfTurn { tool }
            | FitAssumption::Zero { tool, .. }
            | FitAssumption::Reference { tool } => tool,
        }
    }

    /// Parameter count, without latency and tool.
    fn parameters(self) -> usize {
        match self {
            FitAssumption::Nothing | FitAssumption::Tool => 0,
            FitAssumption::HalfTurn { .. } | FitAssumption::Zero { .. } => 1,
            FitAssumption::Reference { .. } => 6,
        }
    }
}

/// Fit of a model to a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HypothesisFit {
    /// Assumption made.
    pub assumption: FitAssumption,
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
            self.fits.iter().filter(|fit| fit.assumption.is_faultless() && !fit.is_misinterpreted);
        faultless.map(|fit| fit.residual_m).fold(f64::INFINITY, f64::min)
    }

    /// Fit with the lowest score.
    pub fn best(&self) -> Option<ScoredFit> {
        let fits = self.fits.iter().map(|fit| ScoredFit { fit: *fit, score: self.score(fit) });
        fits.min_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// Whether no faulty hypothesis can score lower, given its additional parameters.
    pub fn is_conclusive(&self) -> bool {
        let min_faulty_score = self.price(0.0, 1.0);
        self.best().is_some_and(|best| best.score <= min_faulty_score)
    }

    fn score(&self, fit: &HypothesisFit) -> f64 {
        let misread = if fit.is_misinterpreted { 3.0 } else { 0.0 };
        let parameters = fit.assumption.parameters() as f64 + misread;
        self.price(fit.residual_m, parameters) + self.tool_price(&fit.tool_m)
    }

    /// The cheapest of a link deviation, an offset along the flange axis, and an arbitrary tool.
    fn tool_price(&self, tool_m: &Vec3) -> f64 {
        let price = crate::selection::model_selection::price(self.effective_samples());
        let deviation = |length_m: f64| 0.5 * (length_m / DEVIATION_PRIOR_M).powi(2);
        let prior = (tool_m.norm() / TOOL_PRIOR_M).powi(2);
        let along_axis = price + deviation(tool_m.xy().norm()) + prior;
        deviation(tool_m.norm()).min(along_axis).min(3.0 * price + prior)
    }

    fn price(&self, residual_m: f64, parameters: f64) -> f64 {
        let n = self.effective_samples();
        n * (residual_m.powi(2) + RESIDUAL_FLOOR_M.powi(2)).ln()
            + crate::selection::model_selection::price(n) * parameters
    }

    fn effective_samples(&self) -> f64 {
        (self.samples as f64).min(MAX_EFFECTIVE_SAMPLES)
    }
}

/// Which hypotheses to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitHypotheses {
    /// Those without a fault.
    Faultless,
    /// Every hypothesis.
    All,
}

/// Fits the model of `stream`'s chain. `None` if the joint states cover too few samples.
pub fn fit_model(
    joints: &JointTrack,
    stream: &PoseStream,
    max_lag_s: f64,
    tried: FitHypotheses,
) -> Option<ModelFit> {
    let scale = metres_by_size(joints, stream);
    let lag_s = candidate_lags(joints, stream, max_lag_s);
    let of = |lag_s| StreamWithFk::new(joints, stream, scale, (lag_s, max_lag_s));
    let candidates = lag_s.into_iter().filter_map(of);
    let best = candidates
        .map(|stream_with_fk| {
            let fit = stream_with_fk.fit();
            (fit.faultless_residual_m(), stream_with_fk, fit)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, stream_with_fk, mut fit) = best?;
    if tried == FitHypotheses::Faultless {
        return Some(fit);
    }
    fit.fits.extend(stream_with_fk.faulty_fits());
    if fit.fits.iter().all(|fit| fit.residual_m > MIN_LARGE_RESIDUAL_M) {
        fit.fits.extend(stream_with_fk.misinterpreted_fits());
    }
    Some(fit)
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
    let zeros = (0..stream.chain.dof()).map(|joint| FitAssumption::Zero { joint, tool: true });
    let candidates = candidate_lags(joints, stream, max_lag_s).into_iter();
    let candidates =
        candidates.filter_map(|lag_s| StreamWithFk::new(joints, stream, scale, (lag_s, max_lag_s)));
    let best = candidates.filter_map(|stream_with_fk| {
        let mut fit = stream_with_fk.fit();
        if with_zero {
            fit.fits = zeros
                .clone()
                .flat_map(|assumption| stream_with_fk.fits_under(assumption))
                .collect();
        }
        fit.best()
    });
    best.min_by(|a, b| a.score.total_cmp(&b.score))
}

pub(crate) fn frame_price(samples: usize) -> f64 {
    let free = FitAssumption::Reference { tool: false }.parameters() as f64;
    free * crate::selection::model_selection::price((samples as f64).min(MAX_EFFECTIVE_SAMPLES))
}

/// From the correlation of stream speed and joint activity, and zero.
fn candidate_lags(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let peaks = lag_peaks(&joint_activity(joints), &speed, max_lag_s);
    let near = peaks.iter().filter(|peak| peak.correlation > 0.4).take(2).map(|peak| peak.lag_s);
    std::iter::once(0.0).chain(near.filter(|lag_s| lag_s.abs() > 0.02)).collect()
}

struct StreamWithFk<'a> {
    joints: &'a JointTrack,
    stream: PoseStream<'a>,
    lag_s: f64,
    max_lag_s: f64,
    t_s: Vec<f64>,
    xyz: Vec<Vec3>,
    /// `None` without rotations.
    inverse_xyz: Option<Vec<Vec3>>,
    fk: Vec<Pose>,
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
        let PoseStream { track, chain, columns, .. } = *stream;
        let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, lag_s);
        let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row] * scale).collect();
        let inverse_xyz = match &track.orientation {
            Orientations::Rotations(all) => {
                let inverse = rows.iter().zip(&xyz).map(|(&row, p)| -(all[row].inverse() * p));
                Some(inverse.collect())
            }
            Orientations::Numbers(_) | Orientations::Unset(_) => None,
        };
        let t_s = rows.iter().map(|&row| track.t_s[row]).collect();
        (rows.len() >= MIN_SAMPLES).then_some(Self {
            joints,
            stream: *stream,
            lag_s,
            max_lag_s,
            t_s,
            xyz,
            inverse_xyz,
            fk,
            in_degrees: false,
        })
    }

    fn fit(&self) -> ModelFit {
        let half_turns = [false, true].map(|tool| FitAssumption::HalfTurn { tool });
        let assumption =
            [FitAssumption::Nothing, FitAssumption::Tool].into_iter().chain(half_turns);
        let fits = assumption.flat_map(|assumption| self.fits_under(assumption)).collect();
        let unfitted = self.solve(self.initial_parameters(), &[0], ToolPrior::None);
        ModelFit {
            samples: self.t_s.len(),
            spread_m: crate::frames::position_fit::spread(&self.xyz),
            as_is_m: unfitted.0,
            fits,
        }
    }

    /// Fits to poses and joints as logged.
    fn faulty_fits(&self) -> Vec<HypothesisFit> {
        let dof = self.stream.chain.dof();
        let zeros = (0..dof)
            .flat_map(|joint| [false, true].map(|tool| FitAssumption::Zero { joint, tool }));
        let references = [false, true].map(|tool| FitAssumption::Reference { tool });
        references
            .into_iter()
            .chain(zeros)
            .flat_map(|assumption| self.fits_under(assumption))
            .collect()
    }

    /// Inverted poses, joints in degrees.
    fn misinterpreted_fits(&self) -> Vec<HypothesisFit> {
        let of = |stream_with_fk: StreamWithFk<'_>| {
            let assumption = [
                FitAssumption::Nothing,
                FitAssumption::Tool,
                FitAssumption::Reference { tool: true },
            ];
            let fits =
                assumption.into_iter().flat_map(|assumption| stream_with_fk.fits_under(assumption));
            fits.map(|fit| HypothesisFit { is_misinterpreted: true, ..fit }).collect::<Vec<_>>()
        };
        let unchanged = || StreamWithFk {
            joints: self.joints,
            stream: self.stream,
            lag_s: self.lag_s,
            max_lag_s: self.max_lag_s,
            t_s: self.t_s.clone(),
            xyz: self.xyz.clone(),
            inverse_xyz: None,
            fk: self.fk.clone(),
            in_degrees: self.in_degrees,
        };
        let inverted = self.inverse_xyz.clone().map(|xyz| of(StreamWithFk { xyz, ..unchanged() }));
        let mut in_radians = StreamWithFk { in_degrees: true, ..unchanged() };
        in_radians.fk = in_radians.poses();
        inverted.into_iter().flatten().chain(of(in_radians)).collect()
    }

    fn poses(&self) -> Vec<Pose> {
        let parameters = self.initial_parameters();
        let mut chain_state = ChainState::new(self);
        let mut poses = Vec::with_capacity(self.t_s.len());
        for &t_s in &self.t_s {
            if chain_state.at(t_s, &parameters) {
                chain_state.pose = self.stream.chain.forward(&chain_state.q);
                poses.push(chain_state.pose);
            }
        }
        poses
    }

    fn initial_parameters(&self) -> FittedParameters {
        FittedParameters {
            lag_s: self.lag_s,
            zeros: vec![0.0; self.stream.chain.dof()],
            reference: Pose::identity(),
            tool: Vec3::zeros(),
        }
    }

    /// Fits the parameters of `assumption`, and an unknown reference. A tool is fitted twice: in any
    /// direction, and along the flange axis. Without a tool, a link deviation is fitted.
    fn fits_under(&self, assumption: FitAssumption) -> Vec<HypothesisFit> {
        let dof = self.stream.chain.dof();
        let is_free = !self.stream.reference_known;
        let reference = match assumption {
            FitAssumption::Reference { .. } | FitAssumption::HalfTurn { .. } if is_free => {
                return Vec::new();
            }
            FitAssumption::Reference { .. } => true,
            _ => is_free,
        };
        let mut free = vec![0];
        if let FitAssumption::Zero { joint, .. } = assumption {
            free.push(1 + joint);
        }
        free.extend((0..6).filter(|_| reference).map(|at| 1 + dof + at));
        free.extend((0..3).map(|at| 7 + dof + at));
        let from = |reference: Pose| FittedParameters { reference, ..self.initial_parameters() };
        let half_turn = Pose::rotation(Vec3::z() * std::f64::consts::PI);
        let starts = match (assumption, reference) {
            (FitAssumption::HalfTurn { .. }, _) => vec![from(half_turn)],
            (_, false) => vec![self.initial_parameters()],
            // Collinear positions leave the rotation about the line free, so start from each usual frame.
            (_, true) => {
                let (rigid, _) = FkColumns::from_poses(&self.fk).fit_rigid_or_collinear(&self.xyz);
                vec![self.initial_parameters(), from(half_turn), from(rigid)]
            }
        };
        let priors: &[ToolPrior] = match assumption.has_tool() {
            false => &[ToolPrior::Deviation],
            true => &[ToolPrior::None, ToolPrior::AlongAxis],
        };
        let fits = priors.iter().filter_map(|&prior| {
            let solutions = starts.iter().map(|start| self.solve(start.clone(), &free, prior));
            let (residual_m, parameters) = solutions.min_by(|a, b| a.0.total_cmp(&b.0))?;
            residual_m.is_finite().then_some(HypothesisFit {
                assumption,
                is_misinterpreted: false,
                residual_m,
                tool_m: parameters.tool,
                lag_s: parameters.lag_s,
            })
        });
        fits.collect()
    }

    /// Gauss–Newton on `free`, indexed as latency, joint zeros, reference, tool.
    fn solve(
        &self,
        mut parameters: FittedParameters,
        free: &[usize],
        prior: ToolPrior,
    ) -> (f64, FittedParameters) {
        const MAX_ROUNDS: usize = 10;
        const CONVERGED_COST_CHANGE: f64 = 1e-5;
        let mut min_residual_m = f64::INFINITY;
        let mut best = (f64::INFINITY, parameters.clone());
        for round in 0..=MAX_ROUNDS {
            let (residual_m, step) = self.step(&parameters, free, prior);
            let cost = residual_m.hypot(prior.pull(&parameters.tool).norm());
            let gain = min_residual_m - cost;
            if gain > 0.0 {
                (min_residual_m, best) = (cost, (residual_m, parameters.clone()));
            }
            let Some(step) =
                step.filter(|_| round < MAX_ROUNDS && gain.abs() > CONVERGED_COST_CHANGE * cost)
            else {
                break;
            };
            let dof = parameters.zeros.len();
            for (&at, &change) in free.iter().zip(step.iter()) {
                match at {
                    0 => {
                        let most_s = self.max_lag_s;
                        parameters.lag_s = (parameters.lag_s + change).clamp(-most_s, most_s);
                    }
                    at if at <= dof => parameters.zeros[at - 1] += change,
                    at if at > 6 + dof => parameters.tool[at - 7 - dof] += change,
                    _ => {}
                }
            }
            let twist: [f64; 6] = std::array::from_fn(|axis| {
                let at = free.iter().position(|&at| at == 1 + dof + axis);
                at.map_or(0.0, |at| step[at])
            });
            parameters.reference = pose_of_twist(&twist) * parameters.reference;
        }
        best
    }

    /// Residual over the best 90 %, rms m, and the next step. Infinite and `None` if joint states cover too
    /// few samples.
    fn step(
        &self,
        parameters: &FittedParameters,
        free: &[usize],
        prior: ToolPrior,
    ) -> (f64, Option<DVector<f64>>) {
        /// Unobservable parameters keep their value.
        const DAMPING_SCALE: f64 = 0.5;
        /// At the fitted latency.
        const MIN_COVERED_SHARE: f64 = 0.75;
        let (n, dof) = (free.len(), parameters.zeros.len());
        let mut chain_state = ChainState::new(self);
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let mut squares: Vec<f64> = Vec::with_capacity(self.t_s.len());
        let mut rows: Vec<Vec3> = Vec::with_capacity(n);
        let turn = parameters.reference.rotation;
        for (&t_s, logged) in self.t_s.iter().zip(&self.xyz) {
            if !chain_state.at(t_s, parameters) {
                continue;
            }
            chain_state.pose =
                self.stream.chain.forward_with_jacobian(&chain_state.q, &mut chain_state.jacobian);
            let at = chain_state.tip(parameters);
            let lever = chain_state.pose.rotation * parameters.tool;
            rows.clear();
            rows.extend(free.iter().map(|&parameter| match parameter {
                0 => -(turn * chain_state.velocity(&lever)),
                p if p <= dof => turn * chain_state.along(p - 1, &lever),
                p if p <= 3 + dof => Vec3::ith(p - 1 - dof, 1.0),
                p if p <= 6 + dof => Vec3::ith(p - 4 - dof, 1.0).cross(&at),
                p => turn * (chain_state.pose.rotation * Vec3::ith(p - 7 - dof, 1.0)),
            }));
            let residual = logged - at;
            squares.push(residual.norm_squared());
            for (i, a) in rows.iter().enumerate() {
                right[i] += a.dot(&residual);
                for (j, b) in rows[..=i].iter().enumerate() {
                    normal[(i, j)] += a.dot(b);
                }
            }
        }
        // Few covered samples fit too easily.
        if squares.len() < MIN_SAMPLES.max((MIN_COVERED_SHARE * self.t_s.len() as f64) as usize) {
            return (f64::INFINITY, None);
        }
        let samples = squares.len() as f64;
        let (weights, pull) = (prior.weights(), prior.pull(&parameters.tool));
        for (at, &parameter) in free.iter().enumerate() {
            normal[(at, at)] += 1e-9 * samples / (DAMPING_SCALE * DAMPING_SCALE);
            if let Some(axis) = parameter.checked_sub(7 + dof) {
                normal[(at, at)] += samples * weights[axis].powi(2);
                right[at] -= samples * weights[axis] * pull[axis];
            }
        }
        let residual_m = trimmed_rms(squares);
        // The factorisation reads the lower triangle.
        (residual_m, normal.cholesky().map(|factor| factor.solve(&right)))
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

/// Rms of the smallest 90 %.
fn trimmed_rms(mut squares: Vec<f64>) -> f64 {
    squares.sort_by(f64::total_cmp);
    let kept = (9 * squares.len()).div_ceil(10);
    (squares[..kept].iter().sum::<f64>() / kept.max(1) as f64).sqrt()
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
        let each = RESIDUAL_FLOOR_M / DEVIATION_PRIOR_M / MAX_EFFECTIVE_SAMPLES.sqrt();
        match self {
            Self::None => Vec3::zeros(),
            Self::AlongAxis => Vec3::new(each, each, 0.0),
            Self::Deviation => Vec3::repeat(each),
        }
    }

    fn pull(self, tool_m: &Vec3) -> Vec3 {
        self.weights().component_mul(tool_m)
    }
}

struct ChainState<'a> {
    stream: &'a StreamWithFk<'a>,
    cursor: usize,
    track: (Vec<f64>, Vec<f64>),
    q: Vec<f64>,
    qd: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
    pose: Pose,
}

impl<'a> ChainState<'a> {
    fn new(stream_with_fk: &'a StreamWithFk<'a>) -> Self {
        let (dof, track) = (stream_with_fk.stream.chain.dof(), stream_with_fk.joints.dof);
        Self {
            stream: stream_with_fk,
            cursor: 0,
            track: (vec![0.0; track], vec![0.0; track]),
            q: vec![0.0; dof],
            qd: vec![0.0; dof],
            jacobian: vec![[0.0; 6]; dof],
            pose: Pose::identity(),
        }
    }

    /// Moves the joints to the time of measurement. False if joint states do not cover it.
    fn at(&mut self, t_s: f64, parameters: &FittedParameters) -> bool {
        let StreamWithFk { joints, stream, in_degrees, .. } = self.stream;
        let (q, qd) = &mut self.track;
        if !joints.at(t_s - parameters.lag_s, &mut self.cursor, q, qd) {
            return false;
        }
        for (at, (&column, kind)) in
            stream.columns.iter().zip(stream.chain.joint_kinds()).enumerate()
        {
            let turns = *in_degrees && *kind != JointKind::Prismatic;
            let unit = if turns { 1_f64.to_radians() } else { 1.0 };
            self.q[at] = unit * q[column] + parameters.zeros[at];
            self.qd[at] = unit * qd[column];
        }
        true
    }

    /// Tip in the stream's reference frame.
    fn tip(&self, parameters: &FittedParameters) -> Vec3 {
        (parameters.reference * (self.pose * Point3::from(parameters.tool))).coords
    }

    /// Derivative in the base; `lever` is from the link origin.
    fn along(&self, joint: usize, lever: &Vec3) -> Vec3 {
        let [x, y, z, a, b, c] = self.jacobian[joint];
        Vec3::new(x, y, z) + Vec3::new(a, b, c).cross(lever)
    }

    fn velocity(&self, lever: &Vec3) -> Vec3 {
        self.qd.iter().enumerate().map(|(joint, rate)| *rate * self.along(joint, lever)).sum()
    }
}
