//! Robots in TOML, with the catalogue's schema.

use std::collections::HashSet;

use serde::Deserialize;
use toml::Spanned;

use crate::geometry::{pose, rotation_from_rpy};

use super::dh::{DhModel, DhTable};
use super::error::Located;
use super::error::{Problem, RobotError};
use super::joint::{JointDraft, JointKind, Limits, LinkDraft};
use super::model::{Provenance, Robot, unit_axis};
use super::without_bom;

impl Robot {
    /// Parses TOML in m and rad: `[[joint]]` tables as in URDF (which take precedence), or a `[dh]` table.
    /// `source` is its name in errors.
    ///
    /// # Errors
    /// If it does not match the schema, or its joints do not form one tree.
    pub fn from_toml(text: &str, source: &str) -> Result<Robot, RobotError> {
        let text = without_bom(text);
        let table: RobotTable = parse(text, source)?;
        let robot = table.into_robot(source);
        let mut robot = robot.map_err(|located| RobotError::located(source, text, located))?;
        robot.text = Some(text.into());
        Ok(robot)
    }
}

pub(super) fn parse<T: serde::de::DeserializeOwned>(
    text: &str,
    source: &str,
) -> Result<T, RobotError> {
    toml::from_str(text).map_err(|error| {
        let message = error.message().lines().collect::<Vec<_>>().join(", ");
        let offset = error.span().map_or(0, |span| span.start);
        RobotError::located(source, text, (offset, Problem::Toml(message)))
    })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotTable {
    id: Option<String>,
    vendor: Option<String>,
    model: Option<String>,
    source: Option<String>,
    licence: Option<String>,
    base: Option<String>,
    tip: Option<String>,
    controller_base: Option<String>,
    controller_tip: Option<String>,
    #[serde(default)]
    aliases: Vec<String>,
    #[serde(default)]
    joint_prefixes: Vec<String>,
    joint_names: Option<Vec<String>>,
    dof: Option<usize>,
    units: Option<String>,
    #[serde(default, rename = "joint")]
    joints: Vec<Spanned<JointTable>>,
    dh: Option<Spanned<DhTable>>,
    #[serde(rename = "source_paths")]
    _source_paths: Option<String>,
    #[serde(rename = "driver_frame")]
    _driver_frame: Option<String>,
    #[serde(rename = "note")]
    _note: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct JointTable {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    parent: String,
    child: String,
    #[serde(default)]
    xyz: [f64; 3],
    #[serde(default)]
    rpy: [f64; 3],
    axis: Option<[f64; 3]>,
    lower: Option<f64>,
    upper: Option<f64>,
    velocity: Option<f64>,
}

impl RobotTable {
    pub(super) fn into_robot(mut self, source: &str) -> Result<Robot, Located> {
        if let Some(found) = self.units.take_if(|units| units != "m, rad") {
            return Err((0, Problem::Units { found }));
        }
        let (joints, dh) = self.joint_drafts()?;
        let name = self.id.take().unwrap_or_else(|| source.to_owned());
        let mut robot = Robot::assemble(&name, source, links_of(&joints), joints)?;
        self.check_dof(&robot)?;
        robot.dh = dh;
        robot.provenance = self.provenance();
        robot.default_base = self.base;
        robot.default_tip = self.tip;
        robot.controller_base = self.controller_base;
        robot.controller_tip = self.controller_tip;
        robot.aliases = self.aliases;
        robot.joint_prefixes = self.joint_prefixes;
        check_named_links(&robot)?;
        Ok(robot)
    }

    fn joint_drafts(&mut self) -> Result<(Vec<JointDraft>, Option<DhModel>), Located> {
        if !self.joints.is_empty() {
            let joints: Result<_, _> = self.joints.drain(..).map(joint_draft).collect();
            return joints.map(|joints| (joints, None));
        }
        let dh = self.dh.take().ok_or((0, Problem::NoKinematics))?;
        let at = dh.span().start;
        let mut dh = dh.into_inner();
        dh.base = dh.base.or_else(|| self.base.clone());
        dh.tip = dh.tip.or_else(|| self.tip.clone());
        dh.joint_names = dh.joint_names.or_else(|| self.joint_names.take());
        self.base = Some(dh.base_name().to_owned());
        self.tip = Some(dh.tip_name().to_owned());
        let joints = dh.joints(at).map_err(|problem| (at, problem))?;
        Ok((joints, Some(dh.model())))
    }

    fn check_dof(&self, robot: &Robot) -> Result<(), Located> {
        let counted = robot.joints().iter().filter(|joint| joint.kind.has_position()).count();
        match self.dof {
            Some(stated) if stated != counted => Err((0, Problem::Dof { stated, counted })),
            _ => Ok(()),
        }
    }

    fn provenance(&mut self) -> Option<Provenance> {
        Some(Provenance {
            vendor: self.vendor.take()?,
            model: self.model.take()?,
            source: self.source.take()?,
            licence: self.licence.take()?,
        })
    }
}

fn joint_draft(table: Spanned<JointTable>) -> Result<JointDraft, Located> {
    let at = table.span().start;
    let JointTable { name, kind, parent, child, xyz, rpy, axis, lower, upper, velocity } =
        table.into_inner();
    let Some(kind) = JointKind::from_name(&kind) else {
        return Err((at, Problem::JointType { joint: name, found: kind }));
    };
    let axis = axis.unwrap_or([1.0, 0.0, 0.0]);
    if [xyz, rpy, axis].iter().flatten().any(|number| !number.is_finite()) {
        return Err((at, Problem::NotFinite { element: format!("joint '{name}'") }));
    }
    let axis = unit_axis(&name, kind, axis).map_err(|problem| (at, problem))?;
    let finite = |limit: Option<f64>| limit.filter(|limit| limit.is_finite());
    Ok(JointDraft {
        name,
        kind,
        parent,
        child,
        parent_from_joint: pose(xyz, rotation_from_rpy(rpy)),
        axis,
        limits: Limits { lower: finite(lower), upper: finite(upper), velocity: finite(velocity) },
        mimic: None,
        at,
    })
}

fn links_of(joints: &[JointDraft]) -> Vec<LinkDraft> {
    let mut seen = HashSet::new();
    let mentions =
        joints.iter().flat_map(|joint| [(&joint.parent, joint.at), (&joint.child, joint.at)]);
    mentions
        .filter(|(name, _)| seen.insert(name.as_str()))
        .map(|(name, at)| LinkDraft { name: name.clone(), at })
        .collect()
}

fn check_named_links(robot: &Robot) -> Result<(), Located> {
    let named = [
        ("base", &robot.default_base),
        ("tip", &robot.default_tip),
        ("controller_base", &robot.controller_base),
        ("controller_tip", &robot.controller_tip),
    ];
    for (what, name) in named {
        if let Some(name) = name
            && robot.link(name).is_none()
        {
            return Err((0, Problem::NamedLink { what, name: name.clone() }));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::geometry::angle_between;
    use crate::robot::Chain;
    use crate::robot::catalogue::VENDORS;

    use super::*;

    #[derive(Deserialize)]
    struct Vendor<T> {
        robot: Vec<T>,
    }

    /// Stated differences between `[dh]` and the joints of a catalogue arm.
    #[derive(Deserialize)]
    struct Stated {
        dh: Option<StatedDifference>,
    }

    #[derive(Deserialize)]
    struct StatedDifference {
        max_diff_vs_urdf_m: f64,
        max_diff_vs_urdf_rad: f64,
    }

    fn chain(robot: &Robot, dh: &DhTable) -> Chain {
        let link = |name| robot.link(name).unwrap();
        robot.chain(link(dh.base_name()), link(dh.tip_name())).unwrap()
    }

    #[test]
    fn dh_tables_match_the_joints_within_the_catalogues_tolerance() {
        let mut compared = 0;
        for (file, text) in VENDORS {
            let tables: Vendor<RobotTable> = parse(text, file).unwrap();
            let stated: Vendor<Stated> = parse(text, file).unwrap();
            for (mut table, stated) in tables.robot.into_iter().zip(stated.robot) {
                let (Some(dh), Some(stated)) = (table.dh.take(), stated.dh) else { continue };
                assert_agrees(table, &dh.into_inner(), &stated);
                compared += 1;
            }
        }
        assert_eq!(compared, 37);
    }

    /// The factor allows for maxima at other positions.
    fn assert_agrees(table: RobotTable, dh: &DhTable, stated: &StatedDifference) {
        let drafts = dh.joints(0).unwrap();
        let of_rows = Robot::assemble("dh", "dh", links_of(&drafts), drafts).unwrap();
        let of_joints = table.into_robot("catalogue").unwrap();
        let (rows, joints) = (chain(&of_rows, dh), chain(&of_joints, dh));
        for round in 0..50_u32 {
            let q: Vec<f64> =
                (0..rows.dof()).map(|i| 2.5 * f64::from(round * 7 + i as u32 * 3).sin()).collect();
            let difference = rows.forward(&q).inverse() * joints.forward(&q);
            let distance_m = difference.translation.vector.norm();
            let angle_rad =
                angle_between(&difference.rotation, &crate::geometry::Rotation::identity());
            assert!(
                distance_m < 1.5 * stated.max_diff_vs_urdf_m + 1e-14
                    && angle_rad < 1.5 * stated.max_diff_vs_urdf_rad + 1e-14,
                "{}: {distance_m:e} m and {angle_rad:e} rad off",
                of_joints.name
            );
        }
    }
}
