//! Fits constant transforms between pairs of poses.

use super::reconciliation::MAX_AGREEING_RAD;
use crate::geometry::{
    Pose, Rotation, angle_between, mean_vector, rotation_by_wahba, rotation_from_rotvec,
    rotvec_from_rotation,
};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Largest angle between two pairs' transforms, rad.
const MAX_PAIR_ANGLE_RAD: f64 = 20.0 * MAX_AGREEING_RAD;

/// Poses to fit base and tool: 1.5 times as many values as unknowns.
const MIN_POSES: usize = 3;

/// Smallest rotation that defines an axis, rad.
const MIN_ROTATION_RAD: f64 = 0.05;

/// `before_from_after` in `after = before · tip`.
pub(super) fn fit_tip(before: &[Pose], after: &[Pose]) -> Option<Pose> {
    mean_pose(before.iter().zip(after).map(|(before, after)| before.inverse() * after).collect())
}

/// `after_from_before` in `after = base · before`.
pub(super) fn fit_base(before: &[Pose], after: &[Pose]) -> Option<Pose> {
    mean_pose(before.iter().zip(after).map(|(before, after)| after * before.inverse()).collect())
}

fn mean_pose(poses: Vec<Pose>) -> Option<Pose> {
    let mut rotation = poses.first()?.rotation;
    if poses.iter().any(|pose| angle_between(&pose.rotation, &rotation) > MAX_PAIR_ANGLE_RAD) {
        return None;
    }
    for _ in 0..5 {
        let away = |pose: &Pose| rotvec_from_rotation(&(rotation.inverse() * pose.rotation));
        let mean = mean_vector(poses.iter().map(away));
        rotation *= rotation_from_rotvec(mean);
    }
    let xyz = mean_vector(poses.iter().map(|pose| pose.translation.vector));
    Some(crate::geometry::pose(xyz.into(), rotation))
}

/// Fits `after = base · before · tip`. `None` for too few pairs, a single axis, or no constant solution.
///
/// Rotations follow Park and Martin (*Robot sensor calibration: solving AX = XB on the Euclidean group*,
/// IEEE Trans. Robotics and Automation 10, 1994), translations from least squares.
pub(super) fn fit_base_and_tip(before: &[Pose], after: &[Pose]) -> Option<(Pose, Pose)> {
    if before.len() < MIN_POSES {
        return None;
    }
    let turn = |poses: &[Pose], at: usize| {
        rotvec_from_rotation(&(poses[0].rotation.inverse() * poses[at].rotation))
    };
    let mut moment = Matrix3::zeros();
    let mut axes = Matrix3::zeros();
    for at in 1..before.len() {
        let [a, b] = [turn(before, at), turn(after, at)];
        if (a.norm() - b.norm()).abs() > MAX_PAIR_ANGLE_RAD {
            return None;
        }
        // The axis of a half turn is ambiguous in sign.
        if a.norm() > MIN_ROTATION_RAD && a.norm() < std::f64::consts::PI - MIN_ROTATION_RAD {
            moment += a * b.transpose();
            axes += a.normalize() * a.normalize().transpose();
        }
    }
    let spread = axes.symmetric_eigenvalues();
    let [_, second, _] = sorted([spread.x, spread.y, spread.z]);
    if second < 0.05 {
        return None;
    }
    let tip_rotation = rotation_by_wahba(&moment);
    let base_rotation = fit_base(
        &before.iter().map(|pose| pure_rotation(pose.rotation * tip_rotation)).collect::<Vec<_>>(),
        &after.iter().map(|pose| pure_rotation(pose.rotation)).collect::<Vec<_>>(),
    )?
    .rotation;
    // t_after = R_base t_before + R_base R_before t_tip + t_base.
    let mut matrix = DMatrix::zeros(3 * before.len(), 6);
    let mut right = DVector::zeros(3 * before.len());
    for (at, (before, after)) in before.iter().zip(after).enumerate() {
        let rotation = (base_rotation * before.rotation).to_rotation_matrix();
        matrix.fixed_view_mut::<3, 3>(3 * at, 0).copy_from(rotation.matrix());
        matrix.fixed_view_mut::<3, 3>(3 * at, 3).copy_from(&Matrix3::identity());
        let left = after.translation.vector - base_rotation * before.translation.vector;
        right.fixed_rows_mut::<3>(3 * at).copy_from(&left);
    }
    let found = matrix.svd(true, true).solve(&right, 1e-9).ok()?;
    let part = |at: usize| [found[at], found[at + 1], found[at + 2]];
    let [tip, base] = [(part(0), tip_rotation), (part(3), base_rotation)];
    Some((crate::geometry::pose(base.0, base.1), crate::geometry::pose(tip.0, tip.1)))
}

fn pure_rotation(rotation: Rotation) -> Pose {
    crate::geometry::pose([0.0; 3], rotation)
}

fn sorted(mut values: [f64; 3]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Vec3, pose};
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Vec<Pose>> {
        let numbers = proptest::array::uniform6(-1.0..1.0_f64);
        proptest::collection::vec(numbers, 6..12).prop_map(|all| {
            let pose_of = |[x, y, z, a, b, c]: [f64; 6]| {
                pose([x, y, z], rotation_from_rotvec(Vec3::new(a, b, c) * 1.5))
            };
            all.into_iter().map(pose_of).collect()
        })
    }

    proptest! {
        #[test]
        fn offsets_at_both_ends_are_recovered(all in poses()) {
            let (base_pose, tip_pose, before) = (all[0], all[1], &all[2..]);
            let after: Vec<Pose> = before.iter().map(|is| base_pose * is * tip_pose).collect();
            let Some((base, tip)) = fit_base_and_tip(before, &after) else { return Ok(()) };
            for (found, planted) in [(base, base_pose), (tip, tip_pose)] {
                prop_assert!(angle_between(&found.rotation, &planted.rotation) < 1e-6);
                prop_assert!((found.translation.vector - planted.translation.vector).norm() < 1e-6);
            }
        }
    }
}
