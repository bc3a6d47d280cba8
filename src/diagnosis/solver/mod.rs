//! Linear least squares under correlated noise, robust weights and covariances.

pub(crate) mod linear;
pub(crate) mod noise;
pub(crate) mod robust;
