//! Latency between several topics of joint states of one arm.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::estimate::{ArmStreamsDiagnosis, position_factor};
use crate::diagnosis::{Measured, PoseStream};
use crate::run::{Arm, Run};
use crate::stream::JointTrack;

/// A topic of joint states that is late against the arm's other joint states.
#[derive(Clone, Copy, Debug)]
pub struct JointTopicLatency {
    /// Its stream.
    pub stream: usize,
    /// Stream of other joints.
    pub other: usize,
    /// Negative if it is early.
    pub latency_s: Measured,
}

/// Fit of a pose stream's positions with one latency for most joints and another for the joints of a topic.
struct TwoLatencies {
    of_most_s: f64,
    /// Latency of the topic relative to the other joints.
    between: Measured,
    squares: f64,
}

/// The arm with corrected stamps of the topic. `None` unless its latency explains most of the positions' error.
pub(super) fn with_corrected_topic(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
) -> Option<(Arm, JointTopicLatency)> {
    /// Ratio of squared errors. Backlash depends on the direction of motion too, but reduces it less.
    const MAX_REMAINING_SHARE: f64 = 0.25;
    const MIN_STD_ERRORS: f64 = 5.0;
    let streams: Vec<usize> = arm.joint_sources.iter().map(|source| source.stream).collect();
    let topics: BTreeSet<usize> = streams.iter().copied().collect();
    if topics.len() < 2 || arm.trajectory.is_some() {
        return None;
    }
    let poses = arm.poses.iter().zip(&found.arm.streams);
    let with_latency = poses.filter(|(_, found)| found.latency_s.is_ok());
    let (source, diagnosis) = with_latency.max_by_key(|(source, _)| source.track.t_s.len())?;
    let stream = run.pose_stream(source);
    let fit = |own: &[usize]| {
        let lag_s = diagnosis.latency_s.as_ref().map_or(0.0, |latency| latency.value);
        TwoLatencies::fit(&arm.joints, &stream, (position_factor(diagnosis), lag_s), own)
    };
    let together = fit(&[])?;
    let columns_of = |topic: usize| -> Vec<usize> {
        (0..streams.len()).filter(|&column| streams[column] == topic).collect()
    };
    let fits = topics.iter().filter_map(|&topic| Some((topic, fit(&columns_of(topic))?)));
    let (topic, best) = fits.min_by(|a, b| a.1.squares.total_cmp(&b.1.squares))?;
    let is_clear = best.squares < MAX_REMAINING_SHARE * together.squares
        && best.between.value.abs() > MIN_STD_ERRORS * best.between.std_error;
    let other = topics.iter().copied().find(|other| *other != topic).filter(|_| is_clear)?;
    // If there are two topics, the late topic disagrees with the poses as well.
    let is_other =
        topics.len() == 2 && (best.of_most_s - best.between.value).abs() < best.of_most_s.abs();
    let late = match is_other {
        true => {
            JointTopicLatency { stream: other, other: topic, latency_s: best.between.scaled(-1.0) }
        }
        false => JointTopicLatency { stream: topic, other, latency_s: best.between },
    };
    let joints = shifted(&arm.joints, &columns_of(late.stream), late.latency_s.value);
    let mut corrected = arm.clone();
    corrected.joints = Arc::new(joints);
    Some((corrected, late))
}

/// Shifts the joints in `columns` to the times of the others.
fn shifted(track: &JointTrack, columns: &[usize], late_s: f64) -> JointTrack {
    let dof = track.dof;
    let mut moved = JointTrack { t_s: Vec::new(), q: Vec::new(), qd: Vec::new(), ..track.clone() };
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; dof], vec![0.0; dof]);
    for (row, t_s) in track.t_s.iter().enumerate() {
        if !track.at(t_s + late_s, &mut cursor, &mut q, &mut qd) {
            continue;
        }
        let own = row * dof..(row + 1) * dof;
        let (mut row_q, mut row_qd) = (track.q[own.clone()].to_vec(), track.qd[own].to_vec());
        for &column in columns {
            (row_q[column], row_qd[column]) = (q[column], qd[column]);
        }
        moved.t_s.push(*t_s);
        moved.q.extend(row_q);
        moved.qd.extend(row_qd);
    }
    moved
}

impl TwoLatencies {
    /// Linearizes the positions, times `factor` in m, in both latencies, all zeros, the reference and the tool.
    /// Without `own` columns there is one latency.
    fn fit(
        joints: &JointTrack,
        stream: &PoseStream<'_>,
        (factor, lag_s): (f64, f64),
        own: &[usize],
    ) -> Option<Self> {
        const ITERATIONS: usize = 5;
        let mut found = Self {
            of_most_s: lag_s,
            between: Measured { value: 0.0, std_error: 0.0, dof: 0.0 },
            squares: 0.0,
        };
        for _ in 0..ITERATIONS {
            let track = shifted(joints, own, found.between.value);
            let step = Step::solve(&track, stream, (factor, found.of_most_s), own)?;
            found.squares = step.mean_square;
            found.of_most_s += step.of_most_s;
            let between_s = found.between.value + step.between.value;
            found.between = Measured { value: between_s, ..step.between };
        }
        Some(found)
    }
}

/// Change of both latencies in one iteration.
struct Step {
    of_most_s: f64,
    between: Measured,
    mean_square: f64,
}

