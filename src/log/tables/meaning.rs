//! What the columns of a table hold, by the caller's word, else by their names. What neither says is left
//! as bare numbers.

mod said;

use std::collections::BTreeMap;

use super::clock::Clock;
use super::names::{self, Axis, Part};
use super::{Column, ColumnSettings, Found, Refusal, Table, array, positions};
use crate::TableCell;
use crate::rtde::JOINTS as UR_JOINTS;
use ground::stream::{ArrayColumns, Columns, JointColumn, JointColumns, Times, usable};

/// Joints that an arm has, at least and at most, and its gripper with it.
const JOINTS: std::ops::RangeInclusive<usize> = 4..=8;
/// Names that LeRobot gives to columns that are no measurement.
const COUNTERS: &[&str] = &["frame_index", "episode_index", "index", "task_index"];

/// One number of a row.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Cell {
    column: usize,
    part: usize,
}

/// What some cells are together.
enum Meaning {
    /// Positions of joints of these names; whether nobody said the names.
    Joints { names: Vec<String>, unnamed: bool, lines: Vec<[f64; 2]> },
    /// Position, and what is logged of the rotation.
    Pose,
    /// A position alone.
    Position,
    /// Bare numbers, or a single one.
    Numbers,
    /// Of no use.
    Nothing,
}

struct Group {
    topic: String,
    cells: Vec<Cell>,
    meaning: Meaning,
    why: String,
}

/// The topics that the columns of `table` are.
///
/// # Errors
/// Where the caller names columns that it does not have.
pub(super) fn of(
    table: &Table,
    clock: &Clock,
    settings: &ColumnSettings,
) -> Result<Vec<Found>, Refusal> {
    let mut groups = said::said(table, settings)?;
    let is_taken =
        |groups: &[Group], cell: &Cell| groups.iter().any(|group| group.cells.contains(cell));
    let is_clock = |cell: &Cell| clock.cell == Some((cell.column, cell.part));
    let is_open = |at: usize, column: &Column| {
        let is_stamp = column.width == 1 && clock.cell == Some((at, 0));
        !is_stamp && !COUNTERS.contains(&column.name.as_str()) && column.width > 0
    };
    let open: Vec<usize> =
        (0..table.columns.len()).filter(|&at| is_open(at, &table.columns[at])).collect();
    let named: Vec<Cell> = open
        .iter()
        .flat_map(|&column| cells(table, column))
        .filter(|cell| !is_taken(&groups, cell))
        .collect();
    let by_name = named_groups(table, &named);
    groups.extend(by_name);
    for column in open {
        let all = (0..table.columns[column].width).map(|part| Cell { column, part });
        let free: Vec<Cell> =
            all.filter(|cell| !is_taken(&groups, cell) && !is_clock(cell)).collect();
        match free.len() {
            0 => {}
            count if count == table.columns[column].width => {
                groups.push(whole(&table.columns[column], free));
            }
            _ if settings.says_all() => {}
            _ => groups.push(rest(&table.columns[column], free)),
        }
    }
    join_parts(table, &mut groups);
    distinct(&mut groups);
    let most = groups.iter().map(|group| group.most(table)).fold(0.0, f64::max);
    Ok(groups.into_iter().map(|group| group.found(table, clock, most)).collect())
}

/// Two turns: a joint whose positions go beyond these logs no rad.
const TWO_TURNS: f64 = 4.0 * std::f64::consts::PI;

/// Words of names that say that numbers are rad.
const RADIANS: &[&str] = &["rad", "rads", "radian", "radians"];

/// Why joints whose numbers are too large for rad are no degrees either, where the numbers say so by
/// themselves.
fn no_degrees(table: &Table, cells: &[Cell], most: f64) -> Option<String> {
    /// More than two turns in degrees, the ends of shares of a range, and joints that must reach one.
    const TURNS: f64 = 720.0;
    const END: f64 = 100.0;
    const REACH: usize = 2;
    if most > TURNS {
        return Some(
            "degrees do not go so far either: ticks of an encoder, or another unit".to_owned(),
        );
    }
    let reaches = |cell: &&Cell| {
        let column = &table.columns[cell.column];
        column.values.iter().skip(cell.part).step_by(column.width).any(|value| value.abs() == END)
    };
    let is_share = most == END && cells.iter().filter(reaches).count() >= REACH;
    is_share.then(|| "several end at exactly 100, as shares of a range do".to_owned())
}

