//! Changes of causes: what changes, how it depends on time, and by how much.

use super::profile::Profile;
use crate::priors::{FRAME_PRIOR_M, RAD_PER_M, RADIAL_SCALE_PRIOR, TOOL_PRIOR_M, ZERO_PRIOR};
use crate::residuals::cause_columns::Frame;
use nalgebra::{DVector, Vector6};
use std::ops::Range;

/// What changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Subject {
    Frame { stream: usize, frame: Frame },
    RadialScale { stream: usize },
    Zero { column: usize },
}

impl Subject {
    /// Stream that it affects. A joint zero affects every stream.
    pub fn stream(self) -> Option<usize> {
        match self {
            Self::Frame { stream, .. } | Self::RadialScale { stream } => Some(stream),
            Self::Zero { .. } => None,
        }
    }
}

#[derive(Clone)]
pub(super) struct Change {
    pub subject: Subject,
    /// Variable columns of its stream. Of a joint zero, one.
    pub columns: Range<usize>,
    /// By the stamps of its stream, or of the joints for a joint zero.
    pub profile: Profile,
    /// Half of the change in its columns.
    pub half: DVector<f64>,
}

impl Change {
    /// Parameters of its amount and of a gradual profile, which has no effect without an amount.
    pub fn width(&self) -> usize {
        let has_amount = self.half.iter().any(|value| *value != 0.0);
        self.columns.len() + if has_amount { self.profile.derivatives(0.0).len() } else { 0 }
    }

    pub fn without_amount(&self) -> Self {
        Self { half: DVector::zeros(self.half.len()), ..self.clone() }
    }

    /// Minus twice the logarithm of the prior probability of its amount: large opposite changes are improbable.
    pub fn prior_cost(&self) -> f64 {
        let size = |column: usize| match self.subject {
            Subject::Frame { frame: Frame::Tool, .. }
                if Frame::Tool.translation().contains(&column) =>
            {
                TOOL_PRIOR_M
            }
            Subject::Frame { frame, .. } if frame.translation().contains(&column) => FRAME_PRIOR_M,
            Subject::Frame { .. } => RAD_PER_M * FRAME_PRIOR_M,
            Subject::RadialScale { .. } => RADIAL_SCALE_PRIOR,
            Subject::Zero { .. } => ZERO_PRIOR,
        };
        let amounts = self.columns.clone().zip(&self.half);
        amounts.map(|(column, half)| (2.0 * half / size(column)).powi(2)).sum()
    }

    /// `part` times its half, as a twist of its frame. Zero unless a frame changes.
    pub fn twist(&self, part: f64) -> Vector6<f64> {
        let mut twist = Vector6::zeros();
        if let Subject::Frame { frame, .. } = self.subject {
            let first = self.columns.start - frame.columns().start;
            twist.rows_mut(first, self.half.len()).copy_from(&(&self.half * part));
        }
        twist
    }
}

/// Added to the profile of each change to remove the change. The state that remains is the middle of all states.
pub(super) const TO_MIDDLE: f64 = 0.0;
/// The state that remains is the first one, because slips and collisions happen later.
pub(super) const TO_START: f64 = 1.0;

/// Value of a joint's zero or a radial scale relative to the start.
pub(super) fn value_at<'a>(
    changes: impl Iterator<Item = &'a Change>,
    subject: Subject,
    t_s: f64,
) -> f64 {
    let own = changes.filter(|change| change.subject == subject);
    own.map(|change| (change.profile.factor(t_s) + TO_START) * change.half[0]).sum()
}
