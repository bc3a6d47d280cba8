//! The arm, and the tool where each stream says that it is.

use re_sdk_types::archetypes::{
    Boxes3D, LineStrips3D, Points3D, Transform3D, TransformAxes3D, ViewCoordinates,
};
use re_sdk_types::components::{FillMode, LineStrip3D, Radius, RotationQuat};
use re_sdk_types::datatypes::Quaternion;
use rerun::EntityPath;

use super::tape::{Tape, entity};
use super::{MOST_ROWS, ReplayArm, ReplayCause, ReplayStream, State, StreamKind};
use crate::geometry::{Pose, xyz_of, xyzw_from_rotation};
use crate::stream::JointTrack;
use crate::tables::{self, Posed, thin};

const ARM_RGB: [u8; 3] = [205, 210, 220];
const RECORDED_RGB: [u8; 3] = [110, 115, 125];

/// The entity above all that is drawn of an arm; its space is the base of the chain.
pub(super) fn root(arm: &str) -> EntityPath {
    entity(&["arms", arm])
}

/// Adds an arm and its streams.
pub(super) fn draw(tape: &Tape, arm: &ReplayArm<'_>) -> Result<(), ReplayCause> {
    let size_m = arm.chain.max_reach_m();
    tape.still(&root(arm.name), &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    let shape = Skeleton { part: "arm", rgb: ARM_RGB, radius_m: 0.014 * size_m };
    shape.draw(tape, arm, &arm.corrected)?;
    if arm.corrected.q != arm.recorded.q {
        let shape =
            Skeleton { part: "arm_as_recorded", rgb: RECORDED_RGB, radius_m: 0.004 * size_m };
        shape.draw(tape, arm, arm.recorded)?;
    }
    tip(tape, arm, size_m)?;
    for stream in &arm.streams {
        tools(tape, arm, stream, size_m)?;
    }
    Ok(())
}

/// The arm as a line through the origins of its links.
struct Skeleton {
    part: &'static str,
    rgb: [u8; 3],
    radius_m: f64,
}

impl Skeleton {
    fn draw(
        &self,
        tape: &Tape,
        arm: &ReplayArm<'_>,
        joints: &JointTrack,
    ) -> Result<(), ReplayCause> {
        let mut stamps_ns = Vec::new();
        let mut strips: Vec<Vec<[f64; 3]>> = Vec::new();
        let mut links = Vec::new();
        for (t_s, q) in rows(arm, joints) {
            arm.chain.joint_frames(&q, &mut links);
            links.push(arm.chain.forward(&q));
            stamps_ns.push(tape.stamp_ns(t_s));
            strips.push(std::iter::once([0.0; 3]).chain(links.iter().map(xyz_of)).collect());
        }
        let path = entity(&["arms", arm.name, self.part]);
        let lengths: Vec<usize> = strips.iter().map(Vec::len).collect();
        let knots = Points3D::update_fields().with_positions(strips.iter().flatten().copied());
        let bones = strips.iter().map(|strip| LineStrip3D::from_iter(strip.iter().copied()));
        let bones = LineStrips3D::update_fields().with_strips(bones);
        let style = LineStrips3D::update_fields()
            .with_colors([self.rgb])
            .with_radii([radius(self.radius_m)]);
        tape.still(&path, &style)?;
        let style = Points3D::update_fields()
            .with_colors([self.rgb])
            .with_radii([radius(1.6 * self.radius_m)]);
        tape.still(&path, &style)?;
        tape.columns(&path, &stamps_ns, bones.columns_of_unit_batches()?)?;
        tape.columns(&path, &stamps_ns, knots.columns(lengths)?)?;
        Ok(())
    }
}

/// The frame at the end of the arm.
fn tip(tape: &Tape, arm: &ReplayArm<'_>, size_m: f64) -> Result<(), ReplayCause> {
    let mut moved = Moved::default();
    for (t_s, q) in rows(arm, &arm.corrected) {
        let base_from_tip = arm.chain.forward(&q);
        moved.stamps_ns.push(tape.stamp_ns(t_s));
        moved.xyz.push(xyz_of(&base_from_tip));
        moved.xyzw.push(xyzw_from_rotation(&base_from_tip.rotation));
    }
    let tool = Tool {
        label: arm.chain.tip_name(),
        is_named: false,
        rgb: ARM_RGB,
        fill: FillMode::MajorWireframe,
    };
    tool.draw(tape, &entity(&["arms", arm.name, "tip"]), &moved, size_m)
}

/// The tool as a stream says it is, and the paths that it takes.
fn tools(
    tape: &Tape,
    arm: &ReplayArm<'_>,
    stream: &ReplayStream<'_>,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let reference = entity(&["arms", arm.name, stream.topic]);
    tape.still(&reference, &still(&stream.base_from_reference))?;
    for state in State::drawn(stream) {
        let moved = match state {
            State::Logged => Moved::of(stream, Posed::Logged, 0.0)?,
            State::Explained => Moved::of(stream, Posed::Corrected, stream.latency_s)?,
        };
        let rgb = state.rgb(stream.kind);
        let fill = match (stream.kind, state) {
            (StreamKind::Tf, _) => FillMode::MajorWireframe,
            (StreamKind::Pose, State::Logged) => FillMode::Solid,
            (StreamKind::Pose, State::Explained) => FillMode::TransparentFillMajorWireframe,
        };
        let is_named = stream.kind == StreamKind::Pose;
        let tool = Tool { label: &arm.label(stream, state), is_named, rgb, fill };
        tool.draw(tape, &reference.join(&entity(&[state.entity()])), &moved, size_m)?;
        if stream.kind == StreamKind::Pose {
            let path = reference.join(&entity(&[&format!("{}_trail", state.entity())]));
            trail(tape, &path, &moved.xyz, rgb)?;
        }
    }
    if stream.kind == StreamKind::Tf {
        return Ok(());
    }
    let by_fk = Moved::of(stream, Posed::Fk, 0.0)?;
    trail(tape, &reference.join(&entity(&["fk_trail"])), &by_fk.xyz, RECORDED_RGB)
}

/// A frame that moves.
#[derive(Default)]
struct Moved {
    stamps_ns: Vec<i64>,
    xyz: Vec<[f64; 3]>,
    xyzw: Vec<[f64; 4]>,
}

impl Moved {
    /// A pose of a stream's samples, its stamps moved back by `latency_s`.
    fn of(stream: &ReplayStream<'_>, posed: Posed, latency_s: f64) -> Result<Self, ReplayCause> {
        let stamps_ns = tables::stamps_ns(&stream.frame)?;
        let xyz = tables::positions(&stream.frame, posed)?;
        let xyzw = tables::quaternions_xyzw(&stream.frame, posed)?;
        let mut moved = Self::default();
        let late_ns = crate::time::nanos(latency_s);
        for row in thin::evenly(stamps_ns.len(), MOST_ROWS) {
            moved.stamps_ns.push(stamps_ns[row].saturating_sub(late_ns));
            moved.xyz.push(xyz[row]);
            moved.xyzw.push(xyzw[row]);
        }
        Ok(moved)
    }
}

/// A box that stands for the tool: from the frame's origin along its z axis, broader along x than
/// along y, so that no rotation hides.
struct Tool<'a> {
    label: &'a str,
    /// Whether the label is always shown, not only under the pointer.
    is_named: bool,
    rgb: [u8; 3],
    fill: FillMode,
}

