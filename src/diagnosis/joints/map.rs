//! Mapping from logged joint values to joint positions: order, unit and zero.

use crate::distinct::distinct;
use ground::robot::Chain;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Motion of a joint per unit of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coupling {
    /// Driven joint.
    pub joint: usize,
    /// Driving joint.
    pub by: usize,
    pub factor: f64,
}

/// Mapping of a logged row to joint positions, rad or m: `q[j] = factor[j] · row[from[j]] + zero[j]`, then
/// `q[coupling.joint] += coupling.factor · q[coupling.by]`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct JointMap {
    pub from: Vec<usize>,
    pub factor: Vec<f64>,
    pub zero: Vec<f64>,
    pub coupling: Option<Coupling>,
}

impl JointMap {
    pub fn as_logged(dof: usize) -> Self {
        let (from, zero) = ((0..dof).collect(), vec![0.0; dof]);
        Self { from, factor: vec![1.0; dof], zero, coupling: None }
    }

    pub fn apply(&self, row: &[f64], q: &mut [f64]) {
        for (j, q) in q.iter_mut().enumerate() {
            *q = self.factor[j] * row[self.from[j]] + self.zero[j];
        }
        if let Some(Coupling { joint, by, factor }) = self.coupling {
            q[joint] += factor * q[by];
        }
    }

    /// Replaces one joint's factor and zero.
    pub fn with(&self, joint: usize, factor: f64, zero: f64) -> Self {
        let mut map = self.clone();
        (map.factor[joint], map.zero[joint]) = (factor, zero);
        map
    }

    /// Removes a zero of the first joint that is a multiple of 90°: base frames differ so between makers.
    pub fn with_base_turned(&self) -> Self {
        let zero = if is_quarter_turn(self.zero[0]) { 0.0 } else { self.zero[0] };
        self.with(0, self.factor[0], zero)
    }

    /// The units stay with the logged values.
    pub fn in_order(&self, from: &[usize]) -> Self {
        Self { from: from.to_vec(), ..self.clone() }
    }

