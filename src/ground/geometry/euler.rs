//! Three turns about coordinate axes: 24 Euler orders, and four whose numbers are labelled by axis.

use super::Rotation;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

/// Distance of the middle angle from gimbal lock, rad, below which only the sum or difference of the outer
/// angles is used. SciPy's value.
const LOCK_RAD: f64 = 1e-7;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Axis {
    X,
    Y,
    Z,
}

/// Axes of the second and third turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Frame {
    /// Extrinsic; lower case in SciPy.
    Fixed,
    /// Intrinsic; upper case in SciPy.
    Moving,
}

/// Order of three turns and assignment of numbers to turns. Equal maps are equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EulerOrder {
    axes: [Axis; 3],
    frame: Frame,
    /// Numbers are (rx, ry, rz). Only if no plain order is the same map; `frame` is then `Fixed`.
    labelled_by_axis: bool,
}

#[derive(Clone, Copy)]
struct Turn {
    axis: Axis,
    /// Index of its angle.
    number: usize,
}

impl EulerOrder {
    /// Numbers in the order of the turns; adjacent axes differ.
    pub(super) const fn plain(axes: [Axis; 3], frame: Frame) -> Self {
        Self { axes, frame, labelled_by_axis: false }
    }

    /// Three different axes, numbers (rx, ry, rz). An order about moving axes equals the reverse order
    /// about fixed axes; two of the six have a plain name.
    pub(super) const fn labelled(axes: [Axis; 3], frame: Frame) -> Self {
        let [a, b, c] = axes;
        let fixed = match frame {
            Frame::Fixed => [a, b, c],
            Frame::Moving => [c, b, a],
        };
        match fixed {
            [Axis::X, Axis::Y, Axis::Z] => Self::plain(fixed, Frame::Fixed),
            [Axis::Z, Axis::Y, Axis::X] => Self::plain([Axis::X, Axis::Y, Axis::Z], Frame::Moving),
            axes => Self { axes, frame: Frame::Fixed, labelled_by_axis: true },
        }
    }

    pub(super) fn is_labelled_by_axis(self) -> bool {
        self.labelled_by_axis
    }

    fn is_proper(self) -> bool {
        self.axes[0] == self.axes[2]
    }

    fn turns(self) -> [Turn; 3] {
        let turn = |letter: usize| {
            let axis = self.axes[letter];
            Turn { axis, number: if self.labelled_by_axis { axis as usize } else { letter } }
        };
        match self.frame {
            Frame::Fixed => [turn(0), turn(1), turn(2)],
            Frame::Moving => [turn(2), turn(1), turn(0)],
        }
    }

    pub(super) fn is_about_fixed_axes(self) -> bool {
        self.frame == Frame::Fixed
    }

    /// Axis letters in the order of the name, with the index of the angle.
    pub(super) fn lettered(self) -> [(char, usize); 3] {
        let mut turns = self.turns();
        if self.frame == Frame::Moving {
            turns.reverse();
        }
        turns.map(|turn| (['x', 'y', 'z'][turn.axis as usize], turn.number))
    }

    pub(super) fn rotation(self, numbers: [f64; 3]) -> Rotation {
        self.rotation_from_half_angles(numbers.map(Phase::of_half))
    }

    /// Both triples, rad, in (−π, π]. The principal one is first; its middle angle is in [−π/2, π/2], or in
    /// [0, π] for a proper order.
    pub(super) fn solutions(self, rotation: &Rotation) -> [[f64; 3]; 2] {
        self.half_angle_solutions(rotation).map(|halves| halves.map(Phase::doubled))
    }

    /// Distance of `numbers` from gimbal lock, rad, in [0, π/2].
    pub(super) fn gimbal_margin(self, numbers: [f64; 3]) -> f64 {
        let [_, middle, _] = self.turns();
        let past_half_turn = numbers[middle.number].rem_euclid(PI);
        if self.is_proper() {
            past_half_turn.min(PI - past_half_turn)
        } else {
            (past_half_turn - FRAC_PI_2).abs()
        }
    }

    pub(super) fn rotation_from_half_angles(self, halves: [Phase; 3]) -> Rotation {
        let [first, second, third] = self.turns().map(|turn| {
            let Phase { cos, sin } = halves[turn.number];
            let mut axis = Vector3::zeros();
            axis[turn.axis as usize] = sin;
            Quaternion::from_parts(cos, axis)
        });
        UnitQuaternion::new_unchecked(third * second * first)
    }

