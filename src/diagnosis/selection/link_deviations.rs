//! Joint zeros of an arm whose links deviate from the nominal model.
//!
//! Links of a real arm deviate by hundredths of a millimetre and thousandths of a degree. A joint zero is
//! reported only if it exceeds their effect. Link deviations are therefore random effects with a prior N(0,
//! s²), where 1 mm corresponds to 0.1°, and zeros are fixed effects (Patterson and Thompson, *Recovery of
//! inter-block information*, Biometrika 58, 1971). The interval of a zero then includes the inaccuracy of
//! the nominal model.
//!
//! A link deviation about or along its joint's axis is that joint's zero. It is a random effect as well,
//! because an offset that all joints share is no single joint's fault.
//!
//! Deviations differ between links: on a factory-new UR5, one link was rotated by 0.37°, the next worst by
//! 0.1°, and no zero was off by 0.01°. So each link has its own s, and the zeros share one. These sizes
//! scatter such that deviations follow Student's t with [`SIZE_PRIOR_DOF`] degrees of freedom. They
//! maximise a variational bound on the marginal likelihood (Bishop, *Pattern Recognition and Machine
//! Learning*, 2006, ch. 10.1 and 10.3).

use super::model_selection::Cause;
use super::nominal_model::{FreeAlongside, is_free_parameter, link_frames};
use crate::model::measurement::{PoseObservations, State, StreamAt, StreamState};
use crate::priors::{
    ABSENT_RADIAL_SCALE_PRIOR, FRAME_PRIOR_M, FREE_PRIOR, LINK_PRIOR_M,
    MAX_LOG_RATIO_OF_CONFOUNDER, MIN_LOG_RATIO_OF_ZERO, MODEL_ERROR_M, RAD_PER_M,
    RADIAL_SCALE_PRIOR, ZERO_PRIOR, price,
};
use crate::solver::linear::Normal;
use crate::{Confounder, Measured};
use ground::geometry::{Rotation, Vec3};
use ground::robot::{JointKind, turn_z_to};
use ground::stats::MeasuredLength;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix6};

pub(crate) const MIN_DEVIATION_M: f64 = 1e-5;
pub(crate) const MAX_DEVIATION_M: f64 = 3e-3;
/// Ratio of successive sizes that are tried.
pub(crate) const DEVIATION_RATIO: f64 = 1.6;
/// Zeros with a larger standard error, relative to [`ZERO_PRIOR`], are not observable.
const MAX_STD_ERROR_SHARE: f64 = 0.5;
const MAX_ZEROS: usize = 4;
pub(crate) const MAX_DEVIATION_SAMPLES: usize = 1000;
/// Zeros of several degrees are nonlinear.
const LINEARIZATION_ROUNDS: usize = 4;
/// Degrees of freedom of the Student's t prior: similarity of the sizes.
const SIZE_PRIOR_DOF: f64 = 8.0;
/// Rounds, and the change of twice the log-likelihood at convergence.
const SIZE_ITERATION_LIMITS: (usize, f64) = (40, 0.02);

/// Joint zeros estimated together with link deviations.
#[derive(Clone, Debug)]
pub(crate) struct LinkDeviations {
    /// Columns of joints with a zero offset, each with the zeros that could replace it.
    pub reported: Vec<(usize, Vec<Confounder>)>,
    /// One per joint of the track, rad or m. `None` if not in the chain or not observable.
    pub zeros: Vec<Option<Measured>>,
    /// Standard deviation of the links, m.
    pub link_m: f64,
    /// Of the link that is displaced most.
    pub largest_displacement: Option<LinkDisplacement>,
}

/// Displacement of a link's outer end from the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkDisplacement {
    /// Columns of the joints at its ends.
    pub joints: [usize; 2],
    /// Size, m.
    pub length_m: Measured,
}

impl LinkDeviations {
    /// Joint offsets plus the reported zeros.
    pub fn with_zeros(&self, offsets: &[f64]) -> Vec<f64> {
        let mut with = offsets.to_vec();
        for &(column, _) in &self.reported {
            with[column] = self.zeros[column].map_or(with[column], |zero| zero.value);
        }
        with
    }

