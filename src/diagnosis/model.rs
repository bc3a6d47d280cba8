//! The model of a pose stream, and its derivatives.
//!
//! `logged(s) = reference · FK(q(s − τ) + δ) · tool`, with `τ = latency + skew·(s − middle)` and
//! positions scaled by `1 + growth` about the base origin. Small changes of `reference` multiply on
//! the left, of `tool` on the right. Residuals are taken in the stream's reference frame: position
//! in m, rotation as the rotation vector of `logged · predicted⁻¹` in rad.

use super::noise::Noise;
use crate::geometry::{Pose, Rotation, Vec3, rotation_from_rotvec, rotvec_from_rotation};
use crate::robot::Chain;
use crate::stream::JointTrack;
use nalgebra::{DMatrix, DVector, Translation3};

/// Parameters of one stream, in the order of its columns.
pub(super) const LATENCY: usize = 0;
pub(super) const SKEW: usize = 1;
pub(super) const GROWTH: usize = 2;
pub(super) const REFERENCE: usize = 3;
pub(super) const TOOL: usize = 9;
/// Parameters a stream.
pub(super) const STREAM_WIDTH: usize = 15;

/// A pose stream whose reading and units are settled, ready for the fit.
pub(super) struct Witness<'a> {
    pub joints: &'a JointTrack,
    pub chain: &'a Chain,
    pub columns: &'a [usize],
    pub reference_known: bool,
    /// Joint speeds below which a joint counts as still, by joint of the track, rad/s or m/s.
    pub still: &'a [f64],
    pub t_s: Vec<f64>,
    pub xyz: Vec<Vec3>,
    pub rotation: Vec<Rotation>,
    /// The stamp about which skew turns, s.
    pub middle_s: f64,
}

/// The parameters of one stream.
#[derive(Clone, Debug)]
pub(super) struct StreamState {
    pub latency_s: f64,
    pub skew: f64,
    pub growth: f64,
    pub reference: Pose,
    pub tool: Pose,
    /// The part of `reference` that is a round slip rather than a tuned number.
    pub round_reference: Option<Pose>,
    /// The part of `tool` that is a round slip rather than a tuned number.
    pub round_tool: Option<Pose>,
}

impl StreamState {
    pub fn at_latency(latency_s: f64) -> Self {
        Self {
            latency_s,
            skew: 0.0,
            growth: 0.0,
            reference: Pose::identity(),
            tool: Pose::identity(),
            round_reference: None,
            round_tool: None,
        }
    }

    /// The tuned parameters' present values: how far each is from "no such cause".
    fn values(&self) -> [f64; STREAM_WIDTH] {
        let mut values = [0.0; STREAM_WIDTH];
        values[LATENCY] = self.latency_s;
        values[SKEW] = self.skew;
        values[GROWTH] = self.growth;
        let reference = self.reference * self.round_reference.unwrap_or_default().inverse();
        let tool = self.round_tool.unwrap_or_default().inverse() * self.tool;
        values[REFERENCE..TOOL].copy_from_slice(&twist_of(&reference));
        values[TOOL..].copy_from_slice(&twist_of(&tool));
        values
    }

    fn step(&mut self, delta: &[f64]) {
        self.latency_s += delta[LATENCY];
        self.skew += delta[SKEW];
        self.growth += delta[GROWTH];
        self.reference = pose_of_twist(&delta[REFERENCE..TOOL]) * self.reference;
        self.tool *= pose_of_twist(&delta[TOOL..]);
    }
}

/// Translation and rotation vector of a pose, side by side.
pub(super) fn twist_of(pose: &Pose) -> [f64; 6] {
    let (p, r) = (pose.translation.vector, rotvec_from_rotation(&pose.rotation));
    [p.x, p.y, p.z, r.x, r.y, r.z]
}

fn pose_of_twist(twist: &[f64]) -> Pose {
    Pose::from_parts(
        Translation3::new(twist[0], twist[1], twist[2]),
        rotation_from_rotvec(Vec3::new(twist[3], twist[4], twist[5])),
    )
}

/// The parameters of the whole model: joint offsets, then each stream's.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub offsets: Vec<f64>,
    pub streams: Vec<StreamState>,
}

impl State {
    /// Number of parameters.
    pub fn width(&self) -> usize {
        self.offsets.len() + self.streams.len() * STREAM_WIDTH
    }

    /// Index of a stream's parameter.
    pub fn index(&self, stream: usize, parameter: usize) -> usize {
        self.offsets.len() + stream * STREAM_WIDTH + parameter
    }

