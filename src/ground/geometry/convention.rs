//! Rotations in three numbers: names and conversions.

use super::euler::{Axis, EulerOrder, Frame};
use super::{Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use Axis::{X, Y, Z};
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

/// Convention of a rotation in three numbers.
///
/// Names are `rotvec`, `euler:SEQ` and `euler:SEQ@axes`. SEQ uses SciPy's letters: lower case about fixed
/// axes, upper case about moving axes, numbers in the order of the letters; ROS rpy is `euler:xyz`. With
/// `@axes` the numbers are always (rx, ry, rz), applied in the order SEQ. Equal maps are equal conventions:
/// an `@axes` name of a plain map parses to the plain convention, and one about moving axes to its
/// equivalent about fixed axes.
///
/// ```
/// # use poseaudit_ground::geometry::Convention;
/// let kuka: Convention = "euler:ZYX".parse()?;
/// let rpy: Convention = "euler:xyz".parse()?;
/// let [a, b, c] = kuka.numbers(&rpy.rotation([0.1, 0.2, 0.3]));
/// assert!((a - 0.3).abs() + (b - 0.2).abs() + (c - 0.1).abs() < 1e-12);
/// # Ok::<(), poseaudit_ground::geometry::ConventionError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Convention {
    /// Axis times angle, rad.
    RotVec,
    /// Three turns about coordinate axes, rad.
    Euler(EulerOrder),
}

const fn fixed(axes: [Axis; 3]) -> Convention {
    Convention::Euler(EulerOrder::plain(axes, Frame::Fixed))
}

const fn moving(axes: [Axis; 3]) -> Convention {
    Convention::Euler(EulerOrder::plain(axes, Frame::Moving))
}

const fn labelled(axes: [Axis; 3]) -> Convention {
    Convention::Euler(EulerOrder::labelled(axes, Frame::Fixed))
}

/// Most common first.
const ALL: [Convention; 29] = [
    Convention::RotVec,
    fixed([X, Y, Z]),
    moving([Z, Y, X]),
    moving([X, Y, Z]),
    moving([Z, Y, Z]),
    // Other Tait–Bryan orders.
    fixed([X, Z, Y]),
    fixed([Y, X, Z]),
    fixed([Y, Z, X]),
    fixed([Z, X, Y]),
    fixed([Z, Y, X]),
    moving([X, Z, Y]),
    moving([Y, X, Z]),
    moving([Y, Z, X]),
    moving([Z, X, Y]),
    // Other proper Euler orders.
    fixed([X, Y, X]),
    fixed([X, Z, X]),
    fixed([Y, X, Y]),
    fixed([Y, Z, Y]),
    fixed([Z, X, Z]),
    fixed([Z, Y, Z]),
    moving([X, Y, X]),
    moving([X, Z, X]),
    moving([Y, X, Y]),
    moving([Y, Z, Y]),
    moving([Z, X, Z]),
    // Maps without a plain name.
    labelled([X, Z, Y]),
    labelled([Y, X, Z]),
    labelled([Y, Z, X]),
    labelled([Z, X, Y]),
];

impl Convention {
    /// Roll, pitch, yaw as in ROS: `euler:xyz`.
    pub const RPY: Self = fixed([X, Y, Z]);

