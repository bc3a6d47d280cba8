//! Plans for reading messages in any encoding.

use super::fault::{Append, DecodeError};
use super::row::Row;
use super::{json, protobuf, steps};

/// Recipe compiled for one channel.
#[derive(Debug)]
pub(crate) enum Plan {
    /// CDR or ROS 1.
    Steps(steps::Plan),
    Json(json::Plan),
    /// Protocol buffers.
    Protobuf(protobuf::Plan),
}

impl Plan {
    /// Decodes `message` into `row` and passes each of its rows to `append`.
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
