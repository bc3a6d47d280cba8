//! Pose streams that are compared with each other, with their trajectory errors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::diagnosis::{
    MAX_STAMP_DIFFERENCE_S, TrajectoryError, absolute_trajectory_error, aligned_trajectory_error,
    associate_stamps, relative_pose_error,
};
use crate::finding::Unit;
use crate::geometry::Pose;
use crate::run::{Arm, PoseSource, Run};
use crate::stream::{Orientations, PoseTrack};

/// One pose stream, compared with another.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ComparisonRow {
    /// Topic of the stream.
    pub topic: String,
    /// Topic of the reference.
    pub reference: String,
    /// Why it is the reference.
    pub reason: String,
    /// Pairs of poses with stamps at most 10 ms apart, as associated by evo. The errors are theirs; `null` if there
    /// are none.
    pub pairs: usize,
    /// Absolute trajectory error as logged: `evo_ape`.
    pub ate: Option<TrajectoryErrorRow>,
    /// Absolute trajectory error after rigid alignment of the positions: `evo_ape --align`.
    pub ate_aligned: Option<TrajectoryErrorRow>,
    /// Relative pose error between consecutive pairs: `evo_rpe`.
    pub rpe: Option<TrajectoryErrorRow>,
}

/// Root mean squares.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
pub struct TrajectoryErrorRow {
    /// Of the distance, m.
    pub translation_m: f64,
    /// Of the angle, rad.
    pub rotation_rad: f64,
}

impl From<TrajectoryError> for TrajectoryErrorRow {
    fn from(error: TrajectoryError) -> Self {
        Self { translation_m: error.translation_rmse_m, rotation_rad: error.rotation_rmse_rad }
    }
}

impl TrajectoryErrorRow {
    fn show(&self) -> String {
        let [length, angle] =
            [Unit::Metre.show(self.translation_m), Unit::Radian.show(self.rotation_rad)];
        format!("{length} and {angle}")
    }
}

impl ComparisonRow {
    /// `ATE 8.12 mm and 2.06° rms aligned (3.17 m and 58.1° as logged), RPE 3.49 mm and 0.28°, of 573 pairs of poses up
    /// to 10 ms apart`: the errors include the motion between their stamps. `None` without pairs.
    pub fn errors(&self) -> Option<String> {
        let (logged, steps) = (self.ate?.show(), self.rpe?.show());
        let aligned = self.ate_aligned.map_or_else(
            || format!("ATE {logged} rms as logged"),
            |aligned| format!("ATE {} rms aligned ({logged} as logged)", aligned.show()),
        );
        let apart = Unit::Second.show(MAX_STAMP_DIFFERENCE_S);
        Some(format!(
            "{aligned}, RPE {steps}, of {} pairs of poses up to {apart} apart",
            self.pairs
        ))
    }
}

pub(crate) fn comparison_rows(run: &Run) -> Vec<ComparisonRow> {
    let of_arm = |arm: &Arm| {
        let Some(trajectory) = &arm.trajectory else { return Vec::new() };
        let row = |source: &PoseSource| {
            let [reference, estimate] = [&trajectory.track, &source.track];
            let stamps = |track: &PoseTrack| -> Vec<i64> {
                track.t_s.iter().map(|t_s| run.origin.shifted(*t_s).nanos()).collect()
            };
            let pairs =
                associate_stamps(&stamps(reference), &stamps(estimate), MAX_STAMP_DIFFERENCE_S);
            let poses = poses(reference).zip(poses(estimate)).map(|(reference, estimate)| {
                let both = pairs.iter().map(|&(a, b)| (reference[a], estimate[b]));
                both.unzip::<Pose, Pose, Vec<Pose>, Vec<Pose>>()
            });
            let error = |of: fn(&[Pose], &[Pose]) -> Option<TrajectoryError>| {
                let (reference, estimate) = poses.as_ref()?;
                Some(of(reference, estimate)?.into())
            };
            ComparisonRow {
                topic: run.streams[source.stream].topic.clone(),
                reference: run.streams[trajectory.stream].topic.clone(),
                reason: trajectory.why.clone(),
                pairs: pairs.len(),
                ate: error(absolute_trajectory_error),
                ate_aligned: error(aligned_trajectory_error),
                rpe: error(relative_pose_error),
            }
        };
        arm.poses.iter().map(row).collect()
    };
    run.arms.iter().flat_map(of_arm).collect()
}

/// `None` without rotations.
fn poses(track: &PoseTrack) -> Option<Vec<Pose>> {
    let Orientations::Rotations(rotations) = &track.orientation else { return None };
    let both = track.xyz.iter().zip(rotations);
    Some(both.map(|(xyz, rotation)| Pose::from_parts((*xyz).into(), *rotation)).collect())
}
