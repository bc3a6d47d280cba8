//! Tree of links and joints.

use std::collections::HashMap;
use std::sync::Arc;

use crate::geometry::{Pose, Vec3};

use super::dh::DhModel;
use super::error::{ChainError, Located, Problem};
use super::joint::{JointDraft, JointKind, Limits, LinkDraft, MAX_MAGNITUDE, Mimic};
use super::nearest::nearest;

/// Robot: one tree of links and joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name.
    pub name: String,
    /// File, topic, or `catalogue`.
    pub source: String,
    /// Declared base link.
    pub default_base: Option<String>,
    /// Declared tip link.
    pub default_tip: Option<String>,
    /// Link in which the controller expresses its poses.
    pub controller_base: Option<String>,
    /// Link whose pose the controller reports.
    pub controller_tip: Option<String>,
    /// Other prefixes in logs.
    pub joint_prefixes: Vec<String>,
    /// Other names of the arm.
    pub aliases: Vec<String>,
    /// Origin of the data, if declared.
    pub provenance: Option<Provenance>,
    /// DH table, if any.
    pub dh: Option<DhModel>,
    /// `None` for catalogue arms.
    pub(super) text: Option<Arc<str>>,
    links: Vec<Link>,
    joints: Vec<Joint>,
    link_ids: HashMap<String, LinkId>,
    joint_ids: HashMap<String, usize>,
    root: LinkId,
}

/// Origin of a catalogue arm's data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// Manufacturer.
    pub vendor: String,
    /// Manufacturer's name of the arm.
    pub model: String,
    /// Repository and commit.
    pub source: String,
    /// Licence of the source.
    pub licence: String,
}

/// Valid for the robot that returned it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(usize);

#[derive(Debug, Clone, PartialEq)]
struct Link {
    name: String,
    /// Joint whose child it is.
    parent: Option<usize>,
    /// Joints whose parent it is, in file order.
    children: Vec<usize>,
}

/// A joint between two links.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Unique within the robot.
    pub name: String,
    /// Type of motion.
    pub kind: JointKind,
    /// Link towards the root.
    pub parent: LinkId,
    /// Link away from the root, with the joint's frame after the motion.
    pub child: LinkId,
    /// Pose of the child at position zero.
    pub parent_from_joint: Pose,
    /// Unit vector, in the joint's frame.
    pub axis: Vec3,
    /// Stated limits.
    pub limits: Limits,
    /// Driving joint.
    pub mimic: Option<Mimic>,
}

struct Offsets {
    links: Vec<usize>,
    joints: Vec<usize>,
}

impl Robot {
    /// Builds the tree.
    ///
    /// # Errors
    /// If links and joints do not form one tree with unique names.
    pub(super) fn assemble(
        name: &str,
        source: &str,
        link_drafts: Vec<LinkDraft>,
        joint_drafts: Vec<JointDraft>,
    ) -> Result<Robot, Located> {
        let at = Offsets {
            links: link_drafts.iter().map(|draft| draft.at).collect(),
            joints: joint_drafts.iter().map(|draft| draft.at).collect(),
        };
        let (mut links, link_ids) = collect_links(link_drafts)?;
        let (joints, joint_ids) = connect(joint_drafts, &mut links, &link_ids)?;
        let root = find_root(&links, &joints, &at)?;
        Ok(Robot {
            name: name.to_owned(),
            source: source.to_owned(),
            default_base: None,
            default_tip: None,
            controller_base: None,
            controller_tip: None,
            joint_prefixes: Vec::new(),
            aliases: Vec::new(),
            provenance: None,
            dh: None,
            text: None,
            links,
            joints,
            link_ids,
            joint_ids,
            root,
        })
    }

    /// A body that moves freely in a frame; its joint is named like the robot.
    ///
    /// # Panics
    /// If the links have the same name.
    pub fn floating_body(name: &str, frame: &str, body: &str) -> Robot {
        let link = |name: &str| LinkDraft { name: name.to_owned(), at: 0 };
        let joint = JointDraft {
            name: name.to_owned(),
            kind: JointKind::Floating,
            parent: frame.to_owned(),
            child: body.to_owned(),
            parent_from_joint: Pose::identity(),
            axis: Vec3::z(),
            limits: Limits::default(),
            mimic: None,
            at: 0,
        };
        Robot::assemble(name, name, vec![link(frame), link(body)], vec![joint])
            .unwrap_or_else(|_| panic!("'{frame}' and '{body}' are two links"))
    }

