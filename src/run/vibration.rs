//! Replaces smoothed joint positions by the recorded ones if poses follow these.
//!
//! Fast variations of the positions are taken for noise ([`super::velocities::smooth`]). They are motion if the tool
//! follows them, as in a simulation, and a controller computes its poses from the positions that it logs.

use std::sync::Arc;

use super::Run;
use super::arm::Arm;
use super::joints::JointSamples;
use super::sources::PoseSource;
use super::velocities::derivative;
use crate::diagnosis::encoder_step;
use crate::geometry::{Rotation, angle_between};
use crate::stream::{JointTrack, Orientations};

pub(super) fn follow_recorded_positions(run: &mut Run) {
    for index in 0..run.arms.len() {
        let arm = &run.arms[index];
        let may_follow = arm.recorded_joints.is_none() && arm.poses.iter().any(is_comparable);
        let recorded =
            may_follow.then(|| recorded_track(arm, &run.joint_samples(&arm.joint_sources)));
        let Some(recorded) = recorded.flatten() else { continue };
        if arm.poses.iter().any(|source| follows(source, &recorded, &arm.joints)) {
            run.arms[index].joints = Arc::new(recorded);
        }
    }
}

/// Whether it has orientations at the stamps of the joint states.
fn is_comparable(source: &PoseSource) -> bool {
    source.stamps_copied && matches!(source.track.orientation, Orientations::Rotations(_))
}

/// The track with its positions as recorded. `None` if they are not smoothed, or not all recorded at its times.
fn recorded_track(arm: &Arm, samples: &[JointSamples<'_>]) -> Option<JointTrack> {
    let smoothed = &arm.joints;
    let mut recorded = smoothed.as_ref().clone();
    let t_s = &smoothed.t_s;
    for (column, joint) in samples.iter().enumerate() {
        let mut rows = joint.t_s.iter().zip(joint.position.iter()).peekable();
        let at = |t_s: &f64| {
            while rows.next_if(|(own_s, _)| *own_s < t_s).is_some() {}
            rows.peek().filter(|(own_s, _)| *own_s == t_s).map(|(_, position)| **position)
        };
        let q: Vec<f64> = t_s.iter().map(at).collect::<Option<_>>()?;
        if q.iter().copied().eq(smoothed.positions_of(column)) {
            continue;
        }
        let rounding = encoder_step(&q) / 12f64.sqrt();
        let period_s = (t_s.last()? - t_s.first()?) / t_s.len() as f64;
        if let Some(noise) = recorded.noise.get_mut(column) {
            *noise = [rounding, rounding / (2f64.sqrt() * period_s)];
        }
        for (row, (q, qd)) in q.iter().zip(derivative(t_s, &q)).enumerate() {
            let at = row * recorded.dof + column;
            (recorded.q[at], recorded.qd[at]) = (*q, qd);
        }
    }
    (recorded.q != smoothed.q).then_some(recorded)
}

/// Whether the tool turns from row to row as by one track, and not as by the other.
fn follows(source: &PoseSource, track: &JointTrack, other: &JointTrack) -> bool {
    /// Of the differences in turns; not calibrated. Those of the other track contain the vibration.
    const MAX_RATIO: f64 = 0.5;
    const MAX_ROWS: usize = 2000;
    const MIN_ROWS: usize = 20;
    let Orientations::Rotations(rotations) = &source.track.orientation else { return false };
    let fk = |track: &JointTrack, row: usize| -> Rotation {
        source.chain.forward(&track.positions_at(row, &source.columns)).rotation
    };
    let rows = source.track.t_s.iter().enumerate().filter_map(|(pose, t_s)| {
        let row = track.t_s.partition_point(|own_s| own_s < t_s);
        (track.t_s.get(row) == Some(t_s)).then_some((pose, row))
    });
    let rows: Vec<(usize, usize)> = rows.take(MAX_ROWS).collect();
    let (mut square, mut square_of_other) = (0.0, 0.0);
    for pair in rows.windows(2).filter(|pair| pair[1].1 == pair[0].1 + 1) {
        let turn = angle_between(&rotations[pair[0].0], &rotations[pair[1].0]);
        let by = |track: &JointTrack| angle_between(&fk(track, pair[0].1), &fk(track, pair[1].1));
        square += (by(track) - turn).powi(2);
        square_of_other += (by(other) - turn).powi(2);
    }
    rows.len() >= MIN_ROWS && square < MAX_RATIO * MAX_RATIO * square_of_other
}
