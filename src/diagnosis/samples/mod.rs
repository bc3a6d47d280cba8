//! Samples that the estimators use.

pub(crate) mod aligned;
pub(crate) mod sampling;
