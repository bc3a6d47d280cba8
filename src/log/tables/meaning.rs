//! Identifies the contents of table columns: as configured, otherwise by name. Unidentified columns are
//! passed on as bare numbers.

mod configured;
mod row_layout;
mod sampling;
mod trajectory;

use std::collections::{BTreeMap, BTreeSet, HashSet};

use super::clock::{self, Clock, TWO_TURNS_RAD};
use super::names::{self, PoseComponent, PosePart};
use super::row_labels::RowLabels;
use super::row_layout::pose_order;
use super::velocity_files::follow_positions;
use super::{
    Cell, Column, ColumnSettings, RowStamps, Table, TableTopic, Velocities, array_columns,
    joint_columns, pose_columns, row_losses,
};
use crate::TableCell;
pub(crate) use row_layout::LayoutColumns;
use sampling::Sampling;

use ground::geometry::{AngleUnit, rotation_from_matrix_rows};
use ground::robot::UR_JOINTS;
use ground::stream::{ArrayColumns, Columns, JointColumns, is_usable, usable_or_nan};

/// Joints of an arm, with its gripper.
const JOINT_COUNTS: std::ops::RangeInclusive<usize> = 4..=8;
/// For joint positions, a pose or its parts.
const MIN_CELLS: usize = 3;
/// Reason of a column whose values name streams.
const ROW_LABEL: &str = "names the stream of each row";
/// LeRobot's counters; no measurements.
const COUNTER_COLUMNS: &[&str] = &["frame_index", "episode_index", "index", "task_index"];

#[derive(Clone)]
enum ColumnMeaning {
    /// `unnamed` if the joint names are generated.
    Joints {
        names: Vec<String>,
        unnamed: bool,
        lines: Vec<[f64; 2]>,
        /// Velocities in the same order; may be empty.
        velocities: Vec<Cell>,
    },
    /// Velocities of joints in another table, in this unit or that of the joints.
    Velocities(Option<AngleUnit>),
    /// The rotation in any encoding.
    Pose,
    /// A position and a quaternion xyzw, by the format of the file.
    QuaternionPose,
    Position,
    Numbers,
    /// Not audited.
    Unused,
}

impl ColumnMeaning {
    /// Joints in the unit of the table, without velocities.
    fn joints(names: Vec<String>, unnamed: bool) -> Self {
        Self::Joints { names, unnamed, lines: Vec::new(), velocities: Vec::new() }
    }
}

#[derive(Clone)]
struct ColumnGroup {
    topic: String,
    cells: Vec<Cell>,
    meaning: ColumnMeaning,
    why: String,
    part: Option<PosePartKey>,
}

/// Column that contains the parts (empty if each number is a column), words that the parts share, and the
/// part.
type PosePartKey = (String, Vec<String>, PosePart);

/// # Errors
/// If the configuration selects columns that do not exist.
pub(super) fn identify_topics(
    table: &Table,
    clock: &Clock,
    settings: &ColumnSettings,
    layout: Option<&LayoutColumns>,
) -> Result<Vec<TableTopic>, String> {
    let mut groups = match layout {
        Some(layout) => layout.groups(table),
        None => configured::configured_groups(table, settings)?,
    };
    if groups.is_empty() {
        groups = trajectory::trajectory_groups(table);
    }
    let taken_by = |groups: &[ColumnGroup]| -> HashSet<Cell> {
        groups.iter().flat_map(ColumnGroup::all_cells).copied().collect()
    };
    let is_clock_open = settings.time.is_none() && settings.rate_hz.is_none() && layout.is_none();
    let (own_clocks, further) = match is_clock_open {
        true => clock::further_clocks(table, clock),
        false => Default::default(),
    };
    let clocks: HashSet<Cell> = own_clocks
        .values()
        .chain([clock])
        .flat_map(|clock| [clock.cell, clock.nanos])
        .flatten()
        .collect();
    let is_clock = |cell: &Cell| clocks.contains(cell);
    let open: Vec<usize> =
        (0..table.columns.len()).filter(|&at| table.columns[at].width > 0).collect();
    let identified = taken_by(&groups);
    let named: Vec<Cell> = open
        .iter()
        .flat_map(|&column| cells(table, column))
        .filter(|cell| !identified.contains(cell) && !is_clock(cell))
        .collect();
    let by_name = group_by_names(table, &named);
    groups.extend(by_name);
    let taken = taken_by(&groups);
    for column in open {
        let all = (0..table.columns[column].width).map(|part| Cell { column, part });
        let free: Vec<Cell> = all.filter(|cell| !taken.contains(cell) && !is_clock(cell)).collect();
        let is_counter = COUNTER_COLUMNS.contains(&table.columns[column].name.as_str());
        match free.len() {
            0 => {}
            _ if is_counter => {
                let topic = table.columns[column].name.clone();
                let why = "counts rows or episodes, by its name".to_owned();
                groups.push(ColumnGroup::new(topic, free, ColumnMeaning::Unused, why));
            }
            count if count == table.columns[column].width => {
                groups.push(identify_column(table, &table.columns[column], free));
            }
            _ if settings.declares_all() => {}
            _ => groups.push(unidentified_rest(&table.columns[column], free)),
        }
    }
    join_pose_parts(table, &mut groups);
    groups.retain(|group| !group.cells.is_empty());
    if layout.is_none() {
        assign_velocities(table, clock, &mut groups);
        groups.iter_mut().for_each(|group| convert_mixed_angles(table, group));
    }
    number_duplicates(&mut groups);
    if settings.pose.is_empty() && (layout.is_none() || table.is_one_of_several) {
        name_after_file(&mut groups, &table.stream_name);
    }
    let most = groups.iter().map(|group| group.max_position(table)).fold(0.0, f64::max);
    let clock_of = |group: &ColumnGroup| -> (&Clock, &Clock) {
        let group_of = |cell: &Cell| clock::group_of(&table.columns[cell.column].name);
        let home = group.cells.first().and_then(group_of);
        let in_group = home
            .and_then(|home| own_clocks.get(home))
            .filter(|_| group.cells.iter().all(|cell| group_of(cell) == home));
        let is_time =
            group.cells.iter().any(|cell| further.iter().any(|clock| clock.cell == Some(*cell)));
        match in_group {
            Some(own) => (clock, own),
            None if is_time => (clock, clock),
            None => further_clock(table, clock, &further, group).unwrap_or((clock, clock)),
        }
    };
    let sampling = Sampling::of_groups(table, &groups);
    let with_clock: Vec<(&Clock, &Clock)> = groups.iter().map(clock_of).collect();
    let is_used = |group: &ColumnGroup| match group.cells.as_slice() {
        [only] => with_clock.iter().any(|(_, own)| own.cell == Some(*only)),
        _ => false,
    };
    let all_cells: Vec<&[Cell]> = groups.iter().map(|group| group.cells.as_slice()).collect();
    let labels = RowLabels::detect(table, &all_cells);
    let groups = groups.into_iter().zip(&with_clock).filter(|(group, _)| !is_used(group));
    let found = groups.flat_map(|(group, clocks)| {
        group.into_topics(table, *clocks, (most, &sampling), labels.as_ref())
    });
    let why = |name: &str, why: &str| match &labels {
        Some(own) if own.cell.is_none() && own.column == name => ROW_LABEL.to_owned(),
        _ => why.to_owned(),
    };
    let unread = table.unread.iter().map(|(name, own)| TableTopic {
        topic: name.clone(),
        kind: "unread".to_owned(),
        why: why(name, own),
        rows: table.rows as u64,
        ..TableTopic::default()
    });
    Ok(found.chain(unread).collect())
}

