//! Encoding of a pose's numbers: form, order and units.

use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use crate::geometry::{
    AngleUnit, Convention, LengthScale, Pose, Rotation, RotationEncoding, UnitError, Units, Vec3,
    pose, rotation_from_matrix_rows, rotation_from_rotvec, rotation_from_xyzw, vendors, xyz_of,
    xyzw_from_rotation,
};

use super::error::DeskError;

/// `max |RᵀR − I|` of a matrix, or ten times the deviation of a quaternion's norm.
const MAX_DEFECT: f64 = 1e-2;

/// Larger deviations are noted.
pub(super) const MIN_NOTED_DEFECT: f64 = 1e-3;

/// Same angle as in ORD006, rad.
pub(super) const GIMBAL_LOCK_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Largest plausible lengths, each in its unit.
pub(super) const MAX_LENGTH_M: f64 = 10.0;
const MAX_LENGTH_CM: f64 = 1e3;
const MAX_LENGTH_MM: f64 = 1e4;

/// Largest plausible angles, each in its unit.
pub(super) const MAX_ANGLE_RAD: f64 = 1.1 * TAU;
const MAX_ANGLE_DEG: f64 = 1e3;

fn accepts_count(form: RotationEncoding, count: usize) -> bool {
    match form {
        RotationEncoding::Three(_) => matches!(count, 3 | 6),
        RotationEncoding::Xyzw | RotationEncoding::Wxyz | RotationEncoding::AxisAngle => {
            matches!(count, 4 | 7)
        }
        RotationEncoding::Rows | RotationEncoding::Columns => matches!(count, 9 | 12 | 16),
        RotationEncoding::TwoColumns | RotationEncoding::TwoRows => matches!(count, 6 | 9),
    }
}

fn has_position(form: RotationEncoding, count: usize) -> bool {
    match form {
        RotationEncoding::Three(_) => count == 6,
        RotationEncoding::Xyzw | RotationEncoding::Wxyz | RotationEncoding::AxisAngle => count == 7,
        RotationEncoding::Rows | RotationEncoding::Columns => count > 9,
        RotationEncoding::TwoColumns | RotationEncoding::TwoRows => count == 9,
    }
}

/// Known part of an encoding.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownEncoding {
    /// Form of the rotation.
    pub rotation: Option<RotationEncoding>,
    /// Units.
    pub units: Units,
}

impl KnownEncoding {
    /// Fills missing parts from `other`.
    pub fn or(self, other: Self) -> Self {
        Self { rotation: self.rotation.or(other.rotation), units: self.units.or(other.units) }
    }
}

/// `FORM` or a maker's `NAME`, and units, as `euler:ZYX,deg,mm`, `kuka`, `mm`.
impl FromStr for KnownEncoding {
    type Err = DeskError;

    fn from_str(text: &str) -> Result<Self, DeskError> {
        let mut known = Self::default();
        let mut of_vendor = Self::default();
        for part in text.split(',').map(str::trim) {
            match (known.units.set_symbol(part), vendors::find(part)) {
                (Ok(()), _) => {}
                (Err(UnitError::Contradiction), _) => {
                    return Err(DeskError::Contradiction { unit: part.to_owned() });
                }
                (Err(UnitError::Unknown), Some(vendor)) => {
                    of_vendor = Self { rotation: Some(vendor.coding), units: vendor.units };
                }
                (Err(UnitError::Unknown), None) => {
                    let form = part.parse().map_err(|source| DeskError::Form { source })?;
                    known.rotation = Some(form);
                }
            }
        }
        Ok(known.or(of_vendor))
    }
}

/// Encoding of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberEncoding {
    /// Form of the rotation.
    pub rotation: RotationEncoding,
    /// Unit of the position.
    pub length: LengthScale,
    /// Unit of the angles, if any.
    pub angle: AngleUnit,
    /// Whether there is a position.
    pub has_position: bool,
    /// Whether the position's unit is unusual for its size.
    pub has_unusual_length: bool,
    /// Whether the angles' unit is unusual for their size.
    pub has_unusual_angle: bool,
}

/// Limit in any unit.
const MAX_NUMBER: f64 = 1e9;

impl NumberEncoding {
    /// Number of unusual units.
    pub fn count_unusual_units(&self) -> u8 {
        u8::from(self.has_unusual_length) + u8::from(self.has_unusual_angle)
    }

