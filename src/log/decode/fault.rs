//! Why a message could not be decoded.

use super::builder::TooManyJoints;
use super::cursor::{EncapsulationError, Short};
use super::protobuf::WireError;
use super::row::Row;
use super::schema::excerpt;

/// Why a message could not be decoded.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DecodeError<'p> {
    /// The message is not in a representation read here.
    #[error(transparent)]
    Encapsulation(#[from] EncapsulationError),
    /// A field reaches beyond the end of the message.
    #[error("field `{}`: {short}", excerpt(field))]
    Short { field: &'p str, short: Short },
    /// It is no JSON, or not of the type's fields.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// It is no protocol buffer, or not of the type's fields.
    #[error(transparent)]
    Protobuf(#[from] WireError),
    /// The columns refused the row.
    #[error(transparent)]
    Refused(#[from] TooManyJoints),
}

/// Why a message could not be read.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum JsonError {
    #[error("not JSON of this type: {what}")]
    Malformed { what: String },
    #[error("no object `{path}`")]
    Missing { path: String },
}

/// What a walk does with each row.
pub(super) type Append<'f> = dyn FnMut(&Row) -> Result<(), TooManyJoints> + 'f;
