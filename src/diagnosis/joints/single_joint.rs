//! Scale and zero of one joint in closed form, given the others.
//!
//! A revolute joint moves the tip and the ends of its axes on circles, so the four vectors of a pose are
//! `c + a·cos θ + b·sin θ`. The residual sum of squares is a constant minus `2·Re Σ zₖ·exp(−iθₖ)`, with `zₖ`
//! from the logged poses. With `θₖ = s·vₖ + o`, the best `o` for a given `s` is the argument of
//! `Σ zₖ·exp(−i·s·vₖ)`, and the best `s` maximises its magnitude. A spectrum of a few hundred lines covers every
//! scale, sign and zero.

use super::interpreted_poses::{ConstantFrames, InterpretedPoses};
use super::map::JointMap;
use crate::model::jacobian::{Derivative, PoseJacobian};
use ground::geometry::{Pose, Vec3};
use ground::stats::mean;
use std::f64::consts::{PI, TAU};

pub(super) struct SingleJoint {
    values: Vec<f64>,
    /// Real and imaginary part of `zₖ`; required position, m, if prismatic.
    required: Vec<[f64; 2]>,
    is_prismatic: bool,
    /// Minimum and maximum value.
    span: [f64; 2],
}

/// Position, and the columns of the rotation matrix scaled by the lever, if any.
fn pose_vectors(pose: &Pose, lever_m: Option<f64>) -> [Vec3; 4] {
    let position = pose.translation.vector;
    let Some(lever_m) = lever_m else {
        return [position, Vec3::zeros(), Vec3::zeros(), Vec3::zeros()];
    };
    let matrix = pose.rotation.to_rotation_matrix();
    // The squared Frobenius norm of a matrix change is twice the squared angle.
    let scale = lever_m / 2f64.sqrt();
    let column = |axis: usize| scale * matrix.matrix().column(axis);
    [position, column(0), column(1), column(2)]
}

fn dot(a: &[Vec3; 4], b: &[Vec3; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

impl SingleJoint {
    /// The other joints are read by `map`, in `frames`.
    pub fn new(
        view: &InterpretedPoses,
        map: &JointMap,
        frames: &ConstantFrames,
        joint: usize,
    ) -> Self {
        Self::each(view, map, frames, &[joint]).remove(0)
    }

    /// The same for each of several joints.
    pub fn each(
        view: &InterpretedPoses,
        map: &JointMap,
        frames: &ConstantFrames,
        joints: &[usize],
    ) -> Vec<Self> {
        let dof = view.chain.dof();
        let lever_m = view.rotation.as_ref().map(|_| view.lever_m);
        let (mut q, mut columns) = (vec![0.0; dof], vec![[0.0; 6]; dof]);
        let without_samples = |&joint: &usize| Self {
            values: Vec::with_capacity(view.len()),
            required: Vec::with_capacity(view.len()),
            is_prismatic: view.chain.slides(joint),
            span: view.spans[map.from[joint]],
        };
        let mut all: Vec<Self> = joints.iter().map(without_samples).collect();
        for (row, logged) in view.q.chunks_exact(dof).zip(view.logged()) {
            map.apply(row, &mut q);
            let link = view.chain.forward_with_jacobian(&q, &mut columns);
            let jacobian = PoseJacobian::new(&columns, &frames.reference, &link, &frames.tool);
            let predicted = pose_vectors(&jacobian.pose, lever_m);
            let logged = pose_vectors(&logged, lever_m);
            let off: [Vec3; 4] = std::array::from_fn(|i| logged[i] - predicted[i]);
            for (single, &joint) in all.iter_mut().zip(joints) {
                single.values.push(row[map.from[joint]]);
                let derivative = jacobian.joint(joint);
                single.required.push(single.required(q[joint], derivative, &predicted, &off));
            }
        }
        all
    }

    /// Of a sample at position `q`. `off` is the difference of the logged pose from the `predicted` one.
    fn required(
        &self,
        q: f64,
        [velocity, axis]: Derivative,
        [_, u, v, w]: &[Vec3; 4],
        off: &[Vec3; 4],
    ) -> [f64; 2] {
        let along = [velocity, axis.cross(u), axis.cross(v), axis.cross(w)];
        if self.is_prismatic {
            return [q + dot(&along, off) / dot(&along, &along).max(1e-12), 0.0];
        }
        // On the circle about the axis, at angle `q` from the joint's zero.
        let radius = along.map(|along| along.cross(&axis));
        let off = std::array::from_fn(|i| off[i] + radius[i]);
        let (cos, sin) = (dot(&radius, &off), dot(&along, &off));
        let (sin_q, cos_q) = q.sin_cos();
        [cos * cos_q - sin * sin_q, cos * sin_q + sin * cos_q]
    }

    /// Best zero, or 0 without one, and its score (higher is better).
    pub fn best_zero(&self, factor: f64, has_zero: bool) -> (f64, f64) {
        let samples = self.values.iter().zip(&self.required);
        if self.is_prismatic {
            let offs = samples.map(|(value, required)| required[0] - factor * value);
            let zero = if has_zero { mean(offs.clone()) } else { 0.0 };
            return (zero, -offs.map(|off| (off - zero).powi(2)).sum::<f64>());
        }
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (value, [a, b]) in samples {
            // z·exp(−i·s·v)
            let (sin, cos) = (factor * value).sin_cos();
            real += a * cos + b * sin;
            imaginary += b * cos - a * sin;
        }
        if has_zero { (imaginary.atan2(real), real.hypot(imaginary)) } else { (0.0, real) }
    }

    /// Best factor and zero, or 0 without one. `None` if the joint does not move.
    pub fn best_factor(&self, has_zero: bool) -> Option<(f64, f64)> {
        const MAX_RANGE_RAD: f64 = 2.5 * TAU;
        /// Joints with a smaller range do not determine their scale.
        const SPECTRAL_LINE_RAD: f64 = PI / 16.0;
        let [low, high] = self.span;
        if high <= low {
            return None;
        }
        if self.is_prismatic {
            return Some(self.line(has_zero));
        }
        let widest = if has_zero { high - low } else { low.abs().max(high.abs()) };
        let lines = (MAX_RANGE_RAD / SPECTRAL_LINE_RAD) as i32;
        let tried = (-lines..=lines).map(|line| {
            let factor = f64::from(line) * (SPECTRAL_LINE_RAD / widest);
            let (zero, score) = self.best_zero(factor, has_zero);
            (score, (factor, zero))
        });
        tried.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, best)| best)
    }

    /// Regression for a prismatic joint.
    fn line(&self, has_zero: bool) -> (f64, f64) {
        let mean = |of: &dyn Fn(usize) -> f64| mean((0..self.values.len()).map(of));
        let (v, w) = (|k: usize| self.values[k], |k: usize| self.required[k][0]);
        let (v0, w0) = if has_zero { (mean(&v), mean(&w)) } else { (0.0, 0.0) };
        let slope =
            mean(&|k| (v(k) - v0) * (w(k) - w0)) / mean(&|k| (v(k) - v0).powi(2)).max(1e-18);
        (slope, w0 - slope * v0)
    }
}
