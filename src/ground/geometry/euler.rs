//! Rotations as three turns about coordinate axes: 24 Euler orders, and four whose numbers are labelled by
//! axis.

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

/// Reference of the axes of the second and third turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Frame {
    /// Fixed axes (extrinsic; lower case in SciPy).
    Fixed,
    /// Axes moved by the earlier turns (intrinsic; upper case in SciPy).
    Moving,
}

/// Order of three turns about coordinate axes, with the assignment of numbers to turns.
///
/// Two orders are equal exactly if they are the same map from numbers to rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct EulerOrder {
    axes: [Axis; 3],
    frame: Frame,
    /// The numbers are (rx, ry, rz) regardless of the order of the turns. Only if no plain order is the
    /// same map; `frame` is then `Fixed`.
    labelled_by_axis: bool,
}

#[derive(Clone, Copy)]
struct Turn {
    axis: Axis,
    /// Index of its angle in the three numbers.
    number: usize,
}

impl EulerOrder {
    /// Turns about `axes`, with the numbers in the order of the turns; adjacent axes differ.
    pub(super) const fn plain(axes: [Axis; 3], frame: Frame) -> Self {
        Self { axes, frame, labelled_by_axis: false }
    }

    /// Turns about three different `axes`, with the numbers (rx, ry, rz).
    ///
    /// An order about moving axes equals the reverse order about fixed axes. Two of the six orders have a
    /// plain name.
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

    /// Whether the numbers are labelled by axis rather than by turn.
    pub(super) fn is_labelled_by_axis(self) -> bool {
        self.labelled_by_axis
    }

    /// Whether the first and third turn share an axis (a proper Euler order, such as z-y-z).
    fn is_proper(self) -> bool {
        self.axes[0] == self.axes[2]
    }

    /// The turns in the order of execution about fixed axes.
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

    /// Whether the turns are about fixed axes.
    pub(super) fn is_about_fixed_axes(self) -> bool {
        self.frame == Frame::Fixed
    }

    /// The turns in the order of the name: the axis (`x`, `y` or `z`), and the index of its angle in the
    /// three numbers.
    pub(super) fn lettered(self) -> [(char, usize); 3] {
        let mut turns = self.turns();
        if self.frame == Frame::Moving {
            turns.reverse();
        }
        turns.map(|turn| (['x', 'y', 'z'][turn.axis as usize], turn.number))
    }

    /// Converts `numbers` (rad) to a rotation.
    pub(super) fn rotation(self, numbers: [f64; 3]) -> Rotation {
        self.rotation_from_half_angles(numbers.map(Phase::of_half))
    }

    /// Both triples, rad, each angle in (−π, π], that represent `rotation`. The principal one is first; its
    /// middle angle is in [−π/2, π/2], or in [0, π] for a proper order.
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

    /// Converts the phases of half of each number to a rotation.
    pub(super) fn rotation_from_half_angles(self, halves: [Phase; 3]) -> Rotation {
        let [first, second, third] = self.turns().map(|turn| {
            let Phase { cos, sin } = halves[turn.number];
            let mut axis = Vector3::zeros();
            axis[turn.axis as usize] = sin;
            Quaternion::from_parts(cos, axis)
        });
        UnitQuaternion::new_unchecked(third * second * first)
    }

    /// [`solutions`](Self::solutions) as the phases of half of each number. Needs only square roots, no
    /// trigonometry.
    ///
    /// After Bernardes and Viollet, "Quaternion to Euler angles conversion: a direct, general and
    /// computationally efficient method" (PLoS ONE 17(11), 2022), as in SciPy. In gimbal lock (within 1e-7
    /// rad) the number of the last letter is zero, as in SciPy; in the other solution it is π.
    pub(super) fn half_angle_solutions(self, rotation: &Rotation) -> [[Phase; 3]; 2] {
        let turns = self.turns();
        let proper = self.is_proper();
        let [i, j, mut k] = turns.map(|turn| turn.axis as usize);
        if proper {
            k = 3 - i - j;
        }
        let sign = if (i + 1) % 3 == j { 1.0 } else { -1.0 };
        // (a, b) points along half the sum of the outer angles; its length is the cosine of half the middle
        // one. (c, d) points along half their difference; its length is the sine. With three axes this
        // applies to the middle angle plus π/2, and to the third one times `sign`.
        let (w, v) = (rotation.w, rotation.imag());
        let [a, b, c, d] = if proper {
            [w, v[i], v[j], sign * v[k]]
        } else {
            [w - v[j], v[i] + sign * v[k], v[j] + w, sign * v[k] - v[i]]
        };

        let (cos, sin) = (length(a, b), length(c, d));
        let tiny = 0.5 * LOCK_RAD * length(cos, sin);
        // In lock only one of them is determined; the other is chosen for a zero angle of the last letter.
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

/// Point on the unit circle.
///
/// Conversions between orders use the phase of half of each angle. A phase and its opposite are equivalent:
/// a whole turn changes the sign of the quaternion.
#[derive(Clone, Copy)]
pub(super) struct Phase {
    cos: f64,
    sin: f64,
}

impl Phase {
    /// The phase of half of `angle`, rad.
    fn of_half(angle: f64) -> Self {
        let (sin, cos) = (0.5 * angle).sin_cos();
        Self { cos, sin }
    }

    /// The phase of the direction (x, y), not both zero.
    fn towards(x: f64, y: f64) -> Self {
        let length = length(x, y);
        Self { cos: x / length, sin: y / length }
    }

    /// Twice this phase as an angle, rad, in (−π, π].
    fn doubled(self) -> f64 {
        let flip = self.cos < 0.0 || (self.cos == 0.0 && self.sin < 0.0);
        let (cos, sin) = if flip { (-self.cos, -self.sin) } else { (self.cos, self.sin) };
        // Adding zero avoids −0 in reports.
        2.0 * sin.atan2(cos) + 0.0
    }

    /// Half of this phase, or its opposite.
    fn halved(self) -> Self {
        // Both expressions give the bisector; each is accurate where the other loses digits.
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

    /// π/2 minus this phase.
    fn complement(self) -> Self {
        Self { cos: self.sin, sin: self.cos }
    }

    /// This phase plus π/2.
    fn quarter_on(self) -> Self {
        Self { cos: -self.sin, sin: self.cos }
    }
}

/// Length of (x, y), without scaling, for small components.
fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}
