//! Calibration input from tables of configurations.

use std::path::Path;

use super::calibrate::{CalibrationInput, LogInputs, encoding_name, trouble};
use crate::diagnosis::{PoseStream, diagnose_arm};
use crate::geometry::{Vec3, rotation_from_xyzw};
use crate::log::{CalibrationTable, RotationColumns, read_calibration_table};
use crate::report::{Trouble, TroubleKind};
use crate::robot::{LinkId, Robot};
use crate::run::{PoseSourceKind, RunOptions};
use crate::stream::{JointTrack, Orientations, PoseTrack};

/// Tables have no times: rows are 1 s apart, with the arm at rest for half of it.
const ROW_INTERVAL_S: f64 = 1.0;
const REST_S: f64 = 0.5;
const MIN_ROWS: usize = 6;

/// `None` if the file is not a table.
pub(super) fn read_table(path: &Path) -> Result<Option<ConfigurationTable>, Trouble> {
    Ok(read_calibration_table(path)?.map(ConfigurationTable))
}

pub(super) struct ConfigurationTable(CalibrationTable);

impl ConfigurationTable {
    /// Resolves their encoding against the arm in `options`.
    pub fn input(&self, path: &Path, options: &RunOptions) -> Result<LogInputs, Trouble> {
        let Self(table) = self;
        let call = |what: String, remedy: &str| {
            let kind = TroubleKind::Call;
            Trouble { kind, ..trouble(path, what, remedy) }
        };
        let [named] = options.robots.as_slice() else {
            let what = "a table of configurations does not identify the arm".to_owned();
            return Err(call(what, "name its model with --robot"));
        };
        let robot = named.robot()?;
        let (base, tip) = chain_ends(&robot, options)
            .map_err(|what| call(what, "name a link with --base or --tip"))?;
        let chain = robot.chain(base, tip).map_err(|error| {
            call(error.to_string(), "name different links with --base and --tip")
        })?;
        let Some(joints) = table.joints(chain.joint_names()) else {
            let what =
                format!("it has no columns for the joints {}", chain.joint_names().join(", "));
            return Err(trouble(
                path,
                what,
                "name the columns like the model's joints, or q1, q2 and so on",
            ));
        };
        if table.rows.len() < MIN_ROWS {
            let what = format!("only {} rows hold numbers in all columns", table.rows.len());
            return Err(trouble(path, what, "use a table with more configurations"));
        }
        let (track, poses) = (joint_track(table, &joints), pose_track(table));
        let columns: Vec<usize> = (0..joints.len()).collect();
        let stream = PoseStream {
            track: &poses,
            chain: &chain,
            columns: &columns,
            reference_known: false,
            stamp_error_s: 0.0,
            stamps_copied: true,
            removed_ramp: None,
        };
        let found = diagnose_arm(&track, &[stream], ROW_INTERVAL_S);
        let Some(diagnosis) = found.streams.first().filter(|one| one.residual.is_ok()) else {
            return Err(trouble(
                path,
                "its poses do not follow the arm",
                "check that --robot is the arm's model",
            ));
        };
        if diagnosis.is_far_from_fk() {
            return Err(trouble(
                path,
                "its positions do not match FK",
                "check that --robot is the arm's model",
            ));
        }
        let mut unzeroed = found.joints.clone();
        unzeroed.offsets.iter_mut().for_each(|offset| offset.is_chosen = false);
        let slides: Vec<bool> = chain
            .joint_kinds()
            .iter()
            .map(|kind| *kind == crate::robot::JointKind::Prismatic)
            .collect();
        let frames = &diagnosis.frame_correction;
        let dropped = table.dropped.first().map(|line| {
            format!(
                "{} rows with values that are not numbers, the first in line {line}",
                table.dropped.len()
            )
        });
        let input = CalibrationInput {
            log: path.to_path_buf(),
            topic: "rows".to_owned(),
            source_kind: PoseSourceKind::External,
            encoding: encoding_name(diagnosis),
            base: chain.base_name().to_owned(),
            tip: chain.tip_name().to_owned(),
            joints: unzeroed.corrected_joints(&track, &slides),
            columns: columns.clone(),
            t_s: diagnosis.aligned.t_s.clone(),
            poses: diagnosis.aligned.corrected.iter().map(|pose| frames.invert(pose)).collect(),
            is_rotation_excluded: diagnosis.encoding.is_err(),
            latency_s: None,
            skew: 0.0,
            reference: frames.reference,
            is_reference_free: true,
            tool: frames.tool,
            is_tool_free: true,
            zeros: Vec::new(),
        };
        Ok((robot, vec![input], dropped.into_iter().collect()))
    }
}

fn chain_ends(robot: &Robot, options: &RunOptions) -> Result<(LinkId, LinkId), String> {
    let link = |given: &Option<String>, usual: &Option<String>| {
        let name = given.as_ref().or(usual.as_ref());
        name.map(|name| robot.link_or_nearest(name)).transpose().map_err(|error| error.to_string())
    };
    let base = link(&options.base, &robot.default_base)?.unwrap_or_else(|| robot.root());
    let usual = ["tool0", "flange"].iter().find_map(|name| robot.link(name));
    let tip = link(&options.tip, &robot.default_tip)?.or(usual);
    Ok((base, tip.or_else(|| robot.leaf_links().last()).unwrap_or(base)))
}

fn joint_track(table: &CalibrationTable, joints: &[usize]) -> JointTrack {
    let mut track = JointTrack { dof: joints.len(), ..JointTrack::default() };
    for (at, row) in table.rows.iter().enumerate() {
        for within_s in [0.0, REST_S] {
            track.t_s.push(at as f64 * ROW_INTERVAL_S + within_s);
            track.q.extend(joints.iter().map(|&column| row[column]));
        }
    }
    track.qd = vec![0.0; track.q.len()];
    track
}

fn pose_track(table: &CalibrationTable) -> PoseTrack {
    let rows = &table.rows;
    let xyz = |row: &Vec<f64>| Vec3::from(table.position.map(|column| row[column]));
    let orientation = match &table.rotation {
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
        t_s: (0..rows.len()).map(|at| at as f64 * ROW_INTERVAL_S + 0.5 * REST_S).collect(),
        xyz: rows.iter().map(xyz).collect(),
        orientation,
        declared: None,
    }
}
