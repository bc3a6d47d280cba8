//! How the numbers of a pose are coded: their form, their order, their units.

use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

use crate::geometry::{
    AngleUnit, Convention, LengthUnit, Pose, Rotation, pose, rotation_from_matrix_rows,
    rotation_from_xyzw, xyz_of, xyzw_from_rotation,
};

use super::error::DeskError;
use super::usage;

/// How far a matrix, `max |RᵀR − I|`, or a quaternion's norm may be off before it is refused.
const REFUSED_DEFECT: f64 = 1e-2;

/// The defect from which it is said.
pub(super) const SAID_DEFECT: f64 = 1e-3;

/// The margin to gimbal lock, rad, below which it is said: that of ORD006.
pub(super) const LOCK_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// A length, in the unit as given, beyond which it is not in metres.
const LONGEST_M: f64 = 10.0;

/// An angle, in the unit as given, beyond which it is not in radians.
const WIDEST_RAD: f64 = 1.1 * TAU;

/// In which form numbers code a rotation, and in which order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Three numbers.
    Three(Convention),
    /// Four numbers x, y, z, w.
    Xyzw,
    /// Four numbers w, x, y, z.
    Wxyz,
    /// A matrix row by row: nine numbers, or twelve or sixteen with the position.
    Rows,
    /// The same column by column.
    Columns,
}

impl Form {
    /// Whether its rotation numbers are angles.
    pub fn has_angles(self) -> bool {
        matches!(self, Self::Three(_))
    }

    /// Whether `count` numbers can be a pose, or a rotation alone, in this form.
    fn takes(self, count: usize) -> bool {
        match self {
            Self::Three(_) => matches!(count, 3 | 6),
            Self::Xyzw | Self::Wxyz => matches!(count, 4 | 7),
            Self::Rows | Self::Columns => matches!(count, 9 | 12 | 16),
        }
    }

    /// How unusual it is, from 0.
    pub(super) fn usual_rank(self) -> u8 {
        match self {
            Self::Three(convention) => convention.usual_rank(),
            Self::Xyzw | Self::Rows => 0,
            Self::Wxyz | Self::Columns => 1,
        }
    }
}

impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Three(convention) => convention.fmt(f),
            Self::Xyzw => f.write_str("quat:xyzw"),
            Self::Wxyz => f.write_str("quat:wxyz"),
            Self::Rows => f.write_str("matrix:rows"),
            Self::Columns => f.write_str("matrix:columns"),
        }
    }
}

impl FromStr for Form {
    type Err = DeskError;

    fn from_str(name: &str) -> Result<Self, DeskError> {
        Ok(match name {
            "quat:xyzw" => Self::Xyzw,
            "quat:wxyz" => Self::Wxyz,
            "matrix:rows" => Self::Rows,
            "matrix:columns" => Self::Columns,
            name => Self::Three(name.parse().map_err(|source| DeskError::Form { source })?),
        })
    }
}

/// What is known of how numbers are coded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Style {
    /// The form.
    pub form: Option<Form>,
    /// The unit of the position.
    pub length: Option<LengthUnit>,
    /// The unit of the angles.
    pub angle: Option<AngleUnit>,
}

impl Style {
    /// This, and where it says nothing what `other` says.
    pub fn or(self, other: Self) -> Self {
        Self {
            form: self.form.or(other.form),
            length: self.length.or(other.length),
            angle: self.angle.or(other.angle),
        }
    }
}

/// `FORM`, `NAME` of a maker, and units, with commas: `euler:ZYX,deg,mm`, `kuka`, `mm`.
impl FromStr for Style {
    type Err = DeskError;

    fn from_str(text: &str) -> Result<Self, DeskError> {
        /// Sets what is not set to something else.
        fn set<T: PartialEq>(known: &mut Option<T>, to: T, part: &str) -> Result<(), DeskError> {
            match known.replace(to) {
                Some(before) if known.as_ref() != Some(&before) => {
                    Err(DeskError::Contradiction { unit: part.to_owned() })
                }
                _ => Ok(()),
            }
        }
        let mut style = Self::default();
        let mut of_maker = Self::default();
        for part in text.split(',').map(str::trim) {
            match part {
                "deg" => set(&mut style.angle, AngleUnit::Degree, part)?,
                "rad" => set(&mut style.angle, AngleUnit::Radian, part)?,
                "mm" => set(&mut style.length, LengthUnit::Millimetre, part)?,
                "m" => set(&mut style.length, LengthUnit::Metre, part)?,
                part => match usage::style_of(part) {
                    Some(style) => of_maker = style,
                    None => style.form = Some(part.parse()?),
                },
            }
        }
        Ok(style.or(of_maker))
    }
}

