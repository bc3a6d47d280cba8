//! Columns selected in the configuration.

use super::{Cell, ColumnGroup, ColumnMeaning, counted_names};
use crate::tables::{ColumnSelector, ColumnSettings, Table};

pub(super) fn configured_groups(
    table: &Table,
    settings: &ColumnSettings,
) -> Result<Vec<ColumnGroup>, String> {
    let mut groups = groups_of_arm(table, settings)?;
    for (arm, settings) in &settings.arms {
        let own = groups_of_arm(table, settings)
            .map_err(|what| what.replacen("columns.", &format!("columns.arm.{arm}."), 1))?;
        let named =
            |group: ColumnGroup| ColumnGroup { topic: format!("{arm}/{}", group.topic), ..group };
        groups.extend(own.into_iter().map(named));
    }
    Ok(groups)
}

fn groups_of_arm(table: &Table, settings: &ColumnSettings) -> Result<Vec<ColumnGroup>, String> {
    let mut groups = Vec::new();
    let topics = [
        ("joints", &settings.joints),
        ("joint_commands", &settings.joint_commands),
        ("pose", &settings.pose),
        ("pose_commands", &settings.pose_commands),
    ];
    for (key, selectors) in topics {
        let mut all = Vec::new();
        for selector in selectors {
            all.extend(
                selected_cells(table, selector)
                    .map_err(|what| format!("`columns.{key}`: {what}"))?,
            );
        }
        if all.is_empty() {
            continue;
        }
        let meaning = match (key, all.len()) {
            ("joints" | "joint_commands", count) => ColumnMeaning::Joints {
                names: counted_names("", count),
                unnamed: true,
                lines: joint_conversions(settings, count)?,
                velocities: Vec::new(),
            },
            (_, 3) => ColumnMeaning::Position,
            (_, 6 | 7 | 12 | 16) => ColumnMeaning::Pose,
            (_, count) => {
                return Err(format!(
                    "`columns.{key}` selects {count} numbers; a pose has 3, 6, 7, 12 or 16"
                ));
            }
        };
        let why = format!("`columns.{key}` of the config");
        groups.push(ColumnGroup::new(key.to_owned(), all, meaning, why));
    }
    Ok(groups)
}

/// Factor and offset of each joint; empty if not declared.
fn joint_conversions(settings: &ColumnSettings, count: usize) -> Result<Vec<[f64; 2]>, String> {
    let (factors, offsets) = (&settings.joint_factors, &settings.joint_offsets);
    for (key, values) in [("joint_factors", factors), ("joint_offsets", offsets)] {
        if !values.is_empty() && values.len() != count {
            return Err(format!("`columns.{key}` has {} numbers for {count} joints", values.len()));
        }
    }
    if factors.is_empty() && offsets.is_empty() {
        return Ok(Vec::new());
    }
    let of = |values: &[f64], at: usize, default| values.get(at).copied().unwrap_or(default);
    Ok((0..count).map(|at| [of(factors, at, 1.0), of(offsets, at, 0.0)]).collect())
}

fn selected_cells(table: &Table, selector: &ColumnSelector) -> Result<Vec<Cell>, String> {
    let ColumnSelector { column: name, range } = selector;
    let column = table.column(name);
    let column = column.ok_or_else(|| format!("there is no column '{name}'"))?;
    let width = table.columns[column].width;
    let (first, end) = range.unwrap_or((0, width));
    if end > width {
        return Err(format!("'{name}' has {width} numbers per row; [{first}:{end}] exceeds them"));
    }
    Ok((first..end).map(|part| Cell { column, part }).collect())
}
