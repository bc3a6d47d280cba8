//! Gauss–Newton from the nominal model to the maximum of the posterior.

use super::parameters::CalibrationParameters;
use super::system::{CalibrationState, CalibrationSystem, LinearizedStream, StreamSource};
use super::undetermined::undetermined_directions;
use super::workspace::TipSensitivity;
use super::{
    ArmCalibration, CalibrationFailure, CalibrationResidual, CalibrationStream, FrameFreedom,
    PointDistance, StreamCalibration,
};
use crate::Measured;
use crate::selection::link_deviations::DEVIATION_GRID_M;
use crate::solver::linear::Normal;
use ground::geometry::Vec3;
use ground::robot::{LinkPath, Robot};
use ground::stats::mean;
use nalgebra::{DMatrix, DVector};

const MAX_ITERATIONS: usize = 12;
const CONVERGED_SIGMAS: f64 = 1e-3;
/// Steps of the nominal fit of free positions.
const START_ROUNDS: usize = 3;

/// Calibrates `robot`. The chain's joints `zeros` have free zeros; `distances` are known.
///
/// # Errors
/// If the chain or the samples do not permit a calibration.
pub fn calibrate_arm(
    robot: &Robot,
    streams: &[CalibrationStream],
    zeros: &[usize],
    distances: &[PointDistance],
) -> Result<ArmCalibration, CalibrationFailure> {
    let paths: Option<Vec<LinkPath>> =
        streams.iter().map(|stream| robot.link_path(stream.base, stream.tip)).collect();
    let paths = paths.ok_or(CalibrationFailure::Chain)?;
    let ends = paths.first().zip(streams.first());
    let (path, first) = ends.ok_or(CalibrationFailure::TooFewSamples)?;
    if paths.iter().any(|other| other.links != path.links) {
        return Err(CalibrationFailure::OtherJoints);
    }
    let chain = robot.chain(first.base, first.tip).map_err(|_| CalibrationFailure::Chain)?;
    let parameters = CalibrationParameters::new(path, &chain, streams, &paths, zeros.to_vec());
    let sources: Vec<StreamSource> = streams
        .iter()
        .enumerate()
        .map(|(s, stream)| StreamSource::new(stream, parameters.columns_of(s)))
        .collect();
    let (parameters, sources) = (&parameters, sources.as_slice());
    let system = CalibrationSystem { robot, path, parameters, sources, distances };
    let mut state = CalibrationState {
        values: DVector::zeros(parameters.width),
        streams: streams.iter().map(|one| (one.latency_s, one.reference, one.tool)).collect(),
    };
    let mut linearized = system.start(&mut state).ok_or(CalibrationFailure::TooFewSamples)?;
    let before = system.nominal_residuals(&linearized, &state);
    let distances_before = system.distances_m(&state);
    let ([mut link_m, mut max_link_m], mut unsettled) = ([DEVIATION_GRID_M.0; 2], None);
    for round in 0..MAX_ITERATIONS {
        let normal = system.normal(&linearized, &state);
        [link_m, max_link_m] = system.link_sizes_m(&normal, &state);
        let (step, cholesky) =
            system.step(&normal, &state, link_m).ok_or(CalibrationFailure::Diverges)?;
        let moved = (step.dot(&(cholesky.l() * cholesky.l().transpose() * &step))
            / parameters.width as f64)
            .sqrt();
        if !step.iter().all(|value| value.is_finite()) {
            return Err(CalibrationFailure::Diverges);
        }
        system.advance(&mut state, &step);
        let share = fitted_share(&cholesky.inverse(), &normal);
        linearized = system.linearize(&state, Some(share)).ok_or(CalibrationFailure::Diverges)?;
        unsettled = (moved >= CONVERGED_SIGMAS).then_some(moved);
        if unsettled.is_none() && round > 1 {
            break;
        }
    }
    let normal = system.normal(&linearized, &state);
    let (_, cholesky) = system.step(&normal, &state, link_m).ok_or(CalibrationFailure::Diverges)?;
    let prior = parameters.prior(link_m);
    let inverse = cholesky.inverse();
    // A fit absorbs noise: residuals shrink by the share of fitted degrees of freedom, scores by its square
    // (MacKinnon and White 1985, HC3, on average).
    let fitted = (&inverse * &normal.matrix).trace();
    let fitted_share = fitted_share(&inverse, &normal);
    let scores = system.scores(&linearized, &state) / (1.0 - fitted_share).powi(2);
    let before_log = DMatrix::from_diagonal(&DVector::from_vec(prior));
    let covariance = &inverse * (scores + before_log) * &inverse;
    let held_out = system.held_out(&linearized, &state, link_m);
    let dof = (normal.independent - fitted).max(3.0);
    let calibrated = system.robot_at(&state);
    let workspace = TipSensitivity::new(&system, &state);
    let shared = parameters.shared();
    let reports = (0..sources.len()).map(|s| {
        let own = &parameters.streams[s];
        let LinearizedStream { linear, weights } = &linearized[s];
        let (latency_s, reference, tool) = state.streams[s];
        let std_error = |at: usize| covariance[(at, at)].max(0.0).sqrt();
        StreamCalibration {
            samples: linear.len(),
            latency_s: own.latency.map(|at| Measured {
                value: latency_s,
                std_error: std_error(at),
                dof,
            }),
            reference: (!own.reference.is_empty()).then_some(reference),
            tool: (!own.tool.is_empty()).then_some(tool),
            before: before[s].0,
            after: rms_residual(std::slice::from_ref(&linear.residual)),
            held_out_before: before[s].1,
            held_out_after: held_out[s],
            noise: [0, 1].map(|kind| weights[kind].noise.sigma),
            inflation: [0, 1].map(|kind| weights[kind].noise.inflation()),
            spans: sources[s].spans(),
            errors_m: linear.residual[0].iter().map(Vec3::norm).collect(),
        }
    });
    let reports = reports.collect();
    let shared_covariance = covariance.view((0, 0), (shared, shared)).into_owned();
    Ok(ArmCalibration {
        links: path.links.clone(),
        deviations: parameters.deviations(state.values.as_slice()),
        link_m,
        max_link_m,
        remaining_step: unsettled,
        undetermined: undetermined_directions(&normal.matrix, parameters, link_m, &workspace),
        calibrated_uncertainty: workspace.uncertainty(&shared_covariance),
        nominal_uncertainty: workspace.uncertainty(&parameters.nominal_covariance(link_m)),
        robot: calibrated,
        parameters: parameters.links.clone(),
        zeros: parameters.zeros.clone(),
        values: state.values.iter().take(shared).copied().collect(),
        covariance: shared_covariance,
        dof,
        streams: reports,
        distances_m: std::iter::zip(distances_before, system.distances_m(&state))
            .map(|(before, after)| [before, after])
            .collect(),
    })
}

