//! Corrections of the system on which a log was recorded, derived from an audit's findings and written as
//! files for people and drivers. An audit can apply them before the rules run.

mod apply;
#[cfg(feature = "fix")]
mod code;
#[cfg(feature = "fix")]
mod collect;
mod context;
mod corrections_file;
#[cfg(feature = "fix")]
mod dataset;
#[cfg(feature = "fix")]
mod fix_files;
#[cfg(feature = "fix")]
mod frames;

pub(crate) use apply::GivenCorrections;
#[cfg(feature = "fix")]
pub(crate) use collect::CorrectionPlan;
pub use corrections_file::{
    Corrections, CouplingCorrection, FrameCorrection, JointCorrection, JointOrder, TopicCorrection,
};
#[cfg(feature = "fix")]
pub(crate) use fix_files::{FIX_FILES, model_files};
