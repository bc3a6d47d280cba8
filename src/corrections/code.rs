//! Lines of code that read numbers as what they are.

use crate::geometry::{Convention, QuaternionSlip};

/// One line each in the libraries that roboticists use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Lines {
    pub scipy: String,
    pub tf2: String,
    pub eigen: String,
    pub nalgebra: String,
}

impl Lines {
    fn new(scipy: &str, tf2: &str, eigen: &str, nalgebra: &str) -> Self {
        let [scipy, tf2, eigen, nalgebra] = [scipy, tf2, eigen, nalgebra].map(str::to_owned);
        Self { scipy, tf2, eigen, nalgebra }
    }

    /// Each library's name with its line.
    pub fn named(&self) -> [(&'static str, &str); 4] {
        [
            ("SciPy", &self.scipy),
            ("tf2 (C++)", &self.tf2),
            ("Eigen", &self.eigen),
            ("nalgebra", &self.nalgebra),
        ]
    }
}

/// The names of three numbers of a convention, in the order of the log.
pub(super) fn labels(convention: Convention) -> [&'static str; 3] {
    let name = convention.to_string();
    let by_axis = !name.starts_with("euler:") || name.ends_with("@axes");
    if by_axis { ["rx", "ry", "rz"] } else { ["a", "b", "c"] }
}

/// The rotation that three numbers of `convention` code, named as [`labels`] has them.
pub(super) fn of_numbers(convention: Convention) -> Lines {
    let name = convention.to_string();
    let Some(order) = name.strip_prefix("euler:") else {
        return Lines::new(
            "Rotation.from_rotvec([rx, ry, rz])",
            "tf2::Vector3 r(rx, ry, rz); tf2::Quaternion q = r.length() > 0 ? \
             tf2::Quaternion(r.normalized(), r.length()) : tf2::Quaternion::getIdentity();",
            "Eigen::Vector3d r(rx, ry, rz); \
             Eigen::Quaterniond q(Eigen::AngleAxisd(r.norm(), r.stableNormalized()));",
            "UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz))",
        );
    };
    let (letters, is_by_axis) = match order.strip_suffix("@axes") {
        Some(letters) => (letters, true),
        None => (order, false),
    };
    let labels = labels(convention);
    let turns = letters.chars().enumerate().map(|(letter, axis)| {
        let axis = axis.to_ascii_lowercase();
        let number = match is_by_axis {
            true => labels[usize::from(axis as u8 - b'x')],
            false => labels[letter],
        };
        (axis, number)
    });
    let mut product: Vec<(char, &str)> = turns.collect();
    let numbers: Vec<&str> = product.iter().map(|(_, number)| *number).collect();
    let numbers = numbers.join(", ");
    // The first of several turns about fixed axes stands last, of those about moving axes first.
    if letters.starts_with(|c: char| c.is_ascii_lowercase()) {
        product.reverse();
    }
    let times = |factor: &dyn Fn(char, &str) -> String| {
        let factors: Vec<String> =
            product.iter().map(|&(axis, label)| factor(axis, label)).collect();
        factors.join(" * ")
    };
    let tf2 = times(&|axis, number| {
        let unit = ['x', 'y', 'z'].map(|other| if other == axis { "1" } else { "0" }).join(", ");
        format!("tf2::Quaternion(tf2::Vector3({unit}), {number})")
    });
    let eigen = times(&|axis, number| {
        let axis = axis.to_ascii_uppercase();
        format!("Eigen::AngleAxisd({number}, Eigen::Vector3d::Unit{axis}())")
    });
    let nalgebra = times(&|axis, number| {
        format!("UnitQuaternion::from_axis_angle(&Vector3::{axis}_axis(), {number})")
    });
    Lines {
        scipy: format!("Rotation.from_euler(\"{letters}\", [{numbers}])"),
        tf2: format!("tf2::Quaternion q = {tf2};"),
        eigen: format!("Eigen::Quaterniond q = {eigen};"),
        nalgebra,
    }
}

/// The rotation of four numbers `n` in the order of the log.
pub(super) fn of_quaternion(slip: QuaternionSlip) -> Lines {
    let [x, y, z, w] = match slip {
        QuaternionSlip::WxyzReadAsXyzw => [1, 2, 3, 0],
        QuaternionSlip::XyzwReadAsWxyz => [0, 1, 2, 3],
    };
    Lines {
        scipy: format!("Rotation.from_quat([n[{x}], n[{y}], n[{z}], n[{w}]])"),
        tf2: format!("tf2::Quaternion q(n[{x}], n[{y}], n[{z}], n[{w}]);"),
        eigen: format!("Eigen::Quaterniond q(n[{w}], n[{x}], n[{y}], n[{z}]);  // w, x, y, z"),
        nalgebra: format!(
            "UnitQuaternion::from_quaternion(Quaternion::new(n[{w}], n[{x}], n[{y}], n[{z}]))  // w, x, y, z"
        ),
    }
}

/// The inverse of a `rotation`, its position left as it is.
pub(super) fn inverse_rotation() -> Lines {
    Lines::new(
        "rotation.inv()",
        "rotation.inverse()  // tf2::Quaternion",
        "rotation.inverse()  // Eigen::Quaterniond; of a matrix .transpose()",
        "rotation.inverse()",
    )
}

/// The inverse of a `pose` as a whole.
pub(super) fn inverse_pose() -> Lines {
    Lines::new(
        "RigidTransform.from_components(xyz, rotation).inv()  # or rotation.inv(), -rotation.inv().apply(xyz)",
        "pose.inverse()  // tf2::Transform",
        "pose.inverse()  // Eigen::Isometry3d",
        "pose.inverse()  // Isometry3<f64>",
    )
}

/// Angles times a factor of π/180, or of its inverse.
pub(super) fn angles(to_radians: bool) -> Lines {
    match to_radians {
        true => Lines::new(
            "numpy.deg2rad(angles)",
            "angle * M_PI / 180.0",
            "angles * (M_PI / 180.0)",
            "angle.to_radians()",
        ),
        false => Lines::new(
            "numpy.rad2deg(angles)",
            "angle * 180.0 / M_PI",
            "angles * (180.0 / M_PI)",
            "angle.to_degrees()",
        ),
    }
}

/// Positions times a factor.
pub(super) fn lengths(factor: f64) -> Lines {
    let times = format!("xyz * {factor:?}");
    Lines::new(&times, &times, &times, &times)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Rotation, Vec3, angle_between, rotation_from_rotvec};