    /// The scale at which steps are damped (Levenberg 1944): what the log shows is known far better
    /// than this and hardly notices; what it does not show stays in place.
    pub fn scales(&self) -> Vec<f64> {
        let mut stream = [0.02; STREAM_WIDTH];
        stream[SKEW] = 1e-4;
        let joints = std::iter::repeat_n(0.02, self.offsets.len());
        joints.chain(self.streams.iter().flat_map(|_| stream)).collect()
    }

    /// Present values of all tuned parameters.
    pub fn values(&self) -> DVector<f64> {
        let streams = self.streams.iter().flat_map(StreamState::values);
        DVector::from_iterator(self.width(), self.offsets.iter().copied().chain(streams))
    }

    /// Moves every parameter by `delta`.
    pub fn step(&mut self, delta: &DVector<f64>) {
        let joints = self.offsets.len();
        for (offset, change) in self.offsets.iter_mut().zip(delta.iter()) {
            *offset += change;
        }
        for (s, stream) in self.streams.iter_mut().enumerate() {
            let start = joints + s * STREAM_WIDTH;
            stream.step(&delta.as_slice()[start..start + STREAM_WIDTH]);
        }
    }
}

/// One prediction and what it rests on.
struct Predicted {
    pose: Pose,
    /// `base_from_link · tool` before the reference is applied.
    in_base: Pose,
    moving: bool,
}

/// Buffers of one sweep over a stream.
pub(super) struct Sweep {
    cursor: usize,
    track_q: Vec<f64>,
    track_qd: Vec<f64>,
    q: Vec<f64>,
    qd: Vec<f64>,
    jacobian: Vec<[f64; 6]>,
}

impl Sweep {
    pub fn new(witness: &Witness) -> Self {
        let (dof, track) = (witness.columns.len(), witness.joints.dof);
        Self {
            cursor: 0,
            track_q: vec![0.0; track],
            track_qd: vec![0.0; track],
            q: vec![0.0; dof],
            qd: vec![0.0; dof],
            jacobian: vec![[0.0; 6]; dof],
        }
    }
}

impl Witness<'_> {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// The pose that the model gives for sample `k`; the Jacobian of the chain is left in `sweep`.
    fn predict(&self, k: usize, stream: &StreamState, offsets: &[f64], sweep: &mut Sweep) -> Option<Predicted> {
        let stamp = self.t_s[k];
        let truth = stamp - stream.latency_s - stream.skew * (stamp - self.middle_s);
        let Sweep { cursor, track_q, track_qd, q, qd, jacobian } = sweep;
        if !self.joints.at(truth, cursor, track_q, track_qd) {
            return None;
        }
        let mut moving = false;
        for (i, &column) in self.columns.iter().enumerate() {
            q[i] = track_q[column] + offsets[column];
            qd[i] = track_qd[column];
            moving |= qd[i].abs() > self.still[column];
        }
        let base_from_link = self.chain.forward_with_jacobian(q, jacobian);
        let mut in_base = base_from_link * stream.tool;
        in_base.translation.vector *= 1.0 + stream.growth;
        Some(Predicted { pose: stream.reference * in_base, in_base, moving })
    }

    /// `reference_from_tip · tool` for sample `k`, or `None` where the joints do not cover it.
    pub fn pose_at(&self, k: usize, stream: &StreamState, offsets: &[f64], sweep: &mut Sweep) -> Option<Pose> {
        self.predict(k, stream, offsets, sweep).map(|predicted| predicted.pose)
    }

    /// Logged minus predicted: position in m, rotation vector in rad.
    pub fn residual(&self, k: usize, predicted: &Pose) -> ([f64; 3], [f64; 3]) {
        let position = self.xyz[k] - predicted.translation.vector;
        let rotation = rotvec_from_rotation(&(self.rotation[k] * predicted.rotation.inverse()));
        (position.into(), rotation.into())
    }

    /// Residuals and design rows of every `stride`-th sample that the joints cover.
    pub fn linearize(&self, stream: &StreamState, offsets: &[f64], stride: usize) -> Linear {
        let (joints, width) = (offsets.len(), offsets.len() + STREAM_WIDTH);
        let mut sweep = Sweep::new(self);
        let mut linear = Linear { width, ..Linear::default() };
        for k in (0..self.len()).step_by(stride.max(1)) {
            let Some(predicted) = self.predict(k, stream, offsets, &mut sweep) else {
                continue;
            };
            let (position, rotation) = self.residual(k, &predicted.pose);
            linear.sample.push(k);
            linear.moving += usize::from(predicted.moving);
            linear.position.push(position);
            linear.rotation.push(rotation);
            let start = linear.design.len();
            linear.design.resize(start + 6 * width, 0.0);
            let mut rows = Rows { values: &mut linear.design[start..], width };
            self.fill(k, stream, &predicted, &sweep, joints, &mut rows);
        }
        linear
    }

    /// Writes the derivatives of the prediction for one sample.
    fn fill(&self, k: usize, stream: &StreamState, predicted: &Predicted, sweep: &Sweep, joints: usize, rows: &mut Rows) {
        let to_reference = stream.reference.rotation;
        let at = predicted.pose.translation.vector;
        let in_base = predicted.in_base.translation.vector;
        let (mut v, mut w) = (Vec3::zeros(), Vec3::zeros());
        // The chain's Jacobian is that of the link; the tool point adds the lever to it.
        let base_from_link = predicted.in_base.rotation * stream.tool.rotation.inverse();
        let lever = base_from_link * stream.tool.translation.vector;
        for (i, column) in sweep.jacobian.iter().enumerate() {
            let angular = Vec3::new(column[3], column[4], column[5]);
            let linear = Vec3::new(column[0], column[1], column[2]) + angular.cross(&lever);
            let (linear, angular) = (to_reference * linear, to_reference * angular);
            rows.set(self.columns[i], &linear, &angular);
            v += linear * sweep.qd[i];
            w += angular * sweep.qd[i];
        }
        if predicted.moving {
            rows.set(joints + LATENCY, &-v, &-w);
            let lever_s = self.t_s[k] - self.middle_s;
            rows.set(joints + SKEW, &(-v * lever_s), &(-w * lever_s));
        }
        rows.set(joints + GROWTH, &(to_reference * in_base), &Vec3::zeros());
        for axis in 0..3 {
            let unit = Vec3::ith(axis, 1.0);
            rows.set(joints + REFERENCE + axis, &unit, &Vec3::zeros());
            rows.set(joints + REFERENCE + 3 + axis, &unit.cross(&at), &unit);
            let tool_axis = predicted.pose.rotation * unit;
            rows.set(joints + TOOL + axis, &tool_axis, &Vec3::zeros());
            rows.set(joints + TOOL + 3 + axis, &Vec3::zeros(), &tool_axis);
        }
    }
}

