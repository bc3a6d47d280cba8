//! Columns of a table by position, as `--columns` names them.

use std::collections::HashSet;

use super::{Cell, ColumnGroup, ColumnMeaning, counted_names};
use crate::tables::Table;
use crate::tables::clock::CellTime;
use crate::tables::row_layout::{LayoutGroup, LayoutTime, Meaning, RowLayout};
use ground::geometry::AngleUnit;

/// A layout, applied to the columns of one table.
pub(crate) struct LayoutColumns {
    pub(in crate::tables) time: CellTime,
    groups: Vec<LayoutGroup>,
    /// Cell of each position in a row; `None` for text.
    cells: Vec<Option<Cell>>,
    meanings: Vec<Meaning>,
}

impl LayoutColumns {
    /// Converts lengths and angles whose convention is not declared to m and rad.
    ///
    /// # Errors
    /// If the table has another number of columns, or text where the layout has numbers.
    pub(in crate::tables) fn resolve(
        layout: &RowLayout,
        table: &mut Table,
    ) -> Result<Self, String> {
        let cells = table.row_cells();
        let meanings = layout.meanings();
        if meanings.len() != cells.len() {
            return Err(format!(
                "--columns names {} columns, but its rows have {}; the first row is {}",
                meanings.len(),
                cells.len(),
                first_row(table, &cells)
            ));
        }
        let is_free = |meaning: &Meaning| matches!(meaning, Meaning::Ignored | Meaning::Open);
        let text =
            cells.iter().zip(&meanings).position(|(cell, it)| cell.is_none() && !is_free(it));
        if let Some(at) = text {
            let (number, meaning) = (at + 1, &meanings[at]);
            return Err(format!(
                "--columns names column {number} `{meaning}`, but it holds text, not numbers"
            ));
        }
        // Only numbers are left in the groups and times.
        let cell = |at: usize| cells[at].unwrap_or(Cell { column: 0, part: 0 });
        let time = match layout.time() {
            LayoutTime::Column { index, unit_s } => CellTime::Column(cell(index), unit_s),
            LayoutTime::SecondsAndNanos(both) => CellTime::SecondsAndNanos(both.map(cell)),
            LayoutTime::Rate(rate_hz) => CellTime::Rate(rate_hz),
            LayoutTime::Open => CellTime::Open,
        };
        let groups = layout.groups();
        for group in &groups {
            for (at, factor) in conversions(group) {
                let Cell { column, part } = cell(at);
                let column = &mut table.columns[column];
                let width = column.width;
                column.values.iter_mut().skip(part).step_by(width).for_each(|it| *it *= factor);
            }
        }
        Ok(Self { time, groups, cells, meanings })
    }

    /// Joints and poses, and the ignored columns.
    pub(super) fn groups(&self, table: &Table) -> Vec<ColumnGroup> {
        let why = || "as given by --columns".to_owned();
        let all_of = |places: &[usize]| -> Vec<Cell> {
            places.iter().filter_map(|&at| self.cells[at]).collect()
        };
        let mut groups = Vec::new();
        for group in &self.groups {
            if !group.joints.is_empty() {
                let unit = group.joint_unit.or(group.velocity_unit.map(|_| AngleUnit::Radian));
                let count = group.joints.len();
                let lines = unit.map_or(Vec::new(), |unit| vec![[unit.in_rad(), 0.0]; count]);
                let meaning = ColumnMeaning::Joints {
                    names: counted_names("", count),
                    unnamed: true,
                    lines,
                    velocities: all_of(&group.velocities),
                };
                let cells = all_of(&group.joints);
                groups.push(ColumnGroup::new(group.topic("joints"), cells, meaning, why()));
            }
            if group.joints.is_empty() && !group.velocities.is_empty() {
                let meaning = ColumnMeaning::Velocities(group.velocity_unit);
                let cells = all_of(&group.velocities);
                groups.push(ColumnGroup::new(group.topic("joints"), cells, meaning, why()));
            }
            if group.has_pose() {
                let cells = all_of(&group.pose());
                let meaning = match cells.len() {
                    3 => ColumnMeaning::Position,
                    _ => ColumnMeaning::Pose,
                };
                groups.push(ColumnGroup::new(group.topic("pose"), cells, meaning, why()));
            }
        }
        groups.extend(self.ignored(table));
        groups
    }

    /// Neighbouring numbers of one column are one group.
    fn ignored(&self, table: &Table) -> Vec<ColumnGroup> {
        let ignored = self.cells.iter().zip(&self.meanings);
        let ignored = ignored.filter(|(_, meaning)| **meaning == Meaning::Ignored);
        let mut runs: Vec<Vec<Cell>> = Vec::new();
        for cell in ignored.filter_map(|(cell, _)| *cell) {
            let continues = |last: &Cell| last.column == cell.column && last.part + 1 == cell.part;
            match runs.last_mut() {
                Some(run) if run.last().is_some_and(continues) => run.push(cell),
                _ => runs.push(vec![cell]),
            }
        }
        let group = |cells: Vec<Cell>| {
            let (first, last) = (cells[0], cells[cells.len() - 1]);
            let column = &table.columns[first.column];
            let topic = match cells.len() {
                1 => table.cell_name(first),
                count if count == column.width => column.name.clone(),
                _ => format!("{}[{}:{}]", column.name, first.part, last.part + 1),
            };
            let why = "`_` in --columns".to_owned();
            ColumnGroup::new(topic, cells, ColumnMeaning::Unused, why)
        };
        runs.into_iter().map(group).collect()
    }
}

/// Positions of a row with their factors to m and rad; velocities to the unit of the joints. A declared
/// convention has its units declared with it.
fn conversions(group: &LayoutGroup) -> Vec<(usize, f64)> {
    let mut factors = Vec::new();
    if let Some(own) = group.velocity_unit.filter(|_| !group.joints.is_empty()) {
        let joints = group.joint_unit.unwrap_or_default();
        let factor = own.in_rad() / joints.in_rad();
        factors.extend(group.velocities.iter().map(|&at| (at, factor)));
    }
    if group.coding.is_some() {
        return factors;
    }
    let (length, angle) = (group.units.length, group.units.angle);
    if let Some(length) = length {
        // Translation of a matrix by rows or by columns; the other one of the two is zero.
        let translation: HashSet<usize> = match group.rotation.len() {
            12 => HashSet::from([3, 7, 11]),
            16 => HashSet::from([3, 7, 11, 12, 13, 14]),
            _ => HashSet::new(),
        };
        let inside = group.rotation.iter().enumerate().filter(|(at, _)| translation.contains(at));
        let all = group.position.iter().chain(inside.map(|(_, at)| at));
        factors.extend(all.map(|&at| (at, length.in_m())));
    }
    if let (Some(angle), 3) = (angle, group.rotation.len()) {
        factors.extend(group.rotation.iter().map(|&at| (at, angle.in_rad())));
    }
    factors
}

fn first_row(table: &Table, cells: &[Option<Cell>]) -> String {
    const MAX_SHOWN: usize = 40;
    let value = |cell: &Option<Cell>| match cell {
        Some(Cell { column, part }) => {
            table.columns[*column].values.get(*part).map_or_else(String::new, f64::to_string)
        }
        None => "text".to_owned(),
    };
    let shown: Vec<String> = cells.iter().take(MAX_SHOWN).map(value).collect();
    let more = if cells.len() > MAX_SHOWN { ",…" } else { "" };
    format!("{}{more}", shown.join(","))
}
