use super::beside_links::BesideLinks;
use super::fit::ArmFit;
use crate::encodings::decoded_stream::DecodedStream;
use crate::joints::{CorrectedJoints, half_turns};
use crate::model::observability::travel;
use crate::selection::held_out::HeldOut;
use crate::selection::model_selection::Cause;
use crate::{Confounder, JointCoupling, JointOffset, JointScale, Measured, NotObservable};
use ground::geometry::Vec3;
use ground::robot::JointKind;
use std::f64::consts::TAU;

pub(super) fn unobservable_offsets(dof: usize, why: &NotObservable) -> Vec<JointOffset> {
    let offset = JointOffset {
        offset: Err(why.clone()),
        is_chosen: false,
        effect_m: 0.0,
        lever_m: 0.0,
        confounders: Vec::new(),
        held_out: None,
    };
    vec![offset; dof]
}

/// Selected offsets are estimated with the selected causes free, the others with all joints free.
pub(super) fn joint_offsets(
    fitted: &ArmFit,
    decoded: &[&DecodedStream],
    corrected: &CorrectedJoints,
    held_out: &HeldOut,
    beside_links: &BesideLinks,
) -> Vec<JointOffset> {
    let ArmFit { model, candidates, .. } = fitted;
    let joints = &corrected.track;
    // By more than 3° (or 50 mm).
    let moved: Vec<bool> = (0..joints.dof).map(|joint| travel(joints, joint) > 0.05).collect();
    let several_moved = moved.iter().filter(|moved| **moved).count() > 1;
    let is_zero = |cause: &Cause| matches!(cause, Cause::Zero(_));
    let zeros: Vec<Cause> = candidates.optional.iter().copied().filter(is_zero).collect();
    let levers_m = levers_m(decoded, joints.dof);
    let all_zeros: Vec<Cause> = model.causes.iter().copied().chain(zeros.iter().copied()).collect();
    (0..joints.dof)
        .map(|joint| {
            let cause = Cause::Zero(joint);
            let deviations = fitted.deviations.as_ref();
            let deviation_confounders =
                deviations.and_then(|deviations| deviations.confounders(joint));
            let held_out_residual = held_out.of(cause);
            let chosen = (model.causes.contains(&cause)
                && held_out_residual.is_none_or(|residual| residual.is_lower()))
                || deviation_confounders.is_some();
            let deviation_zero = deviations.map(|deviations| deviations.zeros[joint]);
            let is_excited = zeros.contains(&cause) && (chosen || (moved[joint] && several_moved));
            let causes = if chosen { &model.causes } else { &all_zeros };
            let offset = match deviation_zero {
                Some(zero) => zero.ok_or(NotObservable::NominalKinematics),
                None if is_excited => {
                    fitted.measured(causes, cause).map(|zero| beside_links.widen(cause, zero))
                }
                None => Err(NotObservable::NotExcited),
            };
            let mut all_confounders =
                if chosen { fitted.confounders(cause) } else { fitted.frame_confounders(cause) };
            all_confounders.extend_from_slice(deviation_confounders.unwrap_or_default());
            if let (true, Ok(zero)) = (chosen, &offset) {
                let of_frame = frame_of_end(decoded, joint, zero.value.abs());
                let is_new = |frame: &Confounder| {
                    !all_confounders.iter().any(|known| known.is_same_frame(frame))
                };
                all_confounders.extend(of_frame.filter(is_new));
            }
            let is_slide = corrected.is_prismatic[joint];
            let turns = |value: f64| if is_slide { 0.0 } else { TAU * half_turns(value) };
            let within_a_turn =
                |offset: Measured| Measured { value: offset.value - turns(offset.value), ..offset };
            let offset = offset.map(within_a_turn);
            let amount = offset.as_ref().map_or(0.0, |offset| offset.value.abs());
            let chord = if is_slide { amount } else { 2.0 * (0.5 * amount).sin() };
            let lever_m = levers_m[joint];
            JointOffset {
                offset,
                is_chosen: chosen,
                effect_m: chord * lever_m,
                lever_m,
                confounders: all_confounders,
                held_out: held_out_residual,
            }
        })
        .collect()
}

/// Frame that turns the poses like a zero of this size of the first or last joint. With several streams, no frame turns all.
fn frame_of_end(decoded: &[&DecodedStream], column: usize, size: f64) -> Option<Confounder> {
    let [DecodedStream { observations, .. }] = decoded else { return None };
    if !observations.reference_known {
        return None;
    }
    match observations.columns.iter().position(|own| *own == column)? {
        0 => Some(Confounder::Reference(0, size)),
        joint if joint + 1 == observations.columns.len() => Some(Confounder::Tool(0, size)),
        _ => None,
    }
}

/// Refined scales and couplings.
pub(super) fn joint_gains(
    fitted: &ArmFit,
    corrected: &CorrectedJoints,
) -> (Vec<JointScale>, Vec<JointCoupling>) {
    let model = &fitted.model;
    let (mut scales, mut couplings) = (Vec::new(), Vec::new());
    for (at, &(column, by)) in corrected.gains.iter().enumerate() {
        let cause = Cause::JointScale(corrected.track.dof + at);
        let Ok(gain) = fitted.measured(&model.causes, cause) else { continue };
        let is_own = |own: &&JointCoupling| (own.column, own.by) == (column, by);
        if column == by {
            let encoded = corrected.encoding.factor(column);
            let factor = Measured { value: 1.0 + gain.value, ..gain }.scaled(encoded);
            let has_zero = fitted.is_free(Cause::Zero(column));
            let offset = if has_zero { model.state.offsets[column] } else { 0.0 };
            scales.push(JointScale { column, factor, offset });
        } else if let Some(encoded) = corrected.encoding.couplings.iter().find(is_own) {
            let factor = Measured { value: encoded.factor.value + gain.value, ..gain };
            couplings.push(JointCoupling { column, by, factor });
        }
    }
    (scales, couplings)
}

/// Largest distance of each joint's axis from the tip, m/rad (1 if prismatic), over evenly spread joint positions (Halton
/// 1960).
fn levers_m(decoded: &[&DecodedStream], dof: usize) -> Vec<f64> {
    const CONFIGURATIONS: u32 = 500;
    const HALTON_BASES: [u32; 10] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29];
    let mut levers_m = vec![0.0_f64; dof];
    for DecodedStream { observations, .. } in decoded {
        let (chain, kinds) = (observations.chain, observations.chain.joint_kinds());
        let mut jacobian = vec![[0.0; 6]; chain.dof()];
        for index in 1..=CONFIGURATIONS {
            let at = |(j, kind): (usize, &JointKind)| match kind {
                JointKind::Prismatic => 0.0,
                _ => TAU * (radical_inverse(index, HALTON_BASES[j % HALTON_BASES.len()]) - 0.5),
            };
            let q: Vec<f64> = kinds.iter().enumerate().map(at).collect();
            chain.forward_with_jacobian(&q, &mut jacobian);
            for ((&column, kind), [x, y, z, ..]) in
                observations.columns.iter().zip(kinds).zip(&jacobian)
            {
                let lever_m = match kind {
                    JointKind::Prismatic => 1.0,
                    _ => Vec3::new(*x, *y, *z).norm(),
                };
                levers_m[column] = levers_m[column].max(lever_m);
            }
        }
    }
    levers_m
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
