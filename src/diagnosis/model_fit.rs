//! What a model of the arm needs to explain the positions of a stream: nothing, an active TCP, a joint
//! zero, a moved frame. Of several arms with the same joint names the log is of the one that needs least.
//!
//! Positions alone are held against FK, so that no convention of rotations is in the way. Each way is a
//! Gauss–Newton fit of `p(s) = reference · FK(q(s − τ) + δ) · tool` with the latency free, on a few dozen
//! slow samples; what it leaves is compared between arms, not judged.

use super::PoseStream;
use super::latency::{joint_activity, linear_speed, peaks};
use super::model::pose_of_twist;
use super::placement::metres_by_size;
use super::placing::Expected;
use super::sampling::slow_samples;
use ground::geometry::{Pose, Vec3};
use ground::robot::JointKind;
use ground::stream::{JointTrack, Orientations};
use nalgebra::{DMatrix, DVector, Point3};

/// Fewer samples tell nothing.
const ENOUGH: usize = 12;
/// Where this is left, m, the pose may be inverted or the joints in degrees.
const ASTRAY_M: f64 = 5e-3;

/// Standard deviation of a tool's length before it is seen, m: grippers are 0.1 to 0.3 m long, and a TCP beyond
/// 0.5 m is rare.
const USUAL_TOOL_M: f64 = 0.2;
/// By how much the flange of a calibrated arm deviates from that of its nominal model, m, as a standard deviation.
/// Healthy UR5e of two public data sets deviate by 0.1 to 1.6 mm (docs/real-logs.md).
const DEVIATION_M: f64 = 1e-3;
/// Residuals below this do not count for or against a model, m. The nominal models of these arms leave 0.1 to 1.3 mm,
/// and a wrong arm with a free tool fits short motion to micrometres.
const FLOOR_M: f64 = 1e-3;
/// Samples of one motion depend on each other: no more of them count. With 20, a zero or a tool that is not there is
/// preferred to the deviations of real links (0.3 mm and 0.05° each, rich motion) in none of 60 generated runs.
const COUNTED: f64 = 20.0;

/// What must be assumed for a model to fit, the most harmless first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Needs {
    /// Nothing.
    Nothing,
    /// A tool of constant offset: an active TCP.
    Tool,
    /// The base turned by half a turn about its z axis (`base` for `base_link`), with or without a tool.
    HalfTurn {
        /// Whether with a tool.
        tool: bool,
    },
    /// The zero of a joint, by its place in the chain, with or without a tool.
    Zero {
        /// The joint.
        joint: usize,
        /// Whether with a tool.
        tool: bool,
    },
    /// Another reference frame, with or without a tool.
    Reference {
        /// Whether with a tool.
        tool: bool,
    },
}

impl Needs {
    /// Whether that is no fault of the arm: nothing, an active TCP, or the other usual base frame.
    pub fn is_harmless(self) -> bool {
        matches!(self, Needs::Nothing | Needs::Tool | Needs::HalfTurn { .. })
    }

    /// Whether a tool is fitted.
    pub fn has_tool(self) -> bool {
        match self {
            Needs::Nothing => false,
            Needs::Tool => true,
            Needs::HalfTurn { tool } | Needs::Zero { tool, .. } | Needs::Reference { tool } => tool,
        }
    }

    /// How many numbers are fitted besides the latency and the tool.
    fn parameters(self) -> usize {
        match self {
            Needs::Nothing | Needs::Tool => 0,
            Needs::HalfTurn { .. } | Needs::Zero { .. } => 1,
            Needs::Reference { .. } => 6,
        }
    }
}

/// One way in which a model fits a stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// What it needs.
    pub needs: Needs,
    /// Whether besides the poses are inverted or the joints in degrees.
    pub misread: bool,
    /// What it leaves of the positions, rms m over the best nine tenths of the samples.
    pub left_m: f64,
    /// The tool's offset in the link's frame, m.
    pub tool_m: Vec3,
    /// The latency of the stream, s.
    pub lag_s: f64,
}

