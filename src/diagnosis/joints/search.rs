//! Searches for the simplest interpretation of the joint states that fits a pose stream. Kinds are tried
//! the simplest first: another unit, reversed joints or one joint misinterpreted; another order;
//! combinations of two. The best proposals of a kind are refined.

use super::interpretation::JointInterpretation;
use super::interpreted_poses::{ConstantFrames, FreeFrames, InterpretedPoses, ResidualSize};
use super::map::{
    Coupling, JointMap, MAX_PERMUTED_JOINTS, candidate_orders, other_maps, unit_maps,
};
use super::refinement::{JointProposal, RefinedProposal};
use super::single_joint::SingleJoint;
use crate::distinct::by_score;
use crate::frames::position_fit::spread;
use crate::priors::FLANGE_PRIOR_M;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Per kind on all samples, after `ROUGH_STEPS` steps on `ROUGH_SAMPLES` samples.
const REFINED_PROPOSALS: usize = 24;
const ROUGH_STEPS: usize = 8;
const ROUGH_SAMPLES: usize = 20;
/// Rough residual over the largest accepted one, beyond which no proposal of a kind is refined: the remaining steps and
/// samples change a residual by less.
const MAX_ROUGH_RATIO: f64 = 3.0;
/// Steps of the full refinement.
const MAX_STEPS: usize = 25;
/// More are preselected by a frame-free score on `SCREENING_SAMPLES` samples.
const MAX_UNSCREENED_PROPOSALS: usize = 150;
const SCREENING_SAMPLES: usize = 12;
/// To determine a joint's sign and scale.
pub(crate) const MIN_MOTION_RAD: f64 = 0.05;
const MIN_MOTION_M: f64 = 5e-3;
/// Ratio to the best residual that excludes another interpretation.
const MIN_RESIDUAL_RATIO: f64 = 2.0;
/// A costlier interpretation is selected only if the cheaper one exceeds this multiple of the least
/// residual.
const MAX_COMPETITOR_RATIO: f64 = 4.0;
/// A cheaper interpretation below this residual is kept: link deviations explain it.
const MAX_MODEL_RESIDUAL_M: f64 = 2.0 * FLANGE_PRIOR_M;
/// Smaller residuals distinguish no interpretations.
const RESIDUAL_FLOOR_M: f64 = 3e-4;
const ORDER_PRICE: f64 = 1.5;
/// Costlier sets of reversed joints are one mirrored axis instead.
const MIRROR_PRICE: f64 = 1.2;
/// Share of their extent.
const MAX_MIRRORED_RESIDUAL_SHARE: f64 = 0.02;
/// All subsets of as many joints are tried.
const MAX_SUBSET_JOINTS: usize = 10;
/// For a scale that is not round.
const ODD_SCALE_PRICE: f64 = 0.5;

pub(super) enum SearchOutcome {
    /// Clearly best.
    Found(JointInterpretation),
    /// Several fit equally well, with this residual, m.
    Ambiguous(f64),
    Nothing,
}

/// The simplest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum InterpretationKind {
    /// One cause: a unit, reversed joints, or one joint.
    OneJoint,
    Order,
    /// One joint coupled to another.
    Coupled,
    UnitAndOneJoint,
    TwoJoints,
    OrderAndOneJoint,
}

impl InterpretationKind {
    pub const ALL: [InterpretationKind; 6] = [
        InterpretationKind::OneJoint,
        InterpretationKind::Order,
        InterpretationKind::Coupled,
        InterpretationKind::UnitAndOneJoint,
        InterpretationKind::TwoJoints,
        InterpretationKind::OrderAndOneJoint,
    ];
    /// Kinds for a stream already close to FK.
    pub const FOR_SMALL_RESIDUALS: [InterpretationKind; 2] =
        [InterpretationKind::OneJoint, InterpretationKind::Coupled];
}

