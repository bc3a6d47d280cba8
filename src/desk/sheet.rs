//! Converts one pose to every convention.

use crate::geometry::{
    AngleUnit, CodeLine, Convention, LengthScale, Pose, Rotation, RotationEncoding, Vec3,
    code_of_numbers, code_of_quaternion, xyzw_from_rotation,
};

use super::error::DeskError;
use super::form::{LOCK_RAD, Reading, SAID_DEFECT, Style, defect, readings};
use super::frames::worlds;
use super::paste::Pasted;
use crate::geometry::vendors::{LibraryName, VendorUse, library_names, uses_of};

/// Pose in one convention.
#[derive(Clone, Debug)]
pub struct Row {
    /// The convention.
    pub form: RotationEncoding,
    /// Rotation, angles in rad; nine for a matrix.
    pub numbers: Vec<f64>,
    /// Distance to gimbal lock, rad; `None` without one.
    pub gimbal_margin_rad: Option<f64>,
    /// Users of the convention.
    pub uses: Vec<&'static VendorUse>,
    /// Its names in libraries.
    pub names: Vec<LibraryName>,
}

impl Row {
    fn of(form: RotationEncoding, numbers: Vec<f64>) -> Self {
        Self {
            gimbal_margin_rad: None,
            uses: uses_of(form).collect(),
            names: library_names(form),
            form,
            numbers,
        }
    }

    /// Whether within 5° of gimbal lock.
    pub fn is_near_lock(&self) -> bool {
        self.gimbal_margin_rad.is_some_and(|margin_rad| margin_rad < LOCK_RAD)
    }
}

/// Pose in every convention.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Encoding of the input.
    pub reading: Reading,
    /// The pose.
    pub pose: Pose,
    /// Whether the input has a position.
    pub has_position: bool,
    /// Quaternions, rotation vector, matrix, then Euler orders, most common first.
    pub rows: Vec<Row>,
    /// The pose in other axis conventions.
    pub worlds: Vec<(&'static str, Pose)>,
    /// Code for the given numbers, if three.
    pub code_of_numbers: Vec<CodeLine>,
    /// Code for the quaternion.
    pub code_of_quaternion: Vec<CodeLine>,
    /// Assumptions and warnings.
    pub notes: Vec<String>,
}

/// Pose in one of several possible conventions.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The convention.
    pub reading: Reading,
    /// The resulting pose.
    pub pose: Pose,
    /// Users of the convention.
    pub uses: Vec<&'static VendorUse>,
}

/// Result for one text.
#[derive(Clone, Debug)]
pub enum Sheets {
    /// The encoding is determined.
    One(Box<Sheet>),
    /// Ambiguous among conventions with known users.
    Several {
        /// Candidates, most common first.
        candidates: Vec<Candidate>,
        /// Assumptions.
        notes: Vec<String>,
    },
}

/// Interprets `pasted`; `style` overrides its own.
///
/// # Errors
/// If the numbers are not a pose in that style.
pub fn sheet(pasted: &Pasted, style: Style) -> Result<Sheets, DeskError> {
    let known = style.or(pasted.style);
    let readings = readings(&[&pasted.numbers], known)?;
    let mut usual: Vec<Reading> = Vec::new();
    for reading in readings.into_iter().filter(|reading| reading.odd_units() == 0) {
        let is_used = known.form.is_some() || uses_of(reading.form).next().is_some();
        if is_used {
            usual.push(reading);
        }
    }
    let mut notes = Vec::new();
    let count = pasted.numbers.len();
    if let Some(first) = usual.first() {
        notes.extend(unit_notes(first, known));
    }
    if count == 9
        && usual.first().is_some_and(|first| first.form == RotationEncoding::Rows)
        && known.form.is_none()
    {
        notes.push("row-major assumed; for column-major use --from matrix:columns".to_owned());
    }
    match usual.as_slice() {
        [reading] => {
            let sheet = one(*reading, pasted, notes)?;
            Ok(Sheets::One(Box::new(sheet)))
        }
        several => {
            let candidates = several.iter().map(|reading| {
                let pose = reading.pose(&pasted.numbers)?;
                Ok(Candidate { reading: *reading, pose, uses: uses_of(reading.form).collect() })
            });
            let candidates = candidates.collect::<Result<Vec<_>, DeskError>>()?;
            Ok(Sheets::Several { candidates, notes })
        }
    }
}