    /// URDF or TOML; `None` for catalogue arms.
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }

    /// Links in file order.
    pub fn links(&self) -> impl Iterator<Item = LinkId> + '_ {
        (0..self.links.len()).map(LinkId)
    }

    /// Joints in file order.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The joint with this name.
    pub fn joint(&self, name: &str) -> Option<&Joint> {
        self.joint_ids.get(name).map(|&joint| &self.joints[joint])
    }

    /// Ignores unknown joints.
    pub(super) fn move_joint(&mut self, name: &str, parent_from_joint: Pose) {
        if let Some(&joint) = self.joint_ids.get(name) {
            self.joints[joint].parent_from_joint = parent_from_joint;
        }
    }

    /// Copy with these joint origins, in file order.
    pub(super) fn with_origins(&self, parent_from_joint: &[Pose]) -> Robot {
        let mut robot = self.clone();
        for (joint, origin) in robot.joints.iter_mut().zip(parent_from_joint) {
            joint.parent_from_joint = *origin;
        }
        robot
    }

    /// Robot of the same rows under the other DH convention; `None` without a DH table.
    pub fn under_other_convention(&self) -> Option<Robot> {
        let dh = self.dh.as_ref()?;
        let mut robot = self.with_origins(&dh.other_origins);
        let other_origins = self.joints().iter().map(|joint| joint.parent_from_joint).collect();
        robot.dh = Some(DhModel { convention: dh.convention.other(), other_origins });
        Some(robot)
    }

    /// The link with this name.
    pub fn link(&self, name: &str) -> Option<LinkId> {
        self.link_ids.get(name).copied()
    }

    /// The link with a name given by the user.
    ///
    /// # Errors
    /// [`ChainError::UnknownLink`] with the most similar names, or else root and leaves.
    pub fn link_or_nearest(&self, name: &str) -> Result<LinkId, ChainError> {
        self.link(name).ok_or_else(|| {
            let mut instead = self.nearest_link_names(name);
            if instead.is_empty() {
                let ends = std::iter::once(self.root).chain(self.leaf_links());
                instead = ends.take(4).map(|link| self.link_name(link)).collect();
            }
            ChainError::UnknownLink {
                robot: self.name.clone(),
                link: name.to_owned(),
                instead: instead.into_iter().map(str::to_owned).collect(),
            }
        })
    }

    /// Name of a link.
    pub fn link_name(&self, link: LinkId) -> &str {
        &self.links[link.0].name
    }

    /// Root link.
    pub fn root(&self) -> LinkId {
        self.root
    }

    /// Joint whose child is `link`; `None` for the root.
    pub fn parent_joint(&self, link: LinkId) -> Option<&Joint> {
        self.links[link.0].parent.map(|joint| &self.joints[joint])
    }

    /// Joints whose parent is `link`, in file order.
    pub fn child_joints(&self, link: LinkId) -> impl Iterator<Item = &Joint> {
        self.links[link.0].children.iter().map(|&joint| &self.joints[joint])
    }

    /// Links without children, in file order.
    pub fn leaf_links(&self) -> impl Iterator<Item = LinkId> + '_ {
        self.links().filter(|link| self.links[link.0].children.is_empty())
    }

    /// Up to three link names similar to `name`, most similar first.
    pub fn nearest_link_names(&self, name: &str) -> Vec<&str> {
        nearest(name, self.links.iter().map(|link| link.name.as_str()))
    }

    /// `a_from_b` if only fixed joints connect the links.
    pub fn fixed_transform(&self, a: LinkId, b: LinkId) -> Option<Pose> {
        let path = self.path(a, b);
        let fixed = path.iter().all(|step| step.joint.kind == JointKind::Fixed);
        fixed.then(|| path.iter().fold(Pose::identity(), |pose, step| pose * step.fixed_part()))
    }

    /// Up to their lowest common ancestor, then down.
    pub(super) fn path(&self, from: LinkId, to: LinkId) -> Vec<PathStep<'_>> {
        let (mut up, mut down) = (self.joints_to_root(from), self.joints_to_root(to));
        while let (Some(a), Some(b)) = (up.last(), down.last())
            && std::ptr::eq(*a, *b)
        {
            up.pop();
            down.pop();
        }
        let climb = up.into_iter().map(|joint| PathStep { joint, upwards: true });
        let descent = down.into_iter().rev().map(|joint| PathStep { joint, upwards: false });
        climb.chain(descent).collect()
    }

    fn joints_to_root(&self, link: LinkId) -> Vec<&Joint> {
        std::iter::successors(self.parent_joint(link), |joint| self.parent_joint(joint.parent))
            .collect()
    }

    /// `None` if two link or joint names would become equal.
    pub(super) fn renamed(&self, rename: impl Fn(&str) -> String) -> Option<Robot> {
        let mut robot = self.with_joints_renamed(&rename)?;
        for link in &mut robot.links {
            link.name = rename(&link.name);
        }
        let named = [
            &mut robot.default_base, &mut robot.default_tip, &mut robot.controller_base,
            &mut robot.controller_tip,
        ];
        for link in named.into_iter().flatten() {
            *link = rename(link);
        }
        let links = robot.links.iter().enumerate();
        robot.link_ids = links.map(|(index, link)| (link.name.clone(), LinkId(index))).collect();
        (robot.link_ids.len() == robot.links.len()).then_some(robot)
    }

    /// Copy with renamed joints; `None` if two names would become equal.
    pub fn with_joints_renamed(&self, rename: impl Fn(&str) -> String) -> Option<Robot> {
        let mut robot = self.clone();
        for joint in &mut robot.joints {
            joint.name = rename(&joint.name);
            if let Some(mimic) = &mut joint.mimic {
                mimic.joint = rename(&mimic.joint);
            }
        }
        let joints = robot.joints.iter().enumerate();
        robot.joint_ids = joints.map(|(index, joint)| (joint.name.clone(), index)).collect();
        (robot.joint_ids.len() == robot.joints.len()).then_some(robot)
    }
}