/// The cells of a column whose numbers have names: of one number the column's.
fn cells(table: &Table, column: usize) -> Vec<Cell> {
    let of = &table.columns[column];
    let is_named = of.width == 1 || of.parts.len() == of.width;
    (0..of.width).filter(|_| is_named).map(|part| Cell { column, part }).collect()
}

/// What a cell is called.
fn name(table: &Table, cell: Cell) -> &str {
    let column = &table.columns[cell.column];
    column.parts.get(cell.part).unwrap_or(&column.name)
}

/// The same as a config has it, which names columns and numbers of them.
fn table_cell(table: &Table, Cell { column, part }: Cell) -> TableCell {
    let Column { name, width, .. } = &table.columns[column];
    let name = if *width == 1 { name.clone() } else { format!("{name}[{part}]") };
    TableCell { at: (column, part), name }
}

/// The topic that a cell of a column with named numbers belongs to; empty where each number is a column.
fn home(table: &Table, cell: Cell) -> &str {
    let column = &table.columns[cell.column];
    if column.parts.is_empty() { "" } else { &column.name }
}

/// Poses and joints among cells that have names.
fn named_groups(table: &Table, all: &[Cell]) -> Vec<Group> {
    let mut groups = Vec::new();
    let mut poses: BTreeMap<(&str, Vec<String>), BTreeMap<Axis, Cell>> = BTreeMap::new();
    for &cell in all {
        if let Some((key, axis)) = names::axis(name(table, cell)) {
            poses.entry((home(table, cell), key)).or_default().entry(axis).or_insert(cell);
        }
    }
    for ((home, key), axes) in poses {
        let three = |of: fn(usize) -> Axis| -> Option<Vec<Cell>> {
            (0..3).map(|axis| axes.get(&of(axis)).copied()).collect()
        };
        let Some(position) = three(Axis::Xyz).or_else(|| three(Axis::Position)) else { continue };
        let quaternion: Option<Vec<Cell>> =
            (0..4).map(|axis| axes.get(&Axis::Quaternion(axis)).copied()).collect();
        let turn = quaternion.or_else(|| three(Axis::Turn)).or_else(|| three(Axis::Letter));
        let meaning = if turn.is_some() { Meaning::Pose } else { Meaning::Position };
        let cells: Vec<Cell> = position.into_iter().chain(turn.into_iter().flatten()).collect();
        let label = if key.is_empty() { "pose".to_owned() } else { key.join("_") };
        let topic = match (home.is_empty(), key.is_empty()) {
            (true, _) => label,
            (false, true) => home.to_owned(),
            (false, false) => format!("{home}/{label}"),
        };
        groups.push(Group { topic, why: why(table, &cells, "by name"), cells, meaning });
    }
    let is_free =
        |groups: &[Group], cell: &Cell| !groups.iter().any(|group| group.cells.contains(cell));
    let rest: Vec<Cell> = all.iter().copied().filter(|cell| is_free(&groups, cell)).collect();
    groups.extend(numbered_joints(table, &rest));
    let rest: Vec<Cell> = rest.into_iter().filter(|cell| is_free(&groups, cell)).collect();
    groups.extend(limbs(table, &rest));
    groups
}

