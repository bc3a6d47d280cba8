//! Observability of a fault in a motion: its Fisher information after marginalising unknown frames, link
//! deviations, and every other single cause.

use nalgebra::{DMatrix, DVector};
use poseaudit::geometry::Vec3;
use poseaudit::robot::Chain;
use poseaudit::synth::Scenario;

use crate::cases::Case;
use crate::fault_kinds::{DEGREE, FaultKind, PlantedFault, TrueValue, chain};
use crate::scenes::Scene;

/// Number of pose samples that represent the stream.
const SAMPLES: usize = 120;
/// Share of independent samples, given correlated noise.
const INDEPENDENT_SHARE: f64 = 0.2;
/// Standard deviation of the link deviations of an uncalibrated arm, m and rad.
const LINK_SIGMAS: (f64, f64) = (3e-4, 0.05 * DEGREE);
/// Prior standard deviations of a marker's distance from the tip, m, and of its rotation, rad.
const MARKER_SIGMAS: (f64, f64) = (0.5, 3.0);
/// Prior standard deviations of a tracker's position, m, and rotation, rad.
const WORLD_SIGMAS: (f64, f64) = (10.0, 3.0);
/// Prior standard deviation of another cause: zero offset, rad, and latency, s.
const ZERO_OFFSET_SIGMA_RAD: f64 = 3.0;
const LATENCY_SIGMA_S: f64 = 1.0;
/// Minimum χ² (five standard deviations) of a fault that must be found.
const MIN_CHI_SQUARED: f64 = 25.0;

/// Whether the poses show a planted fault and distinguish it from every other single cause. False for kinds
/// without a model here.
pub fn is_observable(case: &Case, planted: &PlantedFault) -> bool {
    let run = &case.scenario;
    let TrueValue::Amount(amount) = planted.truth else { return false };
    // With several faults, each would have to be distinguished from all combinations of the others.
    if case.planted.len() > 1 {
        return false;
    }
    let Some(columns) = Derivatives::new(run) else { return false };
    let dof = columns.zeros.len();
    let joint = |name: &Option<String>| {
        chain(run).joint_names().iter().position(|joint| Some(joint) == name.as_ref())
    };
    let signature = match (planted.kind, joint(&planted.subject)) {
        (FaultKind::PoseLate, _) => &columns.latency * amount,
        (FaultKind::Zero, Some(joint)) => &columns.zeros[joint] * amount,
        _ => return false,
    };
    let is_planted = |other: Option<usize>| match planted.kind {
        FaultKind::Zero => other.is_some() && other == joint(&planted.subject),
        _ => other.is_none(),
    };
    let mut nuisances = columns.links.clone();
    if !case.names_tip {
        nuisances.extend(scale_by_priors(&columns.tool, MARKER_SIGMAS));
    }
    if matches!(case.scene, Scene::TrackerWorld | Scene::Marker) {
        nuisances.extend(scale_by_priors(&columns.base, WORLD_SIGMAS));
    }
    let others = (0..dof).map(Some).chain([None]).filter(|other| !is_planted(*other));
    let others = others.map(|other| match other {
        Some(joint) => vec![&columns.zeros[joint] * ZERO_OFFSET_SIGMA_RAD],
        None => vec![&columns.latency * LATENCY_SIGMA_S],
    });
    let frames = [
        scale_by_priors(&columns.tool, MARKER_SIGMAS),
        scale_by_priors(&columns.base, WORLD_SIGMAS),
    ];
    let residuals = others.chain(frames).map(|other| {
        let all: Vec<_> = nuisances.iter().cloned().chain(other).collect();
        residual_chi_squared(&signature, &all)
    });
    residuals.fold(residual_chi_squared(&signature, &nuisances), f64::min) > MIN_CHI_SQUARED
}

fn scale_by_priors(frame: &[DVector<f64>], (length_m, angle_rad): (f64, f64)) -> Vec<DVector<f64>> {
    let sigma = |at: usize| if at < 3 { length_m } else { angle_rad };
    frame.iter().enumerate().map(|(at, column)| column * sigma(at)).collect()
}

