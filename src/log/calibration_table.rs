//! Calibration tables: rows of joint positions, with or without measured poses, without stamps.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use csv::{ReaderBuilder, Trim};

use super::file_format::{self, FileFormat};
use super::tables::{
    JoinedRows, LayoutGroup, LayoutTime, TableFormat, delimiter_of_numbers, is_text,
    names_and_rows, rows_of_lists, to_utf8,
};
use super::{ColumnSettings, LogError, Meaning, RowLayout, local};
use ground::geometry::{
    AngleUnit, LengthScale, RotationEncoding, rotation_from_matrix_rows, xyzw_from_rotation,
};

/// Limits in bytes and rows.
const MAX_BYTES: u64 = 1 << 26;
const MAX_ROWS: usize = 100_000;

/// Table of numeric rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NumberTable {
    /// Column names; empty if the first line has numbers.
    pub names: Vec<String>,
    /// Rows, all with the same number of columns.
    pub rows: Vec<Vec<f64>>,
    /// Line numbers of rows with non-finite cells or another number of columns.
    pub dropped: Vec<usize>,
    /// Name of the position of the tool in the file, which a layout replaces in `names`.
    pub pose_name: Option<String>,
}

/// Table of joint positions and measured poses, with named columns.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationTable {
    /// All columns.
    pub numbers: NumberTable,
    /// Position columns x, y, z of each measured point; rotations belong to the first.
    pub positions: Vec<[usize; 3]>,
    /// Rotation columns, if any.
    pub rotation: RotationColumns,
}

impl CalibrationTable {
    /// Name of the first position in the file.
    pub fn pose_name(&self) -> Option<&str> {
        let named = || Some(self.numbers.names.get(self.positions.first()?[0])?.as_str());
        self.numbers.pose_name.as_deref().or_else(named)
    }
}

/// Columns of a rotation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RotationColumns {
    /// Quaternion: x, y, z, w.
    Quaternion([usize; 4]),
    /// Three numbers, any convention.
    Numbers([usize; 3]),
    /// No rotation.
    None,
}

/// Prefixes and suffixes of column names.
const POSITIONS: [&str; 13] = [
    "", "p", "p_", "pos_", "pos", "position_", "position.", "position.x.", "t", "t_", "tcp_",
    "tool_", "translation_",
];
const QUATERNIONS: [&str; 7] =
    ["q", "q_", "quat_", "quat", "orientation_", "orientation.", "rot_q"];
const NUMBERS: [&str; 10] =
    ["r", "r_", "rot_", "rot", "phi", "phi_", "euler_", "rotvec_", "o", "theta_"];
const TRIPLES: [[&str; 3]; 4] =
    [["roll", "pitch", "yaw"], ["a", "b", "c"], ["w", "p", "r"], ["alpha", "beta", "gamma"]];
const SUFFIXES: [&str; 5] = ["", "1", "_1", "_m", "_mm"];
/// Points measured per row.
const MAX_POINTS: usize = 64;

/// Reads the table at `path`, by its layout in `settings` or by the names of its columns. `None` if it is a log.
///
/// # Errors
/// If the file cannot be opened, its layout does not fit, or it has no position columns.
pub fn read_calibration_table(
    path: &Path,
    settings: &ColumnSettings,
) -> Result<Option<CalibrationTable>, LogError> {
    let Some(numbers) = read_named_numbers(path, settings)? else { return Ok(None) };
    match by_names(numbers) {
        None if !declares_times(path, settings) => Err(without_poses(path)),
        table => Ok(table),
    }
}

/// A layout with times is that of a log.
fn declares_times(path: &Path, settings: &ColumnSettings) -> bool {
    settings.layout_of(path).is_some_and(|layout| layout.time() != LayoutTime::Open)
}

fn without_poses(path: &Path) -> LogError {
    LogError::ConfigurationColumns {
        path: path.to_owned(),
        what: "its columns name no position of the tool".to_owned(),
    }
}

