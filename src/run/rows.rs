//! Rows of a stream in the order of their stamps.

use crate::time::Stamp;

/// Rows of a piece of a stream, in the order of the log, each after the time when it was.
pub(super) type Rows = Vec<(Stamp, usize)>;
