//! Visual and collision shapes of a URDF, to draw a robot; invalid ones are ignored. Format:
//! <https://wiki.ros.org/urdf/XML/link>.

use roxmltree::Node;

use crate::geometry::{Pose, pose, rotation_from_rpy};

use super::joint::MAX_MAGNITUDE;
use super::xml::document;
use super::{LinkId, Robot};

/// A visual of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct Visual {
    /// The link.
    pub link: LinkId,
    /// Pose in the link.
    pub link_from_visual: Pose,
    /// Shape.
    pub shape: Shape,
}

/// Shape, centred on its frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// Mesh file.
    Mesh {
        /// Such as `package://ur_description/meshes/base.dae`.
        uri: String,
        /// Scale along x, y and z.
        scale: [f64; 3],
    },
    /// Edge lengths along x, y and z, m.
    Box([f64; 3]),
    /// Cylinder along z.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
        /// Length, m.
        length_m: f64,
    },
    /// Radius, m.
    Sphere(f64),
}

impl Robot {
    /// In file order; empty if the model is not a URDF.
    pub fn visuals(&self) -> Vec<Visual> {
        self.drawn("visual")
    }

    /// Collision shapes, in file order.
    pub fn collisions(&self) -> Vec<Visual> {
        self.drawn("collision")
    }

    fn drawn(&self, element: &'static str) -> Vec<Visual> {
        let document = self.text().map(document);
        let Some(Ok(document)) = document else { return Vec::new() };
        // Links may be renamed but keep their order.
        let links = child_named(document.root_element(), "link").zip(self.links());
        let visuals = links.flat_map(|(node, link)| {
            child_named(node, element).filter_map(move |visual| visual_of(link, visual))
        });
        visuals.collect()
    }
}

fn visual_of(link: LinkId, node: Node) -> Option<Visual> {
    let origin = child_named(node, "origin").next();
    let part = |attribute| match origin.and_then(|origin| origin.attribute(attribute)) {
        Some(text) => numbers::<3>(text),
        None => Some([0.0; 3]),
    };
    let link_from_visual = pose(part("xyz")?, rotation_from_rpy(part("rpy")?));
    let geometry = child_named(node, "geometry").next()?;
    let shape = shape_of(geometry.children().find(Node::is_element)?)?;
    Some(Visual { link, link_from_visual, shape })
}

fn shape_of(node: Node) -> Option<Shape> {
    let number = |attribute| numbers::<1>(node.attribute(attribute)?).map(|[number]| number);
    Some(match node.tag_name().name() {
        "mesh" => Shape::Mesh {
            uri: node.attribute("filename")?.trim().to_owned(),
            scale: node.attribute("scale").map_or(Some([1.0; 3]), numbers)?,
        },
        "box" => Shape::Box(numbers(node.attribute("size")?)?),
        "cylinder" => Shape::Cylinder { radius_m: number("radius")?, length_m: number("length")? },
        "sphere" => Shape::Sphere(number("radius")?),
        _ => return None,
    })
}

fn child_named<'a, 'input>(
    node: Node<'a, 'input>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.is_element() && child.tag_name().name() == name)
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let words = text
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|x: &f64| x.abs() <= MAX_MAGNITUDE));
    words.collect::<Option<Vec<f64>>>()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const URDF: &str = r#"<robot name="two">
      <link name="base">
        <visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
        <visual><geometry><box size="wide"/></geometry></visual>
        <collision><geometry><sphere radius="1"/></geometry></collision>
      </link>
      <joint name="j" type="revolute">
        <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
      </joint>
      <link name="arm">
        <visual>
          <origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>
          <geometry><mesh filename="package://two/arm.stl" scale="0.001 0.001 0.001"/></geometry>
        </visual>
        <visual><geometry><cylinder radius="0.05" length="1"/></geometry></visual>
        <visual><geometry><teapot/></geometry></visual>
      </link>
    </robot>"#;

    #[test]
    fn visuals_belong_to_their_links_and_broken_ones_are_skipped() {
        let robot = Robot::from_urdf(URDF, "test").unwrap();
        let visuals = robot.visuals();
        let links: Vec<&str> = visuals.iter().map(|visual| robot.link_name(visual.link)).collect();
        assert_eq!(links, ["base", "arm", "arm"]);
        assert_eq!(visuals[0].shape, Shape::Box([0.1, 0.2, 0.3]));
        assert_eq!(visuals[0].link_from_visual, Pose::identity());
        let uri = "package://two/arm.stl".to_owned();
        assert_eq!(visuals[1].shape, Shape::Mesh { uri, scale: [0.001; 3] });
        let x = visuals[1].link_from_visual * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((x - nalgebra::Point3::new(0.0, 1.0, 0.5)).norm() < 1e-12, "{x}");
        assert_eq!(visuals[2].shape, Shape::Cylinder { radius_m: 0.05, length_m: 1.0 });
    }

    #[test]
    fn collision_shapes_are_separate_from_visuals() {
        let shapes: Vec<Shape> = Robot::from_urdf(URDF, "test")
            .unwrap()
            .collisions()
            .into_iter()
            .map(|collision| collision.shape)
            .collect();
        assert_eq!(shapes, [Shape::Sphere(1.0)]);
    }

    #[test]
    fn visuals_follow_a_renamed_link() {
        let robot = Robot::from_urdf(URDF, "test").unwrap();
        let left = robot.renamed(|name| format!("left_{name}")).unwrap();
        let links: Vec<LinkId> = left.visuals().iter().map(|visual| visual.link).collect();
        assert_eq!(left.link("left_arm"), links.last().copied());
    }

    #[test]
    fn models_without_a_urdf_have_no_visuals() {
        assert!(crate::robot::catalogue::find("ur5e").unwrap().visuals().is_empty());
    }
}
