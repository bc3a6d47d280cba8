//! How the numbers of a joint state may have to be read: whose they are, in which unit, from which
//! zero.

use ground::robot::{Chain, JointKind};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// A joint whose position also contains a share of another joint's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coupling {
    /// The joint that moves.
    pub joint: usize,
    /// The joint that drives it.
    pub by: usize,
    /// How far `joint` moves per unit of `by`.
    pub factor: f64,
}

/// The number that each joint of a chain has, and what it means in rad or m:
/// `q[j] = factor[j] · row[from[j]] + zero[j]`, then `q[coupling.joint] += coupling.factor · q[coupling.by]`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JointMap {
    /// The entry that holds this joint's number.
    pub from: Vec<usize>,
    /// What the number is multiplied by.
    pub factor: Vec<f64>,
    /// What is then added, rad or m.
    pub zero: Vec<f64>,
    /// A pair of coupled joints.
    pub coupling: Option<Coupling>,
}

impl JointMap {
    /// The numbers are what they say.
    pub fn as_logged(dof: usize) -> Self {
        let (from, zero) = ((0..dof).collect(), vec![0.0; dof]);
        Self { from, factor: vec![1.0; dof], zero, coupling: None }
    }

    /// The joint positions that a row of numbers means.
    pub fn apply(&self, row: &[f64], q: &mut [f64]) {
        for (j, q) in q.iter_mut().enumerate() {
            *q = self.factor[j] * row[self.from[j]] + self.zero[j];
        }
        if let Some(Coupling { joint, by, factor }) = self.coupling {
            q[joint] += factor * q[by];
        }
    }

    /// The same with one joint read otherwise.
    pub fn with(&self, joint: usize, factor: f64, zero: f64) -> Self {
        let mut map = self.clone();
        (map.factor[joint], map.zero[joint]) = (factor, zero);
        map
    }

    /// The same without a zero of the first joint that is a round turn: the base is turned then, as makers'
    /// bases are against each other's.
    pub fn with_base_turned(&self) -> Self {
        let zero = if is_quarter_turn(self.zero[0]) { 0.0 } else { self.zero[0] };
        self.with(0, self.factor[0], zero)
    }

    /// The same with numbers in another order, whose units go with the numbers.
    pub fn in_order(&self, from: &[usize]) -> Self {
        Self { from: from.to_vec(), ..self.clone() }
    }

    /// By how many turns a turning joint's zero may be moved, it is: into a half turn where the
    /// numbers are whole radians, else to where the positions are nearest to the joint's range.
    pub fn settle_turns(&mut self, chain: &Chain, spans: &[[f64; 2]]) {
        for (j, kind) in chain.joint_kinds().iter().enumerate() {
            if *kind == JointKind::Prismatic {
                continue;
            }
            let limits = chain.limits()[j];
            let middle =
                limits.lower.zip(limits.upper).map_or(0.0, |(low, high)| (low + high) / 2.0);
            let [low, high] = spans[self.from[j]];
            let turns = match self.factor[j] {
                1.0 => half_turns(self.zero[j]),
                factor => ((factor * (low + high) / 2.0 + self.zero[j] - middle) / TAU).round(),
            };
            self.zero[j] -= TAU * turns;
        }
    }

    /// Whether it takes a turning joint to where none is: so far beyond its limits or, where it has none,
    /// through so many turns.
    pub fn out_of_range(&self, chain: &Chain, spans: &[[f64; 2]]) -> bool {
        const BEYOND: f64 = 2.0;
        const TURNS: f64 = 3.0;
        (0..self.from.len()).any(|j| {
            let limits = chain.limits()[j];
            let most = limits.lower.zip(limits.upper).map(|(low, high)| low.abs().max(high.abs()));
            let ends = spans[self.from[j]].map(|end| self.factor[j] * end + self.zero[j]);
            let farthest = ends[0].abs().max(ends[1].abs());
            chain.joint_kinds()[j] != JointKind::Prismatic
                && farthest > most.map_or(TURNS * TAU, |most| most + BEYOND)
        })
    }

    /// How many joints it takes beyond the limits of the model by more than a twentieth of their
    /// range.
    pub fn beyond_limits(&self, chain: &Chain, spans: &[[f64; 2]]) -> usize {
        let is_beyond = |j: &usize| {
            let limits = chain.limits()[*j];
            let Some((lower, upper)) = limits.lower.zip(limits.upper) else { return false };
            let ends = spans[self.from[*j]].map(|end| self.factor[*j] * end + self.zero[*j]);
            let room = 0.05 * (upper - lower);
            ends.iter().any(|end| *end < lower - room || *end > upper + room)
        };
        (0..self.from.len()).filter(is_beyond).count()
    }
}