/// A table whose columns are unknown.
pub fn not_configurations(path: &Path) -> LogError {
    LogError::ConfigurationColumns {
        path: path.to_owned(),
        what: "it is not read as a table of configurations".to_owned(),
    }
}

/// Reads two tables of the same configurations, one of joints and one of measured poses. `None` if they are something else.
///
/// # Errors
/// Those of [`read_calibration_table`], and if their rows do not correspond.
pub fn read_calibration_tables(
    paths: [&Path; 2],
    settings: &ColumnSettings,
) -> Result<Option<CalibrationTable>, LogError> {
    let [one, other] = paths.map(|path| Ok((path, read_named_numbers(path, settings)?)));
    let has_poses = |table: &NumberTable| columns(&table.names).is_some();
    let is_any_log = paths.into_iter().any(|path| declares_times(path, settings));
    let ((first, one), (second, other)) = match (one?, other?) {
        ((first, Some(one)), (second, Some(other))) => ((first, one), (second, other)),
        ((_, Some(one)), (path, None)) | ((path, None), (_, Some(one)))
            if !has_poses(&one) && !is_any_log =>
        {
            return Err(not_configurations(path));
        }
        _ => return Ok(None),
    };
    let (joints, poses) = match (has_poses(&one), has_poses(&other)) {
        (false, true) => ((first, one), (second, other)),
        (true, false) => ((second, other), (first, one)),
        (false, false) => return Err(without_poses(first)),
        (true, true) => return Ok(None),
    };
    join_rows(joints, vec![poses]).map(by_names)
}

/// Reads tables of the same configurations, one of joints and several of points on the tool, by their layouts in
/// `settings`. `None` if the layouts state something else.
///
/// # Errors
/// Those of [`read_calibration_tables`].
pub fn read_calibration_points(
    paths: &[&Path],
    settings: &ColumnSettings,
) -> Result<Option<CalibrationTable>, LogError> {
    let states = |path: &Path, is_wanted: fn(Meaning) -> bool| {
        let layout = settings.layout_of(path).filter(|layout| layout.time() == LayoutTime::Open);
        let items = layout.map(RowLayout::items).unwrap_or_default();
        items.iter().any(|item| !item.is_command && is_wanted(item.meaning))
    };
    let has_joints = |path: &Path| states(path, |meaning| meaning == Meaning::Joints);
    let has_position = |path: &Path| states(path, |meaning| meaning == Meaning::Axis(0));
    let (joints, points): (Vec<&Path>, Vec<&Path>) =
        paths.iter().copied().partition(|&path| has_joints(path));
    let &[joints] = joints.as_slice() else { return Ok(None) };
    if has_position(joints) || !points.iter().all(|&path| has_position(path)) {
        return Ok(None);
    }
    let has_rotation = |path: &Path| {
        states(path, |meaning| {
            matches!(
                meaning,
                Meaning::QuaternionPart(_)
                    | Meaning::Rotation(_)
                    | Meaning::Matrix
                    | Meaning::Vendor(_)
            )
        })
    };
    if let Some(path) = points.iter().find(|&&path| has_rotation(path)) {
        return Err(LogError::Configurations {
            path: path.to_path_buf(),
            what: "it has rotations, but of several points only the positions are used".to_owned(),
            remedy: "write `_` for the columns of its rotations in --columns",
        });
    }
    let read = |path| -> Result<_, LogError> {
        let numbers = read_named_numbers(path, settings)?;
        Ok((path, numbers.ok_or_else(|| not_configurations(path))?))
    };
    let points: Result<Vec<(&Path, NumberTable)>, LogError> =
        points.into_iter().map(read).collect();
    join_rows(read(joints)?, points?).map(by_names)
}

