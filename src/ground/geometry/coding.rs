//! How the numbers of a pose code its rotation, and in which order.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

use super::{Convention, ConventionError};

/// How numbers code a rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum Coding {
    /// Three numbers of this convention.
    Three(Convention),
    /// A quaternion x, y, z, w.
    Xyzw,
    /// A quaternion w, x, y, z.
    Wxyz,
    /// A matrix row by row: nine numbers, or twelve or sixteen with the position.
    Rows,
    /// The same column by column.
    Columns,
    /// The first two columns of a matrix, as learned policies give rotations (Zhou et al., *On the
    /// Continuity of Rotation Representations in Neural Networks*, CVPR 2019).
    TwoColumns,
    /// The first two rows of a matrix (PyTorch3D's `matrix_to_rotation_6d`).
    TwoRows,
    /// A unit vector along the axis, then the angle.
    AxisAngle,
}

impl Coding {
    /// The coding of that name where it is three numbers or a quaternion: of the others the numbers tell
    /// how they lie, so nobody declares them.
    ///
    /// # Errors
    /// Where there is none.
    pub fn declared(name: &str) -> Result<Self, ConventionError> {
        match name.parse()? {
            coding @ (Self::Three(_) | Self::Xyzw | Self::Wxyz) => Ok(coding),
            _ => Err(ConventionError::Unknown(name.to_owned())),
        }
    }

    /// Whether its numbers are angles.
    pub fn has_angles(self) -> bool {
        matches!(self, Self::Three(_) | Self::AxisAngle)
    }

    /// Whether it is a matrix, or two columns or rows of one.
    pub fn is_matrix(self) -> bool {
        matches!(self, Self::Rows | Self::Columns | Self::TwoColumns | Self::TwoRows)
    }

    /// How unusual it is, from 0.
    pub fn usual_rank(self) -> u8 {
        match self {
            Self::Three(convention) => convention.usual_rank(),
            Self::Xyzw | Self::Rows => 0,
            Self::Wxyz | Self::Columns | Self::TwoColumns | Self::TwoRows | Self::AxisAngle => 1,
        }
    }
}

impl fmt::Display for Coding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Three(convention) => convention.fmt(f),
            Self::Xyzw => f.write_str("quat:xyzw"),
            Self::Wxyz => f.write_str("quat:wxyz"),
            Self::Rows => f.write_str("matrix:rows"),
            Self::Columns => f.write_str("matrix:columns"),
            Self::TwoColumns => f.write_str("rot6d:columns"),
            Self::TwoRows => f.write_str("rot6d:rows"),
            Self::AxisAngle => f.write_str("axis-angle"),
        }
    }
}

impl FromStr for Coding {
    type Err = ConventionError;

    fn from_str(name: &str) -> Result<Self, ConventionError> {
        Ok(match name {
            "quat:xyzw" => Self::Xyzw,
            "quat:wxyz" => Self::Wxyz,
            "matrix:rows" => Self::Rows,
            "matrix:columns" => Self::Columns,
            "rot6d:columns" => Self::TwoColumns,
            "rot6d:rows" => Self::TwoRows,
            "axis-angle" => Self::AxisAngle,
            name => Self::Three(name.parse()?),
        })
    }
}

impl TryFrom<String> for Coding {
    type Error = ConventionError;

    fn try_from(name: String) -> Result<Self, ConventionError> {
        name.parse()
    }
}
