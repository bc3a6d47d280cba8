//! Writes the arm as URDF.

use crate::geometry::{Convention, xyz_of};
use crate::robot::{Joint, Limits, Mimic, Robot};

/// `robot` as URDF: links, joints, limits and mimic joints, without shapes and masses.
pub fn urdf_text(robot: &Robot) -> String {
    let mut text =
        format!("<?xml version=\"1.0\"?>\n<robot name={}>\n", xml_attribute(&robot.name));
    for link in robot.links() {
        text += &format!("  <link name={}/>\n", xml_attribute(robot.link_name(link)));
    }
    for joint in robot.joints() {
        text += &joint_text(robot, joint);
    }
    text + "</robot>\n"
}

fn joint_text(robot: &Robot, joint: &Joint) -> String {
    let [x, y, z] = xyz_of(&joint.parent_from_joint);
    let [roll, pitch, yaw] = Convention::RPY.numbers(&joint.parent_from_joint.rotation);
    let mut text = format!(
        "  <joint name={} type=\"{}\">\n    <parent link={}/>\n    <child link={}/>\n    \
         <origin xyz=\"{x} {y} {z}\" rpy=\"{roll} {pitch} {yaw}\"/>\n",
        xml_attribute(&joint.name),
        joint.kind.name(),
        xml_attribute(robot.link_name(joint.parent)),
        xml_attribute(robot.link_name(joint.child)),
    );
    if joint.kind.has_position() {
        let [x, y, z]: [f64; 3] = joint.axis.into();
        text += &format!("    <axis xyz=\"{x} {y} {z}\"/>\n");
        text += &limit_text(&joint.limits);
    }
    if let Some(Mimic { joint, multiplier, offset }) = &joint.mimic {
        let joint = xml_attribute(joint);
        text += &format!(
            "    <mimic joint={joint} multiplier=\"{multiplier}\" offset=\"{offset}\"/>\n"
        );
    }
    text + "  </joint>\n"
}

/// URDF requires an effort if there is any limit.
fn limit_text(limits: &Limits) -> String {
    let Limits { lower, upper, velocity } = *limits;
    let stated = [("lower", lower), ("upper", upper), ("velocity", velocity)];
    let attributes: String = stated
        .into_iter()
        .filter_map(|(name, limit)| Some(format!(" {name}=\"{}\"", limit?)))
        .collect();
    if attributes.is_empty() {
        return attributes;
    }
    format!("    <limit effort=\"0\"{attributes}/>\n")
}

fn xml_attribute(name: &str) -> String {
    let escaped = name.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    format!("\"{escaped}\"")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::angle_between;
    use crate::robot::catalogue;

    #[test]
    fn every_catalogue_arm_round_trips() {
        for robot in catalogue::entries() {
            let read = Robot::from_urdf(&urdf_text(robot), "written").unwrap();
            assert_eq!(read.name, robot.name);
            let names = |robot: &Robot| -> Vec<String> {
                robot.links().map(|link| robot.link_name(link).to_owned()).collect()
            };
            assert_eq!(names(&read), names(robot));
            assert_eq!(read.joints().len(), robot.joints().len());
            for (read, joint) in read.joints().iter().zip(robot.joints()) {
                assert_eq!((&read.name, read.kind), (&joint.name, joint.kind));
                assert_eq!((read.parent, read.child), (joint.parent, joint.child));
                assert_eq!((read.limits, &read.mimic), (joint.limits, &joint.mimic));
                assert!((read.axis - joint.axis).norm() < 1e-15);
                let (read, joint) = (read.parent_from_joint, joint.parent_from_joint);
                assert_eq!(read.translation, joint.translation);
                assert!(angle_between(&read.rotation, &joint.rotation) < 1e-15);
            }
        }
    }

    #[test]
    fn names_are_escaped() {
        assert_eq!(xml_attribute("a<b & \"c\""), "\"a&lt;b &amp; &quot;c&quot;\"");
    }
}
