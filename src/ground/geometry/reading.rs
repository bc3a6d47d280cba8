//! The fault of reading the numbers of one rotation convention as another's.

use super::convention::{Convention, rotvec_branches};
use super::{Rotation, Slip, Vec3, rotation_from_rotvec};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

/// Two rotations by less than this angle apart, rad, are one candidate.
const SAME_RAD: f64 = 1e-9;

/// Rotation vectors, rad, in general position: maps that agree on these agree everywhere.
const PROBES: [[f64; 3]; 3] = [[0.5, -0.9, 1.3], [-1.9, 0.4, 0.8], [0.3, 2.2, -1.1]];

/// Three numbers that are `is`, and somebody read them as `read_as`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Misreading {
    /// What the numbers mean.
    pub is: Convention,
    /// What they were taken for.
    pub read_as: Convention,
}

impl Misreading {
    /// Replaces `out` by every rotation that may have been the true one where `logged` is what the
    /// misreading made of it; the one from the principal numbers first, none twice.
    ///
    /// The misread numbers are any that `read_as` turns into `logged` and that `is` can show: a
    /// rotation vector of norm ≤ 2π, or Euler angles from −π to 2π (both ±180° and 0–360° displays).
    /// Whole turns in a number are no matter to an Euler order, but a rotation vector with another
    /// 2π in one component is another rotation. Where `logged` is in the gimbal lock of `read_as`
    /// the numbers are a continuum, of which [`Convention::branches`] has two.
    ///
    /// Nothing is allocated once `out` has room for a dozen.
    pub fn truths(&self, logged: &Rotation, out: &mut Vec<Rotation>) {
        out.clear();
        match (self.is, self.read_as) {
            (Convention::Euler(is), Convention::Euler(read_as)) => {
                for halves in read_as.half_angle_solutions(logged) {
                    push_new(out, is.rotation_from_half_angles(halves));
                }
            }
            (Convention::RotVec, Convention::Euler(read_as)) => {
                for numbers in read_as.solutions(logged) {
                    for rotvec in with_whole_turns(numbers).filter(|v| v.norm() <= TAU + SAME_RAD) {
                        push_new(out, rotation_from_rotvec(rotvec));
                    }
                }
            }
            (Convention::Euler(is), Convention::RotVec) => {
                let shown = -PI - SAME_RAD..=TAU + SAME_RAD;
                for numbers in rotvec_branches(logged) {
                    if numbers.iter().all(|angle| shown.contains(angle)) {
                        push_new(out, is.rotation(numbers));
                    }
                }
            }
            (Convention::RotVec, Convention::RotVec) => out.push(*logged),
        }
    }
}

/// The vectors whose components are those of `numbers` (rad, in [−π, π]) up to a whole turn and
/// within ±2π, `numbers` first.
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

/// Whether two rotations are less than [`SAME_RAD`] apart; q and −q are one rotation.
fn is_same(a: &Rotation, b: &Rotation) -> bool {
    // Unit quaternions half of a small angle apart lie that far apart as points.
    let sign = if a.coords.dot(&b.coords) < 0.0 { -1.0 } else { 1.0 };
    (a.coords - b.coords * sign).norm_squared() < (0.5 * SAME_RAD).powi(2)
}

/// Misreadings that are the same map on every rotation, so that no log can tell them apart.
#[derive(Clone, Debug)]
pub struct MisreadingClass {
    /// The most usual first: by the ranks of both conventions together
    /// ([`Convention::usual_rank`]), then those read as `euler:xyz`. Never empty.
    pub members: Vec<Misreading>,
}

/// All misreadings of one of [`Convention::all`] as another, those that are one map in one class;
/// the class with the most usual member first.
///
/// None of them is the identity or the plain transpose of a rotation.
pub fn misreading_classes() -> &'static [MisreadingClass] {
    static CLASSES: LazyLock<Vec<MisreadingClass>> =
        LazyLock::new(|| classes_of(Convention::all()));
    &CLASSES
}

