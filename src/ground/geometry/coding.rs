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
}

impl Coding {
    /// The coding of that name that is no matrix: a matrix tells by its numbers how it lies, so nobody
    /// declares it.
    ///
    /// # Errors
    /// Where there is none.
    pub fn declared(name: &str) -> Result<Self, ConventionError> {
        match name.parse()? {
            Self::Rows | Self::Columns => Err(ConventionError::Unknown(name.to_owned())),
            coding => Ok(coding),
        }
    }

    /// Whether its numbers are angles.
    pub fn has_angles(self) -> bool {
        matches!(self, Self::Three(_))
    }

    /// Whether it is a matrix.
    pub fn is_matrix(self) -> bool {
        matches!(self, Self::Rows | Self::Columns)
    }

    /// How unusual it is, from 0.
    pub fn usual_rank(self) -> u8 {
        match self {
            Self::Three(convention) => convention.usual_rank(),
            Self::Xyzw | Self::Rows => 0,
            Self::Wxyz | Self::Columns => 1,
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
