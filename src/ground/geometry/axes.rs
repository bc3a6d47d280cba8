//! Axis conventions: exchanged, reversed or mirrored coordinate axes.

use super::{Pose, Rotation, Vec3, rotation_from_matrix_rows};
use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

/// Directions of x, y and z, as signed axes of the standard frame (REP 103: x forward, y left, z up).
///
/// 24 of the 48 conventions are left-handed: no rotation maps a right-handed frame to them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Axes {
    /// Parallel standard axis, 0 to 2, all different.
    along: [usize; 3],
    reversed: [bool; 3],
}

const DIRECTION_NAMES: [[&str; 2]; 3] = [["forward", "back"], ["left", "right"], ["up", "down"]];

impl Axes {
    /// REP 103.
    pub const STANDARD: Self = Self { along: [0, 1, 2], reversed: [false; 3] };

    /// Unity: x right, y up, z forward, left-handed.
    pub const UNITY: Self = Self { along: [1, 2, 0], reversed: [true, false, false] };

    /// Optical frame of a camera (REP 103): x right, y down, z forward.
    pub const OPTICAL: Self = Self { along: [1, 2, 0], reversed: [true, true, false] };

    /// All 48, fewest changed axes first.
    pub fn all() -> &'static [Self] {
        static ALL: LazyLock<Vec<Axes>> = LazyLock::new(|| {
            let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
            let signs = (0..8).map(|bits| [0, 1, 2].map(|axis| bits >> axis & 1 == 1));
            let mut all: Vec<Axes> = orders
                .into_iter()
                .flat_map(|along| signs.clone().map(move |reversed| Axes { along, reversed }))
                .collect();
            all.sort_by_key(|axes| (0..3).filter(|&axis| !axes.is_in_place(axis)).count());
            all
        });
        &ALL
    }

    fn is_in_place(self, axis: usize) -> bool {
        self.along[axis] == axis && !self.reversed[axis]
    }

    /// Whether they are left-handed.
    pub fn are_left_handed(self) -> bool {
        let [a, b, c] = self.along;
        let is_odd_permutation = (a > b) ^ (a > c) ^ (b > c);
        self.reversed.iter().fold(is_odd_permutation, |is_odd, reversed| is_odd ^ reversed)
    }

    /// Whether they are permuted, not only reversed.
    pub fn are_exchanged(self) -> bool {
        self.along != Self::STANDARD.along
    }

    /// Converts a vector to these axes.
    pub fn convert_from_standard(self, standard: Vec3) -> Vec3 {
        Vec3::from_fn(|axis, _| {
            let part = standard[self.along[axis]];
            if self.reversed[axis] { -part } else { part }
        })
    }

    /// Converts a vector from these axes.
    pub fn to_standard(self, in_own_axes: Vec3) -> Vec3 {
        let mut standard = Vec3::zeros();
        for axis in 0..3 {
            standard[self.along[axis]] =
                if self.reversed[axis] { -in_own_axes[axis] } else { in_own_axes[axis] };
        }
        standard
    }

    /// Rotation Q such that `Q·R·Q⁻¹` expresses a rotation R in these axes. Exists for left-handed axes,
    /// because reversing all axes keeps a rotation.
    pub fn conjugator(self) -> Rotation {
        let sign = if self.are_left_handed() { -1.0 } else { 1.0 };
        let columns =
            [Vec3::x(), Vec3::y(), Vec3::z()].map(|unit| self.convert_from_standard(unit) * sign);
        let rows = [0, 1, 2].map(|row| columns.map(|column| column[row]));
        rotation_from_matrix_rows(rows).map_or_else(Rotation::identity, |(rotation, _)| rotation)
    }

    /// Converts back to standard axes.
    pub fn inverse(self) -> Self {
        let mut inverse = Self::STANDARD;
        for axis in 0..3 {
            inverse.along[self.along[axis]] = axis;
            inverse.reversed[self.along[axis]] = self.reversed[axis];
        }
        inverse
    }

    /// Converts a pose whose world and body both use standard axes.
    pub fn pose_from_standard(self, standard: &Pose) -> Pose {
        let turn = self.conjugator();
        let xyz = self.convert_from_standard(standard.translation.vector);
        Pose::from_parts(xyz.into(), turn * standard.rotation * turn.inverse())
    }

    /// Standard x, y and z in terms of logged components, such as `[-y, z, x]`; of a position or of a
    /// quaternion's vector part.
    pub fn standard_names(self, is_vector_part: bool) -> [String; 3] {
        // The sign of a pseudovector changes with the handedness.
        let turned = is_vector_part && self.are_left_handed();
        let mut names: [String; 3] = Default::default();
        for axis in 0..3 {
            let sign = if self.reversed[axis] ^ turned { "-" } else { "" };
            names[self.along[axis]] = format!("{sign}{}", ["x", "y", "z"][axis]);
        }
        names
    }
}

