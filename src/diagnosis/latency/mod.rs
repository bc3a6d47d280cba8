//! Latency of a stream: candidate lags, large changes, the profile over the run, jitter, compensation.

pub(crate) mod coarse;
pub(crate) mod compensation;
pub(crate) mod correlation;
pub(crate) mod delay_jitter;
pub(crate) mod lag_windows;
pub(crate) mod late_joints;
pub(crate) mod piecewise;
pub(crate) mod profile;
pub(crate) mod ramp;
pub(crate) mod residual_by_latency;
pub(crate) mod speed_residual;
pub(crate) mod steps;