impl Step {
    fn solve(
        joints: &JointTrack,
        stream: &PoseStream<'_>,
        (factor, lag_s): (f64, f64),
        own: &[usize],
    ) -> Option<Self> {
        const MAX_SAMPLES: usize = 1500;
        const MIN_SAMPLES: usize = 100;
        /// Link deviations correlate the errors of neighbouring samples.
        const CORRELATION_S: f64 = 0.5;
        const MIN_SINGULAR_SHARE: f64 = 1e-9;
        let PoseStream { track, chain, columns, .. } = *stream;
        let dof = columns.len();
        let (reference, tool, count) = (2 + dof, 8 + dof, 11 + dof);
        let mut normal = DMatrix::<f64>::zeros(count, count);
        let mut right = DVector::<f64>::zeros(count);
        let (mut squares, mut samples) = (0.0, 0_usize);
        let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
        let mut jacobian = vec![[0.0; 6]; dof];
        let (mut first_s, mut last_s) = (f64::INFINITY, f64::NEG_INFINITY);
        for at in (0..track.t_s.len()).step_by(track.t_s.len().div_ceil(MAX_SAMPLES).max(1)) {
            if !joints.at(track.t_s[at] - lag_s, &mut cursor, &mut q, &mut qd) {
                continue;
            }
            let of_chain =
                |all: &[f64]| columns.iter().map(|&column| all[column]).collect::<Vec<_>>();
            let (own_q, own_qd) = (of_chain(&q), of_chain(&qd));
            let pose = chain.forward_with_jacobian(&own_q, &mut jacobian);
            let position = pose.translation.vector;
            let residual = track.xyz[at] * factor - position;
            let rotation = pose.rotation.to_rotation_matrix();
            for axis in 0..3 {
                let mut row = DVector::<f64>::zeros(count);
                for joint in 0..dof {
                    let rate = jacobian[joint][axis] * own_qd[joint];
                    row[0] -= rate;
                    if own.contains(&columns[joint]) {
                        row[1] += rate;
                    }
                    row[2 + joint] = jacobian[joint][axis];
                }
                row[reference + axis] = 1.0;
                // The cross product of each unit vector with the position.
                row[reference + 3 + (axis + 1) % 3] = position[(axis + 2) % 3];
                row[reference + 3 + (axis + 2) % 3] = -position[(axis + 1) % 3];
                for part in 0..3 {
                    row[tool + part] = rotation[(axis, part)];
                }
                normal.ger(1.0, &row, &row, 1.0);
                right.axpy(residual[axis], &row, 1.0);
                squares += residual[axis].powi(2);
            }
            samples += 1;
            first_s = first_s.min(track.t_s[at]);
            last_s = last_s.max(track.t_s[at]);
        }
        if samples < MIN_SAMPLES {
            return None;
        }
        let decomposed = normal.svd(true, true);
        let least = MIN_SINGULAR_SHARE * decomposed.singular_values.max();
        let solution = decomposed.solve(&right, least).ok()?;
        let inverse = decomposed.pseudo_inverse(least).ok()?;
        let mean_square = (squares - solution.dot(&right)).max(0.0) / (3 * samples) as f64;
        let independent = ((last_s - first_s) / CORRELATION_S).clamp(1.0, samples as f64);
        let inflation = samples as f64 / independent;
        let std_error = (mean_square * inflation * inverse[(1, 1)]).max(0.0).sqrt();
        Some(Self {
            of_most_s: solution[0],
            between: Measured { value: solution[1], std_error, dof: independent },
            mean_square,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;
    use crate::robot::catalogue;
    use crate::stream::{Orientations, PoseTrack};

    /// A UR5e. Its last three joints are late by `late_s`, and its poses by 4 ms, in a displaced frame.
    #[test]
    fn a_late_topic_is_measured_beside_frames_and_zeros() {
        let robot = catalogue::find("ur5e").expect("in the catalogue");
        let link = |name: &str| robot.link(name).expect("a link");
        let base = link(robot.controller_base.as_deref().expect("a base"));
        let chain = robot.chain(base, link(robot.default_tip.as_deref().expect("a tip")));
        let chain = chain.expect("a chain");
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
            let stream = PoseStream {
                track: &track,
                chain: &chain,
                columns: &[0, 1, 2, 3, 4, 5],
                reference_known: true,
                stamp_error_s: 0.0,
                stamps_copied: false,
                removed_ramp: None,
            };
            let fit = |own: &[usize]| TwoLatencies::fit(&joints, &stream, (1.0, 0.0), own);
            let (two, one) = (fit(&[3, 4, 5]).expect("a fit"), fit(&[]).expect("a fit"));
            assert!((two.between.value - late_s).abs() < 2e-4, "{:?}", two.between);
            assert!((two.of_most_s - 0.004).abs() < 2e-4, "{}", two.of_most_s);
            assert_eq!(two.squares < 0.1 * one.squares, late_s > 0.0);
        }
    }

    #[test]
    fn shifted_joints_are_read_later() {
        let t_s: Vec<f64> = (0..100).map(|k| 0.01 * f64::from(k)).collect();
        let q = t_s.iter().flat_map(|t_s| [*t_s, 2.0 * t_s]).collect();
        let track = JointTrack { dof: 2, qd: [1.0, 2.0].repeat(100), q, t_s, noise: Vec::new() };
        let moved = shifted(&track, &[1], 0.025);
        assert_eq!(moved.len(), 97);
        for (row, t_s) in moved.t_s.iter().enumerate() {
            assert!((moved.q[2 * row] - t_s).abs() < 1e-12);
            assert!((moved.q[2 * row + 1] - 2.0 * (t_s + 0.025)).abs() < 1e-12);
        }
    }
}
