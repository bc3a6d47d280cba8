//! Space of an arm: colours, transforms and camera.

use re_log_types::EntityPath;
use re_sdk_types::archetypes::Transform3D;
use re_sdk_types::components::{Radius, RotationQuat, TransformFrameId};
use re_sdk_types::datatypes::Quaternion;

use super::timeline_writer::entity_path;
use super::{MAX_ROWS, ReplayArm};
use crate::geometry::{Pose, Rotation, Vec3, xyz_of, xyzw_from_rotation};
use crate::stats::thin;
use crate::stream::JointTrack;

pub(super) const ARM_RGB: [u8; 3] = [205, 210, 220];
pub(super) const JOINT_RGB: [u8; 3] = [92, 122, 158];
pub(super) const RECORDED_RGB: [u8; 3] = [110, 115, 125];

/// Everything drawn for an arm, in the base of the chain.
pub(super) fn arm_root(arm: &str) -> EntityPath {
    entity_path(&["arms", arm])
}

/// Places the space of an arm in the frame of its base, as the log's transforms name it.
pub(super) fn connection_to_log(root: &EntityPath, base: &str) -> Transform3D {
    Transform3D::update_fields()
        .with_child_frame(TransformFrameId::from_entity_path(root))
        .with_parent_frame(TransformFrameId::new(base))
}

pub(super) fn drawn_rows(joints: &JointTrack) -> Vec<usize> {
    thin::even_rows(joints.len(), MAX_ROWS)
}

pub(super) fn positions(arm: &ReplayArm<'_>, joints: &JointTrack, row: usize) -> Vec<f64> {
    joints.positions_at(row, arm.columns)
}

/// Bounding sphere of the motion in the base frame: centre and radius, m.
pub(super) fn bounding_sphere(arm: &ReplayArm<'_>) -> (Vec3, f64) {
    /// More rows barely change the result.
    const MAX_ROWS: usize = 200;
    let (mut low, mut high) = (Vec3::zeros(), Vec3::zeros());
    let mut frames = Vec::new();
    for row in thin::even_rows(arm.corrected.len(), MAX_ROWS) {
        let q = positions(arm, &arm.corrected, row);
        arm.chain.joint_frames(&q, &mut frames);
        frames.push(arm.chain.forward(&q));
        for frame in &frames {
            low = low.inf(&frame.translation.vector);
            high = high.sup(&frame.translation.vector);
        }
    }
    ((low + high) / 2.0, ((high - low).norm() / 2.0).max(0.1 * arm.chain.max_reach_m()))
}

pub(super) fn static_transform(pose: &Pose) -> Transform3D {
    let rotation = rotation_component(&pose.rotation);
    Transform3D::update_fields().with_translation(xyz_of(pose)).with_quaternion(rotation)
}

pub(super) fn transforms(poses: &[Pose]) -> Transform3D {
    Transform3D::update_fields()
        .with_many_translation(poses.iter().map(xyz_of))
        .with_many_quaternion(poses.iter().map(|pose| rotation_component(&pose.rotation)))
}

pub(super) fn rotation_component(rotation: &Rotation) -> RotationQuat {
    let xyzw = xyzw_from_rotation(rotation);
    RotationQuat(Quaternion::from_xyzw(xyzw.map(|component| component as f32)))
}

pub(super) fn radius(radius_m: f64) -> Radius {
    Radius::new_scene_units(radius_m as f32)
}