    /// Confounders of a joint's zero. `None` if it is not reported.
    pub fn confounders(&self, column: usize) -> Option<&[Confounder]> {
        self.reported.iter().find(|named| named.0 == column).map(|named| named.1.as_slice())
    }
}

/// Estimates the likeliest zeros and link deviations. The state excludes causes that link deviations imitate.
pub(crate) fn estimate_link_deviations(
    StreamAt { observations, state, offsets }: StreamAt,
) -> Option<LinkDeviations> {
    let mut offsets = offsets.to_vec();
    let mut chosen: Option<DeviationFit> = None;
    for round in 1.. {
        let model = DeviationModel::linearize(observations.at(state, &offsets))?;
        let fit = model.select_zeros(chosen)?;
        let mut next = offsets.clone();
        for &joint in &fit.zeros {
            next[observations.columns[joint]] += model.measured_zero(&fit, joint)?.value;
        }
        let moved = next.iter().zip(&offsets).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if moved < 1e-6 || round == LINEARIZATION_ROUNDS {
            return Some(model.to_link_deviations(&fit, observations, &offsets));
        }
        (offsets, chosen) = (next, Some(fit));
    }
    None
}

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
    let Some(model) = DeviationModel::linearize(at) else {
        return sets.map(|_| ErrorsBesideLinks::default());
    };
    sets.map(|causes| {
        let additional = AdditionalCauses::for_stream(causes, observations, stream);
        let (_, fits) = model.fits_by_size(&additional);
        let joints = observations.columns.len();
        // All links between have five columns.
        let frames = [(0, 0), (joints, 6 + 5 * joints.saturating_sub(1))].map(|(link, first)| {
            is_free_parameter(6 * link, at)
                .then(|| fits.iter().map(|it| model.frame_covariance(it, first)).sum())
        });
        let std_error = |variance: &dyn Fn(&DeviationFit) -> Option<f64>| {
            let mean = |weight: f64, fit| Some(weight * variance(fit)?);
            fits.iter().map(|(weight, fit)| mean(*weight, fit)).sum::<Option<f64>>().map(f64::sqrt)
        };
        let zeros = additional.zeros.iter().map(|&joint| {
            let zero =
                |fit: &DeviationFit| Some(model.measured_zero(fit, joint)?.std_error.powi(2));
            (Cause::Zero(observations.columns[joint]), std_error(&zero))
        });
        let scale_at = model.kinds.len() - 1;
        let scale = |fit: &DeviationFit| Some(fit.covariance_columns(&[scale_at])[(scale_at, 0)]);
        let scale =
            additional.radial_scale.then(|| (Cause::RadialScale(stream), std_error(&scale)));
        let known = |(cause, std_error): (Cause, Option<f64>)| Some((cause, std_error?));
        ErrorsBesideLinks { std_errors: zeros.chain(scale).filter_map(known).collect(), frames }
    })
}

#[derive(Clone, Copy, PartialEq)]
enum DeviationParameter {
    /// Not constrained by the nominal model.
    Unconstrained,
    /// `unit` is its standard deviation at group size 1 m.
    Deviation { group: usize, unit: f64 },
    /// No link deviation imitates it.
    RadialScale,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct AdditionalCauses {
    /// Joints of the chain with a zero offset.
    zeros: Vec<usize>,
    reference: bool,
    tool: bool,
    radial_scale: bool,
}

impl AdditionalCauses {
    fn zeros(joints: &[usize]) -> Self {
        Self { zeros: joints.to_vec(), ..Self::default() }
    }

