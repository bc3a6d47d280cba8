//! Calibration from configurations around a fixed point of the tool: input from tables and logs, distances of points,
//! and files in which the point moved.

use std::path::Path;

use super::Options;
use super::calibration_input::{CalibrationInput, LogInputs, Measurement, trouble};
use super::tables::{MIN_ROWS, dropped_rows, joint_track, named_chain, numbers_suffice, row_times};
use crate::checks::{is_point_moved, max_row_error_m};
use crate::diagnosis::{ArmCalibration, FixedPoint, PointDistance, StreamCalibration, value_range};
use crate::geometry::{Pose, Rotation, Vec3, mean_vector, pose};
use crate::log::{self, NumberTable, Topic, read_number_table};
use crate::report::Trouble;
use crate::robot::{Chain, JointKind, Robot};
use crate::run::{PoseSourceKind, Run, RunOptions};
use crate::stream::{Columns, JointTrack};

/// Larger errors with the nominal model are not link deviations, rms m.
const MAX_NOMINAL_ERROR_M: f64 = 50e-3;
/// Larger joint positions are in degrees.
const MAX_RAD: f64 = 2.5 * std::f64::consts::PI;
/// Standard deviation of a given distance of two points, m: of a printed or machined tool.
const DISTANCE_STD_M: f64 = 0.1e-3;

/// Joints that move less within this time, rad or m, rest. Rests in configurations that differ less are one.
const REST_WINDOW_S: f64 = 0.5;
const MAX_REST_RANGE: f64 = 2e-3;
const MIN_REST_DIFFERENCE: f64 = 10e-3;

const JOINTS_REMEDY: &str = "give a list with the joint positions of one configuration in each row";
const REMEDY: &str = "check that the point stayed in place, that the columns are the joints of --robot, and \
                      leave the file out otherwise";

/// Configurations in which the point stays at one place.
struct Configurations {
    robot: Robot,
    chain: Chain,
    /// A [`joint_track`].
    joints: JointTrack,
    is_in_degrees: bool,
    dropped: Option<String>,
}

/// Reads a table with one configuration per row, or a log with joint states.
pub(super) fn input(path: &Path, options: &Options) -> Result<LogInputs, Trouble> {
    let found = match read_number_table(path)? {
        Some(table) => configurations_in_table(path, &table, &options.run)?,
        None => configurations_in_log(path, options)?,
    };
    let Configurations { robot, chain, joints, is_in_degrees, dropped } = found;
    let Some(fit) = fit(&chain, &joints) else {
        return Err(trouble(path, "no finite configuration", REMEDY));
    };
    if fit.rms_m() > MAX_NOMINAL_ERROR_M {
        return Err(trouble(path, error_text(&fit), REMEDY));
    }
    let rows = fit.errors.len();
    let input = CalibrationInput {
        log: path.to_path_buf(),
        topic: "rows".to_owned(),
        source_kind: PoseSourceKind::External,
        measurement: Measurement::FixedPoint,
        encoding: is_in_degrees.then(|| "degrees".to_owned()),
        base: chain.base_name().to_owned(),
        tip: chain.tip_name().to_owned(),
        columns: (0..chain.dof()).collect(),
        joints,
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
    let dropped = dropped.map(|what| format!("{}: {what}", path.display()));
    Ok((robot, vec![input], dropped.into_iter().collect()))
}

fn configurations_in_table(
    path: &Path,
    table: &NumberTable,
    options: &RunOptions,
) -> Result<Configurations, Trouble> {
    numbers_suffice(path, table)?;
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
    let joints = joint_track(table, &joints, unit);
    let dropped = dropped_rows(table);
    Ok(Configurations { robot, chain, joints, is_in_degrees, dropped })
}

/// The rows of a table without stamps, or the rests of the joints.
fn configurations_in_log(path: &Path, options: &Options) -> Result<Configurations, Trouble> {
    const ROWS_HZ: f64 = 1.0;
    let paths = [path.to_path_buf()];
    let mut has_times = true;
    let log = log::open(&paths, &options.read).or_else(|error| {
        // A rate replaces the stamps, so it is given only to tables that have none.
        has_times = false;
        let mut read = options.read.clone();
        read.columns.rate_hz.get_or_insert(ROWS_HZ);
        log::open(&paths, &read).map_err(|_| error)
    })?;
    if !has_times {
        let tables: Vec<NumberTable> = log.topics.iter().filter_map(joint_table).collect();
        let mut results =
            tables.iter().map(|table| configurations_in_table(path, table, &options.run));
        let first = results.next();
        let usable = results.find(Result::is_ok);
        return match (first, usable) {
            (Some(Err(_)), Some(found)) => found,
            (Some(first), _) => first,
            (None, _) => Err(trouble(path, "has no joint positions", JOINTS_REMEDY)),
        };
    }
    let run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()))?;
    if let Some(error) = &run.no_arm {
        return Err(error.into());
    }
    let [arm] = run.arms.as_slice() else {
        let what = format!("has joint states of {} arms", run.arms.len());
        return Err(trouble(path, what, "write the joint states of one arm into the log"));
    };
    let rows = rests(&arm.joints, &arm.columns);
    let count = rows.len();
    if count < MIN_ROWS {
        let what = format!(
            "the joints rest in only {count} configurations for {REST_WINDOW_S} s and more, fewer than {MIN_ROWS}"
        );
        return Err(trouble(path, what, "let the arm rest for 1 s in each configuration"));
    }
    let table = NumberTable { rows, ..NumberTable::default() };
    let columns: Vec<usize> = (0..arm.chain.dof()).collect();
    Ok(Configurations {
        robot: arm.robot.clone(),
        chain: arm.chain.clone(),
        joints: joint_track(&table, &columns, 1.0),
        is_in_degrees: false,
        dropped: None,
    })
}

