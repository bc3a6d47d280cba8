//! Causes that exceed the effect of link deviations, and their accuracy together with link deviations.

use super::deviation_model::{DeviationFit, DeviationModel, WeightedFit};
use super::model_selection::Cause;
use crate::model::measurement::{PoseObservations, State, StreamAt};
use crate::priors::{RAD_PER_M, price};
use nalgebra::Matrix6;

/// Keeps the causes that exceed the effect of usual link deviations, which are preferred because no arm is
/// exact. A cause is dropped if that lowers twice the log-likelihood by at most the price of a parameter.
/// All links have the same prior: a first or last link that deviates much more is a wrong frame. A radial
/// scale must also exceed the deviation of any one link.
///
/// The state of the stream excludes the causes.
pub(crate) fn causes_beyond_link_deviations(
    at: StreamAt,
    stream: usize,
    causes: &[Cause],
) -> Vec<Cause> {
    let Some(model) = DeviationModel::linearize(at, stream) else {
        return causes.to_vec();
    };
    let min_gain = price(model.dof);
    let mut retained = causes.to_vec();
    let mut present = model.evidence(&retained);
    let without_one = |causes: &[Cause]| {
        let without = (0..causes.len()).map(|at| {
            let mut rest = causes.to_vec();
            rest.remove(at);
            (model.evidence(&rest), rest)
        });
        without.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    while let Some((likelihood, rest)) =
        without_one(&retained).filter(|(likelihood, _)| likelihood + min_gain >= present)
    {
        (present, retained) = (present.max(likelihood), rest);
    }
    let scale = Cause::RadialScale(stream);
    if retained.contains(&scale) {
        let evidence = |causes: &[Cause]| model.evidence_of_unequal_links(causes);
        let others: Vec<Cause> = retained.iter().copied().filter(|cause| *cause != scale).collect();
        if evidence(&retained) <= evidence(&others) + min_gain {
            return others;
        }
    }
    retained
}

/// The joint zero that is likelier than `frame` and than neither, with the other `causes` and usual link deviations. In
/// a small motion, any zero moves the tip as a tool does, but only in one direction.
///
/// The streams are linearised about `state`, which excludes the causes and the frame.
pub(crate) fn zero_instead_of_frame(
    observations: &[&PoseObservations],
    state: &State,
    frame: Cause,
    causes: &[Cause],
    zeros: impl Iterator<Item = Cause>,
) -> Option<Cause> {
    let of_stream = |(s, observations): (usize, &&PoseObservations)| {
        DeviationModel::linearize(observations.in_state(state, s), s)
    };
    let models: Vec<DeviationModel> =
        observations.iter().enumerate().map(of_stream).collect::<Option<_>>()?;
    let evidence = |cause: Option<Cause>| -> f64 {
        let with: Vec<Cause> = causes.iter().copied().chain(cause).collect();
        models.iter().map(|model| model.evidence(&with)).sum()
    };
    let scored = zeros.map(|zero| (evidence(Some(zero)), zero));
    let (likeliest, zero) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_needed = || likeliest > evidence(None) + price(models[0].dof);
    (likeliest > evidence(Some(frame)) && is_needed()).then_some(zero)
}

impl DeviationModel {
    /// Standard errors of the joint zeros and the radial scale among `causes`, by fits with these. They include the
    /// effect of link deviations that may hide in the noise.
    pub fn std_errors(&self, causes: &[Cause], fits: &[WeightedFit]) -> Vec<(Cause, f64)> {
        let std_error = |&cause: &Cause| {
            let variance = |fit: &DeviationFit| match cause {
                Cause::Zero(column) => {
                    let joint = self.columns.iter().position(|own| *own == column)?;
                    Some(self.measured_zero(fit, joint)?.std_error.powi(2))
                }
                Cause::RadialScale(s) if s == self.stream => {
                    Some(fit.variance(self.kinds.len() - 1))
                }
                _ => None,
            };
            let weighted = fits.iter().map(|(weight, fit)| Some(weight * variance(fit)?));
            Some((cause, weighted.sum::<Option<f64>>()?.sqrt()))
        };
        causes.iter().filter_map(std_error).collect()
    }

    /// Covariances of the twists of the reference and of the last joint's link, in their own axes. `None` unless the
    /// reference or the tool differs from the model.
    pub fn frame_covariances(&self, fits: &[WeightedFit]) -> [Option<Matrix6<f64>>; 2] {
        // All links between have five columns.
        let last = 6 + 5 * self.joints.saturating_sub(1);
        [0, last].map(|first| {
            let is_free = self.kinds[first].group.is_none();
            is_free.then(|| fits.iter().map(|it| self.frame_covariance(it, first)).sum())
        })
    }

    /// Share of a fit in the covariance of a frame. Its own link deviates as well. The zero of the last joint is
    /// fixed, because the tool may equal it.
    fn frame_covariance(&self, (weight, fit): &WeightedFit, first: usize) -> Matrix6<f64> {
        let last_zero = self.zero_at(self.joints.saturating_sub(1));
        let columns: Vec<usize> = (first..first + 6).chain([last_zero]).collect();
        let covariance = fit.covariance_columns(&columns);
        let size_m = self.typical_size_m(&fit.sizes_m);
        let entry = |row: usize, column: usize| {
            let by_zero = covariance[(first + row, 6)] * covariance[(first + column, 6)]
                / covariance[(last_zero, 6)];
            let of_link = if row < 3 { size_m } else { size_m * RAD_PER_M };
            let deviation = if row == column { of_link.powi(2) } else { 0.0 };
            covariance[(first + row, column)] - by_zero + deviation
        };
        Matrix6::from_fn(entry) * *weight
    }

    /// Twice the log-likelihood at the likeliest size of each link's deviations.
    fn evidence_of_unequal_links(&self, causes: &[Cause]) -> f64 {
        let (_, by_size) = self.fits_by_size(causes);
        let start = by_size.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let likeliest = start.and_then(|(_, fit)| self.maximize_likelihood(causes, &fit.sizes_m));
        likeliest.map_or(f64::NEG_INFINITY, |fit| {
            fit.evidence + Self::log_prior(self.typical_size_m(&fit.sizes_m))
        })
    }
}