/// Families of joints by number.
fn numbered_joints(table: &Table, all: &[Cell]) -> Vec<Group> {
    let mut families: BTreeMap<(&str, Vec<String>), BTreeMap<usize, Cell>> = BTreeMap::new();
    for &cell in all {
        let own = names::numbered(name(table, cell));
        let is_known = |stem: &[String]| names::is_stem_of_joints(stem) || names::is_pose(stem);
        let Some((stem, number)) = own.filter(|(stem, _)| is_known(stem)) else { continue };
        families.entry((home(table, cell), stem)).or_default().entry(number).or_insert(cell);
    }
    let mut groups = Vec::new();
    for ((home, stem), members) in families {
        let first = members.keys().next().copied().unwrap_or(0);
        let is_run = members.keys().copied().eq(first..first + members.len());
        if first > 1 || !is_run {
            continue;
        }
        let cells: Vec<Cell> = members.into_values().collect();
        if names::is_pose(&stem) && matches!(cells.len(), 6 | 7 | 12 | 16) {
            let topic =
                if home.is_empty() { stem.join("_") } else { format!("{home}/{}", stem.join("_")) };
            let why = why(table, &cells, "by name and number");
            groups.push(Group { topic, cells, meaning: Meaning::Pose, why });
            continue;
        }
        if !names::is_stem_of_joints(&stem) || !JOINTS.contains(&cells.len()) {
            continue;
        }
        let is_plain = names::is_plain(&stem);
        let side = names::side(&stem);
        let names = match is_plain {
            true => (1..=cells.len()).map(|number| format!("{side}q{number}")).collect(),
            false => cells.iter().map(|&cell| name(table, cell).to_owned()).collect(),
        };
        let names = match (stem.join("_").as_str(), cells.len()) {
            ("actual_q" | "target_q", 6) => UR_JOINTS.map(str::to_owned).to_vec(),
            _ => names,
        };
        let unnamed = is_plain && !names.contains(&UR_JOINTS[0].to_owned());
        let topic = match home.is_empty() {
            // libfranka's `q_d` is what is desired.
            true if stem.ends_with(&["q".to_owned(), "d".to_owned()]) => {
                format!("{}_command", stem.join("_"))
            }
            true => stem.join("_"),
            false => home.to_owned(),
        };
        let why = why(table, &cells, "by name and number");
        groups.push(Group {
            topic,
            cells,
            meaning: Meaning::Joints { names, unnamed, lines: Vec::new() },
            why,
        });
    }
    groups
}

/// Joints named after the parts of an arm, of one column or of all that are single numbers.
fn limbs(table: &Table, all: &[Cell]) -> Vec<Group> {
    let mut homes: BTreeMap<String, Vec<(Cell, String)>> = BTreeMap::new();
    for &cell in all {
        let own = name(table, cell);
        let Some(joint) = names::joint_name(own) else { continue };
        let home = match home(table, cell) {
            // The path before the name of a joint is what tells states from commands.
            "" => own
                .rsplit_once(['/', '.'])
                .map_or("", |(before, _)| before)
                .trim_end_matches(".pos")
                .to_owned(),
            home => home.to_owned(),
        };
        let joint = joint.rsplit(['/']).next().unwrap_or(&joint).to_owned();
        homes.entry(home).or_default().push((cell, joint));
    }
    let mut groups = Vec::new();
    for (home, members) in homes {
        let own =
            members.iter().filter(|(_, joint)| !names::is_gripper(&names::words(joint))).count();
        if own < *JOINTS.start() {
            continue;
        }
        let (cells, names): (Vec<Cell>, Vec<String>) = members.into_iter().unzip();
        let topic = if home.is_empty() { "joints".to_owned() } else { home };
        let why = why(table, &cells, "by the names of joints");
        groups.push(Group {
            topic,
            cells,
            meaning: Meaning::Joints { names, unnamed: false, lines: Vec::new() },
            why,
        });
    }
    groups
}

