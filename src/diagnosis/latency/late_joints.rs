//! Latency between groups of joints of one arm, if several topics contain their states.

use crate::PoseStream;
use crate::model::jacobian::PoseJacobian;
use crate::solver::linear::Linear;
use crate::solver::robust::pseudo_inverse;
use ground::geometry::Pose;
use ground::stats::thin::thinned;
use ground::stats::{Measured, lowest};
use ground::stream::JointTrack;

/// A group of joints that is late against the arm's other joints.
#[derive(Clone, Copy, Debug)]
pub struct LateJoints {
    /// Index of the group.
    pub group: usize,
    /// Negative if they are early.
    pub latency_s: Measured,
}

impl LateJoints {
    /// The late group among `groups` of joint-track columns, by a pose stream whose positions times `factor` are in m and
    /// whose latency is about `lag_s`. `None` unless one latency explains most of the positions' error.
    pub fn find(
        joints: &JointTrack,
        stream: &PoseStream,
        (factor, lag_s): (f64, f64),
        groups: &[Vec<usize>],
    ) -> Option<Self> {
        /// Ratio of squared errors. Backlash depends on the direction of motion too, but explains less.
        const MAX_REMAINING_SHARE: f64 = 0.25;
        const MIN_STD_ERRORS: f64 = 5.0;
        let fit = |own: &[usize]| TwoLatencies::fit(joints, stream, (factor, lag_s), own);
        let together = fit(&[])?;
        let fits = groups.iter().enumerate().filter_map(|(at, own)| Some((at, fit(own)?)));
        let (group, best) = lowest(fits, |fit| fit.1.mean_square)?;
        let late = best.between;
        let is_clear = best.mean_square < MAX_REMAINING_SHARE * together.mean_square
            && late.value.abs() > MIN_STD_ERRORS * late.std_error;
        // Of two groups, the late one disagrees with the poses as well.
        let is_other =
            groups.len() == 2 && (best.of_others_s - late.value).abs() < best.of_others_s.abs();
        is_clear.then_some(match is_other {
            true => Self { group: 1 - group, latency_s: late.scaled(-1.0) },
            false => Self { group, latency_s: late },
        })
    }
}

/// Joints with those in `columns` shifted to the times of the others.
pub fn with_earlier_joints(joints: &JointTrack, columns: &[usize], late_s: f64) -> JointTrack {
    let (mut moved, mut rows) = (joints.clone(), Vec::new());
    let mut sequence = joints.sequence();
    for (row, t_s) in joints.t_s.iter().enumerate() {
        let Some((q, qd)) = sequence.at(t_s + late_s) else { continue };
        rows.push(row);
        for &column in columns {
            let at = row * joints.dof + column;
            (moved.q[at], moved.qd[at]) = (q[column], qd[column]);
        }
    }
    moved.at_rows(rows.into_iter())
}

/// Fit of a stream's positions with one latency for some joints and another for the others.
struct TwoLatencies {
    of_others_s: f64,
    /// Latency of the joints relative to the others.
    between: Measured,
    /// Of the residuals, m².
    mean_square: f64,
}

impl TwoLatencies {
    /// Without `own` columns there is one latency.
    fn fit(
        joints: &JointTrack,
        stream: &PoseStream,
        (factor, lag_s): (f64, f64),
        own: &[usize],
    ) -> Option<Self> {
        const GAUSS_NEWTON_STEPS: usize = 5;
        let between = Measured { value: 0.0, std_error: 0.0, dof: 0.0 };
        let mut found = Self { of_others_s: lag_s, between, mean_square: 0.0 };
        for _ in 0..GAUSS_NEWTON_STEPS {
            let shifted = with_earlier_joints(joints, own, found.between.value);
            found = found.after_step(&shifted, stream, factor, own)?;
        }
        Some(found)
    }

