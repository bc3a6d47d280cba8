//! Source code that constructs a rotation.

use std::fmt::Display;

use super::Convention;

/// Code for one library.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CodeLine {
    /// Library.
    pub library: &'static str,
    /// Code.
    pub line: String,
}

/// Constructs the rotation from `numbers` (rad; literals or names). Libraries name Euler orders
/// differently, so lines without order letters multiply single turns.
pub fn code_of_numbers(convention: Convention, numbers: [impl Display; 3]) -> Vec<CodeLine> {
    let Convention::Euler(order) = convention else {
        let [a, b, c] = numbers;
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
    let turns = order.lettered().map(|(axis, number)| (axis, numbers[number].to_string()));
    let letters: String = turns.iter().map(|(axis, _)| *axis).collect();
    let in_order = turns.each_ref().map(|(_, angle)| angle.as_str()).join(", ");
    let is_fixed = order.is_about_fixed_axes();
    // About fixed axes the first turn is the last factor.
    let product = |factor: &dyn Fn(char, &str) -> String| {
        let mut factors = turns.each_ref().map(|(axis, angle)| factor(*axis, angle));
        if is_fixed {
            factors.reverse();
        }
        factors.join(" * ")
    };
    let (scipy, axes_code) = match is_fixed {
        true => (letters.clone(), format!("s{letters}")),
        false => (letters.to_ascii_uppercase(), format!("r{letters}")),
    };
    let tf2 = product(&|axis, angle| {
        let unit = ['x', 'y', 'z'].map(|other| if other == axis { "1" } else { "0" }).join(", ");
        format!("tf2::Quaternion(tf2::Vector3({unit}), {angle})")
    });
    let eigen = product(&|axis, angle| {
        format!("Eigen::AngleAxisd({angle}, Eigen::Vector3d::Unit{}())", axis.to_ascii_uppercase())
    });
    lines([
        ("SciPy", format!("Rotation.from_euler(\"{scipy}\", [{in_order}])")),
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

/// Constructs the rotation of a quaternion (literals or names), in each library's order.
pub fn code_of_quaternion(xyzw: [impl Display; 4]) -> Vec<CodeLine> {
    let [x, y, z, w] = xyzw;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Rotation, Vec3, angle_between, rotation_from_rotvec};

    fn line(lines: &[CodeLine], library: &str) -> String {
        lines.iter().find(|line| line.library == library).unwrap().line.clone()
    }

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
    fn code_lines_evaluate_to_the_convention() {
        let numbers = [0.7, -0.4, 2.1];
        for &convention in Convention::all() {
            let lines = code_of_numbers(convention, numbers);
            let found = evaluated(&line(&lines, "nalgebra"));
            assert!(angle_between(&found, &convention.rotation(numbers)) < 1e-9, "{convention}");
        }
    }

    #[test]
    fn libraries_use_their_own_names_and_orders() {
        let rpy = code_of_numbers(Convention::RPY, [0.1, 0.2, 0.3]);
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
        let by_axis = code_of_numbers("euler:xzy@axes".parse().unwrap(), [0.1, 0.2, 0.3]);
        assert_eq!(
            line(&by_axis, "tf2 (C++)"),
            "tf2::Quaternion q = tf2::Quaternion(tf2::Vector3(0, 1, 0), 0.2) * \
             tf2::Quaternion(tf2::Vector3(0, 0, 1), 0.3) * tf2::Quaternion(tf2::Vector3(1, 0, 0), 0.1);"
        );
        assert_eq!(line(&by_axis, "SciPy"), "Rotation.from_euler(\"xzy\", [0.1, 0.3, 0.2])");
        let moving = code_of_numbers("euler:ZYX".parse().unwrap(), ["a", "b", "c"]);
        assert_eq!(line(&moving, "SciPy"), "Rotation.from_euler(\"ZYX\", [a, b, c])");
        assert_eq!(
            line(&moving, "Eigen"),
            "Eigen::Quaterniond q = Eigen::AngleAxisd(a, Eigen::Vector3d::UnitZ()) * \
             Eigen::AngleAxisd(b, Eigen::Vector3d::UnitY()) * \
             Eigen::AngleAxisd(c, Eigen::Vector3d::UnitX());"
        );
        let turned = code_of_quaternion(["x", "y", "z", "w"]);
        assert!(line(&turned, "Eigen").contains("(w, x, y, z)"));
        assert!(line(&turned, "SciPy").contains("[x, y, z, w]"));
    }
}
