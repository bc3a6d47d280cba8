//! Rows of a stream with their stamps.

use crate::time::Stamp;

/// Rows of a part of a stream, in log order, each with its stamp.
pub(super) type Rows = Vec<(Stamp, usize)>;
