//! Pose stream of an arm whose links deviate from the nominal model.
//!
//! Links of a real arm deviate by hundredths of a millimetre and thousandths of a degree. Link deviations are random effects
//! with a prior N(0, s²), where 1 mm corresponds to 0.1°; causes beside them are fixed effects (Patterson and Thompson,
//! *Recovery of inter-block information*, Biometrika 58, 1971). A deviation about or along a joint's axis is that joint's
//! zero. It is a random effect as well, because an offset that all joints share is no single joint's fault.
//!
//! Deviations differ between links: on a factory-new UR5, one link was rotated by 0.37°, the next worst by 0.1°, and no zero
//! was off by 0.01°. So each link has its own s, and the zeros share one. These sizes scatter such that deviations follow
//! Student's t with [`SIZE_PRIOR_DOF`] degrees of freedom. They maximise a variational bound on the marginal likelihood
//! (Bishop, *Pattern Recognition and Machine Learning*, 2006, ch. 10.1 and 10.3).

use super::model_selection::Cause;
use super::nominal_model::{FreeAlongside, is_free_parameter, link_frames};
use crate::Measured;
use crate::model::measurement::StreamAt;
use crate::priors::{
    ABSENT_RADIAL_SCALE_PRIOR, FRAME_PRIOR_M, FREE_PRIOR, MODEL_ERROR_M, RAD_PER_M,
    RADIAL_SCALE_PRIOR, ZERO_PRIOR,
};
use crate::solver::linear::Normal;
use ground::geometry::{Rotation, Vec3};
use ground::robot::turn_z_to;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Minimum, maximum, ratio.
pub(crate) const DEVIATION_GRID_M: (f64, f64, f64) = (1e-5, 3e-3, 1.6);
pub(crate) const MAX_DEVIATION_SAMPLES: usize = 1000;
/// Degrees of freedom of the Student's t prior: similarity of the sizes.
const SIZE_PRIOR_DOF: f64 = 8.0;
/// Rounds, and the change of twice the log-likelihood at convergence.
const SIZE_ITERATION_LIMITS: (usize, f64) = (40, 0.02);

pub(crate) struct DeviationParameter {
    /// Link, or the zeros. `None` if the nominal model does not constrain it.
    pub group: Option<usize>,
    /// Standard deviation, at group size 1 m.
    pub unit: f64,
    /// Cause of a larger value, with its standard deviation.
    cause: Option<(Cause, f64)>,
}

impl DeviationParameter {
    const UNCONSTRAINED: Self = Self { group: None, unit: FREE_PRIOR, cause: None };
}

/// Ascending grid.
pub(super) fn sizes_m() -> impl Iterator<Item = f64> {
    let (min_size_m, max_size_m, times) = DEVIATION_GRID_M;
    let tried = std::iter::successors(Some(min_size_m), move |size_m| Some(size_m * times));
    tried.take_while(move |size_m| *size_m < max_size_m).chain([max_size_m])
}

/// Stream linearised in link frames, latency and zeros.
pub(crate) struct DeviationModel {
    /// Index of the stream.
    pub(super) stream: usize,
    /// Columns of the chain's joints in the track.
    pub columns: Vec<usize>,
    normal: Normal,
    /// Zeros precede the radial scale, which is last.
    pub kinds: Vec<DeviationParameter>,
    /// In the chain.
    pub joints: usize,
    /// Degrees of freedom of the noise estimate.
    pub dof: f64,
}

pub(crate) struct DeviationFit {
    /// Joints whose zeros are fixed effects.
    pub zeros: Vec<usize>,
    /// Size per group, m.
    pub sizes_m: Vec<f64>,
    /// Twice the log-likelihood, up to a common constant.
    pub evidence: f64,
    pub mean: DVector<f64>,
    /// Inverse of the covariance.
    precision: Cholesky<f64, Dyn>,
}