/// Clocks of the rows and of a group of columns, if a time column is named like the group or has times in the same
/// rows. If it has fewer rows than the table, its rows are not those of the other columns.
fn further_clock<'a>(
    table: &Table,
    clock: &'a Clock,
    further: &'a [Clock],
    group: &ColumnGroup,
) -> Option<(&'a Clock, &'a Clock)> {
    let rows_of = |clock: &Clock| clock.stamps.iter().map(Option::is_some).collect::<Vec<bool>>();
    let is_named_like = |clock: &Clock| {
        let own = clock.stream_words(table);
        let has_all = |cell: &Cell| {
            let words = names::split_words(&table.columns[cell.column].name);
            own.iter().all(|own| words.iter().any(|word| names::singular(word) == own))
        };
        !own.is_empty() && group.cells.iter().all(has_all)
    };
    let rows = sampling::rows_with_numbers(table, &group.cells);
    let of_rows = rows_of(clock);
    let is_block = |own: &&Clock| rows != of_rows && rows_of(own) == rows;
    if let Some(own) = further.iter().find(is_block) {
        return Some((own, own));
    }
    if is_named_like(clock) {
        return None;
    }
    let mut named = further.iter().filter(|own| is_named_like(own));
    named.next().filter(|_| named.next().is_none()).map(|own| (clock, own))
}

/// Converts each joint to rad if their names give different units.
fn convert_mixed_angles(table: &Table, group: &mut ColumnGroup) {
    let ColumnMeaning::Joints { lines, .. } = &mut group.meaning else { return };
    let units =
        group.cells.iter().map(|&cell| unit_by_name(&names::split_words(name(table, cell))));
    let units: Option<Vec<AngleUnit>> = units.collect();
    if let Some(units) = units.filter(|units| lines.is_empty() && differ(units)) {
        *lines = units.iter().map(|unit| [unit.in_rad(), 0.0]).collect();
        group.why += "; in rad and degrees, by name";
    }
}

fn differ<T: PartialEq>(all: &[T]) -> bool {
    all.windows(2).any(|pair| pair[0] != pair[1])
}

/// Units of a position, m, if its names give different ones.
fn mixed_lengths_m(table: &Table, cells: &[Cell]) -> Option<Vec<f64>> {
    let units = cells.get(..3)?.iter().map(|&cell| names::length_unit_m(name(table, cell)));
    units.collect::<Option<Vec<f64>>>().filter(|units| differ(units))
}

/// Called if they are too large for rad; `None` if they may be degrees.
fn why_not_degrees(table: &Table, cells: &[Cell], most: f64) -> Option<String> {
    /// Two turns in degrees; percentages end at exactly 100 in several joints.
    const MAX_DEGREES: f64 = 720.0;
    const RANGE_END_PERCENT: f64 = 100.0;
    const MIN_JOINTS_AT_END: usize = 2;
    if most > MAX_DEGREES {
        return Some("too large for degrees as well: encoder ticks or another unit".to_owned());
    }
    let reaches =
        |cell: &&Cell| numbers(table, **cell).any(|value| value.abs() == RANGE_END_PERCENT);
    let is_share =
        most == RANGE_END_PERCENT && cells.iter().filter(reaches).count() >= MIN_JOINTS_AT_END;
    is_share.then(|| "several end at exactly 100, like percentages of a range".to_owned())
}

/// Cells with names; a single number has the name of its column.
fn cells(table: &Table, column: usize) -> Vec<Cell> {
    let of = &table.columns[column];
    let is_named = of.width == 1 || of.parts.len() == of.width;
    (0..of.width).filter(|_| is_named).map(|part| Cell { column, part }).collect()
}

fn name(table: &Table, cell: Cell) -> &str {
    let column = &table.columns[cell.column];
    column.parts.get(cell.part).unwrap_or(&column.name)
}

/// In the notation `NAME[INDEX]` of the configuration.
fn table_cell(table: &Table, at: Cell) -> TableCell {
    TableCell { table: 0, at, name: table.cell_name(at), labels: None, is_unidentified: false }
}

fn numbers(table: &Table, cell: Cell) -> impl Iterator<Item = f64> + Clone {
    table.columns[cell.column].numbers(cell.part)
}

/// Measured values change and have fractions.
fn is_measured(table: &Table, cell: Cell) -> bool {
    let mut values = numbers(table, cell).filter(|value| value.is_finite());
    let has_fractions = values.clone().any(|value| value.fract() != 0.0);
    let first = values.next();
    has_fractions && values.any(|value| Some(value) != first)
}

/// Empty if each number is a column.
fn home_column(table: &Table, cell: Cell) -> &str {
    let column = &table.columns[cell.column];
    if column.parts.is_empty() { "" } else { &column.name }
}

