//! Joint commands in a table with named joints.
//!
//! Unnamed numbers are commands if they lead the joints. Named ones whose order contradicts their motion
//! are excluded.

use crate::diagnosis::{GroupShift, NumericTable};
use crate::log::{Log, Note, Topic};
use crate::run::by_order::TABLE;
use crate::run::role::{Role, beside_arm, plain_role};
use crate::stream::{Columns, JointColumn, JointColumns};

use super::cells::{is_open, side_by_side};

/// Maximum number of joints, as every pair is compared.
const MOST_JOINTS: usize = 16;
/// Minimum number of moving joints, and of swapped ones.
const MOVING: usize = 3;
const SWAPPED: usize = 2;
/// Maximum residual of one joint's columns, as a share of its spread, and minimum ratio for other joints.
const SAME: f64 = 0.1;
const OTHER: f64 = 3.0;

/// Turns unnamed numbers that lead joints into commands. Excludes and reports commands with contradicting
/// names.
pub(super) fn settle(log: &mut Log) {
    let is_state = |topic: &&Topic| role(topic) == Some(Role::Joints);
    let states: Vec<usize> = places(&log.topics, is_state);
    let commands = places(&log.topics, |topic| {
        let is_bare = is_open(topic) && beside_arm(&topic.name) == Role::Reference;
        is_bare || role(topic) == Some(Role::Reference)
    });
    for at in commands {
        for &state in &states {
            let Some(way) = Way::of(&log.topics[state], &log.topics[at]) else { continue };
            let name = log.topics[state].name.clone();
            let Some(Columns::Joints(joints)) = log.topics[state].columns.clone() else { continue };
            let topic = &mut log.topics[at];
            match way {
                Way::Commands(lead_s) => {
                    topic.columns = topic.columns.take().map(|own| commanded(own, &joints));
                    topic.read_as = Some(format!(
                        "joint commands: its numbers match '{name}', {:.0} ms earlier",
                        1e3 * lead_s
                    ));
                }
                Way::Swapped(pairs) => {
                    let (own, others): (Vec<String>, Vec<String>) = pairs.into_iter().unzip();
                    let what = format!(
                        "'{}' and '{name}' name their joints in different orders: the first topic's {} moves \
                         like the second topic's {}",
                        topic.name,
                        own.join(", "),
                        others.join(", ")
                    );
                    topic.columns = None;
                    topic.unusable = Some(format!("its names contradict those of '{name}'"));
                    if let Some(file) = log.files.first().map(|file| file.path.clone()) {
                        log.contradictions.get_or_insert_default().push(Note { file, what });
                    }
                }
            }
            break;
        }
    }
}

fn places(topics: &[Topic], is_it: impl Fn(&&Topic) -> bool) -> Vec<usize> {
    (0..topics.len()).filter(|&at| is_it(&&topics[at])).collect()
}

fn role(topic: &Topic) -> Option<Role> {
    let columns = topic.columns.as_ref().filter(|_| topic.encoding == TABLE)?;
    matches!(columns, Columns::Joints(_))
        .then(|| plain_role(&topic.name, columns).map(|(role, _)| role))
        .flatten()
}

enum Way {
    /// They lead the joints by this time, s.
    Commands(f64),
    /// Swapped names: name, and joint that it moves like.
    Swapped(Vec<(String, String)>),
}

impl Way {
    fn of(state: &Topic, command: &Topic) -> Option<Self> {
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
        if names.len() != count || count > MOST_JOINTS {
            return None;
        }
        if !joints.conversions.is_empty() {
            return None;
        }
        let factor = if joints.converted_from_degrees { 1_f64.to_radians() } else { 1.0 };
        let is_bare = matches!(command.columns, Some(Columns::Array(_)));
        let sheet = side_by_side(&[(state, 1.0), (command, if is_bare { factor } else { 1.0 })])?;
        let arms: Vec<usize> = (0..count)
            .filter(|&at| {
                !["gripper", "finger", "jaw"].iter().any(|of| joints.joints[at].name.contains(of))
                    && sheet.moves(at)
            })
            .collect();
        if arms.len() < MOVING {
            return None;
        }
        let shift = |joint: usize, other: usize| -> Option<GroupShift> {
            sheet.group_shift(&[joint], &[count + of_state[other]])
        };
        let own: Vec<Option<GroupShift>> = arms.iter().map(|&joint| shift(joint, joint)).collect();
        if is_bare {
            let own: Vec<GroupShift> = own.into_iter().collect::<Option<_>>()?;
            let lead_s = own.iter().map(|shift| -shift.delay_s).sum::<f64>() / own.len() as f64;
            return (lead_s > -sheet.step_s()).then_some(Self::Commands(lead_s));
        }
        swapped(&arms, &own, shift, &sheet).map(|pairs| {
            let name = |at: usize| joints.joints[at].name.clone();
            Self::Swapped(pairs.into_iter().map(|(own, other)| (name(own), name(other))).collect())
        })
    }
}

/// Pairs of joints with swapped commands. `None` unless they form a unique permutation.
fn swapped(
    arms: &[usize],
    own: &[Option<GroupShift>],
    shift: impl Fn(usize, usize) -> Option<GroupShift>,
    sheet: &NumericTable,
) -> Option<Vec<(usize, usize)>> {
    let mut pairs = Vec::new();
    for (&joint, own) in arms.iter().zip(own) {
        if own.is_some_and(|own| own.residual < OTHER * SAME) {
            continue;
        }
        let others = arms.iter().filter(|&&other| other != joint);
        let found = others.filter_map(|&other| Some((other, shift(joint, other)?)));
        let mut found: Vec<(usize, GroupShift)> = found.collect();
        found.sort_by(|a, b| a.1.residual.total_cmp(&b.1.residual));
        let (other, best) = *found.first()?;
        let is_only = found.get(1).is_none_or(|(_, next)| next.residual > OTHER * best.residual);
        if best.residual > SAME || best.delay_s > sheet.step_s() || !is_only {
            return None;
        }
        pairs.push((other, joint));
    }
    let mut whose: Vec<usize> = pairs.iter().map(|(own, _)| *own).collect();
    let mut moved: Vec<usize> = pairs.iter().map(|(_, other)| *other).collect();
    whose.sort_unstable();
    moved.sort_unstable();
    (pairs.len() >= SWAPPED && whose == moved).then_some(pairs)
}

fn commanded(numbers: Columns, joints: &JointColumns) -> Columns {
    let Columns::Array(array) = numbers else { return numbers };
    let factor = if joints.converted_from_degrees { 1_f64.to_radians() } else { 1.0 };
    let rows = array.times.len();
    let column = |(at, joint): (usize, &JointColumn)| JointColumn {
        name: joint.name.clone(),
        position: (0..rows).map(|row| factor * array.row(row)[at]).collect(),
        velocity: vec![f64::NAN; rows],
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