fn classes_of(conventions: &[Convention]) -> Vec<MisreadingClass> {
    let mut misreadings: Vec<Misreading> = conventions
        .iter()
        .flat_map(|&is| conventions.iter().map(move |&read_as| Misreading { is, read_as }))
        .filter(|misreading| misreading.is != misreading.read_as)
        .collect();
    // Stable: the rest is in the order of `conventions`.
    misreadings.sort_by_key(|Misreading { is, read_as }| {
        (is.usual_rank() + read_as.usual_rank(), *read_as != Convention::RPY)
    });

    let probes = PROBES.map(|rotvec| rotation_from_rotvec(Vec3::from(rotvec)));
    let mut images: Vec<[Vec<Rotation>; PROBES.len()]> = Vec::new();
    let mut classes: Vec<MisreadingClass> = Vec::new();
    for misreading in misreadings {
        let image = probes.map(|probe| {
            let mut truths = Vec::new();
            misreading.truths(&probe, &mut truths);
            truths
        });
        let same_map = |known: &[Vec<Rotation>; PROBES.len()]| {
            known.iter().zip(&image).all(|(a, b)| is_same_set(a, b))
        };
        match images.iter().position(same_map) {
            Some(at) => classes[at].members.push(misreading),
            None => {
                images.push(image);
                classes.push(MisreadingClass { members: vec![misreading] });
            }
        }
    }
    classes
}

fn is_same_set(a: &[Rotation], b: &[Rotation]) -> bool {
    a.len() == b.len() && a.iter().all(|x| b.iter().any(|y| is_same(x, y)))
}

/// Quaternion components taken in the wrong order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QuaternionSlip {
    /// The four numbers are `quat:wxyz`, and somebody read them as `quat:xyzw`.
    WxyzReadAsXyzw,
    /// The four numbers are `quat:xyzw`, and somebody read them as `quat:wxyz`.
    XyzwReadAsWxyz,
}

impl QuaternionSlip {
    /// Both of them.
    pub const BOTH: [Self; 2] = [Self::WxyzReadAsXyzw, Self::XyzwReadAsWxyz];

    /// The true components x, y, z, w where the slip made `logged_xyzw` of them.
    pub fn truth(self, logged_xyzw: [f64; 4]) -> [f64; 4] {
        let [x, y, z, w] = logged_xyzw;
        match self {
            Self::WxyzReadAsXyzw => [y, z, w, x],
            Self::XyzwReadAsWxyz => [w, x, y, z],
        }
    }
}

/// What became of the rotations of a stream, or of its poses as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Slip<String>", into = "Slip<String>")]
pub enum RotationSlip {
    /// Three numbers of one convention were read as another.
    Misread(Misreading),
    /// The quaternion's components stand in the other order.
    Quaternion(QuaternionSlip),
    /// The rotation is inverted, the position is not.
    Transposed,
    /// The pose is inverted as a whole.
    Inverted,
}

impl TryFrom<Slip<String>> for RotationSlip {
    type Error = String;

    fn try_from(slip: Slip<String>) -> Result<Self, String> {
        let Slip { is, read_as } = &slip;
        Ok(match (is.as_str(), read_as.as_str()) {
            ("transpose", "pose") => Self::Transposed,
            ("pose-inverse", "pose") => Self::Inverted,
            ("quat:wxyz", "quat:xyzw") => Self::Quaternion(QuaternionSlip::WxyzReadAsXyzw),
            ("quat:xyzw", "quat:wxyz") => Self::Quaternion(QuaternionSlip::XyzwReadAsWxyz),
            _ => {
                let convention =
                    |name: &str| name.parse::<Convention>().map_err(|error| error.to_string());
                let misreading = Misreading { is: convention(is)?, read_as: convention(read_as)? };
                if misreading.is == misreading.read_as {
                    return Err(format!("`{is}` read as `{read_as}` is no slip"));
                }
                Self::Misread(misreading)
            }
        })
    }
}