fn group_by_names(table: &Table, all: &[Cell]) -> Vec<ColumnGroup> {
    let mut groups = Vec::new();
    let mut poses: BTreeMap<(&str, Vec<String>), BTreeMap<PoseComponent, Cell>> = BTreeMap::new();
    for &cell in all {
        for (key, axis) in names::pose_components(name(table, cell)) {
            poses.entry((home_column(table, cell), key)).or_default().entry(axis).or_insert(cell);
        }
    }
    for ((home, key), axes) in poses {
        let all_of = |count: usize, of: &dyn Fn(usize) -> PoseComponent| -> Option<Vec<Cell>> {
            (0..count).map(|axis| axes.get(&of(axis)).copied()).collect()
        };
        let position =
            all_of(3, &PoseComponent::Xyz).or_else(|| all_of(3, &PoseComponent::Position));
        let is_free = |cells: &Vec<Cell>| {
            position.as_ref().is_none_or(|own| cells.iter().all(|cell| !own.contains(cell)))
        };
        let with_w = || {
            let w = *axes.get(&PoseComponent::Quaternion(3))?;
            Some([all_of(3, &PoseComponent::Rotation)?, vec![w]].concat())
        };
        let label = |label: usize| all_of(3, &|at| PoseComponent::Label(label, at)).filter(is_free);
        let named = all_of(4, &PoseComponent::Quaternion)
            .or_else(with_w)
            .or_else(|| all_of(3, &PoseComponent::Rotation));
        let turn = named.clone().or_else(|| (0..names::ANGLE_LABELS.len()).find_map(label));
        let (cells, meaning, part) = match (position, turn, named) {
            (Some(position), Some(turn), _) => {
                ([position, turn].concat(), ColumnMeaning::Pose, None)
            }
            (Some(position), None, _) => {
                (position, ColumnMeaning::Position, Some(PosePart::Position))
            }
            // Rotation whose position is in numbered columns. Single-letter labels are too ambiguous without a
            // position.
            (None, _, Some(turn)) => {
                let is_quaternion = turn.len() == 4;
                let part = if is_quaternion { PosePart::Quaternion } else { PosePart::Rotation };
                (turn, ColumnMeaning::Numbers, Some(part))
            }
            (None, _, None) => continue,
        };
        let label = if key.is_empty() { "pose".to_owned() } else { key.join("_") };
        let topic = match (home.is_empty(), key.is_empty()) {
            (true, _) => label,
            (false, true) => home.to_owned(),
            (false, false) => format!("{home}/{label}"),
        };
        let part = part.map(|part| (home.to_owned(), key, part));
        let why = describe_origin(table, &cells, "by name");
        groups.push(ColumnGroup { topic, cells, meaning, why, part });
    }
    let free = |groups: &[ColumnGroup]| -> Vec<Cell> {
        let taken: HashSet<Cell> = groups.iter().flat_map(|group| &group.cells).copied().collect();
        all.iter().copied().filter(|cell| !taken.contains(cell)).collect()
    };
    groups.extend(group_matrices(table, &free(&groups)));
    groups.extend(group_numbered(table, &free(&groups)));
    groups.extend(group_by_limb_names(table, &free(&groups)));
    if groups.is_empty() {
        groups = group_few_joints(table, all);
    }
    groups
}

/// Positions of fewer joints than an arm has, as a test of single joints logs them: in a table with their commands or
/// velocities, and too few other numbers for an arm.
fn group_few_joints(table: &Table, all: &[Cell]) -> Vec<ColumnGroup> {
    let mut families: BTreeMap<Vec<String>, BTreeMap<usize, Cell>> = BTreeMap::new();
    let (mut others, mut has_velocities) = (0, false);
    for &cell in all {
        let own = name(table, cell);
        let words = names::split_words(own);
        let is_angle = names::says_degrees(own) && names::is_bare_position(&words);
        let is_joint = names::is_joint_positions(&words) || is_angle;
        let (stem, number) = names::numbered(own).unwrap_or_else(|| (words.clone(), 1));
        match () {
            () if is_joint => {
                families.entry(stem).or_default().entry(number).or_insert(cell);
            }
            () if names::is_joint_velocities(&words) => has_velocities = true,
            () if names::is_other_quantity(&words) => {}
            () => others += 1,
        }
    }
    let most = families.values().map(BTreeMap::len).max().unwrap_or(0);
    if most.max(others) >= *JOINT_COUNTS.start() || (families.len() < 2 && !has_velocities) {
        return Vec::new();
    }
    let group = |(stem, members): (Vec<String>, BTreeMap<usize, Cell>)| {
        let cells: Vec<Cell> = members.values().copied().collect();
        let names = members.keys().map(|number| format!("q{number}")).collect();
        let why = describe_origin(table, &cells, "by name");
        ColumnGroup::new(stem.join("_"), cells, ColumnMeaning::joints(names, true), why)
    };
    families.into_iter().map(group).collect()
}

/// Numbers named by row and column.
fn group_matrices(table: &Table, all: &[Cell]) -> Vec<ColumnGroup> {
    type Family<'a> = (&'a str, Vec<String>);
    let mut families: BTreeMap<Family<'_>, BTreeMap<(usize, usize), Cell>> = BTreeMap::new();
    for &cell in all {
        if let Some((stem, at)) = names::matrix_cell(name(table, cell)) {
            families.entry((home_column(table, cell), stem)).or_default().entry(at).or_insert(cell);
        }
    }
    let made = families.into_iter().filter_map(|((home, stem), members)| {
        let is_whole = |rows: usize, columns: usize| {
            [0, 1].into_iter().any(|first| {
                let all = (first..first + rows)
                    .flat_map(|row| (first..first + columns).map(move |column| (row, column)));
                members.keys().copied().eq(all)
            })
        };
        let (meaning, part) = match () {
            () if is_whole(4, 4) || is_whole(3, 4) => (ColumnMeaning::Pose, None),
            () if is_whole(3, 3) => (ColumnMeaning::Numbers, Some(PosePart::Matrix)),
            () => return None,
        };
        let cells: Vec<Cell> = members.values().copied().collect();
        let topic = topic_of(home, &stem);
        let part = part.map(|part| (home.to_owned(), names::pose_key(&stem), part));
        let why = describe_origin(table, &cells, "matrix elements by name");
        Some(ColumnGroup { topic, cells, meaning, why, part })
    });
    made.collect()
}

fn topic_of(home: &str, stem: &[String]) -> String {
    if home.is_empty() { stem.join("_") } else { format!("{home}/{}", stem.join("_")) }
}

