//! Residuals of a stream against FK, with and without the estimators.

pub(crate) mod cause_columns;
pub(crate) mod comparison;
pub(crate) mod excess;
pub(crate) mod held_out;
pub(crate) mod residual_check;
pub(crate) mod trajectory_error;