    /// Decodes `numbers`; a missing position is zero.
    ///
    /// # Errors
    /// If the count does not fit the form, or the numbers are not a rotation.
    pub fn pose(&self, numbers: &[f64]) -> Result<Pose, DeskError> {
        let form = self.rotation;
        if !accepts_count(form, numbers.len()) {
            return Err(DeskError::CountOfForm { form, count: numbers.len() });
        }
        let is_beyond = |number: &&f64| !number.is_finite() || number.abs() > MAX_NUMBER;
        if let Some(&number) = numbers.iter().find(is_beyond) {
            return Err(DeskError::TooLarge { number });
        }
        let (xyz, rotation) = match form {
            RotationEncoding::Three(convention) => {
                let (xyz, three) = split_last::<3>(numbers);
                (xyz, convention.rotation(three.map(|angle| angle * self.angle.in_rad())))
            }
            RotationEncoding::Xyzw | RotationEncoding::Wxyz => {
                let (xyz, four) = split_last::<4>(numbers);
                let [a, b, c, d] = four;
                let q_xyzw = if form == RotationEncoding::Wxyz { [b, c, d, a] } else { four };
                (xyz, unit_quaternion(q_xyzw)?)
            }
            RotationEncoding::AxisAngle => {
                let (xyz, [x, y, z, angle]) = split_last::<4>(numbers);
                (xyz, rotation_about([x, y, z], angle * self.angle.in_rad())?)
            }
            _ => {
                let (xyz, rows) = matrix_rows(form, numbers)?;
                (xyz, rotation_from_rows(rows)?)
            }
        };
        Ok(pose(xyz.map(|length| length * self.length.in_m()), rotation))
    }
}

impl fmt::Display for NumberEncoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.rotation)?;
        if self.rotation.has_angles() {
            write!(f, ", {}", self.angle.symbol())?;
        }
        if self.has_position {
            write!(f, ", {}", self.length)?;
        }
        Ok(())
    }
}

/// The last `N` numbers, and the three before, or zeros.
fn split_last<const N: usize>(numbers: &[f64]) -> ([f64; 3], [f64; N]) {
    let (xyz, last) = numbers.split_at(numbers.len() - N);
    let mut rotation = [0.0; N];
    rotation.copy_from_slice(last);
    (first_three(xyz), rotation)
}

fn first_three(numbers: &[f64]) -> [f64; 3] {
    match *numbers {
        [x, y, z] => [x, y, z],
        _ => [0.0; 3],
    }
}

fn rotation_about(axis: [f64; 3], angle: f64) -> Result<Rotation, DeskError> {
    let axis = Vec3::from(axis);
    match (axis.norm() - 1.0).abs() <= MAX_DEFECT {
        true => Ok(rotation_from_rotvec(axis.normalize() * angle)),
        false => Err(DeskError::Axis { norm: axis.norm() }),
    }
}

/// Position and rotation rows.
fn matrix_rows(
    form: RotationEncoding,
    numbers: &[f64],
) -> Result<([f64; 3], [[f64; 3]; 3]), DeskError> {
    if matches!(form, RotationEncoding::TwoColumns | RotationEncoding::TwoRows) {
        let (xyz, [a, b, c, d, e, f]) = split_last::<6>(numbers);
        let (first, second) = (Vec3::new(a, b, c), Vec3::new(d, e, f));
        let rows = [first, second, first.cross(&second)].map(Into::into);
        return Ok((xyz, if form == RotationEncoding::TwoRows { rows } else { transpose(rows) }));
    }
    let by_column = form == RotationEncoding::Columns;
    let (width, height) = match numbers.len() {
        9 => (3, 3),
        12 => (4, 3),
        _ => (4, 4),
    };
    let at = |row: usize, column: usize| match by_column {
        true => numbers[column * height + row],
        false => numbers[row * width + column],
    };
    if height == 4 {
        let last = [0, 1, 2, 3].map(|column| at(3, column));
        let far = last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > 1e-6);
        if far {
            return Err(DeskError::LastRow { row: last });
        }
    }
    let xyz = match width {
        4 => [0, 1, 2].map(|row| at(row, 3)),
        _ => [0.0; 3],
    };
    Ok((xyz, [0, 1, 2].map(|row| [0, 1, 2].map(|column| at(row, column)))))
}

