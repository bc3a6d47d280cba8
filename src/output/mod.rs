//! Outputs of an audited run in addition to its report. Each takes an [`Audited`](crate::Audited) run and
//! first checks that it does not overwrite an input file. Outputs do not change the findings.

pub mod calibration;
mod error_series;
#[cfg(feature = "fix")]
pub mod fix;
pub mod foxglove;
pub mod plotjuggler;
#[cfg(feature = "recording")]
pub mod replay;
#[cfg(feature = "tables")]
pub mod tables;
pub mod tum;
