//! Whether a diagnosis in one encoding of the joint states is accepted.

use crate::joints::ResidualSize;
use crate::{ArmDiagnosis, JointDiagnosis, JointUnit, PoseDiagnosis, PoseStream};

impl ArmDiagnosis {
    pub(super) fn is_in_other_encoding(&self) -> bool {
        self.joints.encoding.as_ref().is_ok_and(|encoding| !encoding.is_as_logged())
    }

    /// Some stream must be close to FK. A scale that is not a plausible gear ratio must explain everything, and
    /// several such scales must be equal: scales of one joint each fit almost any short motion.
    pub(super) fn is_credible(&self) -> bool {
        /// Of scales that count as one, as for a round scale.
        const MAX_SCALE_RATIO: f64 = 1.01;
        let JointDiagnosis { encoding, scales, .. } = &self.joints;
        let implausible = scales.iter().filter(|scale| !scale.is_coded() && !scale.is_round());
        let sizes: Vec<f64> = implausible.map(|scale| scale.factor.value.abs()).collect();
        let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        let most = sizes.iter().copied().fold(0.0, f64::max);
        let couplings = encoding.iter().flat_map(|encoding| &encoding.couplings);
        let has_implausible_scale =
            most > 0.0 || couplings.into_iter().any(|coupling| !coupling.is_round());
        self.is_close_to_fk()
            && (!has_implausible_scale || self.largest_unexplained().is_none())
            && most <= MAX_SCALE_RATIO * least
    }

    /// Some stream is close to FK.
    pub(super) fn is_close_to_fk(&self) -> bool {
        self.streams.iter().any(PoseDiagnosis::is_close_to_fk)
    }

    pub(super) fn is_far_from_fk(&self) -> bool {
        !self.streams.is_empty() && self.streams.iter().all(PoseDiagnosis::is_far_from_fk)
    }

    /// Each stream that agrees with FK in `before`, without frame errors, still does.
    pub(super) fn preserves_agreement(&self, before: &Self) -> bool {
        let mut pairs = self.streams.iter().zip(&before.streams);
        pairs.all(|(after, before)| !before.agrees_in_frame() || after.agrees_in_frame())
    }

    /// Whether each stream in a known frame is near FK as logged, and each other one is explained.
    pub(super) fn is_plausible_for(&self, streams: &[PoseStream]) -> bool {
        self.streams.iter().zip(streams).all(|(found, stream)| match stream.reference_known {
            true => found.is_near_as_logged(),
            false => !found.is_unexplained(),
        })
    }

    /// Sum over the streams.
    pub(super) fn total_residual_m(&self) -> f64 {
        self.streams.iter().map(PoseDiagnosis::combined_excess_m).sum()
    }

    /// Stream with the largest excess residual, if that is unexplained.
    pub(super) fn largest_unexplained(&self) -> Option<(usize, ResidualSize)> {
        let (index, worst) = self
            .streams
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.combined_excess_m().total_cmp(&b.1.combined_excess_m()))?;
        worst.is_unexplained().then(|| (index, worst.excess()))
    }

    /// Number of parameters of joint zeros, frame errors and rotation conventions.
    pub(super) fn parameter_count(&self) -> usize {
        const FRAME: usize = 6;
        self.joints.chosen_zeros()
            + FRAME * self.streams.iter().map(PoseDiagnosis::chosen_frames).sum::<usize>()
            + self.streams.iter().filter(|stream| stream.is_misread()).count()
    }

    /// The same without scales that are 1 and couplings that are 0.
    pub(super) fn without_negligible_gains(mut self) -> Self {
        /// Counts as 1: less than 0.1° per turn.
        const FACTOR_TOLERANCE: f64 = 2e-4;
        let is_one = |factor: f64| (factor - 1.0).abs() < FACTOR_TOLERANCE;
        if let JointDiagnosis { encoding: Ok(encoding), scales, .. } = &mut self.joints {
            scales.retain(|scale| !is_one(scale.factor.value));
            encoding
                .unit_errors
                .retain(|error| error.unit != JointUnit::Scaled || !is_one(error.factor));
            encoding.couplings.retain(|coupling| coupling.factor.value.abs() > FACTOR_TOLERANCE);
        }
        self
    }
}