    /// Acts on the zeros of revolute joints. Radians are unwrapped to within half a turn, others to the
    /// centre of the joint's range.
    pub fn remove_whole_turns(&mut self, chain: &Chain, spans: &[[f64; 2]]) {
        for j in chain.turning_joints() {
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

    fn ends(&self, joint: usize, spans: &[[f64; 2]]) -> [f64; 2] {
        spans[self.from[joint]].map(|end| self.factor[joint] * end + self.zero[joint])
    }

    /// Whether a revolute joint is far beyond its limits or, without limits, several turns.
    pub fn out_of_range(&self, chain: &Chain, spans: &[[f64; 2]]) -> bool {
        const MAX_LIMIT_RATIO: f64 = 2.0;
        const MAX_TURNS: f64 = 3.0;
        chain.turning_joints().any(|j| {
            let limits = chain.limits()[j];
            let most = limits.lower.zip(limits.upper).map(|(low, high)| low.abs().max(high.abs()));
            let [first, last] = self.ends(j, spans);
            let farthest = first.abs().max(last.abs());
            farthest > most.map_or(MAX_TURNS * TAU, |most| most + MAX_LIMIT_RATIO)
        })
    }

    /// Joints beyond the model's limits by over a twentieth of the range.
    pub fn beyond_limits(&self, chain: &Chain, spans: &[[f64; 2]]) -> usize {
        let is_beyond = |j: &usize| {
            let limits = chain.limits()[*j];
            let Some((lower, upper)) = limits.lower.zip(limits.upper) else { return false };
            let room = 0.05 * (upper - lower);
            self.ends(*j, spans).iter().any(|end| *end < lower - room || *end > upper + room)
        };
        (0..self.from.len()).filter(is_beyond).count()
    }
}

/// Whether `angle` is a multiple of a quarter turn.
pub(crate) fn is_quarter_turn(angle: f64) -> bool {
    /// Estimates of round angles are within it; a tuned zero rarely is.
    const ROUND_TOLERANCE_RAD: f64 = 5e-3;
    let quarters = angle / FRAC_PI_2;
    (quarters - quarters.round()).abs() * FRAC_PI_2 < ROUND_TOLERANCE_RAD
}

/// Whole turns outside (−π, π].
pub(crate) fn half_turns(angle: f64) -> f64 {
    ((angle - PI) / TAU).ceil()
}

/// Revolute and prismatic joints multiplied by a factor each.
pub(super) fn scaled(chain: &Chain, turning: f64, sliding: f64) -> JointMap {
    let factor = |joint: usize| if chain.slides(joint) { sliding } else { turning };
    let factor = (0..chain.dof()).map(factor).collect();
    JointMap { factor, ..JointMap::as_logged(chain.dof()) }
}

/// All revolute joints in degrees, all prismatic ones in millimetres, and both.
pub(super) fn unit_maps(chain: &Chain) -> Vec<JointMap> {
    let degree = 1f64.to_radians();
    let all = [(degree, 1.0), (degree, 1e-3), (1.0, 1e-3)];
    let all = all.map(|(turning, sliding)| scaled(chain, turning, sliding));
    let none = JointMap::as_logged(chain.dof());
    distinct(all.into_iter().filter(|map| *map != none), JointMap::eq)
}

/// Other angle units, encoder ticks, all reversed, shares of the range, and declared degrees that are radians.
pub(super) fn other_maps(chain: &Chain) -> Vec<JointMap> {
    let degree = 1f64.to_radians();
    let mut maps = Vec::new();
    let angles = [TAU, PI, 1e-3, 1e-6, 0.1 * degree, 0.01 * degree, 1e-3 * degree, TAU / 400.0];
    for turning in angles.into_iter().chain([2.0, 0.5]) {
        for sign in [1.0, -1.0] {
            maps.extend([1.0, 1e-3].map(|sliding| scaled(chain, sign * turning, sliding)));
        }
    }
    // The last are radians declared as degrees.
    let reversed = [(-1.0, 1.0), (-1.0, -1.0), (-degree, 1.0), (1.0 / degree, 1.0)];
    maps.extend(reversed.map(|(turning, sliding)| scaled(chain, turning, sliding)));
    for bits in 8..=24 {
        let tick = TAU / f64::from(1 << bits);
        for sign in [1.0, -1.0] {
            let map = scaled(chain, sign * tick, 1.0);
            let mut centred = map.clone();
            chain.turning_joints().for_each(|joint| centred.zero[joint] = -sign * PI);
            maps.extend([map, centred]);
        }
    }
    let none = JointMap::as_logged(chain.dof());
    for [low, high] in [[-100.0, 100.0], [0.0, 100.0], [-1.0, 1.0], [0.0, 1.0]] {
        let mut map = none.clone();
        for (j, limits) in chain.limits().iter().enumerate() {
            if let Some((lower, upper)) = limits.lower.zip(limits.upper) {
                map.factor[j] = (upper - lower) / (high - low);
                map.zero[j] = lower - map.factor[j] * low;
            }
        }
        maps.push(map);
    }
    let known = [unit_maps(chain), vec![none]].concat();
    distinct(maps.into_iter().filter(|map| !known.contains(map)), JointMap::eq)
}

/// Exhaustive search (7! = 5040).
pub(super) const MAX_PERMUTED_JOINTS: usize = 7;

/// All permutations of up to `max_joints` joints; otherwise all swaps, the reversed order, and the order by
/// `names`.
pub(super) fn candidate_orders(names: &[String], max_joints: usize) -> Vec<Vec<usize>> {
    let dof = names.len();
    let mut order: Vec<usize> = (0..dof).collect();
    let mut all = Vec::new();
    if dof <= max_joints {
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
    let mut sorted = order.clone();
    sorted.sort_by_key(|&joint| &names[joint]);
    let mut rank = vec![0; dof];
    sorted.iter().enumerate().for_each(|(place, &joint)| rank[joint] = place);
    all.extend([(0..dof).rev().collect(), order, sorted, rank]);
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
