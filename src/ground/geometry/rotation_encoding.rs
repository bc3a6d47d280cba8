//! Encodings of a rotation in numbers.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

use super::{Convention, ConventionError};

/// Encoding of a rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum RotationEncoding {
    /// Three numbers.
    Three(Convention),
    /// Quaternion x, y, z, w.
    Xyzw,
    /// Quaternion w, x, y, z.
    Wxyz,
    /// Matrix by rows: nine numbers, or twelve or sixteen with the position.
    Rows,
    /// Matrix by columns.
    Columns,
    /// First two columns of a matrix, as learned policies output (Zhou et al., *On the Continuity of
    /// Rotation Representations in Neural Networks*, CVPR 2019).
    TwoColumns,
    /// First two rows (PyTorch3D's `matrix_to_rotation_6d`).
    TwoRows,
    /// Unit axis, then angle.
    AxisAngle,
}

impl RotationEncoding {
    /// Parses a declarable encoding: three numbers or a quaternion. Others are identified from the numbers.
    ///
    /// # Errors
    /// If the name is unknown or not declarable.
    pub fn from_declared_name(name: &str) -> Result<Self, ConventionError> {
        match name.parse()? {
            coding @ (Self::Three(_) | Self::Xyzw | Self::Wxyz) => Ok(coding),
            _ => Err(ConventionError::Unknown(name.to_owned())),
        }
    }

    /// Whether it includes angles.
    pub fn has_angles(self) -> bool {
        matches!(self, Self::Three(_) | Self::AxisAngle)
    }

    /// Whether it is a matrix or part of one.
    pub fn is_matrix(self) -> bool {
        matches!(self, Self::Rows | Self::Columns | Self::TwoColumns | Self::TwoRows)
    }

    /// Rank by usage, 0 first.
    pub fn usual_rank(self) -> u8 {
        match self {
            Self::Three(convention) => convention.usual_rank(),
            Self::Xyzw | Self::Rows => 0,
            Self::Wxyz | Self::Columns | Self::TwoColumns | Self::TwoRows | Self::AxisAngle => 1,
        }
    }
}

impl fmt::Display for RotationEncoding {
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

impl FromStr for RotationEncoding {
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

impl TryFrom<String> for RotationEncoding {
    type Error = ConventionError;

    fn try_from(name: String) -> Result<Self, ConventionError> {
        name.parse()
    }
}