/// Joints, poses and pose parts whose names end in a number.
fn group_numbered(table: &Table, all: &[Cell]) -> Vec<ColumnGroup> {
    let mut families: BTreeMap<(&str, Vec<String>), BTreeMap<usize, Cell>> = BTreeMap::new();
    for &cell in all {
        let own = names::numbered(name(table, cell));
        let is_known = |stem: &[String]| {
            names::is_stem_of_joints(stem)
                || names::is_pose(stem)
                || (3..=4).any(|width| names::pose_part(&stem.join("_"), width).is_some())
        };
        let is_limb = names::numbers_a_limb(name(table, cell));
        let Some((stem, number)) = own.filter(|(stem, _)| !is_limb && is_known(stem)) else {
            continue;
        };
        families.entry((home_column(table, cell), stem)).or_default().entry(number).or_insert(cell);
    }
    let mut groups = Vec::new();
    for ((home, stem), members) in &families {
        let first = members.keys().next().copied().unwrap_or(0);
        let is_run = members.keys().copied().eq(first..first + members.len());
        if first > 1 || !is_run {
            continue;
        }
        let cells: Vec<Cell> = members.values().copied().collect();
        let count = cells.len();
        let are_joints = names::is_stem_of_joints(stem) && JOINT_COUNTS.contains(&count);
        // ABB logs a quaternion as q1 to q4, Leica as Q0 to Q3. No four joints move like that.
        let is_quaternion =
            stem.last().is_some_and(|word| word == "q") && count == 4 && are_unit(table, &cells);
        let (meaning, part) = match names::pose_part(&stem.join("_"), count) {
            _ if names::is_pose(stem) && matches!(count, 6 | 7 | 12 | 16) => {
                (ColumnMeaning::Pose, None)
            }
            _ if is_quaternion => (ColumnMeaning::Numbers, Some(PosePart::Quaternion)),
            _ if are_joints => (numbered_joints(table, stem, first, &cells), None),
            Some((_, PosePart::Position)) => (ColumnMeaning::Position, Some(PosePart::Position)),
            Some((_, part)) => (ColumnMeaning::Numbers, Some(part)),
            None => continue,
        };
        let topic = match &meaning {
            ColumnMeaning::Joints { .. } if !home.is_empty() => (*home).to_owned(),
            // `q_d` of libfranka holds desired positions.
            ColumnMeaning::Joints { .. } if stem.ends_with(&["q".to_owned(), "d".to_owned()]) => {
                format!("{}_command", stem.join("_"))
            }
            _ => topic_of(home, stem),
        };
        let why = describe_origin(table, &cells, "by name and number");
        let part = part.map(|part| ((*home).to_owned(), names::pose_key(stem), part));
        groups.push(ColumnGroup { topic, cells, meaning, why, part });
    }
    groups
}

/// Joints with the names of a UR, of the log or of their columns, or counted.
fn numbered_joints(table: &Table, stem: &[String], first: usize, cells: &[Cell]) -> ColumnMeaning {
    let of_columns = || cells.iter().map(|&cell| name(table, cell).to_owned()).collect();
    let known = match (stem.join("_").as_str(), cells.len()) {
        ("actual_q" | "target_q", 6) => Some(UR_JOINTS.map(str::to_owned).to_vec()),
        (_, count) => logged_names(table, stem, first, count)
            .or_else(|| (!names::is_generic(stem)).then(of_columns)),
    };
    match known {
        Some(names) => ColumnMeaning::joints(names, false),
        None => ColumnMeaning::joints(counted_names(&names::arm_prefix(stem), cells.len()), true),
    }
}

/// `left_q1`, `left_q2` and so on.
fn counted_names(prefix: &str, count: usize) -> Vec<String> {
    (1..=count).map(|number| format!("{prefix}q{number}")).collect()
}

/// `rostopic echo -p` writes them next to the positions.
fn logged_names(table: &Table, stem: &[String], first: usize, count: usize) -> Option<Vec<String>> {
    if !stem.ends_with(&["field".to_owned(), "position".to_owned()]) {
        return None;
    }
    (first..first + count).map(|at| table.texts.get(&format!("field.name{at}")).cloned()).collect()
}

fn are_unit(table: &Table, cells: &[Cell]) -> bool {
    /// Share of the rows, and tolerance for rounding to two digits.
    const MIN_UNIT_PERCENT: usize = 95;
    const MAX_NORM_DEVIATION: f64 = 0.03;
    let square = |row: usize, cell: &Cell| table.number(row, *cell).powi(2);
    let norm = |row: usize| cells.iter().map(|cell| square(row, cell)).sum::<f64>().sqrt();
    let unit = (0..table.rows).filter(|&row| (norm(row) - 1.0).abs() < MAX_NORM_DEVIATION).count();
    100 * unit >= MIN_UNIT_PERCENT * table.rows
}

fn assign_velocities(table: &Table, clock: &Clock, groups: &mut Vec<ColumnGroup>) {
    let words_of = |cell: &Cell| {
        let column = &table.columns[cell.column];
        let part = column.parts.get(cell.part);
        let mut words = names::split_words(&column.name);
        words.extend(part.map(|part| names::split_words(part)).unwrap_or_default());
        if part.is_none() && column.width > 1 {
            words.push(cell.part.to_string());
        }
        words
    };
    let is_read = |group: &&ColumnGroup| {
        use ColumnMeaning::{Numbers, Unused, Velocities};
        !matches!(group.meaning, Numbers | Unused | Velocities(_))
    };
    let read = groups.iter().filter(is_read);
    let used: HashSet<Cell> = read.flat_map(|group| &group.cells).copied().collect();
    let mut open: BTreeMap<Vec<String>, Vec<(Vec<String>, Cell)>> = BTreeMap::new();
    for (column, own) in table.columns.iter().enumerate() {
        for part in 0..own.width {
            let cell = Cell { column, part };
            let words = words_of(&cell);
            if names::is_joint_velocities(&words) && !used.contains(&cell) {
                open.entry(names::shared_words(&words)).or_default().push((words, cell));
            }
        }
    }
    let mut taken: Vec<Vec<Cell>> = Vec::new();
    let mut commands: Vec<(Vec<Cell>, Vec<String>, bool)> = Vec::new();
    for group in groups.iter_mut() {
        let ColumnGroup { cells, meaning, why, .. } = group;
        let ColumnMeaning::Joints { velocities, names, unnamed, .. } = meaning else { continue };
        // `joint_velocity_1` rather than `motor_velocity_1` for `joint_position_1`.
        let velocity = |cell: &Cell| {
            let words = words_of(cell);
            let differing =
                |other: &[String]| other.iter().filter(|it| !words.contains(it)).count();
            let alike = open.get(&names::shared_words(&words))?;
            alike.iter().min_by_key(|(other, _)| differing(other)).map(|(_, cell)| *cell)
        };
        let Some(own) = cells.iter().map(velocity).collect::<Option<Vec<Cell>>>() else { continue };
        if taken.iter().flatten().any(|cell| own.contains(cell)) {
            continue;
        }
        let is_open = own.iter().any(|cell| names::is_ambiguous_velocity(&words_of(cell)));
        let stamp = |row: usize| clock.stamps.get(row).copied().flatten();
        let pair = |joint: usize, row: usize| {
            [cells[joint], own[joint]].map(|cell| table.number(row, cell))
        };
        if is_open && follow_positions(table.rows, cells.len(), stamp, pair) {
            commands.push((own, names.clone(), *unnamed));
            continue;
        }
        let mut names: Vec<&str> = own.iter().map(|&cell| name(table, cell)).collect();
        names.dedup();
        *why += &format!("; velocities in {}", names.join(", "));
        velocities.clone_from(&own);
        taken.push(own);
    }
    let given = taken.iter().chain(commands.iter().map(|(cells, ..)| cells)).flatten();
    let given: HashSet<Cell> = given.copied().collect();
    groups.iter_mut().for_each(|group| group.cells.retain(|cell| !given.contains(cell)));
    groups.retain(|group| !group.cells.is_empty());
    for (cells, names, unnamed) in commands {
        let why = "desired joint positions: their values follow the joint positions, not the joint \
            velocities";
        let topic = format!("{}_command", velocity_topic(table, &cells));
        let meaning = ColumnMeaning::joints(names, unnamed);
        groups.push(ColumnGroup::new(topic, cells, meaning, why.to_owned()));
    }
}

