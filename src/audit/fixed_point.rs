//! Calibration from tables of configurations around a fixed point of the tool: input, distances of points, and files
//! in which the point moved.

use std::path::Path;

use super::calibrate::{CalibrationInput, LogInputs, Measurement, trouble};
use super::tables::{dropped_rows, joint_track, named_chain, numbers_suffice, row_times};
use crate::diagnosis::{ArmCalibration, FixedPoint, PointDistance, StreamCalibration};
use crate::geometry::{Pose, Rotation, Vec3, pose};
use crate::log::read_number_table;
use crate::report::Trouble;
use crate::robot::{Chain, JointKind};
use crate::run::{PoseSourceKind, RunOptions};
use crate::stream::JointTrack;

/// Larger errors with the nominal model are not link deviations, rms m.
const MAX_NOMINAL_ERROR_M: f64 = 50e-3;
/// Larger joint positions are in degrees.
const MAX_RAD: f64 = 2.5 * std::f64::consts::PI;
/// Standard deviation of a given distance of two points, m: of a printed or machined tool.
const DISTANCE_STD_M: f64 = 0.1e-3;
/// Rms distances of calibrated rows from their fixed point, m: rejected, and rejected if one jump explains it. Both
/// are at least this many times the median of the files.
const MAX_POINT_ERROR_M: f64 = 3e-3;
const MAX_JUMP_ERROR_M: f64 = 0.5e-3;
const MAX_POINT_ERROR_RATIO: f64 = 4.0;
/// Rows further from the point than this, and than this many times the median of their file, are reported.
const MIN_ROW_ERROR_M: f64 = 1e-3;
const MAX_ROW_ERROR_RATIO: f64 = 6.0;

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
fn fit(chain: &Chain, track: &JointTrack) -> Option<FixedPoint> {
    // Two samples per row.
    FixedPoint::fit(chain, (0..track.len()).step_by(2).map(|at| track.row(at)))
}

/// Errors of the rows for a known point of the tip.
fn errors_at(chain: &Chain, track: &JointTrack, tip_xyz: Vec3) -> FixedPoint {
    let point = |at: usize| {
        let tip = chain.forward(track.row(at));
        tip.translation.vector + tip.rotation * tip_xyz
    };
    let points: Vec<Vec3> = (0..track.len()).step_by(2).map(point).collect();
    let base_xyz = points.iter().sum::<Vec3>() / points.len().max(1) as f64;
    let errors = points.iter().map(|point| point - base_xyz).collect();
    FixedPoint { base_xyz, tip_xyz, errors }
}

/// How far the rows are from one point.
fn error_text(fit: &FixedPoint) -> String {
    let rms_mm = 1e3 * fit.rms_m();
    match fit.jump() {
        Some((row, by_m)) => format!(
            "the point moves by {:.1} mm after row {row}: its rows are {rms_mm:.2} mm rms from one point",
            1e3 * by_m
        ),
        None => format!("its rows are {rms_mm:.2} mm rms from one point"),
    }
}

/// Whether the rows of a file do not share a fixed point. Files usually leave `typical_m` rms.
pub(super) fn has_moved(
    stream: &CalibrationInput,
    found: &StreamCalibration,
    typical_m: f64,
    calibration: &ArmCalibration,
) -> bool {
    let (rms_m, least_m) = (found.after.m, MAX_POINT_ERROR_RATIO * typical_m);
    let is_far = typical_m > MAX_POINT_ERROR_M || rms_m > least_m.max(MAX_POINT_ERROR_M);
    let jumps = || calibrated_errors(stream, calibration).is_some_and(|fit| fit.jump().is_some());
    stream.measurement == Measurement::FixedPoint
        && (is_far || (rms_m > least_m.max(MAX_JUMP_ERROR_M) && jumps()))
}

/// How far the rows of a file are from one point with the calibrated links.
pub(super) fn moved_text(
    stream: &CalibrationInput,
    calibration: &ArmCalibration,
) -> Option<String> {
    let fit = calibrated_errors(stream, calibration)?;
    Some(format!("{}, also with the calibrated links", error_text(&fit)))
}

fn calibrated_errors(
    stream: &CalibrationInput,
    calibration: &ArmCalibration,
) -> Option<FixedPoint> {
    let robot = &calibration.robot;
    let chain = robot.chain(robot.link(&stream.base)?, robot.link(&stream.tip)?).ok()?;
    // All files have one tool.
    let tool = calibration.streams.first()?.tool?;
    Some(errors_at(&chain, &stream.joints, tool.translation.vector))
}

/// Rows far from the point of a file.
pub(super) fn outlier_rows(errors_m: &[f64]) -> Option<String> {
    const MAX_LISTED: usize = 5;
    let limit_m = (MAX_ROW_ERROR_RATIO * median(errors_m.to_vec())).max(MIN_ROW_ERROR_M);
    let rows = errors_m.iter().enumerate().filter(|(_, error)| **error > limit_m);
    let rows: Vec<(usize, f64)> = rows.map(|(row, error)| (row + 1, *error)).collect();
    let largest_m = rows.iter().map(|row| row.1).fold(0.0, f64::max);
    let listed: Vec<String> =
        rows.iter().take(MAX_LISTED).map(|(row, _)| row.to_string()).collect();
    let more = if rows.len() > MAX_LISTED { " …" } else { "" };
    (!rows.is_empty()).then(|| {
        format!(
            "{} of {} rows have little weight, being up to {:.1} mm from the point of the others: row {}{more}",
            rows.len(),
            errors_m.len(),
            1e3 * largest_m,
            listed.join(", ")
        )
    })
}

/// Lower median.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied().unwrap_or(0.0)
}

pub(super) fn typical_residual_m(calibration: &ArmCalibration) -> f64 {
    median(calibration.streams.iter().map(|one| one.after.m).collect())
}

fn folder(stream: &CalibrationInput) -> &Path {
    stream.log.parent().unwrap_or(Path::new(""))
}

/// Pairs of streams in folders with two.
pub(super) fn distances(
    streams: &[CalibrationInput],
    distance_m: Option<f64>,
) -> Vec<PointDistance> {
    let Some(distance_m) = distance_m else { return Vec::new() };
    let mut found = Vec::new();
    for (at, stream) in streams.iter().enumerate() {
        let mut same =
            streams.iter().enumerate().filter(|(_, other)| folder(other) == folder(stream));
        if let (Some((first, _)), Some((second, _)), None) = (same.next(), same.next(), same.next())
            && first == at
        {
            let streams = [first, second];
            found.push(PointDistance { streams, distance_m, std_error_m: DISTANCE_STD_M });
        }
    }
    found
}

/// Groups that are held out together: folders if there are several, otherwise files.
pub(super) fn held_out_group(streams: &[CalibrationInput], s: usize) -> Option<usize> {
    let first_as = |is_same: &dyn Fn(&CalibrationInput) -> bool| streams.iter().position(is_same);
    match streams[s].measurement {
        Measurement::Pose | Measurement::Point => None,
        Measurement::FixedPoint if streams.iter().any(|one| folder(one) != folder(&streams[s])) => {
            first_as(&|one| folder(one) == folder(&streams[s]))
        }
        Measurement::FixedPoint => Some(s),
    }
}
