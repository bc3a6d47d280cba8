//! Kinematics of a URDF. Format and defaults: <https://wiki.ros.org/urdf/XML/joint>.

use roxmltree::Node;

use crate::geometry::{Pose, Rotation, pose, rotation_from_rpy, rotation_from_xyzw};

use super::error::Located;
use super::error::{Problem, RobotError};
use super::joint::{JointDraft, JointKind, Limits, LinkDraft, Mimic};
use super::model::{Robot, unit_axis};
use super::xml::document;

impl Robot {
    /// Parses `<link>` and `<joint>` of a URDF; `source` is its file or topic in errors. A missing origin
    /// is the identity, a missing axis x; axes are normalised.
    ///
    /// # Errors
    /// If it is not a URDF or not one tree, contains xacro, declares entities, has an invalid number or too
    /// many elements.
    pub fn from_urdf(text: &str, source: &str) -> Result<Robot, RobotError> {
        let document = document(text);
        let robot = document.and_then(|document| read_robot(document.root_element(), source));
        let mut robot = robot.map_err(|located| RobotError::located(source, text, located))?;
        robot.text = Some(text.into());
        Ok(robot)
    }
}

fn read_robot(root: Node, source: &str) -> Result<Robot, Located> {
    let found = root.tag_name().name();
    if found != "robot" {
        return Err(at(root, Problem::NotARobot { found: found.to_owned() }));
    }
    let (mut links, mut joints) = (Vec::new(), Vec::new());
    for child in root.children().filter(Node::is_element) {
        refuse_xacro_element(child)?;
        match child.tag_name().name() {
            "link" => links.push(LinkDraft { name: name_of(child)?, at: child.range().start }),
            "joint" => joints.push(read_joint(child)?),
            _ => {}
        }
    }
    Robot::assemble(root.attribute("name").unwrap_or("robot"), source, links, joints)
}

fn read_joint(node: Node) -> Result<JointDraft, Located> {
    for part in node.descendants().filter(Node::is_element) {
        refuse_xacro_element(part)?;
        part.attributes().try_for_each(|attribute| refuse_xacro_text(part, attribute.value()))?;
    }
    let name = name_of(node)?;
    let element = Element { node, label: format!("joint '{name}'") };
    let type_name = element.required(node, "type", "type attribute")?;
    let kind = JointKind::from_name(type_name).ok_or_else(|| {
        at(node, Problem::JointType { joint: name.clone(), found: type_name.to_owned() })
    })?;
    let axis_xyz = element.triple("axis", "xyz")?.unwrap_or([1.0, 0.0, 0.0]);
    let axis = unit_axis(&name, kind, axis_xyz).map_err(|problem| at(node, problem))?;
    Ok(JointDraft {
        kind,
        parent: element.link("parent", "<parent link=…>")?,
        child: element.link("child", "<child link=…>")?,
        parent_from_joint: element.origin()?,
        axis,
        limits: element.limits(kind)?,
        mimic: element.mimic()?,
        name,
        at: node.range().start,
    })
}

struct Element<'a> {
    node: Node<'a, 'a>,
    label: String,
}

impl<'a> Element<'a> {
    fn part(&self, tag: &str) -> Option<Node<'a, 'a>> {
        self.node.children().find(|child| child.is_element() && child.tag_name().name() == tag)
    }

    fn link(&self, tag: &str, missing: &'static str) -> Result<String, Located> {
        let part = self.part(tag).ok_or_else(|| self.lacks(missing))?;
        self.required(part, "link", missing).map(str::to_owned)
    }

    fn origin(&self) -> Result<Pose, Located> {
        let xyz = self.triple("origin", "xyz")?.unwrap_or_default();
        let rotation = match self.quaternion()? {
            Some(rotation) => rotation,
            None => rotation_from_rpy(self.triple("origin", "rpy")?.unwrap_or_default()),
        };
        Ok(pose(xyz, rotation))
    }

    /// `quat_xyzw`, an alternative to `rpy` in newer URDFs.
    fn quaternion(&self) -> Result<Option<Rotation>, Located> {
        const EXPECTED: &str = "a quaternion x y z w";
        let Some(components) = self.numbers::<4>("origin", "quat_xyzw", EXPECTED)? else {
            return Ok(None);
        };
        let [x, y, z, w] = components;
        let bad = || self.bad_number("origin", "quat_xyzw", &format!("{x} {y} {z} {w}"), EXPECTED);
        rotation_from_xyzw(components).map(Some).ok_or_else(bad)
    }

