//! Linearised pose streams of a calibration, and steps to the maximum of the posterior.

use super::parameters::CalibrationParameters;
use super::{CalibrationStream, FrameFreedom, MAX_LINK_SIZE_M, PointDistance};
use crate::model::measurement::{ExcludedComponents, PoseObservations, StreamState, pose_of_twist};
use crate::selection::deviation_model::DEVIATION_GRID_M;
use crate::selection::nominal_model::{FreeAlongside, link_frames};
use crate::solver::linear::{Linear, Normal, Weight};
use ground::geometry::{Pose, Vec3};
use ground::robot::{LinkPath, Robot};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::collections::BTreeSet;
use std::ops::Range;

/// Per stream; more do not improve the estimate.
const MAX_SAMPLES: usize = 20_000;
/// Per stream, for cross-validation.
const BLOCKS: usize = 50;
pub(super) const FOLDS: usize = 5;

pub(super) struct CalibrationState {
    pub values: DVector<f64>,
    /// Streams' own parameters are relative to the initial state.
    pub streams: Vec<StreamState>,
}

pub(super) struct LinearizedStream {
    pub linear: Linear,
    pub weights: Vec<Weight>,
}

pub(super) struct CalibrationSystem<'a> {
    pub robot: &'a Robot,
    pub path: &'a LinkPath,
    pub parameters: CalibrationParameters,
    pub streams: &'a [CalibrationStream<'a>],
    /// [`CalibrationParameters::columns_of`] each stream.
    pub columns: Vec<DMatrix<f64>>,
    pub distances: &'a [PointDistance],
}

