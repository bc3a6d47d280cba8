//! Measurement model of a pose stream, and what a motion reveals about its parameters.

pub(crate) mod jacobian;
pub(crate) mod measurement;
pub(crate) mod moving_frame;
pub(crate) mod observability;