/// Accepts a residual of at most `max_residual`.
pub(super) fn search_kind(
    view: &InterpretedPoses,
    kind: InterpretationKind,
    freedom: FreeFrames,
    max_residual: ResidualSize,
) -> SearchOutcome {
    let none = view.as_logged();
    if is_within(&view.fitted_residual(&none, freedom), max_residual) {
        // The poses fit as logged.
        return SearchOutcome::Nothing;
    }
    if let (InterpretationKind::OneJoint, Some(found)) = (kind, mirrored_in_unit(view)) {
        return SearchOutcome::Found(found);
    }
    let proposals = match kind {
        InterpretationKind::OneJoint => one_joint(view, freedom),
        InterpretationKind::Order => reordered(view, freedom),
        InterpretationKind::Coupled => coupled_pairs(view),
        InterpretationKind::UnitAndOneJoint => unit_and_one_joint(view, freedom),
        InterpretationKind::TwoJoints => two_joints(view, freedom),
        InterpretationKind::OrderAndOneJoint => order_and_one_joint(view, freedom),
    };
    refine_and_select(view, proposals, freedom, max_residual)
}

fn is_within(residual: &ResidualSize, max_residual: ResidualSize) -> bool {
    residual.m <= max_residual.m
        && residual
            .rad
            .zip(max_residual.rad)
            .is_none_or(|(residual, max_residual)| residual <= max_residual)
}

fn refine_and_select(
    view: &InterpretedPoses,
    proposals: Vec<JointProposal>,
    freedom: FreeFrames,
    max_residual: ResidualSize,
) -> SearchOutcome {
    let thin = view.thinned(ROUGH_SAMPLES);
    let mut rough: Vec<(f64, JointProposal)> = proposals
        .into_par_iter()
        .map(|proposal| {
            let RefinedProposal { map, total_m, .. } = proposal.refine(&thin, freedom, ROUGH_STEPS);
            (total_m, JointProposal { map, ..proposal })
        })
        .collect();
    rough.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rad = max_residual.rad.filter(|_| view.rotation.is_some());
    let max_rough_m =
        MAX_ROUGH_RATIO * ResidualSize { rad, ..max_residual }.combined_m(view.lever_m);
    if rough.first().is_none_or(|(left, _)| *left > max_rough_m) {
        return SearchOutcome::Nothing;
    }
    rough.truncate(REFINED_PROPOSALS);
    let polished = rough.into_par_iter().map(|(_, one)| one.refine(view, freedom, MAX_STEPS));
    let polished: Vec<RefinedProposal> = polished.collect();
    let min_residual = polished.iter().map(|one| one.total_m).fold(f64::INFINITY, f64::min);
    let max_equivalent = (MAX_COMPETITOR_RATIO * min_residual).max(MAX_MODEL_RESIDUAL_M);
    let equivalent = polished
        .iter()
        .filter(|one| is_within(&one.residual, max_residual) && one.total_m <= max_equivalent);
    let Some(best) =
        equivalent.min_by(|a, b| a.price.total_cmp(&b.price).then(a.total_m.total_cmp(&b.total_m)))
    else {
        return SearchOutcome::Nothing;
    };
    let others = polished.iter().filter(|other| {
        other.price <= best.price && !gives_same_positions(view, &other.map, &best.map)
    });
    let runner_up = others.min_by(|a, b| a.total_m.total_cmp(&b.total_m));
    let min_runner_up_m = MIN_RESIDUAL_RATIO * best.total_m.max(RESIDUAL_FLOOR_M);
    if runner_up.is_some_and(|other| other.total_m < min_runner_up_m) {
        return SearchOutcome::Ambiguous(best.total_m);
    }
    let runner_up_m = runner_up.map(|other| other.residual.m);
    let map = best.map.with_base_turned();
    SearchOutcome::Found(JointInterpretation { map, residual: best.residual, runner_up_m })
}

fn gives_same_positions(view: &InterpretedPoses, a: &JointMap, b: &JointMap) -> bool {
    /// In rad or m.
    const POSITION_TOLERANCE: f64 = 0.02;
    let dof = view.chain.dof();
    let (mut by_a, mut by_b) = (vec![0.0; dof], vec![0.0; dof]);
    view.q.chunks_exact(dof).all(|row| {
        a.apply(row, &mut by_a);
        b.apply(row, &mut by_b);
        by_a.iter().zip(&by_b).enumerate().all(|(joint, (a, b))| {
            let difference = a - b;
            let turns = if view.chain.slides(joint) { 0.0 } else { (difference / TAU).round() };
            (difference - TAU * turns).abs() < POSITION_TOLERANCE
        })
    })
}

