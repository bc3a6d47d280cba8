//! Effect of link deviations on the tip over the workspace.

use super::FkUncertainty;
use super::system::{CalibrationState, CalibrationSystem};
use crate::model::measurement::{PoseObservations, StreamState};
use crate::selection::nominal_model::{FreeAlongside, link_frames};
use crate::solver::linear::Linear;
use ground::geometry::Pose;
use ground::robot::{Chain, JointKind, Limits};
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};

const CONFIGURATIONS: usize = 300;
const RANDOM_SEED: u64 = 24;

/// Sensitivity of the tip's pose to parameters.
pub(crate) struct TipSensitivity {
    /// Six rows per configuration: position in m, rotation in rad.
    effects: DMatrix<f64>,
}

impl TipSensitivity {
    /// To the first `parameters` of [`tip_derivatives`].
    pub fn from_derivatives(linear: &Linear, parameters: usize) -> Self {
        let derivative = |row: usize, column: usize| linear.row(row / 6, row % 6)[column];
        Self { effects: DMatrix::from_fn(6 * linear.len(), parameters, derivative) }
    }

    /// To the shared parameters within the joint limits, after projecting out free constant frames.
    pub(super) fn new(system: &CalibrationSystem, state: &CalibrationState) -> Self {
        let parameters = &system.parameters;
        let shared = parameters.shared();
        let robot = system.robot_with(state, &[]);
        let Ok(chain) = robot.chain(system.streams[0].base, system.streams[0].tip) else {
            return Self { effects: DMatrix::zeros(0, shared) };
        };
        let joints = random_configurations(&chain, CONFIGURATIONS, RANDOM_SEED);
        let linear = tip_derivatives(&chain, &joints);
        let design = Self::from_derivatives(&linear, linear.width).effects;
        let mut effects = &design * parameters.shared_columns(0, [false; 2]);
        let is_free = |link: &usize| parameters.links.iter().all(|one| one.link != *link);
        let free = [0, system.path.axes.len()].into_iter().filter(is_free);
        let free: Vec<usize> = free.flat_map(|link| 6 * link..6 * link + 6).collect();
        if !free.is_empty() {
            let frames = design.select_columns(&free);
            if let Some(cholesky) = frames.tr_mul(&frames).cholesky() {
                effects -= &frames * cholesky.solve(&frames.tr_mul(&effects));
            }
        }
        Self { effects }
    }

    /// Uncertainty for a covariance of the shared parameters.
    pub fn uncertainty(&self, covariance: &DMatrix<f64>) -> FkUncertainty {
        let variances = (&self.effects * covariance).component_mul(&self.effects).column_sum();
        let rms = |first: usize| {
            let own = variances.as_slice().chunks(6).flat_map(|of_pose| &of_pose[first..first + 3]);
            let postures = (variances.len() / 6).max(1) as f64;
            (own.map(|variance| variance.max(0.0)).sum::<f64>() / postures).sqrt()
        };
        FkUncertainty { m: rms(0), rad: rms(3) }
    }

    /// Tip displacement by a change, rms m.
    pub fn effect_m(&self, change: &DVector<f64>) -> f64 {
        self.uncertainty(&(change * change.transpose())).m
    }
}

/// Derivatives of the tip's pose by the frame of each link, latency and zeros, at the rows of `motion`.
pub(crate) fn tip_derivatives(chain: &Chain, motion: &JointTrack) -> Linear {
    let columns: Vec<usize> = (0..chain.dof()).collect();
    let still = vec![0.0; chain.dof()];
    // Observed poses affect only the residuals.
    let poses = vec![Pose::identity(); motion.len()];
    let observations = PoseObservations::new(motion, chain, &columns, &still, &motion.t_s, &poses);
    let state = StreamState::at_latency(0.0);
    link_frames(observations.at(&state, &still), 0..motion.len(), FreeAlongside::Zeros)
}

/// Configurations at rest, over the joint ranges.
pub(crate) fn random_configurations(chain: &Chain, count: usize, seed: u64) -> JointTrack {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let range = |(limits, kind): (&Limits, &JointKind)| {
        let usual = if *kind == JointKind::Prismatic { 0.5 } else { std::f64::consts::PI };
        let low = limits.lower.unwrap_or(-usual).max(-usual);
        let high = limits.upper.unwrap_or(usual).min(usual);
        match low < high {
            true => (low, high),
            false => (limits.lower.unwrap_or(0.0), limits.upper.unwrap_or(0.0)),
        }
    };
    let ranges: Vec<(f64, f64)> =
        chain.limits().iter().zip(chain.joint_kinds()).map(range).collect();
    let rows = (0..count).flat_map(|_| &ranges);
    let q: Vec<f64> = rows.map(|(low, high)| low + (high - low) * rng.random::<f64>()).collect();
    let t_s = (0..count).map(|at| at as f64).collect();
    JointTrack { t_s, dof: ranges.len(), qd: vec![0.0; q.len()], q, noise: Vec::new() }
}