/// Joins tables of the same configurations, of joints and of measured points. Only the first point has a rotation.
fn join_rows(
    (path, mut joints): (&Path, NumberTable),
    points: Vec<(&Path, NumberTable)>,
) -> Result<NumberTable, LogError> {
    let unusable = |path: &Path, what| LogError::Configurations {
        path: path.to_owned(),
        what,
        remedy: "each row of one table must belong to the same row of the others",
    };
    let others = points.iter().map(|(path, table)| (*path, table));
    for (path, table) in std::iter::once((path, &joints)).chain(others) {
        if let Some(line) = table.dropped.first() {
            let (lost, width) = (table.dropped.len(), table.width());
            let what = format!(
                "{lost} of its rows, the first in line {line}, do not hold {width} numbers"
            );
            return Err(unusable(path, what));
        }
    }
    if joints.names.is_empty() {
        joints.names = (1..=joints.width()).map(|joint| format!("q{joint}")).collect();
    }
    for (number, (path, table)) in (1..).zip(points) {
        let [rows, expected] = [&table, &joints].map(|table| table.rows.len());
        if rows != expected {
            let what = format!("it has {rows} rows, but the joints have {expected}");
            return Err(unusable(path, what));
        }
        let rename = |name: String| match name.as_str() {
            _ if number == 1 => name,
            "x" | "y" | "z" => format!("{name}{number}"),
            _ => "_".to_owned(),
        };
        joints.names.extend(table.names.into_iter().map(rename));
        joints.pose_name = joints.pose_name.or(table.pose_name);
        joints.rows.iter_mut().zip(table.rows).for_each(|(row, point)| row.extend(point));
    }
    Ok(joints)
}

/// Numbers at `path`, with the names of their columns by its layout in `settings` or by its header.
fn read_named_numbers(
    path: &Path,
    settings: &ColumnSettings,
) -> Result<Option<NumberTable>, LogError> {
    let Some(bytes) = read_bytes(path)? else { return Ok(None) };
    let layout = settings.layout_of(path).filter(|layout| layout.time() == LayoutTime::Open);
    let of_table = |format: TableFormat| {
        let (names, rows) = names_and_rows(format, path, &bytes)?;
        let is_finite = |row: &Vec<f64>| row.iter().all(|number| number.is_finite());
        let (rows, dropped): (Vec<_>, Vec<_>) =
            (1..).zip(rows).partition(|(_, row): &(usize, Vec<f64>)| is_finite(row));
        Some(NumberTable {
            // Those of an array state nothing.
            names: if layout.is_some() { names } else { Vec::new() },
            rows: rows.into_iter().map(|(_, row)| row).collect(),
            dropped: dropped.into_iter().map(|(at, _)| at).collect(),
            pose_name: None,
        })
    };
    let numbers = match file_format::detect_format(&bytes) {
        FileFormat::Table(format) if layout.is_some() || format == TableFormat::Npy => {
            of_table(format)
        }
        _ => None,
    };
    match (layout, numbers.or_else(|| parse_numbers(&bytes, layout))) {
        (Some(layout), Some(numbers)) => named_by_layout(numbers, layout)
            .map(Some)
            .map_err(|what| LogError::Layout { path: path.to_owned(), what }),
        (_, numbers) => Ok(numbers),
    }
}

/// Reads a text table of numbers at `path`. `None` if it is a log, a list of records or no text.
///
/// # Errors
/// If the file cannot be opened.
pub fn read_number_table(path: &Path) -> Result<Option<NumberTable>, LogError> {
    Ok(read_bytes(path)?.and_then(|bytes| parse_numbers(&bytes, None)))
}