fn unit_notes(reading: &Reading, known: Style) -> Vec<String> {
    let mut notes = Vec::new();
    if reading.has_position && known.units.length.is_none() {
        let length = reading.length;
        notes.push(match length {
            LengthScale::METRE => {
                "metres assumed: no length exceeds 10; override with --mm".to_owned()
            }
            LengthScale::MILLIMETRE => {
                "millimetres assumed: a length exceeds 10; override with --m".to_owned()
            }
            _ => format!(
                "{} assumed: a length exceeds 10,000; override with --mm",
                length.plural_name()
            ),
        });
    }
    if reading.form.has_angles() && known.units.angle.is_none() {
        notes.push(match reading.angle {
            AngleUnit::Radian => {
                "radians assumed: no angle exceeds 6.9; override with --deg".to_owned()
            }
            AngleUnit::Degree => {
                "degrees assumed: an angle exceeds 6.9; override with --rad".to_owned()
            }
            parts => {
                format!(
                    "{} assumed: an angle exceeds 1,000; override with --deg",
                    parts.plural_name()
                )
            }
        });
    }
    notes
}

fn one(reading: Reading, pasted: &Pasted, mut notes: Vec<String>) -> Result<Sheet, DeskError> {
    let pose = reading.pose(&pasted.numbers)?;
    let missed = defect(reading.form, &pasted.numbers);
    if missed > SAID_DEFECT {
        notes.push(match reading.form {
            form if form.is_matrix() => {
                format!(
                    "the matrix is not exactly orthonormal (max |RᵀR − I| {missed:.1e}); using the \
                    nearest rotation"
                )
            }
            _ => format!("the quaternion's norm differs from 1 by {missed:.1e}; it was normalised"),
        });
    }
    let rotation = &pose.rotation;
    let [x, y, z, w] = xyzw_from_rotation(rotation);
    let matrix = rotation.to_rotation_matrix();
    let by_rows: Vec<f64> = matrix.matrix().transpose().iter().map(|c| c + 0.0).collect();
    let by_columns: Vec<f64> = matrix.matrix().iter().map(|c| c + 0.0).collect();
    let mut rows = vec![
        Row::of(RotationEncoding::Xyzw, vec![x, y, z, w]),
        Row::of(RotationEncoding::Wxyz, vec![w, x, y, z]),
        Row::of(RotationEncoding::Rows, by_rows.clone()),
        Row::of(RotationEncoding::TwoColumns, by_columns[..6].to_vec()),
        Row::of(RotationEncoding::TwoRows, by_rows[..6].to_vec()),
        Row::of(RotationEncoding::Columns, by_columns),
        Row::of(RotationEncoding::AxisAngle, axis_angle(rotation)),
    ];
    rows.extend(Convention::all().iter().map(|&convention| {
        let numbers = convention.numbers(rotation);
        let mut row = Row::of(RotationEncoding::Three(convention), numbers.to_vec());
        row.gimbal_margin_rad = convention.gimbal_margin(numbers);
        row
    }));
    let own = rows.iter().find(|row| row.form == reading.form);
    if let Some((row, margin_rad)) = own.and_then(|row| Some((row, row.gimbal_margin_rad?)))
        && row.is_near_lock()
    {
        notes.push(format!(
            "{:.2}° from gimbal lock of {}: the outer angles are nearly degenerate",
            margin_rad.to_degrees(),
            row.form
        ));
    }
    let code_of_numbers = match reading.form {
        RotationEncoding::Three(convention) => {
            let given = &pasted.numbers[pasted.numbers.len() - 3..];
            let numbers = [0, 1, 2].map(|at| literal(given[at] * reading.angle.in_rad()));
            code_of_numbers(convention, numbers)
        }
        _ => Vec::new(),
    };
    Ok(Sheet {
        has_position: reading.has_position,
        worlds: worlds()
            .iter()
            .map(|world| (world.who.as_str(), world.axes.pose_from_standard(&pose)))
            .collect(),
        code_of_numbers,
        code_of_quaternion: code_of_quaternion(xyzw_from_rotation(rotation).map(literal)),
        reading,
        pose,
        rows,
        notes,
    })
}

/// Unit vector, and angle, rad.
fn axis_angle(rotation: &Rotation) -> Vec<f64> {
    let axis = rotation.axis().map_or(Vec3::z(), |axis| axis.into_inner());
    vec![axis.x, axis.y, axis.z, rotation.angle()]
}

