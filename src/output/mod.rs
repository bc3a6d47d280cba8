//! What is written of an audited run beside its report.
//!
//! Each output takes an [`Audited`](crate::Audited) run and computes nothing but where things are drawn. It
//! first makes sure that no file which was read is lost. None of them touches what the report says is wrong,
//! so that a report outlives an output that cannot be written.

pub mod calibration;
#[cfg(feature = "fix")]
pub mod fix;
pub mod foxglove;
#[cfg(feature = "recording")]
pub mod replay;
#[cfg(feature = "tables")]
pub mod tables;
