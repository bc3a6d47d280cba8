//! Errors in decoding a message.

use super::builder::TooManyJoints;
use super::cursor::{EncapsulationError, Short};
use super::protobuf::WireError;
use super::row::Row;
use super::schema::excerpt;

#[derive(Debug, thiserror::Error)]
pub(crate) enum DecodeError<'p> {
    /// Unsupported representation.
    #[error(transparent)]
    Encapsulation(#[from] EncapsulationError),
    /// A field beyond the end.
    #[error("field `{}`: {short}", excerpt(field))]
    Short { field: &'p str, short: Short },
    /// Invalid, or without the type's fields.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// Invalid, or without the type's fields.
    #[error(transparent)]
    Protobuf(#[from] WireError),
    /// Refused by the columns.
    #[error(transparent)]
    Refused(#[from] TooManyJoints),
}

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum JsonError {
    #[error("not JSON of this type: {what}")]
    Malformed { what: String },
    #[error("no object `{path}`")]
    Missing { path: String },
}

/// Called with each row.
pub(super) type Append<'f> = dyn FnMut(&Row) -> Result<(), TooManyJoints> + 'f;