/// Rounded to 1e-9; a float literal in every language.
fn literal(value: f64) -> String {
    format!("{:?}", (value * 1e9).round() / 1e9 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desk::paste;
    use crate::geometry::{angle_between, rotation_from_xyzw, xyz_of};

    fn one(text: &str, style: &str) -> Sheet {
        let style = if style.is_empty() { Style::default() } else { style.parse().unwrap() };
        match sheet(&paste(text).unwrap(), style).unwrap() {
            Sheets::One(sheet) => *sheet,
            Sheets::Several { candidates, .. } => panic!("{candidates:?}"),
        }
    }

    fn numbers(sheet: &Sheet, form: &str) -> Vec<f64> {
        let form: RotationEncoding = form.parse().unwrap();
        sheet.rows.iter().find(|row| row.form == form).unwrap().numbers.clone()
    }

    #[track_caller]
    fn assert_near(found: &[f64], expected: &[f64], within: f64) {
        assert_eq!(found.len(), expected.len());
        let far = found.iter().zip(expected).any(|(a, b)| (a - b).abs() > within);
        assert!(!far, "{found:?} is not {expected:?}");
    }

    #[test]
    fn the_sample_of_aubos_sdk_is_its_quaternion() {
        // Vendor's example: rpy, rad, and quaternion w, x, y, z.
        let sheet = one("0.611 0.785 0.960", "aubo");
        let expected = [0.834722, 0.078043, 0.451893, 0.304864];
        assert_near(&numbers(&sheet, "quat:wxyz"), &expected, 1e-6);
    }

    #[test]
    fn a_pendants_pose_is_said_in_every_convention() {
        let sheet = one("243.69 -249.04 618.32 149.49 -12.78 72.64", "euler:xyz,deg,mm");
        assert_near(&xyz_of(&sheet.pose), &[0.24369, -0.24904, 0.61832], 1e-12);
        assert_eq!(sheet.rows.len(), 7 + 29);
        assert_near(
            &numbers(&sheet, "euler:ZYX"),
            &[72.64, -12.78, 149.49].map(f64::to_radians),
            1e-12,
        );
        for row in &sheet.rows {
            let reading = Reading { form: row.form, ..one("0 0 0", "rotvec,rad,m").reading };
            let again = reading.pose(&row.numbers).unwrap();
            assert!(angle_between(&again.rotation, &sheet.pose.rotation) < 1e-9, "{}", row.form);
        }
    }

    #[test]
    fn what_text_says_needs_no_flag() {
        let literal = one("p[0.1, 0.2, 0.3, 0, 3.14, 0]", "");
        assert_eq!(literal.reading.form.to_string(), "rotvec");
        let origin = one(r#"<origin xyz="0 0 0" rpy="1.570796327 0 1.570796327"/>"#, "");
        assert_near(&numbers(&origin, "quat:xyzw"), &[0.5, 0.5, 0.5, 0.5], 1e-9);
    }

    #[test]
    fn frankas_matrix_goes_by_columns_and_rokaes_by_rows() {
        let columns = one("0 1 0 0  -1 0 0 0  0 0 1 0  0.3 0.1 0.5 1", "");
        let rows = one("0 -1 0 0.3  1 0 0 0.1  0 0 1 0.5  0 0 0 1", "");
        assert_eq!(columns.reading.form, RotationEncoding::Columns);
        assert_eq!(rows.reading.form, RotationEncoding::Rows);
        assert_eq!(columns.pose, rows.pose);
        let columns = one("0 1 0  -1 0 0  0 0 1  0.3 0.1 0.5", "");
        assert_eq!((columns.reading.form, columns.pose), (RotationEncoding::Columns, rows.pose));
        let short = one("0 -1 0 0.3  1 0 0 0.1  0 0 1 0.5", "");
        assert_eq!((short.reading.form, short.pose), (RotationEncoding::Rows, rows.pose));
    }

    #[test]
    fn a_bare_order_is_left_open() {
        let pasted = paste("243.69 -249.04 618.32 149.49 -12.78 72.64").unwrap();
        let Sheets::Several { candidates, notes } = sheet(&pasted, Style::default()).unwrap()
        else {
            panic!("it was settled");
        };
        let names: Vec<String> =
            candidates.iter().map(|candidate| candidate.reading.form.to_string()).collect();
        assert_eq!(names[..3], ["rotvec", "euler:xyz", "euler:ZYX"]);
        assert!(notes.iter().any(|note| note.starts_with("millimetres")));
        let pasted = paste("0 0 1 0.1 0.2 0.3 0.927").unwrap();
        assert!(matches!(sheet(&pasted, Style::default()), Ok(Sheets::Several { .. })));
    }

    #[test]
    fn lock_is_warned_of() {
        let locked = one("0 0 0 10 88 20", "euler:xyz,deg,m");
        assert!(locked.notes.iter().any(|note| note.starts_with("2.00° from gimbal lock")));
        let free = one("0 0 0 10 60 20", "euler:xyz,deg,m");
        assert!(!free.notes.iter().any(|note| note.contains("lock")), "{:?}", free.notes);
    }

    #[test]
    fn a_matrix_that_is_none_is_refused_with_the_nearest_rotation() {
        let refused = |text: &str| sheet(&paste(text).unwrap(), Style::default()).unwrap_err();
        let error = refused("1 0 0  0 0.9 0  0 0 1");
        let DeskError::NotOrthonormal { defect, nearest_xyzw } = error else { panic!("{error}") };
        assert!((defect - 0.19).abs() < 1e-12);
        let nearest = rotation_from_xyzw(nearest_xyzw).unwrap();
        assert!(nearest.angle() < 1e-12);
        let mirrored = refused("1 0 0  0 1 0  0 0 -1");
        assert_eq!(mirrored, DeskError::NoRotation { determinant: -1.0 });
        assert!(matches!(refused("1 0.5 0 0.9"), DeskError::Norm { .. }));
    }
}
