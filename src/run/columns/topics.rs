//! Rewrites table topics after identification.

use crate::diagnosis::{ColumnContent, JointValueUnit};
use crate::log::{Log, TableCell, Topic};
use crate::robot::Chain;
use crate::stream::{ArrayColumns, Column, Columns, JointColumn, JointColumns, PoseColumns};

use super::cells::{is_unidentified, selectors};
use super::roles::IdentifiedArm;
use super::{ColumnSearch, IdentifiedColumns};

const SIDES: [&str; 2] = ["first/", "second/"];

/// Reasons for unidentified numbers.
const NAME_UNKNOWN: &str = "its name does not identify it";
const MATCHES_NOTHING: &str =
    "neither a joint nor part of the pose, and it matches none of their columns";
const NOT_AN_ARM: &str = "neither joints nor a pose of the arm";

/// Whether numbers with this reason may be anything, such as a rotation.
fn may_be_rotation(reason: &str) -> bool {
    [NAME_UNKNOWN, MATCHES_NOTHING, NOT_AN_ARM].contains(&reason)
}

/// Replaces unnamed numbers by identified topics. The rest get a reason each.
pub(super) fn rewrite(log: &mut Log, search: &ColumnSearch<'_>, identified: &IdentifiedColumns) {
    let made: Vec<Topic> = identified
        .arms
        .iter()
        .zip(SIDES)
        .flat_map(|(arm, side)| {
            let prefix = if identified.arms.len() > 1 { side } else { "" };
            arm_topics(log, search, arm, prefix)
        })
        .collect();
    let used: Vec<usize> = identified.arms.iter().flat_map(IdentifiedArm::all_columns).collect();
    let others: Vec<&(Vec<usize>, String)> =
        identified.arms.iter().flat_map(|arm| &arm.others).collect();
    let has_pose = identified.arms.iter().any(|arm| !arm.pose.is_empty());
    let mut topics = Vec::with_capacity(log.topics.len());
    for (index, topic) in std::mem::take(&mut log.topics).into_iter().enumerate() {
        let is_used = |part: usize| {
            let at = search.cells.column((index, part));
            at.is_some_and(|at| used.contains(&at))
        };
        let count = topic.cells.len();
        let is_whole = (0..count).all(|part| !is_used(part));
        if !is_unidentified(&topic) || (is_whole && count > 1 && !has_pose) {
            topics.push(topic);
            continue;
        }
        let remaining: Vec<usize> = (0..count)
            .filter(|&part| {
                let at = search.cells.column((index, part));
                !is_used(part)
                    || others.iter().any(|(columns, _)| at.is_some_and(|at| columns.contains(&at)))
            })
            .collect();
        if remaining.is_empty() {
            continue;
        }
        let mut runs: Vec<(Vec<usize>, String)> = Vec::new();
        for part in remaining {
            let reason = match is_whole && count > 1 {
                true => NOT_AN_ARM.to_owned(),
                false => search.exclusion_reason((index, part), &used, &others),
            };
            match runs.last_mut() {
                Some((run, last)) if *last == reason && run.last() == Some(&(part - 1)) => {
                    run.push(part)
                }
                _ => runs.push((vec![part], reason)),
            }
        }
        for (run, reason) in runs {
            // Copies and constants are not a rotation.
            let cell = |&part: &usize| TableCell {
                is_unidentified: topic.cells[part].is_unidentified && may_be_rotation(&reason),
                ..topic.cells[part].clone()
            };
            let cells: Vec<TableCell> = run.iter().map(cell).collect();
            let names: Vec<String> = cells.iter().map(|cell| cell.name.clone()).collect();
            topics.push(Topic {
                name: selectors(&names).concat(),
                type_name: type_name(&topic, run.len()),
                cells,
                unusable: Some(reason),
                ..topic_like(&topic)
            });
        }
    }
    topics.extend(made);
    topics.sort_by(|a, b| (&a.name, &a.type_name).cmp(&(&b.name, &b.type_name)));
    log.topics = topics;
}

