//! Finds each arm's joint path in a robot model, and its tip.

use std::collections::BTreeSet;

use crate::robot::{Joint, JointKind, LinkId, Robot};

#[derive(Clone, Debug, PartialEq)]
pub(super) struct ArmPath {
    /// Link above the first joint.
    pub base: LinkId,
    /// Link below the last joint.
    pub end: LinkId,
    /// Independent joints, from base to end.
    pub joints: Vec<String>,
}

const GRIPPER_WORDS: &[&str] = &["gripper", "finger", "jaw", "claw", "knuckle"];

/// Names of joints that rotate a whole gripper.
const ROTATION_WORDS: &[&str] = &["roll", "rot", "pitch", "yaw", "turn", "wrist"];

/// Whether a joint has one coordinate and mimics no other.
fn is_independent(joint: &Joint) -> bool {
    joint.kind.has_position() && joint.mimic.is_none()
}

/// Names of the independent joints.
pub(super) fn independent_joint_names(robot: &Robot) -> Vec<String> {
    let own = robot.joints().iter().filter(|joint| is_independent(joint));
    own.map(|joint| joint.name.clone()).collect()
}

/// `joint`, or the one that it mimics.
pub(super) fn driving_joint<'a>(robot: &'a Robot, joint: &'a Joint) -> &'a Joint {
    let master = |joint: &&'a Joint| robot.joint(&joint.mimic.as_ref()?.joint);
    // Limits the steps of cyclic mimics.
    let drivers = std::iter::successors(Some(joint), master).take(robot.joints().len() + 1);
    drivers.last().unwrap_or(joint)
}

/// The longest path of independent logged joints, and others with at least four own joints, more than
/// shared.
///
/// A path ends where all branches have fewer joints than the path so far (a gripper), and before a last
/// joint named like a gripper's.
pub(super) fn find_arm_paths(robot: &Robot, logged: impl Fn(&str) -> bool) -> Vec<ArmPath> {
    const MIN_OWN_JOINTS: usize = 4;
    let mut walk = TreeWalk { robot, logged, ends: Vec::new() };
    walk.descend(
        robot.root(),
        ArmPath { base: robot.root(), end: robot.root(), joints: Vec::new() },
    );
    let mut ends = walk.ends;
    ends.sort_by_key(|path| std::cmp::Reverse(path.joints.len()));
    let mut arms: Vec<ArmPath> = Vec::new();
    for path in ends {
        let taken = |joint: &&String| arms.iter().any(|arm| arm.joints.contains(joint));
        let shared = path.joints.iter().filter(taken).count();
        let own = path.joints.len() - shared;
        if own > 0 && (arms.is_empty() || own >= MIN_OWN_JOINTS.max(shared + 1)) {
            arms.push(path);
        }
    }
    arms
}

/// The same, if there is exactly one.
pub(super) fn find_only_arm_path(robot: &Robot, logged: impl Fn(&str) -> bool) -> Option<ArmPath> {
    <[_; 1]>::try_from(find_arm_paths(robot, logged)).ok().map(|[path]| path)
}

struct TreeWalk<'a, F> {
    robot: &'a Robot,
    logged: F,
    ends: Vec<ArmPath>,
}

impl<F: Fn(&str) -> bool> TreeWalk<'_, F> {
    fn descend(&mut self, link: LinkId, path: ArmPath) {
        let robot = self.robot;
        let branches: Vec<(&Joint, usize)> = robot
            .child_joints(link)
            .filter(|joint| self.moves(joint))
            .map(|joint| (joint, self.depth(joint)))
            .collect();
        let deepest = branches.iter().map(|(_, depth)| *depth).max().unwrap_or(0);
        let is_gripper = branches.len() > 1 && deepest < path.joints.len();
        let ways: Vec<&Joint> = branches
            .into_iter()
            .filter(|(joint, depth)| {
                *depth > 0 && !is_gripper && !opens_gripper(joint, *depth, &path)
            })
            .map(|(joint, _)| joint)
            .collect();
        if ways.is_empty() {
            if !path.joints.is_empty() {
                self.ends.push(path);
            }
            return;
        }
        for joint in ways {
            self.descend(joint.child, self.extended(&path, joint));
        }
    }

    fn extended(&self, path: &ArmPath, joint: &Joint) -> ArmPath {
        let mut path = path.clone();
        if is_independent(joint) && (self.logged)(&joint.name) {
            if path.joints.is_empty() {
                path.base = joint.parent;
            }
            path.joints.push(joint.name.clone());
            path.end = joint.child;
        } else if !is_fixed(joint) && !(self.logged)(&driving_joint(self.robot, joint).name) {
            // Without this joint's position, the arm can only start below it.
            path = ArmPath { base: joint.child, end: joint.child, joints: Vec::new() };
        }
        path
    }

    fn moves(&self, joint: &Joint) -> bool {
        !is_fixed(joint) || self.robot.child_joints(joint.child).any(|below| self.moves(below))
    }

    /// Maximum number of independent logged joints from `joint`.
    fn depth(&self, joint: &Joint) -> usize {
        let below = self.robot.child_joints(joint.child).map(|below| self.depth(below)).max();
        usize::from(is_independent(joint) && (self.logged)(&joint.name)) + below.unwrap_or(0)
    }
}

