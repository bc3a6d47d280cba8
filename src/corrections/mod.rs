//! Corrections of the system on which a log was recorded.
//!
//! [`Corrections`] are derived from an audit's findings and written as files for people and drivers. An
//! audit can apply them to the streams before the rules run. They contain values but no thresholds, and
//! nothing here estimates.

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
