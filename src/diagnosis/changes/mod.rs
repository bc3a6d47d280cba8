//! Changes within a run: a tool slips, the base is moved, a joint loses its zero, or an encoding changes.
//!
//! Steps and gradual changes of frames, joint zeros and radial scales are columns of the residual ([`cause_changes`]): they
//! are searched ([`change_search`]), fitted ([`change_fit`]), removed ([`removal`]) and reported ([`change_report`]).
//! Encodings are estimated for each part of the run, and all parts are encoded alike ([`encoding_changes`]). Steps of
//! frames and zeros too large for a linearisation are differences between the diagnoses of the parts
//! ([`large_steps`]).

mod cause_changes;
mod change;
mod change_fit;
mod change_points;
mod change_report;
mod change_search;
mod changing_stream;
mod constant_frames;
mod encoding_changes;
mod jumps;
mod large_steps;
mod patches;
mod profile;
mod removal;
mod score_test;
mod split_run;

use crate::residuals::cause_columns::CauseColumns;
use crate::residuals::comparison::has_slow_residual;
use crate::{ArmDiagnosis, PoseDiagnosis, PoseStream};

pub(super) use cause_changes::diagnose_with_cause_changes;
pub use change_points::{
    ChangePoint, Course, EncodingSpans, FrameChange, JointChange, JointParameter, JointPatch,
    ScalarChange,
};
pub(super) use constant_frames::constant_frames_suffice;
pub(super) use encoding_changes::{
    diagnose_with_encoding_changes, diagnose_with_recorded_encoding_changes,
};
use score_test::has_unusual_zero;

impl ArmDiagnosis {
    /// Whether noise, usual link deviations and constant frames explain the residuals of all streams.
    pub fn is_explained(&self, streams: &[PoseStream]) -> bool {
        self.streams.iter().zip(streams).all(|(found, stream)| is_explained(found, stream))
    }
}

/// Whether noise, usual link deviations and constant frames explain the residual of a stream.
pub(super) fn is_explained(diagnosis: &PoseDiagnosis, stream: &PoseStream) -> bool {
    let are_links_enough = || {
        let columns = CauseColumns::new(diagnosis, stream);
        let is_far = diagnosis.residual.is_err() || diagnosis.is_far_from_fk();
        !is_far && !columns.has_unexplained_residual() && !has_unusual_zero(&columns)
    };
    !has_slow_residual(diagnosis) || are_links_enough()
}