    /// Causes that affect `stream`.
    fn for_stream(causes: &[Cause], observations: &PoseObservations, stream: usize) -> Self {
        let mut additional = Self::default();
        for cause in causes {
            match *cause {
                Cause::Zero(column) => {
                    let joint = observations.columns.iter().position(|own| *own == column);
                    additional.zeros.extend(joint);
                }
                Cause::Reference(s) => additional.reference |= s == stream,
                Cause::Tool(s) => additional.tool |= s == stream,
                Cause::RadialScale(s) => additional.radial_scale |= s == stream,
                Cause::JointScale(_) | Cause::Latency(_) | Cause::Skew(_) => {}
            }
        }
        additional
    }
}

/// Keeps the causes that exceed the effect of usual link deviations, which are preferred because no arm is
/// exact. A cause is dropped if that lowers twice the log-likelihood by at most the price of a parameter.
/// All links deviate alike, because one that deviates much more is a wrong frame, if it is the first or the last. A radial
/// scale must also exceed the deviation of any one link.
///
/// The state of the stream excludes the causes.
pub(crate) fn causes_beyond_link_deviations(
    at: StreamAt,
    stream: usize,
    causes: &[Cause],
) -> Vec<Cause> {
    let Some(model) = DeviationModel::linearize(at) else {
        return causes.to_vec();
    };
    let additional =
        |causes: &[Cause]| AdditionalCauses::for_stream(causes, at.observations, stream);
    let evidence = |causes: &[Cause]| model.evidence(&additional(causes));
    let min_gain = price(model.dof());
    let mut retained = causes.to_vec();
    let mut present = evidence(&retained);
    while !retained.is_empty() {
        let without = (0..retained.len()).map(|at| {
            let mut rest = retained.clone();
            rest.remove(at);
            (evidence(&rest), rest)
        });
        match without.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((likelihood, rest)) if likelihood + min_gain >= present => {
                (present, retained) = (present.max(likelihood), rest);
            }
            _ => break,
        }
    }
    let scale = Cause::RadialScale(stream);
    if retained.contains(&scale) {
        let evidence = |causes: &[Cause]| model.evidence_of_unequal_links(&additional(causes));
        let others: Vec<Cause> = retained.iter().copied().filter(|cause| *cause != scale).collect();
        if evidence(&retained) <= evidence(&others) + min_gain {
            return others;
        }
    }
    retained
}

/// The joint zero that is likelier than `frame` and than neither, beside the other `causes` and usual link deviations. In
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
    let model = |(observations, stream): (&&PoseObservations, &StreamState)| {
        DeviationModel::linearize(observations.at(stream, &state.offsets))
    };
    let models: Vec<DeviationModel> =
        observations.iter().zip(&state.streams).map(model).collect::<Option<_>>()?;
    let evidence = |cause: Option<Cause>| -> f64 {
        let with: Vec<Cause> = causes.iter().copied().chain(cause).collect();
        let of_stream = |(s, model): (usize, &DeviationModel)| {
            model.evidence(&AdditionalCauses::for_stream(&with, observations[s], s))
        };
        models.iter().enumerate().map(of_stream).sum()
    };
    let scored = zeros.map(|zero| (evidence(Some(zero)), zero));
    let (likeliest, zero) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let is_needed = || likeliest > evidence(None) + price(models[0].dof());
    (likeliest > evidence(Some(frame)) && is_needed()).then_some(zero)
}

/// Ascending sizes of link deviations below `limit_m`.
pub(crate) fn deviation_grid_m(limit_m: f64) -> impl Iterator<Item = f64> {
    let sizes_m = std::iter::successors(Some(MIN_DEVIATION_M), |size_m| Some(size_m * DEVIATION_RATIO));
    sizes_m.take_while(move |size_m| *size_m < limit_m)
}

/// Stream linearised in link frames, latency and zeros.
struct DeviationModel {
    normal: Normal,
    /// Zeros precede the radial scale, which is last.
    kinds: Vec<DeviationParameter>,
    /// In the chain.
    joints: usize,
}

struct DeviationFit {
    /// Joints whose zeros are fixed effects.
    zeros: Vec<usize>,
    /// Size per group, m.
    sizes_m: Vec<f64>,
    /// Twice the log-likelihood, up to a common constant.
    evidence: f64,
    mean: DVector<f64>,
    /// Inverse of the covariance.
    precision: Cholesky<f64, Dyn>,
}

impl DeviationFit {
    /// Columns `at` of the covariance.
    fn covariance_columns(&self, at: &[usize]) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.mean.len(), at.len());
        at.iter().enumerate().for_each(|(column, &row)| columns[(row, column)] = 1.0);
        self.precision.solve_mut(&mut columns);
        columns
    }

    /// Diagonal of the covariance, from the inverse of the Cholesky factor.
    fn variances(&self) -> Vec<f64> {
        let factor = self.precision.l_dirty();
        let variance = |at: usize| {
            let mut column = DVector::zeros(self.mean.len() - at);
            column[0] = 1.0;
            let (mut sum, len) = (0.0, column.len());
            for row in 0..len {
                let value = column[row] / factor[(at + row, at + row)];
                sum += value * value;
                let below = factor.view((at + row + 1, at + row), (len - row - 1, 1));
                column.rows_mut(row + 1, len - row - 1).axpy(-value, &below.column(0), 1.0);
            }
            sum
        };
        (0..self.mean.len()).map(variance).collect()
    }
}

