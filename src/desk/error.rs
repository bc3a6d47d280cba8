//! Why the desk cannot take what it was given.

use crate::geometry::{ConventionError, RotationEncoding};

/// Reason why a text is not a pose, or not in the given form.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "each message is self-explanatory")]
pub enum DeskError {
    #[error("{source}")]
    Form { source: ConventionError },
    #[error("`{unit}` contradicts another unit")]
    Contradiction { unit: String },
    #[error("`{name}` is not a link of an arm{}", did_you_mean(nearest))]
    Frame { name: String, nearest: Option<String> },
    #[error("`{word}` is not a number")]
    Word { word: String },
    #[error("{count} numbers are not a pose")]
    Count { count: usize },
    #[error("{count} numbers do not fit the form {form}")]
    CountOfForm { form: RotationEncoding, count: usize },
    #[error("{number:e} is too large for a pose")]
    TooLarge { number: f64 },
    #[error("the poses have different lengths: {first} and {other} numbers")]
    Counts { first: usize, other: usize },
    #[error(
        "the matrix is not orthonormal: max |RᵀR − I| is {defect:.2e}; the nearest rotation is \
         x y z w {}",
        format_six_digits(nearest_xyzw)
    )]
    NotOrthonormal { defect: f64, nearest_xyzw: [f64; 4] },
    #[error("not a rotation matrix: its determinant is {determinant:.3}")]
    NoRotation { determinant: f64 },
    #[error("the last row of the matrix is {}, not 0 0 0 1", format_six_digits(row))]
    LastRow { row: [f64; 4] },
    #[error("the quaternion's norm is {norm:.4}, not 1")]
    Norm { norm: f64 },
    #[error("the norm of the rotation axis is {norm:.4}, not 1")]
    Axis { norm: f64 },
    #[error("not well-formed XML: {0}")]
    Xml(String),
    #[error("not a pose in YAML: {0}")]
    Yaml(String),
    #[error("the message has no {0}")]
    Missing(&'static str),
    #[error("the message contains {0} poses")]
    Several(usize),
    #[error("row {row}: {what}")]
    Row { row: usize, what: String },
    #[error("no pair of poses given")]
    NoPairs,
}

impl DeskError {
    /// Remedy as a short clause.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Form { .. } => {
                "use rotvec, euler:SEQ, quat:xyzw, quat:wxyz, matrix:rows, matrix:columns, axis-angle, \
                 rot6d:columns, rot6d:rows or a maker such as kuka, followed by deg or rad and mm or m, \
                 separated by commas"
            }
            Self::Contradiction { .. } => "use only one of deg and rad, and one of mm and m",
            Self::Frame { .. } => "name links of the arm; give your own arm with --robot",
            Self::Word { .. } => "give numbers, p[…], a URDF origin or a ROS message as YAML",
            Self::Count { .. } => {
                "give 6 (position and three angles), 7 (and a quaternion), 9 (and two columns of the \
                 matrix), 12 or 16 (a matrix), or a rotation alone as 3, 4 or 9"
            }
            Self::TooLarge { .. } => "give lengths in m or mm and angles in rad or degrees",
            Self::CountOfForm { .. } => "name the matching form, or omit it to have it inferred",
            Self::Counts { .. } => "use one form for all poses of a side",
            Self::NotOrthonormal { .. } => {
                "give more digits, or take the nearest rotation if the matrix was averaged or blended"
            }
            Self::NoRotation { .. } => {
                "a negative determinant means a mirrored axis; check for a lost row or sign"
            }
            Self::LastRow { .. } => "name the order: matrix:rows or matrix:columns",
            Self::Norm { .. } => {
                "check that all four numbers belong to the quaternion, and normalise it"
            }
            Self::Axis { .. } => "give a unit vector, then the angle",
            Self::Xml(_) => "paste the whole <origin …/>",
            Self::Yaml(_) | Self::Missing(_) => {
                "paste position and orientation as the topic prints them"
            }
            Self::Several(_) => "paste only one of them",
            Self::Row { .. } => "use two columns with a pose each, or columns named is… and but…",
            Self::NoPairs => "give --is and --but, or a CSV with a pair in each row",
        }
    }
}

fn did_you_mean(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or(String::new(), |near| format!(": did you mean `{near}`?"))
}

/// Numbers with six digits, separated by spaces.
fn format_six_digits(numbers: &[f64]) -> String {
    let texts: Vec<String> = numbers.iter().map(|number| format!("{:.6}", number + 0.0)).collect();
    texts.join(" ")
}
