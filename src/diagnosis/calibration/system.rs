//! Linearised pose streams of a calibration, and steps to the maximum of the posterior.

use super::CalibrationStream;
use super::parameters::CalibrationParameters;
use crate::model::measurement::{
    ExcludedComponents, PoseObservations, StreamState, ToolPart, pose_of_twist,
};
use crate::selection::link_deviations::DEVIATION_GRID_M;
use crate::selection::nominal_model::{FreeAlongside, link_frames};
use crate::solver::linear::{Linear, Normal, Weight};
use ground::geometry::{Pose, Vec3};
use ground::robot::{Chain, LinkPath, Robot};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

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
    fn fold(&self, fold: usize) -> Vec<usize> {
        let stretch = self.linear.len().div_ceil(BLOCKS).max(1);
        (0..self.linear.len()).filter(|at| (at / stretch) % FOLDS == fold).collect()
    }

    pub fn part(&self, fold: usize) -> Self {
        let samples = self.fold(fold);
        let weights = self.weights.iter().map(|weight| weight.subset(&samples)).collect();
        Self { linear: self.linear.subset(&samples), weights }
    }

    pub fn after(&self, step: &DVector<f64>) -> Vec<Vec<[f64; 3]>> {
        self.linear.residuals_after(step.as_slice())
    }
}

pub(super) struct StreamSource<'a> {
    pub stream: &'a CalibrationStream<'a>,
    xyz: Vec<Vec3>,
    stride: usize,
    pub columns: DMatrix<f64>,
    rest_speeds: Vec<f64>,
}

impl<'a> StreamSource<'a> {
    pub fn new(stream: &'a CalibrationStream<'a>, columns: DMatrix<f64>) -> Self {
        let stride = stream.t_s.len().div_ceil(MAX_SAMPLES).max(1);
        let xyz = stream.poses.iter().map(|pose| pose.translation.vector).collect();
        Self { stream, xyz, stride, columns, rest_speeds: vec![0.0; stream.joints.dof] }
    }

    /// Per joint of the chain while poses are available.
    pub fn spans(&self) -> Vec<f64> {
        let t_s = &self.stream.t_s;
        let (Some(first), Some(last)) = (t_s.first(), t_s.last()) else { return Vec::new() };
        let joints = self.stream.joints;
        let span = |&column: &usize| {
            let rows = (0..joints.len()).filter(|&row| (*first..=*last).contains(&joints.t_s[row]));
            let range = rows.map(|row| joints.row(row)[column]);
            let (low, high) = range.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| {
                (low.min(q), high.max(q))
            });
            (high - low).max(0.0)
        };
        self.stream.columns.iter().map(span).collect()
    }

    pub(super) fn observations<'b>(&'b self, chain: &'b Chain) -> PoseObservations<'b> {
        let stream = self.stream;
        let ends = stream.t_s.first().zip(stream.t_s.last());
        PoseObservations {
            joints: stream.joints,
            chain,
            columns: &stream.columns,
            gains: &[],
            reference_known: !stream.reference_is_free,
            rest_speeds: &self.rest_speeds,
            t_s: stream.t_s.clone(),
            xyz: self.xyz.clone(),
            rotation: stream.poses.iter().map(|pose| pose.rotation).collect(),
            excluded: ExcludedComponents {
                position: stream.excluded,
                rotation: stream.is_rotation_excluded,
            },
            tool_part: ToolPart::Whole,
            middle_s: ends.map_or(0.0, |(first, last)| 0.5 * (first + last)),
        }
    }
}

pub(super) struct CalibrationSystem<'a> {
    pub robot: &'a Robot,
    pub path: &'a LinkPath,
    pub parameters: &'a CalibrationParameters,
    pub sources: &'a [StreamSource<'a>],
}

