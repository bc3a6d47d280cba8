//! Converts one pose to every convention.

use crate::geometry::{
    AngleUnit, CodeLine, Convention, LengthScale, Pose, Rotation, RotationEncoding, Vec3,
    code_of_numbers, code_of_quaternion, xyzw_from_rotation,
};

use super::encoding::{
    GIMBAL_LOCK_RAD, KnownEncoding, MAX_ANGLE_RAD, MAX_LENGTH_M, MIN_NOTED_DEFECT, NumberEncoding,
    possible_encodings, rotation_defect,
};
use super::error::DeskError;
use super::fixed_frames::worlds;
use super::parse::PoseText;
use crate::geometry::vendors::{LibraryName, VendorUse, library_names, uses_of};

/// Pose in one convention.
#[derive(Clone, Debug)]
pub struct ConventionRow {
    /// The convention.
    pub rotation: RotationEncoding,
    /// Rotation, angles in rad; nine for a matrix.
    pub numbers: Vec<f64>,
    /// Distance to gimbal lock, rad; `None` without one.
    pub gimbal_margin_rad: Option<f64>,
    /// Users of the convention.
    pub uses: Vec<&'static VendorUse>,
    /// Its names in libraries.
    pub names: Vec<LibraryName>,
}

impl ConventionRow {
    fn new(form: RotationEncoding, numbers: Vec<f64>) -> Self {
        Self {
            gimbal_margin_rad: None,
            uses: uses_of(form).collect(),
            names: library_names(form),
            rotation: form,
            numbers,
        }
    }

    /// Whether within 5° of gimbal lock.
    pub fn is_near_gimbal_lock(&self) -> bool {
        self.gimbal_margin_rad.is_some_and(|margin_rad| margin_rad < GIMBAL_LOCK_RAD)
    }
}

