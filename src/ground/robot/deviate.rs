//! Robots whose link frames deviate from the nominal model.

use super::joint::JointKind;
use super::model::{LinkId, Robot};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec};

/// Links of a chain that may deviate. Link i > 0 is moved by coordinate i − 1; link 0 carries the first
/// moving joint.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkPath {
    /// `base_from_link` of link 0.
    pub base_from_first: Pose,
    /// Link names.
    pub links: Vec<String>,
    /// Axis of the joint that moves each link except link 0, in that link.
    pub axes: Vec<Vec3>,
    /// Whether that joint is prismatic.
    pub slides: Vec<bool>,
    /// Joint whose origin contains each link's deviation; `None` for a last link that is the tip.
    deviation_joints: Vec<Option<usize>>,
    joints: Vec<usize>,
}

impl LinkPath {
    /// Whether link `index` can deviate.
    pub fn can_deviate(&self, index: usize) -> bool {
        self.deviation_joints.get(index).is_some_and(Option::is_some)
    }
}

impl Robot {
    /// Links from `base` to `tip`. `None` if no joint on the path moves, or a moving one is a mimic or
    /// passed from child to parent.
    pub fn link_path(&self, base: LinkId, tip: LinkId) -> Option<LinkPath> {
        let path = self.path(base, tip);
        let moves = |kind: JointKind| kind != JointKind::Fixed;
        let index_of = |name: &str| self.joints().iter().position(|joint| joint.name == name);
        let first = path.iter().position(|step| moves(step.joint.kind))?;
        let base_from_first =
            path[..first].iter().fold(Pose::identity(), |pose, step| pose * step.fixed_part());
        let mut links = LinkPath {
            base_from_first,
            links: vec![self.link_name(path[first].joint.parent).to_owned()],
            axes: Vec::new(),
            slides: Vec::new(),
            deviation_joints: vec![index_of(&path[first].joint.name)],
            joints: Vec::new(),
        };
        for (at, step) in path.iter().enumerate().filter(|(_, step)| moves(step.joint.kind)) {
            let joint = step.joint;
            if step.upwards || joint.mimic.is_some() || !joint.kind.has_position() {
                return None;
            }
            links.links.push(self.link_name(joint.child).to_owned());
            links.axes.push(joint.axis);
            links.slides.push(joint.kind == JointKind::Prismatic);
            links.joints.push(index_of(&joint.name)?);
            let next = path.get(at + 1).filter(|next| !next.upwards);
            links.deviation_joints.push(next.and_then(|next| index_of(&next.joint.name)));
        }
        Some(links)
    }

    /// Copy in which each link along `path` deviates by a pose in its frame (m, rad), and zeros are added
    /// to the joints (`q_true = q_reported + zero`; rad or m). Ignores deviations that the model cannot
    /// represent.
    pub fn with_deviations(&self, path: &LinkPath, deviations: &[Pose], zeros: &[f64]) -> Robot {
        let mut origins: Vec<Pose> =
            self.joints().iter().map(|joint| joint.parent_from_joint).collect();
        for (carrier, deviation) in path.deviation_joints.iter().zip(deviations) {
            if let Some(joint) = *carrier {
                origins[joint] = deviation * origins[joint];
            }
        }
        for (&joint, &zero) in path.joints.iter().zip(zeros).filter(|(_, zero)| **zero != 0.0) {
            let own = &self.joints()[joint];
            origins[joint] *= match own.kind {
                JointKind::Prismatic => {
                    pose((own.axis * zero).into(), crate::geometry::Rotation::identity())
                }
                _ => pose([0.0; 3], rotation_from_rotvec(own.axis * zero)),
            };
        }
        let mut robot = self.with_origins(&origins);
        robot.dh = None;
        robot
    }
}