fn velocity_topic(table: &Table, cells: &[Cell]) -> String {
    let first = cells[0];
    if cells.iter().all(|cell| cell.column == first.column) {
        return table.columns[first.column].name.clone();
    }
    let first = name(table, first);
    names::numbered(first).map_or_else(|| first.to_owned(), |(stem, _)| stem.join("_"))
}

/// Joints named after parts of an arm.
fn group_by_limb_names(table: &Table, all: &[Cell]) -> Vec<ColumnGroup> {
    let mut homes: BTreeMap<(String, &str), Vec<(Cell, String)>> = BTreeMap::new();
    for &cell in all {
        let own = name(table, cell);
        let base = || names::is_base(own).then(|| names::without_unit(own).to_owned());
        let joint = names::joint_name(own).or_else(base);
        let Some(joint) = joint else { continue };
        let home = match home_column(table, cell) {
            // The path before a joint name distinguishes states from commands.
            "" => joint.rsplit_once(['/', '.']).map_or("", |(before, _)| before).to_owned(),
            home => home.to_owned(),
        };
        let joint = joint.rsplit(['/', '.']).next().unwrap_or(&joint).to_owned();
        let command = names::command_word(own).unwrap_or_default();
        homes.entry((home, command)).or_default().push((cell, joint));
    }
    let mut groups = Vec::new();
    for ((home, command), members) in homes {
        // The hand in `left_hand.joint_1` is part of the path.
        let of_arm = |(cell, _): &&(Cell, String)| {
            !names::is_gripper(&names::split_words(name(table, *cell)))
        };
        if members.iter().filter(of_arm).count() < *JOINT_COUNTS.start() {
            continue;
        }
        let (cells, names): (Vec<Cell>, Vec<String>) = members.into_iter().unzip();
        if !names::are_several_limbs(&names) {
            continue;
        }
        let topic = match (home.is_empty(), command.is_empty()) {
            (true, true) => "joints".to_owned(),
            (true, false) => format!("joints_{command}"),
            (false, _) => home,
        };
        let why = describe_origin(table, &cells, "by joint names");
        groups.push(ColumnGroup::new(topic, cells, ColumnMeaning::joints(names, false), why));
    }
    groups
}

fn identify_column(table: &Table, column: &Column, cells: Vec<Cell>) -> ColumnGroup {
    let words = names::split_words(&column.name);
    let by_name = |what: &str| format!("{what}, by the name of the column");
    let (meaning, why) = match column.width {
        width if let Some(names) = joint_state_names(table, &column.name, width) => {
            let why = "joint positions, named in the same record".to_owned();
            (ColumnMeaning::joints(names, false), why)
        }
        width if names::is_joint_velocities(&words) && JOINT_COUNTS.contains(&width) => {
            (ColumnMeaning::Velocities(unit_by_name(&words)), by_name("joint velocities"))
        }
        width
            if names::is_other_quantity(&words)
                || (names::is_gripper(&words)
                    && !names::is_pose_of_gripper(&column.name, width)
                    && !are_homogeneous(column)) =>
        {
            (ColumnMeaning::Unused, "neither joint positions nor a pose, by its name".to_owned())
        }
        6 if words.ends_with(&["actual".into(), "q".into()])
            || words.ends_with(&["target".into(), "q".into()]) =>
        {
            let names = UR_JOINTS.map(str::to_owned).to_vec();
            (ColumnMeaning::joints(names, false), by_name("joints of a UR"))
        }
        width
            if JOINT_COUNTS.contains(&width)
                && (names::is_joint_positions(&words) || has_velocities(table, column)) =>
        {
            let names = counted_names(&names::arm_prefix(&words), width);
            (ColumnMeaning::joints(names, true), by_name("joint positions"))
        }
        width @ (6 | 7 | 12 | 16)
            if names::is_pose(&words) || names::is_pose_of_gripper(&column.name, width) =>
        {
            (ColumnMeaning::Pose, by_name("a pose"))
        }
        16 if are_homogeneous(column) => {
            (ColumnMeaning::Pose, "a pose, because each row is a homogeneous matrix".to_owned())
        }
        3 if names::pose_part(&column.name, 3)
            .is_some_and(|(_, part)| part == PosePart::Position) =>
        {
            (ColumnMeaning::Position, by_name("a position"))
        }
        1 => (ColumnMeaning::Numbers, "its name does not show what it holds".to_owned()),
        width => (
            ColumnMeaning::Numbers,
            format!(
                "its name does not show what its {width} numbers are: declare it in [columns] of the config"
            ),
        ),
    };
    let part = names::pose_part(&column.name, column.width)
        .or_else(|| are_rotations(column).then(|| (names::pose_key(&words), PosePart::Matrix)))
        .filter(|_| !matches!(meaning, ColumnMeaning::Pose | ColumnMeaning::Joints { .. }))
        .map(|(key, part)| (String::new(), key, part));
    ColumnGroup { topic: column.name.clone(), cells, meaning, why, part }
}

