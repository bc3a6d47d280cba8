//! Residual of a diagnosis, with its derivatives by small changes of the reference, the tool frame and the latency.

use crate::model::jacobian::{Derivative, PoseJacobian};
use crate::model::measurement::{FLOOR_M, FLOOR_RAD};
use crate::solver::linear::Linear;
use crate::{AlignedSamples, PoseDiagnosis};
use ground::geometry::{Pose, Vec3, pose, rotvec_from_rotation};
use std::ops::Range;

/// One of a stream's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frame {
    Reference,
    Tool,
}

impl Frame {
    pub const BOTH: [Self; 2] = [Self::Reference, Self::Tool];

    /// Columns of its constant change, a twist.
    pub const fn columns(self) -> Range<usize> {
        match self {
            Self::Reference => 0..6,
            Self::Tool => 6..12,
        }
    }
}

/// Column of the latency, followed by the skew.
pub(super) const LATENCY: usize = 12;
/// Number of columns of constant causes.
pub(super) const CONSTANT: usize = LATENCY + 2;

pub(super) struct FrameColumns<'a> {
    pub aligned: &'a AlignedSamples,
    has_rotation: bool,
    /// The reference turns about it, in the base.
    pub centre: Vec3,
}

impl<'a> FrameColumns<'a> {
    pub fn new(diagnosis: &'a PoseDiagnosis) -> Self {
        let aligned = &diagnosis.aligned;
        let sum: Vec3 = aligned.fk_at_truth.iter().map(|pose| pose.translation.vector).sum();
        let centre = sum / aligned.fk_at_truth.len().max(1) as f64;
        Self { aligned, has_rotation: diagnosis.encoding.is_ok(), centre }
    }

    /// Rows of up to about 4000 samples.
    pub fn samples(&self) -> impl Iterator<Item = usize> + '_ {
        const MAX_SAMPLES: usize = 4000;
        let all = self.aligned.t_s.len();
        (0..all).step_by(all.div_ceil(MAX_SAMPLES).max(1))
    }

    /// From −1 at the first sample to 1 at the last.
    pub fn part(&self, t_s: f64) -> f64 {
        (t_s - self.aligned.middle_s()) / self.half_span_s().max(f64::MIN_POSITIVE)
    }

    pub fn half_span_s(&self) -> f64 {
        let t_s = &self.aligned.t_s;
        t_s.first().zip(t_s.last()).map_or(0.0, |(first, last)| 0.5 * (last - first))
    }

    /// Of FK at a row.
    fn velocity(&self, row: usize) -> Derivative {
        let AlignedSamples { t_s, fk_at_truth, .. } = self.aligned;
        let (from, to) = (row.saturating_sub(1), (row + 1).min(t_s.len() - 1));
        let (before, after) = (&fk_at_truth[from], &fk_at_truth[to]);
        let moved = after.translation.vector - before.translation.vector;
        let turned = rotvec_from_rotation(&(after.rotation * before.rotation.inverse()));
        let interval_s = (t_s[to] - t_s[from]).max(f64::MIN_POSITIVE);
        [moved, turned].map(|change| change / interval_s)
    }

    /// Residuals in m and rad, and their derivatives: `width` columns, the first [`CONSTANT`] for constant causes.
    /// `more` gives the columns that are repeated behind them, and their factor at a time.
    pub fn linearize(
        &self,
        width: usize,
        more: impl Fn(f64) -> Option<(Range<usize>, f64)>,
    ) -> Linear {
        let mut linear = Linear::new(width, &[FLOOR_M, FLOOR_RAD]);
        let identity = Pose::identity();
        let mask = |vector: Vec3| if self.has_rotation { vector } else { Vec3::zeros() };
        for row in self.samples() {
            let (fk, is) = (&self.aligned.fk_at_truth[row], &self.aligned.corrected[row]);
            let turn = rotvec_from_rotation(&(is.rotation * fk.rotation.inverse()));
            let shift = is.translation.vector - fk.translation.vector;
            let mut rows = linear.push(&[shift.into(), mask(turn).into()]);
            let about_centre = pose((fk.translation.vector - self.centre).into(), fk.rotation);
            let jacobian = PoseJacobian::new(&[], &identity, &about_centre, &identity);
            let late = self.velocity(row).map(|part| -part);
            let part = self.part(self.aligned.t_s[row]);
            let derivatives: [Derivative; CONSTANT] = std::array::from_fn(|column| match column {
                0..6 => jacobian.reference(column),
                6..LATENCY => jacobian.tool(column - 6),
                LATENCY => late,
                _ => late.map(|late| late * part),
            });
            let mut set = |column: usize, [linear, angular]: Derivative| {
                rows.set(0, column, linear.into());
                rows.set(1, column, mask(angular).into());
            };
            derivatives.iter().enumerate().for_each(|(column, own)| set(column, *own));
            if let Some((columns, factor)) = more(self.aligned.t_s[row]) {
                for (at, column) in columns.enumerate() {
                    set(CONSTANT + at, derivatives[column].map(|vector| vector * factor));
                }
            }
        }
        linear
    }
}