/// Orthonormal with determinant −1.
fn is_mirrored(numbers: &[f64]) -> bool {
    let matrix =
        |numbers: &[f64]| matrix_rows(RotationEncoding::Rows, numbers).ok().map(|(_, rows)| rows);
    let mirrored = (numbers.len() == 9).then(|| numbers.iter().map(|c| -c).collect::<Vec<f64>>());
    let rows = mirrored.and_then(|numbers| matrix(&numbers));
    rows.is_some_and(|rows| rotation_from_rows(rows).is_ok())
}

fn transpose(rows: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|column| rows.map(|row| row[column]))
}

fn rotation_from_rows(rows: [[f64; 3]; 3]) -> Result<Rotation, DeskError> {
    match rotation_from_matrix_rows(rows) {
        Some((rotation, defect)) if defect <= MAX_DEFECT => Ok(rotation),
        Some((nearest, defect)) => {
            Err(DeskError::NotOrthonormal { defect, nearest_xyzw: xyzw_from_rotation(&nearest) })
        }
        None => Err(DeskError::NoRotation { determinant: determinant(rows) }),
    }
}

fn determinant([a, b, c]: [[f64; 3]; 3]) -> f64 {
    a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
}

fn unit_quaternion(q_xyzw: [f64; 4]) -> Result<Rotation, DeskError> {
    let norm = norm(q_xyzw);
    rotation_from_xyzw(q_xyzw)
        .filter(|_| (norm - 1.0).abs() <= 10.0 * MAX_DEFECT)
        .ok_or(DeskError::Norm { norm })
}

