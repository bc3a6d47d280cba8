//! Observability of a fault in a motion: its Fisher information after marginalising unknown frames, link
//! deviations, and every other single cause.

use nalgebra::{DMatrix, DVector};
use poseaudit::geometry::Vec3;
use poseaudit::robot::Chain;
use poseaudit::synth::Scenario;

use crate::cases::Case;
use crate::kinds::{DEGREE, Kind, Planted, Truth, chain};
use crate::scenes::Scene;

/// Number of pose samples that represent the stream.
const SAMPLES: usize = 120;
/// Share of independent samples, given correlated noise.
const INDEPENDENT: f64 = 0.2;
/// Standard deviation of the link deviations of an uncalibrated arm, m and rad.
const LINK: (f64, f64) = (3e-4, 0.05 * DEGREE);
/// Prior standard deviations of a marker's distance from the tip, m, and of its rotation, rad.
const MARKER: (f64, f64) = (0.5, 3.0);
/// Prior standard deviations of a tracker's position, m, and rotation, rad.
const WORLD: (f64, f64) = (10.0, 3.0);
/// Prior standard deviation of another cause: zero offset, rad, and latency, s.
const ZERO_RAD: f64 = 3.0;
const LATENCY_S: f64 = 1.0;
/// Minimum χ² (five standard deviations) of a fault that must be found.
const SHOWN: f64 = 25.0;

/// Whether the poses show a planted fault and distinguish it from every other single cause. False for kinds
/// without a model here.
pub fn is_observable(case: &Case, planted: &Planted) -> bool {
    let run = &case.scenario;
    let Truth::Amount(amount) = planted.truth else { return false };
    // With several faults, each would have to be distinguished from all combinations of the others.
    if case.planted.len() > 1 {
        return false;
    }
    let Some(columns) = Columns::of(run) else { return false };
    let dof = columns.zeros.len();
    let joint = |name: &Option<String>| {
        chain(run).joint_names().iter().position(|joint| Some(joint) == name.as_ref())
    };
    let signature = match (planted.kind, joint(&planted.subject)) {
        (Kind::PoseLate, _) => &columns.latency * amount,
        (Kind::Zero, Some(joint)) => &columns.zeros[joint] * amount,
        _ => return false,
    };
    let is_its = |other: Option<usize>| match planted.kind {
        Kind::Zero => other.is_some() && other == joint(&planted.subject),
        _ => other.is_none(),
    };
    let mut nuisances = columns.links.clone();
    if !case.names_tip {
        nuisances.extend(scaled(&columns.tool, MARKER));
    }
    if matches!(case.scene, Scene::TrackerWorld | Scene::Marker) {
        nuisances.extend(scaled(&columns.base, WORLD));
    }
    let others = (0..dof).map(Some).chain([None]).filter(|other| !is_its(*other));
    let others = others.map(|other| match other {
        Some(joint) => vec![&columns.zeros[joint] * ZERO_RAD],
        None => vec![&columns.latency * LATENCY_S],
    });
    let frames = [scaled(&columns.tool, MARKER), scaled(&columns.base, WORLD)];
    let least = others.chain(frames).map(|other| {
        let all: Vec<_> = nuisances.iter().cloned().chain(other).collect();
        left(&signature, &all)
    });
    least.fold(left(&signature, &nuisances), f64::min) > SHOWN
}

fn scaled(frame: &[DVector<f64>], (length_m, angle_rad): (f64, f64)) -> Vec<DVector<f64>> {
    let sigma = |at: usize| if at < 3 { length_m } else { angle_rad };
    frame.iter().enumerate().map(|(at, column)| column * sigma(at)).collect()
}

/// Residual χ² of a signature after projecting out columns with unit priors.
fn left(signature: &DVector<f64>, columns: &[DVector<f64>]) -> f64 {
    let a = DMatrix::from_columns(columns);
    let normal = a.tr_mul(&a) + DMatrix::identity(columns.len(), columns.len());
    let b = a.tr_mul(signature);
    let explained = normal.cholesky().map_or(0.0, |normal| b.dot(&normal.solve(&b)));
    signature.norm_squared() - explained
}

/// Derivatives of the pose stream in units of its noise, six rows per sample.
struct Columns {
    zeros: Vec<DVector<f64>>,
    latency: DVector<f64>,
    base: Vec<DVector<f64>>,
    tool: Vec<DVector<f64>>,
    /// Three translations and three rotations of each link, one standard deviation each.
    links: Vec<DVector<f64>>,
}

impl Columns {
    fn of(run: &Scenario) -> Option<Self> {
        let chain: Chain = chain(run);
        let dof = chain.dof();
        let step_s = run.duration_s / SAMPLES as f64;
        let times_s: Vec<f64> = (0..SAMPLES).map(|at| (at as f64 + 0.5) * step_s).collect();
        let rows = run.joints_at(&times_s).ok()?;
        let quantum = run.joints.quantum * 0.3 + run.noise.joints;
        let sigma_m = run.noise.pose_m.max(1e-6).hypot(quantum);
        let sigma_rad = run.noise.pose_rad.max(1e-6).hypot(quantum);
        let correlation = run.noise.correlation;
        let independent = INDEPENDENT * (1.0 - correlation) / (1.0 + correlation);
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
            let put = |column: &mut DVector<f64>, shift: Vec3, turn: Vec3, times: f64| {
                for axis in 0..3 {
                    column[6 * at + axis] += weight * times * shift[axis] / sigma_m;
                    column[6 * at + 3 + axis] += weight * times * turn[axis] / sigma_rad;
                }
            };
            for (joint, column) in jacobian.iter().enumerate() {
                let turn = Vec3::new(column[3], column[4], column[5]);
                let shift =
                    Vec3::new(column[0], column[1], column[2]) + turn.cross(&(stream - tip));
                put(&mut columns.zeros[joint], shift, turn, 1.0);
                put(&mut columns.latency, shift, turn, -velocity[joint]);
            }
            let frame =
                |into: &mut [DVector<f64>], origin: Vec3, axes: [Vec3; 3], sigma: (f64, f64)| {
                    for (axis, direction) in axes.into_iter().enumerate() {
                        put(&mut into[axis], direction, Vec3::zeros(), sigma.0);
                        put(
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
                frame(into, link.translation.vector, axes, LINK);
            }
        }
        Some(columns)
    }
}
