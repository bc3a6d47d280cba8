//! The effect of changes on a stream.
//!
//! A change moves the stream's poses, or the joint states. Its effect is a combination of columns of the residual, which are
//! fitted, and is removed from poses and joint states.

use super::change::{Change, Subject, TO_MIDDLE, TO_START};
use super::patches::with_poses;
use super::profile::Profile;
use crate::arm_run::ArmRun;
use crate::residuals::cause_columns::{CauseColumns, Frame, RADIAL_SCALE, VariableColumns, ZEROS};
use crate::{AlignedSamples, ArmDiagnosis, PoseDiagnosis};
use ground::geometry::Pose;
use ground::stream::PoseTrack;
use nalgebra::{DVector, Vector6};
use std::borrow::Cow;
use std::ops::Range;

/// A stream that follows FK, and what changes it.
pub(super) struct Stream<'a> {
    pub columns: CauseColumns<'a>,
    pub found: &'a PoseDiagnosis,
    pub index: usize,
}

impl<'a> Stream<'a> {
    pub fn all(run: &ArmRun<'a>, diagnosis: &'a ArmDiagnosis) -> Vec<Self> {
        let stream = |(index, found): (usize, &'a PoseDiagnosis)| {
            found.residual.as_ref().ok()?;
            let columns = CauseColumns::new(found, &run.streams[index]).with_free_zeros();
            Some(Self { columns, found, index })
        };
        diagnosis.streams.iter().enumerate().filter_map(stream).collect()
    }

    fn latency_s(&self) -> f64 {
        self.found.latency_s.as_ref().map_or(0.0, |latency| latency.value)
    }

    /// The change in this stream's columns and stamps. `None` if it does not affect the stream.
    pub fn seen(&self, change: &Change) -> Option<Change> {
        let Subject::Zero { column } = change.subject else {
            return (change.subject.stream() == Some(self.index)).then(|| change.clone());
        };
        let columns = self.columns.zero(column)?;
        let profile = change.profile.later(self.latency_s());
        Some(Change { profile, columns, ..change.clone() })
    }

    pub fn all_seen(&self, changes: &[Change]) -> Vec<Change> {
        changes.iter().filter_map(|change| self.seen(change)).collect()
    }

    /// The change that is seen in these columns. `None` for a latency.
    pub fn change(&self, profile: Profile, columns: Range<usize>) -> Option<Change> {
        let (stream, half) = (self.index, DVector::zeros(columns.len()));
        let subject = match Frame::of(&columns) {
            Some(frame) => Subject::Frame { stream, frame },
            None if columns.start == RADIAL_SCALE => Subject::RadialScale { stream },
            None => Subject::Zero { column: self.columns.joint_column(columns.start)? },
        };
        // Joint zeros change by the joints' stamps.
        let late_s = if subject.stream().is_none() { self.latency_s() } else { 0.0 };
        Some(Change { subject, columns, profile: profile.later(-late_s), half })
    }

    /// Columns with a factor of each sample's time.
    pub fn variable(&self, columns: &Range<usize>, factor: impl Fn(f64) -> f64) -> VariableColumns {
        let t_s = self.columns.samples().map(|row| self.columns.aligned.t_s[row]);
        VariableColumns {
            columns: columns.clone(),
            factors: t_s.map(factor).collect(),
            along: None,
        }
    }

    /// Columns of the amount of a change, then of the parameters of its profile, each with its parameter. The first is
    /// `first`.
    pub fn columns_of(&self, change: &Change, first: usize) -> Vec<(usize, VariableColumns)> {
        let Some(Change { columns, profile, half, .. }) = self.seen(change) else {
            return Vec::new();
        };
        let of_amount = columns.len();
        let of_profile = (0..change.width() - of_amount).map(|parameter| {
            let variable = self.variable(&columns, |t_s| profile.derivatives(t_s)[parameter]);
            (
                first + of_amount + parameter,
                VariableColumns { along: Some(half.clone()), ..variable },
            )
        });
        let amount = (first, self.variable(&columns, |t_s| profile.factor(t_s)));
        std::iter::once(amount).chain(of_profile).collect()
    }

    /// Removes these changes of frames and radial scales from a corrected pose, [`TO_MIDDLE`] or [`TO_START`]. `constant`
    /// are twists of the reference and the tool.
    fn steady_pose(
        &self,
        seen: &[Change],
        target: f64,
        constant: &[Vector6<f64>; 2],
        is: &Pose,
        t_s: f64,
    ) -> Pose {
        let mut twists = *constant;
        let mut scale = 0.0;
        for change in seen {
            let part = change.profile.factor(t_s) + target;
            match change.subject {
                Subject::Frame { frame, .. } => twists[frame as usize] += change.twist(part),
                Subject::RadialScale { .. } => scale += part * change.half[0],
                Subject::Zero { .. } => {}
            }
        }
        let [reference, tool] =
            Frame::BOTH.map(|frame| self.columns.motion(frame, &twists[frame as usize]).inverse());
        let mut pose = reference * is * tool;
        pose.translation.vector /= 1.0 + scale;
        pose
    }

    /// Decoded poses, with frames and radial scale as at the start.
    pub fn steady_track(&self, changes: &[Change]) -> PoseTrack {
        let seen = self.all_seen(changes);
        let AlignedSamples { corrected, t_s, .. } = &self.found.aligned;
        let steady = |(is, &t_s): (&Pose, &f64)| {
            let pose = self.steady_pose(&seen, TO_START, &[Vector6::zeros(); 2], is, t_s);
            self.found.frame_correction.invert(&pose)
        };
        with_poses(self.found, corrected.iter().zip(t_s).map(steady))
    }

    /// The stream without these changes and constant changes of its frames, in the samples that are fitted.
    pub fn without(&self, changes: &[Change], constant: &[Vector6<f64>; 2]) -> Self {
        let seen = self.all_seen(changes);
        let chain = self.columns.chain;
        let dof = chain.dof();
        let zeros: Vec<&Change> = seen.iter().filter(|it| it.subject.stream().is_none()).collect();
        let mut aligned = self.found.aligned.clone();
        for row in self.columns.rows() {
            let t_s = aligned.t_s[row];
            aligned.corrected[row] =
                self.steady_pose(&seen, TO_MIDDLE, constant, &aligned.corrected[row], t_s);
            if !zeros.is_empty() {
                let q = &mut aligned.q_at_truth[row * dof..(row + 1) * dof];
                for zero in &zeros {
                    q[zero.columns.start - ZEROS] += zero.profile.factor(t_s) * zero.half[0];
                }
                aligned.fk_at_truth[row] = chain.forward(q);
            }
        }
        let mut columns = self.columns.clone();
        columns.aligned = Cow::Owned(aligned);
        Self { columns, ..*self }
    }
}
