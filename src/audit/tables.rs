//! Calibration input from tables of configurations.

use std::path::Path;

use super::Options;
use super::calibration_input::{CalibrationInput, LogInputs, Measurement, trouble};
use super::competing_arm::CalibrationPositions;
use super::missing_rate::columns_of_configurations;
use crate::diagnosis::{PoseStream, diagnose_arm};
use crate::geometry::{Vec3, rotation_from_xyzw};
use crate::log::{
    CalibrationTable, LogError, NumberTable, RotationColumns, not_configurations,
    read_calibration_points, read_calibration_table, read_calibration_tables,
};
use crate::report::Trouble;
use crate::robot::{Chain, LinkId, Robot};
use crate::run::{PoseSourceKind, RunOptions, source_of_column};
use crate::stream::{JointTrack, Orientations, PoseTrack};

/// Tables have no times: rows are 1 s apart, with the arm at rest for half of it.
const ROW_INTERVAL_S: f64 = 1.0;
const REST_S: f64 = 0.5;
pub(super) const MIN_ROWS: usize = 6;

/// `None` if the file is not a table.
pub(super) fn read_table(
    path: &Path,
    options: &Options,
) -> Result<Option<ConfigurationTable>, Trouble> {
    let table = read_calibration_table(path, &options.read.columns);
    configuration_table(table, &[path], options)
}

/// Joints and poses of the same configurations in two tables. `None` if the files are something else.
pub(super) fn read_tables(
    paths: [&Path; 2],
    options: &Options,
) -> Result<Option<ConfigurationTable>, Trouble> {
    let table = read_calibration_tables(paths, &options.read.columns);
    configuration_table(table, &paths, options)
}

/// Joints and several points of the same configurations in tables whose columns are stated. `None` if they are something else.
pub(super) fn read_points(
    paths: &[&Path],
    options: &Options,
) -> Result<Option<ConfigurationTable>, Trouble> {
    let table = read_calibration_points(paths, &options.read.columns);
    configuration_table(table, paths, options)
}

fn configuration_table(
    table: Result<Option<CalibrationTable>, LogError>,
    paths: &[&Path],
    options: &Options,
) -> Result<Option<ConfigurationTable>, Trouble> {
    let table = table.map_err(|error| read_trouble(error, paths, options))?;
    Ok(table.map(ConfigurationTable))
}

/// An error that asks for the columns proposes them. Tables without times are configurations.
pub(super) fn read_trouble(error: LogError, paths: &[&Path], options: &Options) -> Trouble {
    let error = match error {
        LogError::NoTimes { path, .. } => not_configurations(&path),
        error => error,
    };
    let asks_for_columns = matches!(error, LogError::ConfigurationColumns { .. });
    let logs = paths.iter().map(|path| path.to_path_buf()).collect();
    let proposal = asks_for_columns
        .then(|| columns_of_configurations(&Options { logs, ..options.clone() }))
        .flatten();
    let trouble = Trouble::from(error);
    Trouble { remedy: proposal.unwrap_or_else(|| trouble.remedy.clone()), ..trouble }
}

pub(super) struct ConfigurationTable(CalibrationTable);

impl ConfigurationTable {
    /// Resolves their encoding against the arm in `options`.
    pub fn input(&self, path: &Path, options: &RunOptions) -> Result<LogInputs, Trouble> {
        let Self(table) = self;
        let (robot, chain) = named_chain(path, options, None)?;
        let numbers = &table.numbers;
        let Some(joints) = numbers.joints(chain.joint_names()) else {
            let what =
                format!("it has no columns for the joints {}", chain.joint_names().join(", "));
            return Err(trouble(
                path,
                what,
                "name the columns like the model's joints or q1, q2 and so on, or state them with --columns",
            ));
        };
        numbers_suffice(path, numbers)?;
        let track = joint_track(numbers, &joints, 1.0);
        let poses: Vec<PoseTrack> = table
            .positions
            .iter()
            .enumerate()
            .map(|(point, position)| {
                let rotation = if point == 0 { &table.rotation } else { &RotationColumns::None };
                pose_track(&numbers.rows, *position, rotation)
            })
            .collect();
        let columns: Vec<usize> = (0..joints.len()).collect();
        let stream = |track| PoseStream {
            reference_known: false,
            stamps_copied: true,
            ..PoseStream::new(track, &chain, &columns)
        };
        let streams: Vec<PoseStream> = poses.iter().map(stream).collect();
        let found = diagnose_arm(&track, &streams, ROW_INTERVAL_S);
        let mut unzeroed = found.joints.clone();
        unzeroed.offsets.iter_mut().for_each(|offset| offset.is_chosen = false);
        let slides: Vec<bool> = chain
            .joint_kinds()
            .iter()
            .map(|kind| *kind == crate::robot::JointKind::Prismatic)
            .collect();
        let joints = unzeroed.corrected_joints(&track, &slides);
        let source_kind = match table.pose_name().map(source_of_column) {
            Some(PoseSourceKind::Controller) => PoseSourceKind::Controller,
            _ => PoseSourceKind::External,
        };
        let mut inputs: Vec<CalibrationInput> = Vec::with_capacity(poses.len());
        for (point, diagnosis) in found.streams.iter().enumerate() {
            let why_not = match diagnosis.residual.is_err() {
                true => Some("its poses do not follow the arm"),
                false => (diagnosis.is_far_from_fk() || diagnosis.is_unrelated_to_fk())
                    .then_some("its positions do not match FK"),
            };
            if let Some(what) = why_not {
                let positions = CalibrationPositions {
                    joints: &joints,
                    columns: &columns,
                    track: &poses[point],
                    max_lag_s: 0.0,
                };
                return Err(match positions.competing_arm(&robot.name, &chain) {
                    Some(other) => {
                        let what = format!("{what}; {}", other.describe(&robot.name));
                        trouble(path, what, &other.remedy())
                    }
                    None => trouble(
                        path,
                        what,
                        "check that --robot is the arm's model, and state units in --columns, such as x:mm",
                    ),
                });
            }
            let (topic, measurement) = match poses.len() {
                1 => ("rows".to_owned(), Measurement::Pose),
                _ => (format!("point {}", point + 1), Measurement::Point),
            };
            let joints = (joints.clone(), columns.clone());
            let mut input = CalibrationInput::new(path, topic, &chain, joints, diagnosis);
            (input.measurement, input.source_kind) = (measurement, source_kind);
            // All points are measured in one frame.
            input.reference = inputs.first().map_or(input.reference, |first| first.reference);
            inputs.push(input);
        }
        Ok((robot, inputs, dropped_rows(numbers).into_iter().collect()))
    }
}