/// Before refinement.
fn best_proposals(
    view: &InterpretedPoses,
    proposals: Vec<JointProposal>,
    freedom: FreeFrames,
    most: usize,
) -> Vec<JointProposal> {
    let thin = view.thinned(SCREENING_SAMPLES);
    let by =
        |proposals: Vec<JointProposal>, most: usize, score: &(dyn Fn(&JointMap) -> f64 + Sync)| {
            let scored = proposals.into_par_iter().map(|one| (score(&one.map), one));
            by_score(scored.collect::<Vec<_>>()).take(most).collect::<Vec<_>>()
        };
    let screened = match proposals.len() > MAX_UNSCREENED_PROPOSALS {
        true => {
            let logged = thin.distances(&thin.logged());
            by(proposals, MAX_UNSCREENED_PROPOSALS, &|map| thin.strain(map, &logged))
        }
        false => proposals,
    };
    by(screened, most, &|map| view.misfit(map, freedom))
}

/// Likely part of the fault; whether the joint ranges support them.
pub(super) fn likely_maps(view: &InterpretedPoses) -> Vec<(JointMap, bool)> {
    let none = view.as_logged();
    let is_out = none.out_of_range(view.chain, &view.spans);
    let in_range = unit_maps(view.chain)
        .into_iter()
        .find(|unit| is_out && unit.beyond_limits(view.chain, &view.spans) == 0);
    let ordered = reordered(view, FreeFrames::Both);
    let nearest = best_proposals(view, ordered, FreeFrames::Both, 1);
    let nearest = nearest.into_iter().map(|one| (one.map, false));
    in_range.map(|unit| (unit, true)).into_iter().chain(nearest).collect()
}

fn moves_enough(view: &InterpretedPoses, map: &JointMap, joint: usize, factor: f64) -> bool {
    let least = if view.chain.slides(joint) { MIN_MOTION_M } else { MIN_MOTION_RAD };
    factor.abs() * logged_range(view, map, joint) > least
}

fn logged_range(view: &InterpretedPoses, map: &JointMap, joint: usize) -> f64 {
    let [low, high] = view.spans[map.from[joint]];
    high - low
}

fn moving_joints(view: &InterpretedPoses, map: &JointMap) -> Vec<usize> {
    (0..view.chain.dof())
        .filter(|&joint| moves_enough(view, map, joint, map.factor[joint]))
        .collect()
}

fn one_joint(view: &InterpretedPoses, freedom: FreeFrames) -> Vec<JointProposal> {
    let thin = &view.thinned(ROUGH_SAMPLES);
    let none = view.as_logged();
    let nearest = |proposals| best_proposals(thin, proposals, freedom, REFINED_PROPOSALS / 2);
    let units = unit_maps(view.chain).into_iter().map(|map| JointProposal::new(map, 1.0));
    let others = other_maps(view.chain).into_iter().map(|map| JointProposal::new(map, 1.25));
    let mut proposals = nearest(units.chain(others).collect());
    let mut reversed = reversed_subsets(view, &none);
    if is_mirrored(view, &none) {
        // They can be equivalent to one mirrored axis, which is a single cause.
        reversed.retain(|proposal| proposal.price < MIRROR_PRICE);
    }
    proposals.extend(nearest(reversed));
    proposals.extend(nearest(subsets_in_degrees(view, &none)));
    proposals.extend(common_gear(thin, &none, freedom));
    let none = JointProposal::new(none, 0.0);
    proposals
        .extend((0..view.chain.dof()).flat_map(|joint| single_joint(thin, &none, freedom, joint)));
    proposals
}

fn is_mirrored(view: &InterpretedPoses, map: &JointMap) -> bool {
    view.mirrored().misfit(map, FreeFrames::Both) < MAX_MIRRORED_RESIDUAL_SHARE * spread(&view.xyz)
}

/// Reversing all joints in that unit would also fit, but with rotated frames.
fn mirrored_in_unit(view: &InterpretedPoses) -> Option<JointInterpretation> {
    let map = unit_maps(view.chain).into_iter().find(|unit| is_mirrored(view, unit))?;
    let max_residual =
        ResidualSize { m: MAX_MIRRORED_RESIDUAL_SHARE * spread(&view.xyz), rad: None };
    Some(JointInterpretation { map, residual: max_residual, runner_up_m: None })
}

