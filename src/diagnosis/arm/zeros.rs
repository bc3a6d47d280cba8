use super::confounders::{confounders, frame_confounders, measured};
use super::fit::ArmFit;
use crate::encodings::decoded_stream::DecodedStream;
use crate::joints::{CorrectedJoints, half_turns};
use crate::selection::model_selection::Cause;
use crate::{JointCoupling, JointOffset, JointScale, Measured, NotObservable};
use ground::geometry::Vec3;
use ground::robot::JointKind;
use ground::stream::JointTrack;
use std::f64::consts::TAU;

pub(super) fn unobservable_offsets(dof: usize, why: &NotObservable) -> Vec<JointOffset> {
    let offset = || JointOffset {
        offset: Err(why.clone()),
        is_chosen: false,
        effect_m: 0.0,
        lever_m: 0.0,
        confounders: Vec::new(),
    };
    (0..dof).map(|_| offset()).collect()
}

/// Selected offsets are estimated with the selected causes free, the others with all joints free.
pub(super) fn joint_offsets(
    fitted: &ArmFit,
    prepared: &[&DecodedStream],
    joints: &JointTrack,
) -> Vec<JointOffset> {
    let ArmFit { model: explanation, candidates: menu, .. } = fitted;
    let moved = moved_joints(joints);
    let zeros: Vec<Cause> =
        menu.optional.iter().copied().filter(|cause| matches!(cause, Cause::Zero(_))).collect();
    let everyone: Vec<Cause> =
        explanation.causes.iter().copied().chain(zeros.iter().copied()).collect();
    (0..joints.dof)
        .map(|joint| {
            let cause = Cause::Zero(joint);
            let drawing = fitted.deviations.as_ref();
            let instead = drawing.and_then(|drawing| drawing.confounders(joint));
            let chosen = explanation.causes.contains(&cause) || instead.is_some();
            let beside = drawing.map(|drawing| drawing.zeros[joint]);
            let offset = if let Some(zero) = beside {
                zero.ok_or(NotObservable::NominalKinematics)
            } else if !zeros.contains(&cause) {
                Err(NotObservable::NotExcited)
            } else if chosen {
                measured(fitted, &explanation.causes, cause, 0)
            } else if !moved[joint] || moved.iter().filter(|m| **m).count() < 2 {
                Err(NotObservable::NotExcited)
            } else {
                measured(fitted, &everyone, cause, 0)
            };
            let mut twins =
                if chosen { confounders(fitted, cause) } else { frame_confounders(fitted, cause) };
            twins.extend_from_slice(instead.unwrap_or_default());
            let slides = is_prismatic(prepared, joint);
            let within_a_turn = |offset: Measured| match slides {
                true => offset,
                false => {
                    Measured { value: offset.value - TAU * half_turns(offset.value), ..offset }
                }
            };
            let offset = offset.map(within_a_turn);
            let amount = offset.as_ref().map_or(0.0, |offset| offset.value.abs());
            let chord = if slides { amount } else { 2.0 * (0.5 * amount).sin() };
            let lever_m = lever_m(prepared, joint);
            JointOffset {
                offset,
                is_chosen: chosen,
                effect_m: chord * lever_m,
                lever_m,
                confounders: twins,
            }
        })
        .collect()
}

fn is_prismatic(prepared: &[&DecodedStream], joint: usize) -> bool {
    prepared.iter().any(|DecodedStream { observations: witness, .. }| {
        let own = witness.columns.iter().position(|&column| column == joint);
        own.is_some_and(|own| witness.chain.joint_kinds()[own] == JointKind::Prismatic)
    })
}

pub(super) fn joint_scales(fitted: &ArmFit, read: &CorrectedJoints) -> Vec<JointScale> {
    let explanation = &fitted.model;
    let scale = |(at, &(column, by)): (usize, &(usize, usize))| {
        if by != column {
            return None;
        }
        let about = read.factors[column];
        let gain = gain(fitted, read, at)?;
        let factor = Measured {
            value: about * (1.0 + gain.value),
            std_error: about.abs() * gain.std_error,
            ..gain
        };
        let zero = Cause::Zero(column);
        let is_off = explanation.causes.contains(&zero) || fitted.candidates.always.contains(&zero);
        let offset = if is_off { explanation.state.offsets[column] } else { 0.0 };
        Some(JointScale { column, factor, offset })
    };
    read.gains.iter().enumerate().filter_map(scale).collect()
}

pub(super) fn joint_couplings(fitted: &ArmFit, read: &CorrectedJoints) -> Vec<JointCoupling> {
    let coupling = |(at, &(column, by)): (usize, &(usize, usize))| {
        let about = read.couplings.iter().find(|own| (own.column, own.by) == (column, by))?;
        let gain = gain(fitted, read, at)?;
        let factor = Measured { value: about.factor.value + gain.value, ..gain };
        Some(JointCoupling { column, by, factor })
    };
    read.gains.iter().enumerate().filter_map(coupling).collect()
}

/// Entry `at` of [`CorrectedJoints::gains`], relative to the encoding.
fn gain(fitted: &ArmFit, read: &CorrectedJoints, at: usize) -> Option<Measured> {
    measured(fitted, &fitted.model.causes, Cause::JointScale(read.track.dof + at), 0).ok()
}

/// Joints that move by more than 3° (or 50 mm).
fn moved_joints(joints: &JointTrack) -> Vec<bool> {
    (0..joints.dof)
        .map(|j| {
            let column = || joints.q.iter().skip(j).step_by(joints.dof);
            let low = column().copied().fold(f64::INFINITY, f64::min);
            let high = column().copied().fold(f64::NEG_INFINITY, f64::max);
            high - low > 0.05
        })
        .collect()
}

/// Largest distance from axis to tip, m/rad (1 if prismatic), over evenly spread joint positions (Halton
/// 1960).
fn lever_m(prepared: &[&DecodedStream], joint: usize) -> f64 {
    const CONFIGURATIONS: u32 = 500;
    const HALTON_BASES: [u32; 10] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29];
    let lever = |prepared: &&DecodedStream| {
        let own = prepared.observations.columns.iter().position(|&column| column == joint)?;
        let chain = prepared.observations.chain;
        let kinds = chain.joint_kinds();
        if kinds[own] == JointKind::Prismatic {
            return Some(1.0);
        }
        let mut jacobian = vec![[0.0; 6]; chain.dof()];
        let levers = (1..=CONFIGURATIONS).map(|index| {
            let at = |(j, kind): (usize, &JointKind)| match kind {
                JointKind::Prismatic => 0.0,
                _ => TAU * (radical_inverse(index, HALTON_BASES[j % HALTON_BASES.len()]) - 0.5),
            };
            let q: Vec<f64> = kinds.iter().enumerate().map(at).collect();
            chain.forward_with_jacobian(&q, &mut jacobian);
            let [x, y, z, ..] = jacobian[own];
            Vec3::new(x, y, z).norm()
        });
        Some(levers.fold(0.0, f64::max))
    };
    prepared.iter().filter_map(lever).fold(0.0, f64::max)
}

/// Digits of `index` in `base`, mirrored at the point, in [0, 1).
fn radical_inverse(mut index: u32, base: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
    while index > 0 {
        value += f64::from(index % base) * digit;
        index /= base;
        digit /= f64::from(base);
    }
    value
}
