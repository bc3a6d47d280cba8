//! Which joints give, and by how much: linear least squares on what one explanation of the run leaves,
//! with everything that explanation may hold free beside them.

use super::found::{BendShape, JointBend, Sag, play};
use super::gravity::{Gravity, Masses, Postures};
use super::{Run, Samples};
use crate::explain::price;
use crate::linear::{Linear, Normal, Weight};
use crate::model::{FLOOR_M, FLOOR_RAD};
use crate::robust::sandwich;
use crate::{ArmDiagnosis, FrameEstimate, Seen};
use ground::geometry::Vec3;
use ground::stats::Measured;
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;

/// Play that is assumed while it is sought, rad; the shape hardly hangs on it.
const FIRST_PLAY_RAD: f64 = 3e-3;
/// A joint gives where that explains so much of what is left beyond the noise.
const SHARE: f64 = 0.03;
/// Orders of eccentricity that are tried: of the joint itself, of its encoder, of a bearing.
const ORDERS: [u32; 3] = [1, 2, 3];
/// Torque below this share of the largest makes no sag that could be told.
const LEAST_TORQUE: f64 = 0.05;
/// An amount is told from none by so many standard errors.
const TOLD: f64 = 4.0;
/// More than this is no bend, rad.
const MOST_RAD: f64 = 0.1;
/// Joints whose number ranges over less show no eccentricity, rad.
const LEAST_RANGE_RAD: f64 = 1.0;

/// How a joint may give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Play,
    Sag,
    Eccentric(u32),
}

/// A joint that may give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Term {
    pub column: usize,
    pub kind: Kind,
    /// The coefficients found so far: of eccentricity that of the sine and that of the cosine.
    pub amount: [f64; 2],
    pub std_error: f64,
    pub dof: f64,
}

impl Term {
    fn new(column: usize, kind: Kind) -> Self {
        Self { column, kind, amount: [0.0; 2], std_error: 0.0, dof: 3.0 }
    }

    /// Number of coefficients.
    fn width(&self) -> usize {
        if matches!(self.kind, Kind::Eccentric(_)) { 2 } else { 1 }
    }

    /// The size, rad, with its sign where it has one.
    pub fn size(&self) -> f64 {
        match self.kind {
            Kind::Play | Kind::Sag => self.amount[0],
            Kind::Eccentric(_) => self.amount[0].hypot(self.amount[1]),
        }
    }

    /// Whether it is one, and told from none.
    fn holds(&self) -> bool {
        let size = self.size();
        let is_way = size > 0.0 || self.kind == Kind::Play;
        is_way && size.abs() > TOLD * self.std_error && size.abs() < MOST_RAD
    }
}

/// What is free beside the bends.
pub(super) struct Free {
    zeros: Vec<bool>,
    /// Of each stream: latency, growth, reference, tool.
    streams: Vec<[bool; 4]>,
}

/// Parameters of a stream beside its joints': latency, growth, reference and tool.
const STREAM: usize = 14;
const PARTS: [std::ops::Range<usize>; 4] = [0..1, 1..2, 2..8, 8..14];

impl Free {
    /// All zeros, latencies and frames.
    pub fn all(run: &Run) -> Self {
        Self {
            zeros: vec![true; run.joints.dof],
            streams: vec![[true, false, true, true]; run.streams.len()],
        }
    }

    /// What an explanation holds.
    pub fn chosen(run: &Run, found: &ArmDiagnosis) -> Self {
        let streams = run.streams.iter().zip(&found.streams).map(|(stream, found)| {
            let frame =
                |frame: &Seen<FrameEstimate>| frame.as_ref().is_ok_and(|frame| frame.chosen);
            let is_free = !stream.reference_known || frame(&found.reference);
            [found.latency_s.is_ok(), found.growth_chosen, is_free, frame(&found.tool)]
        });
        let mut zeros: Vec<bool> =
            found.joints.offsets.iter().map(|offset| offset.chosen).collect();
        zeros.resize(run.joints.dof, false);
        Self { zeros, streams: streams.collect() }
    }
}