fn read_bytes(path: &Path) -> Result<Option<Vec<u8>>, LogError> {
    let Some(path) = local(path) else { return Ok(None) };
    if path.is_dir() {
        return Ok(JoinedRows::in_folder(&path).map(|rows| rows.content));
    }
    if !path.is_file() {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    let read = File::open(&path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
    read.map_err(|source| LogError::Io { path, source })?;
    Ok(Some(bytes))
}

fn by_names(numbers: NumberTable) -> Option<CalibrationTable> {
    let (positions, rotation) = columns(&numbers.names)?;
    Some(CalibrationTable { numbers, positions, rotation })
}

/// Names the columns of the joints, of the tool position and of its rotation, and converts joint positions and tool
/// positions to rad and m if their units are declared.
fn named_by_layout(mut numbers: NumberTable, layout: &RowLayout) -> Result<NumberTable, String> {
    if numbers.width() != layout.width() {
        return Err(format!(
            "--columns names {} columns, but its rows have {}",
            layout.width(),
            numbers.width()
        ));
    }
    let groups = layout.groups();
    let is_matrix = |group: &LayoutGroup| matches!(group.rotation.len(), 12 | 16);
    let is_measured = |group: &&LayoutGroup| {
        !group.is_command && (is_matrix(group) || !group.position.is_empty())
    };
    let has_joints = |group: &&LayoutGroup| !group.is_command && !group.joints.is_empty();
    let group = groups.iter().find(is_measured).or_else(|| groups.iter().find(has_joints));
    let Some(group) = group else {
        numbers.names = vec!["_".to_owned(); numbers.width()];
        return Ok(numbers);
    };
    let (position, rotation) = match is_matrix(group) {
        true => {
            let position = append_quaternions(&mut numbers, &group.rotation)?;
            (position.to_vec(), (layout.width()..layout.width() + 4).collect())
        }
        false => (group.position.clone(), group.rotation.clone()),
    };
    let names_of_rotation: &[&str] = match (rotation.len(), group.coding) {
        (0, _) => &[],
        _ if is_matrix(group) => &["qx", "qy", "qz", "qw"],
        (3, _) => &["rx", "ry", "rz"],
        (4, Some(RotationEncoding::Wxyz)) => &["qw", "qx", "qy", "qz"],
        (4, Some(RotationEncoding::Xyzw)) => &["qx", "qy", "qz", "qw"],
        _ => {
            return Err("`calibrate` needs rotations in --columns as three numbers, `quat:xyzw` or `quat:wxyz`".to_owned());
        }
    };
    numbers.pose_name = position.first().and_then(|&at| numbers.names.get(at).cloned());
    let joint_unit = group.joint_unit.map_or(1.0, AngleUnit::in_rad);
    let length = group.units.length.map_or(1.0, LengthScale::in_m);
    for row in &mut numbers.rows {
        group.joints.iter().for_each(|&at| row[at] *= joint_unit);
        position.iter().for_each(|&at| row[at] *= length);
    }
    numbers.names = vec!["_".to_owned(); numbers.width()];
    for (joint, &at) in (1..).zip(&group.joints) {
        numbers.names[at] = format!("q{joint}");
    }
    let of_pose = position
        .iter()
        .zip(["x", "y", "z"])
        .chain(rotation.iter().zip(names_of_rotation.iter().copied()));
    of_pose.for_each(|(&at, name)| name.clone_into(&mut numbers.names[at]));
    Ok(numbers)
}

/// Appends the quaternions of matrices by rows, or by columns if the last row is there. Returns the columns of the
/// position.
fn append_quaternions(numbers: &mut NumberTable, matrix: &[usize]) -> Result<[usize; 3], String> {
    let is_last_row =
        |row: &[f64], last: [usize; 4]| last.map(|at| row[matrix[at]]) == [0.0, 0.0, 0.0, 1.0];
    let by_columns =
        matrix.len() == 16 && numbers.rows.iter().all(|row| is_last_row(row, [3, 7, 11, 15]));
    let element = |row: usize, column: usize| {
        matrix[if by_columns { 4 * column + row } else { 4 * row + column }]
    };
    for row in &mut numbers.rows {
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| row[element(i, j)]));
        let Some((rotation, _)) = rotation_from_matrix_rows(rows) else {
            return Err("--columns declares a matrix, but it contains no rotation".to_owned());
        };
        row.extend(xyzw_from_rotation(&rotation));
    }
    Ok([0, 1, 2].map(|axis| element(axis, 3)))
}