/// Maps with another factor of each subset of `joints`, with the size of the subset. Empty if there are too many joints.
fn subsets<'a>(
    base: &'a JointMap,
    joints: &'a [usize],
    factor: impl Fn(f64) -> f64 + 'a,
) -> impl Iterator<Item = (JointMap, usize)> + 'a {
    let count = if joints.len() > MAX_SUBSET_JOINTS { 0 } else { 1u32 << joints.len() };
    (0..count).map(move |chosen| {
        let mut map = base.clone();
        for (_, &joint) in joints.iter().enumerate().filter(|(bit, _)| chosen & (1 << bit) != 0) {
            map.factor[joint] = factor(map.factor[joint]);
        }
        (map, chosen.count_ones() as usize)
    })
}

/// Reversing all joints is one cause.
fn reversed_subsets(view: &InterpretedPoses, base: &JointMap) -> Vec<JointProposal> {
    let moving = moving_joints(view, base);
    let reversed = subsets(base, &moving, |factor| -factor).skip(1);
    let price = |count: usize| if count == moving.len() { 1.25 } else { count as f64 };
    reversed.map(|(map, count)| JointProposal::new(map, price(count))).collect()
}

/// Some joints in degrees, among them all that turn too far in radians. Empty without such joints.
fn subsets_in_degrees(view: &InterpretedPoses, base: &JointMap) -> Vec<JointProposal> {
    /// One cause, but rarer than a unit of all joints. Joints whose unit the motion does not show remain as logged.
    const PRICE: f64 = 1.5;
    const PRICE_OF_JOINT: f64 = 0.01;
    /// No joint turns further, rad.
    const MAX_TURN_RAD: f64 = 2.0 * TAU;
    let is_far =
        |joint: &usize| view.spans[base.from[*joint]].iter().any(|end| end.abs() > MAX_TURN_RAD);
    let (far, near): (Vec<usize>, Vec<usize>) = view.chain.turning_joints().partition(is_far);
    if far.is_empty() {
        return Vec::new();
    }
    let degree = 1f64.to_radians();
    let mut base = base.clone();
    far.iter().for_each(|&joint| base.factor[joint] = degree);
    // All of them are another proposal.
    subsets(&base, &near, |_| degree)
        .filter(|(_, count)| *count < near.len())
        .map(|(map, count)| JointProposal::new(map, PRICE + PRICE_OF_JOINT * count as f64))
        .collect()
}

/// Common factor of all revolute joints that is not round, such as that of a unit.
fn common_gear(
    view: &InterpretedPoses,
    base: &JointMap,
    freedom: FreeFrames,
) -> Option<JointProposal> {
    /// Maximum range of any joint, the minimum as a share of it, and the ratio of successive factors.
    const MAX_RANGE_RAD: f64 = 2.0 * TAU;
    const MIN_RANGE_SHARE: f64 = 0.01;
    const FACTOR_STEP: f64 = 1.04;
    /// Of the factor, from 1. No unit differs by so little.
    const MIN_DIFFERENCE: f64 = 0.05;
    let mut turning = moving_joints(view, base);
    turning.retain(|joint| !view.chain.slides(*joint));
    let widest = turning.iter().map(|&joint| logged_range(view, base, joint)).fold(0.0, f64::max);
    if widest <= 0.0 {
        return None;
    }
    let scaled = |factor: f64| {
        let mut map = base.clone();
        turning.iter().for_each(|&joint| map.factor[joint] = factor);
        map
    };
    let steps = ((MAX_RANGE_RAD / MIN_RANGE_SHARE).ln() / FACTOR_STEP.ln()) as i32;
    let tried = (0..=steps).flat_map(|step| {
        let factor = MIN_RANGE_SHARE / widest * FACTOR_STEP.powi(step);
        [factor, -factor].map(|factor| JointProposal::new(scaled(factor), 1.25 + ODD_SCALE_PRICE))
    });
    let best = best_proposals(view, tried.collect(), freedom, 1).pop()?;
    let is_unit =
        turning.iter().all(|&joint| (best.map.factor[joint] - 1.0).abs() > MIN_DIFFERENCE);
    is_unit.then_some(JointProposal { factors: turning, ..best })
}

