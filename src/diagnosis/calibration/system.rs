//! Linearised pose streams of a calibration, and steps to the maximum of the posterior.

use super::parameters::CalibrationParameters;
use super::{CalibrationStream, FrameFreedom, PointDistance};
use crate::model::measurement::{ExcludedComponents, PoseObservations, StreamState, pose_of_twist};
use crate::samples::sampling::range_of;
use crate::selection::link_deviations::DEVIATION_GRID_M;
use crate::selection::nominal_model::{FreeAlongside, link_frames};
use crate::solver::linear::{Linear, Normal, Weight};
use ground::geometry::{Pose, Vec3};
use ground::robot::{Chain, LinkPath, Robot};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::collections::BTreeSet;
use std::ops::Range;

/// Per stream; more do not improve the estimate.
const MAX_SAMPLES: usize = 20_000;
/// Per stream, for cross-validation.
const BLOCKS: usize = 50;
pub(super) const FOLDS: usize = 5;

#[derive(Clone)]
pub(super) struct CalibrationState {
    /// Those of streams are relative to their initial values.
    pub values: DVector<f64>,
    /// Latency, reference and tool.
    pub streams: Vec<(f64, Pose, Pose)>,
}

pub(super) struct LinearizedStream {
    pub linear: Linear,
    pub weights: Vec<Weight>,
}

impl LinearizedStream {
    /// Every fifth block, starting at `fold`.
    fn blocks(&self, fold: usize) -> Vec<usize> {
        let stretch = self.linear.len().div_ceil(BLOCKS).max(1);
        (0..self.linear.len()).filter(|at| (at / stretch) % FOLDS == fold).collect()
    }

    fn part(&self, samples: &[usize]) -> Self {
        let weights = self.weights.iter().map(|weight| weight.subset(samples)).collect();
        Self { linear: self.linear.subset(samples), weights }
    }
}

pub(super) struct StreamSource<'a> {
    pub stream: &'a CalibrationStream<'a>,
    stride: usize,
    pub columns: DMatrix<f64>,
    rest_speeds: Vec<f64>,
}

impl<'a> StreamSource<'a> {
    pub fn new(stream: &'a CalibrationStream<'a>, columns: DMatrix<f64>) -> Self {
        let stride = stream.t_s.len().div_ceil(MAX_SAMPLES).max(1);
        Self { stream, stride, columns, rest_speeds: vec![0.0; stream.joints.dof] }
    }

    /// Per joint of the chain while poses are available.
    pub fn spans(&self) -> Vec<f64> {
        let t_s = &self.stream.t_s;
        let (Some(first), Some(last)) = (t_s.first(), t_s.last()) else { return Vec::new() };
        let joints = self.stream.joints;
        let span = |&column: &usize| {
            let rows = (0..joints.len()).filter(|&row| (*first..=*last).contains(&joints.t_s[row]));
            let range = rows.map(|row| joints.row(row)[column]);
            let [low, high] = range_of(range);
            (high - low).max(0.0)
        };
        self.stream.columns.iter().map(span).collect()
    }

    pub(super) fn observations<'b>(&'b self, chain: &'b Chain) -> PoseObservations<'b> {
        let stream = self.stream;
        PoseObservations {
            reference_known: stream.reference_freedom == FrameFreedom::Known,
            excluded: ExcludedComponents {
                position: stream.excluded,
                rotation: stream.is_rotation_excluded,
            },
            ..PoseObservations::new(
                stream.joints, chain, &stream.columns, &self.rest_speeds, &stream.t_s,
                &stream.poses,
            )
        }
    }
}

pub(super) struct CalibrationSystem<'a> {
    pub robot: &'a Robot,
    pub path: &'a LinkPath,
    pub parameters: &'a CalibrationParameters,
    pub sources: &'a [StreamSource<'a>],
    pub distances: &'a [PointDistance],
}

