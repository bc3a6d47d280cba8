//! Causes that exceed the effect of link deviations, and their accuracy together with link deviations.

use super::deviation_model::{DeviationFit, DeviationModel};
use super::model_selection::Cause;
use super::nominal_model::is_free_parameter;
use crate::model::measurement::{PoseObservations, State, StreamAt};
use crate::priors::{RAD_PER_M, price};
use nalgebra::Matrix6;

/// Errors of causes that are free together, including the effect of link deviations that may hide in the noise.
#[derive(Default)]
pub(crate) struct ErrorsBesideLinks {
    /// Standard errors of joint zeros and radial scales.
    pub std_errors: Vec<(Cause, f64)>,
    /// Covariances of the twists of the reference and of the last joint's link, in their own axes. `None` unless the
    /// reference or the tool differs from the model.
    pub frames: [Option<Matrix6<f64>>; 2],
}

/// For each of `sets` of causes.
pub(crate) fn errors_beside_links<const N: usize>(
    at: StreamAt,
    stream: usize,
    sets: [&[Cause]; N],
) -> [ErrorsBesideLinks; N] {
    let observations = at.observations;
    let Some(model) = DeviationModel::linearize(at, stream) else {
        return sets.map(|_| ErrorsBesideLinks::default());
    };
    sets.map(|causes| {
        let (_, fits) = model.fits_by_size(causes);
        let joints = observations.columns.len();
        // All links between have five columns.
        let frames = [(0, 0), (joints, 6 + 5 * joints.saturating_sub(1))].map(|(link, first)| {
            is_free_parameter(6 * link, at)
                .then(|| fits.iter().map(|it| model.frame_covariance(it, first)).sum())
        });
        let std_error = |variance: &dyn Fn(&DeviationFit) -> Option<f64>| {
            let weighted = fits.iter().map(|(weight, fit)| Some(weight * variance(fit)?));
            weighted.sum::<Option<f64>>().map(f64::sqrt)
        };
        let zeros = model.zeros_of(causes).into_iter().map(|joint| {
            let zero =
                |fit: &DeviationFit| Some(model.measured_zero(fit, joint)?.std_error.powi(2));
            (Cause::Zero(observations.columns[joint]), std_error(&zero))
        });
        let scale_at = model.kinds.len() - 1;
        let scale = |fit: &DeviationFit| Some(fit.variance(scale_at));
        let cause = Cause::RadialScale(stream);
        let scale = causes.contains(&cause).then(|| (cause, std_error(&scale)));
        let known = |(cause, std_error): (Cause, Option<f64>)| Some((cause, std_error?));
        ErrorsBesideLinks { std_errors: zeros.chain(scale).filter_map(known).collect(), frames }
    })
}

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
        DeviationModel::linearize(observations.at(&state.streams[s], &state.offsets), s)
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
    /// Share of a fit in the covariance of a frame. Its own link deviates as well. The zero of the last joint is
    /// fixed, because the tool may equal it.
    fn frame_covariance(&self, (weight, fit): &(f64, DeviationFit), first: usize) -> Matrix6<f64> {
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
