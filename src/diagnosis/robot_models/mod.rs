//! Comparison of robot models and DH conventions by the poses of a log.

pub(crate) mod dh_convention;
pub(crate) mod position_misfit;
pub(crate) mod ranking;