    /// What the line of nalgebra makes of numbers, told from its text.
    fn evaluated(line: &str, labels: [&str; 3], numbers: [f64; 3]) -> Rotation {
        let number = |label: &str| numbers[labels.iter().position(|l| *l == label).unwrap()];
        if line.starts_with("UnitQuaternion::from_scaled_axis") {
            return Rotation::from_scaled_axis(Vec3::from(numbers));
        }
        line.split(" * ").fold(Rotation::identity(), |product, factor| {
            let (axis, label) = factor
                .strip_prefix("UnitQuaternion::from_axis_angle(&Vector3::")
                .and_then(|rest| rest.strip_suffix(')'))
                .and_then(|rest| rest.split_once("_axis(), "))
                .unwrap();
            let axis = Vec3::ith("xyz".find(axis).unwrap(), 1.0);
            product * rotation_from_rotvec(axis * number(label))
        })
    }

    #[test]
    fn every_line_of_nalgebra_is_the_convention() {
        let numbers = [0.7, -0.4, 2.1];
        for &convention in Convention::all() {
            let Lines { nalgebra, .. } = of_numbers(convention);
            let found = evaluated(&nalgebra, labels(convention), numbers);
            let expected = convention.rotation(numbers);
            assert!(angle_between(&found, &expected) < 1e-12, "{convention}: {nalgebra}");
        }
    }

    #[test]
    fn the_lines_agree_with_each_other() {
        for (name, scipy, product) in [
            ("euler:xyz", "\"xyz\", [a, b, c]", "zc yb xa"),
            ("euler:ZYX", "\"ZYX\", [a, b, c]", "za yb xc"),
            ("euler:xzy@axes", "\"xzy\", [rx, rz, ry]", "yry zrz xrx"),
            ("euler:ZYZ", "\"ZYZ\", [a, b, c]", "za yb zc"),
        ] {
            let lines = of_numbers(name.parse().unwrap());
            assert_eq!(lines.scipy, format!("Rotation.from_euler({scipy})"));
            let factors = |line: &str, axis: fn(&str) -> char, label: fn(&str) -> &str| {
                let body = line.split_once("= ").map_or(line, |(_, body)| body);
                let body = body.trim_end_matches(';');
                let factors =
                    body.split(" * ").map(|factor| format!("{}{}", axis(factor), label(factor)));
                factors.collect::<Vec<_>>().join(" ")
            };
            let eigen = factors(
                &lines.eigen,
                |factor| {
                    factor
                        .split_once("Unit")
                        .unwrap()
                        .1
                        .chars()
                        .next()
                        .unwrap()
                        .to_ascii_lowercase()
                },
                |factor| factor.split_once('(').unwrap().1.split_once(',').unwrap().0,
            );
            assert_eq!(eigen, product, "{}", lines.eigen);
            let tf2 = factors(
                &lines.tf2,
                |factor| match factor.split_once("Vector3(").unwrap().1.split_once(')').unwrap().0 {
                    "1, 0, 0" => 'x',
                    "0, 1, 0" => 'y',
                    _ => 'z',
                },
                |factor| factor.rsplit_once(", ").unwrap().1.trim_end_matches(')'),
            );
            assert_eq!(tf2, product, "{}", lines.tf2);
        }
    }

    #[test]
    fn the_scalar_part_is_where_each_library_wants_it() {
        let lines = of_quaternion(QuaternionSlip::WxyzReadAsXyzw);
        assert!(lines.scipy.contains("[n[1], n[2], n[3], n[0]]"), "{}", lines.scipy);
        assert!(lines.eigen.contains("(n[0], n[1], n[2], n[3])"), "{}", lines.eigen);
        let lines = of_quaternion(QuaternionSlip::XyzwReadAsWxyz);
        assert!(lines.tf2.contains("(n[0], n[1], n[2], n[3])"), "{}", lines.tf2);
        assert!(lines.nalgebra.contains("(n[3], n[0], n[1], n[2])"), "{}", lines.nalgebra);
    }
}
