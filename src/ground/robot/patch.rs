//! Minimal edits of a model's source text.

use std::ops::Range;

use roxmltree::Node;
use serde::Deserialize;
use toml::Spanned;

use super::dh::DhConvention;
use super::error::RobotError;
use super::joint::JointKind;
use super::model::Robot;
use super::xml::document;
use crate::geometry::{
    Convention, Pose, angle_between, pose, rotation_from_rotvec, xyz_of, xyzw_from_rotation,
};

/// Resolution of the edited origins, m and rad.
const RESOLUTION: f64 = 1e-9;

/// Error of editing a model's text.
#[derive(Debug, thiserror::Error)]
pub enum PatchError {
    /// From the catalogue or not from text.
    #[error("the model is not from a file or a description")]
    NoText,
    /// A calibration replaced the origins and would undo the edit.
    #[error("the joint origins were replaced by a calibration")]
    Overlaid,
    /// Neither a URDF nor a DH table.
    #[error("the text is neither a URDF nor a DH table")]
    Layout,
    /// The result cannot be parsed.
    #[error("{0}")]
    Unreadable(#[from] RobotError),
    /// The edit has not the intended effect.
    #[error("the format of joint '{0}' does not allow an edit")]
    NotPatched(String),
}

type Edit = (Range<usize>, String);

impl Robot {
    /// Adds `offsets` to the joint zeros in the text: FK of reported positions becomes the previous FK of
    /// `position + offset` (`q_true = q_reported + offset`; rad, or m for prismatic joints).
    ///
    /// A joint's origin becomes `parent_from_joint · motion(axis, offset)`. In a DH table, θ or d of the
    /// row changes, and the convention if the robot uses the other one. Unknown joints are ignored; the
    /// rest of the text stays.
    ///
    /// # Errors
    /// If there is no text, or it cannot be edited.
    pub fn text_with_offsets(&self, offsets: &[(&str, f64)]) -> Result<String, PatchError> {
        let (text, own) = self.own_text()?;
        let text = text.as_str();
        let offset_of = |index: usize| {
            let name = &self.joints()[index].name;
            offsets.iter().find(|(joint, _)| joint == name).map(|&(_, offset)| offset)
        };
        if self.joints().iter().enumerate().all(|(index, _)| offset_of(index).is_none()) {
            return Ok(text.to_owned());
        }
        let edits = match (own.dh.is_some(), is_xml(text)) {
            (true, _) => dh_edits(text, &own, offset_of)?,
            (false, true) => urdf_edits(text, &own, |index| {
                let joint = &own.joints()[index];
                Some(joint.parent_from_joint * motion(joint.kind, &joint.axis, offset_of(index)?))
            })?,
            (false, false) => return Err(PatchError::Layout),
        };
        let patched = edited(text, edits);
        let read = Robot::from_text(&patched, &self.source)?;
        let joints = own.joints().iter().zip(read.joints()).enumerate();
        for (index, (joint, read)) in joints.filter(|_| own.dh.is_none()) {
            let motion = motion(joint.kind, &joint.axis, offset_of(index).unwrap_or(0.0));
            if !is_within_resolution(&read.parent_from_joint, &(joint.parent_from_joint * motion)) {
                return Err(PatchError::NotPatched(joint.name.clone()));
            }
        }
        Ok(patched)
    }

    /// Edits a URDF so that its joints have the origins of `to`, a copy of this robot.
    ///
    /// # Errors
    /// If the text is missing, no URDF, or cannot be edited.
    pub fn text_with_origins_of(&self, to: &Robot) -> Result<String, PatchError> {
        let text = self.text().ok_or(PatchError::NoText)?;
        if !is_xml(text) {
            return Err(PatchError::Layout);
        }
        let own = Robot::from_text(text, &self.source)?;
        let after = |index: usize| to.joints().get(index).map(|joint| joint.parent_from_joint);
        let patched = edited(text, urdf_edits(text, &own, after)?);
        let read = Robot::from_text(&patched, &self.source)?;
        for (joint, read) in to.joints().iter().zip(read.joints()) {
            if !is_within_resolution(&read.parent_from_joint, &joint.parent_from_joint) {
                return Err(PatchError::NotPatched(joint.name.clone()));
            }
        }
        Ok(patched)
    }

