//! Pose series of hand and target.

use super::CameraMount;
use crate::latency::correlation::median_period_s;
use crate::samples::sampling::pose_between;
use ground::geometry::{Pose, Vec3, pose};
use ground::robot::Chain;
use ground::stats::thin::thinned;
use ground::stream::{JointTrack, Orientations, PoseTrack};

/// Poses over time. Times are from the run's origin, strictly increasing.
#[derive(Clone, Debug, Default)]
pub struct PoseSeries {
    /// Sample times.
    pub t_s: Vec<f64>,
    /// Translations in m.
    pub poses: Vec<Pose>,
}

impl PoseSeries {
    /// `None` if the orientations are undecoded.
    pub fn from_track(track: &PoseTrack) -> Option<Self> {
        let Orientations::Rotations(rotations) = &track.orientation else { return None };
        let poses = track.xyz.iter().zip(rotations);
        let poses = poses.map(|(xyz, rotation)| pose((*xyz).into(), *rotation)).collect();
        Some(Self { t_s: track.t_s.clone(), poses })
    }

    /// Tip poses by FK, thinned to 100–200 Hz.
    pub fn from_joints(joints: &JointTrack, chain: &Chain, columns: &[usize]) -> Self {
        /// Between samples the hand's motion is nearly linear.
        const PERIOD_S: f64 = 0.01;
        let period_s = median_period_s(&joints.t_s).max(1e-6);
        let step = ((PERIOD_S / period_s) as usize).max(1);
        let sample =
            |row: usize| (joints.t_s[row], chain.forward(&joints.positions_at(row, columns)));
        let (t_s, poses) = (0..joints.len()).step_by(step).map(sample).unzip();
        Self { t_s, poses }
    }

    /// Common time span, s; not positive if none.
    pub fn overlap_s(&self, other: &PoseSeries) -> f64 {
        let span = |series: &PoseSeries| Some((*series.t_s.first()?, *series.t_s.last()?));
        match (span(self), span(other)) {
            (Some(a), Some(b)) => a.1.min(b.1) - a.0.max(b.0),
            _ => 0.0,
        }
    }

    /// Interpolates position linearly, rotation along the shortest path. `None` outside the samples and in
    /// gaps longer than both 0.2 s and ten periods.
    pub(crate) fn at(&self, t_s: f64, period_s: f64) -> Option<Pose> {
        pose_between(&self.t_s, &self.poses, t_s, (10.0 * period_s).max(0.2))
    }
}

/// Mean in the series' own frame. Shorter than 1 if the directions vary.
pub(super) fn mean_direction(series: &PoseSeries) -> [f64; 3] {
    let xyz = series.poses.iter().map(|pose| pose.translation.vector);
    let sum: Vec3 = xyz.filter_map(|xyz| xyz.try_normalize(1e-9)).sum();
    (sum / series.poses.len().max(1) as f64).into()
}

#[derive(Clone, Copy, Debug)]
pub(super) struct PosePair {
    /// `base_from_hand` or, for a camera in the base, `hand_from_base`.
    pub carrier_pose: Pose,
    /// `camera_from_target`.
    pub target: Pose,
}

pub(super) struct HandEyeSetting<'a> {
    pub hand: &'a PoseSeries,
    pub period_s: f64,
    pub mount: CameraMount,
    /// Decoded target poses.
    pub targets: Vec<(f64, Pose)>,
}

impl<'a> HandEyeSetting<'a> {
    pub fn new(
        hand: &'a PoseSeries,
        target: impl Iterator<Item = (f64, Pose)>,
        mount: CameraMount,
    ) -> Self {
        let period_s = median_period_s(&hand.t_s);
        Self { hand, period_s, mount, targets: target.collect() }
    }

    /// Carrier pose at `t_s`.
    pub fn carrier_at(&self, t_s: f64) -> Option<Pose> {
        let hand = self.hand.at(t_s, self.period_s)?;
        Some(match self.mount {
            CameraMount::InHand => hand,
            CameraMount::InBase => hand.inverse(),
        })
    }

    /// Simultaneous poses for a target delay of `lag_s`. Takes at most `most` pairs, evenly spaced.
    pub fn pairs_at(&self, lag_s: f64, most: usize) -> Vec<PosePair> {
        let pairs = thinned(&self.targets, most).filter_map(|&(t_s, target)| {
            Some(PosePair { carrier_pose: self.carrier_at(t_s - lag_s)?, target })
        });
        pairs.collect()
    }
}
