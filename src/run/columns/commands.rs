//! Joint commands in a table with named joints.
//!
//! Unnamed numbers are commands if they lead the joints. Named ones whose order contradicts their motion
//! are excluded.

use crate::diagnosis::{GroupShift, NumericTable};
use crate::log::{Log, Note, Topic};
use crate::run::joint_order::TABLE;
use crate::run::role::{Role, role_by_content, role_outside_arm};
use crate::stream::{Columns, JointColumn, JointColumns};

use super::cells::{is_unidentified, join_tables};

/// Maximum number of joints, as every pair is compared.
const MAX_JOINTS: usize = 16;
/// Minimum number of moving joints, and of swapped ones.
const MIN_MOVING_JOINTS: usize = 3;
const MIN_SWAPPED_JOINTS: usize = 2;
/// Maximum residual of one joint's columns, as a share of its spread, and minimum ratio for other joints.
const MAX_MATCH_RESIDUAL: f64 = 0.1;
const MIN_MISMATCH_RATIO: f64 = 3.0;

/// Turns unnamed numbers that lead joints into commands. Excludes and reports commands with contradicting
/// names.
pub(super) fn identify_commands(log: &mut Log) {
    let is_state = |topic: &&Topic| joint_role(topic) == Some(Role::Joints);
    let states: Vec<usize> = topic_indices(&log.topics, is_state);
    let commands = topic_indices(&log.topics, |topic| {
        let is_bare = is_unidentified(topic) && role_outside_arm(&topic.name) == Role::Reference;
        is_bare || joint_role(topic) == Some(Role::Reference)
    });
    for at in commands {
        for &state in &states {
            let Some(relation) = CommandRelation::detect(&log.topics[state], &log.topics[at])
            else {
                continue;
            };
            let name = log.topics[state].name.clone();
            let Some(Columns::Joints(joints)) = log.topics[state].columns.clone() else { continue };
            let topic = &mut log.topics[at];
            match relation {
                CommandRelation::Commands(lead_s) => {
                    topic.columns = topic.columns.take().map(|own| to_joint_commands(own, &joints));
                    topic.read_as = Some(format!(
                        "joint commands: its numbers match '{name}', {:.0} ms earlier",
                        1e3 * lead_s
                    ));
                }
                CommandRelation::Swapped(pairs) => {
                    let (own, others): (Vec<String>, Vec<String>) = pairs.into_iter().unzip();
                    let what = format!(
                        "'{}' and '{name}' name their joints in different orders: the first topic's {} moves \
                         like the second topic's {}",
                        topic.name,
                        own.join(", "),
                        others.join(", ")
                    );
                    topic.columns = None;
                    topic.unusable = Some(format!("its names contradict the names of '{name}'"));
                    if let Some(file) = log.files.first().map(|file| file.path.clone()) {
                        log.contradictions.get_or_insert_default().push(Note { file, what });
                    }
                }
            }
            break;
        }
    }
}

fn topic_indices(topics: &[Topic], is_it: impl Fn(&&Topic) -> bool) -> Vec<usize> {
    (0..topics.len()).filter(|&at| is_it(&&topics[at])).collect()
}

fn joint_role(topic: &Topic) -> Option<Role> {
    let columns = topic.columns.as_ref().filter(|_| topic.encoding == TABLE)?;
    matches!(columns, Columns::Joints(_))
        .then(|| role_by_content(&topic.name, columns).map(|(role, _)| role))
        .flatten()
}

enum CommandRelation {
    /// They lead the joints by this time, s.
    Commands(f64),
    /// Swapped names: name, and joint that it moves like.
    Swapped(Vec<(String, String)>),
}