/// The six rows of one sample, row-major.
struct Rows<'a> {
    values: &'a mut [f64],
    width: usize,
}

impl Rows<'_> {
    fn set(&mut self, column: usize, linear: &Vec3, angular: &Vec3) {
        for axis in 0..3 {
            self.values[axis * self.width + column] = linear[axis];
            self.values[(axis + 3) * self.width + column] = angular[axis];
        }
    }
}

/// A stream's residuals and design, linearised about a state.
#[derive(Default)]
pub(super) struct Linear {
    /// Parameters: the joints', then the stream's.
    pub width: usize,
    /// Index of each row's sample in the stream.
    pub sample: Vec<usize>,
    /// Samples in which some joint moves.
    pub moving: usize,
    /// Position residuals, m.
    pub position: Vec<[f64; 3]>,
    /// Rotation residuals, rad.
    pub rotation: Vec<[f64; 3]>,
    /// Six rows a sample of `width` derivatives.
    design: Vec<f64>,
}

/// Weights of a stream's samples, from noise and robustness.
pub(super) struct Weights {
    pub position: Noise,
    pub rotation: Noise,
    /// Huber weight of each sample's position, 0 to 1.
    pub robust_position: Vec<f64>,
    /// Huber weight of each sample's rotation, 0 to 1.
    pub robust_rotation: Vec<f64>,
}

impl Weights {
    fn row(&self, sample: usize, row: usize) -> f64 {
        if row < 3 {
            self.robust_position[sample] / self.position.sigma.powi(2)
        } else {
            self.robust_rotation[sample] / self.rotation.sigma.powi(2)
        }
    }
}

