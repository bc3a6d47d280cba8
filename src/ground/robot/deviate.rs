//! Arms whose links are not quite those of their model.

use super::joint::JointKind;
use super::model::{LinkId, Robot};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec};

/// The links along a chain whose frames may be off, and the joints whose origins say so.
///
/// Link 0 is the one that the first moving joint stands on, link i the one that the joint of
/// coordinate i − 1 moves.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkPath {
    /// `base_from_link` of link 0.
    pub base_from_first: Pose,
    /// The names of the links.
    pub links: Vec<String>,
    /// The axis of the joint that moves each link but link 0, in that link.
    pub axes: Vec<Vec3>,
    /// Whether that joint slides.
    pub slides: Vec<bool>,
    /// For each link, the index of the joint whose origin in it takes its deviation; none of a last
    /// link that is itself the tip.
    carriers: Vec<Option<usize>>,
    /// For each moving joint, its index.
    joints: Vec<usize>,
}

impl LinkPath {
    /// Whether the model has a place for the deviation of link `index`.
    pub fn carries(&self, index: usize) -> bool {
        self.carriers.get(index).is_some_and(Option::is_some)
    }
}

impl Robot {
    /// The links from `base` to `tip`. None where the way leads over a moving joint from child to
    /// parent, over one that mimics another, or over no moving joint.
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
            carriers: vec![index_of(&path[first].joint.name)],
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
            links.carriers.push(next.and_then(|next| index_of(&next.joint.name)));
        }
        Some(links)
    }

    /// The same robot with each link along `path` off by its deviation, in that link's own frame (m,
    /// rad), and with the joints' zeros taken into the model (`q_true = q_reported + zero`; rad, or m).
    /// A deviation for which the model has no place is left out.
    pub fn deviated(&self, path: &LinkPath, deviations: &[Pose], zeros: &[f64]) -> Robot {
        let mut origins: Vec<Pose> =
            self.joints().iter().map(|joint| joint.parent_from_joint).collect();
        for (carrier, deviation) in path.carriers.iter().zip(deviations) {
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
