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
        let harmless =
            self.fits.iter().filter(|way| way.assumption.is_faultless() && !way.is_misinterpreted);
        harmless.map(|way| way.residual_m).fold(f64::INFINITY, f64::min)
    }

    /// Fit with the lowest score.
    pub fn best(&self) -> Option<ScoredFit> {
        let ways = self.fits.iter().map(|way| ScoredFit { fit: *way, score: self.score(way) });
        ways.min_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// Whether no faulty hypothesis can score lower, given its additional parameters.
    pub fn is_conclusive(&self) -> bool {
        let least = self.price(0.0, 1.0);
        self.best().is_some_and(|best| best.score <= least)
    }

    fn score(&self, way: &HypothesisFit) -> f64 {
        let misread = if way.is_misinterpreted { 3.0 } else { 0.0 };
        let parameters = way.assumption.parameters() as f64 + misread;
        self.price(way.residual_m, parameters) + self.tool_price(&way.tool_m)
    }

    /// The cheapest of a link deviation, an offset along the flange axis, and an arbitrary tool.
    fn tool_price(&self, tool_m: &Vec3) -> f64 {
        let each = crate::selection::model_selection::price(self.effective_samples());
        let deviation = |length_m: f64| 0.5 * (length_m / DEVIATION_PRIOR_M).powi(2);
        let prior = (tool_m.norm() / TOOL_PRIOR_M).powi(2);
        let along_axis = each + deviation(tool_m.xy().norm()) + prior;
        deviation(tool_m.norm()).min(along_axis).min(3.0 * each + prior)
    }

    fn price(&self, left_m: f64, parameters: f64) -> f64 {
        let n = self.effective_samples();
        n * (left_m.powi(2) + RESIDUAL_FLOOR_M.powi(2)).ln()
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
    most_lag_s: f64,
    tried: FitHypotheses,
) -> Option<ModelFit> {
    let scale = metres_by_size(joints, stream);
    let lag_s = candidate_lags(joints, stream, most_lag_s);
    let of = |lag_s| StreamWithFk::new(joints, stream, scale, (lag_s, most_lag_s));
    let sights = lag_s.into_iter().filter_map(of);
    let best = sights
        .map(|sight| {
            let fit = sight.fit();
            (fit.faultless_residual_m(), sight, fit)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, sight, mut fit) = best?;
    if tried == FitHypotheses::Faultless {
        return Some(fit);
    }
    fit.fits.extend(sight.faulty_fits());
    if fit.fits.iter().all(|way| way.residual_m > MIN_LARGE_RESIDUAL_M) {
        fit.fits.extend(sight.misinterpreted_fits());
    }
    Some(fit)
}

/// Cheapest fit without a fault, or, if `with_zero`, with one joint zero. An unknown frame is free. `None`
/// if the joint states cover too few samples.
pub(crate) fn tool_fit(
    joints: &JointTrack,
    stream: &PoseStream,
    most_lag_s: f64,
    with_zero: bool,
) -> Option<ScoredFit> {
    let scale = metres_by_size(joints, stream);
    let zeros = (0..stream.chain.dof()).map(|joint| FitAssumption::Zero { joint, tool: true });
    let sights = candidate_lags(joints, stream, most_lag_s).into_iter();
    let sights =
        sights.filter_map(|lag_s| StreamWithFk::new(joints, stream, scale, (lag_s, most_lag_s)));
    let best = sights.filter_map(|sight| {
        let mut fit = sight.fit();
        if with_zero {
            fit.fits = zeros.clone().flat_map(|needs| sight.fits_under(needs)).collect();
        }
        fit.best()
    });
    best.min_by(|a, b| a.score.total_cmp(&b.score))
}

/// Price of a free frame.
pub(crate) fn frame_price(samples: usize) -> f64 {
    let free = FitAssumption::Reference { tool: false }.parameters() as f64;
    free * crate::selection::model_selection::price((samples as f64).min(MAX_EFFECTIVE_SAMPLES))
}

/// From the correlation of stream speed and joint activity, and zero.
fn candidate_lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let peaks = lag_peaks(&joint_activity(joints), &speed, most_lag_s);
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
        (lag_s, most_lag_s): (f64, f64),
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
            max_lag_s: most_lag_s,
            t_s,
            xyz,
            inverse_xyz,
            fk,
            in_degrees: false,
        })
    }

    fn fit(&self) -> ModelFit {
        let half_turns = [false, true].map(|tool| FitAssumption::HalfTurn { tool });
        let needs = [FitAssumption::Nothing, FitAssumption::Tool].into_iter().chain(half_turns);
        let ways = needs.flat_map(|needs| self.fits_under(needs)).collect();
        let as_is = self.solve(self.initial_parameters(), &[0], ToolPrior::None);
        ModelFit {
            samples: self.t_s.len(),
            spread_m: crate::frames::position_fit::spread(&self.xyz),
            as_is_m: as_is.0,
            fits: ways,
        }
    }

    /// Fits to poses and joints as logged.
    fn faulty_fits(&self) -> Vec<HypothesisFit> {
        let dof = self.stream.chain.dof();
        let zeros = (0..dof)
            .flat_map(|joint| [false, true].map(|tool| FitAssumption::Zero { joint, tool }));
        let references = [false, true].map(|tool| FitAssumption::Reference { tool });
        references.into_iter().chain(zeros).flat_map(|needs| self.fits_under(needs)).collect()
    }

    /// Inverted poses, joints in degrees.
    fn misinterpreted_fits(&self) -> Vec<HypothesisFit> {
        let of = |sight: StreamWithFk<'_>| {
            let needs = [
                FitAssumption::Nothing,
                FitAssumption::Tool,
                FitAssumption::Reference { tool: true },
            ];
            let ways = needs.into_iter().flat_map(|needs| sight.fits_under(needs));
            ways.map(|way| HypothesisFit { is_misinterpreted: true, ..way }).collect::<Vec<_>>()
        };
        let as_it_is = || StreamWithFk {
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
        let inverted = self.inverse_xyz.clone().map(|xyz| of(StreamWithFk { xyz, ..as_it_is() }));
        let mut in_radians = StreamWithFk { in_degrees: true, ..as_it_is() };
        in_radians.fk = in_radians.poses();
        inverted.into_iter().flatten().chain(of(in_radians)).collect()
    }

    fn poses(&self) -> Vec<Pose> {
        let guess = self.initial_parameters();
        let mut moment = ChainState::new(self);
        let mut poses = Vec::with_capacity(self.t_s.len());
        for &t_s in &self.t_s {
            if moment.at(t_s, &guess) {
                moment.pose = self.stream.chain.forward(&moment.q);
                poses.push(moment.pose);
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
    fn fits_under(&self, needs: FitAssumption) -> Vec<HypothesisFit> {
        let dof = self.stream.chain.dof();
        let is_free = !self.stream.reference_known;
        let reference = match needs {
            FitAssumption::Reference { .. } | FitAssumption::HalfTurn { .. } if is_free => {
                return Vec::new();
            }
            FitAssumption::Reference { .. } => true,
            _ => is_free,
        };
        let mut free = vec![0];
        if let FitAssumption::Zero { joint, .. } = needs {
            free.push(1 + joint);
        }
        free.extend((0..6).filter(|_| reference).map(|at| 1 + dof + at));
        free.extend((0..3).map(|at| 7 + dof + at));
        let from = |reference: Pose| FittedParameters { reference, ..self.initial_parameters() };
        let half_turn = Pose::rotation(Vec3::z() * std::f64::consts::PI);
        let starts = match (needs, reference) {
            (FitAssumption::HalfTurn { .. }, _) => vec![from(half_turn)],
            (_, false) => vec![self.initial_parameters()],
            // Collinear positions leave the rotation about the line free, so start from each usual frame.
            (_, true) => {
                let (turned, _) = FkColumns::from_poses(&self.fk).fit_rigid_or_collinear(&self.xyz);
                vec![self.initial_parameters(), from(half_turn), from(turned)]
            }
        };
        let priors: &[ToolPrior] = match needs.has_tool() {
            false => &[ToolPrior::Deviation],
            true => &[ToolPrior::None, ToolPrior::AlongAxis],
        };
        let ways = priors.iter().filter_map(|&prior| {
            let found = starts.iter().map(|start| self.solve(start.clone(), &free, prior));
            let (left_m, guess) = found.min_by(|a, b| a.0.total_cmp(&b.0))?;
            left_m.is_finite().then_some(HypothesisFit {
                assumption: needs,
                is_misinterpreted: false,
                residual_m: left_m,
                tool_m: guess.tool,
                lag_s: guess.lag_s,
            })
        });
        ways.collect()
    }

    /// Gauss–Newton on `free`, indexed as latency, joint zeros, reference, tool.
    fn solve(
        &self,
        mut guess: FittedParameters,
        free: &[usize],
        prior: ToolPrior,
    ) -> (f64, FittedParameters) {
        const MAX_ROUNDS: usize = 10;
        const CONVERGED_COST_CHANGE: f64 = 1e-5;
        let mut least = f64::INFINITY;
        let mut best = (f64::INFINITY, guess.clone());
        for round in 0..=MAX_ROUNDS {
            let (left_m, step) = self.step(&guess, free, prior);
            let cost = left_m.hypot(prior.pull(&guess.tool).norm());
            let gain = least - cost;
            if gain > 0.0 {
                (least, best) = (cost, (left_m, guess.clone()));
            }
            let Some(step) =
                step.filter(|_| round < MAX_ROUNDS && gain.abs() > CONVERGED_COST_CHANGE * cost)
            else {
                break;
            };
            let dof = guess.zeros.len();
            for (&at, &change) in free.iter().zip(step.iter()) {
                match at {
                    0 => {
                        let most_s = self.max_lag_s;
                        guess.lag_s = (guess.lag_s + change).clamp(-most_s, most_s);
                    }
                    at if at <= dof => guess.zeros[at - 1] += change,
                    at if at > 6 + dof => guess.tool[at - 7 - dof] += change,
                    _ => {}
                }
            }
            let twist: [f64; 6] = std::array::from_fn(|axis| {
                let at = free.iter().position(|&at| at == 1 + dof + axis);
                at.map_or(0.0, |at| step[at])
            });
            guess.reference = pose_of_twist(&twist) * guess.reference;
        }
        best
    }

    /// Residual over the best 90 %, rms m, and the next step. Infinite and `None` if joint states cover too
    /// few samples.
    fn step(
        &self,
        guess: &FittedParameters,
        free: &[usize],
        prior: ToolPrior,
    ) -> (f64, Option<DVector<f64>>) {
        /// Unobservable parameters keep their value.
        const DAMPING_SCALE: f64 = 0.5;
        /// At the fitted latency.
        const MIN_COVERED_SHARE: f64 = 0.75;
        let (n, dof) = (free.len(), guess.zeros.len());
        let mut moment = ChainState::new(self);
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let mut squares: Vec<f64> = Vec::with_capacity(self.t_s.len());
        let mut rows: Vec<Vec3> = Vec::with_capacity(n);
        let turn = guess.reference.rotation;
        for (&t_s, logged) in self.t_s.iter().zip(&self.xyz) {
            if !moment.at(t_s, guess) {
                continue;
            }
            moment.pose = self.stream.chain.forward_with_jacobian(&moment.q, &mut moment.jacobian);
            let at = moment.tip(guess);
            let lever = moment.pose.rotation * guess.tool;
            rows.clear();
            rows.extend(free.iter().map(|&parameter| match parameter {
                0 => -(turn * moment.velocity(&lever)),
                p if p <= dof => turn * moment.along(p - 1, &lever),
                p if p <= 3 + dof => Vec3::ith(p - 1 - dof, 1.0),
                p if p <= 6 + dof => Vec3::ith(p - 4 - dof, 1.0).cross(&at),
                p => turn * (moment.pose.rotation * Vec3::ith(p - 7 - dof, 1.0)),
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
        let (weights, pull) = (prior.weights(), prior.pull(&guess.tool));
        for (at, &parameter) in free.iter().enumerate() {
            normal[(at, at)] += 1e-9 * samples / (DAMPING_SCALE * DAMPING_SCALE);
            if let Some(axis) = parameter.checked_sub(7 + dof) {
                normal[(at, at)] += samples * weights[axis].powi(2);
                right[at] -= samples * weights[axis] * pull[axis];
            }
        }
        let left_m = rms_of_most(squares);
        // The factorisation reads the lower triangle.
        (left_m, normal.cholesky().map(|factor| factor.solve(&right)))
    }
}

/// Rms distance from the median over the best 90 %, comparable with residuals.
pub(crate) fn extent(xyz: &[Vec3]) -> f64 {
    let middle: [f64; 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = xyz.iter().map(|xyz| xyz[axis]).collect();
        ground::stats::median(&mut values).unwrap_or(0.0)
    });
    let middle = Vec3::from(middle);
    rms_of_most(xyz.iter().map(|xyz| (xyz - middle).norm_squared()).collect())
}

/// Rms of the smallest 90 %.
fn rms_of_most(mut squares: Vec<f64>) -> f64 {
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
    fn new(sight: &'a StreamWithFk<'a>) -> Self {
        let (dof, track) = (sight.stream.chain.dof(), sight.joints.dof);
        Self {
            stream: sight,
            cursor: 0,
            track: (vec![0.0; track], vec![0.0; track]),
            q: vec![0.0; dof],
            qd: vec![0.0; dof],
            jacobian: vec![[0.0; 6]; dof],
            pose: Pose::identity(),
        }
    }

    /// Moves the joints to the time of measurement. False if joint states do not cover it.
    fn at(&mut self, t_s: f64, guess: &FittedParameters) -> bool {
        let StreamWithFk { joints, stream, in_degrees, .. } = self.stream;
        let (q, qd) = &mut self.track;
        if !joints.at(t_s - guess.lag_s, &mut self.cursor, q, qd) {
            return false;
        }
        for (at, (&column, kind)) in
            stream.columns.iter().zip(stream.chain.joint_kinds()).enumerate()
        {
            let turns = *in_degrees && *kind != JointKind::Prismatic;
            let unit = if turns { 1_f64.to_radians() } else { 1.0 };
            self.q[at] = unit * q[column] + guess.zeros[at];
            self.qd[at] = unit * qd[column];
        }
        true
    }

    /// Tip in the stream's reference frame.
    fn tip(&self, guess: &FittedParameters) -> Vec3 {
        (guess.reference * (self.pose * Point3::from(guess.tool))).coords
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
