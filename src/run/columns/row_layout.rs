//! The meaning of a table's columns as a value of `--columns`.

use crate::geometry::{AngleUnit, Convention, LengthScale, RotationEncoding, Units};
use crate::log::{
    Cell, LayoutItem, Log, Meaning, RotationLabels, RowLayout, TableCell, TableShape, Topic,
};
use crate::run::role::{Role, names_object, role_by_content, role_outside_arm};
use crate::stream::{Columns, JointColumns};

use super::cells::is_unidentified;
use super::named_units::named_units;

/// Columns with one meaning, in order.
pub(super) struct Assignment {
    pub arm: Option<String>,
    pub is_command: bool,
    pub content: Content,
    pub cells: Vec<TableCell>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Content {
    Joints(Option<AngleUnit>),
    Velocities,
    /// Position, then rotation. A matrix includes the position.
    Pose(Option<RotationLabels>),
}

/// One column of an assignment.
#[derive(Clone, PartialEq)]
struct Part {
    arm: Option<String>,
    is_command: bool,
    meaning: Meaning,
    units: Units,
    /// Index in the meaning, and its width.
    within: (usize, usize),
}

/// Layout of the table with this index. `None` if the columns have no order that a layout can state.
pub(super) fn layout(
    shape: &TableShape,
    table: usize,
    assignments: &[Assignment],
) -> Option<RowLayout> {
    let place = |cell: Cell| shape.numbers.iter().position(|number| number.at == Some(cell));
    let mut parts: Vec<Option<Part>> = vec![None; shape.numbers.len()];
    for assignment in assignments {
        let own = assignment.cells.iter();
        let own = own.map(|cell| place(cell.at).filter(|_| cell.table == table));
        let places: Vec<usize> = own.collect::<Option<_>>()?;
        for (place, part) in assignment.parts(&places)? {
            parts[place] = Some(part);
        }
    }
    let row = |meaning: Meaning| Part {
        arm: None,
        is_command: false,
        meaning,
        units: Units::default(),
        within: (0, 1),
    };
    if let Some(at) = shape.time.and_then(place) {
        let meaning = if shape.nanos.is_some() { Meaning::Seconds } else { Meaning::Time };
        parts[at] = Some(row(meaning));
    }
    if let Some(at) = shape.nanos.and_then(place) {
        parts[at] = Some(row(Meaning::Nanoseconds));
    }
    let mut items: Vec<LayoutItem> = Vec::new();
    let mut last: Option<Part> = None;
    for part in parts {
        let part = part.unwrap_or_else(|| row(Meaning::Ignored));
        let is_next = last.as_ref().is_some_and(|last| part.continues(last));
        match items.last_mut() {
            Some(item) if is_next => item.count += 1,
            _ => items.push(LayoutItem {
                arm: part.arm.clone(),
                is_command: part.is_command,
                time_unit_s: shape.time_unit_s.filter(|_| part.meaning == Meaning::Time),
                units: part.units,
                ..LayoutItem::new(part.meaning, 1)
            }),
        }
        last = Some(part);
    }
    RowLayout::new(items, shape.rate_hz).ok()
}

impl Part {
    fn continues(&self, last: &Self) -> bool {
        let is_same = self.meaning == last.meaning
            && (&self.arm, self.is_command, self.units) == (&last.arm, last.is_command, last.units);
        let is_repeated =
            matches!(self.meaning, Meaning::Ignored | Meaning::Joints | Meaning::JointVelocities);
        is_same && (is_repeated || self.within.0 > 0)
    }
}

impl Assignment {
    /// Places with their parts. `None` if joints are not in the order of the columns.
    fn parts(&self, places: &[usize]) -> Option<Vec<(usize, Part)>> {
        let part = |meaning: Meaning, units: Units, within: (usize, usize)| Part {
            arm: self.arm.clone(),
            is_command: self.is_command,
            meaning,
            units,
            within,
        };
        let are_ordered = places.windows(2).all(|pair| pair[0] < pair[1]);
        let all = |meaning: Meaning, angle: Option<AngleUnit>| {
            let (count, units) = (places.len(), Units { length: None, angle });
            let parts = places.iter().enumerate();
            parts.map(|(at, &place)| (place, part(meaning, units, (at, count)))).collect()
        };
        match self.content {
            Content::Joints(angle) => are_ordered.then(|| all(Meaning::Joints, angle)),
            Content::Velocities => are_ordered.then(|| all(Meaning::JointVelocities, None)),
            Content::Pose(labels) => {
                let is_run = |places: &[usize]| places.windows(2).all(|it| it[0] + 1 == it[1]);
                if matches!(places.len(), 12 | 16) {
                    return is_run(places).then(|| all(Meaning::Matrix, None));
                }
                let (position, rotation) = places.split_at_checked(3)?;
                let names: Vec<String> = self.cells.iter().map(|cell| cell.name.clone()).collect();
                let Units { length, angle } = named_units(&names);
                let of_position = Units {
                    length: length.filter(|unit| *unit != LengthScale::default()),
                    angle: None,
                };
                let of_rotation = Units {
                    length: None,
                    angle: angle.filter(|unit| *unit != AngleUnit::default()),
                };
                let mut parts: Vec<(usize, Part)> = position
                    .iter()
                    .enumerate()
                    .map(|(axis, &place)| (place, part(Meaning::Axis(axis), of_position, (0, 1))))
                    .collect();
                let count = rotation.len();
                match (count, labels) {
                    (4, Some(RotationLabels::Quaternion)) => {
                        let own = rotation.iter().enumerate();
                        parts.extend(own.map(|(at, &place)| {
                            (place, part(Meaning::QuaternionPart(at), Units::default(), (0, 1)))
                        }));
                    }
                    (3 | 4, _) if is_run(rotation) => {
                        let coding = match (count, labels) {
                            (3, Some(RotationLabels::RotationVector)) => {
                                Some(RotationEncoding::Three(Convention::RotVec))
                            }
                            (4, Some(RotationLabels::ScalarFirst)) => Some(RotationEncoding::Wxyz),
                            _ => None,
                        };
                        let own = rotation.iter().enumerate();
                        parts.extend(own.map(|(at, &place)| {
                            (place, part(Meaning::Rotation(coding), of_rotation, (at, count)))
                        }));
                    }
                    // Without its rotation, the pose is a position.
                    _ => {}
                }
                Some(parts)
            }
        }
    }
}

/// Assignments of the topics of one table.
pub(super) fn assignments(topics: &[Topic], table: usize) -> Option<Vec<Assignment>> {
    let is_object = |topic: &Topic| {
        let is_pose = matches!(topic.columns, Some(Columns::Poses(_) | Columns::Array(_)));
        is_pose && names_object(&topic.name)
    };
    // A long table has several streams in the same columns.
    let is_first = |topic: &Topic| topics.iter().find(|it| it.cells == topic.cells);
    let own = topics.iter().filter(|topic| {
        topic.cells.first().is_some_and(|cell| cell.table == table)
            && !is_unidentified(topic)
            && !is_object(topic)
            && is_first(topic).is_some_and(|first| first.name == topic.name)
    });
    let mut assigned = Vec::new();
    for topic in own.clone() {
        let (Some(columns), Some(role)) = (&topic.columns, role_of(topic)) else { continue };
        let are_joints = |topic: &Topic| matches!(topic.columns, Some(Columns::Joints(_)));
        let is_alike =
            |other: &&Topic| role_of(other) == Some(role) && are_joints(other) == are_joints(topic);
        // Its name makes it a target.
        let is_named = role == Role::Target || own.clone().filter(is_alike).count() > 1;
        let arm = match (is_named, topic.name.split_once('/')) {
            (false, None) => None,
            (false, Some((arm, _))) if !["first", "second"].contains(&arm) => None,
            (false, Some((arm, _))) => Some(arm.to_owned()),
            (true, Some((arm, _))) => Some(arm.replace([',', ':', '='], "_")),
            (true, None) => Some(topic.name.replace([',', ':', '=', '/'], "_")),
        };
        let is_command = role == Role::Reference;
        let assignment = |content: Content, cells: &[TableCell]| Assignment {
            arm: arm.clone(),
            is_command,
            content,
            cells: cells.to_vec(),
        };
        match columns {
            Columns::Joints(joints) => {
                assigned.push(assignment(Content::Joints(unit_of(joints)?), &topic.cells));
                if topic.velocity_cells.first().is_some_and(|cell| cell.table == table) {
                    assigned.push(assignment(Content::Velocities, &topic.velocity_cells));
                }
            }
            Columns::Poses(_) | Columns::Array(_) => {
                let labels = topic.cells.get(3).and_then(|cell| cell.labels);
                assigned.push(assignment(Content::Pose(labels), &topic.cells));
            }
            _ => {}
        }
    }
    // Velocities of joints in another table.
    let has_only_velocities = |topic: &&Topic| {
        let is_own = |cells: &[TableCell]| cells.first().is_some_and(|cell| cell.table == table);
        is_own(&topic.velocity_cells) && !is_own(&topic.cells)
    };
    assigned.extend(topics.iter().filter(has_only_velocities).map(|topic| Assignment {
        arm: None,
        is_command: role_of(topic) == Some(Role::Reference),
        content: Content::Velocities,
        cells: topic.velocity_cells.clone(),
    }));
    Some(assigned)
}

fn role_of(topic: &Topic) -> Option<Role> {
    let columns = topic.columns.as_ref()?;
    match columns {
        Columns::Poses(_) | Columns::Array(_) => Some(role_outside_arm(&topic.name)),
        _ => role_by_content(&topic.name, columns).map(|(role, _)| role),
    }
}

/// Unit of the numbers; outer `None` if no unit converts them, or the names give another order.
fn unit_of(joints: &JointColumns) -> Option<Option<AngleUnit>> {
    let degree = AngleUnit::Degree;
    let unit = match joints.conversions.as_slice() {
        [] => joints.converted_from_degrees.then_some(degree),
        lines if lines.iter().all(|line| *line == [1.0, 0.0]) => None,
        lines if lines.iter().all(|line| *line == [degree.in_rad(), 0.0]) => Some(degree),
        _ => return None,
    };
    let number = |name: &str| -> Option<usize> {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        digits.trim_end_matches(|c: char| !c.is_ascii_digit()).parse().ok()
    };
    let numbers: Vec<Option<usize>> =
        joints.joints.iter().map(|joint| number(&joint.name)).collect();
    let are_counted =
        || numbers.iter().all(Option::is_some) && numbers.windows(2).all(|it| it[0] < it[1]);
    let is_ur = || joints.joints.first().is_some_and(|it| it.name.ends_with("shoulder_pan_joint"));
    (joints.unnamed || are_counted() || is_ur()).then_some(unit)
}

/// Sets the layout of each table that was read without one.
pub(super) fn describe_tables(log: &mut Log) {
    for table in 0..log.tables.len() {
        if log.tables[table].layout.is_some() {
            continue;
        }
        let known = assignments(&log.topics, table);
        let layout = known.and_then(|known| layout(&log.tables[table], table, &known));
        log.tables[table].layout = layout.map(|layout| layout.to_string());
    }
}