/// Excludes single unidentified numbers if names give joints and pose.
pub(super) fn exclude_singles(log: &mut Log) {
    for topic in
        log.topics.iter_mut().filter(|topic| is_unidentified(topic) && topic.cells.len() == 1)
    {
        topic.columns = None;
        topic.unusable = topic.read_as.take();
    }
}

fn topic_like(topic: &Topic) -> Topic {
    Topic {
        name: topic.name.clone(),
        type_name: topic.type_name.clone(),
        encoding: topic.encoding.clone(),
        messages: topic.messages,
        span: topic.span,
        ..Topic::default()
    }
}

fn type_name(topic: &Topic, count: usize) -> String {
    let one = topic.type_name.split('[').next().unwrap_or_default();
    if count == 1 { one.to_owned() } else { format!("{one}[{count}]") }
}

fn arm_topics(
    log: &Log,
    search: &ColumnSearch<'_>,
    arm: &IdentifiedArm,
    prefix: &str,
) -> Vec<Topic> {
    let topic = |name: &str, columns: &[usize], why: &str, made: Columns| {
        let numbers = &search.cells.numbers;
        let like = &log.topics[numbers[columns[0]].at.0];
        Topic {
            name: format!("{prefix}{name}"),
            type_name: type_name(like, columns.len()),
            cells: columns.iter().map(|&at| numbers[at].cell.clone()).collect(),
            read_as: Some(why.to_owned()),
            columns: Some(made),
            ..topic_like(like)
        }
    };
    let mut topics = Vec::new();
    let is_open = |columns: &[usize]| {
        columns.iter().all(|&at| search.cells.numbers[at].kind == super::NumberKind::Unidentified)
    };
    let chain = search.chain_of(arm);
    let joints = |columns: &[usize], velocities: &[usize]| {
        let numbers = array(log, search, &[columns, velocities].concat());
        joints(numbers, columns.len(), arm.mapping.unit, chain)
    };
    let own = &arm.mapping.joints;
    if is_open(own) {
        let velocities = arm.velocities.as_deref().filter(|own| is_open(own)).unwrap_or_default();
        let made = topic("joints", own, &arm.joints_why, joints(own, velocities));
        let velocity_cells =
            velocities.iter().map(|&at| search.cells.numbers[at].cell.clone()).collect();
        topics.push(Topic { velocity_cells, ..made });
    }
    if let Some((columns, why)) = &arm.joint_commands {
        topics.push(topic("joint_commands", columns, why, joints(columns, &[])));
    }
    let pose = |columns: &[usize]| match array(log, search, columns) {
        position if position.width == 3 => Columns::Poses(vec![positions(position)]),
        numbers => Columns::Array(numbers),
    };
    if is_open(&arm.pose) && !arm.pose.is_empty() {
        let name = if arm.is_pose_command { "pose_commands" } else { "pose" };
        topics.push(topic(name, &arm.pose, &arm.pose_why, pose(&arm.pose)));
    }
    if let Some((columns, why)) = &arm.pose_commands {
        topics.push(topic("pose_commands", columns, why, pose(columns)));
    }
    topics
}

fn array(log: &Log, search: &ColumnSearch<'_>, columns: &[usize]) -> ArrayColumns {
    let of = |&column: &usize| {
        let (topic, part) = search.cells.numbers[column].at;
        match &log.topics[topic].columns {
            Some(Columns::Array(array)) => Some((array, part)),
            _ => None,
        }
    };
    let all: Vec<(&ArrayColumns, usize)> = columns.iter().filter_map(of).collect();
    let mut made = ArrayColumns { width: columns.len(), ..ArrayColumns::default() };
    let Some((first, _)) = all.first() else { return made };
    let mut places: Vec<usize> = vec![0; all.len()];
    for (row, (&header, &received)) in first.times.header.iter().zip(&first.times.log).enumerate() {
        places[0] = row;
        let found = all.iter().zip(&mut places).all(|((array, _), place)| {
            while array.times.log.get(*place).is_some_and(|other| *other < received) {
                *place += 1;
            }
            array.times.log.get(*place) == Some(&received)
        });
        if found {
            made.times.push(header, received, received);
            made.values
                .extend(all.iter().zip(&places).map(|((array, part), at)| array.row(*at)[*part]));
        }
    }
    made.not_finite = all.iter().map(|(array, _)| array.not_finite).max().unwrap_or(0);
    made
}