/// The search for what gives on one linearisation.
pub(super) struct Search<'a> {
    run: &'a Run<'a>,
    samples: &'a [Samples],
    gravity: Arc<Gravity>,
    /// The largest torque about each joint over the run.
    most_torque: Vec<f64>,
    /// Torques of each sample of each stream, one a joint.
    torques: Vec<Vec<Vec<f64>>>,
}

/// Least squares with some terms beside everything else.
struct System {
    linears: Vec<Linear>,
    weights: Vec<Vec<Weight>>,
    normal: Normal,
    /// Columns of each stream's own parameters in the whole.
    columns: Vec<Vec<usize>>,
    /// Where the terms begin, and each of them.
    starts: Vec<usize>,
}

impl<'a> Search<'a> {
    pub fn new(run: &'a Run, samples: &'a [Samples], masses: Masses) -> Option<Self> {
        let stream = run.streams.iter().max_by_key(|stream| stream.columns.len())?;
        let gravity = Arc::new(Gravity::of(stream.chain, stream.columns, masses));
        let torques = torques(&gravity, samples, run.joints.dof);
        let mut most_torque = vec![0.0_f64; run.joints.dof];
        for own in torques.iter().flatten() {
            most_torque.iter_mut().zip(own).for_each(|(most, own)| *most = most.max(own.abs()));
        }
        Some(Self { run, samples, gravity, most_torque, torques })
    }