/// The joint positions, or unnamed numbers, of a topic.
fn joint_table(topic: &Topic) -> Option<NumberTable> {
    let (names, rows): (Vec<String>, Vec<Vec<f64>>) = match topic.columns.as_ref()? {
        Columns::Joints(joints) => {
            let row = |row| joints.joints.iter().map(|joint| joint.position[row]).collect();
            let names = joints.joints.iter().map(|joint| joint.name.clone()).collect();
            (names, (0..joints.times.len()).map(row).collect())
        }
        Columns::Array(array) => {
            let rows = array.values.chunks_exact(array.width.max(1));
            (Vec::new(), rows.map(<[f64]>::to_vec).collect())
        }
        _ => return None,
    };
    let is_finite = |row: &Vec<f64>| row.iter().all(|value| value.is_finite());
    let dropped = (1..).zip(&rows).filter(|(_, row)| !is_finite(row)).map(|(at, _)| at).collect();
    let rows = rows.into_iter().filter(is_finite).collect();
    Some(NumberTable { names, rows, dropped, pose_name: None })
}

/// Mean configurations at rest, each different from the one before.
fn rests(joints: &JointTrack, columns: &[usize]) -> Vec<Vec<f64>> {
    let mut rests: Vec<(f64, Vec<f64>)> = Vec::new();
    let mut start = 0;
    while start < joints.len() {
        let end = joints.t_s.partition_point(|t_s| *t_s < joints.t_s[start] + REST_WINDOW_S);
        let count = (end - start) as f64;
        let values = |column: usize| (start..end).map(move |row| joints.row(row)[column]);
        let is_still = |&column: &usize| value_range(values(column)) < MAX_REST_RANGE;
        let lasts = joints.t_s[end - 1] - joints.t_s[start] > 0.5 * REST_WINDOW_S;
        if lasts && columns.iter().all(is_still) {
            let mean: Vec<f64> =
                columns.iter().map(|&column| values(column).sum::<f64>() / count).collect();
            let is_same = |last: &[f64]| {
                last.iter().zip(&mean).all(|(a, b)| (a - b).abs() < MIN_REST_DIFFERENCE)
            };
            match rests.last_mut() {
                Some((weight, last)) if is_same(last) => {
                    *weight += count;
                    let share = count / *weight;
                    last.iter_mut().zip(&mean).for_each(|(a, b)| *a += share * (b - *a));
                }
                _ => rests.push((count, mean)),
            }
        }
        start = end;
    }
    rests.into_iter().map(|(_, mean)| mean).collect()
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
    let base_xyz = mean_vector(&points);
    let errors = points.iter().map(|point| point - base_xyz).collect();
    FixedPoint { base_xyz, errors }
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
    let jumps = || calibrated_errors(stream, calibration).is_some_and(|fit| fit.jump().is_some());
    stream.measurement == Measurement::FixedPoint && is_point_moved(found.after.m, typical_m, jumps)
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
    let limit_m = max_row_error_m(median(errors_m.to_vec()));
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