impl DeviationModel {
    /// The weights come from the residual when all links may deviate by about 1 mm.
    fn linearize(stream: StreamAt) -> Option<Self> {
        let rows = stream.observations.rows(MAX_DEVIATION_SAMPLES);
        let linear = link_frames(stream, rows, FreeAlongside::ZerosAndRadialScale);
        let joints = stream.observations.columns.len();
        let (columns, kinds) = parameters(stream);
        // Position and rotation of each sample.
        if 6 * linear.len() <= kinds.len() {
            return None;
        }
        let every = AdditionalCauses { zeros: (0..joints).collect(), ..Default::default() };
        let mut weights = linear.first_weights();
        let mut model = Self { normal: Normal::zeros(kinds.len()), kinds, joints };
        for _ in 0..4 {
            model.normal = linear.normal(&weights).mapped(&columns);
            let Some(fit) = model.fit_with(&every, &model.uniform_sizes(1e-3)) else { break };
            weights = linear.weights_after((&columns * &fit.mean).as_slice());
        }
        Some(model)
    }

    /// Degrees of freedom of the noise estimate.
    fn dof(&self) -> f64 {
        self.normal.dof(self.kinds.len())
    }

    fn uniform_sizes(&self, size_m: f64) -> Vec<f64> {
        vec![size_m; self.joints + 2]
    }

    fn zero_at(&self, joint: usize) -> usize {
        self.kinds.len() - 1 - self.joints + joint
    }

    /// Links and zeros with deviations.
    fn groups(&self) -> impl Iterator<Item = usize> {
        (0..self.joints + 2).filter(|own| {
            self.kinds.iter().any(
                |kind| matches!(kind, DeviationParameter::Deviation { group, .. } if group == own),
            )
        })
    }

    fn fit_with(&self, additional: &AdditionalCauses, sizes_m: &[f64]) -> Option<DeviationFit> {
        let is_of_frame = |group: usize| {
            (additional.reference && group == 0) || (additional.tool && group == self.joints)
        };
        let mut variances: Vec<f64> = self
            .kinds
            .iter()
            .map(|of| match of {
                DeviationParameter::Unconstrained => FREE_PRIOR.powi(2),
                DeviationParameter::Deviation { group, unit } => {
                    let frame = if is_of_frame(*group) { FRAME_PRIOR_M * unit } else { 0.0 };
                    (unit * sizes_m[*group]).powi(2) + frame.powi(2)
                }
                DeviationParameter::RadialScale => if additional.radial_scale {
                    RADIAL_SCALE_PRIOR
                } else {
                    ABSENT_RADIAL_SCALE_PRIOR
                }
                .powi(2),
            })
            .collect();
        for &joint in &additional.zeros {
            variances[self.zero_at(joint)] += ZERO_PRIOR.powi(2);
        }
        if let Some(last) = self.joints.checked_sub(1).filter(|_| additional.tool) {
            // Equivalent to tool rotation about the last axis.
            variances[self.zero_at(last)] += FREE_PRIOR.powi(2);
        }
        let mut precision = self.normal.matrix.clone();
        for (i, variance) in variances.iter().enumerate() {
            precision[(i, i)] += variance.recip();
        }
        let cholesky = precision.cholesky()?;
        let mean = cholesky.solve(&self.normal.right);
        let log_prior: f64 = variances.iter().map(|variance| variance.ln()).sum();
        let usual_m = self.typical_size_m(sizes_m);
        // Of the scaled inverse χ² prior of each variance; 0 if all have the usual size.
        let unlike = |group: usize| {
            let ratio = sizes_m[group] / usual_m;
            2.0 * ratio.ln() + ratio.powi(-2) - 1.0
        };
        let unlike: f64 = self.groups().map(unlike).sum();
        Some(DeviationFit {
            zeros: additional.zeros.clone(),
            sizes_m: sizes_m.to_vec(),
            evidence: self.normal.right.dot(&mean)
                - cholesky.ln_determinant()
                - log_prior
                - SIZE_PRIOR_DOF * unlike,
            mean,
            precision: cholesky,
        })
    }