    /// The same on other samples of the run.
    pub fn on<'b>(&self, samples: &'b [Samples]) -> Search<'b>
    where
        'a: 'b,
    {
        let gravity = Arc::clone(&self.gravity);
        let torques = torques(&gravity, samples, self.run.joints.dof);
        let most_torque = self.most_torque.clone();
        Search { run: self.run, samples, gravity, most_torque, torques }
    }

    /// Everything that may give.
    fn candidates(&self) -> Vec<Term> {
        let dof = self.run.joints.dof;
        let largest = self.most_torque.iter().copied().fold(0.0, f64::max);
        let of_joint = |column: usize| {
            let values =
                || self.samples.iter().flat_map(move |s| s.q.iter().map(move |q| q[column]));
            let low = values().fold(f64::INFINITY, f64::min);
            let high = values().fold(f64::NEG_INFINITY, f64::max);
            let sags = self.most_torque[column] > LEAST_TORQUE * largest;
            let turns = high - low > LEAST_RANGE_RAD;
            let moves = high - low > 0.05;
            let orders = ORDERS.iter().map(|&order| Kind::Eccentric(order));
            let kinds = std::iter::once(Kind::Play)
                .chain(sags.then_some(Kind::Sag))
                .chain(orders.filter(move |_| turns));
            kinds
                .filter(move |_| moves)
                .map(move |kind| Term::new(column, kind))
                .collect::<Vec<_>>()
        };
        let used = |column: &usize| {
            !self.run.slides[*column]
                && self.run.streams.iter().any(|stream| stream.columns.contains(column))
        };
        (0..dof).filter(used).flat_map(of_joint).collect()
    }

    /// The shapes of `terms` at each sample of each stream, a number a coefficient.
    fn shapes(&self, terms: &[Term]) -> Vec<Vec<Vec<f64>>> {
        let joints = self.run.joints;
        let behind: Vec<Vec<f64>> = terms
            .iter()
            .map(|term| match term.kind {
                Kind::Play => {
                    let width = match term.amount[0].abs() {
                        0.0 => FIRST_PLAY_RAD,
                        width => width,
                    };
                    play(joints.len(), |row| joints.q[row * joints.dof + term.column], width)
                }
                Kind::Sag | Kind::Eccentric(_) => Vec::new(),
            })
            .collect();
        let of_stream = |(samples, torques): (&Samples, &Vec<Vec<f64>>)| {
            let of_sample = |k: usize| {
                let mut values = Vec::new();
                for (term, behind) in terms.iter().zip(&behind) {
                    let q = samples.q[k][term.column];
                    match term.kind {
                        Kind::Play => {
                            let (row, part) = samples.at[k];
                            let next = (row + 1).min(behind.len() - 1);
                            values.push(behind[row] * (1.0 - part) + behind[next] * part);
                        }
                        Kind::Sag => {
                            let most = self.most_torque[term.column];
                            values.push(torques[k][term.column] / most);
                        }
                        Kind::Eccentric(order) => {
                            let (sin, cos) = (f64::from(order) * q).sin_cos();
                            values.extend([sin, cos]);
                        }
                    }
                }
                values
            };
            (0..samples.q.len()).map(of_sample).collect()
        };
        self.samples.iter().zip(&self.torques).map(of_stream).collect()
    }

    fn system(&self, terms: &[Term], free: &Free) -> System {
        let dof = self.run.joints.dof;
        let starts: Vec<usize> = terms
            .iter()
            .scan(dof, |next, term| {
                let start = *next;
                *next += term.width();
                Some(start)
            })
            .collect();
        let own = dof + terms.iter().map(Term::width).sum::<usize>();
        let shapes = self.shapes(terms);
        let linears: Vec<Linear> = self
            .samples
            .iter()
            .zip(&shapes)
            .map(|(samples, shapes)| linear(samples, shapes, terms, &starts, own))
            .collect();
        let columns: Vec<Vec<usize>> = (0..linears.len())
            .map(|s| (0..own).chain((0..STREAM).map(|p| own + s * STREAM + p)).collect())
            .collect();
        let weights = linears.iter().map(Linear::first_weights).collect();
        let normal = Normal::zeros(0);
        let mut system = System { linears, weights, normal, columns, starts };
        system.sum();
        let every: Vec<usize> = (0..terms.len()).collect();
        for _ in 0..2 {
            let step = system.step(&system.parameters(terms, &every, free));
            system.weigh(&step);
        }
        system
    }

    /// The joints that give, as few as explain most, with everything else free: such as have play or sag
    /// alone, and where they are others such as may be eccentric too.
    pub fn terms(&self) -> Vec<Vec<Term>> {
        let (terms, free) = (self.candidates(), Free::all(self.run));
        let system = self.system(&terms, &free);
        let cost = |set: &[usize]| system.cost(&system.parameters(&terms, set, &free));
        let every: Vec<usize> = (0..terms.len()).collect();
        let (plain, least) = (cost(&[]), cost(&every));
        let price = price(system.normal.independent);
        let worth =
            |index: usize| (price * terms[index].width() as f64).max(SHARE * (plain - least));
        let is_eccentric = |index: &usize| matches!(terms[*index].kind, Kind::Eccentric(_));
        let simple: Vec<usize> = every.iter().copied().filter(|i| !is_eccentric(i)).collect();
        let simple = fewest(&simple, plain, &cost, &worth);
        let mixed = fewest(&every, plain, &cost, &worth);
        let is_mixed = mixed.iter().any(is_eccentric);
        let sets = [Some(simple), is_mixed.then_some(mixed)].into_iter().flatten();
        let of = |set: Vec<usize>| set.into_iter().map(|index| terms[index]).collect();
        sets.filter(|set| !set.is_empty()).map(of).collect()
    }

    /// `Σ n·ln σ` of what some terms leave, everything else free.
    pub fn left(&self, terms: &[Term]) -> f64 {
        self.system(terms, &Free::all(self.run)).noise()
    }

    /// Moves the amounts of `terms` to where they leave least beside what is `free`. `is_taken` says whether
    /// the samples are what is left with the amounts so far taken off: then those that are none are dropped.
    pub fn refine(&self, terms: &mut Vec<Term>, free: &Free, is_taken: bool) {
        let system = self.system(terms, free);
        let every: Vec<usize> = (0..terms.len()).collect();
        let parameters = system.parameters(terms, &every, free);
        let step = system.step(&parameters);
        let covariance = system.covariance(&parameters);
        for (term, &start) in terms.iter_mut().zip(&system.starts) {
            let at = |i: usize| parameters.iter().position(|&p| p == start + i).unwrap_or(0);
            let variance = |i: usize| covariance[(at(i), at(i))].max(0.0);
            for i in 0..term.width() {
                term.amount[i] = f64::from(u8::from(is_taken)) * term.amount[i] + step[start + i];
            }
            let worst = (0..term.width()).map(variance).fold(0.0, f64::max);
            term.std_error = worst.sqrt();
            term.dof = (system.normal.independent - parameters.len() as f64).max(3.0);
        }
        if is_taken {
            terms.retain(Term::holds);
        }
    }

    /// The bends that `terms` are.
    pub fn bends(&self, terms: &[Term]) -> Vec<JointBend> {
        let bend = |term: &Term| {
            let Term { column, amount, std_error, dof, .. } = *term;
            let shape = match term.kind {
                Kind::Play => BendShape::Play,
                Kind::Sag => BendShape::Sag(Sag {
                    gravity: Arc::clone(&self.gravity),
                    most_torque: self.most_torque[column],
                }),
                Kind::Eccentric(order) => {
                    BendShape::Eccentric { order, phase_rad: amount[1].atan2(amount[0]) }
                }
            };
            JointBend { column, amount: Measured { value: term.size(), std_error, dof }, shape }
        };
        terms.iter().map(bend).collect()
    }
}