/// Pose in every convention.
#[derive(Clone, Debug)]
pub struct PoseConversions {
    /// Encoding of the input.
    pub encoding: NumberEncoding,
    /// The pose.
    pub pose: Pose,
    /// Whether the input has a position.
    pub has_position: bool,
    /// Quaternions, rotation vector, matrix, then Euler orders, most common first.
    pub rows: Vec<ConventionRow>,
    /// The pose in other axis conventions.
    pub worlds: Vec<(&'static str, Pose)>,
    /// Code for the given numbers, if three.
    pub numbers_code: Vec<CodeLine>,
    /// Code for the quaternion.
    pub quaternion_code: Vec<CodeLine>,
    /// Assumptions and warnings.
    pub notes: Vec<String>,
}

/// Pose in one of several possible conventions.
#[derive(Clone, Debug)]
pub struct ConversionCandidate {
    /// The convention.
    pub encoding: NumberEncoding,
    /// The resulting pose.
    pub pose: Pose,
    /// Users of the convention.
    pub uses: Vec<&'static VendorUse>,
}

/// Result for one text.
#[derive(Clone, Debug)]
pub enum ConversionResult {
    /// The encoding is determined.
    Determined(Box<PoseConversions>),
    /// Ambiguous among conventions with known users.
    Ambiguous {
        /// Candidates, most common first.
        candidates: Vec<ConversionCandidate>,
        /// Assumptions.
        notes: Vec<String>,
    },
}

/// Interprets `pose_text`; `encoding` overrides its own.
///
/// # Errors
/// If the numbers are not a pose in that style.
pub fn convert(pose_text: &PoseText, known: KnownEncoding) -> Result<ConversionResult, DeskError> {
    let known = known.or(pose_text.encoding);
    let encodings = possible_encodings(&[&pose_text.numbers], known)?;
    let mut usual: Vec<NumberEncoding> = Vec::new();
    for encoding in encodings.into_iter().filter(|encoding| encoding.count_unusual_units() == 0) {
        let is_used = known.rotation.is_some() || uses_of(encoding.rotation).next().is_some();
        if is_used {
            usual.push(encoding);
        }
    }
    let mut notes = Vec::new();
    let count = pose_text.numbers.len();
    if let Some(first) = usual.first() {
        notes.extend(assumed_units(first, known));
        notes.extend(implausible_sizes(first, known, &pose_text.numbers)?);
    }
    if count == 9
        && usual.first().is_some_and(|first| first.rotation == RotationEncoding::Rows)
        && known.rotation.is_none()
    {
        notes.push("row-major assumed; for column-major use --from matrix:columns".to_owned());
    }
    match usual.as_slice() {
        [encoding] => {
            let conversions = convert_determined(*encoding, pose_text, notes)?;
            Ok(ConversionResult::Determined(Box::new(conversions)))
        }
        several => {
            let candidates = several.iter().map(|encoding| {
                let pose = encoding.pose(&pose_text.numbers)?;
                Ok(ConversionCandidate {
                    encoding: *encoding,
                    pose,
                    uses: uses_of(encoding.rotation).collect(),
                })
            });
            let candidates = candidates.collect::<Result<Vec<_>, DeskError>>()?;
            Ok(ConversionResult::Ambiguous { candidates, notes })
        }
    }
}

/// The units that the sizes of the numbers suggest, and how to override them.
fn assumed_units(encoding: &NumberEncoding, known: KnownEncoding) -> Option<String> {
    let length = match encoding.length {
        _ if !encoding.has_position || known.units.length.is_some() => None,
        LengthScale::METRE => Some("metres (no length exceeds 10; else --mm)".to_owned()),
        LengthScale::MILLIMETRE => Some("millimetres (a length exceeds 10; else --m)".to_owned()),
        other => Some(format!("{} (a length exceeds 10,000; else --mm)", other.plural_name())),
    };
    let angle = match encoding.angle {
        _ if !encoding.rotation.has_angles() || known.units.angle.is_some() => None,
        AngleUnit::Radian => Some("radians (no angle exceeds 6.9; else --deg)".to_owned()),
        AngleUnit::Degree => Some("degrees (an angle exceeds 6.9; else --rad)".to_owned()),
        parts => Some(format!("{} (an angle exceeds 1,000; else --deg)", parts.plural_name())),
    };
    let units: Vec<String> = [length, angle].into_iter().flatten().collect();
    (!units.is_empty()).then(|| format!("assumed: {}", units.join(", ")))
}

/// Stated units that make a position or an angle too large for an arm.
fn implausible_sizes(
    encoding: &NumberEncoding,
    known: KnownEncoding,
    numbers: &[f64],
) -> Result<Vec<String>, DeskError> {
    /// Less than the size of a robot's base, m.
    const MIN_DISTANCE_M: f64 = 2e-3;
    let mut notes = Vec::new();
    let position_m = encoding.pose(numbers)?.translation.vector.norm();
    let is_tiny = position_m > 0.0 && position_m < MIN_DISTANCE_M;
    if encoding.has_position && encoding.length != LengthScale::METRE && is_tiny {
        notes.push(format!(
            "the position is {:.2} mm from the origin; if the numbers are metres, add --m",
            1e3 * position_m
        ));
    }
    if encoding.has_position && known.units.length.is_some() && position_m > MAX_LENGTH_M {
        notes.push(format!(
            "no arm reaches {position_m:.1} m; if the numbers are millimetres, add --mm"
        ));
    }
    let angles = match encoding.rotation {
        RotationEncoding::Three(_) => 3,
        RotationEncoding::AxisAngle => 1,
        _ => 0,
    };
    let angles = numbers[numbers.len().saturating_sub(angles)..].iter();
    let widest = angles.fold(0.0, |widest: f64, angle| widest.max(angle.abs()));
    if known.units.angle == Some(AngleUnit::Radian) && widest > MAX_ANGLE_RAD {
        notes.push(format!(
            "{widest} rad is more than a turn; if the angles are degrees, add --deg"
        ));
    }
    Ok(notes)
}

fn convert_determined(
    encoding: NumberEncoding,
    pose_text: &PoseText,
    mut notes: Vec<String>,
) -> Result<PoseConversions, DeskError> {
    let pose = encoding.pose(&pose_text.numbers)?;
    let missed = rotation_defect(encoding.rotation, &pose_text.numbers);
    if missed > MIN_NOTED_DEFECT {
        notes.push(match encoding.rotation {
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
        ConventionRow::new(RotationEncoding::Xyzw, vec![x, y, z, w]),
        ConventionRow::new(RotationEncoding::Wxyz, vec![w, x, y, z]),
        ConventionRow::new(RotationEncoding::Rows, by_rows.clone()),
        ConventionRow::new(RotationEncoding::TwoColumns, by_columns[..6].to_vec()),
        ConventionRow::new(RotationEncoding::TwoRows, by_rows[..6].to_vec()),
        ConventionRow::new(RotationEncoding::Columns, by_columns),
        ConventionRow::new(RotationEncoding::AxisAngle, axis_angle(rotation)),
    ];
    rows.extend(Convention::all().iter().map(|&convention| {
        let numbers = convention.numbers(rotation);
        let mut row = ConventionRow::new(RotationEncoding::Three(convention), numbers.to_vec());
        row.gimbal_margin_rad = convention.gimbal_margin(numbers);
        row
    }));
    let own = rows.iter().find(|row| row.rotation == encoding.rotation);
    if let Some((row, margin_rad)) = own.and_then(|row| Some((row, row.gimbal_margin_rad?)))
        && row.is_near_gimbal_lock()
    {
        notes.push(format!(
            "{:.2}° from gimbal lock of {}: the outer angles are nearly degenerate",
            margin_rad.to_degrees(),
            row.rotation
        ));
    }
    let code_of_numbers = match encoding.rotation {
        RotationEncoding::Three(convention) => {
            let given = &pose_text.numbers[pose_text.numbers.len() - 3..];
            let numbers = [0, 1, 2].map(|at| float_literal(given[at] * encoding.angle.in_rad()));
            code_of_numbers(convention, numbers)
        }
        _ => Vec::new(),
    };
    Ok(PoseConversions {
        has_position: encoding.has_position,
        worlds: worlds()
            .iter()
            .map(|world| (world.who.as_str(), world.axes.pose_from_standard(&pose)))
            .collect(),
        numbers_code: code_of_numbers,
        quaternion_code: code_of_quaternion(xyzw_from_rotation(rotation).map(float_literal)),
        encoding,
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
fn float_literal(value: f64) -> String {
    format!("{:?}", (value * 1e9).round() / 1e9 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desk::parse_pose;
    use crate::geometry::{angle_between, rotation_from_xyzw, xyz_of};

    fn one(text: &str, known: &str) -> PoseConversions {
        let known =
            if known.is_empty() { KnownEncoding::default() } else { known.parse().unwrap() };
        match convert(&parse_pose(text).unwrap(), known).unwrap() {
            ConversionResult::Determined(conversions) => *conversions,
            ConversionResult::Ambiguous { candidates, .. } => panic!("{candidates:?}"),
        }
    }

    fn numbers(conversions: &PoseConversions, form: &str) -> Vec<f64> {
        let form: RotationEncoding = form.parse().unwrap();
        conversions.rows.iter().find(|row| row.rotation == form).unwrap().numbers.clone()
    }

    #[track_caller]
    fn assert_near(found: &[f64], expected: &[f64], within: f64) {
        assert_eq!(found.len(), expected.len());
        let far = found.iter().zip(expected).any(|(a, b)| (a - b).abs() > within);
        assert!(!far, "{found:?} is not {expected:?}");
    }

    #[test]
    fn the_pose_of_aubos_sdk_has_its_quaternion() {
        // Vendor's example: rpy, rad, and quaternion w, x, y, z.
        let conversions = one("0.611 0.785 0.960", "aubo");
        let expected = [0.834722, 0.078043, 0.451893, 0.304864];
        assert_near(&numbers(&conversions, "quat:wxyz"), &expected, 1e-6);
    }

    #[test]
    fn a_pendant_pose_is_converted_to_every_convention() {
        let conversions = one("243.69 -249.04 618.32 149.49 -12.78 72.64", "euler:xyz,deg,mm");
        assert_near(&xyz_of(&conversions.pose), &[0.24369, -0.24904, 0.61832], 1e-12);
        assert_eq!(conversions.rows.len(), 7 + 29);
        assert_near(
            &numbers(&conversions, "euler:ZYX"),
            &[72.64, -12.78, 149.49].map(f64::to_radians),
            1e-12,
        );
        for row in &conversions.rows {
            let encoding =
                NumberEncoding { rotation: row.rotation, ..one("0 0 0", "rotvec,rad,m").encoding };
            let again = encoding.pose(&row.numbers).unwrap();
            assert!(
                angle_between(&again.rotation, &conversions.pose.rotation) < 1e-9,
                "{}",
                row.rotation
            );
        }
    }

    #[test]
    fn an_encoding_stated_by_the_text_needs_no_flag() {
        let literal = one("p[0.1, 0.2, 0.3, 0, 3.14, 0]", "");
        assert_eq!(literal.encoding.rotation.to_string(), "rotvec");
        let origin = one(r#"<origin xyz="0 0 0" rpy="1.570796327 0 1.570796327"/>"#, "");
        assert_near(&numbers(&origin, "quat:xyzw"), &[0.5, 0.5, 0.5, 0.5], 1e-9);
    }

    #[test]
    fn frankas_matrix_goes_by_columns_and_rokaes_by_rows() {
        let columns = one("0 1 0 0  -1 0 0 0  0 0 1 0  0.3 0.1 0.5 1", "");
        let rows = one("0 -1 0 0.3  1 0 0 0.1  0 0 1 0.5  0 0 0 1", "");
        assert_eq!(columns.encoding.rotation, RotationEncoding::Columns);
        assert_eq!(rows.encoding.rotation, RotationEncoding::Rows);
        assert_eq!(columns.pose, rows.pose);
        let columns = one("0 1 0  -1 0 0  0 0 1  0.3 0.1 0.5", "");
        assert_eq!(
            (columns.encoding.rotation, columns.pose),
            (RotationEncoding::Columns, rows.pose)
        );
        let short = one("0 -1 0 0.3  1 0 0 0.1  0 0 1 0.5", "");
        assert_eq!((short.encoding.rotation, short.pose), (RotationEncoding::Rows, rows.pose));
    }

    #[test]
    fn bare_quaternions_stay_ambiguous() {
        let pose_text = parse_pose("243.69 -249.04 618.32 149.49 -12.78 72.64").unwrap();
        let ConversionResult::Ambiguous { candidates, notes } =
            convert(&pose_text, KnownEncoding::default()).unwrap()
        else {
            panic!("it was settled");
        };
        let names: Vec<String> =
            candidates.iter().map(|candidate| candidate.encoding.rotation.to_string()).collect();
        assert_eq!(names[..3], ["rotvec", "euler:xyz", "euler:ZYX"]);
        assert!(notes.iter().any(|note| note.starts_with("assumed: millimetres")));
        let pose_text = parse_pose("0 0 1 0.1 0.2 0.3 0.927").unwrap();
        assert!(matches!(
            convert(&pose_text, KnownEncoding::default()),
            Ok(ConversionResult::Ambiguous { .. })
        ));
    }

    #[test]
    fn units_that_make_a_pose_implausible_are_noted() {
        let noted = |text: &str, known: &str, part: &str| {
            one(text, known).notes.iter().any(|note| note.contains(part))
        };
        let literal = "p[-143.5, -435.2, 288.1, 1.2, -1.7, 0.6]";
        assert!(noted(literal, "", "no arm reaches 541.3 m"));
        assert!(!noted(literal, "mm", "reaches"));
        assert!(noted("0.1 0.2 0.3 10 20 30", "kuka", "0.37 mm from the origin"));
        assert!(!noted("600 0.2 0.3 10 20 30", "kuka", "origin"));
        assert!(!noted("p[-0.1435, -0.4352, 0.2881, 1.2, -1.7, 0.6]", "", "reaches"));
        let degrees = r#"<origin xyz="0 0 1" rpy="0 0 90"/>"#;
        assert!(noted(degrees, "", "90 rad is more than a turn"));
        assert!(!noted(degrees, "deg", "turn"));
    }

    #[test]
    fn gimbal_lock_is_noted() {
        let locked = one("0 0 0 10 88 20", "euler:xyz,deg,m");
        assert!(locked.notes.iter().any(|note| note.starts_with("2.00° from gimbal lock")));
        let free = one("0 0 0 10 60 20", "euler:xyz,deg,m");
        assert!(!free.notes.iter().any(|note| note.contains("lock")), "{:?}", free.notes);
    }

    #[test]
    fn an_invalid_matrix_is_rejected_with_the_nearest_rotation() {
        let refused =
            |text: &str| convert(&parse_pose(text).unwrap(), KnownEncoding::default()).unwrap_err();
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