/// Fit with its weight.
pub(crate) type WeightedFit = (f64, DeviationFit);

impl DeviationFit {
    /// Columns `at` of the covariance.
    pub fn covariance_columns(&self, at: &[usize]) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(self.mean.len(), at.len());
        at.iter().enumerate().for_each(|(column, &row)| columns[(row, column)] = 1.0);
        self.precision.solve_mut(&mut columns);
        columns
    }

    pub fn variance(&self, at: usize) -> f64 {
        self.covariance_columns(&[at])[(at, 0)]
    }

    /// Diagonal of the covariance, from the inverse of the Cholesky factor.
    fn variances(&self) -> Vec<f64> {
        let mut inverse = DMatrix::identity(self.mean.len(), self.mean.len());
        self.precision.l_dirty().solve_lower_triangular_unchecked_mut(&mut inverse);
        inverse.column_iter().map(|column| column.norm_squared()).collect()
    }
}

impl DeviationModel {
    /// The weights come from the residual when all links may deviate by about 1 mm.
    pub fn linearize(stream: StreamAt, index: usize) -> Option<Self> {
        let rows = stream.observations.rows(MAX_DEVIATION_SAMPLES);
        let linear = link_frames(stream, rows, FreeAlongside::ZerosAndRadialScale);
        let joints = stream.observations.columns.len();
        let (columns, kinds) = parameters(stream, index);
        // Position and rotation of each sample.
        if 6 * linear.len() <= kinds.len() {
            return None;
        }
        let track_columns = stream.observations.columns.to_vec();
        let every: Vec<Cause> = track_columns.iter().copied().map(Cause::Zero).collect();
        let mut weights = linear.first_weights();
        let normal = Normal::zeros(kinds.len());
        let mut model =
            Self { stream: index, columns: track_columns, normal, kinds, joints, dof: 3.0 };
        for _ in 0..4 {
            let normal = linear.normal(&weights);
            model.dof = normal.dof(model.kinds.len());
            model.normal.matrix = columns.tr_mul(&normal.matrix) * &columns;
            model.normal.right = columns.tr_mul(&normal.right);
            let Some(fit) = model.fit_with(&every, &model.uniform_sizes(1e-3)) else { break };
            weights = linear.weights_after((&columns * &fit.mean).as_slice());
        }
        Some(model)
    }

    pub fn uniform_sizes(&self, size_m: f64) -> Vec<f64> {
        vec![size_m; self.joints + 2]
    }

    /// Joints of the chain with a zero among `causes`.
    pub fn zeros_of(&self, causes: &[Cause]) -> Vec<usize> {
        let joint = |cause: &Cause| match cause {
            Cause::Zero(column) => self.columns.iter().position(|own| own == column),
            _ => None,
        };
        causes.iter().filter_map(joint).collect()
    }

    pub fn zero_at(&self, joint: usize) -> usize {
        self.kinds.len() - 1 - self.joints + joint
    }

    /// Links and zeros with deviations.
    pub fn groups(&self) -> impl Iterator<Item = usize> {
        (0..self.joints + 2).filter(|own| self.kinds.iter().any(|kind| kind.group == Some(*own)))
    }

