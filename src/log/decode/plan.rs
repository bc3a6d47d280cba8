//! Plans: how the rows of one channel are read from its messages, in whatever encoding.

use super::fault::{Append, DecodeError};
use super::row::Row;
use super::{json, protobuf, steps};

/// What a recipe became for the format of one channel.
#[derive(Debug)]
pub(crate) enum Plan {
    /// CDR or ROS 1 serialization.
    Steps(steps::Plan),
    /// JSON.
    Json(json::Plan),
    /// Protocol buffers.
    Protobuf(protobuf::Plan),
}

impl Plan {
    /// Reads `message` through `row` and gives each of its rows to `append`.
    pub(crate) fn decode<'p>(
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