fn reordered(view: &InterpretedPoses, freedom: FreeFrames) -> Vec<JointProposal> {
    let thin = view.thinned(ROUGH_SAMPLES);
    let none = view.as_logged();
    let orders = candidate_orders(view.chain.joint_names(), MAX_PERMUTED_JOINTS);
    let units = unit_maps(view.chain).into_iter().map(|unit| (unit, 1.0));
    let bases = std::iter::once((none.clone(), 0.0)).chain(units);
    let all = bases
        .flat_map(|(base, price)| {
            orders
                .iter()
                .map(move |order| JointProposal::new(base.in_order(order), price + ORDER_PRICE))
        })
        .filter(|proposal| proposal.map.from != none.from)
        .collect();
    best_proposals(&thin, all, freedom, REFINED_PROPOSALS / 2)
}

/// Pairs of coupled revolute joints with a factor of ±1 (angle from the horizon, as FANUC's J3) or an
/// estimated one (wrists with concentric gear trains).
fn coupled_pairs(view: &InterpretedPoses) -> Vec<JointProposal> {
    const FACTORS: [(f64, bool); 3] = [(1.0, false), (-1.0, false), (0.0, true)];
    let none = view.as_logged();
    let turning: Vec<usize> = view.chain.turning_joints().collect();
    let mut driving = moving_joints(view, &none);
    driving.retain(|by| turning.contains(by));
    let mut proposals = Vec::new();
    for &joint in &turning {
        for &by in driving.iter().filter(|by| **by != joint) {
            proposals.extend(FACTORS.map(|(factor, fits_coupling)| {
                let map =
                    JointMap { coupling: Some(Coupling { joint, by, factor }), ..none.clone() };
                let price = if fits_coupling { 1.0 + ODD_SCALE_PRICE } else { 1.0 };
                JointProposal { fits_coupling, ..JointProposal::new(map, price) }
            }));
        }
    }
    proposals
}

fn unit_and_one_joint(view: &InterpretedPoses, freedom: FreeFrames) -> Vec<JointProposal> {
    let thin = view.thinned(ROUGH_SAMPLES);
    let pairs: Vec<(JointProposal, usize)> = unit_maps(view.chain)
        .into_iter()
        .map(|unit| JointProposal::new(unit, 1.0))
        .flat_map(|unit| (0..view.chain.dof()).map(move |joint| (unit.clone(), joint)))
        .collect();
    pairs
        .into_par_iter()
        .flat_map_iter(|(unit, joint)| single_joint(&thin, &unit, freedom, joint))
        .collect()
}

/// Tries the joint's zero, direction, unit or scale.
fn single_joint(
    view: &InterpretedPoses,
    base: &JointProposal,
    freedom: FreeFrames,
    joint: usize,
) -> Vec<JointProposal> {
    let slides = view.chain.slides(joint);
    let own = base.map.factor[joint];
    let moves = |factor: f64| moves_enough(view, &base.map, joint, factor);
    let with_zero = |factor: f64, price: f64| {
        let pick = |single: &SingleJoint| (factor, single.best_zero(factor, true).0);
        let zero = alternate_fit(view, &base.map, freedom, joint, pick).1;
        base.with_joint(joint, factor, Some(zero), price)
    };
    let mut proposals = vec![with_zero(own, 1.0)];
    let reversed = moves(own).then_some(-own);
    let units: &[f64] = if slides { &[1e-3, 1e-2] } else { &[std::f64::consts::PI / 180.0] };
    let units = units.iter().copied().filter(|&unit| own == 1.0 && moves(unit));
    for factor in reversed.into_iter().chain(units) {
        proposals.push(base.with_joint(joint, factor, None, 1.0));
        proposals.push(with_zero(factor, 2.0));
    }
    for has_zero in [true, false] {
        let pick = |single: &SingleJoint| single.best_factor(has_zero).unwrap_or((own, 0.0));
        let (factor, zero) = alternate_fit(view, &base.map, freedom, joint, pick);
        if moves(factor) {
            let price = ODD_SCALE_PRICE + if has_zero { 2.0 } else { 1.0 };
            let scaled = base.with_joint(joint, factor, has_zero.then_some(zero), price);
            proposals.push(JointProposal { factors: vec![joint], ..scaled });
        }
    }
    proposals
}

/// Factor and zero from `pick`, alternating with the constant frames.
fn alternate_fit(
    view: &InterpretedPoses,
    base: &JointMap,
    freedom: FreeFrames,
    joint: usize,
    pick: impl Fn(&SingleJoint) -> (f64, f64),
) -> (f64, f64) {
    const ALTERNATIONS: usize = 3;
    let mut frames = view.first_frames(base, freedom);
    let mut found = (base.factor[joint], base.zero[joint]);
    for _ in 0..ALTERNATIONS {
        found = pick(&SingleJoint::new(view, base, &frames, joint));
        frames = view.fit_frames(&view.fk(&base.with(joint, found.0, found.1)), freedom);
    }
    found
}