    /// Rotation vector, 24 Euler orders and four `@axes` maps; most common first.
    pub fn all() -> &'static [Self] {
        &ALL
    }

    /// Rank by usage: rotation vector, `euler:xyz`, `euler:ZYX`, `euler:XYZ`, `euler:ZYZ`, other plain
    /// orders, those labelled by axis.
    pub fn usual_rank(self) -> u8 {
        const NAMED: u8 = 5;
        match self {
            Self::Euler(order) if order.is_labelled_by_axis() => NAMED + 1,
            _ => (0..NAMED).zip(ALL).find(|&(_, usual)| usual == self).map_or(NAMED, |(at, _)| at),
        }
    }

    /// Whether the numbers belong to x, y and z rather than to turns.
    pub fn is_by_axis(self) -> bool {
        match self {
            Self::RotVec => true,
            Self::Euler(order) => order.is_labelled_by_axis(),
        }
    }

    /// Converts `numbers` (rad) to `a_from_b`.
    pub fn rotation(self, numbers: [f64; 3]) -> Rotation {
        match self {
            Self::RotVec => rotation_from_rotvec(Vec3::from(numbers)),
            Self::Euler(order) => order.rotation(numbers),
        }
    }

    /// Converts a rotation to numbers, rad, on the principal branch.
    ///
    /// A rotation vector has norm ≤ π. Outer Euler angles are in (−π, π], the middle one in [−π/2, π/2], or
    /// in [0, π] if first and last axis are equal. Within 1e-7 rad of gimbal lock, the angle of the last
    /// letter is zero, as in SciPy.
    pub fn numbers(self, rotation: &Rotation) -> [f64; 3] {
        match self {
            Self::RotVec => rotvec_from_rotation(rotation).into(),
            Self::Euler(order) => order.solutions(rotation)[0],
        }
    }

    /// Sets `out` to every triple, rad, that a pendant could show for `rotation`, the principal one first.
    ///
    /// An Euler order has two solutions, each angle in (−π, π]; whole turns are not added. A rotation
    /// vector of angle θ yields lengths θ, θ − 2π, θ + 2π and θ − 4π along its axis, the identity only
    /// zero.
    pub fn branches(self, rotation: &Rotation, out: &mut Vec<[f64; 3]>) {
        out.clear();
        match self {
            Self::RotVec => out.extend(rotvec_branches(rotation)),
            Self::Euler(order) => out.extend(order.solutions(rotation)),
        }
    }

    /// Distance of the middle angle from gimbal lock, rad, in [0, π/2]; `None` for a rotation vector.
    pub fn gimbal_margin(self, numbers: [f64; 3]) -> Option<f64> {
        match self {
            Self::RotVec => None,
            Self::Euler(order) => Some(order.gimbal_margin(numbers)),
        }
    }
}

/// Rotation vectors with norm below 4π, rad, shortest first.
pub(super) fn rotvec_branches(rotation: &Rotation) -> impl Iterator<Item = [f64; 3]> {
    const WHOLE_TURNS: [f64; 4] = [0.0, -1.0, 1.0, -2.0];
    let rotvec = rotvec_from_rotation(rotation);
    let angle = rotvec.norm();
    let known = if angle > 1e-12 { WHOLE_TURNS.len() } else { 1 };
    WHOLE_TURNS.into_iter().take(known).map(move |turns| match turns {
        0.0 => rotvec.into(),
        turns => (rotvec * (1.0 + turns * TAU / angle)).into(),
    })
}

/// Error of parsing a [`Convention`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConventionError {
    /// No known form.
    #[error(
        "unknown rotation convention `{0}`: expected `rotvec`, or `euler:` and three axis letters as in \
         `euler:xyz`, `euler:ZYX` or `euler:xzy@axes`"
    )]
    Unknown(String),
    /// For example `euler:xYz`.
    #[error(
        "`{0}` mixes upper and lower case: write `xyz` for turns about fixed axes, `XYZ` about \
         moving axes"
    )]
    MixedCase(String),
    /// For example `euler:xxz`.
    #[error("`{0}` turns twice in a row about one axis: adjacent letters must differ")]
    RepeatedAxis(String),
    /// For example `euler:zyz@axes`: no rx.
    #[error("`{0}` has no number for one axis: `@axes` needs three different letters")]
    AxisWithoutNumber(String),
}

impl FromStr for Convention {
    type Err = ConventionError;

    fn from_str(name: &str) -> Result<Self, ConventionError> {
        if name == "rotvec" {
            return Ok(Self::RotVec);
        }
        let unknown = || ConventionError::Unknown(name.to_owned());
        let code = name.strip_prefix("euler:").ok_or_else(unknown)?;
        let (letters, labelled_by_axis) = match code.strip_suffix("@axes") {
            Some(letters) => (letters, true),
            None => (code, false),
        };
        let &[a, b, c] = letters.as_bytes() else { return Err(unknown()) };
        let axis = |letter: u8| match letter {
            b'x' | b'X' => Ok(X),
            b'y' | b'Y' => Ok(Y),
            b'z' | b'Z' => Ok(Z),
            _ => Err(unknown()),
        };
        let axes = [axis(a)?, axis(b)?, axis(c)?];
        let frame = match [a, b, c].map(|letter| letter.is_ascii_lowercase()) {
            [true, true, true] => Frame::Fixed,
            [false, false, false] => Frame::Moving,
            _ => return Err(ConventionError::MixedCase(name.to_owned())),
        };
        if axes[0] == axes[1] || axes[1] == axes[2] {
            return Err(ConventionError::RepeatedAxis(name.to_owned()));
        }
        if !labelled_by_axis {
            return Ok(Self::Euler(EulerOrder::plain(axes, frame)));
        }
        if axes[0] == axes[2] {
            return Err(ConventionError::AxisWithoutNumber(name.to_owned()));
        }
        Ok(Self::Euler(EulerOrder::labelled(axes, frame)))
    }
}

