//! A frame that moves in an arm's base, as the odometry frame of a mobile manipulator.

use super::jacobian::pose_change;
use crate::samples::sampling::{as_rotations, pose_between};
use ground::geometry::{Pose, Vec3};
use ground::stream::{Orientations, PoseTrack};

/// Frame that moves in an arm's base. Poses in it are transformed to the base, so that constant causes have constant
/// effects. The measurement model accounts for the motion of the base between the assumed and the true time.
#[derive(Clone, Debug, Default)]
pub struct MovingFrame {
    /// True times of the transforms, s from the run's origin, strictly increasing.
    pub t_s: Vec<f64>,
    /// Poses of the frame in the base.
    pub base_from_frame: Vec<Pose>,
    /// Assumed latency of the poses: they are transformed to the base at their stamp minus this, s.
    pub lag_s: f64,
}

impl MovingFrame {
    /// Frame in the base at a true time, interpolated. `None` outside the transforms.
    pub fn pose_at(&self, t_s: f64) -> Option<Pose> {
        pose_between(&self.t_s, &self.base_from_frame, t_s, f64::INFINITY)
    }

    /// Poses in the base. Drops those outside the transforms.
    pub fn in_base(&self, logged: &PoseTrack) -> PoseTrack {
        self.transformed(logged, |base_from_frame| base_from_frame)
    }

    /// Poses in the frame, from those in the base.
    pub(crate) fn in_frame(&self, track: &PoseTrack) -> PoseTrack {
        self.transformed(track, |base_from_frame| base_from_frame.inverse())
    }

    fn transformed(&self, track: &PoseTrack, transform: impl Fn(Pose) -> Pose) -> PoseTrack {
        let rotations = as_rotations(&track.orientation);
        let (mut t_s, mut xyz, mut turned) = (Vec::new(), Vec::new(), Vec::new());
        for (row, &stamp_s) in track.t_s.iter().enumerate() {
            let Some(base_from_frame) = self.pose_at(stamp_s - self.lag_s) else { continue };
            let rotation = rotations.map(|rotations| rotations[row]).unwrap_or_default();
            let pose =
                transform(base_from_frame) * Pose::from_parts(track.xyz[row].into(), rotation);
            t_s.push(stamp_s);
            xyz.push(pose.translation.vector);
            turned.push(pose.rotation);
        }
        let orientation = match rotations {
            Some(_) => Orientations::Rotations(turned),
            None => Orientations::Unset(t_s.len()),
        };
        PoseTrack { t_s, xyz, orientation, declared: None }
    }

    /// The base at a true time, in the base to which poses with this stamp are transformed.
    pub(crate) fn base_at(&self, stamp_s: f64, truth_s: f64) -> Option<Pose> {
        Some(self.pose_at(stamp_s - self.lag_s)? * self.pose_at(truth_s)?.inverse())
    }

    /// Velocity of the base in the frame, in its own axes: m/s and rad/s.
    pub(crate) fn base_velocity(&self, t_s: f64) -> Option<[Vec3; 2]> {
        /// Several periods of usual transforms.
        const HALF_SPAN_S: f64 = 0.05;
        let (first_s, last_s) = (*self.t_s.first()?, *self.t_s.last()?);
        let here = self.pose_at(t_s)?;
        let from_s = (t_s - HALF_SPAN_S).max(first_s);
        let to_s = (t_s + HALF_SPAN_S).min(last_s);
        let before = here * self.pose_at(from_s)?.inverse();
        let after = here * self.pose_at(to_s)?.inverse();
        let span_s = (to_s - from_s).max(f64::MIN_POSITIVE);
        Some(pose_change(&before, &after).map(|part| part / span_s))
    }
}
