//! Scale and zero of one joint in closed form, given the others.
//!
//! A revolute joint moves the tip and the ends of its axes on circles, so the four vectors of a pose are
//! `c + a·cos θ + b·sin θ`. The residual sum of squares is a constant minus `2·Re Σ zₖ·exp(−iθₖ)`, with `zₖ`
//! from the logged poses. With `θₖ = s·vₖ + o`, the best `o` for a given `s` is the argument of
//! `Σ zₖ·exp(−i·s·vₖ)`, and the best `s` maximises its magnitude. A spectrum of a few hundred lines covers every
//! scale, sign and zero.

use super::interpreted_poses::{ConstantFrames, InterpretedPoses};
use super::map::JointMap;
use crate::model::jacobian::PoseJacobian;
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
        let dof = view.chain.dof();
        let slides = view.chain.slides(joint);
        let lever_m = view.rotation.as_ref().map(|_| view.lever_m);
        let (mut q, mut columns) = (vec![0.0; dof], vec![[0.0; 6]; dof]);
        let (mut values, mut required) = (Vec::new(), Vec::new());
        for (k, row) in view.q.chunks_exact(dof).enumerate() {
            map.apply(row, &mut q);
            values.push(row[map.from[joint]]);
            let link = view.chain.forward_with_jacobian(&q, &mut columns);
            let jacobian = PoseJacobian::new(&columns, &frames.reference, &link, &frames.tool);
            let [velocity, axis] = jacobian.joint(joint);
            let predicted = pose_vectors(&jacobian.pose, lever_m);
            let [_, u, v, w] = predicted;
            let along = [velocity, axis.cross(&u), axis.cross(&v), axis.cross(&w)];
            let turn = view.rotation.as_ref().map_or_else(Default::default, |all| all[k]);
            let logged = pose_vectors(&Pose::from_parts(view.xyz[k].into(), turn), lever_m);
            let off: [Vec3; 4] = std::array::from_fn(|i| logged[i] - predicted[i]);
            required.push(if slides {
                [q[joint] + dot(&along, &off) / dot(&along, &along).max(1e-12), 0.0]
            } else {
                // On the circle about the axis, at angle `q` from the joint's zero.
                let radius = along.map(|along| along.cross(&axis));
                let off = std::array::from_fn(|i| off[i] + radius[i]);
                let (cos, sin) = (dot(&radius, &off), dot(&along, &off));
                let (sin_q, cos_q) = q[joint].sin_cos();
                [cos * cos_q - sin * sin_q, cos * sin_q + sin * cos_q]
            });
        }
        Self { values, required, is_prismatic: slides, span: view.spans[map.from[joint]] }
    }

    /// Best zero and its score (higher is better).
    pub fn best_zero(&self, factor: f64) -> (f64, f64) {
        if self.is_prismatic {
            let offs = || self.values.iter().zip(&self.required).map(|(v, w)| w[0] - factor * v);
            let zero = mean(offs());
            return (zero, -offs().map(|off| (off - zero).powi(2)).sum::<f64>());
        }
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (value, [a, b]) in self.values.iter().zip(&self.required) {
            // z·exp(−i·s·v)
            let (sin, cos) = (factor * value).sin_cos();
            real += a * cos + b * sin;
            imaginary += b * cos - a * sin;
        }
        (imaginary.atan2(real), real.hypot(imaginary))
    }

    /// Zero offset 0.
    pub fn score_without_zero(&self, factor: f64) -> f64 {
        let samples = self.values.iter().zip(&self.required);
        if self.is_prismatic {
            return -samples.map(|(v, w)| (w[0] - factor * v).powi(2)).sum::<f64>();
        }
        let part = |(value, [a, b]): (&f64, &[f64; 2])| {
            let (sin, cos) = (factor * value).sin_cos();
            a * cos + b * sin
        };
        samples.map(part).sum()
    }

    /// Best with a free zero, and without one.
    pub fn factors(&self) -> Vec<(f64, f64)> {
        const MAX_RANGE_RAD: f64 = 2.5 * TAU;
        /// Joints with a smaller range do not determine their scale.
        const SPECTRAL_LINE_RAD: f64 = PI / 16.0;
        let width = self.span[1] - self.span[0];
        let largest = self.span[0].abs().max(self.span[1].abs());
        if width <= 0.0 {
            return Vec::new();
        }
        if self.is_prismatic {
            return self.line();
        }
        let best = |lines: usize, step: f64, well: &dyn Fn(f64) -> f64| {
            let lines = (0..=2 * lines).map(|i| (i as f64 - lines as f64) * step);
            let best = lines.map(|s| (well(s), s)).max_by(|a, b| a.0.total_cmp(&b.0));
            best.map_or(1.0, |(_, s)| s)
        };
        let lines = (MAX_RANGE_RAD / SPECTRAL_LINE_RAD) as usize;
        let with_zero = best(lines, SPECTRAL_LINE_RAD / width, &|s| self.best_zero(s).1);
        let without = best(lines, SPECTRAL_LINE_RAD / largest, &|s| self.score_without_zero(s));
        vec![(with_zero, self.best_zero(with_zero).0), (without, 0.0)]
    }

    /// Regression for a prismatic joint, with and without a zero.
    fn line(&self) -> Vec<(f64, f64)> {
        let mean = |of: &dyn Fn(usize) -> f64| mean((0..self.values.len()).map(of));
        let (v, w) = (|k: usize| self.values[k], |k: usize| self.required[k][0]);
        let (mean_v, mean_w) = (mean(&v), mean(&w));
        let slope = |v0: f64, w0: f64| {
            mean(&|k| (v(k) - v0) * (w(k) - w0)) / mean(&|k| (v(k) - v0).powi(2)).max(1e-18)
        };
        let with_zero = slope(mean_v, mean_w);
        vec![(with_zero, mean_w - with_zero * mean_v), (slope(0.0, 0.0), 0.0)]
    }
}