    /// Share of a fit in the covariance of a frame. Its own link deviates as well. The zero of the last joint is that of the
    /// model, because the tool may equal it.
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

    /// The standard error includes the scatter of all zeros, estimated from the other joints.
    fn measured_zero(&self, fit: &DeviationFit, joint: usize) -> Option<Measured> {
        let at = self.zero_at(joint);
        let DeviationParameter::Deviation { group, unit } = self.kinds[at] else {
            return None;
        };
        let variance = fit.covariance_columns(&[at])[(at, 0)] + (unit * fit.sizes_m[group]).powi(2);
        let others = SIZE_PRIOR_DOF + (self.joints - fit.zeros.len()) as f64;
        (variance > 0.0).then(|| Measured {
            value: fit.mean[at],
            std_error: variance.sqrt(),
            dof: self.dof().min(others),
        })
    }

    /// Log prior of the typical size of deviations, twice, up to a constant.
    fn log_prior(size_m: f64) -> f64 {
        /// Log-normal, m.
        const TYPICAL_M: f64 = MODEL_ERROR_M;
        const LOG_SCATTER: f64 = 1.0;
        -((size_m / TYPICAL_M).ln() / LOG_SCATTER).powi(2)
    }

    /// Twice the log-likelihood, averaged over the common size of the deviations.
    fn evidence(&self, additional: &AdditionalCauses) -> f64 {
        self.fits_by_size(additional).0
    }

    /// Twice the log-likelihood at the likeliest size of each link's deviations.
    fn evidence_of_unequal_links(&self, additional: &AdditionalCauses) -> f64 {
        let (_, by_size) = self.fits_by_size(additional);
        let start = by_size.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let likeliest =
            start.and_then(|(_, fit)| self.maximize_likelihood(additional, &fit.sizes_m));
        likeliest.map_or(f64::NEG_INFINITY, |fit| {
            fit.evidence + Self::log_prior(self.typical_size_m(&fit.sizes_m))
        })
    }

    /// Twice the log-likelihood, averaged over the common size of the deviations, and one fit per size, with the posterior
    /// probability of that size.
    fn fits_by_size(&self, additional: &AdditionalCauses) -> (f64, Vec<(f64, DeviationFit)>) {
        let fits = self.fits_with_equal_sizes(additional);
        let fits = fits.map(|fit| (0.5 * (fit.evidence + Self::log_prior(fit.sizes_m[0])), fit));
        let mut fits: Vec<(f64, DeviationFit)> = fits.collect();
        let likeliest = fits.iter().map(|fit| fit.0).fold(f64::NEG_INFINITY, f64::max);
        fits.iter_mut().for_each(|fit| fit.0 = (fit.0 - likeliest).exp());
        let total: f64 = fits.iter().map(|fit| fit.0).sum();
        fits.iter_mut().for_each(|fit| fit.0 /= total);
        (2.0 * (likeliest + total.ln()), fits)
    }

    /// One fit per common size of the deviations.
    fn fits_with_equal_sizes(
        &self,
        additional: &AdditionalCauses,
    ) -> impl Iterator<Item = DeviationFit> {
        let sizes_m = deviation_grid_m(MAX_DEVIATION_M).chain([MAX_DEVIATION_M]);
        sizes_m.filter_map(|size_m| self.fit_with(additional, &self.uniform_sizes(size_m)))
    }

    fn typical_size_m(&self, sizes_m: &[f64]) -> f64 {
        let precisions: f64 = self.groups().map(|group| sizes_m[group].powi(-2)).sum();
        (self.groups().count() as f64 / precisions).sqrt().clamp(MIN_DEVIATION_M, MAX_DEVIATION_M)
    }