impl System {
    fn sum(&mut self) {
        let width = self.columns.iter().flatten().max().map_or(0, |last| last + 1);
        /// As the fit of the model damps its steps.
        const SCALE: f64 = 0.02;
        let mut normal = Normal::zeros(width);
        for ((linear, weights), columns) in
            self.linears.iter().zip(&self.weights).zip(&self.columns)
        {
            linear.accumulate(weights, columns, &mut normal);
        }
        for parameter in 0..width {
            normal.matrix[(parameter, parameter)] += SCALE.powi(-2);
        }
        self.normal = normal;
    }

    fn weigh(&mut self, step: &DVector<f64>) {
        let own = |columns: &[usize]| -> Vec<f64> { columns.iter().map(|&c| step[c]).collect() };
        self.weights = self
            .linears
            .iter()
            .zip(&self.columns)
            .map(|(linear, columns)| linear.weights_after(&own(columns)))
            .collect();
        self.sum();
    }

    /// The parameters of some terms and of what is free beside them, ascending.
    fn parameters(&self, terms: &[Term], set: &[usize], free: &Free) -> Vec<usize> {
        let dof = free.zeros.len();
        let own = dof + terms.iter().map(Term::width).sum::<usize>();
        let zeros =
            free.zeros.iter().enumerate().filter(|(_, free)| **free).map(|(joint, _)| joint);
        let mut parameters: Vec<usize> = zeros.collect();
        for &index in set {
            parameters.extend((0..terms[index].width()).map(|i| self.starts[index] + i));
        }
        for (s, parts) in free.streams.iter().enumerate() {
            for (part, _) in PARTS.into_iter().zip(parts).filter(|(_, free)| **free) {
                parameters.extend(part.map(|parameter| own + s * STREAM + parameter));
            }
        }
        parameters.sort_unstable();
        parameters
    }

    fn step(&self, parameters: &[usize]) -> DVector<f64> {
        let none = DVector::zeros(self.normal.right.len());
        self.normal.step(&none, parameters)
    }

    fn cost(&self, parameters: &[usize]) -> f64 {
        self.normal.cost_after(&self.step(parameters))
    }

    /// `Σ n·ln σ` of what is left.
    fn noise(&self) -> f64 {
        let of_stream = |(linear, weights): (&Linear, &Vec<Weight>)| {
            let log = weights.iter().map(|weight| weight.noise.sigma.ln()).sum::<f64>();
            linear.len() as f64 * log
        };
        self.linears.iter().zip(&self.weights).map(of_stream).sum()
    }

    fn covariance(&self, parameters: &[usize]) -> DMatrix<f64> {
        let n = parameters.len();
        let (mut information, mut scores) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        for ((linear, weights), columns) in
            self.linears.iter().zip(&self.weights).zip(&self.columns)
        {
            let targets: Vec<Option<usize>> =
                columns.iter().map(|column| parameters.binary_search(column).ok()).collect();
            linear.accumulate_covariance(weights, &targets, &mut information, &mut scores);
        }
        sandwich(&information, &scores)
    }
}

