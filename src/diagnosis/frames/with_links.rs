//! Frames of an arm whose links deviate from its model.
//!
//! A fit without link deviations moves the frames until they explain a part of the deviations. So once the causes are
//! selected, the chosen frames are estimated again, together with link deviations within their prior. Frames that are not
//! chosen only deviate like links.

use crate::model::measurement::{twist_at, twist_lengths, twist_of};
use crate::priors::{LINK_PRIOR_M, LINK_PRIOR_RAD};
use crate::residuals::cause_columns::{CauseColumns, Frame};
use crate::{FrameEstimate, PoseDiagnosis, PoseStream};
use ground::geometry::Vec3;
use ground::stats::joint_p_value;
use nalgebra::{DMatrix, DVector};

/// Estimates the reference and the tool of `found` together with link deviations. `None` unless the frame is `free`, and
/// if the motion does not determine them.
pub(crate) fn frames_with_links(
    found: &PoseDiagnosis,
    stream: &PoseStream,
    free: [bool; 2],
) -> Option<[Option<FrameEstimate>; 2]> {
    if !free.contains(&true) || found.encoding.is_err() {
        return None;
    }
    let columns = CauseColumns::new(found, stream);
    let (linear, first) = columns.constant_fit();
    let mut normal = linear.normal(&first.weights);
    columns.add_prior(&mut normal);
    for (frame, _) in Frame::BOTH.into_iter().zip(free).filter(|it| !it.1) {
        for (axis, column) in frame.columns().enumerate() {
            let prior = if axis < 3 { LINK_PRIOR_M } else { LINK_PRIOR_RAD };
            normal.matrix[(column, column)] += prior.powi(-2);
        }
    }
    let covariance = normal.matrix.clone().cholesky()?.inverse();
    let step = &covariance * &normal.right;
    let dof = normal.dof(linear.width);
    let estimate = |(frame, is_free): (Frame, bool)| {
        let (before, about) = match frame {
            Frame::Reference => (&found.reference, columns.centre),
            Frame::Tool => (&found.tool, Vec3::zeros()),
        };
        let before = before.as_ref().ok().filter(|_| is_free)?;
        let moved =
            columns.motion(frame, &step.fixed_rows::<6>(frame.columns().start).into_owned());
        // The reported reference is the inverse of what maps base coordinates to the stream's.
        let pose = match frame {
            Frame::Reference => moved.inverse() * before.pose,
            Frame::Tool => moved * before.pose,
        };
        let lever = pose.translation.vector - about;
        let first = frame.columns().start;
        let own = covariance.fixed_view::<6, 6>(first, first);
        let own = twist_at(&lever) * own * twist_at(&lever).transpose();
        let twist = twist_of(&pose);
        let [translation_m, rotation_rad] = twist_lengths(&twist, &own, dof).map(|it| it.norm);
        let own = DMatrix::from_column_slice(6, 6, own.as_slice());
        let p_value = joint_p_value(&DVector::from_column_slice(&twist), &own, dof);
        Some(FrameEstimate { pose, translation_m, rotation_rad, p_value, ..before.clone() })
    };
    let [reference, tool] = Frame::BOTH;
    Some([(reference, free[0]), (tool, free[1])].map(estimate))
}

#[cfg(test)]
mod tests {
    use crate::diagnose_arm;
    use crate::test_motion::{arm, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use ground::geometry::{Pose, Rotation, Vec3, pose, rotation_from_rotvec};

    #[test]
    fn frames_of_an_arm_that_deviates_are_inside_their_intervals() {
        let (joints, chain) = arm();
        let deviating = deviating_chain(4e-4);
        let shift = Vec3::new(0.01, -0.02, 0.005);
        let turn = rotation_from_rotvec(Vec3::new(0.0, 0.02, 0.01));
        let base = pose(shift.into(), Rotation::identity());
        let tool = pose(shift.into(), turn);
        for (reference, tool) in [(base, Pose::identity()), (Pose::identity(), tool)] {
            let mut random = Lcg::new();
            let poses = joints.q.chunks(6).map(|q| reference * deviating.forward(q) * tool);
            let noisy = |pose: Pose| {
                (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
            };
            let track = pose_track(&joints.t_s, poses.map(noisy));
            let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
            let stream = &found.streams[0];
            assert!(stream.is_nominal);
            let is_of_base = tool == Pose::identity();
            let frame = if is_of_base { &stream.reference } else { &stream.tool };
            let frame = frame.as_ref().expect("a frame");
            assert!(frame.is_chosen);
            for (truth, measured) in
                [(shift.norm(), &frame.translation_m), (tool.rotation.angle(), &frame.rotation_rad)]
            {
                let off = (measured.value - truth).abs();
                assert!(off < measured.half_width(0.99), "{is_of_base}: {truth} {measured:?}");
                assert!(measured.half_width(0.95) < 4e-3, "{is_of_base}: {measured:?}");
            }
        }
    }
}