/// The arm that the options name, and its chain. If the default tip has another number of joints than
/// `joint_count`, a leaf link with that number is the tip.
pub(super) fn named_chain(
    path: &Path,
    options: &RunOptions,
    joint_count: Option<usize>,
) -> Result<(Robot, Chain), Trouble> {
    let call = |what: String, remedy: &str| Trouble::call(path.display(), what, remedy);
    let [named] = options.robots.as_slice() else {
        let what = "a table of configurations does not identify the arm".to_owned();
        return Err(call(what, "name its model with --robot"));
    };
    let robot = named.robot()?;
    let (base, tip) = chain_ends(&robot, options)
        .map_err(|what| call(what, "name a link with --base or --tip"))?;
    let chain = robot.chain(base, tip);
    let with_count = || {
        let count = joint_count.filter(|_| options.tip.is_none())?;
        let is_right = |chain: &Chain| chain.dof() == count;
        if chain.as_ref().is_ok_and(is_right) {
            return None;
        }
        robot.leaf_links().filter_map(|link| robot.chain(base, link).ok()).find(is_right)
    };
    if let Some(other) = with_count() {
        return Ok((robot, other));
    }
    let chain = chain
        .map_err(|error| call(error.to_string(), "name different links with --base and --tip"))?;
    Ok((robot, chain))
}

/// # Errors
/// If there are too few rows.
pub(super) fn numbers_suffice(path: &Path, table: &NumberTable) -> Result<(), Trouble> {
    let rows = table.rows.len();
    if rows < MIN_ROWS {
        let what = format!("only {rows} rows hold numbers in all columns, fewer than {MIN_ROWS}");
        return Err(trouble(path, what, "use a table with more configurations"));
    }
    Ok(())
}

pub(super) fn dropped_rows(table: &NumberTable) -> Option<String> {
    let line = table.dropped.first()?;
    let count = table.dropped.len();
    Some(format!("{count} rows with values that are not numbers, the first in line {line}"))
}

pub(super) fn chain_ends(robot: &Robot, options: &RunOptions) -> Result<(LinkId, LinkId), String> {
    let link = |given: &Option<String>, usual: &Option<String>| {
        let name = given.as_ref().or(usual.as_ref());
        name.map(|name| robot.link_or_nearest(name)).transpose().map_err(|error| error.to_string())
    };
    let base = link(&options.base, &robot.default_base)?.unwrap_or_else(|| robot.root());
    let usual = ["tool0", "flange"].iter().find_map(|name| robot.link(name));
    let tip = link(&options.tip, &robot.default_tip)?.or(usual);
    Ok((base, tip.or_else(|| robot.leaf_links().last()).unwrap_or(base)))
}

/// Rows at rest, with joint positions times `unit`.
pub(super) fn joint_track(table: &NumberTable, joints: &[usize], unit: f64) -> JointTrack {
    let mut track = JointTrack { dof: joints.len(), ..JointTrack::default() };
    for (at, row) in table.rows.iter().enumerate() {
        for within_s in [0.0, REST_S] {
            track.t_s.push(at as f64 * ROW_INTERVAL_S + within_s);
            track.q.extend(joints.iter().map(|&column| unit * row[column]));
        }
    }
    track.qd = vec![0.0; track.q.len()];
    track
}

/// Times of rows within the rests of [`joint_track`].
pub(super) fn row_times(rows: usize) -> Vec<f64> {
    (0..rows).map(|at| at as f64 * ROW_INTERVAL_S + 0.5 * REST_S).collect()
}

fn pose_track(rows: &[Vec<f64>], position: [usize; 3], rotation: &RotationColumns) -> PoseTrack {
    let xyz = |row: &Vec<f64>| Vec3::from(position.map(|column| row[column]));
    let orientation = match rotation {
        RotationColumns::Numbers(columns) => Orientations::Numbers(
            rows.iter().map(|row| columns.map(|column| row[column])).collect(),
        ),
        RotationColumns::Quaternion(columns) => {
            let rotation = |row: &Vec<f64>| rotation_from_xyzw(columns.map(|column| row[column]));
            let all: Option<Vec<_>> = rows.iter().map(rotation).collect();
            all.map_or(Orientations::Unset(rows.len()), Orientations::Rotations)
        }
        RotationColumns::None => Orientations::Unset(rows.len()),
    };
    PoseTrack {
        t_s: row_times(rows.len()),
        xyz: rows.iter().map(xyz).collect(),
        orientation,
        declared: None,
    }
}