/// Degrees of freedom of the fit per independent residual.
fn fitted_share(covariance: &DMatrix<f64>, normal: &Normal) -> f64 {
    ((covariance * &normal.matrix).trace() / normal.independent.max(1.0)).clamp(0.0, 0.9)
}

/// Residual by kind over pieces of a stream.
fn rms_residual(linearized: &[Vec<Vec<Vec3>>]) -> CalibrationResidual {
    let rms = |kind: usize| {
        let all = linearized.iter().flat_map(|stream| &stream[kind]);
        mean(all.map(Vec3::norm_squared)).sqrt()
    };
    CalibrationResidual { m: rms(0), rad: rms(1) }
}

impl CalibrationSystem<'_> {
    /// Residuals of all samples and cross-validated, after fitting frames and latencies.
    fn nominal_residuals(
        &self,
        linearized: &[LinearizedStream],
        state: &CalibrationState,
    ) -> Vec<(CalibrationResidual, CalibrationResidual)> {
        let own = self.own_parameters();
        let fitted = |normal: &Normal| normal.step_from_zero(&own);
        let all_free = fitted(&self.sample_normal(linearized));
        let folds = self.cross_validated(linearized, state, fitted);
        let residual = |(source, stream): (&StreamSource, &LinearizedStream)| {
            rms_residual(&[stream.linear.residuals_after((&source.columns * &all_free).as_slice())])
        };
        self.sources.iter().zip(linearized).map(residual).zip(folds).collect()
    }

    /// Fits all parameters to the other folds.
    fn held_out(
        &self,
        linearized: &[LinearizedStream],
        state: &CalibrationState,
        link_m: f64,
    ) -> Vec<CalibrationResidual> {
        let of = |training: &Normal| match self.step(training, state, link_m) {
            Some((step, _)) => step,
            None => DVector::zeros(self.parameters.width),
        };
        self.cross_validated(linearized, state, of)
    }

    /// Each fold is predicted by a step from the others' equations. Frames that only a held-out group has are
    /// fitted to it.
    fn cross_validated(
        &self,
        linearized: &[LinearizedStream],
        state: &CalibrationState,
        step: impl Fn(&Normal) -> DVector<f64>,
    ) -> Vec<CalibrationResidual> {
        let all_data = self.normal(linearized, state);
        let (folds, by_group) = self.folds();
        let mut all: Vec<Vec<_>> = linearized.iter().map(|_| Vec::new()).collect();
        for fold in 0..folds {
            let held_out_parts = self.fold(linearized, fold);
            let mut held_out = self.sample_normal(&held_out_parts);
            let mut training = Normal::zeros(self.parameters.width);
            training.matrix = &all_data.matrix - &held_out.matrix;
            training.right = &all_data.right - &held_out.right;
            let mut step = step(&training);
            if by_group {
                let unseen = self.parameters_only_in(&held_out_parts, linearized);
                unseen.iter().for_each(|&parameter| step[parameter] = 0.0);
                held_out.right -= &held_out.matrix * &step;
                step += held_out.step_from_zero(&unseen);
            }
            for ((all, part), source) in all.iter_mut().zip(&held_out_parts).zip(self.sources) {
                all.push(part.linear.residuals_after((&source.columns * &step).as_slice()));
            }
        }
        all.iter().map(|folds| rms_residual(folds)).collect()
    }

    fn own_parameters(&self) -> Vec<usize> {
        (self.parameters.shared()..self.parameters.width).collect()
    }

    /// Streams' own parameters that no sample outside `part` depends on.
    fn parameters_only_in(
        &self,
        part: &[LinearizedStream],
        all: &[LinearizedStream],
    ) -> Vec<usize> {
        let is_elsewhere = |parameter: usize| {
            part.iter().zip(all).enumerate().any(|(s, (part, all))| {
                let own = &self.parameters.streams[s];
                part.linear.len() < all.linear.len()
                    && (own.reference.contains(&parameter)
                        || own.tool.contains(&parameter)
                        || own.latency == Some(parameter))
            })
        };
        self.own_parameters().into_iter().filter(|&parameter| !is_elsewhere(parameter)).collect()
    }

    /// Fits free positions with nominal links, whose initial values are only guesses.
    fn start(&self, state: &mut CalibrationState) -> Option<Vec<LinearizedStream>> {
        let is_position = |frame| matches!(frame, FrameFreedom::Position(_));
        let has_positions = self.sources.iter().any(|source| {
            is_position(source.stream.reference_freedom) || is_position(source.stream.tool_freedom)
        });
        let mut linearized = self.linearize(state, None)?;
        for _ in (0..START_ROUNDS).filter(|_| has_positions) {
            let step = self.sample_normal(&linearized).step_from_zero(&self.own_parameters());
            self.advance(state, &step);
            linearized = self.linearize(state, Some(0.0))?;
        }
        Some(linearized)
    }

    fn distances_m(&self, state: &CalibrationState) -> Vec<f64> {
        let between = |[a, b]: [usize; 2]| (self.point(a, state) - self.point(b, state)).norm();
        self.distances.iter().map(|distance| between(distance.streams)).collect()
    }
}