    /// Fit with `causes` beside the deviations.
    pub fn fit_with(&self, causes: &[Cause], sizes_m: &[f64]) -> Option<DeviationFit> {
        let variance = |DeviationParameter { group, unit, cause }: &DeviationParameter| {
            let deviation = group.map_or(*unit, |group| unit * sizes_m[group]);
            let of_cause = cause.filter(|(cause, _)| causes.contains(cause));
            deviation.powi(2) + of_cause.map_or(0.0, |(_, size)| size.powi(2))
        };
        let mut variances: Vec<f64> = self.kinds.iter().map(variance).collect();
        let has_tool = causes.contains(&Cause::Tool(self.stream));
        if let Some(last) = self.joints.checked_sub(1).filter(|_| has_tool) {
            // Equivalent to tool rotation about the last axis.
            variances[self.zero_at(last)] += FREE_PRIOR.powi(2);
        }
        let mut precision = self.normal.matrix.clone();
        for (i, variance) in variances.iter().enumerate() {
            precision[(i, i)] += variance.recip();
        }
        let cholesky = precision.cholesky()?;
        let mean = cholesky.solve(&self.normal.right);
        let log_det: f64 = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
        let log_prior: f64 = variances.iter().map(|variance| variance.ln()).sum();
        let usual_m = self.typical_size_m(sizes_m);
        // Of the scaled inverse χ² prior of each variance; 0 if all have the usual size.
        let unlike = |group: usize| {
            let ratio = sizes_m[group] / usual_m;
            2.0 * ratio.ln() + ratio.powi(-2) - 1.0
        };
        let unlike: f64 = self.groups().map(unlike).sum();
        Some(DeviationFit {
            zeros: self.zeros_of(causes),
            sizes_m: sizes_m.to_vec(),
            evidence: self.normal.right.dot(&mean) - log_det - log_prior - SIZE_PRIOR_DOF * unlike,
            mean,
            precision: cholesky,
        })
    }

    /// The standard error includes the scatter of all zeros, estimated from the other joints.
    pub fn measured_zero(&self, fit: &DeviationFit, joint: usize) -> Option<Measured> {
        let at = self.zero_at(joint);
        let DeviationParameter { group, unit, .. } = self.kinds[at];
        let variance = fit.variance(at) + (unit * fit.sizes_m[group?]).powi(2);
        let others = SIZE_PRIOR_DOF + (self.joints - fit.zeros.len()) as f64;
        (variance > 0.0).then(|| Measured {
            value: fit.mean[at],
            std_error: variance.sqrt(),
            dof: self.dof.min(others),
        })
    }

    /// Log prior of the typical size of deviations, twice, up to a constant.
    pub fn log_prior(size_m: f64) -> f64 {
        /// Log-normal, m.
        const TYPICAL_M: f64 = MODEL_ERROR_M;
        const LOG_SCATTER: f64 = 1.0;
        -((size_m / TYPICAL_M).ln() / LOG_SCATTER).powi(2)
    }

    /// Twice the log-likelihood, averaged over the common size of the deviations.
    pub fn evidence(&self, causes: &[Cause]) -> f64 {
        self.fits_by_size(causes).0
    }

    /// Twice the log-likelihood, averaged over the common size of the deviations, and one fit per size, with the posterior
    /// probability of that size.
    pub fn fits_by_size(&self, causes: &[Cause]) -> (f64, Vec<WeightedFit>) {
        let fits = sizes_m().filter_map(|size_m| {
            let fit = self.fit_with(causes, &self.uniform_sizes(size_m))?;
            Some((0.5 * (fit.evidence + Self::log_prior(size_m)), fit))
        });
        let mut fits: Vec<WeightedFit> = fits.collect();
        let likeliest = fits.iter().map(|fit| fit.0).fold(f64::NEG_INFINITY, f64::max);
        fits.iter_mut().for_each(|fit| fit.0 = (fit.0 - likeliest).exp());
        let total: f64 = fits.iter().map(|fit| fit.0).sum();
        fits.iter_mut().for_each(|fit| fit.0 /= total);
        (2.0 * (likeliest + total.ln()), fits)
    }

    pub fn typical_size_m(&self, sizes_m: &[f64]) -> f64 {
        let (min_size_m, max_size_m, _) = DEVIATION_GRID_M;
        let precisions: f64 = self.groups().map(|group| sizes_m[group].powi(-2)).sum();
        (self.groups().count() as f64 / precisions).sqrt().clamp(min_size_m, max_size_m)
    }

