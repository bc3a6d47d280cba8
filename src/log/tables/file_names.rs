//! Tables of bare numbers whose files name the content, such as `log_q_actual.csv` and `jointPosition.csv`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use super::clock::TWO_TURNS_RAD;
use super::{Column, Table, clock, names};

/// Column of a table without column names.
pub(super) const UNNAMED_COLUMN: &str = "array";

/// Names of the tables without column names: the names of their files. Empty if no file names joints or poses.
/// Files that differ only in numbers have the same name: they are episodes.
pub(super) fn table_names(paths: &[&Path]) -> HashMap<PathBuf, String> {
    let named = |path: &Path| names_content(&words_of(path));
    let is_set = paths.len() > 1 && paths.iter().any(|path| named(path));
    let paths = || paths.iter().filter(|path| is_set || named(path));
    let mut counts: BTreeMap<Vec<String>, usize> = BTreeMap::new();
    paths().for_each(|path| *counts.entry(without_numbers(path)).or_default() += 1);
    let name = |path: &&Path| {
        let own = without_numbers(path);
        let name = if counts[&own] > 1 { own.join("_") } else { stem(path) };
        (path.to_path_buf(), name)
    };
    paths().map(name).collect()
}

/// Whether the files may be one run: no two name the same content. `None` if none names measured joints or poses.
pub(crate) fn are_one_run(paths: &[&Path]) -> Option<bool> {
    let keys: Vec<Vec<String>> = paths.iter().map(|path| without_numbers(path)).collect();
    let sides_of = |is_it: fn(&[String]) -> bool| -> Vec<String> {
        let is_command = |key: &[String]| names::contains_any(key, names::COMMAND_WORDS);
        let own = keys.iter().filter(|key| is_it(key) && !is_command(key));
        own.map(|key| names::arm_prefix(key)).collect()
    };
    let (joints, poses) = (sides_of(names::is_joint_positions), sides_of(names_content));
    // Poses of several bodies may accompany joints.
    let measured = if joints.is_empty() { &poses } else { &joints };
    let distinct = |of: &[String]| of.iter().collect::<BTreeSet<_>>().len() == of.len();
    let is_one = distinct(measured) && keys.iter().collect::<BTreeSet<_>>().len() == keys.len();
    (!measured.is_empty()).then_some(is_one)
}

