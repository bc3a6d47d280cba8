//! Gauss–Newton from the nominal model to the maximum of the posterior.

use super::parameters::CalibrationParameters;
use super::system::{CalibrationState, CalibrationSystem, FOLDS, LinearizedStream};
use super::undetermined::undetermined_directions;
use super::workspace::TipSensitivity;
use super::{
    ArmCalibration, CalibrationFailure, CalibrationResidual, CalibrationStream, FrameFreedom,
    PointDistance, StreamCalibration,
};
use crate::Measured;
use crate::model::measurement::StreamState;
use crate::samples::sampling::value_range;
use crate::selection::deviation_model::DEVIATION_GRID_M;
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
    let path_of = |stream: &CalibrationStream| robot.link_path(stream.base, stream.tip);
    let paths: Vec<LinkPath> =
        streams.iter().map(path_of).collect::<Option<_>>().ok_or(CalibrationFailure::Chain)?;
    let ends = paths.first().zip(streams.first());
    let (path, first) = ends.ok_or(CalibrationFailure::TooFewSamples)?;
    if paths.iter().any(|other| other.links != path.links) {
        return Err(CalibrationFailure::OtherJoints);
    }
    let chain = robot.chain(first.base, first.tip).map_err(|_| CalibrationFailure::Chain)?;
    let parameters = CalibrationParameters::new(path, &chain, streams, &paths, zeros.to_vec());
    let columns = (0..streams.len()).map(|s| parameters.columns_of(s)).collect();
    let system = CalibrationSystem { robot, path, parameters, streams, columns, distances };
    let parameters = &system.parameters;
    let initial =
        |&CalibrationStream { latency_s, skew, reference, tool, .. }: &CalibrationStream| {
            StreamState { skew, reference, tool, ..StreamState::at_latency(latency_s) }
        };
    let mut state = CalibrationState {
        values: DVector::zeros(parameters.width),
        streams: streams.iter().map(initial).collect(),
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
        let moved = cholesky.l().tr_mul(&step).norm() / (parameters.width as f64).sqrt();
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
    let inverse = cholesky.inverse();
    // A fit absorbs noise: residuals shrink by the share of fitted degrees of freedom, scores by its square
    // (MacKinnon and White 1985, HC3, on average).
    let fitted = (&inverse * &normal.matrix).trace();
    let scores =
        system.scores(&linearized, &state) / (1.0 - fitted_share(&inverse, &normal)).powi(2);
    let prior = DMatrix::from_diagonal(&parameters.prior(link_m));
    let covariance = &inverse * (scores + prior) * &inverse;
    // Fits all parameters to the other folds.
    let held_out = system.cross_validated(&linearized, &state, |training| {
        let step = system.step(training, &state, link_m);
        step.map_or_else(|| DVector::zeros(parameters.width), |(step, _)| step)
    });
    let dof = (normal.independent - fitted).max(3.0);
    let workspace = TipSensitivity::new(&system, &state);
    let shared = parameters.shared();
    let reports = streams.iter().enumerate().map(|(s, stream)| {
        let [reference, tool, latency] = &parameters.streams[s];
        let LinearizedStream { linear, weights } = &linearized[s];
        let StreamState { latency_s: value, .. } = state.streams[s];
        let std_error = |at: usize| covariance[(at, at)].max(0.0).sqrt();
        StreamCalibration {
            samples: linear.len(),
            latency_s: latency.clone().next().map(|at| Measured {
                value,
                std_error: std_error(at),
                dof,
            }),
            reference: (!reference.is_empty()).then_some(state.streams[s].reference),
            tool: (!tool.is_empty()).then_some(state.streams[s].tool),
            before: before[s].0,
            after: rms_residual(std::slice::from_ref(&linear.residual)),
            held_out_before: before[s].1,
            held_out_after: held_out[s],
            noise: [0, 1].map(|kind| weights[kind].noise.sigma),
            inflation: [0, 1].map(|kind| weights[kind].noise.inflation()),
            spans: spans(stream),
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
        undetermined: undetermined_directions(&inverse, parameters, link_m, &workspace),
        calibrated_uncertainty: workspace.uncertainty(&shared_covariance),
        nominal_uncertainty: workspace.uncertainty(&parameters.nominal_covariance(link_m)),
        robot: system.robot_with(&state, &system.zeros(&state)),
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
        let of_all = self.residuals_after(linearized, &all_free).map(|all| rms_residual(&[all]));
        of_all.zip(self.cross_validated(linearized, state, fitted)).collect()
    }

    /// Residuals of each stream after a step, by kind.
    fn residuals_after(
        &self,
        linearized: &[LinearizedStream],
        step: &DVector<f64>,
    ) -> impl Iterator<Item = Vec<Vec<Vec3>>> {
        let own = self.columns.iter().map(move |columns| columns * step);
        linearized.iter().zip(own).map(|(it, own)| it.linear.residuals_after(own.as_slice()))
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
        let groups = self.held_out_groups();
        let mut all: Vec<Vec<_>> = linearized.iter().map(|_| Vec::new()).collect();
        for fold in 0..groups.as_ref().map_or(FOLDS, Vec::len) {
            let group = groups.as_ref().map(|groups| groups[fold]);
            let part = self.held_out_part(linearized, fold, group);
            let mut held_out = self.sample_normal(&part);
            let mut training = Normal::zeros(self.parameters.width);
            training.matrix = &all_data.matrix - &held_out.matrix;
            training.right = &all_data.right - &held_out.right;
            let mut step = step(&training);
            if group.is_some() {
                let unseen = self.own_parameters_of_group(group);
                unseen.iter().for_each(|&parameter| step[parameter] = 0.0);
                held_out.right -= &held_out.matrix * &step;
                step += held_out.step_from_zero(&unseen);
            }
            all.iter_mut()
                .zip(self.residuals_after(&part, &step))
                .for_each(|(all, it)| all.push(it));
        }
        all.iter().map(|folds| rms_residual(folds)).collect()
    }

    fn own_parameters(&self) -> Vec<usize> {
        (self.parameters.shared()..self.parameters.width).collect()
    }

    /// Own parameters that no stream outside the group has.
    fn own_parameters_of_group(&self, group: Option<usize>) -> Vec<usize> {
        let others = self.streams.iter().zip(&self.parameters.streams);
        let others = others.filter(|(stream, _)| stream.held_out_group != group);
        let elsewhere: Vec<_> = others.flat_map(|(_, own)| own).collect();
        let mut parameters = self.own_parameters();
        parameters.retain(|parameter| !elsewhere.iter().any(|own| own.contains(parameter)));
        parameters
    }

    /// Fits free positions with nominal links, whose initial values are only guesses.
    fn start(&self, state: &mut CalibrationState) -> Option<Vec<LinearizedStream>> {
        let freedoms = self.streams.iter().flat_map(|it| [it.reference_freedom, it.tool_freedom]);
        let mut positions = freedoms.filter(|frame| matches!(frame, FrameFreedom::Position(_)));
        let rounds = if positions.next().is_some() { START_ROUNDS } else { 0 };
        let mut linearized = self.linearize(state, None)?;
        for _ in 0..rounds {
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

/// Range per joint of the chain while poses are available.
fn spans(stream: &CalibrationStream) -> Vec<f64> {
    let CalibrationStream { joints, t_s, .. } = stream;
    let (Some(first_s), Some(last_s)) = (t_s.first(), t_s.last()) else { return Vec::new() };
    let is_covered = |&row: &usize| (*first_s..=*last_s).contains(&joints.t_s[row]);
    let rows = || (0..joints.len()).filter(is_covered);
    let span = |&column: &usize| value_range(rows().map(|row| joints.row(row)[column])).max(0.0);
    stream.columns.iter().map(span).collect()
}
