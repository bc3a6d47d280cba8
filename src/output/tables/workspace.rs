use std::collections::BTreeSet;

use polars::prelude::{Column, DataFrame, PolarsResult};

use crate::diagnosis::cell_centre_m;
use crate::report::ArmWorkspace;
use crate::robot::{Chain, JointKind};
use crate::time::Stamp;

use super::{pose_columns, split_components};

/// One row per cell of the base frame that a tip reached.
pub(super) fn reach_map_frame(arms: &[ArmWorkspace<'_>]) -> PolarsResult<DataFrame> {
    let rows: Vec<_> = arms
        .iter()
        .flat_map(|arm| arm.workspace.cells.iter().map(move |(cell, place)| (arm, cell, place)))
        .collect();
    let robots: Vec<&str> = rows.iter().map(|(arm, ..)| arm.robot).collect();
    let centres: Vec<[f64; 3]> = rows.iter().map(|(_, cell, _)| cell_centre_m(**cell)).collect();
    let count = |name: &str, of: &dyn Fn(usize) -> usize| {
        let counts: Vec<u64> = (0..rows.len()).map(|row| of(row) as u64).collect();
        Column::new(name.into(), counts)
    };
    let dwell_s: Vec<f64> = rows.iter().map(|(.., place)| place.dwell_s).collect();
    let mut columns = vec![Column::new("robot".into(), robots)];
    columns.extend(split_components(["x_m", "y_m", "z_m"].map(str::to_owned), &centres));
    columns.extend([
        count("samples", &|row| rows[row].2.samples),
        Column::new("dwell_s".into(), dwell_s),
        count("orientations", &|row| rows[row].2.orientations),
        count("poses", &|row| rows[row].2.poses.len()),
    ]);
    DataFrame::new(rows.len(), columns)
}

/// One row per reached pose, with joint positions; null for other robots.
pub(super) fn reached_poses_frame(
    arms: &[ArmWorkspace<'_>],
    origin: Stamp,
) -> PolarsResult<DataFrame> {
    let rows: Vec<_> = arms
        .iter()
        .flat_map(|arm| arm.workspace.poses.iter().map(move |pose| (arm, pose)))
        .collect();
    let robots: Vec<&str> = rows.iter().map(|(arm, _)| arm.robot).collect();
    let stamps: Vec<i64> = rows.iter().map(|(_, pose)| origin.shifted(pose.t_s).nanos()).collect();
    let t_s: Vec<f64> = rows.iter().map(|(_, pose)| pose.t_s).collect();
    let samples: Vec<u64> = rows.iter().map(|(_, pose)| pose.samples as u64).collect();
    let mut columns = vec![
        Column::new("robot".into(), robots),
        Column::new(super::STAMP_NS.into(), stamps),
        Column::new(super::T_S.into(), t_s),
    ];
    columns.extend(pose_columns("", rows.iter().map(|(_, pose)| &pose.base_from_tip)));
    columns.push(Column::new("samples".into(), samples));
    let mut known = BTreeSet::new();
    for name in arms.iter().flat_map(|arm| joint_columns(arm.chain)) {
        if !known.insert(name.clone()) {
            continue;
        }
        let positions = rows.iter().map(|(arm, pose)| {
            let joint = joint_columns(arm.chain).position(|other| other == name)?;
            pose.q.get(joint).copied()
        });
        columns.push(Column::new(name.as_str().into(), positions.collect::<Vec<Option<f64>>>()));
    }
    DataFrame::new(rows.len(), columns)
}

/// `{joint}_rad`, or `{joint}_m` for a prismatic joint.
pub(super) fn joint_columns(chain: &Chain) -> impl Iterator<Item = String> {
    chain.joint_names().iter().zip(chain.joint_kinds()).map(|(name, kind)| match kind {
        JointKind::Prismatic => format!("{name}_m"),
        _ => format!("{name}_rad"),
    })
}
