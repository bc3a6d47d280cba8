//! A rotation as lines of code.

use crate::geometry::Rotation;
use crate::geometry::{Convention, xyzw_from_rotation};

/// A line of code in a library.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CodeLine {
    /// The library.
    pub library: &'static str,
    /// The line.
    pub line: String,
}

/// Lines that make the rotation of `numbers` (rad) in `convention`, by the turns themselves and not by
/// the library's own name of the order.
pub(super) fn of_numbers(convention: Convention, numbers: [f64; 3]) -> Vec<CodeLine> {
    let name = convention.to_string();
    let [a, b, c] = numbers.map(number);
    let Some(order) = name.strip_prefix("euler:") else {
        return lines([
            ("SciPy", format!("Rotation.from_rotvec([{a}, {b}, {c}])")),
            (
                "tf_transformations",
                format!("quaternion_about_axis(numpy.linalg.norm(r), r)  # r = [{a}, {b}, {c}]"),
            ),
            (
                "tf2 (C++)",
                format!(
                    "tf2::Vector3 r({a}, {b}, {c}); tf2::Quaternion q = r.length() > 0 ? \
                     tf2::Quaternion(r.normalized(), r.length()) : tf2::Quaternion::getIdentity();"
                ),
            ),
            (
                "Eigen",
                format!(
                    "Eigen::Vector3d r({a}, {b}, {c}); \
                     Eigen::Quaterniond q(Eigen::AngleAxisd(r.norm(), r.stableNormalized()));"
                ),
            ),
            ("nalgebra", format!("UnitQuaternion::from_scaled_axis(Vector3::new({a}, {b}, {c}))")),
        ]);
    };
    let (letters, is_by_axis) = match order.strip_suffix("@axes") {
        Some(letters) => (letters, true),
        None => (order, false),
    };
    let turns: Vec<(char, String)> = letters
        .chars()
        .enumerate()
        .map(|(letter, axis)| {
            let axis = axis.to_ascii_lowercase();
            let of = if is_by_axis { usize::from(axis as u8 - b'x') } else { letter };
            (axis, number(numbers[of]))
        })
        .collect();
    let in_order: Vec<&str> = turns.iter().map(|(_, angle)| angle.as_str()).collect();
    let in_order = in_order.join(", ");
    let is_fixed = letters.starts_with(|letter: char| letter.is_ascii_lowercase());
    // The first of several turns about fixed axes stands last, of those about moving axes first.
    let product = |factor: &dyn Fn(char, &str) -> String| {
        let mut factors: Vec<String> =
            turns.iter().map(|(axis, angle)| factor(*axis, angle)).collect();
        if is_fixed {
            factors.reverse();
        }
        factors.join(" * ")
    };
    let axes_code = format!("{}{}", if is_fixed { 's' } else { 'r' }, letters.to_ascii_lowercase());
    let tf2 = product(&|axis, angle| {
        let unit = ['x', 'y', 'z'].map(|other| if other == axis { "1" } else { "0" }).join(", ");
        format!("tf2::Quaternion(tf2::Vector3({unit}), {angle})")
    });
    let eigen = product(&|axis, angle| {
        format!("Eigen::AngleAxisd({angle}, Eigen::Vector3d::Unit{}())", axis.to_ascii_uppercase())
    });
    lines([
        ("SciPy", format!("Rotation.from_euler(\"{letters}\", [{in_order}])")),
        ("tf_transformations", format!("quaternion_from_euler({in_order}, axes=\"{axes_code}\")")),
        ("tf2 (C++)", format!("tf2::Quaternion q = {tf2};")),
        ("Eigen", format!("Eigen::Quaterniond q = {eigen};")),
        (
            "nalgebra",
            product(&|axis, angle| {
                format!("UnitQuaternion::from_axis_angle(&Vector3::{axis}_axis(), {angle})")
            }),
        ),
    ])
}

