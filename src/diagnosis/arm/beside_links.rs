//! Widens standard errors by link deviations, which noise may hide.

use super::fit::ArmFit;
use crate::encodings::decoded_stream::DecodedStream;
use crate::model::measurement::{twist_at, twist_lengths, twist_of};
use crate::selection::deviation_model::DeviationModel;
use crate::selection::model_selection::Cause;
use crate::{FrameEstimate, Measured};
use ground::geometry::Vec3;
use ground::robot::Chain;
use nalgebra::Matrix6;
use std::collections::BTreeMap;

/// Errors of zeros, radial scales and frames. The selected causes are free; a zero or radial scale that is not selected is
/// free as well, together with all zeros. Excludes zeros that were fitted with link deviations.
#[derive(Default)]
pub(super) struct BesideLinks {
    /// Of the stream with the smallest.
    std_errors: BTreeMap<Cause, f64>,
    /// Covariances of a twist after a reference, and of a twist before a tool.
    frames: BTreeMap<Cause, Matrix6<f64>>,
}

impl BesideLinks {
    pub fn new(fitted: &ArmFit, decoded: &[&DecodedStream]) -> Self {
        let mut beside = Self::default();
        let (selected, optional) = (&fitted.model.causes, &fitted.candidates.optional);
        let is_scale = |cause: &Cause| matches!(cause, Cause::RadialScale(_));
        let is_nominal = fitted.deviations.is_some();
        if is_nominal && !selected.iter().any(is_scale) {
            return beside;
        }
        let with = |others: &dyn Fn(&Cause) -> bool| -> Vec<Cause> {
            let others = optional.iter().filter(|cause| others(cause) && !selected.contains(cause));
            selected.iter().chain(others).copied().collect()
        };
        let zeros = with(&|cause| matches!(cause, Cause::Zero(_)));
        let state = fitted.exact_state();
        for (index, decoded) in decoded.iter().enumerate() {
            if decoded.observations.chain.is_floating() {
                continue;
            }
            let scale = with(&|cause| *cause == Cause::RadialScale(index));
            let at = decoded.observations.in_state(&state, index);
            let Some(model) = DeviationModel::linearize(at, index) else { continue };
            let (_, fits) = model.fits_by_size(selected);
            if !is_nominal {
                let [reference, last_link] = model.frame_covariances(&fits);
                let tool = last_link.map(|of_link| of_tool(decoded.observations.chain, &of_link));
                beside.frames.extend(reference.map(|own| (Cause::Reference(index), own)));
                beside.frames.extend(tool.map(|own| (Cause::Tool(index), own)));
            }
            let others = [&zeros, &scale]
                .into_iter()
                .flat_map(|causes| model.std_errors(causes, &model.fits_by_size(causes).1));
            let others = others.filter(|(cause, _)| !selected.contains(cause));
            let found = model.std_errors(selected, &fits).into_iter().chain(others);
            for (cause, std_error) in found.filter(|(cause, _)| !is_nominal || is_scale(cause)) {
                let own = beside.std_errors.entry(cause).or_insert(std_error);
                *own = own.min(std_error);
            }
        }
        beside
    }

    /// A reference or tool, with the larger standard errors.
    pub fn widen_frame(&self, cause: Cause, found: FrameEstimate) -> FrameEstimate {
        let Some(of_twist) = self.frames.get(&cause) else { return found };
        // In the axes of the reference, the stream's translation is the opposite of the reported one.
        let lever = match cause {
            Cause::Tool(_) => found.pose.translation.vector,
            _ => Vec3::zeros(),
        };
        let covariance = twist_at(&lever) * of_twist * twist_at(&lever).transpose();
        let dof = found.translation_m.dof;
        let [m, rad] =
            twist_lengths(&twist_of(&found.pose), &covariance, dof).map(|length| length.norm);
        let widen = |own: Measured, other: Measured| Measured {
            std_error: own.std_error.max(other.std_error),
            ..own
        };
        FrameEstimate {
            translation_m: widen(found.translation_m, m),
            rotation_rad: widen(found.rotation_rad, rad),
            ..found
        }
    }

    /// `measured`, with the larger standard error.
    pub fn widen(&self, cause: Cause, measured: Measured) -> Measured {
        let own = self.std_errors.get(&cause).unwrap_or(&0.0);
        Measured { std_error: own.max(measured.std_error), ..measured }
    }
}

/// Transforms the covariance of a twist from the last joint's link to the tip.
fn of_tool(chain: &Chain, of_link: &Matrix6<f64>) -> Matrix6<f64> {
    let link_from_tip = chain.last_from_tip();
    let turn = link_from_tip.rotation.inverse().to_rotation_matrix();
    let mut turned = Matrix6::zeros();
    turned.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
    turned.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
    let by_link = turned * twist_at(&link_from_tip.translation.vector);
    by_link * of_link * by_link.transpose()
}

#[cfg(test)]
mod tests {
    use crate::diagnose_arm;
    use crate::test_motion::{arm, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};

    #[test]
    fn frames_are_as_inaccurate_as_the_links() {
        let (joints, chain) = arm();
        let shift = Vec3::new(0.03, -0.02, 0.1);
        let turn = rotation_from_rotvec(Vec3::new(0.2, 0.1, -0.3));
        let tools = [Rotation::identity(), turn].map(|turn| pose(shift.into(), turn));
        for link_m in [3e-5, 1e-4] {
            let deviating = deviating_chain(link_m);
            for tool in tools {
                let mut random = Lcg::new();
                let noisy = |q: &[f64]| {
                    let pose = deviating.forward(q) * tool;
                    (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
                };
                let track = pose_track(&joints.t_s, joints.q.chunks(6).map(noisy));
                let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
                let found = found.streams[0].tool.as_ref().expect("a tool");
                let off = Pose::inv_mul(&found.pose, &tool).translation.vector.norm();
                let std_error = found.translation_m.std_error;
                assert!(off < 5.0 * std_error, "{link_m}: off by {off}, {found:?}");
                assert!((0.3..5.0).contains(&(std_error / link_m)), "{link_m}: {found:?}");
            }
        }
    }
}
