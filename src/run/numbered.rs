//! Joints that a table counts and does not name: they get the names of the model's joints, in its order.
//! Without a model the arms of the catalogue with as many joints are held against the poses.

use crate::log::Topic;
use crate::robot::{Robot, catalogue};
use crate::stream::{Columns, JointColumns};

use super::model::{Clues, Model};
use super::skeleton;

/// The encoding of topics that are made of a table's columns.
pub(super) const TABLE: &str = "table";

/// Names the joints of tables after those of `robots`, of which each may be for names with a prefix.
pub(super) fn name(topics: &mut [Topic], robots: &[(&Robot, Option<&str>)]) {
    for topic in topics.iter_mut().filter(|topic| topic.encoding == TABLE) {
        let Some(Columns::Joints(joints)) = &mut topic.columns else { continue };
        let Some(side) = side_of(joints) else { continue };
        let fits = |prefix: &Option<&str>| {
            prefix.is_none_or(|prefix| prefix.trim_end_matches('_') == side)
        };
        let Some((robot, _)) = robots.iter().find(|(_, prefix)| fits(prefix)) else { continue };
        let Some(own) = path(robot).filter(|own| own.len() <= joints.joints.len()) else {
            continue;
        };
        for (joint, own) in joints.joints.iter_mut().zip(own) {
            joint.name = own;
        }
    }
}

/// The side in names such as `left_q1`, empty in `q1`; `None` where joints have names of their own.
fn side_of(joints: &JointColumns) -> Option<String> {
    let sides: Option<Vec<&str>> = joints
        .joints
        .iter()
        .enumerate()
        .map(|(at, joint)| joint.name.strip_suffix(&format!("q{}", at + 1)))
        .collect();
    let sides = sides.filter(|_| joints.unnamed)?;
    let first = sides.first()?;
    sides.iter().all(|side| side == first).then(|| first.trim_end_matches('_').to_owned())
}

/// The joints of a robot's longest arm, from base to tip.
fn path(robot: &Robot) -> Option<Vec<String>> {
    skeleton::arms(robot, |_| true).into_iter().next().map(|arm| arm.joints)
}

/// Whether all joints are numbers.
pub(super) fn is_numbered(joints: &[String]) -> bool {
    let is_it = |(at, name): (usize, &String)| *name == format!("q{}", at + 1);
    joints.len() > 3 && joints.iter().enumerate().all(is_it)
}

/// The arms of the catalogue with as many joints as are numbered, or one less, which is a gripper then; their
/// joints named by number.
pub(super) fn candidates(clues: &Clues<'_>) -> Vec<Model> {
    let count = clues.joints.len();
    let model = |robot: &Robot| {
        let own = path(robot).filter(|own| own.len() == count || own.len() + 1 == count)?;
        let number = |name: &str| own.iter().position(|joint| joint == name);
        let renamed = robot.with_joints_renamed(|name| match number(name) {
            Some(at) => format!("q{}", at + 1),
            None => name.to_owned(),
        })?;
        Some(Model::new(renamed, String::new(), "", clues))
    };
    catalogue::entries().iter().filter_map(model).collect()
}

/// The arm of the catalogue that metadata name: `so101_follower` is a `so101`.
pub(super) fn of_type(robot_type: &str) -> Option<&'static Robot> {
    let words: Vec<&str> = robot_type.split(['_', '-', ' ']).collect();
    (1..=words.len()).rev().find_map(|count| catalogue::find(&words[..count].join("_")))
}