    /// Maximises the likelihood over the sizes, from `sizes_m`. Groups with little information converge
    /// slowly, so the step grows while the likelihood increases.
    fn maximize_likelihood(
        &self,
        additional: &AdditionalCauses,
        sizes_m: &[f64],
    ) -> Option<DeviationFit> {
        let (max_iterations, max_change) = SIZE_ITERATION_LIMITS;
        let mut fit = self.fit_with(additional, sizes_m)?;
        let mut stride = 1.0;
        for _ in 0..max_iterations {
            let likelier = self.updated_sizes(&fit);
            let step = |(&size, &next): (&f64, &f64)| size * (next / size).powf(stride);
            let next: Vec<f64> = fit.sizes_m.iter().zip(&likelier).map(step).collect();
            // A large step may make the system singular.
            match self.fit_with(additional, &next).filter(|next| next.evidence > fit.evidence) {
                Some(next) => {
                    let gained = next.evidence - fit.evidence;
                    (fit, stride) = (next, 2.0 * stride);
                    if gained < max_change {
                        break;
                    }
                }
                None if stride > 1.0 => stride = 1.0,
                None => break,
            }
        }
        Some(fit)
    }

    /// Sizes that maximise the likelihood given this posterior.
    fn updated_sizes(&self, fit: &DeviationFit) -> Vec<f64> {
        let named: Vec<usize> = fit.zeros.iter().map(|joint| self.zero_at(*joint)).collect();
        let usual_m = self.typical_size_m(&fit.sizes_m);
        let variances = fit.variances();
        let mut sums = vec![(SIZE_PRIOR_DOF * usual_m.powi(2), SIZE_PRIOR_DOF); fit.sizes_m.len()];
        for (i, of) in self.kinds.iter().enumerate().filter(|(i, _)| !named.contains(i)) {
            if let DeviationParameter::Deviation { group, unit } = of {
                let square = fit.mean[i].powi(2) + variances[i];
                sums[*group].0 += square / unit.powi(2);
                sums[*group].1 += 1.0;
            }
        }
        let size_m =
            |(sum, count): (f64, f64)| (sum / count).sqrt().clamp(MIN_DEVIATION_M, MAX_DEVIATION_M);
        sums.into_iter().map(size_m).collect()
    }

    /// Started from the best common deviation size.
    fn without_zeros(&self) -> Option<DeviationFit> {
        let none = AdditionalCauses::default();
        let best =
            self.fits_with_equal_sizes(&none).max_by(|a, b| a.evidence.total_cmp(&b.evidence))?;
        self.maximize_likelihood(&none, &best.sizes_m)
    }

    /// One fit per joint that is not `excluded`.
    fn with_one_more_zero(
        &self,
        zeros: &[usize],
        sizes_m: &[f64],
        excluded: &[usize],
    ) -> Vec<(usize, DeviationFit)> {
        let others = (0..self.joints).filter(|joint| !excluded.contains(joint));
        let with = |joint| {
            let with: Vec<usize> = zeros.iter().copied().chain([joint]).collect();
            Some((joint, self.maximize_likelihood(&AdditionalCauses::zeros(&with), sizes_m)?))
        };
        others.filter_map(with).collect()
    }

    /// Selects zeros that exceed link deviations, starting from `before`.
    fn select_zeros(&self, before: Option<DeviationFit>) -> Option<DeviationFit> {
        let mut chosen = match before {
            Some(before) => {
                let zeros = AdditionalCauses::zeros(&before.zeros);
                self.maximize_likelihood(&zeros, &before.sizes_m)?
            }
            None => self.without_zeros()?,
        };
        while chosen.zeros.len() < MAX_ZEROS {
            let with = self.with_one_more_zero(&chosen.zeros, &chosen.sizes_m, &chosen.zeros);
            let with = with.into_iter().map(|(_, with)| with);
            let likeliest = with.max_by(|a, b| a.evidence.total_cmp(&b.evidence));
            let min_evidence = chosen.evidence + MIN_LOG_RATIO_OF_ZERO;
            match likeliest.filter(|likeliest| likeliest.evidence > min_evidence) {
                Some(likeliest) => chosen = likeliest,
                None => break,
            }
        }
        Some(chosen)
    }