/// How a model fits a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelFit {
    /// Samples that it was tried on.
    pub samples: usize,
    /// Rms distance of the positions from their mean, m.
    pub spread_m: f64,
    /// What is left with nothing assumed but a latency, m.
    pub as_is_m: f64,
    /// Every way that was tried.
    pub ways: Vec<Way>,
}

/// One way of a model with its price paid: less is better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priced {
    /// The way.
    pub way: Way,
    /// `n ln σ²` of what it leaves, and the price of what it needs.
    pub score: f64,
}

impl ModelFit {
    /// The least that is left without a fault, m.
    pub fn harmless_m(&self) -> f64 {
        let harmless = self.ways.iter().filter(|way| way.needs.is_harmless() && !way.misread);
        harmless.map(|way| way.left_m).fold(f64::INFINITY, f64::min)
    }

    /// The cheapest way.
    pub fn best(&self) -> Option<Priced> {
        let ways = self.ways.iter().map(|way| Priced { way: *way, score: self.score(way) });
        ways.min_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// Whether no way with a fault can be cheaper than those tried, as it would leave something and need a
    /// number at least.
    pub fn is_settled(&self) -> bool {
        let least = self.price(0.0, 1.0);
        self.best().is_some_and(|best| best.score <= least)
    }

    fn score(&self, way: &Way) -> f64 {
        let misread = if way.misread { 3.0 } else { 0.0 };
        let parameters = way.needs.parameters() as f64 + misread;
        self.price(way.left_m, parameters) + self.tool_price(&way.tool_m)
    }

    /// The price of a tool: of a deviation of the links, of a length along the flange's axis, or of any tool.
    fn tool_price(&self, tool_m: &Vec3) -> f64 {
        let each = super::explain::price(self.counted());
        let deviation = |length_m: f64| 0.5 * (length_m / DEVIATION_M).powi(2);
        let prior = (tool_m.norm() / USUAL_TOOL_M).powi(2);
        let along_axis = each + deviation(tool_m.xy().norm()) + prior;
        deviation(tool_m.norm()).min(along_axis).min(3.0 * each + prior)
    }

    /// The price of so many parameters that leave so much.
    fn price(&self, left_m: f64, parameters: f64) -> f64 {
        let n = self.counted();
        n * (left_m.powi(2) + FLOOR_M.powi(2)).ln() + super::explain::price(n) * parameters
    }

    fn counted(&self) -> f64 {
        (self.samples as f64).min(COUNTED)
    }
}

/// Which ways a model is tried in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tried {
    /// Those without a fault.
    Harmless,
    /// All there are.
    All,
}

/// How the model behind `stream`'s chain fits its positions; `None` where the joints cover too few
/// samples.
pub fn model_fit(
    joints: &JointTrack,
    stream: &PoseStream,
    most_lag_s: f64,
    tried: Tried,
) -> Option<ModelFit> {
    let scale = metres_by_size(joints, stream);
    let lag_s = lags(joints, stream, most_lag_s);
    let of = |lag_s| Sight::of(joints, stream, scale, (lag_s, most_lag_s));
    let sights = lag_s.into_iter().filter_map(of);
    let best = sights
        .map(|sight| {
            let fit = sight.fit();
            (fit.harmless_m(), sight, fit)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, sight, mut fit) = best?;
    if tried == Tried::Harmless {
        return Some(fit);
    }
    fit.ways.extend(sight.faulty_ways());
    if fit.ways.iter().all(|way| way.left_m > ASTRAY_M) {
        fit.ways.extend(sight.misread_ways());
    }
    Some(fit)
}

/// The cheapest way without a fault in which the model fits, its frame free if that is not known, or the cheapest
/// with the zero of one joint; `None` if the joints cover too few samples.
pub(super) fn tool_fit(
    joints: &JointTrack,
    stream: &PoseStream,
    most_lag_s: f64,
    with_zero: bool,
) -> Option<Priced> {
    let scale = metres_by_size(joints, stream);
    let zeros = (0..stream.chain.dof()).map(|joint| Needs::Zero { joint, tool: true });
    let sights = lags(joints, stream, most_lag_s).into_iter();
    let sights = sights.filter_map(|lag_s| Sight::of(joints, stream, scale, (lag_s, most_lag_s)));
    let best = sights.filter_map(|sight| {
        let mut fit = sight.fit();
        if with_zero {
            fit.ways = zeros.clone().flat_map(|needs| sight.ways(needs)).collect();
        }
        fit.best()
    });
    best.min_by(|a, b| a.score.total_cmp(&b.score))
}

/// The price of a free frame for a stream of so many samples.
pub(super) fn frame_price(samples: usize) -> f64 {
    let free = Needs::Reference { tool: false }.parameters() as f64;
    free * super::explain::price((samples as f64).min(COUNTED))
}

/// Latencies at which the stream moves as the joints do, and none.
fn lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let speed = linear_speed(&track.t_s, &track.xyz);
    let peaks = peaks(&joint_activity(joints), &speed, most_lag_s);
    let near = peaks.iter().filter(|peak| peak.correlation > 0.4).take(2).map(|peak| peak.lag_s);
    std::iter::once(0.0).chain(near.filter(|lag_s| lag_s.abs() > 0.02)).collect()
}