fn is_fixed(joint: &Joint) -> bool {
    joint.kind == JointKind::Fixed
}

fn opens_gripper(joint: &Joint, depth: usize, path: &ArmPath) -> bool {
    let name = joint.name.to_lowercase();
    let has = |words: &[&str]| words.iter().any(|word| name.contains(word));
    depth == 1
        && path.joints.len() > 1
        && is_independent(joint)
        && has(GRIPPER_WORDS)
        && !has(ROTATION_WORDS)
}

/// Default tip among links fixed to `end`: `preferred`, else the first of `tool0`, `flange`, `*_tcp`,
/// `*_link8`, else behind the most fixed joints.
pub(super) fn select_tip(robot: &Robot, end: LinkId, preferred: Option<&str>) -> LinkId {
    let fixed = fixed_links_below(robot, end);
    let named = |fits: &dyn Fn(&str) -> bool| {
        fixed.iter().map(|(link, _)| *link).find(|link| fits(robot.link_name(*link)))
    };
    let is = |name: &str, bare: &str| {
        name == bare || name.ends_with(&format!("_{bare}")) || name.ends_with(&format!("/{bare}"))
    };
    preferred
        .and_then(|preferred| named(&|name| name == preferred))
        .or_else(|| named(&|name| is(name, "tool0")))
        .or_else(|| named(&|name| is(name, "flange")))
        .or_else(|| named(&|name| name.ends_with("_tcp")))
        .or_else(|| named(&|name| name.ends_with("_link8")))
        .or_else(|| fixed.iter().rev().max_by_key(|(_, depth)| *depth).map(|(link, _)| *link))
        .unwrap_or(end)
}

/// `link` and links fixed below, with the number of joints between, parents first.
fn fixed_links_below(robot: &Robot, link: LinkId) -> Vec<(LinkId, usize)> {
    let mut found = vec![(link, 0)];
    let mut next = 0;
    while let Some(&(link, depth)) = found.get(next) {
        let below = robot.child_joints(link).filter(|joint| is_fixed(joint));
        found.extend(below.map(|joint| (joint.child, depth + 1)));
        next += 1;
    }
    found
}

/// Logged joints above `link` if none of them belongs to an arm, as a positioner moves its table.
pub(super) fn joints_of_positioner(
    robot: &Robot,
    link: LinkId,
    arms: &[ArmPath],
    logged: impl Fn(&str) -> bool,
) -> Vec<String> {
    let above = moving_joints_above(robot, link);
    let joints: BTreeSet<&String> = above.map(|joint| &driving_joint(robot, joint).name).collect();
    let is_own =
        |joint: &&String| logged(joint) && !arms.iter().any(|arm| arm.joints.contains(joint));
    if joints.iter().all(is_own) { joints.into_iter().cloned().collect() } else { Vec::new() }
}