impl fmt::Display for Axes {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = [0, 1, 2]
            .map(|axis| DIRECTION_NAMES[self.along[axis]][usize::from(self.reversed[axis])]);
        write!(out, "x {}, y {}, z {}", words[0], words[1], words[2])?;
        if self.are_left_handed() { write!(out, " (left-handed)") } else { Ok(()) }
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::all().iter().find(|axes| axes.to_string() == text);
        found.copied().ok_or_else(|| {
            format!("`{text}` is not an axis convention: write axes as in `{}`", Self::UNITY)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{angle_between, rotation_from_rotvec, rotvec_from_rotation};

    #[test]
    fn half_of_the_48_axis_conventions_are_left_handed() {
        let all = Axes::all();
        assert_eq!((all.len(), all[0]), (48, Axes::STANDARD));
        assert_eq!(all.iter().filter(|axes| axes.are_left_handed()).count(), 24);
        let v = Vec3::new(1.0, -2.0, 3.0);
        for axes in all {
            assert_eq!(axes.to_standard(axes.convert_from_standard(v)), v);
            assert_eq!(axes.inverse().convert_from_standard(axes.convert_from_standard(v)), v);
            assert_eq!(axes.to_string().parse(), Ok(*axes));
        }
    }

    #[test]
    fn unity_has_x_right_y_up_and_z_forward() {
        assert_eq!(Axes::UNITY.to_string(), "x right, y up, z forward (left-handed)");
        assert_eq!(
            Axes::UNITY.convert_from_standard(Vec3::new(1.0, 2.0, 3.0)),
            Vec3::new(-2.0, 3.0, 1.0)
        );
        assert_eq!(Axes::UNITY.standard_names(false), ["z", "-x", "y"]);
        assert_eq!(Axes::UNITY.standard_names(true), ["-z", "x", "-y"]);
    }

    #[test]
    fn a_rotation_is_the_same_in_any_axes() {
        let rotation = rotation_from_rotvec(Vec3::new(0.4, -0.8, 1.1));
        let v = Vec3::new(0.3, 0.5, -0.7);
        for axes in Axes::all() {
            let conjugator = axes.conjugator();
            let in_own_axes = conjugator * rotation * conjugator.inverse();
            assert!(
                (in_own_axes * axes.convert_from_standard(v)
                    - axes.convert_from_standard(rotation * v))
                .norm()
                    < 1e-12,
                "{axes}"
            );
            let names = axes.standard_names(true);
            let rotvec = rotvec_from_rotation(&in_own_axes);
            let named = |name: &String| {
                let part = rotvec[["x", "y", "z"].iter().position(|n| name.ends_with(n)).unwrap()];
                if name.starts_with('-') { -part } else { part }
            };
            let undone = rotation_from_rotvec(Vec3::from_iterator(names.iter().map(named)));
            assert!(angle_between(&undone, &rotation) < 1e-12, "{axes}");
        }
    }
}