/// Some samples of a stream beside what moves it.
struct Sight<'a> {
    joints: &'a JointTrack,
    stream: PoseStream<'a>,
    lag_s: f64,
    /// The longest latency that is fitted, s.
    most_lag_s: f64,
    t_s: Vec<f64>,
    xyz: Vec<Vec3>,
    /// Positions of the inverse poses, where the stream has rotations.
    inverse_xyz: Option<Vec<Vec3>>,
    fk: Vec<Pose>,
    /// Whether positions of the joints are degrees.
    in_degrees: bool,
}

/// What is fitted.
#[derive(Clone)]
struct Guess {
    lag_s: f64,
    zeros: Vec<f64>,
    reference: Pose,
    tool: Vec3,
}

impl<'a> Sight<'a> {
    fn of(
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
        (rows.len() >= ENOUGH).then_some(Self {
            joints,
            stream: *stream,
            lag_s,
            most_lag_s,
            t_s,
            xyz,
            inverse_xyz,
            fk,
            in_degrees: false,
        })
    }

    /// The ways without a fault.
    fn fit(&self) -> ModelFit {
        let half_turns = [false, true].map(|tool| Needs::HalfTurn { tool });
        let needs = [Needs::Nothing, Needs::Tool].into_iter().chain(half_turns);
        let ways = needs.flat_map(|needs| self.ways(needs)).collect();
        let as_is = self.solve(self.plain(), &[0], ToolPrior::None);
        ModelFit {
            samples: self.t_s.len(),
            spread_m: super::placing::spread(&self.xyz),
            as_is_m: as_is.0,
            ways,
        }
    }

    /// The ways with one, with poses and joints read as they are.
    fn faulty_ways(&self) -> Vec<Way> {
        let dof = self.stream.chain.dof();
        let zeros =
            (0..dof).flat_map(|joint| [false, true].map(|tool| Needs::Zero { joint, tool }));
        let references = [false, true].map(|tool| Needs::Reference { tool });
        references.into_iter().chain(zeros).flat_map(|needs| self.ways(needs)).collect()
    }

