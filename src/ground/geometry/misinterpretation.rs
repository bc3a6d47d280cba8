//! Numbers of one rotation convention converted as another.

use super::convention::{Convention, rotvec_branches};
use super::{Misread, Rotation, Vec3, rotation_from_rotvec};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

/// Closer rotations are the same candidate, rad.
const MAX_EQUAL_ANGLE_RAD: f64 = 1e-9;

/// Rotation vectors, rad, in general position: maps that agree here agree everywhere.
const PROBES: [[f64; 3]; 3] = [[0.5, -0.9, 1.3], [-1.9, 0.4, 0.8], [0.3, 2.2, -1.1]];

/// Numbers in the convention `is`, converted as `read_as`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Misinterpretation {
    /// True convention.
    pub is: Convention,
    /// Convention used.
    pub read_as: Convention,
}

impl Misinterpretation {
    /// Sets `out` to every rotation that this misinterpretation can turn into `logged`, that of the
    /// principal numbers first.
    ///
    /// The numbers are any that `read_as` turns into `logged` and that `is` can represent: a rotation
    /// vector of norm ≤ 2π, or Euler angles from −π to 2π (displays with ±180° and 0–360°). Adding 2π to
    /// one component changes a rotation vector but no Euler angle. In gimbal lock, only two points of the
    /// continuum are used ([`Convention::branches`]).
    ///
    /// Does not allocate if `out` has capacity for twelve.
    pub fn true_rotations(&self, logged: &Rotation, out: &mut Vec<Rotation>) {
        out.clear();
        match (self.is, self.read_as) {
            (Convention::Euler(is), Convention::Euler(read_as)) => {
                for halves in read_as.half_angle_solutions(logged) {
                    push_new(out, is.rotation_from_half_angles(halves));
                }
            }
            (Convention::RotVec, Convention::Euler(read_as)) => {
                for numbers in read_as.solutions(logged) {
                    for rotvec in
                        with_whole_turns(numbers).filter(|v| v.norm() <= TAU + MAX_EQUAL_ANGLE_RAD)
                    {
                        push_new(out, rotation_from_rotvec(rotvec));
                    }
                }
            }
            (Convention::Euler(is), Convention::RotVec) => {
                let displayed_range = -PI - MAX_EQUAL_ANGLE_RAD..=TAU + MAX_EQUAL_ANGLE_RAD;
                for numbers in rotvec_branches(logged) {
                    if numbers.iter().all(|angle| displayed_range.contains(angle)) {
                        push_new(out, is.rotation(numbers));
                    }
                }
            }
            (Convention::RotVec, Convention::RotVec) => out.push(*logged),
        }
    }
}

/// `numbers` (rad, in [−π, π]) first, then up to a whole turn per component, within ±2π.
fn with_whole_turns(numbers: [f64; 3]) -> impl Iterator<Item = Vec3> {
    let turned = numbers.map(|angle| angle - TAU.copysign(angle));
    (0..8).map(move |mask| {
        Vec3::from_fn(|i, _| if mask >> i & 1 == 0 { numbers[i] } else { turned[i] })
    })
}

fn push_new(out: &mut Vec<Rotation>, candidate: Rotation) {
    if !out.iter().any(|known| is_same(known, &candidate)) {
        out.push(candidate);
    }
}

/// Up to [`MAX_EQUAL_ANGLE_RAD`]; q and −q are equal.
fn is_same(a: &Rotation, b: &Rotation) -> bool {
    // For small angles the distance of unit quaternions is half the angle.
    let sign = if a.coords.dot(&b.coords) < 0.0 { -1.0 } else { 1.0 };
    (a.coords - b.coords * sign).norm_squared() < (0.5 * MAX_EQUAL_ANGLE_RAD).powi(2)
}

/// Misinterpretations that are the same map; no log distinguishes them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MisinterpretationClass {
    /// By the ranks of both conventions ([`Convention::usual_rank`]), then those read as `euler:xyz`. Never
    /// empty.
    pub members: Vec<Misinterpretation>,
}

/// All misinterpretations between conventions of [`Convention::all`], grouped by map, most common first.
/// None is the identity or a transpose.
pub fn misinterpretation_classes() -> &'static [MisinterpretationClass] {
    static CLASSES: LazyLock<Vec<MisinterpretationClass>> =
        LazyLock::new(|| classes_of(Convention::all()));
    &CLASSES
}

