//! Calibration input from tables of configurations around a fixed point of the tool.

use std::path::Path;

use super::calibrate::{CalibrationInput, LogInputs, Measurement, trouble};
use super::tables::{dropped_rows, joint_track, named_chain, numbers_suffice, row_times};
use crate::diagnosis::FixedPoint;
use crate::geometry::{Pose, Rotation, pose};
use crate::log::read_number_table;
use crate::report::Trouble;
use crate::robot::{Chain, JointKind};
use crate::run::{PoseSourceKind, RunOptions};
use crate::stream::JointTrack;

/// Larger errors with the nominal model are not link deviations, rms m.
const MAX_NOMINAL_ERROR_M: f64 = 50e-3;
/// Larger joint positions are in degrees.
const MAX_RAD: f64 = 2.5 * std::f64::consts::PI;
const REMEDY: &str = "check that the point stayed in place, that the columns are the joints of --robot, and \
                      leave the file out otherwise";

/// Reads a table with one configuration per row.
pub(super) fn input(path: &Path, options: &RunOptions) -> Result<LogInputs, Trouble> {
    let Some(table) = read_number_table(path)? else {
        let what = "is not a table of joint positions";
        return Err(trouble(path, what, "give a CSV with one configuration per row"));
    };
    numbers_suffice(path, &table)?;
    let width = table.names.is_empty().then(|| table.width());
    let (robot, chain) = named_chain(path, options, width)?;
    let Some(joints) = table.joints(chain.joint_names()) else {
        let (names, dof) = (chain.joint_names().join(", "), chain.dof());
        let what = match width {
            Some(width) => format!("has {width} columns, but the arm has {dof} joints: {names}"),
            None => format!("has no columns for the joints {names}"),
        };
        return Err(trouble(path, what, "use one column per joint, and name the tip with --tip"));
    };
    let turns = chain.joint_kinds().iter().all(|kind| *kind != JointKind::Prismatic);
    let values =
        || table.rows.iter().flat_map(|row| joints.iter().map(|&column| row[column].abs()));
    let is_in_degrees = turns && values().fold(0.0, f64::max) > MAX_RAD;
    let unit = if is_in_degrees { 1f64.to_radians() } else { 1.0 };
    let track = joint_track(&table, &joints, unit);
    let Some(fit) = fit(&chain, &track) else {
        return Err(trouble(path, "no finite configuration", REMEDY));
    };
    if fit.rms_m() > MAX_NOMINAL_ERROR_M {
        return Err(trouble(path, error_text(&fit), REMEDY));
    }
    let rows = table.rows.len();
    let input = CalibrationInput {
        log: path.to_path_buf(),
        topic: "rows".to_owned(),
        source_kind: PoseSourceKind::External,
        measurement: Measurement::FixedPoint,
        encoding: is_in_degrees.then(|| "degrees".to_owned()),
        base: chain.base_name().to_owned(),
        tip: chain.tip_name().to_owned(),
        columns: (0..joints.len()).collect(),
        joints: track,
        t_s: row_times(rows),
        poses: vec![Pose::identity(); rows],
        is_rotation_excluded: true,
        latency_s: None,
        skew: 0.0,
        reference: pose((-fit.base_xyz).into(), Rotation::identity()),
        is_reference_free: true,
        tool: Pose::identity(),
        is_tool_free: true,
        zeros: Vec::new(),
    };
    let dropped = dropped_rows(&table).map(|what| format!("{}: {what}", path.display()));
    Ok((robot, vec![input], dropped.into_iter().collect()))
}

/// Fits the point to the rows of a [`joint_track`].
pub(super) fn fit(chain: &Chain, track: &JointTrack) -> Option<FixedPoint> {
    // Two samples per row.
    FixedPoint::fit(chain, (0..track.len()).step_by(2).map(|at| track.row(at)))
}

/// How far the rows are from one point.
pub(super) fn error_text(fit: &FixedPoint) -> String {
    let rms_mm = 1e3 * fit.rms_m();
    match fit.jump() {
        Some((row, by_m)) => format!(
            "the point moves by {:.1} mm after row {row}: its rows are {rms_mm:.2} mm rms from one point",
            1e3 * by_m
        ),
        None => format!("its rows are {rms_mm:.2} mm rms from one point"),
    }
}
