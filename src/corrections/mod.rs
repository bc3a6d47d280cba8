//! Corrections: what would mend the system that a log was recorded on.
//!
//! [`Corrections`] are told from an audit's findings, written as files that a person or a driver can
//! use, and taken back by an audit that applies them to the streams before it judges anything. They
//! hold amounts and no thresholds; nothing here estimates.

mod apply;
#[cfg(feature = "fix")]
mod code;
#[cfg(feature = "fix")]
mod collect;
#[cfg(feature = "fix")]
mod dataset;
mod file;
#[cfg(feature = "fix")]
mod files;
#[cfg(feature = "fix")]
mod frames;
mod source;

pub(crate) use apply::Given;
#[cfg(feature = "fix")]
pub(crate) use collect::Mending;
pub use file::{Corrections, FrameCorrection, JointCorrection, JointOrder, TopicCorrection};
#[cfg(feature = "fix")]
pub(crate) use files::{FIX_FILES, model_files};
