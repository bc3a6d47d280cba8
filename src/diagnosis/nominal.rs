//! Whether a residual is that of a nominal model held against a calibrated arm.
//!
//! Every arm leaves the factory a little other than its drawing: lengths by tenths of a millimetre,
//! axes by hundredths of a degree. Against the controller's calibrated pose the drawing's FK is then
//! off by millimetres that no one or two joint zeros explain, and that small changes of all link
//! frames do (Mooring, Roth and Driels, *Fundamentals of Manipulator Calibration*, 1991, ch. 3).

use super::linear::{Linear, Normal, Weight};
use super::model::{FLOOR_M, FLOOR_RAD, State, StreamState, Sweep, Witness};
use crate::geometry::Vec3;
use nalgebra::DVector;

/// No arm's calibration moves its tip by more, rms: 10 mm and 0.5°.
pub(super) const MOST_M: f64 = 10e-3;
pub(super) const MOST_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// Less than this is no calibration's, rms: 0.3 mm.
const LEAST_M: f64 = 0.3e-3;
/// Link frames change by no more than about this, m and rad: steps are damped at this scale.
const SCALE: f64 = 0.01;
/// Samples that are fitted.
const SAMPLES: usize = 1000;
/// Small changes leave less than this share of what the smallest explanation leaves.
const LEFT: f64 = 0.5;

/// Whether small changes of the link frames explain `witness` far better than the causes in
/// `state` do, with so little to explain that a calibration may account for all of it.
///
/// `plain` is the stream's state without any cause but latency and large frames; `price` is that of
/// a parameter.
pub(super) fn is_nominal(
    witness: &Witness,
    stream: usize,
    state: &State,
    plain: &StreamState,
    price: f64,
) -> bool {
    let none = vec![0.0; state.offsets.len()];
    let stride = witness.len().div_ceil(SAMPLES).max(1);
    let as_recorded = witness.linearize(plain, &none, stride);
    let rms = |residual: &[[f64; 3]]| {
        let squares: f64 = residual.iter().flatten().map(|c| c * c).sum();
        (squares / residual.len().max(1) as f64).sqrt()
    };
    if rms(&as_recorded.residual[0]) > MOST_M || rms(&as_recorded.residual[1]) > MOST_RAD {
        return false;
    }
    let explained = witness.linearize(&state.streams[stream], &state.offsets, stride);
    if rms(&explained.residual[0]) < LEAST_M {
        return false;
    }
    let frames = link_frames(witness, plain, stride);
    let (step, parameters) = solve(&frames);
    let calibrated = frames.weights_after(step.as_slice());
    let sparse = explained.weights_after(&vec![0.0; explained.width]);
    let better = |(a, b): (&Weight, &Weight)| (b.noise.sigma / a.noise.sigma).ln();
    // Both are weighed with the calibrated fit's memory, the nearer to the log's own noise.
    let gain: f64 = calibrated
        .iter()
        .zip(&sparse)
        .map(|pair| 2.0 * 3.0 * frames.len() as f64 / pair.0.noise.inflation() * better(pair))
        .sum();
    let left = calibrated[0].noise.sigma < LEFT * sparse[0].noise.sigma
        || calibrated[1].noise.sigma < LEFT * sparse[1].noise.sigma;
    left && gain > price * parameters as f64
}

/// The stream linearised in small changes of the reference and of every joint's child link frame,
/// each six numbers, and in its latency.
fn link_frames(witness: &Witness, plain: &StreamState, stride: usize) -> Linear {
    let joints = witness.columns.len();
    let width = 6 * (joints + 1) + 1;
    let mut linear = Linear::new(width, &[FLOOR_M, FLOOR_RAD]);
    let mut sweep = Sweep::new(witness);
    let mut links = Vec::new();
    let none = vec![0.0; witness.joints.dof];
    for k in (0..witness.len()).step_by(stride) {
        let Some(predicted) = witness.pose_at(k, plain, &none, &mut sweep) else { continue };
        witness.chain.joint_frames(sweep.q(), &mut links);
        let (velocity, rate) = sweep.twist();
        let mut rows = linear.push(&witness.residual(k, &predicted));
        let tip = predicted.translation.vector;
        let base = [plain.reference];
        let frames = links.iter().map(|link| plain.reference * link);
        for (i, frame) in base.into_iter().chain(frames).enumerate() {
            for axis in 0..3 {
                let unit = frame.rotation * Vec3::ith(axis, 1.0);
                rows.set(0, 6 * i + axis, unit.into());
                rows.set(0, 6 * i + 3 + axis, unit.cross(&(tip - frame.translation.vector)).into());
                rows.set(1, 6 * i + 3 + axis, unit.into());
            }
        }
        let (velocity, rate) =
            (plain.reference.rotation * velocity, plain.reference.rotation * rate);
        rows.set(0, width - 1, (-velocity).into());
        rows.set(1, width - 1, (-rate).into());
    }
    linear
}

/// The least-squares changes, and how many of them the log tells apart.
fn solve(linear: &Linear) -> (DVector<f64>, usize) {
    let columns: Vec<usize> = (0..linear.width).collect();
    let zero = DVector::zeros(linear.width);
    let mut weights = linear.first_weights();
    let mut step = zero.clone();
    let mut seen = 0;
    for _ in 0..3 {
        let mut normal = Normal::zeros(linear.width);
        linear.accumulate(&weights, &columns, &mut normal);
        seen = normal.rank();
        for i in 0..linear.width {
            normal.matrix[(i, i)] += SCALE.powi(-2);
        }
        step = normal.step(&zero, &columns);
        weights = linear.weights_after(step.as_slice());
    }
    (step, seen)
}
