//! Lines of code that decode numbers correctly.

use crate::geometry::{
    CodeLine, Convention, QuaternionOrderError, code_of_numbers, code_of_quaternion,
};

/// One line per entry of [`LIBRARIES`].
pub(super) type CodeLines = Vec<CodeLine>;

const LIBRARIES: [&str; 4] = ["SciPy", "tf2 (C++)", "Eigen", "nalgebra"];

fn lines(by_library: [&str; 4]) -> CodeLines {
    let line = |(library, line): (_, &str)| CodeLine { library, line: line.to_owned() };
    LIBRARIES.into_iter().zip(by_library).map(line).collect()
}

/// Variables for the numbers in logged order.
pub(super) fn variable_names(convention: Convention) -> [&'static str; 3] {
    match convention.is_by_axis() {
        true => ["rx", "ry", "rz"],
        false => ["a", "b", "c"],
    }
}

pub(super) fn decode_numbers(convention: Convention) -> CodeLines {
    retain_libraries(code_of_numbers(convention, variable_names(convention)))
}

/// From four numbers `n` in logged order.
pub(super) fn decode_quaternion(slip: QuaternionOrderError) -> CodeLines {
    let xyzw = match slip {
        QuaternionOrderError::WxyzReadAsXyzw => [1, 2, 3, 0],
        QuaternionOrderError::XyzwReadAsWxyz => [0, 1, 2, 3],
    };
    retain_libraries(code_of_quaternion(xyzw.map(|at| format!("n[{at}]"))))
}

fn retain_libraries(mut lines: CodeLines) -> CodeLines {
    lines.retain(|line| LIBRARIES.contains(&line.library));
    lines
}

pub(super) fn invert_rotation() -> CodeLines {
    lines([
        "rotation.inv()",
        "rotation.inverse()  // tf2::Quaternion",
        "rotation.inverse()  // Eigen::Quaterniond; for a matrix .transpose()",
        "rotation.inverse()",
    ])
}

pub(super) fn invert_pose() -> CodeLines {
    lines([
        "RigidTransform.from_components(xyz, rotation).inv()  # or rotation.inv(), -rotation.inv().apply(xyz)",
        "pose.inverse()  // tf2::Transform",
        "pose.inverse()  // Eigen::Isometry3d",
        "pose.inverse()  // Isometry3<f64>",
    ])
}

/// Multiplies by π/180 or its inverse.
pub(super) fn convert_angles(to_radians: bool) -> CodeLines {
    match to_radians {
        true => lines([
            "numpy.deg2rad(angles)", "angle * M_PI / 180.0", "angles * (M_PI / 180.0)",
            "angle.to_radians()",
        ]),
        false => lines([
            "numpy.rad2deg(angles)", "angle * 180.0 / M_PI", "angles * (180.0 / M_PI)",
            "angle.to_degrees()",
        ]),
    }
}

pub(super) fn scale_lengths(factor: f64) -> CodeLines {
    let times = format!("xyz * {factor:?}");
    lines([&times; 4])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scalar_part_is_where_each_library_expects_it() {
        let of =
            |slip| decode_quaternion(slip).into_iter().map(|line| line.line).collect::<Vec<_>>();
        let [scipy, _, eigen, _] = &of(QuaternionOrderError::WxyzReadAsXyzw)[..] else { panic!() };
        assert!(scipy.contains("[n[1], n[2], n[3], n[0]]"), "{scipy}");
        assert!(eigen.contains("(n[0], n[1], n[2], n[3])"), "{eigen}");
        let [_, tf2, _, nalgebra] = &of(QuaternionOrderError::XyzwReadAsWxyz)[..] else { panic!() };
        assert!(tf2.contains("(n[0], n[1], n[2], n[3])"), "{tf2}");
        assert!(nalgebra.contains("(n[3], n[0], n[1], n[2])"), "{nalgebra}");
    }

    #[test]
    fn numbers_are_named_by_rotation_or_axis() {
        let scipy = |name: &str| decode_numbers(name.parse().unwrap())[0].line.clone();
        assert_eq!(scipy("euler:ZYZ"), "Rotation.from_euler(\"ZYZ\", [a, b, c])");
        assert_eq!(scipy("euler:xzy@axes"), "Rotation.from_euler(\"xzy\", [rx, rz, ry])");
        assert_eq!(scipy("rotvec"), "Rotation.from_rotvec([rx, ry, rz])");
    }
}