impl CalibrationSystem<'_> {
    /// Robot with link deviations, without zeros.
    fn links_at(&self, state: &CalibrationState) -> Robot {
        let deviations = self.parameters.deviations(state.values.as_slice());
        let deviations: Vec<Pose> = deviations.iter().map(|twist| pose_of_twist(twist)).collect();
        self.robot.with_deviations(self.path, &deviations, &[])
    }

    /// Robot with link deviations and zeros.
    pub fn robot_at(&self, state: &CalibrationState) -> Robot {
        let deviations = self.parameters.deviations(state.values.as_slice());
        let deviations: Vec<Pose> = deviations.iter().map(|twist| pose_of_twist(twist)).collect();
        self.robot.with_deviations(self.path, &deviations, &self.zeros(state))
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
        self.links_at(state).chain(stream.base, stream.tip).ok()
    }

    /// Weights are from the residuals there.
    pub fn linearize(
        &self,
        state: &CalibrationState,
        is_solution: bool,
    ) -> Option<Vec<LinearizedStream>> {
        let robot = self.links_at(state);
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
                link_frames(&observations, &stream_state, &offsets, rows, FreeAlongside::Zeros);
            if linear.len() < FOLDS {
                return None;
            }
            let weights = match is_solution {
                true => linear.weights_after(&vec![0.0; linear.width]),
                false => linear.first_weights(),
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

    pub fn normal(&self, linearized: &[LinearizedStream]) -> Normal {
        let mut normal = Normal::zeros(self.parameters.width());
        for (source, stream) in self.sources.iter().zip(linearized) {
            let all: Vec<usize> = (0..stream.linear.width).collect();
            let mut own = Normal::zeros(stream.linear.width);
            stream.linear.accumulate(&stream.weights, &all, &mut own);
            normal.matrix += source.columns.transpose() * own.matrix * &source.columns;
            normal.right += source.columns.transpose() * own.right;
            normal.cost += own.cost;
            normal.independent += own.independent;
        }
        normal
    }

    /// Covariance of the scores, for the sandwich estimator.
    pub fn scores(&self, linearized: &[LinearizedStream]) -> DMatrix<f64> {
        let mut all = DMatrix::zeros(self.parameters.width(), self.parameters.width());
        for (source, LinearizedStream { linear, weights }) in self.sources.iter().zip(linearized) {
            let columns: Vec<Option<usize>> = (0..linear.width).map(Some).collect();
            let mut information = DMatrix::zeros(linear.width, linear.width);
            let mut scores = DMatrix::zeros(linear.width, linear.width);
            linear.accumulate_covariance(weights, &columns, &mut information, &mut scores);
            all += source.columns.transpose() * scores * &source.columns;
        }
        all
    }

    fn deviation_from_prior(&self, state: &CalibrationState) -> DVector<f64> {
        let mut values = state.values.clone();
        // Flat prior, centred on the current value.
        values
            .rows_mut(self.parameters.links.len(), values.len() - self.parameters.links.len())
            .fill(0.0);
        values
    }

    /// Step to the maximum of the posterior, and the precision there.
    pub fn step(
        &self,
        normal: &Normal,
        state: &CalibrationState,
        link_m: f64,
    ) -> Option<(DVector<f64>, Cholesky<f64, Dyn>)> {
        let prior = DVector::from_vec(self.parameters.prior(link_m));
        let precision = &normal.matrix + DMatrix::from_diagonal(&prior);
        let cholesky = precision.cholesky()?;
        let right = &normal.right - prior.component_mul(&self.deviation_from_prior(state));
        Some((cholesky.solve(&right), cholesky))
    }

    pub fn best_link_m(&self, normal: &Normal, state: &CalibrationState) -> f64 {
        let (min_m, max_m, times) = DEVIATION_GRID_M;
        let total = &normal.right + &normal.matrix * self.deviation_from_prior(state);
        let evidence = |link_m: f64| {
            let prior = DVector::from_vec(self.parameters.prior(link_m));
            let precision = &normal.matrix + DMatrix::from_diagonal(&prior);
            let Some(cholesky) = precision.cholesky() else { return f64::NEG_INFINITY };
            let log_det: f64 = cholesky.l_dirty().diagonal().iter().map(|x| 2.0 * x.ln()).sum();
            total.dot(&cholesky.solve(&total)) - log_det
                + prior.iter().map(|one| one.ln()).sum::<f64>()
        };
        let tried = std::iter::successors(Some(min_m), |link_m| Some(link_m * times));
        let tried = tried
            .take_while(|link_m| *link_m < 4.0 * max_m)
            .map(|link_m| (link_m, evidence(link_m)));
        tried.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(min_m, |best| best.0)
    }

    pub fn advance(&self, state: &mut CalibrationState, step: &DVector<f64>) {
        // Neglects a product of frame errors, which the next iteration corrects.
        state.values += step;
        for (s, (latency_s, reference, tool)) in state.streams.iter_mut().enumerate() {
            let own = self.parameters.free_parameters_of(s);
            let mut part = step
                .rows(self.parameters.stream_range(s).start, self.parameters.stream_range(s).len())
                .into_iter()
                .copied();
            let mut twist = || -> Vec<f64> { part.by_ref().take(6).collect() };
            if own.reference {
                *reference *= pose_of_twist(&twist());
            }
            if own.tool {
                let tip = self.last_from_tip(s);
                *tool = tip.inverse() * pose_of_twist(&twist()) * tip * *tool;
            }
            if own.latency {
                *latency_s += part.next().unwrap_or(0.0);
            }
        }
    }

    fn last_from_tip(&self, s: usize) -> Pose {
        let stream = self.sources[s].stream;
        let Ok(chain) = self.robot.chain(stream.base, stream.tip) else { return Pose::identity() };
        let (q, mut frames) = (vec![0.0; chain.dof()], Vec::new());
        chain.joint_frames(&q, &mut frames);
        frames.last().map_or_else(Pose::identity, |last| last.inv_mul(&chain.forward(&q)))
    }
}