    /// Text with this robot's DH convention, and the robot parsed from it.
    fn own_text(&self) -> Result<(String, Robot), PatchError> {
        let text = self.text().ok_or(PatchError::NoText)?;
        let text = match &self.dh {
            Some(dh) => of_convention(text, dh.convention).ok_or(PatchError::Layout)?,
            None => text.to_owned(),
        };
        let own = Robot::from_text(&text, &self.source)?;
        let same = own.joints().iter().zip(self.joints());
        let mut same = same.map(|(own, joint)| {
            is_within_resolution(&own.parent_from_joint, &joint.parent_from_joint)
        });
        match same.all(|is_within_resolution| is_within_resolution) {
            true => Ok((text, own)),
            false => Err(PatchError::Overlaid),
        }
    }
}

fn of_convention(text: &str, convention: DhConvention) -> Option<String> {
    let table: DhText = toml::from_str(text).ok()?;
    let stated = table.dh.convention;
    if stated.get_ref() == convention.name() {
        return Some(text.to_owned());
    }
    Some(edited(text, vec![(stated.span(), format!("\"{}\"", convention.name()))]))
}

fn is_xml(text: &str) -> bool {
    super::without_bom(text).trim_start().starts_with('<')
}

fn is_within_resolution(a: &Pose, b: &Pose) -> bool {
    let difference = a.inverse() * b;
    difference.translation.vector.norm() < RESOLUTION
        && angle_between(&a.rotation, &b.rotation) < RESOLUTION
}

/// In its own frame.
fn motion(kind: JointKind, axis: &crate::geometry::Vec3, offset: f64) -> Pose {
    match kind {
        JointKind::Prismatic => pose((axis * offset).into(), rotation_from_rotvec(axis * 0.0)),
        _ => pose([0.0; 3], rotation_from_rotvec(axis * offset)),
    }
}

fn edited(text: &str, mut edits: Vec<Edit>) -> String {
    edits.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    let mut edited = text.to_owned();
    for (place, new) in edits {
        edited.replace_range(place, &new);
    }
    edited
}

/// At most twelve decimals, no trailing zeros.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.12}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

pub(super) fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(number).collect::<Vec<_>>().join(" ")
}

#[derive(Deserialize)]
struct DhText {
    dh: DhRows,
}

#[derive(Deserialize)]
struct DhRows {
    convention: Spanned<String>,
    rows: Vec<[Spanned<f64>; 4]>,
}

fn dh_edits(
    text: &str,
    own: &Robot,
    offset_of: impl Fn(usize) -> Option<f64>,
) -> Result<Vec<Edit>, PatchError> {
    const D: usize = 1;
    const THETA: usize = 3;
    let table: DhText = toml::from_str(text).map_err(|_| PatchError::Layout)?;
    let edits = table.dh.rows.iter().zip(own.joints()).enumerate().filter_map(|(index, row)| {
        let (row, joint) = row;
        let column = if joint.kind == JointKind::Prismatic { D } else { THETA };
        let cell = &row[column];
        let new = cell.get_ref() + offset_of(index)?;
        Some((cell.span(), decimal(&number(new))))
    });
    Ok(edits.collect())
}

fn decimal(number: &str) -> String {
    if number.contains('.') { number.to_owned() } else { format!("{number}.0") }
}

fn urdf_edits(
    text: &str,
    own: &Robot,
    after: impl Fn(usize) -> Option<Pose>,
) -> Result<Vec<Edit>, PatchError> {
    let document = document(text).map_err(|_| PatchError::Layout)?;
    let nodes = document.root_element().children().filter(|node| node.has_tag_name("joint"));
    let mut edits = Vec::new();
    for (index, (joint, node)) in own.joints().iter().zip(nodes).enumerate() {
        let Some(after) = after(index) else { continue };
        let before = joint.parent_from_joint;
        let is_element = |child: &Node| child.is_element() && child.tag_name().name() == "origin";
        let origin = node.children().find(is_element);
        let refuse = || PatchError::NotPatched(joint.name.clone());
        if before.rotation != after.rotation {
            let quaternion = origin.and_then(|origin| origin.attribute_node("quat_xyzw"));
            let (name, value) = match quaternion {
                Some(_) => ("quat_xyzw", numbers(xyzw_from_rotation(&after.rotation))),
                None => ("rpy", numbers(Convention::RPY.numbers(&after.rotation))),
            };
            edits.push(attribute_edit(text, node, origin, name, &value).ok_or_else(refuse)?);
        }
        if before.translation != after.translation {
            let value = numbers(xyz_of(&after));
            edits.push(attribute_edit(text, node, origin, "xyz", &value).ok_or_else(refuse)?);
        }
    }
    Ok(edits)
}