fn classes_of(conventions: &[Convention]) -> Vec<MisinterpretationClass> {
    /// Above the rounding of a few dozen numbers.
    const MAX_SUM_DIFFERENCE: f64 = 1e-6;
    let mut misinterpretations: Vec<Misinterpretation> = conventions
        .iter()
        .flat_map(|&is| conventions.iter().map(move |&read_as| Misinterpretation { is, read_as }))
        .filter(|misinterpretation| misinterpretation.is != misinterpretation.read_as)
        .collect();
    // Stable: ties keep the order of `conventions`.
    misinterpretations.sort_by_key(|Misinterpretation { is, read_as }| {
        (is.usual_rank() + read_as.usual_rank(), *read_as != Convention::RPY)
    });

    let probes = PROBES.map(|rotvec| rotation_from_rotvec(Vec3::from(rotvec)));
    // With the sum of |w|, which differs unless the maps are the same or similar.
    let mut images: Vec<(f64, [Vec<Rotation>; PROBES.len()])> = Vec::new();
    let mut classes: Vec<MisinterpretationClass> = Vec::new();
    for misinterpretation in misinterpretations {
        let image = probes.map(|probe| {
            let mut rotations = Vec::new();
            misinterpretation.true_rotations(&probe, &mut rotations);
            rotations
        });
        let sum: f64 = image.iter().flatten().map(|rotation| rotation.w.abs()).sum();
        let same_map = |(known_sum, known): &(f64, [Vec<Rotation>; PROBES.len()])| {
            (known_sum - sum).abs() < MAX_SUM_DIFFERENCE
                && known.iter().zip(&image).all(|(a, b)| is_same_set(a, b))
        };
        match images.iter().position(same_map) {
            Some(at) => classes[at].members.push(misinterpretation),
            None => {
                images.push((sum, image));
                classes.push(MisinterpretationClass { members: vec![misinterpretation] });
            }
        }
    }
    classes
}

fn is_same_set(a: &[Rotation], b: &[Rotation]) -> bool {
    a.len() == b.len() && a.iter().all(|x| b.iter().any(|y| is_same(x, y)))
}

/// Wrong order of quaternion components.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QuaternionOrderError {
    /// `quat:wxyz` read as `quat:xyzw`.
    WxyzReadAsXyzw,
    /// `quat:xyzw` read as `quat:wxyz`.
    XyzwReadAsWxyz,
}

impl QuaternionOrderError {
    /// Both orders.
    pub const BOTH: [Self; 2] = [Self::WxyzReadAsXyzw, Self::XyzwReadAsWxyz];

    /// True components x, y, z, w.
    pub fn true_xyzw(self, logged_xyzw: [f64; 4]) -> [f64; 4] {
        let [x, y, z, w] = logged_xyzw;
        match self {
            Self::WxyzReadAsXyzw => [y, z, w, x],
            Self::XyzwReadAsWxyz => [w, x, y, z],
        }
    }
}

/// Misinterpretation of a stream's rotations or poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Misread<String>", into = "Misread<String>")]
pub enum RotationError {
    /// Wrong convention of three numbers.
    Misread(Misinterpretation),
    /// Wrong order of quaternion components.
    Quaternion(QuaternionOrderError),
    /// Inverted rotation, correct position.
    Transposed,
    /// Inverted pose.
    Inverted,
}

impl TryFrom<Misread<String>> for RotationError {
    type Error = String;

    fn try_from(error: Misread<String>) -> Result<Self, String> {
        let Misread { is, read_as } = &error;
        Ok(match (is.as_str(), read_as.as_str()) {
            ("transpose", "pose") => Self::Transposed,
            ("pose-inverse", "pose") => Self::Inverted,
            ("quat:wxyz", "quat:xyzw") => Self::Quaternion(QuaternionOrderError::WxyzReadAsXyzw),
            ("quat:xyzw", "quat:wxyz") => Self::Quaternion(QuaternionOrderError::XyzwReadAsWxyz),
            _ => {
                let convention =
                    |name: &str| name.parse::<Convention>().map_err(|error| error.to_string());
                let misinterpretation =
                    Misinterpretation { is: convention(is)?, read_as: convention(read_as)? };
                if misinterpretation.is == misinterpretation.read_as {
                    return Err(format!("`{is}` read as `{read_as}` is not a misinterpretation"));
                }
                Self::Misread(misinterpretation)
            }
        })
    }
}