    /// Infinite limits, and position limits of a continuous joint, count as none.
    fn limits(&self, kind: JointKind) -> Result<Limits, Located> {
        let limit = |attribute| -> Result<Option<f64>, Located> {
            Ok(self.number("limit", attribute)?.filter(|value| value.is_finite()))
        };
        let velocity = limit("velocity")?;
        if kind == JointKind::Continuous {
            return Ok(Limits { velocity, ..Limits::default() });
        }
        Ok(Limits { lower: limit("lower")?, upper: limit("upper")?, velocity })
    }

    fn mimic(&self) -> Result<Option<Mimic>, Located> {
        let Some(part) = self.part("mimic") else { return Ok(None) };
        Ok(Some(Mimic {
            joint: self.required(part, "joint", "<mimic joint=…>")?.to_owned(),
            multiplier: self.finite("mimic", "multiplier")?.unwrap_or(1.0),
            offset: self.finite("mimic", "offset")?.unwrap_or(0.0),
        }))
    }

    fn triple(&self, tag: &str, attribute: &'static str) -> Result<Option<[f64; 3]>, Located> {
        self.numbers(tag, attribute, "three finite numbers")
    }

    fn finite(&self, tag: &str, attribute: &'static str) -> Result<Option<f64>, Located> {
        Ok(self.numbers(tag, attribute, "a finite number")?.map(|[number]| number))
    }

    fn numbers<const N: usize>(
        &self,
        tag: &str,
        attribute: &'static str,
        expected: &'static str,
    ) -> Result<Option<[f64; N]>, Located> {
        let Some(text) = self.attribute(tag, attribute) else { return Ok(None) };
        let parsed: Option<Vec<f64>> = text
            .split_whitespace()
            .map(|word| word.parse().ok().filter(|x: &f64| x.is_finite()))
            .collect();
        let numbers = parsed.and_then(|numbers| <[f64; N]>::try_from(numbers).ok());
        numbers.map(Some).ok_or_else(|| self.bad_number(tag, attribute, text, expected))
    }

    fn number(&self, tag: &str, attribute: &'static str) -> Result<Option<f64>, Located> {
        let Some(text) = self.attribute(tag, attribute) else { return Ok(None) };
        let number = text.trim().parse().ok().filter(|x: &f64| !x.is_nan());
        number.map(Some).ok_or_else(|| self.bad_number(tag, attribute, text, "a number"))
    }

    fn attribute(&self, tag: &str, attribute: &str) -> Option<&'a str> {
        self.part(tag)?.attribute(attribute)
    }

    fn required(
        &self,
        part: Node<'a, 'a>,
        attribute: &str,
        missing: &'static str,
    ) -> Result<&'a str, Located> {
        part.attribute(attribute).ok_or_else(|| self.lacks(missing))
    }

    fn lacks(&self, missing: &'static str) -> Located {
        at(self.node, Problem::Missing { element: self.label.clone(), missing })
    }

    fn bad_number(
        &self,
        tag: &str,
        attribute: &'static str,
        found: &str,
        expected: &'static str,
    ) -> Located {
        let (element, found) = (self.label.clone(), found.to_owned());
        at(
            self.part(tag).unwrap_or(self.node),
            Problem::Number { element, attribute, found, expected },
        )
    }
}

fn name_of(node: Node) -> Result<String, Located> {
    let name = node.attribute("name").ok_or_else(|| {
        let element = format!("a <{}>", node.tag_name().name());
        at(node, Problem::Missing { element, missing: "name" })
    })?;
    refuse_xacro_text(node, name)?;
    Ok(name.to_owned())
}

fn refuse_xacro_element(node: Node) -> Result<(), Located> {
    let tag = node.tag_name();
    if tag.namespace().is_some_and(|namespace| namespace.contains("xacro")) {
        return Err(at(node, Problem::Xacro { found: format!("<xacro:{}>", tag.name()) }));
    }
    Ok(())
}

fn refuse_xacro_text(node: Node, text: &str) -> Result<(), Located> {
    if text.contains("${") || text.contains("$(") {
        return Err(at(node, Problem::Xacro { found: format!("\"{text}\"") }));
    }
    Ok(())
}

fn at(node: Node, problem: Problem) -> Located {
    (node.range().start, problem)
}
