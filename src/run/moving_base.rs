//! Transforms poses in a moving frame, such as odometry, to the base.

use crate::geometry::{Pose, interpolate};
use crate::stream::{Orientations, PoseTrack};

use super::sources::{MovingBase, PoseSource};

impl PoseSource {
    /// Transforms the poses again with transforms `lag_s` before the stamps. `is_on_time` if that is the
    /// poses' latency.
    pub(crate) fn retransform(&mut self, lag_s: f64, is_on_time: bool) {
        let Some(base) = &mut self.moving_base else { return };
        let transformed = base.in_base(lag_s);
        if transformed.t_s.len() > 1 {
            (base.lag_s, base.is_on_time) = (lag_s, is_on_time);
            self.track = transformed;
        }
    }
}

impl MovingBase {
    /// Frame in base at a time, interpolated. `None` outside the transforms.
    pub fn pose_at(&self, t_s: f64) -> Option<Pose> {
        let right = self.t_s.partition_point(|&t| t < t_s);
        let (&after_s, after) = (self.t_s.get(right)?, self.base_from_frame.get(right)?);
        if after_s == t_s {
            return Some(*after);
        }
        let left = right.checked_sub(1)?;
        let part = (t_s - self.t_s[left]) / (after_s - self.t_s[left]);
        Some(interpolate(&self.base_from_frame[left], after, part))
    }

    /// Poses in the base, with transforms `lag_s` before the stamps.
    pub fn in_base(&self, lag_s: f64) -> PoseTrack {
        let logged = &self.logged;
        let rotations = match &logged.orientation {
            Orientations::Rotations(rotations) => Some(rotations),
            _ => None,
        };
        let mut transformed = PoseTrack {
            t_s: Vec::new(),
            xyz: Vec::new(),
            orientation: Orientations::Rotations(Vec::new()),
            declared: None,
        };
        let mut turned = Vec::new();
        for (row, &t_s) in logged.t_s.iter().enumerate() {
            let rotation = rotations.map(|rotations| rotations[row]).unwrap_or_default();
            let Some(base_from_frame) = self.pose_at(t_s - lag_s) else { continue };
            let pose = base_from_frame * Pose::from_parts(logged.xyz[row].into(), rotation);
            transformed.t_s.push(t_s);
            transformed.xyz.push(pose.translation.vector);
            turned.push(pose.rotation);
        }
        transformed.orientation = match rotations {
            Some(_) => Orientations::Rotations(turned),
            None => Orientations::Unset(transformed.t_s.len()),
        };
        transformed
    }
}