/// One way to read numbers as a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// The form of the rotation.
    pub form: Form,
    /// The unit of the position.
    pub length: LengthUnit,
    /// The unit of the angles; of no matter where there are none.
    pub angle: AngleUnit,
    /// Whether the numbers hold a position; if not its unit is of no matter.
    pub has_position: bool,
    /// Whether the unit of the position is other than the numbers' size suggests.
    pub has_odd_length: bool,
    /// Whether the unit of the angles is.
    pub has_odd_angle: bool,
}

/// No number of a pose is larger, in whatever unit.
const FARTHEST: f64 = 1e9;

impl Reading {
    /// How many units are other than the numbers' size suggests.
    pub fn odd_units(&self) -> u8 {
        u8::from(self.has_odd_length) + u8::from(self.has_odd_angle)
    }

    /// The pose that `numbers` code, its position zero where they are a rotation alone.
    ///
    /// # Errors
    /// Where their number does not fit the form, or they are no rotation.
    pub fn pose(&self, numbers: &[f64]) -> Result<Pose, DeskError> {
        let form = self.form;
        if !form.takes(numbers.len()) {
            return Err(DeskError::CountOfForm { form, count: numbers.len() });
        }
        let is_beyond = |number: &&f64| !number.is_finite() || number.abs() > FARTHEST;
        if let Some(&number) = numbers.iter().find(is_beyond) {
            return Err(DeskError::Beyond { number });
        }
        let (xyz, rotation) = match form {
            Form::Three(convention) => {
                let (xyz, three) = before_last::<3>(numbers);
                (xyz, convention.rotation(three.map(|angle| angle * self.angle.in_rad())))
            }
            Form::Xyzw | Form::Wxyz => {
                let (xyz, four) = before_last::<4>(numbers);
                let [a, b, c, d] = four;
                let q_xyzw = if form == Form::Wxyz { [b, c, d, a] } else { four };
                (xyz, unit_quaternion(q_xyzw)?)
            }
            Form::Rows | Form::Columns => {
                let (xyz, rows) = matrix(numbers, form == Form::Columns)?;
                (xyz, orthonormal(rows)?)
            }
        };
        Ok(pose(xyz.map(|length| length * self.length.in_m()), rotation))
    }
}

impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.form)?;
        if self.form.has_angles() {
            write!(f, ", {}", self.angle.symbol())?;
        }
        if self.has_position {
            write!(f, ", {}", self.length.symbol())?;
        }
        Ok(())
    }
}

/// Whether that many numbers hold a position.
pub(super) fn has_position(count: usize) -> bool {
    matches!(count, 6 | 7 | 12 | 16)
}

/// The last `N` numbers, and the three before them or zeros.
fn before_last<const N: usize>(numbers: &[f64]) -> ([f64; 3], [f64; N]) {
    let (xyz, last) = numbers.split_at(numbers.len() - N);
    let mut rotation = [0.0; N];
    rotation.copy_from_slice(last);
    (three(xyz), rotation)
}

fn three(numbers: &[f64]) -> [f64; 3] {
    match *numbers {
        [x, y, z] => [x, y, z],
        _ => [0.0; 3],
    }
}