impl Linear {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.sample.len()
    }

    fn row(&self, sample: usize, row: usize) -> &[f64] {
        let start = (sample * 6 + row) * self.width;
        &self.design[start..start + self.width]
    }

    fn residual(&self, sample: usize, row: usize) -> f64 {
        if row < 3 { self.position[sample][row] } else { self.rotation[sample][row - 3] }
    }

    /// Adds this stream's normal equations into `normal`; `columns` maps its parameters.
    ///
    /// Each row counts as `1 / inflation` independent ones, so that costs are those of
    /// independent samples.
    pub fn accumulate(&self, weights: &Weights, columns: &[usize], normal: &mut Normal) {
        let shrink = [weights.position.inflation().recip(), weights.rotation.inflation().recip()];
        let width = self.width;
        let mut block = DMatrix::<f64>::zeros(width, width);
        let mut right = DVector::<f64>::zeros(width);
        for sample in 0..self.len() {
            for r in 0..6 {
                let weight = weights.row(sample, r) * shrink[r / 3];
                let (row, residual) = (self.row(sample, r), self.residual(sample, r));
                normal.cost += weight * residual * residual;
                for i in 0..width {
                    let scaled = weight * row[i];
                    if scaled == 0.0 {
                        continue;
                    }
                    right[i] += scaled * residual;
                    for j in 0..=i {
                        block[(i, j)] += scaled * row[j];
                    }
                }
            }
        }
        for i in 0..width {
            normal.right[columns[i]] += right[i];
            for j in 0..=i {
                let value = block[(i, j)];
                normal.matrix[(columns[i], columns[j])] += value;
                if i != j {
                    normal.matrix[(columns[j], columns[i])] += value;
                }
            }
        }
        let samples = self.len() as f64;
        normal.independent += 3.0 * samples * (shrink[0] + shrink[1]);
    }

    /// The residuals that remain after a step `delta` of this stream's parameters.
    pub fn after(&self, delta: &[f64]) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let remaining = |sample: usize, first: usize| -> [f64; 3] {
            std::array::from_fn(|axis| {
                let row = self.row(sample, first + axis);
                let explained: f64 = row.iter().zip(delta).map(|(a, d)| a * d).sum();
                self.residual(sample, first + axis) - explained
            })
        };
        (0..self.len()).map(|sample| (remaining(sample, 0), remaining(sample, 3))).unzip()
    }

    /// Adds `Σ_k Σ_l A_kᵀ W γ(k−l) W A_l` over the chosen columns into `scores`: the covariance of
    /// the score under correlated noise (the "meat" of a sandwich covariance; White 1980, Newey and
    /// West 1987, with the autocovariance of [`Noise`] in place of a truncated one).
    pub fn accumulate_scores(&self, weights: &Weights, columns: &[Option<usize>], scores: &mut DMatrix<f64>) {
        let chosen: Vec<(usize, usize)> =
            columns.iter().enumerate().filter_map(|(own, target)| target.map(|t| (own, t))).collect();
        let mut memory = vec![[0.0; 6]; chosen.len()];
        let noise = [weights.position, weights.rotation];
        let mut scaled = vec![[0.0; 6]; chosen.len()];
        for sample in 0..self.len() {
            for r in 0..6 {
                let weight = weights.row(sample, r);
                let row = self.row(sample, r);
                for (c, &(own, _)) in chosen.iter().enumerate() {
                    scaled[c][r] = weight * row[own];
                }
            }
            for a in 0..chosen.len() {
                for b in 0..=a {
                    let mut sum = 0.0;
                    for r in 0..6 {
                        let Noise { sigma, share, .. } = noise[r / 3];
                        let variance = sigma * sigma;
                        let crossed = scaled[a][r] * memory[b][r] + memory[a][r] * scaled[b][r];
                        sum += variance * (scaled[a][r] * scaled[b][r] + share * crossed);
                    }
                    scores[(chosen[a].1, chosen[b].1)] += sum;
                    if a != b {
                        scores[(chosen[b].1, chosen[a].1)] += sum;
                    }
                }
            }
            for (past, now) in memory.iter_mut().zip(&scaled) {
                for r in 0..6 {
                    past[r] = noise[r / 3].rho * (past[r] + now[r]);
                }
            }
        }
    }

    /// Adds the plain `Aᵀ W A` over the chosen columns into `information`.
    pub fn accumulate_information(&self, weights: &Weights, columns: &[Option<usize>], information: &mut DMatrix<f64>) {
        let chosen: Vec<(usize, usize)> =
            columns.iter().enumerate().filter_map(|(own, target)| target.map(|t| (own, t))).collect();
        for sample in 0..self.len() {
            for r in 0..6 {
                let (weight, row) = (weights.row(sample, r), self.row(sample, r));
                for (a, &(own_a, target_a)) in chosen.iter().enumerate() {
                    for &(own_b, target_b) in &chosen[..=a] {
                        let value = weight * row[own_a] * row[own_b];
                        information[(target_a, target_b)] += value;
                        if target_a != target_b {
                            information[(target_b, target_a)] += value;
                        }
                    }
                }
            }
        }
    }
}

/// Normal equations over all parameters of the model.
pub(super) struct Normal {
    /// `Aᵀ W A`.
    pub matrix: DMatrix<f64>,
    /// `Aᵀ W r`.
    pub right: DVector<f64>,
    /// `rᵀ W r`.
    pub cost: f64,
    /// Number of residual components, counted as independent ones.
    pub independent: f64,
}

impl Normal {
    pub fn zeros(width: usize) -> Self {
        Self {
            matrix: DMatrix::zeros(width, width),
            right: DVector::zeros(width),
            cost: 0.0,
            independent: 0.0,
        }
    }
}
