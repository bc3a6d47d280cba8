//! Finite Fourier series motions that start and end at rest.

use super::JointMargins;
use ground::stream::JointTrack;
use nalgebra::{DMatrix, DVectorViewMut};
use std::f64::consts::{PI, TAU};

/// Rate for limit checks, by the fastest sine.
const SAMPLES_PER_PERIOD: usize = 16;

/// `q_j(t) = around_j + Σ_k sin_jk·sin(kω(t − rest)) + cos_jk·cos(kω(t − rest))`, `ω = 2π / seconds`.
/// Velocity and acceleration are zero at both ends; the arm rests before and after.
#[derive(Clone, Debug, PartialEq)]
pub struct FourierMotion {
    /// Start and end, rad or m.
    pub around: Vec<f64>,
    /// Motion's duration.
    pub seconds: f64,
    /// Before and after it.
    pub rest_s: f64,
    /// Sines per joint.
    pub harmonics: usize,
    /// Amplitudes, joint by joint, rad or m.
    pub sin: Vec<f64>,
    /// Amplitudes, joint by joint, rad or m.
    pub cos: Vec<f64>,
}

impl FourierMotion {
    pub(super) fn at_rest(around: &[f64], seconds: f64, rest_s: f64, harmonics: usize) -> Self {
        let (around, none) = (around.to_vec(), vec![0.0; around.len() * harmonics]);
        Self { around, seconds, rest_s, harmonics, sin: none.clone(), cos: none }
    }

    /// Duration, including rests.
    pub fn length_s(&self) -> f64 {
        self.seconds + 2.0 * self.rest_s
    }

    /// Number of joints.
    pub fn dof(&self) -> usize {
        self.around.len()
    }

    /// Position, velocity and acceleration of a joint.
    pub fn at(&self, joint: usize, t_s: f64) -> [f64; 3] {
        self.moving(joint, (t_s - self.rest_s).clamp(0.0, self.seconds))
    }

    /// Time since the start of the motion.
    fn moving(&self, joint: usize, t_s: f64) -> [f64; 3] {
        let omega = TAU / self.seconds;
        let own = joint * self.harmonics..(joint + 1) * self.harmonics;
        let mut sum = [self.around[joint], 0.0, 0.0];
        for (k, (a, b)) in self.sin[own.clone()].iter().zip(&self.cos[own]).enumerate() {
            let rate = (k + 1) as f64 * omega;
            let (sin, cos) = (rate * t_s).sin_cos();
            sum[0] += a * sin + b * cos;
            sum[1] += rate * (a * cos - b * sin);
            sum[2] -= rate * rate * (a * sin + b * cos);
        }
        sum
    }

    /// Samples at `count` even times.
    pub fn track(&self, count: usize) -> JointTrack {
        sampled(count, self.length_s(), self.dof(), |joint, t_s| self.at(joint, t_s))
    }

    /// Projects a joint's amplitudes onto motions at rest at both ends, and scales them to `share` of its
    /// room.
    ///
    /// Limits also hold between samples: a sum of K sines bounded by m at N equidistant points is bounded
    /// by `m / cos(πK/N)` everywhere (Ehlich and Zeller, "Schwankung von Polynomen zwischen Gitterpunkten",
    /// Mathematische Zeitschrift 86, 1964).
    pub(super) fn project(&mut self, joint: usize, margins: &JointMargins, share: f64) {
        let own = joint * self.harmonics..(joint + 1) * self.harmonics;
        // At the ends, velocity is Σ k·sin_k, position Σ cos_k, acceleration Σ k²·cos_k.
        subtract_projections(&mut self.sin[own.clone()], [|k| k]);
        subtract_projections(&mut self.cos[own.clone()], [|_| 1.0, |k| k * k]);
        let count = SAMPLES_PER_PERIOD * self.harmonics;
        let between = (PI / SAMPLES_PER_PERIOD as f64).cos().recip();
        let mut most = [0.0_f64; 4];
        for row in 0..count {
            let [q, qd, qdd] = self.moving(joint, self.seconds * row as f64 / count as f64);
            let off = q - self.around[joint];
            let values = [off, -off, qd.abs(), qdd.abs()];
            most.iter_mut().zip(values).for_each(|(most, value)| *most = most.max(value));
        }
        // The bound is on the absolute value, so either side includes the larger overshoot.
        let over = (between - 1.0) * most[0].max(most[1]);
        let allowed = [
            share * margins.above / (most[0] + over),
            share * margins.below / (most[1] + over),
            margins.velocity / (between * most[2]),
            margins.acceleration / (between * most[3]),
        ];
        let factor = allowed.into_iter().fold(f64::INFINITY, f64::min);
        let factor = if factor.is_finite() { factor * (1.0 - 1e-9) } else { 0.0 };
        for value in self.sin[own.clone()].iter_mut().chain(&mut self.cos[own]) {
            *value *= factor;
        }
    }
}

/// Samples at `count` even times, by position, velocity and acceleration of a joint.
pub(super) fn sampled(
    count: usize,
    length_s: f64,
    dof: usize,
    at: impl Fn(usize, f64) -> [f64; 3],
) -> JointTrack {
    let last = count.max(2) - 1;
    let mut track = JointTrack { dof, ..JointTrack::default() };
    for row in 0..=last {
        let t_s = length_s * row as f64 / last as f64;
        track.t_s.push(t_s);
        for [q, qd, _] in (0..dof).map(|joint| at(joint, t_s)) {
            track.q.push(q);
            track.qd.push(qd);
        }
    }
    track
}

/// Removes the components along `directions`, functions of the number of the harmonic, from 1.
fn subtract_projections<const N: usize>(values: &mut [f64], directions: [fn(f64) -> f64; N]) {
    let harmonics = values.len();
    let basis = DMatrix::from_fn(harmonics, N, |k, n| directions[n]((k + 1) as f64)).qr().q();
    let mut values = DVectorViewMut::from_slice(values, harmonics);
    // The second pass removes rounding errors.
    for _ in 0..2 {
        let along = basis.tr_mul(&values);
        values -= &basis * along;
    }
}
