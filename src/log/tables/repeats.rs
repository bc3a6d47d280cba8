//! Columns that repeat another column, or hold one value, in every row of every episode.

use std::borrow::Cow;
use std::collections::BTreeMap;

use super::{TableTopic, names};
use crate::Repeat;
use ground::stream::{Columns, JointColumn, JointColumns};

/// Minimum rows of an episode, and minimum rows with a change in a repeated column.
const MIN_ROWS: usize = 20;
const MIN_CHANGES: usize = 10;
/// Topics compared with each other.
const MAX_TOPICS: usize = 100;

/// With the number of tables that have each.
#[derive(Default)]
pub(super) struct RepeatCounts {
    tables: BTreeMap<String, usize>,
    found: BTreeMap<Repeat, usize>,
}

impl RepeatCounts {
    pub fn count(&mut self, episode: &[TableTopic]) {
        let measured: Vec<(&str, &Columns)> = episode
            .iter()
            .filter_map(|found| Some((found.topic.as_str(), found.columns.as_ref()?)))
            .filter(|(_, columns)| ValueRows::from_columns(columns).len() >= MIN_ROWS)
            .take(MAX_TOPICS)
            .collect();
        if measured.is_empty() {
            return;
        }
        for (topic, _) in &measured {
            *self.tables.entry((*topic).to_owned()).or_default() += 1;
        }
        let all: Vec<ValueRows<'_>> =
            measured.iter().map(|(_, columns)| ValueRows::from_columns(columns)).collect();
        let moves = |at: usize| all[at].has_changes(MIN_CHANGES);
        let is_arm = |columns: &Columns| matches!(columns, Columns::Joints(_));
        let arm_moves = (0..measured.len()).any(|at| is_arm(measured[at].1) && moves(at));
        for (at, (topic, columns)) in measured.iter().enumerate() {
            let of = |number: Option<String>, of: Option<String>| Repeat {
                topic: (*topic).to_owned(),
                number,
                of,
            };
            if !moves(at) {
                let is_still = !all[at].has_changes(1) && arm_moves && !is_arm(columns);
                self.add(is_still.then(|| of(None, None)));
                continue;
            }
            let first = (0..at).find(|&other| all[at].equals(&all[other]));
            self.add(first.map(|other| of(None, Some(measured[other].0.to_owned()))));
            if let Columns::Joints(joints) = columns {
                for (joint, other) in repeated_joints(joints) {
                    self.add(Some(of(Some(joint), other)));
                }
            }
        }
    }

    fn add(&mut self, repeat: Option<Repeat>) {
        if let Some(repeat) = repeat {
            *self.found.entry(repeat).or_default() += 1;
        }
    }

    pub fn in_all(self) -> Vec<Repeat> {
        let Self { tables, found } = self;
        let is_always =
            |(repeat, count): &(Repeat, usize)| tables.get(&repeat.topic) == Some(count);
        found.into_iter().filter(is_always).map(|(repeat, _)| repeat).collect()
    }
}

/// Rows, or the values of each joint; empty for other columns.
struct ValueRows<'a> {
    parts: Vec<Cow<'a, [f64]>>,
    /// Values per row.
    width: usize,
}

impl<'a> ValueRows<'a> {
    fn from_columns(columns: &'a Columns) -> Self {
        match columns {
            Columns::Array(array) => {
                Self { parts: vec![array.values.as_slice().into()], width: array.width.max(1) }
            }
            Columns::Poses(poses) => {
                let flattened = |xyz: Cow<'a, [[f64; 3]]>| match xyz {
                    Cow::Borrowed(xyz) => xyz.as_flattened().into(),
                    Cow::Owned(xyz) => xyz.into_flattened().into(),
                };
                let xyz = poses.iter().map(|poses| poses.xyz.to_slice());
                Self { parts: xyz.map(flattened).collect(), width: 3 }
            }
            Columns::Joints(joints) => {
                let positions = joints.joints.iter().map(|joint| joint.position.as_slice());
                Self { parts: positions.map(Cow::from).collect(), width: 1 }
            }
            _ => Self { parts: Vec::new(), width: 1 },
        }
    }

    fn of_joint(joint: &'a JointColumn) -> Self {
        Self { parts: vec![joint.position.as_slice().into()], width: 1 }
    }

    fn len(&self) -> usize {
        self.parts.iter().map(|part| part.len() / self.width).sum()
    }

    fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.parts.iter().flat_map(|part| part.chunks_exact(self.width))
    }

    /// Whether at least `count` rows differ from the previous one.
    fn has_changes(&self, count: usize) -> bool {
        let pairs = self.iter().zip(self.iter().skip(1));
        pairs.filter(|(a, b)| !are_bitwise_equal(a, b)).take(count).count() == count
    }

    fn equals(&self, other: &Self) -> bool {
        let mut rows = self.iter().zip(other.iter());
        self.len() == other.len() && rows.all(|(a, b)| are_bitwise_equal(a, b))
    }
}

/// Two measurements differ at least by noise.
fn are_bitwise_equal(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Joints that repeat an earlier one, or never move while others do. Fingers move together and are excluded.
fn repeated_joints(joints: &JointColumns) -> Vec<(String, Option<String>)> {
    let is_finger = |name: &str| names::is_gripper(&names::split_words(name));
    let arm: Vec<_> = joints.joints.iter().filter(|joint| !is_finger(&joint.name)).collect();
    let own: Vec<ValueRows<'_>> = arm.iter().map(|joint| ValueRows::of_joint(joint)).collect();
    let arm_moves = own.iter().any(|values| values.has_changes(MIN_CHANGES));
    let mut found = Vec::new();
    for (at, joint) in arm.iter().enumerate() {
        let moves = own[at].has_changes(MIN_CHANGES);
        let other = (0..at).find(|&other| moves && own[at].equals(&own[other]));
        if other.is_some() || (arm_moves && !own[at].has_changes(1)) {
            found.push((joint.name.clone(), other.map(|other| arm[other].name.clone())));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_is_constant_only_if_other_joints_of_the_arm_move() {
        let still = |name: &str| JointColumn::from_positions(name.to_owned(), vec![0.5; 40]);
        let moving = |name: &str| {
            let positions = (0..40).map(|row| 0.01 * f64::from(row)).collect();
            JointColumn::from_positions(name.to_owned(), positions)
        };
        let repeated = |joints: Vec<JointColumn>| {
            repeated_joints(&JointColumns { joints, ..JointColumns::default() })
        };
        let found = repeated(vec![moving("waist"), still("shoulder"), still("gripper")]);
        assert_eq!(found, [("shoulder".to_owned(), None)]);
        assert_eq!(repeated(vec![still("waist"), still("shoulder"), moving("gripper")]), []);
    }
}