impl fmt::Display for Convention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::RotVec => f.write_str("rotvec"),
            Self::Euler(order) => write!(f, "euler:{order}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::test_random::Lcg;
    use crate::geometry::{angle_between, rotation_from_xyzw};
    use std::f64::consts::{FRAC_PI_2, PI};

    const NUMBERS: [f64; 3] = [0.7, -0.4, 2.1];
    const ROTVEC: [f64; 3] = [1.2, -1.7, 0.6];

    /// Rotation of `NUMBERS` as x, y, z, w, and numbers of the rotation of `ROTVEC`, by SciPy 1.17.1:
    /// `Rotation.from_euler(SEQ, NUMBERS)`, `Rotation.from_rotvec(ROTVEC).as_euler(SEQ)`. Those of `@axes`
    /// were sorted by hand.
    #[rustfmt::skip]
    const SCIPY: [(&str, [f64; 4], [f64; 3]); 29] = [
        ("rotvec",
            [0.280737522585, -0.160421441477, 0.842212567755, 0.431427160993],
            [1.200000000000, -1.700000000000, 0.600000000000]),
        ("euler:xyz",
            [0.329097527794, 0.198649602472, 0.832487455100, 0.398995977097],
            [2.876588843288, -1.096689586398, -1.749798740860]),
        ("euler:ZYX",
            [0.832487455100, 0.198649602472, 0.329097527794, 0.398995977097],
            [-1.749798740860, -1.096689586398, 2.876588843288]),
        ("euler:XYZ",
            [0.005332592595, -0.384367546521, 0.764695113521, 0.517179404071],
            [2.075126209461, -0.423120425587, 1.660063393204]),
        ("euler:ZYZ",
            [-0.127986296810, -0.151950685512, 0.965806344504, 0.166579116088],
            [-2.045865018619, 2.027070653086, 3.007994384717]),
        ("euler:xzy",
            [0.005332592595, 0.764695113521, -0.384367546521, 0.517179404071],
            [1.105158005153, -0.465924722104, -1.661907490338]),
        ("euler:yxz",
            [-0.384367546521, 0.005332592595, 0.764695113521, 0.517179404071],
            [-2.030620716611, 0.119861554657, 1.154875577472]),
        ("euler:yzx",
            [0.832487455100, 0.329097527794, 0.198649602472, 0.398995977097],
            [-1.766236228610, 1.138919095166, 0.289705575598]),
        ("euler:zxy",
            [0.198649602472, 0.832487455100, 0.329097527794, 0.398995977097],
            [-0.841919069278, 0.924450811647, -2.391422438635]),
        ("euler:zyx",
            [0.764695113521, -0.384367546521, 0.005332592595, 0.517179404071],
            [1.660063393204, -0.423120425587, 2.075126209461]),
        ("euler:XZY",
            [0.329097527794, 0.832487455100, 0.198649602472, 0.398995977097],
            [0.289705575598, 1.138919095166, -1.766236228610]),
        ("euler:YXZ",
            [0.198649602472, 0.329097527794, 0.832487455100, 0.398995977097],
            [-2.391422438635, 0.924450811647, -0.841919069278]),
        ("euler:YZX",
            [0.764695113521, 0.005332592595, -0.384367546521, 0.517179404071],
            [-1.661907490338, -0.465924722104, 1.105158005153]),
        ("euler:ZXY",
            [-0.384367546521, 0.764695113521, 0.005332592595, 0.517179404071],
            [1.154875577472, 0.119861554657, -2.030620716611]),
        ("euler:xyx",
            [0.965806344504, -0.151950685512, -0.127986296810, 0.166579116088],
            [-1.995412424102, 1.652172846249, -2.673997653010]),
        ("euler:xzx",
            [0.965806344504, 0.127986296810, -0.151950685512, 0.166579116088],
            [-0.424616097307, 1.652172846249, 2.038391327375]),
        ("euler:yxy",
            [-0.151950685512, 0.965806344504, 0.127986296810, 0.166579116088],
            [-0.512590177585, 1.158042395749, -1.439885395586]),
        ("euler:yzy",
            [-0.127986296810, 0.965806344504, -0.151950685512, 0.166579116088],
            [-2.083386504379, 1.158042395749, 0.130910931209]),
        ("euler:zxz",
            [-0.151950685512, -0.127986296810, 0.965806344504, 0.166579116088],
            [1.437198057922, 2.027070653086, -0.475068691824]),
        ("euler:zyz",
            [0.127986296810, -0.151950685512, 0.965806344504, 0.166579116088],
            [3.007994384717, 2.027070653086, -2.045865018619]),
        ("euler:XYX",
            [0.965806344504, -0.151950685512, 0.127986296810, 0.166579116088],
            [-2.673997653010, 1.652172846249, -1.995412424102]),
        ("euler:XZX",
            [0.965806344504, -0.127986296810, -0.151950685512, 0.166579116088],
            [2.038391327375, 1.652172846249, -0.424616097307]),
        ("euler:YXY",
            [-0.151950685512, 0.965806344504, -0.127986296810, 0.166579116088],
            [-1.439885395586, 1.158042395749, -0.512590177585]),
        ("euler:YZY",
            [0.127986296810, 0.965806344504, -0.151950685512, 0.166579116088],
            [0.130910931209, 1.158042395749, -2.083386504379]),
        ("euler:ZXZ",
            [-0.151950685512, 0.127986296810, 0.965806344504, 0.166579116088],
            [-0.475068691824, 2.027070653086, 1.437198057922]),
        ("euler:xzy@axes",
            [0.005332592595, 0.198649602472, 0.832487455100, 0.517179404071],
            [1.105158005153, -1.661907490338, -0.465924722104]),
        ("euler:yxz@axes",
            [0.329097527794, 0.198649602472, 0.764695113521, 0.517179404071],
            [0.119861554657, -2.030620716611, 1.154875577472]),
        ("euler:yzx@axes",
            [0.329097527794, -0.384367546521, 0.764695113521, 0.398995977097],
            [0.289705575598, -1.766236228610, 1.138919095166]),
        ("euler:zxy@axes",
            [0.005332592595, -0.384367546521, 0.832487455100, 0.398995977097],
            [0.924450811647, -2.391422438635, -0.841919069278]),
    ];

    fn parsed(name: &str) -> Convention {
        name.parse().unwrap()
    }

    fn gap(a: [f64; 3], b: [f64; 3]) -> f64 {
        (Vec3::from(a) - Vec3::from(b)).amax()
    }

    #[test]
    fn agrees_with_scipy() {
        let rotation = rotation_from_rotvec(Vec3::from(ROTVEC));
        for ((name, q_xyzw, numbers), convention) in SCIPY.into_iter().zip(ALL) {
            assert_eq!(parsed(name), convention);
            let expected = rotation_from_xyzw(q_xyzw).unwrap();
            assert!(angle_between(&convention.rotation(NUMBERS), &expected) < 1e-11, "{name}");
            let found = convention.numbers(&rotation);
            assert!(gap(found, numbers) < 1e-11, "{name}: {found:?}");
        }
    }

    #[test]
    fn every_triple_is_among_its_branches() {
        let mut random = Lcg::new();
        let mut branches = Vec::new();
        for &convention in Convention::all() {
            for _ in 0..200 {
                let mut numbers = random.triple(PI);
                if convention == Convention::RotVec {
                    numbers = (Vec3::from(numbers).normalize() * random.number(TAU)).into();
                }
                let rotation = convention.rotation(numbers);
                for same in [rotation, Rotation::new_unchecked(-rotation.into_inner())] {
                    convention.branches(&same, &mut branches);
                    assert!(
                        branches.iter().any(|branch| gap(*branch, numbers) < 1e-7),
                        "{convention}: {numbers:?} is not among {branches:?}"
                    );
                    for branch in &branches {
                        assert!(angle_between(&convention.rotation(*branch), &rotation) < 1e-12);
                    }
                    let principal = convention.numbers(&same);
                    assert_eq!(principal, branches[0]);
                    match convention {
                        Convention::RotVec => assert!(Vec3::from(principal).norm() <= PI + 1e-15),
                        Convention::Euler(_) => {
                            assert!(branches.as_flattened().iter().all(|a| (-PI..=PI).contains(a)));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_principal_middle_angle_is_in_its_half_turn() {
        let mut random = Lcg::new();
        for _ in 0..200 {
            let rotation = rotation_from_rotvec(Vec3::from(random.triple(PI)));
            let [_, pitch, _] = Convention::RPY.numbers(&rotation);
            let [_, tilt, _] = parsed("euler:ZYZ").numbers(&rotation);
            assert!(pitch.abs() <= FRAC_PI_2 && (0.0..=PI).contains(&tilt), "{pitch} {tilt}");
        }
    }

    #[test]
    fn in_gimbal_lock_the_last_angle_is_zero() {
        let quarter = FRAC_PI_2;
        for &convention in &ALL[1..25] {
            let mut locks = 0;
            for rotvec in [[0.0; 3], [quarter, 0.0, 0.0], [0.0, quarter, 0.0], [0.0, 0.0, quarter]]
            {
                let rotation = rotation_from_rotvec(Vec3::from(rotvec));
                let numbers = convention.numbers(&rotation);
                let back = convention.rotation(numbers);
                assert!(angle_between(&back, &rotation) < 1e-7, "{convention}");
                if convention.gimbal_margin(numbers).unwrap() < 1e-7 {
                    assert_eq!(numbers[2], 0.0, "{convention}");
                    locks += 1;
                }
            }
            assert!(locks > 0, "{convention}");
        }

        let by_axis = parsed("euler:xzy@axes");
        let [rx, ry, rz] = by_axis.numbers(&by_axis.rotation([0.3, 0.5, quarter]));
        assert!(
            (rx - 0.8).abs() < 1e-12 && ry == 0.0 && (rz - quarter).abs() < 1e-7,
            "{rx} {ry} {rz}"
        );
    }

    #[test]
    fn the_gimbal_margin_is_the_distance_of_the_middle_angle_from_lock() {
        let margin = |name: &str, numbers| parsed(name).gimbal_margin(numbers).unwrap();
        assert!((margin("euler:xyz", [1.0, 1.5, 2.0]) - (FRAC_PI_2 - 1.5)).abs() < 1e-15);
        assert!((margin("euler:xyz", [1.0, PI - 1.5, 2.0]) - (FRAC_PI_2 - 1.5)).abs() < 1e-15);
        assert!((margin("euler:ZYZ", [1.0, -0.1, 2.0]) - 0.1).abs() < 1e-15);
        assert!((margin("euler:ZYZ", [1.0, 3.0, 2.0]) - (PI - 3.0)).abs() < 1e-15);
        assert!((margin("euler:xzy@axes", [0.0, 0.0, 1.5]) - (FRAC_PI_2 - 1.5)).abs() < 1e-15);
        assert_eq!(Convention::RotVec.gimbal_margin([0.0, FRAC_PI_2, 0.0]), None);
    }

    #[test]
    fn half_turns_and_no_turn_have_finite_numbers() {
        let mut branches = Vec::new();
        let half_turns = [[PI, 0.0, 0.0], [0.0, -PI, 0.0], [0.0, 0.0, PI]];
        for rotvec in half_turns.into_iter().chain([[0.0; 3], [1e-300, 0.0, 0.0]]) {
            let rotation = rotation_from_rotvec(Vec3::from(rotvec));
            for convention in ALL {
                convention.branches(&rotation, &mut branches);
                for branch in &branches {
                    assert!(angle_between(&convention.rotation(*branch), &rotation) < 2e-7);
                }
            }
        }
    }

    #[test]
    fn names_survive_a_round_trip() {
        for convention in ALL {
            assert_eq!(parsed(&convention.to_string()), convention);
        }
    }

    #[test]
    fn an_order_labelled_by_axis_that_changes_nothing_has_its_plain_name() {
        for (labelled, canonical) in [
            ("euler:xyz@axes", "euler:xyz"),
            ("euler:ZYX@axes", "euler:xyz"),
            ("euler:zyx@axes", "euler:XYZ"),
            ("euler:XYZ@axes", "euler:XYZ"),
            ("euler:YZX@axes", "euler:xzy@axes"),
            ("euler:YXZ@axes", "euler:zxy@axes"),
        ] {
            assert_eq!(parsed(labelled).to_string(), canonical);
        }
    }

    #[test]
    fn errors_of_bad_names_describe_the_fault() {
        let error_of = |name: &str| name.parse::<Convention>().unwrap_err().to_string();
        for name in ["", "euler:", "euler:xy", "euler:abc", "euler:é", "quat:xyzw", "rotvec@axes"]
        {
            assert!(error_of(name).starts_with("unknown rotation convention"), "{name}");
        }
        assert!(error_of("euler:xYz").contains("mixes upper and lower case"));
        assert!(error_of("euler:xxz").contains("twice in a row"));
        assert!(error_of("euler:XZZ@axes").contains("twice in a row"));
        assert!(error_of("euler:zyz@axes").contains("three different letters"));
    }
}