/// A layout that ignores the times makes a log a table of configurations. Cells that it ignores may be text.
fn parse_numbers(bytes: &[u8], layout: Option<&RowLayout>) -> Option<NumberTable> {
    let meanings = layout.map(RowLayout::meanings).unwrap_or_default();
    let is_ignored = |at: usize| meanings.get(at) == Some(&Meaning::Ignored);
    let may_have_times = layout.is_none() || meanings.contains(&Meaning::Open);
    let is_of_records = matches!(
        file_format::detect_format(bytes),
        FileFormat::Table(TableFormat::Json | TableFormat::Yaml)
    );
    let is_log = is_of_records || (may_have_times && super::looks_like_log(bytes));
    if !is_text(bytes) || bytes.len() as u64 > MAX_BYTES || is_log {
        return None;
    }
    let bytes = &*to_utf8(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes));
    let rows = rows_of_lists(bytes);
    let bytes = rows.as_deref().unwrap_or(bytes);
    let first = bytes
        .split(|byte| *byte == b'\n')
        .find(|line| !line.trim_ascii().is_empty() && !line.starts_with(b"#"))?;
    let count = |sign: u8| first.trim_ascii().iter().filter(|byte| **byte == sign).count();
    let delimiter = delimiter_of_numbers(bytes).or_else(|| {
        [b',', b';', b'\t', b' '].into_iter().max_by_key(|&sign| (count(sign), sign != b' '))
    })?;
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .trim(Trim::All)
        .flexible(true)
        .has_headers(false)
        .comment(Some(b'#'))
        .from_reader(bytes);
    let number = |cell: &str| -> Option<f64> {
        match delimiter {
            b',' => cell.parse().ok(),
            _ => cell.replace(',', ".").parse().ok(),
        }
    };
    // Several spaces between columns are empty cells.
    let is_cell = |text: &&str| delimiter != b' ' || !text.is_empty();
    let mut table = NumberTable::default();
    let mut width = None;
    for (at, record) in reader.records().take(MAX_ROWS).enumerate() {
        let Ok(record) = record else {
            table.dropped.push(at + 1);
            continue;
        };
        let cells: Vec<&str> = record.iter().filter(is_cell).collect();
        let is_first = width.is_none();
        let width = *width.get_or_insert(cells.len());
        let is_text = |(at, cell): (usize, &&str)| !is_ignored(at) && number(cell).is_none();
        if is_first && cells.iter().enumerate().any(is_text) {
            table.names = cells.into_iter().map(str::to_owned).collect();
            continue;
        }
        let finite = |(at, cell): (usize, &&str)| match number(cell) {
            Some(value) if value.is_finite() => Some(value),
            _ => is_ignored(at).then_some(0.0),
        };
        match cells.iter().enumerate().map(finite).collect::<Option<Vec<f64>>>() {
            Some(row) if row.len() == width => table.rows.push(row),
            _ => {
                let line = record.position().map(|position| position.line() as usize);
                table.dropped.push(line.unwrap_or(at + 1));
            }
        }
    }
    Some(table)
}