/// Rows that start like rotation matrices, by rows or by columns. Constant ones show nothing.
fn rotation_rows(column: &Column, width: usize, elements: [usize; 9]) -> bool {
    /// Share of the rows, and tolerance of products for rounding to three digits.
    const MIN_PERCENT: usize = 95;
    const MAX_DEVIATION: f64 = 5e-3;
    let is_rotation = |row: &&[f64]| {
        let m = elements.map(|at| row[at]);
        rotation_from_matrix_rows([[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]])
            .is_some_and(|(_, defect)| defect < MAX_DEVIATION)
    };
    let rows = || column.values.chunks_exact(width);
    let count = rows().filter(is_rotation).count();
    column.width == width
        && 100 * count >= MIN_PERCENT * rows().len().max(1)
        && rows().next().is_some_and(|first| rows().any(|row| row != first))
}

fn are_rotations(column: &Column) -> bool {
    column.width == 9 && rotation_rows(column, 9, [0, 1, 2, 3, 4, 5, 6, 7, 8])
}

pub(super) fn are_homogeneous(column: &Column) -> bool {
    const ELEMENTS: [usize; 9] = [0, 1, 2, 4, 5, 6, 8, 9, 10];
    let is_last = |row: &[f64], last: [usize; 4]| last.map(|at| row[at]) == [0.0, 0.0, 0.0, 1.0];
    let rows = || column.values.chunks_exact(16);
    column.width == 16
        && [[12, 13, 14, 15], [3, 7, 11, 15]]
            .into_iter()
            .any(|last| rows().all(|row| is_last(row, last)))
        && rotation_rows(column, 16, ELEMENTS)
}

/// Whether another column is named for the velocities of these positions.
fn has_velocities(table: &Table, column: &Column) -> bool {
    let words = names::split_words(&column.name);
    let is_velocity = |other: &Column| {
        let others = names::split_words(&other.name);
        other.width == column.width && names::are_position_and_velocity(&words, &others)
    };
    table.columns.iter().any(is_velocity)
}

/// A list of as many names next to the positions of joints: `name` and `position`, as `ros2 topic echo` writes them,
/// `joint_names` and `joint_values`, or `joint_names` and `q`.
fn joint_state_names(table: &Table, column: &str, width: usize) -> Option<Vec<String>> {
    const LISTS: [&str; 3] = ["name", "names", "joint_names"];
    let own = column.rfind(['.', '/']).map_or(column, |at| &column[at + 1..]);
    let record = &column[..column.len() - own.len()];
    let of_positions = ["position", "positions"].iter().find_map(|end| column.strip_suffix(end));
    let is_of_joints = names::is_joint_positions(&names::split_words(own));
    let before = [of_positions, is_of_joints.then_some(record)].into_iter().flatten();
    let mut lists = before.flat_map(|before| LISTS.map(|list| format!("{before}{list}")));
    let name = |list: &str, at: usize| table.texts.get(&format!("{list}[{at}]")).cloned();
    lists.find_map(|list| {
        let names = (0..width).map(|at| name(&list, at)).collect::<Option<Vec<String>>>();
        names.filter(|_| width > 1 && name(&list, width).is_none())
    })
}

fn unit_by_name(words: &[String]) -> Option<AngleUnit> {
    if names::contains_any(words, names::DEGREE_WORDS) {
        return Some(AngleUnit::Degree);
    }
    names::contains_any(words, names::RADIAN_WORDS).then_some(AngleUnit::Radian)
}

fn unidentified_rest(column: &Column, cells: Vec<Cell>) -> ColumnGroup {
    let why = format!("its name does not show what these {} numbers are", cells.len());
    ColumnGroup::new(column.name.clone(), cells, ColumnMeaning::Numbers, why)
}

/// Joins each position with the rotation of the same name, then with one whose name states no frame: `pos_w` and `quat`.
fn join_pose_parts(table: &Table, groups: &mut [ColumnGroup]) {
    const WORLD: &str = "w";
    let without_world =
        |key: &[String]| key.iter().filter(|word| *word != WORLD).cloned().collect::<Vec<_>>();
    join_parts_of(table, groups, &|key| key.to_vec());
    join_parts_of(table, groups, &without_world);
}

/// Joins parts with the same words.
fn join_parts_of(
    table: &Table,
    groups: &mut [ColumnGroup],
    words: &dyn Fn(&[String]) -> Vec<String>,
) {
    for at in 0..groups.len() {
        let Some((home, key, PosePart::Position)) = groups[at].part.clone() else { continue };
        let key = words(&key);
        let is_turn = |group: &ColumnGroup| {
            group.part.as_ref().is_some_and(|(own_home, own, part)| {
                *own_home == home && words(own) == key && *part != PosePart::Position
            })
        };
        let turns = (0..groups.len()).filter(|&other| is_turn(&groups[other]));
        // If it is logged twice, prefer the quaternion.
        let rank = |group: &ColumnGroup| match group.part {
            Some((_, _, PosePart::Quaternion)) => 2,
            Some((_, _, PosePart::Matrix)) => 1,
            _ => 0,
        };
        let Some(other) = turns.max_by_key(|&other| rank(&groups[other])) else { continue };
        let turn = std::mem::take(&mut groups[other].cells);
        groups[other].part = None;
        let name = groups[other].topic.clone();
        let own = &mut groups[at];
        own.part = None;
        own.why = match own.why.starts_with("columns ") {
            true => format!("{}; {}", own.why, describe_origin(table, &turn, "its rotation")),
            false => {
                format!("a position, and its rotation in '{name}', by the names of the columns")
            }
        };
        own.meaning = ColumnMeaning::Pose;
        own.cells = pose_order(&own.cells, &turn);
    }
}

fn number_duplicates(groups: &mut [ColumnGroup]) {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for group in groups {
        let count = seen.entry(group.topic.clone()).or_default();
        *count += 1;
        if *count > 1 {
            group.topic = format!("{} ({count})", group.topic);
        }
    }
}

