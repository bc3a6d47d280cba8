//! Links of an arm: frames and visuals of the model.

use std::path::PathBuf;

use re_log_types::EntityPath;
use re_sdk_types::archetypes::{
    Asset3D, Boxes3D, Cylinders3D, Ellipsoids3D, Points3D, TransformAxes3D,
};
use re_sdk_types::components::{AlbedoFactor, FillMode, Scale3D};
use re_sdk_types::datatypes::Rgba32;

use super::mesh::{Mesh, MeshError};
use super::scene::{ARM_RGB, drawn_rows, positions, radius, static_transform, transforms};
use super::timeline_writer::{TimelineWriter, entity_path};
use super::{ReplayArm, ReplayCause};
use crate::geometry::Pose;
use crate::robot::{Chain, LinkId, Shape, Visual};

/// Missing files that are named.
const MAX_NAMED_FILES: usize = 3;

pub(super) struct VisualsResult {
    /// All visuals are drawn.
    pub is_complete: bool,
    /// Notes for the report.
    pub notes: Vec<String>,
}

/// Links of an arm, and links of its robot that move with them.
pub(super) fn draw(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    size_m: f64,
    mesh_roots: &[PathBuf],
) -> Result<VisualsResult, ReplayCause> {
    let visuals = arm.robot.visuals();
    let mut found = VisualCounts::default();
    for link in arm.robot.links() {
        let name = arm.robot.link_name(link);
        let is_of_chain = is_of_chain(arm, link);
        let shown: Vec<&Visual> = visuals.iter().filter(|visual| visual.link == link).collect();
        if !is_of_chain && shown.is_empty() {
            continue;
        }
        let path = entity_path(&["arms", arm.name, "links"]).join(&entity_path(&[name]));
        let Some(carried) = LinkMotion::from_link(arm, link) else {
            found.unplaced += shown.len();
            continue;
        };
        carried.draw(writer, arm, &path)?;
        if is_of_chain {
            draw_frame(writer, arm, &path, name, size_m)?;
        }
        for (index, visual) in shown.into_iter().enumerate() {
            let path = path.join(&entity_path(&[&format!("visual_{index}")]));
            found.draw(writer, &path, visual, mesh_roots)?;
        }
    }
    Ok(found.into_result(arm, !mesh_roots.is_empty()))
}

/// The base, the tip, or moved by a joint of the chain.
fn is_of_chain(arm: &ReplayArm<'_>, link: LinkId) -> bool {
    let name = arm.robot.link_name(link);
    let mut joints = arm.chain.joint_names().iter().filter_map(|joint| arm.robot.joint(joint));
    name == arm.chain.base_name()
        || name == arm.chain.tip_name()
        || joints.any(|joint| joint.child == link)
}

enum LinkMotion {
    /// Fixed in the base.
    Fixed(Pose),
    /// At the end of a chain with these joints of the arm.
    Moving(Box<Chain>, Vec<usize>),
}

impl LinkMotion {
    /// `None` for a link moved by joints outside the arm, such as a gripper's finger.
    fn from_link(arm: &ReplayArm<'_>, link: LinkId) -> Option<Self> {
        let base = arm.robot.link(arm.chain.base_name())?;
        if let Some(pose) = arm.robot.fixed_transform(base, link) {
            return Some(LinkMotion::Fixed(pose));
        }
        let chain = arm.robot.chain(base, link).ok()?;
        let of_arm = |name: &String| arm.chain.joint_names().iter().position(|it| it == name);
        let joints = chain.joint_names().iter().map(of_arm).collect::<Option<Vec<usize>>>()?;
        Some(LinkMotion::Moving(Box::new(chain), joints))
    }

    fn draw(
        &self,
        writer: &TimelineWriter,
        arm: &ReplayArm<'_>,
        path: &EntityPath,
    ) -> Result<(), ReplayCause> {
        let (chain, joints) = match self {
            LinkMotion::Fixed(pose) => return writer.log_static(path, &static_transform(pose)),
            LinkMotion::Moving(chain, joints) => (chain, joints),
        };
        let kept = drawn_rows(&arm.corrected);
        let poses = kept.iter().map(|&row| {
            let q = positions(arm, &arm.corrected, row);
            let own: Vec<f64> = joints.iter().map(|&joint| q[joint]).collect();
            chain.forward(&own)
        });
        let poses: Vec<Pose> = poses.collect();
        let times = writer.joint_times(arm, &kept);
        writer.log_columns(path, &times, transforms(&poses).columns_of_unit_batches()?)
    }
}

/// Axes and name, which is always visible at the ends of the chain, else on hover.
fn draw_frame(
    writer: &TimelineWriter,
    arm: &ReplayArm<'_>,
    path: &EntityPath,
    name: &str,
    size_m: f64,
) -> Result<(), ReplayCause> {
    let is_base = name == arm.chain.base_name();
    let name_tag = Points3D::new([[0.0; 3]])
        .with_radii([radius(0.006 * size_m)])
        .with_colors([ARM_RGB])
        .with_labels([name])
        .with_show_labels(is_base);
    let path = path.join(&entity_path(&["frame"]));
    writer.log_static(&path, &name_tag)?;
    writer.log_static(&path, &TransformAxes3D::new((0.09 * size_m) as f32))
}

