//! Corrections of joint states in a part of the run, and decoded poses.

use std::ops::Range;

use super::JointPatch;
use super::split_run::set_velocity;
use crate::PoseDiagnosis;
use crate::samples::sampling::rows_within;
use ground::geometry::Pose;
use ground::stream::{JointTrack, Orientations, PoseTrack};

impl JointPatch {
    /// Maps the joint's positions to the baseline segment.
    pub(crate) fn apply(&self, joints: &mut JointTrack) {
        let dof = joints.dof.max(1);
        let rows = self.rows(&joints.t_s);
        for row in rows.clone() {
            let at = row * dof + self.column;
            if let Some(other) = self.exchanged_with {
                let other = row * dof + other;
                joints.q.swap(at, other);
                joints.qd.swap(at, other);
            }
            self.apply_to_value(joints.t_s[row], &mut joints.q[at], &mut joints.qd[at]);
        }
        for edge in [rows.start, rows.end].into_iter().filter(|edge| *edge > 1) {
            for column in std::iter::once(self.column).chain(self.exchanged_with) {
                set_velocity(joints, column, edge - 1, edge - 2);
                set_velocity(joints, column, edge, edge + 1);
            }
        }
    }

    /// The same for the joint's own samples.
    pub fn apply_to_samples(&self, t_s: &[f64], position: &mut [f64], velocity: &mut [f64]) {
        for row in self.rows(t_s) {
            self.apply_to_value(t_s[row], &mut position[row], &mut velocity[row]);
        }
    }

    /// Rows of the segment.
    pub fn rows(&self, t_s: &[f64]) -> Range<usize> {
        rows_within(t_s, self.from_s, self.to_s)
    }

    fn apply_to_value(&self, t_s: f64, position: &mut f64, velocity: &mut f64) {
        // The first span starts at minus infinity.
        let drift = if self.rate == 0.0 { 0.0 } else { self.rate * (t_s - self.from_s) };
        *position = self.factor * *position + self.offset + drift;
        *velocity = self.factor * *velocity + self.rate;
    }
}

/// A stream with decoded poses.
pub(super) fn with_poses(
    diagnosis: &PoseDiagnosis,
    poses: impl Iterator<Item = Pose>,
) -> PoseTrack {
    let (xyz, rotations): (Vec<_>, Vec<_>) =
        poses.map(|pose| (pose.translation.vector, pose.rotation)).unzip();
    let orientation = match &diagnosis.encoding {
        Ok(_) => Orientations::Rotations(rotations),
        Err(_) => Orientations::Unset(rotations.len()),
    };
    PoseTrack { t_s: diagnosis.aligned.t_s.clone(), xyz, orientation, declared: None }
}