/// Names the only pose of a file after the file, if its columns do not name it.
fn name_after_file(groups: &mut [ColumnGroup], name: &str) {
    const UNNAMED: [&str; 2] = ["pose", "field_pose"];
    let is_other = |group: &&ColumnGroup| !matches!(group.meaning, ColumnMeaning::Unused);
    let unidentified = |group: &ColumnGroup| match group.meaning {
        ColumnMeaning::Numbers => group.cells.len(),
        _ => 0,
    };
    // So many may be joints.
    if name.is_empty()
        || groups.iter().map(unidentified).sum::<usize>() >= *JOINT_COUNTS.start()
        || groups.iter().filter(is_other).filter(|group| unidentified(group) == 0).count() != 1
    {
        return;
    }
    let is_pose = |group: &&mut ColumnGroup| {
        let meaning = &group.meaning;
        use ColumnMeaning::{Pose, Position, QuaternionPose};
        matches!(meaning, Pose | Position | QuaternionPose)
            && UNNAMED.contains(&group.topic.as_str())
    };
    if let Some(own) = groups.iter_mut().find(is_pose) {
        name.clone_into(&mut own.topic);
    }
}

fn describe_origin(table: &Table, cells: &[Cell], by: &str) -> String {
    let names: Vec<&str> = cells.iter().map(|&cell| name(table, cell)).collect();
    format!("columns {}, {by}", names.join(", "))
}

impl ColumnGroup {
    fn new(topic: String, cells: Vec<Cell>, meaning: ColumnMeaning, why: String) -> Self {
        Self { topic, cells, meaning, why, part: None }
    }

    /// With joint velocities.
    fn all_cells(&self) -> impl Iterator<Item = &Cell> {
        let velocities = match &self.meaning {
            ColumnMeaning::Joints { velocities, .. } => velocities.as_slice(),
            _ => &[],
        };
        self.cells.iter().chain(velocities)
    }

    /// Absolute and in the logged unit, without the gripper; 0 if no joints.
    fn max_position(&self, table: &Table) -> f64 {
        let ColumnMeaning::Joints { names, lines, .. } = &self.meaning else { return 0.0 };
        if !lines.is_empty() {
            return 0.0;
        }
        let arms = self
            .cells
            .iter()
            .zip(names)
            .filter(|(_, name)| !names::is_gripper(&names::split_words(name)));
        let sizes = arms.flat_map(|(&cell, _)| numbers(table, cell).map(f64::abs));
        sizes.filter(|size| is_usable(*size)).fold(0.0, f64::max)
    }

    /// One topic, or one for each stream of a long table that has numbers of the group.
    fn into_topics(
        self,
        table: &Table,
        clocks: (&Clock, &Clock),
        values: (f64, &Sampling),
        labels: Option<&RowLabels>,
    ) -> Vec<TableTopic> {
        let Some(labels) = labels else {
            return vec![self.into_topic(table, clocks, values, None)];
        };
        if labels.cell.is_some_and(|cell| self.cells == [cell]) {
            let (meaning, why) = (ColumnMeaning::Unused, ROW_LABEL.to_owned());
            let own = Self { meaning, why, part: None, ..self };
            return vec![own.into_topic(table, clocks, values, None)];
        }
        let streams = labels.streams().into_iter();
        let topics = streams
            .map(|stream| self.clone().into_topic(table, clocks, values, Some((labels, stream))));
        topics.filter(|topic| topic.rows + topic.unstamped > 0 || topic.damaged.is_some()).collect()
    }

