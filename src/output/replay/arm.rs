//! Draws an arm as capsules: between joints, and a thicker one on each revolute axis.

use re_sdk_types::archetypes::{Capsules3D, LineStrips3D};
use re_sdk_types::components::{Color, FillMode, Length, LineStrip3D, Radius, RotationQuat};

use super::scene::{
    ARM_RGB, JOINT_RGB, RECORDED_RGB, drawn_rows, positions, radius, rotation_component,
};
use super::timeline_writer::{TimelineWriter, entity_path};
use super::{ReplayArm, ReplayCause};
use crate::geometry::{Pose, Vec3, xyz_of};
use crate::robot::{JointKind, turn_z_to};
use crate::stream::JointTrack;

/// Radius, as a fraction of the arm's reach.
const LINK_RADIUS_RATIO: f64 = 0.018;
/// Radius, as a fraction of the arm's reach.
const JOINT_RADIUS_RATIO: f64 = 0.028;
/// Half length without ends, as a fraction of the arm's reach.
const JOINT_HALF_LENGTH_RATIO: f64 = 0.022;

/// From `start` along `along`, m, in the base frame.
struct Capsule {
    start: Vec3,
    along: Vec3,
}

/// Adds the entity `part` at the positions in `joints`.
pub(super) fn draw(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    part: &str,
    joints: &JointTrack,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let path = entity_path(&["arms", arm.name, part]);
    let (mut counts, mut capsules) = (Vec::new(), Vec::new());
    let kept = drawn_rows(joints);
    for &row in &kept {
        let frames = link_frames(arm, &positions(arm, joints, row));
        let before = capsules.len();
        capsules.extend(link_capsules(&frames));
        capsules.extend(joint_capsules(arm, &frames, JOINT_HALF_LENGTH_RATIO * size_m));
        counts.push(capsules.len() - before);
    }
    let links = arm.chain.dof() + 1;
    let style = |row: usize| {
        if row < links { (ARM_RGB, LINK_RADIUS_RATIO) } else { (JOINT_RGB, JOINT_RADIUS_RATIO) }
    };
    let styles = (0..counts.first().copied().unwrap_or(0)).map(style);
    let (rgb, radii): (Vec<Color>, Vec<Radius>) =
        styles.map(|(rgb, part)| (Color::from(rgb), radius(part * size_m))).unzip();
    let still = Capsules3D::update_fields()
        .with_colors(rgb)
        .with_radii(radii)
        .with_fill_mode(FillMode::Solid);
    writer.log_static(&path, &still)?;
    let lengths = capsules.iter().map(|it| Length::from(it.along.norm() as f32));
    let starts = capsules.iter().map(|it| <[f64; 3]>::from(it.start).map(|part| part as f32));
    let shapes = Capsules3D::update_fields()
        .with_lengths(lengths)
        .with_translations(starts)
        .with_quaternions(capsules.iter().map(Capsule::rotation));
    let times = writer.joint_times(arm, &kept);
    writer.log_columns(&path, &times, shapes.columns(counts)?)
}

/// A thin line from joint to joint.
pub(super) fn draw_thin(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    part: &str,
    joints: &JointTrack,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let path = entity_path(&["arms", arm.name, part]);
    let kept = drawn_rows(joints);
    let strips = kept.iter().map(|&row| {
        let frames = link_frames(arm, &positions(arm, joints, row));
        LineStrip3D::from_iter(frames.iter().map(xyz_of))
    });
    let strips = LineStrips3D::update_fields().with_strips(strips);
    let style = LineStrips3D::update_fields()
        .with_colors([RECORDED_RGB])
        .with_radii([radius(0.3 * LINK_RADIUS_RATIO * size_m)]);
    writer.log_static(&path, &style)?;
    let times = writer.joint_times(arm, &kept);
    writer.log_columns(&path, &times, strips.columns_of_unit_batches()?)
}

/// Base, links moved by joints, and tip, in the base frame.
fn link_frames(arm: &ReplayArm<'_>, q: &[f64]) -> Vec<Pose> {
    let mut moved = Vec::new();
    arm.chain.joint_frames(q, &mut moved);
    let tip = arm.chain.forward(q);
    std::iter::once(Pose::identity()).chain(moved).chain([tip]).collect()
}

fn link_capsules(frames: &[Pose]) -> impl Iterator<Item = Capsule> {
    frames.windows(2).map(|pair| {
        let start = pair[0].translation.vector;
        Capsule { start, along: pair[1].translation.vector - start }
    })
}

fn joint_capsules<'a>(
    arm: &'a ReplayArm<'_>,
    frames: &'a [Pose],
    half_m: f64,
) -> impl Iterator<Item = Capsule> + 'a {
    let joints = arm.chain.joint_names().iter().zip(&frames[1..]);
    let turning = joints.filter_map(|(name, frame)| Some((arm.robot.joint(name)?, frame)));
    let turning = turning.filter(|(joint, _)| joint.kind != JointKind::Prismatic);
    turning.map(move |(joint, frame)| {
        let half = frame.rotation * joint.axis * half_m;
        Capsule { start: frame.translation.vector - half, along: 2.0 * half }
    })
}

impl Capsule {
    /// Rotation from z to the capsule's axis.
    fn rotation(&self) -> RotationQuat {
        let along = self.along.try_normalize(1e-9).unwrap_or(Vec3::z());
        rotation_component(&turn_z_to(&along))
    }
}