    /// [`solutions`](Self::solutions) as phases of half angles, with square roots only.
    ///
    /// After Bernardes and Viollet, "Quaternion to Euler angles conversion: a direct, general and
    /// computationally efficient method" (PLoS ONE 17(11), 2022), as in SciPy. In gimbal lock (within 1e-7
    /// rad) the last letter's number is zero, in the other solution π.
    pub(super) fn half_angle_solutions(self, rotation: &Rotation) -> [[Phase; 3]; 2] {
        let turns = self.turns();
        let proper = self.is_proper();
        let [i, j, mut k] = turns.map(|turn| turn.axis as usize);
        if proper {
            k = 3 - i - j;
        }
        let sign = if (i + 1) % 3 == j { 1.0 } else { -1.0 };
        // (a, b) points along half the sum of the outer angles, with the cosine of half the middle one as
        // length; (c, d) along half their difference, with the sine. With three axes the middle angle is
        // plus π/2, the third times `sign`.
        let (w, v) = (rotation.w, rotation.imag());
        let [a, b, c, d] = if proper {
            [w, v[i], v[j], sign * v[k]]
        } else {
            [w - v[j], v[i] + sign * v[k], v[j] + w, sign * v[k] - v[i]]
        };

        let (cos, sin) = (length(a, b), length(c, d));
        let tiny = 0.5 * LOCK_RAD * length(cos, sin);
        // In lock, the other one is chosen for a zero angle of the last letter.
        let partner = |known: Phase| match self.frame {
            Frame::Fixed => known.negated(),
            Frame::Moving => known,
        };
        let (half_sum, half_difference) = if sin <= tiny {
            let half_sum = Phase::towards(a, b);
            (half_sum, partner(half_sum))
        } else if cos <= tiny {
            let half_difference = Phase::towards(c, d);
            (partner(half_difference), half_difference)
        } else {
            (Phase::towards(a, b), Phase::towards(c, d))
        };

        let first = half_sum.plus(half_difference.negated()).halved();
        let third = half_sum.plus(half_difference).halved();
        let [second, third] = if proper {
            [Phase::towards(cos, sin), third]
        } else {
            let third = if sign > 0.0 { third } else { third.negated() };
            [Phase::towards(cos + sin, sin - cos), third]
        };
        let other_second = if proper { second.negated() } else { second.complement() };

        let in_order_of_numbers = |angles: [Phase; 3]| {
            let mut halves = angles;
            for (turn, angle) in turns.into_iter().zip(angles) {
                halves[turn.number] = angle;
            }
            halves
        };
        [
            in_order_of_numbers([first, second, third]),
            in_order_of_numbers([first.quarter_on(), other_second, third.quarter_on()]),
        ]
    }
}

impl fmt::Display for EulerOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for axis in self.axes {
            f.write_str(match (axis, self.frame) {
                (Axis::X, Frame::Fixed) => "x",
                (Axis::Y, Frame::Fixed) => "y",
                (Axis::Z, Frame::Fixed) => "z",
                (Axis::X, Frame::Moving) => "X",
                (Axis::Y, Frame::Moving) => "Y",
                (Axis::Z, Frame::Moving) => "Z",
            })?;
        }
        f.write_str(if self.labelled_by_axis { "@axes" } else { "" })
    }
}

/// Point on the unit circle: half of an angle. Opposite phases are equivalent, as a whole turn changes the
/// sign of the quaternion.
#[derive(Clone, Copy)]
pub(super) struct Phase {
    cos: f64,
    sin: f64,
}

impl Phase {
    fn of_half(angle: f64) -> Self {
        let (sin, cos) = (0.5 * angle).sin_cos();
        Self { cos, sin }
    }

    /// Direction of (x, y), not both zero.
    fn towards(x: f64, y: f64) -> Self {
        let length = length(x, y);
        Self { cos: x / length, sin: y / length }
    }

    /// Twice this phase, rad, in (−π, π].
    fn doubled(self) -> f64 {
        let flip = self.cos < 0.0 || (self.cos == 0.0 && self.sin < 0.0);
        let (cos, sin) = if flip { (-self.cos, -self.sin) } else { (self.cos, self.sin) };
        // Adding zero avoids −0 in reports.
        2.0 * sin.atan2(cos) + 0.0
    }

    /// Half of this phase, or its opposite.
    fn halved(self) -> Self {
        // Both are bisectors; each is accurate where the other loses digits.
        if self.cos > 0.0 {
            Self::towards(1.0 + self.cos, self.sin)
        } else {
            Self::towards(self.sin, 1.0 - self.cos)
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            cos: self.cos * other.cos - self.sin * other.sin,
            sin: self.sin * other.cos + self.cos * other.sin,
        }
    }

    fn negated(self) -> Self {
        Self { sin: -self.sin, ..self }
    }

    fn complement(self) -> Self {
        Self { cos: self.sin, sin: self.cos }
    }

    fn quarter_on(self) -> Self {
        Self { cos: -self.sin, sin: self.cos }
    }
}

/// Without scaling, for small components.
fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}