    /// Converts `fit` to columns of the joint track.
    fn to_link_deviations(
        &self,
        fit: &DeviationFit,
        observations: &PoseObservations,
        offsets: &[f64],
    ) -> LinkDeviations {
        let absolute = |fit: &DeviationFit, joint: usize| {
            let zero = self.measured_zero(fit, joint)?;
            Some(Measured { value: offsets[observations.columns[joint]] + zero.value, ..zero })
        };
        let mut zeros = vec![None; observations.joints.dof];
        for &joint in &fit.zeros {
            zeros[observations.columns[joint]] = absolute(fit, joint);
        }
        for (joint, with) in self.with_one_more_zero(&fit.zeros, &fit.sizes_m, &fit.zeros) {
            zeros[observations.columns[joint]] = absolute(&with, joint)
                .filter(|zero| zero.std_error < MAX_STD_ERROR_SHARE * ZERO_PRIOR);
        }
        let confounders_of = |&joint: &usize| {
            let others: Vec<usize> =
                fit.zeros.iter().copied().filter(|zero| *zero != joint).collect();
            let instead = self.with_one_more_zero(&others, &fit.sizes_m, &fit.zeros);
            let as_likely = instead.into_iter().filter(|(_, fit_with_zero)| {
                fit_with_zero.evidence > fit.evidence - MAX_LOG_RATIO_OF_CONFOUNDER
            });
            // An insignificant zero replaces nothing: the scatter of all zeros explains the residual.
            let confounder = |(other, fit_with_zero): (usize, DeviationFit)| {
                let zero = self.measured_zero(&fit_with_zero, other)?;
                let column = observations.columns[other];
                (zero.value.abs() > zero.half_width(0.95))
                    .then(|| Confounder::JointZero(column, offsets[column] + zero.value))
            };
            (observations.columns[joint], as_likely.filter_map(confounder).collect())
        };
        let links: Vec<usize> = self.groups().filter(|group| *group <= self.joints).collect();
        let squares: f64 = links.iter().map(|link| fit.sizes_m[*link].powi(2)).sum();
        LinkDeviations {
            reported: fit.zeros.iter().map(confounders_of).collect(),
            zeros,
            link_m: (squares / links.len().max(1) as f64).sqrt(),
            largest_displacement: self.largest_displacement(fit, observations.columns),
        }
    }

    /// Beyond the first joint and before the last. Other links are the base and the tool. `None` unless the displacement of
    /// one link alone explains the residual, which usual deviations do not, and no other link is as likely.
    fn largest_displacement(
        &self,
        fit: &DeviationFit,
        columns: &[usize],
    ) -> Option<LinkDisplacement> {
        /// Residual beside usual deviations, relative to that beside the displaced link; not calibrated. Far displacements in
        /// directions that hardly move the tip make a residual smaller, too.
        const MIN_RESIDUAL_RATIO: f64 = 2.0;
        let zeros = AdditionalCauses::zeros(&fit.zeros);
        let usual = self.uniform_sizes(self.typical_size_m(&fit.sizes_m).min(LINK_PRIOR_M));
        let links = self.groups().filter(|group| (1..self.joints).contains(group));
        let alone = links.filter_map(|link| {
            let mut sizes_m = usual.clone();
            sizes_m[link] = FREE_PRIOR;
            Some((link, self.fit_with(&zeros, &sizes_m)?))
        });
        let mut alone: Vec<(usize, DeviationFit)> = alone.collect();
        alone.sort_by(|a, b| b.1.evidence.total_cmp(&a.1.evidence));
        let (link, best) = alone.first()?;
        let min_gain = (MIN_RESIDUAL_RATIO.powi(2) - 1.0) * self.dof();
        let is_needed = best.evidence > self.fit_with(&zeros, &usual)?.evidence + min_gain;
        let is_single = alone
            .get(1)
            .is_none_or(|(_, other)| best.evidence > other.evidence + MAX_LOG_RATIO_OF_CONFOUNDER);
        (is_needed && is_single).then(|| {
            let own = DeviationParameter::Deviation { group: *link, unit: 1.0 };
            let own: Vec<usize> = (0..self.kinds.len()).filter(|&i| self.kinds[i] == own).collect();
            let mean: Vec<f64> = own.iter().map(|&i| best.mean[i]).collect();
            let covariance = best.covariance_columns(&own).select_rows(&own);
            let length_m = MeasuredLength::estimate(&mean, &covariance, self.dof()).norm;
            LinkDisplacement { joints: [columns[link - 1], columns[*link]], length_m }
        })
    }
}

