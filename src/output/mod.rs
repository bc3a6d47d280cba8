//! Outputs of an audited run in addition to its report.
//!
//! Each output takes an [`Audited`](crate::Audited) run and computes only the positions of drawn objects.
//! It first checks that it does not overwrite an input file. Outputs do not change the findings, so the
//! report is available even if an output cannot be written.

pub mod calibration;
#[cfg(feature = "fix")]
pub mod fix;
pub mod foxglove;
#[cfg(feature = "recording")]
pub mod replay;
#[cfg(feature = "tables")]
pub mod tables;
