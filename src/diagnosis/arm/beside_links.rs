//! Standard errors that include link deviations, which may hide in the noise.

use super::fit::ArmFit;
use crate::Measured;
use crate::encodings::decoded_stream::DecodedStream;
use crate::model::measurement::State;
use crate::selection::link_deviations::std_errors_beside_links;
use crate::selection::model_selection::Cause;

/// Standard errors of zeros and radial scales. For selected ones the selected causes are free, for others also all zeros or
/// the radial scale. Zeros that were fitted with link deviations are left out.
#[derive(Default)]
pub(super) struct BesideLinks {
    std_errors: Vec<(Cause, f64)>,
}

impl BesideLinks {
    pub fn new(fitted: &ArmFit, decoded: &[&DecodedStream]) -> Self {
        let mut beside = Self::default();
        let (selected, optional) = (&fitted.model.causes, &fitted.candidates.optional);
        let is_scale = |cause: &Cause| matches!(cause, Cause::RadialScale(_));
        let is_nominal = fitted.deviations.is_some();
        if is_nominal && !selected.iter().any(is_scale) {
            return beside;
        }
        let with = |others: &dyn Fn(&Cause) -> bool| -> Vec<Cause> {
            let others = optional.iter().filter(|cause| others(cause) && !selected.contains(cause));
            selected.iter().chain(others).copied().collect()
        };
        let zeros = with(&|cause| matches!(cause, Cause::Zero(_)));
        let State { offsets, streams } = fitted.exact_state();
        for (index, (decoded, state)) in decoded.iter().zip(&streams).enumerate() {
            if decoded.observations.chain.is_floating() {
                continue;
            }
            let scale = with(&|cause| *cause == Cause::RadialScale(index));
            let [of_selected, of_zeros, of_scale] = std_errors_beside_links(
                (&decoded.observations, index),
                state,
                &offsets,
                [selected, &zeros, &scale],
            );
            let others = of_zeros.into_iter().chain(of_scale);
            let others = others.filter(|(cause, _)| !selected.contains(cause));
            let found = of_selected.into_iter().chain(others);
            let found = found.filter(|(cause, _)| !is_nominal || is_scale(cause));
            found.for_each(|found| beside.add(found));
        }
        beside
    }

    /// The stream with the smallest standard error counts.
    fn add(&mut self, (cause, std_error): (Cause, f64)) {
        match self.std_errors.iter_mut().find(|(own, _)| *own == cause) {
            Some((_, own)) => *own = own.min(std_error),
            None => self.std_errors.push((cause, std_error)),
        }
    }

    /// `measured`, with the larger standard error.
    pub fn widen(&self, cause: Cause, measured: Measured) -> Measured {
        let own = self.std_errors.iter().find(|(own, _)| *own == cause);
        let std_error = own.map_or(0.0, |(_, std_error)| *std_error).max(measured.std_error);
        Measured { std_error, ..measured }
    }
}