/// Columns of [`link_frames`] and kinds of the parameters: deviations of each link frame, latency, zeros (a
/// separate group) and radial scale. A link frame has six deviations, except the one equal to its joint's
/// zero.
fn parameters(stream: StreamAt) -> (DMatrix<f64>, Vec<DeviationParameter>) {
    let observations = stream.observations;
    let joints = observations.columns.len();
    let latency = 6 * (joints + 1);
    let unit = |is_rotation: bool| if is_rotation { RAD_PER_M } else { 1.0 };
    let mut columns: Vec<DVector<f64>> = Vec::new();
    let mut of = Vec::new();
    let radial_scale = latency + 1 + joints;
    let axes = observations.chain.joint_axes();
    let kinds = observations.chain.joint_kinds();
    for link in 0..=joints {
        let is_free = is_free_parameter(6 * link, stream);
        let joint = link.checked_sub(1).filter(|_| !is_free);
        let basis = joint.map_or_else(Rotation::identity, |joint| turn_z_to(&axes[joint]));
        for (axis, is_rotation) in (0..6).map(|i| (i % 3, i >= 3)) {
            let is_zero = |joint: usize| is_rotation != (kinds[joint] == JointKind::Prismatic);
            if axis == 2 && joint.is_some_and(is_zero) {
                continue;
            }
            let first = 6 * link + if is_rotation { 3 } else { 0 };
            let mut column = DVector::zeros(radial_scale + 1);
            column.fixed_rows_mut::<3>(first).copy_from(&(basis * Vec3::ith(axis, 1.0)));
            columns.push(column);
            of.push(match is_free {
                true => DeviationParameter::Unconstrained,
                false => DeviationParameter::Deviation { group: link, unit: unit(is_rotation) },
            });
        }
    }
    for own in latency..=radial_scale {
        let mut column = DVector::zeros(radial_scale + 1);
        column[own] = 1.0;
        columns.push(column);
        of.push(match own.checked_sub(latency + 1) {
            None => DeviationParameter::Unconstrained,
            Some(joint) if joint == joints => DeviationParameter::RadialScale,
            Some(joint) => {
                let is_rotation = kinds[joint] != JointKind::Prismatic;
                DeviationParameter::Deviation { group: joints + 1, unit: unit(is_rotation) }
            }
        });
    }
    (DMatrix::from_columns(&columns), of)
}

#[cfg(test)]
mod tests {
    use crate::diagnose_arm;
    use crate::test_motion::{arm, chain_with, deviating_chain, pose_track, tip_stream};
    use crate::test_random::Lcg;
    use ground::geometry::{Pose, Rotation, Vec3};
    use ground::robot::Chain;

    /// Joints and length, mm, of the link that is displaced most, of an arm that moves like `of`.
    fn largest_displacement(of: &Chain) -> Option<([usize; 2], f64)> {
        let (joints, chain) = arm();
        let mut random = Lcg::new();
        let noisy = |q: &[f64]| {
            let pose = of.forward(q);
            (pose.translation.vector + Vec3::from(random.triple(2e-5)), pose.rotation)
        };
        let track = pose_track(&joints.t_s, joints.q.chunks(6).map(noisy));
        let found = diagnose_arm(&joints, &[tip_stream(&track, &chain)], 1.0);
        assert!(found.streams[0].is_nominal);
        let link = found.streams[0].largest_displacement?;
        Some((link.joints, 1e3 * link.length_m.value))
    }

    #[test]
    fn one_link_that_differs_from_the_model_is_found() {
        for link in 2..5 {
            let mut deviations = [Pose::identity(); 7];
            let shift = Vec3::new(3e-3, 0.0, 0.0);
            deviations[link] = Pose::from_parts(shift.into(), Rotation::identity());
            let found = largest_displacement(&chain_with(&deviations));
            let (joints, length_mm) = found.expect("a link");
            assert_eq!(joints, [link - 1, link]);
            assert!((length_mm - 3.0).abs() < 0.3, "{link}: {length_mm}");
        }
        let usual = largest_displacement(&deviating_chain(5e-4));
        assert!(usual.is_none_or(|(_, usual_mm)| usual_mm < 2.0), "{usual:?}");
    }
}