/// A joint on a path through the tree.
pub(super) struct PathStep<'a> {
    pub joint: &'a Joint,
    /// Whether it leads from child to parent.
    pub upwards: bool,
}

impl PathStep<'_> {
    /// Transform at position zero.
    pub(super) fn fixed_part(&self) -> Pose {
        if self.upwards {
            self.joint.parent_from_joint.inverse()
        } else {
            self.joint.parent_from_joint
        }
    }
}

/// Arbitrary for joint types without an axis.
///
/// # Errors
/// If the axis is needed and is zero.
pub(super) fn unit_axis(joint: &str, kind: JointKind, xyz: [f64; 3]) -> Result<Vec3, Problem> {
    if !kind.has_position() {
        return Ok(Vec3::x());
    }
    let axis = Vec3::from(xyz);
    // Scaled first, because squares of large components overflow.
    let largest = axis.amax();
    let axis = (largest > 1e-9).then(|| (axis / largest).normalize());
    axis.ok_or_else(|| Problem::ZeroAxis { joint: joint.to_owned() })
}

fn collect_links(drafts: Vec<LinkDraft>) -> Result<(Vec<Link>, HashMap<String, LinkId>), Located> {
    let mut link_ids = HashMap::new();
    let mut links = Vec::with_capacity(drafts.len());
    for LinkDraft { name, at } in drafts {
        if link_ids.insert(name.clone(), LinkId(links.len())).is_some() {
            return Err((at, Problem::DuplicateName { what: "link", name }));
        }
        links.push(Link { name, parent: None, children: Vec::new() });
    }
    Ok((links, link_ids))
}

fn connect(
    drafts: Vec<JointDraft>,
    links: &mut [Link],
    link_ids: &HashMap<String, LinkId>,
) -> Result<(Vec<Joint>, HashMap<String, usize>), Located> {
    let mut joints: Vec<Joint> = Vec::with_capacity(drafts.len());
    let mut joint_ids = HashMap::new();
    for draft in drafts {
        let JointDraft { name, at, .. } = draft;
        if joint_ids.insert(name.clone(), joints.len()).is_some() {
            return Err((at, Problem::DuplicateName { what: "joint", name }));
        }
        let find = |end, link: String| {
            let unknown =
                || (at, Problem::UnknownLink { joint: name.clone(), end, link: link.clone() });
            link_ids.get(&link).copied().ok_or_else(unknown)
        };
        let (parent, child) = (find("parent", draft.parent)?, find("child", draft.child)?);
        let mimic = draft.mimic.as_ref();
        let numbers = mimic.into_iter().flat_map(|mimic| [mimic.multiplier, mimic.offset]);
        let numbers = numbers.chain(draft.parent_from_joint.translation.vector.iter().copied());
        if let Some(found) =
            numbers.map(f64::abs).find(|number| number.is_nan() || *number > MAX_MAGNITUDE)
        {
            let link = links[child.0].name.clone();
            return Err((at, Problem::Beyond { joint: name, link, found, most: MAX_MAGNITUDE }));
        }
        if let Some(first) = links[child.0].parent.replace(joints.len()) {
            let link = links[child.0].name.clone();
            let first = joints[first].name.clone();
            return Err((at, Problem::TwoParents { link, first, second: name }));
        }
        links[parent.0].children.push(joints.len());
        joints.push(Joint {
            name,
            kind: draft.kind,
            parent,
            child,
            parent_from_joint: draft.parent_from_joint,
            axis: draft.axis,
            limits: draft.limits.within_reason(),
            mimic: draft.mimic,
        });
    }
    Ok((joints, joint_ids))
}

/// Every link already has at most one parent.
fn find_root(links: &[Link], joints: &[Joint], at: &Offsets) -> Result<LinkId, Located> {
    let reached = reach(links, joints);
    let looped = links.iter().zip(reached).find(|(_, reached)| !reached);
    if let Some(joint) = looped.and_then(|(link, _)| link.parent) {
        return Err((at.joints[joint], Problem::Loop { joint: joints[joint].name.clone() }));
    }
    let mut roots = (0..links.len()).filter(|&link| links[link].parent.is_none());
    let first = roots.next().ok_or((0, Problem::NoLink))?;
    if let Some(second) = roots.next() {
        let [first_name, second_name] = [first, second].map(|link| links[link].name.clone());
        let problem = Problem::TwoRoots { first: first_name, second: second_name };
        return Err((at.links[second], problem));
    }
    Ok(LinkId(first))
}

/// Whether each link descends from a link without a parent.
fn reach(links: &[Link], joints: &[Joint]) -> Vec<bool> {
    let mut reached = vec![false; links.len()];
    let mut pending: Vec<usize> =
        (0..links.len()).filter(|&link| links[link].parent.is_none()).collect();
    while let Some(link) = pending.pop() {
        reached[link] = true;
        pending.extend(links[link].children.iter().map(|&joint| joints[joint].child.0));
    }
    reached
}