fn columns(names: &[String]) -> Option<(Vec<[usize; 3]>, RotationColumns)> {
    let lower: Vec<String> = names.iter().map(|name| name.to_lowercase()).collect();
    let at = |name: String| lower.iter().position(|own| *own == name);
    let axes = |prefix: &str, suffix: &str| -> Option<[usize; 3]> {
        let [x, y, z] = ["x", "y", "z"].map(|axis| at(format!("{prefix}{axis}{suffix}")));
        Some([x?, y?, z?])
    };
    // A first point without a number, or numbered points.
    let points = |prefix: &str| -> Vec<[usize; 3]> {
        let first = SUFFIXES.iter().find_map(|suffix| axes(prefix, suffix));
        let next = (2..=MAX_POINTS).map_while(|point| {
            ["", "_"].iter().find_map(|between| axes(prefix, &format!("{between}{point}")))
        });
        first.into_iter().chain(next).collect()
    };
    let positions =
        POSITIONS.iter().map(|prefix| points(prefix)).find(|found| !found.is_empty())?;
    let quaternion = QUATERNIONS.iter().find_map(|prefix| {
        SUFFIXES.iter().find_map(|suffix| {
            let [x, y, z] = axes(prefix, suffix)?;
            Some([x, y, z, at(format!("{prefix}w{suffix}"))?])
        })
    });
    let triple = || {
        let named = |names: &[&str; 3], ending: &str| -> Option<[usize; 3]> {
            let [a, b, c] = names.map(|name| at(format!("{name}{ending}")));
            Some([a?, b?, c?])
        };
        let endings = ["", "1", "_1", "_deg", "_rad"];
        let angles =
            NUMBERS.iter().find_map(|prefix| endings.iter().find_map(|end| axes(prefix, end)));
        angles.or_else(|| {
            TRIPLES.iter().find_map(|names| endings.iter().find_map(|end| named(names, end)))
        })
    };
    let rotation = match quaternion {
        Some(columns) => RotationColumns::Quaternion(columns),
        None => triple().map_or(RotationColumns::None, RotationColumns::Numbers),
    };
    Some((positions, rotation))
}

impl NumberTable {
    /// Number of columns.
    pub fn width(&self) -> usize {
        self.rows.first().map_or(self.names.len(), Vec::len)
    }