/// Sets an attribute of a joint's origin; inserts attribute or element if missing.
fn attribute_edit(
    text: &str,
    joint: Node<'_, '_>,
    origin: Option<Node<'_, '_>>,
    name: &str,
    value: &str,
) -> Option<Edit> {
    let Some(origin) = origin else {
        let first = joint.first_child()?;
        let at = first.range().start;
        let blank = first.text().filter(|text| first.is_text() && text.trim().is_empty());
        let blank = blank.unwrap_or_default();
        return Some((at..at, format!("{blank}<origin {name}=\"{value}\"/>")));
    };
    if let Some(attribute) = origin.attribute_node(name) {
        return Some((attribute.range_value(), value.to_owned()));
    }
    let start = origin.range().start;
    let tag_ends = |c: char| c.is_whitespace() || c == '/' || c == '>';
    let at = start + text.get(start..)?.find(tag_ends)?;
    Some((at..at, format!(" {name}=\"{value}\"")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const URDF: &str = r#"<?xml version="1.0"?>
<robot name="two">  <!-- by hand -->
  <link name="base"/><link name="arm"/><link name="slide"/><link name="tool"/>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="arm"/>
    <axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name='lift' type='prismatic'>
    <origin rpy='0.1 0.2 0.3'/>
    <parent link="arm"/><child link="slide"/><axis xyz="1 0 0"/>
  </joint>
  <joint name="twist" type="continuous">
    <origin  xyz="0 0 0.5" rpy="0 1.570796326794897 0" />
    <parent link="slide"/><child link="tool"/><axis xyz="0 0 -1"/>
  </joint>
</robot>
"#;

    const DH: &str = r#"
# a table
[dh]
convention = "modified"  # Craig
rows = [
  [0, 0.4, 0.0, 0.0],   # the first
  [0.3, 0.1, 1.5, -1.0],
  [0.0, 0.2, -1.5, 0.0],
]
joint_types = ["revolute", "revolute", "prismatic"]
"#;

    fn forward(robot: &Robot, tip: &str, q: &[f64]) -> Pose {
        let base = robot.root();
        robot.chain(base, robot.link(tip).unwrap()).unwrap().forward(q)
    }

    #[test]
    fn patched_fk_of_reported_positions_is_the_true_pose() {
        let robot = Robot::from_urdf(URDF, "two.urdf").unwrap();
        let offsets = [("turn", 0.02), ("lift", -0.003), ("twist", 0.4), ("another", 1.0)];
        let patched = robot.text_with_offsets(&offsets).unwrap();
        let patched_robot = Robot::from_urdf(&patched, "patched.urdf").unwrap();
        for q in [[0.0, 0.0, 0.0], [0.7, 0.1, -2.0]] {
            let truth = [q[0] + 0.02, q[1] - 0.003, q[2] + 0.4];
            let (found, expected) =
                (forward(&patched_robot, "tool", &q), forward(&robot, "tool", &truth));
            assert!(is_within_resolution(&found, &expected), "{found} is not {expected}");
        }
        let changed = similar::TextDiff::from_lines(URDF, &patched);
        let changed = changed.iter_all_changes();
        let gone = changed.filter(|change| change.tag() == similar::ChangeTag::Delete);
        assert_eq!(gone.count(), 2, "one origin is new, two change:\n{patched}");
    }

    #[test]
    fn an_offset_is_written_into_the_rows_of_a_dh_table() {
        let robot = Robot::from_toml(DH, "arm.toml").unwrap();
        let offsets = [("joint_2", 0.01), ("joint_3", 0.002)];
        let patched = robot.text_with_offsets(&offsets).unwrap();
        assert!(patched.contains("[0.3, 0.1, 1.5, -0.99]") && patched.contains("# the first"));
        let patched_robot = Robot::from_toml(&patched, "arm.toml").unwrap();
        let (found, expected) = (
            forward(&patched_robot, "tip", &[0.3, -0.4, 0.1]),
            forward(&robot, "tip", &[0.3, -0.39, 0.102]),
        );
        assert!(is_within_resolution(&found, &expected));
    }

    #[test]
    fn equal_rows_give_another_arm_under_the_other_convention() {
        let robot = Robot::from_toml(DH, "arm.toml").unwrap();
        let rebuilt = robot.under_other_convention().unwrap();
        assert_eq!(robot.text_with_offsets(&[]).unwrap(), DH);
        let text = rebuilt.text_with_offsets(&[]).unwrap();
        assert!(text.contains("convention = \"standard\"  # Craig"), "{text}");
        let read = Robot::from_toml(&text, "arm.toml").unwrap();
        let q = [0.3, -0.4, 0.1];
        assert!(is_within_resolution(&forward(&rebuilt, "tip", &q), &forward(&read, "tip", &q)));
        assert!(!is_within_resolution(&forward(&robot, "tip", &q), &forward(&read, "tip", &q)));
        let back = rebuilt.under_other_convention().unwrap();
        assert!(is_within_resolution(&forward(&robot, "tip", &q), &forward(&back, "tip", &q)));
    }

    #[test]
    fn a_robot_without_its_own_text_is_not_patched() {
        let catalogued = crate::robot::catalogue::find("ur5e").unwrap();
        let why = catalogued.text_with_offsets(&[("elbow_joint", 0.1)]).unwrap_err();
        assert!(matches!(why, PatchError::NoText), "{why}");
        let mut robot = Robot::from_urdf(URDF, "two.urdf").unwrap();
        robot.move_joint("twist", Pose::translation(0.0, 0.0, 0.4));
        let why = robot.text_with_offsets(&[("turn", 0.1)]).unwrap_err();
        assert!(matches!(why, PatchError::Overlaid), "{why}");
    }
}
