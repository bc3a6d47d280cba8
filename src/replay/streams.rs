//! The pose streams: where they say that the tool was, and their ghosts.

use re_sdk_types::archetypes::LineStrips3D;
use re_sdk_types::components::{LineStrip3D, Radius};
use rerun::{EntityPath, entity_path};

use crate::geometry::{Pose, pose, rotation_from_xyzw, xyz_of};
use crate::robot::Chain;
use crate::tables::{PoseColumns, Quantity, Version};

use super::arm::pick;
use super::recorder::{Recorded, Recorder};
use super::tool::{Tool, Weight};
use super::{MOST_POINTS, MOST_POSES, ReplayArm, ReplayStream, palette, thinning};

/// Half the thickness of a trail, in points on the screen.
const TRAIL_UI_POINTS: f32 = 0.75;

/// Records the streams of `arm`.
pub fn record(arm: &ReplayArm, recorder: &Recorder) -> Recorded {
    let reach_m = arm.chain.max_reach_m();
    for (index, stream) in arm.streams.iter().enumerate() {
        let entity = arm.entity().join(&entity_path!["streams", arm.stream_name(index)]);
        let show = Show { arm, stream, entity, reach_m, recorder };
        let (logged, corrected) = palette::stream(index);
        if stream.derived {
            let tool = Tool { colour: palette::DERIVED, weight: Weight::Thin, label: None };
            show.version("logged", Version::Logged, Quantity::Time, &tool)?;
            continue;
        }
        let label = |version: &str| Some(arm.label(index, version));
        let tool = Tool { colour: logged, weight: Weight::Bold, label: label("logged") };
        show.version("logged", Version::Logged, Quantity::Time, &tool)?;
        let tool = Tool { colour: corrected, weight: Weight::Bold, label: label("corrected") };
        show.version("corrected", Version::Corrected, Quantity::TrueTime, &tool)?;
    }
    Ok(())
}

/// One stream, to be shown below `entity`.
struct Show<'a> {
    arm: &'a ReplayArm<'a>,
    stream: &'a ReplayStream<'a>,
    entity: EntityPath,
    reach_m: f64,
    recorder: &'a Recorder,
}

impl Show<'_> {
    /// One version of the stream: a tool that moves, and the way that it went.
    fn version(&self, name: &str, version: Version, when: Quantity, tool: &Tool) -> Recorded {
        let t_s = self.stream.table.numbers(when);
        let entity = self.entity.join(&entity_path![name]);
        let rows: Vec<usize> = thinning::every_kth(t_s.len(), MOST_POSES).collect();
        let t_s: Vec<f64> = rows.iter().map(|&row| t_s[row]).collect();
        let poses = self.in_base(version, &rows, &t_s);
        self.recorder.frame(entity.clone(), &t_s, &poses)?;
        tool.record(entity, self.reach_m, self.recorder)?;

        let points = thinning::every_kth(poses.len(), MOST_POINTS).map(|row| xyz_of(&poses[row]));
        let trail = LineStrips3D::new([LineStrip3D::from_iter(points)])
            .with_colors([tool.colour])
            .with_radii([Radius::new_ui_points(TRAIL_UI_POINTS)]);
        self.recorder.fixed(self.entity.join(&entity_path!["trail", name]), &trail)
    }

    /// The poses of `rows` in the base of the robot; they were true at `t_s`.
    fn in_base(&self, version: Version, rows: &[usize], t_s: &[f64]) -> Vec<Pose> {
        let columns = self.stream.table.poses(version);
        let reference_from_frame = match version {
            Version::Logged => self.stream.estimated_reference.unwrap_or_default(),
            _ => Pose::identity(),
        };
        let mut reference = Reference::new(self.arm, self.stream);
        let placed = rows.iter().zip(t_s).map(|(&row, &t_s)| {
            reference.in_base(t_s) * reference_from_frame * pose_of(&columns, row)
        });
        placed.collect()
    }
}

fn pose_of(columns: &PoseColumns, row: usize) -> Pose {
    let rotation = rotation_from_xyzw(columns.xyzw(row)).unwrap_or_default();
    pose(columns.xyz(row), rotation)
}

/// The frame that a stream's poses are in, seen from the robot's base.
///
/// Another link than the base may be meant, even one that moves. Both chains tell where the links
/// are that they share, so either way `base_from_link · (reference_from_link)⁻¹` is known.
struct Reference<'a> {
    arm: &'a ReplayArm<'a>,
    stream: &'a ReplayStream<'a>,
    /// A joint that both chains go through, by its place in the arm's and in the stream's; `None`
    /// where the reference is the base.
    shared: Option<(usize, usize)>,
    base_from_reference: Pose,
    cursor: usize,
}

impl<'a> Reference<'a> {
    fn new(arm: &'a ReplayArm<'a>, stream: &'a ReplayStream<'a>) -> Self {
        let names = stream.chain.joint_names();
        let mut places = arm.chain.joint_names().iter().enumerate().filter_map(|(place, name)| {
            Some((place, names.iter().position(|other| other == name)?))
        });
        let is_base = stream.chain.base_name() == arm.chain.base_name();
        let shared = if is_base { None } else { places.next() };
        Self { arm, stream, shared, base_from_reference: Pose::identity(), cursor: 0 }
    }

    /// `base_from_reference` at time `t_s`; where the joint states do not reach, as when they last
    /// did.
    fn in_base(&mut self, t_s: f64) -> Pose {
        let Some((in_arm, in_stream)) = self.shared else { return self.base_from_reference };
        let joints = self.arm.joints();
        let (mut q, mut qd) = (vec![0.0; joints.dof], vec![0.0; joints.dof]);
        if joints.at(t_s, &mut self.cursor, &mut q, &mut qd) {
            let base_from_link = link(self.arm.chain, self.arm.columns, &q, in_arm);
            let reference_from_link = link(self.stream.chain, self.stream.columns, &q, in_stream);
            self.base_from_reference = base_from_link * reference_from_link.inverse();
        }
        self.base_from_reference
    }
}

/// The child link of joint `joint` in the base of `chain`, for a row of the joint track.
fn link(chain: &Chain, columns: &[usize], row: &[f64], joint: usize) -> Pose {
    let (mut q, mut frames) = (vec![0.0; chain.dof()], Vec::new());
    pick(row, columns, &mut q);
    chain.joint_frames(&q, &mut frames);
    frames[joint]
}
