//! Writes a robot's kinematics as a URDF.

use std::fmt::Write as _;

use super::joint::JointKind;
use super::model::Robot;
use super::patch::numbers;
use crate::geometry::{Convention, xyz_of};

impl Robot {
    /// URDF of links, joints, origins, axes and limits.
    pub fn to_urdf(&self) -> String {
        let mut text =
            format!("<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n", escaped(&self.name));
        for link in self.links() {
            let _ = writeln!(text, "  <link name=\"{}\"/>", escaped(self.link_name(link)));
        }
        for joint in self.joints() {
            let (name, kind) = (escaped(&joint.name), joint.kind.name());
            let _ = writeln!(text, "  <joint name=\"{name}\" type=\"{kind}\">");
            let origin = &joint.parent_from_joint;
            let (xyz, rpy) =
                (numbers(xyz_of(origin)), numbers(Convention::RPY.numbers(&origin.rotation)));
            let _ = writeln!(text, "    <origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>");
            let ends = [joint.parent, joint.child].map(|link| escaped(self.link_name(link)));
            let _ = writeln!(
                text,
                "    <parent link=\"{}\"/>\n    <child link=\"{}\"/>",
                ends[0], ends[1]
            );
            if joint.kind.has_position() {
                let _ =
                    writeln!(text, "    <axis xyz=\"{}\"/>", numbers(joint.axis.iter().copied()));
                let limits = &joint.limits;
                let ends =
                    limits.lower.zip(limits.upper).filter(|_| joint.kind != JointKind::Continuous);
                let ends = ends.map_or_else(String::new, |(lower, upper)| {
                    format!("lower=\"{lower}\" upper=\"{upper}\" ")
                });
                let velocity = limits.velocity.unwrap_or(0.0);
                if !ends.is_empty() || limits.velocity.is_some() {
                    let _ =
                        writeln!(text, "    <limit {ends}effort=\"0\" velocity=\"{velocity}\"/>");
                }
            }
            if let Some(mimic) = &joint.mimic {
                let (joint, multiplier, offset) =
                    (escaped(&mimic.joint), mimic.multiplier, mimic.offset);
                let _ = writeln!(
                    text,
                    "    <mimic joint=\"{joint}\" multiplier=\"{multiplier}\" offset=\"{offset}\"/>"
                );
            }
            text += "  </joint>\n";
        }
        text + "</robot>\n"
    }
}

fn escaped(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use crate::robot::{Robot, catalogue};

    #[test]
    fn every_catalogue_arm_survives_a_urdf_round_trip() {
        for robot in catalogue::entries() {
            let read = Robot::from_urdf(&robot.to_urdf(), "written.urdf").unwrap();
            assert_eq!(read.joints().len(), robot.joints().len());
            for (read, joint) in read.joints().iter().zip(robot.joints()) {
                let off = read.parent_from_joint.inverse() * joint.parent_from_joint;
                assert!(off.translation.vector.norm() < 1e-11 && off.rotation.angle() < 1e-11);
                assert!((read.axis - joint.axis).norm() < 1e-9 || !joint.kind.has_position());
                assert_eq!(
                    (&read.name, read.kind, &read.mimic),
                    (&joint.name, joint.kind, &joint.mimic)
                );
                assert_eq!(
                    (read.limits.lower, read.limits.upper),
                    (joint.limits.lower, joint.limits.upper)
                );
            }
        }
    }
}