/// Lines that make `rotation` from a quaternion, its numbers in each library's order.
pub(super) fn of_quaternion(rotation: &Rotation) -> Vec<CodeLine> {
    let [x, y, z, w] = xyzw_from_rotation(rotation).map(number);
    lines([
        ("SciPy", format!("Rotation.from_quat([{x}, {y}, {z}, {w}])")),
        ("geometry_msgs", format!("Quaternion(x={x}, y={y}, z={z}, w={w})")),
        ("tf2 (C++)", format!("tf2::Quaternion q({x}, {y}, {z}, {w});")),
        ("Eigen", format!("Eigen::Quaterniond q({w}, {x}, {y}, {z});  // w, x, y, z")),
        (
            "nalgebra",
            format!(
                "UnitQuaternion::from_quaternion(Quaternion::new({w}, {x}, {y}, {z}))  // w, x, y, z"
            ),
        ),
    ])
}

fn lines<const N: usize>(lines: [(&'static str, String); N]) -> Vec<CodeLine> {
    lines.into_iter().map(|(library, line)| CodeLine { library, line }).collect()
}

/// A number to a billionth that every language takes for a float.
fn number(value: f64) -> String {
    format!("{:?}", (value * 1e9).round() / 1e9 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Vec3, angle_between, rotation_from_rotvec};

    fn line(lines: &[CodeLine], library: &str) -> String {
        lines.iter().find(|line| line.library == library).unwrap().line.clone()
    }

    /// What the line of nalgebra makes, told from its text.
    fn evaluated(line: &str) -> Rotation {
        let numbers = |text: &str| -> Vec<f64> {
            text.split(", ").map(|number| number.trim_end_matches(')').parse().unwrap()).collect()
        };
        if let Some(vector) = line.strip_prefix("UnitQuaternion::from_scaled_axis(Vector3::new(") {
            return rotation_from_rotvec(Vec3::from_vec(numbers(vector)));
        }
        line.split(" * ").fold(Rotation::identity(), |product, factor| {
            let rest = factor.strip_prefix("UnitQuaternion::from_axis_angle(&Vector3::").unwrap();
            let (axis, angle) = rest.split_once("_axis(), ").unwrap();
            let axis = Vec3::ith("xyz".find(axis).unwrap(), 1.0);
            product * rotation_from_rotvec(axis * numbers(angle)[0])
        })
    }

    #[test]
    fn the_lines_are_the_convention() {
        let numbers = [0.7, -0.4, 2.1];
        for &convention in Convention::all() {
            let lines = of_numbers(convention, numbers);
            let found = evaluated(&line(&lines, "nalgebra"));
            assert!(angle_between(&found, &convention.rotation(numbers)) < 1e-9, "{convention}");
        }
    }

    #[test]
    fn libraries_take_their_own_names_and_orders() {
        let rpy = of_numbers(Convention::RPY, [0.1, 0.2, 0.3]);
        assert_eq!(line(&rpy, "SciPy"), "Rotation.from_euler(\"xyz\", [0.1, 0.2, 0.3])");
        assert_eq!(
            line(&rpy, "tf_transformations"),
            "quaternion_from_euler(0.1, 0.2, 0.3, axes=\"sxyz\")"
        );
        assert_eq!(
            line(&rpy, "Eigen"),
            "Eigen::Quaterniond q = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()) * \
             Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()) * \
             Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX());"
        );
        let by_axis = of_numbers("euler:xzy@axes".parse().unwrap(), [0.1, 0.2, 0.3]);
        assert_eq!(
            line(&by_axis, "tf2 (C++)"),
            "tf2::Quaternion q = tf2::Quaternion(tf2::Vector3(0, 1, 0), 0.2) * \
             tf2::Quaternion(tf2::Vector3(0, 0, 1), 0.3) * tf2::Quaternion(tf2::Vector3(1, 0, 0), 0.1);"
        );
        assert_eq!(line(&by_axis, "SciPy"), "Rotation.from_euler(\"xzy\", [0.1, 0.3, 0.2])");
        let turned = of_quaternion(&Convention::RPY.rotation([0.0, 0.0, std::f64::consts::PI]));
        assert!(line(&turned, "Eigen").contains("(0.0, 0.0, 0.0, 1.0)"));
        assert!(line(&turned, "SciPy").contains("[0.0, 0.0, 1.0, 0.0]"));
    }
}
