//! Rows with stamps.

use crate::time::Stamp;

/// Rows of a part in log order, each with its stamp.
pub(super) type Rows = Vec<(Stamp, usize)>;