impl CalibrationSystem<'_> {
    /// Robot with link deviations and these zeros.
    fn robot_with(&self, state: &CalibrationState, zeros: &[f64]) -> Robot {
        let deviations = self.parameters.deviations(state.values.as_slice());
        let deviations: Vec<Pose> = deviations.iter().map(|twist| pose_of_twist(twist)).collect();
        self.robot.with_deviations(self.path, &deviations, zeros)
    }

    pub fn robot_at(&self, state: &CalibrationState) -> Robot {
        self.robot_with(state, &self.zeros(state))
    }

    fn zeros(&self, state: &CalibrationState) -> Vec<f64> {
        let mut zeros = vec![0.0; self.path.axes.len()];
        for (at, &joint) in self.parameters.zeros.iter().enumerate() {
            zeros[joint] = state.values[self.parameters.links.len() + at];
        }
        zeros
    }

    /// Chain with the link deviations of `state`.
    pub fn chain(&self, s: usize, state: &CalibrationState) -> Option<Chain> {
        let stream = self.sources[s].stream;
        self.robot_with(state, &[]).chain(stream.base, stream.tip).ok()
    }

    /// Weights are from the residuals there. A fit absorbed `fitted_share` of their variance; `None` before a fit.
    pub fn linearize(
        &self,
        state: &CalibrationState,
        fitted_share: Option<f64>,
    ) -> Option<Vec<LinearizedStream>> {
        let robot = self.robot_with(state, &[]);
        let zeros = self.zeros(state);
        let of_stream = |(s, source): (usize, &StreamSource)| {
            let stream = source.stream;
            let chain = robot.chain(stream.base, stream.tip).ok()?;
            let observations = source.observations(&chain);
            let stream_state = self.stream_state(s, state);
            let mut offsets = vec![0.0; stream.joints.dof];
            for (&column, zero) in stream.columns.iter().zip(&zeros) {
                offsets[column] = *zero;
            }
            let rows = (0..observations.len()).step_by(source.stride);
            let linear =
                link_frames(observations.at(&stream_state, &offsets), rows, FreeAlongside::Zeros);
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
        self.sources.iter().enumerate().map(of_stream).collect()
    }

    fn stream_state(&self, s: usize, state: &CalibrationState) -> StreamState {
        let (latency_s, reference, tool) = state.streams[s];
        let skew = self.sources[s].stream.skew;
        StreamState { reference, tool, skew, ..StreamState::at_latency(latency_s) }
    }

    /// Number of folds of a cross-validation, and whether they are the groups of streams.
    pub fn folds(&self) -> (usize, bool) {
        let groups = self.sources.iter().map(|source| source.stream.held_out_group);
        match groups.collect::<Option<BTreeSet<usize>>>() {
            Some(groups) if groups.len() > 1 => (groups.len(), true),
            _ => (FOLDS, false),
        }
    }

    pub fn fold(&self, linearized: &[LinearizedStream], fold: usize) -> Vec<LinearizedStream> {
        let groups: BTreeSet<Option<usize>> =
            self.sources.iter().map(|source| source.stream.held_out_group).collect();
        let (_, by_group) = self.folds();
        let group = groups.into_iter().nth(fold).flatten();
        let of = |(source, stream): (&StreamSource, &LinearizedStream)| {
            let is_held_out = source.stream.held_out_group == group;
            let samples = match by_group {
                false => stream.blocks(fold),
                true => (0..stream.linear.len()).filter(|_| is_held_out).collect(),
            };
            stream.part(&samples)
        };
        self.sources.iter().zip(linearized).map(of).collect()
    }

    /// Equations of all samples and distances.
    pub fn normal(&self, linearized: &[LinearizedStream], state: &CalibrationState) -> Normal {
        let mut normal = self.sample_normal(linearized);
        let distances = self.distance_normal(state);
        normal.matrix += distances.matrix;
        normal.right += distances.right;
        normal
    }

    /// Point of a stream in the base.
    pub fn point(&self, s: usize, state: &CalibrationState) -> Vec3 {
        state.streams[s].1.inverse().translation.vector
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
                let reference = self.parameters.streams[s].reference.clone();
                reference.take(3).enumerate().for_each(|(axis, parameter)| {
                    along[parameter] += sign * direction[axis];
                });
            }
            normal.right += weight * residual * &along;
            normal.matrix += weight * &along * along.transpose();
            normal.independent += 1.0;
        }
        normal
    }

    pub fn sample_normal(&self, linearized: &[LinearizedStream]) -> Normal {
        let mut normal = Normal::zeros(self.parameters.width);
        for (source, stream) in self.sources.iter().zip(linearized) {
            let own = stream.linear.normal(&stream.weights);
            normal.matrix += source.columns.transpose() * own.matrix * &source.columns;
            normal.right += source.columns.transpose() * own.right;
            normal.cost += own.cost;
            // Distances from a fixed point shrink with the arm. Relative to its size they do not:
            // the derivative of r / (1 + scale).
            if matches!(source.stream.reference_freedom, FrameFreedom::Position(_)) {
                normal.right += own.cost * &self.parameters.scale;
            }
            // Excluded rotations are exact zeros.
            normal.independent += match source.stream.is_rotation_excluded {
                true => stream.weights[0].noise.independent(stream.linear.len()),
                false => own.independent,
            };
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
        for (source, LinearizedStream { linear, weights }) in self.sources.iter().zip(linearized) {
            let [_, scores] = linear.covariance_parts(weights);
            all += source.columns.transpose() * scores * &source.columns;
        }
        all
    }

    fn deviation_from_prior(&self, state: &CalibrationState) -> DVector<f64> {
        let mut values = state.values.clone();
        // Flat prior, centred on the current value.
        values.as_mut_slice()[self.parameters.links.len()..].fill(0.0);
        values
    }

    /// Precision of the prior and of the posterior.
    fn posterior(
        &self,
        normal: &Normal,
        link_m: f64,
    ) -> (DVector<f64>, Option<Cholesky<f64, Dyn>>) {
        let prior = DVector::from_vec(self.parameters.prior(link_m));
        let precision = &normal.matrix + DMatrix::from_diagonal(&prior);
        (prior, precision.cholesky())
    }

    /// Step to the maximum of the posterior, and the precision there.
    pub fn step(
        &self,
        normal: &Normal,
        state: &CalibrationState,
        link_m: f64,
    ) -> Option<(DVector<f64>, Cholesky<f64, Dyn>)> {
        let (prior, cholesky) = self.posterior(normal, link_m);
        let cholesky = cholesky?;
        let right = &normal.right - prior.component_mul(&self.deviation_from_prior(state));
        Some((cholesky.solve(&right), cholesky))
    }

    /// The likeliest standard deviation of the link deviations, and the largest that is not much less likely.
    pub fn link_sizes_m(&self, normal: &Normal, state: &CalibrationState) -> [f64; 2] {
        /// Twice the logarithm of a likelihood ratio: 95 % of χ² with one degree of freedom.
        const MAX_LOG_RATIO: f64 = 3.84;
        let (min_m, max_m, times) = DEVIATION_GRID_M;
        let total = &normal.right + &normal.matrix * self.deviation_from_prior(state);
        let evidence = |link_m: f64| {
            let (prior, cholesky) = self.posterior(normal, link_m);
            let Some(cholesky) = cholesky else { return f64::NEG_INFINITY };
            let log_det: f64 = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
            total.dot(&cholesky.solve(&total)) - log_det
                + prior.iter().map(|one| one.ln()).sum::<f64>()
        };
        let tried = std::iter::successors(Some(min_m), |link_m| Some(link_m * times));
        let tried: Vec<(f64, f64)> = tried
            .take_while(|link_m| *link_m < 4.0 * max_m)
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
        for (s, (latency_s, reference, tool)) in state.streams.iter_mut().enumerate() {
            let own = &self.parameters.streams[s];
            let twist = |range: &Range<usize>| -> [f64; 6] {
                let mut twist = [0.0; 6];
                twist.iter_mut().zip(range.clone()).for_each(|(part, at)| *part = step[at]);
                twist
            };
            if !own.reference.is_empty() {
                *reference *= pose_of_twist(&twist(&own.reference));
            }
            if !own.tool.is_empty() {
                let stream = self.sources[s].stream;
                let chain = self.robot.chain(stream.base, stream.tip);
                let tip = chain.map_or_else(|_| Pose::identity(), |chain| chain.last_from_tip());
                *tool = tip.inverse() * pose_of_twist(&twist(&own.tool)) * tip * *tool;
            }
            if let Some(latency) = own.latency {
                *latency_s += step[latency];
            }
        }
    }
}