/// `base` with a fault of each of `joints`: another zero, and, for those in `reversible`, the other direction, then both.
fn with_joint_faults<'a>(
    view: &InterpretedPoses,
    base: &'a JointProposal,
    frames: &ConstantFrames,
    joints: Vec<usize>,
    reversible: &'a [usize],
) -> impl Iterator<Item = impl Iterator<Item = JointProposal> + 'a> + 'a {
    let singles = SingleJoint::each(view, &base.map, frames, &joints);
    singles.into_iter().zip(joints).map(move |(single, joint)| {
        let count = if reversible.contains(&joint) { 3 } else { 1 };
        (0..count).map(move |fault| match fault {
            0 => base.with_joint(joint, 1.0, Some(single.best_zero(1.0, true).0), 1.0),
            1 => base.with_joint(joint, -1.0, None, 1.0),
            _ => base.with_joint(joint, -1.0, Some(single.best_zero(-1.0, true).0), 2.0),
        })
    })
}

/// The first has its zero on a grid, forward or reversed.
fn two_joints(view: &InterpretedPoses, freedom: FreeFrames) -> Vec<JointProposal> {
    const ZERO_GRID_POINTS: u32 = 24;
    let thin = view.thinned(16);
    let dof = view.chain.dof();
    let none = JointProposal::new(view.as_logged(), 0.0);
    let can_move = moving_joints(view, &none.map);
    // Factor, zero, and price.
    let first_faults = |joint: usize| -> Vec<(f64, Option<f64>, f64)> {
        if view.chain.slides(joint) {
            return vec![(1e-3, None, 1.0), (-1.0, None, 1.0)];
        }
        let zeros = (1..ZERO_GRID_POINTS)
            .map(|step| Some(TAU * f64::from(step) / f64::from(ZERO_GRID_POINTS)));
        let mut faults = vec![(1f64.to_radians(), None, 1.0), (-1.0, None, 1.0)];
        faults.extend(zeros.flat_map(|zero| [(1.0, zero, 1.0), (-1.0, zero, 2.0)]));
        faults.retain(|(factor, ..)| *factor > 0.0 || can_move.contains(&joint));
        faults
    };
    let firsts: Vec<(usize, JointProposal)> = (0..dof)
        .flat_map(|joint| first_faults(joint).into_iter().map(move |fault| (joint, fault)))
        .map(|(joint, (factor, zero, price))| (joint, none.with_joint(joint, factor, zero, price)))
        .collect();
    let proposals: Vec<JointProposal> = firsts
        .into_par_iter()
        .flat_map_iter(|(first, base)| {
            let frames = thin.first_frames(&base.map, freedom);
            let seconds = (0..dof).filter(|&second| second != first).collect();
            let faults = with_joint_faults(&thin, &base, &frames, seconds, &can_move);
            faults.flatten().collect::<Vec<_>>()
        })
        .collect();
    best_proposals(&thin, proposals, freedom, REFINED_PROPOSALS)
}

fn order_and_one_joint(view: &InterpretedPoses, freedom: FreeFrames) -> Vec<JointProposal> {
    let thin = view.thinned(10);
    let none = view.as_logged();
    // One joint fewer than above, because each order is combined with each joint.
    let orders = candidate_orders(view.chain.joint_names(), MAX_PERMUTED_JOINTS - 1);
    let proposals = orders
        .into_par_iter()
        .filter(|order| *order != none.from)
        .flat_map_iter(|order| {
            let base = JointProposal::new(none.in_order(&order), ORDER_PRICE);
            let can_move = moving_joints(&thin, &base.map);
            let (frames, joints) = (ConstantFrames::default(), (0..view.chain.dof()).collect());
            let faults = with_joint_faults(&thin, &base, &frames, joints, &can_move);
            // Zero and direction of one joint are two causes.
            faults.flat_map(|faults| faults.take(2)).collect::<Vec<_>>()
        })
        .collect();
    best_proposals(&thin, proposals, freedom, REFINED_PROPOSALS)
}
