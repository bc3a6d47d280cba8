//! Columns of trajectory formats, whose names declare their meaning, order and units.

use std::collections::BTreeMap;

use super::{Cell, ColumnGroup, ColumnMeaning, Table, clock, describe_origin};
use crate::tables::trajectory::TUM_COLUMNS;

/// ASL dataset format of EuRoC and other recordings of aerial vehicles.
const EUROC_POSE: [&str; 7] =
    ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_x", "q_RS_y", "q_RS_z", "q_RS_w"];

/// The pose, and the other columns of its format. Empty for other tables.
pub(super) fn trajectory_groups(table: &Table) -> Vec<ColumnGroup> {
    let cells_of = |names: &[&str]| -> Option<Vec<Cell>> {
        let cell = |name: &&str| Some(Cell { column: table.column(name)?, part: 0 });
        let cells: Vec<Cell> = names.iter().map(cell).collect::<Option<_>>()?;
        cells.iter().all(|cell| table.columns[cell.column].width == 1).then_some(cells)
    };
    let others = table.columns.iter().filter(|column| !clock::is_time(&column.name));
    let is_alone = others.count() == TUM_COLUMNS.len() - 1;
    let tum = || cells_of(&TUM_COLUMNS[1..]).filter(|_| is_alone);
    let Some(cells) = cells_of(&EUROC_POSE).or_else(tum) else { return Vec::new() };
    let mut others: BTreeMap<&str, Vec<Cell>> = BTreeMap::new();
    for (column, own) in table.columns.iter().enumerate() {
        let cell = Cell { column, part: 0 };
        if !cells.contains(&cell) && !clock::is_time(&own.name) && own.width == 1 {
            others.entry(vector_name(&own.name)).or_default().push(cell);
        }
    }
    let group = |topic: &str, cells: Vec<Cell>, meaning: ColumnMeaning, why: &str| {
        let why = describe_origin(table, &cells, why);
        ColumnGroup::new(topic.to_owned(), cells, meaning, why)
    };
    let pose = group("pose", cells, ColumnMeaning::QuaternionPose, "position and quaternion");
    let unused = others
        .into_iter()
        .map(|(name, cells)| group(name, cells, ColumnMeaning::Unused, "not part of the pose"));
    std::iter::once(pose).chain(unused).collect()
}

/// `v_RS_R` of `v_RS_R_x [m s^-1]`.
fn vector_name(name: &str) -> &str {
    let bare = name.split_once(" [").map_or(name, |(bare, _)| bare);
    let stem = ["_x", "_y", "_z"].iter().find_map(|axis| bare.strip_suffix(axis));
    stem.unwrap_or(bare)
}