/// The position and the rows of the rotation in 9, 12 or 16 numbers.
fn matrix(numbers: &[f64], by_column: bool) -> Result<([f64; 3], [[f64; 3]; 3]), DeskError> {
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

fn orthonormal(rows: [[f64; 3]; 3]) -> Result<Rotation, DeskError> {
    match rotation_from_matrix_rows(rows) {
        Some((rotation, defect)) if defect <= REFUSED_DEFECT => Ok(rotation),
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
    let norm = norm_of(q_xyzw);
    rotation_from_xyzw(q_xyzw)
        .filter(|_| (norm - 1.0).abs() <= 10.0 * REFUSED_DEFECT)
        .ok_or(DeskError::Norm { norm })
}

fn norm_of(q: [f64; 4]) -> f64 {
    q.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// By how much the rotation numbers miss a rotation: a matrix `max |RᵀR − I|`, a quaternion its norm
/// minus 1; zero where nothing can be missed.
pub(super) fn defect(form: Form, numbers: &[f64]) -> f64 {
    match form {
        Form::Three(_) => 0.0,
        Form::Xyzw | Form::Wxyz => (norm_of(before_last::<4>(numbers).1) - 1.0).abs(),
        Form::Rows | Form::Columns => matrix(numbers, form == Form::Columns)
            .ok()
            .and_then(|(_, rows)| rotation_from_matrix_rows(rows))
            .map_or(0.0, |(_, defect)| defect),
    }
}

/// How far the angles of `numbers` are from gimbal lock, rad; none where they have no such thing.
pub(super) fn gimbal_margin(reading: &Reading, numbers: &[f64]) -> Option<f64> {
    match reading.form {
        Form::Three(convention) if numbers.len() >= 3 => {
            let (_, three) = before_last::<3>(numbers);
            convention.gimbal_margin(three.map(|angle| angle * reading.angle.in_rad()))
        }
        _ => None,
    }
}

/// Every way in which `samples`, all of one length, can be read within `style`; the likeliest first.
///
/// Lengths above 10 are millimetres, angles above 1.1 turns degrees; below, metres and radians come
/// first and the others after them, as odd.
///
/// # Errors
/// Where there is none; then why the likeliest is not.
pub(super) fn readings(samples: &[&[f64]], style: Style) -> Result<Vec<Reading>, DeskError> {
    let count = samples.first().map_or(0, |numbers| numbers.len());
    let forms: Vec<Form> = match (style.form, count) {
        (Some(form), _) => vec![form],
        (None, 3 | 6) => Convention::all().iter().map(|&three| Form::Three(three)).collect(),
        (None, 4 | 7) => vec![Form::Xyzw, Form::Wxyz],
        (None, 9) => vec![Form::Rows],
        (None, 12 | 16) => vec![Form::Rows, Form::Columns],
        _ => return Err(DeskError::Count { count }),
    };
    let mut found: Vec<Reading> = Vec::new();
    let mut refusal = None;
    for form in forms {
        let plain = Reading {
            form,
            length: LengthUnit::Metre,
            angle: AngleUnit::Radian,
            has_position: has_position(count),
            has_odd_length: false,
            has_odd_angle: false,
        };
        let poses: Result<Vec<Pose>, DeskError> =
            samples.iter().map(|numbers| plain.pose(numbers)).collect();
        let poses = match poses {
            Ok(poses) => poses,
            Err(error) => {
                refusal = Some(match refusal {
                    // Of two orders of a matrix the one whose last row is right says what is wrong.
                    Some(first) if !matches!(first, DeskError::LastRow { .. }) => first,
                    _ => error,
                });
                continue;
            }
        };
        // A symmetric matrix is one pose by rows and by columns.
        let is_known = |known: &Reading| {
            matches!((known.form, form), (Form::Rows, Form::Columns))
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
        let widest = match form {
            Form::Three(_) => samples
                .iter()
                .flat_map(|numbers| before_last::<3>(numbers).1)
                .fold(0.0, |widest: f64, angle| widest.max(angle.abs())),
            _ => 0.0,
        };
        let lengths = match (style.length, longest) {
            (Some(unit), _) => vec![(unit, false)],
            (None, 0.0) => vec![(LengthUnit::Metre, false)],
            (None, longest) if longest > LONGEST_M => vec![(LengthUnit::Millimetre, false)],
            (None, _) => vec![(LengthUnit::Metre, false), (LengthUnit::Millimetre, true)],
        };
        let angles = match (style.angle, widest) {
            (Some(unit), _) => vec![(unit, false)],
            (None, 0.0) => vec![(AngleUnit::Radian, false)],
            (None, widest) if widest > WIDEST_RAD => vec![(AngleUnit::Degree, false)],
            (None, _) => vec![(AngleUnit::Radian, false), (AngleUnit::Degree, true)],
        };
        for &(length, has_odd_length) in &lengths {
            for &(angle, has_odd_angle) in &angles {
                found.push(Reading { length, angle, has_odd_length, has_odd_angle, ..plain });
            }
        }
    }
    match (found.is_empty(), refusal) {
        (true, Some(refusal)) => Err(refusal),
        (true, None) => Err(DeskError::Count { count }),
        (false, _) => {
            found.sort_by_key(|reading| (reading.odd_units(), reading.form.usual_rank()));
            Ok(found)
        }
    }
}