    /// Maximises the likelihood over the sizes, from `sizes_m`. Groups with little information converge
    /// slowly, so the step grows while the likelihood increases.
    pub fn maximize_likelihood(&self, causes: &[Cause], sizes_m: &[f64]) -> Option<DeviationFit> {
        let (max_iterations, max_change) = SIZE_ITERATION_LIMITS;
        let mut fit = self.fit_with(causes, sizes_m)?;
        let mut stride = 1.0;
        for _ in 0..max_iterations {
            let likelier = self.updated_sizes(&fit);
            let step = |(&size, &next): (&f64, &f64)| size * (next / size).powf(stride);
            let next: Vec<f64> = fit.sizes_m.iter().zip(&likelier).map(step).collect();
            // A large step may make the system singular.
            match self.fit_with(causes, &next).filter(|next| next.evidence > fit.evidence) {
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
            if let Some(group) = of.group {
                let square = fit.mean[i].powi(2) + variances[i];
                sums[group].0 += square / of.unit.powi(2);
                sums[group].1 += 1.0;
            }
        }
        let (min_size_m, max_size_m, _) = DEVIATION_GRID_M;
        let size_m = |(sum, count): (f64, f64)| (sum / count).sqrt().clamp(min_size_m, max_size_m);
        sums.into_iter().map(size_m).collect()
    }
}

/// Columns of [`link_frames`] and kinds of the parameters: deviations of each link frame, latency, zeros (a
/// separate group) and radial scale. A link frame has six deviations, except the one equal to its joint's
/// zero.
fn parameters(stream: StreamAt, index: usize) -> (DMatrix<f64>, Vec<DeviationParameter>) {
    let StreamAt { observations, .. } = stream;
    let joints = observations.columns.len();
    let latency = 6 * (joints + 1);
    let width = latency + joints + 2;
    let axes = observations.chain.joint_axes();
    let is_rotary = |joint: usize| !observations.chain.slides(joint);
    let unit = |is_rotation: bool| if is_rotation { RAD_PER_M } else { 1.0 };
    let (mut columns, mut kinds) = (Vec::new(), Vec::new());
    for link in 0..=joints {
        let is_free = is_free_parameter(6 * link, stream);
        let frame = match link {
            0 => Some(Cause::Reference(index)),
            _ => (link == joints).then_some(Cause::Tool(index)),
        };
        let joint = link.checked_sub(1).filter(|_| !is_free);
        let basis = joint.map_or_else(Rotation::identity, |joint| turn_z_to(&axes[joint]));
        for (axis, is_rotation) in (0..6).map(|i| (i % 3, i >= 3)) {
            if axis == 2 && joint.is_some_and(|joint| is_rotary(joint) == is_rotation) {
                continue;
            }
            let first = 6 * link + if is_rotation { 3 } else { 0 };
            let mut column = DVector::zeros(width);
            column.fixed_rows_mut::<3>(first).copy_from(&(basis * Vec3::ith(axis, 1.0)));
            columns.push(column);
            let unit = unit(is_rotation);
            let cause = frame.map(|frame| (frame, FRAME_PRIOR_M * unit));
            kinds.push(match is_free {
                true => DeviationParameter::UNCONSTRAINED,
                false => DeviationParameter { group: Some(link), unit, cause },
            });
        }
    }
    let identity = DMatrix::<f64>::identity(width, width);
    columns.extend(identity.column_iter().skip(latency).map(|column| column.into_owned()));
    kinds.push(DeviationParameter::UNCONSTRAINED);
    kinds.extend(observations.columns.iter().enumerate().map(|(joint, &column)| {
        let cause = Some((Cause::Zero(column), ZERO_PRIOR));
        DeviationParameter { group: Some(joints + 1), unit: unit(is_rotary(joint)), cause }
    }));
    let cause = Some((Cause::RadialScale(index), RADIAL_SCALE_PRIOR));
    kinds.push(DeviationParameter { group: None, unit: ABSENT_RADIAL_SCALE_PRIOR, cause });
    (DMatrix::from_columns(&columns), kinds)
}