    /// After one least-squares step. Joint zeros, the reference and the position of the tool are free.
    fn after_step(
        &self,
        joints: &JointTrack,
        stream: &PoseStream,
        factor: f64,
        own: &[usize],
    ) -> Option<Self> {
        const MAX_SAMPLES: usize = 1500;
        const MIN_SAMPLES: usize = 100;
        /// Link deviations correlate the errors of neighbouring samples.
        const CORRELATION_S: f64 = 0.5;
        let PoseStream { track, chain, columns, .. } = *stream;
        let mut linear = Linear::new(2 + columns.len() + 6 + 3, &[0.0]);
        let mut times = Vec::new();
        let mut sequence = joints.sequence();
        let mut link = vec![[0.0; 6]; columns.len()];
        let identity = Pose::identity();
        for at in thinned(0..track.t_s.len(), MAX_SAMPLES) {
            let t_s = track.t_s[at];
            let Some((q, qd)) = sequence.at(t_s - self.of_others_s) else { continue };
            let rates = |is_moved: &dyn Fn(&usize) -> bool| -> Vec<f64> {
                columns.iter().map(|joint| if is_moved(joint) { qd[*joint] } else { 0.0 }).collect()
            };
            let q: Vec<f64> = columns.iter().map(|&column| q[column]).collect();
            let base_from_tip = chain.forward_with_jacobian(&q, &mut link);
            let residual = track.xyz[at] * factor - base_from_tip.translation.vector;
            let jacobian = PoseJacobian::new(&link, &identity, &base_from_tip, &identity);
            let latencies = [
                jacobian.velocity(&rates(&|_| true)).map(|part| -part),
                jacobian.velocity(&rates(&|joint| own.contains(joint))),
            ];
            let zeros = (0..columns.len()).map(|joint| jacobian.joint(joint));
            let frames = (0..6).map(|axis| jacobian.reference(axis));
            let tool = (0..3).map(|axis| jacobian.tool(axis));
            let all = latencies.into_iter().chain(zeros).chain(frames).chain(tool);
            linear.push(&[residual]).set_from(0, all.map(|[of_position, _]| of_position));
            times.push(t_s);
        }
        let span_s = times.last()? - times.first()?;
        let samples = times.len() as f64;
        if times.len() < MIN_SAMPLES {
            return None;
        }
        let normal = linear.normal(&linear.even_weights());
        let inverse = pseudo_inverse(&normal.matrix).0;
        let solution = &inverse * &normal.right;
        let mean_square = normal.cost_after(&solution).max(0.0) / (3.0 * samples);
        let independent = (span_s / CORRELATION_S).clamp(1.0, samples);
        let variance = mean_square * samples / independent * inverse[(1, 1)];
        let std_error = variance.max(0.0).sqrt();
        let between_s = self.between.value + solution[1];
        Some(Self {
            of_others_s: self.of_others_s + solution[0],
            between: Measured { value: between_s, std_error, dof: independent },
            mean_square,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_motion::{arm, tip_stream};
    use ground::geometry::Vec3;
    use ground::stream::{Orientations, PoseTrack};

    /// A UR5e. Its last three joints are late by `late_s`, and its poses by 4 ms, in a displaced frame.
    #[test]
    fn late_joints_are_measured_beside_frames_and_zeros() {
        let (_, chain) = arm();
        let angle = |joint: usize, t_s: f64| {
            [-0.4, -1.3, 1.4, -1.2, -1.0, 0.3][joint]
                + 0.5 * ((0.7 + 0.3 * joint as f64) * t_s).sin()
        };
        let rate = |joint: usize, t_s: f64| {
            let turn = 0.7 + 0.3 * joint as f64;
            0.5 * turn * (turn * t_s).cos()
        };
        let all = |of: &dyn Fn(usize, f64) -> f64, t_s: f64, late_s: f64| -> Vec<f64> {
            (0..6).map(|joint| of(joint, if joint < 3 { t_s } else { t_s - late_s })).collect()
        };
        let t_s: Vec<f64> = (0..2500).map(|row| 0.01 * f64::from(row)).collect();
        for late_s in [0.0, 0.02] {
            let rows = |of: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
                t_s.iter().flat_map(|t_s| all(of, *t_s, late_s)).collect()
            };
            let mut q = rows(&angle);
            // A zero that is off.
            q.iter_mut().skip(1).step_by(6).for_each(|q| *q += 0.01);
            let joints =
                JointTrack { t_s: t_s.clone(), dof: 6, q, qd: rows(&rate), noise: Vec::new() };
            let position = |t_s: &f64| {
                let pose = chain.forward(&all(&angle, t_s - 0.004, 0.0));
                pose.translation.vector + Vec3::new(0.03, -0.02, 0.01)
            };
            let track = PoseTrack {
                t_s: t_s.clone(),
                xyz: t_s.iter().map(position).collect(),
                orientation: Orientations::Unset(t_s.len()),
                declared: None,
            };
            let stream = tip_stream(&track, &chain);
            let fit = |own: &[usize]| TwoLatencies::fit(&joints, &stream, (1.0, 0.0), own);
            let (two, one) = (fit(&[3, 4, 5]).expect("a fit"), fit(&[]).expect("a fit"));
            assert!((two.between.value - late_s).abs() < 2e-4, "{:?}", two.between);
            assert!((two.of_others_s - 0.004).abs() < 2e-4, "{}", two.of_others_s);
            assert_eq!(two.mean_square < 0.1 * one.mean_square, late_s > 0.0);
        }
    }

    #[test]
    fn shifted_joints_are_read_later() {
        let t_s: Vec<f64> = (0..100).map(|k| 0.01 * f64::from(k)).collect();
        let q = t_s.iter().flat_map(|t_s| [*t_s, 2.0 * t_s]).collect();
        let track = JointTrack { dof: 2, qd: [1.0, 2.0].repeat(100), q, t_s, noise: Vec::new() };
        let moved = with_earlier_joints(&track, &[1], 0.025);
        assert_eq!(moved.len(), 97);
        for (row, t_s) in moved.t_s.iter().enumerate() {
            assert!((moved.q[2 * row] - t_s).abs() < 1e-12);
            assert!((moved.q[2 * row + 1] - 2.0 * (t_s + 0.025)).abs() < 1e-12);
        }
    }
}