/// A column of numbers without names.
fn whole(column: &Column, cells: Vec<Cell>) -> Group {
    let words = names::words(&column.name);
    let by_name = |what: &str| format!("{what}, by the name of the column");
    let (meaning, why) = match column.width {
        _ if names::is_other(&words) || names::is_gripper(&words) => {
            (Meaning::Nothing, "neither joint positions nor a pose, by its name".to_owned())
        }
        6 if names::words(&column.name).ends_with(&["actual".into(), "q".into()])
            || names::words(&column.name).ends_with(&["target".into(), "q".into()]) =>
        {
            let names = UR_JOINTS.map(str::to_owned).to_vec();
            (
                Meaning::Joints { names, unnamed: false, lines: Vec::new() },
                by_name("joints of a UR"),
            )
        }
        width if names::are_joints(&words) && JOINTS.contains(&width) => {
            let side = names::side(&words);
            let names = (1..=width).map(|number| format!("{side}q{number}")).collect();
            (
                Meaning::Joints { names, unnamed: true, lines: Vec::new() },
                by_name("joint positions"),
            )
        }
        6 | 7 | 12 | 16 if names::is_pose(&words) => (Meaning::Pose, by_name("a pose")),
        3 if names::part(&column.name, 3).is_some_and(|(_, part)| part == Part::Position) => {
            (Meaning::Position, by_name("a position"))
        }
        1 => (Meaning::Numbers, "its name does not say what it is".to_owned()),
        width => (
            Meaning::Numbers,
            format!(
                "its name does not say what its {width} numbers are: say it in [columns] of the config"
            ),
        ),
    };
    Group { topic: column.name.clone(), cells, meaning, why }
}

/// What is left of a column of which some numbers are told.
fn rest(column: &Column, cells: Vec<Cell>) -> Group {
    let why = format!("its name does not say what these {} numbers are", cells.len());
    Group { topic: column.name.clone(), cells, meaning: Meaning::Numbers, why }
}

/// Joins a position in one column and the rotation of the same name in another.
fn join_parts(table: &Table, groups: &mut Vec<Group>) {
    let part = |group: &Group| {
        let column = &table.columns[group.cells.first()?.column];
        let is_whole = group.cells.len() == column.width && column.parts.is_empty();
        names::part(&column.name, column.width).filter(|_| is_whole && group.topic == column.name)
    };
    let mut at = 0;
    while at < groups.len() {
        let Some((key, Part::Position)) = part(&groups[at]) else {
            at += 1;
            continue;
        };
        let turns: Vec<usize> = (0..groups.len())
            .filter(|&other| {
                part(&groups[other]).is_some_and(|(own, part)| own == key && part != Part::Position)
            })
            .collect();
        // Of a rotation that is there twice, the quaternion says more.
        let widest = turns.iter().copied().max_by_key(|&other| groups[other].cells.len());
        if let Some(other) = widest {
            let turn = std::mem::take(&mut groups[other].cells);
            let name = groups[other].topic.clone();
            let own = &mut groups[at];
            own.why =
                format!("a position, and its rotation in '{name}', by the names of the columns");
            own.cells.extend(turn);
            own.meaning = Meaning::Pose;
        }
        at += 1;
    }
    groups.retain(|group| !group.cells.is_empty());
}

/// Gives topics of one name numbers.
fn distinct(groups: &mut [Group]) {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for group in groups {
        let count = seen.entry(group.topic.clone()).or_default();
        *count += 1;
        if *count > 1 {
            group.topic = format!("{} ({count})", group.topic);
        }
    }
}

/// The names of some cells, and what they were told by.
fn why(table: &Table, cells: &[Cell], by: &str) -> String {
    let names: Vec<&str> = cells.iter().map(|&cell| name(table, cell)).collect();
    format!("columns {}, {by}", names.join(", "))
}

impl Group {
    /// The largest position of a joint that is no gripper's, whatever its unit; 0 of other groups.
    fn most(&self, table: &Table) -> f64 {
        let Meaning::Joints { names, lines, .. } = &self.meaning else { return 0.0 };
        if !lines.is_empty() {
            return 0.0;
        }
        let arms = self
            .cells
            .iter()
            .zip(names)
            .filter(|(_, name)| !names::is_gripper(&names::words(name)));
        let sizes = arms.flat_map(|(cell, _)| {
            let column = &table.columns[cell.column];
            column.values.iter().skip(cell.part).step_by(column.width).map(|value| value.abs())
        });
        sizes.filter(|size| usable(*size)).fold(0.0, f64::max)
    }