/// The set among `menu` that costs least with what each is worth, added and dropped one at a time. `plain`
/// is the cost of none.
fn fewest(
    menu: &[usize],
    plain: f64,
    cost: &dyn Fn(&[usize]) -> f64,
    worth: &dyn Fn(usize) -> f64,
) -> Vec<usize> {
    let (mut set, mut now): (Vec<usize>, f64) = (Vec::new(), plain);
    for _ in 0..2 * menu.len() {
        let grown = menu.iter().filter(|index| !set.contains(index)).map(|&index| {
            let with: Vec<usize> = set.iter().copied().chain([index]).collect();
            (index, cost(&with))
        });
        let best = grown.min_by(|a, b| (a.1 + worth(a.0)).total_cmp(&(b.1 + worth(b.0))));
        let Some((index, after)) = best.filter(|(index, after)| now - after > worth(*index)) else {
            break;
        };
        set.push(index);
        now = after;
        // What came first may be needless beside what came later.
        loop {
            let fewer = (0..set.len()).map(|at| {
                let mut fewer = set.clone();
                fewer.remove(at);
                (at, cost(&fewer))
            });
            let needless = fewer.filter(|(at, without)| without - now < worth(set[*at]));
            let Some((at, without)) = needless.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
            set.remove(at);
            now = without;
        }
    }
    set
}

/// The torques about the joints at each sample of each stream.
fn torques(gravity: &Gravity, samples: &[Samples], dof: usize) -> Vec<Vec<Vec<f64>>> {
    let mut buffer = Postures::default();
    let mut of_sample = |q: &Vec<f64>| {
        let mut torques = vec![0.0; dof];
        gravity.torques(q, &mut buffer, &mut torques);
        torques
    };
    samples.iter().map(|samples| samples.q.iter().map(&mut of_sample).collect()).collect()
}

/// The residuals of a stream's samples and their derivatives, in the base, at the tip.
fn linear(
    samples: &Samples,
    shapes: &[Vec<f64>],
    terms: &[Term],
    starts: &[usize],
    own: usize,
) -> Linear {
    const POSITION: usize = 0;
    const ROTATION: usize = 1;
    let mut linear = Linear::new(own + STREAM, &[FLOOR_M, FLOOR_RAD]);
    for (k, shapes) in shapes.iter().enumerate() {
        let mut rows = linear.push(&samples.residual[k]);
        let mut set = |column: usize, length: Vec3, angle: Vec3| {
            rows.set(POSITION, column, length.into());
            let angle = if samples.has_rotation { angle } else { Vec3::zeros() };
            rows.set(ROTATION, column, angle.into());
        };
        let of_joint = |joint: usize| {
            let [a, b, c, d, e, f] = samples.jacobian[k][joint];
            (Vec3::new(a, b, c), Vec3::new(d, e, f))
        };
        let (mut v, mut w) = (Vec3::zeros(), Vec3::zeros());
        for (joint, speed) in samples.qd[k].iter().enumerate() {
            let (length, angle) = of_joint(joint);
            set(joint, length, angle);
            v += length * *speed;
            w += angle * *speed;
        }
        let mut shapes = shapes.iter();
        for (term, &start) in terms.iter().zip(starts) {
            let (length, angle) = of_joint(term.column);
            for (i, shape) in shapes.by_ref().take(term.width()).enumerate() {
                set(start + i, length * *shape, angle * *shape);
            }
        }
        let fk = &samples.fk[k];
        let at = fk.translation.vector;
        set(own, -v, -w);
        set(own + 1, at, Vec3::zeros());
        for axis in 0..3 {
            let unit = Vec3::ith(axis, 1.0);
            set(own + 2 + axis, unit, Vec3::zeros());
            set(own + 5 + axis, unit.cross(&at), unit);
            let tool = fk.rotation * unit;
            set(own + 8 + axis, tool, Vec3::zeros());
            set(own + 11 + axis, Vec3::zeros(), tool);
        }
    }
    linear
}