impl From<RotationError> for Misread<String> {
    fn from(error: RotationError) -> Self {
        let of =
            |is: &str, read_as: &str| Misread { is: is.to_owned(), read_as: read_as.to_owned() };
        match error {
            RotationError::Transposed => of("transpose", "pose"),
            RotationError::Inverted => of("pose-inverse", "pose"),
            RotationError::Quaternion(QuaternionOrderError::WxyzReadAsXyzw) => {
                of("quat:wxyz", "quat:xyzw")
            }
            RotationError::Quaternion(QuaternionOrderError::XyzwReadAsWxyz) => {
                of("quat:xyzw", "quat:wxyz")
            }
            RotationError::Misread(Misinterpretation { is, read_as }) => {
                of(&is.to_string(), &read_as.to_string())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::angle_between;
    use crate::geometry::test_random::Lcg;

    fn misinterpretation(is: &str, read_as: &str) -> Misinterpretation {
        Misinterpretation { is: is.parse().unwrap(), read_as: read_as.parse().unwrap() }
    }

    fn class_of(is: &str, read_as: &str) -> &'static MisinterpretationClass {
        let pair = misinterpretation(is, read_as);
        misinterpretation_classes().iter().find(|class| class.members.contains(&pair)).unwrap()
    }

    #[test]
    fn the_true_rotation_is_among_the_candidates() {
        let mut random = Lcg::new();
        let mut rotations = Vec::new();
        let mut displayed_range = Vec::new();
        for class in misinterpretation_classes() {
            for &Misinterpretation { is, read_as } in &class.members {
                for _ in 0..20 {
                    let truth = rotation_from_rotvec(Vec3::from(random.triple(PI)));
                    is.branches(&truth, &mut displayed_range);
                    // Pendants show rotation vectors up to a whole turn, Euler angles on any branch.
                    for numbers in &displayed_range[..2] {
                        let logged = read_as.rotation(*numbers);
                        class.members[0].true_rotations(&logged, &mut rotations);
                        assert!(
                            rotations.iter().any(|found| angle_between(found, &truth) < 1e-7),
                            "{is} read as {read_as}: {numbers:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn angles_from_0_to_360_degrees_are_decoded() {
        let numbers = [5.5, 3.5, 6.0];
        let reading = misinterpretation("euler:ZYX", "rotvec");
        let mut rotations = Vec::new();
        reading.true_rotations(&reading.read_as.rotation(numbers), &mut rotations);
        let truth = reading.is.rotation(numbers);
        assert!(rotations.iter().any(|found| angle_between(found, &truth) < 1e-9));
    }

    #[test]
    fn candidates_are_unique_and_finite_in_gimbal_lock() {
        let mut rotations = Vec::new();
        for rotvec in PROBES.into_iter().chain([[0.0; 3], [0.0, PI / 2.0, 0.0], [PI, 0.0, 0.0]]) {
            let logged = rotation_from_rotvec(Vec3::from(rotvec));
            for reading in misinterpretation_classes().iter().flat_map(|class| &class.members) {
                reading.true_rotations(&logged, &mut rotations);
                assert!((1..=16).contains(&rotations.len()));
                for (i, a) in rotations.iter().enumerate() {
                    assert!((a.norm() - 1.0).abs() < 1e-12);
                    assert!(
                        rotations[..i]
                            .iter()
                            .all(|b| angle_between(a, b) >= 0.9 * MAX_EQUAL_ANGLE_RAD)
                    );
                }
            }
        }
    }

    #[test]
    fn equal_misinterpretations_are_one_class_named_by_the_most_usual_pair() {
        let reversed = class_of("euler:ZYX", "euler:xyz");
        assert_eq!(reversed.members.len(), 24);
        assert_eq!(reversed.members[0], misinterpretation("euler:ZYX", "euler:xyz"));
        assert!(reversed.members.contains(&misinterpretation("euler:xyz", "euler:ZYX")));
        assert!(reversed.members.contains(&misinterpretation("euler:xyx", "euler:ZYZ")));
        assert!(reversed.members.contains(&misinterpretation("euler:XYZ", "euler:zyx")));

        let other_frame = class_of("euler:xyz", "euler:XYZ");
        assert_eq!(other_frame.members[0], misinterpretation("euler:xyz", "euler:XYZ"));
        assert!(other_frame.members.contains(&misinterpretation("euler:ZYX", "euler:zyx")));

        let kawasaki = class_of("euler:ZYZ", "euler:xyz");
        assert_eq!(kawasaki.members[0], misinterpretation("euler:ZYZ", "euler:xyz"));
        assert!(kawasaki.members.contains(&misinterpretation("euler:zyz", "euler:ZYX")));
    }

    #[test]
    fn every_misinterpretation_is_in_one_class() {
        let members: usize =
            misinterpretation_classes().iter().map(|class| class.members.len()).sum();
        assert_eq!(members, 29 * 28);
        // Checked with SciPy on random rotations. With the identity, the transpose and a quaternion order,
        // the 251 maps are 254 of 603 hypotheses.
        assert_eq!(misinterpretation_classes().len(), 443);
        assert_eq!(classes_of(&Convention::all()[..25]).len(), 251);
    }

    #[test]
    fn no_misinterpretation_is_the_identity_or_a_transpose() {
        let mut rotations = Vec::new();
        for class in misinterpretation_classes() {
            for map in [|r: &Rotation| *r, |r: &Rotation| r.inverse()] {
                let same = PROBES.iter().all(|&probe| {
                    let logged = rotation_from_rotvec(Vec3::from(probe));
                    class.members[0].true_rotations(&logged, &mut rotations);
                    is_same_set(&rotations, &[map(&logged)])
                });
                assert!(!same, "{:?}", class.members[0]);
            }
        }
    }

    #[test]
    fn a_quaternion_order_error_is_undone() {
        let (w, x, y, z) = (0.9, 0.1, -0.2, 0.3);
        assert_eq!(QuaternionOrderError::WxyzReadAsXyzw.true_xyzw([w, x, y, z]), [x, y, z, w]);
        assert_eq!(QuaternionOrderError::XyzwReadAsWxyz.true_xyzw([y, z, w, x]), [x, y, z, w]);
    }
}
