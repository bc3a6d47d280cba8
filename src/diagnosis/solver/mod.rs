//! Least squares: linear under correlated noise, and nonlinear; robust weights and covariances.

pub(crate) mod linear;
pub(crate) mod minimize;
pub(crate) mod noise;
mod recurrence;
pub(crate) mod robust;
