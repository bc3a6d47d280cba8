//! Errors in decoding a message.

use super::builder::TooManyJoints;
use super::cursor::{EncapsulationError, Short};
use super::protobuf::WireError;
use super::row::Row;
use super::schema::excerpt;

/// Reason why a message could not be decoded.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DecodeError<'p> {
    /// Unsupported message representation.
    #[error(transparent)]
    Encapsulation(#[from] EncapsulationError),
    /// A field extends beyond the end of the message.
    #[error("field `{}`: {short}", excerpt(field))]
    Short { field: &'p str, short: Short },
    /// Invalid JSON, or JSON without the type's fields.
    #[error(transparent)]
    Json(#[from] JsonError),
    /// Invalid protocol buffer, or one without the type's fields.
    #[error(transparent)]
    Protobuf(#[from] WireError),
    /// The columns rejected the row.
    #[error(transparent)]
    Refused(#[from] TooManyJoints),
}

/// Reason why a JSON message could not be decoded.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum JsonError {
    #[error("not JSON of this type: {what}")]
    Malformed { what: String },
    #[error("no object `{path}`")]
    Missing { path: String },
}

/// Callback for each row.
pub(super) type Append<'f> = dyn FnMut(&Row) -> Result<(), TooManyJoints> + 'f;
