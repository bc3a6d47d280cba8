//! Diagnosis in one encoding of the joint states, and whether it is accepted.

use crate::joints::ResidualSize;
use crate::{
    ArmDiagnosis, EstimateResult, JointCoupling, JointDiagnosis, JointEncoding, JointOffset,
    JointScale, JointUnit, PoseDiagnosis, PoseStream,
};

#[derive(Clone)]
pub(super) struct EncodingResult {
    /// Of the joint states, before refining its scales and couplings.
    pub encoding: EstimateResult<JointEncoding>,
    pub offsets: Vec<JointOffset>,
    pub scales: Vec<JointScale>,
    pub couplings: Vec<JointCoupling>,
    pub streams: Vec<PoseDiagnosis>,
}

impl EncodingResult {
    pub fn is_in_other_encoding(&self) -> bool {
        self.encoding.as_ref().is_ok_and(|encoding| !encoding.is_as_logged())
    }

    /// Some stream must be close to FK. A scale that is not a plausible gear ratio must explain everything, and
    /// several such scales must be equal: scales of one joint each fit almost any short motion.
    pub fn is_credible(&self) -> bool {
        /// Of scales that count as one, as for a round scale.
        const MAX_SCALE_RATIO: f64 = 1.01;
        let implausible = self.scales.iter().filter(|scale| !scale.is_coded() && !scale.is_round());
        let sizes: Vec<f64> = implausible.map(|scale| scale.factor.value.abs()).collect();
        let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
        let most = sizes.iter().copied().fold(0.0, f64::max);
        let has_implausible_scale =
            most > 0.0 || self.couplings.iter().any(|coupling| !coupling.is_round());
        self.is_close_to_fk()
            && (!has_implausible_scale || self.largest_unexplained().is_none())
            && most <= MAX_SCALE_RATIO * least
    }

    /// Some stream is close to FK.
    pub fn is_close_to_fk(&self) -> bool {
        self.streams.iter().any(PoseDiagnosis::is_close_to_fk)
    }

    pub fn is_far_from_fk(&self) -> bool {
        !self.streams.is_empty() && self.streams.iter().all(PoseDiagnosis::is_far_from_fk)
    }

    /// Each stream that agrees with FK in `before`, without frame errors, still does.
    pub fn preserves_agreement(&self, before: &Self) -> bool {
        let mut pairs = self.streams.iter().zip(&before.streams);
        pairs.all(|(after, before)| !before.agrees_in_frame() || after.agrees_in_frame())
    }

    /// Whether each stream in a known frame is near FK as logged, and each other one is explained.
    pub fn is_plausible_for(&self, streams: &[PoseStream]) -> bool {
        self.streams.iter().zip(streams).all(|(found, stream)| match stream.reference_known {
            true => found.is_near_as_logged(),
            false => !found.is_unexplained(),
        })
    }

    /// Sum over the streams.
    pub fn total_residual_m(&self) -> f64 {
        self.streams.iter().map(PoseDiagnosis::combined_excess_m).sum()
    }

    /// Stream with the largest excess residual, if that is unexplained.
    pub fn largest_unexplained(&self) -> Option<(usize, ResidualSize)> {
        let (index, worst) = self
            .streams
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.combined_excess_m().total_cmp(&b.1.combined_excess_m()))?;
        worst.is_unexplained().then(|| (index, worst.excess()))
    }

    /// Of joint zeros, frame errors and rotation conventions.
    pub fn parameter_count(&self) -> usize {
        const FRAME: usize = 6;
        let frames = self.streams.iter().flat_map(|stream| [&stream.reference, &stream.tool]);
        let zeros = self.offsets.iter().filter(|offset| offset.is_chosen);
        zeros.count()
            + FRAME * frames.flatten().filter(|frame| frame.is_chosen).count()
            + self.streams.iter().filter(|stream| stream.is_misread()).count()
    }

    /// The diagnosis, with refined scales and couplings in the encoding. Those that are 1 and 0 are left out.
    pub fn into_diagnosis(self) -> ArmDiagnosis {
        /// Counts as 1: less than 0.1° per turn.
        const FACTOR_TOLERANCE: f64 = 2e-4;
        let Self { mut encoding, offsets, mut scales, mut couplings, streams } = self;
        if let Ok(encoding) = &mut encoding {
            for unit_error in &mut encoding.unit_errors {
                let refined = scales.iter().find(|scale| scale.column == unit_error.column);
                unit_error.factor = refined.map_or(unit_error.factor, |scale| scale.factor.value);
            }
            let is_one = |factor: f64| (factor - 1.0).abs() < FACTOR_TOLERANCE;
            scales.retain(|scale| !is_one(scale.factor.value));
            encoding.unit_errors.retain(|unit_error| {
                unit_error.unit != JointUnit::Scaled || !is_one(unit_error.factor)
            });
            couplings.retain(|coupling| coupling.factor.value.abs() > FACTOR_TOLERANCE);
            encoding.couplings = couplings;
        }
        ArmDiagnosis { joints: JointDiagnosis::without_changes(encoding, offsets, scales), streams }
    }
}