fn joints(
    array: ArrayColumns,
    count: usize,
    unit: JointValueUnit,
    chain: Option<&Chain>,
) -> Columns {
    let degrees = unit == JointValueUnit::Degrees;
    let lines: Vec<[f64; 2]> = match (unit, chain) {
        (JointValueUnit::Ticks { .. } | JointValueUnit::Shares, Some(chain)) => {
            (0..count).map(|joint| <[f64; 2]>::from(unit.factor_and_offset(chain, joint))).collect()
        }
        _ => Vec::new(),
    };
    let factor = if degrees { 1_f64.to_radians() } else { 1.0 };
    let column = |joint: usize| {
        let numbers = |at: usize| array.values.iter().skip(at).step_by(array.width);
        let [factor, offset] = lines.get(joint).copied().unwrap_or([factor, 0.0]);
        JointColumn {
            name: format!("q{}", joint + 1),
            position: numbers(joint).map(|q| factor * q + offset).collect(),
            velocity: match count + joint < array.width {
                true => numbers(count + joint).map(|rate| factor * rate).collect(),
                false => Column::constant(f64::NAN, array.times.len()),
            },
        }
    };
    Columns::Joints(JointColumns {
        joints: (0..count).map(column).collect(),
        times: array.times.clone(),
        not_finite: array.not_finite,
        unnamed: true,
        converted_from_degrees: degrees,
        conversions: lines,
        ..JointColumns::default()
    })
}

fn positions(array: ArrayColumns) -> PoseColumns {
    PoseColumns {
        xyz: array.values.chunks_exact(3).map(|row| [row[0], row[1], row[2]]).collect(),
        q_xyzw: Column::constant([0.0; 4], array.times.len()),
        not_finite: array.not_finite,
        times: array.times.into(),
        ..PoseColumns::default()
    }
}

impl ColumnSearch<'_> {
    /// How a number behaves that is neither joint nor pose.
    fn exclusion_reason(
        &self,
        number: (usize, usize),
        used: &[usize],
        others: &[&(Vec<usize>, String)],
    ) -> String {
        let at = self.cells.column(number);
        let Some(at) = at else { return NAME_UNKNOWN.to_owned() };
        if let Some((_, why)) = others.iter().find(|(columns, _)| columns.contains(&at)) {
            return why.clone();
        }
        let name = |at: usize| selectors(&[self.cells.numbers[at].cell.name.clone()]).concat();
        match self.cells.table.content(at, used) {
            ColumnContent::Constant => "it never changes".to_owned(),
            ColumnContent::TwoLevels => {
                "it takes two values, like a gripper or a switch".to_owned()
            }
            ColumnContent::CopyOf(other, shift) if shift.delay_s == 0.0 => {
                format!("a copy of {}", name(other))
            }
            ColumnContent::CopyOf(other, shift) => {
                let when = if shift.delay_s > 0.0 { "later" } else { "earlier" };
                format!("a copy of {}, {:.0} ms {when}", name(other), 1e3 * shift.delay_s.abs())
            }
            ColumnContent::RateOf(other) => format!("the rate of {}", name(other)),
            ColumnContent::Independent if used.is_empty() => NAME_UNKNOWN.to_owned(),
            ColumnContent::Independent => MATCHES_NOTHING.to_owned(),
        }
    }
}