/// Whether an angle is a multiple of 90°, zero among them.
pub(in super::super) fn is_quarter_turn(angle: f64) -> bool {
    /// Tolerance, rad: an estimated round angle is this close, a tuned zero hardly ever.
    const NEAR: f64 = 5e-3;
    let quarters = angle / FRAC_PI_2;
    (quarters - quarters.round()).abs() * FRAC_PI_2 < NEAR
}

/// Whole turns by which an angle is outside of (−π, π].
pub(in super::super) fn half_turns(angle: f64) -> f64 {
    ((angle - PI) / TAU).ceil()
}

/// A way in which all joints of an arm may be read.
pub(super) struct Whole {
    pub map: JointMap,
    /// Whether turning joints are in degrees, and sliding ones in millimetres, and nothing else.
    pub is_unit: bool,
}

/// The ways in which all joints of an arm are read at once: degrees, millimetres, other units of
/// angle, ticks of an encoder, all reversed, and shares of the range.
pub(super) fn wholes(chain: &Chain) -> Vec<Whole> {
    let kinds = chain.joint_kinds();
    let none = JointMap::as_logged(kinds.len());
    let slides = |kind: &JointKind| *kind == JointKind::Prismatic;
    let scaled = |turning: f64, sliding: f64| {
        let factor = kinds.iter().map(|kind| if slides(kind) { sliding } else { turning });
        JointMap { factor: factor.collect(), ..none.clone() }
    };
    let degree = 1f64.to_radians();
    let mut wholes: Vec<Whole> = [(degree, 1.0), (degree, 1e-3), (1.0, 1e-3)]
        .map(|(turning, sliding)| Whole { map: scaled(turning, sliding), is_unit: true })
        .into();
    let mut add = |map: JointMap| wholes.push(Whole { map, is_unit: false });
    let angles = [TAU, PI, 1e-3, 1e-6, 0.1 * degree, 0.01 * degree, 1e-3 * degree, TAU / 400.0];
    for turning in angles.into_iter().chain([2.0, 0.5]) {
        for sign in [1.0, -1.0] {
            add(scaled(sign * turning, 1.0));
            if kinds.iter().any(slides) {
                add(scaled(sign * turning, 1e-3));
            }
        }
    }
    add(scaled(-1.0, 1.0));
    add(scaled(-1.0, -1.0));
    add(scaled(-degree, 1.0));
    for bits in 8..=24 {
        let tick = TAU / f64::from(1 << bits);
        for sign in [1.0, -1.0] {
            let map = scaled(sign * tick, 1.0);
            let mut centred = map.clone();
            for (zero, kind) in centred.zero.iter_mut().zip(kinds) {
                *zero = if slides(kind) { 0.0 } else { -sign * PI };
            }
            add(map);
            add(centred);
        }
    }
    for [low, high] in [[-100.0, 100.0], [0.0, 100.0], [-1.0, 1.0], [0.0, 1.0]] {
        let mut map = none.clone();
        for (j, limits) in chain.limits().iter().enumerate() {
            if let Some((lower, upper)) = limits.lower.zip(limits.upper) {
                map.factor[j] = (upper - lower) / (high - low);
                map.zero[j] = lower - map.factor[j] * low;
            }
        }
        add(map);
    }
    wholes.retain(|whole| whole.map != none);
    let mut distinct: Vec<Whole> = Vec::new();
    for whole in wholes {
        if !distinct.iter().any(|other| other.map == whole.map) {
            distinct.push(whole);
        }
    }
    distinct
}

/// Most joints whose orders are all tried (7! = 5040).
pub(super) const ALL_ORDERS: usize = 7;

/// Orders in which the numbers of joints may stand: all of them of up to `most` joints, else every
/// exchange of two joints, and back to front, and by `names` sorted.
pub(super) fn orders(names: &[String], most: usize) -> Vec<Vec<usize>> {
    let dof = names.len();
    let mut order: Vec<usize> = (0..dof).collect();
    let mut all = Vec::new();
    if dof <= most {
        permutations(&mut order, 0, &mut |order| all.push(order.to_vec()));
        return all;
    }
    for a in 0..dof {
        for b in a + 1..dof {
            let mut swapped = order.clone();
            swapped.swap(a, b);
            all.push(swapped);
        }
    }
    all.push((0..dof).rev().collect());
    let mut sorted = order.clone();
    sorted.sort_by_key(|&joint| &names[joint]);
    let mut rank = vec![0; dof];
    sorted.iter().enumerate().for_each(|(place, &joint)| rank[joint] = place);
    all.push(order);
    all.push(sorted);
    all.push(rank);
    all
}

fn permutations(order: &mut [usize], from: usize, visit: &mut dyn FnMut(&[usize])) {
    if from == order.len() {
        return visit(order);
    }
    for i in from..order.len() {
        order.swap(from, i);
        permutations(order, from + 1, visit);
        order.swap(from, i);
    }
}