    /// `most` is the largest joint position of the table. Beyond two turns all joint positions are taken
    /// for degrees, in states and in commands.
    fn into_topic(
        self,
        table: &Table,
        (clock, own): (&Clock, &Clock),
        (most, sampling): (f64, &Sampling),
        stream: Option<(&RowLabels, Option<usize>)>,
    ) -> TableTopic {
        let mut own_rows = sampling.own_rows(table, &self);
        let Self { mut topic, cells, meaning, mut why, .. } = self;
        if let Some((labels, stream)) = stream {
            let rows = labels.rows.iter().enumerate();
            let is_own = |(row, label): (usize, &Option<usize>)| {
                *label == stream && own_rows.as_ref().is_none_or(|own_rows| own_rows[row])
            };
            own_rows = Some(rows.map(is_own).collect());
            let value = stream.map(|stream| labels.values[stream].as_str());
            topic = value.map_or_else(|| topic.clone(), |value| format!("{value}/{topic}"));
        }
        if let Some(own_rows) = &own_rows {
            let count = own_rows.iter().filter(|is_own| **is_own).count();
            why += &format!("; in {count} of {} rows", table.rows);
        }
        let mut contradiction = None;
        let kind = cells.first().map_or("", |cell| &table.columns[cell.column].kind);
        let kind =
            if cells.len() == 1 { kind.to_owned() } else { format!("{kind}[{}]", cells.len()) };
        let at = |row: usize, cell: &Cell| table.number(row, *cell);
        let columns: BTreeSet<usize> = cells.iter().map(|cell| cell.column).collect();
        let with_losses: Vec<usize> =
            columns.into_iter().filter(|column| table.lost_rows.contains_key(column)).collect();
        let (mut rows, mut unstamped) = (Vec::with_capacity(table.rows), 0);
        for (row, (stamp, own)) in clock.stamps.iter().zip(&own.stamps).enumerate() {
            // Reported as losses, not as gaps or NaN.
            if with_losses.iter().any(|column| table.is_lost(*column, row))
                || own_rows.as_ref().is_some_and(|own_rows| !own_rows[row])
            {
                continue;
            }
            match (*own, *stamp) {
                (Some(own), Some(stamp)) => {
                    rows.push((row, RowStamps { column_ns: own, row_ns: stamp }))
                }
                (None, Some(_)) if cells.iter().any(|cell| at(row, cell).is_finite()) => {
                    unstamped += 1
                }
                _ => {}
            }
        }
        let damaged = match meaning {
            ColumnMeaning::Unused => None,
            ColumnMeaning::Numbers if cells.len() < MIN_CELLS => None,
            _ => row_losses::remove_damaged_rows(table, &mut rows, cells.len(), |row, cell| {
                at(row, &cells[cell])
            }),
        };
        let mut stamps: Vec<RowStamps> = rows.iter().map(|(_, stamp)| *stamp).collect();
        RowStamps::put_in_row_order(&mut stamps);
        let is_position = matches!(
            meaning,
            ColumnMeaning::Pose | ColumnMeaning::Position | ColumnMeaning::QuaternionPose
        );
        let lengths_m = is_position.then(|| mixed_lengths_m(table, &cells)).flatten();
        if lengths_m.is_some() {
            why += "; in different units of length, by name";
        }
        let factor = |part: usize| {
            lengths_m.as_ref().and_then(|units| units.get(part)).copied().unwrap_or(1.0)
        };
        let values = || -> Vec<f64> {
            let row = |row: usize| {
                cells.iter().enumerate().map(move |(part, cell)| factor(part) * at(row, cell))
            };
            rows.iter().flat_map(|&(at, _)| row(at)).collect()
        };
        let usable_values_of = |cell: &Cell| -> Vec<f64> {
            rows.iter().map(|&(row, _)| usable_or_nan(at(row, cell))).collect()
        };
        let is_pose = matches!(meaning, ColumnMeaning::Pose);
        let velocity_cells = match &meaning {
            ColumnMeaning::Joints { velocities, .. } => {
                velocities.iter().map(|&cell| table_cell(table, cell)).collect()
            }
            _ => Vec::new(),
        };
        let is_open = matches!(meaning, ColumnMeaning::Numbers);
        let velocities = match &meaning {
            ColumnMeaning::Velocities(unit) => {
                let stamps = stamps.iter().map(|stamp| stamp.column_ns).collect();
                Some(Velocities { stamps, values: values(), width: cells.len(), unit: *unit })
            }
            _ => None,
        };
        let columns = match meaning {
            ColumnMeaning::Joints { names, unnamed, lines, velocities } => {
                let positions = names.into_iter().zip(cells.iter().map(usable_values_of));
                let joints = joint_columns(&stamps, positions);
                let mut joints = JointColumns { unnamed, ..joints };
                for (joint, cell) in joints.joints.iter_mut().zip(&velocities) {
                    joint.velocity = usable_values_of(cell).into();
                }
                for (joint, [factor, offset]) in joints.joints.iter_mut().zip(&lines) {
                    joint.position.iter_mut().for_each(|q| *q = factor * *q + offset);
                    joint.velocity.update(|v| v * factor);
                }
                // Velocities have the unit of the positions, unless their names or values say otherwise.
                let in_words = |known: &[&str]| {
                    velocities.iter().any(|&cell| names::has_word(name(table, cell), known))
                };
                let is_named = cells.iter().all(|&cell| names::says_degrees(name(table, cell)));
                let says_rad =
                    |cell: &&Cell| names::has_word(name(table, **cell), names::RADIAN_WORDS);
                // `joints_rad` next to `joints_deg`.
                let is_small = || {
                    let mut positions = joints.joints.iter().flat_map(|joint| &joint.position);
                    positions.all(|position| position.is_nan() || position.abs() <= TWO_TURNS_RAD)
                };
                let is_rad = cells.iter().all(|cell| says_rad(&cell)) && is_small();
                let are_degrees =
                    (is_named || (most > TWO_TURNS_RAD && !is_rad)) && lines.is_empty();
                let are_radians = || in_words(names::RADIAN_WORDS) || are_rates_in_radians(&joints);
                if in_words(names::DEGREE_WORDS) || (are_degrees && !are_radians()) {
                    joints.joints.iter_mut().for_each(|it| it.velocity.update(f64::to_radians));
                }
                if are_degrees {
                    why += &match is_named {
                        true => "; in degrees, by name".to_owned(),
                        false => {
                            format!(
                                "; taken for degrees: values up to {most:.1} are too large for rad"
                            )
                        }
                    };
                    if let Some(what) = why_not_degrees(table, &cells, most) {
                        why += &format!(", but {what}");
                    }
                    contradiction = cells.iter().find(says_rad).map(|&cell| {
                        let name = name(table, cell);
                        format!(
                            "the name '{name}' indicates rad, but joint positions reach {most:.1}"
                        )
                    });
                    joints.converted_from_degrees = true;
                    let all = joints.joints.iter_mut().flat_map(|joint| &mut joint.position);
                    all.for_each(|position| *position = position.to_radians());
                }
                joints.conversions = lines;
                Some(Columns::Joints(joints))
            }
            ColumnMeaning::Pose => {
                Some(Columns::Array(array_columns(&stamps, cells.len(), &values())))
            }
            ColumnMeaning::Numbers => {
                let array = array_columns(&stamps, cells.len(), &values());
                Some(Columns::Array(ArrayColumns { unnamed: true, ..array }))
            }
            ColumnMeaning::Position | ColumnMeaning::QuaternionPose => {
                Some(Columns::Poses(vec![pose_columns(&stamps, cells.len(), &values())]))
            }
            ColumnMeaning::Unused | ColumnMeaning::Velocities(_) => None,
        };
        let names: Vec<&str> = cells.iter().map(|&cell| name(table, cell)).collect();
        let labels = names.get(3..).filter(|_| is_pose).and_then(names::rotation_labels);
        let cell = |(at, &cell): (usize, &Cell)| TableCell {
            labels: labels.filter(|_| at >= 3),
            is_unidentified: is_open && is_measured(table, cell),
            ..table_cell(table, cell)
        };
        let cells = cells.iter().enumerate().map(cell).collect();
        let rows = stamps.len() as u64;
        TableTopic {
            topic,
            kind,
            why,
            cells,
            velocity_cells,
            velocities,
            contradiction,
            columns,
            rows,
            unstamped,
            damaged,
        }
    }
}

/// Whether positions are in degrees and velocities in rad/s, 57 times smaller than the rates of the positions.
fn are_rates_in_radians(joints: &JointColumns) -> bool {
    /// To the rates in rad/s.
    const RATIO: std::ops::Range<f64> = 0.5..2.0;
    let t_s: Vec<f64> = joints.times.header.iter().map(|ns| *ns as f64 * 1e-9).collect();
    let (mut products, mut squares) = (0.0, 0.0);
    for joint in &joints.joints {
        for row in 1..t_s.len().saturating_sub(1) {
            let moved = joint.position[row + 1] - joint.position[row - 1];
            let rate = moved.to_radians() / (t_s[row + 1] - t_s[row - 1]);
            let velocity = joint.velocity[row];
            if rate.is_finite() && velocity.is_finite() {
                (products, squares) = (products + rate * velocity, squares + rate * rate);
            }
        }
    }
    RATIO.contains(&(products / squares))
}