impl From<RotationSlip> for Slip<String> {
    fn from(slip: RotationSlip) -> Self {
        let of = |is: &str, read_as: &str| Slip { is: is.to_owned(), read_as: read_as.to_owned() };
        match slip {
            RotationSlip::Transposed => of("transpose", "pose"),
            RotationSlip::Inverted => of("pose-inverse", "pose"),
            RotationSlip::Quaternion(QuaternionSlip::WxyzReadAsXyzw) => {
                of("quat:wxyz", "quat:xyzw")
            }
            RotationSlip::Quaternion(QuaternionSlip::XyzwReadAsWxyz) => {
                of("quat:xyzw", "quat:wxyz")
            }
            RotationSlip::Misread(Misreading { is, read_as }) => {
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

    fn misreading(is: &str, read_as: &str) -> Misreading {
        Misreading { is: is.parse().unwrap(), read_as: read_as.parse().unwrap() }
    }

    fn class_of(is: &str, read_as: &str) -> &'static MisreadingClass {
        let wanted = misreading(is, read_as);
        misreading_classes().iter().find(|class| class.members.contains(&wanted)).unwrap()
    }

    #[test]
    fn the_truth_is_among_the_truths() {
        let mut random = Lcg::new();
        let mut truths = Vec::new();
        let mut shown = Vec::new();
        for class in misreading_classes() {
            for &Misreading { is, read_as } in &class.members {
                for _ in 0..20 {
                    let truth = rotation_from_rotvec(Vec3::from(random.triple(PI)));
                    is.branches(&truth, &mut shown);
                    // A pendant shows a rotation vector up to a whole turn, and Euler angles on any
                    // branch.
                    for numbers in &shown[..2] {
                        let logged = read_as.rotation(*numbers);
                        class.members[0].truths(&logged, &mut truths);
                        assert!(
                            truths.iter().any(|found| angle_between(found, &truth) < 1e-7),
                            "{is} read as {read_as}: {numbers:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_display_from_0_to_360_degrees_is_understood() {
        let numbers = [5.5, 3.5, 6.0];
        let reading = misreading("euler:ZYX", "rotvec");
        let mut truths = Vec::new();
        reading.truths(&reading.read_as.rotation(numbers), &mut truths);
        let truth = reading.is.rotation(numbers);
        assert!(truths.iter().any(|found| angle_between(found, &truth) < 1e-9));
    }

    #[test]
    fn no_truth_is_listed_twice_and_gimbal_lock_is_finite() {
        let mut truths = Vec::new();
        for rotvec in PROBES.into_iter().chain([[0.0; 3], [0.0, PI / 2.0, 0.0], [PI, 0.0, 0.0]]) {
            let logged = rotation_from_rotvec(Vec3::from(rotvec));
            for reading in misreading_classes().iter().flat_map(|class| &class.members) {
                reading.truths(&logged, &mut truths);
                assert!((1..=16).contains(&truths.len()));
                for (i, a) in truths.iter().enumerate() {
                    assert!((a.norm() - 1.0).abs() < 1e-12);
                    assert!(truths[..i].iter().all(|b| angle_between(a, b) >= 0.9 * SAME_RAD));
                }
            }
        }
    }

    #[test]
    fn equal_maps_are_one_class_named_by_its_most_usual_pair() {
        let reversed = class_of("euler:ZYX", "euler:xyz");
        assert_eq!(reversed.members.len(), 24);
        assert_eq!(reversed.members[0], misreading("euler:ZYX", "euler:xyz"));
        assert!(reversed.members.contains(&misreading("euler:xyz", "euler:ZYX")));
        assert!(reversed.members.contains(&misreading("euler:xyx", "euler:ZYZ")));
        assert!(reversed.members.contains(&misreading("euler:XYZ", "euler:zyx")));

        let other_frame = class_of("euler:xyz", "euler:XYZ");
        assert_eq!(other_frame.members[0], misreading("euler:xyz", "euler:XYZ"));
        assert!(other_frame.members.contains(&misreading("euler:ZYX", "euler:zyx")));

        let kawasaki = class_of("euler:ZYZ", "euler:xyz");
        assert_eq!(kawasaki.members[0], misreading("euler:ZYZ", "euler:xyz"));
        assert!(kawasaki.members.contains(&misreading("euler:zyz", "euler:ZYX")));
    }

    #[test]
    fn every_misreading_is_in_one_class() {
        let members: usize = misreading_classes().iter().map(|class| class.members.len()).sum();
        assert_eq!(members, 29 * 28);
        // Checked against SciPy on random rotations. The 251 and the identity, the transpose and a
        // quaternion slip are the 254 different maps of 603 hypotheses.
        assert_eq!(misreading_classes().len(), 443);
        assert_eq!(classes_of(&Convention::all()[..25]).len(), 251);
    }

    #[test]
    fn no_misreading_is_harmless_or_a_transpose() {
        let mut truths = Vec::new();
        for class in misreading_classes() {
            for map in [|r: &Rotation| *r, |r: &Rotation| r.inverse()] {
                let same = PROBES.iter().all(|&probe| {
                    let logged = rotation_from_rotvec(Vec3::from(probe));
                    class.members[0].truths(&logged, &mut truths);
                    is_same_set(&truths, &[map(&logged)])
                });
                assert!(!same, "{:?}", class.members[0]);
            }
        }
    }

    #[test]
    fn a_quaternion_slip_is_undone() {
        let (w, x, y, z) = (0.9, 0.1, -0.2, 0.3);
        // A reader that takes (w, x, y, z) for (x, y, z, w), and the other way round.
        assert_eq!(QuaternionSlip::WxyzReadAsXyzw.truth([w, x, y, z]), [x, y, z, w]);
        assert_eq!(QuaternionSlip::XyzwReadAsWxyz.truth([y, z, w, x]), [x, y, z, w]);
    }
}