impl CommandRelation {
    fn detect(state: &Topic, command: &Topic) -> Option<Self> {
        let Some(Columns::Joints(joints)) = &state.columns else { return None };
        let count = joints.joints.len();
        let names: Vec<&str> = match &command.columns {
            Some(Columns::Joints(own)) => {
                own.joints.iter().map(|joint| joint.name.as_str()).collect()
            }
            Some(Columns::Array(own)) if own.width == count => {
                joints.joints.iter().map(|joint| joint.name.as_str()).collect()
            }
            _ => return None,
        };
        let place = |joint: &JointColumn| names.iter().position(|name| *name == joint.name);
        let of_state: Vec<usize> = joints.joints.iter().map(place).collect::<Option<_>>()?;
        if names.len() != count || count > MAX_JOINTS || !joints.conversions.is_empty() {
            return None;
        }
        let factor = if joints.converted_from_degrees { 1_f64.to_radians() } else { 1.0 };
        let is_bare = matches!(command.columns, Some(Columns::Array(_)));
        let table = join_tables(&[(state, 1.0), (command, if is_bare { factor } else { 1.0 })])?;
        let arms: Vec<usize> = (0..count)
            .filter(|&at| {
                !["gripper", "finger", "jaw"].iter().any(|of| joints.joints[at].name.contains(of))
                    && table.moves(at)
            })
            .collect();
        if arms.len() < MIN_MOVING_JOINTS {
            return None;
        }
        let shift = |joint: usize, other: usize| -> Option<GroupShift> {
            table.group_shift(&[joint], &[count + of_state[other]])
        };
        let own: Vec<Option<GroupShift>> = arms.iter().map(|&joint| shift(joint, joint)).collect();
        if is_bare {
            let own: Vec<GroupShift> = own.into_iter().collect::<Option<_>>()?;
            let lead_s = own.iter().map(|shift| -shift.delay_s).sum::<f64>() / own.len() as f64;
            return (lead_s > -table.step_s()).then_some(Self::Commands(lead_s));
        }
        find_swapped(&arms, &own, shift, &table).map(|pairs| {
            let name = |at: usize| joints.joints[at].name.clone();
            Self::Swapped(pairs.into_iter().map(|(own, other)| (name(own), name(other))).collect())
        })
    }
}

/// Pairs of joints with swapped commands. `None` unless they form a unique permutation.
fn find_swapped(
    arms: &[usize],
    own: &[Option<GroupShift>],
    shift: impl Fn(usize, usize) -> Option<GroupShift>,
    table: &NumericTable,
) -> Option<Vec<(usize, usize)>> {
    let mut pairs = Vec::new();
    for (&joint, own) in arms.iter().zip(own) {
        if own.is_some_and(|own| own.residual < MIN_MISMATCH_RATIO * MAX_MATCH_RESIDUAL) {
            continue;
        }
        let others = arms.iter().filter(|&&other| other != joint);
        let found = others.filter_map(|&other| Some((other, shift(joint, other)?)));
        let mut found: Vec<(usize, GroupShift)> = found.collect();
        found.sort_by(|a, b| a.1.residual.total_cmp(&b.1.residual));
        let (other, best) = *found.first()?;
        let is_only =
            found.get(1).is_none_or(|(_, next)| next.residual > MIN_MISMATCH_RATIO * best.residual);
        if best.residual > MAX_MATCH_RESIDUAL || best.delay_s > table.step_s() || !is_only {
            return None;
        }
        pairs.push((other, joint));
    }
    let mut whose: Vec<usize> = pairs.iter().map(|(own, _)| *own).collect();
    let mut moved: Vec<usize> = pairs.iter().map(|(_, other)| *other).collect();
    whose.sort_unstable();
    moved.sort_unstable();
    (pairs.len() >= MIN_SWAPPED_JOINTS && whose == moved).then_some(pairs)
}

fn to_joint_commands(numbers: Columns, joints: &JointColumns) -> Columns {
    let Columns::Array(array) = numbers else { return numbers };
    let factor = if joints.converted_from_degrees { 1_f64.to_radians() } else { 1.0 };
    let rows = array.times.len();
    let column = |(at, joint): (usize, &JointColumn)| {
        let position = (0..rows).map(|row| factor * array.row(row)[at]).collect();
        JointColumn::from_positions(joint.name.clone(), position)
    };
    Columns::Joints(JointColumns {
        joints: joints.joints.iter().enumerate().map(column).collect(),
        not_finite: array.not_finite,
        unnamed: joints.unnamed,
        converted_from_degrees: joints.converted_from_degrees,
        times: array.times,
        ..JointColumns::default()
    })
}