    /// The ways of poses that are inverted, and of joints that are in degrees.
    fn misread_ways(&self) -> Vec<Way> {
        let of = |sight: Sight<'_>| {
            let needs = [Needs::Nothing, Needs::Tool, Needs::Reference { tool: true }];
            let ways = needs.into_iter().flat_map(|needs| sight.ways(needs));
            ways.map(|way| Way { misread: true, ..way }).collect::<Vec<_>>()
        };
        let as_it_is = || Sight {
            joints: self.joints,
            stream: self.stream,
            lag_s: self.lag_s,
            most_lag_s: self.most_lag_s,
            t_s: self.t_s.clone(),
            xyz: self.xyz.clone(),
            inverse_xyz: None,
            fk: self.fk.clone(),
            in_degrees: self.in_degrees,
        };
        let inverted = self.inverse_xyz.clone().map(|xyz| of(Sight { xyz, ..as_it_is() }));
        let mut in_radians = Sight { in_degrees: true, ..as_it_is() };
        in_radians.fk = in_radians.poses();
        inverted.into_iter().flatten().chain(of(in_radians)).collect()
    }

    /// FK at the samples.
    fn poses(&self) -> Vec<Pose> {
        let guess = self.plain();
        let mut moment = Moment::new(self);
        let mut poses = Vec::with_capacity(self.t_s.len());
        for &t_s in &self.t_s {
            if moment.at(t_s, &guess) {
                moment.pose = self.stream.chain.forward(&moment.q);
                poses.push(moment.pose);
            }
        }
        poses
    }

    fn plain(&self) -> Guess {
        Guess {
            lag_s: self.lag_s,
            zeros: vec![0.0; self.stream.chain.dof()],
            reference: Pose::identity(),
            tool: Vec3::zeros(),
        }
    }

    /// The fits with the parameters of `needs` free, and the reference frame if it is not known: with a tool of
    /// any kind and with one along the flange's axis, or with the deviation of the links alone.
    fn ways(&self, needs: Needs) -> Vec<Way> {
        let dof = self.stream.chain.dof();
        let is_free = !self.stream.reference_known;
        let reference = match needs {
            Needs::Reference { .. } | Needs::HalfTurn { .. } if is_free => return Vec::new(),
            Needs::Reference { .. } => true,
            _ => is_free,
        };
        let mut free = vec![0];
        if let Needs::Zero { joint, .. } = needs {
            free.push(1 + joint);
        }
        free.extend((0..6).filter(|_| reference).map(|at| 1 + dof + at));
        free.extend((0..3).map(|at| 7 + dof + at));
        let from = |reference: Pose| Guess { reference, ..self.plain() };
        let half_turn = Pose::rotation(Vec3::z() * std::f64::consts::PI);
        let starts = match (needs, reference) {
            (Needs::HalfTurn { .. }, _) => vec![from(half_turn)],
            (_, false) => vec![self.plain()],
            // Positions along a line leave the turn about it open: each usual frame is a start.
            (_, true) => {
                let (turned, _) = Expected::of(&self.fk).turned_anyhow(&self.xyz);
                vec![self.plain(), from(half_turn), from(turned)]
            }
        };
        let priors: &[ToolPrior] = match needs.has_tool() {
            false => &[ToolPrior::Deviation],
            true => &[ToolPrior::None, ToolPrior::AlongAxis],
        };
        let ways = priors.iter().filter_map(|&prior| {
            let found = starts.iter().map(|start| self.solve(start.clone(), &free, prior));
            let (left_m, guess) = found.min_by(|a, b| a.0.total_cmp(&b.0))?;
            left_m.is_finite().then_some(Way {
                needs,
                misread: false,
                left_m,
                tool_m: guess.tool,
                lag_s: guess.lag_s,
            })
        });
        ways.collect()
    }

    /// Gauss–Newton on the numbers `free`: latency, joint zeros, reference frame, tool, in this order.
    fn solve(&self, mut guess: Guess, free: &[usize], prior: ToolPrior) -> (f64, Guess) {
        const ROUNDS: usize = 10;
        /// The cost has settled if it changes by less than this share.
        const SETTLED: f64 = 1e-5;
        let mut least = f64::INFINITY;
        let mut best = (f64::INFINITY, guess.clone());
        for round in 0..=ROUNDS {
            let (left_m, step) = self.step(&guess, free, prior);
            let cost = left_m.hypot(prior.pull(&guess.tool).norm());
            let gain = least - cost;
            if gain > 0.0 {
                (least, best) = (cost, (left_m, guess.clone()));
            }
            let Some(step) = step.filter(|_| round < ROUNDS && gain.abs() > SETTLED * cost) else {
                break;
            };
            let dof = guess.zeros.len();
            for (&at, &change) in free.iter().zip(step.iter()) {
                match at {
                    0 => {
                        let most_s = self.most_lag_s;
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

    /// What a guess leaves, rms m over the best nine tenths, and the step from it; infinite and none where the
    /// joints cover too little.
    fn step(&self, guess: &Guess, free: &[usize], prior: ToolPrior) -> (f64, Option<DVector<f64>>) {
        /// Steps are damped at this scale, so that what the log does not show stays in place.
        const SCALE: f64 = 0.5;
        /// Share of the samples that the joints must cover at the fitted latency.
        const COVERED: f64 = 0.75;
        let (n, dof) = (free.len(), guess.zeros.len());
        let mut moment = Moment::new(self);
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
        // A latency that leaves few samples covered explains little, however well.
        if squares.len() < ENOUGH.max((COVERED * self.t_s.len() as f64) as usize) {
            return (f64::INFINITY, None);
        }
        let samples = squares.len() as f64;
        let (weights, pull) = (prior.weights(), prior.pull(&guess.tool));
        for (at, &parameter) in free.iter().enumerate() {
            normal[(at, at)] += 1e-9 * samples / (SCALE * SCALE);
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

/// Rms distance of positions from their median over the best nine tenths, as residuals are.
pub(super) fn extent(xyz: &[Vec3]) -> f64 {
    let middle: [f64; 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = xyz.iter().map(|xyz| xyz[axis]).collect();
        ground::stats::median(&mut values).unwrap_or(0.0)
    });
    let middle = Vec3::from(middle);
    rms_of_most(xyz.iter().map(|xyz| (xyz - middle).norm_squared()).collect())
}

/// Root of the mean of the least nine tenths of some squares.
fn rms_of_most(mut squares: Vec<f64>) -> f64 {
    squares.sort_by(f64::total_cmp);
    let kept = (9 * squares.len()).div_ceil(10);
    (squares[..kept].iter().sum::<f64>() / kept.max(1) as f64).sqrt()
}

/// What is assumed of a tool before it is fitted.
#[derive(Clone, Copy)]
enum ToolPrior {
    /// Nothing.
    None,
    /// It lies along the flange's axis, but for the deviation of the links.
    AlongAxis,
    /// There is none, but for the deviation of the links.
    Deviation,
}

impl ToolPrior {
    /// Weights of the tool's coordinates against the rms residual.
    fn weights(self) -> Vec3 {
        let each = FLOOR_M / DEVIATION_M / COUNTED.sqrt();
        match self {
            Self::None => Vec3::zeros(),
            Self::AlongAxis => Vec3::new(each, each, 0.0),
            Self::Deviation => Vec3::repeat(each),
        }
    }

    /// The weighted coordinates of a tool.
    fn pull(self, tool_m: &Vec3) -> Vec3 {
        self.weights().component_mul(tool_m)
    }
}

/// The chain at one moment.
struct Moment<'a> {
    sight: &'a Sight<'a>,
    cursor: usize,
    track: (Vec<f64>, Vec<f64>),
    q: Vec<f64>,
    qd: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
    pose: Pose,
}

impl<'a> Moment<'a> {
    fn new(sight: &'a Sight<'a>) -> Self {
        let (dof, track) = (sight.stream.chain.dof(), sight.joints.dof);
        Self {
            sight,
            cursor: 0,
            track: (vec![0.0; track], vec![0.0; track]),
            q: vec![0.0; dof],
            qd: vec![0.0; dof],
            jacobian: vec![[0.0; 6]; dof],
            pose: Pose::identity(),
        }
    }

    /// Takes the joints to what a sample stamped `t_s` speaks of; false where they do not cover it.
    fn at(&mut self, t_s: f64, guess: &Guess) -> bool {
        let Sight { joints, stream, in_degrees, .. } = self.sight;
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

    /// Where the model puts the stream's point, in its reference frame.
    fn tip(&self, guess: &Guess) -> Vec3 {
        (guess.reference * (self.pose * Point3::from(guess.tool))).coords
    }

    /// How that point moves with a joint, in the base, `lever` from the link's origin.
    fn along(&self, joint: usize, lever: &Vec3) -> Vec3 {
        let [x, y, z, a, b, c] = self.jacobian[joint];
        Vec3::new(x, y, z) + Vec3::new(a, b, c).cross(lever)
    }

    fn velocity(&self, lever: &Vec3) -> Vec3 {
        self.qd.iter().enumerate().map(|(joint, rate)| *rate * self.along(joint, lever)).sum()
    }
}