    /// Columns of the joints by these names, otherwise by number, from 0 or 1: `q1`, `joint_1`, `J1`. A table
    /// without names must have one column per joint.
    pub fn joints(&self, names: &[String]) -> Option<Vec<usize>> {
        const NUMBERED: [&str; 12] = [
            "q", "q_", "q[", "j", "j_", "joint", "joint_", "joint_position_", "theta", "theta_",
            "a", "axis",
        ];
        if self.names.is_empty() {
            return (self.width() == names.len()).then(|| (0..names.len()).collect());
        }
        let lower: Vec<String> = self.names.iter().map(|name| name.to_lowercase()).collect();
        let all = |name: &dyn Fn(usize) -> String| -> Option<Vec<usize>> {
            (0..names.len()).map(|joint| lower.iter().position(|own| *own == name(joint))).collect()
        };
        let by_name = all(&|joint| names[joint].to_lowercase());
        let by_number = || {
            NUMBERED.iter().find_map(|stem| {
                [1, 0].iter().find_map(|first| {
                    ["", "_deg", "_rad", "]"]
                        .iter()
                        .find_map(|ending| all(&|joint| format!("{stem}{}{ending}", joint + first)))
                })
            })
        };
        by_name.or_else(by_number)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::FileLayout;

    fn names(of: &[&str]) -> Vec<String> {
        of.iter().map(|&name| name.to_owned()).collect()
    }

    fn by_layout(
        numbers: NumberTable,
        layout: &RowLayout,
    ) -> Result<Option<CalibrationTable>, String> {
        named_by_layout(numbers, layout).map(by_names)
    }

    fn parse_table(bytes: &[u8]) -> Option<CalibrationTable> {
        parse_numbers(bytes, None).and_then(by_names)
    }

    #[test]
    fn a_layout_names_the_columns_of_a_table_without_names() {
        let numbers = || parse_numbers(b"180;90;1000;0;2000;7;1;0;0;0\n", None).unwrap();
        let read = |layout: &str| by_layout(numbers(), &layout.parse().unwrap());
        let table = read("q[2]:deg,xyz:mm,_,quat:wxyz").unwrap().unwrap();
        assert_eq!(table.positions, [[2, 3, 4]]);
        assert_eq!(table.rotation, RotationColumns::Quaternion([7, 8, 9, 6]));
        let row = &table.numbers.rows[0];
        assert_eq!(row[..5], [PI, PI / 2.0, 1.0, 0.0, 2.0]);
        assert_eq!(table.numbers.joints(&names(&["a", "b"])), Some(vec![0, 1]));
        assert_eq!(table.numbers.joints(&names(&["a", "b", "c"])), None);
        assert_eq!(read("q[2],_[8]"), Ok(None));
        let matrix = parse_numbers(b"1;2;0;-1;0;10;1;0;0;20;0;0;1;30\n", None).unwrap();
        let table = by_layout(matrix, &"q[2],matrix[12]:mm".parse().unwrap()).unwrap().unwrap();
        let (row, [p]) = (&table.numbers.rows[0], table.positions.as_slice()) else { panic!() };
        assert_eq!(p.map(|at| row[at]), [0.01, 0.02, 0.03]);
        let RotationColumns::Quaternion(q) = table.rotation else { panic!("{table:?}") };
        let [x, y, z, w] = q.map(|at| row[at]);
        assert!(x.abs() + y.abs() < 1e-12 && (z - w).abs() < 1e-12, "{row:?}");
        let line = read("q[2],xyz,rot[4],_").unwrap_err();
        assert!(line.contains("needs rotations"), "{line}");
        let line = read("q[2],xyz").unwrap_err();
        assert!(line.contains("--columns names 5 columns, but its rows have 10"), "{line}");
    }

    #[test]
    fn lists_within_a_list_are_configurations() {
        let table = parse_numbers(b"q = [\n [1, 2, 3],\n [4, 5, 6]\n]\n", None).unwrap();
        assert_eq!(table.rows, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert!(table.dropped.is_empty(), "{table:?}");
    }

    #[test]
    fn a_layout_without_times_makes_rows_configurations() {
        let text = b"Timestamp;a;b;Target;X;Y;Z\n7;1,5;2;TMC;1;2;3\n7;2;2,5;;4;5;6\n";
        let read = |layout: &str| {
            let layout: RowLayout = layout.parse().unwrap();
            let numbers = parse_numbers(text, Some(&layout))?;
            by_layout(numbers, &layout).unwrap()
        };
        let table = read("_,q[2],_,xyz:mm").unwrap();
        assert_eq!(table.pose_name(), Some("X"));
        let rows = table.numbers.rows;
        assert_eq!(
            rows,
            [[7.0, 1.5, 2.0, 0.0, 1e-3, 2e-3, 3e-3], [7.0, 2.0, 2.5, 0.0, 4e-3, 5e-3, 6e-3]]
        );
        assert_eq!(read("?,q[2],_,xyz:mm"), None);
    }

    #[test]
    fn columns_are_identified_by_name() {
        let table = parse_table(
            b"q1,q2,x,y,z,rx,ry,rz\n1,2,3,4,5,6,7,8\n1,2,3,4,5,6,7\n1,2,3,nan,5,6,7,8\n",
        )
        .unwrap();
        assert_eq!(table.positions, [[2, 3, 4]]);
        assert_eq!(table.rotation, RotationColumns::Numbers([5, 6, 7]));
        let numbers = table.numbers;
        assert_eq!(numbers.joints(&names(&["shoulder", "elbow"])), Some(vec![0, 1]));
        assert_eq!((numbers.rows.len(), numbers.dropped.as_slice()), (1, [3, 4].as_slice()));
        let table = parse_table(b"X;Y;Z;qx;qy;qz;qw;elbow\n0,5;0;0;0;0;0;1;0,25\n").unwrap();
        assert_eq!(table.rotation, RotationColumns::Quaternion([3, 4, 5, 6]));
        let numbers = table.numbers;
        assert_eq!(numbers.rows[0][7], 0.25);
        assert_eq!(numbers.joints(&names(&["elbow"])), Some(vec![7]));
        assert_eq!(numbers.joints(&names(&["elbow", "wrist"])), None);
    }

    #[test]
    fn joints_and_poses_may_be_in_two_tables() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &[u8]| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let joints = write("q.txt", b"1 2\n3 4\n");
        let poses = write("p.csv", b"x,y,z,qx,qy,qz,qw\n5,6,7,0,0,0,1\n8,9,10,0,0,0,1\n");
        let settings = ColumnSettings::default();
        let read = |one: &Path, other: &Path| read_calibration_tables([one, other], &settings);
        for (one, other) in [(&joints, &poses), (&poses, &joints)] {
            let table = read(one, other).unwrap().unwrap();
            assert_eq!(table.numbers.rows[1], [3.0, 4.0, 8.0, 9.0, 10.0, 0.0, 0.0, 0.0, 1.0]);
            assert_eq!(table.positions, [[2, 3, 4]]);
            assert_eq!(table.numbers.joints(&names(&["a", "b"])), Some(vec![0, 1]));
        }
        let file = |path: &Path, layout: &str| -> FileLayout {
            let name = path.file_name().unwrap().to_string_lossy();
            format!("{name}={layout}").parse().unwrap()
        };
        let [one, two] = ["1.txt", "2.txt"].map(|name| write(name, b"1 2 3\n4 5 6\n"));
        let layouts = vec![file(&joints, "q[2]"), file(&one, "xyz"), file(&two, "xyz:mm")];
        let settings_of_points = ColumnSettings { layouts, ..ColumnSettings::default() };
        let read_points = |settings: &ColumnSettings| {
            let paths = [&one, &joints, &two].map(|path| path.as_path());
            read_calibration_points(&paths, settings).unwrap()
        };
        let table = read_points(&settings_of_points).unwrap();
        assert_eq!(table.positions, [[2, 3, 4], [5, 6, 7]]);
        assert_eq!(table.numbers.rows[1], [3.0, 4.0, 4.0, 5.0, 6.0, 4e-3, 5e-3, 6e-3]);
        assert_eq!(read_points(&settings), None);
        let why = |one: &Path| read(one, &poses).unwrap_err().to_string();
        let few = why(&write("few.txt", b"1 2\n"));
        assert!(few.contains("p.csv: it has 2 rows, but the joints have 1"), "{few}");
        let lost = why(&write("lost.txt", b"1 2\n3\n"));
        assert!(
            lost.contains("1 of its rows, the first in line 2, do not hold 2 numbers"),
            "{lost}"
        );
        let neither = read(&joints, &joints).unwrap_err().to_string();
        assert!(neither.contains("its columns name no position"), "{neither}");
        assert_eq!(read(&poses, &poses).unwrap(), None);
    }

    #[test]
    fn numbered_positions_are_several_points() {
        let table = parse_table(b"q1,x1,y1,z1,x2,y2,z2,x4,y4,z4\n1,2,3,4,5,6,7,8,9,10\n").unwrap();
        assert_eq!(table.positions, [[1, 2, 3], [4, 5, 6]]);
    }

    #[test]
    fn joint_positions_need_no_names() {
        let spaced = "1,   0.2\n3,   4\n";
        for text in ["1,2e-1\n\n3,4\n", spaced, "# q\n1; 0,2\n3;4\n", "1  0.2\n3   4\n5 nan\n"] {
            let table = parse_numbers(text.as_bytes(), None).unwrap();
            assert_eq!(table.rows, [[1.0, 0.2], [3.0, 4.0]], "{text:?}");
            assert_eq!(table.joints(&names(&["a", "b"])), Some(vec![0, 1]));
            assert_eq!(table.joints(&names(&["a", "b", "c"])), None);
        }
        let table = parse_numbers(b"nan,1\n2,3\n", None).unwrap();
        assert_eq!((table.rows.len(), table.dropped.as_slice()), (1, [1].as_slice()));
        assert_eq!(
            parse_numbers(b"q1,q2\n1,2\n", None).unwrap().joints(&names(&["a", "b"])),
            Some(vec![0, 1])
        );
    }

    #[test]
    fn other_files_are_no_table_of_configurations() {
        for text in ["", "a,b\n1,2\n", "1,2,3\n", "timestamp,actual_q_0,x,y,z\n1,2,3,4,5\n", "\0\0"]
        {
            assert_eq!(parse_table(text.as_bytes()), None, "{text:?}");
        }
    }
}