    /// The topic; `most` is the largest position of any joint of the table. Where it is beyond two turns they
    /// are taken for degrees, states and commands alike.
    fn found(self, table: &Table, clock: &Clock, most: f64) -> Found {
        let Self { topic, cells, meaning, mut why } = self;
        let mut contradiction = None;
        let kind = cells.first().map_or("", |cell| &table.columns[cell.column].kind);
        let kind =
            if cells.len() == 1 { kind.to_owned() } else { format!("{kind}[{}]", cells.len()) };
        let rows: Vec<(usize, i64)> = clock
            .stamps
            .iter()
            .enumerate()
            .filter_map(|(row, stamp)| Some((row, (*stamp)?)))
            .collect();
        let stamps: Vec<i64> = rows.iter().map(|(_, stamp)| *stamp).collect();
        let at = |row: usize, cell: &Cell| {
            let column = &table.columns[cell.column];
            column.values.get(row * column.width + cell.part).copied().unwrap_or(f64::NAN)
        };
        let values = || -> Vec<f64> {
            rows.iter().flat_map(|&(row, _)| cells.iter().map(move |cell| at(row, cell))).collect()
        };
        let columns = match meaning {
            Meaning::Joints { names, unnamed, lines } => {
                let mut joints = joints(&stamps, &names, &values(), unnamed);
                for (joint, [factor, offset]) in joints.joints.iter_mut().zip(&lines) {
                    joint.position.iter_mut().for_each(|q| *q = factor * *q + offset);
                }
                if most > TWO_TURNS && lines.is_empty() {
                    why += &format!("; taken for degrees: rad do not go up to {most:.1}");
                    if let Some(what) = no_degrees(table, &cells, most) {
                        why += &format!(", but {what}");
                    }
                    let says_rad = |cell: &&Cell| {
                        names::words(name(table, **cell))
                            .iter()
                            .any(|word| RADIANS.contains(&word.as_str()))
                    };
                    contradiction = cells.iter().find(says_rad).map(|&cell| {
                        let name = name(table, cell);
                        format!(
                            "the name '{name}' says rad, and joint positions go up to {most:.1}"
                        )
                    });
                    joints.taken_for_degrees = true;
                    let all = joints.joints.iter_mut().flat_map(|joint| &mut joint.position);
                    all.for_each(|position| *position = position.to_radians());
                }
                joints.lines = lines;
                Some(Columns::Joints(joints))
            }
            Meaning::Pose => Some(Columns::Array(array(&stamps, cells.len(), &values()))),
            Meaning::Numbers => {
                let array = array(&stamps, cells.len(), &values());
                Some(Columns::Array(ArrayColumns { unnamed: true, ..array }))
            }
            Meaning::Position => Some(Columns::Poses(vec![positions(&stamps, &values())])),
            Meaning::Nothing => None,
        };
        let cells = cells.iter().map(|&cell| table_cell(table, cell)).collect();
        Found { topic, kind, why, cells, contradiction, columns, rows: stamps.len() as u64 }
    }
}

fn joints(stamps: &[i64], names: &[String], values: &[f64], unnamed: bool) -> JointColumns {
    let mut times = Times::default();
    stamps.iter().for_each(|&stamp| times.push(stamp, stamp, stamp));
    let mut joints = JointColumns { times, unnamed, ..JointColumns::default() };
    for (at, name) in names.iter().enumerate() {
        let logged = values.iter().skip(at).step_by(names.len()).copied();
        let position: Vec<f64> =
            logged.map(|value| if usable(value) { value } else { f64::NAN }).collect();
        let unusable = position.iter().filter(|value| value.is_nan()).count();
        (0..unusable).for_each(|_| joints.drop_value(at));
        joints.joints.push(JointColumn {
            name: name.clone(),
            velocity: vec![f64::NAN; position.len()],
            position,
        });
    }
    joints
}