fn stem(path: &Path) -> String {
    let is_packed = path.extension().is_some_and(|extension| extension == "zst");
    let path = if is_packed { path.with_extension("") } else { path.to_owned() };
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn words_of(path: &Path) -> Vec<String> {
    names::split_words(&stem(path))
}

fn without_numbers(path: &Path) -> Vec<String> {
    let mut words = words_of(path);
    words.retain(|word| !word.bytes().all(|byte| byte.is_ascii_digit()));
    words
}

/// Words such as `motor` or `hand` occur in the names of any file.
fn names_content(words: &[String]) -> bool {
    let has = |known: &[&str]| names::contains_any(words, known);
    let is_general = has(&["axis", "axe", "motor", "motors", "servo"]);
    let is_of_tool = has(&["pose", "tcp", "ee", "eef", "effector", "cartesian", "flange"])
        || (has(&["tool"]) && has(&["vector", "position", "pos"]));
    (names::is_joint_positions(words) && !is_general) || (names::is_pose(words) && is_of_tool)
}

impl Table {
    /// Puts the stream's name before that of the only array, if the file names joints or poses and the array does not:
    /// `positions` in `left/qpos.parquet`.
    pub(super) fn name_only_array(&mut self, path: &Path) {
        const GENERAL_NAMES: [&str; 6] =
            ["position", "positions", "value", "values", "data", "state"];
        let mut arrays = self.columns.iter_mut().filter(|column| column.width > 1);
        let (Some(own), None) = (arrays.next(), arrays.next()) else { return };
        let is_general = GENERAL_NAMES.contains(&own.name.to_lowercase().as_str());
        if is_general && names_content(&words_of(path)) {
            own.name = format!("{}/{}", self.stream_name, own.name);
        }
    }

    /// Names the only column, and separates stamps before or after the other numbers unless another file has the times.
    pub(super) fn name_columns(&mut self, name: &str) {
        /// Positions, six joints or poses without times. Their first number may increase in each row.
        const COMPLETE_WIDTHS: [usize; 4] = [3, 6, 12, 16];
        let [column] = self.columns.as_mut_slice() else { return };
        if column.name != UNNAMED_COLUMN || !column.parts.is_empty() {
            return;
        }
        let (width, kind) = (column.width, column.kind.clone());
        let numbers_at = |part: usize| -> Vec<f64> { column.numbers(part).collect() };
        let is_clock = |part: &usize| {
            let own = numbers_at(*part);
            let may_be_short = *part == 0 && !COMPLETE_WIDTHS.contains(&width);
            clock::increases_like_times(&own, &kind) && (clock::exceed_joints(&own) || may_be_short)
        };
        let may_have_times = width > 1 && self.times.is_none();
        let ends = [0, width.saturating_sub(1)];
        let time = ends.into_iter().find(|part| may_have_times && is_clock(part));
        let stamps = time.map(|part| (part, numbers_at(part)));
        let others = (0..width).filter(|part| Some(*part) != time);
        let most = |part: usize| column.numbers(part).map(f64::abs).fold(0.0, f64::max);
        if names::is_joint_positions(&names::split_words(name)) && have_no_unit(others.map(most)) {
            return;
        }
        name.clone_into(&mut column.name);
        let Some((part, stamps)) = stamps else { return };
        let rest = column.values.iter().enumerate().filter(|(at, _)| at % width != part);
        let rest = rest.map(|(_, number)| *number).collect();
        let own = Column { width: width - 1, values: rest, ..std::mem::take(column) };
        let times =
            Column { name: "time".to_owned(), kind, width: 1, values: stamps, ..Column::default() };
        self.columns = vec![times, own];
        if let Some(lost) = self.lost_rows.remove(&0) {
            self.lost_rows = BTreeMap::from([(0, lost.clone()), (1, lost)]);
        }
    }
}

/// Whether joints that reach so far are neither in rad nor in degrees: some are beyond two turns in degrees, although all
/// others are within two turns in rad.
fn have_no_unit(most: impl Iterator<Item = f64>) -> bool {
    let (small, large): (Vec<f64>, Vec<f64>) = most.partition(|most| *most <= TWO_TURNS_RAD);
    let is_beyond = |most: &f64| most.to_radians() > TWO_TURNS_RAD;
    !small.is_empty() && !large.is_empty() && large.iter().all(is_beyond)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table_name(paths: &[&str], of: &str) -> Option<String> {
        let paths: Vec<&Path> = paths.iter().map(Path::new).collect();
        table_names(&paths).get(Path::new(of)).cloned()
    }

    #[test]
    fn files_name_tables_if_one_names_joints_or_poses() {
        for (paths, expected) in [
            (vec!["a/jointPosition.csv"], Some("jointPosition")),
            (vec!["joints_3.npy"], Some("joints_3")),
            (vec!["joints_3.npy", "joints_4.npy"], Some("joints")),
            (vec!["run.csv", "q.csv"], Some("run")),
            (vec!["ee_pose.csv.zst"], Some("ee_pose")),
            (vec!["run.csv"], None),
            (vec!["hand_guiding.csv"], None),
            (vec!["motor_test.csv"], None),
            (vec!["run.csv", "forces.csv"], None),
        ] {
            assert_eq!(table_name(&paths, paths[0]).as_deref(), expected, "{paths:?}");
        }
    }

    #[test]
    fn numbers_beyond_joints_are_not_named_joints() {
        let name = |row: [f64; 4]| {
            let values = [row, row.map(|own| 0.5 * own), row].concat();
            let columns = vec![Column::untyped(UNNAMED_COLUMN, 4, values)];
            let mut table = Table { rows: 3, columns, ..Table::default() };
            table.name_columns("joints");
            table.columns[0].name.clone()
        };
        for (row, expected) in [
            ([3111.3, 0.16, 0.001, -0.05], UNNAMED_COLUMN),
            ([0.2, 0.16, 0.001, -0.05], "joints"),
            ([90.0, 0.16, 45.0, -0.05], "joints"),
            ([3111.0, 2048.0, 1900.0, 2100.0], "joints"),
        ] {
            assert_eq!(name(row), expected, "{row:?}");
        }
    }

    #[test]
    fn one_run_has_measured_joints_once() {
        for (names, expected) in [
            (vec!["log_q_actual.csv", "log_q_target.csv", "log_tool_vector.csv"], Some(true)),
            (vec!["left_joints.csv", "right_joints.csv"], Some(true)),
            (vec!["dataQ.txt", "dataQref.txt", "dataDQref.txt"], Some(true)),
            (vec!["joints_1.csv", "joints_2.csv"], Some(false)),
            (vec!["pick_joints.csv", "place_joints.csv"], Some(false)),
            (vec!["position.csv", "tcp_pose.csv"], Some(true)),
            (vec!["tcp_pose_pick.csv", "tcp_pose_place.csv"], Some(false)),
            (vec!["forces.csv", "currents.csv"], None),
        ] {
            let paths: Vec<&Path> = names.iter().map(Path::new).collect();
            assert_eq!(are_one_run(&paths), expected, "{names:?}");
        }
    }
}