#[derive(Default)]
struct VisualCounts {
    /// Drawn visuals, and meshes among them.
    drawn: usize,
    meshes: usize,
    /// Missing meshes, with the reason.
    missing: Vec<(String, MeshError)>,
    /// Visuals on links whose position is unknown.
    unplaced: usize,
}

impl VisualCounts {
    fn draw(
        &mut self,
        writer: &TimelineWriter,
        path: &EntityPath,
        visual: &Visual,
        mesh_roots: &[PathBuf],
    ) -> Result<(), ReplayCause> {
        let place = static_transform(&visual.link_from_visual);
        match &visual.shape {
            Shape::Mesh { uri, scale } => match Mesh::find(uri, mesh_roots) {
                Ok(mesh) => {
                    let scale = Scale3D::from(scale.map(|part| part as f32));
                    writer.log_static(path, &place.with_scale(scale))?;
                    writer.log_static(path, &mesh_asset(mesh))?;
                    self.meshes += 1;
                }
                Err(why) => {
                    self.missing.push((uri.clone(), why));
                    return Ok(());
                }
            },
            Shape::Box(edges_m) => {
                writer.log_static(path, &place)?;
                let halves = edges_m.map(|edge| (edge / 2.0) as f32);
                writer.log_static(
                    path,
                    &Boxes3D::from_half_sizes([halves])
                        .with_colors([ARM_RGB])
                        .with_fill_mode(FillMode::Solid),
                )?;
            }
            &Shape::Cylinder { radius_m, length_m } => {
                writer.log_static(path, &place)?;
                let round = Cylinders3D::update_fields()
                    .with_lengths([length_m as f32])
                    .with_radii([radius_m as f32])
                    .with_colors([ARM_RGB])
                    .with_fill_mode(FillMode::Solid);
                writer.log_static(path, &round)?;
            }
            &Shape::Sphere(radius_m) => {
                writer.log_static(path, &place)?;
                let ball = Ellipsoids3D::from_half_sizes([[radius_m as f32; 3]])
                    .with_colors([ARM_RGB])
                    .with_fill_mode(FillMode::Solid);
                writer.log_static(path, &ball)?;
            }
        }
        self.drawn += 1;
        Ok(())
    }

    fn into_result(self, arm: &ReplayArm<'_>, has_roots: bool) -> VisualsResult {
        let is_whole = self.drawn > 0 && self.missing.is_empty();
        let all = self.meshes + self.missing.len();
        let mut notes = Vec::new();
        if let Some((first, _)) = self.missing.first().filter(|_| !has_roots) {
            notes.push(format!(
                "{} is drawn as capsules: set --mesh-root to the folders that contain its {}, such as \
                 {first}",
                arm.name,
                count_text(all, "mesh", "meshes"),
            ));
        } else if !self.missing.is_empty() {
            let mut names: Vec<String> =
                self.missing.iter().take(MAX_NAMED_FILES).map(describe_missing).collect();
            let others = self.missing.len().saturating_sub(MAX_NAMED_FILES);
            if others > 0 {
                names.push(format!("and {others} more"));
            }
            notes.push(format!(
                "{} of the {} of {} are not drawn, shown as capsules instead: {}",
                self.missing.len(),
                count_text(all, "mesh", "meshes"),
                arm.name,
                names.join("; "),
            ));
        } else if all > 0 {
            let them = count_text(all, "mesh", "meshes");
            notes.push(format!("{} is drawn with the {them} of its model", arm.name));
        } else if has_roots {
            notes.push(format!("the model of {} has no mesh: it is drawn as capsules", arm.name));
        }
        if self.unplaced > 0 {
            notes.push(format!(
                "{} of {} on links that other joints move are not drawn",
                count_text(self.unplaced, "visual", "visuals"),
                arm.name,
            ));
        }
        VisualsResult { is_complete: is_whole, notes }
    }
}

fn describe_missing((uri, why): &(String, MeshError)) -> String {
    match why {
        MeshError::NotFound => format!("{uri} is not below --mesh-root"),
        MeshError::Unreadable(why) => format!("{uri} cannot be shown: {why}"),
    }
}

fn count_text(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn mesh_asset(mesh: Mesh) -> Asset3D {
    let [red, green, blue] = ARM_RGB;
    let is_coloured = mesh.is_coloured();
    let asset = Asset3D::new(mesh.bytes).with_media_type(mesh.media_type);
    if is_coloured {
        return asset;
    }
    asset.with_albedo_factor(AlbedoFactor(Rgba32::from_rgb(red, green, blue)))
}
