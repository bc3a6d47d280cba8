//! Corrections: what would mend the system that a log was recorded on.
//!
//! [`Corrections`] are told from an audit's findings, written as files that a person or a driver can
//! use, and taken back by an audit that applies them to the streams before it judges anything. They
//! hold amounts and no thresholds; nothing here estimates.

mod apply;
mod code;
mod collect;
mod file;
mod files;
mod frames;

pub(crate) use apply::Given;
pub(crate) use collect::Mending;
pub use file::{Corrections, FrameCorrection, JointCorrection, JointOrder, TopicCorrection};
pub(crate) use files::{FIX_FILES, model_files};
