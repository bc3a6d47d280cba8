//! Target poses decoded from another encoding.

use super::series::HandEyeSetting;
use super::{CameraMount, HandEyeStreams};
use ground::geometry::{
    Axes, MisinterpretationClass, Pose, QuaternionOrderError, Rotation, Vec3, pose,
    rotation_from_xyzw, xyzw_from_rotation,
};
use ground::stats::Measured;
use ground::stats::thin::thinned;

/// Encoding of a target's poses.
#[derive(Clone, Copy, Debug)]
pub enum TargetEncoding {
    /// As logged.
    AsLogged,
    /// Positions and rotations use different axes: those of the positions, if the rotations use the standard ones.
    Axes(Axes),
    /// Only the rotations are transposed.
    Transposed,
    /// Quaternion components are permuted.
    QuaternionOrder(QuaternionOrderError),
    /// Rotations misinterpreted in another convention.
    Misinterpreted(&'static MisinterpretationClass),
    /// Positions are scaled.
    Scaled(TargetScaleError),
}

/// Scale errors of a target's positions, as factors by which they are too long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetScaleError {
    /// Common factor; 1 if the size is right.
    pub size: Option<Measured>,
    /// Additional depth factor; 1 if the focal length is right.
    pub depth: Option<Measured>,
    /// Depth coordinate: 0 to 2.
    pub along: usize,
    /// Whether either factor alone explains the motion almost equally well.
    pub is_either: bool,
}

impl TargetScaleError {
    /// Corrects a logged position.
    pub fn correct(&self, xyz: Vec3) -> Vec3 {
        let factor = |of: &Option<Measured>| of.map_or(1.0, |of| of.value);
        let mut xyz = xyz / factor(&self.size);
        xyz[self.along] /= factor(&self.depth);
        xyz
    }
}

impl<'a> HandEyeStreams<'a> {
    /// Hand and decoded target, thinned to about `most` poses.
    pub(super) fn setting(
        &self,
        encoding: TargetEncoding,
        mount: CameraMount,
        most: usize,
    ) -> HandEyeSetting<'a> {
        let mut truths = Vec::new();
        let stamped = thinned(self.target.t_s.iter().zip(&self.target.poses), most);
        let poses = stamped.map(|(&t_s, pose)| (t_s, encoding.decode(pose, &mut truths)));
        HandEyeSetting::new(self.hand, poses, mount)
    }
}

impl TargetEncoding {
    /// `truths` is a scratch buffer.
    fn decode(&self, logged: &Pose, truths: &mut Vec<Rotation>) -> Pose {
        let (xyz, rotation) = (logged.translation.vector, logged.rotation);
        match self {
            Self::AsLogged => *logged,
            Self::Axes(axes) => pose(axes.to_standard(xyz).into(), rotation),
            Self::Transposed => pose(xyz.into(), rotation.inverse()),
            Self::QuaternionOrder(error) => {
                let meant = rotation_from_xyzw(error.true_xyzw(xyzw_from_rotation(&rotation)));
                pose(xyz.into(), meant.unwrap_or(rotation))
            }
            Self::Misinterpreted(class) => {
                if let Some(misreading) = class.members.first() {
                    misreading.true_rotations(&rotation, truths);
                }
                pose(xyz.into(), truths.first().copied().unwrap_or(rotation))
            }
            Self::Scaled(stretch) => pose(stretch.correct(xyz).into(), rotation),
        }
    }
}