impl CalibrationSystem<'_> {
    /// Robot with link deviations and these zeros.
    pub fn robot_with(&self, state: &CalibrationState, zeros: &[f64]) -> Robot {
        let deviations = self.parameters.deviations(state.values.as_slice());
        let deviations: Vec<Pose> = deviations.iter().map(|twist| pose_of_twist(twist)).collect();
        self.robot.with_deviations(self.path, &deviations, zeros)
    }

    pub fn zeros(&self, state: &CalibrationState) -> Vec<f64> {
        let mut zeros = vec![0.0; self.path.axes.len()];
        for (at, &joint) in self.parameters.zeros.iter().enumerate() {
            zeros[joint] = state.values[self.parameters.links.len() + at];
        }
        zeros
    }

    /// Weights are from the residuals there. A fit absorbed `fitted_share` of their variance; `None` before a fit.
    pub fn linearize(
        &self,
        state: &CalibrationState,
        fitted_share: Option<f64>,
    ) -> Option<Vec<LinearizedStream>> {
        let robot = self.robot_with(state, &[]);
        let zeros = self.zeros(state);
        let of_stream = |(stream, stream_state): (&CalibrationStream, &StreamState)| {
            let chain = robot.chain(stream.base, stream.tip).ok()?;
            let (joints, columns) = (stream.joints, &stream.columns);
            let at_rest = vec![0.0; joints.dof];
            let observations = PoseObservations {
                reference_known: stream.reference_freedom == FrameFreedom::Known,
                excluded: ExcludedComponents {
                    position: stream.excluded,
                    rotation: stream.is_rotation_excluded,
                },
                ..PoseObservations::new(
                    joints, &chain, columns, &at_rest, &stream.t_s, &stream.poses,
                )
            };
            let mut offsets = vec![0.0; joints.dof];
            for (&column, zero) in columns.iter().zip(&zeros) {
                offsets[column] = *zero;
            }
            let rows = observations.rows(MAX_SAMPLES);
            let linear =
                link_frames(observations.at(stream_state, &offsets), rows, FreeAlongside::Zeros);
            if linear.len() < FOLDS {
                return None;
            }
            let weights = match fitted_share {
                Some(share) => {
                    let mut weights = linear.weights();
                    weights.iter_mut().for_each(|one| one.noise.sigma /= (1.0 - share).sqrt());
                    weights
                }
                None => linear.first_weights(),
            };
            Some(LinearizedStream { linear, weights })
        };
        self.streams.iter().zip(&state.streams).map(of_stream).collect()
    }

    /// Groups of streams that are held out together, if there are several.
    pub fn held_out_groups(&self) -> Option<Vec<usize>> {
        let groups = self.streams.iter().map(|stream| stream.held_out_group);
        let groups: BTreeSet<usize> = groups.collect::<Option<_>>()?;
        (groups.len() > 1).then(|| groups.into_iter().collect())
    }

    /// Samples held out in a fold: streams of `group`, or else every fifth block.
    pub fn held_out_part(
        &self,
        linearized: &[LinearizedStream],
        fold: usize,
        group: Option<usize>,
    ) -> Vec<LinearizedStream> {
        let part = |(stream, it): (&CalibrationStream, &LinearizedStream)| {
            let stretch = it.linear.len().div_ceil(BLOCKS).max(1);
            let is_held_out = |sample: &usize| match group {
                Some(_) => stream.held_out_group == group,
                None => (sample / stretch) % FOLDS == fold,
            };
            let samples: Vec<usize> = (0..it.linear.len()).filter(is_held_out).collect();
            let weights = it.weights.iter().map(|weight| weight.subset(&samples)).collect();
            LinearizedStream { linear: it.linear.subset(&samples), weights }
        };
        self.streams.iter().zip(linearized).map(part).collect()
    }

    /// Equations of all samples and distances.
    pub fn normal(&self, linearized: &[LinearizedStream], state: &CalibrationState) -> Normal {
        let mut normal = self.sample_normal(linearized);
        normal += self.distance_normal(state);
        normal
    }

    /// Point of a stream in the base.
    pub fn point(&self, s: usize, state: &CalibrationState) -> Vec3 {
        state.streams[s].reference.inverse().translation.vector
    }

    fn distance_normal(&self, state: &CalibrationState) -> Normal {
        let mut normal = Normal::zeros(self.parameters.width);
        for distance in self.distances {
            let [a, b] = distance.streams;
            let between = self.point(a, state) - self.point(b, state);
            let Some(direction) = between.try_normalize(0.0) else { continue };
            let weight = distance.std_error_m.powi(-2);
            let residual = distance.distance_m - between.norm();
            let mut along = DVector::zeros(self.parameters.width);
            // The reference maps the point to the origin.
            for (s, sign) in [(a, -1.0), (b, 1.0)] {
                let [reference, ..] = self.parameters.streams[s].clone();
                reference.take(3).enumerate().for_each(|(axis, parameter)| {
                    along[parameter] += sign * direction[axis];
                });
            }
            normal.right += weight * residual * &along;
            normal.matrix += weight * &along * along.transpose();
        }
        normal
    }

    pub fn sample_normal(&self, linearized: &[LinearizedStream]) -> Normal {
        let mut normal = Normal::zeros(self.parameters.width);
        for (s, LinearizedStream { linear, weights }) in linearized.iter().enumerate() {
            let (stream, columns) = (&self.streams[s], &self.columns[s]);
            let mut own = linear.normal(weights).mapped(columns);
            // Distances from a fixed point shrink with the arm. Relative to its size they do not:
            // the derivative of r / (1 + scale).
            if matches!(stream.reference_freedom, FrameFreedom::Position(_)) {
                own.right += own.cost * &self.parameters.scale;
            }
            // Excluded rotations are exact zeros.
            if stream.is_rotation_excluded {
                own.independent = weights[0].noise.independent(linear.len());
            }
            normal += own;
        }
        normal
    }

    /// Covariance of the scores, for the sandwich estimator.
    pub fn scores(
        &self,
        linearized: &[LinearizedStream],
        state: &CalibrationState,
    ) -> DMatrix<f64> {
        let mut all = self.distance_normal(state).matrix;
        for (columns, LinearizedStream { linear, weights }) in self.columns.iter().zip(linearized) {
            let [_, scores] = linear.covariance_parts(weights);
            all += columns.tr_mul(&scores) * columns;
        }
        all
    }

    fn deviation_from_prior(&self, state: &CalibrationState) -> DVector<f64> {
        let mut values = state.values.clone();
        // Flat prior, centred on the current value.
        values.rows_range_mut(self.parameters.links.len()..).fill(0.0);
        values
    }

    /// Precision of the prior and of the posterior.
    fn posterior(
        &self,
        normal: &Normal,
        link_m: f64,
    ) -> Option<(DVector<f64>, Cholesky<f64, Dyn>)> {
        let prior = self.parameters.prior(link_m);
        let precision = &normal.matrix + DMatrix::from_diagonal(&prior);
        Some((prior, precision.cholesky()?))
    }

    /// Step to the maximum of the posterior, and the precision there.
    pub fn step(
        &self,
        normal: &Normal,
        state: &CalibrationState,
        link_m: f64,
    ) -> Option<(DVector<f64>, Cholesky<f64, Dyn>)> {
        let (prior, cholesky) = self.posterior(normal, link_m)?;
        let right = &normal.right - prior.component_mul(&self.deviation_from_prior(state));
        Some((cholesky.solve(&right), cholesky))
    }

    /// The likeliest standard deviation of the link deviations, and the largest that is not much less likely.
    pub fn link_sizes_m(&self, normal: &Normal, state: &CalibrationState) -> [f64; 2] {
        /// Twice the logarithm of a likelihood ratio: 95 % of χ² with one degree of freedom.
        const MAX_LOG_RATIO: f64 = 3.84;
        let total = &normal.right + &normal.matrix * self.deviation_from_prior(state);
        let evidence = |link_m: f64| {
            let Some((prior, cholesky)) = self.posterior(normal, link_m) else {
                return f64::NEG_INFINITY;
            };
            total.dot(&cholesky.solve(&total)) - cholesky.ln_determinant()
                + prior.iter().map(|one| one.ln()).sum::<f64>()
        };
        let (min_m, _, times) = DEVIATION_GRID_M;
        let tried = std::iter::successors(Some(min_m), |link_m| Some(link_m * times));
        let tried: Vec<(f64, f64)> = tried
            .take_while(|link_m| *link_m < MAX_LINK_SIZE_M)
            .map(|link_m| (link_m, evidence(link_m)))
            .collect();
        let best = tried.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
        let (best_m, highest) = best.unwrap_or((min_m, 0.0));
        let likely = tried.iter().filter(|(_, evidence)| highest - evidence <= MAX_LOG_RATIO);
        [best_m, likely.fold(best_m, |largest_m, (link_m, _)| largest_m.max(*link_m))]
    }

    pub fn advance(&self, state: &mut CalibrationState, step: &DVector<f64>) {
        // Neglects a product of frame errors, which the next iteration corrects.
        state.values += step;
        for (s, stream) in state.streams.iter_mut().enumerate() {
            let [reference, tool, latency] = &self.parameters.streams[s];
            let frame = |range: &Range<usize>| {
                let mut twist = [0.0; 6];
                twist.iter_mut().zip(range.clone()).for_each(|(part, at)| *part = step[at]);
                pose_of_twist(&twist)
            };
            stream.reference *= frame(reference);
            if !tool.is_empty() {
                let CalibrationStream { base, tip, .. } = self.streams[s];
                let chain = self.robot.chain(base, tip);
                let tip = chain.map_or_else(|_| Pose::identity(), |chain| chain.last_from_tip());
                stream.tool = tip.inverse() * frame(tool) * tip * stream.tool;
            }
            stream.latency_s += latency.clone().map(|at| step[at]).sum::<f64>();
        }
    }
}
