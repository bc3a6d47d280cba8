//! The arm: a tube along its joints, the frames of its links, and its tool.

use re_sdk_types::archetypes::{LineStrips3D, ViewCoordinates};
use re_sdk_types::components::Color;
use rerun::{EntityPath, entity_path};

use crate::geometry::{Pose, xyz_of};
use crate::stream::JointTrack;

use super::recorder::{Recorded, Recorder};
use super::tool::{Tool, Weight, axes, scene_units};
use super::{MOST_POSES, ReplayArm, palette, thinning};

/// Sizes of what is drawn, as parts of the arm's reach.
mod part {
    pub const TUBE: f64 = 0.016;
    pub const THIN_TUBE: f64 = 0.006;
    pub const LINK_AXES: f64 = 0.06;
}

/// Records the arm where it was and, where that is not the same, by the joint states as recorded.
pub fn record(arm: &ReplayArm, recorder: &Recorder) -> Recorded {
    recorder.fixed(arm.entity(), &ViewCoordinates::RIGHT_HAND_Z_UP())?;
    let reach_m = arm.chain.max_reach_m();
    let moved = arm.entity().join(&entity_path!["arm"]);
    let motion = Motion::of(arm, arm.joints());
    motion.tube(&moved, palette::ARM, part::TUBE * reach_m, recorder)?;
    motion.links(&moved, arm.chain.joint_names(), part::LINK_AXES * reach_m, recorder)?;
    motion.tip(&moved, recorder)?;
    let tool = Tool { colour: palette::ARM, weight: Weight::Thin, label: None };
    tool.record(tip_of(&moved), reach_m, recorder)?;
    if arm.corrected.is_some() {
        let as_recorded = arm.entity().join(&entity_path!["arm_as_recorded"]);
        let motion = Motion::of(arm, arm.recorded);
        motion.tube(&as_recorded, palette::AS_RECORDED, part::THIN_TUBE * reach_m, recorder)?;
        motion.tip(&as_recorded, recorder)?;
        recorder.fixed(tip_of(&as_recorded), &axes(part::LINK_AXES * reach_m))?;
    }
    Ok(())
}

/// Where the joints and the tip of an arm were, in its base.
struct Motion {
    t_s: Vec<f64>,
    /// For every time the origins of base, joints and tip, m.
    points: Vec<Vec<[f64; 3]>>,
    /// For every joint `base_from_child` of its child link over time.
    links: Vec<Vec<Pose>>,
    /// `base_from_tip` over time.
    tip: Vec<Pose>,
}

impl Motion {
    fn of(arm: &ReplayArm, joints: &JointTrack) -> Self {
        let chain = arm.chain;
        let rows = thinning::every_kth(joints.len(), MOST_POSES);
        let (mut t_s, mut points, mut tip) = (Vec::new(), Vec::new(), Vec::new());
        let mut links = vec![Vec::new(); chain.dof()];
        let (mut q, mut frames) = (vec![0.0; chain.dof()], Vec::new());
        for row in rows {
            pick(joints.row(row), arm.columns, &mut q);
            chain.joint_frames(&q, &mut frames);
            let base_from_tip = chain.forward(&q);
            let joints_and_tip = frames.iter().chain([&base_from_tip]).map(xyz_of);
            points.push([[0.0; 3]].into_iter().chain(joints_and_tip).collect());
            links.iter_mut().zip(&frames).for_each(|(link, frame)| link.push(*frame));
            tip.push(base_from_tip);
            t_s.push(joints.t_s[row]);
        }
        Self { t_s, points, links, tip }
    }

    fn tube(&self, entity: &EntityPath, colour: Color, radius_m: f64, recorder: &Recorder) -> Recorded {
        let columns = LineStrips3D::update_fields().with_strips(&self.points);
        recorder.moving(entity.clone(), &self.t_s, columns.columns_of_unit_batches())?;
        let look = LineStrips3D::update_fields()
            .with_colors([colour])
            .with_radii([scene_units(radius_m)]);
        recorder.fixed(entity.clone(), &look)
    }

    fn links(&self, arm: &EntityPath, names: &[String], axes_m: f64, recorder: &Recorder) -> Recorded {
        for (name, poses) in names.iter().zip(&self.links) {
            let entity = arm.join(&entity_path!["links", name]);
            recorder.frame(entity.clone(), &self.t_s, poses)?;
            recorder.fixed(entity, &axes(axes_m))?;
        }
        Ok(())
    }

    fn tip(&self, arm: &EntityPath, recorder: &Recorder) -> Recorded {
        recorder.frame(tip_of(arm), &self.t_s, &self.tip)
    }
}

fn tip_of(arm: &EntityPath) -> EntityPath {
    arm.join(&entity_path!["tool"])
}

/// Writes the entries of `row` that `columns` names to `out`.
pub fn pick(row: &[f64], columns: &[usize], out: &mut [f64]) {
    out.iter_mut().zip(columns).for_each(|(out, &column)| *out = row[column]);
}