pub(super) fn moving_joints_above(robot: &Robot, link: LinkId) -> impl Iterator<Item = &Joint> {
    let up =
        std::iter::successors(robot.parent_joint(link), |joint| robot.parent_joint(joint.parent));
    up.filter(|joint| !is_fixed(joint))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A URDF from "name type parent child".
    pub fn robot(joints: &[&str]) -> Robot {
        Robot::from_urdf(&urdf(joints), "test").unwrap()
    }

    pub fn urdf(joints: &[&str]) -> String {
        let mut links: Vec<&str> = Vec::new();
        let mut body = String::new();
        for joint in joints {
            let [name, kind, parent, child] = joint.split(' ').collect::<Vec<_>>()[..] else {
                panic!("{joint}")
            };
            links.extend([parent, child]);
            let (kind, mimic) = match kind.split_once('=') {
                Some((kind, master)) => (kind, format!("<mimic joint=\"{master}\"/>")),
                None => (kind, String::new()),
            };
            body += &format!(
                "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
                 <axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>{mimic}</joint>"
            );
        }
        links.sort_unstable();
        links.dedup();
        let links: String = links.iter().map(|link| format!("<link name=\"{link}\"/>")).collect();
        format!("<robot name=\"r\">{links}{body}</robot>")
    }

    const ARM: [&str; 6] = [
        "j1 revolute base l1", "j2 revolute l1 l2", "j3 revolute l2 l3", "j4 revolute l3 l4",
        "f fixed l4 flange", "t fixed flange tool0",
    ];

    fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
        ARM.into_iter().chain(more.iter().copied()).collect()
    }

    fn only_arm(robot: &Robot) -> (Vec<String>, &str) {
        let arms = find_arm_paths(robot, |_| true);
        assert_eq!(arms.len(), 1, "{arms:?}");
        (arms[0].joints.clone(), robot.link_name(select_tip(robot, arms[0].end, None)))
    }

    #[test]
    fn the_path_ends_before_a_branching_gripper() {
        let joints = with(&[
            "h fixed tool0 hand",
            "finger1 prismatic hand left",
            "finger2 prismatic=finger1 hand right",
            "c fixed hand hand_tcp",
        ]);
        assert_eq!(
            only_arm(&robot(&joints)),
            (vec!["j1".into(), "j2".into(), "j3".into(), "j4".into()], "tool0")
        );
    }

    #[test]
    fn fingers_with_joints_of_their_own_are_no_arms() {
        let joints = with(&[
            "a1 revolute tool0 a", "a2 revolute a aa", "a3 revolute aa aaa", "b1 revolute tool0 b",
            "b2 revolute b bb", "b3 revolute bb bbb",
        ]);
        assert_eq!(only_arm(&robot(&joints)).0.len(), 4);
    }

    #[test]
    fn the_path_ends_before_a_jaw_but_not_before_a_wrist() {
        assert_eq!(only_arm(&robot(&with(&["gripper revolute tool0 jaw"]))).0.len(), 4);
        let turning = robot(&with(&["gripper_roll revolute tool0 wrist", "e fixed wrist ee_tcp"]));
        assert_eq!(only_arm(&turning).0.len(), 5);
        assert_eq!(only_arm(&turning).1, "ee_tcp");
    }

    #[test]
    fn two_arms_on_a_torso_are_two() {
        let mut joints = vec!["torso revolute base chest"];
        let names: Vec<String> = ["left", "right"]
            .iter()
            .flat_map(|side| {
                (0..4).map(move |i| {
                    let parent = if i == 0 { "chest".to_owned() } else { format!("{side}_l{i}") };
                    format!("{side}_j{i} revolute {parent} {side}_l{}", i + 1)
                })
            })
            .collect();
        joints.extend(names.iter().map(String::as_str));
        let robot = robot(&joints);
        let found = find_arm_paths(&robot, |_| true);
        assert_eq!(found.iter().map(|arm| arm.joints.len()).collect::<Vec<_>>(), [5, 5]);
    }

    #[test]
    fn an_arm_begins_below_a_joint_that_is_not_logged() {
        let robot = robot(&ARM);
        let arms = find_arm_paths(&robot, |name| name != "j1");
        assert_eq!(arms[0].joints, ["j2", "j3", "j4"]);
        assert_eq!(robot.link_name(arms[0].base), "l1");
    }

    #[test]
    fn a_mimic_joint_is_where_its_driver_is() {
        let joints = ["lift revolute base l1", "stage revolute=lift l1 l2", "j2 revolute l2 l3"];
        let robot = robot(&joints);
        assert_eq!(driving_joint(&robot, robot.joint("stage").unwrap()).name, "lift");
        assert_eq!(find_arm_paths(&robot, |name| name != "stage")[0].joints, ["lift", "j2"]);
        assert_eq!(find_arm_paths(&robot, |name| name == "j2")[0].joints, ["j2"]);
    }

    #[test]
    fn the_tip_is_the_preferred_link_or_the_best_known_name() {
        let robot = robot(&with(&["c fixed tool0 camera", "o fixed camera optical"]));
        let end = robot.link("l4").unwrap();
        assert_eq!(robot.link_name(select_tip(&robot, end, None)), "tool0");
        assert_eq!(robot.link_name(select_tip(&robot, end, Some("camera"))), "camera");
        assert_eq!(robot.link_name(select_tip(&robot, end, Some("l2"))), "tool0");
        let plain =
            self::robot(&["j revolute base l", "a fixed l x", "b fixed l y", "c fixed y z"]);
        assert_eq!(plain.link_name(select_tip(&plain, plain.link("l").unwrap(), None)), "z");
    }
}