fn norm(q: [f64; 4]) -> f64 {
    q.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// `max |RᵀR − I|` of a matrix, or a quaternion's norm minus 1; otherwise zero.
pub(super) fn rotation_defect(form: RotationEncoding, numbers: &[f64]) -> f64 {
    match form {
        RotationEncoding::Three(_) | RotationEncoding::AxisAngle => 0.0,
        RotationEncoding::Xyzw | RotationEncoding::Wxyz => {
            (norm(split_last::<4>(numbers).1) - 1.0).abs()
        }
        _ => matrix_rows(form, numbers)
            .ok()
            .and_then(|(_, rows)| rotation_from_matrix_rows(rows))
            .map_or(0.0, |(_, defect)| defect),
    }
}

/// In rad; `None` if the form has no lock.
pub(super) fn gimbal_margin(encoding: &NumberEncoding, numbers: &[f64]) -> Option<f64> {
    match encoding.rotation {
        RotationEncoding::Three(convention) if numbers.len() >= 3 => {
            let (_, three) = split_last::<3>(numbers);
            convention.gimbal_margin(three.map(|angle| angle * encoding.angle.in_rad()))
        }
        _ => None,
    }
}

/// Encodings of `samples` (of equal length) compatible with `known`, most likely first.
///
/// Lengths above 10 are millimetres and above 10,000 micrometres; angles above 1.1 turns are degrees and
/// above 1,000 fractions of degrees. Below that, metres and radians come first; other units are marked as
/// unusual.
///
/// # Errors
/// If there is none: the reason for the most likely one.
pub(super) fn possible_encodings(
    samples: &[&[f64]],
    known: KnownEncoding,
) -> Result<Vec<NumberEncoding>, DeskError> {
    let count = samples.first().map_or(0, |numbers| numbers.len());
    let forms: Vec<RotationEncoding> = match (known.rotation, count) {
        (Some(form), _) => vec![form],
        (None, 3 | 6) => {
            Convention::all().iter().map(|&three| RotationEncoding::Three(three)).collect()
        }
        (None, 4 | 7) => {
            vec![RotationEncoding::Xyzw, RotationEncoding::Wxyz, RotationEncoding::AxisAngle]
        }
        (None, 9) => {
            vec![RotationEncoding::Rows, RotationEncoding::TwoColumns, RotationEncoding::TwoRows]
        }
        (None, 12 | 16) => vec![RotationEncoding::Rows, RotationEncoding::Columns],
        _ => return Err(DeskError::Count { count }),
    };
    let mut found: Vec<NumberEncoding> = Vec::new();
    let mut refusal = None;
    for form in forms {
        // A complete rotation is not interpreted as a partial one.
        let is_partial = matches!(
            form,
            RotationEncoding::AxisAngle | RotationEncoding::TwoColumns | RotationEncoding::TwoRows
        );
        let is_whole = |known: &NumberEncoding| {
            matches!(known.rotation, RotationEncoding::Xyzw | RotationEncoding::Rows)
        };
        if is_partial && (found.iter().any(is_whole) || samples.iter().all(|n| is_mirrored(n))) {
            continue;
        }
        let plain = NumberEncoding {
            rotation: form,
            length: LengthScale::METRE,
            angle: AngleUnit::Radian,
            has_position: has_position(form, count),
            has_unusual_length: false,
            has_unusual_angle: false,
        };
        let poses: Result<Vec<Pose>, DeskError> =
            samples.iter().map(|numbers| plain.pose(numbers)).collect();
        let poses = match poses {
            Ok(poses) => poses,
            Err(error) => {
                refusal = Some(match refusal {
                    // A valid last row makes the other error more informative.
                    Some(first) if !matches!(first, DeskError::LastRow { .. }) => first,
                    _ => error,
                });
                continue;
            }
        };
        // A symmetric matrix is the same pose in row-major and column-major order.
        let is_known = |known: &NumberEncoding| {
            matches!((known.rotation, form), (RotationEncoding::Rows, RotationEncoding::Columns))
                && samples.iter().zip(&poses).all(|(numbers, pose)| {
                    known.pose(numbers).is_ok_and(|known| {
                        (known.to_homogeneous() - pose.to_homogeneous()).amax() < 1e-9
                    })
                })
        };
        if found.iter().any(is_known) {
            continue;
        }
        let longest =
            poses.iter().flat_map(xyz_of).fold(0.0, |longest: f64, x| longest.max(x.abs()));
        let widest = |angles: usize| {
            let last = samples.iter().flat_map(|numbers| &numbers[numbers.len() - angles..]);
            last.fold(0.0, |widest: f64, angle| widest.max(angle.abs()))
        };
        let widest = match form {
            RotationEncoding::Three(_) => widest(3),
            RotationEncoding::AxisAngle => widest(1),
            _ => 0.0,
        };
        let lengths =
            known.units.length.map_or_else(|| length_units(longest), |unit| vec![(unit, false)]);
        let angles =
            known.units.angle.map_or_else(|| angle_units(widest), |unit| vec![(unit, false)]);
        for &(length, has_odd_length) in &lengths {
            for &(angle, has_odd_angle) in &angles {
                found.push(NumberEncoding {
                    length,
                    angle,
                    has_unusual_length: has_odd_length,
                    has_unusual_angle: has_odd_angle,
                    ..plain
                });
            }
        }
    }
    match (found.is_empty(), refusal) {
        (true, Some(refusal)) => Err(refusal),
        (true, None) => Err(DeskError::Count { count }),
        (false, _) => {
            found.sort_by_key(|encoding| {
                (encoding.count_unusual_units(), encoding.rotation.usual_rank())
            });
            Ok(found)
        }
    }
}

/// Each with whether it is unusual for that size.
fn length_units(longest: f64) -> Vec<(LengthScale, bool)> {
    let [metre, millimetre] = [LengthScale::METRE, LengthScale::MILLIMETRE];
    let [centimetre, micrometre] = [1e-2, 1e-6].map(LengthScale::from_m);
    match longest {
        0.0 => vec![(metre, false)],
        longest if longest > MAX_LENGTH_MM => vec![(micrometre, false), (millimetre, true)],
        longest if longest > MAX_LENGTH_CM => vec![(millimetre, false)],
        longest if longest > MAX_LENGTH_M => vec![(millimetre, false), (centimetre, true)],
        _ => vec![(metre, false), (millimetre, true), (centimetre, true)],
    }
}

/// Analogous to [`length_units`].
fn angle_units(widest: f64) -> Vec<(AngleUnit, bool)> {
    match widest {
        0.0 => vec![(AngleUnit::Radian, false)],
        widest if widest > MAX_ANGLE_DEG => {
            vec![(AngleUnit::TenthMillidegree, false), (AngleUnit::Millidegree, false)]
        }
        widest if widest > MAX_ANGLE_RAD => vec![(AngleUnit::Degree, false)],
        _ => vec![(AngleUnit::Radian, false), (AngleUnit::Degree, true)],
    }
}
