//! Plans: how the rows of one channel are read from its messages, in whatever encoding.

use super::builder::TooManyJoints;
use super::cursor::{EncapsulationError, Short};
use super::row::Row;
use super::schema::excerpt;
use super::{json, protobuf, steps};

/// What a recipe became for the format of one channel.
#[derive(Debug)]
pub(in crate::log) enum Plan {
    /// CDR or ROS 1 serialization.
    Steps(steps::Plan),
    /// JSON.
    Json(json::Plan),
    /// Protocol buffers.
    Protobuf(protobuf::Plan),
}

/// Why a message could not be decoded.
#[derive(Debug, thiserror::Error)]
pub(in crate::log) enum DecodeError<'p> {
    /// The message is not in a representation read here.
    #[error(transparent)]
    Encapsulation(#[from] EncapsulationError),
    /// A field reaches beyond the end of the message.
    #[error("field `{}`: {short}", excerpt(field))]
    Short { field: &'p str, short: Short },
    /// It is no JSON, or not of the type's fields.
    #[error(transparent)]
    Json(#[from] json::JsonError),
    /// It is no protocol buffer, or not of the type's fields.
    #[error(transparent)]
    Protobuf(#[from] protobuf::WireError),
    /// The columns refused the row.
    #[error(transparent)]
    Refused(#[from] TooManyJoints),
}

/// What a walk does with each row.
pub(super) type Append<'f> = dyn FnMut(&Row) -> Result<(), TooManyJoints> + 'f;

impl Plan {
    /// Reads `message` through `row` and gives each of its rows to `append`.
    pub(in crate::log) fn decode<'p>(
        &'p self,
        message: &[u8],
        row: &mut Row,
        append: &mut Append<'_>,
    ) -> Result<(), DecodeError<'p>> {
        match self {
            Plan::Steps(plan) => plan.decode(message, row, append),
            Plan::Json(plan) => plan.decode(message, row, append),
            Plan::Protobuf(plan) => plan.decode(message, row, append),
        }
    }
}