/// Residual χ² of a signature after projecting out columns with unit priors.
fn residual_chi_squared(signature: &DVector<f64>, columns: &[DVector<f64>]) -> f64 {
    let a = DMatrix::from_columns(columns);
    let normal = a.tr_mul(&a) + DMatrix::identity(columns.len(), columns.len());
    let b = a.tr_mul(signature);
    let explained = normal.cholesky().map_or(0.0, |normal| b.dot(&normal.solve(&b)));
    signature.norm_squared() - explained
}

/// Derivatives of the pose stream in units of its noise, six rows per sample.
struct Derivatives {
    zeros: Vec<DVector<f64>>,
    latency: DVector<f64>,
    base: Vec<DVector<f64>>,
    tool: Vec<DVector<f64>>,
    /// Three translations and three rotations of each link, one standard deviation each.
    links: Vec<DVector<f64>>,
}

impl Derivatives {
    fn new(run: &Scenario) -> Option<Self> {
        let chain: Chain = chain(run);
        let dof = chain.dof();
        let step_s = run.duration_s / SAMPLES as f64;
        let times_s: Vec<f64> = (0..SAMPLES).map(|at| (at as f64 + 0.5) * step_s).collect();
        let rows = run.joints_at(&times_s).ok()?;
        let quantum = run.joints.resolution * 0.3 + run.noise.joints;
        let sigma_m = run.noise.pose_m.max(1e-6).hypot(quantum);
        let sigma_rad = run.noise.pose_rad.max(1e-6).hypot(quantum);
        let correlation = run.noise.correlation;
        let independent = INDEPENDENT_SHARE * (1.0 - correlation) / (1.0 + correlation);
        let count = run.duration_s * run.pose.timing.rate_hz * independent;
        let weight = (count / SAMPLES as f64).sqrt();
        let zero = || DVector::zeros(6 * SAMPLES);
        let mut columns = Self {
            zeros: vec![zero(); dof],
            latency: zero(),
            base: vec![zero(); 6],
            tool: vec![zero(); 6],
            links: vec![zero(); 6 * dof],
        };
        let mut jacobian = vec![[0.0; 6]; dof];
        let mut frames = Vec::new();
        for (at, (q, velocity)) in rows.iter().enumerate() {
            let base_from_tip = chain.forward_with_jacobian(q, &mut jacobian);
            let stream = (base_from_tip * run.pose.tip_from_stream).translation.vector;
            let tip = base_from_tip.translation.vector;
            let add = |column: &mut DVector<f64>, shift: Vec3, turn: Vec3, times: f64| {
                for axis in 0..3 {
                    column[6 * at + axis] += weight * times * shift[axis] / sigma_m;
                    column[6 * at + 3 + axis] += weight * times * turn[axis] / sigma_rad;
                }
            };
            for (joint, column) in jacobian.iter().enumerate() {
                let turn = Vec3::new(column[3], column[4], column[5]);
                let shift =
                    Vec3::new(column[0], column[1], column[2]) + turn.cross(&(stream - tip));
                add(&mut columns.zeros[joint], shift, turn, 1.0);
                add(&mut columns.latency, shift, turn, -velocity[joint]);
            }
            let frame =
                |into: &mut [DVector<f64>], origin: Vec3, axes: [Vec3; 3], sigma: (f64, f64)| {
                    for (axis, direction) in axes.into_iter().enumerate() {
                        add(&mut into[axis], direction, Vec3::zeros(), sigma.0);
                        add(
                            &mut into[3 + axis],
                            direction.cross(&(stream - origin)),
                            direction,
                            sigma.1,
                        );
                    }
                };
            let unit = [Vec3::x(), Vec3::y(), Vec3::z()];
            frame(&mut columns.base, Vec3::zeros(), unit, (1.0, 1.0));
            frame(
                &mut columns.tool,
                tip,
                unit.map(|axis| base_from_tip.rotation * axis),
                (1.0, 1.0),
            );
            chain.joint_frames(q, &mut frames);
            for (link, into) in frames.iter().zip(columns.links.chunks_exact_mut(6)) {
                let axes = unit.map(|axis| link.rotation * axis);
                frame(into, link.translation.vector, axes, LINK_SIGMAS);
            }
        }
        Some(columns)
    }
}