impl Tool<'_> {
    fn draw(
        &self,
        tape: &Tape,
        path: &EntityPath,
        moved: &Moved,
        size_m: f64,
    ) -> Result<(), ReplayCause> {
        let half = [0.05, 0.02, 0.08].map(|part| part * size_m);
        let body = Boxes3D::from_centers_and_half_sizes([[0.0, 0.0, half[2]]], [half])
            .with_colors([self.rgb])
            .with_fill_mode(self.fill)
            .with_labels([self.label])
            .with_show_labels(self.is_named);
        tape.still(path, &body)?;
        tape.still(path, &TransformAxes3D::new((0.2 * size_m) as f32))?;
        let poses = Transform3D::update_fields()
            .with_many_translation(moved.xyz.iter().copied())
            .with_many_quaternion(moved.xyzw.iter().copied().map(quaternion));
        tape.columns(path, &moved.stamps_ns, poses.columns_of_unit_batches()?)?;
        Ok(())
    }
}

/// The whole path of a tool, at all times.
fn trail(
    tape: &Tape,
    path: &EntityPath,
    xyz: &[[f64; 3]],
    rgb: [u8; 3],
) -> Result<(), ReplayCause> {
    let strip = LineStrips3D::new([LineStrip3D::from_iter(xyz.iter().copied())])
        .with_colors([rgb])
        .with_radii([Radius::new_ui_points(1.0)]);
    Ok(tape.still(path, &strip)?)
}

/// Times, s, and positions of the chain's joints at the rows of `joints` that are kept.
fn rows<'a>(
    arm: &'a ReplayArm<'_>,
    joints: &'a JointTrack,
) -> impl Iterator<Item = (f64, Vec<f64>)> + 'a {
    thin::evenly(joints.len(), MOST_ROWS).into_iter().map(|row| {
        let positions = joints.row(row);
        (joints.t_s[row], arm.columns.iter().map(|&column| positions[column]).collect())
    })
}

fn still(pose: &Pose) -> Transform3D {
    let rotation = quaternion(xyzw_from_rotation(&pose.rotation));
    Transform3D::update_fields().with_translation(xyz_of(pose)).with_quaternion(rotation)
}

fn quaternion(xyzw: [f64; 4]) -> RotationQuat {
    RotationQuat(Quaternion::from_xyzw(xyzw.map(|component| component as f32)))
}

fn radius(radius_m: f64) -> Radius {
    Radius::new_scene_units(radius_m as f32)
}
